"""Raw channels to a model in one scikit-learn pipeline, with routed metadata."""

from dataclasses import dataclass

import chains
import numpy as np
import pandas as pd
import pytest
from chains import worst
from sklearn import config_context
from sklearn.model_selection import (
    GridSearchCV,
    KFold,
    LeaveOneGroupOut,
    LeaveOneOut,
    cross_validate,
)
from sklearn.pipeline import make_pipeline

from pysindy_nrf import (
    BlockedTimeSplit,
    KinematicSmoother,
    NRFRegressor,
    laws,
    scorers,
)
from pysindy_nrf.exceptions import ChannelError, LawError

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
DT = 1e-3
N = 1200  # samples of a record


@pytest.fixture(autouse=True, scope="module")
def _routing():
    with config_context(enable_metadata_routing=True):
        yield


def whole_records():
    """Records are held out one by one; their ids come as metadata named record."""
    return LeaveOneGroupOut().set_split_request(groups="record")


def regressor(**options):
    names = ("record", "time", "base_acceleration", "covariates")
    routed = dict.fromkeys(names, True)
    model = NRFRegressor(**options).set_fit_request(**routed)
    return model.set_score_request(**routed).set_predict_request(**routed)


def smoother(**options):
    routed = {"record": True, "time": True}
    smoother = KinematicSmoother(fs=1 / DT, joint=False, **options)
    return smoother.set_fit_request(**routed).set_transform_request(**routed)


def pipeline(**options):
    linear = regressor(degree=1, coordinates="absolute")
    return make_pipeline(smoother(**options), linear)


@dataclass
class Tests:
    """Raw channels of three tests of one linear chain, one below the other."""

    __test__ = False
    table: pd.DataFrame
    F: np.ndarray
    record: np.ndarray
    time: np.ndarray
    m: np.ndarray

    def rows(self, rows):
        return Tests(
            self.table[rows], self.F[rows], self.record[rows], self.time[rows], self.m
        )

    @property
    def metadata(self):
        return {"record": self.record, "time": self.time}

    def fit(self, pipe):
        return pipe.fit(self.table, self.F, **self.metadata)

    def features(self, pipe):
        """What the smoother of a fitted pipeline makes of the channels."""
        return pipe[:-1].transform(self.table, **self.metadata)

    def cross_validate(self, pipe, splitter, scoring):
        return cross_validate(
            pipe,
            self.table,
            self.F,
            cv=splitter,
            params=self.metadata,
            scoring=scoring,
            return_estimator=True,
            error_score="raise",
        )


@pytest.fixture(scope="module")
def tests():
    parameters = chains.parameters(2, np.random.default_rng(4), cubic=False)
    rng = np.random.default_rng(0)
    raw, forces = [], []
    for seed in (1, 2, 3):
        case = chains.duffing(
            2, [2], seed=seed, n_samples=N, parameters_of_chain=parameters, substeps=2
        )
        channels = np.hstack([case.a, case.s.cumsum(axis=1)])
        noise = channels.std(axis=0) * rng.standard_normal(channels.shape)
        raw.append(channels + 0.01 * noise)
        forces.append(case.F)
    table = pd.DataFrame(np.vstack(raw), columns=["a1", "a2", "x1", "x2"])
    ids = np.repeat(["one", "two", "three"], N)
    time = np.tile(np.arange(N) * DT, 3)
    return Tests(table, np.vstack(forces), ids, time, parameters[0])


# -- records stay apart --------------------------------------------------------


def test_every_record_is_fused_by_itself(tests):
    pipe = tests.fit(pipeline())
    assert worst(pipe[-1].masses_, tests.m) < 0.02
    features = tests.features(pipe)
    assert list(features.columns) == ["a1", "a2", "v1", "v2", "x1", "x2"]
    second = slice(N, 2 * N)
    alone = KinematicSmoother(fs=1 / DT, noise=dict(pipe[0].noise_), joint=False)
    expected = alone.fit_transform(tests.table.iloc[second])
    assert np.allclose(features.iloc[second], expected, rtol=1e-6, atol=1e-9)


def test_without_ids_the_seams_are_smoothed_over(tests):
    careless = make_pipeline(
        KinematicSmoother(fs=1 / DT, joint=False),
        NRFRegressor(degree=1, coordinates="absolute"),
    )
    careless.fit(tests.table, tests.F)
    careful = tests.fit(pipeline())
    error = worst(careful[-1].masses_, tests.m)
    assert worst(careless[-1].masses_, tests.m) > error


@pytest.fixture(scope="module")
def filtered(tests):
    """A pipeline whose filter masks the edges of every record."""
    return tests.fit(pipeline(band=(None, 80.0)))


def test_masked_edges_of_every_record_are_left_out(tests, filtered):
    rows = tests.features(filtered).notna().all(axis=1).to_numpy()
    edge = filtered[0].edge_
    assert edge > 5
    assert (~rows).sum() == 6 * edge
    assert not rows[N - edge : N + edge].any()
    assert filtered[-1].n_samples_ == rows.sum()
    predicted = filtered.predict(tests.table, **tests.metadata)
    assert np.array_equal(np.isfinite(predicted).all(axis=1), rows)


def test_a_score_is_of_the_rows_inside_the_edges(tests, filtered):
    """R^2 of the accelerations by hand."""
    features = tests.features(filtered)
    rows = features.notna().all(axis=1).to_numpy()
    a = features.loc[rows, ["a1", "a2"]].to_numpy()
    predicted = filtered.predict(tests.table, **tests.metadata)
    gap = (tests.F[rows] - predicted[rows]) / filtered[-1].masses_
    expected = 1 - (gap**2).sum() / ((a - a.mean(axis=0)) ** 2).sum()
    score = filtered.score(tests.table, tests.F, **tests.metadata)
    scored = scorers.acceleration(filtered, tests.table, tests.F, **tests.metadata)
    assert score == pytest.approx(expected, abs=1e-12)
    assert scored == pytest.approx(expected, abs=1e-12)


# -- cross-validation ----------------------------------------------------------


def test_cross_validation_of_the_whole_pipeline(tests):
    scoring = {"balance": scorers.balance, "acceleration": scorers.acceleration}
    pipe = pipeline(band=(None, 80.0))
    scores = tests.cross_validate(pipe, whole_records(), scoring)
    assert (scores["test_acceleration"] > 0.98).all()
    for i, name in enumerate(np.unique(tests.record)):
        held_out = tests.rows(tests.record == name)
        model = scores["estimator"][i]
        data = held_out.table, held_out.F
        expected = model.score(*data, **held_out.metadata)
        assert scores["test_acceleration"][i] == pytest.approx(expected, abs=1e-12)
        expected = scorers.balance(model, *data, **held_out.metadata)
        assert scores["test_balance"][i] == expected


def test_gaps_that_blocks_in_time_leave_are_not_smoothed_over(tests):
    splitter, pipe = BlockedTimeSplit(3, gap=50), pipeline(band=(None, 80.0))
    scores = tests.cross_validate(pipe, splitter, scorers.balance)
    middle = scores["estimator"][1]
    # of each record the middle block is held out, and 50 samples on either side
    n_rows = 3 * (N - N // 3 - 2 * 50)
    n_pieces = 3 * 2
    assert middle[-1].n_samples_ == n_rows - n_pieces * 2 * middle[0].edge_
    assert (-scores["test_score"] < 30).all()


def test_a_search_over_smoother_and_degree(tests):
    two = tests.rows(slice(0, 2 * N))
    search = GridSearchCV(
        pipeline(),
        {"kinematicsmoother__band": [(None, 100.0)], "nrfregressor__degree": [1, 2]},
        cv=whole_records(),
        scoring=scorers.acceleration,
    )
    search.fit(two.table, two.F, **two.metadata)
    assert search.best_estimator_[-1].masses_ == pytest.approx(two.m, rel=0.03)
    assert search.score(two.table, two.F, **two.metadata) > 0.99


def test_base_acceleration_and_covariates_reach_fit_and_score():
    """A damper switched by a voltage, on one DOF that is shaken at its base."""
    rng = np.random.default_rng(0)
    m, c, k, _ = chains.parameters(1, rng, cubic=False)
    ag = chains.band_limited(3 * N, DT, rng, rms=2.0)
    u = np.repeat([0.0, 1.0, 2.0, 0.5, 1.5], 3 * N // 5)
    s = chains.band_limited(3 * N, DT, rng, rms=1e-3, band=(1.0, 20.0))
    v = np.gradient(s, DT)
    F = chains.band_limited(3 * N, DT, rng, rms=50.0)
    damper = (20.0 + 40.0 * u) * np.sign(v) + 300.0 * u * v
    a = (F - c * v - k * s - damper) / m

    declared = {"storey 1": [laws.PowerSeries(1), laws.CovariateFriction("u")]}
    metadata = {
        "record": np.repeat([1, 2, 3], N),
        "covariates": pd.DataFrame({"u": u}),
        "base_acceleration": ag,
    }
    scores = cross_validate(
        regressor(laws=declared),
        np.column_stack([a, v, s]),
        F[:, None],
        cv=whole_records(),
        params=metadata,
        return_estimator=True,
        error_score="raise",
    )
    assert (scores["test_score"] > 1 - 1e-9).all()
    for model in scores["estimator"]:
        assert worst(model.masses_, m) < 1e-8


# -- laws that remember the path -----------------------------------------------


class Dahl:
    """Three tests of the paper's chain with its damper, one below the other."""

    laws = {1: [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]}

    def __init__(self):
        cases = [chains.paper_case(seed=s, duration=0.8)[0] for s in (0, 1, 2)]
        self.n = len(cases[0].X)
        self.dt = cases[0].dt
        self.m = cases[0].m
        self.X = np.vstack([case.X for case in cases])
        self.F = np.vstack([case.F for case in cases])
        self.record = np.repeat(["one", "two", "three"], self.n)
        self.time = np.tile(np.arange(self.n) * self.dt, 3)


@pytest.fixture(scope="module")
def three_dahl():
    return Dahl()


@pytest.fixture(scope="module")
def models_of_folds(three_dahl):
    """One model for each record held out, and its score."""
    test = three_dahl
    return cross_validate(
        regressor(degree=1, laws=test.laws),
        test.X,
        test.F,
        cv=whole_records(),
        params={"record": test.record, "time": test.time},
        return_estimator=True,
        error_score="raise",
    )


def test_a_law_with_memory_starts_anew_with_every_record(three_dahl, models_of_folds):
    assert (models_of_folds["test_score"] > 1 - 1e-9).all()
    for model in models_of_folds["estimator"]:
        assert worst(model.masses_, three_dahl.m) < 1e-4


def test_a_state_that_runs_on_spoils_the_masses(three_dahl, models_of_folds):
    test = three_dahl
    as_one = NRFRegressor(degree=1, laws=test.laws, dt=test.dt).fit(test.X, test.F)
    errors = [worst(m.masses_, test.m) for m in models_of_folds["estimator"]]
    assert worst(as_one.masses_, test.m) > 10 * max(errors)


@pytest.fixture(params=["time", "dt", "index"])
def clocked(request, three_dahl):
    """One record whose samples have a time in some way: X, metadata, sampling step."""
    test, n = three_dahl, three_dahl.n
    X = test.X[:n]
    metadata = {}
    dt = None
    if request.param == "time":
        metadata = {"time": test.time[:n]}
    elif request.param == "dt":
        dt = test.dt
    else:
        index = pd.Index(test.time[:n], name="t")
        X = pd.DataFrame(X, columns=["a1", "a2", "v1", "v2", "s1", "s2"], index=index)
    return X, metadata, dt


def test_a_law_with_memory_refuses_shuffled_folds(three_dahl, clocked):
    X, metadata, dt = clocked
    F = three_dahl.F[: len(X)]
    model = regressor(degree=1, laws=three_dahl.laws, dt=dt)
    shuffled = KFold(5, shuffle=True, random_state=0)
    with pytest.raises(LawError, match="law remembers the path"):
        cross_validate(model, X, F, cv=shuffled, params=metadata, error_score="raise")


def test_a_law_with_memory_refuses_shuffled_samples(three_dahl, clocked):
    X, metadata, dt = clocked
    mixed = np.random.default_rng(0).permutation(len(X))
    F = three_dahl.F[mixed]
    X = X.iloc[mixed] if isinstance(X, pd.DataFrame) else X[mixed]
    metadata = {name: values[mixed] for name, values in metadata.items()}
    model = regressor(degree=1, laws=three_dahl.laws, dt=dt)
    with pytest.raises((LawError, ChannelError), match="shuffle|law remembers"):
        model.fit(X, F, **metadata)


def test_records_themselves_are_the_samples_of_a_search():
    parameters = chains.parameters(2, np.random.default_rng(4), cubic=False)
    records = []
    for seed in (1, 2, 3):
        case = chains.duffing(
            2,
            [1, 2],
            seed=seed,
            n_samples=N,
            parameters_of_chain=parameters,
            substeps=2,
        )
        records.append(case.record())
    search = GridSearchCV(
        NRFRegressor(), {"degree": [1, 3]}, cv=LeaveOneOut(), scoring=scorers.free_run
    )
    search.fit(records)
    assert worst(search.best_estimator_.masses_, parameters[0]) < 0.02
    assert search.cv_results_["mean_test_score"][0] > -5.0
