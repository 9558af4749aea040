"""Every method that an upper layer carries out finds its function."""

from pkgutil import resolve_name

import pytest

from pysindy_nrf.common.lazy import Hook


@pytest.mark.parametrize("hook", Hook)
def test_every_hook_names_a_function_of_the_package(hook):
    assert callable(resolve_name(hook.value))
