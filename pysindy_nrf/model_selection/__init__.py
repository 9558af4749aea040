"""Choosing orders and hyper-parameters by held-out error, with respect for records and time.

``GridSearchCV(NRFRegressor(), {"degree": range(1, 8)}, cv=BlockedTimeSplit(), refit=one_standard_error)`` and
:func:`select_order`, which gives the same numbers from one pass over the samples.
"""

from .along_path import AlongPath
from .rule import one_standard_error
from .selection import OrderSelection, select_order
from .sparsity import BlockEnsemble, SparsitySelection, select_sparsity
from .splitters import BlockedTimeSplit, RecordSplit

__all__ = [
    "AlongPath",
    "BlockEnsemble",
    "SparsitySelection",
    "select_sparsity",
    "BlockedTimeSplit",
    "OrderSelection",
    "RecordSplit",
    "one_standard_error",
    "select_order",
]
