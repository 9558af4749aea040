"""Atoms of the general laws at a site, sized by the motion there.

A class is the hypothesis, so its dictionary must be complete: curves of drift and rate
by hinges and smooth signs, loops by sliders of many sizes behind many backlashes. An
atom stands in a class only where the motion shows what makes it of this class: a slider
must slip, and a branch must relax within the motion. None degrades: the distance slid
since the start of a record says nothing of another record, and made predictions of
other tests of a frame worse. :class:`~pysindy_nrf.laws.DegradingBoucWen` is a name.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..chain.sites import Site
from ..laws.atoms import Atom, GeneralCurve, GeneralHysteresis, SumOfAtoms
from ..laws.base import EffectClass
from .search_data import SearchData


@dataclass(frozen=True)
class DictionarySettings:
    """Sizes of the atoms. Chosen on the records of benchmarks/measured_records.py."""

    # Drifts at which a curve bends, as shares of the largest drift.
    hinges: tuple[float, ...] = (0.0, 0.1, 0.25, 0.45, 0.65, 0.85)
    # Rates over which friction turns, and beyond which a damper bends, as shares of
    # the rms rate.
    signs: tuple[float, ...] = (0.01, 0.1, 0.4, 1.0)
    knees: tuple[float, ...] = (0.5, 1.0, 2.0)
    # Backlashes and yield drifts of sliders, as shares of the largest drift.
    gaps: tuple[float, ...] = (0.0, 0.05, 0.15, 0.3, 0.5)
    yields: tuple[float, ...] = (0.01, 0.03, 0.1, 0.2, 0.4, 0.7)
    # Yield drifts of sliders without a backlash besides: after a blow most of the
    # motion is far smaller than its peak. Chosen on the second case of docs/paper.md.
    fine_yields: tuple[float, ...] = (0.001, 0.003)
    # A slider slips if its backlash and yield drift are less than this share of the
    # largest drift: one that does not is a spring with a gap.
    slips: float = 0.8
    # Drifts over which a pinched slider is free, as shares of the largest drift.
    pinches: tuple[float, ...] = (0.1, 0.4)
    # Times in which a branch relaxes, in multiples of the rms drift over the rms rate,
    # the time of one radian. Faster branches are dashpots: they took the first place
    # of the bearing in 10 of 13 isolated frames.
    relaxations: tuple[float, ...] = (1.0, 3.0, 10.0)


DICTIONARY = DictionarySettings()
# A direction of its own: both strengths of an atom, one of each direction.
DIRECTIONS = (0.0, 1.0, -1.0)


@dataclass(frozen=True)
class MotionSize:
    """Sizes of the motion at a site.

    Attributes
    ----------
    largest, drift, rate : float
        Largest and rms drift, m, and rms rate, m/s.
    has_clock : bool
    """

    largest: float
    drift: float
    rate: float
    has_clock: bool

    @classmethod
    def of(cls, site: Site, data: SearchData) -> MotionSize:
        """The sizes at a site in the rows of a search."""
        drift, _ = data.drift_and_rate(site)
        rms_drift, rms_rate, *_ = data.scales(site)
        has_clock = all(data.data.segments[i].dt for i in data.searched)
        return cls(
            float(np.abs(drift).max()),
            rms_drift,
            rms_rate,
            has_clock,
        )


def dictionary(
    effect_class: EffectClass, site: Site, data: SearchData
) -> SumOfAtoms | None:
    """A law of all atoms of a class at a site; None for a class of names alone."""
    size = MotionSize.of(site, data)
    if not (size.drift > 0 and size.rate > 0):
        return None
    if effect_class == "memoryless":
        return GeneralCurve(_of_curves(size))
    if effect_class == "hysteresis":
        return GeneralHysteresis(_of_loops(size))
    return None


def _of_curves(size: MotionSize) -> Iterator[Atom]:
    """Atoms of a function of drift and rate."""
    for share in DICTIONARY.hinges:
        # from zero on both sides it is a linear spring
        directions = DIRECTIONS if share > 0 else DIRECTIONS[1:]
        for direction in directions:
            yield "hinge", share * size.largest, direction
    if not size.has_clock:
        yield from _signs(size, DICTIONARY.signs[:1])
        return
    yield from _signs(size, DICTIONARY.signs)
    for share in DICTIONARY.knees:
        for direction in DIRECTIONS:
            yield "knee", share * size.rate, direction
    yield ("drift rate",)


def _signs(size: MotionSize, shares: tuple[float, ...]) -> Iterator[Atom]:
    """Friction of several sharpnesses, constant and growing with the drift."""
    for share in shares:
        for direction in DIRECTIONS:
            yield "sign", share * size.rate, direction
            yield "wedge", share * size.rate, direction


def _of_loops(size: MotionSize) -> Iterator[Atom]:
    """Atoms of a hysteresis."""
    for uy in DICTIONARY.fine_yields:
        yield "slider", 0.0, uy * size.largest, 0.0
    for gap in DICTIONARY.gaps:
        for uy in DICTIONARY.yields:
            if gap + uy < DICTIONARY.slips:
                for direction in DIRECTIONS:
                    yield "slider", gap * size.largest, uy * size.largest, direction
    for uy in DICTIONARY.yields[1::2]:
        for free in DICTIONARY.pinches:
            yield "pinched", uy * size.largest, free * size.largest
    if size.has_clock:
        for multiple in DICTIONARY.relaxations:
            yield "branch", multiple * size.drift / size.rate
