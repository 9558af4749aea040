"""The paper's two structures, simulated: the 2-DOF frame (section 3) and the four-storey frame (section 4).

What the paper does not print is chosen here, said here, and the same for all cases: the course of
the random forces, the hammer, the dampers' law in the laboratory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..exceptions import ChainError
from ..laws import ModifiedDahl, PowerSeries
from ..model import ChainModel
from ..record import Record
from ..sites import Site
from .published import LINEAR_COMPLETE

# 2-DOF frame (section 3.1): kg, N/m, N s/m; eqs. (6)-(7).
MASS, STIFFNESS, DAMPING = 10.0, 1e5, 100.0
MR_DAMPER = {"K0": 50.0, "C0": 399.0, "Fd": 34.85, "f0": 0.0, "sigma": 5e4}
# Rms of the random forces, N. The paper does not print it: with this one the noise-free
# incomplete case gives its m_1 = 9.85 kg (see calibrate_level).
FORCE_LEVEL = 345.0
BAND = (0.5, 60.0)  # Hz, of the random forces
FS_TWO_DOF, DURATION_TWO_DOF = 1000.0, 20.0
# Four-storey frame (section 4.1).
FS_FRAME, DURATION_FRAME, BLOWS = 1024.0, 32.0, 16
LEVELS, FRICTIONS = (500.0, 1000.0, 2000.0), (20.0, 70.0)  # N: peaks of the blows, friction of the damper
FRAME_SIGMA = 5e4  # 1/m, of the damper's loop
COMPLETE_FRAME, INCOMPLETE_FRAME, INCOMPLETE_LINEAR = (1, 2, 3, 4), (3,), (2,)


@dataclass(frozen=True)
class Case:
    """A simulated test with its truth.

    Attributes
    ----------
    name : str
    truth, bare : ChainModel
        The structure with and without its damper.
    exact : Record
        Noise-free, every channel.
    measured : Record
        What an engineer would get: noisy, with the channels that are measured.
    force : ndarray of shape (n_samples, n_dof)
        True storey forces, N.
    damper : ndarray of shape (n_samples, n_dof)
        True force of the damper in each storey, N.
    noise : float
        Share of the rms of each channel in ``measured``.
    """

    name: str
    truth: ChainModel
    bare: ChainModel
    exact: Record
    measured: Record
    force: np.ndarray
    damper: np.ndarray
    noise: float = 0.0


def two_dof_model(damper: bool = True) -> ChainModel:
    """The 2-DOF frame of section 3.1.

    Parameters
    ----------
    damper : bool
        With the MR damper (modified Dahl model, eqs. 6-7) on storey 1.

    Returns
    -------
    ChainModel

    Examples
    --------
    >>> from pysindy_nrf.paper.cases import two_dof_model
    >>> two_dof_model(damper=False).modes()["frequency"].round(2).tolist()  # Hz
    [9.84, 25.75]
    """
    storey = PowerSeries(1, [DAMPING, STIFFNESS])
    first = [storey, ModifiedDahl(**MR_DAMPER)] if damper else [storey]
    return ChainModel([MASS, MASS], {"storey 1": first, "storey 2": storey})


def two_dof(
    excitation: str = "complete",
    noise: float = 0.0,
    *,
    level: float = FORCE_LEVEL,
    duration: float = DURATION_TWO_DOF,
    method: str = "default",
    random_state: int = 0,
) -> Case:
    """One of the paper's 2-DOF cases.

    Parameters
    ----------
    excitation : {"complete", "incomplete"}
        Random forces on both DOFs, or on DOF 2 only.
    noise : float
        Share of the rms of each channel (forces included), 0.05 = 5 %.
    level : float
        Rms of each force, N.
    duration : float
        s, at 1000 Hz.
    method : str
        Of :func:`pysindy_nrf.simulate`; ``"newmark"`` is the paper's.
    random_state : int

    Returns
    -------
    Case
        Accelerations, velocities and displacements are measured.
    """
    from ..excitation import band_limited_random

    dofs = _choice(excitation, {"complete": (1, 2), "incomplete": (2,)})
    F = band_limited_random(2, duration, FS_TWO_DOF, dofs=dofs, rms=level, band=BAND, random_state=random_state)
    name = f"2 DOF, {excitation}, {noise:.0%} noise"
    return _case(name, two_dof_model(), two_dof_model(False), F, FS_TWO_DOF, noise, random_state, method=method)


def calibrate_level(target: float = 9.85, *, tolerance: float = 1e-3, random_state: int = 0) -> float:
    """Force level at which the noise-free incomplete 2-DOF case gives a wanted m_1.

    The cubic series cannot hold the damper; how much too low m_1 comes out depends on how
    large the damper's friction is beside the force, and on little else.

    Parameters
    ----------
    target : float
        m_1, kg.
    tolerance : float
        kg.
    random_state : int

    Returns
    -------
    float
        Rms force, N.
    """
    from scipy.optimize import brentq

    def gap(log_level: float) -> float:
        found = first_mass(float(np.exp(log_level)), "incomplete", random_state) - target
        return 0.0 if abs(found) < tolerance else found

    return float(np.exp(brentq(gap, np.log(150.0), np.log(1500.0), xtol=1e-4)))


def first_mass(level: float, excitation: str = "incomplete", random_state: int = 0) -> float:
    """m_1 of the noise-free 2-DOF frame as the cubic series finds it at a force level, kg."""
    import warnings

    from ..exceptions import BiasWarning
    from ..regressor import NRFRegressor

    case = two_dof(excitation, level=level, random_state=random_state)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BiasWarning)
        return float(NRFRegressor(degree=3).fit(*case.exact.to_features(smooth=False)).masses_[0])


def frame_model(friction: float = 0.0, sigma: float = FRAME_SIGMA) -> ChainModel:
    """The four-storey frame: the paper's linear model (20) and masses, a Dahl damper on storey 4.

    Parameters
    ----------
    friction : float
        Friction force of the two dampers together, N; 0 for the bare frame.
    sigma : float
        Shape of their loop, 1/m.

    Returns
    -------
    ChainModel
    """
    bare = LINEAR_COMPLETE.model()
    if not friction:
        return bare
    damper = ModifiedDahl(K0=0.0, C0=0.0, Fd=friction, f0=0.0, sigma=sigma)
    return bare.with_laws({"storey 4": [*bare.laws[Site(4)], damper]})


def four_storey(
    floors: tuple[int, ...] = COMPLETE_FRAME,
    friction: float = 20.0,
    noise: float = 0.0,
    *,
    level: float = 1000.0,
    duration: float = DURATION_FRAME,
    blows: int = BLOWS,
    model: ChainModel | None = None,
    random_state: int = 0,
) -> Case:
    """One of the hammer tests on the four-storey frame.

    Parameters
    ----------
    floors : tuple of int
        Floors that are hit in turn.
    friction : float
        Of the dampers on storey 4, N; 0 for the linear frame.
    noise : float
        Share of the rms of each channel.
    level : float
        Largest peak of the half-sine blows of 10 ms, N.
    duration : float
        s, at 1024 Hz.
    blows : int
    model : ChainModel, optional
        Another structure in place of the frame (a damaged one).
    random_state : int

    Returns
    -------
    Case
        Accelerations and displacements are measured, velocities are not.
    """
    from ..excitation import impact_hammer

    F = impact_hammer(4, duration, FS_FRAME, dofs=floors, level=level, n_hits=blows, random_state=random_state)
    truth = frame_model(friction) if model is None else model
    where = "all floors hit" if len(floors) == 4 else f"floor {', '.join(map(str, floors))} hit"
    name = f"frame, {where}, {level:.0f} N, damper {friction:.0f} N, {noise:.0%} noise"
    return _case(name, truth, frame_model(), F, FS_FRAME, noise, random_state, velocity=False)


def _case(
    name: str,
    truth: ChainModel,
    bare: ChainModel,
    F: np.ndarray,
    fs: float,
    noise: float,
    random_state: int,
    velocity: bool = True,
    **options: Any,
) -> Case:
    from ..noise import add_noise
    from ..simulation import free_run

    run = free_run(truth, F, 1.0 / fs, name=name, **options)
    exact = run.record
    measured = exact if velocity else exact.replace(velocity=None)
    if noise:
        measured = add_noise(measured, noise, random_state=[random_state, 1])
    force, damper = _true_forces(truth, bare, run)
    return Case(name, truth, bare, exact, measured, force, damper, noise)


def _true_forces(truth: ChainModel, bare: ChainModel, run: Any) -> tuple[np.ndarray, np.ndarray]:
    """Storey forces from the balances of the simulated motion, and what the bare structure lacks of them."""
    record = run.record
    inertia = record.force - truth.masses * record.acceleration
    force = np.cumsum(inertia[:, ::-1], axis=1)[:, ::-1]  # R_i = sum over j >= i of F_j - m_j a_j
    X, _ = record.to_features(smooth=False)
    return force, force - bare.restoring_force(X)


def _choice(value: str, known: dict[str, Any]) -> Any:
    if value not in known:
        raise ChainError(f"excitation={value!r} is unknown", f"Choose {' or '.join(map(repr, known))}.")
    return known[value]
