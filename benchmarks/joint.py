"""All floors forced: is it better to solve each balance alone, or all at once?

    python benchmarks/joint.py [--quick] [--out FOLDER]

Alone is ``strategy="complete"``, all at once the default, ``"joint"``. Chains of 2 to 6
floors, all forced, channels with 0.5 to 5 % noise, fused; storeys linear or cubic, a
Dahl damper that is declared, or one that is not. Each as it is, with five times the
noise on one floor's motion, and with one force that reads 5 % too much. The error of a
law is that of its force along the true motion, percent, the worst storey; that of the
masses the worst one. ``--quick`` takes every fourth case.
"""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path
from typing import Any

import search_path
import numpy as np
import pandas as pd
from harness import linear_storeys, options_of, quietly, write_csv
from tqdm import tqdm

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.simulation.noise import add_noise

FS = 500.0  # Hz
SECONDS = 12.0
LAWS = ("linear", "cubic", "Dahl, declared", "Dahl, not declared")
NOISES = (0.005, 0.02, 0.05)
FLOORS = (2, 3, 4, 6)
TESTS = ("all alike", "one floor noisy", "one force wrong")
NOISIER = 5.0  # times the noise of the other floors
TOO_MUCH = 1.05  # times the force
STRATEGIES = {"alone": "complete", "joint": "auto"}


def true_chain(
    rng: np.random.Generator, kind: str, n: int
) -> tuple[ChainModel, dict[str, Any]]:
    """A chain with a law in one storey, and what the regressor is told of it."""
    m = rng.uniform(8, 14, n)
    k = rng.uniform(0.6e5, 1.4e5, n)
    c = rng.uniform(60, 150, n)
    storeys = linear_storeys(k, c)
    place = f"storey {rng.integers(1, n + 1)}"
    declared: dict[str, Any] = {"degree": 1 if kind == "linear" else 3}
    if kind == "cubic":
        storeys[place].append(laws.CubicStiffness(2e10))
    if kind.startswith("Dahl"):
        storeys[place].append(laws.Dahl(sigma=2e4, Fd=25.0))
    if kind == "Dahl, declared":
        own_laws = {place: [laws.PowerSeries(1), laws.Dahl()]}
        declared = {"degree": 1, "laws": own_laws}
    return ChainModel(m, storeys), declared


def measured(record: Record, test: str, noise: float, floor: int, seed: int) -> Record:
    """Noisy channels, one floor's noisier or one force too large."""
    plain = add_noise(record, noise, random_state=seed)
    if test == "one force wrong":
        gains = np.ones(record.n_dof)
        gains[floor] = TOO_MUCH
        return plain.replace(force=plain.force * gains)
    if test == "one floor noisy":
        noisy = add_noise(record, NOISIER * noise, random_state=seed + 1)
        acceleration = with_column(plain.acceleration, noisy.acceleration, floor)
        displacement = with_column(plain.displacement, noisy.displacement, floor)
        return plain.replace(acceleration=acceleration, displacement=displacement)
    return plain


def with_column(values: np.ndarray, others: np.ndarray, column: int) -> np.ndarray:
    """One column taken from another array."""
    out = values.copy()
    out[:, column] = others[:, column]
    return out


def case(test: str, kind: str, n: int, noise: float, seed: int) -> dict[str, Any]:
    """Errors of both strategies on one chain."""
    rng = np.random.default_rng([6, n, seed])
    truth, declared = true_chain(rng, kind, n)
    F = excitation.band_limited_random(
        n,
        SECONDS,
        FS,
        excited=range(1, n + 1),
        rms=120.0,
        band=(0.5, 40),
        random_state=[6, n, seed],
    )
    record = simulate(truth, F, 1 / FS)
    floor = int(rng.integers(n))
    X, F = measured(record, test, noise, floor, seed).to_features()

    row: dict[str, Any] = {
        "test": test,
        "law": kind,
        "floors": n,
        "noise (%)": 100 * noise,
        "seed": seed,
    }
    for name, strategy in STRATEGIES.items():
        model = quietly(NRFRegressor(strategy=strategy, **declared).fit, X, F)
        row["solved"] = model.solve_order_.strategy
        row[f"mass, {name}"] = 100 * np.abs(model.masses_ / truth.masses - 1).max()
        row[f"force, {name}"] = worst_force(model, truth, record)
    return row


def worst_force(model: NRFRegressor, truth: ChainModel, record: Record) -> float:
    """Largest error of a storey's force along the true motion, percent."""
    inertia = record.force - truth.masses * record.acceleration
    true = np.cumsum(inertia[:, ::-1], axis=1)[:, ::-1]
    X, _ = record.to_features(smooth=False)
    forces = model.restoring_force(X)
    return max(nrmse(*pair) for pair in zip(true.T, forces.T))


def table(quick: bool = False) -> pd.DataFrame:
    """All cases, or every fourth."""
    cases = list(product(TESTS, range(2), LAWS, FLOORS, NOISES))
    rows = []
    for test, seed, kind, n, noise in tqdm(cases[:: 4 if quick else 1], disable=None):
        rows.append(case(test, kind, n, noise, seed))
    return pd.DataFrame(rows)


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """By test and law: error alone over error joint; above one, joint is better."""
    out = {}
    for error in ("mass", "force"):
        ratio = rows[f"{error}, alone"] / rows[f"{error}, joint"]
        for test, ratios in ratio.groupby(rows["test"], sort=False):
            out[error, test, "every law"] = statistics(ratios, rows)
        for (test, law), ratios in ratio.groupby(
            [rows["test"], rows["law"]], sort=False
        ):
            out[error, test, law] = statistics(ratios, rows)
    return pd.DataFrame.from_dict(out, orient="index")


def statistics(ratio: pd.Series, rows: pd.DataFrame) -> dict[str, float]:
    """How often joint is better or worse by 2 %, and by how much."""
    return {
        "cases": len(ratio),
        "better (%)": 100 * (ratio > 1.02).mean(),
        "worse (%)": 100 * (ratio < 0.98).mean(),
        "geometric mean": np.exp(np.log(ratio).mean()),
        "least": ratio.min(),
        "most": ratio.max(),
        "solved alone": (rows["solved"][ratio.index] == "complete").sum(),
    }


def main(arguments: list[str] | None = None) -> int:
    """Print the ratios."""
    parser = options_of(__doc__, quick="every fourth case")
    parser.add_argument("--out", type=Path, help="folder for a CSV file of all cases")
    options = parser.parse_args(arguments)

    rows = table(options.quick)
    print(summary(rows).to_string(float_format="{:.2f}".format))
    write_csv(rows, options.out, "joint")
    return 0


if __name__ == "__main__":
    sys.exit(main())
