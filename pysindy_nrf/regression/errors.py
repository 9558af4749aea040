"""One ruler for errors: percent NRMSE, per balance and pooled.

``100 rms(e) / rms(reference)``; the reference is the force F_j on a forced DOF and the inertia
``m_j a_j`` elsewhere (where storeys were solved from the top down, the inertia of all DOFs above).
Pooled: root of the summed squares over the summed squares, each balance first divided by the rms of
its storey force.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import pandas as pd

from ..data.record import Record
from ..exceptions import NRFError
from ..mechanics.identifiability import SolveOrder
from ..mechanics.sites import Site
from .blocks import Block
from .chain_model import ChainModel
from .chain_solve import groups_of
from .gram_pass import total_gram
from .grams import BlockGrams
from .layout import Layout
from .segments import BlockRows, Segment, SegmentSet

COLUMNS = ["error", "residual", "reference", "of"]
# Percent; below it round-off of a Gram matrix (the root of the machine precision) shows in the last digits.
_HELD_BY_A_GRAM = 0.1


def balance_errors(model: ChainModel, grams: BlockGrams) -> pd.DataFrame:
    """Balance errors (one step, not free run) of a model from Gram matrices.

    Parameters
    ----------
    model : ChainModel
    grams : BlockGrams
        A sum, of the data to judge, with the model's own laws as columns.

    Returns
    -------
    DataFrame
        One row ``"dof j"`` for each balance whose force is known, and ``"pooled"``; columns
        ``error`` (percent), ``residual`` and ``reference`` (rms, N), ``of`` (``"F"`` or ``"m a"``).

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.regression.chain_solve import groups_of
    >>> from pysindy_nrf.regression.errors import balance_errors
    >>> from pysindy_nrf.regression.gram_pass import total_gram
    >>> from pysindy_nrf.regression.layout import LawLayout
    >>> X, F = datasets.load_demo().to_features()
    >>> fitted = NRFRegressor(degree=3).fit(X, F)
    >>> layout = LawLayout(fitted.chain_, fitted.model_.laws)
    >>> data = fitted.model_.segments(X, F)
    >>> grams = total_gram(layout, groups_of(layout, fitted.solve_order_), data.segments[0].blocks(layout))
    >>> balance_errors(fitted.model_, grams)["error"].round(1).to_dict()
    {'dof 1': 2.2, 'dof 2': 4.2, 'dof 3': 1.2, 'pooled': 1.9}
    """
    coefficients = model.coefficients
    masses = dict(enumerate(model.masses, 1))
    rows, pooled = {}, Pooled()
    for j in masses:
        sizes = balance_sizes(j, masses, coefficients, grams)
        if sizes is None:
            continue
        rows[f"dof {j}"] = [_percent(sizes.residual, sizes.reference), sizes.residual, sizes.reference, sizes.of]
        pooled.add(sizes)
    rows["pooled"] = [pooled.percent, np.nan, np.nan, ""]
    return pd.DataFrame.from_dict(rows, orient="index", columns=COLUMNS)


def pooled_error(masses: Mapping[int, float], coefficients: Mapping[Site, np.ndarray], grams: BlockGrams) -> float:
    """Pooled balance error of masses and coefficients, percent NRMSE; see :func:`balance_errors`.

    Parameters
    ----------
    masses : mapping of int to float
        kg, by DOF.
    coefficients : mapping of Site to ndarray
    grams : BlockGrams

    Returns
    -------
    float

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.regression.chain_solve import groups_of
    >>> from pysindy_nrf.regression.errors import pooled_error
    >>> from pysindy_nrf.regression.gram_pass import total_gram
    >>> from pysindy_nrf.regression.layout import LawLayout
    >>> X, F = datasets.load_demo().to_features()
    >>> fitted = NRFRegressor(degree=3).fit(X, F)
    >>> layout = LawLayout(fitted.chain_, fitted.model_.laws)
    >>> segment = fitted.model_.segments(X, F).segments[0]
    >>> grams = total_gram(layout, groups_of(layout, fitted.solve_order_), segment.blocks(layout))
    >>> masses = dict(enumerate(fitted.masses_, 1))
    >>> coefficients = {site: held[0].coefficients for site, held in fitted.model_.laws.items()}
    >>> round(pooled_error(masses, coefficients, grams), 1)  # percent
    1.9
    """
    pooled = Pooled()
    for j in range(1, grams.layout.n_dof + 1):
        sizes = balance_sizes(j, masses, coefficients, grams)
        if sizes is not None:
            pooled.add(sizes)
    return pooled.percent


class Sizes(NamedTuple):
    """Rms of the residual, the reference and the storey force of one balance (N), and the samples behind them.

    Attributes
    ----------
    residual, reference, storey : float
        Rms, N.
    of : {"F", "m a"}
        What the reference is: the applied force, or the inertia.
    n_samples : int

    Examples
    --------
    >>> from pysindy_nrf.regression.errors import Sizes
    >>> size = Sizes(residual=2.0, reference=50.0, storey=40.0, of="F", n_samples=4000)
    >>> 100 * size.residual / size.reference  # percent NRMSE of this balance
    4.0
    """

    residual: float
    reference: float
    storey: float
    of: str
    n_samples: int


def balance_sizes(
    dof: int, masses: Mapping[int, float], coefficients: Mapping[Site, np.ndarray], grams: BlockGrams
) -> Sizes | None:
    """Rms sizes of one balance, or None if its force is unknown throughout.

    Where the storeys were solved from the top down (base excitation, known masses), it is the
    balance of all DOFs from this one up, whose reference is the inertia above the storey: of the
    single balance little would be left but the difference of two storey forces.

    Parameters
    ----------
    dof : int
    masses : mapping of int to float
        kg, by DOF.
    coefficients : mapping of Site to ndarray
    grams : BlockGrams
        If it holds blocks, so are masses, coefficients and what comes back.

    Returns
    -------
    Sizes or None

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.regression.chain_solve import groups_of
    >>> from pysindy_nrf.regression.errors import balance_sizes
    >>> from pysindy_nrf.regression.gram_pass import total_gram
    >>> from pysindy_nrf.regression.layout import LawLayout
    >>> X, F = datasets.load_demo().to_features()
    >>> fitted = NRFRegressor(degree=3).fit(X, F)
    >>> layout = LawLayout(fitted.chain_, fitted.model_.laws)
    >>> segment = fitted.model_.segments(X, F).segments[0]
    >>> grams = total_gram(layout, groups_of(layout, fitted.solve_order_), segment.blocks(layout))
    >>> masses = dict(enumerate(fitted.masses_, 1))
    >>> coefficients = {site: held[0].coefficients for site, held in fitted.model_.laws.items()}
    >>> [balance_sizes(j, masses, coefficients, grams).of for j in (1, 2, 3)]  # floor 2 is shaken
    ['m a', 'F', 'm a']
    """
    above = tuple(range(dof, grams.layout.n_dof + 1))
    dofs = above if above in grams.groups else (dof,)
    size = grams.sizes[dofs]
    if not np.any(size):
        return None
    where, mass_at, target_at = grams.positions(dofs)
    group = grams.groups[dofs]
    # columns: residual, force alone, inertia alone, storey force alone
    weights = np.zeros((*grams.shape, grams.matrices[dofs].shape[-1], 4))
    own = None
    for site, sign in zip(group.sites, group.signs):
        weights[..., where[site], 0] = sign * coefficients[site]
        if own is None and site.p == dof:
            own = site
            weights[..., where[site], 3] = coefficients[site]
    weights[..., target_at, 0], weights[..., target_at, 1] = -1.0, 1.0
    if mass_at is not None:
        weights[..., mass_at, 0] = weights[..., mass_at, 2] = masses[dof]
    residual, force, inertia, storey = np.moveaxis(grams.norms(dofs, weights), -1, 0) / size**0.5
    of = "F" if np.all(force) and mass_at is not None else "m a"
    if grams.shape:
        reference = np.where(force, force, inertia)
        storey = np.where(storey, storey, np.where(reference, reference, 1.0))
        return Sizes(residual, reference, storey, of, size)  # type: ignore[arg-type]  # of each block
    reference = force or inertia
    return Sizes(float(residual), float(reference), float(storey or reference or 1.0), of, int(size))


class Pooled:
    """Running sums behind the pooled error.

    Examples
    --------
    >>> from pysindy_nrf.regression.errors import Pooled, Sizes
    >>> pooled = Pooled()
    >>> pooled.add(Sizes(residual=2.0, reference=50.0, storey=50.0, of="F", n_samples=1000))
    >>> pooled.add(Sizes(residual=0.6, reference=10.0, storey=10.0, of="m a", n_samples=1000))
    >>> round(pooled.percent, 2)  # between 4 and 6 %
    5.1
    """

    def __init__(self) -> None:
        self.top = self.bottom = 0.0

    def add(self, sizes: Sizes) -> None:
        """Add one balance, divided by the rms of its storey force.

        Parameters
        ----------
        sizes : Sizes
        """
        self.top += sizes.n_samples * (sizes.residual / sizes.storey) ** 2
        self.bottom += sizes.n_samples * (sizes.reference / sizes.storey) ** 2

    @property
    def percent(self) -> float:
        """Percent NRMSE."""
        return _percent(self.top**0.5, self.bottom**0.5)


def _percent(part: Any, whole: Any) -> Any:
    if np.ndim(whole):  # of blocks
        return np.array([_percent(*pair) for pair in zip(part.tolist(), whole.tolist())])
    return 100.0 * part / whole if whole else (0.0 if part == 0 else np.inf)


def judge(
    model: ChainModel, layout: Layout, solve_order: SolveOrder, blocks: Iterable[Block] | Callable[[], Iterable[Block]]
) -> pd.DataFrame:
    """Balance errors of a model on blocks of samples.

    Parameters
    ----------
    model : ChainModel
    layout : Layout
        Of the model's laws.
    solve_order : SolveOrder
        How the model was solved: single balances, or from the top down.
    blocks : iterable of Block, or callable
        A callable returns a fresh iterable at each call; an error too small for a Gram matrix is then read off the
        samples once more, by QR.

    Returns
    -------
    DataFrame
        See :func:`balance_errors`.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.regression.errors import judge
    >>> from pysindy_nrf.regression.layout import LawLayout
    >>> X, F = datasets.load_demo().to_features()
    >>> fitted = NRFRegressor(degree=3).fit(X, F)
    >>> layout = LawLayout(fitted.chain_, fitted.model_.laws)
    >>> segment = fitted.model_.segments(X, F).segments[0]
    >>> errors = judge(fitted.model_, layout, fitted.solve_order_, segment.blocks(layout))
    >>> errors["of"].to_dict()
    {'dof 1': 'm a', 'dof 2': 'F', 'dof 3': 'm a', 'pooled': ''}
    """
    known = dict(enumerate(model.masses.tolist(), 1))

    def run(kind: str, held: Iterable[Block]) -> pd.DataFrame:
        return balance_errors(model, total_gram(layout, groups_of(layout, solve_order), held, known, kind))

    if not callable(blocks):
        return run("gram", blocks)
    errors = run("gram", blocks())
    return run("root", blocks()) if (errors["error"] < _HELD_BY_A_GRAM).any() else errors


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
    >>> from pysindy_nrf.regression.errors import nrmse
    >>> round(nrmse([1.0, -2.0, 2.0], [1.1, -2.2, 2.2]), 9)  # ten percent too large
    10.0
    """
    a, b = np.asarray(measured, dtype=float), np.asarray(found, dtype=float)
    good = np.isfinite(a) & np.isfinite(b)
    return _percent(float(np.sqrt(np.mean((b[good] - a[good]) ** 2))), float(np.sqrt(np.mean(a[good] ** 2))))


def free_run_of(
    model: ChainModel,
    segment: Segment,
    rows: slice | None = None,
    dt: float | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    integrator: Callable[..., Record] = ChainModel.simulate,
    **options: Any,
) -> Record:
    """The model alone under the forces and base motion of some rows, from their first state."""
    rows = segment.valid if rows is None else rows
    x0, v0 = start or (np.cumsum(y[rows.start].astype(float)) for y in (segment.s, segment.v))
    return integrator(
        model,
        segment.F[rows],
        segment.step if dt is None else dt,
        x0=x0,
        v0=v0,
        t0=segment.time_at(rows.start),
        base_acceleration=None if segment.ag is None else segment.ag[rows],
        covariates={k: c[rows] for k, c in segment.covariates.items()} or None,
        **options,
    )


def squares_of(run: Record, segment: Segment, rows: slice, filter: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares of a free run's error and of the measured displacement."""
    x = np.cumsum(segment.s[rows], axis=1)
    error = run.displacement - x
    if filter is not None:
        error, x = filter.apply(error), filter.apply(x)
    return (error**2).sum(axis=0), (x**2).sum(axis=0)


class Judged(Protocol):
    """What a free run is compared with."""

    @property
    def data(self) -> SegmentSet:
        """Records."""

    @property
    def filters(self) -> Sequence[Any]:
        """FairFilter or None, one for each record."""


def free_run_error(model: ChainModel, work: Judged, blocks: Sequence[BlockRows]) -> float:
    """Free-run error of the displacements on some blocks, percent NRMSE."""
    if (model.masses <= 0).any():
        return float("nan")
    top, bottom = np.zeros(model.n_dof), np.zeros(model.n_dof)
    for block in blocks:
        seg = work.data.segments[block.segment]
        start = seg.valid.start
        rows = slice(start + block.rows.start, start + block.rows.stop)
        dt = seg.dt
        if dt is None or np.isnan(seg.F[rows.start]).any() or rows.stop - rows.start < 8:
            return float("nan")
        try:
            run = free_run_of(model, seg, rows, dt)
        except NRFError:
            return float("nan")
        error, x = squares_of(run, seg, rows, work.filters[block.segment])
        top += error
        bottom += x
    return float(100.0 * np.sqrt(np.mean(top / bottom))) if (bottom > 0).all() else float("nan")
