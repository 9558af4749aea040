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
    "further",
    [
        {"ground 3": laws.LinearElastic(2.5e4)},
        {"link 4-2": laws.LinearElastic(2.5e4)},
    ],
    ids=["a brace to the ground", "a brace over two storeys"],
)
def test_a_brace_that_moves_masses_gives_no_green_verdict(further):
    """Fit and loop judge by the same facts: what the run misses beyond noise."""
    record = measured(further, n=4, seconds=8.0)
    with pytest.warns(UserWarning, match="beyond its noise"):
        model = NRFRegressor(degree=1).fit(record)

    report = close_loop(record)

    assert worst(report.model.masses, MASSES) > 0.1
    for verdict in (model.verdict(), report.verdict):
        grounds = {(reason.kind, reason.place) for reason in verdict.grounds}
        assert ("residual", "measured channels") in grounds


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
