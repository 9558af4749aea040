"""Sums of products of the columns of equations of motion, factors and blocks."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf import Chain, ForceLawLibrary, laws
from pysindy_nrf.chain import LawLayout, Layout, blocks_of
from pysindy_nrf.equations import (
    NormalEquations,
    ProductSums,
    blocks_of_segment,
    pieces_of,
    total_products,
)
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records import from_arrays

BRACED = Chain(3, ["link 3-1"])
TERMS = {"storey 1": 2, "storey 2": 3, "storey 3": 1, "link 3-1": 2}
LAYOUT = Layout(BRACED, TERMS)
GROUPS = [LAYOUT.group(dofs) for dofs in ((1,), (2,), (3,), (2, 3))]
MASSES = {1: 2.0, 2: 3.0, 3: 5.0, 4: 7.0}
KINDS = pytest.mark.parametrize("kind", ["gram", "root"])


@dataclass
class Columns:
    """Terms, accelerations and forces, one row a sample."""

    terms: np.ndarray
    a: np.ndarray
    F: np.ndarray

    def cut(self, rows):
        return Columns(self.terms[rows], self.a[rows], self.F[rows])

    def blocks(self, size=64):
        return blocks_of(self.terms, self.a, self.F, size)

    def of_group(self, layout, group, masses=MASSES):
        """Terms, a_j and F_j of one DOF; sum of F_j - m_j a_j of several."""
        columns = [self.terms[:, layout.slices[site]] for site in group.sites]
        dofs = [dof - 1 for dof in group.dofs]
        if len(dofs) == 1:
            return np.hstack([*columns, self.a[:, dofs], self.F[:, dofs]])
        m = np.array([masses[dof] for dof in group.dofs])
        inertia = self.a[:, dofs] @ m
        return np.column_stack([*columns, self.F[:, dofs].sum(axis=1) - inertia])


def whole_numbers(n_samples, n_terms, n_dof, seed=0):
    """Products and sums of whole numbers are exact in a double."""
    rng = np.random.default_rng(seed)
    table = rng.integers(-9, 10, (n_samples, n_terms + 2 * n_dof)).astype(float)
    return Columns(*np.split(table, [n_terms, n_terms + n_dof], axis=1))


def random_columns():
    """Columns whose units are up to ten orders apart."""
    rng = np.random.default_rng(0)
    units = 10.0 ** rng.uniform(-5, 5, LAYOUT.n_terms)
    terms = rng.normal(size=(500, LAYOUT.n_terms)) * units
    return Columns(terms, rng.normal(size=(500, 3)), rng.normal(size=(500, 3)))


def total_of(columns, kind="gram", size=64):
    return total_products(LAYOUT, GROUPS, columns.blocks(size), MASSES, kind)


def assert_products(sums, expected, rel=1e-12):
    """Equal to so many parts of the lengths of the columns."""
    length = np.sqrt(np.diagonal(expected, axis1=-2, axis2=-1))
    scale = np.where(length > 0, length, 1.0)
    error = (sums - expected) / scale[..., :, None] / scale[..., None, :]
    assert np.abs(error).max() < rel


def assert_same(sums, expected, rel=1e-12):
    squares = sums.squares().matrices
    for dofs, matrix in expected.squares().matrices.items():
        assert_products(squares[dofs], matrix, rel)
        assert np.array_equal(sums.sizes[dofs], expected.sizes[dofs])


# -- products ------------------------------------------------------------------

ALL_GROUPS = [(1,), (2,), (3,), (4,), (3, 4), (2, 3, 4), (1, 2, 3, 4)]


@given(
    counts=st.lists(st.integers(0, 14), min_size=5, max_size=5),
    size=st.one_of(st.sampled_from([1, 255, 256, 257]), st.integers(1, 700)),
    dofs=st.lists(st.sampled_from(ALL_GROUPS), min_size=1, max_size=5, unique=True),
    chunk=st.integers(1, 700),
    known=st.sets(st.sampled_from([1, 2, 3, 4])),
)
def test_every_product_is_exact(counts, size, dofs, chunk, known):
    """Any terms and sums; a mass that is not given takes no part in a sum."""
    sites = ["storey 1", "storey 2", "storey 3", "storey 4", "link 4-2"]
    terms = dict(zip(sites, counts)) | {"dof 3": 1}
    layout = Layout(Chain(4, ["link 4-2"]), terms)
    columns = whole_numbers(size, layout.n_terms, 4)
    groups = [layout.group(group) for group in dofs]
    masses = {dof: MASSES[dof] for dof in known}
    total = total_products(layout, groups, columns.blocks(chunk), masses)
    assert list(total.matrices) == dofs
    for group in groups:
        A = columns.of_group(layout, group, dict.fromkeys(MASSES, 0.0) | masses)
        assert np.array_equal(total.matrices[group.dofs], A.T @ A)
        assert total.sizes[group.dofs] == size


@KINDS
@pytest.mark.parametrize("group", GROUPS, ids=lambda group: str(group.dofs))
def test_triangular_factor_and_lengths_are_those_of_qr(kind, group):
    columns = random_columns()
    total, A = total_of(columns, kind), columns.of_group(LAYOUT, group)
    assert_products(total.squares().matrices[group.dofs], A.T @ A)

    combine = np.random.default_rng(1).normal(size=(A.shape[1], 4))
    combine /= np.linalg.norm(A, axis=0)[:, None]
    triangle = total.triangle(group.dofs, combine)
    expected = np.linalg.qr(A @ combine, mode="r")
    assert np.array_equal(triangle, np.triu(triangle))
    assert np.abs(triangle) == pytest.approx(np.abs(expected), abs=1e-9)
    lengths = np.linalg.norm(A @ combine, axis=0)
    assert total.norms(group.dofs, combine) == pytest.approx(lengths, rel=1e-10)


@KINDS
@given(
    cuts=st.lists(st.integers(1, 499), max_size=3, unique=True),
    size=st.integers(1, 700),
)
def test_chunks_add(kind, cuts, size):
    columns = random_columns()
    edges = [0, *sorted(cuts), 500]
    pooled = total_of(columns.cut(slice(0, edges[1])), kind, size)
    for low, high in zip(edges[1:-1], edges[2:]):
        pooled = pooled.merge(total_of(columns.cut(slice(low, high)), kind, size))
    assert pooled.n_samples == 500
    assert_same(pooled, total_of(columns, kind))


@KINDS
def test_records_with_different_unknown_forces(kind):
    """An equation takes the samples in which its forces are known; all are counted."""
    records = [whole_numbers(n, 8, 3, seed) for seed, n in enumerate((40, 70, 30, 25))]
    unknown = [[], [2], [2], [1, 3]]
    sums = ProductSums(LAYOUT, GROUPS, MASSES, kind)
    for record, dofs in zip(records, unknown):
        record.F[:, [dof - 1 for dof in dofs]] = np.nan
        sums.add_each((0, block) for block in record.blocks(16))
    total = sums.total()

    assert total.n_samples == 165
    squares = total.squares().matrices
    for group in GROUPS:
        rows = [np.zeros((0, squares[group.dofs].shape[0]))]
        for record, dofs in zip(records, unknown):
            if not set(dofs) & set(group.dofs):
                rows.append(record.of_group(LAYOUT, group))
        A = np.vstack(rows)
        assert np.allclose(squares[group.dofs], A.T @ A, rtol=1e-12, atol=1e-9)
        assert total.sizes[group.dofs] == len(A)


@pytest.mark.parametrize(
    ("groups", "kind", "what"),
    [(GROUPS[:1], "gram", "balances"), (GROUPS, "root", "columns or kinds")],
)
def test_sums_of_other_equations_or_kinds_do_not_add(groups, kind, what):
    columns = random_columns()
    other = total_products(LAYOUT, groups, columns.blocks(), MASSES, kind)
    with pytest.raises(NRFError, match=f"different {what} cannot"):
        total_of(columns).merge(other)


def test_running_sums_survive_pickling():
    """A worker takes them up where another left off."""
    columns = random_columns()
    first, second = list(columns.blocks(250))
    sums = pickle.loads(pickle.dumps(ProductSums(LAYOUT, GROUPS, MASSES).add(first)))
    assert_same(sums.add(second).total(), total_of(columns))


def test_sums_go_on_behind_a_total():
    columns = random_columns()
    before = total_of(columns.cut(slice(0, 200)))
    behind = ProductSums(LAYOUT, GROUPS, MASSES).empty(before)
    for block in columns.cut(slice(200, 500)).blocks():
        behind.add(block)
    assert behind.n_samples == 500
    assert_same(behind.total(), total_of(columns))


# -- columns of laws -----------------------------------------------------------

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


def random_laws(rng, n_dof):
    """A chain and laws at its sites and at a DOF."""
    links = [f"link {p}-1" for p in range(3, n_dof + 1) if rng.random() < 0.5]
    ground = rng.choice(["base", "free"]) if n_dof > 1 else "base"
    chain = Chain(n_dof, links, ground)
    by_site = {}
    for site in [*chain.sites, "dof 1"]:
        others = rng.choice(OTHERS, rng.integers(3), replace=False)
        by_site[site] = POWERS[rng.integers(4)] + list(others)
    return chain, by_site


def stored(X, order):
    """The same numbers, laid out in memory in some way."""
    if order == "strided":
        return np.repeat(X, 2, axis=0)[::2]
    out = np.array(X, order="F" if order == "F" else "C")
    out.flags.writeable = order != "read-only"
    return out


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("order", ["C", "F", "strided", "read-only"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), n=st.integers(1, 4))
def test_what_is_summed_up_are_the_features_of_the_library(order, dtype, seed, n):
    """Whatever the layout of the user's arrays; float32 is added in double."""
    rng = np.random.default_rng(seed)
    chain, by_site = random_laws(rng, n)
    s = np.cumsum(rng.normal(size=(2000, n)), axis=0) * 1e-4
    v = np.gradient(s, axis=0) * 1e3
    X = np.hstack([rng.normal(size=(2000, n)), v, s]).astype(dtype)
    F = rng.normal(size=(2000, n)).astype(dtype)

    library = ForceLawLibrary(by_site, chain, dt=1e-3)
    features = np.asarray(library.fit_transform(X.astype(float)))
    layout = library.layout_
    segment = from_arrays(stored(X, order), F, dt=1e-3).segments[0]
    by_hand = [X[:, :n].astype(float)]
    for site in layout.acting:
        motion = segment.motion(site, slice(0, 2000))
        by_hand.extend(law.features(motion) for law in layout.laws[site])
    assert np.allclose(features, np.hstack(by_hand), rtol=1e-12, atol=0.0)

    groups = [layout.group((j,)) for j in range(1, n + 1)]
    blocks = blocks_of_segment(segment, layout, 700, states={})
    total = total_products(layout, groups, blocks)
    columns = Columns(features[:, n:], features[:, :n], F.astype(float))
    for dofs, matrix in total.matrices.items():
        A = columns.of_group(layout, total.groups[dofs])
        assert_products(matrix, A.T @ A)


class Clipped(laws.ForceLaw):
    """A law that calls its column "s" and means another."""

    name = "test_clipped"
    family = "stiffness"
    columns = (laws.Term("k", "s", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.minimum(s, 0.5)


def test_a_laws_own_function_decides_what_its_column_is():
    layout = LawLayout(Chain(1), {"storey 1": [Clipped()]})
    x = np.linspace(0, 1, 9)[:, None]
    segment = from_arrays(np.hstack([x, x, x]), x).segments[0]
    (block,) = blocks_of_segment(segment, layout)
    assert block.terms[0].max() == 0.5


# -- factors -------------------------------------------------------------------


def of_columns(columns, kind="gram"):
    """One DOF whose columns [terms | a | F] are given, one row a sample."""
    layout = Layout(Chain(1), {"storey 1": columns.shape[1] - 2})
    blocks = blocks_of(columns[:, :-2], columns[:, -2:-1], columns[:, -1:], 100)
    return total_products(layout, [layout.group((1,))], blocks, kind=kind)


@pytest.mark.parametrize("condition", [1e1, 1e5, 1e9, 1e13])
def test_a_streamed_root_loses_no_digit(condition):
    """It is Householder's QR of all rows, at any condition and in any units."""
    rng, p = np.random.default_rng(3), 12
    decay = np.logspace(0, -np.log10(condition), p)
    mix = np.linalg.qr(rng.normal(size=(p, p)))[0] * decay
    units = 10.0 ** rng.uniform(-8, 8, p)
    columns = ((mix @ rng.normal(size=(p, 4000))) * units[:, None]).T
    length = np.linalg.norm(columns, axis=0)

    root = of_columns(columns, "root").matrices[(1,)] / length
    R = np.linalg.qr(root, mode="r")
    expected = np.linalg.qr(columns / length, mode="r")
    sign = np.sign(np.diag(R) * np.diag(expected))[:, None]
    assert np.allclose(R, sign * expected, atol=1e-14)


def test_dependent_columns_leave_zeros_and_the_others_their_digits():
    """Columns x, 0, 2 x, y, x + y of units far apart."""
    x, y = np.array([3.0, 4.0, 0.0]), np.array([1.0, 0.0, 2.0])
    columns = np.column_stack([1e8 * x, 0 * x, 2e-3 * x, 1e-7 * y, x + y])
    R = of_columns(columns).triangle((1,), np.eye(5))
    across = np.sqrt(5.0 - 0.6**2)  # y has 0.6 along x
    assert R[0] == pytest.approx([5e8, 0.0, 1e-2, 0.6e-7, 5.6], rel=1e-12)
    assert R[3, 3:] == pytest.approx([across * 1e-7, across], rel=1e-12)
    assert not R[1:3].any()
    assert not R[4].any()


# -- blocks --------------------------------------------------------------------


def ten_blocks(kind="gram"):
    """Force 2 is unknown in the third block."""
    columns = random_columns()
    columns.F[100:150, 1] = np.nan
    sums = ProductSums(LAYOUT, GROUPS, MASSES, kind)
    return sums.add_each(enumerate(columns.blocks(50))).grams()


def assert_weighted(sums, weights):
    """The sums of samples that are each taken so many times."""
    columns = random_columns()
    squares = sums.squares().matrices
    for group in GROUPS:
        A = columns.of_group(LAYOUT, group)
        w = np.repeat(np.asarray(weights, dtype=float), 50)
        if 2 in group.dofs:
            w[100:150] = 0.0
        assert_products(squares[group.dofs], A.T @ (w[:, None] * A))


WEIGHTS = st.lists(st.sampled_from([0.0, 0.25, 1.0, 3.0]), min_size=10, max_size=10)


@KINDS
@given(weights=WEIGHTS.filter(lambda w: sum(w[3:]) > 0))
def test_weighted_sums_are_those_of_weighted_samples(kind, weights):
    grams = ten_blocks(kind)
    assert_weighted(grams.sum(weights), weights)
    several = grams.sum([weights, np.ones(10)])
    assert several.shape == (2,)
    assert_weighted(several[0], weights)
    assert_weighted(several[1], np.ones(10))


@KINDS
def test_sums_without_each_block_are_those_of_the_other_samples(kind):
    rest = ten_blocks(kind).leave_one_out()
    assert rest.shape == (10,)
    for i in range(10):
        assert_weighted(rest[i], 1.0 - np.eye(10)[i])
        assert rest.sizes[2, 3][i] == 450 - 50 * (i != 2)


def test_a_term_that_moves_in_one_block_only_is_exactly_zero_without_it():
    """Differences of totals would leave round-off, which a solve takes for motion."""
    layout = Layout(Chain(1), {"storey 1": 1})
    s, a, F = np.random.default_rng(0).normal(size=(3, 400, 1))
    s[:100] = s[200:] = 0.0
    sums = ProductSums(layout, [layout.group((1,))])
    grams = sums.add_each(enumerate(blocks_of(s, a, F, 100))).grams()
    moves = grams.leave_one_out().matrices[(1,)][:, 0].any(axis=1)
    assert moves.tolist() == [True, False, True, True]


@KINDS
def test_blocks_on_disk_are_the_same_to_the_last_bit(kind, tmp_path):
    grams = ten_blocks(kind)
    path = tmp_path / "grams.npz"
    np.savez(path, **grams.to_arrays())
    with np.load(path, allow_pickle=False) as file:
        again = NormalEquations.from_arrays(dict(file), LAYOUT, GROUPS, MASSES)
    assert (again.kind, again.shape) == (kind, (10,))
    assert np.array_equal(again.n_samples, grams.n_samples)
    for dofs, matrix in grams.matrices.items():
        assert np.array_equal(again.matrices[dofs], matrix)
        assert np.array_equal(again.sizes[dofs], grams.sizes[dofs])


@KINDS
@pytest.mark.parametrize("several", [False, True], ids=["some columns", "combinations"])
def test_other_columns_of_the_same_samples(kind, several):
    """Orders of a power series are some of its columns; a change of basis combines."""
    matrix = np.eye(9)[:, [0, 3, 7, 8]]
    change = np.array([0, 3, 7, 8])
    if several:
        matrix = change = np.random.default_rng(1).normal(size=(9, 4))
    grams = ten_blocks()
    chosen = grams.roots() if kind == "root" else grams
    products = chosen.transformed(LAYOUT, {GROUPS[0]: change}).squares().matrices[(1,)]
    expected = matrix.T @ grams.matrices[(1,)] @ matrix
    assert np.allclose(products, expected, rtol=1e-8)


def test_columns_projected_on_instruments_are_those_of_the_projector():
    """P_Z X by an orthonormal basis of Z."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(300, 9))
    Z = X[:, :8] + rng.normal(size=(300, 8))
    both = np.hstack([X, Z])
    grams = NormalEquations(
        LAYOUT,
        groups={(1,): GROUPS[0]},
        matrices={(1,): both.T @ both},
        sizes={(1,): 300.0},
        n_samples=300.0,
        known_masses={},
        instrumented=True,
    )
    Q = np.linalg.qr(Z)[0]
    products = grams.projected().squares().matrices[(1,)]
    assert np.allclose(products, X.T @ Q @ Q.T @ X, atol=1e-9)


# -- pieces of records ---------------------------------------------------------


@pytest.fixture(scope="module")
def two_records():
    rng = np.random.default_rng(2)
    X, F = rng.normal(size=(900, 6)), rng.normal(size=(900, 2))
    return from_arrays(X, F, record=np.repeat([1, 2], [600, 300]), dt=1e-3)


SERIES = LawLayout(Chain(2), {i: [laws.PowerSeries(2)] for i in (1, 2)})
SINGLES = [SERIES.group((1,)), SERIES.group((2,))]


def test_pieces_sum_up_to_the_records(two_records):
    pieces = pieces_of(two_records, SERIES, SINGLES, [None, None], {})
    blocks = []
    for segment in two_records.segments:
        blocks.extend(blocks_of_segment(segment, SERIES))
    assert_same(pieces.sum(), total_products(SERIES, SINGLES, blocks))
    assert pieces.n_samples.sum() == 900
    # the least whole length that makes at most 64 pieces is 15 samples
    assert np.bincount(pieces.record).tolist() == [40, 20]


def test_the_record_itself_as_its_instruments_changes_no_solution(two_records):
    """Two-stage least squares on the columns themselves is least squares."""
    runs = two_records.segments
    pieces = pieces_of(two_records, SERIES, SINGLES, [None, None], {}, runs=runs)
    projected = pieces.sum().projected().squares().matrices[(1,)]
    plain = pieces_of(two_records, SERIES, SINGLES, [None, None], {}).sum()
    expected = plain.matrices[(1,)]
    assert np.allclose(projected[:-1], expected[:-1], rtol=1e-9)


def test_a_record_without_a_run_is_left_out(two_records):
    runs = [None, two_records.segments[1]]
    pieces = pieces_of(two_records, SERIES, SINGLES, [None, None], {}, runs=runs)
    assert set(pieces.record) == {1}
    assert pieces.n_samples.sum() == 300


def test_pieces_end_where_edges_are_given(two_records):
    edges = [np.array([0, 100, 600]), np.array([0, 300])]
    pieces = pieces_of(two_records, SERIES, SINGLES, [None, None], {}, edges=edges)
    assert pieces.n_samples.tolist() == [100, 500, 300]
    assert pieces.record.tolist() == [0, 0, 1]
