"""Integrals of motions over time."""

from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

from ...exceptions import ChannelError
from ..zero_phase_filter import check_rate

# Degree of the interpolating spline; the shortest records get a lower odd one.
DEGREE = 7
MIN_SAMPLES = 3


def integrate(
    a: Any, dt: float, method: str = "spline", order: int = 1, detrend: bool = False
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
    values = np.asarray(a, dtype=float)
    if values.ndim not in (1, 2):
        cure = "Give one row per sample and one column per channel."
        raise ChannelError(f"The motion has {values.ndim} dimensions", cure)
    if len(values) < 3:
        raise ChannelError(
            f"{len(values)} samples are too few", "Give a longer record."
        )
    if not np.isfinite(values).all():
        rows = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
        raise ChannelError(
            f"The motion is not finite in row {rows[0]}",
            "Cut the masked edges and repair gaps first.",
        )
    dt = 1.0 / check_rate(1.0 / dt if dt else None)
    if order not in (1, 2):
        raise ChannelError(f"order={order!r} is not 1 or 2", "Integrate once or twice.")
    n = len(values)
    t = dt * np.arange(n)
    if method == "cumulative":
        out = values
        for _ in range(order):
            out = cumulative_trapezoid(out, dx=dt, axis=0, initial=0.0)
    else:
        degree = min(
            7, n - 1 if n % 2 == 0 else n - 2
        )  # less than 7 for the shortest records
        out = make_interp_spline(t, values, k=max(1, degree), axis=0).antiderivative(
            order
        )(t)
    if detrend:
        basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), order)
        out = out - basis @ np.linalg.lstsq(basis, out, rcond=None)[0]
    return out
