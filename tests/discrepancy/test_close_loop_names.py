"""A name is sure only where the data could have spoken against it."""

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, Site, close_loop, excitation, laws, simulate
from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.discrepancy.steps import doubt_names, surely_left
from pysindy_nrf.simulation.noise import add_noise


def step(law, family, site="storey 2", before=10.0, after=2.0, **more):
    return Step(law, family, site, validation_before=before, validation_after=after, noise_floor=1.0, **more)


@pytest.mark.parametrize(
    ("one", "two", "sure"),
    [
        (("coulomb_friction", "friction"), ("stribeck_friction", "friction"), False),  # one curve of the rate
        (("two_sided_gap", "contact"), ("cubic_stiffness", "stiffness"), False),  # one curve of the drift
        (("power_law_damping", "damping"), ("constant_force", "forcing"), False),  # a damper that is not symmetric
        (("coulomb_friction", "friction"), ("constant_force", "forcing"), True),  # asymmetric friction, to the letter
        (("coulomb_friction", "friction"), ("cubic_stiffness", "stiffness"), True),  # of different variables
    ],
)
def test_two_laws_of_one_variable_at_one_site_are_a_description(one, two, sure):
    steps = [step(*one, after=5.0), step(*two, before=5.0, after=1.0)]
    doubt_names(steps)
    assert all(s.sure is sure for s in steps)
    assert ("one law that is not in the catalogue" in steps[0].sentence) is not sure
    if not sure:  # what the first leaves alone: of 10 % over a noise of 1 %, 5 %
        assert steps[0].remainder == pytest.approx(np.sqrt(24 / 99))
        assert "closest law" in steps[0].sentence and "49 %" in steps[0].sentence


def test_laws_at_different_sites_stand_for_themselves():
    steps = [step("coulomb_friction", "friction"), step("quadratic_damping", "damping", "storey 3")]
    doubt_names(steps)
    assert all(s.sure and not s.company for s in steps)


def test_an_offset_beside_friction_may_be_its_asymmetry():
    steps = [step("coulomb_friction", "friction", "storey 1"), step("constant_force", "forcing", "dof 1")]
    doubt_names(steps)
    assert steps[1].alternatives == ["friction"] and steps[0].alternatives == []


def test_a_power_that_may_be_zero_may_be_friction():
    near, far = ([step("power_law_damping", "damping", intervals={"n": (low, 0.5)})] for low in (0.1, 0.35))
    doubt_names(near), doubt_names(far)
    assert near[0].alternatives == ["friction"] and far[0].alternatives == []


def test_what_is_left_counts_when_it_stands_out_block_by_block():
    """Blocks are loud or quiet together: beside their own noise an excess of 20 % is plain, in their median it is not."""
    rng = np.random.default_rng(0)
    loudness = np.exp(rng.normal(0, 0.8, 10))
    noise = [loudness * np.exp(rng.normal(0, 0.03, 10)) for _ in range(2)]
    left = 1.2 * loudness * np.exp(rng.normal(0, 0.03, 10))
    least = surely_left(left, noise)
    assert np.median(left) / 1.1 < least < np.median(left)
    assert surely_left(left, []) == np.median(left)


@pytest.mark.slow
def test_a_hysteresis_with_a_knee_of_its_own_takes_the_place_of_the_simpler_one():
    """Bouc-Wen under an earthquake: Dahl does most of the work and goes first, and is not mended by a second element."""
    fs = 200.0
    held = {
        1: [laws.LinearElastic(8.5e4), laws.LinearViscous(400.0)],
        2: [laws.LinearElastic(7e4), laws.LinearViscous(200.0)],
    }
    held[1].append(laws.BoucWen(beta=300.0, rho=0.0, n=1.5, alpha=4e4))
    truth = ChainModel([12.0, 9.0], held)
    t = np.arange(int(30 * fs)) / fs
    shaking = excitation.band_limited_random(1, 30.0, fs, dofs=[1], rms=1.5, band=(0.3, 12.0), random_state=3)[:, 0]
    ag = shaking * (t / 8 * np.exp(1 - t / 8)) ** 2
    record = add_noise(simulate(truth, np.zeros((len(t), 2)), 1 / fs, base_acceleration=ag), 0.01, random_state=0)
    baseline = NRFRegressor(degree=1, known_masses={1: 12.0, 2: 9.0})
    report = close_loop(record, baseline=baseline, catalogue=[laws.Dahl(), laws.Jenkins(), laws.Iwan(), laws.BoucWen()])
    last = report.steps[-1]
    assert (last.law, last.site) == ("bouc_wen", "storey 1")
    assert [law.name for law in report.model.laws[Site("storey 1")]].count("jenkins") == 0
    for name, true in {"beta": 300.0, "n": 1.5, "alpha": 4e4}.items():
        low, high = last.intervals[name]
        assert last.parameters[name] == pytest.approx(true, rel=0.1) and low - 0.02 * true < true < high + 0.02 * true
