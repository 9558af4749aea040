"""The free run of a chain fitted to the channels of fewer sensors than floors.

A linear chain comes first, from the modes of the channels; declared laws start from the
linear chains that follow the channels best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.structure import Chain
from ..exceptions import ChannelError, ExcitationError, IdentifiabilityError
from ..laws import PowerSeries
from .chain_starts import LinearChain, chain_starts
from .channel_trials import Knowledge, Trial, distance_of_masses, solved
from .declared_law_fit import fit_declared_laws
from .fewer_sensors_settings import SETTINGS
from .free_run_fit import FreeRunFit, Solution
from .hidden_motions import channel_errors, error_beyond_noise
from .parameter_vector import free_parameters
from .parameters import Known
from .problem import Problem
from .shots import Shot
from .spectra import common_band
from .whitened_runs import MIN_ROWS


class ChannelEstimate(NamedTuple):
    """Best fit of a free run to the channels.

    Attributes
    ----------
    fit : FreeRunFit
        With the noise that it shows.
    solution : Solution
    rivals : list of str
        A sentence, if another chain fits as well.
    """

    fit: FreeRunFit
    solution: Solution
    rivals: list[str]


def estimate(
    problem: Problem,
    shots: Sequence[Shot],
    known: Mapping[int, float],
    constraints: Known = MappingProxyType({}),
) -> ChannelEstimate:
    """Free run of the problem's laws fitted to the channels of shots.

    Parameters
    ----------
    problem : Problem
    shots : sequence of Shot
    known : mapping of int to float
        Masses, kg, by DOF.
    constraints : mapping of str to Parameter

    Raises
    ------
    ChannelError
        If the records are too short.
    ExcitationError
        If nothing scales the chain.
    IdentifiabilityError
        If the sensors do not determine the chain, or no chain follows the channels.
    """
    _require_length(shots)
    knowledge = Knowledge(problem.chain, known, constraints)
    forced = _forced_dofs(shots)
    scaling_masses = knowledge.scaling_masses(forced)
    if not forced and not scaling_masses:
        raise ExcitationError(
            "No force is measured and no mass is known, so nothing scales the chain",
            "Measure a force on one DOF, or give a mass: known_masses={dof: kg}; ratios"
            " to it then come out.",
        )

    is_linear = _has_linear_links_only(problem)
    if is_linear and not constraints:
        _require_sensing(problem.chain, shots, forced, known)

    starts = _starting_chains(problem, shots, knowledge, scaling_masses)
    trials = _linear_trials(problem, shots, knowledge, starts, is_linear)
    if is_linear:
        best, rivals = _best_chain(trials)
    else:
        followed = _followed(trials)
        best = fit_declared_laws(problem, followed, knowledge)
        rivals = []

    best = _with_learned_noise(_with_best_hold(best))
    return ChannelEstimate(best.fit, best.solution, rivals)


def refined(fit: FreeRunFit) -> ChannelEstimate:
    """The end of a fit that begins near it, weighted by the noise that it shows.

    Raises
    ------
    NRFError
        If the first free run diverges.
    """
    solution = fit.solve(
        fit.rebuild.start,
        steps=SETTINGS.law_steps,
        move=True,
        settled=SETTINGS.settled,
    )
    trial = _with_learned_noise(Trial(fit.begun_from(solution), solution))
    return ChannelEstimate(trial.fit, trial.solution, [])


def _require_length(shots: Sequence[Shot]) -> None:
    longest = max(shots, key=attrgetter("n_samples"))
    if longest.n_samples < MIN_ROWS:
        raise ChannelError(
            f"Record {longest.segment.name!r} has {longest.n_samples} samples, and none"
            " has more",
            f"Give records of {MIN_ROWS} samples or more.",
        )


def _forced_dofs(shots: Sequence[Shot]) -> set[int]:
    forced: set[int] = set()
    for shot in shots:
        forces = shot.segment.F[shot.segment.valid]
        forced.update((np.flatnonzero(forces.any(axis=0)) + 1).tolist())
    return forced


def _links(problem: Problem) -> list[Site]:
    """Links in which laws act."""
    return [site for site in problem.layout.acting if site.kind == "link"]


def _has_linear_links_only(problem: Problem) -> bool:
    """Whether all laws are springs and dashpots in links."""
    for site, laws in problem.laws.items():
        for law in laws:
            is_linear = isinstance(law, PowerSeries) and law.degree == 1
            if site.kind != "link" or not is_linear:
                return False
    return True


def _require_sensing(
    chain: Chain, shots: Sequence[Shot], forced: set[int], known: Mapping[int, float]
) -> None:
    """Raise an error if the sensors determine no linear chain, whatever the noise."""
    dofs = {int(channel[1:]) for channel in shots[0].channels}
    sensing = chain.sensing(dofs, forced, known_masses=known)
    if not sensing.complete:
        raise IdentifiabilityError(
            str(sensing).rstrip("."),
            "So do more known_masses=, or a Parameter with a spread for each.",
        )


def _starting_chains(
    problem: Problem,
    shots: Sequence[Shot],
    knowledge: Knowledge,
    scaling_masses: Mapping[int, float],
) -> list[LinearChain]:
    """The chain of the expected values, and chains with the modes of the channels."""
    links = _links(problem)
    expected = _expected_chain(knowledge.values, problem.chain.n_dof, links)
    band = common_band([shot.segment for shot in shots], problem.band)
    try:
        from_modes = chain_starts(shots, problem.chain, links, scaling_masses, band)
    except IdentifiabilityError:
        if expected is None:
            raise
        return [expected]
    return from_modes if expected is None else [expected, *from_modes]


def _expected_chain(
    values: Mapping[str, float], n_dof: int, links: Sequence[Site]
) -> LinearChain | None:
    """The chain of known and expected values, if they are of all its parameters."""
    masses = [values.get(f"m{dof}", 0.0) for dof in range(1, n_dof + 1)]
    stiffness = [values.get(f"{site}: s", 0.0) for site in links]
    if min(masses) <= 0 or min(stiffness) <= 0:
        return None

    springs = {site: PowerSeries(1, [0.0, k]) for site, k in zip(links, stiffness)}
    lowest = ChainModel(masses, springs).modes()["frequency"].min()
    k = np.array(stiffness)
    c = 2 * SETTINGS.first_damping * k / (2 * np.pi * lowest)
    return LinearChain(np.array(masses), k, c, 0.0)


def _linear_trials(
    problem: Problem,
    shots: Sequence[Shot],
    knowledge: Knowledge,
    starts: Sequence[LinearChain],
    is_linear: bool,
) -> list[Trial]:
    """A few steps from every starting chain, the best first."""
    trials = []
    for start in starts:
        fit = _linear_fit(problem, shots, knowledge, start, is_linear)
        trial = solved(fit, fit.rebuild.start, SETTINGS.trial_steps)
        if trial is not None:
            trials.append(trial)

    if not trials:
        raise IdentifiabilityError(
            "No linear chain follows the channels",
            "Check units and DOFs, or add a sensor.",
        )
    even = [trial for trial in trials if _is_even(trial.solution.model)]
    return sorted(even or trials, key=attrgetter("cost"))


def _linear_fit(
    problem: Problem,
    shots: Sequence[Shot],
    knowledge: Knowledge,
    start: LinearChain,
    is_linear: bool,
) -> FreeRunFit:
    """Fit of a linear chain to the shots."""
    laws = {}
    for site, c, k in zip(_links(problem), start.damping, start.stiffness):
        laws[site] = PowerSeries(1, [c, k])
    model = ChainModel(start.masses, laws, problem.chain)
    rebuild = free_parameters(model, knowledge.masses)
    return FreeRunFit(
        rebuild=rebuild,
        shots=shots,
        band=problem.band,
        prior=knowledge.prior(rebuild, all_declared=is_linear),
    )


def _is_even(model: ChainModel) -> bool:
    """Whether no floor is so heavy that it hardly moves."""
    return bool(np.ptp(np.log(model.masses)) < np.log(SETTINGS.max_mass_ratio))


def _followed(trials: Sequence[Trial]) -> list[Trial]:
    """The best trials, if they are not much worse than the best."""
    limit = SETTINGS.max_cost_ratio * trials[0].cost
    return [trial for trial in trials[: SETTINGS.followed] if trial.cost <= limit]


def _best_chain(trials: Sequence[Trial]) -> tuple[Trial, list[str]]:
    """The chain that trials end in, and a sentence on rivals."""
    best = trials[0]
    n_values = best.fit.n_samples * len(best.fit.shots[0].channels)
    # the ratio of likelihoods of the confidence region, as one of costs
    ratio = chi2.ppf(SETTINGS.rival_level, len(best.solution.u)) / n_values
    alike = np.exp(ratio)

    followed = _followed(trials)
    for trial in trials[SETTINGS.followed :]:
        if trial.cost <= alike * best.cost:
            followed.append(trial)

    ends = []
    for trial in followed:
        end = solved(trial.fit, trial.solution.u, SETTINGS.max_steps)
        ends.append(trial if end is None else end)
    ends.sort(key=attrgetter("cost"))

    models = []
    for end in ends:
        if end.cost < alike * ends[0].cost:
            models.append(end.solution.model)
    return ends[0], _rivals(models)


def _rivals(models: Sequence[ChainModel]) -> list[str]:
    """A sentence if chains far apart fit alike; the best comes first."""
    for model in models:
        if distance_of_masses(model, models[0]) > SETTINGS.rival_distance:
            masses = ", ".join(f"{mass:.3g}" for mass in model.masses)
            return [
                "Another linear chain fits the channels as well, with masses of"
                f" {masses} {model.units.mass}: add a sensor."
            ]
    return []


def _with_best_hold(trial: Trial) -> Trial:
    """The estimate under the course of the force that predicts the channels best."""
    fit = trial.fit.with_best_hold(trial.solution.model)
    if [shot.hold for shot in fit.shots] != [shot.hold for shot in trial.fit.shots]:
        again = solved(fit, trial.solution.u, SETTINGS.max_steps)
        if again is not None:
            return again
    return Trial(fit, trial.solution)


def _with_learned_noise(trial: Trial) -> Trial:
    """The estimate weighted by the noise that its own gaps show."""
    channels = trial.fit.shots[0].channels
    for _ in range(SETTINGS.noise_rounds):
        fit = trial.fit.with_noise(trial.solution.model, channels)
        if fit is None:
            break
        again = solved(fit, trial.solution.u, SETTINGS.max_steps)
        if again is None or _loses_the_channels(again, trial):
            break
        trial = again

    if trial.fit.noise is None:
        # weights do without noise, intervals of motions do not
        fit = trial.fit.with_noise(trial.solution.model, channels)
        if fit is not None:
            trial = Trial(fit, trial.solution)
    return trial


def _loses_the_channels(weighted: Trial, trial: Trial) -> bool:
    """Whether gaps that are no noise, taken for noise, lead the fit away."""
    model = trial.solution.model
    errors = [error_beyond_noise(weighted.fit, s, model) for s in weighted.fit.shots]
    if not any(errors):
        return False
    before = channel_errors(trial.fit.shots, model)["error"]["pooled"]
    model = weighted.solution.model
    after = channel_errors(weighted.fit.shots, model)["error"]["pooled"]
    return bool(after > (1 + SETTINGS.reported_error) * before)
