"""What a model leaves of the measured forces: one step at a time, and in a free run.

The residual of balance j is the force the model lacks there,

    e_j = F_j - (m_j a_j + sum over sites of incidence * R)

so a law f that is missing at a site with incidence b leaves ``e = b f``: + in the balance of the
upper end, - in that of the lower one. Summed from the top, ``rho_i = sum_{j >= i} e_j`` is the force
missing across the cut below DOF i: of storey i alone on a plain chain, and in general of storey i,
of every link and ground link that crosses the cut, and of the DOF sites above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ..data.record import Record
from ..exceptions import ChannelError, SimulationError
from ..regression.chain_model import ChainModel
from ..regression.errors import free_run_of
from ..regression.segments import Segment, SegmentSet

# Residuals below this share of their reference are rounding.
ROUND_OFF = 1e-9


@dataclass
class Residual:
    """One-step residual of a model, record by record.

    Attributes
    ----------
    model : ChainModel
    data : SegmentSet
    filters : list of FairFilter or None
        One for each record; the residual has passed it.
    balance : list of ndarray of shape (n_valid_samples, n_dof)
        e_j, N; a column of NaN where the force on the DOF is unknown.
    sizes : DataFrame
        Rows ``"dof j"`` and ``"storey i"``; columns ``rms`` (N), ``percent`` (of the reference),
        ``reference`` (rms, N), ``of``: a balance is measured by F, or by m a where no force acts; a
        storey by the force across its cut, ``sum_{j >= i} (F_j - m_j a_j)``.
    scale : ndarray of shape (n_dof,)
        Rms of the model's force in storey j (of the reference of balance j if that is zero), N.
    """

    model: ChainModel
    data: SegmentSet
    filters: list[Any]
    balance: list[np.ndarray]
    sizes: pd.DataFrame
    scale: np.ndarray

    @property
    def n_dof(self) -> int:
        """Number of balances."""
        return self.model.n_dof

    @property
    def storey(self) -> list[np.ndarray]:
        """rho_i of each record, N, shape (n_valid_samples, n_dof); NaN if a balance above is not known."""
        return [from_top(e) for e in self.balance]

    @property
    def known(self) -> np.ndarray:
        """Balances whose force is known, shape (n_records, n_dof)."""
        return np.array([~np.isnan(e[0]) for e in self.balance])

    @property
    def is_round_off(self) -> bool:
        """Whether every balance closes to rounding."""
        size = self.sizes.iloc[: self.n_dof].dropna(subset="rms")
        return bool((size["rms"] <= ROUND_OFF * size["reference"]).all())

    def with_balance(self, balance: Sequence[np.ndarray]) -> Residual:
        """The same with other residuals of the balances, N, and their sizes."""
        left = np.concatenate([rms(balance), rms([from_top(e) for e in balance])])
        reference = self.sizes["reference"].to_numpy()
        percent = 100 * np.divide(left, reference, out=np.full(len(left), np.nan), where=reference > 0)
        sizes = self.sizes.assign(rms=left, percent=percent)
        return Residual(self.model, self.data, self.filters, list(balance), sizes, self.scale)

    def at(self, name: str) -> list[np.ndarray]:
        """Residual of one balance (``"dof 2"``) or storey (``"storey 2"``), one array for each record, N."""
        kind, _, number = name.partition(" ")
        if kind not in ("dof", "storey") or not number.isdigit() or not 1 <= int(number) <= self.n_dof:
            raise ChannelError(f"The residual has no {name!r}", f"Use 'dof 1'.. or 'storey 1'.. up to {self.n_dof}.")
        parts = self.balance if kind == "dof" else self.storey
        return [part[:, int(number) - 1] for part in parts]

    def __str__(self) -> str:
        rows = [f"{name}: {r.rms:.4g} N, {r.percent:.3g} % of {r.of}" for name, r in self.sizes.iterrows()]
        return "\n".join(rows)


def from_top(columns: np.ndarray) -> np.ndarray:
    """Sums over the DOFs from the top down to each, shape kept: column i holds ``sum_{j >= i}``."""
    return np.cumsum(columns[:, ::-1], axis=1)[:, ::-1]


def rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Rms of every column over records that may hold columns of NaN; NaN if unknown in all."""
    squares = sum(np.nansum(p**2, axis=0) for p in parts)
    count = sum(np.isfinite(p).sum(axis=0) for p in parts)
    return np.sqrt(np.divide(squares, count, out=np.full(np.shape(squares), np.nan), where=count > 0))


def filters_of(data: SegmentSet, filters: Any = None, band: Any = None) -> list[Any]:
    """One filter for each record, from what a user gave."""
    if filters is None:
        from ..signals.zero_phase_filter import filters_of

        return filters_of(band, data)
    if band is not None:
        raise ChannelError("Both filters and band were given", "Give one of them.")
    filters = list(filters)
    if len(filters) != len(data.segments):
        raise ChannelError(
            f"{len(filters)} filters for {len(data.segments)} records", "Give one for each record, or a band."
        )
    return filters


def residual_of(model: ChainModel, data: Any, filters: Any = None, *, band: Any = None) -> Residual:
    """One-step residual of a model in a frequency band."""
    data = model.segments(data)
    filters = filters_of(data, filters, band)
    found: tuple[list[np.ndarray], ...] = ([], [], [], [])
    balances, inertias, forces, storeys = found
    own = {site: k for k, site in enumerate(model.laws)}
    pick = [own.get(model.chain.site(j)) for j in range(1, model.n_dof + 1)]
    incidence = model.chain.incidence(model.laws)
    for seg, filter, R in zip(data.segments, filters, model.site_forces(data)):
        inertia, force = seg.a[seg.valid].astype(float) * model.masses, seg.F[seg.valid].astype(float)
        storey = np.column_stack([np.zeros(len(R)) if k is None else R[:, k] for k in pick])
        parts = [force - inertia - R @ incidence.T, inertia, force, storey]
        for out, part in zip(found, parts):
            out.append(part if filter is None else filter.apply(part))
    if not np.isfinite(balances[0][0]).any() and not any(np.isfinite(e[0]).any() for e in balances):
        raise ChannelError(
            "The force is unknown on every DOF, so no balance has a residual",
            "Give F, with zeros on DOFs known to be unforced.",
        )
    sizes = _sizes(balances, inertias, forces)
    scale = rms(storeys)
    reference = sizes["reference"].to_numpy()[: model.n_dof]
    scale = np.where(scale > 0, scale, np.where(reference > 0, reference, 1.0))
    return Residual(model, data, filters, balances, sizes, scale)


def _sizes(balances: list[np.ndarray], inertias: list[np.ndarray], forces: list[np.ndarray]) -> pd.DataFrame:
    n = balances[0].shape[1]
    force = rms(forces)
    inertia = rms([np.where(np.isnan(f), np.nan, i) for i, f in zip(inertias, forces)])
    cut = rms([from_top(f - i) for f, i in zip(forces, inertias)])
    left = np.concatenate([rms(balances), rms([from_top(e) for e in balances])])
    reference = np.concatenate([np.where(force > 0, force, inertia), cut])
    of = np.concatenate([np.where(force > 0, "F", "m a"), np.repeat("storey force", n)])
    percent = 100 * np.divide(left, reference, out=np.full(2 * n, np.nan), where=reference > 0)
    names = [f"{kind} {j}" for kind in ("dof", "storey") for j in range(1, n + 1)]
    return pd.DataFrame({"rms": left, "percent": percent, "reference": reference, "of": of}, index=names)


@dataclass
class FreeRunResidual:
    """Measured minus simulated motion of a free run, record by record.

    Attributes
    ----------
    displacement, acceleration : list of ndarray of shape (n_valid_samples, n_dof)
        Relative to the base (m) and absolute (m/s^2), filtered; NaN where no free run is possible.
    sizes : DataFrame
        Rows ``"dof j"``; percent NRMSE of displacement and acceleration over all records.
    reasons : list of str
        Why a record could not be run; empty text where it could.
    """

    displacement: list[np.ndarray]
    acceleration: list[np.ndarray]
    sizes: pd.DataFrame
    reasons: list[str] = field(default_factory=list)


def free_run_residual(
    model: ChainModel, data: Any, filters: Any = None, *, band: Any = None, **options: Any
) -> FreeRunResidual:
    """Residual of the free run under the measured forces, from the state at the first sample."""
    data = model.segments(data)
    filters = filters_of(data, filters, band)
    left: tuple[list, list] = ([], [])
    measured: tuple[list, list] = ([], [])
    reasons = []
    for seg, filter in zip(data.segments, filters):
        rows = seg.valid
        pair = [np.cumsum(seg.s[rows].astype(float), axis=1), seg.a[rows].astype(float)]
        run, why = free_run(model, seg, options)
        reasons.append(why)
        for k, y in enumerate(pair):
            if run is None:
                left[k].append(np.full(y.shape, np.nan))
                measured[k].append(left[k][-1])
                continue
            parts = [y - (run.acceleration if k else run.displacement), y]
            parts = parts if filter is None else [filter.apply(p) for p in parts]
            left[k].append(parts[0])
            measured[k].append(parts[1])
    percent = [100 * rms(e) / rms(y) for e, y in zip(left, measured)]
    names = [f"dof {j}" for j in range(1, model.n_dof + 1)]
    sizes = pd.DataFrame(dict(zip(("displacement", "acceleration"), percent)), index=names)
    return FreeRunResidual(left[0], left[1], sizes, reasons)


def free_run(model: ChainModel, seg: Segment, options: dict[str, Any]) -> tuple[Record | None, str]:
    """Free run of one contiguous record from its first state, or the reason why there is none."""
    rows = seg.valid
    name = f"record {seg.name!r}"
    if seg.dt is None:
        return None, f"{name}: the sampling step is not known"
    if rows.stop - rows.start < 2:
        return None, f"{name} has a single sample"
    if np.isnan(seg.F[rows]).any():
        return None, f"{name}: the force on DOF {int(np.flatnonzero(np.isnan(seg.F[rows.start]))[0]) + 1} is unknown"
    if (model.masses <= 0).any():
        return None, f"{name}: m{int(np.argmin(model.masses)) + 1} is not positive"
    try:
        run = free_run_of(model, seg, name=seg.name, **options)
    except SimulationError as error:
        return None, f"{name}: {error.what}"
    return run, ""
