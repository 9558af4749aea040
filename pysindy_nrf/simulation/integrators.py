"""Compiled integrators: Runge-Kutta with located velocity reversals, and Newmark of average acceleration."""

from functools import cache

import numpy as np

from ..laws.compiled import borrow, jit, part
from .system import (
    FREE,
    LOWER,
    MEMORY,
    ON_DOF,
    UPPER,
    accelerate,
    advance_site,
    advance_states,
    inputs_at,
    put,
    relative,
    site_force,
    solve,
)

# why a run ended
DONE, DIVERGED, CRAWLS = 0, 1, 2
# Steps a sample, on average over the samples so far and these many more, beyond which a run is given up.
PATIENCE, FIRST = 250, 100


@part
def _attempt(system, regime, polynomials, interval, dt, done, h, x0, v0, z0, a0, tables, x1, v1, z1, k, w):
    """One step of length h; returns the error over the tolerance (Dormand-Prince 8: Hairer's mix of two)."""
    a_table, b, c, e3, e5, rtol, ztol = tables
    n, stages = x0.size, b.size
    t0 = interval * dt + done
    for stage in range(stages):
        if stage == 0:
            for j in range(n):
                k.v[0, j], k.a[0, j], x1[j], v1[j] = v0[j], a0[j], x0[j], v0[j]
            inputs_at(polynomials, interval, done / dt, k.row)
            for i in range(k.force.size):
                k.force[i] = k.force0[i]
        else:
            for j in range(n):
                dx, dv = 0.0, 0.0
                for m in range(stage):
                    if a_table[stage, m] != 0.0:
                        dx += a_table[stage, m] * k.v[m, j]
                        dv += a_table[stage, m] * k.a[m, j]
                x1[j], v1[j] = x0[j] + h * dx, v0[j] + h * dv
                k.v[stage, j] = v1[j]
            inputs_at(polynomials, interval, (done + c[stage] * h) / dt, k.row)
            if z0.size:
                put(z1, z0)
                inputs_at(polynomials, interval, (done + 0.5 * c[stage] * h) / dt, k.middle)
                advance_states(system, x0, v0, x1, v1, z1, c[stage] * h, k.middle, w.u)
            accelerate(system, regime, t0 + c[stage] * h, k.row, x1, v1, z1, k.a[stage], k.force, w)
        k.power[stage, 0] = 0.0
        for j in range(n):
            k.power[stage, 0] += (k.row[j] - system.masses[j] * k.row[n]) * v1[j]
        for i in range(k.force.size):
            k.power[stage, i + 1] = k.force[i] * relative(v1, system.sites[i])
    x_top, v_top = k.top[0], k.top[1]
    for j in range(n):
        dx, dv = 0.0, 0.0
        for m in range(stages):
            dx += b[m] * k.v[m, j]
            dv += b[m] * k.a[m, j]
        x1[j], v1[j] = x0[j] + h * dx, v0[j] + h * dv
        x_top, v_top = max(x_top, abs(x1[j])), max(v_top, abs(v1[j]))
    norm3, norm5 = 0.0, 0.0
    for j in range(n):
        x3, v3, x5, v5 = 0.0, 0.0, 0.0, 0.0
        for m in range(stages):
            x3 += e3[m] * k.v[m, j]
            v3 += e3[m] * k.a[m, j]
            x5 += e5[m] * k.v[m, j]
            v5 += e5[m] * k.a[m, j]
        if x_top > 0.0:
            norm3 += (x3 / x_top) ** 2
            norm5 += (x5 / x_top) ** 2
        if v_top > 0.0:
            norm3 += (v3 / v_top) ** 2
            norm5 += (v5 / v_top) ** 2
    error = 0.0
    if norm5 != 0.0 or norm3 != 0.0:
        error = h * norm5 / (np.sqrt((norm5 + 0.01 * norm3) * 2.0 * n) * rtol)
    if z0.size:
        # states by one step and by two: zero for laws that do not care how fast the path is run
        for j in range(n):
            k.x_half[j] = 0.5 * (x0[j] + x1[j]) + 0.125 * h * (v0[j] - v1[j])
            k.v_half[j] = 1.5 * (x1[j] - x0[j]) / h - 0.25 * (v0[j] + v1[j])
        put(k.z_once, z0)
        put(z1, z0)
        inputs_at(polynomials, interval, (done + 0.5 * h) / dt, k.middle)
        advance_states(system, x0, v0, x1, v1, k.z_once, h, k.middle, w.u)
        inputs_at(polynomials, interval, (done + 0.25 * h) / dt, k.middle)
        advance_states(system, x0, v0, k.x_half, k.v_half, z1, 0.5 * h, k.middle, w.u)
        inputs_at(polynomials, interval, (done + 0.75 * h) / dt, k.middle)
        advance_states(system, k.x_half, k.v_half, x1, v1, z1, 0.5 * h, k.middle, w.u)
        for m in range(z0.size):
            size = max(abs(z1[m]), k.z_top[m])
            if size > 0.0:
                gap = abs(z1[m] - k.z_once[m]) / (size * ztol)
                # a second-order rule: put its error on the scale of an eighth-order one
                error = max(error, gap ** (8.0 / 3.0)) if gap == gap else np.nan
    return error


@part
def _reversal(system, regime, watch, v0, v1, k, stages, v_tol):
    """First watched site that reverses in the step just tried: site and kind."""
    for i in range(watch.size):
        if watch[i] and regime[i] != 0:
            site = system.sites[i]
            start, end = relative(v0, site), relative(v1, site)
            sign = 0.0
            if regime[i] != FREE:
                sign = float(regime[i])
            elif abs(start) > v_tol:
                sign = np.sign(start)
            if sign != 0.0 and end * sign < -v_tol:
                # from standstill forward and back: nothing to interpolate between yet, the step is too long
                return i, 2 if abs(start) <= v_tol and relative(k.a[0], site) * sign > 0.0 else 1
            plus = sign > 0.0 or end > v_tol
            minus = sign < 0.0 or end < -v_tol
            for stage in range(1, stages):
                rate = relative(k.v[stage], site)  # of low order: small excursions mean nothing
                plus |= rate > 1e5 * v_tol
                minus |= rate < -1e5 * v_tol
            if plus and minus:
                return i, 2
    return -1, 0


@part
def _settle(system, regime, jump, v_tol, t, row, x, v, z, a, force, w):
    """Decide which sites at standstill stick and which slip, and find the accelerations."""
    for i in range(jump.size):
        if jump[i] and regime[i] != 0:
            site = system.sites[i]
            if abs(relative(v, site)) <= v_tol:
                regime[i] = 0
            elif regime[i] == FREE:
                regime[i] = 1 if relative(v, site) > 0.0 else -1
    for _ in range(jump.size + 1):
        accelerate(system, regime, t, row, x, v, z, a, force, w)
        changed = False
        worst, most = -1, 1.0 + 1e-9  # one at a time: a site that slips relieves the others
        for i in range(jump.size):
            if jump[i] and regime[i] == 0:
                if w.jump[i] <= 0.0:
                    regime[i] = 1 if relative(a, system.sites[i]) > 0.0 else -1
                    changed = True
                elif abs(w.share[i]) > most:
                    worst, most = i, abs(w.share[i])
        if worst >= 0:
            regime[worst] = 1 if w.share[worst] > 0.0 else -1
            changed = True
        if not changed:
            break


@part
def _overload(regime, jump, w):
    """Sticking site that holds more than it can, by how much; -1 if none."""
    worst, most = -1, 1e-9
    for i in range(jump.size):
        if jump[i] and regime[i] == 0 and abs(w.share[i]) - 1.0 > most:
            worst, most = i, abs(w.share[i]) - 1.0
    return worst, most


@part
def _overload_inside(system, regime, jump, polynomials, interval, dt, done, h, x0, v0, x1, v1, z, a, force, k, w):
    """Most that a sticking site holds too much at the eighths of a step, along which forces bend."""
    most, sticks = 0.0, False
    for i in range(jump.size):
        sticks |= jump[i] and regime[i] == 0
    if not sticks:
        return most
    for eighth in range(1, 8):
        q = eighth / 8.0
        for j in range(x0.size):  # the cubic between both ends
            gap = x1[j] - x0[j]
            k.x_half[j] = x0[j] + q * q * (3.0 - 2.0 * q) * gap + h * q * (1.0 - q) * ((1.0 - q) * v0[j] - q * v1[j])
            k.v_half[j] = 6.0 * q * (1.0 - q) * gap / h
            k.v_half[j] += (1.0 - q) * (1.0 - 3.0 * q) * v0[j] + q * (3.0 * q - 2.0) * v1[j]
        inputs_at(polynomials, interval, (done + q * h) / dt, k.middle)
        accelerate(system, regime, interval * dt + done + q * h, k.middle, k.x_half, k.v_half, z, a, force, w)
        most = max(most, _overload(regime, jump, w)[1])
    return most


def runge_kutta(system, w, k, polynomials, samples, dt, x, v, z, jump, tables, adaptive, smallest, out):
    """March a system over its samples."""
    n, n_sites, stages = x.size, system.sites.shape[0], tables[1].size
    watch = np.zeros(n_sites, dtype=np.bool_)
    for i in range(n_sites):
        watch[i] = jump[i] or system.sites[i, MEMORY]
    regime = np.full(n_sites, FREE)
    a, x1, v1, z1 = np.zeros(n), np.zeros(n), np.zeros(n), z.copy()
    a1, force1 = np.zeros(n), np.zeros(n_sites)
    # the caller owns every array: hand them on without counting references
    x, v, z, samples, polynomials = borrow(x), borrow(v), borrow(z), borrow(samples), borrow(polynomials)
    system, w, k = borrow(system), borrow(w), borrow(k)
    steps, rejected, forced = 0, 0, 0
    bent = polynomials.shape[0] > 2  # a force that bends may pass between two samples what friction can hold
    proposal = dt
    last = samples.shape[0] - 1
    # motion too small to matter: below it errors are absolute, or round-off would rule the first steps
    strongest = 0.0
    for interval in range(last + 1):
        strongest = max(strongest, abs(samples[interval, n]))
        for j in range(n):
            strongest = max(strongest, abs(samples[interval, j]) / system.masses[j])
    k.top[1] = 1e-4 * dt * strongest
    k.top[0] = dt * k.top[1]
    for j in range(n):
        k.top[0], k.top[1] = max(k.top[0], abs(x[j])), max(k.top[1], abs(v[j]))
    k.work[:] = 0.0
    for interval in range(last + 1):
        v_tol = 1e-11 * k.top[1]
        put(k.row, samples[interval])
        _settle(system, regime, jump, v_tol, interval * dt, k.row, x, v, z, a, k.force0, w)
        for j in range(n):
            out.x[interval, j], out.v[interval, j], out.a[interval, j] = x[j], v[j], a[j] + samples[interval, n]
        for m in range(z.size):
            out.z[interval, m] = z[m]
        for m in range(n_sites + 1):
            out.work[interval, m] = k.work[m]
        if interval == last:
            break
        done, events, crawled, shortest = 0.0, 0, 0, smallest
        while done < dt:
            h = min(proposal, dt - done)
            if dt - done - h < 1e-9 * dt:
                h = dt - done
            h_tried = h
            arrived = -1  # site that comes to a standstill, or starts to slip, at the end of this step
            tries = 0  # left to find the instant of a standstill
            low, high, v_low, v_high = 0.0, 0.0, 0.0, 0.0
            while True:
                error = _attempt(
                    system, regime, polynomials, interval, dt, done, h, x, v, z, a, tables, x1, v1, z1, k, w
                )
                if tries > 0:  # on the way to the standstill of a site: regula falsi (Illinois) on its rate
                    rate = relative(v1, system.sites[arrived])
                    tries -= 1
                    if tries > 0 and abs(rate) > v_tol and high - low >= 1e-14 * dt:
                        if (rate > 0.0) == (v_high > 0.0):
                            high, v_high = h, rate
                            v_low *= 0.5
                        else:
                            low, v_low = h, rate
                            v_high *= 0.5
                        h = (low * v_high - high * v_low) / (v_high - v_low)
                        continue
                    tries = 0
                if events < 100 and error == error:
                    site, kind = _reversal(system, regime, watch, v, v1, k, stages, v_tol)
                    if kind == 2 and h > shortest:
                        h = max(0.5 * h, shortest)
                        arrived = -1
                        continue
                    if kind == 1:
                        low, high = 0.0, h
                        v_low, v_high = relative(v, system.sites[site]), relative(v1, system.sites[site])
                        h = 1e-9 * dt  # of a slipping site that starts from standstill in the wrong direction
                        if v_low * v_high < 0.0:
                            tries, h = 60, (low * v_high - high * v_low) / (v_high - v_low)
                        arrived = site
                        events += 1
                        continue
                if not adaptive or error <= 1.0:
                    break
                rejected += 1
                if h <= shortest:
                    forced += 1
                    crawled += 1
                    if crawled == 64:  # it slides along a jump that is not at zero rate
                        shortest *= 8.0
                    break
                shrink = 0.9 * error ** (-0.125) if error == error and error < 1e300 else 0.1
                h = max(h * min(max(shrink, 0.1), 0.9), shortest)
                arrived = -1
            steps += 1
            if steps + rejected > PATIENCE * (interval + FIRST):
                return CRAWLS, interval, 0, steps, rejected, forced
            for j in range(n):
                if not (abs(x1[j]) < 1e100 and abs(v1[j]) < 1e100):
                    return DIVERGED, interval, j, steps, rejected, forced
            inputs_at(polynomials, interval, (done + h) / dt, k.row)
            t = interval * dt + done + h
            if arrived >= 0 and jump[arrived]:
                regime[arrived] = 0
            for i in range(n_sites):
                if regime[i] == 0:  # a sticking site stands still exactly, not to within round-off
                    site = system.sites[i]
                    p, q = site[UPPER], site[LOWER]
                    if i != arrived:
                        x1[p] = x[p] + (x1[q] - x[q] if q >= 0 else 0.0)
                    v1[p] = v1[q] if q >= 0 else 0.0
            if arrived >= 0:
                _settle(system, regime, jump, v_tol, t, k.row, x1, v1, z1, a1, force1, w)
            else:
                inside = 0.0
                if bent and h > shortest:
                    inside = _overload_inside(
                        system, regime, jump, polynomials, interval, dt, done, h, x, v, x1, v1, z1, a1, force1, k, w
                    )
                accelerate(system, regime, t, k.row, x1, v1, z1, a1, force1, w)
                site, most = _overload(regime, jump, w)
                if max(most, inside) > 1e-6 and h > shortest and events < 100:
                    # it starts to slip inside this step: come closer to that instant
                    events += 1
                    rejected += 1
                    steps -= 1
                    proposal = max(0.5 * h, shortest)
                    continue
                if site >= 0:
                    _settle(system, regime, jump, v_tol, t, k.row, x1, v1, z1, a1, force1, w)
            for m in range(n_sites + 1):
                gain = 0.0
                for stage in range(stages):
                    gain += tables[1][stage] * k.power[stage, m]
                k.work[m] += h * gain
            for j in range(n):
                x[j], v[j], a[j] = x1[j], v1[j], a1[j]
                k.top[0], k.top[1] = max(k.top[0], abs(x[j])), max(k.top[1], abs(v[j]))
            for m in range(z.size):
                z[m] = z1[m]
                k.z_top[m] = max(k.z_top[m], abs(z[m]))
            for i in range(n_sites):
                k.force0[i] = force1[i]
            done = dt if h == dt - done else done + h
            if adaptive:
                grow = 10.0 if error < 1e-9 else min(0.9 * error ** (-0.125), 10.0)
                proposal = min(max(h * max(grow, 0.1), h_tried if arrived >= 0 else shortest), dt)
            else:
                proposal = dt
    return DONE, last, 0, steps, rejected, forced


runge_kutta = jit(runge_kutta)


@part
def _move(system, site, s0, r0, s1, r1, z, dt, middle, u):
    """Move the states of a site over one step, split where its linear rate crosses zero."""
    if r0 * r1 < 0.0:
        until = dt * r0 / (r0 - r1)
        s_there = s0 + 0.5 * r0 * until
        advance_site(system, site, s0, r0, s_there, 0.0, z, until, middle, u)
        advance_site(system, site, s_there, 0.0, s1, r1, z, dt - until, middle, u)
    else:
        advance_site(system, site, s0, r0, s1, r1, z, dt, middle, u)


@part
def _move_all(system, x0, v0, x1, v1, z, dt, middle, u):
    """Move the states of all sites with memory over one step."""
    for i in range(system.sites.shape[0]):
        site = system.sites[i]
        if site[MEMORY]:
            s0, r0, s1, r1 = relative(x0, site), relative(v0, site), relative(x1, site), relative(v1, site)
            _move(system, site, s0, r0, s1, r1, z, dt, middle, u)


@part
def _end_force(system, w, site, t, row, middle, dt, x0, v0, x1, v1, z0, z1, nudge):
    """Force of a site at the end of a step whose relative acceleration there is larger by the nudge."""
    s1, r1 = relative(x1, site) + 0.25 * dt * dt * nudge, relative(v1, site) + 0.5 * dt * nudge
    if site[MEMORY]:
        put(z1, z0)
        _move(system, site, relative(x0, site), relative(v0, site), s1, r1, z1, dt, middle, w.u)
    force, _ = site_force(system, site, s1, r1, t, row, z1, w.u, w.out)
    return force


def newmark(system, w, samples, dt, x, v, z, out):
    """March a system over its samples."""
    x, v, z, samples = borrow(x), borrow(v), borrow(z), borrow(samples)
    system, w = borrow(system), borrow(w)
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
        put(a1, a)
        converged = False
        for iteration in range(40):
            for j in range(n):
                x1[j] = x[j] + dt * v[j] + 0.25 * dt * dt * (a[j] + a1[j])
                v1[j] = v[j] + 0.5 * dt * (a[j] + a1[j])
            for k in range(n_sites):
                site = system.sites[k]
                nudge = 1e-6 * top
                now = _end_force(system, w, site, t, row, middle, dt, x, v, x1, v1, z, z1, 0.0)
                nudged = _end_force(system, w, site, t, row, middle, dt, x, v, x1, v1, z, z1, nudge)
                slope[k] = (nudged - now) / nudge
            put(z1, z)
            _move_all(system, x, v, x1, v1, z1, dt, middle, w.u)
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
        _move_all(system, x, v, x1, v1, z, dt, middle, w.u)
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


@cache
def rule_of(method: str) -> tuple[np.ndarray, ...]:
    """Coefficients a, b, c and weights e3, e5 of the embedded errors: SciPy's DOP853, or the classical rule."""
    if method == "classical":
        a = np.zeros((4, 4))
        a[1, 0] = a[2, 1] = 0.5
        a[3, 2] = 1.0
        return a, np.array([1, 2, 2, 1]) / 6, np.array([0, 0.5, 0.5, 1]), np.zeros(4), np.zeros(4)
    from scipy.integrate import DOP853

    s = DOP853.n_stages
    tables = DOP853.A[:s, :s], DOP853.B, DOP853.C[:s], DOP853.E3[:s], DOP853.E5[:s]
    return tuple(np.ascontiguousarray(m) for m in tables)
