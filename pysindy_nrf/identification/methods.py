"""Methods of identification: what each requires, which arguments it uses, what it does.

Every method turns a problem and its data into an :class:`IdentificationResult`. The
door (:mod:`.door`) chooses one, and refuses what it does not use.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Generic, TypeVar

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..common.warn import warn_user
from ..diagnosis import bias
from ..equations.chain_solve import third_law_gap, unknown_forces, visited_regions
from ..equations.errors import balance_errors
from ..exceptions import BiasWarning, DataQualityWarning, RankWarning
from ..records.dataset import Dataset
from ..records.files.frequency_response import FrequencyResponse
from ..records.input_arrays import (
    Input,
    InputSettings,
    as_dataset,
    with_motion_checks,
)
from ..records.zero_phase_filter import Band
from .constraints import constrained
from .examination import Finding, examined
from .hausman import Difference, difference_of
from .intervals import Resolver, least_squares_resolver
from .offsets import least_squares_beside_offsets
from .output_error import refine
from .problem import Estimate, Problem
from .result import IdentificationResult
from .shape_derivatives import shapes_of_motion

# What data may provide and methods may require, in the words of messages.
EVERY_FLOOR = "a sensor on every floor"
WHOLE_RECORDS = "whole records in memory"
RECORDS = "Records"
RESPONSES = "frequency responses"

# Percent of the balances, pooled, below which noise in the motion biases nothing: it
# takes 1e-6 of a mass, times the condition of the columns.
CLOSED = 0.1

# Squared balance error of instruments over that of least squares, above which they
# disagree because a law is missing: the free run that makes the instruments lacks it,
# too. EMPS, all of it, halves and quarters: 1.1 to 1.3 with friction declared, 1.9 with
# a dashpot alone.
MOST_LEFT = 1.5

Data = TypeVar("Data", Dataset, FrequencyResponse)


@dataclass(frozen=True)
class IdentificationMethod(ABC, Generic[Data]):
    """A method of identification.

    Parameters
    ----------
    asked : str
        The setting of ``estimation`` by which it was chosen.

    Attributes
    ----------
    name : str
        In ``model.info``.
    label : str
        In messages.
    requires : frozenset of str
        What the data must provide.
    uses : frozenset of str
        The arguments that have a part in it, of those that not every method uses.
    """

    asked: str = "auto"

    name: ClassVar[str]
    label: ClassVar[str]
    requires: ClassVar[frozenset[str]]
    uses: ClassVar[frozenset[str]]

    @abstractmethod
    def read(self, passed: Input, settings: InputSettings) -> Data:
        """The data as this method needs them."""

    @abstractmethod
    def identify(self, problem: Problem, data: Data) -> IdentificationResult:
        """Masses and laws of a problem from its data."""


def _measured_motions(passed: Input, settings: InputSettings) -> Dataset:
    """Motions of all floors, with notes on those that do not fit each other."""
    data = as_dataset(passed, settings)
    if data.records or isinstance(passed.X, Dataset):
        return data
    return with_motion_checks(data)


class LeastSquares(IdentificationMethod[Dataset]):
    """Least squares of the balances; noise in the motion biases it."""

    name = "ls"
    label = "least squares"
    requires = frozenset({EVERY_FLOOR})
    uses = frozenset(
        {"sample_weight", "optimizer", "strategy", "constraints", "band", "varying"}
    )

    def read(self, passed: Input, settings: InputSettings) -> Dataset:
        """Motions of all floors."""
        return _measured_motions(passed, settings)

    def identify(self, problem: Problem, data: Dataset) -> IdentificationResult:
        """Masses and laws of a problem from its data."""
        estimate, data = least_squares_beside_offsets(problem, data)
        return examined_result(self.finding(estimate, data))

    def finding(self, estimate: Estimate, data: Dataset) -> Finding:
        """A least-squares estimate as what was found."""
        return Finding(estimate, data, self.asked, self.name, by_least_squares=estimate)


class InstrumentalVariables(IdentificationMethod[Dataset]):
    """Instruments from the model's own free run; noise in the motion does not matter.

    Where no free run can serve, the least-squares estimate is kept, with a warning.
    """

    name = "iv"
    label = "instrumental variables"
    refinement: ClassVar[str] = "iv"
    requires = frozenset({EVERY_FLOOR, WHOLE_RECORDS})
    uses = frozenset({"optimizer", "strategy", "constraints", "band"})

    def read(self, passed: Input, settings: InputSettings) -> Dataset:
        """Records fused so that they can be fused again, each DOF by itself."""
        return _measured_motions(passed, replace(settings, both_fusions=True))

    def identify(self, problem: Problem, data: Dataset) -> IdentificationResult:
        """Masses and laws of a problem from its data."""
        start, data = least_squares_beside_offsets(problem, data)
        finding = self.refined(problem, start, data)
        _warn_of_doubts(finding)
        return examined_result(finding)

    def refined(self, problem: Problem, start: Estimate, data: Dataset) -> Finding:
        """What this method makes of a least-squares estimate; it warns of nothing."""
        same_terms = replace(problem, optimizer=start.problem.optimizer)
        refinement = refine(self.refinement, same_terms, start, _fused_apart(data))
        if refinement.resolver is None:
            by_least_squares = LeastSquares(self.asked).finding(start, data)
            return replace(
                by_least_squares, notes=refinement.notes, doubts=refinement.doubts
            )

        estimate = refinement.estimate
        if estimate.problem is not start.problem:
            # other shape parameters give other columns
            order = estimate.problem.solve_order(data.forced, data.unknown)
            sums = estimate.problem.normal_equations(data, order)
            estimate = estimate._replace(grams=sums)
        return Finding(
            estimate,
            data,
            asked=self.asked,
            method=refinement.method,
            notes=refinement.notes,
            doubts=refinement.doubts,
            details=refinement.facts,
            resolver=refinement.resolver,
            judged=refinement.judged,
        )


class OutputError(InstrumentalVariables):
    """The free run fitted to the motion, from instrumental variables on.

    It is kept where it predicts parts of the records better that it did not see.
    """

    name = "simulation"
    label = "the free run fitted to the motion"
    refinement = "simulation"


class LeastSquaresOrInstruments(InstrumentalVariables):
    """Instruments if they serve, or least squares that finds the same.

    Least squares is taken where there is no noise to speak of, and where the test of
    Durbin, Wu and Hausman does not distinguish it from the instruments.
    """

    name = "auto"
    label = "least squares or instrumental variables"
    refinement = "auto"
    requires = InstrumentalVariables.requires | {RECORDS}

    def identify(self, problem: Problem, data: Dataset) -> IdentificationResult:
        """Masses and laws of a problem from its data."""
        start, data = least_squares_beside_offsets(problem, data)
        plain = LeastSquares(self.asked).finding(start, data)
        noise_matters = _noise_matters(start, data)
        if not noise_matters and _closes(start, data):
            return examined_result(plain)

        finding = self.refined(problem, start, data)
        if not noise_matters:
            difference = _difference(start, data, finding)
            if difference is None or not difference.matters:
                return examined_result(plain)
            if _leaves_more(finding, start):
                result = examined_result(plain)
                return replace(result, doubts=(*result.doubts, difference.sentence))

        if not finding.is_least_squares:
            _warn_of_doubts(finding)
            # the channels are examined by least squares of what was measured
            finding = replace(finding, by_least_squares=start, judged=None)
        return examined_result(finding)


class InstrumentsWithoutFreeRun(LeastSquaresOrInstruments):
    """The same without a fit of the free run, which takes many times longer."""

    refinement = "iv"


def _warn_of_doubts(finding: Finding) -> None:
    """One warning of everything that is doubtful of an estimate."""
    if not finding.is_least_squares:
        for text in finding.estimate.solution.dependent:
            warn_user(text, RankWarning)
    if finding.doubts:
        warn_user(" ".join(finding.doubts), BiasWarning)


def _noise_matters(estimate: Estimate, data: Dataset) -> bool:
    """Whether noise in the motion biases least squares beyond its standard errors.

    Of shape parameters of the motion it is not known how much any noise biases them.
    """
    shares = bias.noise_shares(data, estimate.problem.filters(data))
    biases = bias.noise_bias(estimate.model, estimate.order, estimate.grams, shares)
    if biases and shapes_of_motion(estimate.declared):
        return True
    return max((balance.errors for balance in biases), default=0.0) > bias.NEGLIGIBLE


def _closes(estimate: Estimate, data: Dataset) -> bool:
    """Whether the equations of motion close so well that noise cannot bias them.

    Noise leaves at least its own force in them, and biases by the square of its share.
    """
    if any(note.kind == "computed" for note in data.quality):
        return True
    errors = balance_errors(estimate.model, estimate.grams)
    return bool(errors.loc["pooled", "error"] < CLOSED)


def _difference(start: Estimate, data: Dataset, finding: Finding) -> Difference | None:
    """Instruments less least squares; None where none serve."""
    if finding.is_least_squares or finding.resolver is None:
        return None
    apart = _fused_apart(data)
    return difference_of(start, apart, finding.estimate.model, finding.resolver)


def _leaves_more(finding: Finding, start: Estimate) -> bool:
    """Whether instruments leave so much more that a law is missing, not only noise."""
    errors = []
    for estimate in (finding.estimate, start):
        table = balance_errors(estimate.model, estimate.grams)
        errors.append(float(table.loc["pooled", "error"]))
    return errors[0] ** 2 > MOST_LEFT * errors[1] ** 2


def _fused_apart(data: Dataset) -> Dataset:
    # the joint fusion has warned of the channels
    with warnings.catch_warnings(action="ignore", category=DataQualityWarning):
        return data.apart


# -- from an estimate to a result ----------------------------------------------------


def result_of(finding: Finding) -> IdentificationResult:
    """The result of an estimate that obeys what is known, not yet examined."""
    estimate = finding.estimate
    resolver = finding.resolver
    model, constrain = _obeying(estimate, resolver, finding.data)
    if resolver is not None:
        resolver = replace(resolver, constrain=constrain)

    problem = estimate.problem.with_laws(model.laws)
    errors = balance_errors(model, estimate.grams)
    visited = visited_regions(finding.data, problem.layout)
    info = {
        "band": finite_band(problem.band),
        "strategy": estimate.order.strategy,
        "n_samples": int(estimate.grams.n_samples),
        "balance_error_percent": {
            name: float(error)
            for name, error in errors["error"].items()
            if np.isfinite(error)
        },
        "estimation": finding.facts,
    }
    condition = {fit.step.name: fit.condition for fit in estimate.solution.fits}
    return IdentificationResult(
        model=ChainModel(model.masses, model.laws, model.chain, visited, info),
        problem=problem,
        order=estimate.order,
        method=finding.method,
        errors=errors,
        sums=estimate.grams,
        condition=pd.Series(condition, name="condition", dtype=float),
        third_law_gap=third_law_gap(estimate.solution, estimate.grams),
        unknown_forces=unknown_forces(model, finding.data),
        inner=estimate.solution.inner,
        data=finding.data,
        resolver=resolver,
        constrain=constrain,
        biased_by_noise=finding.is_least_squares,
        notes=finding.notes,
        declared=estimate.declared,
    )


def examined_result(finding: Finding) -> IdentificationResult:
    """The result of an estimate, examined; doubts are given as one warning."""
    result = result_of(finding)
    if finding.by_least_squares is None or finding.is_least_squares:
        estimate = finding.estimate._replace(model=result.model)
    else:
        model, _ = _obeying(finding.by_least_squares, None, finding.data)
        estimate = finding.by_least_squares._replace(model=model)

    error = float(result.errors.loc["pooled", "error"])
    examination = examined(finding, estimate, result.model, error)
    examination.warn_of_bias()
    if finding.estimate.solution.dependent and result.smaller_order is not None:
        warn_user(f"The model has too many terms: {result.smaller_order}", RankWarning)
    return replace(result, examination=examination)


Constrain = Callable[[ChainModel], ChainModel]


def _obeying(
    estimate: Estimate, resolver: Resolver | None, data: Dataset
) -> tuple[ChainModel, Constrain | None]:
    """The model that obeys what is known, and the function that makes others obey."""
    problem = estimate.problem
    if not problem.constraints:
        return estimate.model, None
    if resolver is None:
        resolver = least_squares_resolver(problem, estimate.order, data)
    return constrained(estimate.model, problem.constraints, resolver)


def finite_band(band: Band) -> list[float | None] | None:
    """A band, Hz, with None for an edge that is not there, as JSON takes it."""
    if band is None:
        return None
    return [None if edge is None or np.isinf(edge) else float(edge) for edge in band]
