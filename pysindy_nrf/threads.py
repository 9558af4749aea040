"""Independent shares of one pass on all cores: compiled code runs without the interpreter's lock."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from itertools import chain, islice
from typing import TypeVar

Share = TypeVar("Share")
Result = TypeVar("Result")

_AHEAD = 2  # shares for each thread that wait or are done: memory stays flat in their number


@cache
def _cores() -> int:
    from joblib import cpu_count

    return int(cpu_count())  # of this process: affinity and the limits of a container count


def n_threads() -> int:
    """Threads of a pass: the cores of this process, or what OMP_NUM_THREADS or NUMBA_NUM_THREADS allow.

    These are the variables that joblib and Dask set in their workers, so that fits side by side do not fight for cores.

    Returns
    -------
    int
        At least 1.

    Examples
    --------
    >>> from pysindy_nrf.threads import n_threads
    >>> n_threads() >= 1
    True
    """
    asked = [os.environ.get(name, "").split(",")[0].strip() for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")]
    return min([_cores(), *(int(x) for x in asked if x.isdecimal() and int(x) > 0)])


def in_threads(function: Callable[[Share], Result], shares: Iterable[Share]) -> Iterator[Result]:
    """Results of a function for each share, in the order of the shares, which are read as they are needed.

    A single share is done in the caller's thread, and so are all where there is one thread only.

    Parameters
    ----------
    function : callable
        Of one share; spends its time without the interpreter's lock.
    shares : iterable

    Yields
    ------
    object

    Examples
    --------
    >>> from pysindy_nrf.threads import in_threads
    >>> list(in_threads(abs, [-1, 2, -3]))
    [1, 2, 3]
    """
    rest = iter(shares)
    begun, threads = list(islice(rest, 2)), n_threads()
    if threads == 1 or len(begun) < 2:
        yield from map(function, chain(begun, rest))
        return
    from concurrent.futures import Future, ThreadPoolExecutor

    waiting: deque[Future[Result]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for share in chain(begun, rest):
            waiting.append(pool.submit(function, share))
            if len(waiting) > _AHEAD * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
