"""
Cyclic tests of a damper: better than a cubic series?
=====================================================

Tests of a damper at constant current, each at one frequency. The declared model is a
spring, a dashpot and the load cell's offset. Beside it stands the cubic series in
velocity and drift, the paper's nine terms. Every twelfth of the 82 runs is drawn.

Run: ``PYSINDY_NRF_DATA=... python plot_closed_loop_measured_mr_damper_cyclic.py
[folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
import numpy as np
from paper_displays import HysteresisLoopDisplay

from pysindy_nrf import KinematicSmoother, NRFRegressor, close_loop, laws

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)


def declared(degree):
    return NRFRegressor(
        laws={1: [laws.PowerSeries(degree), laws.ConstantForce()]}, massless=True
    )


runs = measured_sets.mr_damper_cyclic_runs()[::12]
rows, reports = [], []
for run in runs:
    record = measured_sets.load_mr_damper_cyclic(run)
    report = close_loop(record, declared(1), max_steps=2)
    cubic = close_loop(record, declared(3), max_steps=0)
    errors = report.table["held-out"]
    rows.append([errors.iloc[0], cubic.table["held-out"].iloc[0], errors.iloc[-1]])
    reports.append(report)
    print(f"{run}\n{report}\n")

figure, axes = plt.subplots(1, 3, figsize=(14, 4.5), layout="constrained")
X, F = record.to_features(KinematicSmoother(band=(None, 8.0)))
for ax, model, when in zip(axes, (report.models[0], report.model), ("before", "after")):
    HysteresisLoopDisplay.from_estimator(model, X, F, "storey 1").plot(ax)
    ax.set_title(f"{runs[-1]}, {when}")
positions = np.arange(len(runs))
for k, name in enumerate(("spring and dashpot", "cubic series", "found by the loop")):
    axes[2].bar(positions + 0.27 * (k - 1), [row[k] for row in rows], 0.27, label=name)
axes[2].set_xticks(positions, runs, rotation=45, ha="right")
axes[2].set_ylabel("held-out error (% NRMSE)")
axes[2].legend(frameon=False)
figure.savefig(folder / "closed_loop_measured_mr_damper_cyclic.png", dpi=150)
