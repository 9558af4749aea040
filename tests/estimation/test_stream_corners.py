"""Fits in pieces on sources that are uneven, constrained, repeated or wrong: the answer of the arrays, or the cause."""

import chains
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import NRFRegressor, Record, laws
from pysindy_nrf.estimation.streaming import sources
from pysindy_nrf.estimation.streaming.accumulator import Accumulator
from pysindy_nrf.exceptions import ChannelError, ExcitationError, FileFormatError, NRFError
from pysindy_nrf.regression.input_arrays import feature_names

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch):
    monkeypatch.setattr(sources, "chunk_rows", lambda n_dof: 400)


@pytest.fixture(scope="module")
def case():
    return chains.duffing(2, [1, 2], seed=6, n_samples=2000)


def table(case, rows=slice(None), **more):
    columns = dict(zip([*feature_names(2), "F1", "F2"], np.hstack([case.X, case.F])[rows].T))
    return pd.DataFrame(columns | more)


def same(model, case):
    assert chains.worst(model.masses_, case.m) < 1e-8
    for i in (1, 2):
        assert model.restoring_forces_[i].coefficients["s"] == pytest.approx(case.k[i - 1], rel=1e-7)


# -- what the sources hold --------------------------------------------------------------------


def test_parquet_row_groups_that_chunks_cut_through(case, tmp_path):
    """Groups of 300 rows, chunks of 400: a fit that goes on at chunk 3 sees exactly the rows from 1200 on."""
    path = tmp_path / "a.parquet"
    table(case).to_parquet(path, row_group_size=300)
    same(NRFRegressor().fit(path), case)
    source = sources.open_source(path)
    late = np.vstack([chunk.X for chunk in source.chunks(3)])
    np.testing.assert_array_equal(late, case.X[1200:])
    even = tmp_path / "even.parquet"
    table(case).to_parquet(even, row_group_size=1000)
    assert [chunk.n_samples for chunk in sources.open_source(even).chunks()] == [400] * 5


def test_a_list_of_files_goes_on_in_its_second(case, tmp_path):
    """Chunk 4 of two files with three chunks each is the second chunk of the second file."""
    for k, rows in enumerate((slice(0, 1000), slice(1000, 2000))):
        np.save(tmp_path / f"X{k}.npy", case.X[rows])
    source = sources.open_source([tmp_path / "X0.npy", tmp_path / "X1.npy"])
    np.testing.assert_array_equal(next(iter(source.chunks(4))).X, case.X[1400:1800])
    assert source.folder() == tmp_path and source.identity() != sources.open_source([tmp_path / "X0.npy"]).identity()


def test_data_sets_that_are_not_needed_stay_where_they_are(case, tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["X"], file["F"] = case.X, case.F
        file["spectrum"] = np.zeros((2000, 7))
        file["fs"] = 1000.0
    same(NRFRegressor().fit(tmp_path / "a.h5"), case)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["X"], file["F"] = case.X, case.F[:-5]
    with pytest.raises(ChannelError, match=r"data sets of .*b.h5 have \[1995, 2000\] samples"):
        NRFRegressor().fit(tmp_path / "b.h5")


def test_a_fit_by_path_reads_no_other_file(case, tmp_path):
    """Neither through a link, nor from values that are kept elsewhere, nor through a virtual data set."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["F"] = case.F
    case.F.tofile(tmp_path / "secret.bin")
    virtual = h5py.VirtualLayout(case.F.shape, "f8")
    virtual[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "F", shape=case.F.shape)
    for name in ("link", "external", "virtual"):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file["X"] = case.X
            if name == "link":
                file["F"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "F")
            elif name == "external":
                file.create_dataset("F", case.F.shape, "f8", external=[(str(tmp_path / "secret.bin"), 0, case.F.nbytes)])
            else:
                file.create_virtual_dataset("F", virtual)
        says = "No force is measured" if name == "link" else "'F' lies in another file"
        with pytest.raises(NRFError, match=says):
            NRFRegressor().fit(tmp_path / f"{name}.h5")


@pytest.mark.parametrize("suffix", [".h5", ".parquet"])
def test_a_damaged_file_is_named(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"PAR1" + bytes(500) + b"PAR1")
    with pytest.raises(FileFormatError, match=f"a{suffix}"):
        NRFRegressor().fit(path)


def test_a_file_that_is_damaged_in_the_middle_is_named_while_it_is_read(case, tmp_path):
    """Header and footer of the file are whole, a page of samples is not."""
    path = tmp_path / "a.parquet"
    table(case).to_parquet(path, row_group_size=500, compression="snappy")
    raw = bytearray(path.read_bytes())
    middle = len(raw) // 3
    raw[middle : middle + 4000] = bytes(4000)
    path.write_bytes(raw)
    with pytest.raises(FileFormatError, match="a.parquet"):
        NRFRegressor().fit(path)
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("X", data=case.X, chunks=(250, 6), compression="gzip", fletcher32=True)
        file.create_dataset("F", data=case.F, chunks=(250, 2))
    raw = bytearray(path.read_bytes())
    middle = len(raw) // 2
    raw[middle : middle + 3000] = b"\xff" * 3000
    path.write_bytes(raw)
    with pytest.raises(FileFormatError, match="a.h5"):
        NRFRegressor().fit(path)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (lambda c, p: (p / "X.npy", p / "F.csv",), FileFormatError, "F=.*F.csv' is not a .npy file"),
        (lambda c, p: (p / "F.npy",), ChannelError, r"X has the shape \(2000, 2\)"),
        (lambda c, p: (p / "t.npy",), ChannelError, r"X has the shape \(2000,\)"),
        (lambda c, p: ([p / "X.npy", p / "X.npy"], [p / "F.npy"],), ChannelError, "2 files of X need as many of F"),
        (lambda c, p: (p / "a.parquet", c.F,), ChannelError, "F was given beside a table"),
        (lambda c, p: (iter([c.X]), c.F,), ChannelError, "F was given beside an iterator"),
        (lambda c, p: (iter([{"a1": 1.0}]),), ChannelError, "The iterator gave dict"),
        (lambda c, p: (iter([pd.DataFrame({"x": [1.0]})]),), ChannelError, "The table has no columns a1, a2"),
        (lambda c, p: (iter([np.zeros((0, 6))]),), NRFError, "no samples|0 rows|samples"),
        (lambda c, p: (iter([np.full((900, 6), np.nan)]),), NRFError, "NaN|samples"),
        (lambda c, p: (iter([table(c).drop(columns=["F1", "F2"])]),), ExcitationError, "nothing scales the chain"),
        (lambda c, p: (iter([table(c, slice(0, 9))]),), ChannelError, "9 samples are too few for the balance of DOF"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_source_is_named(case, tmp_path, given, error, words):
    np.save(tmp_path / "X.npy", case.X)
    np.save(tmp_path / "F.npy", case.F)
    np.save(tmp_path / "t.npy", np.arange(2000.0))
    (tmp_path / "F.csv").write_text("F1\n1\n")
    table(case).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(error, match=words):
        NRFRegressor().fit(*given(case, tmp_path))


def test_time_must_go_on_from_piece_to_piece(case):
    t = np.arange(2000) * 1e-3
    pieces = [table(case, slice(0, 1000), t=t[:1000]), table(case, slice(1000, 2000), t=t[900:1900])]
    with pytest.raises(ChannelError, match="does not increase from one piece to the next"):
        NRFRegressor(laws={"storey 1": [laws.PowerSeries(3), laws.HarmonicForce(frequency=1.5)]}).fit(iter(pieces))


def test_a_moving_base_in_absolute_coordinates_comes_from_its_own_columns(case):
    """x0 and xdot0 beside absolute motions: drift of storey 1 is x1 - x0, as in memory."""
    t = np.arange(2000) * 1e-3
    x0, xdot0 = 1e-3 * np.sin(9 * t), 9e-3 * np.cos(9 * t)
    x, v = np.cumsum(case.s, axis=1) + x0[:, None], np.cumsum(case.v, axis=1) + xdot0[:, None]
    names = [*feature_names(2, "absolute"), "F1", "F2"]
    frame = pd.DataFrame(dict(zip(names, np.hstack([case.a, v, x, case.F]).T)) | {"xdot0": xdot0, "x0": x0})
    same(NRFRegressor(coordinates="absolute").fit(iter([frame[:700], frame[700:]])), case)


# -- what is found ----------------------------------------------------------------------------


def test_constraints_hold_in_a_fit_by_pieces(case, tmp_path):
    """A total mass that is 10 % too large is reached exactly, by the constrained optimum of the arrays."""
    from pysindy_nrf.estimation.constraints import TotalMass

    np.save(tmp_path / "X.npy", case.X)
    np.save(tmp_path / "F.npy", case.F)
    asked = [TotalMass(1.1 * case.m.sum())]
    pieces = NRFRegressor(constraints=asked).fit(tmp_path / "X.npy", tmp_path / "F.npy")
    whole = NRFRegressor(constraints=asked).fit(case.X, case.F)
    assert pieces.masses_.sum() == pytest.approx(1.1 * case.m.sum(), rel=1e-9)
    np.testing.assert_allclose(pieces.masses_, whole.masses_, rtol=1e-5)


def test_a_second_fit_forgets_the_names_of_the_first(case, tmp_path):
    np.save(tmp_path / "X.npy", case.X)
    np.save(tmp_path / "F.npy", case.F)
    model = NRFRegressor().fit(table(case)[feature_names(2)], case.F)
    assert list(model.feature_names_in_) == feature_names(2)
    model.fit(tmp_path / "X.npy", tmp_path / "F.npy")
    assert not hasattr(model, "feature_names_in_") and model.n_features_in_ == 6
    same(model, case)


def filled(case, rows=slice(None), n=1):
    """An accumulator after some pieces."""
    out = Accumulator(NRFRegressor(), "gram")
    for k, part in enumerate(np.array_split(np.arange(2000)[rows], n)):
        out.add(sources.Chunk(case.X[part], case.F[part], first=k == 0), k)
    return out.close()


def test_sums_of_workers_are_those_of_one(case, chain4):
    """An empty part changes nothing, many parts stay few blocks, another chain is refused."""
    whole = filled(case)
    empty = Accumulator(NRFRegressor(), "gram").close()
    runs = len(whole.runs)
    assert whole.merge(empty).n_samples == 2000 and len(whole.runs) == runs
    parts = Accumulator(NRFRegressor(), "gram")
    for k in range(200):
        one = Accumulator(NRFRegressor(), "gram")
        one.add(sources.Chunk(case.X[10 * k : 10 * k + 10], case.F[10 * k : 10 * k + 10], f"r{k}"), k)
        parts.merge(one.close())
    for dofs, gram in whole.grams().sum().matrices.items():
        size = np.sqrt(np.diag(gram))
        gap = (parts.grams().sum().matrices[dofs] - gram) / np.outer(size, size)
        assert np.abs(gap).max() < 1e-12
    assert len(parts.blocks) < 200 and len(parts.windows) < 200
    with pytest.raises(ChannelError, match="has 2 DOFs, another 4"):
        whole.merge(_other(chain4))
    with pytest.raises(ChannelError, match="There are no samples. The source is empty"):
        empty.require_model()


def _other(chain4):
    out = Accumulator(NRFRegressor(), "gram")
    out.add(sources.Chunk(chain4.X, chain4.F), 0)
    return out.close()


def test_a_state_that_cannot_be_written_costs_no_fit(case, tmp_path, monkeypatch):
    """A folder that turns read-only while the fit runs: a warning, and the answer."""
    from pysindy_nrf.estimation.streaming import fit_streamed
    from pysindy_nrf.exceptions import DataQualityWarning

    np.save(tmp_path / "X.npy", case.X)
    np.save(tmp_path / "F.npy", case.F)
    (tmp_path / "taken").write_text("a file where the folder of states should be")
    with pytest.warns(DataQualityWarning, match="cannot be written .* the fit goes on"):
        model = fit_streamed(
            NRFRegressor(), tmp_path / "X.npy", tmp_path / "F.npy", state=tmp_path / "taken" / "s", save_every=0.0
        )
    same(model, case)


def test_records_pairs_and_a_single_record_are_one_stream(case):
    rec = Record(force=case.F, acceleration=case.a, velocity=np.cumsum(case.v, axis=1),
                 displacement=np.cumsum(case.s, axis=1), fs=1000.0, name="r")  # fmt: skip
    found = NRFRegressor().fit(iter([(case.X[:900], case.F[:900]), (case.X[900:], case.F[900:])]))
    same(found, case)
    assert NRFRegressor(degree=3).fit(iter([rec, rec])).n_samples_ > 3000
