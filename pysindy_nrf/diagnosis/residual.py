"""What a model leaves of the measured forces.

The residual of balance j is the force that the model lacks there,

    e_j = F_j - (m_j a_j + sum over sites of incidence * R)

so a law f that is missing at a site with incidence b leaves ``e = b f``: + in the
balance of the upper end, - in that of the lower one. Summed from the top, ``rho_i =
sum_{j >= i} e_j`` is the force missing across the cut below DOF i. On a plain chain it
is that of storey i. In general it is that of storey i, of every link and ground link
that crosses the cut, and of the DOF sites above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..exceptions import ChannelError
from ..records.dataset import Dataset
from ..records.record import Record
from ..records.zero_phase_filter import ZeroPhaseFilter

Filters = Sequence[ZeroPhaseFilter | None]


@dataclass
class Residual:
    """One-step residual of a model, record by record.

    Parameters
    ----------
    model : ChainModel
    data : Dataset
    filters : list of ZeroPhaseFilter or None
        One for each record; the residual has passed it.
    balance : list of ndarray of shape (n_valid_samples, n_dof)
        Residual e_j of each record, N; a column of NaN where the force is unknown.
    reference : DataFrame
        Rows ``"dof j"`` and ``"storey i"``; columns ``reference`` (rms, N) and ``of``.
        A balance is measured by F, or by m a where no force acts; a storey by the force
        across its cut, sum_{j >= i} (F_j - m_j a_j).
    scale : ndarray of shape (n_dof,)
        Rms of the model's force in storey j, N; of the reference of balance j if that
        is zero.
    columns : dict
        Columns of the motion, which do not depend on the model.
    """

    model: ChainModel
    data: Dataset
    filters: list[ZeroPhaseFilter | None]
    balance: list[np.ndarray]
    reference: pd.DataFrame
    scale: np.ndarray
    columns: dict[Any, dict[Any, Any]] = field(default_factory=dict)

    @property
    def n_dof(self) -> int:
        """Number of balances."""
        return self.model.n_dof

    @cached_property
    def storey(self) -> list[np.ndarray]:
        """rho_i of each record, N, shape (n_valid_samples, n_dof).

        NaN if a balance above is not known.
        """
        return [from_top(residual) for residual in self.balance]

    @property
    def known(self) -> np.ndarray:
        """Balances whose force is known, shape (n_records, n_dof)."""
        return np.array([~np.isnan(residual[0]) for residual in self.balance])

    @cached_property
    def sizes(self) -> pd.DataFrame:
        """The references with ``rms`` (N) and ``percent`` of balances and storeys."""
        size = np.concatenate([rms(self.balance), rms(self.storey)])
        reference = self.reference["reference"].to_numpy()
        percent = np.full(len(size), np.nan)
        np.divide(100 * size, reference, out=percent, where=reference > 0)
        table = self.reference.assign(rms=size, percent=percent)
        return table[["rms", "percent", "reference", "of"]]

    def at_place(self, name: str) -> list[np.ndarray]:
        """Residual of one balance (``"dof 2"``) or storey (``"storey 2"``), N.

        One array for each record.
        """
        kind, _, number = name.partition(" ")
        residuals = self.balance if kind == "dof" else self.storey
        return [residual[:, int(number) - 1] for residual in residuals]


def from_top(columns: np.ndarray) -> np.ndarray:
    """Sums over the DOFs from the top down to each: column i is ``sum_{j >= i}``."""
    return np.cumsum(columns[:, ::-1], axis=1)[:, ::-1]


def rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Rms of every column over records; NaN if it is unknown in all of them."""
    squares = np.sum([np.nansum(lines**2, axis=0) for lines in parts], axis=0)
    count = np.sum([np.isfinite(lines).sum(axis=0) for lines in parts], axis=0)
    mean = np.full(np.shape(squares), np.nan)
    np.divide(squares, count, out=mean, where=count > 0)
    return np.sqrt(mean)


def residual_of(
    model: ChainModel,
    data: Dataset | Record | Sequence[Record],
    filters: Filters | None = None,
    forces: Sequence[np.ndarray] | None = None,
) -> Residual:
    """One-step residual of a model.

    Parameters
    ----------
    model : ChainModel
    data : Dataset, or what :meth:`ChainModel.segments` makes one of
    filters : sequence of ZeroPhaseFilter or None, optional
        One for each record.
    forces : sequence of ndarray, optional
        Forces of the model's sites along each record, N; its own if None.

    Raises
    ------
    ChannelError
        If the force is unknown on every DOF.
    """
    data = model.segments(data)
    filters = [None] * len(data.segments) if filters is None else list(filters)
    forces = model.site_forces(data) if forces is None else forces
    incidence = model.chain.incidence(model.laws)

    residuals, storeys = [], []
    applied, inertias = [], []
    for segment, band, site_forces in zip(data.segments, filters, forces, strict=True):
        inertia = segment.a[segment.valid].astype(float) * model.masses
        force = segment.F[segment.valid].astype(float)
        driving = segment.driving_force[segment.valid].astype(float)
        residual = driving - inertia - site_forces @ incidence.T
        residuals.append(filtered(residual, band))
        inertias.append(filtered(inertia, band))
        applied.append(filtered(force, band))
        storeys.append(filtered(_storey_forces(model, site_forces), band))

    if not any(np.isfinite(residual[0]).any() for residual in residuals):
        raise ChannelError(
            "The force is unknown on every DOF, so no balance has a residual",
            "Give F, with zeros on DOFs known to be unforced.",
        )
    reference = _reference(model.n_dof, applied, inertias)
    of_balance = reference["reference"].to_numpy()[: model.n_dof]
    scale = rms(storeys)
    scale = np.where(scale > 0, scale, np.where(of_balance > 0, of_balance, 1.0))
    return Residual(model, data, filters, residuals, reference, scale)


def filtered(lines: np.ndarray, band: ZeroPhaseFilter | None) -> np.ndarray:
    """Lines through the filter of their record, if it has one."""
    return lines if band is None else band.apply(lines)


def _storey_forces(model: ChainModel, site_forces: np.ndarray) -> np.ndarray:
    """Forces of storeys 1 to n, of all sites; zero where a chain has no storey."""
    columns = {site: k for k, site in enumerate(model.laws)}
    forces = np.zeros((len(site_forces), model.n_dof))
    for j in range(1, model.n_dof + 1):
        column = columns.get(model.chain.site(j))
        if column is not None:
            forces[:, j - 1] = site_forces[:, column]
    return forces


def _reference(
    n_dof: int, applied: Sequence[np.ndarray], inertias: Sequence[np.ndarray]
) -> pd.DataFrame:
    """What the residuals of balances and storeys are measured by."""
    known_inertias, cuts = [], []
    for force, inertia in zip(applied, inertias):
        known_inertias.append(np.where(np.isnan(force), np.nan, inertia))
        cuts.append(from_top(force - inertia))
    size = rms(applied)
    of_balance = np.where(size > 0, size, rms(known_inertias))
    names = [f"dof {j}" for j in range(1, n_dof + 1)]
    names += [f"storey {i}" for i in range(1, n_dof + 1)]
    of = np.where(size > 0, "F", "m a").tolist() + ["storey force"] * n_dof
    reference = np.concatenate([of_balance, rms(cuts)])
    return pd.DataFrame({"reference": reference, "of": of}, index=names)
