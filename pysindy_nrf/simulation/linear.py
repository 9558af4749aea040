"""Exact motion of a linear structure under sampled forces."""

from functools import cache

import numpy as np
from scipy.signal import lfilter

from ..records.hold import BAND_LIMITED
from .inputs import courses_between

# Condition of the mode shapes above which modes count as one.
MAX_CONDITION = 1e10
# Exponent by which a mode may grow over the record; exp(200) is 1e87.
MAX_GROWTH = 200.0
GAUSS_POINTS = 12  # of an interval: exact for what a mode does in a period and more

Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


def linear_run(
    matrices: Motion,
    F: np.ndarray,
    dt: float,
    start: np.ndarray,
    base_acceleration: np.ndarray | None = None,
    hold: str = BAND_LIMITED,
) -> Motion | None:
    """Motion of a linear structure, exact for the course of the forces.

    Parameters
    ----------
    matrices : tuple of three ndarray of shape (n_dof, n_dof)
        Masses M, damping C and stiffness K.
    F : ndarray of shape (n_samples, n_dof)
        N.
    dt : float
        s.
    start : ndarray of shape (2, n_dof)
        Displacement and velocity relative to the base.
    base_acceleration : ndarray of shape (n_samples,), optional
        m/s^2.
    hold : {"cubic", "linear", "zero"}
        Course of the forces between the samples.

    Returns
    -------
    tuple of three ndarray of shape (n_samples, n_dof), or None
        Displacement and velocity relative to the base, absolute acceleration; None if
        modes coincide or grow without bounds.
    """
    M, C, K = matrices
    n = len(M)
    modes = _modes(M, C, K)
    if modes is None:
        return None
    values, vectors, inverse = modes
    if (values.real * dt * len(F) > MAX_GROWTH).any():
        return None

    if base_acceleration is None:
        base_acceleration = np.zeros(len(F))
    accelerations = np.hstack([np.linalg.inv(M), -np.ones((n, 1))])
    inputs = inverse @ np.vstack([np.zeros((n, n + 1)), accelerations])
    courses = courses_between(np.column_stack([F, base_acceleration]), hold)

    # what an interval of each power of time leaves in every mode at its end
    nodes, weights = _gauss_rule()
    remaining = np.exp(np.outer(values, (1 - nodes) * dt)) * (weights * dt)
    drive = sum(
        inputs * (remaining @ nodes**power)[:, None] @ course.T
        for power, course in enumerate(courses)
    )

    drive = np.column_stack([inverse @ start.ravel(), drive])
    factors = np.exp(values * dt)
    modal = [lfilter([1.0], [1.0, -q], line) for q, line in zip(factors, drive)]
    x, v = np.split((vectors @ np.array(modal)).real, 2)
    return x.T, v.T, np.linalg.solve(M, F.T - C @ v - K @ x).T


@cache
def _gauss_rule() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of the quadrature on an interval from 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def _modes(M: np.ndarray, C: np.ndarray, K: np.ndarray) -> Motion | None:
    """Eigenvalues, shapes and inverse shapes of the state matrix, one of each pair.

    The others are conjugate: their shapes are counted twice. None if they are not
    independent.
    """
    n = len(M)
    rates = np.eye(2 * n)[n:]
    A = np.vstack([rates, -np.linalg.solve(M, np.hstack([K, C]))])
    if not np.isfinite(A).all():
        return None
    values, vectors = np.linalg.eig(A)
    if not np.linalg.cond(vectors) < MAX_CONDITION:
        return None

    inverse = np.linalg.inv(vectors)
    one_of_pair = values.imag >= 0
    multiplicity = np.where(values.imag > 0, 2.0, 1.0)
    shapes = vectors * multiplicity
    return values[one_of_pair], shapes[:, one_of_pair], inverse[one_of_pair]
