"""Content of a file: variables by name, and the attributes by which a record written
here is restored bit for bit.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...exceptions import ChannelError, FileFormatError, FileVersionError, NRFError
from ..record import BASES, MATRICES, Record

MAX_BYTES = 4_000_000_000  # larger files are refused; a record of a test is far below
SCHEMA, VERSION = "pysindy_nrf.Record", 1


@dataclass
class Table:
    """Variables of one file by name, as in the file (no unit converted)."""

    path: Path
    kind: str  # "CSV", "Parquet", "MAT", ...
    variables: dict[
        str, np.ndarray
    ]  # columns of shape (n_samples,), matrices and scalars
    units: dict[str, str] = field(default_factory=dict)  # written in the header
    notes: list[str] = field(default_factory=list)  # decisions of the reader, in words
    attributes: Attributes | None = None  # of a record that this package wrote
    fs: float | None = None  # Hz, where the file states one and has no time
    decimal: str = "."  # mark of columns that are still text

    @property
    def names(self) -> str:
        """Names and shapes of the variables, for messages."""
        shown = [
            (
                name
                if values.ndim == 1
                else (
                    f"{name}"
                    f" {'x'.join(map(str, values.shape)) if values.ndim else '(a number)'}"
                )
            )
            for name, values in zip(map(short, self.variables), self.variables.values())
        ]
        return ", ".join(shown[:20]) + (
            f" and {len(shown) - 20} more" if len(shown) > 20 else ""
        )


def short(name: str) -> str:
    """A name, cut where a message would drown in it."""
    return name if len(name) <= 80 else f"{name[:60]}... ({len(name)} characters)"


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


# Samples of sensors shrink to a third or a tenth; a channel of zeros shrinks a
# thousandfold, but is not alone.
_SHRINKS, _HARMLESS = (
    100,
    200_000_000,
)  # times, and bytes below which it does not matter


def check_size(path: Path, size: int, max_bytes: int) -> None:
    """Refuse a content of more bytes than the limit, or out of all proportion to its
    file.
    """
    if _HARMLESS < size <= max_bytes and size > _SHRINKS * path.stat().st_size:
        what = (
            f"{path}, a file of {path.stat().st_size / 1e6:.2g} MB, unpacks to more"
            f" than {size / 1e9:.2g} GB"
        )
        raise FileFormatError(
            f"{what}, as no measured channels do",
            "Save it uncompressed if it is right.",
        )
    if size > max_bytes:
        what = (
            f"{path} holds {size / 1e9:.3g} GB, more than the limit of"
            f" {max_bytes / 1e9:.3g} GB"
        )
        raise FileFormatError(what, "Split it into records, or raise max_bytes=.")


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
    """What a library raises on a damaged file, which may be anything, as an error that
    names the file.
    """
    try:
        yield
    except NRFError:
        raise
    except Exception as error:
        raise unreadable(path, kind, error) from error


@dataclass(frozen=True)
class Attributes:
    """Attributes of a record; names of all columns, of those that are covariates, and
    of those in single precision.
    """

    name: str
    coordinates: str
    fs: float  # Hz
    t0: float  # s, time of the first sample
    n_samples: int
    columns: tuple[str, ...]
    covariates: tuple[str, ...] = ()
    float32: tuple[str, ...] = ()

    @classmethod
    def of(cls, record: Record) -> Attributes:
        """Attributes of a record."""
        columns = columns_of(record)
        single = tuple(
            name for name, line in columns.items() if line.dtype == np.float32
        )
        clock = float(record.fs), float(record.t0), record.n_samples
        return cls(
            record.name,
            record.coordinates,
            *clock,
            tuple(columns),
            tuple(record.covariates),
            single,
        )

    def to_json(self) -> str:
        """Attributes as one line of ASCII."""
        return json.dumps(
            {"schema": SCHEMA, "version": VERSION, **asdict(self)}, allow_nan=False
        )

    @classmethod
    def from_json(cls, text: str | bytes, where: Any) -> Attributes:
        """Attributes from the text of :meth:`to_json`."""
        try:
            data = json.loads(text)
            if data["schema"] != SCHEMA:
                raise ValueError("it is of another schema")
            return cls.checked(data, where)
        except FileFormatError:
            raise
        except (
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            OverflowError,
            RecursionError,
        ) as error:
            cure = "Write it again with write_record."
            raise FileFormatError(
                f"The attributes of the record in {where} are damaged: {error}", cure
            ) from error

    @classmethod
    def checked(cls, data: Mapping[str, Any], where: Any) -> Attributes:
        """Attributes from a mapping; ValueError, KeyError or TypeError if it is
        damaged.
        """
        version = data["version"]
        if not isinstance(version, int) or isinstance(version, bool):
            raise ValueError(f"its version is {version!r}")
        if version > VERSION:
            what = (
                f"The record in {where} has version {version}, this package reads up to"
                f" {VERSION}"
            )
            raise FileVersionError(what, "Update pysindy_nrf.")
        texts: dict[str, Any] = {key: data[key] for key in ("name", "coordinates")}
        numbers: dict[str, Any] = {key: float(data[key]) for key in ("fs", "t0")}
        lists: dict[str, Any] = {
            key: tuple(data[key]) for key in ("columns", "covariates", "float32")
        }
        if not all(
            isinstance(text, str)
            for text in (*texts.values(), *sum(lists.values(), ()))
        ):
            raise ValueError("a name is not a text")
        if texts["coordinates"] not in ("relative", "absolute"):
            raise ValueError(f"its coordinates are {texts['coordinates']!r}")
        if not np.isfinite(list(numbers.values())).all() or numbers["fs"] <= 0:
            raise ValueError("its sampling rate or first time is not valid")
        if not {*lists["covariates"], *lists["float32"]} <= set(lists["columns"]):
            raise ValueError("it names columns that it does not have")
        return cls(**texts, **numbers, **lists, n_samples=int(data["n_samples"]))


def columns_of(record: Record) -> dict[str, np.ndarray]:
    """All columns of a record by name, including columns of NaN (not measured, force
    unknown).
    """
    out: dict[str, np.ndarray] = {}
    for key, prefix in MATRICES.items():
        matrix = getattr(record, key)
        if matrix is not None:
            out |= {f"{prefix}{j + 1}": matrix[:, j] for j in range(record.n_dof)}
    out |= {
        short: line
        for key, short in BASES.items()
        if (line := getattr(record, key)) is not None
    }
    for name, line in record.covariates.items():
        if name in out or name == "t":
            what = (
                f"The covariate {name!r} of record {record.name!r} has the name of"
                " another column of the file"
            )
            raise ChannelError(what, "Rename it: record.replace(covariates=...).")
        out[str(name)] = line
    return out


def restored(attributes: Attributes, columns: Mapping[str, np.ndarray]) -> Record:
    """The record from its attributes and the columns of the file."""
    lines = {}
    for name in attributes.columns:
        if name not in columns:
            raise FileFormatError(
                f"The file lacks the column {name!r} of {attributes.name!r}",
                "Write it again.",
            )
        if len(columns[name]) != attributes.n_samples:
            what = (
                f"{attributes.name!r} had {attributes.n_samples} samples,"
                f" {len(columns[name])} of {name!r} are there"
            )
            raise FileFormatError(what, "The file is cut off; write it again.")
        try:
            lines[name] = np.asarray(columns[name]).astype(
                np.float32 if name in attributes.float32 else np.float64
            )
        except (TypeError, ValueError) as error:
            what = f"The column {name!r} of record {attributes.name!r} holds no numbers"
            raise FileFormatError(what, "Write it again.") from error
    covariates = {name: lines.pop(name) for name in attributes.covariates}
    parts: dict[str, Any] = {
        key: lines[short] for key, short in BASES.items() if short in lines
    }
    for key, prefix in MATRICES.items():
        own = [
            line
            for name, line in lines.items()
            if name[:1] == prefix and name[1:].isdigit()
        ]
        if own:
            parts[key] = np.column_stack(own)
    about: dict[str, Any] = {
        "name": attributes.name,
        "coordinates": attributes.coordinates,
        "fs": attributes.fs,
    }
    record = Record(**parts, **about, covariates=covariates)
    record.t0 = attributes.t0
    return record
