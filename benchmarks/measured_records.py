"""Each measured record from its undeclared baseline: held-out error before and after,
effect by effect.

    python benchmarks/measured_records.py                     # all: hours, most of it the MR damper's cyclic runs
    python benchmarks/measured_records.py emps bouc_wen       # some
    python benchmarks/measured_records.py --quick             # the smallest record, one effect at most
    python benchmarks/measured_records.py emps --old-band     # beside it the result in the band that was set by hand

``close_loop`` gets channels in SI units and known masses; no band, no trim, no other
option. Errors are held-out, pooled, in the band that the loop found. A claim is an
effect that held-out data confirm. Data: the folder that PYSINDY_NRF_DATA names, or
``../shared/data``.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ.setdefault(
    "PYSINDY_NRF_DATA", str(Path(__file__).resolve().parents[2] / "shared" / "data")
)
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np  # noqa: E402
from battery import measured  # noqa: E402

from pysindy_nrf import NRFRegressor, close_loop, laws  # noqa: E402
from pysindy_nrf.exceptions import NRFError  # noqa: E402

Check = tuple[str, str, bool]
ELEMENT = {1: 0.0}  # a damper or a connection by itself: no mass


@dataclass
class Tested:
    """Records of one test, what is known of its masses, what was found by hand, and
    what the loop must find.
    """

    load: Callable[[], Any]
    hand: str
    checks: Callable[[Any], list[Check]]
    masses: dict[int, float] | None = None
    old_band: tuple[float | None, float | None] | None = None
    others: dict[str, dict[str, Any]] = field(
        default_factory=dict
    )  # further declared models, by name
    declared: dict[str, Any] = field(default_factory=lambda: {"degree": 1})

    def run(
        self, records: Any, model: dict[str, Any] | None = None, **options: Any
    ) -> Any:
        """The loop on records of this test."""
        declared = NRFRegressor(**(model or self.declared), known_masses=self.masses)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return close_loop(records, declared, **options)


# -- what is asked -------------------------------------------------------------


def claims(report) -> list:
    """The effects that held-out data confirm."""
    return [step for step in report.steps if step.confirmed]


def families(step) -> set[str]:
    """The step's family and its declared ties."""
    return {step.family, *step.alternatives}


def held(report) -> float:
    """Held-out error of the model, percent."""
    return float(report.final["held-out"])


def told(report) -> str:
    """The effects in a few words."""
    words = [
        f"{s.law} at"
        f" {s.site}{'' if s.confirmed else ' (NOT CONFIRMED)'}{'' if s.sure else ' [not sure]'}"
        f" {s.gain:.2g} dB"
        for s in report.steps
    ]
    return "; ".join(words) or "nothing"


def at_most(limit: float) -> Callable:
    return lambda report: [
        (
            f"held-out at most {limit:g} %",
            f"{held(report):.3g}",
            bool(held(report) <= limit),
        )
    ]


def first_is(*names: str, at: str = "storey 1") -> Callable:
    """The first claim is of such a law or family."""

    def check(report) -> list[Check]:
        first = next(iter(claims(report)), None)
        right = (
            first is not None
            and first.site == at
            and bool({first.law, *families(first)} & set(names))
        )
        return [(f"first: {' or '.join(names)} at {at}", told(report), right)]

    return check


def has(*names: str, at: tuple[str, ...]) -> Callable:
    """At every one of these sites a claim is of such a law or family."""

    def check(report) -> list[Check]:
        sites = {s.site for s in claims(report) if {s.law, *families(s)} & set(names)}
        return [
            (f"{' or '.join(names)} at {', '.join(at)}", told(report), set(at) <= sites)
        ]

    return check


def nothing(report) -> list[Check]:
    return [("no claim", told(report), not claims(report))]


def notes_an_offset(report) -> list[Check]:
    """A constant that the equations of motion hold is noted as the quality of it."""
    noted = any(note.kind == "offset" for note in report.quality)
    return [("an offset is noted", "", noted)]


def falls_by_a_third(report) -> list[Check]:
    ratio = held(report) / float(report.table["held-out"].iloc[0])
    return [
        (
            "held-out falls by a third at least",
            f"to {100 * ratio:.0f} %",
            bool(ratio <= 2 / 3),
        )
    ]


def benchmark_parameters(report) -> list[Check]:
    """The published parameters of the Bouc-Wen benchmark within 3 %."""
    step = next((s for s in claims(report) if s.law == "bouc_wen"), None)
    if step is None:
        return [("parameters within 3 %", "no Bouc-Wen", False)]
    linear, p = report.model.restoring_forces["storey 1"].linear_part(), step.parameters
    found = {
        "m": report.model.masses[0],
        "c": linear["c"],
        "k": linear["k"],
        "alpha": p["alpha"],
        "n": p["n"],
    }
    found |= {"beta": p["beta"], "rho": p["rho"]}
    truth = {
        "m": 2.0,
        "c": 10.0,
        "k": 5e4,
        "alpha": 5e4,
        "n": 1.0,
        "beta": 800.0,
        "rho": -1.375,
    }
    off = {name: float(value / truth[name] - 1) for name, value in found.items()}
    return [
        (
            "parameters within 3 %",
            ", ".join(f"{k} {100 * x:+.1f} %" for k, x in off.items()),
            max(map(abs, off.values())) <= 0.03,
        )
    ]


def consistent(report) -> list[Check]:
    """No claim raises the held-out error, and the model holds claims only."""
    raised = [s.law for s in claims(report) if not s.error_after < s.error_before]
    sites = Counter(s.site for s in claims(report) if not s.is_fault)
    base = {str(s): len(held_) for s, held_ in report.models[0].laws.items()}
    model = {str(s): len(held_) for s, held_ in report.model.laws.items()}
    extra = {s: n - base.get(s, 0) for s, n in model.items() if n > base.get(s, 0)}
    return [
        (
            "no claim raises the held-out error",
            ", ".join(raised) or "none does",
            not raised,
        ),
        ("the model holds the claims and nothing else", "", extra == dict(sites)),
    ]


def every(*checks: Callable) -> Callable:
    return lambda report: [row for check in checks for row in check(report)]


# -- the records ---------------------------------------------------------------


def frame(test: str, hand: str, *checks: Callable) -> Tested:
    """The three-storey frame on its fixed base."""
    masses = {1: 1.0, 2: 1.0, 3: 1.0}
    return Tested(
        lambda: measured.load_nees_three_storey(test),
        hand,
        every(*checks),
        masses,
        (0.2, 10.0),
    )


def isolated(test: str) -> Tested:
    """The frame on friction-pendulum bearings."""
    checks = every(has("friction", "hysteresis", at=("storey 1",)), at_most(45))
    masses = {1: 1.0, 2: 1.0, 3: 1.0, 4: 1.0}
    return Tested(
        lambda: measured.load_nees_isolated(test),
        "friction: 73 -> about 40",
        checks,
        masses,
        (0.2, 10.0),
    )


def friction_damper(run: str) -> Tested:
    checks = every(has("hysteresis", "play", at=("storey 1",)), falls_by_a_third)
    hand = "one state with backlash: 38.9, 45 -> 11 to 14, 21"
    return Tested(lambda: measured.load_friction_damper(run), hand, checks, ELEMENT)


STOREYS = ("storey 1", "storey 2", "storey 3")
DAMPER_RUNS = {
    "friction_damper_05hz": "0.5Hz36lbtension1.5amplitude",
    "friction_damper_1hz": "1Hz30lbtension1amplitude",
    "friction_damper_1hz_loose": "1Hz0lbtension1amplitude",
    "friction_damper_2hz": "2Hz30lbtension0.5amplitude",
    "friction_damper_quake": "KocaeliMCE",
}
SETS: dict[str, Tested] = {
    "emps": Tested(
        measured.load_emps,
        "17-18 -> Coulomb 7 -> offset or v^2: 4",
        every(
            first_is("friction"),
            at_most(5.5),
            notes_an_offset,
        ),
        None,
        (None, 20.0),
        {"no spring declared": {"laws": {1: laws.LinearViscous()}}},
    ),
    "silverbox": Tested(
        measured.load_silverbox_multisine,
        "cubic: 7 -> 0.8",
        every(first_is("cubic_stiffness"), at_most(1.4)),
        None,
        (None, 150.0),
    ),
    "dry_friction_60": Tested(
        measured.dry_friction,
        "17.7 -> friction against the ground 8.1 (in the storey: 16.3)",
        every(first_is("ground_friction", at="dof 1"), at_most(10)),
        {1: 1.0},
        (None, 20.0),
    ),
    "dry_friction_70": Tested(
        measured.load_dry_friction_storey_more,
        "9.6 -> friction against the ground, about 6",
        every(first_is("ground_friction", at="dof 1"), at_most(7)),
        {1: 1.0},
        (0.3, 20.0),
    ),
    "frame_162s1": frame("fbgm162s1", "24/19/31, nothing", nothing),
    "frame_162s3": frame("fbgm162s3", "between s1 and s5"),
    "frame_162s5": frame(
        "fbgm162s5", "30/27/38 -> hysteresis 14/10/21", has("hysteresis", at=STOREYS)
    ),
    "frame_152s3": frame(
        "fbgm152s3", "hysteresis in storey 3", has("hysteresis", at=("storey 3",))
    ),
    "frame_152s4": frame(
        "fbgm152s4",
        "30/24/42 -> 20/16/37, 27.5 pooled",
        has("hysteresis", at=STOREYS),
        at_most(28),
    ),
    "isolator_111": isolated("fpgm111s1"),
    "isolator_171": isolated("fpgm171s3"),
    "mr_white_noise": Tested(
        measured.load_mr_damper_white_noise,
        "50 -> friction or Dahl 33 -> times voltage 26 -> lagged 15-18",
        every(first_is("friction", "hysteresis"), at_most(21)),
        ELEMENT,
        (None, 60.0),
    ),
    "mr_random_voltage": Tested(
        measured.load_mr_damper_random_voltage,
        "78 -> 23 (the load cell clips)",
        at_most(25),
        ELEMENT,
        (None, 60.0),
    ),
    **{name: friction_damper(run) for name, run in DAMPER_RUNS.items()},
    "bouc_wen": Tested(
        measured.load_bouc_wen_benchmark,
        "25 -> Bouc-Wen 0.5",
        every(first_is("bouc_wen"), at_most(1.0), benchmark_parameters),
        None,
        (None, 150.0),
    ),
    "timber": Tested(  # without a clock
        measured.load_timber_connection,
        "46 -> one state 27 -> pinched and degrading 15",
        at_most(20),
        ELEMENT,
        declared={"laws": {1: [laws.LinearElastic()]}},
    ),
    "hotel": Tested(measured.hotel, "21, nothing", nothing, {1: 1.0, 2: 1.0}),
    "tower": Tested(
        measured.load_tower_with_mass_driver,
        "nothing: the driver's calibration is not certain",
        nothing,
    ),
}
CYCLIC = "mr_cyclic"
LIMIT_CYCLIC = 8.0


def show(name: str, one: Tested, old_band: bool = False, **options: Any) -> list[Check]:
    """Run the loop on one set and print what it found beside what is asked."""
    records = one.load()
    out: list[Check] = []
    variants = {"": None, **one.others}
    for variant, model in variants.items():
        start = time.perf_counter()
        report = one.run(records, model, **options)
        print(
            f"## {name}{f', {variant}' if variant else ''}"
            f" ({time.perf_counter() - start:.0f} s)\n"
        )
        print(f"By hand: {one.hand}\n\n{line(report)}")
        if old_band and one.old_band is not None:
            beside = one.run(records, model, band=one.old_band, **options)
            low, high = one.old_band
            print(
                f"In the band set by hand, {low or 0:g} to {high:g} Hz: {line(beside)}"
            )
        print(f"\n{report}\n")
        checks = [*one.checks(report), *consistent(report)]
        print_checks(checks)
        out += checks
    return out


def line(report) -> str:
    """Errors from the baseline to the model, band, effects."""
    errors = " -> ".join(f"{x:.3g}" for x in report.table["held-out"])
    return (
        f"held-out {errors} %, model {held(report):.3g} %, band"
        f" {report.table['band'].iloc[0]}: {told(report)}"
    )


def print_checks(checks: list[Check]) -> None:
    print("| check | found | |\n|---|---|---|")
    for what, found, passed in checks:
        print(f"| {what} | {found} | {'PASS' if passed else 'FAIL'} |")
    print(flush=True)


def cyclic(count: int | None, jobs: int, **options: Any) -> list[Check]:
    """The MR damper's cyclic runs, each by itself."""
    from joblib import Parallel, delayed

    one = Tested(
        lambda: None,
        "30, cubic 17 -> friction along v + k x 11-13",
        at_most(LIMIT_CYCLIC),
        ELEMENT,
    )
    start = time.perf_counter()
    reports = Parallel(n_jobs=jobs)(
        delayed(one.run)(record, **options) for record in measured.mr_cyclic(count)
    )
    before = float(np.median([r.table["held-out"].iloc[0] for r in reports]))
    after = [held(r) for r in reports]
    kinds = Counter(claims(r)[0].law if claims(r) else "nothing" for r in reports)
    raised = sum(not row[2] for r in reports for row in consistent(r))
    print(
        f"## {CYCLIC}, {len(reports)} runs ({time.perf_counter() - start:.0f} s)\n\nBy"
        f" hand: {one.hand}\n"
    )
    print(
        f"median held-out {before:.3g} -> {np.median(after):.3g} % (worst"
        f" {max(after):.3g} %)"
    )
    print(f"first claims: {', '.join(f'{k} {n}' for k, n in kinds.most_common())}\n")
    checks = [
        (
            f"median at most {LIMIT_CYCLIC:g} %",
            f"{np.median(after):.3g}",
            bool(np.median(after) <= LIMIT_CYCLIC),
        ),
        ("no claim raises the held-out error", f"{raised} do", raised == 0),
    ]
    print_checks(checks)
    return checks


def main(arguments: list[str] | None = None) -> dict[str, list[Check]]:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "sets",
        nargs="*",
        choices=[*SETS, CYCLIC, []],
        help="sets to run; all by default",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="the smallest record and two cyclic runs, one effect",
    )
    parser.add_argument(
        "--old-band",
        action="store_true",
        help="also in the band that was once set by hand",
    )
    parser.add_argument("--runs", type=int, help="so many of the 82 cyclic runs")
    parser.add_argument("--jobs", type=int, default=1, help="cyclic runs at a time")
    o = parser.parse_args(arguments)
    options: dict[str, Any] = {"max_steps": 1} if o.quick else {}
    out: dict[str, list[Check]] = {}
    for name in o.sets or (
        ["friction_damper_2hz", CYCLIC] if o.quick else [*SETS, CYCLIC]
    ):
        try:
            if name == CYCLIC:
                out[name] = cyclic(
                    o.runs or (2 if o.quick else None), o.jobs, **options
                )
            else:
                out[name] = show(name, SETS[name], o.old_band, **options)
        except NRFError as error:
            if "folder" not in str(error):
                print(f"## {name}\n\nrefused: {error}\n")
                out[name] = [("it runs", str(error), False)]
                continue
            print(f"## {name}\n\nskipped: {error}\n")
    failed = sum(not passed for checks in out.values() for _, _, passed in checks)
    print(f"{sum(map(len, out.values()))} checks, {failed} failed")
    return out


if __name__ == "__main__":
    main()
