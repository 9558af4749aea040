"""Every bad input gets an error that names the channel and the cure, or a warning."""

import warnings

import pytest

battery = pytest.importorskip(
    "bad_inputs_battery", reason="the benchmarks are not part of an installed package"
)
with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
    KINDS = battery.every_kind()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_promise_is_kept(kind):
    outcome = battery.judge(kind)
    assert outcome.is_good, (
        f"promised {kind.promise} with {kind.words}, got {outcome.got}:"
        f" {outcome.message}"
    )
