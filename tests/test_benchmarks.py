"""The quick settings of the benchmarks run from end to end, and what they claim of accuracy holds."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import noise
import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
pytestmark = pytest.mark.examples


def run(script: str, *options: str) -> str:
    """Output of a benchmark on one core."""
    one_core = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / script), *options], capture_output=True, text=True, env=one_core
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    return done.stdout


def test_no_row_of_the_foundation_fails():
    lines = run("foundation.py", "--quick").splitlines()
    assert not [line for line in lines if line.endswith("| FAIL |")]
    assert sum(line.startswith("## ") for line in lines) == 9
    assert sum(line.endswith("| PASS |") for line in lines) >= 58


def test_the_speed_table_compares_all_and_loses_no_digit(tmp_path):
    table = tmp_path / "speed.csv"
    verdicts = [
        line
        for line in run("speed.py", "--quick", "--out", str(table)).splitlines()
        if line.rstrip().endswith(("PASS |", "MISS |"))
    ]
    exact = [line for line in verdicts if "QR reference" in line or "memory" in line]
    assert len(exact) == 5 and not [line for line in exact if "MISS" in line], exact
    rows = table.read_text().splitlines()
    for by in ("pysindy_nrf", "lstsq per DOF", "LinearRegression", "SINDy, same terms", "SINDy, plain", "FROLS"):
        assert sum(by in row for row in rows) == 2, by


def test_promises_are_printed_beside_what_was_measured():
    said = run("promises.py", "--part", "intervals", "detection", "--runs", "2", "--jobs", "1")
    assert "| 95 % intervals that hold the truth | all | 2 | 92 to 98 |" in said


def test_instruments_recover_masses_that_raw_channels_lose(capsys):
    for part in ("hammer", "intervals", "frequency response"):
        noise.main(["--seconds", "4", "--seeds", "1", "--repetitions", "2", "--jobs", "1", "--only", part])
    rows = {line.split("  ")[0]: line.split("  ") for line in capsys.readouterr().out.splitlines()}
    raw, iv = (float(next(x for x in rows[name][1:] if x).split()[0]) for name in ("ls, raw channels", "iv"))
    assert iv < 3 < 20 < raw


def test_estimates_stay_above_the_cramer_rao_bound_and_near_it():
    """Weighted instruments for the masses: within three of the smallest standard deviations there can be."""
    found = np.array([noise.quietly(noise.one, "5 %, hammer", "iv", seed) for seed in range(2)])
    ratio = np.sqrt(np.mean(found[:, : noise.N] ** 2)) / noise.bound("5 %, hammer", 0)[: noise.N].mean()
    assert 0.3 < ratio < 3.0
