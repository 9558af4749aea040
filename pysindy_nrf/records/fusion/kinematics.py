"""From the measured channels of a record to the regressor's input (paper eq. 8);
integration of motions.
"""

import warnings
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

from ...exceptions import ChannelError, DataQualityWarning
from ..checks.channel_checks import data_warnings
from ..record import Record
from ..zero_phase_filter import Band, ZeroPhaseFilter, check_band, check_rate
from .kinematic_smoother import KinematicSmoother

RESOLVED = (
    0.7  # share of the knots' Nyquist frequency up to which a fused motion is reliable
)


def to_features(
    record: Record, smooth: Any = True, check: bool = True
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Accelerations, inter-storey velocities and drifts of a record, and its forces;
    its channels are checked.
    """
    have = set(record.measured)
    if not record.has_clock:
        raise ChannelError(
            f"Record {record.name!r} has no clock, which a mass or a damper needs",
            "Give fs= in Hz, or the time. For an element without mass:"
            " NRFRegressor(massless=True) with laws of the drift alone, such as"
            " laws={1: [laws.LinearElastic()]}.",
        )
    for j in range(1, record.n_dof + 1):
        if not have & {f"a{j}", f"v{j}", f"x{j}"}:
            raise ChannelError(
                f"DOF {j} of record {record.name!r} has no motion channel",
                f"Measure a{j}, v{j} or x{j}, or fit the records themselves"
                " (NRFRegressor.fit): the free run is then fitted to the other"
                " channels.",
            )
    if not isinstance(smooth, (bool, KinematicSmoother)):
        raise ChannelError(
            f"smooth={smooth!r} is unknown", "Give True, False or a KinematicSmoother."
        )
    smoother = KinematicSmoother(band="auto") if smooth is True else smooth or None
    again = smoother is not None and bool(smoother._kept)
    if messages := data_warnings(record) if check and not again else []:
        warnings.warn(
            f"Record {record.name!r}:"
            f" {'; '.join(text.rstrip('.') for text in messages)}. See"
            " pysindy_nrf.records.checks.alignment and pysindy_nrf.records.checks.channel_checks.",
            DataQualityWarning,
            stacklevel=3,
        )
    if smoother is None:
        missing = [
            f"{kind}{j}"
            for j in range(1, record.n_dof + 1)
            for kind in "avx"
            if f"{kind}{j}" not in have
        ]
        if missing:
            lacks = (
                f"Record {record.name!r} lacks"
                f" {', '.join(missing[:6])}{' and more' * (len(missing) > 6)}"
            )
            raise ChannelError(
                lacks,
                "Use smooth=True, which derives them from the other channels, or"
                " measure them.",
            )
        fused = record
    else:
        fused = smoother.transform_record(record)
    a, v, x = fused.acceleration, fused.velocity, fused.displacement
    assert (
        a is not None and v is not None and x is not None
    )  # measured, or filled in by the smoother
    if record.coordinates == "absolute" and record.base_moves:
        vg, xg = base_motion(record, fused, smooth)
        v, x = v - vg[:, None], x - xg[:, None]
    index = pd.Index(record.time, name="t")
    columns = [f"{kind}{j}" for kind in "avs" for j in range(1, record.n_dof + 1)]
    table, n = np.hstack([a, v, x]), record.n_dof
    table[:, n + 1 : 2 * n] -= v[:, :-1]
    table[:, 2 * n + 1 :] -= x[:, :-1]
    X, force = (
        pd.DataFrame(table, index=index, columns=columns, copy=False),
        fused.force,
    )
    del fused, v, x  # long motions are not held twice
    if smoother is not None and smoother.spacing_.max() > 1.0:
        # an accelerometer resolves the whole band; what a displacement sensor cannot
        # resolve is smoothed away
        blind = [
            h for j, h in smoother.spacing_.items() if f"a{j}" not in have and h > 1.0
        ]
        if blind:
            X.attrs["resolved"] = RESOLVED * record.fs / (2 * float(max(blind)))
        X.attrs["joint_fusion"] = smoother.joint and not _as_measured(record, a)
    if smoother is not None:
        X.attrs["noise"] = {
            str(name): float(level) for name, level in smoother.noise_.items()
        }
    if smoother is not None and smoother.band_ is not None:
        X.attrs["band"] = check_band(smoother.band_, record.fs)
    if messages:
        X.attrs["doubts"] = messages
    return X, pd.DataFrame(
        force, index=index, columns=[f"F{j}" for j in range(1, record.n_dof + 1)]
    )


def base_acceleration(record: Record) -> np.ndarray:
    """Acceleration of the base, derived where only its motion was measured."""
    if record.base_acceleration is not None:
        return record.base_acceleration
    if not record.base_moves:
        return np.zeros(record.n_samples)
    acceleration = _ground(
        record, velocity=record.base_velocity, displacement=record.base_displacement
    ).acceleration
    assert acceleration is not None
    return acceleration[:, 0]


def base_acceleration_if_any(record: Record, band: Band = None) -> np.ndarray | None:
    """The same; None for a record in which no motion of the base was given."""
    ag = base_acceleration(record) if record.base_moves else record.base_acceleration
    return (
        ag if ag is None or band is None else ZeroPhaseFilter(band, record.fs).apply(ag)
    )


def base_motion(
    record: Record, fused: Record, smooth: Any = True
) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and displacement of the base, for records in absolute coordinates."""
    have = set(record.measured)
    if {"vg", "xg"} <= have and smooth is False:
        assert fused.base_velocity is not None and fused.base_displacement is not None
        return fused.base_velocity, fused.base_displacement
    if smooth is False or not have & {"vg", "xg"}:
        what = (
            f"Record {record.name!r} has absolute displacements and a moving base, but"
            " lacks "
        )
        what += "vg" if "xg" in have else "xg"
        cure = (
            "and base_velocity."
            if smooth is False
            else "(integrating ag alone loses its slow part)."
        )
        raise ChannelError(
            what, f"Give base_displacement {cure} Or give motion relative to the base."
        )
    # the record is already band-limited if the smoother was told to
    measured = {
        "velocity": fused.base_velocity,
        "displacement": fused.base_displacement,
    }
    whole = _ground(record, acceleration=fused.base_acceleration, **measured)
    assert whole.velocity is not None and whole.displacement is not None
    return whole.velocity[:, 0], whole.displacement[:, 0]


def _ground(record: Record, **measured: Any) -> Record:
    """Motion of the base of a record, fused from what was measured of it."""
    ground = Record(
        **measured, fs=record.fs, name=f"base of {record.name}", coordinates="absolute"
    )
    return KinematicSmoother().transform_record(ground)


def _as_measured(record: Record, fused: np.ndarray) -> bool:
    """True if the fusion passed clean accelerations on unchanged."""
    return record.acceleration is not None and np.allclose(
        record.acceleration,
        fused,
        rtol=1e-4,
        atol=1e-4 * np.nanstd(fused),
        equal_nan=True,
    )


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
