"""Integrals of motions over time."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

from ...common import positive
from ...exceptions import ChannelError

# Degree of the interpolating spline.
DEGREE = 7
MIN_SAMPLES = 3


def integrate(
    a: ArrayLike,
    dt: float,
    method: str = "spline",
    order: int = 1,
    detrend: bool = False,
) -> np.ndarray:
    """Integral over time of every column of one contiguous record, zero at the first
    sample (but with ``detrend``).

    Parameters
    ----------
    a : array-like of shape (n_samples,) or (n_samples, p)
        Motion, evenly sampled.
    dt : float
        Sampling step, s.
    method : {"spline", "cumulative"}
        ``"spline"``: antiderivative of the interpolating spline of degree 7.
        ``"cumulative"``: trapezoid rule (the paper's), low by ``(2 pi f dt)^2 / 12``
        for each integration.
    order : {1, 2}
        Once (velocity from acceleration) or twice.
    detrend : bool
        Remove the polynomial of degree ``order`` that fits best: the drift that the
        unknown initial motion and a sensor offset leave.

    Returns
    -------
    ndarray of the shape of a
        Times s or s^2.

    Raises
    ------
    ChannelError
        If a is not finite, too short, or a parameter is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.records.fusion import integrate
    >>> t = np.arange(1000) / 500
    >>> v = integrate(np.cos(30 * t), dt=1 / 500)
    >>> bool(np.abs(v - np.sin(30 * t) / 30).max() < 1e-9)
    True
    """
    if method not in ("spline", "cumulative"):
        raise ChannelError(
            f"method={method!r} is unknown", "Choose spline, cumulative."
        )
    if order not in (1, 2):
        raise ChannelError(f"order={order!r} is not 1 or 2", "Integrate once or twice.")
    values = _checked_motion(a)
    dt = positive("dt", dt, "Give the sampling step in s.", ChannelError)

    if method == "cumulative":
        integral = values
        for _ in range(order):
            integral = cumulative_trapezoid(integral, dx=dt, axis=0, initial=0.0)
    else:
        integral = _integral_of_spline(values, dt, order)
    return _without_trend(integral, order) if detrend else integral


def _checked_motion(motion: ArrayLike) -> np.ndarray:
    values = np.asarray(motion, dtype=float)
    if values.ndim not in (1, 2):
        raise ChannelError(
            f"The motion has {values.ndim} dimensions",
            "Give one row per sample and one column per channel.",
        )
    if len(values) < MIN_SAMPLES:
        raise ChannelError(
            f"{len(values)} samples are too few", "Give a longer record."
        )
    finite = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    if not finite.all():
        raise ChannelError(
            f"The motion is not finite in row {np.flatnonzero(~finite)[0]}",
            "Cut the masked edges and repair gaps first.",
        )
    return values


def _integral_of_spline(values: np.ndarray, dt: float, order: int) -> np.ndarray:
    n_samples = len(values)
    t = dt * np.arange(n_samples)
    # the shortest records get a lower odd degree
    highest = n_samples - 1 if n_samples % 2 == 0 else n_samples - 2
    spline = make_interp_spline(t, values, k=max(1, min(DEGREE, highest)), axis=0)
    return spline.antiderivative(order)(t)


def _without_trend(values: np.ndarray, degree: int) -> np.ndarray:
    """Values less the polynomial that fits best."""
    position = np.linspace(-1.0, 1.0, len(values))
    basis = np.polynomial.legendre.legvander(position, degree)
    return values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
