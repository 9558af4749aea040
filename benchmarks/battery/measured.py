"""The measured sets as the loop gets them: the loaders of the examples, and the preparation that two of them need."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pysindy_nrf import Record

sys.path.append(str(Path(__file__).resolve().parents[2] / "examples"))
import measured_sets  # noqa: E402
from measured_sets import (  # noqa: E402, F401
    load_bouc_wen_benchmark,
    load_emps,
    load_mr_damper_white_noise,
    load_nees_three_storey,
)


def dry_friction() -> Record:
    """The lasers' 500 Hz instead of the logger's 2000 Hz, and their stand-off (the mean) taken off."""
    whole = measured_sets.load_dry_friction_storey()
    x, xg = whole.displacement[::4], whole.base_displacement[::4]
    return Record(
        displacement=x - x.mean(axis=0),
        base_displacement=xg - xg.mean(),
        fs=500.0,
        coordinates="absolute",
        name=whole.name,
    )


def nees_isolated() -> Record:
    """The frame on friction-pendulum bearings: base level (DOF 1) and floors (DOFs 2 to 4) on the table.

    Of the table only the acceleration is measured; its displacement is the double integral above
    0.1 Hz, and the displacements pass the same filter.
    """
    from pysindy_nrf.signals import integrate
    from pysindy_nrf.signals.zero_phase_filter import FairFilter

    whole = measured_sets.load_nees_three_storey("fpgm111s1")
    above = FairFilter((0.1, None), whole.fs)
    ag = above.apply(whole.base_acceleration)
    table = integrate(ag, whole.dt, method="spectral", order=2)
    x = np.column_stack([whole.base_displacement, whole.displacement])
    return Record(
        displacement=above.apply(x),
        base_acceleration=ag,
        base_displacement=above.apply(table),
        fs=whole.fs,
        coordinates="absolute",
        name="fpgm111s1, base level and floors",
    )


def mr_cyclic() -> list[Record]:
    """All 82 cyclic tests of the MR damper."""
    return [measured_sets.load_mr_damper_cyclic(run) for run in measured_sets.mr_damper_cyclic_runs()]


def hotel() -> list[Record]:
    """All 21 earthquakes of the six-storey hotel."""
    return [measured_sets.load_six_storey_hotel(i) for i in range(1, 22)]
