"""The course of a search: a class at a site first, a name second, then a judge.

Each round grows a general law at every storey, scans the names of all other classes,
and tries the names of the best places. What holds at another condition is added; what
does not gives way to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from . import judge
from .acceptance import (
    JudgedProposal,
    is_there,
    leaves_nothing_of,
    next_proposal,
)
from .candidate_search import polished
from .channel_errors import ChannelErrorTest
from .class_result import ClassResult
from .constants import best_constant, state_with_means
from .effect_judge import (
    EffectJudge,
    JudgedEffect,
    stands_beside_another,
)
from .effects import Candidate, Finding, RankedFinding, SearchState
from .error_reduction import REDUCTION
from .estimate_judge import EstimateJudge
from .fitted_model import FittedModel
from .instead import fault_instead
from .judge import JUDGE
from .naming import (
    NAMING,
    Naming,
    Proposal,
    at_all_storeys,
    general_proposal,
    other_names,
    proposal_of,
)
from .places import Place
from .promises import Promise, effects_at, enrichment_of, promise_of
from .sensor_faults import FaultSearch


@dataclass(frozen=True)
class ClassSettings:
    """Effort of a search for classes."""

    # Places whose names are tried; a class that is refused gives way to the next.
    places: int = 4


CLASSES = ClassSettings()


@dataclass(frozen=True)
class SearchTools:
    """What a search asks of others.

    Attributes
    ----------
    faults : FaultSearch
    errors : ChannelErrorTest
    judge : EffectJudge
    estimates : EstimateJudge
    progress : callable
    """

    faults: FaultSearch
    errors: ChannelErrorTest
    judge: EffectJudge
    estimates: EstimateJudge
    progress: Callable[[], object]


@dataclass(frozen=True)
class _Doubt:
    """What speaks against a proposal."""

    words: str
    # Whether the final estimate leaves its coefficients open.
    is_of_estimate: bool = False


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
            result = result.with_accepted(*accepted)
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
            result = result.with_accepted(proposal, judged)
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
            proposal = proposal_of(promise, state, self.tools.estimates)
            if proposal is not None:
                proposals.append(proposal)

        if proposals and room > 1:
            best = max(proposals, key=lambda proposal: proposal.value)
            proposals += at_all_storeys(best, self.places, state, room)
        proposals += _faults(self.tools.faults.findings(state), state)
        general = [p.general for p in promising if p.general is not None]
        return sorted(proposals, key=lambda proposal: -proposal.value), general

    def _promises(self, state: SearchState) -> Iterator[Promise]:
        """What each place promises beside a state, if it is free."""
        for place in self.places:
            self.tools.progress()
            if len(place.sites) > 1:
                continue
            there = effects_at(place, state)
            if there:
                promise = enrichment_of(place, state, there)
            else:
                promise = promise_of(place, state)
            if promise is not None:
                yield promise

    # -- accept, judge ---------------------------------------------------------

    def _first_that_holds(
        self, proposals: Sequence[Proposal], result: ClassResult
    ) -> tuple[tuple[Proposal, JudgedEffect] | None, ClassResult]:
        """The first proposal that holds, and the result with those refused."""
        why = ""
        state = result.state
        self.tools.judge.begin_round()
        self.tools.estimates.begin_round()
        there = self._judged(proposals, state)
        while there:
            best = next_proposal(there, state)
            there.remove(best)
            proposal, judged = best.proposal, best.judged
            if self._has_only_noise_to_explain(proposal.finding, state):
                why = why or "the final estimate without it leaves nothing but noise"
                continue
            if not judged.holds:
                result = self._with_refused(best, result)
                why = why or _in_words(judged)
                continue
            doubt = self._doubt(proposal, result)
            if not doubt:
                proposal = self._with_rivals(best, proposals, state)
                proposal = _with_faults_instead(proposal, proposals, state)
                return (proposal, judged), result
            why = why or doubt.words
            if doubt.is_of_estimate:
                there += self._judged(_general_instead(proposal), state)
        return None, replace(result, why_refused=why)

    def _judged(
        self, proposals: Iterable[Proposal], state: SearchState
    ) -> list[JudgedProposal]:
        """Proposals that are there, with what another condition says of them."""
        judged = []
        for proposal in proposals:
            if is_there(proposal, state):
                at_condition = self.tools.judge.judged(proposal.finding, state)
                judged.append(JudgedProposal(proposal, at_condition))
        return judged

    def _with_rivals(
        self, best: JudgedProposal, proposals: Sequence[Proposal], state: SearchState
    ) -> Proposal:
        """A proposal with names and places that another record does not refute."""
        proposal, naming = best.proposal, best.proposal.naming
        if best.judged.condition != "another record":
            return proposal
        rivals = list(naming.rivals)
        if naming.carries and not proposal.finding.is_fault:
            rivals = self._names_as_good(proposal, state)
        for elsewhere in proposals:
            other = elsewhere.finding
            is_new = other not in rivals and not _adds_to(elsewhere, proposal)
            if is_new and not self.tools.judge.prefers(proposal.finding, other, state):
                rivals.append(other)
        return replace(proposal, naming=replace(naming, rivals=rivals))

    def _names_as_good(self, proposal: Proposal, state: SearchState) -> list[Finding]:
        """Other names of a place that one of the two records does not refute.

        A law that contains the name is another one only where it gains something.
        """
        name, naming = proposal.finding, proposal.naming
        prefers = self.tools.judge.prefers
        least, errors = JUDGE.least_reduction, REDUCTION.sure_errors

        as_good = []
        for other in other_names(name, naming, self._place_of(proposal)):
            if other.candidate.law.contains(name.candidate.law):
                is_rival = prefers(other, name, state, NAMING.gain_of_general, errors)
            else:
                in_search = judge.is_better(name, other, least, errors)
                is_rival = not (
                    in_search and prefers(name, other, state, least, errors)
                )
            if is_rival:
                as_good.append(other)
        return as_good

    def _with_refused(self, failed: JudgedProposal, result: ClassResult) -> ClassResult:
        """The result with a proposal that does not hold at another condition.

        Without a force where the final estimate leaves nothing but noise. A mass takes
        up what a fault changes, but not what a force does.
        """
        is_fault = failed.proposal.finding.is_fault
        if not is_fault and self.tools.estimates.leaves_noise_alone(result.state):
            return result
        return result.with_refused(failed.proposal, failed.judged)

    def _has_only_noise_to_explain(self, finding: Finding, state: SearchState) -> bool:
        """Whether a law is at its site already, and nothing but noise is left.

        Or, of atoms that are added to a law, whether the motion does not show them.
        """
        if finding.is_fault:
            return False
        estimates = self.tools.estimates
        if finding.only_enriches(state.effects):
            assert finding.after is not None
            return estimates.follows_as_well(state, finding.after)
        new = finding.new_effects(state.effects)
        return stands_beside_another(new, state) and estimates.leaves_noise_alone(state)

    def _doubt(self, proposal: Proposal, result: ClassResult) -> _Doubt | None:
        """What speaks against a proposal: channels, final estimate, motion."""
        state, finding = result.state, proposal.finding
        assert finding.after is not None
        before = self.tools.judge.on_all_records(state.model)
        after = self.tools.judge.on_all_records(finding.after.model)
        if self._is_explained_by_errors(finding, before, after):
            return _Doubt("errors of the channels within their tolerances explain it")
        if self.tools.estimates.is_undetermined(finding, state):
            return _Doubt("the final estimate does not determine it", True)
        if self.tools.estimates.contradicts(finding, state):
            return _Doubt("the free run speaks against it")
        return None

    def _is_explained_by_errors(
        self, finding: Finding, before: FittedModel, after: FittedModel
    ) -> bool:
        """Whether errors of the channels within their tolerances explain a finding.

        The same errors in all records. A fault is such an error itself: those of the
        other channels explain it, unless another channel of its DOF witnesses it.
        """
        state, test = finding.before, self.tools.errors
        assert state.records is not None
        if finding.witnessed:
            return False
        if finding.is_fault:
            channels = finding.candidate.sites[0].channels
            of_errors = test.of_other_channels(
                channels, before, state.records, state.effects
            )
            return of_errors > after.reduction_from(before).value
        law = finding.candidate.law
        beyond = test.beyond(after, before, law, state.records, state.effects)
        return not beyond.is_there

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
        return replace(result, first=first).with_state(polished(start))


def _general_instead(proposal: Proposal) -> list[Proposal]:
    """The general law in place of a name that the final estimate leaves open."""
    naming = proposal.naming
    if naming.general is None:
        return []
    general = general_proposal(naming.general, naming.effect_class, naming.names)
    return [] if general is None else [general]


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


def _with_faults_instead(
    proposal: Proposal, proposals: Sequence[Proposal], state: SearchState
) -> Proposal:
    """A proposal with the faults of sensors beside which it is not there.

    Those that explain the data as well as another fault are its rivals.
    """
    known = state.model.spectra.data.known_masses
    instead = []
    for other in proposals:
        if not other.finding.is_fault:
            continue
        is_rival = proposal.finding.is_fault and other.finding in proposal.naming.rivals
        if is_rival or leaves_nothing_of(proposal, other, state):
            instead.append(fault_instead(proposal.finding, other.finding, known))
    return replace(proposal, naming=replace(proposal.naming, instead=instead))


def _adds_to(other: Proposal, proposal: Proposal) -> bool:
    """Whether a proposal is of the class of another, at its site and further ones."""
    same_class = other.naming.effect_class == proposal.naming.effect_class
    sites = set(other.finding.candidate.sites)
    return same_class and bool(sites & set(proposal.finding.candidate.sites))


def _in_words(judged: JudgedEffect) -> str:
    """What a judge says against an effect."""
    decisive = judged.decisive
    size = f"{decisive.value:.2g} dB, standard error {decisive.error:.2g}"
    return f"at {judged.condition} it does not hold ({size})"


def _ranked(proposals: Sequence[Proposal]) -> list[RankedFinding]:
    return [RankedFinding(p.finding, p.reduction) for p in proposals]
