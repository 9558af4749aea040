"""A record cut into pieces of an eighth of the period of its first mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...chain.model import ChainModel
from ...diagnosis.period import mean_period
from ...exceptions import ChannelError
from ...records.dataset import Segment

PIECES_A_PERIOD = 8
# More pieces cost time and show nothing more of a record; fewer show no course.
MAX_PIECES = 512
LEAST_PIECES = 32
LEAST_SAMPLES = 4


@dataclass(frozen=True, eq=False)
class Pieces:
    """Consecutive pieces of one record.

    Attributes
    ----------
    edges : ndarray of shape (n_pieces + 1,)
        In valid samples.
    times : ndarray of shape (n_pieces + 1,)
        Of the edges, s.
    period : float
        Of the first mode, s.
    """

    edges: np.ndarray
    times: np.ndarray
    period: float

    @property
    def middles(self) -> np.ndarray:
        """Middles of the pieces, s."""
        return 0.5 * (self.times[:-1] + self.times[1:])

    def __len__(self) -> int:
        return len(self.edges) - 1


def pieces_of_record(segment: Segment, model: ChainModel) -> Pieces:
    """Pieces of an eighth of a period of the first mode.

    Raises
    ------
    ChannelError
        If the record has no clock, or too few samples.
    """
    step = segment.step
    period = _first_period(segment, model)
    length = segment.n_valid * step
    count = min(int(PIECES_A_PERIOD * length / period), MAX_PIECES)
    count = min(max(count, LEAST_PIECES), segment.n_valid // LEAST_SAMPLES)
    if count < LEAST_PIECES:
        raise ChannelError(
            f"Record {segment.name!r} has {segment.n_valid} samples, too few for a"
            " course in time",
            f"Give at least {LEAST_PIECES * LEAST_SAMPLES}.",
        )
    edges = np.linspace(0, segment.n_valid, count + 1).astype(int)
    assert segment.t is not None  # it has a step
    times = segment.t[segment.valid.start] + step * edges
    return Pieces(edges, times, period)


def _first_period(segment: Segment, model: ChainModel) -> float:
    """Period of the first mode of the model, or of the drifts where it has none, s."""
    frequencies = model.modes()["frequency"].to_numpy()
    first = frequencies[np.isfinite(frequencies) & (frequencies > 0)]
    if len(first):
        return float(1.0 / first.min())
    drifts = segment.s[segment.valid].astype(float)
    return mean_period(list(drifts.T)) * segment.step
