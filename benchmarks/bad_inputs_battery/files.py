"""Bad files: empty, cut off, of another type than their name, hostile, or with wrong
words in them.
"""

# ruff: noqa: E501

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records.files import read_frf, read_record, read_table

from .kind import Kind
from .material import good

_KEPT: list[tempfile.TemporaryDirectory] = []  # lives as long as the process


@cache
def folder() -> Path:
    """A folder of files that goes away with the process."""
    _KEPT.append(tempfile.TemporaryDirectory(prefix="bad files "))
    return Path(_KEPT[0].name)


def written(name: str, content: str | bytes) -> Path:
    """A file of that content, in a folder of its own."""
    home = Path(tempfile.mkdtemp(dir=folder()))
    path = home / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def made(name: str, write: Callable[[Path], Any]) -> Path:
    """A file that a library writes."""
    path = Path(tempfile.mkdtemp(dir=folder())) / name
    write(path)
    return path


def frame() -> pd.DataFrame:
    """A good table with a time."""
    return good().to_frame().reset_index()


def csv(
    table: pd.DataFrame | None = None, name: str = "test.csv", **options: Any
) -> Path:
    """A table as delimited text."""
    return written(
        name, (frame() if table is None else table).to_csv(index=False, **options)
    )


def cut(path: Path, share: float) -> Path:
    """The first part of a file."""
    raw = path.read_bytes()
    return written(path.name, raw[: int(len(raw) * share)])


def flipped(path: Path, at: float, n: int = 64) -> Path:
    """A file with some bytes overwritten."""
    raw = bytearray(path.read_bytes())
    start = int(len(raw) * at)
    raw[start : start + n] = bytes(255 - b for b in raw[start : start + n])
    return written(path.name, bytes(raw))


def mat(**variables: Any) -> Path:
    from scipy.io import savemat

    return made(
        "test.mat",
        lambda p: savemat(
            p, variables or {"a1": good().acceleration[:, 0], "t": good().time}
        ),
    )


def hdf5(**variables: Any) -> Path:
    import h5py

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, value in (
                variables or {"a1": good().acceleration[:, 0], "t": good().time}
            ).items():
                file[name] = value

    return made("test.h5", write)


def npz(name: str = "test.npz", **variables: Any) -> Path:
    return made(
        name,
        lambda p: np.savez(
            p, **(variables or {"a1": good().acceleration[:, 0], "t": good().time})
        ),
    )


def parquet() -> Path:
    return made("test.parquet", lambda p: frame().to_parquet(p))


def npy_header(shape: tuple[int, ...]) -> Path:
    def write(path: Path) -> None:
        with open(path, "wb") as file:
            np.lib.format.write_array_header_1_0(
                file, {"descr": "<f8", "fortran_order": False, "shape": shape}
            )
            file.write(bytes(80))

    return made("a1.npy", write)


def zipped(name: str, content: bytes) -> Path:
    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(name, content)

    return made("test.npz", write)


UFF_55 = """    -1
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


def of_readers() -> dict[str, tuple]:
    """Files that :func:`read_table` refuses."""
    return {
        "no such file": (folder() / "none.csv", "does not exist", "Check the path"),
        "a folder": (folder(), "is not a file", "Give one file"),
        "empty file": (written("empty.csv", ""), "is empty", "Export it again"),
        "empty MAT": (written("empty.mat", ""), "is empty", "Export it again"),
        "nothing but a header": (
            written("head.csv", "t,a1,F1\n"),
            "no rows of numbers|no channel",
            "table of numbers|Give",
        ),
        "nothing but blank lines": (
            written("blank.csv", "\n\n  \n"),
            "no rows of numbers|no channel",
            "table of numbers|Give",
        ),
        "prose": (
            written("notes.txt", "The shaker was mounted on floor 2.\nIt rained.\n"),
            "no rows of numbers",
            "table of numbers",
        ),
        "markup": (
            written("page.csv", "<html><script>alert(1)</script></html>\n"),
            "no rows of numbers",
            "table of numbers",
        ),
        "binary called CSV": (
            written("data.csv", bytes(range(256)) * 40),
            "binary data",
            "rename it|export it",
        ),
        "a type that is not read": (
            written("test.xlsb", b"abc"),
            "type .xlsb, which is not read",
            "Supported types are",
        ),
        "a spreadsheet called CSV": (
            zipped("xl/workbook.xml", b"<workbook/>").rename(folder() / "book.csv"),
            "is called .csv but holds",
            "Rename|export",
        ),
        "HDF5 called NPZ": (
            hdf5().rename(folder() / "h.npz"),
            "is called .npz but holds HDF5",
            "Rename it to .h5",
        ),
        "Parquet called CSV": (
            parquet().rename(folder() / "p.csv"),
            "is called .csv but holds Parquet",
            "Rename it to .parquet",
        ),
        "CSV called MAT": (
            csv(name="test.mat"),
            "cannot be read as MATLAB",
            "export it again|rename",
        ),
        "CSV called HDF5": (
            csv(name="test.h5"),
            "cannot be read as HDF5",
            "export it again|rename",
        ),
        "CSV called Parquet": (
            csv(name="test.parquet"),
            "cannot be read as Parquet",
            "export it again|rename",
        ),
        "CSV called NPZ": (
            csv(name="test.npz"),
            "cannot be read as NumPy|pickled",
            "export it again|rename|plain arrays",
        ),
        "CSV called UFF": (
            csv(name="test.uff"),
            "cannot be read as UFF",
            "export it again|rename",
        ),
        "truncated MAT": (
            cut(mat(), 0.6),
            "cannot be read as MATLAB",
            "export it again",
        ),
        "MAT with a damaged middle": (
            flipped(mat(), 0.0, 140),
            "cannot be read as MATLAB",
            "export it again",
        ),
        "truncated HDF5": (
            cut(hdf5(), 0.5),
            "cannot be read as HDF5",
            "export it again",
        ),
        "truncated Parquet": (
            cut(parquet(), 0.7),
            "cannot be read as Parquet",
            "export it again",
        ),
        "truncated NPZ": (
            cut(npz(), 0.5),
            "cannot be read as NumPy",
            "export it again",
        ),
        "UFF of the wrong type (mode shapes)": (
            written("shapes.uff", UFF_55),
            "no time history",
            "export it again|another type",
        ),
        "UFF cut off": (
            written("cut.uff", UFF_55[:60]),
            "cannot be read as UFF|no time history",
            "export it again",
        ),
        "NumPy file that wants a terabyte": (
            npy_header((2**37,)),
            "holds|cannot be read as NumPy",
            "limit|cut off",
        ),
        "NumPy file of negative length": (
            npy_header((-5,)),
            "cannot be read as NumPy",
            "export it again",
        ),
        "pickled objects": (
            made("a1.npy", lambda p: np.save(p, np.array([{}, None], dtype=object))),
            "pickled Python objects",
            "plain arrays",
        ),
        "an archive of other things": (
            zipped("readme.txt", b"hello"),
            "no channel of numbers|cannot be read as NumPy",
            "Give|export",
        ),
        "MAT with text only": (
            mat(note="hello"),
            "no channel of numbers",
            "one variable or column",
        ),
        "HDF5 with a single number": (
            hdf5(k=3.0),
            "no channel of numbers",
            "one variable or column",
        ),
        "two columns of one name": (
            written("twice.csv", "t,a1,a1\n0,1,2\n1,2,3\n2,3,4\n"),
            "two columns named 'a1'",
            "Rename one",
        ),
        "rows of different width": (
            written(
                "ragged.csv",
                "t,a1\n"
                + "".join("0.1,2,3,4,5\n" if i % 2 else "1,2\n" for i in range(40)),
            ),
            "cannot be read|no rows of numbers|columns|differ",
            "export|Give|table",
        ),
        "UTF-16 without a mark": (
            written("u16.csv", "t,a1\n0,1\n1,2\n".encode("utf-16-le")),
            "binary data|characters|no rows",
            "export|Give|rename",
        ),
    }


def of_records() -> dict[str, tuple]:
    """Files that are read, but hold no usable record."""
    f = frame()
    holes, infinite, words = f.copy(), f.copy(), f.copy()
    holes.loc[500, "a2"], infinite.loc[9, "x1"] = np.nan, np.inf
    words = words.astype({"x3": object})
    words.loc[7, "x3"] = "overload"
    late = f.copy()
    late.loc[700:, "t"] += 0.4
    back = f.iloc[::-1]
    plain = f.drop(columns="t")
    return {
        "no time": (csv(plain), {}, "has no time column", "--fs|fs="),
        "no motion": (
            csv(f[["t", "F2"]]),
            {},
            "no column is known to be a motion",
            "mapping|--map",
        ),
        "columns of no known name": (
            csv(f.set_axis([f"q{i}" for i in range(f.shape[1])], axis=1)),
            {},
            "no column is known to be a motion",
            "mapping|--map",
        ),
        "NaN in the middle": (
            csv(holes),
            {},
            "a2 of record 'test' is NaN in row 500",
            "Split|fill",
        ),
        "infinity in the file": (
            csv(infinite),
            {},
            "x1 .* is infinite in row 9",
            "Repair",
        ),
        "a word among numbers": (
            csv(words),
            {},
            "holds the text 'overload' in data row 8",
            "Remove it",
        ),
        "a gap in the clock": (csv(late), {}, "clock is uneven", "Split|resample"),
        "a clock that runs backwards": (
            csv(back),
            {},
            "runs backwards after row 0",
            "Sort",
        ),
        "time stamps that are none": (
            csv(f.assign(t="noon")),
            {},
            "time 'noon' is not understood|'noon'",
            "timestamps|Remove",
        ),
        "a sampling rate in words": (
            csv(plain),
            {"fs": "fast"},
            "fs='fast' is not a sampling rate",
            "Hz",
        ),
        "a mapping to a column that is not there": (
            csv(),
            {"mapping": {"x1": "laser"}},
            "has no variable 'laser'",
            "It holds",
        ),
        "a mapping that is code": (
            csv(),
            {"mapping": {"x1": "__import__('os').getcwd()"}},
            "has no variable|is not understood",
            "It holds|Write",
        ),
        "a mapping that is a number": (
            csv(),
            {"mapping": {"x1": 3}},
            "is 3, not a text",
            "Write",
        ),
        "a mapping by an unknown factor": (
            csv(),
            {"mapping": {"x1": "x1*gain"}},
            "factor 'gain' of channel x1",
            "Write",
        ),
        "a mapping by zero": (
            csv(),
            {"mapping": {"x1": "x1*0"}},
            "not a usable number",
            "finite factor",
        ),
        "a channel without a number": (
            csv(),
            {"mapping": {"a": "a1"}},
            "has no number",
            "Write a1",
        ),
        "a motion declared unknown": (
            csv(),
            {"mapping": {"x1": "unknown"}},
            "cannot be 'unknown'",
            "Only a force",
        ),
        "an unknown unit": (
            csv(),
            {"units": {"x": "blorb"}},
            "'blorb' of channel x1 is unknown",
            "Write e.g.",
        ),
        "a unit of another kind": (
            csv(),
            {"units": {"x1": "kN"}},
            "unit 'kN' measures force",
            "Write e.g.",
        ),
        "a unit that is a number": (
            csv(),
            {"units": {"x1": 3}},
            "unit of 'x1' is 3",
            "text",
        ),
        "a unit for a channel that is not there": (
            csv(),
            {"units": {"x9": "mm"}},
            "'x9', which is not among the channels",
            "Name a channel",
        ),
        "a column that is not in the matrix": (
            mat(acc=good().acceleration, t=good().time),
            {"mapping": {"a1": "acc[:, 7]"}},
            "there is no column 7",
            "count from 0",
        ),
        "a matrix where a line is needed": (
            mat(acc=good().acceleration, t=good().time),
            {"mapping": {"a1": "acc"}},
            "has the shape",
            "Pick one column",
        ),
        "complex numbers for a channel": (
            mat(a1=good().acceleration[:, 0] * 1j, t=good().time),
            {},
            "is complex",
            "read_frf",
        ),
        "variables of other lengths": (
            mat(a1=good().acceleration[:, 0], t=good().time[:-4]),
            {},
            "channels differ in length",
            "Map channels of one test|resample",
        ),
        "more bytes than allowed": (
            csv(),
            {"max_bytes": 1000},
            "more than the limit",
            "max_bytes",
        ),
    }


def of_responses() -> dict[str, tuple]:
    """Frequency responses."""
    lines = "f;H1;H2\n" + "".join(
        f"{f};{0.1 * f}+0.01j;0.2-0.1j\n" for f in range(1, 30)
    )
    return {
        "a record as a frequency response": (
            csv(),
            {},
            "holds no complex responses",
            "export real and imaginary",
        ),
        "frequencies that fall": (
            written("f.csv", "f;H1\n2;1+1j\n1;1+1j\n"),
            {},
            "does not rise after row 0",
            "Sort",
        ),
        "a response with a gap": (
            written("f.csv", lines.replace("0.5+0.01j", "nan+0j")),
            {},
            "H1 is not finite in row",
            "Cut",
        ),
        "driven where there is nothing": (
            written("f.csv", lines),
            {"excited": 7},
            "excited=7 is not one of the 2 DOFs",
            "Name the DOF",
        ),
        "an unknown kind": (
            written("f.csv", lines),
            {"kind": "magic"},
            "kind='magic' is unknown",
            "Choose",
        ),
        "text for a response": (
            written("f.csv", "f;H1\none;two\n"),
            {},
            "'one;two' is not 2 numbers",
            "Write complex numbers",
        ),
        "an empty response": (written("f.csv", ""), {}, "is empty", "Export"),
    }


def kinds() -> list[Kind]:
    """All kinds of this room."""
    out = [
        Kind(
            "file",
            name,
            lambda p: read_table(p, max_bytes=10**9),
            (path,),
            NRFError,
            tuple(words),
        )
        for name, (path, *words) in of_readers().items()
    ]
    for read, rows in ((read_record, of_records()), (read_frf, of_responses())):
        out += [
            Kind(
                "file",
                name,
                lambda p, o, read=read: read(p, **o),
                (path, options),
                NRFError,
                tuple(words),
            )
            for name, (path, options, *words) in rows.items()
        ]
    return out
