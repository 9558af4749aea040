"""Imported before NumPy: one thread, the measured data, the modules of other folders.

Benchmarks use modules of ``tests`` and ``examples``, and read measured records from the
folder that PYSINDY_NRF_DATA names, ``../shared/data`` if it names none.
"""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ.setdefault("PYSINDY_NRF_DATA", str(ROOT.parent / "shared" / "data"))

for folder in ("benchmarks", "tests", "examples"):
    if str(ROOT / folder) not in sys.path:
        sys.path.append(str(ROOT / folder))
