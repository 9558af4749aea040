"""What the loop says of an accepted effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import balance_errors
from ..solved import model_of
from .gate import MOST_FAMILIES, Verdict
from .report import Step
from .search import Finding
from .sensors import SensorFinding
from .stage import Trial

# A hysteresis that turns over within this share of the rms drift is friction by another name.
_ONE_CLASS = 0.3
# So is a power of the rate below this; the fluid dampers of the literature begin with 0.3.
_NEARLY_FRICTION = 0.25


def remainder(before: float, left: float, floor: float) -> float:
    """Share of what noise does not explain that stays unexplained at the end."""
    noise = floor if np.isfinite(floor) else 0.0
    return float(np.sqrt(max(left**2 - noise**2, 0.0) / max(before**2 - noise**2, 1e-300)))


def improper(law: str, found: Mapping[str, tuple[float, float]]) -> bool:
    """Whether the coefficients are not those of the effect that a law is named after.

    A Stribeck force that falls towards rest is a way to write a force that grows with the rate.
    """
    return law == "stribeck_friction" and found.get("dF", (0.0, 0.0))[1] < 0.0


def worst(trial: Trial) -> str:
    """The balance with the largest share of the pooled error, in words."""
    blocks = range(len(trial.work.search))
    errors = balance_errors(model_of(trial.layout, trial.solve(blocks)), trial.moments(blocks))["error"].drop("pooled")
    return f"balance of {str(errors.idxmax()).replace('dof', 'DOF')}"


def _alternatives(chosen: Finding, tied: Sequence[Finding], drift: float) -> list[str]:
    """Other families: those tied, and friction where a law is all but that.

    A hysteresis that turns over within a small part of the drift, a power of the rate near zero.
    """
    families = [f.law.family for f in tied]
    shape = chosen.law.shape
    turn = shape.get("uy") if "uy" in shape else 1.0 / (shape.get("sigma") or np.inf) if "sigma" in shape else np.inf
    steep = chosen.law.family == "hysteresis" and turn is not None and turn < _ONE_CLASS * drift
    if steep or (chosen.law.name == "power_law_damping" and (shape.get("n") or 1.0) < _NEARLY_FRICTION):
        families.insert(0, "friction")
    return list(dict.fromkeys(families))[: MOST_FAMILIES - 1]


def step_of(
    chosen: Finding,
    tied: Sequence[Finding],
    verdict: Verdict,
    before: np.ndarray,
    after: np.ndarray,
    floor: float,
    ranking: Sequence[Finding],
    drift: float,
) -> Step:
    """An accepted candidate as a step of the report.

    Parameters
    ----------
    chosen : Finding
    tied : sequence of Finding
        Families that the data cannot tell from it.
    verdict : Verdict
    before, after : ndarray of shape (n_blocks,)
        Errors on each block after fitting to the others, percent.
    floor : float
        What noise alone leaves, percent.
    ranking : sequence of Finding
    drift : float
        Rms drift of the site, m.

    Returns
    -------
    Step
    """
    faulty = chosen if isinstance(chosen, SensorFinding) else None
    return Step(
        parameters=chosen.law.parameters if faulty else {},
        sensors=faulty.equals if faulty else [],
        law=chosen.law.name,
        family=chosen.law.family,
        site=str(chosen.site),
        shape=dict(chosen.law.shape),
        alternatives=_alternatives(chosen, tied, drift),
        tied=[(f.law.name, str(f.site), f.error) for f in tied],
        gain=verdict.gain,
        wins=verdict.wins,
        null_gain=verdict.null_gain,
        validation_before=float(np.median(before)),
        validation_after=float(np.median(after)),
        noise_floor=floor,
        evidence=verdict.sentence + (f" ({faulty.remark})" if faulty and faulty.remark else ""),
        runners_up=[(f.law.name, str(f.site), f.error) for f in ranking if f is not chosen][:5],
    )
