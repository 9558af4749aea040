"""Masses and laws of a chain with fewer sensors than floors.

The free run of the chain is fitted to the channels that there are.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from ..records.record import Record
from .channel_estimate import estimate
from .channel_shots import shot_of
from .constraints import Constraint, NonNegative, Prior, as_constraints
from .determination import negative_dampers as negative
from .determination import poorly_determined as told
from .fewer_sensors_settings import SETTINGS
from .free_parameters import Rebuild
from .free_run_fit import Solution
from .hidden_motions import channel_errors, error_beyond_noise, motions_of
from .intervals import InfluenceResolver
from .linearised_run import Linearised
from .problem import Estimate, Problem

__all__ = [
    "Linearised",
    "estimate",
    "fit_fewer_sensors",
    "identify_from_channels",
    "lacks_motion",
    "negative",
    "shot_of",
    "told",
]


@dataclass(frozen=True)
class ChannelIdentification:
    """Estimate from records in which some floors have no sensor.

    Attributes
    ----------
    estimate : Estimate
        The model, with the equations of motion along its free runs.
    resolver : InfluenceResolver
        Of the intervals.
    runs : Dataset
        Free runs, in place of measured motions of all floors.
    channels : tuple of str
        The measured channels.
    errors : DataFrame
        Free-run errors of the measured channels, percent NRMSE.
    motions : list of DataFrame
        Motions of all DOFs and forces of all sites, with intervals, by record.
    doubts : list of str
        Why the chain may be another one; intervals are then withheld.
    notes : list of str
        All that a user should know, doubts first.
    """

    estimate: Estimate
    resolver: InfluenceResolver
    runs: Dataset
    channels: tuple[str, ...]
    errors: pd.DataFrame
    motions: list[pd.DataFrame]
    doubts: list[str]
    notes: list[str]


def lacks_motion(records: Any) -> bool:
    """Whether some floor has no sensor in a record."""
    if not all(isinstance(record, Record) for record in records):
        return False
    return any(_floors_without_sensor(record) for record in records)


def _floors_without_sensor(record: Record) -> set[int]:
    with_sensor = set()
    for dof in range(1, record.n_dof + 1):
        if {f"a{dof}", f"v{dof}", f"x{dof}"} & set(record.measured):
            with_sensor.add(dof)
    return set(range(1, record.n_dof + 1)) - with_sensor


def fit_fewer_sensors(estimator: Any, records: Sequence[Record]) -> Any:
    """Fit a regressor to records in which some floors have no sensor."""
    problem = estimator.problem(records[0].n_dof)
    result = identify_from_channels(problem, records, estimator.constraints)

    estimator._records = result.runs
    estimator._measured = False
    estimator.problem_ = result.estimate.problem
    estimator._resolver = result.resolver
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        estimator._publish(result.estimate, result.runs)
        estimator.model_.info["estimation"] = {
            "asked": estimator.estimation,
            "found": "simulation",
            "notes": result.notes,
            "sensors": result.channels,
            "doubts": result.doubts,
        }
        estimator._examine(result.estimate, result.runs, result.runs, False)

    estimator.missing_terms_ = estimator.missing_terms_[:0]
    estimator.jump_bias_ = estimator.jump_bias_[:0]
    estimator.errors_ = result.errors
    of_channels = result.errors.drop(index="pooled").set_index("of")["error"]
    table = pd.DataFrame([of_channels], index=["measured channels"])
    estimator._free = FreeRuns(table)
    estimator.motions_ = result.motions
    estimator.data_warnings_ = {
        "channels": [],
        "forces": [],
        "records": [],
        "masses": result.notes,
    }
    if result.notes:
        warn(" ".join(result.notes), BiasWarning)
    return estimator


def identify_from_channels(
    problem: Problem, records: Sequence[Record], constraints: Any = None
) -> ChannelIdentification:
    """Estimate a chain from records in which some floors have no sensor.

    Parameters
    ----------
    problem : Problem
    records : sequence of Record
    constraints : Constraint or sequence of Constraint, optional

    Raises
    ------
    ChannelError
        If a record or a constraint cannot be used.
    ExcitationError
        If nothing scales the chain.
    IdentifiabilityError
        If the channels do not determine the chain, or no chain follows them.
    """
    equations = as_constraints(constraints)
    _require_equations(equations)
    known = dict(problem.known_masses)
    shots = [
        shot_of(record, number, problem.chain.n_dof)
        for number, record in enumerate(records)
    ]
    fit, solution, rivals = estimate(problem, shots, known, equations)
    doubts = rivals + negative(solution, fit.rebuild)
    notes = doubts + told(solution, fit.rebuild)
    model = solution.model

    errors = channel_errors(fit.shots, model)
    _require_followed_channels(errors)
    model_errors = [error_beyond_noise(fit, shot, model) for shot in fit.shots]
    notes += _contradicted_priors(equations, solution, fit.rebuild)
    notes += _note_on_model_error(max(model_errors))

    runs = Dataset(
        [shot.run(model) for shot in fit.shots],
        sum(len(shot.segment.F) for shot in shots),
    )
    along_runs = _equations_along(runs, problem, solution)
    resolver = InfluenceResolver(
        along_runs.grams, along_runs.order, known, best=solution, rebuild=fit.rebuild
    )
    motions = []
    for number, error in enumerate(model_errors):
        motions.append(motions_of(fit, number, solution, error))
    return ChannelIdentification(
        estimate=along_runs,
        resolver=resolver,
        runs=runs,
        channels=fit.shots[0].channels,
        errors=errors,
        motions=motions,
        doubts=doubts,
        notes=notes,
    )


def _require_equations(constraints: Sequence[Constraint]) -> None:
    """Raise an error at a bound, which no residual of a fit stands for."""
    for constraint in constraints:
        if isinstance(constraint, NonNegative):
            raise ChannelError(
                f"{constraint!r} is for records in which every floor has a sensor",
                "Leave it out.",
            )


def _require_followed_channels(errors: pd.DataFrame) -> None:
    """Raise an error if the best free run misses most of the channels."""
    missed = errors["error"]["pooled"]
    if missed > 100 * SETTINGS.refused_error:
        raise IdentifiabilityError(
            f"The best free run misses {missed:.0f} % of the measured channels",
            "Add a sensor (Chain.sensing says where), declare the law that the chain"
            " lacks, or reduce the noise.",
        )


def _contradicted_priors(
    constraints: Sequence[Constraint], solution: Solution, rebuild: Rebuild
) -> list[str]:
    """Sentences on priors from which the estimate is far away."""
    values = dict(zip(rebuild.names, rebuild.values(solution.u)))
    notes = []
    for prior in constraints:
        if not isinstance(prior, Prior):
            continue
        value = values[prior.parameter]
        if abs(value - prior.value) > SETTINGS.contradicted * prior.spread:
            notes.append(f"The data contradict {prior!r}: it came out as {value:.4g}.")
    return notes


def _note_on_model_error(share: float) -> list[str]:
    if share <= 0:
        return []
    return [
        f"The model misses {100 * share:.2g} % of a measured channel beyond its noise."
        " Intervals of motions hold that, those of parameters do not: search for what"
        " it lacks (close_loop)."
    ]


def _equations_along(runs: Dataset, problem: Problem, solution: Solution) -> Estimate:
    """The equations of motion along the free runs, with the model of the fit."""
    model = solution.model
    if not problem.known_masses and not runs.forced:
        # by priors alone nothing scales the equations
        problem = problem.with_known_masses({1: model.masses[0]})
    along = replace(problem, laws=model.laws, optimizer=None)
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        return along.solve(runs)._replace(model=model)
