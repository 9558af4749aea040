"""What `import pysindy_nrf` promises."""

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version

import pytest

import pysindy_nrf

FIXED_NAMES = """
    Chain Site Record NRFRegressor ChainOptimizer StateSpaceChainOptimizer InterstoryPolynomialLibrary ForceLawLibrary
    ChainModel KinematicSmoother ZeroPhaseFilter close_loop compare_with_sindy simulate laws datasets
""".split()


@pytest.mark.parametrize("name", FIXED_NAMES)
def test_fixed_names_are_public(name):
    assert name in pysindy_nrf.__all__ and name in dir(pysindy_nrf)
    assert getattr(pysindy_nrf, name).__doc__


def test_every_public_name_resolves():
    for name in pysindy_nrf.__all__:
        getattr(pysindy_nrf, name)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'NRFRegresor'"):
        pysindy_nrf.NRFRegresor  # noqa: B018


def fresh(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout


def test_the_bare_import_is_light():
    heavy = (
        "numba llvmlite matplotlib scipy.signal sklearn pysindy pyarrow.parquet h5py"
        " click".split()
    )
    code = (
        f"import sys, json, pysindy_nrf; print(json.dumps([m for m in {heavy!r} if m in"
        " sys.modules]))"
    )
    assert json.loads(fresh(code)) == []


def test_the_command_line_starts_light():
    heavy = ["numba", "matplotlib", "scipy.signal", "sklearn", "pysindy"]
    code = (
        "import sys, json, pysindy_nrf.cli; print(json.dumps([m for m in"
        f" {heavy!r} if m in sys.modules]))"
    )
    assert json.loads(fresh(code)) == []


def test_the_version_is_the_distributions():
    try:
        assert version("pysindy-nrf") == pysindy_nrf.__version__
    except PackageNotFoundError:
        pytest.skip("pysindy-nrf is not installed, the tests run from the source tree")
