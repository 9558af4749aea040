"""
Stiffness over many earthquakes
===============================

A steel frame on a shaking table under rising motions, and a hotel in 21 earthquakes.
Each test is fitted by itself, linear storeys for unit floor masses; the bands are 95 %
intervals. Stiffness falls with the amplitude: whether it also changed within a test is
what ``varying="auto"`` is asked.

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

from pysindy_nrf import NRFRegressor, Record
from pysindy_nrf.exceptions import NRFWarning

FRAME_TESTS = ("fbgm162s1", "fbgm162s3", "fbgm162s5", "fbgm152s3", "fbgm152s4")
EVENTS = range(1, 22)
COLORS = ("tab:blue", "tab:red", "tab:green")


def stiffness_of(record: Record, changes: bool) -> pd.DataFrame:
    """Stiffness of each storey over the mass of a floor, with its interval, 1/s^2."""
    unit_masses = dict.fromkeys(range(1, record.n_dof + 1), 1.0)
    varying = "auto" if changes else None
    model = NRFRegressor(degree=1, known_masses=unit_masses, varying=varying)
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        model.fit(record)
        intervals = model.confidence_intervals().set_index("parameter")
    rows = intervals[intervals.index.str.endswith(": s")]
    table = rows.assign(test=record.name, error=model.errors_["error"]["pooled"])
    if changes:
        table_of_changes = model.time_variation_.changes
        stiffness = table_of_changes[table_of_changes["term"] == "s"]
        table["within the test"] = stiffness["kind"].to_numpy()
    return table


def draw(ax: plt.Axes, tables: list[pd.DataFrame], names: list[str]) -> None:
    """Stiffness over the tests with bands, a line for each storey."""
    place = np.arange(len(tables))
    for color, parameter in zip(COLORS, tables[0].index):
        rows = pd.DataFrame([table.loc[parameter] for table in tables])
        value = rows["estimate"].to_numpy(float)
        ends = rows[["lower", "upper"]].to_numpy(float)
        ax.plot(place, value, "o-", color=color, ms=3, label=parameter[:-3])
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
        frame.append(stiffness_of(record, changes=True))
    hotel = []
    for event in EVENTS:
        record = measured_sets.load_six_storey_hotel(event)
        hotel.append(stiffness_of(record, changes=False))
    for tables in (frame, hotel):
        print(pd.concat(tables).round(1).to_string())

    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    draw(axes[0], frame, list(FRAME_TESTS))
    axes[0].set_title("steel frame on a shaking table")
    draw(
        axes[1], [table.loc[["storey 2: s"]] for table in hotel], list(map(str, EVENTS))
    )
    axes[1].set_title("hotel, between its two instrumented floors")
    axes[1].set_xlabel("earthquake")
    figure.savefig(folder / "time_varying_measured.png", dpi=110)


if "PYSINDY_NRF_DATA" not in os.environ:
    sys.exit("Set PYSINDY_NRF_DATA to the folder of the measured records.")
if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "nrf_output"))
