"""What a file holds: variables by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...exceptions import FileFormatError
from .attributes import Attributes

# A record of a test fits in memory many times over below this size.
MAX_BYTES = 4_000_000_000


@dataclass
class Table:
    r"""Variables of one file by name.

    Attributes
    ----------
    path : Path
    kind : str
        ``"CSV"``, ``"Parquet"``, ``"MAT"``, ...
    variables : dict of str to ndarray
        Columns of shape (n_samples,), matrices and scalars, as in the file (no unit converted).
    units : dict of str to str
        Units written in the file's header.
    notes : list of str
        What the reader decided, in words.
    attributes : Attributes, optional
        Of the record, where the file was written by this package.
    fs : float, optional
        Sampling rate, Hz, where the file states one and has no time.
    decimal : {".", ","}
        Decimal mark of columns that are still text.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf import io
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "own.csv")
    ...     _ = path.write_text("t,Deck [mm]\n0.00,1.5\n0.01,1.6\n")
    ...     table = io.read_table(path)
    >>> table.kind, list(table.variables), table.units
    ('delimited text', ['t', 'Deck'], {'Deck': 'mm'})
    """

    path: Path
    kind: str
    variables: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    attributes: Attributes | None = None
    fs: float | None = None
    decimal: str = "."

    @property
    def names(self) -> str:
        """Names and shapes of the variables, for messages."""
        shown = [
            name if values.ndim == 1 else f"{name} {'x'.join(map(str, values.shape)) if values.ndim else '(a number)'}"
            for name, values in self.variables.items()
        ]
        return ", ".join(shown[:20]) + (f" and {len(shown) - 20} more" if len(shown) > 20 else "")


def check_file(path: Path, max_bytes: int = MAX_BYTES) -> None:
    """Refuse what is not a file, is empty or too large."""
    if not path.exists():
        raise FileFormatError(f"{path} does not exist", "Check the path.")
    if not path.is_file():
        raise FileFormatError(f"{path} is not a file", "Give one file with the channels of one test.")
    size = path.stat().st_size
    if size == 0:
        raise FileFormatError(f"{path} is empty (0 bytes)", "Export it again.")
    check_size(path, size, max_bytes)


def check_size(path: Path, size: int, max_bytes: int) -> None:
    """Refuse more bytes than are wanted."""
    if size > max_bytes:
        raise FileFormatError(
            f"{path} holds {size / 1e9:.3g} GB, more than the limit of {max_bytes / 1e9:.3g} GB",
            "Split it into records, or raise max_bytes=.",
        )


def unreadable(path: Path, kind: str, error: Exception | str) -> FileFormatError:
    """The error for a file that is not what it claims to be."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return FileFormatError(
        f"{path} cannot be read as {kind}: {reason[:300]}",
        "It may be cut off, damaged or of another type; export it again, or rename it to its true type.",
    )
