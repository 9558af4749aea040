"""Masses and terms: each optimizer through this package, and in PySINDy by itself.

    python benchmarks/pysindy_table.py --quick
    python benchmarks/pysindy_table.py --short --write  # into the page

Duffing chains of three masses, all DOFs or the roof alone excited, clean and with 2 %
white noise on every channel; the noisy records are fused, unless ``--raw``, and both
sides see the same channels. Ours: ``NRFRegressor``. PySINDy's: what an expert would set
up. For each DOF its acceleration, from the terms of all storeys one by one and the
forces that act, columns and target of rms one, all samples; masses are 1/m of the
forces. Shears: PySINDy's optimizer on the forces above each storey (``ShearSINDy``).
The optimizers have the same paths of settings on all sides; as a share of the force is
not one of the acceleration, each side is shown at the setting that finds the true terms
of the most chains. True terms: v, s, s^3 of the storeys of each balance;
right: no other and no fewer. A mass error is that of the worst mass of a chain, median
over the chains; "none" where a DOF is not excited, so that no force has the coefficient
1/m.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import search_path
import chains
import numpy as np
import pandas as pd
import pysindy as ps
from harness import markdown, options_of, quietly, replace_section
from sklearn.base import clone

from pysindy_nrf import InterstoryPolynomialLibrary, NRFRegressor
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.simulation.noise import add_noise
from pysindy_nrf.sindy import ShearSINDy

N = 3
STOREYS = range(1, N + 1)
DT = 1e-3  # s
TRUE = ("v", "s", "s^3")  # terms of a Duffing storey
TRUE_TERMS = set(product(STOREYS, TRUE))
LEAST_DAMPING = 0.0155  # share of every storey's force
SHARES = (0.003, 0.01, 0.03, 0.1)
ENSEMBLE = "`EnsembleOptimizer(STLSQ(threshold=...), library_ensemble=True)`"
# by name the settings that are tried; "iv" are the instruments of this package
OPTIMIZERS: dict[str, list[Any]] = {
    "least squares": [None],
    "instrumental variables": ["iv"],
    "`STLSQ(threshold=...)`": [ps.STLSQ(threshold=share) for share in SHARES],
    "`SR3(reg_weight_lam=...)`": [
        ps.SR3(reg_weight_lam=share**2 / 2) for share in SHARES
    ],
    "`SSR(kappa=...)`": [ps.SSR(kappa=share**2) for share in SHARES],
    "`FROLS(max_iter=9, kappa=...)`": [
        ps.FROLS(max_iter=9, kappa=share**2) for share in SHARES
    ],
    ENSEMBLE: [
        ps.EnsembleOptimizer(
            ps.STLSQ(threshold=share), library_ensemble=True, n_models=10
        )
        for share in SHARES
    ],
}
SHORT = ("`STLSQ(threshold=...)`", "`SR3(reg_weight_lam=...)`")
EXCITED = {"all DOFs": [1, 2, 3], "roof": [3]}
BEGIN = "<!-- benchmarks/pysindy_table.py -->"
END = "<!-- end -->"
PAGE = search_path.ROOT / "docs" / "coming_from_pysindy.md"

Terms = set[tuple[int, str]]  # storey and term


@dataclass(frozen=True)
class Test:
    """Masses of a chain (kg), its motions and forces as both sides see them."""

    masses: np.ndarray
    X: np.ndarray
    F: np.ndarray
    seed: int


def chain(seed: int, excited: list[int], n_samples: int) -> chains.Case:
    """A chain whose damping is at least 1.5 % of every storey's force."""
    m, c, k, k3 = chains.parameters(N, np.random.default_rng(seed))
    for _ in range(5):
        case = chains.duffing(
            N,
            excited,
            seed=seed,
            n_samples=n_samples,
            parameters_of_chain=(m, c, k, k3),
        )
        share = case.c * case.v.std(axis=0) / case.storey_forces.std(axis=0)
        c = c * np.maximum(1.0, LEAST_DAMPING / share)
    return case


def channels(
    case: chains.Case, noise: float, seed: int, raw: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Motions and forces of a chain, fused where they are noisy."""
    record = case.record()
    if noise:
        record = add_noise(record, noise, random_state=seed)
    X, F = record.to_features(smooth=noise > 0 and not raw)
    return np.asarray(X), np.asarray(F)


# -- both sides: masses and the terms they keep --------------------------------


def ours(X: np.ndarray, F: np.ndarray, optimizer: Any) -> tuple[np.ndarray, Terms]:
    model = NRFRegressor(degree=3, optimizer=optimizer)
    if optimizer == "iv":
        model = NRFRegressor(degree=3, estimation="iv", dt=DT)
    model.fit(X, F)
    terms = set()
    for i in STOREYS:
        coefficients = model.restoring_forces_[i].coefficients
        terms |= {(i, term) for term in coefficients.index[coefficients != 0]}
    return model.masses_, terms


def theirs(X: np.ndarray, F: np.ndarray, optimizer: Any) -> tuple[np.ndarray, Terms]:
    """A term counts for its storey if it is in one of its balances or in another."""
    library = InterstoryPolynomialLibrary(3).fit(X)
    laws = np.asarray(library.transform(X))[:, N:]
    labels = library.get_feature_names()[N:]
    acting = np.flatnonzero(F.any(axis=0))
    columns = np.hstack([laws, F[:, acting]])
    a = X[:, :N]
    size = np.sqrt(np.mean(columns**2, axis=0))
    target = np.sqrt(np.mean(a**2, axis=0))

    masses = np.full(N, np.nan)
    terms = set()
    for j in range(N):
        y = a[:, j] / target[j]
        values = coefficients(optimizer, columns / size, y)
        if j in acting:
            k = len(labels) + list(acting).index(j)
            if values[k]:
                masses[j] = size[k] / (values[k] * target[j])
        for label in np.array(labels)[values[: len(labels)] != 0]:
            terms.add(place(label, j + 1))
    return masses, terms


def shears(X: np.ndarray, F: np.ndarray, optimizer: Any) -> tuple[np.ndarray, Terms]:
    """PySINDy on the forces above each storey."""
    if optimizer is None:
        optimizer = ps.STLSQ(threshold=0.0, alpha=0.0)
    try:
        model = ShearSINDy(3, optimizer).fit(X, F)
    except NRFError:
        return np.full(N, np.nan), set()
    terms = set()
    for i in STOREYS:
        values = model.model_.restoring_forces[i].coefficients
        terms |= {(i, term) for term in values.index[values != 0]}
    return model.masses_, terms


def coefficients(optimizer: Any, A: np.ndarray, y: np.ndarray) -> np.ndarray:
    if optimizer is None:
        return np.linalg.lstsq(A, y)[0]
    return clone(optimizer).fit(A, y[:, None]).coef_[0]


def place(label: str, balance: int) -> tuple[int, str]:
    """Storey and term of a column such as ``"v2 s2^2"``."""
    storey = int(label.split(" ")[0].partition("^")[0][1:])
    term = label.replace(f"v{storey}", "v").replace(f"s{storey}", "s")
    if balance in (storey - 1, storey):
        return storey, term
    return storey, f"{term} in balance {balance}"


# -- the table -----------------------------------------------------------------


def best_setting(side: Callable, settings: list, tests: list[Test]) -> tuple[str, ...]:
    """Worst mass, chains with right terms, wrong terms, at the best setting."""
    scores = []
    for optimizer in settings:
        errors, wrong = [], []
        for test in tests:
            # ensembles draw from NumPy's global state
            np.random.seed(test.seed)
            masses, terms = side(test.X, test.F, optimizer)
            errors.append(100 * np.abs(masses / test.masses - 1).max())
            wrong.append(len(terms ^ TRUE_TERMS))
        scores.append((-wrong.count(0), np.median(wrong), np.median(errors)))
    if not scores:
        return "", "", ""
    negative_right, wrong, error = min(scores)
    return in_words(error), f"{-negative_right} of {len(tests)}", f"{wrong:g}"


def in_words(error: float) -> str:
    """A mass error in percent."""
    if np.isnan(error):
        return "none"
    return "exact" if error < 1e-6 else f"{error:.2g} %"


def comparison(
    names: list[str],
    n_chains: int,
    n_samples: int,
    noises: tuple[float, ...],
    raw: bool,
) -> pd.DataFrame:
    """One line for each optimizer, excitation and noise."""
    tests: dict[tuple[str, float], list[Test]] = {}
    for word, noise in product(EXCITED, noises):
        tests[word, noise] = []
        for seed in range(n_chains):
            case = chain(seed, EXCITED[word], n_samples)
            X, F = channels(case, noise, seed, raw)
            tests[word, noise].append(Test(case.m, X, F, seed))

    lines = []
    for name, word, noise in product(names, EXCITED, noises):
        settings = OPTIMIZERS[name]
        line = {"optimizer": name, "excited": word, "noise": f"{100 * noise:g} %"}
        here = best_setting(ours, settings, tests[word, noise])
        known_to_pysindy = [] if settings == ["iv"] else settings
        there = best_setting(theirs, known_to_pysindy, tests[word, noise])
        above = best_setting(shears, known_to_pysindy, tests[word, noise])
        sides = {"here": here, "PySINDy": there, "shears": above}
        for side, values in sides.items():
            mass, right, wrong = values
            line[f"{side}: worst mass"] = mass
            line[f"{side}: terms right"] = right
            line[f"{side}: terms wrong"] = wrong
        lines.append(line)
    return pd.DataFrame(lines)


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print the table; put it into the page."""
    parser = options_of(__doc__, quick="one short chain")
    parser.add_argument("--write", action="store_true")
    parser.add_argument(
        "--short", action="store_true", help="three noisy chains, three optimizers"
    )
    parser.add_argument("--raw", action="store_true", help="noisy channels as they are")
    options = parser.parse_args(arguments)
    size = (1, 1000, (0.02,)) if options.quick else (6, 6000, (0.0, 0.02))
    names = list(OPTIMIZERS)
    if options.short:
        size = (3, 6000, (0.02,))
        names = ["least squares", *SHORT]
    table = quietly(comparison, names, *size, options.raw)
    print(markdown(table))
    if options.write:
        replace_section(PAGE, BEGIN, END, markdown(table))
    return table


if __name__ == "__main__":
    main()
