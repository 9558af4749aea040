"""Model files: model -> JSON -> model predicts the same bits; spoilt files are refused
as the schema says.
"""

import json
import resource

import jsonschema
import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, datasets, laws, simulate
from pysindy_nrf.common.files import schema
from pysindy_nrf.exceptions import FileFormatError, FileVersionError


def test_a_fitted_model_obeys_the_schema_and_runs_the_same_bits(tmp_path):
    record = datasets.load_demo()
    model = NRFRegressor(degree=3).fit(record).model_
    model.to_json(tmp_path / "m.json")
    jsonschema.Draft202012Validator(schema()).validate(
        json.loads((tmp_path / "m.json").read_text())
    )
    back = ChainModel.from_json(tmp_path / "m.json")
    a, b = (
        simulate(m, record.force[:400], record.dt).displacement for m in (model, back)
    )
    assert a.tobytes() == b.tobytes()


BASE = ChainModel(
    [10.0, 12.0],
    {
        1: [laws.PowerSeries(1, [1.0, 2.0]), laws.Dahl(sigma=5e4, Fd=3.0)],
        2: laws.PowerSeries(1, [1, 2]),
    },
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
    np.nan,
]


def _places(data, path=()):
    yield path
    items = (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    )
    for key, value in items:
        yield from _places(value, (*path, key))


@pytest.mark.parametrize(
    "path", [p for p in _places(BASE) if p], ids=lambda p: ".".join(map(str, p))
)
def test_a_spoilt_model_is_refused_in_words_and_as_the_schema_says(path):
    """Every place of the file, every odd value: refused by name or a model; never
    accepted against the schema.
    """
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
    with pytest.raises(
        FileFormatError, match="1e9990 is beyond the range of a double"
    ):  # anywhere: it could not be written
        ChainModel.from_json(
            json.dumps(BASE | {"info": {"band": [1.0]}}).replace("[1.0]}", "[1e9990]}")
        )


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["laws"].update(
            {"storey 1": [{"law": "power_series", "options": {"degree": 10**9}}]}
        ),
        lambda d: d["laws"].update(
            {
                "storey 1": [
                    {"law": "power_series", "options": {"degree": [10**9, 10**9]}}
                ]
            }
        ),
        lambda d: d.update(masses=[1.0], chain={"n_dof": 10**9}),
        lambda d: d["chain"].update(links=["link 99999999999999999999-0"]),
        lambda d: d.update(laws={"storey 1": [{"law": "__class__"}]}),
        lambda d: d["visited"].update(
            {"storey 1": {"low": [0, 0], "high": [1, 1], "cells": [[]]}}
        ),
        lambda d: d["visited"].update(
            {"storey 1": {"low": [0], "high": [1, 1], "cells": ["x"]}}
        ),
    ],
)
def test_a_hostile_model_is_refused(change):
    data = json.loads(json.dumps(BASE))
    change(data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileFormatError):
        ChainModel.from_json(json.dumps(data))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB
