"""Intervals in view of alternatives that the data do not exclude."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pandas as pd
from scipy.stats import norm

from ..common.warn import warn_user
from ..diagnosis.facts import Alternative, AmbiguousInterval, Move
from ..diagnosis.open_alternatives import (
    OpenAlternatives,
    ambiguous_intervals,
    with_ambiguity,
)
from ..exceptions import BiasWarning, NRFError
from .intervals import Statistic

# Level of the half-widths of alternatives.
LEVEL = 0.95


def ambiguous_in(
    table: pd.DataFrame,
    among: OpenAlternatives,
    statistic: Statistic,
    level: float = LEVEL,
) -> tuple[AmbiguousInterval, ...]:
    """Intervals of a table that alternatives widen, or that are withheld for them.

    Parameters
    ----------
    table : DataFrame
        ``parameter``, ``estimate``, ``lower``, ``upper``.
    among : OpenAlternatives
    statistic : callable
        Gives the estimates of a model.
    level : float
    """
    estimates = table.set_index("parameter")
    bounds = dict(zip(estimates.index, zip(estimates["lower"], estimates["upper"])))
    moves = {}
    for alternative in among.alternatives:
        moves[alternative.description] = _moves_of(alternative, statistic, level)
    values = estimates["estimate"].to_dict()
    return ambiguous_intervals(values, bounds, moves, among.rejecting)


def _moves_of(
    alternative: Alternative, statistic: Statistic, level: float
) -> Mapping[str, Move]:
    """What an alternative does to any statistic of a model.

    The uncertainty beside it is known of masses and coefficients only.
    """
    ratio = float(norm.ppf((1 + level) / 2) / norm.ppf((1 + LEVEL) / 2))
    moves = {}
    for name, move in alternative.moves.items():
        moves[name] = Move(move.change, ratio * move.half_width)
    if alternative.model is None or alternative.compared is None:
        return moves
    try:
        change = statistic(alternative.model) - statistic(alternative.compared)
    except NRFError:
        # a model without modes, say
        return moves
    others = change.drop(list(moves), errors="ignore").dropna()
    return moves | {str(name): Move(float(size)) for name, size in others.items()}


def table_with_ambiguity(
    table: pd.DataFrame, ambiguous: Iterable[AmbiguousInterval]
) -> pd.DataFrame:
    """A table of intervals, widened where they are ambiguous; NaN where withheld."""
    ambiguous = tuple(ambiguous)
    ends = with_ambiguity({}, ambiguous)
    if not ends:
        return table
    _warn_of_withheld(ambiguous)

    low = {name: interval[0] for name, interval in ends.items()}
    high = {name: interval[1] for name, interval in ends.items()}
    is_changed = table["parameter"].isin(list(ends))
    lower = table["lower"].mask(is_changed, table["parameter"].map(low))
    upper = table["upper"].mask(is_changed, table["parameter"].map(high))
    return table.assign(lower=lower, upper=upper)


def _warn_of_withheld(ambiguous: Iterable[AmbiguousInterval]) -> None:
    """Say which intervals are withheld, and for which alternatives."""
    withheld = [interval for interval in ambiguous if interval.withheld]
    if not withheld:
        return
    alternatives: list[str] = []
    for interval in withheld:
        alternatives += interval.by
    names = ", ".join(interval.parameter for interval in withheld)
    reasons = " or ".join(dict.fromkeys(alternatives))
    message = f"Intervals of {names} are withheld: {reasons} would fit as well."
    warn_user(message, BiasWarning)
