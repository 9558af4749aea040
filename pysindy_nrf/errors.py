"""One ruler for errors: percent NRMSE, per balance and pooled.

``100 rms(e) / rms(reference)``; the reference is the force F_j on a forced DOF and the inertia
``m_j a_j`` elsewhere. Pooled: root of the summed squares over the summed squares, each balance
first divided by the rms of its storey force.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from .layout import Layout
from .model import ChainModel
from .moments import Block, Moments, accumulate

COLUMNS = ["error", "residual", "reference", "of"]


def balance_errors(model: ChainModel, moments: Moments) -> pd.DataFrame:
    """Balance errors (one step, not free run) of a model from moments.

    Parameters
    ----------
    model : ChainModel
    moments : Moments
        Of the data to judge, with the model's own laws as columns.

    Returns
    -------
    DataFrame
        One row ``"dof j"`` for each balance whose force is known, and ``"pooled"``; columns
        ``error`` (percent), ``residual`` and ``reference`` (rms, N), ``of`` (``"F"`` or ``"m a"``).
    """
    coefficients = {
        site: np.concatenate([law.coefficients for law in held if law.coefficients is not None] or [np.zeros(0)])
        for site, held in model.laws.items()
    }
    rows, top, bottom = {}, 0.0, 0.0
    for j in range(1, model.n_dof + 1):
        part = moments.parts[(j,)]
        if not part.n_samples:
            continue
        where, mass_at, target_at = moments.positions((j,))
        group = moments.groups[(j,)]
        size = part.n_samples**0.5
        left = np.zeros(part.matrix.shape[0])
        for site, sign in zip(group.sites, group.signs):
            left[where[site]] = sign * coefficients[site]
        left[mass_at] = model.masses[j - 1]
        only_mass, only_force = np.zeros_like(left), np.zeros_like(left)
        only_mass[mass_at], only_force[target_at] = model.masses[j - 1], 1.0
        residual = part.norm(left - only_force) / size
        force = part.norm(only_force) / size
        reference = force or part.norm(only_mass) / size
        rows[f"dof {j}"] = [_percent(residual, reference), residual, reference, "F" if force else "m a"]
        scale = 0.0
        for site in group.sites:
            if not scale and site.p == j:
                alone = np.zeros_like(left)
                alone[where[site]] = coefficients[site]
                scale = part.norm(alone) / size
        scale = scale or reference or 1.0
        top += part.n_samples * (residual / scale) ** 2
        bottom += part.n_samples * (reference / scale) ** 2
    rows["pooled"] = [_percent(top**0.5, bottom**0.5), np.nan, np.nan, ""]
    return pd.DataFrame.from_dict(rows, orient="index", columns=COLUMNS)


def _percent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole else (0.0 if part == 0 else np.inf)


def judge(model: ChainModel, layout: Layout, blocks: Iterable[Block]) -> pd.DataFrame:
    """Balance errors of a model on blocks of samples.

    Parameters
    ----------
    model : ChainModel
    layout : Layout
        Of the model's laws.
    blocks : iterable of Block

    Returns
    -------
    DataFrame
        See :func:`balance_errors`.
    """
    groups = [layout.group((j,)) for j in range(1, model.n_dof + 1)]
    return balance_errors(model, accumulate(Moments(layout, groups), blocks))


def nrmse(measured: Any, found: Any) -> float:
    """Percent NRMSE of one signal, ``100 rms(found - measured) / rms(measured)``.

    Parameters
    ----------
    measured, found : array-like of the same shape

    Returns
    -------
    float
        Rows with NaN in either are left out.
    """
    a, b = np.asarray(measured, dtype=float), np.asarray(found, dtype=float)
    good = np.isfinite(a) & np.isfinite(b)
    return _percent(float(np.sqrt(np.mean((b[good] - a[good]) ** 2))), float(np.sqrt(np.mean(a[good] ** 2))))
