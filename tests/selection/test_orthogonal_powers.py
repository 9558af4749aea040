"""The basis in which orders are selected: the same powers, without what makes them nearly dependent."""

import numpy as np
import pytest
from sklearn.model_selection import GridSearchCV, KFold

from pysindy_nrf import NRFRegressor, laws
from pysindy_nrf.laws.power_series import exponents_of
from pysindy_nrf.selection import select_order
from pysindy_nrf.selection.fold_moments import Monomials, OrthogonalPowers


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
