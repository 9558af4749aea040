"""Which terms are kept: sparse optimizers judged on data they were not fitted to."""

import warnings
from pathlib import Path

import chains
import numpy as np
import pysindy as ps
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.linear_model import Ridge

from pysindy_nrf import laws
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.selection import select_sparsity
from pysindy_nrf.selection.sparsity import AlongPath, BlockEnsemble
from pysindy_nrf.simulation.noise import add_noise

TRUE = ["v", "s", "s^3"]


def record_of(case, noise):
    return add_noise(case.record(), noise, random_state=0)


def kept(terms, n):
    return [[label for label, c in terms.loc[f"storey {i}"].items() if c] for i in range(1, n + 1)]


PATHS = {
    "STLSQ": [ps.STLSQ(threshold=t) for t in (0.003, 0.01, 0.03, 0.1, 0.3)],
    "ensemble": [BlockEnsemble(ps.STLSQ(threshold=t), n_models=6) for t in (0.003, 0.01, 0.03)],
}


@pytest.fixture(scope="module")
def found():
    case = chains.duffing(3, [2], seed=9, n_samples=4000)
    return case, select_sparsity(record_of(case, 0.02), paths=PATHS)


def test_the_error_says_what_a_missing_term_costs(found):
    """Left out, the smallest damping adds its own share of the force to the error, in quadrature."""
    _, selection = found
    errors = selection.table.loc["STLSQ"]
    full, thin = errors.loc["threshold=0.003", "error"], errors.loc["threshold=0.3"]
    assert thin["terms"] < 9 and thin["error"] > 2 * full
    assert errors.loc[errors["chosen"], "error"].iloc[0] < 1.02 * errors["error"].min()


def test_inclusion_is_one_for_what_is_there_and_low_for_what_is_not(found):
    _, selection = found
    share = selection.inclusion["ensemble"]
    there = share.index.get_level_values("term").isin(TRUE)
    assert (share[there] == 1.0).all() and share[~there].max() < 0.6


def test_the_chosen_setting_is_an_estimator(found):
    case, selection = found
    rec = record_of(case, 0.02)
    for name in ("STLSQ", "ensemble"):
        model = selection.regressor(name).fit(rec)
        assert np.abs(model.masses_ / case.m - 1).max() < 0.02
        for i in (1, 2, 3):
            coefficients = model.restoring_forces_[i].coefficients
            assert list(coefficients.index[coefficients != 0]) == TRUE
    with pytest.raises(NRFError, match="no optimizer 'LASSO'"):
        selection.regressor("LASSO")


def test_random_numbers_come_from_random_state_alone():
    rec = record_of(chains.duffing(2, [1], seed=2, n_samples=4000), 0.03)
    path = {"ensemble": [BlockEnsemble(ps.STLSQ(threshold=0.004), n_models=4)]}
    first, again, other = (select_sparsity(rec, paths=path, random_state=k).inclusion for k in (5, 5, 6))
    assert first.equals(again) and not first.equals(other)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.integers(2, 9))
def test_what_lies_along_the_path_is_within_its_tolerance(seed, p):
    """Definition: the residual is at most that of all columns plus tau^2 |y|^2, and the coefficients are least squares."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((60, p)) @ rng.standard_normal((p, p))
    y = x @ (rng.standard_normal(p) * 10.0 ** rng.integers(-4, 1, p)) + 0.01 * rng.standard_normal(60)
    tau = 10.0 ** rng.uniform(-3, -0.5)
    with warnings.catch_warnings(action="ignore"):
        model = AlongPath(ps.SSR(max_iter=99), tau).fit(x, y[:, None])
    full = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    left = y - x @ model.coef_[0]
    assert left @ left <= (full @ full + tau**2 * (y @ y)) * (1 + 1e-9)
    assert np.abs(x[:, model.ind_[0]].T @ left).max(initial=0.0) < 1e-7 * np.abs(x.T @ y).max()


@pytest.mark.slow
def test_every_optimizer_finds_the_true_terms_of_a_noisy_chain_hit_on_one_floor(monkeypatch):
    """The quick benchmark: 2 % noise on every channel; the damping is the smallest term, a percent of the force."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    import sparse_selection

    table = sparse_selection.main(["--quick"]).set_index("optimizer")
    assert table.loc[["STLSQ", "ensemble", "SR3", "SSR", "FROLS"], "exact"].all()
    assert table.loc["SINDy, defaults", "missing"] > 0


def test_the_path_goes_on_where_one_threshold_fits_no_storey_and_never_past_what_the_folds_miss():
    """A low threshold keeps false terms; dropped one by one they cost nothing, and the damping (1 % of the force) stays."""
    case = chains.duffing(3, [2], seed=9, n_samples=4000)
    rec, path = record_of(case, 0.02), {"STLSQ": [ps.STLSQ(threshold=0.002)]}
    plain, found = (select_sparsity(rec, paths=path, prune=prune) for prune in (False, True))
    assert len(plain.table) == 1 and plain.table["terms"].iloc[0] > 9
    assert kept(found.terms["STLSQ"], 3) == [TRUE] * 3
    table = found.table
    assert table["error"].max() < 1.02 * table["error"].min()
    assert table["terms"].tolist() == list(range(plain.table["terms"].iloc[0], 8, -1)) and table["chosen"].iloc[-1]
    assert "without" in table.index[-1][1]
    model = found.regressor().fit(rec)
    assert [list(model.restoring_forces_[i].coefficients.index) for i in (1, 2, 3)] == [TRUE] * 3
    assert np.abs(model.masses_ / case.m - 1).max() < 0.02


def test_a_law_that_was_given_is_never_taken_apart():
    m, c, k, k3 = chains.parameters(2, np.random.default_rng(3))
    case = chains.duffing(2, [1, 2], seed=3, n_samples=4000, given=(m, c, k, k3 * [1, 0]))
    given = {"storey 1": [laws.LinearViscous(), laws.Duffing(), laws.QuadraticDamping()]}
    found = select_sparsity(record_of(case, 0.01), paths={"STLSQ": [ps.STLSQ(threshold=1e-4)]}, laws=given)
    assert (found.terms.loc["storey 1", "STLSQ"] != 0).sum() == 4
    assert kept(found.terms["STLSQ"], 2)[1] == ["v", "s"]


def test_sparsity_asks_for_paths_that_exist():
    rec = record_of(chains.duffing(2, [1, 2], seed=5, cubic=False), 0.01)
    with pytest.raises(NRFError, match="no default path 'LASSO'. Choose from"):
        select_sparsity(rec, paths=["LASSO"])
    with pytest.raises(NRFError, match="Ridge keeps no history_"):
        AlongPath(Ridge()).fit(np.eye(3), np.ones((3, 1)))
    with pytest.raises(NRFError, match="no optimizer to choose from"):
        select_sparsity(rec, paths={})
    found = select_sparsity(rec, degree=2, paths={"STLSQ": [ps.STLSQ(threshold=t) for t in (1e-3, 0.5)]})
    assert repr(found).startswith("SparsitySelection(best='STLSQ'; STLSQ ")
    settings = [setting for name, setting in found.table.index if name == "STLSQ"]
    kept = [len(found.support("STLSQ", setting)) for setting in settings]
    assert max(kept) >= 4 and found.support("STLSQ", "no such setting") == []


def test_a_threshold_beyond_every_term_is_no_candidate():
    """Nothing is left of any force: an error of nearly 100 %, not an exception."""
    rec = record_of(chains.duffing(2, [1, 2], seed=5, cubic=False), 0.01)
    paths = {"STLSQ": [ps.STLSQ(threshold=1e-3), ps.STLSQ(threshold=1e9)], "none": [ps.STLSQ(threshold=1e9)]}
    found = select_sparsity(rec, degree=2, paths=paths)
    assert 90 < found.table.loc["none", "error"].iloc[0] < 101
    assert found.best == "STLSQ"


def test_orders_that_were_thinned_out_stand_in_the_laws(three):
    ps = pytest.importorskip("pysindy")
    paths = {"ensemble": [BlockEnsemble(ps.STLSQ(threshold=0.02), n_models=3)]}
    regressor = select_sparsity(*three, degree=1, orders={2: 3}, paths=paths, prune=False).regressor()
    assert regressor.fit(*three).masses_ == pytest.approx([10.0, 12.0, 8.0], rel=0.02)
