"""What the page reads of a closed loop, by its public attributes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import pandas as pd

from ..chain.model import ChainModel
from ..diagnosis import effects
from ..diagnosis.evidence import Evidence
from ..diagnosis.free_run import FreeRuns
from ..diagnosis.site_loops import SiteLoop
from ..diagnosis.verdict import Verdict
from ..records.checks.channel_checks import Measured
from ..records.quality import QualityNote
from .words import Band


class Step(effects.Effect, Protocol):
    """One effect, with what the search and held-out data say of it in words."""

    @property
    def sentence(self) -> str:
        """The entire step."""

    @property
    def evidence(self) -> str:
        """Why it was accepted."""

    @property
    def judged_by(self) -> str:
        """What judged it, such as ``"another record"``."""

    @property
    def reduction_least(self) -> float:
        """Error reduction without the fold that contributes most, dB."""

    @property
    def reduction_heldout(self) -> float:
        """Error reduction on held-out data, dB."""

    @property
    def share(self) -> float:
        """What it changes of the force at its site, as a share."""

    @property
    def rivals(self) -> Sequence[tuple[str, str, float]]:
        """Law, site and error reduction, dB, of candidates that explain it as well."""


class Loop(Protocol):
    """A report of the loop; see :class:`pysindy_nrf.discrepancy.LoopReport`."""

    @property
    def steps(self) -> Sequence[Step]:
        """Effects in the order in which they were accepted."""

    @property
    def table(self) -> pd.DataFrame:
        """Errors of the baseline and after each effect, percent NRMSE."""

    @property
    def final(self) -> pd.Series:
        """Errors of the model."""

    @property
    def stopped_because(self) -> str:
        """Why the search stopped."""

    @property
    def nothing_claimed(self) -> bool:
        """Whether nothing is claimed."""

    @property
    def model(self) -> ChainModel:
        """The model found."""

    @property
    def band(self) -> Band:
        """Hz."""

    @property
    def candidates(self) -> pd.DataFrame:
        """Candidates of the last search, best first."""

    @property
    def evidence(self) -> Sequence[Evidence]:
        """What was left after each model."""

    @property
    def measured(self) -> Sequence[Measured]:
        """What was measured."""

    @property
    def quality(self) -> tuple[QualityNote, ...]:
        """What is known of the quality of the records."""

    @property
    def loops(self) -> Sequence[SiteLoop]:
        """Force of every site along the search data."""

    @property
    def settings(self) -> Mapping[str, Mapping[str, object]]:
        """Every setting of the run, by group."""

    @property
    def lack_of_fit(self) -> pd.DataFrame:
        """What general laws would still remove of the error, dB."""

    @property
    def bounds(self) -> effects.Bounds:
        """95 % intervals by parameter."""

    @property
    def free_runs(self) -> FreeRuns | None:
        """The model alone under the measured forces."""

    @property
    def verdict(self) -> Verdict:
        """Whether the model may be used."""


def confirmed(report: Loop) -> list[Step]:
    """The effects that held-out data confirm: those of the model."""
    return [step for step in report.steps if step.confirmed]


def first_evidence(report: Loop) -> Evidence | None:
    """The evidence of the first confirmed effect, whose force is drawn first."""
    for evidence, step in zip(report.evidence, report.steps):
        if step.confirmed:
            return evidence
    return None
