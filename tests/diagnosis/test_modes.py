"""Modes at the measured amplitude, and how alike shapes are, beside theory."""

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.diagnosis import equivalent_modes, loops_of, modal_assurance
from pysindy_nrf.diagnosis.site_loops import SiteLoop

AMPLITUDE, OMEGA = 2e-3, 30.0  # m, rad/s


def harmonic_loop(model):
    """Two whole cycles of a harmonic drift."""
    t = np.linspace(0, 4 * np.pi / OMEGA, 4001)[:-1]
    s = AMPLITUDE * np.sin(OMEGA * t)
    v = AMPLITUDE * OMEGA * np.cos(OMEGA * t)
    force = model.restoring_forces[1](v, s)
    return SiteLoop("storey 1", "harmonic", t, s, v, force)


def test_a_cubic_spring_is_three_quarters_of_its_peak_stiffer():
    k, k3, m = 9e3, 1.2e9, 10.0
    model = ChainModel([m], {1: [laws.Duffing(k, k3)]})

    mode = equivalent_modes(model, [harmonic_loop(model)]).loc[1]

    stiffness = k + 0.75 * k3 * AMPLITUDE**2
    assert mode["frequency"] == pytest.approx(np.sqrt(stiffness / m) / (2 * np.pi))
    assert mode["damping"] == pytest.approx(0.0, abs=1e-9)


def test_a_friction_damps_as_much_as_its_loop_dissipates():
    """4 Fc A a cycle, as a dashpot of 4 Fc / (pi A omega)."""
    k, m, fc = 9e3, 10.0, 6.0
    friction = [laws.LinearElastic(k), laws.CoulombFriction(fc)]
    model = ChainModel([m], {1: friction})

    mode = equivalent_modes(model, [harmonic_loop(model)]).loc[1]

    dashpot = 4 * fc / (np.pi * AMPLITUDE * OMEGA)
    assert mode["damping"] == pytest.approx(dashpot / (2 * np.sqrt(k * m)), rel=1e-3)


def test_a_linear_chain_has_the_same_modes_at_every_amplitude():
    storey = [laws.LinearViscous(20.0), laws.LinearElastic(3e4)]
    model = ChainModel([10.0, 8.0], {1: storey, 2: storey})
    F = excitation.band_limited_random(
        2, 6.0, 500.0, excited=[2], rms=50.0, band=(1, 40), random_state=0
    )
    fitted = NRFRegressor(degree=1).fit(simulate(model, F, 1 / 500))

    loops = loops_of(fitted.model_, fitted.fit_data("Fit again."))

    pd.testing.assert_frame_equal(
        equivalent_modes(fitted.model_, loops), fitted.modes(), rtol=1e-6, atol=1e-6
    )


def test_shapes_of_equal_floors_are_orthogonal_and_scale_and_sign_count_for_nothing():
    storey = [laws.LinearElastic(3e4)]
    modes = ChainModel([10.0, 10.0], {1: storey, 2: storey}).modes()
    scaled = modes.assign(
        **{"dof 1": -3 * modes["dof 1"], "dof 2": -3 * modes["dof 2"]}
    )

    assert modal_assurance(modes, scaled).to_numpy() == pytest.approx(np.eye(2))
