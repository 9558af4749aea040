"""Compiled integration of a law's internal state along a sampled motion, with exact
velocity reversals.
"""

from typing import Any

import numpy as np
from numba.core.errors import NumbaError

from ..common.compiled import (
    address_of,
    addresses,
    call_walk,
    cannot_compile,
    inline,
    jit,
    part,
    read_only,
    walk_pointer,
)
from ..exceptions import ChannelError, LawError
from .shape import Motion

_STRETCH = 2048  # intervals whose reversals are found before the state is moved
_LOOK = 64  # intervals that are checked together: most contain no reversal


@inline
def _slope(x, c):
    return c[0] + x * (
        2.0 * c[1] + x * (3.0 * c[2] + x * (4.0 * c[3] + x * 5.0 * c[4]))
    )


@inline
def _curvature(x, c):
    return 2.0 * c[1] + x * (6.0 * c[2] + x * (12.0 * c[3] + x * 20.0 * c[4]))


@inline
def _rise(x, c):
    return x * (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4]))))


@inline
def _cubic(rise, h, v0, v1):
    """Hermite polynomial c_1 x + ... + c_5 x^5 of the drift's rise, x = 0..1, from the
    rates.
    """
    p, q = rise - h * v0, h * (v1 - v0)
    return h * v0, 3.0 * p - q, q - 2.0 * p, 0.0, 0.0


@inline
def _quintic(rise, h, v0, a0, v1, a1):
    """The same from rates and accelerations."""
    p = rise - h * v0 - 0.5 * h * h * a0
    q = h * (v1 - v0 - h * a0)
    r = h * h * (a1 - a0)
    return (
        h * v0,
        0.5 * h * h * a0,
        10.0 * p - 4.0 * q + 0.5 * r,
        7.0 * q - 15.0 * p - r,
        6.0 * p - 3.0 * q + 0.5 * r,
    )


@inline
def _third(x, c):
    return 6.0 * c[2] + x * (24.0 * c[3] + x * 60.0 * c[4])


def _root_of(f, df):
    @inline
    def root(low, high, c):
        """Zero of f between low and high, where f changes sign, by Newton's method
        safeguarded by bisection.
        """
        f_low, f_high = f(low, c), f(high, c)
        x = (low * f_high - high * f_low) / (f_high - f_low)
        for _ in range(60):
            value = f(x, c)
            if (value > 0.0) == (f_high > 0.0):
                high = x
            else:
                low = x
            new = x - value / df(x, c)
            if not low <= new <= high:
                new = 0.5 * (low + high)
            move = abs(new - x)
            x = new
            if move < 1e-10:
                break
        return x

    return root


_reversal_point = _root_of(_slope, _curvature)
_slowest_point = _root_of(_curvature, _third)


@inline
def _plausible(peak, rise, h, v0, v1):
    """True if a peak of the drift lies beyond both ends and within reach of their
    rates.
    """
    way = peak if v0 > 0.0 else -peak
    back = peak - rise if v0 > 0.0 else rise - peak
    return 0.0 <= way <= h * abs(v0) and 0.0 <= back <= h * abs(v1)


@part
def _reversals(s0, s1, v0, v1, h, a0, a1, has_a):
    """Velocity reversals inside an interval: number, shares of the time, rises of the
    drift since its start.
    """
    rise = s1 - s0
    if v0 * v1 < 0.0:
        if has_a:
            c = _quintic(rise, h, v0, a0, v1, a1)
            x = _reversal_point(0.0, 1.0, c)
            if _plausible(_rise(x, c), rise, h, v0, v1):
                return 1, x, _rise(x, c), 1.0, 0.0
        c = _cubic(rise, h, v0, v1)
        x = _reversal_point(0.0, 1.0, c)
        if _plausible(_rise(x, c), rise, h, v0, v1):
            return 1, x, _rise(x, c), 1.0, 0.0
    # the accelerations show a rate that dips and recovers: it may cross zero twice
    else:
        c = _quintic(rise, h, v0, a0, v1, a1)
        x = _slowest_point(0.0, 1.0, c)
        if _slope(x, c) * v0 < 0.0:
            x0, x1 = _reversal_point(0.0, x, c), _reversal_point(x, 1.0, c)
            if 0.0 <= x0 <= x1 <= 1.0:  # fails if rounding hides the change of sign
                return 2, x0, _rise(x0, c), x1, _rise(x1, c)
    return 0, 1.0, 0.0, 1.0, 0.0


@inline
def _doubt_sign(v0, v1, n, out):
    """Mark the intervals in which the rate changes sign and return 1 if there are
    any.
    """
    some = np.int64(0)
    for i in range(n):
        out[i] = v0[i] * v1[i] < 0.0
        some |= out[i]
    return some


@inline
def _doubt_both(v0, v1, a0, a1, n, out):
    """Mark the intervals in which the rate changes sign, or falls and recovers; return
    1 if there are any.
    """
    some = np.int64(0)
    for i in range(n):
        out[i] = (v0[i] * v1[i] < 0.0) | ((v0[i] * a0[i] < 0.0) & (v0[i] * a1[i] > 0.0))
        some |= out[i]
    return some


@part
def _find_reversals(s, v, a, t, has_a, low, high, doubtful, at, shares, drifts):
    """Write interval, share of its time and drift of each reversal between samples
    low..high; return their number.
    """
    count, a0, a1 = 0, 0.0, 0.0
    for begin in range(low, high - 1, _LOOK):
        n = min(_LOOK, high - 1 - begin)
        v0, v1 = address_of(v, begin), address_of(v, begin + 1)
        if has_a:
            some = _doubt_both(
                v0, v1, address_of(a, begin), address_of(a, begin + 1), n, doubtful
            )
        else:
            some = _doubt_sign(v0, v1, n, doubtful)
        if not some:
            continue
        for i in range(begin + 1, begin + n + 1):
            if doubtful[i - begin - 1]:
                if has_a:
                    a0, a1 = a[i - 1], a[i]
                h = t[i] - t[i - 1]
                n_here, x0, rise0, x1, rise1 = _reversals(
                    s[i - 1], s[i], v[i - 1], v[i], h, a0, a1, has_a
                )
                for k in range(n_here):
                    at[count] = i
                    shares[count] = x1 - x0 if k else x0
                    drifts[count] = s[i - 1] + (rise1 if k else rise0)
                    count += 1
    return count


@jit
def memory_path(walk, s, v, a, t, u, theta, state, z, h, at):
    """Compiled path of the state of any law, whose ``walk`` is called once for each way
    without reversal.
    """
    size, n_samples, n_theta, has_t, has_a = (
        state.size,
        s.size,
        theta.size,
        t.size > 0,
        a.size > 0,
    )
    s, v, a, t, u, theta, state, z, h, at = addresses(
        (s, v, a, t, u, theta, state, z, h, at)
    )
    shares, drifts, doubtful = (
        address_of(h, _STRETCH),
        address_of(h, 3 * _STRETCH),
        address_of(at, 2 * _STRETCH),
    )
    ends = address_of(
        drifts, 2 * _STRETCH
    )  # drifts of an interval with at most two reversals; rates; durations
    rates, steps = address_of(ends, 4), address_of(ends, 8)
    for k in range(size):
        z[k * n_samples] = state[k]
    for low in range(0, n_samples - 1, _STRETCH):
        high = min(low + _STRETCH + 1, n_samples)
        for i in range(low + 1, high):
            h[i - low - 1] = t[i] - t[i - 1] if has_t else np.nan
        count = (
            _find_reversals(s, v, a, t, has_a, low, high, doubtful, at, shares, drifts)
            if has_t
            else 0
        )
        w, last = 0, low  # the state is there
        while True:
            i = at[w] if w < count else high
            rows = (
                address_of(s, last),
                address_of(v, last),
                address_of(h, last - low),
                i - 1 - last,
            )
            more = (
                address_of(u, last),
                n_samples,
                1,
                theta,
                n_theta,
                address_of(z, last + 1),
                n_samples,
                1,
            )
            call_walk(walk, (state, *rows, *more))
            if w == count:
                break
            n, left = 0, h[i - 1 - low]
            ends[0], rates[0] = s[i - 1], v[i - 1]
            while w < count and at[w] == i:
                steps[n] = shares[w] * h[i - 1 - low]
                left -= steps[n]
                n += 1
                ends[n], rates[n] = drifts[w], 0.0
                w += 1
            ends[n + 1], rates[n + 1], steps[n] = s[i], v[i], left
            more = (
                address_of(u, i - 1),
                n_samples,
                0,
                theta,
                n_theta,
                address_of(z, i),
                n_samples,
                0,
            )
            call_walk(walk, (state, ends, rates, steps, n + 1, *more))
            last = i


def state_path(
    law: Any,
    motion: Motion,
    u: np.ndarray,
    theta: np.ndarray,
    state: np.ndarray | None = None,
) -> np.ndarray:
    """Internal state of a law along a motion, (n_states, n_samples); ``state`` is moved
    to the end of its record.
    """
    none = np.empty(0)
    s, v, a, t = (
        read_only(none if x is None else x)
        for x in (motion.s, motion.v, motion.a, motion.t)
    )
    if not np.isfinite(s.sum() + v.sum()):
        raise ChannelError(
            "The motion of a law with memory is not finite",
            "Remove NaN rows at both ends first.",
        )
    try:
        walk = walk_pointer(type(law).advance, law.n_states, len(u))
        h, at = (
            np.empty(5 * _STRETCH + 12),
            np.empty(2 * _STRETCH + _LOOK, dtype=np.int64),
        )
        paths, shape, marks = (
            [np.empty((law.n_states, 0))],
            read_only(theta),
            [*motion.starts, len(s)],
        )
        for low, high in zip([0, *motion.starts], marks if len(s) else []):
            state = np.zeros(law.n_states) if low or state is None else state
            z, part = np.empty((law.n_states, high - low)), slice(low, high)
            memory_path(
                walk.address,
                s[part],
                v[part],
                a[part],
                t[part],
                read_only(u[:, part]),
                shape,
                state,
                z,
                h,
                at,
            )
            paths.append(z)
    except NumbaError as error:
        raise cannot_compile(law, error) from error
    if not all(np.isfinite(z[:, -1:]).all() for z in paths):
        if motion.t is None:
            raise LawError(
                f"{type(law).__name__} needs the time of the samples",
                "Pass time= or dt=.",
            )
        cure = (
            "Change its shape parameters"
            f" ({', '.join(f'{k} = {x}' for k, x in law.shape.items())})."
        )
        raise LawError(
            f"The state of {type(law).__name__} diverges on this motion", cure
        )
    return np.hstack(paths) if motion.starts else paths[-1]
