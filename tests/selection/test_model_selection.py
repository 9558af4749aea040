"""Order selection: splitters, the rule, and the fast path against GridSearchCV."""

import warnings

import chains
import numpy as np
import pandas as pd
import pysindy as ps
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import GridSearchCV, KFold, LeaveOneGroupOut

from pysindy_nrf import (
    BlockedTimeSplit,
    NRFRegressor,
    Record,
    laws,
    one_standard_error,
    select_order,
)
from pysindy_nrf.exceptions import ChainError, ChannelError, NRFError, RankWarning
from pysindy_nrf.selection import one_se_rule as rule
from pysindy_nrf.selection import scorers
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")


@pytest.fixture(scope="module")
def cubic():
    case = chains.duffing(4, [3], seed=1, n_samples=3000)
    return case, case.noisy()


# -- splitters -----------------------------------------------------------------


@given(
    st.lists(st.integers(12, 60), min_size=1, max_size=5),
    st.integers(2, 5),
    st.integers(0, 2),
)
def test_blocks_are_held_out_once_with_a_gap_around_them(lengths, n_splits, gap):
    ids = np.repeat(np.arange(len(lengths)), lengths)
    X = np.zeros((len(ids), 3))
    seen = np.zeros(len(ids), dtype=int)
    for train, test in BlockedTimeSplit(n_splits, gap=gap).split(X, groups=ids):
        seen[test] += 1
        assert not set(train) & set(test)
        for i in set(ids):
            held, kept = test[ids[test] == i], train[ids[train] == i]
            assert (np.diff(held) == 1).all()  # one block of every record
            distance = np.abs(kept[:, None] - held).min(initial=gap + 1)
            assert distance > gap
            left_out = (ids == i).sum() - len(held) - len(kept)
            assert left_out <= 2 * gap
    assert (seen == 1).all()


def test_one_record_without_a_gap_is_scikit_learns_kfold():
    X = np.zeros((103, 3))
    for ours, theirs in zip(BlockedTimeSplit(5).split(X), KFold(5).split(X)):
        assert all(np.array_equal(a, b) for a, b in zip(ours, theirs))


@pytest.mark.parametrize(
    "split, message",
    [
        (
            lambda X: BlockedTimeSplit(2).split(X, groups=np.arange(20) % 2),
            "record 0 do not follow each other",
        ),
        (
            lambda X: BlockedTimeSplit(2).split(X, groups=[None] * 20),
            "record has no id in rows 0, 1, 2",
        ),
        (lambda X: BlockedTimeSplit(5, gap=8).split(X), "20 samples is too short"),
        (lambda X: BlockedTimeSplit(1).split(X), "n_splits=1"),
    ],
)
def test_folds_that_cannot_be(split, message):
    with pytest.raises(NRFError, match=message):
        list(split(np.zeros((20, 3))))


# -- the rule ------------------------------------------------------------------


def results(scores, params):
    scores = np.asarray(scores, dtype=float)
    return {
        "params": params,
        **{f"split{i}_test_score": column for i, column in enumerate(scores.T)},
    }


DEGREES = [{"degree": d} for d in (1, 3, 5)]


def test_the_rule_of_the_book():
    """Errors 10, 8.2, 8.0 with a standard error of 0.3 at the best: the middle one is
    within it, the first is not.
    """
    e = np.array([[10.0, 10.1, 9.9], [8.2, 8.3, 8.1], [7.4, 8.0, 8.6]])
    se = np.std(e[2], ddof=1) / np.sqrt(3)
    assert 0.2 < se < 2.0
    assert one_standard_error(results(-e, DEGREES), min_gain=0.0) == 1
    assert (
        one_standard_error(results(-e - [[0], [se], [0]], DEGREES), min_gain=0.0) == 2
    )
    squares = 1 - (e / 100) ** 2  # as R^2
    assert one_standard_error(results(squares, DEGREES), min_gain=0.0) == 1


@given(st.integers(0, 10**6))
def test_the_rule_never_takes_more_terms_than_the_best_and_stays_near_it(seed):
    rng = np.random.default_rng(seed)
    e = rng.uniform(1.0, 9.0, (5, 1)) + rng.uniform(0, 1, (5, 4))
    params = [{"degree": d} for d in rng.permutation([1, 2, 3, 4, 5])]
    chosen, best = (
        one_standard_error(results(-e, params)),
        int(np.argmin(e.mean(axis=1))),
    )
    assert params[chosen]["degree"] <= params[best]["degree"]
    bound = max(e[best].mean() + rule.standard_error(e[best]), e[best].mean() / 0.85)
    assert e[chosen].mean() <= bound
    assert not any(
        p["degree"] < params[chosen]["degree"] and row.mean() <= bound
        for p, row in zip(params, e)
    )


def test_round_off_is_no_reason_for_more_terms():
    """Noise-free: errors of 1e-12 %, or R^2 of one less a bit, differ by luck."""
    assert (
        one_standard_error(results([[-9e-11] * 3, [-3e-12] * 3, [-1e-12] * 3], DEGREES))
        == 0
    )
    assert (
        one_standard_error(results([[1 - 4e-16] * 3, [1.0] * 3, [1.0] * 3], DEGREES))
        == 0
    )


def test_what_is_simple_depends_on_what_is_searched():
    flat = [[-5.0, -5.1], [-5.0, -5.1], [-5.0, -5.1]]
    thresholds = [{"optimizer__threshold": t} for t in (0.01, 0.1, 0.03)]
    assert one_standard_error(results(flat, thresholds)) == 1
    boxes = [{"nrfregressor__degree": d} for d in (3, (1, 3), (2, 2))]
    assert one_standard_error(results(flat, boxes)) == 1  # nine, seven and eight terms
    assert (
        one_standard_error(
            results(flat, [{"band": b} for b in "abc"]),
            complexity=lambda p: "bca".index(p["band"]),
        )
        == 1
    )
    with pytest.raises(NRFError, match="complexity of"):
        one_standard_error(results(flat, [{"band": b} for b in "abc"]))


def test_failed_fits_are_never_chosen():
    scores = [[np.nan, -1.0], [-4.0, -4.2], [-3.9, -4.0]]
    assert one_standard_error(results(scores, DEGREES)) == 1
    with pytest.raises(NRFError, match="No candidate"):
        one_standard_error(results(np.full((3, 2), np.nan), DEGREES))
    with pytest.raises(NRFError, match="named 'R2'.*score"):
        one_standard_error(results(scores, DEGREES), metric="R2")


# -- the fast path -------------------------------------------------------------


def searched(X, F, candidates, cv=5, **params):
    return GridSearchCV(
        NRFRegressor(**params),
        {"degree": candidates},
        cv=cv,
        refit=False,
        scoring={"balance": scorers.balance, "acceleration": scorers.acceleration},
    ).fit(X, F)


def assert_same(search, X, F, candidates, cv=5, tolerance=1e-9, **params):
    degrees, boxes = (
        [c for c in candidates if not isinstance(c, tuple)],
        [c for c in candidates if isinstance(c, tuple)],
    )
    for name in ("balance", "acceleration"):
        found = select_order(
            X, F, degrees=degrees, boxes=boxes, cv=cv, scoring=name, **params
        )
        theirs = rule.fold_scores(search.cv_results_, name)
        assert np.abs(found.fold_scores.to_numpy() - theirs).max() < tolerance
        assert (
            found.best_order
            == candidates[one_standard_error(search.cv_results_, metric=name)]
        )


def test_the_scores_are_those_of_grid_search(cubic):
    case, X = cubic
    candidates = [1, 2, 3, 4, 5, 6, 7, (1, 3), (4, 2)]
    assert_same(searched(X, case.F, candidates), X, case.F, candidates)


@pytest.mark.parametrize(
    "forced, params",
    [
        ([1, 2, 3], {}),
        ([1, 2, 3], {"strategy": "joint"}),
        ([2], {"orders": {"storey 3": (1, 1)}}),
        (
            [2],
            {
                "laws": {
                    "storey 1": [laws.LinearViscous(), laws.Duffing()],
                    "link 3-1": [laws.PowerSeries(1)],
                }
            },
        ),
        ([3], {"known_masses": {1: 20.0}}),
        ([3], {"optimizer": ps.STLSQ(threshold=0.02)}),
    ],
    ids=[
        "complete",
        "joint",
        "one order given",
        "laws given",
        "a mass given",
        "sparse",
    ],
)
def test_whatever_the_regressor_is_told(forced, params):
    case = chains.duffing(3, forced, seed=5, n_samples=1500)
    X, candidates, cv = case.noisy(), [1, 3, 4], BlockedTimeSplit(4, gap=20)
    assert_same(
        searched(X, case.F, candidates, cv, **params),
        X,
        case.F,
        candidates,
        cv,
        **params,
    )


def test_clean_data_and_shuffled_folds_too(cubic):
    case, X = cubic
    shuffled = KFold(4, shuffle=True, random_state=1)
    assert_same(
        searched(X, case.F, [1, 3, 5], shuffled), X, case.F, [1, 3, 5], shuffled
    )
    assert_same(
        searched(case.X, case.F, [1, 3, 6]), case.X, case.F, [1, 3, 6], tolerance=1e-5
    )  # percent of nothing


def test_a_base_that_shakes_and_a_force_that_is_not_known():
    ag = chains.band_limited(2000, 1e-3, np.random.default_rng(5), rms=2.0)
    case = chains.duffing(3, [], seed=7, n_samples=2000, ag=ag)
    params = {"known_masses": dict(enumerate(case.m, 1))}
    X = case.noisy(0.005)
    assert_same(searched(X, None, [1, 3, 4], **params), X, None, [1, 3, 4], **params)
    case = chains.duffing(3, [1, 3], seed=8, n_samples=2000)
    F = case.F.copy()
    F[:, 1] = np.nan
    params, X = {"known_masses": {2: case.m[1]}}, case.noisy(0.01)
    assert_same(searched(X, F, [1, 3, 4], **params), X, F, [1, 3, 4], **params)


def test_records_that_force_other_floors_are_held_out_whole():
    """A roving hammer: which balances scale the chain changes from fold to fold."""
    cases = [
        chains.duffing(
            3,
            [j],
            seed=9,
            n_samples=1500,
            given=chains.parameters(3, np.random.default_rng(2)),
        )
        for j in (1, 2, 3)
    ]
    X, F = np.vstack([c.noisy(0.005) for c in cases]), np.vstack([c.F for c in cases])
    ids = np.repeat([1, 2, 3], 1500)
    folds = list(LeaveOneGroupOut().split(X, groups=ids))
    assert_same(searched(X, F, [1, 3, 4], folds), X, F, [1, 3, 4], folds)
    found = select_order(X, F, degrees=[1, 3, 4], cv=LeaveOneGroupOut(), record=ids)
    assert np.allclose(
        found.fold_scores,
        select_order(X, F, degrees=[1, 3, 4], cv=folds).fold_scores,
        atol=1e-10,
    )


def test_a_fold_whose_terms_depend_on_each_other_does_not_spoil_the_others():
    """Half of the record holds the drifts at two values, where every s^2 is one
    constant, s^3 = c^2 s and v s^2 = c^2 v; half of it is rich. What the poor half says
    of the rich one with such terms is not determined: not compared.
    """
    rng = np.random.default_rng(4)
    v, a = 0.1 * rng.standard_normal((4000, 2)), rng.standard_normal((4000, 2))
    s = 1e-3 * np.vstack(
        [np.sign(rng.standard_normal((2000, 2))), rng.standard_normal((2000, 2))]
    )
    R = 50 * v + 1e4 * s + 1e9 * s**3
    F = (
        np.array([10.0, 12.0]) * a
        + R
        - np.column_stack([R[:, 1], np.zeros(4000)])
        + 0.5 * rng.standard_normal((4000, 2))
    )
    X = np.hstack([a, v, s])
    with warnings.catch_warnings(action="ignore", category=RankWarning):
        found = select_order(
            X, F, degrees=[1, 2, 3], cv=2, scoring="balance"
        ).fold_scores.to_numpy()
        theirs = rule.fold_scores(searched(X, F, [1, 2, 3], 2).cv_results_, "balance")
    apart = np.abs(found - theirs)
    apart[1:, 1] = 0.0
    assert (
        apart.max() < 1e-9
        and np.isfinite(found).all()
        and found[2, 1] < 5 * found[2, 0] < 0
    )


def test_one_storey_is_linear_and_one_is_cubic():
    given = chains.parameters(3, np.random.default_rng(3))
    given = (*given[:3], given[3] * np.array([1.0, 0.0, 1.0]))
    case = chains.duffing(3, [2], seed=4, n_samples=4000, given=given)
    for X in (case.X, case.noisy(0.003)):
        found = select_order(X, case.F, degrees=range(1, 6))
        assert found.best_order == 3
        assert found.orders_ == {"storey 1": 3, "storey 2": 1, "storey 3": 3}
    model = found.regressor(by_storey=True).fit(X, case.F)
    assert list(model.restoring_forces_["storey 2"].coefficients.index) == ["v", "s"]
    assert found.regressor().degree == 3


def test_the_free_run_is_judged_too():
    case = chains.duffing(2, [2], seed=6, n_samples=2000, substeps=4)
    found = select_order(
        case.X, case.F, degrees=[1, 3], cv=3, free_run=True, dt=case.dt
    )
    assert (
        found.table.loc["3", "free_run_error"]
        < 1.0
        < 10.0
        < found.table.loc["1", "free_run_error"]
    )
    alone = select_order(
        case.X, case.F, degrees=[1, 3], cv=3, scoring="free_run", dt=case.dt
    )
    assert alone.best_order == 3
    folds = list(KFold(3).split(case.X))
    train, test = folds[1]
    model = NRFRegressor(degree=3, dt=case.dt).fit(case.X[train], case.F[train])
    assert alone.fold_scores.loc["3", "fold 2"] == pytest.approx(
        scorers.free_run(model, case.X[test], case.F[test]), rel=1e-6
    )
    with pytest.raises(ChannelError, match="free run needs the time"):
        select_order(case.X, case.F, scoring="free_run")


@pytest.mark.parametrize(
    "options, error, message",
    [
        ({"degrees": []}, NRFError, "no order"),
        ({"degrees": [0, 1]}, NRFError, "no terms"),
        ({"degrees": [2.5]}, NRFError, "2.5"),
        ({"scoring": "r2"}, NRFError, "'r2' is unknown"),
        ({"rule": "smallest"}, NRFError, "'smallest' is unknown"),
        ({"degree": 3}, ChainError, "is what is selected"),
        ({"estimation": "iv"}, ChainError, "GridSearchCV"),
        ({"laws": {"storey 1": [laws.Dahl()]}}, ChainError, "shape parameters"),
        ({"orders": {"storey 9": 2}}, NRFError, "storey 9"),
        ({"orders": {f"storey {i}": 1 for i in range(1, 5)}}, ChainError, "already"),
        ({"cv": [([0, 1], [1, 2])]}, NRFError, "trained with"),
    ],
)
def test_what_cannot_be_asked(cubic, options, error, message):
    case, X = cubic
    with pytest.raises(error, match=message):
        select_order(X, case.F, **options)


def test_the_validation_curve(cubic):
    case, X = cubic
    found = select_order(X, case.F, degrees=range(1, 6))
    (ax,) = found.plot().ax_
    assert "% NRMSE" in ax.get_ylabel() and "degree" in ax.get_xlabel()
    line = ax.containers[0].lines[0]
    assert np.allclose(line.get_ydata(), found.table["balance_error"])
    ring = next(x for x in ax.lines if x.get_label() == "chosen")
    assert ring.get_xdata().tolist() == [2]


# -- what it must show ---------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("degree", [1, 3])
def test_the_true_degree_is_chosen_from_fused_records(degree, noise):
    seed = 11
    case = chains.duffing(
        3, [2], seed=seed, n_samples=1500, cubic=degree == 3, substeps=2
    )
    X, F = add_noise(case.record(), noise, random_state=seed).to_features(smooth=True)
    search = GridSearchCV(
        NRFRegressor(),
        {"degree": [1, 2, 3, 4, 6]},
        cv=BlockedTimeSplit(5),
        refit=one_standard_error,
    )
    assert search.fit(X, F).best_params_ == {"degree": degree}
    assert select_order(X, F).best_order == degree


def test_thresholds_are_searched_beside_degrees(cubic):
    case, X = cubic
    search = GridSearchCV(
        NRFRegressor(optimizer=ps.STLSQ()),
        {"degree": [3], "optimizer__threshold": [0.001, 0.01, 0.1, 0.5]},
        cv=3,
        refit=one_standard_error,
    )
    with warnings.catch_warnings(action="ignore"):
        search.fit(X, case.F)
    assert search.best_params_["optimizer__threshold"] in (0.01, 0.1)


def test_tables_and_ids_are_read_as_by_the_regressor(cubic):
    case, X = cubic
    names = [f"{kind}{j}" for kind in "avs" for j in range(1, 5)]
    table = pd.DataFrame(X, columns=names).sample(frac=1, axis=1, random_state=0)
    plain = select_order(X, case.F, degrees=[1, 3])
    assert np.allclose(
        select_order(table, case.F, degrees=[1, 3]).fold_scores,
        plain.fold_scores,
        atol=1e-10,
    )
    ids = np.repeat(["a", "b"], 1500)
    two = select_order(X, case.F, degrees=[1, 3], record=ids)
    blocks = list(BlockedTimeSplit(5).split(X, groups=ids))
    assert np.allclose(
        two.fold_scores,
        select_order(X, case.F, degrees=[1, 3], cv=blocks).fold_scores,
        atol=1e-10,
    )


def linear_record(noise=0.0):
    """Two linear storeys, both DOFs forced."""
    case = chains.duffing(2, [1, 2], seed=5, n_samples=3000, cubic=False)
    return add_noise(case.record(), noise, random_state=1)


def test_a_fold_without_a_force_says_so():
    """A record in free motion alone: no force scales the fold that must do without the
    other record.
    """
    t = np.arange(1500)[:, None] / 1000
    w = 2 * np.pi * np.array([[5.0, 9.0]])
    x = 1e-3 * np.sin(w * t)
    free = Record(
        force=0 * x,
        acceleration=-(w**2) * x,
        velocity=1e-3 * w * np.cos(w * t),
        displacement=x,
        fs=1000.0,
    )
    with pytest.raises(
        NRFError, match="No candidate could be fitted and scored on every fold"
    ):
        select_order(
            [linear_record(0.01), free.replace(name="free")],
            degrees=[1, 2],
            cv=LeaveOneGroupOut(),
        )


def test_the_rule_may_be_the_least_error():
    best = select_order(linear_record(0.02), degrees=[1, 2, 3], rule="best")
    assert str(best.best_order) == best.fold_scores.mean(axis=1).idxmax()
