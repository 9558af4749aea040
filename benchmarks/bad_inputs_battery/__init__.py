"""Kinds of bad input, room by room; each says what must come of it."""

from __future__ import annotations

from . import command_line, estimators, files, laws, loop, records, representations
from .kind import Kind, Outcome, judge

ROOMS = (records, estimators, representations, laws, loop, files, command_line)


def every_kind() -> list[Kind]:
    """All kinds of all rooms."""
    return [kind for room in ROOMS for kind in room.kinds()]


__all__ = ["Kind", "Outcome", "every_kind", "judge"]
