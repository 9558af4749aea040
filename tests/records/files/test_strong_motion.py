"""Strong-motion text: real CSMIP files against the peaks their own headers state,
COSMOS by its definition.
"""

import re

import measured
import numpy as np
import pytest

from pysindy_nrf.exceptions import FileFormatError
from pysindy_nrf.records.files import inspect_record, read_record, read_table


def path_of(channel):
    return (
        measured.folder("strong_motion_v2")
        / "strong_motion_v2"
        / f"CHAN{channel:02d}.V2"
    )


@pytest.mark.parametrize("channel", [1, 5, 13])
def test_the_peaks_are_those_of_the_header(channel):
    """PEAK ACCELERATION = 171.589 CM/SEC/SEC AT 3.140 SEC: the right value at the right
    sample, for all three series.
    """
    path = path_of(channel)
    table = read_table(path)
    assert table.fs == 50 and table.units["acceleration"] == "CM/SEC/SEC"
    stated = re.findall(
        r"PEAK\s+(\w+)\s+=\s*(-?[\d.]+)\s+\S+\s+AT\s+([\d.]+)",
        path.read_text("latin-1"),
    )
    assert [kind.lower() for kind, *_ in stated] == [
        "acceleration",
        "velocity",
        "displacement",
    ]
    for kind, value, time in stated:
        line = table.variables[kind.lower()]
        assert len(line) == 1138
        at = np.abs(line).argmax()
        assert line[at] == float(value) and at / 50 == pytest.approx(
            float(time), abs=0.021
        )


def test_several_files_of_one_test():
    pytest.importorskip("pint")
    paths = [path_of(2), path_of(5)]
    reading = inspect_record(
        paths,
        mapping={"ag": "CHAN02.acceleration", "a1": "CHAN05.acceleration"},
        name="overpass",
    )
    rec = reading.record
    assert rec.base_moves and rec.n_dof == 1 and rec.fs == 50
    assert np.abs(rec.base_acceleration).max() == pytest.approx(3.11353)
    assert any(
        "west" in note.lower() or "column" in note.lower()
        for note in reading.table.notes
    )


def csmip(number, values, step=".005", kind="ACCEL", end=True):
    """A block of CSMIP volume 2: lines of text, the series in 8F10.3, and its end."""
    rows = [
        "".join(f"{v:10.3f}" for v in values[i : i + 8])
        for i in range(0, len(values), 8)
    ]
    return [
        "CORRECTED ACCELEROGRAM   01336",
        f"CHAN {number:2d}: 90 DEG     (STA CHN: {number:2d})     LOCATION: ROOF",
        (
            f" {len(values)} POINTS OF {kind} DATA EQUALLY SPACED AT  {step} SEC. "
            " (UNITS: CM/SEC/SEC)"
        ),
        *rows,
        *[f"/&  ----------  END OF DATA FOR CHANNEL  {number}  ----------"] * end,
    ]


def test_a_block_in_which_numbers_touch_and_two_channels_in_a_file(written):
    one = np.array(
        [-12345.678, -98765.432, 1.5, 0.0, 2.25, -3.125, 4.0, 5.0, -6.5, 100.25]
    )
    table = read_table(
        written("\r\n".join(csmip(1, one) + csmip(7, one / 2)) + "\r\n", "two.v2")
    )
    assert (
        list(table.variables) == ["ch1.acceleration", "ch7.acceleration"]
        and table.fs == 200
    )
    np.testing.assert_array_equal(table.variables["ch1.acceleration"], one)


def block_of(
    values,
    *,
    title,
    announced,
    width,
    precision,
    per_line,
    form,
    reals,
    reals_form,
    channel=1,
):
    """A block as the COSMOS description lays it out; the variants are those that
    processing centres write.
    """
    per, wide = reals_form
    number = (
        (lambda v: f"{v:{width}d}")
        if form.endswith("I")
        else (lambda v: f"{v:{width}.{precision}{form[-1]}}")
    )
    lines = [
        f"{title:<26s}(Format v01.20 with 13 text lines) Src: 052b146n8036z.abc",
        *(f"text line {i}" for i in range(7)),
        f"Sta Chan {channel:3d}: 90 Deg (Rcrdr Chan {channel:2d}) Location:Roof",
        *(f"text line {i}" for i in range(4)),
        " 100 Integer-header values follow on  10 lines, Format = (10I8)",
        *("".join(f"{-999:8d}" for _ in range(10)) for _ in range(10)),
        (
            f" 100 Real-header values follow on  {-(-100 // per)} lines , Format ="
            f" ({per}F{wide}.6)"
        ),
        *(
            "".join(f"{v:{wide}.6f}" for v in reals[i : i + per])
            for i in range(0, 100, per)
        ),
        "   2 Comment line(s) follow, each starting with a |",
        "| RcrdId: NC.1336",
        "| 3 acceleration pts of the pre-event part were cut",
        announced,
        *(
            "".join(map(number, values[i : i + per_line]))
            for i in range(0, len(values), per_line)
        ),
        f"End-of-data for Chan  {channel} {title.lower()}",
    ]
    return "\r\n".join(lines) + "\r\n"


VARIANTS = {
    "corrected, packed": (
        "Corrected acceleration",
        (
            "{n:8d} acceleration  pts, approx {T:4.0f} secs, units=cm/sec2(04),"
            " Format=(8F10.3)"
        ),
        (10, 3, 8, "F"),
        (6, 13),
        "acceleration",
    ),
    "corrected, a column": (
        "Corrected acceleration",
        (
            "{n:8d} acceleration  pts, approx {T:4.0f} secs, units=cm/sec2(04),"
            " Format=(1E15.6)"
        ),
        (15, 6, 1, "E"),
        (5, 15),
        "acceleration",
    ),
    "uncorrected": (
        "Uncorrected acceleration",
        (
            "{n:8d} uncor. accel. pts, approx {T:4.0f} secs, units=cm/sec2"
            " (04),Format=(8F10.3)"
        ),
        (10, 3, 8, "F"),
        (6, 13),
        "acceleration",
    ),
    "no comma": (
        "Uncorrected acceleration",
        "{n:8d} accel. pts approx {T:4.0f} secs, units=cm/sec2(04), Format =(5E14.5)",
        (14, 5, 5, "E"),
        (5, 15),
        "acceleration",
    ),
    "velocity": (
        "Velocity data",
        (
            "{n:8d} velocity     pts, approx {T:4.0f} secs, units= cm/sec(05),"
            " Format=(8F10.4)"
        ),
        (10, 4, 8, "F"),
        (6, 13),
        "velocity",
    ),
    "displacement": (
        "Displacement data",
        (
            "{n:8d} displacement pts, approx {T:4.0f} secs, units=     cm(06),"
            " Format=(5E15.6)"
        ),
        (15, 6, 5, "E"),
        (6, 13),
        "displacement",
    ),
}


@pytest.mark.parametrize(
    ("variant", "suffix"),
    list(zip(VARIANTS, [".v2", ".V2c", ".v1c", ".txt", ".v2", ".V1"])),
)
def test_cosmos_as_the_processing_centres_write_it(tmp_path, variant, suffix):
    """Real 62 is the interval of the series in ms; real 34 that of the raw record in s,
    before it was resampled.
    """
    title, announced, (width, precision, per_line, form), reals_form, kind = VARIANTS[
        variant
    ]
    n, reals = 1201, np.full(100, -999.0)
    reals[33], reals[61] = 0.01, 5.0
    values = 50 * np.sin(np.arange(n) / 7)
    text = block_of(
        values,
        title=title,
        announced=announced.format(n=n, T=n * 0.005),
        width=width,
        precision=precision,
        per_line=per_line,
        form=form,
        reals=reals,
        reals_form=reals_form,
    )
    path = tmp_path / f"station{suffix}"
    path.write_text(text, newline="")
    table = read_table(path)
    assert list(table.variables) == [kind] and table.fs == 200
    np.testing.assert_allclose(table.variables[kind], values, atol=1e-3)
    pytest.importorskip("pint")
    letter = {"acceleration": "a", "velocity": "v", "displacement": "x"}[kind]
    rec = read_record(path, mapping={f"{letter}1": kind})
    np.testing.assert_allclose(getattr(rec, kind)[:, 0], 0.01 * values, atol=1e-5)


def test_cosmos_channels_of_one_file_and_raw_counts(tmp_path):
    title, announced, (width, precision, per_line, form), reals_form, _ = VARIANTS[
        "corrected, packed"
    ]
    reals = np.full(100, -999.0)
    reals[33] = (
        0.005  # where only the raw record's interval is stated, the series has it
    )
    values = np.arange(400) / 8
    text = "".join(
        block_of(
            k * values,
            title=title,
            announced=announced.format(n=400, T=2),
            width=width,
            precision=precision,
            per_line=per_line,
            form=form,
            reals=reals,
            reals_form=reals_form,
            channel=k,
        )
        for k in (1, 3)
    )
    (tmp_path / "both.v2").write_text(text, newline="")
    table = read_table(tmp_path / "both.v2")
    assert (
        list(table.variables) == ["ch1.acceleration", "ch3.acceleration"]
        and table.fs == 200
    )
    np.testing.assert_allclose(
        table.variables["ch3.acceleration"], 3 * values, atol=5e-4
    )
    counts = block_of(
        np.arange(40) - 982416,
        title="Raw acceleration counts",
        reals=reals,
        reals_form=(5, 15),
        width=8,
        precision=0,
        announced=(
            "      40 raw accel.   pts, approx    0 secs, units=counts"
            " (50),Format=(10I8)"
        ),
        per_line=10,
        form="I",
    )
    (tmp_path / "raw.V0c").write_text(counts, newline="")
    with pytest.raises(FileFormatError, match="raw counts of channel 1.*V1, V2"):
        read_table(tmp_path / "raw.V0c")


Y = 100 * np.sin(np.arange(16) / 100)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (csmip(1, Y, ".020") + csmip(2, Y, ".010"), "sampled every 0.01, 0.02 s"),
        (csmip(1, Y) + csmip(1, Y), "acceleration of channel 1 twice"),
        (
            [line.replace("     0.000", "     0.0x0") for line in csmip(1, Y)],
            "not made of numbers 10 characters wide",
        ),
        (
            [line.replace(".005", ".02.020") for line in csmip(1, Y)],
            r"'\.02\.020' in a header is not a number",
        ),
        (
            csmip(1, Y)[:-2],
            "announces 16 points of the acceleration of channel 1, 8 are there",
        ),
        (
            [
                (
                    "   16 acceleration pts, approx  0 secs, units=cm/sec2 (04),"
                    " Format=(8f10.3)"
                ),
                *csmip(1, Y)[3:],
            ],
            "cannot be read as .*|no real header with the sampling interval",
        ),
    ],
)
def test_text_that_contradicts_itself(written, lines, words):
    with pytest.raises(FileFormatError, match=words):
        read_table(written("\n".join(lines) + "\n", "a.v2"))


@pytest.mark.parametrize(
    ("announced", "interval", "words"),
    [
        ("40", 5.0, "announces 40 points"),
        ("16 60", 5.0, "16 points every 0.005 s are 0.08 s, the header says 60 s"),
        ("16", -999.0, "no sampling interval"),
    ],
)
def test_cosmos_headers_that_do_not_fit_the_points(written, announced, interval, words):
    title, line, (width, precision, per_line, form), reals_form, _ = VARIANTS[
        "corrected, packed"
    ]
    n, _, seconds = announced.partition(" ")
    reals = np.full(100, -999.0)
    reals[61] = interval
    text = block_of(
        Y,
        title=title,
        announced=line.format(n=int(n), T=float(seconds or 0)),
        width=width,
        precision=precision,
        per_line=per_line,
        form=form,
        reals=reals,
        reals_form=reals_form,
    )
    with pytest.raises(FileFormatError, match=words):
        read_table(written(text, "a.v2"))


def test_a_peak_that_the_points_do_not_reach_is_noted(written):
    text = path_of(1).read_text("latin-1").replace("171.589", "999.589", 1)
    notes = read_table(written(text, "peak.v2", "latin-1")).notes
    assert any("states a peak acceleration of 999.589" in note for note in notes)


@pytest.mark.parametrize(
    "mark", ["\x85", "\x1c", "\x0b"]
)  # 0x85 is an ellipsis in Windows text
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_only_ends_of_lines_end_a_line(tmp_path, mark, end):
    """Words after such a character are still words of their line: no second channel, no
    second series.
    """
    lines = csmip(2, np.arange(10.0))
    lines[1] += f"{mark}CHAN  9: LOG"
    lines.insert(
        2,
        f"SEE THE LOG{mark} 9 POINTS OF VELOC DATA EQUALLY SPACED AT  .005 SEC. "
        " (UNITS: CM/SEC)",
    )
    path = tmp_path / "marked.v2"
    path.write_text(end.join(lines) + end, encoding="latin-1", newline="")
    table = read_table(path)
    assert list(table.variables) == ["acceleration"] and any(
        note.startswith("channel 2:") for note in table.notes
    )
    np.testing.assert_array_equal(table.variables["acceleration"], np.arange(10.0))
