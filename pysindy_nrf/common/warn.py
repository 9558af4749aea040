"""Warnings that point at the line of the user who called the package."""

import inspect
import os
import sys
import warnings
from pathlib import Path
from weakref import WeakKeyDictionary

_PACKAGE = str(Path(__file__).parents[1]) + os.sep
# Where scikit-learn's searches call estimators.
_SEARCHES = os.path.join("sklearn", "model_selection", "_search")
# By search the results of the fit before, and the kinds it has warned of in this one.
# Python's own memory of warnings is lost at every ``catch_warnings``.
_warned: WeakKeyDictionary[object, tuple[int, set[type]]] = WeakKeyDictionary()


def warn_user(message: str | Warning, category: type[Warning] | None = None) -> None:
    """Warn at the first line outside the package, however deep the caller lies.

    A search of scikit-learn warns once of each kind, at the line of the search.

    Parameters
    ----------
    message : str or Warning
    category : type of Warning, optional
        That of ``message`` where it is a Warning.
    """
    inner = [_PACKAGE]
    search = _search_among_callers()
    if search is not None:
        kind = type(message) if isinstance(message, Warning) else category
        if not _is_first(search, kind or UserWarning):
            return
        inner.extend(_folders("sklearn", "joblib"))
        message = (
            "Some fits of this search are doubtful. Fit the model that it chose by"
            f" itself to read why. The first one: {message}"
        )
        category = kind

    if sys.version_info >= (3, 12):
        warnings.warn(message, category, skip_file_prefixes=tuple(inner))
    else:
        warnings.warn(message, category, stacklevel=_level_of_the_user(tuple(inner)))


def _search_among_callers() -> object | None:
    """The search of scikit-learn that is running, if any."""
    frame = inspect.currentframe()
    while frame is not None:
        if _SEARCHES in frame.f_code.co_filename and "self" in frame.f_locals:
            return frame.f_locals["self"]
        frame = frame.f_back
    return None


def _is_first(search: object, kind: type) -> bool:
    """Whether a search has not yet warned of a kind in this fit of it."""
    before = id(getattr(search, "cv_results_", None))
    known, kinds = _warned.get(search, (before, set()))
    if known != before:
        kinds = set()
    _warned[search] = (before, kinds | {kind})
    return kind not in kinds


def _folders(*packages: str) -> list[str]:
    """Folders of packages that are loaded."""
    folders = []
    for name in packages:
        file = getattr(sys.modules.get(name), "__file__", None)
        if file is not None:
            folders.append(str(Path(file).parent) + os.sep)
    return folders


def _level_of_the_user(inner: tuple[str, ...]) -> int:
    """Stack level of the first frame outside some folders, counted from the caller."""
    frame = inspect.currentframe()
    level = 0

    while frame is not None and frame.f_code.co_filename.startswith(inner):
        frame = frame.f_back
        level += 1

    # this function's own frame stands for the first one that warnings.warn counts
    return level
