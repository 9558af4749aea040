"""Disk cache of compiled functions, keyed by all the code that a function uses.

Numba's own ``cache=True`` is not enough here. It misses the edit of a function that is
called from another file. It never finds a function that was made inside another one,
such as the callbacks of the laws: a second process compiles for another two seconds.
"""

import hashlib
import pickle
from collections.abc import Callable
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.base import BaseContext
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import CPUCodegen
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.typing.templates import Signature

# Goes into every fingerprint: a change of this text makes all earlier files unused.
_FORMAT = "names with fingerprints, references not counted"
_PLAIN_TYPES = (int, float, complex, str, bytes, tuple, type(None))
# What numba, llvmlite and pickle raise for files that they cannot read.
_UNREADABLE = (ImportError, AttributeError, EOFError, pickle.UnpicklingError)


class _CodeHash:
    """Hash over functions, with the constants, closures and functions that they use."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256(f"numba {numba.__version__}, {_FORMAT}".encode())
        self._visited: set[int] = set()

    def hexdigest(self) -> str:
        return self._hash.hexdigest()

    def add(self, value: object) -> None:
        """Add a function, or anything that a function refers to."""
        if isinstance(value, Dispatcher):
            self._add_options(value.targetoptions)
            value = value.py_func
        value = getattr(value, "_defn", value)  # the function behind a numba intrinsic

        if isinstance(value, ModuleType):
            self._add_text(value.__name__)
        elif isinstance(value, np.ndarray):
            self._hash.update(value.tobytes())
        elif isinstance(value, MethodType):
            self.add(value.__func__)
        elif isinstance(value, FunctionType):
            self._add_function(value)
        elif isinstance(value, _PLAIN_TYPES):
            self._add_text(repr(value))
        else:
            self._add_text(getattr(value, "__qualname__", type(value).__qualname__))

    def _add_function(self, function: FunctionType) -> None:
        if id(function) in self._visited:  # it calls itself
            return
        self._visited.add(id(function))

        self._add_code(function.__code__)
        for cell in function.__closure__ or ():
            self.add(cell.cell_contents)
        for name in function.__code__.co_names:
            if name in function.__globals__:
                self._add_text(name)
                self.add(function.__globals__[name])

    def _add_code(self, code: CodeType) -> None:
        self._hash.update(code.co_code)
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                self._add_code(constant)
            else:
                self._add_text(repr(constant))
        self._add_text(repr((code.co_names, code.co_varnames)))

    def _add_options(self, options: dict[str, object]) -> None:
        """Add compiler options; the order of a set changes from process to process."""
        for name, value in sorted(options.items()):
            ordered = sorted(value) if isinstance(value, set) else value
            self._add_text(f"{name}={ordered!r}")

    def _add_text(self, text: str) -> None:
        self._hash.update(text.encode())


def fingerprint(*functions: object) -> str:
    """Hash of the code of functions, and of the constants and functions they use."""
    code = _CodeHash()
    for function in functions:
        code.add(function)
    return code.hexdigest()


def with_unique_name(function: Callable) -> Callable:
    """The function under a name that contains its fingerprint.

    Numba numbers machine code afresh in each process. Code of two processes can have
    the same number, and one would be linked in place of the other.
    """
    mark = fingerprint(function)[:16]
    if not function.__qualname__.endswith(mark):
        function.__qualname__ = f"{function.__qualname__}_{mark}"
    return function


class _FingerprintCache(FunctionCache):
    """Numba's cache with one index file for each fingerprint of a function."""

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self._fingerprint = fingerprint(function)

        locator = self._impl.locator
        self._cache_file = IndexDataCacheFile(
            locator.get_cache_path(),
            f"{function.__name__}-{self._fingerprint[:24]}",
            locator.get_source_stamp(),
        )

    def _index_key(self, sig: Signature, codegen: CPUCodegen) -> tuple:
        return sig, codegen.magic_tuple(), self._fingerprint

    def load_overload(
        self, sig: Signature, target_context: BaseContext
    ) -> CompileResult | None:
        """The code on disk; None, so that it is compiled again, if it is damaged."""
        try:
            return super().load_overload(sig, target_context)
        except _UNREADABLE:
            return None


def attach_cache(compiled: Any, function: Callable) -> None:
    """Cache what numba compiles of a function, where a folder can be written."""
    try:
        compiled._cache = _FingerprintCache(function)
    except (RuntimeError, OSError):
        pass  # compiled anew in every process
