"""What a fit reads of the motion itself: checks, scales, visited regions, forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..chain.identifiability import SolveOrder
from ..chain.layout import LawLayout, Layout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..common.warn import warn_user
from ..exceptions import ChannelError, DataQualityWarning
from ..laws.shape import Motion, Scales
from ..records.dataset import Dataset


def require_moving(data: Dataset, layout: LawLayout) -> None:
    """Refuse channels that are constant in every record."""
    for channel in range(3 * data.n_dof):
        kind = "avs"[channel // data.n_dof]
        dof = channel % data.n_dof + 1
        is_read = kind == "a" or bool(layout.counts.get(Site(dof)))
        if is_read and not _moves(data, channel):
            what = f"Channel {kind}{dof} is constant in every record"
            cure = (
                "A dead sensor, a wrong column or a floor that is not excited; check"
                " it, or leave the DOF out."
            )
            raise ChannelError(what, cure)


def _moves(data: Dataset, channel: int) -> bool:
    """Whether a channel takes more than one value in some record."""
    for segment in data.segments:
        if segment.extent.low[channel] < segment.extent.high[channel]:
            return True
    return False


def require_samples(data: Dataset, solve_order: SolveOrder, layout: Layout) -> None:
    """Refuse fewer samples than a step of the solve order has unknowns."""
    for step in solve_order.steps:
        n_unknowns = len(step.masses)
        n_unknowns += sum(layout.counts[site] for site in step.sites)
        dofs = [dof - 1 for dof in step.dofs]
        n_samples = 0
        for segment in data.segments:
            if not np.isnan(segment.F[segment.valid.start, dofs]).any():
                n_samples += segment.n_valid
        if n_samples <= n_unknowns:
            what = (
                f"{n_samples} samples are too few for the {step.name}, which has"
                f" {n_unknowns} unknowns"
            )
            raise ChannelError(what, "Use a longer record or a lower degree.")


def require_clock(data: Dataset, layout: LawLayout) -> None:
    """Warn where laws that remember the path have to guess where the motion turns."""
    clockless = any(segment.t is None for segment in data.segments)
    if layout.has_memory and clockless:
        warn_user(
            "A law remembers the path and the time of the samples is unknown: where the"
            " motion turns between two samples is guessed, which costs accuracy. Pass"
            " dt= (s) to the estimator or time= to fit.",
            DataQualityWarning,
        )


def scales_of(data: Dataset, layout: LawLayout) -> dict[Site, Scales]:
    """Sizes of the motion at each site, from which shape parameters are searched."""
    scales: dict[Site, Scales] = {}
    for site in layout.sites:
        motions = [segment.motion(site, segment.valid) for segment in data.segments]
        n_samples = sum(motion.n_samples for motion in motions)
        drift = sum((motion.s**2).sum() for motion in motions)
        rate = sum((motion.v**2).sum() for motion in motions)
        rms_drift = float(np.sqrt(drift / n_samples))
        rms_rate = float(np.sqrt(rate / n_samples))
        scales[site] = (rms_drift, rms_rate, *clock_of(motions))
    return scales


def clock_of(motions: Sequence[Motion]) -> tuple[float, tuple[float, float]]:
    """Length of the longest record, and first and last time of all, s.

    One second from 0 without a clock.
    """
    starts = []
    ends = []
    for motion in motions:
        if motion.t is not None:
            starts.append(float(motion.t[0]))
            ends.append(float(motion.t[-1]))
    if not starts:
        return 1.0, (0.0, 1.0)
    longest = float(np.max(np.subtract(ends, starts)))
    return longest, (min(starts), max(ends))


def visited_regions(data: Dataset, layout: LawLayout) -> dict[Site, VisitedRegion]:
    """Rates and drifts that the data visited, by site."""
    pieces = []
    lows = []
    highs = []
    for segment in data.segments:
        pieces.append((segment.v[segment.valid], segment.s[segment.valid]))
        low, high = segment.extent.boxes(data.n_dof)
        lows.append(low)
        highs.append(high)
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    storeys = VisitedRegion.of_storeys(pieces, low, high)

    regions = {}
    for site in layout.sites:
        if site.p - site.q == 1:
            regions[site] = storeys[site.p - 1]
        else:
            between = slice(site.q, site.p)
            rate = [v[:, between].sum(axis=1, dtype=float) for v, _ in pieces]
            drift = [s[:, between].sum(axis=1, dtype=float) for _, s in pieces]
            regions[site] = VisitedRegion.of(
                np.concatenate(rate), np.concatenate(drift)
            )
    return regions


def unknown_forces(model: ChainModel, data: Dataset) -> pd.DataFrame:
    """Forces (N) on the DOFs whose force was not known, from the equations of motion.

    NaN where it was given.
    """
    first_rows = [segment.F[segment.valid.start] for segment in data.segments]
    hidden = np.flatnonzero(np.isnan(first_rows).any(axis=0))
    names = [f"F{j + 1}" for j in hidden]
    measured = [segment.F[segment.valid][:, hidden] for segment in data.segments]
    if not len(hidden):
        return pd.DataFrame(data.scatter(measured), columns=names)

    parts = []
    for known, forces in zip(measured, model.balance_forces(data)):
        parts.append(np.where(np.isnan(known), forces[:, hidden], np.nan))
    return pd.DataFrame(data.scatter(parts), columns=names)
