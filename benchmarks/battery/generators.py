"""Random chains with hidden effects, simulated.

The truth stays in the case; the loop sees the records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from .formulas import CODE, KINDS, N_PAR, along, integrate
from .loads import EXCITATIONS, base_motion, draw_loads
from .sensors import imperfect

N_SAMPLES = 8192
# Effect over its storey's force (rms), smallest and largest.
SHARE = (0.03, 0.30)
TRIALS = 200  # chains that are drawn for a case at most
FRICTIONS = ("coulomb", "stribeck", "asymmetric_friction", "ground_friction")


# -- what a case is made of ----------------------------------------------------


@dataclass(frozen=True)
class Effect:
    """An undeclared effect.

    It acts on a link (p, q), where q = 0 is the ground, or on DOF p from outside.
    Parameters are in SI units, the amplitude first.
    """

    kind: str
    p: int
    q: int
    par: np.ndarray
    share: float = 0.0

    @property
    def on_dof(self) -> bool:
        """Whether it acts on one DOF from outside."""
        return self.kind in ("harmonic", "constant")

    @property
    def site(self) -> str:
        """Where, in the grammar of the package."""
        if self.on_dof:
            return f"dof {self.p}"
        if self.p == self.q + 1:
            return f"storey {self.p}"
        if self.q == 0:
            return f"ground {self.p}"
        return f"link {self.p}-{self.q}"

    def between_ends(self, y: np.ndarray) -> np.ndarray:
        """Difference of a motion of the DOFs between the two ends."""
        return y[:, self.p - 1] - (y[:, self.q - 1] if self.q else 0.0)

    def force(self, t, s, v, vg, n_substeps: int = 16) -> np.ndarray:
        """Force along a motion of its two ends, N."""
        motion = [np.ascontiguousarray(y, dtype=float) for y in (s, v, t, vg)]
        return along(CODE[self.kind], self.par, *motion, n_substeps)


@dataclass(frozen=True)
class Structure:
    """Masses (kg) and storey laws k s + c v + k3 s^3 (N/m, N s/m, N/m^3)."""

    m: np.ndarray
    k: np.ndarray
    c: np.ndarray
    k3: np.ndarray

    @property
    def n(self) -> int:
        """Number of masses."""
        return len(self.m)

    def force_of(self, storey: int, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Force of a storey along a motion of the DOFs, N."""
        i = storey - 1
        s = drift(x, storey)
        return self.k[i] * s + self.c[i] * drift(v, storey) + self.k3[i] * s**3


class Loads(NamedTuple):
    """Forces, and the base's acceleration, velocity and displacement."""

    F: np.ndarray
    ag: np.ndarray
    vg: np.ndarray
    xg: np.ndarray


@dataclass(frozen=True)
class Run:
    """A simulated test without noise: loads, motion, forces of the effects."""

    fs: float
    F: np.ndarray
    ag: np.ndarray
    vg: np.ndarray
    xg: np.ndarray
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    effects: np.ndarray

    @property
    def t(self) -> np.ndarray:
        """Seconds."""
        return np.arange(len(self.x)) / self.fs

    @property
    def is_finite(self) -> bool:
        """Whether the motion stayed within the range of numbers."""
        return bool(np.isfinite(self.x).all())

    def ends(self, effect: Effect) -> tuple[np.ndarray, np.ndarray]:
        """Drift and rate between the ends of an effect."""
        return effect.between_ends(self.x), effect.between_ends(self.v)


@dataclass(frozen=True)
class Plan:
    """What to draw.

    Parameters
    ----------
    name, group : str
    seed : int
    noise : float
        White noise on every channel that is measured (F of the forced DOFs, a, v, x of
        all DOFs, and ag, vg, xg of a moving base), as a share of its rms.
    kinds : tuple of str
        Effects; on different sites if several.
    base : bool
        Base excitation with known masses, instead of forces.
    degree : int
        Of the storeys: 1 linear, 3 with a cubic spring that is part of the declared
        model.
    n_samples : int
    largest : int
        Masses at most.
    excitation : str, optional
    accelerations_only : bool
        One force and the accelerations of all DOFs are all that is measured.
    sensors : str
        One of ``sensors.FAULTS``: an imperfection that all sensors share.
    every : bool
        The effect is in every storey, of four at least.
    """

    name: str
    group: str
    seed: int
    noise: float
    kinds: tuple[str, ...] = ()
    base: bool = False
    degree: int = 1
    n_samples: int = N_SAMPLES
    largest: int = 6
    excitation: str | None = None
    accelerations_only: bool = False
    sensors: str = ""
    every: bool = False

    @property
    def smallest(self) -> int:
        """Masses at least."""
        if self.every:
            return 4
        if "brace" in self.kinds:
            return 3
        if not all(possible(kind, 1, self.base) for kind in self.kinds):
            return 2
        return max(len(self.kinds), 1)


@dataclass(frozen=True)
class Case:
    """One case of the battery.

    ``searched`` and ``unseen`` are what the loop gets: channels as dictionaries.
    ``beside`` are effects that are there and not asked for.
    """

    name: str
    group: str
    seed: int
    noise: float
    degree: int
    excitation: str
    forced: tuple[int, ...]
    structure: Structure
    effects: list[Effect]
    runs: list[Run]
    searched: list[dict]
    unseen: list[dict]
    sensors: str = ""
    beside: Sequence[Effect] = ()

    @property
    def base(self) -> bool:
        """Whether the base moves and no force acts."""
        return not self.forced


# -- structures ----------------------------------------------------------------


def drift(y: np.ndarray, storey: int) -> np.ndarray:
    """Motion of a storey: that of its upper DOF less that of its lower one."""
    return y[:, storey - 1] - (y[:, storey - 2] if storey > 1 else 0.0)


def rms(y: np.ndarray) -> float:
    return np.sqrt(np.mean(y**2))


def frequencies(m, k) -> np.ndarray:
    """Natural frequencies of the undamped chain, Hz."""
    stiffness = np.diag(k + np.append(k[1:], 0.0))
    stiffness -= np.diag(k[1:], 1) + np.diag(k[1:], -1)
    squares = np.linalg.eigvalsh(stiffness / np.sqrt(np.outer(m, m)))
    return np.sqrt(squares) / (2 * np.pi)


def draw_structure(rng, n: int) -> tuple[Structure, np.ndarray]:
    """A linear chain and its natural frequencies, which lie between 1 and 30 Hz.

    Masses are 5 to 5e4 kg, damping is 1 to 3 % in each storey.
    """
    size = 10 ** rng.uniform(np.log10(5), np.log10(5e4))
    m = np.clip(size * rng.uniform(0.7, 1.4, n), 5.0, 5e4)
    k = m.mean() * rng.uniform(0.6, 1.6, n)
    f = frequencies(m, k)

    lowest = min(1.05 * f[-1] / f[0], 29.0)
    highest = np.exp(rng.uniform(np.log(lowest), np.log(30.0)))
    k = k * (highest / f[-1]) ** 2
    c = 2 * rng.uniform(0.01, 0.03, n) * np.sqrt(k * m)
    return Structure(m, k, c, np.zeros(n)), frequencies(m, k)


def scaled_loads(rng, structure, f, fs, how, forced, n, drift) -> Loads:
    """Forces or a base motion that make an rms drift (m) of the linear chain."""
    loads = unscaled_loads(rng, structure, f, fs, how, forced, n)
    run = simulated(structure, [], loads, fs, n_substeps=4)
    return scaled(loads, drift / rms(np.diff(run.x, axis=1, prepend=0.0)))


def unscaled_loads(rng, structure, f, fs, how, forced, n) -> Loads:
    """Forces, as large as the masses they act on, or a base motion."""
    F = np.zeros((n, structure.n))
    still = np.zeros(n)
    if not forced:
        ag = draw_loads(rng, how, 1, n, fs, f)[:, 0]
        return Loads(F, *base_motion(ag, fs, 0.4 * f[0]))
    columns = [j - 1 for j in forced]
    F[:, columns] = draw_loads(rng, how, len(columns), n, fs, f) * structure.m[columns]
    return Loads(F, still, still, still)


def scaled(loads: Loads, scale: float) -> Loads:
    """Loads times a factor."""
    return Loads(*(y * scale for y in loads))


# -- simulation ----------------------------------------------------------------


def simulate(structure: Structure, effects: list[Effect], F, ag, vg, xg, fs) -> Run:
    """One test from rest; loads are cubic splines between the samples."""
    return simulated(structure, effects, Loads(F, ag, vg, xg), fs)


def simulated(
    structure: Structure,
    effects: list[Effect],
    loads: Loads,
    fs: float,
    n_substeps: int = 12,
) -> Run:
    """One test from rest, with sub-steps as small as the effects ask for."""
    t = np.arange(len(loads.F)) / fs
    spline = CubicSpline(t, np.column_stack([loads.F, loads.ag, loads.vg]))
    kinds = [CODE[effect.kind] for effect in effects]
    ends = [(effect.p, effect.q) for effect in effects]
    pars = [effect.par for effect in effects]
    motion = integrate(
        np.ascontiguousarray(spline.c),
        len(t),
        1 / fs,
        substeps_for(structure, effects, fs, n_substeps),
        structure.m,
        structure.k,
        structure.c,
        structure.k3,
        np.array(kinds, dtype=np.int64),
        np.array(ends, dtype=np.int64).reshape(-1, 2),
        np.array(pars, dtype=float).reshape(-1, N_PAR),
    )
    return Run(fs, *loads, *motion)


def substeps_for(structure, effects: list[Effect], fs: float, least: int) -> int:
    """Enough sub-steps for the steepest part of the effects."""
    lightest = structure.m.min()
    rate = max([steepness(effect, lightest) for effect in effects], default=0.0)
    if rate > 0.0:
        least = 4 * least
    return int(np.clip(np.ceil(1.5 * rate / fs), least, 400))


def steepness(effect: Effect, mass: float) -> float:
    """Rate (1/s) at which an effect can turn a mass round; 0 for the smooth ones."""
    amplitude, first, second = effect.par[:3]
    if effect.kind in FRICTIONS:
        return 2.0 * amplitude * (1 + abs(second)) / first / mass
    if effect.kind == "power_damping":
        return 2.0 * amplitude * first ** (second - 1) / mass
    if effect.kind in ("one_sided_gap", "two_sided_gap", "brace", "ground_link"):
        return 4 * np.sqrt(2 * amplitude / mass)
    if effect.kind == "dahl":
        return 4 * np.sqrt(2 * amplitude * first / mass)
    if effect.kind in ("jenkins", "bouc_wen"):
        return 4 * np.sqrt(2 * amplitude / first / mass)
    return 0.0


# -- shapes of the effects -----------------------------------------------------


class Size(NamedTuple):
    """Rms drift (m) and rate (m/s), duration (s), natural frequencies (Hz)."""

    s: float
    v: float
    duration: float
    f: np.ndarray


# powers of drift and rate by which a parameter grows with the motion
FIXED = (0, 0)
BY_DRIFT = (1, 0)
BY_RATE = (0, 1)
PER_DRIFT = (-1, 0)
Parameters = list[tuple[float, tuple[int, int]]]


def friction_shape(rng, size: Size) -> Parameters:
    """Rate within which the friction turns round."""
    return [(size.v * 10 ** rng.uniform(-3, -2), BY_RATE)]


def stribeck_shape(rng, size: Size) -> Parameters:
    turn = friction_shape(rng, size)
    static = rng.uniform(0.5, 1.5)
    return [*turn, (static, FIXED), (size.v * rng.uniform(0.2, 0.8), BY_RATE)]


def asymmetric_shape(rng, size: Size) -> Parameters:
    turn = friction_shape(rng, size)
    return [*turn, (rng.choice([-1, 1]) * rng.uniform(0.25, 0.6), FIXED)]


def quadratic_damping_shape(rng, size: Size) -> Parameters:
    return [(1e-3 * size.v, BY_RATE)]


def power_damping_shape(rng, size: Size) -> Parameters:
    return [(1e-3 * size.v, BY_RATE), (rng.uniform(0.25, 0.55), FIXED)]


def corner_width(rng, size: Size) -> float:
    """Width of a corner: none, or rounded."""
    return 0.0 if rng.random() < 0.5 else size.s * rng.uniform(0.01, 0.05)


def gap_shape(rng, size: Size) -> Parameters:
    gap = size.s * rng.uniform(0.4, 1.4)
    width = corner_width(rng, size)
    return [(gap, BY_DRIFT), (width, BY_DRIFT), (rng.choice([-1.0, 1.0]), FIXED)]


def bilinear_shape(rng, size: Size) -> Parameters:
    return [(corner_width(rng, size), BY_DRIFT)]


def dahl_shape(rng, size: Size) -> Parameters:
    return [(10 ** rng.uniform(0.0, 1.5) / size.s, PER_DRIFT)]


def bouc_wen_shape(rng, size: Size) -> Parameters:
    yield_drift = size.s * rng.uniform(0.3, 1.0)
    beta = rng.uniform(0.35, 0.9)
    n = rng.choice([1.0, 1.5, 2.0])
    return [(yield_drift, BY_DRIFT), (beta, FIXED), (n, FIXED)]


def jenkins_shape(rng, size: Size) -> Parameters:
    return [(size.s * rng.uniform(0.2, 0.9), BY_DRIFT)]


def maxwell_shape(rng, size: Size) -> Parameters:
    return [(size.s / size.v * 10 ** rng.uniform(-0.4, 0.5), FIXED)]


def step_shape(rng, size: Size) -> Parameters:
    onset = size.duration * rng.uniform(0.3, 0.65)
    return [(onset, FIXED), (0.02 / size.f[-1] * rng.uniform(0.1, 1.0), FIXED)]


def drifting_shape(rng, size: Size) -> Parameters:
    return [(size.duration, FIXED)]


def harmonic_shape(rng, size: Size) -> Parameters:
    lowest = size.f[0] * rng.uniform(0.6, 1.0)
    frequency = lowest * (size.f[-1] / size.f[0]) ** rng.random()
    return [(frequency, FIXED), (rng.uniform(0, 2 * np.pi), FIXED)]


def link_shape(rng, size: Size) -> Parameters:
    return [(rng.uniform(0.0, 2.0) * 0.02 * size.s / size.v, FIXED)]


SHAPES: dict[str, Callable[..., Parameters]] = {
    "coulomb": friction_shape,
    "stribeck": stribeck_shape,
    "asymmetric_friction": asymmetric_shape,
    "ground_friction": friction_shape,
    "quadratic_damping": quadratic_damping_shape,
    "power_damping": power_damping_shape,
    "one_sided_gap": gap_shape,
    "two_sided_gap": gap_shape,
    "bilinear": bilinear_shape,
    "dahl": dahl_shape,
    "bouc_wen": bouc_wen_shape,
    "jenkins": jenkins_shape,
    "maxwell": maxwell_shape,
    "stiffness_step": step_shape,
    "stiffness_drift": drifting_shape,
    "damping_drift": drifting_shape,
    "harmonic": harmonic_shape,
    "brace": link_shape,
    "ground_link": link_shape,
}


def draw_shape(rng, kind: str, size: Size) -> tuple[np.ndarray, np.ndarray]:
    """Parameters without amplitude, and their powers of (s, v) to rescale by."""
    par = np.zeros(N_PAR)
    powers = np.zeros((N_PAR, 2))
    if kind in SHAPES:
        for i, (value, power) in enumerate(SHAPES[kind](rng, size), 1):
            par[i] = value
            powers[i] = power
    return par, powers


def draw_place(rng, kind: str, n: int, base: bool) -> tuple[int, int]:
    """Ends (p, q) of an effect on a chain of n masses; q = 0 is the ground."""
    if kind in ("harmonic", "constant"):
        return int(rng.integers(1, n + 1)), 0
    if kind == "brace":
        p = int(rng.integers(3, n + 1))
        return p, int(rng.integers(1, p - 1))
    if kind == "ground_friction" and base:
        return int(rng.integers(1, n + 1)), 0
    if kind in ("ground_link", "ground_friction"):
        return int(rng.integers(2, n + 1)), 0
    p = int(rng.integers(1, n + 1))
    return p, p - 1


def possible(kind: str, n: int, base: bool) -> bool:
    """Whether a kind of effect exists on such a chain, and is no storey law."""
    if kind == "brace":
        return n >= 3
    if kind == "ground_link":
        return n >= 2
    if kind == "ground_friction":
        return n >= 2 or base
    return True


def effect_cycle(n: int, base: bool) -> list[str]:
    """Kinds that exist on a chain of n masses."""
    return [kind for kind in KINDS if possible(kind, n, base)]


def sign_of(rng, kind: str) -> float:
    """Sign of the amplitude: some effects soften or weaken as often as they stiffen."""
    if kind in ("stiffness_step", "stiffness_drift", "bilinear"):
        return float(rng.choice([-1.0, -1.0, 1.0]))
    if kind in ("cubic", "quadratic", "constant", "odd_quadratic"):
        return float(rng.choice([-1.0, 1.0, 1.0]))
    return 1.0


# -- sizes of the effects ------------------------------------------------------


@dataclass(frozen=True)
class Sized:
    """An effect, the rms drift and rate it was shaped for, and its parameters' powers.

    Its share is the wanted one.
    """

    effect: Effect
    size: np.ndarray
    powers: np.ndarray

    def resized(self, size: np.ndarray, factor: float) -> Sized:
        """The same for another motion, its amplitude times a factor."""
        par = self.effect.par.copy()
        par[1:] *= np.prod((size / self.size) ** self.powers[1:], axis=1)
        par[0] *= factor
        return replace(self, effect=replace(self.effect, par=par), size=size)


def size_of(effect: Effect, run: Run) -> np.ndarray:
    """Rms drift and rate between the ends of an effect."""
    s, v = run.ends(effect)
    return np.sqrt([np.mean(s**2), np.mean(v**2)])


def shares(structure: Structure, effects: list[Effect], run: Run) -> np.ndarray:
    """Rms of each effect over that of the storey below its upper end."""
    out = []
    for effect, force in zip(effects, run.effects.T):
        storey = structure.force_of(effect.p, run.x, run.v)
        out.append(np.sqrt(np.mean(force**2) / np.mean(storey**2)))
    return np.array(out)


def first_guess(
    rng, structure: Structure, effect: Effect, run: Run, f: np.ndarray
) -> Sized | None:
    """An effect of the wanted share along the motion without it, None if it is zero."""
    size = size_of(effect, run)
    par, powers = draw_shape(rng, effect.kind, Size(*size, len(run.F) / run.fs, f))
    par[0] = sign_of(rng, effect.kind)
    force = replace(effect, par=par).force(run.t, *run.ends(effect), run.vg)
    if not force.any():
        return None
    storey = structure.force_of(effect.p, run.x, run.v)
    par[0] *= effect.share * np.sqrt(np.mean(storey**2) / np.mean(force**2))
    return Sized(replace(effect, par=par), size, powers)


def calibrate(
    rng, structure, kinds, places, loads, fs, f, targets
) -> tuple[list[Effect], Run] | None:
    """Effects of the wanted size on this chain, and the run with them.

    None if there is no such size.
    """
    loads = Loads(*loads)
    plain = simulated(structure, [], loads, fs)
    guesses = []
    for kind, (p, q), target in zip(kinds, places, targets):
        effect = Effect(kind, p, q, np.zeros(N_PAR), target)
        guess = first_guess(rng, structure, effect, plain, f)
        if guess is None:
            return None
        guesses.append(guess)

    for _ in range(12):
        effects = [guess.effect for guess in guesses]
        run = simulated(structure, effects, loads, fs)
        if not run.is_finite or np.abs(run.x).max() > 50 * np.abs(plain.x).max():
            return None
        shares_of_effects = shares(structure, effects, run)
        if close_enough(shares_of_effects, np.asarray(targets)):
            sized = zip(effects, shares_of_effects.tolist())
            return [replace(effect, share=share) for effect, share in sized], run
        guesses = [corrected(*pair, run) for pair in zip(guesses, shares_of_effects)]
    return None


def close_enough(shares_of_effects: np.ndarray, targets: np.ndarray) -> bool:
    """Whether all shares are about the wanted ones, and within the bounds."""
    near = (0.85 * targets <= shares_of_effects) & (shares_of_effects <= 1.15 * targets)
    inside = (SHARE[0] <= shares_of_effects) & (shares_of_effects <= SHARE[1])
    return bool(np.all(near & inside))


def corrected(guess: Sized, share: float, run: Run) -> Sized:
    """A guess resized for the motion that it made, nearer to its share."""
    ratio = np.clip(guess.effect.share / max(share, 1e-12), 0.4, 2.5)
    return guess.resized(size_of(guess.effect, run), ratio**0.9)


# -- cases ---------------------------------------------------------------------


def make_case(
    name: str, group: str, seed: int, noise: float, kinds: tuple = (), **wishes
) -> Case:
    """Draw one case; the same arguments always give the same case.

    Arguments are those of :class:`Plan`.
    """
    plan = Plan(name, group, seed, noise, kinds, **wishes)
    rng = np.random.default_rng([seed, 20240])
    for _ in range(TRIALS):
        case = draw_case(rng, plan)
        if case is not None:
            return case
    raise RuntimeError(f"no chain was found for {name} (seed {seed}, {kinds})")


def draw_case(rng, plan: Plan) -> Case | None:
    """A chain with its effects and two tests; None if they do not go together."""
    n = int(rng.integers(plan.smallest, plan.largest + 1))
    structure, f = draw_structure(rng, n)
    fs = float(np.round(f[-1] * rng.uniform(16, 28), 1))
    how = plan.excitation or draw_excitation(rng, plan.base)
    forced = draw_forced(rng, plan, n)
    drift_rms = 10 ** rng.uniform(-4.5, -2)
    loads = scaled_loads(rng, structure, f, fs, how, forced, plan.n_samples, drift_rms)
    if plan.degree == 3:
        structure = hardened(rng, structure, loads, fs)

    kinds = plan.kinds * n if plan.every else plan.kinds
    places = draw_places(rng, plan, kinds, n)
    if len(set(places)) < len(places):
        return None
    bounds = np.log([1.05 * SHARE[0], 0.9 * SHARE[1]])
    targets = np.exp(rng.uniform(*bounds, len(kinds)))
    calibrated = calibrate(rng, structure, kinds, places, loads, fs, f, targets)
    if calibrated is None:
        return None

    effects, run = calibrated
    again = unscaled_loads(rng, structure, f, fs, how, forced, plan.n_samples)
    other = simulated(structure, effects, like(again, loads), fs)
    if not other.is_finite:
        return None
    searched, unseen = measured(rng, plan, [run, other], forced)
    return Case(
        plan.name,
        plan.group,
        plan.seed,
        plan.noise,
        plan.degree,
        how,
        forced,
        structure,
        effects,
        [run, other],
        [searched],
        [unseen],
        plan.sensors,
    )


def draw_excitation(rng, base: bool) -> str:
    """A kind of excitation; bases shake rather than are hit."""
    kinds = ("random", "earthquake", "earthquake") if base else EXCITATIONS
    return str(rng.choice(kinds))


def draw_forced(rng, plan: Plan, n: int) -> tuple[int, ...]:
    """No DOF over a moving base, all DOFs, or one."""
    if plan.base:
        return ()
    if not plan.accelerations_only and rng.random() < 0.5:
        return tuple(range(1, n + 1))
    return (int(rng.integers(1, n + 1)),)


def draw_places(rng, plan: Plan, kinds: tuple, n: int) -> list[tuple[int, int]]:
    """Where the effects act."""
    if plan.every:
        return [(storey, storey - 1) for storey in range(1, n + 1)]
    return [draw_place(rng, kind, n, plan.base) for kind in kinds]


def hardened(rng, structure: Structure, loads: Loads, fs: float) -> Structure:
    """The chain with cubic springs of some percent of the linear force."""
    run = simulated(structure, [], loads, fs)
    s = np.diff(run.x, axis=1, prepend=0.0)
    share = rng.uniform(0.03, 0.12, structure.n)
    return replace(structure, k3=share * structure.k / np.mean(s**2, axis=0))


def like(loads: Loads, others: Loads) -> Loads:
    """Loads of the same rms as others."""
    if loads.F.any():
        return scaled(loads, rms(others.F) / rms(loads.F))
    return scaled(loads, rms(others.ag) / rms(loads.ag))


def measured(rng, plan: Plan, runs: list[Run], forced: tuple[int, ...]) -> list[dict]:
    """Channels of all tests, by one installation of sensors."""
    tests = [channels(rng, run, plan.noise, forced) for run in runs]
    if plan.accelerations_only:
        channels_used = ("fs", "acceleration", "force")
        tests = [{key: test[key] for key in channels_used} for test in tests]
    if plan.sensors:
        seed = [plan.seed, 7]
        tests = [imperfect(np.random.default_rng(seed), y, plan.sensors) for y in tests]
    return tests


def channels(rng, run: Run, noise: float, forced: tuple[int, ...]) -> dict:
    """Channels of a run, with white noise of a share of the rms on each that moves."""

    def noisy(y: np.ndarray) -> np.ndarray:
        size = noise * np.sqrt(np.mean(y**2, axis=0))
        return y + size * rng.standard_normal(y.shape)

    out = {
        "fs": run.fs,
        "acceleration": noisy(run.a),
        "velocity": noisy(run.v),
        "displacement": noisy(run.x),
    }
    if forced:
        out["force"] = np.where(run.F.any(axis=0), noisy(run.F), 0.0)
    else:
        out["base_acceleration"] = noisy(run.ag)
        out["base_velocity"] = noisy(run.vg)
        out["base_displacement"] = noisy(run.xg)
    return out
