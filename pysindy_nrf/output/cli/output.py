"""Files that the commands write, each whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...data.io import write_forces, write_table
from ...regression.segments import SegmentSet
from ..displays import FreeRunDisplay
from ..displays._matplotlib import save
from ..displays.forces import loop_figure
from ..displays.motion import response_figures
from ..report.story import band_text
from .work import Outcome


def write_all(
    outcome: Outcome,
    folder: Path,
    band: Any,
    figures: bool,
    tables: str = "csv",
    forces: str | None = None,
    records: Any = None,
) -> list[Path]:
    """Write model, tables, figures (with matplotlib), the page of the records, and what was asked for beside them."""
    from ..report import write_html

    est, model = outcome.estimator, outcome.estimator.model_
    written = [folder / "model.json"]
    model.to_json(written[0])
    masses = pd.DataFrame({"dof": range(1, model.n_dof + 1), "mass_kg": model.masses})
    errors = est.errors_.reset_index(names="balance").rename(
        columns={"error": "error_percent", "residual": "residual_N_rms", "reference": "reference_N_rms"}
    )
    frames = {"masses": masses, "coefficients": coefficients(model), "balance_errors": errors}
    if (model.masses > 0).all() and (model.total_masses > 0).all():
        frames["modes"] = model.modes().reset_index().rename(columns={"frequency": "frequency_Hz"})
    if outcome.free_run is not None:
        frames["free_run_errors"] = outcome.free_run.add_suffix("_percent").reset_index(names="record")
    written += [write_table(frame, folder / f"{name}.{tables}") for name, frame in frames.items()]
    if forces and outcome.data is not None:
        for i, seg in enumerate(outcome.data.segments, 1):
            number = f"_{i}" if len(outcome.data.segments) > 1 else ""
            alone = SegmentSet([replace(seg, rows=slice(0, seg.n_samples))], seg.n_samples)
            written.append(write_forces(model, alone, folder / f"restoring_forces{number}.{forces}"))
    if figures:
        written += _figures(outcome, folder, band)
    if outcome.frf is None:
        notes = tuple(outcome.warnings)
        written += page(lambda path: write_html(path, est, records, notes=notes, band=band), folder / "report.html")
    return written


def page(write: Callable[[Path], Any], path: Path) -> list[Path]:
    """Write a page if the packages of the extra ``report`` are installed."""
    from ..report import available

    if not available():
        return []
    write(path)
    return [path]


def coefficients(model: Any) -> pd.DataFrame:
    """All coefficients of a model: ``site``, ``term``, ``value``, ``unit``."""
    rows = [
        (str(site), term, value, unit)
        for site, force in model.restoring_forces.items()
        for (term, value), unit in zip(force.coefficients.items(), force.units)
    ]
    return pd.DataFrame(rows, columns=["site", "term", "value", "unit"])


def _figures(outcome: Outcome, folder: Path, band: Any) -> list[Path]:
    """Draw the restoring forces and the free run, or the frequency responses."""
    written = []
    if outcome.frf is not None:
        frf, found = outcome.frf
        used = outcome.used
        title = f"Accelerance, force on DOF {frf.driven}, {band_text(band)}"
        responses = response_figures(frf.f[used], frf.H[used], found[used])
        return save(folder / "frequency_response.png", responses, title=title)
    if outcome.data is not None:
        from ...discrepancy.site_loops import loops_of
        from ...signals.zero_phase_filter import filters_of

        data = outcome.data
        loops = [loop_figure(loop) for loop in loops_of(outcome.estimator.model_, data, filters_of(band, data))]
        written += save(folder / "restoring_forces.png", loops, columns=max(1, min(3, len(loops))))
    if outcome.runs:
        display = _free_run(outcome, band)
        last = f", last {display.time[-1] - display.begin:.3g} s" if display.begin > display.time[0] else ""
        title = f"The model alone under the measured force{last}, {band_text(band)}"
        written += save(folder / "free_run.png", display.figures(), title=title)
    return written


def _free_run(outcome: Outcome, band: Any) -> Any:
    """Measured and free-run displacements at the end of the first record, where a model has had time to go wrong."""
    from ...signals.zero_phase_filter import FairFilter

    seg, run = outcome.runs[0]
    measured, own = np.cumsum(seg.s[seg.valid], axis=1), run.displacement
    begin = run.time[_start_of_last_cycles(measured)]
    if band is not None:
        filter = FairFilter(band, run.fs)
        measured, own = filter.apply(measured), filter.apply(own)
    return FreeRunDisplay(run.time, measured, own, begin)


def _start_of_last_cycles(measured: np.ndarray, cycles: int = 25) -> int:
    """Row where the last cycles of the top displacement begin."""
    crossings = np.flatnonzero(np.diff(np.signbit(measured[:, -1] - measured[:, -1].mean())))
    return int(crossings[-2 * cycles]) if len(crossings) >= 2 * cycles else 0
