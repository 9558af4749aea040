"""Commands on records and runs: what a file holds, runs of a model, plans, pages."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report_cases import TWO_STOREYS, two_storeys

from pysindy_nrf import datasets, excitation, simulate
from pysindy_nrf.cli import ExitCode, run
from pysindy_nrf.records.files import read_record

# Digits that a file may lose.
SAME = {"rtol": 1e-9, "atol": 1e-15}


def write_csv(name, **columns):
    pd.DataFrame(columns).to_csv(name, index=False)


# -- inspect -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channels", "factor", "question"),
    [
        ("acceleration", 1 / 9.80665, "is a1 in g?"),
        ("displacement", 1e3, "is x1 in mm?"),
    ],
)
def test_inspect_suspects_a_unit_that_nobody_declared(
    here, capsys, demo_file, channels, factor, question
):
    record = read_record(demo_file)
    other = record.replace(**{channels: factor * getattr(record, channels)})
    other.to_frame().to_csv("other.csv")
    assert run(["inspect", "other.csv"]) == 0
    assert question in capsys.readouterr().out
    assert [path.name for path in here.iterdir()] == ["other.csv"]


def test_inspect_finds_nothing_wrong_with_the_bundled_record(capsys, demo_file):
    assert run(["inspect", demo_file]) == 0
    assert "nothing looks wrong" in capsys.readouterr().out


def test_inspect_lists_the_columns_it_cannot_place(here, capsys):
    write_csv("own.csv", Zeit=[0.0, 0.5, 1.0], Laser=[1.0, 2.5, 2.0])
    assert run(["inspect", "own.csv"]) == ExitCode.DATA
    shown = capsys.readouterr()
    assert "Laser  3 values, 1 to 2.5" in shown.out
    assert "--map x1=name" in shown.err


def test_inspect_speaks_json(here, spoken, demo_file):
    assert run(["inspect", demo_file, "--json"]) == 0
    record = spoken()["records"][0]
    assert record["n_dof"] == 3
    assert record["doubts"] == []
    assert record["clock"].startswith("200 Hz")


def test_inspect_proposes_a_mapping_that_run_can_read(here, capsys, demo_file):
    Path("test.csv").write_text(Path(demo_file).read_text())
    assert run(["inspect", "test.csv", "--write-mapping", "test.toml"]) == 0
    assert "run --mapping test.toml" in capsys.readouterr().out
    assert run(["inspect", "--mapping", "test.toml"]) == 0
    assert run(["inspect", "test.csv", "--write-mapping", "test.toml"]) == ExitCode.DATA


# -- laws ----------------------------------------------------------------------


def test_inspect_draws_a_page_of_the_channels(here, needs_pages, demo_file):
    assert run(["inspect", str(demo_file), "--html", "data.html"]) == 0
    page = Path("data.html").read_text("utf-8")
    assert "What was measured" in page
    assert page.count("<figure") >= 5


def test_inspect_loses_no_file_for_its_page(here, capsys, demo_file):
    Path("mine.txt").write_text("notes")
    assert run(["inspect", str(demo_file), "--html", "mine.txt"]) == 3
    assert Path("mine.txt").read_text() == "notes"


def test_laws_are_chosen_by_words(spoken):
    assert run(["laws", "coulomb", "--json"]) == 0
    listed = {row["name"]: row for row in spoken()["laws"]}
    assert listed["coulomb_friction"]["formula"] == "Fc sgn(v)"
    assert all("coulomb" in str(row).lower() for row in listed.values())


# -- simulate ------------------------------------------------------------------


@pytest.fixture
def shaker():
    """The force of a shaker on floor 2 of three, at 500 Hz."""
    return excitation.band_limited_random(
        3, 3.0, 500.0, excited=2, rms=80.0, band=(1, 30), random_state=0
    )


def test_simulate_is_the_free_run_of_the_model(here, capsys, truth_file, shaker):
    """A force in kN, a name with markup; motions in the file are left out."""
    pytest.importorskip("pint")
    table = {"t": np.arange(len(shaker)) / 500, "<b>Shaker</b>": shaker[:, 1] / 1e3}
    write_csv("f.csv", **table, a1=0.0)
    maps = ["--map", "F2=<b>Shaker</b> @ kN"]
    assert run(["simulate", truth_file, "f.csv", *maps, "-o", "answer.uff"]) == 0
    assert "<b>" not in capsys.readouterr().err

    expected = simulate(datasets.demo_truth(), shaker, 1 / 500)
    answer = read_record("answer.uff")
    np.testing.assert_allclose(answer.displacement, expected.displacement, **SAME)
    assert answer.fs == 500
    assert answer.name == "f"


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


@pytest.mark.parametrize("motions", [{}, {"Acc 1": 0.1, "Laser 2": 3.0}])
@pytest.mark.parametrize("files", [["f.csv"], []])
def test_simulate_reads_the_mapping_file_of_the_campaign(
    here, truth_file, shaker, motions, files
):
    """The file of the next test holds the shaker, and perhaps no motion."""
    pytest.importorskip("pint")
    write_csv(
        "f.csv",
        Zeit=2.0 * np.arange(len(shaker)),
        Shaker=shaker[:, 1] / 1e3,
        **motions,
    )
    Path("campaign.toml").write_text(CAMPAIGN, "utf-8")
    command = ["simulate", truth_file, *files, "--mapping", "campaign.toml"]
    assert run([*command, "-o", "answer.parquet"]) == 0

    answer = read_record("answer.parquet")
    expected = simulate(datasets.demo_truth(), shaker, 1 / 500)
    np.testing.assert_allclose(answer.displacement, expected.displacement, **SAME)
    assert answer.name == ("f" if files else "shaker, day 2")


def test_simulate_options_go_before_the_mapping_file(here, truth_file):
    pytest.importorskip("pint")
    write_csv("f.csv", Zeit=[0.0, 2, 4], Shaker=[1.0, 2, 3], Other=[0.0, 0, 0])
    Path("campaign.toml").write_text(CAMPAIGN, "utf-8")
    command = ["simulate", truth_file, "--mapping", "campaign.toml"]
    assert run([*command, "--map", "F2=Other", "-o", "a.csv"]) == 0
    assert not read_record("a.csv").displacement.any(), "nothing pushes"


def test_simulate_wants_one_test(here, capsys, truth_file):
    for name in ("f.csv", "g.csv"):
        write_csv(name, t=[0.0, 1, 2], F1=[1.0, 2, 3])
    Path("two.toml").write_text('files = ["f.csv", "g.csv"]', "utf-8")
    assert run(["simulate", truth_file, "--mapping", "two.toml"]) == ExitCode.USAGE
    assert "names 2 tests" in capsys.readouterr().err
    assert run(["simulate", truth_file]) == ExitCode.USAGE
    assert "no file is named" in capsys.readouterr().err
    assert not Path("simulation.csv").exists()


def test_simulate_starts_where_it_is_told(here, spoken, truth_file):
    write_csv("still.csv", t=np.arange(400) / 500, F1=0.0)
    command = ["simulate", truth_file, "still.csv", "--x0", "0.001,0.002,0.003"]
    assert run([*command, "--json", "-o", "a.parquet"]) == 0
    assert spoken()["record"]["n_samples"] == 400
    start = read_record("a.parquet").displacement[0]
    np.testing.assert_allclose(start, [1e-3, 2e-3, 3e-3])


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ("F4", "F4 acts on a DOF"),
        ("x1", "no column is known"),
    ],
)
def test_simulate_refuses_forces_that_do_not_fit(
    here, capsys, truth_file, column, words
):
    write_csv("f.csv", t=[0.0, 1, 2], **{column: [1.0, 2, 3]})
    assert run(["simulate", truth_file, "f.csv"]) == ExitCode.DATA
    assert words in capsys.readouterr().err
    assert not Path("simulation.csv").exists()


def test_simulate_refuses_what_is_no_model(here, capsys):
    write_csv("f.csv", t=[0.0, 1, 2], F1=[1.0, 2, 3])
    assert run(["simulate", "f.csv", "f.csv"]) == ExitCode.DATA
    assert "f.csv" in capsys.readouterr().err


def test_simulate_refuses_a_start_that_is_no_numbers(here, truth_file):
    assert run(["simulate", truth_file, "f.csv", "--x0", "a,b"]) == ExitCode.USAGE


@pytest.fixture
def fitted_frame(here, capsys):
    """A linear frame identified from its own record, with a link to the ground."""
    two_storeys(name="fit").to_frame().to_csv("fit.csv")
    command = ["identify", "fit.csv", "--degree", "1", "--no-figures"]
    assert run([*command, "--link", "ground 2"]) == 0
    capsys.readouterr()


def test_a_run_beyond_what_the_model_knows_is_warned_of(fitted_frame, capsys):
    """Ten times the force gives ten times the drift of a linear frame."""
    rec = two_storeys()
    first, second = 10 * rec.force.T
    write_csv("big.csv", t=rec.time, F1=first, F2=second)
    assert run(["simulate", "nrf_output/model.json", "big.csv"]) == 0
    text = capsys.readouterr().out
    assert "storey 1 drifts" in text
    assert "is a guess" in text
    assert "ground 2 drifts" not in text


def test_a_run_inside_of_what_the_model_knows_is_no_warning(fitted_frame, capsys):
    assert run(["simulate", "nrf_output/model.json", "fit.csv"]) == 0
    shown = capsys.readouterr()
    assert "is a guess" not in shown.out + shown.err


TWO_FILES = """files = ["jack1.csv", "jack2.csv"]
together = true
[channels]
F1 = "jack1.load"
F2 = "jack2.load"
"""


def test_forces_in_two_files_of_one_test(here):
    """together = true: each force in its own file, one clock."""
    rec = two_storeys()
    for number, load in enumerate(rec.force.T, 1):
        write_csv(f"jack{number}.csv", t=rec.time, load=load)
    Path("test.toml").write_text(TWO_FILES)
    TWO_STOREYS.to_json("model.json")
    command = ["simulate", "model.json", "--mapping", "test.toml"]
    assert run([*command, "-o", "answer.csv"]) == 0
    answer = read_record("answer.csv").displacement
    np.testing.assert_allclose(answer, rec.displacement, rtol=1e-6, atol=1e-12)


# -- plan ----------------------------------------------------------------------


def test_plan_names_what_stays_out_of_reach(here, capsys):
    where = ["--can-hit", "1,2", "--sensors", "1,2,4", "--unknown", "3"]
    assert run(["plan", "4", *where]) == 0
    text = capsys.readouterr().out
    assert "Floor 3 has no sensor" in text
    assert "out of reach remain" in text
    assert not list(here.iterdir())


def test_plan_with_a_model(spoken, truth_file):
    assert run(["plan", "3", "--model", truth_file, "--json"]) == 0
    best = spoken()["tests"][0]
    assert best["identifies"] == 1
    assert 0 < best["response"] <= 1


def test_plan_without_a_floor_to_hit(capsys):
    assert run(["plan", "3", "--can-hit", "none"]) == 0
    text = capsys.readouterr().out
    assert "known mass is needed" in text
    assert "the best first" not in text


def test_plan_refuses_floors_that_are_not_there(capsys, truth_file):
    assert run(["plan", "3", "--can-hit", "9"]) == ExitCode.DATA
    assert "DOF 9" in capsys.readouterr().err
    assert run(["plan", "5", "--model", truth_file]) == ExitCode.USAGE
    assert "has 3 floors, not 5" in capsys.readouterr().err


# -- names that are markup -----------------------------------------------------

SCRIPT = '<script>alert("F2")</script>'
RED_TEXT = "Beschl. \x1b[31m1 & 2"


@pytest.fixture
def odd(here):
    """The bundled record as a file whose name and channels are markup."""
    record = datasets.load_demo().to_frame()
    path = here / 'test <b>7 & "x".csv'
    record.rename(columns={"F2": SCRIPT, "a1": RED_TEXT}).to_csv(path)
    return [str(path), "--map", f"F2={SCRIPT}", "--map", f"a1={RED_TEXT}"]


def test_control_characters_are_shown_and_not_obeyed(odd, capsys):
    assert run(["inspect", *odd]) == 0
    text = capsys.readouterr().out
    assert "\x1b" not in text
    assert "\\x1b[31m1 & 2" in text
    assert SCRIPT in text


def test_control_characters_survive_in_json(odd, spoken):
    assert run(["inspect", *odd, "--json"]) == 0
    sources = spoken()["records"][0]["sources"]
    assert sources["a1"]["from"] == RED_TEXT


def test_markup_in_names_stays_text_on_the_page(odd, here):
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    run(["identify", *odd, "--degree", "1", "--no-figures"])
    page = (here / "nrf_output" / "report.html").read_text("utf-8")
    assert "<b>7" not in page
    assert "&lt;b&gt;7" in page
    assert 'alert("F2")' not in page


# -- report --------------------------------------------------------------------


@pytest.fixture
def needs_pages():
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")


def test_report_of_a_model_over_records(here, needs_pages, demo_file, truth_file):
    title = ["--title", "Frame <1>"]
    assert run(["report", truth_file, demo_file, "-o", "one.html", *title]) == 0
    page = Path("one.html").read_text("utf-8")
    assert "Frame &lt;1&gt;" in page
    assert page.lstrip().lower().startswith("<!doctype html")


@pytest.mark.slow
def test_report_of_what_json_printed(here, needs_pages, capsys, demo_file):
    command = ["identify", demo_file, "--degree", "1", "--no-figures", "--json"]
    assert run(command) == 0
    Path("result.json").write_text(capsys.readouterr().out)
    assert run(["report", "result.json", "-o", "two.html"]) == 0
    assert Path("two.html").stat().st_size > 1000


def test_report_takes_one_result(here, truth_file):
    Path("none.json").write_text("[1, 2]")
    assert run(["report"]) == ExitCode.USAGE
    assert run(["report", "none.json", truth_file]) == ExitCode.USAGE
    assert run(["report", "none.json"]) == ExitCode.DATA
