"""Mutation testing: how many small faults put into the core do the tests notice?

    python benchmarks/mutation.py --part chain_solve --sample 20      # a quick look
    python benchmarks/mutation.py                                     # the benchmark setting: 120 mutants of each part
    python benchmarks/mutation.py --sample 0                          # every mutant: days

Needs cosmic-ray (pip install cosmic-ray). Package and tests are copied to a temporary folder, one
fault at a time is put into the copy (an operator exchanged, a number off by one, a condition turned
round, ...), and the tests that belong to the part are run on it until the first one fails. A mutant is
killed if a test fails or the run takes ten times as long as without it. Faults inside type annotations
and of decorators change nothing that runs and are left out. Survivors are printed with their line:
each is either a test to write or a fault without effect (a tolerance, a speed-up).
"""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]

# Part -> what is mutated, and the tests that answer for it, the fastest first.
PARTS = {
    "chain_solve": (
        ["pysindy_nrf/chain_solve.py"],
        ["tests/test_properties.py", "tests/test_solve.py", "tests/test_regressor.py", "tests/test_bad_input.py"],
    ),
    "moments": (
        ["pysindy_nrf/moments.py", "pysindy_nrf/gram.py"],
        ["tests/test_moments.py", "tests/test_solve.py", "tests/test_properties.py"],
    ),
    "laws": (["pysindy_nrf/laws"], ["tests/test_laws.py", "tests/test_memory.py", "tests/test_compiled.py"]),
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

CONFIG = """[cosmic-ray]
module-path = {modules}
timeout = {timeout}
excluded-modules = []
test-command = "{command}"

[cosmic-ray.distributor]
name = "local"
"""


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


def sampled(session: Path, home: Path, count: int, seed: int) -> int:
    """Leave a random sample of the mutants in a session; the number left."""
    from cosmic_ray.work_db import WorkDB, use_db

    with use_db(str(session), WorkDB.Mode.open) as db:
        items = list(db.work_items)
    idle: dict[Path, set[tuple[int, int]]] = {}
    chosen = []
    for item in items:
        mutation = item.mutations[0]
        where = home / mutation.module_path
        at = idle.setdefault(where, idle_lines(where))
        if mutation.start_pos not in at and not any(skipped in mutation.operator_name for skipped in SKIPPED):
            chosen.append(item)
    if count and len(chosen) > count:
        picked = np.random.default_rng(seed).choice(len(chosen), count, replace=False)
        chosen = [chosen[i] for i in sorted(picked)]
    session.unlink()
    with use_db(str(session), WorkDB.Mode.create) as db:
        db.add_work_items(chosen)
    return len(chosen)


def run(part: str, count: int, seed: int, chosen: list[str] | None = None) -> dict:
    """Mutate one part; killed, survived and the survivors' lines."""
    from cosmic_ray.work_db import WorkDB, use_db

    modules, tests = PARTS[part]
    tests = chosen or tests
    with tempfile.TemporaryDirectory(prefix="mutants") as folder:
        home = copied(Path(folder))
        modules = [m for m in modules if (home / m).exists()]
        tests = [t for t in tests if (home / t).exists()]
        command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider {' '.join(tests)}"
        env = {**os.environ, "PYTHONPATH": str(home), "NUMBA_CACHE_DIR": str(home / "numba")}
        began = time.monotonic()
        clean = subprocess.run(command.split(), cwd=home, env=env, capture_output=True, text=True)
        if clean.returncode:
            raise RuntimeError(f"the tests of {part} fail without a fault in the code:\n{clean.stdout[-3000:]}")
        took = time.monotonic() - began
        config, session = home / "mutation.toml", home / "session.sqlite"
        config.write_text(CONFIG.format(modules=modules, timeout=round(10 * took + 30, 1), command=command))
        for step in (["init", config.name, session.name], ["exec", config.name, session.name]):
            if step[0] == "exec":
                left = sampled(session, home, count, seed)
            done = subprocess.run(
                [sys.executable, "-m", "cosmic_ray.cli", *step], cwd=home, env=env, capture_output=True, text=True
            )
            if done.returncode:
                raise RuntimeError(f"cosmic-ray {step[0]} fails:\n{done.stderr[-3000:]}")
        survivors, killed, invalid = [], 0, 0
        with use_db(str(session), WorkDB.Mode.open) as db:
            for item, result in db.completed_work_items:
                mutation = item.mutations[0]
                if result.test_outcome is None or "incompetent" in str(result.test_outcome).lower():
                    invalid += 1
                elif "survived" in str(result.test_outcome).lower():
                    line = (home / mutation.module_path).read_text().splitlines()[mutation.start_pos[0] - 1].strip()
                    name = mutation.operator_name.removeprefix("core/")
                    survivors.append(f"{mutation.module_path}:{mutation.start_pos[0]} {name}: {line}")
                else:
                    killed += 1
    return {"part": part, "mutants": left, "killed": killed, "invalid": invalid, "survivors": survivors}


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
