"""The end of the search: confirmation on held-out data, intervals, certainty,
safeguards, the report.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from .. import laws
from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..diagnosis.site_loops import loops_of
from ..diagnosis.verdict import FreeRuns
from ..equations.errors import free_run_by_either
from ..equations.normal_equations import variance
from ..exceptions import NRFError
from ..identification.fewer_sensors import Linearised, estimate, negative, shot_of, told
from ..identification.intervals import parameters_of
from ..identification.output_error import (
    FreeRunFit,
    Rebuild,
    Shot,
    Solution,
    free_parameters,
)
from ..identification.problem import Problem
from ..records.checks.channel_checks import measured
from ..records.record import Record
from . import judge, words
from .catalogue import as_laws, balances_of, candidates, general_laws
from .constants import (
    BY_NOISE,
    CLAIMED,
    COMPLETE,
    HOPELESS,
    LARGE_GAIN,
    LEAST_GAIN,
    PERIODS,
    TENTH,
)
from .evidence import look
from .prepare import MOST, Workspace, measured_of
from .report import LoopReport, Step, audit
from .residual import floor_of, searched, simulated
from .ruler import ChannelRuler, ChannelWork, Gain, Laws, Powers, Ruler, Slot, Trial
from .search import Forward, Search
from .sensors import SUSPECTS
from .state import Axes, Effect, Finding, Proposal, State
from .windows import ChannelWindows, split, window_length

LEVEL = 0.95
# Draws of noise, of which one tells what it leaves of a balance to a fifth: 0.8 to 1.3
# of the mean.
FLOORS, LEAST_DRAW = 4, 0.8
RUN = 3 * MOST  # samples of free runs from the start of a record: unstable models crawl


@dataclass(eq=False)
class Stand:
    """A model on the way to the last one, judged on the search and on held-out data."""

    name: str
    trial: Trial
    held: Powers
    row: dict[str, float]

    @property
    def error(self) -> float:
        """Pooled held-out error, percent."""
        return self.row["held-out"]


def concluded(
    forward: Forward,
    first: State,
    settings: Mapping[str, Any],
    rng: np.random.Generator,
) -> LoopReport:
    """The report of a search that has come to its end; the held-out data are read
    here.
    """
    instants = [
        float(e.law.shape[p.name] or 0.0)
        for e in forward.state.effects
        for p in e.law.shapes
        if p.instant
    ]
    for ruler in (first.trial.ruler, *forward.rulers.values()):
        ruler.work.leave_out(
            instants, ruler.windows.length / 2
        )  # the ends of a fold show next to nothing
    last = forward.state.trial
    last.ruler.grams(last)  # these products serve all smaller models below
    last.powers_on(last.ruler.held)
    baseline = confirmed = _stand("baseline", first.trial)
    trials, found, held = [first.trial], {}, dict[Effect, tuple[Stand, Stand]]()
    for effect in (
        forward.state.effects
    ):  # what the search says: each effect beside all those found before it
        with suppress(NRFError):
            found[effect] = _pair(forward, trials[-1], effect)
            trials.append(found[effect][1])
    waiting = list(found)
    while (
        waiting
    ):  # what held-out data do not confirm alone may be confirmed beside the rest
        refused = []
        for effect in waiting:
            held.pop(
                effect, None
            )  # they stand in the order in which they are confirmed
            held[effect] = pair = _judged(forward, confirmed, effect)
            if _confirms(effect, *pair):
                confirmed = pair[1]
            else:
                refused.append(effect)
        group = (
            _together(forward, confirmed, refused)
            if len(refused) == len(waiting)
            else {}
        )
        held = {e: pair for e, pair in held.items() if e not in group} | group
        confirmed = [confirmed, *(after for _, after in group.values())][-1]
        waiting = (
            [e for e in refused if e not in group]
            if group or len(refused) < len(waiting)
            else []
        )
    steps = [
        _step(forward.rivals.get(effect, []), effect, *held[effect], found[effect])
        for effect in held
    ]
    stands = [baseline, *(after for _, after in held.values())]
    at = stands.index(confirmed)
    stopped = words.best_refused(forward.last[0] if forward.last else None)
    if len(forward.state.effects) >= (most := settings["max_steps"]):
        stopped = (
            f"{most} effects were added, as many as max_steps allows"
            if most
            else "no effect was asked for"
        )
    if not trials[-1].ruler.windows.centred:
        stopped += f". {words.MEANS_LEFT_IN}" if len(steps) > 1 else ""
        for stand in stands:  # one ruler for the table
            stand.row |= _of_search(_as_measured(stand.trial))
    if not confirmed.trial.ruler.windows.centred:
        stands = [_stand(stand.name, _as_measured(stand.trial)) for stand in stands]
    unfit = _no_claim(trials[-1])
    no_claim = unfit or _no_claim(confirmed.trial)
    if no_claim:
        stopped, at = f"{no_claim}. Nothing is claimed", 0
        steps, stands = (
            ([], stands[:1])
            if unfit
            else ([replace(s, confirmed=False) for s in steps], stands)
        )
    confirmed = stands[at]
    assert forward.state.ready is not None
    draws = (
        ruler
        for _, ruler in simulated(
            forward.state.ready, confirmed.trial.on_part(), rng, FLOORS
        )
    )
    noise = next(draws, None)
    beyond = _say_how_sure(
        steps, confirmed, draws if noise is None else chain([noise], draws)
    )
    fewer = len(forward.state.effects) < settings["max_steps"] and not no_claim
    general = _general(confirmed, forward, fewer or any(step.sure for step in steps))
    there = general[general["there"]]
    stopped += f". {words.not_in_catalogue(there)}" if len(there) and fewer else ""
    for step in steps:  # no name is sure where a law is lacking
        step.sure &= balances_of(Site(step.site)) not in [
            balances_of(Site(site)) for site, _ in there.index
        ]
    work, ready = confirmed.trial.ruler.work, forward.whole or forward.state.ready
    if ready.contradictions:
        stopped += f". {words.contradictions([s.witness for s in ready.contradictions[:SUSPECTS]])}"
    report = _report(steps, stands, at, stopped, first.trial.ruler.band(), forward.last)
    model, floor = (
        report.model,
        floor_of(report.model, None if noise is None else noise.work),
    )
    for site in model.laws:
        s, v = work.along(site)
        model.visited[Site(site)] = VisitedRegion.of(v, s)
    each = zip(stands, report.models, [*(step.site for step in steps), ""])
    report.evidence = [
        look(s.trial.ruler.work, m, s.name, site, floor) for s, m, site in each
    ]
    report.measured, report.loops = measured_of(ready), loops_of(model, *searched(work))
    report.settings = audit(settings, [ready.records[i] for i in ready.heldout or ()])
    report.lack_of_fit, report.beyond_noise = general.drop(columns="there"), beyond
    report.bounds = _bounds(confirmed.trial)
    report.claims_nothing = bool(no_claim)
    return report


def _general(final: Stand, forward: Forward, asked: bool) -> pd.DataFrame:
    """What the general laws still gain at each storey and tie, dB; where ``asked``,
    whether errors explain it.
    """
    trial = final.trial.on_part()
    rows = []
    for site in trial.chain.sites:
        for law in general_laws(trial.ruler.work, site):
            try:
                after = trial.with_laws([(site, law)])
            except NRFError:  # its columns depend on those of the model
                continue
            gain = after.gain_over(trial)
            there = (
                asked
                and judge.is_there(gain)
                and gain.bound > 0
                and forward.beyond_errors(after, trial, law)[1]
            )
            words_of = (
                "a function of drift and rate"
                if not law.has_memory
                else "a hysteresis of sliders"
            )
            rows.append((str(site), words_of, gain.value, gain.error, there))
    columns = ["site", "general law", "gain (dB)", "standard error", "there"]
    return pd.DataFrame(rows, columns=columns).set_index(columns[:2])


def _pair(forward: Forward, trial: Trial, effect: Effect) -> tuple[Trial, Trial]:
    """A model and the same with one effect more, on one ruler; a fault only changes the
    records.
    """
    if effect.is_fault:
        ruler = forward.rulers[effect]
        ruler = ruler if trial.ruler.windows.centred else ruler.as_measured()
        return trial, Trial(ruler, trial.base, trial.laws)
    if effect.law.variable == "1":  # the means alone show a constant force
        trial = _as_measured(trial)
    return trial, trial.with_laws([(effect.site, effect.law)])


def _judged(forward: Forward, confirmed: Stand, effect: Effect) -> tuple[Stand, Stand]:
    """The confirmed model and the same with one effect more, judged on the held-out
    data.
    """
    name = f"{effect.law.name} at {effect.site}"
    try:
        before, after = _pair(forward, confirmed.trial, effect)
    except NRFError:  # its columns depend on those of the model
        return confirmed, replace(confirmed, name=name)
    return (
        confirmed if before is confirmed.trial else _stand(confirmed.name, before)
    ), _stand(name, after)


def _confirms(effect: Effect, before: Stand, after: Stand) -> bool:
    """Whether the held-out error falls, and what is left, there or in the search, by a
    tenth.
    """
    gain = after.trial.gain_over(before.trial)
    least = LEAST_GAIN if after.error <= (1.0 - TENTH) * before.error else CLAIMED
    return bool(after.error < before.error and judge.is_there(gain, effect.law, least))


def _together(
    forward: Forward, confirmed: Stand, some: list[Effect]
) -> dict[Effect, tuple[Stand, Stand]]:
    """Effects of which none is confirmed alone, each judged beside the others: errors
    pass to the storey below.
    """
    pairs, effects = (
        dict[Effect, tuple[Stand, Stand]](),
        [e for e in some if not e.is_fault and e.law.variable != "1"],
    )
    with suppress(NRFError):  # columns may depend on each other
        while len(effects) > 1 and len(pairs) != len(effects):
            others = [[(o.site, o.law) for o in effects if o is not e] for e in effects]
            stands = [
                _stand(confirmed.name, confirmed.trial.with_laws(placed))
                for placed in others
            ]
            pairs = {e: _judged(forward, stand, e) for e, stand in zip(effects, stands)}
            effects = [e for e in effects if _confirms(e, *pairs[e])]
    return pairs if effects and len(pairs) == len(effects) else {}


def _stand(name: str, trial: Trial) -> Stand:
    """A trial judged on the search and on the held-out data."""
    ruler, held = trial.ruler, trial.ruler.held
    powers, usual = trial.powers_on(held), ruler.clear_power(trial.powers.reference)
    undriven = (
        held.clear_power(powers.reference) / held.windows.size
        < TENTH * usual / ruler.windows.size
    )
    row = _of_search(trial) | {
        "held-out": held.error(powers, usual),
        "free run": free_run_error(trial.model(), ruler.work),
        **{
            f"held-out dof {j}": float(e)
            for j, e in enumerate(np.where(undriven, np.nan, held.errors(powers)), 1)
        },
    }
    return Stand(name, trial, powers, row)


def _of_search(trial: Trial) -> dict[str, float]:
    """The errors on the search data, of the fit and of each fold left out of it,
    percent.
    """
    within = Powers(trial.within[None], trial.powers.reference)
    return {
        "search": trial.ruler.error(within),
        "validation": trial.ruler.error(trial.powers),
    }


def _as_measured(trial: Trial) -> Trial:
    """The same model with the means left in."""
    if trial.ruler.windows.centred:
        with suppress(NRFError):
            return Trial(trial.ruler.as_measured(), trial.base, trial.laws)
    return trial


def _step(
    rivals: Sequence[Finding],
    effect: Effect,
    before: Stand,
    after: Stand,
    pair: tuple[Trial, Trial],
) -> Step:
    """One effect: what the search says of it, beside those found before it, and what
    held-out data say of it.
    """
    site, (old, trial) = effect.site, pair
    gain = trial.gain_over(old)
    held = Gain(before.held, after.held, before.trial.ruler.informative)
    families = [f.family for f in rivals]
    if not effect.is_fault:
        low, high = trial.ruler.band()
        families.insert(
            0,
            effect.law.limit(
                trial.ruler.work.scales(site)[0], (low or 0.0, high or np.inf)
            ),
        )
    if effect.law.variable == "1":
        families = ["sensor"]  # the wrong zero of a displacement is the same
    others = [
        family for family in dict.fromkeys(families) if family != effect.law.family
    ]
    step = Step(
        effect.law.name,
        effect.law.family,
        str(site),
        shape=dict(effect.law.shape),
        alternatives=others[:2],
        error_before=before.error,
        error_after=after.error,
        free_run_before=before.row["free run"],
        free_run_after=after.row["free run"],
        validation_before=old.ruler.error(old.powers),
        gain=gain.value,
        gain_error=gain.error,
        gain_least=gain.least,
        gain_heldout=held.value,
        confirmed=_confirms(effect, before, after),
        tied=[
            (
                f.proposal.law.name,
                ", ".join(map(str, f.proposal.sites)),
                f.gain.value if f.gain else np.nan,
            )
            for f in rivals
        ],
    )
    if effect.is_fault:
        step.sure, fitted = effect.witnessed and gain.bound > 0, effect.law
        step.sensors = [
            str(f.proposal.sites[0])
            for f in rivals
            if f.is_fault and f.proposal.law.name == effect.law.name
        ]
    else:
        laws = trial.model().laws[site]
        fitted = next(law for law in reversed(laws) if law.name == effect.law.name)
        step.sure = gain.bound > 0 and all(
            (fitted.parameters[c] or 0.0) >= 0 for c in fitted.nonnegative
        )
        step.intervals = _intervals(trial, effect)
        step.share = judge.share_of(trial, trial.without(site, effect.law), site)
    step.parameters, step.units = dict(fitted.parameters), fitted.units
    step.evidence = words.acceptance(step)
    return step


def _intervals(trial: Trial, effect: Effect) -> dict[str, tuple[float, float]]:
    """95 % intervals by the jackknife over folds (Efron 1982; see `_by_folds`), those
    of shapes by derivatives.
    """
    law, site = effect.law, effect.site
    base = trial.without(site, law)
    axes = Axes(effect.template, trial.ruler.work, [site])
    width = len(law.terms())
    at = trial.layout.slices[site].stop - width
    values = trial.theta[0, at : at + width]
    columns = [trial.ruler.columns(site, [law])]
    centre = axes.point(law)
    free = 0 if axes.instant else len(centre)
    for k in range(free):
        h = 2e-3 * (axes.high[k] - axes.low[k])
        h = -h if centre[k] + h > axes.high[k] else h
        moved = axes.at(centre + h * np.eye(len(centre))[k])[0]
        columns.append(
            (values @ (trial.ruler.columns(site, [moved]) - columns[0]) / h)[None]
        )
    try:
        parts = Slot(base, [(site, law)], extra=free).left_out(np.vstack(columns))
    except NRFError:
        return {}
    if not np.isfinite(parts).all():
        return {}
    half = student.ppf(0.5 + LEVEL / 2, len(parts) - 1) * np.sqrt(variance(parts))
    out = {
        t.symbol: (float(x - half[k]), float(x + half[k]))
        for k, (t, x) in enumerate(zip(law.terms(), values))
    }
    for k, shape in enumerate(axes.shapes):
        around = (
            centre[k] + np.array([-1, 1]) * half[width + k]
            if free
            else np.ravel(axes.told(centre))
        )
        ends = axes.scales[0].values(around, k)
        out[shape.name] = (float(ends[0]), float(ends[1]))
    return out


def _bounds(trial: Trial) -> dict[str, tuple[float, float]]:
    """95 % intervals of masses and coefficients by name, from fold to fold."""
    known = trial.ruler.work.known_masses
    found = pd.DataFrame(
        [
            parameters_of(trial.model(m, c), known)
            for m, c in zip(trial.masses, trial.theta)
        ]
    )
    half = student.ppf(0.5 + LEVEL / 2, max(len(found) - 2, 1)) * np.sqrt(
        variance(found.iloc[1:])
    )
    return {
        name: (x - h, x + h)
        for name, x, h in zip(found, found.iloc[0].astype(float), half)
        if np.isfinite(h)
    }


def _no_claim(trial: Trial) -> str:
    """Why nothing may be claimed; empty if something may."""
    model, known, left = trial.model(), trial.ruler.work.known_masses, trial.left
    if np.nanmax(left) >= HOPELESS:
        return words.hopeless(left)
    if any(m <= 0 and j not in known for j, m in enumerate(model.masses, 1)):
        return words.negative_masses(model.masses)
    total = model.total_masses
    cancelled = [j for j, m in known.items() if m > 0 and total[j - 1] <= TENTH * m]
    return words.cancelled_masses(cancelled) if cancelled else ""


def _say_how_sure(
    steps: list[Step], final: Stand, noises: Iterable[Ruler]
) -> np.ndarray:
    """Say how much of an effect its worst balance keeps, and if its name is sure."""
    trial, at = final.trial, [Site(step.site) for step in steps]
    left = trial.ruler.errors(trial.powers)
    wholes = []
    for step, site in zip(steps, at):
        own = [
            j
            for j in range(len(left))
            if site.kind != "sensor" and site.incidence(j + 1)
        ] or np.arange(len(left))
        wholes.append(
            max(step.validation_before, float(np.sqrt(np.mean(left[own] ** 2))), 1e-300)
        )
        there = (
            s
            for s, other in zip(steps, at)
            if s is not step and balances_of(other) == balances_of(site)
        )
        step.company = [s.law for s in there if s.confirmed]
        step.sure &= step.confirmed and not (step.alternatives or step.company)
    most = COMPLETE * max(
        (whole for step, whole in zip(steps, wholes) if step.sure), default=0.0
    )
    floors: list[np.ndarray] = []

    def beyond(share: float) -> np.ndarray:
        """What is left beyond noise, if the draws so far hold some share of the
        mean.
        """
        floor = np.mean(np.square(floors), axis=0) / share**2 if floors else 0.0
        return np.sqrt(np.maximum(left**2 - BY_NOISE**2 * floor, 0.0))

    for noise in noises:
        with suppress(NRFError):
            floors.append(
                np.nan_to_num(noise.errors(Trial(noise, trial.base, trial.laws).powers))
            )
        if np.nanmax(beyond(LEAST_DRAW)) > most:  # no name can be sure
            break
    for step, whole in zip(steps, wholes):
        step.remainder = float(np.nanmax(beyond(1.0))) / whole
        step.sure &= step.remainder <= COMPLETE
    return beyond(1.0)


def _report(
    steps: list[Step],
    stands: list[Stand],
    at: int,
    stopped: str,
    band: tuple[float | None, float | None],
    last: Sequence[tuple[Finding, Gain]],
) -> LoopReport:
    """The report on models that were judged, of which the one ``at`` holds the
    confirmed effects.
    """
    rows: dict[str, dict[str, float]] = {}
    for stand in stands:
        rows[
            stand.name if stand.name not in rows else f"{stand.name} ({len(rows)})"
        ] = stand.row
    table = pd.DataFrame.from_dict(rows, orient="index").assign(band=words.band(band))
    models = [stand.trial.model() for stand in stands]
    models[at].info = {
        "band": list(band) if any(band) else None,
        "steps": [f"{s.law} at {s.site}" for s in steps if s.confirmed],
        "stopped_because": stopped,
    }
    columns = ["law", "family", "site", "gain (dB)", "standard error", "least"]
    names = [
        [f.proposal.law.name, f.family, ", ".join(map(str, f.proposal.sites))]
        for f, _ in last
    ]
    listed = pd.DataFrame(
        [[*name, g.value, g.error, g.least] for name, (_, g) in zip(names, last)],
        columns=columns,
    )
    return LoopReport(steps, table, stopped, models[at], band, listed, models)


def free_run_error(model: ChainModel, work: Workspace) -> float:
    """Free-run error of the displacements over held-out windows, percent NRMSE; NaN
    where the model cannot run.
    """
    if (model.masses <= 0).any():
        return float("nan")
    top, bottom = np.zeros(model.n_dof), np.zeros(model.n_dof)
    every = -(-sum(b.rows.stop - b.rows.start for b in work.held) // MOST)
    for block in work.held:
        seg = work.data.segments[block.segment]
        if seg.dt is None or np.isnan(seg.F[seg.valid.start]).any():
            return float("nan")
        s = seg.s[seg.valid][block.rows, 0].astype(float)
        crossings = int(
            np.diff(s > s.mean()).sum()
        )  # of the first drift, two in a period
        size = max(8, min(len(s), int(PERIODS * 2 * len(s) / max(1, crossings))))
        for start in range(block.rows.start, block.rows.stop - size + 1, every * size):
            rows = slice(seg.valid.start + start, seg.valid.start + start + size)
            try:
                run = free_run_by_either(model, seg, rows, seg.dt)
            except NRFError:
                return float("nan")
            x = np.cumsum(seg.s[rows], axis=1)
            top += ((run.displacement - x) ** 2).sum(axis=0)
            bottom += ((x - x.mean(axis=0)) ** 2).sum(axis=0)
    return (
        float(100.0 * np.sqrt(np.mean(top / bottom)))
        if (bottom > 0).all()
        else float("nan")
    )


# One law of each kind whose free run takes a second at most (that of a Bouc-Wen law may
# take minutes); others if named.
KINDS = (
    laws.CoulombFriction(),
    laws.QuadraticDamping(),
    laws.DisplacementDependentDamping(),
    laws.QuadraticStiffness(),
    laws.CubicStiffness(),
    laws.OneSidedGap(),
    laws.OneSidedGap(side=-1),
    laws.TwoSidedGap(),
    laws.Jenkins(),
)
SETTLE, STILL = (
    6,
    0.98,
    # linearisations of a model about its own run at most; until it misses this share of
    # before
)
FOLLOWED, REFINED = (
    4,
    25,
    # candidates; steps of the fit of a confirmed model, of which a gap needs more than
    # six
)


class _Course:
    """Models on the way, each linearised about its free run."""

    def __init__(
        self,
        problem: Problem,
        shots: Sequence[Shot],
        search: Search,
        heldout: Any,
        runs: list[Any],
    ) -> None:
        self.problem, self.shots, self.search = problem, shots, search
        self.length = window_length(runs[: heldout[0] if heldout else None])
        self.rows = split(runs, self.length, heldout)
        for block in self.rows[1]:  # no fit reads them
            shots[block.segment].weights[block.rows] = 0.0
        self.informative: Any = None

    def stand(
        self, name: str, model: ChainModel, laws_: Laws, effects: Sequence[Effect] = ()
    ) -> tuple[Stand, State]:
        """A model judged by its free run, and the linear problem about it."""
        work = ChannelWork(
            Linearised(model, self.shots), *self.rows, self.problem.known_masses
        )
        channels, given = self.shots[0].channels, (work.data, work.search, self.length)
        ruler = ChannelRuler(
            work, ChannelWindows(len(channels), *given), self.informative
        )
        if self.informative is None:
            self.informative = ruler.find_channel_bands(
                self.problem.band or (None, None)
            )
        trial = Trial(ruler, self.problem.chain, laws_)
        judged, at = copy(trial), trial.layout.n_terms
        own = np.concatenate(
            [
                *(model.coefficients[site] for site in trial.layout.slices),
                trial.theta[0, at:],
            ]
        )
        judged.masses, judged.theta = (
            np.vstack([model.masses, trial.masses[1:]]),
            np.vstack([own, trial.theta[1:]]),
        )
        judged.powers = ruler.missed(ruler.windows)
        there = ruler.missed(
            ChannelWindows(
                len(channels), work.data, work.held, self.length, ruler.windows.edges
            )
        )
        error = ruler.error(there, ruler.clear_power(judged.powers.reference))
        held = [
            (x * ruler.clear).reshape(len(channels), -1).sum(axis=1)
            for x in (there.residual, there.reference)
        ]
        row = dict.fromkeys(("search", "validation"), ruler.error(judged.powers))
        row |= {"held-out": error, "free run": error}
        row |= {
            f"held-out dof {c[1:]}": float(100 * np.sqrt(a / b))
            for c, a, b in zip(channels, *held)
        }
        return Stand(name, judged, there, row), State(trial, tuple(effects))

    def settled(
        self, name: str, state: State, model: ChainModel | None = None
    ) -> tuple[Stand, State] | None:
        """A model and its shape parameters fitted to the search folds, linearised until
        its run misses no less.
        """
        best: tuple[Stand, State] | None = None
        with suppress(NRFError, np.linalg.LinAlgError):
            for _ in range(SETTLE):
                new = self.stand(
                    name, model or state.trial.model(), state.trial.laws, state.effects
                )
                old, now = (
                    s.trial.powers.residual.sum() for s in ((best or new)[0], new[0])
                )
                slow, best = (
                    best is not None and now > STILL * old,
                    (new if best is None or now < old else best),
                )
                if slow:
                    break
                state, model = self.search.polished(new[1]), None
        return best

    def fitted(
        self, model: ChainModel, state: State, steps: int
    ) -> tuple[Solution, Rebuild, list[Effect]]:
        """A model fitted to all rows that are not held out, by the sensitivities and
        initial states of its free run.
        """
        at = {e: (e.site, state.trial.laws[e.site].index(e.law)) for e in state.effects}
        shapes = [
            (*at[e], p)
            for e in at
            for p in e.law.shapes
            if e.template.shape[p.name] is None
        ]
        rebuild = free_parameters(model, self.problem.known_masses, shapes=shapes)
        used, layout = (
            [shot for shot in self.shots if shot.weights.any()],
            LawLayout(model.chain, model.laws),
        )
        fit = FreeRunFit(rebuild, used, layout, self.problem.band)
        best = fit.solve(rebuild.start, steps=steps, move=True)
        return (
            best,
            rebuild,
            [replace(e, law=best.model.laws[site][i]) for e, (site, i) in at.items()],
        )

    def refined(self, stand: Stand, state: State) -> tuple[Stand, State]:
        """A model that is settled, fitted by its free run, if this misses less."""
        with suppress(NRFError):
            best, _, effects = self.fitted(stand.trial.model(), state, REFINED)
            new = self.stand(stand.name, best.model, best.model.laws, effects)
            if new[0].trial.gain_over(stand.trial).value > 0:
                return new
        return stand, state


def by_channels(
    mine: Sequence[Record],
    kept: Sequence[Record],
    problem: Problem,
    catalogue: Any,
    settings: dict[str, Any],
) -> LoopReport:
    """The loop on records in which floors have no sensor.

    Candidates are ranked by what their force would do to the measured channels, along
    the free run and to first order; the best are settled, and one is taken by how much
    less its free run misses.
    """
    every, known = [*mine, *kept], problem.known_masses
    heldout = list(range(len(mine), len(every))) if kept else None
    shots = [shot_of(rec, i, problem.chain.n_dof) for i, rec in enumerate(every)]
    fit, found, notes = estimate(problem, shots[: len(mine)], known)
    shots = [
        *fit.shots,
        *(replace(shot, hold=fit.shots[0].hold) for shot in shots[len(mine) :]),
    ]
    names = tuple(
        c for c in mine[0].covariates if all(c in rec.covariates for rec in every)
    )
    tried = [
        law
        for law in as_laws(KINDS if catalogue is None else catalogue, names)
        if not any(p.is_frequency for p in law.shapes)
    ]
    forced = sorted({j for rec in mine for j in rec.forced})
    placed = candidates(tried, problem.chain, known, names, forced, len(mine))
    proposals = [Proposal(law, (site,)) for law, site in placed]
    course = _Course(
        problem,
        shots,
        Search(proposals),
        heldout,
        [shot.run(found.model) for shot in shots],
    )
    first = course.stand("baseline", found.model, found.model.laws)
    model = course.fitted(found.model, first[1], REFINED)[0].model
    stand, state = course.settled("baseline", first[1], model) or course.stand(
        "baseline", model, model.laws
    )
    stands, last = [stand], []
    steps: list[Step] = []
    while len(steps) < settings["max_steps"]:
        pairs = []
        for f in course.search.candidates(state, 1)[:FOLLOWED]:
            if f.after is not None and (
                after := course.settled(f.proposal.name, f.after)
            ):
                gain = after[0].trial.gain_over(stand.trial)
                pairs.append((replace(f, after=after[1], gain=gain), gain, after[0]))
        pairs = sorted(
            (one for one in pairs if one[1].value > 0), key=lambda one: -one[1].value
        )
        last = [(f, gain) for f, gain, _ in pairs]
        if not pairs:
            break
        number = judge.chosen(last)
        finding, gain, new = pairs[number]
        assert finding.after is not None
        if not (judge.is_there(gain) and gain.lower >= LARGE_GAIN):
            break
        rivals = judge.rivals(last, number)
        new, refined = course.refined(new, finding.after)
        step = _step(rivals, refined.effects[-1], stand, new, (stand.trial, new.trial))
        step.remainder = new.error / stand.error
        step.sure &= step.confirmed and not step.alternatives
        step.evidence += "".join(
            f"; the channels cannot tell it from {f.proposal.name}" for f in rivals
        )
        steps.append(step)
        stands.append(new)
        if not step.confirmed:
            break
        stand, state = new, refined
    ended = len(steps) >= settings["max_steps"] or (steps and not steps[-1].confirmed)
    refused = "the last effect is not confirmed, or no more were asked for"
    stopped = refused if ended else words.best_refused(last[0] if last else None)
    claims_nothing = False
    try:
        last_fit = course.fitted(stand.trial.model(), state, 0)[:2]
        notes += told(*last_fit) + negative(*last_fit)
    except NRFError as error:
        stopped, claims_nothing = f"{error.what}. Nothing is claimed", True
        steps, stands, stand = [], stands[:1], stands[0]
    stopped = ". ".join([stopped, *(note.rstrip(".") for note in notes)])
    report = _report(
        steps, stands, stands.index(stand), stopped, stand.trial.ruler.band(), last
    )
    left = {
        name.removeprefix("held-out "): x
        for name, x in stand.row.items()
        if name.startswith("held-out dof")
    }
    report.free_runs = FreeRuns(pd.DataFrame(left, ["measured channels"]))
    report.measured, report.bounds = (
        [measured(rec) for rec in every],
        _bounds(stand.trial),
    )
    taken = {"catalogue": tried, "calibration": "none: channels are taken as they are"}
    report.settings = audit(settings | taken, kept)
    report.claims_nothing = claims_nothing
    return report
