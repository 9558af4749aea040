"""The loop where floors have no sensor: effects by the free run of the channels."""

import pytest
from chains import driven
from few_channels import shaken, with_sensors

from pysindy_nrf import ChainModel, NRFRegressor, close_loop, excitation, laws
from pysindy_nrf.simulation import add_noise

CATALOGUE = [laws.CoulombFriction(), laws.CubicStiffness(), laws.QuadraticDamping()]


@pytest.fixture(scope="module")
def report():
    """Three floors on a shaken base, sensors on two, a cubic spring in storey 2."""
    masses = [12.0, 11.0, 10.0]
    storeys = {i: [laws.PowerSeries(1, [30.0, 1.5e5])] for i in (1, 2, 3)}
    storeys[2].append(laws.CubicStiffness(3e9))
    ground = excitation.band_limited_random(
        1, 6.0, 150.0, excited=[1], rms=3.0, band=(0.5, 35), random_state=2
    )
    record = shaken(ChainModel(masses, storeys), ground[:, 0], fs=150.0)
    record = with_sensors(add_noise(record, 0.005, random_state=1), [1, 3])
    baseline = NRFRegressor(degree=1, known_masses=dict(enumerate(masses, 1)))
    return close_loop(record, baseline, catalogue=CATALOGUE)


def test_a_cubic_spring_is_found_at_its_storey(report):
    (step,) = report.steps

    assert step.law == "cubic_stiffness"
    assert step.site == "storey 2"
    assert step.confirmed
    assert step.parameters["k3"] == pytest.approx(3e9, rel=0.05)


def test_the_held_out_error_falls_to_the_noise(report):
    held_out = report.table["held-out"]

    assert held_out.iloc[0] > 20.0
    assert held_out.iloc[-1] < 1.0


def test_the_report_is_written(report, tmp_path):
    report.to_html(tmp_path / "page.html")

    assert "cubic" in report.to_markdown()


def test_nothing_is_added_where_the_chain_is_linear():
    storey = laws.PowerSeries(1, [30.0, 1e5])
    truth = ChainModel([10.0, 8.0], {1: storey, 2: storey})
    record = driven(truth, [2], 6.0, 150.0, 100.0, (0.5, 40.0), seed=3)
    record = with_sensors(add_noise(record, 0.005, random_state=4), [2])

    report = close_loop(record, catalogue=CATALOGUE)

    assert not report.steps
    assert report.table["held-out"].iloc[0] < 1.5
    assert report.stopped_because.startswith("no ")
