"""Files of archives and loggers, written here from their published layouts."""

import gzip

import numpy as np
import pytest

from pysindy_nrf.exceptions import FileFormatError
from pysindy_nrf.records.files import inspect_record, read_record, read_table

N = 403
MOTION = 20 * np.sin(np.arange(N) / 7) * np.exp(-np.arange(N) / 100)


def rows(values, form, per_line):
    cells = [format(value, form) for value in values]
    return ["".join(cells[i : i + per_line]) for i in range(0, N, per_line)]


def lines(*parts):
    flat = [
        line
        for element in parts
        for line in ([element] if element is str(element) else element)
    ]
    return "\n".join(flat) + "\n"


PEER_TITLES = ["PEER NGA STRONG MOTION DATABASE RECORD", "Imperial Valley-06, Array 6"]


@pytest.mark.parametrize(
    ("kind", "unit", "suffix"),
    [("ACCELERATION", "G", "AT2"), ("VELOCITY", "CM/S", "VT2")],
)
@pytest.mark.parametrize(
    "clock", ["NPTS=    403, DT=   .0050 SEC,", "  403    0.0050    NPTS, DT"]
)
def test_peer(written, kind, unit, suffix, clock):
    title = f"{kind} TIME SERIES IN UNITS OF {unit}"
    text = lines(PEER_TITLES, title, clock, rows(MOTION, "15.7E", 5))
    table = read_table(written(text, f"RSN1.{suffix}"))
    assert table.fs == 200
    assert table.units == {kind.lower(): unit.lower()}
    np.testing.assert_allclose(table.variables[kind.lower()], MOTION, rtol=1e-6)


def test_a_peer_record_with_points_missing(written):
    title = "ACCELERATION TIME SERIES IN UNITS OF G"
    body = rows(MOTION, "15.7E", 5)[:-3]
    with pytest.raises(FileFormatError, match="announces 403 points"):
        read_table(
            written(lines(PEER_TITLES, title, "NPTS= 403, DT= .005", body), "a.at2")
        )


def knet(direction, counts, started="2011/03/11 14:46:21"):
    gal = counts * 3920 / 6182761
    peak = np.abs(gal - gal.mean()).max()
    head = {
        "Origin Time": "2011/03/11 14:46:00",
        "Lat.": "38.103",
        "Station Code": "AKT001",
        "Record Time": started,
        "Sampling Freq(Hz)": "100Hz",
        "Duration Time(s)": "4",
        "Dir.": direction,
        "Scale Factor": "3920(gal)/6182761",
        "Max. Acc. (gal)": f"{peak:.3f}",
        "Last Correction": "2011/03/11 14:46:06",
        "Memo.": "",
    }
    return lines(
        [f"{key:18s}{text}" for key, text in head.items()], rows(counts, "9d", 8)
    )


def test_knet_and_its_offset(written):
    counts = np.round(1e4 * MOTION).astype(int) + 5000
    table = read_table(written(knet("E-W", counts), "AKT0011103111446.EW"))
    assert table.fs == 100
    assert not any("take care" in note for note in table.notes)
    (line,) = table.variables.values()
    np.testing.assert_allclose(line, (counts - counts.mean()) * 3920 / 6182761)


def test_two_directions_of_a_station_are_joined(written):
    """They are called alike but for the end of their names."""
    pytest.importorskip("pint")
    counts = np.round(1e4 * MOTION).astype(int)
    later = "2011/03/11 14:46:22"
    paths = [
        written(knet("N-S", counts), "AKT001.NS"),
        written(knet("E-W", counts, later), "AKT001.EW"),
    ]
    mapping = {"a1": "AKT001_NS.acceleration NS", "a2": "AKT001_EW.acceleration EW"}
    record = read_record(paths, mapping=mapping)
    assert record.n_samples == N - 100
    assert record.quality[0].size == pytest.approx(1.0)


def smc(kind="2 CORRECTED ACCELEROGRAM", comments=2):
    texts = [kind, *["text"] * 10]
    integers = np.full(48, -32768)
    integers[15:17] = comments, N
    reals = np.full(50, 1.7e38)
    reals[1] = 200.0
    return lines(
        texts,
        ["".join(f"{i:10d}" for i in integers[k : k + 8]) for k in range(0, 48, 8)],
        ["".join(f"{r:15.7E}" for r in reals[k : k + 5]) for k in range(0, 50, 5)],
        ["| a remark"] * comments,
        rows(MOTION, "10.4f", 8),
    )


@pytest.mark.parametrize("name", ["a.smc", "a.txt"])
def test_smc(written, name):
    table = read_table(written(smc(), name))
    assert table.fs == 200
    assert table.units == {"acceleration": "cm/s^2"}
    np.testing.assert_allclose(table.variables["acceleration"], MOTION, atol=5e-5)


def test_spectra_of_smc_are_named(written):
    with pytest.raises(FileFormatError, match="RESPONSE SPECTRA"):
        read_table(written(smc("5 RESPONSE SPECTRA"), "a.smc"))


def lvm(x_columns, decimal=".", late=0.0):
    def number(value):
        return format(value, ".6f").replace(".", decimal)

    head = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        f"Decimal_Separator\t{decimal}",
        f"X_Columns\t{x_columns}",
        "***End_of_Header***\t",
        "\t",
        "Channels\t2\t",
        f"Samples\t{N}\t{N}\t",
        "Y_Unit_Label\tkN\tmm\t",
        "X_Dimension\tTime\tTime\t",
        f"X0\t{number(late)}\t{number(0)}\t",
        f"Delta_X\t{number(0.004)}\t{number(0.004)}\t",
        "***End_of_Header***\t\t",
    ]
    if x_columns == "Multi":
        names = "X_Value\tF1\tX_Value\tx1\tComment"
    else:
        names = "X_Value\tF1\tx1\tComment"
    body = []
    for k, y in enumerate(MOTION):
        t = number(0.004 * k)
        cells = {
            "No": ["", number(y), number(2 * y)],
            "One": [t, number(y), number(2 * y)],
            "Multi": [t, number(y), t, number(2 * y)],
        }[x_columns]
        body.append("\t".join(cells))
    return lines(head, names, body)


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("x_columns", ["No", "One", "Multi"])
def test_labview_measurements(written, x_columns, decimal):
    pytest.importorskip("pint")
    record = read_record(written(lvm(x_columns, decimal), "a.lvm"))
    assert record.fs == pytest.approx(250)
    np.testing.assert_allclose(record.force[:, 0], 1e3 * MOTION, atol=1e-3)
    np.testing.assert_allclose(record.displacement[:, 0], 2e-3 * MOTION, atol=1e-8)


def test_starts_of_labview_measurements(written):
    pytest.importorskip("pint")
    record = read_record(written(lvm("No", late=0.04), "a.lvm"))
    assert record.n_samples == N - 10
    np.testing.assert_allclose(record.force[:, 0], 1e3 * MOTION[:-10], atol=1e-3)


def test_several_measurements_in_one_file_are_not_one_test(written):
    text = lvm("One")
    with pytest.raises(FileFormatError, match="2 measurements"):
        read_table(written(text + text[text.index("Channels") :], "a.lvm"))


def test_a_compressed_table(tmp_path):
    path = tmp_path / "own.csv.gz"
    body = "".join(f"{k / 100},{y},{2 * y}\n" for k, y in enumerate(MOTION))
    path.write_bytes(gzip.compress(b"t,F1,x1\n" + body.encode()))
    reading = inspect_record(path)
    np.testing.assert_allclose(reading.record.force[:, 0], MOTION)
    assert reading.record.name == "own"


def test_a_damaged_compressed_table(tmp_path):
    path = tmp_path / "own.csv.gz"
    path.write_bytes(gzip.compress(b"t,F1\n" * 1000)[:-20])
    with pytest.raises(FileFormatError, match="compressed file"):
        read_table(path)
