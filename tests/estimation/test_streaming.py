"""Fits that never hold all samples: the same answer as in memory, whatever the chunks, and after a kill."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import chains
import numpy as np
import pandas as pd
import pytest
import tqdm.auto

from pysindy_nrf import ChainModel, NRFRegressor, Record, laws, simulate
from pysindy_nrf.estimation.streaming import Chunk, accumulator, fit_streamed, sources
from pysindy_nrf.estimation.streaming.accumulator import Accumulator
from pysindy_nrf.exceptions import ChainError, ChannelError, FileFormatError, NRFError
from pysindy_nrf.regression.chain_solve import groups_of
from pysindy_nrf.regression.gram_pass import total_gram
from pysindy_nrf.regression.segments import feature_names


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch):
    """Many chunks from few samples."""
    monkeypatch.setattr(sources, "chunk_rows", lambda n_dof: 700)


def noisy(case: chains.Case, share: float = 0.01, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return tuple(x + share * x.std(axis=0) * rng.standard_normal(x.shape) for x in (case.X, case.F))


@pytest.fixture(scope="module")
def data():
    return noisy(chains.duffing(3, [1, 2, 3], seed=4, n_samples=6000))


@pytest.fixture(scope="module")
def in_memory(data):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return NRFRegressor().fit(*data)


def table(X, F, **more):
    n = F.shape[1]
    frame = pd.DataFrame(X, columns=feature_names(n)).assign(**{f"F{j + 1}": F[:, j] for j in range(n)})
    return frame.assign(**more)


def same(model, reference, tolerance=1e-12):
    assert chains.worst(model.masses_, reference.masses_) < tolerance
    for site, law in reference.restoring_forces_.items():
        found = model.restoring_forces_[site].coefficients
        scale = np.abs(law.coefficients).max()
        assert np.allclose(found / scale, law.coefficients / scale, atol=10 * tolerance, rtol=tolerance)
    assert np.allclose(model.errors_["error"], reference.errors_["error"], rtol=1e-8)
    assert model.n_samples_ == reference.n_samples_


@pytest.fixture(params=["npy", "npy float32", "parquet", "h5 matrices", "h5 columns", "frames", "pairs", "files"])
def streamed(request, data, tmp_path):
    """(X, F) as a user would pass them, by every way in."""
    X, F = data
    kind = request.param
    if kind.startswith("npy"):
        kept = np.float32 if kind.endswith("32") else np.float64
        np.save(tmp_path / "X.npy", X.astype(kept))
        np.save(tmp_path / "F.npy", F.astype(kept))
        return tmp_path / "X.npy", str(tmp_path / "F.npy")
    if kind == "parquet":
        pytest.importorskip("pyarrow")
        table(X, F, note=1.0).to_parquet(tmp_path / "test.parquet", row_group_size=450)
        return tmp_path / "test.parquet", None
    if kind.startswith("h5"):
        h5py = pytest.importorskip("h5py")
        with h5py.File(tmp_path / "test.h5", "w") as file:
            if kind.endswith("matrices"):
                file["X"], file["F"] = X, F
            else:
                for name, column in table(X, F).items():
                    file[name] = column.to_numpy()
        return tmp_path / "test.h5", None
    if kind == "frames":
        whole = table(X, F)
        return (whole.iloc[i : i + 613] for i in range(0, len(whole), 613)), None
    if kind == "pairs":
        return ((X[i : i + 613], F[i : i + 613]) for i in range(0, len(X), 613)), None
    for i in range(3):
        np.save(tmp_path / f"X{i}.npy", X[2000 * i : 2000 * (i + 1)])
        np.save(tmp_path / f"F{i}.npy", F[2000 * i : 2000 * (i + 1)])
    return [tmp_path / f"X{i}.npy" for i in range(3)], [tmp_path / f"F{i}.npy" for i in range(3)]


@pytest.mark.filterwarnings("ignore")
def test_every_way_in_gives_the_answer_of_the_arrays(streamed, data, in_memory, tmp_path):
    X, F = streamed
    reference = in_memory
    if not hasattr(X, "__next__") and "X.npy" in str(X) and np.load(X, mmap_mode="r").dtype == np.float32:
        reference = NRFRegressor().fit(*(x.astype(np.float32).astype(float) for x in data))
    model = NRFRegressor().fit(X, F)
    same(model, reference, 1e-11)
    assert not list(tmp_path.glob(".*")), "a fit that is done leaves no state behind"
    # what the estimator offers after a fit, it offers after this one
    assert model.predict(data[0][:50]).shape == (50, 3)
    widths = [(m.confidence_intervals()["upper"] - m.confidence_intervals()["lower"])[:3] for m in (model, reference)]
    assert np.allclose(*widths, rtol=0.5)
    assert list(model.missing_terms_.index) == list(reference.missing_terms_.index)
    region, truth = (m.model_.visited["storey 2"] for m in (model, reference))
    assert region.low == pytest.approx(truth.low) and region.high == pytest.approx(truth.high)


@pytest.mark.filterwarnings("ignore")
def test_digits_that_squaring_would_lose_come_back_in_a_second_pass(tmp_path):
    """Noise-free data at rms ratios that a Gram matrix alone cannot hold."""
    case = chains.duffing(3, [1, 2, 3], seed=4, n_samples=6000)
    np.save(tmp_path / "X.npy", case.X)
    np.save(tmp_path / "F.npy", case.F)
    X, F = tmp_path / "X.npy", tmp_path / "F.npy"
    assert chains.worst(NRFRegressor(degree=5).fit(X, F).masses_, case.m) < 1e-9
    once = ((case.X[i : i + 700], case.F[i : i + 700]) for i in range(0, 6000, 700))
    assert chains.worst(NRFRegressor(degree=5).fit(once).masses_, case.m) < 1e-9


@pytest.mark.filterwarnings("ignore")
def test_a_base_that_moves_is_solved_from_the_top_down():
    case = chains.duffing(3, [], seed=5, n_samples=5000, ag=chains.band_limited(5000, 1e-3, np.random.default_rng(1), 2.0))
    known = dict(enumerate(case.m, 1))
    model = NRFRegressor(known_masses=known).fit(Chunk(case.X[i : i + 900], None) for i in range(0, 5000, 900))
    for i in (1, 2, 3):
        assert model.restoring_forces_[i].coefficients["s"] == pytest.approx(case.k[i - 1], rel=1e-7)


@pytest.mark.filterwarnings("ignore")
def test_partial_fit_adds_records_and_a_roving_hammer_reaches_every_mass():
    """Each record forces one DOF: only all of them together are complete."""
    cases = chains.each_single(3, seed=3)
    m, c, k, k3 = cases[0].m, cases[0].c, cases[0].k, cases[0].k3
    cases = [chains.duffing(3, [j], seed=j, given=(m, c, k, k3)) for j in (1, 2, 3)]
    model = NRFRegressor()
    model.partial_fit(cases[2].X, cases[2].F)
    assert model.walk_.strategy == "sequential"
    for case in cases[:2]:
        model = pickle.loads(pickle.dumps(model)).partial_fit(case.X, case.F)
    assert model.walk_.strategy == "complete"
    assert chains.worst(model.masses_, m) < 1e-9
    pooled = NRFRegressor().fit(np.vstack([c.X for c in cases]), np.vstack([c.F for c in cases]), record=np.repeat([3, 1, 2], 3000))
    assert chains.worst(model.masses_, pooled.masses_) < 1e-9 and model.n_samples_ == 9000
    with pytest.raises(NRFError, match="settings"):
        model.set_params(degree=2).partial_fit(cases[0].X, cases[0].F)
    assert model.fit(cases[2].X, cases[2].F).n_samples_ == 3000  # fit begins anew


@pytest.mark.filterwarnings("ignore")
def test_partial_fit_takes_records_and_refuses_another_chain(chain2, chain4):
    records = [
        Record(force=chain2.F[part], acceleration=chain2.absolute[part, :2], velocity=chain2.absolute[part, 2:4],
               displacement=chain2.absolute[part, 4:], fs=1000.0, name=str(i))
        for i, part in enumerate((slice(0, 1000), slice(1000, 2000)))
    ]  # fmt: skip
    one = NRFRegressor().fit(records)
    two = NRFRegressor().partial_fit(records[0]).partial_fit([records[1]])
    same(two, one, 1e-8)
    with pytest.raises(ChannelError, match="12 columns.*6 are needed"):
        two.partial_fit(chain4.X, chain4.F)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("timed", ["dt", "t", "datetime"])
def test_a_law_that_remembers_goes_on_from_chunk_to_chunk(timed, tmp_path):
    """A Dahl element and a relaxing one: a state reset at each of nine chunks would miss their coefficients."""
    truth = ChainModel(
        [10.0, 12.0],
        {
            "storey 1": (laws.LinearElastic(9e4), laws.LinearViscous(80.0), laws.Dahl(sigma=900.0, Fd=60.0)),
            "storey 2": (laws.LinearElastic(7e4), laws.MaxwellBranch(tau=0.3, k=2e4)),
        },
    )
    rng = np.random.default_rng(3)
    F = np.column_stack([chains.band_limited(6000, 1e-3, rng, 200.0) for _ in range(2)])
    X, F = simulate(truth, F, 1e-3).to_features(smooth=False)
    own = {
        "storey 1": [laws.LinearElastic(), laws.LinearViscous(), laws.Dahl(sigma=900.0)],
        "storey 2": [laws.LinearElastic(), laws.MaxwellBranch(tau=0.3)],
    }
    t = 5.0 + np.arange(6000) / 1000
    whole = NRFRegressor(laws=own, dt=1e-3).fit(X.to_numpy(), F.to_numpy())
    frame = table(X.to_numpy(), F.to_numpy())
    if timed == "t":
        frame["t"] = t
    elif timed == "datetime":
        frame.index = pd.Timestamp("2024-05-01") + pd.to_timedelta(np.round(t * 1e9), unit="ns")
    model = NRFRegressor(laws=own, dt=1e-3 if timed == "dt" else None)
    model.fit(frame.iloc[i : i + 700] for i in range(0, 6000, 700))
    tolerance = 1e-6 if timed == "datetime" else 1e-9
    same(model, whole, tolerance)
    assert model.restoring_forces_[1].coefficients["Z"] == pytest.approx(60.0, rel=1e-3)
    assert model.restoring_forces_[2].coefficients.iloc[-1] == pytest.approx(2e4, rel=1e-3)


@pytest.mark.filterwarnings("ignore")
def test_nan_edges_of_a_record_are_masked_and_holes_are_refused(data, in_memory):
    X, F = (np.array(x) for x in data)

    def fit(X, F, size=500, **ids):
        frames = table(X, F, **ids)
        return NRFRegressor().fit(frames.iloc[i : i + size] for i in range(0, len(X), size))

    X[:1200, 2] = np.nan  # more than two whole chunks
    F[-70:] = np.nan
    model = fit(X, F)
    assert model.n_samples_ == 6000 - 1270
    same(model, NRFRegressor().fit(X, F), 1e-11)
    X[3000:3500] = np.nan  # a chunk that is empty in the middle of a record
    with pytest.raises(ChannelError, match="NaN about row 3.00, between finite rows"):
        fit(X, F)
    split = fit(X, F, record=np.where(np.arange(6000) < 3200, "before", "after"))
    assert split.n_samples_ == 6000 - 1270 - 500


@pytest.mark.filterwarnings("ignore")
def test_an_unknown_force_may_differ_between_records_but_not_within_one(data):
    X, F = (np.array(x) for x in data)
    F[3000:, 1] = np.nan
    ids = np.repeat(["a", "b"], 3000)
    frames = [table(X, F, record=ids).iloc[i : i + 500] for i in range(0, 6000, 500)]
    model = NRFRegressor().fit(iter(frames))
    same(model, NRFRegressor().fit(X, F, record=ids), 1e-11)
    assert list(model.unknown_forces_.columns) == ["F2"]
    with pytest.raises(ChannelError, match="F2 of record"):
        NRFRegressor().fit(frame.drop(columns="record") for frame in frames)


def test_what_cannot_be_read_in_pieces_says_so(tmp_path, data):
    X, F = data
    np.save(tmp_path / "X.npy", X)
    np.save(tmp_path / "F.npy", F[:-1])
    with pytest.raises(ChannelError, match="F has 5999 samples, X has 6000"):
        NRFRegressor().fit(tmp_path / "X.npy", tmp_path / "F.npy")
    with pytest.raises(FileFormatError, match="does not exist"):
        NRFRegressor().fit(tmp_path / "none.parquet")
    with pytest.raises(FileFormatError, match="chunksize"):
        (tmp_path / "x.csv").write_text("a1,v1,s1\n")
        NRFRegressor().fit(tmp_path / "x.csv")
    with pytest.raises(ChannelError, match="lacks the column s3"):
        NRFRegressor().fit(iter([table(X, F).drop(columns=["s3"])]))
    with pytest.raises(ChannelError, match="lacks the column F2"):
        NRFRegressor().fit(iter([table(X, F).drop(columns=["F2"])]))
    with pytest.raises(ChannelError, match="samples"):
        NRFRegressor().fit(iter([]))
    with pytest.raises(ChainError, match="band="):
        NRFRegressor(band=(1, 50), dt=1e-3).fit(iter([table(X, F)]))
    with pytest.raises(ChainError, match="estimation='iv'"):
        NRFRegressor(estimation="iv").fit(iter([table(X, F)]))
    with pytest.raises(ChainError, match="no value for sigma"):
        NRFRegressor(laws={"storey 1": laws.Dahl()}, dt=1e-3).fit(iter([table(X, F)]))
    pickled = tmp_path / "P.npy"
    np.save(pickled, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match="cannot be read"):
        NRFRegressor().fit(pickled)


WORKER = """
import sys, time, numpy as np
from pysindy_nrf import NRFRegressor
from pysindy_nrf.estimation.streaming import accumulator, dispatch, sources
sources.chunk_rows = lambda n: 700
add = accumulator.Accumulator.add
def slow(self, chunk, number):
    print(number, flush=True)
    time.sleep(0.02)
    add(self, chunk, number)
accumulator.Accumulator.add = slow
model = dispatch.fit_streamed(NRFRegressor(degree=int(sys.argv[3])), sys.argv[1], sys.argv[2], save_every=0.0)
np.save(sys.argv[4], model.masses_)
"""


def work(folder: Path, degree: int, stop_after: int | None = None, how=signal.SIGKILL) -> list[int]:
    """Run a fit in another process, stop it after some chunks; the numbers of the chunks it read."""
    run = subprocess.Popen(
        [sys.executable, "-c", WORKER, *map(str, (folder / "X.npy", folder / "F.npy", degree, folder / "masses.npy"))],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    seen = []
    for line in run.stdout:
        seen.append(int(line))
        if len(seen) == stop_after:
            run.send_signal(how)
    run.wait(60)
    assert stop_after is not None or run.returncode == 0, run.stderr.read()
    return seen


def test_a_killed_fit_goes_on_and_gives_the_same_answer(tmp_path):
    """Killed in the first pass (kill -9), stopped in the second one (Ctrl-C)."""
    case = chains.duffing(2, [1, 2], seed=6, n_samples=4000)  # without noise, and degree 5: two passes
    np.save(tmp_path / "X.npy", case.X)
    np.save(tmp_path / "F.npy", case.F)
    assert work(tmp_path, 5) == [*range(6), *range(6)]
    straight = np.load(tmp_path / "masses.npy")
    (tmp_path / "masses.npy").unlink()
    first = work(tmp_path, 5, stop_after=4)
    assert not (tmp_path / "masses.npy").exists() and len(list(tmp_path.glob(".*"))) == 1
    second = work(tmp_path, 5, stop_after=6 - first[-1] + 3, how=signal.SIGINT)
    assert second[0] >= first[-1] - 1 and second[-1] < 5, "goes on where it was, and is stopped in the second pass"
    rest = work(tmp_path, 5)
    assert rest[0] >= second[-1] - 1 and rest[-1] == 5 and len(rest) < 6
    assert np.allclose(np.load(tmp_path / "masses.npy"), straight, rtol=1e-12, atol=0)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.filterwarnings("ignore")
def test_a_state_of_other_data_or_settings_is_not_taken(tmp_path, data, monkeypatch):
    X, F = data
    for name, values in {"X": X, "F": F}.items():
        np.save(tmp_path / f"{name}.npy", values)
    state = tmp_path / "my.state"
    plain = Accumulator.add

    def stop(self, chunk, number):
        if number == 4:
            raise KeyboardInterrupt
        plain(self, chunk, number)

    monkeypatch.setattr(Accumulator, "add", stop)
    with pytest.raises(KeyboardInterrupt) as caught:
        NRFRegressor().fit(tmp_path / "X.npy", tmp_path / "F.npy", state=state)
    assert "my.state" in caught.value.__notes__[0] and state.exists()
    monkeypatch.setattr(Accumulator, "add", plain)
    other = NRFRegressor(degree=2).fit(tmp_path / "X.npy", tmp_path / "F.npy", state=state)
    assert other.n_samples_ == 6000
    state.write_bytes(b"not a state")
    with pytest.raises(FileFormatError, match="my.state is not the state"):
        NRFRegressor().fit(tmp_path / "X.npy", tmp_path / "F.npy", state=state)
    assert state.read_bytes() == b"not a state"  # it may be a file of the user's
    with pytest.raises(ChannelError, match="cannot be read again"):
        NRFRegressor().fit(iter([table(X, F)]), state=state)


@pytest.mark.filterwarnings("ignore")
def test_ctrl_c_without_a_state_promises_none(data, monkeypatch):
    """An iterator cannot be resumed: nothing is said of a file with what was done."""
    X, F = data
    plain = Accumulator.add

    def stop(self, chunk, number):
        if number == 1:
            raise KeyboardInterrupt
        plain(self, chunk, number)

    monkeypatch.setattr(Accumulator, "add", stop)
    with pytest.raises(KeyboardInterrupt) as caught:
        NRFRegressor().fit(iter([table(X[:3000], F[:3000]), table(X[3000:], F[3000:])]))
    assert not getattr(caught.value, "__notes__", [])


def test_a_list_of_iterators_is_refused_with_the_cure(data):
    X, F = data
    with pytest.raises(ChannelError, match="holds something that is no file.*one iterator"):
        NRFRegressor().fit([iter([table(X, F)]), iter([table(X, F)])])


@pytest.mark.filterwarnings("ignore")
def test_many_chunks_leave_few_blocks_and_the_same_sum(data, in_memory, monkeypatch):
    monkeypatch.setattr(accumulator, "N_BLOCKS", 5)
    monkeypatch.setattr(accumulator, "N_WINDOWS", 9)
    X, F = data
    acc = Accumulator(NRFRegressor(), n_samples=6000)
    acc.block_rows = 40
    for i in range(60):
        acc.add(Chunk(X[100 * i : 100 * (i + 1)], F[100 * i : 100 * (i + 1)], first=i == 0), i)
    acc.close()
    assert len(acc.blocks) <= 11 and len(acc.windows) <= 9 and len(acc.runs) == 1
    assert sum(b.grams.n_samples for b in acc.blocks) == 6000
    direct = NRFRegressor().fit(X, F)
    whole, layout, data = acc.grams().sum(), direct.problem_.layout, direct.model_.segments(X, F)
    once = total_gram(layout, groups_of(layout, direct.walk_), data.segments[0].blocks(layout))
    for dofs, gram in once.matrices.items():
        size = np.sqrt(np.diag(gram))
        assert np.allclose((whole.matrices[dofs] - gram) / np.outer(size, size), 0, atol=1e-13)


MEMORY = """
import resource, sys, threading, time
from pathlib import Path
import numpy as np
from pysindy_nrf import NRFRegressor

def anonymous():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024

NRFRegressor(degree=2).fit(np.random.default_rng(0).normal(size=(5000, 6)), np.random.default_rng(1).normal(size=(5000, 2)))
start, most, on = anonymous(), [0.0], [True]
def watch():
    while on[0]:
        most[0] = max(most[0], anonymous()); time.sleep(0.005)
watcher = threading.Thread(target=watch); watcher.start()
model = NRFRegressor(degree=2).fit(sys.argv[1], sys.argv[2])
on[0] = False; watcher.join()
print(most[0] - start)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="RssAnon is read from /proc")
def test_memory_does_not_grow_with_the_file(tmp_path):
    """A file of 200 MB costs no more anonymous memory than a few chunks of it."""
    n, rows = 2, 3_000_000
    X = np.lib.format.open_memmap(tmp_path / "X.npy", mode="w+", dtype=np.float64, shape=(rows, 3 * n))
    F = np.lib.format.open_memmap(tmp_path / "F.npy", mode="w+", dtype=np.float64, shape=(rows, n))
    rng = np.random.default_rng(0)
    piece = rng.standard_normal((100_000, 3 * n))
    for at in range(0, rows, len(piece)):
        X[at : at + len(piece)] = piece
        force = 5 * piece[:, :n] + piece[:, n : 2 * n] + 30 * piece[:, 2 * n :]
        force[:, 0] -= piece[:, n + 1] + 30 * piece[:, 2 * n + 1]
        F[at : at + len(piece)] = force + 0.01 * rng.standard_normal((len(piece), n))
    del X, F
    run = subprocess.run(
        [sys.executable, "-c", MEMORY, str(tmp_path / "X.npy"), str(tmp_path / "F.npy")],
        capture_output=True, text=True, check=True, env={**os.environ, "PYTHONWARNINGS": "ignore"},
    )  # fmt: skip
    assert float(run.stdout) < 120, f"{run.stdout} MB"


def test_a_progress_bar_tells_the_rate(data, tmp_path, capsys, monkeypatch):
    shown = {}

    class Bar(tqdm.auto.tqdm):
        def close(self):
            shown.update(self.format_dict)
            super().close()

    monkeypatch.setattr(tqdm.auto, "tqdm", Bar)
    np.save(tmp_path / "X.npy", data[0])
    np.save(tmp_path / "F.npy", data[1])
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit_streamed(NRFRegressor(), tmp_path / "X.npy", tmp_path / "F.npy", progress=True)
    assert shown["n"] == shown["total"] == 6000 and shown["unit"] == "sample"
    assert 0 < shown["elapsed"] <= time.perf_counter() - began
