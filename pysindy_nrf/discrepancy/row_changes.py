"""What a changed force, or motion of one DOF, changes in the rows of a model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..chain.sites import Site
from ..laws.base import ForceLaw
from .fitted_model import FittedModel
from .search_data import SearchData


@dataclass(frozen=True, eq=False)
class RowChange:
    """What an error of one unit changes in one row of the spectra."""

    change: np.ndarray
    row: int
    error: int


@dataclass(frozen=True)
class TouchedRows:
    """Rows that read a channel of a DOF: its force or acceleration, or those of a law.

    The law and its site are None for the force or the acceleration.
    """

    dof: int
    is_force: bool
    site: Site | None = None
    law: ForceLaw | None = None

    @property
    def width(self) -> int:
        """Number of rows."""
        return 1 if self.law is None else len(self.law.terms())

    def made(self, data: SearchData, records: tuple[int, ...]) -> np.ndarray:
        """The rows along some records, (width, n_samples)."""
        if self.law is not None and self.site is not None:
            return data.columns(self.site, [self.law], records)
        below = data.n_dof if self.is_force else 0
        return data.fixed(records)[below + self.dof - 1][None]


def touched_rows(
    model: FittedModel, dof: int, is_force: bool
) -> Iterator[tuple[TouchedRows, int]]:
    """Rows of a model that read a force, or the motion of a DOF.

    With the number of the first row of each.
    """
    below = model.spectra.data.n_dof if is_force else 0
    yield TouchedRows(dof, is_force), model.first_fixed + below + dof - 1
    if is_force:
        return
    for site in model.layout.sites:
        if not site.incidence(dof):
            continue
        row = model.layout.slices[site].start
        for law in model.laws.get(site, ()):
            yield TouchedRows(dof, is_force, site, law), row
            row += len(law.terms())


def changes_of_rows(
    model: FittedModel, moved: SearchData, touched: Iterable[tuple[TouchedRows, int]]
) -> dict[TouchedRows, np.ndarray]:
    """Changes of the spectra of some rows where the records are moved.

    Parameters
    ----------
    model : FittedModel
    moved : SearchData
        The records of the model, changed.
    touched : iterable of (TouchedRows, int)
        With the number of the first row of each in the model.

    Returns
    -------
    dict of TouchedRows to ndarray of shape (width, n_columns)
    """
    touched = list(touched)

    def rows_along(records: tuple[int, ...]) -> np.ndarray:
        return np.vstack([rows.made(moved, records) for rows, _ in touched])

    after = model.spectra.windows.spectra(rows_along)
    changes, position = {}, 0
    for rows, first in touched:
        new = after[position : position + rows.width]
        before = model.spectra_of_rows[first : first + rows.width]
        changes[rows] = new - before
        position += rows.width
    return changes
