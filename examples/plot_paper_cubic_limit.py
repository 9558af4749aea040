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

HYSTERETIC = {"storey 4": [laws.PowerSeries(1), laws.Dahl()]}
LOOKS = dict(zip(cases.FRICTIONS, (("o", "#0072B2"), ("s", "#D55E00"))))


def mass_errors(floors, friction, level):
    """Largest mass error of the cubic, and of the model with the Dahl law, percent."""
    case = cases.four_storey(floors, friction, level=level)
    X, F = case.exact.to_features(smooth=False)
    cubic = NRFRegressor(degree=3, strategy=cases.paper_strategy(X, F))
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always", BiasWarning)
        cubic.fit(X, F)
    closed = NRFRegressor(degree=1, laws=HYSTERETIC).fit(X, F)
    of_cubic = 100 * (cubic.masses_ / case.truth.masses - 1)
    of_law = 100 * (closed.masses_ / case.truth.masses - 1)
    print(
        f"{case.name}: cubic {of_cubic.round(1)} % (warned: {bool(raised)}), with Dahl"
        f" {of_law.round(2)} %"
    )
    return np.abs(of_cubic).max(), np.abs(of_law).max()


figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
for ax, floors in zip(axes, (cases.COMPLETE_FRAME, cases.INCOMPLETE_FRAME)):
    for friction, (marker, color) in LOOKS.items():
        errors = [mass_errors(floors, friction, level) for level in cases.LEVELS]
        cubic, law = np.transpose(errors)
        look = {"marker": marker, "color": color}
        name = f"{friction:.0f} N"
        ax.plot(cases.LEVELS, cubic, label=f"cubic, {name} damper", **look)
        look |= {"linestyle": ":", "fillstyle": "none"}
        ax.plot(cases.LEVELS, law, label=f"with Dahl law, {name}", **look)
    title = "all floors hit" if len(floors) == 4 else "floor 3 hit"
    ax.set(xlabel="peak of the blows (N)", title=title, yscale="symlog")
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
shown = slice(4096)
candidates = {
    "cubic": NRFRegressor(degree=3),
    "with Dahl law": NRFRegressor(degree=1, laws=HYSTERETIC),
}
figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
for ax, (title, model) in zip(axes, candidates.items()):
    force = model.fit(X, F).restoring_force(X)[shown, 3]
    drift = X["s4"].iloc[shown]
    HysteresisLoopDisplay(drift, force, case.force[shown, 3], "storey 4").plot(ax)
    ax.set_title(title)
figure.savefig(folder / "paper_cubic_limit_loops.png", dpi=150)
