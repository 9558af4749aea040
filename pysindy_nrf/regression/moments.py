"""One pass over the samples leaves small matrices; everything least-squares works on them.

For each balance the columns are ``[terms of its sites | a_j | F_j]``; the moments are their Gram
matrix, or the triangular factor of a streamed QR where squaring would lose digits. Moments add:
chunks, records, folds and workers are all the same thing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import linalg

from ..common.threads import in_threads
from ..exceptions import NRFError
from .gram import Plan, orthogonal_gram
from .layout import Group, Layout, Recipe

# Samples in a block of finished columns; blocks of motions hold fewer where there are many channels, so that a
# block stays in the cache.
BLOCK = 2048
_CACHE = 2**17  # numbers
SHARE = 4  # blocks that a thread takes at once
# Pivots of a scaled Gram matrix below this are round-off.
_LOST = 3e-8


def block_size(layout: Layout) -> int:
    """Samples in a block of a layout, between 512 and 4096."""
    return int(np.clip(_CACHE // max(4 * layout.n_dof, 1) // 256 * 256, 512, 2 * BLOCK))


def _width(layout: Layout, group: Group) -> int:
    """Columns of a group: its terms, and a_j and F_j of a balance or the target of a sum of balances."""
    return sum(layout.counts[s] for s in group.sites) + (2 if len(group.dofs) == 1 else 1)


class Block:
    """Some consecutive samples of one record, one row for each column.

    Parameters
    ----------
    terms : ndarray of shape (n_terms, n), optional
        Finished columns; or the two below.
    acceleration, force : ndarray of shape (n_dof, n)
        Absolute accelerations, m/s^2; forces, N, NaN for a DOF whose force is unknown. They may be views of the user's
        own arrays, as ``source`` may.
    source : ndarray of shape (n_source, n), optional
        Rates, drifts and given columns from which the columns follow.
    recipe : Recipe, optional
        How they follow.
    """

    def __init__(
        self,
        terms: np.ndarray | None,
        acceleration: np.ndarray,
        force: np.ndarray,
        source: np.ndarray | None = None,
        recipe: Recipe | None = None,
        n_terms: int = 0,
    ) -> None:
        self._terms, self.acceleration, self.force = terms, acceleration, force
        self.source, self.recipe, self.n_terms = source, recipe, n_terms

    @property
    def terms(self) -> np.ndarray:
        """Columns of all sites, shape (n_terms, n)."""
        if self._terms is None:
            assert self.recipe is not None and self.source is not None  # a block has its columns or these
            self.source = np.ascontiguousarray(self.source)
            self._terms = self.recipe.finish(self.source, self.n_terms)
        return self._terms

    @property
    def known(self) -> tuple[bool, ...]:
        """Whether the force of each DOF is."""
        return tuple(np.isfinite(self.force[:, 0]).tolist())

    def take(self, rows: Any) -> Block:
        """Some of the samples."""
        if isinstance(rows, slice) and rows == slice(0, self.acceleration.shape[1]):
            return self
        a, force = self.acceleration[:, rows], self.force[:, rows]
        if self.recipe is None or self.source is None:
            return Block(self.terms[:, rows], a, force)
        return Block(None, a, force, self.source[:, rows], self.recipe, self.n_terms)


class GroupMoments:
    """Moments of one group of columns ``[terms of the sites | a of the dofs | F of the dofs summed]``.

    Parameters
    ----------
    n_columns : int
    kind : {"gram", "root"}
        Gram matrix, or triangular root of it by streamed QR.
    """

    def __init__(self, n_columns: int, kind: str = "gram") -> None:
        self.kind = kind
        self.n_samples: Any = 0  # an array of a stack
        self._matrix = np.zeros((n_columns, n_columns))
        self._guess: np.ndarray | None = None
        self._near = np.zeros((0, 0))

    @property
    def matrix(self) -> np.ndarray:
        """Gram matrix or root, shape (n_columns, n_columns)."""
        self._settle()
        return self._matrix

    @matrix.setter
    def matrix(self, value: np.ndarray) -> None:
        self._guess, self._matrix = None, value

    def add(self, rows: np.ndarray) -> None:
        """Add samples."""
        if self.kind == "gram":
            self.matrix += rows @ rows.T
        else:
            self.matrix = _root_of(np.vstack([self.matrix, rows.T]))
        self.n_samples += rows.shape[1]

    def add_guessed(self, rows: np.ndarray, guess: np.ndarray) -> None:
        """Add samples to a root, through the Gram matrix of columns that a guess of the root makes orthogonal."""
        if self._guess is not guess:
            self._settle()
            self._guess, self._near = guess, np.zeros(guess.shape)
        orthogonal_gram(rows, guess, self._near)
        self.n_samples += rows.shape[1]

    def _settle(self) -> None:
        """Root of what was added through a guess."""
        if self._guess is None:
            return
        near = np.tril(self._near)
        root = _scaled_cholesky(near + np.tril(near, -1).T) @ self._guess
        self._guess = None
        self._matrix = _root_of(np.vstack([self._matrix, root])) if self._matrix.any() else root

    def merge(self, other: GroupMoments) -> None:
        """Add the samples of other moments of the same columns."""
        if self.kind != other.kind or self.matrix.shape != other.matrix.shape:
            raise NRFError(
                "Moments of different columns or kinds cannot be added", "Accumulate both with the same layout."
            )
        if self.kind == "gram":
            self.matrix = self.matrix + other.matrix
        else:
            self.matrix = _root_of(np.vstack([self.matrix, other.matrix]))
        self.n_samples += other.n_samples

    def triangle(self, combine: np.ndarray) -> np.ndarray:
        """Triangular factor of linear combinations of the columns."""
        if self.kind == "root":
            upper = np.asarray(np.linalg.qr(self.matrix @ combine, mode="r"))
            if upper.shape[-2] == upper.shape[-1]:
                return upper
            out = np.zeros((*upper.shape[:-2], combine.shape[-1], combine.shape[-1]))
            out[..., : upper.shape[-2], :] = upper
            return out
        gram = combine.T @ self.matrix @ combine
        return _scaled_cholesky(0.5 * (gram + gram.T))

    def root(self) -> np.ndarray:
        """Triangular factor of the columns themselves, shape (..., n_columns, n_columns); see :meth:`triangle`."""
        if self.kind == "root":
            return self.triangle(np.eye(self.matrix.shape[-1]))
        return _scaled_cholesky(self.matrix)

    def norm(self, weights: np.ndarray) -> float:
        """Root of the sum of squares of one combination of the columns."""
        return float(self.norms(weights[:, None])[0])

    def norms(self, weights: np.ndarray) -> np.ndarray:
        """Roots of the sums of squares of some combinations of the columns."""
        image = self.matrix @ weights
        if self.kind == "root":
            return np.linalg.norm(image, axis=-2)
        return np.sqrt(np.clip(np.einsum("ij,ij->j", weights, image), 0.0, None))


def _root_of(rows: np.ndarray) -> np.ndarray:
    """Triangular factor of some rows, square."""
    return linalg.qr(rows, mode="r", overwrite_a=True, check_finite=False)[0][: rows.shape[1]]


def guess_of(part: GroupMoments) -> np.ndarray:
    """Triangular factor of moments that can be divided by: pivots lost to round-off are set to what may be lost."""
    upper = part.root()
    scale = np.linalg.norm(upper, axis=0)
    scale[scale == 0] = 1.0
    low = np.flatnonzero(np.abs(np.diag(upper)) < _LOST * scale)
    upper[low] = 0.0
    upper[low, low] = _LOST * scale[low]
    return np.ascontiguousarray(upper)


def _scaled_cholesky(gram: np.ndarray) -> np.ndarray:
    """Upper factor of a Gram matrix whose columns span many orders of magnitude."""
    scale = np.sqrt(np.clip(np.diagonal(gram, axis1=-2, axis2=-1), 0.0, None))
    safe = np.where(scale > 0, scale, 1.0)
    unit = gram / safe[..., :, None] / safe[..., None, :]
    p = unit.shape[-1]
    try:  # an empty column takes no part
        whole = unit + (scale == 0)[..., None] * np.eye(p)
        if gram.ndim == 2:
            return linalg.cholesky(whole, check_finite=False) * scale
        return np.linalg.cholesky(whole).swapaxes(-1, -2) * scale[..., None, :]  # SciPy takes one at a time
    except np.linalg.LinAlgError:
        pass
    if gram.ndim > 2:
        return np.array([_scaled_cholesky(one) for one in gram])
    upper = np.zeros_like(unit)
    for i in range(p):
        row = unit[i, i:] - upper[:i, i] @ upper[:i, i:]
        if row[0] > 4 * p * np.finfo(float).eps:
            upper[i, i:] = row / np.sqrt(row[0])
    return upper * scale


class Moments:
    """Moments of all groups of a chain.

    Parameters
    ----------
    layout : Layout
    groups : sequence of Group
        Single balances, and sums of balances for base excitation.
    kind : {"gram", "root"}
        ``"root"`` keeps the digits that squaring would lose.
    known_masses : mapping of int to float
        Masses used in summed balances, kg.
    guess : mapping of tuple of int to ndarray of shape (p, p), optional
        For ``"root"``: by group, a triangular factor of moments of similar samples. Columns are first made nearly
        orthogonal with it, after which their Gram matrix loses nothing (CholeskyQR2: Yamamoto, Nakatsukasa,
        Yanagisawa and Fukaya, ETNA 44, 2015). Without it, Householder's QR, which is slower.

    Attributes
    ----------
    n_samples : int
        Samples seen.
    """

    def __init__(
        self,
        layout: Layout,
        groups: Sequence[Group],
        kind: str = "gram",
        known_masses: Mapping[int, float] | None = None,
        guess: Mapping[tuple[int, ...], np.ndarray] | None = None,
    ) -> None:
        self.layout, self.kind = layout, kind
        self.known_masses = dict(known_masses or {})
        self.groups = {g.dofs: g for g in groups}
        self.n_samples: Any = 0
        self.guess = dict(guess or {})
        self._plan: Plan | None = None
        self._known: tuple[bool, ...] = ()
        self._store, self._pending = np.zeros(0), 0
        self._parts = {g.dofs: GroupMoments(_width(layout, g), kind) for g in groups}

    @property
    def parts(self) -> dict[tuple[int, ...], GroupMoments]:
        """Moments of each group, by its DOFs."""
        self._settle()
        return self._parts

    @property
    def stacked(self) -> tuple[int, ...]:
        """Leading axes of the matrices, empty unless :func:`stacked` made them."""
        return next(iter(self.parts.values())).matrix.shape[:-2]

    def of(self, number: int) -> Moments:
        """One of stacked moments."""
        out = Moments(self.layout, list(self.groups.values()), self.kind, self.known_masses)
        out.n_samples = int(self.n_samples[number])
        for dofs, part in self.parts.items():
            out.parts[dofs].matrix, out.parts[dofs].n_samples = part.matrix[number], int(part.n_samples[number])
        return out

    def empty(self) -> Moments:
        """Moments of nothing, of the same columns."""
        out = Moments(self.layout, list(self.groups.values()), self.kind, self.known_masses, self.guess)
        out._plan = self._planned() if self.kind == "gram" else None
        return out

    def _planned(self) -> Plan:
        if self._plan is None:
            self._plan = Plan(self.layout, list(self.groups.values()), self.known_masses)
        return self._plan

    def add(self, block: Block) -> None:
        """Add some consecutive samples."""
        self.n_samples += block.acceleration.shape[1]
        if self.kind == "root":
            self._add_root(block)
        else:
            self._planned().multiply(block, self._room(block.known))
            self._pending += block.acceleration.shape[1]

    def _room(self, known: tuple[bool, ...]) -> np.ndarray:
        """Where the compiled pass sums up samples in which these forces are known."""
        if known != self._known or not len(self._store):
            self._settle()
            self._known, self._store = known, np.zeros(self._planned().size)
        return self._store

    def products(self, blocks: Sequence[Block]) -> np.ndarray:
        """Sums of products of the columns of some blocks with the same known forces, for :meth:`add_products`."""
        plan = self._planned()
        store = np.zeros(plan.size)
        for block in blocks:
            plan.multiply(block, store)
        return store

    def add_products(self, blocks: Sequence[Block], products: np.ndarray) -> None:
        """Add blocks whose products are there already."""
        store = self._room(blocks[0].known)
        store += products
        size = sum(block.acceleration.shape[1] for block in blocks)
        self._pending += size
        self.n_samples += size

    def _settle(self) -> None:
        """Move what the compiled pass has summed up into the groups whose forces it knew."""
        if not self._pending:
            return
        plan = self._planned()
        for dofs, part in self._parts.items():
            if all(self._known[j - 1] for j in dofs):
                part.matrix += self._store[plan.take[dofs]]
                part.n_samples += self._pending
        self._store, self._pending = np.zeros(0), 0

    def _add_root(self, block: Block) -> None:
        layout = self.layout
        terms = block.terms
        for dofs, part in self._parts.items():
            rows = [j - 1 for j in dofs]
            if np.isnan(block.force[rows, 0]).any():
                continue
            own = [terms[layout.slices[s]] for s in self.groups[dofs].sites]
            if len(dofs) == 1:
                own += [block.acceleration[rows], block.force[rows]]
            else:
                mass = np.array([self.known_masses[j] for j in dofs])
                own.append((block.force[rows].sum(axis=0) - mass @ block.acceleration[rows])[None])
            columns = np.vstack(own)
            if dofs in self.guess:
                part.add_guessed(columns, self.guess[dofs])
            else:
                part.add(columns)

    def merge(self, other: Moments) -> Moments:
        """Add the samples of other moments with the same layout and groups."""
        if set(self.parts) != set(other.parts):
            raise NRFError("Moments of different balances cannot be added", "Accumulate both with the same layout.")
        for dofs, part in self.parts.items():
            part.merge(other.parts[dofs])
        self.n_samples += other.n_samples
        return self

    def __getstate__(self) -> dict[str, Any]:
        self._settle()
        return {**self.__dict__, "_plan": None}

    @classmethod
    def from_gram(
        cls,
        layout: Layout,
        groups: Sequence[Group],
        gram: Callable[[tuple[int, ...]], tuple[np.ndarray, int]],
        known_masses: dict[int, float] | None = None,
    ) -> Moments:
        """Moments cut out of one Gram matrix of all columns ``[terms | a_1..a_n | F_1..F_n]``."""
        self = cls(layout, [], "gram", known_masses)
        k, n = layout.n_terms, layout.n_dof
        for group in groups:
            matrix, size = gram(group.dofs)
            index = [i for s in group.sites for i in range(layout.slices[s].start, layout.slices[s].stop)]
            if len(group.dofs) == 1:
                j = group.dofs[0] - 1
                index += [k + j, k + n + j]
                part = GroupMoments(0)
                part.matrix = matrix[np.ix_(index, index)]
            else:
                combine = np.zeros((len(matrix), len(index) + 1))
                combine[index, np.arange(len(index))] = 1.0
                for j in group.dofs:
                    combine[k + n + j - 1, -1] = 1.0
                    combine[k + j - 1, -1] = -self.known_masses[j]
                part = GroupMoments(0)
                part.matrix = combine.T @ matrix @ combine
            part.n_samples = size
            self.groups[group.dofs], self._parts[group.dofs] = group, part
            self.n_samples = max(self.n_samples, size)
        return self

    def positions(self, dofs: tuple[int, ...]) -> tuple[dict, int | None, int]:
        """Where the columns of a group stand: site -> slice, mass column (or None), target column."""
        group, at, where = self.groups[dofs], 0, {}
        for site in group.sites:
            where[site] = slice(at, at + self.layout.counts[site])
            at += self.layout.counts[site]
        return where, (at if len(dofs) == 1 else None), (at + 1 if len(dofs) == 1 else at)


def stacked(parts: Sequence[Moments]) -> Moments:
    """Roots of the same groups, to be solved and judged all at once."""
    first = parts[0]
    out = Moments(first.layout, list(first.groups.values()), "root", first.known_masses)
    out.n_samples = np.array([m.n_samples for m in parts])
    for dofs, part in out.parts.items():
        part.matrix = np.stack([m.parts[dofs].matrix for m in parts])
        part.n_samples = np.array([m.parts[dofs].n_samples for m in parts])
    return out


def accumulate(moments: Moments, blocks: Iterable[Block]) -> Moments:
    """Stream blocks of samples into moments, on all cores; see :func:`pysindy_nrf.common.threads.n_threads`."""
    accumulate_each((moments, block) for block in blocks)
    return moments


def accumulate_each(blocks: Iterable[tuple[Moments, Block]]) -> None:
    """Stream blocks into one of several moments each, on all cores."""

    def multiplied(share: tuple[Moments, list[Block]]) -> tuple[Moments, list[Block], np.ndarray]:
        moments, held = share
        return moments, held, moments.products(held)

    for moments, held, products in in_threads(multiplied, _shares(blocks)):
        moments.add_products(held, products)


def _shares(blocks: Iterable[tuple[Moments, Block]]) -> Iterator[tuple[Moments, list[Block]]]:
    """Neighbouring blocks of the same moments, a few at a time; those that no thread can take are added at once."""
    moments: Moments | None = None
    held: list[Block] = []
    for into, block in blocks:
        if into.kind == "root":
            into.add(block)
            continue
        if held and (into is not moments or len(held) == SHARE or block.known != held[0].known):
            assert moments is not None
            yield moments, held
            held = []
        moments = into
        held.append(block)
    if moments is not None and held:
        yield moments, held


def blocks_of(terms: np.ndarray, acceleration: np.ndarray, force: np.ndarray, size: int = BLOCK) -> Iterator[Block]:
    """Cut ready-made columns into blocks."""
    for start in range(0, len(acceleration), size):
        rows = slice(start, start + size)
        yield Block(terms[rows].T, acceleration[rows].T, force[rows].T)
