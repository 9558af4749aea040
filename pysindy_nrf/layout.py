"""Which column of a balance belongs to which mass, site and term: said once, used everywhere."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .chain import Chain
from .exceptions import ChainError, LawError
from .laws.base import ForceLaw, Motion, Term
from .sites import Site

_MONOMIAL = re.compile(r"(1|v(\^\d+)?( s(\^\d+)?)?|s(\^\d+)?)\Z")


@dataclass(frozen=True)
class Group:
    """One balance, or several summed: the columns that can stand in it.

    Attributes
    ----------
    dofs : tuple of int
        The balances that are summed.
    sites : tuple of Site
        Sites whose force enters.
    signs : tuple of int
        +1 or -1 for each site.
    """

    dofs: tuple[int, ...]
    sites: tuple[Site, ...]
    signs: tuple[int, ...]


class Layout:
    """Columns of a chain's balances.

    Parameters
    ----------
    chain : Chain
    terms : mapping of str to int
        Number of terms at each site; sites beyond the chain's own (``"dof 2"``, further links) follow
        in the order given.

    Attributes
    ----------
    sites : tuple of Site
        All sites, in column order.
    n_terms : int
    """

    def __init__(self, chain: Chain, terms: Mapping[str, int]) -> None:
        counts = {chain.site(s): int(k) for s, k in terms.items()}
        self.chain = chain
        self.sites: tuple[Site, ...] = (*chain.sites, *(s for s in counts if s not in chain.sites))
        wrong = [s for s in self.sites if s.kind == "sensor"]
        if wrong:
            raise ChainError(
                f"{str(wrong[0])!r} is not a place for a force law", "Use a storey, link, ground or dof site."
            )
        self.n_dof = chain.n_dof
        self.counts = {s: counts.get(s, 0) for s in self.sites}
        ends = np.cumsum([0, *(self.counts[s] for s in self.sites)])
        self.slices = {s: slice(int(ends[i]), int(ends[i + 1])) for i, s in enumerate(self.sites)}
        self.n_terms = int(ends[-1])

    @property
    def acting(self) -> tuple[Site, ...]:
        """Sites that have at least one term."""
        return tuple(s for s in self.sites if self.counts[s])

    def group(self, dofs: Sequence[int]) -> Group:
        """The group of columns of one balance, or of several summed.

        Parameters
        ----------
        dofs : sequence of int

        Returns
        -------
        Group
        """
        pairs = [(s, sum(s.incidence(j) for j in dofs)) for s in self.acting]
        pairs = [(s, sign) for s, sign in pairs if sign]
        return Group(tuple(dofs), tuple(s for s, _ in pairs), tuple(sign for _, sign in pairs))


class LawLayout(Layout):
    """A layout whose columns come from laws.

    Parameters
    ----------
    chain : Chain
    laws : mapping of str to sequence of ForceLaw

    Raises
    ------
    LawError
        If two laws at one site hold the same term.
    """

    def __init__(self, chain: Chain, laws: Mapping[str, Iterable[ForceLaw]]) -> None:
        self.laws = {chain.site(s): tuple(ls) for s, ls in laws.items()}
        super().__init__(chain, {s: sum(len(law.terms()) for law in ls) for s, ls in self.laws.items()})
        for site, held in self.laws.items():
            owner: dict[str, str] = {}
            for law in held:
                for term in law.terms():
                    if not _MONOMIAL.match(term.label):
                        continue
                    if term.label in owner:
                        raise LawError(
                            f"{site}: {owner[term.label]} and {type(law).__name__} both hold the term {term.label!r}",
                            "Their coefficients cannot be told apart; leave one out.",
                        )
                    owner[term.label] = type(law).__name__

    def terms_at(self, site: str) -> list[Term]:
        """Terms at a site, in column order.

        Parameters
        ----------
        site : str

        Returns
        -------
        list of Term
        """
        return [term for law in self.laws.get(Site(site), ()) for term in law.terms()]

    def labels(self, site: str) -> list[str]:
        """Distinct labels of the terms at a site; a law's name is added where two would be equal."""
        held = [(law.name, t.label) for law in self.laws.get(Site(site), ()) for t in law.terms()]
        plain = [label for _, label in held]
        return [label if plain.count(label) == 1 else f"{label} ({name})" for name, label in held]

    @property
    def has_memory(self) -> bool:
        """Whether any law remembers the path."""
        return any(law.has_memory for held in self.laws.values() for law in held)

    def columns(self, site: Site, motion: Motion, states: dict | None = None) -> np.ndarray:
        """Feature columns at a site along one contiguous record.

        Parameters
        ----------
        site : Site
        motion : Motion
        states : dict, optional
            Internal states carried from block to block, keyed by (site, law number).

        Returns
        -------
        ndarray of shape (n_samples, n_terms_at_site)
        """
        out = np.empty((self.counts[site], motion.n_samples))
        row = 0
        for i, law in enumerate(self.laws.get(site, ())):
            state = None
            if law.has_memory and states is not None:
                state = states.setdefault((site, i), np.zeros(law.n_states))
            columns = law.features(motion, state)
            out[row : row + columns.shape[1]] = columns.T
            row += columns.shape[1]
        return out.T
