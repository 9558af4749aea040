"""What an excitation can identify, and the order in which it is found.

This is pure topology and uses no samples. An equation of motion can be solved if its
right-hand side contains something known and nonzero: a measured force, a known mass, or
a law identified before (paper eqs. 4-5).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Protocol

from ..exceptions import ChainError, ExcitationError, IdentifiabilityError
from .sites import Site, dofs_of

STRATEGIES = ("auto", "complete", "sequential", "joint")

Dofs = int | Iterable[int]


class Topology(Protocol):
    """DOFs and sites of a chain; a :class:`~pysindy_nrf.Chain` is one."""

    n_dof: int
    sites: tuple[Site, ...]


@dataclass(frozen=True)
class Step:
    """One sub-problem of the solve: an equation of motion, or several summed.

    Attributes
    ----------
    dofs : tuple of int
        DOFs whose equations are summed: one DOF, or all DOFs above a cut.
    masses : tuple of int
        DOFs whose mass is unknown here.
    sites : tuple of Site
        Sites whose laws are unknown here.
    known_sites : tuple of Site
        Sites whose laws were identified before and move to the right-hand side.
    forced : bool
        Whether a measured force scales the sub-problem.
    """

    dofs: tuple[int, ...]
    masses: tuple[int, ...]
    sites: tuple[Site, ...]
    known_sites: tuple[Site, ...] = ()
    forced: bool = False

    @property
    def name(self) -> str:
        """The equations of the sub-problem in words."""
        first, last = self.dofs[0], self.dofs[-1]
        if first == last:
            return f"balance of DOF {first}"
        return f"balance of DOFs {first} to {last} together"

    def __str__(self) -> str:
        unknowns = [f"m{j}" for j in self.masses]
        unknowns.extend(map(str, self.sites))

        title = self.name[0].upper() + self.name[1:]
        if self.forced:
            title += " (forced)"
        return f"{title}: {', '.join(unknowns)}."


@dataclass(frozen=True)
class SolveOrder:
    """Steps of the solve, and unknowns that cannot be identified.

    Attributes
    ----------
    strategy : {"complete", "sequential", "joint"}
    steps : tuple of Step
    missing_masses : tuple of int
    missing_sites : tuple of Site
    reasons : tuple of str
        One sentence for each missing unknown, with a remedy.
    yields : bool
        True if the solve was chosen by default and gives way to a complete one where
        two equations of motion contradict each other.
    apart : tuple of Step
        Of a sequential order that gives way: every equation by itself.
    """

    strategy: str
    steps: tuple[Step, ...]
    missing_masses: tuple[int, ...] = ()
    missing_sites: tuple[Site, ...] = ()
    reasons: tuple[str, ...] = ()
    yields: bool = False
    apart: tuple[Step, ...] = ()

    @property
    def complete(self) -> bool:
        """True if every mass and every law can be identified."""
        return not (self.missing_masses or self.missing_sites)

    def require_complete(self) -> SolveOrder:
        """The order itself; raises an error if anything cannot be identified."""
        if not self.steps:
            what = (
                "No force is measured and no mass is known, so nothing scales the chain"
            )
            cure = (
                "Measure a force on one DOF, or give a mass: known_masses={dof: kg};"
                " ratios to it then come out."
            )
            raise ExcitationError(what, cure, argument="known_masses")
        if not self.complete:
            raise IdentifiabilityError(" ".join(self.reasons))
        return self

    def __str__(self) -> str:
        return "\n".join([str(step) for step in self.steps] + list(self.reasons))


def plan_solve_order(
    chain: Topology,
    excited: Dofs = (),
    unknown: Dofs = (),
    known_masses: Dofs = (),
    strategy: str = "auto",
    sites: Iterable[Site] | None = None,
    alone: bool = False,
) -> SolveOrder:
    """Order of the solve of a chain (paper eqs. 3-5).

    ``sites`` are those at which laws act, all sites of the chain if None. With
    ``alone``, every equation is solved by itself, so "auto" is never joint. Where all
    DOFs are forced it solves from the upper end down: a law that is known is then no
    column, and noise of columns makes masses and stiffnesses too small.
    """
    no_force = frozenset(dofs_of("unknown", unknown, chain.n_dof))
    forced = frozenset(dofs_of("excited", excited, chain.n_dof)) - no_force
    masses = frozenset(dofs_of("known_masses", known_masses, chain.n_dof))
    acting = chain.sites if sites is None else tuple(sites)

    all_forced = len(forced) == chain.n_dof
    chosen = _chosen_strategy(strategy, all_forced, alone or chain.n_dof == 1)
    by_default = strategy == "auto" and all_forced and chain.n_dof > 1
    each_alone = _each_alone(chain.n_dof, acting, forced, masses)

    if chosen == "sequential":
        plan = _SequentialPlan(chain.n_dof, acting, forced, no_force, masses)
        order = plan.order()
        if by_default and order.complete:
            return replace(order, yields=True, apart=each_alone)
        return order

    scaled = forced if chosen == "joint" else forced | (masses - no_force)
    _require_scaled(scaled, chain.n_dof, chosen)
    return SolveOrder(chosen, each_alone, yields=by_default and chosen == "joint")


def _each_alone(
    n_dof: int,
    acting: Sequence[Site],
    forced: frozenset[int],
    known_masses: frozenset[int],
) -> tuple[Step, ...]:
    """A step for each equation of motion by itself, from the top down."""
    steps = []
    for dof in range(n_dof, 0, -1):
        unknown_mass = () if dof in known_masses else (dof,)
        sites = tuple(site for site in acting if site.incidence(dof))
        steps.append(Step((dof,), unknown_mass, sites, (), dof in forced))
    return tuple(steps)


def _chosen_strategy(strategy: str, all_forced: bool, alone: bool) -> str:
    """The strategy that is asked for, or what "auto" stands for."""
    if strategy not in STRATEGIES:
        cure = f"Choose one of {', '.join(STRATEGIES)}."
        raise ChainError(f"strategy={strategy!r} is unknown", cure)
    if strategy != "auto":
        return strategy
    return "joint" if all_forced and not alone else "sequential"


def _require_scaled(scaled: frozenset[int], n_dof: int, strategy: str) -> None:
    """Refuse a strategy that needs more equations with a force than there are."""
    lost = sorted(set(range(1, n_dof + 1)) - scaled)
    if not lost:
        return

    idle = ", ".join(map(str, lost))
    what = (
        f"strategy={strategy!r} needs a force on every DOF; none is measured on DOF"
        f" {idle}"
    )
    cure = (
        "Use strategy='sequential', or hit those floors too (in the same or in another"
        " record)."
    )
    raise IdentifiabilityError(what, cure)


@dataclass
class _SequentialPlan:
    """The search for a sequence of steps; each uses what the steps before it found."""

    n_dof: int
    acting: tuple[Site, ...]
    forced: frozenset[int]
    no_force: frozenset[int]
    given_masses: frozenset[int]
    masses: set[int] = field(init=False)
    sites: set[Site] = field(default_factory=set, init=False)
    open_dofs: list[int] = field(init=False)

    def __post_init__(self) -> None:
        self.masses = set(self.given_masses)
        top_down = range(self.n_dof, 0, -1)
        self.open_dofs = [dof for dof in top_down if dof not in self.no_force]

    def order(self) -> SolveOrder:
        """All steps that can be taken, and what they leave unknown."""
        steps = []
        while step := self._step_from_above() or self._single_step():
            steps.append(step)
            self.masses.update(step.masses)
            self.sites.update(step.sites)
            if len(step.dofs) == 1:
                self.open_dofs.remove(step.dofs[0])

        top_down = range(self.n_dof, 0, -1)
        lost_masses = tuple(dof for dof in top_down if dof not in self.masses)
        lost_sites = tuple(site for site in self.acting if site not in self.sites)
        reasons = _reasons(lost_masses, lost_sites, self.no_force)
        return SolveOrder("sequential", tuple(steps), lost_masses, lost_sites, reasons)

    def _step_from_above(self) -> Step | None:
        """Base excitation, known masses: a storey from the inertia of all above it."""
        above: tuple[int, ...] = ()
        for dof in range(self.n_dof, 0, -1):
            free = dof not in self.forced and dof not in self.no_force
            if not free or dof not in self.given_masses:
                return None

            above = (dof, *above)
            crossing = [s for s in self.acting if sum(map(s.incidence, above))]
            unknown, known = self._split(crossing)
            if unknown:
                return Step(above, (), unknown, known)
        return None

    def _single_step(self) -> Step | None:
        """The equation that can be solved best: a forced one, with few unknowns."""
        ranked: list[tuple[tuple[bool, bool, int], Step]] = []
        for dof in self.open_dofs:
            here = [site for site in self.acting if site.incidence(dof)]
            unknown, known = self._split(here)
            mass = () if dof in self.masses else (dof,)
            n_unknowns = len(unknown) + len(mass)
            if not n_unknowns or not self._is_scaled(dof, known):
                continue

            # a tie carries a small part of the shear, and its errors would rule
            by_ties = dof not in self.masses and not any(s.is_storey for s in known)
            step = Step((dof,), mass, unknown, known, dof in self.forced)
            ranked.append(((not step.forced, by_ties, n_unknowns), step))
        return min(ranked, key=itemgetter(0))[1] if ranked else None

    def _split(
        self, sites: Iterable[Site]
    ) -> tuple[tuple[Site, ...], tuple[Site, ...]]:
        """Sites whose laws are still unknown, and those whose laws are known."""
        unknown: list[Site] = []
        known: list[Site] = []
        for site in sites:
            side = known if site in self.sites else unknown
            side.append(site)
        return tuple(unknown), tuple(known)

    def _is_scaled(self, dof: int, known: tuple[Site, ...]) -> bool:
        """Whether something known and nonzero stands in the equation of a DOF."""
        return dof in self.forced or dof in self.masses or bool(known)


def _reasons(
    masses: tuple[int, ...], sites: tuple[Site, ...], no_force: frozenset[int]
) -> tuple[str, ...]:
    """Why unknowns are out of reach, from the top down, sites before masses."""
    texts: list[tuple[tuple[int, int, int], str]] = []
    for site in sites:
        why = _why_not_scaled(site, no_force)
        texts.append(((-site.p, 0, -site.q), f"{site} cannot be scaled: {why}."))

    for dof in masses:
        why = f"no force and no known mass reaches DOF {dof}; hit floor {dof}."
        if dof in no_force:
            why = f"the force on DOF {dof} is unknown; measure it or weigh the floor."
        texts.append(((-dof, 1, 0), f"m{dof} cannot be found: {why}"))
    return tuple(text for _, text in sorted(texts, key=itemgetter(0)))


def _why_not_scaled(site: Site, no_force: frozenset[int]) -> str:
    """What is missing to scale the laws of a site, and what to do."""
    ends = {site.q, site.p} - {0}
    blind = " and ".join(map(str, sorted(ends & no_force)))
    floors = " or ".join(map(str, sorted(ends - no_force)))

    hit = f"hit floor {floors}" if floors else ""
    if not blind:
        return f"no force and no known mass reaches it; {hit}"

    why = (
        f"the force on DOF {blind} is unknown and nothing else reaches it; measure the"
        f" force on floor {blind}"
    )
    return f"{why}, or {hit}" if hit else why
