"""Second step of the fusion: the degrees of freedom of one structure move together.

What one floor does says much about its neighbours, frequency by frequency. The spectra of the
fused motions, less the noise that is left in them, give the best linear prediction of every
motion from the past of all (a vector autoregression, Yule-Walker equations). It enters the least
squares as a prior: where a motion stands clear of its noise nothing changes, where it does not
the estimate becomes its expectation given all channels. Regressors that are such expectations do
not bias a linear regression (Berkson), as noisy ones do.

No model of the structure is assumed, and no periodicity: the prediction starts with the record.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solveh_banded

from .spline_fusion import DEGREE, BasisLadder, FusedMotion, weights_of

GROUP = 6  # neighbouring degrees of freedom treated together
MEMORY = 80  # past values in one prediction: 20 steps of 4 degrees of freedom, say
NEGLIGIBLE = 1e-4  # share of a motion below which its noise is left alone


def fuse_jointly(
    views: list[list[np.ndarray | None]], single: list[FusedMotion], ladder: BasisLadder
) -> list[FusedMotion]:
    """Improve motions that were fused one by one."""
    able = [j for j, m in enumerate(single) if not m.clean and m.high_pass == 0.0 and np.ptp(m.motion[0]) > 0]
    out = list(single)
    if not able:
        return out
    for group in np.array_split(able, -(-len(able) // GROUP)):
        spacing = min(single[j].spacing for j in group)
        basis = ladder[max(spacing, 1.5) if ladder.n > 64 else 1.0]
        order = min(20, MEMORY // len(group), basis.size // (16 * len(group)))
        if order < 2:
            continue
        motions = _group([views[j] for j in group], [single[j] for j in group], basis, order)
        if motions is None:
            continue
        for j, motion in zip(group, motions):
            out[j] = FusedMotion(motion, single[j].noise, basis.h, 0.0)
    return out


def _group(views: Any, single: Any, basis: Any, order: int) -> list[np.ndarray] | None:
    n, size = len(views), basis.size
    weights = [weights_of(m.noise, 0.0) for m in single]
    rest = np.array([m.motion[0].mean() for m in single])  # the prior is about the motion around it
    rhs, c = np.empty((size, n)), np.empty((size, n))
    for j in range(n):
        centred = [views[j][0] - rest[j], *views[j][1:]]
        rhs[:, j] = sum(w * basis.project(o, y) for o, (w, y) in enumerate(zip(weights[j], centred)) if y is not None)
        c[:, j] = basis.solve(weights[j] / weights[j].max(), rhs[:, j] / weights[j].max())
    scale = c.std(axis=0)
    prediction = _prediction(c / scale, np.array(weights) * scale[:, None] ** 2, basis, order)
    if prediction is None:
        return None
    width = max(order * n + n - 1, (DEGREE + 1) * n)
    band = np.zeros((width + 1, size, n))
    for j in range(n):
        own = basis.normal_matrix(weights[j]) * scale[j] ** 2
        for k in range(DEGREE + 2):
            band[width - k * n, :, j] += own[DEGREE + 1 - k]
    # normal matrix of the prediction errors  sum_i G_i c(k - i),  k = order .. size - 1
    for lag in range(order + 1):
        for i in range(order + 1 - lag):
            block = prediction[i + lag].T @ prediction[i]
            for row in range(n):
                for column in range(n):
                    if (off := lag * n + column - row) >= 0:
                        band[width - off, order - i : size - i, column] += block[row, column]
    solution = solveh_banded(
        band.reshape(width + 1, size * n), (rhs * scale).ravel(), overwrite_ab=True, check_finite=False
    )
    c = solution.reshape(size, n) * scale + rest
    return [np.stack([basis.evaluate(o, c[:, j]) for o in range(3)]) for j in range(n)]


def _prediction(c: np.ndarray, weights: np.ndarray, basis: Any, order: int) -> np.ndarray | None:
    """Whitened one-step prediction errors as filters G_0 .. G_order, (order + 1, n, n)."""
    from scipy.signal import csd

    n = c.shape[1]
    length = min(512, max(32, len(c) // max(8, 2 * n)), len(c))
    f, spectra = csd(c.T[:, None], c.T[None], nperseg=length, detrend="constant")
    spectra = np.moveaxis(spectra, -1, 0) / 2  # one-sided to two-sided
    spectra[0] = spectra[1].real
    symbols = np.maximum(basis.symbols(2 * np.pi * f), 0.0)
    noise = 1.0 / (weights @ symbols).T
    bending = symbols[2] / np.maximum(symbols[0], 1e-300)
    share = (noise * bending[:, None]).sum(axis=0) / np.einsum("fjj,f->j", spectra.real, bending)
    if share.max() < NEGLIGIBLE**2:
        return None
    root = np.sqrt(noise)
    clear, vectors = np.linalg.eigh(spectra / root[:, :, None] / root[:, None, :])
    clear = np.maximum(clear - 1.0, 1e-2)
    signal = (vectors * clear[:, None, :]) @ vectors.conj().transpose(0, 2, 1) * root[:, :, None] * root[:, None, :]
    r = np.fft.irfft(signal, axis=0)[: order + 1]  # r[k] = E c(t) c(t + k)^T

    def lagged(k: int) -> np.ndarray:
        return r[k] if k >= 0 else r[-k].T

    past = np.block([[lagged(k - m) for m in range(order)] for k in range(order)])
    past[np.diag_indices(len(past))] *= 1 + 1e-10
    cross = np.vstack([r[k + 1] for k in range(order)])
    steps = np.linalg.solve(past, cross).T
    left = r[0] - steps @ cross
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    white = (vectors / np.sqrt(np.maximum(values, 1e-12 * values.max()))).T
    return np.stack([white, *(-white @ steps[:, k * n : (k + 1) * n] for k in range(order))])
