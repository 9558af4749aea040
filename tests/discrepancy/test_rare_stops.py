"""Where evidence and loop stop for a rare reason: noise alone, too few blocks, unknown forces, channels that contradict."""

import numpy as np
import pytest
import report_cases
from chains import duffing

from pysindy_nrf import ChainModel, NRFRegressor, Record, Site, close_loop, excitation, laws, simulate
from pysindy_nrf.discrepancy.admissible import admissible
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.contradictions import _halves
from pysindy_nrf.discrepancy.dependence import jackknife, knots_of
from pysindy_nrf.discrepancy.detection import NOISE, detect
from pysindy_nrf.discrepancy.gate import FLOOR, MIN_WINS, judge
from pysindy_nrf.discrepancy.localisation import localise, missing_force
from pysindy_nrf.discrepancy.noise_floor import NoiseFloor
from pysindy_nrf.discrepancy.noise_level import quiet_level
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.reestimate import needless, reestimated
from pysindy_nrf.discrepancy.residual import filters_of, free_run_residual, residual_of
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.discrepancy.second_opinion import _rough
from pysindy_nrf.discrepancy.splits import split
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.surrogate import force_noise
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.regression.input_arrays import from_arrays

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")


def linear(case, **more):
    held = {i + 1: [laws.LinearViscous(case.c[i]), laws.LinearElastic(case.k[i])] for i in range(case.n)}
    return ChainModel(case.m, held | more)


def case_of(n=2, seed=1, **more):
    return duffing(n, range(1, n + 1), seed=seed, n_samples=2500, cubic=False, **more)


def stage_of(rec, held=None):
    ready = prepare(rec)
    search, kept = split(ready.data.segments, ready.heldout)
    work = Workspace(ready.data, [None] * len(ready.data.segments), search, kept, {}, "auto")
    chain = NRFRegressor(degree=1).problem(ready.data.n_dof).chain
    held = held or {Site(f"storey {i}"): (laws.LinearViscous(), laws.LinearElastic()) for i in range(1, 1 + rec.n_dof)}
    return Stage(work, chain, held)


# -- the gate ---------------------------------------------------------------------------------


def test_the_gate_asks_for_something_to_explain_and_for_most_blocks():
    """Arithmetic of the rule: nothing below the floor; a median that falls in a minority of the blocks is chance."""
    closed = judge(np.full(9, 0.5 * FLOOR), np.full(9, 1e-9))
    assert not closed.accepted and "nothing is left to explain" in closed.sentence
    before = np.array([10.0] * 5 + [1.0] * 4)
    after = np.array([2.0] * 5 + [1.5] * 4)
    chance = judge(before, after)
    wins = 5 / 9
    assert wins < MIN_WINS and not chance.accepted
    assert f"in {100 * wins:.0f} % of the blocks; at least {100 * MIN_WINS:.0f} % of the blocks are asked" in chance.sentence
    assert judge(before, np.where(before > 5, 2.0, 0.5)).accepted


def test_at_the_floor_of_noise_the_gate_asks_for_twice_what_noise_gives():
    """A tenth of noise's own bias, unknown to the surrogates, must not become an effect; a clear one must pass."""
    before = np.linspace(9.0, 11.0, 9)
    assert judge(before, 0.70 * before, null_gain=0.2).accepted
    refused = judge(before, 0.70 * before, null_gain=0.2, at_floor=True)
    assert not refused.accepted
    assert "45 % are asked (20 % come from noise alone)" in refused.sentence
    assert judge(before, 0.50 * before, null_gain=0.2, at_floor=True).accepted
    assert judge(before, 0.80 * before, null_gain=0.0, at_floor=True).accepted


def test_an_error_of_blocks_needs_three_of_them():
    assert np.isnan(jackknife(np.array([4.0, 4.0]), np.array([1.0, 1.0])))
    assert jackknife(np.full(5, 4.0), np.full(5, 1.0)) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_array_equal(knots_of(np.full(50, 3.0), 6), [2.0, 4.0])
    assert 0.0 in knots_of(np.linspace(-1, 1, 200), 6)


def test_a_law_driven_by_a_channel_may_feed_energy_in():
    """Passive dampers only resist; what an amplifier or a voltage drives may push."""
    sizes = np.ones(3)
    assert admissible(laws.CovariateFriction(), np.array([-5.0, -5.0, -5.0]), sizes)
    assert not admissible(laws.CoulombFriction(), np.array([-5.0]), sizes[:1])


def test_noise_that_cannot_be_told_is_none():
    """Short signals, and bands between two lines of the spectrum."""
    rng = np.random.default_rng(0)
    assert quiet_level(rng.standard_normal(200), 100.0) == 0.0
    left, force = rng.standard_normal((4000, 2)), np.ones((4000, 2))
    assert force_noise(left, force, 400.0, (10.1, 10.2)).tolist() == [0.0, 0.0]
    assert force_noise(left, force, 400.0) == pytest.approx([1.0, 1.0], rel=0.15)


def test_runs_too_short_to_be_halved_stay_whole():
    assert _halves([slice(0, 10)]) == [[slice(0, 10)]]
    first, second = _halves([slice(0, 6000), slice(8000, 14000)])
    length = [sum(run.stop - run.start for run in part) for part in (first, second)]
    assert sum(length) == 12000 and abs(length[0] - length[1]) <= 1


# -- residuals --------------------------------------------------------------------------------


def test_a_residual_names_its_parts():
    case = case_of()
    data = from_arrays(case.X, case.F, dt=case.dt)
    soft = linear(case, **{})
    residual = residual_of(soft.with_laws({1: [laws.LinearElastic(case.k[0])]}), data)
    np.testing.assert_allclose(residual.at("storey 1")[0], case.c[0] * case.v[:, 0], atol=1e-6 * np.abs(case.F).max())
    for name in ("storey 3", "dof 0", "floor 1", "dof one"):
        with pytest.raises(ChannelError, match=f"The residual has no '{name}'"):
            residual.at(name)
    lines = str(residual).splitlines()
    size = np.sqrt(np.mean((case.c[0] * case.v[:, 0]) ** 2))
    assert lines[0].startswith(f"dof 1: {size:.4g} N") and len(lines) == 4
    with pytest.raises(ChannelError, match="2 filters for 1 records"):
        filters_of(data, [None, None])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(dt=None), "the sampling step is not known"),
        (dict(masses=[1.0, -2.0]), "m2 is not positive"),
    ],
)
def test_a_free_run_that_is_not_possible_says_why(change, words):
    case = case_of()
    data = from_arrays(case.X, case.F, dt=change.get("dt", case.dt))
    model = ChainModel(change.get("masses", case.m), linear(case).laws)
    assert any(words in why for why in free_run_residual(model, data).reasons)


def test_no_place_where_no_balance_is_known_throughout():
    """Floor 1 unknown in one record, floor 2 in the other: nothing can be compared over both."""
    case = case_of()
    F = np.vstack([case.F, case.F])
    F[:2500, 0], F[2500:, 1] = np.nan, np.nan
    data = from_arrays(np.vstack([case.X, case.X]), F, dt=case.dt, record=np.repeat([0, 1], 2500))
    model = linear(case).with_laws({1: [laws.LinearElastic(case.k[0])]})
    with pytest.raises(ChannelError, match="No balance is known in every record"):
        localise(residual_of(model, data))
    hidden = case.F.copy()
    hidden[:, 0] = np.nan
    data = from_arrays(case.X, hidden, dt=case.dt)
    with pytest.raises(ChannelError, match="storey 1 is not seen in the known balances"):
        missing_force(residual_of(model, data), "storey 1")


def test_an_unknown_balance_is_not_tested_and_noise_says_what_it_is():
    """White noise of 1 N in the force of floor 2, a floor of 1 N beside it: once the floor, and no structure."""
    case = case_of(seed=4)
    F = case.F + np.random.default_rng(0).standard_normal(case.F.shape)
    data = from_arrays(case.X, F, dt=case.dt)
    residual = residual_of(linear(case), data)
    floor = NoiseFloor(np.ones(2), np.array([np.sqrt(2.0), 1.0]), "given")
    found = detect(residual, floor)
    assert (found.verdicts["verdict"] == NOISE).all() and "1 times the noise floor" in found.sentence
    assert str(found).count("\n") == len(found.verdicts) - 1
    F[:, 0] = np.nan
    part = detect(residual_of(linear(case), from_arrays(case.X, F, dt=case.dt)))
    assert "dof 1" not in part.verdicts.index and "dof 2" in part.verdicts.index


def test_the_covariance_of_a_floor_without_draws_is_diagonal():
    floor = NoiseFloor(np.array([2.0, 3.0]), np.array([3.6, 3.0]), "given")
    np.testing.assert_array_equal(floor.covariance(), np.diag([4.0, 9.0]))


def test_the_floor_of_raw_channels_is_that_of_a_fit_to_raw_channels():
    """2 % of white noise, nothing fused: the residual of the fit is this noise and no more."""
    rec = report_cases.record(None, seed=4, n_samples=3000, noise=0.02)
    X, F = rec.to_features(smooth=False)
    estimator = NRFRegressor(degree=1, dt=1e-3).fit(X, F)
    residual = residual_of(estimator.model_, from_arrays(X, F, dt=1e-3))
    floor = NoiseFloor.from_channels(estimator.model_, rec, smooth=False, regressor=estimator, random_state=0)
    ratio = residual.sizes["rms"].to_numpy()[:3] / floor.balance
    assert (0.6 < ratio).all() and (ratio < 1.7).all()


# -- the search -------------------------------------------------------------------------------


def _finding(law, site):
    return Finding(Candidate(law, Site(site)), law, 0.0)


def test_a_law_is_not_needless_because_its_own_special_case_stands_beside_it():
    """Friction with an asymmetric one beside it: either imitates the other, so neither is taken out on this ground."""
    stage = stage_of(report_cases.record(report_cases.friction, seed=3, n_samples=2500))
    site = Site("storey 2")
    special, general = laws.CoulombFriction(), laws.AsymmetricFriction()
    both = stage.with_law(site, special).with_law(site, general)
    assert needless(both, [_finding(special, site), _finding(general, site)]) is None
    # an even law is little more than a constant only along a drift that keeps its sign; this one swings about zero
    constant, cubic = laws.ConstantForce(), laws.CubicStiffness()
    third = stage.with_law(site, special).with_law(site, constant).with_law(site, cubic)
    gone = needless(third, [_finding(constant, site), _finding(special, site), _finding(cubic, site)])
    assert gone is not None and gone.law.name == "constant_force"


def test_an_effect_that_was_replaced_is_left_alone_by_what_follows():
    stage = stage_of(report_cases.record(report_cases.friction, seed=3, n_samples=2500))
    site = Site("storey 2")
    here = stage.with_law(site, laws.CoulombFriction())
    lost = _finding(laws.Dahl(sigma=1e3), "storey 1")
    assert needless(here, [lost, _finding(laws.CoulombFriction(), site)]) is None
    assert reestimated(here, [lost]).laws == here.laws


def test_a_law_with_memory_makes_a_model_rough_and_a_spring_does_not():
    rec = report_cases.record(None, seed=3, n_samples=2500)
    stage = stage_of(rec)
    assert not _rough(stage)
    assert _rough(stage.with_law(Site("storey 1"), laws.Dahl(sigma=1e4)))
    rubbing = stage_of(report_cases.record(report_cases.friction, seed=3, n_samples=2500))
    assert _rough(rubbing.with_law(Site("storey 2"), laws.CoulombFriction()))


def test_a_baseline_that_must_find_its_own_shape_finds_it_on_the_search_data():
    """A Dahl damper of 20 N declared without its sigma; what is missing beside it is the cubic of storey 2."""
    spring = [laws.PowerSeries(1, [25.0, 3.5e4])]
    truth = ChainModel(
        [10.0, 8.0], {1: [*spring, laws.Dahl(sigma=4e3, Fd=20.0)], 2: [*spring, laws.CubicStiffness(1e9)]}
    )
    F = excitation.band_limited_random(2, 6.0, 500.0, dofs=[1, 2], rms=60.0, band=(0.5, 25), random_state=0)
    rec = simulate(truth, F, 2e-3)
    baseline = NRFRegressor(laws={"storey 1": [laws.PowerSeries(1), laws.Dahl()], "storey 2": [laws.PowerSeries(1)]})
    report = close_loop(rec, baseline, catalogue=[laws.CubicStiffness()], max_steps=1, n_surrogates=0)
    assert [(s.law, s.site) for s in report.steps] == [("cubic_stiffness", "storey 2")]
    held = next(law for law in report.model.laws[Site("storey 1")] if law.name == "dahl")
    assert held.shape["sigma"] == pytest.approx(4e3, rel=0.5) and held.coefficients[0] == pytest.approx(20.0, rel=0.1)


def test_channels_that_contradict_each_other_are_named_where_the_loop_ends():
    """x2 reads 10 % too much, and the catalogue holds no such fault: the fusion made the best of it, and it is said."""
    rec = report_cases.record(None, seed=3, n_samples=4000, noise=0.005)
    x = rec.displacement.copy()
    x[:, 1] *= 1.1
    report = close_loop(
        rec.replace(displacement=x), catalogue=[laws.CubicStiffness(), laws.SensorOffset()], max_steps=1, n_surrogates=1
    )
    assert "Channels contradict each other" in report.stopped_because and "x2" in report.stopped_because


def test_a_record_of_one_floor_without_sensors_gives_surrogates_without_them():
    """Floor 2 has only a displacement: what imitates the test has no acceleration there either."""
    from pysindy_nrf.discrepancy.surrogate import surrogate

    rec = report_cases.record(None, seed=3, n_samples=2500)
    a = rec.acceleration.copy()
    a[:, 1] = np.nan
    part = rec.replace(acceleration=a)
    stage = stage_of(part)
    fake = surrogate(part, stage.work.data.segments[0], stage.trial().model(), {"x2": 1e-5}, np.random.default_rng(0))
    assert np.isnan(fake.acceleration[:, 1]).all() and np.isfinite(fake.displacement[:, 1]).all()
    assert isinstance(fake, Record)
