"""PySINDy's own tests of libraries and optimizers, with the classes of this package.

    pip download --no-binary :all: --no-deps pysindy==2.1.0
    tar xf pysindy-2.1.0.tar.gz
    python benchmarks/pysindy_contract.py pysindy-2.1.0 [--list]

The tests are read from PySINDy's source distribution, which PyPI holds; none is copied
here. Test functions and the data they ask for are taken out of their files, and called
with our libraries and optimizers where PySINDy passes its own: neither pytest's
collection nor PySINDy's optional solvers (cvxpy, gurobi, jax) are needed. PySINDy's
tests double the single column of their data for its optimizers that need more
(``_align_optimizer_and_1dfeatures``); a state-space model, which reads velocity and
force, is counted among these.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import search_path
import numpy as np
import pandas as pd
import pysindy as ps
from harness import markdown, options_of, quietly
from sklearn.base import clone

from pysindy_nrf import (
    ChainOptimizer,
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
    StateSpaceChainOptimizer,
    laws,
)

FIXTURES = "conftest.py"
FILES = (
    FIXTURES,
    "test_feature_library.py",
    "test_optimizers/test_optimizers.py",
    "test_pysindy.py",
)
OF_LIBRARIES = (
    "fit_transform",
    "change_in_data_shape",
    "get_feature_names",
    "not_fitted",
    "output_shape",
)
OF_OPTIMIZERS = ("fit", "not_fitted", "complexity_not_fitted")
# cases that fail for a reason
REASONS = {
    ("feature_library:change_in_data_shape", "times PySINDy's"): (
        "an IndexError of PySINDy's TensoredLibrary, which takes its factors' columns"
        " by number; PolynomialLibrary() * PolynomialLibrary() fails alike"
    ),
}


@dataclass(frozen=True)
class Case:
    """A test as ``file:function``, the class of ours, and arguments that are no data.

    ``data`` is the fixture that the test gets as its argument of that name.
    """

    test: str
    name: str
    arguments: dict[str, Any]
    data: str = ""


# -- PySINDy's test files ------------------------------------------------------


def definitions(path: Path) -> dict[str, Any]:
    """Functions and imported names of a test file, without decorators.

    What is not installed becomes an empty class.
    """
    names: dict[str, Any] = {}

    def execute(node: ast.stmt) -> None:
        exec(compile(ast.Module([node], []), str(path), "exec"), names)

    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            execute(bare(node))
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            for alias in node.names:
                single = type(node)(**(vars(node) | {"names": [alias]}))
                try:
                    execute(single)
                except ImportError:
                    name = alias.asname or alias.name
                    names[name] = type(alias.name, (), {})
    return names


def bare(node: ast.FunctionDef) -> ast.FunctionDef:
    """A function without decorators and annotations."""
    node.decorator_list = []
    node.returns = None
    for argument in node.args.args:
        argument.annotation = None
    return node


def aligned(optimizer: Any, features: np.ndarray) -> tuple[Any, np.ndarray]:
    """PySINDy's helper, for our class that needs two columns."""
    if isinstance(optimizer, StateSpaceChainOptimizer):
        features = np.hstack([features, features])
    return optimizer, features


# -- what of ours is tested ----------------------------------------------------


def libraries() -> dict[str, tuple[Any, int]]:
    """Libraries of ours, and how many features they make of three columns.

    The columns are a, v, s or x, xdot, F of one DOF.
    """
    duffing = [laws.LinearViscous(), laws.Duffing()]
    memory = [*duffing, laws.Dahl(sigma=1.0)]
    friction = ForceLawLibrary([laws.CoulombFriction()])
    polynomial = ps.PolynomialLibrary(1, include_bias=False)
    cubic_state = InterstoryPolynomialLibrary(3, inputs="state")
    return {
        "polynomial": (InterstoryPolynomialLibrary(3), 1 + 9),
        "polynomial box": (InterstoryPolynomialLibrary((1, 2)), 1 + 5),
        "polynomial, state": (cubic_state, 9 + 1),
        "laws": (ForceLawLibrary(duffing), 1 + 3),
        "laws, state": (ForceLawLibrary(duffing, inputs="state"), 3 + 1),
        "laws with memory": (ForceLawLibrary(memory, dt=0.1), 1 + 4),
        "sum": (InterstoryPolynomialLibrary(1) + friction, 1 + 3),
        "beside PySINDy's": (InterstoryPolynomialLibrary(2) + polynomial, 1 + 5 + 3),
        "times PySINDy's": (ForceLawLibrary(duffing) * polynomial, 4 * 3),
    }


def optimizers() -> dict[str, Any]:
    """What runs on the balances."""
    stlsq = ps.STLSQ(threshold=1e-3)
    ensemble = ps.EnsembleOptimizer(stlsq, library_ensemble=True, n_models=4)
    return {
        "least squares": None,
        "STLSQ": stlsq,
        "SR3": ps.SR3(),
        "SSR": ps.SSR(),
        "FROLS": ps.FROLS(),
        "library ensemble": ensemble,
    }


def cases() -> Iterator[Case]:
    for name, (library, n_features) in libraries().items():
        yield from cases_of_library(name, library, n_features)
    # ten monomials of three columns and their three derivatives: terms of three storeys
    yield from cases_of_optimizer(ChainOptimizer, [3, 2, 2])
    yield from cases_of_optimizer(StateSpaceChainOptimizer, [2, 1, 1])


def cases_of_library(name: str, library: Any, n_features: int) -> Iterator[Case]:
    for test in OF_LIBRARIES:
        arguments = {"library": clone(library)}
        if test == "output_shape":
            arguments["shape"] = n_features
        yield Case(f"feature_library:{test}", name, arguments)
    yield Case("pysindy:libraries", name, {"library": clone(library)})


def cases_of_optimizer(kind: type, terms: list[int]) -> Iterator[Case]:
    name = kind.__name__
    targets = {"cls": kind, "support": True}
    yield Case("optimizers:supports_multiple_targets", name, targets)
    pickled = {"opt_cls": kind, "opt_args": {"terms": terms}}
    yield Case("optimizers:pickle", name, pickled)
    for data, counts in (("data_1d", None), ("data_lorenz", terms)):
        arguments = {"optimizer": kind(terms=counts)}
        yield Case("pysindy:predict", f"{name}, {data}", arguments, data)

    for inner_name, inner in optimizers().items():
        full_name = f"{name}, {inner_name}"
        for test in OF_OPTIMIZERS:
            yield Case(f"optimizers:{test}", full_name, {"optimizer": kind(inner)})
        weighted = {"optimizer": partial(kind, inner)}
        yield Case("optimizers:sample_weight_optimizers", full_name, weighted)


# -- running -------------------------------------------------------------------


class Suite:
    """PySINDy's tests and fixtures, by file."""

    def __init__(self, source: Path) -> None:
        self.files = {}
        for path in FILES:
            name = path.rpartition("/")[2]
            self.files[name] = definitions(source / "test" / path)
        optimizers_file = self.files["test_optimizers.py"]
        optimizers_file["_align_optimizer_and_1dfeatures"] = aligned

    def failure(self, case: Case) -> str | None:
        """Why a case fails, in a line."""
        file, _, function = case.test.partition(":")
        call = self.files[f"test_{file}.py"][f"test_{function}"]
        arguments = case.arguments | self.fixtures(call)
        if case.data:
            arguments["data"] = self.files[FIXTURES][case.data]()
        try:
            call(**arguments)
        except BaseException as error:  # pytest's own failures are no Exception
            lines = str(error).splitlines() or [type(error).__name__]
            return REASONS.get((case.test, case.name), lines[0])
        return None

    def fixtures(self, call: Callable) -> dict[str, Any]:
        """The data that a test asks for."""
        arguments: dict[str, Any] = {}
        for name in inspect.signature(call).parameters:
            if name.startswith("data_"):
                arguments[name] = self.files[FIXTURES][name]()
            elif name == "set_jax_pcc_env":
                arguments[name] = None
        return arguments


def main(arguments: list[str] | None = None) -> int:
    """Run the tests and print what passes."""
    parser = options_of(__doc__)
    parser.add_argument(
        "source", type=Path, help="the unpacked source distribution of PySINDy"
    )
    parser.add_argument("--list", action="store_true", help="name every case")
    options = parser.parse_args(arguments)
    # EnsembleOptimizer draws from NumPy's global state
    np.random.seed(0)
    suite = Suite(options.source)

    rows = []
    for case in cases():
        failure = quietly(suite.failure, case)
        rows.append({"test": case.test, "case": case.name, "failure": failure})
        if options.list and failure is None:
            print(f"    {case.test} ({case.name})")
    table = pd.DataFrame(rows)
    print(f"PySINDy {ps.__version__}\n\n{markdown(counted(table))}\n")

    failures = table.dropna(subset="failure")
    for row in failures.itertuples():
        print(f"    {row.test} ({row.case}): {row.failure}")
    return int(not failures["failure"].isin(REASONS.values()).all())


def counted(table: pd.DataFrame) -> pd.DataFrame:
    """Cases that pass, by test and in all."""
    passed = table["failure"].isna().groupby(table["test"], sort=False)
    counts = passed.agg(["sum", "size"]).set_axis(["passed", "of"], axis=1)
    counts.loc["all"] = counts.sum()
    return counts.reset_index()


if __name__ == "__main__":
    sys.exit(main())
