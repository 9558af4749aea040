"""Faulty sensors as effects: found at their channel, none where sensors are good."""

import numpy as np
import pytest

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.simulation import add_noise

FS = 500.0
RIVALS = [
    laws.CoulombFriction(),
    laws.MaxwellBranch(),
    laws.ConstantForce(),
    laws.DampingDrift(),
    laws.QuadraticStiffness(),
    laws.LinkSpringDashpot(),
    laws.ChannelDelay(),
    laws.GainError(),
    laws.SensorOffset(),
]


class OwnGain(laws.SensorFault):
    """A wrong calibration in percent, as a user would write it."""

    name = "own_gain_in_percent"
    columns = (laws.Term("e", "y/100", "1"),)
    scan = (2.0, 60.0)
    changes_scale = True

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = 0.01 * s

    def reading(self, channel, dt):
        return (1.0 + 0.01 * self.values[0]) * np.asarray(channel)

    def corrected(self, reading, dt):
        return np.asarray(reading) / (1.0 + 0.01 * self.values[0])


def chain(n, seed):
    """A chain of random masses, springs and dashpots."""
    rng, storeys = np.random.default_rng(seed), {}
    for i in range(1, n + 1):
        spring = laws.LinearElastic(rng.uniform(1e5, 2e5))
        storeys[i] = [spring, laws.LinearViscous(rng.uniform(40, 90))]
    return ChainModel(rng.uniform(8, 14, n), storeys)


def record(n, forced, noise, seed=3, sensors=None):
    """Eight seconds of such a chain, with faults of its sensors."""
    model = chain(n, seed)
    model = ChainModel(model.masses, {**model.laws, **(sensors or {})})
    F = excitation.band_limited_random(
        n, 8.0, FS, excited=forced, rms=100.0, band=(1, 50), random_state=seed
    )
    run = simulate(model, F, 1 / FS)
    return add_noise(run, noise, random_state=seed + 1) if noise else run


def test_a_simulated_sensor_reads_late_and_leaves_the_motion_alone():
    late_by_two = {"sensor a2": laws.ChannelDelay(2 / FS)}
    plain, faulty = record(2, [2], 0.0), record(2, [2], 0.0, sensors=late_by_two)
    reading = faulty.acceleration[:, 1]
    assert np.allclose(reading[2:], plain.acceleration[:-2, 1], rtol=1e-9)
    assert np.isnan(reading[:2]).all()
    for key in ("force", "displacement", "velocity"):
        assert np.array_equal(getattr(faulty, key), getattr(plain, key))


def test_a_sensor_that_is_not_there_is_named():
    with pytest.raises(ChannelError, match="sensor a7"):
        record(2, [2], 0.0, sensors={"sensor a7": laws.GainError(0.2)})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("forced", "left_out", "channel", "fault", "noise"),
    [
        ([2], ["velocity"], "a2", laws.ChannelDelay(0.004), 0.01),
        ([1, 2, 3], [], "F2", laws.GainError(0.2), 0.01),
        ([1, 2, 3], ["velocity"], "x3", laws.GainError(0.2), 0.01),
        ([1, 3], [], "F3", laws.ChannelDelay(-0.003), 0.0),
    ],
)
def test_the_faulty_sensor_is_found_and_measured(
    forced, left_out, channel, fault, noise
):
    faulty = record(3, forced, noise, sensors={f"sensor {channel}": fault})
    faulty = faulty.replace(**dict.fromkeys(left_out))
    report = close_loop(faulty, catalogue=RIVALS, max_steps=2)
    step = report.steps[0]
    assert (step.law, step.site) == (fault.name, f"sensor {channel}")
    assert step.family == "sensor" and step.is_fault

    (value,) = step.parameters.values()
    assert value == pytest.approx(fault.values[0], rel=0.05)
    assert step.error_after < 0.6 * step.error_before
    assert np.allclose(report.model.masses, chain(3, 3).masses, rtol=0.02)


def test_all_sensors_of_a_floor_read_the_same_fault():
    gain = {"sensors 2": laws.GainError(-0.1)}
    plain, faulty = record(2, [2], 0.0), record(2, [2], 0.0, sensors=gain)
    for key in ("acceleration", "velocity", "displacement"):
        reading, true = getattr(faulty, key), getattr(plain, key)
        assert np.array_equal(reading, true * [1.0, 0.9])
    assert np.array_equal(faulty.force, plain.force)


@pytest.mark.parametrize(
    ("forced", "left_out", "fault"),
    [
        ([3], ["velocity"], laws.GainError(-0.08)),
        pytest.param(
            [1, 2, 3], [], laws.GainError(0.12), marks=pytest.mark.slow, id="all"
        ),
        pytest.param(
            [1], ["displacement"], laws.ChannelDelay(0.004), marks=pytest.mark.slow
        ),
        pytest.param(
            [1, 2, 3], [], laws.ChannelDelay(0.005), marks=pytest.mark.slow, id="late"
        ),
    ],
)
def test_a_fault_that_all_sensors_of_a_floor_share_is_no_brace(forced, left_out, fault):
    """As where displacement and velocity are integrals of one acceleration."""
    faulty = record(3, forced, 0.01, sensors={"sensors 2": fault})
    report = close_loop(faulty.replace(**dict.fromkeys(left_out)))
    step = report.steps[0]
    assert (step.law, step.site) == (fault.name, "sensors 2")
    assert step.confirmed and not step.sure

    (value,) = step.parameters.values()
    assert value == pytest.approx(fault.values[0], rel=0.05)
    assert np.allclose(report.model.masses, chain(3, 3).masses, rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_small_gain_of_a_force_is_found_where_it_stands_out(noise):
    faulty = record(3, [1, 2, 3], noise, sensors={"sensor F2": laws.GainError(0.04)})
    step = close_loop(faulty, catalogue=RIVALS, max_steps=1).steps[0]
    assert (step.law, step.site) == ("gain_error", "sensor F2")
    assert step.parameters["e"] == pytest.approx(0.04, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [-0.62, 0.62])
def test_a_large_gain_is_measured_beyond_the_range_that_is_scanned(gain):
    faulty = record(3, [1, 2, 3], 0.01, sensors={"sensor F2": laws.GainError(gain)})
    step = close_loop(faulty, catalogue=RIVALS, max_steps=1).steps[0]
    assert (step.law, step.site) == ("gain_error", "sensor F2")
    assert step.parameters["e"] == pytest.approx(gain, rel=0.01)


@pytest.mark.parametrize(
    "left_out",
    [
        pytest.param(["velocity", "displacement"], marks=pytest.mark.slow),
        ["velocity"],
    ],
)
def test_a_fault_that_a_user_wrote_is_tried_like_ours(left_out):
    """Where a floor has one kind of channel, and where two contradict each other."""
    faulty = record(3, [1, 2, 3], 0.01, sensors={"sensor a3": laws.GainError(0.2)})
    faulty = faulty.replace(**dict.fromkeys(left_out))
    values = {}
    for fault in (laws.GainError(), OwnGain()):
        report = close_loop(faulty, catalogue=[fault], max_steps=1)
        (values[fault.name],) = report.steps

    ours, of_user = values["gain_error"], values["own_gain_in_percent"]
    assert of_user.site == ours.site
    assert of_user.parameters["e"] == pytest.approx(
        100 * ours.parameters["e"], rel=0.01
    )


def test_a_late_sensor_on_a_shaken_chain_reads_the_base_late_too():
    """An accelerometer reads the motion of the base, too."""
    storey = [laws.LinearElastic(6000.0), laws.LinearViscous(8.0)]
    late = {"sensor a2": laws.ChannelDelay(0.003)}
    model = ChainModel([10.0, 10.0], {1: storey, 2: storey, **late})
    t = np.arange(2400) / 200.0
    base = 2.0 * np.sin(2 * np.pi * 1.8 * t) * np.clip(2 * t, 0, 1) * (t < 8)
    run = simulate(model, np.zeros((2400, 2)), 1 / 200, base_acceleration=base)
    run = add_noise(run, 0.002, random_state=1)

    masses = NRFRegressor(degree=1, known_masses={1: 10.0, 2: 10.0})
    accelerations = run.replace(velocity=None, displacement=None)
    report = close_loop(accelerations, masses, [laws.ChannelDelay()])
    (step,) = report.steps
    assert step.site == "sensor a2"
    assert step.parameters["tau"] == pytest.approx(0.003, rel=0.05)
    stiffness = report.model.restoring_forces["storey 2"].linear_part()["k"]
    assert stiffness == pytest.approx(6000.0, rel=0.005)


def test_of_two_forces_either_may_be_wrong():
    faulty = record(2, [1, 2], 0.01, sensors={"sensor F2": laws.GainError(0.2)})
    step = close_loop(faulty, catalogue=RIVALS, max_steps=1).steps[0]
    assert {step.site, *step.sensors} == {"sensor F1", "sensor F2"}
    assert "sensor F" in step.sentence.split("The same fault")[1]


@pytest.mark.parametrize(
    ("forced", "noise"), [([2], 0.05), ([1, 2, 3], 0.02), ([1], 0.0)]
)
def test_good_sensors_are_left_alone(forced, noise):
    report = close_loop(record(3, forced, noise, seed=8), catalogue=RIVALS)
    assert report.steps == []
    assert "contradict" not in report.stopped_because


@pytest.mark.slow
def test_channels_that_contradict_each_other_are_named():
    """Three channels of one floor, one late: fusion outvotes it, and the report says
    so.
    """
    late = {"sensor v2": laws.ChannelDelay(0.006)}
    report = close_loop(record(3, [1, 2, 3], 0.03, sensors=late), catalogue=RIVALS)
    sites = [step.site for step in report.steps]
    if sites != ["sensor v2"]:
        assert not sites and "v2 is" in report.stopped_because
        assert "v2" in {note.channel for note in report.quality}
