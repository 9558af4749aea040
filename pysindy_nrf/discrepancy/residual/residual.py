"""What a model leaves of the measured forces.

The residual of balance j is the force the model lacks there,

    e_j = F_j - (m_j a_j + sum over sites of incidence * R)

so a law f that is missing at a site with incidence b leaves ``e = b f``: + in the
balance of the upper end, - in that of the lower one. Summed from the top, ``rho_i =
sum_{j >= i} e_j`` is the force missing across the cut below DOF i: of storey i alone on
a plain chain, and in general of storey i, of every link and ground link that crosses
the cut, and of the DOF sites above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from ...chain.model import ChainModel
from ...exceptions import ChannelError
from ...records.dataset import Dataset, Segment
from .diagnosed_data import DiagnosedData


@dataclass(frozen=True, eq=False)
class Residual:
    """One-step residual of a model, record by record.

    Attributes
    ----------
    model : ChainModel
    data : Dataset
    filters : list
        One for each record; the residual has passed it.
    balance : list of ndarray of shape (n_valid_samples, n_dof)
        e_j, N; a column of NaN where the force is unknown.
    reference : DataFrame
        Rows "dof j" and "storey i"; columns "reference" (rms, N) and "of". A balance is
        measured by F, or by m a where no force acts; a storey by the force across its
        cut, ``sum_{j >= i} (F_j - m_j a_j)``.
    scale : ndarray of shape (n_dof,)
        Rms of the model's force in storey j, N; of the reference of balance j if that
        is zero.
    columns : dict
        Of the motion, for every model.
    """

    model: ChainModel
    data: Dataset
    filters: list[Any]
    balance: list[np.ndarray]
    reference: pd.DataFrame
    scale: np.ndarray
    columns: dict[Any, Any] = field(default_factory=dict)

    @property
    def n_dof(self) -> int:
        """Number of balances."""
        return self.model.n_dof

    @cached_property
    def storey(self) -> list[np.ndarray]:
        """rho_i of each record, N, shape (n_valid_samples, n_dof).

        NaN if a balance above is not known.
        """
        return [from_top(e) for e in self.balance]

    @property
    def known(self) -> np.ndarray:
        """Balances whose force is known, shape (n_records, n_dof)."""
        return np.array([~np.isnan(e[0]) for e in self.balance])

    @cached_property
    def sizes(self) -> pd.DataFrame:
        """References with ``rms`` (N) and ``percent`` of every balance and storey."""
        left = np.concatenate([rms(self.balance), rms(self.storey)])
        size = self.reference["reference"].to_numpy()
        unknown = np.full(len(left), np.nan)
        percent = 100 * np.divide(left, size, out=unknown, where=size > 0)
        table = self.reference.assign(rms=left, percent=percent)
        return table[["rms", "percent", "reference", "of"]]

    def at(self, name: str) -> list[np.ndarray]:
        """Residual of one balance (``"dof 2"``) or storey (``"storey 2"``), N.

        One array for each record.
        """
        kind, _, number = name.partition(" ")
        parts = self.balance if kind == "dof" else self.storey
        return [part[:, int(number) - 1] for part in parts]


def from_top(columns: np.ndarray) -> np.ndarray:
    """Sums over the DOFs from the top down to each: column i holds ``sum_{j >= i}``."""
    return np.cumsum(columns[:, ::-1], axis=1)[:, ::-1]


def rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Rms of every column over records, NaN passed over; NaN if unknown in all."""
    squares, count = 0.0, 0
    for part in parts:
        squares = squares + np.nansum(part**2, axis=0)
        count = count + np.isfinite(part).sum(axis=0)
    unknown = np.full(np.shape(squares), np.nan)
    return np.sqrt(np.divide(squares, count, out=unknown, where=np.greater(count, 0)))


def residual_of(
    model: ChainModel,
    data: Any,
    filters: Sequence[Any] | None = None,
    forces: Sequence[np.ndarray] | None = None,
) -> Residual:
    """One-step residual of a model through filters.

    Parameters
    ----------
    model : ChainModel
    data : Dataset, or data as for :meth:`ChainModel.predict`
    filters : sequence, optional
        One for each record.
    forces : sequence of ndarray of shape (n_valid_samples, n_sites), optional
        Of the sites of the model, N; its own if None.

    Raises
    ------
    ChannelError
        If the force is unknown on every DOF.
    """
    data = model.segments(data)
    if filters is None:
        filters = [None] * len(data.segments)
    if forces is None:
        forces = model.site_forces(data)

    parts = []
    for seg, filter_, site_forces in zip(data.segments, filters, forces, strict=True):
        parts.append(_parts_of(model, seg, filter_, site_forces))
    balance = [part.balance for part in parts]
    if not any(np.isfinite(e[0]).any() for e in balance):
        raise ChannelError(
            "The force is unknown on every DOF, so no balance has a residual",
            "Give F, with zeros on DOFs known to be unforced.",
        )

    reference = _references(parts)
    scale = rms([part.storeys for part in parts])
    other = reference["reference"].to_numpy()[: model.n_dof]
    other = np.where(other > 0, other, 1.0)
    scale = np.where(scale > 0, scale, other)
    return Residual(model, data, list(filters), balance, reference, scale)


def residual_in(data: DiagnosedData, model: ChainModel) -> Residual:
    """Residual of a model on diagnosed data.

    Laws that remember the path follow it from the start of the record.
    """
    pieces, filters, numbers = data.cut()
    if not model.has_memory:
        return replace(residual_of(model, pieces, filters), columns=data.made)

    whole = model.site_forces(data.records)
    forces = []
    for number, piece in zip(numbers, pieces.segments):
        start = piece.valid.start - data.records.segments[number].valid.start
        forces.append(whole[number][start : start + piece.n_valid])
    residual = residual_of(model, pieces, filters, forces)
    return replace(residual, columns=data.made)


@dataclass(frozen=True, eq=False)
class _Parts:
    """Forces in the balances of one record, filtered, (n_valid_samples, n_dof)."""

    balance: np.ndarray
    inertia: np.ndarray
    applied: np.ndarray
    # of the model in each storey
    storeys: np.ndarray


def _parts_of(
    model: ChainModel, segment: Segment, filter_: Any, site_forces: np.ndarray
) -> _Parts:
    """Forces in the balances of one record."""
    incidence = model.chain.incidence(model.laws)
    inertia = segment.a[segment.valid].astype(float) * model.masses
    applied = segment.F[segment.valid].astype(float)
    balance = applied - inertia - site_forces @ incidence.T

    storeys = np.zeros_like(inertia)
    sites = list(model.laws)
    for j in range(model.n_dof):
        site = model.chain.site(j + 1)
        if site in sites:
            storeys[:, j] = site_forces[:, sites.index(site)]

    parts = (balance, inertia, applied, storeys)
    return _Parts(*(filtered(part, filter_) for part in parts))


def filtered(columns: np.ndarray, filter_: Any) -> np.ndarray:
    """Columns through the filter of their record."""
    return columns if filter_ is None else filter_.apply(columns)


def _references(parts: Sequence[_Parts]) -> pd.DataFrame:
    """By what balances and storeys are measured, rms, N."""
    known_inertia, across_cut = [], []
    for part in parts:
        unknown = np.isnan(part.applied)
        known_inertia.append(np.where(unknown, np.nan, part.inertia))
        across_cut.append(from_top(part.applied - part.inertia))

    force = rms([part.applied for part in parts])
    inertia, cut = rms(known_inertia), rms(across_cut)
    n_dof = len(force)
    of_balances = np.where(force > 0, "F", "m a")
    names = [f"dof {j}" for j in range(1, n_dof + 1)]
    names += [f"storey {j}" for j in range(1, n_dof + 1)]
    sizes = np.concatenate([np.where(force > 0, force, inertia), cut])
    kinds = np.concatenate([of_balances, np.repeat("storey force", n_dof)])
    return pd.DataFrame({"reference": sizes, "of": kinds}, index=names)
