"""What a fitted regressor gives: forces, errors, intervals, free runs, the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_is_fitted

from ..chain.model import ChainModel
from ..common.warn import warn_user
from ..diagnosis.free_run import FreeRuns
from ..diagnosis.limits import Diagnosis, diagnose
from ..diagnosis.rules import BEYOND_NUMBERS, GOOD_RUN
from ..diagnosis.site_loops import loops_of
from ..diagnosis.verdict import Verdict
from ..drawing.matplotlib_renderer import Drawing
from ..equations.errors import explained_accelerations, judge
from ..exceptions import ChannelError, SensitivityWarning
from ..records.channels import require_two_dimensions, sample_weights
from ..records.dataset import Dataset, feature_names
from ..records.input_arrays import Input, InputSettings, as_dataset, records_in
from ..records.named_columns import forces_by_name
from ..records.record import Record
from ..report.figures.forces import loop_figures
from ..report.figures.motion import free_run_figures
from ..report.summary import Summary
from ..simulation.api import simulate
from .intervals import AskedFor
from .problem import Problem, blocks_of
from .result import IdentificationResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class FittedChain:
    """Methods of a fitted :class:`~pysindy_nrf.NRFRegressor`."""

    result_: IdentificationResult
    model_: ChainModel
    problem_: Problem
    errors_: pd.DataFrame
    missing_terms_: pd.DataFrame
    jump_bias_: pd.DataFrame
    condition_: pd.Series
    data_warnings_: dict[str, list[str]]
    coordinates: str
    dt: float | None
    _one_force: bool = False

    def fit_data(self, cure: str) -> Dataset:
        """Data of the fit.

        Parameters
        ----------
        cure : str
            Remedy in the error if the data are not available.

        Raises
        ------
        ChannelError
            If the model was fitted in chunks, or loaded without the data.
        """
        check_is_fitted(self)
        return self.result_.require_data(cure)

    # -- other data ------------------------------------------------------------------

    def predict(
        self,
        X: object,
        *,
        record: ArrayLike | None = None,
        time: ArrayLike | None = None,
        base_acceleration: ArrayLike | None = None,
        covariates: Mapping[str, ArrayLike] | None = None,
    ) -> np.ndarray:
        """Forces that the measured motion implies, for data as in :meth:`fit`.

        They are the left-hand sides of the balances.

        Returns
        -------
        ndarray of shape (n_samples, n_dof)
            N; NaN at masked edges. Of shape (n_samples,) if ``fit`` got forces of this
            shape.
        """
        data = self.dataset(
            X,
            record=record,
            time=time,
            base_acceleration=base_acceleration,
            covariates=covariates,
            every_row=True,
        )
        forces = data.scatter(self.model_.balance_forces(data))
        return forces[:, 0] if self._one_force else forces

    def restoring_force(self, X: object, **beside: ArrayLike) -> np.ndarray:
        """Storey forces along data, as for :meth:`fit`.

        Parameters
        ----------
        **beside
            Record, time, base_acceleration and covariates.

        Returns
        -------
        ndarray of shape (n_samples, n_dof)
            Force of storey j in column j-1, N.
        """
        data = self.dataset(X, every_row=True, **beside)
        return self.model_.restoring_force(data)

    def score(
        self,
        X: object,
        y: object = None,
        sample_weight: ArrayLike | None = None,
        *,
        record: ArrayLike | None = None,
        time: ArrayLike | None = None,
        base_acceleration: ArrayLike | None = None,
        covariates: Mapping[str, ArrayLike] | None = None,
    ) -> float:
        """R^2 of the accelerations of the model, for data as in :meth:`fit`.

        It is weighted by the variances of the DOFs, and comparable under any
        excitation; ``scoring="r2"`` of scikit-learn uses the forces, which are zero on
        unforced DOFs. R^2 is a share of squares: 0.99 is a balance that misses 10 % of
        its inertia. :meth:`balance_errors` and ``scorers.balance`` say that in percent
        of the force.

        Parameters
        ----------
        sample_weight : array-like of shape (n_samples,), optional
            Weights of the samples; equal if None.
        """
        data = self.dataset(
            X,
            y,
            record=record,
            time=time,
            base_acceleration=base_acceleration,
            covariates=covariates,
        )
        weights = sample_weights(sample_weight, data.n_samples)
        filters = self.result_.problem.filters(data)
        left_hand_sides = self.model_.balance_forces(data)

        parts = []
        for segment, force, band_pass in zip(data.segments, left_hand_sides, filters):
            rows = segment.valid
            acceleration = segment.a[rows].astype(float)
            missed = (segment.F[rows] - force) / self.model_.masses
            if band_pass is not None:
                acceleration = band_pass.apply(acceleration)
                missed = band_pass.apply(missed)
            parts.append((acceleration, missed, weights[segment.rows][rows]))
        return explained_accelerations(parts)

    def balance_errors(
        self,
        X: object,
        y: object = None,
        **beside: ArrayLike | Mapping[str, ArrayLike] | None,
    ) -> pd.DataFrame:
        """Balance errors on data as in :meth:`fit` and :meth:`restoring_force`.

        They are those of one step, in the band of the fit.

        Returns
        -------
        DataFrame
            Percent NRMSE, one row for each balance; as ``errors_``.
        """
        data = self.dataset(X, y, every_row=False, **beside)
        problem = self.result_.problem
        layout = problem.layout
        filters = problem.filters(data)
        return judge(
            self.model_,
            layout,
            self.result_.order,
            lambda: blocks_of(data, filters, layout),
        )

    def dataset(
        self,
        X: object,
        y: object = None,
        *,
        every_row: bool = False,
        **beside: ArrayLike | Mapping[str, ArrayLike] | None,
    ) -> Dataset:
        """Other data, read as those of the fit.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 n_dof), DataFrame, Record or list of them
            Motions, or records, as in :meth:`fit`.
        y : array-like of shape (n_samples, n_dof), optional
            Forces, N.
        every_row : bool
            Keep the short pieces between gaps of the clock that a fit leaves out.
        **beside
            Record, time, base_acceleration and covariates, as in :meth:`fit`.

        Returns
        -------
        Dataset
            One motion for each record.
        """
        check_is_fitted(self)
        if not hasattr(X, "columns") and records_in(X) is None:
            self._require_width(X)
        settings = replace(
            self._input_settings(X),
            n_dof=self.model_.n_dof,
            has_memory=self.model_.has_memory,
            every_row=every_row,
        )
        return as_dataset(Input(X, y, **beside), settings)

    def _input_settings(self, X: object) -> InputSettings:
        """How data are read; the estimator has its own way."""
        return InputSettings(coordinates=self.coordinates, dt=self.dt)

    def _require_width(self, X: object) -> None:
        """Refuse an array with another number of columns, in scikit-learn's words."""
        if isinstance(X, Dataset):
            return
        require_two_dimensions(X)
        needed = 3 * self.model_.n_dof
        shape = np.shape(cast(ArrayLike, X))
        is_sparse = hasattr(X, "nnz")
        if is_sparse or len(shape) != 2 or shape[-1] == needed:
            return
        names = feature_names(self.model_.n_dof, self.coordinates)
        raise ChannelError(
            f"X has {shape[-1]} features, but {type(self).__name__} is expecting"
            f" {needed} features as input; {needed} columns are needed",
            f"Give {', '.join(names[:9])}.",
        )

    # -- intervals and diagnosis -----------------------------------------------------

    def confidence_intervals(
        self,
        level: float = 0.95,
        *,
        of: AskedFor = "parameters",
        calibration: Mapping[str, float] | None = None,
    ) -> pd.DataFrame:
        """Intervals of masses and coefficients, or of what follows from the model.

        The entire chain is solved again without each of some 64 consecutive pieces of
        the data (jackknife, neighbours correlated: Newey and West), so an error in one
        storey reaches every mass below it. Shape parameters and the choice of terms are
        taken as known: the error of a wrong law is not in the interval (see
        ``missing_terms_``). For a least-squares fit to Records the motions are fused
        DOF by DOF, because the remaining noise of a joint fusion is correlated over the
        entire record. Compute intervals before pickling, which leaves the data behind.

        Parameters
        ----------
        level : float
        of : {"parameters", "masses", "coefficients", "modes", "energies"}, mapping or
        callable
            ``"energies"``: dissipated by every storey along the data of the fit, J. A
            mapping of site to points, ``{"storey 2": (v, s)}``, gives forces there. A
            callable takes a ChainModel and returns a Series.
        calibration : mapping, optional
            Tolerances of every channel by itself, ``{"gain": 0.01, "cross_axis": 0.0,
            "delay": 0.0}`` where they are not given (shares, and s). Columns
            ``combined_lower``, ``combined_upper`` then hold them, too (GUM: type A and
            B); not for a mapping of sites.

        Returns
        -------
        DataFrame
            Columns ``parameter``, ``estimate``, ``lower``, ``upper``; SI units. Known
            masses are left out. Where another structure or channel fits as well the
            interval holds what it makes of the value, or is NaN with a BiasWarning if
            that is more than a tenth (a hundredth where it fits better). NaN, too,
            where noise may bias least squares by half a standard error or more;
            arrays show white noise only, with a clock: smoothed ones, or without a
            clock, count as free of it.

        Raises
        ------
        ChannelError
            If the model has no data, they are too few pieces, or ``calibration`` is no
            table of tolerances.
        """
        check_is_fitted(self)
        return self.result_.confidence_intervals(level, of=of, calibration=calibration)

    def force_intervals(
        self, site: str | int, v: ArrayLike, s: ArrayLike, level: float = 0.95
    ) -> pd.DataFrame:
        """Restoring force of a site at points (v, s) with its interval.

        Outside the region that the data visited an ExtrapolationWarning is raised and
        the interval widened.

        Parameters
        ----------
        site : str or int
        v, s : array-like
            m/s and m.
        level : float

        Returns
        -------
        DataFrame
            ``v``, ``s``, ``force``, ``lower``, ``upper`` (N), ``visited``.
        """
        check_is_fitted(self)
        return self.result_.force_intervals(site, v, s, level)

    def bounds(self) -> tuple[dict[str, tuple[float, float]], list[str]]:
        """95 % intervals by parameter, and why there are none."""
        check_is_fitted(self)
        return self.result_.bounds

    def diagnose(self) -> Diagnosis:
        """What limits the estimate; see :func:`diagnosis.limits.diagnose`."""
        check_is_fitted(self)
        return diagnose(self)

    def verdict(self) -> Verdict:
        """Whether the model may be used, what it holds, and why not.

        Reads the balances, the intervals, the warnings of the fit and a free run over
        the data of the fit. Where a balance does not close, the fit is repeated with
        other mappings of the channels, and the one that closes named. See
        :mod:`pysindy_nrf.diagnosis.verdict`.
        """
        check_is_fitted(self)
        return self.result_.verdict

    def free_runs(self) -> FreeRuns:
        """Free runs of the model over the data of the fit, in the band of the fit.

        Returns
        -------
        FreeRuns
            ``.error``, ``.table``, ``.runs``, ``.why_not``.
        """
        check_is_fitted(self)
        return self.result_.free_runs

    # -- the model -------------------------------------------------------------------

    def modes(self) -> pd.DataFrame:
        """Modes of the linear part; see :meth:`ChainModel.modes`."""
        check_is_fitted(self)
        return self.model_.modes()

    def equations(self, digits: int = 4) -> list[str]:
        """The restoring forces as text; see :meth:`ChainModel.equations`."""
        check_is_fitted(self)
        return self.model_.equations(digits)

    def to_latex(self) -> str:
        """Balances and restoring forces as LaTeX; see :meth:`ChainModel.to_latex`."""
        check_is_fitted(self)
        return self.model_.to_latex()

    def summary(self) -> Summary:
        """Estimates with errors, intervals, units and shares, and how they were found.

        Returns
        -------
        Summary
            ``str`` prints it as statsmodels does; ``to_frame``, ``as_html``,
            ``as_latex``.
        """
        check_is_fitted(self)
        return self.result_.summary()

    def print(self) -> None:
        """Print the equations, then :meth:`summary`."""
        print(self.model_, self.summary(), sep="\n\n")

    def plot(self, ax: Axes | np.ndarray | None = None) -> Drawing:
        """Draw the force of every site over its drift, and the free run (matplotlib).

        Parameters
        ----------
        ax : array of Axes, optional
            New ones if None.

        Returns
        -------
        Display
            With ``ax_`` and ``figure_``.
        """
        check_is_fitted(self)
        data = self.fit_data("Fit again to draw the model over its data.")
        loops = loops_of(self.model_, data, self.problem_.filters(data))
        free_runs = free_run_figures(self.free_runs())[:1]
        figures = loop_figures(self.model_, loops) + free_runs
        return Drawing(figures).plot(ax)

    def simulate(
        self,
        F: ArrayLike,
        *,
        dt: float | None = None,
        x0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        **options: Any,
    ) -> Record:
        """Free run of the identified model; see :func:`pysindy_nrf.simulate`.

        A nonlinear model runs two more times, with parameters that differ by about one
        standard error. If that moves the run by more than sensors notice, a
        SensitivityWarning says by how much.

        Parameters
        ----------
        F : array-like of shape (n_samples, n_dof) or DataFrame
            N; a table with columns ``F1..`` in any order.
        dt : float, optional
            s; the estimator's ``dt`` if None.
        **options
            ``method``, ``base_acceleration``, ...

        Raises
        ------
        ChannelError
            If neither ``dt`` nor the estimator gives the sampling step.
        """
        check_is_fitted(self)
        step = dt if dt is not None else self.dt
        if step is None:
            raise ChannelError(
                "The free run needs the sampling step of F", "Pass dt= in s."
            )
        if hasattr(F, "columns"):
            F = forces_by_name(F, self.model_.n_dof)

        def run_of(model: ChainModel) -> Record:
            return simulate(model, F, step, x0=x0, v0=v0, **options)

        run = run_of(self.model_)
        spread = self.result_.spread_of_run(run, run_of)
        if spread > GOOD_RUN:
            _warn_of_sensitivity(spread)
        return run


def _warn_of_sensitivity(spread: float) -> None:
    """Say that errors of the parameters move a run by a percentage."""
    size = "beyond numbers"
    if spread < BEYOND_NUMBERS:
        size = f"by {spread:.2g} % of its motion"
    warning = SensitivityWarning(
        "The free run is sensitive: one standard error of the parameters moves it"
        f" {size}",
        "Compare its spectrum or its amplitudes, not its samples; or measure longer,"
        " under forces like these.",
    )
    warn_user(warning, SensitivityWarning)
