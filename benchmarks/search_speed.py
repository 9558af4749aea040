"""How fast the search is: the whole catalogue over all sites, beside refitting the full
design matrix.

    python benchmarks/search_speed.py            # 4 DOFs, 16 384 samples: about a minute, nearly all of it the refits
    python benchmarks/search_speed.py --quick    # 3 DOFs, 2048 samples

Both sides start from the same motions and try the same laws at the same sites with the
same shape parameters, columns included. The refit stacks the balances of all DOFs into
one matrix ``[m | c, k of every storey | candidate]`` and calls ``numpy.linalg.lstsq``,
as a hand-written scan would; the loop's own screening solves the chain again on Gram
matrices.
"""

from __future__ import annotations

import argparse
import os
import time

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402

from pysindy_nrf import (  # noqa: E402
    ChainModel,
    NRFRegressor,
    Record,
    Site,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.discrepancy.band_search import find_bands  # noqa: E402
from pysindy_nrf.discrepancy.candidate_search import scan, scan_points  # noqa: E402
from pysindy_nrf.discrepancy.catalogue import (  # noqa: E402
    Experiment,
    candidates,
    default_catalogue,
)
from pysindy_nrf.discrepancy.effects import (  # noqa: E402
    Candidate,
    Finding,
    SearchState,
)
from pysindy_nrf.discrepancy.fitted_model import fit_model  # noqa: E402
from pysindy_nrf.discrepancy.folds import split, window_length  # noqa: E402
from pysindy_nrf.discrepancy.prepare import prepare  # noqa: E402
from pysindy_nrf.discrepancy.search_data import SearchData  # noqa: E402
from pysindy_nrf.discrepancy.spectra import BalanceSpectra  # noqa: E402
from pysindy_nrf.discrepancy.windows import Windows  # noqa: E402

TARGET = 20.0


def record(n: int, samples: int, seed: int = 0) -> Record:
    """A chain of n storeys with friction in the second, forced at every DOF."""
    rng = np.random.default_rng(seed)
    masses = rng.uniform(8.0, 14.0, n)
    stiffness = dict(enumerate(rng.uniform(3e4, 6e4, n), 1))
    parts = {
        f"storey {i}": [laws.LinearElastic(k), laws.LinearViscous(40.0)]
        for i, k in stiffness.items()
    }
    parts["storey 2"] = [*parts["storey 2"], laws.CoulombFriction(8.0)]
    F = excitation.band_limited_random(
        n,
        samples / 1000.0,
        1000.0,
        excited=range(1, n + 1),
        rms=60.0,
        band=(1, 40),
        random_state=seed,
    )
    return simulate(ChainModel(masses, parts), F, 1e-3)


def state_of(rec: Record) -> SearchState:
    """The linear chain on all of a record but what is held out."""
    records = prepare(rec)
    dataset, problem = records.data, NRFRegressor(degree=1).problem(rec.n_dof)
    length = window_length(dataset.segments)
    data = SearchData(dataset, split(dataset.segments, length), {})
    windows = Windows(dataset, data.search, length)
    spectra = BalanceSpectra(data, windows)
    bands = find_bands(spectra, problem.chain, [problem.laws])
    windows = windows.up_to(bands.n_bands - 1)
    spectra = BalanceSpectra(data, windows, bands)
    return SearchState(fit_model(spectra, problem.chain, problem.laws), (), records)


def searched(state: SearchState, rows_of) -> np.ndarray:
    """Rows of arrays along the record that the search may see."""
    folds = state.model.spectra.data.search
    return np.hstack([np.asarray(rows_of([b.segment]))[:, b.rows] for b in folds])


def columns_of(state: SearchState, site: Site, held) -> np.ndarray:
    """Columns of laws at a site in the rows of the search."""
    data = state.model.spectra.data
    return searched(state, lambda records: data.columns(site, held, records))


def design(state: SearchState, site: Site, columns: np.ndarray) -> np.ndarray:
    """The stacked matrix of all balances with the columns of a candidate, shape (n_dof
    n, n_dof + terms).
    """
    model, data = state.model, state.model.spectra.data
    n, size = data.n_dof, columns.shape[1]
    fixed = searched(state, data.fixed)
    own = {s: columns_of(state, s, model.laws[s]) for s in model.layout.acting}
    out = np.zeros((n * size, n + model.layout.n_terms + len(columns)))
    for j in range(1, n + 1):
        rows, at = slice((j - 1) * size, j * size), n
        out[rows, j - 1] = fixed[j - 1]
        for s, part in own.items():
            if s.incidence(j):
                out[rows, at : at + len(part)] = s.incidence(j) * part.T
            at += len(part)
        if site.incidence(j):
            out[rows, at:] = site.incidence(j) * columns.T
    return out


def refit(state: SearchState, tried: list) -> tuple[float, tuple[str, str]]:
    """Seconds, and the best law and site, of one lstsq for every trial."""
    data = state.model.spectra.data
    target = searched(state, data.fixed)[data.n_dof :].ravel()
    best, winner = np.inf, ("", "")
    start = time.perf_counter()
    for site, law in tried:
        matrix = design(state, site, columns_of(state, site, [law]))
        scale = np.sqrt(np.mean(matrix**2, axis=0))
        scale[scale == 0] = 1.0
        scaled = matrix / scale
        values = np.linalg.lstsq(scaled, target, rcond=None)[0]
        error = float(np.sqrt(np.mean((target - scaled @ values) ** 2)))
        if error < best:
            best, winner = error, (law.family, str(site))
    return time.perf_counter() - start, winner


def trials(state: SearchState, tried: list[Candidate]) -> list:
    """Every law with every point of its scan, and its site."""
    out = []
    for candidate in tried:
        points = scan_points(state.model, candidate)
        out += [(candidate.sites[0], law) for (law,) in points]
    return out


def main(arguments: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="3 DOFs, 2048 samples")
    o = parser.parse_args(arguments)
    n, samples = (3, 2048) if o.quick else (4, 16384)
    rec = record(n, samples)
    chain = state_of(rec).model.chain
    experiment = Experiment(default_catalogue(), chain, (), tuple(range(1, n + 1)))
    every = list(candidates(experiment))
    scan_all(state_of(rec), every)  # compiled once
    state = state_of(rec)
    start = time.perf_counter()
    found = scan_all(state, every)
    fast = time.perf_counter() - start
    tried = trials(state, [finding.candidate for finding in found])
    slow, winner = refit(state, tried)
    ratio = slow / fast
    folds = state.model.spectra.data.search
    size = sum(b.rows.stop - b.rows.start for b in folds)
    names = len({candidate.law.name for candidate in every})
    best = found[0].candidate
    print(
        f"{n} DOFs, {samples} samples ({size} searched): {names} laws, {len(every)}"
        f" candidates, {len(tried)} trials\nsearch, the chain solved again on Gram"
        f" matrices: {fast:.2f} s; best: {best.name}\nnumpy.linalg.lstsq on the full"
        f" design matrix:    {slow:.2f} s; best: {winner[0]} at {winner[1]}\nratio"
        f" {ratio:.0f} (target at least {TARGET:g}):"
        f" {'PASS' if ratio >= TARGET else 'FAIL'}"
    )
    return {
        "fast": fast,
        "slow": slow,
        "ratio": ratio,
        "trials": len(tried),
        "site": str(best.sites[0]),
        "winner": winner,
    }


def scan_all(state: SearchState, tried: list[Candidate]) -> list[Finding]:
    """Every candidate at the best point of its scan, the best first, without
    refinement.
    """
    found = [scan(state, candidate, state) for candidate in tried]
    return sorted((f for f in found if f is not None), key=lambda f: -f.screened)


if __name__ == "__main__":
    main()
