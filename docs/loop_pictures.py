"""Draw the pictures of closing_the_loop.md: python docs/loop_pictures.py"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from pysindy_nrf import ChainModel, StepsDisplay, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

IMAGES = Path(__file__).parent / "images"
# Two cycles of a sine of 10 mm.
PHASE = np.linspace(0.0, 4.0 * np.pi, 2000)
MOTION = laws.Motion(0.01 * np.sin(PHASE), 0.0628 * np.cos(PHASE), t=PHASE / 6.28)
LAST_CYCLE = slice(1000, None)

CURVES = {
    "hinge": [("hinge", 0.0025, 1.0), ("hinge", 0.0065, -1.0)],
    "sign": [("sign", 0.02, 0.0), ("sign", 0.02, 1.0), ("sign", 0.02, -1.0)],
    "wedge": [("wedge", 0.005, 0.0)],
    "knee": [("knee", 0.03, 0.0)],
    "drift rate": [("drift rate",)],
}
LOOPS = {
    "slider": [("slider", 0.0, 0.001, 0.0), ("slider", 0.0, 0.004, 0.0)],
    "slider behind a backlash": [("slider", 0.003, 0.001, 0.0)],
    "one direction": [("slider", 0.003, 0.001, 1.0), ("slider", 0.003, 0.001, -1.0)],
    "pinched": [("pinched", 0.001, 0.002)],
    "branch": [("branch", 0.2), ("branch", 1.0)],
}


def draw_atoms(kind, groups, name):
    """Each group of atoms over the drift, one panel a group."""
    figure, axes = plt.subplots(1, len(groups), figsize=(11, 2.3))
    for ax, (title, atoms) in zip(axes, groups.items()):
        for atom in atoms:
            force = kind([atom], [1.0]).force(MOTION)[LAST_CYCLE]
            ax.plot(1e3 * MOTION.s[LAST_CYCLE], force / np.abs(force).max())
        ax.set_title(title, fontsize=9)
        ax.set_xlabel("drift, mm", fontsize=8)
        ax.tick_params(labelsize=7)
    save(figure, name)


def draw_two_strengths():
    """A loop of two strengths, and the two atoms that write it."""
    atoms = [("slider", 0.001, 0.0005, 1.0), ("slider", 0.001, 0.0005, -1.0)]
    force = laws.GeneralHysteresis(atoms, [900.0, 1500.0]).force(MOTION)
    rng = np.random.default_rng(0)
    figure, ax = plt.subplots(figsize=(4.5, 3))
    measured = force + 30.0 * rng.standard_normal(len(force))
    ax.plot(1e3 * MOTION.s, measured, ".", ms=2, color="0.7", label="measured")
    ax.plot(1e3 * MOTION.s[LAST_CYCLE], force[LAST_CYCLE], label="two sliders")
    ax.set_xlabel("drift, mm")
    ax.set_ylabel("force, N")
    ax.legend(fontsize=8)
    save(figure, "loop_two_strengths.png")


def draw_amplitude():
    """The quarters of the amplitude, and which judge which."""
    t = np.linspace(0.0, 10.0, 3000)
    drift = np.sin(2 * np.pi * t) * (0.4 + 0.6 * np.sin(0.3 * t) ** 2)
    quarter = np.searchsorted(np.quantile(np.abs(drift), [0.25, 0.5, 0.75]), abs(drift))
    figure, axes = plt.subplots(1, 2, figsize=(9, 2.5), sharey=True)
    titles = ("lower three fitted, upper one judged", "upper half fitted, lower judged")
    for ax, title, judged in zip(axes, titles, ([3], [0, 1])):
        chosen = np.isin(quarter, judged)
        ax.plot(t, np.where(chosen, np.nan, drift), color="0.6", label="fitted")
        ax.plot(t, np.where(chosen, drift, np.nan), color="C3", label="judged")
        ax.set_title(title, fontsize=9)
        ax.set_xlabel("time, s")
        ax.legend(fontsize=7)
    axes[0].set_ylabel("drift at the site")
    save(figure, "loop_amplitude.png")


def draw_steps():
    """Held-out errors of a loop that finds a gap and friction."""
    linear = [laws.LinearElastic(2e5), laws.LinearViscous(80.0)]
    gap = laws.OneSidedGap(gap=5e-4, k=2e5)
    friction = laws.RegularizedFriction(v0=0.005, Fc=6.0)
    storeys = {1: [*linear, gap], 2: linear, 3: [*linear, friction]}
    truth = ChainModel([12.0] * 3, storeys)
    F = excitation.band_limited_random(
        3, 20.0, 500.0, excited=3, rms=60.0, band=(0.5, 40.0), random_state=1
    )
    record = add_noise(simulate(truth, F, 1 / 500), 0.01, random_state=0)
    figure, ax = plt.subplots(figsize=(6, 3))
    StepsDisplay.from_report(close_loop(record), ax=ax)
    save(figure, "loop_steps.png")


def save(figure, name):
    """Write a figure among the images of the documentation."""
    figure.tight_layout()
    figure.savefig(IMAGES / name, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    draw_atoms(laws.GeneralCurve, CURVES, "loop_curves.png")
    draw_atoms(laws.GeneralHysteresis, LOOPS, "loop_loops.png")
    draw_two_strengths()
    draw_amplitude()
    draw_steps()
