"""The basis in which orders are selected: the same powers, without what makes them nearly dependent."""

import numpy as np
import pytest
from sklearn.model_selection import GridSearchCV, KFold

from pysindy_nrf import ChainModel, NRFRegressor, laws
from pysindy_nrf.laws.power_series import exponents_of
from pysindy_nrf.mechanics.chain import Chain
from pysindy_nrf.regression.layout import LawLayout
from pysindy_nrf.selection import select_order
from pysindy_nrf.selection.fold_moments import Monomials, OrthogonalPowers, Polynomials


def test_polynomials_on_chebyshev_nodes_are_those_of_their_weight_times_x2():
    """Gauss-Chebyshev nodes weigh alike, so sums over them are the integrals: E[x^2] = 1/2, E[x^4] = 3/8."""
    nodes = np.cos(np.pi * (np.arange(64) + 0.5) / 64)
    p = Polynomials(nodes, 7)(nodes)[1:]
    size = np.linalg.norm(p, axis=1)
    assert np.allclose(p @ p.T / np.outer(size, size), np.eye(7), atol=1e-12)
    y = np.array([0.0, 1.0, 2.0])
    assert np.allclose(Polynomials(nodes, 3)(y / 2**0.5)[3], y**3 - (3 / 8) / (1 / 2) ** 2 * y)


@pytest.mark.parametrize("order", [1, 2, 7, (1, 5), (0, 3), (4, 0)])
@pytest.mark.parametrize("motion", ["random", "offset", "steady", "at rest", "few values"])
def test_products_times_the_change_are_the_powers(order, motion):
    rng = np.random.default_rng(0)
    t = np.arange(500.0)
    v, s = {
        "random": (0.1 * rng.standard_normal(500), 1e-3 * rng.standard_normal(500)),
        "offset": (0.1 * rng.standard_normal(500), 1e-3 * (rng.standard_normal(500) + 4)),
        "steady": (np.cos(0.3 * t), np.sin(0.3 * t)),
        "at rest": (np.zeros(500), rng.standard_normal(500)),
        "few values": (np.sign(rng.standard_normal(500)), 3.0 + 0 * t),
    }[motion]
    exponents = exponents_of(order)
    law, whole = OrthogonalPowers(exponents, v[::3], s[::3]), laws.Motion(s, v)
    wanted = np.array([v**h * s**j for h, j in exponents]).T
    size = np.maximum(np.linalg.norm(wanted, axis=0), 1e-300)
    assert np.abs((law.features(whole) @ law.change - wanted) / size).max() < 1e-12
    assert np.allclose(Monomials(exponents).features(whole), wanted, rtol=1e-13)


def test_columns_made_from_factors_are_the_features():
    """What the pass multiplies in cache is what the law says of itself, beside another law at the same storey."""
    rng = np.random.default_rng(1)
    v, s, a = 0.1 * rng.standard_normal((300, 3)), 1e-3 * rng.standard_normal((300, 3)), rng.standard_normal((300, 3))
    held = {
        f"storey {i}": (OrthogonalPowers(exponents_of(4), v[::2, i - 1], s[::2, i - 1]), laws.CoulombFriction()) for i in (1, 3)
    }
    layout = LawLayout(Chain(3), {**held, "storey 2": (laws.PowerSeries(2),)})
    bare = ChainModel([1.0] * 3, {f"storey {i}": laws.LinearElastic(1.0) for i in (1, 2, 3)})
    segment = bare.segments(np.hstack([a, v, s]), np.zeros((300, 3))).segments[0]
    block = next(iter(segment.blocks(layout)))
    assert block.recipe is not None and block.source.shape[0] < layout.n_terms + 6  # fewer rows than columns
    for site in layout.acting:
        motion = segment.motion(site, slice(0, 300))
        columns = np.hstack([law.features(motion) for law in layout.laws[site]])
        assert np.allclose(block.terms[layout.slices[site]].T, columns, rtol=1e-13)


def test_a_steady_vibration_is_made_orthogonal_altogether_and_keeps_its_scores():
    """v^2 + (w s)^2 = const: products of polynomials depend on each other, and the scores must not suffer."""
    t, rng = np.arange(6000) * 1e-3, np.random.default_rng(0)
    phase = 40 * t[:, None] + np.arange(2)
    v = np.cos(phase) + 0.003 * rng.standard_normal((6000, 2))
    s = (np.sin(phase) + 0.003 * rng.standard_normal((6000, 2))) / 40
    a = 40 * rng.standard_normal((6000, 2))
    R = 1e4 * s + 30 * v + 4e6 * s**3
    F = np.array([10.0, 12.0]) * a + R - np.column_stack([R[:, 1], np.zeros(6000)])
    X, F = np.hstack([a, v, s]), F + 0.1 * F.std() * rng.standard_normal(F.shape)
    orders = (1, 3, 6)
    slow = GridSearchCV(NRFRegressor(), {"degree": orders}, cv=KFold(4)).fit(X, F)
    fast = select_order(X, F, degrees=orders, cv=KFold(4), scoring="acceleration")
    wanted = np.column_stack([slow.cv_results_[f"split{i}_test_score"] for i in range(4)])
    assert wanted[1].min() > 0.8 and np.abs(fast.fold_scores.to_numpy() - wanted)[:2].max() < 1e-9
    assert wanted[2].max() < 0  # six powers of a steady vibration are beyond any arithmetic, and chosen by nobody
