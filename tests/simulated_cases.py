"""Short simulated tests for the closed loop: formulas of the benchmark's battery,
motion by SciPy's DOP853.

Nothing here comes from the package: a case holds the channels that the loop may see,
and the truth for the assertion.
"""

import sys
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
if not BENCHMARKS.is_dir():
    pytest.skip(
        "the benchmarks are not part of an installed package", allow_module_level=True
    )
if str(BENCHMARKS) not in sys.path:
    sys.path.insert(0, str(BENCHMARKS))

from battery.formulas import CODE, N_PAR, poly, rates  # noqa: E402
from battery.generators import (
    Effect,
    Run,
    calibrate,
    channels,
    draw_structure,
    scaled_loads,
)  # noqa: E402


@dataclass(frozen=True)
class Plan:
    """What to simulate: size, excitation, noise (share of the rms), hidden effects
    (kind, p, q, share), faults.
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
    n, count, t = structure.n, len(effects), np.arange(len(F)) / fs
    load = np.ascontiguousarray(CubicSpline(t, np.column_stack([F, ag, vg])).c)
    kinds = np.array([CODE[e.kind] for e in effects], dtype=np.int64)
    ends = np.array([[e.p, e.q] for e in effects], dtype=np.int64).reshape(-1, 2)
    par = np.array([e.par for e in effects], dtype=float).reshape(-1, N_PAR)
    rate, forces = np.zeros(2 * n + count), np.zeros(count)
    chain = (structure.m, structure.k, structure.c, structure.k3, kinds, ends, par)

    def derivative(time, y):
        i = min(int(time * fs), len(F) - 2)
        u = poly(load, i, time - i / fs)
        rates(y, time, u[:n], u[n], u[n + 1], *chain, rate, forces)
        return rate.copy()

    y = solve_ivp(
        derivative,
        (0, t[-1]),
        np.zeros(2 * n + count),
        "DOP853",
        t,
        rtol=1e-7,
        atol=1e-11,
    ).y.T
    a, hidden = np.empty((len(t), n)), np.empty((len(t), count))
    for i, time in enumerate(t):
        a[i] = derivative(time, y[i])[n : 2 * n] + ag[i]
        hidden[i] = forces
    return Run(fs, F, ag, vg, xg, y[:, :n], y[:, n : 2 * n], a, hidden)


def late(x, samples):
    """A channel delayed by a number of samples, by cubic interpolation."""
    at = np.arange(len(x), dtype=float)
    return CubicSpline(at, x)(np.clip(at - samples, 0, None))


@cache
def simulated(plan: Plan) -> Simulated:
    """The channels and the truth of a plan; the same plan gives the same numbers."""
    rng = np.random.default_rng([plan.seed, 31])
    for _ in range(50):
        structure, f = draw_structure(rng, plan.n)
        fs = float(np.round(f[-1] * rng.uniform(18, 24), 1))
        how = plan.excitation
        loads = scaled_loads(
            rng,
            structure,
            f,
            fs,
            how,
            plan.forced,
            plan.n_samples,
            10 ** rng.uniform(-4, -2.5),
        )
        if not plan.effects:
            effects = []
            break
        kinds, places, targets = zip(
            *((kind, (p, q), share) for kind, p, q, share in plan.effects)
        )
        if found := calibrate(rng, structure, kinds, places, loads, fs, f, targets):
            effects = found[0]
            break
    else:
        raise RuntimeError(f"no chain was found for {plan}")
    seen = channels(
        rng, motion(structure, effects, *loads, fs), plan.noise, plan.forced
    )
    names = {"a": "acceleration", "v": "velocity", "x": "displacement", "F": "force"}
    for name, gain in plan.gains:
        seen[names[name[0]]][:, int(name[1:]) - 1] *= gain
    for name, samples in plan.delays:
        column = seen[names[name[0]]][:, int(name[1:]) - 1]
        column[:] = late(column.copy(), samples)
    return Simulated(seen, structure.m, effects)
