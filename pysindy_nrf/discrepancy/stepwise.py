"""The course of a search: forward steps, each refined and followed by elimination."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from ..exceptions import NRFError
from ..laws.sensor import SensorFault
from . import judge
from .candidate_search import CandidateSearch
from .chance import ChanceTest
from .channel_errors import ChannelErrorTest
from .effects import Candidate, Effect, Finding, RankedFinding, SearchState
from .error_reduction import ErrorReduction
from .fitted_model import FittedModel, PlacedLaw
from .judge import JUDGE
from .sensor_faults import FaultSearch
from .spectra import BalanceSpectra


@dataclass(frozen=True)
class Examination:
    """What else was asked of a finding that is there and matters.

    Attributes
    ----------
    beyond_errors : ErrorReduction or None
        Where both models are freed of the errors that channels may have.
    chance : float or None
        What the search gains where nothing is missing, dB, if that speaks against the
        finding; infinite where the model has no free run.
    """

    beyond_errors: ErrorReduction | None = None
    chance: float | None = None


@dataclass(frozen=True)
class Round:
    """One round of a search.

    Attributes
    ----------
    findings : sequence of RankedFinding
        The best first.
    examinations : mapping of int to Examination
        Of some of them, by number.
    chosen : int or None
        Number of the finding that was accepted.
    """

    findings: Sequence[RankedFinding] = ()
    examinations: Mapping[int, Examination] = field(default_factory=dict)
    chosen: int | None = None
    # findings that explain the data as well as the chosen one
    rivals: Sequence[Finding] = ()


@dataclass(frozen=True)
class SearchResult:
    """What a search found.

    Attributes
    ----------
    first, state : SearchState
        Before the search and at its end.
    last_round : Round
    rivals : mapping of Effect to sequence of Finding
        What explained the data as well as an effect when it was accepted.
    corrected : mapping of Effect to BalanceSpectra
        Of each fault, the spectra of the records freed of it.
    """

    first: SearchState
    state: SearchState
    last_round: Round
    rivals: Mapping[Effect, Sequence[Finding]]
    corrected: Mapping[Effect, BalanceSpectra]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects in the order in which they were found."""
        return self.state.effects


class StepwiseSearch:
    """Adds effects one by one, and takes out those that become needless.

    Parameters
    ----------
    search : CandidateSearch
    faults : sequence of SensorFault
    errors : ChannelErrorTest
    rng : Generator
        For the draws of chance.
    """

    def __init__(
        self,
        search: CandidateSearch,
        faults: Sequence[SensorFault],
        errors: ChannelErrorTest,
        rng: np.random.Generator,
    ) -> None:
        self.search = search
        self.faults = FaultSearch(faults)
        self.errors = errors
        self.rng = rng

    def add_effects(self, first: SearchState, max_effects: int) -> SearchResult:
        """Add effects until none is accepted, or there are enough of them."""
        result = SearchResult(first, first, Round(), {}, {})

        while len(result.effects) < max_effects:
            before = result.state
            room = max_effects - len(before.effects)
            this_round = self._round(before, room)
            result = replace(result, last_round=this_round)
            if this_round.chosen is None:
                break
            result = self._add(result, this_round)
            result = replace(result, state=eliminate(result.state))
            if _is_no_better(result.state, before):
                result = replace(result, state=before)
                break

        constant = add_constants(
            result.state, self.search.constants, max_effects - len(result.effects)
        )
        return replace(result, state=constant)

    # -- one round -------------------------------------------------------------

    def _round(self, state: SearchState, room: int) -> Round:
        """Find candidates beside a state and choose one, if any is accepted."""
        findings = self.search.findings(state, room)
        findings += self.faults.findings(state)
        ranked = judge.ranked(findings, state)
        good = [k for k, f in enumerate(ranked) if judge.accepts(f.finding, state)]
        chance = ChanceTest(state, self.search, self.faults.laws, self.rng)
        examinations: dict[int, Examination] = {}

        while good:
            contenders = [ranked[k] for k in good]
            place = judge.simplest(contenders)
            number = good[place]
            examination, accepted = self._examine(ranked[number], state, chance)
            examinations[number] = examination
            if accepted:
                rivals = judge.rivals(contenders, place)
                return Round(ranked, examinations, number, rivals)
            good.pop(place)

        return Round(ranked, examinations)

    def _examine(
        self, ranked: RankedFinding, state: SearchState, chance: ChanceTest
    ) -> tuple[Examination, bool]:
        """Whether a finding is neither an error of channels nor chance."""
        finding, beyond = ranked.finding, None
        if not finding.is_fault and finding.after is not None:
            assert state.records is not None
            test = self.errors.beyond(
                finding.after.model,
                state.model,
                finding.candidate.law,
                state.records,
                state.effects,
            )
            beyond = test.reduction
            if not test.is_there:
                return Examination(beyond), False

        if judge.is_clear(finding, state):
            return Examination(beyond), True
        if chance.is_exceeded_by(ranked.reduction, finding.is_fault):
            return Examination(beyond), True
        return Examination(beyond, chance.largest(finding.is_fault)), False

    # -- the state after it ----------------------------------------------------

    def _add(self, result: SearchResult, this_round: Round) -> SearchResult:
        """The result with the chosen finding, all shape parameters refined."""
        assert this_round.chosen is not None
        finding = this_round.findings[this_round.chosen].finding
        assert finding.after is not None
        old = result.state.effects
        new = finding.new_effects(old)
        earlier = [effect for effect in finding.after.effects if effect not in new]
        effects = (*earlier, *_by_own_reduction(new, finding))
        polished = self.search.polished(replace(finding.after, effects=effects))

        rivals = _rivals_of(polished.effects, new, old, result.rivals, this_round)
        corrected = dict(result.corrected)
        for effect in polished.effects:
            if effect.is_fault and effect not in corrected:
                corrected[effect] = polished.model.spectra
        return replace(
            result,
            state=polished,
            rivals={**result.rivals, **rivals},
            corrected=corrected,
        )

    def on_all_samples(self, result: SearchResult) -> SearchResult:
        """Go over to all samples of long records that were searched by excerpts."""
        spectra = result.first.model.spectra.of_all_samples()
        first = replace(result.first, model=result.first.model.refitted(spectra))
        start = replace(result.state, model=result.state.model.refitted(spectra))
        state = self.search.polished(start)
        rivals = {}
        for old, new in zip(result.effects, state.effects):
            rivals[new] = result.rivals.get(old, ())
        self.errors.forget()
        return replace(result, first=first, state=state, rivals=rivals)


def _is_no_better(state: SearchState, before: SearchState) -> bool:
    """Whether a state has effects at the same sites as before and leaves no less."""
    sites = {effect.site for effect in state.effects}
    if sites != {effect.site for effect in before.effects}:
        return False
    return state.model.reduction_from(before.model).value <= 0


def _by_own_reduction(effects: list[Effect], finding: Finding) -> list[Effect]:
    """Effects that were found at once, by what each gains alone."""
    base = finding.before.model
    if len(effects) < 2:
        return effects

    def loss(effect: Effect) -> float:
        alone = base.with_laws([(effect.site, effect.law)])
        return -alone.reduction_from(base).value

    with suppress(NRFError):
        return sorted(effects, key=loss)
    return effects


def _rivals_of(
    effects: Sequence[Effect],
    new: Sequence[Effect],
    old: Sequence[Effect],
    known: Mapping[Effect, Sequence[Finding]],
    this_round: Round,
) -> dict[Effect, Sequence[Finding]]:
    """Rivals of effects that were refined: of new ones those of this round."""
    earlier = {(e.template, e.site): known.get(e, ()) for e in old}
    added = {(e.template, e.site) for e in new}
    rivals: dict[Effect, Sequence[Finding]] = {}
    for effect in effects:
        place = effect.template, effect.site
        if place in added:
            rivals[effect] = this_round.rivals
        else:
            rivals[effect] = earlier.get(place, ())
    return rivals


def eliminate(state: SearchState) -> SearchState:
    """Take out effects that the others made needless, the least useful first."""
    while len(state.effects) > 1:
        weakest, least = None, np.inf
        for effect in state.effects:
            if effect.is_fault:
                continue
            with suppress(NRFError):
                without = state.without([effect])
                reduction = state.model.reduction_from(without.model)
                needed = judge.is_there(reduction, effect.law)
                if not needed and reduction.value < least:
                    weakest, least = without, reduction.value
        if weakest is None:
            break
        state = weakest
    return state


def add_constants(
    state: SearchState, candidates: Sequence[Candidate], room: int
) -> SearchState:
    """Add constant forces, from the means that every other decision leaves out.

    Not without a measured force: the zero of a base motion is no force.
    """
    spectra = state.model.spectra
    means_are_cut = spectra.windows.edges[0] > 0
    if not candidates or not spectra.data.forced or means_are_cut:
        return state
    try:
        model = state.model.refitted(spectra.with_means())
    except NRFError:
        return state

    places = list(dict.fromkeys((c.sites[0], c.law) for c in candidates))
    effects = list(state.effects)
    for _ in range(room):
        added = _best_constant(model, places)
        if added is None:
            break
        (site, law), model = added
        places.remove((site, law))
        effects.append(Effect(law, site, law))
    return replace(state, effects=tuple(effects))


def _best_constant(
    model: FittedModel, places: Sequence[PlacedLaw]
) -> tuple[PlacedLaw, FittedModel] | None:
    """The constant force that lowers the residual most, and the model with it.

    None if none is there and matters.
    """
    best, largest = None, -np.inf
    for site, law in places:
        with suppress(NRFError):
            after = model.with_laws([(site, law)])
            reduction = after.reduction_from(model)
            if reduction.value > largest and judge.is_there(reduction, law):
                share = judge.share_of_force(after, model, site)
                if share >= JUDGE.least_share:
                    best = (site, law), after
                    largest = reduction.value
    return best
