"""Battery of bad inputs: is each named, with its channel and its cure?

    python benchmarks/bad_inputs.py               # one row for each kind, counts
    python benchmarks/bad_inputs.py --room file   # one room
    python benchmarks/bad_inputs.py --failures    # only broken promises

A kind is *caught* (a typed error, or an exit code of the command line, whose message
names what is wrong, where, and the cure), *warned* of (a typed warning that does), or
*right* (an unusual form of good numbers: the same answer). *Silent* is a number without
a word, *bare* an error of no type of ours or a traceback, *changed* an input that is
not the same to the last bit afterwards. The exit code is 1 if a promise is broken.
"""

from __future__ import annotations

import sys

import search_path
import pandas as pd
from bad_inputs_battery import Outcome, every_kind, judge
from bad_inputs_battery.kind import BROKEN, KEPT
from harness import markdown, options_of
from tqdm import tqdm

MESSAGE_WIDTH = 110  # the cure stands at the end of a message


def as_table(outcomes: list[Outcome]) -> pd.DataFrame:
    """One row for each kind."""
    rows = []
    for outcome in outcomes:
        message = " ".join(outcome.message.split())
        rows.append(
            {
                "room": outcome.kind.room,
                "kind": outcome.kind.name,
                "promised": outcome.kind.promise,
                "got": outcome.got,
                "said": message[-MESSAGE_WIDTH:],
            }
        )
    return pd.DataFrame(rows).replace(r"\|", "/", regex=True)


def counts(outcomes: list[Outcome]) -> pd.DataFrame:
    """What came of the kinds, room by room."""
    rooms = [outcome.kind.room for outcome in outcomes]
    results = [outcome.got for outcome in outcomes]
    table = pd.crosstab(pd.Series(rooms), pd.Series(results))
    table = table.reindex(list(dict.fromkeys(rooms)))
    table = table.reindex(columns=[*KEPT, *BROKEN], fill_value=0)

    table.loc["all"] = table.sum()
    table.insert(0, "tried", table.sum(axis=1))
    return table.rename_axis("room").reset_index()


def main(arguments: list[str] | None = None) -> int:
    """Run the battery; the exit code says whether every promise was kept."""
    parser = options_of(__doc__)
    parser.add_argument(
        "--room",
        help="record, estimator, representation, law, model, loop, file, command line",
    )
    parser.add_argument(
        "--failures", action="store_true", help="print only the rows of broken promises"
    )
    options = parser.parse_args(arguments)

    kinds = [kind for kind in every_kind() if options.room in (None, kind.room)]
    outcomes = [judge(kind) for kind in tqdm(kinds, unit="kind", disable=None)]
    broken = [outcome for outcome in outcomes if not outcome.is_good]

    print(markdown(as_table(broken if options.failures else outcomes)))
    print(f"\n{markdown(counts(outcomes))}")
    print(
        f"\n{len(outcomes)} kinds tried, {len(outcomes) - len(broken)} promises kept,"
        f" {len(broken)} broken."
    )
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
