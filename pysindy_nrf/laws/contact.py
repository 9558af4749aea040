"""Springs that are in contact only part of the time: bumpers, cracks, loose joints."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from ..exceptions import LawError
from .base import ForceLaw, Symmetry, Term
from .shape import Shape

_GAP = Shape("gap", "m", 0.05, 4.0, "s")
OUT_OF_REACH = 1e3  # m, half of a play whose other stop no drift reaches


class _Contact(ForceLaw):
    """Base of springs in contact only part of the time."""

    family = "contact"
    symmetry: Symmetry = "none"
    passive = True
    variable = "s"
    nonnegative: tuple[str, ...] = ("k",)


class _OneSided(_Contact):
    """A spring that acts on one side only."""

    labels: ClassVar[Mapping[int, str]]  # of its term, by side

    def __init__(
        self, shape: Mapping[str, float | None], k: float | None, side: int
    ) -> None:
        if side not in (1, -1):
            raise LawError(
                f"{type(self).__name__}: side={side!r} is unknown",
                "Give 1 or -1, the sign of the drift.",
            )
        self.side = int(side)
        super().__init__(shape, {"k": k})

    def options(self) -> dict[str, object]:
        return {"side": self.side}

    def terms(self) -> tuple[Term, ...]:
        return (Term("k", self.labels[self.side], "N/m"),)

    @property
    def theta(self) -> np.ndarray:
        return np.append(super().theta, self.side)


class Bilinear(_Contact):
    """Breathing crack: a spring for positive drift only, ``R = dk max(s, 0)``.

    dk may have either sign. With a linear spring k the stiffness is k + dk for s > 0
    and k for s < 0 (Chondros, Dimarogonas, Yao, J. Sound Vib. 239, 2001).
    """

    name = "bilinear"
    columns = (Term("dk", "max(s, 0)", "N/m"),)
    nonnegative = ()

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.maximum(s, 0.0)


class OneSidedGap(_OneSided):
    r"""Bumper on one side: a spring that acts beyond a gap.

    .. math:: R = k \max(s - g, 0) \quad\text{or}\quad R = k \min(s + g, 0)

    Parameters
    ----------
    gap : float, optional
        Free travel g until contact, m; estimated if None.
    k : float, optional
        Stiffness of the bumper, N/m.
    side : {1, -1}
        Sign of the drift that the bumper limits.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.OneSidedGap(gap=0.002, k=1e6, side=-1).equation(3))
    1e+06 min(s3 + gap, 0)  (gap = 0.002 m)
    """

    name = "one_sided_gap"
    shapes = (_GAP,)
    labels = {1: "max(s - gap, 0)", -1: "min(s + gap, 0)"}
    special_cases = {Bilinear: lambda c: OneSidedGap(1e-12, c.values[0])}

    def __init__(
        self, gap: float | None = None, k: float | None = None, side: int = 1
    ) -> None:
        super().__init__({"gap": gap}, k, side)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = theta[1] * np.maximum(theta[1] * s - theta[0], 0.0)


class PreloadedContact(_OneSided):
    r"""Contact under preload that opens: a spring compressed by u at s = 0.

    .. math:: R = k \max(s, -u) \quad\text{or}\quad R = k \min(s, u)

    Beyond u there is no contact. The preload itself is in equilibrium at s = 0 and not
    counted; u = 0 is the breathing crack of :class:`Bilinear`.
    """

    name = "preloaded_contact"
    shapes = (Shape("u", "m", 0.05, 4.0, "s"),)
    labels = {1: "max(s, -u)", -1: "min(s, u)"}
    special_cases = {Bilinear: lambda c: PreloadedContact(1e-12, c.values[0])}

    def __init__(
        self, u: float | None = None, k: float | None = None, side: int = 1
    ) -> None:
        super().__init__({"u": u}, k, side)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = theta[1] * np.maximum(theta[1] * s, -theta[0])


class TwoSidedGap(_Contact):
    r"""Stops on both sides: a spring that acts beyond an equal gap.

    .. math:: R = k \, (s - \min(\max(s, -g), g))
    """

    name = "two_sided_gap"
    symmetry = "odd"
    shapes = (_GAP,)
    columns = (Term("k", "beyond(s, gap)", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.maximum(s - theta[0], 0.0) + np.minimum(s + theta[0], 0.0)


class SofteningKnee(_Contact):
    r"""Spring that softens beyond a drift: a rocking wall, a joint that opens.

    .. math:: R = -\Delta k \, (s - \min(\max(s, -u), u))

    With a linear spring k the stiffness is k up to the drift u, then k less dk.
    """

    name = "softening_knee"
    symmetry = "odd"
    shapes = (Shape("u", "m", 0.05, 4.0, "s"),)
    columns = (Term("dk", "-beyond(s, u)", "N/m"),)
    nonnegative = ("dk",)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.minimum(theta[0] - s, 0.0) + np.maximum(-theta[0] - s, 0.0)


class DeadZone(_Contact):
    r"""Backlash of a loose joint: no force while the drift is inside the play.

    .. math:: R = k \, (s - \min(\max(s, g (c - 1)), g (c + 1)))

    The play is 2 g wide and reaches from ``g (c - 1)`` to ``g (c + 1)``; c = 0 is
    :class:`TwoSidedGap`. (A backlash that lags its input, the play operator, would
    return more energy than it takes, so it cannot be a restoring force.)
    """

    name = "dead_zone"
    shapes = (_GAP, Shape("centre", "1", -0.95, 0.95, log=False))
    columns = (Term("k", "beyond(s, gap, centre)", "N/m"),)
    special_cases = {
        TwoSidedGap: lambda c: DeadZone(c.theta[0], 0.0, c.values[0]),
        OneSidedGap: lambda c: DeadZone(
            OUT_OF_REACH, c.side * (c.theta[0] / OUT_OF_REACH - 1.0), c.values[0]
        ),
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        low = theta[0] * (theta[1] - 1.0)
        high = theta[0] * (theta[1] + 1.0)
        out[0] = np.maximum(s - high, 0.0) + np.minimum(s - low, 0.0)
