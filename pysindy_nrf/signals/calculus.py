"""Integrals of sampled motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import ChannelError
from .zero_phase_filter import check_rate


def integrate(a: Any, dt: float, method: str = "spline", order: int = 1, detrend: bool = False) -> np.ndarray:
    """Integral over time of every column of one contiguous record, zero at the first sample (but with ``detrend``).

    Parameters
    ----------
    a : array-like of shape (n_samples,) or (n_samples, p)
        Motion, evenly sampled.
    dt : float
        Sampling step, s.
    method : {"spline", "spectral", "cumulative"}
        ``"spline"``: antiderivative of the interpolating spline of degree 7. ``"spectral"``:
        Fourier transform, for periodic records: a motion that comes back. The mean is taken off before each
        integration, so that a velocity passed on the way to the displacement swings about zero, where with the
        others it starts at rest. ``"cumulative"``: trapezoid rule (the paper's), low by ``(2 pi f dt)^2 / 12`` for
        each integration.
    order : {1, 2}
        Once (velocity from acceleration) or twice.
    detrend : bool
        Remove the polynomial of degree ``order`` that fits best: the drift that the unknown
        initial motion and a sensor offset leave.

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
    >>> from pysindy_nrf.signals import integrate
    >>> t = np.arange(1000) / 500
    >>> v = integrate(np.cos(30 * t), dt=1 / 500)
    >>> bool(np.abs(v - np.sin(30 * t) / 30).max() < 1e-9)
    True
    """
    values, dt = _checked(a, dt, method)
    if order not in (1, 2):
        raise ChannelError(f"order={order!r} is not 1 or 2", "Integrate once or twice.")
    n = len(values)
    t = dt * np.arange(n)
    if method == "spectral":
        w = 2j * np.pi * np.fft.rfftfreq(n, dt)
        w[0] = 1.0
        spectrum = np.fft.rfft(values, axis=0) / (w**order).reshape(-1, *[1] * (values.ndim - 1))
        spectrum[0] = 0.0
        out = np.fft.irfft(spectrum, n, axis=0)
        out = out - out[0]
    elif method == "cumulative":
        from scipy.integrate import cumulative_trapezoid

        out = values
        for _ in range(order):
            out = cumulative_trapezoid(out, dx=dt, axis=0, initial=0.0)
    else:
        out = spline_of(values, dt).antiderivative(order)(t)
    if detrend:
        line = np.linspace(-1.0, 1.0, n)
        basis = np.polynomial.legendre.legvander(line, order)
        out = out - basis @ np.linalg.lstsq(basis, out, rcond=None)[0]
    return out


def spline_of(values: np.ndarray, dt: float) -> Any:
    """Interpolating spline of degree 7 (less for the shortest records), as a function of s."""
    from scipy.interpolate import make_interp_spline

    n = len(values)
    degree = min(7, n - 1 if n % 2 == 0 else n - 2)
    return make_interp_spline(dt * np.arange(n), values, k=max(1, degree), axis=0)


def _checked(x: Any, dt: float, method: str) -> tuple[np.ndarray, float]:
    """Motion as an array of numbers and the sampling step, or an error."""
    methods = ("spline", "spectral", "cumulative")
    if method not in methods:
        raise ChannelError(f"method={method!r} is unknown", f"Choose {', '.join(methods)}.")
    values = np.asarray(x, dtype=float)
    if values.ndim not in (1, 2):
        raise ChannelError(
            f"The motion has {values.ndim} dimensions", "Give one row per sample and one column per channel."
        )
    if len(values) < 3:
        raise ChannelError(f"{len(values)} samples are too few", "Give a longer record.")
    if not np.isfinite(values).all():
        rows = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
        raise ChannelError(f"The motion is not finite in row {rows[0]}", "Cut the masked edges and repair gaps first.")
    return values, 1.0 / check_rate(1.0 / dt if dt else None)
