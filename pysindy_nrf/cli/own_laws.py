"""Force laws of the user's own, from Python files."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import click

from ..exceptions import LawError
from .session import NAMED_FILES


def load_laws(path: Path) -> list[str]:
    """Run a Python file that defines force laws; they are registered by it.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of str
        Names of its laws.

    Raises
    ------
    LawError
        If the file cannot be run, or defines no law.
    """
    from ..laws import registry

    name = f"laws_of_{path.stem}"
    spec = spec_from_file_location(name, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise LawError(f"{path} is no Python file", "Give a .py file with your laws.")
    module = module_from_spec(spec)
    # compiled functions look their module up
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        # the user's code may raise anything
        raise LawError(
            f"{path} cannot be run: {type(error).__name__}: {error}",
            "See docs/add_your_own_law.md.",
        ) from error

    names = [law.name for law in registry().values() if law.__module__ == name]
    if not names:
        raise LawError(
            f"{path} defines no law", "Write a subclass of laws.ForceLaw with a name."
        )
    return names


def take_laws(
    context: click.Context, _: click.Parameter, paths: Iterable[Path]
) -> None:
    """Load files of laws before any other option is read."""
    for path in paths:
        load_laws(path)
        context.meta.setdefault(NAMED_FILES, []).append(path)
