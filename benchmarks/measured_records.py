"""Each measured record from its undeclared baseline: error before and after, by effect.

    python benchmarks/measured_records.py                  # all: hours, most of them
                                                           # for 82 cyclic runs
    python benchmarks/measured_records.py emps bouc_wen    # some
    python benchmarks/measured_records.py --quick          # the smallest, one effect
    python benchmarks/measured_records.py emps --old-band  # also in a band set by hand

``close_loop`` gets channels in SI units and known masses; no band, no trim, no other
option. Errors are held-out, pooled, in the band that the loop found. A claim is an
effect that held-out data confirm. Data: the folder that PYSINDY_NRF_DATA names, or
``../shared/data``.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import search_path
import measured_sets
import numpy as np
import pandas as pd
from battery import measured
from harness import FAIL, Claim, in_parallel, judged, markdown, options_of, quietly

from pysindy_nrf import NRFRegressor, close_loop, laws
from pysindy_nrf.exceptions import NRFError

Check = Callable[[Any], Claim]  # of a report
Band = tuple[float | None, float | None]  # Hz
ELEMENT = {1: 0.0}  # a damper or a connection by itself: no mass
UNIT_MASS = {1: 1.0}
EQUAL_FLOORS = {1: 1.0, 2: 1.0, 3: 1.0}
ISOLATED_FLOORS = {1: 1.0, 2: 1.0, 3: 1.0, 4: 1.0}
STOREYS = ("storey 1", "storey 2", "storey 3")


@dataclass(frozen=True)
class Test:
    """Records of a test, what was found by hand, and what the loop must find.

    ``masses`` are the known ones (kg), ``old_band`` is the band that was once set by
    hand, ``variants`` are further declared models by name.
    """

    load: Callable[[], Any]
    hand: str
    checks: tuple[Check, ...]
    masses: dict[int, float] | None = None
    old_band: Band | None = None
    variants: dict[str, dict[str, Any]] = field(default_factory=dict)
    declared: dict[str, Any] = field(default_factory=lambda: {"degree": 1})

    def search(
        self, records: Any, declared: dict[str, Any] | None = None, **options: Any
    ) -> Any:
        """The loop on records of this test."""
        model = NRFRegressor(**(declared or self.declared), known_masses=self.masses)
        return quietly(close_loop, records, model, **options)


# -- what a report claims ------------------------------------------------------


def claims(report: Any) -> list:
    """The effects that held-out data confirm."""
    return [step for step in report.steps if step.confirmed]


def families(step: Any) -> set[str]:
    """The step's family and its declared ties."""
    return {step.family, *step.alternatives}


def names_of(step: Any) -> set[str]:
    """The step's law, its family and its declared ties; of a general law its class."""
    names = {step.law, *families(step)}
    return names if step.carries else {*names, step.effect_class, step.closest}


def heldout_error(report: Any) -> float:
    """Held-out error of the model, percent."""
    return float(report.final["held-out"])


def in_words(report: Any) -> str:
    """The effects in a few words."""
    words = []
    for step in report.steps:
        text = f"{step.law} at {step.site}"
        if not step.confirmed:
            text += " (NOT CONFIRMED)"
        if not step.sure:
            text += " [not sure]"
        words.append(f"{text} {step.reduction:.2g} dB")
    return "; ".join(words) or "nothing"


# -- what is asked -------------------------------------------------------------


def error_at_most(report: Any, percent: float) -> Claim:
    error = heldout_error(report)
    asked = f"held-out at most {percent:g} %"
    return judged(asked, f"{error:.3g}", error <= percent)


def first_claim(report: Any, *names: str, site: str = "storey 1") -> Claim:
    """The first claim is of such a law or family."""
    confirmed = claims(report)
    right = False
    if confirmed and confirmed[0].site == site:
        right = not names_of(confirmed[0]).isdisjoint(names)
    asked = f"first: {' or '.join(names)} at {site}"
    return judged(asked, in_words(report), right)


def claim_at_each(report: Any, *names: str, sites: tuple[str, ...]) -> Claim:
    """At every one of these sites a claim is of such a law or family."""
    effects = set()
    for step in claims(report):
        if not names_of(step).isdisjoint(names):
            effects.add(step.site)
    asked = f"{' or '.join(names)} at {', '.join(sites)}"
    return judged(asked, in_words(report), set(sites) <= effects)


def no_claim(report: Any) -> Claim:
    return judged("no claim", in_words(report), not claims(report))


def notes_an_offset(report: Any) -> Claim:
    """A constant in the equations of motion is noted in the quality of the data."""
    noted = any(note.kind == "offset" for note in report.quality)
    return judged("an offset is noted", "", noted)


def falls_by_a_third(report: Any) -> Claim:
    ratio = heldout_error(report) / float(report.table["held-out"].iloc[0])
    asked = "held-out falls by a third at least"
    return judged(asked, f"to {100 * ratio:.0f} %", ratio <= 2 / 3)


def published_bouc_wen(report: Any) -> Claim:
    """The published parameters of the Bouc-Wen benchmark within 3 %."""
    asked = "parameters within 3 %"
    steps = [step for step in claims(report) if step.law == "bouc_wen"]
    if not steps:
        return judged(asked, "no Bouc-Wen", False)
    effects = {
        "m": report.model.masses[0],
        **report.model.restoring_forces["storey 1"].linear_part(),
        **steps[0].parameters,
    }
    truth = {"m": 2.0, "c": 10.0, "k": 5e4}
    truth |= {"alpha": 5e4, "n": 1.0, "beta": 800.0, "rho": -1.375}
    errors = {name: float(effects[name] / value - 1) for name, value in truth.items()}
    measured = ", ".join(f"{name} {100 * x:+.1f} %" for name, x in errors.items())
    return judged(asked, measured, max(map(abs, errors.values())) <= 0.03)


def raised_errors(report: Any) -> list[str]:
    """Claims that do not lower the held-out error."""
    lowered = [step.error_after < step.error_before for step in claims(report)]
    return [step.law for step, low in zip(claims(report), lowered) if not low]


def none_raises(report: Any) -> Claim:
    raised = raised_errors(report)
    raising = ", ".join(raised) or "none does"
    return judged("no claim raises the held-out error", raising, not raised)


def model_holds_claims(report: Any) -> Claim:
    """What the model has beside the baseline is of the claimed classes at their sites.

    A law that only adds to an effect is no claim of its own.
    """
    claimed = {(s.site, s.effect_class) for s in claims(report) if not s.is_fault}
    added = set()
    for site, of_site in report.model.laws.items():
        declared = len(report.models[0].laws.get(site, ()))
        added |= {(str(site), law.effect_class) for law in of_site[declared:]}
    asked = "the model holds the claims and nothing else"
    return judged(asked, "", added == claimed)


ALWAYS: tuple[Check, ...] = (none_raises, model_holds_claims)


# -- the records ---------------------------------------------------------------


def frame(test: str, hand: str, *checks: Check) -> Test:
    """The three-storey frame on its fixed base."""
    load = partial(measured_sets.load_nees_three_storey, test)
    return Test(load, hand, checks, EQUAL_FLOORS, (0.2, 10.0))


def isolated(test: str) -> Test:
    """The frame on friction-pendulum bearings."""
    checks = (_bearing, at_most(45))
    load = partial(measured.load_nees_isolated, test)
    hand = "friction: 73 -> about 40"
    return Test(load, hand, checks, ISOLATED_FLOORS, (0.2, 10.0))


def friction_damper(run: str) -> Test:
    hand = "one state with backlash: 38.9, 45 -> 11 to 14, 21"
    checks = (_friction_with_backlash, falls_by_a_third)
    return Test(partial(measured_sets.load_friction_damper, run), hand, checks, ELEMENT)


def _bearing(report: Any) -> Claim:
    names = ("friction", "hysteresis", "memoryless")
    return claim_at_each(report, *names, sites=("storey 1",))


def _friction_with_backlash(report: Any) -> Claim:
    return claim_at_each(report, "hysteresis", "play", sites=("storey 1",))


def _hysteresis_everywhere(report: Any) -> Claim:
    return claim_at_each(report, "hysteresis", sites=STOREYS)


def _hysteresis_in_storey_3(report: Any) -> Claim:
    return claim_at_each(report, "hysteresis", sites=("storey 3",))


def _friction_first(report: Any) -> Claim:
    return first_claim(report, "friction", "memoryless")


def _friction_or_hysteresis_first(report: Any) -> Claim:
    return first_claim(report, "friction", "hysteresis", "memoryless")


def _cubic_first(report: Any) -> Claim:
    return first_claim(report, "cubic_stiffness")


def _bouc_wen_first(report: Any) -> Claim:
    return first_claim(report, "bouc_wen")


def _ground_friction_first(report: Any) -> Claim:
    return first_claim(report, "ground_friction", site="dof 1")


def at_most(percent: float) -> Check:
    return partial(error_at_most, percent=percent)


SETS: dict[str, Test] = {
    "emps": Test(
        measured_sets.load_emps,
        "17-18 -> Coulomb 7 -> offset or v^2: 4",
        (_friction_first, at_most(5.5), notes_an_offset),
        old_band=(None, 20.0),
        variants={"no spring declared": {"laws": {1: laws.LinearViscous()}}},
    ),
    "silverbox": Test(
        measured_sets.load_silverbox_multisine,
        "cubic: 7 -> 0.8",
        (_cubic_first, at_most(1.4)),
        old_band=(None, 150.0),
    ),
    "dry_friction_60": Test(
        measured.dry_friction,
        "17.7 -> friction against the ground 8.1 (in the storey: 16.3)",
        (_ground_friction_first, at_most(10)),
        UNIT_MASS,
        (None, 20.0),
    ),
    "dry_friction_70": Test(
        measured_sets.load_dry_friction_storey_more,
        "9.6 -> friction against the ground, about 6",
        (_ground_friction_first, at_most(7)),
        UNIT_MASS,
        (0.3, 20.0),
    ),
    "frame_162s1": frame("fbgm162s1", "24/19/31, nothing", no_claim),
    "frame_162s3": frame("fbgm162s3", "between s1 and s5"),
    "frame_162s5": frame(
        "fbgm162s5", "30/27/38 -> hysteresis 14/10/21", _hysteresis_everywhere
    ),
    "frame_152s3": frame(
        "fbgm152s3", "hysteresis in storey 3", _hysteresis_in_storey_3
    ),
    "frame_152s4": frame(
        "fbgm152s4",
        "30/24/42 -> 20/16/37, 27.5 pooled",
        _hysteresis_everywhere,
        at_most(28),
    ),
    "isolator_111": isolated("fpgm111s1"),
    "isolator_171": isolated("fpgm171s3"),
    "mr_white_noise": Test(
        measured_sets.load_mr_damper_white_noise,
        "50 -> friction or Dahl 33 -> times voltage 26 -> lagged 15-18",
        (_friction_or_hysteresis_first, at_most(21)),
        ELEMENT,
        (None, 60.0),
    ),
    "mr_random_voltage": Test(
        measured_sets.load_mr_damper_random_voltage,
        "78 -> 23 (the load cell clips)",
        (at_most(25),),
        ELEMENT,
        (None, 60.0),
    ),
    "friction_damper_05hz": friction_damper("0.5Hz36lbtension1.5amplitude"),
    "friction_damper_1hz": friction_damper("1Hz30lbtension1amplitude"),
    "friction_damper_1hz_loose": friction_damper("1Hz0lbtension1amplitude"),
    "friction_damper_2hz": friction_damper("2Hz30lbtension0.5amplitude"),
    "friction_damper_quake": friction_damper("KocaeliMCE"),
    "bouc_wen": Test(
        measured_sets.load_bouc_wen_benchmark,
        "25 -> Bouc-Wen 0.5",
        (_bouc_wen_first, at_most(1.0), published_bouc_wen),
        old_band=(None, 150.0),
    ),
    # without a clock
    "timber": Test(
        measured_sets.load_timber_connection,
        "46 -> one state 27 -> pinched and degrading 15",
        (at_most(20),),
        ELEMENT,
        declared={"laws": {1: [laws.LinearElastic()]}},
    ),
    "hotel": Test(measured.hotel, "21, nothing", (no_claim,), {1: 1.0, 2: 1.0}),
    "tower": Test(
        measured_sets.load_tower_with_mass_driver,
        "nothing: the driver's calibration is not certain",
        (no_claim,),
    ),
}
CYCLIC = "mr_cyclic"
CYCLIC_LIMIT = 8.0  # percent, of the median held-out error
QUICK = ["friction_damper_2hz", CYCLIC]


# -- running and printing ------------------------------------------------------


def print_set(name: str, old_band: bool, **options: Any) -> list[Claim]:
    """What the loop found on one set, beside what is asked."""
    test = SETS[name]
    records = test.load()
    rows = print_search(name, test, records, None, old_band, **options)
    for variant, declared in test.variants.items():
        title = f"{name}, {variant}"
        rows += print_search(title, test, records, declared, old_band, **options)
    return rows


def print_search(
    title: str,
    test: Test,
    records: Any,
    declared: dict[str, Any] | None,
    old_band: bool,
    **options: Any,
) -> list[Claim]:
    """One search and its claims."""
    start = time.perf_counter()
    report = test.search(records, declared, **options)
    print(f"## {title} ({time.perf_counter() - start:.0f} s)\n")
    print(f"By hand: {test.hand}\n\n{course(report)}")
    if old_band and test.old_band is not None:
        low, high = test.old_band
        beside = test.search(records, band=test.old_band, **options)
        band = f"{low or 0:g} to {high:g} Hz"
        print(f"In the band set by hand, {band}: {course(beside)}")

    print(f"\n{report}\n")
    rows = [check(report) for check in (*test.checks, *ALWAYS)]
    print(f"{in_table(rows)}\n", flush=True)
    return rows


def course(report: Any) -> str:
    """Errors from the baseline to the model, band, effects."""
    errors = " -> ".join(f"{x:.3g}" for x in report.table["held-out"])
    return (
        f"held-out {errors} %, model {heldout_error(report):.3g} %, band"
        f" {report.table['band'].iloc[0]}: {in_words(report)}"
    )


def in_table(rows: list[Claim]) -> str:
    cells = [(row.asked, row.measured, row.verdict) for row in rows]
    return markdown(pd.DataFrame(cells, columns=["check", "found", ""]))


def print_cyclic(n_runs: int | None, jobs: int, **options: Any) -> list[Claim]:
    """The MR damper's cyclic runs, each by itself."""
    hand = "30, cubic 17 -> friction along v + k x 11-13"
    test = Test(measured.mr_cyclic, hand, (), ELEMENT)
    start = time.perf_counter()
    search = partial(test.search, **options)
    records = measured.mr_cyclic(n_runs)
    reports = in_parallel(search, [(record,) for record in records], jobs)
    seconds = time.perf_counter() - start

    before = np.median([report.table["held-out"].iloc[0] for report in reports])
    errors = [heldout_error(report) for report in reports]
    after = float(np.median(errors))
    firsts = Counter()
    wrong = 0
    for report in reports:
        confirmed = claims(report)
        firsts[confirmed[0].law if confirmed else "nothing"] += 1
        wrong += sum(check(report).verdict == FAIL for check in ALWAYS)

    print(f"## {CYCLIC}, {len(reports)} runs ({seconds:.0f} s)\n\nBy hand: {hand}\n")
    print(f"median held-out {before:.3g} -> {after:.3g} % (worst {max(errors):.3g} %)")
    print(f"first claims: {', '.join(f'{k} {n}' for k, n in firsts.most_common())}\n")
    asked = f"median at most {CYCLIC_LIMIT:g} %"
    rows = [
        judged(asked, f"{after:.3g}", after <= CYCLIC_LIMIT),
        judged("no claim raises the held-out error", f"{wrong} do", wrong == 0),
    ]
    print(f"{in_table(rows)}\n", flush=True)
    return rows


def print_one(name: str, options: argparse.Namespace) -> list[Claim]:
    """What the loop finds in one set."""
    limits = {"max_steps": 1} if options.quick else {}
    if name == CYCLIC:
        n_runs = options.runs or (2 if options.quick else None)
        return print_cyclic(n_runs, options.jobs, **limits)
    return print_set(name, options.old_band, **limits)


def main(arguments: list[str] | None = None) -> dict[str, list[Claim]]:
    """Print what the loop finds in every set."""
    parser = options_of(
        __doc__, quick="the smallest record and two cyclic runs, one effect"
    )
    parser.add_argument(
        "sets", nargs="*", choices=[*SETS, CYCLIC, []], help="sets; all by default"
    )
    parser.add_argument(
        "--old-band", action="store_true", help="also in the band once set by hand"
    )
    parser.add_argument("--runs", type=int, help="so many of the 82 cyclic runs")
    parser.add_argument("--jobs", type=int, default=1, help="cyclic runs at a time")
    options = parser.parse_args(arguments)
    names = options.sets or (QUICK if options.quick else [*SETS, CYCLIC])

    rows: dict[str, list[Claim]] = {}
    for name in names:
        try:
            rows[name] = print_one(name, options)
        except NRFError as error:
            # data that are not there are no failure
            missing = "folder" in str(error)
            print(f"## {name}\n\n{'skipped' if missing else 'refused'}: {error}\n")
            if not missing:
                rows[name] = [judged("it runs", str(error), False)]

    verdicts = [row.verdict for of_set in rows.values() for row in of_set]
    print(f"{len(verdicts)} checks, {verdicts.count(FAIL)} failed")
    return rows


if __name__ == "__main__":
    main()
