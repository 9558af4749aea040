"""Columns of the balances: which belongs to which mass, site and term; blocks of
samples that hold them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np

from ..exceptions import ChainError, LawError
from ..laws.base import ForceLaw
from ..laws.power_series import PowerSeries
from ..laws.shape import Motion
from .sites import Site, as_mapping
from .structure import Chain

_MONOMIAL = re.compile(r"(1|v(\^\d+)?( s(\^\d+)?)?|s(\^\d+)?)\Z")


@dataclass(frozen=True)
class Group:
    """One balance, or several summed: the columns that can stand in it."""

    dofs: tuple[int, ...]
    sites: tuple[Site, ...]
    signs: tuple[int, ...]  # +1 or -1 for each site


class Layout:
    """Columns of a chain's balances; sites beyond the chain's own follow in the order
    given.
    """

    def __init__(self, chain: Chain, terms: Mapping[Any, int]) -> None:
        counts = {chain.site(s): int(k) for s, k in terms.items()}
        self.chain = chain
        self.sites: tuple[Site, ...] = (
            *chain.sites,
            *(s for s in counts if s not in chain.sites),
        )
        if wrong := [s for s in self.sites if s.kind == "sensor"]:
            cure = "Use a storey, link, ground or dof site."
            raise ChainError(f"{str(wrong[0])!r} is not a place for a force law", cure)
        self.n_dof = chain.n_dof
        self.counts = {s: counts.get(s, 0) for s in self.sites}
        ends = np.cumsum([0, *(self.counts[s] for s in self.sites)])
        self.slices = {
            s: slice(int(ends[i]), int(ends[i + 1])) for i, s in enumerate(self.sites)
        }
        self.n_terms = int(ends[-1])

    @cached_property
    def acting(self) -> tuple[Site, ...]:
        """Sites that have at least one term."""
        return tuple(s for s in self.sites if self.counts[s])

    def labels(self, site: str) -> list[str]:
        """Distinct labels of the terms at a site."""
        return [f"term {k + 1}" for k in range(self.counts[Site(site)])]

    def group(self, dofs: Sequence[int]) -> Group:
        """The group of columns of one balance, or of several summed."""
        return _group(tuple(dofs), self.acting)


@lru_cache(4096)
def _group(dofs: tuple[int, ...], acting: tuple[Site, ...]) -> Group:
    """The group of some balances where laws act at some sites; a search asks for the
    same ones again and again.
    """
    signs = {s: sign for s in acting if (sign := sum(s.incidence(j) for j in dofs))}
    return Group(dofs, tuple(signs), tuple(signs.values()))


@dataclass(frozen=True)
class Recipe:
    """Columns v^h s^j that follow from earlier ones by one multiplication each, and
    those of other laws.
    """

    # (n_steps, 3); ``(row, x, p)``: the row is row x of the source times row p; a p of
    # -1 stands for ones. Rows from ``n_terms`` on are helpers
    steps: np.ndarray
    motions: tuple[
        Site, ...
        # sites whose rates are the first rows of the source, and whose drifts are the
        # next ones
    ]
    # laws (by site and number) whose columns follow from no others, and how many of
    # them follow in the source, in order
    others: tuple[tuple[Site, int, int], ...]
    n_source: int  # rows of the source

    def finish(self, source: np.ndarray, n_terms: int) -> np.ndarray:
        """All columns of a block."""
        out = np.empty(
            (max(n_terms, int(self.steps[:, 0].max(initial=-1)) + 1), source.shape[1])
        )
        for row, x, p in self.steps.tolist():
            np.multiply(source[x], out[p] if p >= 0 else 1.0, out=out[row])
        return out[:n_terms]


def copies(rows: Any, sources: Any) -> np.ndarray:
    """Steps that take rows as they stand in the source."""
    return np.column_stack([rows, sources, np.full(len(rows), -1)]).astype(np.int64)


def _recipe(layout: LawLayout) -> Recipe:
    steps: list[tuple[int, int, int]] = []
    motions: list[Site] = []
    others: list[tuple[Site, int, int]] = []
    given: list[int] = []  # first column of each of them
    helper = layout.n_terms
    for site in layout.acting:
        at, v = layout.slices[site].start, 2 * len(motions)
        made: dict[tuple[int, int], int] = {}
        rows: dict[tuple[int, int], int] = {}
        for number, law in enumerate(layout.laws[site]):
            width = len(law.terms())
            powers = _products(law)
            if powers is not None:
                rows |= {power: at + k for k, power in enumerate(powers)}
            else:
                others.append((site, number, width))
                given.append(at)
            at += width
        if rows:
            motions.append(site)
        for power in sorted(rows, key=sum):
            chain = [
                power
                # down to what is there already: s is taken off first, as the power
                # series multiplies
            ]
            while sum(chain[-1]) > 1:
                h, j = chain[-1]
                below = (h, j - 1) if j else (h - 1, 0)
                if below in made:
                    break
                chain.append(below)
            for h, j in reversed(chain):
                if (h, j) in made:
                    continue
                row = rows.get((h, j))
                if row is None:
                    row, helper = helper, helper + 1
                steps.append(
                    (row, v + (j > 0), made.get((h, j - 1) if j else (h - 1, 0), -1))
                )
                made[h, j] = row
    size = 2 * len(motions)
    steps = [
        (row, x // 2 + x % 2 * len(motions), p) for row, x, p in steps
    ]  # rates first, then drifts
    for (_, _, width), at in zip(others, given):
        steps += [(at + k, size + k, -1) for k in range(width)]
        size += width
    return Recipe(
        np.array(steps, dtype=np.int64).reshape(-1, 3),
        tuple(motions),
        tuple(others),
        size,
    )


_PROBE = Motion(np.array([0.7, -1.3, 0.4]), np.array([-0.6, 0.8, 1.7]))


def _products(law: ForceLaw) -> list[tuple[int, int]] | None:
    """Exponents of the columns of a law if they are what their labels say and need
    nothing else, else None.
    """
    powers = [
        power for term in law.terms() if (power := powers_of(term.label)) is not None
    ]
    needs_more = (
        law.has_memory
        or law.covariates
        or law.uses_time
        or law.uses_acceleration
        or law.free_shape
    )
    if needs_more or not powers or len(powers) < len(law.terms()) or (0, 0) in powers:
        return None
    products = np.column_stack([_PROBE.v**h * _PROBE.s**j for h, j in powers])
    found = law.features(_PROBE)
    return (
        powers if (np.abs(found - products) <= 1e-12 * np.abs(products)).all() else None
    )


@cache
def powers_of(label: str) -> tuple[int, int] | None:
    """Exponents (h, j) of a label such as ``"v^2 s"`` or ``"1"``; None if it is no
    monomial.
    """
    if not _MONOMIAL.match(label):
        return None
    power = {"v": 0, "s": 0, "1": 0}
    for factor in label.split():
        base, _, exponent = factor.partition("^")
        power[base] = int(exponent or 1)
    return power["v"], power["s"]


def numbered(words: Sequence[str]) -> list[str]:
    """Words, with a number behind those that occur more than once."""
    return [
        w if words.count(w) == 1 else f"{w} {words[: i + 1].count(w)}"
        for i, w in enumerate(words)
    ]


def distinct_labels(laws: Sequence[ForceLaw]) -> list[str]:
    """Labels of the terms of some laws, all different."""
    plain = [term.label for law in laws for term in law.terms()]
    named = [(term.label, law.name) for law in laws for term in law.terms()]
    number = [
        name
        for law, name in zip(laws, numbered([law.name for law in laws]))
        for _ in law.terms()
    ]
    return [
        (
            label
            if plain.count(label) == 1
            else f"{label} ({name if named.count((label, name)) == 1 else full})"
        )
        for (label, name), full in zip(named, number)
    ]


def with_coefficients(
    laws: Mapping[Site, Sequence[ForceLaw]], coefficients: Mapping[Site, np.ndarray]
) -> dict[Site, tuple[ForceLaw, ...]]:
    """Laws with the coefficients of each site, one law after the other."""
    out = {}
    for site, held in laws.items():
        parts = np.split(
            coefficients.get(site, np.zeros(0)),
            np.cumsum([len(law.terms()) for law in held])[:-1],
        )
        out[site] = tuple(
            law.with_values(coefficients=part) for law, part in zip(held, parts)
        )
    return out


def declared_laws(laws: Any) -> dict[Any, tuple[ForceLaw, ...]]:
    """The laws that a user declared, by the user's own names of the sites."""
    given = {}
    for site, value in as_mapping("laws", laws, "{'storey 1': [...]}").items():
        held = tuple(value) if isinstance(value, (list, tuple)) else (value,)
        if wrong := [law for law in held if not isinstance(law, ForceLaw)]:
            cure = "Use those of pysindy_nrf.laws."
            raise ChainError(
                f"laws[{site!r}] holds {wrong[0]!r}, which is not a force law", cure
            )
        given[site] = held
    return given


def power_series_laws(
    chain: Chain, degree: Any, orders: Mapping[Any, Any] | None = None
) -> dict[Site, list[ForceLaw]]:
    """A power series at every site of a chain."""
    given = {
        chain.site(s): order
        for s, order in as_mapping("orders", orders, "{'storey 2': 5}").items()
    }
    if unknown := [str(site) for site in given if site not in chain.sites]:
        cure = f"Its sites are {', '.join(chain.sites)}."
        raise ChainError(
            f"orders names {unknown[0]!r}, which is not in the chain", cure
        )
    return {site: [PowerSeries(given.get(site, degree))] for site in chain.sites}


class LawLayout(Layout):
    """A layout whose columns come from laws."""

    def __init__(self, chain: Chain, laws: Mapping[Any, Iterable[ForceLaw]]) -> None:
        self.laws = {chain.site(s): tuple(ls) for s, ls in laws.items()}
        super().__init__(
            chain,
            {s: sum(len(law.terms()) for law in ls) for s, ls in self.laws.items()},
        )
        for site, held in self.laws.items():
            owner: dict[str, str] = {}
            for law, label in (
                (one, t.label)
                for one in held
                for t in one.terms()
                if _MONOMIAL.match(t.label)
            ):
                if label in owner:
                    what = (
                        f"{site}: {owner[label]} and {type(law).__name__} both hold the"
                        f" term {label!r}"
                    )
                    raise LawError(
                        what, "Their coefficients cannot be told apart; leave one out."
                    )
                owner[label] = type(law).__name__

    def labels(self, site: str) -> list[str]:
        """Distinct labels of the terms at a site, as :func:`distinct_labels` makes
        them.
        """
        return distinct_labels(self.laws.get(Site(site), ()))

    @cached_property
    def has_memory(self) -> bool:
        """Whether any law remembers the path."""
        return any(law.has_memory for held in self.laws.values() for law in held)

    @cached_property
    def recipe(self) -> Recipe:
        """How the columns follow from rates and drifts, as far as they are products of
        them.
        """
        return _recipe(self)

    def columns(self, site: Site, motion: Motion) -> np.ndarray:
        """Feature columns at a site along one contiguous record."""
        return np.hstack(
            [
                np.empty((motion.n_samples, 0)),
                *(law.features(motion) for law in self.laws.get(site, ())),
            ]
        )


# Samples in a block of finished columns; blocks of many channels hold fewer motions, so
# that they stay in the cache.
BLOCK = 2048
_CACHE = 2**17  # numbers


def block_size(layout: Layout) -> int:
    """Samples in a block of a layout, between 512 and 4096."""
    return int(np.clip(_CACHE // max(4 * layout.n_dof, 1) // 256 * 256, 512, 2 * BLOCK))


class Block:
    """Some consecutive samples of one record, one row for each column; NaN for a DOF
    whose force is unknown.
    """

    def __init__(
        self,
        terms: np.ndarray | None,
        acceleration: np.ndarray,
        force: np.ndarray,
        source: np.ndarray | None = None,
        recipe: Recipe | None = None,
        n_terms: int = 0,
        weights: np.ndarray | None = None,
    ) -> None:
        # arrays may be views of the user's own; without finished columns, source and
        # recipe say how they follow
        self._terms, self.acceleration, self.force = terms, acceleration, force
        self.source, self.recipe, self.n_terms, self.weights = (
            source,
            recipe,
            n_terms,
            weights,
        )

    @property
    def terms(self) -> np.ndarray:
        """Columns of all sites, shape (n_terms, n)."""
        if self._terms is None:
            assert (
                self.recipe is not None and self.source is not None
            )  # a block has its columns or these
            self.source = np.ascontiguousarray(self.source)
            self._terms = self.recipe.finish(self.source, self.n_terms)
        return self._terms

    @property
    def n_samples(self) -> int:
        """Samples."""
        return self.acceleration.shape[1]

    @property
    def weight(self) -> float:
        """Sum of the weights of the samples; their number where they have none."""
        return self.n_samples if self.weights is None else float(self.weights.sum())

    @property
    def weighted(self) -> Block:
        """Columns times the root of the weights, so that a sample of weight two counts
        as two.
        """
        if self.weights is None:
            return self
        root = np.sqrt(self.weights)
        return Block(self.terms * root, self.acceleration * root, self.force * root)

    @property
    def known(self) -> tuple[bool, ...]:
        """Whether the force of each DOF is known."""
        return tuple(np.isfinite(self.force[:, 0]).tolist())

    def take(self, rows: Any) -> Block:
        """Some of the samples; ``rows`` is a slice or an index array."""
        if isinstance(rows, slice) and rows == slice(0, self.acceleration.shape[1]):
            return self
        a, force = self.acceleration[:, rows], self.force[:, rows]
        weights = None if self.weights is None else self.weights[rows]
        if self.recipe is None or self.source is None:
            return Block(self.terms[:, rows], a, force, weights=weights)
        return Block(
            None, a, force, self.source[:, rows], self.recipe, self.n_terms, weights
        )


def blocks_of(
    terms: np.ndarray,
    acceleration: np.ndarray,
    force: np.ndarray,
    size: int = BLOCK,
    weights: np.ndarray | None = None,
) -> Iterator[Block]:
    """Cut ready-made columns, one row for each sample, into blocks of ``size``
    samples.
    """
    for start in range(0, len(acceleration), size):
        rows = slice(start, start + size)
        part = None if weights is None else weights[rows]
        yield Block(terms[rows].T, acceleration[rows].T, force[rows].T, weights=part)


def cut_at(
    edges: np.ndarray, blocks: Iterable[Block], first: int = 0
) -> Iterator[tuple[int, Block]]:
    """Number the samples of a record by the piece they are in, from ``first`` on."""
    at = 0
    for block in blocks:
        stop = at + block.n_samples
        cuts = [at, *edges[(edges > at) & (edges < stop)].tolist(), stop]
        piece = int(np.searchsorted(edges, at, side="right")) - 1
        for number, (low, high) in enumerate(zip(cuts[:-1], cuts[1:]), piece + first):
            yield number, block.take(slice(low - at, high - at))
        at = stop
