"""Moments: small matrices that hold all that least squares needs, and add."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import Chain, laws
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.regression.input_arrays import from_arrays
from pysindy_nrf.regression.layout import LawLayout, Layout
from pysindy_nrf.regression.moments import GroupMoments, Moments, accumulate, blocks_of, guess_of

LAYOUT = Layout(Chain(3, ["link 3-1"]), {"storey 1": 2, "storey 2": 3, "storey 3": 1, "link 3-1": 2})
GROUPS = [LAYOUT.group((j,)) for j in (1, 2, 3)] + [LAYOUT.group((2, 3))]
MASSES = {2: 3.0, 3: 5.0}


def _data(size=500, seed=0):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-5, 5, LAYOUT.n_terms)
    return rng.normal(size=(size, LAYOUT.n_terms)) * scale, rng.normal(size=(size, 3)), rng.normal(size=(size, 3))


def _moments(data, kind="gram", size=64):
    return accumulate(Moments(LAYOUT, GROUPS, kind, MASSES), blocks_of(*data, size))


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
def test_moments_are_those_of_the_columns(kind, dofs):
    data = _data()
    part = _moments(data, kind).parts[dofs]
    columns = _columns(data, dofs)
    gram = part.matrix if kind == "gram" else part.matrix.T @ part.matrix
    size = np.linalg.norm(columns, axis=0)
    assert np.allclose(gram / np.outer(size, size), columns.T @ columns / np.outer(size, size), atol=1e-12)
    assert part.n_samples == len(columns)
    combine = np.random.default_rng(1).normal(size=(columns.shape[1], 4)) / size[:, None]
    triangle = part.triangle(combine)
    assert np.allclose(triangle, np.triu(triangle))
    assert np.allclose(np.abs(triangle), np.abs(np.linalg.qr(columns @ combine, mode="r")), atol=1e-9)
    assert part.norms(combine) == pytest.approx(np.linalg.norm(columns @ combine, axis=0), rel=1e-10)


@pytest.mark.parametrize("kind", ["gram", "root"])
@given(cuts=st.lists(st.integers(1, 499), max_size=3, unique=True), size=st.integers(1, 700))
def test_chunks_add(kind, cuts, size):
    data = _data()
    whole = _moments(data, kind)
    edges = [0, *sorted(cuts), 500]
    pooled = None
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        part = _moments([d[low:high] for d in data], kind, size)
        pooled = part if pooled is None else pooled.merge(part)
    assert pooled.n_samples == whole.n_samples
    for dofs, part in whole.parts.items():
        other = pooled.parts[dofs]
        a, b = (m.matrix if kind == "gram" else m.matrix.T @ m.matrix for m in (part, other))
        size_ = np.sqrt(np.diag(a))
        assert np.allclose(a / np.outer(size_, size_), b / np.outer(size_, size_), atol=1e-12)
        assert other.n_samples == part.n_samples


def test_an_unknown_force_leaves_its_balance_out_of_a_record():
    known, lost = _data(seed=1), _data(seed=2)
    lost[2][:, 1] = np.nan
    pooled = _moments(known).merge(_moments(lost))
    assert {dofs: part.n_samples for dofs, part in pooled.parts.items()} == {(1,): 1000, (2,): 500, (3,): 1000, (2, 3): 500}
    assert np.array_equal(pooled.parts[(2,)].matrix, _moments(known).parts[(2,)].matrix)
    assert all(np.isfinite(part.matrix).all() for part in pooled.parts.values())


def test_columns_ten_orders_apart_keep_their_digits():
    """Gram matrices are scaled after accumulation: the small column is found to round-off."""
    rng = np.random.default_rng(0)
    layout = Layout(Chain(1), {"storey 1": 2})
    a, s = rng.normal(size=(2, 4000, 1))
    terms = np.column_stack([1e-3 * s, 1e-9 * s**3])
    F = 7 * a + terms @ np.array([[2e5], [3e11]])
    part = accumulate(Moments(layout, [layout.group((1,))]), blocks_of(terms, a, F)).parts[(1,)]
    R = part.triangle(np.eye(4))
    assert np.linalg.solve(R[:3, :3], R[:3, 3]) == pytest.approx([2e5, 3e11, 7.0], rel=1e-12)


def test_a_dependent_column_gets_a_pivot_of_zero_not_noise():
    rng = np.random.default_rng(0)
    layout = Layout(Chain(1), {"storey 1": 2})
    a, s = rng.normal(size=(2, 4000, 1))
    part = accumulate(Moments(layout, [layout.group((1,))]), blocks_of(np.column_stack([s, -3 * s]), a, a)).parts[(1,)]
    R = part.triangle(np.eye(4))
    assert abs(R[1, 1]) < 1e-6 * abs(R[0, 1])
    assert np.allclose(R.T @ R, part.matrix, rtol=1e-12, atol=1e-9 * np.abs(part.matrix).max())


def test_one_gram_matrix_of_all_columns_serves_every_balance():
    data = _data()
    full = np.hstack(data)
    cut = Moments.from_gram(LAYOUT, GROUPS, lambda dofs: (full.T @ full, len(full)), MASSES)
    for dofs, part in _moments(data).parts.items():
        size = np.sqrt(np.diag(part.matrix))
        assert np.allclose((cut.parts[dofs].matrix - part.matrix) / np.outer(size, size), 0, atol=1e-12)


def test_moments_of_other_columns_do_not_add():
    with pytest.raises(NRFError, match="cannot be added"):
        _moments(_data()).merge(Moments(LAYOUT, GROUPS[:1]))
    with pytest.raises(NRFError, match="cannot be added"):
        _moments(_data()).merge(_moments(_data(), "root"))


@given(counts=st.lists(st.integers(0, 14), min_size=4, max_size=4), size=st.integers(1, 600), seed=st.integers(0, 99))
def test_any_number_of_terms_anywhere_gives_the_gram_matrix(counts, size, seed):
    """Tiles of three by three, and whatever is left over: storeys, a brace and a DOF's own terms, sums of balances."""
    chain = Chain(3, ["link 3-1"])
    layout = Layout(chain, dict(zip(["storey 1", "storey 2", "storey 3", "link 3-1"], counts)) | {"dof 2": 1})
    groups = [layout.group(dofs) for dofs in ((1,), (2,), (3,), (3, 2), (1, 2, 3))]
    masses = {1: 2.0, 2: 3.0, 3: 5.0}
    rng = np.random.default_rng(seed)
    terms, a, F = (rng.normal(size=(size, k)) for k in (layout.n_terms, 3, 3))
    found = accumulate(Moments(layout, groups, "gram", masses), blocks_of(terms, a, F, 257))
    for group in groups:
        own = [terms[:, layout.slices[s]] for s in group.sites]
        j = [d - 1 for d in group.dofs]
        if len(j) == 1:
            own += [a[:, j], F[:, j]]
        else:
            own.append((F[:, j] - a[:, j] * [masses[d] for d in group.dofs]).sum(axis=1)[:, None])
        columns = np.hstack(own)
        assert np.allclose(found.parts[group.dofs].matrix, columns.T @ columns, rtol=1e-12, atol=1e-11)


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
    moments = Moments(layout, [layout.group((j,)) for j in (1, 2, 3)])
    for block in segment.blocks(layout, 700, states={}):
        moments.add(block)
    whole = slice(0, 5000)
    for (j,), part in moments.parts.items():
        own = [
            law.features(segment.motion(site, whole)) for site in moments.groups[(j,)].sites for law in layout.laws[site]
        ]
        columns = np.hstack([*own, X[:, [j - 1]].astype(float), F[:, [j - 1]].astype(float)])
        size = np.linalg.norm(columns, axis=0)
        assert np.allclose(part.matrix / np.outer(size, size), columns.T @ columns / np.outer(size, size), atol=1e-13)
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
    mix = np.linalg.qr(rng.normal(size=(p, p)))[0] * np.logspace(0, -np.log10(condition), p)
    columns = (mix @ rng.normal(size=(p, 4000))) * 10.0 ** rng.uniform(-8, 8, p)[:, None]
    gram, guessed, direct = GroupMoments(p), GroupMoments(p, "root"), GroupMoments(p, "root")
    gram.add(columns[:, :2000])  # half the samples are enough to guess
    guess = guess_of(gram)
    for low in range(0, 4000, 800):
        guessed.add_guessed(columns[:, low : low + 800], guess)
        direct.add(columns[:, low : low + 800])
    size = np.linalg.norm(columns, axis=1)
    R, truth = (np.linalg.qr(part.matrix / size, mode="r") for part in (guessed, direct))
    sign = np.sign(np.diag(R) * np.diag(truth))[:, None]
    assert np.allclose(R, sign * truth, atol=1e-14)


def test_the_user_may_pickle_and_merge_half_way():
    import pickle

    data = _data()
    first = _moments([d[:200] for d in data])
    both = pickle.loads(pickle.dumps(first)).merge(_moments([d[200:] for d in data]))
    for dofs, part in _moments(data).parts.items():
        size = np.sqrt(np.diag(part.matrix))
        assert np.allclose((both.parts[dofs].matrix - part.matrix) / np.outer(size, size), 0, atol=1e-13)
