"""Alternatives that the data allow besides a model: could the test have failed?

Where fewer modes are excited than there are unknown floors, the equations of motion
close whatever the structure is. Alternatives that a test engineer would think of are
therefore added to the model, one at a time. They are a spring and a dashpot from a
floor to the ground or to the next floor but one, dashpots from all floors to the
ground, and another gain of all sensors of a floor. An alternative that moves a mass or
a stiffness by more than its interval says is a limit of the test, or an effect that the
model lacks.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter

import numpy as np
import pandas as pd
from scipy.stats import norm

from ..chain.model import ChainModel
from ..diagnosis.facts import Alternative, Move
from ..diagnosis.force_delays import delays_of
from ..diagnosis.open_alternatives import MUCH_WIDER
from ..equations.errors import balance_sizes
from ..exceptions import NRFError, NRFWarning
from ..laws.base import ForceLaw
from ..laws.elastic import LinearElastic, LinearViscous
from ..laws.sensor import shifted
from ..records.dataset import Dataset, Segment
from .intervals import (
    Resolver,
    Statistic,
    least_squares_resolver,
    newey_west,
    parameters_of,
)
from .problem import Problem
from .residual_along_runs import free_of_noise

# Step of a change of the data for derivatives, as a share of the channel that changes;
# estimates are linear in it.
_STEP = 0.02
# Share of that step where the estimate bends within it.
_FINER = 0.1
# Pieces of the data whose scatter gives standard errors here, a quarter of those of an
# interval: the standard error then has a scatter of 18 %, which decides nothing.
_N_PIECES = 16
# Share of the squared residual that a change of a channel by a tenth must make. What
# the data feel less is an exact invariance: there the calibration is an assumption.
_FELT = 0.05
# The change of a channel for that, in steps.
_TENTH = 5
# Samples of all records together. Ten storeys are compared in seconds, and an
# alternative that so many samples do not exclude is not excluded by the modes either.
MAX_SAMPLES = 10_000
_QUANTILE = float(norm.ppf(0.975))

Laws = Mapping[str, tuple[ForceLaw, ...]]


def alternatives_of(
    problem: Problem, data: Dataset, identified: ChainModel | None = None
) -> tuple[Alternative, ...]:
    """What else the data allow besides a model.

    Parameters
    ----------
    problem : Problem
        All shape parameters have values.
    data : Dataset
    identified : ChainModel, optional
        The model that instruments identified. The alternatives then are, too: by least
        squares of its free run, with the residuals of the measured motion. Without it
        they are estimated by least squares of the measured motion.

    Returns
    -------
    tuple of Alternative
        The one that leaves least first. Empty for one DOF, where a gain of its sensors
        cannot be separated from masses and forces.
    """
    if problem.chain.n_dof == 1:
        return ()
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        stretches = _strongest_stretches(data)
        if identified is not None:
            stretches = free_of_noise(identified, stretches)
        # free of noise, floors without a force hold their residuals as one
        comparison = _Comparison(problem, stretches, data.forced)
        alternatives = [
            *_other_structures(comparison),
            *_dashpots_to_the_ground(comparison),
            *_other_channels(comparison),
            *_late_forces(comparison),
        ]
    return tuple(sorted(alternatives, key=attrgetter("residual_share")))


def _strongest_stretches(data: Dataset) -> Dataset:
    """The records, each cut to its share of ``MAX_SAMPLES``."""
    share = MAX_SAMPLES / sum(segment.n_valid for segment in data.segments)
    if share >= 1:
        return data
    segments = []
    for segment in data.segments:
        size = max(1, int(share * segment.n_valid))
        first = segment.valid.start + segment.strongest(slice(0, segment.n_valid), size)
        segments.append(segment.cut(slice(first, first + size), 0))
    return replace(data, segments=segments)


@dataclass(frozen=True)
class _Measure:
    """Numbers by which a model and an alternative are compared.

    Attributes
    ----------
    numbers : callable
        Gives the numbers of a model.
    watched : Index
        Names of those that an alternative must not move.
    half_widths : ndarray of shape (n_numbers,)
        Of the 95 % intervals in the model itself.
    """

    numbers: Statistic
    watched: pd.Index
    half_widths: np.ndarray


@dataclass(frozen=True)
class _Solved:
    """A model that was solved from data, and the sums of their pieces.

    Attributes
    ----------
    model : ChainModel
    resolver : Resolver
        Solves the model again on some pieces.
    """

    model: ChainModel
    resolver: Resolver

    @cached_property
    def squares(self) -> np.ndarray:
        """Squared residuals, N^2, (n_pieces, n_dof); zero of an unknown equation."""
        model, pieces = self.model, self.resolver.pieces
        masses = dict(enumerate(model.masses, start=1))
        squares = np.zeros((*pieces.shape, model.n_dof))
        for dof in masses:
            sizes = balance_sizes(dof, masses, model.coefficients, pieces)
            if sizes is not None:
                squares[:, dof - 1] = sizes.residual**2 * sizes.n_samples
        return squares


def _solved(problem: Problem, data: Dataset, forced: tuple[int, ...]) -> _Solved:
    """The model of a problem by least squares; ``forced`` are the driven DOFs."""
    order = problem.solve_order(forced, data.unknown)
    resolver = _of_few_pieces(least_squares_resolver(problem, order, data))
    return _Solved(resolver.model(resolver.pieces.sum()), resolver)


@dataclass(frozen=True)
class _Comparison:
    """What alternatives are compared with.

    ``forced`` are the DOFs that a force drives.
    """

    problem: Problem
    data: Dataset
    forced: tuple[int, ...]

    @cached_property
    def solved(self) -> _Solved:
        """The model without an alternative."""
        return self.solve(self.problem, self.data)

    @property
    def model(self) -> ChainModel:
        """The model without an alternative."""
        return self.solved.model

    @property
    def squares(self) -> np.ndarray:
        """Squared residuals of the model by piece and equation, N^2."""
        return self.solved.squares

    def solve(self, problem: Problem, data: Dataset) -> _Solved:
        """A model with other laws, or from changed channels."""
        return _solved(problem, data, self.forced)

    @cached_property
    def weights(self) -> np.ndarray:
        """Weight of each equation of motion: one over its mean squared residual."""
        return 1.0 / np.maximum(self.squares.sum(axis=0), np.finfo(float).tiny)

    def parameters(self, model: ChainModel) -> pd.Series:
        """Masses and coefficients of a model that has those of the problem at least."""
        return parameters_of(model, self.problem.known_masses)[self.names]

    @cached_property
    def names(self) -> pd.Index:
        """Names of the masses and coefficients that are identified."""
        return parameters_of(self.model, self.problem.known_masses).index

    @cached_property
    def masses_and_stiffnesses(self) -> pd.Index:
        """Names of the masses and stiffnesses that are identified."""
        return masses_and_stiffnesses(self.names)

    def measure(self, numbers: Statistic, watched: pd.Index) -> _Measure:
        """Some numbers, with their half-widths in the model itself."""
        return _Measure(numbers, watched, _half_widths(self.solved.resolver, numbers))

    def with_laws(self, description: str, more: Laws, measure: _Measure) -> Alternative:
        """The alternative that has some more laws."""
        solved = self.solve(self.problem.with_laws(more), self.data)
        here = measure.numbers(self.model)
        numbers_beside = _Numbers(
            here,
            measure.numbers(solved.model),
            pd.Series(_half_widths(solved.resolver, measure.numbers), here.index),
            pd.Series(measure.half_widths, here.index),
        )
        return self.alternative(
            description,
            ", ".join(more),
            numbers_beside,
            measure.watched,
            solved,
        )

    def alternative(
        self,
        description: str,
        place: str,
        numbers: _Numbers,
        watched: pd.Index,
        solved: _Solved,
    ) -> Alternative:
        """What an alternative does to the number that it moves most."""
        size = numbers.here[watched].abs()
        relative_change = (numbers.there - numbers.here)[watched] / size
        relative_width = numbers.half_width[watched] / size
        wider = numbers.wider_half_width[watched] / size
        # NaN where the alternative has no interval of a number
        moved = np.maximum(relative_change.abs(), wider).fillna(0.0)
        parameter = str(moved.idxmax())
        after, before = solved.squares.sum(axis=0), self.squares.sum(axis=0)
        unsolved = before > 0
        ratios = after[unsolved] / before[unsolved]
        return Alternative(
            description,
            place,
            parameter,
            float(relative_change[parameter]),
            float(relative_width[parameter]),
            float(wider[parameter]),
            float(np.sqrt(after.sum() / before.sum())) if unsolved.any() else 1.0,
            float(np.sqrt(ratios.mean())) if unsolved.any() else 1.0,
            numbers.moves,
            solved.model,
            self.model,
        )


def masses_and_stiffnesses(names: pd.Index) -> pd.Index:
    """Names of masses and stiffnesses of storeys; all names where there are none."""
    is_mass = ~names.str.contains(":")
    is_stiffness = names.str.match(r"storey \d+: s$")
    chosen = names[is_mass | is_stiffness]
    return names if chosen.empty else chosen


@dataclass(frozen=True)
class _Numbers:
    """Numbers of a model and the same beside an alternative, with half-widths.

    Attributes
    ----------
    here, there : Series
    half_width, half_width_here : Series
        Beside the alternative, and of the model itself from the same pieces.
    """

    here: pd.Series
    there: pd.Series
    half_width: pd.Series
    half_width_here: pd.Series

    @property
    def wider_half_width(self) -> pd.Series:
        """Half-widths beside the alternative; zero where it makes them no wider.

        A blow in a single piece makes every half-width wide.
        """
        is_wider = self.half_width > MUCH_WIDER * self.half_width_here
        return self.half_width.where(is_wider, 0.0)

    @property
    def moves(self) -> dict[str, Move]:
        """What the alternative does to each number."""
        change = self.there - self.here
        wider = self.wider_half_width
        moves = {}
        for name, size in change.items():
            moves[str(name)] = Move(float(size), float(wider[name]))
        return moves


def _half_widths(resolver: Resolver, numbers: Statistic) -> np.ndarray:
    """Half-widths of the 95 % intervals of numbers."""
    return _QUANTILE * np.sqrt(np.diag(resolver.covariance(numbers)))


def _of_few_pieces(resolver: Resolver) -> Resolver:
    """The same with neighbouring pieces taken together."""
    n_pieces = len(resolver.record)
    together = np.arange(n_pieces) * _N_PIECES // n_pieces
    numbers, first = np.unique(together, return_index=True)
    merged = resolver.pieces.sum(numbers[:, None] == together)
    return replace(resolver, pieces=replace(merged, record=resolver.record[first]))


# -- other structures ----------------------------------------------------------------


def _other_structures(comparison: _Comparison) -> Iterator[Alternative]:
    """A brace at each place where none is declared."""
    places = _places_of_braces(comparison.problem)
    if not places:
        return
    watched = comparison.masses_and_stiffnesses
    try:
        measure = comparison.measure(comparison.parameters, watched)
    except NRFError:
        # too few pieces of data for an interval
        return
    for site, description in places.items():
        brace = {site: (LinearElastic(), LinearViscous())}
        try:
            yield comparison.with_laws(description, brace, measure)
        except NRFError:
            # these data cannot be solved with it, so they say nothing of it
            continue


def _places_of_braces(problem: Problem) -> dict[str, str]:
    """Where a structure may have a brace that is not declared, and what it is."""
    places = {}
    for j in range(2, problem.chain.n_dof + 1):
        places[f"ground {j}"] = f"a brace from DOF {j} to the ground"
    for j in range(3, problem.chain.n_dof + 1):
        places[f"link {j}-{j - 2}"] = f"a brace between DOF {j} and DOF {j - 2}"

    occupied = _occupied_sites(problem)
    return {site: text for site, text in places.items() if site not in occupied}


def _occupied_sites(problem: Problem) -> set[str]:
    return {str(site) for site, group in problem.laws.items() if group}


def _dashpots_to_the_ground(comparison: _Comparison) -> Iterator[Alternative]:
    """Damping that is not of the storeys, as in Rayleigh's model."""
    occupied = _occupied_sites(comparison.problem)
    grounds = [f"ground {j}" for j in range(2, comparison.problem.chain.n_dof + 1)]
    dashpots = {g: (LinearViscous(),) for g in grounds if g not in occupied}
    if not dashpots:
        return

    def numbers(model: ChainModel) -> pd.Series:
        return pd.concat([comparison.parameters(model), damping_ratios(model)])

    description = "dashpots from the floors to the ground"
    try:
        watched = damping_ratios(comparison.model).index
        measure = comparison.measure(numbers, watched)
        yield comparison.with_laws(description, dashpots, measure)
    except NRFError:
        return


def damping_ratios(model: ChainModel) -> pd.Series:
    """Damping ratios by mode, ``"damping 1"``."""
    ratios = model.modes()["damping"]
    return ratios.set_axis([f"damping {number}" for number in ratios.index])


# -- other channels ------------------------------------------------------------------


@dataclass(frozen=True)
class _Change:
    """A change of the channels that one number describes.

    Attributes
    ----------
    description : str
        With a place for the number.
    place : str
    neutral : float
        The number of channels that are right.
    step : float
        How far from it the derivatives are taken.
    apply : callable
        Changes a record, given by how much the number differs from the neutral one.
    """

    description: str
    place: str
    neutral: float
    step: float
    apply: Callable[[Segment, float], Segment]


def _other_channels(comparison: _Comparison) -> Iterator[Alternative]:
    """A gain of all sensors of each floor, and a corner of each force."""
    for change in _changes(comparison.data, comparison.forced):
        try:
            alternative = _with_change(comparison, change)
        except NRFError:
            continue
        if alternative is not None:
            yield alternative


def _with_change(comparison: _Comparison, change: _Change) -> Alternative | None:
    """The alternative with the best change of the channels; None if it has no size.

    It has none where the data hardly feel it, and where no sensor could have it.
    """
    best = _best_change(comparison, change, change.step)
    if best is None or change.neutral + best.amount < 0:
        return None
    at_best = _changed(comparison, change, best.amount)
    if _size(comparison, at_best.squares) > _size(comparison, comparison.squares):
        # the estimate bends within the step
        best = _best_change(comparison, change, _FINER * change.step)
        if best is None:
            return None
        at_best = _changed(comparison, change, best.amount)

    here = comparison.parameters(comparison.model)
    there = comparison.parameters(at_best.model)
    return comparison.alternative(
        change.description.format(change.neutral + best.amount),
        change.place,
        _Numbers(here, there, best.half_widths, 0.0 * here),
        comparison.masses_and_stiffnesses,
        at_best,
    )


@dataclass(frozen=True)
class _BestChange:
    """The change of channels that leaves least.

    Attributes
    ----------
    amount : float
        Less the neutral one.
    half_widths : Series
        What its 95 % interval makes of masses and coefficients.
    """

    amount: float
    half_widths: pd.Series


def _best_change(
    comparison: _Comparison, change: _Change, step: float
) -> _BestChange | None:
    """The minimum of a parabola; None if the data hardly feel the change."""
    weights = comparison.weights
    low = _changed(comparison, change, -step)
    high = _changed(comparison, change, step)
    slope = (high.squares - low.squares) @ weights / (2 * step)
    twice = 2 * comparison.squares
    bend = (high.squares + low.squares - twice) @ weights / step**2
    squares = _size(comparison, comparison.squares)
    if 0.5 * bend.sum() * (_TENTH * change.step) ** 2 < _FELT * squares:
        return None
    amount, spread = _minimum(slope, bend)
    moved = comparison.parameters(high.model) - comparison.parameters(low.model)
    rate = moved / (2 * step)
    return _BestChange(amount, _QUANTILE * rate.abs() * spread)


def _size(comparison: _Comparison, squares: np.ndarray) -> float:
    """Weighted sum of squared residuals."""
    return float(squares.sum(axis=0) @ comparison.weights)


def _changes(data: Dataset, forced: tuple[int, ...]) -> Iterator[_Change]:
    for j in range(1, data.n_dof + 1):
        text = f"a gain of {{:.3g}} in all sensors of DOF {j}"
        yield _Change(text, f"dof {j}", 1.0, _STEP, partial(_with_gain, dof=j))
    for j in forced:
        step = _STEP / _seconds_of_force(data, j)
        text = f"a high-pass filter at {{:.3g}} Hz in F{j}"
        yield _Change(text, f"sensor F{j}", 0.0, step, partial(_without_corner, dof=j))


def _with_gain(segment: Segment, more: float, dof: int) -> Segment:
    """A record in which all motions of a floor are multiplied by one plus a number."""
    drift = segment.s[:, :dof].sum(axis=1)
    rate = segment.v[:, :dof].sum(axis=1)
    acceleration = segment.a[:, dof - 1]
    return segment.moved(dof, x=more * drift, v=more * rate, a=more * acceleration)


def _without_corner(segment: Segment, corner: float, dof: int) -> Segment:
    """A record with the force before a first-order high-pass filter, corner in Hz."""
    return segment.moved(dof, F=2 * np.pi * corner * _integrated_force(segment, dof))


def _integrated_force(segment: Segment, dof: int) -> np.ndarray:
    """Integral of a force over time less its mean, N s."""
    force = np.nan_to_num(segment.F[:, dof - 1].astype(float))
    impulse = segment.step * np.cumsum(force)
    return np.asarray(impulse - impulse.mean())


def _seconds_of_force(data: Dataset, dof: int) -> float:
    """Rms of the change of a force by a corner of one Hz over the rms of the force."""
    impulse = [_integrated_force(segment, dof) for segment in data.segments]
    force = [np.nan_to_num(segment.F[:, dof - 1]) for segment in data.segments]
    ratio = np.linalg.norm(np.concatenate(impulse))
    return float(2 * np.pi * ratio / np.linalg.norm(np.concatenate(force)))


def _changed(comparison: _Comparison, change: _Change, amount: float) -> _Solved:
    """The model from changed channels."""
    segments = [change.apply(segment, amount) for segment in comparison.data.segments]
    data = replace(comparison.data, segments=segments)
    return comparison.solve(comparison.problem, data)


def _late_forces(comparison: _Comparison) -> Iterator[Alternative]:
    """Forces that come later or earlier than the motion they cause."""
    problem, data = comparison.problem, comparison.data
    delays = delays_of(data, problem.filters(data), problem.layout)
    here = comparison.parameters(comparison.model)
    for channel, delay in delays[~delays["aligned"].astype(bool)].iterrows():
        samples = float(delay["samples"])
        if not np.isfinite(samples):
            continue
        dof = int(str(channel)[1:])
        if dof not in comparison.forced:
            continue
        segments = [_with_force_in_time(s, dof, samples) for s in data.segments]
        shifted_data = replace(data, segments=segments)
        try:
            solved = comparison.solve(problem, shifted_data)
        except NRFError:
            continue
        there = comparison.parameters(solved.model)
        side = "late" if samples > 0 else "early"
        yield comparison.alternative(
            f"{channel} logged {abs(samples):.3g} samples {side}",
            f"sensor {channel}",
            _Numbers(here, there, 0.0 * here, 0.0 * here),
            comparison.masses_and_stiffnesses,
            solved,
        )


def _with_force_in_time(segment: Segment, dof: int, samples: float) -> Segment:
    """A record with a force moved forward in time; rows at the ends are left out."""
    force = np.array(segment.F, dtype=float)
    force[:, dof - 1] = shifted(force[:, dof - 1], -samples)
    force[:, dof - 1] = np.nan_to_num(force[:, dof - 1])
    lost = int(np.ceil(abs(samples)))
    rows = slice(segment.valid.start + lost, segment.valid.stop - lost)
    return replace(segment, F=force, valid=rows)


def _minimum(slope: np.ndarray, bend: np.ndarray) -> tuple[float, float]:
    """Minimum of a sum of parabolas and its standard error.

    Every piece of the data has its own slope and bend.
    """
    minimum = -slope.sum() / bend.sum()
    influences = -(slope + bend * minimum) / bend.sum()
    return float(minimum), float(np.sqrt(newey_west(influences[:, None])[0, 0]))
