"""Damaged files are read or refused by name; no process hangs or dies."""

import os
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records.files import read_record

fuzzing = pytest.importorskip("fuzz", reason="benchmarks are not installed")
pytestmark = pytest.mark.fuzz
MAX_MEMORY = 1500  # MB
FILES_OF_A_READER = 6


@pytest.mark.slow
def test_damaged_files_of_every_reader():
    from fuzzing.targets import TARGETS

    seed = int(os.environ.get("FUZZ_SEED", 0))
    n_files = FILES_OF_A_READER * len(TARGETS)
    outcome = fuzzing.fuzz("all", seed=seed, n_files=n_files)
    assert not outcome.failures, "\n".join(map(str, outcome.failures))
    assert outcome.read + outcome.refused == n_files
    assert outcome.refused > len(TARGETS)
    assert outcome.read > 0
    assert outcome.peak < MAX_MEMORY


ODD_CELLS = "nan inf - 1,5 1e400 2024-05-01 0x10 1_000 ٣ # ' True 1e5j".split()
NAMES = [
    "t",
    "a1",
    "x1",
    "F1",
    "v1 [mm/s]",
    "a_1",
    "t [ms]",
    "",
    "<b>",
    "a1 [g]",
    "volt",
]
CELLS = st.floats(-1e6, 1e6).map(repr) | st.sampled_from(["", '"', *ODD_CELLS])
HEADERS = st.lists(st.sampled_from(NAMES), min_size=1, max_size=4)
ROWS = st.lists(st.lists(CELLS, min_size=1, max_size=4), max_size=8)


@given(HEADERS, ROWS, st.sampled_from([",", ";", "\t", " ", "|"]))
@settings(max_examples=60)
def test_tables_someone_typed(header, rows, separator):
    lines = [separator.join(cells) for cells in [header, *rows]]
    with tempfile.TemporaryDirectory(prefix="fuzz") as folder:
        path = Path(folder, "test.csv")
        path.write_text("\n".join(lines), encoding="utf-8", newline="")
        try:
            read_record(path)
        except NRFError as error:
            assert str(error)
