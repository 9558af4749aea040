"""Where people wait: processor time, peak memory and shares by phase of what a user
starts, each in its own process.

    python benchmarks/where_people_wait.py --quick          # small cases, a minute or two
    python benchmarks/where_people_wait.py                  # all of it: about an hour on one core
    python benchmarks/where_people_wait.py --only loop fit  # some parts: start, fit,
    loop, battery, measured
    python benchmarks/where_people_wait.py --write          # the tables into docs/performance.md

The demo is run cold (nothing compiled yet) and warm. Everything else is warm: each
process first runs a small case of the same kind, which is not counted. Processor time
is that of the process and all its threads; with other programs on the machine it is 10
to 30 % longer than on an idle one. ``peak`` is the largest memory of the process,
``data`` the size of the record. Shares are those of the functions that the measured one
calls.
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
from multiprocessing import get_context
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
os.environ.setdefault("PYSINDY_NRF_DATA", str(HERE.parents[1] / "shared" / "data"))
sys.path += [str(HERE), str(HERE.parent / "tests")]
PAGE = HERE.parent / "docs" / "performance.md"
BEGIN, END = "<!-- tables of where_people_wait.py -->", "<!-- end of the tables -->"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
SEEDS = range(30)


def chain(n: int, n_samples: int) -> Any:
    """A record of a chain, made in a process of its own, whose memory is not
    counted.
    """
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(simulated, n, n_samples).result()


def simulated(n: int, n_samples: int, noise: float = 0.02) -> Any:
    """A record of a chain of Duffing storeys in random motion, forced at the top."""
    import chains

    from pysindy_nrf.simulation.noise import add_noise

    return add_noise(
        chains.duffing(n, [n], seed=1, n_samples=n_samples).record(),
        noise,
        random_state=0,
    )


def fused(n: int, size: int) -> Callable[[], Any]:
    """The fusion that a fit of a record needs."""
    record = chain(n, size)
    return lambda: record.to_features()


def arrays(n: int, size: int) -> Callable[[], Any]:
    """A fit of fused motions."""
    from pysindy_nrf import NRFRegressor

    X, F = (table.to_numpy() for table in chain(n, size).to_features())
    return lambda: NRFRegressor(degree=3).fit(X, F)


def record(n: int, size: int) -> Callable[[], Any]:
    """A fit of a record, fusion, diagnosis and all."""
    from pysindy_nrf import NRFRegressor

    rec = chain(n, size)
    return lambda: NRFRegressor(degree=3).fit(rec)


def intervals(n: int, size: int) -> Callable[[], Any]:
    """Confidence intervals of a fit."""
    from pysindy_nrf import NRFRegressor

    model = NRFRegressor(degree=3).fit(chain(n, size))
    return lambda: model.confidence_intervals()


def orders(n: int, size: int) -> Callable[[], Any]:
    """Degrees 1 to 7 by held-out error."""
    from pysindy_nrf import select_order

    X, F = (table.to_numpy() for table in chain(n, size).to_features())
    return lambda: select_order(X, F)


def identify(n: int, size: int) -> Callable[[], Any]:
    """The command on a CSV file, with its pages and figures."""
    from pysindy_nrf.cli.group import run

    folder = Path(tempfile.mkdtemp())
    path = folder / "test.csv"
    chain(n, size).to_frame().to_csv(path)
    return lambda: run(["identify", str(path), "-o", str(folder / "out")])


def loop(n: int, size: int) -> Callable[[], Any]:
    """The closed loop from a linear model, the whole catalogue."""
    from pysindy_nrf import close_loop

    rec = chain(n, size)
    return lambda: close_loop(rec)


def battery(n: int, seed: int) -> Callable[[], Any]:
    """The closed loop on a case of the battery, which has as many samples as the
    battery's.
    """
    from battery.formulas import KINDS
    from battery.generators import make_case
    from battery.scorer import baseline

    from pysindy_nrf import Record, close_loop

    kind = list(KINDS)[seed % len(KINDS)]
    case = make_case(
        "wait",
        "blind",
        seed,
        0.01,
        (kind,),
        **({"n_samples": 2048, "most": 2} if n == 0 else {}),
    )
    records = [Record(name="test", **channels) for channels in case.seen]
    return lambda: close_loop(records, baseline(case))


def measured(name: int, size: int) -> Callable[[], Any]:
    """The closed loop on a measured record, by its number among those of
    measured_records.py.
    """
    from measured_records import SETS

    one = list(SETS.values())[size]
    records = one.load()
    return lambda: one.run(records)


def fusion_over_fit(n: int, size: int) -> dict[str, Any]:
    """The fusion of a record and the fit that it feeds, in turn in one process; both
    warm, medians of 15.
    """
    import numpy as np

    from pysindy_nrf import KinematicSmoother, NRFRegressor

    rec = chain(n, size)
    X, F = (table.to_numpy() for table in rec.to_features())
    runs = (
        lambda: KinematicSmoother().fit_transform(rec),
        lambda: NRFRegressor(degree=3).fit(X, F),
    )
    spent = np.empty((15, 2))
    for row in spent:
        for k, run in enumerate(runs):
            start = time.process_time()
            run()
            row[k] = time.process_time() - start
    fusion, fit = 1e3 * np.median(spent, axis=0)
    return {
        "shares": (
            f"Fusion over the fit it feeds: {fusion:.0f} ms over {fit:.0f} ms,"
            f" {fusion / fit:.1f}, CPU."
        )
    }


CASES: dict[str, Callable[[int, int], Callable[[], Any]]] = {
    "fusion": fused,
    "fit(X, F)": arrays,
    "fit(record)": record,
    "intervals": intervals,
    "select_order": orders,
    "identify": identify,
    "close_loop": loop,
    "battery": battery,
    "measured": measured,
}
SMALL = {"battery": (0, 0), "measured": None}


def shares(profile: cProfile.Profile) -> str:
    """The largest shares among the functions that the measured one calls, down to where
    they branch.
    """
    stats = pstats.Stats(profile)
    stats.calc_callees()
    total, here = stats.total_tt, None
    found: list[tuple[float, str, Any]] = []
    for _ in range(12):
        if here is None:
            rows = [
                (cum, key)
                for key, (_, _, _, cum, _) in stats.stats.items()
                if "pysindy_nrf" in key[0]
            ]
            here = max(rows)[1]
        inside = {
            key: times[3]
            for key, times in stats.all_callees.get(here, {}).items()
            if key != here
        }
        found = sorted(((t, key[2], key) for key, t in inside.items()), reverse=True)
        if not found or found[0][0] < 0.85 * total:
            break
        here = found[0][2]
    return ", ".join(
        f"{name.strip('_<>')} {100 * t / total:.0f} %"
        for t, name, _ in found[:4]
        if t > 0.03 * total
    )


def one(name: str, n: int, size: int) -> dict[str, Any]:
    """Measure a case in this process."""
    warnings.simplefilter("ignore")
    if name == "ratio":
        return fusion_over_fit(n, size)
    before = SMALL.get(name, (n, 4000))
    if before is not None:
        CASES[name](*before)()
    run = CASES[name](n, size)
    wall, cpu = time.perf_counter(), time.process_time()
    run()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    profile = cProfile.Profile()
    if cpu < 120:
        profile.runcall(run)
    return {
        "cpu": cpu,
        "wall": wall,
        "peak": peak,
        "shares": shares(profile) if cpu < 120 else "",
    }


def apart(name: str, n: int, size: int, threads: int = 1) -> dict[str, Any]:
    """The same in a process of its own."""
    env = {
        **os.environ,
        **dict.fromkeys(THREADS, str(threads)),
        "PYTHONWARNINGS": "ignore",
    }
    done = subprocess.run(
        [sys.executable, __file__, "--one", name, str(n), str(size)],
        capture_output=True,
        text=True,
        env=env,
    )
    if done.returncode:
        return {
            "cpu": float("nan"),
            "wall": float("nan"),
            "peak": float("nan"),
            "shares": done.stderr.strip()[-200:],
        }
    return json.loads(done.stdout.splitlines()[-1])


def demo() -> list[str]:
    """The demo, cold and warm."""
    lines = ["| pysindy-nrf demo | CPU s | wall s | peak, MB |", "|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        env = {
            **os.environ,
            **dict.fromkeys(THREADS, "1"),
            "NUMBA_CACHE_DIR": f"{folder}/code",
        }
        for how in ("cold: nothing compiled yet", "warm"):
            before, wall = (
                resource.getrusage(resource.RUSAGE_CHILDREN),
                time.perf_counter(),
            )
            command = [
                sys.executable,
                "-m",
                "pysindy_nrf",
                "demo",
                "-o",
                f"{folder}/{how[:4]}",
            ]
            subprocess.run(command, env=env, check=True, capture_output=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            peak = after.ru_maxrss / 1024
            lines.append(
                f"| {how} | {cpu:.1f} | {time.perf_counter() - wall:.1f} | {peak:.0f} |"
            )
    return lines


def rows(cases: list[tuple[str, int, int]], both: bool) -> list[str]:
    """A table of cases, on one thread and on two."""
    from tqdm import tqdm

    two = "wall s, two threads | " * both
    head = (
        f"| what | n | samples | data, MB | CPU s | wall s | {two}peak, MB | shares |"
    )
    lines = [head, "|---" * head.count("|", 1) + "|"]
    for name, n, size in tqdm(cases, disable=None):
        found = apart(name, n, size)
        two = f" {apart(name, n, size, 2)['wall']:.2f} |" if both else ""
        lines.append(
            f"| {name} | {n} | {size:,} | {size * n * 32 / 1e6:.0f} |"
            f" {found['cpu']:.2f} | {found['wall']:.2f} |{two} {found['peak']:.0f} |"
            f" {found['shares']} |"
        )
    return lines


def of_loops(name: str, numbers: list[int], labels: list[str]) -> list[str]:
    """Median, least and most of several loops, and each of them where there are
    labels.
    """
    import numpy as np
    from tqdm import tqdm

    found = [apart(name, 1, number) for number in tqdm(numbers, disable=None)]
    cpu = np.array([one["cpu"] for one in found])
    told = [
        f"| {name} | {one['cpu']:.1f} | {one['peak']:.0f} | {one['shares']} |"
        for name, one in zip(labels, found)
    ]
    table = (
        [f"| {name} record | CPU s | peak, MB | shares |", "|---|---|---|---|", *told]
        if labels
        else []
    )
    median, least, most = np.nanmedian(cpu), np.nanmin(cpu), np.nanmax(cpu)
    return [
        *table,
        "",
        (
            f"{len(numbers)} {name} records: median {median:.1f} s CPU, {least:.1f} to"
            f" {most:.1f} s."
        ),
    ]


def tables(parts: list[str], quick: bool) -> list[str]:
    """All tables that were asked for."""
    out: list[str] = []
    sizes = [10_000] if quick else [10_000, 100_000, 1_000_000]
    dofs = [2] if quick else [2, 5, 10]
    if "start" in parts:
        out += ["## Start", "", *demo(), ""]
    if "fit" in parts:
        plain = [(name, 4, 20_000 if quick else 60_000) for name in list(CASES)[:6]]
        plain += [("fit(X, F)", n, size) for n in dofs for size in sizes]
        told = apart("ratio", 4, 20_000 if quick else 60_000)["shares"]
        out += ["## Fits and commands", "", *rows(plain, not quick), "", told, ""]
    if "loop" in parts:
        out += [
            "## Closed loop",
            "",
            *rows([("close_loop", n, size) for size in sizes for n in dofs], False),
            "",
        ]
    if "battery" in parts:
        out += [
            "## Closed loop on the battery",
            "",
            *of_loops("battery", [*SEEDS][: 3 if quick else 30], []),
            "",
        ]
    if "measured" in parts:
        from measured_records import SETS

        names = list(SETS)[: 2 if quick else None]
        out += [
            "## Closed loop on measured records",
            "",
            *of_loops("measured", [*range(len(names))], names),
            "",
        ]
    return out


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = ["start", "fit", "loop", "battery", "measured"]
    parser.add_argument("--quick", action="store_true", help="small cases")
    parser.add_argument("--only", nargs="+", choices=parts, default=parts)
    parser.add_argument(
        "--write", action="store_true", help="put the tables into docs/performance.md"
    )
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    o = parser.parse_args()
    if o.one:
        print(json.dumps(one(o.one[0], int(o.one[1]), int(o.one[2]))))
        return 0
    where = (
        f"Measured with Python {platform.python_version()} on {os.cpu_count()} cores."
    )
    text = "\n".join([where, "", *tables(o.only, o.quick)])
    print(text)
    if o.write:
        page = PAGE.read_text("utf-8")
        before, _, after = page.partition(BEGIN)
        PAGE.write_text(
            f"{before}{BEGIN}\n\n{text}\n{END}{after.partition(END)[2]}", "utf-8"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
