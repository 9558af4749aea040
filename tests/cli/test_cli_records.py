"""Commands on records and runs: what a file holds, runs of a model, plans of a test,
pages.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report_cases import TWO_STOREYS, two_storeys

from pysindy_nrf import datasets, excitation, simulate
from pysindy_nrf.cli.group import run
from pysindy_nrf.records.files import read_record


def test_inspect_suspects_the_unit(here, capsys, demo_file):
    """Accelerations in g and displacements in mm that nobody declared contradict each
    other by 9.81 and by 1000.
    """
    record = read_record(demo_file)
    record.replace(acceleration=record.acceleration / 9.80665).to_frame().to_csv(
        "g.csv"
    )
    record.replace(displacement=1e3 * record.displacement).to_frame().to_csv("mm.csv")
    assert run(["inspect", "g.csv"]) == 0
    assert (
        "take care: x1 is 9.8 times as large as a1 says: is a1 in g?"
        in capsys.readouterr().out
    )
    assert run(["inspect", "mm.csv"]) == 0
    assert "is x1 in mm?" in capsys.readouterr().out
    assert run(["inspect", demo_file]) == 0
    assert "nothing looks wrong" in capsys.readouterr().out
    assert sorted(p.name for p in here.iterdir()) == ["g.csv", "mm.csv"]


def test_inspect_lists_the_columns_it_cannot_place(here, capsys):
    pd.DataFrame({"Zeit": [0.0, 0.5, 1.0], "Laser": [1.0, 2.5, 2.0]}).to_csv(
        "own.csv", index=False
    )
    assert run(["inspect", "own.csv"]) == 3
    shown = capsys.readouterr()
    assert "Laser  3 values, 1 to 2.5" in shown.out and "--map x1=name" in shown.err


def test_inspect_speaks_json(here, spoken, demo_file):
    assert run(["inspect", demo_file, "--json"]) == 0
    record = spoken()["records"][0]
    assert (
        record["n_dof"] == 3
        and record["doubts"] == []
        and record["clock"].startswith("200 Hz")
    )


def test_simulate_is_the_free_run_of_the_model(here, capsys, truth_file):
    """Against simulate() in Python; a force in kN, a name with markup, motions in the
    file left out.
    """
    force = excitation.band_limited_random(
        3, 3.0, 500.0, excited=2, rms=80.0, band=(1, 30), random_state=0
    )
    pd.DataFrame(
        {
            "t": np.arange(len(force)) / 500,
            "<b>Shaker</b>": force[:, 1] / 1e3,
            "a1": 0.0,
        }
    ).to_csv("f.csv", index=False)
    pytest.importorskip("pint")
    assert (
        run(
            [
                "simulate",
                truth_file,
                "f.csv",
                "--map",
                "F2=<b>Shaker</b> @ kN",
                "-o",
                "answer.uff",
            ]
        )
        == 0
    )
    assert "<b>" not in capsys.readouterr().err
    expected = simulate(datasets.demo_truth(), force, 1 / 500)
    answer = read_record("answer.uff")
    np.testing.assert_allclose(
        answer.displacement, expected.displacement, rtol=1e-9, atol=1e-15
    )
    assert answer.fs == 500 and answer.name == "f"


CAMPAIGN = """files = ["f.csv"]
name = "shaker, day 2"
[channels]
t = "Zeit @ ms"
F2 = "Shaker @ kN"
a1 = "Acc 1"
x2 = "Laser 2 * 0.5"
[units]
a = "g"
x = "mm"
"""


@pytest.mark.parametrize("with_motions", [True, False])
@pytest.mark.parametrize("named", [True, False])
def test_simulate_reads_the_mapping_file_of_the_campaign(
    here, truth_file, with_motions, named
):
    """The file of the next test holds the shaker, and perhaps no motion; the words said
    once are for all of them.
    """
    pytest.importorskip("pint")
    force = excitation.band_limited_random(
        3, 3.0, 500.0, excited=2, rms=80.0, band=(1, 30), random_state=0
    )
    table = {"Zeit": 2.0 * np.arange(len(force)), "Shaker": force[:, 1] / 1e3}
    motions = {"Acc 1": 0.1, "Laser 2": 3.0} if with_motions else {}
    pd.DataFrame(table | motions).to_csv("f.csv", index=False)
    Path("campaign.toml").write_text(CAMPAIGN, "utf-8")
    files = ["f.csv"] if named else []
    assert (
        run(
            [
                "simulate",
                truth_file,
                *files,
                "--mapping",
                "campaign.toml",
                "-o",
                "answer.parquet",
            ]
        )
        == 0
    )
    answer, expected = (
        read_record("answer.parquet"),
        simulate(datasets.demo_truth(), force, 1 / 500),
    )
    np.testing.assert_allclose(
        answer.displacement, expected.displacement, rtol=1e-9, atol=1e-15
    )
    assert answer.name == ("f" if named else "shaker, day 2")


def test_simulate_options_go_before_the_mapping_file(here, truth_file):
    pytest.importorskip("pint")
    pd.DataFrame(
        {"Zeit": [0.0, 2, 4], "Shaker": [1.0, 2, 3], "Other": [0.0, 0, 0]}
    ).to_csv("f.csv", index=False)
    Path("campaign.toml").write_text(CAMPAIGN, "utf-8")
    assert (
        run(
            [
                "simulate",
                truth_file,
                "--mapping",
                "campaign.toml",
                "--map",
                "F2=Other",
                "-o",
                "a.csv",
            ]
        )
        == 0
    )
    assert not read_record("a.csv").displacement.any()  # nothing pushes


def test_simulate_wants_one_test(here, capsys, truth_file):
    pd.DataFrame({"t": [0.0, 1, 2], "F1": [1.0, 2, 3]}).to_csv("f.csv", index=False)
    pd.DataFrame({"t": [0.0, 1, 2], "F1": [1.0, 2, 3]}).to_csv("g.csv", index=False)
    Path("two.toml").write_text('files = ["f.csv", "g.csv"]', "utf-8")
    assert run(["simulate", truth_file, "--mapping", "two.toml"]) == 2
    assert "names 2 tests" in capsys.readouterr().err
    assert run(["simulate", truth_file]) == 2
    assert "no file is named" in capsys.readouterr().err
    assert not (here / "simulation.csv").exists()


def test_simulate_starts_where_it_is_told(here, spoken, truth_file):
    pd.DataFrame({"t": np.arange(400) / 500, "F1": 0.0}).to_csv(
        "still.csv", index=False
    )
    assert (
        run(
            [
                "simulate",
                truth_file,
                "still.csv",
                "--x0",
                "0.001,0.002,0.003",
                "--json",
                "-o",
                "a.parquet",
            ]
        )
        == 0
    )
    assert spoken()["record"]["n_samples"] == 400
    np.testing.assert_allclose(
        read_record("a.parquet").displacement[0], [1e-3, 2e-3, 3e-3]
    )


def test_simulate_refuses_what_does_not_fit(here, capsys, truth_file):
    pd.DataFrame({"t": [0.0, 1, 2], "F4": [1.0, 2, 3]}).to_csv("f.csv", index=False)
    assert run(["simulate", truth_file, "f.csv"]) == 3
    assert "F4 acts on a DOF that the model does not have" in capsys.readouterr().err
    pd.DataFrame({"t": [0.0, 1, 2], "x1": [1.0, 2, 3]}).to_csv("f.csv", index=False)
    assert run(["simulate", truth_file, "f.csv"]) == 3
    assert "no column is known to be a force" in capsys.readouterr().err
    assert run(["simulate", "f.csv", "f.csv"]) == 3
    assert "f.csv" in capsys.readouterr().err
    assert run(["simulate", truth_file, "f.csv", "--x0", "a,b"]) == 2
    assert not (here / "simulation.csv").exists()


def test_a_run_beyond_what_the_model_knows_is_warned_of(here, capsys):
    """Ten times the force gives ten times the drift of a linear frame: past the data of
    the model, and said so.
    """
    two_storeys(name="fit").to_frame().to_csv("fit.csv")
    assert (
        run(
            [
                "identify",
                "fit.csv",
                "--degree",
                "1",
                "--no-figures",
                "--link",
                "ground 2",
            ]
        )
        == 0
    )
    capsys.readouterr()
    rec = two_storeys()
    pd.DataFrame(
        {"t": rec.time, "F1": 10 * rec.force[:, 0], "F2": 10 * rec.force[:, 1]}
    ).to_csv("big.csv", index=False)
    assert run(["simulate", "nrf_output/model.json", "big.csv"]) == 0
    shown = capsys.readouterr()
    said = shown.out + shown.err
    assert (
        "storey 1 drifts" in said
        and "its force beyond is a guess" in said
        and "ground 2 drifts" not in said
    )
    assert run(["simulate", "nrf_output/model.json", "fit.csv"]) == 0
    shown = capsys.readouterr()
    assert "is a guess" not in shown.out + shown.err


def test_forces_in_two_files_of_one_test(here):
    """together = true: each force in its own file, one clock."""
    rec = two_storeys()
    for j in (0, 1):
        pd.DataFrame({"t": rec.time, "load": rec.force[:, j]}).to_csv(
            f"jack{j + 1}.csv", index=False
        )
    Path("test.toml").write_text(
        'files = ["jack1.csv", "jack2.csv"]\ntogether = true\n[channels]\nF1 ='
        ' "jack1.load"\nF2 = "jack2.load"\n'
    )
    TWO_STOREYS.to_json("model.json")
    assert (
        run(["simulate", "model.json", "--mapping", "test.toml", "-o", "answer.csv"])
        == 0
    )
    np.testing.assert_allclose(
        read_record("answer.csv").displacement, rec.displacement, rtol=1e-6, atol=1e-12
    )


def test_plan(here, capsys, spoken, truth_file):
    assert (
        run(["plan", "4", "--can-hit", "1,2", "--sensors", "1,2,4", "--unknown", "3"])
        == 0
    )
    said = capsys.readouterr().out
    assert "Floor 3 has no sensor" in said and "out of reach remain" in said
    assert run(["plan", "3", "--model", truth_file, "--json"]) == 0
    assert spoken()["tests"][0]["identifies"] == 1
    assert run(["plan", "3", "--can-hit", "9"]) == 3
    assert "DOF 9" in capsys.readouterr().err
    assert run(["plan", "3", "--can-hit", "none"]) == 0
    said = capsys.readouterr().out
    assert (
        "No floor can be hit with a known force; give a mass (--known-mass)" in said
        and "the best first" not in said
    )
    assert run(["plan", "5", "--model", truth_file]) == 2
    assert "The model has 3 floors, not 5" in capsys.readouterr().err
    assert not list(here.iterdir())


@pytest.fixture
def odd(here):
    """The bundled record as a file whose name and channels hold markup, control
    characters, quotes and blanks.
    """
    record = datasets.load_demo().to_frame()
    names = {c: c for c in record} | {
        "F2": '<script>alert("F2")</script>',
        "a1": "Beschl. \x1b[31m1 & 2",
    }
    path = here / 'test <b>7 & "x".csv'
    record.rename(columns=names).to_csv(path)
    maps = ["--map", f"F2={names['F2']}", "--map", f"a1={names['a1']}"]
    return path, maps


def test_markup_and_control_characters_survive(odd, here, capsys, spoken):
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    path, maps = odd
    assert run(["inspect", str(path), *maps]) == 0
    said = capsys.readouterr().out
    assert (
        "\x1b" not in said
        and "\\x1b[31m1 & 2" in said
        and '<script>alert("F2")' in said
    )
    assert run(["inspect", str(path), *maps, "--json"]) == 0
    assert spoken()["records"][0]["sources"]["a1"]["from"] == "Beschl. \x1b[31m1 & 2"
    assert run(["identify", str(path), *maps, "--degree", "1", "--no-figures"]) in (
        0,
        4,
    )
    page = (here / "nrf_output" / "report.html").read_text("utf-8")
    assert "<b>7" not in page and "&lt;b&gt;7" in page and 'alert("F2")' not in page


def test_report_of_a_result_and_records(here, capsys, demo_file, truth_file):
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    assert (
        run(["report", truth_file, demo_file, "-o", "one.html", "--title", "Frame <1>"])
        == 0
    )
    page = (here / "one.html").read_text("utf-8")
    assert "Frame &lt;1&gt;" in page and page.lstrip().lower().startswith(
        "<!doctype html"
    )
    assert (
        run(
            [
                "identify",
                demo_file,
                "--degree",
                "1",
                "--no-figures",
                "--json",
                "-o",
                "out",
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    (here / "result.json").write_text(said[said.index("{") :])
    assert run(["report", "result.json", "-o", "two.html"]) == 0
    assert (here / "two.html").stat().st_size > 1000
    assert run(["report"]) == 2
    assert run(["report", "result.json", truth_file]) == 2
    (here / "none.json").write_text("[1, 2]")
    assert run(["report", "none.json"]) == 3
