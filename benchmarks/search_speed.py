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
from collections.abc import Callable

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
from pysindy_nrf.discrepancy.catalogue import candidates, default_catalogue
from pysindy_nrf.discrepancy.prepare import Workspace, prepare
from pysindy_nrf.discrepancy.ruler import Ruler, Trial
from pysindy_nrf.discrepancy.search import Search, lines_at, proposals_of
from pysindy_nrf.discrepancy.state import Axes, Proposal, State
from pysindy_nrf.discrepancy.windows import Windows, split, window_length

LEAST_RATIO = 20.0
FS = 1000.0  # Hz

Candidate = tuple[Site, laws.ForceLaw]


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


def state_of(test: Record) -> State:
    """The linear chain on all of a record but what is held out."""
    ready = prepare(test)
    data = ready.data
    problem = NRFRegressor(degree=1).problem(data.n_dof)
    length = window_length(data.segments)
    work = Workspace(data, *split(data.segments, length), {})
    ruler = Ruler(work, Windows(data, work.search, length))
    ruler = ruler.find_bands([(problem.chain, problem.laws)])
    return State(Trial(ruler, problem.chain, problem.laws), ready=ready)


# -- the loop's screening ------------------------------------------------------


def scan(state: State, proposals: list[Proposal]) -> list:
    """Every candidate at the best point of its scan, without refinement; best first."""
    search = Search(proposals)
    scanned = [search._scanned(state, proposal, state) for proposal in proposals]
    found = [result for result in scanned if result is not None]
    return sorted(found, key=lambda result: -result.screen)


# -- refitting -----------------------------------------------------------------


def points_of_scans(state: State, proposals: list[Proposal]) -> list[Candidate]:
    """Every law with every point of its scan."""
    points = []
    for proposal in proposals:
        axes = Axes(proposal.law, state.trial.ruler.work, proposal.sites)
        lines = []
        if any(shape.is_frequency for shape in axes.shapes):
            lines = lines_at(state.trial, proposal)
        for values in axes.grid(lines):
            points.append((proposal.sites[0], axes.at(values)[0]))
    return points


def searched(state: State, rows_of: Callable[[list[int]], np.ndarray]) -> np.ndarray:
    """Rows of arrays along the record that the search may see."""
    pieces = []
    for block in state.trial.ruler.work.search:
        pieces.append(np.asarray(rows_of([block.segment]))[:, block.rows])
    return np.hstack(pieces)


def columns_of(state: State, site: Site, group: list[laws.ForceLaw]) -> np.ndarray:
    """Columns of laws at a site, as rows."""
    work = state.trial.ruler.work
    return searched(state, lambda segments: work.columns(site, group, segments))


def baseline_design(state: State) -> list[tuple[Site | None, np.ndarray]]:
    """Inertias of all DOFs, then the columns of each storey."""
    work = state.trial.ruler.work
    groups: list[tuple[Site | None, np.ndarray]] = []
    groups.append((None, searched(state, work.fixed)[: work.n_dof]))
    for site in state.trial.layout.acting:
        groups.append((site, columns_of(state, site, state.trial.laws[site])))
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


def refit(state: State, points: list[Candidate]) -> tuple[float, tuple[str, str]]:
    """Seconds of one lstsq for every point, and the best law and site."""
    work = state.trial.ruler.work
    target = searched(state, work.fixed)[work.n_dof :].ravel()
    best = np.inf
    winner = ("", "")
    start = time.perf_counter()
    for site, law in points:
        groups = baseline_design(state)
        matrix = design(groups, site, columns_of(state, site, [law]))
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
    chain = state.trial.chain
    every = list(candidates(default_catalogue(), chain, {}, (), range(1, n + 1)))
    proposals = proposals_of(every, chain.sites)
    # one law at one site
    proposals = [proposal for proposal in proposals if len(proposal.sites) == 1]
    scan(state, proposals)  # compiles

    state = state_of(test)
    start = time.perf_counter()
    found = scan(state, proposals)
    fast = time.perf_counter() - start
    scanned = {result.proposal for result in found}
    scanned_proposals = [proposal for proposal in proposals if proposal in scanned]
    points = points_of_scans(state, scanned_proposals)
    slow, winner = refit(state, points)

    rows = [block.rows for block in state.trial.ruler.work.search]
    n_searched = sum(block.stop - block.start for block in rows)
    n_laws = len({law.name for law, _ in every})
    ratio = slow / fast
    target = judged(f"target at least {LEAST_RATIO:g}", "", ratio >= LEAST_RATIO)
    print(
        f"{n} DOFs, {n_samples} samples ({n_searched} searched): {n_laws} laws,"
        f" {len(every)} candidates, {len(points)} trials"
    )
    print(
        f"search, the chain solved again on Gram matrices: {fast:.2f} s; best:"
        f" {found[0].proposal.name}"
    )
    print(
        f"numpy.linalg.lstsq on the full design matrix: {slow:.2f} s; best:"
        f" {' at '.join(winner)}"
    )
    print(f"ratio {ratio:.0f} ({target.asked}): {target.verdict}")
    site = str(found[0].proposal.sites[0])
    return {"ratio": ratio, "trials": len(points), "site": site, "winner": winner}


if __name__ == "__main__":
    main()
