"""The closed loop on measured records, from their undeclared baselines: what is published of them must come out."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import measured_sets
import numpy as np
import pytest
from measured import folder

from pysindy_nrf import NRFRegressor, close_loop, laws

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
from battery.measured import dry_friction  # noqa: E402
from measured_records import storey_errors  # noqa: E402

pytestmark = pytest.mark.slow


def _loop(record, baseline=None, band=None, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return close_loop(record, baseline or NRFRegressor(degree=1), band=band, **options)


def _held_out(report):
    return report.table["held-out"].to_numpy(dtype=float)


def test_emps_friction_first_then_the_offset(monkeypatch):
    """Janot, Gautier, Brunot (2019): M = 95.11 kg, 203.5 N s/m, Coulomb 20.39 N, offset -3.16 N."""
    monkeypatch.setenv("PYSINDY_NRF_DATA", str(folder("emps")))
    rails = NRFRegressor(laws={1: laws.LinearViscous()})
    report = _loop(measured_sets.load_emps(), rails, (None, 20.0), max_steps=2)
    errors = _held_out(report)
    assert 15 < errors[0] < 19 and errors[1] <= 9 and errors[-1] <= 5.5
    assert "friction" in {report.steps[0].family, *report.steps[0].alternatives}
    assert [s.law for s in report.steps] in (["coulomb_friction", "constant_force"], ["asymmetric_friction"])
    found = {name: value for s in report.steps for name, value in s.parameters.items()}
    friction, offset = (
        (found["Fc"], found["f0"])
        if "f0" in found
        else ((found["Fp"] + found["Fm"]) / 2, (found["Fp"] - found["Fm"]) / 2)
    )
    assert report.model.masses[0] == pytest.approx(95.0, abs=1.0)
    assert 195 <= report.model.restoring_forces["storey 1"].coefficients["v"] <= 210
    assert 19.8 <= friction <= 21.2
    assert -3.5 <= offset <= -2.9


def test_emps_with_a_spring_declared_finds_the_same_friction(monkeypatch):
    monkeypatch.setenv("PYSINDY_NRF_DATA", str(folder("emps")))
    report = _loop(measured_sets.load_emps(), band=(None, 20.0), max_steps=2)
    assert [s.law for s in report.steps] == ["coulomb_friction", "constant_force"]
    assert report.steps[0].parameters["Fc"] == pytest.approx(20.39, rel=0.06)
    assert _held_out(report)[-1] <= 5.5


def test_dry_friction_acts_against_the_ground(monkeypatch):
    """Lathourakis and Cicirello (2024): the mass rubs on a frame that stands still."""
    monkeypatch.setenv("PYSINDY_NRF_DATA", str(folder("dry_friction_storey")))
    report = _loop(dry_friction(), NRFRegressor(degree=1, known_masses={1: 1.0}), (None, 20.0))
    assert report.steps[0].law == "ground_friction" and report.steps[0].site == "dof 1"
    assert not any(s.family == "friction" and s.site == "storey 1" for s in report.steps)
    errors = _held_out(report)
    assert 15 < errors[0] < 20 and errors[-1] <= 10
    assert 380 <= report.model.restoring_forces["storey 1"].linear_part()["k"] <= 395


def test_bouc_wen_benchmark_gives_the_published_parameters(monkeypatch):
    """Noel and Schoukens (2016), cut out of a running test."""
    monkeypatch.setenv("PYSINDY_NRF_DATA", str(folder("bouc_wen_benchmark")))
    report = _loop(measured_sets.load_bouc_wen_benchmark(), band=(None, 150.0), max_steps=1)
    step, linear = report.steps[0], report.model.restoring_forces["storey 1"].linear_part()
    assert step.law == "bouc_wen"
    assert _held_out(report)[-1] <= 1.5
    found = [
        report.model.masses[0],
        linear["c"],
        linear["k"],
        *(step.parameters[k] for k in ("alpha", "beta", "rho", "n")),
    ]
    assert np.allclose(found, [2.0, 10.0, 5e4, 5e4, 800.0, -1.375, 1.0], rtol=0.1)


EQUAL = {1: 1.0, 2: 1.0, 3: 1.0}


def test_a_weakly_shaken_frame_is_left_as_it_is(monkeypatch):
    monkeypatch.setenv("PYSINDY_NRF_DATA", str(folder("nees_three_storey")))
    record = measured_sets.load_nees_three_storey("fbgm162s1")
    report = _loop(record, NRFRegressor(degree=1, known_masses=EQUAL), (0.2, 10.0))
    assert report.steps == []


def test_a_strongly_shaken_frame_yields_in_every_storey(monkeypatch):
    monkeypatch.setenv("PYSINDY_NRF_DATA", str(folder("nees_three_storey")))
    record, band = measured_sets.load_nees_three_storey("fbgm162s5"), (0.2, 10.0)
    hysteretic = [laws.Jenkins(), laws.Dahl(), laws.CoulombFriction(), laws.CubicStiffness(), laws.QuadraticDamping()]
    report = _loop(record, NRFRegressor(degree=1, known_masses=EQUAL), band, catalogue=hysteretic, n_surrogates=1)
    assert {s.site for s in report.steps if "hysteresis" in {s.family, *s.alternatives}} == {
        "storey 1", "storey 2", "storey 3",
    }  # fmt: skip
    before, after = (storey_errors(report, record, band)[k] for k in (0, -1))
    assert (after <= [20.0, 15.0, 28.0]).all() and (before > after).all()
    assert "stay unexplained by any law of the catalogue" in report.stopped_because and "DOF 3" in report.stopped_because
