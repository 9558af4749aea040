"""Compiled integration of a law's internal state along a sampled motion, with exact velocity reversals."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba.core.errors import NumbaError

from ..exceptions import ChannelError, LawError
from .compiled import borrow, cannot_compile, inline, jit, on_stack, part, read_only
from .shape import Motion

_STRETCH = 2048  # intervals whose reversals are found before the state is moved
_LOOK = 64  # intervals that are checked together: most contain no reversal


@inline
def _slope(x, c):
    return c[0] + x * (2.0 * c[1] + x * (3.0 * c[2] + x * (4.0 * c[3] + x * 5.0 * c[4])))


@inline
def _curvature(x, c):
    return 2.0 * c[1] + x * (6.0 * c[2] + x * (12.0 * c[3] + x * 20.0 * c[4]))


@inline
def _rise(x, c):
    return x * (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4]))))


@inline
def _cubic(rise, h, v0, v1):
    """Hermite polynomial c_1 x + ... + c_5 x^5 of the drift's rise, x = 0..1, from the rates."""
    p, q = rise - h * v0, h * (v1 - v0)
    return h * v0, 3.0 * p - q, q - 2.0 * p, 0.0, 0.0


@inline
def _quintic(rise, h, v0, a0, v1, a1):
    """The same from rates and accelerations."""
    p = rise - h * v0 - 0.5 * h * h * a0
    q = h * (v1 - v0 - h * a0)
    r = h * h * (a1 - a0)
    return h * v0, 0.5 * h * h * a0, 10.0 * p - 4.0 * q + 0.5 * r, 7.0 * q - 15.0 * p - r, 6.0 * p - 3.0 * q + 0.5 * r


@inline
def _third(x, c):
    return 6.0 * c[2] + x * (24.0 * c[3] + x * 60.0 * c[4])


def _root_of(f, df):
    @inline
    def root(low, high, c):
        """Zero of f between low and high, where f changes sign, by Newton's method safeguarded by bisection."""
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
    """True if a peak of the drift lies beyond both ends and within reach of their rates."""
    way = peak if v0 > 0.0 else -peak
    back = peak - rise if v0 > 0.0 else rise - peak
    return 0.0 <= way <= h * abs(v0) and 0.0 <= back <= h * abs(v1)


@part
def _reversals(s0, s1, v0, v1, h, a0, a1, has_a):
    """Velocity reversals inside an interval: number, shares of the time, rises of the drift since its start."""
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
    else:  # the accelerations show a rate that dips and recovers: it may cross zero twice
        c = _quintic(rise, h, v0, a0, v1, a1)
        x = _slowest_point(0.0, 1.0, c)
        if _slope(x, c) * v0 < 0.0:
            x0, x1 = _reversal_point(0.0, x, c), _reversal_point(x, 1.0, c)
            if 0.0 <= x0 <= x1 <= 1.0:  # fails if rounding hides the change of sign
                return 2, x0, _rise(x0, c), x1, _rise(x1, c)
    return 0, 1.0, 0.0, 1.0, 0.0


@inline
def _doubt_sign(v0, v1, out):
    """Mark the intervals in which the rate changes sign and return 1 if there are any."""
    some = np.uint8(0)
    for i in range(v0.size):
        out[i] = v0[i] * v1[i] < 0.0
        some |= out[i]
    return some


@inline
def _doubt_both(v0, v1, a0, a1, out):
    """Mark the intervals in which the rate changes sign, or falls and recovers; return 1 if there are any."""
    some = np.uint8(0)
    for i in range(v0.size):
        out[i] = (v0[i] * v1[i] < 0.0) | ((v0[i] * a0[i] < 0.0) & (v0[i] * a1[i] > 0.0))
        some |= out[i]
    return some


def _find_reversals(s, v, a, t, low, high, doubtful, at, shares, drifts):
    """Write interval, share of its time and drift of each reversal between samples low..high; return their number."""
    if t.size == 0:
        return 0
    has_a = a.size > 0
    count, a0, a1 = 0, 0.0, 0.0
    for begin in range(low, high - 1, doubtful.size):
        end = min(begin + doubtful.size, high - 1)
        v0, v1 = v[begin:end], v[begin + 1 : end + 1]
        if has_a:
            some = _doubt_both(v0, v1, a[begin:end], a[begin + 1 : end + 1], doubtful)
        else:
            some = _doubt_sign(v0, v1, doubtful)
        if not some:
            continue
        for i in range(begin + 1, end + 1):
            if doubtful[i - begin - 1]:
                if has_a:
                    a0, a1 = a[i - 1], a[i]
                n, x0, rise0, x1, rise1 = _reversals(s[i - 1], s[i], v[i - 1], v[i], t[i] - t[i - 1], a0, a1, has_a)
                for k in range(n):
                    at[count] = i
                    shares[count] = x1 - x0 if k else x0
                    drifts[count] = s[i - 1] + (rise1 if k else rise0)
                    count += 1
    return count


@cache
def _path(advance: Callable, n_states: int) -> Callable[..., None]:
    """Compiled path of one law's state; one machine-code file for each law."""
    step = inline(advance)
    find = part(_find_reversals)

    def between(s, v, t, u, middle, state, theta, z, begin, end):
        """Move the state over samples begin..end, which contain no reversal; it stays in registers."""
        has_t = t.size > 0
        now, h = on_stack(n_states), np.nan
        for k in range(n_states):
            now[k] = state[k]
        for i in range(begin, end):
            for k in range(middle.size):
                middle[k] = 0.5 * (u[k, i - 1] + u[k, i])
            if has_t:
                h = t[i] - t[i - 1]
            step(now, s[i - 1], v[i - 1], s[i], v[i], h, middle, theta)
            for k in range(n_states):
                z[k, i] = now[k]
        for k in range(n_states):
            state[k] = now[k]

    def across(s, v, t, u, middle, state, theta, z, i, shares, drifts):
        """Move the state to sample i through the reversals at ``drifts``."""
        for k in range(middle.size):
            middle[k] = 0.5 * (u[k, i - 1] + u[k, i])
        h = t[i] - t[i - 1]
        s0, v0, left = s[i - 1], v[i - 1], h
        for w in range(drifts.size):
            step(state, s0, v0, drifts[w], 0.0, shares[w] * h, middle, theta)
            s0, v0, left = drifts[w], 0.0, left - shares[w] * h
        step(state, s0, v0, s[i], v[i], left, middle, theta)
        for k in range(n_states):
            z[k, i] = state[k]

    between, across = part(between), part(across)

    def one_path(s, v, t, u, middle, state, theta, z, low, high, at, shares, drifts, count):
        """Move the state from sample ``low`` to ``high``."""
        s, v, t, u, middle = borrow(s), borrow(v), borrow(t), borrow(u), borrow(middle)
        state, theta, z = borrow(state), borrow(theta), borrow(z)
        w, begin = 0, low + 1
        while w < count:
            first, i = w, at[w]
            while w < count and at[w] == i:
                w += 1
            between(s, v, t, u, middle, state, theta, z, begin, i)
            across(s, v, t, u, middle, state, theta, z, i, borrow(shares)[first:w], borrow(drifts)[first:w])
            begin = i + 1
        between(s, v, t, u, middle, state, theta, z, begin, high)

    path = part(one_path)

    def memory_path(s, v, a, t, u, theta, state, z):
        doubtful, at = np.empty(_LOOK, dtype=np.uint8), np.empty(2 * _STRETCH, dtype=np.int64)
        shares, drifts = np.empty(2 * _STRETCH), np.empty(2 * _STRETCH)
        middle = np.empty(u.shape[0])
        for k in range(n_states):
            z[k, 0] = state[k]
        for low in range(0, s.size - 1, _STRETCH):
            high = min(low + _STRETCH + 1, s.size)
            count = find(s, v, a, t, low, high, doubtful, at, shares, drifts)
            path(s, v, t, u, middle, state, theta, z, low, high, at, shares, drifts, count)

    return jit(memory_path)


def state_path(
    law: Any, motion: Motion, u: np.ndarray, theta: np.ndarray, state: np.ndarray | None = None
) -> np.ndarray:
    """Internal state of a law along one contiguous record, (n_states, n_samples); ``state`` is moved to its end."""
    none = np.empty(0)
    state = np.zeros(law.n_states) if state is None else state
    s, v, a, t = (read_only(none if x is None else x) for x in (motion.s, motion.v, motion.a, motion.t))
    z = np.empty((law.n_states, len(s)))
    if not np.isfinite(s.sum() + v.sum()):
        raise ChannelError("The motion of a law with memory is not finite", "Remove NaN rows at both ends first.")
    if len(s):
        try:
            _path(type(law).advance, law.n_states)(s, v, a, t, read_only(u), read_only(theta), state, z)
        except NumbaError as error:
            raise cannot_compile(law, error) from error
    if not np.isfinite(state).all():
        if motion.t is None:
            raise LawError(f"{type(law).__name__} needs the time of the samples", "Pass time= or dt=.")
        cure = f"Change its shape parameters ({', '.join(f'{k} = {x}' for k, x in law.shape.items())})."
        raise LawError(f"The state of {type(law).__name__} diverges on this motion", cure)
    return z
