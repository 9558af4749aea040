"""An identification by the command line: features, fit and free run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from ..diagnosis.effects import shares_of
from ..diagnosis.facts import facts_of_model
from ..diagnosis.free_run import FreeRuns
from ..diagnosis.verdict import Verdict, verdict_from
from ..identification.noise_spectra import transfer
from ..identification.regressor import NRFRegressor
from ..records.files.frequency_response import FrequencyResponse, in_band
from ..records.input_arrays import from_arrays
from ..records.record import Record
from .exit_codes import ExitCode, code_of_verdict
from .session import warned, working


@dataclass(frozen=True, eq=False)
class Responses:
    """Measured frequency responses and those of a model.

    Parameters
    ----------
    measured : FrequencyResponse
    f : ndarray of shape (n_lines,)
        Frequencies in the band, Hz.
    by_measurement, by_model : ndarray of shape (n_lines, n_dof)
    """

    measured: FrequencyResponse
    f: np.ndarray
    by_measurement: np.ndarray
    by_model: np.ndarray

    @property
    def errors(self) -> list[float]:
        """Percent NRMSE of the model's responses, by DOF."""
        missed = np.abs(self.by_model - self.by_measurement) ** 2
        reference = np.abs(self.by_measurement) ** 2
        ratio = missed.mean(axis=0) / reference.mean(axis=0)
        return (100 * np.sqrt(ratio)).tolist()


@dataclass(frozen=True, eq=False)
class Outcome:
    """A fitted model and how well it does.

    Parameters
    ----------
    estimator : NRFRegressor
        Fitted.
    verdict : Verdict
    free : FreeRuns
    shares : dict of str to Series
        What each term carries of the force of its site, percent.
    responses : Responses, optional
        Where frequency responses were given.
    warnings : list of str
        Of the fit, besides the reasons of the verdict.
    """

    estimator: NRFRegressor
    verdict: Verdict
    free: FreeRuns = field(default_factory=lambda: FreeRuns(pd.DataFrame()))
    shares: dict[str, pd.Series] = field(default_factory=dict)
    responses: Responses | None = None
    warnings: list[str] = field(default_factory=list)

    @property
    def modes(self) -> pd.DataFrame | None:
        """Modes of the linear part.

        None if a mass is not positive or a part does not swing.
        """
        model = self.estimator.model_
        if (model.masses <= 0).any() or (model.total_masses <= 0).any():
            return None
        modes = model.modes()
        return modes if (modes["damping"].abs() < 1).all() else None

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of the verdict."""
        return code_of_verdict(self.verdict)


def identify_records(
    records: Sequence[Record], estimator: NRFRegressor, raw: bool
) -> Outcome:
    """Identify a chain from records and run the model free.

    Parameters
    ----------
    records : sequence of Record
    estimator : NRFRegressor
    raw : bool
        Whether channels are taken as they are, without fusion.
    """
    with warned() as messages, working("fitting, running free, checking"):
        if raw:
            estimator.fit(from_arrays(records, smooth=False))
        else:
            estimator.fit(records)
        shares = shares_of(estimator.model_, estimator.fit_data(""))
        verdict, free = estimator.verdict(), estimator.free_runs()
    others = [text for text in messages() if text not in verdict.reasons]
    return Outcome(estimator, verdict, free, shares, warnings=others)


def identify_frf(frf: FrequencyResponse, estimator: NRFRegressor) -> Outcome:
    """Identify a linear chain from its frequency responses."""
    with warned() as messages:
        estimator.fit(frf)
    mobility = transfer(estimator.model_.matrices(), frf.f)[:, :, frf.excited - 1]
    accelerance = 2j * np.pi * frf.f[:, None] * mobility
    used = in_band(frf.f, estimator.band)
    responses = Responses(frf, frf.f[used], frf.H[used], accelerance[used])

    bounds = estimator.bounds()[0]
    known = estimator.problem_.known_masses
    verdict = verdict_from(facts_of_model(estimator.model_, bounds, None, known))
    return Outcome(estimator, verdict, responses=responses, warnings=messages())
