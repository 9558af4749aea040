"""Ranges of channels and visited cells depend on the values alone."""

import numpy as np
import pytest

from pysindy_nrf.chain import VisitedRegion
from pysindy_nrf.records import Extent

VALUES = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32).astype(float)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("order", ["C", "F"])
def test_ranges_pass_over_nan(kind, order):
    x = VALUES.copy()
    x[4, 1] = np.nan
    x[7, 2] = np.inf
    extent = Extent.of_columns([np.asarray(x, dtype=kind, order=order)])
    assert extent.low.tolist() == np.nanmin(x, axis=0).tolist()
    assert extent.finite.tolist() == [True, False, False]


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("order", ["C", "F"])
def test_visited_cells_whatever_the_layout(kind, order):
    low, high = np.full((3, 2), -2.0), np.full((3, 2), 1.0)
    stored = np.asarray(VALUES, dtype=kind, order=order)
    regions = VisitedRegion.of_storeys([(stored, stored[:, ::-1])], low, high)
    expected = VisitedRegion.of_storeys([(VALUES, VALUES[:, ::-1])], low, high)
    for region, twin in zip(regions, expected, strict=True):
        assert region.cells.any()
        assert np.array_equal(region.cells, twin.cells)


def test_a_region_contains_its_cells_and_their_neighbours():
    """Two visited corners of a square that is 40 cells wide."""
    region = VisitedRegion.of(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    assert region.contains([0.0, 1.0, 0.04], [0.0, 1.0, 0.04]).all()
    assert not region.contains([0.5, 0.0, -0.1], [0.5, 1.0, 0.0]).any()


def test_the_nearest_visited_point_is_the_middle_of_a_cell():
    region = VisitedRegion.of(np.array([0.0, 1.0]), np.array([0.0, 10.0]))
    v, s = region.nearest([0.4, 0.6], [4.0, 6.0])
    assert v == pytest.approx([0.5 / 40, 39.5 / 40])
    assert s == pytest.approx([5.0 / 40, 395.0 / 40])


def test_a_region_survives_plain_data():
    region = VisitedRegion.of(VALUES[:, 0], VALUES[:, 1])
    again = VisitedRegion.from_dict(region.to_dict())
    assert (again.low, again.high) == (region.low, region.high)
    assert np.array_equal(again.cells, region.cells)
