"""An unscented filter beside the free run fitted to the channels: four floors, two
sensors, one nonlinear law.

    python benchmarks/filter_comparison.py --quick          # the filter alone, one pass: some seconds
    python benchmarks/filter_comparison.py --runs 5 --jobs 2

The cases are those of ``fewer_sensors.py --only laws``. State and parameters (their
logarithms) are estimated together in square-root form with equal weights (van der Merwe
and Wan 2001; Arasaratnam and Haykin 2009), the parameters without drift, in three
passes over the record (Hoshiya and Saito 1984: the covariance of the parameters is
widened between them). Unlike the fit, which starts from the data alone, the filter is
told first values: ``--off 1.3`` draws every one of them up to 1.3 times too large or
too small. It integrates by Runge-Kutta's rule, four steps a sample.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import fewer_sensors
import numpy as np
from fewer_sensors import BAND, CUBE, DURATION, FRICTION, FS, GAP, RMS, chain
from joblib import Parallel, delayed
from scipy.stats import norm

from pysindy_nrf import ChainModel, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

FLOORS, SENSORS, STEPS, PASSES = 4, (2, 4), 4, 3
WIDER = 0.3  # of the first covariance of the parameters, which later passes start from
CREEP = 1e-3  # m/s, in which friction turns round


def rates(law: str, z: np.ndarray, force: float) -> np.ndarray:
    """Velocities and accelerations of all sigma points, (2 * n, n_points)."""
    x, v, p = z[:FLOORS], z[FLOORS : 2 * FLOORS], np.exp(z[2 * FLOORS :])
    m, k, c, own = (
        p[:FLOORS],
        p[FLOORS : 2 * FLOORS],
        p[2 * FLOORS : 3 * FLOORS],
        p[3 * FLOORS :],
    )
    s, w = (np.diff(y, axis=0, prepend=0.0 * y[:1]) for y in (x, v))
    R = k * s + c * w
    if law == "cubic":
        R[1] += own[0] * s[1] ** 3
    elif law == "gap":
        R[1] += own[1] * np.sign(s[1]) * np.maximum(np.abs(s[1]) - own[0], 0.0)
    else:
        R[1] += own[0] * np.tanh(w[1] / CREEP)
    net = -R
    net[:-1] += R[1:]
    net[-1] += force
    return np.concatenate([v, net / m])


def advanced(law: str, z: np.ndarray, start: float, end: float) -> np.ndarray:
    """All sigma points one sample later, under a force that runs straight."""
    h, size = 1 / FS / STEPS, 2 * FLOORS
    z = z.copy()
    for f in np.linspace(start, end, STEPS + 1)[:-1]:
        rise = (end - start) / STEPS

        def at(
            step: np.ndarray | float, share: float, f: float = f, rise: float = rise
        ) -> np.ndarray:
            moved = z.copy()
            moved[:size] += step
            return rates(law, moved, f + share * rise)

        one = at(0.0, 0.0)
        two = at(0.5 * h * one, 0.5)
        three = at(0.5 * h * two, 0.5)
        z[:size] += h / 6 * (one + 2 * two + 2 * three + at(h * three, 1.0))
    return z


def root(columns: np.ndarray) -> np.ndarray:
    """Lower triangle with the same product with its transpose."""
    return np.linalg.qr(columns.T, mode="r").T


def filtered(
    law: str,
    force: np.ndarray,
    measured: np.ndarray,
    first: np.ndarray,
    spread: np.ndarray,
    noise: float,
    passes: int = PASSES,
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the parameters and their standard errors; NaN if the filter
    diverges.
    """
    size = 2 * FLOORS + len(first)
    channels = FLOORS + np.array(SENSORS) - 1
    error, jolt = np.diag(noise * measured.std(axis=0)), noise * force.std() / FS
    for number in range(passes):
        z = np.concatenate([np.zeros(2 * FLOORS), first])
        S = np.diag(
            np.concatenate(
                [np.full(2 * FLOORS, 1e-9), spread * (WIDER if number else 1.0)]
            )
        )
        for i, y in enumerate(measured):
            if i:
                points = advanced(
                    law,
                    z[:, None] + np.sqrt(size) * np.hstack([S, -S]),
                    force[i - 1],
                    force[i],
                )
                z = points.mean(axis=1)
                pushed = np.zeros((size, 1))
                pushed[2 * FLOORS - 1] = jolt / np.exp(z[3 * FLOORS - 1])
                S = root(np.hstack([(points - z[:, None]) / np.sqrt(2 * size), pushed]))
            points = z[:, None] + np.sqrt(size) * np.hstack([S, -S])
            read = rates(law, points, force[i])[channels]
            mean = read.mean(axis=1)
            joint = np.block(
                [
                    [(read - mean[:, None]) / np.sqrt(2 * size), error],
                    [
                        (points - z[:, None]) / np.sqrt(2 * size),
                        np.zeros((size, len(error))),
                    ],
                ]
            )
            if not np.isfinite(joint).all():
                return np.full(len(first), np.nan), np.full(len(first), np.nan)
            both, n = root(joint), len(error)
            z = z + both[n:, :n] @ np.linalg.solve(both[:n, :n], y - mean)
            S = both[n:, n:]
        first = z[2 * FLOORS :]
    return first, np.sqrt((S**2).sum(axis=1))[2 * FLOORS :]


def compared(
    law: str, noise: float, off: float, seed: int, passes: int, fit: bool
) -> tuple[float, ...]:
    """Worst error of the masses and of the law, share of intervals that hold the
    masses, CPU: filter, then fit.
    """
    m, k, c = chain(FLOORS, seed)
    true, _ = fewer_sensors.held(law, c[1], k[1])
    storeys = {i + 1: [laws.PowerSeries(1, [c[i], k[i]])] for i in range(FLOORS)}
    F = excitation.band_limited_random(
        FLOORS, DURATION, FS, excited=[FLOORS], rms=RMS, band=BAND, random_state=seed
    )
    record = simulate(ChainModel(m, {**storeys, 2: true}), F, 1 / FS)
    record = add_noise(record, noise, random_state=[seed, 1])
    own = {"cubic": [CUBE], "gap": [GAP, k[1] / 2], "friction": [FRICTION]}[law]
    truth = np.log(np.concatenate([m, k, c, own]))
    spread = np.full(len(truth), max(np.log(off), 0.1))
    first = truth + spread * np.random.default_rng([seed, 7]).uniform(-1, 1, len(truth))
    sensed = record.acceleration[:, np.array(SENSORS) - 1]
    began = time.process_time()
    found, error = filtered(
        law, record.force[:, -1], sensed, first, spread, noise, passes
    )
    away = np.exp(found - truth) - 1
    inside = np.abs(found - truth)[:FLOORS] <= norm.ppf(0.975) * error[:FLOORS]
    out = [
        np.abs(away[:FLOORS]).max(),
        np.abs(away[3 * FLOORS :]).max(),
        inside.mean(),
        time.process_time() - began,
    ]
    if fit:
        began = time.process_time()
        masses, laws_off, _ = fewer_sensors.nonlinear(law, noise, seed)
        out += [masses, laws_off, time.process_time() - began]
    return tuple(float(x) for x in out)


def main(arguments: list[str] | None = None) -> None:
    """Print medians and largest values."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--off", type=float, nargs="*", default=[1.3, 2.0, 3.0])
    options = parser.parse_args(arguments)
    every = ("cubic", "gap", "friction")
    kinds, runs, passes = (
        (every[:1], 1, 1) if options.quick else (every, options.runs, PASSES)
    )
    run: Callable = delayed(compared)
    print(
        "| law | estimate | masses: median, largest | law: median, largest | hold |"
        " CPU, s |"
    )
    print("|---|---|---|---|---|---|")
    for law in kinds:
        for number, off in enumerate(options.off[:1] if options.quick else options.off):
            fit = number == 0 and not options.quick
            found = np.array(
                Parallel(options.jobs)(
                    run(law, options.noise, off, k, passes, fit) for k in range(runs)
                )
            )
            row(
                law,
                f"filter, first values {off:g} times off",
                found[:, :2],
                found[:, 3],
                found[:, 2],
            )
            if fit:
                row(law, "free run fitted", found[:, 4:6], found[:, 6])


def row(
    law: str,
    name: str,
    errors: np.ndarray,
    cpu: np.ndarray,
    inside: np.ndarray | None = None,
) -> None:
    """Print a row; what diverged or was refused counts as infinitely wrong."""
    errors = 100 * np.where(np.isfinite(errors), errors, np.inf)
    parts = [f"{np.median(e):.2g}, {e.max():.2g} %" for e in errors.T]
    held = "" if inside is None else f"{100 * inside.mean():.0f} %"
    print(
        f"| {law} | {name} | {' | '.join(parts)} | {held} | {np.median(cpu):.0f} |",
        flush=True,
    )


if __name__ == "__main__":
    main()
