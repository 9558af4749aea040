"""Adds up what the processes of the tests have counted; fails below 95 % of the lines or branches of the package.

    python .ci/verdict.py FOLDER          # of files "counted.*"
    python .ci/verdict.py coverage.json   # of a report
"""

import json
import sys
from pathlib import Path

LEAST = 0.95


def report(folder: Path) -> Path:
    """The counts of all processes as one report."""
    from coverage import Coverage

    whole = Coverage(data_file=str(folder / "counted"), config_file="pyproject.toml")
    whole.combine([str(folder)])
    whole.save()
    out = folder / "coverage.json"
    whole.json_report(outfile=str(out))
    return out


given = Path(sys.argv[1])
total = json.loads((report(given) if given.is_dir() else given).read_text())["totals"]
found = {
    "lines": (total["covered_lines"], total["num_statements"]),
    "branches": (total["covered_branches"], total["num_branches"]),
}
print("\n| | run by the tests | of | % |\n|---|---|---|---|")
for what, (run, of) in found.items():
    print(f"| {what} | {run} | {of} | {100 * run / of:.1f} |")
sys.exit(int(any(run < LEAST * of for run, of in found.values())))
