"""The pass over the samples: every product, whatever the tiles, sums and gaps; and roots that lose nothing."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from pysindy_nrf import Chain, laws
from pysindy_nrf.regression.blocks import Block, block_size, blocks_of
from pysindy_nrf.regression.gram import orthogonal_gram
from pysindy_nrf.regression.gram_pass import GramPass, guess_of, total_gram
from pysindy_nrf.regression.grams import BlockGrams
from pysindy_nrf.regression.input_arrays import from_arrays
from pysindy_nrf.regression.layout import LawLayout, Layout

MASSES = {1: 2.0, 2: 3.0, 3: 5.0, 4: 7.0}


def whole_numbers(n, terms, dofs, seed=0):
    """Columns of whole numbers: every product and sum of them is exact in a double."""
    rng = np.random.default_rng(seed)
    return [rng.integers(-9, 10, (n, k)).astype(float) for k in (terms, dofs, dofs)]


def columns_of(layout, group, data, masses=MASSES):
    """The columns of a group written out: terms of its sites, then a_j and F_j, or the sum of F_j - m_j a_j."""
    terms, a, F = data
    own = [terms[:, layout.slices[s]] for s in group.sites]
    j = [d - 1 for d in group.dofs]
    if len(j) == 1:
        return np.hstack([*own, a[:, j], F[:, j]])
    return np.hstack([*own, sum(F[:, i] - masses[i + 1] * a[:, i] for i in j)[:, None]])


def assert_gram(total, data, masses=MASSES):
    for group in total.groups.values():
        A = columns_of(total.layout, group, data, masses)
        assert np.array_equal(total.matrices[group.dofs], A.T @ A), group.dofs
        assert total.sizes[group.dofs] == len(A)


# -- products of columns --------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 255, 256, 257, 600])
def test_every_product_of_a_balance_is_exact(size):
    """Tiles of three by three and whatever is left over: 0, 1 or 2 rows by 0, 1 or 2 columns, in all nine ways."""
    counts = [(3, 6, 4), (7, 4, 5), (5, 8, 6), (5, 4, 3), (6, 5, 0), (0, 1, 2)]
    for first, second, third in counts if size == 257 else counts[1:2]:
        layout = Layout(Chain(3), {"storey 1": first, "storey 2": second, "storey 3": third})
        data = whole_numbers(size, layout.n_terms, 3)
        groups = [layout.group((j,)) for j in (1, 2, 3)]
        assert_gram(total_gram(layout, groups, blocks_of(*data)), data)


@pytest.mark.parametrize("orders", [((1,), (2,), (3,), (4,)), ((3,), (1,)), ((4, 3), (1, 2, 3, 4), (3, 4, 2))], ids=str)
def test_sums_of_balances_are_exact(orders):
    """Sums that hold each other, sums that do not, in any order; a link within a sum cancels."""
    layout = Layout(Chain(4, ["link 4-2"]), {f"storey {i}": i for i in (1, 2, 3, 4)} | {"link 4-2": 2, "dof 3": 1})
    data = whole_numbers(300, layout.n_terms, 4)
    total = total_gram(layout, [layout.group(d) for d in orders], blocks_of(*data), MASSES)
    assert list(total.matrices) == list(orders)
    assert_gram(total, data)


@pytest.mark.parametrize(
    "pair", list(itertools.combinations([(1, 2), (2, 3), (3, 4), (2, 3, 4), (1, 2, 3, 4)], 2)), ids=str
)
def test_two_sums_share_only_what_one_holds_of_the_other(pair):
    layout = Layout(Chain(4), {"storey 1": 1, "storey 4": 1})
    data = whole_numbers(40, 2, 4)
    for dofs in (pair, pair[::-1]):
        groups = [layout.group(d) for d in dofs]
        assert_gram(total_gram(layout, groups, blocks_of(*data), MASSES), data)


def test_a_mass_that_is_not_given_takes_no_part_in_a_sum():
    """Balances of one DOF need none; in a sum the inertia of a floor is its known mass times its acceleration."""
    layout = Layout(Chain(2), {"storey 1": 1})
    data = whole_numbers(20, 1, 2)
    total = total_gram(layout, [layout.group((1, 2))], blocks_of(*data), {2: 3.0})
    assert_gram(total, data, {1: 0.0, 2: 3.0})


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_powers_are_built_from_rates_and_drifts_in_the_pass(degree):
    """v^h s^j by one multiplication each, helpers that no law holds included, across tiles of samples."""
    held = {
        "storey 1": [laws.PowerSeries(degree)],
        "storey 2": [laws.CubicStiffness(), laws.LinearViscous()],
        "storey 3": [laws.CoulombFriction(), laws.LinearElastic()],
    }
    layout = LawLayout(Chain(3), held)
    v, s, a, F = np.random.default_rng(degree).integers(-2, 3, (4, 600, 3)).astype(float)
    groups = [layout.group((j,)) for j in (1, 2, 3)]
    blocks = from_arrays(np.hstack([a, v, s]), F, dt=1e-3).segments[0].blocks(layout, 290, states={})
    total = total_gram(layout, groups, blocks)
    columns = {
        "storey 1": [v[:, 0] ** h * s[:, 0] ** (d - h) for d in range(1, degree + 1) for h in range(d, -1, -1)],
        "storey 2": [s[:, 1] ** 3, v[:, 1]],
        "storey 3": [np.sign(v[:, 2]), s[:, 2]],
    }
    terms = np.zeros((600, layout.n_terms))
    for site in layout.sites:
        terms[:, layout.slices[site]] = np.column_stack(columns[site])
    assert_gram(total, (terms, a, F))


def test_columns_of_a_block_are_built_once_from_their_recipe():
    layout = LawLayout(Chain(1), {"storey 1": [laws.PowerSeries(2)]})
    v, s, a = np.random.default_rng(0).normal(size=(3, 50, 1))
    (block,) = from_arrays(np.hstack([a, v, s]), a, dt=1e-3).segments[0].blocks(layout)
    made = block.terms
    assert np.allclose(made, np.hstack([v, s, v * v, v * s, s * s]).T) and block.terms is made
    given = Block(made, a.T, a.T)
    assert given.terms is made


# -- samples, gaps and pieces ---------------------------------------------------------------------

LAYOUT = Layout(Chain(3, ["link 3-1"]), {"storey 1": 2, "storey 2": 3, "storey 3": 1, "link 3-1": 2})
GROUPS = [LAYOUT.group(dofs) for dofs in ((1,), (2,), (3,), (2, 3))]


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_records_whose_unknown_forces_differ_come_one_after_the_other(kind):
    """A balance takes the samples in which it knows every force; all are counted, and each only once."""
    records = [whole_numbers(n, 8, 3, seed) for seed, n in enumerate((40, 70, 30, 25))]
    lost = [(), (2,), (2,), (1, 3)]
    for record, dofs in zip(records, lost):
        record[2][:, [j - 1 for j in dofs]] = np.nan
    blocks = (block for record in records for block in blocks_of(*record, 16))
    total = total_gram(LAYOUT, GROUPS, blocks, MASSES, kind)
    assert total.n_samples == 165
    for group in GROUPS:
        known = [r for r, dofs in zip(records, lost) if not set(dofs) & set(group.dofs)]
        A = np.vstack([columns_of(LAYOUT, group, r) for r in known])
        assert np.allclose(total.squares().matrices[group.dofs], A.T @ A, rtol=1e-12, atol=1e-9)
        assert total.sizes[group.dofs] == len(A)


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_looking_at_sums_on_the_way_changes_nothing(kind):
    data = whole_numbers(120, 8, 3)
    quiet, watched = (GramPass(LAYOUT, GROUPS, MASSES, kind) for _ in range(2))
    for block in blocks_of(*data, 50):
        quiet.add(block)
        assert watched.add(block).total().sizes[1,] == watched.n_samples
    assert quiet.n_samples == watched.n_samples == 120
    for dofs, gram in quiet.total().squares().matrices.items():
        assert np.allclose(gram, watched.total().squares().matrices[dofs], rtol=1e-13, atol=1e-11)


def test_samples_are_cut_into_blocks_none_left_out():
    terms, a, F = whole_numbers(5000, 2, 1)
    blocks = list(blocks_of(terms, a, F, 1999))
    assert [b.terms.shape for b in blocks] == [(2, 1999), (2, 1999), (2, 1002)]
    assert (
        [b.acceleration.shape for b in blocks] == [b.force.shape for b in blocks] == [(1, 1999), (1, 1999), (1, 1002)]
    )
    for k, whole in enumerate((terms, a, F)):
        pieces = [(b.terms, b.acceleration, b.force)[k].T for b in blocks]
        assert np.array_equal(np.vstack(pieces), whole)
    assert {b.terms.shape[1] for b in blocks_of(terms, a, F)} == {2048, 5000 - 2 * 2048}


@pytest.mark.parametrize("dofs, size", [(1, 4096), (8, 4096), (10, 3072), (16, 2048), (50, 512), (1000, 512)])
def test_a_block_of_many_channels_is_shorter(dofs, size):
    """2^17 numbers for four channels of each DOF, in steps of 256, between 512 and 4096 samples."""
    assert block_size(Layout(Chain(dofs), {})) == size


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_an_empty_pass_takes_the_same_columns_and_starts_at_nothing(kind):
    data = whole_numbers(200, 8, 3)
    guess = {g.dofs: np.linalg.qr(columns_of(LAYOUT, g, data), mode="r") for g in GROUPS} if kind == "root" else None
    first = GramPass(LAYOUT, GROUPS, MASSES, kind, guess).add_each((0, b) for b in blocks_of(*data))
    nothing = first.empty().total()
    assert nothing.n_samples == 0 and nothing.kind == kind and not any(m.any() for m in nothing.matrices.values())
    total = first.total().merge(first.empty().add_each((0, b) for b in blocks_of(*data)).total())
    A = columns_of(LAYOUT, GROUPS[3], data)
    assert np.allclose(total.squares().matrices[2, 3], 2 * A.T @ A, rtol=1e-12, atol=1e-9)
    assert total.n_samples == total.sizes[2, 3] == 400


def test_balances_are_cut_out_of_one_gram_matrix_by_the_samples_each_knows():
    """A force unknown in some samples: the balances that need it come from the others."""
    data = whole_numbers(80, 8, 3)
    known = {(1,): slice(0, 80), (2,): slice(0, 50), (3,): slice(0, 80), (2, 3): slice(0, 50)}
    full = np.hstack(data)
    cut = BlockGrams.from_shared(
        LAYOUT, GROUPS, lambda dofs: (full[known[dofs]].T @ full[known[dofs]], len(full[known[dofs]])), MASSES
    )
    assert cut.n_samples == 80 and list(cut.groups) == list(known)
    for group in GROUPS:
        A = columns_of(LAYOUT, group, [x[known[group.dofs]] for x in data])
        assert np.array_equal(cut.matrices[group.dofs], A.T @ A)
        assert cut.sizes[group.dofs] == len(A)


def test_the_place_of_every_column_is_known():
    total = total_gram(LAYOUT, GROUPS, [], MASSES)
    where, mass, target = total.positions((1,))
    assert where == {"storey 1": slice(0, 2), "storey 2": slice(2, 5), "link 3-1": slice(5, 7)}
    assert (mass, target) == (7, 8)
    where, mass, target = total.positions((2, 3))  # storey 3 is within the sum
    assert where == {"storey 2": slice(0, 3), "link 3-1": slice(3, 5)} and (mass, target) == (None, 5)


# -- roots ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("p", range(1, 11))
def test_rows_made_orthogonal_by_a_guess_have_the_gram_matrix_of_theory(p):
    """guess^-T rows, in groups of four rows and what is left, over one tile of samples and a part of the next."""
    rng = np.random.default_rng(p)
    rows, guess = rng.normal(size=(p, 300)), np.triu(rng.uniform(0.5, 2.0, (p, p)))
    store = np.zeros((p, p))
    for piece in (rows[:, :299], rows[:, 299:]):
        orthogonal_gram(np.ascontiguousarray(piece), guess, store)
    near = np.linalg.solve(guess.T, rows)
    assert np.allclose(np.tril(store), np.tril(near @ near.T), rtol=1e-11, atol=1e-10 * np.abs(near @ near.T).max())


def one_mass(columns):
    """The balance of one DOF whose columns [terms | a | F] are given, one row for each sample."""
    columns = np.asarray(columns, dtype=float)
    layout = Layout(Chain(1), {"storey 1": columns.shape[1] - 2})
    return layout, [layout.group((1,))], list(blocks_of(columns[:, :-2], columns[:, -2:-1], columns[:, -1:], 100))


def total_of(columns, kind="gram", guess=None):
    layout, groups, blocks = one_mass(columns)
    return total_gram(layout, groups, blocks, kind=kind, guess=None if guess is None else {(1,): guess})


def test_a_root_through_guesses_is_that_of_all_samples():
    """Another guess on the way, samples without one, and sums that are added: one factor of all."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(900, 4)) @ rng.normal(size=(4, 4))
    layout, groups, blocks = one_mass(columns)
    good, poor = np.linalg.qr(columns[:100], mode="r"), np.triu(rng.uniform(1, 2, (4, 4)))
    sums = GramPass(layout, groups, kind="root")
    for i, block in enumerate(blocks[:8]):
        sums.guess = {(1,): good} if i < 3 else {(1,): poor} if i < 5 else {}
        sums.add(block)
    total = sums.total().merge(total_of(columns[800:], "root", good))
    assert total.n_samples == 900
    assert np.allclose(total.squares().matrices[1,], columns.T @ columns, rtol=1e-12, atol=1e-10)
    assert np.array_equal(total.matrices[1,], np.triu(total.matrices[1,]))


def test_a_guess_can_be_divided_by_even_where_columns_depend_or_are_zero():
    """A zero column and one that is twice another: the root through the guess is that of the columns."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 500))
    rows = np.column_stack([1e6 * x, np.zeros(500), y, 2e6 * x, x + 1e-3 * y])
    guess = guess_of(total_of(rows))[1,]
    size = np.linalg.norm(rows, axis=0)
    assert np.array_equal(guess, np.triu(guess)) and np.isfinite(np.linalg.inv(guess)).all()
    assert guess[1, 1] > 0 and not guess[1, 2:].any()
    assert 0 < guess[3, 3] < 1e-6 * size[3] and guess[3, 4] == 0 and guess[4, 4] < 1e-6 * size[4]
    assert guess[0, 0] == pytest.approx(size[0]) and guess[0, 3] == pytest.approx(size[3])
    found = total_of(rows, "root", guess).squares().matrices[1,]
    safe = np.where(size > 0, size, 1.0)
    assert np.allclose(found / np.outer(safe, safe), rows.T @ rows / np.outer(safe, safe), atol=1e-12)


def test_lengths_of_combinations_are_those_of_the_samples():
    rows = np.array([[3.0, 4.0], [0.0, 1.0]])
    for kind in ("gram", "root"):
        total = total_of(rows, kind)
        assert total.norms((1,), np.array([[1.0, 1.0, 0.0], [-1.0, 0.0, 2.0]])) == pytest.approx(
            [np.sqrt(2), 3.0, 2 * np.sqrt(17)]
        )
    near = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-15]])  # round-off below zero is no length
    assert replace(total_of(rows), matrices={(1,): near}).norms((1,), np.array([[1.0], [-1.0]])) == 0.0


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_more_combinations_than_columns_have_a_factor_with_rows_of_zeros(kind):
    """Three combinations of two columns: upper triangular, of rank two, and its Gram matrix is theirs."""
    columns = np.array([[1.0, 0.0], [2.0, 3.0], [2.0, 4.0]])
    combine = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, -1.0]])
    R, A = total_of(columns, kind).triangle((1,), combine), columns @ combine
    assert R.shape == (3, 3) and np.array_equal(R, np.triu(R))
    assert np.allclose(R.T @ R, A.T @ A, atol=1e-12) and abs(R[2, 2]) < 1e-7


def test_dependent_columns_leave_zeros_and_the_others_their_digits():
    """Columns x, 0, 2 x, y, x + y of units far apart: pivots of x and y are exact, the rest is zero."""
    x, y = np.array([3.0, 4.0, 0.0]), np.array([1.0, 0.0, 2.0])
    R = total_of(np.column_stack([1e8 * x, 0 * x, 2e-3 * x, 1e-7 * y, x + y])).triangle((1,), np.eye(5))
    across = np.sqrt(5.0 - 0.6**2)  # y has 0.6 along x
    assert R[0] == pytest.approx([5e8, 0.0, 1e-2, 0.6e-7, 5.6], rel=1e-12)
    assert R[3, 3:] == pytest.approx([across * 1e-7, across], rel=1e-12)
    assert not R[1:3].any() and not R[4].any()


def test_a_column_of_zeros_among_many_takes_no_pivot_of_the_others():
    """A term that never moves beside thirty of units far apart: their factor is that of their own QR."""
    A = np.random.default_rng(0).normal(size=(200, 30)) * np.logspace(-6, 6, 30)
    R = total_of(np.insert(A, 2, 0.0, axis=1)).triangle((1,), np.eye(31))
    keep = np.delete(np.arange(31), 2)
    truth = np.linalg.qr(A, mode="r")
    assert not R[2].any() and not R[:, 2].any()
    error = R[np.ix_(keep, keep)] - np.sign(np.diag(truth))[:, None] * truth
    assert np.allclose(error / np.linalg.norm(A, axis=0), 0, atol=1e-13)


@pytest.mark.parametrize("kind", [np.float64, np.float32], ids=["double", "single"])
def test_products_are_the_same_however_the_arrays_lie_in_memory(kind):
    """Samples side by side, channels side by side, each array by itself or every second row; nothing is written."""
    layout = LawLayout(Chain(3), {j: [laws.PowerSeries(3)] for j in (1, 2, 3)})
    groups = [layout.group((j,)) for j in (1, 2, 3)]
    X, F = (np.random.default_rng(k).integers(-2, 3, (700, k)).astype(kind) for k in (9, 3))
    a, v, s = X[:, :3], X[:, 3:6], X[:, 6:]
    columns = [v[:, [j]] ** h * s[:, [j]] ** (d - h) for j in range(3) for d in (1, 2, 3) for h in range(d, -1, -1)]
    truth = (np.hstack(columns).astype(float), a, F)
    wide = np.repeat(X, 2, axis=0)
    for x, force in ((X, F), (np.asfortranarray(X), np.asfortranarray(F)), (wide[::2], np.hstack([F, F])[:, :3])):
        x.flags.writeable = force.flags.writeable = False
        (segment,) = from_arrays(x, force, dt=1e-3).segments
        assert_gram(total_gram(layout, groups, segment.blocks(layout)), truth)
