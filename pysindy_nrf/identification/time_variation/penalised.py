r"""Coefficients that follow courses in time, by penalised least squares.

.. math::
    \min \sum_j w_j \lVert F_j - \sum_c \phi_{jc} \, (B_c \gamma_c) \rVert^2
    + \sum_c \lambda_c \gamma_c^T S_c \gamma_c

The strengths :math:`\lambda` maximise the restricted likelihood: the steps of Fellner
and Schall (Wood and Fasiolo, Biometrics 73, 2017). The bands are those of the posterior
covariance (Wahba 1983; Nychka 1988 on their coverage).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from .neighbours import LEAST_LEFT, NEIGHBOURS, together
from .splines import Course

# Strengths of a penalty, over the information of its coefficient: beyond them the
# course is a straight line, or free.
WEAKEST, STRONGEST = 1e-6, 1e6
MAX_STEPS = 60
# Added to the unit diagonal of the scaled normal equations.
ROUND_OFF = 1e-12
# Relative change of a strength that ends the search.
SETTLED = 0.02


@dataclass(frozen=True, eq=False)
class PenalisedFit:
    """A solved system.

    Attributes
    ----------
    products : ndarray of shape (n_pieces, n + 1, n + 1)
        Of unit noise.
    courses : sequence of Course
        One for each unknown.
    strengths : ndarray of shape (n_unknowns,)
    coefficients : ndarray of shape (n_functions,)
        Of all courses, one after the other.
    covariance : ndarray of shape (n_functions, n_functions)
        Posterior.
    shown : ndarray of shape (n_functions, n_functions), optional
        The same with the noise that the pieces show, neighbours together, where it was
        computed.
    """

    products: np.ndarray
    courses: Sequence[Course]
    strengths: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    shown: np.ndarray | None = None

    @property
    def uncertainty(self) -> np.ndarray:
        """Covariance of the coefficients for bands."""
        return self.covariance if self.shown is None else self.shown

    @cached_property
    def places(self) -> list[slice]:
        """Where the coefficients of each unknown stand."""
        return places_of(self.courses)

    def values(self, unknown: int) -> np.ndarray:
        """Course of an unknown in the pieces."""
        return self.courses[unknown].columns @ self.coefficients[self.places[unknown]]

    def variance(self, unknown: int) -> np.ndarray:
        """Its posterior variance."""
        columns = self.courses[unknown].columns
        here = self.places[unknown]
        return np.einsum("pi,ij,pj->p", columns, self.uncertainty[here, here], columns)

    def smoothed(self, unknown: int) -> np.ndarray:
        """What the penalties have taken from a course.

        It is what a second fit to the residual of the first would add (twicing: Tukey,
        Exploratory data analysis, 1977).
        """
        here = self.places[unknown]
        taken = np.zeros(len(self.coefficients))
        for c, course in enumerate(self.courses):
            place = self.places[c]
            pull = self.strengths[c] * course.penalty @ self.coefficients[place]
            taken += self.covariance[:, place] @ pull
        return self.courses[unknown].columns @ taken[here]

    @cached_property
    def over_time(self) -> np.ndarray:
        """All unknowns in the pieces, (n_pieces, n_unknowns)."""
        return np.column_stack([self.values(c) for c in range(len(self.courses))])

    @cached_property
    def scores(self) -> np.ndarray:
        """Products of the residual with each column, (n_pieces, n_unknowns)."""
        return scores_of(self.products, self.over_time)

    def freedom(self, unknown: int) -> float:
        """Effective degrees of freedom of a course."""
        here = self.places[unknown]
        course = self.courses[unknown]
        used = self.strengths[unknown] * np.sum(
            self.covariance[here, here] * course.penalty
        )
        return course.columns.shape[1] - float(used)

    def crossed(self, unknown: int, functions: np.ndarray) -> np.ndarray:
        """Products of further functions of time of an unknown with all courses.

        Parameters
        ----------
        unknown : int
        functions : ndarray of shape (n_pieces, n)

        Returns
        -------
        ndarray of shape (n_functions, n)
        """
        lines = self.products[:, unknown, :-1]
        blocks = []
        for c, course in enumerate(self.courses):
            blocks.append(course.columns.T @ (lines[:, c, None] * functions))
        return np.concatenate(blocks)

    def by_function(self, scores: np.ndarray) -> np.ndarray:
        """Scores (n_pieces, n_unknowns) with each function of each course."""
        blocks = []
        for c, course in enumerate(self.courses):
            blocks.append(course.columns * scores[:, c, None])
        return np.hstack(blocks)


def two_stage(fit: PenalisedFit, crossed: np.ndarray) -> PenalisedFit:
    """Two-stage least squares with the columns of a fit as instruments.

    Strengths are those of the fit.

    Parameters
    ----------
    fit : PenalisedFit
        Along the instruments.
    crossed : ndarray of shape (n_pieces, n, n + 1)
        Products of the instruments with the columns that they stand for, and with the
        right-hand side, last; of unit noise.
    """
    instruments = _in_functions(fit.products, fit.courses)
    columns = _in_functions(crossed, fit.courses)
    target = fit.by_function(crossed[:, :, -1]).sum(axis=0)
    penalties = []
    for strength, course in zip(fit.strengths, fit.courses):
        penalties.append(strength * course.penalty)

    unit = np.sqrt(np.diag(instruments))
    over = np.outer(unit, unit)
    ridge = ROUND_OFF * np.eye(len(unit))
    explained = np.linalg.solve(instruments / over + ridge, columns / over)
    information = (columns / over).T @ explained + linalg.block_diag(*penalties) / over
    covariance = np.linalg.inv(information + ridge) / over
    gain = covariance @ (unit[:, None] * explained.T / unit)
    penalty = linalg.block_diag(*penalties)
    solved = replace(fit, coefficients=gain @ target, covariance=covariance)

    weights = np.column_stack([-solved.over_time, np.ones(len(crossed))])
    scores = np.matmul(crossed, weights[:, :, None])[:, :, 0]
    n_absorbed = sum(fit.freedom(c) for c in range(len(fit.courses)))
    left = 1 - n_absorbed * (NEIGHBOURS + 1) / len(crossed)
    noise = together(solved.by_function(scores)) / max(left, LEAST_LEFT)
    shown = gain @ noise @ gain.T + covariance @ penalty @ covariance
    return replace(solved, shown=shown)


def _in_functions(products: np.ndarray, courses: Sequence[Course]) -> np.ndarray:
    """Products (n_pieces, n, n) of columns as those of the functions of courses."""
    rows = []
    for c, course in enumerate(courses):
        blocks = []
        for d, other in enumerate(courses):
            weighted = products[:, c, d, None] * other.columns
            blocks.append(course.columns.T @ weighted)
        rows.append(np.hstack(blocks))
    return np.vstack(rows)


def scores_of(products: np.ndarray, over_time: np.ndarray) -> np.ndarray:
    """Products of the residual of coefficients with each column, in the pieces."""
    weights = np.column_stack([-over_time, np.ones(len(products))])
    return np.matmul(products[:, :-1], weights[:, :, None])[:, :, 0]


def places_of(courses: Sequence[Course]) -> list[slice]:
    """Where the coefficients of each course stand, one after the other."""
    ends = np.cumsum([course.columns.shape[1] for course in courses]).tolist()
    return [slice(start, stop) for start, stop in zip([0, *ends[:-1]], ends)]


def fitted(
    products: np.ndarray,
    courses: Sequence[Course],
    strengths: np.ndarray | None = None,
    search: bool = True,
) -> PenalisedFit:
    """Solve, with the strengths of the penalties by restricted likelihood.

    ``strengths`` are where the search begins; they are kept without a search.
    """
    system = _System.of(products, courses)
    penalised = [c for c, course in enumerate(courses) if course.rank]
    now = system.first_strengths()
    if strengths is not None:
        now = system.in_bounds(strengths)
    solution = system.solved(now)
    for _ in range(MAX_STEPS if search and penalised else 0):
        following = system.next_strengths(now, solution, penalised)
        change = np.abs(np.log(following[penalised] / now[penalised])).max()
        now = following
        solution = system.solved(now)
        if change < SETTLED:
            break
    return PenalisedFit(products, courses, now, *solution)


_Solution = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations of the coefficients of all courses."""

    information: np.ndarray
    target: np.ndarray
    courses: Sequence[Course]
    places: list[slice]
    ranks: list[int]

    @classmethod
    def of(cls, products: np.ndarray, courses: Sequence[Course]) -> _System:
        places = places_of(courses)
        constants = np.array([c.columns.shape[1] == 1 for c in courses])
        n_functions = places[-1].stop
        information = np.zeros((n_functions, n_functions))
        target = np.zeros(n_functions)
        starts = np.array([place.start for place in places])

        # constants with constants
        total = products.sum(axis=0)
        fixed = np.flatnonzero(constants)
        fixed_starts = starts[fixed]
        information[fixed_starts[:, None], fixed_starts] = total[fixed[:, None], fixed]
        target[fixed_starts] = total[fixed, -1]
        for c in np.flatnonzero(~constants).tolist():
            columns = courses[c].columns
            lines = columns.T @ products[:, c]
            here = places[c]
            target[here] = lines[:, -1]
            information[here, fixed_starts] = lines[:, fixed]
            information[fixed_starts, here] = lines[:, fixed].T
            for d in np.flatnonzero(~constants).tolist():
                if d < c:
                    continue
                block = columns.T @ (products[:, c, d, None] * courses[d].columns)
                information[here, places[d]] = block
                information[places[d], here] = block.T
        ranks = [course.rank for course in courses]
        return cls(information, target, courses, places, ranks)

    def scale(self, c: int) -> float:
        """Information of a course, a function of it, over its penalty."""
        here = self.places[c]
        penalty = np.trace(self.courses[c].penalty)
        return float(np.trace(self.information[here, here]) / max(penalty, 1e-300))

    def first_strengths(self) -> np.ndarray:
        strengths = np.zeros(len(self.courses))
        for c, rank in enumerate(self.ranks):
            if rank:
                strengths[c] = self.scale(c)
        return strengths

    def in_bounds(self, strengths: np.ndarray) -> np.ndarray:
        """Strengths between the weakest and the strongest; zero without a penalty."""
        bounded = np.zeros(len(self.courses))
        for c, rank in enumerate(self.ranks):
            if rank:
                scale = self.scale(c)
                low, high = WEAKEST * scale, STRONGEST * scale
                bounded[c] = np.clip(strengths[c], low, high)
        return bounded

    def next_strengths(
        self, now: np.ndarray, solution: _Solution, penalised: list[int]
    ) -> np.ndarray:
        """A step of Fellner and Schall."""
        coefficients, covariance = solution
        following = now.copy()
        for c in penalised:
            here = self.places[c]
            penalty = self.courses[c].penalty
            rough = float(coefficients[here] @ penalty @ coefficients[here])
            prior = self.ranks[c] / now[c]
            posterior = float(np.sum(covariance[here, here] * penalty))
            factor = max(prior - posterior, 1e-12 * prior) / max(rough, 1e-300)
            following[c] = now[c] * factor
        return self.in_bounds(following)

    def solved(self, strengths: np.ndarray) -> _Solution:
        """Coefficients and posterior covariance."""
        matrix = self.information.copy()
        for c, strength in enumerate(strengths):
            if self.ranks[c]:
                here = self.places[c]
                matrix[here, here] += strength * self.courses[c].penalty

        unit = np.sqrt(np.diag(matrix))
        scaled = matrix / unit / unit[:, None] + ROUND_OFF * np.eye(len(unit))
        factor = linalg.cho_factor(scaled, lower=True, check_finite=False)
        inverse = linalg.cho_solve(factor, np.eye(len(unit)), check_finite=False)
        covariance = inverse / unit / unit[:, None]
        return covariance @ self.target, covariance
