"""Plain SINDy and this package side by side, and plain SINDy used as documented."""

import chains
import numpy as np
import pandas as pd
import pysindy as ps
import pytest

from pysindy_nrf import ChainModel, compare_with_sindy, laws
from pysindy_nrf.exceptions import ChannelError, NRFError

CUT = 2100  # of 3000 samples; models are judged on the rest
OURS = "pysindy_nrf, least squares"
EXPERT = "SINDy, hand-steered"


def true_model(case):
    storeys = {}
    for i, (c, k, k3) in enumerate(zip(case.c, case.k, case.k3), 1):
        storeys[i] = [laws.LinearViscous(c), laws.Duffing(k, k3)]
    return ChainModel(case.m, storeys)


def compared(case, noise=0.0, **options):
    """The table of a case whose truth is known, with short free runs."""
    options = {"free_run": 1, "optimizers": {}, "truth": true_model(case)} | options
    return compare_with_sindy(case.noisy(noise), case.F, case.dt, **options)


def rms(signals):
    return np.sqrt(np.mean(signals**2, axis=0))


@pytest.fixture(scope="module")
def case():
    return chains.duffing(2, [1, 2], seed=1, n_samples=3000)


@pytest.fixture(scope="module")
def table(case):
    return compared(case, optimizers=None, free_run=5)


# -- what every model finds ----------------------------------------------------

LIMITS = [(0.0, 1e-6), (0.02, 1.0)]  # noise, percent


@pytest.mark.parametrize(("noise", "limit"), LIMITS)
def test_one_forced_floor_gives_this_package_all_masses(noise, limit):
    case = chains.duffing(2, [2], seed=1, n_samples=3000)
    table = compared(case, noise)
    ours, expert = table.loc["pysindy_nrf, instrumental variables"], table.loc[EXPERT]
    assert ours.mass_error < limit
    assert ours.force_error_own_masses == ours.restoring_force_error
    assert expert[["mass_error", "force_error_own_masses"]].isna().all()


@pytest.mark.parametrize(("noise", "limit"), LIMITS)
@pytest.mark.parametrize("forced", [[2], [1, 2]], ids=str)
def test_sindy_is_dealt_its_best_hand(forced, noise, limit):
    """v, s, s^3 of each storey and the forces that act, each counted once."""
    case = chains.duffing(2, forced, seed=1, n_samples=3000)
    expert = compared(case, noise).loc[EXPERT]
    assert expert.terms == 6 + len(forced)
    assert (expert.precision, expert.recall) == (1.0, 1.0)
    assert expert.restoring_force_error < limit
    if len(forced) == 2:
        assert expert.mass_error < limit
        assert expert.force_error_own_masses < limit


@pytest.mark.parametrize("forced", [[2], [1, 2]], ids=str)
def test_sindy_of_storey_shears_finds_masses_and_terms(forced):
    case = chains.duffing(2, forced, seed=1, n_samples=3000)
    shears = compared(case).loc["SINDy, storey shears"]
    assert shears.terms == 6 + 2
    assert (shears.precision, shears.recall) == (1.0, 1.0)
    assert shears.mass_error < 1e-6
    assert shears.force_error_own_masses < 1e-6
    assert shears.storeys_found == "once"
    # noise in the accelerations, which are columns, biases the masses a little
    assert compared(case, 0.02).loc["SINDy, storey shears", "mass_error"] < 3


def test_this_package_finds_two_masses_and_three_terms_of_each_storey(table):
    sparse = table.loc["pysindy_nrf, STLSQ, threshold 0.01"]
    assert (sparse.terms, sparse.precision, sparse.recall) == (8, 1.0, 1.0)


def test_terms_that_are_not_true_lower_the_precision(table):
    dense = table.loc[OURS]
    assert dense.recall == 1.0
    assert dense.terms > 15
    assert dense.precision == pytest.approx(6 / (dense.terms - 2))


def test_the_true_terms_of_absolute_coordinates_are_the_expanded_cubic(table):
    """x1, x2, their rates, the four monomials of (x2 - x1)^3, F1 and F2."""
    row = table.loc["SINDy, normalised"]
    assert row.recall == 1.0
    assert row.precision * row.terms == pytest.approx(10)


def test_ours_is_exact_and_plain_sindy_is_not(table):
    errors = ["restoring_force_error", "balance_error", "mass_error"]
    assert table.loc[OURS, errors].max() < 1e-6
    assert table.loc["SINDy, defaults", "restoring_force_error"] > 20
    assert np.isnan(table.loc["SINDy, defaults", "mass_error"])  # it deleted 1/m


@pytest.fixture(scope="module")
def default_sindy(case):
    """ps.SINDy called as documented, with the state space written out."""
    state = np.hstack([case.s.cumsum(axis=1), case.v.cumsum(axis=1)])
    rate = np.hstack([case.v.cumsum(axis=1), case.a])
    model = ps.SINDy(feature_library=ps.PolynomialLibrary(3))
    model.fit(state[:CUT], t=case.dt, x_dot=rate[:CUT], u=case.F[:CUT])
    a_hat = model.predict(state[CUT:], u=case.F[CUT:])[:, 2:]
    return model, case.m * (a_hat - case.a[CUT:])


def test_terms_of_default_sindy_are_those_of_the_accelerations(table, default_sindy):
    terms = default_sindy[0].coefficients()[2:].any(axis=0).sum()
    assert table.loc["SINDy, defaults", "terms"] == terms


def test_errors_of_default_sindy_are_as_defined(table, default_sindy, case):
    residual, R = default_sindy[1], case.storey_forces[CUT:]
    row = table.loc["SINDy, defaults"]
    gap = np.column_stack([residual.sum(axis=1), residual[:, 1]])
    expected = 100 * np.sqrt(np.mean((rms(gap) / rms(R)) ** 2))
    assert row.restoring_force_error == pytest.approx(expected, rel=1e-9)
    missed = ((rms(residual) / rms(R)) ** 2).sum()
    reference = ((rms(case.F[CUT:]) / rms(R)) ** 2).sum()
    pooled = 100 * np.sqrt(missed / reference)
    assert row.balance_error == pytest.approx(pooled, rel=1e-9)


def test_newtons_third_law_found_once_or_twice():
    """This package finds each storey once; SINDy twice, and with noise not the same."""
    case = chains.duffing(3, [2], seed=3, n_samples=3000, cubic=False)
    table = compared(case, 0.02, degree=1)
    ours, expert = table.loc[OURS], table.loc[EXPERT]
    assert (ours.storeys_found, ours.third_law_gap) == ("once", 0.0)
    assert expert.storeys_found == "twice"

    # stiffness of the storey below and above each floor, from its acceleration alone
    a, v, s = np.split(case.noisy(0.02)[:CUT], 3, axis=1)
    columns = [
        [s[:, 0], s[:, 1], v[:, 0], v[:, 1]],
        [s[:, 1], s[:, 2], v[:, 1], v[:, 2], case.F[:CUT, 1]],
        [s[:, 2], v[:, 2]],
    ]
    below, above = [], []
    for j, terms in enumerate(columns):
        values = case.m[j] * np.linalg.lstsq(np.column_stack(terms), a[:, j])[0]
        below.append(-values[0])
        above.append(values[1])
    lower, other = np.array(below[1:]), np.array(above[:-1])
    gap = 100 * np.abs(lower - other) / (0.5 * np.abs(lower + other))
    assert expert.third_law_gap == pytest.approx(gap.max(), rel=1e-3)


def test_the_storey_forces_of_every_model_come_with_the_table():
    case = chains.duffing(3, [2], seed=2, n_samples=3000)
    forces = compared(case).attrs["storey_forces"]
    truth = case.storey_forces[CUT:]
    np.testing.assert_allclose(forces["truth"], truth, rtol=1e-9)
    size = case.storey_forces.std()
    assert np.abs(forces[OURS] - truth).max() < 1e-3 * size
    assert np.abs(forces["SINDy, defaults"] - truth).max() > 0.05 * size


def test_tables_that_carry_forces_can_be_joined(table):
    assert len(pd.concat([table, table.copy()])) == 2 * len(table)


def test_the_held_out_rule_chooses_within_the_first_part(case):
    """The spoilt end plays no part in the choice; the model is judged on it."""
    rng = np.random.default_rng(0)
    X = case.X + 0.003 * case.X.std(axis=0) * rng.standard_normal(case.X.shape)
    X[2500:, :2] += 5.0 * rng.standard_normal((500, 2))
    truth = true_model(case)
    table = compare_with_sindy(
        X, case.F, case.dt, truth=truth, free_run=1, optimizers="select"
    )
    row = table.loc["pysindy_nrf, terms selected"]
    assert (row.terms, row.precision, row.recall) == (8, 1.0, 1.0)
    assert row.mass_error < 1
    assert row.balance_error > 1


# -- what cannot be run --------------------------------------------------------


@pytest.mark.slow
def test_a_free_run_that_diverges_is_infinite_not_hanging():
    case = chains.duffing(3, [3], seed=0, n_samples=2000)
    table = compare_with_sindy(
        case.X, case.F, case.dt, free_run=30, time_limit=200.0, optimizers={}
    )
    assert np.isinf(table.loc["SINDy, defaults", "free_run_error"])
    assert table.loc["SINDy, defaults", "note"] == "free run diverges"
    assert table.loc[OURS, "free_run_error"] < 1


def test_time_is_limited(case):
    row = compared(case, free_run=900, time_limit=0.02).loc["SINDy, normalised"]
    assert "given up" in row.note
    assert np.isnan(row.free_run_error)


def test_a_library_that_would_fill_the_memory_is_not_built():
    case = chains.duffing(12, range(1, 13), seed=2, n_samples=2500)
    table = compared(case, time_limit=0.2)
    assert "not run: 9139 columns" in table.loc["SINDy, defaults", "note"]
    assert table.loc[OURS, "restoring_force_error"] < 1e-6


def test_without_the_truth_only_what_can_be_known_is_given(case):
    table = compared(case, truth=None, optimizers={"SSR": ps.SSR()})
    unknown = ["precision", "recall", "mass_error", "restoring_force_error"]
    assert table[unknown].isna().all(axis=None)
    assert table["balance_error"].notna().all()
    assert "pysindy_nrf, SSR" in table.index


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": None}, "sampling step"),
        ({"heldout": 0.0}, "heldout=0.0"),
        ({"F": np.full((3000, 2), np.nan)}, "A force is unknown|No force"),
        ({"optimizers": "all"}, "optimizers='all' is unknown"),
    ],
)
def test_bad_input(case, options, message):
    arguments = {"X": case.X, "F": case.F, "dt": case.dt} | options
    with pytest.raises((ChannelError, NRFError), match=message):
        compare_with_sindy(**arguments)
