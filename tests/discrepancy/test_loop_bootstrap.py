"""Records of the bootstrap are those of the model with the noise of the channels."""

import numpy as np
import pytest
from loop_parts import first_state, refitted_to_a_draw, start_of
from simulated_cases import Plan

from pysindy_nrf import ChainModel, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise


def test_a_fit_to_them_finds_the_model_again():
    state = first_state(Plan(2, (1, 2), noise=0.02, seed=73))
    again = refitted_to_a_draw(state)
    assert again.error == pytest.approx(state.model.error, rel=0.3)
    assert again.masses[0] == pytest.approx(state.model.masses[0], rel=0.02)


def test_they_leave_as_much_in_every_band_also_near_a_quarter_of_the_rate():
    """A wrong hold of the force between samples leaves 50 times as much there."""
    truth = ChainModel([2.0], {1: [laws.LinearElastic(2e5), laws.LinearViscous(100.0)]})
    F = excitation.band_limited_random(
        1, 8.0, 500.0, excited=1, rms=100.0, band=(1, 120), random_state=5
    )
    exact = simulate(truth, F, 1 / 500, hold="cubic")
    exact = exact.replace(acceleration=None, velocity=None)
    state = start_of(add_noise(exact, 5e-4, random_state=1)).first

    ratio = refitted_to_a_draw(state).powers.shares / state.model.powers.shares
    assert state.model.spectra.band[1] > 75
    assert np.abs(np.log(ratio)).max() < 1
