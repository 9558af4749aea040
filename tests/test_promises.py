"""The Monte-Carlo report of the promises runs, and its own arithmetic is right."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
if not BENCHMARKS.is_dir():
    pytest.skip("the benchmarks are not part of an installed package", allow_module_level=True)
sys.path.insert(0, str(BENCHMARKS))

import promises  # noqa: E402


def test_a_quick_study_prints_promise_beside_figure(capsys, tmp_path):
    out = tmp_path / "runs.csv"
    table = promises.main(["--part", "intervals", "detection", "--runs", "2", "--jobs", "1", "--out", str(out)])
    said = capsys.readouterr().out
    assert "| 95 % intervals that hold the truth | all | 2 | 92 to 98 |" in said
    assert "promised %" in said and "measured %" in said and "4 runs in" in said
    assert set(table["part"]) <= {*promises.PROMISES, "refused"}
    assert len(pd.read_csv(out)) == len(table)


def test_the_intervals_of_the_report_hold_the_truth():
    """Single figures: the 99 % interval of a rate of 0.9 misses it in about 1 % of many studies."""
    rng, missed = np.random.default_rng(0), 0
    for _ in range(400):
        rows = pd.DataFrame({"run": np.arange(80), "hit": rng.random(80) < 0.9})
        _, low, high = promises.rate(rows)
        missed += not low <= 90 <= high
    assert missed <= stats.binom.ppf(0.999, 400, 0.01)


def test_figures_of_one_run_do_not_count_as_many():
    """Ten copies of each run's figure tell no more than one."""
    rng = np.random.default_rng(1)
    hit = rng.random(60) < 0.8
    once = promises.rate(pd.DataFrame({"run": np.arange(60), "hit": hit}))
    often = promises.rate(pd.DataFrame({"run": np.repeat(np.arange(60), 10), "hit": np.repeat(hit, 10)}))
    assert often[0] == pytest.approx(once[0])
    assert often[2] - often[1] == pytest.approx(once[2] - once[1], rel=0.15)


@pytest.mark.parametrize(
    ("part", "cell", "range_"),
    [
        ("intervals", "all, mass", (92.0, 98.0)),
        ("loop: power", "5 % noise, heard 2 to 4", (85.0, 100.0)),
        ("loop: power", "1 % noise, heard 4 and more", (95.0, 100.0)),
        ("loop: power", "1 % noise, heard 0 to 1", None),
        ("detection: power", "heard 2 to 4", (90.0, 100.0)),
    ],
)
def test_what_is_promised_where(part, cell, range_):
    assert promises.promise_of(part, cell) == range_


def test_broken_promises_are_called_so():
    rows = pd.DataFrame({"part": "loop: false alarms", "cell": "x", "run": range(100), "hit": [i % 2 == 0 for i in range(100)]})
    assert any(line.endswith("| NO |") for line in promises.report(rows))
    kept = rows.assign(hit=True)
    assert not any(line.endswith("| NO |") for line in promises.report(kept))


@pytest.mark.parametrize("heard", [0.0, 0.99, 1.0, 3.0, 50.0, np.inf])
def test_every_strength_has_a_bin(heard):
    low = float(promises.bin_of(heard).split()[1])
    assert low <= heard
