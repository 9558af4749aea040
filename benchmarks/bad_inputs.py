"""Battery of bad inputs: is each named, with channel and cure, and is the user's own
data left as it was?

    python benchmarks/bad_inputs.py                 # one row for each kind, then the counts
    python benchmarks/bad_inputs.py --room file     # one room
    python benchmarks/bad_inputs.py --failures      # only what broke its promise

A kind is *caught* (a typed error, or an exit code of the command line, whose message
names what is wrong, where, and the cure), *warned* of (a typed warning that does), or
*right* (an unusual form of good numbers: the same answer). *Silent* is a number without
a word, *bare* an error of no type of ours or a traceback, *changed* an input that is
not the same to the last bit afterwards.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
sys.path.insert(0, str(Path(__file__).parent))

from bad_inputs_battery import Outcome, every_kind, judge  # noqa: E402
from tqdm import tqdm  # noqa: E402

KEPT = ("caught", "warned", "right")
BROKEN = ("silent", "bare", "changed", "wrong type", "wrong words", "wrong code")


def row(outcome: Outcome) -> str:
    """One line of the table."""
    said = " ".join(outcome.message.split()).replace("|", "/")
    cells = (
        outcome.kind.room,
        outcome.kind.name,
        outcome.kind.promise,
        outcome.got,
        said[-110:],
    )
    return "| " + " | ".join(str(c).replace("|", "/") for c in cells) + " |"


def counts(outcomes: list[Outcome]) -> list[str]:
    """Markdown table of what came of the kinds, room by room."""
    columns = [*KEPT, *BROKEN]
    lines = [
        f"| room | tried | {' | '.join(columns)} |",
        "|---" * (len(columns) + 2) + "|",
    ]
    rooms = list(dict.fromkeys(o.kind.room for o in outcomes))
    for name in [*rooms, "all"]:
        mine = [o for o in outcomes if name in ("all", o.kind.room)]
        got = Counter(o.got for o in mine)
        lines.append(
            f"| {name} | {len(mine)} | {' | '.join(str(got[c]) for c in columns)} |"
        )
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Run the battery; the exit code says whether every promise was kept."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--room",
        help=(
            "record, estimator, representation, law, model, loop, file or command line"
        ),
    )
    parser.add_argument(
        "--failures", action="store_true", help="print only the rows of broken promises"
    )
    options = parser.parse_args(arguments)
    kinds = [k for k in every_kind() if options.room in (None, k.room)]
    outcomes = [judge(kind) for kind in tqdm(kinds, unit="kind", disable=None)]
    shown = [o for o in outcomes if not (options.failures and o.kept)]
    print("| room | kind | promised | got | said |\n|---|---|---|---|---|")
    print("\n".join(map(row, shown)))
    print("\n" + "\n".join(counts(outcomes)))
    broken = [o for o in outcomes if not o.kept]
    print(
        f"\n{len(outcomes)} kinds tried, {len(outcomes) - len(broken)} promises kept,"
        f" {len(broken)} broken."
    )
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
