r"""The free run of a model fitted to measured channels: least squares of masses,
coefficients and shape parameters.

Maximum likelihood with noise in motion and force, :math:`\sum_f J^*(f) S^{-1}(f) R(f;
\theta) = 0` (Pintelon and Schoukens, System identification, 2012), with R and S of
:mod:`.noise_spectra` and sensitivities J by differences of runs. Every record is a
shot, long records are several; the effect of an error in its initial state is projected
out. With all floors measured (``estimation="simulation"``) it starts from instrumental
variables and is kept only if it predicts unseen parts of the records, both halves of
them, better. With fewer sensors: :mod:`.fewer_sensors`.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from ..chain.layout import LawLayout, with_coefficients
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..equations.errors import free_run_of
from ..exceptions import BiasWarning, IdentifiabilityError, NRFError, SimulationError
from ..laws.shape import Shape
from ..records.dataset import Dataset, Segment
from ..simulation.api import classical_run, linear_run, simulate
from .instrumental_variables import (
    IVResult,
    fits_one_step,
    instrumental_variables,
    spread_out,
    with_shapes,
)
from .intervals import InfluenceResolver, Resolver
from .noise_spectra import (
    NoiseModel,
    common_band,
    corrected,
    noise_model,
    spectrum,
    velocities,
)
from .problem import Estimate, Problem

SHOT = 32768  # largest number of samples of a shot
STEPS, FEW = 6, 2  # largest number of iterations: on all data, on each half
UP, DOWN = (
    3.0,
    10.0,
    # damping after a step that fails, and over that after one that holds (Transtrum and
    # Sethna 2012)
)
SETTLED = 0.05  # standard errors: the estimate has converged when a step is shorter
# of errors on unseen parts after and before; a smaller reduction may be chance
LARGEST_RATIO = 0.85
PIECES = 64
FEWEST_ROWS = 64  # of a part of a shot; shorter ones are left out
FORCE_HOLDS = ("cubic", "linear", "zero")  # of the force between its samples
DIFFERENCE = 1e-6  # of parameters, for sensitivities
# directions of the initial state that move the channels less, as a share, stay as they
# are
RANK = 3e-5
LONGEST = 2.0  # change of a logarithm in a step
# of a step, as a share of the squared sensitivities, above which no step is better
MOST_DAMPING = 1e9


def lengths(columns: np.ndarray) -> np.ndarray:
    """Length of each column, 1 of one of zeros."""
    size = np.linalg.norm(columns, axis=0)
    return np.where(size == 0, 1.0, size)


@dataclass
class Shot:
    """A record, or a part of one (``number`` of the record): what drives it, its first
    state, what was measured.
    """

    segment: Segment
    number: int
    start: np.ndarray  # (2, n_dof); displacements and velocities relative to the base
    channels: tuple[str, ...]  # a1: absolute; v1, x1: relative to the base
    measured: np.ndarray  # (n_samples, n_channels)
    weights: (
        np.ndarray
    )  # of the rows, (n_samples, 1); a fit does not read those of weight zero
    hold: str = FORCE_HOLDS[0]

    @property
    def n_samples(self) -> int:
        """Valid rows."""
        return self.segment.n_valid

    def motion(
        self,
        model: ChainModel,
        start: np.ndarray | None = None,
        forces: Segment | None = None,
    ) -> dict[str, np.ndarray]:
        """Motion of all DOFs, shape (n_samples, n_dof) by kind: a (absolute), v and x
        (relative to the base).
        """
        seg, state = forces or self.segment, self.start if start is None else start
        if (matrices := linear_matrices(model)) is not None:
            rows, ag = seg.valid, None if seg.ag is None else seg.ag[seg.valid]
            if (
                found := linear_run(
                    matrices, seg.F[rows], seg.step, state, ag, self.hold
                )
            ) is not None:
                return dict(zip("xva", found))
        integrator = classical_run if fits_one_step(model, seg.step) else simulate
        run = free_run_of(
            model,
            seg,
            start=tuple(state),
            integrator=integrator,
            rtol=1e-9,
            hold=self.hold,
        )
        return {
            kind: np.asarray(y)
            for kind, y in zip(
                "xva", (run.displacement, run.velocity, run.acceleration)
            )
        }

    def read(
        self,
        model: ChainModel,
        start: np.ndarray | None = None,
        forces: Segment | None = None,
    ) -> np.ndarray:
        """What the sensors would read, shape of ``measured``."""
        return self.of(self.motion(model, start, forces))

    def of(self, motion: Mapping[str, np.ndarray]) -> np.ndarray:
        """The channels of a motion."""
        return np.column_stack([motion[c[0]][:, int(c[1:]) - 1] for c in self.channels])

    def run(self, model: ChainModel) -> Segment:
        """Free run as a segment."""
        return placed(self.segment, self.motion(model))


def placed(segment: Segment, motion: Mapping[str, np.ndarray]) -> Segment:
    """A segment with the motion of a run in its valid rows."""
    v, s = (
        spread_out(segment, np.diff(motion[kind], axis=1, prepend=0.0)) for kind in "vx"
    )
    return replace(segment, a=spread_out(segment, motion["a"]), v=v, s=s)


def linear_matrices(
    model: ChainModel,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Mass, damping and stiffness matrix if all laws are springs and dampers in links;
    None otherwise.
    """
    n, kinds = model.n_dof, {"v": 0, "s": 1}
    found = np.zeros((2, n, n))
    for site, held in model.laws.items():
        terms = [
            (kinds.get(term.label), c)
            for law in held
            for term, c in zip(law.terms(), law.values)
        ]
        if any(kind is None for kind, _ in terms) or (terms and site.kind != "link"):
            return None
        at = [site.p - 1, site.q - 1] if site.q else [site.p - 1]
        ends = np.ix_(at, at)
        for kind, c in terms:
            found[kind][ends] += (
                c * np.array([[1.0, -1.0], [-1.0, 1.0]])[: len(at), : len(at)]
            )
    return (np.diag(model.masses), *found) if (model.masses > 0).all() else None


@dataclass
class Rebuild:
    """Builds a ChainModel from free parameters: DOFs (from 0) with a free mass, site
    and term, site, law and shape.
    """

    model: ChainModel
    places: list[tuple]
    scale: np.ndarray  # parameters are values over these; 0: their logarithms
    start: np.ndarray  # the parameters of the model

    def numbers(self, u: np.ndarray) -> np.ndarray:
        """The parameters of a vector, in their units."""
        log = self.scale == 0
        return np.where(
            log, np.exp(np.where(log, np.minimum(u, 700.0), 0.0)), u * self.scale
        )

    def __call__(self, u: np.ndarray) -> ChainModel:
        """Model of a vector."""
        numbers = self.numbers(u)
        model, masses, values = (
            self.model,
            self.model.masses.copy(),
            self.model.coefficients,
        )
        laws = {site: list(held) for site, held in model.laws.items()}
        for place, number in zip(self.places, numbers.tolist()):
            if len(place) == 1:
                masses[place[0]] = number
            elif len(place) == 2:
                values[place[0]][place[1]] = number
            else:
                site, i, shape = place
                laws[site][i] = laws[site][i].with_values(shape={shape.name: number})
        return ChainModel(
            masses,
            with_coefficients(laws, values),
            model.chain,
            model.visited,
            model.info,
        )


def free_parameters(
    model: ChainModel,
    known: Mapping[int, float],
    sizes: Mapping[tuple, float] | None = None,
    shapes: Sequence[tuple[Site, int, Shape]] = (),
) -> Rebuild:
    """Free parameters of a model; zero terms stay zero unless the size of a step of
    each is given.
    """
    found: list[tuple] = [
        ((j,), m, 0.0) for j, m in enumerate(model.masses) if j + 1 not in known
    ]
    for site, values in model.coefficients.items():
        every = [
            (k, value, max(abs(value), (sizes or {}).get((site, k), 0.0)))
            for k, value in enumerate(values)
        ]
        found += [((site, k), value, size) for k, value, size in every if size]
    for site, i, p in shapes:
        now = model.laws[site][i].shape[p.name]
        found.append(((site, i, p), now, 0.0 if p.log else abs(now or 1.0)))
    start = [value / scale if scale else np.log(value) for _, value, scale in found]
    return Rebuild(
        model,
        [place for place, *_ in found],
        np.array([one[2] for one in found]),
        np.array(start),
    )


@dataclass
class Evaluation:
    """Whitened residuals and sensitivities at some parameters, initial states projected
    out, as triangular factors.
    """

    residuals: np.ndarray
    jacobian: np.ndarray
    scores: np.ndarray  # of each comb of lines, (n_pieces, n_parameters)
    record: np.ndarray
    states: list[
        np.ndarray
    ]  # by shot: best change of its initial state and what each parameter takes off it


@dataclass
class Solution:
    """Estimate, influence of each piece of the data (comb of Fourier lines) on it, and
    the record of each piece.
    """

    u: np.ndarray
    model: ChainModel
    influences: np.ndarray  # (n_pieces, n_parameters)
    record: np.ndarray  # (n_pieces,)
    cost: float  # squared whitened residuals
    jacobian: np.ndarray


class FreeRunFit:
    """The shots, their noise, and least squares on them."""

    def __init__(
        self,
        rebuild: Rebuild,
        shots: Sequence[Shot],
        layout: LawLayout,
        band: Any = None,
        prior: Any = None,
    ) -> None:
        self.rebuild, self.shots, self.layout = rebuild, list(shots), layout
        self.low, self.high = self.limits = common_band(
            [s.segment for s in shots], band
        )
        self.noise: NoiseModel | None = None
        empty = np.empty((0, len(rebuild.start))), np.empty(0)
        self.prior: tuple[np.ndarray, np.ndarray] = (
            prior or empty
        )  # equations of the parameters, over their spread
        self.unit = 1.0  # residual that counts as one standard deviation
        self.better: list[Segment | None] = [None] * len(self.shots)
        every = (
            np.concatenate([s.measured * s.weights for s in self.shots])
            if self.shots
            else np.ones((1, 1))
        )
        self.level = np.sqrt(np.mean(every**2, axis=0))
        self.level[self.level == 0] = 1.0

    def learn_noise(self, model: ChainModel, channels: tuple[str, ...] = ()) -> bool:
        """Noise from the gaps of free runs, and the forces corrected by the motion;
        False if there are no gaps.
        """
        runs = [shot.run(model) for shot in self.shots]
        gaps = [s.measured - s.read(model) for s in self.shots]
        layout = LawLayout(model.chain, model.laws)
        noise = noise_model(
            model, layout, [s.segment for s in self.shots], runs, gaps, channels
        )
        if noise is None:
            return False
        self.noise = noise
        self.low, self.high = (
            max(self.limits[0], noise.signal_band[0]),
            min(self.limits[1], noise.signal_band[1]),
        )
        self.better = [
            corrected(s.segment, gap, noise) for s, gap in zip(self.shots, gaps)
        ]
        return True

    def choose_hold(self, model: ChainModel) -> None:
        """Take the course of the force between samples that predicts the motion
        best.
        """
        costs = {}
        for hold in FORCE_HOLDS:
            for shot in self.shots:
                shot.hold = hold
            costs[hold] = self.judge(model, self.whole)[1]
        for shot in self.shots:
            shot.hold = min(costs, key=costs.__getitem__)

    @property
    def whole(self) -> list[slice]:
        """All rows of every shot."""
        return [slice(0, s.n_samples) for s in self.shots]

    def solve(
        self,
        u: np.ndarray,
        rows: Sequence[slice] | None = None,
        steps: int = STEPS,
        move: bool = False,
        settled: float = SETTLED,
    ) -> Solution:
        """Estimate from some rows of every shot; ``move``: initial states are
        estimated, too (Levenberg, Marquardt).
        """
        self.unit = 1.0 if self.noise else 0.0
        now, damping = self.evaluate(u, rows), 1e-4
        if (
            len(self.prior[1]) and not self.noise
        ):  # noise is not known: what the first run misses
            self.unit = max(
                float(np.linalg.norm(now.residuals)) / np.sqrt(self.lines), 1e-12
            )
            now = self.evaluate(u, rows)
        for _ in range(steps):
            J, r, size = now.jacobian, now.residuals, lengths(now.jacobian)
            starts, spread = (
                [shot.start for shot in self.shots],
                np.sqrt(max(r @ r / self.lines, 1e-300)),
            )
            whole = (
                np.linalg.lstsq(J / size, r, rcond=None)[0] / size
            )  # a damped step may be short far from the end
            while damping < MOST_DAMPING:
                wide = np.vstack([J / size, np.sqrt(damping) * np.eye(len(u))])
                step = (
                    np.linalg.lstsq(
                        wide, np.concatenate([r, np.zeros(len(u))]), rcond=None
                    )[0]
                    / size
                )
                if move:
                    for shot, state in zip(self.shots, now.states):
                        shot.start = shot.start + (
                            state[:, -1] + state[:, :-1] @ step
                        ).reshape(2, -1)
                far = np.abs(step[self.rebuild.scale == 0]).max(initial=0.0) > LONGEST
                try:
                    new = (
                        None
                        if far
                        else self.evaluate(
                            u + step, rows, now.residuals @ now.residuals
                        )
                    )
                except NRFError:  # the run diverges, or a shape has no such value
                    new = None
                if new is not None:
                    break
                for shot, start in zip(self.shots, starts):
                    shot.start = start
                damping = max(UP * damping, 1e-6)
            else:
                break
            u, now, damping = u + step, new, damping / DOWN
            if np.linalg.norm(J @ whole) < settled * min(
                spread, 1.0 if self.noise else np.inf
            ):
                break
        size = lengths(now.jacobian)
        half = np.linalg.pinv(now.jacobian / size, rcond=1e-12) / size[:, None]
        cost, of_prior = (
            now.residuals @ now.residuals,
            (self.prior_rows(u)[:, -1] ** 2).sum(),
        )
        if (
            not self.noise and of_prior
        ):  # the likelihood, largest over the level of the noise
            cost = (cost - of_prior) * np.exp(
                min(of_prior / self.unit**2 / self.lines, 700.0)
            )
        return Solution(
            u,
            self.rebuild(u),
            now.scores @ half @ half.T,
            now.record,
            float(cost),
            now.jacobian,
        )

    def evaluate(
        self, u: np.ndarray, rows: Sequence[slice] | None = None, below: float = np.inf
    ) -> Any:
        """Residuals and sensitivities of every shot; None if their cost is not below a
        limit.
        """
        rows, p = rows or self.whole, len(u)
        total = self.lines = sum(r.stop - r.start for r in rows)
        model = self.rebuild(u)
        used = [
            (shot, better, part, shot.read(model))
            for shot, better, part in zip(self.shots, self.better, rows)
            if part.stop - part.start >= FEWEST_ROWS
        ]
        moved = [self.rebuild(u + DIFFERENCE * e) for e in np.eye(p)]
        factors, scores, record, states = [], [np.empty((0, p))], [], []
        if np.isfinite(below):
            gaps = [
                ((shot.measured - base) * shot.weights)[part, :, None]
                for shot, _, part, base in used
            ]
            cost = sum(
                (self.whitened(gap, one[0].segment.step) ** 2).sum()
                for one, gap in zip(used, gaps)
            )
            cost += (self.prior_rows(u)[:, -1] ** 2).sum()
            if not cost < below:
                return None
        for shot, better, part, base in used:
            from_ = base if better is None else shot.read(model, forces=better)
            columns = [
                (shot.read(m, forces=better) - from_) / DIFFERENCE for m in moved
            ]
            decays = self.decays(shot, model, from_, better)
            every = (
                np.stack([*decays, *columns, shot.measured - base], axis=2)
                * shot.weights[:, :, None]
            )
            every = self.whitened(every[part], shot.segment.step)
            flat, k = every.reshape(-1, every.shape[2]), len(decays)
            free, rest = flat[:, :k], flat[:, k:]
            length = lengths(free)
            taken = np.linalg.lstsq(free / length, rest, rcond=RANK)[0]
            rest = rest - free / length @ taken
            state = taken / length[:, None] * self.state_sizes[:, None]
            states.append(np.column_stack([-state[:, :-1], state[:, -1]]))
            factor = np.linalg.qr(rest, mode="r")
            factors.append(np.pad(factor, ((0, p + 1 - len(factor)), (0, 0))))
            pieces = max(2, round(PIECES * (part.stop - part.start) / total))
            scores.append(_scores(rest.reshape(*every.shape[:2], p + 1), pieces))
            record += [shot.number] * pieces
        for row in (
            rows_of := self.prior_rows(u)
        ):  # an error of one standard deviation, in pieces as of the data
            scores.append(
                self.unit
                * np.resize([1.0, -1.0], PIECES)[:, None]
                * row[:-1]
                / np.sqrt(PIECES)
            )
            record += [1 + max(record)] * PIECES
        stacked = np.concatenate([*factors, rows_of])
        return Evaluation(
            stacked[:, -1],
            stacked[:, :-1],
            np.concatenate(scores),
            np.array(record, dtype=int),
            states,
        )

    def prior_rows(self, u: np.ndarray) -> np.ndarray:
        """Sensitivities and residuals of the equations of prior knowledge,
        (n_equations, n_parameters + 1).
        """
        (A, b), now = self.prior, self.rebuild.numbers(u)
        slope = np.where(self.rebuild.scale == 0, now, self.rebuild.scale)
        return self.unit * np.column_stack([A * slope, b - A @ now])

    def decays(
        self, shot: Shot, model: ChainModel, base: np.ndarray, forces: Segment | None
    ) -> list[np.ndarray]:
        """Changes of the channels with each displacement and velocity of the initial
        state.
        """
        motion = shot.motion(model, forces=forces)
        sizes = [float(np.sqrt(np.mean(motion[kind] ** 2))) or 1.0 for kind in "xv"]
        self.state_sizes = np.repeat(sizes, model.n_dof)
        out = []
        for place, size in enumerate(self.state_sizes):
            state = shot.start.copy()
            state.flat[place] += DIFFERENCE * size
            out.append((shot.read(model, state, forces) - base) / DIFFERENCE)
        return out

    def whitened(self, columns: np.ndarray, dt: float) -> np.ndarray:
        """Spectra of (n_rows, n_channels, k) columns in the band over the root of S;
        real, imaginary parts as rows.
        """
        f = np.fft.rfftfreq(len(columns), dt)[1:]
        use = (f >= self.low) & (f <= self.high)
        lines = _lines(columns, dt)[use]
        if self.noise is None:
            lines /= self.level[:, None] * np.sqrt(dt)
        else:
            for rows, _, S in self.noise.blocks(f[use]):
                scale = np.sqrt(np.einsum("ijj->ij", S).real)[:, :, None]
                root = np.linalg.cholesky(S / scale / scale.transpose(0, 2, 1))
                lines[rows] = np.linalg.solve(root, lines[rows] / scale)
        return np.sqrt(2.0) * np.concatenate([lines.real, lines.imag], axis=1)

    def judge(self, model: ChainModel, rows: Sequence[slice]) -> np.ndarray:
        """Squared free-run errors in some rows (plain, weighted) and squared motion;
        initial states are refitted.
        """
        out = np.zeros(3)
        for shot, part in zip(self.shots, rows):
            if part.stop - part.start < FEWEST_ROWS:
                continue
            base = shot.read(model)
            C = np.stack(self.decays(shot, model, base, None), axis=2)[part]
            gap = (shot.measured - base)[part]
            flat = C.reshape(-1, C.shape[2])
            size = lengths(flat)
            gap = (
                gap
                - (C / size) @ np.linalg.lstsq(flat / size, gap.ravel(), rcond=RANK)[0]
            )
            dt, motion = shot.segment.step, shot.measured[part]
            f = np.fft.rfftfreq(len(gap), dt)[1:]
            use = (f >= self.low) & (f <= self.high)
            R, V = (_lines(y[:, :, None], dt)[use, :, 0] for y in (gap, motion))
            scale = np.mean(shot.measured**2, axis=0)
            scale[scale == 0] = 1.0
            weighted = (self.whitened(gap[:, :, None], dt) ** 2).sum() / 2
            out += [
                (np.abs(R) ** 2 / scale).sum(),
                weighted,
                (np.abs(V) ** 2 / scale).sum(),
            ]
        return out


def _lines(values: np.ndarray, dt: float) -> np.ndarray:
    """Spectra of columns of shape (n_rows, n_channels, k), a line a row."""
    n, d, k = values.shape
    return spectrum(values.reshape(n, d * k), dt).reshape(-1, d, k)


def _scores(columns: np.ndarray, pieces: int) -> np.ndarray:
    """Contribution of each comb of whitened lines to the gradient, shape (n_pieces,
    n_parameters).
    """
    # lines are independent except for their neighbours, and every comb contains every
    # resonance; pieces of time are correlated for as long as the structure rings
    products = np.einsum("fd,fdp->fp", columns[:, :, -1], columns[:, :, :-1])
    return np.array([products[k::pieces].sum(axis=0) for k in range(pieces)])


@dataclass
class OutputErrorResult:
    """Result of the refinement."""

    found: (
        Solution | None
        # None if the refined model does not predict unseen parts better than the
        # initial one
    )
    rebuild: Rebuild | None = None
    # free-run error of the velocities on parts that the refinement did not see, percent
    # NRMSE
    error_before: float = np.nan
    error_after: float = np.nan
    why: str = ""  # reason if it was not kept


def output_error(
    start: ChainModel,
    data: Dataset,
    layout: LawLayout,
    known_masses: Mapping[int, float],
    band: Any = None,
    halves: Sequence[ChainModel] | None = None,
) -> OutputErrorResult:
    """Refine masses and coefficients on the free run."""
    shots = shots_of(data, layout.has_memory)
    if not shots:
        return _kept_start("the force on some DOF is unknown in every record")
    if max(shot.n_samples for shot in shots) < 2 * FEWEST_ROWS:
        return _kept_start("the records are too short")
    rebuild = free_parameters(start, known_masses)
    problem = FreeRunFit(rebuild, shots, layout, band)
    resolved = [s.segment.resolved for s in shots if s.segment.resolved is not None]
    problem.limits = problem.limits[0], min([problem.limits[1], *resolved])
    try:
        if not problem.learn_noise(start):
            return OutputErrorResult(
                None, None, 0.0, 0.0, why="the free run is exact to round-off"
            )
        problem.choose_hold(start)
        parts = [_half(shots, 0), _half(shots, 1)]
        swapped = list(zip(halves or (start, start), parts, parts[::-1]))
        before = np.array(
            [problem.judge(rival, unseen) for rival, _, unseen in swapped]
        )
        after = np.array(
            [
                problem.judge(problem.solve(rebuild.start, seen, FEW).model, unseen)
                for _, seen, unseen in swapped
            ]
        )
        error_before, error_after = (
            float(100 * np.sqrt(e[0] / e[2])) for e in (before.sum(0), after.sum(0))
        )
        if not clearly_better(before, after):
            why = (
                "the refinement does not predict unseen parts of the records clearly"
                " better"
            )
            return OutputErrorResult(None, None, error_before, error_after, why=why)
        best = problem.solve(rebuild.start)
    except SimulationError as error:
        return _kept_start(error.what)
    return OutputErrorResult(best, rebuild, error_before, error_after)


def clearly_better(before: np.ndarray, after: np.ndarray) -> bool:
    """True if both unseen halves are predicted better; rows: squared errors (free run,
    weighted, motion).
    """
    every = (after[:, 0] < before[:, 0]).all() and after[:, 1].sum() < before[
        :, 1
    ].sum()
    return bool(
        every and np.sqrt(after[:, 0].sum() / before[:, 0].sum()) <= LARGEST_RATIO
    )


def _kept_start(why: str) -> OutputErrorResult:
    """The estimate of instrumental variables, with a warning that gives the reason."""
    warnings.warn(
        f"estimation='simulation' kept the instrumental-variable estimate: {why}.",
        BiasWarning,
        stacklevel=6,
    )
    return OutputErrorResult(None, why=why)


def shots_of(data: Dataset, has_memory: bool) -> list[Shot]:
    """Records whose forces are all known; long ones are cut unless a law has memory."""
    out = []
    for number, seg in enumerate(data.segments):
        if np.isnan(seg.F[seg.valid.start]).any():
            continue
        n, names = seg.n_valid, tuple(f"v{j}" for j in range(1, seg.n_dof + 1))
        edges = np.linspace(
            0, n, 1 if has_memory else -(-n // SHOT), endpoint=False
        ).astype(int).tolist() + [n]
        for lo, hi in zip(edges[:-1], edges[1:]):
            rows = slice(seg.valid.start + lo, seg.valid.start + hi)
            state = np.array(
                [np.cumsum(y[rows.start].astype(float)) for y in (seg.s, seg.v)]
            )
            part = replace(seg, valid=rows)
            out.append(
                Shot(
                    part, number, state, names, velocities(part), np.ones((hi - lo, 1))
                )
            )
    return out


def _half(shots: Sequence[Shot], which: int) -> list[slice]:
    """The first or second half of every record, which may be several shots."""
    total = {
        number: sum(s.n_samples for s in shots if s.number == number)
        for number in {s.number for s in shots}
    }
    at, out = dict.fromkeys(total, 0), []
    for shot in shots:
        middle = min(max(total[shot.number] // 2 - at[shot.number], 0), shot.n_samples)
        out.append(slice(0, middle) if which == 0 else slice(middle, shot.n_samples))
        at[shot.number] += shot.n_samples
    return out


_NEGLIGIBLE = 0.2  # change of a mass in the last round, in standard errors


def refine(
    method: str, asked: Problem, start: Estimate, data: Dataset
) -> tuple[Estimate, Resolver | None, dict[str, Any], Dataset]:
    """Estimate by instrumental variables (and output error), its resolver, facts, and
    data to judge it on.
    """
    facts: dict[str, Any] = {"asked": method, "found": "ls"}
    problem, solve_order = start.problem, start.order
    known, inner = dict(problem.known_masses), problem.optimizer
    iv = instrumental_variables(start.model, data, problem, solve_order)
    if iv is None:
        return start, None, facts, data
    problem, iv = with_shapes(asked, problem, solve_order, data, iv)
    facts |= {
        "found": "iv",
        "rounds": iv.rounds,
        "correlation": iv.correlation,
        "notes": list(iv.notes),
    }
    resolver = Resolver(iv.pieces, solve_order, known, inner)
    if note := _convergence_note(iv, resolver):
        facts["notes"] = [*facts["notes"], note]
        warnings.warn(note, BiasWarning, stacklevel=4)
    model = iv.model
    if method == "simulation":
        result = output_error(
            model, data, problem.layout, known, problem.band, _halves(resolver)
        )
        for key in ("error_before", "error_after"):
            error = float(getattr(result, key))
            facts[f"free_run_{key}"] = error if np.isfinite(error) else None
        if best := result.found:
            model, facts["found"] = best.model, "simulation"
            assert result.rebuild is not None
            resolver = InfluenceResolver(
                iv.pieces, solve_order, known, inner, best=best, rebuild=result.rebuild
            )
        else:
            facts["notes"] = [
                *facts["notes"],
                f"instrumental variables kept: {result.why}",
            ]
    return (
        start._replace(problem=problem, model=model, solution=iv.solution),
        resolver,
        facts,
        iv.judged(data),
    )


def _convergence_note(iv: IVResult, resolver: Resolver) -> str:
    """Note on rounds that did not converge; empty if the last change is negligible
    against the standard errors.
    """
    if iv.moved is None:
        return ""
    spread = np.zeros(len(iv.moved))
    try:
        variance = np.diag(resolver.covariance(lambda model: pd.Series(model.masses)))
        spread = np.sqrt(variance) / np.abs(iv.model.masses)
    except NRFError:  # too few pieces to tell
        pass
    j = int(np.argmax(iv.moved - _NEGLIGIBLE * spread))
    if iv.moved[j] <= _NEGLIGIBLE * spread[j]:
        return ""
    beside = f" (standard error {100 * spread[j]:.2g} %)" if spread[j] else ""
    return (
        f"estimation='iv' did not converge in {iv.rounds} rounds: the last one changed"
        f" m{j + 1} by {100 * iv.moved[j]:.2g} %{beside}. Give longer or cleaner"
        " records, or a simpler law."
    )


def _halves(resolver: Resolver) -> list[ChainModel] | None:
    """Models of the first and second half of every record; None if one of them cannot
    be solved.
    """
    record = resolver.record
    place = np.arange(len(record)) - np.searchsorted(record, record)
    first = place < np.bincount(record)[record] // 2
    try:
        return [resolver.at(half.astype(float)) for half in (first, ~first)]
    except IdentifiabilityError:
        return None
