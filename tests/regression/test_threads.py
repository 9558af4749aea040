"""One pass on several cores: the same bits as on one, in the order of time, with no thread and no share left behind."""

from __future__ import annotations

import threading

import chains
import joblib
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor, select_order
from pysindy_nrf.common import threads
from pysindy_nrf.mechanics.chain import Chain
from pysindy_nrf.regression.blocks import Block
from pysindy_nrf.regression.gram import Plan
from pysindy_nrf.regression.gram_pass import block_grams, total_gram
from pysindy_nrf.regression.layout import Layout

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


@pytest.mark.parametrize("count", [1, 3])
def test_the_pass_of_a_fit_and_of_the_orders_leaves_the_callers_thread(cores, monkeypatch, count):
    cores(count)
    case = chains.duffing(2, [1, 2], seed=4, n_samples=4000)
    X, F = (np.tile(y, (8, 1)) for y in (case.X, case.F))
    whole, seen = Plan.multiply, set()

    def multiply(self, block, store):
        seen.add(threading.current_thread())
        return whole(self, block, store)

    monkeypatch.setattr(Plan, "multiply", multiply)
    for run in (lambda: NRFRegressor(degree=3).fit(X, F), lambda: select_order(X, F, degrees=(1, 3))):
        seen.clear()
        run()
        others = seen - {threading.main_thread()}  # the caller's thread adds the windows of the diagnosis
        assert bool(others) == (count > 1) and len(others) <= count


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
    """Samples with an unknown force count for the other balance alone."""
    layout = Layout(Chain(2), {"storey 1": 3, "storey 2": COLUMNS - 3})
    groups = [layout.group((j,)) for j in (1, 2)]
    blocks = list(whole_numbers(9000))
    for count in (1, 2, 5):
        cores(count)
        total = total_gram(layout, groups, iter(blocks))
        for group in groups:
            j = group.dofs[0]
            held = [b for b in blocks if np.isfinite(b.force[j - 1, 0])]
            A = np.hstack([
                np.vstack([*(b.terms[layout.slices[s]] for s in group.sites), b.acceleration[j - 1], b.force[j - 1]])
                for b in held
            ])  # fmt: skip
            assert np.array_equal(total.matrices[j,], A @ A.T), (count, j)
            assert total.sizes[j,] == A.shape[1]
        assert total.n_samples == 9000


def test_several_pieces_take_what_is_theirs(cores):
    cores(3)
    layout = Layout(Chain(2), {"storey 1": 3, "storey 2": COLUMNS - 3})
    groups = [layout.group((j,)) for j in (1, 2)]
    blocks = list(whole_numbers(6000))
    each = block_grams(layout, groups, ((i % 3, block) for i, block in enumerate(blocks)))
    for number in range(3):
        alone = total_gram(layout, groups, blocks[number::3])
        assert each.n_samples[number] == alone.n_samples
        for dofs, gram in alone.matrices.items():
            assert np.array_equal(each.matrices[dofs][number], gram)


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


def test_ranges_of_channels_do_not_depend_on_who_looked(cores, monkeypatch):
    """Not a number and infinities are found in whichever share they lie; a channel of NaN has no range."""
    from pysindy_nrf.regression import domains as extent

    rng = np.random.default_rng(8)
    wide, narrow = rng.standard_normal((5000, 7)), rng.standard_normal((5000, 2)).astype(np.float32)
    wide[4321, 2], wide[17, 5], wide[:, 6] = np.nan, -np.inf, np.nan
    monkeypatch.setattr(extent, "_SHARE", 999)
    for count in (1, 3):
        cores(count)
        found = extent.Extent.of([wide, narrow, wide[:0]])
        assert found.finite.tolist() == [True, True, False, True, True, False, False, True, True] + [True] * 7
        np.testing.assert_array_equal(found.low[:6], np.nanmin(wide[:, :6], axis=0))
        np.testing.assert_array_equal(found.high[7:9], narrow.max(axis=0))
        assert found.low[6] == np.inf and found.high[6] == -np.inf
        assert (found.low[9:] == np.inf).all()
