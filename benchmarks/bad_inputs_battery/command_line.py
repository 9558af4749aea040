"""Bad input to the command line: a sentence and an exit code, never a traceback."""

# ruff: noqa: E501

from __future__ import annotations

from typing import Any

import numpy as np

from .files import csv, cut, flipped, frame, mat, of_readers, parquet
from .kind import Kind

USAGE, DATA, OTHER = 2, 3, 1


def call(command: str, path: Any, *options: str) -> tuple:
    return lambda path: [command, path, *options], (path,)


def usage() -> dict[str, tuple]:
    path = csv()
    return {
        "no command": ((lambda: ["nonsense"], ()), "No such command"),
        "no file": ((lambda: ["identify"], ()), "Missing argument"),
        "an unknown option": (call("identify", path, "--magic"), "No such option"),
        "a degree in words": (
            call("identify", path, "--degree", "high"),
            "'high' is not a degree",
        ),
        "a negative degree": (call("identify", path, "--degree", "-3"), "-3"),
        "a band of one number": (
            call("identify", path, "--band", "40"),
            "is not a band",
        ),
        "a band in words": (
            call("identify", path, "--band", "low,high"),
            "is not a band",
        ),
        "a mass in words": (
            call("identify", path, "--known-mass", "2=heavy"),
            "is not a floor and its mass",
        ),
        "a mass twice": (
            call("identify", path, "--known-mass", "2=1", "--known-mass", "2=3"),
            "given twice",
        ),
        "a mapping without =": (
            call("identify", path, "--map", "x1"),
            "CHANNEL=COLUMN",
        ),
        "a law of no name": (
            call("identify", path, "--law", "storey 1=magic"),
            "there is no law 'magic'",
        ),
        "a rate in words": (call("identify", path, "--fs", "fast"), "fast"),
        "frequency options without --frf": (
            call("identify", path, "--excited", "2"),
            "--excited goes with --frf",
        ),
        "steps below zero": (call("close-loop", path, "--steps", "-1"), "-1"),
        "a seed in words": (call("close-loop", path, "--seed", "lucky"), "lucky"),
        "an output that is a file": (
            call("identify", path, "-o", str(path)),
            "is a file|file",
        ),
    }


def data() -> dict[str, tuple]:
    path, f = csv(), frame()
    holes = f.copy()
    holes.loc[500, "a2"] = np.nan
    two = f[["t", "F1", "F2", "a1", "a2", "x1", "x2"]]
    rows = {
        "a band above Nyquist": (call("identify", path, "--band", "1,900"), "Nyquist"),
        "a band upside down": (call("identify", path, "--band", "50,1"), "is empty"),
        "a storey that is not there": (
            call("identify", path, "--order", "storey 9=2"),
            "storey 9",
        ),
        "a mass of no floor": (call("identify", path, "--known-mass", "9=3"), "DOF 9"),
        "a negative mass": (
            call("identify", path, "--known-mass", "2=-3"),
            "is not a mass",
        ),
        "a NaN mass": (
            call("identify", path, "--known-mass", "2=nan"),
            "is not a mass",
        ),
        "a link to nowhere": (call("identify", path, "--link", "link 9-1"), "link 9-1"),
        "a degree of a thousand": (
            call("identify", path, "--degree", "1000"),
            "highest power",
        ),
        "a degree too high for the record": (
            call("identify", path, "--degree", "45"),
            "too few",
        ),
        "NaN in the middle": (
            call("identify", csv(holes)),
            "a2 .* is NaN in row 500",
            "Split",
        ),
        "the same in close-loop": (
            call("close-loop", csv(holes)),
            "a2 .* is NaN in row 500",
            "Split",
        ),
        "no force": (
            call("identify", csv(f.drop(columns=["F1", "F2", "F3"]))),
            "No force is measured|mass",
            "known",
        ),
        "no clock": (
            call("identify", csv(f.drop(columns="t"))),
            "no time column",
            "--fs",
        ),
        "a rate of zero": (
            call("identify", csv(f.drop(columns="t")), "--fs", "0"),
            "is not a sampling rate",
            "Hz",
        ),
        "a mapping to nothing": (
            call("identify", path, "--map", "x1=laser"),
            "has no variable 'laser'",
            "It holds",
        ),
        "a mapping with markup": (
            call("identify", path, "--map", "x1=<script>"),
            "has no variable|not understood",
        ),
        "an unknown unit": (
            call("identify", path, "--unit", "x=blorb"),
            "'blorb' of channel x1 is unknown",
            "Write",
        ),
        "one sample": (
            call("identify", csv(f.iloc[:1])),
            "samples|rows of numbers|no channel|clock",
            "needed|Give|Export",
        ),
        "three samples": (
            call("identify", csv(f.iloc[:3])),
            "samples|short",
            "longer|needed|more",
        ),
        "a static record": (
            call(
                "identify",
                csv(f.assign(**{c: 0.0 * f[c] + 0.1 for c in f if c[0] in "avx"})),
            ),
            "constant|not excited|never",
            "sensor|excite",
        ),
        "every cell NaN": (
            call("identify", csv(f.assign(**{c: np.nan for c in f if c != "t"}))),
            "NaN|no motion|nothing",
            "measured|Leave|Give",
        ),
        "a record of two floors beside one of three": (
            (lambda a, b: ["identify", a, b], (path, csv(two, "two.csv"))),
            "has 2 DOFs",
            "tests of one chain|one chain",
        ),
        "a response that is a record": (
            call("identify", path, "--frf"),
            "holds no complex responses",
            "export real and imaginary",
        ),
        "a held-out file of another chain": (
            (
                lambda a, b: ["close-loop", a, "--heldout", b],
                (path, csv(two, "two.csv")),
            ),
            "has 2 DOFs",
            "one chain",
        ),
        "a file too short to search": (
            call("close-loop", csv(f.iloc[:50])),
            "too short|samples",
            "longer",
        ),
        "a damaged MAT": (
            call("identify", cut(mat(), 0.6)),
            "cannot be read as MATLAB",
            "export",
        ),
        "a damaged Parquet": (
            call("identify", flipped(parquet(), 0.99)),
            "cannot be read as Parquet",
            "export",
        ),
        "huge numbers": (
            call("identify", csv(f.assign(**{c: 1e200 * f[c] for c in f if c != "t"}))),
            "leaves the range of a double",
            "unit",
        ),
    }
    for name, (where, *words) in of_readers().items():
        rows[f"{name} (identify)"] = (call("identify", where), words[0])
    return rows


def kinds() -> list[Kind]:
    """All kinds of this room."""
    return [
        Kind("command line", name, act, given, code, tuple(words))
        for code, rows in ((USAGE, usage()), (DATA, data()))
        for name, ((act, given), *words) in rows.items()
    ]
