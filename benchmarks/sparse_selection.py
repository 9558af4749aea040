"""Which terms are kept on a noisy Duffing chain, chosen by held-out error?

    python benchmarks/sparse_selection.py --quick
    python benchmarks/sparse_selection.py --seeds 20

Four masses, one of them forced, 2 % white noise on every channel (forces too), channels
fused; damping at least 1 % of every storey's force. True terms: v, s, s^3 of every
storey. Plain SINDy on the same noisy channels beside them: with its defaults, with
normalised columns, and steered by hand.
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
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import chains  # noqa: E402
import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402

from pysindy_nrf import ChainModel, Record, compare_with_sindy, laws  # noqa: E402
from pysindy_nrf.selection import select_sparsity  # noqa: E402
from pysindy_nrf.simulation.noise import add_noise  # noqa: E402

N, TRUE, NOISE = 4, {"v", "s", "s^3"}, 0.02


def draw(seed: int, n_samples: int, noise: float = NOISE, n: int = N):
    """A chain whose damping is at least 1 % of every storey's force, and its noisy
    record.
    """
    rng = np.random.default_rng(seed)
    m, c, k, k3 = chains.parameters(n, rng)
    for _ in range(5):
        case = chains.duffing(
            n, [1 + seed % n], seed=seed, n_samples=n_samples, given=(m, c, k, k3)
        )
        share = case.c * case.v.std(axis=0) / case.storey_forces.std(axis=0)
        if share.min() > 0.0102:
            break
        c = c * np.maximum(1.0, 0.011 / share)
    motion = case.absolute
    a, v, x = np.hsplit(motion, 3)
    rec = Record(
        force=case.F, acceleration=a, velocity=v, displacement=x, fs=1 / case.dt
    )
    truth = ChainModel(
        m,
        {
            i + 1: [laws.LinearViscous(case.c[i]), laws.Duffing(k[i], k3[i])]
            for i in range(n)
        },
    )
    return (
        add_noise(rec, noise, random_state=seed) if noise else rec,
        truth,
        float(share.min()),
    )


def rows(seed: int, n: int, n_samples: int) -> list[dict]:
    """One row for the terms selected, and for each SINDy."""
    rec, truth, share = draw(seed, n_samples, n=n)
    began = time.perf_counter()
    found = select_sparsity(rec)
    seconds = time.perf_counter() - began
    kept = {key for key, c in found.terms.items() if c}
    true = {(f"storey {i}", t) for i in range(1, n + 1) for t in TRUE}
    out = [
        {
            "model": "terms selected",
            "missing": len(true - kept),
            "false": len(kept - true),
            "exact": kept == true,
            "error %": found.table["error"].iloc[-1],
            "least damping %": 100 * share,
            "seconds": seconds,
        }
    ]
    X, F = rec.to_features()
    table = compare_with_sindy(X, F, rec.dt, truth=truth, free_run=2, optimizers={})
    for name in ("SINDy, defaults", "SINDy, normalised", "SINDy, hand-steered"):
        row = table.loc[name]
        right = row.precision * row.terms
        out.append(
            {
                "model": name,
                "missing": round(right / row.recall - right) if row.recall else np.nan,
                "false": round(row.terms - right),
                "exact": row.precision == row.recall == 1,
                "error %": row.balance_error,
                "least damping %": 100 * share,
                "seconds": row.seconds,
            }
        )
    return [{"seed": seed, **row} for row in out]


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Over the seeds: how often exactly the true terms are kept, at most one false one,
    and how many at worst.
    """
    grouped = table.groupby("model", sort=False)
    return pd.DataFrame(
        {
            "cases": grouped.size(),
            "exact": grouped["exact"].sum(),
            "all true, at most one false": grouped.apply(
                lambda t: int(((t["missing"] == 0) & (t["false"] <= 1)).sum())
            ),
            "most missing": grouped["missing"].max(),
            "most false": grouped["false"].max(),
            "median balance error %": grouped["error %"].median().round(2),
        }
    )


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="one record of three masses"
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--start", type=int, default=0)
    given = parser.parse_args(arguments)
    seeds = range(given.start, given.start + (1 if given.quick else given.seeds))
    warnings.simplefilter("ignore")
    size = (3, 4000) if given.quick else (N, 16000)
    table = pd.DataFrame([row for seed in seeds for row in rows(seed, *size)])
    print(
        table[~table["exact"] & ~table["model"].str.startswith("SINDy")].to_string(
            index=False
        )
    )
    print(summary(table).to_markdown() if _tabulate() else summary(table).to_string())
    return table


def _tabulate() -> bool:
    from importlib.util import find_spec

    return find_spec("tabulate") is not None


if __name__ == "__main__":
    main()
