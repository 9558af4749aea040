"""Attributes of a record, by which a file written here gives it back bit for bit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from ...exceptions import ChannelError, FileFormatError, FileVersionError
from ..hold import HOLDS
from ..record import COORDINATES, Record

SCHEMA, VERSION = "pysindy_nrf.Record", 1

# What JSON and the types of its values raise on a damaged text.
_DAMAGE = (
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
    RecursionError,
)


@dataclass(frozen=True)
class Attributes:
    """What a record is apart from the numbers of its columns.

    Parameters
    ----------
    name : str
    coordinates : {"relative", "absolute"}
    fs : float
        Sampling rate, Hz.
    t0 : float
        Time of the first sample, s.
    n_samples : int
    columns : tuple of str
        Names of all columns in their order.
    covariates : tuple of str
        Columns that are covariates, whatever their names are.
    float32 : tuple of str
        Columns in single precision.
    rotates : bool
        Whether its channels are angles and torques.
    hold : {"cubic", "linear", "zero"}, optional
        Course of the forces between the samples, where the record says it.
    """

    name: str
    coordinates: str
    fs: float
    t0: float
    n_samples: int
    columns: tuple[str, ...]
    covariates: tuple[str, ...] = ()
    float32: tuple[str, ...] = ()
    rotates: bool = False
    hold: str | None = None

    @classmethod
    def of_record(cls, record: Record) -> Attributes:
        """Attributes of a record."""
        columns = columns_of(record)
        single = [name for name, line in columns.items() if line.dtype == np.float32]
        return cls(
            name=record.name,
            coordinates=record.coordinates,
            fs=float(record.fs),
            t0=float(record.t0),
            n_samples=record.n_samples,
            columns=tuple(columns),
            covariates=tuple(record.covariates),
            float32=tuple(single),
            rotates=record.rotates,
            hold=record.hold,
        )

    def to_json(self) -> str:
        """Attributes as one line of ASCII."""
        content = {"schema": SCHEMA, "version": VERSION, **asdict(self)}
        return json.dumps(content, allow_nan=False)

    @classmethod
    def from_json(cls, text: str | bytes, where: object) -> Attributes:
        """Attributes from the text of :meth:`to_json`.

        Raises
        ------
        FileFormatError
            If the text is damaged.
        FileVersionError
            If a later version of this package wrote it.
        """
        try:
            data = json.loads(text)
            _require_version(data, where)
            attributes = cls(
                name=data["name"],
                coordinates=data["coordinates"],
                fs=float(data["fs"]),
                t0=float(data["t0"]),
                n_samples=int(data["n_samples"]),
                columns=tuple(data["columns"]),
                covariates=tuple(data["covariates"]),
                float32=tuple(data["float32"]),
                rotates=data.get("rotates", False) is True,
                hold=data.get("hold"),
            )
            _require_consistent(attributes)
        except FileFormatError:
            raise
        except _DAMAGE as error:
            raise FileFormatError(
                f"The attributes of the record in {where} are damaged: {error}",
                "Write it again with write_record.",
            ) from error
        return attributes


def _require_version(data: Mapping[str, object], where: object) -> None:
    """Refuse another schema and later versions."""
    if data["schema"] != SCHEMA:
        raise ValueError("it is of another schema")

    version = data["version"]
    if not isinstance(version, int) or isinstance(version, bool):
        raise ValueError(f"its version is {version!r}")
    if version > VERSION:
        raise FileVersionError(
            f"The record in {where} has version {version}, this package reads up to"
            f" {VERSION}",
            "Update pysindy_nrf.",
        )


def _require_consistent(attributes: Attributes) -> None:
    """Raise ValueError for attributes that someone edited."""
    columns = attributes.columns
    marked = attributes.covariates + attributes.float32
    texts = (attributes.name, attributes.coordinates) + columns + marked
    if not all(isinstance(text, str) for text in texts):
        raise ValueError("a name is not a text")
    if attributes.coordinates not in COORDINATES:
        raise ValueError(f"its coordinates are {attributes.coordinates!r}")
    if attributes.hold is not None and attributes.hold not in HOLDS:
        raise ValueError(f"its forces have the course {attributes.hold!r}")
    if not np.isfinite([attributes.fs, attributes.t0]).all() or attributes.fs <= 0:
        raise ValueError("its sampling rate or first time is not valid")
    if not set(marked) <= set(columns):
        raise ValueError("it names columns that it does not have")


def columns_of(record: Record) -> dict[str, np.ndarray]:
    """All columns of a record by name.

    They include columns of NaN, which are channels that were not measured or forces
    that are unknown.
    """
    columns = record.dof_channels() | record.base_channels()
    for name, line in record.covariates.items():
        if name in columns or name == "t":
            raise ChannelError(
                f"The covariate {name!r} of record {record.name!r} has the name of"
                " another column of the file",
                "Rename it: record.replace(covariates=...).",
            )
        columns[str(name)] = line
    return columns


def restored(attributes: Attributes, columns: Mapping[str, np.ndarray]) -> Record:
    """The record from its attributes and the columns of the file."""
    lines = {
        name: _restored_column(name, attributes, columns) for name in attributes.columns
    }
    covariates = {name: lines.pop(name) for name in attributes.covariates}
    record = Record.from_channels(
        lines,
        fs=attributes.fs,
        name=attributes.name,
        coordinates=attributes.coordinates,
        covariates=covariates,
        hold=attributes.hold,
    )
    record = record.starting_at(attributes.t0)
    return record.of_rotations() if attributes.rotates else record


def _restored_column(
    name: str, attributes: Attributes, columns: Mapping[str, np.ndarray]
) -> np.ndarray:
    """A column of the file, whole and in its precision."""
    if name not in columns:
        raise FileFormatError(
            f"The file lacks the column {name!r} of {attributes.name!r}",
            "Write it again.",
        )

    column = np.asarray(columns[name])
    if len(column) != attributes.n_samples:
        raise FileFormatError(
            f"{attributes.name!r} had {attributes.n_samples} samples, {len(column)} of"
            f" {name!r} are there",
            "The file is cut off; write it again.",
        )

    try:
        return column.astype(np.float32 if name in attributes.float32 else np.float64)
    except (TypeError, ValueError) as error:
        raise FileFormatError(
            f"The column {name!r} of record {attributes.name!r} holds no numbers",
            "Write it again.",
        ) from error
