"""Models linearised about their free runs, where floors have no sensor."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..exceptions import NRFError
from ..identification.fewer_sensors import Linearised
from ..identification.output_error import (
    FreeRunFit,
    Rebuild,
    Shot,
    Solution,
    free_parameters,
)
from ..identification.problem import Problem
from .candidate_search import polished
from .channel_spectra import CHANNELS, ChannelData, ChannelSpectra
from .effects import Effect, SearchState
from .fitted_model import FittedModel, LawsBySite, fit_model
from .folds import Split
from .heldout import JudgedModel
from .windows import ChannelWindows


@dataclass(frozen=True, eq=False)
class FittedRuns:
    """The free run of the declared model, fitted to the records."""

    shots: list[Shot]
    model: ChainModel
    # What is doubtful of the fit, in sentences.
    notes: list[str]


@dataclass(frozen=True, eq=False)
class SplitRuns:
    """The same with folds; no fit reads what is held out."""

    runs: FittedRuns
    folds: Split
    # Length of a window, s.
    length: float


@dataclass(frozen=True, eq=False)
class ChannelState:
    """A model judged by its free run, and the linear problem about it."""

    judged: JudgedModel
    search: SearchState


@dataclass(frozen=True, eq=False)
class RunFit:
    """A model fitted by its free run, and how it is rebuilt from free parameters."""

    solution: Solution
    rebuild: Rebuild


class RunModels:
    """Models, each linearised about its free run.

    Parameters
    ----------
    problem : Problem
    split_runs : SplitRuns
    """

    def __init__(self, problem: Problem, split_runs: SplitRuns) -> None:
        self.problem = problem
        self.shots = split_runs.runs.shots
        self.folds = split_runs.folds
        self.length = split_runs.length
        spectra = self._spectra(split_runs.runs.model)
        self.bands = spectra.find_bands(problem.band)
        self._first = split_runs.runs.model, spectra

    def _spectra(self, model: ChainModel) -> ChannelSpectra:
        """Spectra of the channels about the free run of a model."""
        run = Linearised(model, self.shots)
        channels = self.shots[0].channels
        data = ChannelData(run, channels, self.folds, self.problem.known_masses)
        windows = ChannelWindows(len(channels), data.data, data.search, self.length)
        return ChannelSpectra(data, windows)

    def declared(self) -> ChannelState:
        """The declared model about its free run."""
        model, spectra = self._first
        return self._judged("baseline", model, model.laws, spectra)

    def linearise(
        self,
        name: str,
        model: ChainModel,
        laws: LawsBySite,
        effects: Iterable[Effect] = (),
    ) -> ChannelState:
        """A model judged by its free run, and the linear problem about it."""
        return self._judged(name, model, laws, self._spectra(model), effects)

    def _judged(
        self,
        name: str,
        model: ChainModel,
        laws: LawsBySite,
        spectra: ChannelSpectra,
        effects: Iterable[Effect] = (),
    ) -> ChannelState:
        """A model judged by the run about which spectra are linearised."""
        linear = fit_model(spectra.with_bands(self.bands), self.problem.chain, laws)
        judged = judge_run(name, model, linear)
        return ChannelState(judged, SearchState(linear, tuple(effects)))

    def settle(
        self,
        name: str,
        state: SearchState,
        model: ChainModel | None = None,
    ) -> ChannelState | None:
        """Linearise about the free run until it stops improving; None if it diverges.

        Shape parameters are refined on the way.
        """
        best: ChannelState | None = None
        least = np.inf
        with suppress(NRFError, np.linalg.LinAlgError):
            for _ in range(CHANNELS.max_linearisations):
                model = state.model.chain_model() if model is None else model
                new = self.linearise(name, model, state.model.laws, state.effects)
                missed = float(new.judged.model.powers.residual.sum())
                stalled = missed > CHANNELS.stalled * least
                if best is None or missed < least:
                    best, least = new, missed
                if stalled:
                    break
                state, model = polished(new.search), None
        return best

    def fit(self, model: ChainModel, state: SearchState, steps: int) -> RunFit:
        """Fit the free run of a model to all rows that are not held out.

        By the sensitivities and initial states of its free run.
        """
        shapes = []
        for effect in state.effects:
            number = state.model.laws[effect.site].index(effect.law)
            for shape in effect.law.shapes:
                if effect.template.shape[shape.name] is None:
                    shapes.append((effect.site, number, shape))
        rebuild = free_parameters(model, self.problem.known_masses, shapes=shapes)
        used = [shot for shot in self.shots if shot.weights.any()]
        layout = LawLayout(model.chain, model.laws)
        fit = FreeRunFit(rebuild, used, layout, self.problem.band)
        solution = fit.solve(rebuild.start, steps=steps, move=True)
        # later runs begin from the initial states that were estimated
        begun = iter(fit.begun_from(solution).shots)
        self.shots = [next(begun) if s.weights.any() else s for s in self.shots]
        return RunFit(solution, rebuild)

    def refine(self, judged: JudgedModel, state: SearchState) -> ChannelState | None:
        """A settled model fitted by its free run; None if this misses no less."""
        with suppress(NRFError):
            model = judged.model.chain_model()
            best = self.fit(model, state, CHANNELS.fit_steps).solution.model
            effects = []
            for effect in state.effects:
                number = state.model.laws[effect.site].index(effect.law)
                law = best.laws[effect.site][number]
                effects.append(replace(effect, law=law))
            new = self.linearise(judged.name, best, best.laws, effects)
            if new.judged.model.reduction_from(judged.model).value > 0:
                return new
        return None


def judge_run(name: str, model: ChainModel, linear: FittedModel) -> JudgedModel:
    """A model judged by its free run, on the search and on held-out data.

    Parameters
    ----------
    name : str
    model : ChainModel
    linear : FittedModel
        The linear problem about the run, whose folds give the intervals.
    """
    spectra = linear.spectra
    assert isinstance(spectra, ChannelSpectra)
    values = [model.coefficients[site] for site in linear.layout.slices]
    fixed = linear.coefficients[0, linear.first_fixed :]
    coefficients = np.concatenate([*values, fixed])
    powers = spectra.missed(spectra.windows)
    run = replace(
        linear,
        masses=np.vstack([model.masses, linear.masses[1:]]),
        coefficients=np.vstack([coefficients, linear.coefficients[1:]]),
        powers=powers,
    )

    heldout = spectra.missed(spectra.heldout_windows())
    reference = spectra.bands.clear_power(powers.reference)
    error = spectra.error(heldout, reference)
    errors = {
        "search": run.error,
        "validation": run.error,
        "held-out": error,
        "free run": error,
    }
    missed = spectra.by_channel(heldout.residual)
    measured = spectra.by_channel(heldout.reference)
    shares = np.sqrt(missed / measured)
    for channel, share in zip(spectra.data.channels, shares):
        errors[f"held-out dof {channel[1:]}"] = float(100 * share)
    return JudgedModel(name, run, heldout, errors)
