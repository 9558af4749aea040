"""Columns of all equations of motion of a record, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..chain.layout import Block, LawLayout, Recipe, block_size
from ..chain.sites import Site
from ..laws.shape import Motion
from ..records.dataset import Segment


def blocks_of_segment(
    segment: Segment,
    layout: LawLayout,
    size: int | None = None,
    filter: Any = None,
    states: dict | None = None,
) -> Iterator[Block]:
    """Columns of all balances, block by block."""
    start, stop = segment.valid.start, segment.valid.stop
    if filter is not None or (layout.has_memory and states is None):
        size = max(stop - start, 1)
    size = size or block_size(layout)
    recipe = layout.recipe
    storeys = tuple((site.q, site.p) for site in recipe.motions) == tuple(
        (j, j + 1) for j in range(segment.n_dof)
    )
    beside = (
        _side_by_side(segment.a, segment.v, segment.s)
        if storeys and not recipe.others
        else None
    )
    for begin in range(start, stop, size):
        rows = slice(begin, min(begin + size, stop))
        if beside is not None:
            channels = _as_rows(beside, rows)
            a, source = channels[: segment.n_dof], channels[segment.n_dof :]
        else:
            source = _source(
                segment,
                layout,
                recipe,
                rows,
                states,
                lead=int(begin > start or bool(states)),
            )
            a = _as_rows(segment.a, rows)
        force = _as_rows(segment.F, rows)
        weights = None if segment.weights is None else segment.weights[rows]
        if filter is None:
            yield Block(None, a, force, source, recipe, layout.n_terms, weights)
        else:
            terms = recipe.finish(source, layout.n_terms)
            terms = np.ascontiguousarray(filter.apply(terms.T).T)
            a = np.ascontiguousarray(filter.apply(a.T).T)
            known = ~np.isnan(force[:, 0])
            if known.any():
                force = force.copy()  # it may be the user's own array
                force[known] = filter.apply(force[known].T).T
            yield Block(terms, a, force, weights=weights)


def _source(
    segment: Segment,
    layout: LawLayout,
    recipe: Recipe,
    rows: slice,
    states: dict | None,
    lead: int,
) -> np.ndarray:
    """Rates, drifts and the columns of laws that are not products of them, one row
    each.
    """
    out = np.empty((recipe.n_source, rows.stop - rows.start))
    m = len(recipe.motions)
    at = 2 * m
    ends = [(site.q, site.p) for site in recipe.motions]
    if ends and ends == [(i, i + 1) for i in range(ends[0][0], ends[-1][1])]:
        floors = slice(ends[0][0], ends[-1][1])
        out[:m], out[m:at] = segment.v[rows, floors].T, segment.s[rows, floors].T
    else:
        for i, (low, high) in enumerate(ends):
            out[i] = segment.v[rows, low:high].sum(axis=1, dtype=np.float64)
            out[m + i] = segment.s[rows, low:high].sum(axis=1, dtype=np.float64)
    motions: dict[Site, Motion] = {}
    for site, number, width in recipe.others:
        law = layout.laws[site][number]
        if law.has_memory and states is not None:
            state = states.setdefault((site, number), np.zeros(law.n_states))
            wide = segment.motion(site, slice(rows.start - lead, rows.stop))
            out[at : at + width] = law.features(wide, state)[lead:].T
        else:
            if site not in motions:
                motions = {site: segment.motion(site, rows)}
            out[at : at + width] = law.features(motions[site]).T
        at += width
    return out


def _as_rows(channels: np.ndarray, rows: slice) -> np.ndarray:
    """Some samples, one row for each channel; a view that cannot be written to, where
    they are doubles.
    """
    view = channels[rows].T
    view.flags.writeable = False
    return np.asarray(view, dtype=np.float64)


def _side_by_side(a: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray | None:
    """The matrix of which a, v and s are neighbouring columns, if they are: one
    transposition instead of three.
    """
    if not (
        a.dtype == v.dtype == s.dtype
        and a.shape == v.shape == s.shape
        and a.strides == v.strides == s.strides
    ):
        return None
    place = [x.__array_interface__["data"][0] for x in (a, v, s)]
    step = a.shape[1] * a.strides[1]
    if a.strides[1] <= 0 or place != [place[0], place[0] + step, place[0] + 2 * step]:
        return None
    return np.lib.stride_tricks.as_strided(
        a, (a.shape[0], 3 * a.shape[1]), a.strides, writeable=False
    )
