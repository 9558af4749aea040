"""Intervals of an effect's parameters: from block to block, and from the noise in the motion.

The effect's coefficients and shape parameters are estimated together, once, with each block of the
search left out: a law with parameters near the best is linear in them,
``phi(theta + d) c = phi(theta) c + sum_i d_i D_i`` with ``D_i = c dphi/dtheta_i``, so the derivatives
stand beside the columns and the chain is solved as ever (delete-one-block jackknife; Efron 1982). The
spread over the blocks holds what the balances leave, whatever its colour. Noise in the motion also
biases; how much is seen on surrogates, beside what they were simulated with, and the interval reaches as far
the other way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from ..common.jackknife import variance
from ..exceptions import NRFError
from ..laws.base import ForceLaw
from ..mechanics.sites import Site
from ..regression.chain_solve import groups_of
from ..regression.layout import Layout
from .projection import Projection
from .search import Axes, plateau
from .stage import Stage
from .workspace import leave_out_by_use

LEVEL = 0.95
# Step of the derivatives: share of the range of a shape parameter in the coordinates of the search.
_STEP = 2e-3
_LEAST_FOLDS = 3
# No interval is narrower than this share of its parameter on each side, whatever the blocks say.
_LEAST = 1e-4


def intervals(
    stage: Stage,
    place: tuple[Site, int],
    law: ForceLaw,
    theta: np.ndarray,
    nulls: Sequence[Stage] = (),
    origin: np.ndarray | None = None,
    level: float = LEVEL,
) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Intervals of the parameters of one law of the model, and what noise does to its coefficients."""
    site, i = place
    held = stage.laws[site][i]
    axes = Axes(law, stage.work, site)
    centre = axes.point(held)
    start = theta if origin is None else origin
    width, true, begun = len(theta), *(np.concatenate([c, np.zeros(len(centre))]) for c in (theta, start))
    out: dict[str, tuple[float, float]] = {}
    try:
        drift, half = _widths(stage, place, axes, centre, theta, begun, nulls, level)
    except NRFError:  # a change in time between two blocks has no slope: from the profile of the error instead
        out = _profile(stage, place, law, axes, centre, level)
        axes, centre, true, begun = Axes(held, stage.work, site), np.zeros(0), theta, start
        try:
            drift, half = _widths(stage, place, axes, centre, theta, begun, nulls, level)
        except NRFError:
            return out, {}
    half = np.maximum(half, _LEAST * np.append(np.abs(theta), np.ones(len(centre))))
    low, high = (true + np.minimum(0.0, -drift) - half, true + np.maximum(0.0, -drift) + half)
    out |= {t.symbol: (float(lo), float(hi)) for t, lo, hi in zip(held.terms(), low, high)}
    ends = [axes.values(np.clip(centre + end[width:], axes.low, axes.high)) for end in (low, high)]
    out |= {p.name: (float(lo), float(hi)) for p, lo, hi in zip(axes.shapes, *ends)}
    for name, (lo, hi) in _profile(stage, place, law, axes, centre, level).items():
        if name in out:  # where a single block decides, the others do not show how well
            out[name] = min(lo, out[name][0]), max(hi, out[name][1])
    shares = {t.symbol: float(d / c) for t, d, c in zip(held.terms(), drift, start) if nulls and c}
    return {k: v for k, v in out.items() if np.isfinite(v).all()}, shares


def _widths(
    stage: Stage,
    place: tuple[Site, int],
    axes: Axes,
    centre: np.ndarray,
    theta: np.ndarray,
    begun: np.ndarray,
    nulls: Sequence[Stage],
    level: float,
) -> tuple[np.ndarray, np.ndarray]:
    """What noise adds on average to what surrogates began with, and half the interval."""
    _, folds = _linearised(stage, place, axes, centre, theta)
    drifts = []
    for null in nulls:
        try:
            drifts.append(_linearised(null, place, axes, centre, theta)[0] - begun)
        except NRFError:
            continue
    drift = np.mean(drifts, axis=0) if drifts else np.zeros_like(begun)
    return drift, student.ppf(0.5 + level / 2, len(folds) - 1) * np.sqrt(variance(folds))


def _profile(
    stage: Stage, place: tuple[Site, int], law: ForceLaw, axes: Axes, centre: np.ndarray, level: float
) -> dict[str, tuple[float, float]]:
    """The interval of a single shape parameter within which the error hardly changes."""
    if len(centre) != 1:
        return {}
    site, work = place[0], stage.work
    signs = [np.sign(work.motion(site, b.segment).v[b.rows]) for b in work.search]
    count = max(sum(int((np.diff(s) != 0).sum()) for s in signs), 8)
    slack = (1.0 + student.ppf(0.5 + level / 2, count) ** 2 / count) ** 0.5 - 1.0
    slot = Stage(work, stage.chain, stage.without([place])).slot(site, law)
    ends = plateau(
        lambda u: float(slot.errors([axes.at(np.array([u]))])[0]), float(centre[0]), *axes.ends, slack=slack
    )
    low, high = (float(axes.values(np.array([u]))[0]) for u in ends)
    return {axes.shapes[0].name: (low, high)} if high > low else {}


def _linearised(
    stage: Stage, place: tuple[Site, int], axes: Axes, centre: np.ndarray, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and corrections of the shape parameters: from all blocks, and with each left out."""
    site, i = place
    work, width, extra = stage.work, len(theta), len(centre)
    columns = stage.columns
    size = len(columns)
    if extra:
        step = _STEP * (axes.high - axes.low)
        ends = [axes.at(centre + sign * d) for d in np.diag(step) for sign in (1.0, -1.0)]
        both = work.search_columns(site, ends).reshape(extra, 2, width, -1)
        slopes = np.einsum("ekn,k->en", both[:, 0] - both[:, 1], theta) / (2 * step[:, None])
        columns = np.vstack([columns, slopes])
    counts = dict(stage.layout.counts)
    counts[site] += extra
    layout = Layout(stage.chain, counts)
    where = {s: list(range(stage.layout.slices[s].start, stage.layout.slices[s].stop)) for s in stage.layout.sites}
    where[site] = where[site] + list(range(size, size + extra))
    uses, members = work.uses([g.dofs for g in groups_of(layout, stage.solve_order)])
    project = Projection(layout, stage.solve_order, work.known_masses, where, stage.tail, uses)
    grams = np.array([(part := columns[:, rows]) @ part.T for rows in work.spans])
    every = np.einsum("ub,bij->uij", members.astype(float), grams)[None]
    own = [*range(stage.at[place], stage.at[place] + width), *range(size, size + extra)]
    errors, best, _ = project(every)
    more, folds, _ = project(leave_out_by_use(grams, members))
    told = np.isfinite(more)  # without the one block that shows a change in time there is no answer
    if not np.isfinite(errors).all() or told.sum() < _LEAST_FOLDS:
        raise NRFError("The parameters cannot be told apart", "Give longer records.")
    return best[0, own], folds[told][:, own]
