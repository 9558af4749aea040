"""Mutation testing: how many small faults put into the core do the tests notice?

    python benchmarks/mutation.py --part chain_solve --sample 20      # a quick look
    python benchmarks/mutation.py                                     # the benchmark setting: 120 mutants of each part
    python benchmarks/mutation.py --sample 0                          # every mutant: days

Needs cosmic-ray (pip install cosmic-ray) and a system that forks (Linux, macOS). Package and tests are
copied to a temporary folder, one fault at a time is put into the copy (an operator exchanged, a number
off by one, a condition turned round, ...), and the test files that belong to the part are run on it, one
after the other, until a test fails. A mutant is killed if a test fails or a file takes ten times as long
as without it. One process imports the libraries; every run is a fork of it that imports the package
anew. Faults inside type annotations and of decorators change nothing that runs and are left out.
Survivors are printed with their line: each is either a test to write or a fault without effect (a
tolerance, a speed-up).
"""

from __future__ import annotations

import argparse
import ast
import importlib
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]

# Part -> what is mutated, and the tests that answer for it, the fastest first.
PARTS = {
    "chain_solve": (
        ["pysindy_nrf/chain_solve.py"],
        [
            "tests/test_chain_solve.py",
            "tests/test_regressor.py",
            "tests/test_properties.py",
            "tests/test_bad_input.py",
            "tests/test_solve.py",
        ],
    ),
    "moments": (
        ["pysindy_nrf/moments.py", "pysindy_nrf/gram.py"],
        ["tests/test_gram.py", "tests/test_moments.py", "tests/test_properties.py", "tests/test_solve.py"],
    ),
    "laws": (
        ["pysindy_nrf/laws"],
        ["tests/test_laws_exact.py", "tests/test_laws.py", "tests/test_memory.py", "tests/test_compiled.py"],
    ),
    "discrepancy": (
        ["pysindy_nrf/discrepancy"],
        [
            "tests/test_residual.py",
            "tests/test_detection.py",
            "tests/test_localisation.py",
            "tests/test_characterisation.py",
            "tests/test_close_loop.py",
        ],
    ),
}
# Mutants that turn one binary operator into every other are mostly type errors; these are the telling ones.
SKIPPED = ("_BitOr", "_BitAnd", "_BitXor", "_RShift", "_LShift", "_Mod", "_FloorDiv", "RemoveDecorator")
# Imported once, before the package; every run of the tests is a fork of this process.
LIBRARIES = (
    "scipy.linalg",
    "scipy.signal",
    "scipy.optimize",
    "pandas",
    "sklearn.linear_model",
    "pysindy",
    "numba",
    "pytest",
    "hypothesis",
)


def copied(folder: Path) -> Path:
    """Package and tests in a folder of their own, without compiled code."""
    home = folder / "copy"
    leave_out = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc", ".pytest_cache")
    for name in ("pysindy_nrf", "tests", "benchmarks"):
        shutil.copytree(ROOT / name, home / name, ignore=leave_out)
    shutil.copy(ROOT / "pyproject.toml", home)
    return home


def idle_lines(path: Path) -> set[tuple[int, int]]:
    """Positions (line, column) inside annotations, which ``from __future__ import annotations`` never evaluates."""
    out: set[tuple[int, int]] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        held = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        for top in (a for a in held if a is not None):
            for row in range(top.lineno, top.end_lineno + 1):
                first = top.col_offset if row == top.lineno else 0
                last = top.end_col_offset if row == top.end_lineno else 10_000
                out |= {(row, column) for column in range(first, min(last, 400))}
    return out


def mutants(home: Path, modules: list[str], count: int, seed: int) -> list:
    """A random sample of the faults that can be put into some modules, in the order of the files and lines."""
    from cosmic_ray.commands.init import init
    from cosmic_ray.modules import find_modules
    from cosmic_ray.work_db import use_db

    with use_db(":memory:") as db:
        init(find_modules([home / m for m in modules]), db, {})
        every = [item.mutations[0] for item in db.work_items]
    every.sort(key=lambda m: (str(m.module_path), m.start_pos, m.operator_name, m.occurrence))
    idle = {path: idle_lines(path) for path in {m.module_path for m in every}}
    chosen = [
        m for m in every if m.start_pos not in idle[m.module_path] and not any(s in m.operator_name for s in SKIPPED)
    ]
    if count and len(chosen) > count:
        picked = np.random.default_rng(seed).choice(len(chosen), count, replace=False)
        chosen = [chosen[i] for i in sorted(picked)]
    return chosen


@contextmanager
def faulty(mutation: Any) -> Iterator[None]:
    """Put a fault into its file; byte code is known by the time of its file, and this time is no other's."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    path, operator = mutation.module_path, get_operator(mutation.operator_name)(**mutation.operator_args)
    clean, stat = path.read_bytes(), path.stat()
    path.write_text(mutate_code(clean.decode("utf-8"), operator, mutation.occurrence), encoding="utf-8")
    os.utime(path, (0, 0))
    try:
        yield
    finally:
        path.write_bytes(clean)
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def passes(home: Path, test: str, limit: float = np.inf) -> bool:
    """Whether the tests of one file pass on the copy within some seconds, in a fork of this process.

    What is imported here (:data:`LIBRARIES`) need not be imported again there; the package is. What it prints is in
    ``log``.
    """
    child = os.fork()
    if not child:
        _test(home, test, keep=limit == np.inf)
    end = time.monotonic() + limit
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status == 0
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def _test(home: Path, test: str, keep: bool) -> None:
    """Run a test file in a forked process, which ends here; ``keep`` its byte code for the next."""
    code = 1
    try:
        os.setsid()
        sys.stdout = sys.stderr = log = open(home / "log", "w", encoding="utf-8")
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
        os.chdir(home)
        sys.path.insert(0, str(home))
        os.environ |= {"PYTHONPATH": str(home), "NUMBA_CACHE_DIR": str(home / "numba")}
        if not keep:
            os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
            sys.dont_write_bytecode = True
        import numba
        import pytest

        numba.config.reload_config()
        # The package knows compiled code by what it does; a fault elsewhere in its file is no reason to compile again.
        numba.core.caching._SourceFileBackedLocatorMixin.get_source_stamp = lambda self: None
        code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", test]))
    finally:
        sys.stdout.flush()
        os._exit(code)


def run(part: str, count: int, seed: int, chosen: list[str] | None = None) -> dict:
    """Mutate one part; killed, survived and the survivors' lines."""
    modules, tests = PARTS[part]
    tests = chosen or tests
    for name in LIBRARIES:
        importlib.import_module(name)
    killed, survivors = 0, []
    with tempfile.TemporaryDirectory(prefix="mutants") as folder:
        home = copied(Path(folder))
        limits = {}
        for test in tests:
            began = time.monotonic()
            if not passes(home, test):
                tail = (home / "log").read_text(errors="replace")[-3000:]
                raise RuntimeError(f"{test} fails without a fault in the code:\n{tail}")
            limits[test] = 10 * (time.monotonic() - began) + 30
        every = mutants(home, modules, count, seed)
        for mutation in every:
            line = mutation.module_path.read_text(encoding="utf-8").splitlines()[mutation.start_pos[0] - 1].strip()
            with faulty(mutation):
                alive = all(passes(home, test, limit) for test, limit in limits.items())
            if alive:
                where = f"{mutation.module_path.relative_to(home)}:{mutation.start_pos[0]}"
                survivors.append(f"{where} {mutation.operator_name.removeprefix('core/')}: {line}")
            killed += not alive
    return {"part": part, "mutants": len(every), "killed": killed, "survivors": survivors}


def main(arguments: list[str] | None = None) -> int:
    """Print the table; the exit code says whether 80 % were killed in every part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", nargs="+", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--sample", type=int, default=120, help="mutants of each part; 0 for all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tests", nargs="+", help="other tests than those of the part (a quick look)")
    o = parser.parse_args(arguments)
    try:
        import cosmic_ray  # noqa: F401
    except ImportError:
        print("Mutation testing needs cosmic-ray: pip install cosmic-ray", file=sys.stderr)
        return 1
    rows = []
    print("| part | mutants | killed | survived | killed % |\n|---|---|---|---|---|", flush=True)
    for part in o.part:
        found = run(part, o.sample, o.seed, o.tests)
        rows.append(found)
        alive = len(found["survivors"])
        share = 100 * found["killed"] / max(found["killed"] + alive, 1)
        print(f"| {part} | {found['mutants']} | {found['killed']} | {alive} | {share:.0f} |", flush=True)
    for found in rows:
        print(f"\nSurvivors of {found['part']}:")
        print("\n".join(f"  {line}" for line in found["survivors"]) or "  none")
    return int(any(r["killed"] < 0.8 * (r["killed"] + len(r["survivors"])) for r in rows))


if __name__ == "__main__":
    sys.exit(main())
