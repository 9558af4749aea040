"""``close_loop`` on tests with an ordinary mistake, and on tests without any.

    python benchmarks/loop_on_mistakes.py --jobs 2          # 5 a mistake, 40 clean
    python benchmarks/loop_on_mistakes.py --seed 1000       # other structures, noise
    python benchmarks/loop_on_mistakes.py --quick           # 5 mistakes, 4 clean

The tests are those of benchmarks/verdicts.py: chains of 2 to 5 floors with one mistake
in a channel, the structure, the excitation or the integrator. The baseline is the chain
of linear storeys that the author of the test believes in. Of the effects that the loop
confirms:

- *mistake*: all stand where the mistake is, and there is one;
- *nothing*: there are none;
- *other*: one stands elsewhere;
- *off*: a mass or the stiffness of a storey is more than 10 % off in the final model;
- *green, off*: and its verdict is green. A common gain of all forces, or of all
  motions, cannot be known, and is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import search_path
import numpy as np
import pandas as pd
import verdicts
from harness import in_parallel, markdown, options_of
from verdicts import CLEAN, MISTAKES, OFF, Test

from pysindy_nrf import ChainModel, NRFRegressor, close_loop
from pysindy_nrf.exceptions import NRFError

# What hardly any record shows: not the subject of this benchmark, and slow.
LEFT_OUT = {"gain of everything", "high degree"}
CLAIMS = ("mistake", "nothing", "other", "refused")


@dataclass(frozen=True)
class Outcome:
    """What the loop makes of one test."""

    kind: str
    seed: int
    claim: str
    state: str
    off: float
    invariant: bool
    test: str
    effects: str

    @property
    def is_off(self) -> bool:
        return self.off > OFF and not self.invariant

    @property
    def is_green_and_off(self) -> bool:
        return self.state == "green" and self.is_off

    def __str__(self) -> str:
        return (
            f"{self.kind} {self.seed}: {self.state}, {self.off:.1%} off;"
            f" {self.test}; confirmed: {self.effects or 'nothing'}"
        )


def outcome(kind: str, seed: int) -> Outcome:
    """What the loop makes of one test."""
    test, record = verdicts.prepared(kind, seed)
    try:
        report = close_loop(record, NRFRegressor(**test.settings))
    except NRFError as refusal:
        why = str(refusal)
        return Outcome(kind, seed, "refused", "", 0.0, False, str(test), why)

    sites = [str(step.site) for step in report.steps if step.confirmed]
    effects = [f"{step.law} at {step.site}" for step in report.steps if step.confirmed]
    claim = "nothing"
    if sites:
        claim = "mistake" if set(sites) <= places_of(test) else "other"
    return Outcome(
        kind,
        seed,
        claim,
        report.verdict.state,
        error_of(report.model, test),
        test.invariant,
        str(test),
        ", ".join(effects),
    )


def places_of(test: Test) -> set[str]:
    """Sites at which an effect names the mistake of a test."""
    places = set(test.places)
    for place in test.places:
        places.add(f"sensor {place}")
        if place[0] in "ax":
            places.add(f"sensors {place[1:]}")
    return places


def error_of(model: ChainModel, test: Test) -> float:
    """The worst relative error of a mass or of the stiffness of a storey."""
    errors = [float(np.abs(model.masses / test.masses - 1).max())]
    for i, true in enumerate(test.stiffness, start=1):
        stiffness = model.restoring_forces[f"storey {i}"].linear_part()["k"]
        errors.append(abs(float(stiffness) / true - 1))
    return max(errors)


def by_kind(outcomes: list[Outcome]) -> pd.DataFrame:
    """What was claimed, by kind of mistake."""
    rows = []
    for kind in dict.fromkeys(each.kind for each in outcomes):
        of_kind = [each for each in outcomes if each.kind == kind]
        row: dict[str, object] = {"kind": kind, "n": len(of_kind)}
        for claim in CLAIMS:
            row[claim] = sum(each.claim == claim for each in of_kind)
        row["off > 10 %"] = sum(each.is_off for each in of_kind)
        row["green, off"] = sum(each.is_green_and_off for each in of_kind)
        rows.append(row)
    return pd.DataFrame(rows)


def main(arguments: list[str] | None = None) -> None:
    """Print the table, and every test with another claim or a wrong green."""
    parser = options_of(__doc__, quick="five mistakes, four clean tests")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--each", type=int, default=5, help="tests a mistake")
    parser.add_argument("--clean", type=int, default=40, help="tests without any")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)

    kinds = [kind for kind in MISTAKES if kind not in LEFT_OUT]
    each, n_clean = options.each, options.clean
    if options.quick:
        kinds, each, n_clean = kinds[::4], 1, 4
    chosen = verdicts.tasks(kinds, each, n_clean, options.seed)
    outcomes = in_parallel(outcome, chosen, options.jobs)

    print(markdown(by_kind(outcomes)))
    print("\nAnother claim, or green and off:")
    for each_outcome in outcomes:
        is_false = each_outcome.claim == "other"
        is_false |= each_outcome.kind in CLEAN and each_outcome.claim != "nothing"
        if is_false or each_outcome.is_green_and_off:
            print(f"- {each_outcome}")


if __name__ == "__main__":
    main()
