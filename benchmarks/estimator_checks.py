"""How many of scikit-learn's estimator checks fail, ours beside PySINDy's own, in one
run.

    python benchmarks/estimator_checks.py [--list]

Ours that need columns in threes are checked behind the padding of ``tests/padded.py``
and, in a second table, without it: there every failure must be our own error that names
the number of columns. An ``NRFRegressor()`` that finds the number of DOFs itself takes
the three columns of one check, ten rows with a NaN in the first, for one DOF with a
masked edge.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import padded  # noqa: E402
import pysindy as ps  # noqa: E402
import sklearn  # noqa: E402
from sklearn.utils.estimator_checks import check_estimator  # noqa: E402


def failed(estimator) -> tuple[list[dict], int]:
    """Failed checks, and how many were run."""
    results = [
        r
        for r in check_estimator(estimator, on_fail=None, on_skip=None)
        if r["status"] != "skipped"
    ]
    return [r for r in results if r["status"] == "failed"], len(results)


def first_line(error: BaseException) -> str:
    """What an error says first; its name where it says nothing."""
    return (str(error).splitlines() or [type(error).__name__])[0][:110]


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--list", action="store_true", help="name every failing check")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(f"scikit-learn {sklearn.__version__}, PySINDy {ps.__version__}\n")
    print("| estimator | checks failed | of | why |\n|---|---|---|---|")
    worst = 0
    for estimator, reasons in [
        (ps.SINDy(), None),
        (ps.STLSQ(), None),
        (ps.PolynomialLibrary(), None),
        *padded.cases(),
    ]:
        bad, size = failed(estimator)
        why = "" if reasons is None else "; ".join(dict.fromkeys(reasons.values()))
        print(
            f"| {type(estimator).__name__}{' (PySINDy)' if reasons is None else ''} |"
            f" {len(bad)} | {size} | {why} |"
        )
        worst = max(worst, len(bad)) if reasons is not None else worst
        if options.list:
            print(
                *(f"    {r['check_name']}: {first_line(r['exception'])}" for r in bad),
                sep="\n",
            )
    print(
        "\n| without padding | checks failed | of | by our own column count"
        " |\n|---|---|---|---|"
    )
    for estimator in padded.direct():
        bad, size = failed(estimator)
        own = sum(padded.own_column_error(r) for r in bad)
        print(f"| {estimator} | {len(bad)} | {size} | {own} |")
        if options.list:
            print(
                *(f"    {r['check_name']}: {first_line(r['exception'])}" for r in bad),
                sep="\n",
            )
    return int(worst > 3)


if __name__ == "__main__":
    sys.exit(main())
