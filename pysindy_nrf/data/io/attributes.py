"""What a record is beside its columns, written into files so that reading gives the same record, bit for bit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...exceptions import ChannelError, FileFormatError, FileVersionError
from ..record import Record

SCHEMA, VERSION = "pysindy_nrf.Record", 1
_MATRICES = {"F": "force", "a": "acceleration", "v": "velocity", "x": "displacement"}
_BASES = {"ag": "base_acceleration", "vg": "base_velocity", "xg": "base_displacement"}


@dataclass(frozen=True)
class Attributes:
    """Attributes of a record.

    Attributes
    ----------
    name, coordinates : str
    fs, t0 : float
        Sampling rate, Hz, and time of the first sample, s.
    n_samples : int
    columns : tuple of str
        Names of all columns in order, those of covariates as the user gave them.
    covariates : tuple of str
        Which of them are covariates, whatever they are called.
    float32 : tuple of str
        Which of them are single precision.
    """

    name: str
    coordinates: str
    fs: float
    t0: float
    n_samples: int
    columns: tuple[str, ...]
    covariates: tuple[str, ...] = ()
    float32: tuple[str, ...] = ()

    @classmethod
    def of(cls, record: Record) -> Attributes:
        """Those of a record."""
        columns = columns_of(record)
        return cls(
            record.name,
            record.coordinates,
            float(record.fs),
            float(record.t0),
            record.n_samples,
            tuple(columns),
            tuple(record.covariates),
            tuple(name for name, line in columns.items() if line.dtype == np.float32),
        )

    def to_json(self) -> str:
        """One line of ASCII."""
        return json.dumps({"schema": SCHEMA, "version": VERSION, **asdict(self)}, allow_nan=False)

    @classmethod
    def from_json(cls, text: str | bytes, where: Any) -> Attributes:
        """Read what :meth:`to_json` wrote."""
        try:
            data = json.loads(text)
            if data.pop("schema") != SCHEMA:
                raise ValueError("it is of another schema")
            version = data.pop("version")
            if not isinstance(version, int) or isinstance(version, bool):
                raise ValueError(f"its version is {version!r}")
            if version > VERSION:
                raise FileVersionError(
                    f"The record in {where} has version {version}, this package reads up to {VERSION}",
                    "Update pysindy_nrf.",
                )
            return cls._checked(data)
        except FileFormatError:
            raise
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise FileFormatError(
                f"The attributes of the record in {where} are damaged: {error}", "Write it again with write_record."
            ) from error

    @classmethod
    def _checked(cls, data: Mapping[str, Any]) -> Attributes:
        texts: dict[str, Any] = {key: data[key] for key in ("name", "coordinates")}
        numbers: dict[str, Any] = {key: float(data[key]) for key in ("fs", "t0")}
        lists: dict[str, Any] = {key: tuple(data[key]) for key in ("columns", "covariates", "float32")}
        names = [name for group in lists.values() for name in group]
        if not all(isinstance(text, str) for text in (*texts.values(), *names)):
            raise ValueError("a name is no text")
        if texts["coordinates"] not in ("relative", "absolute"):
            raise ValueError(f"its coordinates are {texts['coordinates']!r}")
        if not np.isfinite(list(numbers.values())).all() or numbers["fs"] <= 0:
            raise ValueError("its clock is no number")
        if not {*lists["covariates"], *lists["float32"]} <= set(lists["columns"]):
            raise ValueError("it names columns that it does not have")
        return cls(**texts, **numbers, **lists, n_samples=int(data["n_samples"]))


def columns_of(record: Record) -> dict[str, np.ndarray]:
    """All columns of a record by name, columns of NaN (not measured, force unknown) too."""
    out: dict[str, np.ndarray] = {}
    for prefix, key in _MATRICES.items():
        matrix = getattr(record, key)
        if matrix is not None:
            out |= {f"{prefix}{j + 1}": matrix[:, j] for j in range(record.n_dof)}
    out |= {short: line for short, key in _BASES.items() if (line := getattr(record, key)) is not None}
    for name, line in record.covariates.items():
        if name in out or name == "t":
            raise ChannelError(
                f"The covariate {name!r} of record {record.name!r} has the name of another column of the file",
                "Rename it: record.replace(covariates=...).",
            )
        out[str(name)] = line
    return out


def restored(attributes: Attributes, columns: Mapping[str, np.ndarray]) -> Record:
    """The record that was written."""
    lines = {}
    for name in attributes.columns:
        if name not in columns:
            raise FileFormatError(f"The file lacks the column {name!r} of {attributes.name!r}", "Write it again.")
        if len(columns[name]) != attributes.n_samples:
            raise FileFormatError(
                f"{attributes.name!r} had {attributes.n_samples} samples, {len(columns[name])} of {name!r} are there",
                "The file is cut off; write it again.",
            )
        dtype = np.float32 if name in attributes.float32 else np.float64
        try:
            lines[name] = np.asarray(columns[name]).astype(dtype)
        except (TypeError, ValueError) as error:
            raise FileFormatError(
                f"The column {name!r} of record {attributes.name!r} holds no numbers", "Write it again."
            ) from error
    covariates = {name: lines.pop(name) for name in attributes.covariates}
    matrices = {}
    for prefix, key in _MATRICES.items():
        own = [line for name, line in lines.items() if name[:1] == prefix and name[1:].isdigit()]
        if own:
            matrices[key] = np.column_stack(own)
    bases = {key: lines[short] for short, key in _BASES.items() if short in lines}
    record = Record(
        **matrices,
        **bases,
        fs=attributes.fs,
        covariates=covariates,
        name=attributes.name,
        coordinates=attributes.coordinates,
    )
    record.t0 = attributes.t0
    return record
