"""From files to records: types of files, units by header, option and mapping, several
files, words on the result.
"""

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pysindy_nrf import io
from pysindy_nrf.exceptions import ChannelError, FileFormatError
from pysindy_nrf.records.files import (
    describe,
    inspect_record,
    read_record,
    read_table,
    write_record,
)
from pysindy_nrf.records.files.reading import read_excitation
from pysindy_nrf.records.files.summary import summary

T = np.arange(200) / 100.0


@pytest.fixture
def csv(tmp_path):
    path = tmp_path / "shaker.csv"
    t = np.arange(400) / 200
    columns = {
        "t": t,
        "F2": np.sin(9 * t),
        "a1": np.sin(t),
        "a2": np.cos(t),
        "x1 [mm]": t,
        "x2 [mm]": 2 * t,
    }
    frame = pd.DataFrame(columns | {"operator": "Ann"})
    frame.to_csv(path, index=False)
    return path, frame


def test_units_from_header_option_and_mapping(csv):
    path, f = csv
    rec = read_record(
        path, units={"a": "g", "F2": "kN", "x2": "in"}, mapping={"a2": "a2 @ cm/s^2"}
    )
    np.testing.assert_allclose(
        rec.acceleration,
        np.column_stack([9.80665 * f["a1"], 0.01 * f["a2"]]),
        rtol=1e-12,
    )
    expected = np.column_stack([1e-3 * f["x1 [mm]"], 0.0254 * f["x2 [mm]"]])
    np.testing.assert_allclose(rec.displacement, expected, rtol=1e-12)
    np.testing.assert_allclose(
        rec.force, np.column_stack([0 * f["t"], 1e3 * f["F2"]]), rtol=1e-12
    )
    assert "a1" not in read_record(path, mapping={"a1": "none", "a2": "none"}).measured
    with pytest.raises(ChannelError, match="'v1'"):
        read_record(path, units={"v1": "mm/s"})


def test_the_description_names_origin_units_and_forces(csv):
    path, _ = csv
    text = describe(inspect_record(path, units={"a": "g"}))
    assert "2 DOFs, 400 samples at 200 Hz, 2 s" in text
    assert "forced: DOF 2; known to be unforced: DOF 1" in text
    assert "<- in g" in text and "<- in mm" in text and "not used: operator" in text
    data = summary(read_record(path))
    assert data["forced"] == [2] and data["channels"]["F2"]["unit"] == "N"
    assert "force unknown: DOF 2" in describe(
        inspect_record(path, mapping={"F2": "unknown"})
    )


def test_files_of_one_test_share_names_clock_and_rate(tmp_path, small):
    frame = pd.DataFrame({"t": T, "x1": np.sin(T)})
    (tmp_path / "b").mkdir()
    frame.to_csv(tmp_path / "one.csv", index=False)
    frame.to_csv(tmp_path / "b" / "one.csv", index=False)
    frame.assign(t=T + 0.003).to_csv(tmp_path / "late.csv", index=False)
    write_record(small(), tmp_path / "fast.csv")
    write_record(small(fs=50.0), tmp_path / "slow.csv")
    for names, words in {
        (): "No file was given",
        ("one.csv", "b/one.csv"): "Two files are called 'one'",
        ("one.csv", "late.csv"): "The times of the files 'one' and 'late' differ",
        (
            "fast.csv",
            "slow.csv",
        ): "sampled differently: fast.csv 100 Hz, slow.csv 50 Hz",
    }.items():
        with pytest.raises(FileFormatError, match=words):
            read_table([tmp_path / name for name in names])


def test_columns_by_matrix_name_or_twice(tmp_path):
    np.savez(tmp_path / "m.npz", t=T, a=np.column_stack([np.sin(T), np.cos(T)]))
    np.testing.assert_array_equal(
        read_record(tmp_path / "m.npz").acceleration[:, 1], np.cos(T)
    )
    np.savez(tmp_path / "twice.npz", t=T, x1=T, X1=T)
    with pytest.raises(FileFormatError, match="two columns that are channel x1"):
        read_record(tmp_path / "twice.npz")


def test_a_covariate_of_a_record_stays_one_under_a_mapping(tmp_path, small):
    path = write_record(
        small(covariates={"temperature": 20 + T}), tmp_path / "small.csv"
    )
    again = read_record(path, mapping={"v1": "x1"}, units={"v1": "m/s"})
    np.testing.assert_array_equal(again.covariates["temperature"], 20 + T)
    with pytest.raises(ChannelError, match="coordinates='polar' is unknown"):
        read_record(path, coordinates="polar")


def test_excitations(tmp_path):
    path = tmp_path / "a.csv"
    pd.DataFrame({"t": T, "F1": np.cos(T), "x1": T}).to_csv(path, index=False)
    load = read_excitation(
        path, 2, mapping={"x2": "laser"}, units={"F": "kN", "x": "mm"}
    )  # motions do not matter
    np.testing.assert_allclose(
        load.force, np.column_stack([1e3 * np.cos(T), 0 * T]), rtol=1e-12
    )
    with pytest.raises(ChannelError, match="F1 is unknown"):
        read_excitation(path, 1, mapping={"F1": "unknown"})
    with pytest.raises(
        ChannelError, match="F2 acts on a DOF that the model does not have"
    ):
        read_excitation(path, 1, mapping={"F2": "F1"})
    with pytest.raises(
        FileFormatError,
        match="no column is known to be a force or the base acceleration",
    ):
        read_excitation(path, 1, mapping={"F1": "none"})


def test_files_of_another_type_than_their_name(tmp_path):
    np.savez(tmp_path / "a.npz", x=T)
    (tmp_path / "b.csv").write_bytes((tmp_path / "a.npz").read_bytes())
    (tmp_path / "a.xyz").write_text("t,a1\n0,1\n")
    (tmp_path / "c.csv").write_text("The quick brown fox\njumps over\n")
    savemat(tmp_path / "d.mat", {"note": "only text"})
    for name, words in {
        "a.xyz": r"type \.xyz",
        "b.csv": "called .csv but holds Excel or NPZ",
        "c.csv": "no rows of numbers",
        "": "not a file",
        "d.mat": "no channel of numbers",
    }.items():
        with pytest.raises(FileFormatError, match=words):
            read_table(tmp_path / name)


def test_several_files_keep_the_unit_of_their_time(tmp_path):
    t = np.arange(200) * 1e-3
    pd.DataFrame({"t [ms]": 1e3 * t, "a1": np.sin(30 * t)}).to_csv(
        tmp_path / "A.csv", index=False
    )
    pd.DataFrame({"t [ms]": 1e3 * t, "x1": np.sin(30 * t)}).to_csv(
        tmp_path / "B.csv", index=False
    )
    pd.DataFrame({"t [s]": 1e3 * t, "x1": np.sin(30 * t)}).to_csv(
        tmp_path / "C.csv", index=False
    )
    mapping = {"a1": "A.a1", "x1": "B.x1"}
    assert io.read_record(
        [tmp_path / "A.csv", tmp_path / "B.csv"], mapping=mapping
    ).fs == pytest.approx(1000.0)
    with pytest.raises(FileFormatError, match="different units: ms, s"):
        io.read_table([tmp_path / "A.csv", tmp_path / "C.csv"])
