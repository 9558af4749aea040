"""What data must be before they are fitted."""

from __future__ import annotations

import warnings

import numpy as np

from ..exceptions import ChannelError, DataQualityWarning
from ..mechanics.identifiability import Walk
from ..mechanics.sites import Site
from .layout import LawLayout
from .segments import SegmentSet


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


def require_samples(data: SegmentSet, walk: Walk, layout: LawLayout) -> None:
    """Refuse fewer samples than a step of the walk has unknowns."""
    for step in walk.steps:
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
