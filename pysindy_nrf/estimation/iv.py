r"""Instrumental variables from the free run of the model itself.

Noise in the motion biases least squares; the motion that the identified model makes under the
measured force is correlated with the true motion and not with its noise,

.. math:: Z^T (y - \Phi \theta) = 0, \quad Z = \text{columns of the simulated motion},

and solving this, simulating again and solving again three or four times removes the bias
(Young, Refined instrumental variable methods, 1976). Three traps, all measured:

- noise of the force is in the right-hand side and, through the simulation, in the instruments. In the first
  rounds the instruments are therefore delayed by one sample: white force noise of this sample is not in them.
  In the later ones the run goes under the force as the motion corrects it (:mod:`.spectra`), which lets every
  balance be weighted by frequency as its own noise asks for (generalised least squares; the masses' errors fall to
  a third, the dampings' to half).
- what the fusion could not resolve is missing in the motion, not in the force. The instruments are low-passed to
  what it resolved; what lies above is then not asked for.
- the motion must not have been shrunk towards what is likely (as the joint step of
  :class:`~pysindy_nrf.KinematicSmoother` does): the error would then depend on the motion.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..exceptions import BiasWarning, IdentifiabilityError, RankWarning, SimulationError
from ..laws import PowerSeries
from ..mechanics.identifiability import Walk
from ..regression.blocks_of_samples import pieces_of
from ..regression.chain_model import ChainModel
from ..regression.chain_solve import Solution, groups_of, solve, solve_blocks
from ..regression.grams import BlockGrams
from ..regression.layout import LawLayout
from ..regression.segments import Segment, SegmentSet
from ..regression.solution import model_of
from ..signals.zero_phase_filter import FairFilter, filters_of
from .noise_spectra import Weighting, common_band, lines_of, smoothed, spectrum, velocities, weighting_of
from .problem import Problem
from .runs import likeness_of, run_of, steady

ROUNDS = 8
PLAIN = 2  # rounds before the balances are weighted
SETTLED = 1e-4  # relative change of every mass below which the rounds stop
RESTLESS = 1e-2  # that of any mass in the last round above which the rounds went astray
ASTRAY = 0.05  # by which the free runs' correlation with the motion may fall below that of the best round
ALIKE = 0.5  # correlation of simulated and measured accelerations below which a free run is no instrument
QUIET, LOUD = 1e-3, 0.1  # of the largest density, between which the density lies where a motion counts as lively
LAW = "Lower the degree, add the law that is missing, or give records with longer or cleaner channels."
FORCES = "Give a record in which every force was measured."


@dataclass
class IVResult:
    """What the instrumental variables found.

    Attributes
    ----------
    model : ChainModel
    solution : Solution
    pieces : BlockGrams
        With the last instruments, piece by piece.
    rounds : int
        Rounds of simulation and solve.
    likeness : float
        Correlation of the simulated accelerations with the measured ones in the last round.
    notes : list of str
        What was left out, in words.
    runs : list of Segment or None
        The motion that gave the last instruments.
    settled : bool
        False where the rounds went astray and an earlier one was kept.
    moved : ndarray of shape (n_dof,) or None
        Relative change of each mass in the last round, where the rounds were not at rest when they ended.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
    >>> from pysindy_nrf.estimation import instrumental_variables
    >>> frame = ChainModel([10.0, 10.0], {f"storey {i}": laws.PowerSeries(1, [100.0, 1e5]) for i in (1, 2)})
    >>> F = excitation.band_limited_random(2, 8.0, 500.0, dofs=2, rms=50.0, band=(1, 60), random_state=0)
    >>> X, F = simulate(frame, F, 0.002).to_features(smooth=False)
    >>> start = NRFRegressor(degree=1, dt=0.002).fit(X, F)
    >>> data = start.model_.segments(X, F, dt=0.002)
    >>> found = instrumental_variables(start.model_, data, start.problem_, start.walk_)
    >>> found.model.masses.round(3), bool(found.likeness > 0.99)
    (array([10., 10.]), True)
    """

    model: ChainModel
    solution: Solution
    pieces: BlockGrams
    rounds: int
    likeness: float
    notes: list[str] = field(default_factory=list)
    runs: list[Segment | None] = field(default_factory=list)
    settled: bool = True
    moved: np.ndarray | None = None

    def judged(self, data: SegmentSet) -> SegmentSet:
        """What the balances miss along the measured motion, laid beside the free run, which is free of its noise.

        A law that is missing can be predicted from the run; noise of the motion that a law turns into an error
        cannot. See :func:`pysindy_nrf.diagnostics.missing_terms`.

        Parameters
        ----------
        data : SegmentSet

        Returns
        -------
        SegmentSet
            Motions of the runs, with forces that leave the residual of the measured ones.
        """
        pairs = [(seg, run) for seg, run in zip(data.segments, self.runs) if run is not None]
        measured, simulated = (SegmentSet([p[k] for p in pairs], data.n_samples) for k in (0, 1))
        parts = zip(pairs, self.model.balance_forces(measured), self.model.balance_forces(simulated))
        segments = []
        for (seg, run), along, free in parts:
            force = np.full(seg.F.shape, np.nan)
            force[seg.valid] = seg.F[seg.valid] - along + free
            segments.append(replace(run, F=force))
        return SegmentSet(segments, data.n_samples)


def instrumental_variables(
    start: ChainModel,
    data: SegmentSet,
    problem: Problem,
    walk: Walk,
    filters: Sequence[Any] | None = None,
) -> IVResult | None:
    """Iterated instrumental variables for all strategies and laws.

    Parameters
    ----------
    start : ChainModel
        Least-squares estimate.
    data : SegmentSet
        Motions whose noise is independent of the motion.
    problem : Problem
        With values for all shape parameters. An upper edge of its band colours the noise of the force, and the delay
        of the instruments grows with it.
    walk : Walk
        The order of the solve.
    filters : sequence of FairFilter or None, optional
        One for each record; those of the problem's band if None.

    Returns
    -------
    IVResult or None
        None where no free run could serve; a BiasWarning then says why.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
    >>> from pysindy_nrf.simulation.noise import add_noise
    >>> frame = ChainModel([10.0, 10.0], {f"storey {i}": laws.PowerSeries(1, [100.0, 1e5]) for i in (1, 2)})
    >>> F = excitation.band_limited_random(2, 8.0, 500.0, dofs=2, rms=50.0, band=(1, 60), random_state=0)
    >>> rec = add_noise(simulate(frame, F, 0.002), 0.05, random_state=0)
    >>> model = NRFRegressor(degree=1, estimation="iv").fit(rec)  # calls it after least squares
    >>> model.masses_.round(1), model.model_.info["estimation"]["found"]
    (array([10.1, 10.1]), 'iv')
    """
    layout, known_masses, band = problem.layout, problem.known_masses, problem.band
    filters = problem.filters(data) if filters is None else filters
    groups = groups_of(layout, walk)
    notes: list[str] = []
    model, best = start, None
    first, kept = -1.0, None  # correlation of the first run; of the models found, the one that runs most alike
    usable = [i for i, seg in enumerate(data.segments) if not np.isnan(seg.F[seg.valid.start]).any()]
    if not usable:
        _fall_back("in every record the force on some DOF is unknown, and a free run needs them all", FORCES)
        return None
    if len(usable) < len(data.segments):
        notes.append(
            f"{len(data.segments) - len(usable)} records with an unknown force were left out of the instruments."
        )
    why, cure = "", LAW
    weighting: Weighting | None = None
    for round_ in range(1, ROUNDS + 1):
        try:
            if best is None:
                runs, likeness = _first_runs(start, data, usable, layout, walk, filters, known_masses, band)
            elif round_ > PLAIN:
                weighting = weighting_of(model, data, usable, layout, groups, filters, known_masses, band)
            if weighting is not None:
                runs, likeness = weighting.runs, weighting.likeness
            elif best is not None:
                runs, likeness = _runs(model, data, usable, band)
        except SimulationError as error:
            why, cure = error.what, error.cure
            break
        if best is None:
            first = likeness
        elif kept is None or likeness > kept[0] or (weighting is not None and kept[1].rounds < PLAIN <= best.rounds):
            kept = likeness, best  # runs under measured and under corrected forces are not alike to the same degree
        if likeness < ALIKE:
            why = f"the free run is unlike the measured motion (correlation {likeness:.2f})"
            if best is None:
                why += ", that of least squares between the frequencies at which the motion is lively as well"
            break
        pieces = pieces_of(
            data, layout, groups, filters, known_masses, runs,
            whiteners=None if weighting is None else weighting.whiteners,
        )  # fmt: skip
        try:
            names = {s: layout.labels(s) for s in layout.acting}
            solution = solve(pieces.sum().projected(), walk, known_masses, problem.optimizer, names)
        except IdentifiabilityError as error:
            why, cure = error.what, error.cure
            break
        found = model_of(layout, solution)
        if (found.masses <= 0).any() and not (start.masses <= 0).any():
            why = f"m{int(np.argmin(found.masses)) + 1} became {found.masses.min():.3g} kg"
            break
        moved = np.abs(found.masses / model.masses - 1)
        change = moved.max()
        best = IVResult(found, solution, pieces, round_, likeness, notes, runs)
        model = found
        if change < SETTLED and (round_ > PLAIN + 1 or (round_ > PLAIN and weighting is None)):
            break
    if not why and kept is not None:
        if change > RESTLESS:
            why = f"the masses did not come to rest, the last round moved one by {100 * change:.2g} %"
        elif likeness < kept[0] - ASTRAY:
            why = f"the free runs became less like the measured motion (correlation {likeness:.2f})"
    if not why:
        if best is not None and change >= SETTLED:
            best.moved = moved
        return best
    if kept is None or kept[0] < max(first, ALIKE):  # least squares, which the first round begins with, runs as well
        _fall_back(why, cure)
        return None
    likeness, best = kept
    best.settled = False
    warnings.warn(
        f"estimation='iv' stopped after round {round_}: {why}. The estimate of round {best.rounds} is kept, whose free "
        f"run is most like the measured motion (correlation {likeness:.2f}).",
        BiasWarning,
        stacklevel=5,
    )
    return best


def _fall_back(why: str, cure: str) -> None:
    warnings.warn(
        f"estimation='iv' fell back on least squares: {why}. Noise in the motion then biases masses and "
        f"stiffnesses low. {cure}",
        BiasWarning,
        stacklevel=6,
    )


def delay_of(band: Any, dt: float) -> int:
    """Samples by which instruments are delayed so that the force's noise is not in them."""
    high = None if band is None else band[1]
    return 1 if high is None or not np.isfinite(high) else max(1, round(1.0 / (4 * high * dt)))


def _runs(
    model: ChainModel, data: SegmentSet, usable: Sequence[int], band: Any
) -> tuple[list[Segment | None], float]:
    """Delayed free runs of the usable records, and their correlation with the measured accelerations."""
    measured = [data.segments[i] for i in usable]
    top = common_band(measured, band)
    model = steady(model)
    made = [run_of(model, seg, delay_of(top, seg.step), limited=True) for seg in measured]
    runs: list[Segment | None] = [None] * len(data.segments)
    for i, run in zip(usable, made):
        runs[i] = run
    return runs, likeness_of(measured, made)


def _first_runs(
    start: ChainModel,
    data: SegmentSet,
    usable: Sequence[int],
    layout: LawLayout,
    walk: Walk,
    filters: Sequence[Any],
    known: Mapping[int, float],
    band: Any,
) -> tuple[list[Segment | None], float]:
    """Free runs of the first model that runs like the structure, or of the likeliest."""
    found: list[tuple[list[Segment | None], float]] = []
    worst: SimulationError | IdentifiabilityError | None = None
    linear = LawLayout(layout.chain, {s: (PowerSeries(1),) for s in layout.acting if s.kind == "link"})
    if any(s.kind != "link" for s in layout.acting):
        linear = layout  # what is tied to the ground is no chain

    def between() -> ChainModel | None:
        narrow = _lively_filters(data, usable, band)
        return None if narrow is None else _least_squares(data, linear, walk, narrow, known)

    makes: tuple[Callable[[], ChainModel | None], ...] = (
        lambda: start,
        lambda: None if linear is layout else _least_squares(data, linear, walk, filters, known),
        between,
    )
    for make in makes:
        try:
            model = make()
            if model is None or (model.masses <= 0).any():
                continue
            found.append(_runs(model, data, usable, band))
        except (SimulationError, IdentifiabilityError) as error:
            worst = worst or error
            continue
        if found[-1][1] >= ALIKE:
            return found[-1]
    if not found:
        what, cure = (worst.what, worst.cure) if worst else ("No model of the chain can run", "")
        raise SimulationError(what, cure or "Excite the chain better.")
    return max(found, key=lambda pair: pair[1])


def _lively_filters(data: SegmentSet, usable: Sequence[int], band: Any) -> list[FairFilter | None] | None:
    """One band for all records, in which the velocities stand out of their noise; None where there is none."""
    segments = [data.segments[i] for i in usable]
    lines = [lines_of(seg) for seg in segments]
    density = smoothed(lines, [np.abs(spectrum(velocities(seg), seg.step, taper=True)) ** 2 for seg in segments])
    share = (density.values / np.maximum(density.values.max(axis=0), 1e-300)).max(axis=1)
    lively = density.f[share >= np.clip(np.sqrt(share.min()), QUIET, LOUD)]
    low, high = common_band(segments, band)
    low, high = max(low, lively[0] / 1.2), min([high, 1.2 * lively[-1], *(s.resolved for s in segments if s.resolved)])
    top = 0.45 / max(seg.step for seg in data.segments)
    return filters_of((low, high if high < top else None), data) if low < min(high, top) else None


def _least_squares(
    data: SegmentSet, layout: LawLayout, walk: Walk, filters: Sequence[Any], known: Mapping[int, float]
) -> ChainModel:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RankWarning)
        solution, _ = solve_blocks(
            layout,
            walk,
            lambda: (b for seg, f in zip(data.segments, filters) for b in seg.blocks(layout, filter=f)),
            known,
        )
    return model_of(layout, solution)
