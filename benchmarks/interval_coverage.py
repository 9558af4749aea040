"""Coverage of 95 % intervals: 5 chains, noise of 0, 0.2, 1, 5 % on every channel.

    python benchmarks/interval_coverage.py --jobs 2   # 400 fits, 40 closed loops a cell
    python benchmarks/interval_coverage.py --quick    # 12 and 2, at 1 % noise

Records of 20 s at 500 Hz (10 000 samples), accelerations, displacements and forces;
noise is a share of each channel's rms. The laws are known but for one chain, whose
Rayleigh damping (a dashpot from each floor to the ground) the model does not have; one
chain is excited in its first mode only. Of each cell: the share of intervals that hold
the truth (masses, stiffness, damping, cubic term) with its standard error over records,
the share withheld, the median half-width in percent and the time of a fit with its
intervals, by ``estimation`` = "auto" (the default), "ls" and "iv" of a fit, and by
"close_loop", which has to find the cubic term by itself: a parameter that its model
does not have counts as withheld. ``--estimations declared`` is "auto" with every law of
the structure declared, which is what a loop should come to.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import search_path
import numpy as np
import pandas as pd
from harness import in_parallel, markdown, options_of
from tqdm import tqdm

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.simulation import add_noise

FS = 500.0  # Hz
DURATION = 20.0  # s
NOISE = (0.0, 0.002, 0.01, 0.05)
LOOP = "close_loop"
DECLARED = "declared"
ESTIMATIONS = ("auto", "ls", "iv", LOOP)
ALPHA, BETA = 0.8, 4e-4  # of Rayleigh damping, 1/s and s: 2 % in modes 1 and 2
# Kinds of parameters, by the end of their names.
KINDS = {": s": "stiffness", ": v": "damping", ": s^3": "cubic"}


@dataclass(frozen=True)
class Test:
    """A chain, the DOFs that are forced, and what is known of its laws."""

    truth: ChainModel
    forced: list[int]
    laws: dict[str, list] = field(default_factory=dict)
    # of the structure, but not of the model
    unknown: dict[str, list] = field(default_factory=dict)
    band: tuple[float, float] = (0.5, 30.0)  # Hz

    @property
    def structure(self) -> ChainModel:
        """The chain with the laws that the model does not have."""
        return ChainModel(self.truth.masses, {**self.truth.laws, **self.unknown})


def linear(k: float, c: float) -> list:
    return [laws.LinearElastic(k), laws.LinearViscous(c)]


def tests() -> dict[str, Test]:
    """Tests by name."""
    both_alike = {i: linear(1e5, 60.0) for i in (1, 2)}
    all_alike = {i: linear(1.4e5, 50.0) for i in (1, 2, 3, 4)}
    cubic = [laws.PowerSeries((0, 3), [3.5e4, 0.0, 3e9]), laws.LinearViscous(20.0)]
    with_cubic = {1: linear(4e4, 25.0), 2: cubic, 3: linear(3e4, 15.0)}
    declared = {"storey 2": [laws.PowerSeries((0, 3)), laws.LinearViscous()]}
    masses = [12.0, 10.0, 8.0]
    plain = {i: linear(4e4, 25.0) for i in (1, 2, 3)}
    to_ground = {j: ALPHA * masses[j - 1] for j in (1, 2, 3)}
    rayleigh = {i: linear(4e4, BETA * 4e4) for i in (2, 3)}
    # the lowest storey stands on the ground: both dashpots are one
    rayleigh[1] = linear(4e4, BETA * 4e4 + to_ground[1])
    dashpots = {f"ground {j}": [laws.LinearViscous(to_ground[j])] for j in (2, 3)}
    return {
        "2 DOFs, both forced": Test(ChainModel([10.0, 12.0], both_alike), [1, 2]),
        "3 DOFs, floor 1 forced, cubic storey 2": Test(
            ChainModel([12.0, 10.0, 8.0], with_cubic), [1], declared
        ),
        "4 DOFs, floor 3 forced": Test(ChainModel([12.4] * 4, all_alike), [3]),
        "3 DOFs, floor 3 forced, Rayleigh damping": Test(
            ChainModel(masses, rayleigh), [3], unknown=dashpots
        ),
        "3 DOFs, floor 3 forced, first mode only": Test(
            ChainModel(masses, plain), [3], band=(0.5, 7.0)
        ),
    }


def record(test: Test, noise: float, seed: int) -> Record:
    """A measured record."""
    F = excitation.band_limited_random(
        test.truth.n_dof,
        DURATION,
        FS,
        excited=test.forced,
        rms=100.0,
        band=test.band,
        random_state=[seed, 3],
    )
    exact = simulate(test.structure, F, 1 / FS, hold="cubic").replace(velocity=None)
    return add_noise(exact, noise, random_state=[seed, 4]) if noise else exact


def parameters(model: ChainModel) -> dict[str, float]:
    """Parameters by the names that intervals have."""
    named = {f"m{j}": mass for j, mass in enumerate(model.masses, 1)}
    for site, force in model.restoring_forces.items():
        for term, coefficient in force.coefficients.items():
            named[f"{site}: {term}"] = coefficient
    return named


def kind_of(parameter: str) -> str | None:
    """Kind of a parameter; None for those whose truth is zero."""
    if parameter.startswith("m"):
        return "mass"
    for end, kind in KINDS.items():
        if parameter.endswith(end):
            return kind
    return None


def of_fit(test: Test, measured: Record, estimation: str) -> pd.DataFrame:
    """Intervals of a fit, and the estimate that it chose."""
    known = dict(test.laws)
    method = estimation
    if estimation == DECLARED:
        known |= {
            site: [type(law)() for law in group] for site, group in test.unknown.items()
        }
        method = "auto"
    declared = known or None
    model = NRFRegressor(degree=1, estimation=method, laws=declared).fit(measured)
    ci = model.confidence_intervals(0.95)
    return ci.assign(found=model.model_.info["estimation"]["found"])


def of_loop(test: Test, measured: Record) -> pd.DataFrame:
    """Intervals of a closed loop that starts from linear storeys."""
    report = close_loop(measured)
    estimates = parameters(report.model)
    rows = []
    for name in parameters(test.truth):
        lower, upper = report.bounds.get(name, (np.nan, np.nan))
        estimate = estimates.get(name, np.nan)
        rows.append(
            {"parameter": name, "estimate": estimate, "lower": lower, "upper": upper}
        )
    return pd.DataFrame(rows).assign(found=LOOP)


def intervals(name: str, noise: float, estimation: str, seed: int) -> pd.DataFrame:
    """Each interval of one fit: is it given, does it hold the truth, how wide is it?"""
    test = tests()[name]
    measured = record(test, noise, seed)

    began = time.perf_counter()
    if estimation == LOOP:
        ci = of_loop(test, measured)
    else:
        ci = of_fit(test, measured, estimation)
    ci["seconds"] = time.perf_counter() - began

    ci["kind"] = ci["parameter"].map(kind_of)
    true_values = parameters(test.truth)
    ci = ci[ci["kind"].notna() & ci["parameter"].isin(true_values)]
    truth = ci["parameter"].map(true_values)
    return ci.assign(
        truth=truth,
        given=ci["lower"].notna(),
        holds=ci["lower"].le(truth) & ci["upper"].ge(truth),
        width=50 * (ci["upper"] - ci["lower"]) / truth.abs(),
        off=100 * (ci["estimate"] / truth - 1),
        chain=name,
        noise=noise,
        estimation=estimation,
        seed=seed,
    )


def coverage(intervals: pd.DataFrame) -> pd.DataFrame:
    """Coverage, width, share withheld and time by cell."""
    rows = []
    by_cell = intervals.groupby(["chain", "noise", "estimation"], sort=False)
    for (name, noise, estimation), cell in by_cell:
        row: dict[str, Any] = {
            "chain": name,
            "noise %": 100 * noise,
            "estimation": estimation,
        }
        for kind, of_kind in cell.groupby("kind", sort=False):
            row[kind] = covered(of_kind[of_kind["given"]])
        fits = cell.drop_duplicates("seed")
        row["withheld %"] = round(100 * (~cell["given"]).mean(), 1)
        row["by iv %"] = round(100 * (fits["found"] == "iv").mean())
        row["s"] = round(fits["seconds"].median(), 2)
        rows.append(row)
    return pd.DataFrame(rows).fillna("")


def covered(intervals: pd.DataFrame) -> str:
    """Coverage in percent with its standard error, and the median half-width."""
    if intervals.empty:
        return "withheld"
    share = 100 * intervals["holds"].mean()
    error = 100 * error_of_share(intervals)
    return f"{share:.1f} ± {error:.1f} ({intervals['width'].median():.2g})"


def error_of_share(intervals: pd.DataFrame) -> float:
    """Standard error of the share that holds the truth.

    Intervals of one record hold or miss together, so that records are counted.
    """
    share = intervals["holds"].mean()
    excess = (intervals["holds"] - share).groupby(intervals["seed"]).sum()
    n = len(excess)
    if n < 2:
        return np.nan
    return float(np.sqrt((excess**2).sum() * n / (n - 1)) / len(intervals))


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print the table of all cells."""
    parser = options_of(__doc__, quick="12 fits, 2 loops a cell; 1 % noise")
    parser.add_argument("--fits", type=int, default=400)
    parser.add_argument("--loops", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--estimations", nargs="+", default=ESTIMATIONS)
    parser.add_argument(
        "--chains", default="", help="only chains whose name contains this"
    )
    parser.add_argument("--noise", type=float, nargs="+", default=NOISE)
    parser.add_argument("--save", type=Path, help="CSV of every interval")
    options = parser.parse_args(arguments)
    n_fits, n_loops = (12, 2) if options.quick else (options.fits, options.loops)
    levels = (0.01,) if options.quick else options.noise
    names = [name for name in tests() if options.chains in name]

    tables = []
    cells = list(product(names, levels, options.estimations))
    for cell in tqdm(cells, unit="cell", disable=None):
        n_seeds = n_loops if cell[-1] == LOOP else n_fits
        tasks = [(*cell, seed) for seed in range(n_seeds)]
        tables += in_parallel(intervals, tasks, options.jobs)
        if options.save:  # after every cell: what was done is kept
            pd.concat(tables).to_csv(options.save, index=False)

    table = coverage(pd.concat(tables))
    print("Coverage in percent ± standard error (median half-width in percent)\n")
    print(markdown(table))
    return table


if __name__ == "__main__":
    main()
