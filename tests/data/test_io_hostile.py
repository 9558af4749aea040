"""Files that declare more than they hold, unpack to more than is wanted, or reach for other files: refused before memory is taken."""

import io
import tracemalloc
import zipfile
import zlib

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from pysindy_nrf import Record
from pysindy_nrf.data.io import read_mapping, read_table, write_record
from pysindy_nrf.exceptions import FileFormatError, MissingExtraError

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


def test_npz_bomb(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", x1=ZEROS)
    refused(tmp_path / "a.npz", max_bytes=LIMIT)


def _npy_header(shape):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue()


@pytest.mark.parametrize("shape", [(10**12,), (10**6, 10**6), (2**62, 8), (-5,)])
def test_numpy_headers_that_lie(tmp_path, shape):
    (tmp_path / "a.npy").write_bytes(_npy_header(shape) + bytes(80))
    refused(tmp_path / "a.npy", "declares the shape")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x1.npy", _npy_header(shape) + bytes(80))
    refused(tmp_path / "a.npz", "declares the shape")


def test_matlab_bomb(tmp_path):
    savemat(tmp_path / "a.mat", {"x1": ZEROS}, do_compression=True)
    assert (tmp_path / "a.mat").stat().st_size < 20_000
    refused(tmp_path / "a.mat", max_bytes=LIMIT)


def test_matlab_stream_that_never_ends(tmp_path):
    """One compressed element of 200 MB of zeros."""
    packed = zlib.compress(bytes(200_000_000), 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    (tmp_path / "a.mat").write_bytes(head + np.array([15, len(packed)], "<u4").tobytes() + packed)
    refused(tmp_path / "a.mat", max_bytes=10_000_000)


def test_parquet_of_a_billion_equal_rows(tmp_path):
    pytest.importorskip("pyarrow")
    pd.DataFrame({"x1": ZEROS, "t": np.zeros(len(ZEROS))}).to_parquet(tmp_path / "a.parquet")
    assert (tmp_path / "a.parquet").stat().st_size < 30_000
    refused(tmp_path / "a.parquet", max_bytes=LIMIT)


def test_hdf5_of_a_declared_terabyte(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x1", (10**6, 10**6), "f8", chunks=(1000, 1000), compression="gzip")
    refused(tmp_path / "a.h5")


def test_hdf5_reads_no_other_file(tmp_path):
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret.bin").write_bytes(np.arange(10.0).tobytes())
    np.arange(10.0).tofile(tmp_path / "secret.bin")
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file.create_dataset("x1", (10,), "f8", external=[(str(tmp_path / "secret.bin"), 0, 80)])
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


def test_hdf5_groups_that_hold_themselves_are_read_once(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/a1"] = np.arange(4.0)
        file["run/deep/x1"] = np.arange(4.0)
        file["run/deep/root"] = file["/"]
        file["run/deep/again"] = file["run"]
        file["run/twin"] = file["run/a1"]
        file["t"] = np.arange(4.0)
        file["run/named"] = h5py.SoftLink("/t")
    assert list(read_table(tmp_path / "a.h5").variables) == ["run.a1", "run.deep.x1", "t"]


def test_uff_that_announces_more_than_it_holds(tmp_path):
    pytest.importorskip("pyuff")
    path = write_record(Record(displacement=np.ones((9, 1)), fs=1.0), tmp_path / "a.uff")
    whole = path.read_bytes()
    for lie in (b" 999999999", b"        99"):
        path.write_bytes(whole.replace(b"%10d%10d%10d" % (4, 9, 1), b"%10d%s%10d" % (4, lie, 1)))
        refused(path, "points")
    for cut in (whole[: len(whole) - 20], whole[: len(whole) // 2], whole[: len(whole) * 3 // 4]):
        path.write_bytes(cut)
        refused(path, "does not end|columns are there")
    first = whole.index(b"    -1\n    58", 10)
    path.write_bytes(whole[:first])  # whole data sets are missing
    refused(path, "1 columns are there, 2 were written")


def test_mapping_files_stay_in_their_folder(tmp_path):
    inside = tmp_path / "campaign"
    inside.mkdir()
    (tmp_path / "secret.csv").write_text("t,x1\n0,1\n1,2\n")
    (inside / "link.csv").symlink_to(tmp_path / "secret.csv")
    (inside / "sub").mkdir()
    for name in ("../secret.csv", str(tmp_path / "secret.csv"), "link.csv", "sub/../../secret.csv", ".", "a\\u0000b"):
        (inside / "m.toml").write_text(f'files = ["{name}"]\n')
        with pytest.raises(FileFormatError, match="not in the folder of the mapping file"):
            read_mapping(inside / "m.toml")
    (inside / "m.toml").write_text('files = ["sub/test.csv", "./own.csv"]\n')
    assert [p.name for p in read_mapping(inside / "m.toml").files] == ["test.csv", "own.csv"]


@settings(max_examples=40)
@given(
    data=st.binary(max_size=400),
    suffix=st.sampled_from([".csv", ".mat", ".npz", ".npy", ".parquet", ".h5", ".uff", ".v2"]),
)
def test_noise_in_any_file_is_refused_in_words(tmp_path_factory, data, suffix):
    path = tmp_path_factory.mktemp("noise") / f"a{suffix}"
    path.write_bytes(data)
    try:
        read_table(path)
    except (FileFormatError, MissingExtraError) as error:
        assert path.name in str(error)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """A good file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    rng = np.random.default_rng(0)
    record = Record(acceleration=rng.normal(size=(60, 2)), fs=100.0, name="good")
    out = [write_record(record, folder / f"r{s}") for s in (".parquet", ".uff", ".csv")]
    np.savez_compressed(folder / "r.npz", a1=record.acceleration[:, 0])
    savemat(folder / "r.mat", {"a1": record.acceleration[:, 0]}, do_compression=True)
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "r.h5", "w") as file:
        file["a1"] = record.acceleration[:, 0]
    return [p.read_bytes() for p in out] + [(folder / f"r{s}").read_bytes() for s in (".npz", ".mat", ".h5")]


@settings(max_examples=60)
@given(st.data())
def test_flipped_bytes_never_escape_as_a_bare_error(tmp_path_factory, samples, data):
    which = data.draw(st.integers(0, len(samples) - 1))
    spoilt = bytearray(samples[which])
    for _ in range(data.draw(st.integers(1, 4))):
        spoilt[data.draw(st.integers(0, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("flip") / f"r{['.parquet', '.uff', '.csv', '.npz', '.mat', '.h5'][which]}"
    path.write_bytes(bytes(spoilt))
    try:
        read_table(path, max_bytes=10_000_000)
    except FileFormatError as error:
        assert "r." in str(error)
