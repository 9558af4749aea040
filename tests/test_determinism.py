"""The same input gives the same answer: on several cores, in another process, from the same seed."""

from __future__ import annotations

import inspect
import json
import os
import pkgutil
import subprocess
import sys
import threading
from importlib import import_module

import chains
import joblib
import numpy as np
import pytest

import pysindy_nrf
from pysindy_nrf import NRFRegressor, excitation, select_order
from pysindy_nrf.common import threads
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.mechanics.chain import Chain
from pysindy_nrf.regression.domains import Extent
from pysindy_nrf.regression.gram_pass import block_grams
from pysindy_nrf.regression.layout import Block, Layout

COLUMNS = 7


@pytest.fixture
def cores(monkeypatch):
    """Pretend that there are so many cores, and that nobody asked for fewer."""

    def set_cores(count: int) -> None:
        for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(joblib, "cpu_count", lambda: count)

    return set_cores


@pytest.mark.parametrize(
    ("omp", "numba", "wanted"),
    [("", "", 8), ("3", "", 3), ("", "2", 2), ("5", "2", 2), ("16", "", 8), ("4,2", "", 4), ("0", "many", 8), ("-1", "", 8)],
)
def test_the_variables_that_workers_set_are_heard(cores, monkeypatch, omp, numba, wanted):
    cores(8)
    monkeypatch.setenv("OMP_NUM_THREADS", omp)
    monkeypatch.setenv("NUMBA_NUM_THREADS", numba)
    assert threads.n_threads() == wanted


def test_results_come_in_order_and_shares_are_read_as_they_are_needed(cores):
    cores(3)
    read, slow = [], threading.Event()

    def shares():
        for i in range(200):
            read.append(i)
            yield i

    def work(i):
        if i == 0:
            slow.wait(5.0)  # the first is done last
        return i * i

    found = threads.in_threads(work, shares())
    threading.Timer(0.2, slow.set).start()
    assert next(found) == 0
    assert len(read) < 20  # not all two hundred wait in memory
    assert list(found) == [i * i for i in range(1, 200)]


def test_two_shares_are_worked_on_at_the_same_time(cores):
    """Each waits for the other: one after the other would never end."""
    cores(2)
    together = threading.Barrier(2, timeout=20.0)
    assert sorted(threads.in_threads(lambda _: together.wait(), range(6))) == [0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize("where", ["shares", "work"])
def test_an_error_ends_the_pass_and_its_threads(cores, where):
    cores(4)
    before = threading.active_count()

    def shares():
        yield from range(50)
        if where == "shares":
            raise KeyboardInterrupt

    def work(i):
        if where == "work" and i == 30:
            raise KeyboardInterrupt
        return i

    with pytest.raises(KeyboardInterrupt):
        list(threads.in_threads(work, shares()))
    assert threading.active_count() == before


def test_a_pass_that_nobody_reads_to_the_end_leaves_no_thread(cores):
    cores(4)
    before = threading.active_count()
    found = threads.in_threads(abs, iter(range(100)))
    next(found)
    found.close()
    assert threading.active_count() == before


def whole_numbers(n_samples: int):
    """Blocks of uneven lengths whose products are exact in a double; the second force is unknown now and then."""
    rng = np.random.default_rng(2)
    terms, a, F = (rng.integers(-9, 10, (k, n_samples)).astype(float) for k in (COLUMNS, 2, 2))
    edges = np.unique(np.r_[0, rng.integers(1, n_samples, 60), n_samples])
    for number, (lo, hi) in enumerate(zip(edges[:-1], edges[1:])):
        force = F[:, lo:hi].copy()
        if number % 7 in (3, 4):
            force[1] = np.nan
        yield Block(terms[:, lo:hi], a[:, lo:hi], force)


def test_every_product_is_exact_whoever_multiplies_it(cores):
    """Blocks dealt out to three sums; samples with an unknown force count for the other balance alone."""
    layout = Layout(Chain(2), {"storey 1": 3, "storey 2": COLUMNS - 3})
    groups = [layout.group((j,)) for j in (1, 2)]
    blocks = list(whole_numbers(9000))
    for count in (1, 2, 5):
        cores(count)
        found = block_grams(layout, groups, ((i % 3, block) for i, block in enumerate(blocks)))
        assert found.n_samples.sum() == 9000
        for group in groups:
            j = group.dofs[0]
            for number in range(3):
                held = [b for b in blocks[number::3] if np.isfinite(b.force[j - 1, 0])]
                A = np.hstack([
                    np.vstack([*(b.terms[layout.slices[s]] for s in group.sites), b.acceleration[j - 1], b.force[j - 1]])
                    for b in held
                ])  # fmt: skip
                assert np.array_equal(found.matrices[j,][number], A @ A.T), (count, j)
                assert found.sizes[j,][number] == A.shape[1]


@pytest.mark.parametrize("forced", [[3], [1, 2, 3]], ids=["sequential", "complete"])
def test_a_fit_has_the_same_bits_on_any_number_of_cores(cores, forced):
    case = chains.duffing(3, forced, seed=4, n_samples=8000)
    X, F = (np.tile(y, (5, 1)) for y in (case.X, case.F))
    F += 0.02 * F.std(axis=0) * np.random.default_rng(0).standard_normal(F.shape)
    found = []
    for count in (1, 2, 3):
        cores(count)
        model = NRFRegressor(degree=3).fit(X, F)
        chosen = select_order(X, F, degrees=range(1, 5))
        found.append((model.masses_, model.model_.to_dict(), chosen.fold_scores.to_numpy()))
    for masses, model, scores in found[1:]:
        np.testing.assert_array_equal(masses, found[0][0])
        np.testing.assert_array_equal(scores, found[0][2])
        assert model == found[0][1]
    np.testing.assert_allclose(found[0][0], case.m, rtol=0.02)


def test_ranges_of_channels_do_not_depend_on_who_looked(cores):
    """Not a number and infinities are found in whichever share they lie; a channel of NaN has no range."""
    rng = np.random.default_rng(8)
    wide, narrow = rng.standard_normal((400_000, 7)), rng.standard_normal((400_000, 2)).astype(np.float32)
    wide[300_000, 2], wide[17, 5], wide[:, 6] = np.nan, -np.inf, np.nan
    for count in (1, 3):
        cores(count)
        found = Extent.of([wide, narrow, wide[:0]])
        assert found.finite.tolist() == [True, True, False, True, True, False, False, True, True] + [True] * 7
        np.testing.assert_array_equal(found.low[:6], np.nanmin(wide[:, :6], axis=0))
        np.testing.assert_array_equal(found.high[7:9], narrow.max(axis=0))
        assert found.low[6] == np.inf and found.high[6] == -np.inf
        assert (found.low[9:] == np.inf).all()


# -- the same input, the same answer ----------------------------------------------------------------


SCRIPT = """
import json, sys, warnings
import numpy as np
from pysindy_nrf import ChainModel, NRFRegressor, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

warnings.simplefilter("ignore")
storey = [laws.LinearElastic(1e5), laws.LinearViscous(80.0)]
truth = ChainModel([10.0, 12.0, 9.0], {1: [*storey, laws.Dahl(sigma=3e3, Fd=30.0)], 2: storey, 3: storey})
F = excitation.band_limited_random(3, 2.0, 1000.0, dofs=2, rms=100.0, band=(1, 60), random_state=3)
record = add_noise(simulate(truth, F, 1e-3), 0.01, random_state=4)
X, F = record.to_features()
model = NRFRegressor(degree=3, laws={1: [laws.PowerSeries(1), laws.Dahl()]}).fit(X, F)
plain = NRFRegressor(degree=3).fit(X, F)
found = {
    "features": X.to_numpy()[::97].ravel(),
    "masses": model.masses_,
    "sigma": [model.model_.laws["storey 1"][1].shape["sigma"]],
    "coefficients": np.concatenate([f.coefficients for f in plain.restoring_forces_.values()]),
    "intervals": plain.confidence_intervals(method="bootstrap", random_state=5)[["lower", "upper"]].to_numpy().ravel(),
    "modes": plain.modes().to_numpy().ravel(),
    "free run": model.simulate(F.to_numpy()[:800], dt=1e-3).displacement.ravel(),
}
if "loop" in sys.argv:
    report = close_loop(record, catalogue=[laws.CoulombFriction(), laws.Dahl(), laws.CubicStiffness()], max_steps=1, random_state=6)
    found["loop"] = report.table.select_dtypes("number").to_numpy(dtype=float).ravel()
    found["loop model"] = report.model.masses
print(json.dumps({k: [float(x).hex() for x in np.ravel(v)] for k, v in found.items()}))
"""


def answer(threads: int, *arguments: str) -> dict[str, np.ndarray]:
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    env = {**os.environ, **dict.fromkeys(names, str(threads)), "PYTHONHASHSEED": str(threads)}
    run = subprocess.run([sys.executable, "-c", SCRIPT, *arguments], capture_output=True, text=True, env=env, timeout=300)
    assert run.returncode == 0, run.stderr[-3000:]
    return {k: np.array([float.fromhex(x) for x in v]) for k, v in json.loads(run.stdout.splitlines()[-1]).items()}


@pytest.mark.slow
def test_the_same_input_gives_the_same_bits_in_another_process():
    one, two = answer(1, "loop"), answer(1, "loop")
    assert one.keys() == two.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], two[name], err_msg=name)


@pytest.mark.slow
def test_blas_threads_change_nothing_but_the_last_digits():
    one, four = answer(1), answer(4)
    for name in one:
        scale = 0.0 if name == "coefficients" else np.abs(one[name]).max()  # coefficients are ten orders apart
        np.testing.assert_allclose(four[name], one[name], rtol=1e-10, atol=1e-10 * scale, err_msg=name)


def test_two_fits_in_one_process_are_the_same(chain4):
    one, two = (NRFRegressor(degree=3).fit(chain4.X, chain4.F) for _ in range(2))
    np.testing.assert_array_equal(one.masses_, two.masses_)
    again = one.fit(chain4.X, chain4.F)
    np.testing.assert_array_equal(again.masses_, two.masses_)
    assert again.model_ == two.model_


def modules():
    for info in pkgutil.walk_packages(pysindy_nrf.__path__, "pysindy_nrf."):
        if not info.name.endswith("__main__"):
            yield import_module(info.name)


def test_the_global_random_state_is_neither_read_nor_changed():
    """Nothing in the package touches ``np.random``'s global state or makes a generator of its own accord."""
    import ast
    from pathlib import Path

    wrong = []
    for path in Path(pysindy_nrf.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and ast.unparse(node).startswith(("np.random.", "numpy.random.")):
                if node.attr not in ("Generator", "default_rng", "RandomState", "SeedSequence"):
                    wrong.append(f"{path.name}:{node.lineno} {ast.unparse(node)}")
            if isinstance(node, ast.Import) and any(a.name == "random" for a in node.names):
                wrong.append(f"{path.name}:{node.lineno} import random")
            call = isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.random.default_rng", "numpy.random.default_rng")
            if call and not node.args:
                wrong.append(f"{path.name}:{node.lineno} an unseeded generator")
    assert not wrong, "\n".join(wrong)


def test_whatever_draws_numbers_takes_random_state():
    """Every function whose source draws numbers has ``random_state`` (or is handed the generator)."""
    wrong = []
    for module in modules():
        for name, thing in vars(module).items():
            if not inspect.isfunction(thing) or thing.__module__ != module.__name__ or name.startswith("_"):
                continue
            source = inspect.getsource(thing)
            if "generator(" in source and "random_state" not in inspect.signature(thing).parameters and name != "generator":
                wrong.append(f"{module.__name__}.{name}")
    assert not wrong, ", ".join(wrong)


@pytest.mark.parametrize("seed", ["lucky", -1, 1.5, [1, "a"]])
def test_a_seed_that_is_none_is_refused(seed):
    with pytest.raises(NRFError, match="random_state=.* is no seed. Give a whole number"):
        excitation.band_limited_random(2, 1.0, 100.0, dofs=1, rms=1.0, band=(1, 20), random_state=seed)


def test_seeds_and_generators():
    draw = [
        excitation.band_limited_random(1, 1.0, 100.0, dofs=1, rms=1.0, band=(1, 20), random_state=s)
        for s in (3, 3, np.random.default_rng(3), 4)
    ]
    np.testing.assert_array_equal(draw[0], draw[1])
    np.testing.assert_array_equal(draw[0], draw[2])
    assert not np.allclose(draw[0], draw[3])
