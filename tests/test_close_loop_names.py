"""A name is sure only where the data could have spoken against it."""

import numpy as np
import pytest

from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.discrepancy.steps import doubt_names, surely_left


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
