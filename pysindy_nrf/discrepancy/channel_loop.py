"""The loop on records in which floors have no sensor: its equations are channels.

Candidates are ranked by what their force would do to the measured channels, along the
free run and to first order; the best are settled, and one is taken by how much less its
free run misses.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from ..diagnosis.verdict import FreeRuns
from ..exceptions import NRFError
from ..identification.fewer_sensors import estimate, negative, shot_of, told
from ..records.checks.channel_checks import measured
from . import judge, wording
from .audit import audit
from .candidate_search import CandidateSearch
from .catalogue import Experiment, candidates
from .channel_spectra import CHANNELS
from .confirmation import Decision, FoundEffect
from .effects import Candidate, Finding, RankedFinding
from .folds import split, window_length
from .heldout import JudgedModel
from .intervals import parameter_intervals
from .judge import JUDGE
from .judgement import (
    Judgement,
    candidate_table,
    chain_models,
    error_table,
)
from .report import LoopReport, Step
from .request import LoopRequest, progress_bar
from .run_models import ChannelState, FittedRuns, RunModels, SplitRuns
from .steps import draft_step


@dataclass(frozen=True, eq=False)
class SettledFinding:
    """A finding settled about its own free run."""

    ranked: RankedFinding
    state: ChannelState


@dataclass(frozen=True, eq=False)
class ChannelStart:
    """What a search begins with."""

    models: RunModels
    first: ChannelState
    # What is doubtful of the declared model, in sentences.
    notes: list[str]


@dataclass(frozen=True, eq=False)
class ChannelFound:
    """What a search found.

    Attributes
    ----------
    start : ChannelStart
    steps : list of Step
    judged : list of JudgedModel
        The baseline, then the model with each effect.
    final : ChannelState
        With all confirmed effects.
    last : sequence of SettledFinding
        Candidates of the last round, best first.
    """

    start: ChannelStart
    steps: list[Step]
    judged: list[JudgedModel]
    final: ChannelState
    last: Sequence[SettledFinding]


class ChannelLoop:
    """The loop on records in which floors have no sensor.

    Parameters
    ----------
    request : LoopRequest
    """

    def __init__(self, request: LoopRequest) -> None:
        self.request = request

    # -- prepare, split, find bands --------------------------------------------

    def prepare(self) -> FittedRuns:
        """Fit the free run of the declared model to the measured channels."""
        request = self.request
        problem = replace(request.problem, band=request.band)
        shots = []
        for number, record in enumerate(request.all_records):
            shots.append(shot_of(record, number, problem.chain.n_dof))

        n_searched = len(request.records)
        fit, solution, notes = estimate(
            problem, shots[:n_searched], problem.known_masses
        )
        hold = fit.shots[0].hold
        kept = [replace(shot, hold=hold) for shot in shots[n_searched:]]
        return FittedRuns([*fit.shots, *kept], solution.model, notes)

    def split(self, records: FittedRuns) -> SplitRuns:
        """Cut the records into folds; no fit reads what is held out."""
        runs = [shot.run(records.model) for shot in records.shots]
        n_searched = len(self.request.records)
        length = window_length(runs[:n_searched])
        whole = list(range(n_searched, len(runs))) if self.request.heldout else None
        folds = split(runs, length, whole)

        shots = []
        for number, shot in enumerate(records.shots):
            weights = shot.weights.copy()
            for block in folds.heldout:
                if block.segment == number:
                    weights[block.rows] = 0.0
            shots.append(replace(shot, weights=weights))
        return SplitRuns(replace(records, shots=shots), folds, length)

    def find_bands(self, folds: SplitRuns) -> ChannelStart:
        """Find the informative bands, and settle the declared model in them."""
        problem = replace(self.request.problem, band=self.request.band)
        models = RunModels(problem, folds)
        declared = models.declared()
        fit = models.fit(folds.runs.model, declared.search, CHANNELS.fit_steps)
        model = fit.solution.model
        search = CandidateSearch(())
        first = models.settle("baseline", declared.search, search, model)
        if first is None:
            first = models.linearise("baseline", model, model.laws)
        return ChannelStart(models, first, folds.runs.notes)

    # -- search ----------------------------------------------------------------

    def search(self, start: ChannelStart) -> ChannelFound:
        """Add effects one by one, each confirmed before the next is looked for."""
        request = self.request
        tried = self._candidates()
        found = ChannelFound(start, [], [start.first.judged], start.first, ())
        total = request.max_steps * len(tried)
        with progress_bar(request.progress, total) as tick:
            search = CandidateSearch(tried, tick)
            while len(found.steps) < request.max_steps:
                last = self._settled_findings(found, search)
                found = replace(found, last=last)
                number = _accepted(last)
                if number is None:
                    break
                found = _with_step(found, number)
                if not found.steps[-1].confirmed:
                    break
        return found

    def _candidates(self) -> list[Candidate]:
        """Laws at the sites where they make sense, none with a frequency."""
        request = self.request
        catalogue = []
        for law in request.catalogue:
            if not any(shape.is_frequency for shape in law.shapes):
                catalogue.append(law)
        forced = {j for record in request.records for j in record.forced}
        experiment = Experiment(
            catalogue,
            request.problem.chain,
            request.problem.known_masses,
            forced,
            request.covariates,
            len(request.records),
        )
        return list(candidates(experiment))

    def _settled_findings(
        self, found: ChannelFound, search: CandidateSearch
    ) -> list[SettledFinding]:
        """The best candidates settled about their own free runs, best first.

        Only those whose run misses less.
        """
        current = found.final.judged.model
        settled = []
        best = search.findings(found.final.search, 1)[: CHANNELS.settled_candidates]
        for finding in best:
            if finding.after is None:
                continue
            name = finding.candidate.name
            state = found.start.models.settle(name, finding.after, search)
            if state is None:
                continue
            reduction = state.judged.model.reduction_from(current)
            if reduction.value > 0:
                finding = replace(finding, after=state.search, reduction=reduction)
                settled.append(SettledFinding(RankedFinding(finding, reduction), state))
        return sorted(settled, key=lambda one: -one.ranked.reduction.value)

    # -- judge, report ---------------------------------------------------------

    def judge(self, found: ChannelFound) -> Judgement:
        """What may be claimed of the effects."""
        steps, judged = found.steps, found.judged
        final, notes = judged.index(found.final.judged), list(found.start.notes)
        stopped, nothing_claimed = [self._why_stopped(found)], False
        try:
            notes += _doubts(found)
        except NRFError as error:
            stopped, nothing_claimed = wording.no_claim(error.what), True
            steps, judged = [], judged[:1]
            final = 0

        return Judgement(
            steps,
            judged,
            final,
            [*stopped, *notes],
            judged[final].model.spectra.band,
            [one.ranked for one in found.last],
            nothing_claimed,
        )

    def _why_stopped(self, found: ChannelFound) -> str:
        """Why no further effect was added."""
        steps = found.steps
        if steps and not steps[-1].confirmed:
            return "the last effect is not confirmed"
        if len(steps) >= self.request.max_steps:
            return "no further effect was asked for"
        if not found.last:
            return "no law of the catalogue lowers the error at any site"
        return wording.refused(found.last[0].ranked)

    def report(self, judgement: Judgement) -> LoopReport:
        """Gather what the user reads."""
        request, final = self.request, judgement.final_model
        models = chain_models(judgement)
        by_dof = {}
        for name, error in final.errors.items():
            if name.startswith("held-out dof"):
                by_dof[name.removeprefix("held-out ")] = error
        return LoopReport(
            judgement.steps,
            error_table(judgement),
            judgement.stopped_because,
            models[judgement.final],
            judgement.band,
            candidate_table(judgement.last_findings),
            models,
            measured=[measured(record) for record in request.all_records],
            settings=audit(request, "none: channels are taken as they are"),
            bounds=parameter_intervals(final.model),
            free_runs=FreeRuns(pd.DataFrame(by_dof, ["measured channels"])),
            nothing_claimed=judgement.nothing_claimed,
        )


def _accepted(findings: Sequence[SettledFinding]) -> int | None:
    """Number of the finding that is taken, if it is there and large."""
    if not findings:
        return None
    number = judge.simplest([one.ranked for one in findings])
    reduction = findings[number].ranked.reduction
    is_large = reduction.lower >= JUDGE.large_reduction
    return number if judge.is_there(reduction) and is_large else None


def _with_step(found: ChannelFound, number: int) -> ChannelFound:
    """What was found, with one effect more, refined and judged on held-out data.

    The final model has it if it is confirmed.
    """
    chosen = found.last[number]
    rivals = judge.rivals([one.ranked for one in found.last], number)
    state = chosen.state
    state = found.start.models.refine(state.judged, state.search) or state

    before, effect = found.final.judged, state.search.effects[-1]
    pair = FoundEffect(effect, before.model, state.judged.model)
    draft = draft_step(pair, Decision(effect, before, state.judged), rivals)
    certain = draft.plausible and draft.confirmed and not draft.alternatives
    remainder = state.judged.error / before.error
    step = draft.finished([], remainder, certain)
    step = replace(step, evidence=step.evidence + _not_told_from(rivals))
    return replace(
        found,
        steps=[*found.steps, step],
        judged=[*found.judged, state.judged],
        final=state if step.confirmed else found.final,
    )


def _not_told_from(rivals: Iterable[Finding]) -> str:
    """Candidates that explain the channels as well as an effect, in words."""
    names = [finding.candidate.name for finding in rivals]
    return "".join(f"; the channels cannot tell it from {name}" for name in names)


def _doubts(found: ChannelFound) -> list[str]:
    """What the channels give poorly of the final model, in sentences.

    Raises
    ------
    NRFError
        If they do not give its parameters at all.
    """
    state = found.final
    model = state.judged.model.chain_model()
    fit = found.start.models.fit(model, state.search, 0)
    doubts = told(fit.solution, fit.rebuild)
    return doubts + negative(fit.solution, fit.rebuild)
