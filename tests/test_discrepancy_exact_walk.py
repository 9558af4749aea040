"""Exact numbers of the walk of the loop: when it stops, what it decides, drops and says, with hand-made parts."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from pysindy_nrf import Chain, ChainModel, NRFRegressor, Record, Site, laws
from pysindy_nrf.chain_solve import Solution
from pysindy_nrf.discrepancy import (
    localisation,
    loop,
    markdown,
    noise_floor,
    noise_level,
    prepare,
    projection,
    reestimate,
    report,
    residual,
    search,
    second_opinion,
    sensors,
    spectral_lines,
    splits,
    stage,
    standing,
    steps,
    surrogate,
    together,
    workspace,
)
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.gate import FLOOR, MEMBER_GAIN, MIN_WINS, Verdict
from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.discrepancy.splits import BlockRows
from pysindy_nrf.exceptions import BiasWarning, ChannelError, ExcitationError, NRFError, SimulationError
from pysindy_nrf.input_arrays import from_arrays
from pysindy_nrf.laws.sensor import ChannelDelay, GainError, SensorOffset


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def finding(law, error=1.0, site="storey 1", drop=(), folds=None):
    folds = np.full(5, float(error)) if folds is None else np.array(folds, dtype=float)
    return Finding(Candidate(law, Site(site)), law, error, drop, folds)


def fault(law, error=1.0, site="sensor a1", screen=1.0):
    one = sensors.SensorFinding(Candidate(law, Site(site)), law, screen)
    one.folds = np.full(5, float(error))
    return one


def refuse(*a, **k):
    raise NRFError("cannot", "be")


# -- from step to step ------------------------------------------------------------------------------


class Walk:
    """A loop whose models are the numbers 0, 1, ..; what is decided at each and its errors are given."""

    def __init__(self, monkeypatch, decisions, folds, max_steps=4, floor=np.nan, measured=False, closes=False,
                 stages=(), gone=None, least=None, sensors=(), error=0.0, ranking=None, estimated=None, wrong=()):  # fmt: skip
        self.asked, self.last, self.nulls, self.noisy = [], [], [], []
        decisions, gone = iter(decisions), gone or {}

        def model(k):
            one = SimpleNamespace(number=k)
            one.trial = lambda: SimpleNamespace(number=k, fold_errors=lambda: np.full(5, float(folds[k])))
            return one

        def null(ready, stage, rng, count):
            self.nulls.append((stage.number, count))
            return SimpleNamespace(stages=list(stages), error=error)

        def with_it(stage, chosen, last):
            self.last.append(last)
            k = stage.number + 1
            return model(k), [f for f in gone.get(k, ())]

        monkeypatch.setattr(loop, "Null", null)
        monkeypatch.setattr(loop.LoopReport, "assemble", lambda *a: SimpleNamespace(
            scenes=a[1], steps=a[2], stopped=a[3], ranking=a[4], band=a[5], measured=a[6]
        ))  # fmt: skip
        monkeypatch.setattr(loop, "worst", lambda trial: "balance of DOF 7")
        monkeypatch.setattr(loop, "contradictions", lambda ready, work: ["a1 is late", "x2 too"])
        if least is not None:
            monkeypatch.setattr(loop, "surely_left", lambda folds, noise: least)
        floors = SimpleNamespace(
            of=lambda trial: ("floor", trial.number), closes=lambda *a: closes, words="as given", measured=measured,
            percent=lambda trial, null: floor,
        )  # fmt: skip
        work = SimpleNamespace(scales=lambda site: (0.1, 0.2, 0.3))
        one = loop._Loop(SimpleNamespace(clean=True), work, [], list(sensors), floors, None, 2, False)
        one._findings = lambda stage, trial, steps: [CUBIC] if ranking is None else list(ranking)
        one._decide = lambda stage, ranking, before, null, most: self.asked.append(most) or next(decisions)
        one._with = with_it
        one._standing = lambda stage: ["standing", stage.number]
        monkeypatch.setattr(loop, "estimate", lambda *a: None if estimated is None else estimated(one))
        monkeypatch.setattr(loop, "doubt_what_is_drawn", lambda *a: None)
        monkeypatch.setattr(loop, "wrong_by_noise", lambda *a: self.noisy.append(a) or list(wrong))
        self.loop = one
        self.report = one.run(model(0), max_steps, "band", None)

    @property
    def names(self):
        return [scene.name for scene in self.report.scenes]


def yes(*findings, gain=0.5, null_gain=0.0):
    return [(f, []) for f in findings], Verdict(True, gain, 1.0, null_gain, "it falls")


def no(*findings):
    return [(f, []) for f in findings], Verdict(False, 0.0, 0.0, 0.0, "it does not fall")


FRICTION, CUBIC = finding(laws.CoulombFriction()), finding(laws.CubicStiffness(), site="storey 2")


def test_a_limit_ends_the_walk_and_each_decision_knows_how_many_may_follow(monkeypatch):
    walk = Walk(monkeypatch, [yes(FRICTION), yes(CUBIC)], [80.0, 8.0, 0.8], max_steps=2)
    assert walk.asked == [2, 1] and walk.names == [
        "baseline",
        "coulomb_friction at storey 1",
        "cubic_stiffness at storey 2",
    ]
    assert walk.report.stopped == "2 effects were added, which is the limit set by max_steps"
    first, second = walk.report.steps
    assert (first.validation_before, first.validation_after) == (80.0, 8.0)
    assert (second.validation_before, second.validation_after) == (8.0, 0.8)
    assert walk.nulls == [(0, 2), (1, 2), (2, 2)] and [s.floor for s in walk.report.scenes] == [
        ("floor", k) for k in range(3)
    ]
    assert [s.trial.number for s in walk.report.scenes] == [0, 1, 2] and walk.last == [True, True]
    assert walk.report.band == "band" and walk.report.measured is walk.loop.ready
    assert (
        walk.loop._told(FRICTION) is first
        and walk.loop._told(CUBIC) is second
        and walk.loop._told(finding(laws.Dahl())) is None
    )


@pytest.mark.parametrize("share, goes_on", [(0.999, False), (1.0, True)])
def test_nothing_is_looked_for_where_the_balance_closes(monkeypatch, share, goes_on):
    walk = Walk(monkeypatch, [no(CUBIC, FRICTION)], [share * FLOOR])
    words = "No further effect is supported: the best candidate is cubic_stiffness at storey 2, but it does not fall"
    closed = "The balance closes within 0.02 % on the search data, nothing is left"
    assert walk.report.stopped == (words if goes_on else closed) and walk.report.steps == []


def test_the_walk_ends_at_the_floor_or_where_no_law_helps(monkeypatch):
    assert Walk(monkeypatch, [], [3.4567], closes=True).report.stopped == (
        "3.46 % are left on the search data, no more than noise (as given)"
    )
    walk = Walk(monkeypatch, [], [3.4567], ranking=())
    assert walk.report.stopped == "No law of the catalogue lowers the error at any site" and walk.asked == []


def test_a_fault_that_is_corrected_again_and_again_ends_the_walk_and_stays_one_step(monkeypatch):
    found = [fault(GainError(0.1 / k)) for k in (1, 2, 4, 8, 16)]
    walk = Walk(monkeypatch, [yes(f) for f in found], [80.0, 40.0, 20.0, 10.0, 5.0, 2.0], max_steps=2)
    assert walk.asked == [2, 1, 1, 1] and walk.names == ["baseline", "gain_error at sensor a1"]
    (one,) = walk.report.steps
    assert (one.validation_before, one.validation_after, one.gain) == (80.0, 5.0, 1 - 5 / 80)
    assert walk.report.scenes[-1].trial.number == 4 and walk.report.scenes[-1].folds[0] == 5.0
    assert one.parameters["e"] == pytest.approx(1.1 * 1.05 * 1.025 * 1.0125 - 1)


def test_what_the_last_step_gains_with_a_fault_corrected_again_counts_from_before_it(monkeypatch):
    found = [yes(fault(GainError(0.1))), yes(FRICTION), yes(fault(GainError(0.02)))]
    walk = Walk(monkeypatch, [*found, no(CUBIC)], [80.0, 40.0, 20.0, 10.0])
    gain, friction = walk.report.steps
    assert (gain.validation_after, friction.validation_before, friction.validation_after) == (40.0, 40.0, 10.0)
    assert friction.gain == pytest.approx(0.75) and friction.wins == 1.0 and gain.gain == 0.5
    assert gain.evidence == "it falls; corrected again by e = 0.02 beside coulomb_friction at storey 1"
    assert friction.evidence == "it falls; gain_error at sensor a1 corrected again by e = 0.02: it falls"
    assert len(walk.report.scenes) == 3


def test_effects_accepted_together_name_each_other_and_the_last_shows_what_is_needless(monkeypatch):
    third = finding(laws.Dahl(1.0), site="storey 3")
    walk = Walk(monkeypatch, [yes(FRICTION, CUBIC, third, null_gain=0.1), no(CUBIC)], [80.0, 40.0, 20.0, 10.0])
    assert walk.last == [False, False, True]
    assert [s.evidence for s in walk.report.steps] == [
        "it falls (together with cubic_stiffness at storey 2 and dahl at storey 3)",
        "it falls (together with coulomb_friction at storey 1 and dahl at storey 3)",
        "it falls (together with coulomb_friction at storey 1 and cubic_stiffness at storey 2)",
    ]
    assert all(np.isnan(s.null_gain) for s in walk.report.steps)  # no surrogate was run
    walk = Walk(monkeypatch, [yes(FRICTION, null_gain=0.1), no(CUBIC)], [80.0, 40.0], stages=[SimpleNamespace(
        trial=lambda: SimpleNamespace(fold_errors=lambda: np.ones(5)))])  # fmt: skip
    assert walk.report.steps[0].null_gain == 0.1


def test_a_needless_effect_loses_its_step_and_its_scene(monkeypatch):
    """Two steps with the same words: the one that goes is found by what it tells of, not by its words."""
    twins = [finding(laws.TwoSidedGap(0.1)), finding(laws.TwoSidedGap(0.1))]
    decisions = [yes(FRICTION), yes(twins[0]), yes(twins[1]), yes(CUBIC), no(CUBIC)]
    folds = [80.0, 40.0, 40.0, 40.0, 5.0]
    walk = Walk(monkeypatch, decisions, folds, max_steps=9, gone={4: [twins[1]]})
    assert [s.trial.number for s in walk.report.scenes] == [0, 1, 2, 4]
    assert walk.report.steps[1] is walk.loop._told(twins[0]) and len(walk.report.steps) == 3
    last = walk.report.steps[-1]
    assert last.evidence == "it falls; it makes two_sided_gap at storey 1 needless"
    assert (last.validation_before, last.validation_after) == (40.0, 5.0)
    walk = Walk(monkeypatch, decisions[:2] + [no(CUBIC)], [80.0, 40.0, 5.0], gone={2: [FRICTION]})
    assert [s.trial.number for s in walk.report.scenes] == [0, 2] and walk.report.steps[0].validation_before == 80.0


# -- what is sure at the end ------------------------------------------------------------------------


def ended(monkeypatch, left, before=100.0, **options):
    walk = Walk(monkeypatch, [yes(FRICTION), no(CUBIC)], [before, left], **options)
    return walk.report.steps[0], walk.report.stopped


@pytest.mark.parametrize("share, sure", [(0.99, True), (1.01, False)])
def test_a_name_is_sure_while_little_of_its_effect_is_left(monkeypatch, share, sure):
    step, _ = ended(monkeypatch, 100 * share * standing.SURE)
    assert step.sure == sure and step.remainder == pytest.approx(share * standing.SURE)
    step, _ = ended(monkeypatch, 100 * share * loop._USUALLY, least=1.0)  # chance did the rest
    assert step.sure == sure and step.remainder == pytest.approx(share * loop._USUALLY)
    step, _ = ended(monkeypatch, 1.0, least=100 * share * standing.SURE)
    assert step.sure == sure and step.remainder == pytest.approx(0.01)


@pytest.mark.parametrize(
    "left, floor, sure", [(0.99, np.nan, True), (1.01, np.nan, False), (1.01, 0.51, True), (1.01, 0.5, False)]
)
def test_no_name_is_sure_of_a_balance_that_stays_open_beyond_noise(monkeypatch, left, floor, sure):
    step, _ = ended(monkeypatch, left * loop._OPEN, 1e5, floor=floor * loop._OPEN)
    assert step.sure == sure


@pytest.mark.parametrize(
    "left, floor, told",
    [
        (2.01, 1.0, True),
        (1.99, 1.0, False),
        (5.0, np.nan, False),
        (1.01 * FLOOR, 1e-3, True),
        (0.99 * FLOOR, 1e-3, False),
    ],
)
def test_what_stays_unexplained_is_told_beyond_twice_the_noise(monkeypatch, left, floor, told):
    words = f". {left:.3g} % stay unexplained by any law (noise alone leaves about {floor:.2g} %), most in the "
    words += "balance of DOF 7"
    _, stopped = ended(monkeypatch, left, floor=floor)
    assert stopped.endswith(words) == told and ("unexplained" in stopped) == told


def test_a_model_that_noise_makes_wrong_is_said_to_be_so(monkeypatch):
    quiet = [SimpleNamespace(trial=lambda: SimpleNamespace(fold_errors=lambda: np.ones(5)))]
    wrong = ["2 % in a mass or a site's force", "200 % in Fc of coulomb_friction at storey 1"]
    walk = Walk(monkeypatch, [yes(FRICTION), no(CUBIC)], [100.0, 1.0], stages=quiet, wrong=wrong)
    words = "By noise alone least squares is wrong by up to 2 % in a mass or a site's force, 200 % in Fc of coulomb_"
    assert f"{words}friction at storey 1: fit NRFRegressor(laws=report.model.laws, estim" in walk.report.stopped
    (found,) = walk.noisy
    assert found[0] == ["standing", 1] and found[1].number == 1 and found[3] is walk.loop.ready
    assert "wrong by" not in ended(monkeypatch, 1.0, stages=quiet)[1]
    assert "wrong by" not in ended(monkeypatch, 1.0, wrong=wrong)[1]  # without surrogates nothing is known of it


@pytest.mark.parametrize("error, share", [(0.99, None), (1.0, 2), (100.0, 200)])
def test_what_noise_makes_wrong_is_told_of_the_model_and_of_the_worst_coefficient_of_each_effect(
    monkeypatch, error, share
):
    def effect(**bias):
        step = Step("stribeck_friction", "friction", "storey 1", bias=bias)
        one = standing.Standing(None, step, (Site("storey 1"), 1))
        one.parameters = lambda stage, solution: {"Fc": 3.25, "dF": -1.5, "of": solution}
        return one

    asked = []
    monkeypatch.setattr(standing, "unbiased", lambda stage, ready: asked.append((stage, ready)) or None)
    null = SimpleNamespace(error=error * standing._BIASED)
    model = [f"{share} % in a mass or a site's force"] if share else []
    least = standing._WRONG
    small = [effect(Fc=0.05, dF=-0.99 * least), effect()]
    assert standing.wrong_by_noise(small, "stage", null, "ready") == model and not asked
    large = [effect(Fc=0.05, dF=-0.2), *small, effect(Fc=1.01 * least, dF=0.01)]
    said = ["20 % in dF of stribeck_friction at storey 1", "10 % in Fc of stribeck_friction at storey 1"]
    assert standing.wrong_by_noise(large, "stage", null, "ready") == model + said and asked == [("stage", "ready")]
    monkeypatch.setattr(standing, "unbiased", lambda stage, ready: "instruments")
    said = [f"{said[0]} (instrumental variables: -1.5)", f"{said[1]} (instrumental variables: 3.25)"]
    assert standing.wrong_by_noise(large, "stage", null, "ready") == model + said


def test_channels_that_contradict_each_other_are_named_if_sensors_were_tried(monkeypatch):
    assert ended(monkeypatch, 1.0, sensors=["gain"])[1].endswith("the fusion made the best of it: a1 is late; x2 too")
    assert "contradict" not in ended(monkeypatch, 1.0)[1]


def test_noise_of_surrogates_is_not_asked_of_a_floor_that_is_measured(monkeypatch):
    seen = []
    quiet = [SimpleNamespace(trial=lambda: SimpleNamespace(fold_errors=lambda: np.full(5, 0.5)))]
    monkeypatch.setattr(loop, "surely_left", lambda folds, noise: seen.append([n.tolist() for n in noise]) or 1.0)
    ended(monkeypatch, 1.0, stages=quiet)
    ended(monkeypatch, 1.0, stages=quiet, measured=True)
    assert seen == [[[0.5] * 5], []]


@pytest.mark.parametrize("site, sure", [("storey 2", True), ("storey 1", False), ("ground 1", False)])
def test_what_had_to_be_added_later_at_a_place_takes_the_certainty(monkeypatch, site, sure):
    later = finding(laws.Dahl(1.0), site=site)
    walk = Walk(monkeypatch, [yes(finding(laws.CubicStiffness())), yes(later), no(CUBIC)], [100.0, 10.0, 2.0])
    assert [s.sure for s in walk.report.steps] == [sure, False]
    walk = Walk(monkeypatch, [yes(finding(laws.CubicStiffness())), yes(later), no(CUBIC)], [100.0, 90.0, 2.0])
    assert [s.sure for s in walk.report.steps] == [True, True]


def test_a_stribeck_force_that_falls_at_rest_is_not_sure(monkeypatch):
    def fallen(one):
        one.told[0][1].intervals = {"dF": (-2.0, -1.0)}

    for law, sure in ((laws.StribeckFriction(0.1), False), (laws.Dahl(1.0), True)):
        walk = Walk(monkeypatch, [yes(finding(law)), no(CUBIC)], [100.0, 1.0], estimated=fallen)
        assert walk.report.steps[0].sure == sure


# -- what is tried at a step ------------------------------------------------------------------------


def bare(**parts):
    """A loop without its records."""
    one = object.__new__(loop._Loop)
    one.accepted, one.told, one.every, one.sensors, one.progress = [], [], ["every"], ["gain"], False
    one.ready, one.work, one.rng, one.n_surrogates = SimpleNamespace(clean=True), "work", "rng", 2
    one.__dict__.update(parts)
    return one


def looked_for(monkeypatch, found, after=lambda f: f, now=10.0, faulty=(), steps=()):
    """What the search finds is refined and judged by a given function; the order of the calls is kept."""
    calls = []
    monkeypatch.setattr(loop, "lines_of", lambda trial: "lines")
    monkeypatch.setattr(loop, "screen", lambda *a, **k: calls.append((a, k)) or list(found))
    monkeypatch.setattr(loop, "refine", lambda stage, f: calls.append(f) or after(f))
    monkeypatch.setattr(loop, "validate", lambda stage, f: f)
    monkeypatch.setattr(loop, "sensor_findings", lambda *a: calls.append(a) or list(faulty))
    one = bare(accepted=[CUBIC])
    out = one._findings("stage", SimpleNamespace(search_error=lambda: now), list(steps))
    assert calls[0] == (("stage", ["every"], [(Site("storey 2"), "cubic_stiffness")], "lines", None), {"both": True})
    return out, [c for c in calls[1:-1]], calls[-1]


def test_what_does_not_even_lower_the_error_it_is_fitted_to_is_hopeless(monkeypatch):
    edge = 10.0 * (1 - loop._HOPELESS)
    found = [finding(laws.Dahl(1.0), 0.999 * edge), finding(laws.Iwan(0.1), edge)]
    out, refined, asked = looked_for(monkeypatch, found)
    assert out == found[:1] == refined and asked == (bare().ready, "work", "stage", ["gain"], set())


def test_the_best_of_a_shortlist_are_refined_and_the_best_of_these_judged(monkeypatch):
    found = [finding(laws.Dahl(1.0), 1.0 + 0.01 * k, f"storey {k + 1}") for k in range(20)]
    out, refined, _ = looked_for(monkeypatch, found)
    assert len(refined) == loop._SHORTLIST and out == found[: loop._VALIDATED]
    # the last of the shortlist may become the first
    turned = {id(f): finding(f.law, 9.0 - f.screen, str(f.site)) for f in found}
    out, _, _ = looked_for(monkeypatch, found, lambda f: turned[id(f)])
    assert [f.site.p for f in out] == list(range(loop._SHORTLIST, loop._SHORTLIST - loop._VALIDATED, -1))


def test_a_rich_law_that_takes_a_simpler_ones_place_is_refined_however_it_begins(monkeypatch):
    place = ((Site("storey 1"), 2),)
    rich, poor = finding(laws.Iwan(), 99.0, drop=place), finding(laws.Dahl(), 99.0, drop=place)
    assert len(rich.candidate.law.free_shape) == 2 and len(poor.candidate.law.free_shape) == 1
    free = finding(laws.Iwan(), 99.0, "storey 2")
    assert looked_for(monkeypatch, [rich, poor, free])[1] == [rich]
    near = finding(laws.Iwan(), 1.0, drop=place)
    assert looked_for(monkeypatch, [near])[1] == [near]  # once


def test_special_cases_of_the_best_three_are_judged_too(monkeypatch):
    general = [finding(laws.BoucWen(), 1.0), finding(laws.CubicStiffness(), 2.0, "storey 3"), finding(laws.Iwan(), 3.0)]
    fourth = finding(laws.StribeckFriction(), 4.0)
    special = {"dahl": finding(laws.Dahl(), 20.0), "jenkins": finding(laws.Jenkins(), 20.0)}
    friction = finding(laws.CoulombFriction(), 20.0)
    elsewhere = finding(laws.Dahl(), 20.0, "storey 2")
    found = [*general, fourth, *special.values(), friction, elsewhere]
    assert looked_for(monkeypatch, found)[0] == [*general, fourth, *special.values()]
    known = [general[0], finding(laws.Dahl(), 5.0)]
    assert looked_for(monkeypatch, known)[1] == known  # it is among them already


def test_faults_join_the_others_by_their_error_and_what_cannot_be_judged_is_left_out(monkeypatch):
    told = [Step("gain_error", "sensor", "sensor a1"), Step("dahl", "hysteresis", "storey 1")]
    one = fault(GainError(0.1), 2.0)
    found = [
        finding(laws.Dahl(1.0), 3.0),
        finding(laws.Iwan(0.1), 4.0, folds=[np.inf] * 5),
        finding(laws.Jenkins(0.1), 1.0),
    ]
    out, _, asked = looked_for(monkeypatch, found, faulty=[one], steps=told)
    assert [f.law.name for f in out] == ["jenkins", "gain_error", "dahl"]
    assert asked[-1] == {("gain_error", "sensor a1")}


@pytest.mark.parametrize(
    "share, wins, kept",
    [
        (1.01 * MEMBER_GAIN, 10, True),
        (0.99 * MEMBER_GAIN, 10, False),
        (0.5, round(10 * MIN_WINS), True),
        (0.5, 7, False),
    ],
)
def test_a_law_beside_an_earlier_one_must_beat_itself_in_its_place(share, wins, kept):
    law = laws.TwoSidedGap(0.1)
    place = ((Site("storey 1"), 2),)
    instead = finding(law, drop=place, folds=np.full(10, 1.0))
    beside = finding(law, folds=np.where(np.arange(10) < wins, 1 - share, 1.5))
    assert loop._missed([instead, beside]) == ([instead, beside] if kept else [instead])
    other = Finding(Candidate(laws.TwoSidedGap(), Site("storey 2")), law, 1.0, place, np.full(10, 1.0))
    endless = finding(law, drop=place, folds=np.full(10, np.inf))
    assert loop._missed([beside, other]) == [beside, other] and loop._missed([endless, beside]) == [endless, beside]
    same = finding(law, folds=np.full(10, 1.0))
    assert loop._missed([same, beside]) == [same, beside]


def test_a_candidate_is_held_if_law_site_and_place_are_the_same():
    one = finding(laws.Dahl(), 1.0)
    held = [finding(laws.Dahl(), 2.0)]
    assert loop._holds(held, one) and not loop._holds([], one)
    for other in (
        finding(laws.Dahl(), site="storey 2"),
        finding(laws.Iwan()),
        finding(laws.Dahl(), drop=((Site(1), 0),)),
    ):
        assert not loop._holds([other], one)


# -- what is decided --------------------------------------------------------------------------------


class Court:
    """Decisions of the loop where the parts that judge answer as told; what they were asked is kept."""

    def __init__(self, monkeypatch, clean=True, likeliest=None, confirmed=None, pair=None, ahead=None, alone=None,
                 reached=False, gain=0.0, together=None, judged=None):  # fmt: skip
        self.calls = calls = []
        self.one = one = bare(ready=SimpleNamespace(clean=clean))
        self.null = SimpleNamespace(reached=reached, gain=lambda f: calls.append(("gain", f)) or gain)
        one._polished = lambda stage, f: f
        one._alone = lambda stage, whole, verdict: alone(verdict) if alone else verdict
        one._run_together = lambda stage, found: calls.append(("together", found)) or (together or (lambda f: f))(found)
        if judged:
            one._judged = judged
        monkeypatch.setattr(Finding, "on", lambda self, stage: ("on", self.law.name))
        monkeypatch.setattr(sensors.SensorFinding, "on", lambda self, stage: ("on", self.law.name))

        def asked(name, answer):
            return lambda *a: calls.append((name, *a)) or (answer(*a) if answer else None)

        monkeypatch.setattr(loop, "likeliest", asked("likeliest", likeliest))
        monkeypatch.setattr(loop, "confirmed", asked("confirmed", confirmed or (lambda verdict, *a: verdict)))
        monkeypatch.setattr(loop, "pair_instead", asked("pair", pair))
        monkeypatch.setattr(loop, "look_ahead", asked("ahead", ahead))

    def decide(self, ranking, before=10.0, most=4):
        return self.one._decide("stage", ranking, np.full(5, before), self.null, most)

    def names(self):
        return [c[0] for c in self.calls]


def turned_down(verdict, *a):
    return Verdict(False, verdict.gain, 1.0, 0.0, "turned down")


def test_a_candidate_that_passes_all_is_accepted_alone(monkeypatch):
    court = Court(monkeypatch)
    best = finding(laws.CoulombFriction(), 5.0)
    members, verdict = court.decide([best, finding(laws.CubicStiffness(), 5.2)])
    assert members[0][0] is best and [f.law.family for f in members[0][1]] == ["stiffness"] and len(members) == 1
    assert verdict.accepted and verdict.gain == 0.5 and court.names() == ["gain", "confirmed", "pair", "together"]
    assert court.calls[1][2:] == ("stage", ("on", "coulomb_friction"), court.null, None)
    court.calls.clear()
    assert (
        court.decide([best], most=1)[1].accepted
        and court.calls[-1] == ("together", None)
        and "pair" not in court.names()
    )
    court.calls.clear()
    court.decide([best], most=2)
    assert "pair" in court.names()


def test_a_pair_that_runs_goes_before_the_one(monkeypatch):
    court = Court(monkeypatch, pair=lambda *a: "two")
    assert court.decide([FRICTION]) == "two" and court.calls[-1] == ("together", "two")
    court = Court(monkeypatch, pair=lambda *a: "two", together=lambda found: None)
    assert court.decide([FRICTION])[0] == [(FRICTION, [])]


def test_what_fails_the_gate_leaves_only_simpler_ones(monkeypatch):
    """Of three decisions each has fewer parameters; the first is named where none passes."""
    rich = finding(laws.BoucWen(0.1, 0.2), 9.9)
    ranking = [rich, finding(laws.Dahl(1.0), 9.95, "storey 2"), finding(laws.CoulombFriction(), 9.97, "storey 3")]
    assert [f.n_parameters for f in ranking][1:] == [2, 1]
    court = Court(monkeypatch)
    members, verdict = court.decide(ranking)
    assert members[0][0] in ranking and not verdict.accepted and court.names() == ["ahead", "together"]
    assert court.calls[0][1:3] == ("stage", ranking) and court.calls[0][5] == 4
    passing = finding(laws.CoulombFriction(), 5.0, "storey 3")
    tried = []
    court = Court(monkeypatch)
    monkeypatch.setattr(loop, "choose", lambda left, now: tried.append((list(left), now)) or (left[0], []))
    members, verdict = court.decide([*ranking[:2], passing])
    assert [len(left) for left, _ in tried] == [3, 2, 1] and tried[0][1] == 10.0 and members[0][0] is passing
    tried.clear()
    many = [finding(laws.Dahl(1.0), 9.9 + 0.01 * k, f"storey {k + 1}") for k in range(5)]
    assert court.decide(many)[0][0][0] is many[0] and [len(left) for left, _ in tried] == [5]  # none is simpler
    court = Court(monkeypatch, ahead=lambda *a: "several")
    assert court.decide(many) == "several"


def test_what_runs_worse_leaves_the_next_best_and_what_noise_makes_up_leaves_other_places(monkeypatch):
    ranking = [finding(laws.Dahl(1.0), 5.0, f"storey {k}") for k in (1, 2, 3, 4, 5)]
    tried = []
    monkeypatch.setattr(loop, "choose", lambda left, now: tried.append([f.site.p for f in left]) or (left[0], []))
    court = Court(monkeypatch, alone=turned_down)
    members, verdict = court.decide(ranking)
    assert tried == [[1, 2, 3, 4, 5], [2, 3, 4, 5], [3, 4, 5]] and members[0][0] is ranking[0]
    assert verdict.sentence == "turned down" and len(tried) == loop._DECISIONS and "confirmed" not in court.names()
    twins = [*ranking[:2], finding(laws.Iwan(0.1), 5.1), finding(laws.Dahl(2.0), 5.2, drop=((Site("storey 1"), 1),))]
    tried.clear()
    court.decide(twins)
    assert [len(left) for left in tried] == [4, 3, 2]  # another law, or another place, is another candidate
    tried.clear()
    court = Court(monkeypatch, confirmed=turned_down)
    grounded = [
        finding(laws.Dahl(1.0), 5.0),
        finding(laws.Iwan(0.1), 5.1, "ground 1"),
        finding(laws.Dahl(1.0), 5.2, "storey 2"),
    ]
    members, _ = court.decide(grounded)
    assert tried == [[1, 1, 2], [2]] and members[0][0] is grounded[0]


@pytest.mark.parametrize("gain, accepted", [(0.19, True), (0.23, False)])
def test_at_the_floor_a_law_must_gain_twice_what_noise_gains_and_a_fault_as_much(monkeypatch, gain, accepted):
    """A gain of 0.5 against twice 0.19 and a twentieth, or 0.23."""
    law = finding(laws.CoulombFriction(), 5.0)
    assert Court(monkeypatch, reached=True, gain=gain).decide([law])[1].accepted == accepted
    assert Court(monkeypatch, reached=False, gain=gain).decide([law])[1].accepted
    assert Court(monkeypatch, reached=True, gain=gain).decide([fault(GainError(0.1), 5.0)])[1].accepted


@pytest.mark.parametrize("remark, accepted", [("x1 and a1 disagree", True), ("", False)])
def test_a_fault_that_channels_witness_needs_less_gain(monkeypatch, remark, accepted):
    one = fault(GainError(0.1), 9.3)  # seven percent
    one.remark, one.ready = remark, "corrected records"
    court = Court(monkeypatch)
    assert court.decide([one])[1].accepted == accepted
    if accepted:
        assert court.calls[1][0] == "confirmed" and court.calls[1][-1] == "corrected records"
    assert not Court(monkeypatch).decide([finding(laws.CoulombFriction(), 9.3)])[1].accepted


def test_with_noise_the_likeliest_of_the_rivals_is_named_if_it_passes_too(monkeypatch):
    best, other = finding(laws.CoulombFriction(), 5.0), finding(laws.Dahl(1.0), 5.01)
    named = (other, ["tied"])
    good = Verdict(True, 0.4, 1.0, 0.0, "so does the other")
    for clean in (True, False):
        court = Court(monkeypatch, clean, lambda *a: named, judged=lambda *a: good)
        members, verdict = court.decide([best, other])
        assert (members[0] == named) == (not clean) and (verdict is good) == (not clean)
        assert [c[2] for c in court.calls if c[0] == "confirmed"][0] == "stage"
        assert [c[3] for c in court.calls if c[0] == "confirmed"] == [("on", "coulomb_friction" if clean else "dahl")]
    court = Court(monkeypatch, False, lambda *a: named, judged=lambda *a: turned_down(good))
    members, verdict = court.decide([best, other])
    assert members[0][0] is best and verdict.accepted and verdict.gain == 0.5
    court = Court(monkeypatch, False, lambda *a: (best, ["mine"]), judged=refuse)  # it is the likeliest itself
    members, verdict = court.decide([best, other])
    assert members == [(best, ["mine"])] and verdict.gain == 0.5
    court = Court(monkeypatch, False)
    assert court.decide([fault(GainError(0.1), 5.0)])[1].accepted and "likeliest" not in court.names()


def test_a_rival_is_judged_by_gate_surrogates_and_free_run(monkeypatch):
    one, before = bare(), np.full(5, 10.0)
    monkeypatch.setattr(Finding, "on", lambda self, stage: "with it")
    one._alone = lambda stage, whole, verdict: (stage, whole, verdict)
    null = SimpleNamespace(gain=lambda f: 0.1, reached=False)
    stage_, whole, verdict = one._judged("stage", finding(laws.CoulombFriction(), 5.0), before, null)
    assert (stage_, whole) == ("stage", "with it") and verdict.accepted and verdict.null_gain == 0.1
    assert not one._judged("stage", finding(laws.CoulombFriction(), 9.9), before, null).accepted
    null = SimpleNamespace(gain=lambda f: 0.3, reached=True)
    assert not one._judged("stage", finding(laws.CoulombFriction(), 5.0), before, null).accepted


@pytest.mark.parametrize("asked, run", [(0, 0), (1, 1), (4, 1)])
def test_a_rival_has_one_surrogate_at_most(monkeypatch, asked, run):
    monkeypatch.setattr(loop, "Null", lambda *a: a)
    one = bare(n_surrogates=asked)
    assert one._null("stage") == (one.ready, "stage", "rng", run)


# -- free runs, shapes and what is needless ---------------------------------------------------------


@pytest.mark.parametrize(
    "before, after, gain, accepted, words",
    [
        (10.0, 10.0 * loop._WORSE_ALONE, 0.3, True, "told"),
        (10.0, 10.001 * loop._WORSE_ALONE, 0.3, False, "told, but its free run rises from 10 to 13 %"),
        (10.0, 20.0, loop._BEYOND_DOUBT, True, "told; the free run rises from 10 to 20 %, so more is missing"),
        (10.0, 20.0, 0.999 * loop._BEYOND_DOUBT, False, "told, but its free run rises from 10 to 20 %"),
        (99.9, np.nan, 0.3, False, "told, but its free run (99.9 %) diverges"),
        (100.0, np.nan, 0.3, True, "told"), (np.nan, np.nan, 0.3, True, "told"),
        (99.9, np.inf, 0.9, True, "told; the free run (99.9 %) diverges, so more is missing"),
    ],
)  # fmt: skip
def test_an_effect_must_not_make_the_free_run_worse(before, after, gain, accepted, words):
    one = bare(_free_run={"without": before, "with": after}.__getitem__)
    verdict = one._alone("without", "with", Verdict(True, gain, 1.0, 0.0, "told"))
    assert (verdict.accepted, verdict.sentence) == (accepted, words)


def test_the_free_run_goes_over_the_blocks_that_each_record_begins_with(monkeypatch):
    seen = []
    monkeypatch.setattr(loop, "free_run_error", lambda model, work, blocks: seen.append((model, work, blocks)) or 3.0)
    runs = {0: [slice(0, 100), slice(150, 300)], 2: [slice(4, 80)]}
    work = SimpleNamespace(searched=[0, 2], runs=runs.__getitem__)
    one = SimpleNamespace(work=work, trial=lambda: SimpleNamespace(model=lambda: "model"))
    assert bare()._free_run(one) == 3.0
    assert seen == [("model", work, [BlockRows(0, slice(0, 100)), BlockRows(2, slice(4, 80))])]
    one.trial = lambda: SimpleNamespace(model=refuse)
    assert np.isnan(bare()._free_run(one))


@pytest.mark.parametrize("factor, kept", [(1.02, True), (1.0201, False)])
def test_a_finer_shape_is_taken_unless_the_folds_are_clearly_worse(monkeypatch, factor, kept):
    asked = []
    finer = finding(laws.Iwan(0.1, 0.5), factor * 2.0)
    monkeypatch.setattr(loop, "refine", lambda stage, f, n: asked.append(n) or finer)
    monkeypatch.setattr(loop, "validate", lambda stage, f: f)
    rough = Finding(Candidate(laws.Iwan(), Site("storey 1")), laws.Iwan(0.1, 0.6), 2.0, (), np.full(5, 2.0))
    assert bare()._polished(None, rough) is (finer if kept else rough) and asked == [240]
    plain = finding(laws.CoulombFriction())
    assert bare()._polished(None, plain) is plain and len(asked) == 1


def test_an_accepted_law_takes_the_place_of_those_it_drops_and_drives_out_the_needless(monkeypatch):
    places = {id(f): (f.site, k) for k, f in enumerate((FRICTION, CUBIC))}
    monkeypatch.setattr(loop, "place_of", lambda stage, f, accepted: places.get(id(f)))
    seen = []
    monkeypatch.setattr(loop, "reestimated", lambda stage, accepted: seen.append(list(accepted)) or ("again", stage))
    monkeypatch.setattr(loop, "needless", lambda stage, accepted: None)
    new = finding(laws.BoucWen(0.1, 0.5), drop=((FRICTION.site, 0),))
    monkeypatch.setattr(Finding, "on", lambda self, stage: ("with", stage))
    one = bare(accepted=[FRICTION, CUBIC])
    assert one._with("stage", new, True) == (("again", ("with", "stage")), []) and one.accepted == [CUBIC, new]
    assert seen[0] is not one.accepted and seen == [[CUBIC, new]]

    def model(name):
        return SimpleNamespace(name=name, work="work", chain="chain", without=lambda drop: ("without", drop))

    weak = iter([FRICTION, CUBIC, None])
    monkeypatch.setattr(loop, "needless", lambda stage, accepted: next(weak))
    monkeypatch.setattr(loop, "reestimated", lambda stage, accepted: stage)
    monkeypatch.setattr(loop, "Stage", lambda work, chain, laws: seen.append((work, chain, laws)) or model("less"))
    monkeypatch.setattr(Finding, "on", lambda self, stage: stage)
    one, third = bare(accepted=[FRICTION, CUBIC]), finding(laws.Dahl(1.0), site="storey 3")
    found, gone = one._with(model("all"), third, True)
    assert [f.law.name for f in gone] == ["coulomb_friction", "cubic_stiffness"] and one.accepted == [third]
    assert seen[1:] == [("work", "chain", ("without", [places[id(f)]])) for f in (FRICTION, CUBIC)]
    weak = iter([FRICTION])
    one = bare(accepted=[FRICTION, CUBIC])
    assert one._with(model("all"), third, False)[1] == [] and one.accepted == [FRICTION, CUBIC, third]


def test_a_corrected_channel_changes_the_records_and_is_no_law(monkeypatch):
    monkeypatch.setattr(loop, "reestimated", lambda stage, accepted: stage)
    monkeypatch.setattr(loop, "needless", lambda stage, accepted: None)
    one, found = bare(accepted=[]), fault(GainError(0.1))
    found.ready, found.stage = "corrected", SimpleNamespace(work="fresh")
    assert one._with(SimpleNamespace(), found, True) == (found.stage, []) and one.accepted == []
    assert (one.ready, one.work) == ("corrected", "fresh") and one._drift(found) == 0.0
    assert bare(work=SimpleNamespace(scales=lambda site: (7.0, 8.0, 9.0)))._drift(FRICTION) == 7.0


# -- what is told of the effects in the end ---------------------------------------------------------


def test_what_stands_in_the_end_is_what_has_a_place_and_a_step(monkeypatch):
    site = Site("storey 1")
    one, lost, untold = finding(laws.StribeckFriction(0.25)), finding(laws.Dahl(1.0)), finding(laws.Jenkins(0.1))
    step = Step("stribeck_friction", "friction", "storey 1")
    walk = bare(accepted=[lost, untold, one], told=[(one, step), (lost, step)])
    monkeypatch.setattr(loop, "place_of", lambda stage, f, accepted: None if f is lost else (site, 1))
    (found,) = walk._standing("stage")
    assert (found.finding, found.step, found.place) == (one, step, (site, 1))


def test_parameters_are_those_of_the_last_fit_at_the_place_of_each_effect(monkeypatch):
    site = Site("storey 1")
    held = (laws.LinearElastic(), laws.StribeckFriction(0.25))
    base = SimpleNamespace(
        laws={site: held}, at={(site, 0): 4, (site, 1): 5}, layout=SimpleNamespace(slices={site: slice(4, 7)}),
        work=SimpleNamespace(search=[1, 2, 3]),
    )  # fmt: skip
    theta = {site: np.array([9.0, 3.0, 2.0])}
    solved = []
    trial = SimpleNamespace(solve=lambda b: solved.append(list(b)) or SimpleNamespace(coefficients=theta))
    one = finding(laws.StribeckFriction(0.25))
    step = Step("stribeck_friction", "friction", "storey 1")
    effect = standing.Standing(one, step, (site, 1))
    seen = []
    monkeypatch.setattr(standing, "intervals", lambda *a: seen.append(a) or ({"Fc": (1.0, 2.0)}, {"Fc": 0.1}))
    standing.estimate([effect], base, trial, SimpleNamespace(stages=["s"], truth=None))
    assert solved == [[0, 1, 2]] and step.intervals == {"Fc": (1.0, 2.0)} and step.bias == {"Fc": 0.1}
    values = list(laws.StribeckFriction(0.25).with_values([3.0, 2.0]).parameters.items())
    assert list(step.parameters.items()) == values and seen[0][1] == (site, 1) and seen[0][2] is one.candidate.law
    assert seen[0][3].tolist() == [3.0, 2.0] and seen[0][4:] == (["s"], None)
    truth = SimpleNamespace(coefficients={site: np.array([8.0, 30.0, 20.0])})
    standing.estimate([effect], base, trial, SimpleNamespace(stages=["s"], truth=truth))
    assert seen[1][5].tolist() == [30.0, 20.0]


def test_no_name_is_sure_while_its_balances_hold_a_function_of_the_motion(monkeypatch):
    site, dof, other = Site("storey 1"), Site("dof 1"), Site("storey 2")
    every = [
        finding(laws.ConstantForce(), site="dof 1"),
        finding(laws.Dahl(1.0)),
        finding(laws.Dahl(1.0), site="storey 2"),
    ]
    effects = [
        standing.Standing(f, Step(f.law.name, f.law.family, str(f.site), remainder=0.1), (f.site, 0)) for f in every
    ]
    left = {site: 0.99 * standing.SURE, dof: 9.0, other: 1.01 * standing.SURE}
    seen = []

    def leftover(stage, stages, places):
        seen.append((stages, places))
        return left[places[0][0]]

    monkeypatch.setattr(standing, "leftover", leftover)
    standing.doubt_what_is_drawn(effects, "stage", SimpleNamespace(stages=["s"]), True)
    assert seen == [(["s"], [(site, 0), (dof, 0)]), (["s"], [(other, 0)])]  # the motion of a storey says more
    assert [e.step.sure for e in effects] == [True, True, False]
    assert [e.step.remainder for e in effects] == pytest.approx([0.1, 0.1, 1.01 * standing.SURE])
    for clean, stages, asked in ((True, [], 2), (False, ["s"], 2), (False, [], 0)):
        seen.clear()
        standing.doubt_what_is_drawn(effects, "stage", SimpleNamespace(stages=stages), clean)
        assert len(seen) == asked
    effects[1].step.sure = False
    standing.doubt_what_is_drawn(effects, "stage", SimpleNamespace(stages=["s"]), True)
    assert not effects[1].step.sure


# -- what a baseline must bring ---------------------------------------------------------------------


def test_covariates_of_declared_laws_must_be_in_every_record():
    ready = SimpleNamespace(data=SimpleNamespace(segments=[
        SimpleNamespace(name="one", covariates={"T": 0}), SimpleNamespace(name="two", covariates={}),
    ]))  # fmt: skip
    loop._require_covariates({Site("storey 1"): (laws.CoulombFriction(),)}, ready)
    with pytest.raises(ChannelError, match="Record 'two' has no covariate 'T', which covariate_friction at storey 1"):
        loop._require_covariates({Site("storey 1"): (laws.CovariateFriction(covariate="T"),)}, ready)
    ready.data.segments[1].covariates = {"T": 0, "more": 1}
    loop._require_covariates({Site("storey 1"): (laws.CovariateFriction(covariate="T"),)}, ready)


@pytest.mark.parametrize(
    "options, said",
    [
        ({}, None), ({"estimation": "iv"}, "estimation='iv'"), ({"constraints": "x"}, "constraints="),
        ({"estimation": "iv", "optimizer": "x"}, "estimation='iv', optimizer="),
    ],
)  # fmt: skip
def test_what_a_baseline_asks_for_beside_least_squares_is_said_not_to_be_used(options, said):
    one = SimpleNamespace(**{"estimation": "ls", "constraints": None, "optimizer": None, **options})
    if said is None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            loop._say_what_is_not_used(one)
    else:
        with pytest.warns(BiasWarning, match=f"does not use {said} of the baseline"):
            loop._say_what_is_not_used(one)


# -- shapes again, and what is needless -------------------------------------------------------------


def shaped_stage(*held, site="storey 1"):
    """A model of laws at one site with an error of 2, whose copies keep their laws."""
    one = SimpleNamespace(laws={Site(site): held}, work="work", chain="chain")
    one.slot = lambda: SimpleNamespace(search_error=lambda: 2.0, folds=lambda: np.full(10, 2.0))
    one.without = lambda drop: ("without", drop)
    one.with_values = lambda place, law: shaped_stage(
        *(law if k == place[1] else x for k, x in enumerate(one.laws[Site(site)])), site=site
    )
    return one


@pytest.mark.parametrize("screen, taken", [(1.999, True), (2.0, False), (2.1, False)])
def test_a_shape_is_moved_only_if_the_error_falls(monkeypatch, screen, taken):
    one = Finding(Candidate(laws.Dahl(), Site("storey 1")), laws.Dahl(1.0), 2.0)
    plain = finding(laws.CoulombFriction())
    asked = []

    def refine(base, f, evaluations, reach):
        asked.append((base, f.law.shape["sigma"], f.screen, evaluations, reach))
        return finding(laws.Dahl(3.0), screen)

    monkeypatch.setattr(reestimate, "Stage", lambda *a: a)
    monkeypatch.setattr(reestimate, "refine", refine)
    begin = shaped_stage(laws.CoulombFriction(), laws.Dahl(1.0))
    found = reestimate.reestimated(begin, [plain, one])
    assert (found is begin) != taken and found.laws[Site("storey 1")][1].shape["sigma"] == (3.0 if taken else 1.0)
    base = ("work", "chain", ("without", [(Site("storey 1"), 1)]))
    assert asked == [(base, 1.0, 2.0, reestimate._EVALUATIONS, reestimate._REACH)]  # once: no more is to be gained
    asked.clear()
    assert reestimate.reestimated(begin, [plain]) is begin and reestimate.reestimated(begin, [plain, one], 0) is begin
    assert asked == [] and reestimate.reestimated(begin, [finding(laws.Jenkins(0.1))]) is begin
    monkeypatch.setattr(reestimate, "refine", refuse)
    assert reestimate.reestimated(begin, [one]) is begin


@pytest.mark.parametrize("fall, rounds", [(1.01 * reestimate._ENOUGH, 2), (0.99 * reestimate._ENOUGH, 1)])
def test_shapes_are_gone_through_again_while_the_error_falls_enough(monkeypatch, fall, rounds):
    one = Finding(Candidate(laws.Dahl(), Site("storey 1")), laws.Dahl(1.0), 2.0)
    now = []

    def refine(base, f, *more):
        now.append(f.screen)
        return finding(laws.Dahl(3.0), f.screen * (1 - fall))

    monkeypatch.setattr(reestimate, "Stage", lambda *a: a)
    monkeypatch.setattr(reestimate, "refine", refine)
    reestimate.reestimated(shaped_stage(laws.Dahl(1.0)), [one])
    assert now == pytest.approx([2.0, 2.0 * (1 - fall)][:rounds], rel=1e-12)


def test_of_several_needless_effects_the_weakest_goes_and_special_cases_stay(monkeypatch):
    every = [finding(laws.CoulombFriction()), finding(laws.CubicStiffness()), finding(laws.Jenkins(0.1)), FRICTION]
    stage_ = shaped_stage(*(f.law for f in every))
    before = {0: 2.0 * 1.03, 1: 2.0 * 1.02, 2: 2.0 * 1.02}
    rounds = []

    def without(*a):
        level = before[a[2][1][0][1]]
        return SimpleNamespace(slot=lambda: SimpleNamespace(folds=lambda: np.full(10, level)))

    monkeypatch.setattr(reestimate, "Stage", without)
    monkeypatch.setattr(
        reestimate, "place_of", lambda stage, f, accepted: (f.site, every.index(f)) if f in every else None
    )
    monkeypatch.setattr(reestimate, "reestimated", lambda stage, others, n: rounds.append((others, n)) or stage)
    monkeypatch.setattr(Finding, "__eq__", lambda self, other: self is other)
    assert reestimate.needless(stage_, every) is every[1]  # of equals the first
    assert rounds == [([g for g in every if g is not f], 1) for f in every[:3]]
    before.update({0: 1.0})  # it is better without
    assert reestimate.needless(stage_, every) is every[0]
    monkeypatch.setattr(reestimate, "_imitates", lambda stage, general, special: special is every[0])
    assert reestimate.needless(stage_, every) is every[1]
    monkeypatch.setattr(reestimate, "_imitates", lambda *a: False)
    assert reestimate.needless(stage_, [finding(laws.Dahl(1.0)), *every[1:]]) is every[1]  # one that stands nowhere
    monkeypatch.setattr(reestimate, "reestimated", refuse)
    assert reestimate.needless(stage_, every) is None


# -- several together -------------------------------------------------------------------------------


def test_where_nothing_can_be_tried_nothing_is_gained(monkeypatch):
    assert together._null_gain(SimpleNamespace(slot=refuse), []) == 0.0
    level = SimpleNamespace(slot=lambda: SimpleNamespace(folds=lambda: np.full(3, FLOOR)))
    monkeypatch.setattr(together, "lines_for", lambda stage, c: ("lines", c))
    asked = []
    monkeypatch.setattr(together, "screen", lambda *a: asked.append(a) or [])
    assert together._null_gain(level, [FRICTION]) == 0.0
    assert asked == [(level, [FRICTION.candidate], (), ("lines", FRICTION.candidate))]
    monkeypatch.setattr(together, "screen", lambda *a: ["first", "second"])
    monkeypatch.setattr(together, "refine", lambda stage, f, n: (f, n))
    taken = []

    def validated(error):
        def on(stage):
            return taken.append(error) or stage

        return lambda stage, f: SimpleNamespace(
            error=error, folds=np.full(3, error), on=on, is_first=f == ("first", 20)
        )

    for error, gain in ((FLOOR / 2, 0.5), (FLOOR, 0.0), (np.inf, 0.0)):
        monkeypatch.setattr(together, "validate", validated(error))
        assert together._null_gain(level, [FRICTION]) == pytest.approx(gain)
    assert taken == [FLOOR / 2]


def chained(monkeypatch, ranking, errors, most=4, refused=()):
    """Which candidates are added one after another; the errors of each on the model so far are given by its site."""
    seen = []

    def validated(stage, f):
        seen.append((f.screen, stage))
        if str(f.site) in refused:
            refuse()
        return Finding(f.candidate, f.law, 0.0, (), np.array(errors[str(f.site)], dtype=float))

    monkeypatch.setattr(together, "refine", lambda stage, f, n: f if n == 40 else None)
    monkeypatch.setattr(together, "validate", validated)
    monkeypatch.setattr(Finding, "on", lambda self, stage: stage + 1)
    found = together._chain(0, ranking, np.full(10, 10.0), most)
    assert all(np.isinf(screen) for screen, _ in seen)
    return [(str(f.site), k) for f, _, k in found], [k for _, k in seen]


def test_the_best_of_each_place_is_added_while_it_helps_beside_those_before(monkeypatch):
    law = laws.CoulombFriction()
    ranking = [finding(law, 9.0 + 0.01 * k, f"storey {k}") for k in (3, 1, 2, 4, 5, 6)]
    low = {f"storey {k}": np.full(10, 9.0 - 0.7 * k) for k in range(1, 7)}
    assert chained(monkeypatch, ranking, low)[0] == [(f"storey {k}", k) for k in (1, 2, 3, 4)]
    assert chained(monkeypatch, ranking, low, 2) == ([("storey 1", 1), ("storey 2", 2)], [0, 1])
    errors = low | {
        "storey 1": np.full(10, 10 * (1 - 0.99 * MEMBER_GAIN)),
        "storey 2": np.full(10, 10 * (1 - 1.01 * MEMBER_GAIN)),
    }
    found, stages = chained(monkeypatch, ranking, errors)
    assert found == [(f"storey {k}", k - 1) for k in (2, 3, 4, 5)] and stages == [0, 0, 1, 2, 3]
    for wins, first in ((round(10 * MIN_WINS), "storey 1"), (round(10 * MIN_WINS) - 1, "storey 2")):
        errors = low | {"storey 1": np.where(np.arange(10) < wins, 8.3, 11.0)}
        assert chained(monkeypatch, ranking, errors)[0][0][0] == first
    assert chained(monkeypatch, ranking, low, refused=["storey 1"])[0][0] == ("storey 2", 1)
    # ground 1 is the place of storey 1; what drops another law, and a fault, are no members
    one = [finding(law, 9.0), finding(laws.Dahl(1.0), 9.5, "ground 1"), finding(law, 8.0, "storey 2", ((Site(2), 1),)),
           fault(GainError(0.1), 5.0)]  # fmt: skip
    assert chained(monkeypatch, one, low)[0] == [("storey 1", 1)]


def test_a_pair_is_of_one_family_and_site_without_shapes_and_no_richer_than_the_one(monkeypatch):
    asked = []

    def validated(stage, f):
        asked.append((stage, f.law.name, f.drop, f.screen))
        return Finding(f.candidate, f.law, 0.0, f.drop, np.full(10, 1.0))

    monkeypatch.setattr(together, "validate", validated)
    monkeypatch.setattr(Finding, "on", lambda self, stage: (*stage, self.law.name))
    passed = []
    monkeypatch.setattr(together, "_passed", lambda *a: passed.append(a) or Verdict(True, 0.5, 1.0, 0.0, ""))
    names = (laws.QuadraticStiffness(), laws.CubicStiffness(), laws.QuadraticDamping(), laws.Dahl(), laws.Duffing())
    every = [Candidate(law, Site("storey 1")) for law in names] + [Candidate(laws.QuinticStiffness(), Site("storey 2"))]
    place = ((Site("storey 1"), 1),)
    one = Finding(Candidate(laws.TwoSidedGap(), Site("storey 1")), laws.TwoSidedGap(0.1), 2.0, place, np.full(10, 2.0))
    members, verdict = together.pair_instead((), one, every, "before", "null")
    assert [(f.law.name, tied) for f, tied in members] == [("quadratic_stiffness", []), ("cubic_stiffness", [])]
    assert asked[:2] == [
        ((), "quadratic_stiffness", place, np.inf), (("quadratic_stiffness",), "cubic_stiffness", (), np.inf)
    ]  # fmt: skip
    assert "quadratic_damping" not in [name for _, name, _, _ in asked]
    assert passed[0][2] == ("quadratic_stiffness", "cubic_stiffness") and passed[0][3:] == ("before", "null", 2)
    assert together.pair_instead((), fault(GainError(0.1)), every, None, None) is None
    assert together.pair_instead((), one, every[2:], None, None) is None
    monkeypatch.setattr(together, "_passed", lambda *a: None)
    assert together.pair_instead((), one, every, None, None) is None
    monkeypatch.setattr(together, "validate", refuse)
    assert together.pair_instead((), one, every, None, None) is None


@pytest.mark.parametrize("stages, null_gain, reached, accepted", [
    ((), 9.0, False, True), ((1, 2), 0.46, False, False), ((1, 2), 0.4, False, True), ((1, 2), 0.4, True, False),
])  # fmt: skip
def test_several_are_judged_as_one_beside_surrogates_and_confirmed(monkeypatch, stages, null_gain, reached, accepted):
    site, law = Site("storey 1"), laws.TwoSidedGap(0.1)
    dropped, confirmed = [], []
    whole = SimpleNamespace(laws={site: (law, laws.CubicStiffness(), law)}, work=None, chain=None)
    whole.slot = lambda: SimpleNamespace(folds=lambda: np.full(10, 5.0))
    whole.without = lambda where: dropped.append(where)
    monkeypatch.setattr(together, "Stage", refuse)  # without it the others cannot stand: it is not asked about
    monkeypatch.setattr(together, "_null_gain", lambda s, members: null_gain if s == 2 else 0.0)
    monkeypatch.setattr(together, "confirmed", lambda verdict, *a: confirmed.append(a) or verdict)
    null = SimpleNamespace(stages=list(stages), reached=reached)
    verdict = together._passed("stage", [finding(law)], whole, np.full(10, 10.0), null, 2)
    assert (verdict is not None) == accepted and dropped == [[(site, 2)]]  # the last that was added
    assert confirmed == ([("stage", whole, null)] if accepted else [])
    assert not accepted or verdict.null_gain == (null_gain if stages else 0.0)
    monkeypatch.setattr(together, "confirmed", turned_down)
    assert together._passed("stage", [finding(law)], whole, np.full(10, 10.0), null, 2) is None


# -- candidates beside what is there ----------------------------------------------------------------


def test_an_accepted_law_of_a_candidates_family_or_columns_is_replaced_and_a_declared_one_is_not():
    site = Site("storey 1")
    held = (laws.LinearElastic(), laws.CubicStiffness(), laws.Dahl(1.0), laws.CubicStiffness())
    stage_ = SimpleNamespace(laws={site: held})
    quintic = Candidate(laws.QuinticStiffness(), site)
    accepted = [(site, "dahl"), (site, "cubic_stiffness"), (Site("storey 2"), "cubic_stiffness")]
    assert search.replaced(stage_, quintic, accepted) == ((site, 3),)  # of two the last, which was accepted
    assert search.replaced(stage_, quintic, [*accepted, (site, "cubic_stiffness")]) == ((site, 1), (site, 3))
    assert search.replaced(stage_, Candidate(laws.Jenkins(), site), accepted) == ((site, 2),)
    assert search.replaced(stage_, Candidate(laws.CoulombFriction(), site), accepted) == ()
    assert search.replaced(stage_, Candidate(laws.Jenkins(), Site("storey 3")), accepted) == ()
    dof = Site("dof 1")
    forced = SimpleNamespace(laws={dof: (laws.HarmonicForce(3.0), laws.ConstantForce())})
    both = [(dof, "harmonic_force"), (dof, "constant_force")]
    assert search.replaced(forced, Candidate(laws.ConstantForce(), dof), both) == ((dof, 1),)  # it shares its column


def test_laws_that_hold_each_other_or_share_a_column_stand_not_beside_each_other():
    assert search.excludes(laws.Iwan(), laws.Jenkins()) and search.excludes(laws.Jenkins(), laws.Iwan())
    assert search.excludes(laws.CubicStiffness(), laws.CubicStiffness()) and search.excludes(
        laws.Duffing(), laws.CubicStiffness()
    )
    assert not search.excludes(laws.Dahl(), laws.Dahl(1.0)) and not search.excludes(laws.Dahl(), laws.Jenkins())
    site = Site("storey 1")
    stage_ = SimpleNamespace(laws={site: (laws.Jenkins(0.1), laws.Dahl(1.0), laws.TwoSidedGap(0.1))})
    every = tuple((site, i) for i in range(3))
    assert search.beside(stage_, Candidate(laws.Iwan(), site), every) == ((site, 0),)
    assert search.beside(stage_, Candidate(laws.LuGre(), site), every[:2]) == ((site, 1),)


def test_a_candidate_is_tried_in_the_place_of_its_like_and_beside_it(monkeypatch):
    site = Site("storey 1")
    ticks, kept = [], []

    def slot(site, law, out):
        def errors(points, keep):
            kept.append((out, len(points), keep))
            return np.array([5.0, 3.0, 4.0] + [6.0] * (len(points) - 3))

        return SimpleNamespace(errors=errors)

    work = SimpleNamespace(scales=lambda site: (0.02, 0.3, 40.0), fastest=50.0)
    stage_ = SimpleNamespace(laws={site: (laws.LinearElastic(), laws.TwoSidedGap(0.1))}, work=work, slot=slot)
    one = Candidate(laws.TwoSidedGap(), site)
    accepted = [(site, "two_sided_gap")]
    found = search._scan(stage_, [one], accepted, None, lambda: ticks.append(1), True)
    grid = search.grid_of(stage_, one)
    assert [(f.drop, f.n_freed, f.n_added) for f in found] == [(((site, 1),), 2, 0), ((), 0, 2)] and ticks == [1]
    assert [f.law for f in found] == [grid[1]] * 2 and [f.screen for f in found] == [3.0] * 2
    assert kept == [(((site, 1),), 9, True), ((), 9, True)]
    assert [f.drop for f in search._scan(stage_, [one], accepted, None, None, False)] == [((site, 1),)]
    wave = Candidate(laws.HarmonicForce(), Site("dof 1"))
    kept.clear()
    search._scan(stage_, [wave], (), {Site("dof 1"): [3.0, 4.0, 5.0, 6.0]}, None, False)
    assert kept == [((), 4, True)]
    after = search._scan(stage_, [wave, one], (), {Site("dof 2"): [3.0]}, None, False)  # no line, no candidate
    assert [f.law.name for f in after] == ["two_sided_gap"]


@pytest.mark.parametrize("now, everywhere", [(20.0, True), (20.1, False)])
def test_rich_laws_are_tried_everywhere_unless_a_simple_one_lowers_the_error_by_a_twentieth(
    monkeypatch, now, everywhere
):
    """0.95 of 20 is 19."""
    every = [Candidate(law, Site(i)) for i in (1, 2) for law in (laws.CoulombFriction(), laws.BoucWen())]

    def scan(stage, candidates, *more):
        return [Finding(c, c.law, 19.0 if c.site.p == 1 else 40.0) for c in candidates]

    monkeypatch.setattr(search, "_scan", scan)
    one = SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: now))
    found = [f.site.p for f in search.screen(one, every) if f.law.name == "bouc_wen"]
    assert found == ([1, 2] if everywhere else [1])


def test_a_refinement_begins_inwards_at_the_upper_end_and_keeps_to_its_trials():
    law, site = laws.Iwan(), Site("storey 1")
    work = SimpleNamespace(scales=lambda site: (0.02, 0.3, 40.0), fastest=50.0)
    axes, tried = search.Axes(law, work, site), []

    def errors(points):
        tried.extend(axes.point(p) for p in points)
        return [5.0]

    asked = []
    stage_ = SimpleNamespace(work=work, slot=lambda *a: asked.append(a) or SimpleNamespace(errors=errors))
    step = (axes.high - axes.low) / search._GRID[2]
    for share, sign in ((0.49, -1), (0.51, 1)):
        begin = axes.high - share * step
        start = Finding(Candidate(law, site), axes.at(begin), 5.0, ((site, 1),))
        tried.clear()
        assert search.refine(stage_, start) is start and asked[-1] == (site, law, ((site, 1),))
        assert tried[0] == pytest.approx(begin) and len(tried) <= search._EVALUATIONS[2]
        wanted = [begin + (-1 if sign < 0 else 1) * 0.5 * step * np.eye(2)[k] for k in range(2)]
        for one, goal in zip(tried[1:3], wanted):
            assert one == pytest.approx(goal)
    tried.clear()
    search.refine(stage_, Finding(Candidate(law, site), axes.at((axes.low + axes.high) / 2), 5.0), 7, 0.1)
    assert len(tried) == 7 and tried[1][0] - tried[0][0] == pytest.approx(0.1 * step[0])


def test_one_shape_ends_in_the_middle_of_what_the_error_cannot_tell():
    law, site = laws.StiffnessStep(), Site("storey 1")
    work = SimpleNamespace(scales=lambda site: (0.02, 0.3, 40.0), fastest=50.0)
    axes = search.Axes(law, work, site)
    low, high = axes.ends
    a, b = low + 0.3 * (high - low), low + 0.5 * (high - low)
    stage_ = SimpleNamespace(
        work=work,
        slot=lambda *x: SimpleNamespace(
            errors=lambda points: [1.0 + max(0.0, a - axes.point(p)[0], axes.point(p)[0] - b) for p in points]
        ),
    )
    start = Finding(Candidate(law, site), axes.at(np.array([a + 0.05 * (b - a)])), 1.0, folds=np.ones(3))
    found = search.refine(stage_, start)
    assert axes.point(found.law)[0] == pytest.approx((a + b) / 2, abs=0.02 * (b - a))
    assert found.screen == 1.0 and len(found.folds) == 0
    wave = search.Axes(laws.HarmonicForce(), work, Site("dof 1"))
    assert wave.step(True).tolist() == [0.002]


# -- a place for a law ------------------------------------------------------------------------------


def test_laws_are_built_some_at_once_and_one_that_overflows_costs_only_itself(monkeypatch):
    built = []
    one = object.__new__(stage.Slot)
    one._errors = lambda laws, keep: built.append((list(laws), keep)) or np.array(laws, dtype=float)
    n = 2 * stage._AT_ONCE + 1
    assert one.errors(list(range(n)), True).tolist() == list(range(n))
    assert [(len(part), keep) for part, keep in built] == [(stage._AT_ONCE, True)] * 2 + [(1, True)]
    assert one.errors([]).shape == (0,)

    class Numbers(stage.Slot):
        """Laws are numbers x of one column; the error is x^2 and the samples, the coefficient 1."""

        def __init__(self):
            self._members, self._size, self.width = np.ones((1, 2), dtype=bool), 1, 1
            self.work = SimpleNamespace(sizes=np.array([3.0, 4.0]))
            self._project = lambda total, sizes: (total[:, 0, 1, 1] + sizes[:, 0], np.ones((len(total), 2)), None)

        def _columns(self, laws, keep=False):
            if "bad" in laws:
                refuse()
            return np.array([[x, 1.0] for x in laws])

        def extended(self, columns, spans):
            assert spans == [slice(0, 2)]
            return np.array([np.diag([1.0, x * x])[None] for x in columns[:, 0]])

    assert Numbers()._errors(["bad"], False).tolist() == [np.inf]
    monkeypatch.setattr(stage, "admissible", lambda law, theta, size: law != 5.0 and size.tolist() == [law])
    assert Numbers()._errors([4.0, "bad", 5.0, 9.0], False).tolist() == [23.0, np.inf, np.inf, 88.0]


# -- where a force acts -----------------------------------------------------------------------------


def ranked(monkeypatch, shares, own=None, n=2, sites=None, at_floor=False, known=None):
    """Sites put in order by given shares of patterns, and by what their own motions are said to explain."""
    known = list(range(n)) if known is None else known
    chain, asked = Chain(n), []

    def pattern(site):
        b = localisation._incidence(chain, site)[known]
        return b if b.any() else None

    def share(b):
        asked.append(tuple(b))
        value = shares[tuple(b)] if isinstance(shares, dict) else shares
        return value, value - 0.01, value + 0.01

    def explained(site, b):
        asked.append(str(site))
        return (own or {}).get(str(site), np.nan), 2.0

    fake = SimpleNamespace(known=known, noise=None, at_floor=at_floor, pattern=pattern, share=share, own=explained)
    monkeypatch.setattr(localisation._Work, "of", lambda *a: fake)
    residual = SimpleNamespace(model=SimpleNamespace(chain=chain), data=SimpleNamespace(forced=(2,)))
    return localisation.localise(residual, sites), asked


@pytest.mark.parametrize("second, followed", [(0.7499, False), (0.7501, True)])
def test_equal_patterns_are_judged_once_and_put_in_order_by_their_own_motion(monkeypatch, second, followed):
    """Sites within six times five percent of the best are followed."""
    shares = {(-1, 1): 1.05, (1, 0): 0.9, (0, 1): second}
    own = {"storey 1": 40.0, "storey 2": 80.0, "ground 2": 10.0, "sensor a2": 20.0}
    names = ["storey 1", "dof 1", "storey 2", "ground 2", "sensor a2", "storey 1"]
    table, asked = ranked(monkeypatch, shares, own, sites=names)
    assert asked[:3] == [(1, 0), (-1, 1), (0, 1)] and not isinstance(asked[3], tuple)
    end = ["sensor a2", "ground 2"] if followed else ["ground 2", "sensor a2"]
    assert list(table.index) == ["storey 2", "dof 1", "storey 1", *end]  # from outside: 60 % follow no motion
    assert table["own"].tolist()[:3] == [80.0, 60.0, 40.0] and np.isfinite(table["own"].iloc[3]) == followed
    assert table["share"].tolist() == pytest.approx([100.0, 90.0, 90.0, 100 * second, 100 * second])
    assert table["high"].iloc[0] == 100.0 and table["low"].iloc[1] == pytest.approx(89.0)
    assert table["rms"].iloc[0] == 2.0 and table["balances"].tolist() == ["-1, +2", "+1", "+1", "+2", "+2"]
    assert table["verdict"].iloc[0] == (
        "explains 100 % (balances -1, +2); its own motion explains 80 % of the force; next dof 1 (90 %)"
    )
    assert table["verdict"].iloc[1] == "explains 90 % (balances +1); 60 % follows no motion there"


def test_some_of_the_best_are_followed_and_none_at_the_floor(monkeypatch):
    table, asked = ranked(monkeypatch, 0.5, n=5)
    names = [a for a in asked if isinstance(a, str)]
    assert (
        names
        == [
            str(s)
            for s in localisation._all_sites(
                SimpleNamespace(model=SimpleNamespace(chain=Chain(5)), data=SimpleNamespace(forced=(2,)))
            )
        ][: 2 * localisation._FOLLOWED]
    )
    table, asked = ranked(monkeypatch, 0.5, at_floor=True)
    assert not [a for a in asked if isinstance(a, str)] and table["own"].isna().all()
    assert table["verdict"].iloc[0] == "all balances together leave round-off: nothing to locate"
    table, asked = ranked(monkeypatch, 0.5, sites=["storey 2", "storey 1"], known=[1])
    assert list(table.index) == ["storey 2", "storey 1"] and np.isnan(table["share"].iloc[1])
    assert table["verdict"].tolist() == ["one balance: the signs say nothing", "not seen in the known balances"]


def test_sites_are_storeys_links_grounds_dofs_and_sensors_of_what_is_forced():
    residual = SimpleNamespace(model=SimpleNamespace(chain=Chain(4)), data=SimpleNamespace(forced=(2, 4)))
    assert [str(s) for s in localisation._all_sites(residual)] == (
        ["storey 1", "storey 2", "storey 3", "storey 4", "link 3-1", "link 4-1", "link 4-2"]
        + ["ground 2", "ground 3", "ground 4", "dof 1", "dof 2", "dof 3", "dof 4"]
        + ["sensor a1", "sensor a2", "sensor a3", "sensor a4", "sensor F2", "sensor F4"]
    )
    chain = Chain(3)
    assert localisation._incidence(chain, Site("sensor a3")).tolist() == [0, 0, 1]
    assert localisation._incidence(chain, Site("sensor F1")).tolist() == [1, 0, 0]
    assert localisation._incidence(chain, Site("link 3-1")).tolist() == [-1, 0, 1]
    assert localisation._signs(chain, Site("link 3-1")) == "-1, +3"
    for wrong in ("sensor a4", "sensor x1", "sensor v2", "sensor ag"):
        with pytest.raises(ChannelError, match="not felt in one balance"):
            localisation._incidence(chain, Site(wrong))


def test_a_pattern_is_kept_with_its_first_sign_positive():
    for b in ([-1.0, 1.0], [1.0, -1.0]):
        assert np.frombuffer(localisation._key(np.array(b))).tolist() == [1.0, -1.0]
    assert np.frombuffer(localisation._key(np.array([0.0, 1.0, -1.0]))).tolist() == [0.0, 1.0, -1.0]
    assert localisation._key(np.array([0.0, -1.0])) == localisation._key(np.array([0.0, 1.0]))  # no zero of another sign
    assert localisation._key(None) == b""


@pytest.mark.parametrize("known, told", [(2, True), (1, False)])
def test_sites_of_one_pattern_are_named_where_there_is_more_than_one_balance(known, told):
    names = ["ground 2", "sensor a2", "dof 2", "storey 1"]
    table = pd.DataFrame({"share": [90.0, 90.0, 90.0, 10.0], "own": np.nan, "balances": "+2"}, index=names)
    table["low"] = table["high"] = table["share"]
    work = SimpleNamespace(known=list(range(known)), at_floor=False, noise=None)
    patterns = {Site(s): np.array([0.0, 1.0] if s != "storey 1" else [1.0, 0.0]) for s in names}
    said = localisation._verdicts(table, patterns, work)
    if told:
        assert said[0] == "explains 90 % (balances +2); next storey 1 (10 %); the same pattern as sensor a2, dof 2"
    else:
        assert said[0] == "one balance: the signs say nothing"
    assert "pattern" not in "".join(said[1:]) and "next" not in "".join(said[1:])
    alone = localisation._verdicts(table.iloc[[0, 3]], patterns, SimpleNamespace(**vars(work) | {"known": [0, 1]}))
    assert alone[0] == "explains 90 % (balances +2); next storey 1 (10 %)"


def four(forced=(1,), masses=(1.0, 2.0, 3.0, 5.0), n=60, f=None):
    """Four balances of a chain under forces on some, with what a force on DOF 2 leaves."""
    X, F = np.random.default_rng(0).standard_normal((n, 12)), np.zeros((n, 4))
    F[:, [j - 1 for j in forced]] = 1.0
    model = ChainModel(
        list(masses), {i: [laws.LinearElastic(1.0 + i), laws.LinearViscous(0.1 * i)] for i in (1, 2, 3, 4)}
    )
    one = residual.residual_of(model, from_arrays(X, F, dt=0.01))
    return one.with_balance([np.outer(noise(n, 1) if f is None else f, [0, 1, 0, 0])]), X


@pytest.mark.parametrize(
    "site, forced, known, free",
    [
        (None, (1,), (), "1234"),
        ("dof 2", (1,), (), "13"),
        ("ground 2", (1, 4), (), "134"),
        ("storey 3", (1,), (), "1234"),
        (None, (1,), (3,), "124"),
        ("dof 2", (1,), (3,), "1"),
        ("dof 2", (2,), (), "3"),
        ("dof 2", (3,), (), "34"),
        (None, (), (), ""),
        ("dof 4", (1,), (), "123"),
    ],
)
def test_of_a_piece_that_no_force_scales_the_largest_mass_is_held(site, forced, known, free):
    one, _ = four(forced)
    work = localisation._Work.of(one, None, (), known, 10)
    b = None if site is None else work.pattern(Site(site))
    assert "".join(str(j + 1) for j in np.flatnonzero(work._free_masses(b))) == free
    if site == "dof 2":  # the same beside it
        beside = localisation._Work.of(one, None, ["dof 2"], known, 10)
        assert beside._free_masses(None).tolist() == work._free_masses(b).tolist()


@pytest.mark.parametrize("known, columns", [((), "al"), ((2,), "l"), ((3,), "a"), ((4,), "a")])
def test_a_force_may_hold_what_enters_like_it_and_the_forces_of_a_piece_cut_off(known, columns):
    f = noise(60, 3)
    one, X = four(f=f)
    force, base = localisation.missing_force(one, "dof 2", known_masses=known)
    assert force[0] == pytest.approx(f)
    wanted = {"a": X[:, 1], "l": -(4.0 * X[:, 10] + 0.3 * X[:, 6])}
    assert base[0] == pytest.approx(np.column_stack([wanted[c] for c in columns]), abs=1e-6)


def test_a_model_that_is_corrected_is_loose_with_its_corrections():
    f, d = noise(60, 3), 0.7
    one, X = four(f=f)
    s3 = X[:, 10]
    force, base = localisation.missing_force(
        one.with_balance([np.outer(f, [0, 1, 0, 0]) + d * np.outer(s3, [0, -1, 1, 0])]), "dof 2"
    )
    assert force[0] == pytest.approx(f) and base[0][:, 1] == pytest.approx(-((4.0 + d) * s3 + 0.3 * X[:, 6]))


@pytest.mark.parametrize("gap, tied", [(4e-9, True), (4e-8, False)])
def test_shares_that_differ_in_the_seventh_digit_are_equal(monkeypatch, gap, tied):
    own = {"storey 2": 10.0, "storey 1": 90.0}
    table, _ = ranked(monkeypatch, {(-1, 1): 0.9 + gap, (1, 0): 0.9}, own, sites=["storey 2", "storey 1"])
    assert list(table.index) == (["storey 1", "storey 2"] if tied else ["storey 2", "storey 1"])


def test_a_residual_below_the_floor_is_a_part_of_it():
    one, X = four()
    one = one.with_balance([noise(240, 5).reshape(60, 4)])
    quiet, loud = (localisation._Work.of(one, localisation.NoiseFloor.given(x, 4), (), (), 10) for x in (1e-3, 1e3))
    assert loud.over_floor == pytest.approx(1e-6 * quiet.over_floor) and loud.at_floor and not quiet.at_floor


def test_the_noise_of_the_weights_is_nine_tenths_the_covariance_and_one_its_diagonal():
    one, _ = four()
    S = np.array([[4.0, 1, 0, 0], [1, 9, 0, 0], [0, 0, 1, 0.5], [0, 0, 0.5, 1]])
    work = localisation._Work.of(one, SimpleNamespace(covariance=lambda: S), (), (), 10)
    wanted = S * np.where(np.eye(4) > 0, 1.0, 0.9)
    assert work.noise == pytest.approx(wanted) and work.weight == pytest.approx(np.linalg.inv(wanted))
    for bad in (np.nan, 0.0):
        S[0, 0] = bad
        assert localisation._Work.of(one, SimpleNamespace(covariance=lambda: S), (), (), 10).noise is None
    assert work.forced.tolist() == [True, False, False, False] and not work.held.any()
    assert localisation._Work.of(four(())[0], None, (), (), 10).held.all()  # masses that were given scale the chain


@pytest.mark.parametrize("n, sizes", [(100, [100]), (2047, [2047]), (2048, [1024, 1024]), (4096, [2048, 1024, 1024])])
def test_blocks_of_the_band_hold_a_thousand_samples_or_so(n, sizes):
    one, X = four(n=n)
    work = localisation._Work.of(one, None, (), (), 3)
    assert work.sizes.tolist() == sizes and work.grams.shape == (len(sizes), 16, 16)
    a = X[:, :4]
    assert work.grams.sum(axis=0)[8:12, 8:12] == pytest.approx(a.T @ a)
    assert np.isfinite(work.share(work.pattern(Site("dof 2")))[1]) == (len(sizes) == 3)


def test_the_share_of_a_force_that_its_own_motion_explains_is_asked_of_sensors_and_links():
    one, X = four(n=600)
    work = localisation._Work.of(one, None, (), (), 10)
    line = np.gradient(X[:, 1])
    work.force = lambda b: ([line], [np.ones((600, 1))])
    own, rms = work.own(Site("sensor a2"), 0)
    assert own == pytest.approx(100.0, abs=1e-3) and rms == pytest.approx(np.sqrt(np.mean(line**2)))
    assert np.isnan(work.own(Site("dof 2"), 0)[0])
    work.force = lambda b: ([noise(600, 9)], [np.ones((600, 1))])
    assert work.own(Site("sensor a2"), 0)[0] == pytest.approx(0.0, abs=2.0) and work.own(Site("sensor a2"), 0)[0] >= 0.0
    work.force = lambda b: ([np.zeros(600)], [np.ones((600, 1))])
    assert np.isnan(work.own(Site("sensor a2"), 0)[0]) and work.own(Site("sensor a2"), 0)[1] == 0.0
    m = one.data.segments[0].motion(Site("storey 2"), slice(0, 600))
    columns = localisation._Own(Site("storey 2"), one).of(0)
    assert columns[:, 0].tolist() == m.s.tolist() and columns[:, 1].tolist() == m.v.tolist() and columns.shape[1] > 2


# -- faults of sensors ------------------------------------------------------------------------------


def test_a_fault_whose_channels_cannot_be_fused_is_none(monkeypatch):
    one = sensors.Suspect(GainError(0.1), Site("sensor a1"))
    for error, known in ((NRFError("x", "y"), True), (np.linalg.LinAlgError("x"), True), (TypeError("x"), False)):

        def fail(*a, error=error):
            raise error

        monkeypatch.setattr(sensors, "as_true", fail)
        if known:
            assert sensors._rebuilt(prepare.Prepared(["r"], None), None, None, one) is None
        else:
            with pytest.raises(TypeError):
                sensors._rebuilt(prepare.Prepared(["r"], None), None, None, one)


def test_everything_is_built_again_from_the_corrected_records(monkeypatch):
    prepared, moved = [], []

    def built(*a):
        prepared.append(a)
        return SimpleNamespace(data=SimpleNamespace(segments="fused"))

    trial = SimpleNamespace(search_error=lambda: 3.0, fold_errors=lambda: np.arange(3.0))
    monkeypatch.setattr(sensors, "as_true", lambda r, site, law: f"{r} true")
    monkeypatch.setattr(sensors, "prepare", built)
    monkeypatch.setattr(sensors, "_with_segments", lambda work, segments: moved.append(segments) or "moved")
    monkeypatch.setattr(sensors, "_shifted", lambda seg, kind, j, law: (seg, kind, j, law.values[0]))
    monkeypatch.setattr(
        sensors, "Stage", lambda work, chain, laws: SimpleNamespace(key=(work, chain, laws), trial=lambda: trial)
    )
    monkeypatch.setattr(sensors, "SegmentSet", lambda segments, n: SimpleNamespace(segments=segments, n_samples=n))
    base = SimpleNamespace(chain="chain", laws="laws")
    work = SimpleNamespace(data=SimpleNamespace(segments=[7], n_samples=50))
    ready = prepare.Prepared(["r0", "r1", "r2"], None, heldout=[1], clean=True)
    for held in ([1], None):
        ready.heldout = held
        found = sensors._rebuilt(
            ready, work, base, sensors.Suspect(GainError(0.1), Site("sensor a12"), "they disagree")
        )
        assert (found.screen, found.folds.tolist(), found.remark) == (3.0, [0.0, 1.0, 2.0], "they disagree")
        assert found.stage.key == ("moved", "chain", "laws") and moved[-1] == "fused"
    assert prepared == [(["r0 true", "r2 true"], ["r1 true"]), (["r0 true", "r1 true", "r2 true"], None)]
    force = sensors._rebuilt(ready, work, base, sensors.Suspect(GainError(0.1), Site("sensor F2")))
    assert len(prepared) == 2 and moved[-1] == [(7, "F", 2, 0.1)] and force.ready.clean
    assert force.ready.records == ["r0 true", "r1 true", "r2 true"] and force.ready.data.n_samples == 50


GAIN = GainError()


def findings_of(monkeypatch, seen=(), scanned=(), error=5.0, screens=None, names=(GAIN,), corrected=()):
    """Faults that channels tell (with their size) and that balances promise (with their error)."""
    calls = []
    built = {}

    def rebuilt(ready, work, stage, s):
        calls.append(("rebuilt", str(s.site)))
        one = fault(s.law, (screens or {}).get(str(s.site), 2.0), str(s.site), (screens or {}).get(str(s.site), 2.0))
        one.remark = s.remark
        return built.setdefault(str(s.site), one)

    promised = {f"sensor {c}": e for c, e in scanned}
    monkeypatch.setattr(sensors, "contradictory", lambda ready, work: [
        (size, sensors.Suspect(law, Site(f"sensor {c}"), "they disagree")) for size, law, c in seen])  # fmt: skip
    monkeypatch.setattr(sensors, "_alone", lambda *a: [sensors.Suspect(GainError(), Site(s)) for s in promised])
    monkeypatch.setattr(
        sensors,
        "_scan",
        lambda work, stage, s, now: None if promised[str(s.site)] is None else (promised[str(s.site)], s),
    )
    monkeypatch.setattr(sensors, "_rebuilt", rebuilt)
    monkeypatch.setattr(sensors, "_sharpened", lambda ready, work, stage, f: calls.append(("sharp", str(f.site))) or f)
    stage_ = SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: error))
    told = sensors.sensor_findings(SimpleNamespace(refused={}), None, stage_, list(names), corrected)
    return [str(f.site) for f in told], calls


def test_the_best_promises_and_the_first_contradictions_are_built_again(monkeypatch):
    scanned = [("a1", 3.0), ("a2", 1.0), ("a3", None), ("a4", 2.0)]
    told, calls = findings_of(monkeypatch, scanned=scanned)
    assert [c for _, c in calls] == ["sensor a2", "sensor a4"] and told == ["sensor a2", "sensor a4"]
    from pysindy_nrf.discrepancy.contradictions import CONTRADICTION, MOST

    seen = [(CONTRADICTION, GainError(0.1), f"a{k}") for k in range(1, MOST + 3)]
    assert len([c for kind, c in findings_of(monkeypatch, seen)[1] if kind == "rebuilt"]) == MOST
    seen = [(0.999 * CONTRADICTION, GainError(0.1), "a1"), (CONTRADICTION, ChannelDelay(0.1), "a2")]
    assert findings_of(monkeypatch, seen)[0] == []  # too small, and of a kind that is not tried
    assert findings_of(monkeypatch, seen, names=[ChannelDelay()])[0] == ["sensor a2"]


@pytest.mark.parametrize("screen, sharp", [(0.999, True), (1.001, False)])
def test_a_fault_that_channels_tell_is_sharpened_if_the_error_falls_by_what_the_gate_asks(monkeypatch, screen, sharp):
    screen *= 5.0 * (1 - sensors._WITNESSED)
    seen = [(9.0, GainError(0.1), "a1")]
    assert (("sharp", "sensor a1") in findings_of(monkeypatch, seen, screens={"sensor a1": screen})[1]) == sharp
    assert findings_of(monkeypatch, scanned=[("a1", 1.0)])[1] == [("rebuilt", "sensor a1")]  # no channel bears witness
    for screen, told in ((4.999, ["sensor a1"]), (5.0, [])):
        assert findings_of(monkeypatch, seen, screens={"sensor a1": screen})[0] == told


def test_the_value_of_an_offset_is_looked_for_near_the_mean_of_its_displacement(monkeypatch):
    monkeypatch.setattr(sensors, "longest", lambda work: (1, slice(2, 6)))
    s = np.arange(30.0).reshape(10, 3)
    work = SimpleNamespace(data=SimpleNamespace(segments=[None, SimpleNamespace(s=s)]))
    means = sensors._means(work, sensors.Suspect(SensorOffset(), Site("sensor x2")))
    assert means == [pytest.approx((s[2:6, 0] + s[2:6, 1]).mean())]
    assert sensors._means(work, sensors.Suspect(GainError(), Site("sensor x2"))) == []


def wild(monkeypatch, error, means=(), law=None):
    """A scan of a fault of the unit 1/2 whose error is a given function, with coarse trials where the model is wild."""
    tried = []
    monkeypatch.setattr(sensors, "_shifted", lambda seg, kind, j, law: law.values[0])
    monkeypatch.setattr(sensors, "_with_segments", lambda work, moved: moved[0])
    monkeypatch.setattr(sensors, "_means", lambda work, suspect: list(means))

    def model(value, chain, laws):
        tried.append(value)
        return SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: error(value)))

    monkeypatch.setattr(sensors, "Stage", model)
    work = SimpleNamespace(data=SimpleNamespace(segments=[0]), scales=lambda site: (0.5, 0, 0))
    base = SimpleNamespace(chain=None, laws=None)
    return sensors._scan(work, base, sensors.Suspect(law or SensorOffset(), Site("sensor x2")), error(0.0)), tried


def test_coarse_trials_are_shares_of_the_reach_and_the_mean_within_it(monkeypatch):
    reach = 0.5 * sensors._STEPS["sensor_offset"][1]
    assert wild(monkeypatch, lambda x: 30.0, [1.3, 1.01 * reach])[1][2:] == pytest.approx(
        [*(reach * sensors._COARSE), 1.3]
    )

    def well(x):
        return 30.0 if abs(x - 1.3) > 0.6 else 5.0 + 20 * abs(x - 1.25)

    found, tried = wild(monkeypatch, well, [1.3])
    assert found[1].law.values[0] == pytest.approx(1.25, abs=0.01) and found[0] == pytest.approx(5.0, abs=0.2)
    assert 0.5 * 1.3 <= min(tried[7:]) and max(tried[7:]) <= 1.7 * 1.3
    for share, looked in ((1.001, False), (0.999, True)):  # of what the coarse trials must promise
        level = 30.0 * (1 - sensors._PROMISE) * share
        tried = wild(monkeypatch, lambda x, level=level: 30.0 if abs(x) < 1 else level)[1]
        assert (len(tried) > 6) == looked


def test_a_fault_that_cannot_be_tried_costs_the_most(monkeypatch):
    def error(x):
        return refuse() if x > 0 else 10.0 + 20 * (x + 0.2) ** 2

    found, _ = wild(monkeypatch, error)
    assert found is None or found[1].law.values[0] < 0
    assert wild(monkeypatch, lambda x: refuse() if x else 10.0)[0] is None


def test_a_record_without_a_step_is_shifted_by_samples_and_a_silent_force_stays():
    n = 60
    X, F = np.random.default_rng(0).standard_normal((n, 6)), np.zeros((n, 2))
    F[:, 0] = np.sin(np.arange(n) / 3.0)
    seg = from_arrays(X, F, dt=0.01).segments[0]
    assert sensors._shifted(seg, "F", 2, SensorOffset(0.5)).F.tolist() == seg.F.tolist()
    assert sensors._shifted(seg, "F", 1, SensorOffset(0.5)).F[:, 0] == pytest.approx(F[:, 0] - 0.5)
    seg.F[:, 1] = np.nan
    unknown = sensors._shifted(seg, "F", 2, SensorOffset(0.5))
    assert np.isnan(unknown.F[:, 1]).all() and unknown.valid == seg.valid
    still = from_arrays(X, F).segments[0]
    assert still.dt is None
    late = sensors._shifted(still, "F", 1, ChannelDelay(2.0))  # two samples
    rows = slice(5, n - 5)
    assert late.F[rows, 0] == pytest.approx(F[7 : n - 3, 0], abs=0.05)


# -- words of a step --------------------------------------------------------------------------------


def test_a_step_of_a_fault_tells_its_values_equals_and_what_the_channels_say():
    one = fault(GainError(0.1), 2.0, "sensor a2")
    one.equals, one.remark = ["sensor x2"], "a2 and x2 disagree"
    verdict = Verdict(True, 0.5, 1.0, 0.0, "it falls")
    told = steps.step_of(one, [], verdict, np.ones(3), np.ones(3), 0.5, [], 0.0)
    assert told.parameters == {"e": 0.1} and told.sensors == ["sensor x2"] and told.site == "sensor a2"
    assert told.evidence == "it falls (a2 and x2 disagree)"
    one.remark = ""
    assert steps.step_of(one, [], verdict, np.ones(3), np.ones(3), 0.5, [], 0.0).evidence == "it falls"


def test_the_worst_balance_is_that_with_the_largest_share(monkeypatch):
    table = pd.DataFrame({"error": [3.0, 9.0, 99.0]}, index=["storey 1", "dof 2", "pooled"])
    monkeypatch.setattr(steps, "model_of", lambda layout, solution: ("model", layout, solution))
    monkeypatch.setattr(steps, "balance_errors", lambda model, moments: table if (model, moments) == (
        ("model", "layout", [0, 1]), [0, 1]) else None)  # fmt: skip
    trial = SimpleNamespace(work=SimpleNamespace(search=["a", "b"]), layout="layout", solve=list, moments=list)
    assert steps.worst(trial) == "balance of DOF 2"
    table["error"] = [9.5, 9.0, 99.0]
    assert steps.worst(trial) == "balance of storey 1"


def test_at_most_two_other_families_are_named():
    tied = [finding(law) for law in (laws.QuadraticStiffness(), laws.QuadraticDamping(), laws.TwoSidedGap(0.1))]
    assert steps._alternatives(finding(laws.CubicStiffness()), tied, 1.0) == ["stiffness", "damping"]
    assert steps._alternatives(finding(laws.Jenkins(0.1)), tied, 1.0) == ["friction", "stiffness"]
    for law in (laws.Jenkins(), laws.PowerLawDamping()):  # a shape that is not known is not small
        assert steps._alternatives(finding(law), [], 1.0) == []
    one = Step(
        "power_law_damping", "damping", "storey 1", intervals={"n": (0.1, 0.5)}, alternatives=["a", "b", "friction"]
    )
    steps.doubt_names([one])
    assert one.alternatives == ["friction", "a"]
    plain = Step("power_law_damping", "damping", "storey 1")
    steps.doubt_names([plain])
    assert plain.alternatives == []
    every = [
        Step("constant_force", "forcing", "dof 1", alternatives=["a"]),
        Step("dahl", "hysteresis", "storey 1", alternatives=["b", "forcing"]),
    ]
    steps.doubt_names(every)
    assert every[0].alternatives == ["a", "hysteresis"] and every[1].sure and every[0].sure
    alone = Step("constant_force", "forcing", "dof 1", alternatives=["a", "b", "c"])
    steps.doubt_names([alone])
    assert alone.alternatives == ["a", "b", "c"]


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
    one.__dict__["_made"] = (stages, 0.3, 0.2, "truth")
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
    def one(model):
        if error is not None:
            raise error
        return "stage"

    monkeypatch.setattr(surrogate, "model_of", lambda layout, found: SimpleNamespace(masses=np.array(masses)))
    monkeypatch.setattr(surrogate, "_finite", list)
    trial = SimpleNamespace(layout=None, solve=lambda blocks: list(blocks))
    null = surrogate.Null(None, SimpleNamespace(trial=lambda: trial, work=SimpleNamespace(search="ab")), None, 3)
    null._one, null._like_the_truth = one, lambda trial, found, first: (first, found)
    assert null._surrogates() == ((["stage"] * count, [0, 1]) if count else ([], 0.0, 0.0, None))


def test_surrogates_of_the_truth_that_have_no_free_run_leave_those_of_the_model(monkeypatch):
    site, first = Site("storey 1"), [SimpleNamespace(work=SimpleNamespace(search=[0, 1]))]
    first[0].trial = lambda: SimpleNamespace(solve=lambda blocks: Solution({1: 9.0}, {site: np.array([80.0])}))
    found = Solution({1: 10.0}, {site: np.array([100.0])})
    null = surrogate.Null(None, None, None, 1)
    null._shift = lambda trial, a, b, whole=False: 0.2 if whole else 0.1
    monkeypatch.setattr(surrogate, "model_of", lambda layout, found: found)
    for error in (NRFError("x", "y"), np.linalg.LinAlgError("x")):

        def fail(model, error=error):
            raise error

        null._one = fail
        assert null._like_the_truth(SimpleNamespace(layout=0), found, first) == (first, 0.1, 0.2, found)
    null._one = lambda model: model
    monkeypatch.setattr(surrogate, "_finite", lambda stages: [s for s in stages if s.masses[1] == 11.0])
    stages, _, _, truth = null._like_the_truth(SimpleNamespace(layout=0), found, first)
    assert stages == [truth] and truth.coefficients[site].tolist() == [120.0]
    first[0].trial = lambda: SimpleNamespace(solve=refuse)
    assert null._like_the_truth(SimpleNamespace(layout=0), found, first) == (first, 0.0, 0.0, found)


def test_a_surrogate_has_the_quietest_noise_that_is_told_and_blocks_within_its_rows(monkeypatch):
    """Of the force itself and of its balance, each may tell the noise alone."""
    made, spaces = [], []
    records = SimpleNamespace(records=["r0", "r1"], noise=[{"a1": 9.0}, {"a1": 1.0}])
    search = [BlockRows(1, slice(0, 40)), BlockRows(1, slice(40, 90)), BlockRows(1, slice(90, 120))]
    work = SimpleNamespace(
        searched=[1],
        search=search,
        data=SimpleNamespace(segments=["s0", "s1"]),
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
    monkeypatch.setattr(surrogate, "prepare", lambda fakes, noise: prepared.append((fakes, noise)) or SimpleNamespace(
        data=SimpleNamespace(segments=[seg])))  # fmt: skip
    monkeypatch.setattr(surrogate, "Workspace", lambda *a: spaces.append(a) or "fresh")
    monkeypatch.setattr(surrogate, "Stage", lambda *a: a)
    assert null._one("model") == ("fresh", "chain", "laws")
    assert made == [("r1", "s1", "model", {"a1": 1.0, "F1": 0.2, "F2": 0.5, "F3": 0.5}, "rng", "linear")]
    assert prepared == [(["fake"], [{"a1": 1.0}])]
    assert spaces[0][1:] == (
        ["f1"],
        [BlockRows(0, slice(0, 40)), BlockRows(0, slice(40, 90)), BlockRows(0, slice(90, 95))],
        [],
        {1: 2.0},
        "auto",
    )
    seg.valid = slice(3, 80)
    null._one("model")
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


def test_a_surrogate_starts_where_the_record_does_and_leaves_unmeasured_channels_out():
    n = 50
    zeros = np.zeros((n, 2))
    x = zeros.copy()
    x[:, 1] = np.nan
    record = Record(fs=100.0, force=zeros, displacement=x, velocity=zeros, acceleration=zeros)
    seg = from_arrays(np.tile([0, 0, 1.0, 2.0, 0.1, 0.3], (n, 1)), zeros, dt=0.01).segments[0]
    seg.valid = slice(4, n)
    asked = {}

    def simulate(force, dt, **more):
        asked.update(more, force=force, dt=dt)
        return SimpleNamespace(acceleration=zeros, velocity=zeros + 1, displacement=zeros + 2)

    fake = surrogate.surrogate(
        record, seg, SimpleNamespace(simulate=simulate), {"F2": 1.0, "v1": 2.0}, np.random.default_rng(0), "cubic"
    )
    assert (
        asked["x0"] == pytest.approx([0.1, 0.4])
        and asked["v0"] == pytest.approx([1.0, 3.0])
        and asked["hold"] == "cubic"
    )
    assert asked["dt"] == 0.01 and asked["base_acceleration"] is None and asked["covariates"] is None
    draws = [np.random.default_rng(0).standard_normal(n)]
    assert np.isnan(fake.displacement[:, 1]).all() and fake.displacement[:, 0].tolist() == [2.0] * n
    assert (fake.velocity[:, 1] == 1.0).all() and (fake.velocity[:, 0] - 1).std() == pytest.approx(2.0, rel=0.3)
    assert not fake.force[:, 0].any() and fake.force[:, 1].std() == pytest.approx(1.0, rel=0.3) and len(draws) == 1


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
    null = SimpleNamespace(ready=SimpleNamespace(clean=False), stages=[1] if bias else [], bias=1.0, floor=np.nan)
    verdict = second_opinion.confirmed(Verdict(True, 0.9, 1.0, 0.0, "told"), level, level, null)
    assert not verdict.accepted and verdict.sentence == f"told{words} no instruments can tell"
    null.ready.clean = True
    assert second_opinion.confirmed(verdict, None, None, null) is verdict


# -- lines ------------------------------------------------------------------------------------------


def test_lines_are_looked_for_in_the_longest_record_with_zeros_where_it_is_held_out(monkeypatch):
    def seg(start, stop, dt=0.01):
        return SimpleNamespace(valid=slice(start, stop), dt=dt)

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


def record(n=400, level=0.0, n_dof=1, seed=0, name="r", **more):
    """A cosine of one DOF whose three channels agree but for white noise of a share of their rms."""
    t, rng = np.arange(n) / 100, np.random.default_rng(seed)
    x = np.cos(5 * t)[:, None] * np.arange(1, n_dof + 1)
    motion = {"displacement": x, "velocity": np.gradient(x, t, axis=0), "acceleration": -25 * x}
    motion = {k: y + level * y.std(axis=0) * rng.standard_normal(y.shape) for k, y in motion.items()}
    return Record(fs=100.0, force=rng.standard_normal((n, n_dof)), name=name, **motion, **more)


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
        def __init__(self, noise):
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


# -- pages ------------------------------------------------------------------------------------------


def told_report(**more):
    step = Step(
        "dahl", "hysteresis", "storey 2", parameters={"Fd": 2.0}, evidence="a|b", tied=[("iwan", "storey 2", 1.0)]
    )
    step.runners_up = [("iwan", "storey 2", 1.0), ("jenkins", "storey 1", 2.0)]
    step.detection, step.characterisation = "It is no noise.", "It is a loop."
    table = pd.DataFrame({"held-out": [31.0, 2.0]}, index=["baseline", "dahl at storey 2"])
    return SimpleNamespace(
        **{
            "steps": [step],
            "stopped_because": "of <it>",
            "table": table,
            "evidence": [],
            "measured": [],
            "model": "m ``` n",
            "settings": {},
            **more,
        }
    )


def test_a_report_in_markdown_line_by_line():
    one = told_report()
    head = [
        "# Closing the loop",
        "",
        f"1. {one.steps[0].sentence}".replace("|", "\\|"),
        "",
        "Stopped: of &lt;it>.",
        "",
        "Errors in percent NRMSE; balance errors (one step) except the free run.",
        "",
        "|  | held-out |",
        "|---|---|",
        "| baseline | 31 |",
        "| dahl at storey 2 | 2 |",
        "",
        "## Step 1: dahl at storey 2",
        "",
        "- It is no noise.",
        "- It is a loop.",
        "- Accepted because a\\|b.",
        "",
        "| parameter | estimate | lower | upper |",
        "|---|---|---|---|",
        "| Fd | 2 |  |  |",
        "",
        "Alternatives:",
        "",
        "| law | site | validation error (%) |  |",
        "|---|---|---|---|",
        "| iwan | storey 2 | 1 | tied |",
        "| jenkins | storey 1 | 2 |  |",
        "",
    ]
    tail = ["## Model", "", "```", "m ''' n", "```", ""]
    assert markdown.markdown(one).split("\n") == [*head, *tail]
    seen = [
        SimpleNamespace(detection_sentence=f"d{k}", localisation_sentence=f"l{k}", characterisation_sentence=f"c{k}")
        for k in (1, 2)
    ]
    more = told_report(evidence=seen, measured=[SimpleNamespace(sentence="x1"), SimpleNamespace(sentence="a1")],
                       settings={"loop": {"seed": 0, "band": "full"}, "gate": {"a": 1}})  # fmt: skip
    rest = ["## What is left", "", "- d2", "- l2", "- c2", "", "## What was measured", "", "- x1", "- a1", ""]
    settings = ["## Settings", "", "- loop: seed = 0, band = full", "- gate: a = 1", ""]
    assert markdown.markdown(more).split("\n") == [*head, *rest, *tail, *settings]
    assert markdown.markdown(told_report(steps=[])).split("\n")[2] == "No effect was added."
    plain = Step("dahl", "hysteresis", "storey 2", evidence="why")
    assert (
        "Alternatives:" not in markdown._step(3, plain) and markdown._step(3, plain)[0] == "## Step 3: dahl at storey 2"
    )


def test_settings_name_what_was_held_out():
    ready = SimpleNamespace(heldout=[1, 2], records=[SimpleNamespace(name=n) for n in "abc"])
    tried = [laws.Dahl(), laws.Dahl(1.0), laws.Iwan()]
    told = report.audit(NRFRegressor(degree=1), tried, (1.0, 2.0), 5, 3, 2, ready, "words")["loop"]
    assert told == {
        "band": "(1.0, 2.0) Hz",
        "random_state": "5",
        "max_steps": "3",
        "n_surrogates": "2",
        "noise floor": "words",
        "held out": "b; c",
        "catalogue": "dahl, iwan",
    }
    ready.heldout = None
    told = report.audit(NRFRegressor(degree=1), tried, None, 5, 3, 2, ready)["loop"]
    assert told["band"] == "full" and told["held out"] == "a quarter of every record" and told["noise floor"] == ""


def assembled(monkeypatch, errors, steps, band=None, names=None, coupling=""):
    """The report of models whose held-out errors are given, by balance and pooled."""
    monkeypatch.setattr(report, "model_of", lambda layout, solution: layout)
    monkeypatch.setattr(report, "balance_errors", lambda model, moments: pd.DataFrame({"error": model.errors}))
    monkeypatch.setattr(
        report, "free_run_error", lambda model, work, blocks: 2 * model.errors["pooled"] if blocks == "held" else None
    )
    monkeypatch.setattr(report, "gather", lambda scenes, models, steps: [SimpleNamespace(coupling_sentence=coupling)])
    monkeypatch.setattr(report, "loops_of", lambda model, *a: (model, *a))
    monkeypatch.setattr(report, "searched", lambda work: ("data", "filters"))
    monkeypatch.setattr(report, "measured_of", lambda ready: ("measured", ready))
    work = SimpleNamespace(search=[BlockRows(0, slice(0, 9))] * 3, blocks=[0] * 5, held="held", motion=refuse)
    scenes = []
    for k, (found, held) in enumerate(errors):
        model = SimpleNamespace(errors=found, laws=held, visited={}, info=None)
        trial = SimpleNamespace(layout=model, work=work, solve=list, moments=lambda blocks: list(blocks))
        trial.error = lambda solution, blocks, k=k: 10.0 * k + len(solution) + len(blocks)
        scenes.append(report.Scene((names or ["baseline", "one", "two"])[k], trial, np.array([1.0, 5.0, 9.0]) + k))
    one = [finding(laws.Dahl(1.0), 3.0, "storey 2")]
    return report.LoopReport.assemble(work, scenes, steps, "done", one, band, "ready", None)


def test_the_table_and_the_steps_tell_each_models_errors(monkeypatch):
    site = Site("storey 1")
    told = [Step("dahl", "hysteresis", "storey 1"), Step("iwan", "hysteresis", "storey 1", parameters={"F1": 7.0})]
    old, new = laws.Dahl(1.0).with_values([3.0]), laws.Dahl(1.0).with_values([4.0])
    errors = [
        ({"dof 1": 30.0, "dof 2": 20.0, "pooled": 25.0}, {}),
        ({"dof 1": 3.0, "dof 2": 2.0, "pooled": 2.5}, {site: (old, new)}),
        ({"dof 1": 0.3, "dof 2": 0.2, "pooled": 0.25}, {site: (laws.Iwan(0.1, 0.5),)}),
    ]
    found = assembled(monkeypatch, errors, told, names=["baseline", "same", "same"])
    assert list(found.table.index) == ["baseline", "same", "same (2)"]
    assert list(found.table.columns) == [
        "search",
        "validation",
        "held-out",
        "free run",
        "held-out dof 1",
        "held-out dof 2",
        "band",
    ]
    assert found.table.iloc[1].tolist() == [16.0, 6.0, 2.5, 5.0, 3.0, 2.0, "full"]
    assert [(s.error_before, s.error_after, s.free_run_before, s.free_run_after) for s in told] == [
        (25, 2.5, 50, 5),
        (2.5, 0.25, 5, 0.5),
    ]
    assert told[0].parameters == old.parameters and told[1].parameters == {"F1": 7.0}  # as it stood last
    assert (
        found.model.errors["pooled"] == 0.25
        and len(found.models) == 3
        and found.loops == (found.model, "data", "filters")
    )
    assert found.model.info == {
        "band": None,
        "steps": ["dahl at storey 1", "iwan at storey 1"],
        "stopped_because": "done",
    }
    assert found.candidates.to_dict("records") == [
        {"law": "dahl", "family": "hysteresis", "site": "storey 2", "validation error (%)": 3.0}
    ]
    assert (
        str(found).split("\n")[-1] == "Stopped: done."
        and str(found).startswith("1. dahl at storey 1 ")
        and "\n2. iwan" in str(found)
    )


@pytest.mark.parametrize(
    "band, words",
    [((2.0, 40.0), "2-40 Hz"), ((None, 40.0), "0-40 Hz"), ((2.5, None), "2.5-inf Hz"), ((0.5, 1.5), "0.5-1.5 Hz")],
)
def test_the_table_names_its_band_and_storeys_that_follow_others_are_said_at_the_end(monkeypatch, band, words):
    found = assembled(monkeypatch, [({"pooled": 25.0}, {Site("storey 1"): ()})], [], band, coupling="They are coupled")
    assert found.table["band"].tolist() == [words] and found.stopped_because == "done. They are coupled"
    assert found.model.info == {"band": list(band), "steps": [], "stopped_because": "done. They are coupled"}
    assert str(found) == "No effect was added.\nStopped: done. They are coupled." and found.model.visited == {}


def test_a_scene_has_the_noise_of_its_surrogates():
    assert report.Scene("x", None, None).noise == []
    assert report.Scene("x", None, None, SimpleNamespace(stages=("a", "b"))).noise == ["a", "b"]


# -- models on Gram matrices ------------------------------------------------------------------------


def shaken_space(n_dof, unknown=False, n=240, known=None, strategy="auto", silent=()):
    """Noise under noise: two records of balances that nothing closes, one of them perhaps with an unknown force."""
    rng, out = np.random.default_rng(5), []
    for k in range(2):
        F = rng.standard_normal((n, n_dof))
        F[:, list(silent)] = 0.0
        if unknown and k:
            F[:, 0] = np.nan
        out += from_arrays(rng.standard_normal((n, 3 * n_dof)), F, dt=0.01).segments
    data = type(from_arrays(np.zeros((9, 3)), dt=0.01))(out, 2 * n)
    search = [BlockRows(k, slice(a, a + 60)) for k in (0, 1) for a in (0, 60, 120)]
    held = [BlockRows(0, slice(180, 240)), BlockRows(1, slice(180, 210)), BlockRows(0, slice(100, 110))]
    return workspace.Workspace(data, [None] * 2, search, held, known or {}, strategy)


def linear(n_dof, **more):
    spring = (laws.LinearElastic(), laws.LinearViscous())
    return {Site(f"storey {k}"): spring for k in range(1, n_dof + 1)} | more


@pytest.fixture
def uncompiled(monkeypatch):
    """The walk on Gram matrices as it is written."""
    from pysindy_nrf.laws import compiled

    with monkeypatch.context() as patched:
        patched.setattr(compiled, "jit", lambda function: function)
        patched.setattr(compiled, "part", lambda function: function)
        walk = projection._compiled.__wrapped__()
    monkeypatch.setattr(projection, "_compiled", lambda: walk)


def test_one_balance_is_plain_least_squares_of_the_force(monkeypatch, uncompiled):
    monkeypatch.setattr(stage, "admissible", lambda *a: True)  # noise drives as often as it resists

    work = shaken_space(1)
    one = stage.Stage(work, Chain(1), linear(1))
    rows = [np.column_stack([s.a, s.s, s.v, s.F]) for s in work.data.segments]
    parts = [rows[b.segment][b.rows] for b in work.blocks]

    def fit(blocks, extra=None):
        A = np.vstack([parts[b] for b in blocks])
        columns = A[:, :3] if extra is None else np.column_stack([A[:, :3], extra(A)])
        return np.linalg.lstsq(columns, A[:, 3], rcond=None)[0]

    def error(theta, blocks, extra=None):
        A = np.vstack([parts[b] for b in blocks])
        columns = A[:, :3] if extra is None else np.column_stack([A[:, :3], extra(A)])
        return 100 * np.sqrt(np.mean((A[:, 3] - columns @ theta) ** 2) / np.mean(A[:, 3] ** 2))

    every, trial = range(6), one.trial()
    folds = [error(fit([k for k in every if k != b]), [b]) for b in every]
    assert trial.search_error() == pytest.approx(error(fit(every), every)) and trial.fold_errors() == pytest.approx(
        folds
    )
    for blocks in (every, [0, 1, 2], [0, 1, 2]):
        found, theta = trial.solve(blocks), fit(blocks)
        assert found.masses[1] == pytest.approx(theta[0]) and found.coefficients[Site("storey 1")] == pytest.approx(
            theta[1:]
        )
        for judged in ([6], [7, 8], [0], every, [5, 6]):
            assert trial.error(found, judged) == pytest.approx(error(theta, judged))
    assert trial.model().masses == pytest.approx(fit(every)[:1]) and trial.sizes.tolist() == [60] * 6 + [60, 30, 10]
    assert trial.moments([0, 1]) is trial.moments([0, 1]) is not trial.moments([0, 2])
    cubic = laws.CubicStiffness()
    slot = one.slot(Site("storey 1"), cubic)
    theta = fit(every, lambda A: A[:, 1] ** 3)
    assert slot.search_error(cubic) == pytest.approx(error(theta, every, lambda A: A[:, 1] ** 3))
    wanted = [fit([k for k in every if k != b], lambda A: A[:, 1] ** 3)[[1, 2, 3]] for b in every]
    found = slot.jackknife(cubic)
    assert found[:, [0, 1, -1]] == pytest.approx(np.array(wanted)) and slot.fold_parts(cubic)[2].shape == (6, 1, 2)
    never = one.slot(Site("storey 1"), laws.TwoSidedGap())  # a gap that nothing reaches has a column of zeros
    found = never.errors([laws.TwoSidedGap(1e9), laws.TwoSidedGap(0.5)])
    assert np.isinf(found[0]) and np.isfinite(found[1])
    with pytest.raises(NRFError):
        stage.Stage(work, Chain(1), {Site("storey 1"): (laws.TwoSidedGap(1e9), laws.LinearElastic())}).trial().model()


@pytest.mark.parametrize("unknown", [False, True])
@pytest.mark.parametrize(
    "site, law, drop",
    [
        ("storey 2", laws.CubicStiffness(), ()),
        ("storey 1", laws.CoulombFriction(), ()),
        ("dof 2", laws.ConstantForce(), ()),
        ("ground 2", laws.LinkSpringDashpot(), ()),
        ("link 3-1", laws.LinkSpringDashpot(), ()),
        ("storey 2", laws.QuinticStiffness(), (("storey 2", 2),)),
        ("storey 3", laws.StribeckFriction(0.3), (("storey 2", 2),)),
    ],
)
def test_a_law_on_top_of_a_model_does_as_the_model_with_it(site, law, drop, unknown, monkeypatch, uncompiled):
    monkeypatch.setattr(stage, "admissible", lambda *a: True)  # noise drives as often as it resists
    known = {1: 1.0} if unknown else {}
    held = linear(3) | {
        Site("storey 2"): (
            laws.LinearElastic(),
            laws.LinearViscous(),
            laws.CubicStiffness() if drop else laws.Dahl(2.0),
        )
    }
    one = stage.Stage(shaken_space(3, unknown, known=known), Chain(3), held)
    site, drop = Site(site), tuple((Site(s), k) for s, k in drop)
    slot, whole = one.slot(site, law, drop), one.with_law(site, law, drop)
    assert len(one.laws[site] if site in one.laws else ()) + 1 - sum(s == site for s, _ in drop) == len(
        whole.laws[site]
    )
    assert whole.laws[site][-1] is law and slot.search_error(law) == pytest.approx(
        whole.slot().search_error(), rel=1e-7
    )
    assert slot.errors([law, law]) == pytest.approx([whole.trial().search_error()] * 2, rel=1e-7)
    assert slot.folds(law) == pytest.approx(whole.slot().folds(), rel=1e-6)
    trial, n = whole.trial(), len(whole.work.search)
    every = trial.solve(range(n))
    assert trial.search_error() == pytest.approx(trial.error(every, range(n)), rel=1e-7)
    for b in (0, n - 1):
        rest = trial.solve([k for k in range(n) if k != b])
        assert trial.fold_errors()[b] == pytest.approx(trial.error(rest, [b]), rel=1e-6)
    columns = np.hstack([whole.rows(b.segment)[:, b.rows] for b in whole.work.search])
    assert whole.columns == pytest.approx(columns) and whole.tail + 6 == len(columns)


@pytest.mark.parametrize("known", [{}, {1: 2.0}, {1: 2.0, 3: 1.0}])
@pytest.mark.parametrize(
    "strategy, silent",
    [
        ("auto", False),
        ("complete", False),
        ("sequential", False),
        ("joint", False),
        ("auto", True),
        ("sequential", True),
    ],
)
def test_the_walk_on_gram_matrices_does_as_the_chain_solve(strategy, known, silent, uncompiled):
    # where no force acts on the second DOF, its balance is measured by its inertia
    work = shaken_space(3, known=known, strategy=strategy, silent=[1] if silent else [])
    held = linear(3) | {Site("storey 3"): (laws.LinearElastic(),), Site("dof 2"): (laws.ConstantForce(),)}
    one = stage.Stage(work, Chain(3), held)
    trial, n = one.trial(), len(work.search)
    every = trial.solve(range(n))
    assert trial.search_error() == pytest.approx(trial.error(every, range(n)), rel=1e-7)
    errors, theta, _ = one.slot().fold_parts()
    for b in range(n):
        rest = trial.solve([k for k in range(n) if k != b])
        assert errors[b] == pytest.approx(trial.error(rest, [b]), rel=1e-6)
        for site, values in rest.coefficients.items():
            assert theta[b, trial.layout.slices[site]] == pytest.approx(values, rel=1e-6)


@pytest.mark.parametrize("strategy", ["auto", "joint"])
def test_a_law_that_cannot_be_told_costs_only_itself(strategy, monkeypatch, uncompiled):
    monkeypatch.setattr(stage, "admissible", lambda *a: True)
    one = stage.Stage(shaken_space(2, strategy=strategy), Chain(2), linear(2))
    slot = one.slot(Site("storey 1"), laws.TwoSidedGap())
    found = slot.errors([laws.TwoSidedGap(1e9), laws.TwoSidedGap(0.5)])
    assert np.isinf(found[0])
    assert found[1] == pytest.approx(
        one.with_law(Site("storey 1"), laws.TwoSidedGap(0.5)).trial().search_error(), rel=1e-7
    )


def test_laws_of_a_stage_are_taken_out_and_changed_by_their_number():
    held = linear(2) | {Site("storey 2"): (laws.LinearElastic(), laws.Dahl(1.0), laws.Dahl(2.0))}
    one = stage.Stage(shaken_space(2), Chain(2), held)
    site = Site("storey 2")
    assert (
        one.at == {(Site("storey 1"), 0): 0, (Site("storey 1"), 1): 1, (site, 0): 2, (site, 1): 3, (site, 2): 4}
        and one.tail == 5
    )
    assert [law.name for law in one.without([(site, 1)])[site]] == ["linear_elastic", "dahl"]
    assert [law.shape.get("sigma") for law in one.without([(site, 1)])[site]] == [None, 2.0]
    changed = one.with_values((site, 1), laws.Dahl(9.0))
    assert [law.shape.get("sigma") for law in changed.laws[site]] == [None, 9.0, 2.0]
    assert [law.shape.get("sigma") for law in one.laws[site]] == [None, 1.0, 2.0]
    added = one.with_law(site, laws.Jenkins(0.1), [(site, 2), (Site("storey 1"), 1)])
    assert [law.name for law in added.laws[site]] == ["linear_elastic", "dahl", "jenkins"]
    assert len(added.laws[Site("storey 1")]) == 1
    link = one.with_law(Site("link 2-0"), laws.LinkSpringDashpot())
    assert link.trial().stage is link and len(link.columns) == 5 + 2 + 4


# -- before the walk --------------------------------------------------------------------------------


def test_a_loop_needs_a_model_to_begin_with_and_something_that_scales_it():
    one = record(600, n_dof=1)
    with pytest.raises(NRFError, match="is not a model to begin with"):
        loop.close_loop(one, "linear")
    silent = one.replace(force=np.zeros((600, 1)))
    with pytest.raises(ExcitationError, match="nothing scales the chain"):
        loop.close_loop(silent)


def test_shapes_that_a_baseline_leaves_free_are_found_on_the_search_alone(monkeypatch):
    import sklearn.base

    work, fitted = shaken_space(1), []
    site = Site("storey 1")
    given = {site: (laws.Dahl(1.0), laws.LinearElastic())}
    fresh = SimpleNamespace(_fit=lambda *a: fitted.append(a), model_=SimpleNamespace(laws={site: [laws.Dahl(3.0)]}))
    monkeypatch.setattr(sklearn.base, "clone", lambda baseline: fresh)
    known = SimpleNamespace(_laws=lambda chain, laws: given)
    assert loop._baseline_laws(known, "chain", "given", work) is given and fitted == []
    given[site] = (laws.LinearElastic(), laws.Dahl())
    found = loop._baseline_laws(known, "chain", "given", work)
    assert found[site][0].shape["sigma"] == 3.0 and isinstance(found[site], tuple)
    part, laws_, same = fitted[0]
    assert part is same and laws_ == "given" and [s.valid for s in part.segments] == [slice(0, 180)] * 2


def test_progress_counts_the_candidates(monkeypatch):
    import tqdm.auto

    seen = []

    class Bar:
        def __init__(self, **more):
            seen.append(more)
            self.update = "tick"

        def close(self):
            seen.append("closed")

    monkeypatch.setattr(tqdm.auto, "tqdm", Bar)
    monkeypatch.setattr(loop, "lines_of", lambda trial: "lines")
    monkeypatch.setattr(loop, "screen", lambda *a, **k: seen.append(a[4]) or [])
    monkeypatch.setattr(loop, "sensor_findings", lambda *a: [])
    one = bare(progress=True, every=[1, 2, 3])
    assert one._findings("stage", SimpleNamespace(search_error=lambda: 1.0), [Step("a", "b", "storey 1")]) == []
    assert seen[0] == {"total": 3, "desc": "search 2", "unit": "candidate", "leave": False, "disable": None}
    assert seen[1:] == ["tick", "closed"]


# -- more of sensors and residuals ------------------------------------------------------------------


@pytest.mark.parametrize("true", [0.13, -0.2])
@pytest.mark.parametrize("now", [1.5, 6.0])
def test_a_scan_begins_within_twice_the_bottom_of_the_parabola(monkeypatch, true, now):
    """The first of the trials is the golden section of that."""
    golden = (3 - np.sqrt(5)) / 2
    found, tried = wild(monkeypatch, lambda x: now * np.sqrt(1 + 15 * ((x - true) ** 2 - true**2)), law=GainError())
    first = 2 * true * golden if true > 0 else 2 * true * (1 - golden)
    assert found[1].law.values[0] == pytest.approx(true, abs=0.002) and tried[2] == pytest.approx(first)


@pytest.mark.parametrize("promise, looked", [(0.049, False), (0.051, True)])
@pytest.mark.parametrize("now", [0.5, 3.0])
def test_what_a_parabola_must_promise_is_a_share_of_the_error(monkeypatch, promise, looked, now):
    curve = (1 - (1 - promise) ** 2) / 0.1**2
    found, tried = wild(monkeypatch, lambda x: now * np.sqrt(1.0 + curve * ((x - 0.1) ** 2 - 0.01)), law=GainError())
    assert found is None and (len(tried) > 2) == looked


def test_a_coarse_scan_goes_on_between_half_and_nearly_twice_the_best(monkeypatch):
    near = 0.5 * sensors._STEPS["sensor_offset"][1] * sensors._COARSE[2]
    tried = wild(monkeypatch, lambda x: 30.0 if abs(x - near) > 0.3 else 10.0 + abs(x - near))[1]
    golden = (3 - np.sqrt(5)) / 2
    assert tried[6] == pytest.approx(near * (0.5 + 1.2 * golden))


def test_a_record_without_a_free_run_leaves_nothing_to_compare():
    seg = from_arrays(np.ones((20, 3)), np.full((20, 1), np.nan), dt=0.01)
    model = ChainModel([1.0], {1: [laws.LinearElastic(1.0)]})
    found = residual.free_run_residual(model, seg)
    assert (
        np.isnan(found.displacement[0]).all()
        and np.isnan(found.acceleration[0]).all()
        and found.displacement[0].shape == (20, 1)
    )
    assert found.sizes.isna().all(axis=None) and list(found.sizes.index) == ["dof 1"] and "unknown" in found.reasons[0]
    with pytest.raises(ChannelError, match="no balance has a residual"):
        residual.residual_of(model, seg)


def test_a_force_is_not_looked_for_where_no_balance_is_known():
    one, _ = four()
    one.balance[0][:, 1] = np.nan
    with pytest.raises(ChannelError, match="dof 2 is not seen"):
        localisation.missing_force(one, "dof 2")
    assert localisation._Work.of(one, None, (), (), 10).known.tolist() == [0, 2, 3]
    one.balance[0][:] = np.nan
    with pytest.raises(ChannelError, match="No balance is known"):
        localisation.missing_force(one, "dof 1")
    everywhere, _ = four()
    work = localisation._Work.of(
        everywhere, localisation.NoiseFloor.given(1.0, 4), [f"dof {j}" for j in (1, 2, 3, 4)], (), 10
    )
    assert not work._free_masses(None).any()


@pytest.mark.parametrize("share, alike", [(0.19, True), (0.21, False)])
def test_repetitions_differ_by_less_than_a_fifth_of_their_common_force(share, alike):
    force, other = 3.0 * np.tile([1.0, -1.0], 50), 3.0 * share * np.tile([1.0, 1.0, -1.0, -1.0], 25)
    sets = [from_arrays(np.zeros((100, 3)), f[:, None], dt=0.01) for f in (force + other, force - other)]
    model = ChainModel([1.0], {1: [laws.LinearElastic(1.0)]})
    one = residual.residual_of(model, noise_floor._together(sets))
    if alike:  # 3 N of share apart, each from their mean, times sqrt(2)
        floor = noise_floor.NoiseFloor.from_repeats(one)
        assert floor.balance[0] == pytest.approx(np.sqrt(2) * 3 * share) and floor.source == "2 repeated records"
    else:
        with pytest.raises(ChannelError, match="not excited alike"):
            noise_floor.NoiseFloor.from_repeats(one)


@pytest.mark.parametrize(
    "law, family, sure",
    [("quadratic_damping", "damping", False), ("two_sided_gap", "contact", False), ("dahl", "hysteresis", True)],
)
def test_a_constant_may_be_the_lack_of_symmetry_of_a_curve(law, family, sure):
    both = [Step(law, family, "storey 1"), Step("constant_force", "forcing", "dof 1")]
    steps.doubt_names(both)
    assert [s.sure for s in both] == [sure] * 2
    assert both[0].company == ([] if sure else ["constant_force"]) and both[1].company == ([] if sure else [law])


def test_a_stribeck_force_is_improper_from_zero_down():
    for low, high, wrong in ((-2.0, 0.5, False), (-2.0, -0.5, True)):
        assert steps.improper("stribeck_friction", {"dF": (low, high)}) == wrong


def test_a_value_that_is_not_known_is_none_where_corrections_are_joined():
    first = Step("gain_error", "sensor", "sensor a1", parameters={"e": 0.2})
    offset = Step("sensor_offset", "sensor", "sensor a1", parameters={"b": None})
    other = Step("sensor_offset", "sensor", "sensor a2", parameters={"b": 1.0})
    joined = steps._joined(GainError(0.5), first, [offset, other])
    assert (
        joined.values[0] == pytest.approx(1.2 * 1.5 - 1)
        and offset.parameters == {"b": 0.0}
        and other.parameters == {"b": 1.0}
    )
    begin = Step("sensor_offset", "sensor", "sensor a1", parameters={"b": 0.2})
    gain = Step("gain_error", "sensor", "sensor a1", parameters={"e": None})
    assert steps._joined(SensorOffset(0.5), begin, [gain]).values[0] == pytest.approx(0.7)
    gain.parameters = {"e": 0.1}
    assert steps._joined(SensorOffset(0.5), begin, [gain]).values[0] == pytest.approx(0.2 + 0.5 * 1.1)


def test_alternatives_are_listed_if_there_are_tied_ones_or_others():
    for tied, others in (([("iwan", "storey 2", 1.0)], []), ([], [("iwan", "storey 2", 1.0)])):
        step = Step("dahl", "hysteresis", "storey 2", evidence="why", tied=tied, runners_up=others)
        assert markdown._step(1, step)[-2] == f"| iwan | storey 2 | 1 | {'tied' if tied else ''} |"


def test_a_storey_without_a_law_is_scaled_by_its_balance_and_one_at_rest_by_one():
    X, F = np.random.default_rng(0).standard_normal((50, 6)), np.random.default_rng(1).standard_normal((50, 2))
    model = ChainModel([1.0, 2.0], {1: [laws.LinearElastic(3.0)], 2: [laws.LinearElastic(0.0)]})
    found = residual.residual_of(model, from_arrays(X, F, dt=0.01))
    s = X[:, 4]
    assert found.scale == pytest.approx([3 * np.sqrt(np.mean(s**2)), np.sqrt(np.mean(F[:, 1] ** 2))])
    small = residual.residual_of(model, from_arrays(1e-3 * X, 1e-3 * F, dt=0.01))
    assert small.scale == pytest.approx(1e-3 * found.scale)
    assert small.sizes["percent"].to_numpy() == pytest.approx(found.sizes["percent"].to_numpy())
    F[:, 1] = 0.0
    quiet = residual.residual_of(model, from_arrays(X, F, dt=0.01))
    inertia = 2 * np.sqrt(np.mean(X[:, 1] ** 2))
    assert quiet.scale[1] == pytest.approx(inertia) == quiet.sizes.loc["dof 2", "reference"]
    assert quiet.sizes["of"].tolist() == ["F", "m a", "storey force", "storey force"]
    still = residual.residual_of(model, from_arrays(np.zeros((50, 6)), np.zeros((50, 2)), dt=0.01))
    assert still.scale.tolist() == [1.0, 1.0] and still.sizes["percent"].isna().all()


# -- numbers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "module, numbers",
    [
        (localisation, {"_PIECE": 1024, "_FOLLOWED": 8, "_NEAR": 0.05}),
        (
            loop,
            {
                "_SHORTLIST": 14,
                "_VALIDATED": 10,
                "_DECISIONS": 3,
                "_HOPELESS": 0.05,
                "_USUALLY": 0.25,
                "_OPEN": 50.0,
                "_WORSE_ALONE": 1.3,
                "_BEYOND_DOUBT": 0.5,
            },
        ),
        (noise_floor, {"AT_FLOOR": 1.3, "LOUD": 2.0, "BELOW_FLOOR": 0.8}),
        (noise_level, {"QUIET": 0.2, "_FEWEST": 256, "_LEAST": 0.1, "_WINDOW": 64, "_NOISE": 0.99}),
        (prepare, {"CLEAN": 0.004}),
        (reestimate, {"_ROUNDS": 2, "_EVALUATIONS": 40, "_REACH": 0.2, "_ENOUGH": 1e-3}),
        (residual, {"ROUND_OFF": 1e-9}),
        (search, {"_GRID": {1: 9, 2: 5, 3: 4}, "_EVALUATIONS": {1: 24, 2: 60, 3: 110}, "_SIMPLE": 2, "_NEAR": 1.3}),
        (second_opinion, {"_LEFT": 0.25, "_BEYOND": 2.5, "_WEAK": 1.3, "_STRONG": 0.05, "_GAIN": 0.5, "_OPEN": 50.0}),
        (
            sensors,
            {
                "_WITNESSED": 0.05,
                "_AGAIN": 0.5,
                "_ROUGH": 0.2,
                "_TRIALS": 7,
                "_PROMISE": 0.05,
                "_WORTH": 0.1,
                "_REBUILT": 2,
                "_WILD": 20.0,
                "_STEPS": {"channel_delay": (0.05, 1.5), "gain_error": (0.02, 0.6), "sensor_offset": (0.05, 5.0)},
            },
        ),
        (
            splits,
            {
                "HELDOUT_SHARE": 0.25,
                "N_BLOCKS": 10,
                "SETTLING": 0.04,
                "AT_REST": 0.25,
                "RESTING": 0.1,
                "FEWEST_BLOCKS": 4,
                "SEEN": 0.5,
                "LEAST_ROWS": 200,
            },
        ),
        (stage, {"_AT_ONCE": 32}),
        (steps, {"_ONE_CLASS": 0.3, "_NEARLY_FRICTION": 0.25}),
        (standing, {"SURE": 0.1, "_BIASED": 0.02, "_WRONG": 0.1}),
        (surrogate, {"UNBIASED": 0.005, "_OF_A_SENSOR": 0.5, "_TOO_LOUD": 1.2}),
        (together, {"_MOST": 4}),
        (workspace, {"CACHE": 200_000_000}),
    ],
)
def test_thresholds_have_the_values_that_were_chosen(module, numbers):
    """The tests take them by name; their values are part of what the benchmarks were run with."""
    assert {name: getattr(module, name) for name in numbers} == numbers
    assert sensors._COARSE.tolist() == [-0.6, -0.25, 0.25, 0.6]
