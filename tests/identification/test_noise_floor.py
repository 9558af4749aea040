"""What a model leaves of each equation of motion, beside what noise would leave."""

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.diagnosis import Facts, FreeRunFacts, verdict_from
from pysindy_nrf.diagnosis.facts import LeftOver
from pysindy_nrf.diagnosis.residual import residual_of
from pysindy_nrf.simulation import add_noise

FS = 400.0
MASSES = [11.0, 9.0]
AMPLITUDE, FREQUENCY = 42.0, 17.0  # N and Hz of a force that nobody measured


def frame():
    storey = [laws.LinearElastic(4.5e4), laws.LinearViscous(40.0)]
    return ChainModel(MASSES, {1: storey, 2: storey})


def shaken(noise=0.01, unmeasured=0.0):
    F = excitation.band_limited_random(
        2, 20.0, FS, excited=[1, 2], rms=120.0, band=(0.5, 50.0), random_state=7
    )
    harmonic = unmeasured * np.sin(2 * np.pi * FREQUENCY * np.arange(len(F)) / FS)
    record = simulate(frame(), F + np.outer(harmonic, [0, 1]), 1 / FS, hold="cubic")
    measured = record.replace(force=F, velocity=None)
    return add_noise(measured, noise, random_state=7)


def grounds(fitted):
    return {(ground.kind, ground.place) for ground in fitted.verdict().grounds}


@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_a_right_model_leaves_what_noise_leaves(noise):
    fitted = NRFRegressor(degree=1).fit(shaken(noise))
    for left_over in fitted.result_.beside_noise.left_over.values():
        assert left_over.rms == pytest.approx(left_over.noise, rel=0.5)
    assert "residual" not in {kind for kind, _ in grounds(fitted)}


@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_noise_that_is_drawn_leaves_as_much_as_that_of_the_record(noise):
    result = NRFRegressor(degree=1).fit(shaken(noise)).result_
    left = residual_of(result.model, result.data)
    draws = [result.residual_of_noise(np.random.default_rng(seed)) for seed in (1, 2)]
    for drawn in draws:
        sizes = drawn.sizes["rms"].to_numpy()
        np.testing.assert_allclose(sizes, left.sizes["rms"], rtol=0.1)
    assert not np.allclose(draws[0].balance[0], draws[1].balance[0])


def test_a_harmonic_force_that_nobody_measured_is_missing():
    """Its rms is its amplitude over the root of two; the free run hardly feels it."""
    fitted = NRFRegressor(degree=1).fit(shaken(unmeasured=AMPLITUDE))
    left_over = fitted.result_.beside_noise.left_over[2]
    assert left_over.rms == pytest.approx(AMPLITUDE / np.sqrt(2), rel=0.15)
    assert left_over.rms > 5 * left_over.noise
    assert left_over.band[0] <= FREQUENCY <= left_over.band[1]
    assert fitted.verdict().state == "amber"
    assert ("residual", "dof 2") in grounds(fitted)


def test_a_noisy_equation_that_noise_explains_is_no_reason():
    """52 % of an equation is left, of which noise leaves 50 %."""
    facts = Facts(unexplained={1: 52.0}, free_run=FreeRunFacts(9.0))
    assert verdict_from(facts).state == "red"
    at_noise = Facts({1: 52.0}, beyond_noise={1: 0.0}, free_run=FreeRunFacts(9.0))
    assert verdict_from(at_noise).state == "green"


@pytest.mark.parametrize(
    ("rms", "percent", "state"),
    [(44.0, 22.0, "amber"), (44.0, 3.0, "green"), (5.0, 22.0, "green")],
)
def test_what_is_left_is_said_where_it_is_far_above_noise_and_felt(rms, percent, state):
    left_over = LeftOver(rms, 2.6, percent, (12.0, 25.0))
    assert verdict_from(Facts({1: 4.0}, left_over={1: left_over})).state == state


def test_one_blow_without_noise_has_intervals():
    F = np.zeros((6000, 2))
    width = 12
    F[60 : 60 + width, 1] = 500 * np.sin(np.pi * np.arange(width) / width) ** 2
    record = simulate(frame(), F, 1 / 2000, hold="cubic").replace(velocity=None)
    fitted = NRFRegressor(degree=1).fit(record)
    table = fitted.confidence_intervals(of="masses").set_index("parameter")
    assert (table["upper"] - table["lower"] < 0.02 * table["estimate"]).all()
    assert fitted.verdict().state == "green"
