"""NumPy, HDF5, MATLAB and Parquet: what was put in comes out, hostile files do not."""

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
import scipy.sparse
from scipy.io import savemat

from pysindy_nrf import ChainModel, NRFRegressor, laws, simulate
from pysindy_nrf.exceptions import ChannelError, FileFormatError
from pysindy_nrf.records.files import read_record, read_table

T = np.array([0.0, 0.01, 0.02, 0.03])
A = np.array([1.5, -2.25, 3e-4, 1e3])
LIMIT = 1_000_000  # bytes
ZEROS = np.zeros(1_000_000)  # 8 MB, a few kB compressed
MAX_MEMORY = 6_000_000  # bytes; less than any of the refused contents would take


def require_refusal(path, match="limit", **options):
    """Refused by name, with less memory than the content would take."""
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match=match) as caught:
            read_table(path, **options)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < MAX_MEMORY
    assert path.name in str(caught.value)


def test_parquet_keeps_numbers_and_the_time_index(tmp_path):
    integers = pd.array([1, 2, None, 4], dtype="Int64")
    columns = {"a1": A.astype("float32"), "F1": integers}
    frame = pd.DataFrame(columns, index=pd.Index(T, name="t"))
    frame.to_parquet(tmp_path / "test.parquet")
    variables = read_table(tmp_path / "test.parquet").variables
    np.testing.assert_array_equal(variables["t"], T)
    assert variables["a1"].dtype == np.float32
    np.testing.assert_array_equal(variables["F1"], [1, 2, np.nan, 4])


@pytest.fixture
def parquet(tmp_path):
    """Function that writes columns by pyarrow, which pandas would change."""
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow.parquet import write_table

    def write(names, columns):
        path = tmp_path / "a.parquet"
        write_table(
            pyarrow.Table.from_arrays(list(map(pyarrow.array, columns)), names), path
        )
        return path

    return write


def test_parquet_columns_of_words_are_numbers_where_they_are(parquet):
    numbers = 0.5 * np.arange(8, 39)
    words = [None, *map(str, numbers)]
    path = parquet(["t", "x1"], [np.arange(32) / 10, words])
    np.testing.assert_array_equal(read_record(path).displacement[1:, 0], numbers)


def test_a_missing_word_inside_a_parquet_column_is_located(parquet):
    words = [str(k) for k in range(40)]
    words[7] = None
    path = parquet(["t", "x1"], [np.arange(40) / 10, words])
    with pytest.raises(ChannelError, match="x1 of record 'a' is NaN"):
        read_record(path)


def test_parquet_columns_have_different_names(parquet):
    with pytest.raises(FileFormatError, match="two columns named 'x1'"):
        read_table(parquet(["x1", "x1"], [T, T]))


def save_mat_v73(path, content, classes):
    """Variables as MATLAB writes them: HDF5 behind a block of text, columns first."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in content.items():
            file[name] = np.atleast_2d(values).T
        for name, matlab_class in classes.items():
            file[name].attrs["MATLAB_class"] = np.bytes_(matlab_class)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def test_matlab_5_and_7_3_give_the_same(tmp_path):
    matrix = np.arange(8.0).reshape(4, 2)
    column = T[:, None]
    plain = {"t": column, "acc": matrix, "gain": 35.15}
    structure = {"daq": {"fs": 100.0, "x": A}, "note": "hello"}
    savemat(tmp_path / "v5.mat", plain | structure)
    text = np.frombuffer("hello".encode("utf-16-le"), dtype="u2")
    flat = {"daq/fs": 100.0, "daq/x": A, "note": text}
    save_mat_v73(tmp_path / "v73.mat", plain | flat, {"note": "char"})

    v5 = read_table(tmp_path / "v5.mat")
    v73 = read_table(tmp_path / "v73.mat")
    assert v73.kind == "MATLAB v7.3"
    assert set(v5.variables) == {"t", "acc", "gain", "daq.fs", "daq.x"}
    assert set(v5.variables) == set(v73.variables)
    for name, values in v5.variables.items():
        np.testing.assert_array_equal(values, v73.variables[name])
    np.testing.assert_array_equal(v5.variables["t"], T)
    np.testing.assert_array_equal(v5.variables["acc"], matrix)
    assert v5.variables["gain"].shape == ()


@pytest.mark.parametrize("compressed", [False, True])
def test_every_kind_of_matlab_variable_passes(tmp_path, compressed):
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
        "run": {"x1": A, "about": np.array([("a", 1)], dtype="O,O")},
    }
    savemat(tmp_path / "test.mat", content, do_compression=compressed)
    variables = read_table(tmp_path / "test.mat").variables
    np.testing.assert_array_equal(variables["a1"], np.arange(9.0))
    np.testing.assert_array_equal(variables["z"], 1j * np.ones(3))
    np.testing.assert_array_equal(variables["run.x1"], A)


def test_numpy_archives(tmp_path):
    acc = np.zeros((4, 3), dtype=np.float32)
    np.savez(tmp_path / "test.npz", t=T, fs=100.0, acc=acc)
    variables = read_table(tmp_path / "test.npz").variables
    assert variables["acc"].shape == (4, 3)
    assert variables["fs"].shape == ()


def test_numpy_arrays_and_their_fields(tmp_path):
    """A name beyond latin-1 makes NumPy write its version 3."""
    fields = np.zeros(50, dtype=[("t", float), ("Δx", float)])
    fields["Δx"] = np.arange(50.0)
    with pytest.warns(UserWarning, match="format 3.0"):
        np.save(tmp_path / "log.npy", fields)
    variables = read_table(tmp_path / "log.npy").variables
    np.testing.assert_array_equal(variables["log.Δx"], np.arange(50.0))

    np.save(tmp_path / "plain.npy", A)
    variables = read_table(tmp_path / "plain.npy").variables
    np.testing.assert_array_equal(variables["plain"], A)


def test_hdf5_groups_texts_and_empty_sets(tmp_path):
    """Groups that hold themselves are read once; what is no channel is left out."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("run/a1", "run/deep/x1", "t"):
            file[name] = np.arange(4.0)
        file["run/deep/root"] = file["/"]
        file["run/deep/again"] = file["run"]
        file["run/twin"] = file["run/a1"]
        file["run/named"] = h5py.SoftLink("/t")
        file["who"] = "the lab"
        file.create_dataset("nothing", data=h5py.Empty("f8"))
    variables = read_table(tmp_path / "a.h5").variables
    assert list(variables) == ["run.a1", "run.deep.x1", "t"]


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".npz", ".npy", ".parquet", ".h5"])
def test_missing_empty_and_meaningless_files_are_named(tmp_path, suffix):
    path = tmp_path / f"broken{suffix}"
    with pytest.raises(FileFormatError, match=rf"broken\{suffix} does not exist"):
        read_table(path)
    path.touch()
    with pytest.raises(FileFormatError, match=rf"broken\{suffix} is empty"):
        read_table(path)
    path.write_bytes(np.random.default_rng(0).bytes(3000))
    with pytest.raises(FileFormatError, match=rf"broken\{suffix}"):
        read_table(path)


@pytest.mark.parametrize("name", ["a.mat", "a.npz", "a.parquet"])
@pytest.mark.parametrize("share", [0.3, 0.99])
def test_cut_files(tmp_path, name, share):
    line = np.random.default_rng(0).normal(size=5000)
    savemat(tmp_path / "a.mat", {"x1": line}, do_compression=True)
    np.savez_compressed(tmp_path / "a.npz", x1=line)
    pd.DataFrame({"x1": line}).to_parquet(tmp_path / "a.parquet")
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(share * len(content))])
    with pytest.raises(FileFormatError, match=name):
        read_table(tmp_path / name)


# MATLAB's level 5: a head, and elements of type, size and data, padded to 8 bytes. A
# matrix (type 14) holds its flags, its size, its name and its numbers.
INT8 = 1
INT32 = 5
UINT32 = 6
DOUBLE = 9
MATRIX = 14
COMPRESSED = 15
HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


def element(kind, data=b""):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def flags(array_class):
    return element(UINT32, struct.pack("<II", array_class, 0))


def size(*lengths):
    return element(INT32, struct.pack(f"<{len(lengths)}i", *lengths))


NAME = element(INT8, b"x1")
UNIT = element(DOUBLE, struct.pack("<d", 1.0))
OF_DOUBLES, OF_STRUCTURES = flags(6), flags(1)
NESTED = element(MATRIX, OF_DOUBLES + size(1, 1) + NAME + UNIT)
for _ in range(5000):
    NESTED = element(MATRIX, OF_STRUCTURES + size(1, 1) + NAME + NESTED)
DAMAGED = {
    "no array": element(DOUBLE, bytes(16)),
    "5000 structures": NESTED,
    "tag too long": element(MATRIX, struct.pack("<II", UINT32, 800)),
    "no flags": element(MATRIX, size(1, 1) + NAME + UNIT),
    "negative size": element(MATRIX, OF_DOUBLES + size(-1, 1) + NAME + UNIT),
    "no such type": element(
        MATRIX, OF_DOUBLES + size(1, 1) + NAME + element(250, bytes(8))
    ),
}


@pytest.mark.parametrize("body", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_matlab_file_is_refused_and_the_process_lives(written, body):
    """SciPy's reader can end its process."""
    with pytest.raises(FileFormatError, match="damaged.mat"):
        read_table(written(HEAD + body, "damaged.mat"))


def test_compressed_files_beyond_the_limit(tmp_path):
    """A few kB unpack to 8 MB."""
    np.savez_compressed(tmp_path / "a.npz", x1=ZEROS)
    savemat(tmp_path / "a.mat", {"x1": ZEROS}, do_compression=True)
    pd.DataFrame({"x1": ZEROS, "t": ZEROS}).to_parquet(tmp_path / "a.parquet")
    for name in ("a.npz", "a.mat", "a.parquet"):
        assert (tmp_path / name).stat().st_size < 30_000
        require_refusal(tmp_path / name, max_bytes=LIMIT)


def test_a_matlab_stream_beyond_the_limit(written):
    packed = zlib.compress(bytes(200_000_000), 9)
    tag = struct.pack("<II", COMPRESSED, len(packed))
    require_refusal(written(HEAD + tag + packed, "b.mat"), max_bytes=10_000_000)


def zeros_in_hdf5(path, shape, chunks):
    """Write a data set that takes no room, since nothing is written to it."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.create_dataset("x1", shape, "f8", chunks=chunks, compression="gzip")
    return path


def test_a_terabyte_that_hdf5_declares(tmp_path):
    path = zeros_in_hdf5(tmp_path / "a.h5", (10**6, 10**6), (1000, 1000))
    require_refusal(path)


def test_a_file_beyond_the_limit(written):
    require_refusal(written("t,a1\n0,1\n1,2\n"), max_bytes=5)


def test_files_that_unpack_out_of_all_proportion(tmp_path):
    """Below the limit of 4 GB, but a thousand times their own size."""
    path = tmp_path / "a.npz"
    content = io.BytesIO()
    np.save(content, np.zeros(30_000_000))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("x1.npy", content.getbuffer())
    zeros_in_hdf5(tmp_path / "a.h5", (400_000_000,), (1_000_000,))
    for name in ("a.npz", "a.h5"):
        with pytest.raises(FileFormatError, match=f"{name}, .* unpacks to more than"):
            read_table(tmp_path / name)


@pytest.mark.parametrize("shape", [(10**12,), (10**6, 10**6), (2**62, 8), (-5,)])
def test_numpy_headers_that_lie(tmp_path, shape):
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    content = stream.getvalue() + bytes(80)
    (tmp_path / "a.npy").write_bytes(content)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x1.npy", content)
    require_refusal(tmp_path / "a.npy", "declares the shape")
    require_refusal(tmp_path / "a.npz", "declares the shape")


def test_hdf5_reads_no_external_data(tmp_path):
    h5py = pytest.importorskip("h5py")
    np.arange(10.0).tofile(tmp_path / "secret.bin")
    place = [(str(tmp_path / "secret.bin"), 0, 80)]
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file.create_dataset("x1", (10,), "f8", external=place)
    require_refusal(tmp_path / "external.h5", "'x1' lies in another file")


def test_hdf5_reads_no_other_file(tmp_path):
    h5py = pytest.importorskip("h5py")
    other = str(tmp_path / "other.h5")
    with h5py.File(other, "w") as file:
        file["x1"] = np.arange(10.0)
    layout = h5py.VirtualLayout((10,), "f8")
    layout[:] = h5py.VirtualSource(other, "x1", shape=(10,))
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("x1", layout)
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["a1"] = np.arange(4.0)
        file["x1"] = h5py.ExternalLink(other, "x1")
    require_refusal(tmp_path / "virtual.h5", "'x1' lies in another file")
    assert list(read_table(tmp_path / "link.h5").variables) == ["a1"]


class Mark:
    """Unpickling this leaves a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("read", [read_table, read_record])
def test_pickles_are_never_loaded(tmp_path, read):
    mark = Mark(tmp_path / "it_ran")
    objects = np.array([mark, mark], dtype=object)
    np.savez(tmp_path / "a.npz", a1=objects)
    np.save(tmp_path / "a.npy", objects)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(mark))
    for name, words in {"a.npz": "pickled", "a.npy": "pickled", "b.npy": "b"}.items():
        with pytest.raises(FileFormatError, match=words):
            read(tmp_path / name)
    assert not (tmp_path / "it_ran").exists()


SCRIPT = (Path(__file__).parents[4] / "examples" / "write_test.m").read_text("utf-8")
SAVED = re.compile(r"^save\('shaker_test\.mat'(.*), '-v7'\)", re.MULTILINE)
HEADER = re.compile(r"fprintf\(file, '(t \[s\].*)\\n'\)")


@pytest.fixture
def shaker_test(tmp_path):
    """One test as the MATLAB script writes it, as .mat and as .csv.

    Names and header stand in the script; the structure is the one that it solves.
    """
    lower = laws.PowerSeries(1, [50.0, 5e4])
    upper = laws.PowerSeries(1, [40.0, 4e4])
    t = np.arange(5000) / 500
    force = np.column_stack([0 * t, 80 * np.sin(2 * np.pi * (1 + 0.6 * t) * t)])
    model = ChainModel([12.0, 10.0], {1: lower, 2: upper})
    run = simulate(model, force, 1 / 500, method="newmark")
    a, x = run.acceleration, run.displacement

    lines = {"t": t, "F2": force[:, 1], "a1": a[:, 0], "a2": a[:, 1]}
    lines |= {"x1": x[:, 0], "x2": x[:, 1]}
    names = re.findall(r"'(\w+)'", SAVED.search(SCRIPT)[1])
    content = {name: lines[name][:, None] for name in names}
    savemat(tmp_path / "shaker_test.mat", content, do_compression=True)

    columns = np.column_stack([t, force[:, 1] / 1e3, a / 9.80665, 1e3 * x])
    header = HEADER.search(SCRIPT)[1]
    path = tmp_path / "shaker_test.csv"
    np.savetxt(path, columns, "%.12g", ",", header=header, comments="")
    return path


def test_what_the_matlab_script_writes_is_one_test_in_two_forms(shaker_test):
    csv = read_record(shaker_test)
    mat = read_record(shaker_test.with_suffix(".mat"))
    for name in ("force", "acceleration", "displacement"):
        first, second = getattr(csv, name), getattr(mat, name)
        np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-12)
    assert mat.forced == (2,)
    assert mat.fs == csv.fs == 500.0
    model = NRFRegressor(degree=1).fit(csv)
    np.testing.assert_allclose(model.masses_, [12, 10], rtol=2e-3)


def timetable_of_v7():
    """A file with a timetable, an object of MATLAB, as v7 holds it."""
    numbers = [flags(13), size(2, 1), element(INT8), element(UINT32, b"\1\0\0\0" * 2)]
    words = [element(INT8, word) for word in (b"TT", b"MCOS", b"timetable")]
    content = [flags(17), *words, element(MATRIX, b"".join(numbers))]
    return HEAD + element(MATRIX, b"".join(content))


def test_a_timetable_says_how_it_is_exported(tmp_path):
    h5py = pytest.importorskip("h5py")
    (tmp_path / "v7.mat").write_bytes(timetable_of_v7())
    numbers = {"TT": np.ones((6, 1), dtype="u4")}
    save_mat_v73(tmp_path / "v73.mat", numbers, {"TT": "timetable"})
    with h5py.File(tmp_path / "v73.mat", "r+") as file:
        file["TT"].attrs["MATLAB_object_decode"] = np.int32(3)
    for name in ("v7.mat", "v73.mat"):
        with pytest.raises(FileFormatError, match=r"TT \(timetable\).*timetable2table"):
            read_table(tmp_path / name)


def signal(name, samples, unit, start=0.0):
    """A structure of a measuring program: its axis, its values, its name."""
    return {
        "x_values": {"start_value": start, "increment": 1 / 256},
        "y_values": {"values": samples[:, None], "quantity": {"label": unit}},
        "function_record": {"name": name},
    }


def test_structures_of_a_measuring_program(tmp_path):
    pytest.importorskip("pint")
    t = np.arange(512) / 256
    path = tmp_path / "signals.mat"
    content = {
        "Signal_0": signal("F2", np.cos(9 * t), "kN"),
        "Signal_1": signal("x2", np.sin(9 * t[5:]), "mm", start=5 / 256),
    }
    scipy.io.savemat(path, content)
    record = read_record(path)
    assert record.fs == 256
    assert record.n_samples == 507
    np.testing.assert_allclose(record.force[:, 1], 1e3 * np.cos(9 * t[5:]))
    np.testing.assert_allclose(record.displacement[:, 1], 1e-3 * np.sin(9 * t[5:]))


def test_cells_and_arrays_of_structures(tmp_path):
    t = np.arange(512) / 256
    cells = np.empty((1, 2), object)
    cells[0, 0], cells[0, 1] = np.sin(9 * t), np.cos(9 * t)
    laser = {"data": np.sin(t), "unit": "mm"}
    runs = np.array([laser | {"name": "low"}, laser | {"name": "top"}], dtype=object)
    path = tmp_path / "cells.mat"
    scipy.io.savemat(path, {"acc": cells, "Fs": 256.0, "runs": runs})
    table = read_table(path)
    assert {"acc.1", "acc.2", "low", "top"} <= table.variables.keys()
    assert table.units == {"low": "mm", "top": "mm"}
    assert table.fs == 256


@pytest.mark.parametrize("key", ["unit", "units", "unit_string"])
def test_attributes_of_hdf5_data_sets(tmp_path, key):
    h5py = pytest.importorskip("h5py")
    pytest.importorskip("pint")
    path = tmp_path / "u.h5"
    with h5py.File(path, "w") as file:
        file["x1"], file["F1"] = np.sin(np.arange(99)), np.cos(np.arange(99))
        file["x1"].attrs[key] = "mm"
        file["F1"].attrs[key] = np.bytes_("kN")
        file.attrs["fs"] = 250.0
    record = read_record(path)
    assert record.fs == 250
    np.testing.assert_allclose(record.displacement[:, 0], 1e-3 * np.sin(np.arange(99)))
    np.testing.assert_allclose(record.force[:, 0], 1e3 * np.cos(np.arange(99)))


def test_a_matrix_on_its_side(tmp_path):
    """Its rows are as long as the time: they are the channels."""
    t = np.arange(500) / 100
    path = tmp_path / "side.npz"
    np.savez(path, t=t, a=np.vstack([np.sin(t), np.cos(t)]))
    np.testing.assert_array_equal(read_record(path).acceleration[:, 1], np.cos(t))
    np.savez(path, a=np.vstack([np.sin(t), np.cos(t)]))
    with pytest.raises(ChannelError, match="transposed"):
        read_record(path, fs=100.0)
