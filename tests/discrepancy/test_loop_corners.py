"""What the loop does with fast forces, free chains, few steps, other baselines, faulty channels, two laws of a family."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainModel, NRFRegressor, Site, close_loop, excitation, laws, simulate
from pysindy_nrf.exceptions import BiasWarning, ChannelError
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.slow

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


SOFT = [laws.LinearElastic(2e4), laws.LinearViscous(20.0)]


def shaken(effects, n=1, noise=0.0, rms=30.0, sensors=None):
    """A soft chain with effects in its top storey or on its top floor, 20 s at 200 Hz, all floors forced."""
    at = {f"storey {n}": [], f"dof {n}": []}
    for law in effects:
        at[f"dof {n}" if law.acts_at == ("dof",) else f"storey {n}"].append(law)
    storeys = {f"storey {i}": [*SOFT, *at.pop(f"storey {i}", [])] for i in range(1, n + 1)}
    truth = ChainModel([12.0] * n, {**storeys, **at, **(sensors or {})})
    every = list(range(1, n + 1))
    F = excitation.band_limited_random(n, 20.0, 200.0, dofs=every, rms=rms, band=(0.5, 15.0), random_state=0)
    return add_noise(simulate(truth, F, 1 / 200), noise, random_state=3)


def found_at(report):
    return sorted((s.law, s.site) for s in report.steps)


@pytest.mark.parametrize(
    ("k2", "k3", "catalogue", "n", "noise"),
    [
        (6e5, 1e8, [laws.QuadraticStiffness(), laws.CubicStiffness()], 1, 0.0),
        # a dead zone comes nearer to s^2 and s^3 than either of them alone
        (8e5, 3e8, [laws.QuadraticStiffness(), laws.CubicStiffness(), laws.DeadZone()], 2, 0.01),
    ],
    ids=["one after the other", "before a stand-in"],
)
def test_a_spring_that_is_quadratic_and_cubic_ends_with_both_terms(k2, k3, catalogue, n, noise):
    rec = shaken([laws.QuadraticStiffness(k2), laws.CubicStiffness(k3)], n, noise, rms=20.0)
    report = close_loop(rec, catalogue=catalogue, n_surrogates=1)
    assert found_at(report) == [("cubic_stiffness", f"storey {n}"), ("quadratic_stiffness", f"storey {n}")]
    found = {k: v for s in report.steps for k, v in s.parameters.items()}
    assert found["k2"] == pytest.approx(k2, rel=0.02) and found["k3"] == pytest.approx(k3, rel=0.02)
    assert all(s.intervals for s in report.steps)


def test_two_gaps_of_different_width_are_two_laws():
    """Each step tells of its own: the stiff one is heard first."""
    wide, narrow = laws.TwoSidedGap(0.008, 3e4), laws.TwoSidedGap(0.002, 1e4)
    report = close_loop(shaken([wide, narrow], rms=60.0), catalogue=[laws.TwoSidedGap()], n_surrogates=1)
    assert found_at(report) == [("two_sided_gap", "storey 1")] * 2
    for step, true in zip(report.steps, (wide, narrow)):
        assert step.parameters == pytest.approx(true.parameters, rel=0.01)
        low, high = step.intervals["gap"]
        assert low == pytest.approx(true.shape["gap"], rel=0.02) == high
    held = [law.shape["gap"] for law in report.model.laws[Site("storey 1")] if law.name == "two_sided_gap"]
    assert held == [s.parameters["gap"] for s in report.steps]


def test_two_harmonic_forces_on_one_floor_are_both_found():
    true = {23.7: 14.0, 31.0: 9.0}  # Hz, N
    rec = shaken([laws.HarmonicForce(f, A, 0.0) for f, A in true.items()], 2)
    report = close_loop(rec, catalogue=[laws.HarmonicForce()], n_surrogates=1)
    assert found_at(report) == [("harmonic_force", "dof 2")] * 2
    found = {s.parameters["frequency"]: np.hypot(s.parameters["A"], s.parameters["B"]) for s in report.steps}
    for (f, size), (true_f, true_size) in zip(sorted(found.items()), sorted(true.items())):
        assert f == pytest.approx(true_f, abs=2e-3) and size == pytest.approx(true_size, rel=0.02)


@pytest.mark.parametrize("law", [laws.CubicStiffness(3e8), laws.TwoSidedGap(0.003, 2e4)])
def test_one_law_gets_no_company_of_its_family(law):
    """Noise of 1 %, and four further springs, as many gaps, that could stand beside it."""
    rec = shaken([law], 2, 0.01)
    catalogue = [laws.QuadraticStiffness(), laws.AbsoluteQuadraticStiffness(), laws.CubicStiffness(),
                 laws.QuinticStiffness(), laws.TwoSidedGap(), laws.OneSidedGap(), laws.DeadZone()]  # fmt: skip
    report = close_loop(rec, catalogue=catalogue, n_surrogates=1)
    assert found_at(report) == [(law.name, "storey 2")]
    assert report.steps[0].parameters == pytest.approx(law.parameters, rel=0.05)


def test_a_gain_found_in_two_steps_is_one_fault():
    """F2 is late and reads 30 % too much; the gain is told exactly only once the delay is out of the way."""
    faults = {"sensor F2": [laws.ChannelDelay(0.004), laws.GainError(0.3)]}
    rec = shaken([], 2, 0.005, sensors=faults, rms=60.0)
    report = close_loop(rec, catalogue=[laws.ChannelDelay(), laws.GainError()], n_surrogates=1)
    assert [(s.law, s.site) for s in report.steps] == [("gain_error", "sensor F2"), ("channel_delay", "sensor F2")]
    gain, delay = report.steps
    assert gain.parameters["e"] == pytest.approx(0.3, rel=0.02)
    assert delay.parameters["tau"] == pytest.approx(0.004, rel=0.02)
    assert gain.evidence.count("corrected again") == delay.evidence.count("corrected again") == 1
    ends = report.table["held-out"].to_numpy()
    assert [gain.error_before, gain.error_after, delay.error_after] == ends.tolist() and ends[-1] < 2.0
    assert len(report.models) == len(report.evidence) == 3


