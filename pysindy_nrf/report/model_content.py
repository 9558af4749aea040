"""The page of an identification: of a model, or of a fitted regressor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import pandas as pd

from ..chain.latex import pretty
from ..chain.model import ChainModel, parameters_of
from ..common.audit import settings_of
from ..diagnosis.effects import Bounds, nonlinear_parts, shares_of
from ..diagnosis.free_run import FreeRuns
from ..diagnosis.motions import motions_of
from ..diagnosis.residual import residual_of
from ..diagnosis.site_loops import loops_of
from ..diagnosis.verdict import Verdict
from ..diagnosis.wiring import OPEN
from ..drawing.figure import Figure, dof_words
from ..drawing.tables import Table, table
from ..exceptions import ChannelError, NRFError
from ..records.checks.channel_checks import Measured, measured
from ..records.dataset import Dataset
from ..records.quality import QualityNote
from ..records.record import Record
from ..records.zero_phase_filter import filters_of
from .content import (
    Content,
    Tile,
    audit_part,
    frame_of,
    measured_part,
    model_part,
    names_of,
)
from .figures.evidence import residual_figure
from .figures.intervals import intervals_figure
from .figures.motion import free_run_figures
from .figures.residual import equation_residuals, largest_residual, residual_figures
from .words import Band, band_text

# DOFs whose free run is drawn.
DRAWN_FREE_RUNS = 3
_HEAD_OF_MISSING_TERMS = {
    "residual": "residual (% of its force)",
    "gain": "held-out part of it that further terms remove (%)",
    "missing": "size of these terms (% of its force)",
    "shift": "mass moves with them by (%)",
    "lasting": "part of it that a constant or a straight line in time removes (%)",
    "biased": "a law is missing",
}


class Result(Protocol):
    """What the page reads of the result of an identification."""

    @property
    def kinds_of_nonlinearity(self) -> dict[str, str]:
        """Kinds of the nonlinear forces that the data show, by site."""


class Fitted(Protocol):
    """What the page reads of a fitted :class:`~pysindy_nrf.NRFRegressor`."""

    model_: ChainModel
    errors_: pd.DataFrame
    third_law_gap_: pd.Series
    missing_terms_: pd.DataFrame

    @property
    def result_(self) -> Result:
        """What the identification found."""

    def verdict(self) -> Verdict:
        """Whether the model may be used."""

    def bounds(self) -> tuple[Bounds, list[str]]:
        """95 % intervals, and why there are none."""

    def fit_data(self, cure: str) -> Dataset:
        """Data of the fit; an error if they are gone."""

    def free_runs(self) -> FreeRuns:
        """The model alone under the forces of the fit."""

    def get_params(self, deep: bool = True) -> dict[str, object]:
        """Settings."""


@dataclass(frozen=True, eq=False)
class Identification:
    """A model, the data over which its page draws it, and what its fit says of it.

    Parameters
    ----------
    model : ChainModel
    records : sequence of Record
        As measured.
    data : Dataset, optional
        The motions.
    band : (float or None, float or None), optional
        Band in which all is drawn and judged, Hz.
    bounds, verdict, errors, free_runs, third_law_gap, missing_terms, settings,
    kinds_of_nonlinearity
        As a fitted regressor gives them; ``settings`` are its parameters.
    """

    model: ChainModel
    records: Sequence[Record] = ()
    data: Dataset | None = None
    band: Band = None
    bounds: Bounds = field(default_factory=dict)
    verdict: Verdict | None = None
    errors: pd.DataFrame | None = None
    free_runs: FreeRuns | None = None
    third_law_gap: pd.Series = field(default_factory=lambda: pd.Series(dtype=float))
    missing_terms: pd.DataFrame = field(default_factory=pd.DataFrame)
    settings: Mapping[str, object] = field(default_factory=dict)
    kinds_of_nonlinearity: Mapping[str, str] = field(default_factory=dict)


def identification_of(
    subject: ChainModel | Fitted,
    records: Record | Sequence[Record] | None = None,
    band: Band = None,
    data: Dataset | None = None,
) -> Identification:
    """What the page of a model or of a fitted regressor shows.

    Parameters
    ----------
    subject : ChainModel or fitted NRFRegressor
    records : Record or sequence of Record, optional
        Over which the model is drawn; a regressor without them is drawn over the data
        of its fit.
    band : (float or None, float or None), optional
        Hz; that of the model if None.
    data : Dataset, optional
        Motions of the records; they are fused if None.
    """
    model = subject if isinstance(subject, ChainModel) else subject.model_
    records = [records] if isinstance(records, Record) else list(records or ())
    if band is None and model.info.get("band") is not None:
        low, high = model.info["band"]
        band = (low, high)
    if data is None and records:
        data = motions_of(model, records)

    shown = Identification(model, records, data, band)
    return shown if isinstance(subject, ChainModel) else _with_fit(shown, subject)


def _with_fit(shown: Identification, subject: Fitted) -> Identification:
    """A model with what its fit says of it, over the data of the fit if need be."""
    data, free_runs = shown.data, None
    try:
        of_fit = subject.fit_data("Fit again, or give records.")
        data = of_fit if data is None else data
        free_runs = subject.free_runs()
    except ChannelError:  # it was loaded without the data of its fit
        pass
    return replace(
        shown,
        data=data,
        bounds=subject.bounds()[0],
        verdict=subject.verdict(),
        errors=subject.errors_,
        free_runs=free_runs,
        third_law_gap=subject.third_law_gap_,
        missing_terms=subject.missing_terms_,
        settings=subject.get_params(deep=False),
        kinds_of_nonlinearity=subject.result_.kinds_of_nonlinearity,
    )


def model_content(
    identified: Identification, title: str | None = None, notes: Sequence[str] = ()
) -> Content:
    """The page of an identification.

    Parameters
    ----------
    identified : Identification
    title : str, optional
        Names of the records if None.
    notes : sequence of str
        What is to be taken care of, besides the reasons of the verdict.
    """
    model, data = identified.model, identified.data
    picture, obstacles = _picture(identified)
    loops, nonlinear = [], dict[str, str]()
    if data is not None:
        loops = loops_of(model, data, filters_of(identified.band, data))
        shares = shares_of(model, data)
        bounds, kinds = identified.bounds, identified.kinds_of_nonlinearity
        nonlinear = nonlinear_parts(model, shares, bounds, kinds)

    care = [*notes, *obstacles]
    verdicts = {}
    if identified.verdict is not None:
        care = [*identified.verdict.reasons, *care]
        verdicts = {"": identified.verdict}
    records = _measured_records(identified)
    frame = frame_of(
        model, identified.bounds, nonlinear, _open_dofs(identified), records
    )
    return Content(
        title=title or names_of(records) or "Chain model",
        lead=_lead(model),
        model=model_part(model, loops, identified.bounds),
        audit=audit_part(model.info, _settings(identified)),
        verdicts=verdicts,
        care=list(dict.fromkeys(care)),
        frame=frame,
        picture=picture,
        tiles=_tiles(identified),
        measured=measured_part(records, model, _quality(identified), identified.band),
        errors=[*_errors(identified), *_figures_of_errors(identified)],
        units=model.units,
    )


def _picture(identified: Identification) -> tuple[list[Figure], list[str]]:
    """Residual and free run, and why one of them cannot be drawn."""
    if identified.data is None:
        return [], []
    figures, obstacles = [], []
    filters = filters_of(identified.band, identified.data)
    try:
        sizes = residual_of(identified.model, identified.data, filters).sizes
        residual = residual_figure(sizes, units=identified.model.units)
        if residual is not None:
            figures.append(residual)
    except NRFError as error:
        obstacles.append(str(error))
    return figures + free_run_figures(identified.free_runs)[:1], obstacles


def _measured_records(identified: Identification) -> list[Measured]:
    """What the records hold, with the noise that fusion estimates."""
    if not identified.records or identified.data is None:
        return []
    records = []
    for record, segment in zip(identified.records, identified.data.segments):
        records.append(measured(record, segment.noise))
    return records


def _quality(identified: Identification) -> tuple[QualityNote, ...]:
    """What is known of the channels of the records."""
    return () if identified.data is None else identified.data.quality


def _open_dofs(identified: Identification) -> list[int]:
    """DOFs whose balance does not close."""
    if identified.errors is None:
        return []
    errors = identified.errors["error"].drop("pooled")
    return [int(str(name)[4:]) for name, error in errors.items() if error > OPEN]


def _lead(model: ChainModel) -> str:
    """The model in a sentence."""
    n_forces = sum(bool(laws) for laws in model.laws.values())
    masses = "mass" if model.n_dof == 1 else "masses"
    forces = "restoring force" if n_forces == 1 else "restoring forces"
    return f"{model.n_dof} {masses} and {n_forces} {forces}."


def _tiles(identified: Identification) -> list[Tile]:
    """Error, mass and band in numbers."""
    tiles = []
    if identified.errors is not None:
        pooled = f"{identified.errors.loc['pooled', 'error']:.3g} %"
        tiles.append(Tile("Balance error, pooled", pooled, "on the fitted data"))
    total = float(identified.model.masses.sum())
    unit = pretty(identified.model.units.mass)
    tiles.append(Tile("Total mass", f"{total:.4g} {unit}"))
    tiles.append(Tile("Band", band_text(identified.band)))
    return tiles


def _settings(identified: Identification) -> dict[str, dict[str, str]]:
    """Parameters of the regressor, and what is known of the model."""
    model = dict(identified.model.info)
    for name in ("command", "inputs"):  # in the table of the run
        model.pop(name, None)
    model["band"] = identified.band
    if identified.settings:
        return settings_of(regressor=identified.settings, model=model)
    return settings_of(model=model)


def _figures_of_errors(identified: Identification) -> list[Figure]:
    """Free runs of the other DOFs, what the worst balance leaves, and the intervals."""
    figures = free_run_figures(identified.free_runs)[1:DRAWN_FREE_RUNS]
    data = identified.data
    if data is not None:
        # no balance is known
        with suppress(NRFError):
            filters = filters_of(identified.band, data)
            residuals = equation_residuals(identified.model, data, filters)
            figures += residual_figures(largest_residual(residuals))
    estimates = parameters_of(identified.model)
    intervals = intervals_figure(estimates, identified.bounds)
    return figures if intervals is None else [*figures, intervals]


def _errors(identified: Identification) -> list[Figure | Table]:
    """Errors of the balances, and what they say of laws and of Newton's third law."""
    shown: list[Figure | Table] = []
    if identified.errors is not None:
        errors = identified.errors.set_axis(
            [dof_words(name) for name in identified.errors.index]
        )
        caption = "Balance errors on the fitted data, percent NRMSE"
        unit = identified.model.units.force
        columns = {
            "error": "error (%)",
            "residual": f"residual rms ({unit})",
            "reference": f"reference rms ({unit})",
            "of": "of",
        }
        shown.append(table(caption, errors, columns, "balance"))
    if len(identified.third_law_gap):
        gaps = [[str(site), gap] for site, gap in identified.third_law_gap.items()]
        head = ["storey", "difference (% of its rms)"]
        caption = "Newton's third law: how far the two estimates of one storey differ"
        shown.append(Table(caption, head, gaps))
    if len(identified.missing_terms):
        biased = np.where(identified.missing_terms["biased"], "yes", "no")
        missing = identified.missing_terms.assign(biased=biased)
        caption = "What terms beyond the laws would explain"
        index = "step of the solve"
        shown.append(table(caption, missing, _HEAD_OF_MISSING_TERMS, index))
    return shown
