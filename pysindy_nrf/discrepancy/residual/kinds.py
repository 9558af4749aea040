"""What a diagnosis concludes, as types."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class ResidualKind(Enum):
    """What the residual of one balance or storey holds; the values are the words."""

    NOISE = "noise"
    LINEAR = "linear effect missing"
    NONLINEAR = "nonlinear effect missing"
    UNMEASURED = "unmeasured force or unknown noise"


class Location(Enum):
    """What the signs of the balances show."""

    # noise or rounding explains all balances
    NOTHING = "nothing to locate"
    EXPLAINS = "explains"
    # all sites have one pattern of signs
    ONE_BALANCE = "one balance"


class Dependence(Enum):
    """What a missing force depends on; the values name rows of the table of shares."""

    CONSTANT = "constant"
    LINEAR = "linear"
    LINE = "line"
    DRIFT = "s alone"
    RATE = "v alone"
    COVARIATE = "covariate"
    TIME = "time"
    SURFACE = "s and v"
    PATH = "path"
    NOTHING = "nothing tried"


class Feature(Enum):
    """Marks of the shape of a missing force."""

    JUMP = "jump at v = 0"
    KINK = "kink"
    HARDENING = "hardening"
    SOFTENING = "softening"


@dataclass(frozen=True)
class Obstacle:
    """Why one question to the residual has no answer.

    ``expected`` if nothing is missing.
    """

    reason: str
    expected: bool = False
