"""Simulated tests through ``close_loop``: what is hidden is found where it acts, and
nothing where nothing is.

The loop gets the channels; the assertions alone read the truth.
"""

import pytest
from battery.generators import make_case
from discrepancy_battery import specifications
from simulated_cases import Plan, simulated

from pysindy_nrf import NRFRegressor, Record, Site, close_loop, laws

CATALOGUE = [
    laws.CoulombFriction(),
    laws.QuadraticDamping(),
    laws.QuadraticStiffness(),
    laws.CubicStiffness(),
    laws.QuinticStiffness(),
    laws.OneSidedGap(),
    laws.OneSidedGap(side=-1),
    laws.TwoSidedGap(),
    laws.Jenkins(),
    laws.Dahl(),
    laws.MaxwellBranch(),
    laws.StiffnessStep(),
    laws.HarmonicForce(),
    laws.ConstantForce(),
    laws.LinkSpringDashpot(),
    laws.ChannelDelay(),
    laws.GainError(),
    laws.SensorOffset(),
]
FAMILY = {
    "coulomb": "friction",
    "quadratic_damping": "damping",
    "cubic": "stiffness",
    "quintic": "stiffness",
    "quadratic": "stiffness",
    "two_sided_gap": "contact",
    "dahl": "hysteresis",
    "maxwell": "hysteresis",
    "stiffness_step": "degradation",
    "constant": "forcing",
}
COSTLY = pytest.mark.slow
IN_BOTH = (("cubic", 1, 0, 0.3), ("cubic", 2, 1, 0.3))
TWO_KINDS = (("quadratic", 1, 0, 0.2), ("cubic", 2, 1, 0.25))


def hidden(n, forced, effects, noise, seed, excitation="random"):
    """A test of a chain with effects.

    Each with its kind, its ends (0: the ground) and its rms over that of the force of
    its storey.
    """
    return Plan(n, forced, excitation, noise, effects, seed=seed)


def single_effect(kind, p, q, share):
    """A single effect."""
    return ((kind, p, q, share),)


# what the tests of single laws and sites leave out
HIDDEN = {
    "quintic spring of one mass": hidden(
        1, (1,), single_effect("quintic", 1, 0, 0.2), 0.01, 3
    ),
    "cubic spring": hidden(2, (1, 2), single_effect("cubic", 2, 1, 0.2), 0.0, 4),
    "quadratic damping under blows": hidden(
        2, (2,), single_effect("quadratic_damping", 1, 0, 0.2), 0.0, 5, "hammer"
    ),
    "dead load": hidden(2, (1, 2), single_effect("constant", 2, 0, 0.2), 0.005, 9),
    "cubic springs in both storeys": hidden(2, (2,), IN_BOTH, 0.02, 22),
}
HIDDEN_COSTLY = {
    "gap under a sweep": hidden(
        2, (1, 2), single_effect("two_sided_gap", 2, 1, 0.2), 0.005, 6, "sweep"
    ),
    "sudden loss of stiffness": hidden(
        2, (1, 2), single_effect("stiffness_step", 1, 0, 0.2), 0.01, 8
    ),
    "friction, one force": hidden(
        3, (3,), single_effect("coulomb", 2, 1, 0.2), 0.01, 10
    ),
    "viscoelastic branch": hidden(
        3, (1, 2, 3), single_effect("maxwell", 2, 1, 0.25), 0.0, 15
    ),
    "shaken base": hidden(
        2, (), single_effect("cubic", 2, 1, 0.25), 0.005, 16, "earthquake"
    ),
    "friction at 5 %": hidden(
        2, (1, 2), single_effect("coulomb", 2, 1, 0.25), 0.05, 17
    ),
    "hysteresis, one force": hidden(
        4, (4,), single_effect("dahl", 1, 0, 0.25), 0.0, 19
    ),
    "two effects": hidden(2, (1, 2), TWO_KINDS, 0.005, 21),
}


def loop(case, degree=1):
    """The loop on a case; without forces, all masses are declared."""
    known = None
    if "force" not in case.channels:
        known = dict(enumerate(case.masses, 1))
    baseline = NRFRegressor(degree=degree, known_masses=known)
    return close_loop(Record(**case.channels), baseline, CATALOGUE)


def balance(site):
    """A site; one between a DOF and the ground and the DOF itself are felt alike."""
    site = Site(str(site))
    return Site(f"ground {site.p}") if site.kind == "dof" else site


def family_of(name):
    """The family of the closest name; a general law has none."""
    return laws.registry()[name]().family if name else ""


def assert_found_where_it_acts(plan):
    case = simulated(plan)
    report = loop(case)
    outcomes = {}
    for step in report.steps:
        names = outcomes.setdefault(balance(step.site), set())
        names |= {step.family, *step.alternatives, family_of(step.closest)}

    wanted = {balance(effect.site): FAMILY[effect.kind] for effect in case.effects}
    assert set(outcomes) == set(wanted), str(report)
    for site, family in wanted.items():
        assert family in outcomes[site], str(report)
    heldout = report.table["held-out"]
    assert heldout.iloc[-1] < 0.9 * heldout.iloc[0]


@pytest.mark.parametrize("name", HIDDEN)
def test_what_is_hidden_is_found_where_it_acts(name):
    assert_found_where_it_acts(HIDDEN[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", HIDDEN_COSTLY)
def test_what_is_hidden_is_found_in_costlier_cases(name):
    assert_found_where_it_acts(HIDDEN_COSTLY[name])


@pytest.mark.parametrize(
    "plan",
    [
        Plan(1, (1,), seed=41),
        Plan(2, (1,), "sweep", 0.01, seed=42),
        pytest.param(Plan(4, (2,), noise=0.05, seed=44), marks=COSTLY),
        pytest.param(Plan(3, (), "earthquake", 0.01, seed=45), marks=COSTLY),
    ],
)
def test_nothing_is_added_where_nothing_is_missing(plan):
    assert loop(simulated(plan)).steps == []


def test_nothing_is_added_to_springs_that_are_declared():
    effects = (("cubic", 1, 0, 0.2), ("cubic", 2, 1, 0.2))
    case = simulated(Plan(2, (1, 2), noise=0.01, effects=effects, seed=46))
    assert loop(case, degree=3).steps == []


@pytest.mark.slow
def test_a_force_that_relaxes_is_not_taken_for_late_forces():
    """A branch that relaxes within the sweep delays what the floors feel."""
    case = make_case(**specifications("two", 4, seed=91)[3])
    report = close_loop(Record(**case.searched[0]))
    claims = {step.site: step.effect_class for step in report.steps}
    assert claims == {"storey 2": "hysteresis", "storey 1": "memoryless"}
