"""At which frequencies an unmeasured harmonic force may act, from what the search may see."""

from __future__ import annotations

import numpy as np

from ..mechanics.sites import Site
from ..regression.shape_search import balance_lines, driven_at, driving_frequency, hidden_lines, spectral_lines
from .catalogue import Candidate
from .stage import Stage, Trial


def lines_of(trial: Trial) -> dict[Site, list[float]]:
    """Frequencies to try at each DOF, from what the search may see of the longest record."""
    work = trial.work
    spans = {i: work.data.segments[i].valid for i in work.searched}
    longest = max(spans, key=lambda i: spans[i].stop - spans[i].start)
    seg = work.data.segments[longest]
    if seg.dt is None:
        return {}
    runs = work.runs(longest)
    # a line is as sharp as the record is long: what is held out is zero, not cut away
    inside = np.zeros(seg.n_valid)
    for run in runs:
        inside[run] = 1.0
    whole = slice(runs[0].start, runs[-1].stop)
    rows = (trial.stage.rows(longest) * inside)[:, whole]
    driven = driven_at(seg, max(runs, key=lambda r: r.stop - r.start))
    solution = trial.solve(range(len(work.search)))
    out = {}
    for j in range(1, work.n_dof + 1):
        weighed = j in work.known_masses
        scaled = weighed or j in work.forced
        found = balance_lines(rows, trial.layout, solution, j, seg.dt, scaled, weighed, driven)
        out[Site(f"dof {j}")] = found
    return out


def lines_for(stage: Stage, candidate: Candidate) -> dict[Site, list[float]]:
    """The same for one candidate: nothing unless a frequency is among what it is to be found by."""
    law = candidate.law
    return lines_of(stage.trial()) if any(p.is_frequency and law.shape[p.name] is None for p in law.shapes) else {}


__all__ = ["driving_frequency", "hidden_lines", "lines_for", "lines_of", "spectral_lines"]
