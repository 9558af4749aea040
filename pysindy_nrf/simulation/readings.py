"""What faulty sensors make of a record, and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..data.record import Record
from ..exceptions import ChannelError
from ..laws.base import ForceLaw
from ..laws.sensor import SensorFault
from ..mechanics.sites import Site

CHANNELS = {"a": "acceleration", "v": "velocity", "x": "displacement", "F": "force"}


def as_read(record: Record, laws: Mapping[Site, Sequence[ForceLaw]]) -> Record:
    """A true record as the sensors of a model show it."""
    for site, group in laws.items():
        if site.kind == "sensor":
            for law in group:
                if isinstance(law, SensorFault):
                    record = _changed(record, site, law.reading)
    return record


def as_true(record: Record, site: Site, law: SensorFault) -> Record:
    """A record with one channel freed of a fault."""
    return _changed(record, site, law.corrected)


def _changed(record: Record, site: Site, change: Callable[[np.ndarray, float], np.ndarray]) -> Record:
    kind, number = site.channel[:1], site.channel[1:]
    if kind not in CHANNELS or not number.isdigit() or not 1 <= int(number) <= record.n_dof:
        raise ChannelError(
            f"{str(site)!r} is not a channel of record {record.name!r}",
            f"Its channels are {', '.join(record.channels())}.",
        )
    values = getattr(record, CHANNELS[kind])
    if values is None:
        return record
    values, j = np.array(values, dtype=float), int(number) - 1
    if np.nan_to_num(values[:, j]).any():
        values[:, j] = change(values[:, j], record.dt)
    return record.replace(**{CHANNELS[kind]: values})
