"""Held-out data decide nothing but the last line: with garbage in their place the
search comes out the same.

    python benchmarks/heldout_garbage.py                     # cases of the battery: a few minutes
    python benchmarks/heldout_garbage.py --quick             # one small case
    python benchmarks/heldout_garbage.py --measured emps     # the held-out rows of a measured record

Of a case of the battery the held-out record is replaced by noise of the same size in
every channel; of a measured record the forces and inertias that the balances hold in
the held-out rows. (The states of laws with memory run through the motion between two
searched pieces; with --motion it is replaced, too.) Effects, sites, parameters with
their intervals, gains and the error before each must then be the same to the last
digit; only what held-out data say may differ, and the order of effects, which is that
of their confirmation.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ.setdefault(
    "PYSINDY_NRF_DATA", str(Path(__file__).resolve().parents[2] / "shared" / "data")
)
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np  # noqa: E402
from battery.generators import make_case  # noqa: E402
from battery.scorer import baseline  # noqa: E402

from pysindy_nrf import Record, close_loop  # noqa: E402
from pysindy_nrf.discrepancy import balance_loop, course  # noqa: E402
from pysindy_nrf.discrepancy.search_data import SearchData  # noqa: E402
from pysindy_nrf.records.dataset import Dataset  # noqa: E402

# What the search alone decides.
FOUND = (
    "law",
    "site",
    "shape",
    "tied",
    "parameters",
    "intervals",
    "gain",
    "gain_error",
    "gain_least",
    "share",
    "validation_before",
)
CASES = (("coulomb",), ("cubic",), ("bouc_wen",), (), ("coulomb", "cubic"))


def noise_like(y: Any, rng: np.random.Generator) -> np.ndarray:
    """Noise of the size of each channel; channels of zeros or of NaN stay."""
    y = np.asarray(y, dtype=float)
    return np.where(
        np.isfinite(y), np.nanstd(y, axis=0) * rng.standard_normal(y.shape), y
    )


def garbage(record: Record, seed: int) -> Record:
    """A record of noise with the channels of another."""
    rng = np.random.default_rng(seed)
    keys = [
        f"{base}{kind}"
        for base in ("", "base_")
        for kind in ("acceleration", "velocity", "displacement")
    ]
    return record.replace(
        **{
            k: noise_like(y, rng)
            for k in ("force", *keys)
            if (y := getattr(record, k)) is not None
        }
    )


@contextmanager
def garbage_rows(seed: int, motion: bool = False) -> Iterator[None]:
    """Let the loop hold out the rows it would, with noise in their place after the
    channels were fused.
    """
    prepare, split = balance_loop.prepare, course.split
    fixed, known = SearchData.fixed, {}

    def spoilt(*args: Any, **options: Any) -> Any:
        ready = prepare(*args, **options)
        segments = ready.data.segments
        length = course.window_length(segments)
        known["split"] = split(segments, length, ready.heldout)
        rng, out = np.random.default_rng(seed), list(segments)
        for block in known["split"][1]:
            seg = out[block.segment]
            rows = slice(
                seg.valid.start + block.rows.start, seg.valid.start + block.rows.stop
            )
            changed = {}
            for key in "avsF" if motion else "F":
                y = np.array(getattr(seg, key), dtype=float)
                y[rows] = noise_like(y[rows], rng)
                changed[key] = y
            out[block.segment] = replace(seg, **changed)
        return replace(ready, data=Dataset(out, ready.data.n_samples))

    def balanced(work: Any, segment: int) -> np.ndarray:
        out = fixed(work, segment)
        for rows in (b.rows for b in work.heldout if b.segment == segment):
            out[:, rows] = noise_like(out[:, rows].T, np.random.default_rng(seed)).T
        return out

    with (
        mock.patch.object(balance_loop, "prepare", spoilt),
        mock.patch.object(course, "split", lambda *_: known["split"]),
        mock.patch.object(SearchData, "fixed", balanced),
    ):
        yield


def differences(one: Any, other: Any) -> list[str]:
    """What differs between two reports of all that the search decides."""
    out = []
    if len(one.steps) != len(other.steps):
        out.append(f"{len(one.steps)} and {len(other.steps)} effects")
    pairs = zip(
        *(
            sorted(report.steps, key=lambda s: (s.site, s.law))
            for report in (one, other)
        )
    )
    for a, b in pairs:
        out += [
            f"{name} of {a.law} at {a.site}"
            for name in FOUND
            if not _same(getattr(a, name), getattr(b, name))
        ]
    if one.band != other.band:
        out.append("band")
    return out


def _same(a: Any, b: Any) -> bool:
    """To the last digit; not a number equals itself."""
    return repr(a) == repr(b)


def quietly(*args: Any, **options: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return close_loop(*args, **options)


def of_a_case(
    kinds: tuple[str, ...], seed: int, **size: Any
) -> tuple[str, Any, list[str]]:
    """A case of the battery with its held-out test and with garbage in its place."""
    case = make_case(
        "garbage", "two" if len(kinds) > 1 else "blind", seed, 0.01, kinds, **size
    )
    seen = [Record(name="test", **channels) for channels in case.seen]
    unseen = [Record(name="held-out test", **channels) for channels in case.unseen]
    spoilt = [garbage(record, seed) for record in unseen]
    report, other = (
        quietly(seen, baseline(case), heldout=held) for held in (unseen, spoilt)
    )
    return " + ".join(kinds) or "nothing to find", report, differences(report, other)


def of_a_measured_record(
    name: str, seed: int, motion: bool
) -> tuple[str, Any, list[str]]:
    """A measured record with its held-out rows and with garbage in their place."""
    from measured_records import SETS

    one = SETS[name]
    records = one.load()
    report = one.run(records)
    with garbage_rows(seed, motion):
        other = one.run(records)
    return name, report, differences(report, other)


def main(arguments: list[str] | None = None) -> list[list[str]]:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one small case")
    parser.add_argument(
        "--measured",
        nargs="*",
        default=[],
        help="measured records in place of the battery's cases",
    )
    parser.add_argument(
        "--motion",
        action="store_true",
        help="of measured records drifts and rates, too",
    )
    parser.add_argument("--seed", type=int, default=1)
    o = parser.parse_args(arguments)
    size = {"n_samples": 1024, "most": 2} if o.quick else {"n_samples": 8192, "most": 3}
    out = []
    print("| held out | effects | what differs | |\n|---|---|---|---|")
    for what in o.measured or (CASES[-1:] if o.quick else CASES):
        if o.measured:
            name, report, found = of_a_measured_record(what, o.seed, o.motion)
        else:
            name, report, found = of_a_case(what, o.seed, **size)
        effects = "; ".join(f"{s.law} at {s.site}" for s in report.steps) or "none"
        print(
            f"| {name} | {effects} | {', '.join(found) or 'nothing'} |"
            f" {'FAIL' if found else 'PASS'} |",
            flush=True,
        )
        out.append(found)
    return out


if __name__ == "__main__":
    main()
