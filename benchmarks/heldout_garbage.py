"""What the search finds must not depend on held-out data: they are made garbage.

    python benchmarks/heldout_garbage.py                   # cases of the battery
    python benchmarks/heldout_garbage.py --quick           # one small case
    python benchmarks/heldout_garbage.py --measured emps   # rows of a measured record

Of a case of the battery the held-out record is replaced by noise of the same size in
every channel; of a measured record the forces and inertias that the balances hold in
the held-out rows. (The states of laws with memory run through the motion between two
searched pieces; with --motion it is replaced, too.) Effects, sites, parameters with
their intervals, gains and the error before each must then be the same to the last
digit; only what held-out data say may differ, and the order of effects, which is that
of their confirmation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any
from unittest import mock

import search_path
import measured_records
import numpy as np
from battery.generators import make_case
from battery.scorer import baseline
from harness import judged, options_of, quietly

from pysindy_nrf import Record, close_loop
from pysindy_nrf.discrepancy import balance_loop, course
from pysindy_nrf.discrepancy.search_data import SearchData
from pysindy_nrf.records.dataset import Dataset

# what the search alone decides
FOUND = (
    "law",
    "site",
    "shape",
    "tied",
    "parameters",
    "intervals",
    "reduction",
    "reduction_error",
    "reduction_least",
    "share",
    "validation_before",
)
CASES = (("coulomb",), ("cubic",), ("bouc_wen",), (), ("coulomb", "cubic"))
CHANNELS = (
    "force",
    "acceleration",
    "velocity",
    "displacement",
    "base_acceleration",
    "base_velocity",
    "base_displacement",
)


@dataclass(frozen=True)
class Comparison:
    """A report with the held-out data, and what differs where they are garbage."""

    name: str
    report: Any
    differences: list[str]


# -- garbage -------------------------------------------------------------------


def noise_like(y: Any, rng: np.random.Generator) -> np.ndarray:
    """Noise of the size of each channel; channels of zeros or of NaN stay."""
    y = np.asarray(y, dtype=float)
    noise = np.nanstd(y, axis=0) * rng.standard_normal(y.shape)
    return np.where(np.isfinite(y), noise, y)


def garbage(record: Record, seed: int) -> Record:
    """A record of noise with the channels of another."""
    rng = np.random.default_rng(seed)
    changes = {}
    for name in CHANNELS:
        values = getattr(record, name)
        if values is not None:
            changes[name] = noise_like(values, rng)
    return record.replace(**changes)


class GarbageRows:
    """Steps of the loop that put noise into the rows which it holds out.

    The loop chooses these rows as ever; the noise takes their place after the channels
    were fused.
    """

    def __init__(self, seed: int, motion: bool) -> None:
        self.seed = seed
        self.kinds = "avsF" if motion else "F"
        self._prepare = balance_loop.prepare
        self._split = course.split
        self._fixed = SearchData.fixed
        self._halves: Any = None

    def prepare(self, *arguments: Any, **options: Any) -> Any:
        ready = self._prepare(*arguments, **options)
        segments = list(ready.data.segments)
        length = course.window_length(segments)
        self._halves = self._split(segments, length, ready.heldout)
        rng = np.random.default_rng(self.seed)
        for block in self._halves[1]:
            segments[block.segment] = self.spoilt(segments[block.segment], block, rng)
        return replace(ready, data=Dataset(segments, ready.data.n_samples))

    def spoilt(self, segment: Any, block: Any, rng: np.random.Generator) -> Any:
        """A segment with noise in the rows of a block."""
        first = segment.valid.start
        rows = slice(first + block.rows.start, first + block.rows.stop)
        changes = {}
        for kind in self.kinds:
            values = np.array(getattr(segment, kind), dtype=float)
            values[rows] = noise_like(values[rows], rng)
            changes[kind] = values
        return replace(segment, **changes)

    def split(self, *_: Any) -> Any:
        """The rows that were chosen before the noise."""
        return self._halves

    def balances(self, data: SearchData, segments: Sequence[int]) -> np.ndarray:
        """Inertias and forces with noise in the held-out rows."""
        values = np.array(self._fixed(data, segments))
        for block in data.heldout:
            if [block.segment] == list(segments):
                rng = np.random.default_rng(self.seed)
                values[:, block.rows] = noise_like(values[:, block.rows].T, rng).T
        return values


@contextmanager
def garbage_rows(seed: int, motion: bool) -> Iterator[None]:
    """Let the loop find noise in the rows which it holds out."""
    steps = GarbageRows(seed, motion)

    def balances(data: SearchData, segments: Sequence[int]) -> np.ndarray:
        return steps.balances(data, segments)

    with (
        mock.patch.object(balance_loop, "prepare", steps.prepare),
        mock.patch.object(course, "split", steps.split),
        mock.patch.object(SearchData, "fixed", balances),
    ):
        yield


# -- comparing -----------------------------------------------------------------


def differences(one: Any, other: Any) -> list[str]:
    """What differs between two reports of all that the search decides."""
    different = []
    if len(one.steps) != len(other.steps):
        different.append(f"{len(one.steps)} and {len(other.steps)} effects")
    for a, b in zip(by_site(one.steps), by_site(other.steps)):
        for name in FOUND:
            # to the last digit; not a number equals itself
            if repr(getattr(a, name)) != repr(getattr(b, name)):
                different.append(f"{name} of {a.law} at {a.site}")
    if one.band != other.band:
        different.append("band")
    return different


def by_site(steps: Any) -> list:
    return sorted(steps, key=lambda step: (step.site, step.law))


def compare_case(kinds: tuple[str, ...], seed: int, **size: Any) -> Comparison:
    """A case of the battery with its held-out test and with garbage in its place."""
    group = "two" if len(kinds) > 1 else "blind"
    case = make_case("garbage", group, seed, 0.01, kinds, **size)
    seen = [Record(name="test", **channels) for channels in case.seen]
    unseen = [Record(name="held-out test", **channels) for channels in case.unseen]
    spoilt = [garbage(record, seed) for record in unseen]
    report = quietly(close_loop, seen, baseline(case), heldout=unseen)
    other = quietly(close_loop, seen, baseline(case), heldout=spoilt)
    name = " + ".join(kinds) or "nothing to find"
    return Comparison(name, report, differences(report, other))


def compare_measured(name: str, seed: int, motion: bool) -> Comparison:
    """A measured record with its held-out rows and with garbage in their place."""
    test = measured_records.SETS[name]
    records = test.load()
    report = test.search(records)
    with garbage_rows(seed, motion):
        other = test.search(records)
    return Comparison(name, report, differences(report, other))


def print_row(comparison: Comparison) -> None:
    found = [f"{step.law} at {step.site}" for step in comparison.report.steps]
    different = ", ".join(comparison.differences) or "nothing"
    claim = judged(comparison.name, different, not comparison.differences)
    effects = "; ".join(found) or "none"
    print(
        f"| {claim.asked} | {effects} | {claim.measured} | {claim.verdict} |",
        flush=True,
    )


def main(arguments: list[str] | None = None) -> list[Comparison]:
    """Print what differs in each case."""
    parser = options_of(__doc__, quick="one small case")
    parser.add_argument(
        "--measured",
        nargs="*",
        default=[],
        choices=measured_records.SETS,
        help="measured records in place of the battery's cases",
    )
    parser.add_argument(
        "--motion",
        action="store_true",
        help="of measured records drifts and rates, too",
    )
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    cases = CASES
    size = {"n_samples": 8192, "most": 3}
    if options.quick:
        cases = CASES[-1:]
        size = {"n_samples": 1024, "most": 2}

    print("| held out | effects | what differs | |\n|---|---|---|---|")
    comparisons = []
    for name in options.measured:
        comparisons.append(compare_measured(name, options.seed, options.motion))
        print_row(comparisons[-1])
    for kinds in () if options.measured else cases:
        comparisons.append(compare_case(kinds, options.seed, **size))
        print_row(comparisons[-1])
    return comparisons


if __name__ == "__main__":
    main()
