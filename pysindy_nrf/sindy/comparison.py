"""Plain SINDy, SINDy set up by an expert, and this package on the same data."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pysindy as ps
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator

from ..chain.model import ChainModel
from ..diagnosis.facts import OtherModel
from ..equations.errors import Sizes, nrmse, pooled_percent
from ..exceptions import ChannelError, NRFError, SimulationError
from ..identification.regressor import NRFRegressor
from ..records.input_arrays import from_arrays
from .compared_models import (
    ComparedModel,
    ExpertSINDy,
    PlainSINDy,
    RecordPart,
    Regressor,
    SelectedTerms,
    Shears,
)

__all__ = ["compare_with_sindy"]

COLUMNS = [
    "terms",
    "precision",
    "recall",
    "mass_error",
    "restoring_force_error",
    "force_error_own_masses",
    "balance_error",
    "free_run_error",
    "third_law_gap",
    "storeys_found",
    "seconds",
    "note",
]
# The row of this package whose fit has intervals, and so a verdict.
JUDGED = "pysindy_nrf, instrumental variables"
# Multiplications of a fit that is still run: some ten seconds.
MAX_WORK = 2e11


def compare_with_sindy(
    X: object,
    F: ArrayLike | None = None,
    dt: float | None = None,
    *,
    truth: ChainModel | None = None,
    degree: int = 3,
    optimizers: Mapping[str, BaseEstimator] | str | None = None,
    heldout: float = 0.3,
    free_run: int = 500,
    time_limit: float = 10.0,
    coordinates: str = "relative",
) -> pd.DataFrame:
    """Fit plain SINDy and this package to a part of a record, judge them on the rest.

    Parameters
    ----------
    X : array-like of shape (n_samples, 3 n_dof), DataFrame or Record
        As for :meth:`NRFRegressor.fit`: one contiguous record, base at rest.
    F : array-like of shape (n_samples, n_dof)
        Applied forces, N.
    dt : float
        Sampling step, s; not needed with a Record or a time index.
    truth : ChainModel, optional
        The structure, if it is known (a simulation): gives ``precision``, ``recall``,
        ``mass_error`` and ``restoring_force_error``.
    degree : int
        Of the power series everywhere.
    optimizers : mapping of str to PySINDy optimizer, or "select", optional
        Rows of this package in addition to least squares; ``"select"`` has one with the
        terms that :func:`~pysindy_nrf.selection.select_sparsity` leaves, chosen within
        the first part of the record. STLSQ at PySINDy's default threshold (a tenth of
        each balance's force) and at a hundredth if None.
    heldout : float
        Share of the record at its end on which all errors are measured.
    free_run : int
        Most samples of the free run; PySINDy takes 2 to 30 ms for each.
    time_limit : float
        Seconds after which a free run through PySINDy is given up.
    coordinates : {"relative", "absolute"}
        See :class:`NRFRegressor`.

    Returns
    -------
    DataFrame
        One row for each model:

        * ``SINDy, defaults``: state [x, xdot], u = F, ``PolynomialLibrary(degree)``,
          default STLSQ;
        * ``SINDy, normalised``: the same with ``normalize_columns=True``;
        * ``SINDy, hand-steered``: the accelerations alone from terms of each storey by
          itself and the forces that act, columns and targets of norm one, threshold
          0.01, ridge 1e-8;
        * ``SINDy, storey shears``: SINDy at its best,
          :class:`~pysindy_nrf.sindy.ShearSINDy`: the forces above each storey from the
          accelerations above it and the terms of that storey alone;
        * ``pysindy_nrf, ...``: least squares, instrumental variables and the optimizers
          given.

        Columns; NaN where a number cannot be known:

        * ``terms``: how many were found. Each counts once, in however many
          accelerations it stands; rows that say that the rate of a position is a
          velocity do not count.
        * ``precision``, ``recall``: shares of the true terms in the library of the
          model.
        * ``mass_error``: the largest, percent.
        * ``restoring_force_error``: pooled percent NRMSE of one step, where SINDy is
          given the masses.
        * ``force_error_own_masses``: the same where SINDy finds them as 1/m; NaN where
          a DOF is not forced.
        * ``balance_error``: pooled percent NRMSE of one step.
        * ``free_run_error``: percent NRMSE of the displacements, inf if it diverges.
        * ``third_law_gap``: largest disagreement of the two estimates of a storey,
          percent; ``storeys_found`` says whether there are two: ``"once"`` or
          ``"twice"``.
        * ``seconds`` of the fit, choosing included, and a ``note``.

        ``attrs["storey_forces"]`` has the storey forces (N) that each model finds on
        the rest of the record, by its name, and the true ones.

    Raises
    ------
    ChannelError
        If the record has several parts or no sampling step.
    NRFError
        If ``optimizers`` is another word.

    Notes
    -----
    SINDy of accelerations finds no forces. To give it a restoring force, and balance
    errors in N, it is handed the masses: the true ones, or those of this package's
    least squares. SINDy of storey shears has its own. All rows see the same measured
    accelerations.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, excitation, laws, simulate
    >>> from pysindy_nrf.sindy import compare_with_sindy
    >>> truth = ChainModel(
    ...     [10.0, 10.0], {i: laws.PowerSeries(1, [100.0, 1e5]) for i in (1, 2)}
    ... )
    >>> F = excitation.band_limited_random(
    ...     2,
    ...     1.0,
    ...     1000.0,
    ...     excited=[1, 2],
    ...     rms=50.0,
    ...     band=(1, 60),
    ...     random_state=0,
    ... )
    >>> table = compare_with_sindy(
    ...     simulate(truth, F, 1e-3), truth=truth, free_run=2
    ... )
    >>> bool(
    ...     table.loc["pysindy_nrf, STLSQ", "terms"]
    ...     < table.loc["SINDy, normalised", "terms"]
    ... )
    True
    """
    if not 0 < heldout < 1:
        what = f"heldout={heldout!r} is not a share"
        raise ChannelError(what, "Give a number between 0 and 1.")
    record = _single_record(X, F, dt, coordinates)
    cut = round(record.n_samples * (1 - heldout))
    search, rest = record.take(slice(0, cut)), record.take(slice(cut, None))
    models = _models(degree, optimizers)

    with warnings.catch_warnings(action="ignore"):
        model = truth
        if truth is None:
            model = NRFRegressor(degree, estimation="ls", dt=search.dt)
            model = model.fit(search.X, search.F).model_
        assert isinstance(model, ChainModel)
        forces = model.restoring_force(record.X, dt=record.dt)[cut:]
        course = _Comparison(
            search, rest, _Reference(model, truth is not None, forces), time_limit
        )
        rows = {}
        storey_forces = _StoreyForces()
        if truth is not None:
            storey_forces["truth"] = forces
        for name, compared in models.items():
            rows[name], forces_found = course.row(compared, free_run)
            if forces_found is not None:
                storey_forces[name] = forces_found

    index = pd.Index(rows, name="model")
    table = pd.DataFrame(list(rows.values()), index, COLUMNS)
    table.attrs["storey_forces"] = storey_forces
    return table


def other_models(table: pd.DataFrame, name: str) -> tuple[OtherModel, ...]:
    """Plain SINDy compared with a row of this package, as facts for a verdict.

    Parameters
    ----------
    table : DataFrame
        Of :func:`compare_with_sindy`.
    name : str
        A row of this package.
    """
    of_this = float(table.loc[name, "free_run_error"])
    others = []
    for other, error in table["free_run_error"].items():
        if str(other).startswith("SINDy"):
            others.append(OtherModel(str(other), float(error), of_this))
    return tuple(others)


def _models(
    degree: int, optimizers: Mapping[str, BaseEstimator] | str | None
) -> dict[str, ComparedModel]:
    """The models of the table by name."""
    models: dict[str, ComparedModel] = {
        "SINDy, defaults": PlainSINDy(degree, normalise=False),
        "SINDy, normalised": PlainSINDy(degree),
        "SINDy, hand-steered": ExpertSINDy(degree),
        "SINDy, storey shears": Shears(degree),
        "pysindy_nrf, least squares": Regressor(NRFRegressor(degree, estimation="ls")),
        JUDGED: Regressor(NRFRegressor(degree, estimation="iv")),
    }
    if isinstance(optimizers, str):
        if optimizers != "select":
            what = f"optimizers={optimizers!r} is unknown"
            raise NRFError(what, "Give 'select', or optimizers by name.")
        models["pysindy_nrf, terms selected"] = SelectedTerms(NRFRegressor(degree))
        return models

    if optimizers is None:
        optimizers = {
            "STLSQ": ps.STLSQ(),
            "STLSQ, threshold 0.01": ps.STLSQ(threshold=0.01),
        }
    for name, optimizer in optimizers.items():
        estimator = NRFRegressor(degree, optimizer=optimizer, estimation="ls")
        models[f"pysindy_nrf, {name}"] = Regressor(estimator)
    return models


def _single_record(
    X: object, F: ArrayLike | None, dt: float | None, coordinates: str
) -> RecordPart:
    """The one contiguous record of some data, or an error."""
    data = from_arrays(X, F, coordinates=coordinates, dt=dt)
    segment = data.segments[0]
    if len(data.segments) != 1 or segment.ag is not None:
        what = "The comparison takes one contiguous record on a base at rest"
        raise ChannelError(what, "Choose one record.")
    if segment.dt is None:
        raise ChannelError("The comparison needs the sampling step", "Pass dt= in s.")

    rows = segment.valid
    forces = segment.F[rows].astype(float)
    if np.isnan(forces).any():
        cure = "SINDy needs every force: give zeros where none acts."
        raise ChannelError("A force is unknown", cure)
    return RecordPart(
        a=segment.a[rows].astype(float),
        v=segment.v[rows].astype(float),
        s=segment.s[rows].astype(float),
        F=forces,
        dt=segment.dt,
    )


class _StoreyForces(dict[str, np.ndarray]):
    """Storey forces by model.

    pandas compares what tables carry when they are joined: these are equal to
    themselves alone.
    """

    __eq__ = object.__eq__
    __hash__ = object.__hash__  # type: ignore[assignment]


@dataclass(frozen=True)
class _Reference:
    """What every model is judged by.

    Attributes
    ----------
    model : ChainModel
        The truth, or this package's least squares; SINDy is handed its masses.
    known : bool
        Whether it is the truth.
    storey_forces : ndarray of shape (n_samples, n_dof)
        On the held-out part, N.
    """

    model: ChainModel
    known: bool
    storey_forces: np.ndarray

    @property
    def rms(self) -> np.ndarray:
        """Rms of the storey forces, N."""
        return np.sqrt(np.mean(self.storey_forces**2, axis=0))

    def force_error(self, forces: np.ndarray) -> float:
        """Error of storey forces, percent."""
        gap = np.sqrt(np.mean((forces - self.storey_forces) ** 2, axis=0))
        return float(100 * np.sqrt(np.mean((gap / self.rms) ** 2)))

    def mass_error(self, masses: np.ndarray) -> float:
        """Largest error of the masses, percent."""
        return float(np.max(np.abs(100 * (masses / self.model.masses - 1))))

    def balance_error(
        self, masses: np.ndarray, accelerations: np.ndarray, rest: RecordPart
    ) -> float:
        """Pooled error of the equations of motion, percent."""
        residual = masses * (accelerations - rest.a)
        inertia = masses * rest.a
        sizes = []
        for j in range(rest.n_dof):
            force = _rms(rest.F[:, j])
            reference = force or _rms(inertia[:, j])
            kind = "F" if force else "m a"
            size = self.rms[j]
            sizes.append(
                Sizes(_rms(residual[:, j]), reference, size, kind, rest.n_samples)
            )
        return pooled_percent(sizes)


def _rms(signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


@dataclass(frozen=True)
class _Comparison:
    """Models are fitted to one part of a record and judged on the rest."""

    search: RecordPart
    rest: RecordPart
    reference: _Reference
    time_limit: float

    def row(
        self, model: ComparedModel, n_free_run: int
    ) -> tuple[dict[str, float | str], np.ndarray | None]:
        """The row of one model, and the storey forces (N) that it finds."""
        row: dict[str, float | str] = {"storeys_found": "", "note": ""}
        if isinstance(model, PlainSINDy) and model.work(self.search) > MAX_WORK:
            row["note"] = self._too_much(model)
            return row, None

        start = time.perf_counter()
        try:
            model.fit(self.search)
        except NRFError as error:
            row["note"] = f"no fit: {error}"
            return row, None
        row["seconds"] = time.perf_counter() - start
        row["terms"] = model.terms

        masses = model.masses(self.search)
        handed = masses if model.finds_masses else self.reference.model.masses
        accelerations = model.accelerations(self.rest)
        forces = self._storey_forces(handed, accelerations)
        if self.reference.known:
            by_its_masses = self._storey_forces(masses, accelerations)
            row["mass_error"] = self.reference.mass_error(masses)
            row["restoring_force_error"] = self.reference.force_error(forces)
            row["force_error_own_masses"] = self.reference.force_error(by_its_masses)
        if self.reference.known and not self.reference.model.has_memory:
            row["precision"], row["recall"] = model.precision_and_recall(
                self.search, self.reference.model
            )
        row["balance_error"] = self.reference.balance_error(
            handed, accelerations, self.rest
        )
        row["third_law_gap"], row["storeys_found"] = model.third_law(
            self.reference.model.masses
        )
        row["free_run_error"], row["note"] = self._free_run_error(model, n_free_run)
        return row, forces

    def _too_much(self, model: PlainSINDy) -> str:
        """Why a fit is not run."""
        n_columns = model.n_features(self.search)
        n_samples = self.search.n_samples
        gigabytes = 32e-9 * n_columns * (n_samples + n_columns)
        return (
            f"not run: {n_columns} columns of {n_samples} samples take minutes and"
            f" {gigabytes:.1f} GB"
        )

    def _storey_forces(
        self, masses: np.ndarray, accelerations: np.ndarray
    ) -> np.ndarray:
        """Storey forces on the rest of the record: what all equations above leave."""
        unbalanced = self.rest.F - masses * accelerations
        return np.cumsum(unbalanced[:, ::-1], axis=1)[:, ::-1]

    def _free_run_error(
        self, model: ComparedModel, n_samples: int
    ) -> tuple[float, str]:
        """Error of the displacements, percent, and a note."""
        start = self.rest.take(slice(0, max(2, n_samples)))
        try:
            x = model.free_run(start, time.perf_counter() + self.time_limit)
        except TimeoutError:
            return np.nan, f"free run given up after {self.time_limit:g} s"
        except (SimulationError, OverflowError, FloatingPointError):
            return np.inf, "free run diverges"
        if not np.isfinite(x).all():
            return np.inf, "free run diverges"

        errors = [nrmse(start.x[:, j], x[:, j]) for j in range(start.n_dof)]
        return float(np.sqrt(np.mean(np.square(errors)))), ""
