"""Plans agree with what can be identified."""

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainModel, laws
from pysindy_nrf.exceptions import ChainError

STOREY = laws.PowerSeries(1, [25.0, 1.4e5])


@pytest.mark.parametrize(
    ("can_hit", "unknown"), [(None, []), (None, [2]), ([1, 2], [4])]
)
def test_plans_agree_with_identifiability(can_hit, unknown):
    chain = Chain(4, links=["link 4-2"])
    table = chain.plan(can_hit=can_hit, unknown=unknown).table
    for test in table.itertuples():
        order = chain.identifiability(test.hit, unknown=unknown, strategy="sequential")
        assert order.complete == (test.identifies == 1.0) == (test.left == "")


def test_the_best_test_stands_first_and_hits_what_can_be_hit():
    table = Chain(4).plan(can_hit=[1, 2], unknown=[2]).table
    assert table["hit"].tolist() == [(1,)]

    table = Chain(4, links=["link 4-2"]).plan().table
    assert table["identifies"][0] == table["identifies"].max()
    assert (table["hit"].map(len) <= 2).all()


def test_a_floor_at_a_node_is_not_recommended():
    """Three equal floors on springs to both grounds: the middle is a node of mode 2."""
    chain = Chain(3, ground="both")
    model = ChainModel([10.0] * 3, dict.fromkeys(chain.sites, STOREY), chain)
    table = chain.plan(model=model, max_floors=1).table
    response = dict(zip(table["hit"], table["response"]))
    assert response[(2,)] == pytest.approx(0.0, abs=1e-9)
    # mode 2 is (1, 0, -1): an end responds as much as the best floor
    assert response[(1,)] == pytest.approx(1 / np.sqrt(2), rel=1e-6)
    assert table["hit"][0] != (2,)


def test_a_missing_sensor_is_said():
    advice = str(Chain(4).plan(sensors=[1, 2, 4]))
    assert "Floor 3 has no sensor" in advice
    assert "helps most on floor 3" in advice


def test_without_a_force_a_mass_is_asked_for():
    plan = Chain(3).plan(can_hit=[])
    assert plan.table.empty
    assert "known mass is needed" in str(plan)


def test_a_wrong_floor_is_refused():
    with pytest.raises(ChainError, match="DOF 9"):
        Chain(4).plan(can_hit=[9])
