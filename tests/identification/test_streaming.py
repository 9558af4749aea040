"""Fits of data in chunks: the same answer as in memory for every source and chunk size,
and after an interruption.
"""

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path

import chains
import numpy as np
import pandas as pd
import pytest
from chains import same, table

from pysindy_nrf import ChainModel, NRFRegressor, laws, simulate
from pysindy_nrf.exceptions import (
    ChainError,
    ChannelError,
    DataQualityWarning,
    ExcitationError,
    FileFormatError,
    NRFError,
)
from pysindy_nrf.identification.constraints import TotalMass
from pysindy_nrf.identification.streaming import Chunk, fit_streamed, open_source
from pysindy_nrf.records.dataset import feature_names

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
SIZE = 700  # samples in a chunk


def fit(X, F=None, model=None, **options):
    return fit_streamed(model or NRFRegressor(), X, F, chunk_samples=SIZE, **options)


def save(folder, X, F):
    np.save(folder / "X.npy", X)
    np.save(folder / "F.npy", F)
    return folder / "X.npy", folder / "F.npy"


@pytest.fixture(scope="module")
def exact():
    """Noise-free data of two storeys."""
    return chains.duffing(2, [1, 2], seed=6, n_samples=2000)


@pytest.fixture(scope="module")
def intervals(in_memory):
    return in_memory.confidence_intervals()


@pytest.fixture(
    params=[
        "npy",
        "npy float32",
        "parquet",
        "h5 matrices",
        "h5 columns",
        "frames",
        "pairs",
        "files",
    ]
)
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
    return [tmp_path / f"X{i}.npy" for i in range(3)], [
        tmp_path / f"F{i}.npy" for i in range(3)
    ]


def test_every_way_in_gives_the_answer_of_the_arrays(
    streamed, data, in_memory, intervals, tmp_path
):
    X, F = streamed
    reference = in_memory
    if (
        not hasattr(X, "__next__")
        and "X.npy" in str(X)
        and np.load(X, mmap_mode="r").dtype == np.float32
    ):
        reference = NRFRegressor().fit(
            *(x.astype(np.float32).astype(float) for x in data)
        )
    model = fit(X, F)
    same(model, reference, 1e-11)
    assert not list(tmp_path.glob(".*")), "a fit that is done leaves no state behind"
    assert model.predict(data[0][:50]).shape == (50, 3)
    found, expected = model.confidence_intervals(), intervals
    assert np.allclose(
        (found["upper"] - found["lower"])[:3],
        (expected["upper"] - expected["lower"])[:3],
        rtol=0.5,
    )
    assert list(model.missing_terms_.index) == list(reference.missing_terms_.index)
    region, truth = (m.model_.visited["storey 2"] for m in (model, reference))
    assert region.low == pytest.approx(truth.low) and region.high == pytest.approx(
        truth.high
    )


def test_digits_that_squaring_would_lose_come_back_in_a_second_pass(tmp_path):
    """Noise-free data at rms ratios that a Gram matrix alone cannot hold."""
    case = chains.duffing(3, [1, 2, 3], seed=4, n_samples=6000)
    assert (
        chains.worst(
            fit(*save(tmp_path, case.X, case.F), NRFRegressor(degree=5)).masses_, case.m
        )
        < 1e-9
    )
    once = ((case.X[i : i + 700], case.F[i : i + 700]) for i in range(0, 6000, 700))
    assert chains.worst(NRFRegressor(degree=5).fit(once).masses_, case.m) < 1e-9


def test_a_base_that_moves_is_solved_from_the_top_down():
    case = chains.duffing(
        3,
        [],
        seed=5,
        n_samples=5000,
        ag=chains.band_limited(5000, 1e-3, np.random.default_rng(1), 2.0),
    )
    known = dict(enumerate(case.m, 1))
    model = NRFRegressor(known_masses=known).fit(
        Chunk(case.X[i : i + 900], None) for i in range(0, 5000, 900)
    )
    for i in (1, 2, 3):
        assert model.restoring_forces_[i].coefficients["s"] == pytest.approx(
            case.k[i - 1], rel=1e-7
        )


def test_partial_fit_adds_records_and_a_roving_hammer_reaches_every_mass():
    """Each record forces one DOF: only all of them together are complete."""
    cases = chains.each_single(3, seed=3)
    m, c, k, k3 = cases[0].m, cases[0].c, cases[0].k, cases[0].k3
    cases = [chains.duffing(3, [j], seed=j, given=(m, c, k, k3)) for j in (1, 2, 3)]
    model = NRFRegressor()
    model.partial_fit(cases[2].X, cases[2].F)
    assert model.solve_order_.strategy == "sequential"
    for case in cases[:2]:
        model = pickle.loads(pickle.dumps(model)).partial_fit(case.X, case.F)
    assert model.solve_order_.strategy == "joint"
    assert chains.worst(model.masses_, m) < 1e-9
    pooled = NRFRegressor().fit(
        np.vstack([c.X for c in cases]),
        np.vstack([c.F for c in cases]),
        record=np.repeat([3, 1, 2], 3000),
    )
    assert (
        chains.worst(model.masses_, pooled.masses_) < 1e-9 and model.n_samples_ == 9000
    )
    with pytest.raises(NRFError, match="settings"):
        model.set_params(degree=2).partial_fit(cases[0].X, cases[0].F)
    assert model.fit(cases[2].X, cases[2].F).n_samples_ == 3000  # fit begins anew


def test_partial_fit_takes_records_and_refuses_another_chain(chain2, chain4):
    records = [
        chain2.record().rows(part).replace(name=str(part))
        for part in (slice(0, 1000), slice(1000, 2000))
    ]
    one = NRFRegressor().fit(records)
    two = NRFRegressor().partial_fit(records[0]).partial_fit([records[1]])
    same(two, one, 1e-8)
    with pytest.raises(ChannelError, match="12 columns.*6 are needed"):
        two.partial_fit(chain4.X, chain4.F)


@pytest.fixture(scope="module")
def remembering():
    """Data of a Dahl element and a relaxing one, their laws, and the model of all
    samples at once.
    """
    truth = ChainModel(
        [10.0, 12.0],
        {
            "storey 1": (
                laws.LinearElastic(9e4),
                laws.LinearViscous(80.0),
                laws.Dahl(sigma=900.0, Fd=60.0),
            ),
            "storey 2": (laws.LinearElastic(7e4), laws.MaxwellBranch(tau=0.3, k=2e4)),
        },
    )
    rng = np.random.default_rng(3)
    F = np.column_stack([chains.band_limited(6000, 1e-3, rng, 200.0) for _ in range(2)])
    X, F = (
        table.to_numpy() for table in simulate(truth, F, 1e-3).to_features(smooth=False)
    )
    own = {
        "storey 1": [
            laws.LinearElastic(),
            laws.LinearViscous(),
            laws.Dahl(sigma=900.0),
        ],
        "storey 2": [laws.LinearElastic(), laws.MaxwellBranch(tau=0.3)],
    }
    return X, F, own, NRFRegressor(laws=own, dt=1e-3).fit(X, F)


@pytest.mark.parametrize("timed", ["dt", "t", "datetime"])
def test_a_law_that_remembers_goes_on_from_chunk_to_chunk(timed, remembering):
    """A state reset at each of nine chunks would miss the coefficients."""
    X, F, own, whole = remembering
    t = 5.0 + np.arange(6000) / 1000
    frame = table(X, F)
    if timed == "t":
        frame["t"] = t
    elif timed == "datetime":
        frame.index = pd.Timestamp("2024-05-01") + pd.to_timedelta(
            np.round(t * 1e9), unit="ns"
        )
    model = NRFRegressor(laws=own, dt=1e-3 if timed == "dt" else None)
    model.fit(frame.iloc[i : i + 700] for i in range(0, 6000, 700))
    tolerance = 1e-6 if timed == "datetime" else 1e-9
    same(model, whole, tolerance)
    assert model.restoring_forces_[1].coefficients["Z"] == pytest.approx(60.0, rel=1e-3)
    assert model.restoring_forces_[2].coefficients.iloc[-1] == pytest.approx(
        2e4, rel=1e-3
    )


def test_nan_edges_of_a_record_are_masked_and_holes_are_refused(data, in_memory):
    X, F = (np.array(x) for x in data)

    def fit(X, F, size=500, **ids):
        frames = table(X, F, **ids)
        return NRFRegressor().fit(
            frames.iloc[i : i + size] for i in range(0, len(X), size)
        )

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


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (
            lambda t, p: (p / "X.npy", p / "short.npy"),
            ChannelError,
            "F has 1999 samples, X has 2000",
        ),
        (lambda t, p: (p / "none.parquet",), FileFormatError, "does not exist"),
        (lambda t, p: (p / "F.csv",), FileFormatError, "chunksize"),
        (lambda t, p: (p / "object.npy",), FileFormatError, "cannot be read"),
        (
            lambda t, p: (p / "X.npy", p / "F.csv"),
            FileFormatError,
            "F=.*F.csv' is not a .npy file",
        ),
        (lambda t, p: (p / "F.npy",), ChannelError, r"X has the shape \(2000, 2\)"),
        (lambda t, p: (p / "t.npy",), ChannelError, r"X has the shape \(2000,\)"),
        (
            lambda t, p: ([p / "X.npy", p / "X.npy"], [p / "F.npy"]),
            ChannelError,
            "2 files of X need as many of F",
        ),
        (
            lambda t, p: (p / "a.parquet", np.zeros((2000, 2))),
            ChannelError,
            "F was given beside a table",
        ),
        (
            lambda t, p: (iter([t]), np.zeros((2000, 2))),
            ChannelError,
            "F was given beside an iterator",
        ),
        (
            lambda t, p: ([iter([t]), iter([t])],),
            ChannelError,
            "holds something that is not a file.*one iterator",
        ),
        (lambda t, p: (iter([]),), ChannelError, "no samples"),
        (lambda t, p: (iter([{"a1": 1.0}]),), ChannelError, "The iterator gave dict"),
        (
            lambda t, p: (iter([pd.DataFrame({"x": [1.0]})]),),
            ChannelError,
            "The table has no columns a1, a2",
        ),
        (
            lambda t, p: (iter([t.drop(columns="s2")]),),
            ChannelError,
            "lacks the column s2",
        ),
        (
            lambda t, p: (iter([t.drop(columns="F2")]),),
            ChannelError,
            "lacks the column F2",
        ),
        (lambda t, p: (iter([np.zeros((0, 6))]),), NRFError, "samples"),
        (lambda t, p: (iter([np.full((900, 6), np.nan)]),), NRFError, "NaN|samples"),
        (
            lambda t, p: (iter([t.drop(columns=["F1", "F2"])]),),
            ExcitationError,
            "nothing scales the chain",
        ),
        (
            lambda t, p: (iter([t[:9]]),),
            ChannelError,
            "9 samples are too few for the balance of DOF",
        ),
    ],
)
def test_an_error_names_what_is_wrong_with_a_source(
    exact, tmp_path, given, error, words
):
    save(tmp_path, exact.X, exact.F)
    np.save(tmp_path / "short.npy", exact.F[:-1])
    np.save(tmp_path / "t.npy", np.arange(2000.0))
    np.save(
        tmp_path / "object.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True
    )
    (tmp_path / "F.csv").write_text("F1\n1\n")
    table(exact.X, exact.F).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(error, match=words):
        NRFRegressor().fit(*given(table(exact.X, exact.F), tmp_path))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(band=(1, 50), dt=1e-3), "band="),
        (dict(estimation="iv"), "estimation='iv'"),
        (dict(laws={"storey 1": laws.Dahl()}, dt=1e-3), "no value for sigma"),
    ],
)
def test_settings_that_need_whole_records_are_refused(exact, settings, words):
    with pytest.raises(ChainError, match=words):
        NRFRegressor(**settings).fit(iter([table(exact.X, exact.F)]))


WORKER = """
import signal, sys
import numpy as np
from pysindy_nrf import NRFRegressor
from pysindy_nrf.identification.streaming import fit_streamed

signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent in the background ignores it

class Forces(np.ndarray):
    def __getitem__(self, rows):  # tells which chunk is read, and waits for a word of the parent
        print(rows.start // 700, flush=True)
        sys.stdin.readline()
        return np.asarray(self)[rows]

X, F, degree, out = sys.argv[1:]
model = NRFRegressor(degree=int(degree))
fit_streamed(model, X, np.load(F).view(Forces), save_every=0.0, chunk_samples=700)
np.save(out, model.masses_)
"""


def work(folder: Path, stop_after: int | None = None, how=signal.SIGKILL) -> list[int]:
    """Run a fit of degree 5 in another process, stop it at some chunk; the numbers of
    the chunks it began to read.
    """
    files = folder / "X.npy", folder / "F.npy", 5, folder / "masses.npy"
    run = subprocess.Popen(
        [sys.executable, "-c", WORKER, *map(str, files)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder / "run",
    )
    seen = []
    for line in run.stdout:
        seen.append(int(line))
        if len(seen) == stop_after:
            run.send_signal(how)
            break
        run.stdin.write("go on\n")
        run.stdin.flush()
    _, errors = run.communicate()
    assert stop_after is not None or run.returncode == 0, errors
    return seen


@pytest.mark.slow
def test_a_killed_fit_goes_on_and_gives_the_same_answer(tmp_path):
    """Killed in the first of two passes (kill -9), stopped in the second one
    (Ctrl-C).
    """
    case = chains.duffing(
        2, [1, 2], seed=6, n_samples=4000
    )  # without noise, and degree 5: two passes
    save(tmp_path, case.X, case.F)
    (tmp_path / "run").mkdir()
    assert work(tmp_path) == [*range(6), *range(6)]
    straight = np.load(tmp_path / "masses.npy")
    (tmp_path / "masses.npy").unlink()
    assert work(tmp_path, stop_after=4) == [0, 1, 2, 3]
    assert (
        not (tmp_path / "masses.npy").exists()
        and len(list((tmp_path / "run").iterdir())) == 1
    )
    assert work(tmp_path, stop_after=9, how=signal.SIGINT) == [
        0,
        1,
        2,
        3,
        4,
        5,
        0,
        1,
        2,
    ]  # 0 to 2 are compared first
    assert work(tmp_path) == [0, 1, 2, 3, 4, 5]  # the first pass is not repeated
    assert np.allclose(np.load(tmp_path / "masses.npy"), straight, rtol=1e-12, atol=0)
    assert not list((tmp_path / "run").iterdir()) and not list(tmp_path.glob(".*"))


class Interrupted(np.ndarray):
    """Forces on which Ctrl-C is pressed when sample 1400 is read."""

    def __getitem__(self, rows):
        if isinstance(rows, slice) and rows.start == 1400:
            raise KeyboardInterrupt
        return np.asarray(self)[rows]


def test_a_state_of_other_data_or_settings_is_not_taken(tmp_path, exact):
    X, F = save(tmp_path, exact.X, exact.F)
    state = tmp_path / "my.state"
    with pytest.raises(KeyboardInterrupt) as caught:
        fit(X, exact.F.view(Interrupted), state=state)
    assert "my.state" in caught.value.__notes__[0] and state.exists()
    assert fit(X, F, NRFRegressor(degree=2), state=state).n_samples_ == 2000
    state.write_bytes(b"not a state")
    with pytest.raises(FileFormatError, match="my.state is not the state"):
        fit(X, F, state=state)
    assert state.read_bytes() == b"not a state"  # it may be a file of the user's
    with pytest.raises(ChannelError, match="cannot be read again"):
        fit(iter([table(exact.X, exact.F)]), state=state)


def test_only_a_state_is_removed(tmp_path, exact):
    (tmp_path / "run-2").write_text("mine")
    (tmp_path / "folder").mkdir()
    np.savez(tmp_path / "run.npz", meta=np.arange(9))
    X, F = save(tmp_path, exact.X, exact.F)
    for state in ("run", "folder"):
        assert fit(X, F, state=tmp_path / state, save_every=0.0).n_samples_ == 2000
    with pytest.raises(FileFormatError, match="run.npz is not the state"):
        fit(X, F, state=tmp_path / "run.npz")
    assert {p.name for p in tmp_path.iterdir()} == {
        "X.npy",
        "F.npy",
        "run-2",
        "run.npz",
        "folder",
    }
    assert (
        not list((tmp_path / "folder").iterdir())
        and (tmp_path / "run-2").read_text() == "mine"
    )


CHANGES = {
    "force": lambda X, given: given | {"F": 2 * given["F"]},
    "record": lambda X, given: given | {"record": given["record"][::-1]},
    "time": lambda X, given: given | {"time": 2 * given["time"]},
    "base": (
        lambda X, given: given | {"base_acceleration": 2 * given["base_acceleration"]}
    ),
    "covariates": (
        lambda X, given: (
            given | {"covariates": {"volt": 2 * given["covariates"]["volt"]}}
        )
    ),
    "sign in a file": lambda X, given: given if rewritten(X, -np.load(X)) else None,
    "digit": lambda X, given: given,
}


def rewritten(path, values):
    """Other values of the same shape in a file of the same size and time of change."""
    before = path.stat().st_mtime_ns
    np.save(path, values)
    os.utime(path, ns=(before, before))
    return True


@pytest.mark.parametrize("change", CHANGES)
def test_a_state_is_tied_to_what_was_used(tmp_path, exact, change):
    """Arrays and files of the same shape with other content, and a law that differs in
    its last digit, begin anew.
    """
    X = save(tmp_path, exact.X, exact.F)[0]
    first = {
        "F": exact.F.copy(),
        "record": np.repeat(["a", "b"], 1000),
        "time": np.arange(2000) * 1e-3,
    }
    first |= {
        "base_acceleration": exact.X[:, 0].copy(),
        "covariates": {"volt": 1 + exact.X[:, 2] ** 2},
    }

    def model(tau):
        branch = [
            laws.LinearElastic(),
            laws.LinearViscous(),
            laws.MaxwellBranch(tau=tau),
        ]
        friction = laws.CovariateFriction("volt")
        return NRFRegressor(
            laws={"storey 1": [laws.PowerSeries(3), friction], "storey 2": branch}
        )

    with pytest.raises(KeyboardInterrupt):
        fit(
            X,
            model=model(0.1),
            **(first | {"F": first["F"].view(Interrupted)}),
            state=tmp_path / "s",
        )
    second, tau = (
        CHANGES[change](X, first),
        (np.nextafter(0.1, 1.0) if change == "digit" else 0.1),
    )
    anew = fit(X, model=model(tau), **second)
    resumed = fit(X, model=model(tau), **second, state=tmp_path / "s")
    np.testing.assert_allclose(resumed.masses_, anew.masses_, rtol=1e-12)


def test_a_state_that_cannot_be_written_costs_no_fit(exact, tmp_path):
    """A file is where the folder of the state should be: a warning, and the answer."""
    (tmp_path / "taken").write_text("")
    with pytest.warns(DataQualityWarning, match="cannot be written .* the fit goes on"):
        model = fit(
            *save(tmp_path, exact.X, exact.F),
            state=tmp_path / "taken" / "s",
            save_every=0.0,
        )
    assert chains.worst(model.masses_, exact.m) < 1e-8


def test_a_state_is_no_pipe_and_its_link_stays(exact, tmp_path):
    X, F = save(tmp_path, exact.X, exact.F)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(NRFError, match="pipe is a device or pipe"):
        fit(X, F, state=tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "state")
    fit(X, F, state=tmp_path / "link", save_every=0.0)
    assert (tmp_path / "link").is_symlink() and not (tmp_path / "state").exists()


def right(model, case):
    assert chains.worst(model.masses_, case.m) < 1e-8
    for i in (1, 2):
        assert model.restoring_forces_[i].coefficients["s"] == pytest.approx(
            case.k[i - 1], rel=1e-7
        )


def test_parquet_row_groups_that_chunks_cut_through(exact, tmp_path):
    """Groups of 300 rows, chunks of 400: every row is seen once, in order."""
    path = tmp_path / "a.parquet"
    table(exact.X, exact.F).to_parquet(path, row_group_size=300)
    right(fit_streamed(NRFRegressor(), path, chunk_samples=400), exact)
    chunks = list(open_source(path, chunk_samples=400).chunks())
    np.testing.assert_array_equal(np.vstack([chunk.X for chunk in chunks]), exact.X)
    assert [chunk.first for chunk in chunks] == [True, *[False] * (len(chunks) - 1)]
    even = tmp_path / "even.parquet"
    table(exact.X, exact.F).to_parquet(even, row_group_size=1000)
    assert [
        chunk.n_samples for chunk in open_source(even, chunk_samples=400).chunks()
    ] == [400] * 5


def test_a_fit_by_path_reads_no_other_file(exact, tmp_path):
    """Neither through a link, nor from values that are kept elsewhere, nor through a
    virtual data set.
    """
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["F"] = exact.F
    exact.F.tofile(tmp_path / "secret.bin")
    virtual = h5py.VirtualLayout(exact.F.shape, "f8")
    virtual[:] = h5py.VirtualSource(
        str(tmp_path / "other.h5"), "F", shape=exact.F.shape
    )
    for name in ("link", "external", "virtual"):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file["X"] = exact.X
            if name == "link":
                file["F"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "F")
            elif name == "external":
                file.create_dataset(
                    "F",
                    exact.F.shape,
                    "f8",
                    external=[(str(tmp_path / "secret.bin"), 0, exact.F.nbytes)],
                )
            else:
                file.create_virtual_dataset("F", virtual)
        says = "No force is measured" if name == "link" else "'F' lies in another file"
        with pytest.raises(NRFError, match=says):
            fit(tmp_path / f"{name}.h5")


def test_a_file_that_is_damaged_in_the_middle_is_named_while_it_is_read(
    exact, tmp_path
):
    """Header and footer of the file are whole, a page of samples is not."""
    path = tmp_path / "a.parquet"
    table(exact.X, exact.F).to_parquet(path, row_group_size=500, compression="snappy")
    raw = bytearray(path.read_bytes())
    middle = len(raw) // 3
    raw[middle : middle + 4000] = bytes(4000)
    path.write_bytes(raw)
    with pytest.raises(FileFormatError, match="a.parquet"):
        fit(path)
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset(
            "X", data=exact.X, chunks=(250, 6), compression="gzip", fletcher32=True
        )
        file.create_dataset("F", data=exact.F, chunks=(250, 2))
    raw = bytearray(path.read_bytes())
    middle = len(raw) // 2
    raw[middle : middle + 3000] = b"\xff" * 3000
    path.write_bytes(raw)
    with pytest.raises(FileFormatError, match="a.h5"):
        fit(path)


def test_time_must_go_on_from_piece_to_piece(exact):
    t = np.arange(2000) * 1e-3
    pieces = [
        table(exact.X[0:1000], exact.F[0:1000], t=t[:1000]),
        table(exact.X[1000:2000], exact.F[1000:2000], t=t[900:1900]),
    ]
    with pytest.raises(
        ChannelError, match="does not increase from one piece to the next"
    ):
        NRFRegressor(
            laws={"storey 1": [laws.PowerSeries(3), laws.HarmonicForce(frequency=1.5)]}
        ).fit(iter(pieces))


def test_a_moving_base_in_absolute_coordinates_comes_from_its_own_columns(exact):
    """x0 and xdot0 beside absolute motions: drift of storey 1 is x1 - x0, as in
    memory.
    """
    t = np.arange(2000) * 1e-3
    x0, xdot0 = 1e-3 * np.sin(9 * t), 9e-3 * np.cos(9 * t)
    x, v = (
        np.cumsum(exact.s, axis=1) + x0[:, None],
        np.cumsum(exact.v, axis=1) + xdot0[:, None],
    )
    names = [*feature_names(2, "absolute"), "F1", "F2"]
    frame = pd.DataFrame(
        dict(zip(names, np.hstack([exact.a, v, x, exact.F]).T))
        | {
            "xdot0": xdot0,
            "x0": x0,
        }
    )
    right(
        NRFRegressor(coordinates="absolute").fit(iter([frame[:700], frame[700:]])),
        exact,
    )


def test_constraints_hold_in_a_fit_by_pieces(exact, tmp_path):
    """A total mass that is 10 % too large is reached exactly, by the constrained
    optimum of the arrays.
    """

    X, F = save(tmp_path, exact.X, exact.F)
    asked = [TotalMass(1.1 * exact.m.sum())]
    pieces = fit(X, F, NRFRegressor(constraints=asked))
    whole = NRFRegressor(constraints=asked).fit(exact.X, exact.F)
    assert pieces.masses_.sum() == pytest.approx(1.1 * exact.m.sum(), rel=1e-9)
    np.testing.assert_allclose(pieces.masses_, whole.masses_, rtol=1e-5)
