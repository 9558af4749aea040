"""Computes every number of the paper, and draws its figure.

    python paper/make.py            # prints the table, draws paper/figure.png
    python paper/make.py --write    # also puts the table into paper/paper.md

The measured row needs the folder of measured records that PYSINDY_NRF_DATA names.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    compare_with_sindy,
    datasets,
    excitation,
    io,
    laws,
    simulate,
)
from pysindy_nrf.simulation.noise import add_noise

PAPER = Path(__file__).resolve().parent
BEGIN, END = "<!-- numbers of make.py -->", "<!-- end of the numbers -->"
HEAD = "| test | quantity | reference | identified |\n|---|---|---|---|"
DEMO_MASSES = (12.0, 10.0, 8.0)  # kg, of the bundled record
DEMO_CUBIC = 1.5e9  # N/m^3
EMPS_FRICTION = 20.39  # N, Janot, Gautier and Brunot (2019)

Row = tuple[str, str, str, str]


def frame(damper: bool) -> ChainModel:
    """Two floors of 10 kg; a friction damper in the lower storey on request."""
    storey = laws.PowerSeries(1, [100.0, 1e5])
    lower = [storey, laws.Dahl(sigma=5e4, Fd=34.85)] if damper else [storey]
    return ChainModel([10.0, 10.0], {1: lower, 2: storey})


def frame_test(model: ChainModel, excited: list[int]) -> Record:
    """A test of 20 s at 1 kHz with 1 % noise on every channel."""
    F = excitation.band_limited_random(
        2, 20.0, 1000.0, excited=excited, rms=200.0, band=(0.5, 60), random_state=0
    )
    clean = simulate(model, F, 1e-3, hold="cubic")
    return add_noise(clean, 0.01, random_state=0)


# -- rows of the table ---------------------------------------------------------


def bundled_rows() -> list[Row]:
    """The bundled frame: one shaker, one undeclared law."""
    record = datasets.load_demo()
    report = close_loop(record)
    step = report.steps[0]
    low, high = (f"{x:.4g}" for x in step.intervals["k3"])
    cubic = f"{step.law.replace('_', ' ')} in {step.site}, {low} to {high} N/m³"

    law = {1: [laws.LinearViscous(), laws.Duffing()]}
    model = NRFRegressor(degree=1, laws=law).fit(record)
    masses = ", ".join(f"{mass:.2f}" for mass in model.masses_)
    true_masses = ", ".join(f"{mass:g}" for mass in DEMO_MASSES)
    name = "frame of 3 floors, force on floor 2, 2 % noise"
    return [
        (name, "masses (kg)", true_masses, masses),
        (name, "undeclared law", f"cubic stiffness, {DEMO_CUBIC:.3g} N/m³", cubic),
    ]


def incomplete_rows() -> list[Row]:
    """Plain SINDy and this package where one of two floors is forced."""
    linear = frame(damper=False)
    table = compare_with_sindy(frame_test(linear, [2]), truth=linear, degree=1)
    on_states = table.filter(regex="^SINDy, (?!storey shears)", axis=0)
    n_found = int(on_states["mass_error"].notna().sum())
    error = table.loc["pysindy_nrf, instrumental variables", "mass_error"]

    name = "frame of 2 floors, force on floor 2, 1 % noise"
    sindy = f"found in {n_found} of {len(on_states)} settings"
    return [
        (name, "masses by SINDy on states", "10, 10 kg", sindy),
        (name, "masses by this package", "10, 10 kg", f"within {error:.2f} %"),
    ]


def friction_rows() -> list[Row]:
    """A friction damper: a power series has no memory, Dahl's law has."""
    record = frame_test(frame(damper=True), [2])
    series = NRFRegressor(degree=3).fit(record)
    law = {1: [laws.PowerSeries(1), laws.Dahl()], 2: [laws.PowerSeries(1)]}
    dahl = NRFRegressor(laws=law).fit(record)
    force = dahl.restoring_forces_[1].coefficients["Z"]

    name = "the same with a friction damper"
    return [
        (name, "mass 1, power series", "10 kg", f"{series.masses_[0]:.2f} kg"),
        (name, "mass 1, Dahl's law", "10 kg", f"{dahl.masses_[0]:.2f} kg"),
        (name, "friction, Dahl's law", "34.85 N", f"{force:.1f} N"),
    ]


def measured_rows() -> list[Row]:
    """The friction of a measured positioning stage."""
    path = Path(os.environ["PYSINDY_NRF_DATA"]) / "emps" / "DATA_EMPS.mat"
    mapping = {"t": "t", "x1": "qm", "F1": "vir*gtau"}
    record = io.read_record(path, mapping=mapping, name="EMPS")
    report = close_loop(record, NRFRegressor(degree=1))
    effect = report.verdict.sentence.split(" in storey")[0]
    step = report.steps[0]
    errors = f"balance error {step.error_before:.1f} to {step.error_after:.1f} %"
    found = f"{effect}; {errors}"
    reference = f"Coulomb friction, {EMPS_FRICTION:.1f} N"
    return [("EMPS positioning stage, measured", "undeclared law", reference, found)]


def table() -> str:
    """All rows as Markdown."""
    rows = [*bundled_rows(), *incomplete_rows(), *friction_rows()]
    if "PYSINDY_NRF_DATA" in os.environ:
        rows += measured_rows()
    return "\n".join([HEAD, *(f"| {' | '.join(row)} |" for row in rows)])


# -- the figure ----------------------------------------------------------------


def figure() -> Figure:
    """The bundled frame before and after the loop: storey 1 and the free run."""
    record = datasets.load_demo()
    report = close_loop(record)
    X, _ = record.to_features()
    drift = X["s1"].to_numpy()
    order = np.argsort(drift)
    models = {"declared (linear)": report.models[0], "after the loop": report.model}

    drawing = Figure(figsize=(8.0, 3.0), layout="constrained")
    left, right = drawing.subplots(1, 2, width_ratios=(1, 1.5))
    window = slice(600, 1000)
    time = record.time[window]
    measured = 1e3 * record.displacement[window, 0]
    right.plot(time, measured, color="0.6", linewidth=3, label="measured")
    for (name, model), color in zip(models.items(), ("#c8641e", "#1f5fa8")):
        force = model.restoring_forces[1](X["v1"], X["s1"])
        left.plot(1e3 * drift[order], np.ravel(force)[order], ".", ms=2, color=color)
        run = simulate(model, record.force, record.dt)
        motion = 1e3 * run.displacement[window, 0]
        right.plot(time, motion, color=color, linewidth=1, label=name)
    left.set(xlabel="drift of storey 1 (mm)", ylabel="force of storey 1 (N)")
    right.set(xlabel="time (s)", ylabel="displacement of floor 1 (mm)")
    right.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1))
    return drawing


def main() -> int:
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="into paper.md")
    options = parser.parse_args()
    with warnings.catch_warnings(action="ignore"):
        numbers = table()
        figure().savefig(PAPER / "figure.png", dpi=200)
    print(numbers)
    if options.write:
        page = PAPER / "paper.md"
        before, rest = page.read_text("utf-8").split(BEGIN)
        after = rest.split(END)[1]
        page.write_text(f"{before}{BEGIN}\n\n{numbers}\n\n{END}{after}", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
