"""Errors of all channels within tolerances, fitted together with a model.

An effect that such errors would explain as well is not claimed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from ..exceptions import NRFError
from ..laws.base import ForceLaw
from ..laws.sensor import SensorFault
from . import judge
from .channel_readings import (
    CalibrationError,
    ChannelReadings,
    possible_errors,
    with_errors,
)
from .effects import Effect
from .error_fit import ERROR_FIT, ErrorFit, thinned_columns
from .error_reduction import ErrorReduction
from .fitted_model import FittedModel
from .judge import JUDGE
from .prepare import PreparedRecords
from .row_changes import RowChange, TouchedRows, changes_of_rows, touched_rows
from .search_data import SearchData
from .spectra import BalanceSpectra


@dataclass(frozen=True)
class ChannelErrorSettings:
    """Errors that channels have, and when they explain an effect."""

    # Errors that every channel may have where nothing else is known: gain, and part of
    # another DOF's channel, as shares; delay in samples. Rectangular (GUM), so that
    # calibrations and mountings scatter by 1.2 %. All of them together explain an
    # effect if their squares, in standard deviations, come to the median for one error
    # a channel at most. Without that limit chains with imperfect sensors alone use 0.6
    # to 1.5 times it (seed 401), a tie to the ground that changes a balance by 2 % uses
    # 2.6 times.
    gain: float = 0.02
    cross_axis: float = 0.02
    delay: float = 0.4
    # Squares of likely errors, in standard deviations: nine in ten of those that act as
    # one law does. Those of imperfect sensors that a law stood in for need less than 2
    # (seed 1701), to act as a tie of 4 % takes 3.9 (1901).
    likely: float = float(chi2.ppf(0.9, 1))
    # An effect needs no errors that leave less than a tenth of what they explain
    # without it.
    needless_share: float = 0.1
    # Errors explain more than an effect if by more than this, dB.
    more: float = 0.05
    # Share of its own reduction that an effect must keep where they do.
    kept_share: float = 0.5


CHANNEL_ERRORS = ChannelErrorSettings()
# Names of the errors by the order of the derivative that a fault adds to its channel.
_NAMES = {0: "gain", 1: "delay"}


def default_tolerances(sampling_step: float) -> dict[str, float]:
    """Errors that every channel may have where nothing else is known; delay in s."""
    return {
        "gain": CHANNEL_ERRORS.gain,
        "cross_axis": CHANNEL_ERRORS.cross_axis,
        "delay": CHANNEL_ERRORS.delay * sampling_step,
    }


@dataclass(frozen=True)
class FreedModel:
    """A model on records freed of errors, and these in standard deviations."""

    model: FittedModel
    sizes: np.ndarray


# What errors change in rows of the spectra.
_Changes = dict[tuple[CalibrationError, TouchedRows], np.ndarray]


class ChannelErrors:
    """Errors of the channels of a search, estimated on one set of spectra.

    The size of a fault that was found is uncertain by itself: it was fitted where other
    errors were taken for none.

    Parameters
    ----------
    spectra : BalanceSpectra
    records : PreparedRecords
    tolerances : mapping of str to float
        See :func:`pysindy_nrf.close_loop`.
    known : sequence of Effect
        Effects that were found.
    left_out : collection of str
        Channels whose errors are not among them.
    """

    def __init__(
        self,
        spectra: BalanceSpectra,
        records: PreparedRecords,
        tolerances: Mapping[str, float],
        known: Sequence[Effect],
        left_out: Collection[str] = (),
    ) -> None:
        self.spectra = spectra
        self.data: SearchData = spectra.data
        self.thin = thinned_columns(spectra)
        self.readings = {
            i: ChannelReadings(self.data, records, i) for i in self.data.searched
        }
        possible = self._possible(tolerances, known)
        self.errors = [error for error in possible if error.channel not in left_out]
        # what errors change in rows: of the last model, and of the one before
        self._changes: _Changes = {}
        self._earlier_changes: _Changes = {}

    def _possible(
        self, tolerances: Mapping[str, float], known: Sequence[Effect]
    ) -> list[CalibrationError]:
        """Errors that the channels may have, as large as faults that were found."""
        sizes = _sizes_of_faults(known)
        measured: set[str] = set()
        for channels in self.readings.values():
            measured |= channels.measured

        out = []
        for error in possible_errors(measured, self.data.n_dof, tolerances):
            size = sizes.get((error.channel, error.name), 0.0)
            out.append(replace(error, deviation=max(error.deviation, size)))
        return out

    def freed(
        self,
        model: FittedModel,
        start: np.ndarray | None = None,
        limit: float | None = None,
    ) -> FreedModel:
        """The model on records freed of the likeliest errors of all channels.

        Least squares; masses, coefficients and weights follow the errors (variable
        projection, Golub and Pereyra 1973).

        Parameters
        ----------
        model : FittedModel
        start : ndarray of shape (n_errors,), optional
            Standard deviations.
        limit : float, optional
            Largest sum of the squares of the errors; the median for one error a channel
            if None.
        """
        if not self.errors:
            return FreedModel(model, np.zeros(0))
        if limit is None:
            limit = float(chi2.median(len({e.channel for e in self.errors})))
        if start is None:
            start = np.zeros(len(self.errors))

        fit = ErrorFit(model, self.thin, self._row_changes(model), limit)
        sizes = fit.likeliest(start)
        sized = [(e, x * e.deviation) for e, x in zip(self.errors, sizes)]
        with suppress(NRFError):
            freed = model.on_motions(with_errors(self.data, self.readings, sized))
            if freed.reduction_from(model).value > 0:
                return FreedModel(freed, sizes)
        return FreedModel(model, sizes)

    # -- what errors change ----------------------------------------------------

    def _row_changes(self, model: FittedModel) -> list[RowChange]:
        """What each error of one standard deviation changes in the rows of a model."""
        new: _Changes = {}
        changes = []
        for number, error in enumerate(self.errors):
            touched = list(touched_rows(model, error.dof, error.kind == "F"))
            new |= self._known_changes(error, touched)
            missing = [pair for pair in touched if (error, pair[0]) not in new]
            if missing:
                new |= self._made_changes(model, error, missing)
            for rows, first in touched:
                for k, change in enumerate(new[error, rows]):
                    changes.append(RowChange(change, first + k, number))

        self._earlier_changes = self._changes
        self._changes = new
        return changes

    def _known_changes(
        self, error: CalibrationError, touched: Sequence[tuple[TouchedRows, int]]
    ) -> _Changes:
        """Changes that were made for one of the last two models."""
        known = {}
        for rows, _ in touched:
            for cache in (self._changes, self._earlier_changes):
                if (error, rows) in cache:
                    known[error, rows] = cache[error, rows]
        return known

    def _made_changes(
        self,
        model: FittedModel,
        error: CalibrationError,
        missing: Sequence[tuple[TouchedRows, int]],
    ) -> _Changes:
        """Changes by differences, a standard deviation of the error scaled up."""
        share = ERROR_FIT.difference
        step = [(error, share * error.deviation)]
        moved = self.data.with_data(with_errors(self.data, self.readings, step))
        made = changes_of_rows(model, moved, missing)
        changes: _Changes = {}
        for rows, change in made.items():
            changes[error, rows] = change[:, self.thin] / share
        return changes


def _sizes_of_faults(known: Sequence[Effect]) -> dict[tuple[str, str], float]:
    """Sizes of the faults that were found, by channel and name of the error."""
    sizes = {}
    for effect in known:
        if isinstance(effect.law, SensorFault) and effect.law.order in _NAMES:
            name = _NAMES[effect.law.order]
            for channel in effect.site.channels:
                sizes[channel, name] = abs(effect.law.share)
    return sizes


# -- the test ------------------------------------------------------------------


@dataclass(frozen=True)
class BeyondErrors:
    """What an effect gains where both models are freed of errors of the channels."""

    reduction: ErrorReduction
    # Whether it needs more than errors.
    is_there: bool


class ChannelErrorTest:
    """Do errors of the channels within tolerances explain an effect as well?

    Parameters
    ----------
    tolerances : mapping of str to float
    """

    def __init__(self, tolerances: Mapping[str, float]) -> None:
        self.tolerances = tolerances
        self._errors: ChannelErrors | None = None
        self._freed: tuple[FittedModel, FreedModel] | None = None

    def forget(self) -> None:
        """Free the memory of earlier models, which are hardly asked for again."""
        self._errors, self._freed = None, None

    def beyond(
        self,
        after: FittedModel,
        before: FittedModel,
        law: ForceLaw,
        records: PreparedRecords,
        known: Sequence[Effect],
    ) -> BeyondErrors:
        """Error reduction of a law where both models are freed of errors.

        A law that alone explains what a hundred errors would explain together needs
        none of them: its own reduction counts, unless likely errors explain as much.
        Where errors explain more, it must keep half of its reduction, or a large one.
        """
        errors = self._errors_on(before.spectra, records, known)
        freed = self._freed_of(errors, before)
        plain = after.reduction_from(before)
        of_errors = freed.model.reduction_from(before).value
        # a hundred errors are fitted to what is left
        explain_more = of_errors > plain.value + CHANNEL_ERRORS.more
        least = 0.0
        if explain_more:
            half = CHANNEL_ERRORS.kept_share * plain.value
            least = min(half, JUDGE.large_reduction)

        without_errors = _reduction_without_errors(after, freed.model, law, least)
        if without_errors is not None:
            return BeyondErrors(without_errors, True)

        freed_after = errors.freed(after, freed.sizes)
        used = freed_after.model.reduction_from(after).value
        if used <= CHANNEL_ERRORS.needless_share * of_errors:
            likely = before
            if explain_more:
                likely = errors.freed(before, limit=CHANNEL_ERRORS.likely).model
            if likely.reduction_from(before).value < plain.value:
                return BeyondErrors(plain, judge.is_there(plain, law))

        beyond = freed_after.model.reduction_from(freed.model)
        if not judge.is_there(beyond, law):
            return BeyondErrors(beyond, False)

        # the errors beside the law may lie nearer to the least without it
        again = errors.freed(before, freed_after.sizes)
        if again.model.reduction_from(freed.model).value > 0:
            self._freed = before, again
            beyond = freed_after.model.reduction_from(again.model)
        there = judge.is_there(beyond, law) and beyond.value >= least
        return BeyondErrors(beyond, there)

    def of_other_channels(
        self,
        channels: Collection[str],
        before: FittedModel,
        records: PreparedRecords,
        known: Sequence[Effect],
    ) -> float:
        """Error reduction of likely errors of all channels but some, dB."""
        errors = ChannelErrors(
            before.spectra, records, self.tolerances, known, left_out=channels
        )
        freed = errors.freed(before, limit=CHANNEL_ERRORS.likely)
        return freed.model.reduction_from(before).value

    def _errors_on(
        self,
        spectra: BalanceSpectra,
        records: PreparedRecords,
        known: Sequence[Effect],
    ) -> ChannelErrors:
        """Errors of the channels behind some spectra, made once."""
        if self._errors is None or self._errors.spectra is not spectra:
            self._errors = ChannelErrors(spectra, records, self.tolerances, known)
        return self._errors

    def _freed_of(self, errors: ChannelErrors, before: FittedModel) -> FreedModel:
        """A model freed of the likeliest errors, found once."""
        if self._freed is None or self._freed[0] is not before:
            self._freed = before, errors.freed(before)
        return self._freed[1]


def _reduction_without_errors(
    after: FittedModel, freed: FittedModel, law: ForceLaw, least: float
) -> ErrorReduction | None:
    """What a law gains over the freed model with no errors of its own.

    They would add to its reduction. None if that is not enough.
    """
    with suppress(NRFError):
        own_reduction = after.reduction_from(freed)
        if judge.is_there(own_reduction, law) and own_reduction.value >= least:
            return own_reduction
        beside = after.refitted(freed.spectra).reduction_from(freed)
        if judge.is_there(beside, law) and beside.value >= least:
            return beside
    return None
