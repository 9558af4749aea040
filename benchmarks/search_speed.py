"""How fast the search is: the whole catalogue over all sites, beside refitting the full design matrix.

    python benchmarks/search_speed.py            # 4 DOFs, 16 384 samples: about a minute, nearly all of it the refits
    python benchmarks/search_speed.py --quick    # 3 DOFs, 2048 samples

Both sides start from the same motions and try the same laws at the same sites with the same shape
parameters, columns included. The refit stacks the balances of all DOFs into one matrix
``[m | c, k of every storey | candidate]`` and calls ``numpy.linalg.lstsq``, as a hand-written scan
would; the loop's own screening solves the chain again on Gram matrices.
"""

from __future__ import annotations

import argparse
import os
import time

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402
from pysindy_nrf.discrepancy.splits import split  # noqa: E402
from pysindy_nrf.discrepancy.stage import Stage  # noqa: E402

from pysindy_nrf import ChainModel, NRFRegressor, Record, Site, excitation, laws, simulate  # noqa: E402
from pysindy_nrf.discrepancy.catalogue import candidates, default_catalogue  # noqa: E402
from pysindy_nrf.discrepancy.prepare import prepare  # noqa: E402
from pysindy_nrf.discrepancy.search import grid_of, screen  # noqa: E402
from pysindy_nrf.discrepancy.workspace import Workspace  # noqa: E402

TARGET = 20.0


def record(n: int, samples: int, seed: int = 0) -> Record:
    """A chain of n storeys with friction in the second, forced at every DOF."""
    rng = np.random.default_rng(seed)
    masses = rng.uniform(8.0, 14.0, n)
    stiffness = dict(enumerate(rng.uniform(3e4, 6e4, n), 1))
    parts = {f"storey {i}": [laws.LinearElastic(k), laws.LinearViscous(40.0)] for i, k in stiffness.items()}
    parts["storey 2"] = [*parts["storey 2"], laws.CoulombFriction(8.0)]
    F = excitation.band_limited_random(
        n, samples / 1000.0, 1000.0, dofs=range(1, n + 1), rms=60.0, band=(1, 40), random_state=seed
    )
    return simulate(ChainModel(masses, parts), F, 1e-3)


def stage_of(rec: Record) -> Stage:
    """The linear chain on all of a record but what is held out."""
    data = prepare(rec).data
    search, held = split(data.segments)
    work = Workspace(data, [None], search, held, {}, "auto")
    problem = NRFRegressor(degree=1).problem(data.n_dof)
    return Stage(work, problem.chain, problem.laws)


def design(stage: Stage, site: Site, columns: np.ndarray) -> np.ndarray:
    """The stacked matrix of all balances with the columns of a candidate, shape (n_dof n, n_dof + terms)."""
    work, n = stage.work, stage.work.n_dof
    fixed, size = work.search_fixed, columns.shape[1]
    own = {s: work.search_columns(s, stage.laws[s]) for s in stage.layout.acting}
    width = n + stage.layout.n_terms + len(columns)
    out = np.zeros((n * size, width))
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


def refit(stage: Stage, tried: list) -> tuple[float, tuple[str, str]]:
    """Seconds, and the best law and site, of one lstsq for every trial."""
    n = stage.work.n_dof
    target = stage.work.search_fixed[n:].ravel()
    best, winner = np.inf, ("", "")
    start = time.perf_counter()
    for site, law in tried:
        matrix = design(stage, site, stage.work.search_columns(site, [law]))
        scale = np.sqrt(np.mean(matrix**2, axis=0))
        scale[scale == 0] = 1.0
        left = target - matrix / scale @ np.linalg.lstsq(matrix / scale, target, rcond=None)[0]
        error = float(np.sqrt(np.mean(left**2)))
        if error < best:
            best, winner = error, (law.family, str(site))
    return time.perf_counter() - start, winner


def main(arguments: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="3 DOFs, 2048 samples")
    o = parser.parse_args(arguments)
    n, samples = (3, 2048) if o.quick else (4, 16384)
    rec = record(n, samples)
    every = [c for c in candidates(default_catalogue(), stage_of(rec).chain, {}, (), range(1, n + 1))]
    lines = {Site(f"dof {j}"): [4.0, 9.0, 17.0] for j in range(1, n + 1)}
    screen(stage_of(rec), every, (), lines)  # compiled once
    stage = stage_of(rec)
    start = time.perf_counter()
    found = screen(stage, every, (), lines)
    fast = time.perf_counter() - start
    scanned = {(f.site, f.law.name) for f in found}
    same = [c for c in every if (c.site, c.law.name) in scanned]
    tried = [(c.site, law) for c in same for law in grid_of(stage, c, lines.get(c.site, ()))]
    slow, winner = refit(stage, tried)
    ratio = slow / fast
    names = len({c.law.name for c in every})
    print(
        f"{n} DOFs, {samples} samples ({int(stage.work.sizes.sum())} searched): {names} laws, {len(every)} candidates, "
        f"{len(tried)} trials\n"
        f"search, the chain solved again on Gram matrices: {fast:.2f} s; best: {found[0].law.name} at {found[0].site}\n"
        f"numpy.linalg.lstsq on the full design matrix:    {slow:.2f} s; best: {winner[0]} at {winner[1]}\n"
        f"ratio {ratio:.0f} (target at least {TARGET:g}): {'PASS' if ratio >= TARGET else 'FAIL'}"
    )
    site = str(found[0].site)
    return {"fast": fast, "slow": slow, "ratio": ratio, "trials": len(tried), "site": site, "winner": winner}


if __name__ == "__main__":
    main()
