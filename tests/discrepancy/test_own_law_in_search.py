"""A law declared outside the package takes part in the search with all rights."""

import numpy as np
import pytest

from pysindy_nrf import ChainModel, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise


class PowerSpring(laws.ForceLaw):
    """Spring of any power, ``R = k sgn(s) |s|^p``, which contains the cubic spring."""

    name = "own_power_spring"
    family = "stiffness"
    shapes = (laws.Shape("p", "1", 1.3, 6.0),)
    passive = True
    variable = "s"
    special_cases = {
        laws.CubicStiffness: lambda cubic: PowerSpring(p=3.0, k=cubic.values[0])
    }

    def __init__(self, p: float | None = None, k: float | None = None) -> None:
        super().__init__({"p": p}, {"k": k})

    def terms(self):
        return (laws.Term("k", "sgn(s) |s|^p", "N/m^p"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(s) * np.abs(s) ** theta[0]


class UndeclaredPowerSpring(PowerSpring):
    """The same law without its special case."""

    name = "own_undeclared_power_spring"
    special_cases = {}


class ResistingSpring(PowerSpring):
    """The same law with a coefficient that cannot be negative."""

    name = "own_resisting_spring"
    special_cases = {}
    nonnegative = ("k",)


SPRINGS = [
    laws.QuadraticStiffness(),
    laws.CubicStiffness(),
    laws.QuinticStiffness(),
    laws.CoulombFriction(),
]


def steps_with(law, catalogue, noise=0.0):
    """One step of a search on a chain of two masses with a law in storey 2."""
    linear = [laws.LinearElastic(2e5), laws.LinearViscous(80.0)]
    truth = ChainModel([12.0, 12.0], {1: linear, 2: [*linear, law]})
    F = excitation.band_limited_random(
        2, 16.0, 500.0, excited=2, rms=60.0, band=(1.0, 40.0), random_state=1
    )
    record = simulate(truth, F, 1 / 500)
    if noise:
        record = add_noise(record, noise, random_state=0)
    return close_loop(record, catalogue=catalogue, max_steps=1).steps


def spring(p, force):
    """A spring of a power with a force at a drift of 1 mm, N."""
    return PowerSpring(p=p, k=force / 1e-3**p)


def test_a_law_of_the_user_is_found():
    (step,) = steps_with(spring(4.0, 60.0), [*SPRINGS, PowerSpring()])
    assert (step.law, step.family) == ("own_power_spring", "stiffness")
    assert step.site == "storey 2"
    assert step.shape["p"] == pytest.approx(4.0, rel=1e-3)


@pytest.mark.slow
def test_a_special_case_that_the_data_cannot_tell_from_it_is_taken_or_named():
    (step,) = steps_with(spring(3.05, 60.0), [*SPRINGS, PowerSpring()], noise=0.01)
    names = {law for law, _, _ in step.rivals} | {step.law}
    assert step.site == "storey 2"
    assert "cubic_stiffness" in names


@pytest.mark.parametrize(
    ("law", "accepted"), [(UndeclaredPowerSpring, True), (ResistingSpring, False)]
)
def test_a_sign_that_it_rules_out_is_not_accepted(law, accepted):
    steps = steps_with(spring(3.0, -4.0), [law()], noise=0.01)
    assert any(step.law == law.name for step in steps) == accepted
