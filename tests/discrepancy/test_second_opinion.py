"""What noise makes wrong is not taken for an effect, and an effect is not taken for noise."""

from __future__ import annotations

import re

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainModel, NRFRegressor, Site, close_loop, excitation, laws, simulate
from pysindy_nrf.discrepancy.gate import Verdict
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.second_opinion import confirmed, unbiased_errors
from pysindy_nrf.discrepancy.splits import BlockRows, awake, split
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.surrogate import Null
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.simulation.noise import add_noise

FS, N = 100.0, 12000
M, K, C = [900.0, 700.0], [9e5, 6e5], [1800.0, 1400.0]


def stage_of(drift: float, noise: float = 0.1) -> tuple:
    """A linear chain, with or without a spring that grows weaker, as the loop sees it."""
    storeys = {f"storey {i + 1}": [laws.LinearViscous(C[i]), laws.LinearElastic(K[i])] for i in range(2)}
    storeys["storey 1"].append(laws.StiffnessDrift(kt=drift))
    F = excitation.band_limited_random(2, N / FS, FS, dofs=[1, 2], rms=300.0, band=(0.5, 20.0), random_state=5)
    rec = add_noise(simulate(ChainModel(M, storeys), F, 1 / FS, hold="cubic"), noise, random_state=3)
    ready = prepare(rec)
    search, held = split(ready.data.segments, ready.heldout)
    work = Workspace(ready.data, [None] * len(ready.data.segments), search, held, {}, "auto")
    linear = (laws.LinearViscous(), laws.LinearElastic())
    return ready, Stage(work, Chain(2), {Site(f"storey {i}"): linear for i in (1, 2)})


@pytest.fixture(scope="module", params=[0.0, -4e3], ids=["nothing", "drift"])
def case(request):
    ready, stage = stage_of(request.param)
    return request.param, ready, stage, stage.with_law(Site("storey 1"), laws.StiffnessDrift())


def test_an_effect_lowers_the_unbiased_error_and_noise_does_not(case):
    drift, ready, stage, after = case
    before, left = (float(np.median(unbiased_errors(s, ready))) for s in (stage, after))
    assert (left < 0.8 * before) if drift else (left > 0.95 * before)


def test_the_second_opinion_keeps_an_effect_and_refuses_what_noise_pretends(case):
    drift, ready, stage, after = case
    null = Null(ready, stage, np.random.default_rng(0), 2)
    assert drift or null.bias > 0.005  # least squares at 10 % noise
    verdict = confirmed(Verdict(True, 0.3, 1.0, 0.0, "the error falls by 30 %"), stage, after, null)
    assert verdict.accepted == bool(drift)
    assert drift or "instrumental variables" in verdict.sentence


def test_surrogates_begin_with_what_noise_has_taken_away():
    """A single floor shaken about its resonance, a and x alike but for noise: least squares returns a low mass.

    Surrogates of that model would be less low; those of the model without bias miss by as much as it does.
    """
    m, c, k = 900.0, 1800.0, 9e5
    F = excitation.band_limited_random(1, N / FS, FS, dofs=[1], rms=300.0, band=(4.0, 6.0), random_state=5)
    truth = ChainModel([m], {1: [laws.LinearViscous(c), laws.LinearElastic(k)]})
    ready = prepare(add_noise(simulate(truth, F, 1 / FS), 0.4, random_state=3))
    search, held = split(ready.data.segments, ready.heldout)
    work = Workspace(ready.data, [None], search, held, {}, "auto")
    stage = Stage(work, Chain(1), {Site("storey 1"): (laws.LinearViscous(), laws.LinearElastic())})
    null = Null(ready, stage, np.random.default_rng(1), 4)
    found = stage.trial().model().masses[0]
    missing = m - found
    assert missing > 0.03 * m and null.bias > 0.03
    again = np.mean([s.trial().model().masses[0] for s in null.stages])
    assert again == pytest.approx(found, abs=0.4 * missing)


def test_the_report_says_how_wrong_noise_makes_its_model_and_what_is_not():
    """A single floor shaken about its resonance at 40 % noise; the remedy in the sentence is tried."""
    m = 900.0
    F = excitation.band_limited_random(1, N / FS, FS, dofs=[1], rms=300.0, band=(4.0, 6.0), random_state=5)
    clean = simulate(ChainModel([m], {1: [laws.LinearViscous(1800.0), laws.LinearElastic(9e5)]}), F, 1 / FS, hold="cubic")
    assert "By noise" not in close_loop(clean, NRFRegressor(degree=1)).stopped_because
    noisy = add_noise(clean, 0.4, random_state=3)
    report = close_loop(noisy, NRFRegressor(degree=1))
    said = re.search(r"least squares is wrong by up to (\d+) %", report.stopped_because)
    wrong = abs(report.model.masses[0] / m - 1)
    assert said and wrong > 0.03 and 0.3 * wrong < int(said[1]) / 100 < 3 * wrong
    again = NRFRegressor(laws=report.model.laws, estimation="iv").fit(noisy)
    assert abs(again.masses_[0] / m - 1) < 0.3 * wrong


@pytest.mark.parametrize("hold", ["linear", "cubic"])
def test_surrogates_are_no_louder_than_what_was_measured(hold):
    """Displacement alone, and a force with half of its power above a tenth of the rate: straight lines lose some of it.

    Surrogates with straight lines between the forces leave 5 % of a balance, whatever was measured.
    """
    F = excitation.band_limited_random(1, 40.0, FS, dofs=[1], rms=300.0, band=(3.0, 25.0), random_state=5)
    linear = laws.LinearViscous, laws.LinearElastic
    truth = ChainModel([900.0], {1: [linear[0](1800.0), linear[1](9e5)]})
    rec = add_noise(simulate(truth, F, 1 / FS, hold=hold), 1e-4, random_state=0).replace(acceleration=None, velocity=None)
    ready = prepare(rec)
    search, held = split(ready.data.segments, ready.heldout)
    work = Workspace(ready.data, [None], search, held, {}, "auto")
    stage = Stage(work, Chain(1), {Site("storey 1"): (linear[0](), linear[1]())})
    null, left = Null(ready, stage, np.random.default_rng(0), 2), float(np.median(stage.trial().fold_errors()))
    assert (left > 4.0) == (hold == "linear") and 0.5 * left < null.floor < 1.5 * left
    assert hold == "linear" or null.error < 0.01


def test_blocks_in_which_the_hammer_rests_are_joined_to_those_in_which_it_hits():
    F = excitation.impact_hammer(1, 60.0, 200.0, dofs=[1], level=500.0, n_hits=5, random_state=1)
    rec = simulate(ChainModel([100.0], {1: [laws.LinearViscous(60.0), laws.LinearElastic(4e4)]}), F, 1 / 200)
    ready = prepare(add_noise(rec, 0.01, random_state=0))
    search, held = split(ready.data.segments, ready.heldout)
    energy = np.array([(ready.data.segments[0].F[b.rows] ** 2).sum() for b in search])
    assert (energy > 0.01 * energy.sum()).sum() >= len(search) - 1  # all but what has held-out pieces on both sides
    plain = [BlockRows(0, slice(k * 1200, (k + 1) * 1200)) for k in range(10)]
    joined = awake(plain, ready.data.segments)
    rows = np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in joined])
    assert 4 <= len(joined) < 10 and np.array_equal(rows, np.arange(12000))


def test_a_velocity_that_reads_too_much_is_found_in_a_hammer_test():
    """Between the blows the balance of a single floor is noise alone, and no block is judged by that."""
    F = excitation.impact_hammer(1, 160.0, 50.0, dofs=[1], level=60.0, n_hits=5, width=0.1, random_state=1)
    rec = simulate(ChainModel([100.0], {1: [laws.LinearViscous(80.0), laws.LinearElastic(2.2e4)]}), F, 1 / 50)
    rec = add_noise(rec, 0.01, random_state=0)
    report = close_loop(rec.replace(velocity=1.25 * rec.velocity), NRFRegressor(degree=1))
    assert [(s.law, s.site) for s in report.steps] == [("gain_error", "sensor v1")]
    assert report.steps[0].parameters["e"] == pytest.approx(0.25, abs=0.02)


def test_the_friction_that_noise_halves_is_told_from_the_samples_away_from_rest():
    """Signs of a noisy rate are wrong near rest: least squares takes a third of the friction for viscous damping."""
    held = [laws.LinearElastic(1.92e5), laws.LinearViscous(436.0), laws.CoulombFriction(30.0)]
    truth = ChainModel([17.8, 28.8], {1: [laws.LinearElastic(7.16e4), laws.LinearViscous(139.0)], 2: held})
    F = excitation.band_limited_random(2, 16.0, 500.0, dofs=2, rms=200.0, band=(1, 60), random_state=3)
    record = add_noise(simulate(truth, F, 1 / 500.0), 0.02, random_state=53)
    report = close_loop(record, baseline=NRFRegressor(degree=1), catalogue=[laws.CoulombFriction()])
    (step,) = report.steps
    assert step.law == "coulomb_friction" and step.site == "storey 2"
    low, high = step.intervals["Fc"]
    assert step.parameters["Fc"] == pytest.approx(30.0, rel=0.1) and low < 1.03 * 30.0 and high > 0.97 * 30.0
    plain = re.search(r"without the samples next to rest, .* \(with them Fc = ([\d.]+)\)", step.evidence)
    assert plain and float(plain[1]) < 0.8 * 30.0
