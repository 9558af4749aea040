"""Pictures in scikit-learn's manner: data in ``__init__``, ``plot(ax=None)`` draws, ``from_estimator`` gets the data.

Matplotlib (extra ``plot``) is imported when something is drawn.
"""

from .before_after import BeforeAfterDisplay
from .change_map import ChangeMapDisplay
from .damper_force import DamperForceDisplay
from .energy import EnergyDisplay
from .free_run import FreeRunDisplay
from .loops import HysteresisLoopDisplay
from .modes import ModesDisplay
from .planarity import PlanarityDisplay
from .record import RecordDisplay
from .surface import RestoringForceSurfaceDisplay
from .track import TrackDisplay

__all__ = [
    "BeforeAfterDisplay",
    "RestoringForceSurfaceDisplay",
    "HysteresisLoopDisplay",
    "DamperForceDisplay",
    "EnergyDisplay",
    "FreeRunDisplay",
    "ChangeMapDisplay",
    "ModesDisplay",
    "PlanarityDisplay",
    "RecordDisplay",
    "TrackDisplay",
]
