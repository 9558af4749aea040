r"""Instrumental variables from the free run of the model itself.

:math:`Z^T (y - \Phi \theta) = 0` with Z the columns of the simulated motion, repeated
two or three times (Young, Refined instrumental variable methods, 1976). First
instruments are one sample late, which keeps white force noise out; later runs use the
corrected force (:mod:`.noise_spectra`), so that equations can be weighted by frequency.
The motion must not be shrunk towards a prior, as the joint step of
:class:`~pysindy_nrf.KinematicSmoother` does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..chain.identifiability import SolveOrder
from ..chain.model import ChainModel
from ..equations.accumulation import pieces_of
from ..equations.chain_solve import Solution, model_of, solve
from ..equations.normal_equations import NormalEquations
from ..exceptions import IdentifiabilityError, NRFError, SimulationError
from ..records.dataset import Dataset, Segment
from .instruments import (
    LEAST_CORRELATION,
    EquationWeights,
    InstrumentRuns,
    Instruments,
    Whiteners,
)
from .problem import Problem
from .residual_along_runs import residual_along

MAX_ROUNDS = 8
# Rounds before the equations are weighted.
PLAIN_ROUNDS = 1
# Relative change of every mass below which the rounds end. Instruments of any model
# give estimates that noise does not bias; those of a better one scatter less.
SETTLED = 1e-3
# Relative change of a mass above which the noise is estimated again.
OTHER_NOISE = 1e-2
# Relative change of a mass in the last round above which the rounds diverged.
DIVERGED = 1e-2
# Allowed fall of the correlation with the motion below that of the best round, or of
# least squares.
CORRELATION_DROP = 0.05

CURE = (
    "Lower the degree, add the law that is missing, or give records with longer or"
    " cleaner channels."
)
CURE_OF_FORCES = "Give a record in which every force was measured."


@dataclass(frozen=True)
class IVResult:
    """Result of the instrumental variables.

    Attributes
    ----------
    model : ChainModel
    solution : Solution
        Its masses and coefficients, balance by balance.
    pieces : NormalEquations
        With the last instruments, piece by piece.
    rounds : int
        Rounds of simulation and solve.
    correlation : float
        Of simulated and measured accelerations in the last round.
    notes : tuple of str
        Remarks for the user, e.g. on records left out.
    doubts : tuple of str
        Why an earlier round was kept, as a warning to the user.
    runs : list of Segment or None
        By record, the motion that gave the last instruments.
    whiteners : mapping of tuple of int to Whitener, optional
        Weights of the equations by frequency in the last round.
    settled : bool
        False if the rounds diverged and an earlier one was kept.
    moved : ndarray of shape (n_dof,), optional
        Relative change of each mass in a last round that did not converge.
    """

    model: ChainModel
    solution: Solution
    pieces: NormalEquations
    rounds: int
    correlation: float
    notes: tuple[str, ...]
    runs: list[Segment | None]
    whiteners: Whiteners | None = None
    doubts: tuple[str, ...] = ()
    settled: bool = True
    moved: np.ndarray | None = None

    def judged(self, data: Dataset) -> Dataset:
        """Motions of the free runs, with forces that leave the measured residuals."""
        measured = []
        simulated = []
        for segment, run in zip(data.segments, self.runs):
            if run is not None:
                measured.append(segment)
                simulated.append(run)
        judged = residual_along(self.model, measured, simulated)
        return Dataset(judged, data.n_samples)


@dataclass(frozen=True)
class _Judged:
    """An estimate and how its free run follows the motion."""

    result: IVResult
    correlation: float
    corrected_forces: bool


def instrumental_variables(
    start: ChainModel, data: Dataset, problem: Problem, solve_order: SolveOrder
) -> IVResult:
    """Iterated instrumental variables for all strategies and laws.

    Parameters
    ----------
    start : ChainModel
        By least squares.
    data : Dataset
    problem : Problem
        With values for all shape parameters.
    solve_order : SolveOrder

    Raises
    ------
    IdentifiabilityError
        Where no free run can serve as an instrument; least squares does as well.
    """
    instruments = Instruments(data, problem, solve_order)
    if not instruments.usable:
        raise IdentifiabilityError(
            "in every record the force on some DOF is unknown, and a free run needs all"
            " forces",
            CURE_OF_FORCES,
        )

    rounds = _Rounds(instruments, start)
    failure = rounds.iterate()
    best = rounds.best
    if failure is None:
        return rounds.final_result()

    least = max(rounds.first_correlation - CORRELATION_DROP, LEAST_CORRELATION)
    if best is None or best.correlation < least:
        raise IdentifiabilityError(failure.what, failure.cure) from failure

    doubt = (
        f"estimation='iv' stopped after round {rounds.number}: {failure.what}. The"
        f" estimate of round {best.result.rounds} is kept; its free run has the highest"
        f" correlation with the measured motion ({best.correlation:.2f})."
    )
    return replace(best.result, settled=False, doubts=(doubt,))


class _Rounds:
    """Rounds of simulation and solve, from a first model until the masses settle."""

    def __init__(self, instruments: Instruments, start: ChainModel) -> None:
        self.instruments = instruments
        self.start = start
        self.number = 0
        self.first_correlation = -1.0
        self.last: IVResult | None = None
        self.best: _Judged | None = None
        self.moved = np.zeros(0)
        self.weights: EquationWeights | None = None

    @property
    def change(self) -> float:
        """Largest relative change of a mass in the last round."""
        return float(self.moved.max())

    def iterate(self) -> NRFError | None:
        """Go through the rounds; the reason if they ended without a sound estimate."""
        for number in range(1, MAX_ROUNDS + 1):
            self.number = number
            try:
                runs = self._simulate()
                self._judge(runs)
                self._solve(runs)
            except (SimulationError, IdentifiabilityError) as failure:
                return failure
            if self._is_settled():
                break
        return self._doubt_of_last(runs)

    def final_result(self) -> IVResult:
        """Result of the last round."""
        assert self.last is not None  # there is a failure otherwise
        if self.change >= SETTLED:
            return replace(self.last, moved=self.moved)
        return self.last

    def _simulate(self) -> InstrumentRuns:
        """Instruments of the latest model."""
        if self.last is None:
            return self.instruments.first(self.start)
        model = self.last.model
        if self.number > PLAIN_ROUNDS:
            if self.weights is None or self.change > OTHER_NOISE:
                self.weights = self.instruments.weights(model)
            if self.weights is not None:
                return self.instruments.weighted(model, self.weights)
        return self.instruments.delayed(model)

    def _judge(self, runs: InstrumentRuns) -> None:
        """Compare the latest estimate with the best one, by the motion of its run."""
        if self.last is None:
            self.first_correlation = runs.correlation
        else:
            corrected = runs.whiteners is not None
            latest = _Judged(self.last, runs.correlation, corrected)
            if self.best is None or _is_better(latest, self.best):
                self.best = latest

        if runs.correlation < LEAST_CORRELATION:
            reason = (
                "the free run does not follow the measured motion (correlation"
                f" {runs.correlation:.2f})"
            )
            if self.last is None:
                reason += ", also that of least squares in the band of the motion"
            raise IdentifiabilityError(reason, CURE)

    def _solve(self, runs: InstrumentRuns) -> None:
        """Solve the equations with instruments."""
        problem = self.instruments.problem
        pieces = pieces_of(
            self.instruments.data,
            problem.layout,
            self.instruments.groups,
            self.instruments.filters,
            problem.known_masses,
            runs.runs,
            whiteners=runs.whiteners,
        )
        solution = solve(
            pieces.sum().projected(),
            self.instruments.solve_order,
            problem.known_masses,
            problem.optimizer,
        )
        model = model_of(problem.layout, solution)
        self._require_positive(model.masses)

        before = self.start if self.last is None else self.last.model
        self.moved = np.abs(model.masses / before.masses - 1)
        self.last = IVResult(
            model=model,
            solution=solution,
            pieces=pieces,
            rounds=self.number,
            correlation=runs.correlation,
            notes=self._notes(),
            runs=runs.runs,
            whiteners=runs.whiteners,
        )

    def _require_positive(self, masses: np.ndarray) -> None:
        """End the rounds at a mass that is not positive, unless one was so at first."""
        if (masses <= 0).any() and not (self.start.masses <= 0).any():
            dof = int(np.argmin(masses)) + 1
            size = f"{masses.min():.3g} {self.start.units.mass}"
            raise IdentifiabilityError(f"m{dof} became {size}", CURE)

    def _notes(self) -> tuple[str, ...]:
        n_left_out = len(self.instruments.data.segments) - len(self.instruments.usable)
        if not n_left_out:
            return ()
        return (
            f"{n_left_out} records with an unknown force were left out of the"
            " instruments.",
        )

    def _is_settled(self) -> bool:
        """Whether the masses change no more, in a weighted round if there is one.

        Where the weights alone change them so little, a better instrument changes them
        less.
        """
        return self.change < SETTLED and self.number > PLAIN_ROUNDS

    def _doubt_of_last(self, runs: InstrumentRuns) -> NRFError | None:
        """Why the last round is not to be believed, if an earlier one may be."""
        if self.best is None:
            return None
        if self.change > DIVERGED:
            reason = (
                "the masses did not converge, the last round changed one by"
                f" {100 * self.change:.2g} %"
            )
            return IdentifiabilityError(reason, CURE)
        if runs.correlation < self.best.correlation - CORRELATION_DROP:
            reason = (
                "the correlation of the free runs with the measured motion fell to"
                f" {runs.correlation:.2f}"
            )
            return IdentifiabilityError(reason, CURE)
        return None


def _is_better(latest: _Judged, best: _Judged) -> bool:
    """Whether the run of an estimate follows the motion better than the best one's.

    Correlations under measured and under corrected forces differ: the first estimate
    that is judged under corrected forces replaces that of the first round.
    """
    if latest.correlation > best.correlation:
        return True
    rounds_passed = best.result.rounds < PLAIN_ROUNDS <= latest.result.rounds
    return latest.corrected_forces and rounds_passed
