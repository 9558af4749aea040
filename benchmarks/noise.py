"""What measurement noise does to masses and stiffnesses, and what the estimators make
of it.

    python benchmarks/noise.py --quick                 # two seeds, short records: some minutes
    python benchmarks/noise.py                         # 20 seeds, 300 repetitions for the intervals: hours
    python benchmarks/noise.py --only "5 %" --seeds 5

Noise is white on every channel, the force included, as a share of the channel's RMS.
The truth is simulated with the force as a cubic spline through its samples (a
band-limited force, as measured); with straight lines between the samples accelerations
and displacements contradict each other by 0.1 %, which shows. Errors in percent: median
over the seeds and the range that holds 90 % of them. Below the linear chains stands
what no unbiased estimate can fall below (Cramer-Rao): the median of the worst of
Gaussian errors with the covariance that the noise of these channels leaves.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import warnings
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
from joblib import Parallel, delayed  # noqa: E402

from pysindy_nrf import (  # noqa: E402
    ChainModel,
    KinematicSmoother,
    NRFRegressor,
    Record,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.equations.errors import nrmse  # noqa: E402
from pysindy_nrf.exceptions import NRFError  # noqa: E402
from pysindy_nrf.identification.linear_response import transfer  # noqa: E402
from pysindy_nrf.identification.spectra import fourier_lines  # noqa: E402
from pysindy_nrf.simulation.noise import add_noise  # noqa: E402

FS, DURATION, N = 1000.0, 16.0, 4
MASS, STIFFNESS, DAMPING = 12.4, 1.4e5, 25.0
CUBIC, SIGMA, FRICTION = 5e8, 5e4, 34.85


# -- structures and records ----------------------------------------------------


def chain(kind: str, seed: int) -> tuple[ChainModel, dict]:
    """The true chain and what the estimator is told of its laws."""
    m, k, c = np.full(N, MASS), np.full(N, STIFFNESS), np.full(N, DAMPING)
    if kind == "random parameters":
        rng = np.random.default_rng([seed, 77])
        m, k, c = (
            rng.uniform(6, 25, N),
            rng.uniform(0.7e5, 2.8e5, N),
            rng.uniform(12, 60, N),
        )
    held = {f"storey {i + 1}": [laws.PowerSeries(1, [c[i], k[i]])] for i in range(N)}
    told: dict = {"degree": 1}
    if kind == "cubic storey":
        held["storey 2"] = [
            laws.PowerSeries((0, 3), [STIFFNESS, 0.0, CUBIC]),
            laws.LinearViscous(DAMPING),
        ]
        told = {"degree": 1, "orders": {"storey 2": 3}}
    if kind == "damper":
        held["storey 1"].append(laws.Dahl(sigma=SIGMA, Fd=FRICTION))
        told = {
            "degree": 1,
            "laws": {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=SIGMA)]},
        }
    return ChainModel(m, held), told


def exact_record(
    truth: ChainModel,
    dofs,
    seed: int,
    force: str = "random",
    duration: float | None = None,
) -> Record:
    """What happened."""
    duration = duration or DURATION
    if force == "hammer":
        F = excitation.impact_hammer(
            N, duration, FS, excited=dofs, level=1000.0, n_hits=8, random_state=seed
        )
    else:
        F = excitation.band_limited_random(
            N, duration, FS, excited=dofs, rms=100.0, band=(0.5, 60), random_state=seed
        )
    return simulate(truth, F, 1 / FS, hold="cubic")


def record(
    truth: ChainModel, dofs, seed: int, noise: float, force: str = "random"
) -> Record:
    """A noisy record of a chain."""
    return add_noise(
        exact_record(truth, dofs, seed, force), noise, random_state=[seed, 1000]
    )


def parameters(model: ChainModel) -> np.ndarray:
    """Masses, stiffnesses, dampings."""
    linear = [
        model.restoring_forces[i].linear_part() for i in range(1, model.n_dof + 1)
    ]
    return np.array(
        [*model.masses, *(p["k"] for p in linear), *(p["c"] for p in linear)]
    )


def errors(found: ChainModel, truth: ChainModel) -> np.ndarray:
    return 100 * (parameters(found) / parameters(truth) - 1)


def quietly(function, *args, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return function(*args, **options)


# -- cases ---------------------------------------------------------------------

CASES = {
    "5 %": ("plain", [3], 0.05, "random"),
    "10 %": ("plain", [3], 0.10, "random"),
    "5 %, hammer": ("plain", [3], 0.05, "hammer"),
    "5 %, all DOFs forced": ("plain", [1, 2, 3, 4], 0.05, "random"),
    "5 %, all DOFs forced, strategy='complete'": (
        "plain",
        [1, 2, 3, 4],
        0.05,
        "random",
    ),
    "5 %, cubic storey 2": ("cubic storey", [3], 0.05, "random"),
    "5 %, MR damper, its law in the model": ("damper", [3], 0.05, "random"),
    "5 %, random parameters": ("random parameters", [3], 0.05, "random"),
}
TARGET = {"5 %": 0.6, "10 %": 1.1}


def one(case: str, estimation: str, seed: int) -> np.ndarray:
    kind, dofs, noise, force = CASES[case]
    truth, told = chain(kind, seed)
    rec = record(truth, dofs, seed, noise, force)
    if "complete" in case:
        told["strategy"] = "complete"
    if estimation == "ls, raw channels":
        try:
            return errors(
                NRFRegressor(**told, dt=1 / FS)
                .fit(*rec.to_features(smooth=False))
                .model_,
                truth,
            )
        # a law that remembers the path refuses drifts and rates that do not fit
        # together
        except NRFError:
            return np.full(3 * N, np.nan)
    return errors(NRFRegressor(**told, estimation=estimation).fit(rec).model_, truth)


def bound(case: str, seed: int) -> np.ndarray:
    """Cramer-Rao standard deviations of a linear chain's parameters, percent, for noise
    on a, v, x and F.
    """
    kind, dofs, noise, force = CASES[case]
    truth, _ = chain(kind, seed)
    run = exact_record(truth, dofs, seed, force)
    f = np.fft.rfftfreq(run.n_samples, 1 / FS)[1:]
    f = f[f < 200.0]
    w = 2 * np.pi * f[:, None]
    a, v, x = (
        noise * np.sqrt(np.mean(y**2, axis=0))
        for y in (run.acceleration, run.velocity, run.displacement)
    )
    # all three channels together, as one velocity
    blur = 1 / ((w / a) ** 2 + 1 / v**2 + 1 / (w * x) ** 2) / FS
    shock = (noise * np.sqrt(np.mean(run.force**2, axis=0))) ** 2 / FS
    G = transfer(truth.matrices(), f)[:, :, :N]
    S = (G * shock) @ G.conj().transpose(0, 2, 1) + blur[:, :, None] * np.eye(N)
    v, s = (np.diff(y, axis=1, prepend=0.0) for y in (run.velocity, run.displacement))
    step = np.eye(N) - np.eye(N, k=1)  # storey i pulls DOF i up and DOF i - 1 down
    added = [np.outer(run.acceleration[:, j], np.eye(N)[j]) for j in range(N)]
    added += [np.outer(y[:, i], step[:, i]) for y in (s, v) for i in range(N)]
    J = np.stack(
        [-(G @ fourier_lines(y, 1 / FS)[: len(f), :, None])[:, :, 0] for y in added],
        axis=2,
    )
    information = 2 * np.einsum("fdi,fdj->ij", J.conj(), np.linalg.solve(S, J)).real
    scale = parameters(truth)
    return 100 * np.sqrt(np.diag(np.linalg.inv(information * np.outer(scale, scale))))


SENSORS = (
    "accelerations and force",
    "displacements and force",
    "displacements, moving base",
)


def sensors(case: str, estimation: str, seed: int) -> np.ndarray:
    """Few kinds of sensors, 2 % noise."""
    truth, told = chain("plain", seed)
    if case == "displacements, moving base":
        rng = np.random.default_rng([seed, 5])
        shape = excitation.band_limited_random(
            1, DURATION, FS, excited=1, rms=2.0, band=(0.5, 40.0), random_state=rng
        )
        F = excitation.band_limited_random(
            N, DURATION, FS, excited=[3], rms=100.0, band=(0.5, 60.0), random_state=seed
        )
        exact = simulate(truth, F, 1 / FS, hold="cubic", base_acceleration=shape[:, 0])
        rec = add_noise(exact, 0.02, random_state=[seed, 1000]).replace(
            acceleration=None, velocity=None
        )
    else:
        rec = record(truth, [3], seed, 0.02)
        gone = (
            {"acceleration": None}
            if case.startswith("disp")
            else {"displacement": None}
        )
        rec = rec.replace(velocity=None, **gone)
    band = (1.5, 80.0) if case.startswith("acc") else None
    X, F = rec.to_features(
        smooth=KinematicSmoother(band=band, joint=estimation == "ls")
    )
    model = NRFRegressor(**told, estimation=estimation)
    return errors(
        model.fit(X, F, base_acceleration=rec.base_acceleration).model_, truth
    )


def table(function, cases, estimations, seeds: int, jobs: int) -> None:
    """Worst of the masses, stiffnesses and dampings, and the mean bias over its
    standard error.
    """
    for case in cases:
        rows = {}
        for estimation in estimations:
            began = time.time()
            found = np.array(
                Parallel(n_jobs=jobs)(
                    delayed(quietly)(function, case, estimation, s)
                    for s in range(seeds)
                )
            )
            parts = {
                "mass": found[:, :N],
                "stiffness": found[:, N : 2 * N],
                "damping": found[:, 2 * N :],
            }
            row = {}
            for name, values in parts.items():
                row[f"worst {name}"] = spread(np.abs(values).max(axis=1))
            row["one damping"] = spread(np.abs(parts["damping"]).ravel())
            for name in ("mass", "stiffness"):
                bias, error = (
                    parts[name].mean(axis=0),
                    parts[name].std(axis=0, ddof=1) / seeds**0.5,
                )
                row[f"{name} bias / se"] = (
                    ""
                    if np.isnan(bias).all()
                    else (
                        f"{np.abs(bias / error).max():.1f}"
                        f" ({bias[np.abs(bias).argmax()]:+.2f} %)"
                    )
                )
            row["s per fit"] = f"{(time.time() - began) * jobs / seeds:.1f}"
            rows[estimation] = row
        if function is one and CASES[case][0] in ("plain", "random parameters"):
            sigma = np.mean([bound(case, s) for s in range(min(seeds, 3))], axis=0)
            worst = np.abs(
                np.random.default_rng(0).normal(size=(4000, len(sigma))) * sigma
            )
            parts = {
                "mass": slice(0, N),
                "stiffness": slice(N, 2 * N),
                "damping": slice(2 * N, None),
            }
            rows["Cramer-Rao bound"] = {
                f"worst {k}": f"{np.median(worst[:, part].max(axis=1)):.2f}"
                for k, part in parts.items()
            }
        goal = f"   (target: worst mass {TARGET[case]} %)" if case in TARGET else ""
        print(f"\n{case}{goal}\n{pd.DataFrame(rows).T.to_string()}", flush=True)


def spread(values: np.ndarray) -> str:
    values = values[np.isfinite(values)]
    if not len(values):
        return "refused"
    low, high = np.percentile(values, [5, 95])
    return f"{np.median(values):.2f} [{low:.2f}, {high:.2f}]"


# -- intervals -----------------------------------------------------------------


def covered(kind: str, seed: int) -> np.ndarray:
    """Which 95 % intervals of masses, stiffnesses and dampings hold the truth: a chain
    of two, 8 s.
    """
    storey = laws.PowerSeries(1, [60.0, 1.0e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    F = excitation.band_limited_random(
        2, 8.0, 500.0, excited=[2], rms=100.0, band=(0.5, 50.0), random_state=[seed, 3]
    )
    exact = simulate(truth, F, 1 / 500.0, hold="cubic")
    if kind == "least squares, clean regressors":
        rec = add_noise(exact, 0.05, random_state=[seed, 4], channels=["F2"])
        # only the force is noisy, so the steps are those of complete excitation with a
        # known zero
        model = NRFRegressor(degree=1, dt=1 / 500.0).fit(*rec.to_features(smooth=False))
    else:
        estimation = "iv" if kind.startswith("instrumental") else "simulation"
        model = NRFRegressor(degree=1, estimation=estimation).fit(
            add_noise(exact, 0.05, random_state=[seed, 4])
        )
    ci = model.confidence_intervals(0.95).set_index("parameter")
    true = {
        "m1": 10.0,
        "m2": 12.0,
        **{
            f"storey {i}: {t}": c
            for i in (1, 2)
            for t, c in (("s", 1.0e5), ("v", 60.0))
        },
    }
    return np.array(
        [ci.loc[p, "lower"] <= x <= ci.loc[p, "upper"] for p, x in true.items()]
    )


def coverage(repetitions: int, jobs: int) -> None:
    names = ["m1", "m2", "k1", "c1", "k2", "c2"]
    rows = {}
    for kind in (
        "least squares, clean regressors",
        "instrumental variables, 5 %",
        "free run fitted, 5 %",
    ):
        inside = np.array(
            Parallel(n_jobs=jobs)(
                delayed(quietly)(covered, kind, s) for s in range(repetitions)
            )
        )
        rows[kind] = dict(zip(names, (100 * inside.mean(axis=0)).round(1)))
    print(
        f"\n95 % intervals that hold the truth, percent of {repetitions} (target 92 to "
        f"98)\n{pd.DataFrame(rows).T.to_string()}",
        flush=True,
    )


# -- output error, measured frame ----------------------------------------------


def free_run_errors(kind: str, seed: int) -> tuple[float, float]:
    """Free-run errors on a held-out record without noise: instrumental variables, then
    output error.
    """
    truth, told = chain(kind, seed)
    rec = record(truth, [3], seed, 0.05)
    exact = exact_record(truth, [3], [seed, 9], duration=8.0)
    F = exact.force
    out = []
    for estimation in ("iv", "simulation"):
        model = NRFRegressor(**told, estimation=estimation).fit(rec)
        run = model.simulate(F, dt=1 / FS, hold="cubic")  # as the force was
        out.append(nrmse(exact.acceleration, run.acceleration))
    return out[0], out[1]


def output_error(seeds: int, jobs: int) -> None:
    for kind in ("plain", "cubic storey", "damper", "random parameters"):
        found = np.array(
            Parallel(n_jobs=jobs)(
                delayed(quietly)(free_run_errors, kind, s) for s in range(seeds)
            )
        )
        print(
            f"\nFree-run error on a held-out record, {kind}: percent NRMSE of the"
            f" accelerations, 5 % noise, {seeds} seeds\n  iv {spread(found[:, 0])}  "
            f" simulation {spread(found[:, 1])}   simulation worse in"
            f" {int((found[:, 1] > found[:, 0] * (1 + 1e-9)).sum())} of {seeds}",
            flush=True,
        )


def measured_frame() -> None:
    """Three equal floors from measured frequency responses."""
    sys.path.append(str(Path(__file__).resolve().parents[1] / "examples"))
    from measured_sets import load_three_storey_frf

    try:
        frf = load_three_storey_frf()
    except NRFError as error:
        print(f"\nthree_storey_frf skipped: {error}")
        return
    print(
        "\nthree_storey_frf, 4 to 32 Hz, its useful band: three equal masses (file's"
        " unit), spread, 95 % intervals"
    )
    model = quietly(NRFRegressor(degree=1, band=(4.0, 32.0)).fit, frf)
    ci = model.confidence_intervals().set_index("parameter").iloc[:3]
    text = ", ".join(
        f"{r.estimate:.4f} [{r.lower:.4f}, {r.upper:.4f}]" for r in ci.itertuples()
    )
    m = model.masses_
    print(
        f"  {text}   spread {100 * (m.max() / m.min() - 1):.1f} %  "
        f" {model.data_warnings_['channels']}",
        flush=True,
    )


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="2 seeds, 8 s, 20 repetitions"
    )
    parser.add_argument("--seeds", type=int, default=None)
    parser.add_argument(
        "--seconds", type=float, default=None, help="length of the records"
    )
    parser.add_argument("--repetitions", type=int, default=None)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--only", default="", help="run only the parts whose title contains this"
    )
    options = parser.parse_args(argv)
    global DURATION
    DURATION = options.seconds or (8.0 if options.quick else DURATION)
    seeds = options.seeds or (2 if options.quick else 20)
    began = time.time()
    cases, few = ([c for c in every if options.only in c] for every in (CASES, SENSORS))
    table(
        one, cases, ["ls, raw channels", "ls", "iv", "simulation"], seeds, options.jobs
    )
    table(sensors, few, ["ls", "iv"], seeds, options.jobs)
    if options.only in "intervals":
        coverage(options.repetitions or (20 if options.quick else 300), options.jobs)
    if options.only in "output error":
        output_error(min(seeds, 8), options.jobs)
    if options.only in "frequency response":
        measured_frame()
    print(f"\n{time.time() - began:.0f} s")


if __name__ == "__main__":
    main()
