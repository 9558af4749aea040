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

import search_path
import pandas as pd
from harness import options_of, quietly
from sparse_selection import draw

from pysindy_nrf import compare_with_sindy


def compared(
    seed: int, noise: float, n_samples: int, free_run: int, n_dof: int
) -> pd.DataFrame:
    """The table of :func:`pysindy_nrf.compare_with_sindy` for one chain."""
    record, truth, _ = draw(seed, n_samples, noise, n_dof)
    X, F = record.to_features(smooth=noise > 0)
    return compare_with_sindy(
        X, F, record.dt, truth=truth, optimizers="select", free_run=free_run
    )


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print both tables."""
    parser = options_of(__doc__, quick="two masses, a short record")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=16000)
    parser.add_argument(
        "--noise", type=float, default=0.02, help="share of each channel's rms"
    )
    options = parser.parse_args(arguments)
    size = (3000, 5, 2) if options.quick else (options.samples, 100, 4)

    tables = {
        "clean": quietly(compared, options.seed, 0.0, *size),
        f"{100 * options.noise:g} % noise": quietly(
            compared, options.seed, options.noise, *size
        ),
    }
    table = pd.concat(tables, names=["data"])
    print(table.round(3).to_string())
    return table


if __name__ == "__main__":
    main()
