"""From what a pass over chunks has accumulated to the fitted estimator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...exceptions import ChannelError
from ...mechanics.identifiability import SolveOrder
from ...regression.chain_solve import Solution, model_of, solve, solved_safely
from ...regression.gram_pass import guess_of
from ...regression.grams import BlockGrams
from ...regression.segments import Segment, SegmentSet
from ..intervals import Resolver
from ..problem import Estimate
from .accumulator import Accumulator


def fitted(add_up: Callable[[str, dict], Accumulator], kind: str = "gram") -> Any:
    """The estimator, fitted from one pass; from a second one, with orthogonalised columns, if digits were lost."""
    accumulator = add_up(kind, {})
    solution, grams, solve_order = solution_of(accumulator)
    if solution is None:
        accumulator = add_up("root", guess_of(grams))
        solution, grams, solve_order = solution_of(accumulator)
    assert solution is not None  # only Gram matrices lose digits
    return publish(accumulator, solution, grams, solve_order)


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
    problem = accumulator.require_model().problem
    found = Estimate(problem, solve_order, model_of(problem.layout, solution), solution, grams)
    pieces, known = accumulator.grams().squares(), dict(problem.known_masses)
    data = _shown(accumulator)
    return accumulator.estimator._publish_chunks(
        found, Resolver(pieces, solve_order, known, problem.optimizer), data, _judged(accumulator, data),
        sorted({j for run in accumulator.runs for j in run.unknown}),
    )  # fmt: skip


def _require_usable(accumulator: Accumulator, grams: BlockGrams) -> None:
    from ...regression.chain_solve import require_clock, require_moving

    data, model = _shown(accumulator), accumulator.require_model()
    require_moving(data, model.layout)
    require_clock(data, model.layout)
    for dofs, matrix in grams.matrices.items():
        unknowns, size = matrix.shape[0] - 1, int(grams.sizes[dofs])
        if 0 < size < unknowns + 1 and len(dofs) == 1:
            raise ChannelError(
                f"{size} samples are too few for the balance of DOF {dofs[0]}, which has up to {unknowns} unknowns",
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
