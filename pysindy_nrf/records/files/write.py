"""Writing of records, tables of results and reconstructed forces.

A file is written completely or not at all.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Protocol

import numpy as np
import pandas as pd

from ...common.files import atomic_write
from ...common.lazy import require
from ...exceptions import ChannelError, FileFormatError
from ..dataset import Dataset, Ends
from ..record import Record
from .attributes import Attributes, columns_of
from .formats import PARQUET, UFF
from .formats.parquet import ATTRIBUTES_KEY
from .formats.uff import REACTION_FORCE, TimeHistory, write_data_sets, write_uff

CSV = (".csv",)
FORMULA_SIGNS = ("=", "+", "-", "@")  # by which a spreadsheet knows a formula


def write_record(record: Record, path: str | PathLike[str]) -> Path:
    """Write a record so that :func:`read_record` gives it back bit for bit.

    Parameters
    ----------
    record : Record
    path : path-like
        ``.parquet``, ``.uff`` or ``.unv`` (UFF 58, binary), or ``.csv``. All columns
        are kept (those of NaN too), in SI units, with sampling rate, first time, name,
        coordinates, covariates and base motion.

    Raises
    ------
    FileFormatError
        If the type is not one of these.
    ChannelError
        If a name cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf import datasets, io
    >>> record = datasets.load_demo()
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     back = io.read_record(
    ...         io.write_record(record, pathlib.Path(folder, "test.csv"))
    ...     )
    >>> bool((back.acceleration == record.acceleration).all())
    True
    """
    path = Path(path)
    suffix = _known_suffix(path, PARQUET.suffixes + UFF.suffixes + CSV)
    attributes = Attributes.of_record(record)
    columns = columns_of(record)

    if suffix in UFF.suffixes:
        write_uff(path, columns, attributes)
        return path

    columns = {"t": record.time, **columns}
    if suffix in CSV:
        _write_csv(path, columns, attributes)
    else:
        _write_parquet(path, columns, attributes)
    return path


def _write_csv(
    path: Path, columns: dict[str, np.ndarray], attributes: Attributes
) -> None:
    """Write attributes, names and numbers as delimited text."""
    frame = pd.DataFrame(dict(enumerate(columns.values())))
    with atomic_write(path) as file:
        file.write(f"# {attributes.to_json()}\n")
        # the second line is for human readers; names are read from the first
        csv.writer(file, lineterminator="\n").writerow(map(_no_formula, columns))
        frame.to_csv(file, index=False, header=False, na_rep="nan", lineterminator="\n")


def _write_parquet(
    path: Path, columns: dict[str, np.ndarray], attributes: Attributes | None = None
) -> None:
    """Write columns, and the attributes of a record as metadata."""
    pyarrow = require("pyarrow", "files", "Writing Parquet files")
    parquet = require("pyarrow.parquet", "files", "Writing Parquet files")
    try:
        # from_pandas=False: NaN is kept and not turned into a missing value
        arrays = {
            name: pyarrow.array(line, from_pandas=False)
            for name, line in columns.items()
        }
        table = pyarrow.table(arrays)
    except (pyarrow.ArrowException, UnicodeError) as error:
        raise ChannelError(
            f"{path}: a column cannot be written: {error}", "Rename it."
        ) from error

    if attributes is not None:
        metadata = {ATTRIBUTES_KEY: attributes.to_json().encode()}
        table = table.replace_schema_metadata(metadata)
    with atomic_write(path, "wb") as file:
        parquet.write_table(table, file)


def _no_formula(cell: object) -> object:
    """A text on one line, quoted if spreadsheets would run it as a formula."""
    if not isinstance(cell, str):
        return cell
    text = " ".join(cell.split())
    if text.startswith(FORMULA_SIGNS):
        return f"'{text}"
    return text or cell


def write_table(table: pd.DataFrame, path: str | PathLike[str]) -> Path:
    """Write a table of results.

    Parameters
    ----------
    table : DataFrame
        Its index is written if it has a name.
    path : path-like
        ``.csv`` or ``.parquet``.

    Raises
    ------
    FileFormatError
        If it has another ending.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import pandas as pd
    >>> from pysindy_nrf.records.files import write_table
    >>> table = pd.DataFrame(
    ...     {"mass": [12.03, 10.03]},
    ...     index=pd.Index(["m1", "m2"], name="parameter"),
    ... )
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     print(
    ...         write_table(
    ...             table, pathlib.Path(folder, "masses.csv")
    ...         ).read_text()
    ...     )
    parameter,mass
    m1,12.03
    m2,10.03
    """
    path = Path(path)
    suffix = _known_suffix(path, CSV + PARQUET.suffixes)
    flat = table.reset_index() if table.index.name else table

    if suffix in CSV:
        safe = flat.map(_no_formula).rename(columns=_no_formula)
        with atomic_write(path) as file:
            safe.to_csv(file, index=False, lineterminator="\n")
    else:
        columns = {str(name): flat[name].to_numpy() for name in flat.columns}
        _write_parquet(path, columns)
    return path


class RestoringForceModel(Protocol):
    """A model of a structure that gives the forces of its sites."""

    laws: Mapping[Ends, Sequence[object]]

    def segments(self, X: Record, **options: object) -> Dataset:
        """The motions of a record."""

    def site_forces(self, data: Dataset) -> list[np.ndarray]:
        """Forces of all sites along each record."""


def write_forces(
    model: RestoringForceModel,
    data: Record,
    path: str | PathLike[str],
    **options: object,
) -> Path:
    """Write the restoring forces that a model reconstructs along a record.

    Parameters
    ----------
    model : NRFRegressor or ChainModel
    data : Record
        One record; its channels are fused into one motion.
    path : path-like
        ``.uff`` or ``.unv`` (UFF 58: node = upper DOF, reference node = lower DOF,
        reaction force, N), ``.parquet`` or ``.csv`` (column ``t`` in s and one for each
        site, N).
    **options
        As for :meth:`ChainModel.predict`.

    Raises
    ------
    FileFormatError
        If the ending of ``path`` is none of these, or there is more than one record.
    MissingExtraError
        Without pyarrow, for Parquet.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf import datasets, io
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = io.write_forces(
    ...         datasets.demo_truth(),
    ...         datasets.load_demo(),
    ...         pathlib.Path(folder, "forces.csv"),
    ...     )
    ...     list(io.read_table(path).variables)
    ['t', 'storey 1', 'storey 2', 'storey 3']
    """
    path = Path(path)
    suffix = _known_suffix(path, UFF.suffixes + PARQUET.suffixes + CSV)
    model = getattr(model, "model_", model)
    segments = model.segments(data, **options)
    if len(segments.segments) != 1:
        raise FileFormatError(
            "Forces are written one record at a time", "Pass one record."
        )

    segment = segments.segments[0]
    dt = segment.dt or 1.0
    forces = segments.scatter(model.site_forces(segments))
    columns = {
        site: forces[:, i] for i, (site, laws) in enumerate(model.laws.items()) if laws
    }
    if suffix in UFF.suffixes:
        data_sets = [
            _history_of_force(site, line, 1.0 / dt, segment.name).encoded()
            for site, line in columns.items()
        ]
        write_data_sets(path, data_sets)
        return path

    named = {str(site): line for site, line in columns.items()}
    table = pd.DataFrame({"t": np.arange(len(forces)) * dt, **named})
    return write_table(table, path)


def _history_of_force(
    site: Ends, line: np.ndarray, fs: float, record: str
) -> TimeHistory:
    """The force of a site, between the nodes of its DOFs."""
    titles = (f"restoring force of {site}, N", record)
    lower = max(site.q, 0)
    return TimeHistory(line, fs, 0.0, titles, REACTION_FORCE, site.p, lower, "N")


def _known_suffix(path: Path, known: tuple[str, ...]) -> str:
    """The suffix of a file to be written, in small letters."""
    suffix = path.suffix.lower()
    if suffix not in known:
        raise FileFormatError(
            f"{path} has the type {suffix or '(none)'}, which is not written here",
            f"Choose one of {', '.join(known)}.",
        )
    return suffix
