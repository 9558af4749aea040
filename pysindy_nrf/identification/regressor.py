"""NRFRegressor, the scikit-learn estimator of the identification."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, RegressorMixin

from ..chain.sites import as_mapping
from ..chain.structure import Chain, chain_of
from ..diagnosis import bias
from ..diagnosis.force_channels import ForceProbes, copies_of
from ..diagnosis.sample_windows import collect
from ..equations.chain_solve import (
    doubtful_masses,
    third_law_gap,
    unknown_forces,
    visited_regions,
)
from ..equations.errors import balance_errors
from ..exceptions import ChainError, ChannelError, DataQualityWarning
from ..laws.forcing import lost_masses
from ..records.channels import (
    column_names,
    require_two_dimensions,
    same_columns,
)
from ..records.dataset import Dataset
from ..records.files.frequency_response import FrequencyResponse
from ..records.input_arrays import lacks_motion, records_in, with_motion_checks
from ..records.record import Record
from .constraints import constrained
from .fewer_sensors import fit_fewer_sensors
from .fitted import FittedChain
from .frequency_response import fit_frequency_response
from .output_error import refine
from .problem import (
    DEFAULT_DEGREE,
    LEAST_SQUARES,
    Estimate,
    Problem,
    law_list,
    laws_of_sites,
    wrong_masses,
)
from .streaming import fit_streamed, is_streamed, partial_fit

if TYPE_CHECKING:
    from sklearn.utils import Tags


_ESTIMATIONS = ("auto", "ls", "iv", "simulation")


def _apart(data: Dataset) -> Dataset:
    with warnings.catch_warnings(
        action="ignore", category=DataQualityWarning
    ):  # the first fusion has warned
        return data.apart


def channel_faults(data: Dataset) -> list[str]:
    """What is wrong with the channels, in sentences."""
    several = len(data.segments) > 1
    return list(
        dict.fromkeys(
            f"Record {note.record!r}: {note.message}" if several else note.message
            for note in data.quality
        )
    )


class NRFRegressor(FittedChain, RegressorMixin, BaseEstimator):
    r"""Masses and nonlinear restoring forces of a chain from forces and motions.

    Least squares of the force balances (paper eqs. 2-5),

    .. math:: m_j a_j + R_j(v_j, s_j) - R_{j+1}(v_{j+1}, s_{j+1}) = F_j ,

    all at once where every DOF is forced, in sequence along the chain where only some
    are (eqs. 4-5).

    Parameters
    ----------
    degree : int or (int, int)
        Total degree h + j of the terms v^h s^j in every storey (eq. 9), or the box (k,
        q) of eq. (2).
    orders : mapping of str to int or (int, int), optional
        Other orders at some storeys, e.g. ``{"storey 2": 5, "storey 3": (2, 1)}``.
    strategy : {"auto", "complete", "sequential", "joint"}
        ``"joint"``: all balances at once with shared laws, each over the residual that
        it leaves by itself; ``"complete"``: each by itself, the paper's way (eq. 3);
        both only where every DOF is forced (in one record or another). ``"auto"``:
        joint there, but complete with an ``optimizer``, which chooses terms balance by
        balance, and where two balances contradict each other; elsewhere sequential.
    optimizer : PySINDy optimizer, optional
        Runs inside :class:`ChainOptimizer` on every balance; plain least squares if
        None.
    coordinates : {"relative", "absolute"}
        X holds inter-storey motion v, s (eq. 8), or motion xdot, x of the DOFs.
    estimation : {"auto", "ls", "iv", "simulation"}
        ``"ls"``: least squares. ``"iv"``: instrumental variables from the model's own
        free run, which noise in the motion does not bias, also of shapes that were
        searched; give records, or motions made with ``KinematicSmoother(joint=False)``.
        ``"auto"``: the first where the noise that fusion measured leaves its bias below
        half a standard error, and of arrays; else the second where it is possible.
        ``"simulation"``: the free run fitted to the motion, started from ``"iv"`` and
        kept where it predicts better. See :mod:`pysindy_nrf.identification`.
    laws : mapping of str to ForceLaw or sequence of ForceLaw, optional
        Laws at some sites, in place of the power series there; further links and ``"dof
        j"`` sites join the chain. Shape parameters without a value are estimated; those
        with one are kept. Coefficients are always estimated, also of laws that were
        given values (to fix one:
        :class:`~pysindy_nrf.identification.constraints.KnownStiffness`).
    known_masses : mapping of int to float, optional
        kg, by DOF. With no force anywhere one known mass scales the chain.
    massless : bool
        An element tested by itself (a damper, a connection), whose force is measured
        and whose inertia is none: all masses are zero. With laws of the drift alone its
        record needs no clock.
    band : (float, float), optional
        Frequency band in Hz in which everything is fitted and judged: accelerations,
        forces and law columns pass one zero-phase filter. Needs the sampling step
        (``dt``, ``time`` or a time index).
    dt : float, optional
        Sampling step, s, if X carries no time.
    chain : Chain, optional
        A chain of one storey for each DOF on the base if None.
    constraints : sequence of constraints, optional
        Prior knowledge of masses and coefficients, e.g. ``[EqualMasses(),
        NonNegative("s")]``; see :mod:`pysindy_nrf.identification.constraints`.

    Attributes
    ----------
    masses_ : ndarray of shape (n_dof,)
        kg.
    restoring_forces_ : RestoringForces
        By site: ``["storey 2"]``, ``[2]``, ``["link 4-2"]``; each callable (v, s) -> N.
    third_law_gap_ : Series
        Where every DOF is forced: rms difference of the two estimates of each storey's
        force from either balance by itself (paper eq. 10b), percent of its rms.
        Complete strategy returns that from the upper end (balance i for storey i), the
        joint one neither.
    errors_ : DataFrame
        Balance errors (one step) on the fitted data, percent NRMSE; see
        :mod:`pysindy_nrf.equations.errors`.
    motions_ : list of DataFrame
        Of records in which some floor has no sensor, one each: motions of all DOFs (a
        absolute, v and x relative to the base), forces of all sites (``"R storey 2"``),
        and the ends of their 95 % intervals. The free run is then fitted to the
        measured channels, and ``errors_`` are its errors there.
    missing_terms_ : DataFrame
        Share of each residual that further terms would explain, step by step; a
        BiasWarning is raised if a law is missing.
    jump_bias_ : DataFrame
        Of least squares: coefficients of forces that jump (friction), with and without
        the samples next to the jumps; a BiasWarning is raised if they differ.
    data_warnings_ : dict of str to list of str
        ``"channels"``: texts of the DataQualityWarning on channels (units, sign, gain,
        delay, clipped, dead). Texts of the BiasWarning: ``"records"``, copies of
        others; ``"forces"``, balances that contradict each other (a force in other
        units, a wrong known mass), a force whose channel is not linear or steady,
        records of unlike structures; ``"masses"``, which are not positive or not
        determined against noise.
    model_ : ChainModel
    problem_ : Problem
        The problem solved: chain, laws with their shape parameters, known masses, band,
        strategy and optimizer.
    chain_ : Chain
    solve_order_ : SolveOrder
        The order of the solve, in words.
    unknown_forces_ : DataFrame
        Forces (N) on the DOFs whose force was NaN, from the balances, over the rows
        passed; a column ``F2`` for each such DOF, NaN where the force was given.
    inner_ : dict of str to PySINDy optimizer
        The fitted ``optimizer`` of each balance; see :class:`ChainOptimizer`.
    condition_ : Series
        Scaled condition number of each step.
    n_samples_ : int
        Samples used, NaN edges left out; the sum of their weights.
    n_features_in_ : int

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> record = (
    ...     datasets.load_demo()
    ... )  # forces, accelerations and displacements of three floors
    >>> NRFRegressor(degree=3).fit(record).masses_.round(1)
    array([12., 10.,  8.])
    >>> model = NRFRegressor(degree=3).fit(
    ...     [record.window(0, 10), record.window(10, 20)]
    ... )  # two tests
    >>> round(
    ...     float(model.restoring_forces_["storey 2"].coefficients["s"]), -3
    ... )  # N/m
    35000.0
    """

    def __init__(
        self,
        degree: Any = DEFAULT_DEGREE,
        orders: Mapping[Any, Any] | None = None,
        strategy: str = "auto",
        optimizer: Any = None,
        coordinates: str = "relative",
        estimation: str = "auto",
        laws: Mapping[Any, Any] | None = None,
        known_masses: Mapping[int, float] | None = None,
        band: tuple[float | None, float | None] | None = None,
        dt: float | None = None,
        chain: Chain | None = None,
        constraints: Any = None,
        massless: bool = False,
    ) -> None:
        self.degree, self.orders, self.strategy, self.optimizer = (
            degree,
            orders,
            strategy,
            optimizer,
        )
        self.coordinates, self.estimation, self.laws, self.known_masses = (
            coordinates,
            estimation,
            laws,
            known_masses,
        )
        self.band, self.dt, self.chain, self.constraints, self.massless = (
            band,
            dt,
            chain,
            constraints,
            massless,
        )

    def fit(
        self,
        X: Any,
        y: Any = None,
        sample_weight: Any = None,
        *,
        record: Any = None,
        time: Any = None,
        base_acceleration: Any = None,
        covariates: Mapping[str, Any] | None = None,
        state: Any = None,
    ) -> NRFRegressor:
        """Identify masses and restoring forces.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 n_dof), DataFrame, Record or list of
        Record
            Columns a_1..a_n (absolute, m/s^2), v_1..v_n (inter-storey, m/s), s_1..s_n
            (m), paper eq. 8; with ``coordinates="absolute"`` xdot and x of the DOFs.
            Files by path (``.npy``, Parquet, HDF5), iterators of tables, and Dask
            arrays, tables and delayed records are read in chunks. What ``io.read_frf``
            returns gives a linear chain; its noise is measured and biases nothing.
        y : array-like of shape (n_samples, n_dof), optional
            The applied forces F_j, N. A column of zeros = known to be unforced, of NaN
            = unknown. None = no force anywhere (base excitation, known masses).
        sample_weight : array-like of shape (n_samples,), optional
            Of least squares, with all samples in memory: a sample of weight two counts
            as two, one of zero as none.
        record : array-like of shape (n_samples,), optional
            Record ids; rows without ids are one contiguous record.
        time : array-like of shape (n_samples,), optional
            s.
        base_acceleration : array-like of shape (n_samples,), optional
            m/s^2, as measured: it is filtered to the band of fused motions
            (``X.attrs["band"]``).
        covariates : mapping of str to array-like of shape (n_samples,), optional
        state : path-like, optional
            File or folder for the state of an interrupted fit from files; the next call
            continues from it.

        Raises
        ------
        ChannelError
            If a channel or its clock cannot be used: missing, not finite inside, of
            another length; it is named.
        ExcitationError
            If nothing scales the chain: no force and no known mass.
        IdentifiabilityError
            If the excitation reaches no balance that can be solved, or the data cannot
            tell the terms apart.
        ChainError
            If a setting is unknown, or a site or DOF not in the chain.
        LawError
            If two laws at a site hold the same term, or a law cannot be used with these
            data.
        FileFormatError
            If a file cannot be read.
        """
        self._stream = None
        beside = dict(
            record=record,
            time=time,
            base_acceleration=base_acceleration,
            covariates=covariates,
        )
        if self.coordinates not in ("relative", "absolute"):
            raise ChannelError(
                f"coordinates={self.coordinates!r} is unknown",
                "Choose 'relative' or 'absolute'.",
            )
        if self.estimation not in _ESTIMATIONS:
            raise ChainError(
                f"estimation={self.estimation!r} is unknown",
                f"Choose one of {', '.join(_ESTIMATIONS)}.",
            )
        if sample_weight is not None and (
            self.estimation not in LEAST_SQUARES or is_streamed(X)
        ):
            raise ChannelError(
                "sample_weight is for least squares of samples in memory",
                "Leave it out otherwise.",
            )
        if isinstance(X, FrequencyResponse):
            return fit_frequency_response(self, X)
        records = records_in(X)
        if records is not None and lacks_motion(records):
            return fit_fewer_sensors(self, records)
        if is_streamed(X):
            return fit_streamed(self, X, y, state=state, **beside)
        memory = any(law.has_memory for law in law_list(self.laws))
        options = beside | {
            "has_memory": memory,
            "n_dof": getattr(self.chain, "n_dof", None),
        }
        if not isinstance(X, (Record, Dataset)):
            require_two_dimensions(X)
        options |= {"both_fusions": self.estimation != "ls"}
        data = self._data(X, y, sample_weight=sample_weight, **options)
        if records is None and not isinstance(X, Dataset):
            data = with_motion_checks(data)
        self._measured = records is not None
        least_squares = self.estimation == "ls" or (
            self.estimation == "auto" and records is None
        )
        self._fit(
            data,
            (None if least_squares else lambda: _apart(data)),
        )
        if self.model_.info["estimation"]["found"] == "ls":
            if records is not None:
                self._fused_separately = lambda: _apart(data)
        if records is not None:
            self._given = records
        self._one_force = y is not None and np.ndim(np.asarray(y)) == 1
        same_columns(
            self,
            len(X.columns) if hasattr(X, "columns") else 3 * data.n_dof,
            column_names(X),
            reset=True,
        )
        return self

    def partial_fit(
        self,
        X: Any,
        y: Any = None,
        *,
        record: Any = None,
        time: Any = None,
        base_acceleration: Any = None,
        covariates: Mapping[str, Any] | None = None,
    ) -> NRFRegressor:
        """Add records, given as for :meth:`fit`, to those of earlier calls and solve
        again; ``fit`` starts anew.
        """
        return partial_fit(self, X, y, record, time, base_acceleration, covariates)

    def problem(self, n_dof: int) -> Problem:
        """The identification problem that the parameters define, without data.

        Parameters
        ----------
        n_dof : int
            Number of DOFs; that of ``chain`` where one was given.

        Raises
        ------
        ChainError
            If a site or DOF is not in the chain, or ``orders``, ``laws`` and ``degree``
            contradict each other.
        """
        chain = chain_of(self.chain, n_dof)
        laws = laws_of_sites(chain, self.laws, self.degree, self.orders)
        known = as_mapping("known_masses", self.known_masses, "{2: 12.4}")
        if self.massless:
            if known:
                raise ChainError(
                    "massless=True was given beside known_masses",
                    "Leave one of them out.",
                )
            known = dict.fromkeys(range(1, n_dof + 1), 0.0)
        return Problem(
            chain, laws, known, self.band, self.strategy, None, self.optimizer
        )

    def _data(self, X: Any, y: Any, **options: Any) -> Dataset:
        records = records_in(X)
        if self.massless and records is not None:
            X = (
                records
                if self.problem(records[0].n_dof).needs_clock
                else [rec.by_sample() for rec in records]
            )
        return super()._data(X, y, **options)

    def _fit(self, data: Dataset, separate: Callable[[], Dataset] | None) -> None:
        asked = self.problem(data.n_dof)
        found = asked.solve(data)
        self._resolver, self._records, self.problem_, self.solve_order_ = (
            None,
            data,
            found.problem,
            found.order,
        )
        facts: dict[str, Any] = {"asked": self.estimation, "found": "ls"}
        examined, judged = (
            None,
            data,
            # the channels are examined by least squares unless another method is asked
            # for
        )
        if self.estimation == "auto" and separate is not None:
            shares = bias.noise_shares(data, found.problem.filters(data))
            biases = bias.noise_bias(found.model, found.order, found.grams, shares)
            if max((one.errors for one in biases), default=0.0) > bias.NEGLIGIBLE:
                with warnings.catch_warnings(record=True) as said:
                    warnings.simplefilter("always")
                    refined = refine("iv", asked, found, separate())
                given = [(str(one.message), one.category) for one in said]
                if refined[2]["found"] == "iv":
                    examined = self._constrained(found)
                    found, self._resolver, facts, _ = refined
                    for text, kind in given:
                        warnings.warn(text, kind, stacklevel=3)
                facts |= {"asked": "auto", "notes": [text for text, _ in given]}
        elif separate is not None:
            found, self._resolver, facts, judged = refine(
                self.estimation, asked, found, separate()
            )
        if found.problem is not self.problem_:  # with other shape parameters
            self.problem_, found = (
                found.problem,
                found._replace(grams=found.problem.solve(data).grams),
            )
        plain = (
            facts["found"] == "ls" or examined is not None
        )  # also where the least-squares estimate was kept
        self.solve_order_ = found.order
        found = self._constrained(found)
        self._publish(found, data)
        self.model_.info["estimation"] = facts
        self._examine(examined or found, data, data if plain else judged, plain)

    def _publish_chunks(
        self,
        found: Estimate,
        resolver: Any,
        data: Dataset,
        judged: Dataset,
        unknown: list[int],
    ) -> NRFRegressor:
        """Take an estimate from chunks, of which some windows are kept."""
        self._resolver, self._records = resolver, None
        found = self._constrained(found)
        self._publish(found, data)
        self._examine(found, data, judged, True)
        self.unknown_forces_ = pd.DataFrame({f"F{j}": np.zeros(0) for j in unknown})
        self.model_.info["estimation"] = {"asked": "ls", "found": "ls"}
        self.n_features_in_, self._one_force = 3 * self.model_.n_dof, False
        if hasattr(self, "feature_names_in_"):
            del self.feature_names_in_
        return self

    def _constrained(self, found: Estimate) -> Estimate:
        """The estimate that obeys the constraints."""
        if self.constraints is None:
            return found
        return found._replace(
            model=constrained(found.model, self.constraints, self._resolving())
        )

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        # the data, and what is read from them, are not part of the model
        data = (
            "_records",
            "_fused_separately",
            "_separate_resolver",
            "_given",
            "_free",
            "_verdict",
        )
        return state | {key: None for key in data if key in state}

    def _publish(self, found: Estimate, data: Dataset) -> None:
        self._fused_separately, self._separate_resolver, self._fused_jointly = (
            None,
            None,
            False,
        )
        self._given = self._free = self._verdict = None
        problem, solve_order, model, solution, grams = found
        layout = problem.layout
        self.problem_ = problem.with_laws(model.laws)
        self.chain_, self.solve_order_ = layout.chain, solve_order
        self.masses_ = model.masses
        self.errors_ = balance_errors(model, grams)
        self.condition_ = pd.Series(
            {f.step.name: f.condition for f in solution.fits},
            name="condition",
            dtype=float,
        )
        self.n_samples_ = int(grams.n_samples)
        self.third_law_gap_ = third_law_gap(solution, grams)
        model.visited = visited_regions(data, layout)
        model.info = {
            "band": (
                None
                if self.band is None
                else [None if b is None or np.isinf(b) else float(b) for b in self.band]
            ),
            "strategy": solve_order.strategy,
            "n_samples": self.n_samples_,
            "balance_error_percent": {
                k: float(e) for k, e in self.errors_["error"].items() if np.isfinite(e)
            },
        }
        self.model_, self.inner_ = model, solution.inner
        self.restoring_forces_ = model.restoring_forces
        self.unknown_forces_ = unknown_forces(model, data)

    def _examine(
        self, found: Estimate, data: Dataset, judged: Dataset, least_squares: bool
    ) -> None:
        """Say what may be wrong with the channels, the forces and the laws."""
        problem, solve_order, model, solution, _ = found
        silent = (
            self.band is not None
            or self.model_.info.get("estimation", {}).get("found", "ls") != "ls"
        )
        held = (
            problem.layout if least_squares else None
        )  # the shapes of its laws are those of the model
        terms = bias.MissingTerms(model, solve_order, held)
        jumps = bias.JumpBias(
            model, solve_order, problem.known_masses, problem.optimizer, silent, held
        )
        # fusion costs far more; of arrays, whose fit may take milliseconds, it would
        # double the time
        forces = (
            [ForceProbes(terms.layout, judged)]
            if self._records is not None and self._measured
            else []
        )
        cure = (
            "is its known mass right, or does its force or acceleration have the wrong"
            " sign?"
        )
        lost = [f"{text}: {cure}" for text in lost_masses(model.masses, model.laws)]
        known = (
            wrong_masses(problem, data, float(self.errors_.loc["pooled", "error"]))
            if forces
            else []
        )
        collect(terms.layout, judged, self.band, [terms, *jumps.active, *forces])
        self.missing_terms_, self.jump_bias_ = terms.table(), jumps.table()
        self.data_warnings_ = {
            "channels": channel_faults(data),
            "forces": (
                bias.contradictions_of(solution)
                + [one for held in forces for one in held.sentences()]
            ),
            "records": copies_of(data) if self._records is not None else [],
            "masses": doubtful_masses(solution) + lost + known,
        }
        said = [
            text
            for key in ("records", "forces", "masses")
            for text in self.data_warnings_[key]
        ]
        said += bias.sentences_of(self.jump_bias_)
        bias.warn_of_bias(self.missing_terms_, said, stacklevel=5)

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "model_")

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = False  # base excitation: no force anywhere
        tags.target_tags.multi_output = True
        tags.regressor_tags.poor_score = (
            True  # without an intercept: a balance of forces has none
        )
        return tags
