"""The compiled pass over samples: columns of the balances in cache, neighbours multiplied once.

The columns of a balance are those of the sites that meet at one DOF. A pair of sites that meets in
two balances is multiplied once; sites that never meet are not multiplied at all. Work per sample is
therefore proportional to the number of storeys.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from threading import local
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .layout import Group, Layout, Recipe

if TYPE_CHECKING:
    from .layout import Block

TILE = 256  # samples whose columns stay in the first and second cache
_PAD = 8  # rows of the scratch are not a power of two apart, which would map them onto one cache line
_COPY = -1  # second factor of a row that is copied


class Plan:
    """Rows ``[a_1, F_1, a_2, F_2, ... | sums of balances | terms | helpers]``: how they are built and multiplied."""

    def __init__(self, layout: Layout, groups: Sequence[Group], masses: Mapping[int, float]) -> None:
        n = layout.n_dof
        self.masses = np.array([masses.get(j, 0.0) for j in range(1, n + 1)])
        sums = sorted((g.dofs for g in groups if len(g.dofs) > 1), key=len)
        self.sums = _nested(sums)
        first = 2 * n + len(sums)
        self.terms_at = first
        units: dict[object, tuple[int, int]] = {j: (2 * (j - 1), 2) for j in range(1, n + 1)}
        units |= {dofs: (2 * n + i, 1) for i, dofs in enumerate(sums)}
        units |= {s: (first + layout.slices[s].start, layout.counts[s]) for s in layout.acting}
        place: dict[tuple, int] = {}
        pairs, size = [], 0
        self.take: dict[tuple[int, ...], np.ndarray] = {}
        for group in groups:
            own = [*group.sites, group.dofs[0] if len(group.dofs) == 1 else group.dofs]
            ends = np.cumsum([0, *(units[u][1] for u in own)])
            index = np.zeros((ends[-1], ends[-1]), dtype=np.int64)
            for i, left in enumerate(own):
                for j, right in enumerate(own[: i + 1]):
                    (x, m), (y, k) = units[left], units[right]
                    swap = x < y
                    key = (y, x) if swap else (x, y)
                    if key not in place:
                        place[key] = size
                        pairs.append((x, m, y, k, size) if not swap else (y, k, x, m, size))
                        size += m * k
                    at = place[key] + np.arange(m * k)
                    block = at.reshape(k, m).T if swap else at.reshape(m, k)
                    if i == j:  # only what is on and below the diagonal is multiplied
                        line = np.arange(m)
                        block = np.where(line[:, None] >= line, block, block.T)
                    index[ends[i] : ends[i + 1], ends[j] : ends[j + 1]] = block
                    index[ends[j] : ends[j + 1], ends[i] : ends[i + 1]] = block.T
            self.take[group.dofs] = index
        self.pairs = np.array(pairs, dtype=np.int64).reshape(-1, 5)
        self.size = size
        self.n_rows = first + layout.n_terms
        self._channels = np.r_[2 * np.arange(n), 2 * np.arange(n) + 1]
        self._placed: tuple[Recipe | None, np.ndarray, _Steps, int] | None = None
        self._own = local()  # each thread's scratch

    def multiply(self, block: Block, store: np.ndarray) -> None:
        """Add the products of the columns of a block to ``store``, shape (size,); see ``take`` for its order."""
        recipe, placed = block.recipe, self._placed
        if placed is None or placed[0] is not recipe:
            self._placed = placed = recipe, *self._rows(recipe)
        _, places, steps, n_rows = placed
        scratch = getattr(self._own, "scratch", None)
        if scratch is None or len(scratch) < n_rows:
            self._own.scratch = scratch = _scratch(n_rows)
        source = block.terms if recipe is None else block.source
        given = (np.asarray(x, dtype=np.float64) for x in (block.acceleration, block.force, source))
        kernels()[0](*given, places, *steps, self.sums, self.masses, self.pairs, scratch, store)

    def _rows(self, recipe: Recipe | None) -> tuple[np.ndarray, _Steps, int]:
        """Rows of the channels of a block, how those of the terms are built from them, and how many there are."""
        if recipe is None:
            places = _places(self._channels, np.arange(self.terms_at, self.n_rows))
            nothing = _Steps(np.zeros((0, 4), dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
            return places, nothing, self.n_rows
        size = max(self.n_rows, self.terms_at + int(recipe.steps[:, 0].max(initial=-1)) + 1)
        at = np.full(recipe.n_source, -1)
        steps = []
        for row, p, q in recipe.steps.tolist():
            if q != _COPY:
                steps.append((self.terms_at + row, self.terms_at + p, q))
            elif at[p] < 0:  # a channel that is a term is put where the term stands
                at[p] = self.terms_at + row
            else:
                steps.append((self.terms_at + row, at[p], _COPY))
        beside = np.flatnonzero(at < 0)
        at[beside] = size + np.arange(len(beside))
        moved = np.array(steps, dtype=np.int64).reshape(-1, 3)
        product = moved[:, 2] != _COPY
        moved[product, 2] = at[moved[product, 2]]
        recurrence = recipe.recurrence + np.where(recipe.recurrence < 0, 0, self.terms_at)
        recurrence[:, 1] = at[recipe.recurrence[:, 1]]
        made = _Steps(recurrence, np.ascontiguousarray(recipe.numbers), moved)
        return _places(self._channels, at), made, size + len(beside)


class _Steps(NamedTuple):
    """How rows of the scratch are made from others: see the Recipe; each number is a row of the scratch."""

    recurrence: np.ndarray
    numbers: np.ndarray
    products: np.ndarray


def _places(*rows: np.ndarray) -> np.ndarray:
    """Numbers of rows; without a sign, so that the machine need not ask whether they count from the end."""
    return np.concatenate(rows).astype(np.uint64)


def _nested(sums: Sequence[tuple[int, ...]]) -> np.ndarray:
    """For each sum of balances: (row of the sum, sum it starts from or -1) and the DOFs it adds, -1 behind them."""
    out = []
    for i, dofs in enumerate(sums):
        inside = [k for k in range(i) if set(sums[k]) < set(dofs)]
        parent = inside[-1] if inside else -1
        rest = sorted(set(dofs) - set(sums[parent] if inside else ()))
        out.append([parent, *(j - 1 for j in rest)])
    width = max((len(row) for row in out), default=1)
    return np.array([row + [-1] * (width - len(row)) for row in out], dtype=np.int64).reshape(-1, width)


def _scratch(n_rows: int) -> np.ndarray:
    return np.zeros((max(n_rows, 1), TILE + _PAD))


def orthogonal_gram(rows: np.ndarray, guess: np.ndarray, store: np.ndarray) -> None:
    """Add the Gram matrix of ``guess^-T rows`` to ``store``."""
    rows = np.ascontiguousarray(rows, dtype=np.float64)
    kernels()[1](rows, guess, _scratch(len(rows)), store.ravel())


@cache
def kernels() -> tuple[Callable[..., None], Callable[..., None]]:
    """The compiled passes."""
    from numba import types

    from ..laws.compiled import inline, jit

    fast = {"reassoc", "contract", "nsz"}

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

    def dot32(x, i, j, b, out, at, down, right):
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
        out[at + right] += s01
        out[at + down] += s10
        out[at + down + right] += s11
        out[at + 2 * down] += s20
        out[at + 2 * down + right] += s21

    def dot31(x, i, j, b, out, at, down):
        s0 = s1 = s2 = 0.0
        for t in range(b):
            b0 = x[j, t]
            s0 += x[i, t] * b0
            s1 += x[i + 1, t] * b0
            s2 += x[i + 2, t] * b0
        out[at] += s0
        out[at + down] += s1
        out[at + 2 * down] += s2

    def dot22(x, i, j, b, out, at, step):
        s00 = s01 = s10 = s11 = 0.0
        for t in range(b):
            a0, a1, b0, b1 = x[i, t], x[i + 1, t], x[j, t], x[j + 1, t]
            s00 += a0 * b0
            s01 += a0 * b1
            s10 += a1 * b0
            s11 += a1 * b1
        out[at] += s00
        out[at + 1] += s01
        out[at + step] += s10
        out[at + step + 1] += s11

    def dot11(x, i, j, b, out, at):
        s = 0.0
        for t in range(b):
            s += x[i, t] * x[j, t]
        out[at] += s

    d33, d32, d31, d22, d11 = (inline(f, fastmath=fast) for f in (dot33, dot32, dot31, dot22, dot11))

    def product(x, i, m, j, k, b, out, at):
        """Rows i..i+m times rows j..j+k into out[at:], row-major; only once for a pair of equal rows."""
        same = i == j
        m3, k3 = m - m % 3, k - k % 3
        for p in range(0, m3, 3):
            for q in range(0, p + 3 if same else k3, 3):
                d33(x, i + p, j + q, b, out, at + p * k + q, k)
        left = k - k3  # columns over
        if left and not same:
            for p in range(0, m3, 3):
                if left == 2:
                    d32(x, i + p, j + k3, b, out, at + p * k + k3, k, 1)
                else:
                    d31(x, i + p, j + k3, b, out, at + p * k + k3, k)
        over = m - m3  # rows over
        if over:
            for q in range(0, k3, 3):
                if over == 2:
                    d32(x, j + q, i + m3, b, out, at + m3 * k + q, 1, k)
                else:
                    d31(x, j + q, i + m3, b, out, at + m3 * k + q, 1)
            if over == 2 and left == 2:
                d22(x, i + m3, j + k3, b, out, at + m3 * k + k3, k)
            else:
                for p in range(over):
                    for q in range(left):
                        d11(x, i + m3 + p, j + k3 + q, b, out, at + (m3 + p) * k + k3 + q)

    products = inline(product)

    def copy(out, row):
        for t in range(out.size):
            out[t] = row[t]

    def multiply(out, left, right):
        for t in range(out.size):
            out[t] = left[t] * right[t]

    def ascend(out, x, below, second, g, h, k):
        for t in range(out.size):
            out[t] = (g * x[t] + h) * below[t] + k * second[t]

    def scale(out, x, g, h):
        for t in range(out.size):
            out[t] = g * x[t] + h

    copied, multiplied, ascended, scaled = (inline(f) for f in (copy, multiply, ascend, scale))

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

    def gram_pass(a, force, source, places, recurrence, numbers, steps, sums, masses, pairs, x, store):
        n = a.shape[0]
        for start in range(0, a.shape[1], TILE):
            b = min(TILE, a.shape[1] - start)
            loaded(x, places[:n], a, start, b)
            loaded(x, places[n : 2 * n], force, start, b)
            loaded(x, places[2 * n :], source, start, b)
            for i in range(sums.shape[0]):
                row = 2 * n + i
                if sums[i, 0] >= 0:
                    for t in range(b):
                        x[row, t] = x[2 * n + sums[i, 0], t]
                else:
                    for t in range(b):
                        x[row, t] = 0.0
                for k in range(1, sums.shape[1]):
                    j = sums[i, k]
                    if j >= 0:
                        for t in range(b):
                            x[row, t] += x[2 * j + 1, t] - masses[j] * x[2 * j, t]
            for k in range(recurrence.shape[0]):
                row, v, p, q = recurrence[k, 0], recurrence[k, 1], recurrence[k, 2], recurrence[k, 3]
                g, h, c = numbers[k, 0], numbers[k, 1], numbers[k, 2]
                if p < 0:
                    scaled(x[row, :b], x[v, :b], g, h)
                elif q < 0:
                    ascended(x[row, :b], x[v, :b], x[p, :b], x[p, :b], g, h, 0.0)
                else:
                    ascended(x[row, :b], x[v, :b], x[p, :b], x[q, :b], g, h, c)
            for k in range(steps.shape[0]):
                row, p, q = steps[k, 0], steps[k, 1], steps[k, 2]
                if q < 0:
                    copied(x[row, :b], x[p, :b])
                else:
                    multiplied(x[row, :b], x[p, :b], x[q, :b])
            for k in range(pairs.shape[0]):
                products(x, pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3], b, store, pairs[k, 4])

    def combine(x, i, guess, k, b):
        """Take four earlier rows off row i."""
        g0, g1, g2, g3 = guess[k, i], guess[k + 1, i], guess[k + 2, i], guess[k + 3, i]
        for t in range(b):
            x[i, t] -= (g0 * x[k, t] + g1 * x[k + 1, t]) + (g2 * x[k + 2, t] + g3 * x[k + 3, t])

    take_off = inline(combine, fastmath={"contract"})

    def root_pass(rows, guess, x, store):
        p = rows.shape[0]
        for start in range(0, rows.shape[1], TILE):
            b = min(TILE, rows.shape[1] - start)
            for i in range(p):
                for t in range(b):
                    x[i, t] = rows[i, start + t]
                four = i - i % 4
                for k in range(0, four, 4):
                    take_off(x, i, guess, k, b)
                for k in range(four, i):
                    g = guess[k, i]
                    for t in range(b):
                        x[i, t] -= g * x[k, t]
                g = 1.0 / guess[i, i]
                for t in range(b):
                    x[i, t] *= g
            products(x, 0, p, 0, p, b, store, 0)

    multiply_all = jit(gram_pass)  # one machine code, however the user's arrays lie in memory
    given, whole = types.Array(types.float64, 2, "A", readonly=True), types.Array(types.float64, 2, "C")
    places, table = types.Array(types.uint64, 1, "C"), types.Array(types.int64, 2, "C")
    line = types.Array(types.float64, 1, "C")
    multiply_all.compile((given, given, given, places, table, whole, table, table, line, table, whole, line))
    multiply_all.disable_compile()
    return multiply_all, jit(root_pass)
