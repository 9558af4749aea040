"""Record -> file -> Record is the same, bit for bit; forces and tables come back."""

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

SUFFIXES = [".parquet", ".uff", ".csv"]
MATRICES = ("force", "acceleration", "velocity", "displacement")
BASES = ("base_acceleration", "base_velocity", "base_displacement")
ATTRIBUTES = ("fs", "t0", "name", "coordinates", "hold", "forced", "unknown")


def bits(array):
    return None if array is None else (array.dtype, array.shape, array.tobytes())


def assert_same(first: Record, second: Record) -> None:
    for key in (*MATRICES, *BASES):
        assert bits(getattr(first, key)) == bits(getattr(second, key)), key
    for key in ATTRIBUTES:
        assert getattr(first, key) == getattr(second, key), key
    assert list(first.covariates) == list(second.covariates)
    for name, line in first.covariates.items():
        assert bits(line) == bits(second.covariates[name]), name


N = 7
LINES = arrays(np.float64, N, elements=st.floats(-1e100, 1e100, allow_subnormal=True))


def is_free(name):
    """Whether a covariate may be called so in a file."""
    is_channel = name[:1] in "avxF" and (name[1:].isdigit() or name[1:] == "g")
    return name != "t" and not is_channel and (name.isprintable() or "\n" in name)


@st.composite
def motions(draw, n_dof):
    """A matrix in double or single precision, or with a floor without this sensor."""
    matrix = np.column_stack([draw(LINES) for _ in range(n_dof)])
    if draw(st.booleans()):
        # not a shadow of the drawn values: what fits single precision
        return np.clip(matrix, -1e30, 1e30).astype(np.float32)
    if n_dof > 1 and draw(st.booleans()):
        matrix[:, draw(st.integers(0, n_dof - 1))] = np.nan
    return matrix


@st.composite
def records(draw):
    n_dof = draw(st.integers(1, 3))
    kinds = draw(st.sets(st.sampled_from(MATRICES[1:]), min_size=1))
    lines = {kind: draw(motions(n_dof)) for kind in kinds}
    for base in draw(st.sets(st.sampled_from(BASES))):
        lines[base] = draw(LINES)
    forces = [draw(LINES | st.sampled_from([0.0, np.nan])) for _ in range(n_dof)]
    names = draw(st.sets(st.text(min_size=1, max_size=9).filter(is_free), max_size=2))

    record = Record(
        force=np.column_stack([np.broadcast_to(force, N) for force in forces]),
        fs=draw(st.floats(1e-3, 1e6)),
        covariates={name: draw(LINES) for name in names},
        name=draw(st.text(max_size=9)),
        coordinates=draw(st.sampled_from(["relative", "absolute"])),
        hold=draw(st.sampled_from([None, "cubic", "linear", "zero"])),
        **lines,
    )
    return record.starting_at(draw(st.floats(-1e6, 1e6)))


@pytest.mark.fuzz
@pytest.mark.parametrize("suffix", SUFFIXES)
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
    for channel in channels:
        assert {"data", "name", "unit_str", "fs"} <= set(channel)
    assert_same(from_sep005(channels), record)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_part_of_a_record_survives(tmp_path, suffix):
    """Edges of NaN, a floor without sensor, an unknown force, odd names."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(50, 2)).astype(np.float32)
    x[:3] = np.nan
    x[-2:, 1] = np.nan
    record = Record(
        displacement=x,
        acceleration=rng.normal(size=(50, 2)) * [1.0, np.nan],
        force=rng.normal(size=(50, 2)) * [np.nan, 0],
        base_acceleration=rng.normal(size=50),
        covariates={"größe\n": rng.normal(size=50)},
        fs=1 / 0.00977,
        name='NONE "é',
        coordinates="absolute",
        hold="zero",
    ).starting_at(-12.3)
    reading = inspect_record(write_record(record, tmp_path / f"r{suffix}"))
    assert_same(reading.record, record)
    assert reading.clock.endswith("as written by this package")


def test_a_written_record_opens_with_pandas(tmp_path):
    record = datasets.load_demo()
    table = pd.read_parquet(write_record(record, tmp_path / "r.parquet"))
    np.testing.assert_array_equal(table["a3"], record.acceleration[:, 2])
    np.testing.assert_allclose(table["t"], record.time)
    table = pd.read_csv(write_record(record, tmp_path / "r.csv"), comment="#")
    np.testing.assert_allclose(table["x2"], record.displacement[:, 1], rtol=1e-15)


def test_a_written_record_opens_with_pyuff(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    record = datasets.load_demo()
    sets = pyuff.UFF(str(write_record(record, tmp_path / "r.uff"))).read_sets()
    by_name = {dataset["id1"]: dataset for dataset in sets if dataset["type"] == 58}
    a3 = by_name["a3"]
    np.testing.assert_array_equal(a3["data"], record.acceleration[:, 2])
    assert a3["func_type"] == 1
    assert a3["rsp_node"] == 3
    assert a3["ordinate_spec_data_type"] == 12
    assert a3["ordinate_axis_units_lab"] == "m/s^2"
    assert a3["abscissa_inc"] == pytest.approx(record.dt, rel=1e-5)
    assert by_name["F2"]["ordinate_spec_data_type"] == 13


def test_options_go_before_what_the_file_says(tmp_path):
    x = np.arange(8.0)[:, None]
    record = Record(displacement=x, fs=50.0, name="was", coordinates="absolute")
    path = write_record(record, tmp_path / "r.parquet")
    assert read_record(path).coordinates == "absolute"
    assert read_record(path, coordinates="relative").coordinates == "relative"
    assert read_record(path, name="is").name == "is"
    assert read_record(path).hold is None
    assert read_record(path, hold="zero").hold == "zero"

    halved = read_record(path, mapping={"x1": "x1 * 0.5"})
    np.testing.assert_array_equal(halved.displacement, x / 2)
    assert halved.coordinates == "absolute"
    assert read_record(path, mapping={"x1": "x1"}, hold="linear").hold == "linear"
    assert halved.fs == pytest.approx(50.0)


def test_what_cannot_be_written_is_named(tmp_path, small):
    ambiguous = small(covariates={"F1": np.ones(200)})
    with pytest.raises(ChannelError, match="covariate 'F1'"):
        write_record(ambiguous, tmp_path / "r.parquet")
    with pytest.raises(FileFormatError, match=r"\.xlsx"):
        write_record(small(), tmp_path / "r.xlsx")
    assert not list(tmp_path.iterdir())


def of_later_version(text):
    return text.replace(b'"version": 1,', b'"version": 99,')


def test_a_later_version_of_parquet_is_refused(tmp_path, small):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = write_record(small(), tmp_path / "r.parquet")
    table = parquet.read_table(path)
    metadata = table.schema.metadata.items()
    later = {key: of_later_version(text) for key, text in metadata}
    parquet.write_table(table.replace_schema_metadata(later), path)
    with pytest.raises(FileVersionError, match="version 99.*reads up to 1"):
        read_record(path)


@pytest.mark.parametrize("suffix", [".uff", ".csv"])
def test_a_later_version_of_text_is_refused(tmp_path, small, suffix):
    path = write_record(small(), tmp_path / f"r{suffix}")
    path.write_bytes(of_later_version(path.read_bytes()))
    with pytest.raises(FileVersionError, match="version 99.*reads up to 1"):
        read_record(path)


@pytest.mark.parametrize(
    ("true", "edited", "words"),
    [
        ('"version": 1', '"version": true', "its version is True"),
        ('"name": "small"', '"name": 7', "a name is not a text"),
        ('"coordinates": "relative"', '"coordinates": "polar"', "are 'polar'"),
        ('"fs": 100.0', '"fs": -100.0', "its sampling rate .* not valid"),
        ('"float32": []', '"float32": ["a9"]', "columns that it does not have"),
    ],
)
def test_attributes_that_were_edited_by_hand(tmp_path, small, true, edited, words):
    path = write_record(small(), tmp_path / "small.csv")
    text = path.read_text()
    assert true in text
    path.write_text(text.replace(true, edited, 1))
    with pytest.raises(FileFormatError, match=words):
        read_record(path)


def test_a_record_file_that_lost_a_column(tmp_path, small):
    path = write_record(small(), tmp_path / "small.csv")
    first, *rows = path.read_text().splitlines()
    shorter = [row.rpartition(",")[0] for row in rows]
    path.write_text("\n".join([first, *shorter]) + "\n")
    with pytest.raises(FileFormatError, match="2 columns where 3"):
        read_record(path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_tables_of_results_come_back(tmp_path, suffix):
    table = pd.DataFrame({"dof": [1, 2], "mass_kg": [np.pi, 1 / 3]})
    back = read_table(write_table(table, tmp_path / f"m{suffix}"))
    assert back.variables["mass_kg"].tolist() == [np.pi, 1 / 3]


def test_tables_of_other_types_are_not_written(tmp_path):
    with pytest.raises(FileFormatError, match="not written"):
        write_table(pd.DataFrame({"m": [1.0]}), tmp_path / "m.xls")


def test_reconstructed_forces_as_uff(tmp_path):
    """Forces of a linear storey, read back by node: R_2 = k s_2 + c v_2."""
    pyuff = pytest.importorskip("pyuff")
    record = datasets.load_demo()
    path = write_forces(datasets.demo_truth(), record, tmp_path / "forces.uff")
    sets = pyuff.UFF(str(path)).read_sets()
    nodes = [(int(dataset["rsp_node"]), int(dataset["ref_node"])) for dataset in sets]
    assert nodes == [(1, 0), (2, 1), (3, 2)]

    second = sets[1]
    X, _ = record.to_features()
    expected = 35e3 * X["s2"] + 25.0 * X["v2"]
    tolerance = 1e-9 * expected.abs().max()
    np.testing.assert_allclose(second["data"], expected, rtol=1e-9, atol=tolerance)
    assert second["ordinate_axis_units_lab"] == "N"
    assert "storey 2" in second["id1"]


def test_forces_are_written_one_record_at_a_time(tmp_path, chain2):
    model = NRFRegressor().fit(chain2.X, chain2.F)
    ids = np.repeat([0, 1], [900, 1100])
    with pytest.raises(FileFormatError, match="one record at a time"):
        write_forces(model, chain2.X, tmp_path / "R.csv", record=ids, dt=1e-3)
