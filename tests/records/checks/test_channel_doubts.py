"""Channels that contradict each other are named where a record becomes features, once;
good data pass in silence.
"""

import re
import warnings
from functools import cache

import chains
import measured
import measured_sets
import numpy as np
import paper_cases as cases
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning
from pysindy_nrf.records.checks.alignment import channel_alignment
from pysindy_nrf.records.checks.channel_checks import check_channels, data_warnings
from pysindy_nrf.records.files import read_record
from pysindy_nrf.simulation.noise import add_noise

STOREY = laws.PowerSeries(1, [60.0, 1e5])
TRUTH = ChainModel([10.0, 12.0, 11.0], {f"storey {i}": STOREY for i in (1, 2, 3)})


@cache
def record(noise=0.02, base=False):
    if base:
        ag = excitation.band_limited_random(
            1, 8.0, 500.0, excited=[1], rms=2.0, band=(0.5, 40), random_state=3
        )[:, 0]
        rec = simulate(TRUTH, None, 1 / 500.0, base_acceleration=ag)
    else:
        rec = driven(TRUTH, [3], 8.0, 500.0, 100.0, (0.5, 60.0))
    rec = rec.replace(velocity=None)
    return add_noise(rec, noise, random_state=1) if noise else rec


def changed(rec: Record, key: str, dof: int, change) -> Record:
    array = np.array(getattr(rec, key))
    array[:, dof - 1] = change(array[:, dof - 1])
    return rec.replace(**{key: array})


def base_displacement(rec: Record) -> np.ndarray:
    f = np.fft.rfftfreq(rec.n_samples, rec.dt)
    lines = np.fft.rfft(rec.base_acceleration)
    lines[1:] /= -((2 * np.pi * f[1:]) ** 2)
    lines[0] = 0
    return np.fft.irfft(lines, rec.n_samples)[:, None]


FAULTS = {
    "mm beside m/s^2": (
        lambda: changed(record(), "displacement", 2, lambda y: 1e3 * y),
        ["x2", "mm"],
    ),
    "g beside m": (
        lambda: changed(record(), "acceleration", 1, lambda y: y / 9.80665),
        ["a1", " g"],
    ),
    "wrong sign": (
        lambda: changed(record(), "acceleration", 3, lambda y: -y),
        ["a3", "sign"],
    ),
    "late": (
        lambda: changed(record(), "acceleration", 1, lambda y: np.roll(y, 5)),
        ["a1", "samples) early"],
    ),
    "copied": (
        lambda: record().replace(displacement=record().displacement[:, [0, 0, 2]]),
        ["x2", "x1", "copied"],
    ),
    "swapped": (
        lambda: record().replace(acceleration=record().acceleration[:, [1, 0, 2]]),
        ["a1", "columns swapped"],
    ),
    "absolute as relative": (
        lambda: record(base=True).replace(
            displacement=record(base=True).displacement
            + base_displacement(record(base=True))
        ),
        ["x1", "coordinates='absolute'"],
    ),
    "relative as absolute": (
        lambda: record(base=True).replace(
            coordinates="absolute",
            base_displacement=base_displacement(record(base=True))[:, 0],
        ),
        ["x1", "coordinates='relative'"],
    ),
    "acceleration relative to the base": (
        lambda: record(base=True).replace(
            acceleration=record(base=True).acceleration
            - record(base=True).base_acceleration[:, None]
        ),
        ["a1", "add ag"],
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_on_the_way_to_the_features(fault):
    make, words = FAULTS[fault]
    with pytest.warns(DataQualityWarning) as caught:
        make().replace(force=None).to_features()
    said = [
        str(w.message)
        for w in caught
        if "pysindy_nrf.records.checks.alignment" in str(w.message)
    ]
    assert len(said) == 1 and all(word in said[0] for word in words), said


@pytest.mark.parametrize("estimation", ["ls", "iv"])
def test_fit_says_it_once(estimation):
    rec = FAULTS["wrong sign"][0]()
    with warnings.catch_warnings(record=True, action="always") as caught:
        NRFRegressor(degree=1, estimation=estimation).fit(rec)
    named = [
        w for w in caught if w.category is DataQualityWarning and "a3" in str(w.message)
    ]
    assert len(named) == 1 and "opposite sign" in str(named[0].message)


@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("base", [False, True])
def test_good_channels_are_not_doubted(noise, base):
    rec = record(noise, base)
    assert data_warnings(rec) == []
    if base:
        absolute = rec.replace(
            displacement=rec.displacement + base_displacement(rec),
            coordinates="absolute",
        )
        assert data_warnings(absolute) == []


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("gain", [0.95, 1.05, 1.15])
def test_a_calibration_that_is_some_percent_off_is_named_at_its_dof_alone(gain, noise):
    said = data_warnings(changed(record(noise), "acceleration", 2, lambda y: gain * y))
    assert (
        len(said) == 1 and said[0].startswith("x2 is") and "calibration" in said[0]
    ), said
    assert float(said[0].split()[2]) == pytest.approx(1 / gain, rel=0.01)


def accelerations_alone(k, rms):
    truth = ChainModel(
        [2.0], {"storey 1": laws.PowerSeries(1, [0.02 * np.sqrt(2.0 * k), k])}
    )
    top = np.sqrt(k / 2.0) / np.pi
    return driven(truth, [1], 8.0, 2000.0, rms, (0.05 * top, top)).replace(
        velocity=None, displacement=None
    )


@pytest.mark.parametrize("hertz", [20.0, 130.0])
def test_a_light_frame_may_shake_hard_and_millimetres_for_metres_are_still_asked_for(
    hertz,
):
    rec = accelerations_alone(2.0 * (2 * np.pi * hertz) ** 2, 5.0)
    hard = rec.replace(
        acceleration=rec.acceleration * (15 * hertz / np.abs(rec.acceleration).max())
    )  # 300, 1950 m/s^2
    assert data_warnings(hard) == []
    assert (
        "unit" in data_warnings(hard.replace(acceleration=1e3 * hard.acceleration))[0]
    )


@pytest.mark.parametrize(
    ("key", "name"), [("displacement", "x2"), ("acceleration", "a2")]
)
def test_a_gain_that_drifts_is_named_with_its_size(key, name):
    rec = record()
    ramp = 1 + 0.2 * np.linspace(-0.5, 0.5, rec.n_samples)
    (said,) = data_warnings(
        changed(rec.replace(velocity=None), key, 2, lambda y: y * ramp)
    )
    share = float(
        re.search(
            r"the gain of x2 or a2 drifts: their ratio changes by ([+-]\d+) %", said
        )[1]
    )
    assert share == pytest.approx(20 if key == "displacement" else -20, abs=5)


@pytest.mark.parametrize(
    ("length", "second"), [(1.0, 1.0), (1e-6, 1e-4), (1e-8, 1e-6), (10.0, 10.0)]
)
def test_channels_agree_or_not_at_any_scale(length, second):
    """A chain in micrometres and megahertz is the same chain."""
    rec = record()
    small = rec.replace(
        acceleration=rec.acceleration * length / second**2,
        displacement=rec.displacement * length,
        velocity=None,
        fs=rec.fs / second,
    )
    assert not data_warnings(small)
    table = channel_alignment(small.replace(displacement=1.1 * small.displacement))
    np.testing.assert_allclose(table["gain"].astype(float), 1.1, rtol=0.02)


def test_an_integration_rule_is_no_wrong_calibration():
    """Displacements summed by the trapezoidal rule lose (w dt)^2 / 6, so that no
    frequency has the same gain.
    """
    rec = record(0.0)
    f = np.fft.rfftfreq(rec.n_samples, rec.dt)
    rule = np.ones_like(f)
    turn = (
        np.pi * f[1:] * rec.dt * 5
    )  # as if integrated at a fifth of the rate, and only slow motion kept
    rule[1:] = np.where(turn < 1.5, turn / np.tan(np.minimum(turn, 1.5)), 0.0) ** 2
    summed = np.fft.irfft(
        rule[:, None] * np.fft.rfft(rec.displacement, axis=0), rec.n_samples, axis=0
    )
    assert not [
        text
        for text in data_warnings(rec.replace(displacement=summed))
        if "calibration" in text
    ]


@pytest.mark.parametrize(("friction", "noise"), [(0.0, 0.1), (70.0, 0.0)])
def test_the_papers_hammer_tests_are_not_doubted(friction, noise):
    assert (
        data_warnings(
            cases.four_storey(
                cases.INCOMPLETE_FRAME, friction, noise, duration=16.0
            ).measured
        )
        == []
    )


def test_no_measured_set_is_doubted():
    root = measured.folder("nees_three_storey")
    recs = [
        measured_sets.load_nees_three_storey(test, root)
        for test in ("fbgm162s1", "fbgm162s3", "fbgm162s5", "fpgm111s1")
    ]
    recs += [
        measured_sets.load_six_storey_hotel(event, measured.folder("six_storey_hotel"))
        for event in (1, 7, 14, 21)
    ]
    recs += [
        measured_sets.load_emps(measured.folder("emps")),
        measured_sets.load_bouc_wen_benchmark(
            "multisine", measured.folder("bouc_wen_benchmark")
        ),
        measured_sets.load_dry_friction_storey(measured.folder("dry_friction_storey")),
        measured_sets.load_mr_damper_white_noise(
            measured.folder("mr_damper_white_noise")
        ),
        measured_sets.load_mr_damper_cyclic(folder=measured.folder("mr_damper_cyclic")),
    ]
    assert {rec.name: said for rec in recs if (said := data_warnings(rec))} == {}


@pytest.fixture(scope="module")
def table():
    """All motions and forces of three floors as a table."""
    return driven(TRUTH, [3], 8.0, 500.0, 100.0, (2, 30)).to_frame().reset_index()


def test_a_record_with_numbers_for_not_measured_is_doubted(table):
    bad = table.copy()
    bad.loc[[500, 2000], "F3"] = -9999.0
    found = check_channels(Record.from_frame(bad))
    assert found[["channel", "problem"]].to_numpy().tolist() == [["F3", "filled"]]
    assert found["share"].iloc[0] == pytest.approx(2 / len(table))
    assert "rows 500, 2000" in found["message"].iloc[0]
    assert found["message"].iloc[0] in data_warnings(Record.from_frame(bad))


@pytest.mark.parametrize(
    ("unit", "shown", "factor"), [("ms", "ms", 1e3), ("us", "µs", 1e6)]
)
def test_a_time_in_other_units_is_asked_for(table, tmp_path, unit, shown, factor):
    """Three kinds of motion leave one explanation; a file of accelerations at such a
    rate is refused.
    """
    path = tmp_path / "scope.csv"
    late = table.assign(t=table["t"] * factor)
    late.to_csv(path, index=False)
    (said,) = data_warnings(Record.from_frame(late))
    assert f"as if the time were in {shown}" in said and f"--unit t={shown}" in said
    with pytest.raises(ChannelError, match=f"the time is in {unit}, not in s"):
        read_record(path)
    assert (
        data_warnings(read_record(path, units={"t": shown}))
        == data_warnings(read_record(path, units={"t": unit}))
        == []
    )


def test_a_right_clock_and_slow_displacements_are_not_doubted(table):
    """Towers are measured by satellite once a second."""
    assert data_warnings(Record.from_frame(table)) == []
    slow = table[["t", *(c for c in table if c[0] in "Fx")]].assign(t=table["t"] * 500)
    assert data_warnings(Record.from_frame(slow)) == []
    one = table.assign(
        **{f"v{j}": table[f"v{j}"] * 1e-3 for j in (1, 2, 3)}
    )  # one kind in another unit
    assert not any("the time" in text for text in data_warnings(Record.from_frame(one)))


DT = 1e-3
ARRAYS = {
    "v and s swapped": (lambda x: x[:, [0, 1, 2, 6, 7, 8, 3, 4, 5]], DT, "v1 .*s1 "),
    "a and v swapped": (lambda x: x[:, [3, 4, 5, 0, 1, 2, 6, 7, 8]], DT, "v1 "),
    "a clock ten times too slow": (lambda x: x, 10 * DT, "v1 is 0.1 times as large"),
    "standardised": (
        lambda x: (x - x.mean(axis=0)) / x.std(axis=0),
        None,
        "standard deviation of one",
    ),
    "as they are": (lambda x: x, DT, ""),
    "two folds": (lambda x: np.delete(x, slice(900, 1700), axis=0), DT, ""),
    "in no order": (lambda x: np.random.default_rng(0).permutation(x), DT, ""),
}


@pytest.mark.parametrize("fault", ARRAYS)
def test_arrays_that_are_no_motion_are_named_by_fit_and_by_diagnose(fault):
    change, dt, words = ARRAYS[fault]
    case = chains.duffing(3, [1, 2, 3], seed=0, n_samples=3000)
    model = NRFRegressor(degree=1, dt=dt)
    with warnings.catch_warnings(record=True, action="always") as caught:
        model.fit(change(case.noisy(0.05)), change(np.tile(case.F, 3))[:, :3])
    said = [
        str(w.message)
        for w in caught
        if w.category is DataQualityWarning and str(w.message)[:2] == "X:"
    ]
    assert len(said) == bool(words) and (not words or re.search(words, said[0]))
    assert ("channel" in set(model.diagnose().table["limit"])) == bool(words)
