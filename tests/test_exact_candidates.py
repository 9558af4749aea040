"""Exact numbers of candidates: what can be, what is tried, what passes the gate, which rival is the likeliest."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from types import SimpleNamespace

import numpy as np
import pytest
from hand_made_rooms import blocks, finding, fresh

from pysindy_nrf import Chain, Site, laws
from pysindy_nrf.discrepancy import (
    admissible,
    characterisation,
    contradictions,
    coupling,
    dependence,
    detection,
    evidence,
    floor_source,
    gate,
    intervals,
    leftover,
    likeliest,
)
from pysindy_nrf.discrepancy.catalogue import Candidate, as_laws, balances_of, candidates, default_catalogue
from pysindy_nrf.discrepancy.contradictions import Suspect
from pysindy_nrf.discrepancy.coupling import Coupling
from pysindy_nrf.discrepancy.gate import FLOOR, choose, judge
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.exceptions import LawError, NRFError
from pysindy_nrf.laws.sensor import ChannelDelay, GainError

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


NEW = ["ground 2", "ground 3", "ground 4", "link 3-1", "link 4-1"]


PLACES = {
    **dict.fromkeys(("covariate_friction", "lagged_covariate_friction"), LINKS + NEW[:3]),
    **dict.fromkeys(("maxwell_branch", "inerter", "degradation", "covariate_dahl"), LINKS),
    "link": NEW,
    "harmonic_force": DOFS, "base_motion": DOFS, "ground_friction": DOFS,
    "constant_force": DOFS + ["storey 2", "storey 3", "storey 4", "link 4-2"],
    "added_mass": ["dof 1", "dof 2", "dof 4"],
}  # fmt: skip


def test_every_law_is_tried_at_every_site_where_it_makes_sense():
    """A chain with a brace: dampers may stand on the storeys and the ground, new links where there is none yet."""
    every = default_catalogue(["T", "ag", "vg"])
    found = {}
    for c in candidates(every, Chain(4, links=["link 4-2"]), (4, 2, 1), ("T", "ag", "vg"), (4, 2)):
        found.setdefault(id(c.law), []).append(str(c.site))
    for law in every:
        wanted = [] if law.family == "sensor" else PLACES.get(law.name, PLACES.get(law.family, LINKS + NEW))
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
    assert places(laws.CubicStiffness()) == ["storey 2", "storey 3"]  # at new links beside a plain tie alone
    both = [laws.CubicStiffness(), laws.LinkSpringDashpot()]
    for forced, new in (((1,), ["storey 1", "ground 2", "ground 3", "link 3-1"]), ((), [])):
        every = [str(c.site) for c in candidates(both, free, (), (), forced) if c.law is both[0]]
        assert every == ["storey 2", "storey 3", *new]
    assert places(laws.StiffnessDrift()) == ["storey 2", "storey 3"]
    assert list(candidates([laws.LinkSpringDashpot()], Chain(1), (), (), (1,))) == []


@pytest.mark.parametrize("n_records, tried", [(0, True), (1, True), (2, False), (3, False)])
def test_what_cannot_stand_anywhere_does_not_end_the_list(n_records, tried):
    held = [ChannelDelay(), laws.CovariateFriction(covariate="T"), laws.StiffnessStep(), laws.ConstantForce()]
    found = {c.law.name for c in candidates(held, Chain(1), (), (), (1,), n_records)}
    assert found == {"constant_force", *(["stiffness_step"] if tried else [])}
    assert {c.law.name for c in candidates(held, Chain(1), (), (), (1,))} == {"constant_force", "stiffness_step"}


# -- gate -------------------------------------------------------------------------------------------


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
    assert gate.special_case(general, [general, *gaps], 90.0) is gaps[1]
    constant = finding(laws.ConstantForce(), 1.7)
    assert gate.special_case(general, [general, *gaps, constant], 90.0) is constant
    # no law with more parameters is the simpler one
    few, many = finding(laws.LuGre(0.1, 0.2, 0.3), 1.0), finding(laws.Dahl(10.0), 1.1)
    assert gate.special_case(few, [few, many], 90.0) is many
    assert gate.special_case(many, [few, many], 90.0) is many


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
