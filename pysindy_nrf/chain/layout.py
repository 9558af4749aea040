"""Columns of the equations of motion: which belongs to which mass, site and term."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ..exceptions import ChainError, LawError
from ..laws.base import ForceLaw
from ..laws.shape import Motion
from .blocks import Block, block_size, blocks_of, cut_at
from .laws_by_site import (
    declared_laws,
    distinct_labels,
    power_series_laws,
    with_coefficients,
)
from .recipe import MONOMIAL, Recipe, copies, recipe_of
from .sites import Named, Site
from .structure import Chain

__all__ = [
    "Block",
    "Group",
    "LawLayout",
    "Layout",
    "Recipe",
    "block_size",
    "blocks_of",
    "copies",
    "cut_at",
    "declared_laws",
    "power_series_laws",
    "with_coefficients",
]


@dataclass(frozen=True)
class Group:
    """One equation of motion, or several summed, and the sites whose laws stand in it.

    Attributes
    ----------
    dofs : tuple of int
    sites : tuple of Site
    signs : tuple of int
        +1 or -1 for each site.
    """

    dofs: tuple[int, ...]
    sites: tuple[Site, ...]
    signs: tuple[int, ...]


class Layout:
    """Columns of a chain's equations of motion: so many terms at each site.

    Sites beyond the chain's own follow in the order given.
    """

    def __init__(self, chain: Chain, terms: Mapping[Named, int]) -> None:
        widths = {chain.site(text): int(count) for text, count in terms.items()}
        sites = tuple(dict.fromkeys([*chain.sites, *widths]))
        for site in sites:
            if site.kind == "sensor":
                cure = "Use a storey, link, ground or dof site."
                raise ChainError(f"{str(site)!r} is not a place for a force law", cure)

        self.chain = chain
        self.n_dof = chain.n_dof
        self.sites: tuple[Site, ...] = sites
        self.counts: dict[Site, int] = {}
        self.slices: dict[Site, slice] = {}
        self.n_terms = 0
        for site in sites:
            count = widths.get(site, 0)
            self.counts[site] = count
            self.slices[site] = slice(self.n_terms, self.n_terms + count)
            self.n_terms += count

    @cached_property
    def acting(self) -> tuple[Site, ...]:
        """Sites that have at least one term."""
        return tuple(site for site in self.sites if self.counts[site])

    def labels(self, site: str) -> list[str]:
        """Distinct labels of the terms at a site."""
        return [f"term {k + 1}" for k in range(self.counts[Site(site)])]

    def group(self, dofs: Sequence[int]) -> Group:
        """The columns of one equation of motion, or of several summed."""
        return _group(tuple(dofs), self.acting)


# A search makes many layouts of the same sites and asks for the same groups of each.
@lru_cache(4096)
def _group(dofs: tuple[int, ...], acting: tuple[Site, ...]) -> Group:
    signs = {}
    for site in acting:
        sign = sum(map(site.incidence, dofs))
        if sign:
            signs[site] = sign
    return Group(dofs, tuple(signs), tuple(signs.values()))


class LawLayout(Layout):
    """A layout whose columns come from laws."""

    def __init__(self, chain: Chain, laws: Mapping[Named, Iterable[ForceLaw]]) -> None:
        self.laws: dict[Site, tuple[ForceLaw, ...]] = {}
        counts = {}
        for text, group in laws.items():
            site = chain.site(text)
            self.laws[site] = tuple(group)
            counts[site] = sum(len(law.terms()) for law in self.laws[site])
            _require_each_term_once(site, self.laws[site])
        super().__init__(chain, counts)

    def labels(self, site: str) -> list[str]:
        """Distinct labels of the terms at a site."""
        return distinct_labels(self.laws.get(Site(site), ()))

    @cached_property
    def has_memory(self) -> bool:
        """Whether any law remembers the path."""
        return any(law.has_memory for group in self.laws.values() for law in group)

    @cached_property
    def recipe(self) -> Recipe:
        """How the columns follow from rates and drifts."""
        return recipe_of(self)

    def columns(self, site: Site, motion: Motion) -> np.ndarray:
        """Feature columns at a site along one record, (n_samples, n_terms)."""
        columns = [np.empty((motion.n_samples, 0))]
        for law in self.laws.get(site, ()):
            columns.append(law.features(motion))
        return np.hstack(columns)


def _require_each_term_once(site: Site, laws: Sequence[ForceLaw]) -> None:
    """Refuse two laws of one site that have the same power of rate and drift."""
    owner: dict[str, str] = {}
    for law in laws:
        for term in law.terms():
            if not MONOMIAL.match(term.label):
                continue
            name = type(law).__name__
            if term.label in owner:
                what = (
                    f"{site}: {owner[term.label]} and {name} both hold the term"
                    f" {term.label!r}"
                )
                cure = "Their coefficients cannot be distinguished; leave one out."
                raise LawError(what, cure)
            owner[term.label] = name
