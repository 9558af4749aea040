"""Sums of products of the columns of each equation of motion, block by block.

They are all that least squares reads of the samples: every fit, fold and interval is
solved from some sum of blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..chain.identifiability import SolveOrder
from ..chain.layout import Group, Layout
from ..chain.sites import Site
from ..common.plain_tables import PlainState
from ..exceptions import NRFError
from .jackknife import leave_one_out, share_of, variance
from .ridge_regression import Regression, in_blocks
from .triangular import projected_root, scaled_cholesky, upper_of, weighted_root

__all__ = [
    "ColumnPlaces",
    "NormalEquations",
    "Regression",
    "groups_of",
    "in_blocks",
    "leave_one_out",
    "share_of",
    "variance",
    "width_of",
]

Dofs = tuple[int, ...]
# A number of a sum, or one for each of several blocks.
PerBlock = float | np.ndarray
# What the matrices are: the sums of products, or triangular factors of them, which keep
# the digits that squaring would lose. Files store the number in this list.
KINDS = ("gram", "root")


class ColumnPlaces(NamedTuple):
    """Where the columns of one equation of motion, or of several summed, stand.

    Attributes
    ----------
    sites : dict of Site to slice
        The terms of each site.
    mass : int or None
        The acceleration; a sum of equations has none.
    target : int
        The right-hand side.
    """

    sites: dict[Site, slice]
    mass: int | None
    target: int


@dataclass(frozen=True, eq=False)
class NormalEquations(PlainState):
    """Sums of products of ``[terms of the sites | a_j | F_j]`` of each equation.

    Attributes
    ----------
    layout : Layout
        A LawLayout where the columns come from laws.
    groups : mapping of tuple of int to Group
        Equations of motion, or several summed, by their DOFs.
    matrices : mapping of tuple of int to ndarray
        Shape (n_blocks, p, p), or (p, p) of a sum of blocks. For the kind ``"root"``
        matrices R of shape (..., q, p) with ``R.T @ R`` = sum of products.
    sizes : mapping of tuple of int to ndarray
        Samples in which the forces of the equation are known, (...).
    n_samples : ndarray
        All samples, (...).
    known_masses : mapping of int to float
        Those behind sums of equations, kg.
    kind : {"gram", "root"}
    instrumented : bool
        Whether the columns have instruments behind them: the same equation without its
        right-hand side, of another motion. See :meth:`projected`.
    record : ndarray of shape (n_blocks,), optional
        Number of the record of each block.
    """

    layout: Any  # a LawLayout where laws are read
    groups: Mapping[Dofs, Group]
    matrices: Mapping[Dofs, np.ndarray]
    sizes: Mapping[Dofs, np.ndarray]
    n_samples: np.ndarray
    known_masses: Mapping[int, float]
    kind: str = "gram"
    instrumented: bool = False
    record: np.ndarray | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of blocks; empty for a sum."""
        return np.shape(self.n_samples)

    def __len__(self) -> int:
        return self.shape[0]

    def __bool__(self) -> bool:
        return True

    def __repr__(self) -> str:
        parts = [_counted(n, "block") for n in self.shape]
        parts.append(_counted(len(self.groups), "balance"))
        parts.append(f"{np.sum(self.n_samples):.0f} samples")
        return f"NormalEquations({', '.join(parts)})"

    def __getitem__(self, which: int | slice | np.ndarray) -> NormalEquations:
        """Some of the blocks, or a single one."""

        def chosen(values: np.ndarray) -> np.ndarray:
            return values[which]

        record = None
        if self.record is not None and np.ndim(self.record[which]):
            record = self.record[which]
        return self._mapped(chosen, chosen, record)

    def _mapped(
        self,
        of_matrices: Callable[[np.ndarray], np.ndarray],
        of_sizes: Callable[[np.ndarray], np.ndarray],
        record: np.ndarray | None,
    ) -> NormalEquations:
        """Every matrix and every number of samples put through a function."""
        return replace(
            self,
            matrices={dofs: of_matrices(x) for dofs, x in self.matrices.items()},
            sizes={dofs: of_sizes(n) for dofs, n in self.sizes.items()},
            n_samples=of_sizes(self.n_samples),
            record=record,
        )

    def positions(self, dofs: Dofs) -> ColumnPlaces:
        """Where the columns of an equation stand."""
        sites = {}
        start = 0
        for site in self.groups[dofs].sites:
            stop = start + self.layout.counts[site]
            sites[site] = slice(start, stop)
            start = stop
        if len(dofs) == 1:
            return ColumnPlaces(sites, mass=start, target=start + 1)
        return ColumnPlaces(sites, mass=None, target=start)

    def sum(self, weights: npt.ArrayLike | None = None) -> NormalEquations:
        """Sum of the blocks, each taken ``weights`` times, (..., n_blocks)."""
        if weights is None:
            weights = np.ones(self.shape)
        times = np.asarray(weights, dtype=float)

        def total(matrices: np.ndarray) -> np.ndarray:
            if self.kind == "gram":
                return np.tensordot(times, matrices, 1)
            rows = times.reshape(-1, times.shape[-1])
            roots = np.array([weighted_root(matrices, row) for row in rows])
            return roots.reshape(*times.shape[:-1], *roots.shape[1:])

        def count(sizes: np.ndarray) -> np.ndarray:
            return (times @ sizes)[()]

        return self._mapped(total, count, None)

    def leave_one_out(self) -> NormalEquations:
        """Sums of all blocks but one, for each block.

        What is zero in all others stays exactly zero.
        """
        if self.kind == "root":
            return self.sum(1.0 - np.eye(len(self)))
        return self._mapped(leave_one_out, leave_one_out, self.record)

    def merge(self, other: NormalEquations) -> NormalEquations:
        """Sum of these and others, block by block."""
        self._require_alike(other)
        matrices = {}
        sizes = {}
        for dofs, matrix in self.matrices.items():
            added = other.matrices[dofs]
            if self.kind == "root":
                matrices[dofs] = upper_of(np.concatenate([matrix, added], axis=-2))
            else:
                matrices[dofs] = matrix + added
            sizes[dofs] = self.sizes[dofs] + other.sizes[dofs]
        n_samples = self.n_samples + other.n_samples
        return replace(self, matrices=matrices, sizes=sizes, n_samples=n_samples)

    @classmethod
    def stack(
        cls, parts: Sequence[NormalEquations], record: npt.ArrayLike | None = None
    ) -> NormalEquations:
        """Parts without blocks (sums) as the blocks of one.

        ``record`` are the numbers of their records.
        """
        first = parts[0]
        for other in parts[1:]:
            first._require_alike(other)

        matrices = {}
        sizes = {}
        for dofs in first.matrices:
            matrices[dofs] = np.stack([block.matrices[dofs] for block in parts])
            sizes[dofs] = np.stack([block.sizes[dofs] for block in parts])
        return replace(
            first,
            matrices=matrices,
            sizes=sizes,
            n_samples=np.stack([block.n_samples for block in parts]),
            record=None if record is None else np.asarray(record, dtype=int),
        )

    def _require_alike(self, other: NormalEquations) -> None:
        """Refuse sums of other equations, columns or kinds."""
        cure = "Accumulate both with the same layout."
        if self.matrices.keys() != other.matrices.keys():
            what = "Gram matrices of different balances cannot be added"
            raise NRFError(what, cure)
        for dofs, matrix in self.matrices.items():
            if matrix.shape[-1] != other.matrices[dofs].shape[-1]:
                what = "Gram matrices of different columns or kinds cannot be added"
                raise NRFError(what, cure)
        if self.kind != other.kind:
            what = "Gram matrices of different columns or kinds cannot be added"
            raise NRFError(what, cure)

    def roots(self) -> NormalEquations:
        """The same as triangular factors."""
        if self.kind == "root":
            return self
        roots = {dofs: scaled_cholesky(x) for dofs, x in self.matrices.items()}
        return replace(self, matrices=roots, kind="root")

    def squares(self) -> NormalEquations:
        """The same as sums of products."""
        if self.kind == "gram":
            return self
        squares = {dofs: x.swapaxes(-1, -2) @ x for dofs, x in self.matrices.items()}
        return replace(self, matrices=squares, kind="gram")

    def transformed(
        self, layout: Layout, changes: Mapping[Group, np.ndarray]
    ) -> NormalEquations:
        """The same samples in other columns.

        Those of each equation are its own times its change, an index array or a
        matrix.
        """
        matrices = {}
        for group, change in changes.items():
            matrix = self.matrices[group.dofs]
            if self.kind == "root":
                matrices[group.dofs] = _changed(matrix, change)
            elif change.ndim == 1:
                matrices[group.dofs] = matrix[..., change[:, None], change]
            else:
                matrices[group.dofs] = change.T @ matrix @ change
        groups = {group.dofs: group for group in changes}
        sizes = {dofs: self.sizes[dofs] for dofs in groups}
        return replace(
            self, layout=layout, groups=groups, matrices=matrices, sizes=sizes
        )

    def with_terms(
        self,
        layout: Layout,
        terms: Mapping[Site, np.ndarray],
        groups: Iterable[Group] | None = None,
    ) -> NormalEquations:
        """The same samples with some of the terms of each site, by their numbers.

        ``groups`` are the equations that remain, all of them if None.
        """
        changes = {}
        for group in self.groups.values() if groups is None else groups:
            places = self.positions(group.dofs)
            columns = [places.sites[site].start + terms[site] for site in group.sites]
            if places.mass is not None:
                columns.append(np.array([places.mass]))
            columns.append(np.array([places.target]))
            changes[group] = np.concatenate(columns)
        return self.transformed(layout, changes)

    def projected(self) -> NormalEquations:
        """Roots of the columns projected on the instruments.

        Their solve is two-stage least squares, instrumental variables where there are
        as many instruments as unknowns.
        """
        if not self.instrumented:
            return self
        matrices = {}
        for dofs, products in self.matrices.items():
            n_columns = (products.shape[-1] + 1) // 2
            matrices[dofs] = projected_root(products, n_columns)
        return replace(self, matrices=matrices, kind="root", instrumented=False)

    def triangle(self, dofs: Dofs, combine: np.ndarray) -> np.ndarray:
        """Upper triangular R (..., p, p) of combinations of the columns of an equation.

        ``R.T @ R`` are their products; ``combine`` is (..., n_columns, p).
        """
        matrix = self.matrices[dofs]
        if self.kind == "root":
            return upper_of(matrix @ combine)
        gram = combine.swapaxes(-1, -2) @ matrix @ combine
        return scaled_cholesky(0.5 * (gram + gram.swapaxes(-1, -2)))

    def norms(self, dofs: Dofs, weights: np.ndarray) -> np.ndarray:
        """Lengths (..., p) of combinations of the columns of an equation.

        ``weights`` is (..., n_columns, p).
        """
        image = self.matrices[dofs] @ weights
        if self.kind == "root":
            return np.linalg.norm(image, axis=-2)
        squares = np.einsum("...ij,...ij->...j", weights, image)
        return np.sqrt(np.clip(squares, 0.0, None))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays, as ``numpy.savez`` takes them.

        Layout and groups are given again to :meth:`from_arrays`.
        """
        arrays = {
            "n_samples": np.asarray(self.n_samples),
            "kind": np.array(KINDS.index(self.kind)),
            "instrumented": np.array(self.instrumented),
        }
        if self.record is not None:
            arrays["record"] = self.record
        for dofs, matrix in self.matrices.items():
            arrays[f"gram {_text(dofs)}"] = np.asarray(matrix)
            arrays[f"size {_text(dofs)}"] = np.asarray(self.sizes[dofs])
        return arrays

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, np.ndarray],
        layout: Layout,
        groups: Iterable[Group],
        known_masses: Mapping[int, float] | None = None,
    ) -> NormalEquations:
        """What :meth:`to_arrays` wrote, of the same layout and groups."""
        by_dofs = {group.dofs: group for group in groups}
        return cls(
            layout,
            by_dofs,
            matrices={dofs: arrays[f"gram {_text(dofs)}"] for dofs in by_dofs},
            sizes={dofs: arrays[f"size {_text(dofs)}"][()] for dofs in by_dofs},
            n_samples=arrays["n_samples"][()],
            known_masses=dict(known_masses or {}),
            kind=KINDS[int(arrays["kind"])],
            instrumented=bool(arrays["instrumented"]),
            record=arrays.get("record"),
        )


def _counted(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def _text(dofs: Dofs) -> str:
    return "-".join(map(str, dofs))


def _changed(root: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Some columns of a root, or combinations of them."""
    return root[..., change] if change.ndim == 1 else root @ change


def width_of(layout: Layout, group: Group) -> int:
    """Columns of one equation of motion, or of several summed.

    Its terms, and a_j and F_j, or the right-hand side of a sum.
    """
    n_terms = sum(map(layout.counts.__getitem__, group.sites))
    return n_terms + (2 if len(group.dofs) == 1 else 1)


def groups_of(layout: Layout, solve_order: SolveOrder) -> list[Group]:
    """Every equation of motion, and the sums of equations that an order solves."""
    dofs = [(j,) for j in range(1, layout.n_dof + 1)]
    sums = [step.dofs for step in solve_order.steps if len(step.dofs) > 1]
    return [layout.group(group) for group in dict.fromkeys([*dofs, *sums])]
