"""The models of a comparison: plain SINDy, SINDy set up by an expert, this package."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import pysindy as ps
from pysindy.feature_library.base import BaseFeatureLibrary
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from sklearn.base import clone

from ..chain.model import ChainModel
from ..chain.restoring_force import RestoringForces
from ..identification.regressor import NRFRegressor
from ..selection.sparsity import select_sparsity
from ..simulation.api import simulate
from .shears import ShearSINDy

# A free run that leaves this many times the measured motion diverges.
DIVERGED = 1e3
# Threshold of the expert's STLSQ: a share of the norm of each acceleration.
EXPERT_THRESHOLD = 0.01
# Ridge of the expert: enough for the conditioning of a chain's columns; PySINDy's 0.05
# outweighs normalised columns.
EXPERT_RIDGE = 1e-8


@dataclass(frozen=True)
class RecordPart:
    """Absolute accelerations, inter-storey rates and drifts, forces of some samples."""

    a: np.ndarray
    v: np.ndarray
    s: np.ndarray
    F: np.ndarray
    dt: float

    def take(self, rows: slice) -> RecordPart:
        """Some of the samples."""
        return RecordPart(
            self.a[rows], self.v[rows], self.s[rows], self.F[rows], self.dt
        )

    @property
    def x(self) -> np.ndarray:
        """Displacements relative to the base, m."""
        return self.s.cumsum(axis=1)

    @property
    def xdot(self) -> np.ndarray:
        """Velocities relative to the base, m/s."""
        return self.v.cumsum(axis=1)

    @property
    def X(self) -> np.ndarray:
        """Columns of this package: a, v, s."""
        return np.hstack([self.a, self.v, self.s])

    @property
    def n_dof(self) -> int:
        return self.a.shape[1]

    @property
    def n_samples(self) -> int:
        return len(self.a)

    @property
    def forced(self) -> np.ndarray:
        """Numbers of the DOFs on which a force acts, from 0."""
        return np.flatnonzero(self.F.any(axis=0))


class ComparedModel(Protocol):
    """What the comparison asks of a model."""

    finds_masses: bool

    def fit(self, data: RecordPart) -> None: ...

    @property
    def terms(self) -> int: ...

    def masses(self, data: RecordPart) -> np.ndarray: ...

    def accelerations(self, data: RecordPart) -> np.ndarray: ...

    def precision_and_recall(
        self, data: RecordPart, truth: ChainModel
    ) -> tuple[float, float]: ...

    def third_law(self, masses: np.ndarray) -> tuple[float, str]: ...

    def free_run(self, data: RecordPart, deadline: float) -> np.ndarray: ...


Term = TypeVar("Term")


def precision_and_recall(identified: set[Term], true: set[Term]) -> tuple[float, float]:
    """Shares of true terms among the identified, and of identified among the true."""
    n_right = len(identified & true)
    precision = n_right / len(identified) if identified else np.nan
    recall = n_right / len(true) if true else np.nan
    return precision, recall


def _random_like(
    channels: np.ndarray, n_samples: int, rng: np.random.Generator
) -> np.ndarray:
    """Normal random channels of the standard deviations of some others."""
    shape = (n_samples, channels.shape[1])
    return rng.standard_normal(shape) * channels.std(axis=0)


class PlainSINDy:
    """``ps.SINDy`` on the state [x | xdot] under u = F."""

    finds_masses = False
    # whether each target is divided by its norm
    scales_targets = False

    def __init__(self, degree: int, normalise: bool = True) -> None:
        self.degree = degree
        self.normalise = normalise

    def n_features(self, data: RecordPart) -> int:
        """Columns of the library."""
        n_variables = 2 * data.n_dof + len(data.forced)
        return math.comb(n_variables + self.degree, self.degree)

    def work(self, data: RecordPart) -> float:
        """Multiplications of a fit: passes of every target over the equations."""
        return 10.0 * data.n_dof * data.n_samples * self.n_features(data) ** 2

    def state(self, data: RecordPart) -> np.ndarray:
        """The variables of the library but the forces."""
        return np.hstack([data.x, data.xdot])

    def rate(self, data: RecordPart) -> np.ndarray:
        """The targets."""
        return np.hstack([data.xdot, data.a])

    def library(self, data: RecordPart) -> BaseFeatureLibrary:
        """The feature library."""
        return ps.PolynomialLibrary(self.degree)

    def optimizer(self) -> ps.STLSQ:
        """The optimizer."""
        return ps.STLSQ(normalize_columns=self.normalise)

    def fit(self, data: RecordPart) -> None:
        """Fit SINDy to a part of a record."""
        # a force that is zero throughout would be 0/0 when normalised
        self.forced = data.forced
        rate = self.rate(data)
        self.size = np.ones(rate.shape[1])
        if self.scales_targets:
            self.size = np.linalg.norm(rate, axis=0)

        model = ps.SINDy(optimizer=self.optimizer(), feature_library=self.library(data))
        u = data.F[:, self.forced]
        self.model = model.fit(self.state(data), t=data.dt, x_dot=rate / self.size, u=u)
        # that the rate of a position is a velocity is no term found
        coefficients = np.asarray(self.model.coefficients()) * self.size[:, None]
        self.coefficients = coefficients[-data.n_dof :]
        self.names = self.model.get_feature_names()

    @property
    def features(self) -> set[int]:
        """Features that stand in the acceleration of any DOF."""
        return set(np.flatnonzero(self.coefficients.any(axis=0)).tolist())

    @property
    def terms(self) -> int:
        """Number of features found."""
        return len(self.features)

    def linear(self, prefix: str) -> np.ndarray:
        """Coefficients of the terms x0.. or u0.. in the accelerations."""
        columns: list[int] = []
        while f"{prefix}{len(columns)}" in self.names:
            columns.append(self.names.index(f"{prefix}{len(columns)}"))
        return self.coefficients[:, columns]

    def stiffness(self, n_dof: int) -> np.ndarray:
        """Derivatives of the accelerations by the displacements, linear terms alone."""
        return self.linear("x")[:, :n_dof]

    def masses(self, data: RecordPart) -> np.ndarray:
        """1/m is the coefficient of the force on the DOF.

        NaN where no force acts, or its term was dropped.
        """
        inverse = self.linear("u")[self.forced, np.arange(len(self.forced))]
        masses = np.full(data.n_dof, np.nan)
        with np.errstate(divide="ignore"):
            masses[self.forced] = np.where(inverse != 0, 1.0 / inverse, np.nan)
        return masses

    def predict(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The targets at some states."""
        return np.asarray(self.model.predict(state, u=u)) * self.size

    def accelerations(self, data: RecordPart) -> np.ndarray:
        """Absolute accelerations that the model predicts, m/s^2."""
        rates = self.predict(self.state(data), data.F[:, self.forced])
        return rates[:, -data.n_dof :]

    def derivative(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Rates of the state."""
        return self.predict(state, u)

    def precision_and_recall(
        self, data: RecordPart, truth: ChainModel
    ) -> tuple[float, float]:
        """Shares of the true terms, NaN where the library cannot express the truth.

        The true terms are those of an exact fit of the true accelerations at random
        points.
        """
        rng = np.random.default_rng(0)
        size = 3 * self.n_features(data)
        v = _random_like(data.v, size, rng)
        s = _random_like(data.s, size, rng)
        F = _random_like(data.F, size, rng)
        R = truth.restoring_force(np.hstack([np.zeros_like(s), v, s]))
        above = np.hstack([R[:, 1:], np.zeros((size, 1))])
        a = (F - R + above) / truth.masses

        points = RecordPart(a, v, s, F, data.dt)
        variables = np.hstack([self.state(points), F[:, self.forced]])
        features = np.asarray(self.model.feature_library.transform(variables))
        features = features / np.sqrt(np.mean(features**2, axis=0))
        target = a / np.sqrt(np.mean(a**2, axis=0))
        exact, *_ = np.linalg.lstsq(features, target, rcond=None)
        if np.abs(features @ exact - target).max() > 1e-6:
            return np.nan, np.nan

        true = np.flatnonzero((np.abs(exact) > 1e-7).any(axis=1))
        return precision_and_recall(self.features, set(true.tolist()))

    def third_law(self, masses: np.ndarray) -> tuple[float, str]:
        """Largest gap, percent, of the two stiffnesses found of each storey.

        One is that of the equation above the storey, the other that of the one below.
        """
        n_dof = len(masses)
        if n_dof == 1:
            return 0.0, "once"

        K = -masses[:, None] * self.stiffness(n_dof)
        below = np.diagonal(K, -1)
        above = np.diagonal(K, 1)
        mean = 0.5 * (np.abs(below) + np.abs(above))
        if not mean.all():
            return np.nan, "twice"
        return float(np.max(100 * np.abs(below - above) / mean)), "twice"

    def free_run(self, data: RecordPart, deadline: float) -> np.ndarray:
        """Displacements of the model alone, the forces linear between samples.

        Raises
        ------
        TimeoutError
            After the deadline (of ``time.perf_counter``).
        OverflowError
            If the run diverges.
        """
        states = self.state(data)
        t = data.dt * np.arange(data.n_samples)
        force = make_interp_spline(t, data.F[:, self.forced], k=1)
        limit = DIVERGED * np.abs(states).max(axis=0)

        def rate(instant: float, state: np.ndarray) -> np.ndarray:
            if time.perf_counter() > deadline:
                raise TimeoutError
            if not (np.abs(state) <= limit).all():
                raise OverflowError
            return self.derivative(state[None], force(instant)[None])[0]

        run = solve_ivp(rate, (0.0, t[-1]), states[0], t_eval=t, max_step=data.dt)
        if not run.success:
            raise OverflowError
        return self.displacements(run.y.T[:, : data.n_dof])

    def displacements(self, positions: np.ndarray) -> np.ndarray:
        """Displacements relative to the base from the first half of the state."""
        return positions


class ExpertSINDy(PlainSINDy):
    """``ps.SINDy`` as one who knows both would use it.

    The accelerations alone, from the terms of each storey by itself.
    """

    scales_targets = True

    def n_features(self, data: RecordPart) -> int:
        """Columns of the library."""
        terms = math.comb(2 + self.degree, 2) - 1
        return data.n_dof * terms + len(data.forced)

    def state(self, data: RecordPart) -> np.ndarray:
        """The variables of the library but the forces."""
        return np.hstack([data.s, data.v])

    def rate(self, data: RecordPart) -> np.ndarray:
        """The targets."""
        return data.a

    def derivative(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Rates of the state."""
        a = self.predict(state, u)
        drift_accelerations = np.diff(a, axis=1, prepend=0.0)
        return np.hstack([state[:, a.shape[1] :], drift_accelerations])

    def library(self, data: RecordPart) -> BaseFeatureLibrary:
        """Polynomials of each storey by itself, and the forces."""
        n_dof = data.n_dof
        libraries = []
        columns = []
        for storey in range(n_dof):
            libraries.append(ps.PolynomialLibrary(self.degree, include_bias=False))
            columns.append([storey, n_dof + storey])
        libraries.append(ps.PolynomialLibrary(1, include_bias=False))
        columns.append(list(range(2 * n_dof, 2 * n_dof + len(data.forced))))
        return ps.GeneralizedLibrary(libraries, inputs_per_library=columns)

    def optimizer(self) -> ps.STLSQ:
        """The optimizer."""
        return ps.STLSQ(
            threshold=EXPERT_THRESHOLD, alpha=EXPERT_RIDGE, normalize_columns=True
        )

    def stiffness(self, n_dof: int) -> np.ndarray:
        """Derivatives of the accelerations by the displacements, linear terms alone."""
        by_drift = self.linear("x")[:, :n_dof]
        return by_drift - np.hstack([by_drift[:, 1:], np.zeros((n_dof, 1))])

    def displacements(self, positions: np.ndarray) -> np.ndarray:
        """Displacements relative to the base from the drifts."""
        return positions.cumsum(axis=1)


class FoundChain:
    """A model that finds masses, and each storey once."""

    finds_masses = True
    model: ChainModel

    @property
    def terms(self) -> int:
        """Masses, and coefficients that are not zero."""
        count = self.model.n_dof
        for force in self.model.restoring_forces.values():
            count += int(np.count_nonzero(force.coefficients))
        return count

    def masses(self, data: RecordPart) -> np.ndarray:
        """Masses found, kg."""
        return self.model.masses

    def accelerations(self, data: RecordPart) -> np.ndarray:
        """Absolute accelerations that the model predicts, m/s^2."""
        R = self.model.restoring_force(data.X, dt=data.dt)
        above = np.hstack([R[:, 1:], np.zeros((data.n_samples, 1))])
        return (data.F - R + above) / self.model.masses

    def precision_and_recall(
        self, data: RecordPart, truth: ChainModel
    ) -> tuple[float, float]:
        """Shares of the true terms."""
        identified = _terms_of(self.model.restoring_forces)
        return precision_and_recall(identified, _terms_of(truth.restoring_forces))

    def third_law(self, masses: np.ndarray) -> tuple[float, str]:
        """Each storey is found once, so nothing can disagree."""
        return 0.0, "once"

    def free_run(self, data: RecordPart, deadline: float) -> np.ndarray:
        """Displacements of the model alone."""
        run = simulate(self.model, data.F, data.dt, x0=data.x[0], v0=data.xdot[0])
        assert run.displacement is not None  # a simulation has every channel
        return run.displacement


class Shears(FoundChain):
    """PySINDy's STLSQ on the shear of every storey."""

    def __init__(self, degree: int) -> None:
        self.degree = degree

    def fit(self, data: RecordPart) -> None:
        """Fit the storeys to a part of a record."""
        self.model = ShearSINDy(self.degree).fit(data.X, data.F).model_


class Regressor(FoundChain):
    """An estimator of this package."""

    def __init__(self, estimator: NRFRegressor) -> None:
        self.estimator = estimator

    def fit(self, data: RecordPart) -> None:
        """Fit the estimator to a part of a record."""
        estimator = self._chosen(data)
        estimator.set_params(dt=data.dt)
        self.fitted = estimator.fit(data.X, data.F)
        self.model = self.fitted.model_

    def _chosen(self, data: RecordPart) -> NRFRegressor:
        return clone(self.estimator)

    def third_law(self, masses: np.ndarray) -> tuple[float, str]:
        """Largest gap of the two estimates of each storey, percent."""
        gap = self.fitted.third_law_gap_
        return (float(gap.max()), "twice") if len(gap) else (0.0, "once")


class SelectedTerms(Regressor):
    """An estimator of this package with the terms that the held-out rule leaves."""

    def _chosen(self, data: RecordPart) -> NRFRegressor:
        degree = self.estimator.degree
        return select_sparsity(data.X, data.F, degree=degree, dt=data.dt).regressor()


def _terms_of(forces: RestoringForces) -> set[tuple[str, str]]:
    """Sites and labels of the terms that are not zero."""
    terms = set()
    for site, force in forces.items():
        for label, value in force.coefficients.items():
            if value:
                terms.add((str(site), str(label)))
    return terms
