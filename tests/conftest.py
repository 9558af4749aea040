"""What every test file shares."""

from __future__ import annotations

import chains
import pytest
from hypothesis import settings

settings.register_profile("quick", max_examples=20, deadline=None, derandomize=True)
settings.load_profile("quick")


@pytest.fixture(scope="session")
def chain4():
    """A Duffing chain of four storeys, DOF 3 forced."""
    return chains.duffing(4, [3], seed=1, n_samples=4000)


@pytest.fixture(scope="session")
def chain2():
    """A Duffing chain of two storeys, both DOFs forced."""
    return chains.duffing(2, [1, 2], seed=2, n_samples=2000)


@pytest.fixture(scope="session")
def dahl():
    """The paper's chain with the modified Dahl damper, both DOFs forced: case, Z, R_1."""
    return chains.paper_case(duration=2.0)
