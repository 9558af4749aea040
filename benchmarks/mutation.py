"""Mutation testing: how many small faults put into the core do the tests notice?

    python benchmarks/mutation.py --part chain_solve --sample 20      # a quick look
    python benchmarks/mutation.py                                     # the benchmark setting: 120 mutants of each part
    python benchmarks/mutation.py --sample 0                          # every mutant: days

Needs cosmic-ray and pytest-cov (pip install cosmic-ray pytest-cov) and a system that forks (Linux, macOS).
Package and tests are copied to a temporary folder, and one fault at a time is put into the copy (an
operator exchanged, a number off by one, a condition turned round, ...). Of the test files that belong to
the part those tests are run on it that come by the faulty line, the fastest first, until one fails; a
fault in what a module does when it is imported (a constant), or in compiled code, is put before every
test that comes by the module. Tests beyond two minutes for one fault are not run: what they alone would
notice counts as survived. A mutant is killed if a test fails or the tests take ten times as long as
without it. One process imports the libraries; every run is a fork of it that imports the package anew.
Faults inside type annotations and of decorators change nothing that runs and are left out. Survivors
are printed with their line: each is either a test to write or a fault without effect (a tolerance, a
speed-up).
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
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
            "tests/test_discrepancy_statistics.py",
            "tests/test_discrepancy_noise.py",
            "tests/test_loop_battery.py",
            "tests/test_loop_seams.py",
            "tests/test_leftover.py",
            "tests/test_residual.py",
            "tests/test_detection.py",
            "tests/test_localisation.py",
            "tests/test_characterisation.py",
            "tests/test_projection.py",
            "tests/test_splits.py",
            "tests/test_catalogue.py",
            "tests/test_rare_stops.py",
            "tests/test_evidence.py",
            "tests/test_channel_doubts.py",
            "tests/test_close_loop_names.py",
            "tests/test_close_loop_noise_floor.py",
            "tests/test_loop_corners.py",
            "tests/test_second_opinion.py",
            "tests/test_close_loop.py",
        ],
    ),
}
# Mutants that turn one binary operator into every other are mostly type errors; these are the telling ones.
SKIPPED = ("_BitOr", "_BitAnd", "_BitXor", "_RShift", "_LShift", "_Mod", "_FloorDiv", "RemoveDecorator")
MOST_SECONDS = 120  # of tests for one fault
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


def passes(home: Path, tests: list[str], limit: float = np.inf, cover: str = "") -> bool:
    """Whether some tests pass on the copy within some seconds, in a fork of this process.

    What is imported here (:data:`LIBRARIES`) need not be imported again there; the package is. What it prints is in
    ``log``. ``cover`` is the folder of the package whose lines are noted, with the tests that come by them.
    """
    child = os.fork()
    if not child:
        _test(home, tests, limit == np.inf, cover)
    end = time.monotonic() + limit
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status == 0
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


class _Clock:
    """Notes how long each test takes."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration


def _test(home: Path, tests: list[str], keep: bool, cover: str) -> None:
    """Run tests in a forked process, which ends here; ``keep`` its byte code for the next."""
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
        clock = _Clock()
        noting = [f"--cov={cover}", "--cov-context=test", "--cov-report="] if cover else []
        code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *noting, *tests], plugins=[clock]))
        if cover:
            (home / "seconds.json").write_text(json.dumps(clock.seconds))
    finally:
        sys.stdout.flush()
        os._exit(code)


class Witnesses:
    """Which tests come by which line, and how long they take."""

    def __init__(self, home: Path, modules: list[str], tests: list[str]) -> None:
        from coverage import CoverageData

        if not passes(home, tests, cover=str(Path(modules[0]).parent if modules[0].endswith(".py") else modules[0])):
            tail = (home / "log").read_text(errors="replace")[-3000:]
            raise RuntimeError(f"The tests fail without a fault in the code:\n{tail}")
        self.seconds: dict[str, float] = json.loads((home / "seconds.json").read_text())
        self.data = CoverageData(str(home / ".coverage"))
        self.data.read()

    def of(self, path: Path, line: int) -> list[str]:
        """Tests that come by a line, the fastest first; by its module if none does but its import."""
        lines = self.data.contexts_by_lineno(str(path))
        names = {c.rpartition("|")[0] for c in lines.get(line, [])} - {""}
        names = names or {c.rpartition("|")[0] for held in lines.values() for c in held} - {""}
        chosen, total = [], 0.0
        for name in sorted(names & self.seconds.keys(), key=self.seconds.__getitem__):
            total += self.seconds[name]
            if total > MOST_SECONDS:
                break
            chosen.append(name)
        return chosen


def run(part: str, count: int, seed: int, chosen: list[str] | None = None) -> dict:
    """Mutate one part; killed, survived and the survivors' lines."""
    modules, tests = PARTS[part]
    for name in LIBRARIES:
        importlib.import_module(name)
    killed, survivors = 0, []
    with tempfile.TemporaryDirectory(prefix="mutants") as folder:
        home = copied(Path(folder).resolve())
        witnesses = Witnesses(home, modules, chosen or tests)
        every = mutants(home, modules, count, seed)
        for mutation in every:
            line = mutation.module_path.read_text(encoding="utf-8").splitlines()[mutation.start_pos[0] - 1].strip()
            called = witnesses.of(mutation.module_path, mutation.start_pos[0])
            limit = 10 * sum(witnesses.seconds[name] for name in called) + 30
            with faulty(mutation):
                alive = not called or passes(home, called, limit)
            if alive:
                where = f"{mutation.module_path.relative_to(home)}:{mutation.start_pos[0]}"
                survivors.append(f"{where} {mutation.operator_name.removeprefix('core/')}: {line}")
                print(f"survived: {survivors[-1]}", file=sys.stderr, flush=True)
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
        import pytest_cov  # noqa: F401
    except ImportError:
        print("Mutation testing needs cosmic-ray and pytest-cov: pip install cosmic-ray pytest-cov", file=sys.stderr)
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
