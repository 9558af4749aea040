"""What `import pysindy_nrf` promises."""

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version

import pytest

import pysindy_nrf

FIXED_NAMES = [
    "Chain",
    "ChainModel",
    "ChainOptimizer",
    "ForceLawLibrary",
    "InterstoryPolynomialLibrary",
    "KinematicSmoother",
    "NRFRegressor",
    "Record",
    "Site",
    "StateSpaceChainOptimizer",
    "ZeroPhaseFilter",
    "close_loop",
    "compare_with_sindy",
    "datasets",
    "laws",
    "simulate",
]
HEAVY = ["matplotlib", "numba", "pysindy", "scipy.signal", "sklearn"]


@pytest.mark.parametrize("name", FIXED_NAMES)
def test_fixed_names_are_public(name):
    assert name in pysindy_nrf.__all__
    assert name in dir(pysindy_nrf)
    assert getattr(pysindy_nrf, name).__doc__


def test_every_public_name_resolves():
    for name in pysindy_nrf.__all__:
        getattr(pysindy_nrf, name)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'NRFRegresor'"):
        _ = pysindy_nrf.NRFRegresor


def modules_after(statement: str) -> set[str]:
    """Modules that are loaded in a fresh process after a statement."""
    script = f"import json, sys; {statement}; print(json.dumps(list(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout))


def test_the_bare_import_is_light():
    loaded = modules_after("import pysindy_nrf")
    heavy = {*HEAVY, "llvmlite", "pyarrow.parquet", "h5py", "click"}
    assert not loaded & heavy


def test_the_command_line_starts_light():
    loaded = modules_after("import pysindy_nrf.cli")
    assert not loaded & set(HEAVY)


def test_the_version_is_the_distributions():
    try:
        installed = version("pysindy-nrf")
    except PackageNotFoundError:
        pytest.skip("the tests run from the source tree")
    assert installed == pysindy_nrf.__version__
