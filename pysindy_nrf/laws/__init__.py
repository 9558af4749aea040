"""Force laws: one class each, used by features, identification, simulation, search and text."""

from .base import ForceLaw, Term, from_dict, registry
from .contact import Bilinear, DeadZone, OneSidedGap, PreloadedContact, TwoSidedGap
from .contract import check_law
from .damping import DisplacementDependentDamping, MaxwellBranch, PowerLawDamping, QuadraticDamping
from .elastic import (
    AbsoluteQuadraticStiffness,
    CubicStiffness,
    DampingDrift,
    Duffing,
    LinearElastic,
    LinearViscous,
    QuadraticStiffness,
    QuinticStiffness,
    StiffnessDrift,
    StiffnessStep,
)
from .forcing import AddedMass, BaseMotion, ConstantForce, HarmonicForce, Inerter, LinkSpringDashpot
from .friction import (
    AsymmetricFriction,
    CoulombFriction,
    CovariateDahl,
    CovariateFriction,
    GroundFriction,
    LaggedCovariateFriction,
    ShiftedFriction,
    StribeckFriction,
)
from .hysteresis import BoucWen, Dahl, Iwan, Jenkins, LuGre, ModifiedDahl
from .power_series import PowerSeries
from .sensor import ChannelDelay, GainError, SensorFault, SensorOffset
from .shape import Motion, Shape

__all__ = [
    "ForceLaw", "Motion", "Shape", "Term", "from_dict", "registry", "check_law", "PowerSeries",
    "LinearElastic", "LinearViscous", "Duffing", "CoulombFriction", "AsymmetricFriction", "StribeckFriction",
    "ShiftedFriction", "GroundFriction", "CovariateFriction", "LaggedCovariateFriction", "QuadraticDamping",
    "PowerLawDamping", "DisplacementDependentDamping", "QuadraticStiffness", "AbsoluteQuadraticStiffness",
    "CubicStiffness", "QuinticStiffness", "OneSidedGap", "PreloadedContact", "TwoSidedGap", "DeadZone",
    "Bilinear", "Dahl", "ModifiedDahl", "CovariateDahl", "Jenkins", "Iwan", "LuGre", "BoucWen",
    "MaxwellBranch", "StiffnessStep", "StiffnessDrift", "DampingDrift", "HarmonicForce", "ConstantForce",
    "BaseMotion", "AddedMass", "Inerter", "LinkSpringDashpot", "SensorFault", "ChannelDelay", "GainError",
    "SensorOffset",
]  # fmt: skip
