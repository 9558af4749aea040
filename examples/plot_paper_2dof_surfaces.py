"""
Where does the damper sit? The 2-DOF frame's surfaces
=====================================================

A frame of two masses with an MR damper in storey 1, excited at random on both DOFs or
on DOF 2 only. The identified surface of storey 1 bends, that of storey 2 is a plane:
counterparts of the paper's Figs. 2, 3 and 6, with the published polynomials (11), (14)
and (16) drawn as nets.

Run: ``python plot_paper_2dof_surfaces.py [folder]``; pictures go to ``./nrf_output`` by
default.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import paper_cases as cases
import paper_published as published
from paper_displays import RecordDisplay, RestoringForceSurfaceDisplay
from planarity import PlanarityDisplay, locate_nonlinearity

from pysindy_nrf import NRFRegressor

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

# %%
# Forces and responses (Fig. 2), the first second.
case = cases.two_dof("complete")
first_second = case.exact.window(0, 1)
for kind in ("force", "acceleration", "displacement"):
    RecordDisplay(first_second, kind).plot().figure_.savefig(
        folder / f"paper_fig02_{kind}.png", dpi=150
    )

# %%
# Surfaces under complete (Fig. 3) and incomplete (Fig. 6) excitation.
results = {
    "complete": ("03", published.TWO_DOF_COMPLETE),
    "incomplete": ("06", published.TWO_DOF_INCOMPLETE),
}
for excitation, (number, paper) in results.items():
    case = cases.two_dof(excitation)
    X, F = case.exact.to_features(smooth=False)
    model = NRFRegressor(degree=3, strategy=cases.paper_strategy(X, F)).fit(X, F)
    print(
        f"{excitation}: masses {model.masses_.round(3)} kg, the paper's"
        f" {sorted(paper.masses.items())}"
    )
    print(model.model_)

    figure = plt.figure(figsize=(9.6, 4.2), layout="constrained")
    for storey in (1, 2):
        ax = figure.add_subplot(1, 2, storey, projection="3d")
        published_force = paper.model().restoring_forces[storey]
        RestoringForceSurfaceDisplay.from_estimator(
            model, storey, published_force
        ).plot(ax)
    figure.savefig(folder / f"paper_fig{number}_surfaces_{excitation}.png", dpi=150)

    # How flat is flat? The planarity index says it in numbers.
    location = locate_nonlinearity(model, X, F, random_state=0)
    print(location, location.first.round(3), sep="\n")
    PlanarityDisplay(location.first).plot().figure_.savefig(
        folder / f"paper_2dof_planarity_{excitation}.png", dpi=150
    )
