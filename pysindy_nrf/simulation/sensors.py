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
                    record = _with_channel(record, site, law.reading)
    return record


def as_true(record: Record, site: Site, law: SensorFault) -> Record:
    """A record with one channel freed of a fault."""
    return _with_channel(record, site, law.corrected)


def _with_channel(
    record: Record, site: Site, change: Callable[[np.ndarray, float], np.ndarray]
) -> Record:
    """A record with one channel passed through a function of its values and dt."""
    letter, number = site.channel[:1], site.channel[1:]
    is_channel = letter in OF_LETTER and number.isdigit()
    if not is_channel or not 1 <= int(number) <= record.n_dof:
        raise ChannelError(
            f"{str(site)!r} is not a channel of record {record.name!r}",
            f"Its channels are {', '.join(record.channels())}.",
        )

    name = OF_LETTER[letter]
    if getattr(record, name) is None:
        return record
    values = np.array(getattr(record, name), dtype=float)
    column = int(number) - 1
    if np.nan_to_num(values[:, column]).any():
        values[:, column] = change(values[:, column], record.dt)
    return record.replace(**{name: values})
