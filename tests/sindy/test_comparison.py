"""Plain SINDy and this package side by side: the same data, one ruler, and plain SINDy
used as documented.
"""

import chains
import numpy as np
import pandas as pd
import pysindy as ps
import pytest

from pysindy_nrf import ChainModel, compare_with_sindy, laws
from pysindy_nrf.exceptions import ChannelError


def true_model(case):
    held = {
        i: [laws.LinearViscous(c), laws.Duffing(k, k3)]
        for i, (c, k, k3) in enumerate(zip(case.c, case.k, case.k3), 1)
    }
    return ChainModel(case.m, held)


@pytest.fixture(scope="module")
def case():
    return chains.duffing(2, [1, 2], seed=1, n_samples=3000)


@pytest.fixture(scope="module")
def table(case):
    return compare_with_sindy(
        case.X, case.F, case.dt, truth=true_model(case), free_run=5
    )


@pytest.mark.parametrize(
    ("excited", "noise"), [([2], 0.0), ([2], 0.02), ([1, 2], 0.02)]
)
def test_sindy_is_dealt_its_best_hand(excited, noise):
    """v, s, s^3 of each storey and the forces, each counted once; all masses are 1/m
    only where all DOFs are forced.
    """
    case = chains.duffing(2, excited, seed=1, n_samples=3000)
    table = compare_with_sindy(
        case.noisy(noise),
        case.F,
        case.dt,
        truth=true_model(case),
        free_run=1,
        optimizers={},
    )
    hand, iv = (
        table.loc["SINDy, hand-steered"],
        table.loc["pysindy_nrf, instrumental variables"],
    )
    assert (
        iv.mass_error < (1.0 if noise else 1e-6)
        and iv.force_error_own_masses == iv.restoring_force_error
    )
    assert (hand.terms, hand.precision, hand.recall) == (6 + len(excited), 1.0, 1.0)
    assert hand.restoring_force_error < (1.0 if noise else 1e-6)
    own = hand[["mass_error", "force_error_own_masses"]]
    assert (
        own.max() < (1.0 if noise else 1e-6) if excited == [1, 2] else own.isna().all()
    )


def test_terms_and_hits_are_counted_as_defined(table, case):
    ours = table.loc["pysindy_nrf, STLSQ, threshold 0.01"]
    assert (ours.terms, ours.precision, ours.recall) == (
        8,
        1.0,
        1.0,
    )  # two masses; v, s, s^3 of two storeys
    free = table.loc["pysindy_nrf, least squares"]
    assert (
        free.recall == 1.0
        and free.precision == pytest.approx(6 / (free.terms - 2))
        and free.terms > 15
    )


def test_default_sindy_is_what_its_documentation_says(table, case):
    """The first row against ps.SINDy called here, with the state space written out."""
    x, v = case.s.cumsum(axis=1), case.v.cumsum(axis=1)
    rows = slice(0, 2100)
    model = ps.SINDy(feature_library=ps.PolynomialLibrary(3))
    state, rate = np.hstack([x, v]), np.hstack([v, case.a])
    model.fit(state[rows], t=case.dt, x_dot=rate[rows], u=case.F[rows])
    row = table.loc["SINDy, defaults"]
    assert (
        row.terms == model.coefficients()[2:].any(axis=0).sum()
    )  # of the accelerations, each once
    a_hat = model.predict(state[2100:], u=case.F[2100:])[:, 2:]
    error = case.m * (a_hat - case.a[2100:])
    R = case.storey_forces[2100:]
    gap = np.column_stack([error.sum(axis=1), error[:, 1]])
    rms = lambda y: np.sqrt(np.mean(y**2, axis=0))  # noqa: E731
    assert row.restoring_force_error == pytest.approx(
        100 * np.sqrt(np.mean((rms(gap) / rms(R)) ** 2)), rel=1e-9
    )
    F = case.F[2100:]
    pooled = 100 * np.sqrt(
        ((rms(error) / rms(R)) ** 2).sum() / ((rms(F) / rms(R)) ** 2).sum()
    )
    assert row.balance_error == pytest.approx(pooled, rel=1e-9)


def test_the_true_terms_of_absolute_coordinates_are_the_expanded_cubic(table, case):
    """x1, x2, their rates, the four monomials of (x2 - x1)^3, F1 and F2."""
    row = table.loc["SINDy, normalised"]
    assert row.recall == 1.0 and row.precision * row.terms == pytest.approx(10)


def test_ours_is_exact_and_plain_sindy_is_not(table):
    assert (
        table.loc[
            "pysindy_nrf, least squares",
            ["restoring_force_error", "balance_error", "mass_error"],
        ].max()
        < 1e-6
    )
    assert table.loc["SINDy, defaults", "restoring_force_error"] > 20
    assert np.isnan(table.loc["SINDy, defaults", "mass_error"])  # it deleted 1/m


@pytest.mark.slow
def test_a_free_run_that_diverges_is_infinite_not_hanging():
    case = chains.duffing(3, [3], seed=0, n_samples=2000)
    table = compare_with_sindy(
        case.X, case.F, case.dt, free_run=30, time_limit=200.0, optimizers={}
    )
    assert np.isinf(table.loc["SINDy, defaults", "free_run_error"])
    assert table.loc["SINDy, defaults", "note"] == "free run diverges"
    assert table.loc["pysindy_nrf, least squares", "free_run_error"] < 1


def test_time_is_limited(case):
    table = compare_with_sindy(
        case.X, case.F, case.dt, free_run=900, time_limit=0.02, optimizers={}
    )
    assert "given up" in table.loc["SINDy, normalised", "note"] and np.isnan(
        table.loc["SINDy, normalised", "free_run_error"]
    )


def test_a_library_that_would_fill_the_memory_is_not_built():
    case = chains.duffing(12, range(1, 13), seed=2, n_samples=2500)
    table = compare_with_sindy(
        case.X,
        case.F,
        case.dt,
        truth=true_model(case),
        free_run=1,
        optimizers={},
        time_limit=0.2,
    )
    assert "not run: 9139 columns" in table.loc["SINDy, defaults", "note"]
    assert table.loc["pysindy_nrf, least squares", "restoring_force_error"] < 1e-6


def test_newtons_third_law_found_once_or_twice():
    """One floor hit: this package finds each storey once; SINDy twice, and with noise
    not the same.
    """
    case = chains.duffing(3, [2], seed=3, n_samples=3000, cubic=False)
    X = case.X + 0.02 * case.X.std(axis=0) * np.random.default_rng(0).standard_normal(
        case.X.shape
    )
    table = compare_with_sindy(
        X, case.F, case.dt, truth=true_model(case), degree=1, free_run=1, optimizers={}
    )
    ours, theirs = (
        table.loc["pysindy_nrf, least squares"],
        table.loc["SINDy, hand-steered"],
    )
    assert (ours.storeys_found, ours.third_law_gap) == ("once", 0.0)
    S, V, F2, a = X[:2100, 6:], X[:2100, 3:6], case.F[:2100, 1], X[:2100, :3]
    rows = [
        [S[:, 0], S[:, 1], V[:, 0], V[:, 1]],
        [S[:, 1], S[:, 2], V[:, 1], V[:, 2], F2],
        [S[:, 2], V[:, 2]],
    ]
    k = [
        m * np.linalg.lstsq(np.column_stack(row), a[:, j])[0][:2]
        for j, (m, row) in enumerate(zip(case.m, rows))
    ]
    gaps = [
        100 * abs(-k[i][0] - k[i - 1][1]) / (0.5 * abs(-k[i][0] + k[i - 1][1]))
        for i in (1, 2)
    ]
    assert theirs.storeys_found == "twice" and theirs.third_law_gap == pytest.approx(
        max(gaps), rel=1e-3
    )


def test_without_the_truth_only_what_can_be_known_is_said(case):
    table = compare_with_sindy(
        case.X, case.F, case.dt, free_run=1, optimizers={"SSR": ps.SSR()}
    )
    assert (
        table[["precision", "recall", "mass_error", "restoring_force_error"]]
        .isna()
        .all(axis=None)
    )
    assert table["balance_error"].notna().all() and "pysindy_nrf, SSR" in table.index


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": None}, "sampling step"),
        ({"heldout": 0.0}, "heldout=0.0"),
        ({"F": np.full((3000, 2), np.nan)}, "A force is unknown|No force"),
    ],
)
def test_bad_input(case, options, message):
    given = {"X": case.X, "F": case.F, "dt": case.dt} | options
    with pytest.raises(ChannelError, match=message):
        compare_with_sindy(**given)


def test_the_storey_forces_that_every_model_finds_come_with_the_table():
    case = chains.duffing(3, [2], seed=2, n_samples=3000)
    table = compare_with_sindy(
        case.X, case.F, case.dt, truth=true_model(case), free_run=1, optimizers={}
    )
    assert len(pd.concat([table, table.copy()])) == 2 * len(table)
    forces = table.attrs["storey_forces"]
    np.testing.assert_allclose(forces["truth"], case.storey_forces[2100:], rtol=1e-9)
    size = case.storey_forces.std()
    np.testing.assert_allclose(
        forces["pysindy_nrf, least squares"], forces["truth"], atol=1e-3 * size
    )
    assert np.abs(forces["SINDy, defaults"] - forces["truth"]).max() > 0.05 * size


def test_the_held_out_rule_chooses_within_the_first_part(case):
    """The true terms are left, the damping (the smallest) too; the spoilt end plays no
    part.
    """
    X = case.X + 0.003 * case.X.std(axis=0) * np.random.default_rng(0).standard_normal(
        case.X.shape
    )
    X[2500:, :2] += 5.0 * np.random.default_rng(1).standard_normal((500, 2))
    table = compare_with_sindy(
        X, case.F, case.dt, truth=true_model(case), free_run=1, optimizers="select"
    )
    row = table.loc["pysindy_nrf, terms selected"]
    assert (row.terms, row.precision, row.recall) == (8, 1.0, 1.0)
    assert (
        row.mass_error < 1 and row.balance_error > 1
    )  # fitted to the first part, judged on the rest
