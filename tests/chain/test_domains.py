"""Ranges of channels and visited cells, whatever the layout, the type and the size of
the numbers.
"""

import numpy as np
import pytest

from pysindy_nrf.chain.visited_region import VisitedRegion
from pysindy_nrf.records.extent import Extent


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("order", ["C", "F"])
def test_ranges_and_cells_depend_on_the_values_alone(kind, order):
    x = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32).astype(float)
    x[4, 1], x[7, 2] = np.nan, np.inf
    given = np.asarray(x, dtype=kind, order=order)
    found = Extent.of([given])
    assert found.low.tolist() == np.nanmin(
        x, axis=0
    ).tolist() and found.finite.tolist() == [True, False, False]
    low, high = np.full((3, 2), -2.0), np.full((3, 2), 1.0)
    cells = [
        VisitedRegion.of_storeys([(y, y[:, ::-1])], low, high)
        for y in (np.asarray(given[10:], order=order), x[10:])
    ]
    assert all(
        np.array_equal(one.cells, other.cells) and one.cells.any()
        for one, other in zip(*cells, strict=True)
    )
