"""Bad input to identified models: predictions, forces, intervals, free runs."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial
from operator import getitem
from typing import Any

import numpy as np
from sklearn.exceptions import NotFittedError

from pysindy_nrf import ChainModel, NRFRegressor, laws, simulate
from pysindy_nrf.exceptions import ExtrapolationWarning

from .kind import Kind, refused
from .material import STEP, chain_model, changed, features, table

PUSH = np.zeros((100, 3))


@cache
def fitted() -> NRFRegressor:
    """A regressor fitted to good measurements."""
    return NRFRegressor(degree=(1, 3)).fit(*features())


def free_run(F: Any = PUSH, dt: Any = STEP, **options: Any) -> partial:
    """A free run of the true model."""
    return partial(simulate, chain_model(), F, dt, **options)


def kinds() -> Iterator[Kind]:
    """All kinds of this room."""
    yield from predictions()
    yield from restoring_forces()
    yield from intervals()
    yield from loads()
    yield from starts_and_methods()
    yield from impossible_models()
    yield from unfitted()


def predictions() -> Iterator[Kind]:
    """Motions and forces that are not those of the model."""
    X, F = features()
    model = fitted()

    yield refused(
        "predict on another chain",
        partial(model.predict, X[:, :6]),
        "X has 6 .*9 (columns )?are needed",
        "a1",
    )
    yield refused(
        "predict with a gap",
        partial(model.predict, changed(X, 70, 3, np.nan)),
        "v1 is NaN in row 70",
        "Split",
    )
    yield refused(
        "predict without a column",
        partial(model.predict, table().drop(columns="s3")),
        "lacks s3",
        "Name the columns",
    )
    yield refused("predict complex", partial(model.predict, X + 0j), "complex", ".real")
    yield refused(
        "score with other lengths",
        partial(model.score, X, F[:-2]),
        "F has 1498 samples",
        "same clock",
    )
    yield refused(
        "balance errors with infinity",
        partial(model.balance_errors, changed(X, 5, 5, np.inf), F),
        "v3 is infinite in row 5",
        "Repair",
    )


def restoring_forces() -> Iterator[Kind]:
    """Forces of a storey at rates and drifts that are none."""
    forces = fitted().restoring_forces_

    yield refused(
        "a storey that is not there", partial(getitem, forces, 9), "9", "storey 1"
    )
    yield refused(
        "a force at complex drift",
        partial(forces[1], 0.0, np.array([1j])),
        "complex|numbers",
        "real|number",
    )
    yield refused(
        "a force at a drift in words",
        partial(forces[1], 0.0, ["left"]),
        "storey 1 are not numbers",
        "drifts in m",
    )
    yield refused(
        "rates and drifts of other lengths",
        partial(forces[1], np.zeros(3), np.zeros(2)),
        "not numbers of one shape",
        "drifts in m",
    )
    yield refused(
        "a surface of one point",
        partial(fitted().model_.surface, 1, size=1),
        "surface",
        "at least 2",
    )
    yield Kind(
        "a force far outside the data",
        partial(fitted().force_intervals, 1, 0.0, np.array([5.0])),
        ExtrapolationWarning,
        ("storey 1: 1 of 1 points", "extrapolation"),
    )


def intervals() -> Iterator[Kind]:
    """Levels and tolerances of intervals."""
    asked = fitted().confidence_intervals

    yield refused("intervals of level 95", partial(asked, 95), "level=95", "0.95")
    yield refused(
        "a tolerance below zero",
        partial(asked, calibration={"gain": -0.01}),
        r"calibration\['gain'\]=-0.01",
        "none below zero",
    )
    yield refused(
        "intervals of nothing known",
        partial(asked, of="colours"),
        "of='colours'",
        "parameters|modes",
    )


def loads() -> Iterator[Kind]:
    """Forces and base motions of a free run."""
    yield refused(
        "free run without a clock",
        partial(fitted().simulate, features()[1]),
        "needs the sampling step of F",
        "dt=",
    )
    yield refused(
        "free run with a gap in the force",
        free_run(changed(PUSH, 7, 1, np.nan)),
        "F2 of the force is not finite in row 7",
        "number for every sample",
    )
    yield refused(
        "free run with a step of zero",
        free_run(dt=0.0),
        "dt=0.0 is not a positive number",
        "sampling step",
    )
    yield refused(
        "free run with one sample", free_run(PUSH[:1]), "1 samples", "At least two"
    )
    yield refused(
        "free run of other DOFs",
        free_run(PUSH[:, :2]),
        "2 columns, 3 are needed",
        "F1, F2, F3",
    )
    yield refused(
        "free run with a base of other length",
        free_run(base_acceleration=np.zeros(7)),
        "ag has 7 samples",
        "one clock",
    )


def starts_and_methods() -> Iterator[Kind]:
    """Initial conditions and options of a free run."""
    yield refused(
        "free run from a start of other DOFs",
        free_run(x0=[0.0, 0.0]),
        "x0 has shape",
        "one initial displacement",
    )
    yield refused(
        "free run from infinity",
        free_run(x0=[0.0, np.inf, 0.0]),
        "x2 .* is not finite",
        "number",
    )
    yield refused(
        "free run by magic", free_run(method="magic"), "method='magic'", "Choose"
    )
    yield refused(
        "free run with an unknown hold",
        free_run(hold="quadratic"),
        "hold='quadratic'",
        "Choose",
    )


def impossible_models() -> Iterator[Kind]:
    """Free runs and modes of models that diverge or have no mass."""
    spring = {1: laws.LinearElastic(1e5)}
    unstable = ChainModel([1.0], {1: laws.Duffing(100.0, -1e6)})
    lifted = ChainModel([-3.0], spring)
    push = PUSH[:, :1]

    yield refused(
        "free run that diverges",
        partial(simulate, unstable, np.full((1000, 1), 50.0), 1e-3),
        "diverges at .* DOF",
        "lower the force",
    )
    yield refused(
        "free run without masses",
        partial(simulate, ChainModel([0.0], spring), push, STEP),
        "m1|mass",
        "positive|mass",
    )
    yield refused(
        "free run with a negative mass",
        partial(simulate, lifted, push, STEP),
        "m1|mass",
        "positive|mass",
    )
    yield refused(
        "modes with a negative mass",
        partial(lifted.modes),
        "m1 is not positive",
        "positive masses",
    )


def unfitted() -> Iterator[Kind]:
    """A regressor that was never fitted."""
    X, F = features()
    calls = {
        "predict": partial(NRFRegressor().predict, X),
        "score": partial(NRFRegressor().score, X, F),
        "modes": partial(NRFRegressor().modes),
        "free run": partial(NRFRegressor().simulate, F, dt=STEP),
        "intervals": partial(NRFRegressor().confidence_intervals),
    }
    for name, call in calls.items():
        words = ("not fitted yet", "fit")
        yield Kind(f"{name} before fit", call, NotFittedError, words)
