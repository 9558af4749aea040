"""Every law keeps the one contract; each check refuses a law that breaks it."""

import numpy as np
import pytest

from pysindy_nrf import laws
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.laws import Shape, Term, contract

VARIANTS = [
    laws.OneSidedGap(side=-1),
    laws.PreloadedContact(side=-1),
    laws.PowerSeries(5),
    laws.PowerSeries((2, 1)),
    laws.CovariateFriction("temperature"),
    laws.HiddenOscillator(covariate="ag"),
]
REGISTERED = [laws.registry()[name]() for name in sorted(laws.registry())]
# sizes of their atoms are options, which no change of units reaches
OF_FIXED_SIZE = (laws.GeneralCurve, laws.GeneralHysteresis)


def name_of_check(check):
    return check.__name__.removeprefix("check_")


@pytest.mark.parametrize("check", contract.CHECKS, ids=name_of_check)
@pytest.mark.parametrize("law", REGISTERED + VARIANTS, ids=repr)
def test_every_law_keeps_the_contract(law, check):
    if isinstance(law, OF_FIXED_SIZE) and check is contract.check_units:
        pytest.skip("the sizes of its atoms are options")
    rng = np.random.default_rng(0)
    check(contract.random_values(law, rng), rng)


def test_a_sound_law_passes():
    contract.check_law(laws.GroundFriction())
    contract.check_law(laws.GroundFriction(), random_state=5)
    with pytest.raises(NRFError, match="random_state='x'"):
        contract.check_law(laws.GroundFriction(), random_state="x")


# -- laws that break it --------------------------------------------------------


def broken(parent, **changes):
    """A law that differs from its parent in what is given, with values."""
    name = f"Broken{parent.__name__}"
    cls = type(name, (parent,), {"__doc__": "Documented.", **changes})
    return contract.random_values(cls(), np.random.default_rng(3))


def kernel_of(function):
    """A kernel of one term, from a function of drift and rate."""

    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = function(s, v)

    return staticmethod(kernel)


def features_by(change):
    """Features changed by a function of the motion and of those of the law."""

    def features(self, motion, state=None):
        return change(motion, super(type(self), self).features(motion, state))

    return features


def features_that_spoil(channel):
    """Features whose computation changes a channel of the motion."""

    def spoil(motion, columns):
        if channel == "u":
            motion.covariates["voltage"][-1] += 1e-9
        else:
            getattr(motion, channel)[-1] += 1e-9
        return columns

    return features_by(spoil)


def features_without_state(self, motion, state=None):
    return super(type(self), self).features(motion)


def never(self, other):
    return False


def terms_are(*terms):
    return lambda self: terms


DRIFT = Term("k", "s", "N/m")
CUBED = Term("k3", "s^3", "N/m^3")
TOO_SOFT = {laws.LinearElastic: lambda law: laws.Duffing(0.98 * law.values[0], 0.0)}
BREAKS = []


def refuses(check, parent, message, **changes):
    """Note that a check refuses a law that differs from its parent."""
    BREAKS.append(
        pytest.param(check, parent, message, changes, id=f"{check}: {message}")
    )


@features_by
def both_twice(motion, columns):
    return np.hstack([columns, columns])


@features_by
def single(motion, columns):
    return columns.astype(np.float32)


@features_by
def with_nan(motion, columns):
    return np.where(columns > 0, np.nan, columns)


refuses("features", laws.LinearViscous, "have shape", features=both_twice)
refuses("features", laws.LinearViscous, "are float32", features=single)
refuses("features", laws.LinearViscous, "not finite", features=with_nan)
for channel in "svatu":
    spoiled = features_that_spoil(channel)
    refuses("features", laws.CovariateFriction, "changes the motion", features=spoiled)


@kernel_of
def power(s, v):
    return s**21


@kernel_of
def root(s, v):
    return np.sqrt(v)


@kernel_of
def infinite(s, v):
    return np.where(v > 1e20, np.inf, v)


refuses("large_arguments", laws.LinearViscous, "overflow", kernel=power)
refuses("large_arguments", laws.LinearViscous, "invalid", kernel=root)
refuses("large_arguments", laws.LinearViscous, "not finite", kernel=infinite)


@kernel_of
def by_dimension(s, v):
    return v if np.ndim(v) else 1.001 * v


refuses("single_samples", laws.LinearViscous, "on floats differs", kernel=by_dimension)

refuses("standstill", laws.ConstantForce, "is not 0.5", at_rest=0.5)
refuses("standstill", laws.LinearElastic, "the force vanishes", at_rest=None)


@kernel_of
def nearly_odd(s, v):
    return v + 1e-6 * v * v


refuses("symmetry", laws.LinearViscous, "'even', found 'odd'", symmetry="even")
refuses("symmetry", laws.LinearViscous, "'odd', found 'none'", kernel=nearly_odd)


@features_by
def by_length(motion, columns):
    return columns + 1e-6 * motion.n_samples


@features_by
def doubled(motion, columns):
    return 2.0 * columns


refuses("records", laws.LinearViscous, "the first block differs", features=by_length)
refuses(
    "records", laws.Jenkins, "the last block differs", features=features_without_state
)
refuses("records", laws.LinearViscous, "start from a fresh state", features=doubled)


@kernel_of
def slightly_damped(s, v):
    return s + 1e-4 * v


@kernel_of
def slightly_driven(s, v):
    return s - 1e-4 * v


refuses("energy", laws.LinearElastic, "takes or gives energy", kernel=slightly_damped)
refuses("energy", laws.LinearViscous, "passive, but gives", kernel=slightly_driven)


@kernel_of
def of_drift(s, v):
    return s


refuses("variable", laws.CoulombFriction, "does not follow 's'", variable="s")
refuses("variable", laws.DisplacementDependentDamping, "more than 's'", variable="s")
refuses("variable", laws.Inerter, "does not follow 'a'", kernel=of_drift)
refuses("variable", laws.Dahl, "variable is 'z'", variable="z")

refuses("saturation", laws.BoucWen, "does not saturate", saturates_at="n")
refuses("saturation", laws.Dahl, "is no shape parameter", saturates_at="uy")

low_bound = (Shape("n", "1", 0.15, 4.0, friction_below=0.1),)
refuses("signs", laws.Duffing, "signs are stated", nonnegative=("k2",))
refuses("signs", laws.Duffing, "signs are stated", nonnegative=("k", "k"))
refuses("signs", laws.PowerLawDamping, "friction_below of n", shapes=low_bound)

refuses("special_cases", laws.Duffing, "not LinearElastic", special_cases=TOO_SOFT)
refuses("special_cases", laws.StribeckFriction, "does not contain", contains=never)

wrong_damping = (Term("c", "v", "N/m"),)
wrong_power = (Term("cn", "sgn(v) |v|^n", "N s/m"),)
wrong_shape = (Shape("sigma", "1/s", 0.03, 3000.0, "1/s"),)
wrong_mass = terms_are(Term("m", "ag", "N"))
refuses("units", laws.LinearViscous, "c has not", columns=wrong_damping)
refuses("units", laws.PowerLawDamping, "cn has not", columns=wrong_power)
refuses("units", laws.Dahl, "Fd has not", shapes=wrong_shape)
refuses("units", laws.BaseMotion, "m has not", terms=wrong_mass)

same_symbols = terms_are(DRIFT, CUBED._replace(symbol="k"))
same_labels = (DRIFT, CUBED._replace(label="s"))
name_of_shape = terms_are(Term("sigma", "Z", "N"))
refuses("text", laws.Duffing, "has no documentation", __doc__=None)
refuses("text", laws.Duffing, "name or family", family="")
refuses("text", laws.Duffing, "acts_at is", acts_at=("roof",))
refuses("text", laws.Duffing, "symbols .* are not distinct", terms=same_symbols)
refuses("text", laws.Duffing, "labels .* are not distinct", columns=same_labels)
refuses("text", laws.Dahl, "share a name", terms=name_of_shape)


@pytest.mark.parametrize(("check", "parent", "message", "changes"), BREAKS)
def test_a_law_that_breaks_the_contract_is_refused(check, parent, message, changes):
    law = broken(parent, **changes)
    with pytest.raises((AssertionError, FloatingPointError), match=message):
        getattr(contract, f"check_{check}")(law, np.random.default_rng(3))


def test_rounding_breaks_no_contract():
    rng = np.random.default_rng(3)

    @kernel_of
    def almost_odd(s, v):
        return v + 1e-13 * v * v

    @kernel_of
    def almost_elastic(s, v):
        return s + 1e-8 * v

    contract.check_symmetry(broken(laws.LinearViscous, kernel=almost_odd), rng)
    contract.check_energy(broken(laws.LinearElastic, kernel=almost_elastic), rng)
    contract.check_standstill(broken(laws.ConstantForce, at_rest=1.0), rng)


# -- special cases -------------------------------------------------------------


def test_a_law_contains_its_special_cases_by_their_class():
    friction = laws.CoulombFriction()
    controlled = laws.CovariateFriction("T")
    assert controlled.contains(friction)
    assert not friction.contains(controlled)
    assert laws.DeadZone().contains(laws.OneSidedGap(side=-1))
    assert not laws.DeadZone().contains(laws.CubicStiffness())


def test_a_law_contains_what_its_special_cases_contain():
    assert laws.DeadZone().contains(laws.Bilinear())
    assert laws.asymmetric(laws.BacklashFriction)().contains(laws.Jenkins())
    assert not laws.Bilinear().contains(laws.DeadZone())


def test_a_spring_contains_a_constant_which_a_damper_does_not():
    assert laws.Duffing().contains(laws.ConstantForce())
    assert not laws.QuadraticDamping().contains(laws.ConstantForce())
