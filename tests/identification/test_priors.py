"""Drawings determine what channels do not: priors with a spread, ties and values."""

import numpy as np
import pandas as pd
import pytest
from few_channels import (
    MASSES,
    STIFFNESS,
    frame,
    pushed,
    shaken,
    true_parameters,
    with_sensors,
)

from pysindy_nrf import NRFRegressor, Parameter
from pysindy_nrf.exceptions import BiasWarning, IdentifiabilityError

TRUTH = frame(3)
SPREAD = 0.05


@pytest.fixture(scope="module")
def record():
    """Three floors on a shaken base, two sensors, 0.5 % of noise."""
    ground = 2.0 * pushed(frame()).force[:, 3] / 100.0
    return with_sensors(shaken(TRUTH, ground, noise=0.005).window(0, 4), [2, 3])


@pytest.fixture(scope="module")
def drawings():
    """Priors of all masses and stiffnesses, each one standard deviation off."""
    true = true_parameters(3)
    signs = [1, -1, -1, 1, 1, -1]
    priors = {}
    for sign, (name, value) in zip(signs, true.items()):
        drawn = (1 + sign * SPREAD) * value
        priors[name] = Parameter(drawn, spread=SPREAD * value)
    return priors


def test_without_drawings_the_chain_is_refused(record):
    known = {3: MASSES[2]}

    with pytest.raises(IdentifiabilityError, match="4 of 5 combinations"):
        NRFRegressor(degree=1, known_masses=known).fit(record)


def test_channels_and_drawings_together_are_sharper_than_drawings(record, drawings):
    model = NRFRegressor(degree=1, constraints=drawings).fit(record)

    true = pd.Series(true_parameters(3))
    table = model.confidence_intervals().set_index("parameter").loc[true.index]
    half = (table.upper - table.lower) / 2 / true
    assert half.max() < 0.09  # by the drawings alone it is two spreads, 0.1
    assert half.min() < 0.05
    assert (np.abs(table.estimate / true - 1) < 1.5 * half).all()


@pytest.mark.slow
def test_ties_and_known_values_hold_to_six_digits(record, drawings):
    ties = {
        "storey *: v": Parameter(equal_to="storey 1: v"),
        "storey 2: s": Parameter(STIFFNESS[1]),
    }
    model = NRFRegressor(degree=1, constraints=drawings | ties).fit(record)

    forces = model.restoring_forces_
    damping = [force.coefficients["v"] for force in forces.values()]
    assert np.ptp(damping) < 1e-4 * 25.0
    stiffness = forces["storey 2"].coefficients["s"]
    assert stiffness == pytest.approx(STIFFNESS[1], rel=1e-5)


def test_a_contradicted_prior_is_named(drawings):
    wrong = {"storey 3: s": Parameter(2 * STIFFNESS[2], spread=3e3)}
    record = with_sensors(pushed(TRUTH), [3])

    with pytest.warns(BiasWarning, match="contradict storey 3: s"):
        NRFRegressor(degree=1, constraints=drawings | wrong).fit(record)
