"""Mapping of columns to channels: the grammar, which is never run as code, and mapping
files.
"""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf.cli.group import run
from pysindy_nrf.exceptions import ChannelError, FileFormatError
from pysindy_nrf.records.files import read_record
from pysindy_nrf.records.files.mapping import read_mapping

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture
def archive(tmp_path):
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
    np.savez(tmp_path / "test 7.npz", **content)
    return tmp_path / "test 7.npz", t, acc


def test_the_mapping_grammar(archive):
    path, t, acc = archive
    rec = read_record(
        path,
        mapping={
            "t": "zeit @ ms",
            "a1": "acc[:, 0] @ g",
            "a2": "-acc[:, -2]*2",
            "a3": "wide[2, :]",
            "F1": "drive*gain",
            "F2": "drive * 1e3",
            "F3": "unknown",
            "u": "voltage",
        },
    )
    assert rec.fs == pytest.approx(100) and rec.name == "test 7" and rec.unknown == (3,)
    expected = np.column_stack([9.80665 * acc[:, 0], -2 * acc[:, 1], acc[:, 2]])
    np.testing.assert_allclose(rec.acceleration, expected, rtol=1e-14)
    np.testing.assert_allclose(
        rec.force[:, :2],
        np.column_stack([35.1507 * (t + 1), 1e3 * (t + 1)]),
        rtol=1e-14,
    )
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
        (
            {"x1": "drive @ g"},
            "x1 is a displacement, but its unit 'g' measures acceleration",
        ),
        ({"x": "drive"}, "no number"),
        ({"x1": "unknown"}, "cannot be 'unknown'"),
        ({"F1": "drive"}, "no column is known to be a motion"),
        ({"x1": "__import__('os').system('touch mark')"}, "no variable"),
        ({"x1": "drive*__import__('os').system('touch mark')"}, "factor|understood"),
        ({"x1": "exec(open('x').read())"}, "no variable"),
        ({"x1": "().__class__"}, "no variable|understood"),
    ],
)
def test_a_bad_mapping_names_the_channel_and_is_never_run(
    archive, mapping, message, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    path, *_ = archive
    with pytest.raises((ChannelError, FileFormatError), match=message):
        read_record(path, mapping=mapping, fs=100.0)
    assert not (tmp_path / "mark").exists()


def test_the_example_of_the_documentation_runs(tmp_path, monkeypatch, capsys):
    """The file printed in docs/files.md, with data as it describes them."""
    pytest.importorskip("pint")
    monkeypatch.chdir(tmp_path)
    text = re.search(
        r"```toml\n(.*?)```", (DOCS / "files.md").read_text("utf-8"), re.DOTALL
    )[1]
    Path("campaign.toml").write_text(text)
    t = np.arange(500) / 250
    y = np.sin(9 * t)
    table = pd.DataFrame(
        {
            "Zeit": 1e3 * t,
            "Shaker": 2 * y,
            "Acc. 1": y,
            "Acc. 2": 2 * y,
            "Laser 2": 5 * y,
        }
    )
    for name in ("shaker_1.csv", "shaker_2.csv"):
        table.to_csv(name, index=False)
    said = read_mapping("campaign.toml")
    rec = read_record(
        said.files[0],
        mapping=said.channels,
        units=said.units,
        fs=said.fs,
        coordinates=said.coordinates,
    )
    assert rec.fs == 250 and rec.forced == (2,)
    np.testing.assert_allclose(rec.force[:, 1], 2e3 * y, rtol=1e-12)
    np.testing.assert_allclose(rec.acceleration[:, 0], -9.80665 * y, rtol=1e-12)
    np.testing.assert_allclose(rec.displacement[:, 1], 5e-3 * y, rtol=1e-12)
    assert run(["inspect", "--mapping", "campaign.toml"]) == 0
    shown = capsys.readouterr().out
    assert shown.count("500 samples at 250 Hz") == 2 and "<- -Acc. 1 in g" in shown


def test_options_go_before_the_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.arange(100) / 50
    pd.DataFrame({"t": t, "p": t, "q": 3 * t}).to_csv("a.csv", index=False)
    Path("m.toml").write_text('name = "hit"\n[channels]\nx1 = "p"\n')
    assert (
        run(["inspect", "a.csv", "--mapping", "m.toml", "--map", "x1=q", "--json"]) == 0
    )
    record = json.loads(capsys.readouterr().out)["records"][0]
    assert record["name"] == "hit" and record["sources"]["x1"]["from"] == "q"


def test_mapping_files_stay_in_their_folder(tmp_path):
    inside = tmp_path / "campaign"
    (inside / "sub").mkdir(parents=True)
    (tmp_path / "secret.csv").write_text("t,x1\n0,1\n1,2\n")
    (inside / "link.csv").symlink_to(tmp_path / "secret.csv")
    for name in (
        "../secret.csv",
        str(tmp_path / "secret.csv"),
        "link.csv",
        "sub/../../secret.csv",
        ".",
        "a\\u0000b",
    ):
        (inside / "m.toml").write_text(f'files = ["{name}"]\n')
        with pytest.raises(
            FileFormatError, match="not in the folder of the mapping file"
        ):
            read_mapping(inside / "m.toml")
    (inside / "m.toml").write_text('files = ["sub/test.csv", "./own.csv"]\n')
    assert [p.name for p in read_mapping(inside / "m.toml").files] == [
        "test.csv",
        "own.csv",
    ]


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
def test_a_wrong_key_is_named(written, text, words):
    with pytest.raises(FileFormatError, match=words):
        read_mapping(written(text + "\n", "m.toml"))
