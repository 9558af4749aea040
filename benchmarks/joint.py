"""All floors forced: each balance alone (``strategy="complete"``), or all at once (the
default, ``"joint"``)?

    python benchmarks/joint.py [--quick] [--out FOLDER]

Chains of 2 to 6 floors, all forced, channels with 0.5 to 5 % noise, fused; storeys
linear or cubic, a Dahl damper that is declared, or one that is not. Each as it is, with
five times the noise on one floor's motion, and with one force that reads 5 % too much.
The error of a law is that of its force along the true motion, percent, the worst
storey; that of the masses the worst one. ``--quick`` takes every fourth case.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import ChainModel, NRFRegressor, laws
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import NRFWarning
from pysindy_nrf.simulation import free_run
from pysindy_nrf.simulation.excitation import band_limited_random
from pysindy_nrf.simulation.noise import add_noise

LAWS, NOISES = (
    ("linear", "cubic", "Dahl, declared", "Dahl, not declared"),
    (
        0.005,
        0.02,
        0.05,
    ),
)
TESTS = ("all alike", "one floor noisy", "one force wrong")
NOISIER, TOO_MUCH = 5.0, 1.05


def case(test: str, kind: str, n: int, noise: float, seed: int) -> dict[str, Any]:
    """Errors of both strategies on one chain."""
    rng = np.random.default_rng([6, n, seed])
    m, k, c = (
        rng.uniform(8, 14, n),
        rng.uniform(0.6e5, 1.4e5, n),
        rng.uniform(60, 150, n),
    )
    held: dict[str, list[Any]] = {
        f"storey {i + 1}": [laws.PowerSeries(1, [c[i], k[i]])] for i in range(n)
    }
    place, options = f"storey {rng.integers(1, n + 1)}", {"degree": 1}
    if kind == "cubic":
        held[place].append(laws.CubicStiffness(2e10))
        options = {"degree": 3}
    elif kind.startswith("Dahl"):
        held[place].append(laws.Dahl(sigma=2e4, Fd=25.0))
        declared = {place: [laws.PowerSeries(1), laws.Dahl()]}
        options = (
            {"degree": 1, "laws": declared}
            if kind == "Dahl, declared"
            else {"degree": 3}
        )
    truth = ChainModel(m, held)
    forced = range(1, n + 1)
    F = band_limited_random(
        n,
        12.0,
        500.0,
        excited=forced,
        rms=120.0,
        band=(0.5, 40),
        random_state=[6, n, seed],
    )
    record = free_run(truth, F, 1 / 500.0).record
    X0, _ = record.to_features(smooth=False)
    measured, floor = add_noise(record, noise, random_state=seed), rng.integers(n)
    if test == "one floor noisy":
        noisy = add_noise(record, NOISIER * noise, random_state=seed + 1)
        spoiled = {
            name: getattr(measured, name).copy()
            for name in ("acceleration", "displacement")
        }
        for name, values in spoiled.items():
            values[:, floor] = getattr(noisy, name)[:, floor]
        measured = measured.replace(**spoiled)
    elif test == "one force wrong":
        measured = measured.replace(
            force=measured.force * np.where(np.arange(n) == floor, TOO_MUCH, 1.0)
        )
    X, F = measured.to_features()
    force = np.cumsum((record.force - m * record.acceleration)[:, ::-1], axis=1)[
        :, ::-1
    ]
    out: dict[str, Any] = {
        "test": test,
        "law": kind,
        "floors": n,
        "noise (%)": 100 * noise,
        "seed": seed,
    }
    for name, strategy in (("alone", "complete"), ("joint", "auto")):
        with warnings.catch_warnings(action="ignore", category=NRFWarning):
            model = NRFRegressor(strategy=strategy, **options).fit(X, F)
        out["solved"] = model.solve_order_.strategy
        found = model.restoring_force(X0)
        out[f"mass, {name}"] = 100 * np.abs(model.masses_ / m - 1).max()
        out[f"force, {name}"] = max(nrmse(force[:, i], found[:, i]) for i in range(n))
    return out


def table(quick: bool = False) -> pd.DataFrame:
    """All cases."""
    chosen = list(itertools.product(TESTS, range(2), LAWS, (2, 3, 4, 6), NOISES))
    chosen = [(test, kind, n, noise, seed) for test, seed, kind, n, noise in chosen]
    return pd.DataFrame([case(*one) for one in chosen[:: 4 if quick else 1]])


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """By test and law: error alone over error joint (above one: joint is better), and
    the share better and worse.
    """
    out = {}
    for x in ("mass", "force"):
        ratio = rows[f"{x}, alone"] / rows[f"{x}, joint"]
        for names in (["test"], ["test", "law"]):
            for key, r in ratio.groupby([rows[name] for name in names], sort=False):
                out[x, *(key if len(names) > 1 else (*key, "every law"))] = {
                    "cases": len(r),
                    "better (%)": 100 * (r > 1.02).mean(),
                    "worse (%)": 100 * (r < 0.98).mean(),
                    "geometric mean": np.exp(np.log(r).mean()),
                    "least": r.min(),
                    "most": r.max(),
                    "solved alone": (rows["solved"][r.index] == "complete").sum(),
                }
    return pd.DataFrame.from_dict(out, orient="index")


def main(argv: list[str] | None = None) -> int:
    """Print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="every fourth case")
    parser.add_argument("--out", type=Path, help="folder for a CSV file of all cases")
    args = parser.parse_args(argv)
    rows = table(args.quick)
    print(summary(rows).to_string(float_format="{:.2f}".format))
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        rows.to_csv(args.out / "joint.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
