"""Exact numbers of noise: surrogates, the second opinion, records and their cuts, residuals and their floors."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hand_made_walk import fault, finding, four, noise, record, refuse
from scipy import signal

from pysindy_nrf import ChainModel, Record, Site, laws, simulate
from pysindy_nrf.chain_solve import Solution
from pysindy_nrf.discrepancy import (
    noise_floor,
    noise_level,
    prepare,
    residual,
    second_opinion,
    spectral_lines,
    splits,
    surrogate,
    workspace,
)
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.gate import FLOOR, Verdict
from pysindy_nrf.discrepancy.splits import BlockRows
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.exceptions import ChannelError, NRFError, SimulationError
from pysindy_nrf.input_arrays import from_arrays
from pysindy_nrf.laws.sensor import GainError

# -- surrogates -------------------------------------------------------------------------------------


@pytest.mark.parametrize("n, pieces", [(100, 1), (256, 1), (384, 2), (2560, 19)])
def test_noise_of_a_force_is_the_tenth_percentile_over_what_it_is_in_so_many_pieces(n, pieces):
    """Welch's pieces of 256 samples overlap by half; the sum over frequencies is the power."""
    left = noise(n, 4)[:, None] * [1.0, 0.2]
    f, power = signal.welch(left, 200.0, nperseg=min(256, n), axis=0)
    for band, inside in (
        (None, slice(1, -1)),
        ((20.0, 60.0), (f >= 20) & (f <= 60)),
        ((None, 60.0), (f > 0) & (f <= 60)),
    ):
        low = np.percentile(power[inside], 10, axis=0) / noise_level.lower_tail(0.1, pieces)
        wanted = np.minimum(np.sqrt(low * 100.0), left.std(axis=0))
        assert surrogate.force_noise(left, np.ones((n, 2)), 200.0, band) == pytest.approx(wanted)


def judged_stage(*folds):
    levels = iter(folds) if len(folds) > 1 else None
    one = SimpleNamespace(laws={Site("storey 1"): (laws.LinearElastic(), laws.Dahl(1.0))})
    one.trial = lambda: SimpleNamespace(fold_errors=lambda: np.full(3, float(next(levels) if levels else folds[0])))
    return one


def null_of(own, stages, **more):
    one = surrogate.Null(None, judged_stage(own), None, 2)
    one.__dict__["_made"] = surrogate._Made(stages, 0.3, 0.2, "truth")
    return one


def test_what_a_candidate_gains_where_it_does_not_act_is_the_most_of_all_surrogates(monkeypatch):
    asked = []
    monkeypatch.setattr(surrogate, "lines_for", lambda stage, c: ("lines", c))
    monkeypatch.setattr(
        surrogate, "screen", lambda stage, c, instead, lines: asked.append((c, instead, lines)) or ["best", "next"]
    )
    monkeypatch.setattr(surrogate, "refine", lambda stage, f, n: (stage, f, n))
    after = {4.0: 3.0, 2.0: 0.5, 8.0: 7.0}

    def validated(stage, found):
        level = stage.trial().fold_errors()[0]
        assert found == (stage, "best", 20)
        return SimpleNamespace(folds=np.full(3, after[level]))

    monkeypatch.setattr(surrogate, "validate", validated)
    one = finding(laws.Jenkins(0.1), drop=((Site("storey 1"), 1),))
    null = null_of(5.0, [judged_stage(x) for x in (4.0, 2.0, 8.0)])
    assert null.gain(one) == pytest.approx(0.75) and len(asked) == 3
    assert asked[0] == ([one.candidate], [(Site("storey 1"), "dahl")], ("lines", one.candidate))
    assert null_of(5.0, []).gain(one) == 0.0 and (null.bias, null.error, null.truth) == (0.3, 0.2, "truth")
    after.update({FLOOR: 0.5 * FLOOR, 1.01 * FLOOR: 0.505 * FLOOR})
    assert null_of(5.0, [judged_stage(FLOOR)]).gain(one) == 0.0  # nothing to gain there
    assert null_of(5.0, [judged_stage(1.01 * FLOOR)]).gain(one) == pytest.approx(0.5)
    monkeypatch.setattr(surrogate, "screen", lambda *a: [])
    assert null.gain(one) == 0.0
    monkeypatch.setattr(surrogate, "screen", refuse)
    assert null.gain(one) == 0.0


def test_a_fault_without_witness_must_gain_half_where_the_model_is_at_the_floor(monkeypatch):
    gains = iter([0.1, 0.7, 0.1, 0.2, 0.1, 0.2])
    monkeypatch.setattr(surrogate, "null_gain", lambda stage, f: next(gains))
    one, stages = fault(GainError(0.1)), [judged_stage(1.0), judged_stage(2.0)]
    top = surrogate.AT_FLOOR * 2.0
    assert null_of(top, stages).gain(one) == 0.7
    assert null_of(top, stages).gain(one) == surrogate._OF_A_SENSOR
    assert null_of(1.001 * top, stages).gain(one) == 0.2
    one.remark = "x1 and a1 disagree"
    monkeypatch.setattr(surrogate, "null_gain", lambda stage, f: 0.0)
    assert null_of(top, stages).gain(one) == 0.0 and null_of(top, stages).reached


def test_only_surrogates_that_can_be_judged_count():
    def made(*folds):
        return SimpleNamespace(slot=lambda: SimpleNamespace(folds=lambda: np.array(folds)))

    every = [made(1.0, 2.0), made(1.0, np.inf), made(np.nan, 1.0)]
    assert surrogate._finite(every) == every[:1]


@pytest.mark.parametrize(
    "masses, error, count",
    [
        ((1.0, 2.0), None, 3),
        ((1.0, 0.0), None, 0),
        ((1.0, 2.0), NRFError("x", "y"), 0),
        ((1.0, 2.0), np.linalg.LinAlgError("x"), 0),
    ],
)
def test_a_model_without_a_free_run_has_no_surrogates(monkeypatch, masses, error, count):
    def one(model, hold):
        if error is not None:
            raise error
        return "stage"

    monkeypatch.setattr(surrogate, "model_of", lambda layout, found: SimpleNamespace(masses=np.array(masses)))
    monkeypatch.setattr(surrogate, "_finite", list)
    trial = SimpleNamespace(layout=None, solve=lambda blocks: list(blocks))
    null = surrogate.Null(None, SimpleNamespace(trial=lambda: trial, work=SimpleNamespace(search="ab")), None, 3)
    null._one, null._like_the_truth = one, lambda trial, found, first, hold: (first, found)
    assert null._surrogates("linear") == ((["stage"] * count, [0, 1]) if count else ([], 0.0, 0.0, None))


def test_surrogates_of_the_truth_that_have_no_free_run_leave_those_of_the_model(monkeypatch):
    site, first = Site("storey 1"), [SimpleNamespace(work=SimpleNamespace(search=[0, 1]))]
    first[0].trial = lambda: SimpleNamespace(solve=lambda blocks: Solution({1: 9.0}, {site: np.array([80.0])}))
    found = Solution({1: 10.0}, {site: np.array([100.0])})
    null = surrogate.Null(None, None, None, 1)
    null._shift = lambda trial, a, b, whole=False: 0.2 if whole else 0.1
    monkeypatch.setattr(surrogate, "model_of", lambda layout, found: found)
    for error in (NRFError("x", "y"), np.linalg.LinAlgError("x")):

        def fail(model, hold, error=error):
            raise error

        null._one = fail
        assert null._like_the_truth(SimpleNamespace(layout=0), found, first, "linear") == (first, 0.1, 0.2, found)
    null._one = lambda model, hold: model
    monkeypatch.setattr(surrogate, "_finite", lambda stages: [s for s in stages if s.masses[1] == 11.0])
    stages, _, _, truth = null._like_the_truth(SimpleNamespace(layout=0), found, first, "linear")
    assert stages == [truth] and truth.coefficients[site].tolist() == [120.0]
    first[0].trial = lambda: SimpleNamespace(solve=refuse)
    assert null._like_the_truth(SimpleNamespace(layout=0), found, first, "linear") == (first, 0.0, 0.0, found)


def test_a_surrogate_has_the_quietest_noise_that_is_told_and_blocks_within_its_rows(monkeypatch):
    """Of the force itself and of its balance, each may tell the noise alone."""
    made, spaces = [], []
    records = SimpleNamespace(records=["r0", "r1"], noise=[{"a1": 9.0}, {"a1": 1.0}], bands=[None, (2.0, None)])
    search = [BlockRows(1, slice(0, 40)), BlockRows(1, slice(40, 90)), BlockRows(1, slice(90, 120))]
    work = SimpleNamespace(
        searched=[1],
        search=search,
        data=SimpleNamespace(segments=["s0", SimpleNamespace(valid=slice(3, 123))]),
        filters=["f0", "f1"],
        known_masses={1: 2.0},
        strategy="auto",
        seen_rows=lambda i: ("rows", i),
    )
    base = SimpleNamespace(work=work, chain="chain", laws="laws")
    null = surrogate.Null(records, base, "rng", 1)
    null._force_noise = lambda model, i: {"F1": 0.5, "F2": 0.5, "F3": 0.5}
    monkeypatch.setattr(
        surrogate, "levels_of", lambda rec, motion, rows: dict(motion) | {"F1": 0.2, "F2": 0.0, "F3": 0.9}
    )
    monkeypatch.setattr(surrogate, "surrogate", lambda *a: made.append(a) or "fake")
    seg = SimpleNamespace(valid=slice(3, 98))
    prepared = []
    monkeypatch.setattr(surrogate, "prepare", lambda fakes, noise, bands: prepared.append((fakes, noise, bands)) or SimpleNamespace(
        data=SimpleNamespace(segments=[seg])))  # fmt: skip
    monkeypatch.setattr(surrogate, "Workspace", lambda *a: spaces.append(a) or "fresh")
    monkeypatch.setattr(surrogate, "Stage", lambda *a: a)
    assert null._one("model", "linear") == ("fresh", "chain", "laws")
    assert made == [("r1", work.data.segments[1], "model", {"a1": 1.0, "F1": 0.2, "F2": 0.5, "F3": 0.5}, "rng", "linear")]
    assert prepared == [(["fake"], [{"a1": 1.0}], [(2.0, None)])]
    assert spaces[0][1:] == (
        ["f1"],
        [BlockRows(0, slice(0, 40)), BlockRows(0, slice(40, 90)), BlockRows(0, slice(90, 95))],
        [],
        {1: 2.0},
        "auto",
    )
    seg.valid = slice(3, 80)
    null._one("model", "linear")
    assert spaces[1][2][1:] == [BlockRows(0, slice(40, 77)), BlockRows(0, slice(77, 77))]


def test_noise_of_forces_is_read_in_the_longest_block_within_the_band(monkeypatch):
    n, asked = 100, []
    X, F = np.random.default_rng(0).standard_normal((n, 6)), noise(2 * n, 3).reshape(n, 2)
    data = from_arrays(X, F, dt=0.01)
    search = [BlockRows(0, slice(0, 20)), BlockRows(0, slice(30, 70)), BlockRows(1, slice(0, 90))]
    filters = [SimpleNamespace(band=(1.0, 9.0))]
    work = SimpleNamespace(data=data, search=search, filters=filters, filtered=lambda i, rows: 2 * rows)
    null = surrogate.Null(None, SimpleNamespace(work=work), None, 1)
    monkeypatch.setattr(surrogate, "force_noise", lambda *a: asked.append(a) or np.array([0.5, 0.7]))
    model = SimpleNamespace(balance_forces=lambda data: [X[:, :2]])
    assert null._force_noise(model, 0) == {"F1": 0.5, "F2": 0.7}
    left, force, fs, band = asked[0]
    assert (
        left == pytest.approx(2 * (X[:, :2] - F)[30:70])
        and force == pytest.approx(F[30:70])
        and fs == pytest.approx(100.0)
    )
    assert band == (1.0, 9.0)
    work.filters = [None]
    null._force_noise(model, 0)
    assert asked[1][3] is None
    data.segments[0].F[:, 0] = np.nan
    null._force_noise(model, 0)
    assert asked[2][0][:, 0] == pytest.approx(2 * X[30:70, 0])
    work.data = from_arrays(X, F)
    assert null._force_noise(model, 0) == {}


def late_record(first=400, n=1200, fs=200.0):
    """One mass, hit before its sensor is switched on and after; without noise, and what happened in between."""
    F = np.zeros((n, 1))
    F[[100, 500, 900]] = 1000.0
    truth = ChainModel([10.0], {1: [laws.LinearElastic(4e4), laws.LinearViscous(20.0)]})
    record = simulate(truth, F, 1 / fs)
    gone = {key: np.array(getattr(record, key)) for key in ("acceleration", "velocity", "displacement")}
    for y in gone.values():
        y[:first] = np.nan
    return truth, record, record.replace(**gone)


def test_a_surrogate_of_the_truth_without_noise_is_the_record_from_its_first_valid_row_on():
    """The blow before it is in the first state; simulated from row 0 it would come a second time."""
    truth, whole, late = late_record()
    (segment,) = truth.segments(late).segments
    fake = surrogate.surrogate(late, segment, truth, {}, np.random.default_rng(0))
    assert segment.valid == slice(400, 1200) and fake.force == pytest.approx(whole.force)
    for key in ("acceleration", "velocity", "displacement"):
        made, real = getattr(fake, key), getattr(whole, key)
        assert np.isnan(made[:400]).all() and made[400:] == pytest.approx(real[400:], abs=1e-6 * np.ptp(real))


def test_a_surrogate_has_noise_on_its_channels_alone():
    truth, _, late = late_record()
    (segment,) = truth.segments(late).segments
    late = late.replace(displacement=np.full_like(late.displacement, np.nan))
    fake = surrogate.surrogate(
        late, segment, truth, {"v1": 2.0, "F1": 3.0, "x1": 1.0}, np.random.default_rng(0), "cubic"
    )
    assert np.isnan(fake.displacement).all()
    assert (fake.velocity - late.velocity)[400:].std() == pytest.approx(2.0, rel=0.1)
    assert (fake.force - late.force).std() == pytest.approx(3.0, rel=0.15)  # blows are freed of noise before


def test_blocks_of_surrogates_are_those_rows_of_the_record(monkeypatch):
    truth, _, late = late_record()
    ready = prepare.prepare(late)
    search, held = splits.split(ready.data.segments, ready.heldout)
    work = workspace.Workspace(ready.data, [None], search, held, {}, "auto")
    stage = Stage(work, truth.chain, truth.laws)
    (fake, *_) = surrogate.Null(ready, stage, np.random.default_rng(0), 1).stages
    assert fake.work.data.segments[0].valid == work.data.segments[0].valid and fake.work.search == search
    late_again = prepare.prepare(
        late.replace(acceleration=np.where(np.arange(1200)[:, None] < 450, np.nan, late.acceleration))
    )
    monkeypatch.setattr(surrogate, "prepare", lambda *a, **b: late_again)  # as if fusion had lost its first rows
    (other, *_) = surrogate.Null(ready, stage, np.random.default_rng(0), 1).stages
    lost = late_again.data.segments[0].valid.start - 400
    for one, given in zip(other.work.search, search):
        assert one.rows == slice(max(given.rows.start - lost, 0), max(given.rows.stop - lost, 0))


# -- the second opinion -----------------------------------------------------------------------------


@pytest.mark.parametrize("bias, other, wrong", [(1.0, 9.0, 1.0), (0.99, 1.5, 1.5), (0.99, 0.5, 0.99)])
def test_the_model_with_the_effect_is_asked_unless_that_without_is_wrong_already(monkeypatch, bias, other, wrong):
    asked = []
    strong = second_opinion._STRONG
    monkeypatch.setattr(second_opinion, "Null", lambda *a: asked.append(a) or SimpleNamespace(bias=other * strong))
    null = SimpleNamespace(
        bias=bias * strong,
        stage=SimpleNamespace(layout=SimpleNamespace(acting="sites")),
        ready="ready",
        rng="rng",
        count=2,
    )
    assert second_opinion.wrong_by("after", null) == pytest.approx(wrong * strong)
    assert asked == ([] if bias >= 1 else [("ready", "after", "rng", 2, "sites")])
    if bias < 1:
        second_opinion.wrong_by("after", null, "corrected")
        assert asked[1][0] == "corrected"


def test_errors_without_bias_are_those_of_every_block_and_none_where_nothing_settles(monkeypatch):
    found = SimpleNamespace(settled=True, solution="clean")
    work = SimpleNamespace(search="abc", known_masses={1: 2.0})
    trial = SimpleNamespace(
        model=lambda: "model", layout="layout", walk="walk", error=lambda s, blocks: (s == "clean") * (1.0 + blocks[0])
    )
    one = SimpleNamespace(trial=lambda: trial, work=work)
    monkeypatch.setattr(second_opinion, "searched", lambda work, data: (data, "filters"))
    asked, answer = [], [found]
    monkeypatch.setattr(second_opinion, "instrumental_variables", lambda *a: asked.append(a) or answer[0])
    assert second_opinion.unbiased_errors(one, SimpleNamespace(apart="apart")).tolist() == [1.0, 2.0, 3.0]
    assert asked == [("model", "apart", "layout", "walk", "filters", {1: 2.0})]
    for bad in (None, SimpleNamespace(settled=False)):
        answer[0] = bad
        assert second_opinion.unbiased_errors(one, SimpleNamespace(apart="apart")) is None
    for error in (NRFError("x", "y"), np.linalg.LinAlgError("x")):

        def fail(*a, error=error):
            raise error

        monkeypatch.setattr(second_opinion, "instrumental_variables", fail)
        assert second_opinion.unbiased_errors(one, SimpleNamespace(apart="apart")) is None


@pytest.mark.parametrize(
    "bias, words", [(2.0, "; noise alone makes the model wrong by 200 %, and"), (None, "; noise is strong, and")]
)
def test_what_no_instruments_can_tell_is_said(monkeypatch, bias, words):
    level = SimpleNamespace(slot=lambda: SimpleNamespace(folds=lambda: np.full(5, 60.0)))
    monkeypatch.setattr(second_opinion, "unbiased_errors", lambda s, ready: None)
    monkeypatch.setattr(second_opinion, "_rough", lambda s: False)
    monkeypatch.setattr(second_opinion, "wrong_by", lambda *a: bias)
    null = SimpleNamespace(hasty=False, ready=SimpleNamespace(clean=False), stages=[1] if bias else [], bias=1.0, floor=np.nan)
    verdict = second_opinion.confirmed(Verdict(True, 0.9, 1.0, 0.0, "told"), level, level, null)
    assert not verdict.accepted and verdict.sentence == f"told{words} no instruments can tell"
    null.ready.clean = True
    assert second_opinion.confirmed(verdict, None, None, null) is verdict


# -- lines ------------------------------------------------------------------------------------------


def test_lines_are_looked_for_in_the_longest_record_with_zeros_where_it_is_held_out(monkeypatch):
    def seg(start, stop, dt=0.01):
        return SimpleNamespace(valid=slice(start, stop), n_valid=stop - start, dt=dt)

    asked = []
    monkeypatch.setattr(spectral_lines, "balance_lines", lambda *a: asked.append(a) or [float(a[3])])
    monkeypatch.setattr(spectral_lines, "driven_at", lambda seg, rows: ("driven", rows))
    runs = [slice(2, 10), slice(20, 50), slice(60, 70)]
    segments = [seg(0, 500), seg(10, 90), seg(100, 179)]
    work = SimpleNamespace(
        data=SimpleNamespace(segments=segments), searched=[1, 2], runs=lambda i: runs if i == 1 else None, n_dof=3,
        known_masses={2: 1.0}, forced=(3,), search="abc",
    )  # fmt: skip
    rows = np.arange(160.0).reshape(2, 80) + 1
    trial = SimpleNamespace(
        work=work, layout="layout", solve=list, stage=SimpleNamespace(rows=lambda i: rows if i == 1 else None)
    )
    assert spectral_lines.lines_of(trial) == {Site(f"dof {j}"): [float(j)] for j in (1, 2, 3)}
    inside = np.isin(np.arange(80), np.r_[2:10, 20:50, 60:70])
    for (got, _, solution, _, dt, scaled, weighed, driven), wanted in zip(
        asked, ((False, False), (True, True), (True, False))
    ):
        assert got.tolist() == (rows * inside)[:, 2:70].tolist() and solution == [0, 1, 2] and dt == 0.01
        assert (scaled, weighed) == wanted and driven == ("driven", runs[1])
    segments[1].dt = None
    assert spectral_lines.lines_of(trial) == {}
    monkeypatch.setattr(spectral_lines, "lines_of", lambda trial: trial)
    one = SimpleNamespace(trial=lambda: "lines")
    assert spectral_lines.lines_for(one, Candidate(laws.HarmonicForce(), Site("dof 1"))) == "lines"
    for law in (laws.HarmonicForce(3.0), laws.Dahl(), laws.CoulombFriction()):
        assert spectral_lines.lines_for(one, Candidate(law, Site("dof 1"))) == {}


# -- records ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("share, clean", [(0.999, True), (1.001, False)])
def test_channels_are_clean_if_the_noise_of_each_is_a_small_share_of_it(share, clean):
    one = record(n_dof=2)
    levels = {name: 0.0 for name in one.channels()}
    for name in ("a1", "v2", "x2"):
        noisy = levels | {name: share * prepare.CLEAN * one.channels()[name].std()}
        assert prepare._is_clean(one, noisy) == clean
    assert not prepare._is_clean(one, {k: v for k, v in levels.items() if k != "x1"})
    assert not prepare._is_clean(one.replace(velocity=None), levels)


def test_records_are_numbered_and_stand_behind_each_other():
    first, second, third = record(300, name="a"), record(200, name="b"), record(250, name="c")
    ready = prepare.prepare([first, second], third)
    assert ready.heldout == [2] and ready.records == [first, second, third]
    assert [(s.name, s.rows.start, s.rows.stop) for s in ready.data.segments] == [
        ("a", 0, 300),
        ("b", 300, 500),
        ("c", 500, 750),
    ]
    assert ready.data.n_samples == 750 and prepare.prepare(first).heldout is None and ready.given == [{}, {}, {}]
    assert len(ready.noise) == 3 and set(ready.noise[0]) >= {"a1", "v1", "x1"}
    assert prepare.prepare(first, noise=[{"a1": 0.0, "x1": 0.1}]).given == [{"x1": 0.1}]
    with pytest.raises(ValueError):
        prepare.prepare([first, second], noise=[{}])
    for wrong in ([], None, [first, "b"], "ab", 3):
        with pytest.raises(ChannelError):
            prepare.prepare(wrong)
    with pytest.raises(ChannelError, match="Record 'd' has 2 DOFs, 1 are needed"):
        prepare.prepare([first, record(n_dof=2, name="d")])
    noisy = prepare.prepare(record(level=0.05))
    assert not noisy.clean and noisy.apart is not noisy.data


def test_channels_are_taken_as_they_are_where_all_records_are_clean(monkeypatch):
    monkeypatch.setattr(prepare, "_is_clean", lambda rec, levels: rec.name != "b")
    first, second = record(300, 0.01, name="a"), record(200, 0.01, name="b")
    alone = prepare.prepare(first)
    assert (
        alone.clean
        and alone.apart is alone.data
        and alone.data.segments[0].a[:, 0].tolist() == first.acceleration[:, 0].tolist()
    )
    both = prepare.prepare([first, second])
    assert not both.clean and both.data.segments[0].a[:, 0].tolist() == first.acceleration[:, 0].tolist()
    assert both.data.segments[1].a[:, 0].tolist() != second.acceleration[:, 0].tolist()
    held = prepare.prepare(second, first)
    assert held.apart.segments[1] is held.data.segments[1] and held.apart.segments[0] is not held.data.segments[0]


def test_the_base_joins_the_covariates_with_its_rate():
    n = 400
    t = np.arange(n) / 100
    ag = 3 * np.cos(3 * t)
    temperature = np.arange(n, dtype=float)
    assert set(prepare._covariates(record(covariates={"T": temperature}))) == {"T"}
    found = prepare._covariates(record(covariates={"T": temperature}, base_acceleration=ag))
    assert set(found) == {"T", "ag", "vg"} and found["ag"].tolist() == ag.tolist()
    assert np.corrcoef(np.gradient(found["vg"], t)[50:-50], ag[50:-50])[0, 1] > 0.99
    rate = np.sin(3 * t)
    assert prepare._covariates(record(base_acceleration=ag, base_velocity=rate))["vg"].tolist() == rate.tolist()
    shift = prepare._covariates(record(base_acceleration=ag, base_displacement=-np.cos(3 * t) / 3))["vg"]
    assert np.corrcoef(shift[50:-50], np.sin(3 * t)[50:-50])[0, 1] > 0.99
    own = prepare._covariates(record(base_acceleration=ag, covariates={"vg": temperature, "ag": temperature}))
    assert own["vg"].tolist() == own["ag"].tolist() == temperature.tolist()


# -- the workspace and its columns ------------------------------------------------------------------


def space(*lengths, filters=None, dt=0.01, F=None, search=None):
    rng, out = np.random.default_rng(0), []
    for n in lengths:
        X = rng.standard_normal((n, 6))
        out += from_arrays(X, rng.standard_normal((n, 2)) if F is None else F[:n], dt=dt).segments
    data = type(from_arrays(np.zeros((9, 6)), dt=0.01))(out, sum(lengths))
    search = search or [BlockRows(i, slice(0, n)) for i, n in enumerate(lengths)]
    return workspace.Workspace(data, filters or [None] * len(lengths), search, [], {}, "auto")


def test_columns_that_are_kept_are_not_built_again_and_the_oldest_go_first(monkeypatch):
    work, site = space(50, 30), Site("storey 1")
    size = 80 * 8
    monkeypatch.setattr(workspace, "CACHE", 4 * size + 4)
    one = [laws.CubicStiffness()]
    first = work.search_columns(site, one, True)
    assert work.search_columns(site, one, True) is first and work.search_columns(site, one) is not first
    s = np.concatenate([seg.s[:, 0] for seg in work.data.segments])
    assert first[0] == pytest.approx(s**3) and work._cached == size
    for law in (laws.QuinticStiffness(), laws.CoulombFriction(), laws.QuadraticDamping()):
        work.search_columns(site, [law], True)
    assert work.search_columns(site, one, True) is first and work._cached == 4 * size  # it is the youngest again
    work.search_columns(site, [laws.QuadraticStiffness()], True)
    held = [key[1][0].name for key in work._cache]
    assert (
        held == ["coulomb_friction", "quadratic_damping", "cubic_stiffness", "quadratic_stiffness"]
        and work._cached == 4 * size
    )
    monkeypatch.setattr(workspace, "CACHE", 4 * size)  # what takes a quarter of it is not kept
    work.search_columns(site, [laws.TwoSidedGap(0.1)], True)
    assert len(work._cache) == 4
    work.data.segments[1].s[3] = 1e200
    work._motions.clear()
    with pytest.raises(NRFError, match="overflow"), np.errstate(over="ignore"):
        work.search_columns(site, [laws.QuinticStiffness()])


def test_what_is_fixed_is_filtered_and_zero_where_the_force_is_unknown():
    F = np.random.default_rng(1).standard_normal((50, 2))
    F[:, 0] = np.nan
    double = SimpleNamespace(apply=lambda rows: 2 * rows)
    work = space(50, filters=[double], F=F, search=[BlockRows(0, slice(10, 30)), BlockRows(0, slice(35, 50))])
    a = work.data.segments[0].a
    assert work.fixed(0) == pytest.approx(np.vstack([2 * a.T, np.zeros(50), 2 * F[:, 1]]))
    assert work.known.tolist() == [[False, True]] and work.unknown == (1,) and work.forced == (2,)
    assert work.search_fixed == pytest.approx(work.fixed(0)[:, np.r_[10:30, 35:50]])
    assert work.columns(Site("storey 2"), [laws.LinearElastic()], 0) == pytest.approx(
        2 * work.data.segments[0].s[:, 1:].T
    )
    nothing = space(50, F=np.full((50, 2), np.nan))
    assert not nothing.fixed(0)[2:].any() and np.isfinite(nothing.fixed(0)).all()
    still = space(50, dt=None)
    assert still.scales(Site("storey 1"))[2] == 1.0
    uses, members = work.uses([(1,), (2,), (1, 2)])
    assert uses == {(1,): 0, (2,): 1, (1, 2): 0} and members.tolist() == [[False, False], [True, True]]


# -- residuals and floors ---------------------------------------------------------------------------


def test_rms_is_over_what_is_known_and_sums_go_from_the_top():
    parts = [np.array([[3.0, np.nan], [4.0, np.nan]]), np.array([[0.0, np.nan]])]
    found = residual.rms(parts)
    assert found[0] == pytest.approx(np.sqrt(25 / 3)) and np.isnan(found[1])
    assert residual.from_top(np.array([[1.0, 2.0, 4.0]])).tolist() == [[7.0, 6.0, 4.0]]


@pytest.mark.parametrize("share, closes", [(0.999, True), (1.001, False)])
def test_a_residual_closes_to_rounding_in_every_balance(share, closes):
    one, _ = four((1, 2, 3, 4))
    reference = one.sizes["reference"].to_numpy()
    level = share * residual.ROUND_OFF * reference[1]
    again = one.with_balance([np.tile([0.0, level, 0.0, 0.0], (60, 1))])
    assert again.is_round_off == closes and again.sizes["rms"].iloc[1] == pytest.approx(level)
    assert again.sizes["percent"].iloc[1] == pytest.approx(100 * share * residual.ROUND_OFF)
    assert again.sizes["rms"].iloc[4:].tolist() == pytest.approx([level, level, 0.0, 0.0])
    assert (
        str(again).count("\n") == 7
        and "dof 2: " in str(again)
        and again.at("dof 2")[0] == pytest.approx(np.full(60, level))
    )
    assert again.at("storey 1")[0] == pytest.approx(np.full(60, level))
    for wrong in ("dof 0", "dof 5", "floor 1", "storey x", "storey"):
        with pytest.raises(ChannelError, match="has no"):
            again.at(wrong)
    with pytest.raises(ChannelError, match="2 filters for 1 records"):
        residual.filters_of(one.data, [None, None])
    with pytest.raises(ChannelError, match="Both"):
        residual.filters_of(one.data, [None], (1.0, 2.0))


@pytest.mark.parametrize(
    "change, words",
    [
        ({"rows": 1}, "record 'r' has a single sample"),
        ({"dt": None}, "record 'r': the sampling step is not known"),
        ({"unknown": 2}, "record 'r': the force on DOF 2 is unknown"),
        ({"mass": 0.0}, "record 'r': m2 is not positive"),
        ({"mass": -1.0}, "record 'r': m2 is not positive"),
        ({"rows": 2}, ""),
        ({"mass": 1e-3}, ""),
    ],
)
def test_why_there_is_no_free_run(change, words):
    seg = from_arrays(np.zeros((9, 6)), np.zeros((9, 2)), dt=change.get("dt", 0.01)).segments[0]
    seg.name, seg.valid = "r", slice(3, 3 + change.get("rows", 6))
    if "unknown" in change:
        seg.F[:, change["unknown"] - 1] = np.nan
    asked = []
    seg.s[3], seg.v[3] = [0.1, 0.2], [1.0, 2.0]

    def simulate(force, dt, **more):
        asked.append(more)
        return "run" if len(force) == change.get("rows", 6) and dt == 0.01 else None

    masses = np.array([1.0, change.get("mass", 1.0)])
    run, why = residual.free_run(SimpleNamespace(masses=masses, simulate=simulate), seg, {"hold": "cubic"})
    assert why == words and run == (None if words else "run") and len(asked) == (not words)
    if asked:
        assert asked[0]["x0"] == pytest.approx([0.1, 0.3]) and asked[0]["v0"] == pytest.approx([1.0, 3.0])
        assert asked[0]["t0"] == pytest.approx(0.03) and asked[0]["hold"] == "cubic" and asked[0]["covariates"] is None

    def diverge(*a, **k):
        raise SimulationError("It diverges", "Do not.")

    if not words:
        fake = SimpleNamespace(masses=masses, simulate=diverge)
        assert residual.free_run(fake, seg, {}) == (None, "record 'r': It diverges")


@pytest.mark.filterwarnings("ignore")  # channels at rest
def test_a_floor_of_channels_is_what_fresh_noise_changes(monkeypatch):
    """Draws on a model at rest: the balance changes by the noise of F, and by m, k and c times those of the motion."""
    monkeypatch.setattr(noise_floor, "free_run", lambda model, seg, options: (None, ""))
    monkeypatch.setattr(noise_floor, "quiet_drive", lambda record, levels: record)
    n = 4000
    zeros = np.zeros((n, 1))
    one = Record(fs=100.0, force=zeros, acceleration=zeros, velocity=zeros, displacement=zeros)
    model = ChainModel([2.0], {1: [laws.LinearElastic(100.0), laws.LinearViscous(3.0)]})
    levels = {"a1": 0.5, "F1": 0.7, "x1": 0.01, "v1": 0.1}
    measured = noise_floor._Measured(one, levels, noise_floor._segments(one, *prepare.to_features(one, False)))
    monkeypatch.setattr(noise_floor._Measured, "of", lambda rec, given: measured)
    floor = noise_floor.NoiseFloor.from_channels(model, one, smooth=False, n_draws=3, random_state=0)
    wanted = np.sqrt(0.7**2 + (2 * 0.5) ** 2 + (100 * 0.01) ** 2 + (3 * 0.1) ** 2)
    assert floor.balance[0] == pytest.approx(wanted, rel=0.03) and len(floor.draws) == 3
    assert floor.covariance()[0, 0] == pytest.approx(floor.balance[0] ** 2)


def test_fresh_noise_leaves_unmeasured_motions_to_the_fusion(monkeypatch):
    asked = []
    monkeypatch.setattr(noise_floor, "to_features", lambda rec, smooth: asked.append((rec, smooth)) or ("X", "F"))
    monkeypatch.setattr(noise_floor, "_segments", lambda rec, X, F: rec)
    zeros = np.zeros((200, 2))
    clean = noise_floor._Clean(
        Record(fs=9.0, force=zeros, acceleration=zeros, velocity=zeros, displacement=zeros),
        {"a1": 0.5, "F2": 2.0},
        None,
    )
    for smooth in (True, False):
        found = clean.draw(np.random.default_rng(0), smooth)
        rng = np.random.default_rng(0)
        assert found.force[:, 1] == pytest.approx(2.0 * rng.standard_normal(200)) and not found.force[:, 0].any()
        assert found.acceleration[:, 0] == pytest.approx(0.5 * rng.standard_normal(200))
        measured = [np.isfinite(y).all() for y in (found.acceleration[:, 1], found.force[:, 0])]
        assert measured == [not smooth, True] and asked[-1][1] == smooth


@pytest.mark.parametrize("given", [{"a1": 0.5, "F1": 0.1, "ag": 0.2, "x1": 0.0}, {}])
def test_only_known_noise_of_motions_is_told_to_the_fusion(monkeypatch, given):
    from pysindy_nrf.signals import kinematic_smoother

    told = []

    class Fake:
        def __init__(self, noise, band):
            assert band == "auto"
            told.append(noise)
            self.noise_ = {"a1": 9.0, "x1": 9.0}

    monkeypatch.setattr(kinematic_smoother, "KinematicSmoother", Fake)
    monkeypatch.setattr(noise_floor, "to_features", lambda rec, smoother: (None, None))
    monkeypatch.setattr(noise_floor, "_segments", lambda *a: None)
    monkeypatch.setattr(noise_floor, "levels_of", lambda rec, motion: dict(motion) | {"F1": 3.0, "v9": 1.0})
    found = noise_floor._Measured.of(record(), dict(given))
    assert told == [{"a1": 0.5} if given else "estimate"]
    assert found.levels == ({"a1": 0.5, "x1": 0.0, "F1": 0.1} if given else {"a1": 9.0, "x1": 9.0, "F1": 3.0})


# -- cuts -------------------------------------------------------------------------------------------


def test_a_still_channel_weighs_nothing_and_blocks_share_the_energy():
    X = np.sign(noise(3000 * 6, 2)).reshape(3000, 6)  # every row has the same energy
    X[:, 1] = 0.0
    one = from_arrays(X, np.ones((3000, 2)), dt=0.01).segments
    search_, held = splits.split(one)
    left = 3000 - int(splits.SETTLING * 3000)
    assert [b.rows.stop - b.rows.start for b in search_] == pytest.approx([0.075 * left] * 10, abs=1)
    assert [b.rows.stop - b.rows.start for b in held] == pytest.approx([0.25 / 4 * left] * 4, abs=1)
    assert sum(b.rows.stop - b.rows.start for b in search_ + held) == left and search_[0].rows.start == 3000 - left


def test_a_record_that_starts_from_rest_is_judged_from_its_first_row():
    X = noise(6000, 3).reshape(1000, 6)
    X[:4] = 0.0
    X[:, 3] = 0.0  # a rate that is zero throughout does not move at the start
    assert splits.settled(from_arrays(X, np.ones((1000, 2)), dt=0.01).segments[0]) == 0


def test_a_record_held_out_whole_begins_where_it_has_settled():
    X = np.tile(noise(6, 1), (1000, 1)) + noise(6000, 3).reshape(1000, 6)
    both = from_arrays(X, np.ones((1000, 2)), dt=0.01).segments * 2
    first = int(splits.SETTLING * 1000)
    search_, held = splits.split(both, heldout=[1])
    assert (
        held == [BlockRows(1, slice(first, 1000))] and search_[0].rows.start == first and search_[-1].rows.stop == 1000
    )
