"""The report of the loop on balances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..diagnosis.evidence import Evidence, NoiseFloor, evidence_of
from ..diagnosis.facts import Alternative, unexplained_by
from ..diagnosis.offsets import with_offsets
from ..diagnosis.open_alternatives import (
    OpenAlternatives,
    ambiguous_intervals,
    with_ambiguity,
)
from ..diagnosis.rules import GOOD_RUN
from ..diagnosis.site_loops import loops_of
from ..diagnosis.unseen_drifts import unseen_drifts
from ..diagnosis.verdict import DOUBTFUL, FreeRuns, free_runs, suspect_channels
from ..exceptions import NRFError
from ..identification.alternatives import alternatives_of
from ..identification.intervals import parameters_of
from ..identification.result import IdentificationResult
from ..identification.wiring import wiring_error
from ..records.dataset import Dataset
from ..records.quality import Kind, QualityNote
from .balance_judgement import BalanceJudgement, BalanceOutcome
from .effects import Finding
from .excerpts import EXCERPTS
from .final_estimate import with_bounds, with_final_estimate
from .fitted_model import FittedModel
from .free_run import FREE_RUN
from .judgement import measured_records, report_of
from .prepare import PreparedRecords
from .report import LoopReport, Step
from .request import LoopRequest


def balance_report(request: LoopRequest, concluded: BalanceJudgement) -> LoopReport:
    """Gather what the user reads."""
    judgement, outcome = concluded.judgement, concluded.outcome
    final = judgement.final_model.model
    noise = [recipe.noise for recipe in outcome.records.fusion]
    pieces, filters, _ = final.data_with_offsets.diagnosed().cut()

    report = report_of(request, judgement, request.calibration, _visited(final))
    identified = concluded.identified
    report = with_final_estimate(report, identified)
    beyond_noise = _beyond_noise(final, identified)
    faults = suspect_channels(request.all_records)
    hidden = unseen_drifts(outcome.measured.data, faults)
    report = replace(
        report,
        steps=_with_remainders(report.steps, final, beyond_noise),
        evidence=_evidence(request, concluded, report.models),
        measured=measured_records(outcome.records.records, noise, len(request.heldout)),
        loops=loops_of(report.model, pieces, filters),
        free_runs=_free_runs(report, outcome, final),
        lack_of_fit=_lack_of_fit(outcome.result.general),
        beyond_noise=beyond_noise,
        alternatives=_alternatives(request, outcome, report, hidden),
        unseen_drifts=hidden,
        faults=faults,
        quality=_quality(outcome, final),
    )
    report = _with_ambiguity(report)
    if not report.nothing_claimed:
        instead: list[Alternative] = []
        for tried in outcome.result.accepted:
            instead += tried.naming.instead
        report = _with_faults_instead(report, instead)
    return _with_wiring(report, request)


def _beyond_noise(
    final: FittedModel, identified: IdentificationResult | None
) -> np.ndarray:
    """What each equation of motion keeps beyond noise, percent, shape (n_dof,).

    All that it keeps where the noise is not known.
    """
    errors = final.balance_errors
    if identified is None:
        return errors
    unexplained = dict(enumerate(errors.tolist(), start=1))
    remaining = identified.beside_noise.remaining(unexplained)
    return np.array([remaining[j] for j in unexplained])


def _with_remainders(
    steps: Sequence[Step], final: FittedModel, beyond_noise: np.ndarray
) -> list[Step]:
    """The steps with the share of each effect that its equations keep beyond noise."""
    kept = float(np.nanmax(beyond_noise))
    return [
        replace(step, remainder=kept / _size_of_effect(step, final.balance_errors))
        for step in steps
    ]


def _size_of_effect(step: Step, errors: np.ndarray) -> float:
    """What was missing without an effect, percent; what is left now at least."""
    site = Site(step.site)
    balances = list(range(len(errors)))
    if site.kind != "sensor":
        touched = [j for j in balances if site.incidence(j + 1)]
        balances = touched or balances
    now = float(np.sqrt(np.mean(errors[balances] ** 2)))
    return max(step.validation_before, now, 1e-300)


def _with_ambiguity(report: LoopReport) -> LoopReport:
    """The report with intervals that hold what open alternatives do."""
    if report.identified is not None:
        ambiguous = report.identified.ambiguous_intervals
        return replace(report, ambiguous_intervals=ambiguous)
    among = OpenAlternatives.among(report.alternatives, unexplained_by(report))
    values = parameters_of(report.model).to_dict()
    ambiguous = ambiguous_intervals(values, report.bounds, among.moves, among.rejecting)
    bounds = with_ambiguity(report.bounds, ambiguous)
    return replace(report, bounds=bounds, ambiguous_intervals=ambiguous)


def _with_faults_instead(
    report: LoopReport, instead: Sequence[Alternative]
) -> LoopReport:
    """The report with faults of sensors that explain the data instead of its effects.

    Its intervals hold what they do, too.
    """
    if not instead:
        return report

    among = OpenAlternatives.among(instead, {})
    values = parameters_of(report.model).to_dict()
    wider = ambiguous_intervals(values, report.bounds, among.moves)
    names = {interval.parameter for interval in wider}
    others = [i for i in report.ambiguous_intervals if i.parameter not in names]
    bounds = with_ambiguity(report.bounds, wider)
    return replace(
        report,
        steps=[with_bounds(step, report.model, bounds) for step in report.steps],
        alternatives=(*report.alternatives, *instead),
        bounds=bounds,
        ambiguous_intervals=(*others, *wider),
    )


def _lack_of_fit(general: Sequence[Finding]) -> pd.DataFrame:
    """The table of what general laws would still gain beside the last model."""
    rows = []
    for finding in general:
        if finding.reduction is not None:
            reduction = finding.reduction
            name = finding.candidate.law.name
            error = reduction.standard_error
            rows.append((finding.candidate.site_names, name, reduction.value, error))
    columns = ["site", "general law", "reduction (dB)", "standard error"]
    return pd.DataFrame(rows, columns=columns).set_index(columns[:2])


def _free_runs(
    report: LoopReport, outcome: BalanceOutcome, final: FittedModel
) -> FreeRuns:
    """The final model alone, over the records of the estimate."""
    if report.identified is not None:
        return report.identified.free_runs
    return free_runs(report.model, _starts(outcome.measured, final))


def _with_wiring(report: LoopReport, request: LoopRequest) -> LoopReport:
    """The report with the wiring by which the balances close, if they do not."""
    open_balances = (report.beyond_noise > DOUBTFUL).any()
    closes = not report.faults and not open_balances
    if closes and report.verdict.state != "red":
        return report
    wiring = wiring_error(request.problem, report.model, request.records)
    return replace(report, wiring=wiring)


def _alternatives(
    request: LoopRequest,
    outcome: BalanceOutcome,
    report: LoopReport,
    hidden: Mapping[int, float],
) -> tuple[Alternative, ...]:
    """What the data allow beside the final model, if it may be used."""
    identified = report.identified
    if hidden:
        return ()
    if identified is not None and identified.free_runs.error < GOOD_RUN:
        return identified.alternatives
    if report.nothing_claimed:
        return ()
    if identified is not None:
        return identified.alternatives
    problem = request.problem.with_laws(report.model.laws)
    try:
        return alternatives_of(problem, outcome.records.data)
    except NRFError:
        # least squares cannot solve excerpts of these records
        return ()


def _visited(model: FittedModel) -> dict[Site, VisitedRegion]:
    """Regions of the (v, s) plane that the search reached at every site."""
    visited = {}
    for site in model.chain_model().laws:
        drift, rate = model.spectra.data.drift_and_rate(site)
        visited[site] = VisitedRegion.of(rate, drift)
    return visited


def _evidence(
    request: LoopRequest, concluded: BalanceJudgement, models: Sequence[ChainModel]
) -> list[Evidence]:
    """What each model leaves: is it noise, where does it act, what is it like."""
    judgement, identified = concluded.judgement, concluded.identified
    floor = None
    if identified is not None:
        residual = identified.residual_of_noise(request.rng)
        if residual is not None:
            floor = NoiseFloor.from_draws([residual])

    chosen = [step.site for step in judgement.steps]
    evidence = []
    for judged, model, site in zip(judgement.judged, models, [*chosen, ""]):
        data = judged.model.data_with_offsets.diagnosed()
        evidence.append(evidence_of(data, model, judged.name, site, floor))
    return evidence


def _starts(records: PreparedRecords, final: FittedModel) -> Dataset:
    """The starts of all records, which the final model runs alone."""
    data = with_offsets(records.data, final.offsets)
    limit = FREE_RUN.searches_from_start * EXCERPTS.n_samples
    segments = []
    for segment in data.segments:
        stop = min(segment.valid.stop, segment.valid.start + limit)
        rows = slice(segment.valid.start, stop)
        segments.append(replace(segment, valid=rows))
    return Dataset(segments, data.n_samples)


def _quality(outcome: BalanceOutcome, final: FittedModel) -> tuple[QualityNote, ...]:
    """What is known of the quality of the records."""
    data = outcome.measured.data
    notes = list(data.quality)
    for of_record in final.offsets.notes(data):
        notes += of_record
    noted = {(note.kind, note.channel) for note in notes}
    for contradiction in outcome.contradictions:
        kind: Kind = "delay"
        size = -contradiction.share
        if contradiction.order == 0:
            kind, size = "gain", 1.0 + contradiction.share
        # one contradiction is of either channel
        pair = (contradiction.site.channel, contradiction.reference)
        if any((kind, channel) in noted for channel in pair):
            continue
        noted.add((kind, pair[0]))
        notes.append(
            QualityNote(
                kind,
                contradiction.witness,
                contradiction.site.channel,
                "",
                size,
                contradiction.reference,
            )
        )
    return tuple(notes)
