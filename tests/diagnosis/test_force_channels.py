"""Forces whose channel is not linear or not steady, and records that do not belong
together: named, with the size.
"""

import re
import warnings

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.records.checks.channel_checks import check_channels
from pysindy_nrf.simulation.noise import add_noise

LAWS = {
    f"storey {i}": (laws.LinearElastic(k), laws.LinearViscous(50.0))
    for i, k in ((1, 4e4), (2, 3e4), (3, 2.5e4))
}
FRAME, OTHER = (ChainModel([12.0, 9.0, m], LAWS) for m in (15.0, 18.0))


def record(seed=0, model=FRAME, excited=(1, 2, 3)):
    F = excitation.band_limited_random(
        3,
        15.0,
        400.0,
        excited=list(excited),
        rms=100.0,
        band=(1, 40),
        random_state=seed,
    )
    return add_noise(
        simulate(model, F, 1 / 400, name=f"test {seed}"), 0.01, random_state=seed
    )


@pytest.fixture(scope="module")
def one():
    return record()


def changed(rec, change):
    """The record with another force on floor 2."""
    F = rec.force.copy()
    F[:, 1] = change(F[:, 1])
    return rec.replace(force=F)


def doubts(records):
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor(degree=1).fit(records).data_warnings_


RAMP = np.linspace(-0.5, 0.5, 6000)
DISTORTED = {
    "it lacks 1[6-9]\\S* N on either side of zero .a dead band": (
        lambda y: np.sign(y) * np.maximum(np.abs(y) - 18, 0)
    ),
    "its gain differs by (9|10|11)\\S* % between push and pull": lambda y: np.where(
        y > 0, y, 0.9 * y
    ),
    "too small .saturation": lambda y: 300 * np.tanh(y / 300),
    "its gain drifts by (19|20) % over": lambda y: y * (1 + 0.2 * RAMP),
}


@pytest.mark.parametrize("words", DISTORTED)
def test_a_distorted_force_is_named_with_its_size(one, words):
    said = [
        text
        for text in doubts(changed(one, DISTORTED[words]))["forces"]
        if text.startswith("F2: ")
    ]
    assert len(said) == 1
    assert re.search(words, said[0]), said


def lost(y):
    rows = np.arange(len(y)) % 1500
    return np.where((rows > 700) & (rows < 720), 0.0, y)


@pytest.mark.parametrize(
    ("problem", "change"),
    [
        (
            "interpolated",
            lambda y: np.interp(np.arange(6000), np.arange(0, 6000, 4), y[::4]),
        ),
        ("interpolated", lambda y: y[np.arange(6000) // 5 * 5]),
        ("dropouts", lost),
        ("hum", lambda y: y + 10 * np.sin(2 * np.pi * 50 * np.arange(6000) / 400)),
        ("clipped", lambda y: np.clip(y, -150, 150)),
    ],
)
def test_a_fault_of_the_line_is_named_by_the_channel_alone(one, problem, change):
    found = check_channels(changed(one, change)).set_index("channel")["problem"]
    assert found.to_dict() == {"F2": problem} and check_channels(one).empty


def test_records_that_do_not_belong_together_are_named(one):
    assert not any(doubts([one, record(1)]).values())
    assert "hold the same samples" in doubts([one, one])["records"][0]
    said = " ".join(doubts([one, changed(record(1), lambda y: 1.2 * y)])["forces"])
    assert (
        "do not belong together" in said
        and "is the gain of F2 another one there?" in said
    )
    said = " ".join(doubts([one, record(1, OTHER)])["forces"])
    assert "the balance of DOF 3" in said and "another structure" in said
    alone, other = (record(k, model, [1]) for k, model in enumerate((FRAME, OTHER)))
    assert "the balance of DOF 3 in record" in " ".join(
        doubts([alone, other])["forces"]
    )  # on which no force acts
