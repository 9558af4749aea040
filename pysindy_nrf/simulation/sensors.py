"""Records as faulty sensors show them, and freed of a fault."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..chain.sites import Site
from ..exceptions import ChannelError
from ..laws.base import ForceLaw
from ..laws.sensor import SensorFault
from ..records.record import OF_LETTER, Record


def as_read(record: Record, laws: Mapping[Site, Sequence[ForceLaw]]) -> Record:
    """A true record as the sensors of a model show it."""
    for site, laws_there in laws.items():
        if site.kind == "sensor":
            for law in laws_there:
                if isinstance(law, SensorFault):
                    record = _with_channels(record, site, law.reading)
    return record


def as_true(record: Record, site: Site, law: SensorFault) -> Record:
    """A record with the channels of a site freed of a fault."""
    return _with_channels(record, site, law.corrected)


def _with_channels(
    record: Record, site: Site, change: Callable[[np.ndarray, float], np.ndarray]
) -> Record:
    """A record with the channels of a site passed through a function.

    Of their values and dt.
    """
    letters = [channel[0] for channel in site.channels]
    if not (1 <= site.p <= record.n_dof and set(letters) <= OF_LETTER.keys()):
        raise ChannelError(
            f"{str(site)!r} is not a channel of record {record.name!r}",
            f"Its channels are {', '.join(record.channels())}.",
        )

    changes = {}
    for name in map(OF_LETTER.__getitem__, letters):
        if getattr(record, name) is None:
            continue
        values = np.array(getattr(record, name), dtype=float)
        column = site.p - 1
        if np.nan_to_num(values[:, column]).any():
            values[:, column] = change(values[:, column], record.dt)
        changes[name] = values
    return record.replace(**changes)
