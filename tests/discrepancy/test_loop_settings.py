"""Every number by which the loop decides is listed in the settings of a run."""

import inspect
from dataclasses import fields
from importlib import import_module
from pkgutil import walk_packages

from report_cases import friction, loop_report

from pysindy_nrf import discrepancy
from pysindy_nrf.diagnosis import evidence


def classes_of_settings():
    """Classes of settings in the modules of the loop."""
    for package in (discrepancy, evidence):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            for name, kind in inspect.getmembers(import_module(module.name)):
                is_defined_here = getattr(kind, "__module__", "") == module.name
                if name.endswith("Settings") and is_defined_here:
                    yield kind


def test_all_settings_of_the_loop_are_listed_each_by_a_name_of_its_own():
    count = sum(len(fields(kind)) for kind in classes_of_settings())
    assert len(loop_report(friction).settings["constants"]) == count > 60
