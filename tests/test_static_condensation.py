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

K = [1.2e5, 1.6e5, 1.4e5, 1.5e5]
MASSES = [12.0, 2.0, 12.0, 12.0]


def record(blind=(2,), dofs=(4,), fs=500.0, **changes):
    truth = ChainModel(
        MASSES,
        {f"storey {i + 1}": laws.PowerSeries(1, [25.0, k]) for i, k in enumerate(K)},
    )
    rec = driven(truth, dofs, 20.0, fs, 100.0, (0.5, 9.0), hold="cubic")
    gone = {}
    for kind in ("acceleration", "velocity", "displacement"):
        gone[kind] = np.array(getattr(rec, kind))
        gone[kind][:, [j - 1 for j in blind]] = np.nan
    return rec.replace(**gone, **changes)


def test_it_is_refused_with_the_way_out():
    with pytest.raises(
        IdentifiabilityError, match=r"(do not determine|misses) [\s\S]*Add a sensor"
    ):
        NRFRegressor(degree=1).fit(record(fs=100.0))
    assert "Floor 2 has no sensor" in str(Chain(4).plan(sensors=[1, 3, 4]))


def test_the_condensed_storey_is_the_series_of_those_beside_the_missing_floor():
    with pytest.warns(
        DataQualityWarning, match="floor 2 has no sensor .* storeys 2 to 3 in series"
    ):
        condensed = condense(record())
    assert condensed.floors == (1, 3, 4)
    model = NRFRegressor(degree=1).fit(condensed.record)
    k = [model.restoring_forces_[i].linear_part()["k"] for i in (1, 2, 3)]
    np.testing.assert_allclose(k, [K[0], 1 / (1 / K[1] + 1 / K[2]), K[3]], rtol=0.01)
    assert model.masses_.sum() == pytest.approx(sum(MASSES), rel=0.03)
    assert model.masses_[2] == pytest.approx(12.0, rel=0.01)


def test_a_force_on_a_blind_floor_is_refused_and_complete_records_are_left_alone():
    with pytest.raises(ChannelError, match="force acts on floor 2"):
        condense(record(dofs=(2, 4)))
    whole = record(blind=())
    assert condense(whole).record is whole
