"""Force laws, one class each.

Features, identification, simulation, search and text use the same class.

``__all__`` names the contract and the laws that are written down most often. All others
are here under their names too, e.g. ``laws.TwoSidedGap``; :func:`registry` lists them,
and a search tries them.
"""

from .asymmetric import asymmetric
from .atoms import GeneralCurve as GeneralCurve
from .atoms import GeneralHysteresis as GeneralHysteresis
from .base import ForceLaw, Term, from_dict, registry
from .contact import Bilinear as Bilinear
from .contact import DeadZone as DeadZone
from .contact import OneSidedGap
from .contact import PreloadedContact as PreloadedContact
from .contact import SofteningKnee as SofteningKnee
from .contact import TwoSidedGap as TwoSidedGap
from .contract import check_law
from .contract import random_values as random_values
from .degrading import DegradingBoucWen as DegradingBoucWen
from .degrading import PinchedBoucWen as PinchedBoucWen
from .elastic import AbsoluteQuadraticStiffness as AbsoluteQuadraticStiffness
from .elastic import (
    CubicStiffness,
    Duffing,
    LinearElastic,
    LinearViscous,
    StiffnessDrift,
    StiffnessStep,
)
from .elastic import DampingDrift as DampingDrift
from .elastic import DisplacementDependentDamping as DisplacementDependentDamping
from .elastic import MaxwellBranch as MaxwellBranch
from .elastic import PowerLawDamping as PowerLawDamping
from .elastic import QuadraticDamping as QuadraticDamping
from .elastic import QuadraticStiffness as QuadraticStiffness
from .elastic import QuinticStiffness as QuinticStiffness
from .forcing import AddedMass as AddedMass
from .forcing import BaseMotion as BaseMotion
from .forcing import BendingCoupling as BendingCoupling
from .forcing import ConstantForce
from .forcing import GroundDashpot as GroundDashpot
from .forcing import HarmonicForce as HarmonicForce
from .forcing import HiddenOscillator as HiddenOscillator
from .forcing import Inerter as Inerter
from .forcing import LinkSpringDashpot as LinkSpringDashpot
from .friction import BreakAwayFriction as BreakAwayFriction
from .friction import CoulombFriction
from .friction import CovariateDahl as CovariateDahl
from .friction import CovariateFriction as CovariateFriction
from .friction import GroundFriction as GroundFriction
from .friction import LaggedCovariateFriction as LaggedCovariateFriction
from .friction import PositionDependentFriction as PositionDependentFriction
from .friction import RegularizedFriction as RegularizedFriction
from .friction import ShiftedFriction as ShiftedFriction
from .friction import StribeckFriction as StribeckFriction
from .general import PrandtlIshlinskii as PrandtlIshlinskii
from .general import SmoothSurface as SmoothSurface
from .hysteresis import BacklashFriction as BacklashFriction
from .hysteresis import BoucWen, Dahl, ModifiedDahl
from .hysteresis import Iwan as Iwan
from .hysteresis import Jenkins as Jenkins
from .hysteresis import LuGre as LuGre
from .power_series import PowerSeries
from .sensor import ChannelDelay as ChannelDelay
from .sensor import GainError as GainError
from .sensor import SensorFault as SensorFault
from .sensor import SensorOffset as SensorOffset
from .shape import Motion, Shape
from .shape import ShapeScale as ShapeScale

__all__ = [
    "ForceLaw",
    "Motion",
    "Shape",
    "Term",
    "asymmetric",
    "from_dict",
    "registry",
    "check_law",
    "PowerSeries",
    "LinearElastic",
    "LinearViscous",
    "Duffing",
    "CubicStiffness",
    "CoulombFriction",
    "OneSidedGap",
    "Dahl",
    "ModifiedDahl",
    "BoucWen",
    "ConstantForce",
    "StiffnessStep",
    "StiffnessDrift",
]
