"""
What measured records hide
==========================

Each measured record from its undeclared baseline: the loop's own words and the held-out errors before and after. The
records are not part of the project; the environment variable PYSINDY_NRF_DATA names their folder.

Run: ``PYSINDY_NRF_DATA=... python plot_closed_loop_measured.py [folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt

from pysindy_nrf import NRFRegressor, close_loop, datasets
from pysindy_nrf.displays import BeforeAfterDisplay

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

equal = {1: 1.0, 2: 1.0, 3: 1.0}
tests = {
    "EMPS stage": (datasets.load_emps(), {}, (0, 20)),
    "steel frame, strong shaking": (datasets.load_nees_three_storey("fbgm162s5"), {"known_masses": equal}, (0.2, 10)),
    "steel frame, weak shaking": (datasets.load_nees_three_storey("fbgm162s1"), {"known_masses": equal}, (0.2, 10)),
    "MR damper alone": (datasets.load_mr_damper_white_noise(), {"known_masses": {1: 0.0}}, (0, 60)),
    "Bouc-Wen benchmark": (datasets.load_bouc_wen_benchmark("multisine"), {}, (0, 150)),
}
figure, axes = plt.subplots(2, 3, figsize=(14, 8), layout="constrained")
for ax, (name, (record, declared, band)) in zip(axes.flat, tests.items()):
    report = close_loop(record, NRFRegressor(degree=1, **declared), band=band)
    print(f"{name}\n{report}\n")
    BeforeAfterDisplay.from_report(report).plot(ax)
    ax.set_title(f"{name}, {band[0]:g}-{band[1]:g} Hz")
axes.flat[-1].axis("off")
figure.savefig(folder / "closed_loop_measured.png", dpi=150)
