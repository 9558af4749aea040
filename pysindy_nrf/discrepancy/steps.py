"""What the loop says of an accepted effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..laws.base import ForceLaw, registry
from ..laws.friction import CoulombFriction
from ..laws.sensor import SensorFault
from ..mechanics.sites import Site
from ..regression.chain_solve import model_of
from ..regression.errors import balance_errors
from .catalogue import balances_of
from .gate import MOST_FAMILIES, Verdict, gain_of
from .report import Scene, Step
from .search import Finding
from .sensors import SensorFinding
from .stage import Trial

# A hysteresis that turns over within this share of the rms drift is friction by another name.
_ONE_CLASS = 0.3
# Share of the effect (noise taken off) that may stay unexplained for certain before a name is no longer sure; in the
# median block, whatever chance did.
SURE, _USUALLY = 0.1, 0.25
# Balance error, percent, far above noise, beyond which nothing is explained, however bad it was before.
_OPEN = 50.0


def remainder(before: float, left: float, floor: float) -> float:
    """Share of what noise does not explain that stays unexplained at the end."""
    noise = floor if np.isfinite(floor) else 0.0
    return float(np.sqrt(max(left**2 - noise**2, 0.0) / max(before**2 - noise**2, 1e-300)))


def surely_left(folds: np.ndarray, noise: Sequence[np.ndarray]) -> float:
    """Error that is left at the end at least: what block by block exceeds noise by more than chance (95 %)."""
    from scipy.stats import t

    median = float(np.median(folds))
    others = [n for n in noise if len(n) == len(folds) and (n > 0).all()]
    if not others or len(folds) < 3 or not (folds > 0).all():
        return median
    beyond = np.log(folds) - np.mean([np.log(n) for n in others], axis=0)
    chance = t.ppf(0.95, len(folds) - 1) * beyond.std(ddof=1) / np.sqrt(len(folds))
    return median * float(np.exp(-chance))


def weigh(steps: Sequence[Step], folds: np.ndarray, floor: float, noise: Sequence[np.ndarray]) -> None:
    """Say of each effect how much of it stays unexplained in the end, and whether its name is sure so far."""
    left, least = float(np.median(folds)), surely_left(folds, noise)
    for step in steps:
        step.remainder = remainder(step.validation_before, left, floor)
        open_still = least > _OPEN and not least <= 2.0 * floor
        surely = remainder(step.validation_before, least, floor)
        step.sure = surely <= SURE and step.remainder <= _USUALLY and not open_still


def doubt_names(steps: Sequence[Step]) -> None:
    """Take back the certainty of names that are only parts of one description."""
    kinds = registry()
    for step in steps:
        beside = [s for s in steps if s is not step and balances_of(Site(s.site)) == balances_of(Site(step.site))]
        law = kinds[step.law]
        company = [s for s in beside if _one_description(law, kinds[s.law])]
        if company:
            step.sure, step.company = False, [s.law for s in company]
            alone = remainder(step.validation_before, step.validation_after, step.noise_floor)
            step.remainder = max(step.remainder, alone)
        unsure = any(not s.sure for s in steps if not s.is_fault)
        if step.is_fault and Site(step.site).channel.startswith("F") and unsure:
            step.sure = False
        if _nearly_friction(law, {name: low for name, (low, _) in step.intervals.items()}):
            step.alternatives = list(dict.fromkeys([CoulombFriction.family, *step.alternatives]))[: MOST_FAMILIES - 1]
        if law.variable == "1" and beside:
            families = [*step.alternatives, *(f for s in beside for f in (s.family, *s.alternatives))]
            others = [f for f in dict.fromkeys(families) if f != step.family]
            step.alternatives = others[: MOST_FAMILIES - 1]


def _one_description(one: type[ForceLaw], two: type[ForceLaw]) -> bool:
    """Whether two laws in one balance may be parts of a single curve of the drift or of the rate."""
    curves, variables = [law for law in (one, two) if law.variable in ("s", "v")], {one.variable, two.variable}
    return bool(curves) and (len(variables) == 1 or ("1" in variables and not curves[0].jumps))


def _nearly_friction(law: type[ForceLaw], values: Mapping[str, float | None]) -> bool:
    """Whether a law with these shape parameters is dry friction in all but name."""
    return any((values.get(p.name) or np.inf) < p.friction_below for p in law.shapes if p.friction_below is not None)


def improper(law: str, found: Mapping[str, tuple[float, float]]) -> bool:
    """Whether the coefficients, given as intervals, are not those of the effect that a law is named after."""
    return any(found.get(symbol, (0.0, 0.0))[1] < 0.0 for symbol in registry()[law].expected_positive)


def worst(trial: Trial) -> str:
    """The balance with the largest share of the pooled error, in words."""
    blocks = range(len(trial.work.search))
    errors = balance_errors(model_of(trial.layout, trial.solve(blocks)), trial.total(blocks))["error"].drop("pooled")
    return f"balance of {str(errors.idxmax()).replace('dof', 'DOF')}"


def _alternatives(chosen: Finding, tied: Sequence[Finding], drift: float) -> list[str]:
    """Other families: those tied, and friction where a law is all but that."""
    families = [f.law.family for f in tied]
    if chosen.law.saturation_drift < _ONE_CLASS * drift or _nearly_friction(type(chosen.law), chosen.law.shape):
        families.insert(0, CoulombFriction.family)
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
    """An accepted candidate as a step of the report."""
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
        evidence=verdict.sentence + (f" ({faulty.witness.message})" if faulty and faulty.witness else ""),
        runners_up=[(f.law.name, str(f.site), f.error) for f in ranking if f is not chosen][:5],
    )


def corrected_again(
    steps: Sequence[Step], found: SensorFinding, verdict: Verdict, scenes: Sequence[Scene], after: np.ndarray
) -> bool:
    """Put a further correction of a fault into the step that told of it first, if there is one."""
    one = (found.law.name, str(found.site))
    k = next((k for k, step in enumerate(steps) if (step.law, step.site) == one), None)
    if k is None:
        return False
    first, last = steps[k], steps[-1]
    symbol = found.law.terms()[0].symbol
    before = scenes[0].folds
    first.parameters = _joined(found.law, first, steps[k + 1 :]).parameters
    first.sensors = list(dict.fromkeys([*first.sensors, *found.equals]))
    more = f"corrected again by {symbol} = {found.law.values[0]:.4g}"
    if first is last:
        first.evidence += f"; {more}: {verdict.sentence}"
    else:
        first.evidence += f"; {more} beside {last.law} at {last.site}"
        last.evidence += f"; {first.law} at {first.site} {more}: {verdict.sentence}"
    last.validation_after, last.gain, last.wins = (
        float(np.median(after)),
        gain_of(before, after),
        float(np.mean(after < before)),
    )
    return True


def _joined(law: ForceLaw, first: Step, between: Sequence[Step]) -> SensorFault:
    """Both corrections as one at the place of the first; a gain and an offset do not commute."""
    assert isinstance(law, SensorFault)
    for step in between:
        if step.site == first.site:
            earlier = registry()[step.law]()
            assert isinstance(earlier, SensorFault)
            law, other = law.before(earlier.with_values([v or 0.0 for v in step.parameters.values()]))
            step.parameters = other.parameters
    return law.with_values(list(first.parameters.values())).followed_by(law)
