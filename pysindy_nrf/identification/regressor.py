"""NRFRegressor, the scikit-learn estimator of the identification."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin

from ..chain.sites import as_mapping
from ..chain.structure import Chain, chain_of
from ..common.plain_tables import plain, restored
from ..equations.inner_optimizer import Optimizer
from ..exceptions import ChainError, ChannelError
from ..records.channels import column_names, require_two_dimensions
from ..records.input_arrays import Input, InputSettings, records_in
from .distributed import fit_collection
from .door import (
    ARRAYS,
    COLLECTION,
    PIECES,
    choose_method,
    form_of,
    refuse_arguments,
    refuse_unused,
)
from .fitted import FittedChain
from .parameters import Parameter
from .problem import (
    DEFAULT_DEGREE,
    DeclaredLaws,
    Order,
    Orders,
    Problem,
    law_list,
    laws_of_sites,
)
from .result import IdentificationResult
from .streaming import (
    RunningSums,
    StreamSettings,
    fit_pieces,
    identified,
    with_records,
)
from .time_variation import VaryingSetting, with_time_variation

if TYPE_CHECKING:
    from sklearn.utils import Tags


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
        ``"joint"``: all balances at once with shared laws, each divided by the residual
        that it leaves alone. ``"complete"``: each balance alone, the paper's way (eq.
        3). Both need a force on every DOF, in one record or another. ``"auto"``: joint
        if every DOF is forced, else sequential. Two exceptions: sequential with an
        ``optimizer``, which chooses the terms storey by storey, and complete where two
        balances contradict each other.
    optimizer : PySINDy optimizer, optional
        Runs inside :class:`ChainOptimizer` on every balance; plain least squares if
        None.
    coordinates : {"relative", "absolute"}
        X holds inter-storey motion v, s (eq. 8), or motion xdot, x of the DOFs.
    estimation : {"auto", "ls", "iv", "simulation"}
        How the coefficients are estimated. See :mod:`pysindy_nrf.identification`.

        - ``"ls"``: least squares.
        - ``"iv"``: instrumental variables from the free run of the model, without the
          bias by noise in the motion, also for searched shape parameters. Give records,
          or motions of ``KinematicSmoother(joint=False)``.
        - ``"simulation"``: the free run fitted to the motion. It starts from ``"iv"``
          and is used where it predicts better.
        - ``"auto"``: ``"ls"`` for arrays, and where a test (Durbin, Wu, Hausman) does
          not distinguish it from ``"iv"``; else ``"iv"``. Where forces jump or shape
          parameters are free, and the free run of ``"iv"`` misses more than noise,
          ``"simulation"`` (up to 30,000 samples).
    laws : mapping of str to ForceLaw or sequence of ForceLaw, optional
        Laws at some sites, in place of the power series there; further links and ``"dof
        j"`` sites join the chain. Shape parameters without a value are estimated; those
        with one are kept. Coefficients are always estimated, also of laws that were
        given values (to fix one: ``constraints``).
    known_masses : mapping of int to float, optional
        kg, by DOF. With no force anywhere one known mass scales the chain.
    varying : "auto" or mapping of str to sequence of str, optional
        Coefficients that may change while the structure shakes, by storey: ``{"storey
        2": ["s", "v"]}``. Each follows a penalised spline in time, with steps where the
        data prefer them. ``"auto"`` tests stiffness, damping and the terms of further
        laws of every storey. One record with a clock, by least squares; the courses are
        ``time_variation_``. See :mod:`pysindy_nrf.identification.time_variation`.
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
    constraints : mapping of str to Parameter, optional
        What is known of masses and coefficients, e.g. ``{"m1 + m2": Parameter(20.0),
        "storey *: s": Parameter(lower=0.0)}``; see :class:`Parameter`.

    Attributes
    ----------
    result_ : IdentificationResult
        Everything that the fit found, from which the other attributes are taken. They
        are the same after every kind of fit; what does not apply is empty.
        ``result_.smaller_order`` is the smallest degree that does as well; a
        RankWarning names it where the data cannot separate the terms.
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
        measured channels, and ``errors_`` are its errors there. Empty for others.
    missing_terms_ : DataFrame
        Share of each residual that further terms would explain, step by step; a
        BiasWarning is raised if a law is missing.
    jump_bias_ : DataFrame
        Of least squares: coefficients of forces that jump (friction), with and without
        the samples next to the jumps; a BiasWarning is raised if they differ.
    data_warnings_ : dict of str to list of str
        ``"channels"``: texts of the DataQualityWarning on channels (units, sign, gain,
        delay, clipped, dead). Texts of the BiasWarning: ``"records"``: copies of
        others. ``"masses"``: not positive, or not determined against noise. Texts of
        ``"forces"``: balances that contradict each other (a force in other units, a
        wrong known mass), a force whose channel is not linear or steady, or records of
        unlike structures.
    time_variation_ : TimeVariation or None
        With ``varying``: courses of the coefficients with 95 % bands, their changes,
        and the masses found with them. ``model_`` is then still the constant structure
        that fits best, and a BiasWarning is raised if something changes.
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
        Columns of X; three for each DOF if it has none.
    feature_names_in_ : ndarray of str
        Names of the columns of X, only if it was a table.

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

    # the sums of earlier calls of partial_fit
    _sums: RunningSums | None = None

    def __init__(
        self,
        degree: Order = DEFAULT_DEGREE,
        orders: Orders | None = None,
        strategy: str = "auto",
        optimizer: Optimizer | None = None,
        coordinates: str = "relative",
        estimation: str = "auto",
        laws: DeclaredLaws | None = None,
        known_masses: Mapping[int, float] | None = None,
        band: tuple[float | None, float | None] | None = None,
        dt: float | None = None,
        chain: Chain | None = None,
        constraints: Mapping[str, Parameter] | None = None,
        massless: bool = False,
        varying: VaryingSetting | None = None,
    ) -> None:
        self.degree = degree
        self.orders = orders
        self.strategy = strategy
        self.optimizer = optimizer
        self.coordinates = coordinates
        self.estimation = estimation
        self.laws = laws
        self.known_masses = known_masses
        self.band = band
        self.dt = dt
        self.chain = chain
        self.constraints = constraints
        self.massless = massless
        self.varying = varying

    def fit(
        self,
        X: object,
        y: object = None,
        sample_weight: ArrayLike | None = None,
        *,
        record: ArrayLike | None = None,
        time: ArrayLike | None = None,
        base_acceleration: ArrayLike | None = None,
        covariates: Mapping[str, ArrayLike] | None = None,
        state: str | PathLike[str] | None = None,
    ) -> NRFRegressor:
        """Identify masses and restoring forces.

        What has no part in the fit is refused by name.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 n_dof), DataFrame, Record or list of
        Record
            Columns a_1..a_n (absolute, m/s^2), v_1..v_n (inter-storey, m/s), s_1..s_n
            (m), paper eq. 8; with ``coordinates="absolute"`` xdot and x of the DOFs.
            Files by path (``.npy``, Parquet, HDF5), iterators of tables, and Dask
            arrays, tables and delayed records are read in chunks. What ``io.read_frf``
            returns gives a linear chain; its noise is measured and biases nothing.
            Records know the noise and the band of their fusion, a table that
            ``Record.to_features`` made of one does not.
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
            m/s^2, in the band of the motion.
        covariates : mapping of str to array-like of shape (n_samples,), optional
        state : path-like, optional
            File or folder for the state of an interrupted fit from files; the next call
            continues from it.

        Raises
        ------
        ChannelError
            If a channel or its clock cannot be used: missing, not finite inside, of
            another length; it is named. If an argument was given in addition to data
            that hold their own.
        ExcitationError
            If nothing scales the chain: no force and no known mass.
        IdentifiabilityError
            If the excitation reaches no balance that can be solved, or the data cannot
            separate the terms.
        ChainError
            If a setting is unknown or has no part in the method, or a site or DOF is
            not in the chain.
        LawError
            If two laws at a site hold the same term, or a law cannot be used with these
            data.
        FileFormatError
            If a file cannot be read.
        """
        self._sums = None
        passed = Input(X, y, record, time, base_acceleration, covariates, sample_weight)
        arguments = self._arguments(passed, state)
        form = form_of(X)
        method = choose_method(self.estimation, form, arguments)
        refuse_unused(arguments, form, method)
        if form is ARRAYS:
            require_two_dimensions(X)

        if form is COLLECTION:
            return self._publish(
                fit_collection(StreamSettings.of_estimator(self), passed)
            )
        if form is PIECES:
            return self._publish(
                fit_pieces(StreamSettings.of_estimator(self), passed, state)
            )
        data = method.read(passed, self._input_settings(X))
        result = method.identify(self.problem(data.n_dof).along(data), data)
        if self.varying is not None:
            result = with_time_variation(result, self.varying)
        one_force = form is ARRAYS and y is not None and np.ndim(passed.F) == 1
        return self._publish(result, column_names(X), one_force)

    def partial_fit(
        self,
        X: object,
        y: object = None,
        *,
        record: ArrayLike | None = None,
        time: ArrayLike | None = None,
        base_acceleration: ArrayLike | None = None,
        covariates: Mapping[str, ArrayLike] | None = None,
    ) -> NRFRegressor:
        """Add records, given as for :meth:`fit`, to those of earlier calls.

        All of them are solved again by least squares; ``fit`` starts again.
        """
        passed = Input(X, y, record, time, base_acceleration, covariates)
        arguments = self._arguments(passed)
        form = form_of(X)
        refuse_unused(arguments, form, choose_method("ls", form))
        refuse_arguments({"varying": self.varying}, "partial_fit")

        sums = with_records(self._sums, StreamSettings.of_estimator(self), passed)
        result = identified(lambda kind: sums, sums.kind)
        # a call that fails leaves the sums of earlier calls as they are
        self._sums = sums
        return self._publish(result)

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
        known_masses = as_mapping("known_masses", self.known_masses, "{2: 12.4}")
        if self.massless:
            if known_masses:
                raise ChainError(
                    "massless=True was given in addition to known_masses",
                    "Leave one of them out.",
                )
            known_masses = dict.fromkeys(range(1, n_dof + 1), 0.0)
        return Problem(
            chain,
            laws_of_sites(chain, self.laws, self.degree, self.orders),
            known_masses,
            self.band,
            self.strategy,
            optimizer=self.optimizer,
            constraints=self.constraints or {},
        )

    def _arguments(self, passed: Input, state: object = None) -> list[str]:
        """Names of the arguments and settings that differ from their defaults."""
        values = passed.beside() | {
            "state": state,
            "dt": self.dt,
            "optimizer": self.optimizer,
            "constraints": self.constraints,
            "band": self.band,
            "varying": self.varying,
        }
        names = [name for name, value in values.items() if value is not None]
        if self.coordinates != "relative":
            names.append("coordinates")
        if self.strategy != "auto":
            names.append("strategy")
        return names

    def _input_settings(self, X: object) -> InputSettings:
        """How data are read."""
        if self.coordinates not in ("relative", "absolute"):
            raise ChannelError(
                f"coordinates={self.coordinates!r} is unknown",
                "Choose 'relative' or 'absolute'.",
            )
        needs_clock = True
        records = records_in(X)
        if self.massless and records is not None:
            needs_clock = self.problem(records[0].n_dof).needs_clock
        return InputSettings(
            coordinates=self.coordinates,
            dt=self.dt,
            n_dof=getattr(self.chain, "n_dof", None),
            has_memory=any(law.has_memory for law in law_list(self.laws)),
            needs_clock=needs_clock,
        )

    def _publish(
        self,
        result: IdentificationResult,
        columns: list[str] | None = None,
        one_force: bool = False,
    ) -> NRFRegressor:
        """Set every attribute from a result, the columns of X and the shape of y."""
        self.result_ = result
        self.model_ = result.model
        self.problem_ = result.problem
        self.chain_ = result.model.chain
        self.masses_ = result.model.masses
        self.restoring_forces_ = result.model.restoring_forces
        self.solve_order_ = result.order
        self.condition_ = result.condition
        self.inner_ = result.inner
        self.errors_ = result.errors
        self.third_law_gap_ = result.third_law_gap
        self.n_samples_ = result.n_samples
        self.unknown_forces_ = result.unknown_forces
        self.missing_terms_ = result.examination.missing_terms
        self.jump_bias_ = result.examination.jump_bias
        self.data_warnings_ = result.data_warnings
        self.motions_ = result.motions
        self.time_variation_ = result.time_variation

        self.n_features_in_ = (
            3 * result.model.n_dof if columns is None else len(columns)
        )
        if columns is not None:
            self.feature_names_in_ = np.array(columns, dtype=object)
        elif hasattr(self, "feature_names_in_"):
            del self.feature_names_in_
        self._one_force = one_force
        return self

    def __getstate__(self) -> dict[str, object]:
        state = super().__getstate__()
        return {name: plain(value) for name, value in state.items()}

    def __setstate__(self, state: dict[str, object]) -> None:
        super().__setstate__({name: restored(value) for name, value in state.items()})

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "result_")

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        # under base excitation there is no force anywhere
        tags.target_tags.required = False
        tags.target_tags.multi_output = True
        # a balance of forces has no intercept
        tags.regressor_tags.poor_score = True
        return tags
