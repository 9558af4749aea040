"""How fast the search is beside refitting the full design matrix.

    python benchmarks/search_speed.py           # 4 DOFs, 16 384 samples: a minute
    python benchmarks/search_speed.py --quick   # 3 DOFs, 2048 samples

The whole catalogue over all sites. Both sides start from the same motions and try the
same laws at the same sites with the same shape parameters, columns included. The refit
stacks the balances of all DOFs into one matrix ``[m | c, k of every storey |
candidate]`` and calls ``numpy.linalg.lstsq``, as a hand-written scan would; the loop's
own screening solves the chain again on Gram matrices.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import search_path
import numpy as np
from harness import judged, options_of

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    Site,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.discrepancy.band_search import find_bands
from pysindy_nrf.discrepancy.candidate_search import scan, scan_points
from pysindy_nrf.discrepancy.catalogue import (
    Experiment,
    candidates,
    default_catalogue,
)
from pysindy_nrf.discrepancy.effects import Candidate, Finding, SearchState
from pysindy_nrf.discrepancy.fitted_model import fit_model
from pysindy_nrf.discrepancy.folds import split, window_length
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.search_data import SearchData
from pysindy_nrf.discrepancy.spectra import BalanceSpectra
from pysindy_nrf.discrepancy.windows import Windows

LEAST_RATIO = 20.0
FS = 1000.0  # Hz

PlacedLaw = tuple[Site, laws.ForceLaw]
RowsOf = Callable[[list[int]], Sequence[np.ndarray] | np.ndarray]


def record(n: int, n_samples: int, seed: int = 0) -> Record:
    """A chain with friction in the second storey, forced at every DOF."""
    rng = np.random.default_rng(seed)
    masses = rng.uniform(8.0, 14.0, n)
    storeys: dict[str, list[laws.ForceLaw]] = {}
    for i, k in enumerate(rng.uniform(3e4, 6e4, n), 1):
        storeys[f"storey {i}"] = [laws.LinearElastic(k), laws.LinearViscous(40.0)]
    storeys["storey 2"].append(laws.CoulombFriction(8.0))
    F = excitation.band_limited_random(
        n,
        n_samples / FS,
        FS,
        excited=range(1, n + 1),
        rms=60.0,
        band=(1, 40),
        random_state=seed,
    )
    return simulate(ChainModel(masses, storeys), F, 1 / FS)


def state_of(test: Record) -> SearchState:
    """The linear chain on all of a record but what is held out."""
    records = prepare(test)
    dataset = records.data
    problem = NRFRegressor(degree=1).problem(dataset.n_dof)
    length = window_length(dataset.segments)
    data = SearchData(dataset, split(dataset.segments, length), {})

    windows = Windows(dataset, data.search, length)
    spectra = BalanceSpectra(data, windows)
    bands = find_bands(spectra, problem.chain, [problem.laws])
    spectra = BalanceSpectra(data, windows.up_to(bands.n_bands - 1), bands)
    return SearchState(fit_model(spectra, problem.chain, problem.laws), (), records)


# -- the loop's screening ------------------------------------------------------


def scan_all(state: SearchState, tried: list[Candidate]) -> list[Finding]:
    """Every candidate at the best point of its scan, without refinement; best first."""
    scanned = [scan(state, candidate, state) for candidate in tried]
    findings = [finding for finding in scanned if finding is not None]
    return sorted(findings, key=lambda finding: -finding.screened)


# -- refitting -----------------------------------------------------------------


def points_of_scans(state: SearchState, findings: list[Finding]) -> list[PlacedLaw]:
    """The law of every finding at every point of its scan."""
    points = []
    for finding in findings:
        candidate = finding.candidate
        for (law,) in scan_points(state.model, candidate):
            points.append((candidate.sites[0], law))
    return points


def searched(data: SearchData, rows_of: RowsOf) -> np.ndarray:
    """Rows of arrays along the record that the search may see."""
    pieces = []
    for block in data.search:
        pieces.append(np.asarray(rows_of([block.segment]))[:, block.rows])
    return np.hstack(pieces)


def columns_of(
    data: SearchData, site: Site, group: Sequence[laws.ForceLaw]
) -> np.ndarray:
    """Columns of laws at a site, as rows."""
    return searched(data, lambda segments: data.columns(site, group, segments))


def baseline_design(state: SearchState) -> list[tuple[Site | None, np.ndarray]]:
    """Inertias of all DOFs, then the columns of each storey."""
    model = state.model
    data = model.spectra.data
    groups: list[tuple[Site | None, np.ndarray]] = []
    groups.append((None, searched(data, data.fixed)[: data.n_dof]))
    for site in model.layout.acting:
        groups.append((site, columns_of(data, site, model.laws[site])))
    return groups


def design(
    groups: list[tuple[Site | None, np.ndarray]], site: Site, columns: np.ndarray
) -> np.ndarray:
    """The stacked matrix of all balances with the columns of a candidate.

    Its shape is (n_dof * n_samples, n_dof + n_terms).
    """
    inertias = groups[0][1]
    n, size = inertias.shape
    storeys = [*groups[1:], (site, columns)]
    n_terms = sum(len(values) for _, values in storeys)
    matrix = np.zeros((n * size, n + n_terms))
    for j in range(n):
        rows = slice(j * size, (j + 1) * size)
        matrix[rows, j] = inertias[j]
        first = n
        for place, values in storeys:
            sign = place.incidence(j + 1)
            if sign:
                matrix[rows, first : first + len(values)] = sign * values.T
            first += len(values)
    return matrix


def refit(state: SearchState, points: list[PlacedLaw]) -> tuple[float, tuple[str, str]]:
    """Seconds of one lstsq for every point, and the best law and site."""
    data = state.model.spectra.data
    target = searched(data, data.fixed)[data.n_dof :].ravel()
    best = np.inf
    winner = ("", "")
    start = time.perf_counter()
    for site, law in points:
        groups = baseline_design(state)
        matrix = design(groups, site, columns_of(data, site, [law]))
        scale = np.sqrt(np.mean(matrix**2, axis=0))
        scale[scale == 0] = 1.0
        matrix /= scale
        residual = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
        error = float(np.sqrt(np.mean(residual**2)))
        if error < best:
            best = error
            winner = (law.family, str(site))
    return time.perf_counter() - start, winner


def main(arguments: list[str] | None = None) -> dict:
    """Print both times and their ratio."""
    parser = options_of(__doc__, quick="3 DOFs, 2048 samples")
    options = parser.parse_args(arguments)
    n, n_samples = (3, 2048) if options.quick else (4, 16384)
    test = record(n, n_samples)
    state = state_of(test)
    forced = tuple(range(1, n + 1))
    experiment = Experiment(default_catalogue(), state.model.chain, forced=forced)
    every = list(candidates(experiment))
    scan_all(state, every)  # compiles

    state = state_of(test)
    start = time.perf_counter()
    findings = scan_all(state, every)
    fast = time.perf_counter() - start
    points = points_of_scans(state, findings)
    slow, winner = refit(state, points)

    rows = [block.rows for block in state.model.spectra.data.search]
    n_searched = sum(block.stop - block.start for block in rows)
    n_laws = len({candidate.law.name for candidate in every})
    best = findings[0].candidate
    ratio = slow / fast
    target = judged(f"target at least {LEAST_RATIO:g}", "", ratio >= LEAST_RATIO)
    print(
        f"{n} DOFs, {n_samples} samples ({n_searched} searched): {n_laws} laws,"
        f" {len(every)} candidates, {len(points)} trials"
    )
    print(
        f"search, the chain solved again on Gram matrices: {fast:.2f} s; best:"
        f" {best.name}"
    )
    print(
        f"numpy.linalg.lstsq on the full design matrix: {slow:.2f} s; best:"
        f" {' at '.join(winner)}"
    )
    print(f"ratio {ratio:.0f} ({target.asked}): {target.verdict}")
    return {
        "fast": fast,
        "slow": slow,
        "ratio": ratio,
        "trials": len(points),
        "site": str(best.sites[0]),
        "winner": winner,
    }


if __name__ == "__main__":
    main()
