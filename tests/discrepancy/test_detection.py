"""Noise is called noise at the nominal rate, whatever its colour; linear and nonlinear
effects are told apart.
"""

import dataclasses

import numpy as np
import pytest
from chains import duffing, floor_of_noise, parameters
from pysindy_nrf.discrepancy.evidence import detect
from pysindy_nrf.discrepancy.words import ResidualKind
from scipy.stats import binom

from pysindy_nrf import ChainModel, NRFRegressor, Record, laws
from pysindy_nrf.discrepancy.residual import NoiseFloor, residual_of
from pysindy_nrf.records.input_arrays import from_arrays
from pysindy_nrf.records.zero_phase_filter import filters_of

pytestmark = pytest.mark.slow

RUNS = 50


def linear_case(n, forced, seed, n_samples=6000, extra=None, cubic=0.0, substeps=1):
    m, c, k, _ = parameters(n, np.random.default_rng(seed), cubic=False)
    return duffing(
        n,
        forced,
        seed=seed,
        n_samples=n_samples,
        given=(m, c, k, np.full(n, cubic)),
        extra=extra,
        substeps=substeps,
    )


def fitted(case, F=None, **options):
    F = case.F if F is None else F
    regressor = NRFRegressor(degree=1, dt=case.dt, **options).fit(case.X, F)
    return residual_of(regressor.model_, from_arrays(case.X, F, dt=case.dt))


@pytest.mark.parametrize("band", [None, (2.0, 60.0)])
def test_white_noise_of_a_known_size_is_noise_whatever_the_band(band):
    case = linear_case(1, [1], 0, n_samples=2500)
    data = from_arrays(case.X, case.F, dt=case.dt)
    model = ChainModel(case.m, {1: [laws.LinearElastic(case.k[0])]})
    residual = residual_of(model, data, filters_of(band, data))
    rng, alarms = np.random.default_rng(1), 0
    filter = residual.filters[0]
    for _ in range(RUNS):
        e, other = rng.standard_normal((2, 2500, 1))
        e, other = (x if filter is None else filter.apply(x) for x in (e, other))
        noisy = dataclasses.replace(residual, balance=[e])
        floor = NoiseFloor.from_draws([dataclasses.replace(residual, balance=[other])])
        alarms += not detect(noisy, floor).is_noise
    assert alarms <= binom.ppf(0.999, RUNS, 0.05)


def coulomb(force, storey, n, width):
    """Regularised Coulomb friction, for an integrator without events."""

    def extra(x, v):
        f = force * np.tanh(
            (v[..., storey - 1] - (v[..., storey - 2] if storey > 1 else 0.0)) / width
        )
        out = np.zeros_like(x)
        out[..., storey - 1] = -f
        if storey > 1:
            out[..., storey - 2] = f
        return out

    return extra


def test_effects_are_detected_and_named_linear_or_nonlinear():
    cubic = duffing(3, [1, 2, 3], seed=1, n_samples=6000)
    assert (
        detect(fitted(cubic)).verdicts.loc["storey 2", "verdict"]
        == ResidualKind.NONLINEAR
    )
    friction = linear_case(3, [1, 2, 3], 2, extra=coulomb(8.0, 2, 3, 1e-4), substeps=4)
    found = detect(fitted(friction))
    assert (
        found.verdicts.loc["storey 2", "verdict"] == ResidualKind.NONLINEAR
        and not found.is_noise
    )
    assert found.verdicts.loc["storey 2", "nonlinear share"] > 0.9

    def brace(x, v):
        f = 2e4 * (x[..., 2] - x[..., 0])
        return np.stack([f, 0 * f, -f], axis=-1)

    braced = linear_case(3, [1, 2, 3], 3, extra=brace)
    verdicts = detect(fitted(braced)).verdicts
    assert set(verdicts.loc[["dof 1", "dof 3"], "verdict"]) == {ResidualKind.LINEAR}
    assert (verdicts.loc[["dof 1", "dof 3"], "linear share"] > 0.99).all()


def test_unmeasured_force_is_tied_to_no_measured_signal():
    case = linear_case(2, [1, 2], 4)
    m, c, k, k3 = case.m, case.c, case.k, case.k3
    from chains import integrate

    t = np.arange(len(case.F)) * case.dt
    hidden = np.column_stack([0 * t, 30 * np.cos(2 * np.pi * 23.7 * t)])
    a, v, s = integrate(m, c, k, k3, case.F + hidden, case.dt)
    model = ChainModel(
        m,
        {i + 1: [laws.LinearViscous(c[i]), laws.LinearElastic(k[i])] for i in range(2)},
    )
    noise = np.random.default_rng(0).standard_normal((len(t), 2))
    residual = residual_of(
        model, from_arrays(np.hstack([a, v, s]), case.F + noise, dt=case.dt)
    )
    verdicts = detect(residual, NoiseFloor(np.ones(2), np.ones(2))).verdicts["verdict"]
    assert (
        verdicts["dof 2"] == ResidualKind.UNMEASURED
        and verdicts["dof 1"] == ResidualKind.NOISE
    )
    assert (
        detect(residual).verdicts.loc["dof 1", "verdict"] == ResidualKind.UNMEASURED
    )  # the noise is not known


def noisy_record(case, level, seed):
    """A record with noise of a share of the rms on every channel, and the noise of
    each.
    """
    rng = np.random.default_rng(seed)
    motion = (case.F, case.a, case.v.cumsum(axis=1), case.s.cumsum(axis=1))
    clean = dict(zip(("force", "acceleration", "velocity", "displacement"), motion))
    levels = {k: level * np.sqrt((p**2).mean(axis=0)) for k, p in clean.items()}
    noisy = {k: p + levels[k] * rng.standard_normal(p.shape) for k, p in clean.items()}
    return Record(**noisy, fs=1 / case.dt), levels


@pytest.mark.parametrize("level", [0.01, 0.05])
def test_fused_noise_is_noise_beside_its_floor_and_a_cubic_is_not(level):
    for cubic, wanted in ((False, ResidualKind.NOISE), (True, ResidualKind.NONLINEAR)):
        rec, levels = noisy_record(
            duffing(2, [1, 2], seed=5, n_samples=6000, cubic=cubic), level, 0
        )
        X, F = rec.to_features()
        model = NRFRegressor(degree=1).fit(X, F).model_
        verdicts = detect(
            residual_of(model, from_arrays(X, F)), floor_of_noise(model, rec, levels)
        ).verdicts
        assert verdicts.loc["dof 2", "verdict"] == wanted
        if not cubic:
            assert (verdicts["floor ratio"] < 1.3).all()


def test_rounding_is_noise():
    assert detect(fitted(linear_case(2, [1, 2], 6))).is_noise


def test_noise_is_noise_beside_a_floor_that_was_fitted_as_the_model_was():
    """Noise of 5 % on every channel biases the fit; alarms nevertheless come at the
    level, one in twenty balances.
    """
    alarms = balances = 0
    for seed in range(5):
        n = 1 + seed % 3
        case = linear_case(
            n, list(range(1, n + 1)) if seed % 2 else [1], 40 + seed, n_samples=2500
        )
        rec, levels = noisy_record(case, 0.05, seed)
        X, F = rec.to_features()
        regressor = NRFRegressor(degree=1).fit(X, F)
        floor = floor_of_noise(regressor.model_, rec, levels, regressor, seed=seed)
        found = detect(residual_of(regressor.model_, from_arrays(X, F)), floor).verdicts
        verdicts = found.loc[[f"dof {j + 1}" for j in range(n)], "verdict"]
        alarms, balances = (
            alarms + int((verdicts != ResidualKind.NOISE).sum()),
            balances + n,
        )
    assert alarms <= binom.ppf(0.999, balances, 0.05)


def test_hysteresis_of_an_element_without_mass_is_no_linear_effect():
    """``F = k s + slider``: the residual is F less a spring, and so a linear function
    of F and s, which says nothing.
    """
    s = (
        0.01
        * np.sin(np.linspace(0.0, 150.0, 6000))
        * np.abs(np.sin(np.linspace(0.1, 9.0, 6000)))
    )
    slider = laws.Jenkins(uy=0.002, Fy=400.0).force(
        laws.Motion(s, np.gradient(s, 1e-2))
    )
    X = np.column_stack(
        [np.gradient(np.gradient(s, 1e-2), 1e-2), np.gradient(s, 1e-2), s]
    )
    model = ChainModel([0.0], {1: [laws.LinearElastic(6e4)]})
    residual = residual_of(model, from_arrays(X, (3e4 * s + slider)[:, None], dt=1e-2))
    found = detect(residual, NoiseFloor(np.ones(1), np.ones(1))).verdicts.loc["dof 1"]
    assert found["verdict"] == ResidualKind.NONLINEAR and found["nonlinear share"] > 0.3
