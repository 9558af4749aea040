"""One row of the comparison: fit, judge, free run, time and memory."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np

from ...exceptions import SimulationError
from ...regression.errors import nrmse
from .data import Part, Ruler

COLUMNS = [
    "terms", "precision", "recall", "mass_error", "restoring_force_error", "balance_error", "free_run_error",
    "third_law_gap", "storeys_found", "seconds", "megabytes", "note",
]  # fmt: skip
_MOST_WORK = 2e11  # multiplications of a fit, some ten seconds


def row_of(
    entry: Any, search: Part, rest: Part, ruler: Ruler, free_run: int, time_limit: float
) -> tuple[list[Any], np.ndarray | None]:
    """The row of one model (see ``COLUMNS``), and the storey forces (N) it finds on the held-out part."""
    if entry.work(search) > _MOST_WORK:
        size = entry.n_features(search)
        gigabytes = 32e-9 * size * (len(search.a) + size)
        note = f"not run: {size} columns of {len(search.a)} samples take minutes and {gigabytes:.1f} GB"
        return [np.nan] * 8 + ["", np.nan, np.nan, note], None
    start = time.perf_counter()
    entry.fit(search)
    seconds = time.perf_counter() - start
    megabytes = _peak(lambda: entry.fit(search))
    masses = entry.masses(search)
    handed = masses if entry.finds_masses else ruler.model.masses
    a_hat = entry.accelerations(rest)
    R = np.cumsum((rest.F - handed * a_hat)[:, ::-1], axis=1)[:, ::-1]
    precision, recall = (
        entry.hits(search, ruler.model) if ruler.known and not ruler.model.has_memory else (np.nan, np.nan)
    )
    run, note = _free_run(entry, rest.part(slice(0, max(2, free_run))), time_limit)
    gap, found = entry.third_law(ruler.model.masses)
    return [
        entry.terms,
        precision,
        recall,
        float(np.max(np.abs(100 * (masses / ruler.model.masses - 1)))) if ruler.known else np.nan,
        ruler.force_error(R) if ruler.known else np.nan,
        ruler.balance_error(handed, a_hat, rest),
        run,
        gap,
        found,
        seconds,
        megabytes,
        "; ".join(filter(None, (entry.note, note))),
    ], R


def _peak(work: Callable[[], Any]) -> float:
    """Peak memory of a piece of work, MB."""
    running = tracemalloc.is_tracing()
    if not running:
        tracemalloc.start()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    work()
    peak = tracemalloc.get_traced_memory()[1] - before
    if not running:
        tracemalloc.stop()
    return peak / 1e6


def _free_run(entry: Any, rest: Part, time_limit: float) -> tuple[float, str]:
    try:
        x = entry.run(rest, time.perf_counter() + time_limit)
    except TimeoutError:
        return np.nan, f"free run given up after {time_limit:g} s"
    except (SimulationError, OverflowError, FloatingPointError):
        return np.inf, "free run diverges"
    if not np.isfinite(x).all():
        return np.inf, "free run diverges"
    share = [nrmse(rest.x[:, j], x[:, j]) for j in range(rest.n_dof)]
    return float(np.sqrt(np.mean(np.square(share)))), ""
