"""Plain functions of the laws, compiled by numba and kept on disk.

A law's ``kernel`` and ``advance`` are ordinary Python functions. Compiled code is
cached under a fingerprint of the source and of all it calls. So a second process starts
fast, and an edited law is never run with stale code.
"""

import hashlib
import pickle
from collections.abc import Callable
from ctypes import POINTER, c_double
from functools import cache
from types import CodeType, ModuleType, SimpleNamespace
from typing import Any

import numba
import numpy as np
from llvmlite import ir

# public, but not in numba's __all__
from numba import carray, types  # type: ignore[attr-defined]
from numba.core import cgutils
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.ccallback import CFunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError, TypingError
from numba.extending import intrinsic

from ..exceptions import LawError

_NAMING = (  # code cached under another rule of naming is ignored
    "names with fingerprints, references not counted"
)
_COMPILED: Any = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
_VECTOR = types.CPointer(types.float64)
_KERNEL_SIGNATURE = types.void(*[types.float64] * 4, *[_VECTOR, types.int64] * 4)
_ADVANCE_SIGNATURE = types.void(
    _VECTOR, types.int64, *[types.float64] * 5, *[_VECTOR, types.int64] * 2
)
_ROWS = [
    _VECTOR,
    types.int64,
    types.int64,
]  # the first row, how far the next one is, and the next sample
_WALK_SIGNATURE = types.void(
    *[_VECTOR] * 4, types.int64, *_ROWS, _VECTOR, types.int64, *_ROWS
)


class _PartLibrary(JITCodeLibrary):
    """Code that is optimised and becomes machine code where it is linked into what
    calls it, not before.
    """

    codegen: Any = SimpleNamespace(
        set_env=lambda *_: None
    )  # there is no machine code yet that could have one

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


class _PartCompiler(Compiler):
    """Compiler of what only compiled code calls."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.state.library = _PartLibrary(self.state.targetctx.codegen(), "part")


_INSIDE: Any = _COMPILED | {"no_cpython_wrapper": True, "pipeline_class": _PartCompiler}


def fingerprint(*functions: Any) -> str:
    """Hash of the code of functions, with the constants, closures and functions they
    use.
    """
    digest = hashlib.sha256(f"numba {numba.__version__}, {_NAMING}".encode())
    seen: set[int] = set()

    def code(block: CodeType) -> None:
        digest.update(block.co_code)
        for constant in block.co_consts:
            (
                code(constant)
                if isinstance(constant, CodeType)
                else digest.update(repr(constant).encode())
            )
        digest.update(repr((block.co_names, block.co_varnames)).encode())

    def visit(value: Any) -> None:
        if isinstance(value, Dispatcher):
            options = {
                k: sorted(v) if isinstance(v, set) else v
                for k, v in value.targetoptions.items()
            }
            digest.update(repr(sorted(options.items())).encode())
            value = value.py_func
        value = getattr(value, "_defn", value)  # the function behind a numba intrinsic
        if isinstance(value, ModuleType):
            digest.update(value.__name__.encode())
        elif isinstance(value, np.ndarray):
            digest.update(value.tobytes())
        elif hasattr(value, "__code__"):
            if id(value) in seen:
                return
            seen.add(id(value))
            code(value.__code__)
            for cell in value.__closure__ or ():
                visit(cell.cell_contents)
            for name in value.__code__.co_names:
                if name in value.__globals__:
                    digest.update(name.encode())
                    visit(value.__globals__[name])
        elif isinstance(value, (int, float, complex, str, bytes, tuple, type(None))):
            digest.update(repr(value).encode())
        else:
            digest.update(
                getattr(value, "__qualname__", type(value).__qualname__).encode()
            )

    for function in functions:
        visit(function)
    return digest.hexdigest()


class _CodeCache(FunctionCache):
    """Disk cache keyed by the fingerprint, one index file for each fingerprint."""

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self._print = fingerprint(function)
        locator = self._impl.locator
        name = f"{function.__name__}-{self._print[:24]}"
        self._cache_file = IndexDataCacheFile(
            locator.get_cache_path(), name, locator.get_source_stamp()
        )

    def _index_key(self, sig: Any, codegen: Any) -> tuple:
        return sig, codegen.magic_tuple(), self._print

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code on disk, or None (compile again) if it cannot be read."""
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError, EOFError, pickle.UnpicklingError):
            return None


def _named(function: Callable) -> Callable:
    """The function under a name that holds its fingerprint."""
    mark = fingerprint(function)[:16]
    if not function.__qualname__.endswith(mark):
        function.__qualname__ = f"{function.__qualname__}_{mark}"
    return function


def _attach_cache(compiled: Any, function: Callable) -> Any:
    """Cache on disk; without a writable directory the code is compiled in every
    process.
    """
    try:
        compiled._cache = _CodeCache(function)
    except (RuntimeError, OSError):
        pass
    return compiled


def jit(function: Callable) -> Dispatcher:
    """Compile a plain function on its first call, cached on disk. Its caller makes the
    arrays that it needs.
    """
    return _attach_cache(
        numba.njit(**_COMPILED | {"_nrt": False})(_named(function)), function
    )


def read_only(array: np.ndarray) -> np.ndarray:
    """Read-only view as floats in C order; another layout would trigger a further
    compilation.
    """
    view = np.ascontiguousarray(array, dtype=float).view()
    view.flags.writeable = False
    return view


def inline(function: Callable, fastmath: Any = False) -> Dispatcher:
    """A small plain function for use within :func:`jit` code, copied into every place
    that calls it.
    """
    if isinstance(function, Dispatcher):
        return function
    return numba.njit(forceinline=True, fastmath=fastmath, **_INSIDE)(function)


def part(function: Callable) -> Dispatcher:
    """A larger plain function for use within :func:`jit` code."""
    return numba.njit(**_INSIDE)(_named(function))


def _on_stack(typing_context: Any, size: Any) -> Any:
    """Array on the stack. Nothing else can write to it, so a loop can keep it in
    registers.
    """
    if not isinstance(size, types.IntegerLiteral):
        return None
    line = types.Array(types.float64, 1, "C")

    def codegen(context, builder, signature, args):
        count = max(size.literal_value, 1)
        number = context.get_value_type(types.float64)
        place = cgutils.alloca_once(
            builder, number, size=context.get_constant(types.intp, count)
        )
        view = context.make_array(line)(context, builder)
        extent, step = (
            context.get_constant(types.intp, size.literal_value),
            context.get_constant(types.intp, 8),
        )
        context.populate_array(
            view,
            data=place,
            shape=[extent],
            strides=[step],
            itemsize=step,
            meminfo=None,
        )
        return view._getvalue()

    return line(size), codegen


on_stack: Any = intrinsic(prefer_literal=True)(_on_stack)


def _addressed(kind: Any) -> Any:
    if hasattr(kind, "types"):
        return types.BaseTuple.from_types(
            [_addressed(k) for k in kind.types], getattr(kind, "instance_class", None)
        )
    if not isinstance(kind, types.Array):
        return kind
    if kind.layout != "C":
        raise TypingError("An array is not in C order")
    return types.CPointer(kind.dtype)


def _addresses(typing_context: Any, given: Any) -> Any:
    """A tuple of arrays, numbers and such named tuples, with addresses for arrays: a
    tenth of the code to compile.
    """

    def codegen(context, builder, signature, args):
        def replaced(kind, value):
            if isinstance(kind, types.Array):
                return cgutils.create_struct_proxy(kind)(
                    context, builder, value=value
                ).data
            if not hasattr(kind, "types"):
                return value
            parts = map(replaced, kind.types, cgutils.unpack_tuple(builder, value))
            return context.make_tuple(builder, _addressed(kind), list(parts))

        return replaced(signature.args[0], args[0])

    return _addressed(given)(given), codegen


addresses: Any = intrinsic(_addresses)


def _address(typing_context: Any, array: Any, start: Any) -> Any:
    """Address of an element behind an address."""

    def codegen(context, builder, signature, args):
        return builder.gep(args[0], [args[1]])

    return array(array, types.intp), codegen


address_of: Any = intrinsic(_address)


def _caller(function: Any) -> Any:
    """Call a machine-code callback of some signature by its address: ``call(address,
    (argument, ...))``.
    """

    def call(typing_context, address, arguments):
        def codegen(context, builder, signature, args):
            kinds = [context.get_value_type(kind) for kind in function.args]
            pointer = builder.inttoptr(
                args[0], ir.FunctionType(ir.VoidType(), kinds).as_pointer()
            )
            builder.call(pointer, cgutils.unpack_tuple(builder, args[1]))
            return context.get_dummy_value()

        return types.void(address, arguments), codegen

    return intrinsic(call)


call_kernel, call_advance, call_walk = map(
    _caller, (_KERNEL_SIGNATURE, _ADVANCE_SIGNATURE, _WALK_SIGNATURE)
)


def _pointer(function: Callable, signature: Any) -> CFunc:
    callback = CFunc(
        _named(function),
        (signature.args, signature.return_type),
        {},
        {"nopython": True},
    )
    _attach_cache(callback, function)
    callback.compile()
    return callback


@cache
def kernel_pointer(kernel: Callable) -> CFunc:
    """A law's kernel for single samples as a machine-code callback."""
    law = inline(kernel)

    def kernel_callback(s, v, a, t, u, n_u, z, n_z, theta, n_theta, out, n_out):
        law(
            s,
            v,
            a,
            t,
            carray(u, n_u),
            carray(z, n_z),
            carray(theta, n_theta),
            carray(out, n_out),
        )

    return _pointer(kernel_callback, _KERNEL_SIGNATURE)


@cache
def advance_pointer(advance: Callable) -> CFunc:
    """A law's state update as a machine-code callback."""
    law = inline(advance)

    def advance_callback(z, n_z, s0, v0, s1, v1, dt, u, n_u, theta, n_theta):
        law(carray(z, n_z), s0, v0, s1, v1, dt, carray(u, n_u), carray(theta, n_theta))

    return _pointer(advance_callback, _ADVANCE_SIGNATURE)


@cache
def walk_pointer(advance: Callable, n_states: int, n_inputs: int) -> CFunc:
    """A law's state updates along samples without a reversal as a machine-code
    callback.
    """
    law = inline(advance)

    def walk_callback(
        state, s, v, h, n, u, next_u, step_u, theta, n_theta, z, next_z, step_z
    ):
        now, middle, shape = (
            on_stack(n_states),
            on_stack(n_inputs),
            carray(theta, n_theta),
        )  # both stay in registers
        for k in range(n_states):
            now[k] = state[k]
        for i in range(n):
            for k in range(n_inputs):
                at = k * next_u + i * step_u
                middle[k] = 0.5 * (u[at] + u[at + 1])
            law(now, s[i], v[i], s[i + 1], v[i + 1], h[i], middle, shape)
            for k in range(n_states):
                z[k * next_z + i * step_z] = now[k]
        for k in range(n_states):
            state[k] = now[k]

    return _pointer(walk_callback, _WALK_SIGNATURE)


def pointers(law: Any) -> tuple[CFunc, CFunc]:
    """Kernel and state update of a law as machine-code callbacks."""
    try:
        return kernel_pointer(type(law).kernel), advance_pointer(type(law).advance)
    except NumbaError as error:
        raise cannot_compile(law, error) from error


def on_a_sample(law: Any) -> Callable[..., None]:
    """A law's compiled kernel, called as the plain one."""
    kernel, line = pointers(law)[0].ctypes, POINTER(c_double)
    return lambda *x: kernel(
        *x[:4], *(given for y in x[4:] for given in (y.ctypes.data_as(line), y.size))
    )


def cannot_compile(law: Any, error: Exception) -> LawError:
    """Error for a law that numba does not accept."""
    reason = (
        str(error).strip().splitlines()[-1]
        if str(error).strip()
        else type(error).__name__
    )
    return LawError(
        f"{type(law).__name__} cannot be compiled for single samples ({reason})",
        "Write kernel and advance with plain arithmetic, math and NumPy ufuncs only.",
    )
