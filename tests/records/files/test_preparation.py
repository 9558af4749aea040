"""A part of a test, a lower rate, rows without values, relative accelerations."""

import json

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf.cli import run
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import Preparation
from pysindy_nrf.records.files import read_record

T = np.arange(4000) / 400
SWAY = np.sin(2 * np.pi * 3 * T)
WHISTLE = np.sin(2 * np.pi * 90 * T)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = pd.DataFrame({"t": T, "a1": SWAY + WHISTLE, "ag": WHISTLE, "x1": SWAY})
    table.to_csv("own.csv", index=False)
    return table


def test_a_part_of_the_test(folder):
    record = read_record("own.csv", preparation=Preparation(start=2.0, stop=3.5))
    assert record.n_samples == 600
    assert record.time[0] == pytest.approx(2.0)
    with pytest.raises(ChannelError, match="no samples"):
        read_record("own.csv", preparation=Preparation(start=20.0))


def test_a_lower_rate_has_a_band_limit(folder):
    """90 Hz would be 10 Hz at 100 samples a second; the sway stays as it is."""
    record = read_record("own.csv", preparation=Preparation(fs=100.0))
    assert record.fs == 100
    inside = slice(40, -40)
    expected = np.sin(2 * np.pi * 3 * record.time)[inside]
    np.testing.assert_allclose(record.acceleration[inside, 0], expected, atol=2e-3)
    assert "resampled" in {note.kind for note in record.quality}
    with pytest.raises(ChannelError, match="lower rate"):
        read_record("own.csv", preparation=Preparation(fs=500.0))


def test_accelerations_relative_to_the_base(folder):
    how = Preparation(relative_acceleration=True)
    record = read_record("own.csv", preparation=how)
    np.testing.assert_allclose(record.acceleration[:, 0], SWAY + 2 * WHISTLE)
    with pytest.raises(ChannelError, match="lacks the acceleration of the base"):
        read_record("own.csv", mapping={"ag": "none"}, preparation=how)


def test_rows_in_which_a_channel_is_empty(folder):
    folder.loc[3990:, "x1"] = np.nan
    folder.loc[0, "t"] = np.nan
    folder.to_csv("own.csv", index=False)
    with pytest.raises(ChannelError, match="not finite in row 0"):
        read_record("own.csv")
    record = read_record("own.csv", preparation=Preparation(drop_blank=True))
    assert record.n_samples == 3989


def test_a_hole_that_blank_rows_leave_is_found(folder):
    folder.loc[2000:2003, "x1"] = np.nan
    folder.to_csv("own.csv", index=False)
    with pytest.raises(ChannelError, match="gap"):
        read_record("own.csv", preparation=Preparation(drop_blank=True))
    with pytest.raises(ChannelError, match="without a time"):
        read_record(
            "own.csv",
            mapping={"t": "none"},
            fs=400.0,
            preparation=Preparation(drop_blank=True),
        )


def measured(capsys, *words):
    assert run(["inspect", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)["records"][0]


def test_the_command_line_cuts_and_shapes(folder, capsys):
    flags = ["--from", "2", "--to", "4", "--resample", "100", "--relative-acceleration"]
    record = measured(capsys, "own.csv", *flags)
    assert record["n_samples"] == 200
    assert record["fs"] == 100
    record = measured(capsys, "own.csv", "--map", "a1=mean(a1, -ag)")
    assert record["channels"]["a1"]["rms"] == pytest.approx(0.5 / np.sqrt(2), rel=1e-3)


def test_the_mapping_file_cuts_and_shapes(folder, capsys):
    text = 'files = ["own.csv"]\n[prepare]\nfrom = 1\nto = 3\nresample = 100\n'
    with open("own.toml", "w") as file:
        file.write(text)
    assert measured(capsys, "--mapping", "own.toml")["n_samples"] == 200
    # options go before the file
    record = measured(capsys, "--mapping", "own.toml", "--from", "2")
    assert record["n_samples"] == 100


@pytest.mark.parametrize("line", ["until = 3", "from = 'now'", "drop_blank = 1"])
def test_preparations_that_are_not_understood(folder, capsys, line):
    with open("own.toml", "w") as file:
        file.write(f'files = ["own.csv"]\n[prepare]\n{line}\n')
    assert run(["inspect", "--mapping", "own.toml"]) == 3
    assert line.split()[0] in capsys.readouterr().err
