"""
A steel frame on a shaking table, weak and strong
=================================================

Three storeys, base motion only, so storey forces come per mass. In the weak test the
loop should add nothing; in the strong one every storey yields and the loops open.

Run: ``PYSINDY_NRF_DATA=... python plot_closed_loop_measured_nees.py [folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
import numpy as np
from paper_displays import BeforeAfterDisplay, HysteresisLoopDisplay

from pysindy_nrf import NRFRegressor, close_loop
from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

equal = {1: 1.0, 2: 1.0, 3: 1.0}
reports = {}
for name in ("fbgm162s1", "fbgm162s5"):
    record = measured_sets.load_nees_three_storey(name)
    reports[name] = close_loop(record, NRFRegressor(degree=1, known_masses=equal))
    print(f"{name}\n{reports[name]}\n{reports[name].table.round(2).to_string()}\n")

# columns are built from the whole motion and then filtered, as in the search: a law
# with memory needs the slow part
X, _ = record.to_features()
filter = ZeroPhaseFilter((0.2, 10.0), record.fs)
inertia = filter.apply(-np.cumsum(X[["a3", "a2", "a1"]].to_numpy(), axis=1)[:, ::-1])
drift = filter.apply(X[["s1", "s2", "s3"]].to_numpy())
stretch = slice(len(X) // 25, len(X) // 2)
figure, axes = plt.subplots(2, 4, figsize=(17, 8), layout="constrained")
for row, model, when in zip(
    axes, (reports[name].models[0], reports[name].model), ("before", "after")
):
    force = filter.apply(
        model.restoring_force(X, base_acceleration=record.base_acceleration)
    )
    for ax, i in zip(row, range(3)):
        HysteresisLoopDisplay(
            drift[stretch, i], force[stretch, i], inertia[stretch, i], f"storey {i + 1}"
        ).plot(ax)
        ax.set_title(f"strong shaking, storey {i + 1}, {when}")
        ax.set_ylabel(f"$R_{i + 1}$ for floors of 1 kg (N)")
for ax, (name, report) in zip(axes[:, 3], reports.items()):
    BeforeAfterDisplay.from_report(report).plot(ax)
    ax.set_title(name)
figure.savefig(folder / "closed_loop_measured_nees.png", dpi=150)
