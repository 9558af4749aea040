"""Laws as machine code: callbacks for single samples, and how compiled code calls them.

A law's ``kernel`` and ``advance`` are ordinary Python functions. Here each becomes a
callback of one fixed signature, so that an integrator is compiled once for all laws and
calls them by their address. Arrays go as a pointer and a size.
"""

from collections.abc import Callable, Iterator
from ctypes import POINTER, c_double
from functools import cache
from types import FunctionType

import numpy as np
from llvmlite import ir

# public, but not in numba's __all__
from numba import carray, types  # type: ignore[attr-defined]
from numba.core import cgutils
from numba.core.ccallback import CFunc
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.core.typing.context import BaseContext
from numba.core.typing.templates import Signature
from numba.extending import intrinsic, register_jitable

from ..common.code_cache import attach_cache, with_unique_name
from ..common.compiled import inline
from ..exceptions import LawError
from .base import ForceLaw

_NUMBER = types.float64
_POINTER = types.CPointer(types.float64)
_ARRAY = [_POINTER, types.int64]  # and its size
# Pointer to the first row, steps to the next row and to the next sample.
_ROWS = [_POINTER, types.int64, types.int64]

# s, v, a, t, u, z, theta, out
_KERNEL_SIGNATURE = types.void(*[_NUMBER] * 4, *_ARRAY * 4)
# z, s0, v0, s1, v1, dt, u, theta
_ADVANCE_SIGNATURE = types.void(*_ARRAY, *[_NUMBER] * 5, *_ARRAY * 2)
# state, s, v, h, number of intervals, u, theta, z
_WALK_SIGNATURE = types.void(*[_POINTER] * 4, types.int64, *_ROWS, *_ARRAY, *_ROWS)


def _caller(callback: Signature) -> Callable[..., None]:
    """How compiled code calls a callback: ``call(address, arguments)``."""

    def call(typing_context, address, arguments):
        def codegen(context, builder, signature, values):
            kinds = [context.get_value_type(kind) for kind in callback.args]
            function_type = ir.FunctionType(ir.VoidType(), kinds)
            function = builder.inttoptr(values[0], function_type.as_pointer())
            builder.call(function, cgutils.unpack_tuple(builder, values[1]))
            return context.get_dummy_value()

        return types.void(address, arguments), codegen

    return intrinsic(call)


call_kernel = _caller(_KERNEL_SIGNATURE)
call_advance = _caller(_ADVANCE_SIGNATURE)
call_walk = _caller(_WALK_SIGNATURE)


def _stack_array(
    typing_context: BaseContext, size: types.Type
) -> tuple[Signature, Callable] | None:
    """Array on the stack, of a size that is known when the code is compiled.

    Nothing else can write to it, so that a loop keeps it in registers: paths of Dahl's
    state take two thirds of the time.
    """
    if not isinstance(size, types.IntegerLiteral):
        return None
    kind = types.Array(types.float64, 1, "C")

    def codegen(context, builder, signature, arguments):
        count = context.get_constant(types.intp, max(size.literal_value, 1))
        memory = cgutils.alloca_once(
            builder, context.get_value_type(types.float64), size=count
        )
        bytes_per_number = context.get_constant(types.intp, 8)
        array = context.make_array(kind)(context, builder)
        context.populate_array(
            array,
            data=memory,
            shape=[context.get_constant(types.intp, size.literal_value)],
            strides=[bytes_per_number],
            itemsize=bytes_per_number,
            meminfo=None,
        )
        return array._getvalue()

    return kind(size), codegen


_on_stack: Callable = intrinsic(prefer_literal=True)(_stack_array)


def _functions_used(function: Callable) -> Iterator[FunctionType]:
    """Plain functions that a function refers to, by a global name or a closure."""
    values = [cell.cell_contents for cell in function.__closure__ or ()]
    for name in function.__code__.co_names:
        values.append(function.__globals__.get(name))
    for value in values:
        if isinstance(value, FunctionType):
            yield value


@cache
def _register_helpers(function: Callable) -> None:
    """Let compiled code call the plain functions that a law's function calls."""
    for helper in _functions_used(function):
        register_jitable(error_model="numpy")(helper)
        _register_helpers(helper)


def _compilable(function: Callable) -> Dispatcher:
    """A law's function for use inside a callback."""
    _register_helpers(function)
    return inline(function)


def _callback(function: Callable, signature: Signature) -> CFunc:
    callback = CFunc(
        with_unique_name(function),
        (signature.args, signature.return_type),
        {},
        {"nopython": True},
    )
    attach_cache(callback, function)
    callback.compile()
    return callback


@cache
def kernel_callback(kernel: Callable) -> CFunc:
    """A law's kernel for one sample."""
    law = _compilable(kernel)

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

    return _callback(kernel_callback, _KERNEL_SIGNATURE)


@cache
def advance_callback(advance: Callable) -> CFunc:
    """A law's update of its state over one step."""
    law = _compilable(advance)

    def advance_callback(z, n_z, s0, v0, s1, v1, dt, u, n_u, theta, n_theta):
        law(carray(z, n_z), s0, v0, s1, v1, dt, carray(u, n_u), carray(theta, n_theta))

    return _callback(advance_callback, _ADVANCE_SIGNATURE)


@cache
def walk_callback(advance: Callable, n_states: int, n_inputs: int) -> CFunc:
    """A law's updates of its state along samples between which the rate keeps its sign.

    It is called with the state and the number of intervals, with drifts, rates and
    durations of the intervals, and with the rows of the covariates. It writes the state
    at the end of each interval into the rows of z.
    """
    law = _compilable(advance)

    def walk_callback(
        state, s, v, h, n, u, next_u, step_u, theta, n_theta, z, next_z, step_z
    ):
        now = _on_stack(n_states)
        mean_u = _on_stack(n_inputs)
        shape = carray(theta, n_theta)
        for k in range(n_states):
            now[k] = state[k]

        for i in range(n):
            for k in range(n_inputs):
                first = k * next_u + i * step_u
                mean_u[k] = 0.5 * (u[first] + u[first + 1])
            law(now, s[i], v[i], s[i + 1], v[i + 1], h[i], mean_u, shape)
            for k in range(n_states):
                z[k * next_z + i * step_z] = now[k]

        for k in range(n_states):
            state[k] = now[k]

    return _callback(walk_callback, _WALK_SIGNATURE)


def callbacks_of(law: ForceLaw) -> tuple[CFunc, CFunc]:
    """Kernel and state update of a law, which live as long as the objects returned."""
    try:
        return kernel_callback(type(law).kernel), advance_callback(type(law).advance)
    except NumbaError as error:
        raise cannot_compile(law, error) from error


def compiled_kernel(law: ForceLaw) -> Callable[..., None]:
    """A law's compiled kernel for one sample, with the arguments of the plain one."""
    callback = callbacks_of(law)[0].ctypes

    def kernel(s: float, v: float, a: float, t: float, *arrays: np.ndarray) -> None:
        pointers_and_sizes: list[object] = []
        for array in arrays:
            pointers_and_sizes += [array.ctypes.data_as(POINTER(c_double)), array.size]
        callback(s, v, a, t, *pointers_and_sizes)

    return kernel


def cannot_compile(law: ForceLaw, error: Exception) -> LawError:
    """Error for a law that numba does not accept."""
    lines = str(error).strip().splitlines()
    reason = lines[-1] if lines else type(error).__name__
    return LawError(
        f"{type(law).__name__} cannot be compiled for single samples ({reason})",
        "Write kernel and advance with plain arithmetic, math and NumPy ufuncs only.",
    )
