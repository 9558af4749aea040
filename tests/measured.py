"""Where the measured records are; a test without them is skipped."""

import os
from pathlib import Path

import pytest


def folder(name: str) -> Path:
    """The folder of measured sets, if it holds the set."""
    root = Path(os.environ["PYSINDY_NRF_DATA"])
    if not (root / name).is_dir():
        pytest.skip(f"measured set {name} is not in {root}; set PYSINDY_NRF_DATA")
    return root
