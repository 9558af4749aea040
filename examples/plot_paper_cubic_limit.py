"""
When does the cubic fail, and what cures it?
============================================

A power series in drift and rate cannot remember where it came from, a damper can. What
the cubic leaves unexplained beside a hysteretic storey is not noise, and it drags
masses and stiffnesses down. The regressor says so (BiasWarning); with the hysteretic
law in the model the same data give the right masses. Three force levels and two damper
strengths, all floors hit and floor 3 only, noise-free.

Run: ``python plot_paper_cubic_limit.py [folder]``
"""

import sys
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import paper_cases as cases
from paper_displays import HysteresisLoopDisplay

from pysindy_nrf import NRFRegressor, laws
from pysindy_nrf.exceptions import BiasWarning

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
for ax, floors in zip(axes, (cases.COMPLETE_FRAME, cases.INCOMPLETE_FRAME)):
    for friction, marker, color in zip(cases.FRICTIONS, "os", ("#0072B2", "#D55E00")):
        worst = []
        for level in cases.LEVELS:
            case = cases.four_storey(floors, friction, level=level)
            X, F = case.exact.to_features(smooth=False)
            with warnings.catch_warnings(record=True) as raised:
                warnings.simplefilter("always", BiasWarning)
                cubic = NRFRegressor(degree=3, strategy=cases.paper_strategy(X, F)).fit(
                    X, F
                )
            hysteretic = {"storey 4": [laws.PowerSeries(1), laws.Dahl()]}
            closed = NRFRegressor(degree=1, laws=hysteretic).fit(X, F)
            bias = [100 * (m.masses_ / case.truth.masses - 1) for m in (cubic, closed)]
            worst.append([np.abs(b).max() for b in bias])
            print(
                f"{case.name}: cubic {bias[0].round(1)} % (warned: {bool(raised)}),"
                f" with Dahl {bias[1].round(2)} %"
            )
        worst = np.array(worst)
        ax.plot(
            cases.LEVELS,
            worst[:, 0],
            marker=marker,
            color=color,
            label=f"cubic, {friction:.0f} N damper",
        )
        ax.plot(
            cases.LEVELS,
            worst[:, 1],
            marker=marker,
            color=color,
            linestyle=":",
            fillstyle="none",
            label=f"with Dahl law, {friction:.0f} N",
        )
    ax.set(
        xlabel="peak of the blows (N)",
        title="all floors hit" if len(floors) == 4 else "floor 3 hit",
        yscale="symlog",
    )
    ax.set_xticks(cases.LEVELS)
    ax.set_yticks([0, 1, 10, 100], ["0", "1", "10", "100"])
axes[0].set_ylabel("largest mass error (%)")
axes[1].legend(
    frameon=False, fontsize="small", loc="lower left", bbox_to_anchor=(0, 0.06)
)
figure.savefig(folder / "paper_cubic_limit.png", dpi=150)

# %%
# The loops of storey 4: what the cubic makes of them, and the law that remembers.
case = cases.four_storey(cases.INCOMPLETE_FRAME, 70.0, level=1000.0)
X, F = case.exact.to_features(smooth=False)
part = slice(4096)
candidates = {
    "cubic": NRFRegressor(degree=3),
    "with Dahl law": NRFRegressor(degree=1, laws=hysteretic),
}
figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
for ax, (title, model) in zip(axes, candidates.items()):
    found = model.fit(X, F).restoring_force(X)[part, 3]
    HysteresisLoopDisplay(
        X["s4"].iloc[part], found, case.force[part, 3], "storey 4"
    ).plot(ax).ax_.set_title(title)
figure.savefig(folder / "paper_cubic_limit_loops.png", dpi=150)
