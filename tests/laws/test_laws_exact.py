"""Force laws at points by hand, their values and text, strokes in closed form."""

import itertools
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


def instant(s=0.0, v=0.0, a=0.0, t=0.0, **covariates):
    """One sample of a motion."""
    return Motion(
        s=np.array([s], dtype=float),
        v=np.array([v], dtype=float),
        a=np.array([a], dtype=float),
        t=np.array([t], dtype=float),
        covariates={k: np.array([x], dtype=float) for k, x in covariates.items()},
    )


# -- forces at points, by hand -------------------------------------------------

POINTS = [
    (laws.LinearElastic(2e4), instant(s=3e-3), 60.0),
    (laws.LinearViscous(300.0), instant(v=-0.2), -60.0),
    (laws.Duffing(1e3, 1e6), instant(s=0.1), 1100.0),
    (laws.Duffing(1e3, -1e6), instant(s=-0.02), -12.0),
    (laws.QuadraticStiffness(1e4), instant(s=-0.03), 9.0),
    (laws.AbsoluteQuadraticStiffness(1e4), instant(s=-0.03), -9.0),
    (laws.CubicStiffness(1e6), instant(s=-0.02), -8.0),
    (laws.QuinticStiffness(1e9), instant(s=-0.02), -3.2),
    (laws.LinkSpringDashpot(1e3, 20.0), instant(s=0.01, v=-0.3), 4.0),
    (laws.QuadraticDamping(50.0), instant(v=-0.2), -2.0),
    (laws.PowerLawDamping(0.5, 30.0), instant(v=-0.04), -6.0),
    (laws.PowerLawDamping(3.0, 1e3), instant(v=0.2), 8.0),
    (laws.DisplacementDependentDamping(1e5), instant(s=-0.02, v=0.3), 12.0),
    (laws.CoulombFriction(20.0), instant(v=1e-12), 20.0),
    (laws.CoulombFriction(20.0), instant(v=0.0, s=1.0), 0.0),
    (laws.asymmetric(laws.CoulombFriction)(17.0, 23.0), instant(v=0.01), 17.0),
    (laws.asymmetric(laws.CoulombFriction)(17.0, 23.0), instant(v=-0.01), -23.0),
    (laws.StribeckFriction(0.02, 10.0, 6.0), instant(v=-0.02), -(10.0 + 6.0 / E)),
    (laws.StribeckFriction(0.02, 10.0, 6.0), instant(v=0.04), 10.0 + 6.0 / E**2),
    (laws.StribeckFriction(0.02, 10.0, 6.0), instant(v=1e30), 10.0),
    (laws.RegularizedFriction(0.02, 10.0), instant(v=-0.02), -10.0 * math.tanh(1.0)),
    (laws.PositionDependentFriction(5.0, 2e3), instant(s=-2e-3, v=0.1), 9.0),
    (laws.PositionDependentFriction(5.0, 2e3), instant(s=2e-3, v=0.0), 0.0),
    (laws.ShiftedFriction(4.0, 7.0), instant(s=0.01, v=-0.03), 7.0),
    (laws.ShiftedFriction(4.0, 7.0), instant(s=0.01, v=-0.05), -7.0),
    (laws.ShiftedFriction(4.0, 7.0), instant(s=0.25, v=-1.0), 0.0),
    (laws.GroundFriction(3.0), instant(v=-0.2, vg=0.3), 3.0),
    (laws.GroundFriction(3.0), instant(v=-0.2, vg=0.1), -3.0),
    (laws.GroundFriction(3.0, covariate="table"), instant(v=-0.2, table=0.2), 0.0),
    (laws.CovariateFriction("V", 100.0, 40.0, 10.0), instant(v=-0.5, V=3.0), -235.0),
    (laws.OneSidedGap(1e-3, 2e4), instant(s=3e-3), 40.0),
    (laws.OneSidedGap(1e-3, 2e4), instant(s=1e-3), 0.0),
    (laws.OneSidedGap(1e-3, 2e4), instant(s=-3e-3), 0.0),
    (laws.OneSidedGap(1e-3, 2e4, side=-1), instant(s=-3e-3), -40.0),
    (laws.OneSidedGap(1e-3, 2e4, side=-1), instant(s=-1e-3), 0.0),
    (laws.PreloadedContact(1e-3, 2e4), instant(s=3e-3), 60.0),
    (laws.PreloadedContact(1e-3, 2e4), instant(s=-0.5e-3), -10.0),
    (laws.PreloadedContact(1e-3, 2e4), instant(s=-3e-3), -20.0),
    (laws.PreloadedContact(1e-3, 2e4, side=-1), instant(s=-3e-3), -60.0),
    (laws.PreloadedContact(1e-3, 2e4, side=-1), instant(s=0.5e-3), 10.0),
    (laws.PreloadedContact(1e-3, 2e4, side=-1), instant(s=3e-3), 20.0),
    (laws.TwoSidedGap(1e-3, 2e4), instant(s=1e-3), 0.0),
    (laws.TwoSidedGap(1e-3, 2e4), instant(s=1.5e-3), 10.0),
    (laws.TwoSidedGap(1e-3, 2e4), instant(s=-1.5e-3), -10.0),
    # the play reaches from -0.5 to 1.5 mm
    (laws.DeadZone(1e-3, 0.5, 2e4), instant(s=1.5e-3), 0.0),
    (laws.DeadZone(1e-3, 0.5, 2e4), instant(s=2e-3), 10.0),
    (laws.DeadZone(1e-3, 0.5, 2e4), instant(s=-0.5e-3), 0.0),
    (laws.DeadZone(1e-3, 0.5, 2e4), instant(s=-1e-3), -10.0),
    (laws.Bilinear(-2e4), instant(s=1e-3), -20.0),
    (laws.Bilinear(-2e4), instant(s=-1e-3), 0.0),
    (laws.StiffnessStep(2.0, 1e3), instant(s=-0.01, t=2.01), -10.0),
    (laws.StiffnessStep(2.0, 1e3), instant(s=-0.01, t=2.0), 0.0),
    (laws.StiffnessStep(2.0, 1e3), instant(s=-0.01, t=1.0), 0.0),
    (laws.StiffnessDrift(-300.0), instant(s=0.01, t=4.0), -12.0),
    (laws.DampingDrift(-5.0), instant(v=0.3, t=4.0), -6.0),
    (laws.HarmonicForce(50.0, 3.0, 4.0), instant(t=0.0), 3.0),
    (laws.HarmonicForce(50.0, 3.0, 4.0), instant(t=0.005), 4.0),
    (laws.HarmonicForce(50.0, 3.0, 4.0), instant(t=1 / 400), 7.0 / math.sqrt(2.0)),
    (laws.ConstantForce(-3.2), instant(s=7.0), -3.2),
    (laws.BaseMotion(12.5), instant(ag=-2.0), -25.0),
    (laws.AddedMass(1.5), instant(a=-2.0), -3.0),
    (laws.Inerter(40.0), instant(a=0.5), 20.0),
    (laws.ChannelDelay(0.002), instant(s=9.0, v=3.0), -0.006),
    (laws.GainError(0.2), instant(s=9.0), 1.8),
    (laws.SensorOffset(0.5), instant(s=9.0), 0.5),
    (laws.PowerSeries(1, [100.0, 1e5]), instant(s=2e-3, v=0.5), 250.0),
    (
        laws.PowerSeries(2, [0, 0, 3.0, 5.0, 7.0]),
        instant(s=2.0, v=-1.0),
        3.0 - 10.0 + 28.0,
    ),
    (laws.PowerSeries((2, 1), {"c_2_1": 10.0}), instant(s=3.0, v=-2.0), 120.0),
]


@pytest.mark.parametrize(
    ("law", "motion", "force"),
    POINTS,
    ids=[f"{number}-{law.name}" for number, (law, _, _) in enumerate(POINTS)],
)
def test_force_at_a_point(law, motion, force):
    assert law.force(motion)[0] == pytest.approx(force, rel=1e-13, abs=1e-13)
    double = law.with_values(2.0 * law.values)  # linear in the coefficients
    assert double.force(motion)[0] == pytest.approx(2.0 * force, rel=1e-13, abs=1e-13)


def test_nine_terms_of_the_papers_equation_9():
    columns = laws.PowerSeries(3).features(instant(v=2.0, s=3.0))[0]
    # v, s, v^2, v s, s^2, v^3, v^2 s, v s^2, s^3
    assert columns.tolist() == [2.0, 3.0, 4.0, 6.0, 9.0, 8.0, 12.0, 18.0, 27.0]

    terms = laws.PowerSeries(2).terms()
    symbols = [term.symbol for term in terms]
    units = [term.unit for term in terms]
    assert symbols == ["c_1_0", "c_0_1", "c_2_0", "c_1_1", "c_0_2"]
    assert units == ["N s/m", "N/m", "N s^2/m^2", "N s/m^2", "N/m^2"]


NO_DEGREES = [-1, 61, 2.0, True, "3", None]
NO_BOXES = [(1,), (1, 2, 3), (1, -1), (61, 0), (0, 61), (1, 1.5)]


@pytest.mark.parametrize("degree", NO_DEGREES + NO_BOXES)
def test_degree_of_a_power_series_is_a_whole_number_up_to_60(degree):
    with pytest.raises(LawError, match="order=|degree=|k=|q="):
        laws.PowerSeries(degree)


# -- values --------------------------------------------------------------------


def test_only_shapes_of_either_sign_may_be_zero_or_negative():
    assert laws.DeadZone(gap=1.0, centre=-0.5).shape["centre"] == -0.5
    assert laws.StiffnessStep(t0=0.0).shape == {"t0": 0.0}
    assert laws.BoucWen(rho=0.0).free_shape == ("beta", "n")
    assert laws.TwoSidedGap(gap=1e-300).shape["gap"] == 1e-300
    for value in (0.0, -1e-300):
        with pytest.raises(LawError, match="gap=.* is not positive"):
            laws.TwoSidedGap(gap=value)


def test_coefficients_by_name_or_in_order():
    assert laws.Duffing(k=3.0).coefficients.tolist() == [3.0, 0.0]
    assert laws.Duffing(k3=3.0).coefficients.tolist() == [0.0, 3.0]
    assert laws.Duffing().coefficients is None
    with pytest.raises(LawError, match="has no coefficients yet"):
        laws.Duffing().force(instant(1.0))

    law = laws.Duffing().with_values([1, 2])
    assert law.parameters == {"k": 1.0, "k3": 2.0}
    assert law.values.dtype == float
    assert law.with_values({"k": None, "k3": None}).coefficients is None
    assert law.with_values({"k3": 7}).values.tolist() == [0.0, 7.0]
    assert law.values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([1.0], "has 2 coefficients, 1"),
        ([[1.0, 2.0], [3.0]], "not a finite number"),
        ({"k": 1.0, "c": 2.0}, "no coefficient 'c'"),
        ([1.0, "2 N"], "not a finite number"),
        (math.nan, "not a finite number"),
        (math.inf, "not a finite number"),
        ("stiff", "not a finite number"),
    ],
)
def test_wrong_coefficients_are_named(values, message):
    with pytest.raises(LawError, match=message):
        laws.Duffing().with_values(values)


def test_shape_parameters_by_name():
    law = laws.Iwan(uy=1e-3, F1=1.0, F2=2.0)
    assert law.free_shape == ("ratio",)
    assert law.parameters == {"uy": 1e-3, "ratio": None, "F1": 1.0, "F2": 2.0}
    with pytest.raises(LawError, match="Iwan: ratio has no value"):
        law.features(instant(1.0))
    with pytest.raises(LawError, match="Iwan: uy, ratio has no"):
        _ = laws.Iwan().theta

    full = law.with_values(shape={"ratio": 3})
    assert full.theta.tolist() == [1e-3, 3.0]
    assert full.values.tolist() == [1.0, 2.0]
    assert full.free_shape == ()
    assert full.with_values(shape={"uy": None}).free_shape == ("uy",)
    assert law.shape["ratio"] is None


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ({"n": 2.0}, "no shape parameter 'n'"),
        ({"ratio": "wide"}, "ratio='wide' is not"),
    ],
)
def test_wrong_shape_parameters_are_named(shape, message):
    with pytest.raises(LawError, match=message):
        laws.Iwan().with_values(shape=shape)


@pytest.mark.parametrize("side", [0, 2, -2, "left", None])
@pytest.mark.parametrize("cls", [laws.OneSidedGap, laws.PreloadedContact])
def test_a_contact_has_two_sides(cls, side):
    with pytest.raises(LawError, match=f"{cls.__name__}: side="):
        cls(side=side)
    assert cls(side=1).terms()[0].label.startswith("max")
    assert cls(side=-1).terms()[0].label.startswith("min")
    assert cls(side=np.int64(-1)) == cls(side=-1)


@pytest.mark.parametrize("name", [3, "", "  ", None, ("ag",)])
def test_a_covariate_has_a_name(name):
    for cls in (laws.BaseMotion, laws.CovariateFriction, laws.CovariateDahl):
        with pytest.raises(LawError, match="covariate="):
            cls(covariate=name)


def test_an_asymmetric_law_has_a_strength_in_each_direction():
    asymmetric = laws.asymmetric(laws.Jenkins)(uy=1e-3, Fyp=30.0, Fym=10.0)
    s = 2e-3 * np.sin(np.linspace(0.0, 12.0, 400))
    motion = Motion(s, np.gradient(s, 0.01), t=0.01 * np.arange(400))
    force = asymmetric.force(motion)
    symmetric = laws.Jenkins(uy=1e-3, Fy=1.0).force(motion)
    strength = np.where(symmetric > 0, 30.0, 10.0)
    assert force == pytest.approx(strength * symmetric)


def test_an_asymmetric_law_contains_its_law_and_survives_copies():
    asymmetric = laws.asymmetric(laws.Jenkins)(uy=1e-3, Fyp=30.0, Fym=10.0)
    assert laws.asymmetric(laws.Jenkins) is type(asymmetric)
    assert laws.from_dict(asymmetric.to_dict()) == asymmetric
    assert pickle.loads(pickle.dumps(asymmetric)) == asymmetric
    assert asymmetric.contains(laws.Jenkins())
    assert not laws.Jenkins().contains(asymmetric)


def test_only_odd_laws_without_options_become_asymmetric():
    with pytest.raises(LawError, match="not odd"):
        laws.asymmetric(laws.QuadraticStiffness)
    with pytest.raises(LawError, match="options"):
        laws.asymmetric(laws.PowerSeries)


# -- text and plain data -------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "index", "text"),
    [
        (laws.Duffing(1e5, -2.0), 3, "1e+05 s3 - 2 s3^3"),
        (laws.Duffing(), "", "k s + k3 s^3"),
        (laws.ConstantForce(), 1, "f0"),
        (laws.ConstantForce(2.5), 1, "2.5"),
        (
            laws.ModifiedDahl(sigma=5.0),
            2,
            "K0 s2 + C0 v2 + Fd Z2 + f0  (sigma = 5 1/m)",
        ),
        (laws.Jenkins(uy=0.25), 2, "Fy Jenkins[s2]  (uy = 0.25 m)"),
        (laws.PowerSeries(0), "", "0"),
        (laws.PowerSeries(2, [0, 1.0, 0, 0, 2.0]), 1, "1 s1 + 2 s1^2"),
    ],
    ids=repr,
)
def test_equation_of_a_law(law, index, text):
    assert law.equation(index) == text


def test_digits_of_an_equation():
    law = laws.Duffing(k=1.23456, k3=0.0)
    assert law.equation("2", digits=3) == "1.23 s2 + 0 s2^3"


@pytest.mark.parametrize(
    ("law", "text"),
    [
        (laws.OneSidedGap(0.5, 2e4, -1), "OneSidedGap(side=-1, gap=0.5, k=2e+04)"),
        (laws.OneSidedGap(), "OneSidedGap(side=1)"),
        (laws.Duffing(1.0, 2.0), "Duffing(k=1, k3=2)"),
    ],
)
def test_a_law_prints_the_call_that_makes_it(law, text):
    assert repr(law) == text


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
    assert copy == law
    assert hash(copy) == hash(law)
    assert copy is not law


def test_plain_data_may_leave_out_what_is_not_set():
    assert laws.Duffing().to_dict()["coefficients"] is None
    assert laws.from_dict({"law": "jenkins"}) == laws.Jenkins()
    box = laws.from_dict({"law": "power_series", "options": {"degree": [2, 1]}})
    assert box == laws.PowerSeries((2, 1))


def test_laws_are_equal_if_class_options_and_values_are():
    law = laws.OneSidedGap(gap=0.5, k=2e4, side=-1)
    assert law != laws.OneSidedGap(0.5, 2e4)
    assert law != law.with_values(shape={"gap": 0.6})
    assert laws.AddedMass(1.0) != laws.Inerter(1.0)
    assert laws.Duffing() != "duffing"
    assert len({laws.Duffing(1.0), laws.Duffing(1.0), laws.Duffing(2.0)}) == 2


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"law": "none of these"}, "no law 'none of these'"),
        ({"law": ["dahl"]}, "There is no law"),
        ({}, "does not describe a law"),
        ({"law": "dahl", "options": {"side": 1}}, "'dahl' cannot be built"),
        ({"law": "dahl", "coefficients": [1.0, 2.0]}, "has 1 coefficients, 2"),
    ],
)
def test_data_that_is_no_law_is_named(data, message):
    with pytest.raises(LawError, match=message):
        laws.from_dict(data)


def test_the_registry_is_a_copy_with_unique_names():
    laws.registry().clear()
    assert laws.registry()["dahl"] is laws.Dahl
    with pytest.raises(LawError, match="'iwan' is taken"):
        type("Other", (ForceLaw,), {"name": "iwan"})
    type("Nameless", (laws.Dahl,), {})  # takes no name
    assert laws.registry()["dahl"] is laws.Dahl


# -- features ------------------------------------------------------------------


def test_features_are_columns_of_the_whole_record():
    s = np.array([1.0, 2.0, 3.0])
    columns = laws.LinkSpringDashpot().features(Motion(s, v=-s))
    assert columns.tolist() == [[1.0, -1.0], [2.0, -2.0], [3.0, -3.0]]
    assert columns.flags.f_contiguous
    assert laws.PowerSeries(0).features(Motion(s, v=-s)).shape == (3, 0)


@pytest.mark.parametrize(
    ("law", "missing"),
    [
        (laws.AddedMass(), "needs the acceleration"),
        (laws.DampingDrift(), "needs the time"),
        (laws.BaseMotion(), "needs the covariate 'ag'"),
    ],
)
def test_a_channel_that_a_law_lacks_is_named(law, missing):
    s = np.array([1.0, 2.0, 3.0])
    with pytest.raises(LawError, match=missing):
        law.features(Motion(s, v=-s))


def test_a_law_reads_the_channels_that_are_given():
    s = np.array([1.0, 2.0, 3.0])
    assert laws.AddedMass(2.0).force(Motion(s, s, a=s)).tolist() == [2.0, 4.0, 6.0]
    assert laws.DampingDrift(2.0).force(Motion(s, s, t=s)).tolist() == [2.0, 8.0, 18.0]


# -- readings of faulty sensors ------------------------------------------------


def test_a_delayed_channel_and_back():
    t = np.arange(200) / 100
    y = np.sin(3 * t)
    delay = laws.ChannelDelay(tau=0.025)
    late = delay.reading(y, dt=0.01)
    assert np.isnan(late[:3]).all()
    assert np.isfinite(late[3:]).all()
    np.testing.assert_allclose(late[8:-4], np.sin(3 * (t[8:-4] - 0.025)), atol=1e-9)

    early = delay.corrected(y, dt=0.01)
    assert np.isnan(early[-3:]).all()
    np.testing.assert_allclose(early[8:-8], np.sin(3 * (t[8:-8] + 0.025)), atol=1e-9)


def test_a_delay_of_a_few_samples():
    t = np.arange(4) / 100
    early = laws.ChannelDelay(0.005).corrected(np.sin(3 * t), 0.01)
    np.testing.assert_allclose(early[:3], np.sin(3 * t[:3] + 0.015), atol=1e-5)


def test_gain_and_offset_of_a_channel():
    wrong_sign = laws.GainError(-2.0)
    assert wrong_sign.reading([1, 2], 0.1).tolist() == [-1.0, -2.0]
    assert laws.GainError(0.25).corrected([5, 10], 0.1).tolist() == [4.0, 8.0]
    assert laws.SensorOffset(0.5).reading([1, 2], 0.1).tolist() == [1.5, 2.5]
    assert laws.SensorOffset(0.5).corrected([1, 2], 0.1).tolist() == [0.5, 1.5]


def test_a_fault_must_write_its_reading():
    with pytest.raises(NotImplementedError):
        laws.SensorFault().reading([1.0], 0.1)
    with pytest.raises(NotImplementedError):
        laws.SensorFault().corrected([1.0], 0.1)


# -- states: one stroke in closed form -----------------------------------------


def stroke(law, start, ds, *, dt=1.0, u=(), s0=0.3):
    """State after a stroke, from the plain function that is compiled for records."""
    z = np.array(start, dtype=float, ndmin=1)
    covariates = np.array(u, dtype=float)
    type(law).advance(z, s0, 1.0, s0 + ds, 1.0, dt, covariates, law.theta)
    return z


def test_break_away_peaks_after_each_reversal():
    law = laws.BreakAwayFriction(d=2e-3)
    from_rest = stroke(law, 0.0, 1e-3)[0]
    onward = stroke(law, 0.3, 4e-3)[0]
    reversed_ = stroke(law, 0.3, -4e-3)[0]
    assert from_rest == pytest.approx(math.exp(-0.5), rel=1e-14)
    assert onward == pytest.approx(0.3 / E**2, rel=1e-14)
    assert reversed_ == pytest.approx(-1.0 / E**2, rel=1e-14)
    assert stroke(law, 0.3, 0.0)[0] == 0.3
    assert stroke(law, 1e-100, 1e-3)[0] == 1e-100


def test_lag_of_a_covariate_in_one_step():
    law = laws.LaggedCovariateFriction(tau=0.5)
    fresh = stroke(law, [0.0, 0.0], 0.1, dt=0.25, u=[3.0])
    rising = stroke(law, [1.0, 1.0], 0.1, dt=0.25, u=[3.0])
    falling = stroke(law, [5.0, 1.0], 0.1, dt=1.0, u=[3.0])
    assert fresh.tolist() == [3.0, 1.0]  # it starts at the command
    assert rising[0] == pytest.approx(3.0 - 2.0 * math.exp(-0.5), rel=1e-14)
    assert falling[0] == pytest.approx(3.0 + 2.0 * math.exp(-2.0), rel=1e-14)


def test_lag_and_hysteresis_in_one_step():
    law = laws.CovariateDahl(sigma=20.0, tau=0.5)
    moving = stroke(law, [1.0, 1.0, 0.25], -0.1, dt=0.25, u=[3.0])
    fresh = stroke(law, [0.0, 0.0, 0.0], 0.1, dt=0.25, u=[3.0])
    resting = stroke(law, [0.0, 1.0, 0.5], 0.0, dt=0.5, u=[1.0])
    lagged = 3.0 - 2.0 * math.exp(-0.5)
    branch = -1.0 + 1.25 * math.exp(-2.0)
    assert moving.tolist() == pytest.approx([lagged, 1.0, branch], rel=1e-12)
    assert fresh.tolist() == pytest.approx([3.0, 1.0, 1.0 - math.exp(-2.0)])
    assert resting.tolist() == pytest.approx([1.0 - 1.0 / E, 1.0, 0.5])


# -- Bouc-Wen in one stroke ----------------------------------------------------


def _length(start, end, rho, n):
    """x of a stroke from y = start to end: the integral of dx / dy.

    dx / dy is 1 / (1 - (sgn y + rho) |y|^n).
    """
    edges = [start, 0.0, end] if start * end < 0.0 else [start, end]
    total = 0.0
    for low, high in zip(edges[:-1], edges[1:]):
        c = rho + (1.0 if low + high > 0.0 else -1.0)

        def length_by_state(y, c=c):
            return 1.0 / (1.0 - c * abs(y) ** n)

        integral, _ = quad(
            length_by_state, low, high, epsabs=1e-14, epsrel=1e-12, limit=200
        )
        total += integral
    return total


STARTS = [-4.0, -1.3, -0.2, -0.01, 0.0, 1e-4, 8.0]
STARTS_BY_LIMIT = [-0.7, 0.3, 0.8, 1.7]  # shares of the state where a loop ends


@pytest.mark.parametrize("rho", [-2.0, -1.5, -1.0, -0.6, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("n", [1.0, 1.2, 2.0, 2.7, 4.0])
def test_bouc_wen_strokes_have_their_length(n, rho):
    softens = rho > -1.0
    limit = (1.0 + rho) ** (-1.0 / n) if softens else 3.0
    starts = [*STARTS, *(share * limit for share in STARTS_BY_LIMIT)]
    law = laws.BoucWen(beta=40.0, rho=rho, n=n)
    for start, x in itertools.product(starts, (1e-3, 0.07, 0.4, 1.1)):
        end = stroke(law, start, x / 40.0, s0=0.0)[0]
        assert stroke(law, -start, -x / 40.0, s0=0.0)[0] == -end  # odd
        if abs(end) >= 1e3:
            continue  # hardens without a limit

        slope = abs(1.0 - (rho + math.copysign(1.0, end)) * abs(end) ** n)
        if slope < 1e-6:
            assert end == pytest.approx(limit, rel=1e-6)
            continue
        gap = abs(_length(start, end, rho, n) - x)
        if softens and abs(start) <= 1.0:  # inside the loop
            assert gap * slope < 1e-6, (start, x)
        else:
            size = max(abs(end), abs(start))
            assert gap < 2e-5 * max(x, size / slope), (start, x)
