"""Damaged files are read or refused by name: no other exception, no dead process, no
hang, no hunger for memory.
"""

import os
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records.files import read_record

pytestmark = pytest.mark.fuzz
BENCHMARKS = Path(__file__).resolve().parents[3] / "benchmarks"
if not BENCHMARKS.is_dir():
    pytest.skip(
        "the benchmarks are not part of an installed package", allow_module_level=True
    )
sys.path.insert(0, str(BENCHMARKS))

from fuzz import fuzz  # noqa: E402
from fuzzing.targets import TARGETS  # noqa: E402


def test_some_seconds_of_damaged_files():
    found = fuzz("all", seed=int(os.environ.get("FUZZ_SEED", 0)), seconds=4.0)
    assert not found.failures, "\n".join(map(str, found.failures))
    assert found.refused > len(TARGETS) and found.read > 0
    assert found.peak < 1500  # MB


CELLS = st.one_of(
    st.floats(-1e6, 1e6).map(repr),
    st.sampled_from(
        [
            "nan",
            "",
            "1,5",
            "inf",
            "-",
            "1e400",
            '"',
            "2024-05-01",
            "0x10",
            "1_000",
            "٣",
            "#",
            "'",
            "True",
            "1e5j",
        ]
    ),
)


@given(
    st.lists(
        st.sampled_from(
            [
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
        ),
        min_size=1,
        max_size=4,
    ),
    st.lists(st.lists(CELLS, min_size=1, max_size=4), max_size=8),
    st.sampled_from([",", ";", "\t", " ", "|"]),
)
@settings(max_examples=60)
def test_tables_someone_typed(header, rows, separator):
    text = "\n".join(separator.join(row) for row in [header, *rows])
    with tempfile.TemporaryDirectory(prefix="fuzz") as folder:
        path = Path(folder, "test.csv")
        path.write_text(text, encoding="utf-8", newline="")
        try:
            read_record(path)
        except NRFError as error:
            assert str(error)
