"""PySINDy's own tests of its contract for libraries and optimizers, run with the
classes of this package.

    pip download --no-binary :all: --no-deps pysindy==2.1.0
    tar xf pysindy-2.1.0.tar.gz
    python benchmarks/pysindy_contract.py pysindy-2.1.0 [--list]

The tests are read from PySINDy's source distribution, which PyPI holds; none is copied
here. Test functions and the data they ask for are taken out of their files, and called
with our libraries and optimizers where PySINDy passes its own: neither pytest's
collection nor PySINDy's optional solvers (cvxpy, gurobi, jax) are needed. PySINDy's
tests double the single column of their data for its optimizers that need more
(``_align_optimizer_and_1dfeatures``); they are told that a state-space model, which
reads velocity and force, is one of these.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import sys
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pysindy as ps
from sklearn.base import clone

from pysindy_nrf import (
    ChainOptimizer,
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
    StateSpaceChainOptimizer,
    laws,
)

FILES = (
    "conftest.py",
    "test_feature_library.py",
    "test_optimizers/test_optimizers.py",
    "test_pysindy.py",
)
# Cases that fail for a reason.
REASONS = {
    ("feature_library:change_in_data_shape", "times PySINDy's"): (
        "an IndexError of PySINDy's TensoredLibrary, which takes its factors' columns"
        " by number; PolynomialLibrary() * PolynomialLibrary() fails alike"
    ),
}


def definitions(path: Path) -> dict[str, Any]:
    """Functions and imported names of a test file, without decorators; what is not
    installed is an empty class.
    """
    tree, names = ast.parse(path.read_text()), {}
    for node in tree.body:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            for alias in node.names:
                one = type(node)(**{**vars(node), "names": [alias]})
                try:
                    exec(compile(ast.Module([one], []), str(path), "exec"), names)
                except ImportError:
                    names[alias.asname or alias.name] = type(alias.name, (), {})
        elif isinstance(node, ast.FunctionDef):
            node.decorator_list = []
            for argument in (*node.args.args, node):
                argument.annotation = argument.returns = None
            exec(compile(ast.Module([node], []), str(path), "exec"), names)
    return names


def aligned(optimizer: Any, features: np.ndarray) -> tuple[Any, np.ndarray]:
    """PySINDy's helper, for our class that needs two columns."""
    return optimizer, (
        np.hstack([features, features])
        if isinstance(optimizer, StateSpaceChainOptimizer)
        else features
    )


def libraries() -> dict[str, tuple[Any, int]]:
    """Libraries of ours, and how many features they make of three columns: a, v, s or
    x, xdot, F of one DOF.
    """
    duffing, extra = (
        [laws.LinearViscous(), laws.Duffing()],
        ps.PolynomialLibrary(1, include_bias=False),
    )
    return {
        "polynomial": (InterstoryPolynomialLibrary(3), 1 + 9),
        "polynomial box": (InterstoryPolynomialLibrary((1, 2)), 1 + 5),
        "polynomial, state": (
            InterstoryPolynomialLibrary(3, inputs="state"),
            1 + 9 + 1,
        ),
        "laws": (ForceLawLibrary(duffing), 1 + 3),
        "laws, state": (ForceLawLibrary(duffing, inputs="state"), 1 + 3 + 1),
        "laws with memory": (
            ForceLawLibrary([*duffing, laws.Dahl(sigma=1.0)], dt=0.1),
            1 + 4,
        ),
        "sum": (
            InterstoryPolynomialLibrary(1) + ForceLawLibrary([laws.CoulombFriction()]),
            1 + 3,
        ),
        "beside PySINDy's": (InterstoryPolynomialLibrary(2) + extra, 1 + 5 + 3),
        "times PySINDy's": (ForceLawLibrary(duffing) * extra, 4 * 3),
    }


def optimizers() -> dict[str, Any]:
    """What runs on the balances."""
    return {
        "least squares": None,
        "STLSQ": ps.STLSQ(threshold=1e-3),
        "SR3": ps.SR3(),
        "SSR": ps.SSR(),
        "FROLS": ps.FROLS(),
        "library ensemble": ps.EnsembleOptimizer(
            ps.STLSQ(threshold=1e-3), library_ensemble=True, n_models=4
        ),
    }


def cases() -> list[tuple[str, str, dict[str, Any]]]:
    """Test, what of ours it is given, and the arguments that are no data."""
    out: list[tuple[str, str, dict[str, Any]]] = []
    for name, (library, size) in libraries().items():
        for test in (
            "fit_transform",
            "change_in_data_shape",
            "get_feature_names",
            "not_fitted",
            "output_shape",
        ):
            given = {"library": clone(library)} | (
                {"shape": size} if test == "output_shape" else {}
            )
            out.append((f"feature_library:{test}", name, given))
        out.append(("pysindy:libraries", name, {"library": clone(library)}))
    for kind in (ChainOptimizer, StateSpaceChainOptimizer):
        out.append(
            (
                "optimizers:supports_multiple_targets",
                kind.__name__,
                {"cls": kind, "support": True},
            )
        )
        # ten monomials of three columns and their three derivatives: terms of three
        # storeys
        terms = [3, 2, 2] if kind is ChainOptimizer else [2, 1, 1]
        out.append(
            (
                "optimizers:pickle",
                kind.__name__,
                {"opt_cls": kind, "opt_args": {"terms": terms}},
            )
        )
        for data, counts in (("data_1d", None), ("data_lorenz", terms)):
            given = {"data": data, "optimizer": kind(terms=counts)}
            out.append(("pysindy:predict", f"{kind.__name__}, {data}", given))
        for name, inner in optimizers().items():
            for test in ("fit", "not_fitted", "complexity_not_fitted"):
                out.append(
                    (
                        f"optimizers:{test}",
                        f"{kind.__name__}, {name}",
                        {"optimizer": kind(inner)},
                    )
                )
            weighted = {"optimizer": partial(kind, inner)}
            out.append(
                (
                    "optimizers:sample_weight_optimizers",
                    f"{kind.__name__}, {name}",
                    weighted,
                )
            )
    return out


def main() -> int:
    """Run the tests, print what passes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "source", type=Path, help="the unpacked source distribution of PySINDy"
    )
    parser.add_argument("--list", action="store_true", help="name every case")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    np.random.seed(0)  # noqa: NPY002  EnsembleOptimizer draws from it
    held = {
        path.rpartition("/")[2]: definitions(given.source / "test" / path)
        for path in FILES
    }
    held["test_optimizers.py"]["_align_optimizer_and_1dfeatures"] = aligned
    fixtures = held["conftest.py"]
    print(f"PySINDy {ps.__version__}\n\n| test | passed | of |\n|---|---|---|")
    counts: dict[str, list[int]] = {}
    failures = []
    for test, name, arguments in cases():
        file, _, function = test.partition(":")
        call = held[f"test_{file}.py"][f"test_{function}"]
        wanted = inspect.signature(call).parameters
        data = {key: fixtures[key]() for key in wanted if key.startswith("data_")}
        data |= {key: None for key in wanted if key == "set_jax_pcc_env"}
        data |= {
            key: fixtures[value]() for key, value in arguments.items() if key == "data"
        }
        passed, of = counts.setdefault(test, [0, 0])
        try:
            call(**{**arguments, **data})
        except BaseException as error:  # pytest's own failures are no Exception
            first = (str(error).splitlines() or [type(error).__name__])[0]
            failures.append(f"    {test} ({name}): {REASONS.get((test, name), first)}")
        else:
            passed += 1
            if given.list:
                print(f"    {test} ({name})")
        counts[test] = [passed, of + 1]
    for test, (passed, of) in counts.items():
        print(f"| {test} | {passed} | {of} |")
    passed, of = (sum(column) for column in zip(*counts.values()))
    print(f"| all | {passed} | {of} |\n")
    print(*failures, sep="\n")
    return int(any(line.split(": ", 1)[1] not in REASONS.values() for line in failures))


if __name__ == "__main__":
    sys.exit(main())
