"""Each measured record again, a little different: does the same effect come out?

    python benchmarks/robustness.py                          # all records and variants: hours
    python benchmarks/robustness.py emps silverbox --jobs 2  # some
    python benchmarks/robustness.py --quick                  # one record, one variant, one effect at most

Variants: the first half of the record, every other sample (after a zero-phase low-pass
at 0.4 of the new rate), another ``random_state``, and 1 % noise (of each channel's rms)
on what was measured. A claim of the whole record is kept if the variant has a claim at
that site whose family, or one of whose declared ties, is among the claim's family and
ties. A record without a claim is kept if the variant has none.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import measured_records as whole
import numpy as np
from joblib import Parallel, delayed

from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter

CHANNELS = (
    "force",
    "displacement",
    "velocity",
    "acceleration",
    "base_acceleration",
    "base_displacement",
)


def half_length(record: Any) -> Any:
    return record.rows(slice(0, record.n_samples // 2))


def half_rate(record: Any) -> Any:
    """Every other sample, low-passed before where there is a clock."""
    keep = slice(0, None, 2)
    low = (
        ZeroPhaseFilter((None, 0.2 * record.fs), record.fs).apply
        if record.has_clock
        else np.asarray
    )
    changes = {name: low(getattr(record, name))[keep] for name in present(record)}
    covariates = {
        name: np.asarray(values)[keep]
        for name, values in (record.covariates or {}).items()
    }
    clock = {"fs": record.fs / 2} if record.has_clock else {}
    return record.replace(**changes, **clock, covariates=covariates or None)


def noisy(record: Any) -> Any:
    """White noise of 1 % of each channel's rms."""
    rng = np.random.default_rng(0)
    values = {name: np.asarray(getattr(record, name)) for name in present(record)}
    sigma = {name: 0.01 * x.std(axis=0, keepdims=True) for name, x in values.items()}
    return record.replace(
        **{
            name: x + sigma[name] * rng.standard_normal(x.shape)
            for name, x in values.items()
        }
    )


def present(record: Any) -> list[str]:
    """Channels that the record holds."""
    return [name for name in CHANNELS if getattr(record, name, None) is not None]


VARIANTS = {
    "half length": half_length,
    "half rate": half_rate,
    "another seed": lambda r: r,
    "1 % noise": noisy,
}


def found(
    name: str, variant: str | None, **options: Any
) -> list[tuple[str, str, frozenset[str]]] | str:
    """Claims of a record or of its variant as (site, law, families); or why it was
    refused.
    """
    one = whole.SETS[name]
    records = one.load()
    pieces = records if isinstance(records, list) else [records]
    changed = [VARIANTS[variant](piece) if variant else piece for piece in pieces]
    seed = {"random_state": 1} if variant == "another seed" else {}
    try:
        report = one.run(
            changed if isinstance(records, list) else changed[0], **seed, **options
        )
    except NRFError as error:
        return str(error)
    return [
        (step.site, step.law, frozenset({*whole.families(step), step.law}))
        for step in whole.claims(report)
    ]


def kept(before: list[tuple[str, str, frozenset[str]]], after: Any) -> tuple[int, int]:
    """Claims of the whole record that the variant has too, and how many there are
    (nothing: one).
    """
    if not before:
        return int(after == []), 1
    if isinstance(after, str):
        return 0, len(before)
    return sum(
        any(site == s and names & n for s, _, n in after) for site, _, names in before
    ), len(before)


def main(arguments: list[str] | None = None) -> dict[str, tuple[int, int]]:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "sets", nargs="*", choices=[*whole.SETS, []], help="records; all by default"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one record, half its length, one effect at most",
    )
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    o = parser.parse_args(arguments)
    names = o.sets or (["friction_damper_2hz"] if o.quick else list(whole.SETS))
    variants = ["half length"] if o.quick else list(VARIANTS)
    options = {"max_steps": 1} if o.quick else {}
    start = time.perf_counter()
    runs = [(name, variant) for name in names for variant in (None, *variants)]
    results = dict(
        zip(
            runs,
            Parallel(n_jobs=o.jobs)(delayed(found)(*run, **options) for run in runs),
            strict=True,
        )
    )
    print("| record | variant | claims | kept |\n|---|---|---|---|")
    totals: dict[str, tuple[int, int]] = {variant: (0, 0) for variant in variants}
    for name, variant in runs:
        claims = results[name, variant]
        told = (
            claims
            if isinstance(claims, str)
            else "; ".join(f"{law} at {site}" for site, law, _ in claims)
        )
        score = ""
        if variant is not None:
            right, of = kept(results[name, None], claims)
            totals[variant] = totals[variant][0] + right, totals[variant][1] + of
            score = f"{right} of {of}"
        print(f"| {name} | {variant or 'whole'} | {told or 'none'} | {score} |")
    right, of = (sum(column) for column in zip(*totals.values(), strict=True))
    print(
        f"\nKept: {right} of {of} ({100 * right / of:.0f} %; at least 90 % are"
        " required)."
    )
    print("; ".join(f"{variant} {a} of {b}" for variant, (a, b) in totals.items()))
    print(f"{time.perf_counter() - start:.0f} s")
    return totals


if __name__ == "__main__":
    main()
