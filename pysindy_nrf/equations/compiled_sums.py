"""Compiled: the pass over samples, each pair of sites that meets multiplied once; the
solve of many Gram matrices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from threading import local
from typing import TYPE_CHECKING, Any

import numpy as np

from ..chain.layout import Group, Layout, Recipe

if TYPE_CHECKING:
    from ..chain.layout import Block

TILE = 256  # samples whose columns stay in the first and second cache
_ROW = (
    TILE + 8
    # rows of the scratch are not a power of two apart, which would map them onto one
    # cache line
)


class Plan:
    """Rows ``[a_1, F_1, 0, a_2, ... | sums of balances | terms | helpers]``: how they
    are built and multiplied.
    """

    def __init__(
        self, layout: Layout, groups: Sequence[Group], masses: Mapping[int, float]
    ) -> None:
        n = layout.n_dof
        self.masses = np.array([masses.get(j, 0.0) for j in range(1, n + 1)])
        sums = sorted(
            (g.dofs for g in groups if len(g.dofs) > 1), key=len
        )  # of all DOFs from one on
        self.sums = np.array([dofs[0] - 1 for dofs in sums], dtype=np.int64)
        # rows of DOFs, sums and sites; each begins at a multiple of three, with rows of
        # zeros behind it
        counts: dict[object, int] = {j: 2 for j in range(1, n + 1)}
        counts |= {dofs: 1 for dofs in sums} | {
            s: layout.counts[s] for s in layout.acting
        }
        ends = np.cumsum([0, *(-(-k // 3) * 3 for k in counts.values())]).tolist()
        units = {unit: (at, end - at) for unit, at, end in zip(counts, ends, ends[1:])}
        self.terms = np.array(
            [units[s][0] + k for s in layout.acting for k in range(layout.counts[s])],
            dtype=int,
        )
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
                    block = (
                        place[x, y]
                        + np.arange(m)[: counts[high], None] * k
                        + np.arange(counts[low])
                    )
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
        """Add the products of the columns of a block to ``store``, shape (size,); see
        ``take`` for its order.
        """
        recipe, placed = block.recipe, self._placed
        if placed is None or placed[0] is not recipe:
            self._placed = placed = recipe, *self._rows(recipe)
        _, places, steps, n_rows = placed
        scratch = getattr(self._own, "scratch", None)
        if scratch is None or len(scratch) < n_rows:
            self._own.scratch = scratch = np.zeros((n_rows, _ROW))
        source = block.terms if recipe is None else block.source
        given = (
            np.asarray(x, dtype=np.float64)
            for x in (block.acceleration, block.force, source)
        )
        _kernel()(
            *given, places, steps, self.sums, self.masses, self.pairs, scratch, store
        )

    def _rows(self, recipe: Recipe | None) -> tuple[np.ndarray, np.ndarray, int]:
        """Rows of the channels of a block, how those of the terms are built from them,
        and how many there are.
        """
        if recipe is None:
            return (
                np.concatenate([self._channels, self.terms]),
                np.zeros((0, 3), dtype=np.int64),
                self.n_rows,
            )
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
        return (
            np.concatenate([self._channels, at]),
            steps[steps[:, 0] != steps[:, 1]],
            size + len(beside),
        )


@cache
def _kernel() -> Callable[..., None]:
    """The compiled pass."""
    from numba import types

    from ..common.compiled import address_of, addresses, inline, jit

    def dot33(x, y, b, out, step):
        s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = 0.0
        for t in range(b):
            a0, a1, a2 = x[t], x[t + _ROW], x[t + 2 * _ROW]
            b0, b1, b2 = y[t], y[t + _ROW], y[t + 2 * _ROW]
            s00 += a0 * b0
            s01 += a0 * b1
            s02 += a0 * b2
            s10 += a1 * b0
            s11 += a1 * b1
            s12 += a1 * b2
            s20 += a2 * b0
            s21 += a2 * b1
            s22 += a2 * b2
        out[0], out[1], out[2] = out[0] + s00, out[1] + s01, out[2] + s02
        out[step], out[step + 1], out[step + 2] = (
            out[step] + s10,
            out[step + 1] + s11,
            out[step + 2] + s12,
        )
        step *= 2
        out[step], out[step + 1], out[step + 2] = (
            out[step] + s20,
            out[step + 1] + s21,
            out[step + 2] + s22,
        )

    def dot32(x, y, b, out):
        s00 = s01 = s10 = s11 = s20 = s21 = 0.0
        for t in range(b):
            a0, a1, a2, b0, b1 = x[t], x[t + _ROW], x[t + 2 * _ROW], y[t], y[t + _ROW]
            s00 += a0 * b0
            s01 += a0 * b1
            s10 += a1 * b0
            s11 += a1 * b1
            s20 += a2 * b0
            s21 += a2 * b1
        out[0], out[1], out[2] = out[0] + s00, out[1] + s01, out[2] + s10
        out[3], out[4], out[5] = out[3] + s11, out[4] + s20, out[5] + s21

    fast = {"reassoc", "contract", "nsz"}
    threes, twos = inline(dot33, fastmath=fast), inline(dot32, fastmath=fast)

    def load(x, places, channels, start, b):
        if abs(channels.strides[0]) < abs(
            channels.strides[1]
        ):  # the channels of a sample lie side by side
            for t in range(b):
                for j in range(channels.shape[0]):
                    x[places[j] * _ROW + t] = channels[j, start + t]
        else:
            for j in range(channels.shape[0]):
                row = address_of(x, places[j] * _ROW)
                for t in range(b):
                    row[t] = channels[j, start + t]

    loaded = inline(load)

    def gram_pass(a, force, source, places, steps, sums, masses, pairs, x, store):
        n, size, n_sums, n_steps, n_pairs = (
            a.shape[0],
            a.shape[1],
            sums.size,
            steps.shape[0],
            pairs.shape[0],
        )
        x, store, steps, pairs, sums, masses, of_a = addresses(
            (x, store, steps, pairs, sums, masses, places)
        )
        of_force, of_source = address_of(of_a, n), address_of(of_a, 2 * n)
        for start in range(0, size, TILE):
            b = min(TILE, size - start)
            loaded(x, of_a, a, start, b)
            loaded(x, of_force, force, start, b)
            loaded(x, of_source, source, start, b)
            end = n
            for i in range(n_sums):
                row = address_of(x, 3 * (n + i) * _ROW)
                before = address_of(row, -3 * _ROW)
                for t in range(b):
                    row[t] = before[t] if i > 0 else 0.0
                for j in range(sums[i], end):
                    given = address_of(x, 3 * j * _ROW)
                    for t in range(b):
                        row[t] += given[t + _ROW] - masses[j] * given[t]
                end = sums[i]
            for k in range(n_steps):
                row, of = (
                    address_of(x, steps[3 * k] * _ROW),
                    address_of(x, steps[3 * k + 1] * _ROW),
                )
                if steps[3 * k + 2] < 0:
                    for t in range(b):
                        row[t] = of[t]
                else:
                    by = address_of(x, steps[3 * k + 2] * _ROW)
                    for t in range(b):
                        row[t] = by[t] * of[t]
            for k in range(
                n_pairs
                # rows i..i+m times rows j..j+c, row-major; only once for a pair of
                # equal rows
            ):
                pair = address_of(pairs, 5 * k)
                i, m, j, c, out = (
                    pair[0],
                    pair[1],
                    pair[2],
                    pair[3],
                    address_of(store, pair[4]),
                )
                for p in range(0, m, 3):
                    left = address_of(x, (i + p) * _ROW)
                    if c == 2:
                        twos(left, address_of(x, j * _ROW), b, address_of(out, 2 * p))
                    else:
                        for q in range(0, p + 3 if i == j else c, 3):
                            threes(
                                left,
                                address_of(x, (j + q) * _ROW),
                                b,
                                address_of(out, p * c + q),
                                c,
                            )

    multiply_all = jit(
        gram_pass
    )  # one machine code, however the user's arrays lie in memory
    given, whole = (
        types.Array(types.float64, 2, "A", readonly=True),
        types.Array(types.float64, 2, "C"),
    )
    kinds = (types.int64, 2), (types.int64, 1), (types.float64, 1)
    table, starts, line = (types.Array(kind, n, "C") for kind, n in kinds)
    multiply_all.compile(
        (given, given, given, starts, table, starts, line, table, whole, line)
    )
    multiply_all.disable_compile()
    return multiply_all


OWN, KNOWN, MASS = range(3)  # roles of a column in a step of the solve order


@cache
def compiled_solve() -> Callable[..., None]:
    """Masses (known ones preset) and coefficients by fit; dependent columns: NaN if
    strict, else zero for one.
    """
    from ..common.compiled import address_of, addresses, jit, part

    def least_squares(gram, p, columns, width, target, values, work, strict):
        """Solve for columns scaled to unit length; False where they depend on each
        other.
        """
        scale = address_of(work, p * p)
        for i in range(width):
            size = gram[columns[i] * (p + 1)]
            if not (size < np.inf and (size > 0.0 or not strict)):
                return False
            scale[i] = 1.0 / math.sqrt(size) if size > 0.0 else 0.0
        for i in range(width):
            row, products = address_of(work, i * p), address_of(gram, columns[i] * p)
            dot = 0.0
            for j in range(p):
                if target[j] != 0.0:
                    dot += products[j] * target[j]
            values[i] = dot * scale[i]
            for j in range(i + 1):
                above = address_of(work, j * p)
                part = products[columns[j]] * scale[i] * scale[j]
                for k in range(j):
                    part -= row[k] * above[k]
                if i != j:
                    row[j] = part / above[j]
                elif part > 9e-16 * (width + 1):
                    row[i] = math.sqrt(part)
                elif not strict:
                    row[i] = np.inf  # its coefficient becomes zero
                else:
                    return False
            for k in range(i):
                values[i] -= row[k] * values[k]
            values[i] /= row[i]
        for i in range(width - 1, -1, -1):
            for k in range(i + 1, width):
                values[i] -= work[k * p + i] * values[k]
            values[i] /= work[i * p + i]
        for i in range(width):
            values[i] *= scale[i]
        return True

    solved = part(least_squares)

    def chain(
        fit, strict, n, at, steps, entries, dofs, masses, theta, scratch, columns
    ):
        n_fits, n_groups, p, n_steps = (
            fit.shape[0],
            fit.shape[1],
            fit.shape[2],
            steps.shape[0],
        )
        fit, steps, entries, dofs, masses, theta, target, columns = addresses(
            (fit, steps, entries, dofs, masses, theta, scratch, columns)
        )
        values, work = address_of(target, p), address_of(target, 2 * p)
        for b in range(n_fits):
            own, weights = address_of(theta, b * p), address_of(masses, b * n)
            for i in range(n_steps):
                step = address_of(
                    steps,
                    6 * i,
                    # group, entries from and to, DOFs from and to, whether masses are
                    # free
                )
                for k in range(p):
                    target[k] = 0.0
                for d in range(step[3], step[4]):
                    target[at + n + dofs[d]] += 1.0
                    if not step[5]:
                        target[at + dofs[d]] -= weights[dofs[d]]
                width = np.int64(0)
                for e in range(step[1], step[2]):
                    entry = address_of(entries, 4 * e)  # column, sign, role, DOF
                    if entry[2] == KNOWN:
                        target[entry[0]] -= entry[1] * own[entry[0]]
                    else:
                        columns[width] = entry[0]
                        width += 1
                gram = address_of(fit, (b * n_groups + step[0]) * p * p)
                if not solved(gram, p, columns, width, target, values, work, strict):
                    for k in range(p):
                        own[k] = np.nan
                    break
                width = np.int64(0)
                for e in range(step[1], step[2]):
                    entry = address_of(entries, 4 * e)
                    if entry[2] == OWN:
                        own[entry[0]] = entry[1] * values[width]
                    elif entry[2] == MASS:
                        weights[entry[3]] = values[width]
                    if entry[2] != KNOWN:
                        width += 1

    compiled = jit(chain)

    def solve(fit: np.ndarray, *given: Any) -> None:
        p = fit.shape[2]
        compiled(fit, *given, np.empty(p * (p + 3)), np.empty(p, dtype=np.int64))

    return solve
