"""Gram matrices of blocks of samples: all that least squares needs; they add, are weighted, left out and stored."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import Chain, laws
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.regression.blocks import blocks_of, cut_at
from pysindy_nrf.regression.gram_pass import GramPass, block_grams, guess_of, total_gram
from pysindy_nrf.regression.grams import BlockGrams
from pysindy_nrf.regression.input_arrays import from_arrays
from pysindy_nrf.regression.layout import LawLayout, Layout

LAYOUT = Layout(Chain(3, ["link 3-1"]), {"storey 1": 2, "storey 2": 3, "storey 3": 1, "link 3-1": 2})
GROUPS = [LAYOUT.group((j,)) for j in (1, 2, 3)] + [LAYOUT.group((2, 3))]
MASSES = {2: 3.0, 3: 5.0}


def _data(size=500, seed=0):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-5, 5, LAYOUT.n_terms)
    return rng.normal(size=(size, LAYOUT.n_terms)) * scale, rng.normal(size=(size, 3)), rng.normal(size=(size, 3))


def _total(data, kind="gram", size=64):
    return total_gram(LAYOUT, GROUPS, blocks_of(*data, size), MASSES, kind)


def _columns(data, dofs):
    """The columns of a group written out by hand."""
    terms, a, F = data
    sites = {"storey 1": slice(0, 2), "storey 2": slice(2, 5), "storey 3": slice(5, 6), "link 3-1": slice(6, 8)}
    of = {
        (1,): ["storey 1", "storey 2", "link 3-1"], (2,): ["storey 2", "storey 3"], (3,): ["storey 3", "link 3-1"],
        (2, 3): ["storey 2", "link 3-1"],
    }[dofs]  # fmt: skip
    parts = [terms[:, sites[s]] for s in of]
    if len(dofs) == 1:
        return np.column_stack([*parts, a[:, dofs[0] - 1], F[:, dofs[0] - 1]])
    target = sum(F[:, j - 1] - MASSES[j] * a[:, j - 1] for j in dofs)
    return np.column_stack([*parts, target])


@pytest.mark.parametrize("kind", ["gram", "root"])
@pytest.mark.parametrize("dofs", [(1,), (2,), (3,), (2, 3)], ids=str)
def test_gram_matrices_are_those_of_the_columns(kind, dofs):
    data = _data()
    total = _total(data, kind)
    columns = _columns(data, dofs)
    gram = total.squares().matrices[dofs]
    size = np.linalg.norm(columns, axis=0)
    assert np.allclose(gram / np.outer(size, size), columns.T @ columns / np.outer(size, size), atol=1e-12)
    assert total.sizes[dofs] == len(columns)
    combine = np.random.default_rng(1).normal(size=(columns.shape[1], 4)) / size[:, None]
    triangle = total.triangle(dofs, combine)
    assert np.allclose(triangle, np.triu(triangle))
    assert np.allclose(np.abs(triangle), np.abs(np.linalg.qr(columns @ combine, mode="r")), atol=1e-9)
    assert total.norms(dofs, combine) == pytest.approx(np.linalg.norm(columns @ combine, axis=0), rel=1e-10)


@pytest.mark.parametrize("kind", ["gram", "root"])
@given(cuts=st.lists(st.integers(1, 499), max_size=3, unique=True), size=st.integers(1, 700))
def test_chunks_add(kind, cuts, size):
    data = _data()
    whole = _total(data, kind)
    edges = [0, *sorted(cuts), 500]
    pooled = None
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        part = _total([d[low:high] for d in data], kind, size)
        pooled = part if pooled is None else pooled.merge(part)
    assert pooled.n_samples == whole.n_samples
    assert_same(pooled, whole)


def assert_same(found, wanted, rel=1e-12):
    """Gram matrices are equal to so many parts of the lengths of their columns."""
    for dofs, a in wanted.squares().matrices.items():
        size = np.sqrt(np.diagonal(a, axis1=-2, axis2=-1))
        scale = np.where(size > 0, size, 1.0)
        gap = (found.squares().matrices[dofs] - a) / scale[..., :, None] / scale[..., None, :]
        assert np.abs(gap).max() < rel, dofs
        assert np.array_equal(found.sizes[dofs], wanted.sizes[dofs])


def test_an_unknown_force_leaves_its_balance_out_of_a_record():
    known, lost = _data(seed=1), _data(seed=2)
    lost[2][:, 1] = np.nan
    pooled = _total(known).merge(_total(lost))
    assert pooled.sizes == {(1,): 1000, (2,): 500, (3,): 1000, (2, 3): 500}
    assert np.array_equal(pooled.matrices[(2,)], _total(known).matrices[(2,)])
    assert all(np.isfinite(matrix).all() for matrix in pooled.matrices.values())


# -- operations on blocks ---------------------------------------------------------------------------


def _blocks(kind="gram"):
    """Ten blocks of 50 samples, and the direct Gram matrix of any weights on them."""
    data = _data()
    data[2][100:150, 1] = np.nan  # the force on DOF 2 is unknown in the third block
    numbered = enumerate(blocks_of(*data, 50))
    grams = GramPass(LAYOUT, GROUPS, MASSES, kind).add_each(numbered).grams()

    def direct(weights, dofs):
        columns = np.nan_to_num(_columns(data, dofs))
        w = np.repeat(weights, 50)
        w[100:150] *= 0.0 if 2 in dofs else 1.0
        return columns.T @ (w[:, None] * columns)

    return grams, direct


def assert_direct(found, weights, direct):
    for dofs, matrix in found.squares().matrices.items():
        wanted = direct(weights, dofs)
        size = np.sqrt(np.diag(wanted))
        assert np.allclose(matrix / np.outer(size, size), wanted / np.outer(size, size), atol=1e-12)


@pytest.mark.parametrize("kind", ["gram", "root"])
@given(weights=st.lists(st.sampled_from([0.0, 0.25, 1.0, 3.0]), min_size=10, max_size=10).filter(lambda w: sum(w[3:]) > 0))
def test_weighted_sums_are_those_of_weighted_samples(kind, weights):
    """Generalized least squares, bootstrap draws and folds: each sample times the root of the weight of its block."""
    grams, direct = _blocks(kind)
    assert_direct(grams.sum(weights), np.array(weights), direct)
    several = grams.sum([weights, np.ones(10)])
    assert several.shape == (2,)
    assert_direct(several[0], np.array(weights), direct)
    assert_direct(several[1], np.ones(10), direct)


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_sums_without_each_block_are_those_of_the_other_samples(kind):
    grams, direct = _blocks(kind)
    rest = grams.leave_one_out()
    assert rest.shape == (10,)
    for i in range(10):
        assert_direct(rest[i], 1.0 - np.eye(10)[i], direct)
        assert rest.sizes[2, 3][i] == 450 - 50 * (i != 2)


def test_a_term_that_moves_in_one_block_only_is_exactly_zero_without_it():
    """Differences of totals would leave round-off there, which a solve takes for motion."""
    layout = Layout(Chain(1), {"storey 1": 1})
    s, a, F = np.random.default_rng(0).normal(size=(3, 400, 1))
    s[:100] = s[200:] = 0.0
    grams = block_grams(layout, [layout.group((1,))], enumerate(blocks_of(s, a, F, 100)))
    assert [bool(m[0].any()) for m in grams.leave_one_out().matrices[1,]] == [True, False, True, True]


def test_sums_before_and_behind_each_boundary():
    grams, direct = _blocks()
    before, after = grams.running()
    assert before.shape == after.shape == (11,)
    for i in (0, 1, 4, 10):
        first = np.arange(10) < i
        for part, weights in ((before[i], first), (after[i], ~first)):
            for dofs, matrix in part.matrices.items():
                assert np.allclose(matrix, direct(weights.astype(float), dofs), rtol=1e-11, atol=1e-9)
        assert before.n_samples[i] == 50 * i


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_blocks_of_several_workers_stand_behind_each_other(kind):
    grams, direct = _blocks(kind)
    joined = BlockGrams.concatenate([grams[:3], grams[3:7], grams[7:]])
    stacked = BlockGrams.stack([grams[i] for i in range(10)], record=[0] * 4 + [1] * 6)
    assert stacked.record.tolist() == [0] * 4 + [1] * 6 and stacked[2:5].record.tolist() == [0, 0, 1]
    for other in (joined, stacked):
        assert other.shape == (10,)
        assert all(np.array_equal(other.matrices[d], m) for d, m in grams.matrices.items())
        assert_direct(other.sum(), np.ones(10), direct)


def test_blocks_are_cut_where_a_piece_ends():
    """Blocks of 64 samples, pieces that begin elsewhere: each sample is in its piece, and only there."""
    data = _data()
    edges = np.array([0, 30, 31, 200, 500])
    grams = block_grams(LAYOUT, GROUPS, cut_at(edges, blocks_of(*data, 64), first=1), MASSES)
    assert grams.n_samples.tolist() == [0, 30, 1, 169, 300]
    for number, (low, high) in enumerate(zip(edges[:-1], edges[1:]), 1):
        assert_same(grams[number], _total([d[low:high] for d in data]))


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_blocks_on_disk_are_the_same_to_the_last_bit(kind, tmp_path):
    grams, _ = _blocks(kind)
    np.savez(tmp_path / "grams.npz", **grams.to_arrays())
    with np.load(tmp_path / "grams.npz", allow_pickle=False) as file:
        again = BlockGrams.from_arrays(dict(file), LAYOUT, GROUPS, MASSES)
    assert again.kind == kind and again.shape == (10,) and np.array_equal(again.n_samples, grams.n_samples)
    assert all(np.array_equal(again.matrices[d], m) for d, m in grams.matrices.items())
    assert all(np.array_equal(again.sizes[d], n) for d, n in grams.sizes.items())
    assert_same(again.sum(), grams.sum(), 1e-15)


def test_other_columns_of_the_same_samples():
    """Orders of a power series are some of its columns; a change of basis is a product with a matrix."""
    grams, _ = _blocks()
    group = GROUPS[0]
    few = np.array([0, 3, 7, 8])
    change = np.random.default_rng(1).normal(size=(9, 4))
    for kind in (grams, grams.roots()):
        cut, turned = (kind.transformed(LAYOUT, {group: c}).squares().matrices[1,] for c in (few, change))
        assert np.allclose(cut, grams.matrices[1,][:, few[:, None], few], rtol=1e-11)
        assert np.allclose(turned, change.T @ grams.matrices[1,] @ change, rtol=1e-8)


def test_columns_projected_on_instruments_are_those_of_the_projector():
    """P_Z X by an orthonormal basis of Z: the root of the projected columns has their Gram matrix."""
    rng = np.random.default_rng(0)
    X, Z = rng.normal(size=(300, 9)), rng.normal(size=(300, 8))
    Z = np.column_stack([X[:, :8] + Z[:, :8]])
    both = np.hstack([X, Z])
    grams = BlockGrams(
        LAYOUT, {(1,): GROUPS[0]}, {(1,): (both.T @ both)[None]}, {(1,): np.array([300.0])}, np.array([300.0]), {},
        instrumented=True,
    )  # fmt: skip
    Q = np.linalg.qr(Z)[0]
    assert np.allclose(grams.sum().projected().squares().matrices[1,], X.T @ Q @ Q.T @ X, atol=1e-9)


def test_columns_ten_orders_apart_keep_their_digits():
    """Gram matrices are scaled after accumulation: the small column is found to round-off."""
    rng = np.random.default_rng(0)
    layout = Layout(Chain(1), {"storey 1": 2})
    a, s = rng.normal(size=(2, 4000, 1))
    terms = np.column_stack([1e-3 * s, 1e-9 * s**3])
    F = 7 * a + terms @ np.array([[2e5], [3e11]])
    R = total_gram(layout, [layout.group((1,))], blocks_of(terms, a, F)).triangle((1,), np.eye(4))
    assert np.linalg.solve(R[:3, :3], R[:3, 3]) == pytest.approx([2e5, 3e11, 7.0], rel=1e-12)


def test_a_dependent_column_gets_a_pivot_of_zero_not_noise():
    rng = np.random.default_rng(0)
    layout = Layout(Chain(1), {"storey 1": 2})
    a, s = rng.normal(size=(2, 4000, 1))
    total = total_gram(layout, [layout.group((1,))], blocks_of(np.column_stack([s, -3 * s]), a, a))
    gram, R = total.matrices[1,], total.triangle((1,), np.eye(4))
    assert abs(R[1, 1]) < 1e-6 * abs(R[0, 1])
    assert np.allclose(R.T @ R, gram, rtol=1e-12, atol=1e-9 * np.abs(gram).max())


def test_one_gram_matrix_of_all_columns_serves_every_balance():
    data = _data()
    full = np.hstack(data)
    assert_same(BlockGrams.from_shared(LAYOUT, GROUPS, lambda dofs: (full.T @ full, len(full)), MASSES), _total(data))


def test_gram_matrices_of_other_balances_or_kinds_do_not_add():
    with pytest.raises(NRFError, match="different balances cannot be added"):
        _total(_data()).merge(total_gram(LAYOUT, GROUPS[:1], blocks_of(*_data())))
    with pytest.raises(NRFError, match="different columns or kinds cannot be added"):
        _total(_data()).merge(_total(_data(), "root"))


@given(counts=st.lists(st.integers(0, 14), min_size=4, max_size=4), size=st.integers(1, 600), seed=st.integers(0, 99))
def test_any_number_of_terms_anywhere_gives_the_gram_matrix(counts, size, seed):
    """Tiles of three by three, and whatever is left over: storeys, a brace and a DOF's own terms, sums of balances."""
    chain = Chain(3, ["link 3-1"])
    layout = Layout(chain, dict(zip(["storey 1", "storey 2", "storey 3", "link 3-1"], counts)) | {"dof 2": 1})
    groups = [layout.group(dofs) for dofs in ((1,), (2,), (3,), (3, 2), (1, 2, 3))]
    masses = {1: 2.0, 2: 3.0, 3: 5.0}
    rng = np.random.default_rng(seed)
    terms, a, F = (rng.normal(size=(size, k)) for k in (layout.n_terms, 3, 3))
    found = total_gram(layout, groups, blocks_of(terms, a, F, 257), masses)
    for group in groups:
        own = [terms[:, layout.slices[s]] for s in group.sites]
        j = [d - 1 for d in group.dofs]
        if len(j) == 1:
            own += [a[:, j], F[:, j]]
        else:
            own.append((F[:, j] - a[:, j] * [masses[d] for d in group.dofs]).sum(axis=1)[:, None])
        columns = np.hstack(own)
        assert np.allclose(found.matrices[group.dofs], columns.T @ columns, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("order", ["C", "F", "strided", "read-only"])
def test_columns_built_in_the_pass_are_those_of_the_laws(order, dtype):
    """Products of v and s, and laws that are none, whatever the layout of the user's arrays; float32 is added in double."""
    held = {
        "storey 1": [laws.PowerSeries((2, 3))],
        "storey 2": [laws.LinearElastic(), laws.LinearViscous(), laws.CubicStiffness(), laws.CoulombFriction()],
        "storey 3": [laws.Dahl(sigma=300.0), laws.PowerSeries(1)],
        "link 3-1": [laws.PowerSeries(2)],
    }
    layout = LawLayout(Chain(3, ["link 3-1"]), held)
    rng = np.random.default_rng(0)
    s = np.cumsum(rng.normal(size=(5000, 3)), axis=0) * 1e-4
    X = np.hstack([rng.normal(size=(5000, 3)), np.gradient(s, axis=0) * 1e3, s]).astype(dtype)
    F = rng.normal(size=(5000, 3)).astype(dtype)
    given = {
        "C": X, "F": np.asfortranarray(X), "strided": np.repeat(X, 2, axis=0)[::2], "read-only": X.copy(),
    }[order]  # fmt: skip
    given.flags.writeable = order != "read-only"
    segment = from_arrays(given, F, dt=1e-3).segments[0]
    groups = [layout.group((j,)) for j in (1, 2, 3)]
    total = total_gram(layout, groups, segment.blocks(layout, 700, states={}))
    whole = slice(0, 5000)
    for (j,), gram in total.matrices.items():
        own = [
            law.features(segment.motion(site, whole)) for site in total.groups[(j,)].sites for law in layout.laws[site]
        ]
        columns = np.hstack([*own, X[:, [j - 1]].astype(float), F[:, [j - 1]].astype(float)])
        size = np.linalg.norm(columns, axis=0)
        assert np.allclose(gram / np.outer(size, size), columns.T @ columns / np.outer(size, size), atol=1e-13)
    assert X.dtype == dtype  # the user's array is as it was


def test_a_law_whose_label_lies_is_taken_at_its_word_by_nobody():
    """A user's law may call a column "s" and mean another: its own function decides."""

    class Clipped(laws.ForceLaw):
        name = "test_clipped"

        def terms(self):
            return (laws.Term("k", "s", "N/m"),)

        @staticmethod
        def kernel(s, v, a, t, u, z, theta, out):
            out[0] = np.minimum(s, 0.5)

    layout = LawLayout(Chain(1), {"storey 1": [Clipped()]})
    x = np.linspace(0, 1, 9)[:, None]
    block = next(iter(from_arrays(np.hstack([x, x, x]), x).segments[0].blocks(layout)))
    assert block.terms[0].max() == 0.5


@pytest.mark.parametrize("condition", [1e1, 1e5, 1e9, 1e13])
def test_a_guess_of_the_root_loses_no_digit(condition):
    """The root through a guess is that of Householder's QR, up to signs, at any condition number and any units."""
    rng = np.random.default_rng(3)
    p = 12
    layout = Layout(Chain(1), {"storey 1": p - 2})
    mix = np.linalg.qr(rng.normal(size=(p, p)))[0] * np.logspace(0, -np.log10(condition), p)
    columns = ((mix @ rng.normal(size=(p, 4000))) * 10.0 ** rng.uniform(-8, 8, p)[:, None]).T
    groups, data = [layout.group((1,))], (columns[:, : p - 2], columns[:, p - 2 : p - 1], columns[:, p - 1 :])
    first = total_gram(layout, groups, blocks_of(*(x[:2000] for x in data)))  # half the samples are enough to guess
    guessed = total_gram(layout, groups, blocks_of(*data, 800), kind="root", guess=guess_of(first))
    size = np.linalg.norm(columns, axis=0)
    R, truth = (np.linalg.qr(rows / size, mode="r") for rows in (guessed.matrices[1,], columns))
    sign = np.sign(np.diag(R) * np.diag(truth))[:, None]
    assert np.allclose(R, sign * truth, atol=1e-14)


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_a_pass_may_be_interrupted_and_pickled_half_way(kind):
    data = _data()
    first = GramPass(LAYOUT, GROUPS, MASSES, kind).add_each((0, b) for b in blocks_of(*[d[:200] for d in data]))
    rest = list(blocks_of(*[d[200:] for d in data], 100))
    pickled = pickle.loads(pickle.dumps(first)).add_each((0, b) for b in rest).total()
    resumed = first.empty(before=first.total())
    for block in rest:
        resumed.add(block)
    assert resumed.n_samples == pickled.n_samples == 500
    for found in (pickled, resumed.total()):
        assert_same(found, _total(data), 1e-13)
