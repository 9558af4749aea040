"""What is known of a model, of its data and of the search behind it.

A verdict follows from these facts alone; see :mod:`pysindy_nrf.diagnosis.verdict`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..chain.restoring_force import RestoringForce
from ..chain.visited_region import VisitedRegion
from ..common.unit_system import TRANSLATION, UnitSystem
from ..records.quality import QualityNote
from .assumptions import Assumption
from .effects import Bounds, Effect, described
from .evidence import Evidence
from .free_run import FreeRuns

# Share of the force of a site from which on a negative stiffness is no error of a weak
# spring.
CARRIES = 0.25
# Periods of the slowest mode in a record, below which the chain hardly has a spring to
# the ground.
FLOATING_PERIODS = 3.0
# Letters of the labels of terms that are powers of drift and rate.
_POWERS = set("sv ^123456789")


@dataclass(frozen=True)
class FreeRunFacts:
    """How far the model alone follows the measured motion.

    Parameters
    ----------
    error : float
        Percent NRMSE over the records; NaN without a run.
    over_periods : float
        Percent NRMSE of free runs over some periods; NaN if they were not tried.
    diverges : bool
        Whether a run came to no end or grows beyond all numbers.
    why_not : str
        Why a run is missing.
    floats : bool
        Whether the chain has hardly a spring to the ground, so that it may drift.
    by_newmark : bool
        Whether the default method of :func:`pysindy_nrf.simulate` failed and Newmark's
        computed the run.
    diverges_by_default : bool
        Whether it failed because the motion grew beyond all measure.
    spread : float
        Percent of the motion by which errors of the parameters move the run; NaN where
        that was not tried.
    """

    error: float = float("nan")
    over_periods: float = float("nan")
    diverges: bool = False
    why_not: str = ""
    floats: bool = True
    by_newmark: bool = False
    diverges_by_default: bool = False
    spread: float = float("nan")


@dataclass(frozen=True)
class GrowingMode:
    """A mode of the linear part that grows by itself."""

    number: int
    damping: float


@dataclass(frozen=True)
class LeftOver:
    """What a model leaves of one equation of motion, and what noise would leave.

    Parameters
    ----------
    rms, noise : float
        N.
    percent : float
        The rms as a share of the force, percent.
    band : (float, float), optional
        Of both, Hz; None for all frequencies.
    """

    rms: float
    noise: float
    percent: float
    band: tuple[float, float] | None = None


@dataclass(frozen=True)
class ShapeAtEnd:
    """A shape parameter that ended where its search ends.

    Parameters
    ----------
    law : str
        Name, such as ``"jenkins"``.
    site : str
    shape : str
        Name of the parameter.
    end : {"lower", "upper"}
    value : float
        SI units.
    unit : str
    """

    law: str
    site: str
    shape: str
    end: str
    value: float
    unit: str


@dataclass(frozen=True)
class Move:
    """What an alternative does to a value of a model.

    Parameters
    ----------
    change : float
        SI units.
    half_width : float
        Of the 95 % interval with it, SI units; 0 if that is not much wider.
    """

    change: float
    half_width: float = 0.0


@dataclass(frozen=True)
class Alternative:
    """Something that the data allow besides a model.

    Parameters
    ----------
    description : str
        What it is, such as ``"a spring and a dashpot from DOF 2 to the ground"``.
    place : str
        Site or DOF.
    parameter : str
        The mass or stiffness that it moves most, ``"m2"`` or ``"storey 2: s"``.
    change : float
        By how much it moves that parameter, as a share of it.
    half_width : float
        Half-width of the 95 % interval of that parameter with it, as a share.
    wider : float
        The same if it is much wider than without the alternative; 0 otherwise.
    residual_share : float
        Residual of all equations of motion with it, as a share of that of the model.
    residual_share_by_equation : float
        The same with each residual as a share of itself: the rms over the equations.
    moves : mapping of str to Move
        What it does to each mass and coefficient.
    model, compared : ChainModel, optional
        The estimate with it, and that without it from the same data.
    """

    description: str
    place: str
    parameter: str
    change: float
    half_width: float
    wider: float
    residual_share: float
    residual_share_by_equation: float
    moves: Mapping[str, Move] = field(default_factory=dict)
    model: ChainModel | None = None
    compared: ChainModel | None = None

    @property
    def reach(self) -> float:
        """How far from the model the parameter may be, as a share of it."""
        return max(abs(self.change), self.wider)


@dataclass(frozen=True)
class OtherModel:
    """Another model of the same record, judged with this one on data left out.

    Parameters
    ----------
    name : str
    free_run, free_run_of_this : float
        Errors of both free runs, percent NRMSE; NaN where there is none, inf where it
        diverges.
    """

    name: str
    free_run: float
    free_run_of_this: float


@dataclass(frozen=True)
class AmbiguousInterval:
    """An interval that an alternative to the model moves or widens.

    Parameters
    ----------
    parameter : str
        Such as ``"m2"`` or ``"storey 2: s"``.
    low, high : float
        What the model and the alternatives span together, SI units.
    by : tuple of str
        The alternatives, as they are described.
    withheld : bool
        Whether the span says too little to be given as an interval.
    """

    parameter: str
    low: float
    high: float
    by: tuple[str, ...]
    withheld: bool

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the interval that is given; NaN if it is withheld."""
        unknown = float("nan")
        return (unknown, unknown) if self.withheld else (self.low, self.high)


@dataclass(frozen=True)
class Facts:
    """What is known of a model, of its data and of the search behind it.

    Parameters
    ----------
    unexplained : mapping of int to float
        Share of the equation of motion of each DOF that the model leaves, percent
        NRMSE.
    beyond_noise : mapping of int to float
        The same beyond what noise leaves; DOFs where that is not known are left out.
    left_over : mapping of int to LeftOver
        Residual of each DOF whose noise is known.
    channel_error : float
        Largest share of a measured channel that the free run misses beyond its noise,
        where some floor has no sensor.
    holds : tuple of str
        What the model holds besides linear storeys, in words.
    impossible_masses : mapping of int to float
        Masses by DOF that were identified and are not positive, kg.
    negative_stiffness : tuple of str
        Sites whose stiffness is negative beyond its interval.
    intervals : mapping of str to (float, float)
        95 % intervals by parameter (``"m1"``, ``"storey 2: s"``).
    growing_mode : GrowingMode, optional
        The mode with the most negative damping.
    free_run : FreeRunFacts
    channel_faults : mapping of str to bool
        Channels that seem reversed, in another unit or in the wrong column, in words,
        and whether that is sure.
    quality : tuple of QualityNote
        What is known of channels, clocks and units.
    n_records : int
        Records behind the model; a note names its own if there are several.
    effects : tuple of Effect
        What a search added, confirmed or not.
    unanswered : mapping of str to str
        Questions to the residual that have no answer, and why.
    unseen_drifts : mapping of int to float
        Noise over rms of the drift of each storey that noise hides.
    shapes_at_ends : tuple of ShapeAtEnd
        Shape parameters that ended where their search ends.
    alternatives : tuple of Alternative
        What the data allow besides the model, the one that leaves least first.
    ambiguous_intervals : tuple of AmbiguousInterval
        Intervals that alternatives widen, or that are withheld for them.
    other_models : tuple of OtherModel
        Models with which this one was compared.
    assumptions : tuple of Assumption
        What the model takes for granted; no reason against it.
    noise_is_known : bool
        Whether it is known what noise alone would leave.
    searched : bool
        Whether a search has looked for effects that the model lacks.
    nothing_claimed : str
        Why a search claims nothing; empty if it does.
    wiring : str
        The error of wiring without which the balances close, if there is one.
    noise_or_law : tuple of str
        What a missing law or noise in the motion may explain, in sentences.
    doubts : tuple of str
        What else is doubtful, in sentences.
    units : UnitSystem
        Of the model.
    """

    unexplained: Mapping[int, float] = field(default_factory=dict)
    beyond_noise: Mapping[int, float] = field(default_factory=dict)
    left_over: Mapping[int, LeftOver] = field(default_factory=dict)
    channel_error: float = 0.0
    holds: tuple[str, ...] = ()
    impossible_masses: Mapping[int, float] = field(default_factory=dict)
    negative_stiffness: tuple[str, ...] = ()
    intervals: Bounds = field(default_factory=dict)
    growing_mode: GrowingMode | None = None
    free_run: FreeRunFacts = FreeRunFacts()
    channel_faults: Mapping[str, bool] = field(default_factory=dict)
    quality: tuple[QualityNote, ...] = ()
    n_records: int = 1
    effects: tuple[Effect, ...] = ()
    unanswered: Mapping[str, str] = field(default_factory=dict)
    unseen_drifts: Mapping[int, float] = field(default_factory=dict)
    shapes_at_ends: tuple[ShapeAtEnd, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    ambiguous_intervals: tuple[AmbiguousInterval, ...] = ()
    other_models: tuple[OtherModel, ...] = ()
    assumptions: tuple[Assumption, ...] = ()
    noise_is_known: bool = True
    searched: bool = False
    nothing_claimed: str = ""
    wiring: str = ""
    noise_or_law: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    units: UnitSystem = TRANSLATION

    @property
    def remaining(self) -> dict[int, float]:
        """What each equation keeps, percent, beyond noise where that is known."""
        return {**self.unexplained, **self.beyond_noise}


# -- a model -------------------------------------------------------------------


def facts_of_model(
    model: ChainModel,
    bounds: Bounds,
    runs: FreeRuns | None,
    known_masses: Collection[int] = (),
    over_periods: float = float("nan"),
) -> Facts:
    """What masses, laws, intervals and free runs of a model say of it.

    Parameters
    ----------
    model : ChainModel
    bounds : mapping of str to (float, float)
        95 % intervals by parameter.
    runs : FreeRuns, optional
    known_masses : collection of int
        DOFs whose mass was given.
    over_periods : float
        Error of free runs over some periods, percent NRMSE.
    """
    modes = _modes_of(model)
    return Facts(
        impossible_masses=_impossible_masses(model, known_masses),
        negative_stiffness=tuple(_negative_stiffness(model, bounds)),
        intervals=bounds,
        growing_mode=_growing_mode(modes),
        free_run=_free_run_facts(runs, modes, over_periods),
        units=model.units,
    )


def _modes_of(model: ChainModel) -> pd.DataFrame:
    """Modes of the linear part; empty where a mass is not positive."""
    if (model.masses > 0).all() and (model.total_masses > 0).all():
        return model.modes()
    return pd.DataFrame()


def _impossible_masses(
    model: ChainModel, known_masses: Collection[int]
) -> dict[int, float]:
    """Masses that were identified and are not positive, by DOF."""
    impossible = {}
    for j, mass in enumerate(model.masses.tolist(), 1):
        if mass <= 0 and j not in known_masses:
            impossible[j] = mass
    return impossible


def _growing_mode(modes: pd.DataFrame) -> GrowingMode | None:
    """The mode with the most negative damping."""
    if modes.empty or not modes["damping"].min() < 0:
        return None
    number = modes["damping"].idxmin()
    return GrowingMode(number, float(modes.loc[number, "damping"]))


def _free_run_facts(
    runs: FreeRuns | None, modes: pd.DataFrame, over_periods: float
) -> FreeRunFacts:
    """How far a model alone follows the measured motion."""
    if runs is None:
        return FreeRunFacts(over_periods=over_periods)
    is_finite = np.isfinite(runs.table.to_numpy(dtype=float)).all()
    return FreeRunFacts(
        error=runs.error,
        over_periods=over_periods,
        diverges=runs.failed or not is_finite,
        why_not=runs.why_not,
        floats=_floats(runs, modes),
        by_newmark=runs.by_newmark,
        diverges_by_default=runs.diverges_by_default,
        spread=runs.spread,
    )


def _floats(runs: FreeRuns, modes: pd.DataFrame) -> bool:
    """Whether the slowest mode hardly comes round in the longest record."""
    if modes.empty or not runs.runs:
        return True
    durations = [segment.n_valid * (segment.dt or 1.0) for segment, _ in runs.runs]
    return float(modes["frequency"].min()) * max(durations) < FLOATING_PERIODS


def _negative_stiffness(model: ChainModel, bounds: Bounds) -> list[str]:
    """Sites without memory whose stiffness is negative and carries their force.

    Storeys, and others with a law whose stiffness cannot be negative.
    """
    places = []
    for site, force in model.restoring_forces.items():
        region = model.visited.get(site)
        stiffness = float(force.linear_part()["k"])
        upper_end = bounds.get(f"{site}: s", (stiffness, stiffness))[1]
        surely_negative = stiffness < 0 and upper_end < 0
        if region is None or not surely_negative:
            continue
        if not (site.is_storey or _cannot_be_negative(force)):
            continue
        if _is_polynomial(force) and _pushes_outwards(force, region):
            places.append(str(site))
    return places


def _cannot_be_negative(force: RestoringForce) -> bool:
    """Whether a law with a spring says that its stiffness is not negative."""
    for law in force.laws:
        symbols = [term.symbol for term in law.terms() if term.label == "s"]
        if not set(symbols) <= set(law.nonnegative):
            return False
    return True


def _is_polynomial(force: RestoringForce) -> bool:
    """Whether a force is made of powers of drift and rate alone."""
    if force.has_memory:
        return False
    labels = [term.label for law in force.laws for term in law.terms()]
    return all(set(label) <= _POWERS for label in labels)


def _pushes_outwards(force: RestoringForce, region: VisitedRegion) -> bool:
    """Whether a storey pushes away from its rest, and its spring carries the force."""
    largest = np.maximum(np.abs(region.low), np.abs(region.high))
    rate, drift = float(largest[0]), float(largest[1])
    backward, forward = force(np.zeros(2), np.array([-drift, drift]))

    linear = force.linear_part()
    of_spring = -linear["k"] * drift
    of_dashpot = abs(linear["c"]) * rate
    carries = of_spring > CARRIES * (of_spring + of_dashpot)
    return bool(forward - backward < 0 and carries)


# -- a closed loop -------------------------------------------------------------


class Identified(Protocol):
    """The result of an identification."""

    @property
    def facts(self) -> Facts:
        """What is known of its model and of its data."""


class Loop(Protocol):
    """What a verdict reads of a report of the loop."""

    @property
    def identified(self) -> Identified | None:
        """The final estimate of the model, if it has one."""

    @property
    def model(self) -> ChainModel:
        """The model found."""

    @property
    def models(self) -> Sequence[ChainModel]:
        """The baseline, and the model after each effect."""

    @property
    def bounds(self) -> Bounds:
        """95 % intervals by parameter."""

    @property
    def steps(self) -> Sequence[Effect]:
        """Effects that the search added."""

    @property
    def final(self) -> pd.Series:
        """Errors of the model, percent NRMSE."""

    @property
    def evidence(self) -> Sequence[Evidence]:
        """What was left after each model."""

    @property
    def free_runs(self) -> FreeRuns | None:
        """The model alone under the measured forces."""

    @property
    def faults(self) -> Mapping[str, bool]:
        """Channels at fault, and whether that is sure."""

    @property
    def quality(self) -> Sequence[QualityNote]:
        """What is known of the channels."""

    @property
    def stopped_because(self) -> str:
        """Why the search stopped."""

    @property
    def nothing_claimed(self) -> bool:
        """Whether nothing is claimed."""

    @property
    def beyond_noise(self) -> np.ndarray:
        """Error of each equation of motion beyond noise, percent; may be empty."""

    @property
    def alternatives(self) -> tuple[Alternative, ...]:
        """What the data allow besides the model."""

    @property
    def ambiguous_intervals(self) -> tuple[AmbiguousInterval, ...]:
        """Intervals that alternatives widen, or that are withheld for them."""

    @property
    def unseen_drifts(self) -> Mapping[int, float]:
        """Noise over rms of the drift of each storey that noise hides."""

    @property
    def wiring(self) -> str:
        """The mapping of channels with which the balances close."""


def facts_of_loop(report: Loop) -> Facts:
    """What a report of the loop says of its model.

    ``wiring`` is left out: a verdict asks for it where the other facts make it likely.
    """
    of_model = _facts_of_estimate(report)
    of_search = dict(enumerate(report.beyond_noise.tolist(), start=1))
    confirmed = [step for step in report.steps if step.confirmed]
    has_floor = all(evidence.floor is not None for evidence in report.evidence)
    return replace(
        of_model,
        beyond_noise=dict(of_model.beyond_noise) or of_search,
        left_over=dict(of_model.left_over) or _left_over(report),
        searched=True,
        alternatives=report.alternatives,
        ambiguous_intervals=report.ambiguous_intervals,
        unseen_drifts=report.unseen_drifts,
        holds=tuple(map(described, confirmed)),
        channel_faults=report.faults,
        quality=tuple(dict.fromkeys([*report.quality, *of_model.quality])),
        effects=tuple(report.steps),
        unanswered=_unanswered(report.evidence),
        noise_is_known=has_floor
        or set(of_model.left_over) >= set(of_model.unexplained),
        nothing_claimed=report.stopped_because if report.nothing_claimed else "",
    )


def _facts_of_estimate(report: Loop) -> Facts:
    """What is known of the model of a loop as an estimate."""
    over_periods = float(report.final["free run"])
    if report.identified is not None:
        facts = report.identified.facts
        run = replace(facts.free_run, over_periods=over_periods)
        return replace(facts, free_run=run)

    model = report.model
    dofs = range(1, model.n_dof + 1)
    known_masses = [j for j in dofs if f"m{j}" not in report.bounds]
    facts = facts_of_model(
        model, report.bounds, report.free_runs, known_masses, over_periods
    )
    return replace(facts, unexplained=unexplained_by(report))


def unexplained_by(report: Loop) -> dict[int, float]:
    """Share of each equation of motion that the model leaves, percent, held out."""
    shares = {}
    for j in range(1, report.model.n_dof + 1):
        shares[j] = float(report.final.get(f"held-out dof {j}", np.nan))
    return shares


def _left_over(report: Loop) -> dict[int, LeftOver]:
    """What the final model leaves, where it is known what noise would leave."""
    left_over = {}
    for model, evidence in zip(report.models, report.evidence):
        if model is not report.model or evidence.floor is None:
            continue
        for j, noise in enumerate(evidence.floor.balance, start=1):
            size = evidence.sizes.loc[f"dof {j}"]
            if noise > 0 and np.isfinite(size["rms"]):
                percent = float(size["percent"])
                left_over[j] = LeftOver(float(size["rms"]), float(noise), percent)
    return left_over


def _unanswered(evidence: Sequence[Evidence]) -> dict[str, str]:
    """Questions to the residuals that have no answer, and why."""
    unanswered = {}
    for after_one_model in evidence:
        for question, obstacle in after_one_model.not_possible.items():
            if not obstacle.expected:
                unanswered[question] = obstacle.reason
    return unanswered
