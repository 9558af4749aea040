"""
The four-storey frame, hit on every floor and on floor 3 only
=============================================================

A stand-in for the paper's laboratory frame: its published linear model (20), a mainly
viscous damper on storey 4 and blows that are calibrated to (18) and (22)
(``paper_cases.calibrate_frame``), 1024 Hz, accelerations and displacements measured at
0.2 % noise. Counterparts of Figs. 10-13 (all floors hit), with the published
polynomials (18) and (20) beside ours, and of Figs. 14-16 (only floor 3 hit; the frame
without its damper on floor 2), with (22) and (23).

The damper's force is a cubic's minus a linear model's (eq. 21), as in the paper; then
the same with a Dahl law in the model.

Run: ``python plot_paper_frame.py [folder]``
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import paper_cases as cases
import paper_published as published
from paper_displays import (
    DamperForceDisplay,
    EnergyDisplay,
    ModesDisplay,
    RecordDisplay,
    RestoringForceSurfaceDisplay,
)
from planarity import PlanarityDisplay, locate_nonlinearity

from pysindy_nrf import NRFRegressor, laws
from pysindy_nrf.identification import damper_force

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output")
folder.mkdir(parents=True, exist_ok=True)

# %%
# The two tests, each with its figures' numbers in the paper.
NUMBERS = {
    "complete": {"record": "10", "surfaces": "11", "force": "12", "energy": "13"},
    "incomplete": {
        "record": "14_record",
        "surfaces": "14",
        "force": "15",
        "energy": "16",
    },
}
RESULTS = {
    "complete": (published.FRAME_COMPLETE, published.LINEAR_COMPLETE),
    "incomplete": (published.FRAME_INCOMPLETE, published.LINEAR_INCOMPLETE),
}


def save(figure, name):
    figure.savefig(folder / f"paper_{name}.png", dpi=150)


# %%
# Forces and responses.
def draw_record(record, number):
    for kind in ("force", "acceleration", "displacement"):
        display = RecordDisplay(record, kind).plot()
        save(display.figure_, f"fig{number}_{kind}")


# %%
# Surfaces of the cubic, with those of the paper.
def draw_surfaces(cubic, paper, number):
    figure = plt.figure(figsize=(10, 8.4), layout="constrained")
    for storey in (1, 2, 3, 4):
        ax = figure.add_subplot(2, 2, storey, projection="3d")
        force = paper.model().restoring_forces[storey]
        RestoringForceSurfaceDisplay.from_estimator(cubic, storey, force).plot(ax)
    save(figure, f"fig{number}_surfaces")


# %%
# Where is the damper?
def draw_planarity(cubic, X, F, excitation):
    location = locate_nonlinearity(cubic, X, F, random_state=0)
    print(location)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    tables = {"the cubic": location.first, "Dahl in storey 4": location.last}
    for ax, (title, table) in zip(axes, tables.items()):
        PlanarityDisplay(table).plot(ax)
        ax.set_title(title, loc="left", fontsize="medium")
    save(figure, f"frame_planarity_{excitation}")


# %%
# The damper force in storey 4. A diagonal load cell would read more than the horizontal
# force: 25 % more for a device that rises 0.3 m over 0.4 m (0.5 m long), and its
# reading is brought back here.
def draw_damper_force(models, linear, X, damper, number):
    horizontal = 0.4 / 0.5
    load_cell = damper / horizontal
    measured = load_cell * horizontal
    figure, axes = plt.subplots(
        1, 2, figsize=(9, 3.6), sharey=True, layout="constrained"
    )
    # of the law with memory four seconds
    cubic, hysteretic = models
    fits = {
        "cubic less linear (eq. 21)": (cubic, slice(None)),
        "with a Dahl law, less linear": (hysteretic, slice(4096)),
    }
    for ax, (name, (model, rows)) in zip(axes, fits.items()):
        motion = X.iloc[rows]
        display = DamperForceDisplay.from_estimator(
            model, linear, motion, 4, measured[rows]
        )
        display.plot(ax)
        others = damper_force(model, linear, motion).drop(columns="storey 4")
        largest = others.abs().max(axis=None)
        title = f"{name}\n(found in the other storeys: at most {largest:.2g} N)"
        ax.set_title(title, fontsize="medium")
    save(figure, f"fig{number}_damper_force")


# %%
# The energy that it dissipates.
def draw_energy(forces, X, true, number):
    energy = {"true": true}
    for name, force in forces.items():
        energy[name] = cases.path_energy(force, X["s4"])
        print(f"{name}: {energy[name][-1]:.2f} J")
    save(EnergyDisplay(X.index, energy).plot().figure_, f"fig{number}_energy")


# %%
# The paper's way is a cubic for the frame with its damper, a linear model for the frame
# without it. Beside it the same data with a law that can hold the damper.
def draw(excitation):
    """All figures of one test."""
    number = NUMBERS[excitation]
    paper, paper_linear = RESULTS[excitation]
    test = cases.damped_frame(excitation, noise=0.002)
    bare_test = cases.damped_frame(excitation, noise=0.002, damper=None, random_state=1)
    X, F = test.measured.to_features()
    strategy = cases.paper_strategy(X, F)
    cubic = NRFRegressor(degree=3, strategy=strategy).fit(X, F)
    linear = NRFRegressor(degree=1, strategy=strategy)
    linear.fit(*bare_test.measured.to_features())
    dahl = {"storey 4": [laws.PowerSeries(1), laws.Dahl()]}
    hysteretic = NRFRegressor(degree=1, laws=dahl).fit(X, F)
    models = {
        "cubic": cubic,
        "linear, no damper": linear,
        "with Dahl law": hysteretic,
        "paper's cubic": paper.model(),
    }
    print(cases.total_mass(models, published.TOTAL_MASS).round(2))

    draw_record(test.measured, number["record"])
    draw_surfaces(cubic, paper, number["surfaces"])
    draw_planarity(cubic, X, F, excitation)
    fits = (cubic, hysteretic)
    draw_damper_force(fits, linear, X, test.damper[:, 3], number["force"])

    v, s = X["v4"], X["s4"]
    bare = linear.restoring_forces_[4](v, s)
    printed = published.force(paper.storeys[4], v, s)
    printed_bare = published.force(paper_linear.storeys[4], v, s)
    forces = {
        "cubic": cubic.restoring_force(X)[:, 3] - bare,
        "with Dahl law": hysteretic.restoring_force(X)[:, 3] - bare,
        f"paper's polynomial {paper.equations}": printed - printed_bare,
    }
    exact_drift = test.exact.to_features(smooth=False)[0]["s4"]
    true = cases.path_energy(test.damper[:, 3], exact_drift)
    print(f"true energy: {true[-1]:.2f} J")
    draw_energy(forces, X, true, number["energy"])

    # the linear frame and its modes, beside the spectrum of its test
    print(linear.model_, linear.modes().round(4), sep="\n")
    display = ModesDisplay.from_estimator(linear, bare_test.measured).plot()
    save(display.figure_, f"frame_modes_{excitation}")


# %%
for excitation, title in (
    ("complete", "all floors hit"),
    ("incomplete", "floor 3 hit"),
):
    print(title)
    draw(excitation)
