"""LabVIEW measurement files (.lvm): text with a header for the file and its channels.

Reference: National Instruments, "Specification for the LabVIEW measurement file".
"""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ....exceptions import FileFormatError
from ...clock import rate_of
from ..table import MAX_BYTES, Clock, Table, unreadable

FORMAT = "LabVIEW measurement"
END_OF_HEADER = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ","}


def read_lvm(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the channels of a LabVIEW measurement file, with units and clocks."""
    lines = path.read_text(encoding="latin-1").splitlines()
    ends = [row for row, line in enumerate(lines) if line.startswith(END_OF_HEADER)]
    if not ends:
        raise unreadable(path, FORMAT, "its header does not end")
    if len(ends) > 2:
        raise FileFormatError(
            f"{path} holds {len(ends) - 1} measurements one after the other",
            "Export each as a file of its own; they are several tests.",
        )

    of_file = _header(lines[: ends[0]], "\t")
    separator = _SEPARATORS.get(of_file.get("separator", ["tab"])[0].lower(), "\t")
    decimal = of_file.get("decimal_separator", ["."])[0] or "."
    of_channels = _header(lines[ends[0] : ends[-1]], separator)
    names = [name.strip() for name in lines[ends[-1] + 1].split(separator)]
    frame = _numbers(path, lines[ends[-1] + 2 :], names, separator, decimal)
    columns = of_file.get("x_columns", ["One"])[0].lower()
    return _table(path, frame, names, columns, _Channels(of_channels, decimal))


class _Channels:
    """What the second header says of each channel."""

    def __init__(self, header: Mapping[str, Sequence[str]], decimal: str) -> None:
        self.header = header
        self.decimal = decimal

    def unit(self, number: int) -> str:
        units = self.header.get("y_unit_label", [])
        return units[number].strip() if number < len(units) else ""

    def clock(self, number: int) -> Clock | None:
        """The clock of a channel, from its step and its start."""
        step = self._number("delta_x", number)
        if step is None or step <= 0:
            return None
        return Clock(rate_of(step), self._number("x0", number) or 0.0)

    def _number(self, key: str, number: int) -> float | None:
        cells = self.header.get(key, [])
        if number >= len(cells):
            return None
        try:
            return float(cells[number].replace(self.decimal, "."))
        except ValueError:
            return None


def _header(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    """Entries of a header by key in small letters."""
    entries = {}
    for line in lines:
        key, *cells = line.rstrip().split(separator)
        if cells:
            entries[key.strip().lower()] = cells
    return entries


def _numbers(
    path: Path, lines: Sequence[str], names: Sequence[str], separator: str, decimal: str
) -> pd.DataFrame:
    """Rows of numbers; a last column of comments is left out."""
    try:
        frame = pd.read_csv(
            io.StringIO("\n".join(lines)),
            sep=separator,
            decimal=decimal,
            header=None,
            names=list(range(len(names))),
            index_col=False,
            skipinitialspace=True,
        )
    except ValueError as error:
        raise unreadable(path, FORMAT, error) from error
    has_comment = names[-1].lower() == "comment"
    return frame.iloc[:, : len(names) - has_comment]


def _table(
    path: Path,
    frame: pd.DataFrame,
    names: Sequence[str],
    x_columns: str,
    channels: _Channels,
) -> Table:
    """Channels by name; the columns of X are clocks."""
    variables: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, Clock] = {}
    number = 0
    for k in frame.columns:
        line = frame[k].to_numpy(dtype=float)
        if _is_clock(names[k]):
            if x_columns == "one" and np.isfinite(line).all():
                variables["t"], units["t"] = line, "s"
            continue
        name = names[k] if names[k] not in variables else f"{names[k]} {number + 1}"
        variables[name] = line[: _last_filled(line)]
        if channels.unit(number):
            units[name] = channels.unit(number)
        clock = channels.clock(number)
        if clock is not None:
            clocks[name] = clock
        number += 1

    if "t" in variables:
        return Table(path, FORMAT, variables, units)
    rates = {clock.fs for clock in clocks.values()}
    fs = rates.pop() if len(rates) == 1 else None
    return Table(path, FORMAT, variables, units, fs=fs, clocks=clocks)


def _is_clock(name: str) -> bool:
    return name.lower().startswith("x_value") or not name


def _last_filled(line: np.ndarray) -> int:
    """Number of samples up to the last that is filled."""
    filled = np.flatnonzero(np.isfinite(line))
    return int(filled[-1]) + 1 if filled.size else 0
