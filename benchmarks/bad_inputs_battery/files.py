"""Bad files: empty, cut off, hostile, of another type than their name says."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pysindy_nrf.records.files import read_frf, read_record, read_table

from .kind import Kind, refused
from .material import good
from .sample_files import (
    csv,
    cut,
    flipped,
    folder,
    frame,
    hdf5,
    mat,
    npy_of_shape,
    npz,
    parquet,
    pickled,
    renamed,
    written,
    zipped,
)

UFF_MODE_SHAPES = """    -1
    55
NONE
NONE
NONE
NONE
NONE
         1         2         3         8         2         6
         2         4         0         1
  0.00000E+00  1.00000E+00  0.00000E+00  0.00000E+00
    -1
"""


def kinds() -> Iterator[Kind]:
    """All kinds of this room."""
    yield from unreadable()
    yield from incomplete_records()
    yield from spoilt_columns()
    yield from mappings()
    yield from units()
    yield from variables()
    yield from responses()


# -- files that are refused as tables ------------------------------------------


def unreadable() -> Iterator[Kind]:
    """Files that ``read_table`` refuses."""
    yield from empty_files()
    yield from other_types()
    yield from damaged_files()
    yield from hostile_files()
    yield from odd_tables()


def table(name: str, path: Path, *words: str) -> Kind:
    """A file that cannot be read as a table."""
    return refused(name, partial(read_table, path, max_bytes=10**9), *words)


def empty_files() -> Iterator[Kind]:
    """Files of nothing, or of no numbers."""
    no_numbers = ("no rows of numbers", "table of numbers")
    no_channel = ("no rows of numbers|no channel", "table of numbers|Give")

    yield table(
        "no such file", folder() / "none.csv", "does not exist", "Check the path"
    )
    yield table("a folder", folder(), "is not a file", "Give one file")
    yield table("empty file", written("empty.csv", ""), "is empty", "Export it again")
    yield table("empty MAT", written("empty.mat", ""), "is empty", "Export it again")
    yield table("nothing but a header", written("head.csv", "t,a1,F1\n"), *no_channel)
    yield table(
        "nothing but blank lines", written("blank.csv", "\n\n  \n"), *no_channel
    )
    prose = "The shaker was mounted on floor 2.\nIt rained.\n"
    yield table("prose", written("notes.txt", prose), *no_numbers)
    page = "<html><script>alert(1)</script></html>\n"
    yield table("markup", written("page.csv", page), *no_numbers)


def other_types() -> Iterator[Kind]:
    """Files of another type than their name says."""
    again = "export it again|rename"
    workbook = zipped("xl/workbook.xml", b"<workbook/>")

    yield table(
        "binary called CSV",
        written("data.csv", bytes(range(256)) * 40),
        "binary data",
        "rename it|export it",
    )
    yield table(
        "a type that is not read",
        written("test.xlsb", b"abc"),
        "type .xlsb, which is not read",
        "Supported types are",
    )
    yield table(
        "a spreadsheet called CSV",
        renamed(workbook, "book.csv"),
        "is called .csv but holds",
        "Rename|export",
    )
    yield table(
        "HDF5 called NPZ",
        renamed(hdf5(), "h.npz"),
        "is called .npz but holds HDF5",
        "Rename it to .h5",
    )
    yield table(
        "Parquet called CSV",
        renamed(parquet(), "p.csv"),
        "is called .csv but holds Parquet",
        "Rename it to .parquet",
    )
    yield table(
        "CSV called MAT", csv(name="test.mat"), "cannot be read as MATLAB", again
    )
    yield table("CSV called HDF5", csv(name="test.h5"), "cannot be read as HDF5", again)
    yield table(
        "CSV called Parquet",
        csv(name="test.parquet"),
        "cannot be read as Parquet",
        again,
    )
    yield table(
        "CSV called NPZ",
        csv(name="test.npz"),
        "cannot be read as NumPy|pickled",
        f"{again}|plain arrays",
    )
    yield table("CSV called UFF", csv(name="test.uff"), "cannot be read as UFF", again)


def damaged_files() -> Iterator[Kind]:
    """Files that are cut off or overwritten."""
    again = "export it again"

    yield table("truncated MAT", cut(mat(), 0.6), "cannot be read as MATLAB", again)
    yield table(
        "MAT with a damaged middle",
        flipped(mat(), 0.0, 140),
        "cannot be read as MATLAB",
        again,
    )
    yield table("truncated HDF5", cut(hdf5(), 0.5), "cannot be read as HDF5", again)
    yield table(
        "truncated Parquet", cut(parquet(), 0.7), "cannot be read as Parquet", again
    )
    yield table("truncated NPZ", cut(npz(), 0.5), "cannot be read as NumPy", again)
    yield table(
        "UFF of the wrong type (mode shapes)",
        written("shapes.uff", UFF_MODE_SHAPES),
        "no time history",
        "export it again|another type",
    )
    yield table(
        "UFF cut off",
        written("cut.uff", UFF_MODE_SHAPES[:60]),
        "cannot be read as UFF|no time history",
        again,
    )


def hostile_files() -> Iterator[Kind]:
    """Files that want all memory, or to run code."""
    yield table(
        "NumPy file that wants a terabyte",
        npy_of_shape(2**37),
        "holds|cannot be read as NumPy",
        "limit|cut off",
    )
    yield table(
        "NumPy file of negative length",
        npy_of_shape(-5),
        "cannot be read as NumPy",
        "export it again",
    )
    yield table("pickled objects", pickled(), "pickled Python objects", "plain arrays")
    yield table(
        "an archive of other things",
        zipped("readme.txt", b"hello"),
        "no channel of numbers|cannot be read as NumPy",
        "Give|export",
    )


def odd_tables() -> Iterator[Kind]:
    """Files of numbers that make no table."""
    no_channel = ("no channel of numbers", "one variable or column")
    ragged = "t,a1\n" + "1,2\n0.1,2,3,4,5\n" * 20
    utf16 = "t,a1\n0,1\n1,2\n".encode("utf-16-le")

    yield table("MAT with text only", mat(note="hello"), *no_channel)
    yield table("HDF5 with a single number", hdf5(k=3.0), *no_channel)
    yield table(
        "two columns of one name",
        written("twice.csv", "t,a1,a1\n0,1,2\n1,2,3\n2,3,4\n"),
        "two columns named 'a1'",
        "Rename one",
    )
    yield table(
        "rows of different width",
        written("ragged.csv", ragged),
        "cannot be read|no rows of numbers|columns|differ",
        "export|Give|table",
    )
    yield table(
        "UTF-16 without a mark",
        written("u16.csv", utf16),
        "binary data|characters|no rows",
        "export|Give|rename",
    )


# -- files that are read, but hold no usable record ----------------------------


def record(path: Path, **options: Any) -> partial:
    """A record read from a file."""
    return partial(read_record, path, **options)


def incomplete_records() -> Iterator[Kind]:
    """Files without a clock or a motion."""
    table = frame()
    without_time = csv(table.drop(columns="t"))
    unknown_names = [f"q{i}" for i in range(table.shape[1])]
    no_motion = ("no column is known to be a motion", "mapping|--map")

    yield refused("no time", record(without_time), "has no time column", "--fs|fs=")
    yield refused(
        "a sampling rate in words",
        record(without_time, fs="fast"),
        "fs='fast' is not a sampling rate",
        "Hz",
    )
    yield refused("no motion", record(csv(table[["t", "F2"]])), *no_motion)
    yield refused(
        "columns of no known name",
        record(csv(table.set_axis(unknown_names, axis=1))),
        *no_motion,
    )
    yield refused(
        "more bytes than allowed",
        record(csv(), max_bytes=1000),
        "more than the limit",
        "max_bytes",
    )


def spoilt_columns() -> Iterator[Kind]:
    """Columns with gaps, words, or a clock that does not run evenly."""
    holes = frame()
    holes.loc[500, "a2"] = np.nan
    infinite = frame()
    infinite.loc[9, "x1"] = np.inf
    words = frame().astype({"x3": object})
    words.loc[7, "x3"] = "overload"
    late = frame()
    late.loc[700:, "t"] += 0.4

    yield refused(
        "NaN in the middle",
        record(csv(holes)),
        "a2 of record 'test' is NaN in row 500",
        "Split|fill",
    )
    yield refused(
        "infinity in the file",
        record(csv(infinite)),
        "x1 .* is infinite in row 9",
        "Repair",
    )
    yield refused(
        "a word among numbers",
        record(csv(words)),
        "holds the text 'overload' in data row 8",
        "Remove it",
    )
    yield refused(
        "a gap in the clock",
        record(csv(late)),
        "clock is uneven",
        "Split|resample",
    )
    yield refused(
        "a clock that runs backwards",
        record(csv(frame().iloc[::-1])),
        "runs backwards after row 0",
        "Sort",
    )
    yield refused(
        "time stamps that are none",
        record(csv(frame().assign(t="noon"))),
        "time 'noon' is not understood|'noon'",
        "timestamps|Remove",
    )


def mappings() -> Iterator[Kind]:
    """Channels that are mapped to nothing."""

    def mapped(name: str, channel: str, expression: Any, *words: str) -> Kind:
        return refused(name, record(csv(), mapping={channel: expression}), *words)

    yield mapped(
        "a mapping to a column that is not there",
        "x1",
        "laser",
        "has no variable 'laser'",
        "It holds",
    )
    yield mapped(
        "a mapping that is code",
        "x1",
        "__import__('os').getcwd()",
        "has no variable|is not understood",
        "It holds|Write",
    )
    yield mapped("a mapping that is a number", "x1", 3, "is 3, not a text", "Write")
    yield mapped(
        "a mapping by an unknown factor",
        "x1",
        "x1*gain",
        "factor 'gain' of channel x1",
        "Write",
    )
    yield mapped(
        "a mapping by zero", "x1", "x1*0", "not a usable number", "finite factor"
    )
    yield mapped("a channel without a number", "a", "a1", "has no number", "Write a1")
    yield mapped(
        "a motion declared unknown",
        "x1",
        "unknown",
        "cannot be 'unknown'",
        "Only a force",
    )


def units() -> Iterator[Kind]:
    """Units that are none, or of another kind."""

    def measured_in(name: str, channel: str, unit: Any, *words: str) -> Kind:
        return refused(name, record(csv(), units={channel: unit}), *words)

    yield measured_in(
        "an unknown unit",
        "x",
        "blorb",
        "'blorb' of channel x1 is unknown",
        "Write e.g.",
    )
    yield measured_in(
        "a unit of another kind",
        "x1",
        "kN",
        "unit 'kN' measures force",
        "Write e.g.",
    )
    yield measured_in("a unit that is a number", "x1", 3, "unit of 'x1' is 3", "text")
    yield measured_in(
        "a unit for a channel that is not there",
        "x9",
        "mm",
        "'x9', which is not among the channels",
        "Name a channel",
    )


def variables() -> Iterator[Kind]:
    """Variables of MATLAB files that are no line of real numbers."""
    a, t = good().acceleration, good().time
    matrix = mat(acc=a, t=t)

    yield refused(
        "a column that is not in the matrix",
        record(matrix, mapping={"a1": "acc[:, 7]"}),
        "there is no column 7",
        "count from 0",
    )
    yield refused(
        "a matrix where a line is needed",
        record(matrix, mapping={"a1": "acc"}),
        "has the shape",
        "Pick one column",
    )
    yield refused(
        "complex numbers for a channel",
        record(mat(a1=a[:, 0] * 1j, t=t)),
        "is complex",
        "read_frf",
    )
    yield refused(
        "variables of other lengths",
        record(mat(a1=a[:, 0], t=t[:-4])),
        "channels differ in length",
        "Map channels of one test|resample",
    )


# -- frequency responses -------------------------------------------------------


def responses() -> Iterator[Kind]:
    """Files that hold no usable frequency response."""
    lines = ["f;H1;H2"]
    for f in range(1, 30):
        lines.append(f"{f};{0.1 * f}+0.01j;0.2-0.1j")
    text = "\n".join(lines) + "\n"

    def response(name: str, text: str, *words: str, **options: Any) -> Kind:
        call = partial(read_frf, written("f.csv", text), **options)
        return refused(name, call, *words)

    yield refused(
        "a record as a frequency response",
        partial(read_frf, csv()),
        "holds no complex responses",
        "export real and imaginary",
    )
    yield response(
        "frequencies that fall",
        "f;H1\n2;1+1j\n1;1+1j\n",
        "does not rise after row 0",
        "Sort",
    )
    yield response(
        "a response with a gap",
        text.replace("0.5+0.01j", "nan+0j"),
        "H1 is not finite in row",
        "Cut",
    )
    yield response(
        "driven where there is nothing",
        text,
        "excited=7 is not one of the 2 DOFs",
        "Name the DOF",
        excited=7,
    )
    yield response(
        "an unknown kind", text, "kind='magic' is unknown", "Choose", kind="magic"
    )
    yield response(
        "text for a response",
        "f;H1\none;two\n",
        "'one;two' is not 2 numbers",
        "Write complex numbers",
    )
    yield response("an empty response", "", "is empty", "Export")
