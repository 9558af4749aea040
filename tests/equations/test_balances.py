"""Equations of motion of records: the same columns whole, by block and by law."""

import numpy as np
import pytest

from pysindy_nrf import Chain, laws
from pysindy_nrf.chain import LawLayout
from pysindy_nrf.equations import BalanceEquations
from pysindy_nrf.records import ZeroPhaseFilter, from_arrays

LAYOUT = LawLayout(
    Chain(3, ["link 3-1"]),
    {
        "storey 1": [laws.PowerSeries(2), laws.Dahl(sigma=300.0)],
        "storey 2": [laws.CoulombFriction()],
        "link 3-1": [laws.LinearElastic(), laws.Jenkins(uy=1e-3)],
        "dof 2": [laws.AddedMass()],
    },
)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    s = np.cumsum(rng.normal(size=(3000, 3)), axis=0) * 1e-4
    v = np.gradient(s, axis=0) * 1e3
    F = rng.normal(size=(3000, 3))
    F[:, 1] = np.nan
    return from_arrays(np.hstack([rng.normal(size=(3000, 3)), v, s]), F, dt=1e-3)


@pytest.fixture(params=["raw", "filtered"])
def equations(data, request):
    filter = None
    if request.param == "filtered":
        filter = ZeroPhaseFilter((5.0, 100.0), fs=1000.0)
    return BalanceEquations(data, LAYOUT, [filter])


def filtered(equations, lines):
    (filter,) = equations.filters
    return lines if filter is None else filter.apply(lines)


def test_columns_of_a_site_are_the_features_of_its_laws(equations):
    (segment,) = equations.data.segments
    block = equations.whole_record(0)
    for site in LAYOUT.acting:
        motion = segment.motion(site, segment.valid)
        features = np.hstack([law.features(motion) for law in LAYOUT.laws[site]])
        expected = filtered(equations, features).T
        columns = block.terms[LAYOUT.slices[site]]
        assert columns == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_right_hand_sides_are_accelerations_and_the_forces_that_are_known(equations):
    (segment,) = equations.data.segments
    block = equations.whole_record(0)
    acceleration = filtered(equations, segment.a[segment.valid])
    force = filtered(equations, segment.F[segment.valid][:, [0, 2]])
    assert block.acceleration == pytest.approx(acceleration.T, abs=1e-12)
    assert block.force[[0, 2]] == pytest.approx(force.T, abs=1e-12)
    assert block.known == (True, False, True)


def test_blocks_follow_each_other_and_laws_remember(equations):
    terms = [block.terms for block in equations.blocks(0)]
    expected = equations.whole_record(0).terms
    assert np.hstack(terms) == pytest.approx(expected, rel=1e-9, abs=1e-12)
