"""Every command on files as engineers have them: results right, words printable, files whole, exit codes as documented."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, datasets, excitation, simulate
from pysindy_nrf.data.io import read_record, read_table, write_record
from pysindy_nrf.output.cli import group
from pysindy_nrf.output.cli.group import run

DOCS = Path(__file__).parents[2] / "docs"
COMMANDS = list(group.cli.commands)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def demo_file(tmp_path_factory):
    return str(write_record(datasets.load_demo(), tmp_path_factory.mktemp("demo") / "demo.csv"))


@pytest.fixture(scope="module")
def truth_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("truth") / "model.json"
    datasets.demo_truth().to_json(path)
    return str(path)


def spoken(capsys):
    return json.loads(capsys.readouterr().out, parse_constant=lambda word: pytest.fail(f"{word} in JSON"))


# -- inspect ----------------------------------------------------------------------------------


def test_inspect_suspects_the_unit(here, capsys, demo_file):
    """Accelerations in g and displacements in mm that nobody declared contradict each other by 9.81 and by 1000."""
    record = read_record(demo_file)
    record.replace(acceleration=record.acceleration / 9.80665).to_frame().to_csv("g.csv")
    record.replace(displacement=1e3 * record.displacement).to_frame().to_csv("mm.csv")
    assert run(["inspect", "g.csv"]) == 0
    assert "take care: x1 is 9.8 times as large as a1 says: is a1 in g?" in capsys.readouterr().out
    assert run(["inspect", "mm.csv"]) == 0
    assert "is x1 in mm?" in capsys.readouterr().out
    assert run(["inspect", demo_file]) == 0
    assert "nothing looks wrong" in capsys.readouterr().out
    assert sorted(p.name for p in here.iterdir()) == ["g.csv", "mm.csv"]


def test_inspect_lists_the_columns_it_cannot_place(here, capsys):
    pd.DataFrame({"Zeit": [0.0, 0.5, 1.0], "Laser": [1.0, 2.5, 2.0]}).to_csv("own.csv", index=False)
    assert run(["inspect", "own.csv"]) == 3
    shown = capsys.readouterr()
    assert "Laser  3 values, 1 to 2.5" in shown.out and "--map x1=name" in shown.err


def test_inspect_speaks_json(here, capsys, demo_file):
    assert run(["inspect", demo_file, "--json"]) == 0
    record = spoken(capsys)["records"][0]
    assert record["n_dof"] == 3 and record["doubts"] == [] and record["clock"].startswith("200 Hz")


def test_forces_are_drawn_although_the_free_run_diverges(here, capsys):
    """Negative damping: the model explains the record, alone it flies away; the picture of its forces is still wanted."""
    pytest.importorskip("matplotlib")
    t = np.arange(4000) / 200
    rng = np.random.default_rng(0)
    x = sum(np.sin(w * t + p) / w for w, p in zip(np.linspace(5, 60, 40), rng.uniform(0, 6, 40)))
    v, a = np.gradient(x, t), np.gradient(np.gradient(x, t), t)
    force = 10.0 * a - 900.0 * v + 2e4 * x
    pd.DataFrame({"t": t, "F1": force, "a1": a, "v1": v, "x1": x})[5:-5].to_csv("f.csv", index=False)
    assert run(["identify", "f.csv", "--degree", "1"]) == 0
    assert "no free run: The free run diverges" in capsys.readouterr().out
    assert Path("nrf_output/restoring_forces.png").exists() and not Path("nrf_output/free_run.png").exists()


# -- simulate ---------------------------------------------------------------------------------


def test_simulate_is_the_free_run_of_the_model(here, capsys, truth_file):
    """Against simulate() in Python; a force in kN, a name with markup, motions in the file left out."""
    force = excitation.band_limited_random(3, 3.0, 500.0, dofs=2, rms=80.0, band=(1, 30), random_state=0)
    pd.DataFrame({"t": np.arange(len(force)) / 500, "<b>Shaker</b>": force[:, 1] / 1e3, "a1": 0.0}).to_csv(
        "f.csv", index=False
    )
    pytest.importorskip("pint")
    assert run(["simulate", truth_file, "f.csv", "--map", "F2=<b>Shaker</b> @ kN", "-o", "answer.uff"]) == 0
    assert "<b>" not in capsys.readouterr().err
    expected = simulate(datasets.demo_truth(), force, 1 / 500)
    answer = read_record("answer.uff")
    np.testing.assert_allclose(answer.displacement, expected.displacement, rtol=1e-9, atol=1e-15)
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
def test_simulate_reads_the_mapping_file_of_the_campaign(here, capsys, truth_file, with_motions, named):
    """The file of the next test holds the shaker, and perhaps no motion; the words said once are for all of them."""
    pytest.importorskip("pint")
    force = excitation.band_limited_random(3, 3.0, 500.0, dofs=2, rms=80.0, band=(1, 30), random_state=0)
    table = {"Zeit": 2.0 * np.arange(len(force)), "Shaker": force[:, 1] / 1e3}
    motions = {"Acc 1": 0.1, "Laser 2": 3.0} if with_motions else {}
    pd.DataFrame(table | motions).to_csv("f.csv", index=False)
    Path("campaign.toml").write_text(CAMPAIGN, "utf-8")
    files = ["f.csv"] if named else []
    assert run(["simulate", truth_file, *files, "--mapping", "campaign.toml", "-o", "answer.parquet"]) == 0
    answer, expected = read_record("answer.parquet"), simulate(datasets.demo_truth(), force, 1 / 500)
    np.testing.assert_allclose(answer.displacement, expected.displacement, rtol=1e-9, atol=1e-15)
    assert answer.name == ("f" if named else "shaker, day 2")


def test_simulate_options_go_before_the_mapping_file(here, capsys, truth_file):
    pytest.importorskip("pint")
    pd.DataFrame({"Zeit": [0.0, 2, 4], "Shaker": [1.0, 2, 3], "Other": [0.0, 0, 0]}).to_csv("f.csv", index=False)
    Path("campaign.toml").write_text(CAMPAIGN, "utf-8")
    assert run(["simulate", truth_file, "--mapping", "campaign.toml", "--map", "F2=Other", "-o", "a.csv"]) == 0
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


def test_simulate_starts_where_it_is_told(here, capsys, truth_file):
    pd.DataFrame({"t": np.arange(400) / 500, "F1": 0.0}).to_csv("still.csv", index=False)
    assert run(["simulate", truth_file, "still.csv", "--x0", "0.001,0.002,0.003", "--json", "-o", "a.parquet"]) == 0
    assert spoken(capsys)["record"]["n_samples"] == 400
    np.testing.assert_allclose(read_record("a.parquet").displacement[0], [1e-3, 2e-3, 3e-3])


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


# -- select-order, compare, plan, report ------------------------------------------------------


def test_select_order_finds_the_cubic(here, capsys, demo_file):
    assert run(["select-order", demo_file, "--degrees", "1-5", "--no-figures", "--json"]) == 0
    data = spoken(capsys)
    assert data["best_order"] == 3 and data["orders_by_storey"]["storey 2"] == 1
    assert list(pd.read_csv("nrf_output/orders.csv")["order"]) == [1, 2, 3, 4, 5]


def test_select_order_says_what_to_do_next(here, capsys, demo_file):
    assert run(["select-order", demo_file, "--degrees", "1,3", "--no-figures"]) == 0
    said = capsys.readouterr().out
    assert "identify ... --degree 3" in said and "--order 'storey 2=1'" in said
    assert run(["select-order", demo_file, "--degrees", "one"]) == 2
    assert run(["select-order", demo_file, "--box", "1"]) == 2


def test_compare_with_the_truth(here, capsys, demo_file, truth_file):
    assert run(["compare", demo_file, "--truth", truth_file, "--time-limit", "0.2", "--json"]) == 0
    table = spoken(capsys)["table"]
    assert table["pysindy_nrf, least squares"]["mass_error"] < 1 < table["SINDy, defaults"]["terms"] / 100
    assert "terms" in pd.read_csv("nrf_output/comparison.csv")


def test_plan(here, capsys, truth_file):
    assert run(["plan", "4", "--can-hit", "1,2", "--sensors", "1,2,4", "--unknown", "3"]) == 0
    said = capsys.readouterr().out
    assert "Floor 3 has no sensor" in said and "out of reach remain" in said
    assert run(["plan", "3", "--model", truth_file, "--json"]) == 0
    assert spoken(capsys)["tests"][0]["identifies"] == 1
    assert run(["plan", "3", "--can-hit", "9"]) == 3
    assert "DOF 9" in capsys.readouterr().err
    assert not list(here.iterdir())


@pytest.fixture
def odd(here):
    """The bundled record as a file whose name and channels hold markup, control characters, quotes and blanks."""
    record = datasets.load_demo().to_frame()
    names = {c: c for c in record} | {"F2": '<script>alert("F2")</script>', "a1": "Beschl. \x1b[31m1 & 2"}
    path = here / 'test <b>7 & "x".csv'
    record.rename(columns=names).to_csv(path)
    maps = ["--map", f"F2={names['F2']}", "--map", f"a1={names['a1']}"]
    return path, maps


def test_markup_and_control_characters_survive(odd, here, capsys):
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    path, maps = odd
    assert run(["inspect", str(path), *maps]) == 0
    said = capsys.readouterr().out
    assert "\x1b" not in said and "\\x1b[31m1 & 2" in said and '<script>alert("F2")' in said
    assert run(["inspect", str(path), *maps, "--json"]) == 0
    assert spoken(capsys)["records"][0]["sources"]["a1"]["from"] == "Beschl. \x1b[31m1 & 2"
    assert run(["report", str(path), *maps, "--degree", "1", "-o", "page.html"]) == 0
    page = (here / "page.html").read_text("utf-8")
    assert "<b>7" not in page and "&lt;b&gt;7" in page and 'alert("F2")' not in page


def test_report_of_a_result_and_records(here, capsys, demo_file, truth_file):
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    assert run(["report", truth_file, demo_file, "-o", "one.html", "--title", "Frame <1>"]) == 0
    page = (here / "one.html").read_text("utf-8")
    assert "Frame &lt;1&gt;" in page and page.lstrip().lower().startswith("<!doctype html")
    assert run(["identify", demo_file, "--degree", "1", "--no-figures", "--json", "-o", "out"]) == 0
    said = capsys.readouterr().out
    (here / "result.json").write_text(said[said.index("{") :])
    assert run(["report", "result.json", "-o", "two.html"]) == 0
    assert (here / "two.html").stat().st_size > 1000
    assert run(["report"]) == 2
    assert run(["report", "result.json", truth_file]) == 2
    (here / "none.json").write_text("[1, 2]")
    assert run(["report", "none.json"]) == 3


# -- identify: what else it writes ------------------------------------------------------------


def test_forces_and_parquet_tables(here, capsys, demo_file):
    pytest.importorskip("pyuff")
    command = ["identify", demo_file, "--forces", "uff", "--tables", "parquet", "--no-figures", "--json"]
    assert run(command) == 0
    data = spoken(capsys)
    forces = read_table("nrf_output/restoring_forces.uff").variables
    assert list(forces) == ["F1", "F2", "F3"] and len(forces["F1"]) == 4000
    masses = read_table("nrf_output/masses.parquet").variables["mass_kg"]
    np.testing.assert_array_equal(masses, data["masses_kg"])
    # the force the model reconstructs in storey 3 carries the mass above it: R_3 = -m_3 a_3, noise apart
    record = datasets.load_demo()
    inertia = -masses[2] * record.acceleration[:, 2]
    assert np.std(forces["F3"] - inertia) < 0.1 * np.std(inertia)


# -- all commands -----------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command(command, capsys):
    assert run([command, "--help"]) == 0
    said = capsys.readouterr().out
    assert "--json" in said and ("pysindy-nrf " + command in said or command == "demo")
    assert f"`{command}" in (DOCS / "command_line.md").read_text("utf-8")


@pytest.mark.parametrize("command", [c for c in COMMANDS if c not in ("demo", "plan")])
def test_no_command_shows_a_traceback(command, here, capsys):
    (here / "bad.csv").write_bytes(os.urandom(500))
    for arguments in ([], ["nowhere.csv"], ["bad.csv"], ["nowhere.csv", "bad.csv"], ["--nonsense"], ["."], [""]):
        code = run([command, *arguments])
        shown = capsys.readouterr()
        assert code in (2, 3) and "Traceback" not in shown.err + shown.out and shown.err.strip()
        assert "fault of pysindy-nrf" not in shown.err, shown.err
    assert [p.name for p in here.iterdir()] == ["bad.csv"]


def test_exit_codes_are_those_of_the_page():
    table = re.findall(r"^\| (\d+) \| ([\w ]+)", (DOCS / "command_line.md").read_text("utf-8"), re.MULTILINE)
    codes = {int(code): words for code, words in table}
    assert set(codes) == {0, group.OTHER, group.USAGE, group.DATA, group.INTERRUPTED}
    assert codes[group.USAGE] == "wrong usage" and codes[group.INTERRUPTED] == "stopped by Ctrl"


def process(*arguments, cwd, **more):
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": cwd, **more}
    return subprocess.Popen([sys.executable, "-m", "pysindy_nrf", *arguments], **options)


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_ctrl_c_in_a_real_process(here, demo_file):
    """Interrupted in the middle of the search: a sentence, code 130, no file."""
    running = process("close-loop", demo_file, "-o", "out", cwd=here, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    while "forced: DOF" not in (line := running.stdout.readline()):
        assert line or running.poll() is None
    time.sleep(1.0)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=60)
    # a shell shows 130 either way: Python takes its own life by SIGINT where the interrupt fell into code of an exec()
    assert running.returncode in (130, -signal.SIGINT) and "Stopped" in err and "Traceback" not in out + err, err
    assert not list(here.iterdir())


SWALLOW = """
import ctypes, time
from pysindy_nrf.output.cli import group

@group.cli.command()
def swallow():
    def callback():
        raise KeyboardInterrupt
    ctypes.CFUNCTYPE(None)(callback)()
    time.sleep(600)
    print("not heard")

group.main(["swallow"])
"""


def test_ctrl_c_that_a_callback_swallows_is_heard_all_the_same(here):
    """Python drops what is raised in a callback of compiled code, such as the compiler's; it must come again."""
    done = subprocess.run([sys.executable, "-c", SWALLOW], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130 and "Stopped" in done.stderr
    assert "Traceback" not in done.stderr and "not heard" not in done.stdout


def test_a_terminal_that_knows_only_ascii(here, demo_file):
    """Signs it lacks are shown as codes; no command fails on its own words."""
    table = datasets.load_demo().to_frame().rename(columns={"a1": "Größe µ"})
    table.to_csv("odd.csv")
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0"}
    done = process("inspect", "odd.csv", "--map", "a1=Größe µ", cwd=here, env=environment)
    out, err = done.communicate(timeout=60)
    assert done.returncode == 0 and "Gr" in out, err


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_shell_completion(here, shell, monkeypatch, capsys):
    """The variable and the words of the documentation are those that the program answers to."""
    assert f"_PYSINDY_NRF_COMPLETE={shell}_source" in (DOCS / "command_line.md").read_text("utf-8")
    monkeypatch.setenv("_PYSINDY_NRF_COMPLETE", f"{shell}_source")
    with pytest.raises(SystemExit, match="0"):
        run([])
    assert "pysindy-nrf" in capsys.readouterr().out
    monkeypatch.setenv("_PYSINDY_NRF_COMPLETE", f"{shell}_complete")
    monkeypatch.setenv("COMP_WORDS", "pysindy-nrf se")
    monkeypatch.setenv("COMP_CWORD", "1" if shell == "zsh" else "se")
    with pytest.raises(SystemExit, match="0"):
        run([])
    assert "select-order" in capsys.readouterr().out


def test_a_full_disk_is_a_sentence(here, capsys, demo_file, monkeypatch):
    import errno

    def full(self, *args, **options):
        raise OSError(errno.ENOSPC, "No space left on device", "nrf_output/model.json")

    monkeypatch.setattr(ChainModel, "to_json", full)
    assert run(["identify", demo_file, "--degree", "1", "--no-figures"]) == 1
    assert "No space left on device" in capsys.readouterr().err
