"""Chains integrated by SciPy's DOP853, of which the package knows nothing but the
channels.
"""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline


def multisine(rng, fs, duration, band, rms):
    """A force or base acceleration of random phases, as a function of time."""
    f = np.arange(np.ceil(band[0] * duration), band[1] * duration) / duration
    t = np.arange(int(4 * duration * fs) + 8) / (4 * fs)
    phase = rng.uniform(0, 2 * np.pi, len(f))
    spline = CubicSpline(
        t,
        rms
        * np.sqrt(2 / len(f))
        * np.cos(np.outer(t, 2 * np.pi * f) + phase).sum(axis=1),
    )
    starts, pieces = t.tolist(), spline.c.T.tolist()

    def at(now):
        """Many moments by SciPy; a single one, as the integrator asks, in numbers."""
        if np.ndim(now):
            return spline(now)
        k = min(max(int(now * 4 * fs), 0), len(pieces) - 1)
        past, (c3, c2, c1, c0) = now - starts[k], pieces[k]
        return ((c3 * past + c2) * past + c1) * past + c0

    return at


def matrix(values):
    """Stiffness or damping matrix of a chain on the base from the values of its
    storeys.
    """
    values = np.asarray(values, dtype=float)
    return (
        np.diag(values + np.append(values[1:], 0.0))
        - np.diag(values[1:], 1)
        - np.diag(values[1:], -1)
    )


def run(
    m,
    c,
    k,
    fs,
    duration,
    force: Callable | None = None,
    base: Callable | None = None,
    extra=None,
    break_at=(),
):
    """Absolute a, v and x relative to the base, and t, under force(t), extra(v, x) (N)
    and base(t) (m/s^2).
    """
    m, n = np.asarray(m, dtype=float), len(m)
    K, C = matrix(k), matrix(c)

    def absolute(t, x, v):
        out = -(K @ x) - C @ v
        if force is not None:
            out = out + force(t)
        return (out if extra is None else out + extra(v, x)) / m

    def rates(t, z):
        a = absolute(t, z[:n], z[n:])
        return np.concatenate([z[n:], a if base is None else a - base(t)])

    t = np.arange(int(duration * fs)) / fs
    ends = [0.0, *(b for b in break_at if 0 < b < t[-1]), t[-1] + 1e-9]
    z, parts = np.zeros(2 * n), []
    for low, high in zip(ends[:-1], ends[1:]):
        inside = t[(t >= low) & (t < high)]
        got = solve_ivp(
            rates,
            (low, high),
            z,
            "DOP853",
            np.append(inside, high),
            rtol=1e-9,
            atol=1e-12,
            max_step=4 / fs,
        )
        parts.append(got.y[:, :-1])
        z = got.y[:, -1]
    y = np.hstack(parts).T
    x, v = y[:, :n], y[:, n:]
    a = np.array([absolute(*row) for row in zip(t, x, v)])
    return a, v, x, t
