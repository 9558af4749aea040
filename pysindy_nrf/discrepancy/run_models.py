"""Models linearised about their free runs, where floors have no sensor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..exceptions import NRFError
from ..identification.channel_estimate import ChannelEstimate, refined
from ..identification.channel_fit import result_from_channels
from ..identification.fewer_sensors import Linearised, identification_of
from ..identification.free_runs import linear_matrices
from ..identification.output_error import (
    FreeRunFit,
    Shot,
    free_parameters,
)
from ..identification.problem import Problem
from ..identification.result import IdentificationResult
from .candidate_search import polished
from .channel_spectra import CHANNELS, ChannelData, ChannelSpectra
from .effects import Effect, SearchState
from .fitted_model import FittedModel, LawsBySite, fit_model
from .folds import Split
from .heldout import JudgedModel
from .windows import ChannelWindows


@dataclass(frozen=True, eq=False)
class FittedRuns:
    """The free run of the declared model, fitted to the records.

    Attributes
    ----------
    shots : list of Shot
        Of all records; those held out completely stand last.
    estimate : ChannelEstimate
        From all samples of the others.
    """

    shots: list[Shot]
    estimate: ChannelEstimate

    @property
    def model(self) -> ChainModel:
        """The declared model."""
        return self.estimate.solution.model


@dataclass(frozen=True, eq=False)
class SplitRuns:
    """The same with folds; no fit reads what is held out."""

    runs: FittedRuns
    folds: Split
    # Length of a window, s.
    length: float


@dataclass(frozen=True, eq=False)
class ChannelState:
    """A model judged by its free run, the linear problem about it, and its shots."""

    judged: JudgedModel
    search: SearchState
    shots: list[Shot]


@dataclass(frozen=True, eq=False)
class FittedRun:
    """A model fitted by its free run, and shots from the initial states found with it.

    Those of what is held out begin as before.
    """

    model: ChainModel
    shots: list[Shot]


class RunModels:
    """Models, each linearised about its free run.

    Parameters
    ----------
    problem : Problem
    split_runs : SplitRuns
    """

    def __init__(self, problem: Problem, split_runs: SplitRuns) -> None:
        self.problem = problem
        self.declared_runs = split_runs.runs
        self.folds = split_runs.folds
        self.length = split_runs.length
        self._first = self._spectra(self.declared_runs.model, self.declared_runs.shots)
        self.bands = self._first.find_bands(problem.band)

    def _spectra(self, model: ChainModel, shots: list[Shot]) -> ChannelSpectra:
        """Spectra of the channels about the free run of a model."""
        run = Linearised(model, shots)
        channels = shots[0].channels
        data = ChannelData(run, channels, self.folds, self.problem.known_masses)
        windows = ChannelWindows(len(channels), data.data, data.search, self.length)
        return ChannelSpectra(data, windows)

    def declared(self) -> ChannelState:
        """The declared model about its free run."""
        model, shots = self.declared_runs.model, self.declared_runs.shots
        linear = self._fitted(self._first, model.laws)
        judged = judge_run("baseline", model, linear)
        return ChannelState(judged, SearchState(linear), shots)

    def linearise(
        self,
        name: str,
        run: FittedRun,
        laws: LawsBySite,
        effects: Iterable[Effect] = (),
    ) -> ChannelState:
        """A model judged by its free run, and the linear problem about it."""
        linear = self._fitted(self._spectra(run.model, run.shots), laws)
        judged = judge_run(name, run.model, linear)
        return ChannelState(judged, SearchState(linear, tuple(effects)), run.shots)

    def _fitted(self, spectra: ChannelSpectra, laws: LawsBySite) -> FittedModel:
        """The linear problem about a run, in the informative bands."""
        return fit_model(spectra.with_bands(self.bands), self.problem.chain, laws)

    def settle(
        self, name: str, state: SearchState, start: FittedRun
    ) -> ChannelState | None:
        """Linearise about the free run until it stops improving; None if it diverges.

        By the error reduction, by which candidates are judged: else every candidate
        would gain what the model without it was not settled by. Shape parameters are
        refined on the way.

        Parameters
        ----------
        name : str
        state : SearchState
        start : FittedRun
            About which the state is linearised first.
        """
        best: ChannelState | None = None
        gain = np.inf
        run = start
        with suppress(NRFError, np.linalg.LinAlgError):
            for _ in range(CHANNELS.max_linearisations):
                new = self.linearise(name, run, state.model.laws, state.effects)
                if best is not None:
                    gain = new.judged.model.reduction_from(best.judged.model).value
                if gain > 0:
                    best = new
                if gain < CHANNELS.stalled:
                    break
                state = polished(new.search)
                run = FittedRun(state.model.chain_model(), start.shots)
        return best

    def fit(self, state: ChannelState, steps: int) -> FittedRun:
        """Fit the free run of a model to all rows that are not held out.

        By the sensitivities and initial states of its free run.
        """
        used = [shot for shot in state.shots if shot.weights.any()]
        model = state.judged.model.chain_model()
        fit = self._fit_to(used, model, state.search.effects)
        solution = fit.solve(fit.rebuild.start, steps=steps, move=True)
        begun = iter(fit.begun_from(solution).shots)
        shots = [next(begun) if s.weights.any() else s for s in state.shots]
        return FittedRun(solution.model, shots)

    def _fit_to(
        self, shots: Sequence[Shot], model: ChainModel, effects: Sequence[Effect]
    ) -> FreeRunFit:
        """A fit of masses, coefficients and free shape parameters to some shots."""
        shapes = []
        for effect in effects:
            number = _number_of(effect, model)
            for shape in effect.law.shapes:
                if effect.template.shape[shape.name] is None:
                    shapes.append((effect.site, number, shape))
        rebuild = free_parameters(model, self.problem.known_masses, shapes=shapes)
        layout = LawLayout(model.chain, model.laws)
        return FreeRunFit(rebuild, shots, layout, self.problem.band)

    def final_estimate(self, state: ChannelState) -> IdentificationResult:
        """The estimate of a model from all samples of the records that are searched.

        Raises
        ------
        NRFError
            If the channels do not determine it, or its free run leaves them.
        """
        model, effects = state.judged.model.chain_model(), state.search.effects
        estimate = self.declared_runs.estimate
        if effects:
            searched = [shot for shot in state.shots if shot.weights.any()]
            weights = [shot.weights for shot in estimate.fit.shots]
            shots = [replace(s, weights=w) for s, w in zip(searched, weights)]
            estimate = refined(self._fit_to(shots, model, effects))

        free = {site: list(group) for site, group in model.laws.items()}
        for effect in effects:
            free[effect.site][_number_of(effect, model)] = effect.template
        problem = replace(self.problem, laws=model.laws)
        result = result_from_channels(identification_of(problem, estimate))
        return replace(result, declared=problem.with_laws(free))

    def refine(
        self, state: ChannelState, steps: int = CHANNELS.fit_steps
    ) -> ChannelState:
        """A settled model fitted by its free run, in damped steps.

        As it was where that misses no less, or diverges.
        """
        with suppress(NRFError, np.linalg.LinAlgError):
            run = self.fit(state, steps)
            effects = []
            for effect in state.search.effects:
                effects.append(replace(effect, law=effect.law_in(run.model)))
            new = self.linearise(state.judged.name, run, run.model.laws, effects)
            if new.judged.model.reduction_from(state.judged.model).value > 0:
                return new
        return state

    def refine_candidate(self, state: ChannelState) -> ChannelState:
        """The same of one of several, in few steps where its run is integrated."""
        is_linear = linear_matrices(state.judged.model.chain_model()) is not None
        steps = CHANNELS.fit_steps if is_linear else CHANNELS.trial_steps
        return self.refine(state, steps)


def _number_of(effect: Effect, model: ChainModel) -> int:
    """Number of the law of an effect among those at its site."""
    return model.laws[effect.site].index(effect.law_in(model))


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
