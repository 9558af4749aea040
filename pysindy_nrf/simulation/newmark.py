"""The paper's Newmark-beta integration: average acceleration, one step a sample.

Each step solves the balance at its end for the accelerations there, by Newton's method
with the tangent of every site.
"""

from collections import namedtuple

import numpy as np

from ..common.compiled import address_of, addresses, inline, jit, subroutine
from .balance import (
    Drive,
    Instant,
    Output,
    accelerate,
    add_between,
    advance_site,
    copy_to,
    new_instant,
    new_output,
    new_work,
    record_sample,
    relative,
    site_at,
    site_force,
    solve,
)
from .outcome import DIVERGED, DONE, Outcome, StepCounts
from .system import LOWER, MEMORY, ON_DOF, UPPER, System

MAX_ITERATIONS = 40
# Iterations after which only half of each correction is taken: it may alternate between
# both sides of a kink.
FULL_CORRECTIONS = 15
# Of the largest acceleration so far.
TOLERANCE = 1e-13
NUDGE = 1e-6  # for the tangent of a site
LARGEST = 1e100  # m or m/s^2, beyond which a run diverges

# Accelerations that balance the forces of a trial; tangents of the site forces by their
# acceleration; Newton's correction; inputs in the middle of the step; work so far.
Trial = namedtuple("Trial", "balanced tangent correction middle energy")


def integrate(
    system: System, drive: Drive, start: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> tuple[Output, Outcome]:
    """Motion from displacements, velocities and states of the laws."""
    x, v, z = start
    trial = Trial(
        balanced=np.zeros(system.n_dof),
        tangent=np.zeros(system.n_sites),
        correction=np.zeros(system.n_dof),
        middle=np.zeros(drive.n_inputs),
        energy=np.zeros(system.n_sites + 1),
    )
    out = new_output(system, drive.last + 1)
    why, interval, dof, iterations, forced = newmark(
        system,
        drive,
        new_instant(system)._replace(x=x, v=v, z=z),
        new_instant(system),
        trial,
        new_work(system),
        out,
    )
    return out, Outcome(why, interval, dof, StepCounts(interval, iterations, forced))


@subroutine
def _move_site(system, site, start, s1, r1, z, dt, middle, u):
    """Move the states of a site over the step, cut where its linear rate is zero."""
    s0, r0 = relative(start.x, site), relative(start.v, site)
    if r0 * r1 < 0.0:
        until = dt * r0 / (r0 - r1)
        s_turn = s0 + 0.5 * r0 * until
        advance_site(system, site, s0, r0, s_turn, 0.0, z, until, middle, u)
        advance_site(system, site, s_turn, 0.0, s1, r1, z, dt - until, middle, u)
    else:
        advance_site(system, site, s0, r0, s1, r1, z, dt, middle, u)


@subroutine
def _move_states(system, start, end, z, dt, middle, u):
    """Move the states of all sites with memory over the step."""
    for i in range(system.n_sites):
        site = site_at(system, i)
        if site[MEMORY]:
            s1, r1 = relative(end.x, site), relative(end.v, site)
            _move_site(system, site, start, s1, r1, z, dt, middle, u)


@subroutine
def _end_force(system, site, start, end, t, row, nudge, dt, middle, w):
    """Force of a site at the end if its relative acceleration is larger by a nudge."""
    s1 = relative(end.x, site) + 0.25 * dt * dt * nudge
    r1 = relative(end.v, site) + 0.5 * dt * nudge
    if site[MEMORY]:
        copy_to(end.z, start.z, system.n_states)
        _move_site(system, site, start, s1, r1, end.z, dt, middle, w.u)
    force, _ = site_force(system, site, s1, r1, t, row, end.z, w.u, w.out, True)
    return force


@inline
def _set_end(start, end, dt, n):
    """Displacements and rates at the end from the accelerations at both ends."""
    for j in range(n):
        both = start.a[j] + end.a[j]
        end.x[j] = start.x[j] + dt * start.v[j] + 0.25 * dt * dt * both
        end.v[j] = start.v[j] + 0.5 * dt * both


@inline
def _solve_for_correction(system, end, trial, w):
    """Newton's correction of the accelerations at the end."""
    n = system.n_dof
    for j in range(n):
        for k in range(n):
            w.matrix[j * n + k] = w.mass[j] if j == k else 0.0
        trial.correction[j] = w.mass[j] * (trial.balanced[j] - end.a[j])

    for i in range(system.n_sites):
        site = site_at(system, i)
        p, q = site[UPPER], site[LOWER]
        inertia = 0.0 if site[ON_DOF] else w.inertia[i]
        gap = relative(trial.balanced, site) - relative(end.a, site)
        add_between(w.matrix, p, q, n, trial.tangent[i] + inertia)
        trial.correction[p] += inertia * gap
        if q >= 0:
            trial.correction[q] -= inertia * gap
    solve(w.matrix, trial.correction, n)


@inline
def _diverged_dof(end, n):
    """DOF whose motion is not finite, or too large; -1 if none."""
    for j in range(n):
        if not (abs(end.a[j]) < LARGEST and abs(end.x[j]) < LARGEST):
            return j
    return -1


@inline
def _accept(system, start, end, before, after, energy, dt):
    """Add the work of the step by the trapezoidal rule, and go to its end."""
    n = system.n_dof
    for j in range(n):
        load0 = before[j] - system.masses[j] * before[n]
        load1 = after[j] - system.masses[j] * after[n]
        energy[0] += 0.5 * dt * (load0 * start.v[j] + load1 * end.v[j])
    for i in range(system.n_sites):
        site = site_at(system, i)
        power0 = start.force[i] * relative(start.v, site)
        power1 = end.force[i] * relative(end.v, site)
        energy[i + 1] += 0.5 * dt * (power0 + power1)
        start.force[i] = end.force[i]
    for j in range(n):
        start.x[j] = end.x[j]
        start.v[j] = end.v[j]
        start.a[j] = end.a[j]


@jit
def newmark(system, drive, start, end, trial, w, out):
    """March a system over its samples.

    Returns why it ends, at which interval and DOF, and the numbers of iterations and of
    steps that have not converged.
    """
    system, drive, start, end, trial, w, out = addresses(
        (system, drive, start, end, trial, w, out)
    )
    n, dt = system.n_dof, drive.dt
    middle = trial.middle
    iterations = 0
    forced = 0
    largest_acceleration = 1e-12

    accelerate(system, 0.0, drive.samples, start, w, True)
    for interval in range(drive.last + 1):
        for j in range(n):
            largest_acceleration = max(largest_acceleration, abs(start.a[j]))
        row = address_of(drive.samples, interval * drive.n_inputs)
        record_sample(system, out, interval, start, row[n], trial.energy)
        if interval == drive.last:
            break

        next_row = address_of(row, drive.n_inputs)
        t = (interval + 1) * dt
        for j in range(drive.n_inputs):
            middle[j] = 0.5 * (row[j] + next_row[j])

        copy_to(end.a, start.a, n)
        for iteration in range(MAX_ITERATIONS):
            _set_end(start, end, dt, n)
            nudge = NUDGE * largest_acceleration
            for i in range(system.n_sites):
                site = site_at(system, i)
                force = _end_force(
                    system, site, start, end, t, next_row, 0.0, dt, middle, w
                )
                nudged = _end_force(
                    system, site, start, end, t, next_row, nudge, dt, middle, w
                )
                trial.tangent[i] = (nudged - force) / nudge

            copy_to(end.z, start.z, system.n_states)
            _move_states(system, start, end, end.z, dt, middle, w.u)
            now = Instant(end.x, end.v, end.z, trial.balanced, end.force)
            accelerate(system, t, next_row, now, w, True)
            _solve_for_correction(system, end, trial, w)

            share = 1.0 if iteration < FULL_CORRECTIONS else 0.5
            largest = 0.0
            for j in range(n):
                end.a[j] += share * trial.correction[j]
                largest = max(largest, abs(trial.correction[j]))
            dof = _diverged_dof(end, n)
            if dof >= 0:
                return DIVERGED, interval, dof, iterations, forced
            if largest <= TOLERANCE * largest_acceleration:
                break
            iterations += 1
        else:
            forced += 1

        # the accepted end, its states and the accelerations that balance it
        _set_end(start, end, dt, n)
        _move_states(system, start, end, start.z, dt, middle, w.u)
        now = Instant(end.x, end.v, start.z, end.a, end.force)
        accelerate(system, t, next_row, now, w, True)
        _accept(system, start, end, row, next_row, trial.energy, dt)

    return DONE, drive.last, 0, iterations, forced
