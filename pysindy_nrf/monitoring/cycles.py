"""Stiffness, energy and plastic drift of every storey, cycle by cycle of a record."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm

from ..chain.sites import as_mapping
from ..drawing.matplotlib_renderer import Drawing
from ..exceptions import ChainError, ChannelError
from ..identification import newey_west
from ..records.dataset import Segment
from ..records.input_arrays import from_arrays
from ..records.record import Record
from ..report.figures.cycles import cycle_figures

# A reversal counts if the drift moves on by this share of its range, and by this many
# times its noise.
LEAST_SHARE = 0.03
LEAST_NOISES = 6.0
# Samples of a cycle, at least: three coefficients and their errors.
LEAST_SAMPLES = 12
# Share of the largest drift up to which the first cycles show the sound stiffness.
SOUND_UP_TO = 0.5
# Share of a cycle over which what a line leaves of its force is correlated.
CORRELATED = 0.125
LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class StoreyCycles:
    """Indicators of damage of every storey, cycle by cycle.

    Attributes
    ----------
    table : DataFrame
        A row for each cycle. The last five have ``_lower`` and ``_upper`` ends of 95 %
        intervals.

        - ``storey``, ``cycle``, ``start`` and ``end`` (s).
        - ``amplitude``: half the range of the drift, m.
        - ``stiffness``: N/m, and its ``loss``, percent of the sound one.
        - ``energy``: dissipated, J.
        - ``plastic``: equivalent cumulative plastic drift, m.
        - ``residual``: drift at which the force vanishes, m.
    storeys : DataFrame
        A row for each storey: the sound stiffness, the last loss, the energy and the
        plastic drift of the entire record and the residual drift of the last cycle,
        with their intervals.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import Record
    >>> from pysindy_nrf.monitoring import storey_cycles
    >>> t = np.arange(2000) / 200.0  # s
    >>> s = 0.01 * np.sin(2 * np.pi * t)  # m
    >>> a = -((2 * np.pi) ** 2) * s
    >>> record = Record(
    ...     force=10.0 * a + 4e4 * s, acceleration=a, displacement=s, fs=200.0
    ... )
    >>> cycles = storey_cycles(record, {1: 10.0})
    >>> int(cycles.storeys["stiffness"].iloc[0].round(-2))
    40000
    """

    table: pd.DataFrame
    storeys: pd.DataFrame

    def to_json(self) -> str:
        """Both tables as JSON, SI units."""
        content = {
            "storeys": self.storeys.to_dict("records"),
            "cycles": self.table.to_dict("records"),
        }
        return json.dumps(content, indent=1)

    def plot(self) -> Drawing:
        """Draw loss, energy, plastic and residual drift of each storey (matplotlib).

        Returns
        -------
        Display
            With ``axes_`` and ``figure_``.
        """
        return Drawing(cycle_figures(self.table)).plot()


def storey_cycles(record: Record, masses: Mapping[int, float]) -> StoreyCycles:
    r"""Indicators of damage within an earthquake, storey by storey and cycle by cycle.

    The force of a storey is that of all masses above it, without any law,

    .. math:: R_i = \sum_{j \ge i} (F_j - m_j a_j) .

    A cycle goes from one largest drift to the next. Its stiffness is the slope of a
    line in drift and rate (hysteresis loop analysis: Xu, Chase and Rodgers, Computers
    and Structures 135, 2014), its energy the area of its loop. The equivalent plastic
    drift is the energy beyond that of the sound damping over the largest force: the
    plastic travel of an elasto-plastic storey that dissipates as much (Mahin and
    Bertero, Journal of the Structural Division 107, 1981). The residual drift is that
    at which the line has no force. Stiffness is that of an amplitude;
    ``NRFRegressor(varying="auto")`` says whether a lower one is a change.

    Parameters
    ----------
    record : Record
        Every floor measured.
    masses : mapping of int to float
        Of all DOFs, kg.

    Returns
    -------
    StoreyCycles

    Raises
    ------
    ChainError
        If a mass is missing.
    ChannelError
        If the record has no clock, or the force on a floor is not known.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import (
    ...     ChainModel,
    ...     excitation,
    ...     laws,
    ...     monitoring,
    ...     simulate,
    ... )
    >>> storey = laws.PowerSeries(1, [40.0, 4e4])
    >>> ag = excitation.band_limited_random(
    ...     1, 20.0, 200.0, excited=1, rms=1.0, band=(0.5, 8), random_state=0
    ... )[:, 0]
    >>> record = simulate(
    ...     ChainModel([10.0], {1: storey}),
    ...     None,
    ...     1 / 200.0,
    ...     base_acceleration=ag,
    ... )
    >>> cycles = monitoring.storey_cycles(record, {1: 10.0})
    >>> bool(cycles.table["loss"].abs().max() < 1.0)  # percent
    True
    """
    known = as_mapping("masses", masses, "{1: 12.4}")
    missing = [j for j in range(1, record.n_dof + 1) if j not in known]
    if missing:
        raise ChainError(
            f"The mass of DOF {missing[0]} is not given",
            "Give masses={dof: kg} of all.",
        )
    segment = from_arrays([record]).segments[0]
    mass = np.array([float(known[j]) for j in range(1, record.n_dof + 1)])
    rows = [_cycle_rows(storey) for storey in _storeys(segment, mass)]
    table = pd.concat([row for row in rows if len(row)], ignore_index=True)
    totals = [_total(name, of_storey) for name, of_storey in table.groupby("storey")]
    return StoreyCycles(table, pd.DataFrame(totals))


@dataclass(frozen=True, eq=False)
class _Storey:
    """Motion and force of one storey along a record."""

    name: str
    t: np.ndarray
    drift: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    noise_of_drift: float
    noise_of_force: float


def _storeys(segment: Segment, masses: np.ndarray) -> Iterator[_Storey]:
    """The storeys of a record, from the lowest up."""
    rows = segment.valid
    if np.isnan(segment.F[rows]).any():
        raise ChannelError(
            "The force on a floor is not known, and the forces of the storeys with it",
            "Give zeros where no force acts.",
        )
    t = segment.step * np.arange(segment.n_valid)
    if segment.t is not None:
        t = t + segment.t[rows.start]
    inertia = segment.F[rows] - masses * segment.a[rows]
    forces = np.cumsum(inertia[:, ::-1], axis=1)[:, ::-1]
    noise = segment.noise
    for i in range(segment.n_dof):
        above = range(i + 1, segment.n_dof + 1)
        of_forces = [masses[j - 1] * noise.get(f"a{j}", 0.0) for j in above]
        ends = [noise.get(f"x{j}", 0.0) for j in (i, i + 1)]
        yield _Storey(
            f"storey {i + 1}",
            t,
            segment.s[rows, i].astype(float),
            segment.v[rows, i].astype(float),
            forces[:, i],
            float(np.linalg.norm(ends)),
            float(np.linalg.norm(of_forces)),
        )


def _reversals(storey: _Storey) -> np.ndarray:
    """Samples at which the drift turns, without noise and small ripples."""
    drift = storey.drift
    least = max(LEAST_SHARE * np.ptp(drift), LEAST_NOISES * storey.noise_of_drift)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(drift)))) + 1
    reversals: list[int] = []
    for turn in turns.tolist():
        if not reversals:
            reversals.append(turn)
            continue
        onward = _goes_onward(drift, reversals, turn)
        if onward:
            reversals[-1] = turn
        elif abs(drift[turn] - drift[reversals[-1]]) >= least:
            reversals.append(turn)
    return np.array(reversals, dtype=int)


def _goes_onward(drift: np.ndarray, reversals: list[int], turn: int) -> bool:
    """Whether a turn goes on in the direction of the last reversal."""
    if len(reversals) < 2:
        return False
    direction = drift[reversals[-1]] - drift[reversals[-2]]
    return direction * (drift[turn] - drift[reversals[-1]]) > 0


@dataclass(frozen=True, eq=False)
class _Cycle:
    """A cycle as a line in drift and rate, and as a loop.

    Attributes
    ----------
    rows : slice
    line : ndarray of shape (3,)
        Stiffness, damping and constant.
    covariance : ndarray of shape (3, 3)
        Of the line.
    work : float
        Of the force along the closed loop, J.
    error_of_work : float
    """

    rows: slice
    line: np.ndarray
    covariance: np.ndarray
    work: float
    error_of_work: float


def _cycle(storey: _Storey, rows: slice) -> _Cycle:
    """Fit a cycle."""
    drift = storey.drift[rows]
    rate = storey.rate[rows]
    force = storey.force[rows]
    columns = np.column_stack([drift, rate, np.ones_like(drift)])
    scale = np.linalg.norm(columns, axis=0)
    unit = columns / scale
    inverse = np.linalg.pinv(unit.T @ unit)
    line = inverse @ (unit.T @ force)
    residual = force - unit @ line
    # a whole cycle's residual may repeat; an eighth of it is one piece
    lags = max(1, int(CORRELATED * len(drift)))
    influences = (unit * residual[:, None]) @ inverse
    covariance = newey_west(influences, lags=lags) / np.outer(scale, scale)
    floor = storey.noise_of_force**2 * inverse / np.outer(scale, scale)

    t = storey.t[rows]
    # without its ends the loop is closed by the line
    elastic = line[0] / scale[0] * drift + line[2] / scale[2]
    work = float(np.trapezoid((force - elastic) * rate, t))
    step = (t[-1] - t[0]) / (len(t) - 1)
    noise = max(storey.noise_of_force, float(residual.std()))
    error = noise * step * float(np.linalg.norm(rate)) * np.sqrt(lags)
    return _Cycle(rows, line / scale, covariance + floor, work, float(error))


def _cycle_rows(storey: _Storey) -> pd.DataFrame:
    """Indicators of all cycles of a storey."""
    turns = _reversals(storey)
    cycles = []
    for start, end in zip(turns[:-2:2], turns[2::2]):
        if end - start >= LEAST_SAMPLES:
            cycles.append(_cycle(storey, slice(int(start), int(end) + 1)))
    if not cycles:
        return pd.DataFrame()

    sound = _Sound.of(storey, cycles)
    rows = []
    plastic = np.zeros(2)
    for number, cycle in enumerate(cycles, start=1):
        plastic += sound.plastic(storey, cycle)
        rows.append(_row(storey, number, cycle, sound, plastic))
    return pd.DataFrame(rows)


@dataclass(frozen=True)
class _Sound:
    """Stiffness and damping of a storey before its largest drifts.

    Attributes
    ----------
    stiffness, variance : float
        N/m, and the variance of it.
    damping, variance_of_damping : float
    """

    stiffness: float
    variance: float
    damping: float
    variance_of_damping: float

    @classmethod
    def of(cls, storey: _Storey, cycles: list[_Cycle]) -> _Sound:
        """Of the first cycles, by their precision."""
        amplitudes = np.array([np.ptp(storey.drift[c.rows]) for c in cycles])
        large = np.flatnonzero(amplitudes > SOUND_UP_TO * amplitudes.max())
        first = cycles[: max(int(large[0]), 1)]
        stiffness, variance = _mean_of([(c.line[0], c.covariance[0, 0]) for c in first])
        damping, of_damping = _mean_of([(c.line[1], c.covariance[1, 1]) for c in first])
        return cls(stiffness, variance, damping, of_damping)

    def plastic(self, storey: _Storey, cycle: _Cycle) -> np.ndarray:
        """Equivalent plastic drift of a cycle, m, and its variance."""
        rate, t = storey.rate[cycle.rows], storey.t[cycle.rows]
        peak = float(np.ptp(storey.force[cycle.rows])) / 2
        of_rates = float(np.trapezoid(rate**2, t))
        travel = (cycle.work - self.damping * of_rates) / peak
        variance = cycle.error_of_work**2 + self.variance_of_damping * of_rates**2
        return np.array([travel, variance / peak**2])


def _mean_of(values: list[tuple[float, float]]) -> tuple[float, float]:
    """Mean by precision of values with variances; their scatter is in its variance."""
    value, variance = np.array(values).T
    weights = 1.0 / np.maximum(variance, np.finfo(float).tiny)
    mean = float(weights @ value / weights.sum())
    scatter = float(weights @ (value - mean) ** 2 / weights.sum()) / len(value)
    return mean, max(1.0 / float(weights.sum()), scatter)


def _row(
    storey: _Storey, number: int, cycle: _Cycle, sound: _Sound, plastic: np.ndarray
) -> dict[str, object]:
    """Indicators of a cycle with their intervals."""
    stiffness, _, constant = cycle.line
    k_variance = cycle.covariance[0, 0]
    ratio = stiffness / sound.stiffness
    spread = k_variance / stiffness**2 + sound.variance / sound.stiffness**2
    residual = -constant / stiffness
    gradient = np.array([constant / stiffness**2, 0.0, -1.0 / stiffness])
    values = {
        "stiffness": (stiffness, k_variance),
        "loss": (100 * (1 - ratio), (100 * ratio) ** 2 * spread),
        "energy": (cycle.work, cycle.error_of_work**2),
        "plastic": (plastic[0], plastic[1]),
        "residual": (residual, gradient @ cycle.covariance @ gradient),
    }
    row: dict[str, object] = {
        "storey": storey.name,
        "cycle": number,
        "start": float(storey.t[cycle.rows.start]),
        "end": float(storey.t[cycle.rows.stop - 1]),
        "amplitude": float(np.ptp(storey.drift[cycle.rows])) / 2,
    }
    reach = norm.ppf((1 + LEVEL) / 2)
    for name, (value, variance) in values.items():
        half = reach * float(np.sqrt(variance))
        row |= {
            name: float(value),
            f"{name}_lower": float(value) - half,
            f"{name}_upper": float(value) + half,
        }
    return row


def _total(name: str, cycles: pd.DataFrame) -> dict[str, object]:
    """Indicators of a storey over the whole record."""
    last = cycles.iloc[-1]
    total: dict[str, object] = {"storey": name, "cycles": len(cycles)}
    for indicator in ("stiffness", "loss", "plastic", "residual"):
        for end in ("", "_lower", "_upper"):
            total[indicator + end] = float(last[indicator + end])
    energy = float(cycles["energy"].sum())
    halves = cycles["energy_upper"] - cycles["energy"]
    half = float(np.linalg.norm(halves))
    return total | {
        "energy": energy,
        "energy_lower": energy - half,
        "energy_upper": energy + half,
    }
