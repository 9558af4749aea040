"""Independent shares of one pass on all cores; compiled code releases the interpreter's lock."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain, islice
from typing import TypeVar

Share = TypeVar("Share")
Result = TypeVar("Result")

_AHEAD = 2  # shares per thread that are queued or done; bounds the memory


def n_threads() -> int:
    """Number of threads of a pass: the cores of this process, limited by OMP_NUM_THREADS and NUMBA_NUM_THREADS."""
    from joblib import cpu_count  # affinity and the limits of a container count

    asked = [os.environ.get(name, "").split(",")[0].strip() for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")]
    return min([cpu_count(), *(int(x) for x in asked if x.isdecimal() and int(x) > 0)])


def in_threads(function: Callable[[Share], Result], shares: Iterable[Share]) -> Iterator[Result]:
    """Results of a function for each share, in order; the caller's thread reads the shares on demand."""
    rest = iter(shares)
    begun = list(islice(rest, 2))
    threads, rest = n_threads() if len(begun) == 2 else 1, chain(begun, rest)
    if threads == 1:
        yield from map(function, rest)
        return
    waiting: deque[Future[Result]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for share in rest:
            waiting.append(pool.submit(function, share))
            if len(waiting) > _AHEAD * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
