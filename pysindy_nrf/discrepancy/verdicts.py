"""What the evidence concludes, as types; :mod:`pysindy_nrf.discrepancy.words` makes the sentences."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class ResidualKind(Enum):
    """What the residual of one balance or storey holds."""

    NOISE = "noise"
    LINEAR = "linear"
    NONLINEAR = "nonlinear"
    UNMEASURED = "unmeasured"  # an unmeasured force or coloured noise


class Location(Enum):
    """What the signs of the balances say of one site."""

    NOTHING = "nothing to locate"  # noise or rounding explains all balances
    EXPLAINS = "explains"
    ONE_BALANCE = "one balance"  # every site explains the same
    UNSEEN = "unseen"  # the site touches no known balance
    UNKNOWN = "unknown"  # nothing is left to be explained


class Agreement(Enum):
    """How localisation and the site that the loop chose agree."""

    NONE = "none"  # nothing was chosen or located
    SIGNLESS = "signless"  # all sites have one pattern of signs
    SAME = "same"
    UNJUDGED = "unjudged"
    SAME_SIGNS = "same signs"
    LATER = "later"  # the located site follows in a later step
    NEAR = "near"
    DISAGREES = "disagrees"


class Dependence(Enum):
    """What a missing force depends on; the values name the rows of the table of shares."""

    CONSTANT = "constant"
    LINEAR = "linear"
    LINE = "line"
    DELAY = "delay"
    DRIFT = "s alone"
    RATE = "v alone"
    COVARIATE = "covariate"
    TIME = "time"
    AMPLITUDE = "amplitude"
    SURFACE = "s and v"
    PATH = "path"
    NOTHING = "nothing tried"


class Feature(Enum):
    """Marks of the shape of a missing force."""

    JUMP = "jump at v = 0"
    KINK = "kink"
    HARDENING = "hardening"
    SOFTENING = "softening"


class Parity(Enum):
    """Symmetry of a force under (s, v) -> (-s, -v)."""

    ODD = "odd"
    EVEN = "even"
    NEITHER = "neither"

    @classmethod
    def of(cls, odd: float) -> Parity:
        """Parity from the share of the odd part, 0 to 1."""
        return cls.ODD if odd > 0.9 else cls.EVEN if odd < 0.1 else cls.NEITHER


class Why(Enum):
    """Why one question to the residual has no answer."""

    UNTRIED = "untried"
    ERROR = "error"
    NO_SITE = "no site"
    ONLY_NOISE = "only noise"
    NOTHING_LOCATED = "nothing located"


@dataclass(frozen=True)
class Obstacle:
    """Why one question to the residual has no answer; ``error`` is the text of an exception."""

    why: Why
    error: str = ""

    @property
    def expected(self) -> bool:
        """Whether there is no answer because nothing is missing."""
        return self.why in (Why.ONLY_NOISE, Why.NOTHING_LOCATED)


@dataclass(frozen=True)
class Contradiction:
    """Two channels of one DOF that do not show one motion; ``message`` is that of the alignment."""

    channel: str
    reference: str
    message: str
