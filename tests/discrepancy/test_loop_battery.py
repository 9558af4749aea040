"""Simulated tests through ``close_loop``: what is hidden is found where it acts, and
nothing where nothing is.

The loop gets the channels; the assertions alone read the truth.
"""

import pytest
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
    "ground_friction": "friction",
    "quadratic_damping": "damping",
    "cubic": "stiffness",
    "quintic": "stiffness",
    "quadratic": "stiffness",
    "one_sided_gap": "contact",
    "two_sided_gap": "contact",
    "dahl": "hysteresis",
    "bouc_wen": "hysteresis",
    "maxwell": "hysteresis",
    "stiffness_step": "degradation",
    "harmonic": "forcing",
    "constant": "forcing",
    "brace": "link",
    "ground_link": "link",
}

# What the tests of single laws and sites leave out. Kind, p, q (0: the ground), rms of
# the effect over that of its storey's force
HIDDEN = {
    "quintic spring of one mass": Plan(
        1, (1,), noise=0.01, effects=(("quintic", 1, 0, 0.2),), seed=3
    ),
    "cubic spring": Plan(2, (1, 2), effects=(("cubic", 2, 1, 0.2),), seed=4),
    "quadratic damping under blows": Plan(
        2, (2,), "hammer", 0.0, (("quadratic_damping", 1, 0, 0.2),), seed=5
    ),
    "gap under a sweep": Plan(
        2, (1, 2), "sweep", 0.005, (("two_sided_gap", 2, 1, 0.2),), seed=6
    ),
    "sudden loss of stiffness": Plan(
        2, (1, 2), noise=0.01, effects=(("stiffness_step", 1, 0, 0.2),), seed=8
    ),
    "dead load": Plan(
        2, (1, 2), noise=0.005, effects=(("constant", 2, 0, 0.2),), seed=9
    ),
    "friction, one force": Plan(
        3, (3,), noise=0.01, effects=(("coulomb", 2, 1, 0.2),), seed=10
    ),
    "viscoelastic branch": Plan(
        3, (1, 2, 3), noise=0.0, effects=(("maxwell", 2, 1, 0.25),), seed=15
    ),
    "shaken base": Plan(2, (), "earthquake", 0.005, (("cubic", 2, 1, 0.25),), seed=16),
    "friction at 5 %": Plan(
        2, (1, 2), noise=0.05, effects=(("coulomb", 2, 1, 0.25),), seed=17
    ),
    "hysteresis, one force": Plan(
        4, (4,), noise=0.0, effects=(("dahl", 1, 0, 0.25),), seed=19
    ),
    "cubic springs in both storeys": Plan(
        2,
        (2,),
        noise=0.02,
        effects=(("cubic", 1, 0, 0.3), ("cubic", 2, 1, 0.3)),
        seed=22,
    ),
    "two effects": Plan(
        2,
        (1, 2),
        noise=0.005,
        effects=(("quadratic", 1, 0, 0.2), ("cubic", 2, 1, 0.25)),
        seed=21,
    ),
}


NOTHING = {
    "one mass": (Plan(1, (1,), seed=41), 1),
    "two masses, one force, sweep": (Plan(2, (1,), "sweep", 0.01, seed=42), 1),
    "four masses, one force, 5 %": (Plan(4, (2,), noise=0.05, seed=44), 1),
    "shaken base": (Plan(3, (), "earthquake", 0.01, seed=45), 1),
    "cubic springs that are declared": (
        Plan(
            2,
            (1, 2),
            noise=0.01,
            effects=(("cubic", 1, 0, 0.2), ("cubic", 2, 1, 0.2)),
            seed=46,
        ),
        3,
    ),
}

COSTLY = {
    "friction, one force",
    "viscoelastic branch",
    "friction at 5 %",
    "hysteresis, one force",
    "two effects",
    "gap under a sweep",
    "shaken base",
    "four masses, one force, 5 %",
    "sudden loss of stiffness",
}


def each(plans):
    """Names of plans; the costlier ones are marked."""
    return [
        pytest.param(name, marks=[pytest.mark.slow] * (name in COSTLY))
        for name in plans
    ]


def loop(case, degree=1):
    """The loop on a case; without forces, all masses are declared."""
    known = (
        None
        if "force" in case.channels
        else {j: m for j, m in enumerate(case.masses, 1)}
    )
    return close_loop(
        Record(**case.channels),
        NRFRegressor(degree=degree, known_masses=known),
        CATALOGUE,
    )


def balance(site):
    """A site; one between a DOF and the ground and the DOF itself are felt alike."""
    site = Site(str(site))
    return Site(f"ground {site.p}") if site.kind == "dof" else site


@pytest.mark.parametrize("name", each(HIDDEN))
def test_what_is_hidden_is_found_where_it_acts(name):
    case = simulated(HIDDEN[name])
    report = loop(case)
    for effect in case.effects:
        here = [
            step for step in report.steps if balance(step.site) == balance(effect.site)
        ]
        assert any(
            FAMILY[effect.kind] in (step.family, *step.alternatives) for step in here
        ), str(report)
    assert {balance(s.site) for s in report.steps} == {
        balance(e.site) for e in case.effects
    }, str(report)
    assert report.table["held-out"].iloc[-1] < 0.9 * report.table["held-out"].iloc[0]


@pytest.mark.parametrize("name", each(NOTHING))
def test_nothing_is_added_where_nothing_is_missing(name):
    plan, degree = NOTHING[name]
    assert loop(simulated(plan), degree).steps == []
