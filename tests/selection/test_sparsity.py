"""Which terms are kept: those that data miss to which they were not fitted."""

from pathlib import Path

import chains
import numpy as np
import pytest

from pysindy_nrf import laws
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.selection import select_sparsity
from pysindy_nrf.simulation.noise import add_noise

TRUE = ["v", "s", "s^3"]


def record_of(case, noise):
    return add_noise(case.record(), noise, random_state=0)


def kept(terms, n):
    return [
        [label for label, c in terms.loc[f"storey {i}"].items() if c]
        for i in range(1, n + 1)
    ]


def test_false_terms_go_one_by_one_and_what_is_left_is_an_estimator():
    """They cost nothing; the damping (1 % of the force) stays."""
    case = chains.duffing(3, [2], seed=9, n_samples=4000)
    rec = record_of(case, 0.02)
    found = select_sparsity(rec)
    assert (
        kept(found.terms, 3) == [TRUE] * 3
        and repr(found) == "SparsitySelection(9 of 27 terms)"
    )
    table = found.table
    assert (
        table["terms"].tolist() == list(range(27, 8, -1))
        and table["error"].max() < 1.02 * table["error"].min()
    )
    gone = {f"{label} of {site}" for (site, label), c in found.terms.items() if not c}
    assert table["left_out"].iloc[0] == "" and set(table["left_out"].iloc[1:]) == gone
    model = found.regressor().fit(rec)
    assert [list(model.restoring_forces_[i].coefficients.index) for i in (1, 2, 3)] == [
        TRUE
    ] * 3
    assert np.abs(model.masses_ / case.m - 1).max() < 0.02


@pytest.mark.slow
def test_the_true_terms_of_a_noisy_chain_hit_on_one_floor_are_found(monkeypatch):
    """The quick benchmark: 2 % noise on every channel; the damping is the smallest
    term, a percent of the force.
    """
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    import sparse_selection

    table = sparse_selection.main(["--quick"]).set_index("model")
    assert table.loc["terms selected", "exact"]
    assert table.loc["SINDy, defaults", "missing"] > 0


def test_a_law_that_was_given_is_never_taken_apart():
    m, c, k, k3 = chains.parameters(2, np.random.default_rng(3))
    case = chains.duffing(
        2, [1, 2], seed=3, n_samples=4000, given=(m, c, k, k3 * [1, 0])
    )
    given = {
        "storey 1": [laws.LinearViscous(), laws.Duffing(), laws.QuadraticDamping()]
    }
    found = select_sparsity(record_of(case, 0.01), laws=given)
    assert (found.terms["storey 1"] != 0).sum() == 4
    assert kept(found.terms, 2)[1] == ["v", "s"]


def test_a_series_that_a_fold_cannot_determine_is_no_beginning():
    rec = record_of(chains.duffing(2, [1, 2], seed=5, cubic=False), 0.01)
    folds = [(np.arange(4), np.arange(100, 400)), (np.arange(200, 400), np.arange(100))]
    with pytest.raises(NRFError, match="whole series cannot be fitted"):
        select_sparsity(rec, cv=folds)


def test_orders_that_were_given_stand_in_the_laws(three):
    regressor = select_sparsity(*three, degree=1, orders={2: 3}).regressor()
    assert regressor.fit(*three).masses_ == pytest.approx([10.0, 12.0, 8.0], rel=0.02)
