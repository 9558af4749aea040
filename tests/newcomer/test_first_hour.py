"""A newcomer's first hour: files as vendors write them, the mapping that is proposed,
`run`, and the right verdict.
"""

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, excitation, laws, simulate
from pysindy_nrf.cli import run
from pysindy_nrf.records.files.mapping import propose
from pysindy_nrf.records.files.table import Table
from pysindy_nrf.simulation import add_noise

MASSES, G, LBF, INCH = (8.0, 6.0), 9.80665, 4.4482216, 0.0254
FRAME = {1: laws.PowerSeries(1, [30.0, 4e4]), 2: laws.PowerSeries(1, [20.0, 3e4])}


@cache
def shaken(friction=0.0, fs=256.0):
    """A frame of two storeys shaken on its top; time, force on floor 2, accelerations,
    displacements, with noise.
    """
    held = FRAME | ({2: [FRAME[2], laws.CoulombFriction(friction)]} if friction else {})
    force = excitation.band_limited_random(
        2, 9.0, fs, excited=2, rms=60.0, band=(1, 40), random_state=0
    )
    rec = add_noise(
        simulate(ChainModel(MASSES, held), force, 1 / fs), 0.002, random_state=1
    )
    return rec.time, rec.force[:, 1], rec.acceleration, rec.displacement


def german():
    """Semicolons, decimal commas, units in brackets; friction in the upper storey."""
    t, F, a, x = shaken(12.0)
    columns = {
        "Zeit [s]": t,
        "Kraft Erreger 2.OG [kN]": F / 1e3,
        "Temperatur [°C]": 21.0 + 0 * t,
    }
    columns |= {f"Beschl. {j}.OG [g]": a[:, j - 1] / G for j in (1, 2)} | {
        f"Weg {j} [mm]": 1e3 * x[:, j - 1] for j in (1, 2)
    }
    pd.DataFrame(columns).to_csv(
        "messung.csv", sep=";", decimal=",", index=False, float_format="%.8g"
    )
    return "messung.csv"


def american():
    """Time in ms, pounds and inches."""
    t, F, a, x = shaken()
    columns = {
        "Scan #": np.arange(len(t)),
        "Time (ms)": 1e3 * t,
        "Shaker top (lbf)": F / LBF,
    }
    columns |= {f"ACC-L{j} Y (g)": a[:, j - 1] / G for j in (1, 2)}
    columns |= {f"LVDT {j} (in)": x[:, j - 1] / INCH for j in (1, 2)}
    pd.DataFrame(columns).to_csv("test 7.csv", index=False, float_format="%.9g")
    return "test 7.csv"


def suffixes():
    """Units as suffixes."""
    t, F, a, x = shaken()
    columns = {"time_ms": 1e3 * t, "force_2_kN": F / 1e3} | {
        f"acc_{j}_g": a[:, j - 1] / G for j in (1, 2)
    }
    columns |= {f"disp_{j}_mm": 1e3 * x[:, j - 1] for j in (1, 2)}
    pd.DataFrame(columns).to_csv(
        "logger.txt", sep="\t", index=False, float_format="%.9g"
    )
    return "logger.txt"


def excel():
    """A sheet with a title, names and a row of units; friction in the upper storey."""
    openpyxl = pytest.importorskip("openpyxl")
    t, F, a, x = shaken(12.0)
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Test of 12 May"])
    sheet.append(
        [
            "Temps",
            "Effort 2",
            "Accélération 1",
            "Accélération 2",
            "Déplacement 1",
            "Déplacement 2",
        ]
    )
    sheet.append(["s", "N", "m/s²", "m/s²", "mm", "mm"])
    for row in np.column_stack([t, F, a, 1e3 * x]).tolist():
        sheet.append(row)
    book.save("essai.xlsx")
    return "essai.xlsx"


def tdms():
    """LabVIEW: units and the sampling rate as properties, no time."""
    nptdms = pytest.importorskip("nptdms")
    t, F, a, x = shaken()
    lines = {"Hammer 2": (F, "N")} | {
        f"Acc {j}": (a[:, j - 1] / G, "g") for j in (1, 2)
    }
    lines |= {f"Laser {j}": (1e3 * x[:, j - 1], "mm") for j in (1, 2)}
    step = {"wf_increment": t[1] - t[0]}
    channels = [
        nptdms.ChannelObject("DAQ", k, y, properties={"unit_string": u} | step)
        for k, (y, u) in lines.items()
    ]
    with nptdms.TdmsWriter("daq.tdms") as file:
        file.write_segment(channels)
    return "daq.tdms"


def matlab():
    """MATLAB v7.3: matrices, one column a floor."""
    h5py = pytest.importorskip("h5py")
    t, F, a, x = shaken()
    with h5py.File("data.mat", "w", userblock_size=512) as file:
        for name, y in {
            "t": t[:, None],
            "acc": a,
            "disp": x,
            "force_2": F[:, None],
        }.items():
            file[name] = y.T
    Path("data.mat").write_bytes(
        b"MATLAB 7.3 MAT-file".ljust(512) + Path("data.mat").read_bytes()[512:]
    )
    return "data.mat"


def spanish_on_another_floor():
    """The force stands in the channel list of the wrong floor."""
    t, F, a, x = shaken()
    columns = {"Tiempo [s]": t, "Fuerza 1 [N]": F} | {
        f"Aceleración {j} [m/s^2]": a[:, j - 1] for j in (1, 2)
    }
    columns |= {f"Desplazamiento {j} [mm]": 1e3 * x[:, j - 1] for j in (1, 2)}
    pd.DataFrame(columns).to_csv("ensayo.csv", index=False, float_format="%.9g")
    return "ensayo.csv"


def japanese_upside_down():
    """One accelerometer hangs upside down."""
    t, F, a, x = shaken()
    columns = {
        "時刻 [s]": t,
        "加振力 2 [N]": F,
        "加速度 1 [m/s^2]": -a[:, 0],
        "加速度 2 [m/s^2]": a[:, 1],
    }
    pd.DataFrame(columns).to_csv("shiken.csv", index=False, float_format="%.9g")
    return "shiken.csv"


RIGHT = [
    (german, "friction"),
    (american, ""),
    (suffixes, ""),
    (excel, "friction"),
    (tdms, ""),
    (matlab, ""),
]
WRONG = [
    (spanish_on_another_floor, "F1 acting on floor 2"),
    (japanese_upside_down, "a1 reversed"),
]


@pytest.mark.parametrize(
    ("vendor", "words"), RIGHT + WRONG, ids=lambda x: getattr(x, "__name__", "")
)
def test_the_proposed_mapping_leads_to_the_right_verdict(
    vendor, words, tmp_path, monkeypatch, capsys
):
    pytest.importorskip("pint")
    monkeypatch.chdir(tmp_path)
    file = vendor()
    assert run(["inspect", file, "--write-mapping", "mine.toml"]) == 0
    following = re.search(
        r"then: pysindy-nrf (run --mapping mine.toml)", capsys.readouterr().out
    )[1]
    code = run([*following.split(), "--json", "--steps", "1", "--no-figures"])
    data = json.loads(capsys.readouterr().out)
    verdict = data["verdict"]
    if (vendor, words) in WRONG:
        assert code == 4 and verdict["state"] == "red" and words in verdict["sentence"]
    else:
        assert code == 0 and verdict["state"] in ("green", "amber")
        assert words in verdict["sentence"].lower() and (
            "storey 2" in verdict["sentence"]
        ) == bool(words)
        np.testing.assert_allclose(data["model"]["masses"], MASSES, rtol=0.03)
    (folder,) = Path("nrf_runs").iterdir()
    assert folder.name == Path(file).stem and (folder / "manifest.json").exists()


def test_a_time_that_must_be_in_ms_is_refused_with_the_cure(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    t, F, a, _ = shaken()
    pd.DataFrame({"t": 1e3 * t, "F2": F, "a1": a[:, 0], "a2": a[:, 1]}).to_csv(
        "ms.csv", index=False
    )
    assert run(["run", "ms.csv"]) == 3
    said = capsys.readouterr().err
    assert "the time is in ms" in said and "--unit t=ms" in said
    assert run(["run", "ms.csv", "--map", "a2=A2"]) == 3
    assert "did you mean 'a2'?" in capsys.readouterr().err


def test_units_behind_a_slash_and_a_clock_without_a_name_are_seen(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    t, F, a, x = shaken()
    columns = {"X_Value": t, "Kraft 2/kN": F / 1e3} | {
        f"B{j} Beschl./(m/s^2)": a[:, j - 1] for j in (1, 2)
    }
    columns |= {f"Weg {j}/mm": 1e3 * x[:, j - 1] for j in (1, 2)}
    pd.DataFrame(columns).to_csv("din.csv", index=False)
    assert run(["inspect", "din.csv", "--write-mapping", "din.toml", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)["records"][0]
    assert (
        record["doubts"] == []
        and '"X_Value"   # ? no unit' in Path("din.toml").read_text()
    )


@pytest.mark.parametrize(
    ("names", "encoding"),
    [
        (
            [
                "時間(ms)",
                "加振力 2(N)",
                "加速度1F(gal)",
                "加速度2F(gal)",
                "変位1F(mm)",
                "変位2F(mm)",
            ],
            "cp932",
        ),
        (
            [
                "时间（ms）",
                "激振力2（N）",
                "加速度1（gal）",
                "加速度2（gal）",
                "位移1（mm）",
                "位移2（mm）",
            ],
            "gb18030",
        ),
        (
            [
                "Zeit [ms]",
                "Kraft 2 [N]",
                "Beschl. 1 [gal]",
                "Beschl. 2 [gal]",
                "Weg Stütze 1 [mm]",
                "Weg Stütze 2 [mm]",
            ],
            "cp1252",
        ),
    ],
)
def test_names_are_read_in_the_encoding_of_the_country(
    names, encoding, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    t, F, a, x = shaken()
    lines = np.column_stack([1e3 * t, F, 100 * a, 1e3 * x])
    pd.DataFrame(lines, columns=names).to_csv("own.csv", index=False, encoding=encoding)
    assert run(["inspect", "own.csv", "--write-mapping", "own.toml", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)["records"][0]
    assert record["doubts"] == [] and re.split(r"[（(\[]", names[1])[0].strip() in Path(
        "own.toml"
    ).read_text("utf-8")
    assert "?" not in Path("own.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("names", "channels"),
    [
        (
            [
                "Tempo",
                "Forza 3",
                "Accelerazione P1",
                "Accelerazione P2",
                "Accelerazione P3",
                "Spostamento tavola",
            ],
            "t a1 a2 a3 xg F3",
        ),
        (
            ["时间", "激振力", "加速度1", "加速度2", "位移1", "位移2", "温度"],
            "t a1 a2 x1 x2 F2",
        ),
        (
            ["Ch1 Zeit", "Ch2 Kraft", "Ch3 Beschl", "Ch4 Beschl", "Ch5 Weg", "Ch6 Weg"],
            "t a1 a2 x1 x2 F2",
        ),  # inputs count
        (
            [
                "Time",
                "AI 1/Shaker top",
                "AI 2/Acc floor 1",
                "AI 3/Acc floor 2",
                "AI 4/String pot 2",
            ],
            "t a1 a2 x2 F2",
        ),
        (
            ["Time", "Hammer", "Acc base", "Acc 1", "Acc roof", "Trigger"],
            "t ag a1 a2 F2",
        ),
    ],
)
def test_words_of_the_trade_are_understood_and_doubts_are_said(names, channels):
    found = propose(Table(Path("x.csv"), "text", {name: np.zeros(9) for name in names}))
    assert [one.channel for one in found] == channels.split()
    assert all(one.doubts for one in found if one.channel != "t")  # no unit was written
