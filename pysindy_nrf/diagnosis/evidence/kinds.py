"""What a diagnosis concludes, as types."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class ResidualKind(Enum):
    """What the residual of one balance or storey holds; the values are the words.

    Attributes
    ----------
    NOISE, LINEAR, NONLINEAR
        Noise alone; an effect that is missing, linear or not.
    UNMEASURED
        An unmeasured force, or noise that is not known.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis import ResidualKind
    >>> ResidualKind("noise")
    <ResidualKind.NOISE: 'noise'>
    """

    NOISE = "noise"
    LINEAR = "linear effect missing"
    NONLINEAR = "nonlinear effect missing"
    UNMEASURED = "unmeasured force or unknown noise"


class Location(Enum):
    """What the signs of the balances show.

    Attributes
    ----------
    NOTHING
        Noise or rounding explains all balances.
    EXPLAINS
        A force at one site explains most.
    ONE_BALANCE
        All sites have one pattern of signs.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis import Location
    >>> Location.NOTHING.value
    'nothing to locate'
    """

    NOTHING = "nothing to locate"
    EXPLAINS = "explains"
    ONE_BALANCE = "one balance"


class Dependence(Enum):
    """What a missing force depends on; the values name rows of the table of shares.

    Attributes
    ----------
    CONSTANT, LINEAR, LINE, DRIFT, RATE, COVARIATE, TIME, SURFACE, PATH
        Simplest first; the path is hysteresis.
    NOTHING
        None of them.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis import Dependence
    >>> Dependence("v alone")
    <Dependence.RATE: 'v alone'>
    """

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
    """Marks of the shape of a missing force.

    Attributes
    ----------
    JUMP, KINK
        Of friction, of a gap or contact.
    HARDENING, SOFTENING
        Of a smooth spring.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis import Feature
    >>> Feature.JUMP.value
    'jump at v = 0'
    """

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
