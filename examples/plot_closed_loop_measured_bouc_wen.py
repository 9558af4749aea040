"""
The Bouc-Wen benchmark from a linear start
==========================================

The published benchmark of Noel and Schoukens (2016): a mass on a hysteretic spring
under a multisine. Declared is a linear spring. Found should be m = 2 kg, c = 10 N s/m,
k = 5e4 N/m, and the hysteresis with alpha = 5e4 N/m, beta gamma = 800 1/m, delta /
gamma = -1.375, nu = 1.

Run: ``PYSINDY_NRF_DATA=... python plot_closed_loop_measured_bouc_wen.py [folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
from paper_displays import BeforeAfterDisplay, HysteresisLoopDisplay

from pysindy_nrf import NRFRegressor, close_loop
from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

record = measured_sets.load_bouc_wen_benchmark()
report = close_loop(record, NRFRegressor(degree=1))
print(report.model)
print(f"{report}\n{report.table.round(2).to_string()}")

X, F = record.to_features()
filter = ZeroPhaseFilter(report.band, record.fs)
stretch = slice(3000, 3500)
figure, axes = plt.subplots(1, 3, figsize=(14, 4.5), layout="constrained")
for ax, model, when in zip(axes, (report.models[0], report.model), ("before", "after")):
    measured = filter.apply(F["F1"].to_numpy() - model.masses[0] * X["a1"].to_numpy())
    force = filter.apply(model.restoring_force(X)[:, 0])
    HysteresisLoopDisplay(
        X["s1"].to_numpy()[stretch], force[stretch], measured[stretch]
    ).plot(ax)
    ax.set_title(when)
BeforeAfterDisplay.from_report(report).plot(axes[2])
figure.savefig(folder / "closed_loop_measured_bouc_wen.png", dpi=150)
