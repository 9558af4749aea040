"""General laws: sparse sums of atoms, simple functions of the motion at a site.

A search grows them out of a dictionary where it does not know a name. They describe a
curve or a loop by a few hinges, smooth signs or sliders, each with its own size.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import ClassVar

import numpy as np

from ..exceptions import LawError
from .base import Coefficients, ForceLaw, Term

# Kind and numbers of an atom, such as ("slider", gap, uy, direction).
Atom = tuple[str | float, ...]
# Numbers of an atom that the kernel reads: the code of its kind, and three more.
WIDTH = 4
# Internal states of an atom with memory: its elongation, and the distance slid.
STATES = 2
# A bound that no term reaches: both directions of an atom are kept.
UNBOUNDED = 1e300


class SumOfAtoms(ForceLaw):
    """Base of the general laws.

    Parameters
    ----------
    atoms : iterable of (kind, number, ...)
    c : sequence of float, optional
        Coefficients of the atoms.

    Attributes
    ----------
    kinds : dict of str to (int, str, str, bool)
        Of each kind of atom its code, the label with places for its numbers, the unit
        of its coefficient, and whether that cannot be negative.
    """

    kinds: ClassVar[dict[str, tuple[int, str, str, bool]]] = {}
    simplest: ClassVar[Atom] = ()
    symmetry = "none"

    def __init__(
        self, atoms: Iterable[Sequence[str | float]] = (), c: Coefficients = None
    ) -> None:
        self.atoms = [_checked(self, atom) for atom in atoms] or [self.simplest]
        signed = []
        for number, atom in enumerate(self.atoms, 1):
            if self.kinds[str(atom[0])][3]:
                signed.append(f"c{number}")
        self.nonnegative = tuple(signed)
        super().__init__(None, c)

    def options(self) -> dict[str, object]:
        """The atoms as plain data."""
        return {"atoms": [list(atom) for atom in self.atoms]}

    def terms(self) -> tuple[Term, ...]:
        """One for each atom."""
        terms = []
        for number, atom in enumerate(self.atoms, 1):
            _, label, unit, _ = self.kinds[str(atom[0])]
            terms.append(Term(f"c{number}", label.format(*atom[1:]), unit))
        return tuple(terms)

    @property
    def theta(self) -> np.ndarray:
        """Code and numbers of each atom."""
        numbers = np.zeros((len(self.atoms), WIDTH))
        for row, atom in zip(numbers, self.atoms):
            row[0] = self.kinds[str(atom[0])][0]
            row[1 : len(atom)] = atom[1:]
        return numbers.ravel()

    def __hash__(self) -> int:
        return hash((type(self), tuple(self.atoms)))

    def __eq__(self, other: object) -> bool:
        return super().__eq__(other)


def _checked(law: SumOfAtoms, atom: Sequence[str | float]) -> Atom:
    """An atom as a tuple of its kind and numbers."""
    kind, numbers = str(atom[0]), [float(x) for x in atom[1:]]
    if kind not in law.kinds:
        raise LawError(
            f"{type(law).__name__} has no atom {kind!r}",
            f"It has {', '.join(law.kinds)}.",
        )
    return (kind, *numbers)


def _one_direction(values, direction):
    """The positive part of a term, its negative part, or both."""
    low = 0.0 if direction > 0.0 else -UNBOUNDED
    high = 0.0 if direction < 0.0 else UNBOUNDED
    return np.minimum(np.maximum(values, low), high)


class GeneralCurve(SumOfAtoms):
    r"""A general function of drift and rate.

    Its atoms are

    - ``("hinge", u, direction)``: :math:`\operatorname{sgn} s \max(|s| - u, 0)`, a bend
      of the spring; on one side alone where ``direction`` is 1 or -1;
    - ``("sign", w, direction)``: :math:`\tanh(v / w)`, friction; of one direction
      alone where ``direction`` is 1 or -1;
    - ``("wedge", w, direction)``: :math:`|s| \tanh(v / w)`, friction that grows with
      the drift;
    - ``("knee", w, direction)``: :math:`\operatorname{sgn} v \max(|v| - w, 0)`, a bend
      of the damper;
    - ``("drift rate",)``: :math:`|s| v`.

    Parameters
    ----------
    atoms : iterable of (kind, number, ...)
        Drifts in m, rates in m/s.
    c : sequence of float, optional
        Coefficients of the atoms.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> atoms = [("hinge", 0.002, 1), ("sign", 0.01, 0)]
    >>> print(laws.GeneralCurve(atoms, [4e4, 20.0]).equation(1))
    4e+04 hinge[s1; 0.002, +1] + 20 sign[v1; 0.01, +0]
    """

    name = "general_curve"
    family = "curve"
    kinds = {
        "hinge": (0, "hinge[s; {:.4g}, {:+.0f}]", "N/m", False),
        "sign": (1, "sign[v; {:.4g}, {:+.0f}]", "N", True),
        "wedge": (2, "wedge[s v; {:.4g}, {:+.0f}]", "N/m", True),
        "knee": (3, "knee[v; {:.4g}, {:+.0f}]", "N s/m", False),
        "drift rate": (4, "|s| v", "N s/m^2", False),
    }
    simplest = ("hinge", 0.0, 1.0)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        for k in range(theta.size // 4):
            code = int(theta[4 * k])
            size = theta[4 * k + 1]
            direction = theta[4 * k + 2]
            if code == 0:
                beyond = np.sign(s) * np.maximum(np.abs(s) - size, 0.0)
                out[k] = _one_direction(beyond, direction)
            elif code == 1:
                out[k] = _one_direction(np.tanh(v / size), direction)
            elif code == 2:
                out[k] = _one_direction(np.abs(s) * np.tanh(v / size), direction)
            elif code == 3:
                beyond = np.sign(v) * np.maximum(np.abs(v) - size, 0.0)
                out[k] = _one_direction(beyond, direction)
            else:
                out[k] = np.abs(s) * v


class GeneralHysteresis(SumOfAtoms):
    r"""A general hysteresis: sliders behind a backlash, and branches that relax.

    Its atoms are

    - ``("slider", gap, uy, direction)``: a slider that yields at the drift ``uy``
      behind a backlash of ``gap`` (:class:`BacklashFriction`); its force in one
      direction alone where ``direction`` is 1 or -1;
    - ``("degrading", uy, path)``: a slider whose strength falls with the distance slid,
      :math:`e^{-l / \text{path}}`;
    - ``("pinched", uy, w)``: a slider that slips freely near the middle,
      :math:`|s| / (|s| + w)`;
    - ``("branch", tau)``: a spring in series with a dashpot (:class:`MaxwellBranch`).

    Parameters
    ----------
    atoms : iterable of (kind, number, ...)
        Drifts in m, times in s.
    c : sequence of float, optional
        Coefficients of the atoms.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> two_strengths = [
    ...     ("slider", 0.001, 0.0004, 1),
    ...     ("slider", 0.001, 0.0004, -1),
    ... ]
    >>> laws.GeneralHysteresis(two_strengths, [9900.0, 16500.0]).values.tolist()
    [9900.0, 16500.0]
    """

    name = "general_hysteresis"
    family = "hysteresis"
    kinds = {
        "slider": (0, "slider[s; {:.4g}, {:.4g}, {:+.0f}]", "N", True),
        "degrading": (1, "degrading[s; {:.4g}, {:.4g}]", "N", True),
        "pinched": (2, "pinched[s; {:.4g}, {:.4g}]", "N", True),
        "branch": (3, "branch[s; {:.4g}]", "N/m", True),
    }
    simplest = ("slider", 0.0, 1.0, 1.0)

    def __init__(
        self, atoms: Iterable[Sequence[str | float]] = (), c: Coefficients = None
    ) -> None:
        super().__init__(atoms, c)
        self.n_states = STATES * len(self.atoms)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        for k in range(theta.size // 4):
            code = int(theta[4 * k])
            state = z[2 * k]
            if code == 0:
                gap = theta[4 * k + 1]
                uy = theta[4 * k + 2]
                beyond = np.minimum(np.maximum((np.abs(state) - gap) / uy, 0.0), 1.0)
                out[k] = _one_direction(np.sign(state) * beyond, theta[4 * k + 3])
            elif code == 1:
                slid = np.minimum(z[2 * k + 1] / theta[4 * k + 2], 700.0)
                out[k] = state / theta[4 * k + 1] * np.exp(-slid)
            elif code == 2:
                free = theta[4 * k + 2]
                out[k] = state / theta[4 * k + 1] * np.abs(s) / (np.abs(s) + free)
            else:
                out[k] = state

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        for k in range(theta.size // 4):
            code = int(theta[4 * k])
            before = z[2 * k]
            if code < 3:
                reach = theta[4 * k + 1]
                if code == 0:
                    reach += theta[4 * k + 2]
                moved = before + (s1 - s0)
                z[2 * k] = min(max(moved, -reach), reach)
                z[2 * k + 1] += abs(moved - z[2 * k])
            elif dt <= 0.0:
                z[2 * k] = before + (s1 - s0)
            else:
                # exact for a drift that is linear in time over the step
                x = dt / theta[4 * k + 1]
                mean = -math.expm1(-x) / x if x > 1e-8 else 1.0
                z[2 * k] = before * math.exp(-x) + (s1 - s0) * mean
