"""An effect judged at another amplitude of its site.

A law that is there holds at every amplitude; one that bends the misfit of another law
does not. Samples are sorted by the drift at the site into quarters. Coefficients from
the lower three judge the upper one, those from the upper half judge the lower half. All
columns are first computed along the complete records, memory included.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.sites import Site
from ..equations.normal_equations import leave_one_out, variance
from ..laws.base import ForceLaw
from .error_reduction import REDUCTION, mean_reduction, residual_share
from .fitted_model import FittedModel
from .search_data import SearchData


@dataclass(frozen=True)
class AmplitudeSettings:
    """Numbers of the comparison of amplitudes.

    Chosen on 16 measured records of which others of the same structure were at hand:
    2 of 21 later effects that made those worse by more than 1 dB passed.
    """

    # Quarters of the samples, by amplitude.
    n_parts: int = 4
    # Pieces of time for the standard error, by the jackknife.
    n_pieces: int = 10


AMPLITUDE = AmplitudeSettings()
# Parts to which coefficients are fitted, and those that are judged by them.
DIRECTIONS: tuple[tuple[list[int], list[int]], ...] = (
    ([0, 1, 2], [3]),
    ([2, 3], [0, 1]),
)


@dataclass(frozen=True)
class OtherCondition:
    """Error reduction of an effect at a condition that its fit did not see, dB."""

    value: float
    error: float

    def exceeds(self, least: float, errors: float) -> bool:
        """Whether it is so many dB at least, and so many standard errors above zero."""
        return bool(self.value >= least and self.value > errors * self.error)

    @property
    def fails(self) -> bool:
        """Whether the error rises by more than its standard error."""
        return bool(self.value < -self.error)

    def is_below(self, least: float) -> bool:
        """Whether the reduction is less than so many dB, by two standard errors."""
        return bool(self.value + REDUCTION.sure_errors * self.error < least)


# Of an effect that a condition says nothing of.
NOT_JUDGED = OtherCondition(0.0, np.inf)


def at_other_amplitudes(
    before: FittedModel, after: FittedModel, sites: Iterable[Site]
) -> OtherCondition:
    """The error reduction from one model to another at other amplitudes of some sites.

    Parameters
    ----------
    before, after : FittedModel
        Without and with an effect.
    sites : iterable of Site
        Where it acts.
    """
    data = after.spectra.data
    if data.forces.unknown:
        return NOT_JUDGED
    columns, numbers = _columns([before, after], data)
    places = [[numbers.index(n) for n in m.row_numbers] for m in (before, after)]
    values = []
    for site in sites:
        products = _products(columns, _drift(site, data))
        for fitted, judged in DIRECTIONS:
            halves = products[:, fitted].sum(axis=1), products[:, judged].sum(axis=1)
            powers = []
            for model, rows in zip((before, after), places):
                block = np.ix_(range(len(halves[0])), rows, rows)
                powers.append(_powers(model, halves[0][block], halves[1][block]))
            values.append(_reduction(*powers))
    return _weighted_mean(values)


def _columns(
    models: Sequence[FittedModel], data: SearchData
) -> tuple[np.ndarray, list[int]]:
    """Rows of some models along all searched samples, and their numbers.

    In the band that was diagnosed; the mean over each piece of time is taken out. Shape
    (n_rows, n_samples).
    """
    placed: dict[tuple[Site, ForceLaw], None] = {}
    numbers: dict[int, None] = {}
    for model in models:
        for site in model.layout.sites:
            placed.update(
                dict.fromkeys((site, law) for law in model.laws.get(site, ()))
            )
    for site, law in placed:
        numbers.update(dict.fromkeys(models[0].spectra.numbers_of(site, law)))
    n_terms = models[0].first_fixed
    numbers.update(dict.fromkeys(models[0].row_numbers[n_terms:]))

    parts = []
    for record in data.searched:
        rows = [data.columns(site, [law], [record]) for site, law in placed]
        every = np.vstack([*rows, *data.fixed([record])])
        filter_ = data.filters[record]
        if filter_ is not None:
            every = filter_.apply(every.T).T
        parts += [every[:, run] for run in data.runs(record)]
    columns = np.concatenate(parts, axis=1)
    for piece in _pieces(columns.shape[1]):
        columns[:, piece] -= columns[:, piece].mean(axis=1, keepdims=True)
    return columns, list(numbers)


def _pieces(n_samples: int) -> list[slice]:
    """Pieces of time of equal length."""
    edges = np.linspace(0, n_samples, AMPLITUDE.n_pieces + 1).astype(int)
    return [slice(low, high) for low, high in zip(edges[:-1], edges[1:])]


def _drift(site: Site, data: SearchData) -> np.ndarray:
    """Size of the drift at a site along all searched samples."""
    parts = []
    for record in data.searched:
        drift = data.motion(site, record).s
        parts += [drift[run] for run in data.runs(record)]
    drift = np.concatenate(parts)
    return np.abs(drift - np.median(drift))


def _products(columns: np.ndarray, drift: np.ndarray) -> np.ndarray:
    """Products by piece of time and quarter of the amplitude."""
    limits = np.quantile(drift, np.arange(1, AMPLITUDE.n_parts) / AMPLITUDE.n_parts)
    quarter = np.searchsorted(limits, drift)
    by_piece = []
    for piece in _pieces(len(drift)):
        by_part = []
        for number in range(AMPLITUDE.n_parts):
            chosen = columns[:, piece][:, quarter[piece] == number]
            by_part.append(chosen @ chosen.T)
        by_piece.append(by_part)
    return np.array(by_piece)


def _reduction(
    before: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray]
) -> OtherCondition:
    """Error reduction on one half of the samples with coefficients from the other.

    Both models over the same reference: with its own a tie to the ground of a shaken
    frame would gain what its reference grows.
    """
    missed_before, reference = before
    missed, _ = after
    with np.errstate(divide="ignore", invalid="ignore"):
        share_before = residual_share(missed_before, reference)
        share = residual_share(missed, reference)
    known = (np.isfinite(share_before) & np.isfinite(share)).all(axis=0)
    each = mean_reduction(share_before, share, known)
    error = float(np.sqrt(variance(each[1:])))
    if not known.any() or not np.isfinite(error):
        return NOT_JUDGED
    return OtherCondition(float(each[0]), max(error, 1e-9))


def _powers(
    model: FittedModel, fitted: np.ndarray, judged: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Power of residual and reference on the judged samples.

    From all pieces, then with each piece left out; (n_pieces + 1, n_balances, 1).
    """
    every = np.concatenate([fitted.sum(axis=0)[None], leave_one_out(fitted)])
    of_judged = np.concatenate([judged.sum(axis=0)[None], leave_one_out(judged)])
    solver = model.solver
    sums = np.repeat(every[:, None], len(solver.groups), axis=1)
    masses, coefficients = solver.solve(sums, False)
    powers = []
    for rows in solver.rows(masses, coefficients):
        along = ((rows @ of_judged) * rows).sum(axis=-1)
        powers.append(np.maximum(along, 0.0)[..., None])
    return powers[0], powers[1]


def _weighted_mean(values: Sequence[OtherCondition]) -> OtherCondition:
    """The mean of several error reductions by their variances."""
    weights = np.array([1.0 / value.error**2 for value in values])
    if not weights.sum() > 0:
        return NOT_JUDGED
    mean = float(np.average([value.value for value in values], weights=weights))
    return OtherCondition(mean, float(1.0 / np.sqrt(weights.sum())))
