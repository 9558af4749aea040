"""One kind of bad input, what it must give, and the judge."""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from click.testing import CliRunner
from sklearn.exceptions import NotFittedError

from pysindy_nrf import Record
from pysindy_nrf.exceptions import MissingExtraError, NRFError, NRFWarning

TYPED = (NRFError, MissingExtraError, NotFittedError)


@dataclass(frozen=True)
class Kind:
    """A bad input.

    Attributes
    ----------
    room : str
        What it is given to: ``"estimator"``, ``"record"``, ``"law"``, ``"loop"``,
        ``"file"``, ...
    name : str
    act : callable
        What a user would do with ``given``.
    given : tuple
        The user's own arrays, tables and files; they must be the same to the last bit
        afterwards.
    expected : type, int or callable
        A class of errors or warnings; the exit code of the command line; or a callable
        that says of the result whether it is the one that clean input gives.
    words : tuple of str
        Patterns that the message must hold: what is wrong and where, then the cure.
    """

    room: str
    name: str
    act: Callable[..., Any]
    given: tuple
    expected: Any
    words: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.room}: {self.name}"

    @property
    def promise(self) -> str:
        """What is expected, in words."""
        if isinstance(self.expected, type):
            return self.expected.__name__
        return (
            f"exit code {self.expected}"
            if isinstance(self.expected, int)
            else "the right number"
        )


@dataclass
class Outcome:
    """What a kind gave: ``caught``, ``warned``, ``right``, or one of the failures
    ``silent`` (a number without a word), ``bare`` (an error of no type of ours),
    ``wrong words``, ``changed`` (the input).
    """

    kind: Kind
    got: str
    message: str

    @property
    def kept(self) -> bool:
        """Whether the promise was kept."""
        return self.got in ("caught", "warned", "right")


def judge(kind: Kind) -> Outcome:
    """Do what the user would do and say what came of it."""
    before = fingerprint(kind.given)
    got, message = _attempt(kind)
    if fingerprint(kind.given) != before:
        got = "changed"
    return Outcome(kind, got, message)


def _attempt(kind: Kind) -> tuple[str, str]:
    if isinstance(kind.expected, int):
        return _command(kind)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            value = kind.act(*kind.given)
        except TYPED as error:
            fits = isinstance(kind.expected, type) and isinstance(error, kind.expected)
            return (
                _words(kind, [str(error)], "caught")
                if fits
                else ("wrong type", f"{type(error).__name__}: {error}")
            )
        except Exception as error:
            return "bare", f"{type(error).__name__}: {error}"
    ours = [str(w.message) for w in said if issubclass(w.category, NRFWarning)]
    if not isinstance(kind.expected, type):
        return (
            ("right", "")
            if kind.expected(value)
            else ("silent", f"returned {value!r:.80}")
        )
    chosen = [str(w.message) for w in said if issubclass(w.category, kind.expected)]
    if not chosen:
        return "silent", (
            f"other warnings: {'; '.join(ours)[:200]}"
            if ours
            else f"returned {value!r:.80}"
        )
    return _words(kind, chosen, "warned")


def _words(kind: Kind, messages: list[str], good: str) -> tuple[str, str]:
    """Whether one message says what is wrong, where, and the cure."""
    for text in messages:
        if all(re.search(word, text, re.DOTALL) for word in kind.words):
            return good, text
    return "wrong words", " | ".join(messages)


def _command(kind: Kind) -> tuple[str, str]:
    """Run the command line in a folder of its own; ``act`` returns its arguments."""
    from pysindy_nrf.cli import group

    runner = CliRunner()
    with runner.isolation() as streams, runner.isolated_filesystem():
        try:
            code = group.run([str(a) for a in kind.act(*kind.given)])
        except SystemExit as leave:
            code = leave.code
        except BaseException as error:
            return "bare", f"{type(error).__name__}: {error}"
        text = "".join(stream.getvalue().decode() for stream in streams[:2])
    if "Traceback" in text or "Unexpected" in text:
        return "bare", text[-300:]
    if code != kind.expected:
        return (
            "silent" if code == 0 else "wrong code"
        ), f"exit code {code}: {text[-300:]}"
    return _words(kind, [text], "caught" if code else "warned")


def fingerprint(value: Any) -> str:
    """A digest of everything a user would miss if it changed."""
    digest = hashlib.sha256()
    _feed(value, digest.update)
    return digest.hexdigest()


def _feed(value: Any, update: Callable[[bytes], None]) -> None:
    update(type(value).__name__.encode())
    if isinstance(value, np.ma.MaskedArray):
        _feed([value.data, np.ma.getmaskarray(value)], update)
    elif isinstance(value, np.ndarray):
        update(
            f"{value.dtype}{value.shape}{value.strides}{value.flags.writeable}".encode()
        )
        update(
            repr(value.tolist()).encode()
            if value.dtype.hasobject
            else np.ascontiguousarray(value).tobytes()
        )
    elif isinstance(value, (pd.DataFrame, pd.Series)):
        frame = value.to_frame() if isinstance(value, pd.Series) else value
        _feed([list(map(repr, frame.columns)), repr(frame.index), frame.attrs], update)
        for i in range(frame.shape[1]):
            _feed(frame.iloc[:, i].to_numpy(), update)
    elif isinstance(value, Record):
        _feed(vars(value), update)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _feed([repr(key), item], update)
    elif isinstance(value, (list, tuple)):
        for item in value:
            _feed(item, update)
    elif isinstance(value, Path):
        if value.is_dir():
            _feed(sorted(str(p) for p in value.rglob("*")), update)
        elif value.is_file():
            update(value.read_bytes())
    elif isinstance(value, (str, int, float, complex, bytes, type(None))):
        update(repr(value).encode())
