"""Results of a run: written aside, then moved into place whole, with a manifest.
Nothing else is written over.

A manifest names the files of a run with their SHA-256. A run replaces files that an
earlier one made and nobody changed, and no others. Earlier results that share a file
with it, or came from other inputs, go.
"""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from ..common.audit import versions
from ..common.files import PART, atomic_write, file_behind, hold, left_behind
from ..exceptions import NRFError

MANIFEST = "manifest.json"
_SCHEMA, _VERSION, _LOCK, _OLD = "pysindy_nrf.Manifest", 1, "lock", "replaced"


class Results:
    """The place where a run writes: a folder, or one file with its manifest beside
    it.
    """

    def __init__(
        self, output: Path, single: bool, inputs: Sequence[Path], force: bool
    ) -> None:
        self.output, self.inputs, self.force = output, inputs, force
        self.home = output.parent if single else output
        self.manifest = self.home / (
            f"{output.name}.{MANIFEST}" if single else MANIFEST
        )
        if not self.home.is_dir():
            file_behind(self.home)
        for left in left_behind(self.home / output.name, _LOCK):
            self._undo(left)
        if single:
            self._refuse([output.name])

    def _undo(self, left: Path) -> None:
        """Remove what a killed run left; if it was moving its results, the earlier ones
        come back.
        """
        if (left / MANIFEST).exists():  # it is moved last
            for name, mark in (
                one
                for run in self._runs(left / MANIFEST)[-1:]
                for one in run["files"].items()
            ):
                if _is(self.home / name, mark):
                    (self.home / name).unlink()
            for old in (left / _OLD).glob("*"):
                if not (self.home / old.name).exists():
                    shutil.move(old, self.home / old.name)
        shutil.rmtree(left, ignore_errors=True)

    def _runs(self, path: Path) -> list[dict[str, Any]]:
        """Earlier runs by a manifest, none if it cannot be read or names files
        elsewhere.
        """
        with suppress(OSError, ValueError, TypeError, LookupError, AttributeError):
            data = json.loads(path.read_text(encoding="utf-8"))
            held = {one for run in data["runs"] for one in run["files"].items()}
            read = {one["sha256"] for run in data["runs"] for one in run["inputs"]}
            sound = (
                data["schema"] == _SCHEMA
                and None not in read
                and all(Path(name).name == name for name, _ in held)
            )
            return data["runs"] if sound else []
        return []

    def _read(self, path: Path) -> bool:
        """Whether a file is an input of the run, by this or another name."""
        return any(one.exists() and one.samefile(path) for one in self.inputs)

    def _refuse(self, names: Sequence[str]) -> None:
        """Raise an NRFError if a file would be lost: an input, or what is no unchanged
        result of an earlier run.
        """
        earlier = [
            run["files"]
            for path in self.home.glob(f"*{MANIFEST}")
            for run in self._runs(path)
        ]
        for target in (self.home / name for name in names):
            if not file_behind(target).exists() or self.force:
                continue
            read, made = (
                self._read(target),
                any(_is(target, files.get(target.name)) for files in earlier),
            )
            if read or not made:
                what = (
                    "an input of this run"
                    if read
                    else "no result of an earlier run, or changed since"
                )
                raise NRFError(
                    f"{target} is {what}, and would be lost",
                    "Give another output (-o), or say --force.",
                )

    @cached_property
    def sources(self) -> list[dict[str, Any]]:
        """The inputs as they are named in manifests and models: ``file``, ``bytes``,
        ``sha256``.
        """
        files = [path for path in dict.fromkeys(self.inputs) if path.is_file()]
        return [
            {"file": str(path), "bytes": path.stat().st_size, "sha256": sha256(path)}
            for path in files
        ]

    @contextmanager
    def aside(self, about: Mapping[str, Any]) -> Iterator[Path]:
        """A folder for the files of the run, moved into place at the end; ``about``
        goes into the manifest.
        """
        made = [path for path in (self.home, *self.home.parents) if not path.exists()]
        self.home.mkdir(parents=True, exist_ok=True)
        aside = Path(
            tempfile.mkdtemp(dir=self.home, prefix=f".{self.output.name}.", suffix=PART)
        )
        try:
            (aside / _LOCK).touch()
            with open(aside / _LOCK, "rb") as lock:
                hold(lock.fileno())
                yield aside
                self._move(aside, about)
        except OSError as error:
            if (
                error.filename is not None
                and Path(error.filename).parent == aside.resolve()
            ):
                error.filename = str(self.home / Path(error.filename).name)
            raise
        finally:
            if not any((aside / _OLD).glob("*")):  # else the next run brings them back
                shutil.rmtree(aside, ignore_errors=True)
            with suppress(OSError):  # they hold results
                for path in made:
                    path.rmdir()

    def _move(self, aside: Path, about: Mapping[str, Any]) -> None:
        """Move the files into place, the manifest last; what they replace comes back if
        that fails.
        """
        new = {
            path.name: sha256(path)
            for path in sorted(aside.iterdir())
            if path.name != _LOCK
        }
        self._refuse(list(new))
        run = {**about, "versions": versions(), "inputs": self.sources, "files": new}
        earlier = self._runs(self.manifest)
        kept = [one for one in earlier if _beside(one, run)]
        stale = {
            self.home / name: mark
            for one in earlier
            if one not in kept
            for name, mark in one["files"].items()
        }
        out = {
            path
            for path, mark in stale.items()
            if _is(path, mark) and not self._read(path)
        }
        out |= {self.home / name for name in new}
        with atomic_write(aside / MANIFEST) as file:
            json.dump(
                {"schema": _SCHEMA, "version": _VERSION, "runs": [*kept, run]},
                file,
                indent=2,
            )
        (aside / _OLD).mkdir()
        done: list[tuple[Path, Path]] = []
        try:
            for path in map(file_behind, (self.manifest, *out)):
                if path.exists():
                    done.append(
                        (path, Path(shutil.move(path, aside / _OLD / path.name)))
                    )
            for name, path in {
                **{name: self.home / name for name in new},
                MANIFEST: self.manifest,
            }.items():
                done.append(
                    (aside / name, Path(shutil.move(aside / name, file_behind(path))))
                )
        except BaseException:
            for before, after in reversed(done):
                shutil.move(after, before)
            raise
        shutil.rmtree(aside / _OLD)


def _is(path: Path, mark: str | None) -> bool:
    """Whether a file is there and has this SHA-256."""
    return mark is not None and path.is_file() and sha256(path) == mark


def _beside(earlier: Mapping[str, Any], run: Mapping[str, Any]) -> bool:
    """Whether earlier results stay beside new ones: no common file, and the same inputs
    or results that are inputs.
    """
    had, used = ({one["sha256"] for one in each["inputs"]} for each in (earlier, run))
    related = had == used or not used.isdisjoint(earlier["files"].values())
    return related and earlier["files"].keys().isdisjoint(run["files"])


def sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
