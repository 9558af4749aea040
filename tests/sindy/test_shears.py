"""Plain SINDy on the shears of storeys."""

import chains
import numpy as np
import pysindy as ps
import pytest
from chains import worst

from pysindy_nrf.exceptions import ExcitationError, IdentifiabilityError
from pysindy_nrf.sindy import ShearSINDy, storey_shears

TRUE = ["v", "s", "s^3"]


@pytest.mark.parametrize("forced", [[3], [2], [1], [1, 2, 3]], ids=str)
def test_all_masses_and_terms_from_any_forced_floor(forced):
    case = chains.duffing(3, forced, seed=4, n_samples=2000)
    model = ShearSINDy(optimizer=ps.STLSQ(threshold=0.003, alpha=1e-10))
    model.fit(case.X, case.F)
    assert worst(model.masses_, case.m) < 1e-5
    for i, force in enumerate(model.model_.restoring_forces.values()):
        terms = force.coefficients[force.coefficients != 0]
        assert terms.index.tolist() == TRUE
        assert terms["s"] == pytest.approx(case.k[i], rel=1e-5)


def test_a_shear_is_what_newton_says_of_all_above():
    case = chains.duffing(3, [3], seed=4, n_samples=500)
    second = storey_shears(case.X, case.F, degree=3)[1]
    values = dict.fromkeys(second.names, 0.0)
    values |= {"a2": case.m[1], "a3": case.m[2]}
    values |= {"v2": case.c[1], "s2": case.k[1], "s2^3": case.k3[1]}
    shear = second.features @ np.array(list(values.values()))
    assert np.allclose(shear, second.target, atol=1e-8 * np.abs(second.target).max())


def test_what_cannot_be_is_named():
    case = chains.duffing(2, [2], seed=4, n_samples=500)
    with pytest.raises(ExcitationError, match="nothing scales"):
        ShearSINDy().fit(case.X, 0 * case.F)
    unknown = case.F.copy()
    unknown[:, 0] = np.nan
    with pytest.raises(ExcitationError, match="one is not known"):
        storey_shears(case.X, unknown)
    with pytest.raises(IdentifiabilityError, match="dropped the mass"):
        ShearSINDy(optimizer=ps.STLSQ(threshold=1e3)).fit(case.X, case.F)
