"""Exact numbers of beginnings elsewhere, effects that hide each other and shapes found again, with hand-made parts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hand_made_walk import CUBIC, FRICTION, fault, finding, refuse

from pysindy_nrf import Site, laws
from pysindy_nrf.discrepancy import begin_elsewhere, reestimate, rounds, steps, together
from pysindy_nrf.discrepancy.gate import MEMBER_GAIN, Verdict
from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.laws.sensor import GainError

# -- once more, begun elsewhere ---------------------------------------------------------------------


class Way:
    """Rounds that end with a given error; those of other beginnings follow in turn, hastily and then in earnest."""

    def __init__(self, diary, lefts, doubtful=True, begun="storey 1", hasty=False):
        self.diary, self.lefts, self.hasty = diary, lefts, hasty
        self.left, self.begun, self.steps = lefts[0], begun, []
        self.doubtful = doubtful

    def go(self, stage, max_steps):
        self.diary.append(("go", self.left, self.hasty))
        self.steps = [Step("dahl", "hysteresis", "storey 1", evidence="it falls")] if self.left is not None else []

    def elsewhere(self):
        more = self.lefts[1:]
        return Way(self.diary, more, self.doubtful, None if more[0] is None else "storey 2", hasty=True)

    def in_earnest(self):
        return Way(self.diary, self.lefts, self.left > 5.0, self.begun)

    def instead_of(self, other):
        return SimpleNamespace(accepted=self.left < other.left)


@pytest.fixture
def diary(monkeypatch):
    seen = []
    monkeypatch.setattr(begin_elsewhere, "settle", lambda one: seen.append(("settle", one.left)))
    return seen


def test_effects_that_explain_what_there_is_are_the_end(diary):
    first = Way(diary, [3.0], doubtful=False)
    assert begin_elsewhere.explored(first, "baseline", 4) is first
    assert diary == [("go", 3.0, False), ("settle", 3.0)]


def test_two_other_beginnings_are_scouted_and_the_better_one_is_walked_in_earnest(diary):
    first = Way(diary, [20.0, 30.0, 4.0, 1.0])
    best = begin_elsewhere.explored(first, "baseline", 4)
    assert best.left == 4.0 and not best.hasty
    assert diary == [
        ("go", 20.0, False), ("settle", 20.0), ("go", 30.0, True), ("go", 4.0, True), ("go", 4.0, False), ("settle", 4.0),
    ]  # fmt: skip
    assert best.steps[0].evidence == "it falls; all effects that begin with dahl at storey 1 leave 20 %, these 4 %"


def test_the_second_beginning_is_not_the_last_while_doubts_stay(diary):
    best = begin_elsewhere.explored(Way(diary, [20.0, 10.0, 4.0, 1.0]), "baseline", 4)
    assert best.left == 4.0 and [d for d in diary if d[0] == "settle"] == [("settle", x) for x in (20.0, 10.0, 4.0)]
    best = begin_elsewhere.explored(Way(diary, [20.0, 4.0, 1.0]), "baseline", 4)
    assert best.left == 4.0  # no doubts are left


def test_where_nothing_can_begin_elsewhere_the_first_rounds_stay(diary):
    first = Way(diary, [20.0, None, 1.0])
    assert begin_elsewhere.explored(first, "baseline", 4) is first and diary[-1] == ("go", None, True)
    nothing = Way(diary, [20.0, 1.0], begun=None)
    assert begin_elsewhere.explored(nothing, "baseline", 4) is nothing


def bare(**parts):
    one = object.__new__(rounds.Rounds)
    one.accepted, one.steps, one.enough, one.not_first, one.begun = [], [], None, frozenset(), None
    one.__dict__.update(parts)
    return one


def test_rounds_may_not_begin_where_others_did():
    law, other, sensor = finding(laws.Dahl(1.0), 2.0, "dof 2"), finding(laws.Jenkins(0.1), 3.0), fault(GainError(0.1), 1.0)
    asked = []
    one = bare(opening=None, stage="stage")
    one._findings = lambda *a: asked.append(a) or [sensor, law, other]
    assert one._beginnings() == [sensor, law, other] == one.opening
    one.not_first = frozenset({"sensor"})
    assert one._beginnings() == [law, other] and asked == [("stage", ())]  # searched once
    one.not_first = frozenset({"sensor", "ground 2"})
    assert one._beginnings() == [other]


@pytest.mark.parametrize("enough, floor, known", [(None, 2.0, 2.0), (3.0, np.nan, 3.0)])
def test_other_rounds_share_the_baseline_and_know_the_noise_of_the_first(monkeypatch, enough, floor, known):
    monkeypatch.setattr(rounds, "Null", lambda *a, **k: (a, k))
    monkeypatch.setattr(rounds.Rounds, "floor", floor)
    stage = SimpleNamespace(name="baseline")
    scene = SimpleNamespace(trial=SimpleNamespace(work="work", stage=stage), null="null")
    one = bare(
        measured="measured", every=[1], sensors=[2], floors="floors", rng="rng", n_surrogates=2, progress=False,
        scenes=[scene, "later"], begun="storey 2", not_first=frozenset({"sensor"}), opening=["all"], enough=enough,
    )  # fmt: skip
    other = one.elsewhere()
    assert other.not_first == {"sensor", "storey 2"} and other.enough == known and other.begun is None
    assert (other.stage, other.scenes, other.opening, other.work) == (stage, [scene], ["all"], "work")
    assert other.null == (("measured", stage, "rng", 0), {"hasty": True}) == other.fitted
    earnest = other.in_earnest()
    assert earnest.not_first == other.not_first and earnest.enough is None and earnest.null == "null"


@pytest.mark.parametrize(
    "left, doubtful, enough, runs, better",
    [
        (8.0, False, None, True, True), (9.0, False, None, True, False), (5.0, True, None, True, True),
        (5.0, True, None, False, False), (5.0, True, 1.0, False, True), (5.0, False, None, False, True),
    ],
)  # fmt: skip
def test_other_rounds_take_the_place_of_the_first_where_they_explain_clearly_more(
    monkeypatch, left, doubtful, enough, runs, better
):
    monkeypatch.setattr(rounds.Rounds, "doubtful", doubtful)

    def ended(error, **more):
        stage = SimpleNamespace(laws={Site("storey 1"): (laws.LinearElastic(), laws.Dahl(1.0))})
        return bare(stage=stage, scenes=[SimpleNamespace(folds=np.full(10, error))], **more)

    one = ended(left, enough=enough)
    one.alone = lambda before, after, verdict: SimpleNamespace(accepted=runs)
    assert one.instead_of(ended(10.0)).accepted == better


def test_every_parameter_more_must_gain_more():
    def ended(error, *held):
        return bare(stage=SimpleNamespace(laws={Site(1): held}), scenes=[SimpleNamespace(folds=np.full(10, error))])

    rich = ended(7.8, laws.LinearElastic(), laws.BoucWen(0.1, 0.5), laws.Dahl(1.0))
    rich.alone = lambda before, after, verdict: verdict
    assert not rich.instead_of(ended(10.0, laws.LinearElastic())).accepted  # a gain of 22 % by five and more
    assert rich.instead_of(ended(10.0, laws.LinearElastic(), laws.BoucWen(0.1, 0.5))).accepted


# -- two that hide each other -----------------------------------------------------------------------


def hidden(monkeypatch, ranking, beside, reached=False, most=4, enough=None, before=10.0, passes=("dahl",)):
    asked = []
    monkeypatch.setattr(Finding, "on", lambda self, stage: SimpleNamespace(under=self))
    monkeypatch.setattr(
        rounds, "both_missed", lambda stage, first, second, tied, *a: first if first.law.name in passes else None
    )
    one = bare(enough=enough, every=["every"], progress=False)
    monkeypatch.setattr(rounds, "ranked", lambda stage, every, held, *a: asked.append((stage.under, list(held))) or beside)
    null = SimpleNamespace(reached=reached)
    return one._hidden("stage", ranking, np.full(5, before), null, most), asked


def test_a_second_effect_is_looked_for_beside_the_best_of_two_places(monkeypatch):
    good = 10.0 * (1 - 1.1 * MEMBER_GAIN)
    first, same, other = finding(laws.Iwan(0.1), good), finding(laws.Dahl(1.0), good), finding(laws.Dahl(1.0), good, "storey 2")
    third = finding(laws.Dahl(1.0), good, "storey 3")
    gap = finding(laws.OneSidedGap(0.1), 1.0, "storey 3")
    found, asked = hidden(monkeypatch, [first, same, other, third], [gap])
    assert found is other and asked == [(first, [first]), (other, [other])]
    assert hidden(monkeypatch, [first, same], [gap])[0] is None  # a place has one try
    faint = finding(laws.Dahl(1.0), 10.0 * (1 - 0.9 * MEMBER_GAIN))
    dropping = finding(laws.Dahl(1.0), 5.0, drop=((Site("storey 1"), 1),))
    assert hidden(monkeypatch, [faint, dropping, fault(GainError(0.1), 5.0)], [gap])[1] == []
    endless = finding(laws.OneSidedGap(0.1), site="storey 3", folds=[np.inf] * 5)
    for useless in ([], [finding(laws.OneSidedGap(0.1), 1.0)], [endless]):
        assert hidden(monkeypatch, [same], useless)[0] is None


@pytest.mark.parametrize(
    "options, looks",
    [
        ({}, True), ({"reached": True}, False), ({"most": 1}, False), ({"most": 2}, True), ({"enough": 7.0}, True),
        ({"enough": 8.0}, False), ({"enough": np.nan}, True),
    ],
)  # fmt: skip
def test_nothing_hidden_is_looked_for_at_the_floor(monkeypatch, options, looks):
    """Within 1.3 times what noise leaves."""
    good = finding(laws.Dahl(1.0), 10.0 * (1 - 1.1 * MEMBER_GAIN))
    assert bool(hidden(monkeypatch, [good], [CUBIC], **options)[1]) == looks


def test_the_first_of_two_stands_with_the_shape_it_has_beside_the_second(monkeypatch):
    judged = []
    monkeypatch.setattr(together, "_passed", lambda *a: judged.append(a) or Verdict(True, 0.5, 1.0, 0.0, "both"))
    site, linear = Site("storey 1"), laws.LinearElastic()
    monkeypatch.setattr(Finding, "on", lambda self, stage: SimpleNamespace(held=(self.law, stage)))
    around = SimpleNamespace(laws={site: (linear, laws.TwoSidedGap(0.3))})
    monkeypatch.setattr(Finding, "under", lambda self, stage: around)
    first, second = finding(laws.TwoSidedGap(0.1)), finding(laws.Dahl(1.0), site="storey 2")
    members, verdict = together.both_missed("stage", first, second, ["tied"], "before", "null")
    assert members[0][0].law == laws.TwoSidedGap(0.3) and members[0][1] == [] and members[1] == (second, ["tied"])
    assert verdict.sentence == "both" and judged[0][-1] == 2 + 2 - 2
    monkeypatch.setattr(together, "_passed", lambda *a: None)
    assert together.both_missed("stage", first, second, [], "before", "null") is None


@pytest.mark.parametrize("site, other, sure", [("F2", True, True), ("F2", False, False), ("a2", False, True)])
def test_a_gain_of_a_force_beside_a_doubtful_name_is_doubtful(site, other, sure):
    """A force has one channel: what an effect without a name leaves, its gain may make up for."""
    gain = Step("gain_error", "sensor", f"sensor {site}")
    steps.doubt_names([Step("dahl", "hysteresis", "storey 1", sure=other), gain])
    assert gain.sure == sure


# -- shapes found again -----------------------------------------------------------------------------


def stage_of(*held, error=1.0):
    one = SimpleNamespace(
        laws={Site("storey 1"): held}, slot=lambda: SimpleNamespace(search_error=lambda: error),
    )  # fmt: skip
    return one


def test_a_candidate_stands_among_the_others_as_they_are_beside_it(monkeypatch):
    gap, slid = finding(laws.TwoSidedGap(0.1)), laws.TwoSidedGap(0.3)
    gap.candidate = SimpleNamespace(law=laws.TwoSidedGap(), site=Site("storey 1"))
    new = finding(laws.Dahl(1.0), 4.0)
    asked = []

    def again(stage, accepted, n):
        asked.append((list(accepted), n))
        return stage_of(laws.LinearElastic(), slid, laws.Dahl(2.0), error=0.5)

    monkeypatch.setattr(reestimate, "reestimated", again)
    monkeypatch.setattr(Finding, "on", lambda self, stage: stage)
    stage = stage_of(laws.LinearElastic(), laws.TwoSidedGap(0.1))
    found = reestimate.among(stage, new, [gap])
    assert found.law == laws.Dahl(2.0) and found.screen == 0.5 and asked == [([gap, new], 1)]
    assert found.around == {Site("storey 1"): (laws.LinearElastic(), slid)}
    assert reestimate.among(stage, new, []) is new
    sensor = fault(GainError(0.1))
    assert reestimate.among(stage, sensor, [gap]) is sensor
    instead = finding(laws.Dahl(1.0), drop=((Site("storey 1"), 1),))
    assert reestimate.among(stage, instead, [gap]) is instead  # none is left beside it
    assert reestimate.among(stage_of(laws.CoulombFriction()), new, [FRICTION]) is new  # nothing to find again
    monkeypatch.setattr(reestimate, "reestimated", refuse)
    assert reestimate.among(stage, new, [gap]) is new
