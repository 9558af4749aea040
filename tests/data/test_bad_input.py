"""Every bad input gets an error that names the channel and the cure, or a warning; never a silent number."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
if not BENCHMARKS.is_dir():
    pytest.skip("the benchmarks are not part of an installed package", allow_module_level=True)
sys.path.insert(0, str(BENCHMARKS))

with warnings.catch_warnings():
    warnings.simplefilter("ignore", RuntimeWarning)
    from bad_inputs_battery import Kind, every_kind, judge

    KINDS = every_kind()

from pysindy_nrf.exceptions import BiasWarning, ChannelError, DataQualityWarning  # noqa: E402


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_promise_is_kept(kind):
    outcome = judge(kind)
    assert outcome.kept, f"promised {kind.promise} with {kind.words}, got {outcome.got}: {outcome.message}"


# -- the judge itself is judged -------------------------------------------------------------------


def spoil(x):
    x[3] = 0.0
    raise ChannelError("Channel a1 is bad", "Repair it.")


def wrong_number(x):
    warnings.warn(BiasWarning("The masses are likely biased", "Measure again."), stacklevel=2)
    return x.sum()


@pytest.mark.parametrize(
    ("act", "expected", "words", "got"),
    [
        (lambda x: x.sum(), ChannelError, (), "silent"),
        (lambda x: 1 / 0, ChannelError, (), "bare"),
        (lambda x: {}["a"], ChannelError, (), "bare"),
        (spoil, ChannelError, (), "changed"),
        (wrong_number, DataQualityWarning, (), "silent"),
        (wrong_number, BiasWarning, ("masses", "Measure"), "warned"),
        (wrong_number, BiasWarning, ("drift",), "wrong words"),
        (lambda x: x.sum(), lambda value: value == 4.0, (), "silent"),
        (lambda x: x.sum(), lambda value: value == 5.0, (), "right"),
    ],
)
def test_the_judge_sees_broken_promises(act, expected, words, got):
    assert judge(Kind("none", "none", act, (np.ones(5),), expected, words)).got == got
