"""
A magnetorheological damper under changing voltage
==================================================

A damper by itself, driven by white noise while its voltage changes. A spring and a
dashpot leave half of its force unexplained. The voltage is among the channels; nobody
says what it does.

Run: ``PYSINDY_NRF_DATA=... python plot_closed_loop_measured_mr_damper.py [folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
from paper_displays import BeforeAfterDisplay

from pysindy_nrf import NRFRegressor, close_loop
from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

record = measured_sets.load_mr_damper_white_noise()
report = close_loop(record, NRFRegressor(degree=1, massless=True), max_steps=2)
print(f"{report}\n{report.table.round(2).to_string()}")

X, F = record.to_features()
filter = ZeroPhaseFilter((None, 60.0), record.fs)
measured = filter.apply(F["F1"].to_numpy())
figure, axes = plt.subplots(1, 3, figsize=(14, 4.5), layout="constrained")
stretch = slice(30000, 33000)  # one second
for ax, model, when in zip(axes, (report.models[0], report.model), ("before", "after")):
    force = filter.apply(model.predict(X, covariates=record.covariates)[:, 0])
    ax.plot(record.time[stretch], measured[stretch], "k", linewidth=1, label="measured")
    ax.plot(record.time[stretch], force[stretch], linewidth=1, label="model")
    ax.set(xlabel="time (s)", ylabel="damper force (N)", title=when)
    ax.legend(frameon=False)
BeforeAfterDisplay.from_report(report).plot(axes[2])
figure.savefig(folder / "closed_loop_measured_mr_damper.png", dpi=150)
