"""Declared laws fitted to few channels, from the linear chains that follow them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from operator import attrgetter

import numpy as np

from ..chain.layout import LawLayout, with_coefficients
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..equations.chain_solve import scales_of
from ..exceptions import IdentifiabilityError
from ..laws.base import ForceLaw
from ..laws.shape import Motion, Shape, ShapeScale
from ..records.dataset import Dataset, Segment
from .channel_trials import Knowledge, Trial, distance_of_masses, solved
from .fewer_sensors_settings import SETTINGS
from .free_run_fit import FreeRunFit
from .free_runs import first_state
from .parameter_vector import free_parameters, free_shapes_of
from .problem import Problem
from .shots import Shot

# Scale of a coefficient, as a share of the one that alone gives the force of its site.
SHARE_OF_FORCE = 0.1
# Singular values of columns of one rms, as a share of the largest, that count.
RANK = 1e-6

Laws = dict[Site, list[ForceLaw]]


def fit_declared_laws(
    problem: Problem, linear_trials: Sequence[Trial], knowledge: Knowledge
) -> Trial:
    """The declared laws, from linear chains on their way to the channels.

    At its end a linear chain has made up for what it lacks.

    Parameters
    ----------
    problem : Problem
    linear_trials : sequence of Trial
        The best first.
    knowledge : Knowledge

    Raises
    ------
    IdentifiabilityError
        If every free run diverges.
    """
    trials: list[Trial] = []
    starts: list[ChainModel] = []
    for linear in linear_trials:
        model = linear.solution.model
        distances = [distance_of_masses(model, start) for start in starts]
        if min(distances, default=np.inf) < SETTINGS.rival_distance:
            continue
        from_this_chain = list(_trials_from(problem, linear, knowledge))
        if from_this_chain:
            starts.append(model)
            trials += from_this_chain

    for trial in sorted(trials, key=attrgetter("cost")):
        end = solved(trial.fit, trial.solution.u, SETTINGS.law_steps)
        if end is not None:
            return end
    raise IdentifiabilityError(
        "The free run of the declared laws diverges", "Start from a simpler law."
    )


def _trials_from(
    problem: Problem, linear: Trial, knowledge: Knowledge
) -> Iterator[Trial]:
    """Solutions in windows, with fits to whole shots that can go on from them."""
    shots = linear.fit.shots
    model = linear.solution.model
    runs = Dataset([shot.run(model) for shot in shots], 0)
    shapes = free_shapes_of(problem.laws)

    for laws in _laws_with_first_shapes(problem, shapes, runs):
        layout = LawLayout(problem.chain, laws)
        values, sizes = _nearest_coefficients(layout, runs, model)
        laws_of_start = with_coefficients(laws, values)
        start = ChainModel(model.masses, laws_of_start, problem.chain)
        rebuild = free_parameters(start, knowledge.masses, sizes, shapes)
        fit = FreeRunFit(
            rebuild=rebuild,
            shots=shots,
            layout=problem.layout,
            band=problem.band,
            prior=knowledge.prior(rebuild),
        )

        windows: list[Shot] = []
        first_windows = []
        for shot, run in zip(shots, runs.segments):
            first_windows.append(len(windows))
            windows += _windows(shot, run, problem.layout.has_memory)
        in_windows = replace(fit, shots=windows)
        trial = solved(in_windows, rebuild.start, SETTINGS.trial_steps)
        if trial is None:
            continue

        # whole shots begin where their first windows did
        begun = []
        for shot, window in zip(shots, first_windows):
            begun.append(replace(shot, start=trial.solution.starts[window]))
        yield Trial(replace(fit, shots=begun), trial.solution)


def _laws_with_first_shapes(
    problem: Problem, free: Sequence[tuple[Site, int, Shape]], runs: Dataset
) -> Iterator[Laws]:
    """The declared laws with first values for all shape parameters."""
    if not free:
        yield {site: list(laws) for site, laws in problem.laws.items()}
        return

    scales = scales_of(runs, problem.layout)
    scale = ShapeScale(
        [shape for _, _, shape in free], [scales[site] for site, _, _ in free]
    )
    for share in SETTINGS.first_shapes:
        laws = {site: list(group) for site, group in problem.laws.items()}
        values = scale.values(scale.low + share * (scale.high - scale.low))
        for (site, number, shape), value in zip(free, values):
            law = laws[site][number]
            laws[site][number] = law.with_values(shape={shape.name: float(value)})
        yield laws


def _nearest_coefficients(
    layout: LawLayout, runs: Dataset, model: ChainModel
) -> tuple[dict[Site, np.ndarray], dict[tuple[Site, int], float]]:
    """Coefficients whose forces are nearest to those of a linear model along its run.

    The second result is the scale of each coefficient, by site and term.
    """
    values = {}
    sizes = {}
    for site in layout.acting:
        motions = [run.motion(site, run.valid) for run in runs.segments]
        columns = np.concatenate([layout.columns(site, m) for m in motions])
        force = _linear_force(model, site, motions)

        rms = np.sqrt(np.mean(columns**2, axis=0))
        rms[rms == 0] = 1.0
        values[site] = np.linalg.lstsq(columns / rms, force, rcond=RANK)[0] / rms
        rms_force = max(np.sqrt(np.mean(force**2)), 1e-300)
        for term, size in enumerate(rms):
            sizes[site, term] = float(SHARE_OF_FORCE * rms_force / size)
    return values, sizes


def _linear_force(
    model: ChainModel, site: Site, motions: Sequence[Motion]
) -> np.ndarray:
    """Force of spring and dashpot at a site along motions; zero on a single DOF."""
    k = 0.0
    c = 0.0
    if site.kind == "link":
        linear = model.restoring_forces[site].linear_part()
        k = linear["k"]
        c = linear["c"]
    return np.concatenate([k * motion.s + c * motion.v for motion in motions])


def _windows(shot: Shot, run: Segment, has_memory: bool) -> list[Shot]:
    """Parts of a shot, each from the state of a run; one if a law has memory."""
    n_windows = 1
    if not has_memory:
        n_windows = shot.n_samples // SETTINGS.min_window
        n_windows = int(np.clip(n_windows, 1, SETTINGS.max_windows))
    edges = np.linspace(0, shot.n_samples, n_windows + 1).astype(int).tolist()

    windows = []
    first = shot.segment.valid.start
    for low, high in pairwise(edges):
        rows = slice(first + low, first + high)
        window = replace(
            shot,
            segment=replace(shot.segment, valid=rows),
            start=first_state(run, rows.start),
            measured=shot.measured[low:high],
            weights=shot.weights[low:high],
        )
        windows.append(window)
    return windows
