"""Lines and branches of the package that the tests run, counted where CI asks for it.

``PYSINDY_NRF_COUNTED`` names a folder; every process of the tests leaves its counts there (``.ci/verdict.py`` adds them
up). Counting makes a test half as long again, so the slowest files, which run little that no other does, are not
counted; ``.ci/coverage`` counts everything. Imported before the package, whose own lines run when it is imported.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

# Whole runs of the loop, of the examples and of the benchmarks.
UNCOUNTED = {
    "test_battery_generators.py",
    "test_benchmark_foundation.py",
    "test_benchmark_noise.py",
    "test_benchmark_speed.py",
    "test_catalogue.py",
    "test_close_loop.py",
    "test_close_loop_names.py",
    "test_close_loop_noise_floor.py",
    "test_docs.py",
    "test_examples.py",
    "test_fuzz.py",
    "test_measured_loop.py",
    "test_mutation.py",
    "test_paper.py",
    "test_promises.py",
    "test_readme.py",
    "test_second_opinion.py",
    "test_sklearn_checks.py",
}


class Counter:
    """Counts while told to."""

    def __init__(self, folder: str) -> None:
        from coverage import Coverage

        root = Path(__file__).resolve().parents[1]
        self.coverage = Coverage(
            data_file=str(Path(folder) / "counted"), data_suffix=True, config_file=str(root / "pyproject.toml")
        )
        self.coverage.set_option("run:patch", [])  # processes that a test starts are not counted
        self.coverage.start()
        self.counts = True

    def turn(self, counts: bool) -> None:
        """Go on counting, or stop."""
        if counts != self.counts:
            self.counts = counts
            (self.coverage.start if counts else self.coverage.stop)()

    def end(self) -> None:
        """Leave what was counted in the folder."""
        self.turn(False)
        self.coverage.save()


FOLDER = os.environ.pop("PYSINDY_NRF_COUNTED", "") if os.environ.get("PYTEST_XDIST_WORKER") else ""
COUNTER: Any = Counter(FOLDER) if FOLDER else None
