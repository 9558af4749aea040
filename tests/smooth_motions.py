"""Motions in closed form, and of a linear chain, for tests of the fusion."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from pysindy_nrf import ChainModel, Record, laws, simulate

FS = 1000.0
MASS = 12.4
CHAIN = ChainModel(
    [MASS] * 4, {storey: laws.PowerSeries(1, [25.0, 1.4e5]) for storey in (1, 2, 3, 4)}
)


@dataclass(frozen=True)
class Motion:
    """Acceleration, velocity and displacement of some DOFs, (n_samples, n_dof)."""

    t: np.ndarray
    a: np.ndarray
    v: np.ndarray
    x: np.ndarray
    force: np.ndarray | None = None
    fs: float = FS

    def record(self, kinds="avx", **more) -> Record:
        """Record of some kinds of channels."""
        names = {"a": "acceleration", "v": "velocity", "x": "displacement"}
        channels = {names[kind]: getattr(self, kind) for kind in kinds}
        return Record(force=self.force, fs=self.fs, **channels | more)

    def noisy(self, share, seed) -> "Motion":
        """With noise of a share of the rms in every channel."""
        rng = np.random.default_rng(seed)
        a, v, x = (with_noise(y, share, rng) for y in (self.a, self.v, self.x))
        return Motion(self.t, a, v, x, self.force, self.fs)


def with_noise(y, share, rng):
    return y + share * y.std(axis=0) * rng.normal(size=y.shape)


def rms(y):
    return np.sqrt(np.mean(np.square(y), axis=0))


def harmonics(frequencies, sizes, n_samples=4000, fs=FS, phase=0.3) -> Motion:
    """Sums of sines, one row of sizes for each DOF; not periodic in the record."""
    t = np.arange(n_samples) / fs
    w = 2 * np.pi * np.asarray(frequencies)
    angle = np.multiply.outer(t, w) + phase
    sizes = np.atleast_2d(sizes).T
    x = np.sin(angle) @ sizes
    v = (w * np.cos(angle)) @ sizes
    a = (-(w**2) * np.sin(angle)) @ sizes
    return Motion(t, a, v, x, fs=fs)


def two_floors(n_samples=4000, top=FS / 20) -> Motion:
    """Two DOFs that move below ``top`` Hz."""
    sizes = [[1e-3, 0.3e-3, 2e-3], [0.5e-3, -0.6e-3, 1e-3]]
    return harmonics(top * np.array([0.97, 0.31, 0.053]), sizes, n_samples)


@cache
def chain_test(kind, seed, substeps=2) -> Motion:
    """A linear chain of four floors for 16 s, the third forced at random or hit."""
    rng = np.random.default_rng(seed)
    dt = 1 / (FS * substeps)
    t = np.arange(16000 * substeps) * dt
    force = np.zeros((len(t), 4))
    force[:, 2] = _random(t, rng) if kind == "random" else _blows(t, rng)
    run = simulate(CHAIN, force, dt)
    every = slice(None, None, substeps)
    return Motion(
        t[every],
        run.acceleration[every],
        run.velocity[every],
        run.displacement[every],
        force[every],
    )


def _random(t, rng):
    """300 N rms from 0.5 to 60 Hz."""
    f = np.fft.rfftfreq(len(t) + 5000, t[1])
    lines = rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))
    lines[(f <= 0.5) | (f >= 60)] = 0.0
    force = np.fft.irfft(lines)[: len(t)]
    return 300 * force / force.std()


def _blows(t, rng):
    """Half sines of some 1000 N and 6 ms, one in two seconds."""
    force = np.zeros(len(t))
    for start in np.arange(0.5, 15.5, 2) + rng.uniform(0, 0.5, 8):
        after = t - start
        hit = (after > 0) & (after < 0.006)
        size = 1000 * rng.uniform(0.7, 1.3)
        force[hit] += size * np.sin(np.pi * after[hit] / 0.006)
    return force


def chain_masses(X, F):
    """Masses of that chain: balance 3, then those of floors 4, 2 and 1 with the storey
    that is known by then.
    """
    a, v, s = (X.filter(regex=f"^{kind}").to_numpy().T for kind in "avs")
    F = F.to_numpy().T
    m3, c3, k3, c4, k4 = _fit([a[2], v[2], s[2], -v[3], -s[3]], F[2])
    (m4,) = _fit([a[3]], F[3] - c4 * v[3] - k4 * s[3])
    m2, c2, k2 = _fit([a[1], v[1], s[1]], F[1] + c3 * v[2] + k3 * s[2])
    m1, _, _ = _fit([a[0], v[0], s[0]], F[0] + c2 * v[1] + k2 * s[1])
    return np.array([m1, m2, m3, m4])


def _fit(columns, target):
    matrix = np.column_stack(columns)
    size = matrix.std(axis=0)
    return np.linalg.lstsq(matrix / size, target, rcond=None)[0] / size
