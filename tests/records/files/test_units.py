"""Units against their definitions; a unit of another dimension is refused by name."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from text_tables import rows_of

from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import si_factor
from pysindy_nrf.records.files import read_record

pytest.importorskip("pint")

# By definition: 1 in = 0.0254 m, g = 9.80665 m/s^2, 1 gal = 1 cm/s^2, 1 lbf =
# 0.45359237 kg g, 1 kip = 1000 lbf.
DEFINITIONS = """
    mm          x1  1e-3
    MM          x1  1e-3
    in          xg  0.0254
    inches      x1  0.0254
    Inch        x1  0.0254
    mil         x1  2.54e-5
    ft          x1  0.3048
    µm          x1  1e-6
    μm          x1  1e-6
    um          x1  1e-6
    cm/s        vg  0.01
    in/s        v2  0.0254
    g           a1  9.80665
    G           a1  9.80665
    mg          ag  9.80665e-3
    g's         a1  9.80665
    m.s-2       a1  1
    m.s^-2      a1  1
    m.s⁻²       a1  1
    m·s⁻²       ag  1
    m/(s^2)     a1  1
    mps2        a1  1
    м/с²        a1  1
    cm/sec2.    a1  0.01
    ips         v1  0.0254
    mm.         x1  1e-3
    Zoll        x1  0.0254
    Gal         a1  0.01
    cm/s^2      a1  0.01
    CM/SEC/SEC  a1  0.01
    cm/sec2     a1  0.01
    cm/s/s      a1  0.01
    in/s^2      a1  0.0254
    mm/s²       a1  1e-3
    m·s⁻²       a1  1.0
    ms-2        a1  1.0
    m s^-2      a1  1.0
    [m/s2]      a1  1.0
    N           F1  1.0
    kN          F1  1e3
    KN          F1  1e3
    MN          F1  1e6
    mN          F1  1e-3
    lbf         F1  4.4482216152605
    lb          F1  4.4482216152605
    kip         F1  4448.2216152605
    kips        F1  4448.2216152605
    kgf         F1  9.80665
    ms          t   1e-3
    min         t   60.0
    rad         x1  1
    deg         x1  0.017453292519943295
    rad/s       v1  1
    rpm         v1  0.10471975511965977
    deg/s       v1  0.017453292519943295
    rad/s^2     a1  1
    N.m         F1  1
    Nm          F1  1
    kNm         F1  1e3
    Nmm         F1  1e-3
    lbf*ft      F1  1.3558179483314004
"""
OTHER_DIMENSIONS = """
    mm     F1  F1 is a force.*measures length
    g      F2  F2 is a force.*measures acceleration
    kg     F1  a force.*measures mass
    N      a3  a3 is an acceleration.*measures force
    m/s    a1  an acceleration.*measures velocity
    kN     x2  x2 is a displacement.*measures force
    kN/mm  F1  a force.*measures a stiffness
    Hz     t   t is the time.*measures a frequency
    Hz     v1  a velocity.*measures a frequency
    J      F1  a force.*measures energy
    wug    x1  'wug' of channel x1
    mV     F1  unknown
    K      temperature  'temperature' is a covariate
"""


@pytest.mark.parametrize(("unit", "channel", "size"), rows_of(DEFINITIONS))
def test_factors_are_those_of_the_definitions(unit, channel, size):
    assert si_factor(unit, channel) == pytest.approx(float(size), rel=1e-14)


@pytest.mark.parametrize(("unit", "channel", "words"), rows_of(OTHER_DIMENSIONS))
def test_units_of_other_dimensions_are_refused(unit, channel, words):
    with pytest.raises(ChannelError, match=words):
        si_factor(unit, channel)


@pytest.mark.parametrize(
    "text",
    ["9**9**9**9", "mm**999999999", "m/" * 10000, "__import__('os')", "1e999 m"],
    ids=range(5),
)
def test_expressions_are_not_evaluated(text):
    with pytest.raises(ChannelError, match="x1"):
        si_factor(text, "x1")


@pytest.mark.fuzz
@given(st.text(max_size=40))
def test_no_text_runs_or_hangs(text):
    try:
        assert np.isfinite(si_factor(text, "x1"))
    except ChannelError:
        pass


WITHOUT_PINT = """
import sys
sys.modules["pint"] = None
from pysindy_nrf.records.files import read_record
from pysindy_nrf.exceptions import MissingExtraError
print(read_record(sys.argv[1]).acceleration[2, 0])
try:
    read_record(sys.argv[1], units={"a": "g"})
except MissingExtraError as error:
    print(error)
"""


def test_without_pint_si_is_read_and_other_units_name_the_extra(written):
    path = written("t [s],a1 [m/s²],F1 [N]\n0,1,1\n1,2,2\n2,3,3\n", "si.csv")
    command = [sys.executable, "-c", WITHOUT_PINT, str(path)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.stdout.startswith("3.0\n"), run.stderr
    assert "pysindy_nrf[files]" in run.stdout


def numbered_rows(n, *periods):
    """Times in steps of 10 ms, and whole numbers that repeat, as delimited text."""
    lines = []
    for k in range(n):
        counts = [str(k % period) for period in periods]
        lines.append(",".join([str(k / 100), *counts]))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("unit", ["kg", "V", "t", "furlong", "floor 2"])
def test_a_force_in_no_unit_of_force_is_not_known_to_be_unforced(written, unit):
    path = written(f"t,F2 [{unit}],x1,x2\n" + numbered_rows(40, 7, 5, 3))
    with pytest.raises(ChannelError, match=f"(F2.*{unit}|{unit}.*F2)"):
        read_record(path)
    assert read_record(path, mapping={"F2": "none"}).forced == ()

    # a unit that is known leaves the name
    name = "F2" if unit == "furlong" else f"F2 [{unit}]"
    record = read_record(path, mapping={"F2": f'"{name}" * 9.81 @ N'})
    assert record.force[:, 1].max() == 6 * 9.81

    table = pd.read_csv(path).rename(columns={f"F2 [{unit}]": "F2 [kN]"})
    table.to_parquet(path.with_suffix(".parquet"))
    assert read_record(path.with_suffix(".parquet")).force[:, 1].max() == 6000


@pytest.mark.parametrize(
    "name", ["F2_kg", "F2 kg", "F2/V", "Force 2 [V]", "F 2 (t)", "F2 raw"]
)
def test_a_column_that_names_a_force_is_read_or_asked_for(written, name):
    path = written(f"t,{name},F1,x1,x2\n" + numbered_rows(40, 7, 2, 5, 3))
    with pytest.raises(ChannelError, match="'F2': 'name . number @ N'|measures mass"):
        read_record(path)
    assert read_record(path, mapping={"F2": "none"}).forced == (1,)
    record = read_record(path, mapping={"F2": f'"{name}" * 2 @ N'})
    assert record.force[:, 1].max() == 12


def test_a_rotation_is_one_consistent_set(written):
    text = "t [s],F1 [Nm],x1 [deg],v1 [rpm]\n" + "".join(
        f"{k / 100},{k % 3},{k % 5},{k % 7}\n" for k in range(40)
    )
    record = read_record(written(text))
    assert record.displacement.max() == pytest.approx(4 * np.pi / 180)
    assert [note.kind for note in record.quality] == ["rotation"]


def test_a_torque_beside_a_displacement_is_refused(written):
    text = "t [s],F1 [Nm],x1 [mm]\n0,1,1\n1,2,2\n2,3,3\n"
    with pytest.raises(ChannelError, match="F1 in Nm is a rotation, x1 in mm"):
        read_record(written(text))
