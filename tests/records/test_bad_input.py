"""Every bad input gets an error that names the channel and the cure, or a warning;
never a silent number.
"""

import sys
import warnings
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
if not BENCHMARKS.is_dir():
    pytest.skip(
        "the benchmarks are not part of an installed package", allow_module_level=True
    )
sys.path.insert(0, str(BENCHMARKS))

with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
    from bad_inputs_battery import every_kind, judge

    KINDS = every_kind()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_promise_is_kept(kind):
    outcome = judge(kind)
    assert outcome.kept, (
        f"promised {kind.promise} with {kind.words}, got {outcome.got}:"
        f" {outcome.message}"
    )
