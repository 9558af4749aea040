"""The paper's own processing of the four-storey test."""

from __future__ import annotations

import numpy as np

from ..data.channels import finite_span
from ..data.record import Record
from ..exceptions import ChannelError
from .integration import integrate
from .zero_phase_filter import FairFilter


def paper_processing(record: Record, high_pass: float = 1.0, filter_force: bool = False) -> Record:
    """High-pass the accelerations, integrate them to velocities, leave the displacements.

    Measured accelerations go through a zero-phase 1 Hz high-pass (relative to the base, if it
    moves), velocities are their cumulative trapezoid integral, measured displacements are used as
    they are. So acceleration, velocity and displacement have not gone through the same filter;
    :class:`KinematicSmoother` avoids that.

    Parameters
    ----------
    record : Record
        Accelerations and displacements of every DOF.
    high_pass : float
        Hz.
    filter_force : bool
        Put the forces through the same high-pass (the paper leaves them).

    Returns
    -------
    Record

    Raises
    ------
    ChannelError
        If an acceleration or a displacement was not measured.

    References
    ----------
    "Data-based identification of nonlinear restoring force under spatially incomplete excitations
    with power series polynomial model", the section on the four-storey frame: accelerations and
    displacements at 1024 Hz, 1 Hz high-pass, velocity by numerical integration.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import Record
    >>> from pysindy_nrf.signals import paper_processing
    >>> t = np.arange(8000) / 1000
    >>> rec = Record(acceleration=-3600 * np.sin(60 * t), displacement=np.sin(60 * t), fs=1000.0)
    >>> out = paper_processing(rec)
    >>> gap = out.velocity[1000:-1000, 0] - 60 * np.cos(60 * t[1000:-1000])
    >>> bool(np.std(gap) < 0.02 * 60)  # m/s; the high-pass and the trapezoid leave one percent
    True
    """
    have = set(record.measured)
    missing = [f"{k}{j}" for j in range(1, record.n_dof + 1) for k in "ax" if f"{k}{j}" not in have]
    if missing:
        raise ChannelError(
            f"Record {record.name!r} lacks {', '.join(missing[:6])}, which the paper's processing needs",
            "Use KinematicSmoother, which completes missing channels.",
        )
    measured = record.acceleration
    assert measured is not None  # no channel of it is missing
    operator = FairFilter((high_pass, None), record.fs)
    channels = record.channels()
    span = finite_span(list(channels.values()), list(channels), f"record {record.name!r}")
    base = np.zeros(record.n_samples)
    if record.coordinates == "relative" and record.base_moves:
        from .kinematic_smoother import base_acceleration

        base[span] = base_acceleration({k: y[span] for k, y in channels.items()}, record.fs)
    acceleration, velocity = (np.full((record.n_samples, record.n_dof), np.nan) for _ in range(2))
    relative = operator.apply(measured[span] - base[span, None])
    acceleration[span] = relative + base[span, None]
    velocity[span] = integrate(relative, record.dt, "cumulative")
    force = np.array(record.force, dtype=float)
    if filter_force:
        force[span] = operator.apply(force[span])
    return record.replace(acceleration=acceleration, velocity=velocity, force=force)
