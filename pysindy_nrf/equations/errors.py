"""Errors of the equations of motion: percent NRMSE, per equation and pooled.

``100 rms(e) / rms(reference)``; the reference is the force F_j on a forced DOF and the
inertia ``m_j a_j`` elsewhere (where storeys were solved from the top down, the inertia
of all DOFs above). Pooled: root of the summed squares over the summed squares, each
equation first divided by the rms of its storey force.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..chain.identifiability import SolveOrder
from ..chain.layout import Block, Layout
from ..chain.model import ChainModel
from ..chain.sites import Site
from .accumulation import total_products
from .free_runs import free_run_by_either as free_run_by_either
from .free_runs import free_run_error as free_run_error
from .free_runs import free_run_of as free_run_of
from .free_runs import squares_of as squares_of
from .normal_equations import Dofs, NormalEquations, PerBlock, groups_of

__all__ = ["nrmse"]

COLUMNS = ["error", "residual", "reference", "of"]
# Percent; below it round-off of sums of products, the root of the machine precision,
# shows in the last digits.
LEAST_ERROR_OF_SUMS = 0.1


class Sizes(NamedTuple):
    """Rms sizes of one equation of motion, N; arrays where blocks are judged together.

    Attributes
    ----------
    residual, reference, storey : float
    of : {"F", "m a"}
        The kind of reference.
    n_samples : float
        Samples, or the sum of their weights.
    """

    residual: PerBlock
    reference: PerBlock
    storey: PerBlock
    of: str
    n_samples: PerBlock


def balance_errors(model: ChainModel, grams: NormalEquations) -> pd.DataFrame:
    """Errors of the equations of motion (one step, not free run) of a model."""
    masses = dict(enumerate(model.masses, 1))
    coefficients = model.coefficients
    rows: dict[str, list[PerBlock | str]] = {}
    every = []
    for dof in masses:
        sizes = balance_sizes(dof, masses, coefficients, grams)
        every.append(sizes)
        if sizes is not None:
            error = _percent(sizes.residual, sizes.reference)
            rows[f"dof {dof}"] = [error, sizes.residual, sizes.reference, sizes.of]
    rows["pooled"] = [pooled_percent(every), np.nan, np.nan, ""]
    return pd.DataFrame.from_dict(rows, orient="index", columns=COLUMNS)


def pooled_error(
    masses: Mapping[int, PerBlock],
    coefficients: Mapping[Site, np.ndarray],
    grams: NormalEquations,
) -> Any:
    """Pooled error of masses and coefficients, percent; see :func:`balance_errors`."""
    dofs = range(1, grams.layout.n_dof + 1)
    return pooled_percent(
        balance_sizes(dof, masses, coefficients, grams) for dof in dofs
    )


def balance_sizes(
    dof: int,
    masses: Mapping[int, PerBlock],
    coefficients: Mapping[Site, np.ndarray],
    grams: NormalEquations,
) -> Sizes | None:
    """Rms sizes of one equation, or None if its force is unknown throughout."""
    above = tuple(range(dof, grams.layout.n_dof + 1))
    dofs = above if above in grams.groups else (dof,)
    n_samples = grams.sizes[dofs]
    if not np.any(n_samples):
        return None

    places = grams.positions(dofs)
    # residual, force alone, inertia alone, storey force alone
    weights = np.zeros((*grams.shape, grams.matrices[dofs].shape[-1], 4))
    weights[..., 0] = residual_weights(masses, coefficients, grams, dofs)
    weights[..., places.target, 1] = 1.0
    if places.mass is not None:
        weights[..., places.mass, 2] = masses[dof]
    storey_site = next((site for site in places.sites if site.p == dof), None)
    if storey_site is not None:
        columns = places.sites[storey_site]
        weights[..., columns, 3] = coefficients[storey_site]
    lengths = np.moveaxis(grams.norms(dofs, weights), -1, 0)
    residual, force, inertia, storey = lengths / n_samples**0.5

    of = "F" if np.all(force) and places.mass is not None else "m a"
    reference = np.where(force, force, inertia)
    storey = np.where(storey, storey, np.where(reference, reference, 1.0))
    if grams.shape:
        return Sizes(residual, reference, storey, of, n_samples)
    return Sizes(float(residual), float(reference), float(storey), of, float(n_samples))


def residual_weights(
    masses: Mapping[int, PerBlock],
    coefficients: Mapping[Site, np.ndarray],
    grams: NormalEquations,
    dofs: Dofs,
) -> np.ndarray:
    """Weights of the columns of an equation whose sum is the residual."""
    places = grams.positions(dofs)
    weights = np.zeros((*grams.shape, grams.matrices[dofs].shape[-1]))
    for site, sign in zip(places.sites, grams.groups[dofs].signs):
        weights[..., places.sites[site]] = sign * coefficients[site]
    if places.mass is not None:
        weights[..., places.mass] = masses[dofs[0]]
    weights[..., places.target] = -1.0
    return weights


def pooled_percent(balances: Iterable[Sizes | None]) -> Any:
    """Pooled percent NRMSE, each equation divided by the rms of its storey force.

    None is left out.
    """
    error: PerBlock = 0.0
    reference: PerBlock = 0.0
    for sizes in balances:
        if sizes is not None:
            error += sizes.n_samples * (sizes.residual / sizes.storey) ** 2
            reference += sizes.n_samples * (sizes.reference / sizes.storey) ** 2
    return _percent(error**0.5, reference**0.5)


def _percent(error: PerBlock, reference: PerBlock) -> Any:
    """Percent of a reference; infinite of zero, but zero of zero is zero."""
    percent = np.where(np.equal(error, 0.0), 0.0, np.inf)
    np.divide(100.0 * error, reference, out=percent, where=np.not_equal(reference, 0.0))
    return percent if percent.ndim else float(percent)


def judge(
    model: ChainModel,
    layout: Layout,
    solve_order: SolveOrder,
    blocks: Callable[[], Iterable[Block]],
) -> pd.DataFrame:
    """Errors of a model on blocks of samples; see :func:`balance_errors`.

    Where they are small the samples are summed up once more by QR: ``blocks`` is called
    again.
    """
    masses = dict(enumerate(model.masses.tolist(), 1))
    groups = groups_of(layout, solve_order)
    errors = balance_errors(model, total_products(layout, groups, blocks(), masses))
    if not (errors["error"] < LEAST_ERROR_OF_SUMS).any():
        return errors
    return balance_errors(
        model, total_products(layout, groups, blocks(), masses, "root")
    )


def explained_accelerations(
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> float:
    """R^2 of accelerations, variance-weighted over the DOFs.

    ``parts`` are, by record, measured accelerations, what a model misses of them (NaN:
    unknown), and weights of the samples.
    """
    missed = variation = 0.0
    for j in range(parts[0][0].shape[1]):
        known = [record for record in parts if not np.isnan(record[1][0, j])]
        if known:
            a = np.concatenate([record[0][:, j] for record in known])
            gap = np.concatenate([record[1][:, j] for record in known])
            weights = np.concatenate([record[2] for record in known])
            missed += float(weights @ gap**2)
            variation += float(weights @ (a - np.average(a, weights=weights)) ** 2)
    return 1.0 - missed / variation if variation else float("nan")


def nrmse(measured: npt.ArrayLike, computed: npt.ArrayLike) -> float:
    """Percent NRMSE of one signal, ``100 rms(computed - measured) / rms(measured)``.

    Parameters
    ----------
    measured, computed : array-like of the same shape

    Returns
    -------
    float
        Rows with NaN in either are left out.

    Examples
    --------
    Ten percent too large:

    >>> from pysindy_nrf.equations.errors import nrmse
    >>> round(nrmse([1.0, -2.0, 2.0], [1.1, -2.2, 2.2]), 9)
    10.0
    """
    a, b = np.asarray(measured, dtype=float), np.asarray(computed, dtype=float)
    finite = np.isfinite(a) & np.isfinite(b)
    error = float(np.sqrt(np.mean((b[finite] - a[finite]) ** 2)))
    return _percent(error, float(np.sqrt(np.mean(a[finite] ** 2))))
