"""What several benchmarks share: options, runs in parallel, timing, claims, tables."""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import search_path
import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from tqdm import tqdm

from pysindy_nrf import laws

PASS, FAIL = "PASS", "FAIL"


# -- options -------------------------------------------------------------------


def options_of(module: str | None, quick: str = "") -> argparse.ArgumentParser:
    """Command line of a benchmark: its docstring as help, ``--quick`` if described."""
    parser = argparse.ArgumentParser(
        description=(module or "").replace("%", "%%"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if quick:
        parser.add_argument("--quick", action="store_true", help=quick)
    return parser


# -- runs ----------------------------------------------------------------------


def quietly(function: Callable, *args: Any, **options: Any) -> Any:
    """Call without warnings."""
    with warnings.catch_warnings(action="ignore"):
        return function(*args, **options)


def in_parallel(function: Callable, tasks: Iterable[tuple], jobs: int = 1) -> list:
    """Results of a function without its warnings, one for each tuple of arguments."""
    tasks = list(tasks)
    calls = (delayed(quietly)(function, *task) for task in tasks)
    results = Parallel(n_jobs=jobs, return_as="generator")(calls)
    return list(tqdm(results, total=len(tasks), disable=None, leave=False))


def times_in_turns(
    contenders: dict[str, Callable[[], Any]],
    rounds: int,
    patience: float = np.inf,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, list[float]]:
    """Times of each contender, s, in turns, so that a busy machine slows all alike.

    One that takes longer than ``patience`` (s) has had its last turn. The turns end
    when one contender of several is left.
    """
    times: dict[str, list[float]] = {name: [] for name in contenders}
    patient = list(contenders)

    for _ in range(rounds):
        for name in list(patient):
            began = clock()
            contenders[name]()
            times[name].append(clock() - began)
            if times[name][-1] > patience:
                patient.remove(name)
        if len(patient) < min(2, len(contenders)):
            break
    return times


# -- structures ----------------------------------------------------------------


def linear_storeys(stiffness: Any, damping: Any) -> dict[str, list[laws.ForceLaw]]:
    """A spring (N/m) and a dashpot (N s/m) for each storey, by its name."""
    storeys = {}
    for i, (k, c) in enumerate(zip(stiffness, damping), 1):
        storeys[f"storey {i}"] = [laws.PowerSeries(1, [c, k])]
    return storeys


# -- claims and tables ---------------------------------------------------------


@dataclass(frozen=True)
class Claim:
    """What is asked, what was measured, and the verdict."""

    asked: str
    measured: str
    verdict: str


def judged(asked: str, measured: str, holds: bool, otherwise: str = FAIL) -> Claim:
    """A claim that holds or fails."""
    return Claim(asked, measured, PASS if holds else otherwise)


def markdown(table: pd.DataFrame) -> str:
    """A table in Markdown, without its index."""
    rows = [list(map(str, table)), *table.astype(str).to_numpy().tolist()]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|---" * table.shape[1] + "|")
    return "\n".join(lines)


def replace_section(page: Path, begin: str, end: str, text: str) -> None:
    """Put a text between two marks of a page of the documentation."""
    before, _, rest = page.read_text("utf-8").partition(begin)
    after = rest.partition(end)[2]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", "utf-8")


def write_csv(table: pd.DataFrame, folder: Path | None, name: str) -> None:
    """Keep a table as a file of a folder, where one is given."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        table.to_csv(folder / f"{name}.csv")
