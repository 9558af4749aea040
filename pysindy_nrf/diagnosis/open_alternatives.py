"""Alternatives that the data do not exclude, and what they do to intervals.

An interval holds under the assumption that the structure and the channels are what the
model says. Where the data allow something else, the interval is widened to what both
together span, or withheld where that says too little.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from .effects import Bounds, Interval
from .facts import Alternative, AmbiguousInterval, Move

Moves = Mapping[str, Move]

# Share of a mass, a stiffness or a damping ratio that matters to an engineer.
MATERIAL = 0.1
# Share of a value by which a better model may widen its interval before this, which the
# data reject with the model, is withheld. With Rayleigh damping in
# benchmarks/interval_coverage.py it is 0.2 % of masses and 8 to 30 % of dampings.
SLIGHT = 0.01
# Residual beside an alternative, as a share of that of the model, below which it fits
# better, and below which it is the model to use. Chosen on benchmarks/verdicts.py with
# seed 0: the best alternative left 0.97 at least for 47 right models (0.89 for three of
# benchmarks/interval_coverage.py that are excited in one mode), and below 0.5 for 17 of
# 24 with a missing brace, a gain of a floor, or either with one mode excited.
BETTER_FIT = 0.8
FAR_BETTER_FIT = 0.5
# The same, averaged over the equations of motion, up to which an alternative fits as
# well, and below which dashpots to the ground explain a part of the residual. Chosen on
# benchmarks/verdicts.py with seed 0: right models 0.988 at least, six with Rayleigh
# damping 0.895 at most.
EQUAL_FIT = 1.02
PARTLY_BETTER_FIT = 0.97
# Times the half-width of an interval from which on it says something else: one that is
# wide by itself is not withheld for a little more.
MUCH_WIDER = 2.0
# Percent of an equation of motion that is explained as well as any sensor allows.
EXPLAINED = 1.0


def matters(alternative: Alternative) -> bool:
    """Whether an alternative that fits changes a number that an engineer uses."""
    change = abs(alternative.change)
    if _is_of_damping(alternative):
        # dampings are never determined well: the change itself must be sure
        is_sure = change - alternative.half_width > MATERIAL
        return is_sure and alternative.residual_share_by_equation < PARTLY_BETTER_FIT
    fits_as_well = alternative.residual_share_by_equation < EQUAL_FIT
    return fits_as_well and alternative.reach > MATERIAL


def _is_of_damping(alternative: Alternative) -> bool:
    return alternative.parameter.startswith("damping")


@dataclass(frozen=True)
class OpenAlternatives:
    """The alternatives that the data do not exclude and that change something.

    Parameters
    ----------
    alternatives : tuple of Alternative
    better : frozenset of str
        Descriptions of those that fit better than the model.
    """

    alternatives: tuple[Alternative, ...]
    better: frozenset[str]

    @property
    def rejecting(self) -> frozenset[str]:
        """Descriptions of those with which the data reject the model.

        They fit better, or the change of a damping that they make is sure.
        """
        of_damping = [
            alternative.description
            for alternative in self.alternatives
            if _is_of_damping(alternative)
        ]
        return self.better.union(of_damping)

    @classmethod
    def among(
        cls, alternatives: Iterable[Alternative], remaining: Mapping[int, float]
    ) -> OpenAlternatives:
        """Those among all alternatives.

        ``remaining`` is the share of each equation of motion that the model leaves,
        percent, beyond noise where that is known.
        """
        leaves_something = max(remaining.values(), default=0.0) >= EXPLAINED
        still_open, better = [], set()
        for alternative in alternatives:
            fits_better = leaves_something and alternative.residual_share < BETTER_FIT
            if fits_better:
                better.add(alternative.description)
            if fits_better or matters(alternative):
                still_open.append(alternative)
        return cls(tuple(still_open), frozenset(better))

    @property
    def moves(self) -> dict[str, Moves]:
        """What each does to masses and coefficients, by its description."""
        return {
            alternative.description: alternative.moves
            for alternative in self.alternatives
        }


def ambiguous_intervals(
    values: Mapping[str, float],
    bounds: Bounds,
    moves: Mapping[str, Moves],
    rejecting: Container[str] = (),
) -> tuple[AmbiguousInterval, ...]:
    """Intervals that open alternatives widen, or that are withheld for them.

    They are withheld where they would be too wide for use. Where the data reject the
    model, all of one kind are withheld, such as the dashpots of storeys, as soon as an
    alternative makes one of them slightly wider. An interval that holds zero says
    already that the data do not determine the value.

    Parameters
    ----------
    values, bounds : mapping of str to float and to (float, float)
        Estimates of the model, and their intervals.
    moves : mapping of str to mapping of str to Move
        What each alternative does to the values, by its description.
    rejecting : container of str
        Descriptions of the alternatives with which the data reject the model.
    """
    intervals, spans = {}, {}
    for name, (low, high) in bounds.items():
        holds_zero = low <= 0 <= high
        if holds_zero or not np.isfinite([low, high]).all():
            continue
        interval = AmbiguousInterval(name, low, high, (), withheld=False)
        of_value = {by: every[name] for by, every in moves.items() if name in every}
        intervals[name] = interval
        spans[name] = _spanned(interval, values[name], of_value)

    rejected = _rejected_kinds(intervals, spans, rejecting)
    ambiguous = []
    for name, span in spans.items():
        by_kind = rejected.get(_kind_of(name), ())
        if span.by or by_kind:
            withheld = bool(by_kind) or _says_little(span, intervals[name])
            ambiguous.append(replace(span, by=span.by or by_kind, withheld=withheld))
    return tuple(ambiguous)


def _rejected_kinds(
    intervals: Mapping[str, AmbiguousInterval],
    spans: Mapping[str, AmbiguousInterval],
    rejecting: Container[str],
) -> dict[str, tuple[str, ...]]:
    """Alternatives that make an interval wider, with which the data reject the model.

    By the kind of the parameter.
    """
    rejected: dict[str, tuple[str, ...]] = {}
    for name, span in spans.items():
        wider = _half_width(span) - _half_width(intervals[name])
        is_rejected = any(description in rejecting for description in span.by)
        if is_rejected and wider > SLIGHT:
            rejected.setdefault(_kind_of(name), span.by)
    return rejected


def _kind_of(parameter: str) -> str:
    """Parameters whose names differ in their numbers only are of one kind."""
    return re.sub(r"\d+", "", parameter)


def _spanned(
    interval: AmbiguousInterval, value: float, moves: Mapping[str, Move]
) -> AmbiguousInterval:
    """An interval with all that alternatives make of its value.

    Beside an alternative a value is known as well as without it, at best.
    """
    span = interval
    known_to = (interval.high - interval.low) / 2
    for description, move in moves.items():
        half_width = max(move.half_width, known_to)
        low = value + move.change - half_width
        high = value + move.change + half_width
        if low < interval.low or high > interval.high:
            low, high = min(low, span.low), max(high, span.high)
            span = replace(span, low=low, high=high, by=(*span.by, description))
    return span


def _says_little(span: AmbiguousInterval, interval: AmbiguousInterval) -> bool:
    """Whether an interval is too wide for use, and alternatives make it so."""
    is_wide = _half_width(span) > MATERIAL
    return is_wide and span.high - span.low > MUCH_WIDER * (
        interval.high - interval.low
    )


def _half_width(interval: AmbiguousInterval) -> float:
    """Half-width as a share of the middle; infinite about zero."""
    middle = abs(interval.high + interval.low)
    return (interval.high - interval.low) / middle if middle else np.inf


def with_ambiguity(
    bounds: Bounds, ambiguous: Iterable[AmbiguousInterval]
) -> dict[str, Interval]:
    """Intervals, widened where they are ambiguous; NaN where they are withheld."""
    widened = dict(bounds)
    for interval in ambiguous:
        widened[interval.parameter] = interval.ends
    return widened
