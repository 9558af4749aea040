"""One process that reads damaged files of one kind until its time is up or a number
of files is read; its limits are the operating system's.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzzing.damage import damaged  # noqa: E402
from fuzzing.targets import TARGETS  # noqa: E402

HANG = 10  # s that reading a file of some kB may take
MEMORY = 1_500_000_000  # bytes above what the process needs before it reads anything


class Hang(BaseException):
    """A file was read for too long."""


def _alarm(*_: object) -> None:
    raise Hang


def main() -> None:
    """Read files ``first``, ``first + 1``, ...; one line of JSON for each failure, the
    counts last.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument(
        "--stop", type=int, help="number of the file before which to stop"
    )
    parser.add_argument(
        "--only", type=int, help="read this one file and let its error through"
    )
    options = parser.parse_args()
    from pysindy_nrf.exceptions import MissingExtraError, NRFError

    warnings.simplefilter("ignore")
    chosen = (
        list(TARGETS.values()) if options.target == "all" else [TARGETS[options.target]]
    )
    good = {target.name: target.seeds() for target in chosen}
    with tempfile.TemporaryDirectory() as folder:
        # good files are read, and everything is imported before the memory is limited
        for target in chosen:
            for seed in good[target.name]:
                path = Path(folder, "test" + target.suffix)
                path.write_bytes(seed)
                target.read(path)
        used = (
            int(Path("/proc/self/statm").read_text().split()[0])
            * resource.getpagesize()
        )
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
        signal.signal(signal.SIGALRM, _alarm)
        counts = {"read": 0, "refused": 0, "failed": 0}
        end, i = time.monotonic() + options.seconds, options.first
        stop = np.inf if options.stop is None else options.stop
        while (time.monotonic() < end and i < stop) or options.only is not None:
            i = i if options.only is None else options.only
            target = chosen[i % len(chosen)]
            path = Path(folder, "test" + target.suffix)
            number = sorted(TARGETS).index(target.name)
            path.write_bytes(
                damaged(
                    target,
                    good[target.name],
                    np.random.default_rng([options.seed, number, i]),
                )
            )
            print(
                i, file=sys.stderr, flush=True
            )  # the last line says what a process died of
            if options.only is not None:
                print(repr(path.read_bytes()[:2000]))
                target.read(path)
                return
            signal.setitimer(signal.ITIMER_REAL, HANG)
            try:
                target.read(path)
                counts["read"] += 1
            except (NRFError, MissingExtraError):
                counts["refused"] += 1
            except BaseException as error:
                signal.setitimer(signal.ITIMER_REAL, 0)
                counts["failed"] += 1
                kind = (
                    "hang"
                    if isinstance(error, Hang)
                    else "memory"
                    if isinstance(error, MemoryError)
                    else "crash"
                )
                said = f"{type(error).__name__}: {error}"[:300]
                print(
                    json.dumps(
                        {"kind": f"{target.name}: {kind}", "case": i, "error": said}
                    ),
                    flush=True,
                )
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
            i += 1
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({"counts": counts, "next": i, "peak": peak}), flush=True)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
