"""Mean period of a signal."""

from collections.abc import Sequence

import numpy as np

# Period of a signal that does not move, samples.
PERIOD_AT_REST = 16.0
# Lowest rms frequency, radians per sample.
LOWEST_FREQUENCY = 1e-6


def mean_period(signals: Sequence[np.ndarray]) -> float:
    """Samples of a period at the rms frequency of a signal in stretches."""
    rate, size = 0.0, 0.0
    for signal in signals:
        rate += float(np.sum(np.diff(signal) ** 2))
        size += float(np.sum((signal - signal.mean()) ** 2))

    if not size > 0:
        return PERIOD_AT_REST
    return float(2 * np.pi / max(np.sqrt(rate / size), LOWEST_FREQUENCY))
