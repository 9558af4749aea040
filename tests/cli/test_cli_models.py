"""Commands that find models, on bundled, own and measured files: masses, words, tables
and figures.
"""

from pathlib import Path

import measured
import numpy as np
import pandas as pd
import pytest
from report_cases import two_storeys

from pysindy_nrf import ChainModel, datasets, excitation, laws, simulate
from pysindy_nrf.cli.group import run
from pysindy_nrf.cli.outcome import RED
from pysindy_nrf.records.files import read_table, write_record


def test_demo_does_the_main_job(here, capsys):
    assert run(["demo"]) == 0
    said = capsys.readouterr().out
    for words in (
        "known to be unforced: DOFs 1, 3",
        "Balance of DOF 2 (forced): m2, storey 2, storey 3.",
    ):
        assert words in said
    shown = (
        Path(__file__)
        .parents[2]
        .joinpath("README.md")
        .read_text("utf-8")
        .split("```\nMasses")[1]
        .split("```")[0]
    )
    for piece in (
        piece.strip() for line in shown.splitlines() for piece in line.split("...")
    ):
        assert piece in said, f"README prints {piece!r}"
    folder = here / "nrf_demo"
    model = ChainModel.from_json(folder / "model.json")
    np.testing.assert_allclose(model.masses, [12, 10, 8], rtol=0.01)
    np.testing.assert_array_equal(
        pd.read_csv(folder / "masses.csv", float_precision="round_trip")["mass_kg"],
        model.masses,
    )
    assert set(pd.read_csv(folder / "coefficients.csv")["site"]) == {
        "storey 1",
        "storey 2",
        "storey 3",
    }
    free = pd.read_csv(folder / "free_run_errors.csv")
    assert free.filter(like="percent").to_numpy().max() < 8
    assert pd.read_csv(folder / "modes.csv")["frequency_Hz"].is_monotonic_increasing
    for name in ("restoring_forces.png", "free_run.png"):
        assert (folder / name).read_bytes()[:4] == b"\x89PNG"
    assert not list(folder.glob(".*"))


def test_own_file_in_mm_g_and_kn(here, spoken):
    """The bundled record as an engineer would have it: other names, other units,
    decimal commas.
    """
    table = datasets.load_demo().to_frame()
    own = pd.DataFrame({"Zeit": 1e3 * table.index, "Shaker": table["F2"] / 1e3})
    for j in (1, 2, 3):
        own[f"Acc {j}"], own[f"Laser {j}"] = (
            table[f"a{j}"] / 9.80665,
            1e3 * table[f"x{j}"],
        )
    own.to_csv("own.csv", sep=";", decimal=",", index=False)
    maps = [
        "t=Zeit @ ms",
        "F2=Shaker @ kN",
        *(f"a{j}=Acc {j}" for j in (1, 2, 3)),
        *(f"x{j}=Laser {j}" for j in (1, 2, 3)),
    ]
    before = Path("own.csv").read_bytes()
    command = [
        "identify",
        "own.csv",
        "--unit",
        "a=g",
        "--unit",
        "x=mm",
        "--json",
        "--no-figures",
    ]
    for text in maps:
        command += ["--map", text]
    assert run(command) == 0
    np.testing.assert_allclose(spoken()["masses_kg"], [12, 10, 8], rtol=0.01)
    assert (
        not list((here / "nrf_output").glob("*.png"))
        and Path("own.csv").read_bytes() == before
    )


def test_roving_hammer_over_three_files(here, spoken):
    """Another floor is hit in each file; no file alone has all forces. Noise-free:
    exact.
    """
    truth = datasets.demo_truth()
    rng = np.random.default_rng(0)
    for j in (1, 2, 3):
        force = np.zeros((3000, 3))
        force[100:110, j - 1] = 800 * np.hanning(10)
        force[900:1500, j - 1] = 30 * rng.normal(size=600)
        simulate(truth, force, 1e-3).to_frame().to_csv(f"hit{j}.csv")
    assert (
        run(
            [
                "identify",
                "hit1.csv",
                "hit2.csv",
                "hit3.csv",
                "--raw",
                "--json",
                "--no-figures",
            ]
        )
        == 0
    )
    data = spoken()
    assert data["solve_order"][0].startswith("Balance of DOF 3 (forced)")
    np.testing.assert_allclose(data["masses_kg"], [12, 10, 8], rtol=1e-8)
    assert set(data["free_run_error_percent"]) == {"hit1", "hit2", "hit3"}


def test_base_excitation_with_a_known_mass(here, capsys, spoken):
    ag = excitation.band_limited_random(
        1, 15.0, 500.0, excited=1, rms=1.5, band=(0.3, 15), random_state=1
    )[:, 0]
    simulate(
        datasets.demo_truth(), np.zeros((len(ag), 3)), 1 / 500, base_acceleration=ag
    ).to_frame().drop(columns=["F1", "F2", "F3"]).to_csv("quake.csv")
    assert run(["identify", "quake.csv", "--raw"]) == 3
    assert "cannot be scaled" in capsys.readouterr().out
    assert (
        run(
            [
                "identify",
                "quake.csv",
                "--raw",
                "--known-mass",
                "3=8",
                "--json",
                "--no-figures",
            ]
        )
        == 0
    )
    data = spoken()
    np.testing.assert_allclose(data["masses_kg"], [12, 10, 8], rtol=1e-7)
    assert (
        data["free_run_error_percent"]["quake"]["x3"] < 1
    )  # straight lines between samples of ag


def test_emps(here, capsys, spoken):
    """Only position and drive were measured; published mass 95.1 kg."""
    path = measured.folder("emps") / "emps" / "DATA_EMPS.mat"
    command = [
        "identify",
        str(path),
        "--map",
        "x1=qm",
        "--map",
        "F1=vir*35.1507",
        "--map",
        "t=t",
        "--band",
        "0,20",
    ]
    assert run([*command, "--degree", "1"]) == 0
    said = capsys.readouterr().out
    assert (
        "<- vir * 35.1507" in said
        and "not used: gtau, kp, kv, qg" in said
        and "0 to 20 Hz" in said
    )
    assert "Take care" in said and "Next: pysindy-nrf close-loop" in said
    care = said.split("Take care")[1].split("Written to")[0]
    assert max(map(len, care.splitlines())) <= 110  # a terminal shows it whole
    assert run([*command, "--degree", "1", "--json"]) == 0
    data = spoken()
    assert 93 <= data["masses_kg"][0] <= 97
    assert 16 <= data["balance_error_percent"]["dof 1"] <= 18
    assert (
        run([*command, "--json"]) == RED
    )  # a power series in place of friction: its free run diverges
    data = spoken()
    assert (
        data["verdict"]["state"] == "red"
        and "free run diverges" in data["verdict"]["sentence"]
    )
    assert (
        93 <= data["masses_kg"][0] <= 97
        and 8.5 <= data["balance_error_percent"]["dof 1"] <= 10
    )


def test_frequency_responses(here, capsys, spoken):
    path = (
        measured.folder("three_storey_frf")
        / "three_storey_frf"
        / "cristallo_Experimental.csv"
    )
    assert (
        run(
            [
                "identify",
                str(path),
                "--frf",
                "--excited",
                "1",
                "--band",
                "4,32",
                "--json",
            ]
        )
        == 0
    )
    assert spoken()["masses_kg"] == pytest.approx(
        [5.201] * 3, rel=0.03
    )  # as stated by those who built it
    assert (here / "nrf_output" / "frequency_response.png").is_file()
    assert run(["identify", str(path)]) == 3
    assert "--frf" in capsys.readouterr().err


def response_file(path):
    f = np.linspace(2, 25, 200)
    w = 2 * np.pi * f[:, None, None]
    K, C = (
        np.array([[7e4, -3e4], [-3e4, 3e4]]),
        np.array([[50.0, -20.0], [-20.0, 20.0]]),
    )
    H = (
        -(w[:, :, 0] ** 2)
        * np.linalg.inv(K - w**2 * np.diag([8.0, 6.0]) + 1j * w * C)[:, :, 0]
    )
    rows = [
        ";".join([f"{a}", *(f"{z.real:.15g}{z.imag:+.15g}j" for z in row)])
        for a, row in zip(f, H)
    ]
    Path(path).write_text("\n".join(["f;H1;H2", *rows]))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["H.csv"], "--frf takes one FILE"),
        (["--fs", "100"], "--fs does not go with --frf"),
        (["--map", "F1=p"], "--map does not go with --frf"),
        (["--degree", "3"], "linear laws only"),
    ],
)
def test_what_does_not_go_with_frequency_responses_is_refused(
    here, capsys, more, words
):
    response_file("H.csv")
    assert run(["identify", "H.csv", "--frf", *more]) == 2
    assert words in capsys.readouterr().err


def test_exact_frequency_responses(here, capsys, spoken):
    response_file("H.csv")
    assert run(["identify", "H.csv", "--frf", "--json", "--no-figures"]) == 0
    assert spoken()["masses_kg"] == pytest.approx([8.0, 6.0], rel=1e-6)


def test_a_base_known_by_its_displacement_beside_a_record_at_rest(here, spoken):
    """A shaking table read by a laser: its acceleration comes from xg; in the other
    record the base does not move.
    """
    t = np.arange(6000) / 500.0
    w = 2 * np.pi * np.linspace(1.0, 20.0, 30)
    p = np.random.default_rng(2).uniform(0, 6, 30)
    ag = 0.3 * np.sin(np.outer(t, w) + p).sum(axis=1)
    xg, vg = (
        0.3 * (np.sin(np.outer(t, w) + p + q) / w**k).sum(axis=1)
        for q, k in ((np.pi, 2), (-np.pi / 2, 1))
    )
    shaken = two_storeys(n=6000, ag=ag, name="quake").replace(
        base_acceleration=None, base_displacement=xg, base_velocity=vg
    )
    write_record(shaken, "quake.csv")
    write_record(two_storeys(name="shaker"), "shaker.csv")
    assert (
        run(
            [
                "identify",
                "quake.csv",
                "shaker.csv",
                "--degree",
                "1",
                "--band",
                "1,40",
                "--no-figures",
                "--json",
            ]
        )
        == 0
    )
    assert spoken()["masses_kg"] == pytest.approx([8.0, 6.0], rel=0.01)


def test_two_records_of_one_name_have_a_row_each(here, capsys):
    for k, place in enumerate(("monday", "tuesday")):
        Path(place).mkdir()
        two_storeys(seed=k).to_frame().to_csv(f"{place}/test.csv")
    files = ["monday/test.csv", "tuesday/test.csv"]
    assert run(["identify", *files, "--degree", "1", "--no-figures"]) == 0
    said = capsys.readouterr().out
    assert "test (2)" in said
    table = pd.read_csv("nrf_output/free_run_errors.csv", index_col=0)
    assert list(table.index) == ["test", "test (2)"] and table.to_numpy().max() < 1.0


def test_an_unknown_force_leaves_no_free_run(here, capsys):
    """Nobody knows what drives floor 1 in the wind: this record helps to fit, but
    cannot be run alone.
    """
    wind = two_storeys(name="wind")
    write_record(wind.replace(force=wind.force * [np.nan, 1.0]), "wind.csv")
    write_record(two_storeys(seed=1, name="shaker"), "shaker.csv")
    assert run(["identify", "wind.csv", "--known-mass", "1=8", "--degree", "1"]) == 3
    capsys.readouterr()
    assert (
        run(["identify", "shaker.csv", "wind.csv", "--degree", "1", "--no-figures"])
        == 0
    )
    said = capsys.readouterr().out
    assert "free-run error of shaker" in said and "free-run error of wind" not in said


def test_a_force_of_the_wrong_sign_is_said_and_has_no_modes(here, capsys):
    """-F = m a + ... : every mass comes out negative, which no structure is."""
    rec = two_storeys(name="flipped")
    rec.replace(force=-rec.force).to_frame().to_csv("flipped.csv")
    assert run(["identify", "flipped.csv", "--degree", "1", "--no-figures"]) == RED
    said = capsys.readouterr().out
    assert (
        "RED: Do not use this model. With all forces reversed every balance closes"
        in said
    )
    assert (
        "  - m1 = -8.0" in said
        and "no structure has a mass that is not positive" in " ".join(said.split())
    )
    assert "Next:" not in said
    assert "no free run: a mass is not positive" in said
    assert (
        not Path("nrf_output/modes.csv").exists()
        and Path("nrf_output/masses.csv").exists()
    )


def test_forces_are_drawn_although_the_free_run_diverges(here, capsys):
    """Negative damping: the model explains the record, alone it flies away; the picture
    of its forces is still wanted.
    """
    pytest.importorskip("matplotlib")
    t = np.arange(4000) / 200
    rng = np.random.default_rng(0)
    x = sum(
        np.sin(w * t + p) / w
        for w, p in zip(np.linspace(5, 60, 40), rng.uniform(0, 6, 40))
    )
    v, a = np.gradient(x, t), np.gradient(np.gradient(x, t), t)
    force = 10.0 * a - 900.0 * v + 2e4 * x
    pd.DataFrame({"t": t, "F1": force, "a1": a, "v1": v, "x1": x})[5:-5].to_csv(
        "f.csv", index=False
    )
    assert run(["identify", "f.csv", "--degree", "1"]) == RED
    assert "no free run: The free run diverges" in capsys.readouterr().out
    assert (
        Path("nrf_output/restoring_forces.png").exists()
        and not Path("nrf_output/free_run.png").exists()
    )


def test_laws_by_name(here, spoken, demo_file):
    command = ["identify", demo_file, "--no-figures", "--json"]
    assert (
        run([*command, "--degree", "1", "--law", "storey 1=linear_viscous+duffing"])
        == 0
    )
    data = spoken()
    assert [law["law"] for law in data["model"]["laws"]["storey 1"]] == [
        "linear_viscous",
        "duffing",
    ]
    np.testing.assert_allclose(data["masses_kg"], [12, 10, 8], rtol=0.01)
    masses = read_table("nrf_output/masses.csv").variables["mass_kg"]
    np.testing.assert_array_equal(masses, data["masses_kg"])


def test_select_order_finds_the_cubic_and_says_what_to_do_next(
    here, capsys, spoken, demo_file
):
    command = ["select-order", demo_file, "--degrees", "1,3,4", "--box", "1,2"]
    assert run(command) == 0
    said = capsys.readouterr().out
    assert "identify ... --degree 3" in said and "--order 'storey 2=1'" in said
    assert (
        Path("nrf_output/orders.png").exists()
        and len(pd.read_csv("nrf_output/orders.csv")) == 4
    )
    assert run([*command, "--no-figures", "--json"]) == 0
    data = spoken()
    assert data["best_order"] == 3 and data["orders_by_storey"]["storey 2"] == 1


def test_compare_with_the_truth(here, spoken, demo_file, truth_file):
    assert (
        run(
            [
                "compare",
                demo_file,
                "--truth",
                truth_file,
                "--time-limit",
                "0.2",
                "--json",
            ]
        )
        == 0
    )
    table = spoken()["table"]
    assert (
        table["pysindy_nrf, least squares"]["mass_error"]
        < 1
        < table["SINDy, defaults"]["terms"] / 100
    )
    assert "terms" in pd.read_csv("nrf_output/comparison.csv")


@pytest.fixture
def two_tests(here):
    """A frame of two storeys, tested before and after storey 2 lost 10 %, and with a
    viscous damper in storey 1.
    """
    F = excitation.band_limited_random(
        2, 8.0, 500.0, excited=[1, 2], rms=50.0, band=(1, 40), random_state=1
    )
    for name, k2, c1 in (
        ("before", 4e4, 60.0),
        ("after", 3.6e4, 60.0),
        ("damped", 4e4, 160.0),
    ):
        model = ChainModel(
            [10.0, 12.0],
            {1: laws.PowerSeries(1, [c1, 4e4]), 2: laws.PowerSeries(1, [60.0, k2])},
        )
        simulate(model, F, 2e-3).to_frame().to_csv(f"{name}.csv")


def test_damage_says_where_how_much_and_draws_it(two_tests, here, spoken):
    assert run(["damage", "before.csv", "after.csv", "--json"]) == 0
    data = spoken()
    assert data["damaged"] == ["storey 2"] and data["said"][0].startswith(
        "Stiffness of storey 2 changed by -10.0"
    )
    assert data["changed"][0]["change"] == pytest.approx(-10.0, abs=0.05)
    assert [Path(name).name for name in data["files"]] == [
        "changed.csv",
        "fitted_apart.csv",
        "change.png",
    ]
    assert pd.read_csv(here / "nrf_output" / "changed.csv")["place"].tolist() == [
        "storey 2"
    ]


def test_forces_of_storeys_and_of_a_damper(two_tests, here, spoken):
    assert (
        run(["forces", "damped.csv", "--bare", "before.csv", "--degree", "1", "--json"])
        == 0
    )
    storeys = spoken()["storeys"]
    written = pd.read_csv(here / "nrf_output" / "forces.csv")
    motion = pd.read_csv("damped.csv")
    rate = motion["v1"]
    assert storeys["storey 1"]["damper, rms (N)"] == pytest.approx(
        100.0 * np.sqrt(np.mean(rate**2)), rel=0.02
    )
    assert (
        storeys["storey 2"]["damper, rms (N)"]
        < 0.02 * storeys["storey 1"]["damper, rms (N)"]
    )
    assert storeys["storey 1"]["dissipated by the damper (J)"] == pytest.approx(
        100.0 * np.trapezoid(rate**2, motion["t"]), rel=0.02
    )
    assert (
        len(written) == len(motion)
        and (here / "nrf_output" / "energy.png").read_bytes()[:4] == b"\x89PNG"
    )
