"""Compiled: the pass over samples, each pair of sites that meets multiplied once; the solve of many Gram matrices."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from threading import local
from typing import TYPE_CHECKING

import numpy as np

from .layout import Group, Layout, Recipe

if TYPE_CHECKING:
    from .layout import Block

TILE = 256  # samples whose columns stay in the first and second cache
_PAD = 8  # rows of the scratch are not a power of two apart, which would map them onto one cache line


class Plan:
    """Rows ``[a_1, F_1, 0, a_2, ... | sums of balances | terms | helpers]``: how they are built and multiplied."""

    def __init__(self, layout: Layout, groups: Sequence[Group], masses: Mapping[int, float]) -> None:
        n = layout.n_dof
        self.masses = np.array([masses.get(j, 0.0) for j in range(1, n + 1)])
        sums = sorted((g.dofs for g in groups if len(g.dofs) > 1), key=len)  # of all DOFs from one on
        self.sums = np.array([dofs[0] - 1 for dofs in sums], dtype=np.int64)
        # rows of DOFs, sums and sites; each begins at a multiple of three, with rows of zeros behind it
        counts: dict[object, int] = {j: 2 for j in range(1, n + 1)}
        counts |= {dofs: 1 for dofs in sums} | {s: layout.counts[s] for s in layout.acting}
        ends = np.cumsum([0, *(-(-k // 3) * 3 for k in counts.values())]).tolist()
        units = {unit: (at, end - at) for unit, at, end in zip(counts, ends, ends[1:])}
        self.terms = np.array([units[s][0] + k for s in layout.acting for k in range(layout.counts[s])], dtype=int)
        place: dict[tuple, int] = {}
        pairs, size = [], 0
        self.take: dict[tuple[int, ...], np.ndarray] = {}
        for group in groups:
            own = [*group.sites, group.dofs[0] if len(group.dofs) == 1 else group.dofs]
            ends = np.cumsum([0, *(counts[u] for u in own)]).tolist()
            index = np.zeros((ends[-1], ends[-1]), dtype=np.int64)
            for i, left in enumerate(own):
                for j, right in enumerate(own[: i + 1]):
                    low, high = sorted((left, right), key=units.__getitem__)
                    (x, m), (y, k) = units[high], units[low]
                    if x != y and counts[low] == 2:
                        k = 2  # acceleration and force of a DOF need no third column
                    if (x, y) not in place:
                        place[x, y] = size
                        pairs.append((x, m, y, k, size))
                        size += m * k
                    block = place[x, y] + np.arange(m)[: counts[high], None] * k + np.arange(counts[low])
                    if i == j:  # only what is on and below the diagonal is multiplied
                        line = np.arange(counts[low])
                        block = np.where(line[:, None] >= line, block, block.T)
                    block = block if high == left else block.T
                    index[ends[i] : ends[i + 1], ends[j] : ends[j + 1]] = block
                    index[ends[j] : ends[j + 1], ends[i] : ends[i + 1]] = block.T
            self.take[group.dofs] = index
        self.pairs = np.array(pairs, dtype=np.int64).reshape(-1, 5)
        self.size = size
        self.n_rows = sum(size for _, size in units.values())
        self._channels = np.r_[3 * np.arange(n), 3 * np.arange(n) + 1]
        self._placed: tuple[Recipe | None, np.ndarray, np.ndarray, int] | None = None
        self._own = local()  # each thread's scratch

    def multiply(self, block: Block, store: np.ndarray) -> None:
        """Add the products of the columns of a block to ``store``, shape (size,); see ``take`` for its order."""
        recipe, placed = block.recipe, self._placed
        if placed is None or placed[0] is not recipe:
            self._placed = placed = recipe, *self._rows(recipe)
        _, places, steps, n_rows = placed
        scratch = getattr(self._own, "scratch", None)
        if scratch is None or len(scratch) < n_rows:
            self._own.scratch = scratch = np.zeros((n_rows, TILE + _PAD))
        source = block.terms if recipe is None else block.source
        given = (np.asarray(x, dtype=np.float64) for x in (block.acceleration, block.force, source))
        _kernel()(*given, places, steps, self.sums, self.masses, self.pairs, scratch, store)

    def _rows(self, recipe: Recipe | None) -> tuple[np.ndarray, np.ndarray, int]:
        """Rows of the channels of a block, how those of the terms are built from them, and how many there are."""
        if recipe is None:
            return _places(self._channels, self.terms), np.zeros((0, 3), dtype=np.int64), self.n_rows
        helpers = max(0, int(recipe.steps[:, 0].max(initial=-1)) + 1 - len(self.terms))
        size = self.n_rows + helpers
        rows = np.concatenate([self.terms, np.arange(self.n_rows, size)])
        row, x, p = recipe.steps.T
        copied = p < 0
        at = np.full(recipe.n_source, -1)
        at[x[copied]] = rows[row[copied]]  # put where the (last) term stands
        beside = np.flatnonzero(at < 0)
        at[beside] = size + np.arange(len(beside))
        steps = np.column_stack([rows[row], at[x], np.where(copied, -1, rows[p])])
        return _places(self._channels, at), steps[steps[:, 0] != steps[:, 1]], size + len(beside)


def _places(*rows: np.ndarray) -> np.ndarray:
    """Numbers of rows; without a sign, so that the machine need not ask whether they count from the end."""
    return np.concatenate(rows).astype(np.uint64)


@cache
def _kernel() -> Callable[..., None]:
    """The compiled pass."""
    from numba import types

    from ..laws.compiled import inline, jit

    def dot33(x, i, j, b, out, at, step):
        s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = 0.0
        for t in range(b):
            a0, a1, a2 = x[i, t], x[i + 1, t], x[i + 2, t]
            b0, b1, b2 = x[j, t], x[j + 1, t], x[j + 2, t]
            s00 += a0 * b0
            s01 += a0 * b1
            s02 += a0 * b2
            s10 += a1 * b0
            s11 += a1 * b1
            s12 += a1 * b2
            s20 += a2 * b0
            s21 += a2 * b1
            s22 += a2 * b2
        out[at] += s00
        out[at + 1] += s01
        out[at + 2] += s02
        out[at + step] += s10
        out[at + step + 1] += s11
        out[at + step + 2] += s12
        out[at + 2 * step] += s20
        out[at + 2 * step + 1] += s21
        out[at + 2 * step + 2] += s22

    def dot32(x, i, j, b, out, at):
        s00 = s01 = s10 = s11 = s20 = s21 = 0.0
        for t in range(b):
            a0, a1, a2, b0, b1 = x[i, t], x[i + 1, t], x[i + 2, t], x[j, t], x[j + 1, t]
            s00 += a0 * b0
            s01 += a0 * b1
            s10 += a1 * b0
            s11 += a1 * b1
            s20 += a2 * b0
            s21 += a2 * b1
        out[at] += s00
        out[at + 1] += s01
        out[at + 2] += s10
        out[at + 3] += s11
        out[at + 4] += s20
        out[at + 5] += s21

    fast = {"reassoc", "contract", "nsz"}
    threes, twos = inline(dot33, fastmath=fast), inline(dot32, fastmath=fast)

    def product(x, i, m, j, k, b, out, at):
        """Rows i..i+m times rows j..j+k into out[at:], row-major; only once for a pair of equal rows."""
        for p in range(0, m, 3):
            if k == 2:
                twos(x, i + p, j, b, out, at + 2 * p)
            else:
                for q in range(0, p + 3 if i == j else k, 3):
                    threes(x, i + p, j + q, b, out, at + p * k + q, k)

    products = inline(product)

    def copy(out, row):
        for t in range(out.size):
            out[t] = row[t]

    def multiply(out, left, right):
        for t in range(out.size):
            out[t] = left[t] * right[t]

    copied, multiplied = inline(copy), inline(multiply)

    def load(x, places, channels, start, b):
        if abs(channels.strides[0]) < abs(channels.strides[1]):  # the channels of a sample lie side by side
            for t in range(b):
                for j in range(channels.shape[0]):
                    x[places[j], t] = channels[j, start + t]
        else:
            for j in range(channels.shape[0]):
                for t in range(b):
                    x[places[j], t] = channels[j, start + t]

    loaded = inline(load)

    def gram_pass(a, force, source, places, steps, sums, masses, pairs, x, store):
        n = a.shape[0]
        for start in range(0, a.shape[1], TILE):
            b = min(TILE, a.shape[1] - start)
            loaded(x, places[:n], a, start, b)
            loaded(x, places[n : 2 * n], force, start, b)
            loaded(x, places[2 * n :], source, start, b)
            end = n
            for i in range(sums.size):
                row = 3 * (n + i)
                if i > 0:
                    copied(x[row, :b], x[row - 3, :b])
                else:
                    x[row, :b] = 0.0
                for j in range(sums[i], end):
                    for t in range(b):
                        x[row, t] += x[3 * j + 1, t] - masses[j] * x[3 * j, t]
                end = sums[i]
            for k in range(steps.shape[0]):
                row, of, p = steps[k, 0], steps[k, 1], steps[k, 2]
                if p < 0:
                    copied(x[row, :b], x[of, :b])
                else:
                    multiplied(x[row, :b], x[p, :b], x[of, :b])
            for k in range(pairs.shape[0]):
                products(x, pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3], b, store, pairs[k, 4])

    multiply_all = jit(gram_pass)  # one machine code, however the user's arrays lie in memory
    given, whole = types.Array(types.float64, 2, "A", readonly=True), types.Array(types.float64, 2, "C")
    places, table = types.Array(types.uint64, 1, "C"), types.Array(types.int64, 2, "C")
    line, starts = types.Array(types.float64, 1, "C"), types.Array(types.int64, 1, "C")
    multiply_all.compile((given, given, given, places, table, starts, line, table, whole, line))
    multiply_all.disable_compile()
    return multiply_all


OWN, KNOWN, MASS, SECOND = range(4)  # roles of a column in a step of the solve order


def _least_squares(gram, columns, target, values, work):
    """Solve for columns scaled to unit length; False where they depend on each other."""
    width = len(columns)
    for i in range(width):
        size = gram[columns[i], columns[i]]
        if not (size > 0.0 and size < np.inf):
            return False
        work[i, width] = 1.0 / np.sqrt(size)
    for i in range(width):
        dot = 0.0
        for j in range(len(target)):
            if target[j] != 0.0:
                dot += gram[columns[i], j] * target[j]
        values[i] = dot * work[i, width]
        for j in range(i + 1):
            part = gram[columns[i], columns[j]] * work[i, width] * work[j, width]
            for k in range(j):
                part -= work[i, k] * work[j, k]
            if i != j:
                work[i, j] = part / work[j, j]
            elif part > 9e-16 * (width + 1):
                work[i, i] = np.sqrt(part)
            else:
                return False
        for k in range(i):
            values[i] -= work[i, k] * values[k]
        values[i] /= work[i, i]
    for i in range(width - 1, -1, -1):
        for k in range(i + 1, width):
            values[i] -= work[k, i] * values[k]
        values[i] /= work[i, i]
    for i in range(width):
        values[i] *= work[i, width]
    return True


@cache
def compiled_solve() -> Callable[..., None]:
    """For each stack of Gram matrices: masses (known ones preset) and coefficients; NaN where it cannot be done."""
    from ..laws.compiled import jit, part

    least_squares = part(_least_squares)

    def chain(fit, n, at, steps, entries, dofs, masses, theta):
        p = fit.shape[2]
        target, values, work = np.empty(p), np.empty(p), np.empty((p, p + 1))
        columns = np.empty(p, dtype=np.int64)
        for b in range(fit.shape[0]):
            for i in range(len(steps)):
                u, e0, e1, d0, d1, free = steps[i]
                target[:] = 0.0
                for d in range(d0, d1):
                    target[at + n + dofs[d]] += 1.0
                    if not free:
                        target[at + dofs[d]] -= masses[b, dofs[d]]
                width = 0
                for e in range(e0, e1):
                    where, sign, role, j = entries[e]
                    if role == KNOWN:
                        target[where] -= sign * theta[b, where]
                    else:
                        columns[width] = where
                        width += 1
                if not least_squares(fit[b, u], columns[:width], target, values, work):
                    theta[b] = np.nan
                    break
                width = 0
                for e in range(e0, e1):
                    where, sign, role, j = entries[e]
                    if role == OWN:
                        theta[b, where] = sign * values[width]
                    elif role == MASS:
                        masses[b, j] = values[width]
                    if role != KNOWN:
                        width += 1

    return jit(chain)
