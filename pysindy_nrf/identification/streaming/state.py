"""The state of an interrupted pass on disk: plain arrays and JSON, no code."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypedDict, cast

import numpy as np

from ...chain.sites import Site
from ...common.files import atomic_write
from ...equations.normal_equations import NormalEquations
from ...exceptions import FileFormatError
from ...records.dataset import ROW_ARRAYS, Segment
from ...records.extent import Extent
from .chunks import Chunk, content
from .running_sums import (
    Block,
    Carry,
    Key,
    RunningSums,
    StreamSettings,
    SummedProblem,
    Windows,
)
from .runs import Run
from .sources import Source

_SCHEMA = "pysindy_nrf.FitState"
_VERSION = 8
# What reading a file that is no state may raise.
_DAMAGED = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    OverflowError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
)

Arrays = dict[str, np.ndarray]


class _Facts(TypedDict):
    """What a file holds of the sums beside arrays, as JSON has it."""

    schema: str
    mark: str
    used: int
    n_chunks: int
    n_samples: int
    kind: str
    block_rows: int
    n_dof: int | None
    blocks: list[tuple[list[int], str]]
    runs: list[dict[str, object]]
    windows: list[tuple[list[int], str]]
    every: int
    n_offered: int
    end: float | None


@dataclass
class PassState:
    """Sums of the chunks that were used, and the hash of their content."""

    sums: RunningSums
    used: int = 0

    def add(self, chunk: Chunk) -> None:
        """Use the next chunk."""
        self.sums.add(chunk, self.sums.n_chunks)
        self.used = content([chunk], self.used)


def identity(settings: StreamSettings, source: Source) -> str:
    """Hash of the sources, the laws and the settings of a pass."""
    facts = [_VERSION, source.identity(), settings.in_words()]
    text = json.dumps(facts, default=str, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


# -- writing -------------------------------------------------------------------------


def save(path: Path, state: PassState, mark: str) -> None:
    """Write the state of a pass, with the mark of its sources and settings."""
    sums = state.sums
    windows = sums.windows
    facts = _Facts(
        schema=_SCHEMA,
        mark=mark,
        used=state.used,
        n_chunks=sums.n_chunks,
        n_samples=sums.n_samples,
        kind=sums.kind,
        block_rows=sums.block_rows,
        n_dof=None if sums.problem is None else sums.problem.n_dof,
        blocks=[(list(block.key), block.record) for block in sums.blocks],
        runs=[asdict(run) for run in sums.runs],
        windows=[(list(key), window.name) for key, window in windows.chosen],
        every=windows.every,
        n_offered=windows.n_offered,
        end=None if sums.carry is None else sums.carry.end,
    )
    encoded = np.frombuffer(json.dumps(facts).encode(), dtype=np.uint8)
    arrays: dict[str, Any] = {"facts": encoded} | _arrays_of(sums)
    with atomic_write(path, "wb") as file:
        np.savez(file, **arrays)


def _arrays_of(sums: RunningSums) -> Arrays:
    arrays: Arrays = {}
    if sums.blocks:
        stacked = NormalEquations.stack([block.sums for block in sums.blocks])
        for name, array in stacked.to_arrays().items():
            arrays[f"sums.{name}"] = array
    for i, (_, window) in enumerate(sums.windows.chosen):
        arrays |= _arrays_of_segment(f"window{i}", window)
    if sums.carry is not None:
        for (site, law), law_state in sums.carry.states.items():
            arrays[f"state {site} {law}"] = law_state
        if sums.carry.last is not None:
            arrays |= _arrays_of_segment("last", sums.carry.last)
    if sums.extent is not None:
        arrays["low"] = sums.extent.low
        arrays["high"] = sums.extent.high
        arrays["finite"] = sums.extent.finite
    if sums.origin is not None:
        arrays["origin"] = np.asarray(sums.origin)
    return arrays


def _arrays_of_segment(stem: str, segment: Segment) -> Arrays:
    arrays = {f"{stem}.{name}": getattr(segment, name) for name in ROW_ARRAYS}
    for name, line in segment.covariates.items():
        arrays[f"{stem}.covariate {name}"] = line
    return {name: array for name, array in arrays.items() if array is not None}


# -- reading -------------------------------------------------------------------------


def load(path: Path, settings: StreamSettings, mark: str) -> PassState | None:
    """The state at a path, if it is one of these sources and settings.

    Raises
    ------
    FileFormatError
        If the file is no state.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        facts: _Facts = json.loads(bytes(arrays.pop("facts")).decode())
        if facts["schema"] != _SCHEMA:
            raise FileFormatError(
                f"{path} bears the signature {facts['schema']!r}",
                "Give another path for the state.",
            )
        if facts["mark"] != mark:
            return None
        return PassState(_sums_of(settings, facts, arrays), int(facts["used"]))
    except FileFormatError:
        raise
    except _DAMAGED as error:
        raise FileFormatError(
            f"{path} is not the state of an interrupted fit ({type(error).__name__}:"
            f" {error})",
            "Give another path for the state, or delete the file to start again.",
        ) from error


def _sums_of(settings: StreamSettings, facts: _Facts, arrays: Arrays) -> RunningSums:
    problem = None
    blocks: list[Block] = []
    if facts["n_dof"] is not None:
        problem = SummedProblem(settings, facts["n_dof"])
        blocks = _blocks_of(problem, facts["blocks"], arrays)
    extent = None
    if "low" in arrays:
        extent = Extent(arrays["low"], arrays["high"], arrays["finite"])
    carry = None
    if facts["end"] is not None:
        carry = _carry_of(float(facts["end"]), arrays)

    origin = None
    if "origin" in arrays:
        origin = cast(np.generic, arrays["origin"][()])

    return RunningSums(
        settings,
        facts["kind"],
        block_rows=facts["block_rows"],
        problem=problem,
        blocks=blocks,
        runs=[_run_of(run) for run in facts["runs"]],
        windows=_windows_of(facts, arrays),
        extent=extent,
        n_samples=facts["n_samples"],
        n_chunks=facts["n_chunks"],
        origin=origin,
        carry=carry,
    )


def _run_of(facts: dict[str, object]) -> Run:
    """A run; JSON has lists in place of its tuples."""
    values = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in facts.items()
    }
    return Run(**values)  # type: ignore[arg-type]


def _windows_of(facts: _Facts, arrays: Arrays) -> Windows:
    chosen = []
    for i, (key, name) in enumerate(facts["windows"]):
        window = _segment_of(name, f"window{i}", arrays)
        chosen.append((_key_of(key), window))
    return Windows(chosen, facts["every"], facts["n_offered"])


def _key_of(numbers: list[int]) -> Key:
    chunk, piece, block = numbers
    return chunk, piece, block


def _blocks_of(
    problem: SummedProblem, named: list[tuple[list[int], str]], arrays: Arrays
) -> list[Block]:
    if not named:
        return []
    head = "sums."
    of_sums = {
        name.removeprefix(head): array
        for name, array in arrays.items()
        if name.startswith(head)
    }
    stacked = NormalEquations.from_arrays(
        of_sums, problem.layout, problem.groups, problem.known_masses
    )
    return [
        Block(_key_of(key), record, stacked[i]) for i, (key, record) in enumerate(named)
    ]


def _carry_of(end: float, arrays: Arrays) -> Carry:
    states = {}
    for name, array in arrays.items():
        word, _, place = name.partition(" ")
        if word == "state":
            site, _, law = place.rpartition(" ")
            states[Site(site), int(law)] = array
    last = _segment_of("last", "last", arrays) if "last.a" in arrays else None
    return Carry(end, states, last)


def _segment_of(name: str, stem: str, arrays: Arrays) -> Segment:
    head = f"{stem}.covariate "
    covariates = {
        key.removeprefix(head): line
        for key, line in arrays.items()
        if key.startswith(head)
    }
    all_rows = slice(0, len(arrays[f"{stem}.a"]))
    return Segment(
        name,
        all_rows,
        a=arrays[f"{stem}.a"],
        v=arrays[f"{stem}.v"],
        s=arrays[f"{stem}.s"],
        F=arrays[f"{stem}.F"],
        t=arrays.get(f"{stem}.t"),
        ag=arrays.get(f"{stem}.ag"),
        covariates=covariates,
        valid=all_rows,
    )
