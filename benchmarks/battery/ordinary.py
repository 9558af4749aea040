"""A second generator: ordinary tests, as a laboratory or a site measures them.

Every channel has a wrong zero of 1 % of its peak. Damping is Rayleigh's, so that every
floor has a dashpot to the ground. Accelerometers have an ICP corner. Records begin with
a quiet lead. Loads are stationary sines, blows and noise; few kinds of channels are
measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfilt

from .formulas import N_PAR
from .generators import (
    SHARE,
    Case,
    Effect,
    Loads,
    Plan,
    Run,
    Structure,
    calibrate,
    channels,
    draw_place,
    draw_structure,
    rms,
    scaled,
    simulated,
    unscaled_loads,
)

N_SAMPLES = 8192
OFFSET = 0.01  # wrong zero of every channel, as a share of its peak
NOISE = 0.01  # white noise of every channel, as a share of its rms
MASS_DAMPING = 0.005  # damping ratio of the dashpots to the ground in the first mode
CORNER = 0.05  # of an accelerometer, as a share of the first natural frequency
QUIET = 0.3  # largest part of a record that is a quiet lead
LOADS = ("sine", "hammer", "random")
MEASURED = (
    ("acceleration", "displacement"),
    ("displacement",),
    ("acceleration", "velocity", "displacement"),
    ("acceleration",),
)
TRIALS = 200


def make_ordinary_case(name: str, seed: int, kind: str, number: int) -> Case:
    """One test of a chain with an effect, or without one for an empty kind."""
    rng = np.random.default_rng([seed, 31])
    for _ in range(TRIALS):
        case = _drawn(rng, name, seed, kind, number)
        if case is not None:
            return case
    raise RuntimeError(f"no chain was found for {name} (seed {seed}, {kind})")


def _drawn(rng, name: str, seed: int, kind: str, number: int) -> Case | None:
    """A chain with its effect and two tests; None if they do not go together."""
    n = int(rng.integers(3 if kind == "brace" else 2, 5))
    structure, f = draw_structure(rng, n)
    fs = float(np.round(f[-1] * rng.uniform(16, 28), 1))
    how = LOADS[number % len(LOADS)]
    forced = (
        tuple(range(1, n + 1)) if rng.random() < 0.5 else (int(rng.integers(1, n + 1)),)
    )
    drift = 10 ** rng.uniform(-4.0, -2.0)

    loads = _loads(rng, structure, f, fs, how, forced)
    plain = simulated(structure, [], loads, fs, n_substeps=4)
    loads = scaled(loads, drift / rms(np.diff(plain.x, axis=1, prepend=0.0)))
    effects: list[Effect] = []
    if kind:
        target = np.exp(rng.uniform(*np.log([1.5 * SHARE[0], 0.9 * SHARE[1]])))
        places = [draw_place(rng, kind, n, False)]
        calibrated = calibrate(rng, structure, [kind], places, loads, fs, f, [target])
        if calibrated is None:
            return None
        effects, _ = calibrated

    dashpots = _dashpots(structure, f)
    size = rng.uniform(0.7, 1.4)
    again = _loads(rng, structure, f, fs, how, forced)
    again = scaled(again, size * rms(loads.F) / rms(again.F))
    runs = [
        simulated(structure, [*effects, *dashpots], each, fs) for each in (loads, again)
    ]
    if not all(run.is_finite for run in runs):
        return None

    keys = MEASURED[(number // len(LOADS)) % len(MEASURED)]
    offsets = rng.choice([-1.0, 1.0], (4, n)) * OFFSET
    lead = int(QUIET * rng.random() * N_SAMPLES)
    tests = [_measured(rng, run, f, forced, keys, offsets, lead) for run in runs]
    plan = Plan(name, "ordinary", seed, NOISE)
    return Case(
        plan.name,
        plan.group,
        plan.seed,
        plan.noise,
        plan.degree,
        f"{how}, {'+'.join(key[0] for key in keys)}",
        forced,
        structure,
        effects,
        runs,
        [tests[0]],
        [tests[1]],
        beside=dashpots,
    )


def _loads(rng, structure: Structure, f, fs: float, how: str, forced) -> Loads:
    """Forces on the forced DOFs."""
    if how != "sine":
        return unscaled_loads(rng, structure, f, fs, how, forced, N_SAMPLES)
    t = np.arange(N_SAMPLES) / fs
    F = np.zeros((N_SAMPLES, structure.n))
    for j in forced:
        frequency = f[0] * (f[-1] / f[0]) ** rng.uniform(-0.2, 0.9)
        ramp = np.clip(t * frequency / 5.0, 0.0, 1.0)
        phase = rng.uniform(0.0, 2.0 * np.pi)
        F[:, j - 1] = ramp * np.sin(2.0 * np.pi * frequency * t + phase)
    F *= structure.m
    still = np.zeros(N_SAMPLES)
    return Loads(F, still, still, still)


def _dashpots(structure: Structure, f: np.ndarray) -> list[Effect]:
    """A dashpot from each floor to the ground: mass-proportional damping."""
    rate = 2.0 * MASS_DAMPING * 2.0 * np.pi * f[0]
    dashpots = []
    for dof, mass in enumerate(structure.m.tolist(), 1):
        par = np.zeros(N_PAR)
        # a spring too soft to feel, and its dashpot
        par[0] = 1e-6 * structure.k.min()
        par[1] = rate * mass / par[0]
        dashpots.append(Effect("ground_link", dof, 0, par))
    return dashpots


def _measured(rng, run: Run, f, forced, keys, offsets: np.ndarray, lead: int) -> dict:
    """The channels of a run behind a quiet lead, as ordinary sensors read them."""
    run = _after_lead(run, lead)
    exact = channels(rng, run, 0.0, forced)
    corner = butter(1, CORNER * f[0], "highpass", fs=run.fs, output="sos")
    exact["acceleration"] = sosfilt(corner, exact["acceleration"], axis=0)
    out = {"fs": run.fs}
    for row, key in enumerate(("force", "acceleration", "velocity", "displacement")):
        if key != "force" and key not in keys:
            continue
        y = exact[key]
        noise = NOISE * np.sqrt(np.mean(y**2, axis=0))
        read = y + offsets[row] * np.abs(y).max(axis=0)
        read = read + noise * rng.standard_normal(y.shape)
        # a DOF without a force is known to have none
        out[key] = np.where(y.any(axis=0), read, 0.0)
    return out


def _after_lead(run: Run, lead: int) -> Run:
    """A run that begins with some samples at rest."""
    if not lead:
        return run
    changes = {}
    for key in ("F", "ag", "vg", "xg", "x", "v", "a", "effects"):
        y = getattr(run, key)
        quiet = np.zeros((lead, *y.shape[1:]))
        changes[key] = np.concatenate([quiet, y])
    return replace(run, **changes)
