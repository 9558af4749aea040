"""What columns look like, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..table import Table, short
from .column_facts import ColumnFacts

MAX_NAME_WIDTH = 32  # characters


def words_of_columns(
    table: Table, facts: Sequence[ColumnFacts], used: Mapping[str, str]
) -> list[str]:
    """A line for each column: name, range, spectrum, relation, and its channel.

    Parameters
    ----------
    table : Table
    facts : sequence of ColumnFacts
    used : mapping of str to str
        Channel by mapping of a column.
    """
    has_time = any(fact.is_time for fact in facts) or table.fs is not None
    longest = max((len(short(fact.text)) for fact in facts), default=0)
    width = min(longest, MAX_NAME_WIDTH)
    lines = []
    for fact in facts:
        channel = used.get(fact.text)
        end = f"  -> {channel}" if channel else "  (not used)"
        if fact.is_time and table.files and not channel:
            end = "  (time of its file)"
        name = " ".join(short(fact.text).split())
        unit = table.units.get(fact.variable, "")
        described = _looks_like(fact, unit, has_time)
        lines.append(f"{name:{width}s}  {described}{end}")
    return lines


def _looks_like(fact: ColumnFacts, unit: str, has_time: bool) -> str:
    """Range, spectrum and relation of one column."""
    if fact.values is None:
        return "no numbers"
    finite = fact.values[np.isfinite(fact.values)]
    if not finite.size:
        return "empty"
    if fact.is_constant:
        return f"constant, {finite[0]:.4g} {unit}".rstrip()

    parts = [f"{finite.min():.4g} to {finite.max():.4g} {unit}".rstrip()]
    if fact.is_time:
        parts.append("rises in even steps")
    elif np.isfinite(fact.frequency):
        clock = " Hz" if has_time else " per sample"
        parts.append(f"half of it below {fact.frequency:.3g}{clock}")
    if fact.relation is not None:
        relation = fact.relation
        order = "second derivative" if relation.order == 2 else "derivative"
        parts.append(
            f"looks like the {order} of {short(relation.of)} times"
            f" {relation.factor:.3g}"
        )
    return ", ".join(parts)
