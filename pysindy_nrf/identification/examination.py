"""What may be wrong with an estimate: channels, records, forces, laws and masses."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from operator import attrgetter

import pandas as pd

from ..chain.model import ChainModel
from ..common.plain_tables import PlainState
from ..diagnosis import bias
from ..diagnosis.force_channels import ForceProbes, copies_of
from ..diagnosis.sample_windows import collect
from ..equations.chain_solve import doubtful_masses
from ..equations.errors import balance_errors
from ..exceptions import NRFError, NRFWarning
from ..laws.forcing import lost_masses
from ..records.dataset import Dataset
from ..records.quality import QualityNote
from .intervals import Resolver
from .problem import Estimate, Problem, least_squares

# A known mass is wrong if the balances, with it left free, leave less than this share
# of what they left before, and it differs by more than this share of itself. Of 36
# shaken chains with one mass 20 % wrong all are named, of 18 with right ones none: a
# right mass that is freed leaves what was left or more, a wrong one 74 % at most.
_LEFT_WITH_RIGHT_MASS = 0.8
_OTHER_MASS = 0.03
# Masses that leave this many times the least error, when freed, are named beside it.
_AS_GOOD = 1.5
_CURE_OF_LOST_MASS = (
    "is its known mass right, or does its force or acceleration have the wrong sign?"
)


@cache
def _no_missing_terms() -> pd.DataFrame:
    columns = ["residual", "gain", "missing", "shift", "lasting"]
    return pd.DataFrame(columns=columns, dtype=float).assign(biased=False)


@cache
def _no_jumps() -> pd.DataFrame:
    return pd.DataFrame(columns=["found", "away", "lost", "wrong", "unit"])


@dataclass(frozen=True)
class Examination(PlainState):
    """What an examination found; empty tables and lists where nothing was looked at.

    Attributes
    ----------
    missing_terms : DataFrame
        Share of each residual that further terms would explain, step by step.
    jump_bias : DataFrame
        Coefficients of forces that jump, with and without the samples near the jumps.
    quality : tuple of QualityNote
        What is known of channels, clocks and units.
    n_records : int
    forces, records, masses : list of str
        Sentences on what is doubtful.
    """

    missing_terms: pd.DataFrame = field(default_factory=_no_missing_terms)
    jump_bias: pd.DataFrame = field(default_factory=_no_jumps)
    quality: tuple[QualityNote, ...] = ()
    n_records: int = 1
    forces: list[str] = field(default_factory=list)
    records: list[str] = field(default_factory=list)
    masses: list[str] = field(default_factory=list)

    @property
    def channels(self) -> list[str]:
        """Faults of the channels, in sentences."""
        sentences = []
        for note in filter(attrgetter("is_fault"), self.quality):
            where = f"Record {note.record!r}: " if self.n_records > 1 else ""
            sentences.append(where + note.message)
        return list(dict.fromkeys(sentences))

    def warn_of_bias(self) -> None:
        """Give one BiasWarning if there is a doubt that is not of the channels."""
        doubts = [*self.records, *self.forces, *self.masses]
        doubts += bias.sentences_of(self.jump_bias)
        bias.warn_of_bias(self.missing_terms, doubts)


@dataclass(frozen=True)
class Finding:
    """What a method found, before it is examined.

    Attributes
    ----------
    estimate : Estimate
    data : Dataset
        The motions that its errors are of.
    asked : str
        The setting of ``estimation``.
    method : str
        The method whose estimate was kept.
    notes : tuple of str
        Why another method could not be used, and what else the method found.
    doubts : tuple of str
        Sentences to warn of.
    details : dict of str to object
        Of the method, for ``model.info``.
    resolver : Resolver, optional
        Solves again on pieces of the data; least squares of the data if None.
    by_least_squares : Estimate, optional
        The least-squares estimate by which channels and laws are examined; the estimate
        itself if it is one.
    judged : Dataset, optional
        Other motions on which missing laws are looked for.
    in_memory : bool
        False if ``data`` are windows of what was read in pieces.
    """

    estimate: Estimate
    data: Dataset
    asked: str
    method: str
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    details: Mapping[str, object] = field(default_factory=dict)
    resolver: Resolver | None = None
    by_least_squares: Estimate | None = None
    judged: Dataset | None = None
    in_memory: bool = True

    @property
    def is_least_squares(self) -> bool:
        """Whether the estimate is one of least squares."""
        return self.by_least_squares is self.estimate

    @property
    def facts(self) -> dict[str, object]:
        """What ``model.info`` holds of the method."""
        facts: dict[str, object] = {"asked": self.asked, "found": self.method}
        if self.notes:
            facts["notes"] = list(self.notes)
        return facts | dict(self.details)


def examined(
    finding: Finding, estimate: Estimate, identified: ChainModel, error: float
) -> Examination:
    """Examine what a method found on its data.

    Parameters
    ----------
    finding : Finding
    estimate : Estimate
        By which channels and laws are examined; it obeys what is known of the
        parameters.
    identified : ChainModel
        The model that the user gets, of whose masses the sentences speak.
    error : float
        What the balances of the fit leave, pooled, percent.
    """
    data = finding.data
    judged = finding.judged or data
    problem = estimate.problem
    model = estimate.model
    layout = problem.layout if finding.by_least_squares is not None else None
    missing = bias.MissingTerms(model, estimate.order, layout)
    jumps = bias.JumpBias(
        model,
        estimate.order,
        problem.known_masses,
        problem.optimizer,
        silent=problem.band is not None or not finding.is_least_squares,
        layout=layout,
    )
    # beside a fusion they cost little; a fit of arrays would take twice the time
    probes = [ForceProbes(missing.layout, judged)] if data.records else []
    collect(missing.layout, judged, problem.band, [missing, *jumps.active, *probes])

    # noise biases each equation by itself, and instruments do not mind it
    solution = finding.estimate.solution
    forces = bias.contradictions_of(solution)
    for probe in probes:
        forces += probe.sentences()
    units = identified.units
    masses = doubtful_masses(solution, identified.masses.tolist(), units)
    for sentence in lost_masses(identified.masses, identified.laws, units):
        masses.append(f"{sentence}: {_CURE_OF_LOST_MASS}")
    if data.records:
        masses += _wrong_masses(problem, data, error)

    return Examination(
        missing_terms=missing.table(),
        jump_bias=jumps.table(),
        quality=data.quality,
        n_records=len(data.segments),
        forces=forces,
        records=copies_of(data) if finding.in_memory else [],
        masses=masses,
    )


def _wrong_masses(problem: Problem, data: Dataset, error: float) -> list[str]:
    """A sentence on known masses that the others contradict.

    Left free, they explain most of what the balances leave.
    """
    freed = sorted(_freed_masses(problem, data, error))
    if not freed:
        return []

    least, *_ = freed[0]
    named = []
    for remaining, mass, j in freed:
        if remaining < _AS_GOOD * least:
            known = problem.known_masses[j]
            unit = problem.chain.units.mass
            named.append(f"m{j} is {mass:.4g} {unit}, not {known:.4g}")
    return [
        f"The known masses contradict each other: left free, {'; or '.join(named)}; and"
        f" {least:.2g} % of the balances is unexplained instead of {error:.2g} %. Weigh"
        " it again."
    ]


def _freed_masses(
    problem: Problem, data: Dataset, error: float
) -> Iterator[tuple[float, float, int]]:
    """Error of the balances, mass and DOF of every known mass that prefers another."""
    weighed = [j for j, mass in problem.known_masses.items() if mass]
    if len(weighed) < 2:
        return

    for j in weighed:
        others = dict(problem.known_masses)
        known = others.pop(j)
        try:
            with warnings.catch_warnings(action="ignore", category=NRFWarning):
                freed = least_squares(problem.with_known_masses(others), data)
        except NRFError:
            continue
        mass = float(freed.model.masses[j - 1])
        errors = balance_errors(freed.model, freed.grams)
        remaining = float(errors.loc["pooled", "error"])
        better = remaining < _LEFT_WITH_RIGHT_MASS * error
        if better and abs(mass / known - 1) > _OTHER_MASS:
            yield remaining, mass, j
