"""Record -> file -> Record is the same record, bit for bit; forces and tables come back
from their files.
"""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pysindy_nrf import NRFRegressor, Record, datasets
from pysindy_nrf.exceptions import ChannelError, FileFormatError, FileVersionError
from pysindy_nrf.records.files import (
    from_sep005,
    inspect_record,
    read_record,
    read_table,
    to_sep005,
    write_forces,
    write_record,
    write_table,
)

N = 7
LINES = arrays(np.float64, N, elements=st.floats(-1e100, 1e100, allow_subnormal=True))
NAMES = st.text(min_size=1, max_size=9).filter(
    lambda name: name != "t" and name.isprintable() or "\n" in name
)
MATRICES = ("force", "acceleration", "velocity", "displacement")
BASES = ("base_acceleration", "base_velocity", "base_displacement")


def assert_same(one: Record, two: Record) -> None:
    for key in (*MATRICES, *BASES):
        a, b = getattr(one, key), getattr(two, key)
        assert (a is None) == (b is None), key
        if a is not None:
            assert a.dtype == b.dtype and a.tobytes() == b.tobytes(), key
    assert list(one.covariates) == list(two.covariates)
    for name, line in one.covariates.items():
        assert line.tobytes() == two.covariates[name].tobytes()
    assert (one.fs, one.t0, one.name, one.coordinates) == (
        two.fs,
        two.t0,
        two.name,
        two.coordinates,
    )
    assert one.forced == two.forced and one.unknown == two.unknown


@st.composite
def records(draw):
    n = draw(st.integers(1, 3))
    kinds = draw(st.sets(st.sampled_from(MATRICES[1:]), min_size=1))
    options = {}
    for kind in kinds:
        matrix = np.column_stack([draw(LINES) for _ in range(n)])
        if draw(st.booleans()):
            # not a shadow of the drawn values: what fits single precision
            matrix = np.clip(matrix, -1e30, 1e30).astype(np.float32)
        elif n > 1 and draw(st.booleans()):
            matrix[:, draw(st.integers(0, n - 1))] = (
                np.nan
            )  # a floor without this sensor
        options[kind] = matrix
    force = np.column_stack([draw(LINES) for _ in range(n)])
    for j in range(n):
        what = draw(st.sampled_from(["known", "none", "unknown"]))
        force[:, j] = {"known": force[:, j], "none": 0.0, "unknown": np.nan}[what]
    for base in draw(st.sets(st.sampled_from(BASES))):
        options[base] = draw(LINES)
    record = Record(
        force=force,
        fs=draw(st.floats(1e-3, 1e6)),
        covariates={
            name: draw(LINES)
            for name in draw(st.sets(NAMES.filter(lambda x: not _taken(x)), max_size=2))
        },
        name=draw(st.text(max_size=9)),
        coordinates=draw(st.sampled_from(["relative", "absolute"])),
        **options,
    )
    record.t0 = draw(st.floats(-1e6, 1e6))
    return record


def _taken(name: str) -> bool:
    return name[:1] in "avxF" and (name[1:].isdigit() or name[1:] == "g")


@pytest.mark.fuzz
@pytest.mark.parametrize("suffix", [".parquet", ".uff", ".csv"])
@settings(max_examples=25)
@given(record=records())
def test_record_to_file_to_record(tmp_path_factory, suffix, record):
    path = tmp_path_factory.mktemp("round") / f"r{suffix}"
    assert_same(read_record(write_record(record, path)), record)


@pytest.mark.fuzz
@settings(max_examples=25)
@given(record=records())
def test_record_to_sep005_to_record(record):
    channels = to_sep005(record)
    assert all({"data", "name", "unit_str", "fs"} <= set(one) for one in channels)
    assert_same(from_sep005(channels), record)


@pytest.mark.parametrize("suffix", [".parquet", ".uff", ".csv"])
def test_every_part_of_a_record_survives(tmp_path, suffix):
    """Edges of NaN, a floor without sensor, an unknown force, single precision, odd
    names, a late first sample.
    """
    rng = np.random.default_rng(0)
    x = rng.normal(size=(50, 2)).astype(np.float32)
    x[:3], x[-2:, 1] = np.nan, np.nan
    record = Record(
        displacement=x,
        acceleration=rng.normal(size=(50, 2)) * [1.0, np.nan],
        force=rng.normal(size=(50, 2)) * [np.nan, 0],
        base_acceleration=rng.normal(size=50),
        covariates={"größe\n": rng.normal(size=50)},
        fs=1 / 0.00977,
        name='NONE "é',
        coordinates="absolute",
    )
    record.t0 = -12.3
    reading = inspect_record(write_record(record, tmp_path / f"r{suffix}"))
    assert_same(reading.record, record)
    assert reading.clock.endswith("Hz, as written by this package")


def test_a_written_record_opens_elsewhere(tmp_path):
    """By the libraries of each format, knowing nothing of this package."""
    pyuff = pytest.importorskip("pyuff")
    record = datasets.load_demo()
    plain = pd.read_parquet(write_record(record, tmp_path / "r.parquet"))
    np.testing.assert_array_equal(plain["a3"], record.acceleration[:, 2])
    np.testing.assert_allclose(plain["t"], record.time)
    table = pd.read_csv(write_record(record, tmp_path / "r.csv"), comment="#")
    np.testing.assert_allclose(table["x2"], record.displacement[:, 1], rtol=1e-15)
    sets = pyuff.UFF(str(write_record(record, tmp_path / "r.uff"))).read_sets()
    by_name = {one["id1"]: one for one in sets if one["type"] == 58}
    one = by_name["a3"]
    np.testing.assert_array_equal(one["data"], record.acceleration[:, 2])
    assert (one["func_type"], one["rsp_node"], one["ordinate_spec_data_type"]) == (
        1,
        3,
        12,
    )
    assert one["ordinate_axis_units_lab"] == "m/s^2" and one[
        "abscissa_inc"
    ] == pytest.approx(record.dt, rel=1e-5)
    assert by_name["F2"]["ordinate_spec_data_type"] == 13


def test_options_go_before_what_the_file_says(tmp_path):
    record = Record(
        displacement=np.arange(8.0)[:, None],
        fs=50.0,
        name="was",
        coordinates="absolute",
    )
    path = write_record(record, tmp_path / "r.parquet")
    assert read_record(path).coordinates == "absolute"
    assert read_record(path, coordinates="relative").coordinates == "relative"
    assert read_record(path, name="is").name == "is"
    halved = read_record(path, mapping={"x1": "x1 * 0.5"})
    np.testing.assert_array_equal(halved.displacement, record.displacement / 2)
    assert halved.coordinates == "absolute" and halved.fs == pytest.approx(50.0)


def test_what_cannot_be_written_is_said(tmp_path):
    x = np.ones((4, 1))
    with pytest.raises(ChannelError, match="covariate 'F1'"):
        write_record(
            Record(displacement=x, fs=1.0, covariates={"F1": x[:, 0]}),
            tmp_path / "r.parquet",
        )
    with pytest.raises(FileFormatError, match=r"\.xlsx"):
        write_record(Record(displacement=x, fs=1.0), tmp_path / "r.xlsx")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".parquet", ".uff", ".csv"])
def test_a_later_version_is_refused(tmp_path, small, suffix):
    path = write_record(small(), tmp_path / f"r{suffix}")
    whole = path.read_bytes()
    if suffix == ".parquet":
        import pyarrow.parquet as pq

        table = pq.read_table(path)
        texts = {
            key: text.replace(b'"version": 1', b'"version": 99')
            for key, text in table.schema.metadata.items()
        }
        pq.write_table(table.replace_schema_metadata(texts), path)
    else:
        path.write_bytes(whole.replace(b'"version": 1,', b'"version": 99,'))
    with pytest.raises(FileVersionError, match=r"version 99.*reads up to 1"):
        read_record(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"version": 1', '"version": true', "its version is True"),
        ('"name": "small"', '"name": 7', "a name is not a text"),
        (
            '"coordinates": "relative"',
            '"coordinates": "polar"',
            "its coordinates are 'polar'",
        ),
        ('"fs": 100.0', '"fs": -100.0', "its sampling rate or first time is not valid"),
        ('"float32": []', '"float32": ["a9"]', "names columns that it does not have"),
    ],
)
def test_attributes_that_were_edited_by_hand(tmp_path, small, old, new, words):
    path = write_record(small(), tmp_path / "small.csv")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=words):
        read_record(path)


def test_a_record_file_that_lost_a_column(tmp_path, small):
    path = write_record(small(), tmp_path / "small.csv")
    lines = path.read_text().splitlines()
    path.write_text(
        "\n".join([lines[0], *(line.rpartition(",")[0] for line in lines[1:])]) + "\n"
    )
    with pytest.raises(FileFormatError, match="2 columns where 3 are announced"):
        read_record(path)


def test_tables_of_results(tmp_path):
    table = pd.DataFrame({"dof": [1, 2], "mass_kg": [np.pi, 1 / 3]})
    for suffix in (".csv", ".parquet"):
        back = read_table(write_table(table, tmp_path / f"m{suffix}")).variables
        assert back["mass_kg"].tobytes() == table["mass_kg"].to_numpy().tobytes()
    with pytest.raises(FileFormatError, match="not written"):
        write_table(table, tmp_path / "m.xls")


def test_reconstructed_forces_as_uff(tmp_path):
    """Forces of a linear storey, read back by node: R_2 = k s_2 (+ c v_2)."""
    pyuff = pytest.importorskip("pyuff")
    record, truth = datasets.load_demo(), datasets.demo_truth()
    X, F = record.to_features()
    sets = pyuff.UFF(
        str(write_forces(truth, record, tmp_path / "forces.uff"))
    ).read_sets()
    assert [(int(one["rsp_node"]), int(one["ref_node"])) for one in sets] == [
        (1, 0),
        (2, 1),
        (3, 2),
    ]
    expected = 35e3 * X["s2"] + 25.0 * X["v2"]
    np.testing.assert_allclose(
        sets[1]["data"], expected, rtol=1e-9, atol=1e-9 * expected.abs().max()
    )
    assert sets[1]["ordinate_axis_units_lab"] == "N" and "storey 2" in sets[1]["id1"]


def test_forces_are_written_one_record_at_a_time(tmp_path, chain2):
    model = NRFRegressor().fit(chain2.X, chain2.F)
    with pytest.raises(FileFormatError, match="one record at a time"):
        write_forces(
            model,
            chain2.X,
            tmp_path / "R.csv",
            record=np.repeat([0, 1], [900, 1100]),
            dt=1e-3,
        )
