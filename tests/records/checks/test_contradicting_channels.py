"""Channels that contradict each other are named once; good data pass in silence."""

import re
import warnings
from functools import cache

import measured
import measured_sets
import numpy as np
import paper_cases as cases
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning
from pysindy_nrf.records import channel_alignment, channel_notes, data_warnings
from pysindy_nrf.records.files import read_record
from pysindy_nrf.simulation import add_noise

STOREY = laws.PowerSeries(1, [60.0, 1e5])
TRUTH = ChainModel([10.0, 12.0, 11.0], {f"storey {i}": STOREY for i in (1, 2, 3)})


def positions_and_accelerations(exact: Record, noise: float) -> Record:
    record = exact.replace(velocity=None)
    return add_noise(record, noise, random_state=1) if noise else record


@cache
def forced(noise=0.02) -> Record:
    """Three floors, the upper one forced."""
    exact = driven(TRUTH, [3], 8.0, 500.0, 100.0, (0.5, 60.0))
    return positions_and_accelerations(exact, noise)


@cache
def shaken(noise=0.02) -> Record:
    """The same floors on a base that moves."""
    base = excitation.band_limited_random(
        1, 8.0, 500.0, excited=[1], rms=2.0, band=(0.5, 40), random_state=3
    )
    exact = simulate(TRUTH, None, 1 / 500.0, base_acceleration=base[:, 0])
    return positions_and_accelerations(exact, noise)


def base_displacement(record: Record) -> np.ndarray:
    f = np.fft.rfftfreq(record.n_samples, record.dt)
    lines = np.fft.rfft(record.base_acceleration)
    lines[1:] /= -((2 * np.pi * f[1:]) ** 2)
    lines[0] = 0
    return np.fft.irfft(lines, record.n_samples)


def scaled(record: Record, key: str, dof: int, factor) -> Record:
    array = np.array(getattr(record, key))
    array[:, dof - 1] *= factor
    return record.replace(**{key: array})


def late_acceleration():
    record = forced()
    a = record.acceleration.copy()
    a[:, 0] = np.roll(a[:, 0], 5)
    return record.replace(acceleration=a)


def absolute_called_relative():
    record = shaken()
    absolute = record.displacement + base_displacement(record)[:, None]
    return record.replace(displacement=absolute)


def relative_called_absolute():
    record = shaken()
    return record.replace(
        coordinates="absolute", base_displacement=base_displacement(record)
    )


def acceleration_relative_to_the_base():
    record = shaken()
    relative = record.acceleration - record.base_acceleration[:, None]
    return record.replace(acceleration=relative)


def copied():
    record = forced()
    return record.replace(displacement=record.displacement[:, [0, 0, 2]])


def swapped():
    record = forced()
    return record.replace(acceleration=record.acceleration[:, [1, 0, 2]])


def in_millimetres():
    return scaled(forced(), "displacement", 2, 1e3)


def in_g():
    return scaled(forced(), "acceleration", 1, 1 / 9.80665)


def reversed_acceleration():
    return scaled(forced(), "acceleration", 3, -1.0)


FAULTS = [
    (in_millimetres, "x2", "unit", "is x2 in mm"),
    (in_g, "x1", "unit", "is a1 in g"),
    (reversed_acceleration, "x3", "sign", "opposite sign against a3"),
    (late_acceleration, "x1", "delay", "samples. early against a1"),
    (copied, "x2", "copied", "x2 is the same as x1"),
    (swapped, "x1", "swapped", "columns swapped"),
    (absolute_called_relative, "x2", "frame", "coordinates='absolute'"),
    (relative_called_absolute, "x2", "frame", "coordinates='relative'"),
    (acceleration_relative_to_the_base, "x1", "frame", "add ag"),
]


@pytest.mark.parametrize(("make", "channel", "kind", "words"), FAULTS)
def test_a_fault_is_named_once_on_the_way_to_the_features(make, channel, kind, words):
    record = make()
    assert (channel, kind) in [(n.channel, n.kind) for n in channel_notes(record)]
    with pytest.warns(DataQualityWarning) as caught:
        record.replace(force=None).to_features()
    texts = [str(w.message) for w in caught if "checks.alignment" in str(w.message)]
    assert len(texts) == 1
    assert re.search(words, texts[0])


def test_the_notes_of_a_delay_have_its_size_and_a_witness():
    """Five samples at 500 Hz; the displacement is early by that."""
    (note,) = channel_notes(late_acceleration())
    assert (note.channel, note.witness, note.record) == ("x1", "a1", "simulation")
    assert note.size == pytest.approx(-0.01, rel=0.02)


@pytest.mark.parametrize("estimation", ["ls", "iv"])
def test_fit_warns_of_a_fault_once(estimation):
    with warnings.catch_warnings(record=True, action="always") as caught:
        NRFRegressor(degree=1, estimation=estimation).fit(reversed_acceleration())
    of_channels = [w for w in caught if w.category is DataQualityWarning]
    texts = [str(w.message) for w in of_channels if "a3" in str(w.message)]
    assert len(texts) == 1
    assert "opposite sign" in texts[0]


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_good_channels_pass_in_silence(noise):
    assert channel_notes(forced(noise)) == ()
    record = shaken(noise)
    assert channel_notes(record) == ()
    absolute = record.displacement + base_displacement(record)[:, None]
    turned = record.replace(displacement=absolute, coordinates="absolute")
    assert channel_notes(turned) == ()


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("gain", [0.95, 1.05, 1.15])
def test_a_wrong_calibration_is_named_at_its_dof_alone(gain, noise):
    (note,) = channel_notes(scaled(forced(noise), "acceleration", 2, gain))
    assert (note.kind, note.channel, note.witness) == ("gain", "x2", "a2")
    assert note.size == pytest.approx(1 / gain, rel=0.01)


@pytest.mark.parametrize("hertz", [20.0, 130.0])
def test_a_light_frame_may_shake_hard_but_not_in_millimetres(hertz):
    """300 and 1950 m/s^2 at those frequencies are possible, a thousand times is not."""
    k = 2.0 * (2 * np.pi * hertz) ** 2
    storey = laws.PowerSeries(1, [0.02 * np.sqrt(2.0 * k), k])
    frame = ChainModel([2.0], {"storey 1": storey})
    band = (0.1 * hertz, 2 * hertz)
    run = driven(frame, [1], 8.0, 2000.0, 5.0, band)
    hard = run.acceleration * 15 * hertz / np.abs(run.acceleration).max()
    assert channel_notes(Record(run.force, hard, fs=2000.0)) == ()
    (note,) = channel_notes(Record(run.force, 1e3 * hard, fs=2000.0))
    assert (note.kind, note.channel) == ("unit", "a1")


@pytest.mark.parametrize(("key", "sign"), [("displacement", 1), ("acceleration", -1)])
def test_a_gain_that_drifts_is_named_with_its_size(key, sign):
    record = forced()
    ramp = 1 + 0.2 * np.linspace(-0.5, 0.5, record.n_samples)
    (note,) = channel_notes(scaled(record, key, 2, ramp))
    assert (note.kind, note.channel, note.witness) == ("gain_drift", "x2", "a2")
    assert note.size == pytest.approx(sign * 0.2, abs=0.05)


@pytest.mark.parametrize(
    ("length", "second"), [(1.0, 1.0), (1e-6, 1e-4), (1e-8, 1e-6), (10.0, 10.0)]
)
def test_channels_agree_or_not_at_any_scale(length, second):
    """A chain in micrometres and megahertz is the same chain."""
    record = forced()
    small = Record(
        acceleration=record.acceleration * length / second**2,
        displacement=record.displacement * length,
        fs=record.fs / second,
    )
    assert not channel_notes(small)
    table = channel_alignment(small.replace(displacement=1.1 * small.displacement))
    np.testing.assert_allclose(table["gain"], 1.1, rtol=0.02)


def test_an_integration_rule_is_no_wrong_calibration():
    """Displacements summed by the trapezoidal rule at a fifth of the rate, their fast
    part lost: no frequency has the same gain.
    """
    record = forced(0.0)
    f = np.fft.rfftfreq(record.n_samples, record.dt)
    rule = np.ones_like(f)
    angle = np.pi * f[1:] * record.dt * 5
    slow = angle < 1.5
    rule[1:] = np.where(slow, angle / np.tan(np.minimum(angle, 1.5)), 0.0) ** 2
    lines = rule[:, None] * np.fft.rfft(record.displacement, axis=0)
    summed = np.fft.irfft(lines, record.n_samples, axis=0)
    texts = data_warnings(record.replace(displacement=summed))
    assert not any("calibration" in text for text in texts)


@pytest.mark.parametrize(("friction", "noise"), [(0.0, 0.1), (70.0, 0.0)])
def test_the_papers_hammer_tests_pass_in_silence(friction, noise):
    case = cases.four_storey(cases.INCOMPLETE_FRAME, friction, noise, duration=16.0)
    assert channel_notes(case.measured) == ()


NEES_TESTS = ("fbgm162s1", "fbgm162s3", "fbgm162s5", "fpgm111s1")


def nees(test):
    folder = measured.folder("nees_three_storey")
    return measured_sets.load_nees_three_storey(test, folder)


def hotel(event):
    folder = measured.folder("six_storey_hotel")
    return measured_sets.load_six_storey_hotel(event, folder)


@pytest.mark.parametrize(
    ("load", "options"),
    [
        *[(nees, {"test": test}) for test in NEES_TESTS],
        *[(hotel, {"event": event}) for event in (1, 7, 14, 21)],
        (measured_sets.load_emps, {}),
        (measured_sets.load_bouc_wen_benchmark, {"excitation": "multisine"}),
        (measured_sets.load_dry_friction_storey, {}),
        (measured_sets.load_mr_damper_white_noise, {}),
        (measured_sets.load_mr_damper_cyclic, {}),
    ],
)
def test_measured_sets_pass_in_silence(load, options):
    if load not in (nees, hotel):
        name = load.__name__.removeprefix("load_")
        options = options | {"folder": measured.folder(name)}
    assert channel_notes(load(**options)) == ()


@pytest.fixture(scope="module")
def table():
    """All motions and forces of three floors as a table."""
    record = driven(TRUTH, [3], 8.0, 500.0, 100.0, (2, 30))
    return record.to_frame().reset_index()


@pytest.mark.parametrize(
    ("unit", "shown", "factor"), [("ms", "ms", 1e3), ("us", "µs", 1e6)]
)
def test_a_time_in_other_units_is_asked_for(table, tmp_path, unit, shown, factor):
    """Three kinds of motion leave one explanation; a file of accelerations at such a
    rate is refused.
    """
    stretched = table.assign(t=table["t"] * factor)
    (note,) = channel_notes(Record.from_frame(stretched))
    assert (note.kind, note.size) == ("clock", 1 / factor)
    assert f"--unit t={shown}" in note.message

    path = tmp_path / "scope.csv"
    stretched.to_csv(path, index=False)
    with pytest.raises(ChannelError, match=f"time is in {unit}, not"):
        read_record(path)
    for name in (unit, shown):
        assert data_warnings(read_record(path, units={"t": name})) == []


def test_slow_displacements_are_right_as_of_towers_seen_from_satellites(table):
    slow = table.assign(t=table["t"] * 500)
    positions = slow[["t", "F3", "x1", "x2", "x3"]]
    assert channel_notes(Record.from_frame(positions)) == ()


def test_one_kind_in_another_unit_is_no_wrong_clock(table):
    kilo = {f"v{j}": table[f"v{j}"] * 1e-3 for j in (1, 2, 3)}
    notes = channel_notes(Record.from_frame(table.assign(**kilo)))
    assert {note.kind for note in notes} == {"unit"}
