"""Estimators of chains on the generic tables of scikit-learn's checks.

Columns are padded to whole DOFs by functions of the row alone, so that nothing but
their number changes.
"""

import re

import numpy as np
from sklearn.utils.validation import check_is_fitted

from pysindy_nrf import (
    Chain,
    ChainOptimizer,
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
    KinematicSmoother,
    NRFRegressor,
    StateSpaceChainOptimizer,
    laws,
)
from pysindy_nrf.chain import Layout
from pysindy_nrf.records.channels import checked


def padded(X, multiple, least=0):
    """X with further columns up to a multiple of some number."""
    X = np.asarray(X, dtype=float)
    n_columns = X.shape[1]
    width = max(-(-n_columns // multiple) * multiple, least)
    scale = 1.0 + np.abs(X).sum(axis=1)
    columns = [X]
    for k in range(1, width - n_columns + 1):
        mixed = X @ np.cos(k * np.arange(1.0, n_columns + 1))
        columns.append(scale * np.sin(k + mixed))
    return np.column_stack(columns)


def with_copies(y, n_samples, n_columns):
    """Forces with copies of the first column behind them."""
    forces = np.asarray(y, dtype=float).reshape(n_samples, -1)
    copies = np.tile(forces[:, :1], n_columns - forces.shape[1])
    return np.hstack([forces, copies])


class PaddedRegressor(NRFRegressor):
    def partial_fit(self, X, y=None):
        fitted = hasattr(self, "n_features_in_")
        Z = padded(checked(self, X, reset=not fitted), 3)
        width = self.n_features_in_
        super().partial_fit(Z, with_copies(y, len(Z), Z.shape[1] // 3))
        self.n_features_in_ = width
        return self

    def fit(self, X, y=None, sample_weight=None):
        Z = padded(checked(self, X, reset=True), 3)
        self._wide = None
        if y is not None:
            y = np.asarray(y)
            self._wide = y.shape[1:]
            n_forces = y.reshape(len(y), -1).shape[1]
            Z = padded(Z, 3, 3 * n_forces)
            y = with_copies(y, len(y), Z.shape[1] // 3)
        width = self.n_features_in_
        super().fit(Z, y, sample_weight)
        self.n_features_in_ = width
        return self

    def dataset(self, X, y=None, **beside):
        check_is_fitted(self)
        n_dof = self.model_.n_dof
        X = padded(checked(self, X, reset=False), 3, 3 * n_dof)
        if y is not None:
            y = with_copies(y, len(y), n_dof)
        return super().dataset(X, y, **beside)

    def predict(self, X):
        predicted = super().predict(X)
        if self._wide == ():
            return predicted[:, 0]
        return predicted[:, : self._wide[0]]

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
    def _layout(self, x, terms, n):
        return Layout(Chain(n), dict.fromkeys(range(1, n + 1), terms.shape[1] // n))


ORDER = "a sample depends on its neighbours in time"
EDGES = "NaN rows at the ends of a record are masked edges, not errors"
SIGNALS = {
    "check_estimators_nan_inf": EDGES,
    "check_methods_sample_order_invariance": ORDER,
    "check_methods_subset_invariance": ORDER,
}
WEIGHTS = "check_sample_weight_equivalence_on"
SPARSE = {f"{WEIGHTS}_sparse_data": "scikit-learn 1.6 passes sparse input to all"}
COLUMNS = SPARSE | {"check_estimators_nan_inf": EDGES}
CHAIN = SPARSE | {f"{WEIGHTS}_dense_data": "12 samples of 30 features"}
STATE = {"check_estimators_dtypes": "five columns are no state of a chain"}


def cases():
    """Every public estimator with the checks it is expected to fail, and why."""
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
    """Estimators without padding; they need three columns a DOF."""
    return [
        NRFRegressor(),
        NRFRegressor(chain=Chain(2)),
        InterstoryPolynomialLibrary(),
        ForceLawLibrary([laws.Duffing()]),
    ]


def own_column_error(result):
    """Whether a check failed with our own error on the number of columns."""
    error = result["exception"]
    while error is not None:
        if re.search("columns.* needed|X lacks a1", str(error)):
            return True
        error = error.__cause__ or error.__context__
    return False
