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
from pysindy_nrf.records import Table, propose
from pysindy_nrf.simulation import add_noise

MASSES = (8.0, 6.0)  # kg
G = 9.80665  # m/s^2
LBF = 4.4482216  # N
INCH = 0.0254  # m
LOWER_STOREY = laws.PowerSeries(1, [30.0, 4e4])
UPPER_STOREY = laws.PowerSeries(1, [20.0, 3e4])


@cache
def shaken(friction=0.0, fs=256.0):
    """A frame of two storeys shaken on its top, with noise.

    Friction (N) is in its upper storey.
    """
    storeys = {1: LOWER_STOREY, 2: UPPER_STOREY}
    if friction:
        storeys[2] = [UPPER_STOREY, laws.CoulombFriction(friction)]
    force = excitation.band_limited_random(
        2, 9.0, fs, excited=2, rms=60.0, band=(1, 40), random_state=0
    )
    exact = simulate(ChainModel(MASSES, storeys), force, 1 / fs)
    return add_noise(exact, 0.002, random_state=1)


def by_name(pattern, matrix):
    """Columns of a matrix, named by a pattern and the number of their floor."""
    return {pattern.format(j): line for j, line in enumerate(matrix.T, start=1)}


def write_csv(name, columns, **options):
    table = pd.DataFrame(columns)
    table.to_csv(name, index=False, **{"float_format": "%.9g"} | options)
    return name


def german():
    """Semicolons, decimal commas, units in brackets; friction in the upper storey."""
    test = shaken(12.0)
    columns = {
        "Zeit [s]": test.time,
        "Kraft Erreger 2.OG [kN]": test.force[:, 1] / 1e3,
        "Temperatur [°C]": np.full(test.n_samples, 21.0),
    }
    columns |= by_name("Beschl. {}.OG [g]", test.acceleration / G)
    columns |= by_name("Weg {} [mm]", 1e3 * test.displacement)
    return write_csv("messung.csv", columns, sep=";", decimal=",")


def american():
    """Time in ms, pounds and inches."""
    test = shaken()
    columns = {
        "Scan #": np.arange(test.n_samples),
        "Time (ms)": 1e3 * test.time,
        "Shaker top (lbf)": test.force[:, 1] / LBF,
    }
    columns |= by_name("ACC-L{} Y (g)", test.acceleration / G)
    columns |= by_name("LVDT {} (in)", test.displacement / INCH)
    return write_csv("test 7.csv", columns)


def suffixes():
    """Units as suffixes."""
    test = shaken()
    columns = {"time_ms": 1e3 * test.time, "force_2_kN": test.force[:, 1] / 1e3}
    columns |= by_name("acc_{}_g", test.acceleration / G)
    columns |= by_name("disp_{}_mm", 1e3 * test.displacement)
    return write_csv("logger.txt", columns, sep="\t")


def excel():
    """A sheet with a title, names and a row of units; friction in the upper storey."""
    openpyxl = pytest.importorskip("openpyxl")
    test = shaken(12.0)
    names = "Temps,Effort 2,Accélération 1,Accélération 2,Déplacement 1,Déplacement 2"
    rows = np.column_stack(
        [test.time, test.force[:, 1], test.acceleration, 1e3 * test.displacement]
    )
    book = openpyxl.Workbook()
    book.active.append(["Test of 12 May"])
    book.active.append(names.split(","))
    book.active.append("s N m/s² m/s² mm mm".split())
    for row in rows.tolist():
        book.active.append(row)
    book.save("essai.xlsx")
    return "essai.xlsx"


def tdms():
    """LabVIEW: units and the sampling rate as properties, no time."""
    nptdms = pytest.importorskip("nptdms")
    test = shaken()
    columns = {"Hammer 2": test.force[:, 1]}
    columns |= by_name("Acc {}", test.acceleration / G)
    columns |= by_name("Laser {}", 1e3 * test.displacement)
    unit_of = {"Hammer": "N", "Acc": "g", "Laser": "mm"}
    channels = []
    for name, line in columns.items():
        unit = unit_of[name.split()[0]]
        properties = {"unit_string": unit, "wf_increment": test.dt}
        channels.append(nptdms.ChannelObject("DAQ", name, line, properties))
    with nptdms.TdmsWriter("daq.tdms") as file:
        file.write_segment(channels)
    return "daq.tdms"


def matlab():
    """MATLAB v7.3: matrices, one column a floor."""
    h5py = pytest.importorskip("h5py")
    test = shaken()
    path = Path("data.mat")
    with h5py.File(path, "w", userblock_size=512) as file:
        # MATLAB writes columns first
        file["t"] = test.time[None]
        file["force_2"] = test.force[None, :, 1]
        file["acc"] = test.acceleration.T
        file["disp"] = test.displacement.T
    head = b"MATLAB 7.3 MAT-file".ljust(512)
    path.write_bytes(head + path.read_bytes()[512:])
    return "data.mat"


def french():
    """Units as French laboratories write them, with points; decimal commas."""
    test = shaken()
    columns = {"Temps (s)": test.time, "Effort 2 (daN)": test.force[:, 1] / 10}
    columns |= by_name("Accélération {} (m.s-2)", test.acceleration)
    columns |= by_name("Déplacement {} (mm.)", 1e3 * test.displacement)
    return write_csv("essai 3.csv", columns, sep=";", decimal=",")


def labview():
    """A LabVIEW measurement: tabs, units and steps in a header, no time."""
    test = shaken()
    names = ["Hammer 2", "Acc 1", "Acc 2", "Laser 1", "Laser 2"]
    units = ["N", "g", "g", "mm", "mm"]
    lines = [test.force[:, 1], *(test.acceleration.T / G), *(1e3 * test.displacement.T)]
    n = len(names)
    head = ["LabVIEW Measurement", "Separator\tTab", "Decimal_Separator\t."]
    head += ["X_Columns\tNo", "***End_of_Header***", "", f"Channels\t{n}"]
    for key, cells in {
        "Y_Unit_Label": units,
        "X0": ["0.0"] * n,
        "Delta_X": [repr(test.dt)] * n,
    }.items():
        head.append("\t".join([key, *cells]))
    head += ["***End_of_Header***", "\t".join(["X_Value", *names, "Comment"])]
    rows = ["\t".join(["", *(f"{y:.9g}" for y in row)]) for row in zip(*lines)]
    Path("daq_1.lvm").write_text("\n".join([*head, *rows]) + "\n")
    return "daq_1.lvm"


def measuring_program():
    """MATLAB structures with an axis, values, a unit and a name for each signal."""
    io = pytest.importorskip("scipy.io")
    test = shaken()

    def signal(name, line, unit):
        axis = {"start_value": 0.0, "increment": test.dt}
        values = {"values": line[:, None], "quantity": {"label": unit}}
        return {
            "x_values": axis,
            "y_values": values,
            "function_record": {"name": name},
        }

    signals = {"Signal_0": signal("Force top:2", test.force[:, 1], "N")}
    for j, line in enumerate(test.acceleration.T, 1):
        signals[f"Signal_{j}"] = signal(f"Acc:{j}", line / G, "g")
    io.savemat("lab.mat", signals)
    return "lab.mat"


def structure():
    """A MATLAB structure whose fields are channels, with fs beside them."""
    io = pytest.importorskip("scipy.io")
    test = shaken()
    fields = {"fs": test.fs, "F2": test.force[:, 1]}
    fields |= by_name("xddot{}", test.acceleration)
    fields |= by_name("x{}", test.displacement)
    io.savemat("run7.mat", {"data": fields})
    return "run7.mat"


def three_rows():
    """A sheet with points, quantities and units, a stale range and a blank tail."""
    openpyxl = pytest.importorskip("openpyxl")
    test = shaken()
    book = openpyxl.Workbook()
    book.active.append(["Point", "F:2", "ACC:1", "ACC:2"])
    book.active.append(["Quantity", "Force", "Acceleration", "Acceleration"])
    book.active.append(["s", "kN", "g", "g"])
    force = test.force[:, 1:] / 1e3
    for row in np.column_stack([test.time, force, test.acceleration / G]).tolist():
        book.active.append(row)
    for _ in range(20):
        book.active.append([None, None, None, " "])
    book.save("points.xlsx")
    return "points.xlsx"


def attributes():
    """HDF5 with units as attributes and one rate for the file."""
    h5py = pytest.importorskip("h5py")
    test = shaken()
    columns = {"force_2": (test.force[:, 1] / 1e3, "kN")}
    for j, line in enumerate(test.acceleration.T, 1):
        columns[f"accelerometer_{j}"] = (line / G, "g")
    for j, line in enumerate(test.displacement.T, 1):
        columns[f"laser_{j}"] = (1e3 * line, "mm")
    with h5py.File("scan.h5", "w") as file:
        file.attrs["sampling_rate"] = test.fs
        for name, (line, unit) in columns.items():
            file[name] = line
            file[name].attrs["units"] = unit
    return "scan.h5"


def directions():
    """Each sensor has three directions; the chain moves along Y."""
    test = shaken()
    noise = np.random.default_rng(0).standard_normal((3, test.n_samples))
    columns = {"time_s": test.time, "Force_2 [N]": test.force[:, 1]}
    for j, line in enumerate(test.acceleration.T, 1):
        columns[f"IMU{j}_X [m/s²]"] = 0.02 * noise[j]
        columns[f"IMU{j}_Y [m/s²]"] = line
        columns[f"IMU{j}_Z [m/s²]"] = 9.81 + 0.02 * noise[0]
    return write_csv("imu.csv", columns)


def compressed():
    """A compressed text with times of day."""
    test = shaken()
    start = np.datetime64("2024-05-01T10:00:00", "ns")
    stamps = start + (1e9 * test.time).round().astype("m8[ns]")
    columns = {"timestamp": stamps, "shaker_top [lbf]": test.force[:, 1] / LBF}
    columns |= by_name("acc_{}_g", test.acceleration / G)
    return write_csv("station.csv.gz", columns, compression="gzip")


def spanish_on_another_floor():
    """The force stands in the channel list of the wrong floor."""
    test = shaken()
    columns = {"Tiempo [s]": test.time, "Fuerza 1 [N]": test.force[:, 1]}
    columns |= by_name("Aceleración {} [m/s^2]", test.acceleration)
    columns |= by_name("Desplazamiento {} [mm]", 1e3 * test.displacement)
    return write_csv("ensayo.csv", columns)


def japanese_upside_down():
    """One accelerometer hangs upside down."""
    test = shaken()
    columns = {"時刻 [s]": test.time, "加振力 2 [N]": test.force[:, 1]}
    columns |= by_name("加速度 {} [m/s^2]", test.acceleration * [-1.0, 1.0])
    return write_csv("shiken.csv", columns)


@pytest.fixture
def in_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def verdict_by_proposed_mapping(file, capsys):
    """Exit code and report of the two commands that a newcomer types."""
    assert run(["inspect", file, "--write-mapping", "mine.toml"]) == 0
    advice = r"then: pysindy-nrf (run --mapping mine.toml)"
    command = re.search(advice, capsys.readouterr().out)[1].split()
    code = run([*command, "--json", "--steps", "1", "--no-figures"])
    (folder,) = Path("nrf_runs").iterdir()
    assert folder.name == Path(file).stem
    assert (folder / "manifest.json").exists()
    return code, json.loads(capsys.readouterr().out)


RIGHT = [german, american, suffixes, tdms, matlab, french, labview]
RIGHT += [three_rows, attributes, directions, compressed]
for vendor in (excel, measuring_program, structure):
    RIGHT.append(pytest.param(vendor, marks=pytest.mark.slow))


@pytest.mark.usefixtures("in_folder")
@pytest.mark.parametrize("vendor", RIGHT)
def test_the_proposed_mapping_leads_to_the_right_model(vendor, capsys):
    pytest.importorskip("pint")
    code, report = verdict_by_proposed_mapping(vendor(), capsys)
    assert code == 0
    assert report["verdict"]["state"] in ("green", "amber")
    np.testing.assert_allclose(report["model"]["masses"], MASSES, rtol=0.03)
    sentence = report["verdict"]["sentence"].lower()
    has_friction = vendor in (german, excel)
    assert ("friction" in sentence) == has_friction
    assert ("storey 2" in sentence) == has_friction


WRONG = [
    (spanish_on_another_floor, "F1 acting on floor 2"),
    (japanese_upside_down, "a1 reversed"),
]


@pytest.mark.usefixtures("in_folder")
@pytest.mark.parametrize(("vendor", "fault"), WRONG)
def test_a_wrong_channel_list_gives_a_red_verdict_that_names_it(vendor, fault, capsys):
    code, report = verdict_by_proposed_mapping(vendor(), capsys)
    assert code == 4
    assert report["verdict"]["state"] == "red"
    assert fault in report["verdict"]["sentence"]


@pytest.mark.usefixtures("in_folder")
def test_a_time_that_must_be_in_ms_is_refused_with_the_cure(capsys):
    test = shaken()
    columns = {"t": 1e3 * test.time, "F2": test.force[:, 1]}
    write_csv("ms.csv", columns | by_name("a{}", test.acceleration))
    assert run(["run", "ms.csv"]) == 3
    message = capsys.readouterr().err
    assert "the time is in ms" in message
    assert "--unit t=ms" in message
    assert run(["run", "ms.csv", "--map", "a2=A2"]) == 3
    assert "did you mean 'a2'?" in capsys.readouterr().err


def proposed_mapping(file, capsys):
    """The doubts that `inspect` lists, and the mapping file that it writes."""
    assert run(["inspect", file, "--write-mapping", "own.toml", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)["records"][0]
    return record["doubts"], Path("own.toml").read_text("utf-8")


@pytest.mark.usefixtures("in_folder")
def test_units_behind_a_slash_and_a_clock_without_a_name_are_seen(capsys):
    test = shaken()
    columns = {"X_Value": test.time, "Kraft 2/kN": test.force[:, 1] / 1e3}
    columns |= by_name("B{} Beschl./(m/s^2)", test.acceleration)
    columns |= by_name("Weg {}/mm", 1e3 * test.displacement)
    doubts, mapping = proposed_mapping(write_csv("din.csv", columns), capsys)
    assert doubts == []
    assert '"X_Value"   # ? no unit' in mapping


NAMES_BY_ENCODING = {
    "cp932": ("時間(ms),加振力 2(N),加速度1F(gal),加速度2F(gal),変位1F(mm),変位2F(mm)"),
    "gb18030": (
        "时间（ms）,激振力2（N）,加速度1（gal）,加速度2（gal）,位移1（mm）,位移2（mm）"
    ),
    "cp1252": (
        "Zeit [ms],Kraft 2 [N],Beschl. 1 [gal],Beschl. 2 [gal],"
        "Weg Stütze 1 [mm],Weg Stütze 2 [mm]"
    ),
}


@pytest.mark.usefixtures("in_folder")
@pytest.mark.parametrize(("encoding", "names"), NAMES_BY_ENCODING.items())
def test_names_are_read_in_the_encoding_of_the_country(encoding, names, capsys):
    test = shaken()
    acceleration, displacement = 100 * test.acceleration, 1e3 * test.displacement
    lines = [1e3 * test.time, test.force[:, 1], acceleration, displacement]
    columns = dict(zip(names.split(","), np.column_stack(lines).T))
    file = write_csv("own.csv", columns, encoding=encoding)
    doubts, mapping = proposed_mapping(file, capsys)
    assert doubts == []
    assert "?" not in mapping
    force = names.split(",")[1]
    assert re.split(r"[（(\[]", force)[0].strip() in mapping


COLUMNS = {
    "Tempo,Forza 3,Accelerazione P1,Accelerazione P2,Accelerazione P3,"
    "Spostamento tavola": "t a1 a2 a3 xg F3",
    "时间,激振力,加速度1,加速度2,位移1,位移2,温度": "t a1 a2 x1 x2 F2",
    # the numbers count the inputs of a logger
    "Ch1 Zeit,Ch2 Kraft,Ch3 Beschl,Ch4 Beschl,Ch5 Weg,Ch6 Weg": "t a1 a2 x1 x2 F2",
    "Time,AI 1/Shaker top,AI 2/Acc floor 1,AI 3/Acc floor 2,AI 4/String pot 2": (
        "t a1 a2 x2 F2"
    ),
    "Time,Hammer,Acc base,Acc 1,Acc roof,Trigger": "t ag a1 a2 F2",
}


@pytest.mark.parametrize(("names", "channels"), COLUMNS.items())
def test_words_of_the_trade_are_understood_and_doubts_are_listed(names, channels):
    columns = {name: np.zeros(9) for name in names.split(",")}
    proposals = propose(Table(Path("x.csv"), "text", columns))
    assert [proposal.channel for proposal in proposals] == channels.split()
    # no unit was written
    assert all(proposal.doubts for proposal in proposals if proposal.channel != "t")
