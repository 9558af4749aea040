"""Model files: the same bits come back; spoilt files are refused as the schema says."""

import json
import resource
from importlib.resources import files

import jsonschema
import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, datasets, laws, simulate
from pysindy_nrf.exceptions import FileFormatError, FileVersionError


@pytest.fixture(scope="module")
def validator():
    schema = files("pysindy_nrf") / "common/schemas/chain_model.schema.json"
    return jsonschema.Draft202012Validator(json.loads(schema.read_text()))


def test_a_fitted_model_obeys_the_schema_and_runs_the_same_bits(tmp_path, validator):
    record = datasets.load_demo()
    model = NRFRegressor(degree=3).fit(record).model_
    path = tmp_path / "m.json"
    model.to_json(path)
    validator.validate(json.loads(path.read_text()))
    again = ChainModel.from_json(path)
    forces = record.force[:400]
    displacement = simulate(model, forces, record.dt).displacement
    other = simulate(again, forces, record.dt).displacement
    assert displacement.tobytes() == other.tobytes()


MODEL = ChainModel(
    [10.0, 12.0],
    {
        1: [laws.PowerSeries(1, [1.0, 2.0]), laws.Dahl(sigma=5e4, Fd=3.0)],
        2: laws.PowerSeries(1, [1, 2]),
    },
).to_dict()
ODD_VALUES = [
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
    np.nan,
]


def places(data, path=()):
    """Paths to every value in plain data."""
    if path:
        yield path
    if isinstance(data, dict):
        for key in data:
            yield from places(data[key], (*path, key))
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from places(value, (*path, i))


def spoilt(path, value):
    """The model with another value at one place."""
    data = json.loads(json.dumps(MODEL))
    parent = data
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    return data


def path_name(path):
    return ".".join(map(str, path))


@pytest.mark.parametrize("path", list(places(MODEL)), ids=path_name)
def test_a_spoilt_model_is_refused_as_the_schema_says(path, validator):
    """Refused by name or a model; never accepted against the schema."""
    for odd in ODD_VALUES:
        data = spoilt(path, odd)
        try:
            ChainModel.from_json(json.dumps(data))
        except FileFormatError:
            continue
        assert validator.is_valid(data), odd


def test_a_file_of_a_later_version():
    with pytest.raises(FileVersionError, match="version 2, this package"):
        ChainModel.from_json(json.dumps(MODEL | {"version": 2}))


def test_a_key_twice():
    text = json.dumps(MODEL)
    twice = text.replace('"masses"', '"masses": [1.0, 1.0], "masses"', 1)
    with pytest.raises(FileFormatError, match="twice"):
        ChainModel.from_json(twice)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mases": [1.0]}, "'mases' was unexpected"),
        ({"masses": [float("nan"), 1.0]}, "NaN"),
        ({"masses": [1.0, 2.0, 3.0]}, "3 masses for 2 DOFs"),
        ({"schema": "another"}, "not a saved chain model"),
    ],
)
def test_loopholes_of_json(change, message):
    with pytest.raises(FileFormatError, match=message):
        ChainModel.from_json(json.dumps(MODEL | change))


def test_a_number_that_could_not_be_written_again():
    text = json.dumps(MODEL | {"info": {"band": [1.0]}})
    with pytest.raises(FileFormatError, match="1e9990 is beyond the range"):
        ChainModel.from_json(text.replace("[1.0]}", "[1e9990]}"))


@pytest.mark.parametrize("source", [3.5, "no/such/file.json", "[]"])
def test_what_is_no_file_of_a_model(source):
    with pytest.raises(FileFormatError):
        ChainModel.from_json(source)


HUGE = 10**9


@pytest.mark.parametrize(
    "change",
    [
        {"laws": {"storey 1": [{"law": "power_series", "options": {"degree": HUGE}}]}},
        {
            "laws": {
                "storey 1": [
                    {"law": "power_series", "options": {"degree": [HUGE, HUGE]}}
                ]
            }
        },
        {"masses": [1.0], "chain": {"n_dof": HUGE}},
        {"chain": {"n_dof": 2, "links": ["link 99999999999999999999-0"]}},
        {"laws": {"storey 1": [{"law": "__class__"}]}},
        {"visited": {"storey 1": {"low": [0, 0], "high": [1, 1], "cells": [[]]}}},
        {"visited": {"storey 1": {"low": [0], "high": [1, 1], "cells": ["x"]}}},
    ],
)
def test_a_hostile_model_is_refused_and_takes_no_memory(change):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileFormatError):
        ChainModel.from_json(json.dumps(MODEL | change))
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert after - before < 200_000  # kB
