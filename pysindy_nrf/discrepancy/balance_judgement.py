"""What the loop concludes of balances: the steps, the final model, what is left."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ..exceptions import NRFError
from ..identification.result import IdentificationResult
from ..records.record import Record
from . import wording
from .catalogue import same_balance
from .claims import why_no_claim
from .class_result import ClassResult, TriedEffect
from .class_search import ClassSearch
from .contradictions import Contradiction
from .decision import Decision
from .effects import Effect, instants_of
from .final_estimate import FinalEstimates
from .fitted_model import FittedModel
from .heldout import HeldoutJudge, JudgedModel, search_errors
from .judgement import Judgement
from .prepare import Band, PreparedRecords
from .report import Step
from .request import LoopRequest
from .spectra import BalanceSpectra
from .steps import StepDraft, draft_step


@dataclass(frozen=True, eq=False)
class BalanceOutcome:
    """What a search found, and what judges it.

    Attributes
    ----------
    measured, records : PreparedRecords
        All samples, as measured, and freed of the faults that were found.
    result : ClassResult
        On all samples.
    search : ClassSearch
    estimates : FinalEstimates
        Those that the search asked for.
    excerpts : BalanceSpectra or None
        Spectra on which long records were searched; None if all samples were.
    """

    measured: PreparedRecords
    records: PreparedRecords
    result: ClassResult
    search: ClassSearch
    estimates: FinalEstimates
    excerpts: BalanceSpectra | None = None

    @property
    def contradictions(self) -> list[Contradiction]:
        """Contradictions of the channels, if all samples were searched for faults."""
        records = self.result.state.records
        if self.excerpts is not None or records is None:
            return []
        return self.search.tools.faults.known_contradictions(records)


@dataclass(frozen=True, eq=False)
class BalanceJudgement:
    """What the loop concludes, with all that the report needs.

    Attributes
    ----------
    judgement : Judgement
    outcome : BalanceOutcome
    identified : IdentificationResult or None
        The final estimate; None if it cannot be made.
    """

    judgement: Judgement
    outcome: BalanceOutcome
    identified: IdentificationResult | None


@dataclass(frozen=True, eq=False)
class _Course:
    """The baseline and the models with each effect, judged on held-out data.

    Attributes
    ----------
    judged : list of JudgedModel
    drafts : list of StepDraft
        One for each model but the baseline.
    final : int
        Number of the model with all confirmed effects.
    """

    judged: list[JudgedModel]
    drafts: list[StepDraft]
    final: int


class BalanceJudge:
    """Gathers what a search found into steps.

    Parameters
    ----------
    request : LoopRequest
    outcome : BalanceOutcome
    """

    def __init__(self, request: LoopRequest, outcome: BalanceOutcome) -> None:
        self.request = request
        self.outcome = outcome
        self.heldout = HeldoutJudge(instants_of(outcome.result.effects))

    def judge(self) -> BalanceJudgement:
        """Judge the model with each effect, and find how sure they are."""
        result = self.outcome.result
        course = self._course()
        final = course.final
        drafts = course.drafts
        judged = course.judged
        stopped = self._why_stopped()

        band = result.first.model.spectra.band
        identified = self._estimate(judged[final].model, band)
        no_claim = _why_no_claim(judged[final], identified)
        if no_claim:
            final = 0
            stopped = wording.no_claim(no_claim)
            # the search does not know where the balances hold information
            alone = self.request.band or (None, None)
            identified = self._estimate(judged[0].model, alone)
            unfit = _why_no_claim(judged[0], identified)
            drafts = [] if unfit else [draft.refused() for draft in drafts]
            judged = judged[:1] if unfit else judged

        judgement = Judgement(
            _finished(drafts, self._has_filtered_channel()),
            judged,
            final,
            [*stopped, *self._remarks()],
            band,
            result.last,
            bool(no_claim),
        )
        return BalanceJudgement(judgement, self.outcome, identified)

    # -- the course of the search, on all samples ------------------------------

    def _course(self) -> _Course:
        """The models with each effect; what was refused beside those before it."""
        result = self.outcome.result
        # the products of the largest model serve all smaller ones
        largest = result.state.model
        largest.spectra.products(largest.layout)
        largest.powers_on(self.heldout.heldout(largest.spectra))

        current = self.heldout.judged("baseline", result.first.model)
        judged = [current]
        drafts = []
        final = 0
        claims = [t for t in result.accepted if not t.effect.enriches]
        refused = {tried.position: tried for tried in result.refused}
        for number, tried in enumerate([*claims, None]):
            turned_down = refused.pop(number, None)
            if turned_down is not None:
                decision = self._decided(current, turned_down, False)
                judged.append(decision.after)
                drafts.append(_draft(turned_down, decision, []))
            if tried is None:
                break
            beside = self._enrichment_of(tried)
            decision = self._decided(current, tried, True, beside)
            current = decision.after
            judged.append(current)
            drafts.append(_draft(tried, decision, beside))
            final = len(judged) - 1
        return _Course(_one_table(judged, self.heldout), drafts, final)

    def _enrichment_of(self, tried: TriedEffect) -> list[Effect]:
        """Effects that only add to one."""
        beside = []
        for other in self.outcome.result.accepted:
            same_class = other.naming.effect_class == tried.naming.effect_class
            same_site = other.effect.site == tried.effect.site
            if other.effect.enriches and same_class and same_site:
                beside.append(other.effect)
        return beside

    def _decided(
        self,
        current: JudgedModel,
        tried: TriedEffect,
        confirmed: bool,
        beside: Sequence[Effect] = (),
    ) -> Decision:
        """The models without and with an effect.

        Both are the same where it cannot be fitted to all samples.
        """
        effect = tried.effect
        name = f"{effect.law.name} at {effect.site}"
        before = current
        try:
            if effect.is_constant:
                before = self._with_means(current)
            model = self._with_effect(before.model, tried)
            model = model.with_laws([(e.site, e.law) for e in beside])
        except NRFError:
            return Decision(effect, current, replace(current, name=name), False)
        return Decision(effect, before, self.heldout.judged(name, model), confirmed)

    def _with_means(self, current: JudgedModel) -> JudgedModel:
        """A model with the means left in, which show a constant force."""
        with_means = self.heldout.with_means(current.model)
        if with_means is current.model:
            return current
        return self.heldout.judged(current.name, with_means)

    def _with_effect(self, model: FittedModel, tried: TriedEffect) -> FittedModel:
        """A model with an effect; a fault only changes the records."""
        effect, spectra = tried.effect, tried.corrected
        if spectra is None:
            return model.with_laws([(effect.site, effect.law)])
        if not model.spectra.windows.centred:
            spectra = self.heldout.spectra_with_means(spectra)
        return model.refitted(spectra)

    # -- final estimate, words -------------------------------------------------

    def _estimate(self, model: FittedModel, band: Band) -> IdentificationResult | None:
        """The final estimate of the laws of a model."""
        outcome = self.outcome
        records: Sequence[Record] = self.request.records
        if any(effect.is_fault for effect in outcome.result.effects):
            records = outcome.records.searched
        return outcome.estimates.of(model.laws, records, band)

    def _why_stopped(self) -> list[str]:
        """Why the search added no further effect."""
        result = self.outcome.result
        if len(result.effects) >= self.request.max_steps:
            return [wording.enough_effects(self.request.max_steps)]
        return [wording.best_refused(result.last, result.why_refused)]

    def _has_filtered_channel(self) -> bool:
        """Whether a channel has passed a high-pass filter, which relaxes as laws do."""
        notes = self.outcome.measured.data.quality
        return any(note.kind == "corner" for note in notes)

    def _remarks(self) -> list[str]:
        """What else a reader should know of the records."""
        remarks = []
        if self.request.searches_heldout:
            remarks.append(wording.HELDOUT_IS_SEARCHED)
        if self.outcome.contradictions:
            remarks.append(wording.channels_disagree(self.outcome.contradictions))
        return remarks


def _why_no_claim(judged: JudgedModel, identified: IdentificationResult | None) -> str:
    """Why nothing may be claimed of a model, by its final estimate where there is one.

    Empty if something may.
    """
    if identified is None:
        return why_no_claim(judged, judged.model.chain_model())
    return why_no_claim(judged, identified.model)


def _draft(
    tried: TriedEffect, decision: Decision, beside: Sequence[Effect]
) -> StepDraft:
    """The step of an effect without the certainty of its name."""
    draft = draft_step(decision, tried.naming.rivals)
    naming, judged = tried.naming, tried.judged
    step = replace(
        draft.step,
        effect_class=naming.effect_class,
        closest=naming.closest,
        closest_share=naming.share,
        carries=naming.carries,
        judged_by=judged.condition,
        judged_reduction=judged.decisive.value,
        judged_error=judged.decisive.error,
        laws_beside=[effect.law.name for effect in beside],
    )
    plausible = draft.plausible and not naming.one_shape
    return replace(draft, step=step, plausible=plausible)


def _finished(drafts: Sequence[StepDraft], filtered: bool) -> list[Step]:
    """The steps with the certainty of their names.

    A name is sure that another record has judged, where it carries the model and the
    records refute every other, there and elsewhere; none with memory beside a filtered
    channel.
    """
    steps = []
    for draft in drafts:
        step = draft.step
        relaxes = filtered and draft.effect.law.has_memory
        laws_beside = [*step.laws_beside, *_laws_beside(draft, drafts)]
        is_only = not (step.rivals or step.alternatives or laws_beside)
        is_named = step.carries and is_only
        judged = step.confirmed and step.judged_by == "another record"
        sure = judged and is_named and draft.plausible and not relaxes
        steps.append(replace(step, laws_beside=laws_beside, sure=sure))
    return steps


def _laws_beside(draft: StepDraft, drafts: Iterable[StepDraft]) -> list[str]:
    """Other confirmed laws in the same balance with the same motion."""
    site = same_balance(draft.effect.site)
    laws_beside = []
    for other in drafts:
        there = other is not draft and same_balance(other.effect.site) == site
        if there and other.step.confirmed:
            laws_beside.append(other.effect.law.name)
    return laws_beside


def _one_table(
    judged: Sequence[JudgedModel], heldout: HeldoutJudge
) -> list[JudgedModel]:
    """The judged models, their errors with or without the means alike."""
    if all(each.model.spectra.windows.centred for each in judged):
        return list(judged)
    alike = []
    for each in judged:
        with_means = heldout.judged(each.name, heldout.with_means(each.model))
        errors: Mapping[str, float] = search_errors(with_means.model)
        alike.append(replace(with_means, errors={**with_means.errors, **errors}))
    return alike
