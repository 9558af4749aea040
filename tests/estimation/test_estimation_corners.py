"""Selection, intervals and delays where folds, forces or evidence are missing: the cause in words, or the right answer."""

import pickle
import warnings
from dataclasses import replace

import chains
import numpy as np
import pandas as pd
import pysindy as ps
import pytest

from pysindy_nrf import (
    Chain,
    ChainModel,
    NRFRegressor,
    Record,
    RecordSplit,
    Site,
    excitation,
    laws,
    one_standard_error,
    select_order,
    simulate,
)
from pysindy_nrf.data.io import frequency_response
from pysindy_nrf.diagnostics import force_delay
from pysindy_nrf.discrepancy import second_opinion
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.second_opinion import unbiased_errors
from pysindy_nrf.discrepancy.splits import split
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.estimation import iv
from pysindy_nrf.estimation.frequency import fit_frequency_response
from pysindy_nrf.exceptions import BiasWarning, ChainError, ChannelError, IdentifiabilityError, NRFError
from pysindy_nrf.regression.domains import VisitedRegion
from pysindy_nrf.selection import AlongPath, BlockedTimeSplit, scorers, select_sparsity
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")

FS = 500.0
LINEAR = {f"storey {i}": [laws.PowerSeries(1, [60.0, 1e5])] for i in (1, 2)}
TRUTH = ChainModel([10.0, 12.0], LINEAR)


def record(seed=0, dofs=(1, 2), duration=6.0, rms=100.0, noise=0.0, name="r"):
    F = excitation.band_limited_random(2, duration, FS, dofs=dofs, rms=rms, band=(0.5, 40.0), random_state=seed)
    rec = simulate(TRUTH, F, 1 / FS, hold="cubic", name=name)
    return add_noise(rec, noise, random_state=seed + 1) if noise else rec


def unknown_on(rec, dof):
    force = rec.force.copy()
    force[:, dof - 1] = np.nan
    return rec.replace(force=force)


# -- orders and terms -------------------------------------------------------------------------


def hit_once():
    """Two records, the second of them free: a fold that must do without the first has no force to scale it."""
    free = Record(force=np.zeros((1500, 2)), acceleration=np.ones((1500, 2)), velocity=np.ones((1500, 2)),
                  displacement=np.ones((1500, 2)), fs=FS, name="free")  # fmt: skip
    t = np.arange(1500)[:, None] / FS
    w = 2 * np.pi * np.array([[5.0, 9.0]])
    x = 1e-3 * np.sin(w * t)
    free = free.replace(displacement=x, velocity=1e-3 * w * np.cos(w * t), acceleration=-(w**2) * x)
    return [record(noise=0.01), free]


def test_a_fold_without_a_force_says_so():
    records = hit_once()
    with pytest.raises(NRFError, match="No candidate could be fitted and scored on every fold"):
        select_order(records, degrees=[1, 2], cv=RecordSplit())


def test_the_rule_may_be_the_users_own():
    rec = record(noise=0.02)
    last = select_order(rec, degrees=[1, 2, 3], rule=lambda results: len(results["params"]) - 1)
    best = select_order(rec, degrees=[1, 2, 3], rule="best")
    plain = select_order(rec, degrees=[1, 2, 3])
    assert last.best_order == 3 and plain.best_order == 1
    errors = best.fold_scores.mean(axis=1)  # scores: the larger the better
    assert str(best.best_order) == errors.idxmax()
    assert repr(plain) == "OrderSelection(best_order=1, 3 orders, 5 folds)"
    with pytest.raises(NRFError, match="rule='first' is unknown"):
        select_order(rec, degrees=[1], rule="first")


def test_the_simplest_within_one_standard_error_by_any_complexity():
    """Three models, equal within the scatter of their folds: the least complex is the one a rule calls so."""
    scores = np.array([[-10.0, -12.0, -11.0], [-9.5, -12.0, -11.2], [-9.8, -11.9, -11.0]])
    results = {"params": [{"alpha": a} for a in (3, 1, 2)], "mean_test_score": scores.mean(axis=1)}
    results |= {f"split{k}_test_score": scores[:, k] for k in range(3)}
    assert one_standard_error(results, complexity=lambda params: params["alpha"]) == 1
    assert one_standard_error(results, complexity=[1, 3, 2]) == 0
    orders = {**results, "params": [{"orders": {"storey 1": q}, "degree": 1} for q in (5, 3, 1)]}
    assert one_standard_error(orders) == 2


def test_sparsity_asks_for_paths_that_exist():
    rec = record(noise=0.01)
    with pytest.raises(NRFError, match="no default path 'LASSO'. Choose from"):
        select_sparsity(rec, paths=["LASSO"])
    with pytest.raises(NRFError, match="no optimizer to choose from"):
        select_sparsity(rec, paths={})
    found = select_sparsity(rec, degree=2, paths={"STLSQ": [ps.STLSQ(threshold=t) for t in (1e-3, 0.5)]})
    assert repr(found).startswith("SparsitySelection(best='STLSQ'; STLSQ ")
    settings = [setting for name, setting in found.table.index if name == "STLSQ"]
    kept = [len(found.support("STLSQ", setting)) for setting in settings]
    assert max(kept) >= 4 and found.support("STLSQ", "no such setting") == []


def test_a_threshold_beyond_every_term_is_no_candidate():
    """Nothing is left of any force: an error of nearly 100 %, not an exception."""
    rec = record(noise=0.01)
    paths = {"STLSQ": [ps.STLSQ(threshold=1e-3), ps.STLSQ(threshold=1e9)], "none": [ps.STLSQ(threshold=1e9)]}
    found = select_sparsity(rec, degree=2, paths=paths)
    assert 90 < found.table.loc["none", "error"].iloc[0] < 101
    assert found.best == "STLSQ"


def test_along_a_path_of_one_column_and_never_of_two_targets():
    x = np.linspace(1.0, 2.0, 50)[:, None]
    np.testing.assert_allclose(AlongPath(ps.SSR(), tolerance=1e-6).fit(x, 3 * x).coef_, [[3.0]])
    np.testing.assert_array_equal(AlongPath(ps.SSR(), tolerance=2.0).fit(x, 3 * x).coef_, [[0.0]])
    with pytest.raises(NRFError, match="got 2 targets"):
        AlongPath(ps.SSR()).fit(x, np.hstack([x, x]))


def test_splits_and_scorers_name_themselves():
    assert repr(BlockedTimeSplit(4)).startswith("BlockedTimeSplit(n_splits=4")
    with pytest.raises(ChannelError, match="3 record ids for 4 samples"):
        list(RecordSplit().split(np.zeros((4, 3)), groups=[1, 1, 2]))
    plain = scorers.get_scorer("balance")
    asked = pickle.loads(pickle.dumps(plain))
    assert asked == plain and len({asked, plain}) == 1
    other = pickle.loads(pickle.dumps(plain.set_score_request(record=False)))
    assert other != plain and repr(other) == repr(plain)


# -- what limits an estimate ------------------------------------------------------------------


def test_instruments_need_a_record_whose_forces_are_all_known():
    """Floor 2 has a force nobody measured; floor 1 is enough where m2 is known, but a free run needs all forces."""
    rec = record(noise=0.03)
    hidden = unknown_on(rec, 2)
    for kind in ("iv", "simulation"):
        with pytest.warns(BiasWarning, match="in every record the force on some DOF is unknown"):
            model = NRFRegressor(degree=1, estimation=kind, known_masses={2: 12.0}).fit([hidden, hidden.replace(name="s")])
        assert model.model_.info["estimation"]["found"] == "ls"


def test_a_record_with_an_unknown_force_is_left_out_of_the_instruments_alone():
    pair = record(noise=0.03), unknown_on(record(seed=5, noise=0.03, name="wind"), 1)
    X, F = (np.vstack([rec.to_features()[k] for rec in pair]) for k in (0, 1))
    ids = np.repeat([0, 1], [rec.n_samples for rec in pair])
    model = NRFRegressor(degree=1, estimation="iv", dt=1 / FS).fit(X, F, record=ids)
    facts = model.model_.info["estimation"]
    assert facts["found"] == "iv" and "1 records with an unknown force were left out" in str(facts)
    assert np.abs(model.masses_ / [10.0, 12.0] - 1).max() < 0.03
    refined = NRFRegressor(degree=1, estimation="simulation", dt=1 / FS).fit(X, F, record=ids)
    assert np.abs(refined.masses_ / [10.0, 12.0] - 1).max() < 0.03


def test_instruments_take_records_with_different_unknown_forces_as_they_are():
    """The same two records as a list: least squares takes them, and so should the instruments."""
    pair = [record(noise=0.03), unknown_on(record(seed=5, noise=0.03, name="wind"), 1)]
    model = NRFRegressor(degree=1, estimation="iv").fit(pair)
    assert np.abs(model.masses_ / [10.0, 12.0] - 1).max() < 0.03


def test_intervals_of_coefficients_and_levels_that_are_none():
    model = NRFRegressor(degree=1).fit(record(noise=0.01))
    whole = model.confidence_intervals()
    part = model.confidence_intervals(of="coefficients")
    assert list(part["parameter"]) == [p for p in whole["parameter"] if ":" in p]
    for level in ("high", 95, 0.0):
        with pytest.raises(ChainError, match=f"level={level!r} is not a level of confidence"):
            model.confidence_intervals(level)
    X, F = record(noise=0.01).to_features(smooth=False)
    timeless = NRFRegressor(degree=1).fit(X.to_numpy(), F.to_numpy())
    with pytest.raises(ChannelError, match="Energies need the sampling step"):
        timeless.confidence_intervals(of="energies")
    with pytest.raises(ChannelError, match="before saving the model"):
        pickle.loads(pickle.dumps(model)).confidence_intervals(of="energies")


def test_a_few_samples_bear_no_interval():
    case = chains.duffing(1, [1], seed=1, n_samples=30, cubic=False)
    model = NRFRegressor(degree=1).fit(case.X[:7], case.F[:7])
    for method in ("hac", "bootstrap"):
        with pytest.raises(ChannelError, match="pieces of data are too few to judge"):
            model.confidence_intervals(method=method)


def test_a_single_blow_carries_the_whole_estimate():
    """All that excites storey 2 lies in one piece: without it nothing can be solved, and no interval is invented."""
    F = np.zeros((6000, 2))
    F[3000:3010, 1] = 500 * np.sin(np.pi * np.arange(10) / 9)
    damped = ChainModel([10.0, 12.0], {f"storey {i}": [laws.PowerSeries(1, [4e3, 1e5])] for i in (1, 2)})
    model = NRFRegressor(degree=1).fit(simulate(damped, F, 1 / FS))
    with pytest.raises(IdentifiabilityError, match="A single stretch of the data carries the estimate"):
        model.confidence_intervals()
    assert "No interval can be given: A single stretch of the data" in " ".join(str(model.diagnose()).split())


def test_delays_beyond_reach_or_without_data_are_not_told(tmp_path):
    rec = record(duration=8.0)
    far = rec.replace(force=np.roll(rec.force, 60, axis=0))
    table = force_delay(NRFRegressor(degree=1).fit(far))
    assert table["samples"].isna().all() and table["message"].str.contains("No delay of F. can be told").all()
    short = rec.replace(**{k: getattr(rec, k)[:150] for k in ("force", "acceleration", "velocity", "displacement")})
    with pytest.raises(ChannelError, match="No balance tells the delay of its force"):
        force_delay(NRFRegressor(degree=1).fit(*short.to_features(smooth=False)))
    model = NRFRegressor(degree=1).fit(rec)
    late = rec.replace(force=np.roll(rec.force, 3, axis=0))
    X, F = late.to_features(smooth=False)
    assert force_delay(model, X, F)["samples"].to_numpy() == pytest.approx([3.0, 3.0], abs=0.05)
    model = pickle.loads(pickle.dumps(model))  # the data are not saved with it
    with pytest.raises(ChannelError, match="loaded without the data"):
        force_delay(model)


def test_frequency_responses_are_linear_and_need_lines():
    f = np.linspace(2.0, 25.0, 40)
    w = 2 * np.pi * f
    H = -(w**2) / (1e4 - 2.0 * w**2 + 8j * w)
    response = frequency_response(f, H[:, None])
    with pytest.raises(ChainError, match="estimation='simulation' does not work on frequency responses"):
        fit_frequency_response(NRFRegressor(degree=1, estimation="simulation"), response)
    few = frequency_response(f[:4], H[:4, None])
    with pytest.raises(ChannelError, match="has 4 lines"):
        fit_frequency_response(NRFRegressor(degree=1, estimation="iv"), few)


def test_a_plan_without_a_floor_to_hit_asks_for_a_mass():
    plan = Chain(3).plan(can_hit=[])
    assert not len(plan.table) and "No floor can be hit with a known force" in str(plan)


@pytest.mark.parametrize(
    "broken", [dict(low=[0.0]), dict(high=[np.inf, 1.0]), dict(cells=[]), dict(cells=["", ""])]
)
def test_a_visited_region_is_a_rectangle_of_cells(broken):
    t = np.linspace(0, 6.3, 500)
    region = VisitedRegion.of(0.1 * np.cos(t), 0.001 * np.sin(t)).to_dict()
    assert VisitedRegion.from_dict(region).low == pytest.approx((-0.1, -0.001), rel=1e-2)
    with pytest.raises(ChannelError, match="not a rectangle of cells"):
        VisitedRegion.from_dict(region | broken)


def test_weights_and_columns_of_another_fit_are_refused():
    X, F = record().to_features(smooth=False)
    model = NRFRegressor(degree=1).fit(X, F)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises((ChannelError, ValueError), match="sample_weight has 5 values"):
            model.score(X, F, sample_weight=np.ones(5))
    from pysindy_nrf.regression.feature_library import InterstoryPolynomialLibrary

    frame = pd.DataFrame(np.zeros((5, 6)), columns=["a1", "a2", "v1", "v2", "s1", "s2"])
    library = InterstoryPolynomialLibrary(1).fit(frame)
    with pytest.raises(ChannelError, match="not those of fit"):
        library.transform(frame.rename(columns={"a1": "b1"}))


@pytest.mark.parametrize(
    ("alike", "kept"),
    [
        ([0.95, 0.99, 0.97, -0.07], 1),  # the second run is that of what round 1 found
        ([0.95, 0.96, 0.99, 0.3], 2),
        ([0.95, 0.90, 0.80, 0.4], None),  # least squares, which the first round begins with, runs better than any
        ([0.95, 0.2], None),
        ([0.3, 0.2, 0.1], None),  # the linear chain is tried too, and least squares where the motion is lively
    ],
)
def test_rounds_that_go_astray_give_way_to_the_one_that_runs_like_the_structure(monkeypatch, alike, kept):
    """What a round found is seen in the run that the next one begins with: the last is the first to be doubted."""
    runs = iter(alike)
    whole = iv._runs
    monkeypatch.setattr(iv, "_runs", lambda *a: (whole(*a)[0], next(runs)))
    monkeypatch.setattr(iv, "weighting_of", lambda *a: None)
    monkeypatch.setattr(iv, "SETTLED", 0.0)
    with pytest.warns(BiasWarning, match="fell back" if kept is None else f"The estimate of round {kept} is kept"):
        model = NRFRegressor(degree=1, estimation="iv").fit(add_noise(record(3), 0.04, random_state=9)).model_
    assert model.info["estimation"]["found"] == ("ls" if kept is None else "iv")
    assert kept is None or model.info["estimation"]["rounds"] == kept


def test_instruments_that_went_astray_have_no_say_against_an_effect(monkeypatch):
    """A gain of a half by least squares, of which noise explains nothing, is not refused by rounds that diverged."""
    rec = add_noise(record(3, duration=10.0), 0.04, random_state=9)
    ready = prepare([rec])
    work = Workspace(ready.data, [None], *split(ready.data.segments), {}, "auto")
    stage = Stage(work, Chain(2), {s: tuple(held) for s, held in ((Site(k), v) for k, v in LINEAR.items())})
    found = unbiased_errors(stage, ready)
    assert found is not None and np.isfinite(found).all()
    whole = second_opinion.instrumental_variables
    monkeypatch.setattr(second_opinion, "instrumental_variables", lambda *a: replace(whole(*a), settled=False))
    assert unbiased_errors(stage, ready) is None
