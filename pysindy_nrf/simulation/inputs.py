"""Sampled forces, base acceleration and covariates as polynomials between the samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..data.channels import as_matrix, rows_text
from ..exceptions import ChannelError

HOLDS = ("linear", "zero", "cubic")


def finite(value: Any, names: Any, n_columns: int, what: str) -> np.ndarray:
    """A matrix of finite numbers, or an error that names channel and rows."""
    array = as_matrix(value, names, n_columns, what).astype(float)
    for j in range(n_columns):
        bad = np.flatnonzero(~np.isfinite(array[:, j]))
        if bad.size:
            name = f"{names}{j + 1}" if isinstance(names, str) else names[j]
            raise ChannelError(
                f"Channel {name} of the {what} is not finite in {rows_text(bad)}", "Give a number for every sample."
            )
    return array


def initial(value: Any, prefix: str, n_dof: int, what: str) -> np.ndarray:
    """An initial condition of every DOF."""
    if value is None:
        return np.zeros(n_dof)
    array = np.asarray(value)
    if array.shape != (n_dof,):
        raise ChannelError(
            f"{prefix}0 has shape {array.shape}, ({n_dof},) is needed", f"Give one initial {what} for each DOF."
        )
    return finite(array[None, :], prefix, n_dof, f"initial {what}")[0]


def input_matrix(
    force: np.ndarray, base_acceleration: Any, covariates: Mapping[str, Any] | None, names: tuple[str, ...]
) -> np.ndarray:
    """Forces, base acceleration and the covariates that the laws read, side by side."""
    n = len(force)
    lines = [("ag", np.zeros(n) if base_acceleration is None else base_acceleration)]
    given = dict(covariates or {})
    for name in names:
        if name not in given:
            raise ChannelError(
                f"The laws of the model read the covariate {name!r}, which is not given",
                f"Pass covariates={{{name!r}: ...}}.",
            )
        lines.append((name, given[name]))
    columns = []
    for name, line in lines:
        column = finite(line, [name], 1, "input")[:, 0]
        if len(column) != n:
            raise ChannelError(f"{name} has {len(column)} samples, the force {n}", "Cut or resample them to one clock.")
        columns.append(column)
    return np.ascontiguousarray(np.column_stack([force, *columns]))  # one layout: compiled once


def polynomials(samples: np.ndarray, hold: str) -> np.ndarray:
    """Coefficients of the inputs between samples, in powers of the share of the interval."""
    if hold == "linear":
        return np.stack([samples[:-1], np.diff(samples, axis=0)])
    if hold == "zero":
        return samples[None, :-1].copy()
    if hold == "cubic":
        from scipy.interpolate import CubicSpline

        return np.ascontiguousarray(CubicSpline(np.arange(len(samples)), samples).c[::-1])
    raise ChannelError(f"hold={hold!r} is unknown", f"Choose {', '.join(map(repr, HOLDS))}.")
