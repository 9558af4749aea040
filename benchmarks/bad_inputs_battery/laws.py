"""Bad input to laws, sites, chains, and models that someone wrote."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from pysindy_nrf import Chain, ChainModel, Site, laws

from .kind import Kind, refused
from .material import chain_model


def kinds() -> Iterator[Kind]:
    """All kinds of this room."""
    yield from coefficients()
    yield from descriptions()
    yield from structures()
    yield from models()
    yield from texts()
    yield from hostile_texts()


def coefficients() -> Iterator[Kind]:
    """Coefficients and shape parameters."""
    no_number = ("not a finite number", "SI units")

    yield refused(
        "too few coefficients",
        partial(laws.PowerSeries, 3, [1, 2]),
        "9 coefficients, 2 were given",
        "Their order",
    )
    yield refused(
        "a coefficient that is not there",
        partial(laws.PowerSeries, 1, {"c_9_9": 1.0}),
        "no coefficient 'c_9_9'",
        "It has",
    )
    yield refused(
        "a coefficient in words", partial(laws.Duffing, k="stiff"), *no_number
    )
    yield refused(
        "a coefficient that is NaN", partial(laws.LinearElastic, np.nan), *no_number
    )
    yield refused(
        "a complex coefficient", partial(laws.LinearElastic, 1e5 + 1j), *no_number
    )
    yield refused(
        "a negative sigma",
        partial(laws.Dahl, sigma=-1.0),
        "sigma=-1 is not positive",
        "unit",
    )
    yield refused("a sigma that is NaN", partial(laws.Dahl, sigma=np.nan), *no_number)
    yield refused(
        "a shape parameter that is not there",
        partial(laws.Dahl().with_values, shape={"tau": 1.0}),
        "no shape parameter 'tau'",
        "It has",
    )
    yield refused(
        "a covariate without a name",
        partial(laws.CovariateFriction, ""),
        "not the name of a channel",
        "covariate=",
    )
    yield refused(
        "a million powers",
        partial(laws.PowerSeries, 10**6),
        "above the highest power",
        "lower degree",
    )


def descriptions() -> Iterator[Kind]:
    """Laws described by dictionaries."""
    unknown_option = {"law": "power_series", "options": {"order": 3}}
    huge_box = {"law": "power_series", "options": {"degree": [0, 10**9]}}

    yield refused(
        "an unknown law",
        partial(laws.from_dict, {"law": "magic"}),
        "no law 'magic'",
        "Known laws",
    )
    yield refused(
        "options that do not fit",
        partial(laws.from_dict, unknown_option),
        "cannot be built",
    )
    yield refused(
        "a number for a law",
        partial(laws.from_dict, 3),
        "does not describe a law",
        "It needs",
    )
    yield refused(
        "a box of a million powers",
        partial(laws.from_dict, huge_box),
        "above the highest power",
        "lower degree",
    )


def structures() -> Iterator[Kind]:
    """Sites and chains."""
    yield refused(
        "a site in other words",
        partial(Site, "floor 2"),
        "'floor 2' is not a site",
        "Write it as",
    )
    yield refused(
        "storey 0", partial(Site, "storey 0"), "does not exist", "count from 1"
    )
    yield refused(
        "a link to itself",
        partial(Site, "link 2-2"),
        "joins DOF 2 to itself",
        "two different",
    )
    yield refused("half a storey", partial(Site, 1.5), "is not a site", "Write it as")
    yield refused(
        "a chain without masses",
        partial(Chain, 0),
        "not a number of masses",
        "at least 1",
    )
    yield refused(
        "a chain of 2.5 masses",
        partial(Chain, 2.5),
        "not a number of masses",
        "whole number",
    )
    yield refused(
        "a chain of a billion masses",
        partial(Chain, 10**9),
        "a chain may have",
        "Condense",
    )
    yield refused(
        "a link beyond the roof",
        partial(Chain, 3, ["link 9-1"]),
        "is not a link of a chain with 3 DOFs",
        "Links are",
    )
    yield refused(
        "a link twice",
        partial(Chain, 3, ["link 3-1", "link 1-3"]),
        "in the chain already",
        "once",
    )
    yield refused(
        "an unknown ground",
        partial(Chain, 3, ground="sea"),
        "ground='sea' is unknown",
        "Choose",
    )


def models() -> Iterator[Kind]:
    """Masses and laws that make no model."""
    no_masses = ("masses are not", "Give one mass")

    yield refused(
        "a model of NaN masses", partial(ChainModel, [np.nan], {}), *no_masses
    )
    yield refused(
        "a model of masses in words", partial(ChainModel, ["heavy"], {}), *no_masses
    )
    yield refused("a model without masses", partial(ChainModel, [], {}), "mass")
    yield refused(
        "a model with a law without values",
        partial(ChainModel, [1.0], {1: laws.Dahl()}),
        "has no values",
        "Give its coefficients",
    )
    yield refused(
        "a model with something else for a law",
        partial(ChainModel, [1.0], {1: "dahl"}),
        "not a force law",
        "pysindy_nrf.laws",
    )
    yield refused(
        "a model with a law beyond the roof",
        partial(ChainModel, [1.0], {4: laws.LinearElastic(1e5)}),
        "does not exist|is not a link|not in the chain",
    )


def read(text: Any) -> partial:
    """A model read from text, or from the file of that name."""
    return partial(ChainModel.from_json, text)


def texts() -> Iterator[Kind]:
    """Texts and files that hold no model."""
    good = chain_model().to_json()

    yield refused(
        "JSON that is a list", read("{}"), "not a saved chain model", "schema"
    )
    yield refused(
        "JSON cut off", read(good[:200]), "not a readable chain model", "to_json"
    )
    yield refused(
        "JSON with NaN masses",
        read(good.replace("12.0", "NaN")),
        "readable chain model|masses",
        "to_json|Give",
    )
    yield refused(
        "JSON of a newer version",
        read(good.replace('"version": 1', '"version": 99')),
        "has version 99",
        "Update",
    )
    yield refused(
        "a JSON file that is not there",
        read("no_such_model.json"),
        "no_such_model.json does not exist",
        "path",
    )
    yield refused(
        "a JSON file that is a folder", read("."), "is not a file", "Give one file"
    )
    yield refused(
        "a number for a JSON file",
        read(0),
        "neither JSON text nor a path",
        "to_json",
    )


def hostile_texts() -> Iterator[Kind]:
    """Models that ask for all memory, or hold something else where numbers belong."""
    good = chain_model()
    region = '{"storey 1": {"low": "ab", "high": [1, 2], "cells": ["x"]}}'
    endless = {
        "law": "power_series",
        "options": {"degree": 10**9},
        "shape": {},
        "coefficients": [1.0],
    }
    first_law = '{"storey 1": ['

    yield refused(
        "JSON with a region of text",
        read(good.to_json().replace('"visited": {}', f'"visited": {region}')),
        "not a readable chain model: .*low",
        "Write the file again",
    )
    compact = good.to_json(indent=None)
    yield refused(
        "JSON with a law that wants all memory",
        read(compact.replace(first_law, f"{first_law}{json.dumps(endless)}, ")),
        "not a readable chain model: .*(degree|highest power)",
        "Write the file again",
    )
    yield refused(
        "JSON nested a hundred thousand deep",
        read('{"a":' + "[" * 100_000),
        "not a readable chain model",
        "to_json",
    )
    yield refused(
        "JSON with a billion DOFs",
        read(good.to_json().replace('"n_dof": 3', '"n_dof": 1000000000')),
        "3 masses for 1000000000 DOFs",
        "to_json",
    )
