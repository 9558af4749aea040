"""Pictures in scikit-learn's manner: data in ``__init__``, ``plot(ax=None)`` draws, ``from_estimator`` gets the data.

Matplotlib (extra ``plot``) is imported when something is drawn.
"""

from .before_after import BeforeAfterDisplay
from .change_map import ChangeMapDisplay
from .coefficients import CoefficientsDisplay
from .damper_force import DamperForceDisplay
from .dependence import DependenceDisplay
from .energy import EnergyDisplay
from .free_run import FreeRunDisplay
from .localisation import LocalisationDisplay
from .loops import HysteresisLoopDisplay
from .modes import ModesDisplay
from .order_selection import OrderSelectionDisplay
from .planarity import PlanarityDisplay
from .record import RecordDisplay
from .residual_map import ResidualMapDisplay
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
    "OrderSelectionDisplay",
    "PlanarityDisplay",
    "RecordDisplay",
    "TrackDisplay",
    "CoefficientsDisplay",
    "DependenceDisplay",
    "LocalisationDisplay",
    "ResidualMapDisplay",
]
