"""Universal files, data set 58 ("function at nodal DOF"): time histories in (by pyuff)
and out.
"""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...common.files import atomic_write
from ...common.lazy import require
from ...exceptions import FileFormatError
from ..channels import rate_of
from .table import MAX_BYTES, Attributes, Table, check_size, reading_as, unreadable
from .units import si_unit

# data set of the attributes of a record that this package wrote; other programs pass
# over it
_OWN = 9058
_KINDS = {8: "x", 11: "v", 12: "a", 13: "F", 9: "F"}  # specific data types
_TYPES = {"x": 8, "v": 11, "a": 12, "F": 13}
_DIRECTIONS = {0: "", 1: "+X", -1: "-X", 2: "+Y", -2: "-Y", 3: "+Z", -3: "-Z"}
# data set 164: units code -> length, force
_SYSTEMS = {
    1: ("m", "N"),
    2: ("ft", "lbf"),
    3: ("m", "kgf"),
    5: ("mm", "mN"),
    7: ("in", "lbf"),
    8: ("mm", "kgf"),
}


def read_uff(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the time histories (data sets 58) of a universal file, ASCII or binary."""
    pyuff = require("pyuff", "files", "Reading UFF files")
    with open(path, "rb") as raw:
        raw.seek(max(0, path.stat().st_size - 200))
        if (
            not raw.read().rstrip().endswith(b"-1")
        ):  # pyuff would drop the last data set silently
            raise unreadable(path, "UFF", "its last data set does not end")
    with reading_as(path, "UFF"):
        file = pyuff.UFF(str(path))
        kinds = [int(k) for k in file.get_set_types()]
        heads = {
            i: file.read_sets(i, header_only=True)
            for i, kind in enumerate(kinds)
            if kind == 58
        }
        points = [int(head["num_pts"]) for head in heads.values()]
        if any(n < 0 or n > path.stat().st_size for n in points):
            raise ValueError("a data set announces more points than the file holds")
        check_size(path, 8 * sum(points), max_bytes)
        with warnings.catch_warnings(
            action="ignore"
        ):  # about values that pyuff drops; they are counted below
            sets = [
                file.read_sets(i)
                for i, head in heads.items()
                if int(head["func_type"]) in (0, 1)
            ]
            systems = [file.read_sets(i) for i, kind in enumerate(kinds) if kind == 164]
    if any("data" not in one for one in sets):
        raise unreadable(path, "UFF", "a data set 58 holds no data")
    sets = [one for one in sets if not np.iscomplexobj(one["data"])]
    if not sets:
        raise unreadable(
            path, "UFF", "it holds no time history (data set 58, function type 1)"
        )
    for one in sets:
        if len(one["data"]) != int(one["num_pts"]):
            raise FileFormatError(
                f"{path}: {one['id1'].strip()!r} announces {int(one['num_pts'])}"
                f" points, {len(one['data'])} are there",
                "The file is cut off or damaged; export it again.",
            )
    return (
        _own(path, sets)
        if kinds[0] == _OWN
        else _foreign(path, sets, systems, len(kinds) - len(sets))
    )


def _foreign(
    path: Path,
    sets: Sequence[Mapping[str, Any]],
    systems: Sequence[Mapping],
    skipped: int,
) -> Table:
    names, signs = _names(sets)
    length, force = (
        _SYSTEMS.get(int(systems[0]["units_code"]), ("", "")) if systems else ("m", "N")
    )
    lengths = {len(one["data"]) for one in sets}
    if len(lengths) > 1:
        cure = "Export those of one test into one file."
        raise FileFormatError(
            f"{path}: its time histories have {', '.join(map(str, sorted(lengths)))}"
            " points",
            cure,
        )
    implied = (
        {"x": length, "v": f"{length}/s", "a": f"{length}/s^2", "F": force}
        if length
        else {}
    )
    variables, units, notes = {}, {}, []
    for name, sign, one in zip(names, signs, sets):
        variables[name] = sign * np.asarray(one["data"], dtype=float)
        if unit := _filled(one.get("ordinate_axis_units_lab", "")) or implied.get(
            name[0]
        ):
            units[name] = unit
        if text := _filled(one["id1"]):
            notes.append(f"{name} is {text!r}")
        if sign < 0:
            along = _DIRECTIONS.get(int(one["rsp_dir"]), "a negative axis")
            notes.append(f"{name} was measured along {along}: its sign is turned")
    if skipped:
        notes.append(f"{skipped} other data sets are left out")
    if systems and not length:
        notes.append(
            f"take care: its units code {int(systems[0]['units_code'])} is not known;"
            " give units"
        )
    spacing = {
        (int(one["abscissa_spacing"]), float(one.get("abscissa_inc", 0.0)))
        for one in sets
    }
    if all(even for even, _ in spacing):
        steps = {step for _, step in spacing}
        if len(steps) > 1 or min(steps) <= 0:
            what = (
                f"{path}: its time histories are sampled every"
                f" {', '.join(f'{s:g}' for s in sorted(steps))} s"
            )
            raise FileFormatError(what, "Export those of one clock into one file.")
        return Table(
            path, "UFF 58", variables, units, notes, fs=rate_of(steps.pop(), 1e-5)
        )
    time = np.asarray(sets[0]["x"], dtype=float)
    if any(not np.array_equal(time, np.asarray(one["x"], dtype=float)) for one in sets):
        raise FileFormatError(
            f"{path}: the times of its time histories differ",
            "Export histories with one clock.",
        )
    return Table(path, "UFF 58", {"t": time} | variables, units, notes)


def _filled(text: Any) -> str:
    """A text of the header, empty if it is NONE."""
    stripped = str(text).strip()
    return "" if stripped.upper() == "NONE" else stripped


def _names(sets: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[float]]:
    """Names, and the signs that turn each channel into the positive direction of its
    name.
    """
    kinds = [_KINDS.get(int(one["ordinate_spec_data_type"]), "c") for one in sets]
    directions = [int(one["rsp_dir"]) for one in sets]
    short = [f"{kind}{int(one['rsp_node'])}" for kind, one in zip(kinds, sets)]
    signs = [-1.0 if d < 0 else 1.0 for d in directions]
    if len(set(map(abs, directions))) > 1 or len(set(short)) < len(short):
        short = [
            f"{name}{_DIRECTIONS.get(d, f'({d})')}"
            for name, d in zip(short, directions)
        ]
        signs = [1.0] * len(short)  # the names state the direction
    return [
        name if short.count(name) == 1 else f"{name} set {i + 1}"
        for i, name in enumerate(short)
    ], signs


def _own(path: Path, sets: Sequence[Mapping[str, Any]]) -> Table:
    """A record written by :func:`write_uff`, with its attributes."""
    with open(path, "rb") as file:
        text = [file.readline() for _ in range(3)][-1]
    attributes = Attributes.from_json(text, path)
    if len(sets) != len(attributes.columns):
        raise unreadable(
            path,
            "UFF",
            f"{len(sets)} columns are there, {len(attributes.columns)} were written",
        )
    columns = {
        name: np.asarray(one["data"], dtype=float)
        for name, one in zip(attributes.columns, sets)
    }
    return Table(path, "UFF 58", columns, attributes=attributes, fs=attributes.fs)


def write_uff(
    path: Path, columns: Mapping[str, np.ndarray], attributes: Attributes
) -> None:
    """Write the columns of a record as binary time histories (58b), and its attributes
    as a data set of our own.
    """
    sets = []
    for name, line in columns.items():
        kind = "" if name in attributes.covariates else name[0]
        node, unit = (
            int(name[1:]) if kind and name[1:].isdigit() else 0,
            (si_unit(name) if kind else ""),
        )
        texts = [name, attributes.name]
        sets.append(
            history(
                line,
                attributes.fs,
                attributes.t0,
                texts,
                _TYPES.get(kind, 0),
                node,
                0,
                unit,
            )
        )
    write_sets(
        path, [f"{-1:6d}\n{_OWN:6d}\n{attributes.to_json()}\n{-1:6d}\n".encode(), *sets]
    )


def history(
    line: np.ndarray,
    fs: float,
    t0: float,
    texts: Sequence[str],
    kind: int,
    node: int,
    reference: int,
    unit: str,
) -> bytes:
    """A time history as a binary data set 58, IEEE double precision."""
    data = np.asarray(line, dtype="<f8").tobytes()
    axis = "{:10d}    0    0    0 {:<20} {:<20}"
    head = [
        f"{-1:6d}",
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *(
            f"{ascii(text)[1:-1][:80]:<80}"
            for text in (*texts, *["NONE"] * (5 - len(texts)))
        ),
        (
            f"{1:5d}{0:10d}{0:5d}{0:10d} {'NONE':>10}{node:10d}{1 if kind else 0:4d} "
            f"{'NONE':>10}{reference:10d}{1 if reference else 0:4d}"
        ),
        f"{4:10d}{len(line):10d}{1:10d}{t0:13.5e}{1 / fs:13.5e}{0:13.5e}",
        axis.format(17, "time", "s"),
        axis.format(kind, "NONE", unit or "NONE"),
        axis.format(0, "NONE", "NONE"),
        axis.format(0, "NONE", "NONE"),
    ]
    return ("\n".join(head) + "\n").encode("ascii") + data + f"{-1:6d}\n".encode()


def write_sets(path: Path, sets: Sequence[bytes]) -> None:
    """Write data sets to a universal file, whole or not at all."""
    with atomic_write(path, "wb") as file:
        file.writelines(sets)
