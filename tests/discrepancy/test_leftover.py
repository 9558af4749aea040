"""A law that is nearly the effect leaves a function of the motion at its site, and its name is then not sure."""

from __future__ import annotations

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainModel, NRFRegressor, Site, close_loop, excitation, laws, simulate
from pysindy_nrf.discrepancy import leftover as room
from pysindy_nrf.discrepancy.evidence import searched
from pysindy_nrf.discrepancy.leftover import leftover
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.splits import split
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.laws import Motion
from pysindy_nrf.simulation.noise import add_noise

FS = 400.0
M, C, K = [20.0, 15.0, 12.0], [40.0, 30.0, 30.0], [6e4, 5e4, 4e4]


def record(effect, site, noise):
    """Three floors, the top one shaken, with one effect."""
    held = {f"storey {i + 1}": [laws.LinearViscous(C[i]), laws.LinearElastic(K[i])] for i in range(3)}
    held.setdefault(site, []).append(effect)
    F = excitation.band_limited_random(3, 20.0, FS, dofs=[3], rms=60.0, band=(0.5, 25.0), random_state=2)
    return add_noise(simulate(ChainModel(M, held), F, 1 / FS, hold="cubic"), noise, random_state=4)


@pytest.mark.parametrize(
    "tried, sure", [(laws.CoulombFriction(), False), (laws.PowerLawDamping(), True)], ids=["friction", "power"]
)
def test_friction_is_not_sure_of_a_force_that_grows_with_the_rate(tried, sure):
    """A root of the rate: friction takes three quarters of it, which is little of all balances."""
    noisy = record(laws.PowerLawDamping(cn=12.0, n=0.35), "storey 1", 0.005)
    report = close_loop(noisy, NRFRegressor(degree=1), catalogue=[tried])
    (step,) = report.steps
    assert (step.law, step.site, step.sure) == (tried.name, "storey 1", sure)
    assert (step.remainder > 0.1) != sure and ("closest law" in report.to_markdown()) != sure


@pytest.mark.parametrize("site, beside", [("storey 2", "storey 2"), ("ground 2", "dof 2")])
def test_what_is_left_has_the_size_of_what_was_not_said(site, beside):
    """A cubic spring of which a law of s^5 tells a part; the size of the rest follows from the motion alone."""
    s = Site(site)
    ready = prepare(record(laws.CubicStiffness(1e9), site, 0.0))
    search, held = split(ready.data.segments, ready.heldout)
    work = Workspace(ready.data, [None], search, held, dict(enumerate(M, 1)), "auto")
    linear = {Site(f"storey {i}"): (laws.LinearViscous(), laws.LinearElastic()) for i in (1, 2, 3)}
    plain = Stage(work, Chain(3), linear)
    right, wrong = (plain.with_law(s, law()) for law in (laws.CubicStiffness, laws.QuinticStiffness))
    number = len(right.laws[s]) - 1
    assert room._where(s) == beside and leftover(right, [], [(s, number)]) < 1e-3
    seen = [piece.motion(s, piece.valid) for piece in searched(work)[0].segments]
    drift, rate = (np.concatenate([getattr(m, name) for m in seen]) for name in "sv")
    model = wrong.trial().model()
    said = model.laws[s][-1].features(Motion(drift, rate))[:, 0] * model.laws[s][-1].values[0]

    def beyond_lines(y):
        lines = np.column_stack([drift, rate])
        return np.sqrt(np.mean((y - lines @ np.linalg.lstsq(lines, y, rcond=None)[0]) ** 2))

    expected = beyond_lines(1e9 * drift**3 - said) / beyond_lines(said)
    assert leftover(wrong, [], [(s, number)]) == pytest.approx(expected, rel=0.3) and expected > 0.1
    assert leftover(wrong, [wrong], [(s, number)]) == 0.0  # no more than where noise is all that is left


