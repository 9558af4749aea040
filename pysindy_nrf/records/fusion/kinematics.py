"""From the measured channels of a record to the motion and forces of its balances.

The result has absolute accelerations, inter-storey velocities and drifts (paper eq. 8).
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

from ...exceptions import ChannelError, DataQualityWarning
from ..checks.channel_checks import data_warnings
from ..quality import QualityNote
from ..record import Record
from ..zero_phase_filter import Band, ZeroPhaseFilter, check_band, check_rate
from .kinematic_smoother import KinematicSmoother

# Share of the knots' Nyquist frequency up to which a fused motion is reliable.
RESOLVED = 0.7


@dataclass(frozen=True)
class FusedRecord:
    """One motion and the forces of a record, as the balances need them.

    Arrays have one row per sample and one column per DOF or storey, in SI units. Rows
    at the ends that a filter spoils, or in which a channel is NaN, are NaN.

    Attributes
    ----------
    a : ndarray of shape (n_samples, n_dof)
        Absolute accelerations, m/s^2.
    v, s : ndarray of shape (n_samples, n_dof)
        Inter-storey velocities, m/s, and drifts, m.
    force : ndarray of shape (n_samples, n_dof)
        N; a column of NaN is unknown.
    ag : ndarray of shape (n_samples,) or None
        Acceleration of the base in the band of the motion, m/s^2, measured or derived
        from its velocity and displacement; None if no motion of the base was given.
    time : ndarray of shape (n_samples,)
        s.
    band : (float or None, float or None) or None
        Band of motion and forces, Hz; None if no filter was applied.
    resolved : float or None
        Frequency up to which the fusion resolves the motion of every DOF, Hz; None if
        the sampling rate alone limits it.
    noise : mapping of str to float
        Noise level of each measured motion channel, SI rms.
    spacing : mapping of int to float
        Distance of the spline's knots of each DOF, samples.
    joint : bool
        True if the DOFs improved each other, which leaves their noise dependent on the
        motion.
    notes : tuple of QualityNote
        What is wrong with the measured channels.
    """

    a: np.ndarray
    v: np.ndarray
    s: np.ndarray
    force: np.ndarray
    ag: np.ndarray | None
    time: np.ndarray
    band: Band = None
    resolved: float | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    spacing: Mapping[int, float] = field(default_factory=dict)
    joint: bool = False
    notes: tuple[QualityNote, ...] = ()

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.s.shape[1]


def fuse_record(
    record: Record, smooth: bool | KinematicSmoother = True, check: bool = True
) -> FusedRecord:
    """Fuse the measured channels of a record into one motion of each DOF.

    Parameters
    ----------
    record : Record
    smooth : bool or KinematicSmoother
        True: ``KinematicSmoother(band="auto")``. False: the channels are taken as they
        are, and every DOF needs all three.
    check : bool
        Look for faults of the channels before; what is found becomes a warning and
        stands in ``notes``.

    Raises
    ------
    ChannelError
        If the record has no clock, or a DOF lacks the channels that are needed.
    """
    _require_motion(record)
    smoother = _smoother_of(smooth)
    fused_before = smoother is not None and bool(smoother._kept)
    notes = _checked(record) if check and not fused_before else ()

    if smoother is None:
        _require_every_channel(record)
        fused = record
    else:
        fused = smoother.transform_record(record)

    a, v, x, force = fused.acceleration, fused.velocity, fused.displacement, fused.force
    # measured, or filled in by the smoother
    assert a is not None and v is not None and x is not None
    if record.coordinates == "absolute" and record.base_moves:
        vg, xg = base_motion(record, fused, smooth)
        v, x = v - vg[:, None], x - xg[:, None]
    # long motions are not kept twice
    del fused

    if smoother is None:
        ag = base_acceleration_if_any(record)
        v, s = _interstorey(v), _interstorey(x)
        return FusedRecord(a, v, s, force, ag, record.time, notes=notes)
    band = None if smoother.band_ is None else check_band(smoother.band_, record.fs)
    coarse = bool(smoother.spacing_.max() > 1.0)
    return FusedRecord(
        a,
        _interstorey(v),
        _interstorey(x),
        force,
        _base_in_band(record, band),
        record.time,
        band=band,
        resolved=_resolved_frequency(record, smoother.spacing_),
        noise={str(name): float(level) for name, level in smoother.noise_.items()},
        spacing={int(j): float(h) for j, h in smoother.spacing_.items()},
        joint=coarse and smoother.joint and not _as_measured(record, a),
        notes=notes,
    )


def to_features(
    record: Record, smooth: Any = True, check: bool = True
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Motion and forces of a record as tables; see :func:`fuse_record`.

    Returns
    -------
    X, F : DataFrame
        Columns ``a1.., v1.., s1..`` and ``F1..``, indexed by time. ``X.attrs`` has
        ``band``, ``noise``, ``resolved``, ``joint_fusion`` and ``doubts``.
    """
    fused = fuse_record(record, smooth, check)
    index = pd.Index(fused.time, name="t")
    dofs = range(1, fused.n_dof + 1)
    X = pd.DataFrame(
        np.hstack([fused.a, fused.v, fused.s]),
        index=index,
        columns=[f"{kind}{j}" for kind in "avs" for j in dofs],
        copy=False,
    )
    F = pd.DataFrame(fused.force, index=index, columns=[f"F{j}" for j in dofs])

    if fused.resolved is not None:
        X.attrs["resolved"] = fused.resolved
    if any(spacing > 1.0 for spacing in fused.spacing.values()):
        X.attrs["joint_fusion"] = fused.joint
    if fused.spacing:
        X.attrs["noise"] = dict(fused.noise)
    if fused.band is not None:
        X.attrs["band"] = fused.band
    if fused.notes:
        X.attrs["doubts"] = [note.message for note in fused.notes]
    return X, F


def _require_motion(record: Record) -> None:
    if not record.has_clock:
        raise ChannelError(
            f"Record {record.name!r} has no clock, which a mass or a damper needs",
            "Give fs= in Hz, or the time. For an element without mass:"
            " NRFRegressor(massless=True) with laws of the drift alone, such as"
            " laws={1: [laws.LinearElastic()]}.",
        )
    measured = set(record.measured)
    for j in range(1, record.n_dof + 1):
        if measured.isdisjoint({f"a{j}", f"v{j}", f"x{j}"}):
            raise ChannelError(
                f"DOF {j} of record {record.name!r} has no motion channel",
                f"Measure a{j}, v{j} or x{j}, or fit the records themselves"
                " (NRFRegressor.fit): the free run is then fitted to the other"
                " channels.",
            )


def _require_every_channel(record: Record) -> None:
    wanted = [f"{kind}{j}" for j in range(1, record.n_dof + 1) for kind in "avx"]
    missing = [name for name in wanted if name not in record.measured]
    if missing:
        more = " and more" if len(missing) > 6 else ""
        raise ChannelError(
            f"Record {record.name!r} lacks {', '.join(missing[:6])}{more}",
            "Use smooth=True, which derives them from the other channels, or measure"
            " them.",
        )


def _smoother_of(smooth: bool | KinematicSmoother) -> KinematicSmoother | None:
    if not isinstance(smooth, (bool, KinematicSmoother)):
        raise ChannelError(
            f"smooth={smooth!r} is unknown", "Give True, False or a KinematicSmoother."
        )
    if smooth is True:
        return KinematicSmoother(band="auto")
    return smooth or None


def _checked(record: Record) -> tuple[QualityNote, ...]:
    """Notes on the channels of a record, which a warning lists."""
    notes = tuple(
        QualityNote("other", message, record=record.name)
        for message in data_warnings(record)
    )
    if notes:
        faults = "; ".join(note.message.rstrip(".") for note in notes)
        warnings.warn(
            f"Record {record.name!r}: {faults}. See"
            " pysindy_nrf.records.checks.alignment and"
            " pysindy_nrf.records.checks.channel_checks.",
            DataQualityWarning,
            stacklevel=4,
        )
    return notes


def _interstorey(motion: np.ndarray) -> np.ndarray:
    """Motion of every DOF against the DOF below."""
    return np.diff(motion, axis=1, prepend=0.0)


def _resolved_frequency(record: Record, spacing: pd.Series) -> float | None:
    """Frequency, Hz, up to which the knots resolve every DOF without accelerometer.

    An accelerometer resolves the whole band; what a displacement sensor cannot resolve
    is smoothed away.
    """
    coarse = [
        float(h)
        for j, h in spacing.items()
        if h > 1.0 and f"a{j}" not in record.measured
    ]
    if not coarse:
        return None
    return RESOLVED * record.fs / (2 * max(coarse))


def _base_in_band(record: Record, band: Band) -> np.ndarray | None:
    """Acceleration of the base through the filter of the motion."""
    ag = base_acceleration_if_any(record)
    known = np.flatnonzero(np.isfinite(ag)) if ag is not None else np.zeros(0, int)
    if band is None or ag is None or not known.size:
        return ag
    rows = slice(known[0], known[-1] + 1)
    out = np.array(ag, dtype=float)
    out[rows] = ZeroPhaseFilter(band, record.fs).apply(out[rows])
    return out


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
