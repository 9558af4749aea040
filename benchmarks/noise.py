"""What measurement noise does to masses and stiffnesses, by estimator.

    python benchmarks/noise.py --quick   # two seeds, short records: some minutes
    python benchmarks/noise.py           # 20 seeds, 300 repetitions: hours
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

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import search_path
import measured_sets
import numpy as np
import pandas as pd
from harness import in_parallel, linear_storeys, options_of, quietly

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.identification.linear_response import transfer
from pysindy_nrf.identification.spectra import fourier_lines
from pysindy_nrf.simulation.noise import add_noise

FS = 1000.0  # Hz
DURATION = 16.0  # s
N = 4  # floors
MASS = 12.4  # kg
STIFFNESS = 1.4e5  # N/m
DAMPING = 25.0  # N s/m
CUBIC = 5e8  # N/m^3
SIGMA = 5e4  # 1/m
FRICTION = 34.85  # N

# parameters of a chain, in the order of ``parameters``
PARTS = {
    "mass": slice(0, N),
    "stiffness": slice(N, 2 * N),
    "damping": slice(2 * N, None),
}


# -- structures and records ----------------------------------------------------


@dataclass(frozen=True)
class Test:
    """A structure, the DOFs that are forced, how, and the noise."""

    kind: str = "plain"
    forced: tuple[int, ...] = (3,)
    noise: float = 0.05
    force: str = "random"
    strategy: str = "auto"
    target: float | None = None  # of the worst mass, percent


TESTS = {
    "5 %": Test(target=0.6),
    "10 %": Test(noise=0.10, target=1.1),
    "5 %, hammer": Test(force="hammer"),
    "5 %, all DOFs forced": Test(forced=(1, 2, 3, 4)),
    "5 %, all DOFs forced, strategy='complete'": Test(
        forced=(1, 2, 3, 4), strategy="complete"
    ),
    "5 %, cubic storey 2": Test("cubic storey"),
    "5 %, MR damper, its law in the model": Test("damper"),
    "5 %, random parameters": Test("random parameters"),
}


def chain(kind: str, seed: int) -> tuple[ChainModel, dict]:
    """The true chain, and options of the estimator: its declared laws."""
    m = np.full(N, MASS)
    k = np.full(N, STIFFNESS)
    c = np.full(N, DAMPING)
    if kind == "random parameters":
        rng = np.random.default_rng([seed, 77])
        m = rng.uniform(6, 25, N)
        k = rng.uniform(0.7e5, 2.8e5, N)
        c = rng.uniform(12, 60, N)

    storeys = linear_storeys(k, c)
    declared: dict = {"degree": 1}
    if kind == "cubic storey":
        spring = laws.PowerSeries((0, 3), [STIFFNESS, 0.0, CUBIC])
        storeys["storey 2"] = [spring, laws.LinearViscous(DAMPING)]
        declared["orders"] = {"storey 2": 3}
    if kind == "damper":
        storeys["storey 1"].append(laws.Dahl(sigma=SIGMA, Fd=FRICTION))
        declared["laws"] = {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=SIGMA)]}
    return ChainModel(m, storeys), declared


def random_force(
    forced: tuple[int, ...], seed: int | list[int], duration: float
) -> np.ndarray:
    return excitation.band_limited_random(
        N, duration, FS, excited=forced, rms=100.0, band=(0.5, 60), random_state=seed
    )


def exact_record(
    truth: ChainModel, test: Test, seed: int | list[int], duration: float
) -> Record:
    """The motion without noise."""
    if test.force == "hammer":
        F = excitation.impact_hammer(
            N,
            duration,
            FS,
            excited=test.forced,
            level=1000.0,
            n_hits=8,
            random_state=seed,
        )
    else:
        F = random_force(test.forced, seed, duration)
    return simulate(truth, F, 1 / FS, hold="cubic")


def noisy(exact: Record, noise: float, seed: int) -> Record:
    return add_noise(exact, noise, random_state=[seed, 1000])


def parameters(model: ChainModel) -> np.ndarray:
    """Masses, stiffnesses, dampings."""
    linear = []
    for i in range(1, model.n_dof + 1):
        linear.append(model.restoring_forces[i].linear_part())
    stiffness = [linear_part["k"] for linear_part in linear]
    damping = [linear_part["c"] for linear_part in linear]
    return np.concatenate([model.masses, stiffness, damping])


def errors(model: ChainModel, truth: ChainModel) -> np.ndarray:
    """Percent of the true parameters."""
    return 100 * (parameters(model) / parameters(truth) - 1)


# -- errors of the estimators --------------------------------------------------


def errors_of_test(
    name: str, estimation: str, seed: int, duration: float = DURATION
) -> np.ndarray:
    """Errors of one noisy record of a chain."""
    test = TESTS[name]
    truth, declared = chain(test.kind, seed)
    record = noisy(exact_record(truth, test, seed, duration), test.noise, seed)
    declared["strategy"] = test.strategy
    if estimation == "ls, raw channels":
        estimator = NRFRegressor(**declared, dt=1 / FS)
        X, F = record.to_features(smooth=False)
        try:
            return errors(estimator.fit(X, F).model_, truth)
        except NRFError:
            # a law with memory refuses drifts and rates that contradict each other
            return np.full(3 * N, np.nan)
    estimator = NRFRegressor(**declared, estimation=estimation)
    return errors(estimator.fit(record).model_, truth)


def cramer_rao(name: str, seed: int, duration: float = DURATION) -> np.ndarray:
    """Least standard deviations of a linear chain's parameters, percent.

    Noise is on a, v, x and F; lines up to 200 Hz count.
    """
    test = TESTS[name]
    truth, _ = chain(test.kind, seed)
    run = exact_record(truth, test, seed, duration)
    f = np.fft.rfftfreq(run.n_samples, 1 / FS)[1:]
    f = f[f < 200.0]
    G = transfer(truth.matrices(), f)[:, :, :N]
    S = spectral_noise(run, test.noise, f, G)

    shifts = []
    for load in loads_of_parameters(run):
        response = G @ fourier_lines(load, 1 / FS)[: len(f), :, None]
        shifts.append(-response[:, :, 0])
    J = np.stack(shifts, axis=2)
    information = 2 * np.einsum("fdi,fdj->ij", J.conj(), np.linalg.solve(S, J)).real
    scale = parameters(truth)
    covariance = np.linalg.inv(information * np.outer(scale, scale))
    return 100 * np.sqrt(np.diag(covariance))


def spectral_noise(
    run: Record, noise: float, f: np.ndarray, G: np.ndarray
) -> np.ndarray:
    """Spectral density of the noise of the velocities, that of the forces included."""

    def sigma(y: np.ndarray) -> np.ndarray:
        return noise * np.sqrt(np.mean(y**2, axis=0))

    w = 2 * np.pi * f[:, None]
    # all three channels together, as one velocity
    precision = (
        (w / sigma(run.acceleration)) ** 2
        + 1 / sigma(run.velocity) ** 2
        + 1 / (w * sigma(run.displacement)) ** 2
    )
    of_motion = 1 / precision / FS
    of_force = sigma(run.force) ** 2 / FS
    density = (G * of_force) @ G.conj().transpose(0, 2, 1)
    return density + of_motion[:, :, None] * np.eye(N)


def loads_of_parameters(run: Record) -> list[np.ndarray]:
    """Forces on the DOFs that a unit of each parameter makes."""
    s = np.diff(run.displacement, axis=1, prepend=0.0)
    v = np.diff(run.velocity, axis=1, prepend=0.0)
    # storey i pulls DOF i up and DOF i - 1 down
    pull = np.eye(N) - np.eye(N, k=1)
    loads = [np.outer(run.acceleration[:, j], np.eye(N)[j]) for j in range(N)]
    for y in (s, v):
        loads += [np.outer(y[:, i], pull[:, i]) for i in range(N)]
    return loads


# -- few kinds of sensors ------------------------------------------------------

ACCELERATIONS = "accelerations and force"
DISPLACEMENTS = "displacements and force"
MOVING_BASE = "displacements, moving base"
SENSORS = (ACCELERATIONS, DISPLACEMENTS, MOVING_BASE)


def errors_of_sensors(
    name: str, estimation: str, seed: int, duration: float = DURATION
) -> np.ndarray:
    """Errors with few kinds of sensors, 2 % noise."""
    truth, declared = chain("plain", seed)
    if name == MOVING_BASE:
        exact = on_moving_base(truth, seed, duration)
    else:
        exact = exact_record(truth, Test(), seed, duration)
    record = noisy(exact, 0.02, seed).replace(velocity=None)
    band = None
    if name == ACCELERATIONS:
        record = record.replace(displacement=None)
        band = (1.5, 80.0)
    else:
        record = record.replace(acceleration=None)

    model = NRFRegressor(**declared, estimation=estimation, band=band).fit(record)
    return errors(model.model_, truth)


def on_moving_base(truth: ChainModel, seed: int, duration: float) -> Record:
    """Forced on floor 3, and shaken at the base at 2 m/s^2 rms."""
    rng = np.random.default_rng([seed, 5])
    ag = excitation.band_limited_random(
        1, duration, FS, excited=1, rms=2.0, band=(0.5, 40.0), random_state=rng
    )
    F = random_force((3,), seed, duration)
    return simulate(truth, F, 1 / FS, hold="cubic", base_acceleration=ag[:, 0])


# -- tables --------------------------------------------------------------------


@dataclass(frozen=True)
class Runs:
    """How many seeds and repetitions, how long the records are (s), jobs at a time."""

    seeds: int
    repetitions: int
    duration: float
    jobs: int


def spread(values: np.ndarray) -> str:
    """Median, and the range that holds 90 %."""
    values = values[np.isfinite(values)]
    if not len(values):
        return "refused"
    low, high = np.percentile(values, [5, 95])
    return f"{np.median(values):.2f} [{low:.2f}, {high:.2f}]"


def bias_over_error(values: np.ndarray) -> str:
    """Largest mean bias over its standard error, and the largest bias."""
    bias = values.mean(axis=0)
    if np.isnan(bias).all():
        return ""
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    largest = bias[np.abs(bias).argmax()]
    return f"{np.abs(bias / error).max():.1f} ({largest:+.2f} %)"


def row_of(samples: np.ndarray) -> dict[str, str]:
    """Worst of the masses, stiffnesses and dampings, and their biases."""
    row = {}
    for name, columns in PARTS.items():
        row[f"worst {name}"] = spread(np.abs(samples[:, columns]).max(axis=1))
    row["one damping"] = spread(np.abs(samples[:, PARTS["damping"]]).ravel())
    for name in ("mass", "stiffness"):
        row[f"{name} bias / se"] = bias_over_error(samples[:, PARTS[name]])
    return row


def bound_row(name: str, runs: Runs) -> dict[str, str]:
    """Medians of the worst of Gaussian errors at the Cramer-Rao bound."""
    seeds = range(min(runs.seeds, 3))
    bounds = [cramer_rao(name, seed, runs.duration) for seed in seeds]
    sigma = np.mean(bounds, axis=0)
    rng = np.random.default_rng(0)
    drawn = np.abs(rng.normal(size=(4000, len(sigma))) * sigma)
    row = {}
    for kind, columns in PARTS.items():
        worst = np.median(drawn[:, columns].max(axis=1))
        row[f"worst {kind}"] = f"{worst:.2f}"
    return row


def estimator_table(
    function: Callable, name: str, estimations: tuple[str, ...], runs: Runs
) -> pd.DataFrame:
    """One row for each way of estimating."""
    function = partial(function, duration=runs.duration)
    rows = {}
    for estimation in estimations:
        began = time.time()
        tasks = [(name, estimation, seed) for seed in range(runs.seeds)]
        samples = np.array(in_parallel(function, tasks, runs.jobs))
        seconds = (time.time() - began) * runs.jobs / runs.seeds
        rows[estimation] = row_of(samples) | {"s per fit": f"{seconds:.1f}"}
    return pd.DataFrame(rows).T


def print_tests(only: str, runs: Runs) -> None:
    """Every test by every way of estimating."""
    ways = ("ls, raw channels", "ls", "iv", "simulation")
    for name, test in TESTS.items():
        if only not in name:
            continue
        table = estimator_table(errors_of_test, name, ways, runs)
        if test.kind in ("plain", "random parameters"):
            bound = pd.DataFrame({"Cramer-Rao bound": bound_row(name, runs)}).T
            table = pd.concat([table, bound])
        goal = f"   (target: worst mass {test.target} %)" if test.target else ""
        print(f"\n{name}{goal}\n{table.to_string()}", flush=True)


def print_sensors(only: str, runs: Runs) -> None:
    """Few kinds of sensors."""
    for name in SENSORS:
        if only in name:
            table = estimator_table(errors_of_sensors, name, ("ls", "iv"), runs)
            print(f"\n{name}\n{table.to_string()}", flush=True)


# -- intervals -----------------------------------------------------------------

CLEAN_REGRESSORS = "least squares, clean regressors"
INSTRUMENTS = "instrumental variables, 5 %"
FREE_RUN = "free run fitted, 5 %"
TRUE_VALUES = {
    "m1": 10.0,
    "m2": 12.0,
    "storey 1: s": 1.0e5,
    "storey 1: v": 60.0,
    "storey 2: s": 1.0e5,
    "storey 2: v": 60.0,
}


def covered(kind: str, seed: int) -> np.ndarray:
    """Which 95 % intervals hold the truth: a chain of two, 8 s."""
    fs = 500.0
    storey = laws.PowerSeries(1, [60.0, 1.0e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    F = excitation.band_limited_random(
        2, 8.0, fs, excited=[2], rms=100.0, band=(0.5, 50.0), random_state=[seed, 3]
    )
    exact = simulate(truth, F, 1 / fs, hold="cubic")
    if kind == CLEAN_REGRESSORS:
        record = add_noise(exact, 0.05, random_state=[seed, 4], channels=["F2"])
        # only the force is noisy, so the steps are those of complete excitation with
        # a known zero
        model = NRFRegressor(degree=1, dt=1 / fs)
        model.fit(*record.to_features(smooth=False))
    else:
        record = add_noise(exact, 0.05, random_state=[seed, 4])
        estimation = "iv" if kind == INSTRUMENTS else "simulation"
        model = NRFRegressor(degree=1, estimation=estimation).fit(record)

    intervals = model.confidence_intervals(0.95).set_index("parameter")
    intervals = intervals.loc[list(TRUE_VALUES)]
    true = np.array(list(TRUE_VALUES.values()))
    return ((intervals["lower"] <= true) & (true <= intervals["upper"])).to_numpy()


def print_coverage(runs: Runs) -> None:
    rows = {}
    for kind in (CLEAN_REGRESSORS, INSTRUMENTS, FREE_RUN):
        tasks = [(kind, seed) for seed in range(runs.repetitions)]
        inside = np.array(in_parallel(covered, tasks, runs.jobs))
        rows[kind] = (100 * inside.mean(axis=0)).round(1)
    names = ["m1", "m2", "k1", "c1", "k2", "c2"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=names)
    print(
        f"\n95 % intervals that hold the truth, percent of {runs.repetitions} (target"
        f" 92 to 98)\n{table.to_string()}",
        flush=True,
    )


# -- output error, measured frame ----------------------------------------------


def free_run_errors(kind: str, seed: int, duration: float) -> tuple[float, float]:
    """Errors on a held-out record without noise: instruments, then output error."""
    truth, declared = chain(kind, seed)
    test = Test(kind)
    record = noisy(exact_record(truth, test, seed, duration), test.noise, seed)
    exact = exact_record(truth, test, [seed, 9], duration=8.0)
    gaps = []
    for estimation in ("iv", "simulation"):
        model = NRFRegressor(**declared, estimation=estimation).fit(record)
        run = model.simulate(exact.force, dt=1 / FS, hold="cubic")
        gaps.append(nrmse(exact.acceleration, run.acceleration))
    return gaps[0], gaps[1]


def print_output_error(runs: Runs) -> None:
    n_seeds = min(runs.seeds, 8)
    for kind in ("plain", "cubic storey", "damper", "random parameters"):
        tasks = [(kind, seed, runs.duration) for seed in range(n_seeds)]
        iv, simulation = np.array(in_parallel(free_run_errors, tasks, runs.jobs)).T
        worse = int((simulation > iv * (1 + 1e-9)).sum())
        print(
            f"\nFree-run error on a held-out record, {kind}: percent NRMSE of the"
            f" accelerations, 5 % noise, {n_seeds} seeds\n  iv {spread(iv)}  "
            f" simulation {spread(simulation)}   simulation worse in {worse} of"
            f" {n_seeds}",
            flush=True,
        )


def print_measured_frame(runs: Runs) -> None:
    """Three equal floors from measured frequency responses."""
    try:
        responses = measured_sets.load_three_storey_frf()
    except NRFError as error:
        print(f"\nthree_storey_frf skipped: {error}")
        return
    print(
        "\nthree_storey_frf, 4 to 32 Hz, its useful band: three equal masses (file's"
        " unit), spread, 95 % intervals"
    )
    model = quietly(NRFRegressor(degree=1, band=(4.0, 32.0)).fit, responses)
    masses = []
    for row in model.confidence_intervals().iloc[:3].itertuples():
        masses.append(f"{row.estimate:.4f} [{row.lower:.4f}, {row.upper:.4f}]")
    spread_of_masses = 100 * (model.masses_.max() / model.masses_.min() - 1)
    print(
        f"  {', '.join(masses)}   spread {spread_of_masses:.1f} %  "
        f" {model.data_warnings_['channels']}",
        flush=True,
    )


def paper_frame(forced: tuple[int, ...], noise: float, seed: int, **how: str) -> Record:
    """The paper's frame with its MR damper, under 60 Hz, with noise added."""
    storey = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
    damper = laws.Dahl(sigma=SIGMA, Fd=FRICTION)
    truth = ChainModel([10.0, 10.0], {1: [*storey, damper], 2: storey})
    F = excitation.band_limited_random(
        2, 8.0, FS, excited=forced, rms=200.0, band=(0.5, 60), random_state=seed
    )
    return noisy(simulate(truth, F, 1 / FS, **how), noise, seed)


def print_shapes(runs: Runs) -> None:
    """Shape parameter and friction of a Dahl law whose shape is not known."""
    print("\nMR damper: sigma (50 000 1/m) and friction (34.85 N), least and largest")
    for noise in (0.01, 0.05):
        for forced in ((1, 2), (2,)):
            for estimation in ("ls", "iv"):
                fits = []
                for seed in range(runs.seeds):
                    record = paper_frame(forced, noise, seed, hold="cubic")
                    damped = {"storey 1": [laws.PowerSeries(1), laws.Dahl()]}
                    model = NRFRegressor(degree=1, laws=damped, estimation=estimation)
                    law = quietly(model.fit, record).model_.laws["storey 1"][-1]
                    fits.append((law.parameters["sigma"], law.parameters["Fd"]))
                low, high = np.min(fits, axis=0), np.max(fits, axis=0)
                print(
                    f"  {noise:.0%}, forced {forced}, {estimation}:"
                    f" sigma {low[0]:.0f} to {high[0]:.0f},"
                    f" friction {low[1]:.1f} to {high[1]:.1f}",
                    flush=True,
                )


WAYS: dict[str, dict[str, str]] = {
    "hold='linear'": {"hold": "linear"},
    "method='newmark'": {"method": "newmark"},
    "hold='cubic'": {"hold": "cubic"},
}


def print_ways(runs: Runs) -> None:
    """Error of the worst mass by the way in which the record was simulated."""
    print("\nRecords of a simulation with 1 % of noise: worst mass, percent too high")
    damped = {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=SIGMA)]}
    for name, how in WAYS.items():
        for estimation in ("ls", "iv"):
            worst = []
            for seed in range(runs.seeds):
                record = paper_frame((1, 2), 0.01, seed, **how).replace(hold=None)
                model = NRFRegressor(degree=1, laws=damped, estimation=estimation)
                errors_of_masses = quietly(model.fit, record).masses_ / 10.0 - 1
                worst.append(100 * errors_of_masses[np.abs(errors_of_masses).argmax()])
            print(f"  {name}, {estimation}: {np.median(worst):.2f}", flush=True)


FURTHER_PARTS: dict[str, Callable[[Runs], None]] = {
    "shapes of a damper": print_shapes,
    "ways of simulating": print_ways,
    "intervals": print_coverage,
    "output error": print_output_error,
    "frequency response": print_measured_frame,
}


def main(arguments: list[str] | None = None) -> None:
    """Print all parts."""
    parser = options_of(__doc__, quick="2 seeds, 8 s, 20 repetitions")
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--seconds", type=float, help="length of the records")
    parser.add_argument("--repetitions", type=int)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--only", default="", help="run only the parts whose title contains this"
    )
    options = parser.parse_args(arguments)
    default = Runs(2, 20, 8.0, 1) if options.quick else Runs(20, 300, DURATION, 1)
    runs = Runs(
        options.seeds or default.seeds,
        options.repetitions or default.repetitions,
        options.seconds or default.duration,
        options.jobs,
    )

    began = time.time()
    print_tests(options.only, runs)
    print_sensors(options.only, runs)
    for title, section in FURTHER_PARTS.items():
        if options.only in title:
            section(runs)
    print(f"\n{time.time() - began:.0f} s")


if __name__ == "__main__":
    main()
