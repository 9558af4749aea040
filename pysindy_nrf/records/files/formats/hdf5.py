"""HDF5, and MATLAB v7.3 files, which are HDF5."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ....common.lazy import require
from ....exceptions import FileFormatError
from ...clock import rate_of
from ..table import MAX_BYTES, Clock, Table, check_size, reading_as
from .numeric_arrays import numeric_arrays

if TYPE_CHECKING:
    import h5py

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read_hdf5(path: Path, max_bytes: int = MAX_BYTES, matlab: bool = False) -> Table:
    """Read the numeric data sets of an HDF5 file.

    Names of groups are joined by points. MATLAB writes columns first, and marks texts
    and empty arrays.
    """
    library = require("h5py", "files", "Reading HDF5 and MATLAB v7.3 files")
    kind = "MATLAB v7.3" if matlab else "HDF5"
    arrays: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    rates: dict[str, float] = {}
    objects = []
    total = 0

    with reading_as(path, kind), library.File(path, "r") as file:
        for name, data_set in data_sets(library, file).items():
            if "MATLAB_object_decode" in data_set.attrs:
                class_name = bytes(data_set.attrs["MATLAB_class"]).decode()
                objects.append(f"{name} ({class_name})")
                continue
            if name.startswith("#") or not _is_numeric(data_set, matlab):
                continue

            require_own(path, name, data_set)
            total += data_set.size * data_set.dtype.itemsize
            check_size(path, total, max_bytes)
            values = np.asarray(data_set[()])
            title = name.replace("/", ".")
            arrays[title] = values.T if matlab else values
            units |= _stated(data_set, title, UNIT_ATTRIBUTES, _as_text)
            rates |= _stated(data_set, title, RATE_ATTRIBUTES, _as_rate)
            rates |= _stated(data_set, title, STEP_ATTRIBUTES, _as_rate_of_step)

    table = table_without_objects(path, kind, numeric_arrays(arrays), objects)
    clocks = {name: Clock(rate) for name, rate in rates.items()}
    fs = next(iter(rates.values()), None) if len(set(rates.values())) == 1 else None
    return replace(table, units=units, clocks=clocks, fs=fs)


# Attributes of a data set, or of its group, that state its unit, rate (Hz) or step (s).
UNIT_ATTRIBUTES = ("units", "unit", "unit_string", "Units", "Unit", "UNITS")
RATE_ATTRIBUTES = ("fs", "sampling_rate", "sample_rate", "samplerate", "SampleRate")
STEP_ATTRIBUTES = ("dt", "delta_t", "wf_increment", "time_step")
Stated = TypeVar("Stated")


def _stated(
    data_set: h5py.Dataset,
    title: str,
    attributes: tuple[str, ...],
    read: Callable[[object], Stated | None],
) -> dict[str, Stated]:
    """What an attribute of a data set, or of a group around it, states."""
    for holder in (data_set, data_set.parent, data_set.file):
        for attribute in attributes:
            if attribute in holder.attrs:
                value = read(holder.attrs[attribute])
                return {} if value is None else {title: value}
    return {}


def _as_text(value: object) -> str | None:
    """The text of an attribute; None if it holds no single text."""
    value = np.asarray(value).ravel().tolist()
    if len(value) != 1 or not isinstance(value[0], (str, bytes)):
        return None
    text = (
        value[0] if isinstance(value[0], str) else value[0].decode("utf-8", "replace")
    )
    return text.strip() or None


def _as_rate(value: object) -> float | None:
    """A positive number of an attribute."""
    number = np.asarray(value)
    if number.size != 1 or number.dtype.kind not in "iuf" or not number.item() > 0:
        return None
    return float(number.item())


def _as_rate_of_step(value: object) -> float | None:
    step = _as_rate(value)
    return None if step is None else rate_of(step)


def _is_numeric(data_set: h5py.Dataset, matlab: bool) -> bool:
    """Whether a data set holds numbers, and not a text or nothing."""
    if data_set.shape is None or "MATLAB_empty" in data_set.attrs:
        return False
    if matlab and data_set.attrs.get("MATLAB_class") in (b"char", "char"):
        return False
    return data_set.dtype.kind in "biufc"


def table_without_objects(
    path: Path, kind: str, arrays: dict[str, np.ndarray], objects: list[str]
) -> Table:
    """The table of a file without MATLAB's objects, which only MATLAB can read."""
    if objects and all(values.size <= 1 for values in arrays.values()):
        raise FileFormatError(
            f"{path} holds {', '.join(objects)}, which MATLAB alone can read",
            "In MATLAB: T = timetable2table(TT); t = seconds(T.Time); a1 = T.a1;"
            " save('test.mat', 't', 'a1', '-v7')",
        )
    notes = tuple(f"not read, an object of MATLAB: {title}" for title in objects)
    return Table(path, kind, arrays, notes=notes)


def require_own(path: str | PathLike[str], name: str, data_set: h5py.Dataset) -> None:
    """Refuse a data set whose values lie in other files."""
    if data_set.external or data_set.is_virtual:
        raise FileFormatError(
            f"{path}: the data set {name!r} lies in another file, which is not opened",
            "Export the measured values themselves into one file.",
        )


def data_sets(library: ModuleType, file: h5py.File) -> dict[str, h5py.Dataset]:
    """Data sets of an open file by name, each once.

    Links into other files are not followed.
    """
    by_name = {}

    def collect(name: str, item: h5py.Dataset | h5py.Group) -> None:
        if isinstance(item, library.Dataset):
            by_name[name] = item

    file.visititems(collect)
    return by_name
