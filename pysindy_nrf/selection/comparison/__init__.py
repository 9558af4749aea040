"""Plain SINDy and this package side by side, on the same data in the same call."""

from .api import Comparison, compare, compare_with_sindy, term_shares

__all__ = ["Comparison", "compare", "compare_with_sindy", "term_shares"]
