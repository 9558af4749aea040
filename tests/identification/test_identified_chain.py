"""Forces, energies, planarity and agreement of identified chains."""

import warnings

import numpy as np
import pytest
from paper_cases import energy_shares, found_twice, model_agreement
from planarity import locate_nonlinearity, planarity
from three_floors import chain, features, noisy, run

from pysindy_nrf import ChainModel, NRFRegressor, laws
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.identification import damper_force, dissipated_energy, linear_part

# Of every floor of the linear chain.
MASS = 10.0
DAMPING = 60.0
STIFFNESS = 5e4


@pytest.fixture(scope="module")
def linear():
    """Motions and forces of the linear chain, forced on its top floor."""
    return features(run(chain(), [3]))


@pytest.fixture(scope="module")
def all_forced():
    return features(run(chain(), [1, 2, 3]))


def test_the_force_of_a_damper_is_what_the_bare_structure_lacks():
    X, F = features(run(chain((2, laws.CubicStiffness(2e8))), [3]))
    lacking = damper_force(NRFRegressor(degree=3).fit(X, F), chain(), X)
    assert np.allclose(lacking["storey 2"], 2e8 * X["s2"] ** 3, atol=1e-3)
    assert lacking[["storey 1", "storey 3"]].abs().max(axis=None) < 1e-3
    assert lacking.index.name == "t"


# -- energies ------------------------------------------------------------------------


def test_dissipated_energy_balances_the_work_of_the_force():
    simulated = run(chain(), [1, 2, 3])
    X, _ = features(simulated)
    velocity = simulated.record.velocity[-1]
    drift = X[["s1", "s2", "s3"]].to_numpy()[-1]
    kinetic = 0.5 * MASS * (velocity**2).sum()
    stored = 0.5 * STIFFNESS * (drift**2).sum()
    work = simulated.energy["input"].iloc[-1]
    lost = dissipated_energy(chain(), X).to_numpy()[-1].sum()
    assert lost == pytest.approx(work - kinetic - stored, rel=1e-3)


def shares_of_energy(structure, rms):
    X, F = features(run(structure, [3], rms))
    return energy_shares(NRFRegressor(degree=1).fit(X, F), X)["share"]


def test_energy_shares_depend_on_the_damage_and_not_on_the_level():
    quiet = shares_of_energy(chain(), 50.0)
    loud = shares_of_energy(chain(), 200.0)
    damped = shares_of_energy(chain((2, laws.LinearViscous(120.0))), 50.0)
    assert loud.to_numpy() == pytest.approx(quiet.to_numpy(), rel=1e-6)
    assert (damped - quiet).idxmax() == "storey 2"
    assert damped.sum() == pytest.approx(100.0)


# -- planarity -----------------------------------------------------------------------


def test_large_cubic_coefficients_at_small_drifts_are_planar():
    """The "linear" storeys of the paper carry 1e9 N/m^3."""
    quiet = run(chain((2, laws.CubicStiffness(1e9))), [1, 2, 3], rms=0.5)
    X, F = features(quiet)
    table = planarity(NRFRegressor(degree=3).fit(X, F), X, F, draws=0)
    assert table["planar"].all()
    assert table["reference"].isna().all()


def test_the_reference_covers_what_noise_does_to_a_planar_storey():
    inside = []
    for seed in range(2):
        X, F = noisy(run(chain(), [3], seed=seed), 0.1, seed)
        model = NRFRegressor(degree=3).fit(X, F)
        table = planarity(model, X, F, draws=6, random_state=0)
        inside.append((table["index"] < 2 * table["reference"]).to_numpy())
        assert (table["reference"] > 0.05).all(), "it is not nothing"
    assert np.mean(inside) > 0.7


@pytest.mark.parametrize(("storey", "dofs"), [(1, [3]), (2, [1, 2, 3]), (3, [3])])
def test_a_damper_is_located_wherever_it_sits(storey, dofs):
    X, F = features(run(chain((storey, laws.Dahl(sigma=2e4, Fd=25.0))), dofs))
    with warnings.catch_warnings(action="ignore"):
        model = NRFRegressor(degree=3).fit(X, F)
        location = locate_nonlinearity(model, X, F, draws=4, random_state=0)
    assert location.storeys == [f"storey {storey}"]
    assert location.estimator.masses_ == pytest.approx([MASS] * 3, rel=1e-3)
    assert str(location).startswith(f"The nonlinearity is in storey {storey};")


def test_a_linear_chain_has_no_nonlinear_storey():
    X, F = noisy(run(chain(), [3]), 0.02)
    model = NRFRegressor(degree=3).fit(X, F)
    location = locate_nonlinearity(model, X, F, draws=4, random_state=0)
    assert location.storeys == []
    assert str(location) == "Every storey is planar."


# -- agreement -----------------------------------------------------------------------


def test_agreement_of_models_in_percent(linear):
    X, _ = linear
    storey = laws.PowerSeries(1, [DAMPING, STIFFNESS])
    stiffer = laws.PowerSeries(1, [DAMPING, 1.1 * STIFFNESS])
    other = ChainModel([10.0, 11.0, 10.0], {1: storey, 2: stiffer, 3: storey})
    table = model_agreement(chain(), other, X)
    assert table["mass"].tolist() == pytest.approx([0, 10, 0])
    assert table["k"].tolist() == pytest.approx([0, 10, 0])
    assert table.loc["storey 1", "force"] == 0
    assert 8 < table.loc["storey 2", "force"] < 10.5


def test_forces_are_found_twice_where_all_floors_are_forced(all_forced):
    X, F = all_forced
    twice = found_twice(NRFRegressor(degree=1).fit(X, F), X, F)
    assert list(twice) == ["storey 2", "storey 3"]
    both = twice["storey 3"].loc["s"].to_list()
    assert both == pytest.approx([STIFFNESS, STIFFNESS])


def test_forces_are_not_found_twice_under_one_force(linear):
    X, F = linear
    model = NRFRegressor(degree=1).fit(X, F)
    with pytest.raises(ChainError, match="twice"):
        found_twice(model, X, F)


def test_models_of_other_structures_are_not_compared(chain2, chain4):
    small = NRFRegressor().fit(chain2.X, chain2.F)
    large = NRFRegressor().fit(chain4.X, chain4.F)
    with pytest.raises(ChainError, match="have 2 and 4 DOFs"):
        model_agreement(small, large, chain2.X)
    with pytest.raises(ChainError, match="str is not a chain model"):
        linear_part("a model")
    with pytest.raises(ChainError, match="the regressor that was fitted"):
        locate_nonlinearity(small.model_, chain2.X, chain2.F)
