"""Chain-aware optimizers: the paper's solve around any PySINDy optimizer."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted

from ..data.channels import as_matrix, checked, finite_span, sample_weights
from ..exceptions import BiasWarning, ChannelError, ExcitationError
from ..mechanics.chain import Chain
from ..mechanics.identifiability import plan_solve_order
from .chain_solve import doubtful_masses, solve_blocks
from .layout import Layout, blocks_of

if TYPE_CHECKING:
    from sklearn.utils import Tags


class _ChainOptimizerBase(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """What both chain optimizers share: PySINDy's optimizer contract around one solve."""

    # read by pysindy.EnsembleOptimizer from the optimizer it wraps
    max_iter, copy_X, initial_guess = 1, True, None

    def __init__(
        self, optimizer: Any = None, chain: Chain | None = None, strategy: str = "auto",
        excited: Iterable[int] | None = None, terms: Sequence[int] | None = None,
        known_masses: Mapping[int, float] | None = None,
    ) -> None:  # fmt: skip
        self.optimizer = optimizer
        self.chain = chain
        self.strategy = strategy
        self.excited = excited
        self.terms = terms
        self.known_masses = known_masses

    def _fit_columns(self, terms: np.ndarray, a: np.ndarray, F: np.ndarray, sample_weight: Any) -> Layout:
        n = a.shape[1]
        chain = self.chain if self.chain is not None else Chain(n)
        if len(F) != len(a):
            raise ChannelError(
                f"The features have {len(a)} samples, the targets {len(F)}", "Cut both to the same clock."
            )
        if chain.n_dof != n:
            raise ChannelError(
                f"{n} balances for a chain with {chain.n_dof} DOFs", "Give one force column for each DOF."
            )
        if len(a) < 2:
            raise ChannelError(f"{len(a)} sample is too few", "Give more samples than a balance has unknowns.")
        layout = Layout(chain, dict(zip(chain.sites, _term_counts(self.terms, terms.shape[1], len(chain.sites)))))
        unknown = [j + 1 for j in range(n) if np.isnan(F[:, j]).all()]
        forced = (
            [j + 1 for j in range(n) if np.nan_to_num(F[:, j]).any()] if self.excited is None else list(self.excited)
        )
        known = dict(self.known_masses or {})
        if not forced and not known:
            raise ExcitationError(
                "Every force is zero and no mass is known",
                "Only ratios to a known mass come out: give known_masses={dof: kg}, or measure a force.",
            )
        solve_order = plan_solve_order(chain, forced, unknown, known, self.strategy, layout.acting).require_complete()
        labels = [*["feature"] * terms.shape[1], *(f"a{j + 1}" for j in range(n))]
        forces = {f"F{j + 1}": F[:, j] for j in range(n) if j + 1 not in unknown}
        rows = finite_span([*terms.T, *a.T, *forces.values()], [*labels, *forces])
        weights = None if sample_weight is None else sample_weights(sample_weight, len(a))[rows]
        data = terms[rows], a[rows], F[rows]
        inner = sub_optimizer(self.optimizer)
        blocks = lambda: blocks_of(*data, weights=weights)  # noqa: E731
        self.solution_, _ = solve_blocks(layout, solve_order, blocks, self.known_masses, inner)
        if said := doubtful_masses(self.solution_):
            warnings.warn(" ".join(said), BiasWarning, stacklevel=3)
        self.solve_order_ = solve_order
        self.masses_ = np.array([self.solution_.masses[j] for j in range(1, n + 1)])
        return layout

    def _rows(self, layout: Layout) -> np.ndarray:
        """Coefficients of the storey terms in each balance, shape (n_dof, n_terms)."""
        rows = np.zeros((layout.n_dof, layout.n_terms))
        for site in layout.acting:
            for j in (site.p, site.q):
                if site.incidence(j):
                    second = self.solve_order_.strategy == "complete" and j != site.p
                    held = self.solution_.twins if second else self.solution_.coefficients
                    rows[j - 1, layout.slices[site]] = site.incidence(j) * held[site]
        return rows

    def _finish(self, coef: np.ndarray) -> Self:
        self.coef_ = coef
        self.ind_ = np.abs(coef) > 0
        self.intercept_ = 0.0
        self.n_iter_ = 1  # the solve is direct; an inner optimizer counts its own steps
        return self

    def _targets(self, y: Any, names: str, what: str) -> np.ndarray:
        if y is None:
            raise ChannelError(
                f"{type(self).__name__} requires y to be passed, but the target y is None", f"Give the {what}."
            )
        matrix = as_matrix(y, names, what=what)
        self._one_target = np.ndim(np.asarray(y)) == 1
        if np.isinf(matrix).any():
            raise ChannelError(f"The {what} hold infinite values", "Repair or cut these rows.")
        return matrix

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # without an intercept: a balance of forces has none
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


def sub_optimizer(optimizer: Any) -> Any:
    """The PySINDy optimizer that runs on every sub-problem: that inside a chain optimizer, or itself."""
    return optimizer.optimizer if isinstance(optimizer, _ChainOptimizerBase) else optimizer


def _term_counts(terms: Any, n_columns: int, n_sites: int) -> Sequence[int]:
    if terms is None:
        if n_sites == 0 or n_columns % n_sites:
            raise ChannelError(
                f"{n_columns} storey terms cannot be shared out evenly to {n_sites} sites",
                "Give the number of terms at each site in terms=[...], in the order of chain.sites.",
            )
        return [n_columns // n_sites] * n_sites
    counts = [int(k) for k in terms]
    if len(counts) != n_sites or sum(counts) != n_columns:
        raise ChannelError(
            f"terms={counts} does not fit {n_columns} columns at {n_sites} sites",
            "Give the number of terms at each site, in the order of chain.sites.",
        )
    return counts


class ChainOptimizer(_ChainOptimizerBase):
    """The paper's solve (eqs. 3-5) as a PySINDy optimizer, around any PySINDy optimizer.

    In ``ps.SINDy(optimizer=ChainOptimizer(), feature_library=InterstoryPolynomialLibrary())`` the columns are a, v, s
    (eq. 8) and the targets, passed as ``x_dot``, are the forces F_j. Every balance's columns and right-hand side are
    divided by their rms (never shifted) before the inner optimizer sees them, so a threshold is a share of the
    balance's force, in any units and at any number of samples; the mass is eliminated first and never thresholded.

    Parameters
    ----------
    optimizer : PySINDy optimizer, optional
        Cloned for each sub-problem; plain least squares if None. STLSQ, SR3, SSR, FROLS and others that are quadratic
        in the data see the triangular factor of all samples, on which they give the same answer. Limits of PySINDy's
        own: SSR never returns the full model, FROLS at most all terms but one; bagging draws samples and is refused.
    chain : Chain, optional
        A plain chain of as many DOFs as there are targets if None.
    excited : iterable of int, optional
        DOFs on which a force acts; those with a non-zero target if None.
    terms : sequence of int, optional
        Number of library terms at each site, in the order of ``chain.sites``; equal if None.
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

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainOptimizer
    >>> a, v, s = np.random.default_rng(0).standard_normal((3, 200, 1))
    >>> ChainOptimizer().fit(np.hstack([a, v, s]), 10 * a + 3 * v + 500 * s).coef_.round(6)
    array([[ 10.,   3., 500.]])
    """

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
            raise ChannelError(
                f"{x.shape[1]} features for {n} balances", "The first columns are a_1..a_n, then the terms."
            )
        layout = self._fit_columns(x[:, n:], x[:, :n], F, sample_weight)
        return self._finish(np.hstack([np.diag(self.masses_), self._rows(layout)]))


class StateSpaceChainOptimizer(_ChainOptimizerBase):
    """The paper's solve for a true state-space SINDy model of a chain.

    With x = [x_1..x_n, xdot_1..xdot_n] relative to the base, x_dot = [xdot | a], u = F and
    ``InterstoryPolynomialLibrary(inputs="state")``, rows of ``coef_`` are -c/m, +c/m and 1/m; the kinematic rows are
    fixed. The result prints, predicts, scores and simulates as any ``ps.SINDy``, also where only one floor was excited.
    Outside of ``ps.SINDy`` an odd number of targets, a single one among them, is taken as the accelerations alone.

    Parameters
    ----------
    optimizer, chain, strategy, excited, terms, known_masses
        See :class:`ChainOptimizer`.

    Attributes
    ----------
    coef_ : ndarray of shape (2 n_dof, n_features) or (n_dof, n_features)
        Kinematic rows, then those of the accelerations; the latter alone where they were the targets.
    masses_ : ndarray of shape (n_dof,)
        kg.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import StateSpaceChainOptimizer
    >>> x, v, F = np.random.default_rng(0).standard_normal((3, 200, 1))
    >>> a = (F - 3 * v - 500 * x) / 10
    >>> StateSpaceChainOptimizer().fit(np.hstack([v, v, x, F]), np.hstack([v, a])).coef_.round(6) + 0.0
    array([[  1. ,   0. ,   0. ,   0. ],
           [  0. ,  -0.3, -50. ,   0.1]])
    """

    def fit(self, x_: Any, y: Any, sample_weight: Any = None) -> Self:
        """Find masses and coefficients; errors as of :meth:`ChainOptimizer.fit`.

        Parameters
        ----------
        x_ : array-like of shape (n_samples, n_dof + n_terms + n_dof)
            Features: xdot_1..xdot_n, the terms of every site, F_1..F_n.
        y : array-like of shape (n_samples, 2 n_dof), (n_samples, n_dof) with n_dof odd, or (n_samples,)
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
                + ("" if moving else " (an odd number of targets: accelerations alone)"),
                "The features are xdot, the terms and F: use InterstoryPolynomialLibrary(inputs='state') and pass u=F; "
                "the targets are [xdot | a].",
            )
        forces = x[:, x.shape[1] - n :]
        layout = self._fit_columns(x[:, n : x.shape[1] - n], target[:, -n:], forces, sample_weight)
        inverse = 1.0 / self.masses_
        coef = np.zeros((n, x.shape[1]))
        coef[:, n : x.shape[1] - n] = -inverse[:, None] * self._rows(layout)
        coef[:, x.shape[1] - n :] = np.diag(inverse)
        if moving:
            coef = np.vstack([np.eye(n, x.shape[1]), coef])
        return self._finish(coef)
