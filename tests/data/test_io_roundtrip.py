"""Record -> file -> Record is the same record, bit for bit, whatever is in it; model -> JSON -> model predicts the same bits."""

import json

import jsonschema
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pysindy_nrf import ChainModel, NRFRegressor, Record, datasets, laws
from pysindy_nrf.data.io import (
    from_sep005,
    inspect_record,
    read_record,
    read_table,
    to_sep005,
    write_record,
    write_table,
)
from pysindy_nrf.exceptions import ChannelError, FileFormatError, FileVersionError

N = 7
LINES = arrays(np.float64, N, elements=st.floats(-1e100, 1e100, allow_subnormal=True))
NAMES = st.text(min_size=1, max_size=9).filter(lambda name: name != "t" and name.isprintable() or "\n" in name)
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
    assert (one.fs, one.t0, one.name, one.coordinates) == (two.fs, two.t0, two.name, two.coordinates)
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
            matrix[:, draw(st.integers(0, n - 1))] = np.nan  # a floor without this sensor
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
        covariates={name: draw(LINES) for name in draw(st.sets(NAMES.filter(lambda x: not _taken(x)), max_size=2))},
        name=draw(st.text(max_size=9)),
        coordinates=draw(st.sampled_from(["relative", "absolute"])),
        **options,
    )
    record.t0 = draw(st.floats(-1e6, 1e6))
    return record


def _taken(name: str) -> bool:
    return name[:1] in "avxF" and (name[1:].isdigit() or name[1:] == "g")


@pytest.mark.parametrize("suffix", [".parquet", ".uff", ".csv"])
@settings(max_examples=25)
@given(record=records())
def test_record_to_file_to_record(tmp_path_factory, suffix, record):
    path = tmp_path_factory.mktemp("round") / f"r{suffix}"
    assert_same(read_record(write_record(record, path)), record)


@settings(max_examples=25)
@given(record=records())
def test_record_to_sep005_to_record(record):
    channels = to_sep005(record)
    assert all({"data", "name", "unit_str", "fs"} <= set(one) for one in channels)
    assert_same(from_sep005(channels), record)


def test_edges_and_their_counts_survive(tmp_path):
    x = np.random.default_rng(0).normal(size=(50, 2))
    x[:3], x[-2:, 1] = np.nan, np.nan
    record = Record(displacement=x, fs=1 / 0.00977)
    for suffix in (".parquet", ".uff", ".csv"):
        assert_same(read_record(write_record(record, tmp_path / f"r{suffix}")), record)


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
    by_name = {one["id1"]: one for one in sets}
    one = by_name["a3"]
    np.testing.assert_array_equal(one["data"], record.acceleration[:, 2])
    assert (one["func_type"], one["rsp_node"], one["ordinate_spec_data_type"]) == (1, 3, 12)
    assert one["ordinate_axis_units_lab"] == "m/s^2" and one["abscissa_inc"] == pytest.approx(record.dt, rel=1e-5)
    assert by_name["F2"]["ordinate_spec_data_type"] == 13


def test_a_written_record_that_was_cut_off_is_not_a_shorter_one(tmp_path):
    path = write_record(datasets.load_demo(), tmp_path / "r.csv")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:1000]))
    with pytest.raises(FileFormatError, match="had 4000 samples, 998 of"):
        read_record(path)


def test_options_go_before_what_the_file_says(tmp_path):
    record = Record(displacement=np.arange(8.0)[:, None], fs=50.0, name="was", coordinates="absolute")
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
        write_record(Record(displacement=x, fs=1.0, covariates={"F1": x[:, 0]}), tmp_path / "r.parquet")
    with pytest.raises(ChannelError, match="80 characters"):
        write_record(Record(displacement=x, fs=1.0, name="long " * 30), tmp_path / "r.uff")
    with pytest.raises(FileFormatError, match=r"\.xlsx"):
        write_record(Record(displacement=x, fs=1.0), tmp_path / "r.xlsx")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".parquet", ".uff", ".csv"])
def test_a_later_version_is_refused(tmp_path, suffix, monkeypatch):
    from pysindy_nrf.data.io import attributes, uff

    monkeypatch.setattr(attributes, "VERSION", 99)
    monkeypatch.setattr(uff, "VERSION", 99)
    path = write_record(Record(displacement=np.ones((4, 1)), fs=1.0), tmp_path / f"r{suffix}")
    monkeypatch.undo()
    with pytest.raises(FileVersionError, match=r"version 99.*reads up to 1"):
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
    from pysindy_nrf.data.io import write_forces

    record, truth = datasets.load_demo(), datasets.demo_truth()
    X, F = record.to_features()
    sets = pyuff.UFF(str(write_forces(truth, record, tmp_path / "forces.uff"))).read_sets()
    assert [(int(one["rsp_node"]), int(one["ref_node"])) for one in sets] == [(1, 0), (2, 1), (3, 2)]
    expected = 35e3 * X["s2"] + 25.0 * X["v2"]
    np.testing.assert_allclose(sets[1]["data"], expected, rtol=1e-9, atol=1e-9 * expected.abs().max())
    assert sets[1]["ordinate_axis_units_lab"] == "N" and "storey 2" in sets[1]["id1"]


# -- models -----------------------------------------------------------------------------------


@settings(max_examples=15)
@given(
    masses=st.lists(st.floats(1e-6, 1e9), min_size=1, max_size=3),
    values=st.lists(st.floats(-1e12, 1e12, allow_subnormal=True), min_size=9, max_size=9),
    sigma=st.floats(1.0, 1e6),
)
def test_a_model_predicts_the_same_bits_after_json(masses, values, sigma):
    cubic, dahl = laws.PowerSeries(3, values), laws.Dahl(sigma=sigma, Fd=values[0])
    model = ChainModel(masses, {"storey 1": [cubic, dahl]})
    back = ChainModel.from_json(model.to_json())
    t = np.arange(60) / 50
    motion = [[-9 * np.sin(3 * t + j), 3 * np.cos(3 * t + j), np.sin(3 * t + j)] for j in range(len(masses))]
    X = np.column_stack([motion[j][k] for k in range(3) for j in range(len(masses))])
    assert model.predict(X, dt=0.02).tobytes() == back.predict(X, dt=0.02).tobytes()


def test_a_fitted_model_obeys_the_schema_and_runs_the_same_bits(tmp_path):
    from pysindy_nrf.common.schema import schema

    record = datasets.load_demo()
    model = NRFRegressor(degree=3).fit(record).model_
    model.to_json(tmp_path / "m.json")
    jsonschema.Draft202012Validator(schema()).validate(json.loads((tmp_path / "m.json").read_text()))
    back = ChainModel.from_json(tmp_path / "m.json")
    a, b = (m.simulate(record.force[:400], record.dt).displacement for m in (model, back))
    assert a.tobytes() == b.tobytes()


BASE = ChainModel(
    [10.0, 12.0], {1: [laws.PowerSeries(1, [1.0, 2.0]), laws.Dahl(sigma=5e4, Fd=3.0)], 2: laws.PowerSeries(1, [1, 2])}
).to_dict()
ODD = [
    None,
    True,
    -1,
    0,
    1,
    2.5,
    "x",
    "",
    [],
    {},
    [1, 2],
    {"a": 1},
    10**400,
    1e308,
    "storey 1",
    [[]],
    999999,
    float("nan"),
]


def _places(data, path=()):
    yield path
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield from _places(value, (*path, key))


@pytest.mark.parametrize("path", [p for p in _places(BASE) if p], ids=lambda p: ".".join(map(str, p)))
def test_a_spoilt_model_is_refused_in_words_and_as_the_schema_says(path):
    """Every place of the file, every odd value: refused by name or a model; never accepted against the schema."""
    from pysindy_nrf.common.schema import schema

    validator = jsonschema.Draft202012Validator(schema())
    for odd in ODD:
        data = json.loads(json.dumps(BASE))
        place = data
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = odd
        try:
            ChainModel.from_json(json.dumps(data))
        except FileFormatError:
            continue
        assert validator.is_valid(data), (path, odd)


def test_versions_and_loopholes_of_json():
    with pytest.raises(FileVersionError, match="version 2, this package reads up to 1"):
        ChainModel.from_json(json.dumps(BASE | {"version": 2}))
    with pytest.raises(FileFormatError, match="'mases' was unexpected"):
        ChainModel.from_json(json.dumps(BASE | {"mases": [1.0]}))
    twice = json.dumps(BASE).replace('"masses"', '"masses": [1.0, 1.0], "masses"', 1)
    with pytest.raises(FileFormatError, match="twice"):
        ChainModel.from_json(twice)
    with pytest.raises(FileFormatError, match="NaN"):
        ChainModel.from_json(json.dumps(BASE | {"masses": [float("nan"), 1.0]}))
    with pytest.raises(FileFormatError, match="1e9990 is beyond the range of a double"):  # anywhere: it could not be written
        ChainModel.from_json(json.dumps(BASE | {"info": {"band": [1.0]}}).replace("[1.0]}", "[1e9990]}"))


def test_what_a_reading_says_of_own_files(tmp_path):
    reading = inspect_record(write_record(datasets.load_demo(), tmp_path / "demo.uff"))
    assert reading.clock == "200 Hz, as written by this package" and reading.record.name == "demo"
