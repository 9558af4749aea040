"""Files: atomic writing, strict JSON, and schemas of what this package writes."""

import json
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from glob import escape
from importlib.resources import files
from pathlib import Path
from typing import IO, Any, Literal, NoReturn

from ..exceptions import FileFormatError, NRFError

try:
    import fcntl
except ImportError:
    # On Windows nothing is locked, and nothing that was left behind is removed.
    fcntl = None  # type: ignore[assignment]

# Suffix of what is being written.
UNFINISHED_SUFFIX = ".part"
# Characters of a message about a file that does not match its schema.
MAX_MESSAGE_CHARACTERS = 120
PathLike = str | os.PathLike[str]


@contextmanager
def atomic_write(path: PathLike, mode: Literal["w", "wb"] = "w") -> Iterator[IO[Any]]:
    """Open a temporary file that replaces the target on success.

    A reader sees the old or the complete new file.
    """
    target = file_behind(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(
        dir=target.parent, prefix=f".{target.name}.", suffix=UNFINISHED_SUFFIX
    )
    try:
        with _opened(handle, mode) as file:
            hold(file.fileno())
            for abandoned in left_behind(target):
                abandoned.unlink(missing_ok=True)
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, _permissions(target))
        os.replace(temporary, target)
    except BaseException as error:
        with suppress(FileNotFoundError):
            os.unlink(temporary)
        if isinstance(error, OSError) and error.filename is None:  # a full disk
            error.filename = str(target)
        raise


def _opened(handle: int, mode: Literal["w", "wb"]) -> IO[Any]:
    """A file on a handle.

    A name that UTF-8 cannot encode is written as its code, which JSON reads back as the
    same name.
    """
    if mode == "wb":
        return os.fdopen(handle, mode)
    return os.fdopen(
        handle, mode, encoding="utf-8", newline="", errors="backslashreplace"
    )


def file_behind(path: PathLike) -> Path:
    """The file that a path leads to, links followed.

    Raises
    ------
    NRFError
        If it is a device, a pipe or a folder.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        kind = "a folder" if target.is_dir() else "a device or pipe"
        raise NRFError(
            f"{path} is {kind}, no file can be put in its place",
            "Give the name of a file.",
        )
    return target


def hold(handle: int) -> bool:
    """Lock an open file until it is closed; False if another process has locked it."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def left_behind(target: Path, lock: str = "") -> Iterator[Path]:
    """What processes that were killed left next to a target.

    Each process locks its temporary file, or the file ``lock`` in a temporary folder.
    """
    for path in target.parent.glob(f".{escape(target.name)}.*{UNFINISHED_SUFFIX}"):
        with suppress(OSError), open(path / lock, "rb") as file:
            if hold(file.fileno()):
                yield path


def _permissions(target: Path) -> int:
    """Permissions of the file to be replaced, or 666 reduced by the user's umask."""
    with suppress(FileNotFoundError):
        return target.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


@cache
def schema(name: str = "chain_model") -> dict[str, Any]:
    """A shipped schema (JSON Schema, draft 2020-12)."""
    file = files(__package__) / "schemas" / f"{name}.schema.json"
    return json.loads(file.read_text(encoding="utf-8"))


def plain_json(text: str) -> Any:
    """Parsed strict JSON.

    Raises
    ------
    ValueError
        For NaN, infinity (also 1e999) and repeated keys.
    """

    def refuse_constant(word: str) -> NoReturn:
        raise ValueError(f"{word} is not a JSON number")

    def finite_number(word: str) -> float:
        if not math.isfinite(float(word)):
            raise ValueError(f"{word} is beyond the range of a double")
        return float(word)

    def unique_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
        data = dict(pairs)
        if len(data) < len(pairs):
            raise ValueError("a key occurs twice in one object")
        return data

    return json.loads(
        text,
        parse_constant=refuse_constant,
        parse_float=finite_number,
        object_pairs_hook=unique_keys,
    )


def check(data: object, rules: dict[str, Any], where: str) -> None:
    """Check the parsed JSON of a file against a schema.

    Raises
    ------
    FileFormatError
        If it does not match; the message names the place in the file.
    """
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    fault = best_match(Draft202012Validator(rules).iter_errors(data))
    if fault is None:
        return
    message = fault.message
    if len(message) > MAX_MESSAGE_CHARACTERS:
        message = f"{message[:60]} ... {message[-55:]}"
    title = rules["title"].partition(",")[0].lower()
    place = fault.json_path.removeprefix("$.").removeprefix("$") or "the whole"
    raise FileFormatError(
        f"{where} is not a readable {title}: {place}: {message}",
        "Write the file again, or correct it there.",
    )
