"""Whether an effect is still needed where noise makes nothing wrong.

Noise in the motions makes the masses and coefficients of least squares low, most where the motion is small: early or
late in a sweep, after the strong part of an earthquake. A stiffness that drifts, a force with another gain or a
constant makes up for some of that, in every block of the data. Instrumental variables are not made wrong by noise: with
their coefficients the error falls only if the effect is there.

Frictions and hystereses are not asked about. Noise does not look like them, and their free runs under a noisy force
stick and slip where the structure did not.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from ..estimation.iv import instrumental_variables
from ..estimation.problem import Problem
from ..exceptions import NRFError, NRFWarning
from ..regression.chain_solve import Solution
from ..simulation.system import flatten, jumps
from .evidence import searched
from .gate import Verdict, gain_of
from .prepare import Prepared
from .stage import Stage
from .surrogate import UNBIASED, Null

# Share of the gain by least squares that must be left without the noise's share in it.
_LEFT = 0.25
# An error this many times what noise leaves is not made by noise.
_BEYOND = 2.5
# An error this many times that of least squares says that the instruments are too weak to be asked.
_WEAK = 1.3
# Noise that makes a mass or a force wrong by this share, with no instruments to ask: gain that is then asked for,
# beside twice that of the surrogates; error, percent, beyond which nothing is believed.
_STRONG, _GAIN, _OPEN = 0.05, 0.5, 50.0


def unbiased_errors(stage: Stage, ready: Prepared) -> np.ndarray | None:
    """Balance errors on the search blocks with masses and coefficients by instrumental variables."""
    found = unbiased(stage, ready)
    if found is None:
        return None
    trial = stage.trial()
    return np.array([trial.error(found, [b]) for b in range(len(stage.work.search))])


def unbiased(stage: Stage, ready: Prepared) -> Solution | None:
    """Masses and coefficients by instrumental variables on the search data."""
    trial, work = stage.trial(), stage.work
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NRFWarning)  # what is wrong with the channels has been said
            data, filters = searched(work, data=ready.apart)
            problem = Problem(trial.layout.chain, trial.layout.laws, work.known_masses, strategy=work.strategy)
            found = instrumental_variables(trial.model(), data, problem, trial.solve_order, filters)
    except (NRFError, np.linalg.LinAlgError):
        return None
    return found.solution if found is not None and found.settled else None


def _rough(stage: Stage) -> bool:
    """Whether a law of the model remembers its path, or its force jumps."""
    model = stage.trial().model()
    if model.has_memory:
        return True
    try:
        _, layout = flatten(model)
    except NRFError:  # no free run is possible anyway
        return False
    return bool(jumps(model, layout, np.ones(len(layout.covariates))).any())


def wrong_by(after: Stage, null: Null, corrected: Prepared | None = None) -> float:
    """By how much noise makes the models wrong, without an effect and with it."""
    if null.bias >= _STRONG:
        return null.bias
    sites = null.stage.layout.acting  # a small effect at a site of its own may be known to a tenth of itself
    return max(null.bias, Null(corrected or null.ready, after, null.rng, null.count, sites).bias)


def confirmed(
    verdict: Verdict, stage: Stage, after: Stage, null: Null, corrected: Prepared | None = None
) -> Verdict:
    """The verdict on an accepted effect once the noise's own share in it is known."""
    if null.hasty or null.ready.clean or (null.stages and null.bias < UNBIASED):
        return verdict
    plain = [float(np.median(s.slot().folds())) for s in (stage, after)]
    if plain[0] > _BEYOND * null.floor or _rough(after):  # the first is not so of a floor that is not known
        return verdict
    before, left = unbiased_errors(stage, null.ready), unbiased_errors(after, corrected or null.ready)
    if before is not None and left is not None:
        clean = [float(np.median(before)), float(np.median(left))]
        if clean[0] <= _WEAK * plain[0] or clean[1] <= _WEAK * plain[1]:
            if gain_of(before, left) >= _LEFT * verdict.gain:
                return verdict
            fall = f"{clean[0]:.3g} to {clean[1]:.3g} %"
            said = f"{verdict.sentence}; but not with instrumental variables, which noise does not bias ({fall})"
            return replace(verdict, accepted=False, sentence=said)
    needed = max(_GAIN, 2.0 * verdict.null_gain + 0.05) if null.stages else 0.0
    if verdict.gain >= needed and plain[1] <= _OPEN:
        return verdict
    bias = wrong_by(after, null, corrected) if null.stages else np.inf
    if bias < _STRONG:
        return verdict
    wrong = f"noise alone makes the model wrong by {100 * bias:.0f} %" if null.stages else "noise is strong"
    return replace(verdict, accepted=False, sentence=f"{verdict.sentence}; {wrong}, and no instruments can tell")


__all__ = ["confirmed", "unbiased", "unbiased_errors", "wrong_by"]
