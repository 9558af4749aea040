"""The command line does the main job, on bundled, own and measured files, and fails in words."""

import json
import subprocess
import sys

import measured
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, Record, datasets, simulate
from pysindy_nrf.output.cli.group import run


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_demo_does_the_main_job(here, capsys):
    assert run(["demo"]) == 0
    said = capsys.readouterr().out
    for words in (
        "known to be unforced: DOFs 1, 3",
        "Balance of DOF 2 (forced): m2, storey 2, storey 3.",
        "balance error, pooled",
        "free-run error",
        "(truth 12)",
    ):
        assert words in said
    folder = here / "nrf_output"
    model = ChainModel.from_json(folder / "model.json")
    np.testing.assert_allclose(model.masses, [12, 10, 8], rtol=0.01)
    np.testing.assert_array_equal(pd.read_csv(folder / "masses.csv")["mass_kg"], model.masses)
    assert set(pd.read_csv(folder / "coefficients.csv")["site"]) == {"storey 1", "storey 2", "storey 3"}
    free = pd.read_csv(folder / "free_run_errors.csv")
    assert free.filter(like="percent").to_numpy().max() < 8
    assert pd.read_csv(folder / "modes.csv")["frequency_Hz"].is_monotonic_increasing
    for name in ("restoring_forces.png", "free_run.png"):
        assert (folder / name).read_bytes()[:4] == b"\x89PNG"
    assert not list(folder.glob(".*"))


def test_demo_speaks_json(here, capsys):
    assert run(["demo", "--json", "-o", "out"]) == 0
    data = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(data["masses_kg"], [12, 10, 8], rtol=0.01)
    assert data["balance_error_percent"]["pooled"] < 5
    assert ChainModel.from_json(json.dumps(data["model"])).n_dof == 3


def test_own_file_in_mm_g_and_kn(here, capsys):
    """The bundled record as an engineer would have it: other names, other units, decimal commas."""
    table = datasets.load_demo().to_frame()
    own = pd.DataFrame({"Zeit": 1e3 * table.index, "Shaker": table["F2"] / 1e3})
    for j in (1, 2, 3):
        own[f"Acc {j}"], own[f"Laser {j}"] = table[f"a{j}"] / 9.80665, 1e3 * table[f"x{j}"]
    own.to_csv("own.csv", sep=";", decimal=",", index=False)
    maps = [
        "t=Zeit @ ms",
        "F2=Shaker @ kN",
        *(f"a{j}=Acc {j}" for j in (1, 2, 3)),
        *(f"x{j}=Laser {j}" for j in (1, 2, 3)),
    ]
    command = ["identify", "own.csv", "--unit", "a=g", "--unit", "x=mm", "--json", "--no-figures"]
    for text in maps:
        command += ["--map", text]
    assert run(command) == 0
    np.testing.assert_allclose(json.loads(capsys.readouterr().out)["masses_kg"], [12, 10, 8], rtol=0.01)
    assert not list((here / "nrf_output").glob("*.png"))


def test_roving_hammer_over_three_files(here, capsys):
    """Another floor is hit in each file; no file alone has all forces. Noise-free: exact."""
    truth = datasets.demo_truth()
    rng = np.random.default_rng(0)
    for j in (1, 2, 3):
        force = np.zeros((3000, 3))
        force[100:110, j - 1] = 800 * np.hanning(10)
        force[900:1500, j - 1] = 30 * rng.normal(size=600)
        simulate(truth, force, 1e-3).to_frame().to_csv(f"hit{j}.csv")
    assert run(["identify", "hit1.csv", "hit2.csv", "hit3.csv", "--raw", "--json", "--no-figures"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["walk"][0].startswith("Balance of DOF 3 (forced)")
    np.testing.assert_allclose(data["masses_kg"], [12, 10, 8], rtol=1e-8)
    assert set(data["free_run_error_percent"]) == {"hit1", "hit2", "hit3"}


def test_base_excitation_with_a_known_mass(here, capsys):
    from pysindy_nrf.simulation.excitation import earthquake

    ag = earthquake(15.0, 500.0, peak=4.0, random_state=1)
    simulate(datasets.demo_truth(), np.zeros((len(ag), 3)), 1 / 500, base_acceleration=ag).to_frame().drop(
        columns=["F1", "F2", "F3"]
    ).to_csv("quake.csv")
    assert run(["identify", "quake.csv", "--raw"]) == 3
    assert "cannot be scaled" in capsys.readouterr().out
    assert run(["identify", "quake.csv", "--raw", "--known-mass", "3=8", "--json", "--no-figures"]) == 0
    data = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(data["masses_kg"], [12, 10, 8], rtol=1e-7)
    assert data["free_run_error_percent"]["quake"]["x3"] < 1  # straight lines between samples of ag


def test_laws_by_name(here, capsys):
    datasets.load_demo().to_frame().to_csv("demo.csv")
    command = [
        "identify",
        "demo.csv",
        "--json",
        "--no-figures",
        "--degree",
        "1",
        "--law",
        "storey 1=linear_viscous+duffing",
    ]
    assert run(command) == 0
    data = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(data["masses_kg"], [12, 10, 8], rtol=0.01)
    assert [law["law"] for law in data["model"]["laws"]["storey 1"]] == ["linear_viscous", "duffing"]


def test_emps(here, capsys):
    """Only position and drive were measured; published mass 95.1 kg."""
    path = measured.folder("emps") / "emps" / "DATA_EMPS.mat"
    command = ["identify", str(path), "--map", "x1=qm", "--map", "F1=vir*35.1507", "--map", "t=t", "--band", "0,20"]
    assert run([*command, "--degree", "1"]) == 0
    said = capsys.readouterr().out
    assert "<- vir * 35.1507" in said and "not used: gtau, kp, kv, qg" in said and "0 to 20 Hz" in said
    assert "Take care" in said and "Next: pysindy-nrf close-loop" in said
    care = said.split("Take care")[1].split("Written to")[0]
    assert max(map(len, care.splitlines())) <= 110  # a terminal shows it whole
    assert run([*command, "--degree", "1", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert 93 <= data["masses_kg"][0] <= 97
    assert 16 <= data["balance_error_percent"]["dof 1"] <= 18
    assert run([*command, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert 93 <= data["masses_kg"][0] <= 97 and 8.5 <= data["balance_error_percent"]["dof 1"] <= 10


def test_frequency_responses(here, capsys):
    path = measured.folder("three_storey_frf") / "three_storey_frf" / "cristallo_Experimental.csv"
    assert run(["identify", str(path), "--frf", "--driven", "1", "--band", "4,32", "--json"]) == 0
    masses = json.loads(capsys.readouterr().out)["masses_kg"]
    assert max(masses) / min(masses) - 1 < 0.10
    assert (here / "nrf_output" / "frequency_response.png").is_file()
    assert run(["identify", str(path)]) == 3
    assert "--frf" in capsys.readouterr().err
    assert run(["identify", str(path), "--frf", "--degree", "3"]) == 2
    assert "linear laws only" in capsys.readouterr().err


def test_dry_run_solves_and_writes_nothing(here, capsys):
    datasets.load_demo().to_frame().to_csv("demo.csv")
    assert run(["identify", "demo.csv", "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "4000 samples at 200 Hz" in said and "m2, storey 2, storey 3" in said and "kg" not in said
    assert [p.name for p in here.iterdir()] == ["demo.csv"]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["identify"], 2, "FILE"),
        (["identify", "a.csv", "--map", "x1"], 2, "CHANNEL=COLUMN"),
        (["identify", "a.csv", "--band", "5"], 2, "0.5,30"),
        (["identify", "a.csv", "--degree", "2.5"], 2, "degree"),
        (["identify", "a.csv", "--known-mass", "two=3"], 2, "2=12.4"),
        (["identify", "a.csv", "--law", "storey 1=rubber"], 2, "no law 'rubber'"),
        (["identify", "a.csv", "--kind", "mobility"], 2, "--frf only"),
        (["identify", "a.csv", "--map", "x1=p", "--map", "x1=q"], 2, "twice"),
        (["conquer"], 2, "conquer"),
        (["identify", "nowhere.csv"], 3, "nowhere.csv does not exist"),
        (["identify", "a.csv", "--map", "x1=q"], 3, "no variable 'q'"),
        (["identify", "a.csv"], 3, "nothing scales the chain"),
        (["identify", "a.csv", "--known-mass", "9=1"], 3, "DOF 9"),
        (["identify", "a.csv", "--map", "F1=p", "--band", "0,999"], 3, "Nyquist"),
        (["identify", "a.csv", "--map", "F1=p", "--order", "storey 7=2"], 3, "storey 7"),
    ],
)
def test_errors_are_sentences_with_exit_codes(here, capsys, arguments, code, words):
    t = np.arange(300) / 100
    pd.DataFrame({"t": t, "x1": np.sin(5 * t), "p": np.cos(5 * t)}).to_csv("a.csv", index=False)
    assert run(arguments) == code
    shown = capsys.readouterr()
    assert words in shown.err and "Traceback" not in shown.err + shown.out
    assert not (here / "nrf_output").exists()


def test_ctrl_c_leaves_no_half_written_file(here, capsys, monkeypatch):
    (here / "nrf_output").mkdir()
    (here / "nrf_output" / "masses.csv").write_text("old\n")

    def interrupted(self, file, **options):
        file.write("half")
        raise KeyboardInterrupt

    monkeypatch.setattr(pd.DataFrame, "to_csv", interrupted)
    assert run(["demo"]) == 130
    assert "Stopped" in capsys.readouterr().err
    assert (here / "nrf_output" / "masses.csv").read_text() == "old\n"
    assert {p.name for p in (here / "nrf_output").iterdir()} == {"model.json", "masses.csv"}


def test_an_unwritable_folder_and_a_fault_of_ours(here, capsys, monkeypatch):
    (here / "taken").write_text("")
    assert run(["demo", "-o", "taken"]) == 2
    assert "taken" in capsys.readouterr().err
    from pysindy_nrf import NRFRegressor

    def broken(self, *args, **options):
        raise RuntimeError("boom")

    monkeypatch.setattr(NRFRegressor, "fit", broken)
    assert run(["demo"]) == 1
    shown = capsys.readouterr().err
    assert "RuntimeError: boom" in shown and "report" in shown and "Traceback" not in shown


def test_without_matplotlib_there_are_no_figures_and_it_says_so(here, capsys, monkeypatch):
    import importlib.util

    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "matplotlib" else real(name, *rest)
    )
    assert run(["demo"]) == 0
    assert "pysindy-nrf[plot]" in capsys.readouterr().out
    assert not list((here / "nrf_output").glob("*.png"))


def test_help_teaches(capsys):
    assert run(["--help"]) == 0
    assert "Exit codes" in capsys.readouterr().out
    assert run(["identify", "--help"]) == 0
    assert "--map F1='vir*35.1507'" in capsys.readouterr().out


def test_as_a_process(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "pysindy_nrf", "identify", "nowhere.csv"], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 3 and done.stdout == "" and done.stderr.startswith("Error: nowhere.csv")


def test_the_input_is_not_changed(here):
    rec = datasets.load_demo()
    rec.to_frame().to_csv("demo.csv")
    before = (here / "demo.csv").read_bytes()
    assert run(["identify", "demo.csv", "--band", "0.5,30", "--no-figures"]) == 0
    assert (here / "demo.csv").read_bytes() == before
    assert isinstance(rec, Record)
