"""Raw channels to a model in one scikit-learn pipeline; records, time, base and
covariates as routed metadata.
"""

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
)
from pysindy_nrf.exceptions import ChannelError, LawError
from pysindy_nrf.selection import scorers

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")


def whole_records():
    """Held out one by one; the ids come as metadata named record."""
    return LeaveOneGroupOut().set_split_request(groups="record")


DT, N = 1e-3, 1200
ROUTED = dict(record=True, time=True, base_acceleration=True, covariates=True)


@pytest.fixture(autouse=True, scope="module")
def _routing():
    with config_context(enable_metadata_routing=True):
        yield


@pytest.fixture(scope="module")
def tests():
    """Three tests of one linear chain, one below the other: channels, forces, record
    ids, clock.
    """
    given = chains.parameters(2, np.random.default_rng(4), cubic=False)
    cases = [
        chains.duffing(2, [2], seed=s, n_samples=N, given=given, substeps=2)
        for s in (1, 2, 3)
    ]
    rng = np.random.default_rng(0)
    raw = []
    for case in cases:
        x = case.s.cumsum(axis=1)
        channels = np.hstack([case.a, x])
        raw.append(
            channels + 0.01 * channels.std(axis=0) * rng.standard_normal(channels.shape)
        )
    table = pd.DataFrame(np.vstack(raw), columns=["a1", "a2", "x1", "x2"])
    return (
        cases,
        table,
        np.vstack([c.F for c in cases]),
        np.repeat(["one", "two", "three"], N),
        np.tile(np.arange(N) * DT, 3),
    )


def regressor(**options):
    routed = {k: True for k in ROUTED}
    return (
        NRFRegressor(**options)
        .set_fit_request(**routed)
        .set_score_request(**routed)
        .set_predict_request(**routed)
    )


def smoother(**options):
    routed = dict(record=True, time=True)
    return (
        KinematicSmoother(fs=1 / DT, **options)
        .set_fit_request(**routed)
        .set_transform_request(**routed)
    )


def whole(**options):
    options = {"joint": False, **options}
    return make_pipeline(
        smoother(**options), regressor(degree=1, coordinates="absolute")
    )


def test_raw_channels_to_masses_record_by_record(tests):
    """Each record is fused by itself: the same as fusing three Records."""
    cases, table, F, ids, time = tests
    pipe = whole().fit(table, F, record=ids, time=time)
    assert worst(pipe[-1].masses_, cases[0].m) < 0.02
    smooth = pipe[:-1].transform(table, record=ids, time=time)
    assert list(smooth.columns) == ["a1", "a2", "v1", "v2", "x1", "x2"]
    alone = KinematicSmoother(
        fs=1 / DT, noise=dict(pipe[0].noise_), joint=False
    ).fit_transform(table.iloc[N : 2 * N])
    assert np.allclose(smooth.iloc[N : 2 * N], alone, rtol=1e-6, atol=1e-9)
    careless = make_pipeline(
        KinematicSmoother(fs=1 / DT, joint=False),
        NRFRegressor(degree=1, coordinates="absolute"),
    ).fit(table, F)
    assert worst(careless[-1].masses_, cases[0].m) > worst(
        pipe[-1].masses_, cases[0].m
    )  # the seams are smoothed over


def test_masked_edges_of_every_record_are_left_out_and_scored_correctly(tests):
    cases, table, F, ids, time = tests
    pipe = whole(band=(None, 80.0)).fit(table, F, record=ids, time=time)
    X = pipe[:-1].transform(table, record=ids, time=time)
    rows = X.notna().all(axis=1).to_numpy()
    edge = pipe[0].edge_
    assert (
        edge > 5 and (~rows).sum() == 6 * edge and not rows[N - edge : N + edge].any()
    )
    assert pipe[-1].n_samples_ == rows.sum()
    predicted = pipe.predict(table, record=ids, time=time)
    assert np.array_equal(np.isfinite(predicted).all(axis=1), rows)
    # R^2 of the accelerations by hand, from the finite rows alone
    a, gap = (
        X.loc[rows, ["a1", "a2"]].to_numpy(),
        (F[rows] - predicted[rows]) / pipe[-1].masses_,
    )
    by_hand = 1 - (gap**2).sum() / ((a - a.mean(axis=0)) ** 2).sum()
    assert pipe.score(table, F, record=ids, time=time) == pytest.approx(
        by_hand, abs=1e-12
    )
    assert scorers.acceleration(pipe, table, F, record=ids, time=time) == pytest.approx(
        by_hand, abs=1e-12
    )


def test_cross_validation_of_the_whole_pipeline(tests):
    cases, table, F, ids, time = tests
    found = cross_validate(
        whole(band=(None, 80.0)),
        table,
        F,
        cv=whole_records(),
        params={"record": ids, "time": time},
        return_estimator=True,
        scoring={"balance": scorers.balance, "acceleration": scorers.acceleration},
        error_score="raise",
    )
    assert len(found["test_balance"]) == 3 and (found["test_acceleration"] > 0.98).all()
    for i, name in enumerate(np.unique(ids)):
        rows = ids == name
        model = found["estimator"][i]
        assert model[0].noise_.index.tolist() == list(table.columns)
        again = model.score(table[rows], F[rows], record=ids[rows], time=time[rows])
        assert found["test_acceleration"][i] == pytest.approx(again, abs=1e-12)
        assert found["test_balance"][i] == scorers.balance(
            model, table[rows], F[rows], record=ids[rows], time=time[rows]
        )


def test_blocks_in_time_leave_gaps_that_are_not_smoothed_over(tests):
    cases, table, F, ids, time = tests
    found = cross_validate(
        whole(band=(None, 80.0)),
        table,
        F,
        cv=BlockedTimeSplit(3, gap=50),
        params={"record": ids, "time": time},
        scoring=scorers.balance,
        return_estimator=True,
        error_score="raise",
    )
    edge, middle = found["estimator"][1][0].edge_, found["estimator"][1][-1]
    pieces = (
        3 * 2
        # of each record the block in the middle is held out, 50 samples on either side
        # of it left out
    )
    assert middle.n_samples_ == 3 * (N - N // 3 - 2 * 50) - pieces * 2 * edge
    assert (-found["test_score"] < 30).all()


def test_a_search_over_smoother_and_degree(tests):
    cases, *every = tests
    table, F, ids, time = (of[: 2 * N] for of in every)
    search = GridSearchCV(
        whole(),
        {"kinematicsmoother__band": [(None, 100.0)], "nrfregressor__degree": [1, 2]},
        cv=whole_records(),
        scoring=scorers.acceleration,
    ).fit(table, F, record=ids, time=time)
    assert search.best_estimator_[-1].masses_ == pytest.approx(cases[0].m, rel=0.03)
    assert search.score(table, F, record=ids, time=time) > 0.99


def test_base_acceleration_and_covariates_reach_fit_and_score():
    """A damper switched by a voltage, on a chain shaken at its base: wrong rows of
    either would ruin the fold.
    """
    rng = np.random.default_rng(0)
    ag = chains.band_limited(3 * N, DT, rng, rms=2.0)
    u = np.repeat([0.0, 1.0, 2.0, 0.5, 1.5], 3 * N // 5)
    m, c, k, _ = chains.parameters(1, rng, cubic=False)
    # one DOF: the motion needs no integrator to close the balance, only a, v, s that
    # satisfy it
    s = chains.band_limited(3 * N, DT, rng, rms=1e-3, band=(1.0, 20.0))
    v = np.gradient(s, DT)
    F = chains.band_limited(3 * N, DT, rng, rms=50.0)
    a = (F - c * v - k * s - (20.0 + 40.0 * u) * np.sign(v) - 300.0 * u * v) / m
    X = np.column_stack([a, v, s])
    damper = {"storey 1": [laws.PowerSeries(1), laws.CovariateFriction("u")]}
    ids = np.repeat([1, 2, 3], N)
    found = cross_validate(
        regressor(laws=damper),
        X,
        F[:, None],
        cv=whole_records(),
        error_score="raise",
        return_estimator=True,
        params={
            "record": ids,
            "covariates": pd.DataFrame({"u": u}),
            "base_acceleration": ag,
        },
    )
    assert (found["test_score"] > 1 - 1e-9).all()
    assert all(worst(e.masses_, m) < 1e-8 for e in found["estimator"])


@pytest.fixture(scope="module")
def two_dahl():
    cases = [chains.paper_case(seed=s, duration=0.8)[0] for s in (0, 1, 2)]
    n = len(cases[0].X)
    held = {1: [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]}
    X, F = np.vstack([c.X for c in cases]), np.vstack([c.F for c in cases])
    return (
        cases,
        X,
        F,
        np.repeat(["one", "two", "three"], n),
        np.tile(np.arange(n) * cases[0].dt, 3),
        held,
    )


def test_a_law_with_memory_restarts_at_every_record(two_dahl):
    cases, X, F, ids, time, held = two_dahl
    params = {"record": ids, "time": time}
    found = cross_validate(
        regressor(degree=1, laws=held),
        X,
        F,
        cv=whole_records(),
        params=params,
        return_estimator=True,
        error_score="raise",
    )
    assert (
        found["test_score"] > 1 - 1e-9
    ).all()  # the state is known only if it starts anew where the record does
    assert all(worst(e.masses_, cases[0].m) < 1e-4 for e in found["estimator"])
    run_on = NRFRegressor(degree=1, laws=held, dt=cases[0].dt).fit(
        X, F
    )  # as if it were one record
    assert worst(run_on.masses_, cases[0].m) > 10 * max(
        worst(e.masses_, cases[0].m) for e in found["estimator"]
    )


@pytest.mark.parametrize("clock", ["time", "dt", "index"])
def test_a_law_with_memory_refuses_shuffled_folds(two_dahl, clock):
    cases, X, F, ids, time, held = two_dahl
    cv = KFold(5, shuffle=True, random_state=0)
    n = len(cases[0].X)
    model = regressor(degree=1, laws=held, dt=cases[0].dt if clock == "dt" else None)
    X1, F1, params = X[:n], F[:n], {"time": time[:n]} if clock == "time" else {}
    if clock == "index":
        X1 = pd.DataFrame(
            X1,
            columns=["a1", "a2", "v1", "v2", "s1", "s2"],
            index=pd.Index(time[:n], name="t"),
        )
    with pytest.raises(LawError, match="law remembers the path"):
        cross_validate(model, X1, F1, cv=cv, params=params, error_score="raise")
    mixed = np.random.default_rng(0).permutation(n)
    with pytest.raises((LawError, ChannelError), match="never shuffle|law remembers"):
        model.fit(
            X1.iloc[mixed] if clock == "index" else X1[mixed],
            F1[mixed],
            **{k: v[mixed] for k, v in params.items()},
        )


def test_a_search_over_whole_records():
    """Records themselves are the samples: nothing to route."""
    given = chains.parameters(2, np.random.default_rng(4), cubic=False)
    records = [
        chains.duffing(
            2, [1, 2], seed=k, n_samples=1200, given=given, substeps=2
        ).record()
        for k in (1, 2, 3)
    ]
    search = GridSearchCV(
        NRFRegressor(), {"degree": [1, 3]}, cv=LeaveOneOut(), scoring=scorers.free_run
    ).fit(records)
    assert worst(search.best_estimator_.masses_, given[0]) < 0.02
    assert search.cv_results_["mean_test_score"][0] > -5.0
