"""Confidence intervals: the chain is solved again without each piece of the data."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Protocol

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from ..chain.identifiability import SolveOrder
from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..chain.model import parameters_of as parameters_of
from ..chain.sites import Site
from ..common import number_of
from ..common.unit_system import UnitSystem
from ..common.warn import warn_user
from ..equations.accumulation import pieces_of
from ..equations.chain_solve import (
    NotTogether,
    Solution,
    groups_of,
    model_of,
    solve,
)
from ..equations.inner_optimizer import Optimizer
from ..equations.normal_equations import NormalEquations
from ..exceptions import (
    BiasWarning,
    ChainError,
    ChannelError,
    ExtrapolationWarning,
    IdentifiabilityError,
    RankWarning,
)
from ..laws.base import ForceLaw
from ..records.dataset import Dataset, Segment

if TYPE_CHECKING:
    from .problem import Problem

# Pieces of data, below which their scatter is no standard error.
MIN_PIECES = 8
# Kurtosis of Gaussian influences; it makes the degrees of freedom those of all pieces.
_GAUSSIAN_KURTOSIS = 3.0
# The variance of neighbouring pieces together has fewer degrees of freedom than that of
# single ones, by this factor.
_FREEDOM_OF_NEIGHBOURS = 1.5

Statistic = Callable[[ChainModel], pd.Series]
# Points (v, s) of sites, m/s and m.
Points = (
    Mapping[str, tuple[ArrayLike, ArrayLike]]
    | Mapping[int, tuple[ArrayLike, ArrayLike]]
)
# What intervals are asked for: a name, a function of a model, or points.
AskedFor = str | Callable[[ChainModel], pd.Series | Mapping[str, float]] | Points


# -- statistics of a model -----------------------------------------------------------


def energies_of(layout: LawLayout, data: Dataset) -> Statistic:
    """Energy that every site dissipates along the data, J, as a function of a model."""
    sites = [site for site in layout.acting if site.kind == "link"]
    for segment in data.segments:
        if segment.dt is None:
            raise ChannelError(
                "Energies need the sampling step",
                "Pass dt= (s) to the estimator, time= to fit, or X with a time index.",
            )
    work = {site: _work_of(layout, site, data) for site in sites}
    stored = dict.fromkeys(sites, 0.0)
    for segment, site in product(data.segments, sites):
        drift = segment.motion(site, segment.valid).s
        stored[site] += 0.5 * float(drift[-1] ** 2 - drift[0] ** 2)

    def energies(model: ChainModel) -> pd.Series:
        coefficients = model.coefficients
        forces = model.restoring_forces
        lost = {}
        for site in sites:
            of_site = work[site]
            if _shapes_of(model.laws[site]) != _shapes_of(layout.laws[site]):
                of_site = _work_of(LawLayout(model.chain, model.laws), site, data)
            elastic = forces[site].linear_part()["k"] * stored[site]
            lost[f"energy of {site}"] = coefficients[site] @ of_site - elastic
        return pd.Series(lost, dtype=float)

    return energies


def _work_of(layout: LawLayout, site: Site, data: Dataset) -> np.ndarray:
    """Work of each term of a site along the data with a coefficient of one."""
    work = np.zeros(layout.counts[site])
    for segment in data.segments:
        motion = segment.motion(site, segment.valid)
        power = layout.columns(site, motion) * motion.v[:, None]
        work += np.trapezoid(power, dx=segment.step, axis=0)
    return work


def _shapes_of(laws: Sequence[ForceLaw]) -> list[dict[str, float | None]]:
    return [law.shape for law in laws]


def _modes_of(model: ChainModel) -> pd.Series:
    """Frequencies, Hz, and damping ratios by name."""
    modes = model.modes()
    values = {}
    for name in ("frequency", "damping"):
        for number, value in modes[name].items():
            values[f"{name} {number}"] = value
    return pd.Series(values, dtype=float)


def forces_at(points: Points, model: ChainModel) -> pd.Series:
    """Forces of sites at points (v, s), N, by name."""
    forces: dict[str, float] = {}
    for site, pair in points.items():
        place = model.chain.site(site)
        v, s = np.broadcast_arrays(*(np.asarray(x, float) for x in pair))
        force = model.restoring_forces[place](v.ravel(), s.ravel())
        names = names_of_points(place, v.ravel(), s.ravel(), model.units)
        forces |= dict(zip(names, force.tolist(), strict=True))
    return pd.Series(forces)


def names_of_points(
    site: Site, v: np.ndarray, s: np.ndarray, units: UnitSystem
) -> list[str]:
    """Names of the forces of a site at points (v, s)."""
    names = []
    for rate, drift in zip(v, s):
        point = f"v = {rate:.4g} {units.of('m/s')}, s = {drift:.4g} {units.length}"
        names.append(f"{site} at {point}")
    return names


def statistic_of(
    of: AskedFor,
    known_masses: Mapping[int, float],
    layout: LawLayout,
    data: Dataset | None = None,
) -> Statistic:
    """The function of a model whose intervals a user asks for."""

    def some_parameters(model: ChainModel) -> pd.Series:
        values = parameters_of(model, known_masses)
        has_site = values.index.str.contains(":")
        return values[has_site == (of == "coefficients")]

    if isinstance(of, Mapping):
        return lambda model: forces_at(of, model)
    if callable(of):
        return lambda model: pd.Series(of(model), dtype=float)
    if of == "parameters":
        return lambda model: parameters_of(model, known_masses)
    if of in ("masses", "coefficients"):
        return some_parameters
    if of == "modes":
        return _modes_of
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


# -- estimates from pieces of the data -----------------------------------------------


@dataclass(frozen=True)
class Resolver:
    """Solves the chain again on any choice of pieces of the data.

    Parameters
    ----------
    pieces : NormalEquations
        Sums of consecutive pieces.
    solve_order : SolveOrder
    known_masses : mapping of int to float
        kg, by DOF.
    inner : PySINDy optimizer, optional
        Solves the balances.
    constrain : callable, optional
        Turns a model into one that obeys what is known of the parameters.
    """

    pieces: NormalEquations
    solve_order: SolveOrder
    known_masses: Mapping[int, float]
    inner: Optimizer | None = None
    constrain: Callable[[ChainModel], ChainModel] | None = None

    @property
    def layout(self) -> LawLayout:
        """Columns of the laws."""
        layout = self.pieces.layout
        assert isinstance(layout, LawLayout)
        return layout

    @property
    def record(self) -> np.ndarray:
        """Number of the record of each piece."""
        assert self.pieces.record is not None
        return self.pieces.record

    def without_constraints(self) -> Resolver:
        """The same without what is known of the parameters."""
        return replace(self, constrain=None)

    def solve(self, total: NormalEquations) -> Solution:
        """Masses and coefficients of a sum of pieces."""
        return solve(total.projected(), self.solve_order, self.known_masses, self.inner)

    def solutions(self, every_weights: np.ndarray) -> list[Solution]:
        """Solutions of the pieces, one for each row of weights (n, n_pieces)."""
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            try:
                together = self.solve(self.pieces.sum(every_weights))
            except NotTogether:
                return [self.solve(self.pieces.sum(row)) for row in every_weights]
        return [together.of(number) for number in range(len(every_weights))]

    def model_from(self, solution: Solution) -> ChainModel:
        """Model of a solution, whatever is known of its parameters."""
        return model_of(self.layout, solution)

    def model(self, total: NormalEquations) -> ChainModel:
        """Model of a sum of pieces."""
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            return self._constrained(self.model_from(self.solve(total)))

    def _constrained(self, model: ChainModel) -> ChainModel:
        """A model that obeys what is known of the parameters."""
        return model if self.constrain is None else self.constrain(model)

    def weighted_model(self, weights: np.ndarray) -> ChainModel:
        """Model of the pieces, each taken ``weights`` times."""
        return self.model(self.pieces.sum(weights))

    def weighted_models(self, every_weights: np.ndarray) -> list[ChainModel]:
        """Models of the pieces, one for each row of weights (n, n_pieces)."""
        solutions = self.solutions(every_weights)
        return [self._constrained(self.model_from(each)) for each in solutions]

    def influences(self, statistic: Statistic, removed: float = 1.0) -> np.ndarray:
        """Influence of each piece, shape (n_pieces, n_statistics).

        It is what the statistics are without the piece, less their mean.

        Parameters
        ----------
        statistic : callable
        removed : float
            Share of each piece that is left out; of less than one the influence is
            extrapolated.

        Raises
        ------
        ChannelError
            If there are too few pieces.
        IdentifiabilityError
            If one piece alone determines the estimate.
        """
        n_pieces = len(self.record)
        if n_pieces < MIN_PIECES:
            raise ChannelError(
                f"{n_pieces} pieces of data are too few for an interval",
                "Use a longer record, or more records.",
            )
        try:
            if removed == 1.0:
                models = self.models_without_pieces
            else:
                models = self._models_without(removed)
        except IdentifiabilityError as error:
            raise IdentifiabilityError(
                f"A single part of the data determines the estimate ({error.what})",
                "Excite the structure more than once.",
            ) from error

        values = np.array([statistic(model).to_numpy(float) for model in models])
        scale = np.sqrt((n_pieces - 1) / n_pieces) / removed
        return (values - values.mean(axis=0)) * scale

    @cached_property
    def models_without_pieces(self) -> list[ChainModel]:
        """Models of the data without one piece each."""
        return self._models_without(1.0)

    def _models_without(self, removed: float) -> list[ChainModel]:
        """Models of the data without a share of one piece each."""
        return self.weighted_models(1.0 - removed * np.eye(len(self.record)))

    def covariance(self, statistic: Statistic) -> np.ndarray:
        """Covariance of statistics: delete-one-block jackknife with neighbours."""
        return newey_west(self.influences(statistic), self.record)


class Optimum(Protocol):
    """The optimum of a free run, and what moves it."""

    @property
    def u(self) -> np.ndarray:
        """Vector of parameters."""

    @property
    def influences(self) -> np.ndarray:
        """Influence of each piece, (n_pieces, n_parameters)."""

    @property
    def record(self) -> np.ndarray:
        """Number of the record of each piece."""


@dataclass(frozen=True)
class InfluenceResolver(Resolver):
    """Resolver of an estimate whose pieces move it by known influences.

    Parameters
    ----------
    best : Optimum
    rebuild : callable
        Makes a model of a vector of parameters.
    """

    best: Optimum = field(kw_only=True)
    rebuild: Callable[[np.ndarray], ChainModel] = field(kw_only=True)

    @property
    def record(self) -> np.ndarray:
        """Number of the record of each piece."""
        return self.best.record

    def weighted_model(self, weights: np.ndarray) -> ChainModel:
        """Model of the pieces, each taken ``weights`` times."""
        influences = self.best.influences - self.best.influences.mean(axis=0)
        return self._constrained(self.rebuild(self.best.u + weights @ influences))

    def weighted_models(self, every_weights: np.ndarray) -> list[ChainModel]:
        """Models of the pieces, one for each row of weights (n, n_pieces)."""
        return [self.weighted_model(weights) for weights in every_weights]


def least_squares_resolver(
    problem: Problem, solve_order: SolveOrder, data: Dataset
) -> Resolver:
    """Resolver of a least-squares estimate; one pass over the data."""
    layout = problem.layout
    known_masses = dict(problem.known_masses)
    groups = groups_of(layout, solve_order)
    pieces = pieces_of(data, layout, groups, problem.filters(data), known_masses)
    return Resolver(pieces, solve_order, known_masses, problem.optimizer)


def newey_west(
    influences: np.ndarray, record: np.ndarray | None = None, lags: int = 1
) -> np.ndarray:
    """Covariance that is consistent where neighbours are correlated.

    Newey and West (1987); pieces of different records are independent.
    """
    u = influences - influences.mean(axis=0)
    total = u.T @ u
    for lag in range(1, min(lags, len(u) - 1) + 1):
        same_record = np.ones(len(u) - lag)
        if record is not None:
            same_record = (record[lag:] == record[:-lag]).astype(float)
        cross = (u[lag:] * same_record[:, None]).T @ u[:-lag]
        total += (1 - lag / (lags + 1)) * (cross + cross.T)
    return total


# -- intervals -----------------------------------------------------------------------


@dataclass(frozen=True)
class IntervalMaker:
    """What the intervals of one estimate are made from.

    Parameters
    ----------
    resolver : Resolver
    model : ChainModel
        The estimate.
    withheld : str
        Why no interval can be given; empty if it can.
    repeats : float
        Samples that share one error: all of them where no noise is left, but only
        arithmetic, which no further sample averages out.
    """

    resolver: Resolver
    model: ChainModel
    withheld: str = ""
    repeats: float = 1.0

    def parameters(
        self, of: AskedFor, level: float, data: Dataset | None = None
    ) -> pd.DataFrame:
        """Intervals of anything that follows from a model.

        Returns
        -------
        DataFrame
            Columns ``parameter``, ``estimate``, ``lower``, ``upper``.
        """
        level = _checked_level(level)
        if isinstance(of, Mapping):
            return self._of_points(of, level)
        known_masses = self.resolver.known_masses
        layout = self.resolver.layout
        statistic = statistic_of(of, known_masses, layout, data)
        estimate = statistic(self.model)
        lower, upper = self._bounds(statistic, estimate.to_numpy(float), level)
        columns = {
            "parameter": estimate.index,
            "estimate": estimate.to_numpy(),
            "lower": lower,
            "upper": upper,
        }
        return pd.DataFrame(columns)

    def _of_points(self, points: Points, level: float) -> pd.DataFrame:
        """Intervals of forces at points (v, s) of some sites."""
        tables = []
        for site, pair in points.items():
            if not hasattr(pair, "__len__") or len(pair) != 2:
                raise ChainError(
                    f"of[{site!r}]={pair!r} is not a pair (v, s)", "Give m/s and m."
                )
            forces = self.forces(site, pair[0], pair[1], level)
            place = self.model.chain.site(site)
            table = forces[["force", "lower", "upper"]]
            table = table.rename(columns={"force": "estimate"})
            units = self.model.units
            rates, drifts = forces["v"].to_numpy(), forces["s"].to_numpy()
            table.insert(0, "parameter", names_of_points(place, rates, drifts, units))
            tables.append(table)
        return pd.concat(tables, ignore_index=True)

    def forces(
        self, site: str | int, v: ArrayLike, s: ArrayLike, level: float
    ) -> pd.DataFrame:
        """Force of a site at points (v, s) with its interval.

        Outside the region that the data visited the interval is widened, with an
        ExtrapolationWarning.

        Returns
        -------
        DataFrame
            Columns ``v``, ``s``, ``force``, ``lower``, ``upper``, ``visited``.
        """
        place = self.model.chain.site(site)
        points = np.broadcast_arrays(np.asarray(v, float), np.asarray(s, float))
        rate, drift = (np.ravel(x).astype(float) for x in points)

        def statistic(model: ChainModel) -> pd.Series:
            return pd.Series(model.restoring_forces[place](rate, drift))

        force = statistic(self.model).to_numpy()
        lower, upper = self._bounds(statistic, force, _checked_level(level))
        visited, reach = self._extrapolation(place, rate, drift, force)
        columns = {
            "v": rate,
            "s": drift,
            "force": force,
            "lower": lower - reach,
            "upper": upper + reach,
            "visited": visited,
        }
        return pd.DataFrame(columns)

    def _extrapolation(
        self, site: Site, rate: np.ndarray, drift: np.ndarray, force: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which points the data visited, and how the force changes up to the others."""
        visited = np.ones(len(rate), dtype=bool)
        reach = np.zeros(len(rate))
        region = self.model.visited.get(site)
        if region is None:
            return visited, reach

        visited = region.contains(rate, drift)
        if visited.all():
            return visited, reach

        nearest = region.nearest(rate[~visited], drift[~visited])
        at_the_edge = self.model.restoring_forces[site](*nearest)
        reach[~visited] = np.abs(force[~visited] - at_the_edge)
        units = self.model.units
        warn_user(
            f"{site}: {int((~visited).sum())} of {len(visited)} points (v, s) lie"
            f" outside the region the data visited (v {region.low[0]:.3g} to"
            f" {region.high[0]:.3g} {units.of('m/s')}, s {region.low[1]:.3g} to"
            f" {region.high[1]:.3g} {units.length}); the force there is an"
            " extrapolation of the law, and its interval is widened.",
            ExtrapolationWarning,
        )
        return visited, reach

    def _bounds(
        self, statistic: Statistic, estimate: np.ndarray, level: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the intervals of statistics."""
        if self.withheld:
            warn_user(f"Intervals are withheld: {self.withheld}", BiasWarning)
            unknown = np.full(len(estimate), np.nan)
            return unknown, unknown.copy()

        influences = self._influences(statistic)
        quantile = stats.t.ppf(0.5 + level / 2, _degrees_of_freedom(influences))
        error = np.sqrt(self.repeats) * self._standard_errors(influences)
        return estimate - quantile * error, estimate + quantile * error

    def _influences(self, statistic: Statistic) -> np.ndarray:
        """Influences of the pieces; of their halves where one blow is all there is.

        The rest then hides most of the error that the blow makes, unless there is none
        but of arithmetic.
        """
        try:
            return self.resolver.influences(statistic)
        except IdentifiabilityError:
            if self.repeats == 1.0:
                raise
            return self.resolver.influences(statistic, removed=0.5)

    def standard_errors(self) -> dict[str, float]:
        """Standard errors of masses and coefficients by noise, by parameter."""
        resolver = self.resolver
        statistic = statistic_of("parameters", resolver.known_masses, resolver.layout)
        names = statistic(self.model).index
        errors = self._standard_errors(self._influences(statistic))
        return dict(zip(map(str, names), np.sqrt(self.repeats) * errors))

    def _standard_errors(self, influences: np.ndarray) -> np.ndarray:
        """Standard errors; correlated neighbours count if they increase them."""
        record = self.resolver.record
        n = len(influences)
        alone = np.diag(newey_west(influences, record, lags=0))
        with_neighbours = np.diag(newey_west(influences, record, lags=1))
        # corrected for the mean that was subtracted
        return np.sqrt(np.maximum(alone, with_neighbours) * n / (n - 2))


def _degrees_of_freedom(influences: np.ndarray) -> np.ndarray:
    """Degrees of freedom of each variance (Satterthwaite).

    They are fewer if few pieces determine the estimate.
    """
    second = (influences**2).sum(axis=0)
    fourth = (influences**4).sum(axis=0)
    moves = fourth > 0
    ratio = _GAUSSIAN_KURTOSIS * second**2 / np.where(moves, fourth, 1.0)
    freedom = np.minimum(np.where(moves, ratio, np.inf), len(influences) - 1)
    return np.clip(freedom / _FREEDOM_OF_NEIGHBOURS, 2.0, None)


def _checked_level(level: object) -> float:
    value = number_of(level)
    if not 0 < value < 1:
        raise ChainError(
            f"level={level!r} is not a level of confidence",
            "Give a share between 0 and 1, e.g. 0.95.",
        )
    return value


# -- calibration of the channels -----------------------------------------------------

# Tolerances of a channel where none are given: its gain and the part of another DOF's
# channel that it reads, as shares, and its delay, s.
CALIBRATION = {"gain": 0.01, "cross_axis": 0.0, "delay": 0.0}


def tolerances_of(
    stated: Mapping[str, float] | None, otherwise: Mapping[str, float]
) -> dict[str, float]:
    """Tolerances of channels as stated, the rest as known otherwise."""
    tolerances = {**otherwise, **(stated or {})}
    for name, size in tolerances.items():
        if name not in CALIBRATION or not 0 <= size < np.inf:
            raise ChannelError(
                f"calibration[{name!r}]={size!r} is not a tolerance of a channel",
                "Give gain and cross_axis as shares, delay in s, none below zero.",
            )
    return tolerances


@dataclass(frozen=True)
class _CalibrationError:
    """An error of one channel: a gain, a delay, or a part of another DOF's channel.

    ``kind`` is ``"a"``, ``"x"`` or ``"F"``; DOFs count from zero.
    """

    kind: str
    dof: int
    tolerance: str
    size: float
    read_dof: int

    def applied_to(self, segment: Segment) -> Segment:
        """The segment as it would be with the error."""
        channels = {
            "a": segment.a,
            "v": np.cumsum(segment.v, axis=1),
            "x": np.cumsum(segment.s, axis=1),
            "F": segment.F,
        }
        changes = {}
        for key in self._moved_channels(segment):
            values = channels[key].astype(float)
            if self.tolerance == "delay":
                change = np.gradient(values[:, self.dof], segment.step)
            else:
                change = values[:, self.read_dof]
            changes[key] = self.size * change
        return segment.moved(self.dof + 1, **changes)

    def _moved_channels(self, segment: Segment) -> str:
        """The channels of the fused motion that follow the one with the error."""
        follows_acceleration = (
            bool(segment.noise) and f"x{self.dof + 1}" not in segment.noise
        )
        if self.kind == "F":
            return "F"
        if self.kind == "x":
            return "" if follows_acceleration else "vx"
        return "avx" if follows_acceleration else "a"


def _calibration_errors(
    data: Dataset, tolerances: Mapping[str, float]
) -> Iterator[_CalibrationError]:
    """Every error that the tolerances allow, at its limit."""
    dofs = range(data.n_dof)
    forced = data.forced
    for kind, dof, (name, size) in product("axF", dofs, tolerances.items()):
        if not size or (kind == "F" and dof + 1 not in forced):
            continue
        if name != "cross_axis":
            yield _CalibrationError(kind, dof, name, size, dof)
        elif kind != "F":
            for other in dofs:
                if other != dof:
                    yield _CalibrationError(kind, dof, name, size, other)


def calibration_spread(
    problem: Problem,
    solve_order: SolveOrder,
    data: Dataset,
    statistic: Statistic,
    calibration: Mapping[str, float],
) -> np.ndarray:
    """Standard uncertainty of statistics by errors of each channel within tolerances.

    Type B of the GUM, with rectangular distributions.
    """
    tolerances = tolerances_of(calibration, CALIBRATION)

    def estimate(segments: Sequence[Segment]) -> np.ndarray:
        changed = Dataset(segments, data.n_samples)
        resolver = least_squares_resolver(problem, solve_order, changed)
        model = resolver.model(resolver.pieces.sum())
        return statistic(model).to_numpy(float)

    nominal = estimate(data.segments)
    variance = np.zeros_like(nominal)
    for error in _calibration_errors(data, tolerances):
        moved = estimate([error.applied_to(segment) for segment in data.segments])
        variance += (moved - nominal) ** 2 / 3.0
    return np.sqrt(variance)
