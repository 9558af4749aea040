"""Errors of the channels, fitted beside a model."""

import numpy as np
import pytest
from loop_parts import first_state, freed_of_errors
from simulated_cases import Plan, simulated

from pysindy_nrf import Record, close_loop, laws
from pysindy_nrf.discrepancy import judge

GAINS = {"gain": 0.02}


def state_of(noise):
    """The linear chain of three forced floors."""
    return first_state(Plan(3, (1, 2, 3), noise=noise, seed=75, n_samples=4000))


def with_force_divided(model, divisor):
    """The model fitted to records whose first force is divided by a number."""
    data = model.spectra.data
    segment = data.data.segments[0]
    change = segment.F[:, 0] * (1 / divisor - 1)
    moved = type(data.data)([segment.moved(1, F=change)], data.data.n_samples)
    return model.on_motions(moved)


@pytest.mark.parametrize(("is_known", "undone"), [(True, True), (False, False)])
def test_errors_undo_a_fault_that_was_found_at_a_wrong_size(is_known, undone):
    """A force wrongly divided by 1.1, and gains of 2 %: a known fault is as uncertain
    as it is large.
    """
    state = state_of(noise=0.002)
    wrong = with_force_divided(state.model, 1.1)
    assert wrong.reduction_from(state.model).value < -10

    faults = [(laws.GainError(0.1), "F1")] if is_known else []
    freed, _ = freed_of_errors(state, wrong, GAINS, faults)
    lost = -freed.reduction_from(state.model).value
    assert (lost < judge.JUDGE.least_reduction) is undone


def test_a_gain_common_to_all_forces_explains_nothing():
    """No mass is known: it scales the chain, and what is left of the force with it."""
    state = state_of(noise=0.01)
    _, sizes = freed_of_errors(state, state.model, GAINS)
    forces = [sizes[channel] for channel in ("F1", "F2", "F3")]
    # standard deviations
    assert np.abs(forces).max() < 0.2


def test_a_tie_that_alone_explains_what_errors_of_all_channels_would_is_claimed():
    """Without noise a tie of 4 % of the force leaves nothing; so would a hundred errors
    of up to a percent together.
    """
    plan = Plan(6, (1, 2, 3, 4, 5, 6), effects=(("ground_link", 3, 0, 0.04),), seed=72)
    record = Record(**simulated(plan).channels)
    report = close_loop(record, catalogue=[laws.LinkSpringDashpot()], max_steps=1)
    (step,) = report.steps
    assert (step.law, step.site) == ("link_spring_dashpot", "ground 3")
