"""From files to records: units, several files, descriptions, excitations."""

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pysindy_nrf.exceptions import (
    ChannelError,
    DataQualityWarning,
    FileFormatError,
)
from pysindy_nrf.records import read_excitation, summary
from pysindy_nrf.records.files import (
    describe,
    inspect_record,
    read_record,
    read_table,
    write_record,
)

T = np.arange(200) / 100.0
SHAKER = pd.DataFrame(
    {
        "t": T,
        "F2": np.sin(9 * T),
        "a1": np.sin(T),
        "a2": np.cos(T),
        "x1 [mm]": T,
        "x2 [mm]": 2 * T,
        "operator": "Ann",
    }
)


@pytest.fixture
def csv(tmp_path):
    """Function that writes columns as delimited text and returns the path."""

    def write(columns, name="test.csv"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        pd.DataFrame(columns).to_csv(path, index=False)
        return path

    return write


def test_units_from_header_option_and_mapping(csv):
    units = {"a": "g", "F2": "kN", "x2": "in"}
    record = read_record(csv(SHAKER), units=units, mapping={"a2": "a2 @ cm/s^2"})
    expected = [9.80665 * np.sin(T), 0.01 * np.cos(T)]
    np.testing.assert_allclose(record.acceleration.T, expected, rtol=1e-12)
    expected = [1e-3 * T, 0.0254 * 2 * T]
    np.testing.assert_allclose(record.displacement.T, expected, rtol=1e-12)
    expected = [0 * T, 1e3 * np.sin(9 * T)]
    np.testing.assert_allclose(record.force.T, expected, rtol=1e-12)


def test_a_channel_may_be_dropped(csv):
    record = read_record(csv(SHAKER), mapping={"a1": "none", "a2": "none"})
    assert "a1" not in record.measured


def test_a_unit_of_a_channel_that_is_not_there(csv):
    with pytest.raises(ChannelError, match="'v1'"):
        read_record(csv(SHAKER), units={"v1": "mm/s"})


def test_the_description_names_origin_units_and_forces(csv):
    text = describe(inspect_record(csv(SHAKER), units={"a": "g"}))
    assert "2 DOFs, 200 samples at 100 Hz, 2 s" in text
    assert "forced: DOF 2; no column is a force on DOF 1" in text
    assert "<- in g" in text
    assert "<- in mm" in text
    assert "not used: operator" in text


def test_an_unknown_force_is_described(csv):
    text = describe(inspect_record(csv(SHAKER), mapping={"F2": "unknown"}))
    assert "force unknown: DOF 2" in text


def test_the_summary_is_plain_data(csv):
    data = summary(read_record(csv(SHAKER)))
    assert data["forced"] == [2]
    assert data["channels"]["F2"]["unit"] == "N"


def test_names_are_escaped_in_html(small):
    record = small(name="<img>", covariates={"<b>": T})
    html = record._repr_html_()
    assert "<img" not in html
    assert "<b>&lt;b" not in html
    assert "&lt;img&gt;" in html
    assert "displacement relative to base" in html


def test_files_of_one_test_have_names_of_their_own(csv):
    paths = [csv(SHAKER, "one.csv"), csv(SHAKER, "b/one.csv")]
    with pytest.raises(FileFormatError, match="Two files are called 'one'"):
        read_table(paths)
    with pytest.raises(FileFormatError, match="No file was given"):
        read_table([])


def test_files_with_other_rates_come_to_the_slower_one(tmp_path, small):
    paths = [
        write_record(small(), tmp_path / "fast.csv"),
        write_record(small(fs=50.0), tmp_path / "slow.csv"),
    ]
    mapping = {"F1": "fast.F1", "x1": "slow.x1"}
    record = read_record(paths, mapping=mapping)
    assert record.fs == 50
    assert "resampled" in {note.kind for note in record.quality}


def test_files_of_one_test_keep_the_unit_of_their_time(csv):
    a = csv({"t [ms]": T, "a1": np.sin(30 * T)}, "A.csv")
    b = csv({"t [ms]": T, "x1": np.sin(30 * T)}, "B.csv")
    record = read_record([a, b], mapping={"a1": "A.a1", "x1": "B.x1"})
    assert record.fs == pytest.approx(100e3)
    c = csv({"t [s]": T, "x1": np.sin(30 * T)}, "C.csv")
    with pytest.raises(ChannelError, match="less than half of the test in common"):
        read_record([a, c], mapping={"a1": "A.a1", "x1": "C.x1"})


def test_a_matrix_named_as_a_channel_is_one_channel_a_column(tmp_path):
    path = tmp_path / "m.npz"
    np.savez(path, t=T, a=np.column_stack([np.sin(T), np.cos(T)]))
    np.testing.assert_array_equal(read_record(path).acceleration[:, 1], np.cos(T))


def test_two_columns_of_one_channel_are_refused(tmp_path):
    path = tmp_path / "twice.npz"
    np.savez(path, t=T, x1=T, X1=T)
    with pytest.raises(FileFormatError, match="two columns .* channel x1"):
        read_record(path)


def test_a_covariate_of_a_record_stays_one_under_a_mapping(tmp_path, small):
    record = small(covariates={"temperature": 20 + T})
    path = write_record(record, tmp_path / "small.csv")
    again = read_record(path, mapping={"v1": "x1"}, units={"v1": "m/s"})
    np.testing.assert_array_equal(again.covariates["temperature"], 20 + T)


def test_unknown_coordinates_are_refused(csv):
    with pytest.raises(ChannelError, match="coordinates='polar' is unknown"):
        read_record(csv(SHAKER), coordinates="polar")


@pytest.fixture
def load_file(csv):
    return csv({"t": T, "F1": np.cos(T), "x1": T})


def test_motions_do_not_matter_to_an_excitation(load_file):
    units = {"F": "kN", "x": "mm"}
    load = read_excitation(load_file, 2, mapping={"x2": "laser"}, units=units)
    expected = [1e3 * np.cos(T), 0 * T]
    np.testing.assert_allclose(load.force.T, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ({"F1": "unknown"}, "F1 is unknown"),
        ({"F2": "F1"}, "F2 acts on a DOF"),
        ({"F1": "none"}, "no column .* a force"),
    ],
)
def test_excitations_that_cannot_be(load_file, mapping, words):
    with pytest.raises((ChannelError, FileFormatError), match=words):
        read_excitation(load_file, 1, mapping=mapping)


def test_files_of_another_type_than_their_name(tmp_path):
    np.savez(tmp_path / "a.npz", x=T)
    (tmp_path / "b.csv").write_bytes((tmp_path / "a.npz").read_bytes())
    (tmp_path / "a.xyz").write_text("t,a1\n0,1\n")
    (tmp_path / "c.csv").write_text("The quick brown fox\njumps over\n")
    savemat(tmp_path / "d.mat", {"note": "only text"})
    reasons = {
        "a.xyz": r"type \.xyz",
        "b.csv": "called .csv but holds Excel or NPZ",
        "c.csv": "no rows of numbers",
        "": "not a file",
        "d.mat": "no channel of numbers",
    }
    for name, words in reasons.items():
        with pytest.raises(FileFormatError, match=words):
            read_table(tmp_path / name)


def test_capitals_of_a_suffix_do_not_matter(tmp_path):
    np.savez(tmp_path / "a.npz", x=T)
    capitals = (tmp_path / "a.npz").rename(tmp_path / "A.NPZ")
    np.testing.assert_array_equal(read_table(capitals).variables["x"], T)


@pytest.mark.parametrize(
    ("column", "words"),
    [("Shaker [kN]", "seems to be a force"), ("Table acc [g]", "motion of the base")],
)
def test_what_no_channel_uses_is_not_zero_in_silence(csv, column, words):
    path = csv({"t": T, "x1": np.sin(30 * T), column: np.cos(30 * T)})
    with pytest.warns(DataQualityWarning, match=words):
        read_record(path)


def test_what_is_not_measured_is_not_called_known(csv):
    text = describe(inspect_record(csv({"t": T, "x1": np.sin(30 * T)})))
    assert "no column is a force on DOF 1" in text
    assert "no column is a motion of the base" in text


def test_the_mean_of_two_sensors_of_a_floor(csv):
    """Torsion, which the two see with opposite signs, is left out."""
    sway, twist = np.sin(30 * T), np.cos(17 * T)
    path = csv({"t": T, "left [g]": sway + twist, "right [g]": sway - twist})
    record = read_record(path, mapping={"a1": "mean(left, right)"})
    np.testing.assert_allclose(record.acceleration[:, 0], 9.80665 * sway, atol=1e-12)
    record = read_record(path, mapping={"a1": "sum(left, -right) * 0.5 @ m/s^2"})
    np.testing.assert_allclose(record.acceleration[:, 0], twist, atol=1e-12)


def test_a_mean_of_columns_in_two_units(csv):
    path = csv({"t": T, "left [g]": T, "right [gal]": T})
    with pytest.raises(ChannelError, match="combines columns in"):
        read_record(path, mapping={"a1": "mean(left, right)"})


UNREAD = ["EU", "-", "V", "kg", "mm (rel)"]


@pytest.mark.parametrize("unit", UNREAD)
@pytest.mark.parametrize("channel", ["a1", "x1", "v1", "ag"])
def test_a_channel_by_name_in_no_known_unit_is_refused(csv, channel, unit):
    path = csv({"t": T, "x2": T, f"{channel} [{unit}]": T})
    with pytest.raises(ChannelError, match=f"is {channel} by its name"):
        read_record(path)
    assert channel not in read_record(path, mapping={channel: "none"}).measured
