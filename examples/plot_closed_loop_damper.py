"""
The paper's own damper, if nobody had declared it
=================================================

The masses of a frame with a magneto-rheological damper come out low when storeys are
taken to be linear or cubic. The loop is given the channels and a linear model, nothing
else: it traces the residual to a storey, names the hysteresis, and the masses come
right by themselves.

Run: ``python plot_closed_loop_damper.py [folder]``
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import paper_cases as cases
from paper_displays import BeforeAfterDisplay

from pysindy_nrf import NRFRegressor, close_loop

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

tests = {
    "2-DOF frame, floor 2 shaken": cases.two_dof("incomplete"),
    "four-storey frame, all floors hit": cases.four_storey(cases.COMPLETE_FRAME, 20.0),
    "four-storey frame, floor 3 hit": cases.four_storey(cases.INCOMPLETE_FRAME, 20.0),
}
figure, axes = plt.subplots(1, len(tests), figsize=(13, 4), layout="constrained")
for ax, (name, case) in zip(axes, tests.items()):
    report = close_loop(case.exact, NRFRegressor(degree=1))
    print(f"{name}\n{report}\n{report.table.round(3).to_string()}")
    print(
        f"masses, kg: {report.models[0].masses.round(3)} ->"
        f" {report.model.masses.round(3)}"
    )
    print(f"true:       {case.truth.masses.round(3)}\n")
    BeforeAfterDisplay.from_report(report).plot(ax)
    ax.set_title(name)
figure.savefig(folder / "closed_loop_damper.png", dpi=150)
