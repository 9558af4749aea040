"""Proposals for columns: directions, notations, prefixes, shapes; empty ones are so."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import datasets
from pysindy_nrf.cli import run
from pysindy_nrf.records import Table, propose
from pysindy_nrf.records.files import read_table
from pysindy_nrf.records.files.mapping import column_facts

T = np.arange(2000) / 200
NOISE = np.random.default_rng(0).standard_normal((9, 2000))


def proposed(columns, **units):
    """Columns by channel."""
    proposals = propose(Table(Path("x.csv"), "text", columns, units))
    return {proposal.channel: proposal.text for proposal in proposals}


def of_names(names):
    """A time and columns of noise."""
    return {"t": T} | dict(zip(names.split(), NOISE))


NAMES = {
    "x v a f": "x1=x v1=v a1=a F1=f",
    "ddotxg ddotx1 ddotx2": "ag=ddotxg a1=ddotx1 a2=ddotx2",
    "xddot1 x1dot x1": "a1=xddot1 v1=x1dot x1=x1",
    "ug u1 u2": "xg=ug x1=u1 x2=u2",
    "accel_base accel_top": "ag=accel_base a1=accel_top",
    "data.F2 data.x1 data.x2": "F2=data.F2 x1=data.x1 x2=data.x2",
    "Force.F2 Acc.a1 Acc.a2": "F2=Force.F2 a1=Acc.a1 a2=Acc.a2",
    "Temp_1 SampleIndex": "",
}


@pytest.mark.parametrize(("names", "channels"), NAMES.items())
def test_names_of_equations_and_prefixes(names, channels):
    wanted = dict(pair.split("=") for pair in channels.split()) | {"t": "t"}
    assert proposed(of_names(names)) == wanted


def test_units_in_brackets_that_a_reader_leaves_in_the_names():
    columns = of_names("") | {"F1 [kN]": NOISE[0], "Weg 1 (mm)": NOISE[1]}
    assert proposed(columns) == {
        "t": "t",
        "F1": '"F1 [kN]" @ kN',
        "x1": '"Weg 1 (mm)" @ mm',
    }


@pytest.mark.parametrize("unit", ["s", "ms", "us"])
def test_spectra_are_in_hertz_whatever_the_unit_of_the_time(unit):
    time = T * {"s": 1.0, "ms": 1e3, "us": 1e6}[unit]
    motion = np.sin(2 * np.pi * 12.0 * T)
    table = Table(Path("x.csv"), "text", {"t": time, "a1": motion}, {"t": unit})
    _, fact = column_facts(table)
    assert fact.frequency == pytest.approx(12.0, rel=0.02)


def test_columns_over_frequency_are_no_record(tmp_path, capsys):
    """A phase in degrees is no angle of a shaft, and hertz are no seconds."""
    file = tmp_path / "frf.csv"
    lines = [f"{k},{0.1 * k},{-5 * k}" for k in range(1, 60)]
    file.write_text("\n".join(["Frequency (Hz),H1 mag (m/N),H1 phase (deg)", *lines]))
    mapping = tmp_path / "frf.toml"

    assert run(["inspect", str(file), "--write-mapping", str(mapping)]) != 0

    assert "--frf" in capsys.readouterr().err
    assert not mapping.exists()


def test_channels_of_joined_files(tmp_path):
    for name, columns in {"forces": "t F2", "motions": "t a1 a2"}.items():
        time, *channels = columns.split()
        frame = pd.DataFrame({time: T} | dict(zip(channels, NOISE)))
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
    table = read_table([tmp_path / "forces.csv", tmp_path / "motions.csv"])
    channels = {proposal.channel: proposal.text for proposal in propose(table)}
    assert channels == {
        "t": "forces.t",
        "F2": "forces.F2",
        "a1": "motions.a1",
        "a2": "motions.a2",
    }


def test_three_directions_of_one_sensor_are_not_three_floors():
    columns = of_names("Acc_X Acc_Y")
    columns["Acc_X"] = columns["Acc_X"] * 0.1
    columns["Acc_Z"] = np.full(len(T), 9.81)
    assert proposed(columns) == {"t": "t", "a1": "Acc_Y"}


def test_directions_of_several_sensors():
    columns = of_names("L1_X L1_Y L2_X L2_Y")
    channels = proposed(columns, **dict.fromkeys(columns, "g") | {"t": "s"})
    assert channels["a1"][:3] == "L1_"
    assert channels["a2"] == channels["a1"].replace("L1", "L2")


def test_columns_without_names_by_the_shape_of_their_motion():
    """The second derivative of a column is its acceleration."""
    record = datasets.load_demo()
    x, a = record.displacement[:, 0], record.acceleration[:, 0]
    channels = proposed({"c1": record.time, "c2": a, "c3": x, "c4": record.force[:, 1]})
    assert channels == {"t": "c1", "a1": "c2", "x1": "c3"}


def test_axes_of_a_graph_are_no_motion():
    assert proposed({"x": T, "y": NOISE[0]}) == {"t": "x"}


def written(name, columns):
    pd.DataFrame(columns).to_csv(name, index=False)
    return name


@pytest.fixture(autouse=True)
def in_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_an_empty_proposal_is_called_empty(capsys):
    file = written("own.csv", {"p": NOISE[0], "q": NOISE[1]})
    assert run(["inspect", file, "--write-mapping", "own.toml"]) == 0
    text = capsys.readouterr().out
    assert "The proposal is empty" in text
    assert "pysindy-nrf inspect --mapping own.toml" in text
    assert "named or has a unit" not in text


def test_a_force_without_a_motion_is_not_complete(capsys):
    file = written("own.csv", {"t": T, "Load [kN]": NOISE[1]})
    assert run(["inspect", file, "--write-mapping", "own.toml"]) == 0
    assert "the proposal is not complete" in capsys.readouterr().out


def test_every_column_is_listed_with_what_it_looks_like(capsys):
    record = datasets.load_demo()
    x, a = record.displacement[:, 0], record.acceleration[:, 0]
    columns = {"t": record.time, "laser": x, "probe": a, "Temp": 21.0 + 0 * x}
    assert run(["inspect", written("o.csv", columns), "--write-mapping", "o.toml"]) == 0
    text = Path("o.toml").read_text("utf-8")
    assert "looks like the second derivative of laser" in text
    assert "constant, 21" in text
    assert "(not used)" in text


def test_an_element_tested_alone_is_hinted_at(capsys):
    columns = {"Time [s]": T, "Force [kN]": NOISE[0], "Disp [mm]": NOISE[1]}
    assert run(["inspect", written("o.csv", columns), "--write-mapping", "o.toml"]) == 0
    assert "--known-mass 1=0" in capsys.readouterr().out


def test_a_file_without_a_time_asks_for_its_rate(capsys):
    columns = {"Force [kN]": NOISE[0], "Disp [mm]": NOISE[1]}
    assert run(["inspect", written("o.csv", columns), "--write-mapping", "o.toml"]) == 0
    assert "the file has no time" in capsys.readouterr().out
    assert run(["inspect", "--mapping", "o.toml", "--fs", "100"]) == 0
