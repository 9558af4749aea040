"""Strong-motion text: CSMIP against the peaks of its headers, COSMOS by definition."""

import re
from dataclasses import dataclass, replace

import measured
import numpy as np
import pytest

from pysindy_nrf.exceptions import FileFormatError
from pysindy_nrf.records.files import inspect_record, read_record, read_table

STATED_PEAK = re.compile(
    r"PEAK\s+(\w+)\s+=\s*(-?[\d.]+)\s+\S+\s+AT\s+([\d.]+)", re.IGNORECASE
)


def path_of(channel):
    folder = measured.folder("strong_motion_v2") / "strong_motion_v2"
    return folder / f"CHAN{channel:02d}.V2"


LATER = (
    ("csmip_89324_1992_ch3.V2", 6561, 100),
    ("csmip_54730_2006_ch2.V2", 7808, 100),
    ("csmip_58658_2021_ch7.v2", 13000, 200),
)


@pytest.mark.parametrize(("name", "n_samples", "fs"), LATER)
def test_the_peaks_of_the_dialect_since_1990(name, n_samples, fs):
    """Peak acceleration = 16.917 cm/sec/sec at 18.410 sec, and so on."""
    folder = measured.folder("strong_motion_v2_later")
    table = read_table(folder / "strong_motion_v2_later" / name)
    assert table.fs == fs
    assert [*table.units.values()] == ["cm/sec2", "cm/sec", "cm"]
    assert not any("take care" in note for note in table.notes)
    text = table.path.read_text("latin-1")
    for kind, peak, time in STATED_PEAK.findall(text):
        line = table.variables[kind.lower()]
        assert len(line) == n_samples
        largest = np.abs(line).argmax()
        assert line[largest] == pytest.approx(float(peak), abs=6e-4)
        assert largest / fs == pytest.approx(float(time), abs=1.1 / fs)


@pytest.mark.parametrize("channel", range(1, 14))
def test_the_peaks_are_those_of_the_header(channel):
    """PEAK ACCELERATION = 171.589 CM/SEC/SEC AT 3.140 SEC, and so on."""
    path = path_of(channel)
    table = read_table(path)
    assert table.fs == 50
    assert table.units["acceleration"] == "CM/SEC/SEC"

    stated = STATED_PEAK.findall(path.read_text("latin-1"))
    kinds = [kind.lower() for kind, _, _ in stated]
    assert kinds == ["acceleration", "velocity", "displacement"]
    for kind, peak, time in stated:
        line = table.variables[kind.lower()]
        assert len(line) == 1138
        largest = np.abs(line).argmax()
        assert line[largest] == float(peak)
        assert largest / 50 == pytest.approx(float(time), abs=0.021)


def test_several_files_of_one_test():
    pytest.importorskip("pint")
    mapping = {"ag": "CHAN02.acceleration", "a1": "CHAN05.acceleration"}
    reading = inspect_record([path_of(2), path_of(5)], mapping=mapping)
    record = reading.record
    assert record.base_moves
    assert record.n_dof == 1
    assert record.fs == 50
    assert np.abs(record.base_acceleration).max() == pytest.approx(3.11353)
    notes = " ".join(reading.table.notes).lower()
    assert "west" in notes or "column" in notes


def rows_of(values, form, per_line):
    """Lines of numbers of one form."""
    cells = [format(value, form) for value in values]
    starts = range(0, len(cells), per_line)
    return ["".join(cells[i : i + per_line]) for i in starts]


def csmip(channel, values, step=".005", kind="ACCEL"):
    """A block of CSMIP volume 2: lines of text, the series in 8F10.3, and its end."""
    return [
        "CORRECTED ACCELEROGRAM   01336",
        f"CHAN {channel:2d}: 90 DEG     (STA CHN: {channel:2d})     LOCATION: ROOF",
        f" {len(values)} POINTS OF {kind} DATA EQUALLY SPACED AT  {step} SEC. "
        " (UNITS: CM/SEC/SEC)",
        *rows_of(values, "10.3f", 8),
        f"/&  ----------  END OF DATA FOR CHANNEL  {channel}  ----------",
    ]


def test_numbers_that_touch_and_two_channels_in_a_file(written):
    first = np.array([-12345.678, -98765.432, 1.5, 0.0, 2.25, -3.125, 4.0, 5.0, 100.25])
    lines = csmip(1, first) + csmip(7, first / 2)
    table = read_table(written("\r\n".join(lines) + "\r\n", "two.v2"))
    assert list(table.variables) == ["ch1.acceleration", "ch7.acceleration"]
    assert table.fs == 200
    np.testing.assert_array_equal(table.variables["ch1.acceleration"], first)


@dataclass(frozen=True)
class Cosmos:
    """A block as the COSMOS description lays it out.

    The variants below are those that processing centres write.
    """

    title: str
    kind: str
    announced: str  # the line above the series; {n} points, {T} s
    form: str
    per_line: int
    reals_form: str = "13.6f"
    reals_per_line: int = 6
    interval_ms: float = 5.0
    raw_interval_s: float = 0.01

    def lines(self, values, channel=1, **announced):
        about = {"n": len(values), "T": len(values) * 0.005} | announced
        reals = np.full(100, -999.0)
        reals[33] = self.raw_interval_s
        reals[61] = self.interval_ms
        width = self.reals_form.partition(".")[0]
        return [
            f"{self.title:<26s}(Format v01.20 with 13 text lines) Src: 052b14.abc",
            *[f"text line {i}" for i in range(7)],
            f"Sta Chan {channel:3d}: 90 Deg (Rcrdr Chan {channel:2d}) Location:Roof",
            *[f"text line {i}" for i in range(4)],
            " 100 Integer-header values follow on  10 lines, Format = (10I8)",
            *rows_of([-999] * 100, "8d", 10),
            f" 100 Real-header values follow on  {-(-100 // self.reals_per_line)} lines"
            f" , Format = ({self.reals_per_line}F{width}.6)",
            *rows_of(reals, self.reals_form, self.reals_per_line),
            "   2 Comment line(s) follow, each starting with a |",
            "| RcrdId: NC.1336",
            "| 3 acceleration pts of the pre-event part were cut",
            self.announced.format(**about),
            *rows_of(values, self.form, self.per_line),
            f"End-of-data for Chan  {channel} {self.title.lower()}",
        ]

    def text(self, values, **about):
        return "\r\n".join(self.lines(values, **about)) + "\r\n"


PACKED = Cosmos(
    "Corrected acceleration",
    "acceleration",
    "{n:8d} acceleration  pts, approx {T:4.0f} secs, units=cm/sec2(04),"
    " Format=(8F10.3)",
    "10.3f",
    8,
)
VARIANTS = {
    "packed.v2": PACKED,
    "a column.V2c": replace(
        PACKED,
        announced="{n:8d} acceleration  pts, approx {T:4.0f} secs,"
        " units=cm/sec2(04), Format=(1E15.6)",
        form="15.6E",
        per_line=1,
        reals_form="15.6f",
        reals_per_line=5,
    ),
    "uncorrected.v1c": replace(
        PACKED,
        title="Uncorrected acceleration",
        announced="{n:8d} uncor. accel. pts, approx {T:4.0f} secs, units=cm/sec2"
        " (04),Format=(8F10.3)",
    ),
    "no comma.txt": replace(
        PACKED,
        title="Uncorrected acceleration",
        announced="{n:8d} accel. pts approx {T:4.0f} secs, units=cm/sec2(04),"
        " Format =(5E14.5)",
        form="14.5E",
        per_line=5,
        reals_form="15.6f",
        reals_per_line=5,
    ),
    "velocity.v2": Cosmos(
        "Velocity data",
        "velocity",
        "{n:8d} velocity     pts, approx {T:4.0f} secs, units= cm/sec(05),"
        " Format=(8F10.4)",
        "10.4f",
        8,
    ),
    "displacement.V1": Cosmos(
        "Displacement data",
        "displacement",
        "{n:8d} displacement pts, approx {T:4.0f} secs, units=     cm(06),"
        " Format=(5E15.6)",
        "15.6E",
        5,
    ),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_cosmos_as_the_processing_centres_write_it(written, name):
    """Real 62 is the interval of the resampled series, ms; real 34 of the raw one."""
    pytest.importorskip("pint")
    variant = VARIANTS[name]
    values = 50 * np.sin(np.arange(1201) / 7)
    path = written(variant.text(values), name)
    table = read_table(path)
    assert list(table.variables) == [variant.kind]
    assert table.fs == 200
    np.testing.assert_allclose(table.variables[variant.kind], values, atol=1e-3)

    letter = {"acceleration": "a", "velocity": "v", "displacement": "x"}[variant.kind]
    record = read_record(path, mapping={f"{letter}1": variant.kind})
    motion = getattr(record, variant.kind)[:, 0]
    np.testing.assert_allclose(motion, 0.01 * values, atol=1e-5)


def test_cosmos_channels_of_one_file(written):
    """Where only the interval of the raw record is stated, the series have it."""
    raw = replace(PACKED, interval_ms=-999.0, raw_interval_s=0.005)
    values = np.arange(400) / 8
    text = raw.text(values, channel=1) + raw.text(3 * values, channel=3)
    table = read_table(written(text, "both.v2"))
    assert list(table.variables) == ["ch1.acceleration", "ch3.acceleration"]
    assert table.fs == 200
    third = table.variables["ch3.acceleration"]
    np.testing.assert_allclose(third, 3 * values, atol=5e-4)


def test_raw_counts_are_refused(written):
    counts = Cosmos(
        "Raw acceleration counts",
        "acceleration",
        "{n:8d} raw accel.   pts, approx    0 secs, units=counts (50),Format=(10I8)",
        "8d",
        10,
    )
    path = written(counts.text(np.arange(40) - 982416), "raw.V0c")
    with pytest.raises(FileFormatError, match="raw counts of channel 1"):
        read_table(path)


Y = 100 * np.sin(np.arange(16) / 100)
CONTRADICTIONS = {
    "acceleration of channel 1 twice": csmip(1, Y) + csmip(1, Y),
    "not .* numbers 10 characters wide": [
        line.replace("     0.000", "     0.0x0") for line in csmip(1, Y)
    ],
    r"'\.02\.020' .* is not a number": csmip(1, Y, ".02.020"),
    "announces 16 points .* 8 are there": csmip(1, Y)[:-2],
    "no real header": [PACKED.announced.format(n=16, T=0), *csmip(1, Y)[3:]],
}


@pytest.mark.parametrize(("words", "lines"), CONTRADICTIONS.items())
def test_text_that_contradicts_itself(written, words, lines):
    with pytest.raises(FileFormatError, match=words):
        read_table(written("\n".join(lines) + "\n", "a.v2"))


@pytest.mark.parametrize(
    ("interval_ms", "announced", "words"),
    [
        (5.0, {"n": 40}, "announces 40 points"),
        (5.0, {"T": 60}, "are 0.08 s, the header says 60 s"),
        (-999.0, {}, "no sampling interval"),
    ],
)
def test_cosmos_headers_and_points_differ(written, interval_ms, announced, words):
    block = replace(PACKED, interval_ms=interval_ms, raw_interval_s=-999.0)
    with pytest.raises(FileFormatError, match=words):
        read_table(written(block.text(Y, **announced), "a.v2"))


def test_a_peak_that_the_points_do_not_reach_is_noted(written):
    text = path_of(1).read_text("latin-1").replace("171.589", "999.589", 1)
    notes = read_table(written(text, "peak.v2", "latin-1")).notes
    assert any("peak acceleration of 999.589" in note for note in notes)


# 0x85 is an ellipsis in Windows text
@pytest.mark.parametrize("mark", ["\x85", "\x1c", "\x0b"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_only_ends_of_lines_end_a_line(written, mark, end):
    """Words after such a character are still words of their line."""
    lines = csmip(2, np.arange(10.0))
    lines[1] += f"{mark}CHAN  9: LOG"
    velocity = "9 POINTS OF VELOC DATA EQUALLY SPACED AT  .005 SEC.  (UNITS: CM/SEC)"
    lines.insert(2, f"SEE THE LOG{mark} {velocity}")
    table = read_table(written(end.join(lines) + end, "marked.v2", "latin-1"))
    assert list(table.variables) == ["acceleration"]
    assert any(note.startswith("channel 2:") for note in table.notes)
    np.testing.assert_array_equal(table.variables["acceleration"], np.arange(10.0))


NAMED = {
    "Uncorrected accelerogram   54730-F1275": "V1, .* not corrected",
    "Response and Fourier amplitude spectra": "V3, response spectra",
}


@pytest.mark.parametrize(("title", "words"), NAMED.items())
def test_other_volumes_are_named(written, title, words):
    lines = [title, "Station 1", *["    1.00000    2.00000"] * 40]
    with pytest.raises(FileFormatError, match=words):
        read_table(written("\n".join(lines) + "\n", "a.v2"))


def test_a_line_that_is_only_unknown_is_not_called_damage(written):
    lines = ["Corrected accelerogram 1", "1138 samples of acceleration, every .02 s"]
    with pytest.raises(FileFormatError) as refused:
        read_table(written("\n".join(lines) + "\n", "a.v2"))
    assert "damaged" not in str(refused.value)
    assert "cut off" not in str(refused.value)


def test_channels_of_one_file_with_other_lengths_and_rates(written):
    pytest.importorskip("pint")
    slow, fast = np.arange(2000) * 0.02, np.arange(3990) * 0.01
    lines = csmip(1, 900 * np.sin(9 * slow), ".020")
    lines += csmip(2, 900 * np.sin(9 * fast), ".010")
    path = written("\n".join(lines) + "\n", "two.v2")
    mapping = {"a1": "ch1.acceleration", "a2": "ch2.acceleration"}
    record = read_record(path, mapping=mapping)
    assert record.fs == 50
    np.testing.assert_allclose(*record.acceleration[40:-40].T, atol=0.01)
