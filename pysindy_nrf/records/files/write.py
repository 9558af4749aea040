"""Writing of records, tables of results and reconstructed forces. A file is written
completely or not at all.
"""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...common.files import atomic_write
from ...common.lazy import require
from ...exceptions import ChannelError, FileFormatError
from ..record import Record
from .arrays import ATTRIBUTES_KEY
from .table import Attributes, columns_of
from .uff import history, write_sets, write_uff

_REACTION = 9  # UFF's specific data type


def write_record(record: Record, path: Any) -> Path:
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
    suffix = _suffix(path, (".parquet", ".pq", ".uff", ".unv", ".csv"))
    attributes, columns = Attributes.of(record), columns_of(record)
    if suffix in (".uff", ".unv"):
        write_uff(path, columns, attributes)
    elif suffix == ".csv":
        _write_csv(path, {"t": record.time, **columns}, attributes)
    else:
        _write_parquet(path, {"t": record.time, **columns}, attributes)
    return path


def _write_csv(
    path: Path, columns: dict[str, np.ndarray], attributes: Attributes
) -> None:
    with atomic_write(path) as file:
        file.write(f"# {attributes.to_json()}\n")
        # the second line is for human readers; names are read from the first
        csv.writer(file, lineterminator="\n").writerow(map(_no_formula, columns))
        frame = pd.DataFrame({i: line for i, line in enumerate(columns.values())})
        frame.to_csv(file, index=False, header=False, na_rep="nan", lineterminator="\n")


def _write_parquet(
    path: Path, columns: dict[str, np.ndarray], attributes: Attributes | None = None
) -> None:
    pyarrow: Any = require("pyarrow", "files", "Writing Parquet files")
    parquet: Any = require("pyarrow.parquet", "files", "Writing Parquet files")
    try:
        # from_pandas=False: NaN is kept and not turned into a missing value
        table = pyarrow.table(
            {
                name: pyarrow.array(line, from_pandas=False)
                for name, line in columns.items()
            }
        )
    except (pyarrow.ArrowException, UnicodeError) as error:
        raise ChannelError(
            f"{path}: a column cannot be written: {error}", "Rename it."
        ) from error
    if attributes is not None:
        table = table.replace_schema_metadata(
            {ATTRIBUTES_KEY: attributes.to_json().encode()}
        )
    with atomic_write(path, "wb") as file:
        parquet.write_table(table, file)


def _no_formula(cell: Any) -> Any:
    """A text on one line, quoted if spreadsheets would run it as a formula."""
    text = " ".join(cell.split()) if isinstance(cell, str) else ""
    return f"'{text}" if text[:1] in tuple("=+-@") else text or cell


def write_table(table: pd.DataFrame, path: Any) -> Path:
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
    suffix = _suffix(path, (".csv", ".parquet", ".pq"))
    flat = table.reset_index() if table.index.name else table
    if suffix == ".csv":
        with atomic_write(path) as file:
            flat.map(_no_formula).rename(columns=_no_formula).to_csv(
                file, index=False, lineterminator="\n"
            )
    else:
        _write_parquet(
            path, {str(name): flat[name].to_numpy() for name in flat.columns}
        )
    return path


def write_forces(model: Any, data: Any, path: Any, **options: Any) -> Path:
    """Write the restoring forces that a model reconstructs along a record, one column
    for each site.

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
    suffix = _suffix(path, (".uff", ".unv", ".parquet", ".pq", ".csv"))
    model = getattr(model, "model_", model)
    segments = model.segments(data, **options)
    if len(segments.segments) != 1:
        raise FileFormatError(
            "Forces are written one record at a time", "Pass one record."
        )
    segment = segments.segments[0]
    dt = segment.dt or 1.0
    sites = {site: i for i, (site, laws) in enumerate(model.laws.items()) if laws}
    forces = segments.scatter(model.site_forces(segments))[:, list(sites.values())]
    if suffix in (".uff", ".unv"):
        sets = []
        for line, site in zip(forces.T, sites):
            texts = [f"restoring force of {site}, N", segment.name]
            sets.append(
                history(
                    line, 1.0 / dt, 0.0, texts, _REACTION, site.p, max(site.q, 0), "N"
                )
            )
        write_sets(path, sets)
        return path
    columns = {
        "t": np.arange(len(forces)) * dt,
        **{str(s): line for s, line in zip(sites, forces.T)},
    }
    return write_table(pd.DataFrame(columns), path)


def _suffix(path: Path, known: tuple[str, ...]) -> str:
    suffix = path.suffix.lower()
    if suffix not in known:
        raise FileFormatError(
            f"{path} has the type {suffix or '(none)'}, which is not written here",
            f"Choose one of {', '.join(known)}.",
        )
    return suffix
