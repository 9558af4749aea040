"""Fits of data that do not fit in memory, the state of an interrupted fit on disk, and
``partial_fit``.
"""

import hashlib
import json
import os
import time as clock
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ...chain.identifiability import SolveOrder
from ...chain.sites import Site
from ...common.files import atomic_write, file_behind
from ...equations.chain_solve import (
    Solution,
    model_of,
    require_clock,
    require_moving,
    solve,
    solved_safely,
)
from ...equations.normal_equations import NormalEquations
from ...exceptions import ChannelError, DataQualityWarning, FileFormatError, NRFError
from ...records.channels import is_dask
from ...records.dataset import Dataset, Segment
from ...records.extent import Extent
from ...records.input_arrays import records_in
from ...records.record import Record
from ..intervals import Resolver
from ..problem import Estimate, law_list
from .accumulator import LINES, Accumulator, BlockEntry, Model, Run
from .sources import Chunk, Source, chunk_of, content, open_source


def fitted(add_up: Callable[[str], Accumulator], kind: str = "gram") -> Any:
    """The estimator, fitted from one pass; from a second one, by QR, if digits were
    lost.
    """
    accumulator = add_up(kind)
    solution, grams, solve_order = solution_of(accumulator)
    if solution is None:
        accumulator = add_up("root")
        solution, grams, solve_order = solution_of(accumulator)
    assert solution is not None  # only Gram matrices lose digits
    return publish(accumulator, solution, grams, solve_order)


def solution_of(
    accumulator: Accumulator,
) -> tuple[Solution | None, NormalEquations, SolveOrder]:
    """Solution of the chain (None if the Gram matrices may have lost digits), its Gram
    matrices and solve order.
    """
    model, grams = accumulator.require_model(), accumulator.grams().sum()
    _require_usable(accumulator, grams)
    solve_order = accumulator.solve_order()
    solver = solved_safely if accumulator.kind == "gram" else solve
    return (
        solver(grams, solve_order, model.known_masses, model.problem.optimizer),
        grams,
        solve_order,
    )


def publish(
    accumulator: Accumulator,
    solution: Solution,
    grams: NormalEquations,
    solve_order: SolveOrder,
) -> Any:
    """The estimator, with the results as its attributes."""
    problem = accumulator.require_model().problem
    solution.pass_on(stacklevel=5)
    solve_order = solution.followed(solve_order)
    found = Estimate(
        problem, solve_order, model_of(problem.layout, solution), solution, grams
    )
    pieces, known = accumulator.grams().squares(), dict(problem.known_masses)
    data = _shown(accumulator)
    return accumulator.estimator._publish_chunks(
        found,
        Resolver(pieces, solve_order, known, problem.optimizer),
        data,
        _judged(accumulator, data),
        sorted({j for run in accumulator.runs for j in run.unknown}),
    )


def _require_usable(accumulator: Accumulator, grams: NormalEquations) -> None:
    data, model = _shown(accumulator), accumulator.require_model()
    require_moving(data, model.layout)
    require_clock(data, model.layout)
    for dofs, matrix in grams.matrices.items():
        unknowns, size = matrix.shape[0] - 1, int(grams.sizes[dofs])
        if 0 < size < unknowns + 1 and len(dofs) == 1:
            what = (
                f"{size} samples are too few for the balance of DOF {dofs[0]}, which"
                f" has up to {unknowns} unknowns"
            )
            raise ChannelError(what, "Use a longer record or a lower degree.")


def _judged(accumulator: Accumulator, data: Dataset) -> Dataset:
    """Windows at the start of a record if a law has memory (its states are known
    there), else all.
    """
    if not accumulator.require_model().layout.has_memory:
        return data
    starts = {run.first for run in accumulator.runs}
    chosen = [w for key, w in accumulator.windows if key[:2] in starts and key[2] == 0]
    return Dataset(chosen or data.segments[:1], data.n_samples)


def _shown(accumulator: Accumulator) -> Dataset:
    """The kept windows, with the channel range of all samples."""
    if not accumulator.windows or accumulator.extent is None:
        raise ChannelError(
            "There are no samples", "The source is empty, or holds only NaN."
        )
    segments: list[Segment] = []
    at = 0
    for _, window in accumulator.windows:
        size = window.n_samples
        rows = slice(at, at + size)
        segments.append(replace(window, rows=rows, known_extent=accumulator.extent))
        at += size
    return Dataset(segments, at)


SAVE_EVERY = 10.0  # s between two states on disk


def is_streamed(X: Any) -> bool:
    """True if ``fit`` reads X in chunks: a path, an iterator, a Dask collection, or a
    list of those.
    """
    if isinstance(X, (list, tuple)):
        return (
            len(X) > 0
            and not isinstance(X[0], (list, tuple, Record))
            and is_streamed(X[0])
        )
    return isinstance(X, (str, os.PathLike)) or isinstance(X, Iterator) or is_dask(X)


def fit_streamed(
    estimator: Any,
    X: Any,
    F: Any = None,
    *,
    state: Any = None,
    save_every: float = SAVE_EVERY,
    chunk_samples: int | None = None,
    **beside: Any,
) -> Any:
    """Fit an estimator in one pass over chunks (``beside`` X: record, time, ...);
    memory does not grow with them.
    """
    if is_dask(X) or (isinstance(X, (list, tuple)) and is_dask(X[0])):
        from ..distributed import fit_distributed

        return fit_distributed(estimator, X, F, **beside)

    read = sorted({c for law in law_list(estimator.laws) for c in law.covariates})
    options: Any = dict(
        coordinates=estimator.coordinates, laws_read=read, chunk_samples=chunk_samples
    )
    source = open_source(X, F, **beside, **options)
    with threadpool_limits(
        1, "blas"
    ):  # the matrices are small, and other fits may run beside this one
        passes = _Passes(estimator, source, state, save_every)
        fitted(passes.run, "gram" if source.again else "root")
    passes.done()
    return estimator


def partial_fit(
    estimator: Any,
    X: Any,
    F: Any,
    record: Any,
    time: Any,
    base_acceleration: Any,
    covariates: Any,
) -> Any:
    """Add samples to an estimator and solve again."""

    held = getattr(estimator, "_stream", None)
    # a copy: a call that fails does not change the samples of earlier calls
    accumulator, number = (
        (Accumulator(estimator, "root"), 0)
        if held is None
        else (held[0].copy(), held[1])
    )
    if held is not None and accumulator.settings != _settings(estimator):
        cure = "Set them back, or start again with fit or with a clone."
        raise NRFError(
            "The settings of the estimator changed between two calls of partial_fit",
            cure,
        )
    records = records_in(X)
    if records is not None:
        chunks: Iterable[Chunk] = (chunk_of(r) for r in records)
    else:
        extra = (
            {}
            if covariates is None
            else {k: np.asarray(c) for k, c in dict(covariates).items()}
        )
        chunks = [
            Chunk(X, F, f"call {number}", True, record, time, base_acceleration, extra)
        ]
    with threadpool_limits(1, "blas"):
        for chunk in chunks:
            accumulator.add(chunk, number)
            number += 1
        accumulator.settings = _settings(estimator)
        fitted(lambda *_: accumulator)
    estimator._stream = accumulator, number
    return estimator


def _settings(estimator: Any) -> dict[str, str]:
    return {k: _exact(v) for k, v in estimator.get_params(deep=False).items()}


def _exact(value: Any) -> str:
    """A setting in all its digits; a law prints fewer."""
    if isinstance(value, Mapping):
        return ", ".join(
            sorted(f"{key!s}: {_exact(held)}" for key, held in value.items())
        )
    if isinstance(value, (list, tuple, np.ndarray)):
        return f"[{', '.join(map(_exact, value))}]"
    return _exact(value.to_dict()) if hasattr(value, "to_dict") else repr(value)


class _Passes:
    """Passes over a source with progress and a state on disk."""

    def __init__(
        self, estimator: Any, source: Source, state: Any, save_every: float
    ) -> None:
        self.estimator, self.source, self.save_every = estimator, source, save_every
        self.mark = identity(estimator, source) if source.again else ""
        self.path: Path | None = None
        self.own = False  # true once the file is known to be a state
        if state is not None and not source.again:
            cure = "Give files by path."
            raise ChannelError(
                "An iterator cannot be read again from the middle, so state= has no"
                " effect",
                cure,
            )
        if state is not None:
            self.path = file_behind(
                Path(state) / "fit.nrf-state" if Path(state).is_dir() else state
            )
        elif source.again and os.access(Path.cwd(), os.W_OK):
            self.path = Path.cwd() / f".fit-{self.mark[:12]}.nrf-state"

    def run(self, kind: str) -> Accumulator:
        """Result of one pass; of the second one where a state of it is resumed."""
        from tqdm.auto import tqdm

        accumulator, number, used = (
            Accumulator(self.estimator, kind, self.source.n_samples),
            0,
            0,
        )
        chunks = self.source.chunks()
        if (
            kind == "root"
        ):  # interrupted in the second pass, a fit does not repeat the first
            self.save(accumulator, number, used)
        elif self.path is not None:
            found = load(self.path, self.estimator, self.mark)
            self.own = self.path.exists()  # load refuses any other file
            if found and content(islice(chunks, found[1])) == found[2]:
                accumulator, number, used = found
            else:
                chunks = self.source.chunks()
        saved = clock.monotonic()
        with tqdm(
            total=self.source.n_samples,
            initial=accumulator.n_samples,
            unit="sample",
            unit_scale=True,
            delay=1.0,
            desc=(
                "fit, second pass"
                if self.source.again and accumulator.kind == "root"
                else "fit"
            ),
            disable=None,
        ) as bar:
            try:
                for chunk in chunks:
                    accumulator.add(chunk, number)
                    number, used = number + 1, content([chunk], used)
                    bar.update(chunk.n_samples)
                    if clock.monotonic() - saved >= self.save_every:
                        self.save(accumulator, number, used)
                        saved = clock.monotonic()
            except KeyboardInterrupt as stop:
                if number:
                    self.save(accumulator, number, used)
                if number and self.path is not None:  # without a path there is no state
                    stop.add_note(
                        f"The state is in {self.path}; the same call continues from"
                        " there."
                    )
                raise
        return accumulator.close()

    def save(self, accumulator: Accumulator, number: int, used: int) -> None:
        """Write the state of the pass; a warning if that fails."""
        if self.path is None:
            return
        try:
            save(self.path, accumulator, number, used, self.mark)
            self.own = True
        except OSError as error:  # the fit goes on without a state
            warnings.warn(
                f"The state of the fit cannot be written to {self.path} ({error}); the"
                " fit goes on, but cannot be resumed.",
                DataQualityWarning,
                stacklevel=4,
            )
            self.path = None

    def done(self) -> None:
        """Delete the state."""
        if self.path is not None and self.own:
            self.path.unlink(missing_ok=True)


_SCHEMA, _VERSION = "pysindy_nrf.FitState", 7
_DAMAGED = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    OverflowError,
    EOFError,
)


def identity(estimator: Any, source: Source) -> str:
    """Hash of the sources, the laws and the settings of a pass."""
    text = json.dumps(
        [_VERSION, source.identity(), _settings(estimator)], default=str, sort_keys=True
    )
    return hashlib.sha256(text.encode()).hexdigest()


def save(path: Path, acc: Accumulator, following: int, used: int, mark: str) -> None:
    """Write the state of a pass; ``following`` is the next chunk, ``used`` the content
    of those before it.
    """
    arrays: dict[str, Any] = {}
    entries, carry, extent = acc.entries, acc._carry, acc.extent
    if entries:
        arrays |= {
            f"grams.{k}": x
            for k, x in NormalEquations.stack([e.grams for e in entries])
            .to_arrays()
            .items()
        }
    for i, (_, segment) in enumerate(acc.windows):
        arrays |= _lines(f"window{i}", segment)
    if carry is not None:
        arrays |= {
            f"state {site} {law}": state
            for (site, law), state in carry["states"].items()
        }
        if carry["last"] is not None:
            arrays |= _lines("last", carry["last"])
    if extent is not None:
        arrays |= {"low": extent.low, "high": extent.high, "finite": extent.finite}
    if acc.origin is not None:
        arrays["origin"] = np.asarray(acc.origin)
    meta = {
        "schema": _SCHEMA,
        "mark": mark,
        "following": following,
        "used": used,
        "n_dof": None if acc.model is None else acc.model.chain.n_dof,
        "kind": acc.kind,
        "block_rows": acc.block_rows,
        "n_samples": acc.n_samples,
        "blocks": [[e.key, e.record] for e in entries],
        "open": acc._open is not None,
        "runs": [vars(run) for run in acc.runs],
        "windows": [[k, w.name] for k, w in acc.windows],
        "window_every": acc.window_every,
        "offered": acc._offered,
        "carry": None if carry is None else carry["end"],
    }
    with atomic_write(path, "wb") as file:
        np.savez(
            file,
            meta=np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8),
            **arrays,
        )


def load(path: Path, estimator: Any, mark: str) -> tuple[Accumulator, int, int] | None:
    """Accumulator, number of the next chunk, content of those before it, if it is a
    state of these settings.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
        meta = json.loads(bytes(data.pop("meta")).decode())
        if meta["schema"] != _SCHEMA:
            raise FileFormatError(
                f"{path} bears the signature {meta['schema']!r}",
                "Give another path for the state.",
            )
        if meta["mark"] != mark:
            return None
        acc = Accumulator(estimator, meta["kind"])
        acc.block_rows, acc.n_samples = meta["block_rows"], meta["n_samples"]
        acc.window_every, acc._offered = meta["window_every"], meta["offered"]
        acc.origin = data["origin"][()] if "origin" in data else None
        for run in meta["runs"]:
            values: dict[str, Any] = {
                k: tuple(v) if isinstance(v, list) else v for k, v in run.items()
            }
            acc.runs.append(Run(**values))
        if meta["n_dof"] is not None:
            acc.model = Model(estimator, meta["n_dof"])
            if meta["blocks"]:
                held = {
                    k.removeprefix("grams."): x
                    for k, x in data.items()
                    if k.startswith("grams.")
                }
                grams = NormalEquations.from_arrays(
                    held, acc.model.layout, acc.model.groups, acc.model.known_masses
                )
                acc.blocks = [
                    BlockEntry(tuple(key), name, grams[i])
                    for i, (key, name) in enumerate(meta["blocks"])
                ]
            if meta["open"]:
                held_open = acc.blocks.pop()
                acc._open = held_open.key, held_open.record, acc.sums(held_open.grams)
            windows = enumerate(meta["windows"])
            acc.windows = [
                (tuple(key), _segment(name, data, f"window{i}"))
                for i, (key, name) in windows
            ]
        if "low" in data:
            acc.extent = Extent(data["low"], data["high"], data["finite"])
        if meta["carry"] is not None:
            names = {k: k[6:].rpartition(" ") for k in data if k.startswith("state ")}
            states = {
                (Site(site), int(law)): data[k] for k, (site, _, law) in names.items()
            }
            last = _segment("last", data, "last") if "last.a" in data else None
            acc._carry = {"end": float(meta["carry"]), "states": states, "last": last}
        return acc, int(meta["following"]), int(meta["used"])
    except FileFormatError:
        raise
    except (*_DAMAGED, zipfile.BadZipFile, zlib.error) as error:
        what = (
            f"{path} is not the state of an interrupted fit ({type(error).__name__}:"
            f" {error})"
        )
        raise FileFormatError(
            what, "Give another path for the state, or delete the file to start again."
        ) from error


def _lines(name: str, segment: Segment) -> dict[str, np.ndarray]:
    lines = {
        f"{name}.{k}": getattr(segment, k)
        for k in LINES
        if getattr(segment, k) is not None
    }
    return lines | {f"{name}.covariate {k}": c for k, c in segment.covariates.items()}


def _segment(name: str, data: dict[str, np.ndarray], stem: str) -> Segment:
    lines: dict[str, Any] = {k: data.get(f"{stem}.{k}") for k in LINES}
    head = f"{stem}.covariate "
    covariates = {
        k.removeprefix(head): v for k, v in data.items() if k.startswith(head)
    }
    size = len(lines["a"])
    return Segment(
        name, slice(0, size), **lines, covariates=covariates, valid=slice(0, size)
    )
