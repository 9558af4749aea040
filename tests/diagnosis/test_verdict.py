"""The verdict follows from facts: what is red, what is amber, and what is named.

Expected states are those of the rules in docs/command_line.md.
"""

import re
import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from report_cases import FC, TWO_STOREYS, friction, loop_report

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.diagnosis import (
    Facts,
    FreeRunFacts,
    FreeRuns,
    GrowingMode,
    digits,
    effect_words,
    facts_of_model,
    verdict_after_search,
    verdict_from,
    wiring_errors,
)
from pysindy_nrf.diagnosis.facts import LeftOver, OtherModel, ShapeAtEnd
from pysindy_nrf.records import QualityNote
from pysindy_nrf.simulation import add_noise

GOOD = Facts(unexplained={1: 2.0, 2: 3.0}, free_run=FreeRunFacts(8.0))
LATE = QualityNote("delay", "v1 is late.", "v1", "monday")


AT_END = ShapeAtEnd("jenkins", "storey 2", "uy", "lower", 4e-5, "m")


def kinds(verdict):
    """Kinds of the reasons of a verdict with their places."""
    return [(reason.kind, reason.place) for reason in verdict.grounds]


# -- facts to verdicts ---------------------------------------------------------


def test_a_model_that_closes_and_follows_is_green():
    verdict = verdict_from(GOOD)
    assert verdict.state == "green"
    assert verdict.reasons == ()
    assert "predicts the motion to 8 %" in verdict.sentence


@pytest.mark.parametrize(
    ("facts", "kind", "place"),
    [
        ({"unexplained": {1: 51.0, 2: 3.0}}, "unexplained", "dof 1"),
        ({"impossible_masses": {2: -1.0}}, "mass", "m2"),
        ({"negative_stiffness": ("storey 1",)}, "stiffness", "storey 1"),
        ({"intervals": {"m2": (-1.0, 21.0)}}, "interval", "m2"),
        ({"free_run": FreeRunFacts(np.inf, diverges=True)}, "free run", ""),
        ({"free_run": FreeRunFacts(130.0, floats=False)}, "free run", ""),
        ({"nothing_claimed": "85 % is left"}, "no claim", ""),
        ({"wiring": "With F1 reversed it closes."}, "wiring", ""),
        ({"channel_faults": {"a1 is reversed.": True}}, "channel", ""),
    ],
)
def test_what_makes_a_verdict_red(facts, kind, place):
    verdict = verdict_from(replace(GOOD, **facts))
    assert verdict.state == "red"
    assert kinds(verdict)[0] == (kind, place)
    assert verdict.grounds[0].message in verdict.sentence


@pytest.mark.parametrize(
    ("facts", "kind", "place"),
    [
        ({"unexplained": {1: 2.0, 2: 16.0}}, "unexplained", "dof 2"),
        ({"free_run": FreeRunFacts(25.0)}, "free run", ""),
        ({"free_run": FreeRunFacts(130.0, floats=True)}, "free run", ""),
        (
            {"free_run": FreeRunFacts(130.0, floats=False, spread=60.0)},
            "sensitivity",
            "",
        ),
        ({"channel_faults": {"a1 is another motion.": False}}, "channel", ""),
        ({"quality": (LATE,)}, "quality", "v1"),
        ({"doubts": ("The intervals are withheld.",)}, "other", ""),
        ({"unanswered": {"Where?": "no force is known"}}, "evidence", "Where?"),
        ({"noise_is_known": False}, "evidence", ""),
        ({"shapes_at_ends": (AT_END,)}, "shape", "storey 2"),
    ],
)
def test_what_makes_a_verdict_amber(facts, kind, place):
    verdict = verdict_from(replace(GOOD, **facts))
    assert verdict.state == "amber"
    assert kinds(verdict) == [(kind, place)]
    assert verdict.reasons == (verdict.grounds[0].message,)


@pytest.mark.parametrize("run", [FreeRunFacts(), FreeRunFacts(4.0)])
def test_a_mode_that_grows_is_a_doubt_even_where_the_free_run_follows(run):
    growing = GrowingMode(1, -0.02)
    verdict = verdict_from(replace(GOOD, growing_mode=growing, free_run=run))
    assert kinds(verdict) == [("damping", "mode 1")]


def test_a_mode_that_grows_does_not_excuse_a_run_that_is_lost():
    """Errors of the parameters move such a run as far as they like."""
    run = FreeRunFacts(110.0, floats=False, spread=120.0)
    growing = GrowingMode(3, -0.045)
    verdict = verdict_from(replace(GOOD, growing_mode=growing, free_run=run))
    assert verdict.state == "red"
    assert kinds(verdict)[0] == ("free run", "")


def test_what_equations_leave_is_noise_where_the_free_run_follows():
    facts = replace(GOOD, unexplained={1: 60.0, 2: 3.0})
    assert verdict_from(facts).state == "red"
    follows = replace(facts, free_run=FreeRunFacts(1.0))
    assert verdict_from(follows).state == "green"


def test_a_law_is_no_rival_of_noise_that_explains_most():
    """27.8 N are left where noise leaves 21; where it leaves 10, most is something."""
    doubt = "Balance of DOF 2: a law is missing, or the motion is noisy."
    for noise, state in ((21.2, "green"), (10.0, "amber")):
        residuals = {1: LeftOver(2.6, 2.5, 2.6), 2: LeftOver(27.8, noise, 27.8)}
        facts = replace(
            GOOD,
            unexplained={1: 2.6, 2: 27.8},
            beyond_noise={1: 0.0, 2: 5.0},
            left_over=residuals,
            free_run=FreeRunFacts(7.3),
            noise_or_law=(doubt,),
        )
        assert verdict_from(facts).state == state


def test_a_free_run_that_drifts_later_is_judged_over_some_periods():
    drifts = FreeRunFacts(60.0, over_periods=5.0)
    verdict = verdict_from(replace(GOOD, free_run=drifts))
    assert verdict.state == "green"
    assert "5 % over ten periods" in verdict.sentence


@pytest.mark.parametrize(
    ("other", "of_this", "state"),
    [
        (4.0, 9.0, "amber"),
        (4.0, np.inf, "amber"),
        (8.5, 9.0, "green"),  # no better but by chance
        (0.1, 4.0, "green"),  # as close as sensors measure
        (np.nan, 9.0, "green"),
        (np.inf, 9.0, "green"),
    ],
)
def test_a_model_that_predicts_better_is_named(other, of_this, state):
    compared = replace(GOOD, other_models=(OtherModel("Plain SINDy", other, of_this),))
    verdict = verdict_from(compared)
    assert verdict.state == state
    assert ("comparison", "") in kinds(verdict) or state == "green"


def test_an_error_of_wiring_is_named_before_all_that_follows_from_it():
    facts = Facts(
        unexplained={1: 60.0, 2: 20.0},
        channel_faults={"a1 is reversed.": True},
        wiring="With a1 reversed every balance closes.",
        doubts=("The intervals are withheld.",),
    )
    verdict = verdict_from(facts)
    assert facts.wiring in verdict.sentence
    assert len(verdict.reasons) == 2
    assert "DOF 1" in verdict.reasons[0]
    assert "a1 is reversed." in verdict.reasons


def test_the_record_of_a_note_is_named_where_there_are_several():
    early = replace(LATE, message="v1 is early.", record="tuesday")
    verdict = verdict_from(replace(GOOD, quality=(LATE, early)))
    assert "'monday'" in verdict.reasons[0]
    assert "'tuesday'" in verdict.reasons[1]


def test_what_a_fault_says_is_not_said_again():
    fault = {"v1 is late: it is another motion.": False}
    verdict = verdict_from(replace(GOOD, quality=(LATE,), channel_faults=fault))
    assert kinds(verdict) == [("channel", "")]


@pytest.mark.parametrize(
    ("facts", "searched"),
    [
        ({}, False),
        ({"unexplained": {1: 20.0}}, False),
        ({"unexplained": {1: 26.0}}, True),
        ({"impossible_masses": {1: -1.0}}, True),
        ({"channel_faults": {"a1 is another motion.": False}}, True),
    ],
)
def test_other_mappings_are_tried_only_where_one_is_likely(facts, searched):
    calls = []

    def search():
        calls.append(1)
        return ""

    verdict_after_search(replace(GOOD, **facts), search)
    assert bool(calls) == searched


# -- models to facts -----------------------------------------------------------


def storeys(c, k):
    return ChainModel([12.0, 10.0], {i: laws.PowerSeries(1, [c, k]) for i in (1, 2)})


def test_masses_that_were_given_may_have_any_sign():
    model = ChainModel([-1.0, 2.0], storeys(30.0, 4e4).laws)
    assert facts_of_model(model, {}, None).impossible_masses == {1: -1.0}
    assert facts_of_model(model, {}, None, known_masses=[1]).impossible_masses == {}


def test_a_damper_of_the_wrong_sign_grows():
    growing = facts_of_model(storeys(-30.0, 4e4), {}, None).growing_mode
    assert growing.damping < 0
    assert facts_of_model(storeys(30.0, 4e4), {}, None).growing_mode is None


def test_a_run_that_comes_to_no_end_diverges():
    table = pd.DataFrame([[np.inf, 1.0]], index=["r"], columns=["x1", "x2"])
    runs = FreeRuns(table)
    assert facts_of_model(storeys(30.0, 4e4), {}, runs).free_run.diverges


# -- errors of wiring ----------------------------------------------------------


def shaken_on_top():
    """A linear chain of two storeys, forced on floor 2: a and x with noise."""
    force = excitation.band_limited_random(
        2, 5.0, 500.0, excited=2, rms=60.0, band=(1, 40), random_state=0
    )
    exact = simulate(TWO_STOREYS, force, 2e-3, name="clean")
    return add_noise(exact.replace(velocity=None), 0.003, random_state=1)


def linear_fit(record):
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor(degree=1, estimation="ls").fit(record)


def single_errors():
    """Errors of one kind of channel, by their names."""
    errors = {}
    for error in wiring_errors(shaken_on_top()):
        letters = re.findall(r"([avxF])\d", error.words)
        if len(set(letters)) == 1:
            errors[error.words] = error
    return errors


def test_every_error_of_wiring_is_tried():
    """The force on the other floor, five channels reversed, two pairs exchanged."""
    assert len(single_errors()) == 8


@pytest.mark.parametrize("words", single_errors())
def test_every_error_of_wiring_is_named(words):
    verdict = linear_fit(single_errors()[words].correct(shaken_on_top())).verdict()
    expected = words.replace("F2 acting on floor 1", "F1 acting on floor 2")
    if words[0] in "ax" and words.endswith("reversed"):
        # the fit may prefer either channel of the pair
        expected = "opposite sign"
    assert verdict.state == "red"
    assert expected in str(verdict)


def test_a_clean_record_is_not_accused():
    assert linear_fit(shaken_on_top()).verdict().state != "red"


def test_a_channel_in_another_unit_is_named_first():
    clean = shaken_on_top()
    in_mm = clean.replace(displacement=1e3 * clean.displacement)
    verdict = linear_fit(in_mm).verdict()
    assert verdict.state == "red"
    assert "x1 is 1e+03 times" in verdict.sentence
    assert "another unit" in verdict.sentence


def test_exchanged_sensors_that_nearly_close_are_named():
    """One mode moves most: the exchanged displacement is right but for its size."""
    clean = shaken_on_top()
    exchanged = clean.replace(displacement=clean.displacement[:, ::-1])
    with warnings.catch_warnings(action="ignore"):
        verdict = NRFRegressor(degree=1).fit(exchanged).verdict()
    assert verdict.state == "red"
    assert "x1 and x2 exchanged" in verdict.sentence


def test_a_loop_on_a_force_of_the_wrong_floor_claims_nothing_and_names_it():
    rec = shaken_on_top()
    wrong = rec.replace(force=rec.force[:, ::-1])
    report = close_loop(wrong, catalogue=[laws.CoulombFriction()], max_steps=1)
    assert report.nothing_claimed
    assert report.verdict.state == "red"
    assert "force F1 acting on floor 2" in report.verdict.sentence


STRONG_EFFECTS = {
    "cubic": (laws.CubicStiffness(4e9), 1),
    "friction": (laws.CoulombFriction(40.0), [1, 2]),
    "hysteresis": (laws.BoucWen(beta=400.0, rho=0.3, n=1.0, alpha=3e4), [1, 2]),
}


@pytest.fixture(params=STRONG_EFFECTS)
def strong_effect(request):
    """A record of which linear storeys leave 15 to 50 % of the force."""
    law, forced = STRONG_EFFECTS[request.param]
    linear = laws.PowerSeries(1, [30.0, 3e4])
    lower = laws.PowerSeries(1, [40.0, 4e4])
    truth = ChainModel([12.0, 10.0], {1: lower, 2: [linear, law]})
    force = excitation.band_limited_random(
        2, 6.0, 500.0, excited=forced, rms=60.0, band=(1, 40), random_state=0
    )
    exact = simulate(truth, force, 2e-3).replace(velocity=None)
    return add_noise(exact, 0.01, random_state=1)


def test_a_strong_effect_is_no_error_of_wiring(strong_effect):
    """Wiring is judged by storeys that may have any law."""
    fitted = linear_fit(strong_effect)
    assert fitted.errors_["error"].max() > 15.0
    accused = {"wiring", "channel"}
    assert not accused & {reason.kind for reason in fitted.verdict().grounds}


def test_a_strong_effect_hides_no_error_of_wiring(strong_effect):
    reversed_force = strong_effect.force * [-1.0, 1.0]
    verdict = linear_fit(strong_effect.replace(force=reversed_force)).verdict()
    assert verdict.state == "red"
    assert "F1 reversed" in verdict.sentence


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_sign_of_an_inertia_below_the_noise_accuses_no_channel(seed):
    """An element on a slow rig: 0.06 N of negative inertia in 0.3 N of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(2001) / 100.0
    x, a = np.zeros(len(t)), np.zeros(len(t))
    for amplitude, frequency in ((0.005, 0.5), (0.003, 1.15)):
        w = 2 * np.pi * frequency
        x += amplitude * np.sin(w * t)
        a -= amplitude * w**2 * np.sin(w * t)
    force = 200 * x - 0.5 * a + 0.3 * rng.standard_normal(len(t))

    record = Record(force[:, None], displacement=x[:, None], fs=100.0)
    verdict = linear_fit(record).verdict()

    assert verdict.state == "red"
    assert "reversed" not in str(verdict)


def test_a_brake_that_a_current_drives_accuses_no_channel():
    """The friction of a magnetorheological brake is 2 to 26 N by its current."""
    rng = np.random.default_rng(5)
    t = np.arange(1500) / 100.0
    x = 0.006 * np.sin(2 * np.pi * 0.4 * t) + 0.002 * np.sin(2 * np.pi * 1.3 * t)
    current = 0.5 - 0.5 * np.cos(2 * np.pi * 0.17 * t)
    friction = (2.0 + 24.0 * current) * np.tanh(np.gradient(x, t) / 0.002)
    force = friction + 90.0 * x + 0.2 * rng.standard_normal(len(t))

    record = Record(force[:, None], displacement=x[:, None], fs=100.0)
    verdict = linear_fit(record).verdict()

    assert verdict.state == "red"
    kinds = {ground.kind for ground in verdict.grounds}
    assert not kinds & {"wiring", "channel"}


# -- channels that contradict each other ---------------------------------------


@pytest.fixture(scope="module")
def insensitive():
    """A record whose accelerometer of floor 2 is 15 % too sensitive beside v2, x2."""
    force = excitation.band_limited_random(
        2, 6.0, 250.0, excited=2, rms=60.0, band=(1, 40), random_state=0
    )
    exact = simulate(TWO_STOREYS, force, 1 / 250)
    return exact.replace(acceleration=exact.acceleration * [1.0, 1.15])


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_a_contradiction_of_channels_reaches_fit_and_loop_alike(insensitive):
    fit = NRFRegressor(degree=1).fit(insensitive).verdict()
    loop = close_loop(insensitive, catalogue=[laws.CubicStiffness()]).verdict
    contradictions = [text for text in fit.reasons if "v2" in text and "a2" in text]
    assert contradictions
    assert [text for text in loop.reasons if "v2" in text] == contradictions
    assert fit.state != "green"
    assert loop.state != "green"


# -- words ---------------------------------------------------------------------


def test_the_verdict_on_a_loop_says_what_where_how_large_and_how_sure():
    report = loop_report(friction)
    step = report.steps[0]
    low, high = step.intervals["Fc"]
    assert report.verdict.state == "green"
    assert low < FC < high

    size = digits(low, high, step.parameters["Fc"])
    effect = f"Dry friction of {size} N ({digits(low, high)} N) in storey 2;"
    assert report.verdict.sentence.startswith(effect)
    assert f"GREEN: {report.verdict.sentence}" in report.to_markdown()


def test_intervals_of_a_loop_hold_their_estimates():
    report = loop_report(friction)
    for name, (low, high) in report.steps[0].intervals.items():
        assert low <= report.steps[0].parameters[name] <= high
    for j, mass in enumerate(report.model.masses, 1):
        low, high = report.bounds[f"m{j}"]
        assert low < mass < high


def test_an_effect_is_named_with_its_size_and_place():
    force, interval = {"Fc": 61.7}, {"Fc": (61.2, 62.2)}
    words = effect_words("coulomb_friction", "ground 2", force, interval, {"Fc": "N"})
    expected = "dry friction of 61.7 N (61.2 to 62.2 N) between floor 2 and the ground"
    assert words == expected


def test_an_interval_sets_the_digits():
    assert digits(1234.5, 1235.5) == "1234.5 to 1235.5"
    assert digits(169.2, 188.7) == "169 to 189"
