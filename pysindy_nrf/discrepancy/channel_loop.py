"""The loop on records in which floors have no sensor: its equations are channels.

Candidates are ranked by what their force would do to the measured channels, along the
free run and to first order; the best are settled, and one is taken by how much less its
free run misses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from ..diagnosis.verdict import FreeRuns
from ..exceptions import NRFError
from ..identification.fewer_sensors import estimate, shot_of
from ..identification.result import IdentificationResult
from ..records.checks.channel_checks import measured
from . import judge, wording
from .candidate_search import SEARCH, best_findings
from .catalogue import with_all_storeys, without_tied_laws
from .channel_gains import explained_by_gains
from .channel_spectra import CHANNELS
from .course import Course
from .decision import Decision, falls_on_heldout
from .effects import Candidate, Effect, Finding, RankedFinding
from .final_estimate import with_final_estimate
from .heldout import JudgedModel
from .judge import JUDGE
from .judgement import Judgement, report_of
from .places import class_at
from .report import LoopReport, Step
from .run_models import ChannelState, FittedRun, FittedRuns, RunModels, SplitRuns
from .steps import draft_step


@dataclass(frozen=True, eq=False)
class SettledFinding:
    """A finding settled about its own free run.

    Attributes
    ----------
    ranked : RankedFinding
    state : ChannelState
    first_order : Finding
        The same about the run without it.
    """

    ranked: RankedFinding
    state: ChannelState
    first_order: Finding

    @property
    def expected(self) -> float:
        """Error reduction that a fit may come to, dB."""
        return max(self.ranked.reduction.value, self.first_order.value)


@dataclass(frozen=True, eq=False)
class ChannelStart:
    """What a search begins with."""

    models: RunModels
    first: ChannelState


@dataclass(frozen=True, eq=False)
class ChannelOutcome:
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
    why_refused : str
        What speaks against the best of them.
    """

    start: ChannelStart
    steps: list[Step]
    judged: list[JudgedModel]
    final: ChannelState
    last: Sequence[SettledFinding]
    why_refused: str = ""


@dataclass(frozen=True, eq=False)
class ChannelJudgement:
    """What the loop concludes, and the final estimate; None if nothing is claimed."""

    judgement: Judgement
    identified: IdentificationResult | None


class ChannelLoop(
    Course[FittedRuns, SplitRuns, ChannelStart, ChannelOutcome, ChannelJudgement]
):
    """The loop on records in which floors have no sensor.

    Parameters
    ----------
    request : LoopRequest
    """

    # -- prepare, split, find bands --------------------------------------------

    def prepare(self) -> FittedRuns:
        """Fit the free run of the declared model to the measured channels."""
        request = self.request
        problem = replace(request.problem, band=request.band)
        shots = []
        for number, record in enumerate(request.all_records):
            shots.append(shot_of(record, number, problem.chain.n_dof))

        n_searched = len(request.records)
        declared = estimate(problem, shots[:n_searched], problem.known_masses)
        hold = declared.fit.shots[0].hold
        heldout = [shot.with_hold(hold) for shot in shots[n_searched:]]
        return FittedRuns([*declared.fit.shots, *heldout], declared)

    def split(self, records: FittedRuns) -> SplitRuns:
        """Cut the records into folds; no fit reads what is held out."""
        folds = self.folds_of([shot.run(records.model) for shot in records.shots])
        shots = []
        for number, shot in enumerate(records.shots):
            weights = shot.weights.copy()
            for block in folds.split.heldout:
                if block.segment == number:
                    weights[block.rows] = 0.0
            shots.append(replace(shot, weights=weights))
        return SplitRuns(replace(records, shots=shots), folds.split, folds.window)

    def find_bands(self, folds: SplitRuns) -> ChannelStart:
        """Find the informative bands, and settle the declared model in them."""
        problem = replace(self.request.problem, band=self.request.band)
        models = RunModels(problem, folds)
        declared = models.declared()
        run = models.fit(declared, CHANNELS.fit_steps)
        first = models.settle("baseline", declared.search, run)
        if first is None:
            first = models.linearise("baseline", run, run.model.laws)
        return ChannelStart(models, first)

    # -- search ----------------------------------------------------------------

    def search(self, start: ChannelStart) -> ChannelOutcome:
        """Add effects one by one, each confirmed before the next is looked for."""
        max_steps = self.request.max_steps
        outcome = ChannelOutcome(start, [], [start.first.judged], start.first, ())
        candidates = self._candidates()
        with self.progress(len(candidates)) as tick:
            while len(outcome.steps) < max_steps:
                room = max_steps - len(outcome.steps)
                possible = [c for c in candidates if len(c.sites) <= room]
                settled = _settled_findings(outcome, possible, tick)
                outcome = replace(outcome, last=settled)
                number = _accepted(outcome.last)
                if number is None:
                    break
                first_order = outcome.last[number].first_order
                if explained_by_gains(first_order.value, outcome.final.search.model):
                    outcome = replace(outcome, why_refused=wording.GAINS_EXPLAIN)
                    break
                outcome = _with_effects(outcome, number, bool(self.request.heldout))
                if not outcome.steps[-1].confirmed:
                    break
        return outcome

    def _candidates(self) -> list[Candidate]:
        """Laws at the sites where they make sense, none with a frequency.

        One of several sites is a dashpot from every floor to the ground.
        """
        request = self.request
        catalogue = []
        for law in request.catalogue:
            if not any(shape.is_frequency for shape in law.shapes):
                catalogue.append(law)
        forced = {j for record in request.records for j in record.forced}
        alone = self.candidates(catalogue, forced, request.covariates)
        chain = request.problem.chain
        every = with_all_storeys(without_tied_laws(alone, chain), chain.sites)
        return [c for c in every if len(c.sites) == 1 or c.law.acts_at == ("ground",)]

    # -- judge, report ---------------------------------------------------------

    def judge(self, outcome: ChannelOutcome) -> ChannelJudgement:
        """What may be claimed of the effects, by the final estimate."""
        steps, judged = outcome.steps, outcome.judged
        final = judged.index(outcome.final.judged)
        stopped = [self._why_stopped(outcome)]
        identified = None
        try:
            identified = outcome.start.models.final_estimate(outcome.final)
        except NRFError as error:
            stopped = wording.no_claim(error.what)
            steps, judged = [], judged[:1]
            final = 0

        judgement = Judgement(
            steps,
            judged,
            final,
            stopped,
            judged[final].model.spectra.band,
            [settled.ranked for settled in outcome.last],
            identified is None,
        )
        return ChannelJudgement(judgement, identified)

    def _why_stopped(self, outcome: ChannelOutcome) -> str:
        """Why no further effect was added."""
        steps, max_steps = outcome.steps, self.request.max_steps
        if steps and not steps[-1].confirmed:
            return "the last effect is not confirmed"
        if len(steps) >= max_steps:
            return wording.enough_effects(max_steps)
        ranked = [settled.ranked for settled in outcome.last]
        return wording.best_refused(ranked, outcome.why_refused)

    def report(self, concluded: ChannelJudgement) -> LoopReport:
        """Gather what the user reads."""
        request = self.request
        judgement, identified = concluded.judgement, concluded.identified
        visited = None if identified is None else identified.model.visited
        calibration = "none: channels are taken as they are"
        report = replace(
            report_of(request, judgement, calibration, visited),
            measured=[measured(record) for record in request.all_records],
            free_runs=_free_runs(judgement, identified),
        )
        return with_final_estimate(report, identified)


def _free_runs(
    judgement: Judgement, identified: IdentificationResult | None
) -> FreeRuns:
    """Errors of the measured channels; of those held out without a final estimate."""
    if identified is not None:
        return identified.free_runs
    by_dof = {}
    for name, error in judgement.final_model.errors.items():
        if name.startswith("held-out dof"):
            by_dof[name.removeprefix("held-out ")] = error
    return FreeRuns(pd.DataFrame(by_dof, ["measured channels"]))


def _settled_findings(
    outcome: ChannelOutcome,
    candidates: Sequence[Candidate],
    progress: Callable[[], object],
) -> list[SettledFinding]:
    """The best candidates settled about their own free runs, best first.

    Only those whose run misses less. Those that may be the best are fitted, too.
    """
    state = outcome.final.search
    taken = {(effect.site, effect.template.effect_class) for effect in state.effects}
    free = []
    for candidate in candidates:
        if (candidate.sites[0], candidate.law.effect_class) not in taken:
            free.append(candidate)
    findings = best_findings(state, free, SEARCH.finalists, progress)

    settled = []
    for finding in findings:
        about = _settled(finding, outcome)
        if about is not None:
            settled.append(about)

    best = max([0.0, *(about.expected for about in settled)])
    enough = max(JUDGE.least_reduction, CHANNELS.share_of_best * best)
    for number, about in enumerate(settled):
        if about.expected >= enough:
            refined = outcome.start.models.refine_candidate(about.state)
            settled[number] = _about(refined, about.first_order, outcome)

    better = [about for about in settled if about.ranked.reduction.value > 0]
    return sorted(better, key=lambda about: -about.ranked.reduction.value)


def _settled(finding: Finding, outcome: ChannelOutcome) -> SettledFinding | None:
    """A finding linearised about its own free run; None if that diverges."""
    if finding.after is None:
        return None
    name = finding.candidate.name
    start = FittedRun(finding.after.model.chain_model(), outcome.final.shots)
    state = outcome.start.models.settle(name, finding.after, start)
    if state is None:
        return None
    return _about(state, finding, outcome)


def _about(
    state: ChannelState, finding: Finding, outcome: ChannelOutcome
) -> SettledFinding:
    """A finding about a free run with it."""
    reduction = state.judged.model.reduction_from(outcome.final.judged.model)
    after = replace(finding, after=state.search, reduction=reduction)
    return SettledFinding(RankedFinding(after, reduction), state, finding)


def _accepted(findings: Sequence[SettledFinding]) -> int | None:
    """Number of the finding that is taken, if it is there and large."""
    if not findings:
        return None
    number = judge.simplest([settled.ranked for settled in findings])
    reduction = findings[number].ranked.reduction
    is_large = reduction.lower >= JUDGE.large_reduction
    return number if judge.is_there(reduction) and is_large else None


def _with_effects(
    outcome: ChannelOutcome, number: int, has_records: bool
) -> ChannelOutcome:
    """The outcome with the effects of a finding, refined and judged on held-out data.

    The final model has them if they are confirmed.
    """
    chosen = outcome.last[number]
    rivals = judge.rivals([settled.ranked for settled in outcome.last], number)
    state = outcome.start.models.refine(chosen.state)

    before = outcome.final
    first_new = len(before.search.effects)
    steps = [
        _step_of(effect, before.judged, state.judged, rivals, has_records)
        for effect in state.search.effects[first_new:]
    ]
    return replace(
        outcome,
        steps=[*outcome.steps, *steps],
        judged=[*outcome.judged, *[state.judged] * len(steps)],
        final=state if steps[-1].confirmed else before,
    )


def _step_of(
    effect: Effect,
    before: JudgedModel,
    after: JudgedModel,
    rivals: Sequence[Finding],
    has_records: bool,
) -> Step:
    """The step of an effect, by the models without and with it."""
    confirmed = falls_on_heldout(effect.law, before, after)
    decision = Decision(effect, before, after, confirmed)
    draft = draft_step(decision, rivals)
    heldout = decision.heldout_reduction
    is_only = not (rivals or draft.step.alternatives)
    return replace(
        draft.step,
        sure=has_records and confirmed and draft.plausible and is_only,
        remainder=after.error / before.error,
        evidence=draft.step.evidence + _not_told_from(rivals),
        effect_class=class_at(effect.template, effect.site, before.model.base),
        closest=effect.law.name,
        judged_by="another record" if has_records else "another time",
        judged_reduction=heldout.value,
        judged_error=heldout.standard_error,
    )


def _not_told_from(rivals: Iterable[Finding]) -> str:
    """Candidates that explain the channels as well as an effect, in words."""
    names = [finding.candidate.name for finding in rivals]
    return "".join(
        f"; the channels cannot distinguish it from {name}" for name in names
    )
