"""Masses and terms: each optimizer through this package, beside the same optimizer of
PySINDy on all samples.

    python benchmarks/pysindy_table.py --quick
    python benchmarks/pysindy_table.py --write      # the table of docs/coming_from_pysindy.md

Duffing chains of three masses, all DOFs or the roof alone excited, clean and with 2 %
white noise on every channel; the noisy records are fused, unless ``--raw``, and both
sides see the same channels. Ours: ``NRFRegressor``. PySINDy's: what an expert would set
up. For each DOF its acceleration, from the terms of all storeys one by one and the
forces that act, columns and target of rms one, all samples; masses are 1/m of the
forces. The optimizers have the same paths of settings on both sides; as a share of the
force is not one of the acceleration, each side is shown at the setting that finds the
true terms of the most chains. True terms: v, s, s^3 of the storeys of each balance;
right: no other and no fewer. A mass error is that of the worst mass of a chain, median
over the chains; "none" where a DOF is not excited, so that no force has the coefficient
1/m.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from itertools import product
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import chains  # noqa: E402
import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
import pysindy as ps  # noqa: E402
from sklearn.base import clone  # noqa: E402

from pysindy_nrf import InterstoryPolynomialLibrary, NRFRegressor  # noqa: E402
from pysindy_nrf.simulation.noise import add_noise  # noqa: E402

N, TRUE, DT = 3, ("v", "s", "s^3"), 1e-3
SHARES = (0.003, 0.01, 0.03, 0.1)
OPTIMIZERS = {
    "least squares": [None],
    "instrumental variables": ["iv"],
    "`STLSQ(threshold=...)`": [ps.STLSQ(threshold=t) for t in SHARES],
    "`SR3(reg_weight_lam=...)`": [ps.SR3(reg_weight_lam=t**2 / 2) for t in SHARES],
    "`SSR(kappa=...)`": [ps.SSR(kappa=t**2) for t in SHARES],
    "`FROLS(max_iter=9, kappa=...)`": [
        ps.FROLS(max_iter=9, kappa=t**2) for t in SHARES
    ],
    "`EnsembleOptimizer(STLSQ(threshold=...), library_ensemble=True)`": [
        ps.EnsembleOptimizer(ps.STLSQ(threshold=t), library_ensemble=True, n_models=10)
        for t in SHARES
    ],
}
EXCITED = {"all DOFs": [1, 2, 3], "roof": [3]}
START, END = "<!-- benchmarks/pysindy_table.py -->\n", "<!-- end -->"


def chain(seed: int, excited: list[int], n_samples: int):
    """A chain whose damping is at least 1.5 % of every storey's force."""
    m, c, k, k3 = chains.parameters(N, np.random.default_rng(seed))
    for _ in range(5):
        case = chains.duffing(
            N, excited, seed=seed, n_samples=n_samples, given=(m, c, k, k3)
        )
        share = case.c * case.v.std(axis=0) / case.storey_forces.std(axis=0)
        c = c * np.maximum(1.0, 0.0155 / share)
    return case


def ours(X: np.ndarray, F: np.ndarray, optimizer) -> tuple[np.ndarray, set]:
    """Masses, and the terms kept by storey."""
    way = (
        {"estimation": "iv", "dt": DT}
        if optimizer == "iv"
        else {"optimizer": optimizer}
    )
    model = NRFRegressor(degree=3, **way).fit(X, F)
    kept = {
        (i, t)
        for i in range(1, N + 1)
        for t, c in model.restoring_forces_[i].coefficients.items()
        if c
    }
    return model.masses_, kept


def theirs(X: np.ndarray, F: np.ndarray, optimizer) -> tuple[np.ndarray, set]:
    """The same from accelerations; a term counts for its storey if it stands in one of
    its balances or in another.
    """
    library = InterstoryPolynomialLibrary(3).fit(X)
    terms = np.asarray(library.transform(X))[:, N:]
    acting = np.flatnonzero(F.any(axis=0))
    columns, a = np.hstack([terms, F[:, acting]]), X[:, :N]
    size, target = (np.sqrt(np.mean(y**2, axis=0)) for y in (columns, a))
    masses, kept, labels = np.full(N, np.nan), set(), library.get_feature_names()[N:]
    for j in range(N):
        unit, y = columns / size, a[:, j] / target[j]
        fitted = (
            np.linalg.lstsq(unit, y)[0]
            if optimizer is None
            else clone(optimizer).fit(unit, y[:, None]).coef_[0]
        )
        for k, i in enumerate(acting):
            if i == j and fitted[terms.shape[1] + k]:
                masses[j] = size[terms.shape[1] + k] / (
                    fitted[terms.shape[1] + k] * target[j]
                )
        for label, value in zip(labels, fitted):
            if value:
                storey = int(label.split(" ")[0].partition("^")[0][1:])
                name = label.replace(f"v{storey}", "v").replace(f"s{storey}", "s")
                kept.add(
                    (
                        storey,
                        (
                            name
                            if j + 1 in (storey - 1, storey)
                            else f"{name} in balance {j + 1}"
                        ),
                    )
                )
    return masses, kept


def channels(case, noise: float, seed: int, raw: bool) -> tuple[np.ndarray, np.ndarray]:
    """Motion and forces as both sides see them."""
    record = (
        add_noise(case.record(), noise, random_state=seed) if noise else case.record()
    )
    return tuple(
        np.asarray(table) for table in record.to_features(smooth=noise > 0 and not raw)
    )


def rows(
    seeds: int, n_samples: int, noises: tuple[float, ...], raw: bool
) -> pd.DataFrame:
    """One line for each optimizer, excitation and noise."""
    true, lines = {(i, t) for i in range(1, N + 1) for t in TRUE}, []
    held = {}
    for seed in range(seeds):
        for word, dofs in EXCITED.items():
            case = chain(seed, dofs, n_samples)
            held |= {
                (word, noise, seed): (case.m, *channels(case, noise, seed, raw))
                for noise in noises
            }
    for (name, path), word, noise in product(OPTIMIZERS.items(), EXCITED, noises):
        line = {"optimizer": name, "excited": word, "noise": f"{100 * noise:g} %"}
        for side, fit in (("here", ours), ("PySINDy", theirs)):
            found = []
            for optimizer in path if side == "here" or path != ["iv"] else []:
                errors, wrong = [], []
                for seed in range(seeds):
                    m, X, F = held[word, noise, seed]
                    # noqa: NPY002  ensembles draw from NumPy's global state
                    np.random.seed(seed)
                    masses, kept = fit(X, F, optimizer)
                    errors.append(100 * np.abs(masses / m - 1).max())
                    wrong.append(len(kept ^ true))
                found.append((-wrong.count(0), np.median(wrong), np.median(errors)))
            exact, wrong, error = min(found, default=(0, 0, 0))
            shown = (
                "none"
                if np.isnan(error)
                else "exact"
                if error < 1e-6
                else f"{error:.2g} %"
            )
            values = (
                (shown, f"{-exact} of {seeds}", f"{wrong:g}") if found else ("", "", "")
            )
            line |= dict(
                zip(
                    (
                        f"{side}: {what}"
                        for what in ("worst mass", "terms right", "terms wrong")
                    ),
                    values,
                )
            )
        lines.append(line)
    return pd.DataFrame(lines)


def markdown(table: pd.DataFrame) -> str:
    """The table for the page."""
    lines = [list(table.columns), ["---"] * table.shape[1], *table.to_numpy().tolist()]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print the table; put it into the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one short chain")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--raw", action="store_true", help="noisy channels as they are")
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    table = (
        rows(1, 1000, (0.02,), given.raw)
        if given.quick
        else rows(6, 6000, (0.0, 0.02), given.raw)
    )
    print(markdown(table))
    if given.write:
        page = ROOT / "docs" / "coming_from_pysindy.md"
        before, _, rest = page.read_text(encoding="utf-8").partition(START)
        page.write_text(
            f"{before}{START}{markdown(table)}{END}{rest.partition(END)[2]}",
            encoding="utf-8",
        )
    return table


if __name__ == "__main__":
    main()
