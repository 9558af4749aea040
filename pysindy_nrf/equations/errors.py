"""One ruler for errors: percent NRMSE, per balance and pooled.

``100 rms(e) / rms(reference)``; the reference is the force F_j on a forced DOF and the
inertia ``m_j a_j`` elsewhere (where storeys were solved from the top down, the inertia
of all DOFs above). Pooled: root of the summed squares over the summed squares, each
balance first divided by the rms of its storey force.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ..chain.identifiability import SolveOrder
from ..chain.layout import Block, Layout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..exceptions import NRFError
from ..records.dataset import BlockRows, Dataset, Segment
from ..records.record import Record
from ..simulation.api import simulate
from .accumulation import total_gram
from .chain_solve import groups_of
from .normal_equations import NormalEquations

__all__ = ["nrmse"]
COLUMNS = ["error", "residual", "reference", "of"]
# Percent; below it round-off of a Gram matrix (the root of the machine precision) shows
# in the last digits.
_HELD_BY_A_GRAM = 0.1


def balance_errors(model: ChainModel, grams: NormalEquations) -> pd.DataFrame:
    """Balance errors (one step, not free run) of a model from Gram matrices."""
    coefficients = model.coefficients
    masses = dict(enumerate(model.masses, 1))
    balances = {j: balance_sizes(j, masses, coefficients, grams) for j in masses}
    rows = {
        f"dof {j}": [_percent(*x[:2]), *x[:2], x.of] for j, x in balances.items() if x
    }
    rows["pooled"] = [pooled_percent(balances.values()), np.nan, np.nan, ""]
    return pd.DataFrame.from_dict(rows, orient="index", columns=COLUMNS)


def pooled_error(
    masses: Mapping[int, float],
    coefficients: Mapping[Site, np.ndarray],
    grams: NormalEquations,
) -> float:
    """Pooled balance error of masses and coefficients, percent NRMSE; see
    :func:`balance_errors`.
    """
    return pooled_percent(
        balance_sizes(j, masses, coefficients, grams)
        for j in range(1, grams.layout.n_dof + 1)
    )


class Sizes(NamedTuple):
    """Rms of residual, reference and storey force of one balance, N; the kind of
    reference, and the samples.
    """

    residual: float
    reference: float
    storey: float
    of: str  # "F" or "m a"
    n_samples: float  # or the sum of their weights


def balance_sizes(
    dof: int,
    masses: Mapping[int, float],
    coefficients: Mapping[Site, np.ndarray],
    grams: NormalEquations,
) -> Sizes | None:
    """Rms sizes of one balance, or None if its force is unknown throughout."""
    above = tuple(range(dof, grams.layout.n_dof + 1))
    dofs = above if above in grams.groups else (dof,)
    size = grams.sizes[dofs]
    if not np.any(size):
        return None
    where, mass_at, target_at = grams.positions(dofs)
    # columns: residual, force alone, inertia alone, storey force alone
    weights = np.zeros((*grams.shape, grams.matrices[dofs].shape[-1], 4))
    weights[..., 0] = residual_weights(masses, coefficients, grams, dofs)
    weights[..., target_at, 1] = 1.0
    if mass_at is not None:
        weights[..., mass_at, 2] = masses[dof]
    for site in [site for site in where if site.p == dof][:1]:
        weights[..., where[site], 3] = coefficients[site]
    residual, force, inertia, storey = (
        np.moveaxis(grams.norms(dofs, weights), -1, 0) / size**0.5
    )
    of = "F" if np.all(force) and mass_at is not None else "m a"
    if grams.shape:
        reference = np.where(force, force, inertia)
        storey = np.where(storey, storey, np.where(reference, reference, 1.0))
        # of each block
        return Sizes(residual, reference, storey, of, size)  # type: ignore[arg-type]
    reference = force or inertia
    return Sizes(
        float(residual),
        float(reference),
        float(storey or reference or 1.0),
        of,
        float(size),
    )


def residual_weights(
    masses: Mapping[int, float],
    coefficients: Mapping[Site, np.ndarray],
    grams: NormalEquations,
    dofs: tuple[int, ...],
) -> np.ndarray:
    """Weights of the columns of one balance, or of several summed, whose sum is the
    residual.
    """
    where, mass_at, target_at = grams.positions(dofs)
    weights = np.zeros((*grams.shape, grams.matrices[dofs].shape[-1]))
    for site, sign in zip(where, grams.groups[dofs].signs):
        weights[..., where[site]] = sign * coefficients[site]
    if mass_at is not None:
        weights[..., mass_at] = masses[dofs[0]]
    weights[..., target_at] = -1.0
    return weights


def pooled_percent(balances: Iterable[Sizes | None]) -> float:
    """Pooled percent NRMSE of balances, each divided by the rms of its storey force;
    None is left out.
    """
    top = bottom = 0.0
    for sizes in balances:
        if sizes is not None:
            top += sizes.n_samples * (sizes.residual / sizes.storey) ** 2
            bottom += sizes.n_samples * (sizes.reference / sizes.storey) ** 2
    return _percent(top**0.5, bottom**0.5)


def _percent(part: Any, whole: Any) -> Any:
    if np.ndim(whole):  # of blocks
        return np.array(
            [_percent(*pair) for pair in zip(part.tolist(), whole.tolist())]
        )
    return 100.0 * part / whole if whole else (0.0 if part == 0 else np.inf)


def judge(
    model: ChainModel,
    layout: Layout,
    solve_order: SolveOrder,
    blocks: Callable[[], Iterable[Block]],
) -> pd.DataFrame:
    """Balance errors of a model on blocks of samples."""
    known = dict(enumerate(model.masses.tolist(), 1))

    def run(kind: str) -> pd.DataFrame:
        return balance_errors(
            model,
            total_gram(layout, groups_of(layout, solve_order), blocks(), known, kind),
        )

    errors = run("gram")
    return run("root") if (errors["error"] < _HELD_BY_A_GRAM).any() else errors


def explained_accelerations(
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> float:
    """R^2 of accelerations, variance-weighted over the DOFs, from measured ones, gaps
    (NaN: unknown) and weights.
    """
    left = error = 0.0
    for j in range(parts[0][0].shape[1]):
        if held := [
            (a[:, j], gap[:, j], w) for a, gap, w in parts if not np.isnan(gap[0, j])
        ]:
            a, gap, w = (np.concatenate(column) for column in zip(*held))
            error += float(w @ gap**2)
            left += float(w @ (a - np.average(a, weights=w)) ** 2)
    return 1.0 - error / left if left else float("nan")


def nrmse(measured: Any, found: Any) -> float:
    """Percent NRMSE of one signal, ``100 rms(found - measured) / rms(measured)``.

    Parameters
    ----------
    measured, found : array-like of the same shape

    Returns
    -------
    float
        Rows with NaN in either are left out.

    Examples
    --------
    >>> from pysindy_nrf.equations.errors import nrmse
    >>> round(
    ...     nrmse([1.0, -2.0, 2.0], [1.1, -2.2, 2.2]), 9
    ... )  # ten percent too large
    10.0
    """
    a, b = np.asarray(measured, dtype=float), np.asarray(found, dtype=float)
    good = np.isfinite(a) & np.isfinite(b)
    return _percent(
        float(np.sqrt(np.mean((b[good] - a[good]) ** 2))),
        float(np.sqrt(np.mean(a[good] ** 2))),
    )


def free_run_of(
    model: ChainModel,
    segment: Segment,
    rows: slice | None = None,
    dt: float | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    integrator: Callable[..., Record] = simulate,
    **options: Any,
) -> Record:
    """The model alone under the forces and base motion of some rows, from their first
    state.
    """
    rows = segment.valid if rows is None else rows
    x0, v0 = start or (
        np.cumsum(y[rows.start].astype(float)) for y in (segment.s, segment.v)
    )
    t0 = (
        0.0 if segment.t is None else float(segment.t[rows.start])
    )  # on the clock that the laws read
    return integrator(
        model,
        segment.F[rows],
        segment.step if dt is None else dt,
        x0=x0,
        v0=v0,
        t0=t0,
        base_acceleration=None if segment.ag is None else segment.ag[rows],
        covariates={k: c[rows] for k, c in segment.covariates.items()} or None,
        **options,
    )


def free_run_by_either(
    model: ChainModel, segment: Segment, rows: slice, dt: float | None = None
) -> Record:
    """The free run, by Newmark's method where that of variable steps fails or exceeds a
    hundred times what was seen.
    """
    with suppress(NRFError):
        largest = float(np.abs(np.cumsum(segment.s[rows], axis=1)).max())
        run = free_run_of(model, segment, rows, dt, limit=100.0 * largest or 1e100)
        if np.isfinite(np.asarray(run.displacement, dtype=float)).all():
            return run
    return free_run_of(model, segment, rows, dt, method="newmark")


def squares_of(
    run: Record, segment: Segment, rows: slice, filter: Any = None
) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares of a free run's error and of the measured displacement."""
    x = np.cumsum(segment.s[rows], axis=1)
    error = run.displacement - x
    if filter is not None:
        error, x = filter.apply(error), filter.apply(x)
    return (error**2).sum(axis=0), (x**2).sum(axis=0)


def free_run_error(
    model: ChainModel,
    data: Dataset,
    filters: Sequence[Any],
    blocks: Sequence[BlockRows],
) -> float:
    """Free-run error of the displacements on some blocks, percent NRMSE."""
    if (model.masses <= 0).any():
        return float("nan")
    sums = np.zeros((2, model.n_dof))
    for block in blocks:
        seg = data.segments[block.segment]
        start = seg.valid.start
        rows = slice(start + block.rows.start, start + block.rows.stop)
        if (
            seg.dt is None
            or np.isnan(seg.F[rows.start]).any()
            or rows.stop - rows.start < 8
        ):
            return float("nan")
        try:
            run = free_run_of(model, seg, rows)
        except NRFError:
            return float("nan")
        sums += squares_of(run, seg, rows, filters[block.segment])
    top, bottom = sums
    return (
        float(100.0 * np.sqrt(np.mean(top / bottom)))
        if (bottom > 0).all()
        else float("nan")
    )
