"""Values of options: how a text on the command line is read."""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import click

from ..chain.sites import Site

# A total degree, or a box (k, q).
Degree = int | tuple[int, int]
# Ends of a band, Hz; open where None.
Band = tuple[float | None, float | None]

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")

# The highest order, and the highest floor, that a range may name.
LARGEST_NUMBER = 50


class Text(click.ParamType):
    """A text that a function turns into a value.

    Parameters
    ----------
    name : str
        Form of the text, as help shows it.
    read : callable
        Its ValueError becomes a usage error.
    wanted : str
        What is said to be wanted then; the words of the error if empty.
    """

    def __init__(
        self, name: str, read: Callable[[str], object], wanted: str = ""
    ) -> None:
        self.name = name
        self.read = read
        self.wanted = wanted

    def convert(
        self,
        value: object,
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> object:
        """The value; one that was converted before is left alone."""
        if not isinstance(value, str):
            return value
        try:
            return self.read(value)
        except ValueError as error:
            why = f"{value!r} is not {self.wanted}" if self.wanted else str(error)
            self.fail(why, param, ctx)


def pair(form: str, read: Callable[[str], object] = str) -> Text:
    """A text ``KEY=VALUE``, split at the first ``=``, whose value is read."""

    def key_and_value(text: str) -> tuple[str, object]:
        # bytes of a terminal that is said to know only ASCII
        with suppress(UnicodeError):
            text = os.fsencode(text).decode("utf-8")
        key, sign, value = text.partition("=")
        if not sign or not key.strip() or not value.strip():
            raise ValueError(f"{text!r} is not of the form {form}")
        return key.strip(), read(value.strip())

    return Text(form, key_and_value)


def once(
    ctx: click.Context, param: click.Parameter, pairs: Iterable[tuple[Key, Value]]
) -> dict[Key, Value]:
    """Pairs as a mapping; a key given twice is a usage error."""
    mapping: dict[Key, Value] = {}
    for key, value in pairs:
        if key in mapping:
            raise click.BadParameter(f"{key}= is given twice.", ctx, param)
        mapping[key] = value
    return mapping


def law_names(text: str) -> list[str]:
    """Names of the laws of a site, ``linear_elastic+dahl``."""
    from .. import laws

    known = laws.registry()
    names = [name.strip() for name in text.split("+")]
    for name in names:
        if name not in known:
            listed = ", ".join(sorted(known))
            raise ValueError(f"there is no law {name!r}. Known are {listed}.")
    return names


def mass(text: str) -> tuple[int, float]:
    """A DOF and its mass, kg, ``2=12.4``."""
    dof, _, value = text.partition("=")
    return int(dof), float(value)


def band(text: str) -> Band:
    """Two frequencies, Hz; ``none`` is an open end."""
    ends: list[float | None] = []
    for end in text.split(","):
        is_open = end.strip().lower() in ("none", "", "inf")
        ends.append(None if is_open else float(end))
    low, high = ends
    return low, high


def degree(text: str) -> Degree:
    """A total degree, ``3``, or a box ``k,q``."""
    numbers = _whole_numbers(text)
    if len(numbers) not in (1, 2) or min(numbers) < 0:
        raise ValueError(f"{text!r} is not a degree (3) or a box k,q (2,3)")
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def number_range(text: str) -> list[int]:
    """Whole numbers: ``1-7``, or ``1,3,5``."""
    low, dash, high = text.partition("-")
    if dash:
        ends = _whole_numbers(f"{low},{high}")
        numbers = list(range(ends[0], ends[1] + 1)) if ends else []
    else:
        numbers = _whole_numbers(text)
    if not numbers or min(numbers) < 0 or max(numbers) > LARGEST_NUMBER:
        wanted = f"whole numbers up to {LARGEST_NUMBER}, e.g. 1-7 or 1,3,5"
        raise ValueError(f"{text!r} is not {wanted}")
    return numbers


def floors(text: str) -> list[int]:
    """Floors: as a range, or ``none``."""
    return [] if text.strip().lower() == "none" else number_range(text)


def _numbers(text: str) -> list[float]:
    """Numbers with commas between them."""
    return [float(number) for number in text.split(",")]


def _whole_numbers(text: str) -> list[int]:
    """Whole numbers with commas between them; empty if they are not."""
    try:
        return [int(number) for number in text.split(",")]
    except ValueError:
        return []


def _site(text: str) -> str:
    """A site in its usual spelling."""
    return str(Site(text))


FLOORS = Text("I,J,...", floors)
NUMBERS = Text("A,B,...", _numbers, "numbers with commas between them, e.g. 0.001,0,0")
RANGE = Text("A-B|A,B,...", number_range)
SITE = Text("SITE", _site)
DEGREE = Text("N|K,Q", degree)
BAND = Text("LO,HI", band, "a band, e.g. 0.5,30 (Hz)")
MASS = Text("DOF=KG", mass, "a floor and its mass in kg, e.g. 2=12.4")
PATH = click.Path(path_type=Path)
