"""From a solution of the balances to the chain model, and what can be read off beside it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..exceptions import ChannelError, DataQualityWarning
from ..laws.shape import Motion, Scales
from ..mechanics.identifiability import SolveOrder
from ..mechanics.sites import Site
from .chain_model import ChainModel
from .chain_solve import Solution
from .domains import VisitedRegion
from .grams import BlockGrams
from .layout import LawLayout
from .segments import SegmentSet


def model_of(layout: LawLayout, solution: Solution) -> ChainModel:
    """Put the coefficients of a solution into the laws of a layout."""
    held = {}
    for site in layout.sites:
        values = solution.coefficients.get(site, np.zeros(0))
        ends = np.cumsum([len(law.terms()) for law in layout.laws.get(site, ())])[:-1]
        held[site] = tuple(
            law.with_values(coefficients=part) for law, part in zip(layout.laws.get(site, ()), np.split(values, ends))
        )
    masses = [solution.masses[j] for j in range(1, layout.n_dof + 1)]
    return ChainModel(masses, held, layout.chain)


def lost_masses(model: ChainModel) -> list[str]:
    """Sentences on DOFs of which laws take away all the mass they have."""
    total = model.total_masses
    return [
        f"DOF {j + 1} has {model.masses[j]:.4g} kg and {total[j] - model.masses[j]:.4g} kg added to it, "
        f"{total[j]:.4g} kg in all: is its known mass right, or does its force or acceleration have the wrong sign?"
        for j in np.flatnonzero((model.masses > 0) & (total <= 0))
    ]


def third_law_gap(solution: Solution, grams: BlockGrams) -> pd.Series:
    """Rms difference of the two estimates of each storey's force (paper eq. 10b), percent of its rms."""
    gaps = {}
    for site, twin in solution.twins.items():
        where, *_ = grams.positions((site.p,))
        both = np.zeros((grams.matrices[site.p,].shape[-1], 2))
        both[where[site]] = np.column_stack([solution.coefficients[site] - twin, solution.coefficients[site]])
        gap, whole = grams.norms((site.p,), both)
        gaps[str(site)] = 100.0 * gap / whole if whole else np.inf
    names = sorted(gaps)
    return pd.Series([gaps[name] for name in names], index=names, name="third-law gap (%)", dtype=float)


def unknown_forces(model: ChainModel, data: SegmentSet) -> pd.DataFrame:
    """Forces (N) on the DOFs whose force was not known, from the balances; NaN where it was given."""
    hidden = [j for j in range(data.n_dof) if any(np.isnan(seg.F[seg.valid.start, j]) for seg in data.segments)]
    parts = [np.zeros((seg.n_valid, 0)) for seg in data.segments]
    if hidden:
        forces = model.balance_forces(data)
        parts = [
            np.where(np.isnan(seg.F[seg.valid][:, hidden]), f[:, hidden], np.nan)
            for seg, f in zip(data.segments, forces)
        ]
    return pd.DataFrame(data.scatter(parts), columns=[f"F{j + 1}" for j in hidden])


def visited_regions(data: SegmentSet, layout: LawLayout) -> dict[Site, VisitedRegion]:
    """Rates and drifts that the data visited, by site."""
    pieces = [(seg.v[seg.valid], seg.s[seg.valid]) for seg in data.segments]
    lows, highs = zip(*(seg.extent.boxes(data.n_dof) for seg in data.segments))
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    storeys = VisitedRegion.of_storeys(pieces, low, high)
    out = {}
    for site in layout.sites:
        if site.p - site.q == 1:
            out[site] = storeys[site.p - 1]
        else:
            lines = ([x[k][:, site.q : site.p].sum(axis=1, dtype=float) for x in pieces] for k in (0, 1))
            out[site] = VisitedRegion.of(*map(np.concatenate, lines))
    return out


def clock_of(motions: Sequence[Motion]) -> tuple[float, tuple[float, float]]:
    """Length of the longest record, and first and last time of all, s; 1 s from 0 without a clock."""
    ends = [(float(m.t[0]), float(m.t[-1])) for m in motions if m.t is not None] or [(0.0, 1.0)]
    longest = max(last - first for first, last in ends)
    return longest, (min(first for first, _ in ends), max(last for _, last in ends))


def scales_of(data: SegmentSet, layout: LawLayout) -> dict[Site, Scales]:
    """Sizes of the motion at each site, from which shape parameters are searched."""
    total = {}
    for site in layout.sites:
        motions = [seg.motion(site, seg.valid) for seg in data.segments]
        size = sum(m.n_samples for m in motions)
        rms = [float(np.sqrt(sum((getattr(m, key) ** 2).sum() for m in motions) / size)) for key in "sv"]
        total[site] = (rms[0], rms[1], *clock_of(motions))
    return total


def require_moving(data: SegmentSet, layout: LawLayout) -> None:
    """Refuse channels that are constant in every record."""
    for at, name in enumerate("avs"):
        for j in range(data.n_dof):
            site = Site(j + 1)
            if name != "a" and not (site in layout.counts and layout.counts[site]):
                continue
            if all(seg.extent.is_constant(at * data.n_dof + j) for seg in data.segments):
                raise ChannelError(
                    f"Channel {name}{j + 1} is constant in every record",
                    "A dead sensor, a wrong column or a floor that is not excited; check it, or leave the DOF out.",
                )


def require_samples(data: SegmentSet, solve_order: SolveOrder, layout: LawLayout) -> None:
    """Refuse fewer samples than a step of the solve order has unknowns."""
    for step in solve_order.steps:
        unknowns = len(step.masses) + sum(layout.counts[s] for s in step.sites)
        rows = sum(
            seg.n_valid for seg in data.segments if not any(np.isnan(seg.F[seg.valid.start, j - 1]) for j in step.dofs)
        )
        if rows < unknowns + 1:
            raise ChannelError(
                f"{rows} samples are too few for the {step.name}, which has {unknowns} unknowns",
                "Use a longer record or a lower degree.",
            )


def require_clock(data: SegmentSet, layout: LawLayout) -> None:
    """Warn where laws that remember the path have to guess where the motion turns."""
    if layout.has_memory and any(seg.t is None for seg in data.segments):
        warnings.warn(
            "A law remembers the path and the time of the samples is unknown: where the motion turns between two "
            "samples is guessed, which costs accuracy. Pass dt= (s) to the estimator or time= to fit.",
            DataQualityWarning,
            stacklevel=5,
        )
