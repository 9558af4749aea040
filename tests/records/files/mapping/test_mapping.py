"""Mapping of columns to channels: the grammar, and mapping files."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from text_tables import rows_of

from pysindy_nrf.cli import run
from pysindy_nrf.exceptions import ChannelError, FileFormatError
from pysindy_nrf.records import read_mapping
from pysindy_nrf.records.files import read_record

DOCS = Path(__file__).parents[4] / "docs"
T = np.arange(50) / 100
ACC = np.column_stack([np.sin(20 * T), np.cos(20 * T), T])


@pytest.fixture
def archive(tmp_path):
    """A file whose variables have names of their own."""
    path = tmp_path / "test 7.npz"
    lines = {"zeit": 1e3 * T, "drive": T + 1, "voltage": 2 * T, "short": T[:9]}
    np.savez(path, **lines, acc=ACC, wide=ACC.T, gain=35.1507)
    return path


def test_a_mapping_has_a_sign_a_column_a_factor_and_a_unit(archive):
    accelerations = {"a1": "acc[:, 0] @ g", "a2": "-acc[:, -2]*2", "a3": "wide[2, :]"}
    forces = {"F1": "drive*gain", "F2": "drive * 1e3", "F3": "unknown"}
    others = {"t": "zeit @ ms", "u": "voltage"}
    record = read_record(archive, mapping=accelerations | forces | others)

    assert record.fs == pytest.approx(100)
    assert record.name == "test 7"
    assert record.unknown == (3,)
    expected = [9.80665 * ACC[:, 0], -2 * ACC[:, 1], ACC[:, 2]]
    np.testing.assert_allclose(record.acceleration.T, expected, rtol=1e-14)
    expected = [35.1507 * (T + 1), 1e3 * (T + 1)]
    np.testing.assert_allclose(record.force[:, :2].T, expected, rtol=1e-14)
    np.testing.assert_array_equal(record.covariates["u"], 2 * T)


BAD_MAPPINGS = r"""
    x1  nope           no variable 'nope'.*acc 50x3
    x1  acc            shape \(50, 3\).*acc\[:, 0\]
    x1  acc[:, 3]      no column 3
    x1  drive + 2      no variable 'drive \+ 2'
    x1  drive*2*3      not understood
    x1  drive*volts    factor 'volts'
    x1  drive*0        factor '0'
    x1  drive @ wug    unit 'wug'
    x1  drive @ g      x1 is a displacement.*measures acceleration
    x   drive          no number
    x1  unknown        cannot be 'unknown'
    F1  drive          no column.*motion
    x1  ().__class__   no variable|understood
    x1  exec(open('x').read())                           no variable
    x1  __import__('os').system('touch mark')            no variable
    x1  drive*__import__('os').system('touch mark')      factor|understood
"""


@pytest.mark.parametrize(("channel", "text", "words"), rows_of(BAD_MAPPINGS))
def test_a_bad_mapping_is_named_and_never_run(
    archive, channel, text, words, monkeypatch
):
    monkeypatch.chdir(archive.parent)
    with pytest.raises((ChannelError, FileFormatError), match=words):
        read_record(archive, mapping={channel: text}, fs=100.0)
    assert not Path("mark").exists()


def test_mapped_channels_have_one_length(archive):
    with pytest.raises(ChannelError, match="differ in length"):
        read_record(archive, mapping={"x1": "short", "F1": "drive"}, fs=100.0)


def test_the_example_of_the_documentation_runs(here, capsys):
    """The file printed in docs/files.md, with data as it describes them."""
    pytest.importorskip("pint")
    page = (DOCS / "files.md").read_text("utf-8")
    text = re.search(r"```toml\n(.*?)```", page, re.DOTALL)[1]
    Path("campaign.toml").write_text(text)
    t = np.arange(500) / 250
    y = np.sin(9 * t)
    columns = {"Zeit": 1e3 * t, "Shaker": 2 * y, "Acc. 1": y, "Acc. 2": 2 * y}
    table = pd.DataFrame(columns | {"Laser 2": 5 * y})
    for name in ("shaker_1.csv", "shaker_2.csv"):
        table.to_csv(name, index=False)

    mapping = read_mapping("campaign.toml")
    record = read_record(
        mapping.files[0],
        mapping=mapping.channels,
        units=mapping.units,
        fs=mapping.fs,
        coordinates=mapping.coordinates,
    )
    assert record.fs == 250
    assert record.forced == (2,)
    np.testing.assert_allclose(record.force[:, 1], 2e3 * y, rtol=1e-12)
    np.testing.assert_allclose(record.acceleration[:, 0], -9.80665 * y, rtol=1e-12)
    np.testing.assert_allclose(record.displacement[:, 1], 5e-3 * y, rtol=1e-12)

    assert run(["inspect", "--mapping", "campaign.toml"]) == 0
    shown = capsys.readouterr().out
    assert shown.count("500 samples at 250 Hz") == 2
    assert "<- -Acc. 1 in g" in shown


def test_options_go_before_the_mapping_file(here, spoken):
    t = np.arange(100) / 50
    pd.DataFrame({"t": t, "p": t, "q": 3 * t}).to_csv("a.csv", index=False)
    Path("m.toml").write_text('name = "hit"\n[channels]\nx1 = "p"\n')
    options = ["--mapping", "m.toml", "--map", "x1=q", "--json"]
    assert run(["inspect", "a.csv", *options]) == 0
    record = spoken()["records"][0]
    assert record["name"] == "hit"
    assert record["sources"]["x1"]["from"] == "q"


def test_the_course_of_the_forces_is_said_in_a_mapping_file_or_an_option(here, spoken):
    t = np.arange(100) / 50
    pd.DataFrame({"t": t, "x1": t**2, "F1": t}).to_csv("a.csv", index=False)
    Path("m.toml").write_text('hold = "zero"\n')
    for options, course in [
        ([], None),
        (["--mapping", "m.toml"], "zero"),
        (["--mapping", "m.toml", "--hold", "linear"], "linear"),
    ]:
        assert run(["inspect", "a.csv", *options, "--json"]) == 0
        assert spoken()["records"][0]["hold"] == course


@pytest.fixture
def campaign(tmp_path):
    """A folder with a mapping file, beside a file that does not belong to it."""
    folder = tmp_path / "campaign"
    (folder / "sub").mkdir(parents=True)
    (tmp_path / "secret.csv").write_text("t,x1\n0,1\n1,2\n")
    (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
    return folder / "m.toml"


@pytest.mark.parametrize(
    "name",
    ["../secret.csv", "link.csv", "sub/../../secret.csv", ".", "a\u0000b", "/etc"],
)
def test_files_outside_the_folder_of_a_mapping_file_are_refused(campaign, name):
    campaign.write_text(f"files = [{json.dumps(name)}]\n")
    with pytest.raises(FileFormatError, match="not in the folder"):
        read_mapping(campaign)


def test_files_in_the_folder_of_a_mapping_file_or_below_are_taken(campaign):
    campaign.write_text('files = ["sub/test.csv", "./own.csv"]\n')
    names = [path.name for path in read_mapping(campaign).files]
    assert names == ["test.csv", "own.csv"]


BAD_ENTRIES = f"""
    chanels = {{}}            'chanels' is unknown.*'channels'
    fs = -5                 fs = -5 is not
    fs = true               fs = True is not
    fs = nan                fs = nan is not
    fs = {"5" * 400}  is not a positive number
    fs = {"5" * 5000}  mapping file
    fs = 0x{"f" * 5000}  too long to print
    coordinates = "polar"   'relative' or 'absolute'
    hold = "quintic"        'cubic', 'linear' or 'zero'
    files = "a.csv"         a list of file names
    files = []              a list of file names
    together = 1            true or false
    channels.F1 = 3         channels.F1 = 3 is not
    units.a = ''            units.a = '' is not
    channels = 5            channels = 5 is not
    name = [1]              name = .* is not
    = broken                mapping file
"""


@pytest.mark.parametrize(
    ("entry", "words"), rows_of(BAD_ENTRIES), ids=lambda text: text[:24]
)
def test_a_wrong_entry_is_named(written, entry, words):
    with pytest.raises(FileFormatError, match=words):
        read_mapping(written(f"{entry}\n", "m.toml"))
