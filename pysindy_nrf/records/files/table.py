"""Content of a file by name, and guards against files that are not what they claim."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from ...exceptions import FileFormatError, NRFError
from .attributes import Attributes

MAX_BYTES = 4_000_000_000  # larger files are refused; a record of a test is far below
MAX_NAMES_SHOWN = 20
MAX_NAME_LENGTH = 80  # characters of a name in a message


@dataclass(frozen=True)
class Clock:
    """An even clock of one variable.

    Parameters
    ----------
    fs : float
        Sampling rate, Hz.
    start : float
        Time of the first sample, s: from the origin, else on a clock that all variables
        share.
    origin : numpy.datetime64, optional
        A time of day from which the start counts.
    """

    fs: float
    start: float = 0.0
    origin: np.datetime64 | None = None

    def end(self, n_samples: int) -> float:
        """Time of the last sample, s."""
        return self.start + (n_samples - 1) / self.fs


@dataclass(frozen=True)
class Table:
    """Variables of one file by name, as in the file (no unit converted).

    Parameters
    ----------
    path : Path
    kind : str
        Such as ``"Parquet"``.
    variables : dict of str to ndarray
        Columns of shape (n_samples,), matrices and single numbers.
    units : dict of str to str
        Units that are written in the file, by variable.
    notes : tuple of str
        Decisions of the reader, in words.
    attributes : Attributes, optional
        Of a record that this package wrote.
    fs : float, optional
        Sampling rate, Hz, where the file states one and has no time.
    decimal : str
        Decimal mark of columns that are still text.
    clocks : dict of str to Clock
        By variable, where the file states rates and starts.
    files : tuple of str
        Names of the files of one test, without their ends; variables are called
        ``file.variable``. Empty for one file.
    """

    path: Path
    kind: str
    variables: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    attributes: Attributes | None = None
    fs: float | None = None
    decimal: str = "."
    clocks: dict[str, Clock] = field(default_factory=dict)
    files: tuple[str, ...] = ()

    def file_of(self, variable: str) -> str:
        """The file of a variable, among those of one test."""
        matching = [stem for stem in self.files if variable.startswith(f"{stem}.")]
        return max(matching, key=len, default="")

    @property
    def in_words(self) -> str:
        """The kind of file, and what its reader decided."""
        return "; ".join((self.kind, *self.notes))

    @property
    def names(self) -> str:
        """Names and shapes of the variables, for messages."""
        shown = [
            _name_and_shape(name, values)
            for name, values in list(self.variables.items())[:MAX_NAMES_SHOWN]
        ]
        hidden = len(self.variables) - len(shown)
        more = f" and {hidden} more" if hidden else ""
        return ", ".join(shown) + more


def _name_and_shape(name: str, values: np.ndarray) -> str:
    if values.ndim == 1:
        return short(name)
    shape = "x".join(map(str, values.shape)) if values.ndim else "(a number)"
    return f"{short(name)} {shape}"


def short(name: str) -> str:
    """A name, cut where a message would drown in it."""
    if len(name) <= MAX_NAME_LENGTH:
        return name
    return f"{name[:60]}... ({len(name)} characters)"


def check_file(path: Path, max_bytes: int = MAX_BYTES) -> None:
    """Refuse a path that is no file, and a file that is empty or too large."""
    if not path.exists():
        raise FileFormatError(f"{path} does not exist", "Check the path.")
    if not path.is_file():
        raise FileFormatError(
            f"{path} is not a file", "Give one file with the channels of one test."
        )

    size = path.stat().st_size
    if size == 0:
        raise FileFormatError(f"{path} is empty (0 bytes)", "Export it again.")
    check_size(path, size, max_bytes)


# Samples of sensors shrink to a third or a tenth. A channel of zeros shrinks a
# thousandfold, but is not alone in its file.
MAX_COMPRESSION = 100
HARMLESS_BYTES = 200_000_000  # of a content whose proportion does not matter


def check_size(path: Path, size: int, max_bytes: int) -> None:
    """Refuse a content that is too large, or out of all proportion to its file."""
    file_size = path.stat().st_size
    if size > max_bytes:
        raise FileFormatError(
            f"{path} holds {size / 1e9:.3g} GB, more than the limit of"
            f" {max_bytes / 1e9:.3g} GB",
            "Split it into records, or raise max_bytes=.",
        )
    if size > max(HARMLESS_BYTES, MAX_COMPRESSION * file_size):
        raise FileFormatError(
            f"{path}, a file of {file_size / 1e6:.2g} MB, unpacks to more than"
            f" {size / 1e9:.2g} GB, as no measured channels do",
            "Save it uncompressed if it is right.",
        )


def unreadable(path: Path, kind: str, error: Exception | str) -> FileFormatError:
    """Error for a file that is damaged or of another type."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return FileFormatError(
        f"{path} cannot be read as {kind}: {reason[:300]}",
        "It may be cut off, damaged or of another type; export it again, or rename it"
        " to its true type.",
    )


@contextmanager
def reading_as(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into an error that names it."""
    try:
        yield
    except NRFError:
        raise
    except Exception as error:
        raise unreadable(path, kind, error) from error


def without_empty_rows(
    frame: pd.DataFrame, has_time: bool
) -> tuple[pd.DataFrame, list[str]]:
    """A table without rows in which every cell is empty, and a note on them.

    Empty rows between others are kept where no time would show that samples are missing
    there.
    """
    is_empty = frame.isna().all(axis=1).to_numpy()
    filled = np.flatnonzero(~is_empty)
    if not is_empty.any() or not filled.size:
        return frame, []

    inside = slice(filled[0], filled[-1] + 1)
    filled_rows = frame.iloc[inside]
    if has_time:
        filled_rows = filled_rows[~is_empty[inside]]
    n_dropped = len(frame) - len(filled_rows)
    if not n_dropped:
        return frame, []
    rows = "row" if n_dropped == 1 else "rows"
    return filled_rows.infer_objects(), [f"{n_dropped} empty {rows} left out"]


def two_columns_of_one_name(path: Path, name: str) -> FileFormatError:
    """Error for a table whose columns cannot be distinguished."""
    return FileFormatError(f"{path} has two columns named {name!r}", "Rename one.")
