"""Functions compiled by numba, cached on disk, and pointers for use inside them.

:func:`jit` compiles what Python calls, :func:`inline` and :func:`subroutine` what only
compiled code calls.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher
from numba.core.errors import TypingError
from numba.core.typing.context import BaseContext
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from .code_cache import attach_cache, with_unique_name

_OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "nogil": True,
    "no_cfunc_wrapper": True,
}


class _PartLibrary(JITCodeLibrary):
    """Code that becomes machine code only where it is linked into what calls it.

    This saves a third of the time that all functions take to compile (10 s, not 15 s).
    """

    # The environment of a function is set in its machine code, which is not there yet.
    codegen = SimpleNamespace(set_env=lambda *_: None)

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


class _PartCompiler(Compiler):
    """Compiler of what only compiled code calls."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)
        self.state.library = _PartLibrary(self.state.targetctx.codegen(), "part")


# Without numba's runtime, which counts references to arrays.
_JIT_OPTIONS: dict[str, Any] = {**_OPTIONS, "_nrt": False}
_PART_OPTIONS: dict[str, Any] = {
    **_OPTIONS,
    "no_cpython_wrapper": True,
    "pipeline_class": _PartCompiler,
}


def jit(function: Callable) -> Dispatcher:
    """Compile a function on its first call; it must not make new arrays."""
    compiled = numba.njit(**_JIT_OPTIONS)(with_unique_name(function))
    attach_cache(compiled, function)
    return compiled


def inline(function: Callable, fastmath: bool | set[str] = False) -> Dispatcher:
    """A small function, copied into every place of compiled code that calls it."""
    if isinstance(function, Dispatcher):
        return function
    return numba.njit(forceinline=True, fastmath=fastmath, **_PART_OPTIONS)(function)


def subroutine(function: Callable) -> Dispatcher:
    """A larger function that only compiled code calls."""
    return numba.njit(**_PART_OPTIONS)(with_unique_name(function))


def read_only(array: np.ndarray) -> np.ndarray:
    """The array as floats in C order, not writeable: one type, compiled once."""
    view = np.ascontiguousarray(array, dtype=float).view()
    view.flags.writeable = False
    return view


def _pointer_type(kind: types.Type) -> types.Type:
    """Numba's type of arrays, numbers and tuples of them with pointers for arrays."""
    if hasattr(kind, "types"):
        members = [_pointer_type(member) for member in kind.types]
        return types.BaseTuple.from_types(
            members, getattr(kind, "instance_class", None)
        )
    if not isinstance(kind, types.Array):
        return kind
    if kind.layout != "C":
        raise TypingError("An array is not in C order")
    return types.CPointer(kind.dtype)


def _addresses(
    typing_context: BaseContext, values: types.Type
) -> tuple[Signature, Callable]:
    """A tuple of arrays, numbers and named tuples of them, with pointers for arrays.

    Numba writes ten times as much code to index an array as to index a pointer.
    """

    def codegen(context, builder, signature, arguments):
        def converted(kind, value):
            if isinstance(kind, types.Array):
                array = cgutils.create_struct_proxy(kind)(context, builder, value=value)
                return array.data
            if not hasattr(kind, "types"):
                return value
            members = cgutils.unpack_tuple(builder, value)
            pointers = list(map(converted, kind.types, members))
            return context.make_tuple(builder, _pointer_type(kind), pointers)

        return converted(signature.args[0], arguments[0])

    return _pointer_type(values)(values), codegen


def _address_of(
    typing_context: BaseContext, pointer: types.CPointer, index: types.Type
) -> tuple[Signature, Callable]:
    """Pointer to an element behind a pointer."""

    def codegen(context, builder, signature, arguments):
        return builder.gep(arguments[0], [arguments[1]])

    return pointer(pointer, types.intp), codegen


addresses: Callable = intrinsic(_addresses)
address_of: Callable = intrinsic(_address_of)
