"""Explicit Runge-Kutta integration with located velocity reversals and dry friction.

A step ends where the rate of a watched site is zero: there a law with memory changes
its branch, and a site with dry friction sticks or slips the other way. Between such
events the motion is smooth, and the rule keeps its order.

The compiled functions take their arrays in small named tuples, and are longer than
others: one tuple of all arrays would take five times as long to compile.
"""

from collections import namedtuple
from functools import cache

import numpy as np

from ..common.compiled import address_of, addresses, inline, jit, subroutine
from .balance import (
    FREE,
    STICKS,
    Drive,
    Instant,
    Output,
    accelerate,
    advance_states,
    copy_to,
    inputs_at,
    new_instant,
    new_output,
    new_work,
    record_sample,
    relative,
    site_at,
)
from .outcome import CRAWLS, DIVERGED, DONE, PATIENCE, Outcome, StepCounts
from .system import INERTIA, LOWER, MEMORY, UPPER, System

# A run may use up the patience of this many samples in advance.
FIRST_SAMPLES = 100
# Events that are located within one sample; later ones are passed over.
MAX_EVENTS_PER_SAMPLE = 100
# Steps of the smallest length within one sample after which that length grows.
MAX_CRAWLING_STEPS = 64
MAX_STANDSTILL_TRIES = 60
# Of the largest rate so far: below it a site stands still.
STANDSTILL = 1e-11
# Of the rate of standstill. Stages are of low order: small excursions mean nothing.
EXCURSION = 1e5
# Of the load that friction can hold: a step ends before a site exceeds it by more.
MAX_OVERLOAD = 1e-6
FASTEST = 1e100  # m/s, beyond which a run diverges

# Rule of Runge and Kutta: coefficients, weights and nodes; weights of the embedded
# errors of order 3 and 5; number of stages; tolerances of the motion and of the states;
# largest displacement.
Rule = namedtuple("Rule", "a b c e3 e5 stages rtol ztol limit")
# Of every stage the rates, the accelerations, and the power of the input and into the
# sites; inputs and site forces of one stage; inputs in the middle of a path.
Stages = namedtuple("Stages", "v a power row force middle")
# Start, middle and end of one step.
Path = namedtuple("Path", "start half end")
# Largest motions, (displacement, rate), and states so far; work so far; sites whose
# force jumps where the rate changes sign, and sites whose reversals are located; length
# below which no step is shortened; numbers of steps and events.
Progress = namedtuple("Progress", "top z_top energy jumps watched shortest counts")
# Places in Progress.counts.
STEPS = 0
REJECTED = 1
FORCED = 2
EVENTS = 3
CRAWLING = 4


def integrate(
    system: System,
    drive: Drive,
    start: tuple[np.ndarray, np.ndarray, np.ndarray],
    jumps: np.ndarray,
    rule: Rule,
    adaptive: bool,
) -> tuple[Output, Outcome]:
    """Motion from displacements, velocities and states of the laws, by a rule."""
    x, v, z = start
    first = new_instant(system)._replace(x=x, v=v, z=z)
    path = Path(first, new_instant(system), new_instant(system))
    progress = _new_progress(system, jumps)
    has_inertia = system.laws[:, INERTIA].any()
    special = True if progress.watched.any() or has_inertia else None
    out = new_output(system, drive.last + 1)
    why, interval, dof = runge_kutta(
        system,
        drive,
        rule,
        _new_stages(system, drive, rule),
        path,
        progress,
        new_work(system),
        out,
        adaptive,
        drive.dt / 1024,
        special,
    )
    steps = StepCounts(*progress.counts[: FORCED + 1].tolist())
    return out, Outcome(why, interval, dof, steps)


def dormand_prince(rtol: float, limit: float) -> Rule:
    """SciPy's DOP853, of order 8."""
    a, b, c, e3, e5 = _dop853_tables()
    return Rule(a, b, c, e3, e5, len(b), rtol, max(rtol, 1e-8), limit)


def classical(rtol: float, limit: float) -> Rule:
    """The rule of order 4, without an error estimate."""
    a = np.zeros((4, 4))
    a[1, 0] = a[2, 1] = 0.5
    a[3, 2] = 1.0
    b = np.array([1, 2, 2, 1]) / 6
    c = np.array([0, 0.5, 0.5, 1])
    return Rule(a, b, c, np.zeros(4), np.zeros(4), 4, rtol, max(rtol, 1e-8), limit)


@cache
def _dop853_tables() -> tuple[np.ndarray, ...]:
    from scipy.integrate import DOP853

    n = DOP853.n_stages
    tables = DOP853.A[:n, :n], DOP853.B, DOP853.C[:n], DOP853.E3[:n], DOP853.E5[:n]
    return tuple(np.ascontiguousarray(table) for table in tables)


def _new_stages(system: System, drive: Drive, rule: Rule) -> Stages:
    return Stages(
        v=np.zeros((rule.stages, system.n_dof)),
        a=np.zeros((rule.stages, system.n_dof)),
        power=np.zeros((rule.stages, system.n_sites + 1)),
        row=np.zeros(drive.n_inputs),
        force=np.zeros(system.n_sites),
        middle=np.zeros(drive.n_inputs),
    )


def _new_progress(system: System, jumps: np.ndarray) -> Progress:
    return Progress(
        top=np.zeros(2),
        z_top=np.zeros(system.n_states),
        energy=np.zeros(system.n_sites + 1),
        jumps=jumps.astype(np.int64),
        watched=np.where(jumps, 1, system.sites[:, MEMORY]),
        shortest=np.zeros(1),
        counts=np.zeros(CRAWLING + 1, dtype=np.int64),
    )


# -- one trial step ------------------------------------------------------------


@inline
def _sums(stages, weights, count, j, n):
    """Weighted sums of the rates and accelerations of the stages at one DOF."""
    dx = 0.0
    dv = 0.0
    for stage in range(count):
        if weights[stage] != 0.0:
            dx += weights[stage] * stages.v[stage * n + j]
            dv += weights[stage] * stages.a[stage * n + j]
    return dx, dv


@inline
def _combine(stages, weights, count, start, end, h, n):
    """Motion after a length h at the weighted mean of the first stages."""
    for j in range(n):
        dx, dv = _sums(stages, weights, count, j, n)
        end.x[j] = start.x[j] + h * dx
        end.v[j] = start.v[j] + h * dv


@inline
def _error_of_motion(rule, stages, end, top, h, n):
    """Hairer's mix of both embedded errors, over the tolerance."""
    x_top = top[0]
    v_top = top[1]
    for j in range(n):
        x_top = max(x_top, abs(end.x[j]))
        v_top = max(v_top, abs(end.v[j]))

    norm3 = 0.0
    norm5 = 0.0
    for j in range(n):
        x3, v3 = _sums(stages, rule.e3, rule.stages, j, n)
        x5, v5 = _sums(stages, rule.e5, rule.stages, j, n)
        if x_top > 0.0:
            norm3 += (x3 / x_top) ** 2
            norm5 += (x5 / x_top) ** 2
        if v_top > 0.0:
            norm3 += (v3 / v_top) ** 2
            norm5 += (v5 / v_top) ** 2

    if norm5 == 0.0 and norm3 == 0.0:
        return 0.0
    return h * norm5 / (np.sqrt((norm5 + 0.01 * norm3) * 2.0 * n) * rule.rtol)


@inline
def _error_of_states(system, drive, path, middle, z_top, u, interval, done, h, ztol):
    """Difference of the states moved by one step and by two, over the tolerance.

    It is zero for laws that do not depend on how fast the path is run. The states at
    the end are those of two steps.
    """
    start, half, end = path
    for j in range(system.n_dof):
        x0, v0 = start.x[j], start.v[j]
        x1, v1 = end.x[j], end.v[j]
        half.x[j] = 0.5 * (x0 + x1) + 0.125 * h * (v0 - v1)
        half.v[j] = 1.5 * (x1 - x0) / h - 0.25 * (v0 + v1)

    copy_to(half.z, start.z, system.n_states)
    inputs_at(drive, interval, (done + 0.5 * h) / drive.dt, middle)
    advance_states(system, start.x, start.v, end.x, end.v, half.z, h, middle, u)

    copy_to(end.z, start.z, system.n_states)
    inputs_at(drive, interval, (done + 0.25 * h) / drive.dt, middle)
    advance_states(system, start.x, start.v, half.x, half.v, end.z, 0.5 * h, middle, u)
    inputs_at(drive, interval, (done + 0.75 * h) / drive.dt, middle)
    advance_states(system, half.x, half.v, end.x, end.v, end.z, 0.5 * h, middle, u)

    error = 0.0
    for m in range(system.n_states):
        size = max(abs(end.z[m]), z_top[m])
        if size > 0.0:
            # one quotient after the other: a product of tiny sizes would be zero
            gap = abs(end.z[m] - half.z[m]) / size / ztol
            if gap != gap:
                return np.nan
            # the states are of order 2: their error on the scale of order 8
            error = max(error, gap ** (8.0 / 3.0))
    return error


@subroutine
def _try_step(
    system, drive, rule, stages, path, progress, w, interval, done, h, special
):
    """Try a step of length h; returns its error over the tolerance."""
    start, end = path.start, path.end
    n, n_sites = system.n_dof, system.n_sites
    n_stages = rule.stages
    dt, row = drive.dt, stages.row

    for stage in range(n_stages):
        rate = address_of(stages.v, stage * n)
        if stage == 0:
            copy_to(rate, start.v, n)
            copy_to(stages.a, start.a, n)
            copy_to(end.x, start.x, n)
            copy_to(end.v, start.v, n)
            copy_to(stages.force, start.force, n_sites)
            inputs_at(drive, interval, done / dt, row)
        else:
            share = rule.c[stage]
            weights = address_of(rule.a, stage * n_stages)
            _combine(stages, weights, stage, start, end, h, n)
            copy_to(rate, end.v, n)
            inputs_at(drive, interval, (done + share * h) / dt, row)
            if special is not None:
                copy_to(end.z, start.z, system.n_states)
                inputs_at(drive, interval, (done + 0.5 * share * h) / dt, stages.middle)
                advance_states(
                    system,
                    start.x,
                    start.v,
                    end.x,
                    end.v,
                    end.z,
                    share * h,
                    stages.middle,
                    w.u,
                )
            rise = address_of(stages.a, stage * n)
            now = Instant(end.x, end.v, end.z, rise, stages.force)
            accelerate(system, interval * dt + done + share * h, row, now, w, special)

        power = address_of(stages.power, stage * (n_sites + 1))
        power[0] = 0.0
        for j in range(n):
            power[0] += (row[j] - system.masses[j] * row[n]) * end.v[j]
        for i in range(n_sites):
            power[i + 1] = stages.force[i] * relative(end.v, site_at(system, i))

    _combine(stages, rule.b, n_stages, start, end, h, n)
    error = _error_of_motion(rule, stages, end, progress.top, h, n)
    if special is not None:
        of_states = _error_of_states(
            system,
            drive,
            path,
            stages.middle,
            progress.z_top,
            w.u,
            interval,
            done,
            h,
            rule.ztol,
        )
        if of_states != of_states:
            return np.nan
        error = max(error, of_states)
    return error


# -- reversals -----------------------------------------------------------------

NOTHING = 0
REVERSES = 1
TURNS_TWICE = 2


@subroutine
def _first_reversal(system, stages, path, watched, regime, n_stages, v_tol):
    """First watched site that reverses in the step just tried, and how."""
    for i in range(system.n_sites):
        if not watched[i] or regime[i] == STICKS:
            continue
        site = site_at(system, i)
        start = relative(path.start.v, site)
        end = relative(path.end.v, site)
        sign = 0.0
        if regime[i] != FREE:
            sign = float(regime[i])
        elif abs(start) > v_tol:
            sign = np.sign(start)

        if sign != 0.0 and end * sign < -v_tol:
            # from standstill forward and back: nothing to interpolate between yet, the
            # step is too long
            leaves = relative(stages.a, site) * sign > 0.0
            if abs(start) <= v_tol and leaves:
                return i, TURNS_TWICE
            return i, REVERSES

        forward = sign > 0.0 or end > v_tol
        backward = sign < 0.0 or end < -v_tol
        for stage in range(1, n_stages):
            rate = relative(address_of(stages.v, stage * system.n_dof), site)
            forward |= rate > EXCURSION * v_tol
            backward |= rate < -EXCURSION * v_tol
        if forward and backward:
            return i, TURNS_TWICE
    return -1, NOTHING


# -- dry friction --------------------------------------------------------------


@subroutine
def _settle(system, jumps, v_tol, t, row, now, w):
    """Decide which sites at standstill stick and which slip; find the accelerations."""
    regime = w.regime
    for i in range(system.n_sites):
        if jumps[i] and regime[i] != STICKS:
            rate = relative(now.v, site_at(system, i))
            if abs(rate) <= v_tol:
                regime[i] = STICKS
            elif regime[i] == FREE:
                regime[i] = 1 if rate > 0.0 else -1

    for _ in range(system.n_sites + 1):
        accelerate(system, t, row, now, w, True)
        changed = False
        overloaded = -1
        largest_share = 1.0 + 1e-9
        for i in range(system.n_sites):
            if jumps[i] and regime[i] == STICKS:
                if w.jump[i] <= 0.0:
                    rise = relative(now.a, site_at(system, i))
                    regime[i] = 1 if rise > 0.0 else -1
                    changed = True
                elif abs(w.share[i]) > largest_share:
                    overloaded = i
                    largest_share = abs(w.share[i])
        # one at a time: a site that slips relieves the others
        if overloaded >= 0:
            regime[overloaded] = 1 if w.share[overloaded] > 0.0 else -1
            changed = True
        if not changed:
            break


@subroutine
def _overload(system, jumps, w):
    """Sticking site that holds more than it can, and by how much; -1 if none."""
    overloaded = -1
    excess = 1e-9
    for i in range(system.n_sites):
        if jumps[i] and w.regime[i] == STICKS and abs(w.share[i]) - 1.0 > excess:
            overloaded = i
            excess = abs(w.share[i]) - 1.0
    return overloaded, excess


@subroutine
def _overload_inside(system, drive, path, middle, jumps, w, interval, done, h):
    """Largest overload of a sticking site at the eighths of a step.

    A force that bends may exceed what friction holds between both ends.
    """
    start, half, end = path
    largest_excess = 0.0
    any_sticks = False
    for i in range(system.n_sites):
        any_sticks |= jumps[i] != 0 and w.regime[i] == STICKS
    if not any_sticks:
        return largest_excess

    for eighth in range(1, 8):
        q = eighth / 8.0
        for j in range(system.n_dof):  # the cubic between both ends
            v0, v1 = start.v[j], end.v[j]
            gap = end.x[j] - start.x[j]
            bend = h * q * (1.0 - q) * ((1.0 - q) * v0 - q * v1)
            half.x[j] = start.x[j] + q * q * (3.0 - 2.0 * q) * gap + bend
            half.v[j] = 6.0 * q * (1.0 - q) * gap / h
            half.v[j] += (1.0 - q) * (1.0 - 3.0 * q) * v0 + q * (3.0 * q - 2.0) * v1
        inputs_at(drive, interval, (done + q * h) / drive.dt, middle)
        now = Instant(half.x, half.v, end.z, half.a, half.force)
        accelerate(system, interval * drive.dt + done + q * h, middle, now, w, True)
        _, excess = _overload(system, jumps, w)
        largest_excess = max(largest_excess, excess)
    return largest_excess


@inline
def _stop_sticking_sites(system, path, jumps, regime, arrived):
    """A sticking site stands still exactly, not to within round-off."""
    start, end = path.start, path.end
    if arrived >= 0 and jumps[arrived]:
        regime[arrived] = STICKS
    for i in range(system.n_sites):
        if regime[i] == STICKS:
            site = site_at(system, i)
            p, q = site[UPPER], site[LOWER]
            if i != arrived:
                end.x[p] = start.x[p] + (end.x[q] - start.x[q] if q >= 0 else 0.0)
            end.v[p] = end.v[q] if q >= 0 else 0.0


# -- a run ---------------------------------------------------------------------


@inline
def _set_scales_of_motion(system, drive, start, top):
    """Motions too small to matter: below them errors are absolute.

    Otherwise round-off would rule the first steps.
    """
    n = system.n_dof
    strongest = 0.0
    for sample in range(drive.last + 1):
        row = address_of(drive.samples, sample * drive.n_inputs)
        strongest = max(strongest, abs(row[n]))
        for j in range(n):
            strongest = max(strongest, abs(row[j]) / system.masses[j])
    top[1] = 1e-4 * drive.dt * strongest
    top[0] = drive.dt * top[1]
    for j in range(n):
        top[0] = max(top[0], abs(start.x[j]))
        top[1] = max(top[1], abs(start.v[j]))


# A bracket is (low, rate there, high, rate there): lengths of a step, at whose ends the
# rate of a site has different signs.


@inline
def _secant(bracket):
    """Length at which the straight line through both ends of a bracket is zero."""
    low, v_low, high, v_high = bracket
    return (low * v_high - high * v_low) / (v_high - v_low)


@inline
def _narrowed(bracket, h, rate):
    """The bracket with one end at h, by the Illinois rule."""
    low, v_low, high, v_high = bracket
    if (rate > 0.0) == (v_high > 0.0):
        return low, 0.5 * v_low, h, rate
    return h, rate, high, 0.5 * v_high


@inline
def _shortened(h, error, progress):
    """A shorter step for a smaller error; the same if it must not be shortened."""
    counts, shortest = progress.counts, progress.shortest
    counts[REJECTED] += 1
    if h <= shortest[0]:
        counts[FORCED] += 1
        counts[CRAWLING] += 1
        # it slides along a jump that is not at zero rate
        if counts[CRAWLING] == MAX_CRAWLING_STEPS:
            shortest[0] *= 8.0
        return h
    shrink = 0.1
    if error < 1e300:
        shrink = 0.9 * error ** (-0.125)
    return max(h * min(max(shrink, 0.1), 0.9), shortest[0])


@inline
def _find_step(
    system,
    drive,
    rule,
    stages,
    path,
    progress,
    w,
    interval,
    done,
    h,
    v_tol,
    adaptive,
    special,
):
    """Shorten a step until it is exact enough and no site reverses inside it.

    Returns its length, its error, and the site that comes to a standstill, or starts to
    slip, at its end; -1 if none does.
    """
    start, end = path.start, path.end
    counts, shortest = progress.counts, progress.shortest
    arrived = -1
    tries = 0  # left to find the instant of a standstill
    bracket = 0.0, 0.0, 0.0, 0.0
    while True:
        error = _try_step(
            system, drive, rule, stages, path, progress, w, interval, done, h, special
        )

        if special is not None and tries > 0:
            tries -= 1
            rate = relative(end.v, site_at(system, arrived))
            width = bracket[2] - bracket[0]
            is_found = abs(rate) <= v_tol or width < 1e-14 * drive.dt
            if tries > 0 and error == error and not is_found:
                bracket = _narrowed(bracket, h, rate)
                h = _secant(bracket)
                continue
            tries = 0

        if special is not None and error == error:
            if counts[EVENTS] < MAX_EVENTS_PER_SAMPLE:
                i, kind = _first_reversal(
                    system, stages, path, progress.watched, w.regime, rule.stages, v_tol
                )
                if kind == TURNS_TWICE and h > shortest[0]:
                    h = max(0.5 * h, shortest[0])
                    arrived = -1
                    continue
                if kind == REVERSES:
                    counts[EVENTS] += 1
                    arrived = i
                    v_start = relative(start.v, site_at(system, i))
                    v_end = relative(end.v, site_at(system, i))
                    bracket = 0.0, v_start, h, v_end
                    if v_start * v_end < 0.0:
                        tries = MAX_STANDSTILL_TRIES
                        h = _secant(bracket)
                    else:
                        # it slips, and starts from standstill in the wrong direction
                        h = 1e-9 * drive.dt
                    continue

        if not adaptive or error <= 1.0:
            return h, error, arrived
        shorter = _shortened(h, error, progress)
        if shorter == h:
            return h, error, arrived
        h = shorter
        arrived = -1


@inline
def _diverged_dof(end, error, limit, n):
    """DOF whose motion is not finite, or too large; -1 if none."""
    for j in range(n):
        is_small = abs(end.x[j]) < limit and abs(end.v[j]) < FASTEST
        if error != error or not is_small:
            return j
    return -1


@inline
def _balance_at_end(
    system, drive, path, stages, progress, w, interval, done, h, arrived, v_tol
):
    """Balance at the end of a step; False if a site starts to slip inside it."""
    row, jumps = stages.row, progress.jumps
    end = path.end
    t = interval * drive.dt + done + h
    _stop_sticking_sites(system, path, jumps, w.regime, arrived)
    if arrived >= 0:
        _settle(system, jumps, v_tol, t, row, end, w)
        return True

    may_shorten = h > progress.shortest[0]
    inside = 0.0
    if drive.order > 1 and may_shorten:
        inside = _overload_inside(
            system, drive, path, stages.middle, jumps, w, interval, done, h
        )
    accelerate(system, t, row, end, w, True)
    overloaded, excess = _overload(system, jumps, w)
    may_shorten &= progress.counts[EVENTS] < MAX_EVENTS_PER_SAMPLE
    if max(excess, inside) > MAX_OVERLOAD and may_shorten:
        return False
    if overloaded >= 0:
        _settle(system, jumps, v_tol, t, row, end, w)
    return True


@inline
def _accept(system, rule, stages, path, progress, h):
    """Add the work of a step, and go to its end."""
    start, end = path.start, path.end
    top = progress.top
    n_works = system.n_sites + 1
    for m in range(n_works):
        mean_power = 0.0
        for stage in range(rule.stages):
            mean_power += rule.b[stage] * stages.power[stage * n_works + m]
        progress.energy[m] += h * mean_power

    for j in range(system.n_dof):
        start.x[j] = end.x[j]
        start.v[j] = end.v[j]
        start.a[j] = end.a[j]
        top[0] = max(top[0], abs(end.x[j]))
        top[1] = max(top[1], abs(end.v[j]))
    for m in range(system.n_states):
        start.z[m] = end.z[m]
        progress.z_top[m] = max(progress.z_top[m], abs(end.z[m]))
    copy_to(start.force, end.force, system.n_sites)


@jit
def runge_kutta(
    system, drive, rule, stages, path, progress, w, out, adaptive, smallest, special
):
    """March a system over its samples; returns why it ends, at which interval and DOF.

    ``special`` is None if no site has memory, dry friction or inertia.
    """
    system, drive, rule, stages, path, progress, w, out = addresses(
        (system, drive, rule, stages, path, progress, w, out)
    )
    start, end = path.start, path.end
    row, jumps = stages.row, progress.jumps
    counts, shortest = progress.counts, progress.shortest
    dt, last = drive.dt, drive.last
    proposal = dt

    _set_scales_of_motion(system, drive, start, progress.top)
    for interval in range(last + 1):
        # the balance at a sample
        v_tol = STANDSTILL * progress.top[1]
        t = interval * dt
        copy_to(
            row, address_of(drive.samples, interval * drive.n_inputs), drive.n_inputs
        )
        if special is not None:
            _settle(system, jumps, v_tol, t, row, start, w)
        else:
            accelerate(system, t, row, start, w, special)
        record_sample(system, out, interval, start, row[system.n_dof], progress.energy)
        if interval == last:
            break

        counts[EVENTS] = 0
        counts[CRAWLING] = 0
        shortest[0] = smallest
        done = 0.0
        while done < dt:
            wanted = min(proposal, dt - done)
            if dt - done - wanted < 1e-9 * dt:
                wanted = dt - done
            h, error, arrived = _find_step(
                system,
                drive,
                rule,
                stages,
                path,
                progress,
                w,
                interval,
                done,
                wanted,
                v_tol,
                adaptive,
                special,
            )
            counts[STEPS] += 1
            tried = counts[STEPS] + counts[REJECTED]
            if tried > PATIENCE * (interval + FIRST_SAMPLES):
                return CRAWLS, interval, 0
            dof = _diverged_dof(end, error, rule.limit, system.n_dof)
            if dof >= 0:
                return DIVERGED, interval, dof

            inputs_at(drive, interval, (done + h) / dt, row)
            if special is None:
                accelerate(system, t + done + h, row, end, w, special)
            elif not _balance_at_end(
                system,
                drive,
                path,
                stages,
                progress,
                w,
                interval,
                done,
                h,
                arrived,
                v_tol,
            ):
                # come closer to the instant at which a site starts to slip
                counts[EVENTS] += 1
                counts[REJECTED] += 1
                counts[STEPS] -= 1
                proposal = max(0.5 * h, shortest[0])
                continue
            _accept(system, rule, stages, path, progress, h)
            done = dt if h == dt - done else done + h

            # the length of the next step
            proposal = dt
            if adaptive:
                growth = 10.0
                if error >= 1e-9:
                    growth = min(0.9 * error ** (-0.125), 10.0)
                least = wanted if arrived >= 0 else shortest[0]
                proposal = min(max(h * max(growth, 0.1), least), dt)

    return DONE, last, 0
