"""Plain SINDy on the shears of storeys: masses and laws also where one floor is forced.

The forces above a storey act on all that moves above it, and on the storey:

    F_i + ... + F_n = m_i a_i + ... + m_n a_n + R_i(v_i, s_i)

Every storey is one sparse regression of PySINDy, and no law stands in two of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import pysindy as ps
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, clone

from ..chain.layout import with_coefficients
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..exceptions import ExcitationError, IdentifiabilityError
from ..records.input_arrays import from_arrays
from ..selection.one_se_rule import Degree
from .feature_library import InterstoryPolynomialLibrary, term_names

# Least share of the storey's shear that a term must make. Chosen on the six chains of
# benchmarks/pysindy_table.py, fused records with 2 % noise: 0.01, 0.03 and 0.1 find
# exactly the true terms of 5, 6 and 1 with all floors forced, of 4, 5 and 0 with one.
THRESHOLD = 0.03
# Ridge for the conditioning of the columns; PySINDy's 0.05 outweighs columns of rms one
# where samples are few.
RIDGE = 1e-8


@dataclass(frozen=True)
class StoreyShear:
    """One storey as a regression.

    Attributes
    ----------
    storey : int
    masses : tuple of int
        DOFs above the storey; their accelerations are the first columns.
    features : ndarray of shape (n_samples, n_masses + n_terms)
        Accelerations, m/s^2, then the terms of the storey.
    names : list of str
        Of the columns, e.g. ``["a2", "a3", "v2", "s2", ...]``.
    target : ndarray of shape (n_samples,)
        Forces on the DOFs above together, N.

    Examples
    --------
    >>> import numpy as np
    >>> import pysindy as ps
    >>> from pysindy_nrf.sindy import storey_shears
    >>> a, v, s = np.random.default_rng(0).standard_normal((3, 200, 1))
    >>> (shear,) = storey_shears(
    ...     np.hstack([a, v, s]), 10 * a + 500 * s, degree=1
    ... )
    >>> shear.coefficients(ps.STLSQ(threshold=1e-3, alpha=0)).round(6)
    array([ 10.,   0., 500.])
    >>> shear.without_masses(np.array([10.0])).names
    ['v1', 's1']
    """

    storey: int
    masses: tuple[int, ...]
    features: np.ndarray
    names: list[str]
    target: np.ndarray

    def without_masses(self, masses: np.ndarray) -> StoreyShear:
        """The same with known masses: their inertia moves to the target.

        Parameters
        ----------
        masses : ndarray of shape (n_dof,)
            kg.

        Returns
        -------
        StoreyShear
        """
        n_masses = len(self.masses)
        known = masses[[dof - 1 for dof in self.masses]]
        target = self.target - self.features[:, :n_masses] @ known
        features = self.features[:, n_masses:]
        return StoreyShear(self.storey, (), features, self.names[n_masses:], target)

    def coefficients(self, optimizer: BaseEstimator) -> np.ndarray:
        """What an optimizer finds on columns and target of rms one.

        Parameters
        ----------
        optimizer : PySINDy optimizer
            Cloned.

        Returns
        -------
        ndarray of shape (n_features,)
            SI units.
        """
        size = np.sqrt(np.mean(self.features**2, axis=0))
        length = float(np.sqrt(np.mean(self.target**2)))
        fitted = clone(optimizer)
        fitted.fit(self.features / size, self.target[:, None] / length)
        return np.ravel(fitted.coef_) * length / size


def storey_shears(
    X: object, F: ArrayLike | None = None, degree: Degree = 3
) -> list[StoreyShear]:
    """The storeys of a chain as ordinary regressions, for any optimizer of PySINDy.

    Parameters
    ----------
    X : array-like of shape (n_samples, 3 n_dof), DataFrame or Record
        As for :meth:`NRFRegressor.fit`, base at rest.
    F : array-like of shape (n_samples, n_dof)
        Applied forces, N.
    degree : int or (int, int)
        Of the power series of every storey.

    Returns
    -------
    list of StoreyShear
        From storey 1 up.

    Raises
    ------
    ExcitationError
        If a force is not known.

    Examples
    --------
    >>> import numpy as np
    >>> import pysindy as ps
    >>> from pysindy_nrf.sindy import storey_shears
    >>> rng = np.random.default_rng(0)
    >>> a, v, s = rng.standard_normal((3, 500, 2))
    >>> R = 3 * v + 500 * s
    >>> F = [10, 8] * a + R - np.column_stack([R[:, 1], 0 * R[:, 1]])
    >>> first, second = storey_shears(np.hstack([a, v, s]), F, degree=1)
    >>> first.names
    ['a1', 'a2', 'v1', 's1']
    >>> ps.STLSQ(threshold=0.1, alpha=0).fit(
    ...     first.features, first.target[:, None]
    ... ).coef_.round(6)
    array([[ 10.,   8.,   3., 500.]])
    """
    data = from_arrays(X, F)
    channels = []
    for segment in data.segments:
        rows = segment.valid
        parts = [segment.a[rows], segment.v[rows], segment.s[rows]]
        channels.append(np.hstack([*parts, segment.driving_force[rows]]))
    table = np.concatenate(channels).astype(float)
    n_dof = data.n_dof
    motions, forces = table[:, : 3 * n_dof], table[:, 3 * n_dof :]
    if np.isnan(forces).any():
        what = "A shear is the sum of all forces above a storey, and one is not known"
        raise ExcitationError(what, "Give zeros where no force acts, or NRFRegressor.")

    library = InterstoryPolynomialLibrary(degree).fit(motions)
    terms = np.asarray(library.transform(motions))[:, n_dof:]
    names = term_names(library.layout_)
    shears = []
    for i in range(1, n_dof + 1):
        columns = library.layout_.slices[Site(f"storey {i}")]
        above = tuple(range(i, n_dof + 1))
        features = np.hstack([motions[:, i - 1 : n_dof], terms[:, columns]])
        labels = [*(f"a{j}" for j in above), *names[columns]]
        target = forces[:, i - 1 :].sum(axis=1)
        shears.append(StoreyShear(i, above, features, labels, target))
    return shears


class ShearSINDy(BaseEstimator):
    """PySINDy's sparse regression of every storey's shear.

    Parameters
    ----------
    degree : int or (int, int)
        Of the power series of every storey.
    optimizer : PySINDy optimizer, optional
        On columns and target of rms one. ``ps.STLSQ(threshold=0.03, alpha=1e-8)`` if
        None.

    Attributes
    ----------
    masses_ : ndarray of shape (n_dof,)
        kg.
    model_ : ChainModel

    Notes
    -----
    The mass of a floor is taken from its own storey, those above the highest forced
    floor from the storey of that floor; the storeys up there are then regressed with
    their masses known.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.sindy import ShearSINDy
    >>> ShearSINDy().fit(datasets.load_demo()).masses_.round(0)
    array([12., 10.,  8.])
    """

    def __init__(
        self, degree: Degree = 3, optimizer: BaseEstimator | None = None
    ) -> None:
        self.degree = degree
        self.optimizer = optimizer

    def fit(self, X: object, y: ArrayLike | None = None) -> Self:
        """Find masses and laws.

        Parameters
        ----------
        X, y
            Motions and forces, as for :func:`storey_shears`.

        Raises
        ------
        ExcitationError
            If no force acts, or one is not known.
        IdentifiabilityError
            If the optimizer dropped a mass.
        """
        optimizer = self.optimizer
        if optimizer is None:
            optimizer = ps.STLSQ(threshold=THRESHOLD, alpha=RIDGE)
        shears = storey_shears(X, y, self.degree)
        forced = [shear for shear in shears if shear.target.any()]
        if not forced:
            what = "No force acts, so nothing scales the shears"
            raise ExcitationError(what, "Excite a floor, or use known masses.")

        masses = np.zeros(len(shears))
        coefficients = {}
        for shear in forced:
            values = shear.coefficients(optimizer)
            # a storey further up gives the masses above it anew
            masses[shear.storey - 1 :] = values[: len(shear.masses)]
            coefficients[Site(f"storey {shear.storey}")] = values[len(shear.masses) :]
        lost = np.flatnonzero(masses == 0) + 1
        if lost.size:
            what = f"{type(optimizer).__name__} dropped the mass of DOF {lost[0]}"
            raise IdentifiabilityError(what, "Lower its threshold.")

        for shear in shears[len(forced) :]:
            known = shear.without_masses(masses)
            site = Site(f"storey {shear.storey}")
            coefficients[site] = known.coefficients(optimizer)

        layout = InterstoryPolynomialLibrary(self.degree).layout_of(len(shears))
        laws = with_coefficients(layout.laws, coefficients)
        self.masses_ = masses
        self.model_ = ChainModel(masses, laws)
        return self
