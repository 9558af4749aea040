"""Shape parameters of laws by variable projection: coefficients eliminated on moments."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .exceptions import IdentifiabilityError, LawError, RankWarning
from .laws.base import Shape
from .layout import LawLayout
from .sites import Site

_SCAN = 13


def estimate_shapes(
    layout: LawLayout,
    scales: Mapping[Site, tuple[float, float, float]],
    solve: Callable[[LawLayout], tuple[Any, Any]],
) -> LawLayout:
    """Values for every shape parameter that has none.

    Each is scanned over its bounds in turn, then all are refined together; the linear coefficients
    are eliminated by solving the chain at every trial (Golub and Pereyra, 1973). The criterion is
    the sum of the squared shares that the steps leave unexplained.

    Parameters
    ----------
    layout : LawLayout
    scales : mapping of Site to (float, float, float)
        Rms drift (m), rms rate (m/s) and record length (s) at each site.
    solve : callable
        From a layout with all values to (solution, moments).

    Returns
    -------
    LawLayout
        With all values.
    """
    from scipy.optimize import minimize

    free = [
        (site, i, p)
        for site, held in layout.laws.items()
        for i, law in enumerate(held)
        for p in law.shapes
        if law.shape[p.name] is None
    ]
    low, high = np.array([p.bounds(*scales[site]) for site, _, p in free]).T
    log = np.array([p.log for *_, p in free])
    low_u, high_u = (
        np.where(log, np.log(np.where(log, low, 1.0)), low),
        np.where(log, np.log(np.where(log, high, 1.0)), high),
    )

    def values(u: np.ndarray) -> np.ndarray:
        return np.where(log, np.exp(np.where(log, u, 0.0)), u)

    def trial(u: np.ndarray) -> LawLayout:
        return _with_shapes(layout, free, values(u))

    def cost(u: np.ndarray) -> float:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RankWarning)
                solution, _ = solve(trial(np.clip(u, low_u, high_u)))
        except (IdentifiabilityError, LawError):  # no answer for these values, e.g. a loop like a spring
            return np.inf
        return float(sum(fit.share**2 for fit in solution.fits))

    u = 0.5 * (low_u + high_u)
    for k in range(len(free)):
        line = np.linspace(low_u[k], high_u[k], _SCAN)
        costs = []
        for point in line:
            u[k] = point
            costs.append(cost(u))
        u[k] = line[int(np.argmin(costs))]
    step = (high_u - low_u) / (_SCAN - 1)
    simplex = np.vstack([u, u + np.diag(0.5 * np.where(u + 0.5 * step > high_u, -step, step))])
    best = minimize(
        cost, u, method="Nelder-Mead", bounds=list(zip(low_u, high_u)),
        options={"initial_simplex": simplex, "xatol": 1e-10, "fatol": 1e-18, "maxfev": 120 * len(free)},
    )
    return trial(np.clip(best.x, low_u, high_u))


def _with_shapes(layout: LawLayout, free: list[tuple[Site, int, Shape]], values: np.ndarray) -> LawLayout:
    laws = {site: list(held) for site, held in layout.laws.items()}
    for (site, i, p), value in zip(free, values):
        laws[site][i] = laws[site][i].with_values(shape={p.name: float(value)})
    return LawLayout(layout.chain, laws)

