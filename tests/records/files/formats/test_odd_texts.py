"""Texts as loggers and people write them, other than the readers' own tests: each opens
by its proposal, or says honestly what it lacks.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf.cli import run

pytest.importorskip("pint")
FS = 200.0
T = np.arange(600) / FS
W = np.random.default_rng(0).standard_normal((3, 600))
FORCE = 60 * W[0]  # N
LOWER, UPPER = 9.8 * W[1], 9.8 * W[2]  # m/s^2
G = 9.80665
KYRILLIC = "Время, с;Сила 2, кН;Ускорение 1, м/с²;Ускорение 2, м/с²"


def rows(columns, separator, form="%.9g", decimal="."):
    lines = []
    for row in np.column_stack(columns):
        cells = [(form % value).replace(".", decimal) for value in row]
        lines.append(separator.join(cells))
    return "\n".join(lines) + "\n"


def catman():
    head = "catman AP\nKanäle: 4\n\nZeit\tKraft 2\tBeschl 1\tBeschl 2\ns\tkN\tg\tg\n"
    lines = [T, FORCE / 1e3, LOWER / G, UPPER / G]
    return (head + rows(lines, "\t", decimal=",")).encode("cp1252")


def kyrillic(encoding):
    lines = [T, FORCE / 1e3, LOWER, UPPER]
    text = KYRILLIC.replace("²", "2") + "\n" + rows(lines, ";", decimal=",")
    return text.encode(encoding)


def units_in_a_comment():
    head = "# frame\n# time force2 acc1 acc2\n# ms kN g g\n"
    lines = [1e3 * T, FORCE / 1e3, LOWER / G, UPPER / G]
    return (head + rows(lines, " ")).encode()


def date_and_time_of_day():
    stamps = pd.Timestamp("2024-05-01 10:00") + pd.to_timedelta(T, unit="s")
    head = "Datum;Uhrzeit;Kraft 2 [N];Beschl 1 [g];Beschl 2 [g]\n"
    cells = np.column_stack([FORCE, LOWER / G, UPPER / G])
    lines = [
        f"{stamp:%d.%m.%Y};{stamp:%H:%M:%S.%f};" + ";".join(f"{v:.9f}" for v in row)
        for stamp, row in zip(stamps, cells)
    ]
    return (head + "\n".join(lines) + "\n").encode()


def rate_above():
    head = "Operator: X\nSampling rate: 200 Hz\n\nForce 2 [N]\tAcc 1 [g]\tAcc 2 [g]\n"
    return (head + rows([FORCE, LOWER / G, UPPER / G], "\t")).encode()


def table(names, lines, separator=","):
    return (names + "\n" + rows(lines, separator)).encode()


IN_G = [T, FORCE, LOWER / G, UPPER / G]
TEXTS = {
    "catman.asc": catman(),
    "utf8.csv": kyrillic("utf-8"),
    "cp1251.csv": kyrillic("cp1251"),
    "comments.dat": units_in_a_comment(),
    "datum.csv": date_and_time_of_day(),
    "rate.txt": rate_above(),
    "blank.csv": table("Time s,Force_2 N,Acc_1 g,Acc_2 g", IN_G),
    "comma.csv": table("Time, s;Force 2, N;Acc 1, g;Acc 2, g", IN_G, ";"),
    "suffix.prn": table("t_s,F_roof_N,A_F1_X_g,A_F2_X_g", IN_G),
    "dewesoft.txt": table(
        "Time (s);AI 1/Force top (N);AI 2/Acc floor 1 (g);AI 3/Acc floor 2 (g)",
        IN_G,
        ";",
    ),
    "mg.csv": table(
        "time [ms],force2 [lbf],acc1 [mg],acc2 [mg]",
        [1e3 * T, FORCE / 4.4482216152605, 1e3 * LOWER / G, 1e3 * UPPER / G],
    ),
    "roof.csv": table("t,F2,ACC_ROOF [g],ACC_1ST [g]", [*IN_G[:2], *IN_G[:1:-1]]),
    "dashes.csv": table("t,F2,a1_g,a2_g\n-0.005,-,-,-", IN_G),
}


@pytest.fixture(autouse=True)
def in_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def proposed(capsys, name, content):
    Path(name).write_bytes(content)
    assert run(["inspect", name, "--write-mapping", "own.toml", "--json"]) == 0
    return json.loads(capsys.readouterr().out)["records"]


@pytest.mark.parametrize(("name", "content"), TEXTS.items(), ids=TEXTS)
def test_the_proposal_reads_every_channel_in_its_unit(capsys, name, content):
    (record,) = proposed(capsys, name, content)
    assert record["fs"] == pytest.approx(FS, rel=1e-6)
    for channel, line in {"F2": FORCE, "a1": LOWER, "a2": UPPER}.items():
        rms = np.sqrt(np.mean(line**2))
        assert record["channels"][channel]["rms"] == pytest.approx(rms, rel=1e-3)


HONEST = {
    "volts.csv": table("Time,Ch1,Ch2,Ch3\n(s),(V),(V),(V)", IN_G),
    "opensees.out": rows([T, LOWER, UPPER], " ").encode(),
    "unnamed.txt": rows([LOWER, UPPER], "\t").encode(),
}


@pytest.mark.parametrize(("name", "content"), HONEST.items(), ids=HONEST)
def test_what_nothing_says_is_not_guessed(capsys, name, content):
    assert proposed(capsys, name, content) == []
    text = Path("own.toml").read_text("utf-8")
    assert not any(f"\n{channel} =" in text for channel in ("a1", "x1", "F1", "F2"))


def test_rows_of_a_matrix_that_lies_on_its_side(capsys):
    np.savez("side.npz", time=T, acc=np.vstack([LOWER, UPPER]), F2=FORCE)
    assert run(["inspect", "side.npz", "--write-mapping", "own.toml", "--json"]) == 0
    (record,) = json.loads(capsys.readouterr().out)["records"]
    assert record["sources"]["a2"]["from"] == "acc[1, :]"


def test_one_row_of_numbers_is_called_transposed(capsys):
    Path("row.txt").write_text(" ".join(f"{x:.7e}" for x in np.arange(9000)) + "\n")
    assert run(["inspect", "row.txt"]) == 3
    message = capsys.readouterr().err
    assert "transposed" in message
    assert "damaged" not in message
