"""Displacements that read a wrong zero, or drift."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
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

    def clean(self):
        """Noise aside, and with true zeros."""
        first = [STOREY] if self.law is None else [STOREY, self.law]
        truth = ChainModel(MASSES, {1: first, 2: STOREY, 3: STOREY})
        F = excitation.band_limited_random(
            3, 12.0, 500.0, excited=[3], rms=60.0, band=(2, 40), random_state=1
        )
        return simulate(truth, F + [0.0, 0.0, self.mean_force], 0.002)

    def record(self):
        """What was measured."""
        record = self.clean().replace(velocity=None)
        record = add_noise(record, 0.02, random_state=2)

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
}
DRIFT = Shaker(drift=1.0)


@pytest.mark.parametrize("fault", WRONG_ZEROS)
def test_a_wrong_zero_is_taken_out_and_noted(fault):
    """K b newtons stand in the equations of motion where displacements read b more."""
    test = WRONG_ZEROS[fault]
    model, texts = messages(test.record())

    assert not texts
    assert model.masses_ == pytest.approx(MASSES, rel=0.01)
    offsets = np.zeros(3)
    for note in model.result_.examination.quality:
        assert note.kind == "offset"
        offsets[int(note.channel.removeprefix("dof ")) - 1] = note.size
    zeros = test.offsets * test.clean().displacement.std(axis=0)
    stiffness = ChainModel(MASSES, dict.fromkeys((1, 2, 3), STOREY)).matrices()[2]
    expected = -stiffness @ zeros
    assert offsets == pytest.approx(expected, rel=0.05, abs=0.05 * abs(expected).max())


@pytest.mark.parametrize("fault", WRONG_ZEROS)
def test_a_wrong_zero_is_no_reason_against_a_model(fault):
    model, _ = messages(WRONG_ZEROS[fault].record())

    assert model.result_.verdict.state == "green"
    assert model.result_.free_runs.error < 3.0


def test_each_record_has_zeros_of_its_own():
    tests = [Shaker(offsets=(0.3, 0.0, 0.0)), Shaker(offsets=(-0.3, 0.2, 0.0))]
    records = [test.record().replace(name=f"test {i}") for i, test in enumerate(tests)]
    model, texts = messages(records)

    assert not texts
    assert model.masses_ == pytest.approx(MASSES, rel=0.01)
    notes = model.result_.examination.quality
    first = {note.record: note.size for note in notes if note.channel == "dof 1"}
    assert first["test 0"] < 0 < first["test 1"]


def test_an_even_law_is_found_beside_wrong_zeros():
    """The mean of its force is no offset."""
    law = laws.QuadraticStiffness(k2=1.5e6)
    record = Shaker(offsets=(0.05, -0.05, 0.05), law=law).record()
    declared = {1: [STOREY, laws.QuadraticStiffness()], 2: STOREY, 3: STOREY}
    model = NRFRegressor(laws=declared).fit(record)

    assert model.masses_ == pytest.approx(MASSES, rel=0.02)
    quadratic = model.restoring_forces_[1].coefficients["s^2"]
    assert quadratic == pytest.approx(1.5e6, rel=0.05)


def test_a_declared_constant_force_is_identified():
    record = Shaker(law=laws.ConstantForce(20.0)).record()
    declared = {1: [STOREY, laws.ConstantForce()], 2: STOREY, 3: STOREY}
    model = NRFRegressor(laws=declared).fit(record)

    assert model.restoring_forces_[1].coefficients["1"] == pytest.approx(20, rel=0.05)
    assert not model.result_.examination.quality


def test_a_drift_is_left_out():
    model, texts = messages(DRIFT.record())

    assert not texts
    assert model.masses_ == pytest.approx(MASSES, rel=0.02)
    kinds = {note.kind for note in model.result_.examination.quality}
    assert kinds == {"drift"}


@pytest.mark.parametrize("fault", [DRIFT, Shaker(offsets=(0.5, -0.3, 0.4))])
def test_motions_without_their_record_are_asked_for_their_zeros(fault):
    """What was measured of them is not known, so nothing is taken out."""
    X, F = fault.record().to_features()
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = NRFRegressor(degree=1).fit(X, F)
    texts = [str(warning.message) for warning in caught]

    assert any("wrong zero" in text for text in texts)
    assert not any("A law is missing" in text for text in texts)
    limits = model.diagnose().table["limit"].tolist()
    assert limits[0] == "wrong zero"
    assert "missing law" not in limits


def test_the_band_that_the_question_advises_is_a_cure():
    model, texts = messages(DRIFT.record(), band=(1.0, 60.0))

    assert not any("zero" in text for text in texts)
    assert model.masses_ == pytest.approx(MASSES, rel=0.02)


SOUND = {
    "sound": Shaker(),
    "mean force": Shaker(mean_force=60.0),
    "one-sided contact": Shaker(law=laws.OneSidedGap(gap=1e-5, k=3e4)),
    "hysteresis": Shaker(law=laws.Jenkins(uy=1e-3, Fy=50.0)),
}


@pytest.mark.parametrize("name", SOUND)
def test_a_mean_that_forces_or_laws_make_is_no_wrong_zero(name):
    model, texts = messages(SOUND[name].record())

    assert not any("zero" in text for text in texts)
    assert "wrong zero" not in model.diagnose().table["limit"].tolist()
