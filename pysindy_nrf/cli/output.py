"""Files that the commands write, each whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from .._atomic import atomic_write
from .work import Outcome


def write_all(outcome: Outcome, folder: Path, band: Any, figures: bool) -> list[Path]:
    """Write model, tables and figures.

    Parameters
    ----------
    outcome : Outcome
    folder : Path
    band : (float, float) or None
    figures : bool
        Draw them if matplotlib is installed.

    Returns
    -------
    list of Path
        What was written.
    """
    est, model = outcome.estimator, outcome.estimator.model_
    written = [folder / "model.json"]
    model.to_json(written[0])
    masses = pd.DataFrame({"dof": range(1, model.n_dof + 1), "mass_kg": model.masses})
    errors = est.errors_.reset_index(names="balance").rename(
        columns={"error": "error_percent", "residual": "residual_N_rms", "reference": "reference_N_rms"}
    )
    tables = {"masses.csv": masses, "coefficients.csv": coefficients(model), "balance_errors.csv": errors}
    if (model.masses > 0).all():
        tables["modes.csv"] = model.modes().reset_index().rename(columns={"frequency": "frequency_Hz"})
    if outcome.free_run is not None:
        tables["free_run_errors.csv"] = outcome.free_run.add_suffix("_percent").reset_index(names="record")
    for name, frame in tables.items():
        with atomic_write(folder / name) as file:
            frame.to_csv(file, index=False, lineterminator="\n")
        written.append(folder / name)
    if figures:
        from .figures import draw_all

        written += draw_all(outcome, folder, band)
    return written


def coefficients(model: Any) -> pd.DataFrame:
    """All coefficients of a model, one row each.

    Parameters
    ----------
    model : ChainModel

    Returns
    -------
    DataFrame
        ``site``, ``term``, ``value``, ``unit``.
    """
    rows = [
        (str(site), term, value, force.units[term])
        for site, force in model.restoring_forces.items()
        for term, value in force.coefficients.items()
    ]
    return pd.DataFrame(rows, columns=["site", "term", "value", "unit"])
