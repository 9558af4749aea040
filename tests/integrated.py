"""Chains integrated by SciPy's DOP853: the package sees nothing but their channels."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline


def multisine(rng, fs, duration, band, rms):
    """A force or base acceleration of random phases, as a function of time."""
    lines = np.arange(np.ceil(band[0] * duration), band[1] * duration) / duration
    t = np.arange(int(4 * duration * fs) + 8) / (4 * fs)
    phase = rng.uniform(0, 2 * np.pi, len(lines))
    waves = np.cos(np.outer(t, 2 * np.pi * lines) + phase)
    spline = CubicSpline(t, rms * np.sqrt(2 / len(lines)) * waves.sum(axis=1))
    starts = t.tolist()
    pieces = spline.c.T.tolist()

    def value_at(time):
        """Many times by SciPy; a single one, for the integrator, by plain numbers."""
        if np.ndim(time):
            return spline(time)
        piece = min(max(int(time * 4 * fs), 0), len(pieces) - 1)
        c3, c2, c1, c0 = pieces[piece]
        x = time - starts[piece]
        return ((c3 * x + c2) * x + c1) * x + c0

    return value_at


def matrix(values):
    """Stiffness or damping matrix of a chain on the base, from its storeys."""
    values = np.asarray(values, dtype=float)
    above = np.append(values[1:], 0.0)
    coupling = np.diag(values[1:], 1)
    return np.diag(values + above) - coupling - coupling.T


def run(
    m,
    c,
    k,
    fs,
    duration,
    force: Callable | None = None,
    base: Callable | None = None,
    break_at=(),
):
    """Absolute a, v and x relative to the base, and t.

    The chain is driven by force(t) in N and by base(t) in m/s^2. The integration starts
    anew at the times of ``break_at``.
    """
    m = np.asarray(m, dtype=float)
    n = len(m)
    K, C = matrix(k), matrix(c)

    def absolute(t, x, v):
        load = -(K @ x) - C @ v
        if force is not None:
            load = load + force(t)
        return load / m

    def rates(t, z):
        a = absolute(t, z[:n], z[n:])
        if base is not None:
            a = a - base(t)
        return np.concatenate([z[n:], a])

    t = np.arange(int(duration * fs)) / fs
    breaks = [time for time in break_at if 0 < time < t[-1]]
    edges = [0.0, *breaks, t[-1] + 1e-9]
    z = np.zeros(2 * n)
    pieces = []
    for start, end in zip(edges[:-1], edges[1:]):
        samples = t[(t >= start) & (t < end)]
        solution = solve_ivp(
            rates,
            (start, end),
            z,
            "DOP853",
            np.append(samples, end),
            rtol=1e-9,
            atol=1e-12,
            max_step=4 / fs,
        )
        pieces.append(solution.y[:, :-1])
        z = solution.y[:, -1]

    y = np.hstack(pieces).T
    x, v = y[:, :n], y[:, n:]
    a = np.array([absolute(*row) for row in zip(t, x, v)])
    return a, v, x, t
