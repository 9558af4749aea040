"""The benchmark of speed runs, and what it claims of accuracy and memory holds; times depend on who else is here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "benchmarks" / "speed.py"
if not SCRIPT.is_file():
    pytest.skip("the benchmarks are not part of an installed package", allow_module_level=True)


def test_the_quick_run_compares_all_and_misses_no_digit(tmp_path):
    one_core = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    table = tmp_path / "speed.csv"
    run = subprocess.run(
        [sys.executable, str(SCRIPT), "--quick", "--out", str(table)], capture_output=True, text=True, env=one_core
    )
    assert run.returncode == 0, run.stderr[-3000:]
    lines = run.stdout.splitlines()
    verdicts = [line for line in lines if line.rstrip().endswith(("PASS |", "MISS |"))]
    exact = [line for line in verdicts if "QR reference" in line or "memory" in line]
    assert len(exact) == 5 and not [line for line in exact if "MISS" in line], "\n".join(exact)
    assert sum("samples a second" in line for line in verdicts) == 4
    rows = table.read_text().splitlines()
    for by in ("pysindy_nrf", "lstsq per DOF", "LinearRegression", "SINDy, same terms", "SINDy, plain", "FROLS", "pyCC-ID"):
        assert sum(by in row for row in rows) == 2, by
    # every contender says what it took, or why it did not run
    assert all("not run" in row or "does not apply" in row or float(row.split(",")[-6]) > 0 for row in rows[1:] if '"SINDy' not in row)
