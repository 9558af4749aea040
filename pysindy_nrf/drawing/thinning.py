"""Long lines with few points: the extremes of every stretch are drawn."""

from __future__ import annotations

import numpy as np

# Points of a drawn line: about two to a pixel of a picture.
DRAWN_POINTS = 1000


def thinned(
    x: np.ndarray, y: np.ndarray, n_points: int = DRAWN_POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """A line by the smallest and the largest value of each of its stretches.

    They stand in their order, and evenly: within half a stretch of their places.

    Parameters
    ----------
    x, y : ndarray of shape (n_samples,)
    n_points : int
        About so many are left; a shorter line stays as it is.

    Returns
    -------
    x, y : ndarray of shape (n_points,)

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.drawing.thinning import thinned
    >>> t = np.arange(10_000) / 1000
    >>> x, y = thinned(t, np.sin(40 * t), 100)
    >>> len(x), bool(y.max() > 0.999)
    (100, True)
    """
    size = -(-2 * len(x) // n_points)
    if size < 3:
        return x, y

    n_stretches = len(x) // size
    stretches = y[: n_stretches * size].reshape(n_stretches, size)
    places = np.column_stack([stretches.argmin(axis=1), stretches.argmax(axis=1)])
    in_order = np.take_along_axis(stretches, np.sort(places, axis=1), axis=1)
    drawn = in_order.ravel()
    last = x[n_stretches * size - 1]
    return np.linspace(x[0], last, len(drawn)), drawn
