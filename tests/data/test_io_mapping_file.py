"""The mapping file: what it says is what is read; what it says wrongly is named."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf.data.io import read_mapping, read_record
from pysindy_nrf.exceptions import FileFormatError
from pysindy_nrf.output.cli.group import run

DOCS = Path(__file__).parents[2] / "docs"


def test_the_example_of_the_documentation_runs(tmp_path, monkeypatch, capsys):
    """The file printed in docs/files.md, with data as it describes them."""
    pytest.importorskip("pint")
    monkeypatch.chdir(tmp_path)
    text = re.search(r"```toml\n(.*?)```", (DOCS / "files.md").read_text("utf-8"), re.DOTALL)[1]
    Path("campaign.toml").write_text(text)
    t = np.arange(500) / 250
    motion = np.sin(9 * t)
    for name in ("shaker_1.csv", "shaker_2.csv"):
        pd.DataFrame({
            "Zeit": 1e3 * t, "Shaker": 2 * motion, "Acc. 1": motion, "Acc. 2": 2 * motion, "Laser 2": 5 * motion
        }).to_csv(name, index=False)  # fmt: skip
    said = read_mapping("campaign.toml")
    rec = read_record(said.files[0], mapping=said.channels, units=said.units, fs=said.fs, coordinates=said.coordinates)
    assert rec.fs == 250 and rec.forced == (2,)
    np.testing.assert_allclose(rec.force[:, 1], 2e3 * motion, rtol=1e-12)
    np.testing.assert_allclose(rec.acceleration[:, 0], -9.80665 * motion, rtol=1e-12)
    np.testing.assert_allclose(rec.displacement[:, 1], 5e-3 * motion, rtol=1e-12)
    assert run(["inspect", "--mapping", "campaign.toml"]) == 0
    shown = capsys.readouterr().out
    assert shown.count("500 samples at 250 Hz") == 2 and "<- -Acc. 1 in g" in shown


def test_options_go_before_the_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.arange(100) / 50
    pd.DataFrame({"t": t, "p": t, "q": 3 * t}).to_csv("a.csv", index=False)
    Path("m.toml").write_text('name = "hit"\n[channels]\nx1 = "p"\n')
    assert run(["inspect", "a.csv", "--mapping", "m.toml", "--map", "x1=q", "--json"]) == 0
    import json

    record = json.loads(capsys.readouterr().out)["records"][0]
    assert record["name"] == "hit" and record["sources"]["x1"]["from"] == "q"


def test_channels_of_one_test_in_several_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.arange(100) / 50
    for name in ("floor1", "floor2"):
        pd.DataFrame({"t": t, "acc": t}).to_csv(f"{name}.csv", index=False)
    Path("m.toml").write_text(
        'files = ["floor1.csv", "floor2.csv"]\ntogether = true\nname = "both"\n'
        '[channels]\na1 = "floor1.acc"\na2 = "floor2.acc"\n'
    )
    assert run(["inspect", "--mapping", "m.toml"]) == 0
    assert "both from floor1.csv: 2 DOFs, 100 samples at 50 Hz" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("chanels = {}", "'chanels' is unknown; did you mean 'channels'"),
        ("fs = -5", "fs = -5 is not a positive number"),
        ("fs = true", "fs = True is not a positive number"),
        ("fs = nan", "fs = nan is not"),
        (f"fs = {'5' * 400}", "is not a positive number"),
        (f"fs = {'5' * 5000}", "mapping file"),
        (f"fs = 0x{'f' * 5000}", "a number too long to print is not a positive number"),
        ('coordinates = "polar"', "'relative' or 'absolute'"),
        ('files = "a.csv"', "a list of file names"),
        ("files = []", "a list of file names"),
        ("together = 1", "true or false"),
        ("[channels]\nF1 = 3", "channels.F1 = 3 is not a text"),
        ("[units]\na = ''", "units.a = '' is not a text"),
        ("channels = 5", "channels = 5 is not a table"),
        ("name = [1]", "name = .* is not a text"),
        ("= broken", "mapping file"),
    ],
)
def test_a_wrong_key_is_named(tmp_path, text, words):
    path = tmp_path / "m.toml"
    path.write_text(text + "\n")
    with pytest.raises(FileFormatError, match=words):
        read_mapping(path)
