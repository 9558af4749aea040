r"""Forces that come earlier or later than the motion they cause.

The balance of a forced DOF is solved with its force shifted by whole samples, from one
Gram matrix. The parabola through the lowest three residuals gives the delay; leaving
out pieces of the record gives its standard error, or, of a single blow, the curve of
the residuals and the course of the force between two samples.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg

from ..chain.layout import LawLayout
from ..chain.model import as_segments
from ..equations.accumulation import rows_of, whole_block
from ..equations.normal_equations import variance
from ..exceptions import ChannelError
from ..records.dataset import Dataset, Segment

MOST = 20  # samples
PIECES = 24
LATE = 0.1  # samples; smaller delays are not reported
SAME_RATE = 1e-3  # relative difference of sampling steps that are taken as one
# share of the square of the force that the best shift leaves, above which no delay is
# reported
UNEXPLAINED = 0.5
SURE = 3.0  # standard errors that a delay must be away from zero
# share of the square of a force that two neighbouring pieces hold if it is a single
# blow
BLOW = 0.9
# of the largest term of its balance, below which a blow lies outside the rows that a
# filter left
REMNANT = 0.01
BETWEEN = (
    12**-0.5
)  # standard error of a blow whose place within one sample is anybody's guess, samples


def force_delay(
    estimator: Any, X: Any = None, F: Any = None, **options: Any
) -> pd.DataFrame:
    """Delay of each measured force against the motion."""
    data = (
        estimator.fit_data("Pass X and F.")
        if X is None
        else as_segments(estimator, X, F, **options)
    )
    layout, filters = estimator.problem_.layout, estimator.problem_.filters(data)
    rows = {}
    for j in data.forced:
        if (found := _delay(data, filters, layout, j)) is None:
            continue
        samples, error = found
        aligned = not (abs(samples) >= LATE and abs(samples) >= SURE * error)
        rows[f"F{j}"] = [
            samples * (data.dt or np.nan),
            samples,
            error,
            aligned,
            _words(j, samples, data.dt, aligned),
        ]
    if not data.forced:
        raise ChannelError(
            "No force is measured, so no delay can be estimated", "Measure a force."
        )
    if not rows:
        cure = (
            f"Records of more than {8 * MOST} samples and laws that explain the balance"
            " are needed."
        )
        raise ChannelError("No balance determines the delay of its force", cure)
    columns = ["delay", "samples", "error", "aligned", "message"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis(
        "channel"
    )


def _words(j: int, samples: float, dt: float | None, aligned: bool) -> str:
    """Message on the delay of a force; empty if it is aligned."""
    if np.isnan(samples):
        return (
            f"F{j}: no delay can be estimated, as the laws explain less than half of"
            " its balance, or its blow lies in rows that a filter masked."
        )
    if aligned:
        return ""
    when = "late" if samples > 0 else "early"
    span = (
        f"{abs(samples * dt) * 1e3:.3g} ms ({abs(samples):.2f} samples)"
        if dt
        else f"{abs(samples):.2f} samples"
    )
    return (
        f"F{j} is {span} {when} against the motion of DOF {j}: masses and damping are"
        " wrong in proportion to the phase shift. Shift it (alignment.shifted)."
    )


def _delay(
    data: Dataset, filters: Sequence[Any], layout: LawLayout, j: int
) -> tuple[float, float] | None:
    """Delay in samples of the first record and its standard error, or None if it cannot
    be estimated.
    """
    rates: list[list[tuple[Segment, Any]]] = []
    for seg, filter in zip(data.segments, filters):
        alike = (
            r
            for r in rates
            if seg.dt is None
            or (r[0][0].dt and abs(seg.dt / r[0][0].dt - 1) < SAME_RATE)
        )
        if held := next(alike, None):
            held.append((seg, filter))
        else:
            rates.append([(seg, filter)])
    found = [
        np.array(one) * (held[0][0].dt / data.dt if held[0][0].dt and data.dt else 1.0)
        for held in rates
        if (one := _delay_at(held, layout, j)) is not None
    ]
    if not found:
        return None
    found = [one for one in found if np.isfinite(one).all()] or found[:1]
    values, errors = np.transpose(found)
    if len(found) == 1:
        return float(values[0]), float(errors[0])
    weights = 1 / np.maximum(errors, 1e-9) ** 2
    return float(np.average(values, weights=weights)), float(weights.sum() ** -0.5)


def _delay_at(
    segments: Sequence[tuple[Segment, Any]], layout: LawLayout, j: int
) -> tuple[float, float] | None:
    """Delay in samples and its standard error from records of one sampling rate, or
    None.
    """
    group = layout.group((j,))
    known = dict.fromkeys(range(1, layout.n_dof + 1), 0.0)
    grams, fourth = [], 0.0
    for seg, filter in segments:
        measured = seg.F[seg.valid, j - 1]
        if np.isnan(measured[0]) or not measured.any() or len(measured) < 8 * MOST:
            continue
        *rows, force = rows_of(layout, group, whole_block(seg, layout, filter), known)
        inner = slice(MOST, len(force) - MOST)
        shifted = [
            force[MOST + k : len(force) - MOST + k] for k in range(-MOST, MOST + 1)
        ]
        both = np.vstack([*(row[inner] for row in rows), *shifted])
        fourth += float((both[-MOST - 1] ** 4).sum())
        for part in np.array_split(both, PIECES, axis=1):
            grams.append(part @ part.T)
    if not grams:
        return None
    total, n = np.sum(grams, axis=0), len(grams)
    if (lowest := _lowest(total)) is None:
        return None
    best, sharpness, share = lowest
    energy = np.array([part[-MOST - 1, -MOST - 1] for part in grams])
    if (energy + np.append(energy[1:], 0.0)).max() > BLOW * energy.sum():
        if share < REMNANT:
            return np.nan, np.nan
        samples = (
            energy.sum() ** 2 / fourth
        )  # of the blow, which all that is left may belong to
        return best, float(np.hypot(BETWEEN, sharpness * samples**-0.5))
    left_out = [_lowest(total - g) for g in grams]
    values = np.array([v[0] for v in left_out if v is not None])
    if len(values) < n:
        return None
    return best, float(np.sqrt(variance(values)))


def _lowest(gram: np.ndarray) -> tuple[float, float, float] | None:
    """Shift, samples, at which the force leaves least, NaN if that is most of it; None
    at the ends of the range.
    """
    p = len(gram) - 2 * MOST - 1
    size = np.sqrt(np.diag(gram))
    if not (size > 0).all():
        return None
    unit = gram / size[:, None] / size
    c = linalg.lstsq(unit[:p, :p], unit[:p, p:], cond=1e-12, check_finite=False)[0]
    left = 1.0 - np.einsum("ij,ij->j", unit[:p, p:], c)
    k = int(np.argmin(left))
    if left[k] > UNEXPLAINED:
        return np.nan, np.nan, np.nan
    if not 0 < k < 2 * MOST:
        return None
    bend = left[k - 1] - 2 * left[k] + left[k + 1]
    share = 1.0 / max(float(np.abs(c[:, k]).max()), 1e-300)
    if bend <= 0:
        return float(k - MOST), np.inf, share
    place = 0.5 * (left[k - 1] - left[k + 1]) / bend
    return (
        float(k - MOST + place),
        float(np.sqrt(max(2.0 * (left[k] - 0.5 * bend * place**2), 0.0) / bend)),
        share,
    )
