"""Orders and hyper-parameters chosen by held-out error.

``GridSearchCV(NRFRegressor(), {"degree": range(1, 8)}, cv=BlockedTimeSplit(),
refit=one_standard_error)`` and :func:`select_order`, which gives the same numbers from
one pass over the samples.
"""

from ..common.lazy import public_names

_NAMES = {
    "BlockedTimeSplit": "splitters",
    "one_standard_error": "one_se_rule",
    "select_order": "selection",
    "select_sparsity": "sparsity",
}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
