"""
An undeclared bumper on the third floor, and two effects at once
================================================================

A four-storey frame knocks against a bumper that nobody declared; in the second test the
first storey rubs as well. 2 % noise on every channel, one floor shaken. What does the
loop find, where, and what is left?

Run: ``python plot_closed_loop_bumper.py [folder]``
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from paper_displays import BeforeAfterDisplay

from pysindy_nrf import ChainModel, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)


def storey():
    return [laws.LinearElastic(1.4e5), laws.LinearViscous(60.0)]


bumper = laws.OneSidedGap(gap=0.0015, k=1.5e5)
friction = laws.CoulombFriction(40.0)
frames = {
    "bumper": {"storey 3": [*storey(), bumper]},
    "bumper and friction": {
        "storey 3": [*storey(), bumper],
        "storey 1": [*storey(), friction],
    },
}
F = excitation.band_limited_random(
    4, 16.0, 1000.0, excited=3, rms=150.0, band=(1, 40), random_state=1
)
plain = {f"storey {i}": storey() for i in range(1, 5)}
s = np.linspace(-0.004, 0.004, 400)
figure, axes = plt.subplots(2, 2, figsize=(11, 7.5), layout="constrained")
for row, (name, special) in zip(axes, frames.items()):
    frame = ChainModel([12.4, 12.4, 12.4, 12.0], plain | special)
    record = add_noise(simulate(frame, F, 1e-3), 0.02, random_state=2)
    report = close_loop(record)
    print(f"{name}\n{report}\n{report.table.round(2).to_string()}\n")
    BeforeAfterDisplay.from_report(report).plot(row[0])
    row[0].set_title(name)
    for model, label, style in ((frame, "true", "k-"), (report.model, "found", "--")):
        force = model.restoring_forces["storey 3"](0.0, s)
        row[1].plot(1e3 * s, force, style, label=label)
    row[1].set(
        xlabel="drift of storey 3 (mm)",
        ylabel="restoring force at rest (N)",
        title="storey 3",
    )
    row[1].legend(frameon=False)
figure.savefig(folder / "closed_loop_bumper.png", dpi=150)
