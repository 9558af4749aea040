"""UFF files of other programs: nodes, directions, units, clocks."""

import numpy as np
import pytest

from pysindy_nrf.data.io import describe, inspect_record, read_record, read_table
from pysindy_nrf.exceptions import FileFormatError

pyuff = pytest.importorskip("pyuff")
T = np.arange(64) / 256.0


def channel(node, kind, data, unit="NONE", direction=3, title="NONE", binary=0, **more):
    return {
        "type": 58, "binary": binary, "func_type": 1, "rsp_node": node, "rsp_dir": direction, "ref_node": 0, "ref_dir": 0,
        "data": data, "x": T[: len(data)], "abscissa_spacing": 1, "abscissa_spec_data_type": 17, "id1": title,
        "ordinate_spec_data_type": kind, "ordinate_axis_units_lab": unit, "orddenom_spec_data_type": 0, **more,
    }  # fmt: skip


def written(tmp_path, *sets):
    path = tmp_path / "lab.unv"
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(list(sets), mode="add")
    return path


@pytest.mark.parametrize("binary", [0, 1])
def test_channels_by_node_and_quantity(tmp_path, binary):
    a, f = np.sin(9 * T), np.cos(9 * T)
    path = written(
        tmp_path,
        channel(1, 12, a, "g", title="acc floor 1", binary=binary),
        channel(2, 12, 2 * a, "g", binary=binary),
        channel(2, 13, f, "kN", title="shaker", binary=binary),
    )
    rec = read_record(path)
    assert rec.fs == 256 and rec.forced == (2,) and rec.n_dof == 2
    np.testing.assert_allclose(rec.acceleration[:, 1], 2 * 9.80665 * a, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(rec.force[:, 1], 1e3 * f, rtol=1e-9, atol=1e-8)
    said = describe(inspect_record(path))
    assert "a1 is 'acc floor 1'" in said and "as stated in the file" in said


def test_two_directions_are_told_apart(tmp_path):
    path = written(tmp_path, channel(1, 12, T, "m/s^2", 1), channel(1, 12, 2 * T, "m/s^2", -2))
    assert list(read_table(path).variables) == ["a1+X", "a1-Y"]
    rec = read_record(path, mapping={"a1": "-a1-Y"})
    np.testing.assert_allclose(rec.acceleration[:, 0], -2 * T, rtol=1e-10)


def test_units_of_the_whole_file(tmp_path):
    """Data set 164, code 5: millimetres and millinewtons."""
    units = {"type": 164, "units_code": 5, "units_description": "mm", "temp_mode": 1, "length": 1e3, "force": 1e3,
             "temp": 1.0, "temp_offset": 273.15}  # fmt: skip
    rec = read_record(written(tmp_path, units, channel(1, 8, 5 * T), channel(1, 13, T)))
    np.testing.assert_allclose(rec.displacement[:, 0], 5e-3 * T, rtol=1e-10)
    np.testing.assert_allclose(rec.force[:, 0], 1e-3 * T, rtol=1e-10)


def test_frequency_responses_are_left_out_and_counted(tmp_path):
    frf = channel(1, 12, T + 1j * T)
    frf |= {"func_type": 4, "abscissa_spec_data_type": 18}
    path = written(tmp_path, channel(1, 12, T), frf)
    assert "1 other data sets are left out" in read_table(path).notes
    with pytest.raises(FileFormatError, match="no time history"):
        read_table(written(tmp_path, frf))


def test_clocks_and_lengths_that_differ(tmp_path):
    with pytest.raises(FileFormatError, match="32, 64 points"):
        read_table(written(tmp_path, channel(1, 12, T), channel(2, 12, T[:32])))
    late = channel(2, 12, T)
    late["x"] = 2 * T
    with pytest.raises(FileFormatError, match="sampled every"):
        read_table(written(tmp_path, channel(1, 12, T), late))
