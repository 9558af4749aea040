"""The loop on records in which every floor has a sensor: its equations are balances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.fft import next_fast_len

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..diagnosis.verdict import DOUBTFUL, free_runs, suspect_channels
from ..exceptions import ChannelError, ExcitationError
from ..identification.fitted import wiring_of
from ..identification.problem import Problem
from ..laws.base import ForceLaw
from ..records.dataset import Dataset
from ..records.quality import QualityNote
from ..records.zero_phase_filter import filters_of
from . import wording
from .band_search import find_bands
from .bootstrap import SimulatedRecords, simulated
from .candidate_search import CandidateSearch
from .catalogue import Experiment, candidates, flexible, with_all_storeys
from .certainty import CERTAINTY, certainty_of, lacks_a_law
from .channel_errors import ChannelErrorTest
from .claims import GeneralGain, general_gains, lack_of_fit, why_no_claim
from .confirmation import Confirmation, Confirmer
from .contradictions import Contradiction
from .course import Course
from .effects import Candidate, SearchState
from .excerpts import EXCERPTS, excerpts
from .fitted_model import FittedModel, fit_model
from .folds import split, window_length
from .free_run import FREE_RUN
from .heldout import HeldoutJudge, JudgedModel, search_errors
from .intervals import parameter_intervals
from .judgement import (
    Judgement,
    audit,
    candidate_table,
    chain_models,
    error_table,
    measured_records,
)
from .prepare import PreparedRecords, prepare
from .report import LoopReport
from .request import progress_bar
from .residual import Evidence, NoiseFloor, look, loops_of, residual_of
from .search_data import SearchData
from .spectra import BalanceSpectra
from .steps import StepDraft, draft_step
from .stepwise import SearchResult, StepwiseSearch
from .windows import Windows


@dataclass(frozen=True, eq=False)
class SplitRecords:
    """Fused records with their folds and held-out pieces."""

    records: PreparedRecords
    data: SearchData


@dataclass(frozen=True, eq=False)
class BalanceStart:
    """What a search begins with.

    Attributes
    ----------
    folds : SplitRecords
        All samples.
    first : SearchState
        The declared model, fitted in the informative bands, and the records that the
        search reads: all samples, or excerpts of long records.
    """

    folds: SplitRecords
    first: SearchState

    @property
    def reads_excerpts(self) -> bool:
        """Whether the search reads excerpts of long records."""
        return self.first.records is not self.folds.records


@dataclass(frozen=True, eq=False)
class BalanceFound:
    """What a search found, and what judges it.

    Attributes
    ----------
    measured, records : PreparedRecords
        All samples, as measured, and freed of the faults that were found.
    result : SearchResult
        On all samples.
    search : StepwiseSearch
    excerpts : BalanceSpectra or None
        Spectra on which long records were searched.
    """

    measured: PreparedRecords
    records: PreparedRecords
    result: SearchResult
    search: StepwiseSearch
    excerpts: BalanceSpectra | None


@dataclass(frozen=True, eq=False)
class BalanceJudgement(Judgement):
    """What the loop concludes of balances.

    Attributes
    ----------
    measured, records : PreparedRecords
        All samples, as measured, and freed of the faults that were found.
    general : sequence of GeneralGain
        What general laws would still gain.
    beyond_noise : ndarray of shape (n_dof,)
        Error of each balance beyond what noise leaves of it, percent.
    noise : SimulatedRecords or None
        What the final model would have produced; None if it has no free run.
    contradictions : sequence of Contradiction
    """

    measured: PreparedRecords | None = None
    records: PreparedRecords | None = None
    general: Sequence[GeneralGain] = ()
    beyond_noise: np.ndarray | None = None
    noise: SimulatedRecords | None = None
    contradictions: Sequence[Contradiction] = ()


class BalanceLoop(
    Course[PreparedRecords, SplitRecords, BalanceStart, BalanceFound, BalanceJudgement]
):
    """The loop on records in which every floor has a sensor."""

    # -- prepare, split, find bands --------------------------------------------

    def prepare(self) -> PreparedRecords:
        """Fuse the channels of every record to one motion."""
        return prepare(self.request.records, self.request.heldout)

    def split(self, records: PreparedRecords) -> SplitRecords:
        """Cut the records into folds, and put held-out pieces aside."""
        request = self.request
        # a band that cannot be is refused here
        filters_of(request.band, records.data)
        segments = records.data.segments
        n_searched = len(records.searched)
        length = window_length(segments[:n_searched])
        folds = split(segments, length, records.heldout)
        data = SearchData(records.data, *folds, request.problem.known_masses)
        if not data.forced and not data.known_masses:
            raise ExcitationError(
                "No force is measured and no mass is known, so nothing scales the"
                " chain",
                "Give the baseline known_masses={dof: kg}.",
            )
        return SplitRecords(records, data)

    def find_bands(self, folds: SplitRecords) -> BalanceStart:
        """Find the informative bands; of long records on excerpts."""
        records, data = excerpts(folds.records, folds.data)
        return self._start(folds, records, data)

    def _start(
        self, folds: SplitRecords, records: PreparedRecords, data: SearchData
    ) -> BalanceStart:
        """Find the informative bands, and fit the declared model in them."""
        problem, band = self.request.problem, self.request.band
        laws = declared_laws(problem, data)
        rich = flexible(replace(problem, laws=laws), data)
        windows = Windows(data.data, data.search, self._window(folds, data))
        if band is not None:
            windows = windows.within(*band)

        bands = find_bands(BalanceSpectra(data, windows), problem.chain, [laws, rich])
        windows = windows.up_to(bands.n_bands - 1)
        data = data.seen_through(bands.limits(windows.edges, data.fastest))
        spectra = BalanceSpectra(data, windows, bands)
        model = fit_model(spectra, problem.chain, laws)
        require_covariates(model, folds.records)
        folds = replace(folds, data=data.full)
        return BalanceStart(folds, SearchState(model, records=records))

    def _window(self, folds: SplitRecords, data: SearchData) -> float:
        """Length of a window, s; of excerpts one that is fast to transform."""
        n_searched = len(folds.records.searched)
        if data is folds.data:
            return window_length(data.data.segments[:n_searched])
        segments = data.data.segments
        step = segments[0].step
        half = round(0.5 * window_length(segments) / step)
        return float(2.0 * step * next_fast_len(half))

    # -- search ----------------------------------------------------------------

    def search(self, start: BalanceStart) -> BalanceFound:
        """Search by excerpts, then fit to all samples of long records.

        Search all samples if a fault is found: it changes them.
        """
        search, result = self._search(start)
        if not start.reads_excerpts:
            return self._found(start, search, result, None)

        if any(effect.is_fault for effect in result.effects):
            folds = start.folds
            start = self._start(folds, folds.records, folds.data)
            search, result = self._search(start)
            return self._found(start, search, result, None)

        searched = start.first.model.spectra
        result = search.on_all_samples(result)
        return self._found(start, search, result, searched)

    def _search(self, start: BalanceStart) -> tuple[StepwiseSearch, SearchResult]:
        """One search, on all samples or on excerpts."""
        request = self.request
        tried = self._candidates(start)
        total = request.max_steps * len(tried)
        with progress_bar(request.progress, total) as tick:
            search = StepwiseSearch(
                CandidateSearch(tried, tick),
                request.faults,
                ChannelErrorTest(request.calibration),
                request.rng,
            )
            return search, search.run(start.first, request.max_steps)

    def _candidates(self, start: BalanceStart) -> list[Candidate]:
        """Every law of the catalogue at every site where it makes sense."""
        data, problem = start.folds.data, self.request.problem
        experiment = Experiment(
            problem.chain,
            tuple(problem.known_masses),
            data.forced,
            self.request.channels,
            len(data.searched),
            self.request.catalogue,
        )
        return with_all_storeys(candidates(experiment), problem.chain.sites)

    def _found(
        self,
        start: BalanceStart,
        search: StepwiseSearch,
        result: SearchResult,
        searched: BalanceSpectra | None,
    ) -> BalanceFound:
        """What was found, with the records of all samples."""
        measured = start.folds.records
        records = measured
        if searched is None and result.state.records is not None:
            records = result.state.records
        return BalanceFound(measured, records, result, search, searched)

    # -- judge -----------------------------------------------------------------

    def judge(self, found: BalanceFound) -> BalanceJudgement:
        """Confirm effects on held-out data, and say how sure they are."""
        heldout = HeldoutJudge(_instants(found.result))
        confirmation = Confirmer(found.result, heldout).confirm()
        drafts = []
        for decision in confirmation.decisions:
            effect = decision.effect
            rivals = found.result.rivals.get(effect, ())
            drafts.append(draft_step(confirmation.found[effect], decision, rivals))
        judged = _one_table(confirmation, heldout)
        final = confirmation.judged.index(confirmation.final)
        stopped = self._why_stopped(found, confirmation)

        unfit = why_no_claim(confirmation.largest)
        no_claim = unfit or why_no_claim(confirmation.final.model)
        if no_claim:
            stopped, final = wording.no_claim(no_claim), 0
            drafts = [draft.refused() for draft in drafts]
        if unfit:
            drafts, judged = [], judged[:1]

        return self._with_certainty(
            found,
            drafts,
            Judgement(
                [],
                judged,
                final,
                stopped,
                found.result.first.model.spectra.band,
                found.result.last_round.findings,
                bool(no_claim),
            ),
        )

    def _why_stopped(
        self, found: BalanceFound, confirmation: Confirmation
    ) -> list[str]:
        """Why the search added no further effect."""
        stopped = [wording.best_refused(found.result.last_round)]
        if len(found.result.effects) >= self.request.max_steps:
            stopped = [wording.enough_effects(self.request.max_steps)]
        means_are_in = not confirmation.largest.spectra.windows.centred
        if means_are_in and len(confirmation.decisions) > 1:
            stopped.append(wording.MEANS_LEFT_IN)
        return stopped

    def _with_certainty(
        self, found: BalanceFound, drafts: Sequence[StepDraft], judgement: Judgement
    ) -> BalanceJudgement:
        """The judgement with the certainty of every name, and what is left."""
        final = judgement.final_model.model
        state = found.result.state
        on_excerpts = _on_excerpts(final, found.excerpts)
        assert state.records is not None
        draws = simulated(state.records, on_excerpts, self.request.rng, CERTAINTY.draws)
        noise = next(draws, None)
        every = draws if noise is None else chain([noise], draws)
        certainty = certainty_of(drafts, final, every)

        room = len(found.result.effects) < self.request.max_steps
        goes_on = room and not judgement.nothing_claimed
        asked = goes_on or any(one.sure for one in certainty.effects)
        general = general_gains(on_excerpts, state, found.search.errors, asked)
        there = [gain for gain in general if gain.is_there]

        stopped = list(judgement.stopped)
        if there and goes_on:
            stopped.append(wording.not_in_catalogue(there))
        contradictions = _contradictions(found)
        if contradictions:
            stopped.append(wording.channels_disagree(contradictions))

        # no name is sure where a law is lacking
        lacking = [gain.site for gain in there]
        steps = []
        for draft, one in zip(drafts, certainty.effects):
            sure = one.sure and not lacks_a_law(draft.effect.site, lacking)
            steps.append(draft.finished(one.company, one.remainder, sure))
        return BalanceJudgement(
            steps,
            judgement.judged,
            judgement.final,
            stopped,
            judgement.band,
            judgement.last_findings,
            judgement.nothing_claimed,
            found.measured,
            found.records,
            general,
            certainty.beyond_noise,
            noise,
            contradictions,
        )

    # -- report ----------------------------------------------------------------

    def report(self, judgement: BalanceJudgement) -> LoopReport:
        """Gather what the user reads."""
        request = self.request
        records, prepared = judgement.records, judgement.measured
        assert records is not None and prepared is not None
        assert judgement.beyond_noise is not None
        final = judgement.final_model.model
        data = final.spectra.data
        models = chain_models(judgement, _visited(final))
        model = models[judgement.final]
        noise = [recipe.noise for recipe in records.fusion]
        pieces, filters, _ = data.diagnosed().cut()

        report = LoopReport(
            judgement.steps,
            error_table(judgement),
            judgement.stopped_because,
            model,
            judgement.band,
            candidate_table(judgement.last_findings),
            models,
            _evidence(judgement, models),
            measured_records(records.records, noise, len(request.heldout)),
            loops_of(model, pieces, filters),
            audit(request, request.calibration),
            lack_of_fit(judgement.general),
            parameter_intervals(final),
            free_runs(model, _starts(prepared)),
            judgement.beyond_noise,
            faults=suspect_channels(request.all_records),
            quality=_quality(prepared, judgement.contradictions),
            nothing_claimed=judgement.nothing_claimed,
        )
        return self._with_wiring(report)

    def _with_wiring(self, report: LoopReport) -> LoopReport:
        """The report with the wiring by which the balances close, if they do not."""
        request = self.request
        open_balances = (report.beyond_noise > DOUBTFUL).any()
        closes = not report.faults and not open_balances
        if closes and report.verdict.state != "red":
            return report
        wiring = wiring_of(
            request.baseline, request.problem, report.model, request.records
        )
        return replace(report, wiring=wiring)


def declared_laws(
    problem: Problem, data: SearchData
) -> Mapping[Site, tuple[ForceLaw, ...]]:
    """The laws of the baseline, shape parameters without a value estimated.

    On the folds of the search.
    """
    for laws in problem.laws.values():
        if any(law.free_shape for law in laws):
            pieces = [piece for _, piece in data.pieces()]
            return problem.solve(Dataset(pieces, data.data.n_samples)).model.laws
    return dict(problem.laws)


def require_covariates(model: FittedModel, records: PreparedRecords) -> None:
    """Refuse records, held-out ones too, that lack what the declared laws need."""
    for site, laws in model.laws.items():
        for law in laws:
            for segment in records.data.segments:
                for name in law.covariates:
                    if name not in segment.covariates:
                        raise ChannelError(
                            f"Record {segment.name!r} has no covariate {name!r}, which"
                            f" {law.name} at {site} needs",
                            "Give it in covariates=, or leave the record out.",
                        )


def _instants(result: SearchResult) -> list[float]:
    """Times at which effects that were found change something, s."""
    instants = []
    for effect in result.effects:
        for shape in effect.law.shapes:
            if shape.instant:
                instants.append(float(effect.law.shape[shape.name] or 0.0))
    return instants


def _on_excerpts(model: FittedModel, searched: BalanceSpectra | None) -> FittedModel:
    """The same laws on the excerpts by which long records were searched."""
    if searched is None:
        return model
    if not model.spectra.windows.centred:
        searched = searched.with_means()
    return model.on(searched)


def _one_table(confirmation: Confirmation, heldout: HeldoutJudge) -> list[JudgedModel]:
    """The judged models, their errors with or without the means alike."""
    judged = confirmation.judged
    if not confirmation.largest.spectra.windows.centred:
        alike = []
        for one in judged:
            errors = search_errors(heldout.with_means(one.model))
            alike.append(replace(one, errors={**one.errors, **errors}))
        judged = alike
    if not confirmation.final.model.spectra.windows.centred:
        judged = [heldout.judged(j.name, heldout.with_means(j.model)) for j in judged]
    return judged


def _contradictions(found: BalanceFound) -> list[Contradiction]:
    """Contradictions of the channels of records of which all samples were searched."""
    records = found.result.state.records
    if found.excerpts is not None or records is None:
        return []
    return found.search.faults.known_contradictions(records)


def _visited(model: FittedModel) -> dict[Site, VisitedRegion]:
    """Regions of the (v, s) plane that the search reached at every site."""
    visited = {}
    for site in model.chain_model().laws:
        drift, rate = model.spectra.data.drift_and_rate(site)
        visited[site] = VisitedRegion.of(rate, drift)
    return visited


def _evidence(
    judgement: BalanceJudgement, models: Sequence[ChainModel]
) -> list[Evidence]:
    """What each model leaves: is it noise, where does it act, what is it like."""
    floor = None
    if judgement.noise is not None:
        pieces, filters, _ = judgement.noise.spectra.data.diagnosed().cut()
        left = residual_of(models[judgement.final], pieces, filters)
        floor = NoiseFloor.from_draws([left])

    chosen = [step.site for step in judgement.steps]
    evidence = []
    for one, model, site in zip(judgement.judged, models, [*chosen, ""]):
        data = one.model.spectra.data.diagnosed()
        evidence.append(look(data, model, one.name, site, floor))
    return evidence


def _starts(records: PreparedRecords) -> Dataset:
    """The starts of all records, which the final model runs alone."""
    limit = FREE_RUN.searches_from_start * EXCERPTS.n_samples
    segments = []
    for segment in records.data.segments:
        stop = min(segment.valid.stop, segment.valid.start + limit)
        rows = slice(segment.valid.start, stop)
        segments.append(replace(segment, valid=rows))
    return Dataset(segments, records.data.n_samples)


def _quality(
    records: PreparedRecords, contradictions: Sequence[Contradiction]
) -> tuple[QualityNote, ...]:
    """What is known of the quality of the records."""
    notes = []
    for segment in records.data.segments:
        for doubt in segment.doubts:
            notes.append(QualityNote("other", doubt, record=segment.name))
    for one in contradictions:
        channel, witness = one.site.channel, one.reference
        if one.order == 0:
            size = 1.0 + one.share
            note = QualityNote("gain", one.witness, channel, "", size, witness)
        else:
            note = QualityNote("delay", one.witness, channel, "", -one.share, witness)
        notes.append(note)
    return tuple(notes)
