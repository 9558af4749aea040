"""What the commands do: features, fit, free run. No printing, no files."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ...data.io import FrequencyResponse, frf_to_features
from ...data.record import Record
from ...exceptions import NRFWarning, SimulationError
from ...regression.input_arrays import from_arrays
from ...regression.segments import Segment, SegmentSet
from ...signals.kinematics import base_acceleration

Progress = Callable[[Iterable[Any], str], Iterable[Any]]


@dataclass
class Outcome:
    """A fitted model and how well it does.

    ``free_run`` is the free-run error by record and DOF (percent NRMSE of displacement; None for a frequency
    response) or else ``no_free_run`` says why there is none; ``runs`` holds records as fused beside the model's own
    runs, ``shares`` by site the rms of each term's force (percent of the force's rms), ``frf`` the measured responses
    and the model's, of which the lines ``used`` lie in the band; ``data`` the records as fused.
    """

    estimator: Any
    free_run: pd.DataFrame | None = None
    no_free_run: str = ""
    runs: list[tuple[Segment, Record]] = field(default_factory=list)
    shares: dict[str, pd.Series] = field(default_factory=dict)
    frf: tuple[FrequencyResponse, np.ndarray] | None = None
    used: Any = None
    warnings: list[str] = field(default_factory=list)
    data: SegmentSet | None = None

    @property
    def response_error(self) -> list[float] | None:
        """Percent NRMSE of the model's frequency responses in the band, by DOF."""
        if self.frf is None:
            return None
        measured, found = (H[self.used] for H in (self.frf[0].H, self.frf[1]))
        ratio = (np.abs(found - measured) ** 2).mean(axis=0) / (np.abs(measured) ** 2).mean(axis=0)
        return [float(e) for e in 100 * np.sqrt(ratio)]

    @property
    def modes(self) -> pd.DataFrame | None:
        """Modes of the linear part; None if a mass is not positive or a part does not swing."""
        model = self.estimator.model_
        if (model.masses <= 0).any() or (model.total_masses <= 0).any():
            return None
        modes = model.modes()
        return modes if (modes["damping"].abs() < 1).all() else None


def identify_records(records: Sequence[Record], estimator: Any, raw: bool, progress: Progress) -> Outcome:
    """Identify a chain from records (``raw``: no fusion) and run the model free."""
    from ...signals import KinematicSmoother

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", NRFWarning)
        smooth: Any = not raw
        if smooth and estimator.estimation != "ls":  # which needs noise that is independent of the motion
            smooth = KinematicSmoother(band="auto", joint=False)
        pairs = [rec.to_features(smooth=smooth) for rec in progress(records, "fusing channels")]
        X, F = (pd.concat([pair[k] for pair in pairs]) for k in (0, 1))
        for _ in progress([None], "identifying"):
            options = _beside(records)
            estimator.fit(X, F, **options)
        data = from_arrays(X, F, n_dof=records[0].n_dof, **options)
        outcome = Outcome(estimator, shares=term_shares(estimator.model_, data), data=data)
        _free_runs(outcome, records, data, progress)
    outcome.warnings = list(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, NRFWarning)))
    return outcome


def identify_frf(frf: FrequencyResponse, estimator: Any, band: Any) -> Outcome:
    """Identify a linear chain from its frequency responses; the estimator has no band, lines are cut here."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", NRFWarning)
        estimator.fit(*frf_to_features(frf, band=band))
    model = estimator.model_
    model.visited = {}  # amplitudes of a steady state are no visited motion
    model.info["band"] = None if band is None else [None if b is None or np.isinf(b) else b for b in band]
    low, high = band if band is not None else (None, None)
    used = (frf.f >= (low or 0.0)) & (frf.f <= (np.inf if high is None else high))
    outcome = Outcome(estimator, frf=(frf, _response(model, frf)), used=used)
    outcome.warnings = list(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, NRFWarning)))
    return outcome


def _beside(records: Sequence[Record]) -> dict[str, Any]:
    """What goes beside X: record ids, base acceleration, covariates."""
    ids = np.concatenate([np.full(rec.n_samples, i) for i, rec in enumerate(records)])
    out: dict[str, Any] = {"record": ids}
    if any(rec.base_moves for rec in records):
        out["base_acceleration"] = np.concatenate([base_acceleration(rec) for rec in records])
    names = set(records[0].covariates).intersection(*(rec.covariates for rec in records))
    if names:
        out["covariates"] = {k: np.concatenate([rec.covariates[k] for rec in records]) for k in sorted(names)}
    return out


def term_shares(model: Any, data: SegmentSet) -> dict[str, pd.Series]:
    """Rms of each term's force, percent of the rms of the site's force, by site and largest first."""
    out = {}
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        terms, whole = np.zeros(len(force.coefficients)), 0.0
        for seg in data.segments:
            motion = seg.motion(site, seg.valid)
            columns = np.hstack([law.features(motion) * law.coefficients for law in force.laws])
            terms += (columns**2).sum(axis=0)
            whole += (columns.sum(axis=1) ** 2).sum()
        if whole:
            shares = pd.Series(100 * np.sqrt(terms / whole), index=force.coefficients.index)
            out[str(site)] = shares.sort_values(ascending=False)
    return out


def _free_runs(outcome: Outcome, records: Sequence[Record], data: SegmentSet, progress: Progress) -> None:
    """Run the model alone, from the first measured state, under the measured force."""
    from ...regression.errors import free_run_of, squares_of
    from ...signals.zero_phase_filter import FairFilter

    model, band = outcome.estimator.model_, outcome.estimator.band
    if (model.masses <= 0).any():
        outcome.no_free_run = "a mass is not positive"
        return
    rows: dict[str, list[float]] = {}
    for rec, seg in progress(list(zip(records, data.segments)), "free runs"):
        if np.isnan(seg.F[seg.valid]).any():
            outcome.no_free_run = f"a force of {rec.name} is unknown"
            continue
        try:
            run = free_run_of(model, seg, seg.valid, 1.0 / rec.fs)
        except SimulationError as error:
            outcome.no_free_run = str(error)
            continue
        outcome.runs.append((seg, run))
        filter = None if band is None else FairFilter(band, rec.fs)
        missed, measured = squares_of(run, seg, seg.valid, filter)
        rows[_unique(rec.name, rows)] = list(100.0 * np.sqrt(missed / measured))
    if rows:
        outcome.free_run = pd.DataFrame.from_dict(
            rows, orient="index", columns=[f"x{j}" for j in range(1, model.n_dof + 1)]
        )


def _response(model: Any, frf: FrequencyResponse) -> np.ndarray:
    """Accelerance of the model at the measured lines."""
    M, C, K = model.matrices()
    w = 2 * np.pi * frf.f[:, None, None]
    unit = np.zeros((frf.n_dof, 1))
    unit[frf.driven - 1] = 1.0
    return -(w[:, :, 0] ** 2) * np.linalg.solve(K - w**2 * M + 1j * w * C, unit[None])[:, :, 0]


def _unique(name: str, taken: Any) -> str:
    number, label = 2, name
    while label in taken:
        label, number = f"{name} ({number})", number + 1
    return label
