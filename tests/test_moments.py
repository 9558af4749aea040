"""Moments: small matrices that hold all that least squares needs, and add."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import Chain
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.layout import Layout
from pysindy_nrf.moments import Moments, accumulate, blocks_of

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
