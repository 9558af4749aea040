"""One kind of bad input, what must come of it, and the judge."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
from click.testing import CliRunner
from sklearn.exceptions import NotFittedError

from pysindy_nrf.cli import group
from pysindy_nrf.exceptions import MissingExtraError, NRFError, NRFWarning

TYPED_ERRORS = (NRFError, MissingExtraError, NotFittedError)
GOOD_ANSWERS = ("caught", "warned", "right")
BROKEN = ("silent", "bare", "changed", "wrong type", "wrong words", "wrong code")


@dataclass(frozen=True)
class Kind:
    """A bad input.

    Attributes
    ----------
    name : str
    call : partial
        What a user would do. Its arguments are the user's own arrays, tables and files,
        which must be the same to the last bit afterwards. On the command line it
        returns the words that are typed.
    expected : type, int or callable
        A class of errors or warnings; the exit code of the command line; or a callable
        that says of the result whether it is the one that clean input gives.
    words : tuple of str
        Patterns that the message must match: what is wrong and where, then the cure.
    room : str
        The part of the package that is given the input.
    """

    name: str
    call: partial
    expected: Any
    words: tuple[str, ...] = ()
    room: str = ""

    def __str__(self) -> str:
        return f"{self.room}: {self.name}"

    @property
    def promise(self) -> str:
        """What is expected, in words."""
        if isinstance(self.expected, type):
            return self.expected.__name__
        if isinstance(self.expected, int):
            return f"exit code {self.expected}"
        return "the right number"


@dataclass(frozen=True)
class Outcome:
    """What came of a kind: one of ``KEPT`` or ``BROKEN``, and the message."""

    kind: Kind
    got: str
    message: str

    @property
    def is_good(self) -> bool:
        """Whether the promise was kept."""
        return self.got in GOOD_ANSWERS


def refused(name: str, call: partial, *words: str) -> Kind:
    """A kind that an error of the package must refuse."""
    return Kind(name, call, NRFError, words)


def judge(kind: Kind) -> Outcome:
    """Do what the user would do and say what came of it."""
    arguments = (kind.call.args, kind.call.keywords)
    before = fingerprint(arguments)
    if isinstance(kind.expected, int):
        got, message = judge_command(kind)
    else:
        got, message = judge_call(kind)

    if fingerprint(arguments) != before:
        got = "changed"
    return Outcome(kind, got, message)


def judge_call(kind: Kind) -> tuple[str, str]:
    """Outcome and message of a call of the package."""
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        try:
            value = kind.call()
        except TYPED_ERRORS as error:
            return judge_error(kind, error)
        except Exception as error:
            return "bare", described(error)

    if isinstance(kind.expected, type):
        return judge_warnings(kind, raised, value)
    if kind.expected(value):
        return "right", ""
    return "silent", f"returned {value!r:.80}"


def judge_error(kind: Kind, error: Exception) -> tuple[str, str]:
    """Whether an error of the package is the promised one."""
    if isinstance(kind.expected, type) and isinstance(error, kind.expected):
        return judge_words(kind, [str(error)], "caught")
    return "wrong type", described(error)


def judge_warnings(
    kind: Kind, raised: list[warnings.WarningMessage], value: Any
) -> tuple[str, str]:
    """Whether the promised warning is among those raised."""
    promised = messages_of(raised, kind.expected)
    if promised:
        return judge_words(kind, promised, "warned")

    others = messages_of(raised, NRFWarning)
    if others:
        return "silent", f"other warnings: {'; '.join(others)[:200]}"
    return "silent", f"returned {value!r:.80}"


def judge_command(kind: Kind) -> tuple[str, str]:
    """Outcome and message of a command, run in a folder of its own."""
    runner = CliRunner()
    with runner.isolation() as streams, runner.isolated_filesystem():
        try:
            code = group.run([str(word) for word in kind.call()])
        except SystemExit as leave:
            code = leave.code
        except BaseException as error:
            return "bare", described(error)
        text = "".join(stream.getvalue().decode() for stream in streams[:2])

    if "Traceback" in text or "Unexpected" in text:
        return "bare", text[-300:]
    if code == kind.expected:
        return judge_words(kind, [text], "caught")
    got = "wrong code" if code else "silent"
    return got, f"exit code {code}: {text[-300:]}"


def judge_words(kind: Kind, messages: list[str], good: str) -> tuple[str, str]:
    """Whether one message says what is wrong, where, and the cure."""
    for text in messages:
        if all(re.search(word, text, re.DOTALL) for word in kind.words):
            return good, text
    return "wrong words", " | ".join(messages)


def messages_of(
    raised: list[warnings.WarningMessage], category: type[Warning]
) -> list[str]:
    """Texts of the warnings of one category."""
    return [str(w.message) for w in raised if issubclass(w.category, category)]


def described(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def fingerprint(value: Any) -> str:
    """A digest of everything a user would miss if it changed."""
    return joblib.hash(list(parts_of(value)))


def parts_of(value: Any) -> Iterator[Any]:
    """Values one by one, with what files contain, and masks and locks of arrays."""
    if isinstance(value, dict):
        yield list(value)
        value = list(value.values())

    if isinstance(value, (list, tuple)):
        for item in value:
            yield from parts_of(item)
    elif isinstance(value, Path) and value.is_file():
        yield value.read_bytes()
    elif isinstance(value, np.ma.MaskedArray):
        yield value.data
        yield np.ma.getmaskarray(value)
    elif isinstance(value, pd.DataFrame):
        yield from (value.attrs, list(value), value.index)
        for column in range(value.shape[1]):
            yield value.iloc[:, column].to_numpy()
    else:
        yield value
        if isinstance(value, np.ndarray):
            yield value.flags.writeable
