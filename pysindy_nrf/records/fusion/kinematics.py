"""From the measured channels of a record to the motion and forces of its balances.

The result has absolute accelerations, inter-storey velocities and drifts (paper eq. 8).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from ...common.warn import warn_user
from ...exceptions import ChannelError, DataQualityWarning
from ..checks.channel_checks import channel_notes
from ..checks.corners import without_corners
from ..quality import QualityNote, messages
from ..record import Record
from ..zero_phase_filter import Band, ZeroPhaseFilter, check_band
from .channel_fusion import (
    FusedChannels,
    FusionSettings,
    choose_band,
    fuse_channels,
    warn_of_lost_motion,
)
from .channel_table import ChannelTable
from .dof_fusion import FusedMotion
from .kinematic_smoother import KinematicSmoother

# Share of the knots' Nyquist frequency up to which a fused motion is reliable.
RESOLVED = 0.7
# Accelerations that differ by less than this share of themselves and of their standard
# deviation were passed on unchanged.
PASSED_ON = 1e-4


@dataclass(frozen=True)
class FusedRecord:
    """One motion and the forces of a record, as the balances need them.

    Arrays have a row for each sample and a column for each DOF or storey. Rows at the
    ends that a filter spoils, or in which a channel is NaN, are NaN.

    Attributes
    ----------
    motion : ndarray of shape (n_samples, 3 n_dof)
        Absolute accelerations, m/s^2, inter-storey velocities, m/s, and drifts, m:
        ``a1.., v1.., s1..`` (paper eq. 8). ``a``, ``v`` and ``s`` are views of it.
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
        What is wrong with the measured channels, or to be known of them. Accelerations
        are those before the high-pass filters that notes name.
    simulation_method : str
        The method of :func:`~pysindy_nrf.simulate` that follows the record: Newmark's
        if it was computed by it.
    hold : {"cubic", "linear", "zero"}, optional
        Course of the forces between the samples, if the channels show how they were
        computed; else None.
    as_measured : bool
        Whether the channels are as they are, without fusion.
    """

    motion: np.ndarray
    force: np.ndarray
    ag: np.ndarray | None
    time: np.ndarray
    band: Band = None
    resolved: float | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    spacing: Mapping[int, float] = field(default_factory=dict)
    joint: bool = False
    notes: tuple[QualityNote, ...] = ()
    simulation_method: str = "default"
    hold: str | None = None
    as_measured: bool = False

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.force.shape[1]

    @property
    def a(self) -> np.ndarray:
        """Absolute accelerations, m/s^2, (n_samples, n_dof)."""
        return self.motion[:, : self.n_dof]

    @property
    def v(self) -> np.ndarray:
        """Inter-storey velocities, m/s, (n_samples, n_dof)."""
        return self.motion[:, self.n_dof : 2 * self.n_dof]

    @property
    def s(self) -> np.ndarray:
        """Drifts, m, (n_samples, n_dof)."""
        return self.motion[:, 2 * self.n_dof :]


# Another way to fuse a record than by a KinematicSmoother; the second argument says
# whether its channels are checked.
Fusion = Callable[[Record, bool], FusedRecord]


def fuse_record(
    record: Record, smooth: bool | KinematicSmoother | Fusion = True, check: bool = True
) -> FusedRecord:
    """Fuse the measured channels of a record into one motion of each DOF.

    Parameters
    ----------
    record : Record
    smooth : bool, KinematicSmoother or function
        True: ``KinematicSmoother(band="auto")``. False: the channels are taken as they
        are, and every DOF needs all three. A function, such as a method of
        :class:`TwoWayFusion`, is called with the record and ``check``.
    check : bool
        Look for faults of the channels before; what is found becomes a warning and
        stands in ``notes``.

    Raises
    ------
    ChannelError
        If the record has no clock, or a DOF lacks the channels that are needed.
    """
    if callable(smooth):
        return smooth(record, check)
    _require_motion(record)
    if not isinstance(smooth, (bool, KinematicSmoother)):
        raise ChannelError(
            f"smooth={smooth!r} is unknown", "Give True, False or a KinematicSmoother."
        )
    notes = _checked(record) if check else ()
    record = without_corners(record, notes)
    if smooth is False:
        return _as_measured(record, notes)
    smoother = KinematicSmoother(band="auto") if smooth is True else smooth
    return _from_channels(record, smoother.fuse(record), smoother.joint, notes)


class TwoWayFusion:
    """Fuses one record jointly over its DOFs, and DOF by DOF.

    Instrumental variables need both. The first step, each DOF by itself, is done once.
    """

    def __init__(self) -> None:
        self._dof_by_dof: Sequence[list[FusedMotion]] | None = None
        self._corners: tuple[QualityNote, ...] = ()

    def joint(self, record: Record, check: bool = True) -> FusedRecord:
        """The record with motions that its DOFs improved for each other."""
        return self._fuse(record, True, check)

    def separate(self, record: Record, check: bool = True) -> FusedRecord:
        """The record with motions whose noise is independent of the motion."""
        return self._fuse(record, False, check)

    def _fuse(self, record: Record, joint: bool, check: bool) -> FusedRecord:
        _require_motion(record)
        first = self._dof_by_dof is None
        notes = _checked(record) if check and first else ()
        if first:
            self._corners = notes
        record = without_corners(record, self._corners)
        settings = FusionSettings(band="auto", joint=joint)
        table = ChannelTable.from_record(record)
        fused = fuse_channels(
            table,
            settings,
            choose_band([table], settings),
            noise={},
            keep=first,
            dof_by_dof=self._dof_by_dof or (),
        )
        warn_of_lost_motion(fused)
        if first:
            self._dof_by_dof = fused.dof_by_dof
        return _from_channels(record, fused, joint, notes)


def to_features(
    record: Record,
    smooth: bool | KinematicSmoother | Fusion = True,
    check: bool = True,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Motion and forces of a record as tables; see :func:`fuse_record`.

    Returns
    -------
    X, F : DataFrame
        Columns ``a1.., v1.., s1..`` and ``F1..``, indexed by time.
    """
    fused = fuse_record(record, smooth, check)
    index = pd.Index(fused.time, name="t")
    dofs = range(1, fused.n_dof + 1)
    names = [f"{kind}{j}" for kind in "avs" for j in dofs]
    X = pd.DataFrame(fused.motion, index=index, columns=names, copy=False)
    F = pd.DataFrame(fused.force, index=index, columns=[f"F{j}" for j in dofs])
    return X, F


def _as_measured(record: Record, notes: tuple[QualityNote, ...]) -> FusedRecord:
    """The channels of a record as they are."""
    _require_every_channel(record)
    motion = _motion(record, record, smooth=False)
    ag = base_acceleration_if_any(record)
    return FusedRecord(
        motion, record.force, ag, record.time, notes=notes, as_measured=True
    )


def _from_channels(
    record: Record, fused: FusedChannels, joint: bool, notes: tuple[QualityNote, ...]
) -> FusedRecord:
    """The fused channels of a record as motion of its storeys."""
    band = None if fused.band is None else check_band(fused.band, record.fs)
    with_motion = fused.as_record(record)
    coarse = max(fused.spacing.values()) > 1.0
    rule = fused.rule
    return FusedRecord(
        _motion(record, with_motion, smooth=True),
        with_motion.force,
        _base_in_band(record, band),
        record.time,
        band=band,
        resolved=_resolved_frequency(record, fused.spacing),
        noise=fused.noise,
        spacing=fused.spacing,
        joint=joint and coarse and not _passed_on(record, with_motion),
        notes=(*notes, *_computed_notes(record, fused)),
        simulation_method="default" if rule is None else rule.simulation_method,
        hold=None if rule is None else rule.hold,
        as_measured=rule is not None,
    )


def _computed_notes(record: Record, fused: FusedChannels) -> tuple[QualityNote, ...]:
    """A note on channels that were computed, and are taken as they are."""
    rule = fused.rule
    if rule is None:
        return ()
    message = (
        f"The displacements follow from the accelerations by {rule.name}: the channels"
        " were computed, and are taken as they are, without fusion."
    )
    return (QualityNote("computed", message, record=record.name),)


def _motion(record: Record, fused: Record, smooth: bool) -> np.ndarray:
    """Absolute accelerations, inter-storey velocities and drifts, (n_samples, 3
    n_dof).
    """
    a = fused.acceleration
    v = fused.velocity
    x = fused.displacement
    # measured, or filled in by the fusion
    assert a is not None and v is not None and x is not None

    if record.coordinates == "absolute" and record.base_moves:
        vg, xg = base_motion(record, fused, smooth)
        v, x = v - vg[:, None], x - xg[:, None]
    motion = np.hstack([a, v, x])
    n_dof = record.n_dof
    # of storeys above the first: against the DOF below
    motion[:, n_dof + 1 : 2 * n_dof] -= v[:, :-1]
    motion[:, 2 * n_dof + 1 :] -= x[:, :-1]
    return motion


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


def _checked(record: Record) -> tuple[QualityNote, ...]:
    """Notes on the channels of a record, which a warning lists."""
    notes = channel_notes(record)
    if notes:
        faults = "; ".join(message.rstrip(".") for message in messages(notes))
        warn_user(
            f"Record {record.name!r}: {faults}. See"
            " pysindy_nrf.records.checks.alignment and"
            " pysindy_nrf.records.checks.channel_checks.",
            DataQualityWarning,
        )
    return notes


def _resolved_frequency(record: Record, spacing: Mapping[int, float]) -> float | None:
    """Frequency, Hz, up to which the knots resolve every DOF without accelerometer.

    An accelerometer resolves the whole band; what a displacement sensor cannot resolve
    is smoothed away.
    """
    measured = set(record.measured)
    coarse = [
        distance
        for j, distance in spacing.items()
        if distance > 1.0 and f"a{j}" not in measured
    ]
    return RESOLVED * record.fs / (2 * max(coarse)) if coarse else None


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
    ground = _fused_base(record, record.base_velocity, record.base_displacement)
    return ground.a[:, 0]


def base_acceleration_if_any(record: Record) -> np.ndarray | None:
    """Acceleration of the base; None where none of its motion was given."""
    return base_acceleration(record) if record.base_moves else record.base_acceleration


def base_motion(
    record: Record, fused: Record, smooth: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and displacement of the base, for records in absolute coordinates.

    Parameters
    ----------
    record : Record
        As measured.
    fused : Record
        With the base in the band of the fused motion.
    smooth : bool
        False: both are taken as measured.
    """
    measured = {"vg", "xg"}.intersection(record.measured)
    if not smooth and len(measured) == 2:
        assert fused.base_velocity is not None and fused.base_displacement is not None
        return fused.base_velocity, fused.base_displacement
    if not smooth or not measured:
        missing = "vg" if "xg" in measured else "xg"
        cure = "Give base_displacement (integrating ag alone loses its slow part)."
        if not smooth:
            cure = "Give base_displacement and base_velocity."
        raise ChannelError(
            f"Record {record.name!r} has absolute displacements and a moving base, but"
            f" lacks {missing}",
            f"{cure} Or give motion relative to the base.",
        )
    ground = _fused_base(
        record,
        fused.base_velocity,
        fused.base_displacement,
        fused.base_acceleration,
    )
    return ground.v[:, 0], ground.x[:, 0]


def _fused_base(
    record: Record,
    velocity: np.ndarray | None,
    displacement: np.ndarray | None,
    acceleration: np.ndarray | None = None,
) -> FusedChannels:
    """Motion of the base of a record, fused as that of a DOF is."""
    ground = Record(
        acceleration=acceleration,
        velocity=velocity,
        displacement=displacement,
        fs=record.fs,
        name=f"base of {record.name}",
        coordinates="absolute",
    )
    table = ChannelTable.from_record(ground)
    return fuse_channels(table, FusionSettings(), band=None, noise={})


def _passed_on(record: Record, fused: Record) -> bool:
    """Whether the fusion passed clean accelerations on unchanged."""
    before, after = record.acceleration, fused.acceleration
    if before is None or after is None:
        return False
    tolerance = PASSED_ON * np.nanstd(after)
    return np.allclose(before, after, rtol=PASSED_ON, atol=tolerance, equal_nan=True)
