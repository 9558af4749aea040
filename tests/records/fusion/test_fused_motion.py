"""One motion from noisy channels: right, complete, and without bias."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from smooth_motions import (
    FS,
    MASS,
    chain_masses,
    chain_test,
    harmonics,
    rms,
    two_floors,
    with_noise,
)

from pysindy_nrf import (
    ChainModel,
    KinematicSmoother,
    NRFRegressor,
    Record,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import integrate, to_features
from pysindy_nrf.simulation import add_noise


@pytest.mark.parametrize("kind", ["random", "hammer"])
@pytest.mark.parametrize("seed", [0, 1])
def test_masses_by_least_squares_on_fused_channels_are_within_two_percent(kind, seed):
    clean = chain_test(kind, seed)
    rng = np.random.default_rng(100 + seed)
    force = with_noise(clean.force, 0.05, rng)
    force[:, [0, 1, 3]] = 0.0
    channels = [with_noise(y, 0.05, rng) for y in (clean.a, clean.v, clean.x)]
    smoother = KinematicSmoother()
    X, F = to_features(Record(force, *channels, fs=FS), smoother)
    assert np.abs(chain_masses(X, F) / MASS - 1).max() < 0.02

    true = 0.05 * np.concatenate([y.std(axis=0) for y in (clean.a, clean.v, clean.x)])
    np.testing.assert_allclose(smoother.noise_, true, rtol=0.1)


@pytest.mark.parametrize("kind", ["random", "hammer"])
def test_the_ends_of_a_record_are_not_worse_than_twice_its_middle(kind):
    clean = chain_test(kind, 0)
    fused = KinematicSmoother().transform_record(clean.noisy(0.05, 100).record())
    pairs = (
        (fused.acceleration, clean.a),
        (fused.velocity, clean.v),
        (fused.displacement, clean.x),
    )
    edge = len(clean.t) // 20
    for motion, truth in pairs:
        error = motion - truth
        middle = rms(error[edge:-edge])
        assert (rms(error[:edge]) <= 2 * middle).all()
        assert (rms(error[-edge:]) <= 2 * middle).all()


@pytest.mark.parametrize("share", [0.01, 0.1])
@pytest.mark.parametrize("kinds", ["avx", "ax", "x", "a"])
def test_noise_levels_are_found_from_one_two_or_three_channels(kinds, share):
    truth = chain_test("random", 4)
    rng = np.random.default_rng(4)
    table, levels = {}, {}
    for kind in kinds:
        for j, y in enumerate(getattr(truth, kind).T, 1):
            table[f"{kind}{j}"] = with_noise(y, share, rng)
            levels[f"{kind}{j}"] = share * y.std()
    smoother = KinematicSmoother(fs=FS, band=(2.0, 100.0)).fit(pd.DataFrame(table))
    noise = smoother.noise_[list(levels)]
    np.testing.assert_allclose(noise, list(levels.values()), rtol=0.2)


@pytest.mark.parametrize("kinds", ["avx", "ax", "vx", "x"])
def test_noise_free_motion_comes_back_unchanged(kinds):
    motion = two_floors()
    fused = KinematicSmoother().transform_record(motion.record(kinds))
    # at the very ends a derivative is extrapolation
    inside = slice(None) if "a" in kinds else slice(40, -40)
    for truth, fused_channel in (
        (motion.a, fused.acceleration),
        (motion.v, fused.velocity),
        (motion.x, fused.displacement),
    ):
        assert np.abs(fused_channel - truth)[inside].max() < 1e-6 * rms(truth).min()


def test_noise_free_hammer_keeps_its_kinks_and_the_masses_are_exact():
    X, F = to_features(chain_test("hammer", 0, substeps=1).record())
    np.testing.assert_allclose(chain_masses(X, F), MASS, rtol=1e-8)


def creeping_friction():
    """Two floors of 10 kg; friction of 20 N in storey 2 creeps through some 20
    reversals a second, which leaves kinks in most samples. Integrated by LSODA.
    """
    t = np.arange(3000) / 250
    k1, k2, c1, c2 = 9e4, 6e4, 60.0, 40.0
    tones = (5.1, 8.3, 13.7, 21.9)

    def forces(now, x1, x2, v1, v2):
        """Applied force and net forces, in numbers: they are asked for 100,000
        times.
        """
        top = k2 * (x2 - x1) + c2 * (v2 - v1) + 20.0 * math.tanh((v2 - v1) / 1e-4)
        applied = 60.0 * sum(math.sin(2 * math.pi * now * f + f) for f in tones)
        return applied, top - k1 * x1 - c1 * v1, applied - top

    def rates(now, state):
        x1, x2, v1, v2 = state.tolist()
        _, net1, net2 = forces(now, x1, x2, v1, v2)
        return v1, v2, net1 / 10.0, net2 / 10.0

    tight = {"rtol": 1e-10, "atol": 1e-13, "max_step": 2e-3}
    path = solve_ivp(rates, (0, t[-1]), np.zeros(4), "LSODA", t, **tight).y
    applied, net1, net2 = np.vectorize(forces)(t, *path)
    force = np.column_stack([np.zeros_like(t), applied])
    acceleration = np.column_stack([net1, net2]) / 10.0
    return Record(force, acceleration, path[2:].T, path[:2].T, fs=250.0)


def test_noise_free_friction_is_not_smoothed_and_every_parameter_is_exact():
    """To the error of a free run, which differs between processors by the rounding."""
    linear = [laws.LinearElastic(), laws.LinearViscous()]
    model = NRFRegressor(laws={1: linear, 2: [*linear, laws.RegularizedFriction()]})
    model.fit(creeping_friction())
    np.testing.assert_allclose(model.masses_, 10.0, rtol=1e-4)
    friction = model.model_.laws[model.chain_.site(2)][2]
    assert friction.parameters == pytest.approx({"v0": 1e-4, "Fc": 20.0}, rel=1e-3)


def test_fused_channels_are_derivatives_of_each_other():
    record = chain_test("random", 5).noisy(0.05, 5).record()
    fused = KinematicSmoother().transform_record(record)
    for rate, motion in (
        (fused.acceleration, fused.velocity),
        (fused.velocity, fused.displacement),
    ):
        moved = motion - motion[0]
        error = np.abs(integrate(rate, 1 / FS) - moved).max()
        assert error < 1e-4 * rms(motion).min()


@pytest.fixture(scope="module")
def shaken():
    """Two floors and the motion of their base, all in closed form."""
    ground = harmonics([3.1], [0.02], phase=0.0)
    base = {
        "base_acceleration": ground.a[:, 0],
        "base_velocity": ground.v[:, 0],
        "base_displacement": ground.x[:, 0],
    }
    return two_floors(), ground, base


@pytest.mark.parametrize(
    ("kinds", "measured", "coordinates"),
    [
        ("ax", ["base_acceleration"], "relative"),
        ("ax", ["base_displacement"], "relative"),
        ("ax", ["base_displacement"], "absolute"),
        ("avx", ["base_displacement", "base_acceleration"], "absolute"),
    ],
)
def test_a_moving_base_gives_the_same_features(shaken, kinds, measured, coordinates):
    motion, ground, base = shaken
    acceleration = motion.a + ground.a
    wanted, _ = to_features(
        motion.record(
            acceleration=acceleration, base_acceleration=base["base_acceleration"]
        ),
        smooth=False,
    )

    channels = {"acceleration": acceleration, "displacement": motion.x}
    if "v" in kinds:
        channels["velocity"] = motion.v
    if coordinates == "absolute":
        channels["displacement"] = motion.x + ground.x
        channels["velocity"] = motion.v + ground.v if "v" in kinds else None
    channels |= {key: base[key] for key in measured}
    features, _ = to_features(Record(**channels, fs=FS, coordinates=coordinates))
    error = np.abs(features - wanted).iloc[40:-40].max() / wanted.std()
    assert error.max() < 1e-5


def test_absolute_displacements_need_the_displacement_of_the_base(shaken):
    motion, ground, base = shaken
    record = motion.record(
        acceleration=motion.a + ground.a,
        base_acceleration=base["base_acceleration"],
        coordinates="absolute",
    )
    with pytest.raises(ChannelError, match="base_displacement"):
        to_features(record)


@pytest.mark.parametrize(("n_dof", "n"), [(1, 16), (1, 60), (3, 100), (12, 3000)])
def test_any_number_of_floors_and_short_records_are_fused(n_dof, n):
    motion = harmonics(5 + np.arange(n_dof), np.eye(n_dof), n, phase=0.4)
    noisy = motion.noisy(0.05, 0)
    fused = KinematicSmoother().transform_record(noisy.record("ax"))
    assert (rms(fused.displacement - motion.x) < rms(noisy.x - motion.x)).all()


@pytest.mark.parametrize("n_samples", [997, 1000])
def test_velocities_and_accelerations_of_two_lines_keep_their_size(n_samples):
    """The high-pass that stands for the missing displacement lies far below them."""
    storey = [laws.LinearElastic(2.189e6), laws.LinearViscous(3950.0)]
    truth = ChainModel([1432.0], {1: storey})
    t = np.arange(n_samples) / 62.0
    F = 1000 * (np.sin(2 * np.pi * 5.0 * t) + np.sin(2 * np.pi * 6.0 * t))
    record = simulate(truth, F[:, None], 1 / 62.0).replace(displacement=None)
    for noise in (0.0, 0.01):
        noisy = add_noise(record, noise, random_state=0)
        fitted = NRFRegressor(degree=1).fit(noisy)
        assert fitted.model_.masses == pytest.approx(truth.masses, rel=0.01)


def test_a_resting_floor_does_no_harm():
    motion = two_floors()
    noisy = motion.noisy(0.02, 0)
    for y in (noisy.a, noisy.x):
        y[:, 1] = 0.0
    fused = KinematicSmoother().transform_record(noisy.record("ax"))
    assert not fused.velocity[:, 1].any()
    assert rms(fused.velocity - motion.v)[0] < 0.02 * rms(motion.v)[0]


def test_slow_motion_sampled_very_fast_is_fused_all_the_same():
    """0.3 to 3 Hz at 4 kHz: the normal equations lose their last digits."""
    fs = 4000.0
    motion = harmonics([0.3, 1.0, 3.0], [0.01, 0.02, 0.005], 80_000, fs)
    rough = np.gradient(motion.x, 1 / fs, axis=0)
    rougher = np.gradient(rough, 1 / fs, axis=0)
    record = motion.record(velocity=rough, acceleration=rougher)
    X, _ = record.to_features()
    inside = slice(400, -400)
    for name, exact in (("a1", motion.a), ("v1", motion.v), ("s1", motion.x)):
        error = np.abs(X[name] - exact[:, 0])[inside]
        assert error.max() < 2e-4 * np.abs(exact).max()


@pytest.mark.parametrize("exact", ["v", "a"])
@pytest.mark.parametrize("seconds", [8.0, 40.0])
def test_an_exact_derivative_leaves_a_noisy_position_where_it_is(exact, seconds):
    """The mean of the displacement is known to sigma / sqrt(n) from itself alone."""
    fs = 500.0
    motion = harmonics([1.7, 5.3], [2e-3, 1e-3], int(seconds * fs), fs, phase=0.0)
    x = motion.x[:, 0] + 4e-3
    rate = getattr(motion, exact)[:, 0]
    sigma = 0.05 * x.std()
    noise = sigma * np.random.default_rng(3).standard_normal(len(x))
    table = pd.DataFrame({"x1": x + noise, f"{exact}1": rate})
    fused = KinematicSmoother(fs=fs).fit_transform(table)
    error = fused["x1"] - x
    assert abs(error.mean()) < 5 * sigma / np.sqrt(len(x))
    assert error.std() < 0.1 * sigma
    assert np.abs(fused[f"{exact}1"] - rate).max() < 1e-3 * np.abs(rate).max()
