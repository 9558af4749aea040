"""Units against their definitions; a unit of another dimension is refused by name."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf.data.io import read_record
from pysindy_nrf.data.io.units import factor, is_unit
from pysindy_nrf.exceptions import ChannelError, MissingExtraError

pytest.importorskip("pint")

# By definition: 1 in = 0.0254 m, 1 lb = 0.45359237 kg, g = 9.80665 m/s^2, 1 gal = 1 cm/s^2, 1 kip = 1000 lbf.
POUND_FORCE = 0.45359237 * 9.80665
DEFINED = {
    ("mm", "x1"): 1e-3, ("MM", "x1"): 1e-3, ("in", "xg"): 0.0254, ("inches", "x1"): 0.0254, ("Inch", "x1"): 0.0254,
    ("mil", "x1"): 2.54e-5, ("ft", "x1"): 0.3048, ("µm", "x1"): 1e-6, ("μm", "x1"): 1e-6, ("um", "x1"): 1e-6,
    ("g", "a1"): 9.80665, ("G", "a1"): 9.80665, ("mg", "ag"): 9.80665e-3, ("Gal", "a1"): 0.01, ("cm/s^2", "a1"): 0.01,
    ("CM/SEC/SEC", "a1"): 0.01, ("cm/sec2", "a1"): 0.01, ("in/s^2", "a1"): 0.0254, ("mm/s²", "a1"): 1e-3,
    ("m·s⁻²", "a1"): 1.0, ("ms-2", "a1"): 1.0, ("m s^-2", "a1"): 1.0, ("[m/s2]", "a1"): 1.0, ("cm/s", "vg"): 0.01,
    ("N", "F1"): 1.0, ("kN", "F1"): 1e3, ("KN", "F1"): 1e3, ("MN", "F1"): 1e6, ("mN", "F1"): 1e-3,
    ("lbf", "F1"): POUND_FORCE, ("lb", "F1"): POUND_FORCE, ("kip", "F1"): 1e3 * POUND_FORCE,
    ("kips", "F1"): 1e3 * POUND_FORCE, ("kgf", "F1"): 9.80665, ("ms", "t"): 1e-3, ("min", "t"): 60.0,
}  # fmt: skip


@pytest.mark.parametrize(("unit", "channel"), DEFINED, ids=lambda x: x)
def test_factors_are_those_of_the_definitions(unit, channel):
    assert factor(unit, channel) == pytest.approx(DEFINED[unit, channel], rel=1e-14)


@pytest.mark.parametrize(
    ("unit", "channel", "words"),
    [
        ("mm", "F1", "F1 is a force, but its unit 'mm' measures length"),
        ("g", "F2", "F2 is a force, but its unit 'g' measures acceleration"),
        ("kg", "F1", "a force.*measures mass"),
        ("N", "a3", "a3 is an acceleration.*measures force"),
        ("m/s", "a1", "an acceleration.*measures velocity"),
        ("kN", "x2", "x2 is a displacement.*measures force"),
        ("kN/mm", "F1", "a force.*measures a stiffness"),
        ("Hz", "t", "t is the time.*measures a frequency"),
        ("deg", "x1", "a number or an angle"),
        ("wug", "x1", "'wug' of channel x1 is unknown"),
        ("mV", "F1", "unknown"),
    ],
)
def test_a_wrong_dimension_is_refused(unit, channel, words):
    with pytest.raises(ChannelError, match=words):
        factor(unit, channel)


@given(st.text(max_size=40))
def test_no_text_runs_or_hangs(text):
    try:
        assert np.isfinite(factor(text, "x1"))
    except ChannelError:
        pass
    is_unit(text)


@pytest.mark.parametrize(
    "text", ["9**9**9**9", "mm**999999999", "m/" * 10000, "__import__('os').system('x')", "1e999 m"]
)
def test_expressions_are_not_evaluated(text):
    with pytest.raises(ChannelError):
        factor(text, "x1")


def test_directions_in_brackets_are_no_units(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,acc (N),acc (S),laser (mm)\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    rec = read_record(path, mapping={"a1": "acc (N)", "a2": "acc (S)", "x1": "laser"})
    np.testing.assert_array_equal(rec.acceleration, [[1, 2], [2, 3], [3, 4]])
    np.testing.assert_allclose(rec.displacement[:, 0], [3e-3, 4e-3, 5e-3])


def test_without_pint_si_still_reads_and_the_rest_says_what_to_install(tmp_path, monkeypatch):
    import builtins

    from pysindy_nrf.data.io import units

    real = builtins.__import__
    monkeypatch.setattr("importlib.import_module", _without("pint"))
    monkeypatch.setattr(builtins, "__import__", lambda n, *a, **k: _refuse(n) if n == "pint" else real(n, *a, **k))
    units._registry.cache_clear()
    units._parsed.cache_clear()
    try:
        pd.DataFrame({"t [s]": [0.0, 1, 2], "a1 [m/s²]": [1.0, 2, 3], "F1 [N]": [1.0, 2, 3]}).to_csv(
            tmp_path / "si.csv", index=False
        )
        assert read_record(tmp_path / "si.csv").acceleration[2, 0] == 3
        with pytest.raises(MissingExtraError, match=r"pysindy_nrf\[files\]"):
            read_record(tmp_path / "si.csv", units={"a": "g"})
    finally:
        units._registry.cache_clear()
        units._parsed.cache_clear()


def _refuse(name):
    raise ImportError(name)


def _without(package):
    import importlib

    real = importlib.import_module
    return lambda name, *rest: _refuse(name) if name.split(".")[0] == package else real(name, *rest)
