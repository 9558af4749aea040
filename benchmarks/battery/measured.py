"""Measured sets as the loop gets them: nothing cut off, as few filters as can be."""

from __future__ import annotations

import search_path
import measured_sets

from pysindy_nrf import Record, ZeroPhaseFilter
from pysindy_nrf.records.fusion import integrate

LASER_RATE = 500.0  # Hz; the logger repeats each sample four times


def dry_friction() -> Record:
    """Run 60.52 at the rate of the lasers."""
    logged = measured_sets.load_dry_friction_storey()
    return Record(
        displacement=logged.displacement[::4],
        base_displacement=logged.base_displacement[::4],
        fs=LASER_RATE,
        coordinates="absolute",
        name=logged.name,
    )


def load_nees_isolated(test: str) -> Record:
    """The frame on bearings with the table's displacement, which was not measured.

    It is the double integral of the table's acceleration above 0.1 Hz; the other
    displacements pass the same filter.
    """
    record = measured_sets.load_nees_isolated(test)
    above = ZeroPhaseFilter((0.1, None), record.fs)
    ag = above.apply(record.base_acceleration)
    xg = integrate(ag, record.dt, order=2, detrend=True)
    return record.replace(
        displacement=above.apply(record.displacement),
        base_acceleration=ag,
        base_displacement=above.apply(xg),
    )


def mr_cyclic(count: int | None = None) -> list[Record]:
    """The cyclic tests of the MR damper: all 82, or so many spread over them."""
    runs = measured_sets.mr_damper_cyclic_runs()
    if count is not None:
        step = max(1, len(runs) // count)
        runs = runs[::step][:count]
    return [measured_sets.load_mr_damper_cyclic(run) for run in runs]


def hotel() -> list[Record]:
    """All 21 earthquakes of the six-storey hotel."""
    return [measured_sets.load_six_storey_hotel(event) for event in range(1, 22)]
