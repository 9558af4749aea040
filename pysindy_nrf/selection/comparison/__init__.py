"""Plain SINDy and this package side by side, on the same data in the same call."""

from .api import compare, compare_with_sindy

__all__ = ["compare", "compare_with_sindy"]
