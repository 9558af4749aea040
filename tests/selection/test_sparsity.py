"""Which terms are kept: those that data miss to which they were not fitted."""

from pathlib import Path

import chains
import numpy as np
import pytest

from pysindy_nrf import laws, select_sparsity
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.simulation import add_noise

TRUE = ["v", "s", "s^3"]


def record_of(case, noise):
    return add_noise(case.record(), noise, random_state=0)


def kept_terms(selection, site):
    terms = selection.terms[site]
    return terms.index[terms != 0].tolist()


@pytest.fixture(scope="module")
def duffing():
    """Three Duffing storeys; the damping is 1 % of the force."""
    return chains.duffing(3, [2], seed=9, n_samples=4000)


@pytest.fixture(scope="module")
def selection(duffing):
    return select_sparsity(record_of(duffing, 0.02))


def test_false_terms_go_and_the_damping_stays(selection):
    for i in (1, 2, 3):
        assert kept_terms(selection, f"storey {i}") == TRUE
    assert repr(selection) == "SparsitySelection(9 of 27 terms)"


def test_terms_go_one_by_one_and_cost_nothing(selection):
    table = selection.table
    assert table["terms"].tolist() == list(range(27, 8, -1))
    assert table["error"].max() < 1.02 * table["error"].min()
    gone = set()
    for (site, label), value in selection.terms.items():
        if not value:
            gone.add(f"{label} of {site}")
    assert table["left_out"].iloc[0] == ""
    assert set(table["left_out"].iloc[1:]) == gone


def test_what_is_left_is_an_estimator(selection, duffing):
    model = selection.regressor().fit(record_of(duffing, 0.02))
    for force in model.restoring_forces_.values():
        assert force.coefficients.index.tolist() == TRUE
    assert np.abs(model.masses_ / duffing.m - 1).max() < 0.02


@pytest.mark.slow
def test_the_true_terms_of_a_noisy_chain_hit_on_one_floor(monkeypatch):
    """The quick benchmark: 2 % noise on every channel, damping a percent."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    import sparse_selection

    table = sparse_selection.main(["--quick"]).set_index("model")
    assert table.loc["terms selected", "exact"]
    assert table.loc["SINDy, defaults", "missing"] > 0


def test_a_law_that_was_given_is_never_taken_apart():
    m, c, k, k3 = chains.parameters(2, np.random.default_rng(3))
    linear_above = (m, c, k, k3 * [1, 0])
    case = chains.duffing(
        2, [1, 2], seed=3, n_samples=4000, parameters_of_chain=linear_above
    )
    declared = [laws.LinearViscous(), laws.Duffing(), laws.QuadraticDamping()]
    selection = select_sparsity(record_of(case, 0.01), laws={"storey 1": declared})
    assert len(kept_terms(selection, "storey 1")) == 4
    assert kept_terms(selection, "storey 2") == ["v", "s"]


def test_a_series_that_a_fold_cannot_determine_is_no_beginning():
    record = record_of(chains.duffing(2, [1, 2], seed=5, cubic=False), 0.01)
    folds = [(np.arange(4), np.arange(100, 400)), (np.arange(200, 400), np.arange(100))]
    with pytest.raises(NRFError, match="whole series cannot be fitted"):
        select_sparsity(record, cv=folds)


def test_orders_that_were_given_stand_in_the_laws(three):
    regressor = select_sparsity(*three, degree=1, orders={2: 3}).regressor()
    assert regressor.fit(*three).masses_ == pytest.approx([10.0, 12.0, 8.0], rel=0.02)


# -- how sure the terms are ----------------------------------------------------


@pytest.fixture(scope="module")
def shares(selection):
    return selection.inclusion(n_draws=12, random_state=1)


def test_true_terms_are_found_on_parts_of_the_data_and_others_are_not(shares):
    terms = shares.drop("all", level="term")
    true = terms.index.get_level_values("term").isin(TRUE)
    for kind in ("bagging", "stability"):
        assert (terms[kind][true] > 0.8).all()
        assert (terms[kind][~true] < 0.5).all()
        # a storey is as sure as its least sure term at most
        least = terms[kind][true].groupby("site").min()
        storeys = shares[kind].xs("all", level="term")
        assert (storeys <= least).all()


def test_draws_depend_on_the_random_state_alone(selection, shares):
    again = selection.inclusion(n_draws=12, random_state=1)
    assert again.equals(shares)


def test_the_page_shows_how_sure_the_terms_are(tmp_path):
    pytest.importorskip("plotly")
    case = chains.duffing(1, [1], seed=3, n_samples=1500)
    select_sparsity(record_of(case, 0.01)).to_html(tmp_path / "page.html", 0)
    page = (tmp_path / "page.html").read_text("utf-8")
    assert "bagging" in page
    assert "stability" in page
