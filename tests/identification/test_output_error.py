"""The free run fitted to the motion: as sharp as the noise allows, and kept only where
it predicts better.
"""

import pickle
import warnings

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.identification.output_error import clearly_better
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.slow

FS = 500.0
TRUE = np.array([10.0, 12.0])
LINEAR = {f"storey {i}": [laws.PowerSeries(1, [60.0, 1e5])] for i in (1, 2)}
CUBIC = {
    **LINEAR,
    "storey 2": [laws.PowerSeries((0, 3), [1e5, 0.0, 5e8]), laws.LinearViscous(60.0)],
}
DAHL = {**LINEAR, "storey 1": [*LINEAR["storey 1"], laws.Dahl(sigma=2e4, Fd=25.0)]}


def measured(truth, seed, noise=0.05, duration=8.0, dofs=(2,), hold="cubic"):
    return add_noise(
        driven(
            truth, dofs, duration, FS, 100.0, (0.5, 40.0), seed=[seed, 1], hold=hold
        ),
        noise,
        random_state=[seed, 2],
    )


@pytest.fixture(scope="module")
def fits():
    truth = ChainModel(TRUE, LINEAR)
    recs = [measured(truth, seed) for seed in range(1, 5)]
    return {
        e: [NRFRegressor(degree=1, estimation=e).fit(rec) for rec in recs]
        for e in ("iv", "simulation")
    }


def test_masses_and_damping_are_sharp(fits):
    """At 5 % noise the least that these records allow is 0.2 % for masses and 1 to 2 %
    for damping (Cramer-Rao).
    """
    for models in fits.values():
        masses = np.array([m.masses_ for m in models]) / TRUE - 1
        damping = (
            np.array(
                [
                    [m.restoring_forces_[i].linear_part()["c"] for i in (1, 2)]
                    for m in models
                ]
            )
            / 60
            - 1
        )
        assert np.sqrt(np.mean(masses**2)) < 0.004
        assert np.sqrt(np.mean(damping**2)) < 0.04


def test_it_is_said_what_was_kept(fits):
    for model in fits["simulation"]:
        facts = model.model_.info["estimation"]
        assert facts["found"] in ("iv", "simulation")
        better = facts["free_run_error_after"] < facts["free_run_error_before"]
        assert better or facts["found"] == "iv"
    assert (
        sum(
            m.model_.info["estimation"]["found"] == "simulation"
            for m in fits["simulation"]
        )
        >= 1
    )


@pytest.mark.parametrize(
    ("after", "kept"), [([0.5, 0.5], True), ([0.2, 1.05], False), ([0.97, 0.97], False)]
)
def test_a_refinement_must_predict_both_halves_better_and_clearly(after, kept):
    """Squared errors of 1 before and so much after, on the halves it did not see:
    better on the whole is not enough.
    """
    after = np.column_stack([after, after, [1.0, 1.0]])
    assert clearly_better(np.ones((2, 3)), after) is kept


def test_records_of_a_quarter_second_keep_the_instrumental_estimate():
    short = measured(ChainModel(TRUE, LINEAR), 0, noise=0.01, duration=0.24)
    with pytest.warns(BiasWarning, match="the records are too short"):
        NRFRegressor(degree=1, estimation="simulation").fit(short)


def test_intervals_survive_saving(fits):
    model = fits["simulation"][0]
    again = pickle.loads(pickle.dumps(model)).confidence_intervals(of="modes")
    assert again.equals(model.confidence_intervals(of="modes"))


def test_intervals_are_those_of_the_refined_estimate(fits):
    inside = []
    for model in fits["simulation"]:
        ci = model.confidence_intervals().set_index("parameter")
        np.testing.assert_allclose(ci.loc[["m1", "m2"], "estimate"], model.masses_)
        inside += [
            ci.loc[f"m{j}", "lower"] <= m <= ci.loc[f"m{j}", "upper"]
            for j, m in ((1, 10.0), (2, 12.0))
        ]
        inside += [
            ci.loc[f"storey {i}: v", "lower"]
            <= 60.0
            <= ci.loc[f"storey {i}: v", "upper"]
            for i in (1, 2)
        ]
    assert np.mean(inside) >= 0.8


@pytest.mark.parametrize(
    ("held", "told"),
    [
        (CUBIC, {"orders": {"storey 2": 3}}),
        (DAHL, {"laws": {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=2e4)]}}),
    ],
    ids=["cubic", "Dahl"],
)
def test_never_worse_on_a_record_it_did_not_see(held, told):
    truth = ChainModel(TRUE, held)
    rec, F = (
        measured(truth, 7),
        excitation.band_limited_random(
            2, 4.0, FS, excited=[2], rms=100.0, band=(0.5, 40.0), random_state=70
        ),
    )
    exact = simulate(truth, F, 1 / FS, hold="cubic")
    gap = {}
    for estimation in ("iv", "simulation"):
        run = (
            NRFRegressor(degree=1, estimation=estimation, **told)
            .fit(rec)
            .simulate(F, dt=1 / FS, hold="cubic")
        )
        gap[estimation] = nrmse(exact.acceleration, run.acceleration)
    assert gap["simulation"] <= gap["iv"] * (1 + 1e-9)


def test_a_missing_law_is_still_warned_of():
    with warnings.catch_warnings(record=True, action="always") as caught:
        truth = ChainModel(
            TRUE,
            {**LINEAR, "storey 1": [*LINEAR["storey 1"], laws.CoulombFriction(30.0)]},
        )
        NRFRegressor(degree=1, estimation="simulation").fit(
            measured(truth, 1, noise=0.01)
        )
    assert sum("A law is missing" in str(w.message) for w in caught) == 1


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_the_free_run_fitted_to_clean_records_is_exact():
    """A force that is smooth between samples and no noise: masses to 1e-4."""
    truth = ChainModel(
        [8.0, 6.0], {f"storey {i}": [laws.PowerSeries(1, [30.0, 4e4])] for i in (1, 2)}
    )
    model = NRFRegressor(degree=1, estimation="simulation").fit(
        driven(truth, [1, 2], 6.0, 500.0, 60.0, (1, 40), hold="cubic")
    )
    np.testing.assert_allclose(model.masses_, [8.0, 6.0], rtol=1e-4)
    facts = model.model_.info["estimation"]
    assert facts["free_run_error_after"] <= facts["free_run_error_before"] < 0.1
