"""Estimates that noise in the motion does not bias: instruments, and output error.

With all floors measured the free-run fit (``estimation="simulation"``) starts from
instrumental variables, and is kept only if it predicts unseen parts of the records,
both halves of them, better. Initial states of all shots are free; laws with memory
begin in the states that the measured motion before a shot gives them. With fewer
sensors: :mod:`.fewer_sensors`.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..exceptions import (
    IdentifiabilityError,
    NRFError,
    RankWarning,
    SimulationError,
)
from ..laws.shape import Shape
from ..records.dataset import Dataset
from ..records.zero_phase_filter import Band
from ..simulation.system import flatten, jumping_sites
from .free_run_fit import FreeRunError, FreeRunFit, Solution
from .instrumental_variables import IVResult, instrumental_variables
from .intervals import InfluenceResolver, Resolver
from .joint_intervals import joint_resolver
from .parameter_vector import Rebuild, free_parameters, free_shapes_of
from .problem import Estimate, Problem
from .shape_refinement import refine_shapes
from .shots import Shot, halves_of, shots_of
from .spectra import common_band
from .whitened_runs import MIN_ROWS

__all__ = [
    "FreeRunFit",
    "Rebuild",
    "Shot",
    "Solution",
    "free_parameters",
    "output_error",
    "refine",
]

# Iterations without weights, after which the gaps show noise and not the error of the
# first estimate. Weights of the first gaps leave the dashpot of the Bouc-Wen benchmark
# 1.2 % off, those of the second 0.1 %.
PLAIN_STEPS = 2
# Iterations of a fit to one half of the data, which starts at the fit to all: one step
# of Gauss and Newton goes nearly all of the way.
STEPS_OF_HALF = 1
# Free-run error on unseen parts after and before the refinement; a smaller reduction is
# not worth another estimate.
LARGEST_RATIO = 0.97
# What a free run misses of a channel over the noise of the channel, both rms, that
# errors of the first state explain. Chosen on chains with friction of
# benchmarks/free_runs.py: with 3, one of eight keeps an error of 3.3 % (0.2 with 1.5).
MOST_BY_NOISE = 1.5
# Samples up to which the free run is fitted unasked: 8,192 of a loop take 30 s of one
# core, 153,000 several minutes.
MOST_SAMPLES_UNASKED = 30_000
# Change of a mass in the last round of the instruments, in standard errors, that
# matters no more.
NEGLIGIBLE_CHANGE = 0.2


@dataclass(frozen=True)
class OutputErrorResult:
    """Result of the free-run fit.

    Attributes
    ----------
    solution : Solution or None
        None if the fit does not predict unseen parts better than its start.
    rebuild : Rebuild or None
        What the parameters of the solution mean.
    error_before, error_after : float
        Free-run error of the velocities on parts that the fit did not see, percent
        NRMSE.
    reason : str
        Why the start was kept.
    possible : bool
        False if no fit could be made.
    """

    solution: Solution | None = None
    rebuild: Rebuild | None = None
    error_before: float = np.nan
    error_after: float = np.nan
    reason: str = ""
    possible: bool = True


@dataclass(frozen=True)
class Refinement:
    """An estimate, and what its intervals and the diagnosis need.

    Attributes
    ----------
    estimate : Estimate
    method : {"ls", "iv", "simulation"}
        The method whose estimate was kept.
    resolver : Resolver or None
        Of the intervals; None where the least-squares estimate was kept.
    judged : Dataset
        Motions on which missing terms are judged.
    doubts : tuple of str
        Sentences to warn of.
    notes : tuple of str
        These, and remarks.
    facts : dict of str to object
        Rounds, correlation and free-run errors, for ``model.info``.
    """

    estimate: Estimate
    method: str
    resolver: Resolver | None
    judged: Dataset
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    facts: dict[str, object] = field(default_factory=dict)


def output_error(
    start: ChainModel,
    data: Dataset,
    layout: LawLayout,
    known_masses: Mapping[int, float],
    band: Band = None,
    halves: Sequence[ChainModel] | None = None,
    shapes: Sequence[tuple[Site, int, Shape]] = (),
) -> OutputErrorResult:
    """Fit masses, coefficients and shape parameters by the free run.

    Parameters
    ----------
    start : ChainModel
        First estimate.
    data : Dataset
    layout : LawLayout
    known_masses : mapping of int to float
    band : tuple of float or None, optional
        Hz.
    halves : sequence of ChainModel, optional
        First estimates from the first and the second half of the records.
    shapes : sequence of (Site, int, Shape)
        Shape parameters that are free, by site and number of the law there.
    """
    shots = shots_of(data, start)
    if not shots:
        return _start_kept("the force on some DOF is unknown in every record")
    if max(shot.n_samples for shot in shots) < 2 * MIN_ROWS:
        return _start_kept("the records are too short")

    rebuild = free_parameters(start, known_masses, shapes=shapes)
    fit = FreeRunFit(rebuild, shots, layout, _resolved_band(shots, band))
    try:
        plain = fit.solve(rebuild.start, steps=PLAIN_STEPS, move=True)
        noisy_fit = fit.begun_from(plain).with_noise(plain.model)
        if noisy_fit is None:
            exact = "the free run is exact to round-off"
            return OutputErrorResult(error_before=0.0, error_after=0.0, reason=exact)
        low, high = noisy_fit.weighting.band
        if low >= high:
            return _start_kept("the records hold no motion in the band of the fit")
        return _fit_if_better(noisy_fit, plain.u, start, halves or (start, start))
    except SimulationError as error:
        return _start_kept(error.what)


def _resolved_band(shots: Sequence[Shot], band: Band) -> tuple[float, float]:
    """Band in which the fused motions of all records hold the motion, Hz."""
    segments = [shot.segment for shot in shots]
    low, high = common_band(segments, band)
    for segment in segments:
        if segment.resolved is not None:
            high = min(high, segment.resolved)
    return low, high


def _fit_if_better(
    fit: FreeRunFit,
    first: np.ndarray,
    start: ChainModel,
    rivals: Sequence[ChainModel],
) -> OutputErrorResult:
    """Fit to all data, if fits to each half predict the other half better.

    Parameters
    ----------
    fit : FreeRunFit
    first : ndarray of shape (n_parameters,)
        First estimate.
    start : ChainModel
        By instruments from all data.
    rivals : sequence of two ChainModel
        By instruments from the first and from the second half.
    """
    solution = fit.solve(first, move=True)
    fit = fit.begun_from(solution)
    rows_of_halves = halves_of(fit.shots)

    before = []
    after = []
    for rival, fitted_rows, judged_rows in zip(
        rivals, rows_of_halves, reversed(rows_of_halves)
    ):
        before.append(_error_of_rival(fit, rival, start, judged_rows))
        refined = fit.solve(solution.u, fitted_rows, STEPS_OF_HALF, move=True)
        after.append(fit.error(refined.model, judged_rows))

    error_before = (before[0] + before[1]).percent
    error_after = (after[0] + after[1]).percent
    if not clearly_better(before, after):
        reason = (
            "the refinement does not predict unseen parts of the records clearly better"
        )
        return OutputErrorResult(None, None, error_before, error_after, reason)

    return OutputErrorResult(solution, fit.rebuild, error_before, error_after)


def _error_of_rival(
    fit: FreeRunFit, rival: ChainModel, start: ChainModel, rows: Sequence[slice]
) -> FreeRunError:
    """Error of an estimate from one half; of that from all data if its run diverges."""
    try:
        return fit.error(rival, rows)
    except SimulationError:
        return fit.error(start, rows)


def clearly_better(
    before: Sequence[FreeRunError], after: Sequence[FreeRunError]
) -> bool:
    """Whether every unseen half is predicted better, and all together clearly."""
    halves_improve = [new.plain < old.plain for old, new in zip(before, after)]
    if not all(halves_improve):
        return False

    old = before[0] + before[1]
    new = after[0] + after[1]
    if not new.weighted < old.weighted:
        return False
    return bool(np.sqrt(new.plain / old.plain) <= LARGEST_RATIO)


def _start_kept(reason: str) -> OutputErrorResult:
    """No result, because no fit could be made."""
    return OutputErrorResult(reason=reason, possible=False)


def refine(method: str, asked: Problem, start: Estimate, data: Dataset) -> Refinement:
    """Estimate by instrumental variables, and by output error where it is asked for.

    Parameters
    ----------
    method : {"iv", "simulation", "auto"}
        By ``"auto"`` the free run is fitted where forces jump, or shape parameters are
        free, and it misses more than noise explains.
    asked : Problem
        As the user declared it, with the shape parameters that are free.
    start : Estimate
        By least squares.
    data : Dataset
        Motions whose noise is independent from DOF to DOF.
    """
    order = start.order
    try:
        # columns that depend on each other are warned of once, for the last round
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            iv = instrumental_variables(start.model, data, start.problem, order)
            problem, iv = refine_shapes(asked, start.problem, order, data, iv)
    except IdentifiabilityError as failure:
        doubt = (
            f"estimation='iv' fell back on least squares: {failure.what}. Noise in the"
            f" motion then biases masses and stiffnesses low. {failure.cure}"
        )
        return Refinement(start, "ls", None, data, (doubt,), (doubt,))

    known_masses = dict(problem.known_masses)
    resolver = Resolver(iv.pieces, order, known_masses, problem.optimizer)
    joint = joint_resolver(
        asked, problem, order, data, iv.model.coefficients, iv.runs, iv.whiteners
    )
    doubts = (*iv.doubts, *_doubts_of_convergence(iv, resolver))
    by_instruments = Refinement(
        estimate=start._replace(problem=problem, model=iv.model, solution=iv.solution),
        method="iv",
        resolver=joint or resolver,
        judged=iv.judged(data),
        doubts=doubts,
        notes=(*iv.notes, *doubts),
        facts={"rounds": iv.rounds, "correlation": iv.correlation},
    )
    if method == "simulation":
        return _with_free_run(by_instruments, resolver, data, asked)
    if method == "auto" and _free_run_improves(iv.model, data, asked):
        return _with_free_run(by_instruments, resolver, data, asked)
    return by_instruments


def _free_run_improves(model: ChainModel, data: Dataset, asked: Problem) -> bool:
    """Whether a fit of the free run is worth its time.

    Instruments need columns whose errors have no mean. Noise in the rate makes the
    mean of a force that jumps smaller, and columns of searched shape parameters follow
    a motion with errors.
    """
    if not _shapes_of_motion(asked) and not _jumps(model):
        return False
    if data.n_samples > MOST_SAMPLES_UNASKED:
        return False
    try:
        return any(_misses_more_than_noise(s, model) for s in shots_of(data, model))
    except SimulationError:
        return False


def _jumps(model: ChainModel) -> bool:
    """Whether a force jumps where the rate at its site changes sign."""
    _, layout = flatten(model)
    covariates = np.ones(len(layout.covariates))
    return bool(jumping_sites(model.laws, layout, covariates).any())


def _misses_more_than_noise(shot: Shot, model: ChainModel) -> bool:
    """Whether a free run misses a measured channel by more than its noise."""
    rows = shot.segment.valid
    measured = {
        "a": shot.segment.a[rows],
        "v": np.cumsum(shot.segment.v[rows], axis=1),
        "x": np.cumsum(shot.segment.s[rows], axis=1),
    }
    run = shot.motion(model)
    for channel, noise in shot.segment.noise.items():
        kind, dof = channel[0], channel[1:]
        if kind in measured and dof.isdigit():
            gap = (measured[kind] - run[kind])[:, int(dof) - 1]
            if np.sqrt(np.mean(gap**2)) > MOST_BY_NOISE * noise:
                return True
    return False


def _with_free_run(
    by_instruments: Refinement, resolver: Resolver, data: Dataset, asked: Problem
) -> Refinement:
    """The free-run fit from instrumental variables on, where it predicts better."""
    estimate = by_instruments.estimate
    problem = estimate.problem
    result = output_error(
        estimate.model,
        data,
        problem.layout,
        problem.known_masses,
        problem.band,
        _estimates_of_halves(resolver),
        _shapes_of_motion(asked),
    )
    errors = {
        "free_run_error_before": _finite_or_none(result.error_before),
        "free_run_error_after": _finite_or_none(result.error_after),
    }
    with_errors = replace(by_instruments, facts=by_instruments.facts | errors)
    if result.solution is None or result.rebuild is None:
        note = f"instrumental variables kept: {result.reason}"
        doubts = by_instruments.doubts
        if not result.possible:
            doubt = (
                "estimation='simulation' kept the instrumental-variable estimate:"
                f" {result.reason}."
            )
            doubts = (*doubts, doubt)
        return replace(with_errors, doubts=doubts, notes=(*with_errors.notes, note))

    model = result.solution.model
    influence_resolver = InfluenceResolver(
        resolver.pieces,
        resolver.solve_order,
        resolver.known_masses,
        resolver.inner,
        best=result.solution,
        rebuild=result.rebuild,
    )
    return replace(
        with_errors,
        estimate=estimate._replace(model=model, problem=problem.with_laws(model.laws)),
        method="simulation",
        resolver=influence_resolver,
    )


def _shapes_of_motion(asked: Problem) -> list[tuple[Site, int, Shape]]:
    """The free shape parameters but instants, which other means find better."""
    return [free for free in free_shapes_of(asked.laws) if not free[2].instant]


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _doubts_of_convergence(iv: IVResult, resolver: Resolver) -> list[str]:
    """A sentence on a mass that had not settled."""
    if iv.moved is None:
        return []

    spread = np.zeros(len(iv.moved))
    try:
        variance = np.diag(resolver.covariance(lambda model: pd.Series(model.masses)))
        spread = np.sqrt(variance) / np.abs(iv.model.masses)
    except NRFError:  # too few pieces for a standard error
        pass

    worst = int(np.argmax(iv.moved - NEGLIGIBLE_CHANGE * spread))
    change = iv.moved[worst]
    if change <= NEGLIGIBLE_CHANGE * spread[worst]:
        return []

    error = ""
    if spread[worst]:
        error = f" (standard error {100 * spread[worst]:.2g} %)"
    return [
        f"estimation='iv' did not converge in {iv.rounds} rounds: the last one changed"
        f" m{worst + 1} by {100 * change:.2g} %{error}. Give longer or cleaner records,"
        " or a simpler law."
    ]


def _estimates_of_halves(resolver: Resolver) -> list[ChainModel] | None:
    """Models of both halves of the records, if both can be solved."""
    record = resolver.record
    place = np.arange(len(record)) - np.searchsorted(record, record)
    first = place < np.bincount(record)[record] // 2
    try:
        return [resolver.weighted_model(half.astype(float)) for half in (first, ~first)]
    except IdentifiabilityError:
        return None
