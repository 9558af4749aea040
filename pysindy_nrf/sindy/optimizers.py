"""Chain-aware optimizers: the paper's solve around any PySINDy optimizer."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from ..chain.identifiability import plan_solve_order
from ..chain.layout import Layout, blocks_of
from ..chain.structure import Chain, chain_of, masses_of
from ..equations.chain_solve import doubtful_masses, solve_blocks
from ..equations.errors import explained_accelerations
from ..equations.inner_optimizer import balance_optimizer
from ..exceptions import BiasWarning, ChainError, ChannelError
from ..records.channels import as_matrix, checked, rows_text, sample_weights


class _ChainOptimizerBase(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """What both chain optimizers share: PySINDy's optimizer contract around one
    solve.
    """

    # read by pysindy.EnsembleOptimizer from the optimizer it wraps
    max_iter, copy_X, initial_guess = 1, True, None
    _inputs = "balance"  # of the library whose features are fitted

    def __init__(
        self,
        optimizer: Any = None,
        chain: Chain | None = None,
        strategy: str = "auto",
        excited: int | Iterable[int] | None = None,
        terms: Any = None,
        known_masses: Mapping[int, float] | None = None,
    ) -> None:
        self.optimizer, self.chain, self.strategy = optimizer, chain, strategy
        self.excited, self.terms, self.known_masses = excited, terms, known_masses

    def balance_optimizer(self) -> Any:
        """Refuse an optimizer that does not solve balances of forces.

        Raises
        ------
        ChainError
            Always.
        """
        raise ChainError(
            f"{type(self).__name__} solves for the rates of a state, not for the"
            " balances of a chain",
            "Give the optimizer inside it, optimizer=..., or none.",
        )

    def _fit_columns(
        self,
        x: Any,
        terms: np.ndarray,
        a: np.ndarray,
        F: np.ndarray,
        sample_weight: Any,
    ) -> np.ndarray:
        n = a.shape[1]
        if len(F) != len(a):
            cure = "Cut both to the same clock."
            raise ChannelError(
                f"The features have {len(a)} samples, the targets {len(F)}", cure
            )
        layout = self._layout(x, n, terms.shape[1])
        chain, known = layout.chain, masses_of(self.known_masses, layout.chain)
        unknown = [j + 1 for j in range(n) if np.isnan(F[:, j]).all()]
        forced = (
            [j + 1 for j in range(n) if np.nan_to_num(F[:, j]).any()]
            if self.excited is None
            else self.excited
        )
        inner = balance_optimizer(self.optimizer)
        given = known, self.strategy, layout.acting, inner is not None
        solve_order = plan_solve_order(
            chain, forced, unknown, *given
        ).require_complete()
        known_forces = {f"F{j + 1}": F[:, j] for j in range(n) if j + 1 not in unknown}
        labels = [
            *["feature"] * terms.shape[1],
            *(f"a{j + 1}" for j in range(n)),
            *known_forces,
        ]
        rows = _measured([*terms.T, *a.T, *known_forces.values()], labels)
        weights = (
            None
            if sample_weight is None
            else sample_weights(sample_weight, len(a))[rows]
        )
        data = terms[rows], a[rows], F[rows]
        self.solution_, _ = solve_blocks(
            layout, solve_order, lambda: blocks_of(*data, weights=weights), known, inner
        )
        self.solution_.pass_on(stacklevel=3)
        if said := doubtful_masses(self.solution_):
            warnings.warn(" ".join(said), BiasWarning, stacklevel=3)
        self.inner_, self.solve_order_ = (
            self.solution_.inner,
            self.solution_.followed(solve_order),
        )
        self.masses_ = np.array([self.solution_.masses[j] for j in range(1, n + 1)])
        return balance_rows(layout, self.solution_.coefficients, self.solution_.twins)

    def _layout(self, x: Any, n: int, n_terms: int) -> Layout:
        """Which of the columns behind the accelerations or velocities belong to which
        site.
        """
        source = getattr(
            x, "made_by", None
        )  # features straight from a library bring it
        own = self.terms is None or hasattr(self.terms, "_layout_of")
        library = source if source is not None and own else self.terms if own else None
        if library is None:
            chain = chain_of(self.chain, n)
            layout = Layout(
                chain,
                dict(zip(chain.sites, _counts(self.terms, n_terms, len(chain.sites)))),
            )
        else:
            layout = library._layout_of(n)
        inputs, made_for = (
            getattr(library, "inputs", self._inputs),
            getattr(library, "layout_", layout).n_dof,
        )
        same = layout.n_terms == n_terms and (
            source is None or layout.slices == source.layout_.slices
        )
        for right, what, cure in (
            (
                inputs == self._inputs,
                f"The library makes features of inputs={inputs!r}",
                f"It needs {self._inputs!r}.",
            ),
            (
                layout.n_dof == n,
                f"{n} balances for a chain with {layout.n_dof} DOFs",
                "Give one force column a DOF.",
            ),
            (
                made_for == n,
                (
                    f"The library made features of {made_for} DOFs, the targets are"
                    f" those of {n}"
                ),
                "With fewer columns of u than DOFs the library needs excited=[...].",
            ),
            (
                self.chain in (None, layout.chain),
                f"chain={self.chain} is not the library's",
                "Give it there alone.",
            ),
            (
                same,
                (
                    f"{n_terms} columns do not come from terms={self.terms!r} on a"
                    f" chain of {n} DOFs"
                ),
                "Give the library that made these features: terms=library.",
            ),
        ):
            if not right:
                raise ChannelError(what, cure)
        return layout

    def _finish(self, coef: np.ndarray) -> Self:
        self.coef_, self.ind_, self.intercept_ = coef, np.abs(coef) > 0, 0.0
        self.n_iter_ = 1  # the solve is direct; an inner optimizer counts its own steps
        return self

    def _targets(self, y: Any, names: str, what: str) -> np.ndarray:
        if y is None:
            cure = f"Give the {what}."
            raise ChannelError(
                f"{type(self).__name__} requires y to be passed, but the target y is"
                " None",
                cure,
            )
        matrix = as_matrix(y, names, what=what)
        self._one_target = np.ndim(np.asarray(y)) == 1
        if np.isinf(matrix).any():
            raise ChannelError(
                f"The {what} hold infinite values", "Repair or cut these rows."
            )
        return matrix

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = (
            True  # without an intercept: a balance of forces has none
        )
        tags.input_tags.allow_nan = (
            True  # rows with NaN are left out, as PySINDy's optimizers do
        )
        return tags

    def predict(self, x: Any) -> np.ndarray:
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


def balance_rows(
    layout: Layout,
    found: Mapping[Any, np.ndarray],
    twins: Mapping[Any, np.ndarray] = {},
) -> np.ndarray:
    """Coefficients of the terms in each balance, shape (n_dof, n_terms); ``twins`` are
    those at the lower ends.
    """
    rows = np.zeros((layout.n_dof, layout.n_terms))
    for site in layout.acting:
        for j in (site.p, site.q):
            if site.incidence(j):
                held = found[site] if j == site.p else twins.get(site, found[site])
                rows[j - 1, layout.slices[site]] = site.incidence(j) * held
    return rows


def _counts(terms: Any, n_columns: int, n_sites: int) -> Sequence[int]:
    """Numbers of terms at the sites."""
    cure = (
        "Give the library that made the features, terms=library, or the number of terms"
        " at each site, terms=[...]."
    )
    if terms is None and (n_sites == 1 or n_columns == 0):
        return [n_columns] * n_sites
    if terms is None:
        raise ChannelError(
            f"It is not known which of {n_columns} columns belong to which of {n_sites}"
            " sites",
            cure,
        )
    counts = (
        [int(k) for k in terms]
        if isinstance(terms, Iterable) and not isinstance(terms, str)
        else []
    )
    if len(counts) != n_sites or sum(counts) != n_columns:
        raise ChannelError(
            f"terms={terms!r} does not fit {n_columns} columns at {n_sites} sites", cure
        )
    return counts


def _measured(columns: Sequence[np.ndarray], labels: Sequence[str]) -> np.ndarray:
    """Rows without NaN, which a differentiation leaves at the ends of every
    trajectory.
    """
    rows = np.ones(len(columns[0]), dtype=bool)
    for column, label in zip(columns, labels):
        if (infinite := np.flatnonzero(np.isinf(column))).size:
            raise ChannelError(
                f"Channel {label} is infinite in {rows_text(infinite)}",
                "Repair or cut these rows.",
            )
        if (lost := np.isnan(column)).all():
            raise ChannelError(
                f"Channel {label} holds nothing but NaN", "Leave it out, or measure it."
            )
        rows &= ~lost
    if rows.sum() < 2:
        cure = "Give more than there are unknowns."
        raise ChannelError(
            f"{rows.sum()} of {len(rows)} samples have a number in every channel", cure
        )
    return rows


class ChainOptimizer(_ChainOptimizerBase):
    """The paper's solve (eqs. 3-5) as a PySINDy optimizer, around any PySINDy
    optimizer.

    In ``ps.SINDy(feature_library=library, optimizer=ChainOptimizer(terms=library))``
    the columns are a, v, s (eq. 8) and the targets, passed as ``x_dot``, are the forces
    F_j. Every balance's columns and right-hand side are divided by their rms (never
    shifted) before the inner optimizer sees them, so a threshold is a share of the
    balance's force, in any units and at any number of samples; the mass is eliminated
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
        the order of ``chain.sites``. Not needed with one site, nor last in a
        scikit-learn pipeline behind the library, whose features bring it.
    strategy, known_masses
        See :class:`NRFRegressor`.

    Attributes
    ----------
    coef_ : ndarray of shape (n_dof, n_features)
        Row j is balance j: m_j, + the coefficients of storey j, - those of storey j+1.
    ind_ : ndarray of bool
    masses_ : ndarray of shape (n_dof,)
        kg.
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

    def balance_optimizer(self) -> Any:
        """The PySINDy optimizer that runs on every balance: that inside this one.

        Returns
        -------
        PySINDy optimizer, or None

        Raises
        ------
        ChainError
            If this one has settings that the estimator around it decides.
        """
        given = self.get_params(deep=False)
        plain = ChainOptimizer().get_params(deep=False)
        other = [
            f"{name}={given[name]!r}"
            for name in plain
            if name != "optimizer" and given[name] != plain[name]
        ]
        if other:
            raise ChainError(
                f"The inner ChainOptimizer has {', '.join(other)}, which the estimator"
                " around it decides",
                "Give these to that estimator.",
            )
        return balance_optimizer(self.optimizer)

    def fit(self, x_: Any, y: Any, sample_weight: Any = None) -> Self:
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
            If there are fewer features than balances, or a value is not finite.
        ExcitationError, IdentifiabilityError
            If nothing scales the chain, or a mass or law is out of reach.
        """
        x = checked(self, x_, reset=True, prefix="feature ")
        F = self._targets(y, "F", "forces F")
        n = F.shape[1]
        if x.shape[1] < n:
            cure = "The first columns are a_1..a_n, then the terms."
            raise ChannelError(f"{x.shape[1]} features for {n} balances", cure)
        rows = self._fit_columns(x_, x[:, n:], x[:, :n], F, sample_weight)
        return self._finish(np.hstack([np.diag(self.masses_), rows]))

    def score(self, X: Any, y: Any, sample_weight: Any = None) -> float:
        """R^2 of the accelerations, as :meth:`NRFRegressor.score`: balances without a
        force count like the others.

        Parameters
        ----------
        X, y : array-like
            Features and forces, as for ``fit``.
        sample_weight : array-like of shape (n_samples,), optional
        """
        check_is_fitted(self, "coef_")
        x, F = (
            checked(self, X, reset=False),
            as_matrix(y, "F", len(self.masses_), "forces F"),
        )
        a, weights = x[:, : F.shape[1]], sample_weights(sample_weight, len(x))
        gap = (F - x @ self.coef_.T) / self.masses_
        rows = np.isfinite(gap[:, np.isfinite(F).any(axis=0)]).all(axis=1)
        return explained_accelerations([(a[rows], gap[rows], weights[rows])])


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
    >>> from pysindy_nrf import StateSpaceChainOptimizer
    >>> x, v, F = np.random.default_rng(0).standard_normal((3, 200, 1))
    >>> a = (F - 3 * v - 500 * x) / 10
    >>> (
    ...     StateSpaceChainOptimizer()
    ...     .fit(np.hstack([v, v, x, F]), np.hstack([v, a]))
    ...     .coef_.round(6)
    ...     + 0.0
    ... )
    array([[  1. ,   0. ,   0. ,   0. ],
           [  0. ,  -0.3, -50. ,   0.1]])
    """

    _inputs = "state"

    def fit(self, x_: Any, y: Any, sample_weight: Any = None) -> Self:
        """Find masses and coefficients; errors as of :meth:`ChainOptimizer.fit`.

        Parameters
        ----------
        x_ : array-like of shape (n_samples, n_dof + n_terms + n_dof)
            Features: xdot_1..xdot_n, the terms of every site, F_1..F_n.
        y : array-like of shape (n_samples, 2 n_dof), (n_samples, n_dof) with n_dof odd,
        or (n_samples,)
            Targets: velocities and accelerations, or the accelerations alone.
        sample_weight : array-like of shape (n_samples,), optional
            See :meth:`ChainOptimizer.fit`.
        """
        x = checked(self, x_, reset=True, prefix="feature ")
        target = self._targets(y, "target ", "targets")
        moving = target.shape[1] % 2 == 0  # with the velocities
        n = target.shape[1] // 2 if moving else target.shape[1]
        if x.shape[1] < 2 * n:
            raise ChannelError(
                f"{x.shape[1]} feature(s) for the accelerations of {n} DOFs"
                + (
                    "" if moving else " (an odd number of targets: accelerations alone)"
                ),
                "The features are xdot, the terms and F: use"
                " InterstoryPolynomialLibrary(inputs='state') and pass u=F; the targets"
                " are [xdot | a].",
            )
        terms, forces = x[:, n : x.shape[1] - n], x[:, x.shape[1] - n :]
        coef = self._state_rows(
            self._fit_columns(x_, terms, target[:, -n:], forces, sample_weight)
        )
        return self._finish(coef if moving else coef[n:])

    def _state_rows(self, rows: np.ndarray) -> np.ndarray:
        """Kinematic rows and those of the accelerations from those of the balances."""
        n, m = len(self.masses_), self.masses_[:, None]
        return np.block(
            [
                [np.eye(n, 2 * n + rows.shape[1])],
                [np.zeros((n, n)), -rows / m, np.eye(n) / m],
            ]
        )
