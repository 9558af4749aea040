"""From an accumulator to a fitted estimator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import ChannelError
from ...mechanics.identifiability import Walk
from ...regression.blocks_of_samples import Pieces
from ...regression.chain_solve import Solution, solve, solved_safely
from ...regression.moments import Moments
from ...regression.segments import Segment, SegmentSet
from ...regression.solution import model_of
from ..intervals import Resolver
from .accumulator import Accumulator


def solution_of(accumulator: Accumulator) -> tuple[Solution | None, Moments, Walk]:
    """Solve the chain; None where the Gram matrices may have lost digits that the data hold."""
    moments, model = accumulator.total(), accumulator.require_model()
    _require_usable(accumulator, moments)
    walk = accumulator.walk()
    names = {site: model.layout.labels(site) for site in model.layout.acting}
    inner = accumulator.estimator._inner()
    solver = solved_safely if accumulator.kind == "gram" else solve
    return solver(moments, walk, model.known_masses, inner, names), moments, walk


def publish(accumulator: Accumulator, solution: Solution, moments: Moments, walk: Walk) -> Any:
    """Put the answer into the estimator."""
    estimator, given = accumulator.estimator, accumulator.require_model()
    layout = given.layout
    model = model_of(layout, solution)
    data = _shown(accumulator)
    estimator._fit_data, estimator._apart, estimator._narrow = None, None, False
    estimator._resolver = Resolver(_pieces(accumulator), walk, given.known_masses, estimator._inner())
    if estimator.constraints is not None:
        from ..constraints import constrained

        model = constrained(model, estimator.constraints, estimator._resolver)
    estimator._publish(model, solution, moments, walk, layout, data, _judged(accumulator, data))
    hidden = sorted({j for run in accumulator.runs for j in run.unknown})
    estimator.unknown_forces_ = pd.DataFrame({f"F{j}": np.zeros(0) for j in hidden})
    model.info["estimation"] = {"asked": "ls", "found": "ls"}
    estimator.n_features_in_, estimator._one_force = 3 * layout.n_dof, False
    if hasattr(estimator, "feature_names_in_"):
        del estimator.feature_names_in_
    return estimator


def _require_usable(accumulator: Accumulator, moments: Moments) -> None:
    from ...regression.requirements import require_clock, require_moving

    data, model = _shown(accumulator), accumulator.require_model()
    if not accumulator.forced and not model.known_masses:
        from ...exceptions import ExcitationError

        raise ExcitationError(
            "No force is measured and no mass is known, so nothing scales the chain",
            "Measure a force on one DOF, or give a mass: known_masses={dof: kg}; ratios to it then come out.",
        )
    require_moving(data, model.layout)
    require_clock(data, model.layout)
    for dofs, part in moments.parts.items():
        unknowns = part.matrix.shape[0] - 1
        if 0 < part.n_samples < unknowns + 1 and len(dofs) == 1:
            raise ChannelError(
                f"{part.n_samples} samples are too few for the balance of DOF {dofs[0]}, which has up to {unknowns} "
                "unknowns",
                "Use a longer record or a lower degree.",
            )


def _judged(accumulator: Accumulator, data: SegmentSet) -> SegmentSet:
    """The windows in which states of laws that remember are known: those at the start of a record."""
    if not accumulator.require_model().layout.has_memory:
        return data
    starts = {run.first for run in accumulator.runs}
    chosen = [w for key, w in accumulator.windows if key[:2] in starts and key[2] == 0]
    return SegmentSet(chosen or data.segments[:1], data.n_samples)


def _shown(accumulator: Accumulator) -> SegmentSet:
    """The windows that were kept, with the range of all samples."""
    if not accumulator.windows or accumulator.extent is None:
        raise ChannelError("There are no samples", "The source is empty, or holds nothing but NaN.")
    segments: list[Segment] = []
    at = 0
    for _, window in accumulator.windows:
        size = window.n_samples
        window.rows = slice(at, at + size)
        window._extent = (window.valid, accumulator.extent)
        segments.append(window)
        at += size
    return SegmentSet(segments, at)


def _pieces(accumulator: Accumulator) -> Pieces:
    """Block moments as the intervals and the bootstrap need them."""
    model = accumulator.require_model()
    entries = [*accumulator.blocks, *([accumulator._open] if accumulator._open else [])]
    grams, sizes = {}, {}
    for group in model.groups:
        parts = [e.moments.parts[group.dofs] for e in entries]
        grams[group.dofs] = np.array([p.matrix if p.kind == "gram" else p.matrix.T @ p.matrix for p in parts])
        sizes[group.dofs] = np.array([p.n_samples for p in parts], dtype=float)
    names = {name: i for i, name in enumerate(dict.fromkeys(e.record for e in entries))}
    record = np.array([names[e.record] for e in entries], dtype=int)
    return Pieces(model.layout, list(model.groups), dict(model.known_masses), grams, sizes, record, False)


