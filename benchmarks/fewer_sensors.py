"""Fewer sensors than floors: what the free run fitted to their channels finds.

    python benchmarks/fewer_sensors.py --quick   # two runs of linear rows: seconds
    python benchmarks/fewer_sensors.py           # 300 runs, 30 of each law: hours
    python benchmarks/fewer_sensors.py --only linear --runs 20

Chains with masses of 8 to 16 kg, 100 to 200 kN/m and 15 to 40 N s/m, drawn anew for
each run; 8 s at 200 Hz of a random force on the top floor. Noise is white on every
channel, the force included, as a share of its RMS. Parts:

- *linear*: masses and stiffnesses from the top floor alone, and their intervals;
- *intervals*: from pieces of the data, beside those from curvature;
- *laws*: a nonlinear law in storey 2 of four, sensors on floors 2 and 4;
- *loop*: ``close_loop`` with the same sensors and a hidden law;
- *others*: the same with hysteresis, ties, dashpots to the ground, and wrong sensors;
- *measured*: motions that were measured and are hidden from the fit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import search_path
import measured_sets
import numpy as np
from harness import in_parallel, linear_storeys, options_of, quietly

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import IdentifiabilityError
from pysindy_nrf.identification.fewer_sensors import estimate, shot_of
from pysindy_nrf.simulation.noise import add_noise

FS = 200.0  # Hz
DURATION = 8.0  # s
RMS = 100.0  # N
BAND = (0.5, 50.0)  # Hz
# the nonlinear laws carry about a tenth of the storey's force
GAP = 2e-3  # m
FRICTION = 30.0  # N
CUBE = 4e9  # N/m^3
LAWS = ("cubic", "gap", "friction")
SENSORS = (2, 4)  # floors of four


@dataclass(frozen=True)
class Result:
    """Worst relative error, a second number, or why the test was refused."""

    worst: float
    second: float
    refusal: str = ""


def refused(reason: str) -> Result:
    return Result(np.nan, np.nan, reason)


# -- simulated tests -----------------------------------------------------------


def chain(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, stiffnesses and damping of a run."""
    rng = np.random.default_rng([seed, n])
    return rng.uniform(8, 16, n), rng.uniform(1e5, 2e5, n), rng.uniform(15, 40, n)


def forced(truth: ChainModel, seed: int, hold: str = "cubic") -> Record:
    """A free run under a random force on the top floor."""
    n = truth.n_dof
    F = excitation.band_limited_random(
        n, DURATION, FS, excited=[n], rms=RMS, band=BAND, random_state=seed
    )
    return simulate(truth, F, 1 / FS, hold=hold)


def noisy(record: Record, noise: float, seed: int) -> Record:
    return add_noise(record, noise, random_state=[seed, 1])


def sensed(record: Record, floors: tuple[int, ...]) -> Record:
    """The accelerations of some floors, and the forces."""
    has_sensor = np.isin(np.arange(1, record.n_dof + 1), floors)
    return Record(
        force=record.force,
        acceleration=np.where(has_sensor, record.acceleration, np.nan),
        fs=record.fs,
        base_acceleration=record.base_acceleration,
    )


# -- linear chains -------------------------------------------------------------


def linear(n: int, noise: float, seed: int) -> Result:
    """Worst error of masses and stiffnesses, share of intervals that hold the truth.

    The top floor alone has a sensor.
    """
    m, k, c = chain(n, seed)
    record = forced(ChainModel(m, linear_storeys(k, c)), seed)
    if noise:
        record = noisy(record, noise, seed)
    try:
        model = NRFRegressor(degree=1).fit(sensed(record, (n,)))
    except IdentifiabilityError as error:
        return refused(error.what)

    masses = [f"m{j}" for j in range(1, n + 1)]
    stiffnesses = [f"storey {j}: s" for j in range(1, n + 1)]
    ci = model.confidence_intervals().set_index("parameter")
    ci = ci.loc[masses + stiffnesses]
    if ci["lower"].isna().any():
        return refused("another chain fits as well")
    true = np.concatenate([m, k])
    inside = (ci["lower"] <= true) & (true <= ci["upper"])
    return Result(float(np.abs(ci["estimate"] / true - 1).max()), float(inside.mean()))


def two_intervals(n: int, noise: float, seed: int) -> tuple[float, float, float]:
    """Shares of 95 % intervals that hold the truth: from pieces, from curvature.

    The third number is the median width by pieces over that by curvature, which is the
    inverse of the normal matrix. Damping is not judged.
    """
    m, k, c = chain(n, seed)
    record = noisy(forced(ChainModel(m, linear_storeys(k, c)), seed), noise, seed)
    shot = shot_of(sensed(record, (n,)), 0, n)
    fit, best, _ = estimate(NRFRegressor(degree=1).problem(n), [shot], {})

    values = fit.rebuild.values(best.u)
    true = np.concatenate([m, np.column_stack([c, k]).ravel()])
    judged = np.r_[:n, n + 1 : 3 * n : 2]
    slope = fit.rebuild.slopes(best.u)
    normal = best.jacobian.T @ best.jacobian
    pieces = np.sqrt((best.influences**2).sum(axis=0)) * slope
    curvature = np.sqrt(np.diag(np.linalg.inv(normal))) * slope

    shares = []
    for error in (pieces, curvature):
        inside = np.abs(values - true) < 1.96 * error
        shares.append(float(inside[judged].mean()))
    return *shares, float(np.median((pieces / curvature)[judged]))


# -- nonlinear laws ------------------------------------------------------------


def laws_of_storey(law: str, c: float, k: float) -> tuple[list, list]:
    """The true laws of storey 2, and what is declared of them."""
    spring = laws.PowerSeries(1, [c, k])
    if law == "cubic":
        true = [laws.Duffing(k, CUBE), laws.LinearViscous(c)]
        return true, [laws.Duffing(), laws.LinearViscous()]
    if law == "gap":
        stops = laws.TwoSidedGap(gap=GAP, k=k / 2)
        return [spring, stops], [laws.PowerSeries(1), laws.TwoSidedGap()]
    rubbing = laws.CoulombFriction(FRICTION)
    return [spring, rubbing], [laws.PowerSeries(1), laws.CoulombFriction()]


def nonlinear_parameters(law: str, storey: list) -> np.ndarray:
    """Parameters of the nonlinear law of storey 2."""
    if law == "cubic":
        return np.array([storey[0].parameters["k3"]])
    return np.array(list(storey[1].parameters.values()))


def nonlinear(law: str, noise: float, seed: int) -> Result:
    """Worst error of the masses, and of the parameters of the law in storey 2."""
    m, k, c = chain(4, seed)
    true, declared = laws_of_storey(law, c[1], k[1])
    truth = ChainModel(m, linear_storeys(k, c) | {"storey 2": true})
    record = sensed(noisy(forced(truth, seed), noise, seed), SENSORS)
    estimator = NRFRegressor(degree=1, laws={"storey 2": declared})
    try:
        model = quietly(estimator.fit, record).model_
    except IdentifiabilityError as error:
        return refused(error.what)

    parameters = nonlinear_parameters(law, model.laws["storey 2"])
    ratio = parameters / nonlinear_parameters(law, true)
    return Result(
        float(np.abs(model.masses / m - 1).max()), float(np.abs(ratio - 1).max())
    )


# -- the closed loop -----------------------------------------------------------

HIDDEN = ("friction", "cubic", "square", "gap", "none")
SHARE = 0.12  # of the storey's force that the hidden law carries


@dataclass(frozen=True)
class Search:
    """The hidden law and its storey, what was found, the error before, percent."""

    law: str
    site: str
    effects: list[str]
    error_before: float

    @property
    def right(self) -> bool:
        """Whether the hidden law was found and nothing else."""
        wanted = [f"{self.law} at {self.site}"] if self.law else []
        return self.effects == wanted


def hidden_law(kind: str, force: float, s: np.ndarray, v: np.ndarray) -> laws.ForceLaw:
    """A law of some rms force (N) along a motion."""
    if kind == "friction":
        return laws.CoulombFriction(force)
    if kind == "cubic":
        return laws.CubicStiffness(force / np.sqrt(np.mean(s**6)))
    if kind == "square":
        return laws.QuadraticDamping(force / np.sqrt(np.mean(v**4)))
    gap = 0.8 * s.std()
    beyond = np.maximum(np.abs(s) - gap, 0.0)
    return laws.TwoSidedGap(gap=gap, k=force / np.sqrt(np.mean(beyond**2)))


def with_hidden_law(seed: int) -> tuple[Record, str, str]:
    """A run of four floors, the law that is hidden in it, and its storey."""
    m, k, c = chain(4, seed)
    kind = HIDDEN[seed % len(HIDDEN)]
    i = (seed // len(HIDDEN)) % 4
    site = f"storey {i + 1}"
    plain = linear_storeys(k, c)
    record = forced(ChainModel(m, plain), seed)
    if kind == "none":
        return record, "", site

    for _ in range(3):  # the law changes the motion that it is sized for
        s = np.diff(record.displacement, axis=1, prepend=0.0)[:, i]
        v = np.diff(record.velocity, axis=1, prepend=0.0)[:, i]
        storey_force = np.sqrt(np.mean((k[i] * s + c[i] * v) ** 2))
        law = hidden_law(kind, SHARE * float(storey_force), s, v)
        truth = ChainModel(m, plain | {site: [*plain[site], law]})
        record = forced(truth, seed)
    return record, law.name, site


def search(noise: float, seed: int) -> Search:
    """``close_loop`` from a linear chain, with two sensors."""
    record, law, site = with_hidden_law(seed)
    try:
        report = close_loop(sensed(noisy(record, noise, seed), SENSORS))
    except IdentifiabilityError as error:
        return Search(law, site, [f"refused: {error.what}"], np.nan)
    confirmed = [step for step in report.steps if step.confirmed]
    effects = [f"{step.law} at {step.site}" for step in confirmed]
    return Search(law, site, effects, float(report.table["held-out"].iloc[0]))


# -- other effects, and sensors that are wrong ---------------------------------

# Effects by the class that is right, and faults of the sensor on floor 2.
EFFECTS = {
    "slider": "hysteresis",
    "branch": "hysteresis",
    "brace to the ground": "tie",
    "brace over two storeys": "tie",
    "dashpots to the ground": "tie",
}
FAULTS = ("gain of 6 %", "delay of half a sample", "nothing")
TIE = 0.15  # of the stiffness of the storey below
GAIN = 1.06
DELAY = 0.5  # samples


@dataclass(frozen=True)
class Other:
    """What was hidden, what was claimed, and how far the masses are off, percent."""

    kind: str
    claimed: list[str]
    right: bool
    green: bool
    worst_mass: float


def with_other_effect(kind: str, seed: int) -> tuple[ChainModel, Record, list[str]]:
    """A chain with a hidden effect, its run, and the sites of the effect."""
    m, k, c = chain(4, seed)
    plain = linear_storeys(k, c)
    motion = forced(ChainModel(m, plain), seed)
    i = seed % 4
    s = np.diff(motion.displacement, axis=1, prepend=0.0)[:, i]
    v = np.diff(motion.velocity, axis=1, prepend=0.0)[:, i]
    force = SHARE * float(np.sqrt(np.mean((k[i] * s + c[i] * v) ** 2)))
    dashpots = {f"ground {j}": [laws.LinearViscous(4.0 * m[j - 1])] for j in (2, 3, 4)}
    relaxation = s.std() / v.std()
    branch = laws.MaxwellBranch(tau=relaxation, k=1.5 * force / s.std())
    hidden = {
        "slider": {f"storey {i + 1}": [laws.Jenkins(uy=0.7 * s.std(), Fy=force)]},
        "branch": {f"storey {i + 1}": [branch]},
        "brace to the ground": {"ground 3": [laws.LinearElastic(TIE * k[2])]},
        "brace over two storeys": {"link 4-2": [laws.LinearElastic(TIE * k[3])]},
        "dashpots to the ground": dashpots,
    }.get(kind, {})
    sites = dict(plain)
    for site, further in hidden.items():
        sites[site] = [*sites.get(site, []), *further]
    truth = ChainModel(m, sites)
    return truth, forced(truth, seed), list(hidden)


def with_fault(record: Record, kind: str) -> Record:
    """The record with a fault of the accelerometer on floor 2."""
    a = record.acceleration.copy()
    if kind.startswith("gain"):
        a[:, 1] *= GAIN
    if kind.startswith("delay"):
        w = 2 * np.pi * np.fft.rfftfreq(len(a), 1 / FS)
        lines = np.fft.rfft(a[:, 1]) * np.exp(-1j * w * DELAY / FS)
        a[:, 1] = np.fft.irfft(lines, len(a))
    return record.replace(acceleration=a)


def search_other(kind: str, noise: float, seed: int) -> Other:
    """``close_loop`` from a linear chain, with two sensors."""
    truth, motion, sites = with_other_effect(kind, seed)
    record = with_fault(sensed(noisy(motion, noise, seed), SENSORS), kind)
    report = quietly(lambda: close_loop(record))
    claimed = [step for step in report.steps if step.confirmed]
    right = not claimed
    if sites:
        classes = {step.effect_class for step in claimed}
        places = {step.site for step in claimed}
        right = classes == {EFFECTS[kind]} and places == set(sites)
    off = 100 * float(np.abs(report.model.masses / truth.masses - 1).max())
    names = [f"{step.law} at {step.site}" for step in claimed]
    return Other(kind, names, right, report.verdict.state == "green", off)


# -- measured frames -----------------------------------------------------------


def steady(frf, band: tuple[float, float], seed: int = 0) -> Record:
    """A period of steady motion under a random-phase multisine, from measured FRFs."""
    n = 2 * len(frf.f)
    inside = (frf.f >= band[0]) & (frf.f <= band[1])
    count = int(inside.sum())
    angles = 2 * np.pi * np.random.default_rng(seed).random((count, 1))
    responses = np.column_stack([np.ones(count), frf.H[inside]])
    spectrum = np.zeros((n // 2 + 1, responses.shape[1]), dtype=complex)
    spectrum[1:][inside] = np.exp(1j * angles) * responses
    signals = np.fft.irfft(spectrum, n, axis=0)

    F = np.zeros((n, frf.H.shape[1]))
    F[:, frf.excited - 1] = signals[:, 0]
    fs = n * (frf.f[1] - frf.f[0])
    return Record(force=F, acceleration=signals[:, 1:], fs=fs, name=frf.name)


def missed(record: Record, floor: int, estimator: NRFRegressor) -> float:
    """Percent NRMSE of the motion of a floor that is hidden from the fit."""
    kind = "displacement" if record.acceleration is None else "acceleration"
    channel = f"{'x' if record.acceleration is None else 'a'}{floor}"
    values = np.array(getattr(record, kind))
    measured = values[:, floor - 1].copy()
    values[:, floor - 1] = np.nan
    model = estimator.fit(record.replace(**{kind: values}))
    if kind == "displacement" and record.coordinates == "absolute":
        measured -= record.base_displacement
    return nrmse(measured, model.motions_[0][channel].to_numpy())


def hidden_motion(name: str, record: Record, floor: int, **known) -> str:
    """By how much the motion of a hidden floor is missed, as a line."""
    estimator = NRFRegressor(degree=1, **known)
    try:
        result = f"{quietly(missed, record, floor, estimator):.1f} % NRMSE off"
    except IdentifiabilityError as error:
        result = f"refused: {error.what}"
    return f"{name}, floor {floor} hidden: its motion is {result}"


# -- parts: lines of text ------------------------------------------------------


def line(name: str, results: list[Result], second: str, average: Callable) -> str:
    """Medians of many runs."""
    finite = [result for result in results if np.isfinite(result.worst)]
    if not finite:
        return f"{name:42s} refused in all of {len(results)}"
    worst = [result.worst for result in finite]
    share = 100 * average([result.second for result in finite])
    n_refused = sum(bool(result.refusal) for result in results)
    return (
        f"{name:42s} worst error, median {100 * np.median(worst):8.2g} %,"
        f" largest {100 * np.max(worst):8.2g} %; {second} {share:6.3g} %; refused,"
        f" or no interval, {n_refused} of {len(results)}"
    )


@dataclass(frozen=True)
class Runs:
    """How many runs are made: as many as asked, two, or the default of a part."""

    asked: int | None
    quick: bool
    jobs: int

    def of(self, function: Callable, default: int, *arguments) -> list:
        """Results of a function for many seeds."""
        count = self.asked or (2 if self.quick else default)
        tasks = [(*arguments, seed) for seed in range(count)]
        return in_parallel(function, tasks, self.jobs)


def print_linear(runs: Runs) -> None:
    for n in (2, 3) if runs.quick else (2, 3, 4, 5):
        for noise in (0.0, 0.005) if runs.quick else (0.0, 0.005, 0.02):
            results = runs.of(linear, 300 if noise else 10, n, noise)
            name = f"linear, {n} floors, top alone, {100 * noise:g} % noise"
            print(line(name, results, "inside", np.mean), flush=True)


def print_intervals(runs: Runs) -> None:
    cases = ((2, 0.005),) if runs.quick else ((3, 0.005), (3, 0.02), (4, 0.02))
    for n, noise in cases:
        results = np.array(runs.of(two_intervals, 100, n, noise))
        pieces, curvature, _ = 100 * results.mean(axis=0)
        print(
            f"intervals, {n} floors, {100 * noise:g} % noise: pieces"
            f" {pieces:.1f} % hold, curvature {curvature:.1f} %;"
            f" width over width {np.median(results[:, 2]):.2f}",
            flush=True,
        )


def print_laws(runs: Runs) -> None:
    for law in LAWS:
        results = runs.of(nonlinear, 30, law, 0.01)
        name = f"{law} in storey 2, sensors 2 and 4, 1 %"
        print(line(name, results, "law", np.median), flush=True)


def print_loop(runs: Runs) -> None:
    searches = runs.of(search, 250, 0.005)
    for outcome in searches:
        print(
            f"{outcome.law or 'nothing':18s} {outcome.site}:"
            f" {', '.join(outcome.effects) or 'nothing'}"
            f" (linear chain {outcome.error_before:.2g} % off)"
        )
    right = sum(search.right and bool(search.law) for search in searches)
    silent = sum(search.right and not search.law for search in searches)
    print(
        f"close_loop, sensors 2 and 4, 0.5 %: right {right}, nothing found where"
        f" nothing is {silent}"
    )


def print_others(runs: Runs) -> None:
    for kind in (*EFFECTS, *FAULTS):
        results = runs.of(search_other, 6, kind, 0.005)
        for result in results:
            claimed = ", ".join(result.claimed) or "nothing"
            print(f"  {kind}: {claimed}, masses {result.worst_mass:.2g} % off")
        right = sum(result.right for result in results)
        wrong = sum(result.green and result.worst_mass > 5.0 for result in results)
        print(
            f"{kind}: right {right} of {len(results)}, green with masses more than 5 %"
            f" off {wrong}",
            flush=True,
        )


def print_measured(runs: Runs) -> None:
    equal = dict.fromkeys((1, 2, 3), 5.201)
    bending = {site: [laws.BendingCoupling()] for site in ("link 3-1", "ground 2")}
    frf = measured_sets.load_three_storey_frf()
    for seed in range(3):
        record = steady(frf, (4.0, 32.0), seed)
        for floor in (3, 2, 1):
            print(hidden_motion(f"three_storey_frf {seed}", record, floor), flush=True)

    name = "three_storey_frf, masses known, bending declared"
    record = steady(frf, (4.0, 32.0))
    for floor in (3, 2, 1):
        known = {"laws": bending, "known_masses": equal}
        print(hidden_motion(name, record, floor, **known), flush=True)

    for test in ("fbgm162s1", "fbgm162s3", "fbgm162s5"):
        name = f"nees_three_storey {test}"
        record = measured_sets.load_nees_three_storey(test)
        for floor in (3, 2, 1):
            masses = dict.fromkeys((1, 2, 3), 1.0)
            print(hidden_motion(name, record, floor, known_masses=masses), flush=True)


PARTS: dict[str, Callable[[Runs], None]] = {
    "linear": print_linear,
    "intervals": print_intervals,
    "laws": print_laws,
    "loop": print_loop,
    "others": print_others,
    "measured": print_measured,
}


def main(arguments: list[str] | None = None) -> None:
    """Print every part."""
    parser = options_of(__doc__, quick="two runs of linear chains")
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--runs", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)
    runs = Runs(options.runs, options.quick, options.jobs)
    parts = ("linear", "intervals") if options.quick else PARTS

    began = time.perf_counter()
    for section in parts if options.only is None else (options.only,):
        PARTS[section](runs)
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
