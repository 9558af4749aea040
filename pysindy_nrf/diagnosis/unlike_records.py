"""Records that do not belong together, and copies of records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..records.dataset import Dataset
from .force_distortion import ForceGrams
from .gram_least_squares import left_over, solved

# Times what a record leaves with its own coefficients, from which on those of the
# others do not fit it.
UNLIKE = 1.5
# Share of the force of its equation, that the others must leave of a record.
LEAST_SHARE = 0.03
# Times what its own coefficients leave, up to which a gain of the force explains the
# difference.
EXPLAINED_BY_GAIN = 1.2
# Bytes of the accelerations by which copies are recognised.
COMPARED_BYTES = 4096


@dataclass(frozen=True)
class _Comparison:
    """A record against the others.

    Attributes
    ----------
    record : int
    by_others : float
        Share of the force that the coefficients of the others leave (rms).
    by_own : float
        Share that its own leave, on folds held out.
    gain : float
        Factor by which the force of the record is larger than the others say.
    is_gain : bool
        Whether that explains the difference.
    """

    record: int
    by_others: float
    by_own: float
    gain: float
    is_gain: bool


def unlike_records(grams: ForceGrams, names: Sequence[str]) -> list[str]:
    """A sentence on the record that the others describe worst, if they do not.

    Parameters
    ----------
    grams : ForceGrams
        Of one equation of motion.
    names : sequence of str
        Of the records.
    """
    records = sorted({record for record, _ in grams.matrices})
    if len(records) < 2:
        return []

    worst = None
    for record in records:
        compared = _compare(grams, record)
        if compared is None:
            continue
        if worst is None or compared.by_others >= worst.by_others:
            worst = compared
    if worst is None:
        return []

    if grams.rms and worst.is_gain:
        cause = (
            f"; with its F{grams.dof} divided by {worst.gain:.3g} they agree: is the"
            f" gain of F{grams.dof} another one there?"
        )
    else:
        cause = (
            ". Is it another structure, another amplitude of a law that is missing, or"
            " another calibration?"
        )
    return [
        f"The records do not belong together: the balance of DOF {grams.dof} in record"
        f" {worst.record + 1} ({names[worst.record]!r}) is {worst.by_others:.0%} off"
        f" with the masses and laws that the others give, {worst.by_own:.0%} with its"
        f" own{cause}"
    ]


def _compare(grams: ForceGrams, record: int) -> _Comparison | None:
    """How the coefficients of the others fit a record; None if they do."""
    columns = np.arange(grams.n_own)
    used = np.append(columns, -1)
    folds = []
    others = np.zeros((len(used), len(used)))
    for (number, _), matrix in grams.matrices.items():
        of_own_columns = matrix[np.ix_(used, used)]
        if number == record:
            folds.append(of_own_columns)
        else:
            others += of_own_columns
    of_record = np.sum(folds, axis=0)

    by_own = np.inf
    if len(folds) > 1:
        by_own = sum(
            float(left_over(fold, columns, solved(of_record - fold, columns)))
            for fold in folds
        )
    coefficients = solved(others, columns)
    by_others = float(left_over(of_record, columns, coefficients))
    # those of the others alone may be ill determined
    by_all = float(left_over(of_record, columns, solved(of_record + others, columns)))
    force = of_record[-1, -1]
    if by_all < UNLIKE**2 * by_own or by_others < LEAST_SHARE**2 * force:
        return None

    power = coefficients @ of_record[np.ix_(columns, columns)] @ coefficients
    gain = coefficients @ of_record[columns, -1] / max(power, 1e-300)
    by_scaled = float(left_over(of_record, columns, gain * coefficients))
    return _Comparison(
        record=record,
        by_others=float(np.sqrt(by_others / force)),
        by_own=float(np.sqrt(by_own / force)),
        gain=float(gain),
        is_gain=by_scaled < EXPLAINED_BY_GAIN**2 * by_own,
    )


def copies_of(data: Dataset) -> list[str]:
    """A sentence on records that hold the same samples.

    Copies narrow intervals, for which they have nothing new.
    """
    if len(data.segments) < 2:
        return []

    first_names: dict[bytes, str] = {}
    copies = []
    for segment in data.segments:
        accelerations = np.ascontiguousarray(segment.a[segment.valid]).tobytes()
        forces = np.nansum(segment.F[segment.valid], axis=0).tobytes()
        mark = accelerations[:COMPARED_BYTES] + forces
        if mark in first_names:
            copies.append(f"{segment.name!r} and {first_names[mark]!r}")
        else:
            first_names[mark] = segment.name
    if not copies:
        return []

    more = f" (and {len(copies) - 1} more)" if len(copies) > 1 else ""
    return [
        f"Records {copies[0]}{more} hold the same samples: intervals come out too"
        " narrow. Leave copies out; a test counts once."
    ]
