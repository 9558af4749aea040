"""Spectral lines, coupled storeys, noise levels and noise floors against formulas written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from pysindy_nrf import ChainModel, Record, laws
from pysindy_nrf.discrepancy import bootstrap, characterisation
from pysindy_nrf.discrepancy.evidence import detect
from pysindy_nrf.discrepancy.residual import NoiseFloor, from_top, residual_of, rms
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.laws import Motion
from pysindy_nrf.regression.input_arrays import from_arrays

pytestmark = pytest.mark.slow


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


# -- characterisation -------------------------------------------------------------------------------


def test_a_spectral_line_is_found_between_two_bins():
    t = np.arange(1000) / 100
    for f in (11.37, 30.02):
        e = 0.6 * np.cos(2 * np.pi * f * t + 1) + noise(1000, 3)
        assert characterisation.spectral_line(
            [noise(300), e], [Motion(t[:300], t[:300], t=t[:300]), Motion(t, t, t=t)]
        ) == (pytest.approx(f, abs=0.012))
    clean = np.cos(2 * np.pi * 11.37 * t + 1) + 1e-6 * noise(1000)
    found = characterisation.spectral_line([clean], [Motion(t, t, t=t)])
    assert found == pytest.approx(11.37, abs=0.5 * 2 / 80 / 10 + 1e-9)  # the nearest of 81 in two bins of 0.1 Hz


# -- coupling ---------------------------------------------------------------------------------------


def chain_residual(rho, n=3000, seed=0):
    """A residual whose storey forces are given functions of drifts and rates that are noise."""
    rng = np.random.default_rng(seed)
    s, v = rng.standard_normal((2, n, len(rho)))
    X = np.hstack([rng.standard_normal((n, len(rho))), v, s])
    F = 10 * rng.standard_normal((n, len(rho)))
    model = ChainModel([1.0] * len(rho), {i + 1: [laws.LinearElastic(1.0)] for i in range(len(rho))})
    storeys = np.column_stack([f(s, v) for f in rho])
    e = storeys - np.column_stack([storeys[:, 1:], np.zeros(n)])
    return replace(residual_of(model, from_arrays(X, F, dt=0.01)), balance=[e])


def test_a_storey_that_follows_another_is_coupled_and_one_that_follows_itself_is_not():
    found = chain_residual([lambda s, v: s[:, 0] ** 3 + 5 * np.sign(v[:, 0]), lambda s, v: 2 * s[:, 0] + noise(len(s))])
    assert rms([from_top(found.balance[0])])[1] == pytest.approx(np.sqrt(5), rel=0.05)
    one = detect(found).couplings
    assert [c.storey for c in one] == [2]
    # 4 of 5 parts are linear in the other storey, of what its own motion leaves: all
    assert one[0].own == pytest.approx(0.0, abs=0.02) and one[0].others == pytest.approx(0.8, abs=0.03)
    assert one[0].percent == pytest.approx(found.sizes.loc["storey 2", "percent"])
    level = found.sizes.loc["storey 2", "rms"]
    assert not detect(found, NoiseFloor(np.ones(2), np.full(2, level), "")).couplings
    assert detect(found, NoiseFloor(np.ones(2), np.full(2, 0.1 * level), "")).couplings


@pytest.mark.parametrize(
    "own, other, listed", [(0.55, 0.0, False), (0.45, 0.0, True), (0.93, 1, True), (0.97, 1, False)]
)
def test_a_storey_is_listed_if_half_is_unexplained_or_a_twentieth_follows_the_others(own, other, listed):
    def force(s, v):
        rest = s[:, 0] if other else noise(len(s), 9)
        return np.sqrt(own) * np.sign(v[:, 1]) + np.sqrt(1 - own) * rest

    found = detect(chain_residual([lambda s, v: 0 * s[:, 0], force], 8000)).couplings
    assert bool(found) == listed and (not found or found[0].own == pytest.approx(own, abs=0.02))


# -- noise levels -----------------------------------------------------------------------------------


def test_noise_is_read_where_the_signal_is_quiet_in_frequency_or_time():
    t = np.arange(20000) / 500
    force = sum(np.sin(2 * np.pi * f * t + f**2) for f in np.arange(3.0, 60.0, 0.77))
    for level in (0.1, 0.7):
        assert bootstrap.quiet_level(force + level * noise(20000), 500.0) == pytest.approx(level, rel=0.05)
        assert bootstrap.quiet_level(force + level * noise(20000) + 99 * np.eye(1, 20000, 7)[0], 1.0) > 0
    blows = np.where(np.arange(20000) % 2000 < 20, 50.0, 0.0)
    assert bootstrap.quiet_level(blows + 0.5 * noise(20000), 500.0) == pytest.approx(0.5, rel=0.03)
    with_gaps = blows + 0.5 * noise(20000)
    with_gaps[3000:3100] = np.nan
    assert bootstrap.quiet_level(with_gaps, 500.0) == pytest.approx(0.5, rel=0.03)


def test_wieners_filter_takes_twice_the_noise_off():
    n, fs, level = 2**14, 100.0, 0.2
    t = np.arange(n) / fs
    pure = 3 * np.cos(2 * np.pi * 1638 / n * fs * t)
    found = bootstrap.denoised(pure + level * noise(n), level, fs)
    assert np.std(found - pure) < 0.4 * level and np.std(found) == pytest.approx(3 / np.sqrt(2), rel=0.01)
    # noise of four times the variance: the gain is 1 - 2/4 on average
    loud = 2 * level * noise(n, 1)
    half = bootstrap.denoised(loud, level, fs)
    assert loud @ half / (loud @ loud) == pytest.approx(0.5, abs=0.03) and half.std() < loud.std()
    assert bootstrap.denoised(loud, 0.0, fs) is loud
    holes = np.where(np.arange(n) == 5, np.nan, loud)
    assert bootstrap.denoised(holes, level, fs) is holes


def test_levels_hold_forces_and_base_and_take_the_base_off_relative_motion():
    n = 6400
    rng = np.random.default_rng(0)
    blows = np.where(np.arange(n) % 800 < 20, 50.0, 0.0)
    quiet = blows + 0.1 * rng.standard_normal(n)
    base = blows + 0.3 * rng.standard_normal(n)
    zeros = np.zeros((n, 2))
    record = Record(
        fs=100.0,
        coordinates="absolute",
        force=np.column_stack([quiet, 0 * quiet]),
        acceleration=zeros,
        base_acceleration=base,
    )
    found = bootstrap.levels_of(record, {"a1": 0.5, "a2": 0.3, "x1": 0.5})
    assert found["F1"] == pytest.approx(0.1, rel=0.05) and found["ag"] == pytest.approx(0.3, rel=0.05)
    assert found["x1"] == 0.5 and found["a1"] == 0.5
    relative = record.replace(coordinates="relative")
    found = bootstrap.levels_of(relative, {"a1": 0.5, "a2": 0.3, "x1": 0.5})
    assert found["a1"] == pytest.approx(np.sqrt(0.25 - found["ag"] ** 2)) and found["x1"] == 0.5
    rows = np.arange(n) < 20
    assert bootstrap.levels_of(relative, {}, rows)["F1"] == 0.0
    fresh = bootstrap.noisy_base(record, {"ag": 2.0, "vg": 1.0}, np.random.default_rng(1))
    assert list(fresh) == ["base_acceleration"]
    assert fresh["base_acceleration"] - base == pytest.approx(2.0 * np.random.default_rng(1).standard_normal(n))
    calm = bootstrap.quiet_drive(record, {"F1": 0.1, "ag": 0.3})
    assert calm.force[:, 0] == pytest.approx(bootstrap.denoised(quiet, 0.1, 100.0))
    assert calm.base_acceleration == pytest.approx(bootstrap.denoised(base, 0.3, 100.0))
    assert not bootstrap.noisy_base(record, {"ag": 0.0}, np.random.default_rng(1))


# -- noise floor ------------------------------------------------------------------------------------


def test_floors_that_are_given_add_up_from_the_top():
    floor = NoiseFloor.given({1: 3.0, 3: 4.0}, 3)
    assert floor.at("dof 1") == 3.0 and np.isnan(floor.at("dof 2")) and floor.at("storey 3") == 4.0
    assert np.isnan(floor.storey[:2]).all() and NoiseFloor.given(2.0, 3).storey == pytest.approx(2 * np.sqrt([3, 2, 1]))
    assert NoiseFloor.given([1.0, 2.0], 2).covariance() == pytest.approx(np.diag([1.0, 4.0]))
    for wrong in ({4: 1.0}, {0: 1.0}, [1.0, 2.0], -1.0, np.inf):
        with pytest.raises(ChannelError):
            NoiseFloor.given(wrong, 3)
    assert NoiseFloor.given(0.0, 2).storey.tolist() == [0.0, 0.0]


def repeats(forces, left, n=400):
    """Records of one storey under given forces that leave given residuals."""
    model = ChainModel([1.0], {1: [laws.LinearElastic(1.0)]})
    ids = np.repeat(np.arange(len(forces)), n)
    data = from_arrays(np.zeros((n * len(forces), 3)), np.concatenate(forces)[:, None], record=ids, dt=0.01)
    return replace(residual_of(model, data), balance=[e[:, None] for e in left])


def test_repeated_records_differ_by_noise_that_is_estimated_without_bias():
    force = noise(400, 1)
    left = [noise(400, k) + 10 * force for k in range(2, 5)]
    floor = NoiseFloor.from_repeats(repeats([force] * 3, left))
    assert (
        floor.balance[0] == pytest.approx(np.sqrt(np.mean(np.var(left, axis=0, ddof=1))))
        and "3 repeated" in floor.source
    )


@pytest.mark.parametrize("share, alike", [(0.19, True), (0.21, False)])
def test_records_excited_otherwise_are_no_repetitions(share, alike):
    force = np.tile([1.0, -1.0], 200)
    other = share * np.tile([1.0, 1.0, -1.0, -1.0], 100)
    found = repeats([force + other, force - other], [noise(400), noise(400, 1)])
    if alike:
        NoiseFloor.from_repeats(found)
    else:
        with pytest.raises(ChannelError, match="not excited alike"):
            NoiseFloor.from_repeats(found)


@pytest.mark.parametrize("n", [500, 3000])
def test_white_noise_has_a_line_in_one_record_of_a_hundred(n):
    """Of 400 records of noise 4 are expected, and more than 11 in one of a thousand such tests."""
    rng, t = np.random.default_rng(8), np.arange(n) / 100
    found = [characterisation.spectral_line([rng.standard_normal(n)], [Motion(t, t, t=t)]) for _ in range(400)]
    assert np.isfinite(found).sum() <= stats.binom.ppf(0.999, 400, 0.01)
