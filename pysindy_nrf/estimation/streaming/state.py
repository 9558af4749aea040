"""The state of an interrupted pass on disk: plain arrays, written whole or not at all."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ...common.atomic import atomic_write
from ...exceptions import FileFormatError
from ...mechanics.sites import Site
from ...regression.grams import BlockGrams
from ...regression.segments import Segment
from . import runs
from .accumulator import Accumulator, BlockEntry, Model
from .sources import Source

_VERSION = 2
_DAMAGED = (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError, EOFError)
_LINES = ("a", "v", "s", "F", "t", "ag")


def identity(estimator: Any, source: Source) -> str:
    """What tells one pass from another: the data, the laws, the settings."""
    settings = {k: repr(v) for k, v in sorted(estimator.get_params(deep=False).items())}
    text = json.dumps([_VERSION, source.identity(), settings], default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def save(path: Path, accumulator: Accumulator, following: int, mark: str) -> None:
    """Write the state of a pass."""
    acc = accumulator
    arrays: dict[str, Any] = {}
    entries = acc.entries
    if entries:
        arrays |= {f"grams.{k}": x for k, x in BlockGrams.stack([e.grams for e in entries]).to_arrays().items()}
    for i, (_, segment) in enumerate(acc.windows):
        arrays |= _lines(f"window{i}", segment)
    for dofs, guess in acc.guess.items():
        arrays["guess" + "-".join(map(str, dofs))] = guess
    carry = acc._carry
    if carry is not None:
        for (site, law), state in carry["states"].items():
            arrays[f"state {site} {law}"] = state
        if carry["last"] is not None:
            last = carry["last"]
            arrays |= {f"last.{k}": last[k] for k in _LINES if last[k] is not None}
            arrays |= {f"last.covariate {k}": v for k, v in last["covariates"].items()}
    extent = acc.extent
    meta = {
        "mark": mark, "following": following, "n_dof": None if acc.model is None else acc.model.chain.n_dof,
        "kind": acc.kind, "block_rows": acc.block_rows, "n_samples": acc.n_samples, "has_time": acc.has_time,
        "blocks": [[list(e.key), e.record] for e in entries], "open": acc._open is not None,
        "runs": [runs.to_json(r) for r in acc.runs],
        "windows": [[list(k), w.name] for k, w in acc.windows], "window_every": acc.window_every,
        "offered": acc._offered, "extent": None if extent is None else extent.finite.tolist(),
        "carry": None if carry is None else carry["end"], "origin": _origin_text(acc.origin),
    }  # fmt: skip
    if extent is not None:
        arrays |= {"low": extent.low, "high": extent.high}
    with atomic_write(path, "wb") as file:
        np.savez(file, meta=np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8), **arrays)


def load(path: Path, estimator: Any, mark: str) -> tuple[Accumulator, int] | None:
    """The state of a pass, if the file holds one of these data and settings."""
    from ...regression.domains import Extent

    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
        meta = json.loads(bytes(data.pop("meta")).decode())
        if meta["mark"] != mark:
            return None
        acc = Accumulator(estimator, meta["kind"])
        acc.block_rows, acc.n_samples, acc.has_time = meta["block_rows"], meta["n_samples"], meta["has_time"]
        acc.window_every, acc._offered, acc.origin = meta["window_every"], meta["offered"], _origin(meta["origin"])
        acc.runs = [runs.from_json(r) for r in meta["runs"]]
        acc.guess = {
            tuple(int(j) for j in k[5:].split("-")): np.ascontiguousarray(v)
            for k, v in data.items() if k.startswith("guess")
        }  # fmt: skip
        if meta["n_dof"] is not None:
            acc.model = Model(estimator, meta["n_dof"])
            if meta["blocks"]:
                held = {k.removeprefix("grams."): x for k, x in data.items() if k.startswith("grams.")}
                grams = BlockGrams.from_arrays(held, acc.model.layout, acc.model.groups, acc.model.known_masses)
                acc.blocks = [BlockEntry(tuple(key), name, grams[i]) for i, (key, name) in enumerate(meta["blocks"])]
            if meta["open"]:
                held_open = acc.blocks.pop()
                acc._open = held_open.key, held_open.record, acc.sums(held_open.grams)
            for i, (key, name) in enumerate(meta["windows"]):
                acc.windows.append((tuple(key), _segment(name, data, f"window{i}")))
        if meta["extent"] is not None:
            acc.extent = Extent(data["low"], data["high"], np.array(meta["extent"], dtype=bool))
        if meta["carry"] is not None:
            acc._carry = {"end": float(meta["carry"]), "states": {}, "last": None}
            for name in data:
                if name.startswith("state "):
                    site, _, law = name[6:].rpartition(" ")
                    acc._carry["states"][Site(site), int(law)] = data[name]
            if "last.a" in data:
                last = {k: data.get(f"last.{k}") for k in _LINES}
                head = "last.covariate "
                last["covariates"] = {k.removeprefix(head): v for k, v in data.items() if k.startswith(head)}
                acc._carry["last"] = last
        return acc, int(meta["following"])
    except (*_DAMAGED, zipfile.BadZipFile, zlib.error) as error:
        raise FileFormatError(
            f"{path} is not the state of an interrupted fit ({type(error).__name__}: {error})",
            "Give another path for the state, or delete the file to begin anew.",
        ) from error


def _lines(name: str, segment: Segment) -> dict[str, np.ndarray]:
    lines = {f"{name}.{k}": getattr(segment, k) for k in _LINES if getattr(segment, k) is not None}
    return lines | {f"{name}.covariate {k}": c for k, c in segment.covariates.items()}


def _segment(name: str, data: dict[str, np.ndarray], stem: str) -> Segment:
    lines: dict[str, Any] = {k: data.get(f"{stem}.{k}") for k in _LINES}
    head = f"{stem}.covariate "
    covariates = {k.removeprefix(head): v for k, v in data.items() if k.startswith(head)}
    size = len(lines["a"])
    return Segment(name, slice(0, size), **lines, covariates=covariates, valid=slice(0, size))


def _origin_text(origin: Any) -> list[str] | None:
    if origin is None:
        return None
    if isinstance(origin, np.timedelta64):
        return ["timedelta", str(origin.astype("timedelta64[ns]").astype(np.int64))]
    if isinstance(origin, np.datetime64):
        return ["datetime", str(origin.astype("datetime64[ns]").astype(np.int64))]
    return ["number", repr(float(origin))]


def _origin(text: list[str] | None) -> Any:
    if text is None:
        return None
    kind, value = text
    if kind == "timedelta":
        return np.timedelta64(int(value), "ns")
    return np.datetime64(int(value), "ns") if kind == "datetime" else float(value)
