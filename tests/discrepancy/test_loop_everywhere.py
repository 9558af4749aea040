"""What the loop sees with few sensors, at unusual sites, and of what was declared wrongly."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pysindy_nrf import NRFRegressor, Record, close_loop, laws
from pysindy_nrf.exceptions import DataQualityWarning
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.slow

FS, M, K, C = 250.0, np.array([6.0, 5.0, 4.0]), np.array([5e4, 4e4, 3e4]), np.array([20.0, 15.0, 12.0])
SMALL = [
    laws.CoulombFriction(), laws.QuadraticDamping(), laws.CubicStiffness(), laws.OneSidedGap(), laws.LinkSpringDashpot(),
    laws.ConstantForce(), laws.AddedMass(), laws.Inerter(),
]  # fmt: skip


def quiet_loop(record, catalogue=SMALL, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return close_loop(record, NRFRegressor(degree=1, **options), catalogue=catalogue)


def integrated(force=None, seed=0, forced=3, duration=12.0):
    """Three floors by DOP853 under a sum of sines, with a force that acts on the DOFs besides: x, v -> (3,)."""
    rng = np.random.default_rng(seed)
    w, phase = 2 * np.pi * rng.uniform(1, 40, 60), rng.uniform(0, 2 * np.pi, 60)

    def F(t):
        return 12.0 * np.cos(np.multiply.outer(t, w) + phase).sum(axis=-1)

    def a_of(t, x, v):
        s, r = np.diff(x, prepend=0.0), np.diff(v, prepend=0.0)
        R = K * s + C * r
        left = R - np.append(R[1:], 0.0) + (0.0 if force is None else force(x, v))
        applied = np.zeros(3)
        applied[forced - 1] = F(t)
        return (applied - left) / M

    t = np.arange(int(duration * FS)) / FS
    run = solve_ivp(
        lambda t, y: np.concatenate([y[3:], a_of(t, y[:3], y[3:])]),
        (0, t[-1]),
        np.zeros(6),
        "DOP853",
        t,
        rtol=1e-9,
        atol=1e-12,
    )
    x, v = run.y[:3].T, run.y[3:].T
    a = np.array([a_of(*row) for row in zip(t, x, v)])
    applied = np.zeros((len(t), 3))
    applied[:, forced - 1] = F(t)
    return Record(force=applied, acceleration=a, velocity=v, displacement=x, fs=FS)


def beside(p, q, law):
    """A force between DOFs p and q (0: the ground) as a function of their relative motion."""

    def force(x, v):
        s, r = (y[p - 1] - (y[q - 1] if q else 0.0) for y in (x, v))
        out = np.zeros(3)
        out[p - 1] += law(s, r)
        if q:
            out[q - 1] -= law(s, r)
        return out

    return force


@pytest.mark.parametrize(
    "p, q, law, name, parameters",
    [
        (3, 0, lambda s, v: 300.0 * v * abs(v), "quadratic_damping", {"c2": 300.0}),
        (3, 1, lambda s, v: 2e4 * max(s - 1.5e-3, 0.0), "one_sided_gap", {"k": 2e4, "gap": 1.5e-3}),
        (2, 0, lambda s, v: 8e8 * s**3, "cubic_stiffness", {"k3": 8e8}),
    ],
)
def test_a_law_at_a_ground_tie_or_a_brace_that_nobody_declared_is_found_there(p, q, law, name, parameters):
    record = add_noise(integrated(beside(p, q, law)), 0.005, random_state=1)
    step = quiet_loop(record).steps[0]
    assert (step.law, step.site) == (name, f"link {p}-{q}" if q else f"ground {p}") and step.sure
    for key, value in parameters.items():
        assert step.parameters[key] == pytest.approx(value, rel=0.05)


@pytest.mark.parametrize("seed", [0, 1])
def test_accelerations_alone_of_a_linear_chain_give_its_masses_and_no_effect(seed):
    record = add_noise(integrated(seed=seed), 0.01, random_state=seed).replace(velocity=None, displacement=None)
    with pytest.warns(DataQualityWarning, match="tells the displacement above"):
        report = close_loop(record, NRFRegressor(degree=1), catalogue=SMALL)
    assert not report.steps and report.model.masses == pytest.approx(M, rel=0.02)
    low, high = report.band  # the report says from where on the motion is known
    assert 0.2 < low < 10.0 and high is None and report.table["band"].iloc[0].startswith(f"{low:g}-")


def test_accelerations_alone_show_a_nonlinear_storey():
    record = add_noise(integrated(beside(1, 0, lambda s, v: 1.5e9 * s**3)), 0.005, random_state=2)
    report = quiet_loop(record.replace(velocity=None, displacement=None))
    step = report.steps[0]
    assert (step.law, step.site) == ("cubic_stiffness", "storey 1")
    assert step.error_after < 0.6 * step.error_before and step.parameters["k3"] == pytest.approx(1.5e9, rel=0.25)


@pytest.mark.parametrize("dof", [1, 2])
def test_a_wrong_known_mass_of_a_floor_that_no_force_acts_on_is_named(dof):
    declared = dict(enumerate(M, 1)) | {dof: 1.25 * M[dof - 1]}
    report = quiet_loop(add_noise(integrated(), 0.005, random_state=3), known_masses=declared)
    step = report.steps[0]
    assert (step.law, step.site) == ("added_mass", f"dof {dof}")
    assert step.parameters["dm"] == pytest.approx(-0.25 * M[dof - 1], rel=0.05)


def test_the_gain_of_the_one_force_is_the_scale_of_the_known_masses():
    record = add_noise(integrated(), 0.005, random_state=4)
    report = quiet_loop(record.replace(force=1.3 * record.force), [laws.GainError()], known_masses={2: M[1]})
    (step,) = report.steps
    assert (step.law, step.site) == ("gain_error", "sensor F3")
    assert step.parameters["e"] == pytest.approx(0.3, abs=0.02)
    assert "the known masses (all alike)" in str(step) + report.to_markdown()


def test_what_a_linear_link_leaves_is_a_share_of_its_own_force():
    """Its force is a sum of terms that the storeys have: beyond them there is nothing to divide by."""
    record = add_noise(integrated(beside(3, 0, lambda s, v: 9e3 * s + 6.0 * v)), 0.005, random_state=5)
    step = quiet_loop(record).steps[0]
    assert (step.law, step.site) == ("link_spring_dashpot", "ground 3")
    assert 0.0 <= step.remainder < 1.0 and step.parameters["k"] == pytest.approx(9e3, rel=0.05)
