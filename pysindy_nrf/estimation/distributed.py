"""Beyond one machine: partitions of Dask arrays and tables, and delayed records, reduced as a tree.

Every partition leaves a few small matrices, which add in any order. On a ``distributed`` cluster, what a lost worker
had done is done again by another one; no task changes what another one gave.
"""

from .streaming.partitions import accumulate, added, fit_distributed

__all__ = ["accumulate", "added", "fit_distributed"]
