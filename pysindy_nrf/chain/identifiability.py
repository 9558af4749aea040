"""Order in which the balances of a chain are solved, and unknowns that an excitation
cannot identify.

This is pure topology and uses no samples. A balance can be solved if its right-hand
side contains something known and nonzero: a measured force, a known mass, or a law
identified before (eqs. 4-5).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..exceptions import ChainError, ExcitationError, IdentifiabilityError
from .sites import Site, dofs_of

STRATEGIES = ("auto", "complete", "sequential", "joint")


class Topology(Protocol):
    """The DOFs of a chain and the sites at which its laws act; a
    :class:`~pysindy_nrf.Chain` is one.
    """

    n_dof: int
    sites: tuple[Site, ...]


@dataclass(frozen=True)
class Step:
    """One sub-problem of the solve."""

    dofs: tuple[
        int, ...
    ]  # the balances that are summed: one DOF, or all DOFs above a cut
    masses: tuple[int, ...]  # DOFs whose mass is unknown here
    sites: tuple[Site, ...]  # whose law is unknown here
    known_sites: tuple[
        Site, ...
    ] = ()  # whose law is identified before and moves to the right-hand side
    forced: bool = False  # a measured force scales the sub-problem

    @property
    def name(self) -> str:
        """The balance of the sub-problem in words."""
        if len(self.dofs) == 1:
            return f"balance of DOF {self.dofs[0]}"
        return f"balance of DOFs {self.dofs[0]} to {self.dofs[-1]} together"

    def __str__(self) -> str:
        found = [f"m{j}" for j in self.masses] + [str(s) for s in self.sites]
        text = (
            self.name[0].upper() + self.name[1:] + (" (forced)" if self.forced else "")
        )
        return f"{text}: {', '.join(found)}."


@dataclass(frozen=True)
class SolveOrder:
    """Order in which the balances are solved, and unknowns that cannot be
    identified.
    """

    strategy: str
    steps: tuple[Step, ...]
    missing_masses: tuple[int, ...] = ()
    missing_sites: tuple[Site, ...] = ()
    reasons: tuple[
        str, ...
    ] = ()  # one sentence for each missing unknown, with a remedy
    # joint by default: each balance by itself where two of them contradict each other
    yields: bool = False

    @property
    def complete(self) -> bool:
        """True if every mass and every law can be identified."""
        return not (self.missing_masses or self.missing_sites)

    def require_complete(self) -> SolveOrder:
        """The order itself; raises an error if anything cannot be identified."""
        if not self.steps:
            cure = (
                "Measure a force on one DOF, or give a mass: known_masses={dof: kg};"
                " ratios to it then come out."
            )
            raise ExcitationError(
                "No force is measured and no mass is known, so nothing scales the"
                " chain",
                cure,
                argument="known_masses",
            )
        if not self.complete:
            raise IdentifiabilityError(" ".join(self.reasons))
        return self

    def __str__(self) -> str:
        return "\n".join([str(step) for step in self.steps] + list(self.reasons))


def plan_solve_order(
    chain: Topology,
    excited: Any = (),
    unknown: Any = (),
    known_masses: Any = (),
    strategy: str = "auto",
    sites: Iterable[Site] | None = None,
    alone: bool = False,
) -> SolveOrder:
    """Order of the solve of a chain (paper eqs. 3-5); "auto" is never joint where
    balances are used alone.
    """
    if strategy not in STRATEGIES:
        raise ChainError(
            f"strategy={strategy!r} is unknown",
            f"Choose one of {', '.join(STRATEGIES)}.",
        )
    named = {"excited": excited, "unknown": unknown, "known_masses": known_masses}
    forced_, unknown_, masses = (
        frozenset(dofs_of(name, given, chain.n_dof)) for name, given in named.items()
    )
    forced_ -= unknown_
    acting = chain.sites if sites is None else tuple(sites)
    every = frozenset(range(1, chain.n_dof + 1))
    auto = strategy == "auto"
    if auto:
        strategy = (
            "sequential"
            if forced_ != every
            else "complete"
            if alone or chain.n_dof == 1
            else "joint"
        )
    if strategy in ("complete", "joint"):
        scaled = forced_ if strategy == "joint" else forced_ | (masses - unknown_)
        if scaled != every:
            idle = ", ".join(str(j) for j in sorted(every - scaled))
            what = (
                f"strategy={strategy!r} needs a force on every DOF; none is measured on"
                f" DOF {idle}"
            )
            cure = (
                "Use strategy='sequential', or hit those floors too (in the same or in"
                " another record)."
            )
            raise IdentifiabilityError(what, cure)
        steps = [
            Step(
                (j,),
                (() if j in masses else (j,)),
                tuple(s for s in acting if s.incidence(j)),
                (),
                j in forced_,
            )
            for j in range(chain.n_dof, 0, -1)
        ]
        return SolveOrder(strategy, tuple(steps), yields=auto and strategy == "joint")
    return _sequential(chain, forced_, unknown_, masses, acting)


def _sequential(
    chain: Topology,
    forced: frozenset[int],
    unknown: frozenset[int],
    given: frozenset[int],
    acting: tuple[Site, ...],
) -> SolveOrder:
    masses = set(given)
    sites: set[Site] = set()
    open_rows = [j for j in range(chain.n_dof, 0, -1) if j not in unknown]
    steps: list[Step] = []

    def cut_step() -> Step | None:
        # Base excitation with known masses: each storey from the inertia above it.
        for i in range(chain.n_dof, 0, -1):
            above = tuple(range(i, chain.n_dof + 1))
            if any(j in forced or j in unknown or j not in given for j in above):
                return None
            crossing = [s for s in acting if sum(s.incidence(j) for j in above)]
            fresh = tuple(s for s in crossing if s not in sites)
            if fresh:
                return Step(above, (), fresh, tuple(s for s in crossing if s in sites))
        return None

    def row_step() -> Step | None:
        best = None
        for j in open_rows:
            here = [s for s in acting if s.incidence(j)]
            known = tuple(s for s in here if s in sites)
            fresh = tuple(s for s in here if s not in sites)
            mass = () if j in masses else (j,)
            if not (fresh or mass) or not (j in forced or j in masses or known):
                continue
            weak = j not in masses and not any(
                s.is_storey for s in known
            )  # a tie carries a small part of the shear
            rank = (j not in forced, weak, len(fresh) + len(mass))
            if best is None or rank < best[0]:
                best = (rank, Step((j,), mass, fresh, known, j in forced))
        return best[1] if best else None

    while step := cut_step() or row_step():
        steps.append(step)
        masses.update(step.masses)
        sites.update(step.sites)
        if len(step.dofs) == 1:
            open_rows.remove(step.dofs[0])
    lost_masses = tuple(j for j in range(chain.n_dof, 0, -1) if j not in masses)
    lost_sites = tuple(s for s in acting if s not in sites)
    return SolveOrder(
        "sequential",
        tuple(steps),
        lost_masses,
        lost_sites,
        _reasons(lost_masses, lost_sites, unknown),
    )


def _reasons(
    masses: tuple[int, ...], sites: tuple[Site, ...], unknown: frozenset[int]
) -> tuple[str, ...]:
    said = []
    for site in sites:
        ends = [j for j in (site.q, site.p) if j > 0]
        blind = " and ".join(str(j) for j in ends if j in unknown)
        hit = " or ".join(str(j) for j in ends if j not in unknown)
        why = "no force and no known mass reaches it; "
        if blind:
            why = (
                f"the force on DOF {blind} is unknown and nothing else reaches it;"
                f" measure the force on floor {blind}"
            )
            why += ", or " * bool(hit)
        why += f"hit floor {hit}" if hit else ""
        said.append(((-site.p, 0, -site.q), f"{site} cannot be scaled: {why}."))
    for j in masses:
        why = f"no force and no known mass reaches DOF {j}; hit floor {j}."
        if j in unknown:
            why = f"the force on DOF {j} is unknown; measure it or weigh the floor."
        said.append(((-j, 1, 0), f"m{j} cannot be found: {why}"))
    return tuple(text for _, text in sorted(said, key=lambda item: item[0]))


DAMPING = 0.01  # of every mode of the nominal chain, as a share of critical
LOST = 1e-7  # singular value over the largest below which a direction is not told
# spread of the nominal masses and stiffnesses: equal ones would hide nothing and share
# modes by chance
DRAW = 0.15


@dataclass(frozen=True)
class Sensing:
    """What some sensors can tell of a linear chain, from the rank and condition of the
    linearised problem.
    """

    excited: tuple[int, ...]  # DOFs with a measured force; empty: the base moves
    sensors: tuple[int, ...]
    rank: int
    unknowns: int  # free masses and stiffnesses
    condition: (
        float  # of the changes of the responses with their logarithms, damping unknown
    )
    errors: dict[
        str, float
    ]  # standard error of each over that with sensors on every floor; inf: not told
    gains: dict[
        int, float
    ]  # by floor without a sensor: largest error over that with one more sensor there

    @property
    def complete(self) -> bool:
        """True if all masses and stiffnesses can be told."""
        return self.rank == self.unknowns

    def __str__(self) -> str:
        where = (
            f"{_floors('Force on floor', self.excited)}"
            if self.excited
            else "Base motion"
        )
        worst = max(self.errors, key=self.errors.__getitem__)
        said = f"{where}, {_floors('sensor on floor', self.sensors)}: "
        if self.complete:
            said += (
                f"all {self.unknowns} masses and stiffnesses can be told near a given"
                f" chain (condition {self.condition:.1e}). Least sure is {worst}, with"
                f" {self.errors[worst]:.1f} times the error that sensors on every floor"
                " leave."
            )
        else:
            lost = ", ".join(
                name for name, error in self.errors.items() if np.isinf(error)
            )
            said += (
                f"{self.rank} of {self.unknowns} combinations of masses and stiffnesses"
                f" can be told; {lost} cannot be "
                "told apart."
                f" {'' if self.excited else 'Measure a force on a floor, or give a mass.'}"
            )
        if self.gains:
            floor = max(self.gains, key=self.gains.__getitem__)
            if self.gains[floor] > 1:
                said = f"{said.rstrip()} One more sensor helps most on floor {floor}"
                falls = np.isfinite(self.gains[floor])
                said += (
                    f": the largest error falls by a factor of {self.gains[floor]:.1f}."
                    if falls
                    else "."
                )
        return said.rstrip()


def _floors(text: str, floors: tuple[int, ...]) -> str:
    return f"{text}{'s' * (len(floors) > 1)} {', '.join(map(str, floors))}"


def plan_sensing(
    chain: Any,
    sensors: Any,
    excited: Any = (),
    known_masses: Any = (),
    model: Any = None,
) -> Sensing:
    """Rank, condition and errors of the linearised problem; of the model's linear part,
    or of a nominal chain.
    """
    n, links = chain.n_dof, [s for s in chain.sites if s.kind == "link"]
    seen, hit, known = (
        tuple(sorted(dofs_of(name, given, n)))
        for name, given in (
            ("sensors", sensors),
            ("excited", excited),
            ("known_masses", known_masses),
        )
    )
    if not seen:
        raise ChainError("No floor has a sensor", "Name at least one: sensors=[4].")
    rng, signs = np.random.default_rng(0), chain.incidence(links)
    masses, k = (
        1 + DRAW * rng.uniform(-1, 1, n),
        1 + DRAW * rng.uniform(-1, 1, len(links)),
    )
    if model is not None:
        masses = np.asarray(model.masses, dtype=float)
        k = np.array([abs(model.restoring_forces[s].linear_part()["k"]) for s in links])
    free = [j for j in range(n) if j + 1 not in known]
    values = np.linalg.eigvalsh(
        (signs * k) @ signs.T / np.sqrt(masses)[:, None] / np.sqrt(masses)
    )
    modes = np.sqrt(np.maximum(values, 1e-9 * values[-1]))
    w = np.outer(modes, 1 + DAMPING * np.linspace(-4, 4, 9)).ravel()
    middle = float(np.exp(np.log(modes).mean()))

    def responses(u: np.ndarray) -> np.ndarray:
        """Accelerations of all floors by line and input, changed by logarithms of
        masses, stiffnesses, damping.
        """
        m, stiff = masses.copy(), k * np.exp(u[len(free) : len(free) + len(k)])
        m[free] *= np.exp(u[: len(free)])
        c = k * 2 * DAMPING / middle * np.exp(u[len(free) + len(k) :])
        whole = (signs * (stiff + 1j * w[:, None, None] * c)) @ signs.T - w[
            :, None, None
        ] ** 2 * np.diag(m)
        x = np.linalg.inv(whole)
        inputs = np.eye(n)[:, [j - 1 for j in hit]] if hit else -m[:, None]
        return -(w[:, None, None] ** 2) * (x @ inputs) + (0.0 if hit else 1.0)

    p = len(free) + 2 * len(k)
    J = np.stack(
        [(responses(h) - responses(-h)) / 2e-5 for h in 1e-5 * np.eye(p)], axis=-1
    )
    J = (
        J
        / np.sqrt(np.mean(np.abs(responses(np.zeros(p))) ** 2, axis=0))[
            None, :, :, None
        ]
    )
    names = [f"m{j + 1}" for j in free] + [f"{site}: s" for site in links]

    def told(floors: Iterable[int]) -> tuple[np.ndarray, np.ndarray]:
        """Singular values of the scaled masses and stiffnesses, and their errors."""
        part = J[:, [j - 1 for j in floors]].reshape(-1, p)
        part = np.concatenate([part.real, part.imag])
        wanted, damping = part[:, : len(names)], part[:, len(names) :]
        wanted = wanted - damping @ np.linalg.lstsq(damping, wanted, rcond=None)[0]
        _, singular, turned = np.linalg.svd(wanted, full_matrices=False)
        held = singular > LOST * singular[0]
        variance = (turned[held] ** 2 / singular[held, None] ** 2).sum(axis=0)
        return singular, np.where(
            (turned[~held] ** 2).sum(axis=0) > 1e-6, np.inf, np.sqrt(variance)
        )

    every = told(range(1, n + 1))[1]
    singular, errors = told(seen)
    rank = int((singular > LOST * singular[0]).sum())
    gains = {}
    for floor in sorted(set(range(1, n + 1)) - set(seen)):
        new = told([*seen, floor])[1].max()
        gains[floor] = 1.0 if np.isinf(new) else float(errors.max() / new)
    shares = np.where(
        np.isinf(errors), np.inf, errors / np.where(np.isinf(every), 1.0, every)
    )
    condition = float(singular[0] / singular[-1]) if rank == len(names) else np.inf
    return Sensing(
        hit, seen, rank, len(names), condition, dict(zip(names, shares.tolist())), gains
    )
