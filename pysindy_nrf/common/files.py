"""Files: atomic writing, strict JSON, and schemas of the files that this package
writes.
"""

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
from typing import IO, Any, Literal

from ..exceptions import FileFormatError, NRFError

try:
    import fcntl
except (
    ImportError
):  # Windows, where nothing is locked and nothing left behind is removed
    fcntl = None  # type: ignore[assignment]


@contextmanager
def atomic_write(path: Any, mode: Literal["w", "wb"] = "w") -> Iterator[IO[Any]]:
    """Open a temporary file that replaces the target on success: a reader sees the old
    or the complete new file.
    """
    target = file_behind(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(
        dir=target.parent, prefix=f".{target.name}.", suffix=PART
    )
    try:
        # a name that UTF-8 cannot hold is written as its code, which JSON reads back as
        # the same name
        text: dict[str, Any] = (
            {"encoding": "utf-8", "newline": "", "errors": "backslashreplace"}
            if mode == "w"
            else {}
        )
        with os.fdopen(handle, mode, **text) as file:
            hold(file.fileno())
            for left in left_behind(target):
                left.unlink(missing_ok=True)
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


PART = ".part"  # suffix of what is being written


def file_behind(path: Any) -> Path:
    """The file that a path leads to, links followed; an NRFError for a device, a pipe
    or a folder.
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
    """Lock an open file for as long as this process has it open; False if another
    process does.
    """
    if fcntl is None:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def left_behind(target: Path, lock: str = "") -> Iterator[Path]:
    """What processes that were killed left beside a target; each holds its temporary
    file (or ``lock`` in a folder).
    """
    for path in target.parent.glob(f".{escape(target.name)}.*{PART}"):
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
    return json.loads(
        (files(__package__) / "schemas" / f"{name}.schema.json").read_text(
            encoding="utf-8"
        )
    )


def plain_json(text: str) -> Any:
    """Parsed strict JSON; raises ValueError for NaN, infinity (also 1e999) and repeated
    keys.
    """

    def constant(word: str) -> Any:
        raise ValueError(f"{word} is not a JSON number")

    def number(word: str) -> float:
        if not math.isfinite(float(word)):
            raise ValueError(f"{word} is beyond the range of a double")
        return float(word)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        out = dict(pairs)
        if len(out) < len(pairs):
            raise ValueError("a key occurs twice in one object")
        return out

    return json.loads(
        text, parse_constant=constant, parse_float=number, object_pairs_hook=once
    )


def check(data: Any, rules: dict[str, Any], where: str) -> None:
    """Raise FileFormatError, naming the place, if the parsed JSON of the file ``where``
    does not match a schema.
    """
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    fault = best_match(Draft202012Validator(rules).iter_errors(data))
    if fault is not None:
        title = rules["title"].partition(",")[0].lower()
        said = (
            fault.message
            if len(fault.message) <= 120
            else f"{fault.message[:60]} ... {fault.message[-55:]}"
        )
        cure = "Write the file again, or correct it there."
        raise FileFormatError(
            f"{where} is not a readable {title}: {fault.json_path[2:] or 'the whole'}:"
            f" {said}",
            cure,
        )
