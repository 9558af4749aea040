"""Least squares does not take a part of the friction in silence."""

import warnings

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, laws
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.laws.friction import jump_at_reversal
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.slow

FORCE = 8.0  # N


def fitted(fs=500.0, noise=0.02, estimation="ls", friction=None, band=None, storey=2):
    """Two floors with friction in one storey, and the warnings of a fit that knows of
    it.
    """
    held = {
        1: [laws.LinearElastic(7.2e4), laws.LinearViscous(139.0)],
        2: [laws.LinearElastic(1.9e5), laws.LinearViscous(440.0)],
    }
    held[storey].append(friction or laws.CoulombFriction(FORCE))
    record = driven(ChainModel([18.0, 29.0], held), 2, 16.0, fs, 200.0, (1, 60))
    told = {site: [type(law)() for law in group] for site, group in held.items()}
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = NRFRegressor(laws=told, estimation=estimation, band=band).fit(
            add_noise(record, noise, random_state=50) if noise else record
        )
    return model, [
        str(w.message) for w in caught if issubclass(w.category, BiasWarning)
    ]


@pytest.mark.parametrize("noise", [0.005, 0.02, 0.05])
def test_a_friction_biased_by_noise_is_warned_of_and_its_value_away_from_reversals_is_right(
    noise,
):
    model, said = fitted(noise=noise)
    row = model.jump_bias_.loc["storey 2: sgn(v)"]
    assert row["found"] == model.model_.laws["storey 2"][2].values[0] < 0.85 * FORCE
    assert row["away"] == pytest.approx(FORCE, rel=0.1) and row["wrong"]
    assert row["lost"] == pytest.approx(1 - row["found"] / row["away"], abs=0.02)
    assert any(
        f"sgn(v) is {row['found']:.4g} N, but {row['away']:.4g} without" in text
        for text in said
    )
    found = model.diagnose().table.set_index("limit")
    assert (
        found.loc["jump", "where"] == "storey 2: sgn(v)"
        and "estimation='iv'" in found.loc["jump", "message"]
    )


def test_jumps_between_samples_that_are_too_far_apart_are_warned_of_without_any_noise():
    model, said = fitted(noise=0.0, friction=laws.CoulombFriction(30.0))
    assert model.jump_bias_["wrong"].all() and any(
        "sampling rate too low" in text for text in said
    )


def test_samples_close_enough_and_laws_without_jumps_and_instruments_say_nothing():
    model, said = fitted(fs=2000.0, noise=0.0)
    assert (
        model.jump_bias_["away"].iloc[0] == pytest.approx(FORCE, rel=1e-3)
        and not model.jump_bias_["wrong"].any()
    )
    assert not said and "jump" not in model.diagnose().table["limit"].tolist()
    assert fitted(friction=laws.QuadraticDamping(500.0))[0].jump_bias_.empty
    assert fitted(band=(1.0, 80.0))[
        0
    ].jump_bias_.empty  # the filter spreads each jump: nothing is near a reversal alone
    model, said = fitted(estimation="iv")
    assert model.jump_bias_.empty and not said
    assert model.model_.laws["storey 2"][2].values[0] == pytest.approx(FORCE, rel=0.05)


def test_a_friction_of_micronewtons_is_nothing_to_warn_of():
    """A friction that is not there, on motions without noise: rounding in its
    coefficient differs by what it likes.
    """
    model, said = fitted(fs=2000.0, noise=0.0, friction=laws.CoulombFriction(1e-6))
    assert not said and not model.jump_bias_["wrong"].any()
    model, _ = fitted(noise=0.02, friction=laws.CoulombFriction(0.02))
    assert not model.jump_bias_["wrong"].any()  # 0.01 % of 200 N


def test_each_direction_of_an_asymmetric_friction_is_judged_by_itself():
    friction = laws.asymmetric(laws.CoulombFriction)(10.0, 6.0)
    model, _ = fitted(friction=friction)
    table = model.jump_bias_
    assert len(table) == 2 and table["wrong"].all()
    assert np.allclose(table["away"], friction.values, rtol=0.15)


def test_what_changes_jump_at_reversal():
    assert jump_at_reversal(laws.CoulombFriction(), []).tolist() == [[2.0, 2.0]]
    assert np.abs(jump_at_reversal(laws.LinearViscous(), [])).max() < 1e-8
    near, wide = jump_at_reversal(laws.PowerLawDamping(0.4), [])[0]
    assert abs(near) < 0.5 * abs(wide)  # steep, but not a jump
    held = laws.CovariateFriction()
    assert np.abs(jump_at_reversal(held, [3.0])).max(axis=0)[0] == pytest.approx(6.0)
