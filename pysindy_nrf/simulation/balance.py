"""Compiled force balance of a flat chain model at one instant.

All arrays are pointers here; rows of matrices lie behind each other. ``special`` is
None for a model without memory, dry friction and inertia of laws: the code for these is
then left out when the functions are compiled.
"""

from collections import namedtuple

import numpy as np

from ..common.compiled import address_of, inline, subroutine
from ..laws.callbacks import call_advance, call_kernel
from .system import (
    ADVANCE,
    CONSTANT,
    FIRST,
    INERTIA,
    INPUT,
    KERNEL,
    LAST,
    LAW_COLUMNS,
    LOWER,
    MEMORY,
    N_INPUTS,
    N_STATES,
    N_TERMS,
    N_THETA,
    ON_DOF,
    SITE_COLUMNS,
    STATE,
    TERM,
    THETA,
    UPPER,
    System,
)

# Regimes of a site: it sticks; it slips one way, 1 or -1; its force has no jump.
STICKS = 0
FREE = 2
CREEP = 1e-300  # m/s, a rate that has a sign and nothing else
# Sticking links in a loop share their load: without this their matrix is singular.
SOFTENING = 1e-12

# What drives a run: coefficients (order + 1, last, n_inputs) of each interval, see
# inputs_at; samples (last + 1, n_inputs) of the forces, the acceleration of the base,
# the covariates and the courses of coefficients.
Drive = namedtuple("Drive", "courses samples order last n_inputs dt")
# At one instant: displacements and velocities relative to the base, states of the laws,
# accelerations relative to the base, forces of the sites.
Instant = namedtuple("Instant", "x v z a force")
# A row for each sample: relative displacement, velocity; absolute acceleration; states;
# work of the input and into the sites.
Output = namedtuple("Output", "x v a z work")
# Arrays of one balance: terms and covariates of one law; mass of every DOF; inertia of
# every site; mass matrix; of sticking sites the accelerations by unit load, the matrix
# and the loads; of every site the jump of its friction and the share that holds it;
# numbers of the sticking sites; regimes.
Work = namedtuple(
    "Work", "out u mass inertia matrix column hold load jump share stuck regime"
)


def new_instant(system: System) -> Instant:
    """Arrays for one instant."""
    n = system.n_dof
    return Instant(
        x=np.zeros(n),
        v=np.zeros(n),
        z=np.zeros(system.n_states),
        a=np.zeros(n),
        force=np.zeros(system.n_sites),
    )


def new_output(system: System, n_samples: int) -> Output:
    """Arrays for the result of a run."""
    n = system.n_dof
    return Output(
        x=np.empty((n_samples, n)),
        v=np.empty((n_samples, n)),
        a=np.empty((n_samples, n)),
        z=np.empty((n_samples, system.n_states)),
        work=np.empty((n_samples, system.n_sites + 1)),
    )


def new_work(system: System) -> Work:
    """Arrays for the balances of a system."""
    n, n_sites = system.n_dof, system.n_sites
    widest = int(system.laws[:, [N_TERMS, N_INPUTS]].max(initial=1))
    return Work(
        out=np.zeros(widest),
        u=np.zeros(widest),
        mass=np.zeros(n),
        inertia=np.zeros(n_sites),
        matrix=np.zeros((n, n)),
        column=np.zeros((n_sites, n)),
        hold=np.zeros((n_sites, n_sites)),
        load=np.zeros(n_sites),
        jump=np.zeros(n_sites),
        share=np.zeros(n_sites),
        stuck=np.zeros(n_sites, dtype=np.int64),
        regime=np.full(n_sites, FREE, dtype=np.int64),
    )


# -- small helpers -------------------------------------------------------------


@inline
def copy_to(target, values, n):
    for i in range(n):
        target[i] = values[i]


@inline
def site_at(system, i):
    """Row of a site."""
    return address_of(system.sites, i * SITE_COLUMNS)


@inline
def relative(y, site):
    """Motion of the upper end of a site relative to its lower end."""
    return y[site[UPPER]] - (y[site[LOWER]] if site[LOWER] >= 0 else 0.0)


@subroutine
def inputs_at(drive, interval, x, row):
    """Forces, base acceleration and covariates at a share x of an interval."""
    page = drive.last * drive.n_inputs
    start = interval * drive.n_inputs
    for j in range(start, start + drive.n_inputs):
        value = drive.courses[drive.order * page + j]
        for power in range(drive.order - 1, -1, -1):
            value = value * x + drive.courses[power * page + j]
        row[j - start] = value


@inline
def add_between(matrix, p, q, n, value):
    """Add a stiffness or mass between two DOFs, or a DOF and the base."""
    matrix[p * n + p] += value
    if q >= 0:
        matrix[q * n + q] += value
        matrix[p * n + q] -= value
        matrix[q * n + p] -= value


@subroutine
def solve(matrix, vector, n):
    """Solve a small dense system in place; the answer replaces the right-hand side."""
    for k in range(n):
        best = k
        row = address_of(matrix, k * n)
        for i in range(k + 1, n):
            if abs(matrix[i * n + k]) > abs(matrix[best * n + k]):
                best = i
        if best != k:
            pivot = address_of(matrix, best * n)
            for j in range(n):
                row[j], pivot[j] = pivot[j], row[j]
            vector[k], vector[best] = vector[best], vector[k]

        for i in range(k + 1, n):
            below = address_of(matrix, i * n)
            if below[k] != 0.0:
                factor = below[k] / row[k]
                for j in range(k + 1, n):
                    below[j] -= factor * row[j]
                vector[i] -= factor * vector[k]

    for k in range(n - 1, -1, -1):
        row = address_of(matrix, k * n)
        for j in range(k + 1, n):
            vector[k] -= row[j] * vector[j]
        vector[k] /= row[k]


@subroutine
def record_sample(system, out, sample, now, base, energy):
    """Write the motion and states at a sample, and the work up to it."""
    n, n_states = system.n_dof, system.n_states
    n_works = system.n_sites + 1
    copy_to(address_of(out.x, sample * n), now.x, n)
    copy_to(address_of(out.v, sample * n), now.v, n)
    for j in range(n):
        out.a[sample * n + j] = now.a[j] + base
    copy_to(address_of(out.z, sample * n_states), now.z, n_states)
    copy_to(address_of(out.work, sample * n_works), energy, n_works)


# -- laws ----------------------------------------------------------------------


@inline
def _law_force(system, law, s, v, a, t, row, z, u, out):
    """Force of one law."""
    n_inputs, n_terms = law[N_INPUTS], law[N_TERMS]
    for k in range(n_inputs):
        u[k] = row[system.channels[law[INPUT] + k]]

    motion = s, v, a, system.t0 + t
    covariates = u, n_inputs
    states = address_of(z, law[STATE]), law[N_STATES]
    theta = address_of(system.theta, law[THETA]), law[N_THETA]
    call_kernel(law[KERNEL], (*motion, *covariates, *states, *theta, out, n_terms))

    force = 0.0
    for k in range(n_terms):
        coefficient = system.coefficients[law[TERM] + k]
        followed = system.followed[law[TERM] + k]
        if followed != CONSTANT:
            coefficient = row[followed]
        force += coefficient * out[k]
    return force


@subroutine
def site_force(system, site, s, v, t, row, z, u, out, special):
    """Force of all laws of a site: without acceleration, and the factor of it.

    Covariates and terms of one law after the other are written into u and out.
    """
    force = 0.0
    inertia = 0.0
    for k in range(site[FIRST], site[LAST]):
        law = address_of(system.laws, k * LAW_COLUMNS)
        at_rest = _law_force(system, law, s, v, 0.0, t, row, z, u, out)
        force += at_rest
        if special is not None and law[INERTIA]:
            inertia += _law_force(system, law, s, v, 1.0, t, row, z, u, out) - at_rest
    return force, inertia


@inline
def advance_site(system, site, s0, r0, s1, r1, z, dt, middle, u):
    """Move the states of the laws of one site along a path without reversal."""
    for k in range(site[FIRST], site[LAST]):
        law = address_of(system.laws, k * LAW_COLUMNS)
        if law[N_STATES]:
            for j in range(law[N_INPUTS]):
                u[j] = middle[system.channels[law[INPUT] + j]]
            states = address_of(z, law[STATE]), law[N_STATES]
            covariates = u, law[N_INPUTS]
            theta = address_of(system.theta, law[THETA]), law[N_THETA]
            call_advance(
                law[ADVANCE], (*states, s0, r0, s1, r1, dt, *covariates, *theta)
            )


@subroutine
def advance_states(system, x0, v0, x1, v1, z, dt, middle, u):
    """Move the states of all laws over a step without a reversal at their sites."""
    for i in range(system.n_sites):
        site = site_at(system, i)
        if site[MEMORY]:
            s0, r0 = relative(x0, site), relative(v0, site)
            s1, r1 = relative(x1, site), relative(v1, site)
            advance_site(system, site, s0, r0, s1, r1, z, dt, middle, u)


# -- accelerations -------------------------------------------------------------


@subroutine
def accelerate(system, t, row, now, w, special):
    """Accelerations of the DOFs and forces of the sites, from motion and states."""
    n = system.n_dof
    a, force = now.a, now.force
    base = row[n]
    for j in range(n):
        a[j] = row[j] - system.masses[j] * base
        w.mass[j] = system.masses[j]

    n_stuck = np.int64(0)  # not a literal, for which more would be compiled
    for i in range(system.n_sites):
        site = site_at(system, i)
        s, rate = relative(now.x, site), relative(now.v, site)
        if special is not None and w.regime[i] == STICKS:
            # the mean of both directions, and half their difference
            forward, _ = site_force(
                system, site, s, CREEP, t, row, now.z, w.u, w.out, special
            )
            backward, inertia = site_force(
                system, site, s, -CREEP, t, row, now.z, w.u, w.out, special
            )
            force[i] = 0.5 * (forward + backward)
            w.jump[i] = 0.5 * (forward - backward)
            w.share[i] = 0.0
            if w.jump[i] > 0.0:
                w.stuck[n_stuck] = i
                n_stuck += 1
        else:
            if special is not None:
                rate = _slipping_rate(rate, w.regime[i])
            force[i], inertia = site_force(
                system, site, s, rate, t, row, now.z, w.u, w.out, special
            )

        p, q = site[UPPER], site[LOWER]
        a[p] -= force[i]
        if q >= 0:
            a[q] += force[i]
        w.inertia[i] = inertia
        if special is not None and site[ON_DOF] and inertia != 0.0:
            w.mass[p] += inertia
            a[p] -= inertia * base

    if special is None:
        for j in range(n):
            a[j] /= system.masses[j]
        return

    _divide_by_masses(system, w, a)
    if n_stuck:
        _hold_sticking_sites(system, w, n_stuck, a, force)
    for i in range(system.n_sites):
        if w.inertia[i] != 0.0:
            site = site_at(system, i)
            absolute = relative(a, site) + (base if site[ON_DOF] else 0.0)
            force[i] += w.inertia[i] * absolute


@inline
def _slipping_rate(rate, regime):
    """The rate with the sign of the direction in which a site slips."""
    if regime != FREE and rate * regime < CREEP:
        return regime * CREEP
    return rate


@subroutine
def _divide_by_masses(system, w, vector):
    """Accelerations from forces, with the mass matrix of this instant."""
    n = system.n_dof
    if not system.link_inertia:
        for j in range(n):
            vector[j] /= w.mass[j]
        return

    for j in range(n):
        for k in range(n):
            w.matrix[j * n + k] = w.mass[j] if j == k else 0.0
    for i in range(system.n_sites):
        site = site_at(system, i)
        if w.inertia[i] != 0.0 and not site[ON_DOF]:
            add_between(w.matrix, site[UPPER], site[LOWER], n, w.inertia[i])
    solve(w.matrix, vector, n)


@subroutine
def _hold_sticking_sites(system, w, n_stuck, a, force):
    """Forces that keep each sticking site from accelerating (Filippov 1988).

    A share of the jump of each site is added to its force. A share beyond 1 is more
    than its friction can hold.
    """
    n = system.n_dof
    for k in range(n_stuck):
        i = w.stuck[k]
        site = site_at(system, i)
        column = address_of(w.column, k * n)
        for j in range(n):
            column[j] = 0.0
        column[site[UPPER]] = w.jump[i]
        if site[LOWER] >= 0:
            column[site[LOWER]] = -w.jump[i]
        _divide_by_masses(system, w, column)

    for m in range(n_stuck):
        site = site_at(system, w.stuck[m])
        row = address_of(w.hold, m * n_stuck)
        for k in range(n_stuck):
            row[k] = relative(address_of(w.column, k * n), site)
        if n_stuck > 1:
            row[m] *= 1.0 + SOFTENING
        w.load[m] = relative(a, site)
    solve(w.hold, w.load, n_stuck)

    for k in range(n_stuck):
        i = w.stuck[k]
        w.share[i] = w.load[k]
        force[i] += w.load[k] * w.jump[i]
        for j in range(n):
            a[j] -= w.load[k] * w.column[k * n + j]
