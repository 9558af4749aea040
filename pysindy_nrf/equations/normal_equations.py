"""The one container of moments: Gram matrices of the columns of each balance, block by
block of the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from ..chain.layout import Group, Layout
from ..chain.sites import Site
from ..exceptions import NRFError

Dofs = tuple[int, ...]
KINDS = ("gram", "root")
# Directions of the instruments whose share of the largest is below this are round-off.
_CUT = 1e-12


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gram matrices of ``[terms of the sites | a_j | F_j]`` of each balance, by block
    of samples.
    """

    layout: Any  # a LawLayout where the columns come from laws
    groups: Mapping[Dofs, Group]  # balances, by their DOFs
    # (n_blocks, p, p), or (p, p) of a sum; by the DOFs of the balance. For ``"root"``
    # matrices R of shape (..., q, p) with ``R.T @ R`` = Gram matrix
    matrices: Mapping[Dofs, np.ndarray]
    sizes: Mapping[
        Dofs, Any
    ]  # (...); samples in which the forces of the balance are known
    n_samples: Any  # (...); all samples
    known_masses: Mapping[int, float]  # kg; those behind sums of balances
    kind: str = "gram"  # roots keep the digits that squaring would lose
    # whether the rows hold instruments behind the columns: the same balance without its
    # right-hand side, of another motion. See :meth:`projected`
    instrumented: bool = False
    record: np.ndarray | None = None  # (n_blocks,); number of the record of each block

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of blocks; empty for a sum."""
        return np.shape(self.n_samples)

    def __len__(self) -> int:
        return self.shape[0]

    def __bool__(self) -> bool:
        return True

    def __repr__(self) -> str:
        counts = [*((n, "block") for n in self.shape), (len(self.groups), "balance")]
        what = [f"{n} {word}{'s' * (n != 1)}" for n, word in counts]
        return (
            f"NormalEquations({', '.join(what)}, {np.sum(self.n_samples):.0f} samples)"
        )

    def __getitem__(self, which: Any) -> NormalEquations:
        """Some of the blocks, or a single one."""
        record = (
            None
            if self.record is None or np.ndim(self.record[which]) == 0
            else self.record[which]
        )
        return self._each(lambda x: x[which], lambda n: n[which], record=record)

    def _each(
        self, of_matrix: Callable, of_number: Callable, **changes: Any
    ) -> NormalEquations:
        """Every matrix and every number of samples put through a function."""
        matrices = {dofs: of_matrix(x) for dofs, x in self.matrices.items()}
        sizes = {dofs: of_number(n) for dofs, n in self.sizes.items()}
        return replace(
            self,
            matrices=matrices,
            sizes=sizes,
            n_samples=of_number(self.n_samples),
            **changes,
        )

    def positions(self, dofs: Dofs) -> tuple[dict[Site, slice], int | None, int]:
        """Where the columns of a balance stand: slice of each site, mass column (or
        None), target column.
        """
        at, where = 0, {}
        for site in self.groups[dofs].sites:
            where[site] = slice(at, at + self.layout.counts[site])
            at += self.layout.counts[site]
        return (
            where,
            (at if len(dofs) == 1 else None),
            (at + 1 if len(dofs) == 1 else at),
        )

    def sum(self, weights: Any = None) -> NormalEquations:
        """Sum of the blocks, each taken ``weights`` times, (..., n_blocks)."""
        weights = (
            np.ones(self.shape) if weights is None else np.asarray(weights, dtype=float)
        )
        total = (
            _sum_of_roots if self.kind == "root" else lambda x, w: np.tensordot(w, x, 1)
        )
        return self._each(
            lambda x: total(x, weights), lambda n: (weights @ n)[()], record=None
        )

    def leave_one_out(self) -> NormalEquations:
        """Sums of all blocks but one, for each block; what is zero in all others stays
        exactly zero.
        """
        if self.kind == "root":
            return self.sum(1.0 - np.eye(len(self)))
        return self._each(leave_one_out, leave_one_out)

    def merge(self, other: NormalEquations) -> NormalEquations:
        """Sum of these and others, block by block."""
        self._require_alike(other)
        add = (
            (lambda x, y: upper_of(np.concatenate([x, y], axis=-2)))
            if self.kind == "root"
            else np.add
        )
        return replace(
            self,
            matrices={
                dofs: add(x, other.matrices[dofs]) for dofs, x in self.matrices.items()
            },
            sizes={dofs: n + other.sizes[dofs] for dofs, n in self.sizes.items()},
            n_samples=self.n_samples + other.n_samples,
        )

    @classmethod
    def stack(
        cls, parts: Sequence[NormalEquations], record: Any = None
    ) -> NormalEquations:
        """Parts without blocks (sums) as the blocks of one, ``record`` their
        records.
        """
        first = parts[0]
        for other in parts[1:]:
            first._require_alike(other)
        return replace(
            first,
            matrices={
                dofs: np.stack([p.matrices[dofs] for p in parts])
                for dofs in first.matrices
            },
            sizes={
                dofs: np.stack([p.sizes[dofs] for p in parts]) for dofs in first.sizes
            },
            n_samples=np.stack([p.n_samples for p in parts]),
            record=None if record is None else np.asarray(record, dtype=int),
        )

    def _require_alike(self, other: NormalEquations) -> None:
        same = set(self.matrices) == set(other.matrices)
        wide = same and all(
            x.shape[-1] == other.matrices[dofs].shape[-1]
            for dofs, x in self.matrices.items()
        )
        if self.kind != other.kind or not wide:
            what = (
                "Gram matrices of different"
                f" {'columns or kinds' if same else 'balances'} cannot be added"
            )
            raise NRFError(what, "Accumulate both with the same layout.")

    def roots(self) -> NormalEquations:
        """Triangular roots of the Gram matrices."""
        if self.kind == "root":
            return self
        return replace(
            self,
            matrices={d: scaled_cholesky(x) for d, x in self.matrices.items()},
            kind="root",
        )

    def squares(self) -> NormalEquations:
        """Gram matrices of the roots."""
        if self.kind == "gram":
            return self
        return replace(
            self,
            matrices={d: x.swapaxes(-1, -2) @ x for d, x in self.matrices.items()},
            kind="gram",
        )

    def transformed(
        self, layout: Layout, changes: Mapping[Group, np.ndarray]
    ) -> NormalEquations:
        """The same samples in other columns: those of each balance times its change, an
        index array or a matrix.
        """
        matrices = {}
        for group, change in changes.items():
            x = self.matrices[group.dofs]
            if change.ndim == 1:
                x = (
                    x[..., change]
                    if self.kind == "root"
                    else x[..., change[:, None], change]
                )
            else:
                x = x @ change if self.kind == "root" else change.T @ x @ change
            matrices[group.dofs] = x
        groups, sizes = (
            {g.dofs: g for g in changes},
            {g.dofs: self.sizes[g.dofs] for g in changes},
        )
        return replace(
            self, layout=layout, groups=groups, matrices=matrices, sizes=sizes
        )

    def projected(self) -> NormalEquations:
        """Roots of the columns projected on the instruments Z."""
        if not self.instrumented:
            return self
        # the solve of these is two-stage least squares, instrumental variables where
        # there are as many as unknowns
        matrices = {
            dofs: _projected(x, (x.shape[-1] + 1) // 2)
            for dofs, x in self.matrices.items()
        }
        return replace(self, matrices=matrices, kind="root", instrumented=False)

    def triangle(self, dofs: Dofs, combine: np.ndarray) -> np.ndarray:
        """Upper triangular R, (..., p, p), with ``R.T @ R`` the Gram matrix of the
        columns of a balance times ``combine``, (..., n_columns, p).
        """
        matrix = self.matrices[dofs]
        if self.kind == "gram":
            gram = combine.swapaxes(-1, -2) @ matrix @ combine
            return scaled_cholesky(0.5 * (gram + gram.swapaxes(-1, -2)))
        return upper_of(matrix @ combine)

    def norms(self, dofs: Dofs, weights: np.ndarray) -> np.ndarray:
        """Lengths, (..., p), of combinations of the columns of a balance; ``weights``
        is (..., n_columns, p).
        """
        image = self.matrices[dofs] @ weights
        if self.kind == "root":
            return np.linalg.norm(image, axis=-2)
        return np.sqrt(
            np.clip(np.einsum("...ij,...ij->...j", weights, image), 0.0, None)
        )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays, as ``numpy.savez`` takes them; layout and balances are given
        again to :meth:`from_arrays`.
        """
        out = {
            f"gram {'-'.join(map(str, dofs))}": np.asarray(x)
            for dofs, x in self.matrices.items()
        }
        out |= {
            f"size {'-'.join(map(str, dofs))}": np.asarray(n)
            for dofs, n in self.sizes.items()
        }
        out |= {
            "n_samples": np.asarray(self.n_samples),
            "kind": np.array(KINDS.index(self.kind)),
        }
        out |= {} if self.record is None else {"record": self.record}
        return out | {"instrumented": np.array(self.instrumented)}

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, np.ndarray],
        layout: Layout,
        groups: Iterable[Group],
        known_masses: Mapping[int, float] | None = None,
    ) -> NormalEquations:
        """What :meth:`to_arrays` wrote, of the same layout and balances."""
        held = {g.dofs: g for g in groups}
        names = {dofs: "-".join(map(str, dofs)) for dofs in held}
        return cls(
            layout,
            held,
            {d: arrays[f"gram {x}"] for d, x in names.items()},
            {d: arrays[f"size {x}"][()] for d, x in names.items()},
            arrays["n_samples"][()],
            dict(known_masses or {}),
            KINDS[int(arrays["kind"])],
            bool(arrays["instrumented"]),
            arrays.get("record"),
        )


def variance(values: Any) -> np.ndarray:
    """Variance of an estimate from its n values, each with one part of the data left
    out (jackknife).
    """
    values = np.asarray(values)
    n = len(values)
    return (n - 1) / n * ((values - values.mean(axis=0)) ** 2).sum(axis=0)


def leave_one_out(blocks: np.ndarray) -> np.ndarray:
    """Sums of all entries of the first axis but one, from both ends, so that what is
    zero stays zero.
    """
    zero = np.zeros_like(blocks[:1])
    before = np.concatenate([zero, np.cumsum(blocks[:-1], axis=0)])
    return before + np.concatenate([zero, np.cumsum(blocks[:0:-1], axis=0)])[::-1]


def width_of(layout: Layout, group: Group) -> int:
    """Columns of a balance: its terms, and a_j and F_j, or the right-hand side of a sum
    of balances.
    """
    return sum(layout.counts[s] for s in group.sites) + (
        2 if len(group.dofs) == 1 else 1
    )


def root_of(rows: np.ndarray) -> np.ndarray:
    """Upper triangular factor of rows, (n, p), square; zeros below where there are
    fewer rows than columns.
    """
    return _squared_off(
        linalg.qr(rows, mode="r", overwrite_a=True, check_finite=False)[0][
            : rows.shape[1]
        ]
    )


def upper_of(rows: np.ndarray) -> np.ndarray:
    """The same of rows (..., n, p)."""
    return _squared_off(np.asarray(np.linalg.qr(rows, mode="r")))


def scaled_cholesky(gram: np.ndarray) -> np.ndarray:
    """Upper factor of Gram matrices (..., p, p) whose columns span many orders of
    magnitude.
    """
    scale = np.sqrt(np.clip(np.diagonal(gram, axis1=-2, axis2=-1), 0.0, None))
    safe = np.where(scale > 0, scale, 1.0)
    unit = gram / safe[..., :, None] / safe[..., None, :]
    p = unit.shape[-1]
    try:  # an empty column takes no part
        whole = unit + (scale == 0)[..., None] * np.eye(p)
        if gram.ndim == 2:
            return linalg.cholesky(whole, check_finite=False) * scale
        return (
            np.linalg.cholesky(whole).swapaxes(-1, -2) * scale[..., None, :]
        )  # SciPy takes one at a time
    except np.linalg.LinAlgError:
        pass
    if gram.ndim > 2:
        return np.array([scaled_cholesky(one) for one in gram])
    upper = np.zeros_like(
        unit
    )  # a pivot lost to round-off is zero: a combination of the columns before it
    for i in range(p):
        row = unit[i, i:] - upper[:i, i] @ upper[:i, i:]
        if row[0] > 4 * p * np.finfo(float).eps:
            upper[i, i:] = row / np.sqrt(row[0])
    return upper * scale


def _squared_off(upper: np.ndarray) -> np.ndarray:
    """A factor that has fewer rows than columns gets rows of zeros below."""
    if upper.shape[-2] == upper.shape[-1]:
        return upper
    out = np.zeros((*upper.shape[:-2], upper.shape[-1], upper.shape[-1]))
    out[..., : upper.shape[-2], :] = upper
    return out


def _sum_of_roots(roots: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Roots of weighted sums of what roots (n_blocks, q, p) stand for."""
    p = roots.shape[-1]
    out = np.empty((*weights.shape[:-1], p, p))
    for at in np.ndindex(*weights.shape[:-1]):
        w = weights[at]
        some = np.flatnonzero(w)
        rows = (np.sqrt(w[some])[:, None, None] * roots[some]).reshape(-1, p)
        out[at] = root_of(rows) if len(rows) else 0.0
    return out


def _projected(gram: np.ndarray, n: int) -> np.ndarray:
    """Roots of the first n columns projected on the others; square, zeros below."""
    inner, cross = gram[n:, n:], gram[n:, :n]
    scale = np.sqrt(np.diag(inner))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(inner / scale[:, None] / scale)
    good = values > _CUT * values[-1]
    out = np.zeros((n, n))
    out[: good.sum()] = (vectors[:, good] / np.sqrt(values[good])).T @ (
        cross / scale[:, None]
    )
    return out


# Ridges that are tried, shares of the squares of the columns.
_RIDGE = (1e-9, 1e-5, 1e-3, 3e-2)


class Regression:
    """Least squares on some blocks, judged on the others; all on Gram matrices of
    blocks.

    ``at`` holds the columns of the Gram matrices by the name of their group.
    """

    def __init__(
        self, grams: np.ndarray, at: Mapping[str, np.ndarray], n_folds: int = 5
    ) -> None:
        self.at = at
        self.size = np.sqrt(np.maximum(np.einsum("bii->i", grams), 0.0))
        self.size[self.size == 0] = 1.0
        self.grams = grams / np.outer(self.size, self.size)
        self.folds = np.arange(len(grams)) % min(n_folds, len(grams))
        self._fits: dict[tuple[str, tuple[str, ...]], tuple[np.ndarray, float]] = {}

    @classmethod
    def of(
        cls,
        groups: Mapping[str, Sequence[np.ndarray]],
        n_blocks: int = 25,
        n_folds: int = 5,
    ) -> Regression:
        """The regression on groups of columns, each with one array for every record."""
        widths = [
            1 if parts[0].ndim == 1 else parts[0].shape[1] for parts in groups.values()
        ]
        ends = np.cumsum([0, *widths])
        at = {name: np.arange(a, b) for name, a, b in zip(groups, ends, ends[1:])}
        blocks = in_blocks(
            [np.column_stack(parts) for parts in zip(*groups.values())], n_blocks
        )
        return cls(np.array([b.T @ b for b in blocks]), at, n_folds)

    def left(self, target: str, names: Sequence[str] = ()) -> np.ndarray:
        """Squares of a target left in every block by columns fitted to the other folds;
        the best ridge counts.
        """
        return self._fit(target, tuple(names))[0]

    def share(
        self, target: str, names: Sequence[str], beside: Sequence[str] = ()
    ) -> tuple[float, float]:
        """Held-out share of the squares left by ``beside`` that further columns
        explain, and its standard error.
        """
        return share_of(self.left(target, beside), self.left(target, [*beside, *names]))

    def coefficients(self, target: str, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Coefficients on all data, by name, in the columns' own units."""
        index = self._index(target, names)
        w = _solved(
            self.grams.sum(axis=0)[index[:, None], index],
            self._fit(target, tuple(names))[1],
        )
        w = w * self.size[index[-1]] / self.size[index[:-1]]
        ends = np.cumsum([0, *(len(self.at[name]) for name in names)])
        return {name: w[a:b] for name, a, b in zip(names, ends, ends[1:])}

    def _index(self, target: str, names: Sequence[str]) -> np.ndarray:
        return np.concatenate([self.at[name] for name in (*names, target)])

    def _fit(self, target: str, names: tuple[str, ...]) -> tuple[np.ndarray, float]:
        """Squares left in every block, and the ridge that leaves least."""
        if (target, names) not in self._fits:
            index = self._index(target, names)
            grams = self.grams[:, index[:, None], index]
            scale = float(self.size[index[-1]]) ** 2
            count = int(self.folds.max()) + 1
            parts = np.array([grams[self.folds == k].sum(axis=0) for k in range(count)])
            train = parts.sum(axis=0) - parts if count > 1 else parts
            ridges = np.array(_RIDGE if len(index) > 1 else _RIDGE[:1])
            full = np.insert(
                -_solved(train, ridges[:, None, None, None]),
                len(index) - 1,
                1.0,
                axis=2,
            )
            full = full.transpose(1, 2, 0)[
                self.folds
            ]  # (n_blocks, n_columns, n_ridges)
            left = scale * np.maximum((full * (grams @ full)).sum(axis=1), 0.0)
            best = left.sum(axis=0).argmin()
            self._fits[target, names] = left[:, best], float(ridges[best])
        return self._fits[target, names]


def in_blocks(records: Sequence[np.ndarray], n_blocks: int = 25) -> list[np.ndarray]:
    """Rows of all records, cut into contiguous blocks of about equal length."""
    total = sum(map(len, records))
    counts = [max(1, int(round(n_blocks * len(part) / total))) for part in records]
    return [
        block
        for part, count in zip(records, counts)
        for block in np.array_split(part, count)
    ]


def _solved(grams: np.ndarray, ridge: Any) -> np.ndarray:
    """Ridge regression of the last column on the others, one for each Gram matrix and
    ridge.
    """
    A, h = grams[..., :-1, :-1], grams[..., :-1, -1:]
    eye = np.eye(A.shape[-1])
    sizes = np.maximum(np.einsum("...ii->...i", A), 1e-12)[..., None, :] * eye
    return np.linalg.solve(A + ridge * sizes + 1e-12 * eye, h)[..., 0]


def share_of(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """``1 - sum(after) / sum(before)`` over blocks, and its standard error
    (jackknife).
    """
    if before.sum() <= 0:
        return 0.0, 0.0
    share = 1.0 - float(after.sum() / before.sum())
    if len(before) < 3:
        return share, float("nan")
    top, bottom = after.sum() - after, before.sum() - before
    ratio = np.divide(top, bottom, out=np.ones(len(before)), where=bottom > 0)
    return share, float(np.sqrt(variance(ratio)))
