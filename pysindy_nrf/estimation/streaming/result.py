"""From an accumulator to a fitted estimator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import ChannelError
from ...mechanics.identifiability import Walk
from ...regression.chain_solve import Solution, solve, solved_safely
from ...regression.grams import BlockGrams
from ...regression.segments import Segment, SegmentSet
from ...regression.solution import model_of
from ..intervals import Resolver
from ..problem import Estimate
from .accumulator import Accumulator


def solution_of(accumulator: Accumulator) -> tuple[Solution | None, BlockGrams, Walk]:
    """Solve the chain; None where the Gram matrices may have lost digits that the data hold."""
    model, grams = accumulator.require_model(), accumulator.grams().sum()
    _require_usable(accumulator, grams)
    walk = accumulator.walk()
    names = {site: model.layout.labels(site) for site in model.layout.acting}
    solver = solved_safely if accumulator.kind == "gram" else solve
    return solver(grams, walk, model.known_masses, model.problem.optimizer, names), grams, walk


def publish(accumulator: Accumulator, solution: Solution, grams: BlockGrams, walk: Walk) -> Any:
    """Put the answer into the estimator."""
    estimator, problem = accumulator.estimator, accumulator.require_model().problem
    model = model_of(problem.layout, solution)
    data = _shown(accumulator)
    estimator._records, estimator._apart, estimator._narrow = None, None, False
    estimator._resolver = Resolver(accumulator.grams().squares(), walk, dict(problem.known_masses), problem.optimizer)
    if estimator.constraints is not None:
        from ..constraints import constrained

        model = constrained(model, estimator.constraints, estimator._resolver)
    estimator._publish(Estimate(problem, walk, model, solution, grams), data, _judged(accumulator, data))
    hidden = sorted({j for run in accumulator.runs for j in run.unknown})
    estimator.unknown_forces_ = pd.DataFrame({f"F{j}": np.zeros(0) for j in hidden})
    model.info["estimation"] = {"asked": "ls", "found": "ls"}
    estimator.n_features_in_, estimator._one_force = 3 * model.n_dof, False
    if hasattr(estimator, "feature_names_in_"):
        del estimator.feature_names_in_
    return estimator


def _require_usable(accumulator: Accumulator, grams: BlockGrams) -> None:
    from ...regression.solution import require_clock, require_moving

    data, model = _shown(accumulator), accumulator.require_model()
    require_moving(data, model.layout)
    require_clock(data, model.layout)
    for dofs, matrix in grams.matrices.items():
        unknowns, size = matrix.shape[0] - 1, int(grams.sizes[dofs])
        if 0 < size < unknowns + 1 and len(dofs) == 1:
            raise ChannelError(
                f"{size} samples are too few for the balance of DOF {dofs[0]}, which has up to {unknowns} "
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
