"""Which degree is chosen for cubic and linear chains, and what the choice costs.

    python benchmarks/order_selection.py [--quick] [--seeds N] [--all]

Each chain (random masses, dampings, stiffnesses; motion by an own Runge-Kutta rule) is
measured with white noise of 0 or 2 % of each channel's rms on forces, accelerations,
velocities and displacements, fused by ``Record.to_features(smooth=True)`` and given to
``GridSearchCV(NRFRegressor(), {"degree": range(1, 8)}, cv=BlockedTimeSplit(5),
refit=one_standard_error)``. Exit code 1 if a seed is missed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial

import search_path
import chains
import numpy as np
import pandas as pd
from harness import markdown, options_of, quietly, times_in_turns
from scipy.interpolate import make_interp_spline
from sklearn.model_selection import GridSearchCV
from tqdm import tqdm

from pysindy_nrf import (
    BlockedTimeSplit,
    NRFRegressor,
    Record,
    one_standard_error,
    scorers,
    select_order,
)

DEGREES = range(1, 8)
DT = 1e-3  # s
SUBSTEPS = 4
NOISES = (0.0, 0.02)
# DOFs, those forced, samples
SETUPS = {
    "4 storeys, DOF 3 forced": (4, [3], 4000),
    "3 storeys, all forced": (3, [1, 2, 3], 3000),
}
# judged against the true degree
JUDGED = ("one standard error, R2", "the same, balance", "select_order")


def motions(
    n: int, forced: list[int], n_samples: int, cubic: bool, seeds: range
) -> Iterator[dict[str, np.ndarray]]:
    """Forces and motions of one chain for each seed, integrated as one batch."""
    rngs = [np.random.default_rng(1000 + seed) for seed in seeds]
    drawn = [chains.parameters(n, rng, cubic) for rng in rngs]
    parameters = [np.stack(values) for values in zip(*drawn)]
    F = np.zeros((n_samples, len(rngs), n))
    for i, rng in enumerate(rngs):
        for dof in forced:
            F[:, i, dof - 1] = chains.band_limited(n_samples, DT, rng)

    # forces are straight between the samples
    fine = np.arange((n_samples - 1) * SUBSTEPS + 1) / SUBSTEPS
    forces = make_interp_spline(np.arange(n_samples), F, k=1)(fine)
    motion = chains.integrate(*parameters, forces, DT / SUBSTEPS)
    a, v, s = motion[:, ::SUBSTEPS]
    for i in range(len(rngs)):
        yield {
            "force": F[:, i],
            "acceleration": a[:, i],
            "velocity": v[:, i].cumsum(axis=1),
            "displacement": s[:, i].cumsum(axis=1),
        }


def measured(channels: dict[str, np.ndarray], noise: float, seed: int):
    """Fused features and forces of one noisy record."""
    rng = np.random.default_rng(seed)
    noisy = {}
    for kind, y in channels.items():
        sigma = noise * np.sqrt((y**2).mean(axis=0))
        noisy[kind] = y + sigma * rng.standard_normal(y.shape)
    return Record(fs=1.0 / DT, **noisy).to_features(smooth=True)


def choices(X: pd.DataFrame, F: pd.DataFrame) -> dict[str, int]:
    """Degree chosen by each way of asking."""
    search = GridSearchCV(
        NRFRegressor(),
        {"degree": DEGREES},
        cv=BlockedTimeSplit(5),
        scoring={"R2": scorers.acceleration, "balance": scorers.balance},
        refit=partial(one_standard_error, metric="R2"),
    )
    results = search.fit(X, F).cv_results_
    balance = one_standard_error(results, metric="balance")
    best = int(np.argmin(results["rank_test_R2"]))
    return {
        "one standard error, R2": search.best_params_["degree"],
        "the same, balance": DEGREES[balance],
        "select_order": select_order(X, F, degrees=DEGREES).best_order,
        "best R2 alone": DEGREES[best],
    }


def chosen(setup: tuple, cubic: bool, noise: float, seeds: range) -> pd.DataFrame:
    """The choices, one row a seed."""
    records = motions(*setup, cubic, seeds)
    rows = []
    for seed, channels in zip(tqdm(seeds, leave=False, disable=None), records):
        rows.append(choices(*measured(channels, noise, seed)))
    return pd.DataFrame(rows, index=list(seeds))


def counted(setups: dict[str, tuple], seeds: range) -> tuple[pd.DataFrame, int]:
    """Seeds with the right choice, and how many were missed in all."""
    rows = []
    missed = 0
    for name, setup in setups.items():
        for truth in (3, 1):
            for noise in NOISES:
                degrees = quietly(chosen, setup, truth == 3, noise, seeds)
                wrong = degrees.ne(truth)
                missed += int(wrong[list(JUDGED)].sum(axis=None))
                row = {"chain": name, "noise": f"{noise:.0%}", "true degree": truth}
                for way, n_wrong in wrong.sum().items():
                    row[way] = f"{len(seeds) - n_wrong} of {len(seeds)}"
                rows.append(row)
                print_missed(degrees, truth)
    return pd.DataFrame(rows), missed


def print_missed(degrees: pd.DataFrame, truth: int) -> None:
    """The seeds that were missed, to standard error."""
    for way in JUDGED:
        wrong = degrees[way][degrees[way] != truth]
        if len(wrong):
            cases = ", ".join(
                f"seed {seed}: {degree}" for seed, degree in wrong.items()
            )
            print(f"  missed by {way}: {cases}", file=sys.stderr)


def cost(n_samples: int) -> pd.DataFrame:
    """One pass against the search over the estimator: time and agreement."""
    case = chains.duffing(4, [3], seed=1, n_samples=n_samples)
    X = case.noisy(0.02)
    search = GridSearchCV(NRFRegressor(), {"degree": DEGREES}, cv=5)
    ask = partial(select_order, degrees=DEGREES, scoring="acceleration")
    one_pass = ask(X, case.F)
    results = search.fit(X, case.F).cv_results_
    contenders = {
        "one pass": lambda: ask(X, case.F),
        "search": lambda: search.fit(X, case.F),
    }
    times = times_in_turns(contenders, 3)

    scores = [results[f"split{fold}_test_score"] for fold in range(5)]
    gap = np.abs(np.column_stack(scores) - one_pass.fold_scores.to_numpy()).max()
    quick = np.median(times["one pass"])
    slow = np.median(times["search"])
    row = {
        "select_order, CPU s": f"{quick:.3f}",
        "GridSearchCV, CPU s": f"{slow:.2f}",
        "times faster": f"{slow / quick:.1f}",
        "largest difference of scores": f"{gap:.1e}",
    }
    return pd.DataFrame([row])


def main(arguments: list[str] | None = None) -> int:
    """Print the tables; the exit code says whether a seed was missed."""
    parser = options_of(__doc__, quick="two seeds, fewer samples for the cost")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument(
        "--all", action="store_true", help="every kind of chain, not the first alone"
    )
    options = parser.parse_args(arguments)
    seeds = range(min(options.seeds, 2) if options.quick else options.seeds)
    setups = SETUPS
    if not options.all:
        first = next(iter(SETUPS))
        setups = {first: SETUPS[first]}

    table, missed = counted(setups, seeds)
    print(f"## Degree chosen, seeds right of seeds tried\n\n{markdown(table)}")
    n_samples = 20_000 if options.quick else 100_000
    costs = quietly(cost, n_samples)
    print(f"\n## Degrees 1-7, 5 folds, n = 4, {n_samples:.0e} samples\n")
    print(markdown(costs))
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
