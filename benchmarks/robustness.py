"""Each measured record again, a little different: does the same effect come out?

    python benchmarks/robustness.py                          # all of it: hours
    python benchmarks/robustness.py emps silverbox --jobs 2  # some records
    python benchmarks/robustness.py --quick                  # one record, one variant

Variants: the first half of the record, every other sample (after a zero-phase low-pass
at 0.4 of the new rate), another ``random_state``, and 1 % noise (of each channel's rms)
on what was measured. A claim of the whole record is kept if the variant has a claim at
that site whose family, or one of whose declared ties, is among the claim's family and
ties. A record without a claim is kept if the variant has none.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import search_path
import measured_records
import numpy as np
import pandas as pd
from harness import in_parallel, markdown, options_of

from pysindy_nrf import Record, ZeroPhaseFilter
from pysindy_nrf.exceptions import NRFError

CHANNELS = (
    "force",
    "displacement",
    "velocity",
    "acceleration",
    "base_acceleration",
    "base_displacement",
)
FULL_RECORD = "whole"


# -- variants of a record ------------------------------------------------------


def half_length(record: Record) -> Record:
    return record.rows(slice(0, record.n_samples // 2))


def half_rate(record: Record) -> Record:
    """Every other sample, low-passed before where there is a clock."""
    changes = {}
    for name, values in channels_of(record).items():
        if record.has_clock:
            low_pass = ZeroPhaseFilter((None, 0.2 * record.fs), record.fs)
            values = low_pass.apply(values)
        changes[name] = values[::2]
    covariates = {}
    for name, values in (record.covariates or {}).items():
        covariates[name] = np.asarray(values)[::2]
    if record.has_clock:
        changes["fs"] = record.fs / 2
    return record.replace(**changes, covariates=covariates or None)


def noisy(record: Record) -> Record:
    """White noise of 1 % of each channel's rms."""
    rng = np.random.default_rng(0)
    changes = {}
    for name, values in channels_of(record).items():
        sigma = 0.01 * values.std(axis=0, keepdims=True)
        changes[name] = values + sigma * rng.standard_normal(values.shape)
    return record.replace(**changes)


def unchanged(record: Record) -> Record:
    return record


def channels_of(record: Record) -> dict[str, np.ndarray]:
    """Channels that a record has."""
    channels = {name: getattr(record, name, None) for name in CHANNELS}
    return {name: np.asarray(y) for name, y in channels.items() if y is not None}


VARIANTS = {
    FULL_RECORD: unchanged,
    "half length": half_length,
    "half rate": half_rate,
    "another seed": unchanged,
    "1 % noise": noisy,
}


# -- claims --------------------------------------------------------------------


@dataclass(frozen=True)
class Effects:
    """Claims as (site, law, names that stand for it); or why the record was refused."""

    claims: tuple[tuple[str, str, frozenset[str]], ...] = ()
    refusal: str = ""

    def __str__(self) -> str:
        words = [f"{law} at {site}" for site, law, _ in self.claims]
        return self.refusal or "; ".join(words) or "none"

    def has(self, site: str, names: frozenset[str]) -> bool:
        """Whether there is a claim at a site under one of the names."""
        return any(site == other and names & same for other, _, same in self.claims)


def searched(name: str, variant: str, **options: Any) -> Effects:
    """The claims of a variant of a record."""
    test = measured_records.SETS[name]
    records = test.load()
    change = VARIANTS[variant]
    if isinstance(records, list):
        records = [change(record) for record in records]
    else:
        records = change(records)
    if variant == "another seed":
        options["random_state"] = 1
    try:
        report = test.search(records, **options)
    except NRFError as error:
        return Effects(refusal=str(error))

    claims = []
    for step in measured_records.claims(report):
        names = frozenset(measured_records.names_of(step))
        claims.append((step.site, step.law, names))
    return Effects(tuple(claims))


def shared_effects(full: Effects, variant: Effects) -> tuple[int, int]:
    """Claims of the whole record that the variant has too, and how many there are.

    That there is none counts as one.
    """
    if not full.claims:
        return int(not variant.claims and not variant.refusal), 1
    n_kept = sum(variant.has(site, names) for site, _, names in full.claims)
    return n_kept, len(full.claims)


def scored(results: dict[tuple[str, str], Effects]) -> pd.DataFrame:
    """One row for each record and variant."""
    rows = []
    for (name, variant), effects in results.items():
        row = {"record": name, "variant": variant, "claims": str(effects), "kept": ""}
        if variant != FULL_RECORD:
            right, of = shared_effects(results[name, FULL_RECORD], effects)
            row |= {"kept": f"{right} of {of}", "right": right, "of": of}
        rows.append(row)
    return pd.DataFrame(rows)


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print what every variant claims, and how many claims are kept."""
    parser = options_of(__doc__, quick="one record, half its length, one effect")
    parser.add_argument(
        "sets",
        nargs="*",
        choices=[*measured_records.SETS, []],
        help="records; all by default",
    )
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    options = parser.parse_args(arguments)
    names = options.sets or list(measured_records.SETS)
    variants = list(VARIANTS)
    search = searched
    if options.quick:
        names = options.sets or ["friction_damper_05hz"]
        variants = [FULL_RECORD, "half length"]
        search = partial(searched, max_steps=1)

    start = time.perf_counter()
    tasks = [(name, variant) for name in names for variant in variants]
    table = scored(dict(zip(tasks, in_parallel(search, tasks, options.jobs))))
    print(markdown(table[["record", "variant", "claims", "kept"]]))

    totals = table.dropna().groupby("variant", sort=False)[["right", "of"]].sum()
    right, of = totals.sum().astype(int)
    share = 100 * right / of
    print(f"\nKept: {right} of {of} ({share:.0f} %; at least 90 % are required).")
    counts = [f"{name} {a:.0f} of {b:.0f}" for name, a, b in totals.itertuples()]
    print("; ".join(counts))
    print(f"{time.perf_counter() - start:.0f} s")
    return table


if __name__ == "__main__":
    main()
