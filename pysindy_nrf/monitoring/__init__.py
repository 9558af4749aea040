"""Change between tests and within a record."""

from ..common.lazy import public_names

_NAMES = {"compare_tests": "change", "track": "change"}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
