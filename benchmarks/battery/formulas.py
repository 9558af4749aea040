"""Effects of the battery, in formulas and an integrator of their own.

Nothing here comes from the package under test: friction is a steep tanh, gaps may be
smooth, hysteresis is integrated as an ordinary differential equation with fixed
Runge-Kutta sub-steps. Everything is compiled, which is why functions take long lists of
arrays and numbers.
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
SHIFTS = (0.0, 0.5, 0.5, 1.0)  # of the stages of the Runge-Kutta rule, in steps

# compiled code knows no dictionary
STRIBECK = CODE["stribeck"]
ASYMMETRIC_FRICTION = CODE["asymmetric_friction"]
GROUND_FRICTION = CODE["ground_friction"]
QUADRATIC_DAMPING = CODE["quadratic_damping"]
POWER_DAMPING = CODE["power_damping"]
CUBIC = CODE["cubic"]
QUINTIC = CODE["quintic"]
QUADRATIC = CODE["quadratic"]
ODD_QUADRATIC = CODE["odd_quadratic"]
ONE_SIDED_GAP = CODE["one_sided_gap"]
TWO_SIDED_GAP = CODE["two_sided_gap"]
BILINEAR = CODE["bilinear"]
DAHL = CODE["dahl"]
BOUC_WEN = CODE["bouc_wen"]
JENKINS = CODE["jenkins"]
MAXWELL = CODE["maxwell"]
STIFFNESS_STEP = CODE["stiffness_step"]
STIFFNESS_DRIFT = CODE["stiffness_drift"]
DAMPING_DRIFT = CODE["damping_drift"]
HARMONIC = CODE["harmonic"]
CONSTANT = CODE["constant"]


# -- forces of the effects -----------------------------------------------------
# p holds the parameters, p[0] the amplitude; s, v are drift and rate, z the state


@njit(cache=True)
def friction_force(kind, p, v, vg):
    """Fc, eps; Stribeck: static/sliding - 1, vs; asymmetric: share of the level."""
    if kind == STRIBECK:
        fall = math.exp(-((v / p[3]) ** 2))
        return p[0] * (1.0 + p[2] * fall) * math.tanh(v / p[1])
    if kind == ASYMMETRIC_FRICTION:
        direction = math.tanh(v / p[1])
        return p[0] * (direction + p[2] * direction**2)
    if kind == GROUND_FRICTION:  # on a frame that stands still while the base moves
        return p[0] * math.tanh((v + vg) / p[1])
    return p[0] * math.tanh(v / p[1])


@njit(cache=True)
def damping_force(kind, p, v):
    """c, eps; power law: n of |v|^n sgn v."""
    if kind == QUADRATIC_DAMPING:
        return p[0] * v * math.sqrt(v * v + p[1] * p[1])
    return p[0] * v * (v * v + p[1] * p[1]) ** (0.5 * (p[2] - 1.0))


@njit(cache=True)
def spring_force(kind, p, s):
    """k of a power of the drift."""
    if kind == CUBIC:
        return p[0] * s**3
    if kind == QUINTIC:
        return p[0] * s**5
    if kind == QUADRATIC:
        return p[0] * s**2
    return p[0] * s * abs(s)


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
def contact_force(kind, p, s):
    """k, gap, width, side; bilinear: k, width."""
    if kind == ONE_SIDED_GAP:
        return p[0] * p[3] * smooth_ramp(p[3] * s - p[1], p[2])
    if kind == TWO_SIDED_GAP:
        return p[0] * (smooth_ramp(s - p[1], p[2]) - smooth_ramp(-s - p[1], p[2]))
    return p[0] * smooth_ramp(s, p[1])


@njit(cache=True)
def changing_force(kind, p, s, v, t):
    """k, t0, width of a step; rate of a drift over p[1] seconds."""
    if kind == STIFFNESS_STEP:
        return p[0] * s * 0.5 * (1.0 + math.tanh((t - p[1]) / p[2]))
    if kind == STIFFNESS_DRIFT:
        return p[0] * s * t / p[1]
    return p[0] * v * t / p[1]


@njit(cache=True)
def effect_force(kind, p, s, v, t, z, vg):
    """Force of one effect, N."""
    if kind <= GROUND_FRICTION:
        return friction_force(kind, p, v, vg)
    if kind <= POWER_DAMPING:
        return damping_force(kind, p, v)
    if kind <= ODD_QUADRATIC:
        return spring_force(kind, p, s)
    if kind <= BILINEAR:
        return contact_force(kind, p, s)
    if kind == JENKINS:  # a trial step may leave the yield surface
        return p[0] * min(max(z, -1.0), 1.0)
    if kind <= MAXWELL:
        return p[0] * z
    if kind <= DAMPING_DRIFT:
        return changing_force(kind, p, s, v, t)
    if kind == HARMONIC:  # an applied force stands on the other side
        return -p[0] * math.sin(2.0 * math.pi * p[1] * t + p[2])
    if kind == CONSTANT:
        return -p[0]
    return p[0] * (s + p[1] * v)  # brace, ground link: k, c/k


# -- states of the effects -----------------------------------------------------


@njit(cache=True)
def bouc_wen_rate(p, v, z):
    """Normalised to the yield drift: uy, share beta, n; beta + gamma = 1."""
    beta = p[2]
    gamma = 1.0 - p[2]
    size = abs(z)
    if size < 1e-300:
        return v / p[1]
    closing = beta * abs(v) * size ** (p[3] - 1.0) * z
    return (v - closing - gamma * v * size ** p[3]) / p[1]


@njit(cache=True)
def effect_rate(kind, p, s, v, t, z):
    """Rate of the effect's state."""
    if kind == DAHL:  # sigma
        return p[1] * (v - abs(v) * z)
    if kind == BOUC_WEN:
        return bouc_wen_rate(p, v, z)
    if kind == JENKINS:  # yield drift; the sub-step ends on the yield surface
        return v / p[1]
    if kind == MAXWELL:  # tau
        return v - z / p[1]
    return 0.0


@njit(cache=True)
def returned(kind, z):
    """Elastoplastic return mapping."""
    if kind == JENKINS:
        return min(max(z, -1.0), 1.0)
    return z


@njit(cache=True)
def hermite(u, step, s0, v0, s1, v1):
    """Drift and rate between two samples, at a share u of the step."""
    u2 = u * u
    u3 = u * u * u
    s = (
        (2 * u3 - 3 * u2 + 1) * s0
        + (u3 - 2 * u2 + u) * step * v0
        + (-2 * u3 + 3 * u2) * s1
        + (u3 - u2) * step * v1
    )
    v = (
        (6 * u2 - 6 * u) / step * s0
        + (3 * u2 - 4 * u + 1) * v0
        + (-6 * u2 + 6 * u) / step * s1
        + (3 * u2 - 2 * u) * v1
    )
    return s, v


@njit(cache=True)
def state_after(kind, p, z, step, n_substeps, t, s0, v0, s1, v1):
    """State one sample later, by Runge-Kutta sub-steps along cubic Hermite pieces."""
    h = step / n_substeps
    for m in range(n_substeps):
        rate = np.zeros(4)
        for stage in range(4):
            shift = SHIFTS[stage]
            s, v = hermite((m + shift) / n_substeps, step, s0, v0, s1, v1)
            trial = z
            if stage > 0:
                trial = z + shift * h * rate[stage - 1]
            rate[stage] = effect_rate(kind, p, s, v, t, trial)
        slope = rate[0] + 2 * rate[1] + 2 * rate[2] + rate[3]
        z = returned(kind, z + h * slope / 6.0)
    return z


@njit(cache=True)
def along(kind, p, s, v, t, vg, n_substeps):
    """Force of an effect along a sampled motion."""
    out = np.empty(len(s))
    z = 0.0
    out[0] = effect_force(kind, p, s[0], v[0], t[0], z, vg[0])
    for i in range(len(s) - 1):
        if DAHL <= kind <= MAXWELL:
            step = t[i + 1] - t[i]
            z = state_after(
                kind, p, z, step, n_substeps, t[i], s[i], v[i], s[i + 1], v[i + 1]
            )
        out[i + 1] = effect_force(kind, p, s[i + 1], v[i + 1], t[i + 1], z, vg[i + 1])
    return out


# -- the chain -----------------------------------------------------------------


@njit(cache=True)
def storey_force(k, c, k3, s, v):
    return k * s + c * v + k3 * s**3


@njit(cache=True)
def rates(y, t, F, ag, vg, m, k, c, k3, kinds, ends, pars, out, forces):
    """State rates of the chain; y = x, v (relative to the base), z.

    Forces of the effects go to ``forces``.
    """
    n = len(m)
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
    for e in range(len(kinds)):
        p = ends[e, 0]
        q = ends[e, 1]
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
        value = (coef[0, i, j] * h + coef[1, i, j]) * h + coef[2, i, j]
        out[j] = value * h + coef[3, i, j]
    return out


@njit(cache=True)
def integrate(load, n_samples, dt, n_substeps, m, k, c, k3, kinds, ends, pars):
    """Fixed-step classical Runge-Kutta; load = cubic pieces of [F_1..F_n, ag, vg].

    Returns x, v, absolute acceleration (n_samples, n) and the effects' forces
    (n_samples, n_effects); NaN from where the motion leaves the range of numbers.
    """
    n = len(m)
    y = np.zeros(2 * n + len(kinds))
    x, v, a = np.empty((3, n_samples, n))
    effects = np.empty((n_samples, len(kinds)))
    forces = np.empty(len(kinds))
    slopes = np.empty((4, len(y)))
    h = dt / n_substeps

    for i in range(n_samples):
        piece = min(i, n_samples - 2)
        u = poly(load, piece, dt * (i - piece))
        F = u[:n]
        ag = u[n]
        rate = slopes[0]
        rates(y, i * dt, F, ag, u[n + 1], m, k, c, k3, kinds, ends, pars, rate, forces)
        for j in range(n):
            x[i, j] = y[j]
            v[i, j] = y[n + j]
            a[i, j] = rate[n + j] + ag
        effects[i] = forces
        if i == n_samples - 1:
            break
        if not np.isfinite(y).all():
            x[i:] = np.nan
            break

        for q in range(n_substeps):
            for stage in range(4):
                shift = SHIFTS[stage]
                t = i * dt + q * h + shift * h
                trial = y
                if stage > 0:
                    trial = y + shift * h * slopes[stage - 1]
                u = poly(load, i, (q + shift) * h)
                F = u[:n]
                ag = u[n]
                vg = u[n + 1]
                out = slopes[stage]
                rates(trial, t, F, ag, vg, m, k, c, k3, kinds, ends, pars, out, forces)
            slope = slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3]
            y = y + h / 6.0 * slope
            for e in range(len(kinds)):
                y[2 * n + e] = returned(kinds[e], y[2 * n + e])
    return x, v, a, effects
