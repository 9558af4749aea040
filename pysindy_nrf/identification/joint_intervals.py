"""Intervals of coefficients that are estimated together with shape parameters.

With fixed shape parameters, an interval of a coefficient is too narrow: what a shape
parameter may change, the coefficient makes good.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..chain.identifiability import SolveOrder
from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..diagnosis.facts import ShapeAtEnd
from ..equations.accumulation import Whitener
from ..equations.chain_solve import Solution
from ..exceptions import NRFError
from ..records.dataset import Dataset, Segment
from .intervals import Resolver, newey_west
from .problem import Problem
from .shape_derivatives import ShapeDerivatives, shape_derivatives

# Standard errors by which a shape parameter would leave its range that are no chance.
LEAVES = 3.0


@dataclass(frozen=True)
class JointResolver(Resolver):
    """Resolver of masses and coefficients together with free shape parameters.

    Parameters
    ----------
    shapes : ShapeDerivatives
    """

    shapes: ShapeDerivatives = field(kw_only=True)

    @property
    def layout(self) -> LawLayout:
        """Columns of the laws, without the derivatives."""
        return self.shapes.problem.layout

    def model_from(self, solution: Solution) -> ChainModel:
        """Model of a solution with its shape parameters."""
        return self.shapes.model(solution)

    @cached_property
    def steps_over_errors(self) -> np.ndarray:
        """Step from each shape parameter to its joint estimate, in standard errors.

        Shape (n_shapes,); zero for those that are fixed.
        """
        n_pieces = len(self.pieces)
        every_weights = np.vstack([np.ones(n_pieces), 1.0 - np.eye(n_pieces)])
        solutions = self.solutions(every_weights)
        step, *without_piece = map(self.shapes.steps, solutions)
        spread = np.sqrt(np.diag(newey_west(np.array(without_piece), self.record)))
        return np.divide(step, spread, out=np.zeros(len(step)), where=spread > 0)

    @cached_property
    def leaving(self) -> list[int]:
        """Shape parameters at an end of their range whose step leads out of it."""
        ends = self.shapes.search.at_end(self.shapes.u)
        outwards = self.steps_over_errors * ends
        return [int(k) for k in np.flatnonzero(outwards > 0)]

    @property
    def unsettled(self) -> list[tuple[str, float]]:
        """Shape parameters and the steps to their joint estimates, standard errors.

        Those that would leave their range are fixed.
        """
        resolver = self.holding(self.leaving) if self.leaving else self
        steps = np.abs(resolver.steps_over_errors)
        places = []
        for k in resolver.shapes.numbers:
            site, _, shape = self.shapes.search.free[k]
            places.append((f"{shape.name} in {site}", float(steps[k])))
        return places

    def holding(self, numbers: Sequence[int]) -> JointResolver:
        """The same, in which some shape parameters keep their values."""
        shapes = self.shapes.without(numbers)
        layout = shapes.layout
        changes = {}
        for dofs in self.pieces.groups:
            columns_left: list[int] = []
            places = self.pieces.positions(dofs)
            for site, columns in places.sites.items():
                of_site = self.shapes.columns_without(site, numbers)
                columns_left += [columns.start + column for column in of_site]
            if places.mass is not None:
                columns_left.append(places.mass)
            change = np.array([*columns_left, places.target])
            if self.pieces.instrumented:
                change = np.concatenate(
                    [change, places.target + 1 + np.array(columns_left)]
                )
            changes[layout.group(dofs)] = change
        pieces = self.pieces.transformed(layout, changes)
        return replace(self, pieces=pieces, shapes=shapes)


def joint_resolver(
    declared: Problem,
    problem: Problem,
    order: SolveOrder,
    data: Dataset,
    coefficients: Mapping[Site, np.ndarray],
    runs: Sequence[Segment | None] | None = None,
    whiteners: Mapping[tuple[int, ...], Whitener] | None = None,
) -> JointResolver | None:
    """Resolver that frees the shape parameters again; None if no law has any.

    Those at the end of a range of sizes are fixed: their derivatives may vanish there.

    Parameters
    ----------
    declared : Problem
        With the shape parameters that are free.
    problem : Problem
        With values for all of them.
    order : SolveOrder
    data : Dataset
    coefficients : mapping of Site to ndarray
    runs : sequence of Segment or None, optional
        Motions by record whose columns are the instruments.
    whiteners : mapping of tuple of int to Whitener, optional
        By equation.
    """
    shapes = shape_derivatives(declared, problem, data, with_lines=True)
    if shapes is None or problem.optimizer is not None:
        return None
    search = shapes.search
    at_ends = [
        int(k)
        for k in np.flatnonzero(search.at_end(shapes.u))
        if not search.has_limit(int(k))
    ]
    shapes = shapes.without(at_ends)
    if not shapes.numbers:
        return None
    pieces = shapes.pieces(order, data, coefficients, runs, whiteners)
    known_masses = dict(problem.known_masses)
    return JointResolver(pieces, order, known_masses, shapes=shapes)


def shapes_at_ends(
    declared: Problem, problem: Problem, data: Dataset, resolver: Resolver
) -> tuple[ShapeAtEnd, ...]:
    """Shape parameters that ended where their search ends.

    A parameter at the limit of its law, such as a power of 1, is no doubt unless the
    data want one beyond it.

    Parameters
    ----------
    declared : Problem
        With the shape parameters that are free.
    problem : Problem
        With values for all of them.
    data : Dataset
    resolver : Resolver
        Of the intervals.
    """
    shapes = shape_derivatives(declared, problem, data)
    if shapes is None:
        return ()
    leaving: set[tuple[Site, int, str]] = set()
    if isinstance(resolver, JointResolver):
        leaving = _leaving(resolver)

    at_ends = []
    ends = shapes.search.at_end(shapes.u)
    for k in np.flatnonzero(ends):
        site, number, shape = shapes.search.free[k]
        if shapes.search.has_limit(int(k)):
            if (site, number, shape.name) not in leaving:
                continue
        law = problem.laws[site][number]
        value = float(shapes.search.scale.values(shapes.u)[k])
        side = "lower" if ends[k] < 0 else "upper"
        end = ShapeAtEnd(law.name, str(site), shape.name, side, value, shape.unit)
        at_ends.append(end)
    return tuple(at_ends)


def _leaving(resolver: JointResolver) -> set[tuple[Site, int, str]]:
    """Shape parameters that the data want beyond the limit of the law."""
    try:
        leaving = resolver.leaving
    except NRFError:
        # too few pieces, or a piece without which nothing can be solved
        return set()
    places = set()
    for k in leaving:
        if abs(resolver.steps_over_errors[k]) > LEAVES:
            site, number, shape = resolver.shapes.search.free[k]
            places.add((site, number, shape.name))
    return places
