"""Damaged files are read or refused by name: no other exception, no dead process, no hang, no hunger for memory."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf import ChainModel, Site
from pysindy_nrf.data.io import read_record, read_table
from pysindy_nrf.data.io.mapping import line_of, parse
from pysindy_nrf.data.io.table import Table
from pysindy_nrf.data.io.units import factor
from pysindy_nrf.exceptions import FileFormatError, NRFError

pytestmark = pytest.mark.fuzz
BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
if not BENCHMARKS.is_dir():
    pytest.skip("the benchmarks are not part of an installed package", allow_module_level=True)
sys.path.insert(0, str(BENCHMARKS))

from fuzz import fuzz  # noqa: E402
from fuzzing.targets import TARGETS  # noqa: E402


def test_some_seconds_of_damaged_files():
    found = fuzz("all", seed=int(os.environ.get("FUZZ_SEED", 0)), seconds=4.0)
    assert not found["failures"], "\n".join(map(str, found["failures"]))
    assert found["refused"] > len(TARGETS) and found["read"] > 0
    assert found["peak"] < 1500  # MB


def written(suffix: str, content: bytes) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="fuzz"))
    path = folder / ("test" + suffix)
    path.write_bytes(content)
    return path


def attempt(read, path: Path) -> None:
    try:
        read(path)
    except NRFError as error:
        assert str(error)
    finally:
        path.unlink()
        path.parent.rmdir()


@given(st.sampled_from([".csv", ".npy", ".npz", ".mat", ".h5", ".parquet", ".v2", ".uff"]), st.binary(max_size=400))
def test_bytes_of_no_meaning(suffix, content):
    attempt(read_table, written(suffix, content))


CELLS = st.one_of(
    st.floats(-1e6, 1e6).map(repr),
    st.sampled_from(["nan", "", "1,5", "inf", "-", "1e400", '"', "2024-05-01", "0x10", "1_000", "٣", "#", "'", "True", "1e5j"]),
)


@given(
    st.lists(st.sampled_from(["t", "a1", "x1", "F1", "v1 [mm/s]", "a_1", "t [ms]", "", "<b>", "a1 [g]", "volt"]), min_size=1, max_size=4),
    st.lists(st.lists(CELLS, min_size=1, max_size=4), max_size=8),
    st.sampled_from([",", ";", "\t", " ", "|"]),
)
@settings(max_examples=60)
def test_tables_someone_typed(header, rows, separator):
    text = "\n".join(separator.join(row) for row in [header, *rows])
    attempt(read_record, written(".csv", text.encode()))


@given(st.text(max_size=60))
@settings(max_examples=100)
def test_the_small_grammars_take_any_text(text):
    table = Table(Path("x.csv"), "memory", {"a": np.ones((5, 2)), "x1": np.ones(5), "k": np.array(3.0)})
    for use in (lambda: line_of(parse(text, table, "x1"), table, "x1"), lambda: factor(text, "a1"), lambda: Site(text)):
        try:
            assert use() is not None
        except NRFError as error:
            assert error.what


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)


@given(st.sampled_from(["chain", "masses", "laws", "visited", "info", "version", "schema"]), JSON)
@settings(max_examples=150)
def test_models_with_one_part_exchanged(key, value):
    data = json.loads(TARGETS["model JSON"].seeds()[0])
    data[key] = value
    try:
        model = ChainModel.from_json(json.dumps(data))
    except FileFormatError:
        return
    assert model.n_dof == 3 and np.isfinite(model.masses).all()
