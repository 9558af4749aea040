"""Bad input to laws, sites, chains and identified models."""

# ruff: noqa: E501

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
from sklearn.exceptions import NotFittedError

from pysindy_nrf import Chain, ChainModel, NRFRegressor, Site, laws, simulate
from pysindy_nrf.exceptions import ExtrapolationWarning, NRFError

from .kind import Kind
from .material import STEP, chain_model, changed, features, table


def with_region(text: str) -> str:
    """The JSON of a model with a region of storey 1 that someone wrote."""
    return (
        chain_model()
        .to_json()
        .replace('"visited": {}', f'"visited": {{"storey 1": {text}}}')
    )


def with_degree(degree: int) -> str:
    """The JSON of a model with a power series of a degree that someone wrote."""
    text = json.dumps(
        {
            "law": "power_series",
            "options": {"degree": degree},
            "shape": {},
            "coefficients": [1.0],
        }
    )
    return (
        chain_model()
        .to_json(indent=None)
        .replace('{"storey 1": [', f'{{"storey 1": [{text}, ')
    )


def of_laws() -> dict[str, tuple]:
    return {
        "too few coefficients": (
            lambda: laws.PowerSeries(3, [1, 2]),
            "9 coefficients, 2 were given",
            "Their order",
        ),
        "a coefficient that is not there": (
            lambda: laws.PowerSeries(1, {"c_9_9": 1.0}),
            "no coefficient 'c_9_9'",
            "It has",
        ),
        "a coefficient in words": (
            lambda: laws.Duffing(k="stiff"),
            "not a finite number",
            "SI units",
        ),
        "a coefficient that is NaN": (
            lambda: laws.LinearElastic(np.nan),
            "not a finite number",
            "SI units",
        ),
        "a negative sigma": (
            lambda: laws.Dahl(sigma=-1.0),
            "sigma=-1 is not positive",
            "unit",
        ),
        "a sigma that is NaN": (
            lambda: laws.Dahl(sigma=np.nan),
            "not a finite number",
            "SI units",
        ),
        "a complex coefficient": (
            lambda: laws.LinearElastic(1e5 + 1j),
            "not a finite number",
            "SI units",
        ),
        "a shape parameter that is not there": (
            lambda: laws.Dahl().with_values(shape={"tau": 1.0}),
            "no shape parameter 'tau'",
            "It has",
        ),
        "an unknown law": (
            lambda: laws.from_dict({"law": "magic"}),
            "no law 'magic'",
            "Known laws",
        ),
        "options that do not fit": (
            lambda: laws.from_dict({"law": "power_series", "options": {"order": 3}}),
            "cannot be built",
        ),
        "a number for a law": (
            lambda: laws.from_dict(3),
            "does not describe a law",
            "It needs",
        ),
        "a covariate without a name": (
            lambda: laws.CovariateFriction(""),
            "not the name of a channel",
            "covariate=",
        ),
        "a million powers": (
            lambda: laws.PowerSeries(10**6),
            "above the highest power",
            "lower degree",
        ),
        "a box of a million powers": (
            lambda: laws.from_dict(
                {"law": "power_series", "options": {"degree": [0, 10**9]}}
            ),
            "above the highest power",
            "lower degree",
        ),
        "a site in other words": (
            lambda: Site("floor 2"),
            "'floor 2' is not a site",
            "Write it as",
        ),
        "storey 0": (lambda: Site("storey 0"), "does not exist", "count from 1"),
        "a link to itself": (
            lambda: Site("link 2-2"),
            "joins DOF 2 to itself",
            "two different",
        ),
        "half a storey": (lambda: Site(1.5), "is not a site", "Write it as"),
        "a chain without masses": (
            lambda: Chain(0),
            "not a number of masses",
            "at least 1",
        ),
        "a chain of 2.5 masses": (
            lambda: Chain(2.5),
            "not a number of masses",
            "whole number",
        ),
        "a chain of a billion masses": (
            lambda: Chain(10**9),
            "a chain may have",
            "Condense",
        ),
        "a link beyond the roof": (
            lambda: Chain(3, ["link 9-1"]),
            "is not a link of a chain with 3 DOFs",
            "Links are",
        ),
        "a link twice": (
            lambda: Chain(3, ["link 3-1", "link 1-3"]),
            "in the chain already",
            "once",
        ),
        "an unknown ground": (
            lambda: Chain(3, ground="sea"),
            "ground='sea' is unknown",
            "Choose",
        ),
        "a model of NaN masses": (
            lambda: ChainModel([np.nan], {}),
            "masses are not",
            "Give one mass",
        ),
        "a model of masses in words": (
            lambda: ChainModel(["heavy"], {}),
            "masses are not",
            "Give one mass",
        ),
        "a model without masses": (lambda: ChainModel([], {}), "mass"),
        "a model with a law without values": (
            lambda: ChainModel([1.0], {1: laws.Dahl()}),
            "has no values",
            "Give its coefficients",
        ),
        "a model with something else for a law": (
            lambda: ChainModel([1.0], {1: "dahl"}),
            "not a force law",
            "pysindy_nrf.laws",
        ),
        "a model with a law beyond the roof": (
            lambda: ChainModel([1.0], {4: laws.LinearElastic(1e5)}),
            "does not exist|is not a link|not in the chain",
        ),
        "JSON that is a list": (
            lambda: ChainModel.from_json("{}"),
            "does not hold a chain model",
            "schema",
        ),
        "JSON cut off": (
            lambda: ChainModel.from_json(chain_model().to_json()[:200]),
            "not a readable chain model",
            "to_json",
        ),
        "JSON with NaN masses": (
            lambda: ChainModel.from_json(
                chain_model().to_json().replace("12.0", "NaN")
            ),
            "readable chain model|masses",
            "to_json|Give",
        ),
        "JSON of a newer version": (
            lambda: ChainModel.from_json(
                chain_model().to_json().replace('"version": 1', '"version": 99')
            ),
            "has version 99",
            "Update",
        ),
        "a JSON file that is not there": (
            lambda: ChainModel.from_json("no_such_model.json"),
            "no_such_model.json does not exist",
            "path",
        ),
        "a JSON file that is a folder": (
            lambda: ChainModel.from_json("."),
            "is not a file",
            "Give one file",
        ),
        "a number for a JSON file": (
            lambda: ChainModel.from_json(0),
            "neither JSON text nor a path",
            "to_json",
        ),
        "JSON with a region of text": (
            lambda: ChainModel.from_json(
                with_region('{"low": "ab", "high": [1, 2], "cells": ["x"]}')
            ),
            "not a readable chain model: .*low",
            "Write the file again",
        ),
        "JSON with a law that wants all memory": (
            lambda: ChainModel.from_json(with_degree(10**9)),
            "not a readable chain model: .*(degree|highest power)",
            "Write the file again",
        ),
        "JSON nested a hundred thousand deep": (
            lambda: ChainModel.from_json('{"a":' + "[" * 100_000),
            "not a readable chain model",
            "to_json",
        ),
        "JSON with a billion DOFs": (
            lambda: ChainModel.from_json(
                chain_model().to_json().replace('"n_dof": 3', '"n_dof": 1000000000')
            ),
            "3 masses for 1000000000 DOFs",
            "to_json",
        ),
    }


@cache
def fitted() -> NRFRegressor:
    X, F = features()
    return NRFRegressor(degree=(1, 3)).fit(X, F)


def of_models() -> dict[str, tuple]:
    X, F = features()
    m, truth = fitted(), chain_model()
    push = np.zeros((100, 3))

    def with_X(act: Any, bad: Any) -> tuple:
        return act, (bad,)

    def run(F: Any = push, dt: Any = STEP, **options: Any) -> tuple:
        return lambda F, o: simulate(truth, F, dt, **o), (F, options)

    return {
        "predict on another chain": (
            with_X(m.predict, X[:, :6]),
            "X has 6 .*9 (columns )?are needed",
            "a1",
        ),
        "predict with a gap": (
            with_X(m.predict, changed(X, 70, 3, np.nan)),
            "v1 is NaN in row 70",
            "Split",
        ),
        "predict without a column": (
            with_X(m.predict, table().drop(columns="s3")),
            "lacks s3",
            "Name the columns",
        ),
        "predict complex": (with_X(m.predict, X + 0j), "complex", ".real"),
        "score with other lengths": (
            (m.score, (X, F[:-2])),
            "F has 1498 samples",
            "same clock",
        ),
        "balance errors with infinity": (
            (m.balance_errors, (changed(X, 5, 5, np.inf), F)),
            "v3 is infinite in row 5",
            "Repair",
        ),
        "a storey that is not there": (
            with_X(lambda i: m.restoring_forces_[i], 9),
            "9",
            "storey 1",
        ),
        "a force at complex drift": (
            with_X(lambda s: m.restoring_forces_[1](0.0, s), np.array([1j])),
            "complex|numbers",
            "real|number",
        ),
        "a force at a drift in words": (
            with_X(lambda s: m.restoring_forces_[1](0.0, s), ["left"]),
            "storey 1 are not numbers",
            "drifts in m",
        ),
        "rates and drifts of other lengths": (
            with_X(lambda s: m.restoring_forces_[1](np.zeros(3), s), np.zeros(2)),
            "not numbers of one shape",
            "drifts in m",
        ),
        "a surface of one point": (
            with_X(lambda n: m.model_.surface(1, size=n), 1),
            "surface",
            "at least 2",
        ),
        "intervals of level 95": (
            with_X(m.confidence_intervals, 95),
            "level=95",
            "0.95",
        ),
        "a tolerance below zero": (
            with_X(
                lambda gain: m.confidence_intervals(calibration={"gain": gain}), -0.01
            ),
            "calibration\\['gain'\\]=-0.01",
            "none below zero",
        ),
        "intervals of nothing known": (
            with_X(lambda of: m.confidence_intervals(of=of), "colours"),
            "of='colours'",
            "parameters|modes",
        ),
        "free run without a clock": (
            with_X(m.simulate, F),
            "needs the sampling step of F",
            "dt=",
        ),
        "free run with a gap in the force": (
            run(changed(push, 7, 1, np.nan)),
            "F2 of the force is not finite in row 7",
            "number for every sample",
        ),
        "free run with a step of zero": (
            run(dt=0.0),
            "dt=0.0 is not a positive number",
            "sampling step",
        ),
        "free run with one sample": (run(push[:1]), "1 samples", "At least two"),
        "free run of other DOFs": (
            run(push[:, :2]),
            "2 columns, 3 are needed",
            "F1, F2, F3",
        ),
        "free run from a start of other DOFs": (
            run(x0=[0.0, 0.0]),
            "x0 has shape",
            "one initial displacement",
        ),
        "free run from infinity": (
            run(x0=[0.0, np.inf, 0.0]),
            "x2 .* is not finite",
            "number",
        ),
        "free run by magic": (run(method="magic"), "method='magic'", "Choose"),
        "free run with an unknown hold": (
            run(hold="quadratic"),
            "hold='quadratic'",
            "Choose",
        ),
        "free run with a base of other length": (
            run(base_acceleration=np.zeros(7)),
            "ag has 7 samples",
            "one clock",
        ),
        "free run that diverges": (
            (
                lambda F: simulate(
                    ChainModel([1.0], {1: laws.Duffing(100.0, -1e6)}), F, 1e-3
                ),
                (np.full((1000, 1), 50.0),),
            ),
            "diverges at .* DOF",
            "lower the force",
        ),
        "free run without masses": (
            (
                lambda F: simulate(
                    ChainModel([0.0], {1: laws.LinearElastic(1e5)}), F, STEP
                ),
                (push[:, :1],),
            ),
            "m1|mass",
            "positive|mass",
        ),
        "free run with a negative mass": (
            (
                lambda F: simulate(
                    ChainModel([-3.0], {1: laws.LinearElastic(1e5)}), F, STEP
                ),
                (push[:, :1],),
            ),
            "m1|mass",
            "positive|mass",
        ),
        "modes with a negative mass": (
            (lambda: ChainModel([-3.0], {1: laws.LinearElastic(1e5)}).modes(), ()),
            "m1 is not positive",
            "positive masses",
        ),
    }


def unfitted() -> dict[str, Any]:
    X, F = features()
    return {
        "predict before fit": (lambda X: NRFRegressor().predict(X), (X,)),
        "score before fit": (lambda X, F: NRFRegressor().score(X, F), (X, F)),
        "modes before fit": (lambda: NRFRegressor().modes(), ()),
        "free run before fit": (lambda F: NRFRegressor().simulate(F, dt=STEP), (F,)),
        "intervals before fit": (lambda: NRFRegressor().confidence_intervals(), ()),
    }


def kinds() -> list[Kind]:
    """All kinds of this room."""
    out = [
        Kind("law", name, act, (), NRFError, tuple(words))
        for name, (act, *words) in of_laws().items()
    ]
    out += [
        Kind("model", name, act, given, NRFError, tuple(words))
        for name, ((act, given), *words) in of_models().items()
    ]
    out += [
        Kind("model", name, act, given, NotFittedError, ("not fitted yet", "fit"))
        for name, (act, given) in unfitted().items()
    ]
    far = (lambda s: fitted().force_intervals(1, 0.0, s), (np.array([5.0]),))
    words = ("storey 1: 1 of 1 points", "extrapolation")
    out.append(
        Kind("model", "a force far outside the data", *far, ExtrapolationWarning, words)
    )
    return out
