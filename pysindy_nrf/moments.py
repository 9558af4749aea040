"""One pass over the samples leaves small matrices; everything least-squares works on them.

For each balance the columns are ``[terms of its sites | a_j | F_j]``; the moments are their Gram
matrix, or the triangular factor of a streamed QR where squaring would lose digits. Moments add:
chunks, records, folds and workers are all the same thing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from .exceptions import NRFError
from .layout import Group, Layout

BLOCK = 2048


@dataclass
class Block:
    """Some consecutive samples of one record, one row for each column (C-contiguous).

    Attributes
    ----------
    terms : ndarray of shape (n_terms, n)
    acceleration, force : ndarray of shape (n_dof, n)
        Absolute accelerations, m/s^2; forces, N, NaN for a DOF whose force is unknown.
    """

    terms: np.ndarray
    acceleration: np.ndarray
    force: np.ndarray


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
        self.matrix = np.zeros((n_columns, n_columns))
        self.n_samples = 0

    def add(self, rows: np.ndarray) -> None:
        """Add samples.

        Parameters
        ----------
        rows : ndarray of shape (n_columns, n)
            One row for each column of the group.
        """
        if self.kind == "gram":
            self.matrix += rows @ rows.T
        else:
            stacked = np.vstack([self.matrix, rows.T])
            upper = linalg.qr(stacked, mode="r", overwrite_a=True, check_finite=False)[0]
            self.matrix = upper[: self.matrix.shape[0]]
        self.n_samples += rows.shape[1]

    def merge(self, other: GroupMoments) -> None:
        """Add the samples of other moments of the same columns."""
        if self.kind != other.kind or self.matrix.shape != other.matrix.shape:
            raise NRFError(
                "Moments of different columns or kinds cannot be added", "Accumulate both with the same layout."
            )
        if self.kind == "gram":
            self.matrix = self.matrix + other.matrix
        else:
            self.matrix = linalg.qr(np.vstack([self.matrix, other.matrix]), mode="r", check_finite=False)[0][
                : self.matrix.shape[0]
            ]
        self.n_samples += other.n_samples

    def triangle(self, combine: np.ndarray) -> np.ndarray:
        """Triangular factor of linear combinations of the columns.

        Parameters
        ----------
        combine : ndarray of shape (n_columns, p)

        Returns
        -------
        ndarray of shape (p, p)
            Upper triangular R with ``R.T @ R`` = Gram matrix of the combinations.
        """
        if self.kind == "root":
            upper = linalg.qr(self.matrix @ combine, mode="r", check_finite=False)[0]
            out = np.zeros((combine.shape[1],) * 2)
            rows = min(out.shape[0], upper.shape[0])
            out[:rows] = upper[:rows]
            return out
        gram = combine.T @ self.matrix @ combine
        return _scaled_cholesky(0.5 * (gram + gram.T))

    def norm(self, weights: np.ndarray) -> float:
        """Root of the sum of squares of one combination of the columns.

        Parameters
        ----------
        weights : ndarray of shape (n_columns,)

        Returns
        -------
        float
        """
        return float(self.norms(weights[:, None])[0])

    def norms(self, weights: np.ndarray) -> np.ndarray:
        """Roots of the sums of squares of some combinations of the columns.

        Parameters
        ----------
        weights : ndarray of shape (n_columns, p)

        Returns
        -------
        ndarray of shape (p,)
        """
        image = self.matrix @ weights
        if self.kind == "root":
            return np.linalg.norm(image, axis=0)
        return np.sqrt(np.clip(np.einsum("ij,ij->j", weights, image), 0.0, None))


def _scaled_cholesky(gram: np.ndarray) -> np.ndarray:
    """Upper factor of a Gram matrix whose columns span many orders of magnitude.

    Columns are scaled to unit length first. A pivot lost to round-off becomes zero: the column is a
    combination of those before it.
    """
    scale = np.sqrt(np.clip(np.diag(gram), 0.0, None))
    safe = np.where(scale > 0, scale, 1.0)
    unit = gram / safe[:, None] / safe
    p = len(unit)
    try:
        return linalg.cholesky(unit, check_finite=False) * scale
    except linalg.LinAlgError:
        pass
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
    known_masses : mapping of int to float
        Masses used in summed balances, kg.

    Attributes
    ----------
    n_samples : int
        Samples seen.
    """

    def __init__(
        self, layout: Layout, groups: Sequence[Group], kind: str = "gram", known_masses: dict[int, float] | None = None
    ) -> None:
        self.layout, self.kind = layout, kind
        self.known_masses = dict(known_masses or {})
        self.groups = {g.dofs: g for g in groups}
        self.n_samples = 0
        n, at, order = layout.n_dof, 0, []
        # Order of the buffer: storeys, then a_j and F_j between the sites that share balance j, so
        # that the columns of a balance are neighbours wherever the topology allows.
        placed: dict[object, int] = {}
        for j in range(1, n + 1):
            for site in layout.acting:
                if site.incidence(j) and site not in placed and site.p == j and site.kind == "link" and site.is_storey:
                    placed[site], at = at, at + layout.counts[site]
                    order.append(site)
            placed["a", j], placed["F", j], at = at, at + 1, at + 2
        for site in layout.acting:
            if site not in placed:
                placed[site], at = at, at + layout.counts[site]
        self._placed, self._width = placed, at
        self.columns: dict[tuple[int, ...], np.ndarray] = {}
        self.parts: dict[tuple[int, ...], GroupMoments] = {}
        for dofs, group in self.groups.items():
            index = [np.arange(placed[s], placed[s] + layout.counts[s]) for s in group.sites]
            if len(dofs) == 1:
                index += [np.array([placed["a", dofs[0]]]), np.array([placed["F", dofs[0]]])]
                width = sum(len(i) for i in index)
            else:
                width = sum(len(i) for i in index) + 1
            self.columns[dofs] = np.concatenate(index).astype(int) if index else np.zeros(0, dtype=int)
            self.parts[dofs] = GroupMoments(width, kind)

    def add(self, block: Block) -> None:
        """Add some consecutive samples.

        Parameters
        ----------
        block : Block
        """
        n = block.acceleration.shape[1]
        buffer = np.empty((self._width, n))
        for site in self.layout.acting:
            at = self._placed[site]
            buffer[at : at + self.layout.counts[site]] = block.terms[self.layout.slices[site]]
        for j in range(1, self.layout.n_dof + 1):
            buffer[self._placed["a", j]] = block.acceleration[j - 1]
            buffer[self._placed["F", j]] = block.force[j - 1]
        for dofs, part in self.parts.items():
            if any(np.isnan(block.force[j - 1, 0]) for j in dofs):
                continue
            index = self.columns[dofs]
            if len(dofs) == 1:
                low, high = int(index.min()), int(index.max()) + 1
                if high - low == len(index):
                    window = buffer[low:high]
                    if self.kind == "gram":
                        local = np.argsort(np.argsort(index))
                        part.matrix += (window @ window.T)[np.ix_(local, local)]
                        part.n_samples += n
                        continue
                part.add(buffer[index])
            else:
                rows = [j - 1 for j in dofs]
                mass = np.array([self.known_masses[j] for j in dofs])
                target = block.force[rows].sum(axis=0) - mass @ block.acceleration[rows]
                part.add(np.vstack([buffer[index], target]))
        self.n_samples += n

    def merge(self, other: Moments) -> Moments:
        """Add the samples of other moments with the same layout and groups.

        Parameters
        ----------
        other : Moments

        Returns
        -------
        Moments
            self.
        """
        if set(self.parts) != set(other.parts):
            raise NRFError("Moments of different balances cannot be added", "Accumulate both with the same layout.")
        for dofs, part in self.parts.items():
            part.merge(other.parts[dofs])
        self.n_samples += other.n_samples
        return self

    @classmethod
    def from_gram(
        cls,
        layout: Layout,
        groups: Sequence[Group],
        gram: Callable[[tuple[int, ...]], tuple[np.ndarray, int]],
        known_masses: dict[int, float] | None = None,
    ) -> Moments:
        """Moments cut out of one Gram matrix of all columns ``[terms | a_1..a_n | F_1..F_n]``.

        Parameters
        ----------
        layout : Layout
        groups : sequence of Group
        gram : callable
            From the DOFs of a group to the Gram matrix of the samples in which their forces are known,
            and the number of these samples.
        known_masses : mapping of int to float, optional

        Returns
        -------
        Moments
        """
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
            self.groups[group.dofs], self.parts[group.dofs] = group, part
            self.n_samples = max(self.n_samples, size)
        return self

    def positions(self, dofs: tuple[int, ...]) -> tuple[dict, int | None, int]:
        """Where the columns of a group stand: site -> slice, mass column (or None), target column."""
        group, at, where = self.groups[dofs], 0, {}
        for site in group.sites:
            where[site] = slice(at, at + self.layout.counts[site])
            at += self.layout.counts[site]
        return where, (at if len(dofs) == 1 else None), (at + 1 if len(dofs) == 1 else at)


def accumulate(moments: Moments, blocks: Iterable[Block]) -> Moments:
    """Stream blocks of samples into moments.

    Parameters
    ----------
    moments : Moments
    blocks : iterable of Block

    Returns
    -------
    Moments
    """
    for block in blocks:
        moments.add(block)
    return moments


def blocks_of(terms: np.ndarray, acceleration: np.ndarray, force: np.ndarray, size: int = BLOCK) -> Iterator[Block]:
    """Cut ready-made columns into blocks.

    Parameters
    ----------
    terms : ndarray of shape (n_samples, n_terms)
    acceleration, force : ndarray of shape (n_samples, n_dof)
    size : int
        Samples in a block.

    Yields
    ------
    Block
    """
    for start in range(0, len(acceleration), size):
        rows = slice(start, start + size)
        yield Block(terms[rows].T, acceleration[rows].T, force[rows].T)
