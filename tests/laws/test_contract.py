"""Every law keeps the one contract; each check of the contract refuses a law that
breaks it.
"""

import numpy as np
import pytest

from pysindy_nrf import laws
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.laws import Shape, Term, contract

VARIANTS = [
    *(cls() for _, cls in sorted(laws.registry().items())),
    laws.OneSidedGap(side=-1),
    laws.PreloadedContact(side=-1),
    laws.PowerSeries(5),
    laws.PowerSeries((2, 1)),
    laws.CovariateFriction("temperature"),
    laws.HiddenOscillator(covariate="ag"),
]


@pytest.mark.parametrize(
    "check", contract.CHECKS, ids=lambda check: check.__name__.removeprefix("check_")
)
@pytest.mark.parametrize("law", VARIANTS, ids=repr)
def test_every_law_keeps_the_contract(law, check):
    rng = np.random.default_rng(0)
    check(contract.random_values(law, rng), rng)


def test_a_sound_law_passes():
    assert contract.check_law(laws.GroundFriction()) is None
    assert contract.check_law(laws.GroundFriction(), random_state=5) is None
    with pytest.raises(NRFError, match="random_state='x' is no seed"):
        contract.check_law(laws.GroundFriction(), random_state="x")


def broken(parent, **changes):
    """A law that differs from its parent in what is given, with values."""
    law = type(
        f"Broken{parent.__name__}", (parent,), {"__doc__": "Documented.", **changes}
    )()
    return contract.random_values(law, np.random.default_rng(3))


def plain(function):
    """A kernel of one term."""

    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = function(s, v)

    return staticmethod(kernel)


def features(change):
    """Features that differ from those of the law."""

    def changed(self, motion, state=None):
        return change(motion, super(type(self), self).features(motion, state))

    return changed


def spoils(channel):
    def change(motion, columns):
        array = (
            motion.covariates["voltage"] if channel == "u" else getattr(motion, channel)
        )
        array[-1] += 1e-9
        return columns

    return features(change)


def forgets_state(self, motion, state=None):
    return super(type(self), self).features(motion)


TWO = Term("k", "s", "N/m"), Term("k3", "s^3", "N/m^3")
BREAKS = {
    "features": [
        (
            laws.LinearViscous,
            {"features": features(lambda m, x: np.hstack([x, x]))},
            "have shape",
        ),
        (
            laws.LinearViscous,
            {"features": features(lambda m, x: x.astype(np.float32))},
            "are float32",
        ),
        (
            laws.LinearViscous,
            {"features": features(lambda m, x: np.where(x > 0, np.nan, x))},
            "not finite",
        ),
        *(
            (laws.CovariateFriction, {"features": spoils(x)}, "changes the motion")
            for x in "svatu"
        ),
    ],
    "large_arguments": [
        (laws.LinearViscous, {"kernel": plain(lambda s, v: s**21)}, "overflow"),
        (laws.LinearViscous, {"kernel": plain(lambda s, v: np.sqrt(v))}, "invalid"),
        (
            laws.LinearViscous,
            {"kernel": plain(lambda s, v: np.where(v > 1e20, np.inf, v))},
            "not finite",
        ),
    ],
    "single_samples": [
        (
            laws.LinearViscous,
            {"kernel": plain(lambda s, v: v if np.ndim(v) else 1.001 * v)},
            "on floats differs",
        ),
    ],
    "standstill": [
        (laws.ConstantForce, {"at_rest": 0.5}, "is not 0.5"),
        (laws.LinearElastic, {"at_rest": None}, "the force vanishes"),
    ],
    "symmetry": [
        (laws.LinearViscous, {"symmetry": "even"}, "'even', found 'odd'"),
        (
            laws.LinearViscous,
            {"kernel": plain(lambda s, v: v + 1e-6 * v * v)},
            "'odd', found 'none'",
        ),
    ],
    "records": [
        (
            laws.LinearViscous,
            {"features": features(lambda m, x: x + 1e-6 * m.n_samples)},
            "the first block differs",
        ),
        (laws.Jenkins, {"features": forgets_state}, "the last block differs"),
        (
            laws.LinearViscous,
            {"features": features(lambda m, x: 2.0 * x)},
            "does not start from a fresh state",
        ),
    ],
    "energy": [
        (
            laws.LinearElastic,
            {"kernel": plain(lambda s, v: s + 1e-4 * v)},
            "takes or gives energy",
        ),
        (
            laws.LinearViscous,
            {"kernel": plain(lambda s, v: s - 1e-4 * v)},
            "passive, but gives energy",
        ),
    ],
    "variable": [
        (laws.CoulombFriction, {"variable": "s"}, "does not follow 's'"),
        (laws.DisplacementDependentDamping, {"variable": "s"}, "follows more than 's'"),
        (laws.Inerter, {"kernel": plain(lambda s, v: s)}, "does not follow 'a'"),
        (laws.Dahl, {"variable": "z"}, "variable is 'z'"),
    ],
    "saturation": [
        (laws.BoucWen, {"saturates_at": "n"}, "does not saturate"),
        (laws.Dahl, {"saturates_at": "uy"}, "is no shape parameter"),
    ],
    "signs": [
        (laws.Duffing, {"nonnegative": ("k2",)}, "signs are stated"),
        (laws.Duffing, {"nonnegative": ("k", "k")}, "signs are stated"),
    ],
    "special_cases": [
        (
            laws.Duffing,
            {
                "special_cases": {
                    laws.LinearElastic: lambda c: laws.Duffing(0.98 * c.values[0], 0.0)
                }
            },
            "is not LinearElastic",
        ),
        (laws.StribeckFriction, {"contains": lambda *_: False}, "does not contain"),
    ],
    "units": [
        (
            laws.LinearViscous,
            {"columns": (Term("c", "v", "N/m"),)},
            "c has not the unit N/m",
        ),
        (
            laws.BaseMotion,
            {"terms": lambda self: (Term("m", "ag", "N"),)},
            "m has not the unit",
        ),
        (
            laws.PowerLawDamping,
            {"columns": (Term("cn", "sgn(v) |v|^n", "N s/m"),)},
            "cn has not the unit",
        ),
        (
            laws.Dahl,
            {"shapes": (Shape("sigma", "1/s", 0.03, 3000.0, "1/s"),)},
            "Fd has not the unit",
        ),
    ],
    "text": [
        (laws.Duffing, {"__doc__": None}, "BrokenDuffing has no documentation"),
        (laws.Duffing, {"family": ""}, "name or family is missing"),
        (laws.Duffing, {"acts_at": ("roof",)}, "acts_at is"),
        (
            laws.Duffing,
            {"terms": lambda self: (TWO[0], TWO[1]._replace(symbol="k"))},
            "symbols .* are not distinct",
        ),
        (
            laws.Duffing,
            {"columns": (TWO[0], TWO[1]._replace(label="s"))},
            "labels .* are not distinct",
        ),
        (laws.Dahl, {"terms": lambda self: (Term("sigma", "Z", "N"),)}, "share a name"),
    ],
}


@pytest.mark.parametrize(
    ("check", "parent", "changes", "words"),
    [(check, *case) for check, cases in BREAKS.items() for case in cases],
)
def test_a_law_that_breaks_the_contract_is_refused(check, parent, changes, words):
    with pytest.raises((AssertionError, FloatingPointError), match=words):
        getattr(contract, f"check_{check}")(
            broken(parent, **changes), np.random.default_rng(3)
        )


def test_rounding_breaks_no_contract():
    rng = np.random.default_rng(3)
    contract.check_symmetry(
        broken(laws.LinearViscous, kernel=plain(lambda s, v: v + 1e-13 * v * v)), rng
    )
    contract.check_energy(
        broken(laws.LinearElastic, kernel=plain(lambda s, v: s + 1e-8 * v)), rng
    )
    contract.check_standstill(broken(laws.ConstantForce, at_rest=1.0), rng)


def test_special_cases_are_told_by_their_class():
    friction = laws.CoulombFriction()
    assert laws.CovariateFriction("T").contains(friction) and not friction.contains(
        laws.CovariateFriction("T")
    )
    assert laws.DeadZone().contains(
        laws.OneSidedGap(side=-1)
    ) and not laws.DeadZone().contains(laws.Bilinear())
    assert laws.Duffing().contains(
        laws.ConstantForce()
    ) and not laws.QuadraticDamping().contains(laws.ConstantForce())
