"""Methods of identification: what each requires, which arguments it uses, what it does.

Every method turns a problem and its data into an :class:`IdentificationResult`. The
door (:mod:`.door`) chooses one, and refuses what it does not use.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..common.warn import warn_user
from ..diagnosis import bias
from ..equations.chain_solve import third_law_gap, unknown_forces, visited_regions
from ..equations.errors import balance_errors
from ..exceptions import DataQualityWarning
from ..records.dataset import Dataset
from ..records.input_arrays import (
    Input,
    InputSettings,
    as_dataset,
    with_motion_checks,
)
from .constraints import constrained
from .examination import Finding, examined
from .intervals import Resolver, least_squares_resolver
from .output_error import refine
from .problem import Estimate, Problem, least_squares
from .result import IdentificationResult

# What data may provide and methods may require, in the words of messages.
EVERY_FLOOR = "a sensor on every floor"
WHOLE_RECORDS = "whole records in memory"
RECORDS = "Records"
RESPONSES = "frequency responses"


@dataclass(frozen=True)
class IdentificationMethod(ABC):
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

    def read(self, given: Input, settings: InputSettings) -> Any:
        """The data as this method needs them."""
        data = as_dataset(given, settings)
        if data.records or isinstance(given.X, Dataset):
            return data
        return with_motion_checks(data)

    @abstractmethod
    def identify(self, problem: Problem, data: Any) -> IdentificationResult:
        """Masses and laws of a problem from its data."""


class LeastSquares(IdentificationMethod):
    """Least squares of the balances; noise in the motion biases it."""

    name = "ls"
    label = "least squares"
    requires = frozenset({EVERY_FLOOR})
    uses = frozenset({"sample_weight", "optimizer", "strategy", "constraints", "band"})

    def identify(self, problem: Problem, data: Dataset) -> IdentificationResult:
        """Masses and laws of a problem from its data."""
        return examined_result(self.finding(least_squares(problem, data), data))

    def finding(
        self, estimate: Estimate, data: Dataset, notes: tuple[str, ...] = ()
    ) -> Finding:
        """A least-squares estimate as what was found.

        ``notes`` say why another method could not be used.
        """
        facts: dict[str, Any] = {"asked": self.asked, "found": self.name}
        if notes:
            facts["notes"] = list(notes)
        return Finding(estimate, data, facts, by_least_squares=estimate)


class InstrumentalVariables(IdentificationMethod):
    """Instruments from the model's own free run; noise in the motion does not matter.

    Where no free run can serve, the least-squares estimate is kept, with a warning.
    """

    name = "iv"
    label = "instrumental variables"
    refinement: ClassVar[str] = "iv"
    requires = frozenset({EVERY_FLOOR, WHOLE_RECORDS})
    uses = frozenset({"optimizer", "strategy", "constraints", "band"})

    def read(self, given: Input, settings: InputSettings) -> Dataset:
        """Records fused so that they can be fused again, each DOF by itself."""
        return super().read(given, replace(settings, both_fusions=True))

    def identify(self, problem: Problem, data: Dataset) -> IdentificationResult:
        """Masses and laws of a problem from its data."""
        start = least_squares(problem, data)
        return examined_result(self.refined(problem, start, data))

    def refined(self, problem: Problem, start: Estimate, data: Dataset) -> Finding:
        """What this method makes of a least-squares estimate."""
        refinement = refine(self.refinement, problem, start, _fused_apart(data))
        estimate, resolver, facts, judged = refinement
        if resolver is None:
            return LeastSquares(self.asked).finding(start, data)
        if estimate.problem is not start.problem:
            # other shape parameters give other columns
            order = estimate.problem.solve_order(data.forced, data.unknown)
            sums = estimate.problem.normal_equations(data, order)
            estimate = estimate._replace(grams=sums)
        facts["asked"] = self.asked
        return Finding(estimate, data, facts, resolver, judged=judged)


class OutputError(InstrumentalVariables):
    """The free run fitted to the motion, from instrumental variables on.

    It is kept where it predicts parts of the records better that it did not see.
    """

    name = "simulation"
    label = "the free run fitted to the motion"
    refinement = "simulation"


class LeastSquaresOrInstruments(InstrumentalVariables):
    """Least squares where its noise is negligible, else instruments if they serve."""

    name = "auto"
    label = "least squares or instrumental variables"
    requires = InstrumentalVariables.requires | {RECORDS}

    def identify(self, problem: Problem, data: Dataset) -> IdentificationResult:
        """Masses and laws of a problem from its data."""
        by_least_squares = LeastSquares(self.asked)
        start = least_squares(problem, data)
        if not _noise_matters(start, data):
            return examined_result(by_least_squares.finding(start, data))

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = self.refined(problem, start, data)
        notes = tuple(str(one.message) for one in caught)
        if found.resolver is None:
            return examined_result(by_least_squares.finding(start, data, notes))

        for kind, text in zip((one.category for one in caught), notes):
            warn_user(text, kind)
        facts = found.facts | {"notes": list(notes)}
        # the channels are examined by least squares of what was measured
        return examined_result(
            replace(found, facts=facts, by_least_squares=start, judged=None)
        )


def _noise_matters(estimate: Estimate, data: Dataset) -> bool:
    """Whether noise in the motion biases least squares beyond its standard errors."""
    shares = bias.noise_shares(data, estimate.problem.filters(data))
    biases = bias.noise_bias(estimate.model, estimate.order, estimate.grams, shares)
    return max((one.errors for one in biases), default=0.0) > bias.NEGLIGIBLE


def _fused_apart(data: Dataset) -> Dataset:
    # the joint fusion has warned of the channels
    with warnings.catch_warnings(action="ignore", category=DataQualityWarning):
        return data.apart


# -- from an estimate to a result ----------------------------------------------------


def result_of(found: Finding) -> IdentificationResult:
    """The result of an estimate that obeys what is known, not yet examined."""
    estimate = found.estimate
    model, constrain = _obeying(estimate, found.resolver, found.data)
    resolver = found.resolver
    if resolver is not None:
        resolver = replace(resolver, constrain=constrain)

    problem = estimate.problem.with_laws(model.laws)
    errors = balance_errors(model, estimate.grams)
    visited = visited_regions(found.data, problem.layout)
    info = {
        "band": finite_band(problem.band),
        "strategy": estimate.order.strategy,
        "n_samples": int(estimate.grams.n_samples),
        "balance_error_percent": {
            name: float(error)
            for name, error in errors["error"].items()
            if np.isfinite(error)
        },
        "estimation": found.facts,
    }
    condition = {fit.step.name: fit.condition for fit in estimate.solution.fits}
    return IdentificationResult(
        model=ChainModel(model.masses, model.laws, model.chain, visited, info),
        problem=problem,
        order=estimate.order,
        method=found.facts["found"],
        errors=errors,
        sums=estimate.grams,
        condition=pd.Series(condition, name="condition", dtype=float),
        third_law_gap=third_law_gap(estimate.solution, estimate.grams),
        unknown_forces=unknown_forces(model, found.data),
        inner=estimate.solution.inner,
        data=found.data,
        resolver=resolver,
        constrain=constrain,
        biased_by_noise=found.is_least_squares,
        notes=tuple(found.facts.get("notes", ())),
    )


def examined_result(found: Finding) -> IdentificationResult:
    """The result of an estimate, examined; doubts are given as one warning."""
    result = result_of(found)
    if found.by_least_squares is None or found.is_least_squares:
        estimate = found.estimate._replace(model=result.model)
    else:
        model, _ = _obeying(found.by_least_squares, None, found.data)
        estimate = found.by_least_squares._replace(model=model)

    error = float(result.errors.loc["pooled", "error"])
    examination = examined(found, estimate, error)
    examination.warn_of_bias()
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


def finite_band(band: Any) -> list[float | None] | None:
    """A band, Hz, with None for an edge that is not there, as JSON takes it."""
    if band is None:
        return None
    return [None if edge is None or np.isinf(edge) else float(edge) for edge in band]
