"""Independent shares of one pass on all cores; compiled code releases the interpreter's
lock.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, islice
from typing import TypeVar

Share = TypeVar("Share")
Result = TypeVar("Result")

_AHEAD = 2  # shares per thread that are queued or done; bounds the memory


def n_threads() -> int:
    """Number of threads of a pass: the cores of this process, limited by
    OMP_NUM_THREADS and NUMBA_NUM_THREADS.
    """
    from joblib import cpu_count  # affinity and the limits of a container count

    asked = [
        os.environ.get(name, "").split(",")[0].strip()
        for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
    ]
    return min([cpu_count(), *(int(x) for x in asked if x.isdecimal() and int(x) > 0)])


def in_threads(
    function: Callable[[Share], Result], shares: Iterable[Share]
) -> Iterator[Result]:
    """Results of a function for each share, in order; shares are read on demand, one at
    a time.
    """
    rest = iter(shares)
    begun = list(islice(rest, 2))
    threads, rest = n_threads() if len(begun) == 2 else 1, chain(begun, rest)
    if threads == 1:
        yield from map(function, rest)
        return
    with ThreadPoolExecutor(threads) as pool:
        given = (pool.submit(function, share) for share in rest)
        running = deque(islice(given, _AHEAD * threads))
        while running:
            yield running.popleft().result()
            running.extend(islice(given, 1))
