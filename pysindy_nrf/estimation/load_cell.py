"""A load cell in line with a diagonal device."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import ChannelError


def horizontal_component(force: Any, rise: float, run: float) -> np.ndarray:
    """Horizontal component of the force in a diagonal device.

    The force identified in a storey is horizontal, a load cell in a diagonal damper is not.

    Parameters
    ----------
    force : array-like of shape (n_samples,)
        Measured along the device, N.
    rise, run : float
        Vertical and horizontal distance of its ends, m (any one unit).

    Returns
    -------
    ndarray of shape (n_samples,)
        N.

    Raises
    ------
    ChannelError
        If the device has no horizontal extent.

    Examples
    --------
    >>> from pysindy_nrf.estimation import horizontal_component
    >>> horizontal_component([50.0], rise=0.3, run=0.4).round(9).tolist()
    [40.0]
    """
    length = np.hypot(rise, run)
    if not np.isfinite(length) or run <= 0 or rise < 0:
        raise ChannelError(
            f"A device with rise={rise!r} and run={run!r} has no horizontal component",
            "Give the distances of its ends; run must be positive.",
        )
    return np.asarray(force, dtype=float) * (run / length)
