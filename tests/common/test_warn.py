"""Warnings point at the line of the user, however deep the package gives them."""

import warnings

import pytest

from pysindy_nrf.common.warn import warn_user
from pysindy_nrf.exceptions import BiasWarning, DataQualityWarning


def test_a_warning_has_its_text_and_its_type():
    with pytest.warns(BiasWarning, match="too low"):
        warn_user("Masses are too low.", BiasWarning)

    with pytest.warns(DataQualityWarning, match="no clock"):
        warn_user(DataQualityWarning("There is no clock", "Give fs=."))


def test_a_warning_points_at_this_file():
    with warnings.catch_warnings(record=True, action="always") as caught:
        warn_user("Masses are too low.", BiasWarning)

    assert caught[0].filename == __file__
