"""SEP005 dictionaries as other packages pass them."""

import numpy as np
import pytest

from pysindy_nrf.data.io import from_sep005
from pysindy_nrf.exceptions import ChannelError

T = np.arange(100) / 50


def channel(name, data, unit, **more):
    return {"name": name, "data": data, "unit_str": unit, "fs": 50.0, **more}


def test_units_and_names():
    pytest.importorskip("pint")
    channels = [channel("a1", np.sin(T), "g"), channel("Hammer", np.cos(T), "kN"), channel("x1", T, "mm", quantity="d")]
    rec = from_sep005(channels, mapping={"F1": "Hammer"}, name="hit 3")
    assert rec.fs == 50 and rec.name == "hit 3" and rec.forced == (1,)
    np.testing.assert_allclose(rec.acceleration[:, 0], 9.80665 * np.sin(T), rtol=1e-14)
    np.testing.assert_allclose(rec.force[:, 0], 1e3 * np.cos(T), rtol=1e-14)
    np.testing.assert_allclose(rec.displacement[:, 0], 1e-3 * T, rtol=1e-14)


def test_time_in_place_of_a_rate():
    rec = from_sep005([{"name": "a1", "data": T, "unit_str": "m/s²", "time": 3 + T}])
    assert rec.fs == 50 and rec.t0 == 3


def test_the_callers_arrays_are_left_alone():
    data = np.ones(10)
    rec = from_sep005([channel("a1", data, "m/s^2")])
    rec.acceleration[:] = 7
    assert (data == 1).all() or not np.shares_memory(data, rec.acceleration)


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ([], "no SEP005 channel"),
        ([channel("a1", T, "m/s^2") | {"fs": 25.0}, channel("a2", T, "m/s^2")], "differ in fs: 'a1' 25.0, 'a2' 50.0"),
        (
            [
                channel("a1", T, "m/s^2", start_timestamp="2024-05-01T12:00:00"),
                channel("a2", T, "m/s^2", start_timestamp="2024-05-01T12:00:01"),
            ],
            "differ in start_timestamp",
        ),
        ([{"name": "a1", "data": T, "unit_str": "m"}], "'a1' lacks fs or time"),
        ([{"data": T, "fs": 1.0}], "number 1' lacks name, unit_str"),
        ([channel("a1", T, "m/s^2"), channel("a1", T, "m/s^2")], "Two SEP005 channels are named 'a1'"),
        ([channel("a1", np.ones((4, 2)), "m/s^2")], r"shape \(4, 2\)"),
        ([channel("a1", T, "m/s^2"), channel("x1", T[:9], "m")], "differ in length"),
        ([channel("F1", T, "mm"), channel("x1", T, "m")], "F1 is a force, but its unit 'mm'"),
    ],
)
def test_what_does_not_fit_is_named(channels, words):
    if "mm" in words:
        pytest.importorskip("pint")
    with pytest.raises(ChannelError, match=words):
        from_sep005(channels)


@pytest.mark.parametrize("fs", [0, -100.0, float("inf"), "fast", 10**400])
def test_a_rate_that_is_none_is_refused(fs):
    with pytest.raises(ChannelError, match="'acc' has fs = "):
        from_sep005([{"data": np.zeros(9), "name": "acc", "unit_str": "m/s^2", "fs": fs}])
