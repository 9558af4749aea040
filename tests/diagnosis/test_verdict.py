"""The verdict: green for what closes, red with the error of wiring named, and nobody
accused who is innocent.
"""

import warnings

import pytest
from report_cases import FC, TWO_STOREYS, friction, loop_report

from pysindy_nrf import ChainModel, NRFRegressor, close_loop, excitation, laws, simulate
from pysindy_nrf.diagnosis.verdict import digits, effect_words, rearranged, verdict_on
from pysindy_nrf.simulation.noise import add_noise

MODEL = ChainModel(
    [12.0, 10.0],
    {1: laws.PowerSeries(1, [40.0, 4e4]), 2: laws.PowerSeries(1, [30.0, 3e4])},
)


def shaken_on_top():
    """A linear chain of two storeys of which only floor 2 is forced, in accelerations
    and displacements with noise.
    """
    force = excitation.band_limited_random(
        2, 5.0, 500.0, excited=2, rms=60.0, band=(1, 40), random_state=0
    )
    rec = simulate(TWO_STOREYS, force, 2e-3, name="clean")
    return add_noise(rec.replace(velocity=None), 0.003, random_state=1)


def test_every_error_of_wiring_is_named_and_the_clean_record_is_not_accused():
    clean = shaken_on_top()
    linear = NRFRegressor(degree=1, estimation="ls")
    assert linear.fit(clean).verdict().reasons == () or linear.verdict().state != "red"
    wrong = [
        (words, change) for words, change in rearranged(clean) if " and " not in words
    ]
    assert (
        len(wrong) == 8
    )  # the force on the other floor, five channels reversed, two pairs exchanged
    for words, change in wrong:
        with warnings.catch_warnings(action="ignore"):
            verdict = linear.fit(change(clean)).verdict()
        assert verdict.state == "red", words
        of_a_pair = words[0] in "ax" and words.endswith(
            "reversed"
        )  # the fit may prefer either channel
        expected = (
            "opposite sign"
            if of_a_pair
            else words.replace("F2 acting on floor 1", "F1 acting on floor 2")
        )
        assert expected in str(verdict), verdict


def test_a_channel_in_another_unit_is_named_first():
    clean = shaken_on_top()
    with warnings.catch_warnings(action="ignore"):
        verdict = (
            NRFRegressor(degree=1, estimation="ls")
            .fit(clean.replace(displacement=1e3 * clean.displacement))
            .verdict()
        )
    assert (
        verdict.state == "red"
        and "x1 is 1e+03 times as large against a1: one of them is in another unit or another column"
        in verdict.sentence
    )


def test_the_verdict_on_a_loop_says_what_where_how_large_and_how_sure():
    verdict = loop_report(friction).verdict
    (low, high), found = (
        getattr(loop_report(friction).steps[0], key)["Fc"]
        for key in ("intervals", "parameters")
    )
    assert verdict.state == "green" and low < FC < high
    assert verdict.sentence.startswith(
        f"Dry friction of {digits(low, high, found)} N ({digits(low, high)} N) in"
        " storey 2; linear otherwise; the free run"
    )
    assert f"GREEN: {verdict.sentence}" in loop_report(friction).to_markdown()


def test_exchanged_sensors_that_nearly_close_are_named():
    """One mode moves most: the exchanged displacement is the right one but for its
    size.
    """
    rec = shaken_on_top()
    with warnings.catch_warnings(action="ignore"):
        verdict = (
            NRFRegressor(degree=1)
            .fit(rec.replace(displacement=rec.displacement[:, ::-1]))
            .verdict()
        )
    assert verdict.state == "red" and "x1 with x2 exchanged" in verdict.sentence


def test_a_loop_on_a_force_of_the_wrong_floor_claims_nothing_and_names_it():
    rec = shaken_on_top()
    report = close_loop(
        rec.replace(force=rec.force[:, ::-1]),
        catalogue=[laws.CoulombFriction()],
        max_steps=1,
    )
    assert (
        report.verdict.state == "red"
        and "the force F1 acting on floor 2" in report.verdict.sentence
    )


@pytest.mark.parametrize(
    ("law", "forced"),
    [
        (laws.CubicStiffness(4e9), 1),
        (laws.CoulombFriction(40.0), [1, 2]),
        (laws.BoucWen(beta=400.0, rho=0.3, n=1.0, alpha=3e4), [1, 2]),
    ],
    ids=["cubic", "friction", "hysteresis"],
)
def test_a_strong_effect_is_no_error_of_wiring_and_hides_none(law, forced):
    """Linear storeys leave 15 to 50 % of the force of these records; wiring is judged
    by storeys that may have any law.
    """
    truth = ChainModel(
        MODEL.masses, {**MODEL.laws, "storey 2": [*MODEL.laws["storey 2"], law]}
    )
    force = excitation.band_limited_random(
        2, 6.0, 500.0, excited=forced, rms=60.0, band=(1, 40), random_state=0
    )
    clean = add_noise(
        simulate(truth, force, 2e-3).replace(velocity=None), 0.01, random_state=1
    )
    linear = NRFRegressor(degree=1, estimation="ls")
    with warnings.catch_warnings(action="ignore"):
        assert linear.fit(clean).errors_["error"].max() > 15.0
        said = str(linear.verdict())
        assert not any(word in said for word in ("close", "opposite", "swapped")), said
        turned = linear.fit(clean.replace(force=clean.force * [-1.0, 1.0])).verdict()
    assert turned.state == "red" and "F1 reversed" in turned.sentence


@pytest.mark.parametrize(
    ("model", "balances", "bounds", "words"),
    [
        (MODEL, {1: 51.0, 2: 3.0}, {}, "The balance of DOF 1 leaves 51 %"),
        (ChainModel([-1.0, 2.0], MODEL.laws, MODEL.chain), {1: 3.0}, {}, "m1 = -1 kg"),
        (MODEL, {1: 3.0}, {"m2": (-1.0, 21.0)}, "do not determine m2"),
    ],
)
def test_what_makes_a_verdict_red(model, balances, bounds, words):
    verdict = verdict_on(model, balances, [], None, bounds, wiring=lambda: "")
    assert verdict.state == "red" and words in verdict.sentence
    assert (
        verdict_on(MODEL, {1: 20.0}, []).state == "amber"
        and verdict_on(MODEL, {1: 2.0}, []).state == "green"
    )


def test_intervals_hold_their_estimates_and_set_the_digits():
    report = loop_report(friction)
    step = report.steps[0]
    assert all(
        low <= step.parameters[name] <= high
        for name, (low, high) in step.intervals.items()
    )
    masses = zip(report.model.masses, (report.bounds[f"m{j}"] for j in (1, 2, 3)))
    assert all(low < m < high for m, (low, high) in masses)
    units = {"Fc": "N"}
    assert (
        effect_words(
            "coulomb_friction", "ground 2", {"Fc": 61.7}, {"Fc": (61.2, 62.2)}, units
        )
        == "dry friction of 61.7 N (61.2 to 62.2 N) between floor 2 and the ground"
    )
    assert digits(1234.5, 1235.5) == "1234.5 to 1235.5"
