"""Displacements that read a wrong zero, or drift: asked for by name, and not where a
force or a law makes the mean.
"""

import warnings

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.simulation.noise import add_noise


def three_storeys(shift=(0.0, 0.0, 0.0), ramp=0.0, mean=0.0, law=None):
    storey = laws.PowerSeries(1, [25.0, 5e4])
    first = [storey] if law is None else [storey, law]
    truth = ChainModel(
        [12.0, 10.0, 8.0], {"storey 1": first, "storey 2": storey, "storey 3": storey}
    )
    F = excitation.band_limited_random(
        3, 12.0, 500.0, excited=[3], rms=60.0, band=(2, 40), random_state=1
    )
    rec = add_noise(
        simulate(truth, F + [0.0, 0.0, mean], 0.002).replace(velocity=None),
        0.02,
        random_state=2,
    )
    wrong = np.array(shift) + ramp * np.linspace(0, 1, rec.n_samples)[:, None]
    return rec.replace(
        displacement=rec.displacement + wrong * rec.displacement.std(axis=0)
    )


WRONG_ZEROS = {
    "one, a tenth of its rms": {"shift": (0.1, 0.0, 0.0)},
    "one, twice its rms": {"shift": (0.0, 2.0, 0.0)},
    "all": {"shift": (0.5, -0.3, 0.4)},
    "drift": {"ramp": 1.0},
}


@pytest.mark.parametrize("fault", WRONG_ZEROS)
def test_a_wrong_zero_is_asked_for_instead_of_a_law(fault):
    rec = three_storeys(**WRONG_ZEROS[fault])
    with pytest.warns(BiasWarning, match="wrong zero") as caught:
        model = NRFRegressor(degree=1).fit(rec)
    assert not any("A law is missing" in str(w.message) for w in caught)
    found = model.diagnose().table
    assert (
        found["limit"][0] == "wrong zero"
        and "missing law" not in found["limit"].tolist()
    )
    with warnings.catch_warnings(
        record=True, action="always"
    ) as caught:  # what the sentence advises is a cure
        model = NRFRegressor(degree=1, band=(1.0, 60.0)).fit(rec)
    assert not any("zero" in str(w.message) for w in caught)
    assert model.masses_ == pytest.approx([12.0, 10.0, 8.0], rel=0.02)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"mean": 60.0},
        {"law": laws.OneSidedGap(gap=1e-5, k=3e4)},
        {"law": laws.Jenkins(uy=1e-3, Fy=50.0)},
    ],
    ids=["sound", "mean force", "one-sided contact", "hysteresis"],
)
def test_a_mean_that_forces_or_laws_make_is_no_wrong_zero(given):
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = NRFRegressor(degree=1).fit(three_storeys(**given))
    assert not any("zero" in str(w.message) for w in caught)
    assert "wrong zero" not in model.diagnose().table["limit"].tolist()


def test_what_looks_like_a_wrong_zero_and_may_be_a_force_is_a_question():
    """A storey that has yielded stays bent: its balance lacks a constant, as with a
    wrong zero. Both are asked.
    """
    with pytest.warns(
        BiasWarning, match="Or has a storey yielded, or does a constant force act"
    ):
        NRFRegressor(degree=1).fit(three_storeys(law=laws.ConstantForce(20.0)))
