"""
A hotel in earthquakes: when nothing should be added
====================================================

Two instrumented floors of a six-storey building in six earthquakes. A linear chain of
two masses leaves a good part of the motion unexplained, since four floors carry no
sensor. No storey law mends that, and the loop should say so instead of inventing one.

Run: ``PYSINDY_NRF_DATA=... python plot_closed_loop_measured_hotel.py [folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
from paper_displays import BeforeAfterDisplay, HysteresisLoopDisplay

from pysindy_nrf import NRFRegressor, close_loop

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

records = [
    measured_sets.load_six_storey_hotel(event) for event in (1, 4, 7, 10, 13, 16)
]
report = close_loop(records, NRFRegressor(degree=1, known_masses={1: 1.0, 2: 1.0}))
print(f"{report}\n{report.table.round(2).to_string()}")
print(report.candidates.head(6).to_string())

figure, axes = plt.subplots(1, 3, figsize=(14, 4.5), layout="constrained")
X, F = records[0].to_features()
for ax, site in zip(axes, ("storey 1", "storey 2")):
    HysteresisLoopDisplay.from_estimator(report.model, X, F, site).plot(ax)
    ax.set_title(f"{records[0].name}, {site}")
BeforeAfterDisplay.from_report(report).plot(axes[2])
figure.savefig(folder / "closed_loop_measured_hotel.png", dpi=150)
