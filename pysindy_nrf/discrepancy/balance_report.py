"""The report of the loop on balances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..diagnosis.residual import residual_of
from ..diagnosis.site_loops import loops_of
from ..diagnosis.verdict import DOUBTFUL, free_runs, suspect_channels
from ..identification.wiring import wiring_error
from ..records.dataset import Dataset
from ..records.quality import QualityNote
from .audit import audit
from .balance_judgement import BalanceFound, BalanceJudgement
from .claims import lack_of_fit
from .excerpts import EXCERPTS
from .fitted_model import FittedModel
from .free_run import FREE_RUN
from .intervals import parameter_intervals
from .judgement import (
    candidate_table,
    chain_models,
    error_table,
    measured_records,
)
from .prepare import PreparedRecords
from .report import LoopReport
from .request import LoopRequest
from .residual import Evidence, NoiseFloor, look


def balance_report(request: LoopRequest, concluded: BalanceJudgement) -> LoopReport:
    """Gather what the user reads."""
    judgement, found = concluded.judgement, concluded.found
    final = judgement.final_model.model
    models = chain_models(judgement, _visited(final))
    model = models[judgement.final]
    noise = [recipe.noise for recipe in found.records.fusion]
    pieces, filters, _ = final.spectra.data.diagnosed().cut()

    report = LoopReport(
        judgement.steps,
        error_table(judgement),
        judgement.stopped_because,
        model,
        judgement.band,
        candidate_table(judgement.last_findings),
        models,
        _evidence(concluded, models),
        measured_records(found.records.records, noise, len(request.heldout)),
        loops_of(model, pieces, filters),
        audit(request, request.calibration),
        lack_of_fit(concluded.left.general),
        parameter_intervals(final),
        free_runs(model, _starts(found.measured)),
        concluded.left.certainty.beyond_noise,
        faults=suspect_channels(request.all_records),
        quality=_quality(found),
        nothing_claimed=judgement.nothing_claimed,
    )
    return _with_wiring(report, request)


def _with_wiring(report: LoopReport, request: LoopRequest) -> LoopReport:
    """The report with the wiring by which the balances close, if they do not."""
    open_balances = (report.beyond_noise > DOUBTFUL).any()
    closes = not report.faults and not open_balances
    if closes and report.verdict.state != "red":
        return report
    wiring = wiring_error(request.problem, report.model, request.records)
    return replace(report, wiring=wiring)


def _visited(model: FittedModel) -> dict[Site, VisitedRegion]:
    """Regions of the (v, s) plane that the search reached at every site."""
    visited = {}
    for site in model.chain_model().laws:
        drift, rate = model.spectra.data.drift_and_rate(site)
        visited[site] = VisitedRegion.of(rate, drift)
    return visited


def _evidence(
    concluded: BalanceJudgement, models: Sequence[ChainModel]
) -> list[Evidence]:
    """What each model leaves: is it noise, where does it act, what is it like."""
    judgement, noise = concluded.judgement, concluded.left.noise
    floor = None
    if noise is not None:
        pieces, filters, _ = noise.spectra.data.diagnosed().cut()
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


def _quality(found: BalanceFound) -> tuple[QualityNote, ...]:
    """What is known of the quality of the records."""
    notes = list(found.measured.data.quality)
    for one in found.contradictions:
        channel, witness = one.site.channel, one.reference
        if one.order == 0:
            size = 1.0 + one.share
            note = QualityNote("gain", one.witness, channel, "", size, witness)
        else:
            note = QualityNote("delay", one.witness, channel, "", -one.share, witness)
        notes.append(note)
    return tuple(notes)
