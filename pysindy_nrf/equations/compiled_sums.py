"""Compiled: products of the columns of all equations of motion, summed over samples.

Each pair of sites that meet in an equation is multiplied once.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cache
from threading import local
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..chain.layout import Group, Layout, Recipe
from ..chain.recipe import ONES

if TYPE_CHECKING:
    from ..chain.layout import Block

# Samples whose columns stay in the first and second cache.
TILE = 256
# Samples that a row of the scratch has room for: rows are not a power of two apart,
# which would map them onto one cache line.
_ROW = TILE + 8


class _Unit(NamedTuple):
    """Columns that are always multiplied together: a DOF's, a sum's, or a site's."""

    first: int  # row
    width: int  # columns
    size: int  # rows: a multiple of three, the last ones zero


class ProductPlan:
    """Rows of all columns, and which of them are multiplied.

    The rows are ``[a_1, F_1, 0, a_2, ... | sums of equations | terms | helpers]``.

    Attributes
    ----------
    size : int
        Number of products.
    take : dict of tuple of int to ndarray
        By the DOFs of an equation, or of several summed: where the products of its
        columns stand, (n_columns, n_columns).
    """

    def __init__(
        self, layout: Layout, groups: Sequence[Group], masses: Mapping[int, float]
    ) -> None:
        dofs = range(1, layout.n_dof + 1)
        # a sum has all DOFs from one on
        summed = [group.dofs for group in groups if len(group.dofs) > 1]
        summed.sort(key=len)
        widths: dict[Hashable, int] = dict.fromkeys(dofs, 2)
        widths.update(dict.fromkeys(summed, 1))
        for site in layout.acting:
            widths[site] = layout.counts[site]
        units = _placed_units(widths)

        self.masses = np.array([masses.get(dof, 0.0) for dof in dofs])
        self.sums = np.array([group[0] - 1 for group in summed], dtype=np.int64)
        self.terms = np.zeros(0, dtype=int)
        for site in layout.acting:
            rows = units[site].first + np.arange(units[site].width)
            self.terms = np.concatenate([self.terms, rows])
        last = list(units.values())[-1]
        self.n_rows = last.first + last.size

        products = _Products()
        self.take: dict[tuple[int, ...], np.ndarray] = {}
        for group in groups:
            sides = group.dofs[0] if len(group.dofs) == 1 else group.dofs
            columns = [units[site] for site in group.sites]
            self.take[group.dofs] = products.places([*columns, units[sides]])
        self.pairs = np.array(products.pairs, dtype=np.int64).reshape(-1, 5)
        self.size = products.size

        first_rows = 3 * np.arange(layout.n_dof)
        self._channels = np.concatenate([first_rows, first_rows + 1])
        self._steps: tuple[Recipe | None, _Steps] | None = None
        self._scratch = local()

    def __getstate__(self) -> dict[str, object]:
        """The plan without the scratch of its threads."""
        state = dict(self.__dict__)
        del state["_scratch"]
        return state

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._scratch = local()

    def multiply(self, block: Block, store: np.ndarray) -> None:
        """Add the products of the columns of a block to ``store``, shape (size,)."""
        if self._steps is None or self._steps[0] is not block.recipe:
            self._steps = block.recipe, self._steps_of(block.recipe)
        steps = self._steps[1]

        scratch = getattr(self._scratch, "rows", None)
        if scratch is None or len(scratch) < steps.n_rows:
            scratch = np.zeros((steps.n_rows, _ROW))
            self._scratch.rows = scratch

        source = block.terms if block.recipe is None else block.source
        _kernel()(
            np.asarray(block.acceleration, dtype=np.float64),
            np.asarray(block.force, dtype=np.float64),
            np.asarray(source, dtype=np.float64),
            steps.places,
            steps.steps,
            self.sums,
            self.masses,
            self.pairs,
            scratch,
            store,
        )

    def _steps_of(self, recipe: Recipe | None) -> _Steps:
        """Where the channels of a block go, and how the terms are built from them."""
        if recipe is None:
            places = np.concatenate([self._channels, self.terms])
            return _Steps(places, np.zeros((0, 3), dtype=np.int64), self.n_rows)

        n_helpers = max(0, recipe.n_rows - len(self.terms))
        n_rows = self.n_rows + n_helpers
        rows = np.concatenate([self.terms, np.arange(self.n_rows, n_rows)])
        row, x, factor = recipe.steps.T
        copied = factor == ONES

        # a channel that is a term goes where the (last) term stands
        place = np.full(recipe.n_source, -1)
        place[x[copied]] = rows[row[copied]]
        beside = np.flatnonzero(place < 0)
        place[beside] = n_rows + np.arange(len(beside))

        factors = np.where(copied, ONES, rows[factor])
        steps = np.column_stack([rows[row], place[x], factors])
        steps = steps[steps[:, 0] != steps[:, 1]]
        places = np.concatenate([self._channels, place])
        return _Steps(places, steps, n_rows + len(beside))


class _Steps(NamedTuple):
    """Rows of the channels of a block, and the steps that build the terms."""

    places: np.ndarray  # (n_channels,)
    steps: np.ndarray  # (n_steps, 3), as of a recipe, in rows of the scratch
    n_rows: int


def _placed_units(widths: Mapping[Hashable, int]) -> dict[Hashable, _Unit]:
    """Rows of units of so many columns."""
    units = {}
    first = 0
    for name, width in widths.items():
        size = -(-width // 3) * 3
        units[name] = _Unit(first, width, size)
        first += size
    return units


class _Products:
    """Pairs of units that are multiplied, each once, and where their products stand."""

    def __init__(self) -> None:
        # first row and rows of one unit, of the other, and the place of their products
        self.pairs: list[tuple[int, int, int, int, int]] = []
        self.size = 0
        self._place: dict[tuple[int, int], int] = {}

    def places(self, units: Sequence[_Unit]) -> np.ndarray:
        """Where the products of the columns of some units stand."""
        rows = []
        for unit in units:
            rows.append(np.hstack([self._block(unit, other) for other in units]))
        return np.vstack(rows)

    def _block(self, unit: _Unit, other: _Unit) -> np.ndarray:
        """Where the products of two units stand, (unit.width, other.width)."""
        low, high = min(unit, other), max(unit, other)
        n_columns = low.size
        if low != high and low.width == 2:
            # acceleration and force of a DOF need no third column
            n_columns = 2

        key = (high.first, low.first)
        if key not in self._place:
            pair = (high.first, high.size, low.first, n_columns, self.size)
            self.pairs.append(pair)
            self._place[key] = self.size
            self.size += high.size * n_columns

        row = np.arange(high.width)[:, None] * n_columns
        places = self._place[key] + row + np.arange(low.width)
        if low == high:
            # only what is on and below the diagonal is multiplied
            return np.where(np.tri(low.width, dtype=bool), places, places.T)
        return places if high == unit else places.T


@cache
def _kernel() -> Callable[..., None]:
    """The compiled pass: one machine code, however the user's arrays lie in memory.

    All arrays are addressed by their first number: bounds are not checked, and rows of
    the scratch are ``_ROW`` numbers apart.
    """
    from numba import types

    from ..common.compiled import address_of, addresses, inline, jit

    def multiply_3_by_3(x, y, count, out, stride):
        s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = 0.0
        for t in range(count):
            a0 = x[t]
            a1 = x[t + _ROW]
            a2 = x[t + 2 * _ROW]
            b0 = y[t]
            b1 = y[t + _ROW]
            b2 = y[t + 2 * _ROW]
            s00 += a0 * b0
            s01 += a0 * b1
            s02 += a0 * b2
            s10 += a1 * b0
            s11 += a1 * b1
            s12 += a1 * b2
            s20 += a2 * b0
            s21 += a2 * b1
            s22 += a2 * b2
        out[0] += s00
        out[1] += s01
        out[2] += s02
        out[stride] += s10
        out[stride + 1] += s11
        out[stride + 2] += s12
        out[2 * stride] += s20
        out[2 * stride + 1] += s21
        out[2 * stride + 2] += s22

    def multiply_3_by_2(x, y, count, out):
        s00 = s01 = s10 = s11 = s20 = s21 = 0.0
        for t in range(count):
            a0 = x[t]
            a1 = x[t + _ROW]
            a2 = x[t + 2 * _ROW]
            b0 = y[t]
            b1 = y[t + _ROW]
            s00 += a0 * b0
            s01 += a0 * b1
            s10 += a1 * b0
            s11 += a1 * b1
            s20 += a2 * b0
            s21 += a2 * b1
        out[0] += s00
        out[1] += s01
        out[2] += s10
        out[3] += s11
        out[4] += s20
        out[5] += s21

    # sums of products in any order, so that they are taken several at a time
    fast = {"reassoc", "contract", "nsz"}
    by_threes = inline(multiply_3_by_3, fastmath=fast)
    by_twos = inline(multiply_3_by_2, fastmath=fast)

    def load(rows, places, channels, start, count):
        """Copy channels into their rows, in the order in which they lie in memory."""
        if abs(channels.strides[0]) < abs(channels.strides[1]):
            for t in range(count):
                for j in range(channels.shape[0]):
                    rows[places[j] * _ROW + t] = channels[j, start + t]
        else:
            for j in range(channels.shape[0]):
                row = address_of(rows, places[j] * _ROW)
                for t in range(count):
                    row[t] = channels[j, start + t]

    def add_up(rows, sums, n_sums, masses, n_dof, count):
        """F - m a of all DOFs above each cut, from the sum above the one before."""
        top = n_dof
        for i in range(n_sums):
            row = address_of(rows, 3 * (n_dof + i) * _ROW)
            before = address_of(row, -3 * _ROW)
            for t in range(count):
                row[t] = before[t] if i > 0 else 0.0
            for j in range(sums[i], top):
                a = address_of(rows, 3 * j * _ROW)
                force = address_of(a, _ROW)
                for t in range(count):
                    row[t] += force[t] - masses[j] * a[t]
            top = sums[i]

    def build(rows, steps, n_steps, count):
        """Terms by one multiplication each."""
        for k in range(n_steps):
            row = address_of(rows, steps[3 * k] * _ROW)
            channel = address_of(rows, steps[3 * k + 1] * _ROW)
            if steps[3 * k + 2] < 0:
                for t in range(count):
                    row[t] = channel[t]
            else:
                factor = address_of(rows, steps[3 * k + 2] * _ROW)
                for t in range(count):
                    row[t] = factor[t] * channel[t]

    def multiply(rows, pairs, n_pairs, store, count):
        """Rows i..i+m times rows j..j+c, row-major; equal rows up to the diagonal."""
        for k in range(n_pairs):
            pair = address_of(pairs, 5 * k)
            i = pair[0]
            m = pair[1]
            j = pair[2]
            c = pair[3]
            out = address_of(store, pair[4])
            for p in range(0, m, 3):
                x = address_of(rows, (i + p) * _ROW)
                if c == 2:
                    y = address_of(rows, j * _ROW)
                    by_twos(x, y, count, address_of(out, 2 * p))
                else:
                    for q in range(0, p + 3 if i == j else c, 3):
                        y = address_of(rows, (j + q) * _ROW)
                        by_threes(x, y, count, address_of(out, p * c + q), c)

    loaded = inline(load)
    added_up = inline(add_up)
    built = inline(build)
    multiplied = inline(multiply)

    def gram_pass(a, force, source, places, steps, sums, masses, pairs, scratch, store):
        n_dof = a.shape[0]
        n_samples = a.shape[1]
        n_sums = sums.size
        n_steps = steps.shape[0]
        n_pairs = pairs.shape[0]
        rows, store, steps, pairs, sums, masses, of_a = addresses(
            (scratch, store, steps, pairs, sums, masses, places)
        )
        of_force = address_of(of_a, n_dof)
        of_source = address_of(of_a, 2 * n_dof)

        for start in range(0, n_samples, TILE):
            count = min(TILE, n_samples - start)
            loaded(rows, of_a, a, start, count)
            loaded(rows, of_force, force, start, count)
            loaded(rows, of_source, source, start, count)
            added_up(rows, sums, n_sums, masses, n_dof, count)
            built(rows, steps, n_steps, count)
            multiplied(rows, pairs, n_pairs, store, count)

    compiled = jit(gram_pass)
    channels = types.Array(types.float64, 2, "A", readonly=True)
    numbers = types.Array(types.int64, 1, "C")
    table = types.Array(types.int64, 2, "C")
    line = types.Array(types.float64, 1, "C")
    matrix = types.Array(types.float64, 2, "C")
    compiled.compile(
        (
            channels,
            channels,
            channels,
            numbers,
            table,
            numbers,
            line,
            table,
            matrix,
            line,
        )
    )
    compiled.disable_compile()
    return compiled
