"""One process that reads damaged files of one kind.

It stops when its time is up or a number of files is read. Its limits are the operating
system's.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
HANG = 10  # s that reading a file of some kB may take
MEMORY = 1_500_000_000  # bytes above what the process needs before it reads anything


class Hang(BaseException):
    """A file was read for too long."""


def stop_reading(*_: object) -> None:
    raise Hang


@dataclass(frozen=True)
class Files:
    """Damaged files of some targets, written one after the other to one place."""

    targets: list
    seeds: dict[str, list[bytes]]
    folder: Path
    seed: int

    def path(self, target) -> Path:
        return self.folder / f"test{target.suffix}"

    def read_good_ones(self) -> None:
        """Import everything that reading needs."""
        for target in self.targets:
            for content in self.seeds[target.name]:
                path = self.path(target)
                path.write_bytes(content)
                target.read(path)

    def write(self, case: int) -> tuple:
        """The target and the path of a damaged file."""
        import numpy as np

        from fuzzing.damage import damaged
        from fuzzing.targets import TARGETS

        target = self.targets[case % len(self.targets)]
        number = sorted(TARGETS).index(target.name)
        rng = np.random.default_rng([self.seed, number, case])
        path = self.path(target)
        path.write_bytes(damaged(target, self.seeds[target.name], rng))
        # the last line says what a process died of
        print(case, file=sys.stderr, flush=True)
        return target, path


def limit_memory() -> None:
    """Allow some memory above what is used now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def outcome(target, path: Path) -> tuple[str, BaseException | None]:
    """Whether a file was read, refused by name, or failed."""
    from pysindy_nrf.exceptions import MissingExtraError, NRFError

    signal.setitimer(signal.ITIMER_REAL, HANG)
    try:
        target.read(path)
    except (NRFError, MissingExtraError):
        return "refused", None
    except BaseException as error:
        return "failed", error
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return "read", None


def print_failure(target, case: int, error: BaseException) -> None:
    kind = "crash"
    if isinstance(error, Hang):
        kind = "hang"
    elif isinstance(error, MemoryError):
        kind = "memory"
    text = f"{type(error).__name__}: {error}"[:300]
    message = {"kind": f"{target.name}: {kind}", "case": case, "error": text}
    print(json.dumps(message), flush=True)


def read_files(files: Files, first: int, stop: float, seconds: float) -> None:
    """Read files from one number to another; print failures, and the counts last."""
    limit_memory()
    signal.signal(signal.SIGALRM, stop_reading)
    counts = {"read": 0, "refused": 0, "failed": 0}
    end = time.monotonic() + seconds
    case = first
    while time.monotonic() < end and case < stop:
        target, path = files.write(case)
        result, error = outcome(target, path)
        counts[result] += 1
        if error is not None:
            print_failure(target, case, error)
        case += 1
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({"counts": counts, "next": case, "peak": peak}), flush=True)


def main() -> None:
    """Read files ``first``, ``first + 1``, ...; or one alone."""
    # run as a script, it finds the package that it is part of here
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from fuzzing.targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", choices=["all", *TARGETS])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument(
        "--stop", type=float, default=math.inf, help="file before which to stop"
    )
    parser.add_argument(
        "--only", type=int, help="read this one file and let its error through"
    )
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    targets = [TARGETS[options.target]] if options.target != "all" else []
    targets = targets or list(TARGETS.values())
    seeds = {target.name: target.seeds() for target in targets}
    with tempfile.TemporaryDirectory() as folder:
        files = Files(targets, seeds, Path(folder), options.seed)
        files.read_good_ones()
        if options.only is None:
            read_files(files, options.first, options.stop, options.seconds)
        else:
            target, path = files.write(options.only)
            print(repr(path.read_bytes()[:2000]))
            target.read(path)


if __name__ == "__main__":
    main()
