"""Shape parameters without a value: a frequency is found in the residual's spectrum."""

from dataclasses import dataclass

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, Site, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise

FS = 200.0
# modes of two floors at 4.0 and 10.5 Hz
STOREY = [laws.LinearElastic(2e4), laws.LinearViscous(20.0)]


@dataclass(frozen=True)
class Campaign:
    """A chain of floors of 12 kg, and the records that are taken of it."""

    n: int
    hidden: dict  # forces that nobody measured, by site
    forced: tuple = ()  # floors; all if empty
    seconds: tuple = (20.0,)
    first_storey: tuple = ()  # further laws there

    def records(self):
        """The records, with 2 % of noise."""
        storeys = {f"storey {i}": list(STOREY) for i in range(1, self.n + 1)}
        storeys["storey 1"] += self.first_storey
        truth = ChainModel([12.0] * self.n, {**storeys, **self.hidden})

        records = []
        for number, seconds in enumerate(self.seconds):
            F = excitation.band_limited_random(
                self.n,
                seconds,
                FS,
                excited=self.forced or range(1, self.n + 1),
                rms=40.0,
                band=(0.5, 40.0),
                random_state=number,
            )
            record = simulate(truth, F, 1 / FS)
            records.append(add_noise(record, 0.02, random_state=9 + number))
        return records


def harmonic(frequency):
    """A force of 10 N."""
    return laws.HarmonicForce(frequency, 8.0, 6.0)


BESIDE_A_RESONANCE = 1.02 * 4.016
CAMPAIGNS = {
    "one floor": Campaign(1, {"dof 1": harmonic(21.0)}),
    "beside a resonance": Campaign(
        2, {"dof 2": harmonic(BESIDE_A_RESONANCE)}, seconds=(20.0, 12.0)
    ),
    "on a floor without force": Campaign(
        3, {"dof 1": harmonic(33.3)}, forced=(3,), seconds=(12.0, 15.0, 10.0)
    ),
    "faster than what was excited": Campaign(2, {"dof 2": harmonic(61.0)}),
}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_declared_harmonic_force_is_found_at_any_frequency(name):
    campaign = CAMPAIGNS[name]
    ((site, true),) = campaign.hidden.items()
    declared = {site: [laws.HarmonicForce()]}

    model = NRFRegressor(degree=1, laws=declared).fit(campaign.records())

    law = model.model_.laws[Site(site)][0]
    tolerance = 0.02 / max(campaign.seconds)
    frequency = true.shape["frequency"]
    assert law.shape["frequency"] == pytest.approx(frequency, abs=tolerance)
    assert np.hypot(*law.values) == pytest.approx(10.0, rel=0.15)


@pytest.mark.slow
def test_several_frequencies_are_found_one_after_the_other():
    """Two on one floor and one on another; beside them a gap of unknown width."""
    top = Site("dof 2")
    bottom = Site("dof 1")
    storey = Site("storey 1")
    weak = laws.HarmonicForce(7.5, 3.0, 3.0)
    hidden = {
        top: [harmonic(21.0), weak],
        bottom: [laws.HarmonicForce(13.3, 3.0, 3.0)],
    }
    gap = laws.TwoSidedGap(0.003, 1e4)
    records = Campaign(2, hidden, first_storey=(gap,)).records()
    declared = {
        storey: [laws.PowerSeries(1), laws.TwoSidedGap()],
        top: [laws.HarmonicForce(), laws.HarmonicForce()],
        bottom: [laws.HarmonicForce()],
    }

    fitted_laws = NRFRegressor(degree=1, laws=declared).fit(records).model_.laws

    of_top = sorted(law.shape["frequency"] for law in fitted_laws[top])
    assert of_top == pytest.approx([7.5, 21.0], abs=2e-3)
    assert fitted_laws[bottom][0].shape["frequency"] == pytest.approx(13.3, abs=2e-3)
    assert fitted_laws[storey][1].shape["gap"] == pytest.approx(0.003, rel=0.05)


def test_a_frequency_is_found_in_a_band():
    campaign = Campaign(2, {"dof 2": harmonic(21.0)}, seconds=(20.0, 12.0))
    declared = {"dof 2": [laws.HarmonicForce()]}

    regressor = NRFRegressor(degree=1, band=(0.5, 45.0), laws=declared)
    parameters = (
        regressor.fit(campaign.records()).model_.laws[Site("dof 2")][0].parameters
    )

    assert parameters["frequency"] == pytest.approx(21.0, abs=2e-3)
    assert parameters["A"] == pytest.approx(8.0, rel=0.05)
    assert parameters["B"] == pytest.approx(6.0, rel=0.05)


# -- ranges of the search ------------------------------------------------------------


def fitted_slider(uy):
    """A slider of 25 N that yields at a drift, fitted without noise."""
    slider = laws.Jenkins(uy=uy, Fy=25.0)
    truth = ChainModel([9.0, 7.0], {1: [*STOREY, slider], 2: STOREY})
    F = excitation.band_limited_random(
        2, 8.0, FS, excited=2, rms=120.0, band=(0.5, 30.0), random_state=1
    )
    record = simulate(truth, F, 1 / FS, hold="cubic")
    declared = {"storey 1": [laws.PowerSeries(1), laws.Jenkins()]}
    return NRFRegressor(degree=1, laws=declared).fit(record).result_


@pytest.mark.slow
def test_a_shape_is_found_beyond_the_range_of_its_search():
    # the range begins at a hundredth of the rms of the drift
    result = fitted_slider(uy=3e-5)
    drift = np.std(result.require_data("").segments[0].s[:, 0])
    assert 3e-5 < 0.01 * drift

    slider = result.model.laws[Site("storey 1")][1]
    assert slider.shape["uy"] == pytest.approx(3e-5, rel=0.05)
    assert slider.values[0] == pytest.approx(25.0, rel=0.01)
    assert result.facts.shapes_at_ends == ()


@pytest.mark.slow
def test_a_shape_that_ends_where_its_search_ends_is_a_doubt():
    """A slider that yields at once is dry friction: no yield drift fits it."""
    result = fitted_slider(uy=1e-9)
    (end,) = result.facts.shapes_at_ends
    assert (end.site, end.shape, end.end) == ("storey 1", "uy", "lower")
    assert "shape" in [reason.kind for reason in result.verdict.grounds]
