"""
How well is the damper's force found? Complete and incomplete, with and without noise
=====================================================================================

The damper's force is the identified storey force less that of the bare frame (eq. 21).
Counterparts of the paper's Figs. 4, 5, 7 and 8, and the energy the damper dissipates,
with the published polynomials (11), (12), (16) and (17) evaluated along the same
motion.

The paper's noise: "the standard deviation of the random noise is equal to 5% of the
corresponding mean value". For a signal that swings about zero the mean is next to
nothing; here 5 % is a share of each channel's rms, and the noisy channels are fused
before the fit.

Run: ``python plot_paper_2dof_damper_force.py [folder]``
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import paper_cases as cases
import paper_published as published
from paper_displays import DamperForceDisplay, EnergyDisplay

from pysindy_nrf import NRFRegressor
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.identification import damper_force

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

figures = {
    ("complete", 0.0): ("04", published.TWO_DOF_COMPLETE),
    ("complete", 0.05): ("05", published.TWO_DOF_COMPLETE_NOISY),
    ("incomplete", 0.0): ("07", published.TWO_DOF_INCOMPLETE),
    ("incomplete", 0.05): ("08", published.TWO_DOF_INCOMPLETE_NOISY),
}
energies, energy_axes = plt.subplots(2, 2, figsize=(9, 6.5), layout="constrained")
for (excitation, noise), (number, paper), ax in zip(
    figures, figures.values(), energy_axes.ravel()
):
    case = cases.two_dof(excitation, noise)
    X, F = case.measured.to_features(smooth=noise > 0)
    model = NRFRegressor(degree=3, strategy=cases.paper_strategy(X, F)).fit(X, F)
    identified_force = damper_force(model, case.bare, X)

    # The damper force over drift and rate, the last two seconds; storey 2 has no
    # damper.
    last = slice(-2000, None)
    figure, axes = plt.subplots(
        1, 2, figsize=(8.5, 3.4), sharey=True, layout="constrained"
    )
    truth = case.damper[last, 0]
    for panel, over in zip(axes, ("drift", "rate")):
        display = DamperForceDisplay.from_estimator(
            model, case.bare, X.iloc[last], 1, truth, over
        )
        display.plot(panel)
    largest = identified_force["storey 2"].iloc[last].abs().max()
    figure.suptitle(
        f"{case.name}: damper force in storey 1 (found in storey 2: at most"
        f" {largest:.2g} N)"
    )
    figure.savefig(folder / f"paper_fig{number}_damper_force.png", dpi=150)

    # The energy it dissipates.
    v, s = X["v1"], X["s1"]
    bare = case.bare.restoring_forces[1](v, s)
    printed = published.force(paper.storeys[1], v, s) - bare
    energy = {
        "true": cases.path_energy(case.damper[:, 0], case.exact.displacement[:, 0]),
        "identified": cases.path_energy(identified_force["storey 1"], s),
        f"paper's polynomial {paper.equations}": cases.path_energy(printed, s),
    }
    EnergyDisplay(X.index, energy).plot(ax)
    ax.set_title(case.name, fontsize="medium")
    gap = 100 * (energy["identified"][-1] / energy["true"][-1] - 1)
    force = model.restoring_force(X)
    first = nrmse(case.force[:, 0], force[:, 0])
    second = nrmse(case.force[:, 1], force[:, 1])
    print(
        f"{case.name}: m = {model.masses_.round(3)} kg, storey force errors"
        f" {first:.2f} and {second:.2f} %, dissipated energy {gap:+.2f} % from the"
        " truth"
    )
energies.savefig(folder / "paper_2dof_energy.png", dpi=150)
