"""Parameters that vary with time: moving windows and change points, from Gram matrices of pieces alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from ..common.jackknife import variance
from ..estimation.intervals import Resolver
from ..estimation.problem import Problem
from ..exceptions import ChainError
from ..regression.chain_model import as_segments, storey_names
from ..regression.grams import BlockGrams
from .change import _linear, plain_model, resolver_in_time

_PARTS = 10


def track(
    estimator: Any,
    X: Any,
    F: Any = None,
    *,
    window: float = 2.0,
    step: float = 0.25,
    masses: Any = "fitted",
    **options: Any,
) -> pd.DataFrame:
    """Stiffness and damping of every storey over time.

    The samples are read once into Gram matrices of pieces of ``step`` seconds; every window is a sum of them.

    Parameters
    ----------
    estimator : fitted NRFRegressor
        Usually linear (``degree=1``); fitted to this record or to an earlier test.
    X, F, **options
        One or more records, as for ``fit``.
    window, step : float
        Length of a window and how far it moves, s.
    masses : "fitted", None or mapping of int to float
        Masses held in every window, kg: those of the estimator, none (they are identified in each
        window anew), or given ones.

    Returns
    -------
    DataFrame
        One row for each window: ``record``, ``t`` (its middle, s), ``k1``.. (N/m), ``c1``.. (N s/m).

    Raises
    ------
    ChainError
        If no window fits into a record.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
    >>> from pysindy_nrf.monitoring import track
    >>> damaged = laws.StiffnessStep(t0=4.0, dk=-8e3)  # 20 % of the stiffness is lost after 4 s
    >>> truth = ChainModel([10.0], {1: [laws.PowerSeries(1, [30.0, 4e4]), damaged]})
    >>> F = excitation.band_limited_random(1, 8.0, 500.0, dofs=1, rms=50.0, band=(1, 60), random_state=0)
    >>> X, F = simulate(truth, F, 0.002).to_features(smooth=False)
    >>> table = track(NRFRegressor(degree=1, dt=0.002).fit(X, F), X, F, masses={1: 10.0})
    >>> [int(table.loc[side, "k1"].median().round(-2)) for side in (table["t"] < 2.9, table["t"] > 5.1)]
    [40000, 32000]
    """
    data = as_segments(estimator, X, F, **options)
    resolver, spans = resolver_in_time(_problem(estimator, masses), data, length=step)
    pieces, record = resolver.pieces, resolver.record
    width = max(1, int(round(window / step)))
    names = storey_names(estimator.model_)
    rows = []
    for start in range(len(pieces) - width + 1):
        if record[start] != record[start + width - 1]:
            continue
        linear = _linear(plain_model(resolver, pieces[start : start + width].sum()))
        middle = 0.5 * (spans[start, 0] + spans[start + width - 1, 1])
        rows.append([record[start], middle, *linear[:, 0], *linear[:, 1]])
    if not rows:
        raise ChainError(f"No window of {window:g} s fits into the records", "Use a shorter one.")
    n = len(names)
    columns = ["record", "t", *(f"k{i + 1}" for i in range(n)), *(f"c{i + 1}" for i in range(n))]
    return pd.DataFrame(rows, columns=columns)


@dataclass
class Onset:
    """When and where a structure changed during a record.

    Attributes
    ----------
    time : float
        s from the start of the record; NaN if no significant change was found.
    storey : str or None
        The storey whose stiffness changed most, in standard errors.
    change : float
        Of its stiffness, percent.
    p : float
        Probability of such a change, at any time, if nothing had changed.
    curve : DataFrame
        By candidate time ``t``: ``gain``, the share (percent) of the residual that a change there removes.
    table : DataFrame
        By storey: ``before``, ``after`` (N/m), ``change`` (percent), ``z`` (in standard errors).
    """

    time: float
    storey: str | None
    change: float
    p: float
    curve: pd.DataFrame
    table: pd.DataFrame

    def __str__(self) -> str:
        if self.storey is None:
            return f"No change during the record is significant (p = {self.p:.2g})."
        return (
            f"The stiffness of {self.storey} changed by {self.change:+.2f} % at {self.time:.2f} s (p = {self.p:.1g})."
        )


def find_onset(
    estimator: Any,
    X: Any,
    F: Any = None,
    *,
    step: float = 0.1,
    margin: float = 1.0,
    masses: Any = "fitted",
    level: float = 0.01,
    **options: Any,
) -> Onset:
    """The moment at which a storey's stiffness changed during one record.

    Every boundary of pieces of ``step`` seconds is tried: coefficients before and after it are
    solved separately, and the time is chosen that leaves the least residual over all balances.

    Parameters
    ----------
    estimator : fitted NRFRegressor
        Usually linear.
    X, F, **options
        One record, as for ``fit``.
    step : float
        Resolution, s.
    margin : float
        Least length of a part, s.
    masses
        As for :func:`track`.
    level : float
        Significance level.

    Returns
    -------
    Onset

    Raises
    ------
    ChainError
        If there is more than one record, or it is shorter than two margins.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
    >>> from pysindy_nrf.monitoring import find_onset
    >>> damaged = laws.StiffnessStep(t0=4.0, dk=-8e3)
    >>> truth = ChainModel([10.0], {1: [laws.PowerSeries(1, [30.0, 4e4]), damaged]})
    >>> F = excitation.band_limited_random(1, 8.0, 500.0, dofs=1, rms=50.0, band=(1, 60), random_state=0)
    >>> X, F = simulate(truth, F, 0.002).to_features(smooth=False)
    >>> onset = find_onset(NRFRegressor(degree=1, dt=0.002).fit(X, F), X, F, masses={1: 10.0})
    >>> onset.storey, round(onset.time, 1), round(onset.change)
    ('storey 1', 4.0, -20)
    """
    data = as_segments(estimator, X, F, **options)
    if len(data.segments) > 1:
        raise ChainError("An onset is looked for in one record", "Give the records one by one.")
    resolver, spans = resolver_in_time(_problem(estimator, masses), data, length=step)
    pieces = resolver.pieces
    least = max(1, int(np.ceil(margin / step)))
    candidates = range(least, len(pieces) - least + 1)
    if not candidates:
        raise ChainError(f"The record is too short for two parts of {margin:g} s", "Lower margin.")
    before, after = pieces.running()
    whole = resolver.solve(pieces.sum())
    scale = np.array([fit.residual for fit in whole.fits])
    scale[scale == 0] = 1.0

    def cost(part: BlockGrams) -> float:
        residual = np.array([fit.residual for fit in resolver.solve(part).fits])
        return part.n_samples * float(((residual / scale) ** 2).sum())

    costs = np.array([cost(before[i]) + cost(after[i]) for i in candidates])
    times = np.array([spans[i, 0] for i in candidates])
    best = int(np.argmin(costs))
    index = candidates[best]
    k0, k1 = (_linear(plain_model(resolver, part))[:, 0] for part in (before[index], after[index]))
    z = (k1 - k0) / _scatter(resolver, index)
    names = storey_names(estimator.model_)
    table = pd.DataFrame({"before": k0, "after": k1, "change": 100 * (k1 / k0 - 1), "z": z}, index=names)
    where = int(np.nanargmax(np.abs(z)))  # a free chain has no storey 1
    independent = max(2, int((times[-1] - times[0]) / margin))
    p = float(min(1.0, 2 * special.stdtr(_PARTS - 1, -abs(z[where])) * np.isfinite(z).sum() * independent))
    found = p < level
    curve = pd.DataFrame({"t": times, "gain": 100 * (1 - costs / (pieces.n_samples.sum() * len(scale)))})
    return Onset(
        float(times[best]) if found else float("nan"),
        names[where] if found else None,
        float(table["change"].iloc[where]) if found else float("nan"),
        p,
        curve,
        table,
    )


def _scatter(resolver: Resolver, index: int) -> np.ndarray:
    """Standard error of the change of the stiffnesses, leaving out a tenth of each part at a time."""
    total = np.zeros(())
    for rows in (np.arange(index), np.arange(index, len(resolver.pieces))):
        groups = np.array_split(rows, min(_PARTS, len(rows)))
        values = [
            _linear(plain_model(resolver, resolver.pieces[np.setdiff1d(rows, g)].sum()))[:, 0] for g in groups
        ]
        total = total + variance(values)
    return np.sqrt(total)


def _problem(estimator: Any, masses: Any) -> Problem:
    """The problem that was solved, with these masses known."""
    problem: Problem = estimator.problem_
    if masses is None:
        return problem
    if isinstance(masses, str):
        if masses != "fitted":
            raise ChainError(f"masses={masses!r} is unknown", "Give 'fitted', None, or kg by DOF.")
        masses = {j + 1: float(m) for j, m in enumerate(estimator.masses_)}
    return problem.with_known_masses(masses)
