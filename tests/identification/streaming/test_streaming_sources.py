"""Files and iterators read in chunks: every row once, errors that name them."""

import chains
import numpy as np
import pandas as pd
import pytest
from chains import table

from pysindy_nrf import NRFRegressor
from pysindy_nrf.exceptions import (
    ChannelError,
    ExcitationError,
    FileFormatError,
    NRFError,
)
from pysindy_nrf.identification.streaming import ColumnReader, open_source, sources
from pysindy_nrf.records import Input

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")


@pytest.fixture
def chunks_of_400(monkeypatch):
    monkeypatch.setattr(sources, "SAMPLES_IN_CHUNK", (400, 400))


@pytest.mark.usefixtures("chunks_of_400")
def test_chunks_cut_through_the_row_groups_of_a_file(exact, tmp_path):
    """Groups of 300 rows, chunks of 400: every row is read once, in order."""
    path = tmp_path / "a.parquet"
    table(exact.X, exact.F).to_parquet(path, row_group_size=300)
    model = NRFRegressor().fit(path)
    assert chains.worst(model.masses_, exact.m) < 1e-8

    chunks = list(open_source(Input(path), ColumnReader()).chunks())
    X = np.vstack([chunk.samples.X for chunk in chunks])
    np.testing.assert_array_equal(X, exact.X)
    assert [chunk.first for chunk in chunks] == [True] + [False] * (len(chunks) - 1)


@pytest.mark.usefixtures("chunks_of_400")
def test_chunks_have_one_size(exact, tmp_path):
    path = tmp_path / "even.parquet"
    table(exact.X, exact.F).to_parquet(path, row_group_size=1000)
    sizes = [
        chunk.n_samples for chunk in open_source(Input(path), ColumnReader()).chunks()
    ]
    assert sizes == [400] * 5


@pytest.fixture
def folder(exact, tmp_path):
    """Files of all kinds, some of which are of no use."""
    np.save(tmp_path / "X.npy", exact.X)
    np.save(tmp_path / "F.npy", exact.F)
    np.save(tmp_path / "short.npy", exact.F[:-1])
    np.save(tmp_path / "t.npy", np.arange(2000.0))
    objects = np.array([{"a": 1}], dtype=object)
    np.save(tmp_path / "object.npy", objects, allow_pickle=True)
    (tmp_path / "F.csv").write_text("F1\n1\n")
    table(exact.X, exact.F).to_parquet(tmp_path / "a.parquet")
    return tmp_path


@pytest.mark.parametrize(
    ("X", "F", "error", "words"),
    [
        ("X.npy", "short.npy", ChannelError, "F has 1999 samples, X has 2000"),
        ("none.parquet", None, FileFormatError, "does not exist"),
        ("F.csv", None, FileFormatError, "chunksize"),
        ("object.npy", None, FileFormatError, "cannot be read"),
        ("X.npy", "F.csv", FileFormatError, "F=.*F.csv' is not a .npy file"),
        ("F.npy", None, ChannelError, r"X has the shape \(2000, 2\)"),
        ("t.npy", None, ChannelError, r"X has the shape \(2000,\)"),
    ],
)
def test_a_file_of_no_use_is_named(folder, X, F, error, words):
    force = None if F is None else folder / F
    with pytest.raises(error, match=words):
        NRFRegressor().fit(folder / X, force)


def test_what_is_given_beside_files_is_refused(folder, exact):
    path = folder / "X.npy"
    with pytest.raises(ChannelError, match="2 files of X need as many of F"):
        NRFRegressor().fit([path, path], [folder / "F.npy"])
    with pytest.raises(ChannelError, match="F was given in addition to a table"):
        NRFRegressor().fit(folder / "a.parquet", exact.F)
    with pytest.raises(ChannelError, match="F was given in addition to an iterator"):
        NRFRegressor().fit(iter([table(exact.X, exact.F)]), exact.F)
    with pytest.raises(ChannelError, match="not a file.*one iterator"):
        NRFRegressor().fit([iter([exact.X]), iter([exact.X])])


@pytest.mark.parametrize(
    ("items", "error", "words"),
    [
        ([], ChannelError, "no samples"),
        ([{"a1": 1.0}], ChannelError, "The iterator gave dict"),
        ([pd.DataFrame({"x": [1.0]})], ChannelError, "no columns a1, a2"),
        ([np.zeros((0, 6))], NRFError, "samples"),
        ([np.full((900, 6), np.nan)], NRFError, "NaN|samples"),
    ],
)
def test_items_of_no_use_are_named(items, error, words):
    with pytest.raises(error, match=words):
        NRFRegressor().fit(iter(items))


@pytest.mark.parametrize(
    ("lost", "error", "words"),
    [
        (["s2"], ChannelError, "lacks the column s2"),
        (["F2"], ChannelError, "lacks the column F2"),
        (["F1", "F2"], ExcitationError, "nothing scales the chain"),
    ],
)
def test_columns_that_are_missing_are_named(exact, lost, error, words):
    frame = table(exact.X, exact.F)
    with pytest.raises(error, match=words):
        NRFRegressor().fit(iter([frame.drop(columns=lost)]))


def test_too_few_samples_are_refused(exact):
    with pytest.raises(ChannelError, match="9 samples are too few"):
        NRFRegressor().fit(iter([table(exact.X[:9], exact.F[:9])]))


# -- files that are not what they seem -----------------------------------------------


def linked(h5py, folder, file, F):
    file["F"] = h5py.ExternalLink(str(folder / "other.h5"), "F")


def kept_elsewhere(h5py, folder, file, F):
    place = [(str(folder / "values.bin"), 0, F.nbytes)]
    file.create_dataset("F", F.shape, "f8", external=place)


def virtual(h5py, folder, file, F):
    layout = h5py.VirtualLayout(F.shape, "f8")
    source = h5py.VirtualSource(str(folder / "other.h5"), "F", shape=F.shape)
    layout[:] = source
    file.create_virtual_dataset("F", layout)


@pytest.mark.parametrize(
    ("hide", "words"),
    [
        (linked, "No force is measured"),
        (kept_elsewhere, "'F' lies in another file"),
        (virtual, "'F' lies in another file"),
    ],
)
def test_a_fit_by_path_reads_no_other_file(exact, tmp_path, hide, words):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["F"] = exact.F
    exact.F.tofile(tmp_path / "values.bin")
    with h5py.File(tmp_path / "test.h5", "w") as file:
        file["X"] = exact.X
        hide(h5py, tmp_path, file, exact.F)
    with pytest.raises(NRFError, match=words):
        NRFRegressor().fit(tmp_path / "test.h5")


def spoil(path, start, filler):
    """Overwrite some thousand bytes of a file."""
    raw = bytearray(path.read_bytes())
    raw[start : start + len(filler)] = filler
    path.write_bytes(raw)


def test_a_page_of_samples_that_is_damaged_is_named(exact, tmp_path):
    """Header and footer of the file are whole."""
    path = tmp_path / "a.parquet"
    table(exact.X, exact.F).to_parquet(path, row_group_size=500, compression="snappy")
    spoil(path, path.stat().st_size // 3, bytes(4000))
    with pytest.raises(FileFormatError, match="a.parquet"):
        NRFRegressor().fit(path)


def test_a_data_set_that_is_damaged_is_named(exact, tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    checked = {"chunks": (250, 6), "compression": "gzip", "fletcher32": True}
    with h5py.File(path, "w") as file:
        file.create_dataset("X", data=exact.X, **checked)
        file.create_dataset("F", data=exact.F, chunks=(250, 2))
    spoil(path, path.stat().st_size // 2, b"\xff" * 3000)
    with pytest.raises(FileFormatError, match="a.h5"):
        NRFRegressor().fit(path)
