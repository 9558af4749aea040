r"""Instrumental variables from the free run of the model itself.

:math:`Z^T (y - \Phi \theta) = 0` with Z the columns of the simulated motion, repeated
three or four times (Young, Refined instrumental variable methods, 1976). First
instruments are one sample late, which keeps white force noise out; later runs use the
corrected force (:mod:`.noise_spectra`), so that balances can be weighted by frequency.
The motion must not be shrunk towards a prior, as the joint step of
:class:`~pysindy_nrf.KinematicSmoother` does.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy import linalg

from ..chain.identifiability import SolveOrder
from ..chain.layout import LawLayout, Layout, with_coefficients
from ..chain.model import ChainModel, state_matrix
from ..equations.accumulation import pieces_of, rows_of, whole_block
from ..equations.chain_solve import (
    Solution,
    groups_of,
    model_of,
    scales_of,
    solve,
    solve_blocks,
)
from ..equations.errors import free_run_of
from ..equations.normal_equations import NormalEquations
from ..equations.shape_search import ShapeSearch
from ..exceptions import (
    BiasWarning,
    IdentifiabilityError,
    LawError,
    RankWarning,
    SimulationError,
)
from ..laws import PowerSeries
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import ZeroPhaseFilter, filters_of
from ..simulation.api import classical_run, simulate
from . import noise_spectra as spectra
from .problem import Problem, blocks_of

_Weights = dict[tuple[int, ...], spectra.Whitener]  # by the DOFs of a balance
STEADY = 1e-3  # least damping ratio of every mode of an instrument
# radians of the fastest mode in a sample, above which one Runge-Kutta step is not
# enough
COARSE = 0.25


def steady(model: ChainModel) -> ChainModel:
    """The model with stiffness-proportional damping added if a mode would grow or not
    decay.
    """
    M, C, K = model.matrices()
    values = _eigenvalues(M, C, K)
    if values is None or (-values.real >= STEADY * np.abs(values)).all():
        return model
    slowest = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(M, K))).min())
    if slowest == 0:
        return model
    coefficients = model.coefficients
    for site, force in model.restoring_forces.items():
        linear, labels = (
            force.linear_part(),
            [term.label for law in force.laws for term in law.terms()],
        )
        if "v" in labels:
            coefficients[site][labels.index("v")] += max(
                0.0, 2 * STEADY * abs(linear["k"]) / slowest - linear["c"]
            )
    return ChainModel(
        model.masses,
        with_coefficients(model.laws, coefficients),
        model.chain,
        model.visited,
        model.info,
    )


def _eigenvalues(M: np.ndarray, C: np.ndarray, K: np.ndarray) -> np.ndarray | None:
    """Eigenvalues of the linear structure, 1/s; None if they do not exist."""
    try:
        return np.linalg.eigvals(state_matrix(M, C, K))
    except np.linalg.LinAlgError:  # no mass, or coefficients that are not finite
        return None


def fits_one_step(model: ChainModel, dt: float) -> bool:
    """True if one classical Runge-Kutta step per sample of dt (s) integrates the model
    without shifting its modes.
    """
    if model.has_memory:
        return False
    # a step lowers a frequency w by (w dt)^4 / 120 of itself: 3e-5 at COARSE, but a
    # thousandth at 0.6
    values = _eigenvalues(*model.matrices())
    return values is not None and bool(np.abs(values).max() * dt <= COARSE)


def run_of(
    model: ChainModel, segment: Segment, delay: int = 0, limited: bool = False
) -> Segment:
    """Motion of a model under a record's forces, ``delay`` samples late, low-passed as
    the measured one if limited.
    """
    rows, dt = segment.valid, segment.step
    integrator = classical_run if fits_one_step(model, dt) else simulate
    record = free_run_of(model, segment, integrator=integrator, rtol=1e-5, hold="cubic")
    shift = np.maximum(np.arange(rows.stop - rows.start) - delay, 0)
    smooth = None
    if limited and segment.resolved is not None and segment.resolved < 0.45 / dt:
        smooth = ZeroPhaseFilter((None, segment.resolved), 1.0 / dt)
    v, s = (
        np.diff(np.asarray(y), axis=1, prepend=0.0)
        for y in (record.velocity, record.displacement)
    )
    lines = (
        y if smooth is None else smooth.apply(y)
        for y in (np.asarray(record.acceleration), v, s)
    )
    a, v, s = (spread_out(segment, line[shift]) for line in lines)
    return replace(segment, a=a, v=v, s=s)


def spread_out(segment: Segment, values: np.ndarray) -> np.ndarray:
    """Values in the valid rows of a segment, NaN outside."""
    out = np.full((segment.n_samples, segment.n_dof), np.nan)
    out[segment.valid] = values
    return out


def correlation_of(segments: Sequence[Segment], runs: Sequence[Segment]) -> float:
    """Correlation of simulated and measured accelerations, every DOF with equal
    weight.
    """
    both = own = other = 0.0
    for segment, run in zip(segments, runs):
        a, b = segment.a[segment.valid].astype(float), run.a[run.valid]
        scale = np.mean(a**2, axis=0)
        scale[scale == 0] = 1.0
        both, own, other = (
            both + (a * b / scale).sum(),
            own + (a * a / scale).sum(),
            other + (b * b / scale).sum(),
        )
    with np.errstate(invalid="ignore", over="ignore"):
        correlation = both / np.sqrt(own * other)
    return float(correlation) if np.isfinite(correlation) else 0.0


ROUNDS = 8
PLAIN = 2  # rounds before the balances are weighted
SETTLED = 1e-4  # relative change of every mass below which the rounds stop
DIVERGED = (
    1e-2  # relative change of a mass in the last round above which the rounds diverged
)
CORRELATION_DROP = (
    0.05  # allowed fall of the correlation with the motion below that of the best round
)
# of simulated and measured accelerations; below it a free run cannot be an instrument
LEAST_CORRELATION = 0.5
LOWEST, HIGHEST = (
    1e-3,
    0.1,
    # limits, relative to the largest density, of the level above which a motion has
    # signal
)
LAW = (
    "Lower the degree, add the law that is missing, or give records with longer or"
    " cleaner channels."
)
FORCES = "Give a record in which every force was measured."


@dataclass
class IVResult:
    """Result of the instrumental variables."""

    model: ChainModel
    solution: Solution
    pieces: NormalEquations  # with the last instruments, piece by piece
    rounds: int  # rounds of simulation and solve
    # correlation of the simulated accelerations with the measured ones in the last
    # round
    correlation: float
    notes: list[str] = field(
        default_factory=list
    )  # remarks for the user, e.g. on records left out
    runs: list[Segment | None] = field(
        default_factory=list
    )  # the motion that gave the last instruments
    settled: bool = True  # false if the rounds diverged and an earlier one was kept
    moved: np.ndarray | None = (
        # (n_dof,); relative change of each mass in a last round that did not converge
        None
    )

    def judged(self, data: Dataset) -> Dataset:
        """Motions of the free runs, with forces that leave the residuals of the
        measured motion.
        """
        pairs = [
            (seg, run) for seg, run in zip(data.segments, self.runs) if run is not None
        ]
        measured, simulated = (
            Dataset([p[k] for p in pairs], data.n_samples) for k in (0, 1)
        )
        parts = zip(
            pairs,
            self.model.balance_forces(measured),
            self.model.balance_forces(simulated),
        )
        forces = (
            spread_out(seg, seg.F[seg.valid] - along + free)
            for (seg, _), along, free in parts
        )
        return Dataset(
            [replace(run, F=force) for (_, run), force in zip(pairs, forces)],
            data.n_samples,
        )


def instrumental_variables(
    start: ChainModel, data: Dataset, problem: Problem, solve_order: SolveOrder
) -> IVResult | None:
    """Iterated instrumental variables for all strategies and laws."""
    layout, source = problem.layout, _Instruments(data, problem, solve_order)
    if not source.usable:
        _fall_back(
            "in every record the force on some DOF is unknown, and a free run needs all"
            " forces",
            FORCES,
        )
        return None
    notes = []
    if left_out := len(data.segments) - len(source.usable):
        notes = [
            f"{left_out} records with an unknown force were left out of the"
            " instruments."
        ]
    model, best = start, None
    first, kept = (
        -1.0,
        None,
    )  # correlation of the first run; the best of the models found
    why, cure = "", LAW
    weights: _Weights | None = None
    for round_ in range(1, ROUNDS + 1):
        try:
            weighted = (
                source.weighted(model) if best is not None and round_ > PLAIN else None
            )
            if weighted is not None:
                runs, correlation, weights = weighted
            else:
                weights = None
                runs, correlation = (
                    source.first(start) if best is None else source.delayed(model)
                )
        except SimulationError as error:
            why, cure = error.what, error.cure
            break
        if best is None:
            first = correlation
        elif (
            kept is None
            or correlation > kept[0]
            or (weights is not None and kept[1].rounds < PLAIN <= best.rounds)
        ):
            kept = (
                correlation,
                best,
            )  # correlations under measured and corrected forces differ
        if correlation < LEAST_CORRELATION:
            why = (
                "the free run does not follow the measured motion (correlation"
                f" {correlation:.2f})"
            )
            if best is None:
                why += ", also that of least squares in the band of the motion"
            break
        pieces = pieces_of(
            data,
            layout,
            source.groups,
            source.filters,
            problem.known_masses,
            runs,
            whiteners=weights,
        )
        try:
            solution = solve(
                pieces.sum().projected(),
                solve_order,
                problem.known_masses,
                problem.optimizer,
            )
        except IdentifiabilityError as error:
            why, cure = error.what, error.cure
            break
        found = model_of(layout, solution)
        if (found.masses <= 0).any() and not (start.masses <= 0).any():
            why = (
                f"m{int(np.argmin(found.masses)) + 1} became"
                f" {found.masses.min():.3g} kg"
            )
            break
        moved = np.abs(found.masses / model.masses - 1)
        change = moved.max()
        best = IVResult(found, solution, pieces, round_, correlation, notes, runs)
        model = found
        if change < SETTLED and (
            round_ > PLAIN + 1 or (round_ > PLAIN and weights is None)
        ):
            break
    if not why and kept is not None:
        if change > DIVERGED:
            why = (
                "the masses did not converge, the last round changed one by"
                f" {100 * change:.2g} %"
            )
        elif correlation < kept[0] - CORRELATION_DROP:
            why = (
                "the correlation of the free runs with the measured motion fell to"
                f" {correlation:.2f}"
            )
    if not why:
        if best is not None and change >= SETTLED:
            best.moved = moved
        return best
    if kept is None or kept[0] < max(
        first, LEAST_CORRELATION
    ):  # least squares runs as well
        _fall_back(why, cure)
        return None
    correlation, best = kept
    best.settled = False
    warnings.warn(
        f"estimation='iv' stopped after round {round_}: {why}. The estimate of round"
        f" {best.rounds} is kept; its free run has the highest correlation with the"
        f" measured motion ({correlation:.2f}).",
        BiasWarning,
        stacklevel=5,
    )
    return best


def _fall_back(why: str, cure: str) -> None:
    warnings.warn(
        f"estimation='iv' fell back on least squares: {why}. Noise in the motion then"
        f" biases masses and stiffnesses low. {cure}",
        BiasWarning,
        stacklevel=6,
    )


# On the scale of the search (logarithms, shares of the range of what may be zero): half
# the distance of the two shapes whose difference stands for a derivative, wide enough
# for laws with kinks; the largest step; a step that is at rest.
SPAN, MOST, STILL, PASSES = 0.2, 1.0, 0.01, 3


def with_shapes(
    asked: Problem, problem: Problem, order: SolveOrder, data: Dataset, iv: IVResult
) -> tuple[Problem, IVResult]:
    """Estimate anew with other values of the shape parameters that were searched, while
    their steps contract.
    """
    laws = {  # lines of a spectrum and instants are told by other means
        site: [
            b if any(p.is_frequency or p.instant for p in a.shapes) else a
            for a, b in zip(held, problem.laws[site])
        ]
        for site, held in asked.laws.items()
    }
    if not any(law.free_shape for held in laws.values() for law in held):
        return problem, iv
    search = ShapeSearch(
        LawLayout(problem.chain, laws), scales_of(data, problem.layout)
    )
    unit = np.where(search.scale.log, 1.0, search.high - search.low)
    u = search.scale.point(
        np.array([problem.laws[site][i].shape[p.name] for site, i, p in search.free])
    )
    last = MOST * unit
    for _ in range(PASSES):
        try:
            step = _shape_step(problem, order, data, iv, search, u, SPAN * unit)
        except (IdentifiabilityError, LawError):
            break
        if not (np.abs(step) <= last).all():
            break
        u, last = (
            np.clip(u + step, search.low, search.high),
            np.maximum(np.abs(step), STILL * unit),
        )
        trial = problem.with_laws(search.trial(u).laws)
        again = instrumental_variables(
            model_of(trial.layout, iv.solution), data, trial, order
        )
        if again is None or not again.settled:
            break
        problem, iv = trial, again
        if (last <= STILL * unit).all():
            break
    return problem, iv


def _shape_step(
    problem: Problem,
    order: SolveOrder,
    data: Dataset,
    iv: IVResult,
    search: ShapeSearch,
    u: np.ndarray,
    span: np.ndarray,
) -> np.ndarray:
    """Gauss-Newton step: derivatives of the laws along the measured motion as columns,
    along the run as instruments.
    """
    own, laws = (
        problem.layout,
        {site: list(held) for site, held in problem.laws.items()},
    )
    ends = [
        np.clip(u + sign * np.diag(span), search.low, search.high)
        for sign in (1.0, -1.0)
    ]
    change = {site: [np.eye(own.counts[site])] for site in own.acting}
    for k, (site, i, _) in enumerate(search.free):
        laws[site] += [search.trial(end[k]).laws[site][i] for end in ends]
        at = np.cumsum([0, *(len(law.terms()) for law in problem.laws[site])])
        part = (
            iv.model.coefficients[site][at[i] : at[i + 1]] / (ends[0] - ends[1])[k, k]
        )
        change[site].append(np.concatenate([part, -part])[:, None])
    wide, whole = (
        LawLayout(problem.chain, laws),
        {s: linalg.block_diag(*parts) for s, parts in change.items()},
    )
    narrow = Layout(
        problem.chain, {site: matrix.shape[1] for site, matrix in whole.items()}
    )
    groups = [wide.group(group.dofs) for group in groups_of(own, order)]
    total = pieces_of(
        data, wide, groups, problem.filters(data), problem.known_masses, iv.runs
    ).sum()
    changes = {}
    for group in groups:
        matrix = linalg.block_diag(
            *(whole[site] for site in group.sites), np.eye(1 + (len(group.dofs) == 1))
        )
        changes[narrow.group(group.dofs)] = linalg.block_diag(matrix, matrix[:-1, :-1])
    found = solve(
        total.transformed(narrow, changes).projected(), order, problem.known_masses
    )
    seen = {
        site: iter(found.coefficients[site][own.counts[site] :]) for site in own.acting
    }
    return np.array([next(seen[site]) for site, *_ in search.free])


class _Instruments:
    """Free runs of models under the forces of some records, as instruments of their
    balances.
    """

    def __init__(self, data: Dataset, problem: Problem, order: SolveOrder) -> None:
        self.data, self.problem, self.layout, self.order = (
            data,
            problem,
            problem.layout,
            order,
        )
        self.filters = problem.filters(data)
        self.groups = groups_of(self.layout, order)
        self.usable = [
            i
            for i, seg in enumerate(data.segments)
            if not np.isnan(seg.F[seg.valid.start]).any()
        ]
        self.segments = [data.segments[i] for i in self.usable]
        self.band = spectra.common_band(self.segments, problem.band)

    def _placed(self, runs: Sequence[Segment]) -> tuple[list[Segment | None], float]:
        """Runs by record (None for one with an unknown force) and their correlation
        with the measured motion.
        """
        found = dict(zip(self.usable, runs))
        return [found.get(i) for i in range(len(self.data.segments))], correlation_of(
            self.segments, runs
        )

    def delayed(self, model: ChainModel) -> tuple[list[Segment | None], float]:
        """Free runs under the measured forces, delayed to keep the noise of the force
        out of them.
        """
        model = steady(model)
        high = self.band[1]
        late = [
            1 if not np.isfinite(high) else max(1, round(1.0 / (4 * high * seg.step)))
            for seg in self.segments
        ]
        return self._placed(
            [run_of(model, seg, n, limited=True) for seg, n in zip(self.segments, late)]
        )

    def first(self, start: ChainModel) -> tuple[list[Segment | None], float]:
        """Free runs of the first model that follows the measured motion, or of the best
        one.
        """
        found: list[tuple[list[Segment | None], float]] = []
        worst: SimulationError | IdentifiabilityError | None = None
        linear = LawLayout(
            self.layout.chain,
            {s: (PowerSeries(1),) for s in self.layout.acting if s.kind == "link"},
        )
        if any(s.kind != "link" for s in self.layout.acting):
            linear = self.layout

        makes: tuple[Callable[[], ChainModel | None], ...] = (
            lambda: start,
            lambda: (
                None
                if linear is self.layout
                else self._least_squares(linear, self.filters)
            ),
            lambda: (
                None
                if (held := self._signal_band_filters()) is None
                else self._least_squares(linear, held)
            ),
        )
        for make in makes:
            try:
                model = make()
                if model is None or (model.masses <= 0).any():
                    continue
                found.append(self.delayed(model))
            except (SimulationError, IdentifiabilityError) as error:
                worst = worst or error
                continue
            if found[-1][1] >= LEAST_CORRELATION:
                return found[-1]
        if not found:
            what, cure = (
                (worst.what, worst.cure)
                if worst
                else ("No model of the chain can be simulated", "")
            )
            raise SimulationError(what, cure or "Excite the chain better.")
        return max(found, key=lambda pair: pair[1])

    def weighted(
        self, model: ChainModel
    ) -> tuple[list[Segment | None], float, _Weights] | None:
        """Free runs under the corrected forces, their correlation, and weights of the
        balances; None without noise.
        """
        runner = steady(model)
        plain = [run_of(runner, seg) for seg in self.segments]
        matrices = spectra.linearised(runner, self.layout, plain)
        gaps = [spectra.unbalanced(model, matrices, seg) for seg in self.segments]
        noise = spectra.noise_model(runner, self.layout, self.segments, plain, gaps)
        resolved = [seg.resolved for seg in self.segments if seg.resolved is not None]
        if noise is None or min(resolved, default=np.inf) < noise.signal_band[1]:
            return None
        # the forces of the balances stay as measured; only the motion comes from the
        # corrected forces
        better = [
            spectra.corrected(seg, gap, noise) for seg, gap in zip(self.segments, gaps)
        ]
        return *self._placed([run_of(runner, seg) for seg in better]), self._weights(
            model, noise
        )

    def _weights(self, model: ChainModel, noise: spectra.NoiseModel) -> _Weights:
        """By balance: the share of the instruments that is signal, over the density of
        the residual.
        """
        residuals: dict[tuple[int, ...], list] = {g.dofs: [] for g in self.groups}
        theta, (low, high) = model.coefficients, noise.signal_band
        for i, seg in zip(self.usable, self.segments):
            block = whole_block(seg, self.layout, self.filters[i])
            for group in self.groups:
                rows = rows_of(self.layout, group, block, self.problem.known_masses)
                own = [
                    sign * theta[site] for site, sign in zip(group.sites, group.signs)
                ]
                mass = (
                    [model.masses[[group.dofs[0] - 1]]] if len(group.dofs) == 1 else []
                )
                gap = rows[-1] - np.concatenate([*own, *mass]) @ rows[:-1]
                f = spectra.lines_of(seg)
                use = (f >= low) & (f <= high)
                power = (
                    np.abs(spectra.spectrum(gap[:, None], seg.step, taper=True)) ** 2
                )
                residuals[group.dofs].append((f[use], power[use]))
        out = {}
        band = max(self.band[0], low), min(self.band[1], high)
        for dofs, held in residuals.items():
            left = spectra.smoothed([f for f, _ in held], [p for _, p in held])
            top = left.values.max()
            if top > 0:
                share = noise.share(left.f).mean(axis=1, keepdims=True)
                out[dofs] = spectra.Whitener(
                    spectra.Smooth(left.f, share / np.maximum(left.values, 1e-9 * top)),
                    band,
                )
        return out

    def _signal_band_filters(self) -> list[ZeroPhaseFilter | None] | None:
        """Filters of one band for all records, in which the velocities exceed their
        noise; None if there is none.
        """
        power = [
            np.abs(spectra.spectrum(spectra.velocities(seg), seg.step, taper=True)) ** 2
            for seg in self.segments
        ]
        density = spectra.smoothed(
            [spectra.lines_of(seg) for seg in self.segments], power
        )
        share = (density.values / np.maximum(density.values.max(axis=0), 1e-300)).max(
            axis=1
        )
        inside = density.f[share >= np.clip(np.sqrt(share.min()), LOWEST, HIGHEST)]
        resolved = [seg.resolved for seg in self.segments if seg.resolved]
        low, high = (
            max(self.band[0], inside[0] / 1.2),
            min([self.band[1], 1.2 * inside[-1], *resolved]),
        )
        top = 0.45 / max(seg.step for seg in self.data.segments)
        return (
            filters_of((low, high if high < top else None), self.data)
            if low < min(high, top)
            else None
        )

    def _least_squares(self, layout: LawLayout, filters: Sequence[Any]) -> ChainModel:
        """Least-squares model of a layout."""
        blocks = partial(blocks_of, self.data, filters, layout)
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            solution, _ = solve_blocks(
                layout, self.order, blocks, self.problem.known_masses
            )
        return model_of(layout, solution)
