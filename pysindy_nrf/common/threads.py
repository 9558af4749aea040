"""Independent shares of one pass on all cores.

Compiled code releases the interpreter's lock.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import chain, islice
from typing import TypeVar

Share = TypeVar("Share")
Result = TypeVar("Result")

THREAD_LIMIT_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
# Queued or done; bounds the memory.
SHARES_PER_THREAD = 2


def n_threads() -> int:
    """Number of threads of a pass: the cores of this process, or a lower limit.

    The environment variables in ``THREAD_LIMIT_VARIABLES`` set such limits.
    """
    count = n_cores()
    for name in THREAD_LIMIT_VARIABLES:
        limit = os.environ.get(name, "").split(",")[0].strip()
        if limit.isdecimal() and int(limit) > 0:
            count = min(count, int(limit))
    return count


@cache
def n_cores() -> int:
    """Cores of this process; asked once, since it reads files of the system."""
    from joblib import cpu_count  # affinity and the limits of a container count

    return cpu_count()


def in_threads(
    function: Callable[[Share], Result], shares: Iterable[Share]
) -> Iterator[Result]:
    """Results of a function for each share, in order.

    Shares are read on demand, one at a time.
    """
    remaining = iter(shares)
    first = list(islice(remaining, 2))
    remaining = chain(first, remaining)
    threads = n_threads() if len(first) == 2 else 1
    if threads == 1:
        yield from map(function, remaining)
        return

    with ThreadPoolExecutor(threads) as pool:
        submitted = (pool.submit(function, share) for share in remaining)
        running = deque(islice(submitted, SHARES_PER_THREAD * threads))
        while running:
            yield running.popleft().result()
            running.extend(islice(submitted, 1))
