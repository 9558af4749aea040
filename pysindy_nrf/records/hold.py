"""The course of forces between their samples.

A measured force that passed an anti-aliasing filter is band-limited. A cubic spline
through its samples loses 1.5e-4 of an amplitude at a tenth of the sampling rate and
1.4 % at a quarter. Straight lines lose 3.3 and 19 %, the square of a sinc. A force that
a D/A converter holds comes half a sample late, and loses a sinc.

The motion of a mass hardly feels what a hold adds above half of the sampling rate. For
a constant or straight force there is thus a band-limited one that acts alike; the
equations of motion of measured channels hold for it.
"""

from typing import Literal

import numpy as np

from ..exceptions import ChannelError

Hold = Literal["cubic", "linear", "zero"]
HOLDS: tuple[Hold, ...] = ("cubic", "linear", "zero")
# Of measured channels, where nothing else is known.
BAND_LIMITED: Hold = "cubic"
HOLD_IN_WORDS = {
    "cubic": "band-limited between the samples",
    "linear": "straight between the samples",
    "zero": "constant from each sample to the next",
}
# Weights of the samples k - 2, k - 1, k and k + 1 of a force in the band-limited one.
# A straight force: the response of two straight lines, 1 - w^2 / 12 + .. with w in
# radians a sample. A held one: the mean over the sample before, by the cubic through
# the four.
WEIGHTS = {
    "linear": np.array([0.0, 1.0, 10.0, 1.0]) / 12,
    "zero": np.array([-1.0, 13.0, 13.0, -1.0]) / 24,
}


def require_hold(hold: object) -> None:
    """Refuse a course between the samples that is unknown."""
    if hold not in HOLDS:
        names = ", ".join(map(repr, HOLDS))
        raise ChannelError(f"hold={hold!r} is unknown", f"Choose one of {names}.")


def band_limited(force: np.ndarray, hold: str) -> np.ndarray:
    """Samples of the band-limited force that moves masses as one of another course.

    Parameters
    ----------
    force : ndarray of shape (n_samples, n_dof)
        Before the first and after the last sample it is continued by straight lines.
    hold : {"cubic", "linear", "zero"}
    """
    if hold == BAND_LIMITED or len(force) < 2:
        return force
    first = force[0]
    slope = force[1] - first
    last = 2 * force[-1] - force[-2]
    longer = np.vstack([first - 2 * slope, first - slope, force, last])
    n = len(force)
    moved = [longer[lag : lag + n] for lag in range(4)]
    return sum(weight * samples for weight, samples in zip(WEIGHTS[hold], moved))
