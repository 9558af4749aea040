"""Effects that a model may lack: unmeasured external forces, inertia, further links.

Like every law they stand on the left of ``m a + R = F``: an applied force f that is
missing from F appears here as ``R = -f``.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .base import CovariateLaw, ForceLaw, Term
from .shape import Given, Shape


class HarmonicForce(ForceLaw):
    r"""Harmonic force of an unknown frequency: a machine, a fan, the mains.

    .. math:: R = A \cos(2 \pi f t) + B \sin(2 \pi f t)

    t is the time on the clock of the record; records pooled in one fit share one phase.
    """

    name = "harmonic_force"
    family = "forcing"
    shapes = (Shape("frequency", "1/s", 0.01, 2.0, "v/s"),)
    columns = (
        Term("A", "cos(2 pi frequency t)", "N"),
        Term("B", "sin(2 pi frequency t)", "N"),
    )
    symmetry = "even"
    at_rest = None
    uses_time = True
    acts_at = ("dof",)
    superposes = True

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        phase = 2.0 * np.pi * theta[0] * t
        out[0] = np.cos(phase)
        out[1] = np.sin(phase)


class ConstantForce(ForceLaw):
    """Constant force, ``R = f0``: a dead load, an offset of a force or acceleration
    sensor.

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
    family = "forcing"
    columns = (Term("f0", "1", "N"),)
    symmetry = "even"
    at_rest = None
    acts_at = ("dof", "link")
    variable = "1"
    superposes = True

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = 0.0 * s + 1.0


class BaseMotion(CovariateLaw):
    """Base motion that leaks into a balance, ``R = m ag``.

    For motion relative to the base, a base acceleration that is left out of the balance
    of DOF j leaves the residual ``m_j ag``.
    """

    name = "base_motion"
    family = "forcing"
    symmetry = "even"
    at_rest = None
    acts_at = ("dof",)
    covariate_units = ("m/s^2",)
    mimics_inertia = True
    superposes = True

    def __init__(self, m: Given = None, covariate: str = "ag") -> None:
        super().__init__(covariate, {}, {"m": m})

    def terms(self) -> tuple[Term, ...]:
        return (Term("m", self.covariates[0], "kg"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = u[0]


def total_masses(masses: Any, laws: Mapping[Any, Sequence[ForceLaw]]) -> np.ndarray:
    """Mass of every DOF including the masses that laws at it add, kg, shape
    (n_dof,).
    """
    total = np.array(masses, dtype=float)
    for site, group in laws.items():
        if site.kind == "dof":
            for law in group:
                added = zip(law.terms(), law.values, strict=True)
                total[site.p - 1] += sum(c for term, c in added if term.label == "a")
    return total


def lost_masses(masses: Any, laws: Mapping[Any, Sequence[ForceLaw]]) -> list[str]:
    """Sentences on DOFs of which laws take away all the mass they have."""
    own, total = np.asarray(masses, dtype=float), total_masses(masses, laws)
    return [
        f"DOF {j + 1} has {own[j]:.4g} kg and {total[j] - own[j]:.4g} kg added to it,"
        f" {total[j]:.4g} kg in all"
        for j in np.flatnonzero((own > 0) & (total <= 0))
    ]


class AddedMass(ForceLaw):
    """Mass that the model lacks at a DOF, ``R = dm a``: a wrong known mass, a load,
    moved water.
    """

    name = "added_mass"
    family = "inertia"
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
    columns = (Term("k", "s", "N/m"), Term("c", "v", "N s/m"))
    passive = True
    acts_at = ("new link",)
    nonnegative = ("k", "c")

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s
        out[1] = v


class BendingCoupling(ForceLaw):
    """Coupling of two neighbouring storeys by bending, ``R = -kb s`` between floors two
    apart.

    The stiffness matrix of a frame that bends has positive terms two off its diagonal:
    floors two apart push each other away, where a brace (:class:`LinkSpringDashpot`)
    holds them together. Its share in the storeys' own stiffness is part of their linear
    springs.
    """

    name = "bending_coupling"
    family = "coupling"
    columns = (Term("kb", "-s", "N/m"),)
    variable = "s"
    acts_at = ("two storeys",)
    nonnegative = ("kb",)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = -s


class HiddenOscillator(ForceLaw):
    r"""Oscillator that hangs on a DOF and is not measured: a tuned mass damper,
    sloshing water.

    .. math::
        R = m \, [2 \zeta \omega (v - \dot w) + \omega^2 (s - w)], \quad
        \ddot w = 2 \zeta \omega (v - \dot w) + \omega^2 (s - w) - a_g

    w is its displacement relative to the ground; it begins every record moving with the
    DOF. The update is exact for a motion that is cubic in time over a step. Very stiff
    it is :class:`AddedMass`.

    The base acceleration a_g is the covariate of that name (held at its mean between
    samples), and zero if none is named. A search does not try it under base excitation
    alone, where any inertia fits.
    """

    name = "hidden_oscillator"
    family = "oscillator"
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
        omega: Given = None,
        zeta: Given = None,
        m: Given = None,
        covariate: str | None = None,
    ) -> None:
        if covariate is not None:
            self.covariates, self.covariate_units = (covariate,), ("m/s^2",)  # type: ignore[misc]
            self.symmetry, self.at_rest, self.passive = "none", None, False  # type: ignore[misc]
        super().__init__({"omega": omega, "zeta": zeta}, {"m": m})

    def options(self) -> dict[str, Any]:
        return {"covariate": self.covariates[0]} if self.covariates else {}

    def limit(self, drift: float, band: tuple[float, float]) -> str:
        """A tie where the band lies above its resonance and the mass stands still; an
        added mass if it lies below.
        """
        low, high = 2.0 * np.pi * np.asarray(band)
        omega = self.shape["omega"] or low
        return (
            "link" if omega < low else AddedMass.family if omega > high else self.family
        )

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = -theta[0] * (2.0 * theta[1] * z[1] + theta[0] * z[0])

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        if dt == 0.0:
            return
        square, damping = theta[0] * theta[0], 2.0 * theta[1] * theta[0]
        # s is s0 + v0 t + c2 t^2 + c3 t^3; its acceleration drives w - s, of which b0 +
        # b1 t is one solution
        rate = (s1 - s0) / dt
        c2, c3 = (3.0 * rate - 2.0 * v0 - v1) / dt, (v0 + v1 - 2.0 * rate) / (dt * dt)
        ground = u[0] if u.size else 0.0
        b1 = -6.0 * c3 / square
        b0 = (-2.0 * c2 - ground - damping * b1) / square
        y, dy = z[0] - b0, z[1] - b1
        inside = 1.0 - theta[1] * theta[1]
        fast = theta[0] * math.sqrt(max(abs(inside), 1e-12))
        fall = math.exp(-theta[1] * theta[0] * dt)
        phase = fast * dt
        c, d = math.cos(phase), math.sin(phase) / fast
        if inside < 0.0:
            c, d = math.cosh(min(phase, 300.0)), math.sinh(min(phase, 300.0)) / fast
        both = dy + theta[1] * theta[0] * y
        z[0] = b0 + b1 * dt + fall * (c * y + d * both)
        z[1] = b1 + fall * (c * dy - d * (square * y + theta[1] * theta[0] * dy))
