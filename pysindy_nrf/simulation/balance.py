"""The force balance at one instant: site forces through callbacks, then accelerations. Compiled."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from ..laws.compiled import inline, part
from .system import (
    ADVANCE,
    FIRST,
    INERTIA,
    INPUT,
    KERNEL,
    LAST,
    LOWER,
    MEMORY,
    N_INPUTS,
    N_STATES,
    N_TERMS,
    N_THETA,
    ON_DOF,
    STATE,
    TERM,
    THETA,
    UPPER,
)  # fmt: skip

_DOUBLE, _INT = ir.DoubleType(), ir.IntType(64)


def _part(context, builder, array_type, array, start):
    """Address of array[start]."""
    view = cgutils.create_struct_proxy(array_type)(context, builder, value=array)
    return builder.gep(view.data, [start])


def _kernel_at(typing_context, address, s, v, a, t, u, n_u, z, z0, n_z, theta, theta0, n_theta, out, n_out):
    """Call a law's kernel by its address on parts of flat arrays."""

    def codegen(context, builder, signature, args):
        address, s, v, a, t, u, n_u, z, z0, n_z, theta, theta0, n_theta, out, n_out = args
        kinds = signature.args
        vector = [_DOUBLE.as_pointer(), _INT]
        function = ir.FunctionType(ir.VoidType(), [_DOUBLE] * 4 + vector * 4)
        zero = ir.Constant(_INT, 0)
        builder.call(
            builder.inttoptr(address, function.as_pointer()),
            [
                s, v, a, t,
                _part(context, builder, kinds[5], u, zero), n_u,
                _part(context, builder, kinds[7], z, z0), n_z,
                _part(context, builder, kinds[10], theta, theta0), n_theta,
                _part(context, builder, kinds[13], out, zero), n_out,
            ],
        )  # fmt: skip
        return context.get_dummy_value()

    whole, number, vector = types.int64, types.float64, types.float64[::1]
    return types.void(
        whole, number, number, number, number, vector, whole, vector, whole, whole, vector, whole, whole, vector, whole
    ), codegen


_call_kernel: Any = intrinsic(_kernel_at)


def _advance_at(typing_context, address, z, z0, n_z, s0, v0, s1, v1, dt, u, n_u, theta, theta0, n_theta):
    """Call a law's state update by its address on parts of flat arrays."""

    def codegen(context, builder, signature, args):
        address, z, z0, n_z, s0, v0, s1, v1, dt, u, n_u, theta, theta0, n_theta = args
        kinds = signature.args
        vector = [_DOUBLE.as_pointer(), _INT]
        function = ir.FunctionType(ir.VoidType(), vector + [_DOUBLE] * 5 + vector * 2)
        builder.call(
            builder.inttoptr(address, function.as_pointer()),
            [
                _part(context, builder, kinds[1], z, z0), n_z,
                s0, v0, s1, v1, dt,
                _part(context, builder, kinds[9], u, ir.Constant(_INT, 0)), n_u,
                _part(context, builder, kinds[11], theta, theta0), n_theta,
            ],
        )  # fmt: skip
        return context.get_dummy_value()

    whole, number, vector = types.int64, types.float64, types.float64[::1]
    return types.void(
        whole, vector, whole, whole, number, number, number, number, number, vector, whole, vector, whole, whole
    ), codegen


_call_advance: Any = intrinsic(_advance_at)


@part
def inputs_at(polynomials, interval, x, row):
    """Applied forces, base acceleration and covariates at the share x of a sample interval."""
    last = polynomials.shape[0] - 1
    for j in range(row.size):
        value = polynomials[last, interval, j]
        for d in range(last - 1, -1, -1):
            value = value * x + polynomials[d, interval, j]
        row[j] = value


@inline
def relative(y, site):
    """Motion of the upper end of a site relative to its lower end."""
    return y[site[UPPER]] - (y[site[LOWER]] if site[LOWER] >= 0 else 0.0)


@inline
def law_force(system, law, s, v, a, t, row, z, u, out):
    """Force of one law."""
    n_u, n_terms = law[N_INPUTS], law[N_TERMS]
    for k in range(n_u):
        u[k] = row[system.channels[law[INPUT] + k]]
    _call_kernel(
        law[KERNEL], s, v, a, system.t0 + t, u, n_u, z, law[STATE], law[N_STATES],
        system.theta, law[THETA], law[N_THETA], out, n_terms,
    )  # fmt: skip
    force = 0.0
    for k in range(n_terms):
        force += system.coefficients[law[TERM] + k] * out[k]
    return force


@part
def site_force(system, site, s, v, t, row, z, u, out):
    """Force of all laws of a site: the part without acceleration, and the factor of acceleration."""
    force, inertia = 0.0, 0.0
    for k in range(site[FIRST], site[LAST]):
        law = system.laws[k]
        now = law_force(system, law, s, v, 0.0, t, row, z, u, out)
        force += now
        if law[INERTIA]:
            inertia += law_force(system, law, s, v, 1.0, t, row, z, u, out) - now
    return force, inertia


@inline
def advance_site(system, site, s0, r0, s1, r1, z, dt, middle, u):
    """Move the states of the laws of one site along a path without reversal."""
    for k in range(site[FIRST], site[LAST]):
        law = system.laws[k]
        if law[N_STATES]:
            for j in range(law[N_INPUTS]):
                u[j] = middle[system.channels[law[INPUT] + j]]
            _call_advance(
                law[ADVANCE], z, law[STATE], law[N_STATES], s0, r0, s1, r1, dt, u, law[N_INPUTS],
                system.theta, law[THETA], law[N_THETA],
            )  # fmt: skip


@part
def advance_states(system, x0, v0, x1, v1, z, dt, middle, u):
    """Move the states of all laws from (x0, v0) to (x1, v1), during which no memory site reverses."""
    for i in range(system.sites.shape[0]):
        site = system.sites[i]
        if site[MEMORY]:
            advance_site(
                system, site, relative(x0, site), relative(v0, site), relative(x1, site), relative(v1, site),
                z, dt, middle, u,
            )  # fmt: skip


@part
def solve(matrix, vector, n):
    """Solve a small dense system of size n in place; the answer replaces the right-hand side."""
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            vector[k], vector[pivot] = vector[pivot], vector[k]
        for i in range(k + 1, n):
            if matrix[i, k] != 0.0:
                factor = matrix[i, k] / matrix[k, k]
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                vector[i] -= factor * vector[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            vector[k] -= matrix[k, j] * vector[j]
        vector[k] /= matrix[k, k]


FREE = 2  # regime of a site whose force has no jump at zero rate; +1, -1: slips that way; 0: sticks
_CREEP = 1e-300  # a rate that has a sign and nothing else


@part
def _mass_solve(system, w, vector):
    """Accelerations from forces, with the mass matrix of this instant."""
    n = vector.size
    if not system.link_inertia:
        for j in range(n):
            vector[j] /= w.mass[j]
        return
    for j in range(n):
        for k in range(n):
            w.matrix[j, k] = w.mass[j] if j == k else 0.0
    for i in range(system.sites.shape[0]):
        site, b = system.sites[i], w.inertia[i]
        if b != 0.0 and not site[ON_DOF]:
            p, q = site[UPPER], site[LOWER]
            w.matrix[p, p] += b
            if q >= 0:
                w.matrix[q, q] += b
                w.matrix[p, q] -= b
                w.matrix[q, p] -= b
    solve(w.matrix, vector, n)


@part
def _hold_stuck(system, w, n_stuck, a, force):
    """Forces within the jump of each sticking site so that it does not accelerate (Filippov 1988)."""
    n = a.size
    for k in range(n_stuck):
        site = system.sites[w.stuck[k]]
        for j in range(n):
            w.column[k, j] = 0.0
        w.column[k, site[UPPER]] = w.jump[w.stuck[k]]
        if site[LOWER] >= 0:
            w.column[k, site[LOWER]] = -w.jump[w.stuck[k]]
        _mass_solve(system, w, w.column[k])
    for m in range(n_stuck):
        site = system.sites[w.stuck[m]]
        for k in range(n_stuck):
            w.hold[m, k] = relative(w.column[k], site)
        if n_stuck > 1:
            w.hold[m, m] *= 1.0 + 1e-12  # loops of sticking links share their load
        w.load[m] = relative(a, site)
    solve(w.hold, w.load, n_stuck)
    for k in range(n_stuck):
        i = w.stuck[k]
        w.share[i] = w.load[k]
        force[i] += w.load[k] * w.jump[i]
        for j in range(n):
            a[j] -= w.load[k] * w.column[k, j]


@part
def accelerate(system, regime, t, row, x, v, z, a, force, w):
    """Relative accelerations of the DOFs and forces of the sites at one instant."""
    n = a.size
    base = row[n]
    n_stuck = 0
    for j in range(n):
        a[j] = row[j] - system.masses[j] * base
        w.mass[j] = system.masses[j]
    for i in range(system.sites.shape[0]):
        site = system.sites[i]
        s, rate = relative(x, site), relative(v, site)
        if regime[i] == 0:
            upper, _ = site_force(system, site, s, _CREEP, t, row, z, w.u, w.out)
            lower, inertia = site_force(system, site, s, -_CREEP, t, row, z, w.u, w.out)
            force[i] = 0.5 * (upper + lower)
            w.jump[i] = 0.5 * (upper - lower)
            w.share[i] = 0.0
            if w.jump[i] > 0.0:
                w.stuck[n_stuck] = i
                n_stuck += 1
        else:
            if regime[i] != FREE and rate * regime[i] < _CREEP:
                rate = regime[i] * _CREEP
            force[i], inertia = site_force(system, site, s, rate, t, row, z, w.u, w.out)
        p, q = site[UPPER], site[LOWER]
        a[p] -= force[i]
        if q >= 0:
            a[q] += force[i]
        w.inertia[i] = inertia
        if site[ON_DOF] and inertia != 0.0:
            w.mass[p] += inertia
            a[p] -= inertia * base
    _mass_solve(system, w, a)
    if n_stuck:
        _hold_stuck(system, w, n_stuck, a, force)
    for i in range(system.sites.shape[0]):
        if w.inertia[i] != 0.0:
            site = system.sites[i]
            force[i] += w.inertia[i] * (relative(a, site) + (base if site[ON_DOF] else 0.0))
