"""Channels of one DOF that do not show one motion: who is suspected of a fault.

Only rows of the search are compared: the runs between the held-out pieces, all of them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..exceptions import NRFError
from ..laws.sensor import ChannelDelay, GainError, SensorFault
from ..mechanics.sites import Site
from ..signals.alignment import channel_alignment
from .prepare import Prepared
from .words import Contradiction
from .workspace import Workspace

# Contradictions between channels of one DOF, as a share of the channel, that are looked into, and that are
# worth a word; and how many.
CONTRADICTION, _SAID = 0.02, 0.06
MOST = 4
# Samples below which half a record tells no delay.
_HALF = 1000


@dataclass(frozen=True)
class Suspect:
    """A fault at a channel, and the contradiction between channels of its DOF that bears witness of it."""

    law: SensorFault
    site: Site
    witness: Contradiction | None = None


def contradictions(ready: Prepared, work: Workspace) -> list[Contradiction]:
    """Channels of one DOF that do not show one motion, the largest contradictions first."""
    found = [s.witness for size, s in contradictory(ready, work) if size >= _SAID and s.witness is not None]
    return list(dict.fromkeys(found[:MOST]))


def longest(work: Workspace) -> tuple[int, slice]:
    """The longest run of search rows without a held-out piece in it: number of its record, rows of the record."""
    runs = [(i, run) for i in work.searched for run in work.runs(i)]
    chosen, rows = max(runs, key=lambda r: r[1].stop - r[1].start)
    first = work.data.segments[chosen].valid.start
    return chosen, slice(first + rows.start, first + rows.stop)


def _runs(work: Workspace) -> tuple[int, list[slice]]:
    """The record that has most rows of the search, and its runs without a held-out piece in them."""
    runs = {i: work.runs(i) for i in work.searched}
    chosen = max(runs, key=lambda i: sum(run.stop - run.start for run in runs[i]))
    first = work.data.segments[chosen].valid.start
    return chosen, [slice(first + run.start, first + run.stop) for run in runs[chosen]]


def contradictory(ready: Prepared, work: Workspace) -> list[tuple[float, Suspect]]:
    """Faults that would reconcile the channels of one DOF, with their size as a share of the channel, largest first."""
    if ready.contradictions is not None:
        return ready.contradictions
    try:
        chosen, runs = _runs(work)
        record = ready.records[chosen]
        table = channel_alignment(record, runs=runs)
        halves = [channel_alignment(record, runs=half) for half in _halves(runs)]
    except NRFError:
        ready.contradictions = []
        return []
    sized: list[tuple[float, Suspect]] = []
    for name, row in table.iterrows():
        if row["aligned"] or not np.isfinite(row["gain"]):
            continue
        channel, reference = str(name), str(row["reference"])
        witness = Contradiction(channel, reference, str(row["message"]))
        gain = float(row["sign"] * row["gain"])
        late = [float(half.loc[name, "delay"]) for half in halves]
        large = [float(half.loc[name, "sign"] * half.loc[name, "gain"]) - 1.0 for half in halves]
        turn = abs(row["delay"]) * pace(work, int(channel[1:]))
        pairs = [
            (turn, late, ChannelDelay(row["delay"]), ChannelDelay(-row["delay"])),
            (_beyond_noise(gain, row["coherence"]), large, GainError(gain - 1.0), GainError(1.0 / gain - 1.0)),
        ]
        for size, seen, own, other in pairs:
            # what one half of the record denies is chance
            if size < CONTRADICTION or (any(x > 0 for x in seen) and any(x < 0 for x in seen)):
                continue
            for law, of in ((own, channel), (other, reference)):
                sized.append((size, Suspect(law, Site(f"sensor {of}"), witness)))
    once: dict[tuple[str, str], tuple[float, Suspect]] = {}
    for size, s in sorted(sized, key=lambda p: -p[0]):
        once.setdefault((s.law.name, str(s.site)), (size, s))
    ready.contradictions = list(once.values())
    return ready.contradictions


def _halves(runs: Sequence[slice]) -> list[Sequence[slice]]:
    """The first and the second half of the rows, each as runs; the whole where that is too short to be halved."""
    total = sum(run.stop - run.start for run in runs)
    if total < 2 * _HALF:
        return [runs]
    out: list[list[slice]] = [[], []]
    at = 0
    for run in runs:
        cut = min(max(run.start + total // 2 - at, run.start), run.stop)
        for half, part in zip(out, (slice(run.start, cut), slice(cut, run.stop))):
            if part.stop > part.start:
                half.append(part)
        at += run.stop - run.start
    return [out[0], out[1]]


def _beyond_noise(gain: float, coherence: float) -> float:
    """Deviation of a gain from 1; zero where noise in either channel alone could make it seem so."""
    return abs(gain - 1.0) if gain <= 0 or abs(np.log(gain)) > -0.5 * np.log(coherence) else 0.0


def pace(work: Workspace, dof: int) -> float:
    """Mean circular frequency of the displacement of a DOF's rate, 1/s."""
    top = bottom = 0.0
    for b in work.search:
        seg = work.data.segments[b.segment]
        v = seg.v[seg.valid, :dof][b.rows].sum(axis=1)
        a = np.diff(v) / (seg.dt or 1.0)
        top, bottom = top + float(a @ a), bottom + float(v @ v)
    return float(np.sqrt(top / bottom)) if bottom > 0 else 1.0


__all__ = ["CONTRADICTION", "MOST", "Suspect", "contradictions", "contradictory", "longest", "pace"]
