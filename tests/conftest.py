"""What every test file shares."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import branches
import chains
import pytest
from hypothesis import settings

settings.register_profile("quick", max_examples=20, deadline=None, derandomize=True)
settings.load_profile("quick")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Count the lines that a test runs, where that is asked for."""
    if branches.COUNTER is not None:
        branches.COUNTER.turn(item.path.name not in branches.UNCOUNTED)
    return (yield)


def pytest_sessionfinish() -> None:
    """Leave what was counted."""
    if branches.COUNTER is not None:
        branches.COUNTER.end()


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
    return chains.paper_case()
