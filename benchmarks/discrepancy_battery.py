"""Blind battery for ``close_loop``: is the right effect found, at the right site, and
nothing where there is nothing?

    python benchmarks/discrepancy_battery.py --quick
    python benchmarks/discrepancy_battery.py                         # everything: hours on two cores
    python benchmarks/discrepancy_battery.py --group blind --noise 0.05 --cases 40
    --seed 7 python benchmarks/discrepancy_battery.py --group three acceleration --cases
    10

Cases are drawn and simulated by formulas and an integrator of their own
(battery/formulas.py); the loop is given the noisy channels (F of the forced DOFs, a, v,
x of all; under base excitation ag, vg, xg and the masses; in the group "acceleration"
one force and the accelerations) and the declared baseline, nothing else. An answer is
what held-out data confirm. All rows are written to a CSV file; failures are printed one
per row.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
from battery.generators import KINDS, Case, effect_cycle, make_case  # noqa: E402
from battery.sensors import FAULTS  # noqa: E402

# Three in five at 5 %: there few effects stand out of the noise far enough to be
# eligible.
BLIND_NOISE = (0.0, 0.05, 0.01, 0.05, 0.05)
NOTHING_NOISE = (0.0, 0.01, 0.02, 0.05, 0.10)
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
}
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
# Short records of small chains.
SMALL = {"n_samples": 4096, "most": 3}
QUICK = {
    **dict.fromkeys(SIZES, 1),
    "blind": 3,
    "two": 0,
    "three": 0,
    "acceleration": 0,
    "every": 0,
}
TARGET = {0.0: 97.0, 0.01: 97.0, 0.05: 90.0}
SURE_RIGHT, RIGHT_SURE = 97.0, 60.0


def specifications(
    group: str, count: int, seed: int, noise: float | None = None, **size
) -> list[dict]:
    """What to draw for one group: kinds are dealt in turn, and each meets each noise
    level in turn.
    """
    rng = np.random.default_rng([seed, len(group), ord(group[0])])
    out = []
    for i in range(count):
        spec = {
            "name": f"{group} {i}",
            "group": group,
            "seed": seed * 100_000 + 1000 * list(SIZES).index(group) + i,
            **size,
        }
        if group in ("blind", "base"):
            kinds = [
                k
                for k in effect_cycle(6, group == "base")
                if group == "blind" or k not in ("harmonic", "constant")
            ]
            level = BLIND_NOISE[i % len(BLIND_NOISE)]
            spec |= {
                "kinds": (kinds[5 * i % len(kinds)],),
                "noise": level if noise is None else noise,
                "base": group == "base",
            }
        elif group == "nothing":
            level = NOTHING_NOISE[i % len(NOTHING_NOISE)]
            spec |= {
                "noise": level if noise is None else noise,
                "degree": (1, 3)[(i // len(NOTHING_NOISE)) % 2],
            }
        elif group == "withheld":
            spec |= {
                "kinds": (KINDS[i % len(KINDS)],),
                "noise": 0.01 if noise is None else noise,
            }
        elif group == "acceleration":  # which tell no constant
            kinds = [k for k in effect_cycle(6, False) if k != "constant"]
            spec |= {
                "kinds": (kinds[5 * i % len(kinds)],),
                "noise": 0.005 if noise is None else noise,
            }
            spec |= {"accelerations_only": True}
        elif group == "every":
            spec |= {
                "kinds": (EVERY[i % len(EVERY)],),
                "noise": 0.01 if noise is None else noise,
                "every": True,
            }
        elif group == "sensors":
            spec |= {
                "sensors": FAULTS[i % len(FAULTS)],
                "noise": 0.002 if noise is None else noise,
            }
        else:
            spec |= {
                "kinds": _several(rng, NUMBER[group]),
                "noise": 0.01 if noise is None else noise,
            }
            if "most" in size:
                spec["most"] = max(size["most"], NUMBER[group])
        out.append(spec)
    return out


def _several(rng, count: int) -> tuple[str, ...]:
    """Kinds of different families."""
    from battery.scorer import FAMILY

    while True:
        kinds = tuple(map(str, rng.choice(KINDS, count, replace=False)))
        if len({FAMILY[kind] for kind in kinds}) == count:
            return kinds


def run(spec: dict) -> dict:
    """Draw, simulate, search and score one case."""
    from battery.scorer import run_case

    case: Case = make_case(**spec)
    return run_case(case)


def run_all(specs: list[dict], jobs: int, out: Path | None = None) -> pd.DataFrame:
    """All cases, in parallel, as a table with one row for each; written to ``out``
    after every case.
    """
    from joblib import Parallel, delayed
    from tqdm import tqdm

    order = {s["name"]: i for i, s in enumerate(specs)}
    rows: list[dict] = []
    table = pd.DataFrame()
    found = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(run)(s) for s in specs
    )
    for row in tqdm(found, total=len(specs), unit="case"):
        rows.append(row)
        table = pd.DataFrame(sorted(rows, key=lambda r: order[r["case"]]))
        if out is not None:
            table.to_csv(out, index=False)
    return table


# -- what is printed -----------------------------------------------------------


def percent(part, whole) -> str:
    return f"{100 * part / whole:.1f}" if whole else "-"


def summary(table: pd.DataFrame) -> list[str]:
    """Markdown lines, one small table for each group."""
    out = []
    found = table[table.group.isin(["blind", "base", "acceleration"])]
    if len(found):
        out += [
            (
                "| group | noise % | cases | eligible | right site and family % | site"
                " % | family % | target % | parameters: median error % | held-out"
                " error: median before % | after % | median CPU s |"
            ),
            "|---|" + "---:|" * 11,
        ]
        for (group, noise), part in found.groupby(["group", "noise %"]):
            able = part[part.eligible]
            errors = (
                np.concatenate([np.ravel(e) for e in able["parameter errors"]])
                if len(able)
                else np.zeros(0)
            )
            cells = [
                group,
                f"{noise:g}",
                len(part),
                len(able),
                percent(able.right.sum(), len(able)),
                percent(able["right site"].sum(), len(able)),
                percent(able["right family"].sum(), len(able)),
                (
                    90.0
                    if group == "acceleration"
                    else TARGET.get(round(noise / 100, 4), "-")
                ),
                f"{100 * np.median(errors):.1f}" if len(errors) else "-",
                f"{able['error before'].median():.2g}" if len(able) else "-",
                f"{able['error after'].median():.2g}" if len(able) else "-",
                f"{part.cpu.median():.1f}",
            ]
            out.append("| " + " | ".join(map(str, cells)) + " |")
        out.append("")
    for group, what, target in (
        ("nothing", "nothing to find: nothing added", "99"),
        (
            "sensors",
            "imperfect sensors, nothing else: no effect of the structure",
            "95",
        ),
        ("withheld", "not in the catalogue: no confident wrong name", "100"),
        ("two", "two effects: both found (eligible cases)", "92"),
        ("three", "three effects: all found (eligible cases)", "85"),
        (
            "every",
            "an effect in every storey of four to six: all found (eligible cases)",
            "85",
        ),
    ):
        part = table[table.group == group]
        if group in NUMBER or group == "every":
            part = part[part.eligible.astype(bool)]
        if len(part):
            out.append(
                f"- {what}: {percent(part.right.sum(), len(part))} % of {len(part)}"
                f" (target {target} %)"
            )
            if group == "nothing":
                out += [
                    f"  - noise {x:g} %: {p.right.sum()} of {len(p)}"
                    for x, p in part.groupby("noise %")
                ]
            if group == "sensors":
                out += [
                    f"  - {x}: {p.right.sum()} of {len(p)}"
                    for x, p in part.groupby("sensors", sort=False)
                ]
                wrong = part[~part.right & (part.sure > 0)]
                out.append(
                    f"  - wrong with a sure name: {percent(len(wrong), len(part))} %"
                    " (target 1 %)"
                )
    return out + certainty(table)


def certainty(table: pd.DataFrame) -> list[str]:
    """What "sure" and "confirmed" are worth, over all cases."""
    if "claims" not in table:
        return []
    steps, claims, right, sure, both = (
        int(table[name].fillna(0).sum())
        for name in ("steps", "claims", "names right", "sure", "sure right")
    )
    return [
        (
            f"- sure names that are right: {percent(both, sure)} % of {sure} (target"
            f" {SURE_RIGHT:g} %)"
        ),
        (
            f"- right names that are sure: {percent(both, right)} % of {right} (target"
            f" {RIGHT_SURE:g} %)"
        ),
        f"- effects that held-out data did not confirm: {steps - claims} of {steps}",
    ]


def by_effect(table: pd.DataFrame) -> list[str]:
    """Right answers by kind of effect and noise."""
    part = table[
        table.group.isin(["blind", "base", "acceleration"])
        & table.eligible.astype(bool)
    ]
    if not len(part):
        return []
    levels = sorted(part["noise %"].unique())
    out = [
        "",
        "| effect | " + " | ".join(f"{x:g} %" for x in levels) + " |",
        "|---|" + "---:|" * len(levels),
    ]
    for effect, mine in part.groupby("effect", sort=False):
        cells = [
            f"{p.right.sum()}/{len(p)}" if len(p := mine[mine["noise %"] == x]) else "-"
            for x in levels
        ]
        out.append(f"| {effect} | " + " | ".join(cells) + " |")
    return out


def failures(table: pd.DataFrame) -> list[str]:
    """One row for each failure, with what was found instead."""
    table = table.assign(
        found=table.get("found", pd.Series("", index=table.index)).fillna("")
    )
    wrong = table[~table.right.astype(bool)]
    wrong = wrong[
        (wrong.eligible.astype(bool))
        | wrong.group.isin(["nothing", "withheld", "sensors"])
    ]
    if not len(wrong):
        return ["", "No failures."]
    columns = [
        "case",
        "noise %",
        "n",
        "forced",
        "excitation",
        "effect",
        "site",
        "share %",
        "heard",
        "found",
        "stopped",
    ]
    header = [*columns, "held-out error: before", "after"]
    out = ["", "| " + " | ".join(header) + " |", "|---|" + "---|" * (len(header) - 1)]
    for _, r in wrong.iterrows():
        cells = [r[c] for c in columns] + [
            r.get("error before", np.nan),
            r.get("error after", np.nan),
        ]
        out.append(
            "| "
            + " | ".join(
                f"{x:.3g}" if isinstance(x, float) else str(x) or "nothing"
                for x in cells
            )
            + " |"
        )
    return out


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a dozen short cases")
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
    o = parser.parse_args(arguments)
    sizes = QUICK if o.quick else SIZES
    specs = [
        s
        for g in o.group
        for s in specifications(
            g, o.cases or sizes[g], o.seed, o.noise, **(SMALL if o.quick else {})
        )
    ]
    table = run_all(specs, o.jobs, o.out)
    print("\n".join([*summary(table), *by_effect(table), *failures(table)]))
    return table


if __name__ == "__main__":
    main()
