"""Forces, energies, planarity and agreement of identified chains."""

import warnings

import numpy as np
import pytest
from paper_cases import energy_shares, found_twice, model_agreement
from planarity import locate_nonlinearity, planarity
from three_floors import chain, features, noisy, run

from pysindy_nrf import ChainModel, NRFRegressor, laws
from pysindy_nrf.exceptions import BiasWarning, ChainError
from pysindy_nrf.identification import damper_force, dissipated_energy, linear_part


def test_damper_force_is_what_the_bare_structure_lacks():
    cubic = laws.CubicStiffness(2e8)
    result = run(chain((2, cubic)), [3])
    X, F = features(result)
    found = damper_force(NRFRegressor(degree=3).fit(X, F), chain(), X)
    assert np.allclose(found["storey 2"], 2e8 * X["s2"] ** 3, atol=1e-3)
    assert found[["storey 1", "storey 3"]].abs().max(axis=None) < 1e-3
    assert found.index.name == "t"


def test_dissipated_energy_balances_the_work_of_the_force():
    result = run(chain(), [1, 2, 3])
    X, _ = features(result)
    lost = dissipated_energy(chain(), X).to_numpy()[-1].sum()
    record = result.record
    kinetic = 0.5 * 10.0 * (record.velocity[-1] ** 2).sum()
    stored = 0.5 * 5e4 * (X[["s1", "s2", "s3"]].to_numpy()[-1] ** 2).sum()
    assert lost == pytest.approx(
        result.energy["input"].iloc[-1] - kinetic - stored, rel=1e-3
    )


def test_energy_shares_do_not_depend_on_the_level_but_on_the_damage():
    shares = []
    for rms, extra in (
        (50.0, ()),
        (200.0, ()),
        (50.0, ((2, laws.LinearViscous(120.0)),)),
    ):
        X, F = features(run(chain(*extra), [3], rms))
        shares.append(energy_shares(NRFRegressor(degree=1).fit(X, F), X)["share"])
    assert shares[1].to_numpy() == pytest.approx(shares[0].to_numpy(), rel=1e-6)
    assert (shares[2] - shares[0]).idxmax() == "storey 2"
    assert shares[2].sum() == pytest.approx(100.0)


def test_large_cubic_coefficients_at_small_drifts_are_planar():
    # the paper's "linear" storeys carry 1e9 N/m^3
    X, F = features(run(chain((2, laws.CubicStiffness(1e9))), [1, 2, 3], rms=0.5))
    table = planarity(NRFRegressor(degree=3).fit(X, F), X, F, draws=0)
    assert table["planar"].all() and table["reference"].isna().all()


def test_noise_reference_covers_what_noise_does_to_a_planar_storey():
    inside = []
    for seed in range(2):
        X, F = noisy(run(chain(), [3], seed=seed), 0.1, seed)
        table = planarity(
            NRFRegressor(degree=3).fit(X, F), X, F, draws=6, random_state=0
        )
        inside.append((table["index"] < 2 * table["reference"]).to_numpy())
        assert (table["reference"] > 0.05).all()  # it is not nothing
    assert np.mean(inside) > 0.7


@pytest.mark.parametrize(("storey", "dofs"), [(1, [3]), (2, [1, 2, 3]), (3, [3])])
def test_damper_located_wherever_it_sits(storey, dofs):
    X, F = features(run(chain((storey, laws.Dahl(sigma=2e4, Fd=25.0))), dofs))
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        model = NRFRegressor(degree=3).fit(X, F)
        location = locate_nonlinearity(model, X, F, draws=4, random_state=0)
    assert location.storeys == [f"storey {storey}"]
    assert location.estimator.masses_ == pytest.approx([10.0] * 3, rel=1e-3)
    assert str(location).startswith(f"The nonlinearity is in storey {storey};")


def test_linear_chain_has_no_nonlinear_storey():
    X, F = noisy(run(chain(), [3]), 0.02)
    location = locate_nonlinearity(
        NRFRegressor(degree=3).fit(X, F), X, F, draws=4, random_state=0
    )
    assert location.storeys == [] and str(location) == "Every storey is planar."


def test_model_agreement_in_percent():
    X, F = features(run(chain(), [3]))
    other = ChainModel(
        [10.0, 11.0, 10.0],
        {
            i: laws.PowerSeries(1, [60.0, 5e4 * (1.1 if i == 2 else 1)])
            for i in (1, 2, 3)
        },
    )
    table = model_agreement(chain(), other, X)
    assert table["mass"].tolist() == pytest.approx([0, 10, 0])
    assert table["k"].tolist() == pytest.approx([0, 10, 0])
    assert (
        table.loc["storey 1", "force"] == 0
        and 8 < table.loc["storey 2", "force"] < 10.5
    )


def test_found_twice_needs_complete_excitation():
    X, F = features(run(chain(), [1, 2, 3]))
    twice = found_twice(NRFRegressor(degree=1).fit(X, F), X, F)
    assert list(twice) == ["storey 2", "storey 3"]
    assert twice["storey 3"].loc["s"].to_list() == pytest.approx([5e4, 5e4])
    X, F = features(run(chain(), [3]))
    with pytest.raises(ChainError, match="twice"):
        found_twice(NRFRegressor(degree=1).fit(X, F), X, F)


def test_models_of_other_structures_are_not_compared(chain2, chain4):
    one, two = (NRFRegressor().fit(c.X, c.F) for c in (chain2, chain4))
    with pytest.raises(ChainError, match="have 2 and 4 DOFs"):
        model_agreement(one, two, chain2.X)
    with pytest.raises(ChainError, match="str is not a chain model"):
        linear_part("a model")
    with pytest.raises(ChainError, match="the regressor that was fitted to the data"):
        locate_nonlinearity(one.model_, chain2.X, chain2.F)
