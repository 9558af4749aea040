"""The free run fitted to the channels of records in which some floor has no sensor."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import pandas as pd

from ..common.warn import warn
from ..diagnosis.verdict import FreeRuns
from ..exceptions import (
    BiasWarning,
    ChannelError,
    IdentifiabilityError,
    NRFWarning,
)
from ..records.dataset import Dataset
from ..records.input_arrays import Input, InputSettings, as_dataset
from .examination import Examination, Finding
from .fewer_sensors import (
    UNKNOWN,
    _channel_errors,
    _model_error,
    _motions,
    _names,
    estimate,
    negative,
    shot_of,
    told,
)
from .intervals import InfluenceResolver
from .methods import RECORDS, IdentificationMethod, result_of
from .output_error import FreeRunFit, Solution
from .parameters import Known, with_values
from .problem import Problem, least_squares
from .result import IdentificationResult

# Standard deviations from what is known of a parameter that chance does not explain
# (p = 0.001).
_CONTRADICTION = 3.3


class ChannelFit(IdentificationMethod):
    """The free run fitted to the channels; the only method for floors without one."""

    name = "simulation"
    label = "the free run fitted to the measured channels"
    requires = frozenset({RECORDS})
    uses = frozenset({"constraints", "band"})

    def read(self, given: Input, settings: InputSettings) -> Dataset:
        """The records as they were measured."""
        return as_dataset(given, replace(settings, fuse=False))

    def identify(self, problem: Problem, data: Dataset) -> IdentificationResult:
        """Masses and laws of a problem, and the motions of all floors."""
        known_masses = dict(problem.known_masses)
        _refuse_bounds(problem.constraints)
        shots = [
            shot_of(record, number, problem.chain.n_dof)
            for number, record in enumerate(data.records)
        ]
        fit, best, doubts = estimate(problem, shots, known_masses, problem.constraints)
        doubts = doubts + negative(best, fit.rebuild)
        errors = _channel_errors(fit.shots, best.model)
        notes = doubts + told(best, fit.rebuild)
        _require_fit(errors)
        beyond_noise = [_model_error(fit, shot, best.model) for shot in fit.shots]
        notes += _contradictions(problem, fit, best)
        notes += _sentence_on_model_error(max(beyond_noise))

        facts = {
            "asked": self.asked,
            "found": self.name,
            "notes": notes,
            "sensors": fit.shots[0].channels,
            "doubts": doubts,
        }
        result = _result_of_runs(problem, fit, best, facts)
        motions = [
            _motions(fit, number, best, error)
            for number, error in enumerate(beyond_noise)
        ]
        if notes:
            warn(" ".join(notes), BiasWarning)
        return replace(
            result,
            errors=errors,
            motions=motions,
            examination=Examination(masses=notes),
            doubts=tuple(doubts),
            channel_runs=_runs_of_channels(errors),
        )


def _result_of_runs(
    problem: Problem, fit: FreeRunFit, best: Solution, facts: dict[str, Any]
) -> IdentificationResult:
    """The result whose motions are the free runs."""
    known_masses = dict(problem.known_masses)
    segments = [shot.run(best.model) for shot in fit.shots]
    runs = Dataset(segments, sum(segment.n_samples for segment in segments))
    solved = replace(problem, laws=best.model.laws, optimizer=None, constraints={})
    if not known_masses and not runs.forced:
        # ratios to a mass come out
        solved = solved.with_known_masses({1: best.model.masses[0]})

    # sums, order and conditions are those of the balances along the runs
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        along_runs = least_squares(solved, runs)._replace(model=best.model)
        resolver = InfluenceResolver(
            along_runs.grams,
            along_runs.order,
            known_masses,
            best=best,
            rebuild=fit.rebuild,
        )
        return result_of(Finding(along_runs, runs, facts, resolver))


def _refuse_bounds(known: Known) -> None:
    for name, parameter in known.items():
        if parameter.bounded:
            raise ChannelError(
                f"{name} {parameter} has bounds, which are for records in which every"
                " floor has a sensor",
                "Leave it out.",
            )


def _require_fit(errors: pd.DataFrame) -> None:
    missed = errors["error"]["pooled"]
    if missed > 100 * UNKNOWN:
        raise IdentifiabilityError(
            f"The best free run misses {missed:.0f} % of the measured channels",
            "Add a sensor (Chain.sensing says where), declare the law that the chain"
            " lacks, or reduce the noise.",
        )


def _contradictions(problem: Problem, fit: FreeRunFit, best: Solution) -> list[str]:
    """Sentences on parameters that came out far from what is known of them."""
    names = _names(fit.rebuild)
    values = dict(zip(names, fit.rebuild.numbers(best.u)))
    sentences = []
    for name, known in with_values(problem.constraints, names, problem.chain).items():
        if known.value is None or known.spread is None:
            continue
        if abs(values[name] - known.value) > _CONTRADICTION * known.spread:
            sentences.append(
                f"The data contradict {name} {known}: it came out as"
                f" {values[name]:.4g}."
            )
    return sentences


def _sentence_on_model_error(share: float) -> list[str]:
    if not share > 0:
        return []
    return [
        f"The model misses {100 * share:.2g} % of a measured channel beyond its noise."
        " Intervals of motions hold that, those of parameters do not: search for what"
        " it lacks (close_loop)."
    ]


def _runs_of_channels(errors: pd.DataFrame) -> FreeRuns:
    """Free-run errors of the measured channels, as of free runs over all floors."""
    by_channel = errors.drop(index="pooled").set_index("of")["error"]
    return FreeRuns(pd.DataFrame([by_channel], index=["measured channels"]))
