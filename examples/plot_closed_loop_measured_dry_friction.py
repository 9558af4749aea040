"""
A mass that rubs, but not where one would look
==============================================

A one-storey frame on a shaking base; the mass rubs on a frame that stands on the
laboratory floor. Is the friction in the storey or against the ground? The force over
the drift does not say; the loop does.

Run: ``PYSINDY_NRF_DATA=... python plot_closed_loop_measured_dry_friction.py [folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
import numpy as np
from paper_displays import BeforeAfterDisplay

from pysindy_nrf import KinematicSmoother, NRFRegressor, Record, close_loop

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

measured = measured_sets.load_dry_friction_storey()
# the lasers give 500 Hz, logged at 2000 Hz by repetition; their stand-off is taken off
x, xg = measured.displacement[::4], measured.base_displacement[::4]
record = Record(
    displacement=x - x.mean(axis=0),
    base_displacement=xg - xg.mean(),
    fs=500.0,
    coordinates="absolute",
    name=measured.name,
)
report = close_loop(record, NRFRegressor(degree=1, known_masses={1: 1.0}))
print(f"{report}\n{report.table.round(2).to_string()}")

X, F = record.to_features(KinematicSmoother(band=(None, 20.0)))
inside = X.notna().all(axis=1)
X = X[inside]
vg = np.gradient(xg, 1 / 500.0)[inside]
figure, axes = plt.subplots(1, 3, figsize=(14, 4.5), layout="constrained")
storey = report.model.restoring_forces["storey 1"]
a, v, s = X[["a1", "v1", "s1"]].to_numpy().T
missing = -a - storey(v, s)
rates = {"storey": v, "absolute": v + vg}
for ax, (name, rate) in zip(axes, rates.items()):
    ax.plot(1e3 * rate[::3], missing[::3], ".", markersize=1.5)
    ax.set(
        xlabel=f"{name} velocity (mm/s)",
        ylabel="force the storey does not explain (N, for 1 kg)",
    )
    ax.set_title(f"over the {name} velocity")
BeforeAfterDisplay.from_report(report).plot(axes[2])
figure.savefig(folder / "closed_loop_measured_dry_friction.png", dpi=150)
