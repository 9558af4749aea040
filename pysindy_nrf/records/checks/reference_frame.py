"""Frames of reference: is a velocity or displacement absolute, as its record says?"""

import numpy as np

from ..record import Record
from .transfer_function import MAX_SAMPLES, ORDERS, STRONG_LINE, hann

MIN_SAMPLES = 64
# Lines that the window smears the mean over; lines that a fit needs.
FIRST_LINE = 5
MIN_LINES = 8
# Highest frequency that is used, as a share of half the sampling rate.
MAX_FREQUENCY = 0.8
# The motion follows the floor's acceleration if its coefficient is within this of one,
# and does not follow the base if that one is within this of zero.
TOLERANCE = 0.3


def wrong_frame(record: Record, dof: int, kind: str, reference: str) -> str:
    """Why a velocity or displacement is in another frame of reference than its record
    says.

    Its derivative is fitted by the acceleration of the floor and that of the base:
    relative to the base it is the one less the other, absolute it is the one alone.

    Parameters
    ----------
    record : Record
    dof : int
    kind, reference : str
        Of the two channels that are compared; one of them is ``"a"`` if frames can be.

    Returns
    -------
    str
        A sentence; empty if the frame is right, or nothing can be said.
    """
    ag = record.base_acceleration
    if ag is None or "a" not in (kind, reference):
        return ""
    other = kind if reference == "a" else reference
    channels = record.channels()
    shares = _shares(
        channels[f"{other}{dof}"], channels[f"a{dof}"], ag, ORDERS[other], record.fs
    )
    if shares is None:
        return ""
    floor, base = shares
    relative = record.coordinates == "relative"
    # what is right would be -1 and 0
    wrong_base = 0.0 if relative else -1.0
    if abs(floor - 1) > TOLERANCE or abs(base - wrong_base) > TOLERANCE:
        return ""
    if relative:
        return (
            f"{other}{dof} agrees with a{dof} itself, not with a{dof} less the base"
            f" acceleration: {other}{dof} is absolute (coordinates='absolute'), or"
            f" a{dof} is relative to the base (add ag to it)"
        )
    return (
        f"{other}{dof} agrees with a{dof} less the base acceleration: it is relative to"
        " the base (coordinates='relative')"
    )


def _shares(
    motion: np.ndarray, a: np.ndarray, ag: np.ndarray, order: int, fs: float
) -> tuple[float, float] | None:
    """Coefficients of the floor's and the base's acceleration in the derivative of a
    motion; None if too few lines are strong.
    """
    known = np.isfinite(a) & np.isfinite(motion) & np.isfinite(ag)
    n_samples = min(int(known.sum()), MAX_SAMPLES)
    if n_samples < MIN_SAMPLES or not np.any(ag[known]):
        return None
    y, floor, base = (
        np.fft.rfft(
            hann(n_samples) * (line[known][:n_samples] - line[known][:n_samples].mean())
        )
        for line in (motion, a, ag)
    )
    y = y * (2j * np.pi * np.fft.rfftfreq(n_samples, 1 / fs)) ** (ORDERS["a"] - order)

    line = np.arange(len(y))
    used = line >= FIRST_LINE
    power = np.abs(floor) ** 2
    used &= (power > STRONG_LINE * power[used].max()) & (line < MAX_FREQUENCY * len(y))
    if used.sum() < MIN_LINES:
        return None
    size = np.abs(y[used])
    columns = np.column_stack([floor[used], base[used]]) / size[:, None]
    shares = np.linalg.lstsq(columns, y[used] / size, rcond=None)[0].real
    return float(shares[0]), float(shares[1])
