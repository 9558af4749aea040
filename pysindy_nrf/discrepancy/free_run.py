"""Free-run errors: the model alone, under the measured force, from the measured state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..exceptions import NRFError
from ..model import ChainModel
from .splits import BlockRows
from .workspace import Workspace


def free_run_error(model: ChainModel, work: Workspace, blocks: Sequence[BlockRows]) -> float:
    """Free-run error of the displacements on some blocks, percent NRMSE.

    Parameters
    ----------
    model : ChainModel
    work : Workspace
    blocks : sequence of BlockRows
        Each is run from its own first state, internal states at zero.

    Returns
    -------
    float
        Root of the squared errors of all DOFs (each divided by its rms) over their number; NaN where
        no free run is possible (an unknown force, a mass that is not positive, divergence).
    """
    if (model.masses <= 0).any():
        return float("nan")
    top, bottom = np.zeros(model.n_dof), np.zeros(model.n_dof)
    for block in blocks:
        seg = work.data.segments[block.segment]
        start = seg.valid.start
        rows = slice(start + block.rows.start, start + block.rows.stop)
        dt = seg.dt
        if dt is None or np.isnan(seg.F[rows.start]).any() or rows.stop - rows.start < 8:
            return float("nan")
        x = np.cumsum(seg.s[rows], axis=1)
        v0 = np.cumsum(seg.v[rows.start])
        try:
            run = model.simulate(
                seg.F[rows],
                dt,
                x0=x[0],
                v0=v0,
                base_acceleration=None if seg.ag is None else seg.ag[rows],
                covariates={k: c[rows] for k, c in seg.covariates.items()} or None,
            )
        except NRFError:
            return float("nan")
        error = run.displacement - x
        filter = work.filters[block.segment]
        if filter is not None:
            error, x = filter.apply(error), filter.apply(x)
        top += (error**2).sum(axis=0)
        bottom += (x**2).sum(axis=0)
    return float(100.0 * np.sqrt(np.mean(top / bottom))) if (bottom > 0).all() else float("nan")
