"""Which terms are kept on a noisy Duffing chain, chosen by held-out error?

    python benchmarks/sparse_selection.py --quick
    python benchmarks/sparse_selection.py --seeds 20

Four masses, one of them forced, 2 % white noise on every channel (forces too), channels
fused; damping at least 1 % of every storey's force. True terms: v, s, s^3 of every
storey. Plain SINDy on the same noisy channels beside them: with its defaults, with
normalised columns, and steered by hand.
"""

from __future__ import annotations

import time
from itertools import product

import search_path
import chains
import numpy as np
import pandas as pd
from harness import options_of, quietly

from pysindy_nrf import ChainModel, Record, compare_with_sindy, laws
from pysindy_nrf.selection import select_sparsity
from pysindy_nrf.simulation.noise import add_noise

N = 4
TRUE = ("v", "s", "s^3")
NOISE = 0.02
LEAST_DAMPING = 0.0102  # share of every storey's force
RIVALS = ("SINDy, defaults", "SINDy, normalised", "SINDy, hand-steered")


def draw(
    seed: int, n_samples: int, noise: float = NOISE, n: int = N
) -> tuple[Record, ChainModel, float]:
    """A noisy record of a chain, the truth, and the least share of the damping."""
    m, c, k, k3 = chains.parameters(n, np.random.default_rng(seed))
    for _ in range(5):
        forced = [1 + seed % n]
        case = chains.duffing(
            n, forced, seed=seed, n_samples=n_samples, parameters_of_chain=(m, c, k, k3)
        )
        share = case.c * case.v.std(axis=0) / case.storey_forces.std(axis=0)
        if share.min() > LEAST_DAMPING:
            break
        c = c * np.maximum(1.0, 0.011 / share)

    storeys = {}
    for i in range(n):
        duffing = laws.Duffing(k[i], k3[i])
        storeys[i + 1] = [laws.LinearViscous(case.c[i]), duffing]
    record = case.record()
    if noise:
        record = add_noise(record, noise, random_state=seed)
    return record, ChainModel(m, storeys), float(share.min())


def rows(seed: int, n: int, n_samples: int) -> list[dict]:
    """One row for the terms selected, and for each SINDy."""
    record, truth, share = draw(seed, n_samples, n=n)
    X, F = record.to_features()
    rivals = compare_with_sindy(X, F, record.dt, truth=truth, free_run=2, optimizers={})
    outcomes = [
        selected(record, n),
        *(rival(name, rivals.loc[name]) for name in RIVALS),
    ]
    return [{"seed": seed, **row, "least damping %": 100 * share} for row in outcomes]


def selected(record: Record, n: int) -> dict:
    """The terms that held-out error selects."""
    began = time.perf_counter()
    selection = select_sparsity(record)
    seconds = time.perf_counter() - began

    chosen = {term for term, coefficient in selection.terms.items() if coefficient}
    storeys = [f"storey {i}" for i in range(1, n + 1)]
    true = set(product(storeys, TRUE))
    return {
        "model": "terms selected",
        "missing": len(true - chosen),
        "false": len(chosen - true),
        "exact": chosen == true,
        "error %": selection.table["error"].iloc[-1],
        "seconds": seconds,
    }


def rival(name: str, row: pd.Series) -> dict:
    """The terms of a SINDy, from their precision and recall."""
    right = row.precision * row.terms
    missing = round(right / row.recall - right) if row.recall else np.nan
    return {
        "model": name,
        "missing": missing,
        "false": round(row.terms - right),
        "exact": row.precision == row.recall == 1,
        "error %": row.balance_error,
        "seconds": row.seconds,
    }


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Over the seeds: exactly the true terms, at most one false one, the worst."""
    nearly = (table["missing"] == 0) & (table["false"] <= 1)
    grouped = table.assign(nearly=nearly).groupby("model", sort=False)
    return pd.DataFrame(
        {
            "cases": grouped.size(),
            "exact": grouped["exact"].sum(),
            "all true, at most one false": grouped["nearly"].sum(),
            "most missing": grouped["missing"].max(),
            "most false": grouped["false"].max(),
            "median balance error %": grouped["error %"].median().round(2),
        }
    )


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print the selections that are not exact, and the summary."""
    parser = options_of(__doc__, quick="one record of three masses")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--start", type=int, default=0)
    options = parser.parse_args(arguments)
    n_seeds = 1 if options.quick else options.seeds
    size = (3, 4000) if options.quick else (N, 16000)

    outcomes = []
    for seed in range(options.start, options.start + n_seeds):
        outcomes += quietly(rows, seed, *size)
    table = pd.DataFrame(outcomes)

    ours = table["model"] == "terms selected"
    print(table[ours & ~table["exact"]].to_string(index=False))
    print(summary(table).to_string())
    return table


if __name__ == "__main__":
    main()
