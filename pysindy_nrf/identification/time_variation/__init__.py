"""Coefficients that change while the structure shakes.

The coefficient of a column follows a penalised spline in time (P-spline, Eilers and
Marx 1996), whose strength is that of the restricted likelihood. Steps are added to it
where the Bayesian information criterion prefers them. A change counts if it is
significant at a stated rate of false alarms, and next to laws of the amplitude, too.
"""

from ...common.lazy import public_names

_NAMES = {
    "TimeVariation": "variation",
    "VaryingSetting": "request",
    "with_time_variation": "follow",
}
__all__ = ["TimeVariation"]
__getattr__, __dir__ = public_names(__name__, _NAMES)
