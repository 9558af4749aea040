"""Constraints: obeyed exactly, harmless where true, helpful where data are poor,
contradicted aloud.
"""

import warnings

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import BiasWarning, ChainError
from pysindy_nrf.identification.constraints import (
    EqualMasses,
    EqualStoreys,
    KnownStiffness,
    NonNegative,
    Prior,
    TotalMass,
)

M, K, C = 12.0, 1e5, 60.0


@pytest.fixture(scope="module")
def data():
    storey = laws.PowerSeries(1, [C, K])
    truth = ChainModel([M] * 3, {f"storey {i}": storey for i in (1, 2, 3)})
    F = excitation.band_limited_random(
        3, 8.0, 500.0, excited=[2], rms=100.0, band=(0.5, 50.0), random_state=0
    )
    rec = simulate(truth, F, 1 / 500.0)
    X, F = rec.to_features(smooth=False)
    rng = np.random.default_rng(1)
    X = X + [0.02] * 3 * rng.normal(size=(len(X), 3)) @ np.eye(
        3, 9
    )  # noisy accelerations
    return X, F + 10.0 * rng.normal(size=F.shape) * [0, 1, 0]


def fit(data, constraints=None):
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor(degree=1, constraints=constraints, dt=1 / 500.0).fit(*data)


def test_each_is_obeyed(data):
    assert np.ptp(fit(data, EqualMasses()).masses_) < 1e-9
    assert fit(data, [TotalMass(36.0)]).masses_.sum() == pytest.approx(36.0)
    assert fit(data, [KnownStiffness(2, 1.01e5)]).restoring_forces_[2].coefficients[
        "s"
    ] == pytest.approx(1.01e5)
    tied = fit(data, [EqualStoreys()])
    for term in ("v", "s"):
        assert (
            np.ptp([tied.restoring_forces_[i].coefficients[term] for i in (1, 2, 3)])
            < 1e-6 * K
        )
    pair = fit(
        data, [EqualMasses([1, 3]), TotalMass(36.0), EqualStoreys([1, 2], terms=["s"])]
    )
    assert pair.masses_[0] == pytest.approx(
        pair.masses_[2]
    ) and pair.masses_.sum() == pytest.approx(36.0)


def test_knowledge_narrows_what_it_touches(data):
    free, tied = (
        fit(data, c).confidence_intervals().set_index("parameter")
        for c in (None, [TotalMass(36.0)])
    )
    width = {k: ci["upper"] - ci["lower"] for k, ci in (("free", free), ("tied", tied))}
    for name in (
        "m1",
        "storey 1: s",
        "storey 3: s",
    ):  # a weighed structure scales every stiffness too
        assert width["tied"][name] < 0.8 * width["free"][name]
    # the true total brings every stiffness nearer to the truth: noise had moved them
    # all alike
    gap = {
        k: abs(ci.loc["storey 1: s", "estimate"] / K - 1)
        for k, ci in (("free", free), ("tied", tied))
    }
    assert gap["tied"] < gap["free"]


def test_nonnegative_is_inactive_where_it_holds_and_zero_where_it_does_not(data):
    free = fit(data)
    same = fit(data, [NonNegative("s"), NonNegative("m")])
    np.testing.assert_allclose(same.masses_, free.masses_, rtol=1e-12)
    X, F = data
    storey = laws.PowerSeries(1, [C, K])
    sinking = ChainModel(
        [M] * 3,
        {
            "storey 1": storey,
            "storey 2": laws.PowerSeries(1, [-5.0, K]),
            "storey 3": storey,
        },
    )
    force = excitation.band_limited_random(
        3, 8.0, 500.0, excited=[2], rms=100.0, band=(0.5, 50.0), random_state=0
    )
    X, F = simulate(sinking, force, 1 / 500.0).to_features(smooth=False)
    F = F + np.random.default_rng(0).normal(size=F.shape) * [0, 1, 0]
    held = fit((X, F), [NonNegative("v", sites=[2])])
    assert fit((X, F)).restoring_forces_[2].coefficients["v"] < 0
    assert held.restoring_forces_[2].coefficients["v"] == 0.0


def test_contradictions_are_said(data):
    with pytest.warns(BiasWarning) as caught:
        NRFRegressor(degree=1, constraints=[TotalMass(60.0)], dt=1 / 500.0).fit(*data)
    assert any(
        "TotalMass(mass=60.0" in str(w.message) and "standard errors" in str(w.message)
        for w in caught
    )
    with pytest.raises(ChainError, match="contradict each other"):
        fit(data, [TotalMass(36.0), TotalMass(40.0)])


@pytest.mark.parametrize(
    ("constraint", "message"),
    [
        (EqualMasses([1, 7]), "DOF 7"),
        (KnownStiffness(2, 1e5, term="s^3"), "storey 2 has v, s"),
        (KnownStiffness(9, 1e5), "storey 9"),
        (Prior("m1", 10.0, 1.0), "a floor has no sensor"),
        (TotalMass(-1.0), "not a positive number"),
        ("k > 0", "not a constraint"),
    ],
)
def test_what_does_not_exist_is_refused(data, constraint, message):
    with pytest.raises(ChainError, match=message):
        fit(data, [constraint])


def test_a_total_of_known_masses_is_checked_and_not_solved(three):
    known = {1: 10.0, 2: 12.0, 3: 8.0}
    fit = NRFRegressor(degree=1, known_masses=known, constraints=TotalMass(30.0)).fit
    assert fit(*three).masses_.tolist() == [10.0, 12.0, 8.0]
    with pytest.raises(
        ChainError, match="known masses differ from a constraint by 1 kg"
    ):
        NRFRegressor(degree=1, known_masses=known, constraints=TotalMass(31.0)).fit(
            *three
        )
