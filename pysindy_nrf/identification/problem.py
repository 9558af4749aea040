"""The identification problem: a chain, its force laws and all that is known of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import NamedTuple

from .. import laws as catalogue
from ..chain.identifiability import SolveOrder, plan_solve_order
from ..chain.layout import Block, LawLayout, declared_laws, power_series_laws
from ..chain.model import ChainModel
from ..chain.sites import Site, dofs_of
from ..chain.structure import Chain, chain_of, masses_of
from ..equations import chain_solve
from ..equations.balances import States, blocks_of_segment
from ..equations.inner_optimizer import (
    KeptTerms,
    Optimizer,
    balance_optimizer,
    needs_samples,
)
from ..equations.normal_equations import NormalEquations
from ..equations.shape_search import estimate_shapes
from ..exceptions import ChainError, LawError
from ..laws import ForceLaw
from ..records.dataset import Dataset
from ..records.input_arrays import from_arrays
from ..records.record import Record
from ..records.zero_phase_filter import ZeroPhaseFilter, edges_of, filters_of
from .constraints import constrained
from .intervals import least_squares_resolver
from .parameters import Parameter, as_parameters

DEFAULT_DEGREE = 3
# Settings of ``estimation`` that begin with least squares.
LEAST_SQUARES = ("auto", "ls")

Filters = list[ZeroPhaseFilter | None]
# Degree h + j of the terms v^h s^j, or the box (k, q) of both.
Order = int | tuple[int, int]
# By site, as a user spells it.
Orders = Mapping[str, Order] | Mapping[int, Order]
DeclaredLaws = (
    Mapping[str, ForceLaw | Sequence[ForceLaw]]
    | Mapping[int, ForceLaw | Sequence[ForceLaw]]
)
LawsBySite = (
    Mapping[str, Iterable[ForceLaw]]
    | Mapping[Site, Iterable[ForceLaw]]
    | Mapping[str | int, Iterable[ForceLaw]]
)


@dataclass(frozen=True)
class Problem:
    """An identification problem; it does not change.

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
    known_masses, band, strategy, optimizer, constraints
        See :class:`NRFRegressor`.
    start : mapping of str to sequence of ForceLaw, optional
        The same laws with values of all shape parameters, from which an estimate of
        those that are free starts; they are searched for if None.

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
    optimizer: Optimizer | None = None
    constraints: Mapping[str, Parameter] = field(default_factory=dict)
    start: Mapping[Site, tuple[ForceLaw, ...]] | None = None

    def __post_init__(self) -> None:
        chain = chain_of(self.chain, 0).with_links(self.laws)
        laws: dict[Site, tuple[ForceLaw, ...]] = dict.fromkeys(chain.sites, ())
        laws |= _by_site(chain, self.laws)
        known_masses = masses_of(self.known_masses, chain)

        self._set("chain", chain)
        self._set("laws", MappingProxyType(laws))
        self._set("known_masses", MappingProxyType(known_masses))
        self._set("optimizer", balance_optimizer(self.optimizer))
        self._set("constraints", MappingProxyType(as_parameters(self.constraints)))
        if self.excited is not None:
            self._set("excited", dofs_of("excited", self.excited, chain.n_dof))

    def _set(self, name: str, value: object) -> None:
        """Store a value in its canonical form, once, after construction."""
        object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[type[Problem], tuple[object, ...]]:
        values = []
        for parameter in fields(self):
            value = getattr(self, parameter.name)
            if isinstance(value, MappingProxyType):
                value = dict(value)
            values.append(value)
        return type(self), tuple(values)

    @cached_property
    def layout(self) -> LawLayout:
        """Columns of the laws, site by site."""
        return LawLayout(self.chain, self.laws)

    @property
    def every_law(self) -> list[ForceLaw]:
        """The laws of all sites."""
        return [law for group in self.laws.values() for law in group]

    @property
    def has_free_shapes(self) -> bool:
        """Whether a law has a shape parameter without a value."""
        return any(law.free_shape for law in self.every_law)

    @property
    def needs_clock(self) -> bool:
        """False for an element without mass whose laws depend on the path alone."""
        known = [self.known_masses.get(j + 1) for j in range(self.chain.n_dof)]
        massless = known == [0] * self.chain.n_dof
        return not massless or any(law.rate_dependent for law in self.every_law)

    def with_laws(self, laws: LawsBySite) -> Problem:
        """The same problem with other laws at some sites.

        Parameters
        ----------
        laws : mapping of str to sequence of ForceLaw
        """
        return replace(self, laws=dict(self.laws) | _by_site(self.chain, laws))

    def along(self, data: Record | Dataset) -> Problem:
        """The same problem of a chain that rotates, where the data are rotations.

        Parameters
        ----------
        data : Record or Dataset

        Returns
        -------
        Problem
        """
        if self.chain.rotates or not data.rotates:
            return self
        return replace(self, chain=self.chain.of_rotations())

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
        order = plan_solve_order(
            self.chain,
            forced if self.excited is None else self.excited,
            unknown,
            self.known_masses,
            self.strategy,
            self.layout.acting,
            self.optimizer is not None,
        )
        return order.require_complete()

    def filters(self, data: Dataset) -> Filters:
        """Zero-phase filters of the band, one for each record; None without a band.

        Parameters
        ----------
        data : Dataset
        """
        return filters_of(self.band, data)

    def normal_equations(self, data: Dataset, order: SolveOrder) -> NormalEquations:
        """Sums of the balances over the data.

        Parameters
        ----------
        data : Dataset
        order : SolveOrder
            Its balances are summed up; all shape parameters have values.
        """
        return _solution(self, self.layout, order, data, self.filters(data))[1]

    def solve(self, data: Record | Sequence[Record] | Dataset) -> Estimate:
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
        fused = from_arrays(
            data, n_dof=self.chain.n_dof, has_memory=self.layout.has_memory
        )
        estimate = least_squares(self.along(fused), fused)
        if not self.constraints:
            return estimate
        resolver = least_squares_resolver(estimate.problem, estimate.order, fused)
        model, _ = constrained(estimate.model, self.constraints, resolver)
        return estimate._replace(model=model)


def _by_site(chain: Chain, laws: LawsBySite) -> dict[Site, tuple[ForceLaw, ...]]:
    """Laws by the sites of the chain, however they are spelled."""
    return {chain.site(site): tuple(group) for site, group in laws.items()}


class Estimate(NamedTuple):
    """Least-squares estimate of a :class:`Problem`.

    Attributes
    ----------
    problem : Problem
        With values for all shape parameters.
    order : SolveOrder
        The order in which the balances were solved.
    model : ChainModel
    solution : Solution
    grams : NormalEquations
        The sums from which the solution was taken.
    declared : Problem, optional
        As declared, where it has free shape parameters.
    """

    problem: Problem
    order: SolveOrder
    model: ChainModel
    solution: chain_solve.Solution
    grams: NormalEquations
    declared: Problem | None = None


def least_squares(
    problem: Problem, data: Dataset, forced: tuple[int, ...] | None = None
) -> Estimate:
    """Masses, shape parameters and coefficients, whatever the constraints are.

    ``forced`` are the DOFs that a force drives, those with a force if None.
    """
    driven = data.forced if forced is None else forced
    order = problem.solve_order(driven, data.unknown)
    chain_solve.require_samples(data, order, problem.layout)
    chain_solve.require_moving(data, problem.layout)
    chain_solve.require_clock(data, problem.layout)
    _require_constants_in_band(problem)

    filters = problem.filters(data)
    declared = problem if problem.has_free_shapes else None
    problem = _with_shapes(problem, order, data, filters)
    solution, sums = _solution(problem, problem.layout, order, data, filters)
    solution.pass_on()
    model = chain_solve.model_of(problem.layout, solution)
    followed = solution.followed(order)
    if needs_samples(problem.optimizer):
        problem = replace(problem, optimizer=KeptTerms.of(solution.inner))
    return Estimate(problem, followed, model, solution, sums, declared)


def _require_constants_in_band(problem: Problem) -> None:
    """Refuse constant forces where the band leaves out 0 Hz."""
    low = None if problem.band is None else edges_of(problem.band)[0]
    if not low:
        return
    for site, group in problem.laws.items():
        for law in group:
            if law.variable == "1":
                raise LawError(
                    f"{law.name} at {site} cannot be seen in a band that begins at"
                    f" {low:g} Hz",
                    "Leave out the lower edge of the band, or the law.",
                )


def _with_shapes(
    problem: Problem, order: SolveOrder, data: Dataset, filters: Filters
) -> Problem:
    """The problem with values for the shape parameters that are free."""
    if not problem.has_free_shapes:
        return problem
    if problem.start is not None:
        return replace(problem, laws=problem.start, start=None)

    def solved(layout: LawLayout) -> tuple[chain_solve.Solution, NormalEquations]:
        return _solution(problem, layout, order, data, filters)

    scales = chain_solve.scales_of(data, problem.layout)
    with_shapes = estimate_shapes(problem.layout, scales, solved, data, filters)
    return problem.with_laws(with_shapes.laws)


def _solution(
    problem: Problem,
    layout: LawLayout,
    order: SolveOrder,
    data: Dataset,
    filters: Filters,
) -> tuple[chain_solve.Solution, NormalEquations]:
    """Solution for a layout whose laws have all their shape parameters."""
    blocks = partial(blocks_of, data, filters, layout, in_pieces=True)
    return chain_solve.solve_blocks(
        layout, order, blocks, problem.known_masses, problem.optimizer
    )


def blocks_of(
    data: Dataset,
    filters: Iterable[ZeroPhaseFilter | None],
    layout: LawLayout,
    in_pieces: bool = False,
) -> Iterator[Block]:
    """Columns of all balances, record by record.

    ``in_pieces``: also where laws have memory and nothing is filtered.
    """
    for segment, band_pass in zip(data.segments, filters):
        states: States | None = None
        if in_pieces and band_pass is None:
            states = {}
        yield from blocks_of_segment(segment, layout, filter=band_pass, states=states)


def flexible_laws(
    problem: Problem, drifts: Mapping[Site, float]
) -> dict[Site, list[ForceLaw]]:
    """The laws of a problem with friction, damping, springs and sliders at every site.

    Parameters
    ----------
    problem : Problem
    drifts : mapping of Site to float
        Rms of the drift, m, which gives the sliders their size.
    """
    out = {site: list(group) for site, group in problem.laws.items()}
    for site in problem.chain.sites:
        laws = out.setdefault(site, [])
        labels = {term.label for law in laws for term in law.terms()}
        for law in _general_laws(drifts.get(site, 0.0), problem.needs_clock):
            terms = {term.label for term in law.terms()}
            if labels.isdisjoint(terms):
                laws.append(law)
                # sliders of two sizes have the same terms
                labels |= set() if law.shapes else terms
    return out


def _general_laws(drift: float, has_clock: bool) -> list[ForceLaw]:
    """Laws that together can follow nearly any force over a drift of some rms, m."""
    laws: list[ForceLaw] = [
        catalogue.CoulombFriction(),
        catalogue.QuadraticDamping(),
        catalogue.DisplacementDependentDamping(),
        catalogue.QuadraticStiffness(),
        catalogue.AbsoluteQuadraticStiffness(),
        catalogue.CubicStiffness(),
    ]
    if drift > 0:
        laws += [catalogue.Jenkins(uy=0.5 * drift), catalogue.Jenkins(uy=1.5 * drift)]
    return [law for law in laws if has_clock or not law.rate_dependent]


def law_list(laws: DeclaredLaws | None) -> list[ForceLaw]:
    """The laws that a user declared, of all sites."""
    return [law for group in declared_laws(laws).values() for law in group]


def laws_of_sites(
    chain: Chain, laws: DeclaredLaws | None, degree: Order, orders: Orders | None
) -> dict[Site, tuple[ForceLaw, ...]]:
    """The declared laws by site of the chain, and the power series at its other sites.

    Raises
    ------
    ChainError
        If a site has an order and laws, or ``degree`` contradicts the orders.
    """
    series = _by_site(chain, power_series_laws(chain, degree, orders))
    declared = _by_site(chain, declared_laws(laws))
    ordered = {chain.site(site): order for site, order in (orders or {}).items()}
    for site in ordered:
        if site in declared:
            raise ChainError(
                f"{site} has an order and laws",
                "Name it in orders or in laws, not in both.",
            )
    every_site_is_named = set(chain.sites) <= {*ordered, *declared}
    if degree != DEFAULT_DEGREE and every_site_is_named:
        _refuse_degree(chain, degree, ordered)
    return series | declared


def _refuse_degree(chain: Chain, degree: Order, orders: Mapping[Site, Order]) -> None:
    """Refuse a degree that no storey has; one that every order repeats is no harm."""
    if all(order == degree for order in orders.values()):
        return
    site = min(orders, key=chain.sites.index)
    raise ChainError(
        f"degree={degree!r} contradicts orders, which set every storey ({site}:"
        f" {orders[site]!r})",
        "Leave degree out, or name in orders only the storeys that differ.",
    )
