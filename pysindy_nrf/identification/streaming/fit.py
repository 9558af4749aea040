"""Fits of data that do not fit in memory, and of records that come one by one."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pandas as pd
from threadpoolctl import threadpool_limits

from ...chain.identifiability import SolveOrder
from ...common.files import file_behind
from ...common.warn import warn_user
from ...equations.chain_solve import (
    Solution,
    model_of,
    require_clock,
    require_moving,
    solve,
    solved_safely,
)
from ...equations.normal_equations import NormalEquations
from ...exceptions import ChannelError, DataQualityWarning, NRFError
from ...records.input_arrays import Input, records_in
from ..examination import Finding
from ..intervals import Resolver
from ..methods import LeastSquares, examined_result
from ..problem import Estimate
from ..result import IdentificationResult
from .chunks import Chunk, content, record_chunk
from .running_sums import RunningSums, StreamSettings
from .sources import Source, open_source
from .state import PassState, identity, load, save

# s between two states on disk
SECONDS_BETWEEN_STATES = 10.0

Pass = Callable[[str], RunningSums]
StatePath = str | os.PathLike[str] | None


def fit_pieces(
    settings: StreamSettings, passed: Input, state: StatePath = None
) -> IdentificationResult:
    """Fit files or an iterator, chunk by chunk; memory does not grow with them.

    Parameters
    ----------
    settings : StreamSettings
    passed : Input
        Paths or an iterator, and what was passed with them.
    state : path-like, optional
        File or folder for the state of an interrupted fit.
    """
    source = open_source(passed, settings.reader)
    passes = _Passes(settings, source, state)
    # the matrices are small, and other fits may run beside this one
    with threadpool_limits(1, "blas"):
        result = identified(passes.add_up, "gram" if source.again else "root")
    passes.delete_state()
    return result


def with_records(
    sums: RunningSums | None, settings: StreamSettings, passed: Input
) -> RunningSums:
    """Sums of earlier records and of further ones; the earlier sums do not change.

    Raises
    ------
    NRFError
        If the settings are others than before.
    """
    if sums is None:
        sums = RunningSums(settings, "root")
    elif sums.settings.in_words() != settings.in_words():
        raise NRFError(
            "The settings of the estimator changed between two calls of partial_fit",
            "Set them back, or start again with fit or with a clone.",
        )

    out = sums.copy()
    records = records_in(passed.X)
    if records is None:
        chunks = [Chunk(passed, f"call {out.n_chunks}")]
    else:
        chunks = [record_chunk(record) for record in records]
    with threadpool_limits(1, "blas"):
        for chunk in chunks:
            out.add(chunk, out.n_chunks)
    return out


# -- from sums to a result -----------------------------------------------------------


def identified(add_up: Pass, kind: str = "gram") -> IdentificationResult:
    """The result of one pass; of a second one, by QR, if digits were lost."""
    with threadpool_limits(1, "blas"):
        sums = add_up(kind)
        order, total = _order_and_total(sums)
        solution = _solution(sums, order, total)
        if solution is None:
            sums = add_up("root")
            order, total = _order_and_total(sums)
            solution = _solution(sums, order, total)
        assert solution is not None  # only Gram matrices lose digits
        return _result_of(sums, order, total, solution)


def _order_and_total(sums: RunningSums) -> tuple[SolveOrder, NormalEquations]:
    """The order of the solve, and the sums of all blocks."""
    layout = sums.require_problem().layout
    data = sums.shown()
    total = sums.pieces().sum()
    require_moving(data, layout)
    require_clock(data, layout)
    for dofs, matrix in total.matrices.items():
        n_unknowns = matrix.shape[0] - 1
        n_samples = int(total.sizes[dofs])
        if len(dofs) == 1 and 0 < n_samples <= n_unknowns:
            raise ChannelError(
                f"{n_samples} samples are too few for the balance of DOF {dofs[0]},"
                f" which has up to {n_unknowns} unknowns",
                "Use a longer record or a lower degree.",
            )
    return sums.solve_order(), total


def _solution(
    sums: RunningSums, order: SolveOrder, total: NormalEquations
) -> Solution | None:
    """Solution of the chain; None if Gram matrices may have lost digits."""
    problem = sums.require_problem().problem
    solver = solved_safely if sums.kind == "gram" else solve
    return solver(total, order, dict(problem.known_masses), problem.optimizer)


def _result_of(
    sums: RunningSums, order: SolveOrder, total: NormalEquations, solution: Solution
) -> IdentificationResult:
    problem = sums.require_problem().problem
    solution.pass_on()
    order = solution.followed(order)
    model = model_of(problem.layout, solution)
    estimate = Estimate(problem, order, model, solution, total)
    resolver = Resolver(
        sums.pieces().squares(), order, dict(problem.known_masses), problem.optimizer
    )
    finding = Finding(
        estimate,
        sums.shown(),
        asked=sums.settings.estimator.estimation,
        method=LeastSquares.name,
        resolver=resolver,
        by_least_squares=estimate,
        judged=sums.judged(),
        in_memory=False,
    )
    # the forces themselves were not kept
    unknown = {f"F{j}": pd.Series(dtype=float) for j in sums.unknown_somewhere}
    return replace(
        examined_result(finding), data=None, unknown_forces=pd.DataFrame(unknown)
    )


# -- passes over a source ------------------------------------------------------------


class _Passes:
    """Passes over a source with progress and a state on disk."""

    def __init__(
        self, settings: StreamSettings, source: Source, state: StatePath
    ) -> None:
        self.settings = settings
        self.source = source
        self.mark = identity(settings, source) if source.again else ""
        self.path = self._path_of_state(state)
        # whether the file at the path is known to be a state
        self.is_own = False

    def _path_of_state(self, state: StatePath) -> Path | None:
        if state is not None:
            if not self.source.again:
                raise ChannelError(
                    "An iterator cannot be read again from the middle, so state= has"
                    " no effect",
                    "Give files by path.",
                )
            is_folder = Path(state).is_dir()
            return file_behind(Path(state) / "fit.nrf-state" if is_folder else state)
        if self.source.again and os.access(Path.cwd(), os.W_OK):
            return Path.cwd() / f".fit-{self.mark[:12]}.nrf-state"
        return None

    def add_up(self, kind: str) -> RunningSums:
        """Sums of one pass; of the second one where a state of it is resumed."""
        from tqdm.auto import tqdm

        state = PassState(
            RunningSums.of_length(self.settings, kind, self.source.n_samples)
        )
        chunks = self.source.chunks()
        if kind == "root":
            # interrupted in the second pass, a fit does not repeat the first
            self._save(state)
        else:
            resumed = self._resumed(chunks)
            if resumed is None:
                chunks = self.source.chunks()
            state = resumed or state

        second = self.source.again and state.sums.kind == "root"
        with tqdm(
            total=self.source.n_samples,
            initial=state.sums.n_samples,
            unit="sample",
            unit_scale=True,
            delay=1.0,
            desc="fit, second pass" if second else "fit",
            disable=None,
        ) as bar:
            self._add(chunks, state, bar.update)
        return state.sums

    def _resumed(self, chunks: Iterator[Chunk]) -> PassState | None:
        """The state of an interrupted pass, if the first chunks are those it used."""
        if self.path is None:
            return None
        state = load(self.path, self.settings, self.mark)
        self.is_own = self.path.exists()  # load refuses any other file
        if state is None:
            return None
        used = content(islice(chunks, state.sums.n_chunks))
        return state if used == state.used else None

    def _add(
        self,
        chunks: Iterator[Chunk],
        state: PassState,
        progress: Callable[[int], object],
    ) -> None:
        """Add chunks; where the user interrupts, the state is saved."""
        saved = time.monotonic()
        try:
            for chunk in chunks:
                state.add(chunk)
                progress(chunk.n_samples)
                if time.monotonic() - saved >= SECONDS_BETWEEN_STATES:
                    self._save(state)
                    saved = time.monotonic()
        except KeyboardInterrupt as stop:
            if state.sums.n_chunks:
                self._save(state)
                if self.path is not None:
                    stop.add_note(
                        f"The state is in {self.path}; the same call continues from"
                        " there."
                    )
            raise

    def _save(self, state: PassState) -> None:
        """Write the state; where that fails the fit goes on without one."""
        if self.path is None:
            return
        try:
            save(self.path, state, self.mark)
            self.is_own = True
        except OSError as error:
            warn_user(
                f"The state of the fit cannot be written to {self.path} ({error}); the"
                " fit goes on, but cannot be resumed.",
                DataQualityWarning,
            )
            self.path = None

    def delete_state(self) -> None:
        """Delete the state of a fit that is done."""
        if self.path is not None and self.is_own:
            self.path.unlink(missing_ok=True)
