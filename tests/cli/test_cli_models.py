"""Commands that find models, on bundled, own and measured files.

Masses, words, tables and figures.
"""

from pathlib import Path

import measured
import numpy as np
import pandas as pd
import pytest
from report_cases import two_storeys

from pysindy_nrf import ChainModel, datasets, excitation, laws, simulate
from pysindy_nrf.cli import ExitCode, run
from pysindy_nrf.records.files import read_table, write_record

README = Path(__file__).parents[2] / "README.md"
MASSES = [12, 10, 8]  # of the bundled frame, kg
PNG = b"\x89PNG"
QUIET = ["--no-figures", "--json"]


def is_picture(path):
    return Path(path).read_bytes().startswith(PNG)


# -- the bundled record --------------------------------------------------------


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The folder of the demo, and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    printed = []
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        patched.setattr("click.echo", lambda text, **_: printed.append(text))
        assert run(["demo"]) == 0
    return folder / "nrf_demo", "\n".join(printed)


def test_demo_says_what_was_measured_and_what_can_be_found(demo):
    _, text = demo
    assert "DOFs 1, 3" in text
    assert "Balance of DOF 2 (forced): m2, storey 2" in text


def test_the_readme_prints_what_demo_prints(demo):
    _, text = demo
    shown = README.read_text("utf-8").split("```\nMasses")[1].split("```")[0]
    for line in shown.splitlines():
        for piece in line.split("..."):
            assert piece.strip() in text


def test_demo_finds_the_masses_and_writes_them_to_the_last_digit(demo):
    folder, _ = demo
    model = ChainModel.from_json(folder / "model.json")
    np.testing.assert_allclose(model.masses, MASSES, rtol=0.01)
    table = pd.read_csv(folder / "masses.csv")
    np.testing.assert_array_equal(table["mass_kg"], model.masses)


def test_demo_writes_tables_and_figures(demo):
    folder, _ = demo
    sites = set(pd.read_csv(folder / "coefficients.csv")["site"])
    assert sites == {"storey 1", "storey 2", "storey 3"}
    free = pd.read_csv(folder / "free_run_errors.csv").filter(like="percent")
    assert free.to_numpy().max() < 8
    assert pd.read_csv(folder / "modes.csv")["frequency_Hz"].is_monotonic_increasing
    assert is_picture(folder / "restoring_forces.png")
    assert is_picture(folder / "free_run.png")
    assert not list(folder.glob(".*"))


# -- own files -----------------------------------------------------------------


def test_own_file_in_mm_g_and_kn(here, spoken):
    """The bundled record as an engineer would have it: names, units, decimal commas."""
    record = datasets.load_demo().to_frame()
    table = pd.DataFrame({"Zeit": 1e3 * record.index, "Shaker": record["F2"] / 1e3})
    maps = ["--map", "t=Zeit @ ms", "--map", "F2=Shaker @ kN"]
    for j in (1, 2, 3):
        table[f"Acc {j}"] = record[f"a{j}"] / 9.80665
        table[f"Laser {j}"] = 1e3 * record[f"x{j}"]
        maps += ["--map", f"a{j}=Acc {j}", "--map", f"x{j}=Laser {j}"]
    table.to_csv("own.csv", sep=";", decimal=",", index=False)
    before = Path("own.csv").read_bytes()

    units = ["--unit", "a=g", "--unit", "x=mm"]
    assert run(["identify", "own.csv"] + units + maps + QUIET) == 0
    np.testing.assert_allclose(spoken()["masses_kg"], MASSES, rtol=0.01)
    assert Path("own.csv").read_bytes() == before
    assert not list(Path("nrf_output").glob("*.png"))


def hammered(floor):
    """The bundled frame without noise, hit and shaken on one floor."""
    rng = np.random.default_rng(floor)
    force = np.zeros((3000, 3))
    force[100:110, floor - 1] = 800 * np.hanning(10)
    force[900:1500, floor - 1] = 30 * rng.normal(size=600)
    return simulate(datasets.demo_truth(), force, 1e-3)


def test_roving_hammer_over_three_files(here, spoken):
    """Another floor is hit in each file; no file alone has all forces."""
    files = []
    for floor in (1, 2, 3):
        files.append(f"hit{floor}.csv")
        hammered(floor).to_frame().to_csv(files[-1])

    assert run(["identify", *files, "--raw"] + QUIET) == 0
    data = spoken()
    assert data["solve_order"][0].startswith("Balance of DOF 3 (forced)")
    np.testing.assert_allclose(data["masses_kg"], MASSES, rtol=1e-8)
    assert set(data["free_run_error_percent"]) == {"hit1", "hit2", "hit3"}


@pytest.fixture
def quake(here):
    """The bundled frame on a shaking base, which no force scales."""
    ag = excitation.band_limited_random(
        1, 15.0, 500.0, excited=1, rms=1.5, band=(0.3, 15), random_state=1
    )[:, 0]
    still = np.zeros((len(ag), 3))
    run = simulate(datasets.demo_truth(), still, 1 / 500, base_acceleration=ag)
    table = run.to_frame().drop(columns=["F1", "F2", "F3"])
    table.to_csv("quake.csv")
    return ["identify", "quake.csv", "--raw"]


def test_base_excitation_needs_a_mass(quake, capsys):
    assert run(quake) == ExitCode.DATA
    assert "cannot be scaled" in capsys.readouterr().out


def test_base_excitation_with_a_known_mass(quake, spoken):
    assert run([*quake, "--known-mass", "3=8", *QUIET]) == 0
    data = spoken()
    np.testing.assert_allclose(data["masses_kg"], MASSES, rtol=1e-7)
    # straight lines between samples of ag
    assert data["free_run_error_percent"]["quake"]["x3"] < 1


def test_a_base_known_by_its_displacement_beside_a_record_at_rest(here, spoken):
    """A shaking table read by a laser: its acceleration comes from xg."""
    t = np.arange(6000) / 500.0
    w = 2 * np.pi * np.linspace(1.0, 20.0, 30)
    phase = np.random.default_rng(2).uniform(0, 6, 30) + np.outer(t, w)
    ag = 0.3 * np.sin(phase).sum(axis=1)
    vg = -0.3 * (np.cos(phase) / w).sum(axis=1)
    xg = -0.3 * (np.sin(phase) / w**2).sum(axis=1)
    shaken = two_storeys(n=6000, ag=ag, name="quake").replace(
        base_acceleration=None, base_displacement=xg, base_velocity=vg
    )
    write_record(shaken, "quake.csv")
    write_record(two_storeys(name="shaker"), "shaker.csv")

    command = ["identify", "quake.csv", "shaker.csv", "--degree", "1"]
    assert run([*command, "--band", "1,40", *QUIET]) == 0
    assert spoken()["masses_kg"] == pytest.approx([8.0, 6.0], rel=0.01)


def test_a_floor_without_a_sensor(here, spoken):
    """The free run is fitted to the channels of the upper floor."""
    table = two_storeys().to_frame()[["F1", "F2", "a2", "x2"]]
    table.to_csv("few.csv")
    assert run(["identify", "few.csv", "--degree", "1"] + QUIET) == 0
    assert spoken()["masses_kg"] == pytest.approx([8.0, 6.0], rel=1e-6)
    assert Path("nrf_output/report.html").exists()


def test_two_records_of_one_name_have_a_row_each(here, capsys):
    for seed, place in enumerate(("monday", "tuesday")):
        Path(place).mkdir()
        two_storeys(seed=seed).to_frame().to_csv(f"{place}/test.csv")

    files = ["monday/test.csv", "tuesday/test.csv"]
    assert run(["identify", *files, "--degree", "1", "--no-figures"]) == 0
    assert "test (2)" in capsys.readouterr().out
    table = pd.read_csv("nrf_output/free_run_errors.csv", index_col=0)
    assert list(table.index) == ["test", "test (2)"]
    assert table.to_numpy().max() < 1.0


@pytest.fixture
def windy(here):
    """A record of which nobody knows what drives floor 1, and one of a shaker."""
    wind = two_storeys(name="wind")
    write_record(wind.replace(force=wind.force * [np.nan, 1.0]), "wind.csv")
    write_record(two_storeys(seed=1, name="shaker"), "shaker.csv")


def test_an_unknown_force_alone_identifies_nothing(windy):
    assert (
        run(["identify", "wind.csv", "--known-mass", "1=8", "--degree", "1"])
        == ExitCode.DATA
    )


def test_an_unknown_force_leaves_no_free_run(windy, capsys):
    """The record helps to fit, but cannot be run alone."""
    files = ["shaker.csv", "wind.csv"]
    assert run(["identify", *files, "--degree", "1", "--no-figures"]) == 0
    text = capsys.readouterr().out
    assert "free-run error of shaker" in text
    assert "free-run error of wind" not in text


# -- red verdicts --------------------------------------------------------------


@pytest.fixture
def flipped(here, capsys):
    """What is said of a force of the wrong sign: -F = m a + ..."""
    rec = two_storeys(name="flipped")
    rec.replace(force=-rec.force).to_frame().to_csv("flipped.csv")
    command = ["identify", "flipped.csv", "--degree", "1", "--no-figures"]
    assert run(command) == ExitCode.RED
    return capsys.readouterr().out


def test_a_force_of_the_wrong_sign_is_named(flipped):
    text = " ".join(flipped.split())
    assert "RED: Do not use this model." in text
    assert "all forces reversed" in text
    assert "m1 = -8" in text
    assert "Next:" not in text


def test_negative_masses_have_no_modes_and_no_free_run(flipped):
    assert "no free run: a mass is not positive" in flipped
    assert Path("nrf_output/masses.csv").exists()
    assert not Path("nrf_output/modes.csv").exists()


def test_forces_are_drawn_although_the_free_run_diverges(here, capsys):
    """Negative damping: the model explains the record, alone it flies away."""
    pytest.importorskip("matplotlib")
    t = np.arange(4000) / 200
    rng = np.random.default_rng(0)
    x = np.zeros_like(t)
    for w, phase in zip(np.linspace(5, 60, 40), rng.uniform(0, 6, 40)):
        x += np.sin(w * t + phase) / w
    v = np.gradient(x, t)
    a = np.gradient(v, t)
    force = 10.0 * a - 900.0 * v + 2e4 * x
    table = pd.DataFrame({"t": t, "F1": force, "a1": a, "v1": v, "x1": x})
    table[5:-5].to_csv("f.csv", index=False)

    assert run(["identify", "f.csv", "--degree", "1"]) == ExitCode.RED
    assert "no free run: The free run diverges" in capsys.readouterr().out
    assert Path("nrf_output/restoring_forces.png").exists()
    assert not Path("nrf_output/free_run.png").exists()


# -- measured files ------------------------------------------------------------


@pytest.fixture
def emps(here):
    """The drive of EMPS: only position and drive were measured."""
    path = str(measured.folder("emps") / "emps" / "DATA_EMPS.mat")
    maps = ["--map", "x1=qm", "--map", "F1=vir*35.1507", "--map", "t=t"]
    return ["identify", path, *maps, "--band", "0,20"]


@pytest.mark.slow
def test_emps_is_understood_and_cared_for(emps, capsys):
    assert run(emps + ["--degree", "1", "--no-figures"]) == 0
    text = capsys.readouterr().out
    assert "<- vir * 35.1507" in text
    assert "not used: gtau, kp, kv, qg" in text
    assert "0 to 20 Hz" in text
    section = text.split("What run finds")[1]
    assert "pysindy-nrf run" in section

    care = text.split("Take care")[1].split("Written to")[0]
    assert max(map(len, care.splitlines())) <= 110, "a terminal shows it whole"


def test_emps_has_the_published_mass(emps, spoken):
    """Published: 95.1 kg; dry friction is a sixth of the force."""
    assert run([*emps, "--degree", "1", *QUIET]) == 0
    data = spoken()
    assert data["masses_kg"] == pytest.approx([95.1], rel=0.02)
    assert 16 <= data["balance_error_percent"]["dof 1"] <= 18


@pytest.mark.slow
def test_a_power_series_in_place_of_friction_diverges(emps, spoken):
    assert run(emps + QUIET) == ExitCode.RED
    data = spoken()
    assert data["verdict"]["state"] == "red"
    assert "free run diverges" in data["verdict"]["sentence"]
    assert data["masses_kg"] == pytest.approx([95.1], rel=0.02)
    assert 8.5 <= data["balance_error_percent"]["dof 1"] <= 10


# -- frequency responses -------------------------------------------------------


@pytest.fixture
def measured_responses():
    folder = measured.folder("three_storey_frf") / "three_storey_frf"
    return str(folder / "cristallo_Experimental.csv")


def test_frequency_responses(here, spoken, measured_responses):
    """The masses are those that were stated by who built the frame."""
    command = ["identify", measured_responses, "--frf", "--excited", "1"]
    assert run(command + ["--band", "4,32", "--json"]) == 0
    assert spoken()["masses_kg"] == pytest.approx([5.201] * 3, rel=0.03)
    assert is_picture("nrf_output/frequency_response.png")


def test_frequency_responses_need_their_flag(here, capsys, measured_responses):
    assert run(["identify", measured_responses]) == ExitCode.DATA
    assert "--frf" in capsys.readouterr().err


@pytest.fixture
def responses(here):
    """Exact accelerance of two masses of 8 and 6 kg, forced on floor 1."""
    f = np.linspace(2, 25, 200)
    w = 2 * np.pi * f[:, None, None]
    M = np.diag([8.0, 6.0])
    K = np.array([[7e4, -3e4], [-3e4, 3e4]])
    C = np.array([[50.0, -20.0], [-20.0, 20.0]])
    receptance = np.linalg.inv(K - w**2 * M + 1j * w * C)[:, :, 0]
    accelerance = -(w[:, :, 0] ** 2) * receptance

    lines = ["f;H1;H2"]
    for frequency, row in zip(f, accelerance):
        values = [f"{z.real:.15g}{z.imag:+.15g}j" for z in row]
        lines.append(";".join([str(frequency), *values]))
    Path("H.csv").write_text("\n".join(lines))
    return ["identify", "H.csv", "--frf"]


def test_exact_frequency_responses(responses, spoken):
    assert run(responses + QUIET) == 0
    assert spoken()["masses_kg"] == pytest.approx([8.0, 6.0], rel=1e-6)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["H.csv"], "--frf takes one FILE"),
        (["--fs", "100"], "--fs does not go with"),
        (["--unit", "F=kN"], "--unit does not go with"),
        (["--degree", "3"], "linear laws only"),
    ],
)
def test_what_does_not_go_with_frequency_responses_is_refused(
    responses, capsys, more, words
):
    assert run([*responses, *more]) == ExitCode.USAGE
    assert words in capsys.readouterr().err


# -- laws, orders, comparison --------------------------------------------------


def test_laws_by_name(here, spoken, demo_file):
    law = "storey 1=linear_viscous+duffing"
    assert run(["identify", demo_file, "--degree", "1", "--law", law] + QUIET) == 0
    data = spoken()
    names = [entry["law"] for entry in data["model"]["laws"]["storey 1"]]
    assert names == ["linear_viscous", "duffing"]
    np.testing.assert_allclose(data["masses_kg"], MASSES, rtol=0.01)
    table = read_table("nrf_output/masses.csv").variables
    np.testing.assert_array_equal(table["mass_kg"], data["masses_kg"])


ORDERS = ["--degrees", "1,3,4", "--box", "1,2"]


def test_select_order_says_what_to_do_next(here, capsys, demo_file):
    assert run(["select-order", demo_file, *ORDERS]) == 0
    text = capsys.readouterr().out
    assert "identify ... --degree 3" in text
    assert "--order 'storey 2=1'" in text
    assert is_picture("nrf_output/orders.png")
    assert len(pd.read_csv("nrf_output/orders.csv")) == 4


def test_select_order_finds_the_cubic(here, spoken, demo_file):
    assert run(["select-order", demo_file, *ORDERS, *QUIET]) == 0
    data = spoken()
    assert data["best_order"] == 3
    assert data["orders_by_storey"]["storey 2"] == 1


def test_compare_with_the_truth(here, spoken, demo_file, truth_file):
    command = ["compare", demo_file, "--truth", truth_file]
    assert run(command + ["--time-limit", "0.2", "--json"]) == 0
    table = spoken()["table"]
    assert table["pysindy_nrf, least squares"]["mass_error"] < 1
    assert table["SINDy, defaults"]["terms"] > 100
    assert "terms" in pd.read_csv("nrf_output/comparison.csv")


# -- changes -------------------------------------------------------------------


@pytest.fixture
def tests_of_a_frame(here):
    """A frame of two storeys before and after storey 2 lost 10 %, and damped.

    The damper in storey 1 is viscous, 100 N s/m.
    """
    F = excitation.band_limited_random(
        2, 8.0, 500.0, excited=[1, 2], rms=50.0, band=(1, 40), random_state=1
    )
    for name, k2, c1 in (
        ("before", 4e4, 60.0),
        ("after", 3.6e4, 60.0),
        ("damped", 4e4, 160.0),
    ):
        lower = laws.PowerSeries(1, [c1, 4e4])
        upper = laws.PowerSeries(1, [60.0, k2])
        model = ChainModel([10.0, 12.0], {1: lower, 2: upper})
        simulate(model, F, 2e-3).to_frame().to_csv(f"{name}.csv")


def test_damage_says_where_how_much_and_draws_it(tests_of_a_frame, spoken):
    assert run(["damage", "before.csv", "after.csv", "--json"]) == 0
    data = spoken()
    assert data["damaged"] == ["storey 2"]
    assert {verdict["state"] for verdict in data["verdicts"].values()} == {"green"}
    for mode in data["modes"]:
        assert mode["frequency after"] < mode["frequency before"]
        assert 0.99 < mode["mac"] < 1
    assert data["said"][0].startswith("Stiffness of storey 2 changed by -10.0")
    assert data["changed"][0]["change"] == pytest.approx(-10.0, abs=0.05)
    names = [Path(name).name for name in data["files"]]
    assert names[:3] == ["changed.csv", "fitted_apart.csv", "change.png"]
    table = pd.read_csv("nrf_output/changed.csv")
    assert table["place"].tolist() == ["storey 2"]


def test_forces_of_a_damper(tests_of_a_frame, spoken):
    """A dashpot of 100 N s/m takes c v^2 of power."""
    command = ["forces", "damped.csv", "--bare", "before.csv"]
    assert run(command + ["--degree", "1", "--json"]) == 0
    storeys = spoken()["storeys"]
    motion = pd.read_csv("damped.csv")
    rate = motion["v1"]
    lower, upper = storeys["storey 1"], storeys["storey 2"]

    rms = 100.0 * np.sqrt(np.mean(rate**2))
    assert lower["damper, rms (N)"] == pytest.approx(rms, rel=0.02)
    assert upper["damper, rms (N)"] < 0.02 * lower["damper, rms (N)"]
    energy = 100.0 * np.trapezoid(rate**2, motion["t"])
    assert lower["dissipated by the damper (J)"] == pytest.approx(energy, rel=0.02)
    assert len(pd.read_csv("nrf_output/forces.csv")) == len(motion)
    assert is_picture("nrf_output/energy.png")
