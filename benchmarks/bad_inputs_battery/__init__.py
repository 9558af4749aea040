"""Kinds of bad input, room by room; each states what must come of it."""

from __future__ import annotations

from dataclasses import replace

from . import (
    command_line,
    estimators,
    files,
    laws,
    loop,
    models,
    records,
    representations,
)
from .kind import Kind, Outcome, judge

__all__ = ["Kind", "Outcome", "every_kind", "judge"]

ROOMS = {
    "record": records,
    "estimator": estimators,
    "representation": representations,
    "law": laws,
    "model": models,
    "loop": loop,
    "file": files,
    "command line": command_line,
}


def every_kind() -> list[Kind]:
    """All kinds of all rooms."""
    kinds = []
    for room, module in ROOMS.items():
        kinds += [replace(kind, room=room) for kind in module.kinds()]
    return kinds
