"""Fuzzing of every file reader and of the model's JSON reader.

    python benchmarks/fuzz.py --seconds 1200   # over all readers
    python benchmarks/fuzz.py --target HDF5 --seconds 60 --seed 3
    # one file again, its error let through
    python benchmarks/fuzzing/worker.py HDF5 --seed 3 --only 1741

Small good files of every kind are damaged at random (bytes, sizes in headers, words,
JSON values) and read in a process of its own with 1.5 GB of memory above its start and
10 s for a file of some kB. A reader may read a file or refuse it with a typed error.
Anything else is a failure: another exception, a process that dies, a file that takes
too long or too much memory.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import search_path
import pandas as pd
from fuzzing.targets import TARGETS
from harness import markdown, options_of
from tqdm import tqdm

WORKER = Path(__file__).resolve().parent / "fuzzing" / "worker.py"
# seconds beyond the time given, for the start and for one file that takes long
GRACE = 60.0
LEAST_TIME = 0.5  # s, below which no process is started
MAX_TIME = 3600.0  # s for a number of files
SHOWN = 10  # failures of a reader


@dataclass(frozen=True)
class Failure:
    """What failed, at which number of a file, and how."""

    kind: str
    case: int
    error: str


@dataclass
class Fuzzed:
    """Files read and refused, peak memory (MB), and failures of one reader."""

    target: str
    read: int = 0
    refused: int = 0
    peak: float = 0.0
    failures: list[Failure] = field(default_factory=list)

    @property
    def files(self) -> int:
        return self.read + self.refused + len(self.failures)

    def add(self, lines: list[str]) -> bool:
        """What a process printed; whether it came to its end."""
        finished = False
        for line in lines:
            message = json.loads(line)
            if "counts" in message:
                finished = True
                self.read += message["counts"]["read"]
                self.refused += message["counts"]["refused"]
                self.peak = max(self.peak, message["peak"] / 1e3)
            else:
                self.failures.append(Failure(**message))
        return finished


def fuzz(
    name: str, seed: int, seconds: float = MAX_TIME, n_files: float = math.inf
) -> Fuzzed:
    """Read damaged files of one kind for some seconds, or a number of them."""
    result = Fuzzed(name)
    first = 0
    spent = 0.0
    while spent < seconds - LEAST_TIME and first < n_files:
        began = time.monotonic()
        process = run_worker(name, seed, (first, n_files), seconds - spent)
        spent += time.monotonic() - began
        if result.add(process.stdout.splitlines()):
            break
        stopped_at = last_case(process.stderr)
        if process.returncode is None:
            # in a library that no alarm of Python's wakes
            stopped_at = first if stopped_at is None else stopped_at
            kind, error = "hang", "the process had to be killed"
        elif stopped_at is None:
            reason = process.stderr[-3000:]
            raise RuntimeError(f"the worker for {name} does not start:\n{reason}")
        else:
            kind, error = "died", f"the process ended with {process.returncode}"
        result.failures.append(Failure(f"{name}: {kind}", stopped_at, error))
        result.refused += stopped_at - first
        first = stopped_at + 1
    return result


@dataclass(frozen=True)
class Ended:
    """A worker's output; no return code if it had to be killed."""

    stdout: str
    stderr: str
    returncode: int | None


def run_worker(
    name: str, seed: int, numbers: tuple[float, float], seconds: float
) -> Ended:
    """A process that reads damaged files from one number to another."""
    first, stop = numbers
    command = [sys.executable, str(WORKER), name, "--seed", str(seed)]
    command += ["--first", str(first), "--stop", str(stop), "--seconds", str(seconds)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        stdout, stderr = process.communicate(timeout=seconds + GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        # its failures before the hang are lost with its output
        _, stderr = process.communicate()
        return Ended("", stderr, None)
    return Ended(stdout, stderr, process.returncode)


def last_case(stderr: str) -> int | None:
    """The file that a worker read last."""
    numbers = [line for line in stderr.splitlines() if line.isdigit()]
    return int(numbers[-1]) if numbers else None


def summary(results: list[Fuzzed]) -> pd.DataFrame:
    rows = []
    for result in results:
        row = {
            "reader": result.target,
            "files": result.files,
            "read": result.read,
            "refused by name": result.refused,
            "failed": len(result.failures),
            "peak, MB": round(result.peak),
        }
        rows.append(row)
    return pd.DataFrame(rows)


def main(arguments: list[str] | None = None) -> int:
    """Fuzz; the exit code says whether anything failed."""
    parser = options_of(__doc__)
    parser.add_argument(
        "--seconds", type=float, default=1200.0, help="over all targets"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--target", action="append", choices=sorted(TARGETS))
    options = parser.parse_args(arguments)
    names = options.target or list(TARGETS)
    seconds = options.seconds / len(names)
    results = []
    for name in tqdm(names, unit="reader", disable=None):
        results.append(fuzz(name, options.seed, seconds))

    table = summary(results)
    n_failed = table["failed"].sum()
    print(markdown(table))
    print(
        f"\n{table['files'].sum()} files, {n_failed} failures (crash, hang, memory,"
        " death of the process)."
    )
    for result in results:
        for failure in result.failures[:SHOWN]:
            place = f"case {failure.case} of seed {options.seed}"
            print(f"{failure.kind} at {place}: {failure.error}")
    return int(n_failed > 0)


if __name__ == "__main__":
    sys.exit(main())
