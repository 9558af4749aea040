"""Where people wait: processor time, peak memory and shares by phase.

    python benchmarks/where_people_wait.py --quick          # small cases: minutes
    python benchmarks/where_people_wait.py                  # an hour on one core
    python benchmarks/where_people_wait.py --only loop fit  # some parts
    python benchmarks/where_people_wait.py --write          # into docs/benchmarks.md

Parts: start, fit, loop, battery, measured. What a user starts is measured in a process
of its own. The demo is run cold (nothing compiled yet) and warm. Everything else is
warm: each process first runs a small case of the same kind, which is not counted.
Processor time is that of the process and all its threads; with other programs on the
machine it is 10 to 30 % longer than on an idle one. ``peak`` is the largest memory of
the process, ``data`` the size of the record. Shares are those of the functions that the
measured one calls.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import os
import platform
import pstats
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from datetime import date
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import search_path

# pandas, the package and the other benchmarks are imported where they are used: a
# process that is measured loads what its own case needs

PAGE = search_path.ROOT / "docs" / "benchmarks.md"
BEGIN = "<!-- tables of where_people_wait.py -->"
END = "<!-- end of the tables -->"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
N_BATTERY = 30
PARTS = ("start", "fit", "loop", "battery", "measured")
MAX_PROFILED = 120.0  # s; longer runs are not repeated under the profiler
LEAST_SHARE = 0.03  # of the time, below which a function is not named
SPLIT_SHARE = 0.85  # a function that calls one with more is followed down

Run = Callable[[], Any]


# -- what is measured ----------------------------------------------------------


def chain(n: int, n_samples: int) -> Any:
    """A record of a chain, made in a process whose memory is not counted."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(simulated, n, n_samples).result()


def simulated(n: int, n_samples: int) -> Any:
    """Duffing storeys in random motion, forced at the top, 2 % noise."""
    import chains

    from pysindy_nrf.simulation.noise import add_noise

    case = chains.duffing(n, [n], seed=1, n_samples=n_samples)
    return add_noise(case.record(), 0.02, random_state=0)


def fused_arrays(n: int, n_samples: int) -> tuple[Any, Any]:
    X, F = chain(n, n_samples).to_features()
    return X.to_numpy(), F.to_numpy()


def fusion(n: int, n_samples: int) -> Run:
    """The fusion that a fit of a record needs."""
    return chain(n, n_samples).to_features


def fit_of_arrays(n: int, n_samples: int) -> Run:
    """A fit of fused motions."""
    from pysindy_nrf import NRFRegressor

    X, F = fused_arrays(n, n_samples)
    return lambda: NRFRegressor(degree=3).fit(X, F)


def fit_of_record(n: int, n_samples: int) -> Run:
    """A fit of a record, fusion, diagnosis and all."""
    from pysindy_nrf import NRFRegressor

    record = chain(n, n_samples)
    return lambda: NRFRegressor(degree=3).fit(record)


def intervals(n: int, n_samples: int) -> Run:
    """Confidence intervals of a fit."""
    from pysindy_nrf import NRFRegressor

    return NRFRegressor(degree=3).fit(chain(n, n_samples)).confidence_intervals


def orders(n: int, n_samples: int) -> Run:
    """Degrees 1 to 7 by held-out error."""
    from pysindy_nrf import select_order

    X, F = fused_arrays(n, n_samples)
    return lambda: select_order(X, F)


def identify(n: int, n_samples: int) -> Run:
    """The command on a CSV file, with its pages and figures."""
    from pysindy_nrf.cli.group import run

    folder = Path(tempfile.mkdtemp())
    path = folder / "test.csv"
    chain(n, n_samples).to_frame().to_csv(path)
    return lambda: run(["identify", str(path), "-o", str(folder / "out")])


def loop(n: int, n_samples: int) -> Run:
    """The closed loop from a linear model, the whole catalogue."""
    from pysindy_nrf import close_loop

    record = chain(n, n_samples)
    return lambda: close_loop(record)


def battery(n: int, seed: int) -> Run:
    """The closed loop on a case of the battery; n = 0: a small one."""
    from battery.formulas import KINDS
    from battery.generators import make_case
    from battery.scorer import baseline

    from pysindy_nrf import Record, close_loop

    size = {"n_samples": 2048, "largest": 2} if n == 0 else {}
    kind = KINDS[seed % len(KINDS)]
    case = make_case("wait", "blind", seed, 0.01, (kind,), **size)
    records = [Record(name="test", **channels) for channels in case.searched]
    return lambda: close_loop(records, baseline(case))


def measured(n: int, number: int) -> Run:
    """The closed loop on a record, by its number among those of measured_records.py."""
    from measured_records import SETS

    test = list(SETS.values())[number]
    records = test.load()
    return lambda: test.search(records)


CASES: dict[str, Callable[[int, int], Run]] = {
    "fusion": fusion,
    "fit(X, F)": fit_of_arrays,
    "fit(record)": fit_of_record,
    "intervals": intervals,
    "select_order": orders,
    "identify": identify,
    "close_loop": loop,
    "battery": battery,
    "measured": measured,
}
OF_FITS = (
    "fusion",
    "fit(X, F)",
    "fit(record)",
    "intervals",
    "select_order",
    "identify",
)
RATIO = "ratio"


# -- measuring -----------------------------------------------------------------


@dataclass(frozen=True)
class Wait:
    """Processor and wall time (s), peak memory (MB), and where the time goes."""

    cpu: float = float("nan")
    wall: float = float("nan")
    peak: float = float("nan")
    shares: str = ""


def fusion_over_fit(n: int, n_samples: int) -> Wait:
    """The fusion of a record and the fit that it feeds, in turns, medians of 15."""
    import numpy as np
    from harness import times_in_turns

    from pysindy_nrf import KinematicSmoother, NRFRegressor

    record = chain(n, n_samples)
    X, F = (table.to_numpy() for table in record.to_features())
    contenders = {
        "fusion": lambda: KinematicSmoother().fit_transform(record),
        "fit": lambda: NRFRegressor(degree=3).fit(X, F),
    }
    times = times_in_turns(contenders, 15)
    fusion_time = 1e3 * np.median(times["fusion"])
    fit_time = 1e3 * np.median(times["fit"])
    text = (
        f"Fusion over the fit it feeds: {fusion_time:.0f} ms over {fit_time:.0f} ms,"
        f" {fusion_time / fit_time:.1f}, CPU."
    )
    return Wait(shares=text)


def shares(profile: cProfile.Profile) -> str:
    """The largest shares among the functions that the measured one calls.

    A function that takes nearly all of the time is followed down to where it branches.
    """
    stats = pstats.Stats(profile)
    stats.calc_callees()
    largest: list = []
    place = entrance(stats)
    for _ in range(12):
        largest = callees(stats, place)
        if not largest or largest[0][0] < SPLIT_SHARE * stats.total_tt:
            break
        place = largest[0][1]
    words = []
    for seconds, (_, _, name) in largest[:4]:
        if seconds > LEAST_SHARE * stats.total_tt:
            share = 100 * seconds / stats.total_tt
            words.append(f"{name.strip('_<>')} {share:.0f} %")
    return ", ".join(words)


def entrance(stats: pstats.Stats) -> tuple:
    """The function of the package that takes the longest, with what it calls."""
    times = {}
    for function, (_, _, _, cumulative, _) in stats.stats.items():
        if "pysindy_nrf" in function[0]:
            times[function] = cumulative
    return max(times, key=lambda function: (times[function], function))


def callees(stats: pstats.Stats, place: tuple) -> list[tuple[float, tuple]]:
    """Seconds of the functions that one calls, the largest first."""
    called = stats.all_callees.get(place, {})
    times = [(times[3], function) for function, times in called.items()]
    others = [(seconds, function) for seconds, function in times if function != place]
    return sorted(others, key=lambda pair: (pair[0], pair[1][2]), reverse=True)


def wait_here(name: str, n: int, size: int) -> Wait:
    """Measure a case in this process."""
    warnings.simplefilter("ignore")
    if name == RATIO:
        return fusion_over_fit(n, size)
    if name == "battery":
        CASES[name](0, 0)()
    elif name != "measured":
        CASES[name](n, 4000)()

    run = CASES[name](n, size)
    wall = time.perf_counter()
    cpu = time.process_time()
    run()
    cpu = time.process_time() - cpu
    wall = time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if cpu >= MAX_PROFILED:
        return Wait(cpu, wall, peak)
    profile = cProfile.Profile()
    profile.runcall(run)
    return Wait(cpu, wall, peak, shares(profile))


def wait_apart(name: str, n: int, size: int, threads: int = 1) -> Wait:
    """The same in a process of its own."""
    env = os.environ | dict.fromkeys(THREADS, str(threads))
    env["PYTHONWARNINGS"] = "ignore"
    command = [sys.executable, __file__, "--one", name, str(n), str(size)]
    done = subprocess.run(command, capture_output=True, text=True, env=env)
    if done.returncode:
        return Wait(shares=done.stderr.strip()[-200:])
    return Wait(**json.loads(done.stdout.splitlines()[-1]))


# -- tables --------------------------------------------------------------------


def table(rows: list[dict[str, Any]]) -> str:
    import pandas as pd
    from harness import markdown

    return markdown(pd.DataFrame(rows))


def demo() -> str:
    """The demo, cold and warm."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        env = os.environ | dict.fromkeys(THREADS, "1")
        env["NUMBA_CACHE_DIR"] = f"{folder}/code"
        for how in ("cold: nothing compiled yet", "warm"):
            command = [sys.executable, "-m", "pysindy_nrf", "demo"]
            command += ["-o", f"{folder}/{how[:4]}"]
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            wall = time.perf_counter()
            subprocess.run(command, env=env, check=True, capture_output=True)
            wall = time.perf_counter() - wall
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
            row = {
                "pysindy-nrf demo": how,
                "CPU s": f"{cpu:.1f}",
                "wall s": f"{wall:.1f}",
                "peak, MB": f"{after.ru_maxrss / 1024:.0f}",
            }
            rows.append(row)
    return table(rows)


def waits(cases: list[tuple[str, int, int]], two_threads: bool) -> str:
    """A table of cases, on one thread and on two."""
    from tqdm import tqdm

    rows = []
    for name, n, size in tqdm(cases, disable=None):
        wait = wait_apart(name, n, size)
        row = {
            "what": name,
            "n": n,
            "samples": f"{size:,}",
            "data, MB": f"{size * n * 32 / 1e6:.0f}",
            "CPU s": f"{wait.cpu:.2f}",
            "wall s": f"{wait.wall:.2f}",
        }
        if two_threads:
            wall = wait_apart(name, n, size, 2).wall
            row["wall s, two threads"] = f"{wall:.2f}"
        rows.append(row | {"peak, MB": f"{wait.peak:.0f}", "shares": wait.shares})
    return table(rows)


def loops(name: str, numbers: range) -> tuple[str, list[Wait]]:
    """Median, least and most of several loops, and each of them."""
    import numpy as np
    from tqdm import tqdm

    waits = [wait_apart(name, 1, number) for number in tqdm(numbers, disable=None)]
    cpu = np.array([wait.cpu for wait in waits])
    text = (
        f"{len(numbers)} {name} records: median {np.nanmedian(cpu):.1f} s CPU,"
        f" {np.nanmin(cpu):.1f} to {np.nanmax(cpu):.1f} s."
    )
    return text, waits


def fits_section(quick: bool) -> str:
    size = 20_000 if quick else 60_000
    cases = [(name, 4, size) for name in OF_FITS]
    cases += [("fit(X, F)", n, n_samples) for n, n_samples in grid(quick)]
    ratio = wait_apart(RATIO, 4, size).shares
    return f"{waits(cases, not quick)}\n\n{ratio}"


def grid(quick: bool) -> list[tuple[int, int]]:
    """DOFs and samples."""
    sizes = (10_000,) if quick else (10_000, 100_000, 1_000_000)
    dofs = (2,) if quick else (2, 5, 10)
    return [(n, size) for n in dofs for size in sizes]


def start_section(quick: bool) -> str:
    return demo()


def loop_section(quick: bool) -> str:
    cases = sorted(grid(quick), key=lambda case: case[1])
    return waits([("close_loop", *case) for case in cases], False)


def battery_section(quick: bool) -> str:
    text, _ = loops("battery", range(3 if quick else N_BATTERY))
    return text


def measured_section(quick: bool) -> str:
    from measured_records import SETS

    names = list(SETS)[: 2 if quick else None]
    text, waits = loops("measured", range(len(names)))
    rows = []
    for name, wait in zip(names, waits):
        row = {"measured record": name, "CPU s": f"{wait.cpu:.1f}"}
        rows.append(row | {"peak, MB": f"{wait.peak:.0f}", "shares": wait.shares})
    return f"{table(rows)}\n\n{text}"


SECTIONS: dict[str, tuple[str, Callable[[bool], str]]] = {
    "start": ("Start", start_section),
    "fit": ("Fits and commands", fits_section),
    "loop": ("Closed loop", loop_section),
    "battery": ("Closed loop on the battery", battery_section),
    "measured": ("Closed loop on measured records", measured_section),
}


def print_sections(options: argparse.Namespace) -> None:
    from harness import replace_section

    import pysindy_nrf

    version = (
        f"version {pysindy_nrf.__version__} and Python {platform.python_version()}"
    )
    text = f"Measured on {date.today()} with {version} on {os.cpu_count()} cores.\n"
    for subject in PARTS:
        if subject in options.only:
            title, section = SECTIONS[subject]
            text += f"\n### {title}\n\n{section(options.quick)}\n"
    print(text)
    if options.write:
        replace_section(PAGE, BEGIN, END, f"\n{text}")


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small cases")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument(
        "--write", action="store_true", help="put the tables into docs/benchmarks.md"
    )
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        name, n, size = options.one
        print(json.dumps(asdict(wait_here(name, int(n), int(size)))))
    else:
        print_sections(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
