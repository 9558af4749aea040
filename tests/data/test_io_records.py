"""A file becomes a record in SI units, by names or by a small grammar that is never run as code."""

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pysindy_nrf.data.io import describe, inspect_record, read_record, summary
from pysindy_nrf.data.io.units import factor
from pysindy_nrf.exceptions import ChannelError, FileFormatError

# Definitions: inch and pound of 1959, standard gravity.
INCH, POUND, G = 0.0254, 4.4482216152605, 9.80665


@pytest.mark.parametrize(
    ("unit", "channel", "value"),
    [
        ("mm", "x1", 1e-3), ("in", "xg", INCH), ("ft", "x3", 12 * INCH), ("µm", "x1", 1e-6), ("cm/s", "v1", 1e-2),
        ("in/s", "v2", INCH), ("g", "a1", G), ("mg", "ag", 1e-3 * G), ("cm/s^2", "a1", 1e-2), ("cm/s²", "a1", 1e-2),
        ("cm/s/s", "a1", 1e-2), ("ms-2", "a1", 1.0), ("m/s2", "a1", 1.0), ("Gal", "a2", 1e-2), ("kN", "F1", 1e3),
        ("mN", "F1", 1e-3), ("MN", "F1", 1e6), ("kip", "F2", 1e3 * POUND), ("lbf", "F2", POUND), ("ms", "t", 1e-3),
    ],
)  # fmt: skip
def test_units(unit, channel, value):
    assert factor(unit, channel) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(("unit", "channel"), [("mm", "a1"), ("g", "F1"), ("N", "x1"), ("wug", "x1"), ("cm/s", "a1")])
def test_a_unit_of_another_kind_is_refused(unit, channel):
    with pytest.raises(ChannelError, match=channel):
        factor(unit, channel)


@pytest.fixture
def mat(tmp_path):
    t = np.arange(50) / 100
    acc = np.column_stack([np.sin(20 * t), np.cos(20 * t), t])
    content = {
        "zeit": 1e3 * t,
        "acc": acc,
        "wide": acc.T,
        "drive": t + 1,
        "gain": 35.1507,
        "voltage": 2 * t,
        "short": t[:9],
    }
    savemat(tmp_path / "test 7.mat", content)
    return tmp_path / "test 7.mat", t, acc


def test_the_mapping_grammar(mat):
    path, t, acc = mat
    rec = read_record(
        path,
        mapping={"t": "zeit @ ms", "a1": "acc[:, 0] @ g", "a2": "-acc[:, -2]*2", "a3": "wide[2, :]", "F1": "drive*gain",
                 "F2": "drive * 1e3", "F3": "unknown", "u": "voltage"},
    )  # fmt: skip
    assert rec.fs == pytest.approx(100) and rec.name == "test 7"
    np.testing.assert_allclose(
        rec.acceleration, np.column_stack([G * acc[:, 0], -2 * acc[:, 1], acc[:, 2]]), rtol=1e-14
    )
    np.testing.assert_allclose(rec.force[:, :2], np.column_stack([35.1507 * (t + 1), 1e3 * (t + 1)]), rtol=1e-14)
    assert rec.unknown == (3,)
    np.testing.assert_array_equal(rec.covariates["u"], 2 * t)


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"x1": "nope"}, "no variable 'nope'.*acc 50x3"),
        ({"x1": "acc"}, r"shape \(50, 3\).*acc\[:, 0\]"),
        ({"x1": "acc[:, 3]"}, "no column 3"),
        ({"x1": "short", "F1": "drive"}, "differ in length"),
        ({"x1": "drive + 2"}, "no variable 'drive \\+ 2'"),
        ({"x1": "drive*2*3"}, "not understood"),
        ({"x1": "drive*volts"}, "factor 'volts'"),
        ({"x1": "drive*0"}, "factor '0'"),
        ({"x1": "drive @ wug"}, "unit 'wug'"),
        ({"x1": "drive @ g"}, "x1 is a displacement, but its unit 'g' measures acceleration"),
        ({"x": "drive"}, "no number"),
        ({"x1": "unknown"}, "cannot be 'unknown'"),
        ({"F1": "drive"}, "no column is known to be a motion"),
        ({"x1": "__import__('os').system('touch mark')"}, "no variable"),
        ({"x1": "drive*__import__('os')"}, "factor"),
    ],
)
def test_a_bad_mapping_names_the_channel(mat, mapping, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path, *_ = mat
    with pytest.raises((ChannelError, FileFormatError), match=message):
        read_record(path, mapping=mapping, fs=100.0)
    assert not (tmp_path / "mark").exists()


@pytest.fixture
def csv(tmp_path):
    path = tmp_path / "shaker.csv"
    t = np.arange(400) / 200
    frame = pd.DataFrame(
        {
            "t": t,
            "F2": np.sin(9 * t),
            "a1": np.sin(t),
            "a2": np.cos(t),
            "x1 [mm]": t,
            "x2 [mm]": 2 * t,
            "operator": "Ann",
        }
    )
    frame.to_csv(path, index=False)
    return path, frame


def test_units_from_header_option_and_mapping(csv):
    path, frame = csv
    rec = read_record(path, units={"a": "g", "F2": "kN", "x2": "in"}, mapping={"a2": "a2 @ cm/s^2"})
    np.testing.assert_allclose(rec.acceleration, np.column_stack([G * frame["a1"], 0.01 * frame["a2"]]), rtol=1e-12)
    np.testing.assert_allclose(
        rec.displacement, np.column_stack([1e-3 * frame["x1 [mm]"], INCH * frame["x2 [mm]"]]), rtol=1e-12
    )
    np.testing.assert_allclose(rec.force, np.column_stack([0 * frame["t"], 1e3 * frame["F2"]]), rtol=1e-12)


def test_what_was_understood_is_said(csv):
    path, _ = csv
    text = describe(inspect_record(path, units={"a": "g"}))
    assert "2 DOFs, 400 samples at 200 Hz, 2 s" in text
    assert "forced: DOF 2; known to be unforced: DOF 1" in text
    assert "<- in g" in text and "<- in mm" in text and "not used: operator" in text
    data = summary(read_record(path))
    assert data["forced"] == [2] and data["channels"]["F2"]["unit"] == "N"


def test_a_channel_can_be_dropped(csv):
    path, _ = csv
    assert "a1" not in read_record(path, mapping={"a1": "none", "a2": "none"}).measured


def test_unit_for_a_channel_that_is_not_there(csv):
    with pytest.raises(ChannelError, match="'v1'"):
        read_record(csv[0], units={"v1": "mm/s"})


def test_text_in_a_channel_is_located(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,a1\n" + "".join(f"{i / 100},{i}\n" for i in range(200)) + "2.00,overload\n2.01,3\n")
    with pytest.raises(FileFormatError, match="'overload' in data row 201"):
        read_record(path)


def test_gaps_and_clocks_are_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,a1\n0,1\n0.01,\n0.02,3\n0.03,4\n")
    with pytest.raises(ChannelError, match="a1.*NaN in row 1"):
        read_record(path)
    path.write_text("t,a1\n0,1\n0.01,2\n0.02,3\n0.30,4\n")
    with pytest.raises(ChannelError, match="clock is uneven"):
        read_record(path)
    path.write_text("a1,x1\n0,1\n0.01,2\n0.02,3\n")
    with pytest.raises(ChannelError, match="no time column"):
        read_record(path)
    assert read_record(path, fs=50.0).fs == 50


def test_gaps_and_jitter_are_named_and_counted(tmp_path):
    path = tmp_path / "a.csv"
    rng = np.random.default_rng(0)
    t = np.arange(1000) / 256

    def written(time):
        pd.DataFrame({"t": time, "a1": np.sin(9 * t[: len(time)])}).to_csv(path, index=False)
        return path

    even = inspect_record(written(t))
    assert even.record.fs == 256 and even.clock == "256 Hz, from the time 't', even"
    loose = inspect_record(written(t + rng.uniform(-0.01, 0.01, 1000) / 256))
    assert loose.record.fs == pytest.approx(256, rel=1e-4) and "steps vary by up to" in loose.clock
    with pytest.raises(ChannelError, match="2 gaps, about 75 samples are missing"):
        inspect_record(written(np.delete(np.concatenate([t[:300], t[350:]]), slice(600, 625))))
    with pytest.raises(ChannelError, match="jitter, steps of .*resample"):
        inspect_record(written(t + rng.uniform(-0.3, 0.3, 1000) / 256))
    # a time rounded to milliseconds is no jitter of the clock: the cure says so, and works
    with pytest.raises(ChannelError, match="only rounded.*t = 'none'.*fs=256") as caught:
        inspect_record(written(t.round(3)))
    assert "jitter" in str(caught.value)
    assert inspect_record(path, mapping={"t": "none"}, fs=256.0).clock == "256 Hz, as given"


def test_timestamps(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time,a1\n2024-05-01T12:00:00.00,1\n2024-05-01T12:00:00.25,2\n2024-05-01T12:00:00.50,3\n")
    assert read_record(path).fs == pytest.approx(4.0)


def test_a_record_survives_csv_and_parquet(tmp_path):
    rng = np.random.default_rng(0)
    from pysindy_nrf import Record

    rec = Record(
        force=rng.normal(size=(100, 2)),
        acceleration=rng.normal(size=(100, 2)),
        fs=128.0,
        base_acceleration=rng.normal(size=100),
    )
    rec.to_frame().to_csv(tmp_path / "r.csv")
    rec.to_frame().to_parquet(tmp_path / "r.parquet")
    for name in ("r.csv", "r.parquet"):
        back = read_record(tmp_path / name)
        pd.testing.assert_frame_equal(back.to_frame(), rec.to_frame())
        assert back.fs == rec.fs
