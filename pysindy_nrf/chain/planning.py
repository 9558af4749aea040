"""Plan of the next test: which floors to hit, and where to add a sensor."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypedDict

import numpy as np
import pandas as pd

from .identifiability import SolveOrder
from .sites import dofs_of

if TYPE_CHECKING:
    from .model import ChainModel
    from .structure import Chain

__all__ = ["plan"]

# How tests are ranked: by the share of masses and laws that they identify, then by few
# floors to hit, a strong response of the weakest mode, and a short solve order.
_RANKING = {"identifies": False, "n_hit": True, "response": False, "depth": True}

_NO_TEST = (
    "No floor can be hit with a known force: a known mass is needed to scale the chain."
)


@dataclass(frozen=True)
class Plan:
    """Tests of a chain, the best first, and advice in words.

    Parameters
    ----------
    table : DataFrame
        One row for each test: ``hit`` (floors), ``identifies`` (share of masses and
        laws), ``depth`` (balances through which an error travels), ``response`` (of the
        weakest mode, as a share of what the best floor gives) and ``left`` (what stays
        unknown).
    advice : list of str
    """

    table: pd.DataFrame
    advice: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return "\n".join(self.advice)


class PlanOptions(TypedDict, total=False):
    """Arguments of :func:`plan` besides the chain."""

    can_hit: int | Iterable[int] | None
    sensors: int | Iterable[int] | None
    unknown: int | Iterable[int]
    known_masses: int | Iterable[int]
    model: ChainModel | None
    max_floors: int


def plan(
    chain: Chain,
    *,
    can_hit: int | Iterable[int] | None = None,
    sensors: int | Iterable[int] | None = None,
    unknown: int | Iterable[int] = (),
    known_masses: int | Iterable[int] = (),
    model: ChainModel | None = None,
    max_floors: int = 2,
) -> Plan:
    """Plan floors to hit and sensors to add so that masses and laws can be identified.

    Parameters
    ----------
    chain : Chain
    can_hit, sensors : int or iterable of int, optional
        Floors that a hammer or shaker reaches, and floors whose motion is measured; all
        if None.
    unknown, known_masses : int or iterable of int
        DOFs on which an unmeasured force acts, and DOFs whose mass is known.
    model : ChainModel, optional
        A first guess; floors are then ranked by how well its modes respond to a blow
        there.
    max_floors : int
        Floors hit at most (in one record, or one after another).

    Returns
    -------
    Plan

    Raises
    ------
    ChainError
        If a floor that is named is not in the chain.

    Examples
    --------
    >>> from pysindy_nrf import Chain
    >>> from pysindy_nrf.chain.planning import plan
    >>> print(plan(Chain(3), can_hit=[1, 3], unknown=[2]).advice[0])
    Hit floor 1 and 3: out of reach remain m2.
    """
    reachable = _floors("can_hit", can_hit, chain.n_dof)
    measured = _floors("sensors", sensors, chain.n_dof)
    disturbed = _floors("unknown", unknown, chain.n_dof)
    known_masses = tuple(dofs_of("known_masses", known_masses, chain.n_dof))

    usable = [floor for floor in reachable if floor not in disturbed]
    rows = []
    for n_hit in range(1, max_floors + 1):
        for floors in itertools.combinations(usable, n_hit):
            order = chain.identifiability(
                floors,
                unknown=disturbed,
                known_masses=known_masses,
                strategy="sequential",
            )
            rows.append(_ranked_test(chain, floors, order, model))

    table = pd.DataFrame(rows, columns=["hit", "left", *_RANKING])
    table = table.sort_values(
        list(_RANKING), ascending=list(_RANKING.values()), ignore_index=True
    )
    table = table[["hit", "identifies", "depth", "response", "left"]]
    if table.empty:
        return Plan(table, [_NO_TEST])

    best = table.iloc[0]
    advice = [_what_to_hit(best, measured, chain.n_dof, model)]
    advice += _where_to_measure(chain, measured, best["hit"], known_masses, model)
    if len(best["hit"]) < chain.n_dof and best["identifies"] == 1:
        advice.append(
            "Hitting every floor once, each in a separate record, lets each balance"
            " be solved by itself, and the two estimates of each storey check each"
            " other."
        )
    return Plan(table, advice)


def _floors(
    name: str, floors: int | Iterable[int] | None, n_dof: int
) -> tuple[int, ...]:
    """Floors that an argument names, in order; all if it is None."""
    if floors is None:
        return tuple(range(1, n_dof + 1))
    return tuple(sorted(set(dofs_of(name, floors, n_dof))))


def _ranked_test(
    chain: Chain, floors: tuple[int, ...], order: SolveOrder, model: ChainModel | None
) -> dict[str, object]:
    """One row of the table: what a test that hits these floors can identify."""
    missing = [f"m{j}" for j in order.missing_masses]
    missing += [str(site) for site in order.missing_sites]
    n_unknown = chain.n_dof + len(chain.sites)
    return {
        "hit": floors,
        "left": ", ".join(missing),
        "identifies": 1 - len(missing) / n_unknown,
        "n_hit": len(floors),
        "response": _weakest_response(model, floors),
        "depth": _depth(order),
    }


def _depth(order: SolveOrder) -> int:
    """Most balances one after another through which an error travels."""
    depth_after: dict[object, int] = {}
    deepest = 0

    for step in order.steps:
        before = [depth_after.get(site, 0) for site in step.known_sites]
        depth = 1 + max(before, default=0)
        depth_after |= dict.fromkeys([*step.sites, step.name], depth)
        deepest = max(deepest, depth)

    return deepest


def _weakest_response(model: ChainModel | None, floors: Sequence[int]) -> float:
    """Response of the mode that blows on these floors excite least.

    As a share of its response to a blow on the best floor; NaN without a model.
    """
    if model is None:
        return np.nan
    shapes = np.abs(model.modes().filter(like="dof ").to_numpy())
    hit = shapes[:, np.array(floors) - 1].max(axis=1)
    return float((hit / shapes.max(axis=1)).min())


def _what_to_hit(
    best: pd.Series, measured: Sequence[int], n_dof: int, model: ChainModel | None
) -> str:
    """The best test in words."""
    floors = " and ".join(map(str, best["hit"]))
    if best["identifies"] == 1:
        everywhere = "" if len(measured) == n_dof else ", with a sensor on every floor"
        text = (
            f"Hit floor {floors}{everywhere}: every mass and law can be found; an error"
            f" travels through {best['depth']} balances at most."
        )
    else:
        text = f"Hit floor {floors}: out of reach remain {best['left']}."

    if model is not None:
        text += (
            f" The weakest mode still gets {100 * best['response']:.0f} % of what the"
            " best floor would give it."
        )
    return text


def _where_to_measure(
    chain: Chain,
    measured: Sequence[int],
    hit: Sequence[int],
    known_masses: Sequence[int],
    model: ChainModel | None,
) -> list[str]:
    """Advice on floors without a sensor; empty if there are none."""
    unmeasured = [str(j) for j in range(1, chain.n_dof + 1) if j not in measured]
    if not unmeasured:
        return []
    floors_have = "Floors {} have" if len(unmeasured) > 1 else "Floor {} has"
    advice = [
        f"{floors_have.format(', '.join(unmeasured))} no sensor: the fit then compares"
        " the free run with the sensors of the others."
    ]
    if measured:
        sensing = chain.sensing(measured, hit, known_masses=known_masses, model=model)
        advice.append(str(sensing))
    return advice
