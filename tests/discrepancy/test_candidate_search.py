"""What a search finds beside the linear chain."""

import pytest
from loop_parts import findings_of, first_state
from simulated_cases import Plan

from pysindy_nrf import Site, laws
from pysindy_nrf.discrepancy import judge

CATALOGUE = [
    laws.CoulombFriction(),
    laws.QuadraticDamping(),
    laws.CubicStiffness(),
    laws.OneSidedGap(),
    laws.Jenkins(),
]
STOREY_2 = Site("storey 2")


def hidden(kind, noise):
    """Three forced floors with an effect of 12 % of the force in storey 2."""
    return Plan(3, (1, 2, 3), noise=noise, effects=((kind, 2, 1, 0.12),), seed=72)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_where_nothing_is_missing_nothing_gains(noise):
    state = first_state(Plan(3, (1, 2, 3), noise=noise, seed=75, n_samples=4000))
    for finding in findings_of(state, CATALOGUE):
        assert finding.value < judge.JUDGE.least_reduction


@pytest.mark.parametrize(
    ("kind", "family"),
    [("coulomb", "friction"), ("cubic", "stiffness"), ("quadratic_damping", "damping")],
)
def test_what_is_missing_gains_most_where_it_is(kind, family):
    state = first_state(hidden(kind, noise=0.01))
    best, *others = findings_of(state, CATALOGUE)
    assert (best.family, best.candidate.sites) == (family, (STOREY_2,))
    assert judge.is_there(best.reduction)
    for finding in others:
        if STOREY_2 not in finding.candidate.sites:
            assert finding.value < 0.5 * best.value


def test_a_law_at_every_storey_stands_where_its_coefficient_is_known():
    state = first_state(hidden("cubic", noise=0.02))
    findings = findings_of(state, [laws.CubicStiffness()])
    assert findings[0].candidate.sites == (STOREY_2,) and findings[0].value > 5
    assert max(len(f.candidate.sites) for f in findings) < 3
