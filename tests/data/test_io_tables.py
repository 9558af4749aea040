"""Files of every kind hold what was put into them, and damaged ones say so."""

import pickle
import zipfile

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pysindy_nrf.data.io import read_table
from pysindy_nrf.exceptions import FileFormatError

T = np.array([0.0, 0.01, 0.02, 0.03])
A = np.array([1.5, -2.25, 3e-4, 1e3])

DIALECTS = {
    "comma": "t,a1\n0.00,1.5\n0.01,-2.25\n0.02,3e-4\n0.03,1e3\n",
    "semicolon and decimal comma": "t;a1\n0,00;1,5\n0,01;-2,25\n0,02;3e-4\n0,03;1e3\n",
    "tab and decimal comma": "t\ta1\n0,00\t1,5\n0,01\t-2,25\n0,02\t3e-4\n0,03\t1e3\n",
    "blanks": "   t      a1\n  0.00   1.5\n  0.01  -2.25\n 0.02 3e-4\n 0.03 1e3\n",
    "comment lines": "# shaker test\n% channel list below\nt,a1\n0.00,1.5\n# pause\n0.01,-2.25\n0.02,3e-4\n0.03,1e3\n",
    "names in a comment": "# t, a1\n0.00,1.5\n0.01,-2.25\n0.02,3e-4\n0.03,1e3\n",
    "preamble": "Project: bridge, 2024\nOperator;X\n\nt;a1\n0.00;1.5\n0.01;-2.25\n0.02;3e-4\n0.03;1e3\n",
    "separator at the end": "t;a1;\n0.00;1.5;\n0.01;-2.25;\n0.02;3e-4;\n0.03;1e3;\n",
    "quoted names": '"t","a1"\n0.00,1.5\n0.01,-2.25\n0.02,3e-4\n0.03,1e3\n',
    "Windows lines and mark": "\ufefft,a1\r\n0.00,1.5\r\n0.01,-2.25\r\n0.02,3e-4\r\n0.03,1e3\r\n",
}


@pytest.mark.parametrize("text", DIALECTS.values(), ids=DIALECTS.keys())
def test_the_dialect_is_found(tmp_path, text):
    path = tmp_path / "test.csv"
    path.write_bytes(text.encode())
    variables = read_table(path).variables
    assert list(variables) == ["t", "a1"]
    np.testing.assert_array_equal(variables["t"], T)
    np.testing.assert_array_equal(variables["a1"], A)


def test_units_in_a_header_or_on_their_own_line(tmp_path):
    path = tmp_path / "test.txt"
    path.write_text("t [s];Laser 2 (mm);hammer\n0;1;2\n1;2;3\n")
    assert read_table(path).units == {"t": "s", "Laser 2": "mm"}
    path.write_text("t;x1;F1\ns;mm;kN\n0;1;2\n1;2;3\n")
    table = read_table(path)
    assert table.units == {"t": "s", "x1": "mm", "F1": "kN"}
    np.testing.assert_array_equal(table.variables["F1"], [2, 3])


def test_a_bracket_that_is_no_unit_stays_in_the_name(tmp_path):
    path = tmp_path / "test.csv"
    path.write_text("t,a (floor 1),a (floor 2)\n0,1,2\n1,2,3\n")
    assert list(read_table(path).variables) == ["t", "a (floor 1)", "a (floor 2)"]


def test_columns_without_names_are_numbered(tmp_path):
    path = tmp_path / "test.dat"
    path.write_text("0 1\n1 2\n2 3\n")
    table = read_table(path)
    assert list(table.variables) == ["c1", "c2"]
    assert "no names" in table.notes[0]


def test_a_comma_is_no_decimal_comma_between_columns(tmp_path):
    path = tmp_path / "test.csv"
    path.write_text("1,5\n2,6\n3,7\n")
    np.testing.assert_array_equal(read_table(path).variables["c2"], [5, 6, 7])


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_encodings(tmp_path, encoding):
    path = tmp_path / "test.csv"
    path.write_bytes("Zeit;Größe\n0;1\n1;2\n".encode(encoding))
    assert list(read_table(path).variables) == ["Zeit", "Größe"]


def test_parquet_keeps_numbers_and_the_time_index(tmp_path):
    path = tmp_path / "test.parquet"
    pd.DataFrame(
        {"a1": A.astype("float32"), "F1": pd.array([1, 2, None, 4], dtype="Int64")}, index=pd.Index(T, name="t")
    ).to_parquet(path)
    variables = read_table(path).variables
    np.testing.assert_array_equal(variables["t"], T)
    assert variables["a1"].dtype == np.float32
    np.testing.assert_array_equal(variables["F1"], [1, 2, np.nan, 4])


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
            file[name] = np.atleast_2d(np.asarray(content[name])).T  # MATLAB writes columns first
        file["daq/fs"], file["daq/x"] = [[100.0]], A[None, :]
        file["note"] = np.frombuffer("hello".encode("utf-16-le"), dtype="u2")[:, None]
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
    with open(tmp_path / "v73.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    v5, v73 = (read_table(tmp_path / name) for name in ("v5.mat", "v73.mat"))
    assert v73.kind == "MATLAB v7.3"
    assert set(v5.variables) == set(v73.variables) == {"t", "acc", "gain", "daq.fs", "daq.x"}
    for name, values in v5.variables.items():
        np.testing.assert_array_equal(values, v73.variables[name])
    assert v5.variables["t"].shape == (4,) and v5.variables["acc"].shape == (4, 2) and v5.variables["gain"].shape == ()


def test_numpy_archives(tmp_path):
    np.savez(tmp_path / "test.npz", t=T, fs=100.0, acc=np.zeros((4, 3), dtype=np.float32))
    variables = read_table(tmp_path / "test.npz").variables
    assert variables["acc"].shape == (4, 3) and variables["fs"].shape == ()


class Bomb:
    """Unpickling this would leave a mark."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_pickles_are_never_loaded(tmp_path):
    mark = tmp_path / "mark"
    np.savez(tmp_path / "bad.npz", a1=np.array([Bomb(mark)], dtype=object))
    with pytest.raises(FileFormatError, match="pickled"):
        read_table(tmp_path / "bad.npz")
    (tmp_path / "bad.npy").write_bytes(pickle.dumps(Bomb(mark)))
    with pytest.raises(FileFormatError):
        read_table(tmp_path / "bad.npy")
    assert not mark.exists()


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".npz", ".npy", ".parquet", ".h5"])
def test_empty_missing_and_cut_files_are_named(tmp_path, suffix):
    path = tmp_path / f"broken{suffix}"
    with pytest.raises(FileFormatError, match=rf"broken\{suffix} does not exist"):
        read_table(path)
    path.touch()
    with pytest.raises(FileFormatError, match=rf"broken\{suffix} is empty"):
        read_table(path)
    rng = np.random.default_rng(0)
    path.write_bytes(rng.bytes(3000))
    with pytest.raises(FileFormatError, match=rf"broken\{suffix}"):
        read_table(path)


def test_cut_binaries(tmp_path):
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


def test_what_a_file_is_not(tmp_path):
    (tmp_path / "a.xyz").write_text("t,a1\n0,1\n")
    with pytest.raises(FileFormatError, match=r"type \.xyz"):
        read_table(tmp_path / "a.xyz")
    np.savez(tmp_path / "a.npz", x=T)
    (tmp_path / "b.csv").write_bytes((tmp_path / "a.npz").read_bytes())
    with pytest.raises(FileFormatError, match="called .csv but holds a ZIP"):
        read_table(tmp_path / "b.csv")
    (tmp_path / "c.csv").write_text("The quick brown fox\njumps over\n")
    with pytest.raises(FileFormatError, match="no rows of numbers"):
        read_table(tmp_path / "c.csv")
    with pytest.raises(FileFormatError, match="not a file"):
        read_table(tmp_path)
    savemat(tmp_path / "d.mat", {"note": "only text"})
    with pytest.raises(FileFormatError, match="no channel of numbers"):
        read_table(tmp_path / "d.mat")


def test_size_limits(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", x=np.zeros(2_000_000))
    assert (tmp_path / "bomb.npz").stat().st_size < 100_000
    with pytest.raises(FileFormatError, match="more than the limit"):
        read_table(tmp_path / "bomb.npz", max_bytes=1_000_000)
    with zipfile.ZipFile(tmp_path / "bomb.npz") as archive:
        assert archive.testzip() is None
    (tmp_path / "a.csv").write_text("t,a1\n0,1\n1,2\n")
    with pytest.raises(FileFormatError, match="limit"):
        read_table(tmp_path / "a.csv", max_bytes=5)
