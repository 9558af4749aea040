"""The identification problem: a chain, its force laws, what is known, and its
least-squares solve.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, NamedTuple

from .. import laws
from ..chain.identifiability import SolveOrder, plan_solve_order
from ..chain.layout import Block, LawLayout, declared_laws, power_series_laws
from ..chain.model import ChainModel
from ..chain.sites import Site, dofs_of
from ..chain.structure import Chain, chain_of, masses_of
from ..equations import chain_solve
from ..equations.balances import blocks_of_segment
from ..equations.errors import balance_errors
from ..equations.inner_optimizer import balance_optimizer
from ..equations.normal_equations import NormalEquations
from ..equations.shape_search import estimate_shapes
from ..exceptions import ChainError, NRFError, NRFWarning
from ..laws import ForceLaw
from ..records.dataset import Dataset
from ..records.input_arrays import from_arrays
from ..records.zero_phase_filter import ZeroPhaseFilter, filters_of

DEFAULT_DEGREE = 3
# Of 36 shaken chains with one mass 20 % wrong all are named, of 18 with right ones
# none: freed, a right mass leaves what was left or more, a wrong one among right ones
# at most 74 %.
SHRINKS, ANOTHER = 0.8, 0.03
# Settings of ``estimation`` that begin with least squares and need no motion made for
# them.
LEAST_SQUARES = ("auto", "ls")


@dataclass(frozen=True)
class Problem:
    """An identification problem: the chain, its laws, and all that is known; it does
    not change.

    .. math:: m_j a_j + R_j(v_j, s_j) - R_{j+1}(v_{j+1}, s_{j+1}) = F_j

    :meth:`NRFRegressor.problem` builds it from the parameters of an estimator, and a
    fitted estimator has it as ``problem_``, with the shape parameters that were found.

    Parameters
    ----------
    chain : Chain
        Links at which ``laws`` act are added to it.
    laws : mapping of str to sequence of ForceLaw
        By site; a storey without an entry transmits no force.
    excited : int or iterable of int, optional
        DOFs whose measured force scales the chain; those with a force that is not zero
        if None.
    known_masses, band, strategy, optimizer
        See :class:`NRFRegressor`.

    Raises
    ------
    ChainError
        If a site or DOF is not in the chain, or a known mass is not a mass.

    Examples
    --------
    >>> from pysindy_nrf import Chain, Problem, datasets, laws
    >>> cubic = laws.PowerSeries(3)
    >>> problem = Problem(
    ...     Chain(3),
    ...     {"storey 1": [cubic], "storey 2": [cubic], "storey 3": [cubic]},
    ... )
    >>> problem.solve(datasets.load_demo()).model.masses.round(1)
    array([12., 10.,  8.])
    """

    chain: Chain
    laws: Mapping[Site, tuple[ForceLaw, ...]]
    known_masses: Mapping[int, float] = field(default_factory=dict)
    band: tuple[float | None, float | None] | None = None
    strategy: str = "auto"
    excited: int | tuple[int, ...] | None = None
    optimizer: Any = None

    def __post_init__(self) -> None:
        chain = chain_of(self.chain, 0).with_links(self.laws)
        given = {chain.site(s): tuple(held) for s, held in self.laws.items()}
        laws = {s: given.get(s, ()) for s in chain.sites} | given
        for name, value in (
            ("chain", chain),
            ("laws", MappingProxyType(laws)),
            ("known_masses", MappingProxyType(masses_of(self.known_masses, chain))),
            (
                "excited",
                (
                    None
                    if self.excited is None
                    else dofs_of("excited", self.excited, chain.n_dof)
                ),
            ),
            ("optimizer", balance_optimizer(self.optimizer)),
        ):
            object.__setattr__(self, name, value)

    def __reduce__(self) -> Any:
        held = (getattr(self, one.name) for one in fields(self))
        return type(self), tuple(
            dict(value) if isinstance(value, MappingProxyType) else value
            for value in held
        )

    @property
    def needs_clock(self) -> bool:
        """False for an element without mass whose laws depend on the path alone."""
        massless = all(
            self.known_masses.get(j) == 0 for j in range(1, self.chain.n_dof + 1)
        )
        return not massless or any(
            law.rate_dependent for held in self.laws.values() for law in held
        )

    @cached_property
    def layout(self) -> LawLayout:
        """Columns of the laws, site by site."""
        return LawLayout(self.chain, self.laws)

    def with_laws(self, laws: Mapping[Any, Iterable[ForceLaw]]) -> Problem:
        """The same problem with other laws at some sites.

        Parameters
        ----------
        laws : mapping of str to sequence of ForceLaw
        """
        return replace(
            self,
            laws={
                **self.laws,
                **{self.chain.site(s): tuple(held) for s, held in laws.items()},
            },
        )

    def with_known_masses(self, known_masses: Mapping[int, float]) -> Problem:
        """The same problem with these masses known, and no other.

        Parameters
        ----------
        known_masses : mapping of int to float
            kg, by DOF.
        """
        return replace(self, known_masses=known_masses)

    def solve_order(
        self, forced: int | Iterable[int], unknown: int | Iterable[int] = ()
    ) -> SolveOrder:
        """Balances in the order in which they are solved.

        Parameters
        ----------
        forced, unknown : int or iterable of int
            DOFs with a force that is not zero (``excited`` stands in for them where it
            is given) and of unknown force.

        Raises
        ------
        ExcitationError, IdentifiabilityError
            If nothing scales the chain (no force and no known mass), or a mass or a law
            is out of reach.
        """
        forced = forced if self.excited is None else self.excited
        given = (
            self.known_masses,
            self.strategy,
            self.layout.acting,
            self.optimizer is not None,
        )
        return plan_solve_order(self.chain, forced, unknown, *given).require_complete()

    def filters(self, data: Dataset) -> list[ZeroPhaseFilter | None]:
        """Zero-phase filters of the band, one for each record; None without a band.

        Parameters
        ----------
        data : Dataset
        """
        return filters_of(self.band, data)

    def solve(self, data: Any) -> Estimate:
        """Masses, shape parameters and coefficients by least squares.

        Parameters
        ----------
        data : Record, list of Record or Dataset

        Raises
        ------
        ChannelError, ExcitationError, IdentifiabilityError
            If a channel is constant, there are fewer samples than unknowns, or as for
            :meth:`solve_order`.
        """
        data = from_arrays(
            data, n_dof=self.chain.n_dof, has_memory=self.layout.has_memory
        )
        order = self.solve_order(data.forced, data.unknown)
        chain_solve.require_samples(data, order, self.layout)
        chain_solve.require_moving(data, self.layout)
        chain_solve.require_clock(data, self.layout)
        filters = self.filters(data)
        problem = self
        if any(law.free_shape for held in self.laws.values() for law in held):
            scales = chain_solve.scales_of(data, self.layout)
            # noqa: E731
            tried = lambda laws: _least_squares(self, laws, order, data, filters)
            problem = self.with_laws(
                estimate_shapes(self.layout, scales, tried, data, filters).laws
            )
        solution, grams = _least_squares(problem, problem.layout, order, data, filters)
        solution.pass_on(stacklevel=4)
        model = chain_solve.model_of(problem.layout, solution)
        return Estimate(problem, solution.followed(order), model, solution, grams)


class Estimate(NamedTuple):
    """Least-squares estimate of a :class:`Problem`."""

    problem: Problem  # with values for all shape parameters
    order: SolveOrder  # the order in which the balances were solved
    model: ChainModel
    solution: chain_solve.Solution
    grams: NormalEquations  # of which the solution was taken


def _least_squares(
    problem: Problem,
    layout: LawLayout,
    order: SolveOrder,
    data: Dataset,
    filters: list[ZeroPhaseFilter | None],
) -> tuple[chain_solve.Solution, NormalEquations]:
    """Solution for a layout whose laws have all their shape parameters."""
    blocks = partial(blocks_of, data, filters, layout, in_pieces=True)
    return chain_solve.solve_blocks(
        layout, order, blocks, problem.known_masses, problem.optimizer
    )


def blocks_of(
    data: Dataset, filters: Iterable[Any], layout: LawLayout, in_pieces: bool = False
) -> Iterator[Block]:
    """Columns of all balances, record by record; ``in_pieces`` also where laws have
    memory and nothing is filtered.
    """
    for segment, filter in zip(data.segments, filters):
        yield from blocks_of_segment(
            segment,
            layout,
            filter=filter,
            states={} if in_pieces and filter is None else None,
        )


def wrong_masses(problem: Problem, data: Dataset, error: float) -> list[str]:
    """A sentence on known masses that the others contradict: left free, they explain
    most of what is left.
    """
    known = {j: mass for j, mass in problem.known_masses.items() if mass}
    freed: dict[int, tuple[float, float]] = {}
    for j in known if len(known) > 1 else ():
        with (
            suppress(NRFError),
            warnings.catch_warnings(action="ignore", category=NRFWarning),
        ):
            found = problem.with_known_masses(
                {i: m for i, m in problem.known_masses.items() if i != j}
            ).solve(data)
            left = float(
                balance_errors(found.model, found.grams).loc["pooled", "error"]
            )
            if (
                left < SHRINKS * error
                and abs(found.model.masses[j - 1] / known[j] - 1) > ANOTHER
            ):
                freed[j] = left, float(found.model.masses[j - 1])
    if not freed:
        return []
    best = min(freed.values())[0]
    ranked = [
        j for j in sorted(freed, key=lambda j: freed[j]) if freed[j][0] < 1.5 * best
    ]
    said = "; or ".join(
        f"m{j} is {freed[j][1]:.4g} kg, not {known[j]:.4g}" for j in ranked
    )
    return [
        f"The known masses contradict each other: left free, {said}; and {best:.2g} %"
        f" of the balances is unexplained instead of {error:.2g} %. Weigh it again."
    ]


def flexible_laws(
    problem: Problem, drifts: Mapping[Site, float]
) -> dict[Site, list[ForceLaw]]:
    """The laws of a problem with friction, damping, springs and, by the rms of drifts,
    sliders at every site.
    """
    out = {site: list(held) for site, held in problem.laws.items()}
    for site in problem.chain.sites:
        labels = {t.label for law in out.setdefault(site, []) for t in law.terms()}
        for law in (
            laws.CoulombFriction(),
            laws.QuadraticDamping(),
            laws.DisplacementDependentDamping(),
            laws.QuadraticStiffness(),
            laws.AbsoluteQuadraticStiffness(),
            laws.CubicStiffness(),
            *(
                laws.Jenkins(uy=share * drifts[site])
                for share in (0.5, 1.5)
                if drifts.get(site, 0.0) > 0
            ),
        ):
            if labels.isdisjoint(t.label for t in law.terms()) and (
                problem.needs_clock or not law.rate_dependent
            ):
                out[site].append(law)
                labels |= {t.label for t in law.terms()} if not law.shapes else set()
    return out


def law_list(laws: Any) -> list[ForceLaw]:
    """The laws that a user declared, of all sites."""
    return [law for held in declared_laws(laws).values() for law in held]


def laws_of_sites(
    chain: Chain, laws: Any, degree: Any, orders: Any
) -> dict[Site, tuple[ForceLaw, ...]]:
    """The declared laws by site of the chain, and the power series at its other
    sites.
    """
    series = power_series_laws(chain, degree, orders)
    orders = {chain.site(s): order for s, order in (orders or {}).items()}
    given = {chain.site(s): held for s, held in declared_laws(laws).items()}
    if both := [s for s in orders if s in given]:
        raise ChainError(
            f"{both[0]} has an order and laws",
            "Name it in orders or in laws, not in both.",
        )
    every = degree != DEFAULT_DEGREE and all(
        s in orders or s in given for s in chain.sites
    )
    if every and any(order != degree for order in orders.values()):
        clash = next(s for s in chain.sites if s in orders)
        what = (
            f"degree={degree!r} contradicts orders, which set every storey ({clash}:"
            f" {orders[clash]!r})"
        )
        raise ChainError(
            what, "Leave degree out, or name in orders only the storeys that differ."
        )
    return {s: tuple(held) for s, held in series.items()} | given
