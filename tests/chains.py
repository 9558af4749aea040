"""Chains simulated without the package, and comparisons of fitted models with them.

Duffing chains are integrated in batches by a Runge-Kutta rule, hysteresis by SciPy.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from pysindy_nrf import Record, excitation, simulate
from pysindy_nrf.records import feature_names


@dataclass
class Case:
    """One record of a chain ``R_i = c_i v_i + k_i s_i + k3_i s_i^3``, and its truth."""

    X: np.ndarray
    F: np.ndarray
    m: np.ndarray
    c: np.ndarray
    k: np.ndarray
    k3: np.ndarray
    dt: float
    ag: np.ndarray | None = None

    @property
    def n(self) -> int:
        return len(self.m)

    @property
    def s(self) -> np.ndarray:
        return self.X[:, 2 * self.n :]

    @property
    def v(self) -> np.ndarray:
        return self.X[:, self.n : 2 * self.n]

    @property
    def a(self) -> np.ndarray:
        return self.X[:, : self.n]

    @property
    def storey_forces(self) -> np.ndarray:
        return self.c * self.v + self.k * self.s + self.k3 * self.s**3

    @property
    def absolute(self) -> np.ndarray:
        """Columns a, xdot, x of the DOFs, relative to the base."""
        return np.hstack([self.a, self.v.cumsum(axis=1), self.s.cumsum(axis=1)])

    def noisy(self, share: float = 0.02, seed: int = 0) -> np.ndarray:
        """X with noise of a share of the standard deviation of each column."""
        noise = np.random.default_rng(seed).standard_normal(self.X.shape)
        return self.X + share * self.X.std(axis=0) * noise

    def record(self, **options) -> Record:
        a, v, x = np.split(self.absolute, 3, axis=1)
        return Record(
            force=self.F,
            acceleration=a,
            velocity=v,
            displacement=x,
            fs=1 / self.dt,
            **options,
        )


def parameters(n: int, rng: np.random.Generator, cubic: bool = True):
    """Random m, c, k and k3 of a laboratory frame in SI units, ten orders apart."""
    m = rng.uniform(2.0, 60.0, n)
    k = rng.uniform(3e4, 6e5, n)
    c = rng.uniform(0.01, 0.05, n) * 2 * np.sqrt(k * m)
    if not cubic:
        return m, c, k, np.zeros(n)
    usual_drift = 300.0 / k.mean()
    k3 = rng.uniform(0.1, 0.6, n) * k / usual_drift**2
    return m, c, k, k3


def band_limited(
    n_samples: int,
    dt: float,
    rng: np.random.Generator,
    rms: float = 300.0,
    band=(0.5, 60.0),
) -> np.ndarray:
    """A random signal of flat spectrum within a band (Hz)."""
    frequency = np.fft.rfftfreq(n_samples, dt)
    real = rng.standard_normal(frequency.size)
    imaginary = rng.standard_normal(frequency.size)
    inside = (frequency > band[0]) & (frequency < band[1])
    signal = np.fft.irfft((real + 1j * imaginary) * inside, n_samples)
    return rms * signal / signal.std()


def drifts_of(y: np.ndarray) -> np.ndarray:
    """Differences of neighbouring floors along the last axis."""
    s = y.copy()
    s[..., 1:] -= y[..., :-1]
    return s


def integrate(m, c, k, k3, F, dt, ag=None, extra=None):
    """Absolute a, and v, s of batches of chains, shape (3, n_samples, ..., n).

    Parameters have the shape (..., n) and F (n_samples, ..., n); ``extra(x, v)`` is a
    further force on every floor.
    """
    shape = F.shape[1:]
    x = np.zeros(shape)
    v = np.zeros(shape)
    ag = np.zeros(len(F)) if ag is None else ag
    load = F - m * ag.reshape(-1, *[1] * (F.ndim - 1))

    def acceleration(x, v, load):
        """Relative to the base."""
        s = drifts_of(x)
        R = c * drifts_of(v) + (k + k3 * s * s) * s
        total = load - R
        total[..., :-1] += R[..., 1:]
        if extra is not None:
            total += extra(x, v)
        return total / m

    out = np.empty((3, len(F), *shape))
    for i in range(len(F)):
        out[0, i] = acceleration(x, v, load[i]) + ag[i]
        out[1, i] = drifts_of(v)
        out[2, i] = drifts_of(x)
        if i < len(F) - 1:
            x, v = _runge_kutta_step(acceleration, x, v, dt, load[i], load[i + 1])
    return out


def _runge_kutta_step(acceleration, x, v, h, f0, f1):
    """One step of the classical rule of order 4, under a force from f0 to f1."""
    middle = 0.5 * (f0 + f1)
    a1 = acceleration(x, v, f0)
    a2 = acceleration(x + h / 2 * v, v + h / 2 * a1, middle)
    a3 = acceleration(x + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2, middle)
    a4 = acceleration(x + h * v + h * h / 2 * a2, v + h * a3, f1)
    x = x + h * v + h * h / 6 * (a1 + a2 + a3)
    v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return x, v


def _integrate_in_substeps(chain, F, dt, substeps, ag=None, extra=None):
    """Motion at the samples; forces are straight between them."""
    samples = np.arange(len(F))
    fine = np.arange((len(F) - 1) * substeps + 1) / substeps
    forces = [np.interp(fine, samples, force) for force in F.T]
    base = None if ag is None else np.interp(fine, samples, ag)
    motion = integrate(*chain, np.array(forces).T, dt / substeps, base, extra)
    return motion[:, ::substeps]


def duffing(
    n: int,
    forced,
    seed: int = 0,
    n_samples: int = 3000,
    dt: float = 1e-3,
    cubic: bool = True,
    parameters_of_chain=None,
    substeps: int = 1,
    **drive,
) -> Case:
    """One chain, forced by band-limited noise on some DOFs, or shaken at its base.

    ``parameters_of_chain`` are its m, c, k and k3; random ones if None. ``drive`` are
    ag and extra of :func:`integrate`.
    """
    rng = np.random.default_rng(seed)
    m, c, k, k3 = (
        parameters(n, rng, cubic)
        if parameters_of_chain is None
        else parameters_of_chain
    )
    F = np.zeros((n_samples, n))
    for j in forced:
        F[:, j - 1] = band_limited(n_samples, dt, rng)

    motion = _integrate_in_substeps((m, c, k, k3), F, dt, substeps, **drive)
    return Case(np.hstack([*motion]), F, m, c, k, k3, dt, drive.get("ag"))


def each_single(
    n: int, seed: int, n_samples: int = 2000, dt: float = 1e-3, cubic: bool = True
) -> list[Case]:
    """n chains with random parameters, chain j forced on DOF j alone."""
    rng = np.random.default_rng(seed)
    every = [parameters(n, rng, cubic) for _ in range(n)]
    m, c, k, k3 = (np.stack(p) for p in zip(*every, strict=True))
    F = np.zeros((n_samples, n, n))
    for j in range(n):
        F[:, j, j] = band_limited(n_samples, dt, rng)
    motion = integrate(m, c, k, k3, F, dt)
    cases = []
    for j in range(n):
        X = np.hstack(motion[:, :, j])
        cases.append(Case(X, F[:, j], m[j], c[j], k[j], k3[j], dt))
    return cases


def driven(
    model, dofs, seconds: float, fs: float, rms: float, band, seed=0, **how
) -> Record:
    """Free run of a model under band-limited random forces on some DOFs."""
    F = excitation.band_limited_random(
        model.n_dof, seconds, fs, excited=dofs, rms=rms, band=band, random_state=seed
    )
    return simulate(model, F, 1 / fs, **how)


MASS = 10.0  # kg, of both floors of the paper
STOREY_DAMPING = 100.0  # N s/m
STOREY_STIFFNESS = 1e5  # N/m
DAMPER = dict(K0=50.0, C0=399.0, Fd=34.85, sigma=5e4)
FREQUENCIES = np.arange(1.0, 40.0, 0.5)  # Hz


def paper_case(
    rms: float = 200.0,
    seed: int = 0,
    duration: float = 4.0,
    fs: float = 1000.0,
    forced=(1, 2),
    f0: float = 0.0,
):
    """The paper's chain with a modified Dahl damper on storey 1, by SciPy's LSODA.

    Returns the case, the state of the damper, and the force of storey 1.
    """
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, (2, FREQUENCIES.size))
    is_forced = np.array([1.0 * (dof in forced) for dof in (1, 2)])
    amplitude = is_forced * rms * np.sqrt(2 / FREQUENCIES.size)
    omega = 2 * np.pi * FREQUENCIES

    def force(t):
        """Forces on both floors, for one time or for many."""
        angle = np.multiply.outer(t, omega)
        first = np.sin(angle + phase[0]).sum(axis=-1)
        second = np.sin(angle + phase[1]).sum(axis=-1)
        return amplitude[0] * first, amplitude[1] * second

    def storey_forces(x1, x2, v1, v2, z):
        of_damper = DAMPER["C0"] * v1 + DAMPER["K0"] * x1 + DAMPER["Fd"] * z + f0
        R1 = STOREY_DAMPING * v1 + STOREY_STIFFNESS * x1 + of_damper
        R2 = STOREY_DAMPING * (v2 - v1) + STOREY_STIFFNESS * (x2 - x1)
        return R1, R2

    def rate(t, y):
        x1, x2, v1, v2, z = y
        f1, f2 = force(t)
        R1, R2 = storey_forces(x1, x2, v1, v2, z)
        z_rate = DAMPER["sigma"] * (v1 - z * abs(v1))
        return [v1, v2, (f1 - R1 + R2) / MASS, (f2 - R2) / MASS, z_rate]

    t = np.arange(int(duration * fs)) / fs
    run = solve_ivp(
        rate, (0, t[-1]), np.zeros(5), "LSODA", t, rtol=1e-11, atol=1e-13, max_step=5e-4
    )
    x1, x2, v1, v2, z = run.y
    F = np.column_stack(force(t))
    R1, R2 = storey_forces(x1, x2, v1, v2, z)
    a1 = (F[:, 0] - R1 + R2) / MASS
    a2 = (F[:, 1] - R2) / MASS
    X = np.column_stack([a1, a2, v1, v2 - v1, x1, x2 - x1])
    case = Case(
        X,
        F,
        m=np.full(2, MASS),
        c=np.full(2, STOREY_DAMPING),
        k=np.full(2, STOREY_STIFFNESS),
        k3=np.zeros(2),
        dt=1 / fs,
    )
    return case, z, R1


# -- comparisons ---------------------------------------------------------------


def worst(values, truth) -> float:
    """Largest relative error."""
    values = np.asarray(values, dtype=float)
    truth = np.asarray(truth, dtype=float)
    return float(np.max(np.abs(values / truth - 1.0)))


def same(model, reference, tolerance: float = 1e-12) -> None:
    """Assert that two fits have equal masses, coefficients, errors and samples."""
    assert worst(model.masses_, reference.masses_) < tolerance
    for site, law in reference.restoring_forces_.items():
        scale = np.abs(law.coefficients).max()
        coefficients = model.restoring_forces_[site].coefficients / scale
        expected = law.coefficients / scale
        assert np.allclose(coefficients, expected, atol=10 * tolerance, rtol=tolerance)
    # what squares leave of round-off, percent
    errors = model.errors_["error"]
    assert np.allclose(errors, reference.errors_["error"], rtol=1e-8, atol=1e-4)
    assert model.n_samples_ == reference.n_samples_


def table(X, F, **more) -> pd.DataFrame:
    """Features and forces under their names, beside other columns."""
    n = F.shape[1]
    forces = [f"F{j}" for j in range(1, n + 1)]
    columns = [*feature_names(n), *forces]
    return pd.DataFrame(np.hstack([X, F]), columns=columns).assign(**more)


def absent_share(model, case: Case, true=("v", "s", "s^3")) -> float:
    """Largest rms of an absent term, by its storey's rms force."""
    largest = 0.0
    for storey in range(1, case.n + 1):
        v = case.v[:, storey - 1]
        s = case.s[:, storey - 1]
        force = np.sqrt(np.mean(case.storey_forces[:, storey - 1] ** 2))
        for label, value in model.restoring_forces_[storey].coefficients.items():
            if label not in true:
                h, j = powers(label)
                term = np.sqrt(np.mean((value * v**h * s**j) ** 2))
                largest = max(largest, float(term / force))
    return largest


def powers(label: str) -> tuple[int, int]:
    """Exponents (h, j) of a printed monomial ``"v^2 s"``."""
    exponents = {"v": 0, "s": 0}
    for factor in label.split():
        base, _, power = factor.partition("^")
        exponents[base] += int(power or 1)
    return exponents["v"], exponents["s"]


def floor_of_noise(model, record, levels, regressor=None, draws=4, seed=0):
    """Noise floor from free runs of a model with fresh noise, fused like the record.

    ``levels`` are rms values by channel matrix. With a regressor, each run is fitted,
    too.
    """
    from sklearn.base import clone

    from pysindy_nrf.diagnosis import residual_of
    from pysindy_nrf.diagnosis.evidence import NoiseFloor
    from pysindy_nrf.records import from_arrays

    rng = np.random.default_rng(seed)
    ag = record.base_acceleration
    run = simulate(model, record.force, record.dt, base_acceleration=ag)
    residuals = []
    for _ in range(draws):
        noisy = {}
        for channel, level in levels.items():
            noise = level * rng.standard_normal(run.force.shape)
            noisy[channel] = getattr(run, channel) + noise
        X, F = record.replace(**noisy).to_features()
        fitted = model
        if regressor is not None:
            fitted = clone(regressor).fit(X, F, base_acceleration=ag).model_
        data = from_arrays(X, F, dt=record.dt, base_acceleration=ag)
        residuals.append(residual_of(fitted, data))
    return NoiseFloor.from_draws(residuals)
