"""The verdicts that the README prints, one line a record: ``python
benchmarks/readme_numbers.py [NAME...]``.

A test compares them with the README. Measured records are read from the folder that
PYSINDY_NRF_DATA names.
"""

import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

import measured_sets  # noqa: E402

from pysindy_nrf import NRFRegressor, close_loop, datasets  # noqa: E402

RECORDS = {
    "bundled frame": (datasets.load_demo, None),
    "EMPS positioning stage": (measured_sets.load_emps, None),
}


def line(name: str) -> str:
    """The row of the README's table: record, verdict, held-out balance error before and
    after.
    """
    load, masses = RECORDS[name]
    with warnings.catch_warnings(action="ignore"):
        report = close_loop(load(), NRFRegressor(degree=1, known_masses=masses))
    before, after = report.table["held-out"].iloc[0], report.final["held-out"]
    verdict = report.verdict
    return (
        f"| {name} | {verdict.state}: {verdict.sentence} | {before:.3g} to"
        f" {after:.3g} % |"
    )


if __name__ == "__main__":
    for chosen in sys.argv[1:] or RECORDS:
        print(line(chosen), flush=True)
