"""Change between tests, within a record, and over many tests or a stream."""

from ..common.lazy import public_names

_NAMES = {
    "ChangeAlarm": "stream_alarm",
    "ControlChart": "control_chart",
    "StoreyCycles": "cycles",
    "Tracked": "track",
    "compare_tests": "change",
    "moving_windows": "change",
    "storey_cycles": "cycles",
    "track": "track",
}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
