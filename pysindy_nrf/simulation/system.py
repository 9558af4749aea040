"""A chain model as flat arrays and machine-code callbacks, the form the integrators read."""

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
    """A chain model as flat arrays.

    Attributes
    ----------
    masses : ndarray of shape (n_dof,)
    sites : ndarray of int64, shape (n_sites, 6)
        The two DOFs (from 0; -1 is the base), first and last law, whether the site is a DOF,
        whether a law there remembers the path.
    laws : ndarray of int64, shape (n_laws, 11)
        Addresses of kernel and state update, where the law's values start and how many they are,
        whether it is proportional to acceleration.
    coefficients, theta : ndarray
        Values of all laws, one after the other.
    channels : ndarray of int64
        Columns of the inputs that hold the covariates of all laws, one after the other.
    link_inertia : bool
        Whether the mass matrix is not diagonal.
    t0 : float
        Time of the first sample on the clock of the laws, s.
    """

    masses: np.ndarray
    sites: np.ndarray
    laws: np.ndarray
    coefficients: np.ndarray
    theta: np.ndarray
    channels: np.ndarray
    link_inertia: bool
    t0: float


class Layout(NamedTuple):
    """Which part of a :class:`System` is what.

    Attributes
    ----------
    sites : tuple of Site
    states : dict
        Slice of the state vector by (site, number of the law there), for laws with memory.
    covariates : tuple of str
        Covariates in the order of the input columns.
    keep : list
        Callbacks that must live as long as their addresses are used.
    """

    sites: tuple
    states: dict
    covariates: tuple[str, ...]
    keep: list


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
    sites: list[Any] = []
    rows: list[Any] = []
    coefficients: list[Any] = []
    theta: list[Any] = []
    channels: list[Any] = []
    keep: list[Any] = []
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
    """Room for intermediate values, so that the integrators never allocate.

    Attributes
    ----------
    out, u : ndarray
        Terms and covariates of one law.
    mass, inertia, matrix, column, hold, load, jump, share, stuck : ndarray
        See ``balance.accelerate``.
    """

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


def room(system: System) -> Work:
    """Room for the intermediate values of a system."""
    n, n_sites = len(system.masses), len(system.sites)
    widest = int(system.laws[:, [N_TERMS, N_INPUTS]].max(initial=1))
    return Work(
        np.zeros(widest),
        np.zeros(widest),
        np.zeros(n),
        np.zeros(n_sites),
        np.zeros((n, n)),
        np.zeros((n_sites, n)),
        np.zeros((n_sites, n_sites)),
        np.zeros(n_sites),
        np.zeros(n_sites),
        np.zeros(n_sites),
        np.zeros(n_sites, dtype=np.int64),
    )


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
    """Room for one Runge-Kutta step.

    Attributes
    ----------
    v, a : ndarray of shape (n_stages, n_dof)
    power : ndarray of shape (n_stages, 1 + n_sites)
        Power of the input and into the sites, W.
    row, middle : ndarray of shape (n_inputs,)
    force, force0 : ndarray of shape (n_sites,)
    x_half, v_half : ndarray of shape (n_dof,)
    z_once, z_top : ndarray of shape (n_states,)
    top : ndarray of shape (2,)
        Largest displacement and velocity so far.
    work : ndarray of shape (1 + n_sites,)
        Work so far, J.
    """

    v: np.ndarray
    a: np.ndarray
    power: np.ndarray
    row: np.ndarray
    middle: np.ndarray
    force: np.ndarray
    force0: np.ndarray
    x_half: np.ndarray
    v_half: np.ndarray
    z_once: np.ndarray
    z_top: np.ndarray
    top: np.ndarray
    work: np.ndarray


def stages(n_stages: int, n: int, n_sites: int, n_inputs: int, n_states: int) -> Stages:
    """Room for the steps of a rule."""
    zeros = np.zeros
    return Stages(
        zeros((n_stages, n)), zeros((n_stages, n)), zeros((n_stages, n_sites + 1)),
        zeros(n_inputs), zeros(n_inputs), zeros(n_sites), zeros(n_sites),
        zeros(n), zeros(n), zeros(n_states), zeros(n_states), zeros(2), zeros(n_sites + 1),
    )  # fmt: skip


class Output(NamedTuple):
    """What a run leaves at the samples.

    Attributes
    ----------
    x, v, a : ndarray of shape (n_samples, n_dof)
        Relative displacement and velocity, absolute acceleration.
    z : ndarray of shape (n_samples, n_states)
    work : ndarray of shape (n_samples, 1 + n_sites)
        Work of the input and into the sites, J.
    """

    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    z: np.ndarray
    work: np.ndarray


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
