"""Newmark-beta steps of average acceleration (beta = 1/4, gamma = 1/2). Compiled."""

from __future__ import annotations

import numpy as np

from ..laws.compiled import borrow, jit, part
from .balance import FREE, accelerate, advance_site, relative, site_force, solve
from .runge_kutta import DIVERGED, DONE
from .system import LOWER, MEMORY, ON_DOF, UPPER
from .views import borrow_system, borrow_work


@part
def _move(system, site, s0, r0, s1, r1, z, dt, middle, u):
    """Move the states of a site over one step, split where its linear rate crosses zero."""
    if r0 * r1 < 0.0:
        turn = dt * r0 / (r0 - r1)
        s_turn = s0 + 0.5 * r0 * turn
        advance_site(system, site, s0, r0, s_turn, 0.0, z, turn, middle, u)
        advance_site(system, site, s_turn, 0.0, s1, r1, z, dt - turn, middle, u)
    else:
        advance_site(system, site, s0, r0, s1, r1, z, dt, middle, u)


@part
def _tangent(system, w, i, t, row, middle, dt, x0, v0, x1, v1, z0, z1, force, nudge):
    """Change of the force of site i with the relative acceleration at the end of the step."""
    site = system.sites[i]
    s1, r1 = relative(x1, site) + 0.25 * dt * dt * nudge, relative(v1, site) + 0.5 * dt * nudge
    if site[MEMORY]:
        z1[:] = z0
        _move(system, site, relative(x0, site), relative(v0, site), s1, r1, z1, dt, middle, w.u)
    nudged, _ = site_force(system, site, s1, r1, t, row, z1, w.u, w.out)
    return (nudged - force) / nudge


def newmark(system, w, samples, dt, x, v, z, out):
    """March a system over its samples."""
    x, v, z, samples = borrow(x), borrow(v), borrow(z), borrow(samples)
    system, w = borrow_system(system), borrow_work(w)
    n, n_sites, base = x.size, system.sites.shape[0], x.size
    regime = np.full(n_sites, FREE)
    a, a1, found, step = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    x1, v1, z1, middle = np.zeros(n), np.zeros(n), z.copy(), np.zeros(samples.shape[1])
    force, force1, slope = np.zeros(n_sites), np.zeros(n_sites), np.zeros(n_sites)
    work, matrix = np.zeros(n_sites + 1), np.zeros((n, n))
    iterations, forced, top = 0, 0, 1e-12
    last = samples.shape[0] - 1
    accelerate(system, regime, 0.0, samples[0], x, v, z, a, force, w)
    for i in range(last + 1):
        for j in range(n):
            out.x[i, j], out.v[i, j], out.a[i, j] = x[j], v[j], a[j] + samples[i, base]
            top = max(top, abs(a[j]))
        for m in range(z.size):
            out.z[i, m] = z[m]
        for m in range(n_sites + 1):
            out.work[i, m] = work[m]
        if i == last:
            break
        t, row = (i + 1) * dt, samples[i + 1]
        for j in range(middle.size):
            middle[j] = 0.5 * (samples[i, j] + row[j])
        a1[:] = a
        converged = False
        for iteration in range(40):
            for j in range(n):
                x1[j] = x[j] + dt * v[j] + 0.25 * dt * dt * (a[j] + a1[j])
                v1[j] = v[j] + 0.5 * dt * (a[j] + a1[j])
            for k in range(n_sites):
                site = system.sites[k]
                nudge = 1e-6 * top
                if site[MEMORY]:
                    z1[:] = z
                    _move(
                        system, site, relative(x, site), relative(v, site), relative(x1, site), relative(v1, site),
                        z1, dt, middle, w.u,
                    )  # fmt: skip
                now, _ = site_force(system, site, relative(x1, site), relative(v1, site), t, row, z1, w.u, w.out)
                slope[k] = _tangent(system, w, k, t, row, middle, dt, x, v, x1, v1, z, z1, now, nudge)
            z1[:] = z
            for k in range(n_sites):
                site = system.sites[k]
                if site[MEMORY]:
                    _move(
                        system, site, relative(x, site), relative(v, site), relative(x1, site), relative(v1, site),
                        z1, dt, middle, w.u,
                    )  # fmt: skip
            accelerate(system, regime, t, row, x1, v1, z1, found, force1, w)
            for j in range(n):
                for k in range(n):
                    matrix[j, k] = 0.0
                matrix[j, j] = w.mass[j]
                step[j] = w.mass[j] * (found[j] - a1[j])
            for k in range(n_sites):
                site = system.sites[k]
                p, q = site[UPPER], site[LOWER]
                inertia = 0.0 if site[ON_DOF] else w.inertia[k]
                gap = relative(found, site) - relative(a1, site)
                stiffness = slope[k] + inertia
                matrix[p, p] += stiffness
                step[p] += inertia * gap
                if q >= 0:
                    matrix[q, q] += stiffness
                    matrix[p, q] -= stiffness
                    matrix[q, p] -= stiffness
                    step[q] -= inertia * gap
            solve(matrix, step, n)
            largest = 0.0
            for j in range(n):
                a1[j] += step[j] if iteration < 15 else 0.5 * step[j]
                largest = max(largest, abs(step[j]))
                if not (abs(a1[j]) < 1e100 and abs(x1[j]) < 1e100):
                    return DIVERGED, i, j, i, iterations, forced
            if largest <= 1e-13 * top:
                converged = True
                break
            iterations += 1
        if not converged:
            forced += 1
        # the accepted end, its states and the accelerations that balance it
        for j in range(n):
            x1[j] = x[j] + dt * v[j] + 0.25 * dt * dt * (a[j] + a1[j])
            v1[j] = v[j] + 0.5 * dt * (a[j] + a1[j])
        for k in range(n_sites):
            site = system.sites[k]
            if site[MEMORY]:
                _move(
                    system, site, relative(x, site), relative(v, site), relative(x1, site), relative(v1, site),
                    z, dt, middle, w.u,
                )  # fmt: skip
        accelerate(system, regime, t, row, x1, v1, z, a1, force1, w)
        for j in range(n):
            before, after = samples[i, j] - system.masses[j] * samples[i, base], row[j] - system.masses[j] * row[base]
            work[0] += 0.5 * dt * (before * v[j] + after * v1[j])
        for k in range(n_sites):
            site = system.sites[k]
            work[k + 1] += 0.5 * dt * (force[k] * relative(v, site) + force1[k] * relative(v1, site))
            force[k] = force1[k]
        for j in range(n):
            x[j], v[j], a[j] = x1[j], v1[j], a1[j]
    return DONE, last, 0, last, iterations, forced


newmark = jit(newmark)
