"""Force laws: one class each, used by features, identification, simulation, search and text."""

from .base import ForceLaw, Shape, Term, from_dict, registry
from .bouc_wen import BoucWen
from .contact import Bilinear, DeadZone, OneSidedGap, PreloadedContact, TwoSidedGap
from .contract import check_law
from .damping import DisplacementDependentDamping, PowerLawDamping, QuadraticDamping
from .degradation import DampingDrift, StiffnessDrift, StiffnessStep
from .elastic import Duffing, LinearElastic, LinearViscous
from .forcing import BaseMotion, ConstantForce, HarmonicForce
from .friction import AsymmetricFriction, CoulombFriction, GroundFriction, ShiftedFriction, StribeckFriction
from .hysteresis import Dahl, ModifiedDahl
from .inertia import AddedMass, Inerter
from .jenkins import Iwan, Jenkins
from .link import LinkSpringDashpot
from .lugre import LuGre
from .maxwell import MaxwellBranch
from .motion import Motion
from .power_series import PowerSeries
from .semi_active import CovariateDahl, CovariateFriction, LaggedCovariateFriction
from .sensor import ChannelDelay, GainError, SensorFault, SensorOffset
from .stiffness import AbsoluteQuadraticStiffness, CubicStiffness, QuadraticStiffness, QuinticStiffness

__all__ = [
    "ForceLaw",
    "Motion",
    "Shape",
    "Term",
    "from_dict",
    "registry",
    "check_law",
    "PowerSeries",
    "LinearElastic",
    "LinearViscous",
    "Duffing",
    "CoulombFriction",
    "AsymmetricFriction",
    "StribeckFriction",
    "ShiftedFriction",
    "GroundFriction",
    "CovariateFriction",
    "LaggedCovariateFriction",
    "QuadraticDamping",
    "PowerLawDamping",
    "DisplacementDependentDamping",
    "QuadraticStiffness",
    "AbsoluteQuadraticStiffness",
    "CubicStiffness",
    "QuinticStiffness",
    "OneSidedGap",
    "PreloadedContact",
    "TwoSidedGap",
    "DeadZone",
    "Bilinear",
    "Dahl",
    "ModifiedDahl",
    "CovariateDahl",
    "Jenkins",
    "Iwan",
    "LuGre",
    "BoucWen",
    "MaxwellBranch",
    "StiffnessStep",
    "StiffnessDrift",
    "DampingDrift",
    "HarmonicForce",
    "ConstantForce",
    "BaseMotion",
    "AddedMass",
    "Inerter",
    "LinkSpringDashpot",
    "SensorFault",
    "ChannelDelay",
    "GainError",
    "SensorOffset",
]
