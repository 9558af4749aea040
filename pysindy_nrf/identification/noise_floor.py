"""What a model leaves of each equation of motion, and what noise would leave.

Noise as strong as that of the channels is added to the records once more. What it adds
to the fused motion, and with it to the residual, is what the noise that was measured
has left there. Noise also acts through the estimate: an equation that takes a force
from another one keeps the error of that force.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..chain.model import ChainModel
from ..diagnosis.facts import LeftOver
from ..diagnosis.residual import Residual, residual_of
from ..diagnosis.rules import ABOVE_NOISE
from ..exceptions import NRFWarning
from ..records.dataset import Dataset, Segment
from ..records.fusion.noise_levels import levels_of, noisy_channels
from ..records.input_arrays import from_arrays
from ..records.record import Record
from .problem import Problem

# Samples of all records that are fused again. Noise of 10 000 samples has a known rms
# to 1 %, and that of an octave to 3 %.
MAX_SAMPLES = 10_000
# Lines of a spectrum in the lowest octave, at least.
LEAST_LINES = 32
# Share of the squared residual from which on an octave is counted.
LEAST_SHARE = 0.01
# Octaves below half the rate that are not judged: with two to four samples a period
# neither derivatives nor the course of a force between samples are known. There right
# models leave 1.8 to 3.4 times what noise leaves, elsewhere 0.9 to 1.3 ("clean, cubic"
# 60327 of benchmarks/verdicts.py).
N_UNRESOLVED = 1
# Times what noise leaves that is taken for noise: one draw shows it to a fifth.
TIMES_NOISE = 1.2
# Standard errors of the estimate that are taken for noise: 95 %.
STANDARD_ERRORS = 2.0
# A verdict on the same data is the same, so its noise is.
_SEED = 0


@dataclass(frozen=True)
class BesideNoise:
    """What a model leaves of each equation of motion, and what noise would leave.

    Parameters
    ----------
    left_over : dict of int to LeftOver
        By DOF. Where some octaves hold far more than noise they alone are counted.
    noise : dict of int to float
        What noise would leave at all frequencies, by itself and through the estimate,
        percent of the force.
    """

    left_over: dict[int, LeftOver] = field(default_factory=dict)
    noise: dict[int, float] = field(default_factory=dict)

    def remaining(self, unexplained: Mapping[int, float]) -> dict[int, float]:
        """What equations leave, percent, by DOF: beyond noise where it is known."""
        return {**unexplained, **self.beyond(unexplained)}

    def beyond(self, unexplained: Mapping[int, float]) -> dict[int, float]:
        """What equations leave beyond noise, percent, by DOF."""
        beyond = {}
        for j, noise in self.noise.items():
            power = unexplained.get(j, np.nan) ** 2 - (TIMES_NOISE * noise) ** 2
            beyond[j] = float(np.sqrt(max(power, 0.0)))
        return beyond


def beside_noise(
    problem: Problem,
    model: ChainModel,
    data: Dataset,
    half_samples: Sequence[ChainModel] = (),
) -> BesideNoise:
    """What a model leaves of each equation of motion, and what noise would leave.

    Parameters
    ----------
    problem : Problem
    model : ChainModel
    data : Dataset
        Fused from records.
    half_samples : sequence of ChainModel
        Models that differ from the estimate by one standard error.

    Returns
    -------
    BesideNoise
        Empty where no noise is known.
    """
    of_noise = residual_of_noise(problem, model, data)
    if of_noise is None:
        return BesideNoise()
    step = data.segments[0].step
    filters = problem.filters(data)
    residual = residual_of(model, data, filters)
    n_octaves = _number_of_octaves([*of_noise.balance, *residual.balance])
    noise = _powers_by_octave(of_noise.balance, step, n_octaves)
    powers = _powers_by_octave(residual.balance, step, n_octaves)
    for other in half_samples:
        residual_beside = residual_of(other, data, filters)
        errors = _differences(residual_beside.balance, residual.balance)
        powers_of_errors = _powers_by_octave(errors, step, n_octaves)
        noise += STANDARD_ERRORS**2 * powers_of_errors / len(half_samples)

    known = BesideNoise()
    for j, reference in enumerate(residual.reference["reference"][: model.n_dof]):
        if np.isfinite(powers[:, j]).all() and reference > 0:
            of_dof = _above_noise(powers[:, j], noise[:, j], step)
            percent = 100.0 * of_dof.rms / float(reference)
            known.left_over[j + 1] = replace(of_dof, percent=percent)
            known.noise[j + 1] = 100.0 * float(np.sqrt(noise[:, j].sum()) / reference)
    return known


def _above_noise(powers: np.ndarray, noise: np.ndarray, step: float) -> LeftOver:
    """What is left in the octaves far above noise; in all if there is none."""
    holds_something = powers > LEAST_SHARE * powers.sum()
    counted = holds_something & (powers > ABOVE_NOISE**2 * noise)
    counted[:N_UNRESOLVED] = False
    if not counted.any():
        counted = np.ones(len(powers), dtype=bool)
    rms = float(np.sqrt(powers[counted].sum()))
    of_noise = float(np.sqrt(noise[counted].sum()))
    number = np.flatnonzero(counted)
    highest = 0.5 / step / 2.0 ** number[0]
    is_lowest = number[-1] == len(powers) - 1
    lowest = 0.0 if is_lowest else 0.25 / step / 2.0 ** number[-1]
    return LeftOver(rms, of_noise, np.nan, (lowest, highest))


def residual_of_noise(
    problem: Problem,
    model: ChainModel,
    data: Dataset,
    rng: np.random.Generator | None = None,
) -> Residual | None:
    """What further noise adds to the residual of a model; None where none is known.

    Parameters
    ----------
    problem : Problem
    model : ChainModel
    data : Dataset
        Fused from records. Of long ones stretches are read.
    rng : Generator, optional
        The same noise each time if None.
    """
    if not data.records or not all(segment.noise for segment in data.segments):
        return None
    rng = np.random.default_rng(_SEED) if rng is None else rng
    stretches = [_stretch(problem, data, k) for k in range(len(data.segments))]
    noisy = [
        _with_noise(record, segment, rng)
        for record, segment in zip(stretches, data.segments)
    ]
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        plain = _residual_of_records(problem, model, stretches)
        with_noise = _residual_of_records(problem, model, noisy)
    differences = _differences(with_noise.balance, plain.balance)
    segments = []
    for segment, difference in zip(with_noise.data.segments, differences):
        first = segment.valid.start
        rows = slice(first, first + len(difference))
        segments.append(replace(segment, valid=rows))
    both = Dataset(segments, with_noise.data.n_samples)
    return replace(with_noise, data=both, balance=differences)


def _residual_of_records(
    problem: Problem, model: ChainModel, records: Sequence[Record]
) -> Residual:
    """What a model leaves of records, fused again."""
    fused = from_arrays(
        records,
        n_dof=model.n_dof,
        has_memory=model.has_memory,
        check=False,
        needs_clock=problem.needs_clock,
    )
    return residual_of(model, fused, problem.filters(fused))


def _differences(
    residuals: Sequence[np.ndarray], others: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Differences of two residuals, record by record, as long as the shorter one."""
    differences = []
    for residual, other in zip(residuals, others):
        n_samples = min(len(residual), len(other))
        differences.append(residual[:n_samples] - other[:n_samples])
    return differences


def _stretch(problem: Problem, data: Dataset, number: int) -> Record:
    """The strongest stretch of a record; the record itself if laws have a memory."""
    record, segment = data.records[number], data.segments[number]
    share = MAX_SAMPLES / sum(each.n_valid for each in data.segments)
    if share >= 1 or problem.layout.has_memory:
        return record
    size = max(1, int(share * segment.n_valid))
    first = segment.valid.start + segment.strongest(slice(0, segment.n_valid), size)
    return record.rows(slice(first, first + size))


def _with_noise(record: Record, segment: Segment, rng: np.random.Generator) -> Record:
    """A record with further noise on every channel, as strong as what it has."""
    levels = levels_of(record, segment.noise)
    return record.replace(**noisy_channels(record, levels, rng))


def _number_of_octaves(lines: Sequence[np.ndarray]) -> int:
    """Octaves of which the lowest has enough lines in the shortest record."""
    shortest = min(map(len, lines))
    return max(1, int(np.log2(max(shortest / 2 / LEAST_LINES, 1.0))) + 1)


def _powers_by_octave(
    lines: Sequence[np.ndarray], step: float, n_octaves: int
) -> np.ndarray:
    """Variance of lines by octave, the highest first, (n_octaves, n_columns).

    Parameters
    ----------
    lines : sequence of ndarray of shape (n_samples, n_columns)
    step : float
        s.
    n_octaves : int
        The lowest holds all that is below it.
    """
    lowest = 0.5 / step / 2**n_octaves
    powers = np.zeros((n_octaves, lines[0].shape[1]))
    for record in lines:
        spectrum = np.abs(np.fft.rfft(record, axis=0)) ** 2
        # the means are zeros of sensors
        spectrum[0] = 0.0
        frequencies = np.fft.rfftfreq(len(record), step)
        octaves_down = np.log2(0.5 / step / np.maximum(frequencies, lowest))
        number = np.clip(octaves_down.astype(int), 0, n_octaves - 1)
        for k in range(n_octaves):
            powers[k] += 2.0 * spectrum[number == k].sum(axis=0) / len(record)
    return powers / sum(map(len, lines))
