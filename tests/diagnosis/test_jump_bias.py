"""Least squares does not lose a part of the friction in silence."""

import warnings

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, laws
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.simulation import add_noise

pytestmark = pytest.mark.slow

FORCE = 8.0  # N
FRICTION = laws.CoulombFriction(FORCE)
STEEP_DAMPING = laws.PowerLawDamping(0.4, cn=60.0)


def measured(friction=FRICTION, fs=500.0, noise=0.02):
    """Two floors, pushed on the top, with friction in storey 2."""
    storeys = {
        1: [laws.LinearElastic(7.2e4), laws.LinearViscous(139.0)],
        2: [laws.LinearElastic(1.9e5), laws.LinearViscous(440.0), friction],
    }
    truth = ChainModel([18.0, 29.0], storeys)
    record = driven(truth, 2, 16.0, fs, 200.0, (1, 60))
    return add_noise(record, noise, random_state=50) if noise else record


def fit(record, friction=FRICTION, estimation="ls", band=None):
    """A fit with all laws declared, and what it says of bias."""
    declared = {
        1: [laws.LinearElastic(), laws.LinearViscous()],
        2: [laws.LinearElastic(), laws.LinearViscous(), type(friction)()],
    }
    with warnings.catch_warnings(record=True, action="always") as caught:
        regressor = NRFRegressor(laws=declared, estimation=estimation, band=band)
        model = regressor.fit(record)
    messages = [str(w.message) for w in caught if issubclass(w.category, BiasWarning)]
    return model, messages


def friction_of(model):
    return model.model_.laws["storey 2"][2].values[0]


@pytest.mark.parametrize("noise", [0.005, 0.02, 0.05])
def test_a_friction_biased_by_noise_is_right_away_from_reversals(noise):
    model, messages = fit(measured(noise=noise))

    row = model.jump_bias_.loc["storey 2: sgn(v)"]
    assert row["found"] == friction_of(model) < 0.85 * FORCE
    assert row["away"] == pytest.approx(FORCE, rel=0.1)
    assert row["wrong"]
    assert row["lost"] == pytest.approx(1 - row["found"] / row["away"], abs=0.02)
    sizes = f"sgn(v) is {row['found']:.4g} N, but {row['away']:.4g} without"
    assert any(sizes in text for text in messages)


def test_a_friction_biased_by_noise_is_in_the_diagnosis():
    model, _ = fit(measured())

    row = model.diagnose().table.set_index("limit").loc["jump"]
    assert row["where"] == "storey 2: sgn(v)"
    assert "estimation='iv'" in row["message"]


def test_samples_too_far_apart_for_a_jump_are_warned_of_without_noise():
    model, messages = fit(measured(laws.CoulombFriction(30.0), fs=200.0, noise=0.0))

    assert model.jump_bias_["wrong"].all()
    assert any("sampling rate too low" in text for text in messages)


def test_samples_close_enough_for_a_jump_are_not_warned_of():
    model, messages = fit(measured(fs=2000.0, noise=0.0))

    table = model.jump_bias_
    assert table["away"].iloc[0] == pytest.approx(FORCE, rel=1e-3)
    assert not table["wrong"].any()
    assert not messages
    assert "jump" not in model.diagnose().table["limit"].tolist()


def test_laws_without_jumps_are_not_judged():
    damper = laws.QuadraticDamping(500.0)

    assert fit(measured(damper), damper)[0].jump_bias_.empty


def test_a_filter_spreads_jumps_which_are_not_judged():
    assert fit(measured(), band=(1.0, 80.0))[0].jump_bias_.empty


def test_instruments_lose_no_friction():
    model, messages = fit(measured(), estimation="iv")

    assert model.jump_bias_.empty
    assert not messages
    assert friction_of(model) == pytest.approx(FORCE, rel=0.05)


def test_a_friction_of_a_micronewton_is_nothing_to_warn_of():
    """Rounding in the coefficient of a friction that is not there may differ freely."""
    model, messages = fit(measured(laws.CoulombFriction(1e-6), fs=2000.0, noise=0.0))

    assert not messages
    assert not model.jump_bias_["wrong"].any()


def test_a_friction_of_a_ten_thousandth_of_the_force_is_negligible():
    model, _ = fit(measured(laws.CoulombFriction(0.02)))

    assert not model.jump_bias_["wrong"].any()


def test_each_direction_of_an_asymmetric_friction_is_judged_by_itself():
    friction = laws.asymmetric(laws.CoulombFriction)(10.0, 6.0)
    table = fit(measured(friction), friction)[0].jump_bias_

    assert len(table) == 2
    assert table["wrong"].all()
    assert np.allclose(table["away"], friction.values, rtol=0.15)


@pytest.mark.parametrize("damping", [laws.QuadraticDamping(400.0), STEEP_DAMPING])
def test_damping_does_not_jump_at_a_reversal(damping):
    model, _ = fit(measured(damping), damping)

    assert model.jump_bias_.empty
