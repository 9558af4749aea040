"""A chain model as flat arrays and compiled callbacks, and the work arrays of the integrators."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..exceptions import LawError, SimulationError
from ..laws.compiled import borrow, inline, pointers
from ..laws.forcing import total_masses
from ..laws.friction import jump_at_reversal

# columns of System.laws
KERNEL, ADVANCE, TERM, N_TERMS, STATE, N_STATES, THETA, N_THETA, INPUT, N_INPUTS, INERTIA = range(11)
# columns of System.sites
UPPER, LOWER, FIRST, LAST, ON_DOF, MEMORY = range(6)


class System(NamedTuple):
    """A chain model as flat arrays; the columns of sites and laws are numbered above."""

    masses: np.ndarray
    sites: np.ndarray  # int64, (n_sites, 6); DOFs count from 0, -1 is the base
    laws: np.ndarray  # int64, (n_laws, 11)
    coefficients: np.ndarray  # of all laws, one after the other
    theta: np.ndarray
    channels: np.ndarray  # input columns of the covariates of all laws
    link_inertia: bool  # the mass matrix is not diagonal
    t0: float  # time of the first sample on the clock of the laws, s


class Layout(NamedTuple):
    """The sites, states and covariates that the parts of a :class:`System` belong to."""

    sites: tuple
    states: dict  # slice of the state vector by (site, number of the law there), for laws with memory
    covariates: tuple[str, ...]  # in the order of the input columns
    keep: list  # callbacks that must live as long as their addresses are used


def flatten(model: Any, t0: float = 0.0) -> tuple[System, Layout]:
    """A chain model as flat arrays."""
    masses = np.array(model.masses, dtype=float)
    bad = np.flatnonzero(~(np.isfinite(masses) & (masses > 0)))
    if bad.size:
        raise SimulationError(
            f"m{bad[0] + 1} = {masses[bad[0]]:.4g} kg; a free run needs positive masses",
            "Weigh that floor and give its mass in known_masses=, or excite the chain better.",
        )
    groups = {site: group for site, group in model.laws.items() if site.kind != "sensor" and group}
    missing = [(law, site) for site, group in groups.items() for law in group if law.coefficients is None]
    if missing:
        law, site = missing[0]
        raise LawError(f"{type(law).__name__} at {site} has no coefficients", "Fit the model, or give them.")
    total = total_masses(masses, groups)
    if (total <= 0).any():
        j = int(np.argmin(total))
        raise SimulationError(
            f"DOF {j + 1} has {masses[j]:.4g} kg and {total[j] - masses[j]:.4g} kg added to it, {total[j]:.4g} kg in "
            "all; a free run needs positive masses",
            f"Weigh that floor and give its mass in known_masses=, or leave the added mass at dof {j + 1} out.",
        )
    names = tuple(dict.fromkeys(name for group in groups.values() for law in group for name in law.covariates))
    n = len(masses)
    lists: list[list[Any]] = [[] for _ in range(6)]
    sites, rows, coefficients, theta, channels, keep = lists
    states, n_states, link_inertia = {}, 0, False
    for site, group in groups.items():
        first = len(rows)
        for number, law in enumerate(group):
            kernel, advance = pointers(law)
            keep += [kernel, advance]
            values = law.theta
            rows.append((
                kernel.address, advance.address, len(coefficients), len(law.coefficients), n_states, law.n_states,
                len(theta), len(values), len(channels), len(law.covariates), law.uses_acceleration,
            ))  # fmt: skip
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
    )
    return system, Layout(tuple(groups), states, names, keep)


class Work(NamedTuple):
    """Preallocated arrays of one evaluation of the balance."""

    out: np.ndarray
    u: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray
    matrix: np.ndarray
    column: np.ndarray
    hold: np.ndarray
    load: np.ndarray
    jump: np.ndarray
    share: np.ndarray
    stuck: np.ndarray


def work_arrays(system: System) -> Work:
    """Preallocated arrays for a system."""
    n, n_sites = len(system.masses), len(system.sites)
    widest = int(system.laws[:, [N_TERMS, N_INPUTS]].max(initial=1))
    shapes = (widest, widest, n, n_sites, (n, n), (n_sites, n), (n_sites, n_sites), n_sites, n_sites, n_sites)
    return Work(*map(np.zeros, shapes), np.zeros(n_sites, dtype=np.int64))


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


class Stages(NamedTuple):
    """Preallocated arrays of one Runge-Kutta step."""

    v: np.ndarray  # (n_stages, n_dof)
    a: np.ndarray
    power: np.ndarray  # (n_stages, 1 + n_sites): of the input and into the sites, W
    row: np.ndarray
    middle: np.ndarray
    force: np.ndarray
    force0: np.ndarray
    x_half: np.ndarray
    v_half: np.ndarray
    z_once: np.ndarray
    z_top: np.ndarray
    top: np.ndarray  # largest displacement and velocity so far
    work: np.ndarray


def stages(n_stages: int, n: int, n_sites: int, n_inputs: int, n_states: int) -> Stages:
    """Preallocated arrays for the steps of a rule."""
    of_stages = ((n_stages, n), (n_stages, n), (n_stages, n_sites + 1))
    shapes = (*of_stages, n_inputs, n_inputs, n_sites, n_sites, n, n, n_states, n_states, 2, n_sites + 1)
    return Stages(*map(np.zeros, shapes))


class Output(NamedTuple):
    """Arrays that a run fills, one row for each sample."""

    x: np.ndarray  # relative displacement, (n_samples, n_dof)
    v: np.ndarray
    a: np.ndarray  # absolute
    z: np.ndarray
    work: np.ndarray  # of the input and into the sites, J


@inline
def borrow_system(s):
    return System(
        borrow(s.masses), borrow(s.sites), borrow(s.laws), borrow(s.coefficients), borrow(s.theta), borrow(s.channels),
        s.link_inertia, s.t0,
    )  # fmt: skip


@inline
def borrow_work(w):
    return Work(
        borrow(w.out), borrow(w.u), borrow(w.mass), borrow(w.inertia), borrow(w.matrix), borrow(w.column),
        borrow(w.hold), borrow(w.load), borrow(w.jump), borrow(w.share), borrow(w.stuck),
    )  # fmt: skip


@inline
def borrow_stages(k):
    return Stages(
        borrow(k.v), borrow(k.a), borrow(k.power), borrow(k.row), borrow(k.middle), borrow(k.force), borrow(k.force0),
        borrow(k.x_half), borrow(k.v_half), borrow(k.z_once), borrow(k.z_top), borrow(k.top), borrow(k.work),
    )  # fmt: skip
