"""Coverage of 95 % intervals: 3 chains, noise of 0, 0.2, 1, 5 % on every channel.

    python benchmarks/interval_coverage.py --fits 400 --jobs 2   # --quick: 12 a cell

Records of 20 s at 500 Hz (10 000 samples), accelerations, displacements and forces;
noise is a share of each channel's rms; the laws are known. Of each cell: the share of
intervals that hold the truth (masses, stiffness, damping, cubic term), the share
withheld, the median half-width in percent and the time of a fit with its intervals, by
``estimation`` = "auto" (the default), "ls" and "iv".
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import search_path
import pandas as pd
from harness import in_parallel, markdown, options_of
from tqdm import tqdm

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

FS = 500.0  # Hz
DURATION = 20.0  # s
NOISE = (0.0, 0.002, 0.01, 0.05)
ESTIMATIONS = ("auto", "ls", "iv")
# Kinds of parameters, by the end of their names.
KINDS = {": s": "stiffness", ": v": "damping", ": s^3": "cubic"}


@dataclass(frozen=True)
class Test:
    """A chain, the DOFs that are forced, and what is known of its laws."""

    truth: ChainModel
    forced: list[int]
    laws: dict[str, list] = field(default_factory=dict)


def linear(k: float, c: float) -> list:
    return [laws.LinearElastic(k), laws.LinearViscous(c)]


def tests() -> dict[str, Test]:
    """Tests by name."""
    both_alike = {i: linear(1e5, 60.0) for i in (1, 2)}
    all_alike = {i: linear(1.4e5, 50.0) for i in (1, 2, 3, 4)}
    cubic = [laws.PowerSeries((0, 3), [3.5e4, 0.0, 3e9]), laws.LinearViscous(20.0)]
    with_cubic = {1: linear(4e4, 25.0), 2: cubic, 3: linear(3e4, 15.0)}
    declared = {"storey 2": [laws.PowerSeries((0, 3)), laws.LinearViscous()]}
    return {
        "2 DOFs, both forced": Test(ChainModel([10.0, 12.0], both_alike), [1, 2]),
        "3 DOFs, floor 1 forced, cubic storey 2": Test(
            ChainModel([12.0, 10.0, 8.0], with_cubic), [1], declared
        ),
        "4 DOFs, floor 3 forced": Test(ChainModel([12.4] * 4, all_alike), [3]),
    }


def record(test: Test, noise: float, seed: int) -> Record:
    """A measured record."""
    F = excitation.band_limited_random(
        test.truth.n_dof,
        DURATION,
        FS,
        excited=test.forced,
        rms=100.0,
        band=(0.5, 30.0),
        random_state=[seed, 3],
    )
    exact = simulate(test.truth, F, 1 / FS, hold="cubic").replace(velocity=None)
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


def intervals(name: str, noise: float, estimation: str, seed: int) -> pd.DataFrame:
    """Each interval of one fit: is it given, does it hold the truth, how wide is it?"""
    test = tests()[name]
    measured = record(test, noise, seed)
    known = {"laws": test.laws} if test.laws else {}

    began = time.perf_counter()
    model = NRFRegressor(degree=1, estimation=estimation, **known).fit(measured)
    ci = model.confidence_intervals(0.95)
    seconds = time.perf_counter() - began

    ci["seconds"] = seconds
    ci["found"] = model.model_.info["estimation"]["found"]
    ci["kind"] = ci["parameter"].map(kind_of)
    ci = ci[ci["kind"].notna()]
    truth = ci["parameter"].map(parameters(test.truth))
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


def coverage(found: pd.DataFrame) -> pd.DataFrame:
    """Coverage, width, share withheld and time by cell."""
    rows = []
    by_cell = found.groupby(["chain", "noise", "estimation"], sort=False)
    for (name, noise, estimation), cell in by_cell:
        row: dict[str, Any] = {
            "chain": name,
            "noise %": 100 * noise,
            "estimation": estimation,
        }
        for kind, part in cell.groupby("kind", sort=False):
            row[kind] = covered(part[part["given"]])
        fits = cell.drop_duplicates("seed")
        row["withheld %"] = round(100 * (~cell["given"]).mean(), 1)
        row["by iv %"] = round(100 * (fits["found"] == "iv").mean())
        row["s"] = round(fits["seconds"].median(), 2)
        rows.append(row)
    return pd.DataFrame(rows).fillna("")


def covered(given: pd.DataFrame) -> str:
    """Coverage in percent, and the median half-width."""
    if given.empty:
        return "withheld"
    return f"{100 * given['holds'].mean():.1f} ({given['width'].median():.2g})"


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print the table of all cells."""
    parser = options_of(__doc__, quick="12 fits a cell")
    parser.add_argument("--fits", type=int, default=400)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--estimations", nargs="+", default=ESTIMATIONS)
    parser.add_argument(
        "--chains", default="", help="only chains whose name contains this"
    )
    parser.add_argument("--noise", type=float, nargs="+", default=NOISE)
    parser.add_argument("--save", type=Path, help="CSV of every interval")
    options = parser.parse_args(arguments)
    seeds = range(12 if options.quick else options.fits)
    names = [name for name in tests() if options.chains in name]

    found = []
    cells = list(product(names, options.noise, options.estimations))
    for cell in tqdm(cells, unit="cell", disable=None):
        tasks = [(*cell, seed) for seed in seeds]
        found += in_parallel(intervals, tasks, options.jobs)
        if options.save:  # after every cell: what was done is kept
            pd.concat(found).to_csv(options.save, index=False)

    table = coverage(pd.concat(found))
    print("Coverage in percent (median half-width in percent of the truth)\n")
    print(markdown(table))
    return table


if __name__ == "__main__":
    main()
