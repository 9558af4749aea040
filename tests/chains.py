"""Chains simulated without the package: an own Runge-Kutta rule for batches, SciPy for
hysteresis.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from pysindy_nrf import Record, excitation, simulate
from pysindy_nrf.records.dataset import feature_names


@dataclass
class Case:
    """One record of a Duffing chain ``R_i = c_i v_i + k_i s_i + k3_i s_i^3`` and its
    true parameters.
    """

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
        return self.X + share * self.X.std(axis=0) * np.random.default_rng(
            seed
        ).standard_normal(self.X.shape)

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
    """Random masses, dampings and stiffnesses in SI units of a laboratory frame, ten
    orders apart.
    """
    m = rng.uniform(2.0, 60.0, n)
    k = rng.uniform(3e4, 6e5, n)
    c = rng.uniform(0.01, 0.05, n) * 2 * np.sqrt(k * m)
    level = 300.0 / k.mean()
    return m, c, k, (rng.uniform(0.1, 0.6, n) * k / level**2 if cubic else np.zeros(n))


def band_limited(
    n_samples: int,
    dt: float,
    rng: np.random.Generator,
    rms: float = 300.0,
    band=(0.5, 60.0),
) -> np.ndarray:
    f = np.fft.rfftfreq(n_samples, dt)
    spectrum = (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) * (
        (f > band[0]) & (f < band[1])
    )
    signal = np.fft.irfft(spectrum, n_samples)
    return rms * signal / signal.std()


def integrate(m, c, k, k3, F, dt, ag=None, extra=None, substeps=1, x0=None):
    """Batches of chains: parameters (..., n), F (n_samples, ..., n); returns absolute
    a, and v, s.
    """
    shape = F.shape[1:]
    x, v = (
        (np.zeros(shape) if x0 is None else np.broadcast_to(x0, shape).copy()),
        np.zeros(shape),
    )
    ag = np.zeros(len(F)) if ag is None else ag
    out = np.empty((3, len(F), *shape))

    def drift(y):
        d = y.copy()
        d[..., 1:] -= y[..., :-1]
        return d

    def acceleration(x, v, f):  # relative to the base if f holds -m ag
        s = drift(x)
        R = c * drift(v) + (k + k3 * s * s) * s
        total = f - R
        total[..., :-1] += R[..., 1:]
        if extra is not None:
            total += extra(x, v)
        return total / m

    h = dt / substeps
    load = F - m * ag.reshape(-1, *(1,) * (F.ndim - 1))
    for i in range(len(F)):
        a1 = acceleration(x, v, load[i])
        out[0, i], out[1, i], out[2, i] = a1 + ag[i], drift(v), drift(x)
        if i == len(F) - 1:
            break
        for q in range(substeps):
            f0, f1 = (
                load[i] + (load[i + 1] - load[i]) * p / substeps for p in (q, q + 1)
            )
            fm = 0.5 * (f0 + f1)
            a1 = acceleration(x, v, f0) if q else a1
            a2 = acceleration(x + h / 2 * v, v + h / 2 * a1, fm)
            a3 = acceleration(x + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2, fm)
            a4 = acceleration(x + h * v + h * h / 2 * a2, v + h * a3, f1)
            x = x + h * v + h * h / 6 * (a1 + a2 + a3)
            v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return out


def duffing(
    n: int,
    forced,
    seed: int = 0,
    n_samples: int = 3000,
    dt: float = 1e-3,
    cubic: bool = True,
    ag=None,
    rms: float = 300.0,
    given=None,
    extra=None,
    substeps: int = 1,
) -> Case:
    """One chain, forced by band-limited noise on some DOFs (or shaken at its base)."""
    rng = np.random.default_rng(seed)
    m, c, k, k3 = parameters(n, rng, cubic) if given is None else given
    F = np.zeros((n_samples, n))
    for j in forced:
        F[:, j - 1] = band_limited(n_samples, dt, rng, rms)
    a, v, s = integrate(m, c, k, k3, F, dt, ag, extra, substeps)
    return Case(np.hstack([a, v, s]), F, m, c, k, k3, dt, ag)


def each_single(
    n: int, seed: int, n_samples: int = 2000, dt: float = 1e-3, cubic: bool = True
) -> list[Case]:
    """n chains with random parameters, chain j forced on DOF j alone; integrated as one
    batch.
    """
    rng = np.random.default_rng(seed)
    every = [parameters(n, rng, cubic) for _ in range(n)]
    m, c, k, k3 = (np.stack(p) for p in zip(*every, strict=True))
    F = np.zeros((n_samples, n, n))
    for j in range(n):
        F[:, j, j] = band_limited(n_samples, dt, rng)
    a, v, s = integrate(m, c, k, k3, F, dt)
    return [
        Case(
            np.hstack([a[:, j], v[:, j], s[:, j]]), F[:, j], m[j], c[j], k[j], k3[j], dt
        )
        for j in range(n)
    ]


def driven(
    model, dofs, seconds: float, fs: float, rms: float, band, seed=0, **how
) -> Record:
    """Free run of a model under band-limited random forces on some DOFs."""
    F = excitation.band_limited_random(
        model.n_dof, seconds, fs, excited=dofs, rms=rms, band=band, random_state=seed
    )
    return simulate(model, F, 1 / fs, **how)


PAPER = dict(
    m=np.array([10.0, 10.0]), c=np.array([100.0, 100.0]), k=np.array([1e5, 1e5])
)
DAMPER = dict(K0=50.0, C0=399.0, Fd=34.85, sigma=5e4)


def paper_case(
    rms: float = 200.0,
    seed: int = 0,
    duration: float = 4.0,
    fs: float = 1000.0,
    forced=(1, 2),
    f0: float = 0.0,
):
    """The paper's 2-DOF chain with a modified Dahl damper on storey 1, integrated by
    SciPy's LSODA.
    """
    rng = np.random.default_rng(seed)
    frequency = np.arange(1.0, 40.0, 0.5)
    phase = rng.uniform(0, 2 * np.pi, (2, frequency.size))
    gain = (
        np.array([1.0 * (j in forced) for j in (1, 2)])
        * rms
        * np.sqrt(2 / frequency.size)
    )
    m, c, k = PAPER["m"], PAPER["c"], PAPER["k"]

    def force(t):
        return gain * np.sin(
            2 * np.pi * np.multiply.outer(np.atleast_1d(t), frequency)[:, None, :]
            + phase
        ).sum(axis=-1)

    omega = 2 * np.pi * frequency
    (p1, p2), (g1, g2) = phase, gain
    m1, m2, c1, c2, k1, k2 = *m, *c, *k
    sin = np.sin

    def rate(t, y):
        x1, x2, v1, v2, z = y
        arg = omega * t
        f1, f2 = g1 * sin(arg + p1).sum(), g2 * sin(arg + p2).sum()
        R1 = (c1 + DAMPER["C0"]) * v1 + (k1 + DAMPER["K0"]) * x1 + DAMPER["Fd"] * z + f0
        R2 = c2 * (v2 - v1) + k2 * (x2 - x1)
        return [
            v1,
            v2,
            (f1 - R1 + R2) / m1,
            (f2 - R2) / m2,
            DAMPER["sigma"] * (v1 - z * abs(v1)),
        ]

    t = np.arange(int(duration * fs)) / fs
    run = solve_ivp(
        rate, (0, t[-1]), np.zeros(5), "LSODA", t, rtol=1e-11, atol=1e-13, max_step=5e-4
    )
    x1, x2, v1, v2, z = run.y
    F = force(t)
    s, v = np.column_stack([x1, x2 - x1]), np.column_stack([v1, v2 - v1])
    R1 = (c1 + DAMPER["C0"]) * v1 + (k1 + DAMPER["K0"]) * x1 + DAMPER["Fd"] * z + f0
    R2 = c2 * v[:, 1] + k2 * s[:, 1]
    a = np.column_stack([(F[:, 0] - R1 + R2) / m1, (F[:, 1] - R2) / m2])
    return Case(np.hstack([a, v, s]), F, m, c, k, np.zeros(2), 1 / fs), z, R1


def worst(found, truth) -> float:
    """Largest relative error."""
    found, truth = np.asarray(found, dtype=float), np.asarray(truth, dtype=float)
    return float(np.max(np.abs(found / truth - 1.0)))


def same(model, reference, tolerance: float = 1e-12) -> None:
    """Two fitted models hold the same masses, coefficients, errors and number of
    samples.
    """
    assert worst(model.masses_, reference.masses_) < tolerance
    for site, law in reference.restoring_forces_.items():
        found, scale = (
            model.restoring_forces_[site].coefficients,
            np.abs(law.coefficients).max(),
        )
        assert np.allclose(
            found / scale, law.coefficients / scale, atol=10 * tolerance, rtol=tolerance
        )
    assert np.allclose(model.errors_["error"], reference.errors_["error"], rtol=1e-8)
    assert model.n_samples_ == reference.n_samples_


def table(X, F, **more) -> pd.DataFrame:
    """Features and forces under their names, beside other columns."""
    n = F.shape[1]
    return pd.DataFrame(
        np.hstack([X, F]), columns=[*feature_names(n), *(f"F{j + 1}" for j in range(n))]
    ).assign(**more)


def absent_share(model, case: Case, true=("v", "s", "s^3")) -> float:
    """Largest rms of an absent term as a share of its storey's rms force."""
    largest = 0.0
    for i in range(1, case.n + 1):
        whole = np.sqrt(np.mean(case.storey_forces[:, i - 1] ** 2))
        for label, value in model.restoring_forces_[i].coefficients.items():
            if label not in true:
                h, j = powers(label)
                term = value * case.v[:, i - 1] ** h * case.s[:, i - 1] ** j
                largest = max(largest, float(np.sqrt(np.mean(term**2)) / whole))
    return largest


def powers(label: str) -> tuple[int, int]:
    """Exponents (h, j) of a printed monomial ``"v^2 s"``."""
    h = j = 0
    for factor in label.split():
        base, _, power = factor.partition("^")
        h, j = (h + int(power or 1), j) if base == "v" else (h, j + int(power or 1))
    return h, j


def floor_of_noise(model, record, levels, regressor=None, draws=4, seed=0):
    """Noise floor from free runs of a model with fresh noise (rms by channel matrix),
    fused and fitted like the record.
    """
    from sklearn.base import clone

    from pysindy_nrf.discrepancy.residual import NoiseFloor, residual_of
    from pysindy_nrf.records.input_arrays import from_arrays

    rng, ag = np.random.default_rng(seed), record.base_acceleration
    run = simulate(model, record.force, record.dt, base_acceleration=ag)
    found = []
    for _ in range(draws):
        noisy = {
            k: getattr(run, k) + level * rng.standard_normal(run.force.shape)
            for k, level in levels.items()
        }
        X, F = record.replace(**noisy).to_features()
        fitted = (
            model
            if regressor is None
            else clone(regressor).fit(X, F, base_acceleration=ag).model_
        )
        found.append(
            residual_of(fitted, from_arrays(X, F, dt=record.dt, base_acceleration=ag))
        )
    return NoiseFloor.from_draws(found)
