"""Fuzzing of every file reader and of the model's JSON reader.

    python benchmarks/fuzz.py --seconds 1200        # the benchmark setting: 20 minutes over all readers
    python benchmarks/fuzz.py --target HDF5 --seconds 60 --seed 3
    python benchmarks/fuzzing/worker.py HDF5 --seed 3 --only 1741        # one file again, its error let through

Small good files of every kind are damaged at random (bytes, sizes in headers, words,
JSON values) and read in a process of its own with 1.5 GB of memory above its start and
10 s for a file of some kB. A reader may read a file or refuse it with a typed error.
Anything else is a failure: another exception, a process that dies, a file that takes
too long or too much memory.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from fuzzing.targets import TARGETS  # noqa: E402
from tqdm import tqdm  # noqa: E402

# seconds beyond the time given, for the start and for one file that takes long
GRACE = 60.0


def fuzz(
    name: str, seed: int, seconds: float = 3600.0, n_files: int | None = None
) -> dict:
    """Read damaged files of one kind for some seconds, or a number of them.

    Parameters
    ----------
    name : str
    seed : int
    seconds : float
    n_files : int, optional

    Returns
    -------
    dict
        ``read``, ``refused``, ``peak`` (MB) and ``failures`` (list of kind, case,
        error).
    """
    out = {"target": name, "read": 0, "refused": 0, "peak": 0.0, "failures": []}
    first, spent = 0, 0.0
    while spent < seconds - 0.5 and (n_files is None or first < n_files):
        worker = str(HERE / "fuzzing" / "worker.py")
        command = [
            sys.executable,
            worker,
            name,
            "--seed",
            str(seed),
            "--first",
            str(first),
        ]
        began = time.monotonic()
        command += ["--seconds", str(seconds - spent)]
        if n_files is not None:
            command += ["--stop", str(n_files)]
        try:
            run = subprocess.run(
                command, capture_output=True, text=True, timeout=seconds - spent + GRACE
            )
        except (
            subprocess.TimeoutExpired
        ) as error:  # in a library that no alarm of Python's wakes
            told = (error.stderr or b"").decode(errors="replace").split()
            stuck = int(told[-1]) if told and told[-1].isdigit() else first
            out["failures"].append(
                (f"{name}: hang", stuck, "the process had to be killed")
            )
            out["refused"] += stuck - first
            first, spent = stuck + 1, spent + time.monotonic() - began
            continue
        spent += time.monotonic() - began
        last = {}
        for line in run.stdout.splitlines():
            said = json.loads(line)
            if "counts" in said:
                last = said
            else:
                out["failures"].append((said["kind"], said["case"], said["error"]))
        if last:
            out["read"] += last["counts"]["read"]
            out["refused"] += last["counts"]["refused"]
            out["peak"] = max(out["peak"], last["peak"] / 1e3)
            break
        cases = [line for line in run.stderr.splitlines() if line.isdigit()]
        if not cases:
            raise RuntimeError(
                f"the worker for {name} does not start:\n{run.stderr[-3000:]}"
            )
        died = int(cases[-1])
        out["failures"].append(
            (f"{name}: died", died, f"the process ended with {run.returncode}")
        )
        out["refused"] += died - first
        first = died + 1
    return out


def main() -> int:
    """Fuzz; the exit code says whether anything failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seconds", type=float, default=1200.0, help="over all targets"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--target", action="append", choices=sorted(TARGETS))
    options = parser.parse_args()
    names = options.target or list(TARGETS)
    rows = [
        fuzz(name, options.seed, options.seconds / len(names))
        for name in tqdm(names, unit="reader", disable=None)
    ]
    print(
        "| reader | files | read | refused by name | failed | peak, MB"
        " |\n|---|---|---|---|---|---|"
    )
    for r in rows:
        failed = len(r["failures"])
        cells = (
            r["target"],
            r["read"] + r["refused"] + failed,
            r["read"],
            r["refused"],
            failed,
            round(r["peak"]),
        )
        print(f"| {' | '.join(map(str, cells))} |")
    total, failed = (
        sum(r["read"] + r["refused"] for r in rows),
        sum(len(r["failures"]) for r in rows),
    )
    print(
        f"\n{total + failed} files, {failed} failures (crash, hang, memory, death of"
        " the process)."
    )
    for r in rows:
        for kind, case, error in r["failures"][:10]:
            print(f"{kind} at case {case} of seed {options.seed}: {error}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
