"""Exact numbers of the rooms of the loop: candidates, gate, evidence, floors, intervals, words, by hand or theory."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import welch

from pysindy_nrf import Chain, ChainModel, Site, laws
from pysindy_nrf.discrepancy import (
    admissible,
    characterisation,
    contradictions,
    coupling,
    dependence,
    detection,
    evidence,
    floor_source,
    free_run,
    gate,
    intervals,
    leftover,
    likeliest,
)
from pysindy_nrf.discrepancy.catalogue import Candidate, as_laws, balances_of, candidates, default_catalogue
from pysindy_nrf.discrepancy.contradictions import Suspect
from pysindy_nrf.discrepancy.correlation import Cross, peak_limit, probability_of_peak
from pysindy_nrf.discrepancy.coupling import Coupling, couplings
from pysindy_nrf.discrepancy.dependence import Judge, knots_of
from pysindy_nrf.discrepancy.detection import LINEAR, NOISE, NONLINEAR, UNMEASURED, Detection, detect
from pysindy_nrf.discrepancy.evidence import Evidence
from pysindy_nrf.discrepancy.floor_source import FloorSource
from pysindy_nrf.discrepancy.gate import FLOOR, choose, judge
from pysindy_nrf.discrepancy.noise_floor import AT_FLOOR, BELOW_FLOOR, LOUD, NoiseFloor
from pysindy_nrf.discrepancy.residual import ROUND_OFF, residual_of
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.discrepancy.splits import BlockRows
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.errors import Sizes
from pysindy_nrf.exceptions import ChannelError, LawError, NRFError
from pysindy_nrf.input_arrays import from_arrays
from pysindy_nrf.laws import Motion
from pysindy_nrf.laws.sensor import ChannelDelay, GainError


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def fresh(text):
    """The same text, as another object: what it says counts."""
    return "".join(list(text))


def finding(law, error, site="storey 1", drop=(), folds=None):
    folds = np.array([error, error, 9 * error]) if folds is None else folds
    return Finding(Candidate(law, Site(site)), law, error, drop, folds)


def residual(n=600, n_dof=2, e=None, forced=True, seed=0, lengths=None, **more):
    """A residual of given balances along motions and forces of noise."""
    sets = []
    for k, length in enumerate(lengths or [n]):
        rng = np.random.default_rng(seed + k)
        X, F = rng.standard_normal((length, 3 * n_dof)), rng.standard_normal((length, n_dof))
        sets.append(from_arrays(X, F if forced else 0 * F, dt=0.01, **more))
    data = type(sets[0])([s.segments[0] for s in sets], sum(lengths or [n]))
    model = ChainModel([1.0] * n_dof, {i: [laws.LinearElastic(1.0)] for i in range(1, n_dof + 1)})
    found = residual_of(model, data)
    return found if e is None else found.with_balance(e)


# -- numbers that were chosen -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "module, numbers",
    [
        (admissible, {"_SLACK": 0.1}),
        (
            gate,
            {
                "MIN_GAIN": 0.15, "MIN_WINS": 0.8, "MEMBER_GAIN": 0.05, "PARAMETER_GAIN": 0.05, "AT_THE_FLOOR": 2.0,
                "TIE": 0.1, "PER_PARAMETER": 0.1, "SIMPLER": 0.02, "MOST_OF_THE_WORK": 0.65, "HALF_OF_THE_WORK": 0.5,
                "MOST_LEFT": 2.0, "MOST_FAMILIES": 3, "FLOOR": 0.02,
            },
        ),
        (coupling, {"_LOUD": 2.0, "_OWN": 0.5, "_ALL": 0.95, "_OTHERS": 0.05, "_SURELY": 2.0}),
        (coupling, {"_BLOCKS": 60, "_FOLDS": 10, "_YIELD": (0.15, 0.6, 1.6, 4.0)}),
        (characterisation, {"NEARLY": 0.04, "LEAST": 0.15, "_LINE_LEVEL": 0.01, "_ENOUGH": 8000, "_PER_PERIOD": 8}),
        (contradictions, {"CONTRADICTION": 0.02, "_SAID": 0.06, "MOST": 4, "_HALF": 1000}),
        (dependence, {"_YIELD": (0.02, 0.06, 0.15, 0.3, 0.6, 1.0, 1.6, 2.5), "_RIDGE": (1e-9, 1e-5, 1e-3, 3e-2)}),
        (detection, {"_WHITE_LAGS": 20, "_TAPS": 4, "_ENOUGH": 4096, "_PER_PERIOD": 8}),
        (evidence, {"_ENOUGH": 40_000, "_NEAR": 5.0}),
        (floor_source, {"_FEWEST": 64}),
        (intervals, {"LEVEL": 0.95, "_STEP": 2e-3, "_LEAST_FOLDS": 3, "_LEAST": 1e-4}),
        (leftover, {"_CLEARLY": 1.0, "_SCATTER": 1.5}),
        (likeliest, {"_RIVAL": 0.35, "_MOST": 3, "_CLEARLY": 0.7}),
    ],
)  # fmt: skip
def test_thresholds_are_those_that_the_benchmarks_were_run_with(module, numbers):
    assert {name: getattr(module, name) for name in numbers} == numbers


def test_gaps_are_tried_in_fifths_of_the_rms_drift():
    assert dependence.GAPS == pytest.approx([k / 5 for k in range(14)])
    power = np.fft.fft(np.hanning(4097)[:-1] ** 2).real  # neighbouring lines are alike as its transform tells
    assert characterisation._HANN_OVERLAP == pytest.approx(((power / power[0]) ** 2).sum(), rel=1e-6)


@pytest.mark.parametrize(
    "one, name",
    [
        (Candidate(laws.CoulombFriction(), Site("storey 1")), "site"), (Coupling(1, 2.0, 3.0, 4.0, 5.0), "own"),
        (Suspect(GainError(0.1), Site("sensor a1")), "remark"), (gate.Verdict(True, 1.0, 1.0, 0.0, ""), "accepted"),
    ],
)  # fmt: skip
def test_what_was_found_is_not_changed_afterwards(one, name):
    with pytest.raises(FrozenInstanceError):
        setattr(one, name, None)


# -- what can be, and what is tried -----------------------------------------------------------------


def test_a_stribeck_force_without_friction_is_none_and_a_tenth_of_driving_is_allowed():
    assert not admissible.admissible(laws.StribeckFriction(), np.array([0.0, 1.0]), np.ones(2))
    law = laws.LinkSpringDashpot()
    assert admissible.admissible(law, np.array([1.0, -0.1]), np.ones(2)) and len(law.terms()) == 2
    # what counts is the share of the rms: coefficient times size
    assert admissible.admissible(law, np.array([1.0, -10.0]), np.array([1.0, 0.009]))
    assert not admissible.admissible(law, np.array([1.0, -0.01]), np.array([1.0, 11.0]))


@pytest.mark.parametrize(
    "site, same",
    [
        ("dof 1", "storey 1"), ("dof 3", "ground 3"), ("storey 2", "storey 2"), ("ground 2", "ground 2"),
        ("link 4-2", "link 4-2"), ("sensor a1", "sensor a1"),
    ],
)  # fmt: skip
def test_a_law_on_a_dof_stands_where_one_to_the_ground_does(site, same):
    assert balances_of(Site(site)) == same


def test_every_covariate_is_tried_with_the_laws_that_it_can_drive():
    others = ["covariate_friction", "lagged_covariate_friction", "covariate_dahl"]
    known = {"ag": ["base_motion"], "vg": ["ground_friction"]}
    plain = len(default_catalogue())
    for name in ("T", "af", "ag", "ah", "u", "vf", "vg", "vh", "z"):
        more = default_catalogue([fresh(name)])[plain:]
        assert [law.name for law in more] == known.get(name, others)
        assert all(law.covariates == (name,) for law in more)
    one_sided = [law for law in default_catalogue() if law.name in ("one_sided_gap", "preloaded_contact")]
    assert [law.side for law in one_sided] == [1, -1, 1, -1]


def test_a_catalogue_holds_laws_or_their_classes():
    made = as_laws([laws.Dahl, laws.OneSidedGap(side=-1), laws.CoulombFriction], ())
    assert [law.name for law in made] == ["dahl", "one_sided_gap", "coulomb_friction"] and made[1].side == -1
    assert [law.name for law in as_laws(None, ["vg"])] == [law.name for law in default_catalogue(["vg"])]
    for wrong in (3, [int], ["dahl"], [laws.Dahl(), None]):
        with pytest.raises(LawError):
            as_laws(wrong, ())


DOFS = [f"dof {j}" for j in range(1, 5)]
LINKS = ["storey 1", "storey 2", "storey 3", "storey 4", "link 4-2"]
PLACES = {
    "friction": LINKS + ["ground 2", "ground 3", "ground 4"],
    "link": ["ground 2", "ground 3", "ground 4", "link 3-1", "link 4-1"],
    "harmonic_force": DOFS, "base_motion": DOFS, "ground_friction": DOFS,
    "constant_force": DOFS + ["storey 2", "storey 3", "storey 4", "link 4-2"],
    "added_mass": ["dof 2", "dof 4"],
}  # fmt: skip


def test_every_law_is_tried_at_every_site_where_it_makes_sense():
    """A chain with a brace: dampers may stand on the storeys and the ground, new links where there is none yet."""
    every = default_catalogue(["T", "ag", "vg"])
    found = {}
    for c in candidates(every, Chain(4, links=["link 4-2"]), (4, 2, 1), ("T", "ag", "vg"), (4, 2)):
        found.setdefault(id(c.law), []).append(str(c.site))
    for law in every:
        wanted = [] if law.family == "sensor" else PLACES.get(law.name, PLACES.get(law.family, LINKS))
        assert found.get(id(law), []) == wanted, law.name
    assert Candidate(every[0], Site("ground 2")).name == "coulomb_friction at ground 2"


def test_a_chain_without_forces_is_not_asked_for_inertia_and_a_free_one_has_no_first_storey():
    every = default_catalogue(["ag"])
    still = {c.law.name for c in candidates(every, Chain(2), (1, 2), ("ag",), ())}
    known = {law.name for law in every if law.family != "sensor"}
    # of two floors no link but the ground's is missing
    assert known - still == {"inerter", "added_mass", "base_motion", "maxwell_branch"}
    free = Chain(3, ground="free")

    def places(law):
        return [str(c.site) for c in candidates([law], free, (), (), (1,))]

    assert places(laws.CoulombFriction()) == ["storey 2", "storey 3", "storey 1", "ground 2", "ground 3"]
    assert places(laws.LinkSpringDashpot()) == ["storey 1", "ground 2", "ground 3", "link 3-1"]
    assert places(laws.ConstantForce()) == ["dof 1", "dof 2", "dof 3", "storey 2", "storey 3"]
    assert places(laws.CubicStiffness()) == ["storey 2", "storey 3"]
    assert list(candidates([laws.LinkSpringDashpot()], Chain(1), (), (), (1,))) == []


@pytest.mark.parametrize("n_records, tried", [(0, True), (1, True), (2, False), (3, False)])
def test_what_cannot_stand_anywhere_does_not_end_the_list(n_records, tried):
    held = [ChannelDelay(), laws.CovariateFriction(covariate="T"), laws.StiffnessStep(), laws.ConstantForce()]
    found = {c.law.name for c in candidates(held, Chain(1), (), (), (1,), n_records)}
    assert found == {"constant_force", *(["stiffness_step"] if tried else [])}
    assert {c.law.name for c in candidates(held, Chain(1), (), (), (1,))} == {"constant_force", "stiffness_step"}


# -- correlation and columns ------------------------------------------------------------------------


def test_a_height_of_zero_is_exceeded_for_sure_without_a_division_by_zero():
    with np.errstate(all="raise"):
        assert probability_of_peak(0.0, 1, 1.0) == pytest.approx(1.0)
        assert probability_of_peak(0.0, 5, 1.0) == pytest.approx(1.0)


@pytest.mark.parametrize("x, knots", [([10.0, 12.0, 110.0], [10, 60, 110]), ([-50.0, 2.0, 50.0], [-50, 0, 50])])
def test_a_knot_must_lie_farther_off_than_a_fiftieth_of_the_range(x, knots):
    assert knots_of(np.array(x), 3) == pytest.approx(knots)


def test_a_judge_has_a_block_of_every_record_and_five_folds_by_default():
    rng = np.random.default_rng(0)
    force = [rng.standard_normal(1000), rng.standard_normal(5)]
    one = Judge(force, {"a": [np.ones((len(f), 1)) for f in force]})
    assert len(one.grams) == 26 and one.folds.tolist() == [k % 5 for k in range(26)]
    few = Judge([force[0]], {"a": [np.ones((1000, 1))]}, 2)
    assert few.folds.tolist() == [0, 1]
    # of a single block it can be judged on that block alone
    single = Judge([force[1]], {"a": [np.ones((5, 1))]}, 1)
    assert single.share(["a"])[0] == pytest.approx(5 * force[1].mean() ** 2 / (force[1] @ force[1]), rel=1e-6)
    assert np.isnan(single.share(["a"])[1])


# -- coupling ---------------------------------------------------------------------------------------


def test_shares_of_a_coupling_in_percent():
    text = str(Coupling(1, 5.0, 0.9, 0.9, 0.0))
    assert "explain 90 % of that" in text and "storeys 90 % of the rest" in text


class Judges:
    """Stands in for the regressions: shares as given, and a note of what it was asked."""

    def __init__(self, linear=0.1, law=0.2, others=(0.3, 0.01)):
        self.given, self.made, self.beside = {("linear",): linear, ("linear", "law"): law}, [], []
        self.others = others

    def __call__(self, force, groups, n_blocks, n_folds):
        self.made.append((force, groups, n_blocks, n_folds))
        return self

    def share(self, names, beside=None):
        if names == ["others"]:
            self.beside.append(beside)
            return self.others
        return self.given[names], 0.5


def judged(monkeypatch, found, floor=None, **given):
    judges = Judges(**given)
    monkeypatch.setattr(coupling, "Judge", judges)
    return couplings(found, floor), judges


def test_a_storey_is_judged_beside_the_drifts_and_rates_of_all_others(monkeypatch):
    found, judges = judged(monkeypatch, residual(300, 3, lengths=[300, 200]))
    assert sorted(c.storey for c in found) == [1, 2, 3] and [made[2:] for made in judges.made] == [(60, 10)] * 3
    for i, (force, groups, *_) in enumerate(judges.made):
        assert [len(f) for f in force] == [300, 200] and list(groups) == ["linear", "law", "others"]
        rest = [j for j in range(3) if j != i]
        for k, seg in enumerate(residual(300, 3, lengths=[300, 200]).data.segments):
            assert groups["others"][k] == pytest.approx(np.hstack([seg.s[:, rest], seg.v[:, rest]]))
            assert groups["linear"][k] == pytest.approx(np.column_stack([seg.s[:, i], seg.v[:, i]]))


def test_yield_drifts_are_multiples_of_the_rms_drift_or_of_one_where_nothing_moves(monkeypatch):
    scales = []
    monkeypatch.setattr(coupling, "_own", lambda m, scale: scales.append(scale) or np.zeros((m.n_samples, 1)))
    found = residual(300, 2, lengths=[300, 200])
    for seg in found.data.segments:
        seg.s[:, 1] = 0.0
    judged(monkeypatch, found)
    first = np.concatenate([seg.s[:, 0] for seg in found.data.segments])
    assert scales == [pytest.approx(np.sqrt(np.mean(first**2)))] * 2 + [1.0] * 2


def test_records_in_which_a_storey_is_silent_or_unknown_are_left_aside(monkeypatch):
    e = [noise(300)[:, None], np.zeros((200, 1)), np.full((250, 1), np.nan)]
    found, judges = judged(monkeypatch, residual(n_dof=1, lengths=[300, 200, 250], e=e))
    assert [len(f) for f in judges.made[0][0]] == [300] and [c.storey for c in found] == [1]
    assert len(judges.made[0][1]["law"]) == 1 and "others" not in judges.made[0][1]
    nothing = residual(n_dof=1, lengths=[300], e=[np.full((300, 1), np.nan)])
    assert judged(monkeypatch, nothing)[0] == []


def test_a_quiet_storey_does_not_end_the_list_and_one_at_a_threshold_is_quiet(monkeypatch):
    found = residual(300, 3)
    found.sizes.loc["storey 1", "rms"] = ROUND_OFF * found.sizes.loc["storey 1", "reference"]
    assert sorted(c.storey for c in judged(monkeypatch, found)[0]) == [2, 3]
    loud = found.sizes.loc["storey 2", "rms"]
    for storey, listed in (([0.0, loud / 2, 0.0], [3]), ([0.0, np.nan, 0.0], [3]), ([0.0, loud / 2.01, 0.0], [2, 3])):
        floor = NoiseFloor(np.ones(3), np.array(storey), "given")
        assert sorted(c.storey for c in judged(monkeypatch, found, floor)[0]) == listed


@pytest.mark.parametrize(
    "linear, law, own, beside",
    [
        (0.1, 0.3, 0.3, ["linear", "law"]), (0.3, 0.1, 0.3, ["linear"]), (-0.1, 0.0, 0.0, []), (-0.1, -0.2, -0.1, []),
    ],
)  # fmt: skip
def test_columns_that_explain_nothing_are_not_taken_beside_the_others(monkeypatch, linear, law, own, beside):
    found, judges = judged(monkeypatch, residual(300, 2), linear=linear, law=law)
    assert judges.beside == [beside] * 2 and [c.own for c in found] == [own] * 2
    assert [(c.others, c.error) for c in found] == [(0.3, 0.01)] * 2


@pytest.mark.parametrize(
    "own, others, listed",
    [(0.5, 0.0, False), (0.499, 0.0, True), (0.5, 0.3, True), (0.949, 0.3, True), (0.95, 0.3, False)],
)
def test_half_of_a_storey_or_all_but_a_twentieth_must_be_explained(monkeypatch, own, others, listed):
    found, _ = judged(monkeypatch, residual(300, 2), law=own, others=(others, 0.01))
    assert bool(found) == listed


# -- gate -------------------------------------------------------------------------------------------


def blocks(gain, n=10, level=5.0):
    return np.full(n, level), np.full(n, level * (1 - gain))


@pytest.mark.parametrize(
    "null, gain, at_floor, accepted",
    [
        (0.03, 0.06, False, True), (0.03, 0.06, True, True), (0.05, 0.07, False, True), (0.0501, 0.07, False, False),
        (0.06, 0.1, False, False), (0.06, 0.12, False, True), (0.06, 0.12, True, False), (-0.2, 0.06, False, True),
    ],
)  # fmt: skip
def test_what_noise_gains_counts_from_a_twentieth_on(null, gain, at_floor, accepted):
    assert judge(*blocks(gain), null_gain=null, least=0.05, at_floor=at_floor).accepted == accepted


def test_the_gate_is_not_at_the_floor_unless_told_and_what_is_asked_is_enough():
    assert judge(*blocks(0.4), null_gain=0.3).accepted
    assert judge(*blocks(0.5), least=0.5).accepted and judge(*blocks(0.5, level=2 * FLOOR)).accepted
    assert judge(*blocks(0.5, level=FLOOR)).accepted  # nothing is left to explain below it only
    before, after = blocks(0.5)
    after[:2] = before[:2]  # as much is no win
    assert judge(before, after).wins == 0.8 and judge(before, after).accepted
    after[2] = before[2]
    assert not judge(before, after).accepted
    assert "falls by 90 % (5 to 0.5 %), in 100 % of the blocks" in judge(*blocks(0.9)).sentence
    assert "at least 95 % are asked (90 % come from noise alone)" in judge(*blocks(0.5), null_gain=0.9).sentence
    closed = judge(*blocks(0.5, level=0.01))
    assert not closed.accepted and "closes within 0.01 %" in closed.sentence


def test_a_family_is_tied_up_to_a_tenth_above():
    best, other = finding(laws.CoulombFriction(), 1.0), finding(laws.CubicStiffness(), 1.0 * (1 + gate.TIE))
    assert choose([best, other], 9.0) == (best, [other])
    same = finding(laws.AsymmetricFriction(), 1.05)  # of its own family none
    assert choose([best, same], 9.0) == (best, [])


@pytest.mark.parametrize("site, first", [("storey 1", False), ("storey 2", True), ("storey 3", False)])
def test_a_special_case_must_stand_at_the_same_site(site, first):
    general, simple = finding(laws.Iwan(0.1, 0.2), 1.0, "storey 2"), finding(laws.Jenkins(0.1), 1.5, site)
    assert (choose([general, simple], 90.0)[0] is simple) == first


def test_a_covariate_may_make_more_of_a_difference_than_twice():
    plain = finding(laws.CoulombFriction(), 3.0)
    assert choose([finding(laws.CovariateFriction(covariate="T"), 1.0), plain], 90.0)[0] is plain
    both = [finding(laws.CovariateDahl(covariate="T"), 1.0), finding(laws.CovariateFriction(covariate="T"), 3.0)]
    assert choose(both, 90.0)[0] is both[1]
    stribeck = finding(laws.StribeckFriction(0.1), 1.0)
    assert choose([stribeck, plain], 90.0)[0] is stribeck


def test_a_special_case_of_a_law_that_does_nothing_does_none_of_its_work():
    general, simple = finding(laws.Iwan(0.1, 0.2), 1.0), finding(laws.Jenkins(0.1), 1.3)
    assert choose([general, simple], 0.9)[0] is general


def test_of_several_special_cases_the_one_with_fewest_parameters_then_the_best_goes_first():
    general = finding(laws.DeadZone(0.1, 0.2), 1.0)
    gaps = [finding(laws.OneSidedGap(0.1), 1.6), finding(laws.TwoSidedGap(0.1), 1.5)]
    assert gate._special_case(general, [general, *gaps], 90.0) is gaps[1]
    constant = finding(laws.ConstantForce(), 1.7)
    assert gate._special_case(general, [general, *gaps, constant], 90.0) is constant
    # no law with more parameters is the simpler one
    few, many = finding(laws.LuGre(0.1, 0.2, 0.3), 1.0), finding(laws.Dahl(10.0), 1.1)
    assert gate._special_case(few, [few, many], 90.0) is many
    assert gate._special_case(many, [few, many], 90.0) is many


# -- characterisation -------------------------------------------------------------------------------


def motion(n=500, seed=0, dt=0.02, a=False, **covariates):
    t = np.arange(n) * dt
    w, p = np.array([2.1, 5.3, 9.7])[:, None], np.random.default_rng(seed).uniform(0, 6, (3, 1))
    s, v, acceleration = (f.sum(axis=0) for f in (np.sin(w * t + p), w * np.cos(w * t + p), -w * w * np.sin(w * t + p)))
    return Motion(s, v, acceleration if a else None, t, covariates)


def work_of(force, m, filters=None, beside=None, channels=None):
    return characterisation._Work.of(force, m, filters, beside, channels)


def test_what_is_asked_begins_with_the_simplest_and_holds_covariates_that_move_in_every_record():
    simple = ["constant", "linear", "s alone", "v alone", "time", "amplitude", "s and v", "path"]
    ramp, still = np.linspace(0, 1, 500), np.full(500, 3.0)
    one = motion(T=ramp, U=ramp, K=still, L=still)
    two = motion(seed=1, T=ramp, K=still, L=ramp)
    both = work_of([noise(500), noise(500, 1)], [one, two])
    held = [k for k in both.names if k.startswith("covariate ")]
    assert held == ["covariate T", "covariate L"] and [k for k in both.names if k not in held] == simple
    assert list(both.names)[4:6] == held
    timeless = work_of(noise(500), Motion(one.s, one.v))
    assert list(timeless.names) == [k for k in simple if k != "time"] and np.isnan(timeless.frequency)
    late = work_of(noise(500), one, channels={"F1": noise(500, 3)})
    assert list(late.names)[2] == "delay" and late.judge.at["delay"].size == 1
    assert work_of(noise(500), motion(a=True)).judge.at["delay"].size == 1
    assert work_of(noise(500), motion(a=True), channels={"F1": noise(500, 3)}).judge.at["delay"].size == 2
    tone = work_of(noise(500) + 9 * np.cos(2 * np.pi * 8.0 * one.t), one)
    assert list(tone.names)[2] == "line" and tone.frequency == pytest.approx(8.0, abs=0.05)


def test_forces_come_as_one_array_a_list_or_rows_and_what_goes_beside_them_with_each():
    one, two = motion(), motion(seed=1)
    rows = work_of(np.array([noise(500), noise(500, 1)]), [one, two])
    assert [f.tolist() for f in rows.force] == [noise(500).tolist(), noise(500, 1).tolist()]
    single = work_of([noise(500)], [one], beside=noise(500, 2)[:, None])
    assert single.base == ["constant", "linear", "beside"] and single.judge.at["beside"].size == 1

    class Half:
        def apply(self, columns):
            return columns / 2

    part = work_of([noise(500), np.full(500, np.nan)], [one, two], Half(), [np.ones((500, 2)), np.ones((500, 2))])
    assert len(part.filters) == len(part.motions) == 1 and part.judge.at["beside"].size == 2
    assert part.judge.size[part.judge.at["constant"][0]] == pytest.approx(np.sqrt(500 / 4))
    with pytest.raises(ChannelError, match="differ in length"):
        work_of([noise(500)], [one, two])
    for force in ([np.full(500, np.nan)], [np.full(500, np.inf)]):
        with pytest.raises(ChannelError, match="not finite"):
            work_of(force, [one])
    with pytest.raises(ChannelError, match="not finite"):
        work_of([np.full(500, np.nan), np.where(np.arange(500) < 3, np.nan, 1.0)], [one, two])


def test_the_force_is_drawn_over_every_variable():
    ramp = np.linspace(0, 1, 500)
    force = noise(500)
    curves = work_of(force, motion(T=ramp)).curves()
    assert sorted(curves) == ["amplitude", "covariate T", "s", "t", "v"]
    bins = np.split(np.arange(500), np.linspace(0, 500, 31).astype(int)[1:-1])
    assert curves["covariate T"]["centre"].tolist() == pytest.approx([ramp[k].mean() for k in bins])
    assert curves["t"]["mean"].tolist() == pytest.approx([force[k].mean() for k in bins])
    m = motion()
    assert sorted(work_of(force, Motion(m.s, m.v)).curves()) == ["amplitude", "s", "v"]


def test_a_kink_is_told_instead_of_a_bend_and_a_jump_of_the_rate_alone(monkeypatch):
    one = work_of(noise(500), motion())
    one.rms = 1.0
    monkeypatch.setattr(one, "_has_kink", lambda: True)
    assert one._marks("s", {}) == ["kink"]
    monkeypatch.setattr(one, "_has_kink", lambda: False)
    for word in ("hardening", ""):
        monkeypatch.setattr(one, "_bend", lambda c, word=word: word if len(c) == 4 else "wrong")
        assert one._marks("s", {}) == [word] * bool(word)
    assert one._marks("v", {"v": np.array([-0.31])}) == ["jump at v = 0"]
    assert one._marks("v", {"v": np.array([0.3 * one.rms])}) == []
    for group in ("surface", "path"):
        assert one._marks(group, {group: np.array([9.0])}) == []
    assert one._marks("amplitude", {}) == one._marks("time", {}) == []


def test_the_odd_share_of_a_surface_is_asked_of_all_its_columns():
    """v s^2 is odd under (s, v) -> (-s, -v), s v is even."""
    m = motion(3000)
    odd, even = m.v * m.s**2, m.s * m.v
    for dependence_, force, share in (("s and v", odd, 1.0), ("s and v", even, 0.0), ("path", odd, 1.0)):
        assert work_of(force, m).shape_of(dependence_)[0] == pytest.approx(share, abs=0.02)
    assert np.isnan(work_of(odd, m).shape_of("delay")[0]) and work_of(odd, m).shape_of("line") == (
        pytest.approx(np.nan, nan_ok=True), []
    )  # fmt: skip


def test_a_mirrored_motion_has_its_acceleration_mirrored_and_what_goes_beside_is_no_part_of_the_function(monkeypatch):
    m = motion(a=True)
    one = work_of(noise(500), m, beside=noise(500, 2)[:, None])
    held = {"constant": np.array([3.0]), "linear": np.array([2.0, -1.0, 0.5])}
    for sign in (1.0, -1.0):
        wanted = 3.0 + sign * (2.0 * m.s - m.v + 0.5 * m.a)
        assert one._value(["constant", "linear"], held, sign) == pytest.approx(wanted)
    asked = []
    monkeypatch.setattr(one, "_value", lambda names, coefficients, sign: asked.append((names, sign)) or np.zeros(5))
    assert np.isnan(one.shape_of("amplitude")[0])  # a function of nothing is neither odd nor even
    names = ["constant", "linear", "amplitude"]
    assert asked == [(names, 1.0), (names, -1.0)]
    values = iter([np.array([3.0, 1.0]), np.array([-1.0, 1.0])])  # differences 4, 0; sums 2, 2
    monkeypatch.setattr(one, "_value", lambda *a: next(values))
    assert one.shape_of("linear")[0] == pytest.approx(16 / 24)


@pytest.mark.parametrize("line, told", [(1, False), (2, True), (398, True), (399, False), (400, False)])
def test_the_three_frequencies_at_either_end_are_no_lines(line, told):
    """A Hann window shows a line at three neighbouring frequencies; the fourth from the end may stand out."""
    n, fs = 800, 100.0
    t = np.arange(n) / fs
    e = np.cos(2 * np.pi * line * fs / n * t + 1.0) + 0.1 * noise(n)
    assert np.isfinite(characterisation.spectral_line([e], [Motion(t, t, t=t)])) == told


def test_a_force_is_drawn_in_thirty_bins():
    assert len(characterisation.conditional_mean(noise(300), noise(300, 1))) == 30


def fitted(monkeypatch, **shares):
    """Characterise with shares as given, simplest first."""
    given = {"constant": 0.0, "linear": 0.0, "s alone": 0.0, "s and v": 0.0, "path": 0.0} | shares

    def share(columns):
        return given["constant" if columns == ["constant"] else columns[-1] if len(columns) > 2 else "linear"], 0.0

    one = SimpleNamespace(judge=SimpleNamespace(share=share), base=["constant", "linear"], frequency=1.0, rms=1.0)
    one.names = {k: [] if k in ("constant", "linear") else [k] for k in given}
    one.shape_of, one.curves = lambda d: (0.5, []), dict
    monkeypatch.setattr(characterisation._Work, "of", lambda *a: one)
    return characterisation.characterise(None, None)


def test_what_is_just_enough_is_enough(monkeypatch):
    assert fitted(monkeypatch, path=0.15).dependence == "path"  # 15 %
    assert fitted(monkeypatch, path=0.9, **{"s alone": 0.86}).dependence == "s alone"  # 4 points less
    assert fitted(monkeypatch, path=0.5, **{"s alone": 0.471}).dependence == "s alone"  # three quarters of 4 points
    assert fitted(monkeypatch, path=0.5, **{"s alone": 0.469}).dependence == "path"


@pytest.mark.parametrize("odd, word", [(0.9, "neither odd nor even"), (0.1, "neither odd nor even"), (0.0, "even")])
def test_parity_is_told_beyond_nine_tenths(odd, word):
    table = pd.DataFrame({"share": [80.0]}, index=["s alone"])
    found = characterisation.Characterisation(table, "s alone", 0.0, odd, np.nan, [])
    assert characterisation._sentence(found, None, 1.0) == (
        f"Depends on s alone, {word}, smooth: a nonlinear spring; 80 % explained on data left out."
    )
    assert "noise is 81 %." in characterisation._sentence(found, 0.9, 1.0)


# -- contradictions ---------------------------------------------------------------------------------


def alignment(**rows):
    base = dict(reference="a1", delay=0.0, gain=1.0, sign=1.0, coherence=1.0, aligned=False, message="m")
    return pd.DataFrame.from_dict({k: base | r for k, r in rows.items()}, orient="index")


def suspects(monkeypatch, *tables):
    """What the channels say if they are compared as a whole and in both halves as given."""
    given = iter(tables)
    monkeypatch.setattr(contradictions, "channel_alignment", lambda record, runs: next(given))
    monkeypatch.setattr(contradictions, "_halves", lambda runs: [runs, runs])
    monkeypatch.setattr(contradictions, "_runs", lambda work: (0, []))
    monkeypatch.setattr(contradictions, "pace", lambda work, dof: 10.0 * dof)
    ready = SimpleNamespace(contradictions=None, records=[None])
    found = contradictions.contradictory(ready, None)
    assert ready.contradictions is found and contradictions.contradictory(ready, None) is found  # looked for once
    return found


def test_channels_that_cannot_be_compared_tell_nothing():
    def refuse(work):
        raise NRFError("x", "y")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contradictions, "_runs", refuse)
        ready = SimpleNamespace(contradictions=None, records=[])
        assert contradictions.contradictory(ready, None) == [] == ready.contradictions


def test_a_channel_in_order_does_not_end_the_comparison(monkeypatch):
    table = alignment(v1={"gain": 2.0, "aligned": True}, x1={"gain": np.nan}, x2={"gain": 1.5, "delay": 0.01})
    found = suspects(monkeypatch, table, table, table)
    assert [(round(size, 9), s.law.name, str(s.site)) for size, s in found] == [
        (0.5, "gain_error", "sensor x2"), (0.5, "gain_error", "sensor a1"),
        (0.2, "channel_delay", "sensor x2"), (0.2, "channel_delay", "sensor a1"),  # 10 ms at 20 / s
    ]  # fmt: skip


@pytest.mark.parametrize("size, seen", [(0.02, 2), (0.0199, 0)])
def test_a_fiftieth_of_a_channel_is_looked_into(monkeypatch, size, seen):
    monkeypatch.setattr(contradictions, "_beyond_noise", lambda gain, coherence: size)
    table = alignment(x1={"gain": 1.5})
    assert len(suspects(monkeypatch, table, table, table)) == seen


@pytest.mark.parametrize("gains, seen", [((0.8, 1.0), 2), ((1.0, 1.2), 2), ((0.8, 1.2), 0), ((1.0, 1.0), 2)])
def test_a_half_that_shows_nothing_denies_nothing(monkeypatch, gains, seen):
    tables = [alignment(x1={"gain": g}) for g in (1.5, *gains)]
    assert len(suspects(monkeypatch, *tables)) == seen
    tables = [alignment(x1={"delay": g - 1.0}) for g in (1.5, *gains)]
    assert len(suspects(monkeypatch, *tables)) == seen


# -- detection --------------------------------------------------------------------------------------


def place(level=0.05, min_share=0.02, **more):
    """A place of tests without data."""
    one = detection._Place.__new__(detection._Place)
    one.where, one.level, one.min_share, one.rows, one.curves, one.steps = "dof 1", level, min_share, [], {}, [0.5]
    for name, value in more.items():
        setattr(one, name, value)
    return one


@pytest.mark.parametrize(
    "rms, tests_say, verdict",
    [
        (LOUD, NOISE, NOISE), (BELOW_FLOOR, NONLINEAR, NONLINEAR), (AT_FLOOR, UNMEASURED, UNMEASURED),
        (ROUND_OFF, NONLINEAR, NOISE), (LOUD * 1.01, NOISE, LINEAR),
    ],
)  # fmt: skip
def test_verdicts_exactly_at_the_thresholds(monkeypatch, rms, tests_say, verdict):
    found = residual(300, n_dof=1)
    found.sizes["rms"], found.sizes["reference"] = [np.nan, rms], 1.0  # a balance that is not known does not end it
    asked = []
    fake = SimpleNamespace(loudest=1.0, rows=[], curves={}, judge=lambda: {"verdict": tests_say})
    fake.likeliest = lambda verdict: LINEAR
    monkeypatch.setattr(detection, "_Place", lambda *a: asked.append(a) or fake)
    floor = NoiseFloor.given(1.0 if rms > 0.1 else 0.0, 1)
    told = detect(found, floor)
    assert told.verdicts["verdict"].to_dict() == {"storey 1": verdict} and told.level == 0.05
    # a false alarm in twenty, lags of its own, a fiftieth of the variance; as many views as draws and one
    assert [(a[0], len(a[1]), *a[2:]) for a in asked] == ([("storey 1", 1, 0.05, None, 0.02)] if rms > 0.1 else [])
    if rms > 0.1:
        detect(found, replace(floor, draws=[(found, found.data)] * 2), level=0.1, lags=7, min_share=0.3)
        assert [(a[0], len(a[1]), *a[2:]) for a in asked[1:]] == [("storey 1", 3, 0.1, 7, 0.3)]
    with pytest.raises(NRFError, match="not a residual"):
        detect(found.data)


@pytest.mark.parametrize("worth, taps", [(30.0, 1), (1e5, 4), (3.0, 0)])
def test_a_record_without_forces_has_a_basis_of_its_motion(worth, taps):
    found = residual(900, forced=False)
    columns, pad = detection._View(found, found.data).basis([0], 7, worth, 1)
    assert pad == 7 * taps and columns.shape == (900 - 2 * pad, 5)


def test_the_shortest_record_bounds_the_shifts_and_every_record_is_thinned():
    found = residual(lengths=[900, 200])
    view = detection._View(found, found.data)
    columns, pad = view.basis([0, 1], 7, 1e6, 3)
    assert pad == 7 * 2 and len(columns) == len(range(0, 900 - 28, 3)) + len(range(0, 200 - 28, 3))
    assert view.basis([0, 1], 7, 1.0, 1)[0] is columns  # made once
    assert view.basis([0], 7, 1e6, 3)[1] == 7 * 4 and view.basis([1], 7, 1e6, 3)[1] == 7 * 2


def test_a_channel_must_be_there_in_every_record():
    base = noise(300, 3)
    one = residual(300, 1, covariates={"T": noise(300), "U": noise(300)}, base_acceleration=base).data.segments[0]
    two = residual(200, 1, covariates={"T": noise(200, 1)}).data.segments[0]

    def names(*segments):
        return [name for name, _ in detection._inputs(list(segments))]

    assert names(one) == ["F1", "ag", "T", "U"] and names(one, two) == names(two, one) == ["F1", "T"]
    assert names(one, one) == names(one)
    two.F[:] = 0.0
    assert names(two, one)[0] == "F1" and names(two) == ["T"]
    parts = dict(detection._inputs([one, two]))["T"]
    assert [len(p) for p in parts] == [300, 200] and parts[1] == pytest.approx(noise(200, 1))


def cross(*total, spread=1.0, energy=10.0):
    return [Cross(np.arange(-1, 2), np.array(total, dtype=float), spread, energy, 1.0)]


def test_a_family_of_one_test_keeps_its_probability_and_an_empty_one_is_noise():
    one = place(draws=0, _crosses=lambda kind, name: cross(0.5, -4.5, 1.0))
    p, strong = one._family([("phi_xe", "xe", "F1")])
    assert p == one.rows[0]["p"] == pytest.approx(probability_of_peak(4.5, 3, 1.0))
    assert one.rows[0]["band"] == pytest.approx(peak_limit(0.05 / 3, 3, 1.0) / 10) and strong == pytest.approx(0.2025)
    assert one._family([]) == (1.0, 0.0)
    low = place(draws=0, _crosses=lambda kind, name: cross(0.1, 0.3, 0.2))
    assert low._family([("phi_xe", "xe", name) for name in "abc"]) == (1.0, 0.0)


def test_without_a_time_step_lags_are_samples_and_a_correlation_is_one_at_most():
    one = place(draws=0, steps=[None], _crosses=lambda kind, name: cross(0.5, 1.0, -12.0))
    assert one._family([("phi_xe", "xe", "F1")])[1] == 1.0
    assert one.rows[0]["lag"] == 1.0 and one.rows[0]["peak"] == -1.0
    assert one.curves["dof 1", "phi_xe", "F1"][0].tolist() == [-1, 0, 1]
    other = place(draws=0, _crosses=lambda kind, name: cross(0.5, 1.0, 12.0))
    assert other._family([("phi_xe", "xe", "F1")])[1] == 1.0


@pytest.mark.parametrize("phi, share", [(0.9, 1.0), (-0.9, 1.0), (0.0, 0.0)])
def test_whiteness_is_clipped_to_what_a_correlation_can_be(monkeypatch, phi, share):
    monkeypatch.setattr(detection, "_reference", lambda side, noise: None)
    monkeypatch.setattr(detection, "_fit", lambda density, parts: None)
    monkeypatch.setattr(
        detection, "whitened_autocorrelation", lambda whole, density, lags: (np.full(lags, whole[0]), 400)
    )
    sides = [SimpleNamespace(whole=[phi]), SimpleNamespace(whole=[-phi])]
    one = place(sides=sides, draws=1)
    p, found = one._whiteness()
    assert found == share and one.curves["dof 1", "phi_ee", "e"][1] == pytest.approx(np.full(20, np.sign(phi)))
    assert p == pytest.approx(0.0 if phi else 1.0, abs=1e-9) and one.rows[0]["outside"] == (phi != 0)
    alone = place(sides=sides[:1], draws=0)._whiteness()
    assert alone == (pytest.approx(0.0 if phi else 1.0, abs=1e-9), share)


def test_excess_of_nothing_is_measured_in_newtons():
    sides = [SimpleNamespace(linear_share=s, size=z) for s, z in ((0.0, 0.0), (0.5, 4.0))]
    assert place(sides=sides)._excess() == -2.0


@pytest.mark.parametrize("family", range(3))
def test_a_family_exactly_at_its_third_of_the_level_is_noise(family):
    ps, side = [1.0] * 3, SimpleNamespace(raw={"F1": 0, "s": 0}, linear_share=0.3)
    for p, found in ((0.25, NOISE), (0.2499, (UNMEASURED, LINEAR, NONLINEAR)[family])):
        ps[family] = p
        one = place(0.75, 0.1, sides=[side], _whiteness=lambda: (ps[0], 0.5), _excess=lambda: 0.5)
        one._family = lambda tests: (ps[1], 0.5) if len(tests) == 2 else (ps[2], 0.5)
        assert one.judge()["verdict"] == found


@pytest.mark.parametrize("size", [0.8, 0.3])
def test_a_tone_is_worth_two_samples_for_every_column(size):
    """Two tones have four degrees of freedom; so many columns as half of what it is worth explain half of anything."""
    n = 4000
    found = residual(n, 1, seed=3)
    tones = [np.sqrt(2) * np.cos(2 * np.pi * k / n * np.arange(n)) for k in (190, 310)]
    found.data.segments[0].s[:, 0] = tones[0]
    e = np.sqrt(size) * tones[0] + np.sqrt(1 - size) * tones[1]
    found = found.with_balance([e[:, None]])
    one = detection._Side(detection._View(found, found.data), "dof 1", 5, 1)
    assert one._basis.shape == (n, 4) and n * one.bandwidth < 8  # a constant, drift, rate and force
    explained = 1 - one.rest[0] @ one.rest[0] / one.size
    assert explained == pytest.approx(size, abs=0.01)
    assert one.linear_share == pytest.approx(max((explained - 0.5) / 0.5, 0.0))


def test_a_residual_of_nothing_and_a_signal_that_rests_are_not_divided_by():
    found = residual(300, 1).with_balance([np.zeros((300, 1))])
    with np.errstate(all="raise"):
        one = detection._Side(detection._View(found, found.data), "dof 1", 5, 1)
        assert one.linear_share == 0.0 and one.size == 0.0
        one.raw["still"] = [np.zeros(300)]
        got = one.cross("x2e", "still", 5)
    assert got.spread == 0.0 and not got.moves and not got.total.any()


def test_the_reference_spectrum_is_welchs_of_pieces_of_512():
    whole = noise(2048)
    density = detection._reference(SimpleNamespace(whole=[np.zeros(512)]), [SimpleNamespace(whole=[whole])])
    assert density[0] == pytest.approx(welch(whole, nperseg=512)[1]) and len(density[0]) == 257
    assert detection._response(SimpleNamespace(sos=None), 0.01, 7).tolist() == [1.0] * 4
    assert detection._as_normal(1e300, 9.0) == 37.0


def test_the_sentence_names_a_test_of_the_kind_of_the_verdict():
    names = ["where", "test", "signal", "peak", "lag", "band", "p", "outside"]
    every = [
        ("phi_ee", "e", 0.4, 0, 0.1, 1e-3, True), ("phi_xe", "F1", 0.25, 0, 0.1, 1e-6, True),
        ("phi_x2e", "s", 0.75, 0, 0.1, 1e-9, True),
    ]  # fmt: skip
    tests = pd.DataFrame([(f"dof {j}", *row) for j in (1, 2, 3) for row in every], columns=names)
    table = pd.DataFrame({"verdict": [UNMEASURED, LINEAR, NONLINEAR], "floor ratio": np.nan}, index=tests["where"][::3])
    assert Detection(table, tests, 0.05).sentence == (
        f"dof 1: {UNMEASURED} (phi_ee, e: 0.40, band 0.10); dof 2: {LINEAR} (phi_xe, F1: 0.25, band 0.10); "
        f"dof 3: {NONLINEAR} (phi_x2e, s: 0.75, band 0.10)."
    )


# -- evidence ---------------------------------------------------------------------------------------


def test_what_is_not_noise_is_listed_by_kind_and_place():
    kinds = [UNMEASURED, NONLINEAR, NOISE, LINEAR, NONLINEAR, NONLINEAR]
    where = ["dof 1", "dof 2", "dof 3", "storey 1", "storey 2", "dof 4"]
    table = pd.DataFrame({"verdict": kinds, "floor ratio": [1.0, 2.345, np.nan, 0.5, 1.5, 1.0]}, index=where)
    tests = pd.DataFrame(columns=["where", "test", "signal", "peak", "band", "outside"])
    seen = Evidence("x", detection=SimpleNamespace(verdicts=table, tests=tests, is_noise=False))
    assert seen.strongest is None and seen.detection_sentence == (
        f"The residual is not noise: {UNMEASURED} in the balance of DOF 1; {NONLINEAR} in the balance of DOF 2, 4 and "
        f"storey 2; {LINEAR} in storey 1 (at most 2.3 times the noise floor)."
    )
    seen.detection.is_noise = True
    assert seen.detection_sentence.endswith("in any balance (at most 2.3 times the noise floor).")
    assert evidence._name("storey 2") == "storey 2" and Evidence("x").strongest is None


@pytest.mark.parametrize("strongest", ["phi_e(ex)", "phi_xe", "phi_|x||e|", "phi_x2e"])
def test_any_test_of_a_signal_may_be_the_strongest(strongest):
    rows = [(name, 0.6 if name == strongest else -0.5, 0.1, True) for name in ("phi_e(ex)", "phi_x2e", "phi_|x||e|")]
    rows += [("phi_ee", 0.9, 0.1, True), ("phi_xe", -0.6 if strongest == "phi_xe" else 0.5, 0.1, True)]
    tests = pd.DataFrame(rows, columns=["test", "peak", "band", "outside"])
    assert Evidence("x", detection=SimpleNamespace(tests=tests)).strongest["test"] == strongest


def located(shares, verdict="explains much", **more):
    names = ["storey 2", "storey 3", "dof 1", "ground 2"][: len(shares)]
    table = pd.DataFrame({"share": shares, "high": shares, "low": shares, "verdict": verdict}, index=names)
    table["balances"] = ["a", "b", "c", "d"][: len(shares)]
    options = {"site": "storey 2", "chosen": "storey 3"} | more
    return Evidence("x", localisation=table, **options)


def test_where_it_acts_in_words():
    one = located([90.0, 50.0], chosen="")
    assert one.localisation_sentence == "The signs across the balances point to storey 2: explains much."
    assert one.agreement == located([np.nan, np.nan]).agreement == Evidence("x", chosen="dof 1").agreement == ""
    floor = located([90.0, 50.0], "all leave what the noise floor leaves", chosen="")
    assert floor.localisation_sentence == "All leave what the noise floor leaves."
    same = located([90.0, 90.0, np.nan], "one balance: the signs say nothing")
    chosen = "The loop chose storey 3 by the error after refitting."
    assert same.localisation_sentence == f"One balance: the signs say nothing. {chosen}"
    assert located([90.0, 50.0], chosen="storey 2").agreement == "The loop chose the same site, storey 2."
    judge_not = "The loop chose {}, which localisation cannot judge."
    assert located([90.0, 50.0], chosen="dof 3").agreement == judge_not.format("dof 3")
    assert located([90.0, np.nan, 50.0]).agreement == judge_not.format("storey 3")
    alike = located([90.0, 89.0, 50.0])
    alike.localisation["balances"] = "a"
    assert alike.agreement == "The loop chose storey 3, which has the same pattern of signs."
    assert "number 3." in located([90.0, 80.0, 70.0, 60.0], chosen="dof 1").agreement
    assert "number 2." in located([90.0, 90.0, 70.0, 60.0], chosen="dof 1").agreement  # two sites of one pattern
    assert "(85 %) first, and storey 2 in" in located([90.0, 85.4], later=("dof 1", "storey 2")).agreement


@pytest.mark.parametrize("share, high, near", [(85.0, 0.0, False), (85.1, 0.0, True), (50.0, 90.0, False)])
def test_what_is_five_points_less_or_only_touches_the_band_is_told(share, high, near):
    one = located([90.0, share])
    one.localisation.loc["storey 3", "high"] = high
    assert ("hardly tells" in one.agreement) == near and ("disagrees" in one.agreement) != near


def test_what_it_is_like_and_what_no_chain_explains_in_words():
    one = Evidence("x", site="storey 2", characterisation=SimpleNamespace(sentence="Depends on v. So."))
    assert one.characterisation_sentence == "The force missing at storey 2 depends on v. So."
    assert one.coupling_sentence == ""
    one.couplings = [Coupling(1, 5.0, 0.1, 0.0, 0.0), Coupling(2, 5.0, 0.1, 0.0, 0.0)]
    assert one.coupling_sentence == f"Not explained by a chain law: {one.couplings[0]}; {one.couplings[1]}"
    silent = "is not possible because nothing was tried."
    assert str(Evidence("x")).split("\n") == [
        f"{room} {silent}" for room in ("Detection", "Localisation", "Characterisation")
    ]
    why = Evidence("x", not_possible={"localisation": "it is dark."}).localisation_sentence
    assert why == "Localisation is not possible because it is dark."


class Rooms:
    """The rooms as they would be entered, each with an answer or an error of its own."""

    def __init__(self, patch, **answers):
        table = pd.DataFrame({"share": [9.0], "verdict": ["much"]}, index=["storey 2"])
        self.given = {
            "searched_residual": SimpleNamespace(sizes="sizes"), "_floor": NoiseFloor(np.ones(2), np.ones(2), "s", [1]),
            "detect": SimpleNamespace(is_noise=False), "localise": table, "_characterised": "like", "couplings": ["c"],
        } | answers  # fmt: skip
        self.entered = []
        for name in self.given:
            patch.setattr(evidence, name, lambda *a, name=name, **k: self.enter(name, a, k))

    def enter(self, name, arguments, options):
        self.entered.append((name, arguments, options))
        answer = self.given[name]
        if isinstance(answer, Exception):
            raise answer
        return answer


def looked(patch, noise=(), chosen="", floor=None, **answers):
    rooms = Rooms(patch, **answers)
    return evidence.look(SimpleNamespace(known_masses={1: 2.0}), "model", "m", noise, chosen, floor), rooms


def test_the_rooms_are_entered_one_by_one(monkeypatch):
    found, rooms = looked(monkeypatch, ["surrogate"])
    assert [name for name, *_ in rooms.entered] == [
        "searched_residual", "_floor", "detect", "localise", "_characterised", "couplings"
    ]  # fmt: skip
    assert (found.model, found.sizes, found.site, found.characterisation) == ("m", "sizes", "storey 2", "like")
    assert found.couplings == ["c"] and found.floor.draws == [] and found.not_possible == {}
    given = NoiseFloor(np.ones(2), np.ones(2), "given", [2])
    found, rooms = looked(monkeypatch, ["surrogate"], floor=given)
    assert "_floor" not in [name for name, *_ in rooms.entered] and found.floor.source == "given" and given.draws == [2]
    assert rooms.entered[1][1][1] is given and rooms.entered[2][2] == {"floor": given, "known_masses": {1: 2.0}}
    found, rooms = looked(monkeypatch, ["surrogate"], chosen="storey 1")
    assert found.couplings == [] and found.floor is not None and found.chosen == "storey 1"
    found, rooms = looked(monkeypatch)
    assert found.floor is None and [name for name, *_ in rooms.entered][1:] == ["detect", "localise", "_characterised"]


def test_a_closed_room_says_why(monkeypatch):
    found, rooms = looked(monkeypatch, searched_residual=NRFError("it is dark", "make light"))
    assert set(found.not_possible) == {"residual", "detection", "localisation", "characterisation"}
    assert set(found.not_possible.values()) == {"it is dark"} and len(rooms.entered) == 1
    found, _ = looked(monkeypatch, localise=ValueError("no"))
    assert found.not_possible["characterisation"] == "the site is not known: ValueError: no" and found.site == ""
    found, _ = looked(monkeypatch, detect=SimpleNamespace(is_noise=True))
    assert found.not_possible["characterisation"] == "nothing but noise is left" and found.characterisation is None
    found, _ = looked(monkeypatch, detect=KeyError("k"))
    assert found.characterisation == "like" and found.not_possible == {"detection": "KeyError: 'k'"}
    table = pd.DataFrame({"share": [9.0], "verdict": ["at the noise floor"]}, index=["dof 1"])
    found, _ = looked(monkeypatch, localise=table)
    assert found.not_possible["characterisation"] == "the residual is at the noise floor" and found.site == "dof 1"
    found, _ = looked(monkeypatch, ["surrogate"], couplings=ZeroDivisionError("0"))
    assert found.couplings == [] and found.not_possible["coupling"] == "ZeroDivisionError: 0"
    found, _ = looked(monkeypatch, ["surrogate"], _floor=NRFError("no floor", ""))
    assert found.floor is None and found.not_possible == {"noise floor": "no floor"}
    with pytest.raises(TypeError):  # a fault of the program is not hidden
        looked(monkeypatch, detect=TypeError("t"))


def workspace(lengths=(300, 200), n_dof=2, blocks=None, first=0, seed=0, F=None):
    found = residual(n_dof=n_dof, lengths=list(lengths), seed=seed)
    for seg in found.data.segments:
        seg.valid = slice(first, len(seg.s))
        if F is not None:
            seg.F[:] = F(seg)
    blocks = blocks or [(0, 0, 100), (0, 100, 150), (0, 200, 250), (1, 5, 80)]
    search = [BlockRows(i, slice(a, b)) for i, a, b in blocks]
    return Workspace(found.data, [None] * len(lengths), search, [], {}, "auto")


def test_a_part_of_exactly_a_quarter_of_the_longest_is_looked_at():
    for stop, kept in ((237, 3), (236, 2)):
        work = workspace(blocks=[(0, 0, 100), (0, 100, 148), (0, 200, stop), (1, 5, 80)])
        data, filters = evidence.searched(work)
        assert len(data.segments) == len(filters) == kept and data.segments[0].valid == slice(0, 148)
    few, _ = evidence.searched(workspace(), 55)  # a fifth of 275
    assert [s.valid for s in few.segments] == [slice(0, 30), slice(200, 210), slice(5, 20)]


def test_a_law_that_remembers_follows_the_record_from_its_start():
    work = workspace(first=4)
    slider = laws.Jenkins(uy=0.8, Fy=2.0)
    held = {2: [laws.LinearElastic(1.0)]}
    found = evidence.searched_residual(work, ChainModel([1.0, 1.0], {1: [slider], **held}))
    assert [s.valid for s in found.data.segments] == [slice(4, 154), slice(204, 254), slice(9, 84)]
    plain = evidence.searched_residual(work, ChainModel([1.0, 1.0], held))
    for part, other, seg, k in zip(found.balance, plain.balance, found.data.segments, (0, 0, 1)):
        record = work.data.segments[k]
        force = slider.force(record.motion(Site(1), record.valid))[seg.valid.start - 4 : seg.valid.stop - 4]
        assert other[:, 0] - part[:, 0] == pytest.approx(force) and part[:, 1] == pytest.approx(other[:, 1])


def test_the_floor_of_surrogates_is_made_of_their_residuals(monkeypatch):
    monkeypatch.setattr(evidence, "searched_residual", lambda work, model: residual(50, seed=work + model))
    stages = [SimpleNamespace(work=k, trial=lambda: SimpleNamespace(model=lambda: 10)) for k in (1, 2)]
    floor = evidence._floor(stages)
    assert len(floor.draws) == 2 and floor.draws[1][0].data is floor.draws[1][1]
    every = np.concatenate([residual(50, seed=10 + k).balance[0] for k in (1, 2)])
    assert floor.balance == pytest.approx(np.sqrt((every**2).mean(axis=0)))


@pytest.mark.parametrize(
    "site, seen, late",
    [
        ("storey 2", "storey 2", ["F1", "F2"]), ("storey 1", "storey 1", ["F1"]), ("dof 2", "dof 2", ["F2"]),
        ("link 3-1", "link 3-1", ["F1"]), ("sensor a2", "dof 2", ["F2"]), ("dof 3", "dof 3", []),
    ],
)  # fmt: skip
def test_the_forces_beside_a_site_may_be_late(monkeypatch, site, seen, late):
    """Of three floors, the third with a force that is nowhere known."""
    found = residual(300, 3)
    seg = found.data.segments[0]
    seg.F[:, 2] = np.nan
    asked = {}

    def missing(residual, place, **options):
        asked.update(options, place=str(place))
        return ["force"], [np.zeros((300, asked["width"]))]

    monkeypatch.setattr(evidence, "missing_force", missing)
    monkeypatch.setattr(evidence, "characterise", lambda force, motions, **more: (force, motions, more))
    floor = NoiseFloor(np.array([1.0, 2.0, 3.0]), np.array([4.0, np.nan, 6.0]), "given")
    for width in (0, 2):
        asked["width"] = width
        force, motions, more = evidence._characterised(found, site, {"floor": floor, "known_masses": {1: 2.0}})
        assert force == ["force"] and asked["place"] == site and asked["known_masses"] == {1: 2.0}
        assert motions[0].s == pytest.approx(seg.motion(Site(seen), seg.valid).s)
        assert (more["beside"] is None) == (width == 0) and more["filters"] == found.filters
        assert sorted(more["channels"]) == late
        for name, (line,) in more["channels"].items():
            assert line == pytest.approx(seg.F[:, int(name[1]) - 1])
    levels = {"storey 2": None, "storey 1": 4.0, "dof 2": 2.0, "link 3-1": 3.0, "sensor a2": 2.0, "dof 3": 3.0}
    assert more["noise"] == levels[site]
    assert evidence._characterised(found, site, {"floor": None})[2]["noise"] is None


# -- floors and free runs ---------------------------------------------------------------------------


def test_a_floor_is_known_by_its_name(monkeypatch):
    for name, measured, words in (
        ("channels", False, "surrogates with the noise of the channels"), ("repeats", True, "repeated records"),
    ):  # fmt: skip
        source = FloorSource(fresh(name), 2)
        assert (source.measured, source.words, source.known) == (measured, words, None)
    for wrong in ("abc", "channel", "d", "repeat", "s", "zzz", "", True, None, NoiseFloor.given(1.0, 1)):
        with pytest.raises(ChannelError):
            FloorSource(wrong, 2)
    known = NoiseFloor.given([1.0, 2.0], 2)
    for given in (known, 3, 3.0, [1.0, 2.0], (1.0, 2.0), np.ones(2), {1: 2.0}):
        source = FloorSource(given, 2)
        assert source.measured and source.known is not None and source.words == source.known.source
    trial = SimpleNamespace(work="work", model=lambda: "model")
    monkeypatch.setattr(floor_source, "repeated", lambda work, model: (work, model))
    monkeypatch.setattr(NoiseFloor, "from_repeats", lambda residual: residual)
    assert FloorSource("repeats", 2).of(trial) == ("work", "model") and FloorSource(known, 2).of(trial) is known
    assert FloorSource("channels", 2).of(trial) is None


def test_the_loop_is_closed_where_a_fall_by_the_least_gain_would_just_reach_the_floor(monkeypatch):
    monkeypatch.setattr(FloorSource, "percent", lambda self, trial, null: 10.0 * (1.0 - 0.15))
    assert FloorSource(1.0, 2).closes(None, 10.0, None) and not FloorSource(1.0, 2).closes(None, 10.001, None)


def test_a_balance_of_unknown_force_is_not_pooled(monkeypatch):
    sizes = {1: None, 2: Sizes(9.0, 5.0, 8.0, "F", 300)}
    monkeypatch.setattr(floor_source, "balance_sizes", lambda j, *a: sizes[j])
    asked = []
    trial = SimpleNamespace(
        work=SimpleNamespace(search=[0, 0, 0], n_dof=2),
        solve=lambda b: asked.append(list(b)) or SimpleNamespace(masses=0, coefficients=0),
        moments=lambda b: SimpleNamespace(parts={}),
    )
    assert FloorSource([3.0, 4.0], 2).percent(trial, None) == pytest.approx(100 * 4 / 5) and asked == [[0, 1, 2]]


def test_repeated_records_are_cut_from_their_first_valid_row():
    model = ChainModel([1.0], {1: [laws.LinearElastic(1.0)]})
    found = residual(n_dof=1, lengths=[200, 190])
    for seg in found.data.segments:
        seg.F[:] = found.data.segments[0].F[:190].mean()
        seg.valid = slice(6, len(seg.s))
    search = [BlockRows(0, slice(4, 100)), BlockRows(1, slice(0, 90)), BlockRows(1, slice(120, 180))]
    work = Workspace(found.data, [None] * 2, search, [], {}, "auto")
    cut = floor_source.repeated(work, model)
    assert [s.valid for s in cut.data.segments] == [slice(10, 96)] * 2  # rows 4 to 90 from the sixth on
    for part, seg in zip(cut.balance, found.data.segments):
        wanted = seg.F[10:96] - seg.a[10:96] - seg.s[10:96]
        assert part == pytest.approx(wanted) or part == pytest.approx(-wanted)
    apart = [BlockRows(0, slice(0, 90)), BlockRows(1, slice(95, 180))]
    with pytest.raises(ChannelError, match="2 records with 0 rows in common"):
        floor_source.repeated(Workspace(found.data, [None] * 2, apart, [], {}, "auto"), model)


def free_runs(monkeypatch, masses=(1.0, 2.0), run=None, n=40, first=3, filters=(None,), rows=(5, 20)):
    """Error of free runs that are given as a factor of the measured motion."""
    found = residual(n)
    (seg,) = found.data.segments
    seg.valid = slice(first, n)
    x, asked = np.cumsum(seg.s, axis=1), []

    def alone(model, segment, chosen, dt):
        asked.append((chosen, dt))
        if run is None:
            raise NRFError("x", "y")
        return SimpleNamespace(displacement=run * x[chosen])

    monkeypatch.setattr(free_run, "free_run_of", alone)
    model = SimpleNamespace(masses=np.array(masses), n_dof=2)
    work = SimpleNamespace(data=found.data, filters=list(filters))
    return free_run.free_run_error(model, work, [BlockRows(0, slice(*rows))]), asked, seg


def test_free_runs_are_compared_on_the_rows_of_their_blocks(monkeypatch):
    error, asked, seg = free_runs(monkeypatch, run=np.array([1.3, 0.6]))
    assert error == pytest.approx(100 * np.sqrt((0.3**2 + 0.4**2) / 2))
    assert asked == [(slice(8, 23), pytest.approx(0.01))]

    class First:
        def apply(self, y):
            return y * [5.0, 1.0]

    assert free_runs(monkeypatch, run=1.3, filters=[First()])[0] == pytest.approx(30.0)
    parts = free_run.squares_of(SimpleNamespace(displacement=np.zeros((15, 2))), seg, slice(8, 23), First())
    x = np.cumsum(seg.s[8:23], axis=1)
    assert parts[0] == pytest.approx((x**2).sum(axis=0) * [25, 1]) and parts[1] == pytest.approx(parts[0])


def test_no_free_run_is_told_where_there_is_none(monkeypatch):
    for masses in ((1.0, 0.0), (-1.0, 2.0)):
        assert np.isnan(free_runs(monkeypatch, masses, 1.3)[0])
    assert np.isnan(free_runs(monkeypatch)[0])  # it diverges
    assert np.isfinite(free_runs(monkeypatch, run=1.3, rows=(5, 13))[0])
    error, asked, _ = free_runs(monkeypatch, run=1.3, rows=(5, 12))
    assert np.isnan(error) and asked == []
    found = residual(40)
    work = SimpleNamespace(data=found.data, filters=[None])
    model, rows = SimpleNamespace(masses=np.ones(2), n_dof=2), [BlockRows(0, slice(0, 20))]
    monkeypatch.setattr(free_run, "free_run_of", lambda *a: SimpleNamespace(displacement=np.ones((20, 2))))
    assert np.isfinite(free_run.free_run_error(model, work, rows))
    found.data.segments[0].s[:, 0] = 0.0  # nothing moves: nothing to divide by
    with np.errstate(divide="ignore"):
        assert np.isnan(free_run.free_run_error(model, work, rows))
    found.data.segments[0].F[0, 1] = np.nan
    assert np.isnan(free_run.free_run_error(model, work, rows))
    timeless = residual(40).data
    timeless.segments[0].t = None
    assert np.isnan(free_run.free_run_error(model, SimpleNamespace(data=timeless, filters=[None]), rows))


def test_a_free_run_starts_from_the_state_in_its_first_row():
    asked = {}

    def simulate(force, dt, **more):
        asked.update(more, force=force, dt=dt)
        return "run"

    model = SimpleNamespace(simulate=simulate)
    (seg,) = residual(40, covariates={"T": noise(40, 5)}, base_acceleration=noise(40, 6)).data.segments
    assert free_run.free_run_of(model, seg, slice(7, 30), 0.5) == "run"
    assert asked["x0"] == pytest.approx(np.cumsum(seg.s[7])) and asked["v0"] == pytest.approx(np.cumsum(seg.v[7]))
    assert asked["t0"] == pytest.approx(0.07) and asked["dt"] == 0.5
    assert asked["force"] == pytest.approx(seg.F[7:30])
    assert asked["base_acceleration"] == pytest.approx(noise(40, 6)[7:30])
    assert asked["covariates"]["T"] == pytest.approx(noise(40, 5)[7:30])
    (plain,) = residual(40).data.segments
    free_run.free_run_of(model, plain, slice(7, 30), 0.5)
    assert asked["base_acceleration"] is None and asked["covariates"] is None


# -- intervals --------------------------------------------------------------------------------------


def shaped(n_blocks=5, law=None, seed=0, step=None):
    """One mass with a spring and a damper of a power of the rate, in blocks of noise."""
    ends = [int(e) for e in np.linspace(0, 400, n_blocks + 1)]
    rng = np.random.default_rng(9)

    def force(seg):
        v = seg.v[:, 0]
        return (3.0 * seg.a[:, 0] + 50.0 * seg.s[:, 0] + 2.0 * np.sign(v) * np.abs(v) ** 0.7)[:, None] + (
            0.1 * rng.standard_normal((400, 1))
        )

    blocks = [(0, a, b) for a, b in zip(ends, ends[1:])]
    work = workspace([400], 1, blocks, seed=seed, F=force)
    site, law = Site("storey 1"), law or laws.PowerLawDamping(n=0.6)
    return Stage(work, Chain(1), {site: (laws.LinearElastic(), law)}), (site, 1), blocks


def test_coefficients_and_shapes_are_estimated_together_with_each_block_left_out():
    """d/dn sgn(v) |v|^n = sgn(v) |v|^n ln|v|, in the coordinate of the search; one balance: plain least squares."""
    stage, place_, blocks = shaped()
    law = laws.PowerLawDamping()
    axes = intervals.Axes(law, stage.work, place_[0])
    centre = axes.point(stage.laws[place_[0]][1])
    best, folds = intervals._linearised(stage, place_, axes, centre, np.array([2.0]))
    (seg,) = stage.work.data.segments
    v = seg.v[:, 0]
    power = np.sign(v) * np.abs(v) ** 0.6
    slope = 2.0 * power * np.log(np.abs(v)) * (0.6 if axes.log[0] else 1.0)
    A = np.column_stack([power, slope, seg.s[:, 0], seg.a[:, 0]])

    def solved(rows):
        return np.linalg.lstsq(A[rows], seg.F[rows, 0], rcond=None)[0][:2]

    assert best == pytest.approx(solved(np.arange(400)), rel=1e-4)
    for (_, a, b), fold in zip(blocks, folds, strict=True):
        assert fold == pytest.approx(solved(np.delete(np.arange(400), np.arange(a, b))), rel=1e-3)
    plain = intervals._linearised(stage, place_, axes, np.zeros(0), np.array([2.0]))
    assert plain[0] == pytest.approx(np.linalg.lstsq(A[:, [0, 2, 3]], seg.F[:, 0], rcond=None)[0][:1], rel=1e-4)


@pytest.mark.parametrize("n_blocks, told", [(2, False), (3, True)])
def test_three_blocks_at_least_tell_a_spread(n_blocks, told):
    stage, place_, _ = shaped(n_blocks)
    axes = intervals.Axes(stage.laws[place_[0]][1], stage.work, place_[0])
    if told:
        assert intervals._linearised(stage, place_, axes, np.zeros(0), np.array([2.0]))[1].shape == (3, 1)
    else:
        with pytest.raises(NRFError, match="cannot be told apart"):
            intervals._linearised(stage, place_, axes, np.zeros(0), np.array([2.0]))


def test_the_one_block_that_shows_a_change_in_time_is_not_left_out():
    stage, place_, _ = shaped(5, laws.StiffnessStep(t0=3.3))
    axes = intervals.Axes(stage.laws[place_[0]][1], stage.work, place_[0])
    _, folds = intervals._linearised(stage, place_, axes, np.zeros(0), np.array([2.0]))
    assert folds.shape == (4, 1) and np.isfinite(folds).all()


def judged_parameters(monkeypatch, law, theta, widths, profile=None, nulls=(), origin=None):
    """Intervals of a law at storey 1 with given drifts and half widths, and a given profile."""
    site, given = Site("storey 1"), iter(widths)
    work = SimpleNamespace(scales=lambda s: (0.02, 0.3, 40.0), fastest=50.0)
    asked = []

    def take(*a):
        asked.append((len(a[3]), a[5].tolist()))
        one = next(given)
        if one is None:
            raise NRFError("x", "y")
        return tuple(np.array(x, dtype=float) for x in one)

    monkeypatch.setattr(intervals, "_widths", take)
    monkeypatch.setattr(intervals, "_profile", lambda *a: dict(profile or {}))
    stage = SimpleNamespace(work=work, laws={site: (laws.LinearElastic(), law)})
    free = type(law)()
    return (*intervals.intervals(stage, (site, 1), free, np.array(theta), nulls, origin), asked)


def test_a_shape_has_an_interval_in_its_own_units_within_its_bounds(monkeypatch):
    law = laws.PowerLawDamping(n=0.6)
    axes = intervals.Axes(
        laws.PowerLawDamping(), SimpleNamespace(scales=lambda s: (1, 1, 1), fastest=1.0), Site("storey 1")
    )
    log = bool(axes.log[0])
    centre = np.log(0.6) if log else 0.6

    def shape(u):
        return np.exp(u) if log else u

    found, shares, asked = judged_parameters(monkeypatch, law, [10.0], [([0.5, -0.05], [1.0, 0.1])])
    assert found["cn"] == pytest.approx((8.5, 11.0)) and shares == {}
    assert found["n"] == pytest.approx((shape(centre - 0.1), shape(centre + 0.15))) and asked == [(1, [10.0, 0.0])]
    wide, _, _ = judged_parameters(monkeypatch, law, [10.0], [([0.0, 0.0], [0.0, 99.0])])
    assert wide["n"] == pytest.approx((0.15, 4.0)) and wide["cn"] == pytest.approx((9.999, 10.001))
    thin, _, _ = judged_parameters(monkeypatch, law, [10.0], [([0.0, 0.0], [0.0, 0.0])])
    assert thin["n"] == pytest.approx((shape(centre - 1e-4), shape(centre + 1e-4)), rel=1e-9)
    low, high = (shape(centre - 0.1), shape(centre + 0.1))
    both = ((0.5, 0.9), (min(0.5, low), 0.9)), ((0.59, 0.61), (low, high)), ((0.3, 0.61), (0.3, high))
    for profile, wanted in both:
        found, _, _ = judged_parameters(monkeypatch, law, [9.0], [([0, 0], [0, 0.1])], {"n": profile, "x": (1.0, 2.0)})
        assert found["n"] == pytest.approx(wanted) and set(found) == {"cn", "n"}


def test_what_noise_takes_from_a_coefficient_is_a_share_of_what_it_was(monkeypatch):
    law, widths = laws.LinkSpringDashpot(), [([0.5, 0.5], [1.0, 1.0])]
    origin = np.array([4.0, 0.0])  # of nothing there is no share
    shares = judged_parameters(monkeypatch, law, [5.0, 1.0], widths, nulls=["surrogate"], origin=origin)[1]
    assert list(shares.values()) == [0.125] and len(shares) == 1


def test_where_shapes_have_no_slope_the_profile_of_the_error_tells(monkeypatch):
    law, profile = laws.PowerLawDamping(n=0.6), {"n": (0.5, 0.7)}
    found, shares, asked = judged_parameters(
        monkeypatch, law, [10.0], [None, ([1.0], [2.0])], profile, ["surrogate"], np.array([20.0])
    )
    assert found == {"n": (0.5, 0.7), "cn": pytest.approx((7.0, 12.0))} and shares == {"cn": 0.05}
    assert asked == [(1, [20.0, 0.0]), (0, [20.0])]
    assert judged_parameters(monkeypatch, law, [10.0], [None, None], profile)[:2] == (profile, {})


def test_a_surrogate_that_cannot_be_solved_is_passed_over(monkeypatch):
    def linearised(stage, *a):
        if stage is None:
            raise NRFError("x", "y")
        return stage, np.arange(8.0).reshape(4, 2)

    monkeypatch.setattr(intervals, "_linearised", linearised)
    true = np.array([1.0, 2.0])
    nulls = [None, true + 1.0, None, true + 4.0]
    assert intervals._widths(true, None, None, None, None, true, nulls, 0.9)[0] == pytest.approx([2.5, 2.5])
    assert intervals._widths(true, None, None, None, None, true, [None], 0.9)[0].tolist() == [0.0, 0.0]


def test_a_profile_without_width_tells_nothing(monkeypatch):
    law, site, v = laws.PowerLawDamping(), Site("storey 1"), np.tile([1.0, 1.0, -1.0, -1.0], 10)
    work = SimpleNamespace(scales=lambda s: (0.02, 0.3, 40.0), fastest=50.0, search=[BlockRows(0, slice(0, 40))] * 3)
    work.motion = lambda s, i: Motion(v, v)
    stage = SimpleNamespace(work=work, chain=None, without=lambda places: asked.append(places) or {})
    axes, asked = intervals.Axes(law, work, site), []
    slot = SimpleNamespace(errors=lambda tried: [0.0])
    monkeypatch.setattr(intervals, "Stage", lambda *a: SimpleNamespace(slot=lambda s, law: slot))
    ends = [(0.0, 0.0)]
    monkeypatch.setattr(intervals, "plateau", lambda error, at, *e, slack: asked.append(slack) or ends[-1])
    assert intervals._profile(stage, (site, 1), law, axes, np.zeros(1), 0.9) == {}
    # nineteen turns in each of three blocks
    quantile = intervals.student.ppf(0.95, 57)
    assert asked == [[(site, 1)], pytest.approx(np.sqrt(1 + quantile**2 / 57) - 1)]
    ends.append((-0.1, 0.1))
    assert intervals._profile(stage, (site, 1), law, axes, np.zeros(1), 0.9) == {
        "n": pytest.approx(tuple(float(axes.values(np.array([u]))[0]) for u in ends[-1]))
    }


# -- what is left -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "site, where",
    [
        ("storey 1", "storey 1"), ("storey 2", "storey 2"), ("storey 3", "storey 3"), ("ground 3", "dof 3"),
        ("dof 1", "dof 1"), ("dof 3", "dof 3"), ("link 3-1", None), ("link 5-2", None), ("link 2-1", "storey 2"),
    ],
)  # fmt: skip
def test_a_site_is_seen_in_its_storey_or_in_the_balance_of_its_floor(site, where):
    assert leftover._where(Site(site)) == where


@pytest.mark.parametrize("error", [NRFError("x", "y"), np.linalg.LinAlgError("singular")])
def test_where_nothing_can_be_solved_nothing_is_left(monkeypatch, error):
    def refuse(*a):
        raise error

    monkeypatch.setattr(leftover, "_share", refuse)
    assert leftover.leftover("stage", ["noise"], [(Site("storey 1"), 0)]) == 0.0


def test_noise_counts_one_and_a_half_times(monkeypatch):
    shares = {"stage": 0.5, "quiet": 0.1, "loud": 0.2, "louder": 0.4}
    asked = []
    monkeypatch.setattr(leftover, "_share", lambda stage, *a: asked.append(a) or shares[stage])
    places = [(Site("ground 2"), 1)]
    assert leftover.leftover("stage", ["loud", "quiet"], places) == pytest.approx(np.sqrt(0.25 - 0.09))
    assert asked == [("dof 2", places)] * 3
    assert leftover.leftover("stage", ["louder"], places) == 0.0 and leftover.leftover("stage", [], places) == 0.5


def left_of(monkeypatch, force, given=None, coefficients=(7.0, 2.0), places=((0, 1),), n=2000):
    """The share of a cubic spring of 2 N/m^3, behind a linear one, that a force at storey 2 is."""
    site, m = Site("storey 2"), motion(n)
    seg = SimpleNamespace(valid="rows", motion=lambda s, valid: m if (s, valid) == (site, "rows") else None)
    residual = SimpleNamespace(
        at=lambda where: [force(m)] if where == "storey 2" else None,
        filters=[None],
        data=SimpleNamespace(segments=[seg]),
    )
    monkeypatch.setattr(leftover, "searched_residual", lambda work, model: residual if model == "model" else None)
    if given is not None:
        monkeypatch.setattr(leftover, "Judge", given)
    trial = SimpleNamespace(model=lambda: "model", layout=SimpleNamespace(slices={site: slice(4, 6)}))
    trial.solve = lambda blocks: (
        SimpleNamespace(coefficients={site: np.array(coefficients)}) if list(blocks) == [0, 1, 2] else None
    )
    stage = SimpleNamespace(trial=lambda: trial, work=SimpleNamespace(search=[0, 0, 0]))
    stage.at = {(site, 0): 4, (site, 1): 5}
    stage.laws = {site: (laws.LinearElastic(), laws.CubicStiffness())}
    return leftover._share(stage, "storey 2", [(site, number) for _, number in places]), m


def test_what_is_left_is_told_as_a_share_of_the_effect_beside_what_is_linear(monkeypatch):
    found, _ = left_of(monkeypatch, lambda m: 0.2 * m.s**3 + 3.0 * m.s - m.v + 5.0)
    assert found == pytest.approx(0.1, rel=0.02)
    found, _ = left_of(monkeypatch, lambda m: 0.2 * m.s**3, places=((0, 0), (0, 1)))  # a linear part is no part of it
    assert found == pytest.approx(0.1, rel=0.02)
    damped, m = left_of(monkeypatch, lambda m: 0.2 * m.v * np.abs(m.v))
    lines = np.column_stack([m.s, m.v])
    sizes = [y - lines @ np.linalg.lstsq(lines, y, rcond=None)[0] for y in (0.2 * m.v * np.abs(m.v), 2 * m.s**3)]
    assert damped == pytest.approx(np.std(sizes[0]) / np.std(sizes[1]), rel=0.05)
    assert left_of(monkeypatch, lambda m: 0.2 * m.s**3, coefficients=(7.0, 0.0))[0] == 0.0  # no effect: no share
    assert left_of(monkeypatch, lambda m: np.where(m.t < 1, np.nan, m.s))[0] == 0.0


@pytest.mark.parametrize(
    "shares, best",
    [
        ({"v": (0.3, 0.2), "s": (0.5, 0.51), "s and v": (0.1, 0.05)}, 0.3), ({"v": (0.4, 0.4)}, 0.0),
        ({"s": (0.41, 0.4)}, 0.41), ({"s and v": (0.2, 0.1), "v": (0.1, 0.01)}, 0.2), ({}, 0.0),
    ],
)  # fmt: skip
def test_a_function_must_explain_more_than_its_standard_error(monkeypatch, shares, best):
    class Given:
        def __init__(self, force, groups):
            self.groups = list(groups)

        def held_out(self, names):
            if self.groups == ["linear"] == list(names):
                return np.array([0.04, 0.05])
            assert tuple(names) == ("constant", "linear")
            return np.array([0.25, 0.24])

        def share(self, names, beside):
            assert tuple(beside) == ("constant", "linear")
            return shares.get(names[0], (0.0, 1.0))

    found, m = left_of(monkeypatch, lambda m: 0.5 * np.sign(m.v), Given)
    assert found == pytest.approx(0.5 * np.sqrt(0.49 * best) / (2 * np.sqrt(np.mean(m.s**6)) * 0.3))


# -- the likeliest ----------------------------------------------------------------------------------


def rivals_of(monkeypatch, chosen, ranking, distances=None, tied=(), before=50.0):
    """Which laws are simulated beside the chosen one, and what comes of it."""
    asked = []

    def distance(stage, true, rivals, seen, null_of):
        asked[:] = rivals
        return 1.0 if distances is None else distances[rivals.index(true)]

    monkeypatch.setattr(likeliest, "_error", lambda stage, f: f.error)
    monkeypatch.setattr(likeliest, "_distance", distance)
    found = likeliest.likeliest(None, chosen, list(tied), ranking, np.full(3, before), None)
    return asked, found


class Other(Finding):
    """A finding of another kind, such as a fault of a sensor."""


def test_rivals_stand_in_the_same_balance_are_no_special_cases_and_have_no_more_parameters(monkeypatch):
    chosen = finding(laws.CoulombFriction(), 1.0)
    other = finding(laws.CubicStiffness(), 0.9)
    other = Other(other.candidate, other.law, 0.9, (), other.folds)
    passed_over = [
        chosen,
        other,
        finding(laws.QuadraticDamping(), 0.91, "storey 2"),
        finding(laws.StribeckFriction(0.1), 0.92),  # holds the chosen one
        finding(laws.Dahl(10.0), 0.93),  # two parameters
    ]
    good = [finding(laws.ConstantForce(), 1.01, "dof 1"), finding(laws.QuadraticStiffness(), 1.2)]
    asked, _ = rivals_of(monkeypatch, chosen, [*passed_over, *good])
    assert asked == [chosen, *good]
    more = finding(laws.QuinticStiffness(), 1.1)  # three at most, the best first
    assert rivals_of(monkeypatch, chosen, [*passed_over, *good, more])[0] == [chosen, good[0], more]
    alone, found = rivals_of(monkeypatch, chosen, passed_over, tied=good)
    assert alone == [] and found == (chosen, good)
    near = [finding(law, e, folds=np.full(3, e)) for law, e in ((laws.CubicStiffness(), 1.01), (laws.Bilinear(), 1.02))]
    assert rivals_of(monkeypatch, chosen, near, before=1.19)[0] == [chosen, near[0]]  # 15 % are asked


def test_a_rival_is_measured_from_the_best_at_the_site(monkeypatch):
    chosen, best = finding(laws.CoulombFriction(), 1.2), finding(laws.StribeckFriction(0.1), 1.0)
    for error, rival in ((1.35, True), (1.351, False)):
        other = finding(laws.CubicStiffness(), error)
        assert bool(rivals_of(monkeypatch, chosen, [chosen, best, other])[0]) == rival
    far = finding(laws.StribeckFriction(0.1), 0.1, "storey 2")
    other = finding(laws.CubicStiffness(), 1.35 * 1.2 * 0.999)
    assert rivals_of(monkeypatch, chosen, [chosen, far, other])[0] == [chosen, other]


def test_of_those_that_fit_as_well_fewer_parameters_go_first_then_the_chosen_one(monkeypatch):
    chosen, few = finding(laws.Dahl(10.0), 1.0), finding(laws.CubicStiffness(), 1.1)
    many = finding(laws.TwoSidedGap(0.1), 1.05)
    ranking = [chosen, few, many]
    for distances, winner in (  # in the order of their errors: the chosen one, many, few
        ((1.0, 1.0, 1.0), few), ((1.0, 1.0, 1.5), chosen), ((1.0, 0.9, 1.3), chosen), ((1.0, 0.9, 1.28), few),
        ((2.0, 1.0, 2.0), many), ((1.0, 0.7, 9.0), chosen), ((0.72, 0.5, 9.0), many), ((0.71, 0.5, 9.0), chosen),
    ):  # fmt: skip
        assert rivals_of(monkeypatch, chosen, ranking, distances)[1][0] is winner
    tied = [finding(laws.QuadraticDamping(), 1.0), finding(laws.AddedMass(), 1.0)]
    found = rivals_of(monkeypatch, chosen, ranking, [9.0, 9.0, 1.0], tied)[1]
    assert found == (few, [chosen, tied[0]])  # two other families at most
    assert rivals_of(monkeypatch, chosen, ranking, [np.inf] * 3, tied)[1] == (chosen, tied)


def test_an_error_is_refined_a_little_where_a_law_has_shapes(monkeypatch):
    asked = []
    monkeypatch.setattr(likeliest, "refine", lambda *a: asked.append(a) or SimpleNamespace(screen=4.0))
    free = Finding(Candidate(laws.Jenkins(), Site("storey 1")), laws.Jenkins(0.1), 2.0, ((Site("storey 1"), 0),))
    assert likeliest._error("stage", free) == 4.0
    stage, start, count, reach = asked[0]
    assert (stage, start.law, start.screen, start.drop) == ("stage", free.law, np.inf, free.drop)
    assert (count, reach) == (30, 0.2)

    def slot(site, law, drop):
        return SimpleNamespace(errors=lambda tried: [len(tried) * 3.0, 9.0])

    assert likeliest._error(SimpleNamespace(slot=slot), finding(laws.CoulombFriction(), 1.0)) == 3.0


def test_a_law_that_cannot_be_simulated_is_infinitely_far():
    def refuse(stage):
        raise NRFError("x", "y")

    true = SimpleNamespace(on=lambda stage: stage)
    assert likeliest._distance(None, true, [], np.zeros(2), refuse) == np.inf
