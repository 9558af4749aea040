"""Internal state of a law along a sampled motion, with velocity reversals located.

Between two samples the drift is the polynomial through the measured drift, rate and
acceleration. A law moves its state exactly along a path without reversal, so the path
is cut where the rate of that polynomial is zero.
"""

from collections import namedtuple

import numpy as np
from numba.core.errors import NumbaError

from ..common.compiled import address_of, addresses, inline, jit, read_only, subroutine
from ..exceptions import ChannelError, LawError
from .base import ForceLaw
from .callbacks import call_walk, cannot_compile, walk_callback
from .shape import Motion

# Intervals whose reversals are found before the state is moved through them: their
# arrays stay in the first cache.
INTERVALS_PER_BLOCK = 2048
# Intervals that are checked together: most contain no reversal.
INTERVALS_PER_CHECK = 64
REVERSALS_PER_INTERVAL = 2
# A share of the interval; Newton's method gains ten digits in five steps.
ROOT_TOLERANCE = 1e-10
MAX_ROOT_STEPS = 60

_NONE = np.empty(0)  # a channel that is missing

# One record: address of the law's walk, the motion, covariates, shape parameters, the
# state, which is moved, and its path.
_Record = namedtuple("_Record", "walk s v a t u theta state z n_samples n_theta")
# One block of intervals: their durations and whether one may contain a reversal; of
# each reversal the interval (by the sample at its end), the time since the sample or
# reversal before it as a share of the interval, and the drift; drifts, rates and
# durations at the ends of the parts of one interval, behind each other.
_Block = namedtuple("_Block", "duration suspect interval share drift parts")
_ENDS_OF_PARTS = REVERSALS_PER_INTERVAL + 2
_REVERSALS_PER_BLOCK = REVERSALS_PER_INTERVAL * INTERVALS_PER_BLOCK
_SCRATCH_SIZE = INTERVALS_PER_BLOCK + 2 * _REVERSALS_PER_BLOCK + 3 * _ENDS_OF_PARTS
_MARKS_SIZE = INTERVALS_PER_CHECK + _REVERSALS_PER_BLOCK


# -- the drift within one interval, x = 0..1 -----------------------------------


@inline
def _rise(x, c):
    return x * (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4]))))


@inline
def _slope(x, c):
    return c[0] + x * (
        2.0 * c[1] + x * (3.0 * c[2] + x * (4.0 * c[3] + x * 5.0 * c[4]))
    )


@inline
def _curvature(x, c):
    return 2.0 * c[1] + x * (6.0 * c[2] + x * (12.0 * c[3] + x * 20.0 * c[4]))


@inline
def _change_of_curvature(x, c):
    return 6.0 * c[2] + x * (24.0 * c[3] + x * 60.0 * c[4])


@inline
def _cubic(rise, h, v0, v1):
    """Coefficients c_1 .. c_5 of the drift's rise from the rates at both ends."""
    p = rise - h * v0
    q = h * (v1 - v0)
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


def _root_finder(f, df):
    """Compiled search for a zero of f, whose derivative is df."""

    @inline
    def root(low, high, c):
        """Zero between low and high, where f changes sign: Newton, or bisection."""
        f_low = f(low, c)
        f_high = f(high, c)
        x = (low * f_high - high * f_low) / (f_high - f_low)

        for _ in range(MAX_ROOT_STEPS):
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
            if move < ROOT_TOLERANCE:
                break
        return x

    return root


_reversal_point = _root_finder(_slope, _curvature)
_extremum_of_rate = _root_finder(_curvature, _change_of_curvature)


# -- reversals -----------------------------------------------------------------


@inline
def _is_plausible(peak, rise, h, v0, v1):
    """Whether a peak lies beyond both ends and within reach of their rates."""
    from_start = peak if v0 > 0.0 else -peak
    to_end = peak - rise if v0 > 0.0 else rise - peak
    return 0.0 <= from_start <= h * abs(v0) and 0.0 <= to_end <= h * abs(v1)


@subroutine
def _reversals(s0, s1, v0, v1, h, a0, a1, has_a):
    """Reversals in an interval: their number; shares of time and rises of the drift."""
    rise = s1 - s0
    if v0 * v1 < 0.0:
        if has_a:
            c = _quintic(rise, h, v0, a0, v1, a1)
            x = _reversal_point(0.0, 1.0, c)
            if _is_plausible(_rise(x, c), rise, h, v0, v1):
                return 1, x, _rise(x, c), 1.0, 0.0

        # without accelerations, or with some that contradict the rates
        c = _cubic(rise, h, v0, v1)
        x = _reversal_point(0.0, 1.0, c)
        if _is_plausible(_rise(x, c), rise, h, v0, v1):
            return 1, x, _rise(x, c), 1.0, 0.0
    else:
        # the accelerations show a rate that dips and recovers: it may cross zero twice
        c = _quintic(rise, h, v0, a0, v1, a1)
        x = _extremum_of_rate(0.0, 1.0, c)
        if _slope(x, c) * v0 < 0.0:
            x0 = _reversal_point(0.0, x, c)
            x1 = _reversal_point(x, 1.0, c)
            if 0.0 <= x0 <= x1 <= 1.0:  # fails if rounding hides the change of sign
                return 2, x0, _rise(x0, c), x1, _rise(x1, c)

    return 0, 1.0, 0.0, 1.0, 0.0


# The two functions below have no branch inside their loop, so that it is vectorised.


@inline
def _mark_sign_changes(v0, v1, n, suspect):
    """Mark the intervals in which the rate changes sign; 1 if there are any."""
    marked = np.int64(0)
    for i in range(n):
        suspect[i] = v0[i] * v1[i] < 0.0
        marked |= suspect[i]
    return marked


@inline
def _mark_sign_changes_and_dips(v0, v1, a0, a1, n, suspect):
    """Mark also those in which the rate falls and recovers; 1 if there are any."""
    marked = np.int64(0)
    for i in range(n):
        dips = (v0[i] * a0[i] < 0.0) & (v0[i] * a1[i] > 0.0)
        suspect[i] = (v0[i] * v1[i] < 0.0) | dips
        marked |= suspect[i]
    return marked


@subroutine
def _find_reversals(record, block, first, last, has_a):
    """Write the reversals between two samples into the block; returns their number."""
    s, v = record.s, record.v
    a, t = record.a, record.t
    count = 0
    a0 = 0.0
    a1 = 0.0

    for begin in range(first, last, INTERVALS_PER_CHECK):
        n = min(INTERVALS_PER_CHECK, last - begin)
        v_start = address_of(v, begin)
        v_end = address_of(v, begin + 1)
        if has_a:
            a_start = address_of(a, begin)
            a_end = address_of(a, begin + 1)
            marked = _mark_sign_changes_and_dips(
                v_start, v_end, a_start, a_end, n, block.suspect
            )
        else:
            marked = _mark_sign_changes(v_start, v_end, n, block.suspect)
        if not marked:
            continue

        for i in range(begin + 1, begin + n + 1):
            if not block.suspect[i - begin - 1]:
                continue
            if has_a:
                a0 = a[i - 1]
                a1 = a[i]
            n_reversals, x0, rise0, x1, rise1 = _reversals(
                s[i - 1], s[i], v[i - 1], v[i], t[i] - t[i - 1], a0, a1, has_a
            )
            for k in range(n_reversals):
                block.interval[count] = i
                block.share[count] = x1 - x0 if k else x0
                block.drift[count] = s[i - 1] + (rise1 if k else rise0)
                count += 1

    return count


# -- the path ------------------------------------------------------------------


@inline
def _walk(record, block, first, start, end):
    """Move the state from sample to sample through intervals without a reversal."""
    n = record.n_samples
    motion = (
        address_of(record.s, start),
        address_of(record.v, start),
        address_of(block.duration, start - first),
        end - start,
    )
    covariates = address_of(record.u, start), n, 1
    path = address_of(record.z, start + 1), n, 1
    shape = record.theta, record.n_theta
    call_walk(record.walk, (record.state, *motion, *covariates, *shape, *path))


@inline
def _walk_through_reversals(record, block, first, number, count):
    """Move the state through the interval of a reversal, in parts without one.

    Returns the number of the first reversal behind the interval. All parts read the
    same covariates and write the same sample of the path: the steps there are 0.
    """
    drift = block.parts
    rate = address_of(drift, _ENDS_OF_PARTS)
    duration = address_of(rate, _ENDS_OF_PARTS)
    i = block.interval[number]
    whole_duration = block.duration[i - 1 - first]

    drift[0] = record.s[i - 1]
    rate[0] = record.v[i - 1]
    reversals = 0
    remaining = whole_duration
    while number < count and block.interval[number] == i:
        duration[reversals] = block.share[number] * whole_duration
        remaining -= duration[reversals]
        reversals += 1
        drift[reversals] = block.drift[number]
        rate[reversals] = 0.0
        number += 1
    duration[reversals] = remaining
    drift[reversals + 1] = record.s[i]
    rate[reversals + 1] = record.v[i]

    n = record.n_samples
    motion = drift, rate, duration, reversals + 1
    covariates = address_of(record.u, i - 1), n, 0
    path = address_of(record.z, i), n, 0
    shape = record.theta, record.n_theta
    call_walk(record.walk, (record.state, *motion, *covariates, *shape, *path))
    return number


@inline
def _block_in(scratch, marks):
    """The arrays of a block, one behind the other in two pieces of memory."""
    share = address_of(scratch, INTERVALS_PER_BLOCK)
    drift = address_of(share, _REVERSALS_PER_BLOCK)
    parts = address_of(drift, _REVERSALS_PER_BLOCK)
    interval = address_of(marks, INTERVALS_PER_CHECK)
    return _Block(scratch, marks, interval, share, drift, parts)


@jit
def memory_path(walk, s, v, a, t, u, theta, state, z, scratch, marks):
    """Path of the state of any law through one record.

    Arrays come one by one: named tuples of them would take 2 microseconds a call, the
    time of 200 samples.
    """
    n_states = state.size
    n_samples = s.size
    has_t = t.size > 0
    has_a = a.size > 0
    record = addresses(
        _Record(walk, s, v, a, t, u, theta, state, z, n_samples, theta.size)
    )
    block = _block_in(*addresses((scratch, marks)))

    for k in range(n_states):
        record.z[k * n_samples] = record.state[k]

    for first in range(0, n_samples - 1, INTERVALS_PER_BLOCK):
        last = min(first + INTERVALS_PER_BLOCK, n_samples - 1)
        for i in range(first, last):
            block.duration[i - first] = (
                record.t[i + 1] - record.t[i] if has_t else np.nan
            )

        count = 0
        if has_t:
            count = _find_reversals(record, block, first, last, has_a)

        number = 0
        sample = first
        while number < count:
            i = block.interval[number]
            _walk(record, block, first, sample, i - 1)
            number = _walk_through_reversals(record, block, first, number, count)
            sample = i
        _walk(record, block, first, sample, last)


def state_path(
    law: ForceLaw,
    motion: Motion,
    u: np.ndarray,
    theta: np.ndarray,
    state: np.ndarray | None = None,
) -> np.ndarray:
    """Internal state of a law along a motion.

    Parameters
    ----------
    law : ForceLaw
    motion : Motion
        Records after the first one start from a fresh state.
    u : ndarray of shape (n_covariates, n_samples)
    theta : ndarray of shape (n_theta,)
        Shape parameters.
    state : ndarray of shape (n_states,), optional
        State at the first sample, moved in place to the end of the first record; zero
        if None.

    Returns
    -------
    ndarray of shape (n_states, n_samples)

    Raises
    ------
    ChannelError
        If the motion is not finite.
    LawError
        If the law cannot be compiled, or its state is not finite at the end.
    """
    ends = [*motion.starts, motion.n_samples]
    if motion.n_samples == 0:
        return np.empty((law.n_states, 0))
    if not np.isfinite(np.sum(motion.s) + np.sum(motion.v)):
        raise ChannelError(
            "The motion of a law with memory is not finite",
            "Remove NaN rows at both ends first.",
        )

    paths = []
    for first, end in zip([0, *motion.starts], ends):
        if first > 0 or state is None:
            state = np.zeros(law.n_states)
        try:
            path = _path_of_record(law, motion, slice(first, end), u, theta, state)
        except NumbaError as error:
            raise cannot_compile(law, error) from error
        if not np.isfinite(path[:, -1:]).all():
            raise _divergence(law, motion)
        paths.append(path)
    return np.hstack(paths) if len(paths) > 1 else paths[0]


def _path_of_record(
    law: ForceLaw,
    motion: Motion,
    rows: slice,
    u: np.ndarray,
    theta: np.ndarray,
    state: np.ndarray,
) -> np.ndarray:
    """Path of the state through the rows of one record; moves the state."""
    walk = walk_callback(type(law).advance, law.n_states, len(u))
    path = np.empty((law.n_states, rows.stop - rows.start))
    memory_path(
        walk.address,
        read_only(motion.s[rows]),
        read_only(motion.v[rows]),
        read_only(_NONE if motion.a is None else motion.a[rows]),
        read_only(_NONE if motion.t is None else motion.t[rows]),
        read_only(u[:, rows]),
        read_only(theta),
        state,
        path,
        np.empty(_SCRATCH_SIZE),
        np.empty(_MARKS_SIZE, np.int64),
    )
    return path


def _divergence(law: ForceLaw, motion: Motion) -> LawError:
    """Why a state is not finite: without times a step has no duration."""
    name = type(law).__name__
    if motion.t is None:
        return LawError(f"{name} needs the time of the samples", "Pass time= or dt=.")

    values = ", ".join(f"{key} = {value}" for key, value in law.shape.items())
    return LawError(
        f"The state of {name} diverges on this motion",
        f"Change its shape parameters ({values}).",
    )
