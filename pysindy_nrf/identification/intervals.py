"""Confidence intervals: the whole chain is solved again without each piece of the
data.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from ..chain.identifiability import SolveOrder
from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..common import number_of
from ..equations.accumulation import pieces_of
from ..equations.chain_solve import Solution, groups_of, model_of, solve
from ..equations.normal_equations import NormalEquations
from ..exceptions import (
    BiasWarning,
    ChainError,
    ChannelError,
    ExtrapolationWarning,
    IdentifiabilityError,
    RankWarning,
)
from ..records.dataset import Dataset
from .problem import Problem

FEWEST = 8  # pieces
Statistic = Callable[[ChainModel], pd.Series]


def newey_west(
    influences: np.ndarray, record: np.ndarray | None = None, lags: int = 1
) -> np.ndarray:
    r"""Heteroscedasticity and autocorrelation consistent covariance (Newey and West,
    1987).
    """
    u = influences - influences.mean(axis=0)
    total = u.T @ u
    for lag in range(1, min(lags, len(u) - 1) + 1):
        same = (
            np.ones(len(u) - lag)
            if record is None
            else (record[lag:] == record[:-lag]).astype(float)
        )
        cross = (u[lag:] * same[:, None]).T @ u[:-lag]
        total += (1 - lag / (lags + 1)) * (cross + cross.T)
    return total


def parameters_of(
    model: ChainModel, known_masses: Mapping[int, float] | None = None
) -> pd.Series:
    """Masses and coefficients by name: ``m1``, ``storey 1: v``, ..."""
    values = {
        f"m{j + 1}": m
        for j, m in enumerate(model.masses)
        if j + 1 not in (known_masses or {})
    }
    for site, force in model.restoring_forces.items():
        if force.laws:
            values |= {f"{site}: {term}": c for term, c in force.coefficients.items()}
    return pd.Series(values, dtype=float)


def energies_of(layout: LawLayout, data: Dataset) -> Statistic:
    """A function of a model: the energy (J) that every site dissipates along the data,
    ``energy of storey 1``, ...
    """
    sites = [s for s in layout.acting if s.kind == "link"]
    work = {s: np.zeros(layout.counts[s]) for s in sites}
    stored = dict.fromkeys(sites, 0.0)
    for seg in data.segments:
        if seg.dt is None:
            cure = (
                "Pass dt= (s) to the estimator, time= to fit, or X with a time index."
            )
            raise ChannelError("Energies need the sampling step", cure)
        for site in sites:
            motion = seg.motion(site, seg.valid)
            work[site] += np.trapezoid(
                layout.columns(site, motion) * motion.v[:, None], dx=seg.dt, axis=0
            )
            stored[site] += 0.5 * float(motion.s[-1] ** 2 - motion.s[0] ** 2)

    def energies(model: ChainModel) -> pd.Series:
        own, forces = model.coefficients, model.restoring_forces
        lost = {
            f"energy of {s}": (
                own[s] @ work[s] - forces[s].linear_part()["k"] * stored[s]
            )
            for s in sites
        }
        return pd.Series(lost, dtype=float)

    return energies


def statistic_of(
    of: Any,
    known_masses: Mapping[int, float],
    layout: LawLayout,
    data: Dataset | None = None,
) -> Statistic:
    """The function of a model that a user requests."""
    if callable(of):
        return lambda m: pd.Series(of(m), dtype=float)
    if of == "parameters":
        return lambda m: parameters_of(m, known_masses)
    if of in ("masses", "coefficients"):
        return lambda m: parameters_of(m, known_masses)[
            lambda p: p.index.str.contains(":") == (of == "coefficients")
        ]
    if of == "modes":
        names = ("frequency", "damping")  # Hz, and ratio
        return lambda m: pd.Series(
            {f"{k} {i}": x for k in names for i, x in m.modes()[k].items()}, dtype=float
        )
    if of == "energies":
        if data is None:
            raise ChannelError(
                "Energies need the data",
                "Ask for their intervals before saving the model.",
            )
        return energies_of(layout, data)
    raise ChainError(
        f"of={of!r} is unknown",
        "Give 'parameters', 'masses', 'coefficients', 'modes', 'energies', {site: (v,"
        " s)} or a function of a ChainModel.",
    )


@dataclass
class Resolver:
    """Solves the chain again on any choice of pieces; ``constrain`` maps a model to one
    that obeys the constraints.
    """

    pieces: NormalEquations
    solve_order: SolveOrder
    known_masses: Mapping[int, float]
    inner: Any = None
    constrain: Callable[[ChainModel], ChainModel] | None = None
    withheld: str = ""  # why no interval can be given
    # samples that share one error: all of them where no noise is left, only arithmetic
    repeats: float = 1.0

    @property
    def record(self) -> np.ndarray:
        """Number of the record of each piece."""
        assert self.pieces.record is not None
        return self.pieces.record

    def model(self, total: NormalEquations) -> ChainModel:
        """Model of a sum of pieces."""
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            model = model_of(self.pieces.layout, self.solve(total))
        return model if self.constrain is None else self.constrain(model)

    def solve(self, total: NormalEquations) -> Solution:
        """Masses and coefficients of a sum of pieces."""
        return solve(total.projected(), self.solve_order, self.known_masses, self.inner)

    def at(self, weights: np.ndarray) -> ChainModel:
        """Model of the pieces, each taken ``weights`` times."""
        return self.model(self.pieces.sum(weights))

    def influences(self, statistic: Statistic) -> np.ndarray:
        """Influence of each piece on the statistics, shape (n_pieces, n_statistics):
        what they are without it.
        """
        n = len(self.record)
        if n < FEWEST:
            cure = "Use a longer record, or more records."
            raise ChannelError(f"{n} pieces of data are too few for an interval", cure)
        try:
            values = np.array(
                [statistic(self.at(w)).to_numpy(float) for w in 1.0 - np.eye(n)]
            )
        except IdentifiabilityError as error:
            what = f"A single part of the data determines the estimate ({error.what})"
            raise IdentifiabilityError(
                what, "Excite the structure more than once."
            ) from error
        return (values - values.mean(axis=0)) * np.sqrt((n - 1) / n)

    def covariance(self, statistic: Statistic) -> np.ndarray:
        """Covariance of statistics: delete-one-block jackknife, correlated neighbours
        included.
        """
        return newey_west(self.influences(statistic), self.record)


@dataclass
class InfluenceResolver(Resolver):
    """Resolver of an estimate that is the optimum of a free run: every piece moves it
    by its influence.
    """

    best: Any = field(kw_only=True)  # the optimum, and what each piece moves it by
    rebuild: Callable[[np.ndarray], ChainModel] = field(kw_only=True)

    @property
    def record(self) -> np.ndarray:
        """Number of the record of each piece."""
        return self.best.record

    def at(self, weights: np.ndarray) -> ChainModel:
        """Model of the pieces, each taken ``weights`` times."""
        model = self.rebuild(
            self.best.u
            + weights @ (self.best.influences - self.best.influences.mean(axis=0))
        )
        return model if self.constrain is None else self.constrain(model)


def least_squares_resolver(
    problem: Problem, solve_order: SolveOrder, data: Dataset
) -> Resolver:
    """Resolver of a least-squares estimate; one pass over the data."""
    layout, known = problem.layout, dict(problem.known_masses)
    pieces = pieces_of(
        data, layout, groups_of(layout, solve_order), problem.filters(data), known
    )
    return Resolver(pieces, solve_order, known, problem.optimizer)


# Tolerances of a channel where none are given: gain and part of another DOF's channel
# that it reads; delay, s.
CALIBRATION = {"gain": 0.01, "cross_axis": 0.0, "delay": 0.0}


def tolerances_of(
    given: Mapping[str, float] | None, otherwise: Mapping[str, float]
) -> dict[str, float]:
    """Tolerances of channels as given, the rest as known otherwise."""
    tolerances = {**otherwise, **(given or {})}
    if wrong := [
        key
        for key, size in tolerances.items()
        if key not in CALIBRATION or not 0 <= size < np.inf
    ]:
        what = (
            f"calibration[{wrong[0]!r}]={tolerances[wrong[0]]!r} is not a tolerance of"
            " a channel"
        )
        raise ChannelError(
            what, "Give gain and cross_axis as shares, delay in s, none below zero."
        )
    return tolerances


def calibration_spread(
    problem: Problem,
    solve_order: SolveOrder,
    data: Dataset,
    statistic: Statistic,
    given: Mapping[str, float],
) -> np.ndarray:
    """Standard uncertainty of statistics by errors of each channel within tolerances
    (GUM, type B, rectangular).
    """
    tolerances = tolerances_of(given, CALIBRATION)

    def found(kind: str = "", j: int = 0, name: str = "", other: int = 0) -> np.ndarray:
        """Statistics by least squares of motions and forces with an error in one
        channel.
        """
        segments = []
        for seg in data.segments:
            channels = {
                "a": seg.a,
                "v": np.cumsum(seg.v, axis=1),
                "x": np.cumsum(seg.s, axis=1),
                "F": seg.F,
            }
            derived = (
                bool(seg.noise) and f"x{j + 1}" not in seg.noise
            )  # the motion then follows the acceleration
            hit = {
                "": "",
                "F": "F",
                "x": "" if derived else "vx",
                "a": "avx" if derived else "a",
            }[kind]
            changes = {}
            for key in hit:
                y = channels[key].astype(float)
                rate = (
                    np.gradient(y[:, j], seg.step) if name == "delay" else y[:, other]
                )
                changes[key] = tolerances[name] * rate
            segments.append(seg.moved(j + 1, **changes))
        resolver = least_squares_resolver(
            problem, solve_order, Dataset(segments, data.n_samples)
        )
        return statistic(resolver.model(resolver.pieces.sum())).to_numpy(float)

    cases = []
    for kind, j, name in product(
        "axF", range(data.n_dof), (name for name, size in tolerances.items() if size)
    ):
        others = (
            [k for k in range(data.n_dof) if k != j and kind != "F"]
            if name == "cross_axis"
            else [j]
        )
        cases += [
            (kind, j, name, k) for k in others if kind != "F" or j + 1 in data.forced
        ]
    moved = [found(*case) for case in cases]
    return np.sqrt(
        np.sum(np.square(np.array(moved).reshape(len(cases), -1) - found()), axis=0) / 3
    )


def parameter_intervals(
    resolver: Resolver,
    model: ChainModel,
    level: float,
    of: Any = "parameters",
    data: Dataset | None = None,
) -> pd.DataFrame:
    """Confidence intervals of anything that follows from a model."""
    level = _share(level)
    if isinstance(of, Mapping):
        return _forces_table(resolver, model, of, level)
    statistic = statistic_of(of, resolver.known_masses, resolver.pieces.layout, data)
    estimate = statistic(model)
    low, high = _bounds(resolver, statistic, estimate.to_numpy(float), level)
    return pd.DataFrame(
        {
            "parameter": estimate.index,
            "estimate": estimate.to_numpy(),
            "lower": low,
            "upper": high,
        }
    )


def _forces_table(
    resolver: Resolver, model: ChainModel, points: Mapping[Any, Any], level: float
) -> pd.DataFrame:
    parts = []
    for site, pair in points.items():
        if not hasattr(pair, "__len__") or len(pair) != 2:
            raise ChainError(
                f"of[{site!r}]={pair!r} is not a pair (v, s)", "Give m/s and m."
            )
        table = force_intervals(resolver, model, site, pair[0], pair[1], level)
        name = [
            f"{model.chain.site(site)} at v = {v:.4g} m/s, s = {s:.4g} m"
            for v, s in zip(table["v"], table["s"])
        ]
        parts.append(
            table[["force", "lower", "upper"]].rename(columns={"force": "estimate"})
        )
        parts[-1].insert(0, "parameter", name)
    return pd.concat(parts, ignore_index=True)


def force_intervals(
    resolver: Resolver, model: ChainModel, site: Any, v: Any, s: Any, level: float
) -> pd.DataFrame:
    """Restoring force of a site at points (v, s) with its interval."""
    site = model.chain.site(site)
    rate, drift = (
        np.ravel(x).astype(float)
        for x in np.broadcast_arrays(np.asarray(v, float), np.asarray(s, float))
    )

    def statistic(m: ChainModel) -> pd.Series:
        return pd.Series(m.restoring_forces[site](rate, drift))

    force = statistic(model).to_numpy()
    low, high = _bounds(resolver, statistic, force, _share(level))
    region = model.visited.get(site)
    visited = (
        np.ones(len(rate), dtype=bool)
        if region is None
        else region.contains(rate, drift)
    )
    if region is not None and not visited.all():
        near = region.nearest(rate[~visited], drift[~visited])
        reach = np.abs(force[~visited] - model.restoring_forces[site](*near))
        low[~visited] -= reach
        high[~visited] += reach
        warnings.warn(
            f"{site}: {int((~visited).sum())} of {len(visited)} points (v, s) lie"
            f" outside the region the data visited (v {region.low[0]:.3g} to"
            f" {region.high[0]:.3g} m/s, s {region.low[1]:.3g} to {region.high[1]:.3g}"
            " m); the force there is an extrapolation of the law, and its interval is"
            " widened.",
            ExtrapolationWarning,
            stacklevel=3,
        )
    return pd.DataFrame(
        {
            "v": rate,
            "s": drift,
            "force": force,
            "lower": low,
            "upper": high,
            "visited": visited,
        }
    )


def _bounds(
    resolver: Resolver, statistic: Statistic, estimate: np.ndarray, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the intervals of statistics."""
    if resolver.withheld:
        warnings.warn(
            f"Intervals are withheld: {resolver.withheld}", BiasWarning, stacklevel=5
        )
        return np.full(len(estimate), np.nan), np.full(len(estimate), np.nan)
    influences = resolver.influences(statistic)
    # standard errors; correlated neighbours count if they increase them; corrected for
    # the subtracted mean
    n = len(influences)
    own, both = (
        np.diag(newey_west(influences, resolver.record, lags)) for lags in (0, 1)
    )
    deviation = np.sqrt(np.maximum(own, both) * n / (n - 2))
    # degrees of freedom of each variance (Satterthwaite): fewer if few pieces determine
    # the estimate
    fourth = (influences**4).sum(axis=0)
    freedom = np.where(
        fourth > 0,
        3 * (influences**2).sum(axis=0) ** 2 / np.where(fourth > 0, fourth, 1.0),
        np.inf,
    )
    freedom = np.clip(np.minimum(freedom, n - 1) / 1.5, 2.0, None)
    half = np.sqrt(resolver.repeats) * stats.t.ppf(0.5 + level / 2, freedom) * deviation
    return estimate - half, estimate + half


def _share(level: Any) -> float:
    value = number_of(level)
    if not 0 < value < 1:
        raise ChainError(
            f"level={level!r} is not a level of confidence",
            "Give a share between 0 and 1, e.g. 0.95.",
        )
    return value
