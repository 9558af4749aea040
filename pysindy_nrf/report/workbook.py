"""An Excel workbook of an identification: masses, coefficients, forces, quality."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..common.files import atomic_write
from ..common.lazy import require
from ..diagnosis.site_loops import SiteLoop
from ..exceptions import NRFError
from ..records.quality import QualityNote
from .summary import Summary

# Characters of the widest column.
WIDEST = 80
# Characters by which a spreadsheet takes a text for a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def write_workbook(
    path: str | PathLike[str],
    summary: Summary,
    model: ChainModel,
    loops: Sequence[SiteLoop] = (),
    notes: Sequence[QualityNote] = (),
) -> Path:
    """Write a workbook with one sheet a table.

    Parameters
    ----------
    path : path-like
        ``.xlsx``; an older file is replaced completely.
    summary : Summary
    model : ChainModel
    loops : sequence of SiteLoop
        Forces along the data.
    notes : sequence of QualityNote
        What is known of the channels.

    Returns
    -------
    Path

    Raises
    ------
    MissingExtraError
        Without openpyxl, which the extra ``files`` brings.
    """
    openpyxl = require("openpyxl", "files", "An Excel workbook")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, table in _sheets(summary, model, loops, notes).items():
        sheet = book.create_sheet(name)
        sheet.append(list(table.columns))
        for row in table.itertuples(index=False, name=None):
            sheet.append([_as_cell(value) for value in row])
        _lay_out(sheet)
    target = Path(path)
    with atomic_write(target, "wb") as file:
        book.save(file)
    return target


def _sheets(
    summary: Summary,
    model: ChainModel,
    loops: Sequence[SiteLoop],
    notes: Sequence[QualityNote],
) -> dict[str, pd.DataFrame]:
    """Tables by the names of their sheets."""
    table = summary.to_frame().reset_index(names="parameter")
    is_mass = table["site"] == ""
    intervals = ["parameter", "estimate", "std_error", "lower", "upper", "unit"]
    sheets = {
        "Summary": _first_sheet(summary),
        "Masses": table.loc[is_mass, intervals],
        "Coefficients": table[~is_mass].drop(columns="parameter"),
    }
    if loops:
        sheets["Forces"] = pd.concat([_forces(loop) for loop in loops])
    # a model without masses or springs has none
    with suppress(NRFError, np.linalg.LinAlgError):
        sheets["Modes"] = model.modes().reset_index(names="mode")
    rows = []
    for note in notes:
        rows.append([note.record, note.channel, note.kind, note.size, note.message])
    head = ["record", "channel", "what", "size", "in words"]
    sheets["Quality"] = pd.DataFrame(rows, columns=head)
    return sheets


def _first_sheet(summary: Summary) -> pd.DataFrame:
    """Verdict, reasons, method and errors."""
    rows: list[tuple[str, str]] = []
    if summary.verdict is not None:
        rows.append(("verdict", summary.verdict.state))
        rows.append(("", summary.verdict.sentence))
        rows += [("reason", reason) for reason in summary.verdict.reasons]
    rows += [*summary.head, *(("note", note) for note in summary.notes)]
    return pd.DataFrame(rows, columns=["what", "value"])


def _forces(loop: SiteLoop) -> pd.DataFrame:
    """Force of one site in the stretch of its largest motion."""
    units = loop.units
    measured = float("nan") if loop.measured is None else loop.measured
    lines: Mapping[str, object] = {
        "site": loop.site,
        "record": loop.record,
        "t (s)": loop.t,
        f"drift ({units.length})": loop.s,
        f"rate ({units.of('m/s')})": loop.v,
        f"identified ({units.force})": loop.identified,
        f"measured ({units.force})": measured,
    }
    return pd.DataFrame(lines)


def _as_cell(value: object) -> object:
    """A value of a cell: no text is taken for a formula, no NaN for a number."""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(_FORMULA) else value
    return None if pd.isna(value) else value


def _lay_out(sheet: Any) -> None:
    """A head that stays in sight, and columns as wide as their texts."""
    sheet.freeze_panes = "A2"
    for column in sheet.columns:
        longest = max(len(str(cell.value or "")) for cell in column)
        letter = column[0].column_letter
        sheet.column_dimensions[letter].width = min(WIDEST, longest + 2)
