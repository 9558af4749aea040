"""The verdicts that the README prints, one row a record.

    python benchmarks/readme_numbers.py
    python benchmarks/readme_numbers.py "bundled frame"

Linear storeys are declared, nothing else. A test compares the rows with the README.
Measured records are read from the folder that PYSINDY_NRF_DATA names.
"""

from __future__ import annotations

import search_path
import measured_sets
from harness import options_of, quietly

from pysindy_nrf import NRFRegressor, close_loop, datasets

RECORDS = {
    "bundled frame": datasets.load_demo,
    "EMPS positioning stage": measured_sets.load_emps,
}


def line(name: str) -> str:
    """Record, verdict, held-out balance error before and after."""
    report = quietly(close_loop, RECORDS[name](), NRFRegressor(degree=1))
    before = report.table["held-out"].iloc[0]
    after = report.final["held-out"]
    verdict = report.verdict
    return (
        f"| {name} | {verdict.state}: {verdict.sentence} | {before:.3g} to"
        f" {after:.3g} % |"
    )


def main(arguments: list[str] | None = None) -> None:
    """Print the rows."""
    parser = options_of(__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(RECORDS)}")
    options = parser.parse_args(arguments)
    for name in options.names or RECORDS:
        print(line(name), flush=True)


if __name__ == "__main__":
    main()
