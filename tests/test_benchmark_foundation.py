"""What benchmarks/foundation.py claims holds on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "benchmarks" / "foundation.py"
if not SCRIPT.is_file():
    pytest.skip("the benchmarks are not part of an installed package", allow_module_level=True)


def test_no_row_fails():
    one_core = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    run = subprocess.run([sys.executable, str(SCRIPT), "--quick"], capture_output=True, text=True, env=one_core)
    lines = run.stdout.splitlines()
    failed = [line for line in lines if line.endswith("| FAIL |")]
    assert not failed and run.returncode == 0, "\n".join([*failed, run.stderr[-3000:]])
    assert sum(line.startswith("## ") for line in lines) == 9
    assert sum(line.endswith("| PASS |") for line in lines) >= 58
