r"""Output-error refinement: the free run itself is fitted to the measured motion.

Maximum likelihood with noise in motion and force, :math:`\sum_f J^*(f) S^{-1}(f) R(f; \theta) = 0` (Pintelon and
Schoukens, System identification, 2012), with R and S of :mod:`.noise_spectra` and sensitivities J from the columns of
the laws along the run, filtered by the structure linearised there. Every record is a shot, long records are several;
the effect of an error in its initial state is projected out. Starts from instrumental variables and is kept only if it
predicts unseen parts of the records, both halves of them, better.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from ..exceptions import BiasWarning, IdentifiabilityError, NRFError, SimulationError
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel, state_matrix
from ..regression.layout import LawLayout, with_coefficients
from ..regression.segments import Segment, SegmentSet
from .intervals import InfluenceResolver, Resolver
from .iv import IVResult, instrumental_variables, run_of, with_shapes
from .noise_spectra import NoiseModel, common_band, corrected, noise_model, spectrum, transfer, velocities
from .problem import Estimate, Problem

SHOT = 32768  # largest number of samples of a shot
STEPS, FEW = 6, 2  # largest number of iterations: on all data, on each half
SETTLED = 0.05  # standard errors: the estimate has converged when a step is shorter
LARGEST_RATIO = 0.85  # of errors on unseen parts after and before; a smaller reduction may be chance
PIECES = 64
FEWEST_ROWS = 64  # of a part of a shot; shorter ones are left out
FORCE_HOLDS = ("cubic", "linear", "zero")  # of the force between its samples


@dataclass
class _Solution:
    """Estimate, influence of each piece of the data (comb of Fourier lines) on it, and the record of each piece."""

    model: ChainModel
    influences: np.ndarray  # (n_pieces, n_parameters)
    record: np.ndarray  # (n_pieces,)


@dataclass
class OutputErrorResult:
    """Result of the refinement."""

    found: _Solution | None  # None if the refined model does not predict unseen parts better than the initial one
    # free-run error of the velocities on parts that the refinement did not see, percent NRMSE
    error_before: float = np.nan
    error_after: float = np.nan
    why: str = ""  # reason if it was not kept


@dataclass
class Shot:
    """A record, or a part of one (``number`` of the record), with the initial state of its free run."""

    segment: Segment
    number: int
    start: np.ndarray
    hold: str = FORCE_HOLDS[0]

    @property
    def n_samples(self) -> int:
        """Valid rows."""
        return self.segment.n_valid

    def run(self, model: ChainModel, segment: Segment | None = None) -> Segment:
        """Free run under the shot's forces, or under those of another segment."""
        return run_of(model, segment or self.segment, start=tuple(self.start), hold=self.hold)


def output_error(
    start: ChainModel, data: SegmentSet, layout: LawLayout, known_masses: Mapping[int, float], band: Any = None,
    halves: Sequence[ChainModel] | None = None,
) -> OutputErrorResult:  # fmt: skip
    """Refine masses and coefficients on the free run."""
    shots = shots_of(data, layout.has_memory)
    if not shots:
        return _kept_start("the force on some DOF is unknown in every record")
    if max(shot.n_samples for shot in shots) < 2 * FEWEST_ROWS:
        return _kept_start("the records are too short")
    try:
        noise = noise_model(start, layout, [s.segment for s in shots], [s.run(start) for s in shots])
        if noise is None:
            return OutputErrorResult(None, 0.0, 0.0, why="the free run is exact to round-off")
        problem = _FreeRunFit(start, shots, layout, known_masses, noise, band)
        parts = [_half(shots, 0), _half(shots, 1)]
        swapped = list(zip(halves or (start, start), parts, parts[::-1]))
        before = np.array([problem.judge(rival, unseen) for rival, _, unseen in swapped])
        after = np.array([problem.judge(problem.solve(seen, FEW).model, unseen) for _, seen, unseen in swapped])
        error_before, error_after = (float(100 * np.sqrt(e[0] / e[2])) for e in (before.sum(0), after.sum(0)))
        if not clearly_better(before, after):
            why = "the refinement does not predict unseen parts of the records clearly better"
            return OutputErrorResult(None, error_before, error_after, why=why)
        best = problem.solve([slice(0, s.n_samples) for s in shots])
    except SimulationError as error:
        return _kept_start(error.what)
    return OutputErrorResult(best, error_before, error_after)


def clearly_better(before: np.ndarray, after: np.ndarray) -> bool:
    """True if both unseen halves are predicted better; rows: squared errors (free run, weighted, motion)."""
    every = (after[:, 0] < before[:, 0]).all() and after[:, 1].sum() < before[:, 1].sum()
    return bool(every and np.sqrt(after[:, 0].sum() / before[:, 0].sum()) <= LARGEST_RATIO)


def _kept_start(why: str) -> OutputErrorResult:
    """The estimate of instrumental variables, with a warning that gives the reason."""
    warnings.warn(f"estimation='simulation' kept the instrumental-variable estimate: {why}.", BiasWarning, stacklevel=6)
    return OutputErrorResult(None, why=why)


def shots_of(data: SegmentSet, has_memory: bool) -> list[Shot]:
    """Records whose forces are all known; long ones are cut unless a law has memory."""
    out = []
    for number, seg in enumerate(data.segments):
        if np.isnan(seg.F[seg.valid.start]).any():
            continue
        n = seg.n_valid
        edges = np.linspace(0, n, 1 if has_memory else -(-n // SHOT), endpoint=False).astype(int).tolist() + [n]
        for lo, hi in zip(edges[:-1], edges[1:]):
            rows = slice(seg.valid.start + lo, seg.valid.start + hi)
            state = np.array([np.cumsum(y[rows.start].astype(float)) for y in (seg.s, seg.v)])
            out.append(Shot(replace(seg, valid=rows), number, state))
    return out


def _half(shots: Sequence[Shot], which: int) -> list[slice]:
    """The first or second half of every record, which may be several shots."""
    total = {s.number: 0 for s in shots}
    for shot in shots:
        total[shot.number] += shot.n_samples
    at, out = dict.fromkeys(total, 0), []
    for shot in shots:
        middle = min(max(total[shot.number] // 2 - at[shot.number], 0), shot.n_samples)
        out.append(slice(0, middle) if which == 0 else slice(middle, shot.n_samples))
        at[shot.number] += shot.n_samples
    return out


@dataclass
class _Evaluation:
    """Whitened residuals and sensitivities at some parameters, compressed to triangular factors; scores of pieces."""

    residuals: np.ndarray
    jacobian: np.ndarray
    scores: np.ndarray
    record: np.ndarray


class _FreeRunFit:
    """The shots, their noise, and least squares on them."""

    def __init__(
        self, start: ChainModel, shots: Sequence[Shot], layout: LawLayout, known_masses: Mapping[int, float],
        noise: NoiseModel, band: Any,
    ) -> None:  # fmt: skip
        self.start, self.shots, self.layout, self.noise = start, shots, layout, noise
        self.theta, self.rebuild, self.columns = free_parameters(start, known_masses)
        self._decays: dict[tuple[int, float], np.ndarray] = {}
        low, high = common_band([s.segment for s in shots], band)
        resolved = [s.segment.resolved for s in shots if s.segment.resolved is not None]
        self.low, self.high = max(low, noise.signal_band[0]), min([noise.signal_band[1], high, *resolved])
        # the hold of the force between samples that predicts the motion best
        whole, costs = [slice(0, s.n_samples) for s in shots], {}
        for hold in FORCE_HOLDS:
            for shot in shots:
                shot.hold = hold
            costs[hold] = self.judge(start, whole)[1]
        for shot in shots:
            shot.hold = min(costs, key=costs.__getitem__)
        runs = [shot.run(start) for shot in shots]
        # the corrected force comes from the initial model and does not change in the iterations
        self.better = [corrected(shot.segment, run, noise) for shot, run in zip(shots, runs)]

    def solve(self, rows: Sequence[slice], steps: int = STEPS) -> _Solution:
        """Estimate from some rows of every shot."""
        first = self.evaluate(self.theta, rows)
        size = np.linalg.norm(first.jacobian, axis=0)  # parameters times this are in standard errors
        start = self.theta * size
        seen = {start.tobytes(): first}

        def residuals(scaled: np.ndarray) -> np.ndarray:
            """Whitened residuals; infinite where the free run diverges, which least_squares steps back from."""
            if scaled.tobytes() not in seen:
                try:
                    seen[scaled.tobytes()] = self.evaluate(scaled / size, rows)
                except SimulationError:
                    return np.full_like(first.residuals, np.inf)
            return seen[scaled.tobytes()].residuals

        found = least_squares(
            residuals, start, lambda scaled: seen[scaled.tobytes()].jacobian / size, method="trf",
            xtol=SETTLED / np.linalg.norm(start), ftol=None, gtol=None, max_nfev=steps + 1,
        )  # fmt: skip
        last = seen[found.x.tobytes()]
        inverse = np.linalg.pinv(found.jac.T @ found.jac, rcond=1e-12, hermitian=True) / size
        return _Solution(self.rebuild(found.x / size), -(last.scores / size) @ inverse, last.record)

    def evaluate(self, theta: np.ndarray, rows: Sequence[slice]) -> _Evaluation:
        """Residuals and sensitivities of every shot, with the effect of its initial condition projected out."""
        model, p = self.rebuild(theta), len(theta)
        total = sum(r.stop - r.start for r in rows)
        factors, scores, record = [], [np.empty((0, p))], []
        for shot, better, part in zip(self.shots, self.better, rows):
            if part.stop - part.start < FEWEST_ROWS:
                continue
            gap = velocities(shot.segment) - velocities(shot.run(model))
            moved = self.sensitivities(model, shot, shot.run(model, better))
            columns = self.whitened(np.dstack([self.decays(shot), -moved, gap])[part], shot.segment.step)
            decays, rest = np.split(columns.reshape(-1, columns.shape[2]), [columns.shape[2] - p - 1], axis=1)
            length = np.linalg.norm(decays, axis=0)
            decays /= np.where(length > 0, length, 1.0)
            rest = rest - decays @ np.linalg.lstsq(decays, rest, rcond=3e-5)[0]
            factor = np.linalg.qr(rest, mode="r")
            factors.append(np.pad(factor, ((0, p + 1 - len(factor)), (0, 0))))
            pieces = max(2, round(PIECES * (part.stop - part.start) / total))
            scores.append(_scores(rest.reshape(*columns.shape[:2], p + 1), pieces))
            record += [shot.number] * pieces
        stacked = np.concatenate(factors)
        return _Evaluation(stacked[:, -1], stacked[:, :-1], np.concatenate(scores), np.array(record, dtype=int))

    def whitened(self, columns: np.ndarray, dt: float) -> np.ndarray:
        """Spectra of (n_rows, n_dof, k) columns in the band over the root of S; real and imaginary parts as rows."""
        f = np.fft.rfftfreq(len(columns), dt)[1:]
        use = (f >= self.low) & (f <= self.high)
        lines = _lines(columns, dt)[use]
        for rows, _, S in self.noise.blocks(f[use]):
            scale = np.sqrt(np.einsum("ijj->ij", S).real)[:, :, None]
            root = np.linalg.cholesky(S / scale / scale.transpose(0, 2, 1))
            lines[rows] = np.linalg.solve(root, lines[rows] / scale)
        return np.sqrt(2.0) * np.concatenate([lines.real, lines.imag], axis=1)

    def sensitivities(self, model: ChainModel, shot: Shot, run: Segment) -> np.ndarray:
        """Change of the relative velocities with each parameter, shape (n_rows, n_dof, n_parameters)."""
        rows, n = shot.segment.valid, model.n_dof
        length, dt = rows.stop - rows.start, shot.segment.step
        block = next(iter(replace(run, valid=rows).blocks(self.layout, size=length)))
        f = np.fft.rfftfreq(length, dt)
        G = transfer(self.noise.matrices, np.maximum(f, 0.25 * f[1]))[:, :, :n]
        out = np.empty((length, n, len(self.columns)))
        for k, column in enumerate(self.columns):
            if isinstance(column, int):
                added = np.zeros((n, length))
                added[column] = block.acceleration[column]
            else:
                site, at = column
                signs = np.array([site.incidence(j) for j in range(1, n + 1)], dtype=float)
                added = np.outer(signs, block.terms[self.layout.slices[site].start + at])
            moved = -(G @ np.fft.rfft(added, axis=1).T[:, :, None])[:, :, 0]
            out[:, :, k] = np.fft.irfft(moved, length, axis=0)
        return out

    def decays(self, shot: Shot) -> np.ndarray:
        """Velocities after a unit displacement or velocity of each DOF, shape (n_rows, n_dof, 2 n_dof)."""
        key = (shot.n_samples, shot.segment.step)
        if key not in self._decays:
            n = len(self.noise.matrices[0])
            values, vectors = np.linalg.eig(state_matrix(*self.noise.matrices))
            t = np.arange(shot.n_samples) * shot.segment.step
            growth = np.exp(np.outer(t, np.minimum(values.real, 0) + 1j * values.imag))
            shapes = np.einsum("jm,mk->mjk", vectors[n:], np.linalg.pinv(vectors))
            out = (growth @ shapes.reshape(2 * n, -1)).real
            self._decays = {key: out.reshape(-1, n, 2 * n)}  # shots are of one or two lengths: keep the last
        return self._decays[key]

    def judge(self, model: ChainModel, rows: Sequence[slice]) -> np.ndarray:
        """Squared free-run errors in some rows (plain, weighted) and squared motion; initial states are refitted."""
        out = np.zeros(3)
        for shot, part in zip(self.shots, rows):
            if part.stop - part.start < FEWEST_ROWS:
                continue
            run = shot.run(model)
            v = velocities(shot.segment)
            gap, C = (v - velocities(run))[part], self.decays(shot)[part]
            flat = C.reshape(-1, C.shape[2])
            size = np.linalg.norm(flat, axis=0)
            gap = gap - (C / size) @ np.linalg.lstsq(flat / size, gap.ravel(), rcond=1e-6)[0]
            dt = shot.segment.step
            f = np.fft.rfftfreq(len(gap), dt)[1:]
            use = (f >= self.low) & (f <= self.high)
            R, V = (_lines(y[:, :, None], dt)[use, :, 0] for y in (gap, v[part]))
            scale = np.mean(v**2, axis=0)
            scale[scale == 0] = 1.0
            out += [
                (np.abs(R) ** 2 / scale).sum(),
                (self.whitened(gap[:, :, None], dt) ** 2).sum() / 2,
                (np.abs(V) ** 2 / scale).sum(),
            ]
        return out


def _lines(values: np.ndarray, dt: float) -> np.ndarray:
    """Spectra of columns of shape (n_rows, n_dof, k), a line a row."""
    n, d, k = values.shape
    return spectrum(values.reshape(n, d * k), dt).reshape(-1, d, k)


def _scores(columns: np.ndarray, pieces: int) -> np.ndarray:
    """Contribution of each comb of whitened lines to the gradient, shape (n_pieces, n_parameters)."""
    # lines are independent except for their neighbours, and every comb contains every resonance; pieces of time are
    # correlated for as long as the structure rings
    products = np.einsum("fd,fdp->fp", columns[:, :, -1], columns[:, :, :-1])
    return np.array([products[k::pieces].sum(axis=0) for k in range(pieces)])


@dataclass
class Rebuild:
    """Builds a ChainModel from free parameters: DOFs (from 0) with a free mass, and site and term of each other."""

    model: ChainModel
    free: list[int]
    held: list[tuple[Site, int]]

    def __call__(self, x: np.ndarray) -> ChainModel:
        """Model of a vector."""
        model, masses, values = self.model, self.model.masses.copy(), self.model.coefficients
        masses[self.free] = x[: len(self.free)]
        for (site, k), value in zip(self.held, x[len(self.free) :]):
            values[site][k] = value
        return ChainModel(masses, with_coefficients(model.laws, values), model.chain, model.visited, model.info)


def free_parameters(
    model: ChainModel, known: Mapping[int, float]
) -> tuple[np.ndarray, Rebuild, list[int | tuple[Site, int]]]:
    """Free parameters (zero terms stay zero), their Rebuild, and the DOF (from 0) or site and number of each."""
    free = [j for j in range(model.n_dof) if j + 1 not in known]
    held = [(site, k) for site, values in model.coefficients.items() for k, c in enumerate(values) if c]
    theta = np.array([*model.masses[free], *(model.coefficients[site][k] for site, k in held)])
    return theta, Rebuild(model, free, held), [*free, *held]


_NEGLIGIBLE = 0.2  # change of a mass in the last round, in standard errors


def refine(
    method: str, asked: Problem, start: Estimate, data: SegmentSet
) -> tuple[Estimate, Resolver | None, dict[str, Any], SegmentSet]:
    """Estimate by instrumental variables (and output error), its resolver, facts, and data to judge it on."""
    facts: dict[str, Any] = {"asked": method, "found": "ls"}
    problem, solve_order = start.problem, start.order
    known, inner = dict(problem.known_masses), problem.optimizer
    iv = instrumental_variables(start.model, data, problem, solve_order)
    if iv is None:
        return start, None, facts, data
    problem, iv = with_shapes(asked, problem, solve_order, data, iv)
    facts |= {"found": "iv", "rounds": iv.rounds, "correlation": iv.correlation, "notes": list(iv.notes)}
    resolver = Resolver(iv.pieces, solve_order, known, inner)
    if note := _convergence_note(iv, resolver):
        facts["notes"] = [*facts["notes"], note]
        warnings.warn(note, BiasWarning, stacklevel=4)
    model = iv.model
    if method == "simulation":
        result = output_error(model, data, problem.layout, known, problem.band, _halves(resolver))
        for key in ("error_before", "error_after"):
            error = float(getattr(result, key))
            facts[f"free_run_{key}"] = error if np.isfinite(error) else None
        if best := result.found:
            model, facts["found"] = best.model, "simulation"
            theta, rebuild, _ = free_parameters(model, known)
            resolver = InfluenceResolver(
                iv.pieces, solve_order, known, inner,
                theta=theta, rebuild=rebuild, moves=best.influences, of=best.record,
            )  # fmt: skip
        else:
            facts["notes"] = [*facts["notes"], f"instrumental variables kept: {result.why}"]
    return start._replace(problem=problem, model=model, solution=iv.solution), resolver, facts, iv.judged(data)


def _convergence_note(iv: IVResult, resolver: Resolver) -> str:
    """Note on rounds that did not converge; empty if the last change is negligible against the standard errors."""
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
        f"estimation='iv' did not converge in {iv.rounds} rounds: the last one changed m{j + 1} by "
        f"{100 * iv.moved[j]:.2g} %{beside}. Give longer or cleaner records, or a simpler law."
    )


def _halves(resolver: Resolver) -> list[ChainModel] | None:
    """Models of the first and second half of every record; None if one of them cannot be solved."""
    record = resolver.record
    place = np.arange(len(record)) - np.searchsorted(record, record)
    first = place < np.bincount(record)[record] // 2
    try:
        return [resolver.at(half.astype(float)) for half in (first, ~first)]
    except IdentifiabilityError:
        return None
