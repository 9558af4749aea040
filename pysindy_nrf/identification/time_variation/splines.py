"""Courses in time: a penalised spline, and steps added to it.

P-splines of Eilers and Marx, Statistical Science 11, 1996: B-splines on equidistant
knots, and a penalty on the differences of their coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

# Degree of the splines, and order of the differences that are penalised: without
# curvature the course is a straight line.
DEGREE = 3
DIFFERENCES = 2
# Least pieces of a record between two knots.
PIECES_A_KNOT = 8
# Knots of the longest record, at most. Penalised splines hardly depend on it.
MAX_INTERVALS = 24


@dataclass(frozen=True, eq=False)
class Course:
    """Functions of time whose combination a coefficient follows.

    Attributes
    ----------
    columns : ndarray of shape (n_pieces, n_functions)
        Their values in the middle of each piece.
    penalty : ndarray of shape (n_functions, n_functions)
        Zero for a coefficient that does not change.
    """

    columns: np.ndarray
    penalty: np.ndarray

    @property
    def rank(self) -> int:
        """Rank of the penalty."""
        return int(np.linalg.matrix_rank(self.penalty)) if self.penalty.any() else 0

    def with_step(self, piece: int) -> Course:
        """The same with a step at the beginning of a piece, which is not penalised."""
        after = (np.arange(len(self.columns)) >= piece).astype(float)
        columns = np.column_stack([self.columns, after])
        penalty = np.pad(self.penalty, ((0, 1), (0, 1)))
        return Course(columns, penalty)


def constant(n_pieces: int) -> Course:
    """The course of a coefficient that does not change."""
    return Course(np.ones((n_pieces, 1)), np.zeros((1, 1)))


def p_spline(middles: np.ndarray, max_intervals: int = MAX_INTERVALS) -> Course:
    """Penalised spline over the middles of pieces."""
    n_pieces = len(middles)
    n_intervals = max(4, min(max_intervals, n_pieces // PIECES_A_KNOT))
    share = (middles - middles[0]) / (middles[-1] - middles[0])
    inner = np.arange(-DEGREE, n_intervals + DEGREE + 1) / n_intervals
    columns = BSpline.design_matrix(
        np.clip(share, 0.0, 1.0 - 1e-12), inner, DEGREE
    ).toarray()
    differences = np.diff(np.eye(columns.shape[1]), DIFFERENCES, axis=0)
    return Course(columns, differences.T @ differences)
