"""NumPy, HDF5, MATLAB and Parquet files: what was put in comes out; damaged, lying or
hostile files are refused.
"""

import io
import pickle
import re
import struct
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pysindy_nrf import ChainModel, NRFRegressor, laws, simulate
from pysindy_nrf.exceptions import ChannelError, FileFormatError
from pysindy_nrf.records.files import read_record, read_table

T = np.array([0.0, 0.01, 0.02, 0.03])
A = np.array([1.5, -2.25, 3e-4, 1e3])
LIMIT = 1_000_000
ZEROS = np.zeros(1_000_000)  # 8 MB, a few kB compressed


def refused(path, match="limit", **options):
    """Refused by name, with less memory than the content would take."""
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match=match) as caught:
            read_table(path, **options)
        assert tracemalloc.get_traced_memory()[1] < 6_000_000
    finally:
        tracemalloc.stop()
    assert path.name in str(caught.value)


def test_parquet_keeps_numbers_and_the_time_index(tmp_path):
    path = tmp_path / "test.parquet"
    columns = {
        "a1": A.astype("float32"),
        "F1": pd.array([1, 2, None, 4], dtype="Int64"),
    }
    pd.DataFrame(columns, index=pd.Index(T, name="t")).to_parquet(path)
    variables = read_table(path).variables
    np.testing.assert_array_equal(variables["t"], T)
    assert variables["a1"].dtype == np.float32
    np.testing.assert_array_equal(variables["F1"], [1, 2, np.nan, 4])


def test_parquet_columns_of_words_are_numbers_where_they_are(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    words = [f"{0.5 * k}" if k != 7 else None for k in range(40)]
    pq.write_table(
        pa.table({"t": np.arange(40) / 10, "x1": words}), tmp_path / "a.parquet"
    )
    with pytest.raises(ChannelError, match="x1 of record 'a' is NaN in row 7"):
        read_record(tmp_path / "a.parquet")
    pq.write_table(
        pa.table({"t": np.arange(32) / 10, "x1": [None, *words[8:], None][:32]}),
        tmp_path / "a.parquet",
    )
    np.testing.assert_array_equal(
        read_record(tmp_path / "a.parquet").displacement[1:, 0], 0.5 * np.arange(8, 39)
    )
    pq.write_table(
        pa.Table.from_arrays([pa.array(T), pa.array(T)], names=["x1", "x1"]),
        tmp_path / "a.parquet",
    )
    with pytest.raises(FileFormatError, match="two columns named 'x1'"):
        read_table(tmp_path / "a.parquet")


def test_matlab_5_and_7_3_give_the_same(tmp_path):
    content = {
        "t": T[:, None],
        "acc": np.arange(8.0).reshape(4, 2),
        "gain": 35.15,
        "daq": {"fs": 100.0, "x": A},
        "note": "hello",
    }
    savemat(tmp_path / "v5.mat", content)
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        for name in ("t", "acc", "gain"):
            file[name] = np.atleast_2d(
                np.asarray(content[name])
            ).T  # MATLAB writes columns first
        file["daq/fs"], file["daq/x"] = [[100.0]], A[None, :]
        file["note"] = np.frombuffer("hello".encode("utf-16-le"), dtype="u2")[:, None]
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
    with open(tmp_path / "v73.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    v5, v73 = (read_table(tmp_path / name) for name in ("v5.mat", "v73.mat"))
    assert v73.kind == "MATLAB v7.3"
    assert (
        set(v5.variables)
        == set(v73.variables)
        == {"t", "acc", "gain", "daq.fs", "daq.x"}
    )
    for name, values in v5.variables.items():
        np.testing.assert_array_equal(values, v73.variables[name])
    assert (
        v5.variables["t"].shape == (4,)
        and v5.variables["acc"].shape == (4, 2)
        and v5.variables["gain"].shape == ()
    )


def test_every_kind_of_matlab_variable_passes(tmp_path):
    import scipy.sparse

    cell = np.empty((2, 2), dtype=object)
    cell[:] = [[1, "a"], [np.zeros((0, 0)), {"q": [1, 2]}]]
    content = {
        "a1": np.arange(9.0),
        "c": cell,
        "s": scipy.sparse.eye(4).tocsc(),
        "z": 1j * np.ones(3),
        "u": "größe",
        "e": np.zeros((0, 3)),
        "b": np.array([True]),
        "i": np.arange(3, dtype="i8"),
        "st": np.array([(1, 2.0)], dtype=[("x", "i4"), ("y", "f8")]),
        "run": {
            "x1": A,
            "about": np.array([("a", 1)], dtype=[("who", "O"), ("n", "O")]),
        },
    }
    for compressed in (False, True):
        savemat(tmp_path / "test.mat", content, do_compression=compressed)
        found = read_table(tmp_path / "test.mat").variables
        np.testing.assert_array_equal(found["a1"], np.arange(9.0))
        np.testing.assert_array_equal(found["z"], 1j * np.ones(3))
        np.testing.assert_array_equal(found["run.x1"], A)


def test_numpy_arrays_archives_and_fields(tmp_path):
    np.savez(
        tmp_path / "test.npz", t=T, fs=100.0, acc=np.zeros((4, 3), dtype=np.float32)
    )
    variables = read_table(tmp_path / "test.npz").variables
    assert variables["acc"].shape == (4, 3) and variables["fs"].shape == ()
    fields = np.zeros(
        50, dtype=[("t", float), ("Δx", float)]
    )  # beyond latin-1: NumPy writes its version 3
    fields["Δx"] = np.arange(50.0)
    with (
        pytest.warns(UserWarning, match="format 3.0"),
        open(tmp_path / "log.npy", "wb") as file,
    ):
        np.save(file, fields)
    np.testing.assert_array_equal(
        read_table(tmp_path / "log.npy").variables["log.Δx"], np.arange(50.0)
    )
    np.save(tmp_path / "plain.npy", A)
    np.testing.assert_array_equal(
        read_table(tmp_path / "plain.npy").variables["plain"], A
    )


def test_hdf5_groups_texts_and_empty_sets(tmp_path):
    """Groups that hold themselves are read once; what is not a channel is left out."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/a1"] = np.arange(4.0)
        file["run/deep/x1"] = np.arange(4.0)
        file["run/deep/root"] = file["/"]
        file["run/deep/again"] = file["run"]
        file["run/twin"] = file["run/a1"]
        file["t"] = np.arange(4.0)
        file["run/named"] = h5py.SoftLink("/t")
        file["who"] = "the lab"
        file.create_dataset("nothing", data=h5py.Empty("f8"))
    assert list(read_table(tmp_path / "a.h5").variables) == [
        "run.a1",
        "run.deep.x1",
        "t",
    ]


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".npz", ".npy", ".parquet", ".h5"])
def test_empty_missing_and_meaningless_files_are_named(tmp_path, suffix):
    path = tmp_path / f"broken{suffix}"
    with pytest.raises(FileFormatError, match=rf"broken\{suffix} does not exist"):
        read_table(path)
    path.touch()
    with pytest.raises(FileFormatError, match=rf"broken\{suffix} is empty"):
        read_table(path)
    path.write_bytes(np.random.default_rng(0).bytes(3000))
    with pytest.raises(FileFormatError, match=rf"broken\{suffix}"):
        read_table(path)


def test_cut_files(tmp_path):
    line = np.random.default_rng(0).normal(size=5000)
    savemat(tmp_path / "a.mat", {"x1": line}, do_compression=True)
    np.savez_compressed(tmp_path / "a.npz", x1=line)
    pd.DataFrame({"x1": line}).to_parquet(tmp_path / "a.parquet")
    for name in ("a.mat", "a.npz", "a.parquet"):
        whole = (tmp_path / name).read_bytes()
        for share in (0.3, 0.99):
            (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
            with pytest.raises(FileFormatError, match=name):
                read_table(tmp_path / name)


def element(kind, data=b""):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def shape(*n):
    return element(5, struct.pack(f"<{len(n)}i", *n))


HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
FLAGS, STRUCTURE = (element(6, struct.pack("<II", kind, 0)) for kind in (6, 1))
NAME, ONE = element(1, b"x1"), element(9, struct.pack("<d", 1.0))
NESTED = element(14, FLAGS + shape(1, 1) + NAME + ONE)
for _ in range(5000):
    NESTED = element(14, STRUCTURE + shape(1, 1) + NAME + NESTED)


@pytest.mark.parametrize(
    "body",
    [
        element(9, bytes(16)),
        NESTED,
        element(14, struct.pack("<II", 6, 800)),
        element(14, shape(1, 1) + NAME + ONE),
        element(14, FLAGS + shape(-1, 1) + NAME + ONE),
        element(14, FLAGS + shape(1, 1) + NAME + element(250, bytes(8))),
    ],
    ids=[
        "no array",
        "5000 structures",
        "tag too long",
        "no flags",
        "negative size",
        "no such type",
    ],
)
def test_a_damaged_matlab_file_is_refused_and_the_process_lives(written, body):
    """Level 5 of the format: tag, flags, dimensions, name, content. SciPy's reader can
    end its process.
    """
    with pytest.raises(FileFormatError, match="damaged.mat"):
        read_table(written(HEAD + body, "damaged.mat"))


def test_compressed_files_beyond_the_limit(tmp_path):
    """A few kB that unpack to 8 MB, a MATLAB stream of 200 MB of zeros, a terabyte that
    HDF5 declares.
    """
    np.savez_compressed(tmp_path / "a.npz", x1=ZEROS)
    savemat(tmp_path / "a.mat", {"x1": ZEROS}, do_compression=True)
    pd.DataFrame({"x1": ZEROS, "t": ZEROS}).to_parquet(tmp_path / "a.parquet")
    for name in ("a.npz", "a.mat", "a.parquet"):
        assert (tmp_path / name).stat().st_size < 30_000
        refused(tmp_path / name, max_bytes=LIMIT)
    packed = zlib.compress(bytes(200_000_000), 9)
    (tmp_path / "b.mat").write_bytes(
        HEAD + np.array([15, len(packed)], "<u4").tobytes() + packed
    )
    refused(tmp_path / "b.mat", max_bytes=10_000_000)
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset(
            "x1", (10**6, 10**6), "f8", chunks=(1000, 1000), compression="gzip"
        )
    refused(tmp_path / "a.h5")
    (tmp_path / "a.csv").write_text("t,a1\n0,1\n1,2\n")
    refused(tmp_path / "a.csv", max_bytes=5)


def test_files_that_unpack_out_of_all_proportion(tmp_path):
    """Below the limit of 4 GB, but a thousand times their own size, as no measured
    channels are.
    """
    with zipfile.ZipFile(
        tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1
    ) as archive:
        content = io.BytesIO()
        np.save(content, np.zeros(30_000_000))
        archive.writestr("x1.npy", content.getbuffer())
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset(
            "x1", (400_000_000,), "f8", chunks=(1_000_000,), compression="gzip"
        )
    for name in ("a.npz", "a.h5"):
        with pytest.raises(
            FileFormatError, match=f"{name}, a file of .* MB, unpacks to more than"
        ):
            read_table(tmp_path / name)


@pytest.mark.parametrize("shape", [(10**12,), (10**6, 10**6), (2**62, 8), (-5,)])
def test_numpy_headers_that_lie(tmp_path, shape):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    (tmp_path / "a.npy").write_bytes(stream.getvalue() + bytes(80))
    refused(tmp_path / "a.npy", "declares the shape")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x1.npy", stream.getvalue() + bytes(80))
    refused(tmp_path / "a.npz", "declares the shape")


def test_hdf5_reads_no_other_file(tmp_path):
    h5py = pytest.importorskip("h5py")
    np.arange(10.0).tofile(tmp_path / "secret.bin")
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file.create_dataset(
            "x1", (10,), "f8", external=[(str(tmp_path / "secret.bin"), 0, 80)]
        )
    refused(tmp_path / "external.h5", "'x1' lies in another file")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x1"] = np.arange(10.0)
    layout = h5py.VirtualLayout((10,), "f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x1", shape=(10,))
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("x1", layout)
    refused(tmp_path / "virtual.h5", "'x1' lies in another file")
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["a1"] = np.arange(4.0)
        file["x1"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "x1")
    assert list(read_table(tmp_path / "link.h5").variables) == ["a1"]


class Mark:
    """Unpickling this leaves a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_pickles_are_never_loaded(tmp_path):
    mark = Mark(tmp_path / "it_ran")
    np.savez(tmp_path / "a.npz", a1=np.array([mark, mark], dtype=object))
    np.save(tmp_path / "a.npy", np.array([mark, mark], dtype=object))
    (tmp_path / "b.npy").write_bytes(pickle.dumps(mark))
    for name, words in {
        "a.npz": "pickled",
        "a.npy": "pickled",
        "b.npy": "b.npy",
    }.items():
        for read in (read_table, read_record):
            with pytest.raises(FileFormatError, match=words):
                read(tmp_path / name)
    assert not (tmp_path / "it_ran").exists()


SCRIPT = (Path(__file__).parents[3] / "examples" / "write_test.m").read_text("utf-8")


def test_what_the_matlab_script_writes_is_one_test_in_two_forms(tmp_path):
    """The names and the header stand in the script; columns as MATLAB writes them, (n,
    1), by the structure it solves.
    """
    names = re.findall(
        r"'(\w+)'",
        re.search(r"^save\('shaker_test\.mat'(.*), '-v7'\)", SCRIPT, re.MULTILINE)[1],
    )
    header = re.search(r"fprintf\(file, '(t \[s\].*)\\n'\)", SCRIPT)[1]
    model = ChainModel(
        [12.0, 10.0],
        {1: laws.PowerSeries(1, [50.0, 5e4]), 2: laws.PowerSeries(1, [40.0, 4e4])},
    )
    t = np.arange(5000) / 500
    force = np.column_stack([0 * t, 80 * np.sin(2 * np.pi * (1 + 0.6 * t) * t)])
    run = simulate(model, force, 1 / 500, method="newmark")
    a, x = run.acceleration, run.displacement
    held = {
        "t": t,
        "F2": force[:, 1],
        "a1": a[:, 0],
        "a2": a[:, 1],
        "x1": x[:, 0],
        "x2": x[:, 1],
    }
    savemat(
        tmp_path / "shaker_test.mat",
        {name: held[name][:, None] for name in names},
        do_compression=True,
    )
    columns = np.column_stack([t, force[:, 1] / 1e3, a / 9.80665, 1e3 * x])
    np.savetxt(
        tmp_path / "shaker_test.csv", columns, "%.12g", ",", header=header, comments=""
    )
    records = [read_record(tmp_path / f"shaker_test.{kind}") for kind in ("mat", "csv")]
    for name in ("force", "acceleration", "displacement"):
        first, second = (getattr(record, name) for record in records)
        np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-12)
    assert records[0].forced == (2,) and records[0].fs == records[1].fs == 500.0
    np.testing.assert_allclose(
        NRFRegressor(degree=1).fit(records[1]).masses_, [12, 10], rtol=2e-3
    )


def test_a_timetable_says_how_it_is_exported(tmp_path):
    h5py = pytest.importorskip("h5py")

    def element(kind, data):
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    numbers = (
        element(6, struct.pack("<II", 13, 0))
        + element(5, struct.pack("<ii", 2, 1))
        + element(1, b"")
        + element(6, b"\1\0\0\0" * 2)
    )
    words = element(1, b"TT") + element(1, b"MCOS") + element(1, b"timetable")
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    (tmp_path / "v7.mat").write_bytes(
        head
        + element(
            14, element(6, struct.pack("<II", 17, 0)) + words + element(14, numbers)
        )
    )
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        file["TT"] = np.ones((1, 6), dtype="u4")
        file["TT"].attrs["MATLAB_class"] = np.bytes_("timetable")
        file["TT"].attrs["MATLAB_object_decode"] = np.int32(3)
    for name in ("v7.mat", "v73.mat"):
        with pytest.raises(
            FileFormatError, match=r"TT \(timetable\).*timetable2table\(TT\)"
        ):
            read_table(tmp_path / name)
