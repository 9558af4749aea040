"""Short simulated tests for the closed loop, by the formulas of the benchmarks.

Nothing here comes from the package. A case has the channels that the loop may see, and
the truth for the assertion.
"""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from battery.formulas import CODE, N_PAR, poly, rates
from battery.generators import (
    Effect,
    Run,
    calibrate,
    channels,
    draw_structure,
    scaled_loads,
)
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

MAX_DRAWS = 50
MATRICES = {"a": "acceleration", "v": "velocity", "x": "displacement", "F": "force"}


@dataclass(frozen=True)
class Plan:
    """What to simulate.

    Noise is a share of the rms. Effects are (kind, p, q, share of the force), gains and
    delays (channel, factor or number of samples).
    """

    n: int
    forced: tuple[int, ...] = ()
    excitation: str = "random"
    noise: float = 0.0
    effects: tuple[tuple[str, int, int, float], ...] = ()
    gains: tuple[tuple[str, float], ...] = ()
    delays: tuple[tuple[str, float], ...] = ()
    seed: int = 0
    n_samples: int = 2400


@dataclass
class Simulated:
    """Channels of one test, and the truth."""

    channels: dict
    masses: np.ndarray
    effects: list[Effect] = field(default_factory=list)


def motion(structure, effects, F, ag, vg, xg, fs) -> Run:
    """One test from rest by DOP853; loads are cubic splines between the samples."""
    n = structure.n
    n_effects = len(effects)
    t = np.arange(len(F)) / fs
    loads = np.column_stack([F, ag, vg])
    courses = np.ascontiguousarray(CubicSpline(t, loads).c)
    ends = [(effect.p, effect.q) for effect in effects]
    parameters = [effect.par for effect in effects]
    chain = (
        structure.m,
        structure.k,
        structure.c,
        structure.k3,
        np.array([CODE[effect.kind] for effect in effects], dtype=np.int64),
        np.array(ends, dtype=np.int64).reshape(-1, 2),
        np.array(parameters, dtype=float).reshape(-1, N_PAR),
    )
    rate = np.zeros(2 * n + n_effects)
    hidden_forces = np.zeros(n_effects)

    def derivative(time, y):
        sample = min(int(time * fs), len(F) - 2)
        u = poly(courses, sample, time - sample / fs)
        rates(y, time, u[:n], u[n], u[n + 1], *chain, rate, hidden_forces)
        return rate.copy()

    start = np.zeros(2 * n + n_effects)
    run = solve_ivp(derivative, (0, t[-1]), start, "DOP853", t, rtol=1e-7, atol=1e-11)
    y = run.y.T
    a = np.empty((len(t), n))
    hidden = np.empty((len(t), n_effects))
    for i, time in enumerate(t):
        a[i] = derivative(time, y[i])[n : 2 * n] + ag[i]
        hidden[i] = hidden_forces
    return Run(fs, F, ag, vg, xg, y[:, :n], y[:, n : 2 * n], a, hidden)


def late(x, samples):
    """A channel delayed by a number of samples, by cubic interpolation."""
    numbers = np.arange(len(x), dtype=float)
    return CubicSpline(numbers, x)(np.clip(numbers - samples, 0, None))


def _draw(rng, plan: Plan):
    """Structure, loads, effects and rate of a plan; None if no effects fit it."""
    structure, frequencies = draw_structure(rng, plan.n)
    fs = float(np.round(frequencies[-1] * rng.uniform(18, 24), 1))
    level = 10 ** rng.uniform(-4, -2.5)
    loads = scaled_loads(
        rng,
        structure,
        frequencies,
        fs,
        plan.excitation,
        plan.forced,
        plan.n_samples,
        level,
    )
    if not plan.effects:
        return structure, loads, [], fs

    kinds = [kind for kind, _, _, _ in plan.effects]
    places = [(p, q) for _, p, q, _ in plan.effects]
    targets = [share for _, _, _, share in plan.effects]
    calibrated = calibrate(
        rng, structure, kinds, places, loads, fs, frequencies, targets
    )
    return (structure, loads, calibrated[0], fs) if calibrated else None


@cache
def simulated(plan: Plan) -> Simulated:
    """The channels and the truth of a plan; the same plan gives the same numbers."""
    rng = np.random.default_rng([plan.seed, 31])
    for _ in range(MAX_DRAWS):
        drawn = _draw(rng, plan)
        if drawn is not None:
            break
    else:
        raise RuntimeError(f"no chain was found for {plan}")

    structure, loads, effects, fs = drawn
    run = motion(structure, effects, *loads, fs)
    measured = channels(rng, run, plan.noise, plan.forced)
    for name, gain in plan.gains:
        measured[MATRICES[name[0]]][:, int(name[1:]) - 1] *= gain
    for name, samples in plan.delays:
        matrix = measured[MATRICES[name[0]]]
        column = int(name[1:]) - 1
        matrix[:, column] = late(matrix[:, column].copy(), samples)
    return Simulated(measured, structure.m, effects)
