"""Commands on records that are odd but allowed, and on what they must refuse: words, codes and files."""

import gc
import io
import json
import os
import sys
import time
from pathlib import Path

import chains
import click
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, Record, datasets, excitation, laws, simulate
from pysindy_nrf.data.io import write_record
from pysindy_nrf.output.cli import group, options
from pysindy_nrf.output.cli.group import run


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def two_storeys(seed=0, n=4000, fs=500.0, ag=None, name="r", covariates=None, held=None):
    """Free run of a linear frame of 8 and 6 kg."""
    given = held or {
        "storey 1": [laws.PowerSeries(1, [30.0, 4e4])],
        "storey 2": [laws.PowerSeries(1, [20.0, 3e4])],
    }
    model = ChainModel([8.0, 6.0], given)
    F = excitation.band_limited_random(2, n / fs, fs, dofs=[1, 2], rms=60.0, band=(1, 40), random_state=seed)
    if ag is not None:
        F = 0.0 * F
    return simulate(model, F, 1 / fs, base_acceleration=ag, name=name, covariates=covariates)


def spoken(capsys):
    return json.loads(capsys.readouterr().out)


# -- identify ---------------------------------------------------------------------------------


def test_a_base_known_by_its_displacement_beside_a_record_at_rest(here, capsys):
    """A shaking table read by a laser: its acceleration comes from xg; in the other record the base does not move."""
    t = np.arange(6000) / 500.0
    w = 2 * np.pi * np.linspace(1.0, 20.0, 30)
    p = np.random.default_rng(2).uniform(0, 6, 30)
    ag = 0.3 * np.sin(np.outer(t, w) + p).sum(axis=1)
    xg, vg = (0.3 * (np.sin(np.outer(t, w) + p + q) / w**k).sum(axis=1) for q, k in ((np.pi, 2), (-np.pi / 2, 1)))
    shaken = two_storeys(n=6000, ag=ag, name="quake").replace(
        base_acceleration=None, base_displacement=xg, base_velocity=vg
    )
    write_record(shaken, "quake.csv")
    write_record(two_storeys(name="shaker"), "shaker.csv")
    assert run(["identify", "quake.csv", "shaker.csv", "--degree", "1", "--band", "1,40", "--no-figures", "--json"]) == 0
    assert spoken(capsys)["masses_kg"] == pytest.approx([8.0, 6.0], rel=0.01)


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
    """Nobody knows what drives floor 1 in the wind: this record helps to fit, but cannot be run alone."""
    wind = two_storeys(name="wind")
    write_record(wind.replace(force=wind.force * [np.nan, 1.0]), "wind.csv")
    write_record(two_storeys(seed=1, name="shaker"), "shaker.csv")
    assert run(["identify", "wind.csv", "--known-mass", "1=8", "--degree", "1"]) == 3
    assert run(["identify", "wind.csv", "shaker.csv", "--degree", "1", "--dry-run"]) == 0
    capsys.readouterr()
    assert run(["identify", "shaker.csv", "wind.csv", "--degree", "1", "--no-figures"]) == 0
    said = capsys.readouterr().out
    assert "free-run error of shaker" in said and "free-run error of wind" not in said


def test_a_force_of_the_wrong_sign_is_said_and_has_no_modes(here, capsys):
    """-F = m a + ... : every mass comes out negative, which no structure is."""
    rec = two_storeys(name="flipped")
    rec.replace(force=-rec.force).to_frame().to_csv("flipped.csv")
    assert run(["identify", "flipped.csv", "--degree", "1", "--no-figures"]) == 0
    said = capsys.readouterr().out
    assert "m1, m2 came out negative: the data do not determine this balance" in said
    assert "no free run: a mass is not positive" in said
    assert not Path("nrf_output/modes.csv").exists() and Path("nrf_output/masses.csv").exists()


def test_noise_in_the_force_alone_is_called_a_missing_law_or_noise(here, capsys):
    """White noise of 30 % in F biases nothing, so no warning stands in the way of the advice."""
    rec = two_storeys(name="noisy", n=8000)
    noise = 0.3 * rec.force.std(axis=0) * np.random.default_rng(0).standard_normal(rec.force.shape)
    rec.replace(force=rec.force + noise).to_frame().to_csv("noisy.csv")
    assert run(["identify", "noisy.csv", "--degree", "1", "--raw", "--no-figures"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Much of the force is unexplained in the balance of DOF 1" in said
    assert "A law is missing, or the channels are noisy" in said


def test_a_band_without_an_upper_end_and_five_pictures(here, capsys):
    """Four storeys and a brace are five restoring forces on a sheet of six."""
    case = chains.duffing(4, [1, 2, 3, 4], seed=5, n_samples=2000, cubic=False)
    x, v = np.cumsum(case.s, axis=1), np.cumsum(case.v, axis=1)
    rec = Record(force=case.F, acceleration=case.a, velocity=v, displacement=x, fs=1000.0, name="tall")
    rec.to_frame().to_csv("tall.csv")
    assert run(["identify", "tall.csv", "--degree", "1", "--band", "5,none", "--link", "link 3-1", "--raw"]) == 0
    assert "above 5 Hz" in capsys.readouterr().out
    assert Path("nrf_output/restoring_forces.png").stat().st_size > 10_000


def test_a_channel_that_no_law_reads_does_no_harm(here, capsys):
    """A voltage in the file, mapped under its own name: it is listed, and the masses are what they are without it."""
    voltage = 2.0 + np.sin(3 * np.arange(4000) / 500.0)
    two_storeys().replace(covariates={"voltage": voltage}).to_frame().to_csv("pressed.csv")
    more = ["--map", "voltage=voltage", "--raw", "--json", "--no-figures"]
    assert run(["identify", "pressed.csv", "--degree", "1", *more]) == 0
    said = spoken(capsys)
    assert said["masses_kg"] == pytest.approx([8.0, 6.0], rel=1e-6) and "voltage" in json.dumps(said["records"])


# -- frequency responses, orders, plans, comparisons ------------------------------------------


def response_file(path):
    f = np.linspace(2, 25, 200)
    w = 2 * np.pi * f[:, None, None]
    K, C = np.array([[7e4, -3e4], [-3e4, 3e4]]), np.array([[50.0, -20.0], [-20.0, 20.0]])
    H = -(w[:, :, 0] ** 2) * np.linalg.inv(K - w**2 * np.diag([8.0, 6.0]) + 1j * w * C)[:, :, 0]
    rows = [";".join([f"{a}", *(f"{z.real:.15g}{z.imag:+.15g}j" for z in row)]) for a, row in zip(f, H)]
    Path(path).write_text("\n".join(["f;H1;H2", *rows]))


def test_frequency_responses_take_one_file_and_no_channels(here, capsys):
    response_file("H.csv")
    assert run(["identify", "H.csv", "H.csv", "--frf"]) == 2
    assert "--frf takes one FILE" in capsys.readouterr().err
    assert run(["identify", "H.csv", "--frf", "--fs", "100"]) == 2
    assert "--fs does not go with --frf" in capsys.readouterr().err
    assert run(["identify", "H.csv", "--frf", "--dry-run"]) == 0
    assert "kg" not in capsys.readouterr().out and not Path("nrf_output").exists()
    assert run(["identify", "H.csv", "--frf", "--json", "--no-figures"]) == 0
    assert spoken(capsys)["masses_kg"] == pytest.approx([8.0, 6.0], rel=1e-6)


def test_orders_with_a_box_are_drawn(here, capsys):
    """A linear frame: degree 1 wins over degree 2 and over the box 1,2."""
    two_storeys(n=2500).to_frame().to_csv("r.csv")
    assert run(["select-order", "r.csv", "--degrees", "1-2", "--box", "1,2", "--folds", "3"]) == 0
    assert Path("nrf_output/orders.png").exists()
    table = pd.read_csv("nrf_output/orders.csv")
    assert len(table) == 3 and capsys.readouterr().out.count("order")


def test_a_plan_where_no_floor_can_be_hit(here, capsys):
    assert run(["plan", "3", "--can-hit", "none"]) == 0
    said = capsys.readouterr().out
    assert "No floor can be hit with a known force; give a mass" in said and "the best first" not in said
    datasets.demo_truth().to_json("model.json")
    assert run(["plan", "5", "--model", "model.json"]) == 2
    assert "The model has 3 floors, not 5" in capsys.readouterr().err


def test_compare_takes_one_record(here, capsys):
    for name in ("a.csv", "b.csv"):
        two_storeys(n=500).to_frame().to_csv(name)
    Path("two.toml").write_text('files = ["a.csv", "b.csv"]\n')
    assert run(["compare", "--mapping", "two.toml"]) == 2
    assert "compare takes one record" in capsys.readouterr().err


# -- simulate ---------------------------------------------------------------------------------


def test_a_run_beyond_what_the_model_knows_is_warned_of(here, capsys):
    """Ten times the force gives ten times the drift of a linear frame: past the data of the model, and said so."""
    two_storeys(name="fit").to_frame().to_csv("fit.csv")
    assert run(["identify", "fit.csv", "--degree", "1", "--no-figures", "--link", "ground 2"]) == 0
    capsys.readouterr()
    rec = two_storeys()
    pd.DataFrame({"t": rec.time, "F1": 10 * rec.force[:, 0], "F2": 10 * rec.force[:, 1]}).to_csv("big.csv", index=False)
    assert run(["simulate", "nrf_output/model.json", "big.csv"]) == 0
    shown = capsys.readouterr()
    said = shown.out + shown.err
    assert "storey 1 drifts" in said and "its force beyond is a guess" in said and "ground 2 drifts" not in said
    assert run(["simulate", "nrf_output/model.json", "fit.csv"]) == 0
    shown = capsys.readouterr()
    assert "is a guess" not in shown.out + shown.err


def test_forces_in_two_files_of_one_test(here, capsys):
    """together = true: each force in its own file, one clock."""
    rec = two_storeys()
    for j in (0, 1):
        pd.DataFrame({"t": rec.time, "load": rec.force[:, j]}).to_csv(f"jack{j + 1}.csv", index=False)
    Path("test.toml").write_text(
        'files = ["jack1.csv", "jack2.csv"]\ntogether = true\n[channels]\nF1 = "jack1.load"\nF2 = "jack2.load"\n'
    )
    ChainModel(
        [8.0, 6.0], {"storey 1": [laws.PowerSeries(1, [30.0, 4e4])], "storey 2": [laws.PowerSeries(1, [20.0, 3e4])]}
    ).to_json("model.json")
    assert run(["simulate", "model.json", "--mapping", "test.toml", "-o", "answer.csv"]) == 0
    from pysindy_nrf.data.io import read_record

    np.testing.assert_allclose(read_record("answer.csv").displacement, rec.displacement, rtol=1e-6, atol=1e-12)


# -- what every command shares ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (options.Pair("KEY=VALUE"), "x1=Laser"),
        (options.Mass(), "2=12.4"),
        (options.LawNames(), "storey 1=dahl+cubic_stiffness"),
        (options.SiteDegree(), "storey 2=1,3"),
        (options.Band(), "0.5,none"),
        (options.Numbers(), "0.001,0"),
        (options.Range(), "1-4"),
        (options.Floors(), "1,3"),
    ],
)
def test_a_value_that_was_converted_is_left_alone(kind, text):
    """click converts defaults and values of a default map again; the second time must change nothing."""
    once = kind.convert(text, None, None)
    assert kind.convert(once, None, None) == once and not isinstance(once, str)


def test_alone_it_shows_what_it_can_do(capsys):
    assert run([]) == 2
    assert "identify" in "".join(capsys.readouterr())


def test_main_leaves_with_the_code(capsys):
    for arguments, code in ((["--version"], 0), (["identify"], 2)):
        with pytest.raises(SystemExit) as left:
            group.main(arguments)
        assert (left.value.code or 0) == code
    capsys.readouterr()


def test_a_missing_reader_is_named(here, capsys, monkeypatch):
    Path("a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert run(["inspect", "a.h5"]) == 1
    assert "pysindy_nrf[files]" in capsys.readouterr().err


@pytest.mark.parametrize(("fault", "words"), [(MemoryError(), "Not enough memory"), (RecursionError(), "nested too deeply")])
def test_a_machine_that_gives_up_is_a_sentence(here, capsys, monkeypatch, fault, words):
    from pysindy_nrf import NRFRegressor

    def gives_up(self, *args, **options):
        raise fault

    two_storeys(n=500).to_frame().to_csv("a.csv")
    monkeypatch.setattr(NRFRegressor, "fit", gives_up)
    assert run(["identify", "a.csv"]) == 1
    shown = capsys.readouterr().err
    assert words in shown and "Traceback" not in shown


def test_a_reader_that_has_left_is_no_fault(monkeypatch):
    """`pysindy-nrf plan 8 | head -1`: the other end of the pipe is closed."""
    read, write = os.pipe()
    os.close(read)
    said = io.StringIO()
    with monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", os.fdopen(write, "w", buffering=1))
        patched.setattr(sys, "stderr", said)
        try:
            code = run(["plan", "8"])
        except SystemExit as left:
            code = left.code
        assert code == 1
    assert said.closed or "Traceback" not in said.getvalue()


class Falls:
    def __init__(self, fault):
        self.fault = fault

    def __del__(self):
        raise self.fault


def test_ctrl_c_inside_a_callback_comes_again_and_other_faults_pass(monkeypatch):
    """What Python cannot raise in a destructor it hands to a hook: Ctrl-C must come back, the rest go its way."""
    passed = []
    monkeypatch.setattr(sys, "unraisablehook", lambda fault: passed.append(fault.exc_type))
    with group._heard():
        thing = Falls(ValueError("of another library"))
        del thing
        gc.collect()
    assert passed == [ValueError]
    with pytest.raises(KeyboardInterrupt), group._heard():
        thing = Falls(KeyboardInterrupt())
        del thing
        time.sleep(5)
    assert passed == [ValueError]


def test_without_the_extra_of_the_page_there_is_none_and_it_says_so(here, capsys, monkeypatch):
    from pysindy_nrf.output.report import write

    two_storeys(n=1500).to_frame().to_csv("a.csv")
    real = write.find_spec
    monkeypatch.setattr(write, "find_spec", lambda name, *rest: None if name == "jinja2" else real(name, *rest))
    assert run(["identify", "a.csv", "--degree", "1", "--no-figures"]) == 0
    assert "No page: pip install 'pysindy-nrf[report]'" in capsys.readouterr().out
    assert not list(Path("nrf_output").glob("*.html"))


def test_every_law_by_name_stands_alone():
    """--law SITE=NAME makes a law without arguments; each name of the registry must allow it."""
    for name in laws.registry():
        made = options.laws_of([options.LawNames().convert(f"storey 1={name}", None, None)], 2)
        assert made["storey 1"][0].name == name
    with pytest.raises(click.UsageError, match="there is no law 'rubber'"):
        options.LawNames().convert("storey 1=rubber", None, None)
