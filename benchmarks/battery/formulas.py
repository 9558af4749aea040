"""Effects of the battery, in formulas and an integrator of their own.

Nothing here comes from the package under test: friction is a steep tanh, gaps may be
smooth, hysteresis is integrated as an ordinary differential equation with fixed
Runge-Kutta sub-steps.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

KINDS = (
    "coulomb",
    "stribeck",
    "asymmetric_friction",
    "ground_friction",
    "quadratic_damping",
    "power_damping",
    "cubic",
    "quintic",
    "quadratic",
    "odd_quadratic",
    "one_sided_gap",
    "two_sided_gap",
    "bilinear",
    "dahl",
    "bouc_wen",
    "jenkins",
    "maxwell",
    "stiffness_step",
    "stiffness_drift",
    "damping_drift",
    "harmonic",
    "constant",
    "brace",
    "ground_link",
)
CODE = {name: i for i, name in enumerate(KINDS)}
N_PAR = 6


@njit(cache=True)
def smooth_ramp(x, w):
    """max(x, 0), rounded over the width w (hard for w = 0)."""
    if w <= 0.0:
        return max(x, 0.0)
    u = x / w
    if u > 30.0:
        return x
    if u < -30.0:
        return 0.0
    return w * math.log1p(math.exp(u))


@njit(cache=True)
def effect_force(kind, p, s, v, t, z, vg):
    """Force of one effect, N; p holds its parameters, p[0] the amplitude, z its
    state.
    """
    if kind == 0:  # tanh friction: p = Fc, eps
        return p[0] * math.tanh(v / p[1])
    if kind == 1:  # Stribeck with a Gaussian fall: Fc, eps, static/sliding - 1, vs
        return p[0] * (1.0 + p[2] * math.exp(-((v / p[3]) ** 2))) * math.tanh(v / p[1])
    if kind == 2:  # level (1 + p2) forward, (1 - p2) backward
        return p[0] * (math.tanh(v / p[1]) + p[2] * math.tanh(v / p[1]) ** 2)
    if kind == 3:  # rubbing on a frame that stands still while the base moves
        return p[0] * math.tanh((v + vg) / p[1])
    if kind == 4:
        return p[0] * v * math.sqrt(v * v + p[1] * p[1])
    if kind == 5:  # |v|^n sgn v, rounded: p = c, eps, n
        return p[0] * v * (v * v + p[1] * p[1]) ** (0.5 * (p[2] - 1.0))
    if kind == 6:
        return p[0] * s**3
    if kind == 7:
        return p[0] * s**5
    if kind == 8:
        return p[0] * s**2
    if kind == 9:
        return p[0] * s * abs(s)
    if kind == 10:  # k, gap, width, side
        return p[0] * p[3] * smooth_ramp(p[3] * s - p[1], p[2])
    if kind == 11:
        return p[0] * (smooth_ramp(s - p[1], p[2]) - smooth_ramp(-s - p[1], p[2]))
    if kind == 12:  # k, width
        return p[0] * smooth_ramp(s, p[1])
    if (
        kind == 15
    ):  # inside a sub-step the elastic trial may stand beyond the yield surface
        return p[0] * min(max(z, -1.0), 1.0)
    if kind == 13 or kind == 14 or kind == 16:
        return p[0] * z
    if kind == 17:  # k, t0, width
        return p[0] * s * 0.5 * (1.0 + math.tanh((t - p[1]) / p[2]))
    if kind == 18:
        return p[0] * s * t / p[1]
    if kind == 19:
        return p[0] * v * t / p[1]
    if (
        kind == 20
    ):  # amplitude, frequency, phase: an applied force stands on the other side
        return -p[0] * math.sin(2.0 * math.pi * p[1] * t + p[2])
    if kind == 21:
        return -p[0]
    return p[0] * (s + p[1] * v)  # brace, ground link: k, c/k


@njit(cache=True)
def effect_rate(kind, p, s, v, t, z):
    """Rate of the effect's state."""
    if kind == 13:  # Dahl: sigma
        return p[1] * (v - abs(v) * z)
    if (
        kind == 14
    ):  # Bouc-Wen normalised to yield drift: uy, share beta, n; beta + gamma = 1
        beta, gamma = p[2], 1.0 - p[2]
        size = abs(z)
        if size < 1e-300:
            return v / p[1]
        return (
            v - beta * abs(v) * size ** (p[3] - 1.0) * z - gamma * v * size ** p[3]
        ) / p[1]
    if (
        kind == 15
    ):  # elastoplastic: yield drift; returned to the yield surface after each sub-step
        return v / p[1]
    if kind == 16:  # Maxwell: tau
        return v - z / p[1]
    return 0.0


@njit(cache=True)
def returned(kind, z):
    """Elastoplastic return mapping."""
    if kind == 15:
        return min(max(z, -1.0), 1.0)
    return z


@njit(cache=True)
def along(kind, p, s, v, t, vg, sub):
    """Force of an effect along a sampled motion; the state follows cubic Hermite pieces
    of it.
    """
    n = len(s)
    out = np.empty(n)
    z = 0.0
    out[0] = effect_force(kind, p, s[0], v[0], t[0], z, vg[0])
    for i in range(n - 1):
        if 13 <= kind <= 16:
            step = t[i + 1] - t[i]
            h = step / sub
            for m in range(sub):
                ks = np.zeros(4)
                for stage in range(4):
                    shift = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                    u = (m + shift) / sub
                    u2, u3 = u * u, u * u * u
                    ss = (
                        (2 * u3 - 3 * u2 + 1) * s[i]
                        + (u3 - 2 * u2 + u) * step * v[i]
                        + (-2 * u3 + 3 * u2) * s[i + 1]
                        + (u3 - u2) * step * v[i + 1]
                    )
                    vv = (
                        (6 * u2 - 6 * u) / step * s[i]
                        + (3 * u2 - 4 * u + 1) * v[i]
                        + (-6 * u2 + 6 * u) / step * s[i + 1]
                        + (3 * u2 - 2 * u) * v[i + 1]
                    )
                    zz = z
                    if stage > 0:
                        zz = z + shift * h * ks[stage - 1]
                    ks[stage] = effect_rate(kind, p, ss, vv, t[i], zz)
                z = returned(
                    kind, z + h * (ks[0] + 2 * ks[1] + 2 * ks[2] + ks[3]) / 6.0
                )
        out[i + 1] = effect_force(kind, p, s[i + 1], v[i + 1], t[i + 1], z, vg[i + 1])
    return out


@njit(cache=True)
def storey_force(k, c, k3, s, v):
    return k * s + c * v + k3 * s**3


@njit(cache=True)
def rates(y, t, F, ag, vg, m, k, c, k3, kinds, ends, pars, out, forces):
    """State rates of the chain; y = x, v (relative to the base), z. Forces of the
    effects go to ``forces``.
    """
    n, ne = len(m), len(kinds)
    for j in range(n):
        out[j] = y[n + j]
        out[n + j] = F[j]
    for i in range(n):
        s = y[i] - (y[i - 1] if i else 0.0)
        v = y[n + i] - (y[n + i - 1] if i else 0.0)
        r = storey_force(k[i], c[i], k3[i], s, v)
        out[n + i] -= r
        if i:
            out[n + i - 1] += r
    for e in range(ne):
        p, q = ends[e, 0], ends[e, 1]
        s = y[p - 1] - (y[q - 1] if q else 0.0)
        v = y[n + p - 1] - (y[n + q - 1] if q else 0.0)
        z = y[2 * n + e]
        r = effect_force(kinds[e], pars[e], s, v, t, z, vg)
        forces[e] = r
        out[n + p - 1] -= r
        if q:
            out[n + q - 1] += r
        out[2 * n + e] = effect_rate(kinds[e], pars[e], s, v, t, z)
    for j in range(n):
        out[n + j] = out[n + j] / m[j] - ag


@njit(cache=True)
def poly(coef, i, h):
    """Cubic pieces (order of scipy's CubicSpline.c) at a distance h behind knot i."""
    n = coef.shape[2]
    out = np.empty(n)
    for j in range(n):
        out[j] = ((coef[0, i, j] * h + coef[1, i, j]) * h + coef[2, i, j]) * h + coef[
            3, i, j
        ]
    return out


@njit(cache=True)
def integrate(load, n_samples, dt, sub, m, k, c, k3, kinds, ends, pars):
    """Fixed-step classical Runge-Kutta; load = cubic pieces of [F_1..F_n, ag, vg].

    Returns x, v, absolute acceleration (n_samples, n) and the effects' forces
    (n_samples, n_effects).
    """
    n, ne = len(m), len(kinds)
    size = 2 * n + ne
    y = np.zeros(size)
    x, vel, acc = (
        np.empty((n_samples, n)),
        np.empty((n_samples, n)),
        np.empty((n_samples, n)),
    )
    eff = np.empty((n_samples, ne))
    k1, k2, k3_, k4 = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    f = np.empty(ne)
    h = dt / sub
    for i in range(n_samples):
        at = min(i, n_samples - 2)
        u = poly(load, at, dt * (i - at))
        rates(y, i * dt, u[:n], u[n], u[n + 1], m, k, c, k3, kinds, ends, pars, k1, f)
        for j in range(n):
            x[i, j], vel[i, j], acc[i, j] = y[j], y[n + j], k1[n + j] + u[n]
        eff[i] = f
        if i == n_samples - 1:
            break
        if not np.isfinite(y).all():
            x[i:] = np.nan
            break
        for q in range(sub):
            t = i * dt + q * h
            u0, u1, u2 = (
                poly(load, i, q * h),
                poly(load, i, (q + 0.5) * h),
                poly(load, i, (q + 1) * h),
            )
            rates(y, t, u0[:n], u0[n], u0[n + 1], m, k, c, k3, kinds, ends, pars, k1, f)
            rates(
                y + 0.5 * h * k1,
                t + 0.5 * h,
                u1[:n],
                u1[n],
                u1[n + 1],
                m,
                k,
                c,
                k3,
                kinds,
                ends,
                pars,
                k2,
                f,
            )
            rates(
                y + 0.5 * h * k2,
                t + 0.5 * h,
                u1[:n],
                u1[n],
                u1[n + 1],
                m,
                k,
                c,
                k3,
                kinds,
                ends,
                pars,
                k3_,
                f,
            )
            rates(
                y + h * k3_,
                t + h,
                u2[:n],
                u2[n],
                u2[n + 1],
                m,
                k,
                c,
                k3,
                kinds,
                ends,
                pars,
                k4,
                f,
            )
            y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3_ + k4)
            for e in range(ne):
                y[2 * n + e] = returned(kinds[e], y[2 * n + e])
    return x, vel, acc, eff
