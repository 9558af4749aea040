"""Compiled integrators: Runge-Kutta with located velocity reversals, and Newmark of
average acceleration.
"""

from collections import namedtuple
from functools import cache

import numpy as np

from ..common.compiled import address_of, addresses, inline, jit, part
from . import system as ops

# why a run ended
DONE, DIVERGED, CRAWLS = 0, 1, 2
# Steps a sample, on average over the samples so far and these many more, beyond which a
# run is given up.
PATIENCE, FIRST = 250, 100


@inline
def _sums(k, weights, count, j, n):
    """Weighted sums of the rates and accelerations of the stages at one DOF."""
    dx, dv = 0.0, 0.0
    for m in range(count):
        if weights[m] != 0.0:
            dx += weights[m] * k.v[m * n + j]
            dv += weights[m] * k.a[m * n + j]
    return dx, dv


@part
def _attempt(system, drive, rule, interval, done, h, x0, v0, z0, k, w, general):
    """One step of length h; returns the error over the tolerance (Dormand-Prince 8:
    Hairer's mix of two).
    """
    n, stages, n_states, n_sites = (
        system.n_dof,
        rule.stages,
        system.n_states,
        system.n_sites,
    )
    x1, v1, z1, dt = k.x1, k.v1, k.z1, drive.dt
    t0 = interval * dt + done
    for stage in range(stages):
        rate, rise = address_of(k.v, stage * n), address_of(k.a, stage * n)
        power = address_of(k.power, stage * (n_sites + 1))
        if stage == 0:
            for j in range(n):
                rate[j], rise[j], x1[j], v1[j] = v0[j], k.a0[j], x0[j], v0[j]
            ops.inputs_at(drive, interval, done / dt, k.row)
            ops.put(k.force, k.force0, n_sites)
        else:
            weight, share = address_of(rule.a, stage * stages), rule.c[stage]
            for j in range(n):
                dx, dv = _sums(k, weight, stage, j, n)
                x1[j], v1[j] = x0[j] + h * dx, v0[j] + h * dv
                rate[j] = v1[j]
            ops.inputs_at(drive, interval, (done + share * h) / dt, k.row)
            if general is not None:
                ops.put(z1, z0, n_states)
                ops.inputs_at(drive, interval, (done + 0.5 * share * h) / dt, k.middle)
                ops.advance_states(system, x0, v0, x1, v1, z1, share * h, k.middle, w.u)
            ops.accelerate(
                system, t0 + share * h, k.row, x1, v1, z1, rise, k.force, w, general
            )
        power[0] = 0.0
        for j in range(n):
            power[0] += (k.row[j] - system.masses[j] * k.row[n]) * v1[j]
        for i in range(n_sites):
            power[i + 1] = k.force[i] * ops.relative(
                v1, address_of(system.sites, i * ops.SITE)
            )
    x_top, v_top = k.top[0], k.top[1]
    for j in range(n):
        dx, dv = _sums(k, rule.b, stages, j, n)
        x1[j], v1[j] = x0[j] + h * dx, v0[j] + h * dv
        x_top, v_top = max(x_top, abs(x1[j])), max(v_top, abs(v1[j]))
    norm3, norm5 = 0.0, 0.0
    for j in range(n):
        x3, v3 = _sums(k, rule.e3, stages, j, n)
        x5, v5 = _sums(k, rule.e5, stages, j, n)
        if x_top > 0.0:
            norm3 += (x3 / x_top) ** 2
            norm5 += (x5 / x_top) ** 2
        if v_top > 0.0:
            norm3 += (v3 / v_top) ** 2
            norm5 += (v5 / v_top) ** 2
    error = 0.0
    if norm5 != 0.0 or norm3 != 0.0:
        error = h * norm5 / (np.sqrt((norm5 + 0.01 * norm3) * 2.0 * n) * rule.rtol)
    if general is not None:
        # states by one step and by two: zero for laws that do not care how fast the
        # path is run
        for j in range(n):
            k.x_half[j] = 0.5 * (x0[j] + x1[j]) + 0.125 * h * (v0[j] - v1[j])
            k.v_half[j] = 1.5 * (x1[j] - x0[j]) / h - 0.25 * (v0[j] + v1[j])
        ops.put(k.z_once, z0, n_states)
        ops.put(z1, z0, n_states)
        ops.inputs_at(drive, interval, (done + 0.5 * h) / dt, k.middle)
        ops.advance_states(system, x0, v0, x1, v1, k.z_once, h, k.middle, w.u)
        ops.inputs_at(drive, interval, (done + 0.25 * h) / dt, k.middle)
        ops.advance_states(
            system, x0, v0, k.x_half, k.v_half, z1, 0.5 * h, k.middle, w.u
        )
        ops.inputs_at(drive, interval, (done + 0.75 * h) / dt, k.middle)
        ops.advance_states(
            system, k.x_half, k.v_half, x1, v1, z1, 0.5 * h, k.middle, w.u
        )
        for m in range(n_states):
            size = max(abs(z1[m]), k.z_top[m])
            if size > 0.0:
                gap = (
                    abs(z1[m] - k.z_once[m]) / size / rule.ztol
                )  # a product of tiny sizes would be zero
                # a second-order rule: put its error on the scale of an eighth-order one
                error = max(error, gap ** (8.0 / 3.0)) if gap == gap else np.nan
    return error


@part
def _reversal(system, regime, v0, v1, k, stages, v_tol):
    """First watched site that reverses in the step just tried: site and kind."""
    for i in range(system.n_sites):
        if k.watch[i] and regime[i] != 0:
            site = address_of(system.sites, i * ops.SITE)
            start, end = ops.relative(v0, site), ops.relative(v1, site)
            sign = 0.0
            if regime[i] != ops.FREE:
                sign = float(regime[i])
            elif abs(start) > v_tol:
                sign = np.sign(start)
            if sign != 0.0 and end * sign < -v_tol:
                # from standstill forward and back: nothing to interpolate between yet,
                # the step is too long
                return i, (
                    2
                    if abs(start) <= v_tol and ops.relative(k.a, site) * sign > 0.0
                    else 1
                )
            plus = sign > 0.0 or end > v_tol
            minus = sign < 0.0 or end < -v_tol
            for stage in range(1, stages):
                # of low order: small excursions mean nothing
                rate = ops.relative(address_of(k.v, stage * system.n_dof), site)
                plus |= rate > 1e5 * v_tol
                minus |= rate < -1e5 * v_tol
            if plus and minus:
                return i, 2
    return -1, 0


@part
def _settle(system, jump, v_tol, t, row, x, v, z, a, force, w):
    """Decide which sites at standstill stick and which slip, and find the
    accelerations.
    """
    regime = w.regime
    for i in range(system.n_sites):
        if jump[i] and regime[i] != 0:
            site = address_of(system.sites, i * ops.SITE)
            if abs(ops.relative(v, site)) <= v_tol:
                regime[i] = 0
            elif regime[i] == ops.FREE:
                regime[i] = 1 if ops.relative(v, site) > 0.0 else -1
    for _ in range(system.n_sites + 1):
        ops.accelerate(system, t, row, x, v, z, a, force, w, True)
        changed = False
        worst, most = (
            -1,
            1.0 + 1e-9,
        )  # one at a time: a site that slips relieves the others
        for i in range(system.n_sites):
            if jump[i] and regime[i] == 0:
                if w.jump[i] <= 0.0:
                    regime[i] = (
                        1
                        if ops.relative(a, address_of(system.sites, i * ops.SITE)) > 0.0
                        else -1
                    )
                    changed = True
                elif abs(w.share[i]) > most:
                    worst, most = i, abs(w.share[i])
        if worst >= 0:
            regime[worst] = 1 if w.share[worst] > 0.0 else -1
            changed = True
        if not changed:
            break


@part
def _overload(system, jump, w):
    """Sticking site that holds more than it can, by how much; -1 if none."""
    worst, most = -1, 1e-9
    for i in range(system.n_sites):
        if jump[i] and w.regime[i] == 0 and abs(w.share[i]) - 1.0 > most:
            worst, most = i, abs(w.share[i]) - 1.0
    return worst, most


@part
def _overload_inside(system, drive, interval, done, h, x0, v0, k, w):
    """Most that a sticking site holds too much at the eighths of a step, along which
    forces bend.
    """
    most, sticks = 0.0, False
    for i in range(system.n_sites):
        sticks |= k.jump[i] != 0 and w.regime[i] == 0
    if not sticks:
        return most
    for eighth in range(1, 8):
        q = eighth / 8.0
        for j in range(system.n_dof):  # the cubic between both ends
            gap, v1 = k.x1[j] - x0[j], k.v1[j]
            k.x_half[j] = (
                x0[j]
                + q * q * (3.0 - 2.0 * q) * gap
                + h * q * (1.0 - q) * ((1.0 - q) * v0[j] - q * v1)
            )
            k.v_half[j] = 6.0 * q * (1.0 - q) * gap / h
            k.v_half[j] += (1.0 - q) * (1.0 - 3.0 * q) * v0[j] + q * (
                3.0 * q - 2.0
            ) * v1
        ops.inputs_at(drive, interval, (done + q * h) / drive.dt, k.middle)
        t = interval * drive.dt + done + q * h
        ops.accelerate(
            system, t, k.middle, k.x_half, k.v_half, k.z1, k.a1, k.force1, w, True
        )
        most = max(most, _overload(system, k.jump, w)[1])
    return most


@part
def _record(system, out, i, x, v, a, z, work, base):
    """Write the row of a sample."""
    n, n_states = system.n_dof, system.n_states
    ops.put(address_of(out.x, i * n), x, n)
    ops.put(address_of(out.v, i * n), v, n)
    for j in range(n):
        out.a[i * n + j] = a[j] + base
    ops.put(address_of(out.z, i * n_states), z, n_states)
    ops.put(address_of(out.work, i * (system.n_sites + 1)), work, system.n_sites + 1)


@jit
def runge_kutta(system, drive, rule, k, w, x, v, z, adaptive, smallest, out, general):
    """March a system over its samples; without ``general`` no site has memory, sticks
    or has inertia.
    """
    system, drive, rule, k, w, x, v, z, out = addresses(
        (system, drive, rule, k, w, x, v, z, out)
    )
    regime, jump = w.regime, k.jump
    n, n_sites, n_states, n_inputs, stages = (
        system.n_dof,
        system.n_sites,
        system.n_states,
        drive.n_inputs,
        rule.stages,
    )
    a, x1, v1, z1, a1, force1, dt, last = (
        k.a0,
        k.x1,
        k.v1,
        k.z1,
        k.a1,
        k.force1,
        drive.dt,
        drive.last,
    )
    steps, rejected, forced, proposal = 0, 0, 0, dt
    # motion too small to matter: below it errors are absolute, or round-off would rule
    # the first steps
    strongest = 0.0
    for interval in range(last + 1):
        row = address_of(drive.samples, interval * n_inputs)
        strongest = max(strongest, abs(row[n]))
        for j in range(n):
            strongest = max(strongest, abs(row[j]) / system.masses[j])
    k.top[1] = 1e-4 * dt * strongest
    k.top[0] = dt * k.top[1]
    for j in range(n):
        k.top[0], k.top[1] = max(k.top[0], abs(x[j])), max(k.top[1], abs(v[j]))
    for interval in range(last + 1):
        v_tol = 1e-11 * k.top[1]
        ops.put(k.row, address_of(drive.samples, interval * n_inputs), n_inputs)
        if general is not None:
            _settle(system, jump, v_tol, interval * dt, k.row, x, v, z, a, k.force0, w)
        else:
            ops.accelerate(
                system, interval * dt, k.row, x, v, z, a, k.force0, w, general
            )
        _record(system, out, interval, x, v, a, z, k.work, k.row[n])
        if interval == last:
            break
        done, located, crawled, shortest = 0.0, 0, 0, smallest
        while done < dt:
            h = min(proposal, dt - done)
            if dt - done - h < 1e-9 * dt:
                h = dt - done
            h_tried = h
            # site that comes to a standstill, or starts to slip, at the end of this
            # step
            arrived = -1
            tries = 0  # left to find the instant of a standstill
            low, high, v_low, v_high = 0.0, 0.0, 0.0, 0.0
            while True:
                error = _attempt(
                    system, drive, rule, interval, done, h, x, v, z, k, w, general
                )
                if (
                    general is not None and tries > 0
                ):  # towards the standstill of a site: regula falsi (Illinois)
                    rate = ops.relative(
                        v1, address_of(system.sites, arrived * ops.SITE)
                    )
                    tries -= 1
                    if (
                        tries > 0
                        and error == error
                        and abs(rate) > v_tol
                        and high - low >= 1e-14 * dt
                    ):
                        if (rate > 0.0) == (v_high > 0.0):
                            high, v_high = h, rate
                            v_low *= 0.5
                        else:
                            low, v_low = h, rate
                            v_high *= 0.5
                        h = (low * v_high - high * v_low) / (v_high - v_low)
                        continue
                    tries = 0
                if general is not None and located < 100 and error == error:
                    site, kind = _reversal(system, regime, v, v1, k, stages, v_tol)
                    if kind == 2 and h > shortest:
                        h = max(0.5 * h, shortest)
                        arrived = -1
                        continue
                    if kind == 1:
                        low, high = 0.0, h
                        where = address_of(system.sites, site * ops.SITE)
                        v_low, v_high = ops.relative(v, where), ops.relative(v1, where)
                        h = (
                            1e-9 * dt
                            # of a slipping site that starts from standstill in the
                            # wrong direction
                        )
                        if v_low * v_high < 0.0:
                            tries, h = (
                                60,
                                (low * v_high - high * v_low) / (v_high - v_low),
                            )
                        arrived = site
                        located += 1
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
                shrink = (
                    0.9 * error ** (-0.125) if error == error and error < 1e300 else 0.1
                )
                h = max(h * min(max(shrink, 0.1), 0.9), shortest)
                arrived = -1
            steps += 1
            if steps + rejected > PATIENCE * (interval + FIRST):
                return CRAWLS, interval, 0, steps, rejected, forced
            for j in range(n):
                if error != error or not (
                    abs(x1[j]) < rule.limit and abs(v1[j]) < 1e100
                ):
                    return DIVERGED, interval, j, steps, rejected, forced
            ops.inputs_at(drive, interval, (done + h) / dt, k.row)
            t = interval * dt + done + h
            if general is None:
                ops.accelerate(system, t, k.row, x1, v1, z1, a1, force1, w, general)
            else:
                if arrived >= 0 and jump[arrived]:
                    regime[arrived] = 0
                for i in range(n_sites):
                    if (
                        regime[i] == 0
                    ):  # a sticking site stands still exactly, not to within round-off
                        where = address_of(system.sites, i * ops.SITE)
                        p, q = where[ops.UPPER], where[ops.LOWER]
                        if i != arrived:
                            x1[p] = x[p] + (x1[q] - x[q] if q >= 0 else 0.0)
                        v1[p] = v1[q] if q >= 0 else 0.0
                if arrived >= 0:
                    _settle(system, jump, v_tol, t, k.row, x1, v1, z1, a1, force1, w)
                else:
                    inside = 0.0
                    if (
                        drive.order > 1 and h > shortest
                    ):  # a force that bends may exceed what friction holds
                        inside = _overload_inside(
                            system, drive, interval, done, h, x, v, k, w
                        )
                    ops.accelerate(system, t, k.row, x1, v1, z1, a1, force1, w, general)
                    site, most = _overload(system, jump, w)
                    if max(most, inside) > 1e-6 and h > shortest and located < 100:
                        # it starts to slip inside this step: come closer to that
                        # instant
                        located += 1
                        rejected += 1
                        steps -= 1
                        proposal = max(0.5 * h, shortest)
                        continue
                    if site >= 0:
                        _settle(
                            system, jump, v_tol, t, k.row, x1, v1, z1, a1, force1, w
                        )
            for m in range(n_sites + 1):
                gain = 0.0
                for stage in range(stages):
                    gain += rule.b[stage] * k.power[stage * (n_sites + 1) + m]
                k.work[m] += h * gain
            for j in range(n):
                x[j], v[j], a[j] = x1[j], v1[j], a1[j]
                k.top[0], k.top[1] = max(k.top[0], abs(x[j])), max(k.top[1], abs(v[j]))
            for m in range(n_states):
                z[m] = z1[m]
                k.z_top[m] = max(k.z_top[m], abs(z[m]))
            ops.put(k.force0, force1, n_sites)
            done = dt if h == dt - done else done + h
            if adaptive:
                grow = 10.0 if error < 1e-9 else min(0.9 * error ** (-0.125), 10.0)
                proposal = min(
                    max(h * max(grow, 0.1), h_tried if arrived >= 0 else shortest), dt
                )
            else:
                proposal = dt
    return DONE, last, 0, steps, rejected, forced


@part
def _move(system, site, s0, r0, s1, r1, z, dt, middle, u):
    """Move the states of a site over one step, split where its linear rate crosses
    zero.
    """
    if r0 * r1 < 0.0:
        until = dt * r0 / (r0 - r1)
        s_there = s0 + 0.5 * r0 * until
        ops.advance_site(system, site, s0, r0, s_there, 0.0, z, until, middle, u)
        ops.advance_site(system, site, s_there, 0.0, s1, r1, z, dt - until, middle, u)
    else:
        ops.advance_site(system, site, s0, r0, s1, r1, z, dt, middle, u)


@part
def _move_all(system, x0, v0, x1, v1, z, dt, middle, u):
    """Move the states of all sites with memory over one step."""
    for i in range(system.n_sites):
        site = address_of(system.sites, i * ops.SITE)
        if site[ops.MEMORY]:
            r0, s1, r1 = (
                ops.relative(v0, site),
                ops.relative(x1, site),
                ops.relative(v1, site),
            )
            _move(system, site, ops.relative(x0, site), r0, s1, r1, z, dt, middle, u)


@part
def _end_force(system, w, site, t, row, middle, dt, x0, v0, x1, v1, z0, z1, nudge):
    """Force of a site at the end of a step whose relative acceleration there is larger
    by the nudge.
    """
    s1, r1 = (
        ops.relative(x1, site) + 0.25 * dt * dt * nudge,
        ops.relative(v1, site) + 0.5 * dt * nudge,
    )
    if site[ops.MEMORY]:
        ops.put(z1, z0, system.n_states)
        _move(
            system,
            site,
            ops.relative(x0, site),
            ops.relative(v0, site),
            s1,
            r1,
            z1,
            dt,
            middle,
            w.u,
        )
    force, _ = ops.site_force(system, site, s1, r1, t, row, z1, w.u, w.out, True)
    return force


@jit
def newmark(system, drive, k, w, x, v, z, out):
    """March a system over its samples."""
    system, drive, k, w, x, v, z, out = addresses((system, drive, k, w, x, v, z, out))
    n, n_sites, n_states, n_inputs = (
        system.n_dof,
        system.n_sites,
        system.n_states,
        drive.n_inputs,
    )
    base, dt, last, middle, matrix, work = (
        n,
        drive.dt,
        drive.last,
        k.middle,
        w.matrix,
        k.work,
    )
    a, x1, v1, z1, a1, force, force1 = k.a0, k.x1, k.v1, k.z1, k.a1, k.force0, k.force1
    found, step, slope = k.a, k.v, k.force
    iterations, forced, top = 0, 0, 1e-12
    ops.accelerate(system, 0.0, drive.samples, x, v, z, a, force, w, True)
    for i in range(last + 1):
        for j in range(n):
            top = max(top, abs(a[j]))
        row = address_of(drive.samples, i * n_inputs)
        _record(system, out, i, x, v, a, z, work, row[base])
        if i == last:
            break
        t, was, row = (i + 1) * dt, row, address_of(row, n_inputs)
        for j in range(n_inputs):
            middle[j] = 0.5 * (was[j] + row[j])
        ops.put(a1, a, n)
        for iteration in range(40):
            for j in range(n):
                x1[j] = x[j] + dt * v[j] + 0.25 * dt * dt * (a[j] + a1[j])
                v1[j] = v[j] + 0.5 * dt * (a[j] + a1[j])
            for m in range(n_sites):
                site, nudge = address_of(system.sites, m * ops.SITE), 1e-6 * top
                now = _end_force(
                    system, w, site, t, row, middle, dt, x, v, x1, v1, z, z1, 0.0
                )
                nudged = _end_force(
                    system, w, site, t, row, middle, dt, x, v, x1, v1, z, z1, nudge
                )
                slope[m] = (nudged - now) / nudge
            ops.put(z1, z, n_states)
            _move_all(system, x, v, x1, v1, z1, dt, middle, w.u)
            ops.accelerate(system, t, row, x1, v1, z1, found, force1, w, True)
            for j in range(n):
                for m in range(n):
                    matrix[j * n + m] = w.mass[j] if j == m else 0.0
                step[j] = w.mass[j] * (found[j] - a1[j])
            for m in range(n_sites):
                site = address_of(system.sites, m * ops.SITE)
                p, q = site[ops.UPPER], site[ops.LOWER]
                inertia = 0.0 if site[ops.ON_DOF] else w.inertia[m]
                gap = ops.relative(found, site) - ops.relative(a1, site)
                ops.add_between(matrix, p, q, n, slope[m] + inertia)
                step[p] += inertia * gap
                if q >= 0:
                    step[q] -= inertia * gap
            ops.solve(matrix, step, n)
            largest = 0.0
            for j in range(n):
                a1[j] += step[j] if iteration < 15 else 0.5 * step[j]
                largest = max(largest, abs(step[j]))
                if not (abs(a1[j]) < 1e100 and abs(x1[j]) < 1e100):
                    return DIVERGED, i, j, i, iterations, forced
            if largest <= 1e-13 * top:
                break
            iterations += 1
        else:
            forced += 1
        # the accepted end, its states and the accelerations that balance it
        for j in range(n):
            x1[j] = x[j] + dt * v[j] + 0.25 * dt * dt * (a[j] + a1[j])
            v1[j] = v[j] + 0.5 * dt * (a[j] + a1[j])
        _move_all(system, x, v, x1, v1, z, dt, middle, w.u)
        ops.accelerate(system, t, row, x1, v1, z, a1, force1, w, True)
        for j in range(n):
            before, after = (
                was[j] - system.masses[j] * was[base],
                row[j] - system.masses[j] * row[base],
            )
            work[0] += 0.5 * dt * (before * v[j] + after * v1[j])
        for m in range(n_sites):
            site = address_of(system.sites, m * ops.SITE)
            work[m + 1] += (
                0.5
                * dt
                * (
                    force[m] * ops.relative(v, site)
                    + force1[m] * ops.relative(v1, site)
                )
            )
            force[m] = force1[m]
        for j in range(n):
            x[j], v[j], a[j] = x1[j], v1[j], a1[j]
    return DONE, last, 0, last, iterations, forced


Rule = namedtuple(
    "Rule", "a b c e3 e5 stages rtol ztol limit"
)  # see rule_of; ztol: of states; limit: of motion


@cache
def rule_of(method: str) -> tuple[np.ndarray, ...]:
    """Coefficients a, b, c and weights e3, e5 of the embedded errors: SciPy's DOP853,
    or the classical rule.
    """
    if method == "classical":
        a = np.zeros((4, 4))
        a[1, 0] = a[2, 1] = 0.5
        a[3, 2] = 1.0
        return (
            a,
            np.array([1, 2, 2, 1]) / 6,
            np.array([0, 0.5, 0.5, 1]),
            np.zeros(4),
            np.zeros(4),
        )
    from scipy.integrate import DOP853

    s = DOP853.n_stages
    tables = DOP853.A[:s, :s], DOP853.B, DOP853.C[:s], DOP853.E3[:s], DOP853.E5[:s]
    return tuple(np.ascontiguousarray(m) for m in tables)
