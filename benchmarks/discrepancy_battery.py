"""Blind battery for ``close_loop``: the right effect at the right site, or nothing?

    python benchmarks/discrepancy_battery.py --quick
    python benchmarks/discrepancy_battery.py         # everything: hours on two cores
    python benchmarks/discrepancy_battery.py --group blind --noise 0.05 --cases 40
    python benchmarks/discrepancy_battery.py --group three acceleration --seed 7

Cases are drawn and simulated by formulas and an integrator of their own
(battery/formulas.py); the loop is given the noisy channels (F of the forced DOFs, a, v,
x of all; under base excitation ag, vg, xg and the masses; in the group "acceleration"
one force and the accelerations) and the declared baseline, nothing else. An answer is
what held-out data confirm. All rows are written to a CSV file; failures are printed one
per row.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import search_path
import numpy as np
import pandas as pd
from battery.generators import KINDS, effect_cycle, make_case
from battery.ordinary import make_ordinary_case
from battery.scorer import FAMILY, run_case
from battery.sensors import FAULTS
from harness import options_of
from joblib import Parallel, delayed
from tqdm import tqdm

# Three in five at 5 %: there few effects stand out of the noise far enough to be
# eligible.
BLIND_NOISE = (0.0, 0.05, 0.01, 0.05, 0.05)
NOTHING_NOISE = (0.0, 0.01, 0.02, 0.05, 0.10)
# Cases of each group.
SIZES = {
    "base": 66,
    "blind": 360,
    "nothing": 400,
    "two": 60,
    "withheld": 60,
    "three": 40,
    "acceleration": 60,
    "sensors": 200,
    "every": 40,
    "ordinary": 200,
}
QUICK = {"base": 1, "blind": 3, "nothing": 1, "withheld": 1, "sensors": 1}
# Short records of small chains.
SMALL = {"n_samples": 4096, "largest": 3}
# Kinds that every storey may have.
EVERY = (
    "coulomb",
    "cubic",
    "bouc_wen",
    "quadratic_damping",
    "two_sided_gap",
    "jenkins",
    "power_damping",
    "quadratic",
)
# Effects at once.
NUMBER = {"two": 2, "three": 3}
# Effects of the group "ordinary"; where there is none nothing is to be found.
ORDINARY = (
    "coulomb",
    "cubic",
    "",
    "bouc_wen",
    "quadratic_damping",
    "two_sided_gap",
    "brace",
    "jenkins",
    "",
    "stiffness_step",
    "asymmetric_friction",
    "maxwell",
    "one_sided_gap",
    "dahl",
    "ground_friction",
    "harmonic",
    "power_damping",
)
LEAST_MASSES = {**NUMBER, "every": 4}
# Groups of one effect each.
SINGLE = ("blind", "base", "acceleration")
# Right answers in percent, by noise.
TARGET = {0.0: 97.0, 0.01: 97.0, 0.05: 90.0}
TARGET_ACCELERATION = 90.0
SURE_RIGHT, RIGHT_SURE = 98.0, 50.0


# -- what to draw --------------------------------------------------------------


def specifications(
    group: str, count: int, seed: int, noise: float | None = None, **size: int
) -> list[dict]:
    """Arguments of ``make_case`` for the cases of one group.

    Kinds are dealt in turn, and each meets each noise level in turn; ``noise`` is one
    level for all.
    """
    rng = np.random.default_rng([seed, len(group), ord(group[0])])
    first = seed * 100_000 + 1000 * list(SIZES).index(group)
    out = []
    for i in range(count):
        spec = {"name": f"{group} {i}", "group": group, "seed": first + i, **size}
        spec |= details(rng, group, i)
        if noise is not None:
            spec["noise"] = noise
        if "largest" in size:
            spec["largest"] = max(size["largest"], LEAST_MASSES.get(group, 1))
        out.append(spec)
    return out


def details(rng: np.random.Generator, group: str, i: int) -> dict[str, Any]:
    """Effects, noise and peculiarities of the i-th case of a group."""
    if group in ("blind", "base"):
        return {
            "kinds": single_kind(group, i),
            "noise": BLIND_NOISE[i % len(BLIND_NOISE)],
            "base": group == "base",
        }
    if group == "nothing":
        return {
            "noise": NOTHING_NOISE[i % len(NOTHING_NOISE)],
            "degree": (1, 3)[(i // len(NOTHING_NOISE)) % 2],
        }
    if group == "withheld":
        return {"kinds": (KINDS[i % len(KINDS)],), "noise": 0.01}
    if group == "acceleration":
        return {
            "kinds": single_kind(group, i),
            "noise": 0.005,
            "accelerations_only": True,
        }
    if group == "every":
        return {"kinds": (EVERY[i % len(EVERY)],), "noise": 0.01, "every": True}
    if group == "ordinary":
        return {"kind": ORDINARY[5 * i % len(ORDINARY)], "number": i}
    if group == "sensors":
        return {"sensors": FAULTS[i % len(FAULTS)], "noise": 0.002}
    return {"kinds": several(rng, NUMBER[group]), "noise": 0.01}


def single_kind(group: str, i: int) -> tuple[str]:
    """The kind of the i-th case; neighbours in the list are far apart."""
    impossible = {
        "blind": (),
        "base": ("harmonic", "constant"),
        "acceleration": ("constant",),  # accelerations tell none
    }
    kinds = effect_cycle(6, group == "base")
    kinds = [kind for kind in kinds if kind not in impossible[group]]
    return (kinds[5 * i % len(kinds)],)


def several(rng: np.random.Generator, count: int) -> tuple[str, ...]:
    """Kinds of different families."""
    while True:
        kinds = tuple(map(str, rng.choice(KINDS, count, replace=False)))
        if len({FAMILY[kind] for kind in kinds}) == count:
            return kinds


# -- running -------------------------------------------------------------------


def run(spec: dict) -> dict:
    """Draw, simulate, search and score one case."""
    if spec["group"] == "ordinary":
        kind, number = spec["kind"], spec["number"]
        case = make_ordinary_case(spec["name"], spec["seed"], kind, number)
        return run_case(case)
    return run_case(make_case(**spec))


def run_all(specs: list[dict], jobs: int, out: Path | None = None) -> pd.DataFrame:
    """All cases, in parallel; one row for each, written to ``out`` as they come."""
    order = {spec["name"]: i for i, spec in enumerate(specs)}
    calls = (delayed(run)(spec) for spec in specs)
    results = Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)

    rows: list[dict] = []
    table = pd.DataFrame()
    for row in tqdm(results, total=len(specs), unit="case"):
        rows.append(row)
        table = pd.DataFrame(sorted(rows, key=lambda row: order[row["case"]]))
        if out is not None:
            table.to_csv(out, index=False)
    return table


# -- what is printed -----------------------------------------------------------


def percent(count: int, total: int) -> str:
    return f"{100 * count / total:.1f}" if total else "-"


def in_cells(values: list) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(map(str, values))} |"


def single_effects(table: pd.DataFrame) -> list[str]:
    """Right answers of the groups with one effect each, by noise."""
    rows = table[table.group.isin(SINGLE)]
    if rows.empty:
        return []
    columns = (
        "group",
        "noise %",
        "cases",
        "eligible",
        "right site and class %",
        "site %",
        "class %",
        "target %",
        "parameters: median error %",
        "held-out error: median before %",
        "after %",
        "median CPU s",
    )
    lines = [in_cells(columns), "|---|" + "---:|" * (len(columns) - 1)]
    for (group, noise), cell in rows.groupby(["group", "noise %"]):
        lines.append(in_cells([group, f"{noise:g}", *answers(group, noise, cell)]))
    return [*lines, ""]


def answers(group: str, noise: float, rows: pd.DataFrame) -> list:
    """Cells of one group at one noise."""
    able = rows[rows.eligible]
    count = len(able)
    target = TARGET.get(round(noise / 100, 4), "-")
    medians = ["-", "-", "-"]
    if count:
        errors = np.concatenate([np.ravel(e) for e in able["parameter errors"]])
        if len(errors):
            medians[0] = f"{100 * np.median(errors):.1f}"
        medians[1] = f"{able['error before'].median():.2g}"
        medians[2] = f"{able['error after'].median():.2g}"
    return [
        len(rows),
        count,
        percent(able.right.sum(), count),
        percent(able["right site"].sum(), count),
        percent(able["right class"].sum(), count),
        TARGET_ACCELERATION if group == "acceleration" else target,
        *medians,
        f"{rows.cpu.median():.1f}",
    ]


# of the other groups what is counted, and the target in percent
COUNTED = {
    "nothing": ("nothing to find: nothing added", 99),
    "sensors": ("imperfect sensors, nothing else: no effect of the structure", 95),
    "ordinary": ("ordinary tests: class and site of the first, or nothing", 95),
    "withheld": ("not in the catalogue: no confident wrong name", 100),
    "two": ("two effects: both found (eligible cases)", 92),
    "three": ("three effects: all found (eligible cases)", 85),
    "every": (
        "an effect in every storey of four to six: all found (eligible cases)",
        85,
    ),
}


def other_groups(table: pd.DataFrame) -> list[str]:
    """Right answers of the groups with several effects, or none."""
    lines = []
    for group, (what, target) in COUNTED.items():
        of_group = table[table.group == group]
        if group in (*NUMBER, "every", "ordinary"):
            of_group = of_group[
                of_group.eligible.astype(bool) | (of_group.effect == "none")
            ]
        if of_group.empty:
            continue
        share = percent(of_group.right.sum(), len(of_group))
        lines.append(f"- {what}: {share} % of {len(of_group)} (target {target} %)")
        if group == "nothing":
            lines += right_by(of_group, "noise %", "noise {:g} %")
        if group == "sensors":
            lines += right_by(of_group, "sensors", "{}")
            wrong = of_group[~of_group.right & (of_group.sure > 0)]
            share = percent(len(wrong), len(of_group))
            lines.append(f"  - wrong with a sure name: {share} % (target 1 %)")
    return lines


def right_by(of_group: pd.DataFrame, column: str, label: str) -> list[str]:
    """Right answers by the values of a column."""
    lines = []
    for value, rows in of_group.groupby(column, sort=column != "sensors"):
        name = label.format(value)
        lines.append(f"  - {name}: {rows.right.sum()} of {len(rows)}")
    return lines


def certainty(table: pd.DataFrame) -> list[str]:
    """What "sure" and "confirmed" are worth, over all cases."""
    if "claims" not in table:
        return []
    columns = ["steps", "claims", "names right", "sure", "sure right"]
    steps, claims, right, sure, both = table[columns].fillna(0).sum().astype(int)
    # without one no name is ever sure
    judged = table[table["second record"].astype(bool)]
    judged_right = int(judged["names right"].fillna(0).sum())
    return [
        f"- sure names that are right: {percent(both, sure)} % of {sure}"
        f" (target {SURE_RIGHT:g} %)",
        f"- right names that are sure: {percent(both, right)} % of {right}; where a"
        f" second record is given {percent(both, judged_right)} % of {judged_right}"
        f" (target {RIGHT_SURE:g} %)",
        f"- effects that held-out data did not confirm: {steps - claims} of {steps}",
        f"- claims of what is not there: {int(table['false'].sum())} of {claims}"
        f" (in {int((table['false'] > 0).sum())} of {len(table)} cases)",
    ]


def by_effect(table: pd.DataFrame) -> list[str]:
    """Right answers by kind of effect and noise."""
    single = table[table.group.isin(SINGLE) & table.eligible.astype(bool)]
    if single.empty:
        return []
    levels = sorted(single["noise %"].unique())
    heads = [f"{level:g} %" for level in levels]
    lines = ["", in_cells(["effect", *heads]), "|---|" + "---:|" * len(levels)]
    for effect, rows in single.groupby("effect", sort=False):
        cells = [effect]
        for level in levels:
            cases = rows[rows["noise %"] == level]
            score = f"{cases.right.sum()}/{len(cases)}"
            cells.append(score if len(cases) else "-")
        lines.append(in_cells(cells))
    return lines


FAILURE_COLUMNS = {
    "case": "case",
    "noise %": "noise %",
    "n": "n",
    "forced": "forced",
    "excitation": "excitation",
    "effect": "effect",
    "site": "site",
    "share %": "share %",
    "heard": "heard",
    "found": "found",
    "stopped": "stopped",
    "error before": "held-out error: before",
    "error after": "after",
}


def failures(table: pd.DataFrame) -> list[str]:
    """One row for each failure, with what was found instead."""
    always = table.group.isin(["nothing", "withheld", "sensors"])
    always |= table.effect == "none"
    asked = always | table.eligible.astype(bool)
    wrong = table[asked & ~table.right.astype(bool)]
    if wrong.empty:
        return ["", "No failures."]

    shown = wrong.reindex(columns=list(FAILURE_COLUMNS))
    shown["found"] = shown["found"].fillna("")
    lines = ["", in_cells(FAILURE_COLUMNS.values()), "|---" * shown.shape[1] + "|"]
    for row in shown.itertuples(index=False):
        lines.append(in_cells([cell(value) for value in row]))
    return lines


def cell(value: Any) -> str:
    """A value in three digits, or "nothing"."""
    if isinstance(value, float):
        return f"{value:.3g}"
    return str(value) or "nothing"


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Run the battery and print how often its effects are found."""
    parser = options_of(__doc__, quick="a dozen short cases")
    parser.add_argument(
        "--group",
        nargs="+",
        choices=sorted(SIZES),
        default=list(SIZES),
        help="groups to run",
    )
    parser.add_argument(
        "--noise", type=float, help="one noise level (share of rms) for all cases"
    )
    parser.add_argument("--cases", type=int, help="number of cases in each group")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("discrepancy_battery.csv"),
        help="CSV with one row for each case",
    )
    options = parser.parse_args(arguments)

    size = SMALL if options.quick else {}
    sizes = QUICK if options.quick else SIZES
    specs = []
    for group in options.group:
        count = options.cases or sizes.get(group, 0)
        specs += specifications(group, count, options.seed, options.noise, **size)
    table = run_all(specs, options.jobs, options.out)

    lines = [*single_effects(table), *other_groups(table), *certainty(table)]
    print("\n".join([*lines, *by_effect(table), *failures(table)]))
    return table


if __name__ == "__main__":
    main()
