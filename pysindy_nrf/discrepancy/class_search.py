"""The course of a search: a class at a site first, a name second, then a judge.

Each round grows a general law at every storey, scans the names of all other classes,
and tries the names of the best places. What holds at another condition is added; what
does not gives way to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..equations.normal_equations import variance
from ..exceptions import NRFError
from ..laws.atoms import SumOfAtoms
from . import judge
from .bootstrap import simulated
from .candidate_search import best_findings, polished, scan
from .channel_errors import ChannelErrorTest
from .constants import best_constant, state_with_means
from .dictionary import dictionary
from .effect_judge import EFFECT_JUDGE, EffectJudge, JudgedEffect
from .effects import Candidate, Effect, Finding, RankedFinding, SearchState
from .error_reduction import ErrorReduction
from .fitted_model import FittedModel
from .growth import grown_law
from .judge import JUDGE
from .places import Place, class_at
from .sensor_faults import FaultSearch
from .shifted_residual import SHIFT, shifted_models
from .spectra import BalanceSpectra


@dataclass(frozen=True)
class ClassSettings:
    """Effort of a search for classes, and when a name carries."""

    # Places whose names are tried; a class that is refused gives way to the next.
    places: int = 4
    # Names of a place that are refined.
    finalists: int = 4
    # Names of the best place that are tried at all storeys at once.
    together: int = 2
    # A name carries the model if it loses at most so much against the general law, dB,
    # or a standard error or a tenth up to a limit: it has fewer parameters, but another
    # class takes what an inexact law leaves.
    loss_of_name: float = 0.25
    most_lost: float = 0.75
    # Besides it may lose what noise makes it lose, if it has this part of the gain: a
    # curve bends where noise in the rate rounds a friction.
    share_of_name: float = 0.5
    # Least error reduction of an outside force, or an inertia, dB: a fifth of what is
    # left. One line or one resonance is soon found.
    least_of_narrow: float = 2.0
    # The same of any other later effect, dB: less is what an inexact law leaves.
    least_of_later: float = 1.0
    # Share of the force at its site that an effect changes at least: less is within
    # the calibration of any sensor.
    least_share: float = 0.01
    # Error reduction from which on an effect is not compared with a shifted residual,
    # dB; those of measured records came to 5.5 at most.
    beyond_chance: float = 6.0
    # Draws of noise; a further one exceeds the largest of three in a quarter of cases.
    draws: int = 3


CLASSES = ClassSettings()


@dataclass(frozen=True)
class Naming:
    """A class, its general law, and the closest name.

    Attributes
    ----------
    effect_class : str
    closest : str
        Name of the law of the class that leaves least.
    share : float
        Part of the error reduction of the effect that the closest name has, in dB.
    carries : bool
        Whether the name carries the model, and not the general law.
    rivals : sequence of Finding
        Other names that explain the data as well.
    names : sequence of Finding
        All names of the place that were refined.
    """

    effect_class: str
    closest: str = ""
    share: float = 1.0
    carries: bool = True
    rivals: Sequence[Finding] = ()
    names: Sequence[Finding] = ()


@dataclass(frozen=True, eq=False)
class Proposal:
    """What stands best at a place, added to a state."""

    finding: Finding
    reduction: ErrorReduction
    naming: Naming

    @property
    def value(self) -> float:
        """Cross-validated error reduction over the state, dB."""
        return self.reduction.value


@dataclass(frozen=True, eq=False)
class JudgedProposal:
    """A proposal, and what another condition says of it."""

    proposal: Proposal
    judged: JudgedEffect

    @property
    def value(self) -> float:
        """Error reduction, dB: of both records, if another record has judged it.

        In one record of few frequencies classes and sites are much alike.
        """
        if self.judged.condition != "another record":
            return self.proposal.value
        return 0.5 * (self.proposal.value + self.judged.heldout.value)


@dataclass(frozen=True, eq=False)
class TriedEffect:
    """An effect that was judged, with its naming.

    Attributes
    ----------
    effect : Effect
    naming : Naming
    judged : JudgedEffect
    position : int
        Number of the claims that were accepted before it.
    corrected : BalanceSpectra or None
        Of a fault, the spectra of the records freed of it.
    """

    effect: Effect
    naming: Naming
    judged: JudgedEffect
    position: int
    corrected: BalanceSpectra | None = None


@dataclass(frozen=True)
class ClassResult:
    """What a search found.

    Attributes
    ----------
    first, state : SearchState
        Before the search and at its end, with the means left in if it found a constant.
    accepted : tuple of TriedEffect
        In the order of the effects of the state.
    refused : tuple of TriedEffect
        What the judge refused.
    last : sequence of RankedFinding
        Candidates of the last round, the best first.
    general : tuple of Finding
        General laws of the last round: what they would still gain.
    why_refused : str
        What speaks against the best candidate of the last round.
    """

    first: SearchState
    state: SearchState
    accepted: tuple[TriedEffect, ...] = ()
    refused: tuple[TriedEffect, ...] = ()
    last: Sequence[RankedFinding] = ()
    general: tuple[Finding, ...] = ()
    why_refused: str = ""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects in the order in which they were accepted."""
        return self.state.effects

    @property
    def n_claims(self) -> int:
        """Number of effects that do not only add to another."""
        return sum(not effect.enriches for effect in self.effects)


@dataclass(frozen=True)
class SearchTools:
    """What a search asks of others.

    Attributes
    ----------
    faults : FaultSearch
    errors : ChannelErrorTest
    judge : EffectJudge
    rng : Generator
    progress : callable
    """

    faults: FaultSearch
    errors: ChannelErrorTest
    judge: EffectJudge
    rng: np.random.Generator
    progress: Callable[[], object]


class ClassSearch:
    """Adds effects, class by class.

    Parameters
    ----------
    places : sequence of Place
    tools : SearchTools
    constants : sequence of Candidate
        Constant forces that are looked for at last.
    """

    def __init__(
        self,
        places: Sequence[Place],
        tools: SearchTools,
        constants: Sequence[Candidate] = (),
    ) -> None:
        self.places = list(places)
        self.tools = tools
        self.constants = list(constants)

    def add_effects(self, first: SearchState, max_effects: int) -> ClassResult:
        """Add effects until none is accepted, or there are enough of them."""
        result = ClassResult(first, first)
        while len(result.effects) < max_effects:
            room = max_effects - len(result.effects)
            proposals, general = self.proposals(result.state, room)
            result = replace(result, last=_ranked(proposals), general=tuple(general))
            accepted, result = self._first_that_holds(proposals, result)
            if accepted is None:
                break
            result = _with_accepted(result, *accepted)
        return self._with_constants(result, max_effects)

    def _with_constants(self, result: ClassResult, max_effects: int) -> ClassResult:
        """The result with constant forces, by the means that were left out so far."""
        state = state_with_means(result.state) if self.constants else None
        while state is not None and len(result.effects) < max_effects:
            finding = best_constant(state, self.constants)
            if finding is None or finding.reduction is None:
                break
            judged = self.tools.judge.judged(finding, state)
            if not judged.holds:
                break
            naming = Naming("outside force", finding.candidate.law.name)
            proposal = Proposal(finding, finding.reduction, naming)
            result = _with_accepted(result, proposal, judged)
            state = result.state
        return result

    # -- scan, grow, name ------------------------------------------------------

    def proposals(
        self, state: SearchState, room: int
    ) -> tuple[list[Proposal], list[Finding]]:
        """What stands best at the most promising places, and all general laws."""
        promising = sorted(self._promises(state), key=lambda promise: -promise.value)
        proposals: list[Proposal] = []
        for promise in promising[: CLASSES.places]:
            proposal = _named(promise, state, self.tools.rng)
            if proposal is not None:
                proposals.append(proposal)

        if proposals and room > 1:
            for best in _best_and_best_tie(proposals):
                proposals += _at_all_storeys(best, self.places, state, room)
        proposals += _faults(self.tools.faults.findings(state), state)
        general = [p.general for p in promising if p.general is not None]
        return sorted(proposals, key=lambda proposal: -proposal.value), general

    def _promises(self, state: SearchState) -> Iterator[_Promise]:
        """What each place promises beside a state, if it is free."""
        for place in self.places:
            self.tools.progress()
            if len(place.sites) > 1:
                continue
            there = _effects_at(place, state)
            promise = (
                _enrichment(place, state, there) if there else _promise(place, state)
            )
            if promise is not None:
                yield promise

    # -- accept, judge ---------------------------------------------------------

    def _first_that_holds(
        self, proposals: Sequence[Proposal], result: ClassResult
    ) -> tuple[tuple[Proposal, JudgedEffect] | None, ClassResult]:
        """The first proposal that holds, and the result with those refused."""
        why = ""
        state = result.state
        there = []
        self.tools.judge.begin_round()
        for proposal in proposals:
            if _is_there(proposal, state, self.tools.judge):
                judged = self.tools.judge.judged(proposal.finding, state)
                there.append(JudgedProposal(proposal, judged))
        while there:
            best = _next(there, state)
            there.remove(best)
            proposal, judged = best.proposal, best.judged
            if not judged.holds:
                result = _with_refused(result, proposal, judged)
                why = why or _in_words(judged)
                continue
            doubt = self._doubt(proposal, result)
            if not doubt:
                return (self._with_rivals(best, proposals, state), judged), result
            why = why or doubt
        return None, replace(result, why_refused=why)

    def _with_rivals(
        self, best: JudgedProposal, proposals: Sequence[Proposal], state: SearchState
    ) -> Proposal:
        """A proposal with names and places that another record does not refute."""
        proposal, naming = best.proposal, best.proposal.naming
        finding = proposal.finding
        if best.judged.condition != "another record":
            return proposal
        others = [name for name in naming.names if name.candidate != finding.candidate]
        others += [p.finding for p in proposals if not _adds_to(p, proposal)]
        rivals = list(naming.rivals)
        for other in others:
            is_new = other not in rivals and other.after is not None
            if is_new and not self.tools.judge.prefers(finding, other, state):
                rivals.append(other)
        return replace(proposal, naming=replace(naming, rivals=rivals))

    def _doubt(self, proposal: Proposal, result: ClassResult) -> str:
        """What speaks against a proposal: errors of channels, the free run, chance."""
        state, finding = result.state, proposal.finding
        assert finding.after is not None
        before = self.tools.judge.on_all_records(state.model)
        after = self.tools.judge.on_all_records(finding.after.model)
        # what a record of few frequencies leaves open of the model without an effect is
        # no evidence for the effect
        law, least = finding.candidate.law, EFFECT_JUDGE.least
        if not judge.is_there(after.reduction_from(before), law, least):
            return "a fit to all records explains as much without it"
        if self._is_explained_by_errors(finding, before, after):
            return "errors of the channels within their tolerances explain it"
        if finding.is_fault:
            return ""
        if self.tools.judge.contradicted_by_free_run(finding, state):
            return "with it the free run gets far worse"
        if not state.effects or proposal.value >= CLASSES.beyond_chance:
            return ""
        by_noise = _gain_by_noise(state, finding, self.tools.rng)
        if proposal.value - by_noise < CLASSES.least_of_later:
            return "noise alone makes it gain as much"
        if self._is_chance(proposal, state):
            return "a shifted residual gains as much"
        return ""

    def _is_explained_by_errors(
        self, finding: Finding, before: FittedModel, after: FittedModel
    ) -> bool:
        """Whether errors of the channels within their tolerances explain a finding.

        The same errors in all records. A fault that another channel witnesses is more
        than such an error.
        """
        state, test = finding.before, self.tools.errors
        assert state.records is not None
        if finding.witnessed:
            return False
        if finding.is_fault:
            of_errors = test.explain(before, state.records, state.effects)
            return of_errors > after.reduction_from(before).value
        law = finding.candidate.law
        beyond = test.beyond(after, before, law, state.records, state.effects)
        return not beyond.is_there

    def _is_chance(self, proposal: Proposal, state: SearchState) -> bool:
        """Whether the place gains as much on a residual that was shifted in time."""
        place = self._place_of(proposal)
        exceeded, failed = 0, 0
        for shifted in shifted_models(state.model, self.tools.rng):
            null = SearchState(shifted, state.effects, state.records)
            promise = _promise(place, null)
            reduction = promise.value if promise else 0.0
            if proposal.value > reduction:
                exceeded += 1
            else:
                failed += 1
            if exceeded >= SHIFT.exceeded or failed > SHIFT.draws - SHIFT.exceeded:
                break
        return failed > SHIFT.draws - SHIFT.exceeded

    def _place_of(self, proposal: Proposal) -> Place:
        """The place of a proposal."""
        site = proposal.finding.candidate.sites[0]
        effect_class = proposal.naming.effect_class
        return next(
            place
            for place in self.places
            if place.sites[0] == site and place.effect_class == effect_class
        )

    # -- all samples -----------------------------------------------------------

    def on_all_samples(self, result: ClassResult) -> ClassResult:
        """Go over to all samples of long records that were searched by excerpts."""
        spectra = result.first.model.spectra.of_all_samples()
        first = replace(result.first, model=result.first.model.refitted(spectra))
        start = replace(result.state, model=result.state.model.refitted(spectra))
        self.tools.errors.forget()
        return _with_state(replace(result, first=first), polished(start))


# -- promises ------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Promise:
    """What a place promises beside a base: a grown law, or the scan of its names."""

    place: Place
    base: SearchState
    value: float
    general: Finding | None = None


def _effects_at(place: Place, state: SearchState) -> list[Effect]:
    """Effects of a class at a site, beside which there is no second one."""
    chain = state.model.base
    effects = []
    for effect in state.effects:
        if effect.is_fault or effect.site not in place.sites:
            continue
        same = class_at(effect.template, effect.site, chain) == place.effect_class
        if same and not effect.template.superposes:
            effects.append(effect)
    return effects


def _enrichment(
    place: Place, state: SearchState, effects: Sequence[Effect]
) -> _Promise | None:
    """What atoms promise beside an effect that is there: no claim of its own.

    A general law is grown anew, a name is given a general law beside it, once.
    """
    if not place.grows or len(effects) > 1:
        return None
    effect = effects[0]
    if not isinstance(effect.law, SumOfAtoms):
        general = _grown(place, state, enriches=True)
        return (
            None if general is None else _Promise(place, state, general.value, general)
        )
    general = _grown(place, state.without([effect]))
    if general is None or general.after is None:
        return None
    reduction = general.after.model.reduction_from(state.model)
    nameless = replace(place, names=())
    general = replace(general, reduction=reduction)
    return _Promise(nameless, state, reduction.value, general)


def _promise(place: Place, state: SearchState) -> _Promise | None:
    """What a place promises beside a state; None if nothing can stand there."""
    if place.grows:
        general = _grown(place, state)
        return (
            None if general is None else _Promise(place, state, general.value, general)
        )
    best = 0.0
    for candidate in place.quick_names:
        finding = scan(state, candidate, state)
        if finding is not None:
            best = max(best, finding.screened)
    return _Promise(place, state, best) if best > 0 else None


def _grown(place: Place, state: SearchState, enriches: bool = False) -> Finding | None:
    """The general law of a place beside a state."""
    (site,) = place.sites
    atoms = dictionary(place.effect_class, site, state.model.spectra.data)
    if atoms is None:
        return None
    try:
        law = grown_law(state.model, site, atoms)
        if law is None:
            return None
        after = state.model.with_laws([(site, law)])
    except NRFError:
        return None
    reduction = after.reduction_from(state.model)
    effects = (*state.effects, Effect(law, site, law, enriches=enriches))
    return Finding(
        Candidate(law, (site,)),
        (law,),
        state,
        reduction.value,
        reduction,
        SearchState(after, effects, state.records),
    )


# -- names ---------------------------------------------------------------------


def _named(
    promise: _Promise, state: SearchState, rng: np.random.Generator
) -> Proposal | None:
    """The best of the general law of a place and its names."""
    place = promise.place
    names = best_findings(promise.base, place.names, CLASSES.finalists)
    if _enriches(promise):
        names = [_as_enrichment(name, state) for name in names]
    general = promise.general
    carrying = _carrying(names, general, rng)
    if carrying:
        name, rivals = _simplest_name(carrying, state)
        name = _without_noise(name, names, rng)
        assert name.reduction is not None
        closest = name.candidate.law.name
        naming = Naming(place.effect_class, closest, rivals=rivals, names=names)
        return Proposal(name, name.reduction, naming)
    if general is None or general.reduction is None:
        return None

    closest, share = "", 0.0
    if names:
        closest = names[0].candidate.law.name
        share = max(names[0].value, 0.0) / general.value
    naming = Naming(place.effect_class, closest, share, carries=False)
    return Proposal(general, general.reduction, naming)


def _carrying(
    names: list[Finding], general: Finding | None, rng: np.random.Generator
) -> list[Finding]:
    """Names that gain nearly as much as the general law.

    The best one also where it loses no more than noise makes it lose.
    """
    carrying = [name for name in names if _carries(name, general)]
    if carrying or not names:
        return carrying
    by_noise = _lost_by_noise(names[0], general, rng)
    return [name for name in names[:1] if _carries(name, general, by_noise)]


def _enriches(promise: _Promise) -> bool:
    """Whether a promise only adds to an effect that is there."""
    general = promise.general
    if general is None or general.after is None:
        return False
    return general.after.effects[-1].enriches


def _as_enrichment(name: Finding, state: SearchState) -> Finding:
    """A name whose effect only adds to one that is there."""
    assert name.after is not None
    new = name.new_effects(state.effects)
    effects = [replace(e, enriches=True) if e in new else e for e in name.after.effects]
    after = replace(name.after, effects=tuple(effects))
    return replace(name, after=after)


def _carries(name: Finding, general: Finding | None, allowance: float = 0.0) -> bool:
    """Whether a name gains nearly as much as the general law.

    But for an allowance, dB.
    """
    if name.value <= 0 or name.reduction is None:
        return False
    if general is None or general.reduction is None:
        return True
    without_fold = general.reduction.without_fold - name.reduction.without_fold
    error = float(np.sqrt(variance(without_fold)))
    lost = general.value - name.value - allowance
    nearly = max(JUDGE.loss_of_simplest * general.value, error)
    return lost <= max(CLASSES.loss_of_name, min(nearly, CLASSES.most_lost))


def _without_noise(
    name: Finding, names: Sequence[Finding], rng: np.random.Generator
) -> Finding:
    """A special case of a name that only noise makes lose against it; else the name."""
    law = name.candidate.law
    for simpler in names:
        fewer = simpler.n_parameters < name.n_parameters
        if fewer and law.contains(simpler.candidate.law):
            by_noise = _lost_by_noise(simpler, name, rng)
            noise_matters = by_noise > CLASSES.loss_of_name
            if noise_matters and _carries(simpler, name, by_noise):
                return simpler
    return name


def _lost_by_noise(
    name: Finding, general: Finding | None, rng: np.random.Generator
) -> float:
    """What noise makes a name lose against the general law, dB."""
    if general is None or name.value < CLASSES.share_of_name * general.value:
        return 0.0
    assert name.after is not None
    return _gain_by_noise(name.after, general, rng)


def _gain_by_noise(
    truth: SearchState, finding: Finding, rng: np.random.Generator
) -> float:
    """What a finding gains over a state whose model is the truth, dB.

    On records that this model would have produced with fresh noise; the largest of
    some draws.
    """
    if truth.records is None or finding.after is None:
        return 0.0
    gains = []
    for drawn in simulated(truth.records, truth.model, rng, CLASSES.draws):
        with suppress(NRFError):
            before = truth.model.refitted(drawn.spectra)
            after = finding.after.model.refitted(drawn.spectra)
            gains.append(after.reduction_from(before).value)
    return max([0.0, *gains])


def _simplest_name(
    names: Sequence[Finding], state: SearchState
) -> tuple[Finding, list[Finding]]:
    """The simplest name within a standard error of the best, and those as good."""
    ranked = judge.ranked(names, state)
    place = judge.simplest(ranked)
    return ranked[place].finding, judge.rivals(ranked, place)


def _best_and_best_tie(proposals: Sequence[Proposal]) -> list[Proposal]:
    """The best proposal, and the best tie: some are there at all floors at once."""
    ranked = sorted(proposals, key=lambda proposal: -proposal.value)
    ties = [p for p in ranked if p.naming.effect_class == "tie"]
    return list(dict.fromkeys([ranked[0], *ties[:1]]))


def _at_all_storeys(
    best: Proposal, places: Sequence[Place], state: SearchState, room: int
) -> list[Proposal]:
    """The name of the best place at all storeys at once."""
    law = best.finding.candidate.law
    laws = [law, *(rival.candidate.law for rival in best.naming.rivals)]
    laws = laws[: CLASSES.together]
    candidates = []
    for place in places:
        together = 1 < len(place.sites) <= room and not _effects_at(place, state)
        if together and place.effect_class == best.naming.effect_class:
            candidates += [c for c in place.names if c.law in laws]
    proposals = []
    for finding in best_findings(state, candidates, CLASSES.together):
        if finding.reduction is not None and _is_needed_everywhere(finding, state):
            naming = Naming(best.naming.effect_class, finding.candidate.law.name)
            proposals.append(Proposal(finding, finding.reduction, naming))
    return proposals


def _is_needed_everywhere(finding: Finding, state: SearchState) -> bool:
    """Whether an effect of several sites is there at each, beside the others."""
    if finding.after is None or len(finding.candidate.sites) < 2:
        return False
    for effect in finding.new_effects(state.effects):
        without = finding.after.without([effect])
        alone = finding.after.model.reduction_from(without.model)
        if not judge.is_there(alone):
            return False
    return True


def _faults(findings: Sequence[Finding], state: SearchState) -> list[Proposal]:
    """Faults of sensors, each with those that explain the data as well."""
    ranked = judge.ranked(findings, state)
    proposals = []
    for number, fault in enumerate(ranked):
        name = fault.finding.candidate.law.name
        rivals = judge.rivals(ranked, number)
        naming = Naming("sensor error", name, rivals=rivals)
        proposals.append(Proposal(fault.finding, fault.reduction, naming))
    return proposals


# -- decisions -----------------------------------------------------------------


def _next(proposals: Sequence[JudgedProposal], state: SearchState) -> JudgedProposal:
    """The proposal that comes next.

    The best, one of several sites by what each of them brings; or a simpler one that
    explains the same.
    """
    best = max(proposals, key=_value_of_each_site)
    explaining = [p for p in proposals if _explains(p, best, state)]
    return min([best, *explaining], key=_size)


def _value_of_each_site(judged: JudgedProposal) -> float:
    return judged.value / len(judged.proposal.finding.candidate.sites)


def _size(judged: JudgedProposal) -> tuple[tuple[int, int], float]:
    """Number of parameters; the better of two as large comes first."""
    return judged.proposal.finding.n_parameters, -judged.value


def _explains(
    simpler: JudgedProposal, best: JudgedProposal, state: SearchState
) -> bool:
    """Whether a simpler proposal leaves of the best one nothing to be claimed.

    What it loses is less than a further effect must bring, and beside it the best one
    is not there.
    """
    of_best = best.proposal.finding
    fewer = simpler.proposal.finding.n_parameters < of_best.n_parameters
    nearly = best.value - simpler.value < CLASSES.least_of_later
    if not (fewer and nearly and simpler.value > 0) or of_best.is_fault:
        return False
    beside = simpler.proposal.finding.after
    assert beside is not None
    new = of_best.new_effects(state.effects)
    try:
        both = beside.model.with_laws([(effect.site, effect.law) for effect in new])
    except NRFError:
        # their columns are the same
        return True
    reduction = both.reduction_from(beside.model)
    return not judge.is_there(reduction, of_best.candidate.law)


def _adds_to(other: Proposal, proposal: Proposal) -> bool:
    """Whether a proposal is of the class of another, at its site and further ones."""
    same_class = other.naming.effect_class == proposal.naming.effect_class
    sites = set(other.finding.candidate.sites)
    return same_class and bool(sites & set(proposal.finding.candidate.sites))


def _is_there(
    proposal: Proposal, state: SearchState, effect_judge: EffectJudge
) -> bool:
    """Whether an effect stands whichever fold is left out."""
    finding, reduction = proposal.finding, proposal.reduction
    law = finding.candidate.law
    least = JUDGE.least_reduction
    if proposal.naming.effect_class in ("inertial", "outside force"):
        least = CLASSES.least_of_narrow
    elif state.effects and not finding.is_fault and not _only_enriches(finding, state):
        least = CLASSES.least_of_later
    if not judge.is_there(reduction, law, least):
        return False
    if finding.is_fault:
        return True
    assert finding.after is not None
    new = finding.new_effects(state.effects)
    fitted = effect_judge.on_all_records(finding.after.model)
    if not all(judge.differs_from_zero(fitted, each) for each in new):
        return False
    shares = judge.shares_of_force(finding, state)
    # a dashpot matters beside other dampers, whatever the springs hold
    matters = law.variable == "v" or max(shares.values()) >= CLASSES.least_share
    return matters and not judge.takes_over(finding, shares)


def _only_enriches(finding: Finding, state: SearchState) -> bool:
    """Whether a finding only adds to effects that are there, or grows one anew."""
    assert finding.after is not None
    new = finding.new_effects(state.effects)
    is_larger = len(finding.after.effects) > len(state.effects)
    return all(effect.enriches for effect in new) or not is_larger


def _in_words(judged: JudgedEffect) -> str:
    """What a judge says against an effect."""
    decisive = judged.decisive
    size = f"{decisive.value:.2g} dB, standard error {decisive.error:.2g}"
    return f"at {judged.condition} it does not hold ({size})"


def _ranked(proposals: Sequence[Proposal]) -> list[RankedFinding]:
    return [RankedFinding(p.finding, p.reduction) for p in proposals]


# -- results -------------------------------------------------------------------


def _with_accepted(
    result: ClassResult, proposal: Proposal, judged: JudgedEffect
) -> ClassResult:
    """The result with the effects of a proposal."""
    after = proposal.finding.after
    assert after is not None
    known = {tried.effect: tried for tried in result.accepted}
    accepted = []
    for effect in after.effects:
        tried = known.get(effect)
        if tried is None:
            tried = _tried(effect, proposal, judged, result)
        accepted.append(tried)
    refused = _without(result.refused, accepted[-1])
    return replace(result, state=after, accepted=tuple(accepted), refused=refused)


def _without(
    refused: Iterable[TriedEffect], other: TriedEffect
) -> tuple[TriedEffect, ...]:
    """Refused effects but those of the class and site of another."""
    place = other.naming.effect_class, other.effect.site
    return tuple(
        tried
        for tried in refused
        if (tried.naming.effect_class, tried.effect.site) != place
    )


def _tried(
    effect: Effect, proposal: Proposal, judged: JudgedEffect, result: ClassResult
) -> TriedEffect:
    """An effect of a proposal that was judged."""
    corrected = None
    if effect.is_fault and proposal.finding.after is not None:
        corrected = proposal.finding.after.model.spectra
    return TriedEffect(effect, proposal.naming, judged, result.n_claims, corrected)


def _with_refused(
    result: ClassResult, proposal: Proposal, judged: JudgedEffect
) -> ClassResult:
    """The result with an effect that the judge refused, the best of its round."""
    after = proposal.finding.after
    assert after is not None
    (effect, *_) = proposal.finding.new_effects(result.effects)
    position = result.n_claims
    is_claim = not _only_enriches(proposal.finding, result.state)
    if not is_claim or any(tried.position == position for tried in result.refused):
        return result
    tried = _tried(effect, proposal, judged, result)
    return replace(result, refused=(*_without(result.refused, tried), tried))


def _with_state(result: ClassResult, state: SearchState) -> ClassResult:
    """The result with effects whose shape parameters were refined."""
    accepted = []
    for tried, effect in zip(result.accepted, state.effects):
        accepted.append(replace(tried, effect=effect))
    return replace(result, state=state, accepted=tuple(accepted))
