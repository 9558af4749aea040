"""What the loop does with fast forces, free chains, few steps, other baselines and faulty channels."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainModel, NRFRegressor, Site, close_loop, excitation, laws, simulate
from pysindy_nrf.exceptions import BiasWarning, ChannelError
from pysindy_nrf.noise import add_noise

FS = 500.0
LINEAR = [laws.LinearElastic(2e5), laws.LinearViscous(80.0)]


def forces(n, seconds=12.0, band=(0.5, 40.0), dofs=None):
    return excitation.band_limited_random(
        n, seconds, FS, dofs=dofs or list(range(1, n + 1)), rms=60.0, band=band, random_state=1
    )


def test_the_mains_are_heard_on_a_slow_structure():
    """Modes at 1.6 and 4.1 Hz, shaken up to 10 Hz, and a force of 50 Hz that nobody measured."""
    slow = [laws.LinearElastic(3e3), laws.LinearViscous(8.0)]
    truth = ChainModel([12.0, 12.0], {1: slow, 2: slow, "dof 2": [laws.HarmonicForce(50.0, 30.0, 10.0)]})
    rec = simulate(truth, forces(2, 20.0, (0.5, 10.0), [2]), 1 / FS)
    step = close_loop(rec, catalogue=[laws.HarmonicForce()], n_surrogates=1, max_steps=1).steps[0]
    assert step.site == "dof 2" and step.shape["frequency"] == pytest.approx(50.0, abs=1e-3)
    assert step.parameters["A"] == pytest.approx(30.0, rel=1e-3)


def test_a_dead_load_and_a_harmonic_force_on_one_floor_are_both_found():
    at_2 = [laws.ConstantForce(25.0), laws.HarmonicForce(31.0, 30.0, 10.0)]
    truth = ChainModel([12.0, 12.0], {1: LINEAR, 2: LINEAR, "dof 2": at_2})
    report = close_loop(
        simulate(truth, forces(2), 1 / FS), catalogue=[laws.ConstantForce(), laws.HarmonicForce()], n_surrogates=1
    )
    found = {s.law: s for s in report.steps}
    assert set(found) == {"constant_force", "harmonic_force"} and {s.site for s in report.steps} == {"dof 2"}
    assert found["constant_force"].parameters["f0"] == pytest.approx(25.0, rel=1e-3)
    assert report.table["held-out"].iloc[-1] < 0.01


@pytest.mark.parametrize("most", [1, 4])
def test_effects_that_pass_only_together_are_not_added_in_part(most):
    """A little friction in each of six storeys: what is added has itself passed the gate, and four together do."""
    truth = ChainModel([12.0] * 6, {i: [*LINEAR, laws.CoulombFriction(6.0)] for i in range(1, 7)})
    report = close_loop(
        simulate(truth, forces(6), 1 / FS), catalogue=[laws.CoulombFriction()], max_steps=most, n_surrogates=0
    )
    if most == 1:  # the best storey alone gains 11 %
        assert report.steps == [] and "15 % are asked" in report.stopped_because
        return
    assert [s.law for s in report.steps] == ["coulomb_friction"] * 4
    together = [s for s in report.steps if "together with" in s.evidence]
    whole = 1 - together[-1].validation_after / together[0].validation_before
    assert whole >= 0.15 and whole == pytest.approx(together[0].gain, abs=0.02)


def test_a_free_chain_may_turn_out_to_be_tied_to_the_ground():
    truth = ChainModel([12.0] * 3, {i: LINEAR for i in (1, 2, 3)})
    report = close_loop(
        simulate(truth, forces(3), 1 / FS),
        NRFRegressor(degree=1, chain=Chain(3, ground="free")),
        catalogue=[laws.LinkSpringDashpot()],
        n_surrogates=0,
    )
    assert [str(Site(s.site)) for s in report.steps] == ["storey 1"]
    assert report.table["held-out"].iloc[-1] < 0.01


@pytest.fixture(scope="module")
def rubbing():
    truth = ChainModel([12.0, 12.0], {1: LINEAR, 2: [*LINEAR, laws.CoulombFriction(20.0)]})
    return truth, simulate(truth, forces(2), 1 / FS)


def test_what_the_search_does_not_use_of_the_baseline_is_said(rubbing):
    with pytest.warns(BiasWarning, match="does not use estimation='iv' of the baseline"):
        close_loop(
            rubbing[1], NRFRegressor(degree=1, estimation="iv"), catalogue=[laws.CoulombFriction()], n_surrogates=0
        )
    with warnings.catch_warnings():
        warnings.simplefilter("error", BiasWarning)
        close_loop(rubbing[1], NRFRegressor(degree=1), catalogue=[laws.CoulombFriction()], n_surrogates=0)


def test_the_visited_region_is_that_of_the_search(rubbing):
    """The held-out record is eight times stronger: a force there is an extrapolation, and says so."""
    truth, small = rubbing
    strong = simulate(truth, 8 * forces(2), 1 / FS)
    report = close_loop(small, catalogue=[laws.CoulombFriction()], heldout=strong, n_surrogates=0)
    drift = np.diff(small.displacement, axis=1)[:, 0]
    region = report.model.visited[Site("storey 2")]
    assert region.high[1] <= 1.01 * drift.max()
    assert not region.contains(np.zeros(1), np.array([4 * drift.max()]))[0]


def test_without_surrogates_none_are_spoken_of(rubbing, tmp_path):
    pytest.importorskip("plotly")
    report = close_loop(rubbing[1], catalogue=[laws.CoulombFriction()], n_surrogates=0)
    assert np.isnan(report.steps[0].null_gain)
    report.to_html(tmp_path / "page.html")
    assert "On surrogates" not in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "surrogates with the noise" not in str(report.settings)


def test_what_was_measured_is_shown_as_it_was_measured():
    """F2 reads 30 % too much: the table of the channels shows that, not what the loop made of it."""
    truth = ChainModel([12.0, 12.0], {1: LINEAR, 2: LINEAR})
    rec = add_noise(simulate(truth, forces(2, 16.0), 1 / FS), 0.005, random_state=3)
    force = rec.force * np.array([1.0, 1.3])
    report = close_loop(rec.replace(force=force), catalogue=[laws.GainError()], n_surrogates=1)
    assert report.steps[0].site in ("sensor F1", "sensor F2")  # masses are unknown: only their ratio can be told
    shown = report.measured[0].channels.set_index("channel")["rms"]
    np.testing.assert_allclose(shown[["F1", "F2"]].astype(float), np.sqrt(np.mean(force**2, axis=0)), rtol=1e-3)


def test_a_held_out_record_without_the_covariate_is_named_before_the_search(rubbing):
    rec = rubbing[1].replace(covariates={"u": np.linspace(0, 1, rubbing[1].n_samples)})
    baseline = NRFRegressor(laws={2: [laws.PowerSeries(1), laws.CovariateFriction(covariate="u")]}, degree=1)
    with pytest.raises(ChannelError, match="Record 'later' has no covariate 'u', which covariate_friction"):
        close_loop(rec, baseline, catalogue=[laws.CubicStiffness()], heldout=rubbing[1].replace(name="later"))
    tried = [laws.CovariateFriction(covariate="u"), laws.CoulombFriction()]
    report = close_loop(rec, catalogue=tried, heldout=rubbing[1].replace(name="later"), n_surrogates=0)
    assert [s.law for s in report.steps] == ["coulomb_friction"]
