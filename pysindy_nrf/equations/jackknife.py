"""The jackknife: an estimate again and again, each time with one part left out."""

import numpy as np
import numpy.typing as npt


def leave_one_out(blocks: np.ndarray) -> np.ndarray:
    """Sums of all entries of the first axis but one, for each of them.

    They are summed from both ends, so that what is zero in all others stays zero.
    """
    zero = np.zeros_like(blocks[:1])
    before = np.concatenate([zero, np.cumsum(blocks[:-1], axis=0)])
    behind = np.concatenate([zero, np.cumsum(blocks[:0:-1], axis=0)])
    return before + behind[::-1]


def variance(values: npt.ArrayLike) -> np.ndarray:
    """Variance of an estimate from its n values, each with one part left out."""
    estimates = np.asarray(values)
    n = len(estimates)
    spread = (estimates - estimates.mean(axis=0)) ** 2
    return (n - 1) / n * spread.sum(axis=0)


def share_of(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """``1 - sum(after) / sum(before)`` over blocks, and its standard error."""
    if before.sum() <= 0:
        return 0.0, 0.0

    share = 1.0 - float(after.sum() / before.sum())
    if len(before) < 3:
        return share, float("nan")
    after_rest = after.sum() - after
    before_rest = before.sum() - before
    ratio = np.ones(len(before))
    np.divide(after_rest, before_rest, out=ratio, where=before_rest > 0)
    return share, float(np.sqrt(variance(ratio)))
