"""Order selection: the splitter, the rule, and the fast path against GridSearchCV."""

import warnings
from dataclasses import dataclass, field
from typing import Any

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
    scorers,
    select_order,
)
from pysindy_nrf.exceptions import (
    BiasWarning,
    ChainError,
    ChannelError,
    NRFError,
    RankWarning,
)
from pysindy_nrf.simulation import add_noise

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")


@pytest.fixture(scope="module")
def cubic():
    return chains.duffing(4, [3], seed=1, n_samples=3000)


# -- the splitter --------------------------------------------------------------


@given(
    st.lists(st.integers(12, 60), min_size=1, max_size=5),
    st.integers(2, 5),
    st.integers(0, 2),
)
def test_blocks_are_held_out_once_with_a_gap_around_them(lengths, n_splits, gap):
    ids = np.repeat(np.arange(len(lengths)), lengths)
    times_held_out = np.zeros(len(ids), dtype=int)
    splitter = BlockedTimeSplit(n_splits, gap=gap)
    for train, test in splitter.split(np.zeros((len(ids), 3)), groups=ids):
        times_held_out[test] += 1
        for record in set(ids):
            block = test[ids[test] == record]
            rest = train[ids[train] == record]
            assert (np.diff(block) == 1).all()
            distances = np.abs(rest[:, None] - block)
            assert distances.min(initial=gap + 1) == gap + 1
            assert lengths[record] - len(block) - len(rest) <= 2 * gap
    assert (times_held_out == 1).all()


def test_one_record_without_a_gap_is_scikit_learns_kfold():
    X = np.zeros((103, 3))
    folds = zip(BlockedTimeSplit(5).split(X), KFold(5).split(X), strict=True)
    for (train, test), (expected_train, expected_test) in folds:
        assert np.array_equal(train, expected_train)
        assert np.array_equal(test, expected_test)


@pytest.mark.parametrize(
    ("splitter", "groups", "message"),
    [
        (BlockedTimeSplit(2), np.arange(20) % 2, "do not follow each other"),
        (BlockedTimeSplit(2), [None] * 20, "no id in rows 0, 1, 2"),
        (BlockedTimeSplit(5, gap=8), None, "20 samples is too short"),
        (BlockedTimeSplit(1), None, "n_splits=1"),
    ],
)
def test_folds_that_cannot_be(splitter, groups, message):
    with pytest.raises(NRFError, match=message):
        list(splitter.split(np.zeros((20, 3)), groups=groups))


# -- the rule ------------------------------------------------------------------

DEGREES = [{"degree": 1}, {"degree": 3}, {"degree": 5}]


def results(scores, params=None):
    """As GridSearchCV gives them; scores are (n_candidates, n_folds)."""
    table = {"params": params or DEGREES}
    for i, column in enumerate(np.asarray(scores, dtype=float).T):
        table[f"split{i}_test_score"] = column
    return table


# percent; the standard error of the best, the last one, is 0.35
ERRORS = np.array([[10.0, 10.1, 9.9], [8.2, 8.3, 8.1], [7.4, 8.0, 8.6]])


def standard_error(errors):
    return np.std(errors, ddof=1) / np.sqrt(len(errors))


def test_the_simplest_within_one_standard_error_is_chosen():
    assert 0.2 < standard_error(ERRORS[2]) < 2.0
    assert one_standard_error(results(-ERRORS), min_gain=0.0) == 1


def test_a_candidate_beyond_one_standard_error_is_not_chosen():
    worse = ERRORS.copy()
    worse[1] += standard_error(ERRORS[2])
    assert one_standard_error(results(-worse), min_gain=0.0) == 2


def test_r2_and_percent_give_the_same_choice():
    squares = 1 - (ERRORS / 100) ** 2
    assert one_standard_error(results(squares), min_gain=0.0) == 1


@given(st.integers(0, 10**6))
def test_the_rule_takes_the_simplest_of_those_near_the_best(seed):
    rng = np.random.default_rng(seed)
    errors = rng.uniform(1.0, 9.0, (5, 1)) + rng.uniform(0, 1, (5, 4))
    degrees = rng.permutation([1, 2, 3, 4, 5])
    params = [{"degree": degree} for degree in degrees]
    chosen = one_standard_error(results(-errors, params))
    mean = errors.mean(axis=1)
    best = int(np.argmin(mean))
    limit = max(mean[best] + standard_error(errors[best]), mean[best] / 0.85)
    assert degrees[chosen] == degrees[mean <= limit].min()


@pytest.mark.parametrize(
    "scores",
    [[[-9e-11], [-3e-12], [-1e-12]], [[1 - 4e-16], [1.0], [1.0]]],
    ids=["percent", "R^2"],
)
def test_round_off_is_no_reason_for_more_terms(scores):
    assert one_standard_error(results(scores)) == 0


EQUAL = [[-5.0, -5.1], [-5.0, -5.1], [-5.0, -5.1]]
THRESHOLDS = [{"optimizer__threshold": t} for t in (0.01, 0.1, 0.03)]
BOXES = [{"nrfregressor__degree": d} for d in (3, (1, 3), (2, 2))]
BANDS = [{"band": band} for band in "abc"]


@pytest.mark.parametrize(
    "params", [THRESHOLDS, BOXES], ids=["larger threshold", "fewer terms"]
)
def test_what_is_simple_depends_on_what_is_searched(params):
    """Of the boxes: nine, seven and eight terms."""
    assert one_standard_error(results(EQUAL, params)) == 1


def place_in_bca(params):
    return "bca".index(params["band"])


def test_complexity_of_other_parameters_has_to_be_given():
    table = results(EQUAL, BANDS)
    assert one_standard_error(table, complexity=place_in_bca) == 1
    with pytest.raises(NRFError, match="complexity of"):
        one_standard_error(table)


SOME_FAILED = [[np.nan, -1.0], [-4.0, -4.2], [-3.9, -4.0]]


def test_failed_fits_are_never_chosen():
    assert one_standard_error(results(SOME_FAILED)) == 1
    with pytest.raises(NRFError, match="No candidate"):
        one_standard_error(results(np.full((3, 2), np.nan)))


def test_a_score_that_is_not_there_is_named():
    with pytest.raises(NRFError, match="named 'R2'.*score"):
        one_standard_error(results(SOME_FAILED), metric="R2")


# -- the fast path -------------------------------------------------------------


def scores_of_folds(table, scoring):
    """Scores of a grid search, (n_candidates, n_folds)."""
    names = [name for name in table if name.startswith("split")]
    of_scoring = [name for name in names if name.endswith(f"_test_{scoring}")]
    return np.column_stack([table[name] for name in of_scoring])


@dataclass
class Search:
    """The same candidates by GridSearchCV and by select_order."""

    X: Any
    F: Any
    candidates: list
    cv: Any = 5
    params: dict = field(default_factory=dict)

    def by_grid(self):
        search = GridSearchCV(
            NRFRegressor(**self.params),
            {"degree": self.candidates},
            cv=self.cv,
            refit=False,
            scoring={
                "balance": scorers.balance,
                "acceleration": scorers.acceleration,
            },
        )
        return search.fit(self.X, self.F).cv_results_

    def by_sums(self, scoring):
        boxes = [c for c in self.candidates if isinstance(c, tuple)]
        degrees = [c for c in self.candidates if not isinstance(c, tuple)]
        return select_order(
            self.X,
            self.F,
            degrees=degrees,
            boxes=boxes,
            cv=self.cv,
            scoring=scoring,
            **self.params,
        )

    def assert_same(self, tolerance=1e-9):
        table = self.by_grid()
        for scoring in ("balance", "acceleration"):
            fast = self.by_sums(scoring)
            expected = scores_of_folds(table, scoring)
            assert np.abs(fast.fold_scores.to_numpy() - expected).max() < tolerance
            chosen = one_standard_error(table, metric=scoring)
            assert fast.best_order == self.candidates[chosen]


def test_the_scores_are_those_of_grid_search(cubic):
    candidates = [1, 2, 3, 4, 5, 6, 7, (1, 3), (4, 2)]
    Search(cubic.noisy(), cubic.F, candidates).assert_same()


DUFFING = [laws.LinearViscous(), laws.Duffing()]
SETTINGS = {
    "complete": ([1, 2, 3], {}),
    "joint": ([1, 2, 3], {"strategy": "joint"}),
    "one order given": ([2], {"orders": {"storey 3": (1, 1)}}),
    "laws given": (
        [2],
        {"laws": {"storey 1": DUFFING, "link 3-1": [laws.PowerSeries(1)]}},
    ),
    "a mass given": ([3], {"known_masses": {1: 20.0}}),
    "sparse": ([3], {"optimizer": ps.STLSQ(threshold=0.02)}),
}


@pytest.mark.parametrize(("forced", "params"), SETTINGS.values(), ids=SETTINGS)
def test_the_scores_are_the_same_whatever_the_settings(forced, params):
    case = chains.duffing(3, forced, seed=5, n_samples=1500)
    splitter = BlockedTimeSplit(4, gap=20)
    Search(case.noisy(), case.F, [1, 3, 4], splitter, params).assert_same()


@pytest.mark.filterwarnings("ignore:The groups parameter")
def test_the_scores_are_the_same_on_shuffled_folds(cubic):
    shuffled = KFold(4, shuffle=True, random_state=1)
    Search(cubic.noisy(), cubic.F, [1, 3, 5], shuffled).assert_same()


def test_the_scores_of_clean_data_are_the_same(cubic):
    # percent of nothing
    Search(cubic.X, cubic.F, [1, 3, 6]).assert_same(tolerance=1e-5)


def test_the_scores_are_the_same_on_a_shaken_base():
    ag = chains.band_limited(2000, 1e-3, np.random.default_rng(5), rms=2.0)
    case = chains.duffing(3, [], seed=7, n_samples=2000, ag=ag)
    params = {"known_masses": dict(enumerate(case.m, 1))}
    Search(case.noisy(0.005), None, [1, 3, 4], params=params).assert_same()


def test_the_scores_are_the_same_where_a_force_is_not_known():
    case = chains.duffing(3, [1, 3], seed=8, n_samples=2000)
    case.F[:, 1] = np.nan
    params = {"known_masses": {2: case.m[1]}}
    Search(case.noisy(0.01), case.F, [1, 3, 4], params=params).assert_same()


@pytest.fixture(scope="module")
def hammer():
    """Three records, each with another floor hit, and their ids."""
    parameters = chains.parameters(3, np.random.default_rng(2))
    cases = []
    for j in (1, 2, 3):
        cases.append(
            chains.duffing(
                3, [j], seed=9, n_samples=1500, parameters_of_chain=parameters
            )
        )
    X = np.vstack([case.noisy(0.005) for case in cases])
    F = np.vstack([case.F for case in cases])
    return X, F, np.repeat([1, 2, 3], 1500)


def test_the_scores_are_the_same_where_folds_force_other_floors(hammer):
    """Which equations scale the chain changes from fold to fold."""
    X, F, ids = hammer
    folds = list(LeaveOneGroupOut().split(X, groups=ids))
    Search(X, F, [1, 3, 4], folds).assert_same()


def test_a_splitter_gets_the_record_ids(hammer):
    X, F, ids = hammer
    folds = list(LeaveOneGroupOut().split(X, groups=ids))
    selection = select_order(X, F, degrees=[1, 3], cv=LeaveOneGroupOut(), record=ids)
    other = select_order(X, F, degrees=[1, 3], cv=folds)
    assert np.allclose(selection.fold_scores, other.fold_scores, atol=1e-10)


def half_poor_half_rich():
    """Drifts at two values, where every s^2 is a constant; then drifts of any size."""
    rng = np.random.default_rng(4)
    a, v, s = rng.standard_normal((3, 4000, 2)) * np.array([[[1.0]], [[0.1]], [[1e-3]]])
    s[:2000] = 1e-3 * np.sign(s[:2000])
    R = 50 * v + 1e4 * s + 1e9 * s**3
    noise = 0.5 * rng.standard_normal((4000, 2))
    F = np.array([10.0, 12.0]) * a + R + noise
    F[:, 0] -= R[:, 1]
    return np.hstack([a, v, s]), F


def test_a_fold_with_dependent_terms_does_not_spoil_the_others():
    """What the poor half says of the rich one is not determined: not compared."""
    search = Search(*half_poor_half_rich(), candidates=[1, 2, 3], cv=2)
    with warnings.catch_warnings(action="ignore", category=RankWarning):
        scores = search.by_sums("balance").fold_scores.to_numpy()
        expected = scores_of_folds(search.by_grid(), "balance")
    apart = np.abs(scores - expected)
    assert apart[:, 0].max() < 1e-9
    assert apart[0, 1] < 1e-9
    assert np.isfinite(scores).all()
    assert scores[2, 1] < 5 * scores[2, 0] < 0


# -- what is found -------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_one_storey_is_linear_and_two_are_cubic(noise):
    m, c, k, k3 = chains.parameters(3, np.random.default_rng(3))
    parameters = (m, c, k, k3 * np.array([1.0, 0.0, 1.0]))
    case = chains.duffing(
        3, [2], seed=4, n_samples=4000, parameters_of_chain=parameters
    )
    X = case.noisy(noise)
    selection = select_order(X, case.F, degrees=range(1, 6))
    assert selection.best_order == 3
    assert selection.orders_ == {"storey 1": 3, "storey 2": 1, "storey 3": 3}
    assert selection.regressor().degree == 3
    model = selection.regressor(by_storey=True).fit(X, case.F)
    linear = model.restoring_forces_["storey 2"].coefficients
    assert list(linear.index) == ["v", "s"]


@pytest.fixture(scope="module")
def two_storeys():
    return chains.duffing(2, [2], seed=6, n_samples=2000, substeps=4)


def test_the_table_has_free_runs_if_asked_for(two_storeys):
    case = two_storeys
    selection = select_order(
        case.X, case.F, degrees=[1, 3], cv=3, free_run=True, dt=case.dt
    )
    errors = selection.table["free_run_error"]
    assert errors["3"] < 1.0 < 10.0 < errors["1"]


def test_the_free_run_is_a_score(two_storeys):
    case = two_storeys
    options = {"degrees": [1, 3], "cv": 3, "scoring": "free_run", "dt": case.dt}
    selection = select_order(case.X, case.F, **options)
    assert selection.best_order == 3
    train, test = list(KFold(3).split(case.X))[1]
    model = NRFRegressor(degree=3, dt=case.dt).fit(case.X[train], case.F[train])
    expected = scorers.free_run(model, case.X[test], case.F[test])
    score = selection.fold_scores.loc["3", "fold 2"]
    assert score == pytest.approx(expected, rel=1e-6)


def test_a_free_run_needs_a_clock(two_storeys):
    with pytest.raises(ChannelError, match="free run needs the time"):
        select_order(two_storeys.X, two_storeys.F, scoring="free_run")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"degrees": []}, NRFError, "no order"),
        ({"degrees": [0, 1]}, NRFError, "no terms"),
        ({"degrees": [2.5]}, NRFError, "2.5"),
        ({"scoring": "r2"}, NRFError, "'r2' is unknown"),
        ({"rule": "smallest"}, NRFError, "'smallest' is unknown"),
        ({"degree": 3}, ChainError, "is what is selected"),
        ({"estimation": "iv"}, ChainError, "not sums of"),
        ({"constraints": []}, ChainError, "constraints need"),
        ({"laws": {"storey 1": [laws.Dahl()]}}, ChainError, "shape parameters"),
        ({"orders": {"storey 9": 2}}, NRFError, "storey 9"),
        ({"orders": {f"storey {i}": 1 for i in range(1, 5)}}, ChainError, "already"),
        ({"cv": [([0, 1], [1, 2])]}, NRFError, "trained with"),
    ],
)
def test_what_cannot_be_asked(cubic, options, error, message):
    with pytest.raises(error, match=message):
        select_order(cubic.X, cubic.F, **options)


def test_the_validation_curve(cubic):
    selection = select_order(cubic.noisy(), cubic.F, degrees=range(1, 6))
    (ax,) = selection.plot().ax_
    assert "% NRMSE" in ax.get_ylabel()
    assert "degree" in ax.get_xlabel()
    curve = ax.containers[0].lines[0].get_ydata()
    assert np.allclose(curve, selection.table["balance_error"])
    by_label = {line.get_label(): line for line in ax.lines}
    assert by_label["chosen"].get_xdata().tolist() == [2]


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("degree", [1, 3])
def test_the_true_degree_is_chosen_from_fused_records(degree, noise):
    is_cubic = degree == 3
    case = chains.duffing(3, [2], seed=11, n_samples=1500, cubic=is_cubic, substeps=2)
    record = add_noise(case.record(), noise, random_state=11)
    X, F = record.to_features(smooth=True)
    search = GridSearchCV(
        NRFRegressor(),
        {"degree": [1, 2, 3, 4, 6]},
        cv=BlockedTimeSplit(5),
        refit=one_standard_error,
    )
    assert search.fit(X, F).best_params_ == {"degree": degree}
    assert select_order(X, F).best_order == degree


@pytest.mark.filterwarnings("ignore")
def test_thresholds_are_searched_beside_degrees(cubic):
    thresholds = [0.001, 0.01, 0.1, 0.5]
    search = GridSearchCV(
        NRFRegressor(optimizer=ps.STLSQ()),
        {"degree": [3], "optimizer__threshold": thresholds},
        cv=3,
        refit=one_standard_error,
    )
    search.fit(cubic.noisy(), cubic.F)
    assert search.best_params_["optimizer__threshold"] in (0.01, 0.1)


def test_columns_of_a_table_are_found_by_their_names(cubic):
    names = [f"{kind}{j}" for kind in "avs" for j in range(1, 5)]
    table = pd.DataFrame(cubic.noisy(), columns=names)
    shuffled = table.sample(frac=1, axis=1, random_state=0)
    plain = select_order(cubic.noisy(), cubic.F, degrees=[1, 3])
    selection = select_order(shuffled, cubic.F, degrees=[1, 3])
    assert np.allclose(selection.fold_scores, plain.fold_scores, atol=1e-10)


def test_a_number_of_folds_is_blocks_of_every_record(cubic):
    X, ids = cubic.noisy(), np.repeat(["a", "b"], 1500)
    blocks = list(BlockedTimeSplit(5).split(X, groups=ids))
    selection = select_order(X, cubic.F, degrees=[1, 3], record=ids)
    other = select_order(X, cubic.F, degrees=[1, 3], cv=blocks)
    assert np.allclose(selection.fold_scores, other.fold_scores, atol=1e-10)


def linear_record(noise):
    """Two linear storeys, both DOFs forced."""
    case = chains.duffing(2, [1, 2], seed=5, n_samples=3000, cubic=False)
    return add_noise(case.record(), noise, random_state=1)


def test_a_fold_without_a_force_has_no_candidate():
    """Nothing scales the record in free motion without the other one."""
    t = np.arange(1500)[:, None] / 1000
    w = 2 * np.pi * np.array([[5.0, 9.0]])
    x = 1e-3 * np.sin(w * t)
    free = Record(
        force=0 * x,
        acceleration=-(w**2) * x,
        velocity=1e-3 * w * np.cos(w * t),
        displacement=x,
        fs=1000.0,
        name="free",
    )
    records = [linear_record(0.01), free]
    with pytest.raises(NRFError, match="No candidate could be fitted"):
        select_order(records, degrees=[1, 2], cv=LeaveOneGroupOut())


def test_the_rule_may_be_the_least_error():
    best = select_order(linear_record(0.02), degrees=[1, 2, 3], rule="best")
    assert str(best.best_order) == best.fold_scores.mean(axis=1).idxmax()


# -- searches and users ----------------------------------------------------------


def test_a_search_warns_once_and_again_when_it_is_run_again():
    case = chains.duffing(3, [3], seed=6, n_samples=2000)
    X = case.noisy(0.05)
    search = GridSearchCV(NRFRegressor(), {"degree": [1, 3]}, cv=BlockedTimeSplit(3))
    for _ in range(2):
        with warnings.catch_warnings(record=True, action="always") as caught:
            search.fit(X, case.F)
        ours = [w for w in caught if issubclass(w.category, BiasWarning)]
        assert len(ours) == 1
        assert ours[0].filename == __file__


def test_a_search_says_what_to_pass_instead_of_a_record(cubic):
    search = GridSearchCV(NRFRegressor(), {"degree": [1, 3]})
    with pytest.raises(ChannelError, match="to_features"):
        search.fit(cubic.record())


def test_a_fit_with_too_many_terms_names_the_smallest_degree():
    case = chains.duffing(3, [2], seed=6, n_samples=2000)
    model = NRFRegressor(degree=5).fit(case.noisy(0.005), case.F)
    assert model.result_.smaller_order.degree == 3
    assert "degree=3 does as well" in str(model.summary())
    assert NRFRegressor(degree=3).fit(case.X, case.F).result_.smaller_order is None


def test_dependent_terms_are_warned_of_with_the_degree_that_does_as_well():
    """A steady harmonic motion tells no powers apart."""
    t = np.arange(3000) * 1e-3
    s = 1e-3 * np.sin(20 * t)
    v, a = 2e-2 * np.cos(20 * t), -400 * s
    F = 10 * a + 20 * v + 3e4 * s
    model = NRFRegressor(degree=3, known_masses={1: 10.0})
    with pytest.warns(RankWarning, match="degree=1 does as well"):
        model.fit(np.column_stack([a, v, s]), F[:, None])
