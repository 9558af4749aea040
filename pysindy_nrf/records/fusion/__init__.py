"""One motion of each degree of freedom from its measured channels."""

from ...common.lazy import public_names

_NAMES = {"KinematicSmoother": "kinematic_smoother", "integrate": "integration"}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
