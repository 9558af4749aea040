"""The effects that stand in the final model: their parameters, what noise does to these, whether the name is sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..mechanics.sites import Site
from ..regression.chain_solve import Solution
from .away_from_rest import jumping
from .catalogue import balances_of
from .intervals import intervals
from .leftover import leftover
from .prepare import Prepared
from .report import Step
from .search import Finding
from .second_opinion import unbiased
from .stage import Stage
from .steps import SURE
from .surrogate import Null

# Shares of a mass or a site's force, and of a coefficient, that noise may take before it is said.
_BIASED, _WRONG = 0.02, 0.1


@dataclass
class Standing:
    """An accepted effect, the step that tells of it, and the place of its law in the final model."""

    finding: Finding
    step: Step
    place: tuple[Site, int]

    def coefficients(self, stage: Stage, solution: Solution) -> np.ndarray:
        """Those of its law in a solution of the chain."""
        site, i = self.place
        at = stage.at[self.place] - stage.layout.slices[site].start
        return solution.coefficients[site][at : at + len(stage.laws[site][i].terms())]

    def jumping(self, stage: Stage) -> list[str]:
        """Symbols of those that belong to a force that jumps where the rate changes its sign."""
        site, i = self.place
        first = stage.at[self.place] - stage.layout.slices[site].start
        own = {first + k: term.symbol for k, term in enumerate(stage.laws[site][i].terms())}
        return [own[at] for where, at in jumping(stage) if where == site and at in own]

    def parameters(self, stage: Stage, solution: Solution) -> dict[str, float | None]:
        """Coefficients in a solution, and shape parameters."""
        site, i = self.place
        return stage.laws[site][i].with_values(self.coefficients(stage, solution)).parameters


def estimate(effects: Sequence[Standing], stage: Stage, null: Null) -> Solution:
    """Parameters of every effect in the final model, their intervals, and what noise alone does to them."""
    blocks, fitted = range(len(stage.work.search)), null.fitted(stage)
    draws = [null.fitted(draw) for draw in null.stages]
    found = fitted.trial().solve(blocks)
    for one in effects:
        theta = one.coefficients(stage, found)
        begun = None if null.truth is None else one.coefficients(stage, null.truth)
        one.step.parameters = one.parameters(stage, found)
        law = one.finding.candidate.law
        one.step.intervals, one.step.bias = intervals(fitted, one.place, law, theta, draws, begun)
        if null.away is not None and (names := one.jumping(stage)):
            plain = one.parameters(stage, stage.trial().solve(blocks))
            others = ", ".join(f"{name} = {plain[name]:.4g}" for name in names)
            one.step.evidence += "; estimated without the samples next to rest, where its sign is least certain "
            one.step.evidence += f"(with them {others})"
    return found


def wrong_by_noise(effects: Sequence[Standing], stage: Stage, null: Null, ready: Prepared) -> list[str]:
    """What noise alone makes wrong in the final model, in words; of an effect with what instruments say instead."""
    said = [f"{100 * null.error:.0f} % in a mass or a site's force"] if null.error >= _BIASED else []
    wrong = []
    for one in effects:
        told = {k: abs(b) for k, b in one.step.bias.items() if not _holds_zero(one.step.intervals.get(k))}
        name = max(told, key=told.__getitem__, default="")
        if name and told[name] >= _WRONG:
            wrong.append((one, name))
    other = unbiased(stage, ready) if wrong else None
    for one, name in wrong:
        said.append(f"{100 * abs(one.step.bias[name]):.0f} % in {name} of {one.step.law} at {one.step.site}")
        if other is not None:
            said[-1] += f" (instrumental variables: {one.parameters(stage, other)[name]:.4g})"
    return said


def _holds_zero(interval: tuple[float, float] | None) -> bool:
    """Whether a parameter may as well be nothing: a share of it then says nothing."""
    return interval is not None and interval[0] <= 0.0 <= interval[1]


def doubt_what_is_drawn(effects: Sequence[Standing], stage: Stage, null: Null, clean: bool) -> None:
    """No name is sure of an effect that leaves in its balances what is a function of the motion there."""
    if not null.stages and not clean:
        return  # what noise alone draws there is not known
    together: dict[Any, list[Standing]] = {}
    for one in sorted(effects, key=lambda e: e.finding.site.kind == "dof"):  # the motion of a storey says more
        together.setdefault(balances_of(one.finding.site), []).append(one)
    for group in together.values():
        left = leftover(stage, null.stages, [one.place for one in group])
        for one in group:
            one.step.remainder = max(one.step.remainder, left)
            one.step.sure = one.step.sure and left <= SURE
