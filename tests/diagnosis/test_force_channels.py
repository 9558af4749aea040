"""Forces whose channel is distorted, and records that do not belong together."""

import re
import warnings

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.records import check_channels
from pysindy_nrf.simulation import add_noise

FS = 400.0
N_SAMPLES = 6000


def frame(top_mass):
    storeys = {}
    for i, stiffness in enumerate((4e4, 3e4, 2.5e4), 1):
        storeys[i] = [laws.LinearElastic(stiffness), laws.LinearViscous(50.0)]
    return ChainModel([12.0, 9.0, top_mass], storeys)


def measured(seed=0, top_mass=15.0, excited=(1, 2, 3)):
    F = excitation.band_limited_random(
        3,
        N_SAMPLES / FS,
        FS,
        excited=excited,
        rms=100.0,
        band=(1, 40),
        random_state=seed,
    )
    record = simulate(frame(top_mass), F, 1 / FS, name=f"test {seed}")
    return add_noise(record, 0.01, random_state=seed)


@pytest.fixture(scope="module")
def sound():
    return measured()


def with_second_force(record, change):
    """The record with another force on floor 2."""
    F = record.force.copy()
    F[:, 1] = change(F[:, 1])
    return record.replace(force=F)


def doubts(records):
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor(degree=1).fit(records).data_warnings_


def with_dead_band(force):
    return np.sign(force) * np.maximum(np.abs(force) - 18, 0)


def with_weak_pull(force):
    return np.where(force > 0, force, 0.9 * force)


def saturated(force):
    return 300 * np.tanh(force / 300)


def with_drifting_gain(force):
    return force * (1 + 0.2 * np.linspace(-0.5, 0.5, len(force)))


DISTORTIONS = [
    (with_dead_band, r"it lacks 1[6-9]\S* N on either side of zero"),
    (with_weak_pull, r"its gain differs by (9|10|11)\S* %"),
    (saturated, "too small .saturation"),
    (with_drifting_gain, "its gain drifts by (19|20) % over"),
]


@pytest.mark.parametrize(("distorted", "words"), DISTORTIONS)
def test_a_distorted_force_is_named_with_its_size(sound, distorted, words):
    forces = doubts(with_second_force(sound, distorted))["forces"]

    of_second = [text for text in forces if text.startswith("F2: ")]
    assert len(of_second) == 1
    assert re.search(words, of_second[0])


def test_a_distortion_that_explains_little_is_no_accusation(sound):
    """Peaks that are 5 % too small are a tenth of what noise leaves."""
    record = with_second_force(sound, lambda force: 1200 * np.tanh(force / 1200))
    assert doubts(record)["forces"] == []


@pytest.mark.parametrize("frequency", [5.5, 6.6, 7.5])
def test_a_sine_that_grows_from_rest_is_no_distortion(frequency):
    """Cubic laws fit the start of a sine badly, which is no fault of the force."""
    t = np.arange(0, 40, 1 / 256)
    F = np.zeros((len(t), 3))
    F[:, 1] = 1000 * np.sin(2 * np.pi * frequency * t) * np.clip(t / 3, 0, 1)
    storeys = {}
    for i, stiffness in enumerate((3.0e6, 2.3e6, 2.3e6), 1):
        storeys[i] = [laws.LinearElastic(stiffness), laws.LinearViscous(2600.0)]
    truth = ChainModel([1040.0, 1060.0, 1060.0], storeys)
    record = add_noise(simulate(truth, F, 1 / 256), 0.005, random_state=1)

    with warnings.catch_warnings(action="ignore"):
        assert not NRFRegressor().fit(record).data_warnings_["forces"]


def interpolated(force):
    samples = np.arange(len(force))
    return np.interp(samples, samples[::4], force[::4])


def repeated(force):
    return force[np.arange(len(force)) // 5 * 5]


def with_dropouts(force):
    rows = np.arange(len(force)) % 1500
    return np.where((rows > 700) & (rows < 720), 0.0, force)


def with_hum(force):
    return force + 10 * np.sin(2 * np.pi * 50 * np.arange(len(force)) / FS)


def clipped(force):
    return np.clip(force, -150, 150)


FAULTS = [
    (interpolated, "interpolated"),
    (repeated, "interpolated"),
    (with_dropouts, "dropouts"),
    (with_hum, "hum"),
    (clipped, "clipped"),
]


@pytest.mark.parametrize(("change", "problem"), FAULTS)
def test_a_fault_of_the_line_is_named_by_the_channel_alone(sound, change, problem):
    checks = check_channels(with_second_force(sound, change))

    assert checks.set_index("channel")["problem"].to_dict() == {"F2": problem}


def test_a_sound_line_has_no_fault(sound):
    assert check_channels(sound).empty


def test_records_of_one_structure_belong_together(sound):
    assert not any(doubts([sound, measured(1)]).values())


def test_copies_of_a_record_are_named(sound):
    assert "hold the same samples" in doubts([sound, sound])["records"][0]


def test_another_gain_of_a_force_is_named(sound):
    louder = with_second_force(measured(1), lambda force: 1.2 * force)

    message = " ".join(doubts([sound, louder])["forces"])

    assert "do not belong together" in message
    assert "is the gain of F2 another one there?" in message


def test_a_record_of_another_structure_is_named(sound):
    message = " ".join(doubts([sound, measured(1, top_mass=18.0)])["forces"])

    assert "the balance of DOF 3" in message
    assert "another structure" in message


def test_another_structure_shows_where_no_force_acts():
    first = measured(0, excited=[1])
    second = measured(1, top_mass=18.0, excited=[1])

    message = " ".join(doubts([first, second])["forces"])

    assert "the balance of DOF 3 in record" in message
