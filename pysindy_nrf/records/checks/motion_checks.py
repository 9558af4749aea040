"""Arrays of accelerations, rates and drifts that are not derivatives of each other."""

import re
from dataclasses import replace

import numpy as np

from ..quality import QualityNote, messages
from ..record import Record
from .alignment import ChannelComparison, compare_channels
from .contradictions import contradiction_notes

# Fewest rows that show anything, and most rows that are used.
MIN_ROWS = 256
MAX_ROWS = 4096
# Squared steps over variance of a drift from fewer than six rows a cycle on; rows in no
# order have 2.
ROUGH = 1.0
# Steps this many times as large as those beside them, and half as many times the rms,
# join two stretches of a motion.
JUMP = 8.0
# Gain between channels that is called wrong; noise of 10 % on each gave 2.01 at most.
GROSS_GAIN = 3.0
# Deviation of a standard deviation from one that is round-off.
ROUND_OFF = 1e-6


def motion_notes(
    a: np.ndarray,
    v: np.ndarray,
    s: np.ndarray,
    ag: np.ndarray | None,
    dt: float | None,
) -> tuple[QualityNote, ...]:
    """Notes on motions that were passed as they are.

    Parameters
    ----------
    a, v, s : ndarray of shape (n_samples, n_dof)
        Absolute accelerations of the DOFs, rates and drifts of the storeys.
    ag : ndarray of shape (n_samples,) or None
        Acceleration of the base.
    dt : float or None
        Sampling step, s; without one only standardised columns are found.
    """
    if _are_standardised(a, v, s):
        message = (
            "every column of X has a standard deviation of one, as behind a"
            " StandardScaler: without their units they are no motion. Pass X as"
            " measured"
        )
        return (QualityNote("unit", message),)
    storeys = None if dt is None else _doubtful_stretch(a, v, s, ag, dt)
    if storeys is None:
        return ()
    # small gains, delays and lost coherence are what noise on every channel does
    if not any(_is_gross(comparison) for comparison in compare_channels(storeys)):
        return ()
    return tuple(_of_drifts(note) for note in contradiction_notes(storeys))


def motion_doubts(
    a: np.ndarray,
    v: np.ndarray,
    s: np.ndarray,
    ag: np.ndarray | None,
    dt: float | None,
) -> list[str]:
    """The sentences of :func:`motion_notes`."""
    return messages(motion_notes(a, v, s, ag, dt))


def _are_standardised(*matrices: np.ndarray) -> bool:
    every = max(1, len(matrices[0]) // MAX_ROWS)
    for matrix in matrices:
        for column in matrix.T:
            # a few rows exclude most columns
            if abs(column[::every].std() - 1.0) >= 0.5:
                return False
            if abs(column.std() - 1.0) >= ROUND_OFF:
                return False
    return True


def _doubtful_stretch(
    a: np.ndarray, v: np.ndarray, s: np.ndarray, ag: np.ndarray | None, dt: float
) -> Record | None:
    """The longest stretch about the largest drift in which the motion is smooth; None
    if it is too short, or all columns move as their rates say.
    """
    if len(s) < MIN_ROWS:
        return None
    rows = _about_largest_drift(s)
    relative = _storey_accelerations(a[rows], None if ag is None else ag[rows])
    if _integrates(s[rows], v[rows], dt) and _integrates(v[rows], relative, dt):
        return None
    smooth = _smooth_stretch(s[rows], v[rows])
    if smooth.stop - smooth.start < MIN_ROWS:
        return None
    return Record(
        acceleration=relative[smooth],
        velocity=v[rows][smooth],
        displacement=s[rows][smooth],
        fs=1.0 / dt,
    )


def _storey_accelerations(a: np.ndarray, ag: np.ndarray | None) -> np.ndarray:
    """Accelerations of the floors against those below."""
    return np.diff(a, axis=1, prepend=0.0 if ag is None else ag[:, None])


def _about_largest_drift(s: np.ndarray) -> slice:
    """Rows about the largest drift of storey 1."""
    every = max(1, len(s) // MAX_ROWS)
    largest = every * int(np.abs(s[::every, 0]).argmax())
    start = max(min(largest - MAX_ROWS // 2, len(s) - MAX_ROWS), 0)
    return slice(start, min(start + MAX_ROWS, len(s)))


def _integrates(motion: np.ndarray, rate: np.ndarray, dt: float) -> bool:
    """Whether all columns move as their rates say, over steps of about one radian of
    their motion.
    """
    step = np.median(np.diff(motion, axis=0).std(axis=0))
    lag = int(np.median(motion.std(axis=0)) / max(step, 1e-300))
    if not 1 < lag < len(motion) // 4:
        return False
    path = np.cumsum(rate, axis=0)
    moved = motion[lag:] - motion[:-lag]
    expected = dt * (path[lag:] - path[:-lag])
    power_moved = (moved**2).sum(axis=0)
    power_expected = (expected**2).sum(axis=0)
    product = (moved * expected).sum(axis=0)
    parallel = product > 0.9 * np.sqrt(power_moved * power_expected)
    as_large = (power_moved < 4 * power_expected) & (power_expected < 4 * power_moved)
    return bool(np.all(parallel & as_large))


def _smooth_stretch(s: np.ndarray, v: np.ndarray) -> slice:
    """The longest stretch between jumps, where folds were joined; none where the rows
    follow no clock.
    """
    motion = np.hstack([s, v])
    steps = np.abs(np.diff(motion, axis=0))
    rms, power = np.sqrt(np.mean(steps**2, axis=0)), motion.var(axis=0)
    if len(motion) < MIN_ROWS or not power.all():
        return slice(0, 0)
    if np.median(rms**2 / power) > ROUGH:
        return slice(0, 0)
    beside = np.maximum(steps[:-2], steps[2:])
    jumps = steps[1:-1] > JUMP * np.maximum(beside, 0.5 * rms)
    joints = np.flatnonzero(jumps.any(axis=1)) + 2
    edges = np.concatenate([[0], joints, [len(motion)]])
    longest = int(np.diff(edges).argmax())
    return slice(int(edges[longest]), int(edges[longest + 1]))


def _is_gross(comparison: ChannelComparison) -> bool:
    """Whether a contradiction is more than noise on every channel makes."""
    fit = comparison.transfer
    turned = fit.sign < 0 and abs(comparison.samples) < 0.5
    large = abs(np.log(fit.gain)) > np.log(GROSS_GAIN)
    return bool(turned or large or "swapped" in comparison.faults)


def _of_drifts(note: QualityNote) -> QualityNote:
    """The note with the names of drifts in place of those of displacements."""
    message, channel, witness = (
        re.sub(r"\bx(\d)", r"s\1", text)
        for text in (note.message, note.channel, note.witness)
    )
    return replace(note, message=message, channel=channel, witness=witness, record="")
