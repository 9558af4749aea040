"""Free runs of models under the forces of some records, as instruments."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import numpy as np

from ..chain.identifiability import SolveOrder
from ..chain.layout import Block, Group, LawLayout, with_coefficients
from ..chain.model import ChainModel
from ..equations.accumulation import rows_of, whole_block
from ..equations.chain_solve import groups_of, model_of, solve_blocks
from ..exceptions import (
    IdentifiabilityError,
    NRFError,
    RankWarning,
    SimulationError,
)
from ..laws import PowerSeries
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import ZeroPhaseFilter, filters_of
from .free_runs import HIGHEST_CUTOFF, eigenvalues, simulated
from .linear_response import equivalent_matrices, unbalanced
from .noise_spectra import NoiseModel, corrected, noise_model
from .problem import Problem, blocks_of
from .spectra import (
    SmoothSpectrum,
    Whitener,
    common_band,
    fourier_lines,
    line_frequencies,
    mean_spectrum,
    relative_velocities,
)

# By the DOFs of an equation of motion, or of several that are summed.
Whiteners = Mapping[tuple[int, ...], Whitener]

# Least damping ratio of every mode of an instrument.
LEAST_DAMPING = 1e-3
# Of simulated and measured accelerations; below it a free run is no instrument.
LEAST_CORRELATION = 0.5
# Limits of the share of the largest density above which a motion has signal.
LEAST_SIGNAL_SHARE = 1e-3
MOST_SIGNAL_SHARE = 0.1
# Factor by which the band of the signal is widened on both sides.
BAND_MARGIN = 1.2
# Residual of an equation, as a share of its largest density, below which its weight
# grows no more.
LEAST_RESIDUAL_SHARE = 1e-9


@dataclass(frozen=True)
class InstrumentRuns:
    """Free runs of one model under the forces of the records.

    Attributes
    ----------
    runs : list of Segment or None
        By record; None where a force is unknown.
    correlation : float
        Of simulated and measured accelerations.
    whiteners : mapping of tuple of int to Whitener, optional
        Weights of the equations by frequency; None if all frequencies count alike.
    """

    runs: list[Segment | None]
    correlation: float
    whiteners: Whiteners | None = None


@dataclass(frozen=True)
class EquationWeights:
    """What the noise of a first estimate says of the equations of motion.

    Attributes
    ----------
    forced : list of Segment
        The usable records with corrected forces, under which instruments run.
    whiteners : mapping of tuple of int to Whitener
        Weights of the equations by frequency.
    """

    forced: list[Segment]
    whiteners: Whiteners


def with_decaying_modes(model: ChainModel) -> ChainModel:
    """The model with damping added in proportion to stiffness, if a mode would grow."""
    values = eigenvalues(model)
    if values is None or (-values.real >= LEAST_DAMPING * np.abs(values)).all():
        return model
    M, _, K = model.matrices()
    slowest = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(M, K))).min())
    if slowest == 0:
        return model

    coefficients = model.coefficients
    for site, force in model.restoring_forces.items():
        labels = [term.label for law in force.laws for term in law.terms()]
        if "v" in labels:
            linear = force.linear_part()
            least = 2 * LEAST_DAMPING * abs(linear["k"]) / slowest
            coefficients[site][labels.index("v")] += max(0.0, least - linear["c"])
    return ChainModel(
        model.masses,
        with_coefficients(model.laws, coefficients),
        model.chain,
        model.visited,
        model.info,
    )


def correlation_of(
    segments: Sequence[Segment], runs: Sequence[Segment], delays: Sequence[int]
) -> float:
    """Correlation of simulated and measured accelerations, DOFs of equal weight.

    Runs come some samples late, by which they are moved forward: a quarter of a period
    late, a run of the true model correlates with nothing.
    """
    product = 0.0
    measured_square = 0.0
    simulated_square = 0.0
    for segment, run, delay in zip(segments, runs, delays):
        measured = segment.a[segment.valid].astype(float)
        measured = measured[: len(measured) - delay]
        simulated_a = run.a[run.valid][delay:]
        scale = np.mean(measured**2, axis=0)
        scale[scale == 0] = 1.0
        product += (measured * simulated_a / scale).sum()
        measured_square += (measured * measured / scale).sum()
        simulated_square += (simulated_a * simulated_a / scale).sum()

    with np.errstate(invalid="ignore", over="ignore"):
        correlation = product / np.sqrt(measured_square * simulated_square)
    return float(correlation) if np.isfinite(correlation) else 0.0


def delay_of(segment: Segment, highest: float) -> int:
    """Samples by which an instrument comes late.

    A quarter of a period of the highest frequency (Hz) keeps the noise of the force,
    which the equations of motion hold too, out of the instruments.
    """
    if not np.isfinite(highest):
        return 1
    return max(1, round(1.0 / (4 * highest * segment.step)))


class Instruments:
    """Makes instruments for the equations of motion of some records.

    Parameters
    ----------
    data : Dataset
    problem : Problem
    solve_order : SolveOrder
    """

    def __init__(
        self, data: Dataset, problem: Problem, solve_order: SolveOrder
    ) -> None:
        self.data = data
        self.problem = problem
        self.layout = problem.layout
        self.solve_order = solve_order
        self.filters = problem.filters(data)
        self.groups = groups_of(self.layout, solve_order)

        # a free run needs all forces
        self.usable: list[int] = []
        for number, segment in enumerate(data.segments):
            if not np.isnan(segment.F[segment.valid.start]).any():
                self.usable.append(number)
        self.segments = [data.segments[number] for number in self.usable]
        self.band = common_band(self.segments, problem.band)

    def delayed(self, model: ChainModel) -> InstrumentRuns:
        """Free runs under the measured forces, delayed."""
        runner = with_decaying_modes(model)
        delays = [delay_of(segment, self.band[1]) for segment in self.segments]
        runs = [
            simulated(runner, segment, delay, limited=True)
            for segment, delay in zip(self.segments, delays)
        ]
        return self._by_record(runs, delays)

    def first(self, start: ChainModel) -> InstrumentRuns:
        """Free runs of the first model that follows the motion, or of the best one.

        Parameters
        ----------
        start : ChainModel
            By least squares. Behind it stand linear laws, and linear laws in the band
            of the motion.

        Raises
        ------
        SimulationError
            If no model can be simulated.
        """
        proposals: list[Callable[[], ChainModel | None]] = [
            partial(self._as_given, start),
            self._with_linear_laws,
            self._with_linear_laws_in_signal_band,
        ]
        tried = []
        errors: list[NRFError] = []
        for propose in proposals:
            try:
                model = propose()
                if model is None or (model.masses <= 0).any():
                    continue
                tried.append(self.delayed(model))
            except (SimulationError, IdentifiabilityError) as error:
                errors.append(error)
                continue
            if tried[-1].correlation >= LEAST_CORRELATION:
                return tried[-1]

        if tried:
            return max(tried, key=attrgetter("correlation"))
        cure = "Excite the chain better."
        if errors:
            raise SimulationError(errors[0].what, errors[0].cure or cure)
        raise SimulationError("No model of the chain can be simulated", cure)

    def weights(self, model: ChainModel) -> EquationWeights | None:
        """Corrected forces, and weights of the equations; None without a noise model.

        There is none where noise and motion cannot be separated. The forces in the
        equations stay as measured; only the motion comes from the corrected ones.
        """
        runner = with_decaying_modes(model)
        plain = [simulated(runner, segment) for segment in self.segments]
        matrices = equivalent_matrices(runner, self.layout, plain)
        gaps = [unbalanced(model, matrices, segment) for segment in self.segments]

        noise = noise_model(runner, self.layout, self.segments, plain, gaps)
        if noise is None or not self._resolved_up_to(noise.signal_band[1]):
            return None

        forced = []
        for segment, gap in zip(self.segments, gaps):
            forced.append(corrected(segment, gap, noise))
        return EquationWeights(forced, self._whiteners(model, noise))

    def weighted(self, model: ChainModel, weights: EquationWeights) -> InstrumentRuns:
        """Free runs under corrected forces, with weights of the equations."""
        runner = with_decaying_modes(model)
        runs = [simulated(runner, segment) for segment in weights.forced]
        return self._by_record(runs, [0] * len(runs), weights.whiteners)

    def _by_record(
        self,
        runs: Sequence[Segment],
        delays: Sequence[int],
        whiteners: Whiteners | None = None,
    ) -> InstrumentRuns:
        of_records: list[Segment | None] = [None] * len(self.data.segments)
        for number, run in zip(self.usable, runs):
            of_records[number] = run
        correlation = correlation_of(self.segments, runs, delays)
        return InstrumentRuns(of_records, correlation, whiteners)

    def _resolved_up_to(self, frequency: float) -> bool:
        """Whether the fused motion of every record reaches a frequency, Hz."""
        resolved = [segment.resolved for segment in self.segments]
        return all(limit is None or limit >= frequency for limit in resolved)

    def _as_given(self, start: ChainModel) -> ChainModel:
        return start

    def _linear_layout(self) -> LawLayout | None:
        """A spring and a dashpot in each link; None where laws act on single DOFs."""
        if any(site.kind != "link" for site in self.layout.acting):
            return None
        laws = {site: (PowerSeries(1),) for site in self.layout.acting}
        return LawLayout(self.layout.chain, laws)

    def _with_linear_laws(self) -> ChainModel | None:
        layout = self._linear_layout()
        if layout is None:
            return None
        return self._least_squares(layout, self.filters)

    def _with_linear_laws_in_signal_band(self) -> ChainModel | None:
        filters = self._signal_band_filters()
        if filters is None:
            return None
        return self._least_squares(self._linear_layout() or self.layout, filters)

    def _signal_band_filters(self) -> list[ZeroPhaseFilter | None] | None:
        """Filters of the band in which velocities exceed their noise; None if empty."""
        frequencies = []
        densities = []
        for segment in self.segments:
            velocities = relative_velocities(segment)
            lines = fourier_lines(velocities, segment.step, taper=True)
            frequencies.append(line_frequencies(segment))
            densities.append(np.abs(lines) ** 2)
        spectrum = mean_spectrum(frequencies, densities)

        largest = np.maximum(spectrum.values.max(axis=0), 1e-300)
        share = (spectrum.values / largest).max(axis=1)
        threshold = np.sqrt(share.min())
        threshold = np.clip(threshold, LEAST_SIGNAL_SHARE, MOST_SIGNAL_SHARE)
        inside = spectrum.f[share >= threshold]

        low = max(self.band[0], inside[0] / BAND_MARGIN)
        high = min(self.band[1], inside[-1] * BAND_MARGIN)
        for segment in self.segments:
            if segment.resolved:
                high = min(high, segment.resolved)
        highest = HIGHEST_CUTOFF / max(seg.step for seg in self.data.segments)
        if not low < min(high, highest):
            return None
        return filters_of((low, high if high < highest else None), self.data)

    def _least_squares(
        self, layout: LawLayout, filters: Sequence[ZeroPhaseFilter | None]
    ) -> ChainModel:
        blocks = partial(blocks_of, self.data, filters, layout)
        known = self.problem.known_masses
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            solution, _ = solve_blocks(layout, self.solve_order, blocks, known)
        return model_of(layout, solution)

    def _whiteners(
        self, model: ChainModel, noise: NoiseModel
    ) -> dict[tuple[int, ...], Whitener]:
        """Share of the instruments that is signal, over the density of the residual."""
        low = max(self.band[0], noise.signal_band[0])
        high = min(self.band[1], noise.signal_band[1])

        frequencies, powers = self._residual_powers(model, noise.signal_band)
        whiteners = {}
        for dofs, of_records in powers.items():
            residual = mean_spectrum(frequencies, of_records)
            largest = residual.values.max()
            if largest > 0:
                share = noise.share(residual.f).mean(axis=1, keepdims=True)
                floored = np.maximum(residual.values, LEAST_RESIDUAL_SHARE * largest)
                weight = SmoothSpectrum(residual.f, share / floored)
                whiteners[dofs] = Whitener(weight, (low, high))
        return whiteners

    def _residual_powers(
        self, model: ChainModel, band: tuple[float, float]
    ) -> tuple[list[np.ndarray], dict[tuple[int, ...], list[np.ndarray]]]:
        """Frequencies in a band by record, and there the power of every residual."""
        frequencies = []
        powers: dict[tuple[int, ...], list[np.ndarray]] = {}
        for number, segment in zip(self.usable, self.segments):
            f = line_frequencies(segment)
            inside = (f >= band[0]) & (f <= band[1])
            frequencies.append(f[inside])

            block = whole_block(segment, self.layout, self.filters[number])
            for group in self.groups:
                residual = self._residual(model, group, block)
                lines = fourier_lines(residual[:, None], segment.step, taper=True)
                power = np.abs(lines[inside]) ** 2
                powers.setdefault(group.dofs, []).append(power)
        return frequencies, powers

    def _residual(self, model: ChainModel, group: Group, block: Block) -> np.ndarray:
        """What a model leaves of one equation of motion, or of a sum of several."""
        rows = rows_of(self.layout, group, block, self.problem.known_masses)
        coefficients = model.coefficients
        parameters = []
        for site, sign in zip(group.sites, group.signs):
            parameters.append(sign * coefficients[site])
        if len(group.dofs) == 1:
            parameters.append(model.masses[[group.dofs[0] - 1]])
        return rows[-1] - np.concatenate(parameters) @ rows[:-1]
