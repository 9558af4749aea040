"""Records that are long, rest for most of the time, are swept or hit."""

import numpy as np
import pytest
from scipy.signal import chirp

from pysindy_nrf import ChainModel, KinematicSmoother, Record, laws, simulate


def one_dof(x, a, x_noise, a_noise, seed=0):
    """Displacement and acceleration of one DOF at 1 kHz, with noise."""
    rng = np.random.default_rng(seed)
    x = x + x_noise * rng.standard_normal(len(x))
    a = a + a_noise * rng.standard_normal(len(a))
    return Record(displacement=x, acceleration=a, fs=1000.0)


def chain(masses, stiffnesses, damping):
    storeys = {
        i: [laws.LinearElastic(k), laws.LinearViscous(damping)]
        for i, k in enumerate(stiffnesses, 1)
    }
    return ChainModel(masses, storeys)


def noisy(record, share, kinds, seed=0):
    """The record with those kinds of channels alone, with noise."""
    rng = np.random.default_rng(seed)
    channels = {kind: getattr(record, kind) for kind in kinds}
    for kind, y in channels.items():
        channels[kind] = y + share * y.std(axis=0) * rng.standard_normal(y.shape)
    return Record(**channels, fs=record.fs)


@pytest.mark.parametrize("n", [61_440, 65_535])
def test_blocks_that_overlap_by_more_than_half_keep_the_size_of_the_motion(n):
    """5 Hz with 1 % noise: the fused motion is right to a fraction of it everywhere."""
    w = 2 * np.pi * 5
    x = np.sin(w * np.arange(n) / 1000)
    record = one_dof(x, -(w**2) * x, 0.01, 0.01 * w**2)
    fused = KinematicSmoother(joint=False).fit_transform(record)
    assert np.abs(fused.displacement[:, 0] - x).max() < 0.01


def test_a_record_that_rests_most_of_the_time_keeps_its_noise():
    """A triggered sensor: two thirds of the record are quiet to the last bit."""
    t = np.arange(12_000) / 1000
    moving = t < 4.0
    x = 1e-3 * np.sin(2 * np.pi * 6 * t) * np.sin(np.pi * t / 4.0) ** 2 * moving
    a = np.gradient(np.gradient(x, t), t)
    smoother = KinematicSmoother(joint=False)
    fused = smoother.fit_transform(one_dof(x, a, 3e-5 * moving, 0.05 * moving))
    assert smoother.noise_["x1"] == pytest.approx(3e-5, rel=0.2)
    error = (fused.displacement[:, 0] - x)[moving]
    assert np.sqrt(np.mean(error**2)) < 1e-5


def test_a_sweep_keeps_the_frequencies_that_it_passes_last():
    """All floors together know them at least as well as floor by floor, though the
    record has them briefly.
    """
    F = np.zeros((8000, 4))
    F[:, 1] = 10 * chirp(np.arange(8000) / 200, 0.5, 40.0, 13.0)
    frame = chain([3.0, 2.5, 2.0, 2.0], [6e3, 5e3, 4e3, 4e3], 4.0)
    exact = simulate(frame, F, 1 / 200)
    record = noisy(exact, 0.01, ("acceleration", "velocity", "displacement"))
    f = np.fft.rfftfreq(8000, 1 / 200)
    last = (f > 10) & (f < 13)

    errors = {}
    for joint in (True, False):
        fused = KinematicSmoother(joint=joint).fit_transform(record)
        lines = np.fft.rfft(fused.displacement - exact.displacement, axis=0)[last]
        errors[joint] = np.linalg.norm(lines, axis=0)
    assert (errors[True] < errors[False]).all()


def test_the_end_of_a_long_sweep_decides_on_the_knots():
    """1 to 60 Hz in 60 s with 1 % noise: most samples lack the last frequencies."""
    t = np.arange(60_000) / 1000
    rate = 2 * np.pi * (1 + 59 * t / 60)
    phase = 2 * np.pi * (t + 59 * t**2 / 120)
    x = np.sin(phase)
    a = 2 * np.pi * 59 / 60 * np.cos(phase) - rate**2 * x
    fused = KinematicSmoother().fit_transform(one_dof(x, a, 0.01, 0.01 * a.std()))
    assert np.std(fused.acceleration[:, 0] - a) < 0.01 * a.std()


def test_a_blow_of_five_samples_is_kept():
    """A hammer at the top, 0.1 % noise: the floor that is hit loses nothing."""
    F = np.zeros((6000, 4))
    for start in (100, 2000, 4100):
        F[start : start + 5, 3] = 2000 * np.hanning(5)
    exact = simulate(chain([10.0, 9.0, 8.0, 8.0], [6e4] * 4, 30.0), F, 1 / 500)
    record = noisy(exact, 1e-3, ("displacement", "acceleration"))
    fused = KinematicSmoother().fit_transform(record)
    error = np.std(fused.acceleration - exact.acceleration, axis=0)
    assert (error < 2e-3 * exact.acceleration.std(axis=0)).all()


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_blow_in_noise_is_kept(seed):
    """5 % noise: knots 1.5 samples apart may be no better than two, while those at
    every sample keep the blow.
    """
    rng = np.random.default_rng(seed)
    F = np.zeros((20_000, 2))
    for start in rng.integers(0, 19_900, 7):
        F[start : start + 5, 1] = 2000 * np.hanning(5)
    exact = simulate(chain([10.0, 8.0], [5e4, 5e4], 30.0), F, 1 / 500)
    record = noisy(exact, 0.05, ("displacement", "acceleration"), rng)
    fused = KinematicSmoother().fit_transform(record)
    error = np.std(fused.acceleration - exact.acceleration, axis=0)
    assert (error < 0.05 * exact.acceleration.std(axis=0)).all()
