"""Noise is called noise at the nominal rate, whatever its colour; linear and nonlinear
effects are told apart.
"""

from dataclasses import replace

import numpy as np
import pytest
from chains import duffing, floor_of_noise, integrate, parameters
from scipy.stats import binom

from pysindy_nrf import ChainModel, NRFRegressor, Record, laws
from pysindy_nrf.diagnosis import NoiseFloor, ResidualKind, detect, residual_of
from pysindy_nrf.records import filters_of, from_arrays

pytestmark = pytest.mark.slow

RUNS = 50
ALL = [1, 2, 3]


def linear_case(n, forced, seed, n_samples=6000, **options):
    """A linear chain, with what ``duffing`` adds to it."""
    m, c, k, _ = parameters(n, np.random.default_rng(seed), cubic=False)
    linear = m, c, k, np.zeros(n)
    return duffing(
        n, forced, seed=seed, n_samples=n_samples, parameters_of_chain=linear, **options
    )


def linear_residual(case):
    """What a linear chain leaves that is fitted to a case."""
    regressor = NRFRegressor(degree=1, dt=case.dt).fit(case.X, case.F)
    return residual_of(regressor.model_, from_arrays(case.X, case.F, dt=case.dt))


@pytest.mark.parametrize("band", [None, (2.0, 60.0)])
def test_white_noise_of_a_known_size_is_noise_whatever_the_band(band):
    case = linear_case(1, [1], 0, n_samples=2500)
    data = from_arrays(case.X, case.F, dt=case.dt)
    model = ChainModel(case.m, {1: [laws.LinearElastic(case.k[0])]})
    residual = residual_of(model, data, filters_of(band, data))
    (filter_,) = residual.filters

    rng, alarms = np.random.default_rng(1), 0
    for _ in range(RUNS):
        noise = rng.standard_normal((2, 2500, 1))
        if filter_ is not None:
            noise = [filter_.apply(line) for line in noise]
        residual_of_noise = replace(residual, balance=[noise[0]])
        floor = NoiseFloor.from_draws([replace(residual, balance=[noise[1]])])
        alarms += not detect(residual_of_noise, floor).is_noise
    assert alarms <= binom.ppf(0.999, RUNS, 0.05)


def test_a_cubic_spring_is_nonlinear():
    case = duffing(3, ALL, seed=1, n_samples=6000)
    verdicts = detect(linear_residual(case)).verdicts
    assert verdicts.loc["storey 2", "verdict"] == ResidualKind.NONLINEAR


def test_friction_is_nonlinear():
    """Regularised, for an integrator without events."""

    def friction(x, v):
        force = 8.0 * np.tanh((v[..., 1] - v[..., 0]) / 1e-4)
        out = np.zeros_like(x)
        out[..., 1] = -force
        out[..., 0] = force
        return out

    detection = detect(
        linear_residual(linear_case(3, ALL, 2, extra=friction, substeps=4))
    )
    assert not detection.is_noise
    storey = detection.verdicts.loc["storey 2"]
    assert storey["verdict"] == ResidualKind.NONLINEAR
    assert storey["nonlinear share"] > 0.9


def test_a_brace_is_linear():
    def brace(x, v):
        force = 2e4 * (x[..., 2] - x[..., 0])
        return np.stack([force, 0 * force, -force], axis=-1)

    detection = detect(linear_residual(linear_case(3, ALL, 3, extra=brace)))
    ends = detection.verdicts.loc[["dof 1", "dof 3"]]
    assert set(ends["verdict"]) == {ResidualKind.LINEAR}
    assert (ends["linear share"] > 0.99).all()


@pytest.fixture(scope="module")
def unmeasured_force():
    """A chain of two floors with a motor on the second that nobody measures."""
    case = linear_case(2, [1, 2], 4)
    t = np.arange(len(case.F)) * case.dt
    hidden = np.column_stack([0 * t, 30 * np.cos(2 * np.pi * 23.7 * t)])
    motion = integrate(case.m, case.c, case.k, case.k3, case.F + hidden, case.dt)
    storeys = {}
    for i in range(2):
        spring = laws.LinearElastic(case.k[i])
        storeys[i + 1] = [laws.LinearViscous(case.c[i]), spring]
    noise = np.random.default_rng(0).standard_normal((len(t), 2))
    data = from_arrays(np.hstack(motion), case.F + noise, dt=case.dt)
    return residual_of(ChainModel(case.m, storeys), data)


def test_unmeasured_force_is_tied_to_no_measured_signal(unmeasured_force):
    floor = NoiseFloor(np.ones(2), np.ones(2))
    verdicts = detect(unmeasured_force, floor).verdicts["verdict"]
    assert verdicts["dof 2"] == ResidualKind.UNMEASURED
    assert verdicts["dof 1"] == ResidualKind.NOISE


def test_noise_that_is_not_known_is_not_told_from_a_force(unmeasured_force):
    verdicts = detect(unmeasured_force).verdicts["verdict"]
    assert verdicts["dof 1"] == ResidualKind.UNMEASURED


def noisy_record(case, level, seed):
    """A record with noise of a share of the rms on every channel, and its levels."""
    rng = np.random.default_rng(seed)
    clean = {
        "force": case.F,
        "acceleration": case.a,
        "velocity": case.v.cumsum(axis=1),
        "displacement": case.s.cumsum(axis=1),
    }
    noisy, levels = {}, {}
    for name, lines in clean.items():
        levels[name] = level * np.sqrt((lines**2).mean(axis=0))
        noisy[name] = lines + levels[name] * rng.standard_normal(lines.shape)
    return Record(**noisy, fs=1 / case.dt), levels


@pytest.mark.parametrize("level", [0.01, 0.05])
@pytest.mark.parametrize(
    ("cubic", "wanted"),
    [(False, ResidualKind.NOISE), (True, ResidualKind.NONLINEAR)],
)
def test_fused_noise_is_noise_beside_its_floor_and_a_cubic_is_not(cubic, wanted, level):
    case = duffing(2, [1, 2], seed=5, n_samples=6000, cubic=cubic)
    rec, levels = noisy_record(case, level, 0)
    X, F = rec.to_features()
    model = NRFRegressor(degree=1).fit(X, F).model_
    floor = floor_of_noise(model, rec, levels)
    verdicts = detect(residual_of(model, from_arrays(X, F)), floor).verdicts
    assert verdicts.loc["dof 2", "verdict"] == wanted
    if not cubic:
        assert (verdicts["floor ratio"] < 1.3).all()


def test_rounding_is_noise():
    assert detect(linear_residual(linear_case(2, [1, 2], 6))).is_noise


def alarms_of(n, forced, seed):
    """Balances of a linear chain with 5 % noise in which more than noise is seen."""
    case = linear_case(n, forced, 40 + seed, n_samples=2500)
    rec, levels = noisy_record(case, 0.05, seed)
    X, F = rec.to_features()
    regressor = NRFRegressor(degree=1).fit(X, F)
    floor = floor_of_noise(regressor.model_, rec, levels, regressor, seed=seed)
    residual = residual_of(regressor.model_, from_arrays(X, F))
    verdicts = detect(residual, floor).verdicts["verdict"]
    balances = verdicts[[f"dof {j + 1}" for j in range(n)]]
    return int((balances != ResidualKind.NOISE).sum())


def test_noise_is_noise_beside_a_floor_that_was_fitted_as_the_model_was():
    """Noise of 5 % on every channel biases the fit; alarms come at the level, one in
    twenty balances.
    """
    alarms = alarms_of(1, [1], 0) + alarms_of(2, [1, 2], 1) + alarms_of(3, [1], 2)
    alarms += alarms_of(1, [1], 3) + alarms_of(2, [1], 4)
    assert alarms <= binom.ppf(0.999, 1 + 2 + 3 + 1 + 2, 0.05)


def test_hysteresis_of_an_element_without_mass_is_no_linear_effect():
    """``F = k s + slider``: the residual is F less a spring, and so a linear function
    of F and s, which says nothing.
    """
    path = np.linspace(0.0, 150.0, 6000)
    s = 0.01 * np.sin(path) * np.abs(np.sin(np.linspace(0.1, 9.0, 6000)))
    v = np.gradient(s, 1e-2)
    slider = laws.Jenkins(uy=0.002, Fy=400.0).force(laws.Motion(s, v))
    X = np.column_stack([np.gradient(v, 1e-2), v, s])
    data = from_arrays(X, (3e4 * s + slider)[:, None], dt=1e-2)
    residual = residual_of(ChainModel([0.0], {1: [laws.LinearElastic(6e4)]}), data)
    floor = NoiseFloor(np.ones(1), np.ones(1))
    row = detect(residual, floor).verdicts.loc["dof 1"]
    assert row["verdict"] == ResidualKind.NONLINEAR
    assert row["nonlinear share"] > 0.3
