"""Coefficients in time from a fit: what changes, how, and how sure that is."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ...common.warn import warn_user
from ...exceptions import BiasWarning, ChainError
from ..problem import Problem
from .followed import Followed
from .judgement import Judgement
from .pieces import pieces_of_record
from .request import AUTO, VaryingSetting, places_to_follow
from .tables import variation_of
from .variation import TimeVariation

if TYPE_CHECKING:
    from ..result import IdentificationResult


def with_time_variation(
    result: IdentificationResult, varying: VaryingSetting
) -> IdentificationResult:
    """A result with the courses of coefficients along its record.

    Parameters
    ----------
    result : IdentificationResult
        Of least squares, with its data.
    varying : "auto" or mapping of str to sequence of str

    Raises
    ------
    ChainError
        If there are several records, a site or a term is not in the model, or an
        optimizer or constraints are used.
    ChannelError
        If the record has no clock or is too short.
    """
    problem = result.problem
    _refuse_beside(problem)
    data = result.require_data("Fit again.")
    if len(data.segments) != 1:
        raise ChainError(
            f"varying follows one record, and {len(data.segments)} were given",
            "Give one record; monitoring.track follows several tests.",
        )
    places = places_to_follow(problem, varying)
    pieces = pieces_of_record(data.segments[0], result.model)
    followed = Followed(problem, data, pieces, tuple(places))
    variation = variation_of(Judgement(followed, varying == AUTO))
    _warn_of_changes(variation)
    return replace(result, time_variation=variation)


def _refuse_beside(problem: Problem) -> None:
    """Refuse settings that have no part in courses."""
    for name in ("optimizer", "constraints"):
        if getattr(problem, name):
            raise ChainError(
                f"{name} has no part in varying=", f"Leave {name} out, or varying."
            )


def _warn_of_changes(variation: TimeVariation) -> None:
    """Masses and coefficients of a constant fit average over what changes."""
    if variation.changing:
        warn_user(
            f"{' and '.join(variation.changing)} changes in time: masses_ and"
            " restoring_forces_ are those of the constant structure that fits best;"
            " time_variation_ has the courses, and the masses found with them.",
            BiasWarning,
        )
