"""Records in which floors have no sensor, as shots."""

import numpy as np

from ..exceptions import ChannelError
from ..records.channels import finite_span
from ..records.dataset import Segment
from ..records.fusion.kinematics import base_acceleration_if_any
from ..records.record import Record
from .shots import Shot


def shot_of(record: Record, number: int, n: int) -> Shot:
    """What drives a record, and its channels.

    Parameters
    ----------
    record : Record
    number : int
        Of the record.
    n : int
        DOFs of the chain.

    Raises
    ------
    ChannelError
        If the record has another number of DOFs, a force is unknown, or the motion of
        the base is not known where channels are absolute.
    """
    _require_known_drive(record, n)
    channels = _relative_channels(record)
    ag = base_acceleration_if_any(record)

    needed = dict(channels)
    for dof, force in enumerate(record.force.T, 1):
        needed[f"F{dof}"] = force
    if ag is not None:
        needed["ag"] = ag
    needed |= record.covariates
    rows = finite_span(list(needed.values()), list(needed), f"record {record.name!r}")

    not_measured = np.full((record.n_samples, n), np.nan)
    segment = Segment(
        name=record.name,
        rows=slice(0, record.n_samples),
        a=not_measured,
        v=not_measured,
        s=not_measured,
        F=record.force,
        t=record.time,
        ag=ag,
        covariates=dict(record.covariates),
        valid=rows,
        hold=record.hold,
    )
    measured = np.column_stack([channel[rows] for channel in channels.values()])
    return Shot(
        segment=segment,
        number=number,
        start=np.zeros((2, n)),
        channels=tuple(channels),
        measured=measured,
        weights=np.ones((len(measured), 1)),
    )


def _require_known_drive(record: Record, n: int) -> None:
    if record.n_dof != n:
        raise ChannelError(
            f"Record {record.name!r} has {record.n_dof} DOFs, {n} are needed",
            "Give records of one chain.",
        )
    if record.unknown:
        raise ChannelError(
            f"The force on DOF {record.unknown[0]} of record {record.name!r} is"
            " unknown, and floors have no sensor",
            "Measure it (zeros: known to be unforced), put a sensor on every floor, or"
            " take the floors above it as a chain on it: its acceleration as"
            " base_acceleration=, one mass known.",
        )


def _relative_channels(record: Record) -> dict[str, np.ndarray]:
    """Motion channels by name, velocities and displacements relative to the base."""
    is_absolute = record.coordinates == "absolute" and record.base_moves
    base = {"v": record.base_velocity, "x": record.base_displacement}

    channels = {}
    for name, channel in record.channels().items():
        kind = name[0]
        if kind not in "avx" or not name[1:].isdigit():
            continue
        if is_absolute and kind in base:
            channel = channel - _known_base(base[kind], name, record)
        channels[name] = channel
    return channels


def _known_base(motion: np.ndarray | None, channel: str, record: Record) -> np.ndarray:
    if motion is None:
        raise ChannelError(
            f"Channel {channel} of record {record.name!r} is absolute, and"
            f" {channel[0]}g lacks",
            "Give it, or motion relative to the base, or accelerations alone.",
        )
    return motion
