"""A chain model as flat arrays and compiled callbacks, and its force balance at one
instant.
"""

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np

from ..common.compiled import address_of, inline, part
from ..exceptions import LawError, SimulationError
from ..laws.callbacks import call_advance, call_kernel, callbacks_of
from ..laws.forcing import lost_masses
from ..laws.friction import jump_at_reversal

# columns of System.laws
(
    KERNEL,
    ADVANCE,
    TERM,
    N_TERMS,
    STATE,
    N_STATES,
    THETA,
    N_THETA,
    INPUT,
    N_INPUTS,
    INERTIA,
) = range(11)
# columns of System.sites
UPPER, LOWER, FIRST, LAST, ON_DOF, MEMORY = range(6)
SITE, LAW = 6, 11  # numbers of columns


# A chain model as flat arrays. Columns of sites and laws as above, DOFs from 0, -1 is
# the base; coefficients and shape parameters of all laws, one after the other; input
# columns of their covariates; whether the mass matrix is not diagonal; time of the
# first sample on the clock of the laws, s
System = namedtuple(
    "System",
    "masses sites laws coefficients theta channels link_inertia t0 n_dof n_sites"
    " n_states",
)


class Layout(NamedTuple):
    """The sites, states and covariates that the parts of a :class:`System` belong
    to.
    """

    sites: tuple
    # slice of the state vector by (site, number of the law there), for laws with memory
    states: dict
    covariates: tuple[str, ...]  # in the order of the input columns
    keep: list  # callbacks that must live as long as their addresses are used


def flatten(model: Any, t0: float = 0.0) -> tuple[System, Layout]:
    """A chain model as flat arrays."""
    masses = np.array(model.masses, dtype=float)
    bad = np.flatnonzero(~(np.isfinite(masses) & (masses > 0)))
    if bad.size:
        cure = (
            "Weigh that floor and give its mass in known_masses=, or excite the chain"
            " better."
        )
        raise SimulationError(
            f"m{bad[0] + 1} = {masses[bad[0]]:.4g} kg; a free run needs positive"
            " masses",
            cure,
        )
    groups = {
        site: group
        for site, group in model.laws.items()
        if site.kind != "sensor" and group
    }
    missing = [
        (law, site)
        for site, group in groups.items()
        for law in group
        if law.coefficients is None
    ]
    if missing:
        law, site = missing[0]
        raise LawError(
            f"{type(law).__name__} at {site} has no coefficients",
            "Fit the model, or give them.",
        )
    if lost := lost_masses(masses, groups):
        cure = (
            "Weigh that floor and give its mass in known_masses=, or leave the added"
            " mass out."
        )
        raise SimulationError(f"{lost[0]}; a free run needs positive masses", cure)
    names = tuple(
        dict.fromkeys(
            name
            for group in groups.values()
            for law in group
            for name in law.covariates
        )
    )
    n = len(masses)
    lists: list[list[Any]] = [[] for _ in range(6)]
    sites, rows, coefficients, theta, channels, keep = lists
    states, n_states, link_inertia = {}, 0, False
    for site, group in groups.items():
        first = len(rows)
        for number, law in enumerate(group):
            kernel, advance = callbacks_of(law)
            keep += [kernel, advance]
            values = law.theta
            rows.append(
                (
                    kernel.address,
                    advance.address,
                    len(coefficients),
                    len(law.coefficients),
                    n_states,
                    law.n_states,
                    len(theta),
                    len(values),
                    len(channels),
                    len(law.covariates),
                    law.uses_acceleration,
                )
            )
            coefficients += list(law.coefficients)
            theta += list(values)
            channels += [n + 1 + names.index(name) for name in law.covariates]
            if law.n_states:
                states[site, number] = slice(n_states, n_states + law.n_states)
            n_states += law.n_states
            link_inertia |= law.uses_acceleration and site.kind != "dof"
        memory = any(law.n_states for law in group)
        lower = site.q - 1 if site.kind == "link" else -1
        sites.append((site.p - 1, lower, first, len(rows), site.kind == "dof", memory))
    system = System(
        masses,
        np.array(sites, dtype=np.int64).reshape(-1, 6),
        np.array(rows, dtype=np.int64).reshape(-1, 11),
        np.array(coefficients, dtype=float),
        np.array(theta, dtype=float),
        np.array(channels, dtype=np.int64),
        bool(link_inertia),
        float(t0),
        n,
        len(sites),
        n_states,
    )
    return system, Layout(tuple(groups), states, names, keep)


Work = namedtuple(
    "Work", "out u mass inertia matrix column hold load jump share stuck regime"
)  # one balance


def work_arrays(system: System) -> Work:
    """Preallocated arrays for a system."""
    n, n_sites = len(system.masses), len(system.sites)
    widest = int(system.laws[:, [N_TERMS, N_INPUTS]].max(initial=1))
    shapes: Any = (
        widest,
        widest,
        n,
        n_sites,
        (n, n),
        (n_sites, n),
        (n_sites, n_sites),
        n_sites,
        n_sites,
        n_sites,
    )
    stuck, regime = (
        np.zeros(n_sites, dtype=np.int64),
        np.full(n_sites, FREE, dtype=np.int64),
    )
    return Work._make([*(np.zeros(shape) for shape in shapes), stuck, regime])


def jumps(model: Any, layout: Layout, largest: np.ndarray) -> np.ndarray:
    """Sites whose force jumps where the rate changes sign, as Coulomb friction does."""
    found = []
    for site in layout.sites:
        near = wide = 0.0
        for law in model.laws[site]:
            sizes = [largest[layout.covariates.index(n)] for n in law.covariates]
            change = law.coefficients @ jump_at_reversal(law, sizes)
            near, wide = near + abs(change[0]), wide + abs(change[1])
        found.append(near > 0.5 * wide > 0)
    return np.array(found, dtype=bool)


# One Runge-Kutta step: by stage rates, accelerations and power of the input and into
# the sites; inputs; forces of the stage and at the start; the middle; states by one
# step; largest states, and displacement and velocity, so far; work; at the start and at
# the end; sites whose force jumps where the rate changes sign, and whose reversals are
# located
Stages = namedtuple(
    "Stages",
    "v a power row middle force force0 x_half v_half z_once z_top top work a0 x1 v1 a1"
    " z1 force1 jump watch",
)


def stages(n_stages: int, system: System, n_inputs: int, jump: np.ndarray) -> Stages:
    """Preallocated arrays for the steps of a rule."""
    n, m, n_states = system.n_dof, system.n_sites, system.n_states
    shapes: Any = (
        (n_stages, n),
        (n_stages, n),
        (n_stages, m + 1),
        n_inputs,
        n_inputs,
        m,
        m,
        n,
        n,
        n_states,
        n_states,
    )
    more = (2, m + 1, n, n, n, n, n_states, m)
    kinds = jump.astype(np.int64), np.where(jump, 1, system.sites[:, MEMORY])
    return Stages._make([*(np.zeros(shape) for shape in (*shapes, *more)), *kinds])


# Courses (order + 1, last, n_inputs), see inputs_at, and samples (last + 1, n_inputs)
# of what drives a run
Drive = namedtuple("Drive", "courses samples order last n_inputs dt")
# A row for each sample: relative displacement, velocity; absolute acceleration; states;
# work of input and into sites
Output = namedtuple("Output", "x v a z work")


@part
def inputs_at(drive, interval, x, row):
    """Applied forces, base acceleration and covariates at the share x of a sample
    interval.
    """
    page, start = drive.last * drive.n_inputs, interval * drive.n_inputs
    for j in range(start, start + drive.n_inputs):
        value = drive.courses[drive.order * page + j]
        for d in range(drive.order - 1, -1, -1):
            value = value * x + drive.courses[d * page + j]
        row[j - start] = value


@inline
def put(to, values, n):
    """Copy n numbers."""
    for i in range(n):
        to[i] = values[i]


@inline
def relative(y, site):
    """Motion of the upper end of a site relative to its lower end."""
    return y[site[UPPER]] - (y[site[LOWER]] if site[LOWER] >= 0 else 0.0)


@inline
def law_force(system, law, s, v, a, t, row, z, u, out):
    """Force of one law."""
    n_u, n_terms = law[N_INPUTS], law[N_TERMS]
    for k in range(n_u):
        u[k] = row[system.channels[law[INPUT] + k]]
    given = u, n_u, address_of(z, law[STATE]), law[N_STATES]
    more = address_of(system.theta, law[THETA]), law[N_THETA], out, n_terms
    call_kernel(law[KERNEL], (s, v, a, system.t0 + t, *given, *more))
    force = 0.0
    for k in range(n_terms):
        force += system.coefficients[law[TERM] + k] * out[k]
    return force


@part
def site_force(system, site, s, v, t, row, z, u, out, general):
    """Force of all laws of a site: the part without acceleration, and the factor of
    acceleration.
    """
    force, inertia = 0.0, 0.0
    for k in range(site[FIRST], site[LAST]):
        law = address_of(system.laws, k * LAW)
        now = law_force(system, law, s, v, 0.0, t, row, z, u, out)
        force += now
        if general is not None and law[INERTIA]:
            inertia += law_force(system, law, s, v, 1.0, t, row, z, u, out) - now
    return force, inertia


@inline
def advance_site(system, site, s0, r0, s1, r1, z, dt, middle, u):
    """Move the states of the laws of one site along a path without reversal."""
    for k in range(site[FIRST], site[LAST]):
        law = address_of(system.laws, k * LAW)
        if law[N_STATES]:
            for j in range(law[N_INPUTS]):
                u[j] = middle[system.channels[law[INPUT] + j]]
            more = u, law[N_INPUTS], address_of(system.theta, law[THETA]), law[N_THETA]
            call_advance(
                law[ADVANCE],
                (address_of(z, law[STATE]), law[N_STATES], s0, r0, s1, r1, dt, *more),
            )


@part
def advance_states(system, x0, v0, x1, v1, z, dt, middle, u):
    """Move the states of all laws from (x0, v0) to (x1, v1), during which no memory
    site reverses.
    """
    for i in range(system.n_sites):
        site = address_of(system.sites, i * SITE)
        if site[MEMORY]:
            advance_site(
                system,
                site,
                relative(x0, site),
                relative(v0, site),
                relative(x1, site),
                relative(v1, site),
                z,
                dt,
                middle,
                u,
            )


@part
def solve(matrix, vector, n):
    """Solve a small dense system of size n in place; the answer replaces the right-hand
    side.
    """
    for k in range(n):
        best, row = k, address_of(matrix, k * n)
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


@inline
def add_between(matrix, p, q, n, value):
    """Add a stiffness or mass between two DOFs, or one DOF and the base, to a
    matrix.
    """
    matrix[p * n + p] += value
    if q >= 0:
        matrix[q * n + q] += value
        matrix[p * n + q] -= value
        matrix[q * n + p] -= value


# regime of a site whose force has no jump at zero rate; +1, -1: slips that way; 0:
# sticks
FREE = 2
_CREEP = 1e-300  # a rate that has a sign and nothing else


@part
def _mass_solve(system, w, vector):
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
        site, b = address_of(system.sites, i * SITE), w.inertia[i]
        if b != 0.0 and not site[ON_DOF]:
            add_between(w.matrix, site[UPPER], site[LOWER], n, b)
    solve(w.matrix, vector, n)


@part
def _hold_stuck(system, w, n_stuck, a, force):
    """Forces within the jump of each sticking site so that it does not accelerate
    (Filippov 1988).
    """
    n = system.n_dof
    for k in range(n_stuck):
        site, column = (
            address_of(system.sites, w.stuck[k] * SITE),
            address_of(w.column, k * n),
        )
        for j in range(n):
            column[j] = 0.0
        column[site[UPPER]] = w.jump[w.stuck[k]]
        if site[LOWER] >= 0:
            column[site[LOWER]] = -w.jump[w.stuck[k]]
        _mass_solve(system, w, column)
    for m in range(n_stuck):
        site, row = (
            address_of(system.sites, w.stuck[m] * SITE),
            address_of(w.hold, m * n_stuck),
        )
        for k in range(n_stuck):
            row[k] = relative(address_of(w.column, k * n), site)
        if n_stuck > 1:
            row[m] *= 1.0 + 1e-12  # loops of sticking links share their load
        w.load[m] = relative(a, site)
    solve(w.hold, w.load, n_stuck)
    for k in range(n_stuck):
        i = w.stuck[k]
        w.share[i] = w.load[k]
        force[i] += w.load[k] * w.jump[i]
        for j in range(n):
            a[j] -= w.load[k] * w.column[k * n + j]


@part
def accelerate(system, t, row, x, v, z, a, force, w, general):
    """Relative accelerations of the DOFs and forces of the sites; without ``general``
    no site sticks or has inertia.
    """
    n, n_stuck = (
        system.n_dof,
        np.int64(0),
    )  # not a literal, for which more would be compiled
    base = row[n]
    for j in range(n):
        a[j] = row[j] - system.masses[j] * base
        w.mass[j] = system.masses[j]
    for i in range(system.n_sites):
        site = address_of(system.sites, i * SITE)
        s, rate = relative(x, site), relative(v, site)
        if general is not None and w.regime[i] == 0:
            upper, _ = site_force(
                system, site, s, _CREEP, t, row, z, w.u, w.out, general
            )
            lower, inertia = site_force(
                system, site, s, -_CREEP, t, row, z, w.u, w.out, general
            )
            force[i] = 0.5 * (upper + lower)
            w.jump[i] = 0.5 * (upper - lower)
            w.share[i] = 0.0
            if w.jump[i] > 0.0:
                w.stuck[n_stuck] = i
                n_stuck += 1
        else:
            if (
                general is not None
                and w.regime[i] != FREE
                and rate * w.regime[i] < _CREEP
            ):
                rate = w.regime[i] * _CREEP
            force[i], inertia = site_force(
                system, site, s, rate, t, row, z, w.u, w.out, general
            )
        p, q = site[UPPER], site[LOWER]
        a[p] -= force[i]
        if q >= 0:
            a[q] += force[i]
        w.inertia[i] = inertia
        if general is not None and site[ON_DOF] and inertia != 0.0:
            w.mass[p] += inertia
            a[p] -= inertia * base
    if general is None:
        for j in range(n):
            a[j] /= system.masses[j]
        return
    _mass_solve(system, w, a)
    if n_stuck:
        _hold_stuck(system, w, n_stuck, a, force)
    for i in range(system.n_sites):
        if w.inertia[i] != 0.0:
            site = address_of(system.sites, i * SITE)
            force[i] += w.inertia[i] * (
                relative(a, site) + (base if site[ON_DOF] else 0.0)
            )
