"""Intervals of masses, coefficients and shape parameters, from fold to fold."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import t as student

from ..equations.normal_equations import variance
from ..exceptions import NRFError
from ..identification.intervals import parameters_of
from .effects import Effect
from .fitted_model import FittedModel
from .model_extension import ModelExtension
from .shape_axes import ShapeAxes

# Of the intervals.
LEVEL = 0.95
# Step of the derivatives with respect to shape parameters, as a share of their range.
DIFFERENCE = 2e-3

Interval = tuple[float, float]


def effect_intervals(model: FittedModel, effect: Effect) -> dict[str, Interval]:
    """95 % intervals of an effect by the jackknife over folds (Efron 1982).

    Those of shape parameters by derivatives; an instant is dated by the windows. None
    where the folds do not give them.
    """
    axes = ShapeAxes(effect.template, model.spectra.data, [effect.site])
    point = axes.point_of(effect.law)
    columns = _columns_and_derivatives(model, effect, axes, point)
    width = len(effect.law.terms())
    base = model.without(effect.site, effect.law)
    try:
        extension = ModelExtension(
            base, [(effect.site, effect.law)], len(columns) - width
        )
        values = extension.without_folds(columns)
    except NRFError:
        return {}
    if not np.isfinite(values).all():
        return {}

    half = _half_width(values, len(values) - 1)
    intervals = {}
    for term, value, h in zip(effect.law.terms(), _coefficients(model, effect), half):
        intervals[term.symbol] = (float(value - h), float(value + h))
    for k, shape in enumerate(axes.shapes):
        if axes.is_instant:
            around = np.ravel(axes.dated(point))
        else:
            around = point[k] + np.array([-1, 1]) * half[width + k]
        low, high = axes.scales[0].values(around, k)
        intervals[shape.name] = (float(low), float(high))
    return intervals


def _coefficients(model: FittedModel, effect: Effect) -> np.ndarray:
    """Coefficients of the last law at a site."""
    stop = model.layout.slices[effect.site].stop
    return model.coefficients[0, stop - len(effect.law.terms()) : stop]


def _columns_and_derivatives(
    model: FittedModel, effect: Effect, axes: ShapeAxes, point: np.ndarray
) -> np.ndarray:
    """Spectra of the columns of an effect and of its derivatives with respect to shape.

    An instant has no derivative.
    """
    spectra, site = model.spectra, effect.site
    values = _coefficients(model, effect)
    columns = spectra.columns(site, [effect.law])
    if axes.is_instant:
        return columns

    rows = [columns]
    for k in range(len(point)):
        step = DIFFERENCE * (axes.high[k] - axes.low[k])
        if point[k] + step > axes.high[k]:
            step = -step
        (moved,) = axes.laws_at(point + step * np.eye(len(point))[k])
        change = spectra.columns(site, [moved]) - columns
        rows.append((values @ change / step)[None])
    return np.vstack(rows)


def parameter_intervals(model: FittedModel) -> dict[str, Interval]:
    """95 % intervals of masses and coefficients by name."""
    known = model.spectra.data.known_masses
    rows = []
    for masses, coefficients in zip(model.masses, model.coefficients):
        rows.append(parameters_of(model.chain_model(masses, coefficients), known))
    table = pd.DataFrame(rows)

    half = _half_width(table.iloc[1:], max(len(table) - 2, 1))
    intervals = {}
    for name, value, h in zip(table, table.iloc[0].astype(float), half):
        if np.isfinite(h):
            intervals[name] = (value - h, value + h)
    return intervals


def _half_width(values: np.ndarray | pd.DataFrame, dof: int) -> np.ndarray:
    """Half-widths of the intervals of estimates, each with one fold left out."""
    quantile = student.ppf(0.5 + LEVEL / 2, dof)
    return quantile * np.sqrt(variance(values))
