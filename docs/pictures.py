"""Draws the pictures of the explanations and tutorials into ``docs/images``.

    python docs/pictures.py            # all; two minutes
    python docs/pictures.py noise      # one of them

Every number in a picture is computed here, or read from the tables of benchmarks.md.
"""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle

from pysindy_nrf import (
    ChainModel,
    HysteresisDisplay,
    IntervalsDisplay,
    ModesDisplay,
    NRFRegressor,
    Record,
    datasets,
    excitation,
    laws,
    monitoring,
    simulate,
)
from pysindy_nrf.simulation.noise import add_noise

DOCS = Path(__file__).resolve().parent
IMAGES = DOCS / "images"
BLUE, ORANGE, GREY = "#1f5fa8", "#c8641e", "0.45"

matplotlib.rcParams.update(
    {
        "svg.hashsalt": "pysindy_nrf",
        "font.size": 11,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "savefig.facecolor": "white",
    }
)


# -- structures and records ----------------------------------------------------


def four_floors() -> Record:
    """A free run of four equal floors, forced on floor 3, without noise."""
    storey = [laws.LinearElastic(1.4e5), laws.LinearViscous(25.0)]
    model = ChainModel([12.4] * 4, dict.fromkeys((1, 2, 3, 4), storey))
    F = excitation.band_limited_random(
        4, 8.0, 1000.0, excited=[3], rms=100.0, band=(0.5, 60), random_state=0
    )
    return simulate(model, F, 1e-3, hold="cubic")


def earthquake_record() -> Record:
    """The record of the tutorial on an earthquake."""
    ground = excitation.band_limited_random(
        1, 30.0, 200.0, excited=[1], rms=1.0, band=(0.3, 20), random_state=1
    )[:, 0]
    t = np.arange(len(ground)) / 200.0
    ground *= 2 * np.exp(-(((t - 10) / 6) ** 2))

    storeys = {}
    for j, k in enumerate((4.0e6, 3.6e6, 3.0e6), 1):
        storeys[j] = [laws.LinearElastic(k), laws.LinearViscous(0.004 * k)]
    truth = ChainModel([5200.0, 5000.0, 4300.0], storeys)

    clean = simulate(truth, None, 1 / 200, base_acceleration=ground)
    return add_noise(clean, 0.01, random_state=2).replace(velocity=None)


def rig_record() -> Record:
    """The record of the tutorial on an element."""
    t = np.arange(6000) / 200.0
    x = 0.02 * np.minimum(1, t / 20) * np.sin(np.pi * t)
    motion = laws.Motion(s=x, v=np.gradient(x, 1 / 200.0))
    spring = laws.LinearElastic(2e5).force(motion)
    slider = laws.Jenkins(uy=0.002, Fy=3e3).force(motion)
    noise = 20 * np.random.default_rng(1).standard_normal(6000)
    force = spring + slider + noise
    return Record(force=force[:, None], displacement=x[:, None], fs=200.0)


def frame_test(stiffness: float, random_state: int) -> Record:
    """A test of three floors whose second storey has a given stiffness, N/m."""
    storeys = {}
    for j, k in ((1, 1.4e5), (2, stiffness), (3, 1.4e5)):
        storeys[j] = [laws.LinearElastic(k), laws.LinearViscous(40.0)]
    model = ChainModel([12.0] * 3, storeys)
    F = excitation.band_limited_random(
        3, 12.0, 500.0, excited=3, rms=80.0, band=(1, 50), random_state=random_state
    )
    clean = simulate(model, F, 1 / 500, hold="cubic")
    return add_noise(clean, 0.01, random_state=random_state)


# -- the method ----------------------------------------------------------------


def spring_line(ax: Axes, x0: float, x1: float, y: float) -> None:
    """A spring between two places."""
    n_coils = 7
    ends = np.array([x0, x0 + 0.12 * (x1 - x0), x1 - 0.12 * (x1 - x0), x1])
    inner = np.linspace(ends[1], ends[2], 2 * n_coils)
    height = 0.09 * (-1.0) ** np.arange(2 * n_coils)
    x = np.concatenate([ends[:1], inner, ends[3:]])
    ax.plot(x, np.concatenate([[y], y + height, [y]]), color=GREY, linewidth=1.2)


def arrow(ax: Axes, start: tuple, end: tuple, color: str) -> None:
    """A force or a step."""
    style = {"arrowstyle": "-|>", "mutation_scale": 12, "linewidth": 1.6}
    ax.add_patch(FancyArrowPatch(start, end, color=color, **style))


def draw_chain(ax: Axes) -> None:
    """Three masses joined by storeys, with the force on the second."""
    ax.add_patch(Rectangle((-0.15, -0.5), 0.15, 1.0, color="0.7"))
    for j in (1, 2, 3):
        edge = 2.0 * j - 0.9
        ax.add_patch(Rectangle((edge, -0.3), 0.9, 0.6, color="#d6e2f0"))
        ax.text(edge + 0.45, 0, f"$m_{j}$", ha="center", va="center")
        spring_line(ax, edge - 1.1, edge, 0)
        ax.text(edge - 0.55, 0.2, f"$R_{j}(v_{j}, s_{j})$", ha="center")
        ax.text(edge + 0.45, -0.5, f"$a_{j}$", ha="center", va="center", color=GREY)
    arrow(ax, (3.2, 0.75), (3.9, 0.75), ORANGE)
    ax.text(3.1, 0.75, "$F_2$", ha="right", va="center", color=ORANGE)
    ax.set(xlim=(-0.3, 6.2), ylim=(-0.8, 1.1), title="A chain, forced on DOF 2")


def draw_solve_order(ax: Axes) -> None:
    """Which equation gives which mass and storeys, in which order."""
    steps = (
        (3.55, "1. equation of DOF 2\n$m_2$, $R_2$, $R_3$"),
        (5.55, "2. equation of DOF 3\n$m_3$ from $R_3$"),
        (1.55, "3. equation of DOF 1\n$m_1$, $R_1$ from $R_2$"),
    )
    for x, text in steps:
        ax.text(x, 0, text, ha="center", va="center", fontsize=10)
    arrow(ax, (4.35, 0), (4.8, 0), BLUE)
    arrow(ax, (2.8, 0), (2.3, 0), BLUE)
    ax.set(xlim=(-0.3, 6.2), ylim=(-0.5, 0.5))
    ax.set_title("The order in which a single force identifies it")


def method() -> Figure:
    """A chain with its forces, and the order of the solution."""
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    chain, order = figure.subplots(2, 1, height_ratios=(2, 1.1))
    draw_chain(chain)
    draw_solve_order(order)
    for ax in (chain, order):
        ax.set_axis_off()
    return figure


# -- noise ---------------------------------------------------------------------


def worst_mass_errors(record: Record) -> dict[str, float]:
    """Largest error of a mass by three estimates, percent."""
    raw = NRFRegressor(degree=1, estimation="ls")
    raw.fit(*record.to_features(smooth=False))
    models = {"least squares, raw channels": raw}
    for name, estimation in (
        ("least squares, fused motion", "ls"),
        ("instruments (iv)", "iv"),
    ):
        models[name] = NRFRegressor(degree=1, estimation=estimation).fit(record)
    return {
        name: 100 * float(np.abs(model.masses_ / 12.4 - 1).max())
        for name, model in models.items()
    }


def noise() -> Figure:
    """Errors of masses by noise level, and a fused motion."""
    clean = four_floors()
    levels = np.array([0.005, 0.01, 0.02, 0.05, 0.1])
    errors = [worst_mass_errors(add_noise(clean, x, random_state=0)) for x in levels]

    figure = Figure(figsize=(8.4, 3.7), layout="constrained")
    first, second = figure.subplots(1, 2)
    for name, color in zip(errors[0], ("0.2", ORANGE, BLUE)):
        values = [error[name] for error in errors]
        first.loglog(100 * levels, values, "o-", color=color, label=name)
    first.set(xlabel="noise of every channel (% of its rms)")
    first.set(ylabel="error of the worst mass (%)", ylim=(1e-2, 1e3))
    first.set_xticks(100 * levels, [f"{100 * x:g}" for x in levels])
    first.minorticks_off()
    first.legend(frameon=False, fontsize=9, loc="upper left")

    noisy = add_noise(clean, 0.1, random_state=0)
    window = slice(4000, 4060)
    time = noisy.time[window]
    fused = noisy.to_features()[0]["a1"].to_numpy()[window]
    second.plot(
        time, noisy.acceleration[window, 0], ".", color=ORANGE, label="measured"
    )
    second.plot(time, fused, color=BLUE, label="fused")
    second.plot(time, clean.acceleration[window, 0], ":", color="0.2", label="true")
    second.set(xlabel="time (s)", ylabel="acceleration of floor 1 (m/s²)")
    second.legend(
        frameon=False, fontsize=9, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1)
    )
    return figure


# -- what a test cannot show ---------------------------------------------------


def force_with_interval(ax: Axes) -> None:
    """The force of a cubic storey, inside and outside the visited drifts."""
    storeys = {1: [laws.LinearViscous(60.0), laws.Duffing(k=1e5, k3=2e10)]}
    F = excitation.band_limited_random(
        1, 10.0, 500.0, excited=1, rms=60.0, band=(1, 40), random_state=3
    )
    clean = simulate(ChainModel([10.0], storeys), F, 1 / 500, hold="cubic")
    record = add_noise(clean, 0.02, random_state=3)
    model = NRFRegressor(degree=3).fit(record)

    visited = 1e3 * np.abs(clean.displacement).max()
    drift = np.linspace(-2.5 * visited, 2.5 * visited, 81)
    points = np.zeros_like(drift), drift / 1e3
    rows = model.confidence_intervals(of={"storey 1": points})
    truth = 1e5 * drift / 1e3 + 2e10 * (drift / 1e3) ** 3
    ax.axvspan(-visited, visited, color="0.93", label="visited drifts")
    ax.fill_between(drift, rows["lower"], rows["upper"], color=BLUE, alpha=0.3)
    ax.plot(drift, rows["estimate"], color=BLUE, label="identified, 95 % interval")
    ax.plot(drift, truth, ":", color="0.2", label="true")
    ax.set(xlabel="drift (mm)", ylabel="force at rate zero (N)")
    ax.legend(frameon=False, fontsize=9, loc="upper left")


def mass_by_band(ax: Axes) -> None:
    """A mass, 12.4 kg, and its interval by the highest excited frequency."""
    storey = [laws.LinearElastic(1.4e5), laws.LinearViscous(25.0)]
    model = ChainModel([12.4] * 3, dict.fromkeys((1, 2, 3), storey))
    rows = {}
    for highest in (8.0, 12.0, 18.0, 26.0, 35.0):
        F = excitation.band_limited_random(
            3, 16.0, 500.0, excited=3, rms=100.0, band=(3, highest), random_state=0
        )
        record = add_noise(simulate(model, F, 1 / 500, hold="cubic"), 0.01, 0)
        fit = NRFRegressor(degree=1, estimation="iv").fit(record)
        intervals = fit.confidence_intervals().set_index("parameter")
        rows[highest] = intervals.loc["m1"]

    table = pd.DataFrame(rows).T
    with_answer = table.dropna()
    withheld = table[table["lower"].isna()]
    ends = np.abs(with_answer[["lower", "upper"]].T - with_answer["estimate"])
    bars = {"fmt": "o", "color": BLUE, "capsize": 4, "label": "with 95 % interval"}
    ax.errorbar(with_answer.index, with_answer["estimate"], ends, **bars)
    open_marks = {"mfc": "white", "color": ORANGE, "label": "interval withheld"}
    ax.plot(withheld.index, withheld["estimate"], "o", **open_marks)
    ax.axhline(12.4, color="0.2", linestyle=":")
    for number, mode in enumerate(model.modes()["frequency"], 1):
        ax.axvline(mode, color="0.8", linewidth=1, zorder=0)
        place = ax.get_xaxis_transform()
        ax.text(mode, 1.0, f"mode {number}", transform=place, fontsize=9)
    ax.set(xlabel="highest excited frequency (Hz)", ylabel="mass 1 (kg)")
    ax.legend(frameon=False, fontsize=9, loc="upper right")


def what_a_test_cannot_show() -> Figure:
    """Extrapolation and narrow excitation."""
    figure = Figure(figsize=(8.4, 3.7), layout="constrained")
    first, second = figure.subplots(1, 2)
    force_with_interval(first)
    mass_by_band(second)
    return figure


# -- the paper ------------------------------------------------------------------


def paper() -> Figure:
    """The force of the paper's damper: true, by the power series, by Dahl's law."""
    sys.path.insert(0, str(DOCS.parent / "examples"))
    import paper_cases

    case = paper_cases.two_dof("complete", 0.0)
    X, F = case.measured.to_features(smooth=False)
    bare = case.bare.restoring_forces[1](X["v1"], X["s1"])
    dahl = {1: [laws.PowerSeries(1), laws.Dahl()], 2: [laws.PowerSeries(1)]}
    models = {
        "power series": NRFRegressor(degree=3, strategy="complete"),
        "Dahl's law": NRFRegressor(laws=dahl, strategy="complete"),
    }
    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    window = slice(-1500, None)
    rate = X["v1"].to_numpy()[window]
    for ax, (name, regressor) in zip(axes, models.items()):
        force = regressor.fit(X, F).restoring_force(X)[:, 0] - np.ravel(bare)
        ax.plot(rate, case.damper[window, 0], ".", markersize=3, color="0.6")
        ax.plot(rate, force[window], ".", markersize=1.5, color=BLUE)
        ax.set(title=f"{name} (blue), true (grey)", xlabel="rate of storey 1 (m/s)")
    axes[0].set(ylabel="force of the damper (N)")
    return figure


# -- time, damage --------------------------------------------------------------


def performance() -> Figure:
    """Processor time of the loop, from the table of benchmarks.md."""
    page = (DOCS / "benchmarks.md").read_text("utf-8")
    row = r"^\| close_loop \| (\d+) \| ([\d,]+) \| \d+ \| ([\d.]+) \|"
    times: dict[int, list[tuple[int, float]]] = {}
    for n_dof, samples, seconds in re.findall(row, page, re.MULTILINE):
        point = int(samples.replace(",", "")), float(seconds)
        times.setdefault(int(n_dof), []).append(point)

    figure = Figure(figsize=(5.6, 3.3), layout="constrained")
    ax = figure.subplots()
    for (n_dof, points), color in zip(times.items(), (BLUE, ORANGE, "0.2")):
        ax.loglog(*np.transpose(points), "o-", color=color, label=f"{n_dof} floors")
    ax.set(xlabel="samples", ylabel="processor time of close_loop (s)", ylim=(1, 100))
    ax.legend(frameon=False)
    return figure


def damage() -> Figure:
    """The change that is found after storey 2 lost 5 % of its stiffness."""
    before, after = frame_test(1.4e5, 1), frame_test(0.95 * 1.4e5, 2)
    report = monitoring.compare_tests(NRFRegressor(degree=1), before, after)

    figure = Figure(figsize=(8.4, 3.4), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    maps = [report.map(storey) for storey in (1, 2, 3)]
    largest = max(table["change"].abs().max() for table in maps)
    for storey, (ax, table) in enumerate(zip(axes, maps), 1):
        drift, rate = 1e3 * table["s"], table["v"]
        colours = {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}
        points = ax.scatter(drift, rate, c=table["change"], s=14, marker="s", **colours)
        ax.set(title=f"storey {storey}", xlabel="drift (mm)")
    axes[0].set(ylabel="rate (m/s)")
    figure.colorbar(points, ax=axes, label="change of the force (N)")
    return figure


# -- tutorials -----------------------------------------------------------------


def displays() -> Figure:
    """Three displays of the fit to the bundled record, on given axes."""
    sheet = Figure(figsize=(14.0, 4.2), layout="constrained")
    left, middle, right = sheet.subplots(1, 3)
    linear = [laws.LinearViscous(), laws.LinearElastic()]
    declared = {
        "storey 1": [laws.LinearViscous(), laws.Duffing()],
        "storey 2": linear,
        "storey 3": linear,
    }
    model = NRFRegressor(laws=declared).fit(datasets.load_demo())
    HysteresisDisplay.from_estimator(model, storey=1, ax=left)
    IntervalsDisplay.from_estimator(model, ax=middle)
    ModesDisplay.from_estimator(model, ax=right)
    return sheet


def drawing_of(model: NRFRegressor) -> Figure:
    """What ``model.plot()`` draws."""
    return model.plot().figure_


def shaker_test() -> Figure:
    """The model of the tutorial on a shaker test."""
    storey = {"storey 1": [laws.LinearViscous(), laws.Duffing()]}
    return drawing_of(NRFRegressor(degree=1, laws=storey).fit(datasets.load_demo()))


def earthquake() -> Figure:
    """The model of the tutorial on an earthquake."""
    regressor = NRFRegressor(degree=1, known_masses={3: 4300.0})
    return drawing_of(regressor.fit(earthquake_record()))


def element_on_a_rig() -> Figure:
    """Measured loops of an element, and the identified law."""
    rig = rig_record()
    law = {1: [laws.LinearElastic(), laws.Jenkins()]}
    model = NRFRegressor(laws=law, massless=True).fit(rig)
    X, _ = rig.to_features()
    force = model.restoring_force(X)[:, 0]
    drift = 1e3 * rig.displacement[:, 0]

    figure = Figure(figsize=(5.6, 3.3), layout="constrained")
    ax = figure.subplots()
    measured = rig.force[:, 0] / 1e3
    ax.plot(drift, measured, ".", markersize=2, color=ORANGE, label="measured")
    ax.plot(drift, force / 1e3, color=BLUE, linewidth=0.8, label="identified")
    ax.set(xlabel="displacement (mm)", ylabel="force (kN)")
    ax.legend(frameon=False)
    return figure


PICTURES: dict[str, tuple[Callable[[], Figure], str]] = {
    "method": (method, "svg"),
    "noise": (noise, "svg"),
    "what_a_test_cannot_show": (what_a_test_cannot_show, "svg"),
    "paper": (paper, "png"),
    "displays": (displays, "png"),
    "performance": (performance, "svg"),
    "damage": (damage, "png"),
    "shaker_test": (shaker_test, "png"),
    "earthquake": (earthquake, "png"),
    "element_on_a_rig": (element_on_a_rig, "png"),
}


def main() -> int:
    """Draw the pictures that are named, or all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", choices=[*PICTURES, []], default=[])
    options = parser.parse_args()
    for name in options.names or PICTURES:
        draw, kind = PICTURES[name]
        with warnings.catch_warnings(action="ignore"):
            figure = draw()
        undated = {"metadata": {"Date": None}} if kind == "svg" else {"dpi": 80}
        figure.savefig(IMAGES / f"{name}.{kind}", **undated)
    return 0


if __name__ == "__main__":
    sys.exit(main())
