"""Records that were computed step by step are taken as they are."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from pysindy_nrf import KinematicSmoother, NRFRegressor, Record, close_loop
from pysindy_nrf.records.fusion.kinematics import fuse_record

MASSES = {2: [7.0, 4.0], 3: [12.0, 9.0, 5.0], 5: [9.0, 8.0, 8.0, 6.0, 4.0]}
STIFFNESSES = [5e4, 3.5e4, 2.5e4, 3e4, 2e4]
DAMPINGS = [40.0, 25.0, 30.0, 15.0, 20.0]


@dataclass(frozen=True)
class Frame:
    """Matrices of a linear frame."""

    M: np.ndarray
    C: np.ndarray
    K: np.ndarray

    @classmethod
    def of_floors(cls, n):
        joins = np.eye(n) - np.eye(n, k=-1)
        C = joins.T @ np.diag(DAMPINGS[:n]) @ joins
        K = joins.T @ np.diag(STIFFNESSES[:n]) @ joins
        return cls(np.diag(MASSES[n]), C, K)

    def accelerations(self, x, v, F):
        return np.linalg.solve(self.M, F.T - self.C @ v.T - self.K @ x.T).T

    def by_newmark(self, F, dt, beta):
        """Motion by Newmark's method, with his gamma of one half."""
        x, v, a = np.zeros((3, *F.shape))
        a[0] = np.linalg.solve(self.M, F[0])
        effective = self.M + dt / 2 * self.C + beta * dt**2 * self.K
        for k in range(len(F) - 1):
            x_next = x[k] + dt * v[k] + (0.5 - beta) * dt**2 * a[k]
            v_next = v[k] + dt / 2 * a[k]
            load = F[k + 1] - self.C @ v_next - self.K @ x_next
            a[k + 1] = np.linalg.solve(effective, load)
            x[k + 1] = x_next + beta * dt**2 * a[k + 1]
            v[k + 1] = v_next + dt / 2 * a[k + 1]
        return x, v, a

    def under_straight_forces(self, F, dt):
        """Exact motion under forces that are straight between the samples."""
        n = len(self.M)
        to_rates = np.hstack([np.zeros((n, n)), np.eye(n)])
        to_accelerations = -np.linalg.solve(self.M, np.hstack([self.K, self.C]))
        system = StateSpace(
            np.vstack([to_rates, to_accelerations]),
            np.vstack([np.zeros((n, n)), np.linalg.inv(self.M)]),
            np.eye(2 * n),
            np.zeros((2 * n, n)),
        )
        _, states, _ = lsim(system, F, dt * np.arange(len(F)), interp=True)
        x, v = np.split(states, 2, axis=1)
        return x, v, self.accelerations(x, v, F)


def top_force(n_dof, fs, seconds=16.0, seed=1):
    """A force on the top floor with lines from 1 to 30 Hz, N."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * fs)) / fs
    force = np.zeros((len(t), n_dof))
    for f in rng.uniform(1.0, 30.0, 40):
        force[:, -1] += 20 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6))
    return force


def in_16_bits(y):
    step = np.maximum(np.abs(y).max(axis=0), 1e-300) / 2**15
    return step * np.round(y / step)


def with_noise(y, share=1e-3):
    noise = np.random.default_rng(5).standard_normal(y.shape)
    return y + share * y.std(axis=0) * noise


def computed_kinds(record):
    return [note.kind for note in fuse_record(record).notes if not note.is_fault]


def largest_error(values, true):
    return np.abs(np.asarray(values) / true - 1).max()


@pytest.mark.parametrize("fs", [100.0, 200.0, 500.0])
@pytest.mark.parametrize("n_dof", [3, 5])
@pytest.mark.parametrize("rounded", [np.asarray, in_16_bits])
def test_masses_of_a_newmark_record_are_within_a_thousandth(n_dof, fs, rounded):
    F = top_force(n_dof, fs)
    x, _, a = Frame.of_floors(n_dof).by_newmark(F, 1 / fs, 1 / 4)
    record = Record(rounded(F), rounded(a), displacement=rounded(x), fs=fs)
    model = NRFRegressor(degree=1).fit(record)
    assert largest_error(model.masses_, MASSES[n_dof]) < 1e-3
    assert model.verdict().state == "green"


@pytest.mark.parametrize("fs", [120.0, 250.0, 400.0])
@pytest.mark.parametrize("rounded", [np.asarray, in_16_bits])
def test_masses_under_straight_forces_are_within_a_thousandth(fs, rounded):
    F = top_force(3, fs)
    x, _, a = Frame.of_floors(3).under_straight_forces(F, 1 / fs)
    record = Record(rounded(F), rounded(a), displacement=rounded(x), fs=fs)
    model = NRFRegressor(degree=1).fit(record)
    assert largest_error(model.masses_, MASSES[3]) < 1e-3


@pytest.mark.parametrize("beta", [0.0, 1 / 6, 1 / 4])
def test_velocity_is_that_of_the_rule_from_the_first_sample_to_the_last(beta):
    F = top_force(2, 200.0)
    x, v, a = Frame.of_floors(2).by_newmark(F, 1 / 200, beta)
    record = Record(F, a, displacement=x, fs=200.0)
    fused = KinematicSmoother().transform_record(record)
    np.testing.assert_allclose(fused.velocity, v, atol=1e-9 * v.std())
    np.testing.assert_array_equal(fused.displacement, x)
    assert computed_kinds(record) == ["computed"]


def test_velocity_under_straight_forces_is_exact_to_a_thousandth():
    F = top_force(3, 150.0)
    x, v, a = Frame.of_floors(3).under_straight_forces(F, 1 / 150)
    record = Record(F, a, displacement=x, fs=150.0)
    fused = KinematicSmoother().transform_record(record)
    assert (fused.velocity - v).std() < 1e-3 * v.std()


def test_a_smoother_transforms_a_computed_record_as_it_fitted_it():
    F = top_force(2, 200.0)
    x, v, a = Frame.of_floors(2).by_newmark(F, 1 / 200, 1 / 4)
    smoother = KinematicSmoother().fit(Record(F, a, displacement=x, fs=200.0))
    fused = smoother.transform(Record(F, a, displacement=x, fs=200.0))
    np.testing.assert_allclose(fused.velocity, v, atol=1e-9 * v.std())


@pytest.mark.parametrize("beta", [1 / 4, None])
@pytest.mark.parametrize("noisy", ["x", "ax"])
def test_noise_of_a_thousandth_makes_a_measured_record(beta, noisy):
    F = top_force(3, 200.0)
    frame = Frame.of_floors(3)
    if beta is None:
        x, _, a = frame.under_straight_forces(F, 1 / 200)
    else:
        x, _, a = frame.by_newmark(F, 1 / 200, beta)
    a = with_noise(a) if "a" in noisy else a
    x = with_noise(x) if "x" in noisy else x
    assert computed_kinds(Record(F, a, displacement=x, fs=200.0)) == []


def test_known_noise_makes_a_measured_record():
    F = top_force(2, 200.0)
    x, v, a = Frame.of_floors(2).by_newmark(F, 1 / 200, 1 / 4)
    smoother = KinematicSmoother(noise={"a": 0.05 * a.std(), "x": 0.01 * x.std()})
    fused = smoother.transform_record(Record(F, a, displacement=x, fs=200.0))
    assert np.abs(fused.acceleration - a).max() > 0


@pytest.mark.parametrize("fault", ["gain", "delay", "velocity"])
def test_a_faulty_channel_is_not_taken_for_a_rule(fault):
    F = top_force(3, 200.0)
    x, v, a = Frame.of_floors(3).by_newmark(F, 1 / 200, 1 / 4)
    if fault == "gain":
        x[:, 1] *= 1.05
    elif fault == "delay":
        a[:, 1] = np.roll(a[:, 1], 1)
    else:
        v[:, 1] *= 1.05
    velocity = v if fault == "velocity" else None
    assert computed_kinds(Record(F, a, velocity, x, fs=200.0)) == []


def test_a_smooth_motion_is_no_computed_one():
    t = np.arange(4000) / 200
    lines = [(np.pi, 1.0), (5 * np.sqrt(5), 0.2), (10 * np.e, 0.05)]
    x = sum(size * np.sin(2 * np.pi * f * t) for f, size in lines)
    a = sum(
        -((2 * np.pi * f) ** 2) * size * np.sin(2 * np.pi * f * t) for f, size in lines
    )
    record = Record(None, in_16_bits(a), displacement=in_16_bits(x), fs=200.0)
    assert computed_kinds(record) == []


def test_the_loop_finds_nothing_in_a_linear_newmark_record():
    F = top_force(3, 200.0)
    x, _, a = Frame.of_floors(3).by_newmark(F, 1 / 200, 1 / 4)
    report = close_loop(Record(F, a, displacement=x, fs=200.0))
    assert not any(step.confirmed for step in report.steps)
    assert report.verdict.state == "green"
    assert largest_error(report.model.masses, MASSES[3]) < 1e-3
    assert [note.kind for note in report.quality] == ["computed"]
