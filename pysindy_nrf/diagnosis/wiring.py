"""Errors of wiring: channels reversed, exchanged, or in another unit.

A fault of one channel shows against another of the same floor in their ratio. What no
ratio shows, such as a force on the wrong floor, shows in the equations of motion: with
the right mapping of the channels they close.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..equations.errors import balance_errors
from ..equations.normal_equations import NormalEquations
from ..equations.solution import DOUBTFUL_MASS, Solution
from ..exceptions import NRFError, NRFWarning
from ..records.checks.alignment import channel_alignment
from ..records.record import MATRICES, Record

# Percent of the force of a balance unexplained, above which nothing may be concluded
# from it.
OPEN = 50.0
# Percent above which its estimates deserve a word: as much as 5 % noise leaves of
# linear chains (14.7 at most).
LARGE = 15.0
# Fall of an error that tells mappings apart: of two equally wrong ones, one leaves a
# third of the other once in a thousand where a record holds ten independent cycles
# (0.999 quantile of the variance ratio F(10, 10): 8.8).
TELLING_FALL = 3.0
# Other mappings whose error is at most this many times that of the best one close the
# balances as well.
EQUALLY_GOOD = 1.1
# Ratio of two channels of one motion that no calibration has, and the ratio from which
# on only another unit (the nearest are cm and in) or another column explains it.
OTHER_MOTION, OTHER_UNIT = 1.2, 2.0
# Samples of all records that suffice to tell which channels close a balance.
MAX_SAMPLES = 10_000
# Mappings of the channels that are fitted to fused motions.
MAX_FITTED_MAPPINGS = 6
# DOFs up to which every pair of channels is exchanged; beyond, neighbours only.
MAX_DOFS_FOR_ALL_PAIRS = 6
# Percent; an error below is round-off.
_LEAST_ERROR = 1e-9
_MOTIONS = ("acceleration", "velocity", "displacement")


class Fitted(Protocol):
    """A model and the normal equations that it was solved from."""

    @property
    def model(self) -> ChainModel:
        """The model."""

    @property
    def grams(self) -> NormalEquations:
        """The normal equations."""

    @property
    def solution(self) -> Solution:
        """What is known of the solve."""


Solve = Callable[[list[Record]], Fitted]


@dataclass(frozen=True)
class WiringError:
    """An error of wiring that a record may hold.

    Parameters
    ----------
    words : str
        Such as ``"F2 reversed"``.
    correct : callable
        From a record to the record without the error.
    """

    words: str
    correct: Callable[[Record], Record]


@dataclass(frozen=True, eq=False)
class Closure:
    """How well the balances of records close.

    Parameters
    ----------
    impossible : bool
        Whether the solve failed, or a mass is not positive although the part of its
        inertia that no other term imitates is larger than what its balance leaves. The
        sign of a smaller one says nothing.
    errors : ndarray of shape (n_dof,)
        Percent NRMSE by DOF.
    noise_decides : bool
        Whether noise decides one of the masses, and with it all that follow.
    """

    impossible: bool
    errors: np.ndarray
    noise_decides: bool = False

    @property
    def size(self) -> float:
        """Sum of the logarithms of the errors."""
        return float(np.log(self.errors).sum())

    @property
    def rank(self) -> tuple[bool, float]:
        """The smaller, the better the balances close."""
        return self.impossible, self.size


# -- channels of one floor beside each other -----------------------------------


def suspect_channels(records: Iterable[Record]) -> dict[str, bool]:
    """Channels that seem reversed, in another unit or in the wrong column.

    Returns
    -------
    dict of str to bool
        What one of two channels of a floor is, and whether that is sure.
    """
    faults: dict[str, bool] = {}
    for record in records:
        with suppress(NRFError):  # no floor has two kinds of channels
            table = channel_alignment(record)
            for _, row in table[~table["aligned"].astype(bool)].iterrows():
                faults |= _fault_of_channel(row)
    return faults


def _fault_of_channel(row: pd.Series) -> dict[str, bool]:
    """The fault of one row of a table of aligned channels, if it is one of wiring."""
    if row["sign"] < 0:
        return {f"{row['message']}: one of them is reversed.": True}

    off = abs(np.log(row["gain"]))  # NaN where the channels do not resemble each other
    if off > np.log(OTHER_UNIT):
        conclusion = "one of them is in another unit or another column"
        return {f"{row['message']}: {conclusion}.": True}
    if not off < np.log(OTHER_MOTION):
        return {f"{row['message']}.": False}
    return {}


# -- mappings of the channels --------------------------------------------------


def wiring_errors(record: Record, open_dofs: Iterable[int] = ()) -> list[WiringError]:
    """Errors of wiring that a record may hold.

    Parameters
    ----------
    record : Record
    open_dofs : iterable of int
        DOFs whose balance does not close; on a tall chain their channels are exchanged
        with those of every other floor.
    """
    return [
        *_errors_of_forces(record),
        *_errors_of_sensors(record, set(open_dofs)),
        *_errors_of_the_base(record),
    ]


def _errors_of_forces(record: Record) -> Iterator[WiringError]:
    """Forces that are reversed, exchanged, or act on another floor."""
    forced, floors = record.forced, range(1, record.n_dof + 1)
    for j, k in itertools.product(forced, floors):
        if k in record.unknown or (k in forced and k < j):
            continue
        words = f"the force F{j} acting on floor {k}"
        if k == j:
            words = f"F{j} reversed"
        elif k in forced:
            words = f"F{j} and F{k} exchanged"
        yield WiringError(words, _exchange(("force",), j, k))

    if len(forced) > 1:
        yield WiringError("all forces reversed", _reverse_all_forces)


def _errors_of_sensors(record: Record, open_dofs: set[int]) -> Iterator[WiringError]:
    """Sensors of the motion that are reversed, or exchanged with another floor's."""
    measured = {kind: _measured_dofs(record, kind) for kind in _MOTIONS}
    for j, k in _pairs_of_floors(record.n_dof, open_dofs):
        kinds = tuple(kind for kind in _MOTIONS if {j, k} <= measured[kind])
        groups: list[tuple[str, ...]] = [(kind,) for kind in kinds]
        if len(kinds) > 1:
            groups.append(kinds)
        for group in groups:
            yield WiringError(_of_sensors(group, j, k), _exchange(group, j, k))


def _pairs_of_floors(n_dof: int, open_dofs: set[int]) -> Iterator[tuple[int, int]]:
    """Floors whose sensors may be exchanged; a floor with itself is reversed."""
    floors = range(1, n_dof + 1)
    for j, k in itertools.combinations_with_replacement(floors, 2):
        neighbours = k <= j + 1
        if n_dof <= MAX_DOFS_FOR_ALL_PAIRS or neighbours or {j, k} <= open_dofs:
            yield j, k


def _of_sensors(kinds: Sequence[str], j: int, k: int) -> str:
    """An error of the sensors of one or two floors, in words."""
    letters = [MATRICES[kind] for kind in kinds]
    if j == k:
        return f"{' and '.join(f'{letter}{j}' for letter in letters)} reversed"
    pairs = [f"{letter}{j} and {letter}{k}" for letter in letters]
    return f"{', '.join(pairs)} exchanged"


def _errors_of_the_base(record: Record) -> Iterator[WiringError]:
    """Motions in the other coordinates, and a base that is reversed."""
    if not record.base_moves:
        return

    taken_as = {"relative": "absolute", "absolute": "relative to the base"}
    if _measured_dofs(record, "displacement") or _measured_dofs(record, "velocity"):
        words = f"velocities and displacements taken as {taken_as[record.coordinates]}"
        yield WiringError(words, _in_other_coordinates)
    if record.base_acceleration is not None:
        yield WiringError("ag reversed", _reverse_base)


def _measured_dofs(record: Record, kind: str) -> set[int]:
    """DOFs at which a kind of channel was measured."""
    channels = getattr(record, kind)
    if channels is None:
        return set()
    return set((np.flatnonzero(~np.isnan(channels).all(axis=0)) + 1).tolist())


def _exchange(kinds: tuple[str, ...], j: int, k: int) -> Callable[[Record], Record]:
    """A function that exchanges channels of two DOFs, or reverses those of one."""

    def exchanged(record: Record) -> Record:
        order, signs = np.arange(record.n_dof), np.ones(record.n_dof)
        order[[j - 1, k - 1]] = k - 1, j - 1
        if j == k:
            signs[j - 1] = -1.0
        changes = {}
        for kind in kinds:
            changes[kind] = getattr(record, kind)[:, order] * signs
        return record.replace(**changes)

    return exchanged


def _reverse_all_forces(record: Record) -> Record:
    return record.replace(force=-record.force)


def _reverse_base(record: Record) -> Record:
    return record.replace(base_acceleration=-np.asarray(record.base_acceleration))


def _in_other_coordinates(record: Record) -> Record:
    other = "absolute" if record.coordinates == "relative" else "relative"
    return record.replace(coordinates=other)


# -- the mapping with which the balances close ---------------------------------


def mapping_that_closes(
    records: Sequence[Record],
    solve: Solve,
    quick: Solve,
    known: Collection[int] = (),
) -> str:
    """The error of wiring without which balances close that did not, in words.

    Parameters
    ----------
    records : sequence of Record
    solve, quick : callable
        From records to an estimate of a model with its normal equations. ``quick`` is
        coarse: by it and half of the samples mappings are put in order, and only the
        best are solved.
    known : collection of int
        DOFs whose mass is known, and may have any sign.

    Returns
    -------
    str
        Empty if there is no such error.
    """
    records = _strongest(records)
    as_wired = _closure(records, solve, known)
    closes = not as_wired.impossible and as_wired.errors.max() <= LARGE
    if closes and not suspect_channels(records):
        return ""

    open_dofs = np.flatnonzero(as_wired.errors > OPEN) + 1
    candidates = wiring_errors(records[0], open_dofs.tolist())
    candidates = _most_promising(candidates, records, quick, known)

    closing = []
    for candidate in candidates:
        corrected = [candidate.correct(record) for record in records]
        closure = _closure(corrected, solve, known)
        if _closes_better(closure, as_wired):
            closing.append((candidate, closure))
    if not closing:
        return ""
    return _in_words(closing, as_wired)


def _strongest(records: Sequence[Record]) -> list[Record]:
    """Enough samples to compare mappings: the strongest stretches of the records."""
    stretches = []
    for record in records:
        if record.n_samples > MAX_SAMPLES:
            record = record.rows(_strongest_rows(record))
        stretches.append(record)
    stretches.sort(key=lambda record: -_strength(record).max())

    n_samples = np.cumsum([record.n_samples for record in stretches])
    n_records = 1 + int(np.searchsorted(n_samples, MAX_SAMPLES))
    return stretches[:n_records]


def _strength(record: Record) -> np.ndarray:
    """Size of the force at every sample, or of the motion if no force was measured."""
    if record.forced:
        channels = record.force
    else:
        channels = next(iter(record.channels().values()))[:, None]
    return np.abs(np.nan_to_num(channels)).max(axis=1)


def _strongest_rows(record: Record) -> slice:
    """Rows about the largest force or motion, most of them behind it."""
    peak = int(np.argmax(_strength(record)))
    start = np.clip(peak - MAX_SAMPLES // 4, 0, record.n_samples - MAX_SAMPLES)
    return slice(int(start), int(start) + MAX_SAMPLES)


def _closure(records: list[Record], solve: Solve, known: Collection[int]) -> Closure:
    """How well the balances of records close."""
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        try:
            fitted = solve(records)
        except NRFError:
            return Closure(True, np.full(records[0].n_dof, np.inf))
    balances = balance_errors(fitted.model, fitted.grams).drop("pooled")
    errors = balances["error"].to_numpy(dtype=float)
    noise = fitted.solution.mass_noise
    return Closure(
        _is_impossible(fitted, known),
        np.maximum(errors, _LEAST_ERROR),
        max(noise.values(), default=0.0) > DOUBTFUL_MASS,
    )


def _is_impossible(fitted: Fitted, known: Collection[int]) -> bool:
    """Whether a mass that is solved for is not positive, and noise is not the reason.

    Where it is not known what noise does, it is not the reason.
    """
    noise = fitted.solution.mass_noise
    for j, mass in enumerate(fitted.model.masses, 1):
        if mass <= 0 and j not in known and noise.get(j, 0.0) < DOUBTFUL_MASS:
            return True
    return False


def _most_promising(
    candidates: list[WiringError],
    records: list[Record],
    quick: Solve,
    known: Collection[int],
) -> list[WiringError]:
    """The candidates that a coarse solve ranks before the wiring as it is."""
    halves = [record.rows(slice(0, (record.n_samples + 1) // 2)) for record in records]
    as_wired = _closure(halves, quick, known)
    if not np.isfinite(as_wired.size):  # motions are missing that only fusion fills in
        return candidates

    ranked = []
    for position, candidate in enumerate(candidates):
        corrected = [candidate.correct(half) for half in halves]
        ranked.append((_closure(corrected, quick, known).rank, position))
    ranked.sort()
    best = ranked[:MAX_FITTED_MAPPINGS]
    return [candidates[position] for rank, position in best if rank < as_wired.rank]


def _closing_balances(closure: Closure, as_wired: Closure) -> np.ndarray:
    """Which balances close with a mapping that did not close as wired."""
    needed = np.full(len(closure.errors), OPEN)
    if not as_wired.impossible:
        needed = np.minimum(OPEN, as_wired.errors / TELLING_FALL)
    return closure.errors <= needed


def _closes_better(closure: Closure, as_wired: Closure) -> bool:
    """Whether all balances close with a mapping, or one does and none pays for it."""
    if closure.impossible or closure.noise_decides:
        return False
    closes = _closing_balances(closure, as_wired)
    telling = closure.size < as_wired.size - np.log(TELLING_FALL)
    return bool(closes.all() or (closes.any() and telling))


def _in_words(closing: list[tuple[WiringError, Closure]], as_wired: Closure) -> str:
    """The best mapping, with at most two others that close the balances as well."""
    best, closure = min(closing, key=lambda pair: pair[1].size)
    names = [best.words]
    for other, its_closure in closing:
        as_good = (its_closure.errors <= EQUALLY_GOOD * closure.errors).all()
        if other.words != best.words and as_good:
            names.append(other.words)

    closes = _closing_balances(closure, as_wired)
    which = "every balance closes"
    if closure.errors.max() > OPEN:
        dofs = ", ".join(map(str, np.flatnonzero(closes) + 1))
        which = f"the balance of DOF {dofs} closes"
    largest = closure.errors[closes].max()
    return (
        f"With {' or '.join(names[:3])} {which} ({largest:.2g} % left at most): check"
        " the mapping of the channels."
    )
