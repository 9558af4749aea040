"""The free run fitted to the channels of records in which some floor has no sensor."""

from __future__ import annotations

import warnings
from dataclasses import replace

import pandas as pd

from ..common.warn import warn_user
from ..diagnosis.verdict import FreeRuns
from ..exceptions import BiasWarning, NRFWarning
from ..records.dataset import Dataset
from ..records.input_arrays import Input, InputSettings, as_dataset
from .examination import Examination, Finding
from .fewer_sensors import ChannelIdentification, identify_from_channels
from .methods import RECORDS, IdentificationMethod, result_of
from .problem import Problem
from .result import IdentificationResult


class ChannelFit(IdentificationMethod[Dataset]):
    """The free run fitted to the channels; the only method for floors without one."""

    name = "simulation"
    label = "the free run fitted to the measured channels"
    requires = frozenset({RECORDS})
    uses = frozenset({"constraints", "band"})

    def read(self, passed: Input, settings: InputSettings) -> Dataset:
        """The records as they were measured."""
        return as_dataset(passed, replace(settings, fuse=False))

    def identify(self, problem: Problem, data: Dataset) -> IdentificationResult:
        """Masses and laws of a problem, and the motions of all floors."""
        fit = identify_from_channels(problem, data.records)
        result = result_from_channels(fit, self.asked)
        doubts = result.data_warnings["masses"]
        if doubts:
            warn_user(" ".join(doubts), BiasWarning)
        return result


def result_from_channels(
    fit: ChannelIdentification, asked: str = "auto"
) -> IdentificationResult:
    """The result of an estimate from channels.

    Parameters
    ----------
    fit : ChannelIdentification
    asked : str
        The setting of ``estimation``.
    """
    along_runs = Finding(
        fit.estimate,
        fit.runs,
        asked=asked,
        method=ChannelFit.name,
        notes=tuple(fit.notes),
        details={"sensors": fit.channels, "doubts": fit.doubts},
        resolver=fit.resolver,
    )
    # the errors of balances along the free runs are not asked for
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        result = result_of(along_runs)
    return replace(
        result,
        errors=fit.errors,
        motions=fit.motions,
        examination=Examination(masses=fit.notes),
        doubts=tuple(fit.doubts),
        channel_runs=_runs_of_channels(fit.errors),
        channel_error=fit.model_error,
    )


def _runs_of_channels(errors: pd.DataFrame) -> FreeRuns:
    """Free-run errors of the measured channels, as of free runs over all floors."""
    by_channel = errors.drop(index="pooled").set_index("of")["error"]
    return FreeRuns(pd.DataFrame([by_channel], index=["measured channels"]))
