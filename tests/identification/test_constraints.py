"""What is known of parameters: obeyed exactly, harmless where true, helpful where data
are poor, contradicted aloud.
"""

import warnings

import numpy as np
import pytest

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Parameter,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import BiasWarning, ChainError

MASS = 12.0
STIFFNESS = 1e5
DAMPING = 60.0
FS = 500.0
TOTAL = "m1 + m2 + m3"


def simulated(dampings):
    """Motions and forces of three equal floors, whose middle one is forced."""
    storeys = {
        f"storey {i}": laws.PowerSeries(1, [damping, STIFFNESS])
        for i, damping in enumerate(dampings, start=1)
    }
    force = excitation.band_limited_random(
        3, 8.0, FS, excited=[2], rms=100.0, band=(0.5, 50.0), random_state=0
    )
    return simulate(ChainModel([MASS] * 3, storeys), force, 1 / FS).to_features(
        smooth=False
    )


@pytest.fixture(scope="module")
def noisy():
    X, F = simulated([DAMPING] * 3)
    rng = np.random.default_rng(1)
    X.iloc[:, :3] += 0.02 * rng.normal(size=(len(X), 3))
    F += 10.0 * rng.normal(size=F.shape) * [0, 1, 0]
    return X, F


def fit(data, **known):
    constraints = known.pop("constraints", None)
    model = NRFRegressor(degree=1, constraints=constraints, dt=1 / FS, **known)
    with warnings.catch_warnings(action="ignore"):
        return model.fit(*data)


def coefficients(model, term):
    return [model.restoring_forces_[i].coefficients[term] for i in (1, 2, 3)]


# -- what is known is obeyed ---------------------------------------------------------


def test_tied_masses_are_equal(noisy):
    model = fit(noisy, constraints={"m*": Parameter(equal_to="m1")})
    assert np.ptp(model.masses_) < 1e-9


def test_masses_add_up_to_a_weighed_total(noisy):
    model = fit(noisy, constraints={TOTAL: Parameter(36.0)})
    assert model.masses_.sum() == pytest.approx(36.0)


def test_a_known_stiffness_is_kept(noisy):
    model = fit(noisy, constraints={"storey 2: s": Parameter(1.01e5)})
    assert coefficients(model, "s")[1] == pytest.approx(1.01e5)


def test_a_site_may_be_spelled_in_any_way(noisy):
    model = fit(noisy, constraints={"ground 1:s": Parameter(1.01e5)})
    assert coefficients(model, "s")[0] == pytest.approx(1.01e5)


def test_storeys_built_alike_have_one_law(noisy):
    alike = {
        f"storey *: {term}": Parameter(equal_to=f"storey 1: {term}")
        for term in ("v", "s")
    }
    model = fit(noisy, constraints=alike)
    for term in ("v", "s"):
        assert np.ptp(coefficients(model, term)) < 1e-6 * STIFFNESS


def test_several_are_obeyed_together(noisy):
    known = {
        "m3": Parameter(equal_to="m1"),
        TOTAL: Parameter(36.0),
        "storey 2: s": Parameter(equal_to="storey 1: s"),
    }
    model = fit(noisy, constraints=known)
    assert model.masses_[0] == pytest.approx(model.masses_[2])
    assert model.masses_.sum() == pytest.approx(36.0)
    assert np.ptp(coefficients(model, "s")[:2]) < 1e-6 * STIFFNESS


def test_the_problem_of_an_estimator_obeys_too(noisy):
    estimator = NRFRegressor(degree=1, constraints={TOTAL: Parameter(36.0)})
    record = simulate_record()
    with warnings.catch_warnings(action="ignore"):
        masses = estimator.problem(3).solve(record).model.masses
    assert masses.sum() == pytest.approx(36.0)


def simulate_record():
    storey = laws.PowerSeries(1, [DAMPING, STIFFNESS])
    force = excitation.band_limited_random(
        3, 8.0, FS, excited=[2], rms=100.0, band=(0.5, 50.0), random_state=0
    )
    truth = ChainModel([1.1 * MASS] * 3, {i: storey for i in (1, 2, 3)})
    return simulate(truth, force, 1 / FS)


# -- what it does to the estimate ----------------------------------------------------


def test_a_weighed_total_narrows_every_interval(noisy):
    """It scales masses and stiffnesses alike, and brings both nearer to the truth."""
    free = fit(noisy).confidence_intervals().set_index("parameter")
    weighed = fit(noisy, constraints={TOTAL: Parameter(36.0)})
    weighed = weighed.confidence_intervals().set_index("parameter")

    for name in ("m1", "storey 1: s", "storey 3: s"):
        width = weighed.loc[name, "upper"] - weighed.loc[name, "lower"]
        assert width < 0.8 * (free.loc[name, "upper"] - free.loc[name, "lower"])

    error = abs(weighed.loc["storey 1: s", "estimate"] / STIFFNESS - 1)
    assert error < abs(free.loc["storey 1: s", "estimate"] / STIFFNESS - 1)


def test_bounds_that_hold_change_nothing(noisy):
    positive = Parameter(lower=0.0)
    model = fit(noisy, constraints={"storey *: s": positive, "m*": positive})
    np.testing.assert_allclose(model.masses_, fit(noisy).masses_, rtol=1e-12)


def test_a_parameter_lies_on_a_bound_that_does_not_hold():
    X, F = simulated([DAMPING, -5.0, DAMPING])
    F["F2"] += np.random.default_rng(0).normal(size=len(F))
    assert coefficients(fit((X, F)), "v")[1] < 0

    bounded = fit((X, F), constraints={"storey 2: v": Parameter(lower=0.0)})
    assert coefficients(bounded, "v")[1] == 0.0
    bounded = fit((X, F), constraints={"storey 1: v": Parameter(upper=40.0)})
    assert coefficients(bounded, "v")[0] == 40.0


# -- what contradicts, and what is refused -------------------------------------------


def test_data_that_contradict_are_named(noisy):
    model = NRFRegressor(degree=1, constraints={TOTAL: Parameter(60.0)}, dt=1 / FS)
    with pytest.warns(BiasWarning, match=r"m1 \+ m2 \+ m3 = 60: .* standard errors"):
        model.fit(*noisy)


def test_two_values_of_one_parameter_contradict_each_other(noisy):
    known = {TOTAL: Parameter(36.0), "m1 + m3 + m2": Parameter(40.0)}
    with pytest.raises(ChainError, match="contradict each other"):
        fit(noisy, constraints=known)


def test_known_masses_are_checked_against_a_total(three):
    known_masses = {1: 10.0, 2: 12.0, 3: 8.0}
    right = NRFRegressor(
        degree=1, known_masses=known_masses, constraints={TOTAL: Parameter(30.0)}
    )
    assert right.fit(*three).masses_.tolist() == [10.0, 12.0, 8.0]

    wrong = right.set_params(constraints={TOTAL: Parameter(31.0)})
    with pytest.raises(ChainError, match="differ from a constraint by 1 kg"):
        wrong.fit(*three)


@pytest.mark.parametrize(
    ("constraints", "message"),
    [
        ({"m7": Parameter(1.0)}, "'m7'.*m1 to m3"),
        ({"m3": Parameter(equal_to="m7")}, "'m7'"),
        ({"storey 2: s^3": Parameter(1e5)}, "storey 2 has v, s"),
        ({"storey 9: s": Parameter(1e5)}, "storey 9"),
        ({"link *: s": Parameter(lower=0.0)}, "There are m1"),
        ({"m1": Parameter(10.0, spread=1.0)}, "a floor has no sensor"),
        ({"m1": 10.0}, "not a Parameter"),
        (["m1 > 0"], "not a mapping"),
    ],
)
def test_what_the_model_does_not_have_is_refused(noisy, constraints, message):
    with pytest.raises(ChainError, match=message):
        fit(noisy, constraints=constraints)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"value": 1.0, "equal_to": "m1"}, "a value and a tie"),
        ({"spread": 1.0}, "standard deviation of a value"),
        ({"value": 1.0, "spread": -1.0}, "standard deviation of a value"),
        ({"lower": 2.0, "upper": 1.0}, "above the upper"),
        ({"value": "heavy"}, "no number"),
    ],
)
def test_a_parameter_that_contradicts_itself_is_refused(settings, message):
    with pytest.raises(ChainError, match=message):
        Parameter(**settings)
