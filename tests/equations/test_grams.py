"""Gram matrices of blocks of samples: the products of the columns, their triangular
factors, and sums of blocks.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf import Chain, ForceLawLibrary, laws
from pysindy_nrf.chain.layout import LawLayout, Layout, blocks_of
from pysindy_nrf.equations.accumulation import GramPass, total_gram
from pysindy_nrf.equations.balances import blocks_of_segment
from pysindy_nrf.equations.normal_equations import NormalEquations
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records.input_arrays import from_arrays

LAYOUT = Layout(
    Chain(3, ["link 3-1"]), {"storey 1": 2, "storey 2": 3, "storey 3": 1, "link 3-1": 2}
)
GROUPS = [LAYOUT.group(dofs) for dofs in ((1,), (2,), (3,), (2, 3))]
MASSES = {1: 2.0, 2: 3.0, 3: 5.0, 4: 7.0}


def columns_of(layout, group, data, masses=MASSES):
    """The columns of a group written out: terms of its sites, then a_j and F_j, or the
    sum of F_j - m_j a_j.
    """
    terms, a, F = data
    own = [terms[:, layout.slices[s]] for s in group.sites]
    j = [d - 1 for d in group.dofs]
    if len(j) == 1:
        return np.hstack([*own, a[:, j], F[:, j]])
    return np.hstack([*own, sum(F[:, i] - masses[i + 1] * a[:, i] for i in j)[:, None]])


def whole_numbers(n, terms, dofs, seed=0):
    """Columns of whole numbers: every product and sum of them is exact in a double."""
    rng = np.random.default_rng(seed)
    return [rng.integers(-9, 10, (n, k)).astype(float) for k in (terms, dofs, dofs)]


def random_columns(size=500, seed=0):
    """Columns whose units are up to ten orders apart."""
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-5, 5, LAYOUT.n_terms)
    return (
        rng.normal(size=(size, LAYOUT.n_terms)) * scale,
        rng.normal(size=(size, 3)),
        rng.normal(size=(size, 3)),
    )


def total_of(data, kind="gram", size=64):
    return total_gram(LAYOUT, GROUPS, blocks_of(*data, size), MASSES, kind)


def assert_gram(found, wanted, rel=1e-12):
    """Two Gram matrices are equal to so many parts of the lengths of their columns."""
    size = np.sqrt(np.diagonal(wanted, axis1=-2, axis2=-1))
    scale = np.where(size > 0, size, 1.0)
    assert (
        np.abs((found - wanted) / scale[..., :, None] / scale[..., None, :]).max() < rel
    )


def assert_same(found, wanted, rel=1e-12):
    for dofs, gram in wanted.squares().matrices.items():
        assert_gram(found.squares().matrices[dofs], gram, rel)
        assert np.array_equal(found.sizes[dofs], wanted.sizes[dofs])


SUMS = [(1,), (2,), (3,), (4,), (3, 4), (2, 3, 4), (1, 2, 3, 4)]


@given(
    counts=st.lists(st.integers(0, 14), min_size=5, max_size=5),
    size=st.one_of(st.sampled_from([1, 255, 256, 257]), st.integers(1, 700)),
    dofs=st.lists(st.sampled_from(SUMS), min_size=1, max_size=5, unique=True),
    chunk=st.integers(1, 700),
    known=st.sets(st.sampled_from([1, 2, 3, 4])),
)
def test_every_product_is_exact(counts, size, dofs, chunk, known):
    """Any number of terms, sums of the balances above any cut; a mass that is not given
    takes no part in a sum.
    """
    sites = ["storey 1", "storey 2", "storey 3", "storey 4", "link 4-2"]
    layout = Layout(Chain(4, ["link 4-2"]), dict(zip(sites, counts)) | {"dof 3": 1})
    data, groups = (
        whole_numbers(size, layout.n_terms, 4),
        [layout.group(d) for d in dofs],
    )
    masses = {j: MASSES[j] for j in known}
    total = total_gram(layout, groups, blocks_of(*data, chunk), masses)
    assert list(total.matrices) == [g.dofs for g in groups]
    for group in groups:
        A = columns_of(layout, group, data, dict.fromkeys(MASSES, 0.0) | masses)
        assert np.array_equal(total.matrices[group.dofs], A.T @ A)
        assert total.sizes[group.dofs] == size


@pytest.mark.parametrize("kind", ["gram", "root"])
@pytest.mark.parametrize("group", GROUPS, ids=lambda g: str(g.dofs))
def test_triangular_factor_and_lengths_are_those_of_qr(kind, group):
    data, dofs = random_columns(), group.dofs
    total, columns = total_of(data, kind), columns_of(LAYOUT, group, data)
    assert_gram(total.squares().matrices[dofs], columns.T @ columns)
    combine = (
        np.random.default_rng(1).normal(size=(columns.shape[1], 4))
        / np.linalg.norm(columns, axis=0)[:, None]
    )
    triangle = total.triangle(dofs, combine)
    assert np.array_equal(triangle, np.triu(triangle))
    assert np.allclose(
        np.abs(triangle), np.abs(np.linalg.qr(columns @ combine, mode="r")), atol=1e-9
    )
    assert total.norms(dofs, combine) == pytest.approx(
        np.linalg.norm(columns @ combine, axis=0), rel=1e-10
    )


@pytest.mark.parametrize("kind", ["gram", "root"])
@given(
    cuts=st.lists(st.integers(1, 499), max_size=3, unique=True),
    size=st.integers(1, 700),
)
def test_chunks_add(kind, cuts, size):
    data = random_columns()
    edges = [0, *sorted(cuts), 500]
    parts = [
        total_of([d[low:high] for d in data], kind, size)
        for low, high in zip(edges[:-1], edges[1:])
    ]
    pooled = parts[0]
    for part in parts[1:]:
        pooled = pooled.merge(part)
    assert pooled.n_samples == 500
    assert_same(pooled, total_of(data, kind))


POWERS = [
    [laws.PowerSeries(3)],
    [laws.PowerSeries((1, 3))],
    [laws.LinearElastic(), laws.CubicStiffness(), laws.LinearViscous()],
    [],
]
OTHERS = [
    laws.CoulombFriction(),
    laws.Dahl(sigma=300.0),
    laws.QuadraticDamping(),
    laws.Jenkins(uy=1e-3),
]


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("order", ["C", "F", "strided", "read-only"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), n=st.integers(1, 4))
def test_what_the_library_says_a_column_is_the_pass_sums_up(order, dtype, seed, n):
    """Random laws and chains, whatever the layout of the user's arrays; float32 is
    added in double.
    """
    rng = np.random.default_rng(seed)
    chain = Chain(
        n,
        [f"link {p}-1" for p in range(3, n + 1) if rng.random() < 0.5],
        rng.choice(["base", "free"]) if n > 1 else "base",
    )
    held = {
        s: [
            *POWERS[rng.integers(4)],
            *rng.choice(OTHERS, rng.integers(3), replace=False),
        ]
        for s in [*chain.sites, "dof 1"]
    }
    s = np.cumsum(rng.normal(size=(2000, n)), axis=0) * 1e-4
    X = np.hstack([rng.normal(size=(2000, n)), np.gradient(s, axis=0) * 1e3, s]).astype(
        dtype
    )
    F = rng.normal(size=(2000, n)).astype(dtype)
    given = {
        "C": X,
        "F": np.asfortranarray(X),
        "strided": np.repeat(X, 2, axis=0)[::2],
        "read-only": X.copy(),
    }[order]
    given.flags.writeable = order != "read-only"
    library = ForceLawLibrary(held, chain, dt=1e-3)
    features, layout = (
        np.asarray(library.fit_transform(given.astype(float))),
        library.layout_,
    )
    segment = from_arrays(given, F, dt=1e-3).segments[0]
    own = [
        law.features(segment.motion(site, slice(0, 2000)))
        for site in layout.acting
        for law in layout.laws[site]
    ]
    by_hand = np.hstack([X[:, :n].astype(float), *own])
    assert np.allclose(features, by_hand, rtol=1e-12, atol=0.0)
    total = total_gram(
        layout,
        [layout.group((j,)) for j in range(1, n + 1)],
        blocks_of_segment(segment, layout, 700, states={}),
    )
    for dofs, gram in total.matrices.items():
        columns = columns_of(
            layout,
            total.groups[dofs],
            (features[:, n:], features[:, :n], F.astype(float)),
        )
        assert_gram(gram, columns.T @ columns, 1e-12)
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
    block = next(
        iter(
            blocks_of_segment(from_arrays(np.hstack([x, x, x]), x).segments[0], layout)
        )
    )
    assert block.terms[0].max() == 0.5


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_records_whose_unknown_forces_differ_come_one_after_the_other(kind):
    """A balance takes the samples in which it knows every force; all are counted, and
    each only once.
    """
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
        assert np.allclose(
            total.squares().matrices[group.dofs], A.T @ A, rtol=1e-12, atol=1e-9
        )
        assert total.sizes[group.dofs] == len(A)


def test_gram_matrices_of_other_balances_or_kinds_do_not_add():
    data = random_columns()
    for other, what in (
        (total_gram(LAYOUT, GROUPS[:1], blocks_of(*data)), "balances"),
        (total_of(data, "root"), "columns or kinds"),
    ):
        with pytest.raises(NRFError, match=f"different {what} cannot be added"):
            total_of(data).merge(other)


def of_columns(columns, kind="gram"):
    """The balance of one DOF whose columns [terms | a | F] are given, one row for each
    sample.
    """
    layout = Layout(Chain(1), {"storey 1": columns.shape[1] - 2})
    blocks = blocks_of(columns[:, :-2], columns[:, -2:-1], columns[:, -1:], 100)
    return total_gram(layout, [layout.group((1,))], blocks, kind=kind)


@pytest.mark.parametrize("condition", [1e1, 1e5, 1e9, 1e13])
def test_a_streamed_root_loses_no_digit(condition):
    """It is that of Householder's QR of all rows, up to signs, at any condition number
    and any units.
    """
    rng, p = np.random.default_rng(3), 12
    mix = np.linalg.qr(rng.normal(size=(p, p)))[0] * np.logspace(
        0, -np.log10(condition), p
    )
    columns = (
        (mix @ rng.normal(size=(p, 4000))) * 10.0 ** rng.uniform(-8, 8, p)[:, None]
    ).T
    size = np.linalg.norm(columns, axis=0)
    R, truth = (
        np.linalg.qr(rows / size, mode="r")
        for rows in (of_columns(columns, "root").matrices[1,], columns)
    )
    sign = np.sign(np.diag(R) * np.diag(truth))[:, None]
    assert np.allclose(R, sign * truth, atol=1e-14)


def test_dependent_columns_leave_zeros_and_the_others_their_digits():
    """Columns x, 0, 2 x, y, x + y of units far apart: pivots of x and y are exact, the
    rest is zero.
    """
    x, y = np.array([3.0, 4.0, 0.0]), np.array([1.0, 0.0, 2.0])
    R = of_columns(
        np.column_stack([1e8 * x, 0 * x, 2e-3 * x, 1e-7 * y, x + y])
    ).triangle((1,), np.eye(5))
    across = np.sqrt(5.0 - 0.6**2)  # y has 0.6 along x
    assert R[0] == pytest.approx([5e8, 0.0, 1e-2, 0.6e-7, 5.6], rel=1e-12)
    assert R[3, 3:] == pytest.approx([across * 1e-7, across], rel=1e-12)
    assert not R[1:3].any() and not R[4].any()


def direct(weights, group):
    """The Gram matrix of the samples of ten blocks, each times its weight; force 2 is
    unknown in the third block.
    """
    columns = columns_of(LAYOUT, group, random_columns())
    w = np.repeat(np.asarray(weights, dtype=float), 50)
    w[100:150] *= 0.0 if 2 in group.dofs else 1.0
    return columns.T @ (w[:, None] * columns)


def ten_blocks(kind="gram"):
    data = random_columns()
    data[2][100:150, 1] = np.nan
    return (
        GramPass(LAYOUT, GROUPS, MASSES, kind)
        .add_each(enumerate(blocks_of(*data, 50)))
        .grams()
    )


def assert_direct(found, weights):
    for group in GROUPS:
        assert_gram(found.squares().matrices[group.dofs], direct(weights, group))


@pytest.mark.parametrize("kind", ["gram", "root"])
@given(
    weights=st.lists(
        st.sampled_from([0.0, 0.25, 1.0, 3.0]), min_size=10, max_size=10
    ).filter(lambda w: sum(w[3:]) > 0)
)
def test_weighted_sums_are_those_of_weighted_samples(kind, weights):
    """Generalized least squares, bootstrap draws and folds: each sample times the root
    of the weight of its block.
    """
    grams = ten_blocks(kind)
    assert_direct(grams.sum(weights), np.array(weights))
    several = grams.sum([weights, np.ones(10)])
    assert several.shape == (2,)
    assert_direct(several[0], np.array(weights))
    assert_direct(several[1], np.ones(10))


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_sums_without_each_block_are_those_of_the_other_samples(kind):
    grams = ten_blocks(kind)
    rest = grams.leave_one_out()
    assert rest.shape == (10,)
    for i in range(10):
        assert_direct(rest[i], 1.0 - np.eye(10)[i])
        assert rest.sizes[2, 3][i] == 450 - 50 * (i != 2)


def test_a_term_that_moves_in_one_block_only_is_exactly_zero_without_it():
    """Differences of totals would leave round-off there, which a solve takes for
    motion.
    """
    layout = Layout(Chain(1), {"storey 1": 1})
    s, a, F = np.random.default_rng(0).normal(size=(3, 400, 1))
    s[:100] = s[200:] = 0.0
    grams = (
        GramPass(layout, [layout.group((1,))])
        .add_each(enumerate(blocks_of(s, a, F, 100)))
        .grams()
    )
    assert [bool(m[0].any()) for m in grams.leave_one_out().matrices[1,]] == [
        True,
        False,
        True,
        True,
    ]


@pytest.mark.parametrize("kind", ["gram", "root"])
def test_blocks_on_disk_are_the_same_to_the_last_bit(kind, tmp_path):
    grams = ten_blocks(kind)
    np.savez(tmp_path / "grams.npz", **grams.to_arrays())
    with np.load(tmp_path / "grams.npz", allow_pickle=False) as file:
        again = NormalEquations.from_arrays(dict(file), LAYOUT, GROUPS, MASSES)
    assert (
        again.kind == kind
        and again.shape == (10,)
        and np.array_equal(again.n_samples, grams.n_samples)
    )
    assert all(np.array_equal(again.matrices[d], m) for d, m in grams.matrices.items())
    assert all(np.array_equal(again.sizes[d], n) for d, n in grams.sizes.items())
    assert_same(again.sum(), grams.sum(), 1e-15)


def test_other_columns_of_the_same_samples():
    """Orders of a power series are some of its columns; a change of basis is a product
    with a matrix.
    """
    grams = ten_blocks()
    group = GROUPS[0]
    few = np.array([0, 3, 7, 8])
    change = np.random.default_rng(1).normal(size=(9, 4))
    for kind in (grams, grams.roots()):
        cut, turned = (
            kind.transformed(LAYOUT, {group: c}).squares().matrices[1,]
            for c in (few, change)
        )
        assert np.allclose(cut, grams.matrices[1,][:, few[:, None], few], rtol=1e-11)
        assert np.allclose(turned, change.T @ grams.matrices[1,] @ change, rtol=1e-8)


def test_columns_projected_on_instruments_are_those_of_the_projector():
    """P_Z X by an orthonormal basis of Z: the root of the projected columns has their
    Gram matrix.
    """
    rng = np.random.default_rng(0)
    X, Z = rng.normal(size=(300, 9)), rng.normal(size=(300, 8))
    Z = np.column_stack([X[:, :8] + Z[:, :8]])
    both = np.hstack([X, Z])
    grams = NormalEquations(
        LAYOUT,
        {(1,): GROUPS[0]},
        {(1,): (both.T @ both)[None]},
        {(1,): np.array([300.0])},
        np.array([300.0]),
        {},
        instrumented=True,
    )
    Q = np.linalg.qr(Z)[0]
    assert np.allclose(
        grams.sum().projected().squares().matrices[1,], X.T @ Q @ Q.T @ X, atol=1e-9
    )
