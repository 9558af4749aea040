"""Free runs as evidence: over windows of about ten periods, each from the measured state."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import NRFError
from ..regression.chain_model import ChainModel
from ..regression.errors import free_run_of
from .constants import PERIODS
from .workspace import Workspace


def free_run_error(model: ChainModel, work: Workspace) -> float:
    """Free-run error of the displacements over held-out windows, percent NRMSE; NaN where the model cannot run."""
    if (model.masses <= 0).any():
        return float("nan")
    top, bottom = np.zeros(model.n_dof), np.zeros(model.n_dof)
    for block in work.held:
        seg = work.data.segments[block.segment]
        if seg.dt is None or np.isnan(seg.F[seg.valid.start]).any():
            return float("nan")
        size = _window(seg, block.rows)
        for start in range(block.rows.start, block.rows.stop - size + 1, size):
            rows = slice(seg.valid.start + start, seg.valid.start + start + size)
            run = _run(model, seg, rows)
            if run is None:
                return float("nan")
            x = np.cumsum(seg.s[rows], axis=1)
            x = x - x.mean(axis=0)
            error = run.displacement - np.cumsum(seg.s[rows], axis=1)
            top += (error**2).sum(axis=0)
            bottom += (x**2).sum(axis=0)
    return float(100.0 * np.sqrt(np.mean(top / bottom))) if (bottom > 0).all() else float("nan")


def _window(seg: Any, rows: slice) -> int:
    """Samples of about ten periods of the first drift, at most the block."""
    s = np.asarray(seg.s[seg.valid][rows], dtype=float)[:, 0]
    crossings = np.count_nonzero(np.diff(np.signbit(s - s.mean())))
    length = rows.stop - rows.start
    return max(8, min(length, int(PERIODS * 2 * length / max(crossings, 1))))


def _run(model: ChainModel, seg: Any, rows: slice) -> Any:
    """A free run, tried again by the other integrator; None where both fail."""
    choices: tuple[dict[str, Any], ...] = ({}, {"method": "newmark"})
    for options in choices:
        try:
            run: Any = free_run_of(model, seg, rows, seg.dt, **options)
        except NRFError:
            continue
        if np.isfinite(run.displacement).all():
            return run
    return None
