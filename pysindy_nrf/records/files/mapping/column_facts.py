"""What the columns of a file look like: range, spectrum, and relation to each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..table import Table
from ..units import kind_of_unit, si_factor
from .expression import as_name

MAX_COLUMNS = 64  # that are looked at
MAX_ROWS = 65536  # that are looked at
# Steps of a time may vary by this share; a logger's clock does by less.
TIME_JITTER = 0.05
# Correlation from which on a column is a derivative of another. 300 pairs of unrelated
# noises in narrow bands reach 0.90, motions of two floors of the demo 0.60; sensors of
# one floor of it with 2 % noise are above 0.95.
DERIVATIVE_CORRELATION = 0.95
# By which a derivative must fit better than the column itself, as a share of what is
# left: a motion of one frequency is its own second derivative.
CLEARER_THAN_ITSELF = 0.2
MIN_ROWS = 32
SHORTEST_OF_FILES = 0.5  # of the longest, that are channels of one test


SLOW = 8.0  # Hz; accelerations of structures are sampled faster
SLOWEST_STEP = 100.0  # s; no test is sampled more slowly
TICKS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}  # of a second


def unit_of_ticks(step: float) -> str:
    """The largest unit of time in which a step is short enough for a structure."""
    fast_enough = (unit for unit, n in TICKS.items() if not n / step < SLOW)
    return next(fast_enough, "ns")


@dataclass(frozen=True)
class Relation:
    """A column is a derivative of another.

    Parameters
    ----------
    order : {1, 2}
    of : str
        The mapping of the other column.
    factor : float
        By which the derivative is multiplied, per second where the clock is known.
    """

    order: int
    of: str
    factor: float


@dataclass(frozen=True, eq=False)
class ColumnFacts:
    """What one column looks like.

    Parameters
    ----------
    text : str
        Its mapping, ``name`` or ``name[:, k]``.
    variable : str
        The variable of the file.
    values : ndarray or None
        None for a column without numbers.
    is_time : bool
        Whether it rises in even steps.
    frequency : float
        Frequency below which half of its variance lies, Hz; per sample without a time.
    relation : Relation, optional
    """

    text: str
    variable: str
    values: np.ndarray | None
    is_time: bool = False
    frequency: float = float("nan")
    relation: Relation | None = None

    @property
    def step(self) -> float:
        """Mean step of a time; NaN for any other column."""
        if self.values is None or not self.is_time:
            return float("nan")
        return float((self.values[-1] - self.values[0]) / (len(self.values) - 1))

    @property
    def is_constant(self) -> bool:
        """Whether it does not move."""
        if self.values is None:
            return False
        finite = self.values[np.isfinite(self.values)]
        return not finite.size or float(np.ptp(finite)) == 0.0


def column_facts(table: Table) -> list[ColumnFacts]:
    """Facts on the columns of the longest variables of a file."""
    columns = list(_columns(table))[:MAX_COLUMNS]
    step = _sampling_step(columns, table)
    moving = {
        column: column.values[:MAX_ROWS]
        for column in columns
        if column.values is not None and _has_spectrum(column, column.values)
    }
    with_spectra = {column.text: column for column in _with_spectra(moving, step)}
    return [with_spectra.get(column.text, column) for column in columns]


def _sampling_step(columns: Sequence[ColumnFacts], table: Table) -> float:
    """Step of the first column that is a time, s; in its unit, or that of its ticks."""
    otherwise = 1.0 / table.fs if table.fs is not None else 1.0
    for column in columns:
        if column.values is None or not column.is_time:
            continue
        ticks = _step(column.values) or otherwise
        unit = table.units.get(column.variable) or ""
        if kind_of_unit(unit) == "t":
            return ticks * si_factor(unit, "t")
        is_in_seconds = ticks < SLOWEST_STEP
        return ticks if is_in_seconds else ticks / TICKS[unit_of_ticks(ticks)]
    return otherwise


def _has_spectrum(column: ColumnFacts, values: np.ndarray) -> bool:
    is_long = len(values) >= MIN_ROWS and bool(np.isfinite(values[:MAX_ROWS]).all())
    return is_long and not column.is_time and not column.is_constant


def _columns(table: Table) -> Iterator[ColumnFacts]:
    """Columns of the longest variables, and whether they are times."""
    lengths = [max(values.shape) for values in table.variables.values() if values.ndim]
    longest = max(lengths, default=0)
    # channels of one test in several files may differ in length
    shortest = longest * SHORTEST_OF_FILES if table.files else longest
    for name, values in table.variables.items():
        if values.ndim in (1, 2) and max(values.shape) >= shortest:
            yield from _columns_of_variable(name, values)


def _columns_of_variable(name: str, values: np.ndarray) -> Iterator[ColumnFacts]:
    """The longer lines of a matrix, or a variable of one dimension."""
    if values.ndim == 2 and values.shape[0] < values.shape[1]:
        for k, row in enumerate(values):
            yield _column(f"{as_name(name)}[{k}, :]", name, row)
    elif values.dtype.kind not in "biuf":
        yield ColumnFacts(as_name(name), name, None)
    elif values.ndim == 1:
        yield _column(as_name(name), name, values)
    else:
        for k, column in enumerate(values.T):
            yield _column(f"{as_name(name)}[:, {k}]", name, column)


def _column(text: str, variable: str, values: np.ndarray) -> ColumnFacts:
    line = values.astype(float)
    return ColumnFacts(text, variable, line, is_time=_step(line) is not None)


def _step(line: np.ndarray) -> float | None:
    """The step of a column that rises evenly; None for any other."""
    if len(line) < 3 or not np.isfinite(line).all():
        return None
    steps = np.diff(line)
    mean = (line[-1] - line[0]) / (len(line) - 1)
    if mean <= 0 or np.abs(steps - mean).max() > TIME_JITTER * mean:
        return None
    return float(mean)


def _with_spectra(
    moving: Mapping[ColumnFacts, np.ndarray], step: float
) -> list[ColumnFacts]:
    """Columns with their frequencies and relations."""
    if not moving:
        return []
    columns = list(moving)
    n_rows = min(map(len, moving.values()))
    lines = np.array([line[:n_rows] for line in moving.values()])
    lines = lines - lines.mean(axis=1, keepdims=True)
    taper = np.hanning(lines.shape[1])
    spectra = np.fft.rfft(lines * taper, axis=1)[:, 3:]
    frequencies = np.fft.rfftfreq(lines.shape[1], step)[3:]

    power = np.cumsum(np.abs(spectra) ** 2, axis=1)
    middle = np.argmax(power >= 0.5 * power[:, -1:], axis=1)
    relations = _relations([column.text for column in columns], spectra, frequencies)
    return [
        replace(column, frequency=float(frequencies[k]), relation=relation)
        for column, k, relation in zip(columns, middle, relations)
    ]


def _relations(
    names: Sequence[str], spectra: np.ndarray, frequencies: np.ndarray
) -> list[Relation | None]:
    """For each column the derivative of another that it is, if it is one.

    Spectra are weighted by the frequency to the power of minus the order, half way
    between the two columns.
    """
    w = 2 * np.pi * frequencies
    correlations = {}
    factors = {}
    for order in (0, 1, 2):
        derivative = (1j * w) ** order * spectra
        weight = w**-order
        products = ((weight * spectra) @ derivative.conj().T).real
        size = (weight * np.abs(spectra) ** 2).sum(axis=1)
        size_of_derivative = (weight * np.abs(derivative) ** 2).sum(axis=1)
        scale = np.sqrt(np.outer(size, size_of_derivative))
        correlations[order] = np.abs(products) / np.maximum(scale, 1e-300)
        factors[order] = products / np.maximum(size_of_derivative, 1e-300)

    left_by_itself = 1 - correlations[0]
    relations: list[Relation | None] = []
    for i in range(len(names)):
        best = None
        for order in (2, 1):
            correlation = correlations[order][i].copy()
            correlation[i] = 0.0
            j = int(correlation.argmax())
            unexplained = 1 - correlation[j]
            is_clear = unexplained < CLEARER_THAN_ITSELF * left_by_itself[i, j]
            is_better = best is None or correlation[j] > best[0]
            if correlation[j] > DERIVATIVE_CORRELATION and is_clear and is_better:
                factor = float(factors[order][i, j])
                best = (correlation[j], Relation(order, names[j], factor))
        relations.append(best[1] if best else None)
    return relations
