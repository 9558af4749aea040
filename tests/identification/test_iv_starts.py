"""Instrumental variables where start, band or integrator is the weak point."""

import warnings

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.identification import with_decaying_modes
from pysindy_nrf.simulation import add_noise

pytestmark = [
    pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.DataQualityWarning"),
    pytest.mark.slow,
]


def chain(masses, stiffnesses, dampings):
    storeys = {}
    for i, (k, c) in enumerate(zip(stiffnesses, dampings), 1):
        storeys[i] = laws.PowerSeries(1, [c, k])
    return ChainModel(masses, storeys)


# modes at 5.4, 13.5 and 19.3 Hz
THREE = chain([12.0, 10.0, 8.0], [6e4, 5e4, 4e4], [30.0, 25.0, 20.0])


def pushed(model, seconds, fs, band, rms=60.0, seed=1, dof=3):
    return driven(model, [dof], seconds, fs, rms, band, seed=seed, hold="cubic")


def fit_by_instruments(record, estimation="iv", **settings):
    """A fit that gives no warning, and does not fall back on least squares."""
    with warnings.catch_warnings(action="error", category=BiasWarning):
        model = NRFRegressor(degree=1, estimation=estimation, **settings).fit(record)
    assert model.model_.info["estimation"]["found"] != "ls"
    return model


def worst_mass(model, truth):
    return np.abs(model.masses_ / truth.masses - 1).max()


@pytest.fixture(scope="module")
def accelerations_of_shaken_frame():
    fs = 200.0
    ground = excitation.band_limited_random(
        1, 30.0, fs, excited=[1], rms=2.0, band=(0.5, 20), random_state=2
    )
    record = simulate(THREE, None, 1 / fs, base_acceleration=ground[:, 0], hold="cubic")
    record = record.replace(velocity=None, displacement=None)
    return add_noise(record, 0.01, random_state=3)


def test_accelerometers_alone_of_a_shaken_frame_give_its_masses(
    accelerations_of_shaken_frame,
):
    model = fit_by_instruments(accelerations_of_shaken_frame, known_masses={1: 12.0})

    assert worst_mass(model, THREE) < 1e-3
    assert model.model_.info["estimation"]["correlation"] > 0.999


def test_the_base_is_filtered_to_the_band_of_the_fused_motion(
    accelerations_of_shaken_frame,
):
    """The base below the band, where the floors hold nothing, must drive no run."""
    (segment,) = THREE.segments(accelerations_of_shaken_frame).segments
    low, high = segment.band

    assert 1.0 < low < 5.4  # Hz; below the lowest mode
    assert high is None
    window = np.hanning(segment.n_valid)
    power = np.abs(np.fft.rfft(segment.ag[segment.valid] * window)) ** 2
    f = np.fft.rfftfreq(segment.n_valid, segment.step)
    # the base moves from 0.5 Hz on
    assert power[f < low / 2].sum() < 1e-6 * power.sum()


def test_output_error_at_a_low_sampling_rate_holds_the_truth_in_its_intervals():
    record = pushed(THREE, 40.0, 200.0, (0.5, 20), seed=3)
    noisy = add_noise(record, 0.01, random_state=100).replace(velocity=None)
    model = fit_by_instruments(noisy, estimation="simulation")

    intervals = model.confidence_intervals(0.95).set_index("parameter")
    error = (intervals["upper"] - intervals["lower"]) / 3.92
    true = {"m1": 12.0, "m2": 10.0, "m3": 8.0}
    true |= {"storey 1: v": 30.0, "storey 2: v": 25.0, "storey 3: v": 20.0}
    for name, value in true.items():
        assert abs(intervals.estimate[name] - value) < 4 * error[name], name


@pytest.mark.parametrize("offsets", [(0.5, -0.3, 0.4), (0.0, 2.0, 0.0)])
def test_displacements_with_a_wrong_zero_still_start_the_instruments(offsets):
    """A constant is no motion: it stands beside the laws, and in the quality."""
    record = add_noise(pushed(THREE, 20.0, 500.0, (2, 40)), 0.02, random_state=5)
    x = record.displacement
    shifted = x + np.array(offsets) * x.std(axis=0)
    record = record.replace(displacement=shifted, velocity=None)

    model = NRFRegressor(degree=1, estimation="iv").fit(record)

    assert worst_mass(model, THREE) < 3e-3
    assert model.model_.info["estimation"]["found"] == "iv"
    assert "offset" in [note.kind for note in model.result_.data.quality]


def test_velocities_alone_start_in_the_band_of_the_motion():
    truth = chain(THREE.masses, [24e4, 20e4, 16e4], [60.0, 50.0, 40.0])
    record = add_noise(pushed(truth, 10.0, 1000.0, (4, 60)), 0.06, random_state=105)
    record = record.replace(acceleration=None, displacement=None)

    assert worst_mass(fit_by_instruments(record), truth) < 0.01


# damping ratios of 0.1 to 0.5 %, of which an estimate may be negative
LIGHT = chain([0.35, 0.9, 0.12], [9e4, 4e4, 2.5e4], [1.2, 0.8, 0.3])


def test_instruments_do_not_grow():
    growing = chain([0.35, 0.9, 0.12], [9e4, 4e4, 2.5e4], [1.2, -3.0, 0.3])
    assert (growing.modes()["damping"] < 0).any()

    damped = with_decaying_modes(growing).modes()

    assert (damped["damping"] > 0.9e-3).all()
    frequencies = LIGHT.modes()["frequency"]
    np.testing.assert_allclose(damped["frequency"], frequencies, rtol=1e-3)


def test_a_model_whose_modes_decay_is_its_own_instrument():
    assert with_decaying_modes(LIGHT) is LIGHT


def test_a_frame_with_hardly_any_damping_is_fitted():
    record = pushed(LIGHT, 3.0, 5000.0, (5, 400), rms=8.0, seed=2, dof=1)
    noisy = add_noise(record, 0.08, random_state=101)

    assert worst_mass(fit_by_instruments(noisy), LIGHT) < 5e-3
