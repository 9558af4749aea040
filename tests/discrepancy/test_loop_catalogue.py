"""What the search tries, and where."""

import pytest
from loop_parts import tried_at

from pysindy_nrf import Chain, laws
from pysindy_nrf.discrepancy import default_catalogue

FIELD = """
coulomb_friction stribeck_friction position_dependent_friction break_away_friction
quadratic_damping power_law_damping damping_drift
quadratic_stiffness cubic_stiffness quintic_stiffness stiffness_step stiffness_drift
one_sided_gap two_sided_gap bilinear dead_zone
jenkins iwan dahl lugre bouc_wen degrading_bouc_wen pinched_bouc_wen maxwell_branch
backlash_friction hidden_oscillator
harmonic_force link_spring_dashpot added_mass
channel_delay gain_error sensor_offset
""".split()
STOREYS = {"storey 1", "storey 2", "storey 3"}
DOFS = {"dof 1", "dof 2", "dof 3"}
NEW_LINKS = {"ground 2", "ground 3", "link 3-1"}


def names_in(catalogue):
    return {law.name for law in catalogue}


def places_of(name, **test):
    """Sites of a chain of three floors at which a law is tried."""
    options = {"forced": (1,), **test}
    places = set()
    catalogue = [*default_catalogue(), laws.ConstantForce()]
    for candidate in tried_at(catalogue, Chain(3), **options):
        if candidate.law.name == name:
            places |= set(map(str, candidate.sites))
    return places


def test_the_field_is_in_the_catalogue():
    assert names_in(default_catalogue()) >= set(FIELD)


def test_a_constant_force_is_tried_only_if_it_is_asked_for():
    """It is the zero of a sensor."""
    assert "constant_force" not in names_in(default_catalogue())


def test_laws_that_read_a_channel_are_tried_where_there_is_one():
    reading = {"covariate_friction", "lagged_covariate_friction", "base_motion"}
    reading.add("ground_friction")
    assert names_in(default_catalogue(["voltage", "ag", "vg"])) >= reading
    assert not reading & names_in(default_catalogue())


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("constant_force", DOFS | {"storey 2", "storey 3"}),
        ("coulomb_friction", STOREYS | NEW_LINKS),
        ("cubic_stiffness", STOREYS | NEW_LINKS),
        ("dahl", STOREYS | NEW_LINKS),
        ("maxwell_branch", STOREYS),
        ("link_spring_dashpot", NEW_LINKS),
        ("bending_coupling", {"ground 2", "link 3-1"}),
        ("hidden_oscillator", DOFS),
        ("channel_delay", set()),
    ],
)
def test_each_law_is_tried_where_it_can_be_told(name, places):
    assert places_of(name) == places


def test_without_a_force_nothing_is_tried_that_resembles_an_inertia():
    assert places_of("hidden_oscillator", forced=()) == set()


def test_a_mass_is_tried_where_one_is_known_up_to_the_highest_force():
    """Above it the balances are homogeneous."""
    assert places_of("added_mass") == set()
    assert places_of("added_mass", known_masses=(1, 2)) == {"dof 1"}


@pytest.mark.parametrize("name", ["stiffness_step", "stiffness_drift"])
def test_a_structure_does_not_heal_between_two_tests(name):
    assert places_of(name) == STOREYS
    assert places_of(name, n_records=2) == set()


def test_a_law_of_the_storeys_is_tried_at_all_of_them_at_once():
    catalogue = [laws.CoulombFriction(), laws.ConstantForce()]
    tried = tried_at(catalogue, Chain(3), forced=(1,))
    together = [c.law.name for c in tried if len(c.sites) == 3]
    assert together == ["coulomb_friction"]
