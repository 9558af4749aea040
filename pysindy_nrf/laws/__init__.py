"""Force laws: one class each, used by features, identification, simulation, search and text."""

from .base import ForceLaw, Motion, Shape, Term, from_dict, registry
from .elastic import Duffing, LinearElastic, LinearViscous
from .hysteresis import Dahl, ModifiedDahl
from .power_series import PowerSeries

__all__ = [
    "ForceLaw",
    "Motion",
    "Shape",
    "Term",
    "from_dict",
    "registry",
    "PowerSeries",
    "LinearElastic",
    "LinearViscous",
    "Duffing",
    "Dahl",
    "ModifiedDahl",
]
