"""Free runs of a model under the forces of a record, for fits that repeat them."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..chain.model import ChainModel, state_matrix
from ..chain.sites import Site
from ..equations.errors import free_run_of
from ..laws.base import ForceLaw
from ..records.dataset import Segment
from ..records.record import Record
from ..records.zero_phase_filter import ZeroPhaseFilter
from ..simulation.api import classical_run, linear_run, simulate
from .linear_response import Matrices

# Share of the Nyquist frequency (half of the sampling rate) at which a filter still
# fits: 0.9 of it.
HIGHEST_CUTOFF = 0.45

Motion = dict[str, np.ndarray]


class Accuracy(NamedTuple):
    """How exact a free run has to be.

    Attributes
    ----------
    rtol : float
        Relative tolerance of an integration with error control.
    radians_per_step : float
        Of the fastest mode, up to which one Runge-Kutta step a sample is enough: a step
        lowers a frequency w by (w dt)^4 / 120 of itself.
    """

    rtol: float
    radians_per_step: float


# Of a fit by its free run; a step then lowers a frequency by 3e-5, and sensitivities
# are differences of runs.
OF_FIT = Accuracy(rtol=1e-9, radians_per_step=0.25)
# Of instruments, which any model near the true one gives: a frequency that is 1e-3 too
# low is a twentieth of the half-width of a resonance with 2 % of damping.
OF_INSTRUMENTS = Accuracy(rtol=1e-5, radians_per_step=0.6)


def eigenvalues(model: ChainModel) -> np.ndarray | None:
    """Eigenvalues of the model linearised at rest, 1/s; None if there are none."""
    try:
        return np.linalg.eigvals(state_matrix(*model.matrices()))
    except np.linalg.LinAlgError:  # no mass, or coefficients that are not finite
        return None


def _integrator_for(
    model: ChainModel, dt: float, accuracy: Accuracy
) -> Callable[..., Record]:
    """The fastest integrator that is exact enough for a model and a step dt, s."""
    values = None if model.has_memory else eigenvalues(model)
    if values is None or np.abs(values).max() * dt > accuracy.radians_per_step:
        return simulate
    return classical_run


def in_valid_rows(segment: Segment, values: np.ndarray) -> np.ndarray:
    """Values in the valid rows of a segment, NaN outside."""
    out = np.full((segment.n_samples, segment.n_dof), np.nan)
    out[segment.valid] = values
    return out


def with_motion(segment: Segment, motion: Mapping[str, np.ndarray]) -> Segment:
    """A segment with the motion of a run (relative v and x) in its valid rows."""
    rates = np.diff(motion["v"], axis=1, prepend=0.0)
    drifts = np.diff(motion["x"], axis=1, prepend=0.0)
    return replace(
        segment,
        a=in_valid_rows(segment, motion["a"]),
        v=in_valid_rows(segment, rates),
        s=in_valid_rows(segment, drifts),
    )


def first_state(segment: Segment, row: int | None = None) -> np.ndarray:
    """Displacements and velocities relative to the base in a row, (2, n_dof).

    In the first valid row if ``row`` is None.
    """
    place = segment.valid.start if row is None else row
    displacement = np.cumsum(segment.s[place].astype(float))
    velocity = np.cumsum(segment.v[place].astype(float))
    return np.array([displacement, velocity])


def motion_of(
    model: ChainModel,
    segment: Segment,
    state: np.ndarray,
    accuracy: Accuracy,
    courses: Mapping[str, np.ndarray] | None = None,
) -> Motion:
    """Free run: ``a`` (absolute), ``v`` and ``x`` (relative), (n_samples, n_dof).

    Exact where the chain is linear; else by the fastest integrator that will do.

    Parameters
    ----------
    model : ChainModel
    segment : Segment
        Forces and base motion in its valid rows.
    state : ndarray of shape (2, n_dof)
        First displacements and velocities.
    accuracy : Accuracy
        Of an integration.
    courses : mapping of str to ndarray, optional
        Coefficients that change in time, see :func:`~pysindy_nrf.simulate`.
    """
    matrices = None if courses else linear_matrices(model)
    if matrices is not None:
        rows = segment.valid
        ag = None if segment.ag is None else segment.ag[rows]
        force = segment.driving_force[rows]
        exact = linear_run(matrices, force, segment.step, state, ag, segment.course)
        if exact is not None:
            return dict(zip("xva", exact))

    run = free_run_of(
        model,
        segment,
        start=(state[0], state[1]),
        integrator=_integrator_for(model, segment.step, accuracy),
        rtol=accuracy.rtol,
        courses=courses,
    )
    return {
        "x": np.asarray(run.displacement),
        "v": np.asarray(run.velocity),
        "a": np.asarray(run.acceleration),
    }


def simulated(
    model: ChainModel,
    segment: Segment,
    delay: int = 0,
    limited: bool = False,
    courses: Mapping[str, np.ndarray] | None = None,
) -> Segment:
    """Free run of a model under the forces of a record, as a segment.

    Parameters
    ----------
    model : ChainModel
    segment : Segment
    delay : int
        Samples by which the motion comes late.
    limited : bool
        Whether the motion is low-passed as the fused motion of the record is.
    courses : mapping of str to ndarray, optional
        Coefficients that change in time, see :func:`~pysindy_nrf.simulate`.
    """
    motion = motion_of(model, segment, first_state(segment), OF_INSTRUMENTS, courses)
    a = motion["a"]
    v = np.diff(motion["v"], axis=1, prepend=0.0)
    s = np.diff(motion["x"], axis=1, prepend=0.0)

    rate = 1.0 / segment.step
    cutoff = segment.resolved
    if limited and cutoff is not None and cutoff < HIGHEST_CUTOFF * rate:
        low_pass = ZeroPhaseFilter((None, cutoff), rate)
        a = low_pass.apply(a)
        v = low_pass.apply(v)
        s = low_pass.apply(s)

    late = np.maximum(np.arange(segment.n_valid) - delay, 0)
    return replace(
        segment,
        a=in_valid_rows(segment, a[late]),
        v=in_valid_rows(segment, v[late]),
        s=in_valid_rows(segment, s[late]),
    )


def linear_matrices(model: ChainModel) -> Matrices | None:
    """Mass, damping and stiffness matrix of springs and dashpots in links.

    None if there are other laws, or a mass is not positive.
    """
    if (model.masses <= 0).any():
        return None

    C = np.zeros((model.n_dof, model.n_dof))
    K = np.zeros((model.n_dof, model.n_dof))
    for site, laws in model.laws.items():
        link = _spring_and_dashpot(site, laws)
        if link is None:
            return None
        _add_link(C, site, link["v"])
        _add_link(K, site, link["s"])
    return np.diag(model.masses), C, K


def _add_link(matrix: np.ndarray, site: Site, value: float) -> None:
    """Add a spring or a dashpot between the ends of a link to a matrix."""
    p = site.p - 1
    matrix[p, p] += value
    if site.q:
        q = site.q - 1
        matrix[q, q] += value
        matrix[p, q] -= value
        matrix[q, p] -= value


def _spring_and_dashpot(
    site: Site, laws: tuple[ForceLaw, ...]
) -> dict[str, float] | None:
    """Coefficients of v and s at a site; None if it has other terms, or is no link."""
    link = {"v": 0.0, "s": 0.0}
    for law in laws:
        for term, value in zip(law.terms(), law.values):
            if term.label not in link or site.kind != "link":
                return None
            link[term.label] += value
    return link
