"""From the least-squares estimate to the one that was asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..chain_solve import Solution, groups_of
from ..identifiability import Walk
from ..layout import LawLayout
from ..model import ChainModel
from ..segments import SegmentSet
from .intervals import Resolver
from .iv import instrumental_variables
from .output_error import output_error
from .pieces import pieces_of

METHODS = ("ls", "iv", "simulation")


def refine(
    method: str,
    model: ChainModel,
    solution: Solution,
    data: SegmentSet,
    layout: LawLayout,
    walk: Walk,
    filters: Sequence[Any],
    known: Mapping[int, float],
    inner: Any = None,
    band: Any = None,
    raw: SegmentSet | None = None,
) -> tuple[ChainModel, Solution, Resolver | None, dict[str, Any]]:
    """Instrumental variables, and output error after them.

    Parameters
    ----------
    method : {"iv", "simulation"}
    model, solution
        By least squares.
    data : SegmentSet
        Motions whose noise is independent of the motion.
    layout, walk, filters, known, inner, band
        As in the solve.
    raw : SegmentSet, optional
        Channels as measured, where all are; for ``"simulation"``.

    Returns
    -------
    model, solution, resolver, facts
        The resolver is None where the estimate stayed with least squares.
    """
    facts: dict[str, Any] = {"asked": method, "found": "ls"}
    iv = instrumental_variables(model, data, layout, walk, filters, known, inner, band)
    if iv is None:
        return model, solution, None, facts
    facts |= {"found": "iv", "rounds": iv.rounds, "likeness": iv.likeness, "notes": list(iv.notes)}
    resolver = Resolver(iv.pieces, walk, dict(known), inner)
    model, solution = iv.model, iv.solution
    if method == "simulation":
        result = output_error(model, data, filters, known, raw)
        facts |= {
            "free_run_error_before": _finite(result.error_before),
            "free_run_error_after": _finite(result.error_after),
        }
        if result.kept:
            model, facts["found"] = result.model, "simulation"
    return model, solution, resolver, facts


def least_squares_resolver(
    data: SegmentSet,
    layout: LawLayout,
    walk: Walk,
    filters: Sequence[Any],
    known: Mapping[int, float],
    inner: Any = None,
) -> Resolver:
    """What re-solving a least-squares estimate needs; one pass over the data.

    Parameters
    ----------
    data, layout, walk, filters, known, inner
        As in the solve.

    Returns
    -------
    Resolver
    """
    return Resolver(pieces_of(data, layout, groups_of(layout, walk), filters, known), walk, dict(known), inner)


def _finite(value: float) -> float | None:
    return float(value) if abs(value) < float("inf") else None
