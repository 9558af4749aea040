"""Exact numbers of the loop: when it stops, what it tries, decides, drops and says, with hand-made parts."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from hand_made_walk import CUBIC, FRICTION, fault, finding, record, refuse, shaken_space, turned_down

from pysindy_nrf import Site, laws
from pysindy_nrf.discrepancy import (
    conclusion,
    loop,
    ranking,
    rounds,
    sensors,
    sharpening,
    standing,
    steps,
)
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.gate import FLOOR, MEMBER_GAIN, MIN_WINS, Verdict
from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.discrepancy.splits import BlockRows
from pysindy_nrf.exceptions import BiasWarning, ChannelError, ExcitationError, NRFError
from pysindy_nrf.laws.sensor import GainError

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

        def null(ready, stage, rng, count, **more):
            self.nulls.append((stage.number, count))
            return SimpleNamespace(stages=list(stages), error=error)

        def with_it(stage, chosen, last):
            self.last.append(last)
            k = stage.number + 1
            return model(k), [f for f in gone.get(k, ())]

        monkeypatch.setattr(rounds, "Null", null)
        monkeypatch.setattr(conclusion.LoopReport, "assemble", lambda *a: SimpleNamespace(
            scenes=a[1], steps=a[2], stopped=a[3], ranking=a[4], band=a[5], measured=a[6]
        ))  # fmt: skip
        monkeypatch.setattr(conclusion, "worst", lambda trial: "balance of DOF 7")
        monkeypatch.setattr(conclusion, "contradictions", lambda ready, work: ["a1 is late", "x2 too"])
        if least is not None:
            monkeypatch.setattr(steps, "surely_left", lambda folds, noise: least)
        floors = SimpleNamespace(
            of=lambda trial: ("floor", trial.number), closes=lambda *a: closes, words="as given", measured=measured,
            percent=lambda trial, null: floor,
        )  # fmt: skip
        work = SimpleNamespace(scales=lambda site: (0.1, 0.2, 0.3))
        one = rounds.Rounds(SimpleNamespace(clean=True), work, [], list(sensors), floors, None, 2, False)
        one._findings = lambda stage, steps: [CUBIC] if ranking is None else list(ranking)
        one._decide = lambda stage, ranking, before, null, most: self.asked.append(most) or next(decisions)
        one._with = with_it
        one.standing = lambda: ["standing", one.stage.number]
        monkeypatch.setattr(conclusion, "estimate", lambda *a: None if estimated is None else estimated(one))
        monkeypatch.setattr(conclusion, "share_to_leave", lambda stage: None)
        monkeypatch.setattr(sharpening, "sharpened_again", lambda *a: None)
        monkeypatch.setattr(conclusion, "doubt_what_is_drawn", lambda *a: None)
        monkeypatch.setattr(conclusion, "wrong_by_noise", lambda *a: self.noisy.append(a) or list(wrong))
        self.loop = one
        one.go(model(0), max_steps)
        conclusion.settle(one)
        self.report = conclusion.concluded(one, "band")

    @property
    def names(self):
        return [scene.name for scene in self.report.scenes]


def yes(*findings, gain=0.5, null_gain=0.0):
    return [(f, []) for f in findings], Verdict(True, gain, 1.0, null_gain, "it falls")


def no(*findings):
    return [(f, []) for f in findings], Verdict(False, 0.0, 0.0, 0.0, "it does not fall")


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
    step, _ = ended(monkeypatch, 100 * share * steps._USUALLY, least=1.0)  # chance did the rest
    assert step.sure == sure and step.remainder == pytest.approx(share * steps._USUALLY)
    step, _ = ended(monkeypatch, 1.0, least=100 * share * standing.SURE)
    assert step.sure == sure and step.remainder == pytest.approx(0.01)


@pytest.mark.parametrize(
    "left, floor, sure", [(0.99, np.nan, True), (1.01, np.nan, False), (1.01, 0.51, True), (1.01, 0.5, False)]
)
def test_no_name_is_sure_of_a_balance_that_stays_open_beyond_noise(monkeypatch, left, floor, sure):
    step, _ = ended(monkeypatch, left * steps._OPEN, 1e5, floor=floor * steps._OPEN)
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
    words = f". {left:.3g} % stay unexplained by any law of the catalogue (noise alone leaves about {floor:.2g} %), most in the "
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
    monkeypatch.setattr(steps, "surely_left", lambda folds, noise: seen.append([n.tolist() for n in noise]) or 1.0)
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
    one = object.__new__(rounds.Rounds)
    one.accepted, one.told, one.every, one.sensors, one.progress = [], [], ["every"], ["gain"], False
    one.ready, one.work, one.rng, one.n_surrogates = SimpleNamespace(clean=True), "work", "rng", 2
    one.enough, one.steps, one.not_first = None, [], frozenset()
    one.__dict__.update(parts)
    return one


STAGE = SimpleNamespace(trial=None)


def looked_for(monkeypatch, found, after=lambda f: f, now=10.0, faulty=(), steps=()):
    """What the search finds is refined and judged by a given function; the order of the calls is kept."""
    calls = []
    monkeypatch.setattr(ranking, "lines_of", lambda trial: "lines")
    monkeypatch.setattr(ranking, "screen", lambda *a, **k: calls.append((a, k)) or list(found))
    monkeypatch.setattr(ranking, "refine", lambda stage, f: calls.append(f) or after(f))
    monkeypatch.setattr(ranking, "among", lambda stage, f, accepted: f if accepted == [CUBIC] else None)
    monkeypatch.setattr(ranking, "validate", lambda stage, f: f)
    monkeypatch.setattr(rounds, "sensor_findings", lambda *a: calls.append(a) or list(faulty))
    monkeypatch.setattr(STAGE, "trial", lambda: SimpleNamespace(search_error=lambda: now))
    one = bare(accepted=[CUBIC])
    out = one._findings(STAGE, list(steps))
    assert calls[0] == ((STAGE, ["every"], [(Site("storey 2"), "cubic_stiffness")], "lines", None), {"both": True})
    return out, [c for c in calls[1:-1]], calls[-1]


def test_what_does_not_even_lower_the_error_it_is_fitted_to_is_hopeless(monkeypatch):
    edge = 10.0 * (1 - ranking._HOPELESS)
    found = [finding(laws.Dahl(1.0), 0.999 * edge), finding(laws.Iwan(0.1), edge)]
    out, refined, asked = looked_for(monkeypatch, found)
    assert out == found[:1] == refined and asked == (bare().ready, "work", STAGE, ["gain"], set())


def test_the_best_of_a_shortlist_are_refined_and_the_best_of_these_judged(monkeypatch):
    found = [finding(laws.Dahl(1.0), 1.0 + 0.01 * k, f"storey {k + 1}") for k in range(20)]
    out, refined, _ = looked_for(monkeypatch, found)
    assert len(refined) == ranking._SHORTLIST and out == found[: ranking._VALIDATED]
    # the last of the shortlist may become the first
    turned = {id(f): finding(f.law, 9.0 - f.screen, str(f.site)) for f in found}
    out, _, _ = looked_for(monkeypatch, found, lambda f: turned[id(f)])
    assert [f.site.p for f in out] == list(range(ranking._SHORTLIST, ranking._SHORTLIST - ranking._VALIDATED, -1))


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
    assert ranking._missed([instead, beside]) == ([instead, beside] if kept else [instead])
    other = Finding(Candidate(laws.TwoSidedGap(), Site("storey 2")), law, 1.0, place, np.full(10, 1.0))
    endless = finding(law, drop=place, folds=np.full(10, np.inf))
    assert ranking._missed([beside, other]) == [beside, other] and ranking._missed([endless, beside]) == [endless, beside]
    same = finding(law, folds=np.full(10, 1.0))
    assert ranking._missed([same, beside]) == [same, beside]


def test_a_candidate_is_held_if_law_site_and_place_are_the_same():
    one = finding(laws.Dahl(), 1.0)
    held = [finding(laws.Dahl(), 2.0)]
    assert ranking._holds(held, one) and not ranking._holds([], one)
    for other in (
        finding(laws.Dahl(), site="storey 2"),
        finding(laws.Iwan()),
        finding(laws.Dahl(), drop=((Site(1), 0),)),
    ):
        assert not ranking._holds([other], one)


# -- what is decided --------------------------------------------------------------------------------


class Court:
    """Decisions of the loop where the parts that judge answer as told; what they were asked is kept."""

    def __init__(self, monkeypatch, clean=True, likeliest=None, confirmed=None, pair=None, ahead=None, alone=None,
                 reached=False, gain=0.0, together=None, judged=None):  # fmt: skip
        self.calls = calls = []
        self.one = one = bare(ready=SimpleNamespace(clean=clean))
        one._hidden = lambda *a: calls.append(("hidden", *a))
        self.null = SimpleNamespace(reached=reached, hasty=False, gain=lambda f: calls.append(("gain", f)) or gain)
        one._polished = lambda stage, f: f
        one.alone = lambda stage, whole, verdict: alone(verdict) if alone else verdict
        one._run_together = lambda stage, found: calls.append(("together", found)) or (together or (lambda f: f))(found)
        if judged:
            one._judged = judged
        monkeypatch.setattr(Finding, "on", lambda self, stage: ("on", self.law.name))
        monkeypatch.setattr(sensors.SensorFinding, "on", lambda self, stage: ("on", self.law.name))

        def asked(name, answer):
            return lambda *a: calls.append((name, *a)) or (answer(*a) if answer else None)

        monkeypatch.setattr(rounds, "likeliest", asked("likeliest", likeliest))
        monkeypatch.setattr(rounds, "confirmed", asked("confirmed", confirmed or (lambda verdict, *a: verdict)))
        monkeypatch.setattr(rounds, "pair_instead", asked("pair", pair))
        monkeypatch.setattr(rounds, "look_ahead", asked("ahead", ahead))

    def decide(self, ranking, before=10.0, most=4):
        return self.one._decide("stage", ranking, np.full(5, before), self.null, most)

    def names(self):
        return [c[0] for c in self.calls]


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
    assert members[0][0] in ranking and not verdict.accepted
    assert court.names() == ["ahead", "together", "hidden", "together"]
    assert court.calls[0][1:3] == ("stage", ranking) and court.calls[0][5] == 4
    passing = finding(laws.CoulombFriction(), 5.0, "storey 3")
    tried = []
    court = Court(monkeypatch)
    monkeypatch.setattr(rounds, "choose", lambda left, now: tried.append((list(left), now)) or (left[0], []))
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
    monkeypatch.setattr(rounds, "choose", lambda left, now: tried.append([f.site.p for f in left]) or (left[0], []))
    court = Court(monkeypatch, alone=turned_down)
    members, verdict = court.decide(ranking)
    assert tried == [[1, 2, 3, 4, 5], [2, 3, 4, 5], [3, 4, 5]] and members[0][0] is ranking[0]
    assert verdict.sentence == "turned down" and len(tried) == rounds._DECISIONS and "confirmed" not in court.names()
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
    one.alone = lambda stage, whole, verdict: (stage, whole, verdict)
    null = SimpleNamespace(gain=lambda f: 0.1, reached=False)
    stage_, whole, verdict = one._judged("stage", finding(laws.CoulombFriction(), 5.0), before, null)
    assert (stage_, whole) == ("stage", "with it") and verdict.accepted and verdict.null_gain == 0.1
    assert not one._judged("stage", finding(laws.CoulombFriction(), 9.9), before, null).accepted
    null = SimpleNamespace(gain=lambda f: 0.3, reached=True)
    assert not one._judged("stage", finding(laws.CoulombFriction(), 5.0), before, null).accepted


@pytest.mark.parametrize("asked, run", [(0, 0), (1, 1), (4, 1)])
def test_a_rival_has_one_surrogate_at_most(monkeypatch, asked, run):
    monkeypatch.setattr(rounds, "Null", lambda *a: a)
    one = bare(n_surrogates=asked)
    assert one._null("stage") == (one.ready, "stage", "rng", run)


# -- free runs, shapes and what is needless ---------------------------------------------------------


@pytest.mark.parametrize(
    "before, after, gain, accepted, words",
    [
        (10.0, 10.0 * rounds._WORSE_ALONE, 0.3, True, "told"),
        (10.0, 10.001 * rounds._WORSE_ALONE, 0.3, False, "told, but its free run rises from 10 to 13 %"),
        (10.0, 20.0, rounds._BEYOND_DOUBT, True, "told; the free run rises from 10 to 20 %, so more is missing"),
        (10.0, 20.0, 0.999 * rounds._BEYOND_DOUBT, False, "told, but its free run rises from 10 to 20 %"),
        (99.9, np.nan, 0.3, False, "told, but its free run (99.9 %) diverges"),
        (100.0, np.nan, 0.3, True, "told"), (np.nan, np.nan, 0.3, True, "told"),
        (99.9, np.inf, 0.9, True, "told; the free run (99.9 %) diverges, so more is missing"),
    ],
)  # fmt: skip
def test_an_effect_must_not_make_the_free_run_worse(before, after, gain, accepted, words):
    one = bare(_free_run={"without": before, "with": after}.__getitem__)
    verdict = one.alone("without", "with", Verdict(True, gain, 1.0, 0.0, "told"))
    assert (verdict.accepted, verdict.sentence) == (accepted, words)


def test_the_free_run_goes_over_the_blocks_that_each_record_begins_with(monkeypatch):
    seen = []
    monkeypatch.setattr(rounds, "free_run_error", lambda model, work, blocks: seen.append((model, work, blocks)) or 3.0)
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
    monkeypatch.setattr(rounds, "refine", lambda stage, f, n: asked.append(n) or finer)
    monkeypatch.setattr(rounds, "validate", lambda stage, f: f)
    rough = Finding(Candidate(laws.Iwan(), Site("storey 1")), laws.Iwan(0.1, 0.6), 2.0, (), np.full(5, 2.0))
    assert bare()._polished(None, rough) is (finer if kept else rough) and asked == [240]
    plain = finding(laws.CoulombFriction())
    assert bare()._polished(None, plain) is plain and len(asked) == 1


def test_an_accepted_law_takes_the_place_of_those_it_drops_and_drives_out_the_needless(monkeypatch):
    places = {id(f): (f.site, k) for k, f in enumerate((FRICTION, CUBIC))}
    monkeypatch.setattr(rounds, "place_of", lambda stage, f, accepted: places.get(id(f)))
    seen = []
    monkeypatch.setattr(rounds, "reestimated", lambda stage, accepted: seen.append(list(accepted)) or ("again", stage))
    monkeypatch.setattr(rounds, "needless", lambda stage, accepted: None)
    new = finding(laws.BoucWen(0.1, 0.5), drop=((FRICTION.site, 0),))
    monkeypatch.setattr(Finding, "on", lambda self, stage: ("with", stage))
    one = bare(accepted=[FRICTION, CUBIC])
    assert one._with("stage", new, True) == (("again", ("with", "stage")), []) and one.accepted == [CUBIC, new]
    assert seen[0] is not one.accepted and seen == [[CUBIC, new]]

    def model(name):
        return SimpleNamespace(name=name, work="work", chain="chain", without=lambda drop: ("without", drop))

    weak = iter([FRICTION, CUBIC, None])
    monkeypatch.setattr(rounds, "needless", lambda stage, accepted: next(weak))
    monkeypatch.setattr(rounds, "reestimated", lambda stage, accepted: stage)
    monkeypatch.setattr(rounds, "Stage", lambda work, chain, laws: seen.append((work, chain, laws)) or model("less"))
    monkeypatch.setattr(Finding, "on", lambda self, stage: stage)
    one, third = bare(accepted=[FRICTION, CUBIC]), finding(laws.Dahl(1.0), site="storey 3")
    found, gone = one._with(model("all"), third, True)
    assert [f.law.name for f in gone] == ["coulomb_friction", "cubic_stiffness"] and one.accepted == [third]
    assert seen[1:] == [("work", "chain", ("without", [places[id(f)]])) for f in (FRICTION, CUBIC)]
    weak = iter([FRICTION])
    one = bare(accepted=[FRICTION, CUBIC])
    assert one._with(model("all"), third, False)[1] == [] and one.accepted == [FRICTION, CUBIC, third]


def test_a_corrected_channel_changes_the_records_and_is_no_law(monkeypatch):
    monkeypatch.setattr(rounds, "reestimated", lambda stage, accepted: stage)
    monkeypatch.setattr(rounds, "needless", lambda stage, accepted: None)
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
    monkeypatch.setattr(rounds, "place_of", lambda stage, f, accepted: None if f is lost else (site, 1))
    walk.stage = "stage"
    (found,) = walk.standing()
    assert (found.finding, found.step, found.place) == (one, step, (site, 1))


def test_parameters_are_those_of_the_last_fit_at_the_place_of_each_effect(monkeypatch):
    site = Site("storey 1")
    held = (laws.LinearElastic(), laws.StribeckFriction(0.25))
    base = SimpleNamespace(
        laws={site: held}, at={(site, 0): 4, (site, 1): 5}, layout=SimpleNamespace(slices={site: slice(4, 7)}),
        work=SimpleNamespace(search=[1, 2, 3]), trial=lambda: trial,
    )  # fmt: skip
    theta = {site: np.array([9.0, 3.0, 2.0])}
    solved = []
    trial = SimpleNamespace(solve=lambda b: solved.append(list(b)) or SimpleNamespace(coefficients=theta))
    one = finding(laws.StribeckFriction(0.25))
    step = Step("stribeck_friction", "friction", "storey 1")
    effect = standing.Standing(one, step, (site, 1))
    seen = []
    monkeypatch.setattr(standing, "intervals", lambda *a: seen.append(a) or ({"Fc": (1.0, 2.0)}, {"Fc": 0.1}))
    null = {"stages": ["s"], "away": None, "fitted": lambda stage: stage}
    found = standing.estimate([effect], base, SimpleNamespace(truth=None, **null))
    assert found.coefficients is theta
    assert solved == [[0, 1, 2]] and step.intervals == {"Fc": (1.0, 2.0)} and step.bias == {"Fc": 0.1}
    values = list(laws.StribeckFriction(0.25).with_values([3.0, 2.0]).parameters.items())
    assert list(step.parameters.items()) == values and seen[0][1] == (site, 1) and seen[0][2] is one.candidate.law
    assert seen[0][3].tolist() == [3.0, 2.0] and seen[0][4:] == (["s"], None)
    truth = SimpleNamespace(coefficients={site: np.array([8.0, 30.0, 20.0])})
    standing.estimate([effect], base, SimpleNamespace(truth=truth, **null))
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
    monkeypatch.setattr(ranking, "lines_of", lambda trial: "lines")
    monkeypatch.setattr(ranking, "screen", lambda *a, **k: seen.append(a[4]) or [])
    monkeypatch.setattr(rounds, "sensor_findings", lambda *a: [])
    shown = SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: 1.0))
    one = bare(progress=True, every=[1, 2, 3])
    assert one._findings(shown, [Step("a", "b", "storey 1")]) == []
    assert seen[0] == {"total": 3, "desc": "search 2", "unit": "candidate", "leave": False, "disable": None}
    assert seen[1:] == ["tick", "closed"]
