"""
A positioning stage: the friction nobody declared
=================================================

A drive pushes a carriage along its rails; only the position is measured. The declared
model is a mass with a spring and a dashpot. What is missing? The published answer is
Coulomb friction of 20.4 N and an offset of -3.2 N (Janot, Gautier, Brunot, 2019).

Run: ``PYSINDY_NRF_DATA=... python plot_closed_loop_measured_emps.py [folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
from paper_displays import BeforeAfterDisplay

from pysindy_nrf import KinematicSmoother, NRFRegressor, close_loop

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

record = measured_sets.load_emps()
report = close_loop(record, NRFRegressor(degree=1))
print(f"{report}\n{report.table.round(2).to_string()}")

X, F = record.to_features(KinematicSmoother(band=report.band))
figure, axes = plt.subplots(1, 3, figsize=(14, 4.5), layout="constrained")
velocity = X["v1"].to_numpy()
for ax, model, when in zip(axes, (report.models[0], report.model), ("before", "after")):
    inertia = model.masses[0] * X["a1"].to_numpy()
    ax.plot(
        velocity,
        F["F1"].to_numpy() - inertia,
        color="0.6",
        linewidth=1.5,
        label="measured, inertia taken off",
    )
    ax.plot(velocity, model.predict(X)[:, 0] - inertia, linewidth=0.8, label="model")
    ax.set(xlabel="velocity (m/s)", ylabel="force (N)", title=when)
    ax.legend(frameon=False)
BeforeAfterDisplay.from_report(report).plot(axes[2])
figure.savefig(folder / "closed_loop_measured_emps.png", dpi=150)
