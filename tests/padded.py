"""Estimators of chains on the generic tables of scikit-learn's checks: columns padded
to whole DOFs by functions of the row alone, so that nothing but their number changes.
"""

import re

import numpy as np
from sklearn.utils.validation import check_is_fitted

from pysindy_nrf import (
    Chain,
    ChainOptimizer,
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
    NRFRegressor,
    StateSpaceChainOptimizer,
    laws,
)
from pysindy_nrf.chain.layout import Layout
from pysindy_nrf.records.channels import checked


def padded(X, multiple, least=0):
    """X with further columns up to a multiple of some number."""
    X = np.asarray(X, dtype=float)
    width = max(-(-X.shape[1] // multiple) * multiple, least)
    scale = 1.0 + np.abs(X).sum(axis=1)
    more = [
        scale * np.sin(k + X @ np.cos(k * np.arange(1.0, X.shape[1] + 1)))
        for k in range(1, width - X.shape[1] + 1)
    ]
    return np.column_stack([X, *more])


class PaddedRegressor(NRFRegressor):
    def partial_fit(self, X, y=None):
        fitted = hasattr(self, "n_features_in_")
        Z = padded(checked(self, X, reset=not fitted), 3)
        width = self.n_features_in_
        columns = np.asarray(y, dtype=float).reshape(len(Z), -1)
        super().partial_fit(
            Z,
            np.hstack(
                [columns, np.tile(columns[:, :1], Z.shape[1] // 3 - columns.shape[1])]
            ),
        )
        self.n_features_in_ = width
        return self

    def fit(self, X, y=None, sample_weight=None):
        Z = padded(checked(self, X, reset=True), 3)
        self._wide = None
        if y is not None:
            y = np.asarray(y)
            self._wide = y.shape[1:]
            columns = y.reshape(len(y), -1)
            Z = padded(Z, 3, 3 * columns.shape[1])
            y = np.hstack(
                [columns, np.tile(columns[:, :1], Z.shape[1] // 3 - columns.shape[1])]
            )
        width = self.n_features_in_
        super().fit(Z, y, sample_weight)
        self.n_features_in_ = width
        return self

    def dataset(self, X, y=None, **given):
        check_is_fitted(self)
        n_dof = self.model_.n_dof
        X = padded(checked(self, X, reset=False), 3, 3 * n_dof)
        if y is not None:
            columns = np.asarray(y).reshape(len(y), -1)
            more = np.tile(columns[:, :1], n_dof - columns.shape[1])
            y = np.hstack([columns, more])
        return super().dataset(X, y, **given)

    def predict(self, X):
        out = super().predict(X)
        return out[:, 0] if self._wide == () else out[:, : self._wide[0]]

    def score(self, X, y=None):
        return super().score(X, y)


class _PaddedLibrary:
    def _checked(self, x, reset):
        return padded(checked(self, x, reset=reset), 3)


class PaddedPolynomialLibrary(_PaddedLibrary, InterstoryPolynomialLibrary):
    pass


DUFFING = (laws.LinearViscous(), laws.Duffing())


class PaddedLawLibrary(_PaddedLibrary, ForceLawLibrary):
    def __init__(
        self, laws=DUFFING, chain=None, inputs="balance", dt=None, excited=None
    ):
        super().__init__(laws, chain, inputs, dt, excited)


class EvenOptimizer(ChainOptimizer):
    def _layout(self, x, n, n_terms):
        return Layout(Chain(n), dict.fromkeys(range(1, n + 1), n_terms // n))


ORDER = (
    "what a transformer of signals does to a sample depends on its neighbours in time"
)
EDGES = (
    "NaN rows at the ends of a record are masked edges, not errors; NaN within it and"
    " infinities are refused"
)
SIGNALS = {
    "check_estimators_nan_inf": EDGES,
    "check_methods_sample_order_invariance": ORDER,
    "check_methods_subset_invariance": ORDER,
}
SPARSE = {
    "check_sample_weight_equivalence_on_sparse_data": (
        "scikit-learn 1.6 does not ask whether sparse input is accepted"
    )
}
COLUMNS = SPARSE | {"check_estimators_nan_inf": EDGES}
CHAIN = SPARSE | {
    "check_sample_weight_equivalence_on_dense_data": (
        "30 features of 12 samples tell no mass from its storey: refused"
    ),
}
STATE = {
    "check_estimators_dtypes": (
        "five columns are neither positions and velocities alone nor those with forces"
        " on each DOF"
    ),
}


def cases():
    """Every public estimator with the checks it is expected to fail, and why."""
    from pysindy_nrf import KinematicSmoother

    return [
        (KinematicSmoother(fs=100.0, channels="x"), SIGNALS),
        (EvenOptimizer(), CHAIN),
        (StateSpaceChainOptimizer(), CHAIN),
        (InterstoryPolynomialLibrary(inputs="state"), STATE),
        (ForceLawLibrary(DUFFING, inputs="state"), STATE),
        (PaddedPolynomialLibrary(), {}),
        (PaddedLawLibrary(), {}),
        (PaddedRegressor(degree=1), COLUMNS),
    ]


def direct():
    """What asks for columns in threes, without the padding; a chain of two DOFs asks
    for six.
    """
    return [
        NRFRegressor(),
        NRFRegressor(chain=Chain(2)),
        InterstoryPolynomialLibrary(),
        ForceLawLibrary([laws.Duffing()]),
    ]


def own_column_error(result):
    """Whether a failed check failed because our own error says how many columns, or
    which, are needed.
    """
    error = result["exception"]
    while error is not None:
        if re.search("columns.* needed|X lacks a1", str(error)):
            return True
        error = error.__cause__ or error.__context__
    return False
