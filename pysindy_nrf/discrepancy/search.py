"""The search: forward by the largest gain, backward; every decision on the ruler."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import resample

from ..chain.sites import Site
from ..equations.shape_search import balance_lines, driven_at
from ..exceptions import NRFError
from ..laws.base import ForceLaw
from ..laws.sensor import SensorFault
from . import judge
from .catalogue import general_laws
from .constants import DRAWS, LARGE_GAIN, LEAST_GAIN, LEAST_SHARE, LIKELY, TENTH
from .judge import admissible
from .prepare import LONG, MOST, Prepared
from .residual import simulated
from .ruler import Gain, Ruler, Slot, Trial
from .sensors import Errors, findings_of_faults
from .state import BEHIND, Axes, Effect, Finding, Proposal, State

# Candidates that are refined and cross-validated; the right one was among the first
# three in all battery cases.
FINALISTS = 8
# Share of the best gain so far that general laws must promise at a site before laws of
# the motion are tried there. Of 508 findings within 20 % of the best (battery, 140
# cases of seed 2301) the least had 0.22 of it promised.
PROMISED = 0.15


def lines_at(trial: Trial, proposal: Proposal) -> list[float]:
    """Frequencies that a harmonic force at a DOF may have, Hz, from what the search may
    see of the longest record.
    """
    work, j = trial.ruler.work.whole, proposal.sites[0].p
    runs = [(i, run) for i in work.searched for run in work.runs(i)]
    record, run = max(runs, key=lambda one: one[1].stop - one[1].start)
    segment = work.data.segments[record]
    start, stop = work.runs(record)[0].start, work.runs(record)[-1].stop
    whole = slice(
        start, min(stop, start + LONG)
    )  # ten times as sharp as what the search can tell
    begun = slice(segment.valid.start, segment.valid.start + whole.stop)
    inside, size = np.zeros(whole.stop), whole.stop - whole.start
    for part in work.runs(record):
        inside[part] = (
            # a line is as sharp as the record is long: what is held out is zero, not
            # cut away
            1.0
        )
    few = next_fast_len(
        int(2.2 * size * segment.step * trial.ruler.windows.edges[-1])
    )  # as often as the ruler sees
    few = few if 3 * MOST < size > few else size
    seen, left = inside[whole], inside[whole][np.arange(few) * size // few]
    held, rows = (
        work.made,
        np.zeros((trial.at + 2 * work.n_dof, few)),
    )  # those of the balance of the DOF

    def thin(key: Any, columns: Callable[[], np.ndarray]) -> np.ndarray:
        if (key, few) not in held:
            parts = columns()[whole].T * seen
            held[key, few] = (
                parts if few == size else resample(parts, few, axis=1) * left
            )
        return held[key, few]

    fixed = partial(
        np.nan_to_num,
        np.column_stack([segment.a[begun, j - 1], segment.F[begun, j - 1]]),
    )
    rows[trial.at + j - 1 :: work.n_dof] = thin(j, fixed)
    for s in trial.layout.group((j,)).sites:
        own = [
            thin((s, law), partial(law.features, segment.motion(s, begun)))
            for law in trial.laws[s]
        ]
        rows[trial.layout.slices[s]] = np.vstack(own)
    weighed, dt, driven = (
        j in work.known_masses,
        segment.step * size / few,
        driven_at(segment, run),
    )
    return balance_lines(
        rows,
        trial.layout,
        trial.solution(),
        j,
        dt,
        weighed or j in work.forced,
        weighed,
        driven,
    )


def proposals_of(
    candidates: Iterable[tuple[ForceLaw, Site]], storeys: Sequence[Site]
) -> list[Proposal]:
    """Every candidate at its site, and every law of the storeys at all of them at
    once.
    """
    alone = [Proposal(law, (site,)) for law, site in candidates]
    together = []
    if len(storeys) > 1:
        for law in dict.fromkeys(p.law for p in alone if p.law.variable != "1"):
            if {s for p in alone if p.law == law for s in p.sites} >= set(
                storeys
            ) and "link" in law.acts_at:
                together.append(Proposal(law, tuple(storeys)))
    return alone + together


def exclude(one: ForceLaw, other: ForceLaw) -> bool:
    """Whether two laws cannot stand beside each other at one site."""
    if one.contains(other) or other.contains(one):
        return True
    shared = {t.label for t in one.terms()} & {t.label for t in other.terms()}
    return bool(shared) and not (one.name == other.name and one.shapes)


class Search:
    """Candidates beside a state, and what refines them; ``progress`` is called once for
    each proposal.
    """

    def __init__(
        self, proposals: Sequence[Proposal], progress: Callable[[], Any] = lambda: None
    ) -> None:
        self.constants = [p for p in proposals if p.law.variable == "1"]
        self.proposals, self.progress = (
            [p for p in proposals if p.law.variable != "1"],
            progress,
        )

    def candidates(
        self, state: State, most: float = np.inf, top: int = FINALISTS
    ) -> list[Finding]:
        """Findings on top of a state, each at ``most`` sites, the best first,
        cross-validated.
        """
        found: list[Finding] = []
        promised, best, base = (
            self._promised(state),
            0.0,
            cache(partial(self.without, state)),
        )
        for proposal in sorted(self.proposals, key=lambda p: len(p.law.free_shape)):
            self.progress()
            if len(proposal.sites) <= most and _worth_a_scan(
                proposal, found, promised, best
            ):
                scans = (
                    self._scanned(base(gone), proposal, state)
                    for gone in self._replaced(state, proposal)
                )
                found += (new := [scan for scan in scans if scan is not None])
                best = max([best, *(f.screen for f in new)])
        found.sort(key=lambda f: -f.screen)
        judged: list[Finding] = []
        for f in _varied(found, top):
            judged += filter(
                None,
                [self.judged(f, BEHIND * max(map(_value, judged), default=-np.inf))],
            )
        distinct = {
            (f.proposal, f.state.effects): f for f in sorted(judged, key=_value)
        }  # of equal ones, the best
        return sorted(distinct.values(), key=lambda f: -_value(f))

    def _promised(self, state: State) -> dict[Site, float]:
        """What the general laws gain at each site beside a state, dB: hardly less than
        any law of the motion there.
        """
        ruler, out = state.trial.ruler, {}
        for site in dict.fromkeys(
            s for p in self.proposals if _of_motion(p.law) for s in p.sites
        ):
            try:
                slots = [
                    (law, Slot(state.trial, [(site, law)]))
                    for law in general_laws(ruler.work, site)
                ]
                scans = {
                    law: ruler.scans.setdefault((law, site), ([(law,)], {}))
                    for law, _ in slots
                }
                out[site] = max(
                    float(slot.gains(*scans[law])[0][0]) for law, slot in slots
                )
            except NRFError:  # their columns depend on those of the model
                out[site] = np.inf
        return out

    def _replaced(self, state: State, proposal: Proposal) -> set[frozenset[Effect]]:
        """The effects whose place a proposal must take, and with them those whose place
        it may take.
        """
        mine, law = [e for e in state.effects if e.site in proposal.sites], proposal.law
        if any(e.template == law and not law.superposes for e in mine):
            return set()
        must = frozenset(e for e in mine if exclude(e.law, law))
        return {
            must,
            must
            | {e for e in mine if e.law.family == law.family and not law.superposes},
        }

    @staticmethod
    def without(state: State, gone: Iterable[Effect]) -> State:
        """The state without some effects."""
        trial, gone = state.trial, set(gone)
        for e in gone:
            trial = trial.without(e.site, e.law)
        return (
            State(trial, tuple(e for e in state.effects if e not in gone), state.ready)
            if gone
            else state
        )

    def _scanned(self, base: State, proposal: Proposal, state: State) -> Finding | None:
        ruler = base.trial.ruler
        points, kept = ruler.scans.get(proposal, ((), {}))
        if not points:
            axes = Axes(proposal.law, ruler.work, proposal.sites)
            points = [
                axes.at(u)
                for u in axes.grid(
                    lines_at(base.trial, proposal) if axes.of_frequency else ()
                )
            ]
            if not axes.of_frequency:  # lines of a residual change with the model
                ruler.scans[proposal] = points, kept
        if not points:
            return None
        try:
            slot = Slot(base.trial, [(s, proposal.law) for s in proposal.sites])
            gains = _gains(slot, points, kept)
        except NRFError:
            return None
        best = int(np.argmax(gains))
        if not np.isfinite(gains[best]):
            return None
        lost = 0.0 if base is state else state.trial.gain_over(base.trial).value
        return Finding(proposal, points[best], base, float(gains[best]) - lost)

    @staticmethod
    def _refined(
        base: State,
        proposal: Proposal,
        laws: Sequence[ForceLaw],
        reach: float,
        least: float = -np.inf,
    ) -> tuple[Any, Trial]:
        """Laws with refined shape parameters, beside those of a state."""
        axes = Axes(proposal.law, base.trial.ruler.work, proposal.sites)
        slot = Slot(base.trial, [(s, proposal.law) for s in proposal.sites])
        laws = axes.at(
            axes.refined(
                lambda some: float(_gains(slot, [some])[0]),
                axes.point(laws[0]),
                reach,
                least,
            )
        )
        trial = base.trial.with_laws(list(zip(proposal.sites, laws)))
        if _takes_over(
            trial, base.trial, proposal.sites
        ):  # with the weights of the fitted model
            raise NRFError(
                f"{proposal.law.name} takes over a spring",
                "Leave it out of the catalogue.",
            )
        return laws, trial

    def judged(self, finding: Finding, least: float = -np.inf) -> Finding | None:
        """The finding with refined shape parameters, roughly where less than a gain,
        and its cross-validated gain.
        """
        base, proposal = finding.state, finding.proposal
        try:
            laws, trial = self._refined(base, proposal, finding.laws, 0.5, least)
            new = [Effect(law, s, proposal.law) for law, s in zip(laws, proposal.sites)]
            known = [e for e in new if judge.differs_from_zero(trial, e)]
            if (
                0 < len(known) < len(new)
            ):  # a law of all storeys stands where its force is known
                proposal, new = (
                    replace(proposal, sites=tuple(e.site for e in known)),
                    known,
                )
                trial = base.trial.with_laws([(e.site, e.law) for e in known])
        except NRFError:
            return None
        after, laws = (
            State(trial, (*base.effects, *new), base.ready),
            tuple(e.law for e in new),
        )
        return replace(
            finding,
            proposal=proposal,
            laws=laws,
            after=after,
            gain=trial.gain_over(base.trial),
        )

    def polished(self, state: State) -> State:
        """The shape parameters of all effects refined once more, one effect after the
        other.
        """
        for effect in state.effects:
            if not effect.template.free_shape or effect.is_fault:
                continue
            base = self.without(state, [effect])
            with suppress(NRFError):
                (law,), trial = self._refined(
                    base, Proposal(effect.template, (effect.site,)), (effect.law,), 0.2
                )
                if trial.gain_over(state.trial).value > 0:
                    effects = (
                        replace(effect, law=law) if e is effect else e
                        for e in state.effects
                    )
                    state = State(trial, tuple(effects), state.ready)
        return state


class Forward:
    """The course of a search: forward steps, each refined and followed by backward
    elimination.
    """

    def __init__(
        self,
        search: Search,
        state: State,
        ready: Prepared,
        faults: Sequence[SensorFault],
        rng: np.random.Generator,
        tolerances: Mapping[str, float],
    ) -> None:
        self.search, self.faults, self.rng, self.tolerances = (
            search,
            faults,
            rng,
            tolerances,
        )
        self._errors: Errors | None = None  # of channels
        self._freed: dict[Trial, tuple[Trial, np.ndarray]] = {}  # and the errors
        self.state = replace(state, ready=ready)
        self.whole: Prepared | None = None  # all samples of long records
        self.rulers: dict[Effect, Ruler] = {}  # on the records freed of a fault
        self.rivals: dict[Effect, list[Finding]] = {}
        self.last: list[
            tuple[Finding, Gain]
        ] = []  # candidates of the last forward step, the best first

    def run(self, most: int) -> None:
        """Add effects until none is accepted or there are ``most`` of them."""
        while len(self.state.effects) < most:
            forces = self.search.candidates(self.state, most - len(self.state.effects))
            self.last = judge.ranked(
                forces + findings_of_faults(self.state, self.faults), self.state
            )
            found = self._choice(self.state, self.last)
            if found is None:
                break
            before = self.state
            self._take(found)
            self._eliminate()
            if set(e.site for e in self.state.effects) == set(
                e.site for e in before.effects
            ) and (self.state.trial.gain_over(before.trial).value <= 0):
                self.state = before
                break
        self._constants(most)

    def on_all(self, first: State, ready: Prepared) -> State:
        """Go over to all samples of long records that were searched by excerpts;
        returns their first state.
        """
        ruler = first.trial.ruler.on_all()
        start, end = (
            Trial(ruler, one.trial.base, one.trial.laws) for one in (first, self.state)
        )
        state = self.search.polished(replace(self.state, trial=end))
        self.rivals = {
            e: self.rivals.get(old, [])
            for old, e in zip(self.state.effects, state.effects)
        }
        self.state, self.whole = replace(state, ready=self.state.ready), ready
        self._errors, self._freed = None, {}  # large, and hardly asked again
        return replace(first, trial=start)

    def _choice(self, state: State, pairs: Any) -> tuple[Finding, list[Finding]] | None:
        """The finding to add, which exceeds chance, and what the data cannot tell from
        it; or None.
        """
        good = [pair for pair in pairs if judge.accepts(pair[0], state)]
        chance: dict[bool, list[float]] = {
            True: [],
            False: [],
        }  # gains of faults, and of laws
        while good:
            number = judge.chosen(good)
            finding, gain = good[number]
            if not self._by_errors(finding, state):
                draws = chance[finding.is_fault]
                if judge.is_clear(finding, state) or self._exceeds(
                    draws, gain, state, finding.is_fault
                ):
                    return finding, judge.rivals(good, number)
                finding.chance = max(draws, default=None)
            good.pop(number)
        return None

    def _by_errors(self, finding: Finding, state: State) -> bool:
        """Whether errors of the channels within tolerances explain an effect as
        well.
        """
        if finding.is_fault or finding.after is None:
            return False
        finding.beyond_errors, there = self.beyond_errors(
            finding.after.trial, state.trial, finding.proposal.law
        )
        return not there

    def beyond_errors(
        self, after: Trial, before: Trial, law: ForceLaw
    ) -> tuple[Gain, bool]:
        """Gain of a law where both models are freed of errors of the channels, and
        whether it needs more than these.

        A law that alone explains what a hundred errors would explain together needs
        none of them: its own gain counts, unless likely ones explain as much. Where
        errors explain more, it must keep half of its gain, or a large one.
        """
        assert self.state.ready is not None
        if self._errors is None or self._errors.ruler is not before.ruler:
            self._errors = Errors(
                before.ruler, self.state.ready, self.tolerances, self.state.effects
            )
        if before not in self._freed:
            self._freed = {before: self._errors.freed(before)}
        one, errors = self._freed[before]
        alone, own = one.gain_over(before).value, after.gain_over(before)
        more = alone > own.value + TENTH * LEAST_GAIN  # to which errors are fitted
        least = min(0.5 * own.value, LARGE_GAIN) if more else 0.0
        with suppress(NRFError):
            for few in (
                after,
                Trial(one.ruler, after.base, after.laws),
            ):  # errors of its own would add to its gain
                gain = few.gain_over(one)
                if judge.is_there(gain, law) and gain.value >= least:
                    return gain, True
        two, errors = self._errors.freed(after, errors)
        if two.gain_over(after).value <= TENTH * alone:
            likely = self._errors.freed(before, most=LIKELY)[0] if more else before
            if likely.gain_over(before).value < own.value:
                return own, judge.is_there(own, law)
        if not judge.is_there(gain := two.gain_over(one), law):
            return gain, False
        again = self._errors.freed(
            before, errors
        )  # these errors may lie nearer to the least
        if again[0].gain_over(one).value > 0:
            self._freed[before] = again
            gain = two.gain_over(again[0])
        return gain, judge.is_there(gain, law) and gain.value >= least

    def _exceeds(
        self, draws: list[float], gain: Gain, state: State, faults: bool
    ) -> bool:
        """Whether a gain exceeds what chance gains: in one draw if by far, else in
        all.
        """
        while len(draws) < DRAWS and gain.lower >= max(draws, default=0.0):
            draws.append(self._by_chance(state, faults))
            if gain.lower >= max(draws) + LARGE_GAIN:
                break
        return gain.lower >= max([0.0, *draws])

    def _by_chance(self, state: State, faults: bool) -> float:
        """Gain of the whole search where the state is the truth, dB; infinite where its
        model has no free run.
        """
        assert state.ready is not None
        made = next(simulated(state.ready, state.trial, self.rng), None)
        if made is None:
            return np.inf
        ready, ruler = made
        try:
            null = State(
                Trial(ruler, state.trial.base, state.trial.laws), state.effects, ready
            )
            best = (
                findings_of_faults(null, self.faults)
                if faults
                else self.search.candidates(null, top=3)
            )
        except NRFError:
            return np.inf
        return max(map(_value, best), default=0.0)

    def _take(self, found: tuple[Finding, list[Finding]]) -> None:
        finding, rivals = found
        assert finding.after is not None
        new = [e for e in finding.after.effects if e not in self.state.effects]
        kept = {
            (e.template, e.site): self.rivals.get(e, []) for e in self.state.effects
        }
        base, old = finding.state.trial, finding.after.effects[: -len(new)]
        if len(new) > 1:  # found at once: by what each gains alone
            with suppress(NRFError):
                new = sorted(
                    new,
                    key=lambda e: (
                        -base.with_laws([(e.site, e.law)]).gain_over(base).value
                    ),
                )
        finding.after = replace(finding.after, effects=(*old, *new))
        polished = self.search.polished(finding.after)
        for e in polished.effects:
            mine = any((e.template, e.site) == (n.template, n.site) for n in new)
            self.rivals[e] = rivals if mine else kept.get((e.template, e.site), [])
            if e.is_fault and e not in self.rulers:
                self.rulers[e] = polished.trial.ruler
        self.state = polished

    def _eliminate(self) -> None:
        """Take out effects that the others made needless, the least useful first."""
        while len(self.state.effects) > 1:
            weakest: tuple[float, State] | None = None
            for effect in (e for e in self.state.effects if not e.is_fault):
                with suppress(NRFError):
                    without = self.search.without(self.state, [effect])
                    gain = self.state.trial.gain_over(without.trial)
                    if not judge.is_there(gain, effect.law) and (
                        weakest is None or gain.value < weakest[0]
                    ):
                        weakest = gain.value, without
            if weakest is None:
                return
            self.state = weakest[1]

    def _constants(self, most: int) -> None:
        """Constant forces, from the means that every other decision leaves out."""
        ruler = self.state.trial.ruler
        if (
            not ruler.work.forced or ruler.windows.edges[0] > 0
        ):  # the zero of a base motion is no force
            return
        laws = list(dict.fromkeys((p.law, p.sites[0]) for p in self.search.constants))
        try:
            trial = Trial(
                ruler.as_measured(), self.state.trial.base, self.state.trial.laws
            )
        except NRFError:
            return
        while laws and len(self.state.effects) < most:
            tried = []
            for law, site in laws:
                with suppress(NRFError):
                    after = trial.with_laws([(site, law)])
                    gain = after.gain_over(trial)
                    if (
                        judge.is_there(gain, law)
                        and judge.share_of(after, trial, site) >= LEAST_SHARE
                    ):
                        tried.append((gain.value, law, site, after))
            if not tried:
                return
            _, law, site, trial = max(tried, key=lambda one: one[0])
            laws.remove((law, site))
            effect = Effect(law, site, law)
            self.state = replace(self.state, effects=(*self.state.effects, effect))


def _of_motion(law: ForceLaw) -> bool:
    """Whether a law with shape parameters follows drift and rate alone, as the general
    laws do.
    """
    return bool(law.free_shape) and not (
        law.covariates or law.uses_time or law.uses_acceleration or law.mimics_inertia
    )


def _worth_a_scan(
    proposal: Proposal,
    found: Sequence[Finding],
    promised: Mapping[Site, float],
    best: float,
) -> bool:
    """Whether general laws, and what a law of three shape parameters refines, promise
    something at the same sites.

    At several sites that is what they promise beyond the best site, which the law has
    by itself.
    """
    law, sites = proposal.law, proposal.sites
    each = sorted(max(promised[s], 0.0) for s in sites) if _of_motion(law) else []
    hopes = [sum(each[:-1] or each)] if each else []
    if len(law.free_shape) > 2:
        simple = [
            f.screen
            for f in found
            if f.proposal.sites == sites and law.contains(f.proposal.law)
        ]
        hopes += [max(simple)] if simple else []
    least = max(LEAST_GAIN / 4, PROMISED * best)
    return all(hope >= least for hope in hopes)


def _gains(
    slot: Slot, points: Sequence[tuple[ForceLaw, ...]], kept: Any = None
) -> np.ndarray:
    """Gains of laws at the sites of a slot; minus infinity where a law may not have
    such coefficients.
    """
    gains, theta, sizes = slot.gains(points, kept)
    forces = theta[:, -sizes.shape[1] :] * sizes
    real = (
        slot.springs(theta) >= -TENTH * np.abs(forces).max(axis=1, keepdims=True)
    ).all(axis=1)
    for law, own in zip(
        points[0], np.split(forces, np.cumsum(slot.widths)[:-1], axis=1)
    ):
        real &= admissible(law, own)
    return np.where(real, gains, -np.inf)


def _takes_over(after: Trial, before: Trial, sites: Sequence[Site]) -> bool:
    """Whether laws that were added turn the sign of a spring beside them, by more than
    a tenth of their force.
    """
    forces, turned = (
        after.theta[0]
        * np.sqrt(np.einsum("kii->i", after.summed)[: after.theta.shape[1]]),
        False,
    )
    for site in sites:
        old, own = (
            before.theta[0, before.layout.slices.get(site, slice(0))],
            forces[after.layout.slices[site]],
        )
        springs = np.array(
            [t.label == "s" for law in before.laws.get(site, ()) for t in law.terms()],
            dtype=bool,
        )
        turned |= bool(
            (
                own[: len(old)][springs & (old > 0)]
                < -TENTH * np.abs(own[len(old) :]).max()
            ).any()
        )
    return turned


def _value(finding: Finding) -> float:
    """Gain of a finding, dB."""
    return -np.inf if finding.gain is None else finding.gain.value


def _varied(found: Sequence[Finding], count: int) -> list[Finding]:
    """The best findings that promise something, at most two of a family at the same
    sites.
    """
    out: list[Finding] = []
    for f in found:
        alike = [
            g
            for g in out
            if (g.family, g.proposal.sites) == (f.family, f.proposal.sites)
        ]
        if len(alike) < 2 and f.screen > (LEAST_GAIN / 4 if out else 0.0):
            out.append(f)
        if len(out) == count:
            break
    return out
