"""Effects that a model may lack: unmeasured external forces, inertia, further links.

Like every law they stand on the left of ``m a + R = F``: an applied force f that is
missing from F appears here as ``R = -f``.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from ..common.unit_system import TRANSLATION, UnitSystem
from .base import CovariateLaw, ForceLaw, Term
from .shape import Shape


class _ExternalForce(ForceLaw):
    """Base of forces that do not follow the motion; several may act at one site."""

    family = "forcing"
    stands_for = "outside force"
    symmetry = "even"
    at_rest = None
    superposes = True


class HarmonicForce(_ExternalForce):
    r"""Harmonic force of an unknown frequency: a machine, a fan, the mains.

    .. math:: R = A \cos(2 \pi f t) + B \sin(2 \pi f t)

    t is the time on the clock of the record; records pooled in one fit share one phase.
    """

    name = "harmonic_force"
    shapes = (Shape("frequency", "Hz", 0.01, 2.0, "v/s"),)
    columns = (
        Term("A", "cos(2 pi frequency t)", "N"),
        Term("B", "sin(2 pi frequency t)", "N"),
    )
    uses_time = True
    acts_at = ("dof",)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        phase = 2.0 * np.pi * theta[0] * t
        out[0] = np.cos(phase)
        out[1] = np.sin(phase)


class ConstantForce(_ExternalForce):
    """Constant force, ``R = f0``.

    It is a dead load, or the offset of a force or acceleration sensor.

    Parameters
    ----------
    f0 : float, optional
        Force, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.ConstantForce(f0=-3.2).equation(1))
    -3.2
    """

    name = "constant_force"
    columns = (Term("f0", "1", "N"),)
    acts_at = ("dof", "link")
    variable = "1"

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = 0.0 * s + 1.0


class BaseMotion(_ExternalForce, CovariateLaw):
    """Base motion that leaks into a balance, ``R = m ag``.

    For motion relative to the base, a base acceleration that is left out of the balance
    of DOF j leaves the residual ``m_j ag``.
    """

    name = "base_motion"
    acts_at = ("dof",)
    covariate_units = ("m/s^2",)
    mimics_inertia = True

    def __init__(self, m: float | None = None, covariate: str = "ag") -> None:
        super().__init__(covariate, {}, {"m": m})

    def terms(self) -> tuple[Term, ...]:
        return (Term("m", self.covariates[0], "kg"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = u[0]


class AddedMass(ForceLaw):
    """Mass that the model lacks at a DOF, ``R = dm a``: a load, moved water."""

    name = "added_mass"
    family = "inertia"
    stands_for = "inertial"
    columns = (Term("dm", "a", "kg"),)
    passive = True
    uses_acceleration = True
    acts_at = ("dof",)
    variable = "a"
    mimics_inertia = True

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = a


class Inerter(ForceLaw):
    """Inerter between two DOFs, ``R = b a`` with a their relative acceleration.

    (Smith, IEEE Trans. Automatic Control 47, 2002.)
    """

    name = "inerter"
    family = "inertia"
    stands_for = "inertial"
    columns = (Term("b", "a", "kg"),)
    passive = True
    uses_acceleration = True
    variable = "a"
    mimics_inertia = True
    nonnegative = ("b",)

    kernel = staticmethod(AddedMass.kernel)


class LinkSpringDashpot(ForceLaw):
    """Linear spring and dashpot side by side, ``R = k s + c v``.

    For links that a chain lacks: a brace that skips a floor (``"link 4-2"``), a tie to
    the ground (``"ground 3"``).
    """

    name = "link_spring_dashpot"
    family = "link"
    stands_for = "tie"
    columns = (Term("k", "s", "N/m"), Term("c", "v", "N s/m"))
    passive = True
    acts_at = ("new link",)
    nonnegative = ("k", "c")

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s
        out[1] = v


class GroundDashpot(ForceLaw):
    """Linear dashpot from a floor to the ground, ``R = c v``.

    Damping that is not of the storeys: that part of Rayleigh's damping which is
    proportional to the masses, air, or water. A search tries it at all floors at once,
    too.
    """

    name = "ground_dashpot"
    family = "link"
    stands_for = "tie"
    columns = (Term("c", "v", "N s/m"),)
    variable = "v"
    passive = True
    acts_at = ("ground",)
    nonnegative = ("c",)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v


class BendingCoupling(ForceLaw):
    """Coupling of two neighbouring storeys by bending, ``R = -kb s``.

    It acts between floors two apart. The stiffness matrix of a frame that bends has
    positive terms two off its diagonal: floors two apart push each other away, where a
    brace (:class:`LinkSpringDashpot`) holds them together. Its share in the stiffness
    of the two storeys is part of their linear springs.
    """

    name = "bending_coupling"
    family = "coupling"
    stands_for = "tie"
    columns = (Term("kb", "-s", "N/m"),)
    variable = "s"
    acts_at = ("two storeys",)
    nonnegative = ("kb",)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = -s


class HiddenOscillator(ForceLaw):
    r"""Oscillator on a DOF that is not measured: a tuned mass damper, sloshing water.

    .. math::
        R = m \, [2 \zeta \omega (v - \dot w) + \omega^2 (s - w)], \quad
        \ddot w = 2 \zeta \omega (v - \dot w) + \omega^2 (s - w) - a_g

    w is its displacement relative to the ground; it begins every record moving with the
    DOF. The update is exact for a motion that is cubic in time over a step. Very stiff
    it is :class:`AddedMass`.

    The base acceleration a_g is the covariate of that name (between samples: their
    mean), and zero if none is named. A search does not try it under base excitation
    alone, where any inertia fits.
    """

    name = "hidden_oscillator"
    family = "oscillator"
    stands_for = "inertial"
    shapes = (Shape("omega", "1/s", 0.25, 2.5, "v/s"), Shape("zeta", "1", 0.005, 0.3))
    columns = (Term("m", "Oscillator[s]", "kg"),)
    n_states = 2  # w - s and its rate
    passive = True
    acts_at = ("dof",)
    nonnegative = ("m",)
    mimics_inertia = True
    special_cases = {AddedMass: lambda c: HiddenOscillator(1e4, 0.5, c.values[0])}

    def __init__(
        self,
        omega: float | None = None,
        zeta: float | None = None,
        m: float | None = None,
        covariate: str | None = None,
    ) -> None:
        if covariate is not None:
            self.covariates = (covariate,)
            self.covariate_units = ("m/s^2",)
            self.symmetry = "none"
            self.at_rest = None
            self.passive = False
        super().__init__({"omega": omega, "zeta": zeta}, {"m": m})

    def options(self) -> dict[str, object]:
        return {"covariate": self.covariates[0]} if self.covariates else {}

    def limit(self, drift: float, band: tuple[float, float]) -> str:
        """A tie or an added mass where the band does not contain the resonance.

        Far above the resonance the oscillator stands still, and its spring ties the DOF
        to it. Far below it moves with the DOF.
        """
        lowest, highest = 2.0 * np.pi * np.asarray(band)
        omega = self.shape["omega"] or lowest
        if omega < lowest:
            return "link"
        if omega > highest:
            return AddedMass.family
        return self.family

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = -theta[0] * (2.0 * theta[1] * z[1] + theta[0] * z[0])

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        if dt == 0.0:
            return
        omega = theta[0]
        zeta = theta[1]
        square = omega * omega
        damping = 2.0 * zeta * omega

        # The drift is s0 + v0 t + c2 t^2 + c3 t^3. Its acceleration drives w - s, of
        # which b0 + b1 t is one solution.
        rate = (s1 - s0) / dt
        c2 = (3.0 * rate - 2.0 * v0 - v1) / dt
        c3 = (v0 + v1 - 2.0 * rate) / (dt * dt)
        ground = u[0] if u.size else 0.0
        b1 = -6.0 * c3 / square
        b0 = (-2.0 * c2 - ground - damping * b1) / square

        # The rest is a free vibration from the state at the start of the step.
        y = z[0] - b0
        dy = z[1] - b1
        cosine, sine = _free_vibration(omega, zeta, dt)
        fall = math.exp(-zeta * omega * dt)
        of_sine = dy + zeta * omega * y
        z[0] = b0 + b1 * dt + fall * (cosine * y + sine * of_sine)
        z[1] = b1 + fall * (cosine * dy - sine * (square * y + zeta * omega * dy))


def _free_vibration(omega, zeta, dt):
    """Cosine and sine (over its frequency) of a damped oscillator, without their fall.

    Above critical damping they are hyperbolic.
    """
    inside = 1.0 - zeta * zeta
    frequency = omega * math.sqrt(max(abs(inside), 1e-12))
    phase = frequency * dt
    if inside >= 0.0:
        return math.cos(phase), math.sin(phase) / frequency
    phase = min(phase, 300.0)  # near the largest number that there is
    return math.cosh(phase), math.sinh(phase) / frequency


# -- masses that laws add ------------------------------------------------------


class SiteOfLaws(Protocol):
    """What is read of the site of a law."""

    @property
    def kind(self) -> str:
        """``"dof"`` where the law acts on a DOF alone."""

    @property
    def p(self) -> int:
        """The DOF."""


AnySite = TypeVar("AnySite", bound=SiteOfLaws)


def total_masses(
    masses: npt.ArrayLike, laws: Mapping[AnySite, Sequence[ForceLaw]]
) -> np.ndarray:
    """Mass of every DOF with what laws at it add, kg, shape (n_dof,)."""
    total = np.array(masses, dtype=float)
    for site, laws_there in laws.items():
        if site.kind != "dof":
            continue
        for law in laws_there:
            for term, value in zip(law.terms(), law.values, strict=True):
                if term.label == "a":
                    total[site.p - 1] += value
    return total


def lost_masses(
    masses: npt.ArrayLike,
    laws: Mapping[AnySite, Sequence[ForceLaw]],
    units: UnitSystem = TRANSLATION,
) -> list[str]:
    """Sentences on DOFs of which laws take away all the mass they have."""
    unit = units.mass
    alone = np.asarray(masses, dtype=float)
    total = total_masses(masses, laws)
    return [
        f"DOF {j + 1} has {alone[j]:.4g} {unit} and {total[j] - alone[j]:.4g} {unit}"
        f" added to it, {total[j]:.4g} {unit} in all"
        for j in np.flatnonzero((alone > 0) & (total <= 0))
    ]
