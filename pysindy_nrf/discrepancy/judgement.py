"""What both loops conclude, and the parts of the report that follow from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..records.checks.channel_checks import Measured, measured
from ..records.record import Record
from . import wording
from .audit import audit
from .effects import RankedFinding
from .heldout import JudgedModel
from .intervals import parameter_intervals
from .prepare import Band
from .report import LoopReport, Step, WholeTable
from .request import LoopRequest


@dataclass(frozen=True, eq=False)
class Judgement:
    """What a loop concludes.

    Attributes
    ----------
    steps : list of Step
    judged : list of JudgedModel
        The baseline, then the model with each effect.
    final : int
        Number of the model with all confirmed effects.
    stopped : list of str
        Why the search stopped, in sentences.
    band : (float, float)
        Hz.
    last_findings : sequence of RankedFinding
        Candidates of the last round, best first.
    nothing_claimed : bool
    """

    steps: list[Step]
    judged: list[JudgedModel]
    final: int
    stopped: list[str]
    band: Band
    last_findings: Sequence[RankedFinding]
    nothing_claimed: bool = False

    @property
    def final_model(self) -> JudgedModel:
        """The model with all confirmed effects."""
        return self.judged[self.final]

    @property
    def stopped_because(self) -> str:
        """Why the search stopped, in one paragraph."""
        return wording.paragraph(self.stopped)


def report_of(
    request: LoopRequest,
    judgement: Judgement,
    calibration: object,
    visited: Mapping[Site, VisitedRegion] | None = None,
) -> LoopReport:
    """The report, as far as it does not depend on the equations.

    Parameters
    ----------
    request : LoopRequest
    judgement : Judgement
    calibration : object
        Errors of the channels that the loop reckoned with, for the settings.
    visited : mapping of Site to VisitedRegion, optional
        Regions of the (v, s) plane that the search reached.
    """
    models = _chain_models(judgement, visited)
    return LoopReport(
        judgement.steps,
        _error_table(judgement),
        judgement.stopped_because,
        models[judgement.final],
        judgement.band,
        _candidate_table(judgement.last_findings),
        models,
        settings=audit(request, calibration),
        bounds=parameter_intervals(judgement.final_model.model),
        nothing_claimed=judgement.nothing_claimed,
    )


def _error_table(judgement: Judgement) -> pd.DataFrame:
    """Errors of the baseline and of the model with each effect, percent."""
    rows: dict[str, dict[str, float]] = {}
    for judged in judgement.judged:
        name = judged.name
        if name in rows:
            name = f"{name} ({len(rows)})"
        rows[name] = judged.errors
    table = pd.DataFrame.from_dict(rows, orient="index")
    return WholeTable(table.assign(band=wording.band(judgement.band)))


def _chain_models(
    judgement: Judgement, visited: Mapping[Site, VisitedRegion] | None = None
) -> list[ChainModel]:
    """The judged models; that with all confirmed effects records its origin."""
    models = [judged.model.chain_model() for judged in judgement.judged]
    band = judgement.band
    steps = [step for step in judgement.steps if step.confirmed]
    info = {
        "band": list(band) if any(band) else None,
        "steps": [f"{step.law} at {step.site}" for step in steps],
        "stopped_because": judgement.stopped_because,
    }
    final = models[judgement.final]
    models[judgement.final] = ChainModel(
        final.masses, final.laws, final.chain, visited, info
    )
    return models


def _candidate_table(findings: Sequence[RankedFinding]) -> pd.DataFrame:
    """The candidates of the last round, best first."""
    rows = []
    for ranked in findings:
        candidate, reduction = ranked.finding.candidate, ranked.reduction
        rows.append(
            [
                candidate.law.name,
                ranked.finding.family,
                candidate.site_names,
                reduction.value,
                reduction.standard_error,
                reduction.least,
            ]
        )
    columns = ["law", "family", "site", "reduction (dB)", "standard error", "least"]
    return pd.DataFrame(rows, columns=columns)


def measured_records(
    records: Sequence[Record], noise: Sequence[dict[str, float]], n_heldout: int
) -> list[Measured]:
    """What the records of a closed loop hold; those held out completely stand last."""
    searched = "searched"
    if not n_heldout:
        searched += ", but for a quarter that is held out"
    n_searched = len(records) - n_heldout
    out = []
    for i, (record, levels) in enumerate(zip(records, noise)):
        role = searched if i < n_searched else "held out"
        out.append(measured(record, levels, role))
    return out
