"""The loop where floors have no sensor: hysteresis, and what its verdict reads."""

import pytest
from chains import worst
from few_channels import DAMPING, MASSES, STIFFNESS, pushed, with_sensors

from pysindy_nrf import ChainModel, NRFRegressor, close_loop, laws
from pysindy_nrf.simulation import add_noise

NOISE = 0.005
# The largest drift of storey 2 of three is about 3 mm.
SLIDER = {"uy": 0.8e-3, "Fy": 25.0}


def measured(further, n=3, seconds=4.0, seed=1):
    """Accelerations of the two top floors, of a frame with laws nobody declares."""
    storeys = {}
    for i, stiffness in enumerate(STIFFNESS[:n], 1):
        storeys[f"storey {i}"] = [laws.PowerSeries(1, [DAMPING, stiffness])]
    for site, law in further.items():
        storeys.setdefault(site, []).append(law)
    motion = pushed(ChainModel(MASSES[:n], storeys), seconds=seconds, seed=seed)
    return with_sensors(add_noise(motion, NOISE, random_state=seed), (n - 1, n))


@pytest.mark.slow
def test_a_declared_hysteresis_is_fitted_to_the_channels():
    """Its state is zero where no motion was measured before."""
    record = measured({"storey 2": laws.Jenkins(**SLIDER)})
    declared = {2: [laws.PowerSeries(1), laws.Jenkins()]}

    model = NRFRegressor(degree=1, laws=declared).fit(record)

    (_, slider) = model.model_.laws[model.model_.chain.site("storey 2")]
    assert slider.parameters["Fy"] == pytest.approx(SLIDER["Fy"], rel=0.02)
    assert slider.parameters["uy"] == pytest.approx(SLIDER["uy"], rel=0.02)
    assert worst(model.masses_, MASSES[:3]) < 0.01


@pytest.mark.parametrize(
    "another_record", [False, pytest.param(True, marks=pytest.mark.slow)]
)
def test_a_hidden_hysteresis_is_found_and_estimated(another_record):
    further = {"storey 2": laws.Jenkins(**SLIDER)}
    heldout = measured(further, seed=2) if another_record else None

    report = close_loop(measured(further), heldout=heldout)

    (step,) = report.steps
    assert (step.effect_class, step.site) == ("hysteresis", "storey 2")
    low, high = step.intervals["Fy"]
    assert low < SLIDER["Fy"] < high
    low, high = step.intervals["uy"]
    assert low < SLIDER["uy"] < high
    assert worst(report.model.masses, MASSES[:3]) < 0.01
    # a name is sure where another record has judged it
    assert step.sure == another_record
    judged_by = "another record" if another_record else "another time"
    assert step.judged_by == judged_by


@pytest.mark.parametrize(
    "site",
    ["ground 3", pytest.param("link 4-2", marks=pytest.mark.slow)],
)
def test_a_brace_is_no_green_verdict_of_a_fit_and_is_found_by_the_loop(site):
    """Without it masses are off by half: linearisations alone do not get there."""
    record = measured({site: laws.LinearElastic(2.5e4)}, n=4, seconds=8.0)
    with pytest.warns(UserWarning, match="beyond its noise"):
        model = NRFRegressor(degree=1).fit(record)

    report = close_loop(record)

    assert worst(model.masses_, MASSES) > 0.1
    grounds = {(reason.kind, reason.place) for reason in model.verdict().grounds}
    assert ("residual", "measured channels") in grounds
    (step,) = report.steps
    assert step.effect_class == "tie"
    assert step.site == site or any(site in places for _, places, _ in step.rivals)
    assert not step.sure


@pytest.mark.slow
def test_dashpots_from_all_floors_to_the_ground_are_one_candidate():
    dashpots = {f"ground {j}": laws.LinearViscous(3.0 * MASSES[j - 1]) for j in (2, 3)}

    report = close_loop(measured(dashpots))

    assert [step.site for step in report.steps] == ["ground 2", "ground 3"]
    assert {step.law for step in report.steps} == {"ground_dashpot"}
    assert worst(report.model.masses, MASSES[:3]) < 0.01


def test_a_tie_that_the_gain_of_a_sensor_explains_is_not_claimed():
    record = measured({}, n=4, seconds=8.0)
    acceleration = record.acceleration.copy()
    acceleration[:, 2] *= 1.06

    report = close_loop(record.replace(acceleration=acceleration))

    assert not any(step.confirmed for step in report.steps)
    assert report.verdict.state == "amber"


def test_a_sensor_that_reads_too_much_gives_no_green_verdict():
    """A gain of 6 % moves masses beyond their intervals."""
    record = measured({}, n=4, seconds=8.0)
    acceleration = record.acceleration.copy()
    acceleration[:, 2] *= 1.06
    with pytest.warns(UserWarning, match="beyond its noise"):
        model = NRFRegressor(degree=1).fit(record.replace(acceleration=acceleration))

    assert worst(model.masses_, MASSES) > 0.02
    assert model.verdict().state == "amber"


def test_a_right_model_is_green_and_its_intervals_hold():
    report = close_loop(measured({}, n=4, seconds=8.0))

    assert report.steps == []
    assert report.verdict.state == "green"
    n_inside = 0
    for j, mass in enumerate(MASSES, 1):
        low, high = report.bounds[f"m{j}"]
        n_inside += low < mass < high
    assert n_inside >= 3
