"""Information criteria from the moments of all data."""

from __future__ import annotations

import numpy as np

from ..regression.chain_solve import StepFit
from ..regression.moments import Moments
from .fold_moments import FoldMoments, Order
from .fold_scores import residual_weights
from .one_se_rule import FLOOR


def information(fits: list[StepFit], moments: Moments, shares: dict[tuple[int, ...], float]) -> tuple[float, float]:
    r"""Akaike's and Schwarz's criterion of a chain, summed over the steps of its solve."""
    aic = bic = 0.0
    for fit in fits:
        dofs = fit.step.dofs
        seen = moments.parts[dofs].n_samples if dofs in moments.parts else moments.n_samples
        size = max(seen * shares.get(dofs, 1.0), 2.0)
        level = 2.0 * size * np.log(max(fit.share, FLOOR) * fit.residual / fit.share if fit.share else FLOOR)
        aic += level + 2.0 * fit.n_columns
        bic += level + np.log(size) * fit.n_columns
    return float(aic), float(bic)


def independent_shares(fold_moments: FoldMoments, order: Order) -> dict[tuple[int, ...], float]:
    r"""Independent samples in the residual of each balance, as a share of its samples."""
    solution, walk, moments = fold_moments.fit(order, None)
    shares = {}
    for dofs in moments.parts:
        square, size = fold_moments.piece_norms(order, dofs, residual_weights(moments, solution, dofs))
        held = size > 0
        if held.sum() < 4:
            continue
        square = square[held]
        size, whole = size[held], square.sum() / size[held].sum()
        spread = np.average((square / size / whole - 1.0) ** 2, weights=size) if whole > 0 else 0.0
        shares[dofs] = float(np.clip(2.0 / (spread * size.mean()), 0.0, 1.0)) if spread > 0 else 1.0
    return shares

