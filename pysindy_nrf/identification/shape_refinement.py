"""Shape parameters of laws by instrumental variables."""

from __future__ import annotations

import numpy as np

from ..chain.identifiability import SolveOrder
from ..equations.chain_solve import model_of, solve
from ..exceptions import IdentifiabilityError, LawError
from ..records.dataset import Dataset
from .instrumental_variables import IVResult, instrumental_variables
from .problem import Problem
from .shape_derivatives import ShapeDerivatives, shape_derivatives

# On the scale of the search: logarithms, and shares of the range of what may be zero.
MAX_STEP = 1.0
# A step that counts as rest:
SETTLED = 0.01
MAX_PASSES = 6


def refine_shapes(
    asked: Problem, problem: Problem, order: SolveOrder, data: Dataset, iv: IVResult
) -> tuple[Problem, IVResult]:
    """Estimate again with other shape parameters, while their steps contract.

    Lines of a spectrum and instants keep their values: other means find them better.

    Parameters
    ----------
    asked : Problem
        As declared, with the shape parameters that are free.
    problem : Problem
        With the values that least squares found.
    order : SolveOrder
    data : Dataset
    iv : IVResult
        Estimate with these values.

    Returns
    -------
    problem : Problem
    iv : IVResult
        With the values of the last pass that led to a settled estimate.
    """
    largest = MAX_STEP
    for _ in range(MAX_PASSES):
        derivatives = shape_derivatives(asked, problem, data)
        if derivatives is None:
            break
        try:
            step = _step(derivatives, order, data, iv)
        except (IdentifiabilityError, LawError):
            break

        search = derivatives.search
        u = np.clip(derivatives.u + step, search.low, search.high)
        unit = np.where(search.scale.log, 1.0, search.high - search.low)
        size = float(np.max(np.abs(u - derivatives.u) / unit))
        if not size <= largest:
            break
        largest = max(size, SETTLED)

        trial = problem.with_laws(search.trial(u).laws)
        start = model_of(trial.layout, iv.solution)
        try:
            refined = instrumental_variables(start, data, trial, order)
        except IdentifiabilityError:
            break
        if not refined.settled:
            break

        problem = trial
        iv = refined
        if size <= SETTLED:
            break
    return problem, iv


def _step(
    derivatives: ShapeDerivatives, order: SolveOrder, data: Dataset, iv: IVResult
) -> np.ndarray:
    """Gauss-Newton step of the shape parameters, on the scale of the search.

    Derivatives along the measured motion are columns, those along the free run
    instruments. Parameters that would leave their range keep their values, and the
    others follow.
    """
    while True:
        pieces = derivatives.pieces(
            order, data, iv.model.coefficients, iv.runs, iv.whiteners
        )
        known_masses = derivatives.problem.known_masses
        solution = solve(pieces.sum().projected(), order, known_masses)
        step = derivatives.steps(solution)

        ends = derivatives.search.at_end(derivatives.u)
        leaving = [int(k) for k in np.flatnonzero(step * ends > 0)]
        if not leaving:
            return step
        derivatives = derivatives.without(leaving)
        if not derivatives.numbers:
            return np.zeros(len(step))
