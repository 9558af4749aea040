"""Displacements that read a wrong zero, or drift, are asked for by name."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.simulation import add_noise

MASSES = [12.0, 10.0, 8.0]
STOREY = laws.PowerSeries(1, [25.0, 5e4])


@dataclass(frozen=True)
class Shaker:
    """A test of three storeys, shaken on the top floor.

    Errors of displacements are shares of their standard deviations.
    """

    offsets: tuple = (0.0, 0.0, 0.0)
    drift: float = 0.0
    mean_force: float = 0.0  # N
    law: laws.ForceLaw | None = None  # in storey 1

    def record(self):
        first = [STOREY] if self.law is None else [STOREY, self.law]
        truth = ChainModel(MASSES, {1: first, 2: STOREY, 3: STOREY})
        F = excitation.band_limited_random(
            3, 12.0, 500.0, excited=[3], rms=60.0, band=(2, 40), random_state=1
        )
        record = simulate(truth, F + [0.0, 0.0, self.mean_force], 0.002)
        record = add_noise(record.replace(velocity=None), 0.02, random_state=2)

        ramp = np.linspace(0, 1, record.n_samples)[:, None]
        error = np.array(self.offsets) + self.drift * ramp
        x = record.displacement
        return record.replace(displacement=x + error * x.std(axis=0))


def messages(record, **settings):
    """A fit, and what it warns of."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = NRFRegressor(degree=1, **settings).fit(record)
    return model, [str(warning.message) for warning in caught]


WRONG_ZEROS = {
    "one, a tenth of its rms": Shaker(offsets=(0.1, 0.0, 0.0)),
    "one, twice its rms": Shaker(offsets=(0.0, 2.0, 0.0)),
    "all": Shaker(offsets=(0.5, -0.3, 0.4)),
    "drift": Shaker(drift=1.0),
}


@pytest.mark.parametrize("fault", WRONG_ZEROS)
def test_a_wrong_zero_is_asked_for_instead_of_a_law(fault):
    model, said = messages(WRONG_ZEROS[fault].record())

    assert any("wrong zero" in text for text in said)
    assert not any("A law is missing" in text for text in said)
    limits = model.diagnose().table["limit"].tolist()
    assert limits[0] == "wrong zero"
    assert "missing law" not in limits


@pytest.mark.parametrize("fault", WRONG_ZEROS)
def test_the_band_that_the_question_advises_is_a_cure(fault):
    model, said = messages(WRONG_ZEROS[fault].record(), band=(1.0, 60.0))

    assert not any("zero" in text for text in said)
    assert model.masses_ == pytest.approx(MASSES, rel=0.02)


SOUND = {
    "sound": Shaker(),
    "mean force": Shaker(mean_force=60.0),
    "one-sided contact": Shaker(law=laws.OneSidedGap(gap=1e-5, k=3e4)),
    "hysteresis": Shaker(law=laws.Jenkins(uy=1e-3, Fy=50.0)),
}


@pytest.mark.parametrize("name", SOUND)
def test_a_mean_that_forces_or_laws_make_is_no_wrong_zero(name):
    model, said = messages(SOUND[name].record())

    assert not any("zero" in text for text in said)
    assert "wrong zero" not in model.diagnose().table["limit"].tolist()


def test_what_may_be_a_constant_force_is_a_question():
    """A storey that has yielded stays bent: its equation lacks a constant, too."""
    record = Shaker(law=laws.ConstantForce(20.0)).record()

    with pytest.warns(BiasWarning, match="does a constant force act"):
        NRFRegressor(degree=1).fit(record)
