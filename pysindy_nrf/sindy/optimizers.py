"""Chain-aware optimizers: the paper's solve around any PySINDy optimizer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from ..chain.identifiability import SolveOrder, plan_solve_order
from ..chain.layout import LawLayout, Layout, blocks_of
from ..chain.sites import Site, dofs_of
from ..chain.structure import Chain, chain_of, masses_of
from ..common.warn import warn_user
from ..equations.chain_solve import Solution, doubtful_masses, solve_blocks
from ..equations.errors import explained_accelerations
from ..equations.inner_optimizer import balance_optimizer
from ..exceptions import BiasWarning, ChainError, ChannelError
from ..records.channels import as_matrix, checked, rows_text, sample_weights
from .feature_library import (
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
    LawColumns,
)
from .read_layout import read_series
from .state_columns import StateColumns

_STATE_CURE = (
    "The features are the terms and F: use InterstoryPolynomialLibrary(inputs='state'),"
    " pass it as terms=, and u=F; the targets are [xdot | a], or an odd number of"
    " accelerations alone."
)

# Cosine of the angle between a velocity and its estimate from the state: derivatives of
# noisy states keep it above this.
SAME_VELOCITY = 0.9

# The library that makes the terms, or their numbers at the sites.
Terms = ForceLawLibrary | Sequence[int] | None


@dataclass(frozen=True)
class _Samples:
    """Terms (n_samples, n_terms), accelerations and forces (n_samples, n_dof)."""

    terms: np.ndarray
    acceleration: np.ndarray
    force: np.ndarray

    @property
    def n_dof(self) -> int:
        return self.acceleration.shape[1]

    @property
    def unknown(self) -> list[int]:
        """DOFs whose force is NaN throughout."""
        lost = np.isnan(self.force).all(axis=0)
        return (np.flatnonzero(lost) + 1).tolist()

    @property
    def forced(self) -> list[int]:
        """DOFs whose force is known and not zero."""
        acts = np.nan_to_num(self.force).any(axis=0)
        return (np.flatnonzero(acts) + 1).tolist()

    def measured(self) -> np.ndarray:
        """Which rows have a number in every channel.

        A differentiation leaves NaN at the ends of every trajectory.
        """
        unknown = self.unknown
        columns = [("feature", column) for column in self.terms.T]
        for j, column in enumerate(self.acceleration.T, 1):
            columns.append((f"a{j}", column))
        for j, column in enumerate(self.force.T, 1):
            if j not in unknown:
                columns.append((f"F{j}", column))

        rows = np.ones(len(self.acceleration), dtype=bool)
        for label, column in columns:
            infinite = np.flatnonzero(np.isinf(column))
            if infinite.size:
                what = f"Channel {label} is infinite in {rows_text(infinite)}"
                raise ChannelError(what, "Repair or cut these rows.")
            missing = np.isnan(column)
            if missing.all():
                what = f"Channel {label} holds nothing but NaN"
                raise ChannelError(what, "Leave it out, or measure it.")
            rows &= ~missing

        if rows.sum() < 2:
            what = f"{rows.sum()} of {len(rows)} samples have a number in every channel"
            raise ChannelError(what, "Give more than there are unknowns.")
        return rows

    def take(self, rows: np.ndarray) -> _Samples:
        return _Samples(self.terms[rows], self.acceleration[rows], self.force[rows])


class _ChainOptimizerBase(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """PySINDy's optimizer contract around the solve of a chain."""

    # pysindy.EnsembleOptimizer reads these from the optimizer it wraps
    max_iter = 1
    copy_X = True
    initial_guess = None
    # kind of features: the ``inputs`` of the library that makes them
    _inputs = "balance"

    def __init__(
        self,
        optimizer: BaseEstimator | None = None,
        chain: Chain | None = None,
        strategy: str = "auto",
        excited: int | Iterable[int] | None = None,
        terms: Terms = None,
        known_masses: Mapping[int, float] | None = None,
    ) -> None:
        self.optimizer = optimizer
        self.chain = chain
        self.strategy = strategy
        self.excited = excited
        self.terms = terms
        self.known_masses = known_masses

    def balance_optimizer(self) -> BaseEstimator | None:
        """Refuse an optimizer that does not solve equations of motion.

        Raises
        ------
        ChainError
            Always.
        """
        what = (
            f"{type(self).__name__} solves for the rates of a state, not for the"
            " balances of a chain"
        )
        cure = "Give the optimizer inside it, optimizer=..., or none."
        raise ChainError(what, cure)

    def _solve(
        self, layout: Layout, samples: _Samples, sample_weight: ArrayLike | None
    ) -> np.ndarray:
        """Find masses and coefficients; coefficients of the terms by equation."""
        n_samples = len(samples.acceleration)
        if len(samples.force) != n_samples:
            what = (
                f"The features have {n_samples} samples, the targets"
                f" {len(samples.force)}"
            )
            raise ChannelError(what, "Cut both to the same clock.")

        known_masses = masses_of(self.known_masses, layout.chain)
        inner = balance_optimizer(self.optimizer)
        order = plan_solve_order(
            layout.chain,
            samples.forced if self.excited is None else self.excited,
            samples.unknown,
            known_masses,
            self.strategy,
            layout.acting,
            alone=inner is not None,
        ).require_complete()

        rows = samples.measured()
        weights = None
        if sample_weight is not None:
            weights = sample_weights(sample_weight, n_samples)[rows]
        chosen = samples.take(rows)
        blocks = partial(
            blocks_of,
            chosen.terms,
            chosen.acceleration,
            chosen.force,
            weights=weights,
        )
        solution, _ = solve_blocks(layout, order, blocks, known_masses, inner)
        return self._store(solution, order, layout)

    def _store(
        self, solution: Solution, order: SolveOrder, layout: Layout
    ) -> np.ndarray:
        """Store what was found; returns coefficients of the terms by equation."""
        solution.pass_on()
        dofs = range(1, layout.n_dof + 1)
        masses = np.array([solution.masses[j] for j in dofs])
        doubts = doubtful_masses(solution, masses.tolist())
        if doubts:
            warn_user(" ".join(doubts), BiasWarning)

        self.solution_ = solution
        self.inner_ = solution.inner
        self.solve_order_ = solution.followed(order)
        self.masses_ = masses
        return equation_rows(layout, solution.coefficients, solution.twins)

    def _layout(self, x: ArrayLike, terms: np.ndarray, n_dof: int) -> Layout:
        """Which columns of terms belong to which site.

        Parameters
        ----------
        x : array-like
            The features as they came.
        terms : ndarray of shape (n_samples, n_terms)
        n_dof : int
        """
        n_terms = terms.shape[1]
        library = self._library(x)
        read = self._layout_read(terms, n_dof)
        if _source_of(x) is None and read is not None and not self._has_counts:
            # a search may have cloned the library apart, and changed it since
            layout: Layout = read
        elif library is None:
            layout = self._layout_by_counts(n_dof, n_terms)
        else:
            layout = self._layout_of_library(library, n_dof)
        what = f"{n_dof} balances for a chain with {layout.n_dof} DOFs"
        _require(layout.n_dof == n_dof, what, "Give one force column a DOF.")

        if library is not None:
            self._require_same_chain(library, layout, n_dof)
        what = (
            f"{n_terms} columns do not come from terms={self.terms!r} on a chain of"
            f" {n_dof} DOFs"
        )
        cure = (
            "Give the library that made these features: terms=library. A search that"
            " changes its laws has to change optimizer__terms, too."
        )
        fits = layout.n_terms == n_terms
        source = _source_of(x)
        if source is not None:
            fits = fits and layout.slices == source.layout_.slices
        _require(fits, what, cure)
        return layout

    @property
    def _has_counts(self) -> bool:
        """Whether the numbers of terms were given."""
        return self.terms is not None and not isinstance(self.terms, ForceLawLibrary)

    def _chain_of(self, n_dof: int) -> Chain:
        """The chain of the library named, or of this optimizer."""
        named = None
        if isinstance(self.terms, ForceLawLibrary):
            named = self.terms.chain
        return chain_of(named or self.chain, n_dof)

    def _layout_read(self, terms: np.ndarray, n_dof: int) -> LawLayout | None:
        """The layout that the columns themselves show: power series at every site.

        Any two columns are a series of degree 1, which shows nothing by itself.
        """
        known_series = isinstance(self.terms, InterstoryPolynomialLibrary)
        if isinstance(self.terms, ForceLawLibrary) and not known_series:
            return None
        chain = self._chain_of(n_dof)
        orders = read_series(terms, len(chain.sites))
        if orders is None or (1 in orders and not known_series):
            return None
        by_site = dict(zip(map(str, chain.sites), orders))
        library = InterstoryPolynomialLibrary(
            chain=chain, orders=by_site, inputs=self._inputs
        )
        return library.layout_of(chain.n_dof)

    def _layout_by_counts(self, n_dof: int, n_terms: int) -> Layout:
        """The layout by the numbers of terms at the sites."""
        chain = chain_of(self.chain, n_dof)
        counts = _counts(self.terms, n_terms, len(chain.sites))
        return Layout(chain, dict(zip(chain.sites, counts)))

    def _layout_of_library(self, library: ForceLawLibrary, n_dof: int) -> LawLayout:
        """The layout of a library that makes features of the kind that is needed."""
        what = f"The library makes features of inputs={library.inputs!r}"
        _require(library.inputs == self._inputs, what, f"It needs {self._inputs!r}.")
        return library.layout_of(n_dof)

    def _require_same_chain(
        self, library: ForceLawLibrary, layout: Layout, n_dof: int
    ) -> None:
        """Refuse features or a chain that are not those of the library."""
        fitted_dofs = getattr(library, "layout_", layout).n_dof
        what = (
            f"The library made features of {fitted_dofs} DOFs, the targets are those of"
            f" {n_dof}"
        )
        cure = "With fewer columns of u than DOFs the library needs excited=[...]."
        _require(fitted_dofs == n_dof, what, cure)

        what = f"chain={self.chain} is not the library's"
        _require(self.chain in (None, layout.chain), what, "Give it there alone.")

    def _library(self, x: ArrayLike) -> ForceLawLibrary | None:
        """The library that made the features, if it is known.

        Features straight from a library bring it, unless ``terms`` are numbers.
        """
        named = self.terms if isinstance(self.terms, ForceLawLibrary) else None
        source = _source_of(x)
        if source is None or self._has_counts:
            return named
        return source

    def _finish(self, coef: np.ndarray) -> Self:
        self.coef_ = coef
        self.ind_ = np.abs(coef) > 0
        self.intercept_ = 0.0
        # the solve is direct; an inner optimizer counts its own steps
        self.n_iter_ = 1
        return self

    def _targets(self, y: ArrayLike | None, names: str, what: str) -> np.ndarray:
        """Targets as a matrix; infinite ones are refused."""
        if y is None:
            missing = (
                f"{type(self).__name__} requires y to be passed, but the target y is"
                " None"
            )
            raise ChannelError(missing, f"Give the {what}.")

        matrix = as_matrix(y, names, what=what)
        self._one_target = np.ndim(np.asarray(y)) == 1
        if np.isinf(matrix).any():
            infinite = f"The {what} hold infinite values"
            raise ChannelError(infinite, "Repair or cut these rows.")
        return matrix

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        # an equation of motion has no intercept
        tags.regressor_tags.poor_score = True
        # rows with NaN are left out, as PySINDy's optimizers do
        tags.input_tags.allow_nan = True
        return tags

    def predict(self, x: ArrayLike) -> np.ndarray:
        """Right-hand sides.

        Parameters
        ----------
        x : array-like of shape (n_samples, n_features)
            Features of the library.

        Returns
        -------
        ndarray of shape (n_samples, n_targets)
        """
        check_is_fitted(self, "coef_")
        out = checked(self, x, reset=False) @ self.coef_.T
        return out[:, 0] if self._one_target else out

    @property
    def complexity(self) -> int:
        """Number of coefficients that are not zero."""
        check_is_fitted(self, "coef_")
        return int(np.count_nonzero(self.coef_))


def equation_rows(
    layout: Layout,
    coefficients: Mapping[Site, np.ndarray],
    twins: Mapping[Site, np.ndarray] | None = None,
) -> np.ndarray:
    """Coefficients of the terms in each equation of motion, (n_dof, n_terms).

    ``twins`` are those that the equations at the lower ends found.
    """
    lower = twins or {}
    rows = np.zeros((layout.n_dof, layout.n_terms))
    for site in layout.acting:
        columns = layout.slices[site]
        upper = coefficients[site]
        rows[site.p - 1, columns] = upper
        if site.kind == "link" and site.q > 0:
            rows[site.q - 1, columns] = -lower.get(site, upper)
    return rows


def _source_of(x: ArrayLike) -> ForceLawLibrary | None:
    """The library that made features, where these come straight from it."""
    return x.made_by if isinstance(x, LawColumns) else None


def _require(condition: bool, what: str, cure: str) -> None:
    if not condition:
        raise ChannelError(what, cure)


def _counts(terms: Terms, n_columns: int, n_sites: int) -> Sequence[int]:
    """Numbers of terms at the sites."""
    cure = (
        "Give the library that made the features, terms=library, or the number of terms"
        " at each site, terms=[...]."
    )
    if terms is None and (n_sites == 1 or n_columns == 0):
        return [n_columns] * n_sites
    if terms is None:
        what = (
            f"It is not known which of {n_columns} columns belong to which of {n_sites}"
            " sites"
        )
        raise ChannelError(what, cure)

    several = isinstance(terms, Iterable) and not isinstance(terms, str)
    counts = list(map(int, terms)) if several else []
    if len(counts) != n_sites or sum(counts) != n_columns:
        what = f"terms={terms!r} does not fit {n_columns} columns at {n_sites} sites"
        raise ChannelError(what, cure)
    return counts


class ChainOptimizer(_ChainOptimizerBase):
    """The paper's solve (eqs. 3-5) around any PySINDy optimizer, itself one.

    In ``ps.SINDy(feature_library=library, optimizer=ChainOptimizer(terms=library))``
    the columns are a, v, s (eq. 8) and the targets, passed as ``x_dot``, are the forces
    F_j. Every balance's columns and right-hand side are divided by their rms (never
    shifted) before the inner optimizer sees them. A threshold is thus a share of the
    balance's force, in any units and at any number of samples. The mass is eliminated
    first and never thresholded. Rows with NaN are left out, as PySINDy's optimizers do.

    Parameters
    ----------
    optimizer : PySINDy optimizer, optional
        Cloned for each sub-problem; plain least squares if None. STLSQ, SR3, SSR, FROLS
        and others that are quadratic in the data see the triangular factor of all
        samples, on which they give the same answer. What gives another one there (an
        intercept, trimming, a noise level, a penalty by the number of rows, drawn
        samples) is refused. Limits of PySINDy's own: SSR never returns the full model,
        FROLS at most all terms but one.
    chain : Chain, optional
        That of the library; a plain chain of as many DOFs as there are targets if None.
    excited : int or iterable of int, optional
        DOFs on which a force acts; those with a non-zero target if None.
    terms : ForceLawLibrary or sequence of int, optional
        The library that makes the features, or the number of its terms at each site, in
        the order of ``chain.sites``. Not needed with one site, for power series of
        degree 2 and more, whose columns show it, nor last in a scikit-learn pipeline
        behind the library, whose features bring it. Where a search changes the degree
        of the one library, that of the other does not matter.
    strategy, known_masses
        See :class:`NRFRegressor`.

    Attributes
    ----------
    coef_ : ndarray of shape (n_dof, n_features)
        Row j is balance j: m_j, + the coefficients of storey j, - those of storey j+1.
    ind_ : ndarray of bool
    masses_ : ndarray of shape (n_dof,)
        kg.
    targets_ : list of str
        F1, F2, ...: ``sindy.print(lhs=sindy.optimizer.targets_)`` names the left-hand
        sides, which SINDy takes for rates of its variables.
    solve_order_ : SolveOrder
    solution_ : Solution
    inner_ : dict of str to PySINDy optimizer
        By balance, the fitted inner optimizer (``history_``, ``coef_list``), its
        columns and target of rms one.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainOptimizer
    >>> a, v, s = np.random.default_rng(0).standard_normal((3, 200, 1))
    >>> ChainOptimizer().fit(
    ...     np.hstack([a, v, s]), 10 * a + 3 * v + 500 * s
    ... ).coef_.round(6)
    array([[ 10.,   3., 500.]])
    """

    def balance_optimizer(self) -> BaseEstimator | None:
        """The PySINDy optimizer inside this one, which runs on every equation.

        Returns
        -------
        PySINDy optimizer, or None

        Raises
        ------
        ChainError
            If this one has settings that the estimator around it decides.
        """
        defaults = ChainOptimizer().get_params(deep=False)
        other = []
        for name, value in self.get_params(deep=False).items():
            if name != "optimizer" and value != defaults[name]:
                other.append(f"{name}={value!r}")
        if other:
            what = (
                f"The inner ChainOptimizer has {', '.join(other)}, which the estimator"
                " around it decides"
            )
            raise ChainError(what, "Give these to that estimator.")
        return balance_optimizer(self.optimizer)

    def fit(
        self, x_: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None
    ) -> Self:
        """Find masses and coefficients.

        Parameters
        ----------
        x_ : array-like of shape (n_samples, n_dof + n_terms)
            Features: a_1..a_n and the terms of every site.
        y : array-like of shape (n_samples, n_dof)
            Forces F_j, N.
        sample_weight : array-like of shape (n_samples,), optional
            A sample of weight two counts as two; one of weight zero as none.

        Raises
        ------
        ChannelError
            If there are fewer features than equations, or a value is not finite.
        ExcitationError, IdentifiabilityError
            If nothing scales the chain, or a mass or law is out of reach.
        """
        x = checked(self, x_, reset=True, prefix="feature ")
        F = self._targets(y, "F", "forces F")
        n_dof = F.shape[1]
        if x.shape[1] < n_dof:
            what = f"{x.shape[1]} features for {n_dof} balances"
            raise ChannelError(what, "The first columns are a_1..a_n, then the terms.")

        samples = _Samples(x[:, n_dof:], x[:, :n_dof], F)
        layout = self._layout(x_, samples.terms, n_dof)
        rows = self._solve(layout, samples, sample_weight)
        self.targets_ = [f"F{j}" for j in range(1, n_dof + 1)]
        return self._finish(np.hstack([np.diag(self.masses_), rows]))

    def score(
        self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None
    ) -> float:
        """R^2 of the accelerations, as :meth:`NRFRegressor.score`.

        Equations without a force count like the others.

        Parameters
        ----------
        X, y : array-like
            Features and forces, as for ``fit``.
        sample_weight : array-like of shape (n_samples,), optional

        Returns
        -------
        float
        """
        check_is_fitted(self, "coef_")
        x = checked(self, X, reset=False)
        F = as_matrix(y, "F", len(self.masses_), "forces F")
        weights = sample_weights(sample_weight, len(x))

        gap = (F - x @ self.coef_.T) / self.masses_
        known = np.isfinite(F).any(axis=0)
        rows = np.isfinite(gap[:, known]).all(axis=1)
        a = x[rows, : F.shape[1]]
        return explained_accelerations([(a, gap[rows], weights[rows])])


def _require_velocities(columns: np.ndarray, targets: np.ndarray) -> None:
    """Refuse features whose first columns are not the velocities of the targets."""
    for j, (column, target) in enumerate(zip(columns.T, targets.T), start=1):
        size = np.linalg.norm(column) * np.linalg.norm(target)
        if not column @ target >= SAME_VELOCITY * size:
            what = f"Feature {j} is not the velocity of DOF {j}, which is target {j}"
            raise ChannelError(what, _STATE_CURE)


class StateSpaceChainOptimizer(_ChainOptimizerBase):
    """The paper's solve for a true state-space SINDy model of a chain.

    With x = [x_1..x_n, xdot_1..xdot_n] relative to the base, x_dot = [xdot | a], u = F
    and ``InterstoryPolynomialLibrary(inputs="state")`` as ``terms``, rows of ``coef_``
    are -c/m, +c/m and 1/m; the kinematic rows are fixed. The result prints, predicts,
    scores and simulates as any ``ps.SINDy``, also where only one floor was excited.
    Outside of ``ps.SINDy`` an odd number of targets, a single one among them, is taken
    as the accelerations alone.

    Parameters
    ----------
    optimizer, chain, strategy, excited, terms, known_masses
        See :class:`ChainOptimizer`.

    Attributes
    ----------
    coef_ : ndarray of shape (2 n_dof, n_features) or (n_dof, n_features)
        Kinematic rows, then those of the accelerations; the latter alone where they
        were the targets.
    masses_ : ndarray of shape (n_dof,)
        kg.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import (
    ...     InterstoryPolynomialLibrary,
    ...     StateSpaceChainOptimizer,
    ... )
    >>> terms = InterstoryPolynomialLibrary(1, inputs="state")
    >>> x, v, F = np.random.default_rng(0).standard_normal((3, 200, 1))
    >>> a = (F - 3 * v - 500 * x) / 10
    >>> (
    ...     StateSpaceChainOptimizer(terms=terms)
    ...     .fit(np.hstack([v, x, F]), np.hstack([v, a]))
    ...     .coef_.round(6)
    ...     + 0.0
    ... )
    array([[  1. ,   0. ,   0. ],
           [ -0.3, -50. ,   0.1]])
    """

    _inputs = "state"

    def fit(
        self, x_: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None
    ) -> Self:
        """Find masses and coefficients; errors as for :meth:`ChainOptimizer.fit`.

        Parameters
        ----------
        x_ : array-like of shape (n_samples, n_features)
            Features: xdot_j where storey j has no term v_j, the terms of every site,
            F_j where a force acts.
        y : array-like of shape (n_samples, 2 n_dof), (n_samples, n_dof) with n_dof odd,
        or (n_samples,)
            Targets: velocities and accelerations, or the accelerations alone.
        sample_weight : array-like of shape (n_samples,), optional
            See :meth:`ChainOptimizer.fit`.
        """
        x = checked(self, x_, reset=True, prefix="feature ")
        target = self._targets(y, "target ", "targets")
        n_targets = target.shape[1]
        has_velocities = n_targets % 2 == 0
        n_dof = n_targets // 2 if has_velocities else n_targets
        columns = self._state_columns(x_, x, n_dof)
        if has_velocities and len(columns.velocities) == n_dof:
            _require_velocities(x[:, :n_dof], target[:, :n_dof])
        if x.shape[1] != columns.n_columns:
            what = (
                f"{x.shape[1]} features for the accelerations of {n_dof} DOFs, which"
                f" have {columns.n_columns}"
            )
            if not has_velocities:
                what += " (an odd number of targets: accelerations alone)"
            raise ChannelError(what, _STATE_CURE)
        samples = _Samples(x[:, columns.terms], target[:, -n_dof:], columns.force(x))
        equations = self._solve(columns.layout, samples, sample_weight)
        coef = columns.rows(equations, self.masses_)
        return self._finish(coef if has_velocities else coef[n_dof:])

    def _forces(self, n_dof: int) -> tuple[int, ...]:
        """DOFs whose force is a feature."""
        library = self.terms if isinstance(self.terms, ForceLawLibrary) else None
        excited = self.excited if library is None else library.excited
        if library is not None and hasattr(library, "excited_"):
            excited = library.excited_
        if excited is None:
            return tuple(range(1, n_dof + 1))
        return dofs_of("excited", excited, n_dof)

    def _state_columns(self, x_: ArrayLike, x: np.ndarray, n_dof: int) -> StateColumns:
        """Which features are velocities, terms and forces."""
        source = _source_of(x_)
        if source is not None and not self._has_counts:
            self._layout_of_library(source, n_dof)
            columns = source.state_columns
            self._layout(x_, x[:, columns.terms], n_dof)
            return columns

        forces = self._forces(n_dof)
        terms = x[:, : x.shape[1] - len(forces)]
        read = None if self._has_counts else self._layout_read(terms, n_dof)
        if read is not None:
            self._layout(x_, terms, n_dof)
            return StateColumns.of_laws(read, forces)

        library = self._library(x_)
        if library is not None:
            laws = self._layout_of_library(library, n_dof)
            return self._checked_columns(StateColumns.of_laws(laws, forces), x_, x)
        if x.shape[1] < 2 * n_dof:
            what = f"{x.shape[1]} feature(s) for the accelerations of {n_dof} DOFs"
            raise ChannelError(what, _STATE_CURE)
        # every velocity and every force
        layout = self._layout(x_, x[:, n_dof:-n_dof], n_dof)
        return StateColumns.of_counts(layout)

    def _checked_columns(
        self, columns: StateColumns, x_: ArrayLike, x: np.ndarray
    ) -> StateColumns:
        """Columns of a library that was named; refused if the features are others."""
        n_velocities = len(columns.velocities)
        terms = x[:, n_velocities : x.shape[1] - len(columns.forces)]
        self._layout(x_, terms, columns.layout.n_dof)
        return columns
