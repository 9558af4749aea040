"""An unscented filter beside the free run fitted: four floors, two sensors, one law.

    python benchmarks/filter_comparison.py --quick   # one pass of the filter: seconds
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

import time
from dataclasses import dataclass

import search_path
import fewer_sensors
import numpy as np
import pandas as pd
from fewer_sensors import CUBE, FRICTION, FS, GAP, LAWS, SENSORS
from harness import in_parallel, linear_storeys, markdown, options_of
from scipy.stats import norm

from pysindy_nrf import ChainModel, Record

FLOORS = 4
SIZE = 2 * FLOORS  # displacements and velocities
STEPS = 4  # of the integration, a sample
PASSES = 3
WIDER = 0.3  # of the first covariance of the parameters, which later passes start from
CREEP = 1e-3  # m/s, in which friction turns round
AT_REST = 1e-9  # standard deviation of the initial state, m and m/s


# -- the structure -------------------------------------------------------------


def rates(law: str, z: np.ndarray, force: float) -> np.ndarray:
    """Velocities and accelerations of all sigma points, (2 * n, n_points)."""
    x, v = z[:FLOORS], z[FLOORS:SIZE]
    m, k, c = np.exp(z[SIZE : SIZE + 3 * FLOORS]).reshape(3, FLOORS, -1)
    coefficients = np.exp(z[SIZE + 3 * FLOORS :])
    s = np.diff(x, axis=0, prepend=0.0 * x[:1])
    rate = np.diff(v, axis=0, prepend=0.0 * v[:1])

    storey = k * s + c * rate
    storey[1] += law_force(law, coefficients, s[1], rate[1])
    net = -storey
    net[:-1] += storey[1:]
    net[-1] += force
    return np.concatenate([v, net / m])


def law_force(
    law: str, coefficients: np.ndarray, s: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Force of the nonlinear law in storey 2, N."""
    if law == "cubic":
        return coefficients[0] * s**3
    if law == "gap":
        return (
            coefficients[1] * np.sign(s) * np.maximum(np.abs(s) - coefficients[0], 0.0)
        )
    return coefficients[0] * np.tanh(v / CREEP)


def moved(z: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Points whose state, not their parameters, has moved."""
    out = z.copy()
    out[:SIZE] += step
    return out


def advanced(law: str, z: np.ndarray, start: float, end: float) -> np.ndarray:
    """All sigma points one sample later, under a force that runs straight."""
    h = 1 / FS / STEPS
    rise = (end - start) / STEPS
    for f in np.linspace(start, end, STEPS + 1)[:-1]:
        k1 = rates(law, z, f)
        k2 = rates(law, moved(z, 0.5 * h * k1), f + 0.5 * rise)
        k3 = rates(law, moved(z, 0.5 * h * k2), f + 0.5 * rise)
        k4 = rates(law, moved(z, h * k3), f + rise)
        z = moved(z, h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return z


# -- the filter ----------------------------------------------------------------


@dataclass(frozen=True)
class Belief:
    """Mean of state and parameters, and the root of their covariance."""

    mean: np.ndarray
    root: np.ndarray

    def points(self) -> np.ndarray:
        """Sigma points."""
        sides = np.hstack([self.root, -self.root])
        return self.mean[:, None] + np.sqrt(len(self.mean)) * sides

    @property
    def parameters(self) -> np.ndarray:
        return self.mean[SIZE:]

    @property
    def errors(self) -> np.ndarray:
        """Standard errors of the parameters."""
        return np.sqrt((self.root**2).sum(axis=1))[SIZE:]


def triangle(columns: np.ndarray) -> np.ndarray:
    """Lower triangle with the same product with its transpose."""
    return np.linalg.qr(columns.T, mode="r").T


def deviations(points: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Weighted deviations of sigma points, a root of their covariance."""
    return (points - mean[:, None]) / np.sqrt(points.shape[1])


@dataclass(frozen=True)
class Filter:
    """An unscented filter of one record.

    ``first`` are the logarithms of the parameters that it starts from, ``spread`` their
    standard deviations.
    """

    law: str
    force: np.ndarray
    measured: np.ndarray
    noise: float
    first: np.ndarray
    spread: np.ndarray

    def run(self, passes: int) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the parameters and their standard errors; NaN if diverged."""
        first, spread = self.first, self.spread
        for _ in range(passes):
            belief = self.pass_over_record(first, spread)
            if belief is None:
                return np.full_like(first, np.nan), np.full_like(first, np.nan)
            first = belief.parameters
            spread = WIDER * self.spread
        return first, belief.errors

    def pass_over_record(self, first: np.ndarray, spread: np.ndarray) -> Belief | None:
        """State and parameters at the end of the record."""
        mean = np.concatenate([np.zeros(SIZE), first])
        belief = Belief(mean, np.diag(np.concatenate([np.full(SIZE, AT_REST), spread])))
        for i, measured in enumerate(self.measured):
            if i > 0:
                belief = self.predicted(belief, self.force[i - 1], self.force[i])
            corrected = self.corrected(belief, self.force[i], measured)
            if corrected is None:
                return None
            belief = corrected
        return belief

    def predicted(self, belief: Belief, start: float, end: float) -> Belief:
        """One sample later; the noise of the force pushes the top floor."""
        points = advanced(self.law, belief.points(), start, end)
        mean = points.mean(axis=1)
        push = np.zeros((len(mean), 1))
        top_mass = np.exp(mean[SIZE + FLOORS - 1])
        push[SIZE - 1] = self.noise * self.force.std() / FS / top_mass
        return Belief(mean, triangle(np.hstack([deviations(points, mean), push])))

    def corrected(
        self, belief: Belief, force: float, measured: np.ndarray
    ) -> Belief | None:
        """With the accelerations that were measured; None if a point has diverged."""
        points = belief.points()
        channels = FLOORS + np.array(SENSORS) - 1
        read = rates(self.law, points, force)[channels]
        expected = read.mean(axis=1)
        error = np.diag(self.noise * self.measured.std(axis=0))
        n = len(error)
        joint = np.block(
            [
                [deviations(read, expected), error],
                [deviations(points, belief.mean), np.zeros((len(points), n))],
            ]
        )
        if not np.isfinite(joint).all():
            return None
        both = triangle(joint)
        gain = np.linalg.solve(both[:n, :n], measured - expected)
        return Belief(belief.mean + both[n:, :n] @ gain, both[n:, n:])


# -- the comparison ------------------------------------------------------------


@dataclass(frozen=True)
class Estimate:
    """Worst errors of masses and law, share of intervals that hold, processor time.

    What diverged or was refused counts as infinitely wrong.
    """

    masses: float
    law: float
    seconds: float
    inside: float = np.nan


def tested(law: str, noise: float, seed: int) -> tuple[Record, np.ndarray]:
    """A noisy record, and the logarithms of the true parameters."""
    m, k, c = fewer_sensors.chain(FLOORS, seed)
    storey, _ = fewer_sensors.laws_of_storey(law, c[1], k[1])
    truth = ChainModel(m, linear_storeys(k, c) | {"storey 2": storey})
    # the filter draws straight lines between the samples of the force
    record = fewer_sensors.forced(truth, seed, hold="linear")
    record = fewer_sensors.noisy(record, noise, seed)
    coefficients = {"cubic": [CUBE], "gap": [GAP, k[1] / 2], "friction": [FRICTION]}[
        law
    ]
    return record, np.log(np.concatenate([m, k, c, coefficients]))


def filtered(law: str, noise: float, off: float, passes: int, seed: int) -> Estimate:
    """The filter, from first values that are off by a factor."""
    record, truth = tested(law, noise, seed)
    spread = np.full(len(truth), max(np.log(off), 0.1))
    rng = np.random.default_rng([seed, 7])
    first = truth + spread * rng.uniform(-1, 1, len(truth))
    sensors = np.array(SENSORS) - 1
    began = time.process_time()
    force, measured = record.force[:, -1], record.acceleration[:, sensors]
    estimate, error = Filter(law, force, measured, noise, first, spread).run(passes)
    seconds = time.process_time() - began

    away = np.abs(np.exp(estimate - truth) - 1)
    inside = np.abs(estimate - truth) <= norm.ppf(0.975) * error
    return Estimate(
        away[:FLOORS].max(),
        away[3 * FLOORS :].max(),
        seconds,
        inside[:FLOORS].mean(),
    )


def fitted(law: str, noise: float, seed: int) -> Estimate:
    """The free run fitted to the channels."""
    began = time.process_time()
    result = fewer_sensors.nonlinear(law, noise, seed)
    return Estimate(result.worst, result.second, time.process_time() - began)


def row(law: str, name: str, estimates: list[Estimate]) -> dict[str, str]:
    """Medians and largest values of many runs."""
    inside = [estimate.inside for estimate in estimates]
    seconds = np.median([estimate.seconds for estimate in estimates])
    coverage = "" if np.isnan(inside).all() else f"{100 * np.mean(inside):.0f} %"
    return {
        "law": law,
        "estimate": name,
        "masses: median, largest": in_percent([e.masses for e in estimates]),
        "law: median, largest": in_percent([e.law for e in estimates]),
        "hold": coverage,
        "CPU, s": f"{seconds:.0f}",
    }


def in_percent(errors: list[float]) -> str:
    """Median and largest error."""
    values = 100 * np.array(errors)
    values = np.where(np.isfinite(values), values, np.inf)
    return f"{np.median(values):.2g}, {values.max():.2g} %"


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print the table of all laws."""
    parser = options_of(__doc__, quick="one pass of the filter over one cubic case")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--off", type=float, nargs="*", default=[1.3, 2.0, 3.0])
    options = parser.parse_args(arguments)
    seeds = range(1 if options.quick else options.runs)
    passes = 1 if options.quick else PASSES

    rows = []
    for law in LAWS[:1] if options.quick else LAWS:
        for off in options.off[:1] if options.quick else options.off:
            tasks = [(law, options.noise, off, passes, seed) for seed in seeds]
            by_filter = in_parallel(filtered, tasks, options.jobs)
            rows.append(row(law, f"filter, first values {off:g} times off", by_filter))
        if not options.quick:
            tasks = [(law, options.noise, seed) for seed in seeds]
            by_filter = in_parallel(fitted, tasks, options.jobs)
            rows.append(row(law, "free run fitted", by_filter))
    table = pd.DataFrame(rows)
    print(markdown(table))
    return table


if __name__ == "__main__":
    main()
