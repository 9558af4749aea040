"""A chain model as flat arrays, which the compiled integrators read."""

from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..chain.laws_by_site import distinct_labels
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..common.unit_system import UnitSystem
from ..exceptions import LawError, SimulationError
from ..laws.base import ForceLaw
from ..laws.callbacks import callbacks_of
from ..laws.forcing import lost_masses
from ..laws.friction import jump_at_reversal

WEIGH = "Weigh that floor and give its mass in known_masses="
Laws = Mapping[Site, Sequence[ForceLaw]]

# Columns of System.laws: addresses of the callbacks; where the coefficients, states,
# shape parameters and covariates of a law begin and how many there are; whether it
# reads the acceleration.
KERNEL, ADVANCE = 0, 1
TERM, N_TERMS = 2, 3
STATE, N_STATES = 4, 5
THETA, N_THETA = 6, 7
INPUT, N_INPUTS = 8, 9
INERTIA = 10
LAW_COLUMNS = 11

# Columns of System.sites: the two DOFs, from 0, the base being -1; first and last law;
# whether the site is a DOF; whether a law there has memory.
UPPER, LOWER = 0, 1
FIRST, LAST = 2, 3
ON_DOF, MEMORY = 4, 5
SITE_COLUMNS = 6

# Masses; tables of sites and laws; coefficients and shape parameters of all laws, one
# after the other; the input column that each coefficient follows in time, or CONSTANT;
# input columns of their covariates; whether a link has inertia, so that the mass matrix
# is not diagonal; time of the first sample on the clock of the laws, s; numbers.
System = namedtuple(
    "System",
    "masses sites laws coefficients followed theta channels link_inertia t0 n_dof"
    " n_sites n_states",
)
# In ``System.followed``: a coefficient that follows no input.
CONSTANT = -1


class Layout(NamedTuple):
    """What the parts of a :class:`System` belong to."""

    sites: tuple[Site, ...]
    # slice of the state vector by site and number of the law there
    states: dict[tuple[Site, int], slice]
    covariates: tuple[str, ...]  # in the order of the input columns


@dataclass
class _Tables:
    """Tables of sites and laws while they grow."""

    n_dof: int
    covariates: tuple[str, ...]
    sites: list[tuple[int, ...]] = field(default_factory=list)
    # numba knows no address of what is not compiled; these are
    laws: list[tuple[int | None, ...]] = field(default_factory=list)
    coefficients: list[float] = field(default_factory=list)
    theta: list[float] = field(default_factory=list)
    channels: list[int] = field(default_factory=list)
    states: dict[tuple[Site, int], slice] = field(default_factory=dict)
    n_states: int = 0
    link_inertia: bool = False

    def add_site(self, site: Site, laws: Sequence[ForceLaw]) -> None:
        first = len(self.laws)
        for number, law in enumerate(laws):
            if law.n_states:
                end = self.n_states + law.n_states
                self.states[site, number] = slice(self.n_states, end)
            self.add_law(law)
        on_dof = site.kind == "dof"
        if not on_dof and any(law.uses_acceleration for law in laws):
            self.link_inertia = True
        lower = site.q - 1 if site.kind == "link" else -1
        has_memory = any(law.has_memory for law in laws)
        self.sites.append(
            (site.p - 1, lower, first, len(self.laws), on_dof, has_memory)
        )

    def add_law(self, law: ForceLaw) -> None:
        kernel, advance = callbacks_of(law)
        theta = law.theta
        self.laws.append(
            (
                kernel.address,
                advance.address,
                len(self.coefficients),
                len(law.values),
                self.n_states,
                law.n_states,
                len(self.theta),
                len(theta),
                len(self.channels),
                len(law.covariates),
                law.uses_acceleration,
            )
        )
        self.coefficients += list(law.values)
        self.theta += list(theta)
        self.n_states += law.n_states
        # behind the forces of the DOFs and the acceleration of the base
        self.channels += [
            self.n_dof + 1 + self.covariates.index(name) for name in law.covariates
        ]


def flatten(
    model: ChainModel, t0: float = 0.0, courses: Sequence[str] = ()
) -> tuple[System, Layout]:
    """A chain model as flat arrays.

    ``courses`` names coefficients that follow inputs, which stand behind the
    covariates.

    Raises
    ------
    SimulationError
        If a mass is not positive, or a course is not that of a coefficient.
    LawError
        If a law has no coefficients.
    """
    masses = np.array(model.masses, dtype=float)
    laws = {
        site: laws_there
        for site, laws_there in model.laws.items()
        if site.kind != "sensor" and laws_there
    }
    _require_values(laws)
    _require_positive_masses(masses, laws, model.units)

    names = [
        name for group in laws.values() for law in group for name in law.covariates
    ]
    tables = _Tables(len(masses), tuple(dict.fromkeys(names)))
    for site, laws_there in laws.items():
        tables.add_site(site, laws_there)

    system = System(
        masses=masses,
        sites=np.array(tables.sites, dtype=np.int64).reshape(-1, SITE_COLUMNS),
        laws=np.array(tables.laws, dtype=np.int64).reshape(-1, LAW_COLUMNS),
        coefficients=np.array(tables.coefficients, dtype=float),
        followed=_followed(laws, courses, len(masses) + 1 + len(tables.covariates)),
        theta=np.array(tables.theta, dtype=float),
        channels=np.array(tables.channels, dtype=np.int64),
        link_inertia=tables.link_inertia,
        t0=float(t0),
        n_dof=len(masses),
        n_sites=len(laws),
        n_states=tables.n_states,
    )
    return system, Layout(tuple(laws), tables.states, tables.covariates)


def _followed(laws: Laws, courses: Sequence[str], first: int) -> np.ndarray:
    """Input column of every coefficient, those of courses from the first one on."""
    names = []
    for site, laws_there in laws.items():
        names += [f"{site}: {label}" for label in distinct_labels(laws_there)]
    followed = np.full(len(names), CONSTANT, dtype=np.int64)
    for column, name in enumerate(courses, first):
        if name not in names:
            raise SimulationError(
                f"The model has no coefficient {name!r}",
                f"It has {', '.join(names)}.",
            )
        followed[names.index(name)] = column
    return followed


def _require_values(laws: Laws) -> None:
    for site, laws_there in laws.items():
        for law in laws_there:
            if law.coefficients is None:
                raise LawError(
                    f"{type(law).__name__} at {site} has no coefficients",
                    "Fit the model, or give them.",
                )


def _require_positive_masses(masses: np.ndarray, laws: Laws, units: UnitSystem) -> None:
    needed = "a free run needs positive masses"
    for number, mass in enumerate(masses, 1):
        if not 0 < mass < np.inf:
            raise SimulationError(
                f"m{number} = {mass:.4g} {units.mass}; {needed}",
                f"{WEIGH}, or excite the chain better.",
            )
    for lost in lost_masses(masses, laws, units):
        raise SimulationError(
            f"{lost}; {needed}", f"{WEIGH}, or leave the added mass out."
        )


def jumping_sites(
    laws: Laws, layout: Layout, largest_covariates: np.ndarray
) -> np.ndarray:
    """Sites whose force jumps where the rate changes sign, as Coulomb friction does."""
    jumps = []
    for site in layout.sites:
        near = 0.0
        wide = 0.0
        for law in laws[site]:
            columns = [layout.covariates.index(name) for name in law.covariates]
            change = law.values @ jump_at_reversal(law, largest_covariates[columns])
            near += abs(change[0])
            wide += abs(change[1])
        jumps.append(near > 0.5 * wide > 0)
    return np.array(jumps, dtype=bool)
