"""Floors without a sensor: refused, or left out with the meaning of what is left."""

import numpy as np
import pytest
from chains import driven
from static_condensation import condense

from pysindy_nrf import Chain, ChainModel, NRFRegressor, laws
from pysindy_nrf.exceptions import (
    ChannelError,
    DataQualityWarning,
    IdentifiabilityError,
)

K = [1.2e5, 1.6e5, 1.4e5, 1.5e5]  # N/m
MASSES = [12.0, 2.0, 12.0, 12.0]  # kg
MOTIONS = ("acceleration", "velocity", "displacement")


def record(blind=(2,), dofs=(4,), fs=500.0):
    """A chain of four storeys with a light floor, without sensors on blind floors."""
    storeys = {i: laws.PowerSeries(1, [25.0, k]) for i, k in enumerate(K, 1)}
    truth = ChainModel(MASSES, storeys)
    measured = driven(truth, dofs, 20.0, fs, 100.0, (0.5, 9.0), hold="cubic")
    channels = {}
    for name in MOTIONS:
        channels[name] = np.array(getattr(measured, name))
        channels[name][:, np.array(blind, dtype=int) - 1] = np.nan
    return measured.replace(**channels)


@pytest.mark.slow
def test_a_floor_without_a_sensor_is_refused_with_the_way_out():
    with pytest.raises(IdentifiabilityError, match="Add a sensor"):
        NRFRegressor(degree=1).fit(record(fs=100.0))
    assert "Floor 2 has no sensor" in str(Chain(4).plan(sensors=[1, 3, 4]))


def test_the_condensed_storey_is_two_in_series():
    with pytest.warns(DataQualityWarning, match="floor 2 has no sensor"):
        condensed = condense(record())
    assert condensed.floors == (1, 3, 4)

    model = NRFRegressor(degree=1).fit(condensed.record)
    forces = model.restoring_forces_
    stiffnesses = [forces[storey].linear_part()["k"] for storey in (1, 2, 3)]
    in_series = 1 / (1 / K[1] + 1 / K[2])
    np.testing.assert_allclose(stiffnesses, [K[0], in_series, K[3]], rtol=0.01)
    assert model.masses_.sum() == pytest.approx(sum(MASSES), rel=0.03)
    assert model.masses_[2] == pytest.approx(12.0, rel=0.01)


def test_a_force_on_a_blind_floor_is_refused():
    with pytest.raises(ChannelError, match="force acts on floor 2"):
        condense(record(dofs=(2, 4)))


def test_complete_records_are_left_alone():
    complete = record(blind=())
    assert condense(complete).record is complete
