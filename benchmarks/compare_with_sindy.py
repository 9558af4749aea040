"""Plain SINDy and this package on one Duffing chain, clean and noisy.

    python benchmarks/compare_with_sindy.py --quick
    python benchmarks/compare_with_sindy.py --seed 3

Four masses, one of them forced, damping at least 1 % of every storey's force; noise is
white, a share of each channel's rms, on every channel, forces too. The noisy record is
fused; all rows see the same channels. The terms of this package are chosen by the
held-out rule within the first 70 % of the record, all errors are measured on the rest.
SINDy is handed the true masses where an error is in newtons.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
sys.path.insert(0, str(Path(__file__).parent))

import pandas as pd  # noqa: E402
from sparse_selection import draw  # noqa: E402

from pysindy_nrf import compare_with_sindy  # noqa: E402


def rows(
    seed: int, noise: float, n_samples: int, free_run: int, n_dof: int = 4
) -> pd.DataFrame:
    """The table of :func:`pysindy_nrf.compare_with_sindy` for one chain."""
    record, truth, _ = draw(seed, n_samples, noise, n_dof)
    X, F = record.to_features(smooth=noise > 0)
    return compare_with_sindy(
        X, F, record.dt, truth=truth, optimizers="select", free_run=free_run
    )


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="two masses, a short record"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=16000)
    parser.add_argument(
        "--noise", type=float, default=0.02, help="share of each channel's rms"
    )
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    quick = {"n_samples": 3000, "free_run": 5, "n_dof": 2}
    size = quick if given.quick else {"n_samples": given.samples, "free_run": 100}
    names = {0.0: "clean", given.noise: f"{100 * given.noise:g} % noise"}
    table = pd.concat(
        {name: rows(given.seed, noise, **size) for noise, name in names.items()},
        names=["data"],
    )
    print(table.round(3).to_string())
    return table


if __name__ == "__main__":
    main()
