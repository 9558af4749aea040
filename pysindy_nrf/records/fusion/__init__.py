"""Signals: one motion from many channels, and the same treatment for force and
response.
"""

from ...common.lazy import public_names

_NAMES = {"KinematicSmoother": "kinematic_smoother", "integrate": "kinematics"}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
