"""UFF files and SEP005 dictionaries of other programs."""

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
# Specific data types of UFF.
DISPLACEMENT = 8
ACCELERATION = 12
FORCE = 13


def history(node, data_type, data, **more):
    """A data set 58: the time history of a node in direction +Z."""
    head = {"type": 58, "func_type": 1, "binary": 0, "id1": "NONE"}
    place = {"rsp_node": node, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0}
    abscissa = {"abscissa_spacing": 1, "abscissa_spec_data_type": 17}
    ordinate = {"ordinate_spec_data_type": data_type, "orddenom_spec_data_type": 0}
    samples = {"data": data, "x": T[: len(data)]}
    return head | place | abscissa | ordinate | samples | more


def unit(text):
    return {"ordinate_axis_units_lab": text}


def units_set(code):
    """A data set 164: the units of a whole file."""
    factors = {"length": 1e3, "force": 1e3, "temp": 1.0, "temp_offset": 273.15}
    texts = {"units_description": "own", "temp_mode": 1}
    return {"type": 164, "units_code": code} | texts | factors


@pytest.mark.parametrize("binary", [0, 1])
def test_channels_by_node_and_quantity(uff, binary):
    a, force = np.sin(9 * T), np.cos(9 * T)
    in_g, in_kn = unit("g") | {"binary": binary}, unit("kN") | {"binary": binary}
    path = uff(
        history(1, ACCELERATION, a, **in_g, id1="acc floor 1"),
        history(2, ACCELERATION, 2 * a, **in_g),
        history(2, FORCE, force, **in_kn),
    )
    record = read_record(path)
    assert record.fs == 256
    assert record.forced == (2,)
    expected = np.column_stack([a, 2 * a]) * 9.80665
    np.testing.assert_allclose(record.acceleration, expected, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(record.force[:, 1], 1e3 * force, rtol=1e-9, atol=1e-8)
    described = describe(inspect_record(path))
    assert "a1 is 'acc floor 1'" in described
    assert "as stated in the file" in described


def test_directions_of_one_node_are_in_the_names(uff):
    in_si = unit("m/s^2")
    path = uff(
        history(1, ACCELERATION, T, rsp_dir=1, **in_si),
        history(1, ACCELERATION, 2 * T, rsp_dir=-2, **in_si),
    )
    assert list(read_table(path).variables) == ["a1+X", "a1-Y"]
    record = read_record(path, mapping={"a1": "-a1-Y"})
    np.testing.assert_allclose(record.acceleration[:, 0], -2 * T, rtol=1e-10)


def test_a_negative_direction_is_turned(uff):
    path = uff(history(1, ACCELERATION, T, rsp_dir=-1))
    table = read_table(path)
    np.testing.assert_allclose(table.variables["a1"], -T, rtol=1e-10)
    assert any("along -X" in note for note in table.notes)


def test_units_of_the_whole_file(uff):
    """Code 5 is millimetres and millinewtons."""
    path = uff(units_set(5), history(1, DISPLACEMENT, 5 * T), history(1, FORCE, T))
    record = read_record(path)
    np.testing.assert_allclose(record.displacement[:, 0], 5e-3 * T, rtol=1e-10)
    np.testing.assert_allclose(record.force[:, 0], 1e-3 * T, rtol=1e-10)


def test_an_unknown_system_of_units_is_noted(uff):
    table = read_table(uff(units_set(9), history(1, ACCELERATION, np.sin(T))))
    assert any("units code 9" in note for note in table.notes)
    assert table.units == {}


def test_frequency_responses_are_left_out_and_counted(uff):
    frequency = {"func_type": 4, "abscissa_spec_data_type": 18}
    response = history(1, ACCELERATION, T + 1j * T, **frequency)
    table = read_table(uff(history(1, ACCELERATION, T), response))
    assert "1 other data sets are left out" in table.notes
    with pytest.raises(FileFormatError, match="no time history"):
        read_table(uff(response))


UNEVEN = T + 1e-5 * np.sin(np.arange(64))  # each sample has its own time


def uneven(node, times):
    return history(node, ACCELERATION, T, x=times, abscissa_spacing=0)


def test_times_that_all_channels_share(uff):
    table = read_table(uff(uneven(1, UNEVEN), uneven(2, UNEVEN)))
    np.testing.assert_allclose(table.variables["t"], UNEVEN, atol=1e-6)


def test_times_that_differ_from_one_history_to_the_next(uff):
    with pytest.raises(FileFormatError, match="times .* differ"):
        read_table(uff(uneven(1, UNEVEN), uneven(2, UNEVEN + 0.002)))


@pytest.fixture
def written_uff(tmp_path):
    """A record of two columns, F1 and x1, as a universal file."""
    pytest.importorskip("pyuff")
    record = Record(displacement=np.ones((9, 1)), fs=1.0)
    return write_record(record, tmp_path / "a.uff")


@pytest.mark.parametrize("announced", [999999999, 99])
def test_a_uff_file_that_announces_more_than_it_holds(written_uff, announced):
    content = written_uff.read_bytes()
    true = b"%10d%10d%10d" % (4, 9, 1)
    false = b"%10d%10d%10d" % (4, announced, 1)
    assert true in content
    written_uff.write_bytes(content.replace(true, false))
    with pytest.raises(FileFormatError, match="points"):
        read_table(written_uff)


@pytest.mark.parametrize("share", [0.5, 0.75, 0.98])
def test_a_uff_file_that_is_cut_off(written_uff, share):
    content = written_uff.read_bytes()
    written_uff.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(FileFormatError, match="does not end|columns are there"):
        read_table(written_uff)


def test_a_uff_file_that_lost_a_column(written_uff):
    content = written_uff.read_bytes()
    start = b"    -1\n    58"
    second = content.index(start, content.index(start) + 1)
    written_uff.write_bytes(content[:second])
    with pytest.raises(FileFormatError, match="1 columns .* 2 were written"):
        read_table(written_uff)


S = np.arange(100) / 50


def channel(name="a1", data=S, unit_str="m/s^2", **more):
    """A SEP005 dictionary, sampled at 50 Hz."""
    return {"name": name, "data": data, "unit_str": unit_str, "fs": 50.0} | more


def without(channel, *keys):
    return {key: value for key, value in channel.items() if key not in keys}


def test_units_and_names_of_dictionaries():
    pytest.importorskip("pint")
    channels = [
        channel("a1", np.sin(S), "g"),
        channel("Hammer", np.cos(S), "kN"),
        channel("x1", S, "mm", quantity="d"),
    ]
    record = from_sep005(channels, mapping={"F1": "Hammer"}, name="hit 3")
    assert record.fs == 50
    assert record.name == "hit 3"
    assert record.forced == (1,)
    expected = 9.80665 * np.sin(S)
    np.testing.assert_allclose(record.acceleration[:, 0], expected, rtol=1e-14)
    np.testing.assert_allclose(record.force[:, 0], 1e3 * np.cos(S), rtol=1e-14)
    np.testing.assert_allclose(record.displacement[:, 0], 1e-3 * S, rtol=1e-14)


def test_times_of_dictionaries():
    without_rate = without(channel("x1", S, "m", time=3 + S), "fs")
    record = from_sep005(without_rate)  # a single channel need not be in a list
    assert record.fs == 50
    assert record.t0 == 3
    other = without(channel(time=3.001 + S), "fs")
    with pytest.raises(ChannelError, match="times .* differ"):
        from_sep005([without_rate, other])


def test_a_rate_serves_channels_without_times():
    channels = [channel("x1", S, "m", time=3 + S), channel(time=None)]
    assert from_sep005(channels).fs == 50.0


def test_a_record_without_one_of_its_channels(small):
    record = small()
    channels = [channel for channel in to_sep005(record) if channel["name"] != "F1"]
    fewer = from_sep005(channels)
    np.testing.assert_array_equal(fewer.displacement, record.displacement)
    assert not fewer.forced


def test_arrays_of_the_caller_stay_as_they_are(small):
    data = np.ones(10)
    from_sep005([channel(data=data)]).acceleration[:] = 7
    assert (data == 1).all()

    record = small()
    to_sep005(record)[0]["data"][:] = 7
    assert record.force[0, 0] == 1.0


BAD_CHANNELS = {
    "No SEP005 channel": [],
    "differ in fs: 'a1' 25.0, 'a2' 50.0": [channel(fs=25.0), channel("a2")],
    "differ in start_timestamp": [
        channel(start_timestamp="2024-05-01T12:00:01"),
        channel("a2", start_timestamp="2024-05-01T12:00:02"),
    ],
    "'a1' lacks fs or time": [without(channel(), "fs")],
    "number 1' lacks name, unit_str": [without(channel(), "name", "unit_str")],
    "Two .* named 'a1'": [channel(), channel()],
    r"shape \(4, 2\)": [channel(data=np.ones((4, 2)))],
    "differ in length": [channel(), channel("x1", S[:9], "m")],
    "F1 is a force.* unit 'mm'": [channel("F1", S, "mm"), channel("x1", S, "m")],
}


@pytest.mark.parametrize(("words", "channels"), BAD_CHANNELS.items())
def test_dictionaries_that_do_not_fit_are_named(words, channels):
    with pytest.raises(ChannelError, match=words):
        from_sep005(channels)


@pytest.mark.parametrize("fs", [0, -100.0, float("inf"), "fast", 10**400], ids=range(5))
def test_a_rate_is_a_positive_number(fs):
    with pytest.raises(ChannelError, match="'a1' has fs = "):
        from_sep005([channel(fs=fs)])
