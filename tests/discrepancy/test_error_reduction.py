"""Error reductions in dB, and what the judge makes of them."""

import numpy as np
import pytest
from loop_parts import finding_of, reduction_between

from pysindy_nrf import laws
from pysindy_nrf.discrepancy import judge

# two balances, three bands, five folds that are alike
BEFORE = np.tile([[8.0, 4.0, 1.0], [2.0, 2.0, 2.0]], (5, 1, 1))
REFERENCE = np.full((2, 3), 40.0)
# the last band of the first balance is full of noise
INFORMATIVE = np.array([[True, True, False], [True, True, True]])


def reduction_of(before, after, n_bands=1):
    """The error reduction of one balance, from powers of the residual by fold."""
    reference = np.full((1, n_bands), 1e3)
    informative = np.ones((1, n_bands), dtype=bool)
    return reduction_between(before, after, reference, informative)


def test_a_reduction_is_the_mean_over_informative_bands():
    """10 dB in one of two bands; the band full of noise has no say."""
    change = np.array([[0.1, 1.0, 9.0], [1.0, 1.0, 1.0]])
    reduction = reduction_between(BEFORE, BEFORE * change, REFERENCE, INFORMATIVE)
    assert reduction.value == pytest.approx(5.0, abs=0.1)
    assert reduction.standard_error == pytest.approx(0.0, abs=1e-9)
    assert reduction.least == pytest.approx(reduction.value, rel=1e-3)


def test_a_quiet_balance_has_no_say_beside_one_that_leaves_far_more():
    """Of 50 % of the force 20 % are left; elsewhere 0.1 % become 0.5 %."""
    before = np.tile(1e3 * np.array([[0.25], [1e-6]]), (5, 1, 1))
    after = np.tile(1e3 * np.array([[0.04], [25e-6]]), (5, 1, 1))
    reference, every = np.full((2, 1), 5e3), np.ones((2, 1), dtype=bool)
    reduction = reduction_between(before, after, reference, every)
    assert reduction.value == pytest.approx(10 * np.log10(0.25 / 0.04), abs=0.6)


def test_a_model_without_a_fit_reduces_nothing():
    reduction = reduction_between(BEFORE, BEFORE * np.inf, REFERENCE, INFORMATIVE)
    assert reduction.value == reduction.least == reduction.lower == -np.inf


def test_a_reduction_in_one_fold_alone_is_not_there():
    before = np.full((8, 1, 1), 1.0)
    before[3] = 100.0
    once = reduction_of(before, np.ones((8, 1, 1)))
    assert once.value > 10.0 and not judge.is_there(once)

    always = reduction_of(before, 0.5 * before)
    assert always.value == pytest.approx(3.0, abs=0.1)
    assert judge.is_there(always)


def test_a_fold_without_which_more_is_gained_is_nothing_against_it():
    """A change dated in one fold: a tenth is left in the seven others, all in it."""
    after = np.full((8, 1, 1), 0.1)
    after[3] = 1.0
    reduction = reduction_of(np.ones((8, 1, 1)), after)
    assert reduction.value - 2 * reduction.standard_error < 0.5
    assert reduction.bound > 0.7 * reduction.value

    reversed_folds = reduction_of(np.ones((8, 1, 1)), after[::-1])
    assert reversed_folds.bound == pytest.approx(reduction.bound)


@pytest.mark.parametrize(
    ("law", "there"),
    [
        (laws.ConstantForce(), True),
        (laws.HarmonicForce(), True),
        (laws.CoulombFriction(), False),
    ],
)
def test_a_force_of_one_frequency_is_judged_where_it_acts(law, there):
    """3 dB in one of twelve bands."""
    after = np.ones((8, 1, 12))
    after[..., 0] = 0.5
    reduction = reduction_of(np.ones((8, 1, 12)), after, n_bands=12)
    assert judge.is_there(reduction, law) is there


def ranked(n_parameters, value, spread=0.3):
    """A finding of some size, its reduction scattered from fold to fold."""
    rng = np.random.default_rng(n_parameters)
    without_fold = value + spread * rng.standard_normal(10)
    return finding_of(value, without_fold, spread, n_parameters=n_parameters)


def test_of_what_cannot_be_told_apart_the_simplest_is_taken():
    findings = [ranked(4, 8.0), ranked(1, 7.9), ranked(2, 5.0)]
    assert judge.simplest(findings) == 1
    (rival,) = judge.rivals(findings, 1)
    assert rival.n_parameters == 4


def test_what_is_clearly_better_is_taken_however_large():
    assert judge.simplest([ranked(4, 8.0, 0.0), ranked(1, 5.0, 0.0)]) == 0


def test_a_model_that_lacks_a_fold_is_no_better():
    """A channel that is corrected by a long delay is too short for the last fold."""
    before, reference = np.ones((6, 1, 4)), 100 * np.ones((1, 4))
    informative = np.ones((1, 4), dtype=bool)
    reduction = reduction_between(before, 0.1 * before[:5], reference, informative)
    assert reduction.value == reduction.least == -np.inf
    assert not judge.is_there(reduction)
