"""Force laws against formulas of the literature, closed-form paths of their states, and each promise of the contract."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import quad, solve_ivp

from pysindy_nrf import laws
from pysindy_nrf.exceptions import ChannelError, LawError, NRFError
from pysindy_nrf.laws import ForceLaw, Motion, Shape, Term, base, compiled, contract, memory
from pysindy_nrf.laws.power_series import exponents_of, monomial, monomial_unit, whole

E = math.e


def at(s=0.0, v=0.0, a=0.0, t=0.0, **covariates):
    """One sample of a motion."""
    return Motion(
        *(np.array([float(x)]) for x in (s, v, a, t)), {k: np.array([float(x)]) for k, x in covariates.items()}
    )


# -- forces at points, by hand --------------------------------------------------------------------

POINTS = [
    (laws.LinearElastic(2e4), at(s=3e-3), 60.0),
    (laws.LinearViscous(300.0), at(v=-0.2), -60.0),
    (laws.Duffing(1e3, 1e6), at(s=0.1), 1100.0),
    (laws.Duffing(1e3, -1e6), at(s=-0.02), -12.0),
    (laws.QuadraticStiffness(1e4), at(s=-0.03), 9.0),
    (laws.AbsoluteQuadraticStiffness(1e4), at(s=-0.03), -9.0),
    (laws.CubicStiffness(1e6), at(s=-0.02), -8.0),
    (laws.QuinticStiffness(1e9), at(s=-0.02), -3.2),
    (laws.LinkSpringDashpot(1e3, 20.0), at(s=0.01, v=-0.3), 4.0),
    (laws.QuadraticDamping(50.0), at(v=-0.2), -2.0),
    (laws.PowerLawDamping(0.5, 30.0), at(v=-0.04), -6.0),
    (laws.PowerLawDamping(0.5, 30.0), at(v=0.0), 0.0),
    (laws.PowerLawDamping(3.0, 1e3), at(v=0.2), 8.0),
    (laws.DisplacementDependentDamping(1e5), at(s=-0.02, v=0.3), 12.0),
    (laws.CoulombFriction(20.0), at(v=1e-12), 20.0),
    (laws.CoulombFriction(20.0), at(v=0.0, s=1.0), 0.0),
    (laws.AsymmetricFriction(17.0, 23.0), at(v=0.01), 17.0),
    (laws.AsymmetricFriction(17.0, 23.0), at(v=-0.01), -23.0),
    (laws.AsymmetricFriction(17.0, 23.0), at(v=0.0), 0.0),
    (laws.StribeckFriction(0.02, 10.0, 6.0), at(v=-0.02), -(10.0 + 6.0 / E)),
    (laws.StribeckFriction(0.02, 10.0, 6.0), at(v=0.04), 10.0 + 6.0 / E**2),
    (laws.StribeckFriction(0.02, 10.0, 6.0), at(v=1e30), 10.0),
    (laws.StribeckFriction(0.02, 10.0, 6.0), at(v=0.0), 0.0),
    (laws.ShiftedFriction(4.0, 7.0), at(s=0.01, v=-0.03), 7.0),
    (laws.ShiftedFriction(4.0, 7.0), at(s=0.01, v=-0.05), -7.0),
    (laws.ShiftedFriction(4.0, 7.0), at(s=0.25, v=-1.0), 0.0),
    (laws.GroundFriction(3.0), at(v=-0.2, vg=0.3), 3.0),
    (laws.GroundFriction(3.0), at(v=-0.2, vg=0.1), -3.0),
    (laws.GroundFriction(3.0, covariate="table"), at(v=-0.2, table=0.2), 0.0),
    (laws.CovariateFriction("V", 100.0, 40.0, 10.0), at(v=-0.5, V=3.0), -100.0 - 120.0 - 15.0),
    (laws.CovariateFriction("V", 100.0, 40.0, 10.0), at(v=0.0, V=3.0), 0.0),
    (laws.OneSidedGap(1e-3, 2e4), at(s=3e-3), 40.0),
    (laws.OneSidedGap(1e-3, 2e4), at(s=1e-3), 0.0),
    (laws.OneSidedGap(1e-3, 2e4), at(s=-3e-3), 0.0),
    (laws.OneSidedGap(1e-3, 2e4, side=-1), at(s=-3e-3), -40.0),
    (laws.OneSidedGap(1e-3, 2e4, side=-1), at(s=-1e-3), 0.0),
    (laws.PreloadedContact(1e-3, 2e4), at(s=3e-3), 60.0),
    (laws.PreloadedContact(1e-3, 2e4), at(s=-0.5e-3), -10.0),
    (laws.PreloadedContact(1e-3, 2e4), at(s=-3e-3), -20.0),
    (laws.PreloadedContact(1e-3, 2e4, side=-1), at(s=-3e-3), -60.0),
    (laws.PreloadedContact(1e-3, 2e4, side=-1), at(s=0.5e-3), 10.0),
    (laws.PreloadedContact(1e-3, 2e4, side=-1), at(s=3e-3), 20.0),
    (laws.TwoSidedGap(1e-3, 2e4), at(s=1e-3), 0.0),
    (laws.TwoSidedGap(1e-3, 2e4), at(s=1.5e-3), 10.0),
    (laws.TwoSidedGap(1e-3, 2e4), at(s=-1.5e-3), -10.0),
    (laws.DeadZone(1e-3, 0.5, 2e4), at(s=1.5e-3), 0.0),  # the play reaches from -0.5 to 1.5 mm
    (laws.DeadZone(1e-3, 0.5, 2e4), at(s=2e-3), 10.0),
    (laws.DeadZone(1e-3, 0.5, 2e4), at(s=-0.5e-3), 0.0),
    (laws.DeadZone(1e-3, 0.5, 2e4), at(s=-1e-3), -10.0),
    (laws.Bilinear(-2e4), at(s=1e-3), -20.0),
    (laws.Bilinear(-2e4), at(s=-1e-3), 0.0),
    (laws.StiffnessStep(2.0, 1e3), at(s=-0.01, t=2.01), -10.0),
    (laws.StiffnessStep(2.0, 1e3), at(s=-0.01, t=2.0), 0.0),
    (laws.StiffnessStep(2.0, 1e3), at(s=-0.01, t=1.0), 0.0),
    (laws.StiffnessDrift(-300.0), at(s=0.01, t=4.0), -12.0),
    (laws.DampingDrift(-5.0), at(v=0.3, t=4.0), -6.0),
    (laws.HarmonicForce(50.0, 3.0, 4.0), at(t=0.0), 3.0),
    (laws.HarmonicForce(50.0, 3.0, 4.0), at(t=0.005), 4.0),
    (laws.HarmonicForce(50.0, 3.0, 4.0), at(t=1 / 400), 7.0 / math.sqrt(2.0)),
    (laws.ConstantForce(-3.2), at(s=7.0), -3.2),
    (laws.BaseMotion(12.5), at(ag=-2.0), -25.0),
    (laws.AddedMass(1.5), at(a=-2.0), -3.0),
    (laws.Inerter(40.0), at(a=0.5), 20.0),
    (laws.ChannelDelay(0.002), at(s=9.0, v=3.0), -0.006),
    (laws.GainError(0.2), at(s=9.0), 1.8),
    (laws.SensorOffset(0.5), at(s=9.0), 0.5),
    (laws.PowerSeries(1, [100.0, 1e5]), at(s=2e-3, v=0.5), 250.0),
    (laws.PowerSeries(2, [0, 0, 3.0, 5.0, 7.0]), at(s=2.0, v=-1.0), 3.0 - 10.0 + 28.0),
    (laws.PowerSeries((2, 1), {"c_2_1": 10.0}), at(s=3.0, v=-2.0), 120.0),
]


@pytest.mark.parametrize(("law", "motion", "force"), POINTS, ids=[f"{k}-{p[0].name}" for k, p in enumerate(POINTS)])
def test_force_at_a_point(law, motion, force):
    assert law.force(motion)[0] == pytest.approx(force, rel=1e-13, abs=1e-13)
    double = law.with_values(2.0 * law.values)  # linear in the coefficients
    assert double.force(motion)[0] == pytest.approx(2.0 * force, rel=1e-13, abs=1e-13)


def test_nine_terms_of_the_papers_equation_9():
    v, s = 2.0, 3.0
    expected = [2.0, 3.0, 4.0, 6.0, 9.0, 8.0, 12.0, 18.0, 27.0]  # v, s, v^2, v s, s^2, v^3, v^2 s, v s^2, s^3
    assert laws.PowerSeries(3).features(at(s, v))[0].tolist() == expected
    assert [t.symbol for t in laws.PowerSeries(2).terms()] == ["c_1_0", "c_0_1", "c_2_0", "c_1_1", "c_0_2"]
    units = ["N s/m", "N/m", "N s^2/m^2", "N s/m^2", "N/m^2"]
    assert [t.unit for t in laws.PowerSeries(2).terms()] == units
    assert exponents_of((2, 1)) == ((1, 0), (0, 1), (2, 0), (1, 1), (2, 1))
    assert exponents_of([0, 2]) == ((0, 1), (0, 2))
    assert exponents_of(0) == () and len(exponents_of(60)) == 61 * 62 // 2 - 1 and len(exponents_of((1, 60))) == 121
    assert [monomial(*p) for p in ((0, 0), (1, 0), (0, 1), (3, 1), (1, 2))] == ["1", "v", "s", "v^3 s", "v s^2"]
    assert [monomial_unit(*p) for p in ((0, 0), (3, 1))] == ["N", "N s^3/m^4"]
    assert laws.PowerSeries((2, 1)).options() == {"degree": [2, 1]} and laws.PowerSeries(2).options() == {"degree": 2}


@pytest.mark.parametrize("degree", [-1, 61, 2.0, True, "3", (1,), (1, 2, 3), (1, -1), (61, 0), (0, 61), (1, 1.5), None])
def test_degree_of_a_power_series_is_a_whole_number_up_to_60(degree):
    with pytest.raises(LawError, match="order=|degree=|k=|q="):
        laws.PowerSeries(degree)
    assert whole("n", np.int64(1), 1) == 1 and whole("n", 0) == 0
    with pytest.raises(LawError, match="n=1 is not a whole number of at least 2"):
        whole("n", 1, 2)


# -- what a law says about itself -----------------------------------------------------------------

CATALOGUE = {n: cls for n, cls in laws.registry().items() if cls.__module__.startswith("pysindy_nrf.")}


def _names(condition):
    return {name for name, cls in CATALOGUE.items() if condition(cls)}


def test_what_the_laws_of_the_catalogue_are():
    gives_no_energy = {
        "linear_elastic", "linear_viscous", "duffing", "quadratic_stiffness", "absolute_quadratic_stiffness",
        "cubic_stiffness", "quintic_stiffness", "link_spring_dashpot", "quadratic_damping", "power_law_damping",
        "displacement_dependent_damping", "damping_drift", "coulomb_friction", "asymmetric_friction", "stribeck_friction",
        "shifted_friction", "one_sided_gap", "preloaded_contact", "two_sided_gap", "dead_zone", "bilinear", "dahl",
        "jenkins", "iwan", "maxwell_branch", "added_mass", "inerter",
    }  # fmt: skip
    assert _names(lambda cls: cls.passive) == gives_no_energy
    assert _names(lambda cls: cls.uses_time) == {"stiffness_step", "stiffness_drift", "damping_drift", "harmonic_force"}
    assert _names(lambda cls: cls.uses_acceleration) == {"added_mass", "inerter"}
    states = {
        "dahl": 1, "modified_dahl": 1, "jenkins": 1, "bouc_wen": 1, "lugre": 1, "maxwell_branch": 1, "iwan": 2,
        "lagged_covariate_friction": 2, "covariate_dahl": 3,
    }  # fmt: skip
    assert {name: cls.n_states for name, cls in CATALOGUE.items() if cls.n_states} == states
    assert _names(lambda cls: cls().has_memory) == set(states)
    assert laws.BoucWen.at_rest == laws.Dahl.at_rest == 0.0
    assert laws.ModifiedDahl.at_rest is None and laws.GroundFriction.at_rest is None


RANGES = {  # of a storey that moves 2 mm and 50 mm/s (rms) for 20 s
    "one_sided_gap": {"gap": (1e-4, 8e-3)},
    "two_sided_gap": {"gap": (1e-4, 8e-3)},
    "preloaded_contact": {"u": (1e-4, 8e-3)},
    "dead_zone": {"gap": (1e-4, 8e-3), "centre": (-0.95, 0.95)},
    "power_law_damping": {"n": (0.15, 4.0)},
    "stiffness_step": {"t0": (1.0, 19.0)},
    "harmonic_force": {"frequency": (0.25, 50.0)},
    "stribeck_friction": {"vs": (1e-3, 0.1)},
    "shifted_friction": {"kappa": (0.25, 75.0)},
    "dahl": {"sigma": (15.0, 1.5e6)},
    "modified_dahl": {"sigma": (15.0, 1.5e6)},
    "covariate_dahl": {"sigma": (15.0, 1.5e6), "tau": (2e-3, 2.0)},
    "lagged_covariate_friction": {"tau": (2e-3, 2.0)},
    "jenkins": {"uy": (2e-5, 8e-3)},
    "iwan": {"uy": (2e-5, 4e-3), "ratio": (1.5, 20.0)},
    "lugre": {"sigma": (50.0, 1.5e6), "vs": (1e-3, 0.1), "ratio": (1.05, 3.0)},
    "bouc_wen": {"beta": (15.0, 5e4), "rho": (-2.0, 1.0), "n": (1.0, 4.0)},
    "maxwell_branch": {"tau": (0.012, 0.8)},
}
EITHER_SIGN = {"centre", "t0", "rho"}


def test_where_shape_parameters_are_searched():
    found = {}
    for name, cls in CATALOGUE.items():
        for p in cls.shapes:
            low, high = p.bounds(drift=2e-3, rate=0.05, duration=20.0)
            found.setdefault(name, {})[p.name] = pytest.approx((low, high), rel=1e-12)
            assert p.log == (p.name not in EITHER_SIGN)
    assert found == RANGES


@pytest.mark.parametrize(
    ("scale", "unit"), [("1", 1.0), ("s", 0.5), ("v", 4.0), ("t", 10.0), ("1/s", 2.0), ("1/v", 0.25), ("s/v", 0.125)]
)
def test_bounds_are_multiples_of_their_scale(scale, unit):
    assert Shape("x", "1", 3.0, 5.0, scale).bounds(drift=0.5, rate=4.0, duration=10.0) == (3.0 * unit, 5.0 * unit)


def test_only_shapes_of_either_sign_may_be_zero_or_negative():
    assert laws.DeadZone(gap=1.0, centre=-0.5).shape["centre"] == -0.5
    assert laws.StiffnessStep(t0=0.0).shape == {"t0": 0.0} and laws.BoucWen(rho=0.0).free_shape == ("beta", "n")
    for value in (0.0, -1e-300):
        with pytest.raises(LawError, match="gap=.* is not positive. Its unit is m"):
            laws.TwoSidedGap(gap=value)
    assert laws.TwoSidedGap(gap=1e-300).shape["gap"] == 1e-300


# -- values, text, plain data ---------------------------------------------------------------------


def test_coefficients_by_name_or_in_order():
    assert laws.Duffing(k=3.0).coefficients.tolist() == [3.0, 0.0]
    assert laws.Duffing(k3=3.0).coefficients.tolist() == [0.0, 3.0]
    assert laws.Duffing().coefficients is None
    law = laws.Duffing().with_values([1, 2])
    assert law.parameters == {"k": 1.0, "k3": 2.0} and law.values.dtype == float
    assert law.with_values({"k": None, "k3": None}).coefficients is None
    assert law.with_values({"k3": 7}).values.tolist() == [0.0, 7.0]
    assert law.with_values(np.array([[4.0], [5.0]])).values.tolist() == [4.0, 5.0]
    assert law.values.tolist() == [1.0, 2.0]
    assert laws.LinearElastic().with_values(5.0).values.tolist() == [5.0]
    with pytest.raises(LawError, match="Duffing has 2 coefficients, 1 were given. Their order is k, k3"):
        law.with_values([1.0])
    with pytest.raises(LawError, match="Duffing has 2 coefficients, 3 were given"):
        law.with_values([1.0, 2.0, 3.0])
    with pytest.raises(LawError, match="Duffing has no coefficient 'c'. It has k, k3"):
        law.with_values({"k": 1.0, "c": 2.0})
    for bad in ("stiff", math.nan, math.inf, [1.0, "2 N"], [[1.0, 2.0], [3.0]]):
        with pytest.raises(LawError, match="is not a finite number|were given"):
            law.with_values(bad)
    with pytest.raises(LawError, match="Duffing has no coefficients yet"):
        laws.Duffing().force(at(1.0))


def test_shape_parameters_by_name():
    law = laws.Iwan(uy=1e-3, F1=1.0, F2=2.0)
    assert law.free_shape == ("ratio",) and law.parameters == {"uy": 1e-3, "ratio": None, "F1": 1.0, "F2": 2.0}
    with pytest.raises(LawError, match="Iwan: ratio has no value"):
        law.features(at(1.0))
    with pytest.raises(LawError, match="Iwan: uy, ratio has no value"):
        _ = laws.Iwan().theta
    full = law.with_values(shape={"ratio": 3})
    assert full.theta.tolist() == [1e-3, 3.0] and full.free_shape == () and law.shape["ratio"] is None
    assert full.values is law.values or full.values.tolist() == [1.0, 2.0]
    assert full.with_values(shape={"uy": None}).free_shape == ("uy",)
    with pytest.raises(LawError, match="Iwan has no shape parameter 'n'. It has uy, ratio"):
        law.with_values(shape={"n": 2.0})
    with pytest.raises(LawError, match="CoulombFriction has no shape parameter 'n'. It has none"):
        laws.CoulombFriction().with_values(shape={"n": 2.0})
    with pytest.raises(LawError, match="Iwan: ratio='wide' is not a finite number"):
        law.with_values(shape={"ratio": "wide"})
    side = laws.OneSidedGap(gap=0.5, side=-1)
    assert side.theta.tolist() == [0.5, -1.0] and side.options() == {"side": -1}
    assert laws.PreloadedContact(u=0.5).theta.tolist() == [0.5, 1.0]
    assert laws.PowerSeries(1).theta.tolist() == [1.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("side", [0, 2, -2, "left", None])
@pytest.mark.parametrize("cls", [laws.OneSidedGap, laws.PreloadedContact])
def test_a_contact_has_two_sides(cls, side):
    with pytest.raises(LawError, match=f"{cls.__name__}: side="):
        cls(side=side)
    assert [cls(side=x).terms()[0].label[:3] for x in (1, -1, np.int64(-1))] == ["max", "min", "min"]


@pytest.mark.parametrize("name", [3, "", "  ", None, ("ag",)])
def test_a_covariate_has_a_name(name):
    for cls in (
        laws.BaseMotion,
        laws.GroundFriction,
        laws.CovariateFriction,
        laws.LaggedCovariateFriction,
        laws.CovariateDahl,
    ):
        with pytest.raises(LawError, match="covariate=.* is not the name of a channel"):
            cls(covariate=name)
        assert cls(covariate="c 1").options() == {"covariate": "c 1"}


def test_terms_of_a_covariate():
    def texts(law):
        return [tuple(t) for t in law.terms()]

    assert texts(laws.CovariateFriction("V")) == [
        ("Fc", "sgn(v)", "N"), ("Fu", "V sgn(v)", "N/[u]"), ("Cu", "V v", "N s/m/[u]"),
    ]  # fmt: skip
    assert texts(laws.LaggedCovariateFriction("V"))[1][1] == "lag[V] sgn(v)"
    assert [t[1] for t in texts(laws.CovariateDahl("V"))] == ["Z", "lag[V] Z", "lag[V] v"]
    assert texts(laws.BaseMotion(covariate="a0")) == [("m", "a0", "kg")]
    assert texts(laws.GroundFriction(covariate="v0")) == [("Fc", "sgn(v + v0)", "N")]


def test_text():
    assert laws.Duffing(1e5, -2.0).equation(3) == "1e+05 s3 - 2 s3^3"
    assert laws.Duffing().equation() == "k s + k3 s^3"
    assert laws.Duffing(k=1.23456, k3=0.0).equation("2", digits=3) == "1.23 s2 + 0 s2^3"
    assert laws.ConstantForce().equation(1) == "f0" and laws.ConstantForce(2.5).equation(1) == "2.5"
    assert laws.ModifiedDahl(sigma=5.0).equation(2) == "K0 s2 + C0 v2 + Fd Z2 + f0  (sigma = 5)"
    assert laws.Iwan(uy=0.25).equation(2) == "F1 Jenkins[s2; uy] + F2 Jenkins[s2; ratio uy]  (uy = 0.25)"
    assert laws.Iwan(uy=0.25, ratio=3.0).equation(0).endswith(
        "(uy = 0.25, ratio = 3)"
    ) and "s0" in laws.Iwan().equation(0)
    assert laws.Iwan().equation() == "F1 Jenkins[s; uy] + F2 Jenkins[s; ratio uy]"
    assert laws.PowerSeries(0).equation() == "0"
    assert base.subscript("sgn(v + vs s) + a x Z", 7) == "sgn(v7 + vs s7) + a7 x7 Z7"
    assert repr(laws.OneSidedGap(0.5, 2e4, -1)) == "OneSidedGap(side=-1, gap=0.5, k=2e+04)"
    assert repr(laws.OneSidedGap()) == "OneSidedGap(side=1)" and repr(laws.Duffing(1.0, 2.0)) == "Duffing(k=1, k3=2)"


def test_plain_data_and_back():
    law = laws.OneSidedGap(gap=0.5, k=2e4, side=-1)
    data = law.to_dict()
    assert data == {"law": "one_sided_gap", "options": {"side": -1}, "shape": {"gap": 0.5}, "coefficients": [2e4]}
    copy = laws.from_dict(json.loads(json.dumps(data)))
    assert copy == law and hash(copy) == hash(law) and copy.side == -1 and copy is not law
    assert laws.Duffing().to_dict() == {"law": "duffing", "options": {}, "shape": {}, "coefficients": None}
    assert laws.from_dict({"law": "jenkins"}) == laws.Jenkins()
    assert laws.from_dict({"law": "jenkins", "options": None, "shape": None}) == laws.Jenkins()
    assert laws.from_dict({"law": "power_series", "options": {"degree": [2, 1]}}) == laws.PowerSeries((2, 1))
    assert (
        law != law.with_values([1.0])
        and law != law.with_values(shape={"gap": 0.6})
        and law != laws.OneSidedGap(0.5, 2e4)
    )
    assert laws.AddedMass(1.0) != laws.Inerter(1.0) and laws.Duffing() != "duffing"
    assert len({laws.Duffing(1.0), laws.Duffing(1.0), laws.Duffing(2.0)}) == 2


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (
            {"law": "none of these"},
            "There is no law 'none of these'. Known laws: .*absolute_quadratic_stiffness, added_mass, ",
        ),
        ({"law": ["dahl"]}, "There is no law"),
        ({}, "does not describe a law. It needs 'law', 'options'"),
        (None, "does not describe a law"),
        ({"law": "dahl", "options": 3}, "does not describe a law"),
        ({"law": "dahl", "shape": "sigma"}, "does not describe a law"),
        ({"law": "dahl", "options": {"side": 1}}, "Law 'dahl' cannot be built from"),
        ({"law": "dahl", "coefficients": [1.0, 2.0]}, "Dahl has 1 coefficients, 2 were given"),
    ],
)
def test_data_that_is_no_law_is_named(data, words):
    with pytest.raises(LawError, match=words):
        laws.from_dict(data)


def test_the_registry_is_handed_out_as_a_copy():
    laws.registry().clear()
    assert laws.registry()["dahl"] is laws.Dahl
    with pytest.raises(LawError, match="The name 'iwan' is taken by the law Iwan. Choose another name"):
        type("Other", (ForceLaw,), {"name": "iwan"})
    type("Nameless", (laws.Dahl,), {})  # takes no name
    assert laws.registry()["dahl"] is laws.Dahl


# -- features -------------------------------------------------------------------------------------


def test_features_are_columns_of_the_whole_record():
    s = np.array([1.0, 2.0, 3.0])
    motion = Motion(s, v=-s)
    columns = laws.LinkSpringDashpot().features(motion)
    assert columns.tolist() == [[1.0, -1.0], [2.0, -2.0], [3.0, -3.0]] and columns.flags.f_contiguous
    assert motion.n_samples == 3 and dict(motion.covariates) == {} and motion.a is None and motion.t is None
    assert laws.PowerSeries(0).features(motion).shape == (3, 0)
    with pytest.raises(LawError, match="AddedMass needs the acceleration"):
        laws.AddedMass().features(motion)
    with pytest.raises(LawError, match="DampingDrift needs the time"):
        laws.DampingDrift().features(Motion(s, s, a=s))
    with pytest.raises(LawError, match="BaseMotion needs the covariate 'ag'"):
        laws.BaseMotion().features(motion)
    assert laws.AddedMass(2.0).force(Motion(s, s, a=s)).tolist() == [2.0, 4.0, 6.0]
    assert laws.DampingDrift(2.0).force(Motion(s, s, t=s)).tolist() == [2.0, 8.0, 18.0]


def test_a_kernel_that_reads_neither_time_nor_acceleration_is_given_zeros():
    class Sum(ForceLaw):
        covariates = ("p", "q")

        def terms(self):
            return (Term("a", "a", "N"), Term("b", "b", "N"), Term("p", "p", "N"), Term("q", "q", "N"))

        @staticmethod
        def kernel(s, v, a, t, u, z, theta, out):
            out[0], out[1], out[2], out[3] = a + 0.0, t + 0.0, u[0], u[1]

    s, ones = np.zeros(2), np.ones(2)
    given = {"q": 5 * ones, "p": 4 * ones, "r": ones}
    assert Sum().features(Motion(s, s, covariates=given))[1].tolist() == [0.0, 0.0, 4.0, 5.0]
    assert Sum().features(Motion(s, s, a=2 * ones, covariates=given))[1].tolist() == [2.0, 0.0, 4.0, 5.0]
    assert Sum().features(Motion(s, s, t=3 * ones, covariates=given))[1].tolist() == [0.0, 3.0, 4.0, 5.0]
    assert Sum().features(Motion(s, s, 2 * ones, 3 * ones, given))[1].tolist() == [2.0, 3.0, 4.0, 5.0]
    assert Sum().covariates_of(Motion(s, s, covariates=given)).tolist() == [[4.0, 4.0], [5.0, 5.0]]
    with pytest.raises(LawError, match="Sum needs the covariate 'q'"):
        Sum().covariates_of(Motion(s, s, covariates={"p": s}))


def test_readings_of_faulty_sensors():
    t = np.arange(200) / 100
    y = np.sin(3 * t)
    late = laws.ChannelDelay(tau=0.025).reading(y, dt=0.01)
    assert np.isnan(late[:3]).all() and np.isfinite(late[3:]).all()
    assert np.allclose(late[8:-4], np.sin(3 * (t[8:-4] - 0.025)), atol=1e-9)
    back = laws.ChannelDelay(tau=0.025).corrected(y, dt=0.01)
    assert np.isnan(back[-3:]).all() and np.allclose(back[8:-8], np.sin(3 * (t[8:-8] + 0.025)), atol=1e-9)
    assert laws.GainError(-2.0).reading([1, 2], 0.1).tolist() == [-1.0, -2.0]  # a wrong sign
    assert laws.GainError(0.25).corrected([5, 10], 0.1).tolist() == [4.0, 8.0]
    assert laws.SensorOffset(0.5).reading([1, 2], 0.1).tolist() == [1.5, 2.5]
    assert laws.SensorOffset(0.5).corrected([1, 2], 0.1).tolist() == [0.5, 1.5]
    for method in (laws.SensorFault().reading, laws.SensorFault().corrected):
        with pytest.raises(NotImplementedError):
            method([1.0], 0.1)


# -- states: one stroke in closed form ------------------------------------------------------------


def stroke(law, start, ds, v0=1.0, v1=1.0, dt=1.0, u=(), s0=0.3):
    """State after a stroke, from the plain function that is compiled for records."""
    z = np.array(start, dtype=float, ndmin=1)
    type(law).advance(z, s0, v0, s0 + ds, v1, dt, np.array(u, dtype=float), law.theta)
    return z


@pytest.mark.parametrize(
    "law",
    [
        laws.Dahl(sigma=20.0),
        laws.Jenkins(uy=0.1),
        laws.Iwan(uy=0.1, ratio=2.0),
        laws.LuGre(sigma=20.0, vs=0.5, ratio=1.5),
        laws.BoucWen(beta=20.0, rho=-0.3, n=1.0),
        laws.BoucWen(beta=20.0, rho=0.4, n=1.7),
        laws.MaxwellBranch(tau=0.7),
        laws.CovariateDahl(sigma=20.0, tau=0.5),
    ],
    ids=repr,
)
@pytest.mark.parametrize("s0", [-2.0, -0.25, 0.25, 2.0])
def test_where_a_stroke_begins_does_not_count(law, s0):
    start = np.linspace(0.2, 0.4, law.n_states)
    for ds in (-0.03, 0.03):
        ends = [stroke(law, start, ds, 0.1, 0.4, 0.2, [1.5], at) for at in (0.0, s0)]
        np.testing.assert_allclose(ends[1], ends[0], rtol=1e-12)


@pytest.mark.parametrize("start", [-0.7, 0.0, 0.4])
@pytest.mark.parametrize("cls", [laws.Dahl, laws.ModifiedDahl])
def test_dahl_in_one_stroke(cls, start):
    law = cls(sigma=200.0)
    assert stroke(law, start, 0.01)[0] == pytest.approx(1.0 + (start - 1.0) * math.exp(-2.0), rel=1e-12)
    assert stroke(law, start, -0.01)[0] == pytest.approx(-1.0 + (start + 1.0) * math.exp(-2.0), rel=1e-12)
    assert stroke(law, start, 0.0)[0] == start


@pytest.mark.parametrize(
    ("start", "ds", "end"),
    [(0.0, 1e-3, 0.5), (0.0, 3e-3, 1.0), (0.8, 1e-3, 1.0), (0.8, -1e-3, 0.3), (-0.8, -1e-3, -1.0), (1.0, -4e-3, -1.0)],
)
def test_jenkins_in_one_stroke(start, ds, end):
    assert stroke(laws.Jenkins(uy=2e-3), start, ds)[0] == pytest.approx(end, rel=1e-12)
    assert stroke(laws.Iwan(uy=2e-3, ratio=4.0), [start, start], ds)[0] == pytest.approx(end, rel=1e-12)
    slow = min(max(start + ds / 8e-3, -1.0), 1.0)
    assert stroke(laws.Iwan(uy=2e-3, ratio=4.0), [start, start], ds)[1] == pytest.approx(slow, rel=1e-12)
    assert stroke(laws.Iwan(uy=2e-3, ratio=4.0), [1.0, 0.0], -4e-3).tolist() == pytest.approx([-1.0, -0.5], rel=1e-12)


def test_lag_of_a_covariate_in_one_step():
    lagged = laws.LaggedCovariateFriction(tau=0.5)
    assert stroke(lagged, [0.0, 0.0], 0.1, dt=0.25, u=[3.0]).tolist() == [3.0, 1.0]  # a fresh one starts at the command
    assert stroke(lagged, [1.0, 1.0], 0.1, dt=0.25, u=[3.0])[0] == pytest.approx(3.0 - 2.0 * math.exp(-0.5), rel=1e-14)
    assert stroke(lagged, [5.0, 1.0], 0.1, dt=1.0, u=[3.0])[0] == pytest.approx(3.0 + 2.0 * math.exp(-2.0), rel=1e-14)
    both = laws.CovariateDahl(sigma=20.0, tau=0.5)
    found = stroke(both, [1.0, 1.0, 0.25], -0.1, dt=0.25, u=[3.0])
    expected = [3.0 - 2.0 * math.exp(-0.5), 1.0, -1.0 + 1.25 * math.exp(-2.0)]
    assert found.tolist() == pytest.approx(expected, rel=1e-12)
    assert stroke(both, [0.0, 0.0, 0.0], 0.1, dt=0.25, u=[3.0]).tolist() == pytest.approx(
        [3.0, 1.0, 1.0 - math.exp(-2.0)]
    )
    assert stroke(both, [0.0, 1.0, 0.5], 0.0, dt=0.5, u=[1.0]).tolist() == pytest.approx([1.0 - 1.0 / E, 1.0, 0.5])


def test_force_of_a_lagged_covariate_from_its_state():
    # w is the lagged covariate once it has started, the covariate itself before
    def columns(law, z, u, v):
        out = np.empty(3)
        law.kernel(0.0, v, 0.0, 0.0, np.array([u]), np.array(z), law.theta, out)
        return out.tolist()

    friction = laws.LaggedCovariateFriction(tau=0.5)
    assert columns(friction, [4.0, 1.0], 7.0, -0.5) == [-1.0, -4.0, -2.0]
    assert columns(friction, [0.0, 0.0], 7.0, -0.5) == [-1.0, -7.0, -3.5]
    dahl = laws.CovariateDahl(sigma=1.0, tau=0.5)
    assert columns(dahl, [4.0, 1.0, 0.25], 7.0, -0.5) == [0.25, 1.0, -2.0]
    assert columns(dahl, [0.0, 0.0, 0.25], 7.0, -0.5) == [0.25, 1.75, -3.5]


@pytest.mark.parametrize("x", [1e-4, 0.01, 0.03, 0.0499, 0.0501, 0.3, 2.0, 30.0])
def test_maxwell_branch_in_one_step(x):
    tau, dt = 0.4, 0.4 * x
    law = laws.MaxwellBranch(tau=tau)
    assert stroke(law, 0.7, 0.0, 0.0, 0.0, dt)[0] == pytest.approx(0.7 * math.exp(-x), rel=1e-14)

    def held(rate):  # the integral of exp(-(dt - t) / tau) rate(t) by Gauss's rule, y in units of the step
        y, weight = np.polynomial.legendre.leggauss(60)
        y, weight = 0.5 * (1.0 + y), 0.5 * weight
        return dt * np.sum(weight * np.exp(-x * (1.0 - y)) * rate(y))

    steady = -2.0 * tau * math.expm1(-x)
    assert stroke(law, 0.0, 2.0 * dt, 2.0, 2.0, dt, s0=0.0)[0] == pytest.approx(steady, rel=1e-9)
    assert stroke(law, 0.0, 2.0 * dt, 5.0, 5.0, dt, s0=0.0)[0] == pytest.approx(steady, rel=1e-9)
    turning = stroke(law, 0.0, 0.0, -3.0, 3.0, dt, s0=0.0)[0]  # there and back
    assert turning == pytest.approx(held(lambda y: 6.0 * (y - 0.5)), rel=1e-7)
    assert turning == pytest.approx(-stroke(law, 0.0, 0.0, 3.0, -3.0, dt, s0=0.0)[0], rel=1e-14)


def test_maxwell_branch_is_elastic_in_no_time():
    law = laws.MaxwellBranch(tau=0.4)
    assert stroke(law, 0.5, 0.25, dt=0.0, s0=0.0)[0] == 0.75
    assert stroke(law, 0.5, 0.25, dt=-1.0, s0=1.0)[0] == 0.75


def _stribeck(v, vs, ratio):
    return 1.0 + (ratio - 1.0) * math.exp(-((v / vs) ** 2))


@pytest.mark.parametrize("speed", [0.0, 0.01, 0.02, 0.05, 5.0])
@pytest.mark.parametrize("start", [-0.9, 0.0, 1.2])
def test_lugre_at_steady_speed_is_dahl_with_the_stribeck_level(speed, start):
    law = laws.LuGre(sigma=300.0, vs=0.02, ratio=1.6)
    level = _stribeck(speed, 0.02, 1.6)
    end = level + (start - level) * math.exp(-300.0 * 2e-3 / level)
    assert stroke(law, start, 2e-3, speed, speed)[0] == pytest.approx(end, rel=1e-11)
    assert stroke(law, -start, -2e-3, -speed, -speed)[0] == pytest.approx(-end, rel=1e-11)
    assert stroke(law, start, 0.0, speed, 2 * speed + 0.1)[0] == start


@pytest.mark.parametrize(("v0", "v1"), [(0.0, 0.03), (0.03, 0.0), (0.005, 0.025), (0.1, 0.02), (0.0, 0.5), (2.0, 0.0)])
def test_lugre_over_a_change_of_speed(v0, v1):
    sigma, vs, ratio, start = 300.0, 0.02, 1.6, -0.3
    law = laws.LuGre(sigma=sigma, vs=vs, ratio=ratio)
    ds = 3e-3  # at constant acceleration over the time 2 ds / (v0 + v1)
    T = 2.0 * ds / (v0 + v1)

    def rate(t, z):
        v = v0 + (v1 - v0) * t / T
        return sigma * v * (1.0 - z / _stribeck(v, vs, ratio))

    exact = solve_ivp(rate, (0.0, T), [start], "DOP853", rtol=1e-11, atol=1e-13, max_step=T / 50).y[0, -1]
    assert stroke(law, start, ds, v0, v1, T)[0] == pytest.approx(exact, abs=4e-4)
    assert stroke(law, -start, -ds, -v0, -v1, T)[0] == pytest.approx(-exact, abs=4e-4)


def test_lugre_force_from_its_state():
    law = laws.LuGre(sigma=300.0, vs=0.02, ratio=1.6)

    def columns(v, z):
        out = np.empty(2)
        law.kernel(0.0, v, 0.0, 0.0, np.empty(0), np.array([z]), law.theta, out)
        return out.tolist()

    assert columns(0.5, 0.0) == [0.0, 0.5]  # unbent bristles take the whole rate
    level = 1.0 + 0.6 / E
    assert columns(0.02, level) == pytest.approx([level, 0.0], abs=1e-15)  # bent to the level they slip
    assert columns(-0.02, 0.5) == pytest.approx([0.5, -0.02 - 0.02 * 0.5 / level], rel=1e-14)
    assert columns(-0.04, -0.5) == pytest.approx([-0.5, -0.04 + 0.04 * 0.5 / (1.0 + 0.6 / E**4)], rel=1e-14)
    assert columns(0.01, 0.8) == pytest.approx([0.8, 0.01 - 0.008 / (1.0 + 0.6 * E**-0.25)], rel=1e-14)
    assert columns(1e30, 0.25) == pytest.approx([0.25, 0.75e30], rel=1e-14)


# -- Bouc-Wen in one stroke -----------------------------------------------------------------------


def _length(start, end, rho, n):
    """x of a stroke from y = start to end: the integral of dy / (1 - (sgn y + rho) |y|^n)."""
    edges = [start, 0.0, end] if start * end < 0.0 else [start, end]
    total = 0.0
    for low, high in zip(edges[:-1], edges[1:]):
        c = rho + (1.0 if low + high > 0.0 else -1.0)
        total += quad(lambda y, c=c: 1.0 / (1.0 - c * abs(y) ** n), low, high, epsabs=1e-14, epsrel=1e-12, limit=200)[0]
    return total


@pytest.mark.parametrize("rho", [-2.0, -1.5, -1.0, -0.6, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("n", [1.0, 1.2, 2.0, 2.7, 4.0])
def test_bouc_wen_strokes_have_the_length_they_were_given(n, rho):
    beta = 40.0
    law = laws.BoucWen(beta=beta, rho=rho, n=n)
    top = (1.0 + rho) ** (-1.0 / n) if rho > -1.0 else 3.0  # where a softening loop ends
    for start in (-4.0, -1.3, -0.7 * top, -0.2, -0.01, 0.0, 1e-4, 0.3 * top, 0.8 * top, 1.7 * top, 8.0):
        for x in (1e-3, 0.07, 0.4, 1.1):
            end = stroke(law, start, x / beta, s0=0.0)[0]
            assert stroke(law, -start, -x / beta, s0=0.0)[0] == -end  # odd
            if abs(end) >= 1e3:
                continue  # hardens without a limit
            slope = abs(1.0 - (rho + math.copysign(1.0, end)) * abs(end) ** n)
            size = max(abs(end), abs(start))
            if slope < 1e-6:
                assert end == pytest.approx(top, rel=1e-6)
                continue
            gap = abs(_length(start, end, rho, n) - x)
            if abs(start) <= 1.0 and rho > -1.0:  # inside the loop
                assert gap * slope < 1e-6, (start, x)
            else:
                assert gap < 2e-5 * max(x, size / slope), (start, x)


@pytest.mark.parametrize(
    ("starts", "lengths", "gap"),
    [
        ((-2.1e-3, -1.3e-3, -1e-3, -6e-4, -2e-4, -1e-5, 0.0, 1e-5, 3e-4), (5e-4, 2e-3, 8e-3), 2e-9),
        ((-0.3, -0.1, -0.03, -0.01, 0.02, 0.1), (0.02, 0.1, 0.3), 1.5e-7),
        ((-0.97, -0.7, 0.6), (0.1, 0.4, 1.0), 1e-6),
    ],
    ids=["small", "middle", "full"],
)
def test_bouc_wen_is_the_more_exact_the_smaller_the_loop(starts, lengths, gap):
    for n in (1.05, 1.2, 1.5, 2.0, 3.0):
        for rho in (-1.0, -0.6, 0.0, 0.5, 1.0):
            law = laws.BoucWen(beta=1.0, rho=rho, n=n)
            for start in starts:
                for x in lengths:
                    end = stroke(law, start, x, s0=0.0)[0]
                    slope = 1.0 - (rho + math.copysign(1.0, end)) * abs(end) ** n
                    assert abs(_length(start, end, rho, n) - x) * slope < gap, (n, rho, start, x)


@pytest.mark.parametrize("start", [-0.9, -0.5, 0.0, 0.3])
def test_bouc_wen_with_n_2_is_a_tangent_and_a_hyperbolic_tangent(start):
    # rho = 0: y' = 1 + y^2 up to y = 0, then y' = 1 - y^2
    law = laws.BoucWen(beta=1.0, rho=0.0, n=2.0)
    for x in (0.05, 0.3, 0.9, 2.0, 5.0):
        to_zero = math.atan(-start) if start < 0.0 else 0.0
        if x < to_zero:
            end = math.tan(x + math.atan(start))
        else:
            end = math.tanh(x - to_zero + math.atanh(max(start, 0.0)))
        assert stroke(law, start, x, s0=0.0)[0] == pytest.approx(end, abs=5e-7)


@pytest.mark.parametrize("rho", [-1.7, -1.0, -0.4, 0.0, 0.7, 1.0, 1.8])
@pytest.mark.parametrize("start", [-1.8, -0.4, 0.0, 0.3, 2.0])
def test_bouc_wen_with_n_1_is_exponential(rho, start):
    law = laws.BoucWen(beta=1.0, rho=rho, n=1.0)

    def along(y, c, x):  # y' = 1 - c y
        return y + x if c == 0.0 else 1.0 / c + (y - 1.0 / c) * math.exp(-c * x)

    for x in (1e-3, 0.2, 1.0, 4.0):
        end = start
        rest = x
        if start < 0.0:
            c = 1.0 - rho  # (sgn y + rho) |y| = (1 - rho) y
            if c == 0.0:
                to_zero = -start
            else:
                to_zero = math.log(1.0 - c * start) / c if 1.0 - c * start > 0.0 else math.inf
            rest = max(x - to_zero, 0.0)
            end = 0.0 if rest > 0.0 else along(start, c, x)
        if rest > 0.0:
            end = along(end, 1.0 + rho, rest)
        assert stroke(law, start, x, s0=0.0)[0] == pytest.approx(end, rel=1e-10, abs=1e-12)
        assert stroke(law, -start, -x, s0=0.0)[0] == pytest.approx(-end, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("n", [1.0, 1.5, 2.0, 3.0])
def test_hardening_bouc_wen_is_bounded_and_comes_back(n):
    law = laws.BoucWen(beta=1.0, rho=-1.5, n=n)
    assert stroke(law, 0.0, 200.0)[0] == 1e6 and stroke(law, 0.0, -200.0)[0] == -1e6
    assert stroke(law, 1e6, 5.0)[0] == 1e6  # and stays
    back = (
        _length(-1e6, 0.0, -1.5, n)
        if n == 1.0
        else sum(_length(*p, -1.5, n) for p in ((-1e6, -1e3), (-1e3, -1.0), (-1.0, 0.0)))
    )
    assert stroke(law, 1e6, -back - 0.2, s0=0.0)[0] == pytest.approx(stroke(law, 0.0, -0.2, s0=0.0)[0], abs=2e-5)
    assert stroke(law, 1e6, -0.8 * back, s0=0.0)[0] > 0.0


@pytest.mark.parametrize("n", [1.0, 1.6, 3.0])
def test_bouc_wen_that_unloads_at_its_fixed_point_stays(n):
    # rho > 1: at |y|^n = 1 / (rho - 1) of the other sign the rate vanishes
    law = laws.BoucWen(beta=1.0, rho=3.0, n=n)
    fixed = -(0.5 ** (1.0 / n))
    assert stroke(law, fixed, 0.5, s0=0.0)[0] == pytest.approx(fixed, rel=1e-9)
    assert stroke(law, 0.9 * fixed, 30.0, s0=0.0)[0] == pytest.approx(0.25 ** (1.0 / n), rel=1e-6)
    assert stroke(law, 1.1 * fixed, 0.2, s0=0.0)[0] < 1.1 * fixed


def test_forces_from_a_state():
    def force(law, z, s=0.0, v=0.0):
        out = np.empty(len(law.terms()))
        law.kernel(s, v, 0.0, 0.0, np.empty(0), np.array(z), law.theta, out)
        return law.values @ out

    law = laws.BoucWen(beta=20.0, rho=0.0, n=1.0, alpha=5e4)  # alpha times the hysteretic drift in metres
    assert force(law, stroke(law, 0.0, 0.01)) == pytest.approx(5e4 * (1.0 - math.exp(-0.2)) / 20.0, rel=1e-12)
    damper = laws.ModifiedDahl(K0=50.0, C0=400.0, Fd=35.0, f0=2.0, sigma=1e3)
    assert force(damper, [-0.2], s=0.1, v=0.2) == pytest.approx(5.0 + 80.0 - 7.0 + 2.0, rel=1e-14)
    assert force(laws.Dahl(sigma=1e3, Fd=35.0), [-0.2], s=0.1, v=0.2) == -7.0
    assert force(laws.Iwan(uy=1.0, ratio=2.0, F1=3.0, F2=5.0), [0.5, -1.0], s=0.1, v=0.2) == -3.5
    assert force(laws.MaxwellBranch(tau=1.0, k=1e4), [-2e-3], s=0.1, v=0.2) == -20.0


# -- the checks of the contract, each on a law that breaks it -------------------------------------


def rng():
    return np.random.default_rng(3)


def broken(parent, *args, **changes):
    """A law that differs in what is given, with values."""
    return contract.random_values(type(f"Broken{parent.__name__}", (parent,), changes)(*args), rng())


def plain(function):
    """A kernel of one term."""

    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = function(s, v)

    return staticmethod(kernel)


def refused(check, law, words):
    with pytest.raises(AssertionError, match=words):
        check(law, rng())


def test_the_motion_of_the_checks_is_three_harmonics_of_two_seconds():
    law = laws.CovariateFriction("V")
    motion = contract.random_motion(law, rng())
    assert motion.n_samples == 1001 and motion.t[0] == 0.0 and motion.t[-1] == pytest.approx(4.0, rel=1e-12)
    assert np.diff(motion.t) == pytest.approx(0.004)
    omega = 2 * np.pi * np.arange(501) / 4.0
    lines = [np.fft.rfft(x[:-1]) / 500 for x in (motion.s, motion.v, motion.a)]
    sizes = np.abs(lines[0])
    for k in (1, 2, 3):  # of one, a quarter and a ninth of 5 to 10 cm
        assert 0.05 <= sizes[2 * k] * k**2 <= 0.1
    sizes[[2, 4, 6]] = 0.0
    assert sizes.max() < 1e-12
    np.testing.assert_allclose(lines[1], 1j * omega * lines[0], atol=1e-9)  # the rate of the drift
    np.testing.assert_allclose(lines[2], 1j * omega * lines[1], atol=1e-8)  # and of the rate
    V = motion.covariates["V"]  # positive: a command
    assert 0.5 <= V.min() < 0.52 and 2.48 < V.max() <= 2.5
    wave = V - 1.5
    np.testing.assert_allclose(np.diff(wave, 2) / 0.004**2, -9.0 * wave[1:-1], atol=1e-3)  # at 3 rad/s
    ground = contract.random_motion(laws.GroundFriction(), rng()).covariates["vg"]  # of either sign
    assert 0.19 < ground.max() <= 0.2 and -0.2 <= ground.min() < -0.19
    other = contract.random_motion(law, np.random.default_rng(4))
    assert not np.array_equal(other.s, motion.s)
    short = contract.random_motion(law, rng(), n_periods=1, n_samples=100)
    assert short.n_samples == 101 and short.t[-1] == pytest.approx(2.0) and short.s[-1] == pytest.approx(short.s[0])
    phases = [
        np.angle(np.fft.rfft(contract.random_motion(law, np.random.default_rng(k)).s[:-1])[[2, 4, 6]])
        for k in range(60)
    ]
    assert np.ptp(phases, axis=0).min() > 5.5 and np.abs(np.mean(phases, axis=0)).max() < 0.8


def test_values_of_the_checks_fill_their_search_range():
    draws = [contract.random_values(laws.DeadZone(), np.random.default_rng(k)) for k in range(400)]
    gaps, centres = (np.array([d.shape[name] for d in draws]) for name in ("gap", "centre"))
    low, high = math.log(0.05 * 0.01), math.log(4.0 * 0.01)  # of an rms drift of 1 cm
    assert low <= np.log(gaps).min() < low + 0.05 and high - 0.05 < np.log(gaps).max() <= high
    assert np.log(gaps).mean() == pytest.approx((low + high) / 2, abs=0.2)
    assert -0.95 <= centres.min() < -0.93 and 0.93 < centres.max() <= 0.95
    k = np.array([d.values[0] for d in draws])
    assert 1.0 <= k.min() < 1.1 and 9.9 < k.max() <= 10.0
    times = [contract.random_values(laws.StiffnessStep(), np.random.default_rng(k)).shape["t0"] for k in range(400)]
    assert 0.2 <= min(times) < 0.25 and 3.75 < max(times) <= 3.8  # of a record of 4 s
    speeds = [contract.random_values(laws.StribeckFriction(), np.random.default_rng(k)).shape["vs"] for k in range(400)]
    assert 1e-3 <= min(speeds) < 1.1e-3 and 0.09 < max(speeds) <= 0.1  # of an rms rate of 5 cm/s


def test_a_sound_law_passes():
    assert contract.check_law(laws.GroundFriction()) is None
    assert contract.check_law(laws.GroundFriction(), random_state=5) is None
    with pytest.raises(NRFError, match="random_state='x' is no seed"):
        contract.check_law(laws.GroundFriction(), random_state="x")


def test_check_features():
    check = contract.check_features
    law = broken(laws.LinearViscous)
    check(law, rng())
    for changed, words in (
        (lambda self, m, state=None: np.zeros((m.n_samples, 2)), "have shape"),
        (lambda self, m, state=None: np.zeros((m.n_samples + 1, 1)), "have shape"),
        (lambda self, m, state=None: m.v[:, None].astype(np.float32), "are float32"),
        (lambda self, m, state=None: np.where(m.v > 0, np.nan, m.v)[:, None], "not finite"),
    ):
        refused(check, broken(laws.LinearViscous, features=changed), words)

    def spoils(channel):
        def features(self, m, state=None):
            columns = laws.CovariateFriction.features(self, m)
            changed = m.covariates["voltage"] if channel == "u" else getattr(m, channel)
            changed[-1] += 1e-9
            return columns

        return features

    for channel in "svatu":
        refused(check, broken(laws.CovariateFriction, features=spoils(channel)), "changes the motion")


def test_check_large_arguments():
    check, seen = contract.check_large_arguments, []

    def features(self, m, state=None):
        seen.append(m)
        return laws.CovariateFriction.features(self, m)

    check(broken(laws.CovariateFriction, features=features), rng())
    m = seen[0]
    assert np.diff(m.t) == pytest.approx(0.01) and m.t[0] == 0.0
    for x in (m.s, m.v, m.a, m.covariates["voltage"]):
        size = np.abs(x[x != 0])
        assert len(x) == 200 and {-1.0, 0.0, 1.0} == set(np.sign(x))
        assert 1e-30 <= size.min() < 1e-25 and 1e25 < size.max() <= 1e30
    for kernel in (
        lambda s, v: s**21,
        lambda s, v: v / s,
        lambda s, v: 0.0 * np.log(np.abs(v)),
        lambda s, v: np.sqrt(v),
    ):
        with pytest.raises(FloatingPointError):
            check(broken(laws.LinearViscous, kernel=plain(kernel)), rng())
    refused(check, broken(laws.LinearViscous, kernel=plain(lambda s, v: np.where(v > 1e20, np.inf, v))), "not finite")


def test_check_single_samples():
    def by_kind(s, v):
        return v if np.ndim(v) else 1.001 * v

    refused(contract.check_single_samples, broken(laws.LinearViscous, kernel=plain(by_kind)), "on floats differs")

    @staticmethod
    def silent(s, v, a, t, u, z, theta, out):
        if np.ndim(v):
            out[0] = v

    refused(contract.check_single_samples, broken(laws.LinearViscous, kernel=silent), "on floats differs")


def test_check_rest():
    check = contract.check_rest
    check(broken(laws.LinearViscous), rng())
    check(broken(laws.ConstantForce, at_rest=1.0), rng())
    refused(check, broken(laws.ConstantForce, at_rest=0.5), "the force at rest is not 0.5")
    refused(check, broken(laws.ConstantForce, at_rest=0.0), "the force at rest is not 0.0")
    refused(check, broken(laws.LinearElastic, at_rest=None), "vanishes at rest")
    refused(check, broken(laws.LinearViscous, at_rest=None), "vanishes at rest")
    refused(check, broken(laws.AddedMass, at_rest=None), "vanishes at rest")
    check(broken(laws.AddedMass), rng())


def test_check_symmetry():
    kernels = {
        "odd": lambda s, v: s * v * v,
        "even": lambda s, v: s * v,
        "none": lambda s, v: v + 1e-6 * v * v,  # nearly odd is not odd
    }
    for found, kernel in kernels.items():
        for claimed in kernels:
            law = broken(laws.LinearViscous, kernel=plain(kernel), symmetry=claimed)
            if claimed == found:
                contract.check_symmetry(law, rng())
            else:
                refused(contract.check_symmetry, law, f"symmetry is '{claimed}', found '{found}'")
    contract.check_symmetry(broken(laws.LinearViscous, kernel=plain(lambda s, v: v + 1e-13 * v * v)), rng())
    contract.check_symmetry(broken(laws.AddedMass), rng())


def test_check_records():
    check, viscous, elastoplastic = contract.check_records, laws.LinearViscous.features, laws.Jenkins.features
    for sound in (laws.Jenkins, laws.LinkSpringDashpot, laws.AddedMass, laws.StiffnessDrift, laws.CovariateFriction):
        check(broken(sound), rng())

    def counts_samples(self, m, state=None):
        return viscous(self, m) + 1e-6 * m.n_samples

    refused(check, broken(laws.LinearViscous, features=counts_samples), "the first block differs")
    refused(
        check,
        broken(laws.Jenkins, features=lambda self, m, state=None: elastoplastic(self, m)),
        "the last block differs",
    )
    refused(
        check,
        broken(laws.LinearViscous, features=lambda self, m, state=None: 2.0 * viscous(self, m)),
        "does not start from a fresh state",
    )

    def ages(self, m, state=None):
        self.age = getattr(self, "age", 0) + 1
        return viscous(self, m) * (1.0 if self.age < 5 else 1.001)

    refused(check, broken(laws.LinearViscous, features=ages), "remembers an earlier record")


def test_check_energy():
    check = contract.check_energy

    def law(kernel, **claims):
        return broken(laws.LinearElastic, kernel=plain(kernel), **claims)

    for variable in ("s", "a"):
        refused(
            check,
            law(lambda s, v: s + 1e-4 * v, variable=variable, passive=False),
            "takes or gives energy over closed cycles",
        )
        refused(check, law(lambda s, v: s - 1e-4 * v, variable=variable, passive=False), "takes or gives energy")
        check(law(lambda s, v: s + 1e-8 * v, variable=variable), rng())
    check(law(lambda s, v: s + 1e-4 * v, variable="v"), rng())
    check(law(lambda s, v: s - 1e-8 * v, variable="v"), rng())
    refused(check, law(lambda s, v: s - 1e-4 * v, variable="v"), "passive, but gives energy")
    check(law(lambda s, v: s - 1e-4 * v, variable="v", passive=False), rng())


@pytest.mark.parametrize(
    ("check", "law", "words"),
    [
        (contract.check_variable, broken(laws.CoulombFriction, variable="s"), "does not follow 's'"),
        (contract.check_variable, broken(laws.DisplacementDependentDamping, variable="s"), "follows more than 's'"),
        (contract.check_variable, broken(laws.CubicStiffness, variable="v"), "does not follow 'v'"),
        (contract.check_variable, broken(laws.LinearElastic, variable="1"), "follows more than '1'"),
        (contract.check_variable, broken(laws.BaseMotion, variable="1"), "follows more than '1'"),
        (contract.check_variable, broken(laws.Inerter, kernel=plain(lambda s, v: s)), "does not follow 'a'"),
        (contract.check_variable, broken(laws.Dahl, variable="z"), "variable is 'z'"),
        (contract.check_jumps, broken(laws.QuadraticDamping, jumps=True), "jumps is True, found False"),
        (contract.check_jumps, broken(laws.StribeckFriction, jumps=False), "jumps is False, found True"),
        (contract.check_saturation, broken(laws.BoucWen, saturates_at="n"), "does not saturate"),
        (contract.check_saturation, broken(laws.TwoSidedGap, saturates_at="gap"), "does not saturate"),
        (contract.check_saturation, broken(laws.Dahl, saturates_at="uy"), "is no shape parameter"),
        (contract.check_signs, broken(laws.Duffing, nonnegative=("k2",)), "signs are stated of"),
        (contract.check_signs, broken(laws.Duffing, nonnegative=("k",), expected_positive=("k",)), "signs are stated"),
        (
            contract.check_special_cases,
            broken(laws.Duffing, special_cases={laws.LinearElastic: lambda c: laws.Duffing(0.98 * c.values[0], 0.0)}),
            "is not LinearElastic",
        ),
        (contract.check_special_cases, broken(laws.StribeckFriction, contains=lambda *_: False), "does not contain"),
    ],
)
def test_a_law_that_states_what_is_not_so_is_refused(check, law, words):
    refused(check, law, words)


def test_special_cases_are_told_by_their_class():
    friction = laws.CoulombFriction()
    assert laws.CovariateFriction("T").contains(friction) and not friction.contains(laws.CovariateFriction("T"))
    assert laws.DeadZone().contains(laws.OneSidedGap(side=-1)) and not laws.DeadZone().contains(laws.Bilinear())
    drifts = [law for law in laws.registry().values() if law.__module__.startswith("pysindy_nrf") and law.variable == "s"]
    assert len(drifts) > 5 and all(law().contains(laws.ConstantForce()) for law in drifts)
    assert not laws.QuadraticDamping().contains(laws.ConstantForce())


def test_check_single_precision():
    check, viscous = contract.check_single_precision, laws.LinearViscous.features
    check(broken(laws.CovariateFriction), rng())

    def rounded(self, m, state=None):
        return viscous(self, m).astype(m.v.dtype)

    refused(check, broken(laws.LinearViscous, features=rounded), "features of float32 are float32")

    def off_by(share):
        def features(self, m, state=None):
            single = all(x.dtype == np.float32 for x in (m.s, m.v, m.a, m.t))
            return viscous(self, m).astype(float) * (1.0 + share * single)

        return features

    refused(check, broken(laws.LinearViscous, features=off_by(1e-4)), "loses digits")
    check(broken(laws.LinearViscous, features=off_by(1e-6)), rng())

    def needs_single(self, m, state=None):
        return laws.CovariateFriction.features(self, m) * (1.0 + (m.covariates["voltage"].dtype == np.float32))

    refused(check, broken(laws.CovariateFriction, features=needs_single), "loses digits")


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("N", 2.0), ("1", 1.0), ("1/m", 0.2), ("N s/m", 1.2), ("N s^2/m^3", 2.0 * 9.0 / 125.0), ("N/(m s)", 2.0 / 15.0),
        ("m/s^2", 5.0 / 9.0), ("N s^n/m^n", 2.0 * (3.0 / 5.0) ** 0.7), ("kg", 7.0), ("N s/m/[u]", 1.2 / 11.0),
    ],
)  # fmt: skip
def test_size_of_a_unit(unit, size):
    sizes = {"N": 2.0, "s": 3.0, "m": 5.0, "kg": 7.0, "[u]": 11.0, "1": 1.0}
    assert contract._in(unit, sizes, laws.PowerLawDamping(n=0.7)) == pytest.approx(size, rel=1e-14)


@pytest.mark.parametrize(
    ("parent", "term"),
    [
        (laws.LinearViscous, Term("c", "v", "N/m")),
        (laws.CubicStiffness, Term("k3", "s^3", "N/m^2")),
        (laws.AddedMass, Term("dm", "a", "N")),
        (laws.StiffnessDrift, Term("kt", "s t", "N/m")),
        (laws.BaseMotion, Term("m", "ag", "N")),
        (laws.PowerLawDamping, Term("cn", "sgn(v) |v|^n", "N s/m")),
    ],
)
def test_check_units(parent, term):
    contract.check_units(broken(parent), rng())
    refused(
        contract.check_units,
        broken(parent, terms=lambda self: (term,)),
        re.escape(f"{term.symbol} has not the unit {term.unit}"),
    )


def test_check_force():
    force = laws.Duffing.force
    contract.check_force(broken(laws.Duffing), rng())
    for wrong in (
        lambda self, m: 1.001 * force(self, m),
        lambda self, m: force(self, m) + 1e-6 * np.abs(force(self, m)).max(),
    ):
        refused(contract.check_force, broken(laws.Duffing, force=wrong), "not the features times the coefficients")


def test_check_json():
    check, parent = contract.check_json, laws.TwoSidedGap

    def law(**changes):  # known by its own name, so that its data leads back to it
        cls = type("Json", (parent,), changes)
        cls.name = f"test_json_{len(base._REGISTRY)}"
        base._REGISTRY[cls.name] = cls
        return cls, contract.random_values(cls(), rng())

    known = dict(base._REGISTRY)
    try:
        check(law()[1], rng())
        refused(
            check, law(__eq__=lambda self, other: self is other, __hash__=lambda self: 1)[1], "not equal to its copy"
        )
        refused(check, law(__hash__=lambda self: id(self))[1], "not equal to its copy")

        def drifting(self, m):
            type(self).calls = getattr(type(self), "calls", 0) + 1
            return parent.force(self, m) * type(self).calls

        refused(check, law(force=drifting)[1], "its copy by JSON gives another force")

        def in_place(self, coefficients=None, shape=None):
            new = parent.with_values(self, coefficients, shape)
            if getattr(self, "ready", False):
                self.coefficients = new.coefficients
            return new

        changed = law(with_values=in_place)[1]
        changed.ready = True
        refused(check, changed, "with_values changes the law itself")

        def deaf(self, coefficients=None, shape=None):
            return parent.with_values(self, None if getattr(self, "ready", False) else coefficients, shape)

        lost = law(with_values=deaf)[1]
        lost.ready = True
        refused(check, lost, "with_values loses coefficients")
    finally:
        base._REGISTRY.clear()
        base._REGISTRY.update(known)


def test_check_text():
    check = contract.check_text
    two = (Term("k", "s", "N/m"), Term("k3", "s^3", "N/m^3"))
    with pytest.raises(AssertionError, match="BrokenDuffing has no documentation"):
        check(broken(laws.Duffing), rng())
    check(broken(laws.Duffing, __doc__="Documented."), rng())
    for changes, words in (
        ({"name": "not a name"}, "name or family is missing"),
        ({"family": ""}, "name or family is missing"),
        ({"acts_at": ("roof",)}, "acts_at is"),
        ({"acts_at": ()}, "acts_at is"),
        ({"terms": lambda self: (two[0], two[1]._replace(symbol="k"))}, "symbols .* are not distinct"),
        ({"terms": lambda self: (two[0], two[1]._replace(label="s"))}, "labels .* are not distinct"),
        ({"terms": lambda self: (two[0], two[1]._replace(label=""))}, "labels .* are not distinct"),
        ({"parameters": {"k": 1.0}}, "parameters are wrong"),
        ({"equation": lambda self, index="": "s^3"}, None),
        ({"equation": lambda self, index="": "s"}, "is not in its equation"),
        ({"equation": lambda self, index="": "s^3" if self.coefficients is None else "s"}, "is not in its equation"),
        (
            {"equation": lambda self, index="": "s^3" if self.coefficients is not None else "s"},
            "is not in its equation",
        ),
        ({"__repr__": lambda self: "Duffing"}, "repr is"),
    ):
        law = broken(laws.Duffing, __doc__="Documented.")
        for name, value in changes.items():
            setattr(type(law), name, value)
        if words is None:
            check(law, rng())
        else:
            refused(check, law, words)
    shared = broken(laws.Dahl, terms=lambda self: (Term("sigma", "Z", "N"),))
    refused(check, shared, "a coefficient and a shape share a name")


def test_check_errors():
    check, law = contract.check_errors, laws.TwoSidedGap
    for sound in (laws.TwoSidedGap, laws.StiffnessDrift, laws.AddedMass, laws.BaseMotion):
        check(broken(sound), rng())

    def guessed(self, m, state=None):
        return np.zeros((m.n_samples, 1))

    refused(check, broken(law, features=guessed), "no error where 'gap'")
    refused(check, broken(laws.BaseMotion, features=guessed), "no error where 'ag'")
    refused(check, broken(laws.StiffnessDrift, features=guessed), "no error where 'time'")
    refused(check, broken(laws.AddedMass, features=guessed), "no error where 'acceleration'")

    def lenient(what):
        def with_values(self, coefficients=None, shape=None):
            try:
                return law.with_values(self, coefficients, shape)
            except LawError as error:
                if what in str(error):
                    return self
                raise

        return with_values

    for what, named in (
        ("not a finite number", "gap"), ("not positive", "gap"), ("no shape parameter", "no such"), ("1 coefficients, 2", "2"),
        ("no coefficient 'no such'", "no such"),
    ):  # fmt: skip
        refused(check, broken(law, with_values=lenient(what)), f"no error where '{named}' is wrong or missing")

    def mumbles():
        raise LawError("Something is wrong")

    with pytest.raises(AssertionError, match="the error does not name 'gap': Something is wrong"):
        contract._refuses(mumbles, "gap")
    with pytest.raises(ZeroDivisionError):
        contract._refuses(lambda: 1 / 0, "gap")


def test_close_is_a_share_of_the_largest_of_each_column():
    expected = np.array([[1.0, 100.0], [-4.0, 10.0]])
    for gap, column, fits in ((3.9e-10, 0, True), (4.1e-10, 0, False), (0.99e-8, 1, True), (1.01e-8, 1, False)):
        for sign in (1.0, -1.0):
            found = expected.copy()
            found[0, column] += sign * gap
            if fits:
                contract._close(found, expected, "rows")
            else:
                with pytest.raises(AssertionError, match=r"rows \(by "):
                    contract._close(found, expected, "rows")
    contract._close(expected + 0.5, expected, "rows", tolerance=0.125)  # 0.125 * 4: just
    with pytest.raises(AssertionError, match=r"rows \(by 0.51\)"):
        contract._close(expected + 0.51, expected, "rows", tolerance=0.125)
    contract._close(np.array([1.0]), np.array([2.0]), "rows", 0.5, scale=np.array([[-2.0], [1.0]]))
    with pytest.raises(AssertionError):
        contract._close(np.array([0.9]), np.array([2.0]), "rows", 0.5, scale=np.array([[-2.0], [1.0]]))
    with pytest.raises(AssertionError):
        contract._close(np.array([np.nan]), np.array([2.0]), "rows")


def test_parts_and_types_of_a_motion():
    motion = contract.random_motion(laws.CovariateFriction(), rng(), 1, 20)
    part = contract._part(motion, slice(3, 8))
    for whole_record, some in zip(
        (motion.s, motion.v, motion.a, motion.t, motion.covariates["voltage"]),
        (part.s, part.v, part.a, part.t, part.covariates["voltage"]),
    ):
        assert np.array_equal(whole_record[3:8], some)
    single = contract._as_type(motion, np.float32)
    for double, half in zip(
        (motion.s, motion.v, motion.a, motion.t, motion.covariates["voltage"]),
        (single.s, single.v, single.a, single.t, single.covariates["voltage"]),
    ):
        assert half.dtype == np.float32 and np.array_equal(double.astype(np.float32), half)
    assert contract.covariate_units(laws.GroundFriction()) == ("m/s",)
    assert contract.covariate_units(laws.Dahl()) == () and contract.covariate_units(laws.CovariateDahl()) == ("[u]",)


# -- the path of a state --------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("turn", "rise", "v0", "v1", "fits"),
    [
        (0.5, 0.2, 1.0, -1.0, True),
        (0.0, 0.0, 1.0, -1.0, True),  # just at both ends
        (0.5, 0.5, 1.0, -1.0, True),
        (2.0, 1.0, 1.0, -1.0, True),  # as far as the rates can carry it in 2 s
        (2.1, 1.0, 1.0, -1.0, False),
        (1.5, -0.5, 1.0, -1.0, True),
        (1.5, -0.6, 1.0, -1.0, False),
        (-0.1, -0.2, 1.0, -1.0, False),  # not beyond its start
        (0.1, 0.2, 1.0, -1.0, False),  # not beyond its end
        (0.3, 0.2, 0.1, -1.0, False),
        (0.3, 0.2, 1.0, -0.01, False),
    ],
)
def test_a_turn_lies_beyond_both_ends_and_in_reach(turn, rise, v0, v1, fits, sign):
    assert memory._plausible.py_func(sign * turn, sign * rise, 2.0, sign * v0, sign * v1) == fits


def test_hermite_polynomials_of_a_step():
    rng = np.random.default_rng(5)
    for _ in range(5):
        h = rng.uniform(0.1, 2.0)
        five, three = Polynomial([0.0, *rng.normal(size=5)]), Polynomial([0.0, *rng.normal(size=3)])
        d1, d2 = five.deriv(), five.deriv(2)
        quintic = memory._quintic.py_func(five(1), h, d1(0) / h, d2(0) / h**2, d1(1) / h, d2(1) / h**2)
        np.testing.assert_allclose(quintic, five.coef[1:], rtol=1e-9, atol=1e-11)
        slope = three.deriv()
        cubic = memory._cubic.py_func(three(1), h, slope(0) / h, slope(1) / h)
        np.testing.assert_allclose(cubic, [*three.coef[1:], 0.0, 0.0], rtol=1e-9, atol=1e-11)
        c = five.coef[1:]
        for x in (0.0, 0.3, 1.0):
            assert memory._rise.py_func(x, c) == pytest.approx(five(x), rel=1e-12)
            assert memory._slope.py_func(x, c) == pytest.approx(d1(x), rel=1e-12)
            assert memory._curvature.py_func(x, c) == pytest.approx(d2(x), rel=1e-12)
            assert memory._third.py_func(x, c) == pytest.approx(five.deriv(3)(x), rel=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("power", [1, 3, 9])
@pytest.mark.parametrize("derivative", ["true", "of the wrong sign", "zero", "far too small"])
def test_zeros_are_found_whatever_the_derivative(sign, power, derivative):
    calls = []

    def f(x, c):
        calls.append(x)
        return sign * (x**power - 0.4**power)

    def df(x, c):
        true = sign * power * x ** (power - 1)
        return {"true": true, "of the wrong sign": -true, "zero": 1e-300, "far too small": 0.01 * true}[derivative]

    root = memory._root_of(f, df).py_func(0.0, 1.0, None)
    assert root == pytest.approx(0.4, abs=3e-10)
    assert all(0.0 <= x <= 1.0 for x in calls) and len(calls) <= (14 if derivative == "true" else 64)


def test_doubtful_intervals():
    v = np.array([1.0, -1.0, -2.0, -0.0, 3.0, 3.0, 3.0])
    a = np.array([5.0, 5.0, 5.0, -1.0, -1.0, 1.0, 0.0])
    out = np.zeros(6, dtype=np.uint8)
    memory._doubt_sign.py_func(v[:-1], v[1:], out)
    assert out.tolist() == [1, 0, 0, 0, 0, 0]
    memory._doubt_both.py_func(v[:-1], v[1:], a[:-1], a[1:], out)
    assert out.tolist() == [1, 0, 1, 0, 1, 0]  # -2 -> 0 speeds down and on again; 3 -> 3 dips; 3 -> 3 speeds up only


class Diary(ForceLaw):
    """Notes every stretch of the way that its state is moved along, the last eight of them word by word."""

    shapes = (Shape("pace", "1", 1.0, 2.0),)  # not read
    n_states = 3 + 6 * 8
    covariates = ("level",)

    def terms(self):
        return (Term("c", "distance", "N/m"), Term("d", "count", "N"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[1]
        out[1] = z[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        row = 3 + 6 * (int(z[0]) % 8)
        z[row] = s0
        z[row + 1] = v0
        z[row + 2] = s1
        z[row + 3] = v1
        z[row + 4] = dt
        z[row + 5] = u[0]
        z[0] += 1.0
        z[1] += abs(s1 - s0)
        z[2] += dt


DIARY = Diary({"pace": 1.5})


def read(motion, state=None):
    """What the diary says at the end: the stretches."""
    state = np.zeros(Diary.n_states) if state is None else state
    columns = DIARY.features(motion, state)
    return state[3:].reshape(8, 6)[: int(state[0])], columns


def moving_by(p, edges, with_a=True, with_t=True):
    """A motion that is a polynomial of the time, known at a few times."""
    t = np.asarray(edges, dtype=float)
    v, a = p.deriv(), p.deriv(2)
    return Motion(p(t), v(t), a(t) if with_a else None, t if with_t else None, {"level": np.arange(1.0, len(t) + 1.0)})


def stretches(p, way, levels):
    v = p.deriv()
    return [(p(b), v(b), p(e), v(e), e - b, x) for b, e, x in zip(way[:-1], way[1:], levels, strict=True)]


H, SIZE = 0.02, 1e-3


def _in_time(roots, factor=(1.0,)):
    """Drift of SIZE (m) on a time of H (s) whose rate has these zeros, in shares of H."""
    rate = Polynomial(factor)
    for root in roots:
        rate = rate * Polynomial([-root, 1.0])
    share = rate.integ()
    return Polynomial([SIZE * c / H**k for k, c in enumerate(share.coef)])


TURNS = {  # rate as a polynomial, where it turns inside the step, whether the acceleration is given
    "straight": (_in_time([], (1.0, 0.5)), [], True),
    "parabola": (_in_time([0.3]), [0.3], False),
    "parabola late": (_in_time([0.9]), [0.9], True),
    "cubic": (_in_time([0.3, -1.0]), [0.3], False),
    "cubic late": (_in_time([0.8], (-1.0, 0.2)), [0.8], False),
    "quintic": (_in_time([0.4], (1.0, 0.3, -0.2, 0.8)), [0.4], True),
    "quintic early": (_in_time([0.15], (-1.0, 0.5, 0.3, -0.4)), [0.15], True),
    "twice": (_in_time([0.2, 0.7], (1.0, 0.0, 1.0)), [0.2, 0.7], True),
    "twice, late": (_in_time([0.45, 0.85], (-1.0, 0.1, -0.3)), [0.45, 0.85], True),
    "twice, and once later": (_in_time([0.2, 0.7], (1.6, -1.0)), [0.2, 0.7], True),
    "dips only": (_in_time([], (0.35, -1.0, 1.0)), [], True),
    "twice, not seen": (_in_time([0.2, 0.7]), [], False),
}


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("case", TURNS)
def test_the_way_is_cut_where_the_motion_turns(case, mirror):
    p, turns, with_a = TURNS[case]
    p = p * mirror
    edges = [0.0, H]
    expected = stretches(p, [0.0, *(H * x for x in turns), H], [1.5] * (1 + len(turns)))
    found, columns = read(moving_by(p, edges, with_a))
    assert columns[1, 1] == 1 + len(turns)
    ends = np.array([(e[0], e[2]) for e in expected])
    seen = np.array([[True, True], [True, False], [False, True]]) if len(turns) == 2 else np.full(ends.shape, True)
    np.testing.assert_allclose(found[:, [0, 2]][seen], ends[seen], atol=1e-12 * SIZE)
    np.testing.assert_allclose(found[:, [1, 3]], [[e[1], e[3]] for e in expected], atol=1e-12 * SIZE / H)
    np.testing.assert_allclose(found[:, 4], [e[4] for e in expected], atol=1e-9 * H)
    assert found[:, 5].tolist() == [1.5] * len(expected)  # the mean of both samples
    for k in range(len(turns)):
        assert found[k, 3] == 0.0 == found[k + 1, 1]  # at rest where it turns


@pytest.mark.parametrize("case", ["twice", "twice, late"])
def test_the_drift_of_a_second_turn(case):
    p, turns, _ = TURNS[case]
    found, _ = read(moving_by(p, [0.0, H]))
    assert found[1, 2] == pytest.approx(p(H * turns[1]), rel=1e-9)
    assert found[2, 0] == found[1, 2]


def test_a_state_that_turns_twice_in_a_step_is_that_of_shorter_steps():
    p, turns, _ = TURNS["twice"]
    long, short = ([0.0, H], [0.0, H * turns[0], H * turns[1], H])
    ends = [laws.Dahl(sigma=2e4).features(moving_by(p, edges))[-1, 0] for edges in (long, short)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)


def test_without_time_every_way_is_straight():
    p, _, _ = TURNS["parabola"]
    law = laws.Jenkins(uy=10.0 * SIZE)
    direct = (p(H) - p(0.0)) / (10.0 * SIZE)
    for with_a in (True, False):
        assert law.features(moving_by(p, [0.0, H], with_a, with_t=False))[1, 0] == pytest.approx(direct, rel=1e-12)


def test_several_steps_with_and_without_turns():
    p = _in_time([0.5, 2.25, 3.6], (0.1, 0.01))
    edges = H * np.arange(5)
    way = H * np.array([0.0, 0.5, 1.0, 2.0, 2.25, 3.0, 3.6, 4.0])
    found, columns = read(moving_by(p, edges))
    expected = np.array(stretches(p, way, [1.5, 1.5, 2.5, 3.5, 3.5, 4.5, 4.5]))
    scale = np.array([SIZE, SIZE / H, SIZE, SIZE / H, H, 1.0])
    np.testing.assert_allclose(found / scale, expected / scale, atol=2e-9)
    assert columns[:, 1].tolist() == [0, 2, 3, 5, 7]
    np.testing.assert_allclose(
        columns[:, 0], [0, *np.cumsum(abs(expected[:, 2] - expected[:, 0]))[[1, 2, 4, 6]]], rtol=1e-11
    )
    state = np.zeros(Diary.n_states)
    whole_way = moving_by(p, edges)
    for k in range(4):  # sample by sample, the state handed on
        rows = slice(k, k + 2)
        part = Motion(whole_way.s[rows], whole_way.v[rows], whole_way.a[rows], whole_way.t[rows],
                      {"level": whole_way.covariates["level"][rows]})  # fmt: skip
        read(part, state)
    assert np.array_equal(state[3:45].reshape(7, 6), found)


def _two_samples(s, v, a=None, h=1.0):
    return Motion(
        np.array(s), np.array(v), None if a is None else np.array(a), np.array([0.0, h]), {"level": np.ones(2)}
    )


@pytest.mark.parametrize(
    ("s", "v", "a", "drifts"),
    [
        # the accelerations contradict the rates: the quintic turns on the wrong side, the cubic is taken
        ([0.0, 0.0], [1.0, -1.0], [-900.0, -900.0], [0.0, 0.25, 0.0]),
        ([0.0, 0.0], [-1.0, 1.0], [900.0, 900.0], [0.0, -0.25, 0.0]),
        ([0.0, 0.0], [1.0, -1.0], [-2.0, -2.0], [0.0, 0.25, 0.0]),  # a true parabola
        # the rates contradict the drift: the straight way
        ([0.0, 3.0], [1.0, -1.0], [0.0, 0.0], [0.0, 3.0]),
        ([0.0, -3.0], [1.0, -1.0], None, [0.0, -3.0]),
        ([0.0, 3.0], [-1.0, 1.0], None, [0.0, 3.0]),
        ([0.0, -3.0], [-1.0, 1.0], None, [0.0, -3.0]),
        # a rate of zero does not turn
        ([0.0, 0.4], [1.0, 0.0], [0.0, 0.0], [0.0, 0.4]),
        ([0.0, 0.4], [0.0, 1.0], None, [0.0, 0.4]),
    ],
)
def test_noise_does_not_bend_the_way(s, v, a, drifts):
    found, _ = read(_two_samples(s, v, a))
    assert [*found[:, 0], found[-1, 2]] == pytest.approx(drifts, abs=1e-9)


@pytest.mark.parametrize("n", [2, 2048, 2049, 2050, 4097, 5000])
def test_long_records_turn_in_every_step(n):
    # between two samples the drift rises by h |v| / 4 and falls again, or the other way round
    h, v = 0.5, np.where(np.arange(n) % 2, -1.0, 1.0)
    motion = Motion(np.zeros(n), v, None, h * np.arange(n), {"level": np.zeros(n)})
    state = np.zeros(Diary.n_states)
    columns = DIARY.features(motion, state)
    np.testing.assert_allclose(columns[:, 1], 2.0 * np.arange(n))
    np.testing.assert_allclose(columns[:, 0], 0.25 * np.arange(n), rtol=1e-9)
    assert state[2] == pytest.approx(h * (n - 1), rel=1e-12)


def twice_in_every_other_step(n):
    """A motion that goes forth, back and forth again in every other step: the same rate at all samples."""
    p = _in_time([0.25, 0.75])
    rate, bend = p.deriv(), p.deriv(2)
    a = np.where(np.arange(n) % 2, bend(H), bend(0.0))
    motion = Motion((p(H) - p(0.0)) * np.arange(n), np.full(n, rate(0.0)), a, H * np.arange(n), {"level": np.zeros(n)})
    return motion, [abs(p(e * H) - p(b * H)) for b, e in ((0.0, 0.25), (0.25, 0.75), (0.75, 1.0))]


@pytest.mark.parametrize("n", [2, 2048, 2049, 4097])
def test_long_records_turn_twice_in_many_steps(n):
    columns = DIARY.features(twice_in_every_other_step(n)[0])
    steps = np.diff(columns, axis=0)
    assert (steps[::2, 1] == 3.0).all() and (steps[1::2, 1] == 1.0).all()


@pytest.mark.parametrize("n", [2, 4097])
def test_the_way_of_long_records_that_turn_twice(n):
    motion, ways = twice_in_every_other_step(n)
    steps = np.diff(DIARY.features(motion)[:, 0])
    np.testing.assert_allclose(steps[::2], sum(ways), rtol=1e-7)


def test_records_of_one_sample_and_of_none():
    law = laws.Dahl(sigma=1e3)
    assert law.features(at(s=1.0)).tolist() == [[0.0]]
    state = np.array([0.4])
    assert law.features(at(s=1.0), state).tolist() == [[0.4]] and state.tolist() == [0.4]
    assert law.features(Motion(np.empty(0), np.empty(0))).shape == (0, 1)
    (z,) = memory.state_paths(law, [at(s=1.0)], np.array([[1.0], [2.0]]))
    assert z.tolist() == [[[0.0]], [[0.0]]]
    assert memory.state_paths(law, [], np.array([[1.0]])) == []
    (z,) = memory.state_paths(law, [at(s=1.0)], np.empty((0, 1)))
    assert z.shape == (0, 1, 1)


def test_a_state_is_moved_in_place_and_no_other_array():
    law = laws.Jenkins(uy=2.0)
    s = np.array([0.0, 1.0, 0.5])
    state = np.array([0.25])
    path = memory.state_path(law, Motion(s, np.ones(3)), np.empty((0, 3)), law.theta, state)
    assert path.tolist() == [[0.25, 0.75, 0.5]] and state.tolist() == [0.5] and s.tolist() == [0.0, 1.0, 0.5]
    assert memory.state_path(law, Motion(s, np.ones(3)), np.empty((0, 3)), law.theta).tolist() == [[0.0, 0.5, 0.25]]
    first, second = memory.state_paths(law, [Motion(s, np.ones(3)), Motion(2 * s, np.ones(3))], [[2.0], [4.0]])
    assert first.tolist() == [[[0.0, 0.5, 0.25]], [[0.0, 0.25, 0.125]]]
    assert second.tolist() == [[[0.0, 1.0, 0.5]], [[0.0, 0.5, 0.25]]]


def test_states_that_cannot_be_moved_are_named():
    s, level = np.array([0.0, 1.0]), {"level": np.ones(2)}
    with pytest.raises(LawError, match="Diary needs the time of the samples"):
        DIARY.features(Motion(s, s, covariates=level))
    with pytest.raises(LawError, match="Diary needs the time"):
        memory.state_paths(DIARY, [Motion(s, s, covariates=level)], np.array([[1.5], [1.6]]))
    with pytest.raises(LawError, match=r"The state of Diary grows beyond all bounds .*\(pace = 1.5\)"):
        DIARY.features(Motion(s, s, t=np.array([0.0, np.nan]), covariates=level))
    for bad in (Motion(np.array([0.0, np.nan]), s), Motion(s, np.array([np.inf, 0.0]))):
        with pytest.raises(ChannelError, match="The motion of a law with memory is not finite"):
            laws.Dahl(sigma=1.0).features(bad)


# -- compiled -------------------------------------------------------------------------------------


def test_machine_code_of_a_law():
    law = laws.Jenkins(uy=2.0)
    kernel, advance = compiled.pointers(law)
    assert compiled.pointers(law) == (kernel, advance) and kernel.address and advance.address
    z, u, theta, out = np.array([0.25]), np.zeros(0), law.theta, np.zeros(1)
    import ctypes

    def line(x):
        return x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), x.size

    advance.ctypes(*line(z), 0.0, 1.0, 1.0, 1.0, 0.1, *line(u), *line(theta))
    assert z[0] == 0.75
    kernel.ctypes(0.0, 0.0, 0.0, 0.0, *line(u), *line(z), *line(theta), *line(out))
    assert out[0] == 0.75


def test_arrays_are_handed_on_read_only():
    x = np.arange(6).reshape(2, 3).T
    view = compiled.read_only(x)
    assert view.tolist() == x.tolist() and view.dtype == float
    assert view.flags.c_contiguous and not view.flags.writeable and x.flags.writeable
    y = np.arange(3.0)
    assert compiled.read_only(y).base is y and y.flags.writeable


def test_what_cannot_be_compiled_is_named():
    class Strange(laws.Dahl):
        @staticmethod
        def advance(z, s0, v0, s1, v1, dt, u, theta):
            z[0] = {}.no_such_thing(s0)

    for call in (lambda law: law.features(Motion(np.zeros(3), np.zeros(3))), compiled.pointers):
        with pytest.raises(LawError, match="Strange cannot be compiled for single samples"):
            call(Strange(sigma=1.0))
    law = laws.Dahl()
    assert "(the last line)" in str(compiled.cannot_compile(law, ValueError("first\nthe last line\n")))
    assert "(ValueError)" in str(compiled.cannot_compile(law, ValueError(" ")))


def test_fingerprints_are_of_the_code():
    def make(table, factor=2.0, deeper=3.0):
        def inner(x):
            return x + deeper

        def outer(x):
            return inner(x) * table[0] * factor

        return outer

    one, two = np.array([1.0]), np.array([2.0])
    prints = [
        compiled.fingerprint(f) for f in (make(one), make(one.copy()), make(two), make(one, 2.5), make(one, 2.0, 4.0))
    ]
    assert prints[0] == prints[1] and len(set(prints)) == 4
    assert compiled.fingerprint(make(one), make(two)) != compiled.fingerprint(make(one))

    def recursive(x):
        return recursive(x - 1) if x else 0

    assert len(compiled.fingerprint(recursive)) == 64
    assert compiled.inline(compiled.inline(recursive)) is not None
    plain = make(one)
    compiled._named(plain)
    name = plain.__qualname__
    assert compiled._named(plain).__qualname__ == name and name.endswith(compiled.fingerprint(plain)[:16])
    fast = [compiled.fingerprint(compiled.inline(make(one), fastmath=f)) for f in (False, True)]
    assert fast[0] != fast[1]
