"""Files that the commands write, each whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from ...data.io import write_forces, write_table
from ...regression.segments import SegmentSet
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
    """Write model, tables and figures."""
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
        from .figures import draw_all

        written += draw_all(outcome, folder, band)
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
    """All coefficients of a model, one row each."""
    rows = [
        (str(site), term, value, unit)
        for site, force in model.restoring_forces.items()
        for (term, value), unit in zip(force.coefficients.items(), force.units)
    ]
    return pd.DataFrame(rows, columns=["site", "term", "value", "unit"])
