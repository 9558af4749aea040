"""
Stiffness over many earthquakes
===============================

A steel frame on a shaking table under rising motions, and a hotel in 21 earthquakes.
The stiffness of the largest cycle of each test, with its 95 % interval, follows without
any law from the force of the storey, for unit floor masses. It falls with the
amplitude: whether it also changed within a test is what ``varying="auto"`` is asked.

Run: ``PYSINDY_NRF_DATA=... python plot_time_varying_measured.py [folder]``
"""

import os
import sys
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import measured_sets
import numpy as np
import pandas as pd

from pysindy_nrf import NRFRegressor, Record, monitoring
from pysindy_nrf.exceptions import NRFWarning

FRAME_TESTS = ("fbgm162s1", "fbgm162s3", "fbgm162s5", "fbgm152s3", "fbgm152s4")
EVENTS = range(1, 22)
COLORS = ("tab:blue", "tab:red", "tab:green")
SHOWN = ["amplitude", "stiffness", "stiffness_lower", "stiffness_upper"]


def unit_masses(record: Record) -> dict[int, float]:
    """A mass of one for every floor."""
    return dict.fromkeys(range(1, record.n_dof + 1), 1.0)


def largest_cycles(record: Record) -> pd.DataFrame:
    """Amplitude (m) and stiffness over floor mass (1/s^2) of the largest cycles."""
    cycles = monitoring.storey_cycles(record, unit_masses(record)).table
    largest = cycles.loc[cycles.groupby("storey")["amplitude"].idxmax()]
    return largest.set_index("storey")[SHOWN].assign(test=record.name)


def within_test(record: Record) -> pd.Series:
    """What each storey's stiffness does within a test."""
    masses = unit_masses(record)
    model = NRFRegressor(degree=1, known_masses=masses, varying="auto")
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        changes = model.fit(record).time_variation_.changes
    return changes[changes["term"] == "s"].set_index("site")["kind"]


def draw(ax: plt.Axes, tables: list[pd.DataFrame], names: list[str]) -> None:
    """Stiffness over the tests with intervals, a line for each storey."""
    place = np.arange(len(tables))
    for color, storey in zip(COLORS, tables[0].index):
        rows = pd.DataFrame([table.loc[storey] for table in tables])
        value = rows["stiffness"].to_numpy(float)
        ends = rows[["stiffness_lower", "stiffness_upper"]].to_numpy(float)
        ax.plot(place, value, "o-", color=color, ms=3, label=storey)
        ax.fill_between(place, *ends.T, color=color, alpha=0.2, lw=0)
    ax.set_xticks(place, names, rotation=45, ha="right", fontsize=7)
    ax.set_ylim(bottom=0)
    ax.set_ylabel("stiffness over floor mass (1/s$^2$)")
    ax.legend(fontsize=8)


def main(folder: Path) -> None:
    """Print both tables and draw the figure."""
    folder.mkdir(parents=True, exist_ok=True)
    frame = []
    for test in FRAME_TESTS:
        record = measured_sets.load_nees_three_storey(test)
        table = largest_cycles(record)
        frame.append(table.assign(within=within_test(record)))
    hotel = []
    for event in EVENTS:
        record = measured_sets.load_six_storey_hotel(event)
        hotel.append(largest_cycles(record).loc[["storey 2"]])
    for tables in (frame, hotel):
        print(pd.concat(tables).round(4).to_string())

    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    draw(axes[0], frame, list(FRAME_TESTS))
    axes[0].set_title("steel frame on a shaking table")
    draw(axes[1], hotel, list(map(str, EVENTS)))
    axes[1].set_title("hotel, between its two instrumented floors")
    axes[1].set_xlabel("earthquake")
    figure.savefig(folder / "time_varying_measured.png", dpi=110)


if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output"))
