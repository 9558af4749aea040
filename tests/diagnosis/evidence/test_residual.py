"""The residual is the missing force with its sign, in the band and in one step."""

import numpy as np
import pytest
from chains import duffing, parameters

from pysindy_nrf import ChainModel, laws
from pysindy_nrf.diagnosis import residual_of
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import ZeroPhaseFilter, from_arrays

pytestmark = pytest.mark.slow

FS = 1000.0


def linear_laws(case, storey):
    """Dashpot and spring of one storey of a case."""
    damping, stiffness = case.c[storey - 1], case.k[storey - 1]
    return [laws.LinearViscous(damping), laws.LinearElastic(stiffness)]


def model_of(case):
    """The true model of a case."""
    storeys = {}
    for i in range(1, case.n + 1):
        storeys[i] = linear_laws(case, i)
        if case.k3[i - 1]:
            storeys[i].append(laws.CubicStiffness(case.k3[i - 1]))
    return ChainModel(case.m, storeys)


def data_of(case, F=None):
    F = case.F if F is None else F
    return from_arrays(case.X, F, dt=case.dt, base_acceleration=case.ag)


def test_missing_storey_force_has_opposite_signs_below_and_above():
    case = duffing(4, [1, 2, 3, 4], seed=1)
    model = model_of(case).with_laws({2: linear_laws(case, 2)})
    residual = residual_of(model, data_of(case))
    missing = case.k3[1] * case.s[:, 1] ** 3
    e, rho = residual.balance[0], residual.storey[0]

    tiny = 1e-9 * np.abs(case.F).max()
    assert np.allclose(e[:, 1], missing, atol=tiny)
    assert np.allclose(e[:, 0], -missing, atol=tiny)
    assert np.allclose(rho[:, 1], missing, atol=tiny)
    assert np.abs(rho[:, [0, 2, 3]]).max() < tiny
    assert np.abs(e[:, [2, 3]]).max() < tiny


def test_missing_brace_shows_in_every_cut_it_crosses():
    def brace(x, v):
        force = 2e4 * (x[..., 2] - x[..., 0])
        out = np.zeros_like(x)
        out[..., 2] = -force
        out[..., 0] = force
        return out

    linear = parameters(4, np.random.default_rng(3), cubic=False)
    case = duffing(4, [4], seed=3, parameters_of_chain=linear, extra=brace)
    rho = residual_of(model_of(case), data_of(case)).storey[0]
    force = 2e4 * (case.s[:, 1] + case.s[:, 2])
    assert np.allclose(rho[:, 1], force, atol=1e-7)
    assert np.allclose(rho[:, 2], force, atol=1e-7)
    assert np.abs(rho[:, [0, 3]]).max() < 1e-7


@pytest.fixture
def second_force_unknown():
    """A case of three floors, and its forces without that on the second."""
    case = duffing(3, [1, 2, 3], seed=2)
    F = case.F.copy()
    F[:, 1] = np.nan
    return case, F


def test_unknown_force_masks_its_balance_and_the_cuts_below(second_force_unknown):
    case, F = second_force_unknown
    residual = residual_of(model_of(case), data_of(case, F))
    assert residual.known.tolist() == [[True, False, True]]
    assert np.isnan(residual.balance[0][:, 1]).all()
    assert np.isnan(residual.storey[0][:, :2]).all()
    assert np.isfinite(residual.storey[0][:, 2]).all()
    first = residual.sizes.loc["dof 1"]
    assert first["rms"] < 1e-9 * first["reference"]


def test_a_residual_without_any_force_is_refused(second_force_unknown):
    case, F = second_force_unknown
    with pytest.raises(ChannelError, match="unknown on every DOF"):
        residual_of(model_of(case), data_of(case, F * np.nan))


def test_band_is_the_same_filter_on_the_sum():
    case = duffing(2, [1, 2], seed=5)
    model = model_of(case).with_laws({1: [laws.LinearElastic(case.k[0])]})
    band = ZeroPhaseFilter((2.0, 30.0), FS)
    inside = residual_of(model, data_of(case), [band])
    missing = case.c[0] * case.v[:, 0] + case.k3[0] * case.s[:, 0] ** 3
    tiny = 1e-8 * np.abs(missing).max()
    assert np.allclose(inside.balance[0][:, 0], band.apply(missing), atol=tiny)

    rms = np.sqrt(np.mean(band.apply(case.F[:, 0]) ** 2))
    assert inside.sizes.loc["dof 1", "reference"] == pytest.approx(rms)


def test_unforced_balance_is_measured_by_its_inertia():
    case = duffing(2, [2], seed=6)
    heavier = ChainModel(case.m * [1.1, 1.0], model_of(case).laws)
    sizes = residual_of(heavier, data_of(case)).sizes
    assert list(sizes["of"]) == ["m a", "F", "storey force", "storey force"]
    assert sizes.loc["dof 1", "percent"] == pytest.approx(100 * 0.1 / 1.1, rel=1e-9)
