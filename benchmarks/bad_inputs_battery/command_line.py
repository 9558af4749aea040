"""Bad input to the command line: a sentence and an exit code, never a traceback."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .files import unreadable
from .kind import Kind
from .sample_files import csv, cut, flipped, frame, mat, parquet

USAGE, DATA = 2, 3  # exit codes


def typed(*words: Any) -> list[Any]:
    """What is typed after the name of the program."""
    return list(words)


def misused(name: str, words: str, *command: Any) -> Kind:
    """A command that cannot be understood."""
    return Kind(name, partial(typed, *command), USAGE, (words,))


def unusable(name: str, words: tuple[str, ...], *command: Any) -> Kind:
    """A command whose data or parameters cannot be used."""
    return Kind(name, partial(typed, *command), DATA, words)


def kinds() -> Iterator[Kind]:
    """All kinds of this room."""
    yield from usage()
    yield from numbers_in_words()
    yield from parameters()
    yield from channels()
    yield from mappings()
    yield from short_or_static_records()
    yield from other_structures()
    yield from damaged_files()
    for kind in unreadable():
        (path,) = kind.call.args
        name = f"{kind.name} (identify)"
        yield unusable(name, kind.words[:1], "identify", path)


# -- commands that cannot be understood ----------------------------------------


def usage() -> Iterator[Kind]:
    """Commands, options and files that are not there."""
    path = csv()
    identify = ("identify", path)

    yield misused("no command", "No such command", "nonsense")
    yield misused("no file", "Missing argument", "identify")
    yield misused("an unknown option", "No such option", *identify, "--magic")
    yield misused(
        "a mass twice",
        "given twice",
        *identify,
        "--known-mass",
        "2=1",
        "--known-mass",
        "2=3",
    )
    yield misused("a mapping without =", "CHANNEL=COLUMN", *identify, "--map", "x1")
    yield misused(
        "a law of no name",
        "there is no law 'magic'",
        *identify,
        "--law",
        "storey 1=magic",
    )
    yield misused(
        "frequency options without --frf",
        "--excited goes with --frf",
        *identify,
        "--excited",
        "2",
    )
    yield misused(
        "an output that is a file", "is a file|file", *identify, "-o", str(path)
    )


def numbers_in_words() -> Iterator[Kind]:
    """Options that are no numbers, or not the ones that are needed."""
    path = csv()

    def option(
        name: str, words: str, flag: str, value: str, command: str = "identify"
    ) -> Kind:
        return misused(name, words, command, path, flag, value)

    yield option("a degree in words", "'high' is not a degree", "--degree", "high")
    yield option("a negative degree", "-3", "--degree", "-3")
    yield option("a band of one number", "is not a band", "--band", "40")
    yield option("a band in words", "is not a band", "--band", "low,high")
    yield option(
        "a mass in words", "is not a floor and its mass", "--known-mass", "2=heavy"
    )
    yield option("a rate in words", "fast", "--fs", "fast")
    yield option("steps below zero", "-1", "--steps", "-1", "close-loop")
    yield option("a seed in words", "lucky", "--seed", "lucky", "close-loop")


# -- data and parameters that cannot be used -----------------------------------


def parameters() -> Iterator[Kind]:
    """Options that do not fit the record."""
    path = csv()

    def option(name: str, words: str, flag: str, value: str) -> Kind:
        return unusable(name, (words,), "identify", path, flag, value)

    yield option("a band above Nyquist", "Nyquist", "--band", "1,900")
    yield option("a band upside down", "is empty", "--band", "50,1")
    yield option("a storey that is not there", "storey 9", "--order", "storey 9=2")
    yield option("a mass of no floor", "DOF 9", "--known-mass", "9=3")
    yield option("a negative mass", "is not a mass", "--known-mass", "2=-3")
    yield option("a NaN mass", "is not a mass", "--known-mass", "2=nan")
    yield option("a link to nowhere", "link 9-1", "--link", "link 9-1")
    yield option("a degree of a thousand", "highest power", "--degree", "1000")
    yield option("a degree too high for the record", "too few", "--degree", "45")


def channels() -> Iterator[Kind]:
    """Channels that are missing or have gaps."""
    table = frame()
    holes = table.copy()
    holes.loc[500, "a2"] = np.nan
    gap = ("a2 .* is NaN in row 500", "Split")
    without_force = csv(table.drop(columns=["F1", "F2", "F3"]))
    without_clock = csv(table.drop(columns="t"))

    yield unusable("NaN in the middle", gap, "identify", csv(holes))
    yield unusable("the same in close-loop", gap, "close-loop", csv(holes))
    yield unusable(
        "no force",
        ("No force is measured|mass", "known"),
        "identify",
        without_force,
    )
    yield unusable("no clock", ("no time column", "--fs"), "identify", without_clock)
    yield unusable(
        "a rate of zero",
        ("is not a sampling rate", "Hz"),
        "identify",
        without_clock,
        "--fs",
        "0",
    )


def mappings() -> Iterator[Kind]:
    """Channels and units that are mapped to nothing."""
    path = csv()

    yield unusable(
        "a mapping to nothing",
        ("has no variable 'laser'", "It holds"),
        "identify",
        path,
        "--map",
        "x1=laser",
    )
    yield unusable(
        "a mapping with markup",
        ("has no variable|not understood",),
        "identify",
        path,
        "--map",
        "x1=<script>",
    )
    yield unusable(
        "an unknown unit",
        ("'blorb' of channel x1 is unknown", "Write"),
        "identify",
        path,
        "--unit",
        "x=blorb",
    )


def scaled(table: pd.DataFrame, kinds: str, factor: float) -> pd.DataFrame:
    """A table with some kinds of channels multiplied."""
    out = table.copy()
    for column in table:
        if column[0] in kinds:
            out[column] = factor * table[column]
    return out


def short_or_static_records() -> Iterator[Kind]:
    """Records of next to nothing."""
    table = frame()
    at_rest = scaled(table, "avx", 0.0)
    moved = [column for column in table if column[0] in "avx"]
    at_rest[moved] += 0.1

    yield unusable(
        "one sample",
        (
            "samples|rows of numbers|no channel|clock",
            "needed|Give|Export",
        ),
        "identify",
        csv(table.iloc[:1]),
    )
    yield unusable(
        "three samples",
        ("samples|short", "longer|needed|more"),
        "identify",
        csv(table.iloc[:3]),
    )
    yield unusable(
        "a static record",
        ("constant|not excited|never", "sensor|excite"),
        "identify",
        csv(at_rest),
    )
    yield unusable(
        "every cell NaN",
        ("NaN|no motion|nothing", "measured|Leave|Give"),
        "identify",
        csv(scaled(table, "Favx", np.nan)),
    )
    yield unusable(
        "a file too short to search",
        ("too short|samples", "longer"),
        "close-loop",
        csv(table.iloc[:50]),
    )
    yield unusable(
        "huge numbers",
        ("leaves the range of a double", "unit"),
        "identify",
        csv(scaled(table, "Favx", 1e200)),
    )


def other_structures() -> Iterator[Kind]:
    """Files of another chain, or no responses."""
    path = csv()
    columns = ["t", "F1", "F2", "a1", "a2", "x1", "x2"]
    of_two_floors = csv(frame()[columns], "two.csv")

    yield unusable(
        "a record of two floors beside one of three",
        ("has 2 DOFs", "tests of one chain|one chain"),
        "identify",
        path,
        of_two_floors,
    )
    yield unusable(
        "a held-out file of another chain",
        ("has 2 DOFs", "one chain"),
        "close-loop",
        path,
        "--heldout",
        of_two_floors,
    )
    yield unusable(
        "a response that is a record",
        ("holds no complex responses", "export real and imaginary"),
        "identify",
        path,
        "--frf",
    )


def damaged_files() -> Iterator[Kind]:
    """Files that are cut off or overwritten."""

    def damaged(name: str, path: Path, kind: str) -> Kind:
        words = (f"cannot be read as {kind}", "export")
        return unusable(name, words, "identify", path)

    yield damaged("a damaged MAT", cut(mat(), 0.6), "MATLAB")
    yield damaged("a damaged Parquet", flipped(parquet(), 0.99), "Parquet")
