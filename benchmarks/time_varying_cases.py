"""Chains whose properties change while they shake, and chains that stay as they are.

One case a number: a chain of 2 to 6 floors under random forces or an earthquake, with
noise of 0, 1 or 5 % of the rms of each channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import search_path
import numpy as np

from pysindy_nrf import ChainModel, Record, excitation, laws, simulate
from pysindy_nrf.laws.base import CovariateLaw, ForceLaw, Term
from pysindy_nrf.simulation.noise import add_noise

FS = 250.0  # Hz
SECONDS = 40.0
LEVEL = 300.0  # N rms of a random force
SHAKING = 2.0  # m/s^2 peak of an earthquake
CHANGES = ("ramp", "step", "loss and recovery", "wear", "degrading hysteresis")
CONSTANT = ("linear",)
AMPLITUDE = ("cubic", "hysteresis", "friction")
NOISE = (0.0, 0.01, 0.05)
# Yield drift of a hysteretic storey over the rms drift, and rate below which friction
# creeps over the rms rate, of the linear chain.
YIELD = 1.0
CREEP = 0.05


class ChangingSpring(CovariateLaw):
    """Spring whose stiffness follows a covariate, ``R = k u s``."""

    name = "changing_spring"
    family = "benchmark"
    columns = (Term("k", "u s", "N/m"),)

    def __init__(self, k: float | None = None, covariate: str = "course") -> None:
        super().__init__(covariate, {}, {"k": k})

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = u[0] * s


class WearingFriction(CovariateLaw):
    """Friction whose level follows a covariate, ``R = Fc u tanh(v / v0)``."""

    name = "wearing_friction"
    family = "benchmark"
    columns = (Term("Fc", "u tanh(v/v0)", "N"),)

    def __init__(self, v0: float, Fc: float | None = None) -> None:
        super().__init__("course", {}, {"Fc": Fc})
        self.v0 = float(v0)

    def options(self) -> dict[str, object]:
        return {"v0": self.v0}

    @property
    def theta(self) -> np.ndarray:
        return np.array([self.v0])

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = u[0] * np.tanh(v / theta[0])


@dataclass(frozen=True, eq=False)
class Case:
    """A record, what is declared of the structure, and what is true.

    Attributes
    ----------
    kind, shaking : str
    noise : float
    record : Record
    declared : dict
        Laws by storey, beside linear storeys.
    known_masses : dict or None
    storey : int
        Whose property changes; 0 if nothing does.
    term : str
        The term that changes.
    truth : ndarray or None
        Its coefficient at the samples; None where it has no value by itself.
    instants : tuple of float
        Of sudden changes, s.
    period : float
        Of the first mode, s.
    """

    kind: str
    shaking: str
    noise: float
    record: Record
    declared: dict[str, list[ForceLaw]]
    known_masses: dict[int, float] | None
    storey: int
    term: str
    truth: np.ndarray | None
    instants: tuple[float, ...]
    period: float

    @property
    def about(self) -> str:
        return f"n {self.record.n_dof}, {self.shaking}, noise {self.noise:.0%}"


def changing_case(number: int, seed: int) -> Case:
    """A chain in which a property of one storey changes."""
    rng = np.random.default_rng([seed, number])
    kind = CHANGES[number % len(CHANGES)]
    noise = NOISE[number // len(CHANGES) % len(NOISE)]
    shaking = ("random", "earthquake")[number // 15 % 2]
    return _Draw(rng, kind, shaking, noise).case()


def constant_case(number: int, seed: int) -> Case:
    """A linear chain that does not change."""
    rng = np.random.default_rng([seed, 1, number])
    noise = NOISE[number % len(NOISE)]
    shaking = ("random", "earthquake")[number // 3 % 2]
    return _Draw(rng, "linear", shaking, noise).case()


def amplitude_case(number: int, seed: int) -> Case:
    """A chain with a nonlinear storey that does not change, in a pulse."""
    rng = np.random.default_rng([seed, 2, number])
    kind = AMPLITUDE[number % len(AMPLITUDE)]
    noise = NOISE[number // len(AMPLITUDE) % len(NOISE)]
    return _Draw(rng, kind, "pulse", noise).case()


@dataclass(frozen=True, eq=False)
class _Structure:
    """Laws by storey, what of them is declared, and what changes."""

    storeys: dict[str, list[ForceLaw]]
    declared: dict[str, list[ForceLaw]]
    term: str = "s"
    truth: np.ndarray | None = None


class _Draw:
    """Draws one case."""

    def __init__(
        self, rng: np.random.Generator, kind: str, shaking: str, noise: float
    ) -> None:
        self.rng = rng
        self.kind = kind
        self.shaking = shaking
        self.noise = noise
        self.n = int(rng.integers(2, 7))
        self.m = rng.uniform(80, 140, self.n)
        self.k = rng.uniform(0.6e5, 1.4e5, self.n)
        self.c = rng.uniform(150, 400, self.n)
        self.storey = int(rng.integers(1, self.n + 1))
        self.t = np.arange(int(SECONDS * FS)) / FS
        self.instants: tuple[float, ...] = ()
        self.seed = int(rng.integers(2**31))

    def case(self) -> Case:
        """The case."""
        linear = ChainModel(self.m, self._linear_laws())
        course = self._course()
        structure = self._structure(self._run(linear, np.ones_like(self.t)), course)
        record = self._run(ChainModel(self.m, structure.storeys), course)
        measured = record.replace(covariates={})
        known_masses = None
        if self.shaking != "random":
            known_masses = {j: float(m) for j, m in enumerate(self.m, start=1)}
        return Case(
            self.kind,
            self.shaking,
            self.noise,
            add_noise(measured, self.noise, random_state=self.rng),
            structure.declared,
            known_masses,
            self.storey if self.kind in CHANGES else 0,
            structure.term,
            structure.truth,
            self.instants,
            float(1.0 / linear.modes()["frequency"].iloc[0]),
        )

    def _linear_laws(self) -> dict[str, list[ForceLaw]]:
        storeys: dict[str, list[ForceLaw]] = {}
        for i, (k, c) in enumerate(zip(self.k, self.c), start=1):
            storeys[f"storey {i}"] = [laws.LinearElastic(k), laws.LinearViscous(c)]
        return storeys

    def _course(self) -> np.ndarray:
        """Property over its first value."""
        t, rng = self.t, self.rng
        loss = rng.uniform(0.15, 0.4)
        first = rng.uniform(0.25, 0.45) * SECONDS
        last = rng.uniform(0.6, 0.8) * SECONDS
        if self.shaking == "earthquake":
            # while the strong phase lasts
            first, last = 0.35 * first + 3.0, 0.5 * last
        if self.kind == "step":
            self.instants = (first,)
            return 1 - loss * (t >= first)
        if self.kind == "loss and recovery":
            middle, width = 0.5 * (first + last), 0.25 * (last - first)
            return 1 - loss * np.exp(-0.5 * ((t - middle) / width) ** 2)
        if self.kind == "wear":
            loss *= 2
        return 1 - loss * np.clip((t - first) / (last - first), 0, 1)

    def _structure(self, calm: Record, course: np.ndarray) -> _Structure:
        """What the storey of the case does, by the motion of the linear chain."""
        storeys = self._linear_laws()
        site = f"storey {self.storey}"
        k = self.k[self.storey - 1]
        damping = storeys[site][1]
        drift = rms_between_floors(calm.displacement, self.storey)
        rate = rms_between_floors(calm.velocity, self.storey)
        if self.kind in ("ramp", "step", "loss and recovery"):
            storeys[site] = [ChangingSpring(k), damping]
            return _Structure(storeys, {}, "s", k * course)
        if self.kind == "wear":
            level = self.rng.uniform(0.3, 0.6) * k * drift
            storeys[site].append(WearingFriction(CREEP * rate, level))
            friction = laws.RegularizedFriction(v0=CREEP * rate)
            declared = {site: [laws.PowerSeries(1), friction]}
            return _Structure(storeys, declared, "tanh(v/v0)", level * course)
        if self.kind != "linear":
            storeys[site] = [damping, *self._nonlinear_laws(k, drift)]
        return _Structure(storeys, {})

    def _nonlinear_laws(self, k: float, drift: float) -> list[ForceLaw]:
        """Springs of a nonlinear storey of a stiffness and an rms drift."""
        if self.kind == "cubic":
            hardening = self.rng.uniform(0.05, 0.4) * k / (3 * drift**2)
            return [laws.Duffing(k, hardening)]
        if self.kind == "friction":
            level = self.rng.uniform(0.2, 0.5) * k * drift
            return [laws.LinearElastic(k), laws.Dahl(20 / drift, level)]
        share = self.rng.uniform(0.3, 0.7)
        spring = laws.LinearElastic((1 - share) * k)
        beta = 1 / (YIELD * drift)
        if self.kind == "hysteresis":
            return [spring, laws.BoucWen(beta=beta, alpha=share * k, rho=0.0, n=1.0)]
        worn = 0.03 / drift
        return [spring, laws.DegradingBoucWen(beta, worn, worn, alpha=share * k)]

    def _run(self, model: ChainModel, course: np.ndarray) -> Record:
        """The motion."""
        covariates = {"course": course}
        if self.shaking == "random":
            F = excitation.band_limited_random(
                self.n,
                SECONDS,
                FS,
                excited=list(range(1, self.n + 1)),
                rms=LEVEL,
                band=(0.3, 12),
                random_state=self.seed,
            )
            return simulate(model, F, 1 / FS, covariates=covariates)
        ag = self._ground(np.random.default_rng(self.seed))
        return simulate(
            model, None, 1 / FS, base_acceleration=ag, covariates=covariates
        )

    def _ground(self, rng: np.random.Generator) -> np.ndarray:
        """Acceleration of the base: a strong phase that fades, or a pulse in it."""
        t = self.t
        f = np.fft.rfftfreq(len(t), 1 / FS)
        octaves = np.log(np.maximum(f, 1e-3) / 2.5)
        spectrum = np.fft.rfft(rng.standard_normal(len(t))) * np.exp(-(octaves**2))
        fading = np.exp(-np.maximum(t - 8.0, 0) / 8.0)
        ground = np.fft.irfft(spectrum, len(t)) * np.minimum(t / 3.0, 1.0) ** 2 * fading
        ground *= SHAKING / np.abs(ground).max()
        if self.shaking == "pulse":
            x = (t - 6.0) / 0.6
            pulse = np.cos(2.2 * x) * np.exp(-0.5 * x**2)
            ground = 0.25 * ground + SHAKING * pulse
        return ground


def rms_between_floors(motion: np.ndarray, storey: int) -> float:
    """Rms of the drift or the rate of a storey."""
    between = np.diff(motion, axis=1, prepend=0.0)
    return float(between[:, storey - 1].std())
