"""Forces that come earlier or later than the motion they cause.

The equation of motion of a forced DOF is solved with its force shifted by full
samples, from one Gram matrix. The parabola through the lowest three residuals gives the
delay; leaving out pieces of the record gives its standard error, or, of a single blow,
the curve of the residuals and the course of the force between two samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Unpack

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import linalg

from ..chain.layout import LawLayout
from ..chain.model import DataOptions, FittedRegressor, as_segments
from ..equations.accumulation import rows_of, whole_block
from ..equations.normal_equations import variance
from ..exceptions import ChannelError
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import ZeroPhaseFilter

# Samples by which a force is shifted at most, in either direction.
MAX_SHIFT = 20
# Length of a record over that, at least.
MIN_LENGTH = 8
PIECES = 24
# Samples; smaller delays are not reported.
LEAST_DELAY = 0.1
# Standard errors that a delay must be away from zero.
SURE = 3.0
# Relative difference of sampling steps that are taken as one.
SAME_STEP = 1e-3
# Share of the square of the force that the best shift leaves, above which no delay is
# reported.
UNEXPLAINED = 0.5
# Share of the square of a force that two neighbouring pieces hold if it is a single
# blow.
BLOW = 0.9
# Share of the largest term of its equation, below which a blow lies outside the rows
# that a filter left.
REMNANT = 0.01
# Standard error of a blow whose place within one sample nobody knows, samples.
BETWEEN_SAMPLES = 12**-0.5
# Singular values of columns of unit length, as a share of the largest, that count.
RANK = 1e-12

COLUMNS = ["delay", "samples", "error", "aligned", "message"]


class Problem(Protocol):
    """What delays need of the problem behind a fit."""

    @property
    def layout(self) -> LawLayout:
        """Columns of the laws."""

    def filters(self, data: Dataset) -> list[ZeroPhaseFilter | None]:
        """The filter of each record."""


class Fitted(FittedRegressor, Protocol):
    """What delays need of a fitted :class:`~pysindy_nrf.NRFRegressor`."""

    @property
    def problem_(self) -> Problem:
        """The problem behind the fit."""

    def fit_data(self, cure: str) -> Dataset:
        """The data of the fit."""


def force_delay(
    estimator: Fitted,
    X: object = None,
    F: ArrayLike | None = None,
    **options: Unpack[DataOptions],
) -> pd.DataFrame:
    """Delay of each measured force against the motion.

    Parameters
    ----------
    estimator : NRFRegressor
        Fitted.
    X, F, **options
        Data as for ``fit``; those of the fit if None.

    Returns
    -------
    DataFrame
        By channel: delay (s), samples and their standard error (error), whether the
        force is aligned, and a message if it is not.

    Raises
    ------
    ChannelError
        If there is no force, or no equation determines a delay.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.diagnosis import force_delay
    >>> model = NRFRegressor(degree=3, estimation="ls").fit(
    ...     datasets.load_demo()
    ... )
    >>> delays = force_delay(model)
    >>> list(delays.index), bool(delays["aligned"].all())
    (['F2'], True)
    """
    if X is None:
        data = estimator.fit_data("Pass X and F.")
    else:
        data = as_segments(estimator, X, F, **options)
    if not data.forced:
        raise ChannelError(
            "No force is measured, so no delay can be estimated", "Measure a force."
        )

    problem = estimator.problem_
    table = delays_of(data, problem.filters(data), problem.layout)
    if table.empty:
        raise ChannelError(
            "No balance determines the delay of its force",
            f"Records of more than {MIN_LENGTH * MAX_SHIFT} samples and laws that"
            " explain the balance are needed.",
        )
    return table


def delays_of(
    data: Dataset, filters: Sequence[ZeroPhaseFilter | None], layout: LawLayout
) -> pd.DataFrame:
    """Delays of the forces whose equation of motion determines one.

    The table is that of :func:`force_delay`.
    """
    rows = {}
    for dof in data.forced:
        delay = _delay(data, filters, layout, dof)
        if delay is not None:
            rows[f"F{dof}"] = delay.row(dof, data.dt)
    table = pd.DataFrame.from_dict(rows, orient="index", columns=COLUMNS)
    return table.rename_axis("channel")


@dataclass(frozen=True)
class _Delay:
    """Delay of a force in samples, and its standard error; NaN if it is unknown."""

    samples: float
    error: float

    @property
    def is_finite(self) -> bool:
        """Whether it could be estimated."""
        return bool(np.isfinite(self.samples) and np.isfinite(self.error))

    @property
    def is_aligned(self) -> bool:
        """Whether the delay is small, or may be chance."""
        size = abs(self.samples)
        return not (size >= LEAST_DELAY and size >= SURE * self.error)

    def row(self, dof: int, dt: float | None) -> tuple[float, float, float, bool, str]:
        """Row of the table."""
        seconds = self.samples * (dt or np.nan)
        message = self.message(dof, dt)
        return seconds, self.samples, self.error, self.is_aligned, message

    def message(self, dof: int, dt: float | None) -> str:
        """Message on the delay; empty if the force is aligned."""
        if np.isnan(self.samples):
            return (
                f"F{dof}: no delay can be estimated, as the laws explain less than half"
                " of its balance, or its blow lies in rows that a filter masked."
            )
        if self.is_aligned:
            return ""
        size = abs(self.samples)
        span = f"{size:.2f} samples"
        if dt:
            span = f"{size * dt * 1e3:.3g} ms ({span})"
        when = "late" if self.samples > 0 else "early"
        return (
            f"F{dof} is {span} {when} against the motion of DOF {dof}: masses and"
            " damping are wrong in proportion to the phase shift. Shift it"
            " (alignment.shifted)."
        )


_Filtered = tuple[Segment, ZeroPhaseFilter | None]


def _delay(
    data: Dataset,
    filters: Sequence[ZeroPhaseFilter | None],
    layout: LawLayout,
    dof: int,
) -> _Delay | None:
    """Delay in samples of the first record; None if it cannot be estimated."""
    delays = []
    for records in _by_sampling_step(data, filters):
        delay = _delay_at_one_step(records, layout, dof)
        if delay is None:
            continue
        step = records[0][0].dt
        ratio = step / data.dt if step and data.dt else 1.0
        delays.append(_Delay(delay.samples * ratio, delay.error * ratio))
    return _combined(delays)


def _combined(delays: Sequence[_Delay]) -> _Delay | None:
    """Mean of some delays, weighted by their errors; None of none."""
    if not delays:
        return None
    finite = [delay for delay in delays if delay.is_finite]
    if len(finite) < 2:
        return finite[0] if finite else delays[0]

    values = [delay.samples for delay in finite]
    errors = np.array([delay.error for delay in finite])
    weights = 1 / np.maximum(errors, 1e-9) ** 2
    mean = float(np.average(values, weights=weights))
    return _Delay(mean, float(weights.sum() ** -0.5))


def _by_sampling_step(
    data: Dataset, filters: Sequence[ZeroPhaseFilter | None]
) -> list[list[_Filtered]]:
    """Records with their filters, those of one sampling step together."""
    groups: list[list[_Filtered]] = []
    for segment, band_filter in zip(data.segments, filters):
        for group in groups:
            if _has_same_step(segment, group[0][0]):
                group.append((segment, band_filter))
                break
        else:
            groups.append([(segment, band_filter)])
    return groups


def _has_same_step(segment: Segment, other: Segment) -> bool:
    """Whether a record has the sampling step of another, or none of its own."""
    if segment.dt is None:
        return True
    return bool(other.dt and abs(segment.dt / other.dt - 1) < SAME_STEP)


def _delay_at_one_step(
    records: Sequence[_Filtered], layout: LawLayout, dof: int
) -> _Delay | None:
    """Delay from records of one sampling step."""
    pieces = []
    fourth_powers = 0.0
    for segment, band_filter in records:
        if _holds_force(segment, dof):
            rows = _rows_with_shifted_force(segment, layout, band_filter, dof)
            fourth_powers += float((rows[-MAX_SHIFT - 1] ** 4).sum())
            for columns in np.array_split(rows, PIECES, axis=1):
                pieces.append(columns @ columns.T)
    if not pieces:
        return None

    total = np.sum(pieces, axis=0)
    best = _best_shift(total)
    if best is None:
        return None
    energy = np.array([piece[-MAX_SHIFT - 1, -MAX_SHIFT - 1] for piece in pieces])
    if not _is_single_blow(energy):
        error = _error_by_pieces(total, pieces)
        return None if error is None else _Delay(best.samples, error)
    if best.remnant < REMNANT:
        return _Delay(np.nan, np.nan)
    # samples of the blow, which all that is left may belong to
    n_samples = energy.sum() ** 2 / fourth_powers
    error = np.hypot(BETWEEN_SAMPLES, best.sharpness * n_samples**-0.5)
    return _Delay(best.samples, float(error))


def _holds_force(segment: Segment, dof: int) -> bool:
    """Whether a record holds a force on a DOF, in enough samples."""
    force = segment.F[segment.valid, dof - 1]
    if np.isnan(force[0]) or not force.any():
        return False
    return len(force) >= MIN_LENGTH * MAX_SHIFT


def _error_by_pieces(total: np.ndarray, pieces: Sequence[np.ndarray]) -> float | None:
    """Standard error of the best shift, from shifts with each piece left out."""
    shifts = []
    for piece in pieces:
        shift = _best_shift(total - piece)
        if shift is None:
            return None
        shifts.append(shift.samples)
    return float(np.sqrt(variance(shifts)))


def _rows_with_shifted_force(
    segment: Segment,
    layout: LawLayout,
    band_filter: ZeroPhaseFilter | None,
    dof: int,
) -> np.ndarray:
    """Columns of an equation of motion, and its force shifted from early to late."""
    massless = dict.fromkeys(range(1, layout.n_dof + 1), 0.0)
    block = whole_block(segment, layout, band_filter)
    rows = rows_of(layout, layout.group((dof,)), block, massless)
    force = rows[-1]
    n_inner = len(force) - 2 * MAX_SHIFT

    shifted = np.lib.stride_tricks.sliding_window_view(force, n_inner)
    return np.vstack([rows[:-1, MAX_SHIFT:-MAX_SHIFT], shifted])


def _is_single_blow(energy: np.ndarray) -> bool:
    """Whether two neighbouring pieces hold nearly all of a force."""
    of_two = energy + np.append(energy[1:], 0.0)
    return bool(of_two.max() > BLOW * energy.sum())


@dataclass(frozen=True)
class _Shift:
    """The shift of a force that leaves least.

    Attributes
    ----------
    samples : float
        NaN if all shifts leave most of the force.
    sharpness : float
        Standard error of the shift for one sample.
    remnant : float
        The force over the largest term of its equation.
    """

    samples: float
    sharpness: float
    remnant: float


def _best_shift(gram: np.ndarray) -> _Shift | None:
    """The shift at which the force leaves least; None at the ends of the range."""
    n_columns = len(gram) - 2 * MAX_SHIFT - 1
    size = np.sqrt(np.diag(gram))
    if not (size > 0).all():
        return None

    unit = gram / size[:, None] / size
    matrix = unit[:n_columns, :n_columns]
    forces = unit[:n_columns, n_columns:]
    values = linalg.lstsq(matrix, forces, cond=RANK, check_finite=False)[0]
    unexplained = 1.0 - np.einsum("ij,ij->j", forces, values)
    k = int(np.argmin(unexplained))
    if unexplained[k] > UNEXPLAINED:
        return _Shift(np.nan, np.nan, np.nan)
    if not 0 < k < 2 * MAX_SHIFT:
        return None

    remnant = 1.0 / max(float(np.abs(values[:, k]).max()), 1e-300)
    bend = unexplained[k - 1] - 2 * unexplained[k] + unexplained[k + 1]
    if bend <= 0:
        return _Shift(float(k - MAX_SHIFT), np.inf, remnant)
    offset = 0.5 * (unexplained[k - 1] - unexplained[k + 1]) / bend
    lowest = max(unexplained[k] - 0.5 * bend * offset**2, 0.0)
    sharpness = float(np.sqrt(2.0 * lowest / bend))
    return _Shift(float(k - MAX_SHIFT + offset), sharpness, remnant)
