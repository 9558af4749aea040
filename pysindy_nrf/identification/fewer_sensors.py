"""Masses and laws of a chain with fewer sensors than floors.

The free run of the chain is fitted to the channels that there are.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pandas as pd

from ..exceptions import (
    ChannelError,
    IdentifiabilityError,
    NRFWarning,
)
from ..records.dataset import Dataset
from ..records.input_arrays import lacks_motion
from ..records.record import Record
from .channel_estimate import ChannelEstimate, estimate
from .channel_shots import shot_of
from .determination import negative_dampers, poorly_determined
from .fewer_sensors_settings import SETTINGS
from .free_run_fit import Solution
from .hidden_motions import channel_errors, error_beyond_noise, motions_of
from .intervals import InfluenceResolver
from .linearised_run import Linearised
from .parameter_vector import Rebuild
from .parameters import Known, with_values
from .problem import Estimate, Problem, least_squares

__all__ = [
    "Linearised",
    "estimate",
    "identification_of",
    "identify_from_channels",
    "lacks_motion",
    "negative_dampers",
    "shot_of",
    "poorly_determined",
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
    model_error : float
        Largest share of a measured channel that the free run misses beyond its noise.
    """

    estimate: Estimate
    resolver: InfluenceResolver
    runs: Dataset
    channels: tuple[str, ...]
    errors: pd.DataFrame
    motions: list[pd.DataFrame]
    doubts: list[str]
    notes: list[str]
    model_error: float


def identify_from_channels(
    problem: Problem, records: Sequence[Record]
) -> ChannelIdentification:
    """Estimate a chain from records in which some floors have no sensor.

    Parameters
    ----------
    problem : Problem
    records : sequence of Record

    Raises
    ------
    ChannelError
        If a record or a constraint cannot be used.
    ExcitationError
        If nothing scales the chain.
    IdentifiabilityError
        If the channels do not determine the chain, or no chain follows them.
    """
    _refuse_bounds(problem.constraints)
    known = dict(problem.known_masses)
    shots = [
        shot_of(record, number, problem.chain.n_dof)
        for number, record in enumerate(records)
    ]
    return identification_of(
        problem, estimate(problem, shots, known, problem.constraints)
    )


def identification_of(
    problem: Problem, fitted: ChannelEstimate
) -> ChannelIdentification:
    """What follows from the best fit of a free run to the channels.

    Raises
    ------
    IdentifiabilityError
        If the channels do not determine the chain, or no chain follows them.
    """
    fit, solution, rivals = fitted
    doubts = rivals + negative_dampers(solution, fit.rebuild)
    notes = doubts + poorly_determined(solution, fit.rebuild)
    model = solution.model

    errors = channel_errors(fit.shots, model)
    _require_followed_channels(errors)
    model_errors = [error_beyond_noise(fit, shot, model) for shot in fit.shots]
    notes += _contradicted_values(problem, solution, fit.rebuild)

    runs = Dataset(
        [shot.run(model) for shot in fit.shots],
        sum(len(shot.segment.F) for shot in fit.shots),
    )
    along_runs = _equations_along(runs, problem, solution)
    resolver = InfluenceResolver(
        along_runs.grams,
        along_runs.order,
        dict(problem.known_masses),
        best=solution,
        rebuild=fit.rebuild,
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
        model_error=max(model_errors),
    )


def _refuse_bounds(constraints: Known) -> None:
    """Raise an error at a bound, which no residual of a fit stands for."""
    for name, known in constraints.items():
        if known.bounded:
            raise ChannelError(
                f"{name} {known} has bounds, which are for records in which every floor"
                " has a sensor",
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


def _contradicted_values(
    problem: Problem, solution: Solution, rebuild: Rebuild
) -> list[str]:
    """Sentences on known values from which the estimate is far away."""
    values = dict(zip(rebuild.names, rebuild.values(solution.u)))
    known = with_values(problem.constraints, rebuild.names, problem.chain)
    notes = []
    for name, parameter in known.items():
        if parameter.value is None or parameter.spread is None:
            continue
        gap = abs(values[name] - parameter.value)
        if gap > SETTINGS.contradicted * parameter.spread:
            notes.append(
                f"The data contradict {name} {parameter}: it came out as"
                f" {values[name]:.4g}."
            )
    return notes


def _equations_along(runs: Dataset, problem: Problem, solution: Solution) -> Estimate:
    """The equations of motion along the free runs, with the model of the fit."""
    model = solution.model
    if not problem.known_masses and not runs.forced:
        # by priors alone nothing scales the equations
        problem = problem.with_known_masses({1: model.masses[0]})
    along = replace(problem, laws=model.laws, optimizer=None, constraints={})
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        return least_squares(along, runs)._replace(model=model)
