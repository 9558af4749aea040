"""The measured sets as the loop gets them: the loaders of the examples, nothing cut off
and nothing filtered.
"""

from __future__ import annotations

import sys
from pathlib import Path

from pysindy_nrf import Record

sys.path.append(str(Path(__file__).resolve().parents[2] / "examples"))
import measured_sets  # noqa: E402
from measured_sets import (  # noqa: E402, F401
    friction_damper_runs,
    load_bouc_wen_benchmark,
    load_dry_friction_storey_more,
    load_emps,
    load_friction_damper,
    load_mr_damper_random_voltage,
    load_mr_damper_white_noise,
    load_nees_three_storey,
    load_silverbox_multisine,
    load_timber_connection,
    load_tower_with_mass_driver,
)


def dry_friction() -> Record:
    """Run 60.52 at the lasers' 500 Hz: the logger's 2000 Hz repeat every sample four
    times.
    """
    whole = measured_sets.load_dry_friction_storey()
    return Record(
        displacement=whole.displacement[::4],
        base_displacement=whole.base_displacement[::4],
        fs=500.0,
        coordinates="absolute",
        name=whole.name,
    )


def load_nees_isolated(test: str) -> Record:
    """The frame on bearings with the table's displacement: the double integral of its
    acceleration above 0.1 Hz.

    The table's displacement was not measured; the other displacements pass the same
    filter.
    """
    from pysindy_nrf.records.fusion import integrate
    from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter

    whole = measured_sets.load_nees_isolated(test)
    above = ZeroPhaseFilter((0.1, None), whole.fs)
    ag = above.apply(whole.base_acceleration)
    return whole.replace(
        displacement=above.apply(whole.displacement),
        base_acceleration=ag,
        base_displacement=above.apply(integrate(ag, whole.dt, order=2, detrend=True)),
    )


def mr_cyclic(count: int | None = None) -> list[Record]:
    """The cyclic tests of the MR damper: all 82, or so many spread over them."""
    runs = measured_sets.mr_damper_cyclic_runs()
    step = 1 if count is None else max(1, len(runs) // count)
    return [measured_sets.load_mr_damper_cyclic(run) for run in runs[::step][:count]]


def hotel() -> list[Record]:
    """All 21 earthquakes of the six-storey hotel."""
    return [measured_sets.load_six_storey_hotel(i) for i in range(1, 22)]
