"""What the loop concludes of balances: confirmed effects, and how sure they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

from . import wording
from .bootstrap import SimulatedRecords, simulated
from .certainty import CERTAINTY, CertaintyReport, certainty_of, lacks_a_law
from .claims import GeneralReduction, general_reductions, why_no_claim
from .confirmation import Confirmation, Confirmer
from .contradictions import Contradiction
from .fitted_model import FittedModel
from .heldout import HeldoutJudge, JudgedModel, search_errors
from .judgement import Judgement
from .prepare import PreparedRecords
from .report import Step
from .request import LoopRequest
from .spectra import BalanceSpectra
from .steps import StepDraft, draft_step
from .stepwise import SearchResult, StepwiseSearch


@dataclass(frozen=True, eq=False)
class BalanceOutcome:
    """What a search found, and what judges it.

    Attributes
    ----------
    measured, records : PreparedRecords
        All samples, as measured, and freed of the faults that were found.
    result : SearchResult
        On all samples.
    search : StepwiseSearch
    excerpts : BalanceSpectra or None
        Spectra on which long records were searched; None if all samples were.
    """

    measured: PreparedRecords
    records: PreparedRecords
    result: SearchResult
    search: StepwiseSearch
    excerpts: BalanceSpectra | None = None

    @property
    def contradictions(self) -> list[Contradiction]:
        """Contradictions of the channels, if all samples were searched for faults."""
        records = self.result.state.records
        if self.excerpts is not None or records is None:
            return []
        return self.search.faults.known_contradictions(records)

    def on_excerpts(self, model: FittedModel) -> FittedModel:
        """The same laws on the excerpts by which long records were searched."""
        if self.excerpts is None:
            return model
        if model.spectra.windows.centred:
            return model.refitted(self.excerpts)
        return model.refitted(self.excerpts.with_means())


@dataclass(frozen=True, eq=False)
class Remainder:
    """What the final model leaves unexplained.

    Attributes
    ----------
    certainty : CertaintyReport
        Beside what noise leaves.
    general : list of GeneralReduction
        What general laws would still general.
    noise : SimulatedRecords or None
        What the final model would have produced; None if it has no free run.
    """

    certainty: CertaintyReport
    general: list[GeneralReduction]
    noise: SimulatedRecords | None

    @property
    def lacking(self) -> list[GeneralReduction]:
        """General laws that explain more than the model."""
        return [general for general in self.general if general.is_there]


@dataclass(frozen=True, eq=False)
class BalanceJudgement:
    """What the loop concludes, with all that the report needs."""

    judgement: Judgement
    remainder: Remainder
    outcome: BalanceOutcome


class BalanceJudge:
    """Judges what a search found.

    Parameters
    ----------
    request : LoopRequest
    outcome : BalanceOutcome
    """

    def __init__(self, request: LoopRequest, outcome: BalanceOutcome) -> None:
        self.request = request
        self.outcome = outcome
        self.has_room = len(outcome.result.effects) < request.max_steps

    def judge(self) -> BalanceJudgement:
        """Confirm effects on held-out data, and find how sure they are."""
        heldout = HeldoutJudge(_instants(self.outcome.result))
        confirmation = Confirmer(self.outcome.result, heldout).confirm()
        drafts = self._drafts(confirmation)
        judged = _one_table(confirmation, heldout)
        final = confirmation.judged.index(confirmation.final)
        stopped = self._why_stopped(confirmation)

        unfit = why_no_claim(confirmation.largest)
        no_claim = unfit or why_no_claim(confirmation.final.model)
        if no_claim:
            final = 0
            stopped = wording.no_claim(no_claim)
            drafts = [draft.refused() for draft in drafts]
        if unfit:
            drafts, judged = [], judged[:1]

        claims = not no_claim
        remainder = self._remainder(judged[final].model, drafts, claims)
        judgement = Judgement(
            _finished(drafts, remainder, self._has_filtered_channel()),
            judged,
            final,
            [*stopped, *self._remarks(remainder, claims)],
            self.outcome.result.first.model.spectra.band,
            self.outcome.result.last_round.findings,
            not claims,
        )
        return BalanceJudgement(judgement, remainder, self.outcome)

    def _drafts(self, confirmation: Confirmation) -> list[StepDraft]:
        """The steps of the effects without the certainty of their names."""
        drafts = []
        for decision in confirmation.decisions:
            effect = decision.effect
            rivals = self.outcome.result.rivals.get(effect, ())
            drafts.append(draft_step(confirmation.searched[effect], decision, rivals))
        return drafts

    def _why_stopped(self, confirmation: Confirmation) -> list[str]:
        """Why the search added no further effect."""
        stopped = wording.enough_effects(self.request.max_steps)
        if self.has_room:
            last = self.outcome.result.last_round
            stopped = wording.best_refused(last.findings, last.examinations.get(0))
        means_are_in = not confirmation.largest.spectra.windows.centred
        if means_are_in and len(confirmation.decisions) > 1:
            return [stopped, wording.MEANS_LEFT_IN]
        return [stopped]

    def _remainder(
        self, final: FittedModel, drafts: Sequence[StepDraft], claims: bool
    ) -> Remainder:
        """What the final model leaves beside noise, and what would explain it."""
        outcome, state = self.outcome, self.outcome.result.state
        assert state.records is not None
        on_excerpts = outcome.on_excerpts(final)
        draws = simulated(state.records, on_excerpts, self.request.rng, CERTAINTY.draws)
        noise = next(draws, None)
        every = draws if noise is None else chain([noise], draws)
        certainty = certainty_of(drafts, final, every)

        is_sure = any(effect.sure for effect in certainty.effects)
        asked = is_sure or (self.has_room and claims)
        general = general_reductions(on_excerpts, state, outcome.search.errors, asked)
        return Remainder(certainty, general, noise)

    def _has_filtered_channel(self) -> bool:
        """Whether a channel has passed a high-pass filter, which relaxes as laws do."""
        notes = self.outcome.measured.data.quality
        return any(note.kind == "corner" for note in notes)

    def _remarks(self, remainder: Remainder, claims: bool) -> list[str]:
        """What else a reader should know of the records and the model."""
        remarks = []
        if remainder.lacking and self.has_room and claims:
            remarks.append(wording.not_in_catalogue(remainder.lacking))
        contradictions = self.outcome.contradictions
        if contradictions:
            remarks.append(wording.channels_disagree(contradictions))
        return remarks


def _finished(
    drafts: Sequence[StepDraft], remainder: Remainder, filtered: bool
) -> list[Step]:
    """The steps with the certainty of their names.

    None is sure where a law lacks, nor one with memory beside a filtered channel.
    """
    lacking = [general.site for general in remainder.lacking]
    steps = []
    for draft, certainty in zip(drafts, remainder.certainty.effects):
        relaxes = filtered and draft.effect.law.has_memory
        lacks = lacks_a_law(draft.effect.site, lacking)
        sure = certainty.sure and not lacks and not relaxes
        steps.append(draft.finished(certainty.company, certainty.remainder, sure))
    return steps


def _instants(result: SearchResult) -> list[float]:
    """Times at which effects that were found change something, s."""
    instants = []
    for effect in result.effects:
        for shape in effect.law.shapes:
            if shape.instant:
                instants.append(float(effect.law.shape[shape.name] or 0.0))
    return instants


def _one_table(confirmation: Confirmation, heldout: HeldoutJudge) -> list[JudgedModel]:
    """The judged models, their errors with or without the means alike."""
    judged = confirmation.judged
    if not confirmation.largest.spectra.windows.centred:
        alike = []
        for model in judged:
            errors = search_errors(heldout.with_means(model.model))
            alike.append(replace(model, errors={**model.errors, **errors}))
        judged = alike
    if not confirmation.final.model.spectra.windows.centred:
        judged = [heldout.judged(j.name, heldout.with_means(j.model)) for j in judged]
    return judged
