"""Results of a fitted estimator: forces, errors, intervals, modes, free runs."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm
from sklearn.base import clone
from sklearn.utils.validation import check_is_fitted

from ..chain.identifiability import SolveOrder
from ..chain.model import ChainModel
from ..chain.structure import Chain
from ..diagnosis import verdict as verdicts
from ..diagnosis.bias import NEGLIGIBLE, NoiseBias, noise_bias, noise_shares
from ..diagnosis.planning import Diagnosis, diagnose
from ..diagnosis.site_loops import loops_of
from ..equations.errors import explained_accelerations, judge
from ..exceptions import (
    BiasWarning,
    ChannelError,
    DataQualityWarning,
    NRFError,
    NRFWarning,
)
from ..records.channels import require_two_dimensions, sample_weights
from ..records.dataset import Dataset, feature_names
from ..records.input_arrays import from_arrays, holds_records
from ..records.record import Record
from ..report.figures.forces import loop_figures
from ..report.figures.matplotlib_renderer import Drawing
from ..report.figures.motion import free_run_figure
from ..simulation.api import simulate
from . import intervals
from .problem import Estimate, Problem, blocks_of, flexible_laws

# Percent of the balances, pooled, that 16 bits of a range ten times the rms leave;
# below, the rest is arithmetic and interpolation, which no further sample averages out.
EXACT = 0.01
CURE = "Give the Records themselves, with estimation='auto' or 'iv'."


class FittedChain:
    """Methods of a fitted :class:`~pysindy_nrf.NRFRegressor`."""

    model_: ChainModel
    chain_: Chain
    solve_order_: SolveOrder
    problem_: Problem
    masses_: np.ndarray
    errors_: pd.DataFrame
    missing_terms_: pd.DataFrame
    jump_bias_: pd.DataFrame
    condition_: dict[str, float]
    data_warnings_: dict[str, list[str]]
    n_samples_: int
    band: tuple[float | None, float | None] | None
    coordinates: str
    dt: float | None
    _resolver: intervals.Resolver | None
    _measured = False  # whether they were records
    _records: Dataset | None = (
        None  # data of the fit; None after a fit in chunks or a load
    )
    _fused_separately: Callable[[], Dataset] | None = (
        None  # the motions fused DOF by DOF, if records were given
    )
    _separate_resolver: intervals.Resolver | None = None
    _fused_jointly: bool = False  # True if X was fused jointly over the DOFs
    _given: Any = None  # the records of the fit, if records were given
    _free: verdicts.FreeRuns | None = None
    _verdict: verdicts.Verdict | None = None

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
        if self._records is None:
            raise ChannelError(
                "The model was loaded without the data it was fitted to", cure
            )
        return self._records

    def _data(self, X: Any, y: Any, **options: Any) -> Dataset:
        return from_arrays(X, y, coordinates=self.coordinates, dt=self.dt, **options)

    def predict(
        self,
        X: Any,
        *,
        record: Any = None,
        time: Any = None,
        base_acceleration: Any = None,
        covariates: Mapping[str, Any] | None = None,
    ) -> np.ndarray:
        """Forces on the DOFs that the measured motion implies (left-hand sides of the
        balances), for data as in :meth:`fit`.

        Returns
        -------
        ndarray of shape (n_samples, n_dof)
            N; NaN at masked edges. Of shape (n_samples,) if ``fit`` got forces of this
            shape.
        """
        given = dict(
            record=record,
            time=time,
            base_acceleration=base_acceleration,
            covariates=covariates,
        )
        data = self._judged(X, None, every_row=True, **given)
        out = data.scatter(self.model_.balance_forces(data))
        return out[:, 0] if getattr(self, "_one_force", False) else out

    def restoring_force(self, X: Any, **given: Any) -> np.ndarray:
        """Storey forces along data, given as for :meth:`fit`.

        Parameters
        ----------
        **given
            Record, time, base_acceleration and covariates.

        Returns
        -------
        ndarray of shape (n_samples, n_dof)
            Force of storey j in column j-1, N.
        """
        return self.model_.restoring_force(
            self._judged(X, None, every_row=True, **given)
        )

    def score(
        self,
        X: Any,
        y: Any = None,
        sample_weight: Any = None,
        *,
        record: Any = None,
        time: Any = None,
        base_acceleration: Any = None,
        covariates: Mapping[str, Any] | None = None,
    ) -> float:
        """R^2 of the accelerations the model predicts, variance-weighted over the DOFs,
        on data as for :meth:`fit`.

        It is comparable under any excitation; ``scoring="r2"`` of scikit-learn uses the
        forces, which are zero on unforced DOFs.

        Parameters
        ----------
        sample_weight : array-like of shape (n_samples,), optional
            Weights of the samples; equal if None.
        """
        given = dict(
            record=record,
            time=time,
            base_acceleration=base_acceleration,
            covariates=covariates,
        )
        data = self._judged(X, y, **given)
        weights = sample_weights(sample_weight, data.n_samples)
        judged = []
        for seg, part, filter in zip(
            data.segments, self.model_.balance_forces(data), self.problem_.filters(data)
        ):
            a, gap = (
                seg.a[seg.valid].astype(float),
                (seg.F[seg.valid] - part) / self.masses_,
            )
            a, gap = (
                (a, gap) if filter is None else (filter.apply(a), filter.apply(gap))
            )
            judged.append((a, gap, weights[seg.rows][seg.valid]))
        return explained_accelerations(judged)

    def balance_errors(self, X: Any, y: Any = None, **given: Any) -> pd.DataFrame:
        """Balance errors (one step) in the same band on other data, as for :meth:`fit`
        and :meth:`restoring_force`.

        Returns
        -------
        DataFrame
            Percent NRMSE, one row for each balance; as ``errors_``.
        """
        data = self._judged(X, y, **given)
        layout, filters = self.problem_.layout, self.problem_.filters(data)
        return judge(
            self.model_,
            layout,
            self.solve_order_,
            lambda: blocks_of(data, filters, layout),
        )

    def modes(self) -> pd.DataFrame:
        """Frequencies (Hz), damping ratios and shapes of the linear part; see
        :meth:`ChainModel.modes`.
        """
        check_is_fitted(self)
        return self.model_.modes()

    def confidence_intervals(
        self,
        level: float = 0.95,
        *,
        of: Any = "parameters",
        calibration: Mapping[str, float] | None = None,
    ) -> pd.DataFrame:
        """Confidence intervals of masses and coefficients, or of anything that follows
        from the model.

        The whole chain is solved again without each of some 64 consecutive pieces of
        the data (jackknife, neighbours correlated: Newey and West), so an error in one
        storey reaches every mass below it. Shape parameters and the choice of terms are
        taken as known: the error of a wrong law is not in the interval (see
        ``missing_terms_``). For a least-squares fit to Records the motions are fused
        DOF by DOF, because the remaining noise of a joint fusion is correlated over the
        whole record. Compute intervals before pickling, which leaves the data behind.

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
            masses are left out. NaN with a BiasWarning where noise may bias least
            squares by half a standard error or more, or another chain fits as well;
            arrays show white noise only, with a clock: smoothed ones, or without a
            clock, count as free of it.

        Raises
        ------
        ChannelError
            If the model has no data, they are too few pieces, or ``calibration`` is no
            table of tolerances.
        """
        check_is_fitted(self)
        resolver, data = self._interval_resolver(), self._records
        table = intervals.parameter_intervals(resolver, self.model_, level, of, data)
        if calibration is None:
            return table
        if isinstance(of, Mapping):
            raise ChannelError(
                "calibration does not go with a mapping of sites",
                "Give of= a function of the model.",
            )
        data = self.fit_data("Fit again, or ask for intervals before saving.")
        statistic = intervals.statistic_of(
            of, resolver.known_masses, resolver.pieces.layout, data
        )
        spread = intervals.calibration_spread(
            self.problem_, self.solve_order_, data, statistic, calibration
        )
        for end, sign in (("lower", -1), ("upper", 1)):
            half = np.hypot(
                table[end] - table["estimate"], norm.ppf((1 + level) / 2) * spread
            )
            table[f"combined_{end}"] = table["estimate"] + sign * half
        return table

    def force_intervals(
        self, site: Any, v: Any, s: Any, level: float = 0.95
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
        return intervals.force_intervals(
            self._interval_resolver(), self.model_, site, v, s, level
        )

    def diagnose(self) -> Diagnosis:
        """Diagnose what limits the estimate; see
        :func:`pysindy_nrf.diagnosis.planning.diagnose`.
        """
        check_is_fitted(self)
        return diagnose(self)

    def verdict(self) -> verdicts.Verdict:
        """Whether the model may be used, what it holds, and why not; see
        :mod:`pysindy_nrf.diagnosis.verdict`.

        Reads the balances, the intervals, the warnings of the fit and a free run over
        the data of the fit. Where a balance does not close, the fit is repeated with
        other mappings of the channels, and the one that closes named.
        """
        check_is_fitted(self)
        if self._verdict is not None:
            return self._verdict
        bounds, doubts = self.bounds()
        missing = self.missing_terms_[self.missing_terms_["biased"].astype(bool)]
        doubts = [
            text for held in self.data_warnings_.values() for text in held
        ] + doubts
        doubts += [
            f"{name[0].upper()}{name[1:]}: a law is missing, or the motion is noisy."
            for name in missing.index
        ]
        free, shares = None, {}
        if self._records is not None:
            free, shares = (
                self.free_runs(),
                verdicts.shares_of(self.model_, self._records),
            )
        errors = self.errors_["error"].drop("pooled")
        found = list(verdicts.nonlinear_parts(self.model_, shares, bounds).values())
        self._verdict = verdicts.verdict_on(
            self.model_,
            {int(k[4:]): float(e) for k, e in errors.items()},
            found,
            free,
            bounds,
            known_masses=self.problem_.known_masses,
            doubts=doubts,
            faults=verdicts.suspect_channels(self._given or []),
            wiring=self._wiring,
        )
        return self._verdict

    def free_runs(self) -> verdicts.FreeRuns:
        """Free runs of the model over the data of the fit, in the band of the fit.

        Returns
        -------
        FreeRuns
            ``.error``, ``.table``, ``.runs``, ``.why_not``.
        """
        if self._free is None:
            data = self.fit_data("Fit again to run the model over its data.")
            dt = self.dt if any(seg.dt is None for seg in data.segments) else None
            self._free = verdicts.free_runs(
                self.model_, data, self.problem_.filters(data), dt=dt
            )
        return self._free

    def summary(self) -> str:
        """The verdict with its reasons, the masses and the equations, as text."""
        return f"{self.verdict()}\n{self.model_}"

    def print(self) -> None:
        """Print :meth:`summary`."""
        print(self.summary())

    def equations(self, digits: int = 4) -> list[str]:
        """The restoring forces as text; see :meth:`ChainModel.equations`."""
        check_is_fitted(self)
        return self.model_.equations(digits)

    def to_latex(self) -> str:
        """Balances and restoring forces as LaTeX; see :meth:`ChainModel.to_latex`."""
        check_is_fitted(self)
        return self.model_.to_latex()

    def plot(self, ax: Any = None) -> Any:
        """Draw the force of every site over its drift, and the free run over the
        measured motion (matplotlib).

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
        figures = loop_figures(self.model_, loops) + free_run_figure(self.free_runs())
        return Drawing(figures).plot(ax)

    def bounds(self) -> tuple[dict[str, tuple[float, float]], list[str]]:
        """95 % intervals by parameter, and why there are none."""
        try:
            with warnings.catch_warnings(action="ignore", category=NRFWarning):
                warnings.simplefilter("error", BiasWarning)
                table = self.confidence_intervals()
        except BiasWarning as withheld:
            return {}, [str(withheld)]
        except NRFError as error:
            return {}, [f"No intervals: {error}"]
        return {
            str(r.parameter): (float(r.lower), float(r.upper))
            for r in table.itertuples()
        }, []

    def _wiring(self) -> str:
        """The mapping of channels that closes the balances, in words."""
        given = self._given
        if given is None and self._records is not None:
            given = [
                Record(
                    seg.F[seg.valid],
                    seg.a[seg.valid],
                    np.cumsum(seg.v[seg.valid], axis=1),
                    np.cumsum(seg.s[seg.valid], axis=1),
                    1.0 / (seg.dt or self.dt or 1.0),
                    name=seg.name,
                    base_acceleration=None if seg.ag is None else seg.ag[seg.valid],
                )
                for seg in self._records.segments
            ]
        return (
            ""
            if given is None
            else wiring_of(self, self.problem_, self.model_, list(given))
        )

    def simulate(
        self,
        F: Any,
        *,
        dt: float | None = None,
        x0: Any = None,
        v0: Any = None,
        **options: Any,
    ) -> Record:
        """Free run of the identified model; parameters as of
        :func:`pysindy_nrf.simulate`.

        Parameters
        ----------
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
        return simulate(self.model_, F, step, x0=x0, v0=v0, **options)

    def _judged(self, X: Any, y: Any, **given: Any) -> Dataset:
        check_is_fitted(self)
        if not (hasattr(X, "columns") or isinstance(X, Record) or holds_records(X)):
            require_two_dimensions(X)
            width = (
                np.shape(np.asarray(X))[-1]
                if not hasattr(X, "nnz")
                else 3 * self.model_.n_dof
            )
            if np.ndim(np.asarray(X)) == 2 and width != 3 * self.model_.n_dof:
                raise ChannelError(
                    f"X has {width} features, but {type(self).__name__} is expecting"
                    f" {3 * self.model_.n_dof} features as input;"
                    f" {3 * self.model_.n_dof} columns are needed",
                    "Give"
                    f" {', '.join(feature_names(self.model_.n_dof, self.coordinates)[:9])}.",
                )
        return self._data(
            X, y, has_memory=self.model_.has_memory, n_dof=self.model_.n_dof, **given
        )

    def _resolving(self) -> intervals.Resolver:
        """Resolver of the chain on parts of the data, made at the first use."""
        if self._resolver is None:
            data = self.fit_data("Fit again, or ask for intervals before saving.")
            self._resolver = intervals.least_squares_resolver(
                self.problem_, self.solve_order_, data
            )
        return self._resolver

    def _interval_resolver(self) -> intervals.Resolver:
        """Resolver for intervals, on motions whose errors are independent between
        pieces.
        """
        if self._fused_jointly:
            warnings.warn(
                "The motions in X were fused jointly over the DOFs; their remaining"
                " noise is correlated over the whole record, so the intervals are up to"
                " three times too narrow. Give the records themselves, or make X with"
                " record.to_features(smooth=KinematicSmoother(joint=False)).",
                DataQualityWarning,
                stacklevel=3,
            )
        resolver = self._resolving()
        resolver.withheld = self._withheld()
        if self.errors_.loc["pooled", "error"] < EXACT:
            resolver.repeats = self.n_samples_
        if self._fused_separately is None or resolver.withheld:
            return resolver
        if self._separate_resolver is None:
            apart = self._fused_separately()
            self._separate_resolver = intervals.least_squares_resolver(
                self.problem_, self.solve_order_, apart
            )
            self._separate_resolver.constrain, self._separate_resolver.repeats = (
                resolver.constrain,
                resolver.repeats,
            )
        return self._separate_resolver

    def _noise_bias(self) -> list[NoiseBias]:
        """What noise in the motion does to least squares, by balance; empty for other
        estimates, or without data.
        """
        if self.model_.info["estimation"]["found"] != "ls" or self._records is None:
            return []
        shares = noise_shares(self._records, self.problem_.filters(self._records))
        return noise_bias(
            self.model_, self.solve_order_, self._resolving().pieces.sum(), shares
        )

    def _withheld(self) -> str:
        """Why these data give no valid interval; empty if noise does not bias least
        squares and no chain is as good.
        """
        bias = max((one.errors for one in self._noise_bias()), default=0.0)
        if bias <= NEGLIGIBLE:
            return " ".join(self.model_.info["estimation"].get("doubts", ()))
        return (
            f"noise in the motion may bias least squares by {bias:.2g} standard errors;"
            f" up to {NEGLIGIBLE:g} leave 95 % intervals valid."
            f" {' '.join(self.model_.info['estimation'].get('notes', ())) or CURE}"
        )


def wiring_of(
    estimator: Any, problem: Problem, model: ChainModel, records: list[Record]
) -> str:
    """The error of wiring without which the balances close, in words, whatever law the
    storeys have.

    A chain wired wrongly does not close with any law; a law that is missing is no error
    of wiring.
    """
    # the rms of a drift about a third of its peak, as of Gaussian motion
    drifts = {
        site: max(abs(box.low[1]), abs(box.high[1])) / 3
        for site, box in model.visited.items()
    }
    again = clone(estimator).set_params(
        estimation="ls",
        constraints=None,
        optimizer=None,
        orders=None,
        chain=problem.chain,
        laws=flexible_laws(problem, drifts),
    )

    asked = again.problem(problem.chain.n_dof)
    options = {
        "n_dof": problem.chain.n_dof,
        "has_memory": asked.layout.has_memory,
        "check": False,
    }

    def coarse(some: list[Record]) -> Estimate:
        """An estimate from channels as they are; rates that were not measured are
        differences.
        """
        pairs = (
            (
                one,
                (
                    {}
                    if one.velocity is not None or one.displacement is None
                    else {
                        "velocity": np.gradient(one.displacement, 1.0 / one.fs, axis=0)
                    }
                ),
            )
            for one in some
        )
        return asked.solve(
            from_arrays(
                [one.replace(**rates) for one, rates in pairs],
                smooth=False,
                check=False,
            )
        )

    def solved(some: list[Record]) -> Estimate:
        return asked.solve(again._data(some, None, **options))

    return verdicts.mapping_that_closes(
        records, solved, coarse, estimator.known_masses or ()
    )
