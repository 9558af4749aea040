"""Faulty sensors as undeclared effects: channels that are late, wrongly scaled, or have a wrong zero.

A fault of a sensor is not a force: it changes the channels from which every column is built, and
the fusion that mixes them. So a candidate corrects the channel and the same model is solved again
on what follows. Where a DOF has several kinds of channels their contradiction gives the fault
(:func:`pysindy_nrf.signals.alignment.channel_alignment`) and the balances say which of them is wrong; where
it has one, and for forces, the fault is found from the balances alone.

What the data cannot show is not tried: the gain of the only force where no mass is known (it scales the
chain), the gain of the only DOF, the zero of x1 (a constant force on DOF 1).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from ..common.jackknife import variance
from ..exceptions import NRFError
from ..laws.sensor import SensorFault
from ..mechanics.sites import Site
from ..regression.segments import BlockRows, Segment, SegmentSet
from ..simulation.api import as_true
from .catalogue import Candidate
from .contradictions import CONTRADICTION, MOST, Suspect, contradictory, longest, pace
from .gate import MIN_GAIN, TIE
from .prepare import Prepared, prepare
from .search import Finding
from .stage import Stage
from .verdicts import Contradiction
from .workspace import Workspace

# Gain that is asked where the channels themselves bear witness.
_WITNESSED = 0.05
# Share to which the error must have fallen before a fault that explained nothing is tried again.
_AGAIN = 0.5
# How far, as a share, the value of such a fault may be off, and trials to mend it.
_ROUGH = 0.2
_TRIALS = 7
# The same of a fault that was corrected before other effects were known; blocks that tell its interval.
_LATER, _FEWEST = 0.5, 3
# Fall of the error that a parabola through three trials must promise; faults that are rebuilt from the records.
_PROMISE = 0.05
# Fall of the error that the fused motion must show before everything is built again: the gate asks for more still.
_WORTH = 0.1
_REBUILT = 2
# Baseline error, percent, above which a fault may be too large for a parabola; shares of its reach tried then.
_WILD = 20.0
_COARSE = np.array([-0.6, -0.25, 0.25, 0.6])


@dataclass
class SensorFinding(Finding):
    """A faulty sensor, with everything that follows from the corrected channel.

    Attributes
    ----------
    ready : Prepared
    stage : Stage
        The same laws on the corrected records.
    equals : list of str
        Sensors of which the data could accuse one as well as this.
    witness : Contradiction or None
        Channels of its DOF that contradict each other.
    """

    ready: Prepared | None = None
    stage: Stage | None = None
    equals: list[str] = field(default_factory=list)
    witness: Contradiction | None = None

    @property
    def least(self) -> float:
        """Gain that the gate asks: less where the channels themselves bear witness, whatever the model."""
        return _WITNESSED if self.witness else MIN_GAIN

    def on(self, stage: Stage) -> Stage:
        """The current laws on the corrected channels."""
        assert self.stage is not None
        return self.stage


def sensor_findings(
    ready: Prepared,
    work: Workspace,
    stage: Stage,
    laws: Sequence[SensorFault],
    corrected: Collection[tuple[str, str]] = (),
) -> list[SensorFinding]:
    """Faulty sensors that lower the error, validated, best first."""
    if not laws:
        return []
    kinds = tuple(type(law) for law in laws)
    now = stage.trial().search_error()
    promising: list[tuple[float, Suspect]] = []
    seen = contradictory(ready, work)
    against = [s for size, s in seen if isinstance(s.law, kinds) and size >= CONTRADICTION][:MOST]
    for suspect in _alone(ready, work, laws):
        best = _scan(work, stage, suspect, now)
        if best is not None:
            promising.append(best)
    promising.sort(key=lambda p: p[0])
    found = [_tried(ready, work, stage, s, now) for s in against]
    found += [_rebuilt(ready, work, stage, s) for _, s in promising[:_REBUILT]]
    kept = sorted((f for f in found if f is not None and f.screen < now), key=lambda f: f.error)
    if kept and kept[0].witness and kept[0].screen < (1 - _WITNESSED) * now:
        kept[0] = _sharpened(ready, work, stage, kept[0])
    alone = len(work.forced) == 1 and bool(work.known_masses)  # one force is the scale of the whole chain
    near = [f for f in kept if f.error <= (1 + TIE) * kept[0].error]
    for one in near:
        one.equals = [str(o.site) for o in near if o.law.name == one.law.name and o.site != one.site]
        scales = isinstance(one.law, SensorFault) and one.law.changes_scale
        if alone and scales and one.site.channel[0] == "F":
            one.equals.append("the known masses (all alike)")
    again = {f.law.name: str(f.site) for f in reversed(near) if (f.law.name, str(f.site)) in corrected}
    return [f for f in kept if all(f is not o for o in near) or again.get(f.law.name, str(f.site)) == str(f.site)]


def sharpened_again(
    ready: Prepared, work: Workspace, stage: Stage, law: SensorFault, site: Site
) -> tuple[SensorFinding, float] | None:
    """What is left of a fault that was corrected before other effects were known."""
    scale = abs(float(law.values[0]))
    tried: dict[float, SensorFinding] = {}

    def cost(value: float) -> float:
        one = _rebuilt(ready, work, stage, Suspect(law.with_values([value]), site))
        if one is None:
            return 1e6
        tried[value] = one
        return one.screen

    reach = _LATER * scale
    options = {"xatol": 0.005 * scale, "maxiter": 2 * _TRIALS}
    minimize_scalar(cost, bounds=(-reach, reach), method="bounded", options=options)
    if not tried:
        return None
    best = min(tried, key=lambda value: tried[value].screen)
    ends = (best - 0.1 * scale, best + 0.1 * scale)
    if max(cost(end) for end in ends) >= 1e6:
        return None
    low, mid, high = (tried[value].folds ** 2 for value in (ends[0], best, ends[1]))
    # squared errors are a parabola near the best value; where its top lies without each block in turn
    slope, curve = (np.sum(y) - y for y in ((high - low) / 2, high - 2 * mid + low))
    if (curve <= 0).any() or len(mid) < _FEWEST:
        return None
    tops = -slope / curve * 0.1 * scale
    return tried[best], float(student.ppf(0.975, len(tops) - 1) * np.sqrt(variance(tops[:, None])[0]))


def null_gain(stage: Stage, finding: SensorFinding) -> float:
    """Fall of the error that the same fault promises on data without it, as a share."""
    if finding.witness:
        return 0.0  # the channels contradict each other, whatever the model
    assert isinstance(finding.law, SensorFault)
    now = stage.trial().search_error()
    best = _scan(stage.work, stage, Suspect(finding.law, finding.site), now)
    return 0.0 if best is None else 1.0 - best[0] / now


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
            channels = [f"x{j}" for j in range(2, n + 1) if "x" in kinds[j]]
        elif law.changes_scale:
            channels = single if n > 1 and work.forced else []
            channels = channels + (forces if len(work.forced) + len(work.known_masses) > 1 else [])
        yield from (Suspect(law, Site(f"sensor {c}")) for c in channels)


# -- from the balances alone ----------------------------------------------------------------------


def _scan(work: Workspace, stage: Stage, suspect: Suspect, now: float) -> tuple[float, Suspect] | None:
    """The best value of a fault and its error; None if a parabola through three trials promises too little."""
    kind, j = suspect.site.channel[0], int(suspect.site.channel[1:])
    step, reach = suspect.law.scan
    measure = suspect.law.terms()[0].unit
    unit = 1.0 / pace(work, j) if measure == "s" else 1.0 if measure == "1" else work.scales(Site(f"ground {j}"))[0]

    def cost(value: float) -> float:
        law = suspect.law.with_values([value])
        try:
            moved = _with_segments(work, [_shifted(s, kind, j, law) for s in work.data.segments])
            return min(Stage(moved, stage.chain, stage.laws).trial().search_error(), 1e6)
        except NRFError:
            return 1e6

    h, most = step * unit, reach * unit
    low, high = cost(-h), cost(h)
    # squared errors are a parabola in a small fault
    curve, slope = (low**2 + high**2) / 2 - now**2, (high**2 - low**2) / 2
    promise = slope**2 / (4 * curve) if curve > 0 else np.inf
    wide: tuple[float, float] | None = None  # where to look again if the best value lies at an end
    inner: list[float]
    if min(low, high) < now and promise >= (1 - (1 - _PROMISE) ** 2) * now**2:
        ends = (0.0, most) if high < low else (-most, 0.0)
        guess = 2.0 * (-slope / (2 * curve) * h) if curve > 0 else sum(ends)
        wide, inner = ends, sorted((0.0, float(np.clip(guess, *ends)) or sum(ends)))
    elif now > _WILD:  # a fault so large that nothing is straight near zero
        trials = [x for x in [*(most * _COARSE), *_means(work, suspect)] if abs(x) <= most]
        costs = [cost(x) for x in trials]
        if min(costs) > now * (1 - _PROMISE):
            return None
        near = trials[int(np.argmin(costs))]
        inner = sorted((0.5 * near, 1.7 * near))
    else:
        return None
    best = minimize_scalar(cost, bounds=inner, method="bounded", options={"xatol": 0.01 * h, "maxiter": 16})
    if wide is not None and abs(best.x) > 0.9 * max(map(abs, inner)):
        best = minimize_scalar(cost, bounds=wide, method="bounded", options={"xatol": 0.01 * h, "maxiter": 24})
    if not best.fun < now * (1 - _WORTH):
        return None
    return float(best.fun), replace(suspect, law=suspect.law.with_values([float(best.x)]))


def _means(work: Workspace, suspect: Suspect) -> list[float]:
    """The mean of a displacement, from which an offset of its sensor is not far."""
    if suspect.law.acts_on_derivatives:
        return []
    i, rows = longest(work)
    return [float(work.data.segments[i].s[rows, : int(suspect.site.channel[1:])].sum(axis=1).mean())]


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
        moved = (a[:, j], rate)
        if law.acts_on_derivatives:
            moved = law.corrected(a[:, j], dt), law.corrected(rate, dt)
        new = law.corrected(x, dt)
        a[:, j] = moved[0]
        for y, change in ((s, new - x), (v, moved[1] - rate)):
            y[:, j] += change
            if dof < seg.n_dof:
                y[:, j + 1] -= change
        changed = replace(seg, a=a, v=v, s=s)
    force_known = np.isfinite(seg.F[seg.valid]).all(axis=0)
    every = np.hstack([changed.a, changed.v, changed.s, changed.F[:, force_known]])
    finite = np.isfinite(every).all(axis=1)
    inside = np.flatnonzero(finite[seg.valid])
    start = seg.valid.start
    return replace(changed, valid=slice(start + int(inside[0]), start + int(inside[-1]) + 1))


def _with_segments(work: Workspace, segments: Sequence[Segment]) -> Workspace:
    """The workspace of other motions, with the same blocks of the same rows."""
    data = SegmentSet(list(segments), work.data.n_samples)

    def same(blocks: Sequence[BlockRows]) -> list[BlockRows]:
        out = []
        for b in blocks:
            old, new = work.data.segments[b.segment].valid, data.segments[b.segment].valid
            length = new.stop - new.start
            ends = (int(np.clip(r + old.start - new.start, 0, length)) for r in (b.rows.start, b.rows.stop))
            out.append(BlockRows(b.segment, slice(*ends)))
        return out

    return Workspace(data, work.filters, same(work.search), same(work.held), work.known_masses, work.strategy)


# -- from the records -----------------------------------------------------------------------------


def _tried(ready: Prepared, work: Workspace, stage: Stage, suspect: Suspect, now: float) -> SensorFinding | None:
    """A fault that the channels tell, once the model is so good that it could show; refused, not again before."""
    key = suspect.law.name, str(suspect.site)
    if now > _AGAIN * ready.refused.get(key, np.inf):
        return None
    found = _rebuilt(ready, work, stage, suspect)
    if found is None or not found.screen < now:
        ready.refused[key] = now
    return found


def _rebuilt(ready: Prepared, work: Workspace, stage: Stage, suspect: Suspect) -> SensorFinding | None:
    """Everything again from the corrected records: fusion (which forces take no part in), columns, errors."""
    held = ready.heldout or []
    kind, j = suspect.site.channel[0], int(suspect.site.channel[1:])
    try:
        records = [as_true(r, suspect.site, suspect.law) for r in ready.records]
        if kind == "F":
            segments = [_shifted(s, kind, j, suspect.law) for s in work.data.segments]
            fresh = replace(ready, records=records, data=SegmentSet(segments, work.data.n_samples))
        else:
            mine = [i for i in range(len(records)) if i not in held]
            bands = [ready.bands[i] for i in [*mine, *held]] if ready.bands else None
            fresh = prepare([records[i] for i in mine], [records[i] for i in held] if held else None, bands=bands)
        moved = _with_segments(work, fresh.data.segments)
        after = Stage(moved, stage.chain, stage.laws)
        trial = after.trial()
        screen, folds = trial.search_error(), trial.fold_errors()
    except (NRFError, np.linalg.LinAlgError):  # the corrected channels cannot be fused
        return None
    candidate = Candidate(suspect.law, suspect.site)
    return SensorFinding(
        candidate, suspect.law, screen, folds=folds, ready=fresh, stage=after, witness=suspect.witness
    )


def _sharpened(ready: Prepared, work: Workspace, stage: Stage, finding: SensorFinding) -> SensorFinding:
    """A fault that the channels told roughly, as the balances want it."""
    assert isinstance(finding.law, SensorFault)
    fault, best = finding.law, finding
    rough = float(fault.parameters[fault.terms()[0].symbol] or 0.0)

    def cost(value: float) -> float:
        nonlocal best
        one = _rebuilt(ready, work, stage, Suspect(fault.with_values([value]), finding.site, finding.witness))
        if one is None:
            return 1e6
        best = min(best, one, key=lambda f: f.screen)
        return one.screen

    reach = _ROUGH * abs(rough)
    minimize_scalar(
        cost,
        bounds=(rough - reach, rough + reach),
        method="bounded",
        options={"xatol": 0.01 * reach, "maxiter": _TRIALS},
    )
    return best


__all__ = ["SensorFinding", "null_gain", "sensor_findings", "sharpened_again"]
