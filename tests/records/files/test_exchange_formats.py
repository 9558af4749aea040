"""UFF files and SEP005 dictionaries of other programs: nodes, directions, units,
clocks.
"""

import numpy as np
import pytest

from pysindy_nrf import Record
from pysindy_nrf.exceptions import ChannelError, FileFormatError
from pysindy_nrf.records.files import (
    describe,
    from_sep005,
    inspect_record,
    read_record,
    read_table,
    to_sep005,
    write_record,
)

T = np.arange(64) / 256.0


def history(node, kind, data, unit="NONE", direction=3, title="NONE", binary=0, **more):
    return {
        "type": 58,
        "binary": binary,
        "func_type": 1,
        "rsp_node": node,
        "rsp_dir": direction,
        "ref_node": 0,
        "ref_dir": 0,
        "data": data,
        "x": T[: len(data)],
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": 17,
        "id1": title,
        "ordinate_spec_data_type": kind,
        "ordinate_axis_units_lab": unit,
        "orddenom_spec_data_type": 0,
        **more,
    }


def units_set(code):
    return {
        "type": 164,
        "units_code": code,
        "units_description": "own",
        "temp_mode": 1,
        "length": 1e3,
        "force": 1e3,
        "temp": 1.0,
        "temp_offset": 273.15,
    }


@pytest.mark.parametrize("binary", [0, 1])
def test_channels_by_node_and_quantity(uff, binary):
    a, f = np.sin(9 * T), np.cos(9 * T)
    path = uff(
        history(1, 12, a, "g", title="acc floor 1", binary=binary),
        history(2, 12, 2 * a, "g", binary=binary),
        history(2, 13, f, "kN", title="shaker", binary=binary),
    )
    rec = read_record(path)
    assert rec.fs == 256 and rec.forced == (2,) and rec.n_dof == 2
    np.testing.assert_allclose(
        rec.acceleration[:, 1], 2 * 9.80665 * a, rtol=1e-9, atol=1e-10
    )
    np.testing.assert_allclose(rec.force[:, 1], 1e3 * f, rtol=1e-9, atol=1e-8)
    said = describe(inspect_record(path))
    assert "a1 is 'acc floor 1'" in said and "as stated in the file" in said


def test_directions_are_told_apart_and_a_negative_one_is_turned(uff):
    path = uff(history(1, 12, T, "m/s^2", 1), history(1, 12, 2 * T, "m/s^2", -2))
    assert list(read_table(path).variables) == ["a1+X", "a1-Y"]
    rec = read_record(path, mapping={"a1": "-a1-Y"})
    np.testing.assert_allclose(rec.acceleration[:, 0], -2 * T, rtol=1e-10)
    table = read_table(uff(history(1, 12, T, "m/s^2", -1)))
    np.testing.assert_allclose(table.variables["a1"], -T, rtol=1e-10)
    assert any("along -X" in note for note in table.notes)


def test_units_of_the_whole_file(uff):
    """Data set 164: code 5 is millimetres and millinewtons; an unknown code gives no
    unit and a note.
    """
    rec = read_record(uff(units_set(5), history(1, 8, 5 * T), history(1, 13, T)))
    np.testing.assert_allclose(rec.displacement[:, 0], 5e-3 * T, rtol=1e-10)
    np.testing.assert_allclose(rec.force[:, 0], 1e-3 * T, rtol=1e-10)
    table = read_table(uff(units_set(9), history(1, 12, np.sin(T))))
    assert any("units code 9 is not known; give units" in note for note in table.notes)
    assert table.units == {}


def test_frequency_responses_are_left_out_and_counted(uff):
    frf = history(1, 12, T + 1j * T) | {"func_type": 4, "abscissa_spec_data_type": 18}
    assert (
        "1 other data sets are left out"
        in read_table(uff(history(1, 12, T), frf)).notes
    )
    with pytest.raises(FileFormatError, match="no time history"):
        read_table(uff(frf))


def test_clocks_and_lengths_that_differ(uff):
    """With abscissa_spacing 0 every sample has its own time, which all channels must
    share.
    """
    jitter = T + 1e-5 * np.sin(np.arange(64))
    one = history(1, 12, T, x=jitter, abscissa_spacing=0)
    table = read_table(uff(one, history(2, 12, T, x=jitter, abscissa_spacing=0)))
    np.testing.assert_allclose(table.variables["t"], jitter, atol=1e-6)
    for other, words in (
        (
            history(2, 12, T, x=jitter + 0.002, abscissa_spacing=0),
            "the times of its time histories differ",
        ),
        (history(2, 12, T[:32]), "32, 64 points"),
    ):
        with pytest.raises(FileFormatError, match=words):
            read_table(uff(one, other))
    with pytest.raises(FileFormatError, match="sampled every"):
        read_table(uff(history(1, 12, T), history(2, 12, T, x=2 * T)))


def test_a_uff_file_that_announces_more_than_it_holds(tmp_path):
    pytest.importorskip("pyuff")
    path = write_record(
        Record(displacement=np.ones((9, 1)), fs=1.0), tmp_path / "a.uff"
    )
    whole = path.read_bytes()
    first = whole.index(b"    -1\n    58", whole.index(b"    58") + 10)
    spoilt = {
        whole.replace(
            b"%10d%10d%10d" % (4, 9, 1), b"%10d%s%10d" % (4, lie, 1)
        ): "points"
        for lie in (b" 999999999", b"        99")
    }
    spoilt |= {
        whole[: int(len(whole) * share)]: "does not end|columns are there"
        for share in (0.5, 0.75, 0.98)
    }
    spoilt[whole[:first]] = "1 columns are there, 2 were written"
    for content, words in spoilt.items():
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=words):
            read_table(path)


S = np.arange(100) / 50


def channel(name, data, unit, **more):
    return {"name": name, "data": data, "unit_str": unit, "fs": 50.0, **more}


def test_units_and_names():
    pytest.importorskip("pint")
    channels = [
        channel("a1", np.sin(S), "g"),
        channel("Hammer", np.cos(S), "kN"),
        channel("x1", S, "mm", quantity="d"),
    ]
    rec = from_sep005(channels, mapping={"F1": "Hammer"}, name="hit 3")
    assert rec.fs == 50 and rec.name == "hit 3" and rec.forced == (1,)
    np.testing.assert_allclose(rec.acceleration[:, 0], 9.80665 * np.sin(S), rtol=1e-14)
    np.testing.assert_allclose(rec.force[:, 0], 1e3 * np.cos(S), rtol=1e-14)
    np.testing.assert_allclose(rec.displacement[:, 0], 1e-3 * S, rtol=1e-14)


def test_times_and_rates_of_channels():
    one = {"name": "x1", "data": S, "unit_str": "m", "time": 3 + S}
    two = {"name": "a1", "data": S, "unit_str": "m/s^2", "time": 3.001 + S}
    rec = from_sep005(one)  # a single channel need not be in a list
    assert rec.fs == 50 and rec.t0 == 3
    with pytest.raises(ChannelError, match="The times of the SEP005 channels differ"):
        from_sep005([one, two])
    assert (
        from_sep005([one | {"fs": 50.0}, two | {"fs": 50.0, "time": None}]).fs == 50.0
    )


def test_channels_taken_out_and_the_callers_arrays(small):
    rec = small()
    fewer = from_sep005([one for one in to_sep005(rec) if one["name"] != "F1"])
    np.testing.assert_array_equal(fewer.displacement, rec.displacement)
    assert not fewer.forced
    data = np.ones(10)
    from_sep005([channel("a1", data, "m/s^2")]).acceleration[:] = 7
    to_sep005(rec)[0]["data"][:] = 7
    assert (data == 1).all() and rec.force[0, 0] == 1.0


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ([], "No SEP005 channel was given"),
        (
            [channel("a1", S, "m/s^2") | {"fs": 25.0}, channel("a2", S, "m/s^2")],
            "differ in fs: 'a1' 25.0, 'a2' 50.0",
        ),
        (
            [
                channel(f"a{k}", S, "m/s^2", start_timestamp=f"2024-05-01T12:00:0{k}")
                for k in (1, 2)
            ],
            "differ in start_timestamp",
        ),
        ([{"name": "a1", "data": S, "unit_str": "m"}], "'a1' lacks fs or time"),
        ([{"data": S, "fs": 1.0}], "number 1' lacks name, unit_str"),
        (
            [channel("a1", S, "m/s^2"), channel("a1", S, "m/s^2")],
            "Two SEP005 channels are named 'a1'",
        ),
        ([channel("a1", np.ones((4, 2)), "m/s^2")], r"shape \(4, 2\)"),
        ([channel("a1", S, "m/s^2"), channel("x1", S[:9], "m")], "differ in length"),
        (
            [channel("F1", S, "mm"), channel("x1", S, "m")],
            "F1 is a force, but its unit 'mm'",
        ),
        *(
            ([channel("a1", S, "m/s^2", fs=fs)], "'a1' has fs = ")
            for fs in (0, -100.0, float("inf"), "fast", 10**400)
        ),
    ],
    ids=range(14),
)
def test_dictionaries_that_do_not_fit_are_named(channels, words):
    with pytest.raises(ChannelError, match=words):
        from_sep005([{**one} for one in channels])
