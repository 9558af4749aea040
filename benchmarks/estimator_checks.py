"""How many of scikit-learn's estimator checks fail, ours beside PySINDy's own.

    python benchmarks/estimator_checks.py [--list]

Ours that need columns in threes are checked behind the padding of ``tests/padded.py``
and, in a second table, without it: there every failure must be our own error that names
the number of columns. An ``NRFRegressor()`` that finds the number of DOFs itself takes
the three columns of one check, ten rows with a NaN in the first, for one DOF with a
masked edge. ``--list`` names every failing check.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import search_path
import padded
import pandas as pd
import pysindy as ps
import sklearn
from harness import markdown, options_of, quietly
from sklearn.utils.estimator_checks import check_estimator

ACCEPTED = 3  # failing checks of an estimator of ours, each with its reason


@dataclass(frozen=True)
class Checked:
    """Checks of one estimator that failed, and how many were run."""

    estimator: Any
    failed: list[dict]
    n_checks: int
    reasons: dict[str, str] | None = None

    @property
    def name(self) -> str:
        """Class of the estimator, and whether it is PySINDy's."""
        name = type(self.estimator).__name__
        return f"{name} (PySINDy)" if self.reasons is None else name


def checked(estimator: Any, reasons: dict[str, str] | None = None) -> Checked:
    """Run all checks of an estimator."""
    results = quietly(check_estimator, estimator, on_fail=None, on_skip=None)
    results = [result for result in results if result["status"] != "skipped"]
    failed = [result for result in results if result["status"] == "failed"]
    return Checked(estimator, failed, len(results), reasons)


def with_padding() -> list[Checked]:
    """PySINDy's own estimators, then ours behind a padding of their columns."""
    theirs = (ps.SINDy(), ps.STLSQ(), ps.PolynomialLibrary())
    results = [checked(estimator) for estimator in theirs]
    for estimator, reasons in padded.cases():
        results.append(checked(estimator, reasons))
    return results


def padded_table(results: list[Checked]) -> pd.DataFrame:
    """Failures of each estimator, and why ours are expected."""
    rows = []
    for result in results:
        why = dict.fromkeys((result.reasons or {}).values())
        rows.append([result.name, len(result.failed), result.n_checks, "; ".join(why)])
    return pd.DataFrame(rows, columns=["estimator", "checks failed", "of", "why"])


def direct_table(results: list[Checked]) -> pd.DataFrame:
    """Failures without padding, and how many are our own error about columns."""
    rows = []
    for checked_pair in results:
        ours = sum(padded.own_column_error(result) for result in checked_pair.failed)
        rows.append(
            [
                str(checked_pair.estimator),
                len(checked_pair.failed),
                checked_pair.n_checks,
                ours,
            ]
        )
    columns = ["without padding", "checks failed", "of", "by our own column count"]
    return pd.DataFrame(rows, columns=columns)


def failing_checks(results: list[Checked]) -> list[str]:
    """Names of all checks that failed, with the first line of their error."""
    lines = []
    for checked_pair in results:
        lines.append(checked_pair.name)
        for result in checked_pair.failed:
            error = result["exception"]
            first_line = (str(error).splitlines() or [type(error).__name__])[0]
            lines.append(f"    {result['check_name']}: {first_line[:110]}")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Print the tables; the exit code says whether ours fail more than is accepted."""
    parser = options_of(__doc__)
    parser.add_argument("--list", action="store_true", help="name every failing check")
    options = parser.parse_args(arguments)

    padding = with_padding()
    direct = [checked(estimator, {}) for estimator in padded.direct()]
    print(f"scikit-learn {sklearn.__version__}, PySINDy {ps.__version__}\n")
    print(markdown(padded_table(padding)))
    print(f"\n{markdown(direct_table(direct))}")
    if options.list:
        print("\n".join(["", *failing_checks([*padding, *direct])]))

    ours = [len(result.failed) for result in padding if result.reasons is not None]
    return int(max(ours) > ACCEPTED)


if __name__ == "__main__":
    sys.exit(main())
