"""From what a pass over chunks has accumulated to the fitted estimator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import ChannelError
from ...mechanics.identifiability import SolveOrder
from ...regression.chain_solve import Solution, model_of, solve, solved_safely
from ...regression.grams import BlockGrams
from ...regression.segments import Segment, SegmentSet
from ..intervals import Resolver
from ..problem import Estimate
from .accumulator import Accumulator


def solution_of(accumulator: Accumulator) -> tuple[Solution | None, BlockGrams, SolveOrder]:
    """Solution of the chain (None if the Gram matrices may have lost digits), its Gram matrices and solve order."""
    model, grams = accumulator.require_model(), accumulator.grams().sum()
    _require_usable(accumulator, grams)
    solve_order = accumulator.solve_order()
    names = {site: model.layout.labels(site) for site in model.layout.acting}
    solver = solved_safely if accumulator.kind == "gram" else solve
    return solver(grams, solve_order, model.known_masses, model.problem.optimizer, names), grams, solve_order


def publish(accumulator: Accumulator, solution: Solution, grams: BlockGrams, solve_order: SolveOrder) -> Any:
    """The estimator, with the results as its attributes."""
    estimator, problem = accumulator.estimator, accumulator.require_model().problem
    model = model_of(problem.layout, solution)
    data = _shown(accumulator)
    estimator._records, estimator._fused_separately, estimator._fused_jointly = None, None, False
    known = dict(problem.known_masses)
    estimator._resolver = Resolver(accumulator.grams().squares(), solve_order, known, problem.optimizer)
    if estimator.constraints is not None:
        from ..constraints import constrained

        model = constrained(model, estimator.constraints, estimator._resolver)
    estimator._publish(Estimate(problem, solve_order, model, solution, grams), data, _judged(accumulator, data))
    hidden = sorted({j for run in accumulator.runs for j in run.unknown})
    estimator.unknown_forces_ = pd.DataFrame({f"F{j}": np.zeros(0) for j in hidden})
    model.info["estimation"] = {"asked": "ls", "found": "ls"}
    estimator.n_features_in_, estimator._one_force = 3 * model.n_dof, False
    if hasattr(estimator, "feature_names_in_"):
        del estimator.feature_names_in_
    return estimator


def _require_usable(accumulator: Accumulator, grams: BlockGrams) -> None:
    from ...regression.chain_solve import require_clock, require_moving

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
    """Windows at the start of a record if a law has memory (its states are known there), else all."""
    if not accumulator.require_model().layout.has_memory:
        return data
    starts = {run.first for run in accumulator.runs}
    chosen = [w for key, w in accumulator.windows if key[:2] in starts and key[2] == 0]
    return SegmentSet(chosen or data.segments[:1], data.n_samples)


def _shown(accumulator: Accumulator) -> SegmentSet:
    """The kept windows, with the channel range of all samples."""
    if not accumulator.windows or accumulator.extent is None:
        raise ChannelError("There are no samples", "The source is empty, or holds only NaN.")
    segments: list[Segment] = []
    at = 0
    for _, window in accumulator.windows:
        size = window.n_samples
        window.rows = slice(at, at + size)
        window._extent = (window.valid, accumulator.extent)
        segments.append(window)
        at += size
    return SegmentSet(segments, at)
