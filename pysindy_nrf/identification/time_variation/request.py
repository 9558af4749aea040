"""Which coefficients may change in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from ...chain.sites import Site
from ...exceptions import ChainError
from ...laws.base import ForceLaw
from ..problem import Problem

AUTO = "auto"
# By storey, labels or symbols of terms; or every storey is tested.
Varying = Mapping[str, Sequence[str] | str] | Mapping[int, Sequence[str] | str]
VaryingSetting = Varying | Literal["auto"]

# Terms of a power series that are tested for change: stiffness and damping.
LINEAR_TERMS = ("s", "v")

# A site and the label of one of its terms.
Place = tuple[Site, str]


def places_to_follow(problem: Problem, varying: VaryingSetting) -> list[Place]:
    """Terms that are named, or of every storey those that are tested.

    Raises
    ------
    ChainError
        If the setting is no mapping, or a site or a term is not in the model.
    """
    if isinstance(varying, str):
        if varying != AUTO:
            raise ChainError(
                f"varying={varying!r} is unknown",
                "Give 'auto' or e.g. {'storey 2': ['s', 'v']}.",
            )
        return _every_place(problem)
    if not isinstance(varying, Mapping) or not varying:
        raise ChainError(
            f"varying={varying!r} names no storey",
            "Give 'auto' or e.g. {'storey 2': ['s', 'v']}.",
        )
    places = []
    for name, terms in varying.items():
        site = problem.chain.site(name)
        for term in [terms] if isinstance(terms, str) else terms:
            places.append((site, _label_of(problem, site, term)))
    return list(dict.fromkeys(places))


def _every_place(problem: Problem) -> list[Place]:
    """Stiffness and damping of power series, and every term of other laws."""
    places: list[Place] = []
    for site in problem.layout.acting:
        labels = problem.layout.labels(site)
        names = _law_of_each_term(problem.laws[site])
        for label, law in zip(labels, names):
            if label in LINEAR_TERMS or law.name != "power_series":
                places.append((site, label))
    return places


def _law_of_each_term(laws: Sequence[ForceLaw]) -> list[ForceLaw]:
    return [law for law in laws for _ in law.terms()]


def _label_of(problem: Problem, site: Site, term: str) -> str:
    """Label of a term that is named by its label or by its symbol."""
    labels = problem.layout.labels(site)
    if term in labels:
        return term
    laws = problem.laws.get(site, ())
    symbols = [of_law.symbol for law in laws for of_law in law.terms()]
    if symbols.count(term) == 1:
        return labels[symbols.index(term)]
    raise ChainError(
        f"varying names the term {term!r} of {site}, which has {', '.join(labels)}",
        "Name one of these, or declare a law with the term in laws=.",
    )
