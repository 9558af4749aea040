"""Instrumental variables where their start, their band or their integrator is the weak
point.
"""

import warnings

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.identification.free_runs import fits_one_step, simulated
from pysindy_nrf.identification.instruments import with_decaying_modes
from pysindy_nrf.simulation.noise import add_noise

pytestmark = [
    pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.DataQualityWarning"),
    pytest.mark.slow,
]


def chain(masses, stiffnesses, dampings):
    return ChainModel(
        masses,
        {
            i + 1: [laws.PowerSeries(1, [c, k])]
            for i, (k, c) in enumerate(zip(stiffnesses, dampings))
        },
    )


THREE = chain(
    [12.0, 10.0, 8.0], [6e4, 5e4, 4e4], [30.0, 25.0, 20.0]
)  # 5.4, 13.5 and 19.3 Hz


def top_forced(model, seconds, fs, band, rms=60.0, seed=1, dof=3):
    return driven(model, [dof], seconds, fs, rms, band, seed=seed, hold="cubic")


def fitted(record, **told):
    """A model by instrumental variables, of which no warning says that it is none."""
    with warnings.catch_warnings(action="error", category=BiasWarning):
        model = NRFRegressor(degree=1, **({"estimation": "iv"} | told)).fit(record)
    assert model.model_.info["estimation"]["found"] != "ls"
    return model


def off(model, truth):
    return np.abs(model.masses_ / truth.masses - 1).max()


def shaken(noise):
    fs = 200.0
    ag = excitation.band_limited_random(
        1, 30.0, fs, excited=[1], rms=2.0, band=(0.5, 20), random_state=2
    )
    ag = np.asarray(ag)[:, 0]
    rec = simulate(THREE, None, 1 / fs, base_acceleration=ag, hold="cubic")
    return add_noise(
        rec.replace(velocity=None, displacement=None), noise, random_state=3
    )


def test_a_shaken_frame_with_accelerometers_alone_is_weighed_where_they_tell_the_motion():
    """The fusion takes what lies below its band away from the floors; the base below it
    must not drive the run.
    """
    record = shaken(0.01)
    model = fitted(record, known_masses={1: 12.0})
    assert off(model, THREE) < 1e-3
    assert model.model_.info["estimation"]["correlation"] > 0.999
    (segment,) = model.model_.segments(record).segments
    low, high = segment.band
    assert 1.0 < low < 5.4 and high is None  # Hz; the lowest mode is held
    lines = (
        np.abs(np.fft.rfft(segment.ag[segment.valid] * np.hanning(segment.n_valid)))
        ** 2
    )
    f = np.fft.rfftfreq(segment.n_valid, segment.step)
    assert (
        lines[f < low / 2].sum() < 1e-6 * lines.sum()
    )  # the base moved from 0.5 Hz on


def test_a_run_at_ten_samples_a_period_has_the_modes_of_its_model():
    """Against a run on a clock ten times as fine, under the same sum of sines (no
    spline between samples to blame).
    """

    def motion(fs):
        t = np.arange(int(20 * fs)) / fs
        grow = np.clip(t / 0.5, 0, 1) ** 2 * (3 - 2 * np.clip(t / 0.5, 0, 1))
        f = np.arange(0.5, 20, 0.11)
        waves = np.sin(2 * np.pi * np.outer(t, f) + 7 * f**2)
        return simulate(
            THREE,
            np.column_stack([0 * t, 0 * t, grow * waves.sum(axis=1)]),
            1 / fs,
            hold="cubic",
        )

    fine, coarse = motion(2000.0), motion(200.0)
    (segment,) = THREE.segments(coarse).segments
    run = simulated(THREE, segment)
    error = np.cumsum(run.v, axis=1) - fine.velocity[::10]
    assert (error.std(axis=0) < 1e-3 * fine.velocity.std(axis=0)).all()
    assert fits_one_step(THREE, 1e-3) and not fits_one_step(
        THREE, 1e-2
    )  # 0.12 radians a sample: 2e-6 of a frequency


def test_a_refined_model_at_a_low_sampling_rate_holds_the_truth_in_its_intervals():
    record = add_noise(
        top_forced(THREE, 40.0, 200.0, (0.5, 20), seed=3), 0.01, random_state=100
    )
    found = fitted(
        record.replace(velocity=None), estimation="simulation"
    ).confidence_intervals(0.95)
    found = found.set_index("parameter")
    true = {f"m{i + 1}": m for i, m in enumerate(THREE.masses)}
    true |= {f"storey {i}: v": c for i, c in ((1, 30.0), (2, 25.0), (3, 20.0))}
    for name, value in true.items():
        row = found.loc[name]
        assert (
            abs(row["estimate"] - value) < 4 * (row["upper"] - row["lower"]) / 3.92
        ), name


@pytest.mark.parametrize("wrong", [(0.5, -0.3, 0.4), (0.0, 2.0, 0.0)])
def test_displacement_sensors_with_a_wrong_zero_still_start_the_instruments(wrong):
    """A constant is no motion: least squares in the band of the motion is the better
    start.
    """
    record = add_noise(top_forced(THREE, 20.0, 500.0, (2, 40)), 0.02, random_state=5)
    x = record.displacement + np.array(wrong) * record.displacement.std(axis=0)
    with pytest.warns(BiasWarning, match="read a wrong zero") as said:
        model = NRFRegressor(degree=1, estimation="iv").fit(
            record.replace(displacement=x, velocity=None)
        )
    assert off(model, THREE) < 3e-3 and model.model_.info["estimation"]["found"] == "iv"
    assert not any("fell back" in str(w.message) for w in said)


def test_velocities_alone_start_in_the_band_of_the_motion():
    truth = chain(THREE.masses, [24e4, 20e4, 16e4], [60.0, 50.0, 40.0])
    record = add_noise(top_forced(truth, 10.0, 1000.0, (4, 60)), 0.06, random_state=105)
    assert (
        off(fitted(record.replace(acceleration=None, displacement=None)), truth) < 0.01
    )


def test_a_light_frame_whose_damping_is_found_negative_is_still_run():
    """Damping ratios of 0.1 to 0.5 %, 3 s: an estimate of it may be growth, under which
    no run is like the motion.
    """
    truth = chain([0.35, 0.9, 0.12], [9e4, 4e4, 2.5e4], [1.2, 0.8, 0.3])
    growing = chain([0.35, 0.9, 0.12], [9e4, 4e4, 2.5e4], [1.2, -3.0, 0.3])
    assert (growing.modes()["damping"] < 0).any()
    tamed = with_decaying_modes(growing)
    assert (tamed.modes()["damping"] > 0.9e-3).all()
    np.testing.assert_allclose(
        tamed.modes()["frequency"], truth.modes()["frequency"], rtol=1e-3
    )
    assert with_decaying_modes(truth) is truth
    record = top_forced(truth, 3.0, 5000.0, (5, 400), rms=8.0, seed=2, dof=1)
    assert off(fitted(add_noise(record, 0.08, random_state=101)), truth) < 5e-3
