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
from pysindy_nrf.discrepancy.catalogue import candidates, default_catalogue  # noqa: E402
from pysindy_nrf.discrepancy.prepare import Workspace, prepare  # noqa: E402
from pysindy_nrf.discrepancy.ruler import Ruler, Trial  # noqa: E402
from pysindy_nrf.discrepancy.search import Search, lines_at, proposals_of  # noqa: E402
from pysindy_nrf.discrepancy.state import Axes, Proposal, State  # noqa: E402
from pysindy_nrf.discrepancy.windows import Windows, split, window_length  # noqa: E402

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


def state_of(rec: Record) -> State:
    """The linear chain on all of a record but what is held out."""
    ready = prepare(rec)
    data, problem = ready.data, NRFRegressor(degree=1).problem(ready.data.n_dof)
    length = window_length(data.segments)
    work = Workspace(data, *split(data.segments, length), {})
    ruler = Ruler(work, Windows(data, work.search, length)).find_bands(
        [(problem.chain, problem.laws)]
    )
    return State(Trial(ruler, problem.chain, problem.laws), ready=ready)


def searched(state: State, rows_of) -> np.ndarray:
    """Rows of arrays along the record that the search may see."""
    work = state.trial.ruler.work
    return np.hstack([np.asarray(rows_of([b.segment]))[:, b.rows] for b in work.search])


def design(state: State, site: Site, columns: np.ndarray) -> np.ndarray:
    """The stacked matrix of all balances with the columns of a candidate, shape (n_dof
    n, n_dof + terms).
    """
    work, trial = state.trial.ruler.work, state.trial
    n, size = work.n_dof, columns.shape[1]
    fixed = searched(state, work.fixed)
    own = {
        s: searched(state, lambda i, s=s: work.columns(s, trial.laws[s], i))
        for s in trial.layout.acting
    }
    out = np.zeros((n * size, n + trial.layout.n_terms + len(columns)))
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


def refit(state: State, tried: list) -> tuple[float, tuple[str, str]]:
    """Seconds, and the best law and site, of one lstsq for every trial."""
    work = state.trial.ruler.work
    target = searched(state, work.fixed)[work.n_dof :].ravel()
    best, winner = np.inf, ("", "")
    start = time.perf_counter()
    for site, law in tried:
        matrix = design(
            state, site, searched(state, lambda i: work.columns(site, [law], i))
        )  # noqa: B023
        scale = np.sqrt(np.mean(matrix**2, axis=0))
        scale[scale == 0] = 1.0
        left = (
            target
            - matrix / scale @ np.linalg.lstsq(matrix / scale, target, rcond=None)[0]
        )
        error = float(np.sqrt(np.mean(left**2)))
        if error < best:
            best, winner = error, (law.family, str(site))
    return time.perf_counter() - start, winner


def trials(state: State, proposals: list[Proposal]) -> list[tuple[Site, laws.ForceLaw]]:
    """Every law with every point of its scan."""
    out = []
    for p in proposals:
        axes = Axes(p.law, state.trial.ruler.work, p.sites)
        lines = (
            lines_at(state.trial, p)
            if any(shape.is_frequency for shape in axes.shapes)
            else ()
        )
        out += [(p.sites[0], axes.at(u)[0]) for u in axes.grid(lines)]
    return out


def main(arguments: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="3 DOFs, 2048 samples")
    o = parser.parse_args(arguments)
    n, samples = (3, 2048) if o.quick else (4, 16384)
    rec = record(n, samples)
    chain = state_of(rec).trial.chain
    every = list(candidates(default_catalogue(), chain, {}, (), range(1, n + 1)))
    proposals = [
        p for p in proposals_of(every, chain.sites) if len(p.sites) == 1
    ]  # one law at one site
    scan(state_of(rec), proposals)  # compiled once
    state = state_of(rec)
    start = time.perf_counter()
    found = scan(state, proposals)
    fast = time.perf_counter() - start
    scanned = {f.proposal for f in found}
    tried = trials(state, [p for p in proposals if p in scanned])
    slow, winner = refit(state, tried)
    ratio = slow / fast
    names, size = (
        len({law.name for law, _ in every}),
        sum(b.rows.stop - b.rows.start for b in state.trial.ruler.work.search),
    )
    best = found[0].proposal
    print(
        f"{n} DOFs, {samples} samples ({size} searched): {names} laws, {len(every)}"
        f" candidates, {len(tried)} trials\nsearch, the chain solved again on Gram"
        f" matrices: {fast:.2f} s; best: {best.name}\nnumpy.linalg.lstsq on the full"
        f" design matrix:    {slow:.2f} s; best: {winner[0]} at {winner[1]}\nratio"
        f" {ratio:.0f} (target at least {TARGET:g}):"
        f" {'PASS' if ratio >= TARGET else 'FAIL'}"
    )
    site = str(best.sites[0])
    return {
        "fast": fast,
        "slow": slow,
        "ratio": ratio,
        "trials": len(tried),
        "site": site,
        "winner": winner,
    }


def scan(state: State, proposals: list[Proposal]) -> list:
    """Every candidate at the best point of its scan, the best first, without
    refinement.
    """
    search = Search(proposals)
    found = [search._scanned(state, p, state) for p in proposals]
    return sorted((f for f in found if f is not None), key=lambda f: -f.screen)


if __name__ == "__main__":
    main()
