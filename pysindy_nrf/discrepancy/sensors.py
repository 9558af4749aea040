"""Faulty sensors as undeclared effects: channels that are late, wrongly scaled, or have a wrong zero.

A fault of a sensor is not a force: it changes the channels from which every column is built, and the fusion that mixes
them. So a candidate corrects the channel, and the same model is solved again on what follows. Where a DOF has several
kinds of channels their contradiction gives the fault and the balances say which of them is wrong; where it has one, and
for forces, the fault is found from the balances alone.

What the data cannot show is not tried: the gain of the only force where no mass is known (it scales the chain), the
gain of the only DOF, the zero of x1 (a constant force on DOF 1).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from ..exceptions import NRFError
from ..laws.sensor import ChannelDelay, GainError, SensorFault
from ..mechanics.sites import Site
from ..regression.segments import Segment, SegmentSet
from ..signals.alignment import channel_alignment
from ..simulation.api import as_true
from .constants import LEAST_GAIN, LEAST_SHARE, SUSPECTS
from .prepare import Prepared, Workspace, prepare
from .ruler import Gain, Ruler, Trial
from .state import Effect, Finding, Proposal, State
from .windows import Windows
from .words import Contradiction


def findings_of_faults(state: State, laws: Sequence[SensorFault]) -> list[Finding]:
    """Corrected sensors as findings on top of a state."""
    ready = state.ready
    if not laws or ready is None:
        return []
    work = state.trial.ruler.work
    kinds = tuple(type(law) for law in laws)
    known = [s for size, s in contradictory(ready, work) if isinstance(s.law, kinds) and size >= LEAST_SHARE][:SUSPECTS]
    alone = sorted(filter(None, (_scanned(state.trial, s) for s in _alone(ready, work, laws))), key=lambda p: -p[0])
    found = []
    for suspect in [*known, *(s for _, s in alone[:SUSPECTS])]:
        rebuilt = _rebuilt(ready, state.trial, suspect)
        if rebuilt is None:
            continue
        fresh, trial = rebuilt
        fault = suspect.law
        before = next((e for e in state.effects if (e.law.name, e.site) == (fault.name, suspect.site)), None)
        if before is not None:
            assert isinstance(before.law, SensorFault)
            fault = before.law.followed_by(fault)
        template = next(law for law in laws if law.name == fault.name)
        seen = suspect.witness is not None
        effects = (*(e for e in state.effects if e is not before), Effect(fault, suspect.site, template, seen))
        gain = Gain(state.trial.powers, trial.powers, trial.ruler.informative)
        proposal = Proposal(template, (suspect.site,))
        found.append(Finding(proposal, (fault,), state, gain.value, gain, State(trial, effects, fresh), seen))
    return found


def _alone(ready: Prepared, work: Workspace, laws: Sequence[SensorFault]) -> Iterator[Suspect]:
    """Channels that no other channel of their DOF can contradict, with faults that the balances can show."""
    chosen, _ = longest(work)
    record = ready.records[chosen]
    kinds = {j: [k for k in "avx" if f"{k}{j}" in record.measured] for j in range(1, record.n_dof + 1)}
    n = work.n_dof
    single = [f"{held[0]}{j}" for j, held in kinds.items() if len(held) == 1]
    forces = [f"F{j}" for j in work.forced]
    for law in laws:
        channels = single + forces
        if not law.acts_on_derivatives:
            continue  # the mean of every column over a fold is taken out
        if law.changes_scale:
            channels = single if n > 1 and work.forced else []
            channels = channels + (forces if len(work.forced) + len(work.known_masses) > 1 else [])
        yield from (Suspect(law, Site(f"sensor {c}")) for c in channels)


def on(trial: Trial, data: SegmentSet) -> Trial:
    """The same laws on the same rows of other motions."""
    ruler = trial.ruler
    work, windows = ruler.work.with_data(data), ruler.windows
    moved = Windows(data, work.search, windows.length, windows.edges, windows.centred)
    if len(moved.blocks) != len(windows.blocks):
        raise NRFError("The corrected channels are too short for a fold", "Give longer records.")
    return Trial(Ruler(work, moved, ruler.informative, ruler.clear), trial.base, trial.laws)


def _scanned(trial: Trial, suspect: Suspect) -> tuple[float, Suspect] | None:
    """The best value of a fault and its gain; None if two trials promise too little."""
    work = trial.ruler.work
    kind, j = suspect.site.channel[0], int(suspect.site.channel[1:])
    step, reach = suspect.law.scan
    unit = 1.0 / pace(work, j) if suspect.law.terms()[0].unit == "s" else 1.0

    def gain(value: float) -> float:
        law = suspect.law.with_values([value])
        try:
            data = SegmentSet([_shifted(s, kind, j, law) for s in work.data.segments], work.data.n_samples)
            return on(trial, data).gain_over(trial).value
        except NRFError:
            return -np.inf

    h, most = step * unit, reach * unit
    ends = {value: gain(value) for value in (-h, h)}
    if max(ends.values()) < LEAST_GAIN / 4:
        return None
    bounds = (0.0, most) if ends[h] > ends[-h] else (-most, 0.0)
    best = minimize_scalar(lambda x: -max(gain(x), -1e6), bounds=bounds, method="bounded", options={"maxiter": 16})
    if -best.fun < LEAST_GAIN or abs(best.x) < LEAST_SHARE * unit:
        return None
    return -float(best.fun), replace(suspect, law=suspect.law.with_values([float(best.x)]))


def _shifted(seg: Segment, kind: str, dof: int, law: SensorFault) -> Segment:
    """A record in which a force, or the whole motion of a DOF, is freed of a fault."""
    dt = seg.dt or 1.0
    j = dof - 1
    if kind == "F":
        force = np.array(seg.F, dtype=float)
        if np.isfinite(force[:, j]).any() and np.nan_to_num(force[:, j]).any():
            force[:, j] = law.corrected(force[:, j], dt)
        changed = replace(seg, F=force)
    else:
        a, v, s = (np.array(y, dtype=float) for y in (seg.a, seg.v, seg.s))
        x, rate = s[:, :dof].sum(axis=1), v[:, :dof].sum(axis=1)
        a[:, j] = law.corrected(a[:, j], dt)
        for y, change in ((s, law.corrected(x, dt) - x), (v, law.corrected(rate, dt) - rate)):
            y[:, j] += change
            if dof < seg.n_dof:
                y[:, j + 1] -= change
        changed = replace(seg, a=a, v=v, s=s)
    known = np.isfinite(seg.F[seg.valid]).all(axis=0)
    finite = np.isfinite(np.hstack([changed.a, changed.v, changed.s, changed.F[:, known]])).all(axis=1)
    inside = np.flatnonzero(finite[seg.valid])
    start = seg.valid.start
    return replace(changed, valid=slice(start + int(inside[0]), start + int(inside[-1]) + 1))


def _rebuilt(ready: Prepared, trial: Trial, suspect: Suspect) -> tuple[Prepared, Trial] | None:
    """Everything again from the corrected records: fusion (which forces take no part in), columns, powers."""
    held = ready.heldout or []
    work = trial.ruler.work
    kind, j = suspect.site.channel[0], int(suspect.site.channel[1:])
    try:
        records = [as_true(r, suspect.site, suspect.law) for r in ready.records]
        if kind == "F":
            data = SegmentSet([_shifted(s, kind, j, suspect.law) for s in work.data.segments], work.data.n_samples)
            fresh: Any = replace(ready, records=records, data=data)
        else:
            mine = [i for i in range(len(records)) if i not in held]
            bands = [ready.bands[i] for i in [*mine, *held]] if ready.bands else None
            fresh = prepare([records[i] for i in mine], [records[i] for i in held] if held else None, bands=bands)
        return fresh, on(trial, fresh.data)
    except (NRFError, np.linalg.LinAlgError):  # the corrected channels cannot be fused
        return None


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
    found = [s.witness for size, s in contradictory(ready, work) if size >= LEAST_SHARE and s.witness is not None]
    return list(dict.fromkeys(found[:SUSPECTS]))


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
            if size < LEAST_SHARE or (any(x > 0 for x in seen) and any(x < 0 for x in seen)):
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
