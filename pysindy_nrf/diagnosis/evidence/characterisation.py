"""What a missing force depends on, found without a formula, by one regression.

Groups of columns (any function of the drift, of the rate, sliders that follow the path,
...) are fitted to some blocks of the force and judged on the others: the share of its
variance that they explain there. Detection and localisation ask the same regression.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.linalg import block_diag

from ...equations.normal_equations import Regression
from ...exceptions import ChannelError
from ...laws.shape import Motion
from ..residual import Filters, filtered
from . import wording
from .basis import GAPS, ROWS, Basis
from .kinds import Dependence, Feature
from .motion_columns import thinning
from .settings import RESIDUAL
from .spectral_line import spectral_line

# Samples of a force at least.
LEAST_SAMPLES = 200
# Bins of the mean of a force over another signal.
BINS = 30
_LINEAR = ["constant", "linear"]


@dataclass(frozen=True, eq=False)
class Characterisation:
    """What a force depends on.

    Attributes
    ----------
    shares : DataFrame
        One row for each dependence, simplest first: "share" (percent of the force's
        squares explained on blocks left out), "low", "high" (about 95 %), "gain"
        (points more than linear terms alone), "chosen".
    dependence : Dependence
        The simplest row that explains nearly as much as the best.
    memory : float
        Percentage points that sliders (memory of the path) add to any function of s
        and v.
    odd : float
        Share of the odd part under (s, v) -> (-s, -v), 0 to 1; NaN where the question
        has no sense.
    frequency : float
        Of the highest spectral line, Hz; NaN if none stands out.
    features : list of Feature
        Marks of the shape.
    curves : dict of str to DataFrame
        Means of the force in bins of "s" and "v".
    covariate : str
        On which the force depends.
    rms : float
        Of the force, N.
    noise : float or None
        Rms of the noise in it, N.
    """

    shares: pd.DataFrame
    dependence: Dependence
    memory: float
    odd: float
    frequency: float
    features: list[Feature]
    curves: dict[str, pd.DataFrame]
    covariate: str = ""
    rms: float = float("nan")
    noise: float | None = None

    @property
    def sentence(self) -> str:
        """The same in words."""
        return wording.characterised(self)


def characterise(
    force: Sequence[np.ndarray],
    motions: Sequence[Motion],
    *,
    filters: Filters | None = None,
    beside: Sequence[np.ndarray] | None = None,
    noise: float | None = None,
) -> Characterisation:
    """Find what a missing force depends on.

    Parameters
    ----------
    force : sequence of ndarray of shape (n_samples,)
        N, one for each record.
    motions : sequence of Motion
    filters : sequence, optional
        Of the records; the force has passed them.
    beside : sequence of ndarray, optional
        Columns of which the force may hold any multiple.
    noise : float, optional
        Rms of the noise in the force, N.

    Returns
    -------
    Characterisation

    Raises
    ------
    ChannelError
        If the force is not finite or too short.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.diagnosis import characterise
    >>> from pysindy_nrf.laws import Motion
    >>> t = np.arange(4000) / 400
    >>> s = np.sin(9 * t) + 0.7 * np.sin(23.1 * t)
    >>> v = 9 * np.cos(9 * t) + 0.7 * 23.1 * np.cos(23.1 * t)
    >>> characterise([20 * np.sign(v)], [Motion(s, v)]).dependence
    <Dependence.RATE: 'v alone'>
    """
    if not all(np.isfinite(line).all() for line in force):
        raise ChannelError(
            "The force to characterise is not finite",
            "A balance above with an unknown force leaves no storey residual.",
        )
    if sum(map(len, force)) < LEAST_SAMPLES:
        raise ChannelError(
            f"The force has fewer than {LEAST_SAMPLES} samples", "Give a longer record."
        )

    if filters is None:
        filters = [None] * len(force)
    regression = _ForceRegression(force, motions, filters, beside)
    table = regression.shares()
    row = _simplest(table)
    table["chosen"] = table.index == row
    covariate = row.partition("covariate ")[2]
    dependence = Dependence.COVARIATE if covariate else Dependence(row)

    odd, joined = regression.odd_share(row), np.concatenate(force)
    drift = np.concatenate([motion.s for motion in motions])
    rate = np.concatenate([motion.v for motion in motions])
    shares = table["share"]
    return Characterisation(
        table[["share", "low", "high", "gain", "chosen"]],
        dependence,
        memory=float(shares[Dependence.PATH.value] - shares[Dependence.SURFACE.value]),
        odd=odd,
        frequency=regression.frequency,
        features=regression.features(dependence, odd),
        curves={
            "s": conditional_mean(drift, joined),
            "v": conditional_mean(rate, joined),
        },
        covariate=covariate,
        rms=float(np.sqrt(np.mean(joined**2))),
        noise=noise,
    )


def _simplest(table: pd.DataFrame) -> str:
    """The simplest row that explains nearly as much as the best."""
    best = table["share"].max()
    if not best >= 100 * RESIDUAL.least_share:
        return Dependence.NOTHING.value
    near = table.index[table["share"] >= best - 100 * RESIDUAL.alike]
    return str(near[0])


class _ForceRegression:
    """The columns and the regression of one characterisation."""

    def __init__(
        self,
        force: Sequence[np.ndarray],
        motions: Sequence[Motion],
        filters: Filters,
        beside: Sequence[np.ndarray] | None,
    ) -> None:
        self.motions = motions
        self.filters = filters
        self.basis = Basis(motions)
        self.unfiltered = [self.basis.groups(motion) for motion in motions]
        groups = self._filtered_groups()
        self.base = list(_LINEAR)
        if beside is not None:
            groups["beside"] = list(beside)
            self.base.append("beside")

        self.frequency = float("nan")
        if "time" in groups:
            self.frequency = self._line(groups, force)
            if np.isfinite(self.frequency):
                groups["line"] = self._waves()

        groups["force"] = list(force)
        every = thinning([motion.s for motion in motions])
        thin = {name: [x[::every] for x in parts] for name, parts in groups.items()}
        self.regression = Regression.of(thin)
        self.rows = self._rows(list(groups))

    def _filtered_groups(self) -> dict[str, list[np.ndarray]]:
        """Groups of columns through the filters of the records."""
        widths = [columns.shape[1] for columns in self.unfiltered[0].values()]
        ends = np.cumsum(widths)[:-1]
        groups: dict[str, list[np.ndarray]] = {name: [] for name in self.unfiltered[0]}
        for columns, filter_ in zip(self.unfiltered, self.filters):
            every = filtered(np.hstack(list(columns.values())), filter_)
            for name, group in zip(groups, np.split(every, ends, axis=1)):
                groups[name].append(group)
        return groups

    def _line(
        self, groups: dict[str, list[np.ndarray]], force: Sequence[np.ndarray]
    ) -> float:
        """Frequency of a line in what linear terms leave of the force, Hz."""
        known = {name: groups[name] for name in self.base}
        fit = Regression.of(known | {"force": list(force)})
        coefficients = fit.coefficients("force", self.base)
        residuals = []
        for i, line in enumerate(force):
            explained = [groups[name][i] @ coefficients[name] for name in self.base]
            residuals.append(line - sum(explained))
        return spectral_line(residuals, self.motions)

    def _waves(self) -> list[np.ndarray]:
        """Sines and cosines of the line, with a phase of its own in every record."""
        waves = []
        for motion, filter_ in zip(self.motions, self.filters):
            angle = 2 * np.pi * self.frequency * np.asarray(motion.t)
            both = np.column_stack([np.cos(angle), np.sin(angle)])
            waves.append(filtered(both, filter_))
        ends = np.cumsum([len(wave) for wave in waves[:-1]])
        return np.split(block_diag(*waves), ends)

    def _rows(self, groups: Sequence[str]) -> dict[str, list[str]]:
        """Groups of columns of each row of the table of shares."""
        rows = {}
        for row, names in ROWS.items():
            if row == Dependence.CONSTANT.value:
                rows[row] = ["constant"]
            elif row == Dependence.COVARIATE.value:
                for name in groups:
                    if name.startswith("covariate "):
                        rows[name] = [*self.base, name]
            elif set(names) <= set(groups):
                rows[row] = [*self.base, *names]
        return rows

    def shares(self) -> pd.DataFrame:
        """What each dependence explains of the force on blocks left out, percent."""
        rows = {}
        for name, groups in self.rows.items():
            rows[name] = self.regression.share("force", groups)
        table = pd.DataFrame.from_dict(rows, orient="index", columns=["share", "error"])
        table *= 100
        table["low"] = table["share"] - 2 * table["error"]
        table["high"] = table["share"] + 2 * table["error"]
        linear = table.loc[Dependence.LINEAR.value, "share"]
        table["gain"] = table["share"] - max(linear, 0.0)
        return table

    def odd_share(self, row: str) -> float:
        """Odd share of the fitted function of one row.

        Along the motion and its mirror image, as the filter shows them: it may hide a
        constant, whose coefficient is then anything.
        """
        names = [n for n in self.rows.get(row, []) if n not in ("constant", "beside")]
        if len(names) < 2 or "line" in names:
            return float("nan")

        coefficients = self.regression.coefficients("force", self.rows[row])
        odd, even = 0.0, 0.0
        for i, (motion, filter_) in enumerate(zip(self.motions, self.filters)):
            mirrored = self.basis.groups(_mirror_image(motion))
            plus, minus = (
                filtered(sum(g[n] @ coefficients[n] for n in names), filter_)
                for g in (self.unfiltered[i], mirrored)
            )
            odd += len(plus) * float(np.var(plus - minus))
            even += len(plus) * float(np.var(plus + minus))
        return odd / (odd + even) if odd + even > 0 else float("nan")

    def features(self, dependence: Dependence, odd: float) -> list[Feature]:
        """Marks of the shape of a function of the rate or of the drift."""
        if dependence == Dependence.RATE:
            jump = self._further_share(["jump"], [*self.base, "rate powers"])
            return [Feature.JUMP] if jump > RESIDUAL.least_share else []
        if dependence != Dependence.DRIFT:
            return []

        # straight lines with a gap that explain more than a smooth curve are a kink
        smooth = self._further_share(["powers"], self.base)
        gaps = [self._further_share([f"gap {k}"], self.base) for k in range(len(GAPS))]
        if max(gaps) > smooth + RESIDUAL.least_share * (1 - smooth):
            return [Feature.KINK]
        if odd < RESIDUAL.mostly_odd:
            return []
        return [Feature.HARDENING if self._bends_outwards() else Feature.SOFTENING]

    def _further_share(self, groups: list[str], beside: list[str]) -> float:
        """Share of the force that groups explain beside others."""
        return self.regression.share("force", groups, beside)[0]

    def _bends_outwards(self) -> bool:
        """Whether the odd part of the fitted powers grows faster than the drift.

        Less its regression on the drift it then goes with its cube.
        """
        drifts = np.concatenate([motion.s for motion in self.motions])
        x = drifts / self.basis.drift
        names = [*self.base, "powers"]
        powers = self.regression.coefficients("force", names)["powers"]
        curve = powers[1] * x**3 + powers[3] * x**5
        bend = (curve - x @ curve / (x @ x) * x) @ (x**3)
        return bool(bend > 0)


def _mirror_image(motion: Motion) -> Motion:
    """The motion in the other direction."""
    acceleration = None if motion.a is None else -motion.a
    return Motion(-motion.s, -motion.v, acceleration, motion.t, motion.covariates)


def conditional_mean(x: np.ndarray, force: np.ndarray) -> pd.DataFrame:
    """Mean of a force in bins of equal count of another signal.

    Returns
    -------
    DataFrame
        ``centre`` (of the signal), ``mean`` (N), ``error`` (of it), ``count``.
    """
    order = np.argsort(x, kind="stable")
    edges = np.linspace(0, len(x), min(BINS, len(x)) + 1).astype(int)
    count = np.diff(edges)

    def mean_of(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values[order], edges[:-1]) / count

    mean = mean_of(force)
    scatter = np.maximum(mean_of(force**2) - mean**2, 0.0)
    columns = {
        "centre": mean_of(x),
        "mean": mean,
        "error": np.sqrt(scatter / count),
        "count": count,
    }
    return pd.DataFrame(columns)
