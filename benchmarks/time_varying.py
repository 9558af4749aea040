"""Structures that change while they shake: what, where, when, and how sure?

    python benchmarks/time_varying.py [--quick] [--seed 85] [--out FOLDER]

60 simulated chains of 2 to 6 floors in which the stiffness of one storey ramps, steps,
or is lost and recovers, friction wears, or Bouc-Wen hysteresis degrades, under random
forces or an earthquake, with noise of 0, 1 or 5 % of the rms of each channel; 60 linear
chains that do not change; and 40 with a cubic spring, Bouc-Wen hysteresis or friction
that do not change either, under an earthquake with a pulse. ``varying="auto"`` is told
nothing but the laws of linear storeys (and the friction that wears), and the masses
under an earthquake. ``--quick`` takes eight chains.

No constant was chosen on the seed that is reported, 85; the development used 7000,
8000, 65, 66, 83 and 84.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import search_path
import numpy as np
import pandas as pd
from harness import options_of, quietly, write_csv
from time_varying_cases import (
    FS,
    Case,
    amplitude_case,
    changing_case,
    constant_case,
)

from pysindy_nrf import NRFRegressor
from pysindy_nrf.identification.time_variation import TimeVariation

SEED = 85
Draw = Callable[[int, int], Case]
# What is drawn, how many, and which of them are quick.
GROUPS: dict[str, tuple[Draw, int, tuple[int, ...]]] = {
    "changing": (changing_case, 60, (6, 15, 21, 26)),
    "constant": (constant_case, 60, (1, 5)),
    "amplitude": (amplitude_case, 40, (3, 4)),
}


def followed(case: Case) -> tuple[TimeVariation, float, float]:
    """Courses, and the times of the constant and of the varying fit, s."""
    settings: dict[str, Any] = {
        "degree": 1,
        "laws": case.declared or None,
        "known_masses": case.known_masses,
    }
    began = process_time()
    quietly(NRFRegressor(**settings).fit, case.record)
    constant = process_time() - began
    began = process_time()
    model = quietly(NRFRegressor(**settings, varying="auto").fit, case.record)
    return model.time_variation_, constant, process_time() - began


def row_of(group: str, number: int, seed: int) -> dict[str, Any]:
    """What is found of one chain."""
    case = GROUPS[group][0](number, seed)
    variation, constant, varying = followed(case)
    wanted = [f"storey {case.storey}"] if case.storey else []
    kinds = variation.changes[variation.changes["kind"] != "constant"]
    row = {
        "group": group,
        "number": number,
        "kind": case.kind,
        "noise": case.noise,
        "wanted": ", ".join(wanted),
        "found": ", ".join(variation.changing),
        "right": variation.changing == wanted,
        "said": "; ".join(f"{r.site} {r.term}: {r.kind}" for r in kinds.itertuples()),
        "cost": varying / constant,
        "about": case.about,
    }
    if case.truth is not None:
        row |= accuracy(case, variation)
    if case.instants:
        row |= {"instant (periods)": error_of_instant(case, variation)}
    return row


def accuracy(case: Case, variation: TimeVariation) -> dict[str, Any]:
    """Error of the course, percent NRMSE, and share of the truth in the band."""
    course = variation.course(f"storey {case.storey}", case.term)
    samples = np.arange(len(case.truth)) / FS
    truth = np.interp(course.index, samples, case.truth)
    error = course["value"] - truth
    inside = (course["lower"] <= truth) & (truth <= course["upper"])
    return {
        "error (%)": 100 * np.sqrt(np.mean(error**2) / np.mean(truth**2)),
        "covered (%)": 100 * inside.mean(),
    }


def error_of_instant(case: Case, variation: TimeVariation) -> float:
    """Distance of the nearest instant that was found, periods of the first mode."""
    times = variation.instants["t"].to_numpy(float)
    distances = np.abs(times - case.instants[0]) / case.period
    return float(distances.min(initial=np.inf))


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """What the issue asks for, and what was measured."""
    changing = rows[rows["group"] == "changing"]
    constant = rows[rows["group"] == "constant"]
    amplitude = rows[rows["group"] == "amplitude"]
    stiffness = changing[changing["kind"].isin(("ramp", "step", "loss and recovery"))]
    at_one = stiffness[stiffness["noise"] == 0.01]
    wear = changing[changing["kind"] == "wear"]
    steps = changing.dropna(subset="instant (periods)")
    measured = [
        ("right storey (%)", 100 * changing["right"].mean(), "at least 95"),
        ("stiffness at 1 % noise, worst (% NRMSE)", at_one["error (%)"].max(), "3"),
        ("stiffness at any noise, worst", stiffness["error (%)"].max(), ""),
        ("friction, median (% NRMSE)", wear["error (%)"].median(), ""),
        ("instants within half a period (%)", within_half(steps), ""),
        ("coverage of bands, stiffness (%)", stiffness["covered (%)"].mean(), "90-98"),
        ("coverage of bands, friction (%)", wear["covered (%)"].mean(), "90-98"),
        ("constant called changing (%)", 100 * (~constant["right"]).mean(), "2"),
        ("amplitude not called changing (%)", 100 * amplitude["right"].mean(), "95"),
        ("cost, median (constant fits)", rows["cost"].median(), "5"),
        ("cost, worst", rows["cost"].max(), "5"),
    ]
    return pd.DataFrame(measured, columns=["what", "measured", "asked"])


def within_half(steps: pd.DataFrame) -> float:
    """Share of sudden changes that are dated within half a period, percent."""
    return 100 * float((steps["instant (periods)"] <= 0.5).mean())


def main(arguments: list[str] | None = None) -> int:
    """Print the summary and the chains that went wrong."""
    parser = options_of(__doc__, quick="eight chains")
    parser.add_argument("--out", type=Path, help="folder for a CSV file of all chains")
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args(arguments)

    rows = []
    for group, (_, count, quick) in GROUPS.items():
        for number in quick if options.quick else range(count):
            rows.append(row_of(group, number, options.seed))
    table = pd.DataFrame(rows)
    print(summary(table).to_string(index=False, float_format="{:.3g}".format))
    print("\nOthers than these are right:")
    wrong = table[~table["right"]].drop(columns=["right", "cost"])
    print(wrong.to_string(index=False, float_format="{:.3g}".format))
    write_csv(table, options.out, "time_varying")
    return 0


if __name__ == "__main__":
    sys.exit(main())
