"""Instruments under the corrected force, and the weight of every balance by frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..regression.blocks_of_samples import whole_block
from ..regression.chain_model import ChainModel
from ..regression.gram_pass import rows_of
from ..regression.layout import Group, LawLayout
from ..regression.segments import Segment, SegmentSet
from .runs import likeness_of, run_of, steady
from .spectra import NoiseModel, Smooth, common_band, corrected, lines_of, noise_model, smoothed, spectrum
from .whitening import Whitener


@dataclass
class Weighting:
    """What a weighted round of instrumental variables needs.

    Attributes
    ----------
    runs : list of Segment or None
        Free runs under the corrected forces.
    likeness : float
        Their correlation with the measured accelerations.
    whiteners : dict of tuple of int to Whitener
        By the DOFs of the group.
    """

    runs: list[Segment | None]
    likeness: float
    whiteners: dict[tuple[int, ...], Whitener]


def weighting_of(
    model: ChainModel,
    data: SegmentSet,
    usable: Sequence[int],
    layout: LawLayout,
    groups: Sequence[Group],
    filters: Sequence[Any],
    known_masses: Mapping[int, float],
    band: Any = None,
) -> Weighting | None:
    """Instruments and weights from a model."""
    segments = [data.segments[i] for i in usable]
    runner = steady(model)
    plain = [run_of(runner, seg) for seg in segments]
    noise = noise_model(runner, layout, segments, plain)
    resolved = [seg.resolved for seg in segments if seg.resolved is not None]
    if noise is None or min(resolved, default=np.inf) < noise.lively[1]:
        return None
    better = [corrected(seg, run, noise) for seg, run in zip(segments, plain)]
    found = [run_of(runner, seg) for seg in better]
    likeness = likeness_of(segments, found)
    # the forces of the balances stay as measured: only the motion under the corrected ones is taken
    runs: list[Segment | None] = [None] * len(data.segments)
    for i, run in zip(usable, found):
        runs[i] = run
    low, high = common_band(segments, band)
    low, high = max(low, noise.lively[0]), min(high, noise.lively[1])
    whiteners = _whiteners(model, segments, layout, groups, [filters[i] for i in usable], known_masses, noise)
    for whitener in whiteners.values():
        whitener.band = (low, high)
    return Weighting(runs, likeness, whiteners)


def _whiteners(
    model: ChainModel,
    segments: Sequence[Segment],
    layout: LawLayout,
    groups: Sequence[Group],
    filters: Sequence[Any],
    known_masses: Mapping[int, float],
    noise: NoiseModel,
) -> dict[tuple[int, ...], Whitener]:
    """Weights: the share of the instruments that is signal, over the density of what the balance misses."""
    missed: dict[tuple[int, ...], list] = {g.dofs: [] for g in groups}
    theta = model.coefficients
    for seg, filter in zip(segments, filters):
        block = whole_block(seg, layout, filter)
        for group in groups:
            rows = rows_of(layout, group, block, known_masses)
            own = [sign * theta[site] for site, sign in zip(group.sites, group.signs)]
            mass = [model.masses[[group.dofs[0] - 1]]] if len(group.dofs) == 1 else []
            gap = rows[-1] - np.concatenate([*own, *mass]) @ rows[:-1]
            f = lines_of(seg)
            use = (f >= noise.lively[0]) & (f <= noise.lively[1])
            missed[group.dofs].append((f[use], np.abs(spectrum(gap[:, None], seg.step, taper=True)[use]) ** 2))
    out = {}
    for dofs, held in missed.items():
        left = smoothed([f for f, _ in held], [p for _, p in held])
        top = left.values.max()
        if top > 0:
            share = noise.share(left.f).mean(axis=1, keepdims=True)
            out[dofs] = Whitener(Smooth(left.f, share / np.maximum(left.values, 1e-9 * top)))
    return out
