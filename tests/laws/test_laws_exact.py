"""Force laws against formulas of the literature, closed-form paths of their states, and
each promise of the contract.
"""

import json
import math
import pickle

import numpy as np
import pytest
from scipy.integrate import quad

from pysindy_nrf import laws
from pysindy_nrf.exceptions import LawError
from pysindy_nrf.laws import ForceLaw, Motion

E = math.e


def at(s=0.0, v=0.0, a=0.0, t=0.0, **covariates):
    """One sample of a motion."""
    return Motion(
        *(np.array([float(x)]) for x in (s, v, a, t)),
        {k: np.array([float(x)]) for k, x in covariates.items()},
    )


# -- forces at points, by hand -------------------------------------------------

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
    (laws.PowerLawDamping(3.0, 1e3), at(v=0.2), 8.0),
    (laws.DisplacementDependentDamping(1e5), at(s=-0.02, v=0.3), 12.0),
    (laws.CoulombFriction(20.0), at(v=1e-12), 20.0),
    (laws.CoulombFriction(20.0), at(v=0.0, s=1.0), 0.0),
    (laws.asymmetric(laws.CoulombFriction)(17.0, 23.0), at(v=0.01), 17.0),
    (laws.asymmetric(laws.CoulombFriction)(17.0, 23.0), at(v=-0.01), -23.0),
    (laws.StribeckFriction(0.02, 10.0, 6.0), at(v=-0.02), -(10.0 + 6.0 / E)),
    (laws.StribeckFriction(0.02, 10.0, 6.0), at(v=0.04), 10.0 + 6.0 / E**2),
    (laws.StribeckFriction(0.02, 10.0, 6.0), at(v=1e30), 10.0),
    (
        laws.RegularizedFriction(0.02, 10.0),
        at(v=-0.02),
        -10.0 * (E**2 - 1) / (E**2 + 1),
    ),
    (laws.PositionDependentFriction(5.0, 2e3), at(s=-2e-3, v=0.1), 9.0),
    (laws.PositionDependentFriction(5.0, 2e3), at(s=2e-3, v=0.0), 0.0),
    (laws.ShiftedFriction(4.0, 7.0), at(s=0.01, v=-0.03), 7.0),
    (laws.ShiftedFriction(4.0, 7.0), at(s=0.01, v=-0.05), -7.0),
    (laws.ShiftedFriction(4.0, 7.0), at(s=0.25, v=-1.0), 0.0),
    (laws.GroundFriction(3.0), at(v=-0.2, vg=0.3), 3.0),
    (laws.GroundFriction(3.0), at(v=-0.2, vg=0.1), -3.0),
    (laws.GroundFriction(3.0, covariate="table"), at(v=-0.2, table=0.2), 0.0),
    (
        laws.CovariateFriction("V", 100.0, 40.0, 10.0),
        at(v=-0.5, V=3.0),
        -100.0 - 120.0 - 15.0,
    ),
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
    (
        laws.DeadZone(1e-3, 0.5, 2e4),
        at(s=1.5e-3),
        0.0,
    ),  # the play reaches from -0.5 to 1.5 mm
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


@pytest.mark.parametrize(
    ("law", "motion", "force"),
    POINTS,
    ids=[f"{k}-{p[0].name}" for k, p in enumerate(POINTS)],
)
def test_force_at_a_point(law, motion, force):
    assert law.force(motion)[0] == pytest.approx(force, rel=1e-13, abs=1e-13)
    double = law.with_values(2.0 * law.values)  # linear in the coefficients
    assert double.force(motion)[0] == pytest.approx(2.0 * force, rel=1e-13, abs=1e-13)


def test_nine_terms_of_the_papers_equation_9():
    v, s = 2.0, 3.0
    expected = [
        2.0,
        3.0,
        4.0,
        6.0,
        9.0,
        8.0,
        12.0,
        18.0,
        27.0,
    ]  # v, s, v^2, v s, s^2, v^3, v^2 s, v s^2, s^3
    assert laws.PowerSeries(3).features(at(s, v))[0].tolist() == expected
    assert [t.symbol for t in laws.PowerSeries(2).terms()] == [
        "c_1_0",
        "c_0_1",
        "c_2_0",
        "c_1_1",
        "c_0_2",
    ]
    units = ["N s/m", "N/m", "N s^2/m^2", "N s/m^2", "N/m^2"]
    assert [t.unit for t in laws.PowerSeries(2).terms()] == units


@pytest.mark.parametrize(
    "degree",
    [
        -1,
        61,
        2.0,
        True,
        "3",
        (1,),
        (1, 2, 3),
        (1, -1),
        (61, 0),
        (0, 61),
        (1, 1.5),
        None,
    ],
)
def test_degree_of_a_power_series_is_a_whole_number_up_to_60(degree):
    with pytest.raises(LawError, match="order=|degree=|k=|q="):
        laws.PowerSeries(degree)


# -- what a law says about itself ----------------------------------------------


def test_only_shapes_of_either_sign_may_be_zero_or_negative():
    assert laws.DeadZone(gap=1.0, centre=-0.5).shape["centre"] == -0.5
    assert laws.StiffnessStep(t0=0.0).shape == {"t0": 0.0} and laws.BoucWen(
        rho=0.0
    ).free_shape == ("beta", "n")
    for value in (0.0, -1e-300):
        with pytest.raises(LawError, match="gap=.* is not positive. Its unit is m"):
            laws.TwoSidedGap(gap=value)
    assert laws.TwoSidedGap(gap=1e-300).shape["gap"] == 1e-300


# -- values, text, plain data --------------------------------------------------


def test_coefficients_by_name_or_in_order():
    assert laws.Duffing(k=3.0).coefficients.tolist() == [3.0, 0.0]
    assert (
        laws.Duffing(k3=3.0).coefficients.tolist() == [0.0, 3.0]
        and laws.Duffing().coefficients is None
    )
    law = laws.Duffing().with_values([1, 2])
    assert law.parameters == {"k": 1.0, "k3": 2.0} and law.values.dtype == float
    assert law.with_values({"k": None, "k3": None}).coefficients is None
    assert law.with_values({"k3": 7}).values.tolist() == [0.0, 7.0]
    assert law.values.tolist() == [1.0, 2.0]
    with pytest.raises(
        LawError, match="Duffing has 2 coefficients, 1 were given. Their order is k, k3"
    ):
        law.with_values([1.0])
    with pytest.raises(LawError, match="Duffing has no coefficient 'c'. It has k, k3"):
        law.with_values({"k": 1.0, "c": 2.0})
    for bad in ("stiff", math.nan, math.inf, [1.0, "2 N"], [[1.0, 2.0], [3.0]]):
        with pytest.raises(LawError, match="is not a finite number|were given"):
            law.with_values(bad)
    with pytest.raises(LawError, match="Duffing has no coefficients yet"):
        laws.Duffing().force(at(1.0))


def test_shape_parameters_by_name():
    law = laws.Iwan(uy=1e-3, F1=1.0, F2=2.0)
    assert law.free_shape == ("ratio",) and law.parameters == {
        "uy": 1e-3,
        "ratio": None,
        "F1": 1.0,
        "F2": 2.0,
    }
    with pytest.raises(LawError, match="Iwan: ratio has no value"):
        law.features(at(1.0))
    with pytest.raises(LawError, match="Iwan: uy, ratio has no value"):
        _ = laws.Iwan().theta
    full = law.with_values(shape={"ratio": 3})
    assert (
        full.theta.tolist() == [1e-3, 3.0]
        and full.free_shape == ()
        and law.shape["ratio"] is None
    )
    assert full.values is law.values or full.values.tolist() == [1.0, 2.0]
    assert full.with_values(shape={"uy": None}).free_shape == ("uy",)
    with pytest.raises(
        LawError, match="Iwan has no shape parameter 'n'. It has uy, ratio"
    ):
        law.with_values(shape={"n": 2.0})
    with pytest.raises(LawError, match="Iwan: ratio='wide' is not a finite number"):
        law.with_values(shape={"ratio": "wide"})


@pytest.mark.parametrize("side", [0, 2, -2, "left", None])
@pytest.mark.parametrize("cls", [laws.OneSidedGap, laws.PreloadedContact])
def test_a_contact_has_two_sides(cls, side):
    with pytest.raises(LawError, match=f"{cls.__name__}: side="):
        cls(side=side)
    assert [cls(side=x).terms()[0].label[:3] for x in (1, -1, np.int64(-1))] == [
        "max",
        "min",
        "min",
    ]


@pytest.mark.parametrize("name", [3, "", "  ", None, ("ag",)])
def test_a_covariate_has_a_name(name):
    for cls in (laws.BaseMotion, laws.CovariateFriction, laws.CovariateDahl):
        with pytest.raises(LawError, match="covariate=.* is not the name of a channel"):
            cls(covariate=name)


def test_an_asymmetric_law_is_its_law_where_both_directions_are_alike_and_survives_copies():
    one = laws.asymmetric(laws.Jenkins)(uy=1e-3, Fyp=30.0, Fym=10.0)
    assert laws.from_dict(one.to_dict()) == one == pickle.loads(pickle.dumps(one))
    s = 2e-3 * np.sin(np.linspace(0.0, 12.0, 400))
    motion = Motion(s, np.gradient(s, 0.01), t=0.01 * np.arange(400))
    plain = laws.Jenkins(uy=1e-3, Fy=1.0).force(motion)
    assert one.force(motion) == pytest.approx(np.where(plain > 0, 30.0, 10.0) * plain)
    assert one.contains(laws.Jenkins()) and not laws.Jenkins().contains(one)
    with pytest.raises(LawError, match="not odd"):
        laws.asymmetric(laws.QuadraticStiffness)
    with pytest.raises(LawError, match="options"):
        laws.asymmetric(laws.PowerSeries)


def test_text():
    assert laws.Duffing(1e5, -2.0).equation(3) == "1e+05 s3 - 2 s3^3"
    assert laws.Duffing().equation() == "k s + k3 s^3"
    assert laws.Duffing(k=1.23456, k3=0.0).equation("2", digits=3) == "1.23 s2 + 0 s2^3"
    assert (
        laws.ConstantForce().equation(1) == "f0"
        and laws.ConstantForce(2.5).equation(1) == "2.5"
    )
    assert (
        laws.ModifiedDahl(sigma=5.0).equation(2)
        == "K0 s2 + C0 v2 + Fd Z2 + f0  (sigma = 5 1/m)"
    )
    assert (
        laws.Iwan(uy=0.25).equation(2)
        == "F1 Jenkins[s2; uy] + F2 Jenkins[s2; ratio uy]  (uy = 0.25 m)"
    )
    assert laws.PowerSeries(0).equation() == "0"
    assert (
        repr(laws.OneSidedGap(0.5, 2e4, -1)) == "OneSidedGap(side=-1, gap=0.5, k=2e+04)"
    )
    assert (
        repr(laws.OneSidedGap()) == "OneSidedGap(side=1)"
        and repr(laws.Duffing(1.0, 2.0)) == "Duffing(k=1, k3=2)"
    )


def test_plain_data_and_back():
    law = laws.OneSidedGap(gap=0.5, k=2e4, side=-1)
    data = law.to_dict()
    assert data == {
        "law": "one_sided_gap",
        "options": {"side": -1},
        "shape": {"gap": 0.5},
        "coefficients": [2e4],
    }
    copy = laws.from_dict(json.loads(json.dumps(data)))
    assert (
        copy == law and hash(copy) == hash(law) and copy.side == -1 and copy is not law
    )
    assert laws.Duffing().to_dict() == {
        "law": "duffing",
        "options": {},
        "shape": {},
        "coefficients": None,
    }
    assert laws.from_dict({"law": "jenkins"}) == laws.Jenkins()
    assert laws.from_dict(
        {"law": "power_series", "options": {"degree": [2, 1]}}
    ) == laws.PowerSeries((2, 1))
    assert laws.OneSidedGap(0.5, 2e4) != law != law.with_values(shape={"gap": 0.6})
    assert laws.AddedMass(1.0) != laws.Inerter(1.0) and laws.Duffing() != "duffing"
    assert len({laws.Duffing(1.0), laws.Duffing(1.0), laws.Duffing(2.0)}) == 2


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (
            {"law": "none of these"},
            (
                "There is no law 'none of these'. Known laws:"
                " .*absolute_quadratic_stiffness, added_mass, "
            ),
        ),
        ({}, "does not describe a law. It needs 'law', 'options'"),
        ({"law": "dahl", "options": {"side": 1}}, "Law 'dahl' cannot be built from"),
        (
            {"law": "dahl", "coefficients": [1.0, 2.0]},
            "Dahl has 1 coefficients, 2 were given",
        ),
    ],
)
def test_data_that_is_no_law_is_named(data, words):
    with pytest.raises(LawError, match=words):
        laws.from_dict(data)


def test_the_registry_is_handed_out_as_a_copy():
    laws.registry().clear()
    assert laws.registry()["dahl"] is laws.Dahl
    with pytest.raises(
        LawError, match="The name 'iwan' is taken by the law Iwan. Choose another name"
    ):
        type("Other", (ForceLaw,), {"name": "iwan"})
    type("Nameless", (laws.Dahl,), {})  # takes no name
    assert laws.registry()["dahl"] is laws.Dahl


# -- features ------------------------------------------------------------------


def test_features_are_columns_of_the_whole_record():
    s = np.array([1.0, 2.0, 3.0])
    motion = Motion(s, v=-s)
    columns = laws.LinkSpringDashpot().features(motion)
    assert (
        columns.tolist() == [[1.0, -1.0], [2.0, -2.0], [3.0, -3.0]]
        and columns.flags.f_contiguous
    )
    assert (
        motion.n_samples == 3
        and dict(motion.covariates) == {}
        and motion.a is None
        and motion.t is None
    )
    assert laws.PowerSeries(0).features(motion).shape == (3, 0)
    with pytest.raises(LawError, match="AddedMass needs the acceleration"):
        laws.AddedMass().features(motion)
    with pytest.raises(LawError, match="DampingDrift needs the time"):
        laws.DampingDrift().features(Motion(s, s, a=s))
    with pytest.raises(LawError, match="BaseMotion needs the covariate 'ag'"):
        laws.BaseMotion().features(motion)
    assert laws.AddedMass(2.0).force(Motion(s, s, a=s)).tolist() == [2.0, 4.0, 6.0]
    assert laws.DampingDrift(2.0).force(Motion(s, s, t=s)).tolist() == [2.0, 8.0, 18.0]


def test_readings_of_faulty_sensors():
    t = np.arange(200) / 100
    y = np.sin(3 * t)
    late = laws.ChannelDelay(tau=0.025).reading(y, dt=0.01)
    assert np.isnan(late[:3]).all() and np.isfinite(late[3:]).all()
    assert np.allclose(late[8:-4], np.sin(3 * (t[8:-4] - 0.025)), atol=1e-9)
    back = laws.ChannelDelay(tau=0.025).corrected(y, dt=0.01)
    assert np.isnan(back[-3:]).all() and np.allclose(
        back[8:-8], np.sin(3 * (t[8:-8] + 0.025)), atol=1e-9
    )
    assert np.allclose(
        laws.ChannelDelay(0.005).corrected(y[:4], 0.01)[:3],
        np.sin(3 * t[:3] + 0.015),
        atol=1e-5,
    )  # few
    assert laws.GainError(-2.0).reading([1, 2], 0.1).tolist() == [
        -1.0,
        -2.0,
    ]  # a wrong sign
    assert laws.GainError(0.25).corrected([5, 10], 0.1).tolist() == [4.0, 8.0]
    assert laws.SensorOffset(0.5).reading([1, 2], 0.1).tolist() == [1.5, 2.5]
    assert laws.SensorOffset(0.5).corrected([1, 2], 0.1).tolist() == [0.5, 1.5]
    for method in (laws.SensorFault().reading, laws.SensorFault().corrected):
        with pytest.raises(NotImplementedError):
            method([1.0], 0.1)


# -- states: one stroke in closed form -----------------------------------------


def stroke(law, start, ds, v0=1.0, v1=1.0, dt=1.0, u=(), s0=0.3):
    """State after a stroke, from the plain function that is compiled for records."""
    z = np.array(start, dtype=float, ndmin=1)
    type(law).advance(z, s0, v0, s0 + ds, v1, dt, np.array(u, dtype=float), law.theta)
    return z


def test_break_away_peaks_after_each_reversal():
    law = laws.BreakAwayFriction(d=2e-3)
    assert stroke(law, 0.0, 1e-3)[0] == pytest.approx(
        math.exp(-0.5), rel=1e-14
    )  # from rest
    assert stroke(law, 0.3, 4e-3)[0] == pytest.approx(0.3 / E**2, rel=1e-14)
    assert stroke(law, 0.3, -4e-3)[0] == pytest.approx(-1.0 / E**2, rel=1e-14)
    assert stroke(law, 0.3, 0.0)[0] == 0.3 and stroke(law, 1e-100, 1e-3)[0] == 1e-100


def test_lag_of_a_covariate_in_one_step():
    lagged = laws.LaggedCovariateFriction(tau=0.5)
    assert stroke(lagged, [0.0, 0.0], 0.1, dt=0.25, u=[3.0]).tolist() == [
        3.0,
        1.0,
    ]  # a fresh one starts at the command
    assert stroke(lagged, [1.0, 1.0], 0.1, dt=0.25, u=[3.0])[0] == pytest.approx(
        3.0 - 2.0 * math.exp(-0.5), rel=1e-14
    )
    assert stroke(lagged, [5.0, 1.0], 0.1, dt=1.0, u=[3.0])[0] == pytest.approx(
        3.0 + 2.0 * math.exp(-2.0), rel=1e-14
    )
    both = laws.CovariateDahl(sigma=20.0, tau=0.5)
    found = stroke(both, [1.0, 1.0, 0.25], -0.1, dt=0.25, u=[3.0])
    expected = [3.0 - 2.0 * math.exp(-0.5), 1.0, -1.0 + 1.25 * math.exp(-2.0)]
    assert found.tolist() == pytest.approx(expected, rel=1e-12)
    assert stroke(
        both, [0.0, 0.0, 0.0], 0.1, dt=0.25, u=[3.0]
    ).tolist() == pytest.approx([3.0, 1.0, 1.0 - math.exp(-2.0)])
    assert stroke(
        both, [0.0, 1.0, 0.5], 0.0, dt=0.5, u=[1.0]
    ).tolist() == pytest.approx([1.0 - 1.0 / E, 1.0, 0.5])


# -- Bouc-Wen in one stroke ----------------------------------------------------


def _length(start, end, rho, n):
    """x of a stroke from y = start to end: the integral of dy / (1 - (sgn y + rho)
    |y|^n).
    """
    edges = [start, 0.0, end] if start * end < 0.0 else [start, end]
    total = 0.0
    for low, high in zip(edges[:-1], edges[1:]):
        c = rho + (1.0 if low + high > 0.0 else -1.0)
        total += quad(
            lambda y, c=c: 1.0 / (1.0 - c * abs(y) ** n),
            low,
            high,
            epsabs=1e-14,
            epsrel=1e-12,
            limit=200,
        )[0]
    return total


@pytest.mark.parametrize("rho", [-2.0, -1.5, -1.0, -0.6, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("n", [1.0, 1.2, 2.0, 2.7, 4.0])
def test_bouc_wen_strokes_have_the_length_they_were_given(n, rho):
    beta = 40.0
    law = laws.BoucWen(beta=beta, rho=rho, n=n)
    top = (
        (1.0 + rho) ** (-1.0 / n) if rho > -1.0 else 3.0
    )  # where a softening loop ends
    for start in (
        -4.0,
        -1.3,
        -0.7 * top,
        -0.2,
        -0.01,
        0.0,
        1e-4,
        0.3 * top,
        0.8 * top,
        1.7 * top,
        8.0,
    ):
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
