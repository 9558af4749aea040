"""Every number by which the loop decides is listed in the settings of a run."""

import inspect
from dataclasses import fields, is_dataclass
from importlib import import_module
from pkgutil import walk_packages

from pysindy_nrf import discrepancy
from pysindy_nrf.common.audit import constants_of
from pysindy_nrf.discrepancy.audit import ALL_SETTINGS


def modules():
    path, prefix = discrepancy.__path__, f"{discrepancy.__name__}."
    for module in walk_packages(path, prefix):
        yield import_module(module.name)


def test_all_settings_of_the_loop_are_listed():
    kinds = set()
    for module in modules():
        for name, kind in inspect.getmembers(module, inspect.isclass):
            if name.endswith("Settings") and kind.__module__ == module.__name__:
                kinds.add(kind)
    assert {type(settings) for settings in ALL_SETTINGS.values()} == kinds
    assert all(is_dataclass(kind) for kind in kinds)


def test_every_number_has_a_name_of_its_own():
    count = sum(len(fields(settings)) for settings in ALL_SETTINGS.values())
    assert len(constants_of(ALL_SETTINGS)) == count > 60
