"""Frequency responses of a linear chain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Power of i w between the velocity and a channel of each kind.
POWER_OF_KIND = {"x": -1, "v": 0, "a": 1}


def transfer(
    matrices: Sequence[np.ndarray], f: np.ndarray, channels: Sequence[str] = ()
) -> np.ndarray:
    """Channels from forces and base acceleration, (len(f), n_channels, n_dof + 1).

    Channels are ``a1`` (absolute), ``v1`` and ``x1`` (relative to the base); the
    relative velocities of all DOFs if none is named.
    """
    M, C, K = matrices
    w = 2 * np.pi * np.asarray(f)[:, None, None]
    H = np.linalg.inv(K + 1j * w * C - w**2 * M)
    of_base = -H @ M.sum(axis=1)[None, :, None]
    G = 1j * w * np.concatenate([H, of_base], axis=2)
    if not channels:
        return G

    out = np.empty((len(G), len(channels), G.shape[2]), dtype=complex)
    for k, channel in enumerate(channels):
        kind = channel[0]
        dof = int(channel[1:])
        out[:, k] = G[:, dof - 1] * (1j * w[:, 0]) ** POWER_OF_KIND[kind]
        if kind == "a":
            out[:, k, -1] += 1.0
    return out
