"""Coverage of 95 % intervals: 3 chains x noise 0, 0.2, 1, 5 % of each channel's rms, on
every channel and the force.

    python benchmarks/coverage.py --fits 400 --jobs 2      # --quick: 12 fits a cell

Records of 20 s at 500 Hz (10 000 samples), accelerations, displacements and forces; the
laws are known. Of each cell: the share of intervals that hold the truth (masses,
stiffness, damping, cubic term), the share withheld, the median half-width in percent
and the time of a fit with its intervals, by ``estimation`` = "auto" (the default), "ls"
and "iv".
"""

if (
    __name__ != "__main__"
):  # numba looks for the package of this name, also where another benchmark is run
    raise ImportError("a benchmark to be run, not the package 'coverage'")

import argparse
import os
import time
import warnings

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
import pandas as pd  # noqa: E402
from joblib import Parallel, delayed  # noqa: E402

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate  # noqa: E402
from pysindy_nrf.simulation.noise import add_noise  # noqa: E402

FS, DURATION = 500.0, 20.0
NOISE = (0.0, 0.002, 0.01, 0.05)
KINDS = {"m": "mass", ": s": "stiffness", ": v": "damping", ": s^3": "cubic"}


def linear(k: float, c: float) -> list:
    return [laws.LinearElastic(k), laws.LinearViscous(c)]


def chains() -> dict[str, tuple[ChainModel, list[int], dict]]:
    """By name: the truth, the forced DOFs, what the estimator is told."""
    cubic = [laws.PowerSeries((0, 3), [3.5e4, 0.0, 3e9]), laws.LinearViscous(20.0)]
    return {
        "2 DOFs, both forced": (
            ChainModel([10.0, 12.0], {i: linear(1e5, 60.0) for i in (1, 2)}),
            [1, 2],
            {},
        ),
        "3 DOFs, floor 1 forced, cubic storey 2": (
            ChainModel(
                [12.0, 10.0, 8.0],
                {1: linear(4e4, 25.0), 2: cubic, 3: linear(3e4, 15.0)},
            ),
            [1],
            {"laws": {"storey 2": [laws.PowerSeries((0, 3)), laws.LinearViscous()]}},
        ),
        "4 DOFs, floor 3 forced": (
            ChainModel([12.4] * 4, {i: linear(1.4e5, 50.0) for i in (1, 2, 3, 4)}),
            [3],
            {},
        ),
    }


def record(chain: str, noise: float, seed: int) -> Record:
    """A measured record."""
    truth, dofs, _ = chains()[chain]
    F = excitation.band_limited_random(
        truth.n_dof,
        DURATION,
        FS,
        excited=dofs,
        rms=100.0,
        band=(0.5, 30.0),
        random_state=[seed, 3],
    )
    exact = simulate(truth, F, 1 / FS, hold="cubic").replace(velocity=None)
    return add_noise(exact, noise, random_state=[seed, 4]) if noise else exact


def values_of(model: ChainModel) -> dict[str, float]:
    """Parameters by the names that intervals have."""
    out = {f"m{j}": m for j, m in enumerate(model.masses, 1)}
    for site, force in model.restoring_forces.items():
        out |= {f"{site}: {term}": c for term, c in force.coefficients.items()}
    return out


def kind_of(parameter: str) -> str | None:
    """Kind of a parameter; None for those whose truth is zero."""
    return next(
        (
            kind
            for end, kind in KINDS.items()
            if parameter.endswith(end) or parameter[0] == end
        ),
        None,
    )


def one(chain: str, noise: float, estimation: str, seed: int) -> pd.DataFrame:
    """Each interval of one fit: whether it was given, holds the truth, and how wide it
    is.
    """
    warnings.simplefilter("ignore")
    truth, _, told = chains()[chain]
    true, rec = values_of(truth), record(chain, noise, seed)
    began = time.perf_counter()
    model = NRFRegressor(degree=1, estimation=estimation, **told).fit(rec)
    ci = model.confidence_intervals(0.95)
    ci["seconds"] = time.perf_counter() - began
    ci["found"] = model.model_.info["estimation"]["found"]
    ci["kind"] = [kind_of(p) for p in ci["parameter"]]
    ci = ci[ci["kind"].notna()]
    size = ci["parameter"].map(true)
    ci["truth"] = size
    ci["given"] = ci["lower"].notna()
    ci["holds"] = ci["lower"].le(size) & ci["upper"].ge(size)
    ci["width"] = 50 * (ci["upper"] - ci["lower"]) / size.abs()
    ci["off"] = 100 * (ci["estimate"] / size - 1)
    return ci.assign(chain=chain, noise=noise, estimation=estimation, seed=seed)


def table(found: pd.DataFrame) -> pd.DataFrame:
    """Coverage, width, share withheld and time by cell."""
    rows = []
    for (chain, noise, estimation), cell in found.groupby(
        ["chain", "noise", "estimation"], sort=False
    ):
        row = {"chain": chain, "noise %": 100 * noise, "estimation": estimation}
        for kind in dict.fromkeys(cell["kind"]):
            held = cell[(cell["kind"] == kind) & cell["given"]]
            row[kind] = (
                f"{100 * held['holds'].mean():.1f} ({held['width'].median():.2g})"
                if len(held)
                else "withheld"
            )
        first = cell.drop_duplicates("seed")
        row["withheld %"] = round(100 * (~cell["given"]).mean(), 1)
        row["by iv %"] = round(100 * (first["found"] == "iv").mean())
        row["s"] = round(first["seconds"].median(), 2)
        rows.append(row)
    return pd.DataFrame(rows).fillna("")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fits", type=int, default=400)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--estimations", nargs="+", default=["auto", "ls", "iv"])
    parser.add_argument(
        "--chains", default="", help="only chains whose name contains this"
    )
    parser.add_argument("--noise", type=float, nargs="+", default=NOISE)
    parser.add_argument("--save", help="CSV of every interval")
    options = parser.parse_args()
    cells = [
        (chain, noise, estimation)
        for chain in chains()
        if options.chains in chain
        for noise in options.noise
        for estimation in options.estimations
    ]
    every = []
    for cell in cells:
        jobs = (
            delayed(one)(*cell, seed)
            for seed in range(12 if options.quick else options.fits)
        )
        every.append(pd.concat(Parallel(n_jobs=options.jobs)(jobs)))
        print(
            table(every[-1]).to_string(index=False, header=cell is cells[0]), flush=True
        )
        if options.save:
            pd.concat(every).to_csv(options.save, index=False)
    print("\nCoverage in percent (median half-width in percent of the truth)\n")
    final = table(pd.concat(every)).astype(str)
    for row in ([*final], ["---"] * final.shape[1], *final.to_numpy().tolist()):
        print("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
