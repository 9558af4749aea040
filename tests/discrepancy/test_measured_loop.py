"""The closed loop on measured records: what is published of them comes out."""

import warnings

import measured_sets
import numpy as np
import pytest
from battery.generators import make_case
from battery.measured import dry_friction
from discrepancy_battery import SIZES, specifications
from measured import folder

from pysindy_nrf import NRFRegressor, Record, close_loop, laws


def loop(record, baseline=None, catalogue=None):
    """No band, no trim: the loop gets channels, units and known masses."""
    with warnings.catch_warnings(action="ignore"):
        return close_loop(record, baseline, catalogue)


def frame(test, first=0, last=None):
    """A loop on the frame of three equal floors, on some rows of a test."""
    folder("nees_three_storey")
    record = measured_sets.load_nees_three_storey(test).rows(slice(first, last))
    return loop(record, NRFRegressor(degree=1, known_masses={1: 1.0, 2: 1.0, 3: 1.0}))


def confirmed(report):
    return [step for step in report.steps if step.confirmed]


SPRING = NRFRegressor(degree=1)


def test_emps_has_friction_and_an_offset():
    """Janot, Gautier, Brunot (2019): M = 95.11 kg, 203.5 N s/m, Coulomb 20.39 N, offset
    -3.16 N.
    """
    folder("emps")
    record = measured_sets.load_emps()
    report = loop(record, SPRING)
    first, *_ = confirmed(report)
    assert first.effect_class in ("memoryless", "hysteresis")
    assert "friction" in first.closest
    assert report.model.masses[0] == pytest.approx(95.1, abs=1.5)
    assert confirmed(report)[-1].error_after <= 5.5

    (offset,) = [note.size for note in report.quality if note.kind == "offset"]
    assert -3.5 <= offset < 0  # friction with two strengths takes a part of it
    assert "onstant" not in report.verdict.sentence


@pytest.mark.slow
def test_dry_friction_acts_against_the_ground():
    """Lathourakis and Cicirello (2024): the mass rubs on a frame that stands still.

    Only the transient shows it.
    """
    folder("dry_friction_storey")
    record = dry_friction().rows(slice(274, None))
    report = loop(record, NRFRegressor(degree=1, known_masses={1: 1.0}))
    best = report.steps[0]
    assert (best.law, best.site) == ("ground_friction", "dof 1")
    places = {(step.family, step.site) for step in report.steps}
    assert ("friction", "storey 1") not in places


def test_bouc_wen_benchmark_gives_the_published_parameters():
    """Noel and Schoukens (2016), cut out of a running test."""
    folder("bouc_wen_benchmark")
    report = loop(measured_sets.load_bouc_wen_benchmark(), SPRING)
    step = report.steps[0]
    assert step.law == "bouc_wen" and step.error_after <= 1.0
    published = {"alpha": 5e4, "beta": 800.0, "rho": -1.375, "n": 1.0}
    assert step.parameters == pytest.approx(published, rel=0.03)

    linear = report.model.restoring_forces["storey 1"].linear_part()
    assert report.model.masses[0] == pytest.approx(2.0, rel=0.03)
    assert linear["c"] == pytest.approx(10.0, rel=0.03)
    assert linear["k"] == pytest.approx(5e4, rel=0.03)


@pytest.mark.slow
def test_a_strongly_shaken_frame_yields():
    """Storey 3 is seen and refused: held-out time speaks against it."""
    report = frame("fbgm152s3")
    effects = confirmed(report)
    yielding = set()
    for step in effects:
        if "hysteresis" in {step.family, *step.alternatives}:
            yielding.add(step.site)
    assert yielding == {"storey 1", "storey 2"}
    assert {step.site for step in report.steps} == yielding | {"storey 3"}
    assert (np.diff([step.error_after for step in effects]) <= 0).all()


@pytest.mark.slow
def test_a_name_that_the_estimate_leaves_open_gives_way_to_its_general_law():
    """The strength of a Bouc-Wen law in storey 2 is uncertain by a thousand times."""
    steps = confirmed(frame("fbgm152s4"))
    (found,) = [step for step in steps if step.site == "storey 2"]
    assert (found.law, found.closest) == ("general_hysteresis", "bouc_wen")
    assert not found.carries


@pytest.mark.slow
def test_an_effect_takes_over_no_spring():
    """Sliders beside -214 N/m, where the storey has 420, explained the search and not
    what was held out.
    """
    report = frame("fbgm162s5", 113)
    stiffness = []
    for model in report.models:
        for force in model.restoring_forces.values():
            stiffness.append(force.linear_part()["k"])
    assert report.steps
    # a tenth of the force of the sliders
    assert np.min(stiffness) > -40


def test_what_errors_of_channels_explain_better_is_no_inerter():
    """A chain with imperfect sensors alone: errors of all channels explain 10 dB, an
    inerter 4, 1 dB of it beyond them.
    """
    case = make_case(**specifications("sensors", SIZES["sensors"], 1501)[113])
    records = [Record(**channels) for channels in case.searched]
    assert loop(records, SPRING, [laws.Inerter()]).steps == []
