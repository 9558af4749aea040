"""Forces whose channel is not linear or not steady.

A function of the force is named where it explains more of what an equation of motion
leaves than all further laws of the sites there together: in the fit to all windows, and
on windows held out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.unit_system import UnitSystem
from .gram_least_squares import held_out_residual, left_over, solved
from .sample_windows import FOLDS, LASTING

# Share of the rms of the force, or of its gain, below which a fault does not matter.
LEAST_SIZE = 0.01
# Share of the gain or of the rms from which on a fault is none: no amplifier does so.
LARGEST_SIZE = 1.0
# Share of the square of a function that must be no gain of the force, for data to tell
# them apart: blows that only push have no gain of their own for the pull.
DISTINCT = 0.01
# Percent of the residual that a function must remove: most of it, because laws that the
# model lacks look like a distortion too, in a smaller part. Distorted forces of
# tests/diagnosis/test_force_channels.py: 68 to 95 %; beside a friction damper that the
# model lacks 11 %.
LEAST_REDUCTION = 50.0

PUSH_AND_PULL, SATURATION, DEAD_BAND, DRIFT = range(4)


def force_functions(unit: np.ndarray, ramp: np.ndarray) -> np.ndarray:
    """What a channel may add to a force.

    Push against pull, saturation, a dead band, and drift of the gain.

    Parameters
    ----------
    unit : ndarray of shape (n_samples,)
        The force over its rms.
    ramp : ndarray of shape (n_samples,)
        Time, from -1 to 1 over the record.
    """
    return np.array([np.abs(unit), unit**3, np.sign(unit), ramp * unit])


@dataclass(frozen=True)
class ForceGrams:
    """Gram matrices of one equation of motion.

    Attributes
    ----------
    dof : int
    n_own : int
        Columns of the laws and the inertia of the DOF, which stand first.
    n_further : int
        Probe regressors behind them, the last of which are a constant and a ramp;
        behind these stand the functions of the force, and the force over its rms.
    rms, peak : float
        Of the force, N; 0 if none acts, and the inertia stands for it.
    matrices : dict of (int, int) to ndarray of shape (p, p)
        By record and fold.
    """

    dof: int
    n_own: int
    n_further: int
    rms: float
    peak: float
    matrices: dict[tuple[int, int], np.ndarray]

    def total(self) -> np.ndarray:
        """Sum over records and folds."""
        return np.sum(list(self.matrices.values()), axis=0)

    def folds(self) -> np.ndarray:
        """Sums over records, (FOLDS, p, p)."""
        sums = np.zeros((FOLDS, *self.total().shape))
        for (_, fold), matrix in self.matrices.items():
            sums[fold] += matrix
        return sums


def distortions_of(grams: ForceGrams, units: UnitSystem) -> list[str]:
    """A sentence on the function of the force that explains most, if it is one."""
    if {fold for _, fold in grams.matrices} != set(range(FOLDS)):
        return []

    total = grams.total()
    first = grams.n_own + grams.n_further
    # what a function shares with the force is a gain, which noise makes, too
    gains = total[first:-1, -1] / total[-1, -1]
    without_gains = _without_gains(total, first, gains)
    folds = without_gains @ grams.folds() @ without_gains.T

    # a wrong zero or a drift is no fault of the force
    plain = np.r_[: grams.n_own, first - LASTING : first]
    removed_by_laws = _removed(folds, plain, np.arange(first))
    removed_by_function = []
    for function in range(len(gains)):
        columns = np.append(plain, first + function)
        removed_by_function.append(_removed(folds, plain, columns))

    best = int(np.argmax(removed_by_function))
    removed = removed_by_function[best]
    if removed < max(LEAST_REDUCTION, removed_by_laws):
        return []

    columns = np.append(plain, first + best)
    values = solved(without_gains @ total @ without_gains.T, columns)
    c = -float(values[-1])
    c /= 1 - c * gains[best]
    size = _size(best, c, grams.peak / grams.rms)
    if not LEAST_SIZE < abs(size) < LARGEST_SIZE:
        return []
    return [
        f"F{grams.dof}: {_words(best, size, grams.rms, units.force)}, which explains"
        f" {removed:.0f} % of what its balance leaves, and makes masses, stiffness and"
        " damping wrong. Check its amplifier and range. Or does the structure itself do"
        " so?"
    ]


def _removed(folds: np.ndarray, plain: np.ndarray, columns: np.ndarray) -> float:
    """Percent of the residual of plain columns that others remove.

    The less of two: in the fit to all windows, and on windows held out. Laws that
    follow a start from rest badly fail on held-out windows only.
    """
    total = folds.sum(axis=0)

    def residuals_of(numbers: np.ndarray) -> np.ndarray:
        fitted = left_over(total, numbers, solved(total, numbers))
        return np.array([fitted, held_out_residual(folds, numbers)])

    ratios = residuals_of(columns) / np.maximum(residuals_of(plain), 1e-300)
    return float(100.0 * (1.0 - ratios.max()))


def _without_gains(total: np.ndarray, first: int, gains: np.ndarray) -> np.ndarray:
    """Matrix that takes from each function of the force its share of the force."""
    change = np.eye(len(total))
    change[first:-1, -1] = -gains
    remaining = np.einsum("ij,jk,ik->i", change, total, change)[first:-1]
    # of a force of two values, or of one sign, all is a gain
    is_gain_alone = remaining <= DISTINCT * np.diag(total)[first:-1]
    change[first:-1][is_gain_alone] = 0.0
    return change


def _size(function: int, c: float, peak: float) -> float:
    """Size of a fault, as a share of the gain or of the rms force."""
    if function == DEAD_BAND:
        return c
    if function == SATURATION:
        return c * peak**2
    return 2 * c


def _words(function: int, size: float, rms: float, unit: str) -> str:
    """What is wrong with the force."""
    percent = f"{100 * abs(size):.2g} %"
    if function == PUSH_AND_PULL:
        return f"its gain differs by {percent} between push and pull"
    if function == DRIFT:
        return f"its gain drifts by {percent} over the record"
    if function == SATURATION:
        too = "small (saturation)" if size > 0 else "large"
        return f"its peaks are {percent} too {too}"
    force = f"{abs(size) * rms:.3g} {unit}"
    if size > 0:
        return f"it lacks {force} on either side of zero (a dead band)"
    return f"it has {force} too much on either side of zero"
