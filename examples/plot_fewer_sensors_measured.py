"""
Three floors, two sensors: a measured motion hidden and compared
================================================================

The frequency responses of a frame of three equal floors, force on floor 1 (0.03125 Hz
steps, useful from 4 to 32 Hz). The accelerations of floor 2 are hidden; masses and
storeys are found from the other two, and the hidden motion is compared with the one
that was measured.

Run: ``PYSINDY_NRF_DATA=... python plot_fewer_sensors_measured.py [folder]``
"""

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
import numpy as np

from pysindy_nrf import Chain, NRFRegressor, Record
from pysindy_nrf.equations.errors import nrmse

if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)
print(Chain(3).sensing(sensors=[1, 3], excited=1))

# a period of the steady motion under a random-phase multisine from 4 to 32 Hz
frf = measured_sets.load_three_storey_frf()
n = 2 * len(frf.f)
inside = (frf.f >= 4) & (frf.f <= 32)
count = inside.sum()
phases = np.exp(2j * np.pi * np.random.default_rng(0).random((count, 1)))
lines = np.zeros((n // 2 + 1, 4), dtype=complex)
lines[1:][inside] = phases * np.column_stack([np.ones(count), frf.H[inside]])
signals = np.fft.irfft(lines, n, axis=0)
force = np.zeros((n, 3))
force[:, 0] = signals[:, 0]
a = signals[:, 1:]
hidden = a[:, 1].copy()
a[:, 1] = np.nan
record = Record(force=force, acceleration=a, fs=n * frf.f[0])

model = NRFRegressor(degree=1).fit(record)
motion = model.motions_[0]
error = nrmse(hidden, motion["a2"].to_numpy())
print(f"masses {model.masses_.round(2)}, floor 2: {error:.0f} % NRMSE")
figure, axes = plt.subplots(
    1, 2, figsize=(12, 4), layout="constrained", width_ratios=(1, 3)
)
frame, ax = axes
frame.plot([0, 1], [0, 0], color="0.2", linewidth=2)
for j in (1, 2, 3):
    frame.plot([0, 1], [j, j], color="0.2", linewidth=6)
    frame.plot([0, 0, 1, 1], [j - 1, j, j, j - 1], color="0.5", linewidth=1)
for j, text in ((1, "force, sensor"), (2, "no sensor"), (3, "sensor")):
    frame.annotate(text, (1.05, j), va="center")
frame.set(xlim=(-0.1, 2.2), ylim=(-0.2, 3.4))
frame.axis("off")
shown = motion.iloc[:300]
label = "measured, hidden from the fit"
ax.plot(shown.index, hidden[:300], color="0.6", linewidth=1.5, label=label)
ax.plot(shown.index, shown["a2"], linewidth=0.8, label="estimated")
band = (shown["a2_lower"], shown["a2_upper"])
ax.fill_between(shown.index, *band, alpha=0.3, label="95 %")
ax.set(xlabel="time (s)", ylabel="acceleration of floor 2 (file's unit)")
ax.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
figure.savefig(folder / "fewer_sensors.png", dpi=110)
