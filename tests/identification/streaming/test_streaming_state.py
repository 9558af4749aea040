"""A fit of files that was interrupted goes on, if samples and settings are the same."""

import os
import signal
import subprocess
import sys

import chains
import numpy as np
import pytest
from chains import table

from pysindy_nrf import NRFRegressor, laws
from pysindy_nrf.exceptions import (
    ChannelError,
    DataQualityWarning,
    FileFormatError,
    NRFError,
)
from pysindy_nrf.identification.streaming import fit as passes

pytestmark = [
    pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning"),
    pytest.mark.usefixtures("small_chunks"),
]

WORKER = """
import signal, sys
import numpy as np
from pysindy_nrf import NRFRegressor
from pysindy_nrf.identification.streaming import fit, sources

# a parent in the background ignores it
signal.signal(signal.SIGINT, signal.default_int_handler)
fit.SECONDS_BETWEEN_STATES = 0.0
sources.SAMPLES_IN_CHUNK = (700, 700)

class Forces(np.ndarray):
    def __getitem__(self, rows):
        # names the chunk that is read, and waits for a word of the parent
        print(rows.start // 700, flush=True)
        sys.stdin.readline()
        return np.asarray(self)[rows]

X, F, degree, out = sys.argv[1:]
model = NRFRegressor(degree=int(degree)).fit(X, np.load(F).view(Forces))
np.save(out, model.masses_)
"""


@pytest.fixture
def states_at_once(monkeypatch):
    """A state is written after every chunk."""
    monkeypatch.setattr(passes, "SECONDS_BETWEEN_STATES", 0.0)


@pytest.fixture
def files(exact, tmp_path):
    np.save(tmp_path / "X.npy", exact.X)
    np.save(tmp_path / "F.npy", exact.F)
    return tmp_path / "X.npy", tmp_path / "F.npy"


class Interrupted(np.ndarray):
    """Forces on which Ctrl-C is pressed when sample 1400 is read."""

    def __getitem__(self, rows):
        if isinstance(rows, slice) and rows.start == 1400:
            raise KeyboardInterrupt
        return np.asarray(self)[rows]


# -- interrupted and resumed ---------------------------------------------------------


def work(folder, stop_after=None, how=signal.SIGKILL):
    """Run a fit of degree 5 in another process, and stop it at some chunk.

    Returns the numbers of the chunks that it began to read.
    """
    arguments = [folder / "X.npy", folder / "F.npy", 5, folder / "masses.npy"]
    process = subprocess.Popen(
        [sys.executable, "-c", WORKER, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder / "run",
    )
    begun = []
    for line in process.stdout:
        begun.append(int(line))
        if len(begun) == stop_after:
            process.send_signal(how)
            break
        process.stdin.write("go on\n")
        process.stdin.flush()
    _, errors = process.communicate()
    if stop_after is None:
        assert process.returncode == 0, errors
    return begun


@pytest.mark.slow
def test_a_killed_fit_goes_on_and_gives_the_same_answer(tmp_path):
    """Killed in the first of two passes, stopped by Ctrl-C in the second one."""
    # without noise and of degree 5, so that there are two passes
    case = chains.duffing(2, [1, 2], seed=6, n_samples=4000)
    np.save(tmp_path / "X.npy", case.X)
    np.save(tmp_path / "F.npy", case.F)
    (tmp_path / "run").mkdir()
    assert work(tmp_path) == [*range(6), *range(6)]
    straight = np.load(tmp_path / "masses.npy")
    (tmp_path / "masses.npy").unlink()

    assert work(tmp_path, stop_after=4) == [0, 1, 2, 3]
    assert not (tmp_path / "masses.npy").exists()
    assert len(list((tmp_path / "run").iterdir())) == 1

    # chunks 0 to 2 are compared first
    compared = [0, 1, 2]
    begun = work(tmp_path, stop_after=9, how=signal.SIGINT)
    assert begun == [*compared, 3, 4, 5, 0, 1, 2]
    assert work(tmp_path) == [0, 1, 2, 3, 4, 5], "the first pass is not repeated"

    resumed = np.load(tmp_path / "masses.npy")
    assert np.allclose(resumed, straight, rtol=1e-12, atol=0)
    assert not list((tmp_path / "run").iterdir())
    assert not list(tmp_path.glob(".*"))


def test_a_state_of_other_settings_is_not_taken(files, exact, tmp_path):
    X, F = files
    state = tmp_path / "my.state"
    with pytest.raises(KeyboardInterrupt) as caught:
        NRFRegressor().fit(X, exact.F.view(Interrupted), state=state)
    assert "my.state" in caught.value.__notes__[0]
    assert state.exists()
    assert NRFRegressor(degree=2).fit(X, F, state=state).n_samples_ == 2000


def test_a_file_that_is_no_state_is_refused_and_kept(files, tmp_path):
    state = tmp_path / "my.state"
    state.write_bytes(b"not a state")
    with pytest.raises(FileFormatError, match="my.state is not the state"):
        NRFRegressor().fit(*files, state=state)
    assert state.read_bytes() == b"not a state"


def test_an_iterator_has_no_state(exact, tmp_path):
    with pytest.raises(ChannelError, match="cannot be read again"):
        NRFRegressor().fit(iter([table(exact.X, exact.F)]), state=tmp_path / "s")


@pytest.mark.usefixtures("states_at_once")
def test_only_a_state_is_removed(files, tmp_path):
    (tmp_path / "run-2").write_text("mine")
    (tmp_path / "folder").mkdir()
    np.savez(tmp_path / "run.npz", facts=np.arange(9))
    for state in ("run", "folder"):
        model = NRFRegressor().fit(*files, state=tmp_path / state)
        assert model.n_samples_ == 2000
    with pytest.raises(FileFormatError, match="run.npz is not the state"):
        NRFRegressor().fit(*files, state=tmp_path / "run.npz")

    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"X.npy", "F.npy", "run-2", "run.npz", "folder"}
    assert not list((tmp_path / "folder").iterdir())
    assert (tmp_path / "run-2").read_text() == "mine"


@pytest.mark.usefixtures("states_at_once")
def test_a_state_that_cannot_be_written_costs_no_fit(files, exact, tmp_path):
    """A file is where the folder of the state should be."""
    (tmp_path / "taken").write_text("")
    with pytest.warns(DataQualityWarning, match="cannot be written .* the fit goes on"):
        model = NRFRegressor().fit(*files, state=tmp_path / "taken" / "s")
    assert chains.worst(model.masses_, exact.m) < 1e-8


def test_a_state_is_no_pipe(files, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(NRFError, match="pipe is a device or pipe"):
        NRFRegressor().fit(*files, state=tmp_path / "pipe")


@pytest.mark.usefixtures("states_at_once")
def test_the_link_to_a_state_stays(files, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "state")
    NRFRegressor().fit(*files, state=tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert not (tmp_path / "state").exists()


# -- a state is tied to what was used ------------------------------------------------


def model_with_branch(tau):
    branch = [
        laws.LinearElastic(),
        laws.LinearViscous(),
        laws.MaxwellBranch(tau=tau),
    ]
    friction = [laws.PowerSeries(3), laws.CovariateFriction("volt")]
    return NRFRegressor(laws={"storey 1": friction, "storey 2": branch})


@pytest.fixture
def beside(exact):
    return {
        "y": exact.F.copy(),
        "record": np.repeat(["a", "b"], 1000),
        "time": np.arange(2000) * 1e-3,
        "base_acceleration": exact.X[:, 0].copy(),
        "covariates": {"volt": 1 + exact.X[:, 2] ** 2},
    }


def with_other_values(beside, name):
    """The same arrays, one of which has other values."""
    value = beside[name]
    if name == "covariates":
        changed = {"volt": 2 * value["volt"]}
    elif name == "record":
        changed = value[::-1]
    else:
        changed = 2 * value
    return beside | {name: changed}


def rewrite(path, values):
    """Write other values of the same shape, at the same time of change."""
    before = path.stat().st_mtime_ns
    np.save(path, values)
    os.utime(path, ns=(before, before))


def interrupt(X, beside, state):
    """Leave the state of a fit that was interrupted."""
    forces = beside["y"].view(Interrupted)
    with pytest.raises(KeyboardInterrupt):
        model_with_branch(0.1).fit(X, **(beside | {"y": forces}), state=state)


def assert_begins_anew(X, beside, state, tau=0.1):
    anew = model_with_branch(tau).fit(X, **beside)
    resumed = model_with_branch(tau).fit(X, **beside, state=state)
    np.testing.assert_allclose(resumed.masses_, anew.masses_, rtol=1e-12)


@pytest.mark.parametrize(
    "name", ["y", "record", "time", "base_acceleration", "covariates"]
)
def test_arrays_with_other_values_begin_anew(files, beside, tmp_path, name):
    interrupt(files[0], beside, tmp_path / "s")
    assert_begins_anew(files[0], with_other_values(beside, name), tmp_path / "s")


def test_a_file_with_other_values_begins_anew(files, beside, tmp_path):
    interrupt(files[0], beside, tmp_path / "s")
    rewrite(files[0], -np.load(files[0]))
    assert_begins_anew(files[0], beside, tmp_path / "s")


def test_a_law_that_differs_in_its_last_digit_begins_anew(files, beside, tmp_path):
    interrupt(files[0], beside, tmp_path / "s")
    assert_begins_anew(files[0], beside, tmp_path / "s", tau=np.nextafter(0.1, 1.0))
