"""One step of a solve: least squares on the triangular factor of its columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from ..chain.identifiability import Step
from ..chain.layout import Layout
from ..exceptions import IdentifiabilityError, NRFError
from .inner_optimizer import (
    KeptTerms,
    Optimizer,
    fit_inner,
    require_optimizer,
    survives_compression,
)
from .normal_equations import PerBlock
from .solution import StepFit

# Smallest singular value, as a share of the largest, that counts: round-off of sums of
# products hides what lies below the root of the machine precision.
RANK_CUT = {"gram": 3e-8, "root": 1e-9}
# A rank is in doubt where a bound of the condition comes this near to the cut.
MARGIN_OF_RANK = 10.0
# Length of columns whose squares a double holds with all digits.
SHORTEST_COLUMN = 1e-145
# Part of a column in a combination without influence from which on it is named.
NAMED_PART = 1e-3
MAX_NAMED_COLUMNS = 6

Warned = tuple[tuple[type[Warning], str], ...]


class NotTogether(NRFError):
    """Blocks have to be solved one by one."""

    def __init__(self) -> None:
        what = "These blocks cannot be solved all at once"
        super().__init__(what, "Solve them one by one.")


@dataclass(frozen=True)
class SubProblem:
    """One step as the triangular factor of ``[masses | terms | right-hand side]``.

    Attributes
    ----------
    step : Step
    triangle : ndarray of shape (p + 1, p + 1), or (n_blocks, p + 1, p + 1)
        Upper triangular.
    n_samples : float or ndarray of shape (n_blocks,)
    layout : Layout
    kind : {"gram", "root"}
        What the factor was taken of.
    rows : callable, optional
        Gives the samples of the columns, (n_samples, p + 1), where they can be read
        again.
    """

    step: Step
    triangle: np.ndarray
    n_samples: PerBlock
    layout: Layout
    kind: str
    rows: Callable[[], np.ndarray] | None = None

    def solve(self, inner: Optimizer | None = None) -> tuple[np.ndarray, StepFit]:
        """The unknowns, and how well they are determined."""
        lengths = self._lengths()
        unit = self.triangle / np.where(lengths > 0, lengths, 1.0)
        columns, target = unit[:, :-1], unit[:, -1]
        p = columns.shape[1]

        rank, condition = self._rank(columns)
        if lengths[-1] == 0:
            self._refuse_empty_target(inner)
        fitted: Optimizer | None = None
        warned: Warned = ()
        dependent = ""
        if rank < p:
            dependent = self._dependent_columns(columns, rank)
            cut = RANK_CUT[self.kind]
            scaled = linalg.lstsq(columns, target, cond=cut, check_finite=False)[0]
        elif inner is None:
            scaled = back_substituted(columns[:p], target[:p])
        else:
            scaled, fitted, warned = self._sparse(columns, target, inner)

        share = float(np.linalg.norm(target - columns @ scaled)) if p else 1.0
        noise: tuple[float, ...] = ()
        if rank == p:
            noise = self._mass_noise(columns[:p], scaled, share)
        residual = share * float(lengths[-1]) / (float(self.n_samples) ** 0.5 or 1.0)
        fit = StepFit(
            self.step,
            condition,
            rank,
            p,
            residual,
            share,
            noise,
            fitted,
            warned,
            dependent=dependent,
        )
        return scaled * lengths[-1] / lengths[:-1], fit

    def solve_blocks(
        self, inner: Optimizer | None = None
    ) -> tuple[np.ndarray, StepFit]:
        """The unknowns of all blocks, (n_blocks, p), and how well they are determined.

        Raises NotTogether where columns may depend on each other.
        """
        triangle = self.triangle
        p = triangle.shape[-1] - 1
        lengths = np.linalg.norm(triangle, axis=-2)
        in_range = np.isfinite(lengths) & (lengths >= SHORTEST_COLUMN)
        if inner is not None or not p or not in_range.all():
            raise NotTogether()

        unit = triangle / lengths[..., None, :]
        condition = _bound_of_condition(unit[..., :p, :p])
        doubtful = condition * RANK_CUT[self.kind] * MARGIN_OF_RANK
        if not (doubtful < 1).all():
            raise NotTogether()

        solutions = [back_substituted(upper[:p, :p], upper[:p, p]) for upper in unit]
        scaled = np.array(solutions)
        share = np.abs(unit[..., p, p])
        residual = share * lengths[..., p] / self.n_samples**0.5
        fit = StepFit(self.step, condition, p, p, residual, share)
        return scaled * lengths[..., p:] / lengths[..., :p], fit

    def _labels(self) -> list[str]:
        """The unknowns in words."""
        labels = [f"m{dof}" for dof in self.step.masses]
        for site in self.step.sites:
            labels.extend(f"{site}: {label}" for label in self.layout.labels(site))
        return labels

    def _lengths(self) -> np.ndarray:
        """Lengths of the columns and of the right-hand side; empty ones are refused."""
        lengths = np.linalg.norm(self.triangle, axis=0)
        lost = ~np.isfinite(lengths) | ((lengths > 0) & (lengths < SHORTEST_COLUMN))
        if lost.any():
            name = [*self._labels(), "the force"][int(np.flatnonzero(lost)[0])]
            what = (
                f"{self.step.name}: the squares of {name} leave the range of a double"
            )
            cure = "Check the units of its channels, or lower the degree."
            raise NRFError(what, cure)

        idle = np.flatnonzero(lengths[:-1] == 0)
        if idle.size:
            what = (
                f"{self.step.name}: the column of {self._labels()[idle[0]]} is zero"
                " throughout, or its squares leave the range of a double"
            )
            cure = (
                "Nothing moves there, or its channels have wrong units; check them,"
                " leave the term out, or excite it."
            )
            raise IdentifiabilityError(what, cure)
        return lengths

    def _rank(self, columns: np.ndarray) -> tuple[int, float]:
        """Rank and condition of unit columns."""
        if not columns.shape[1]:
            return 0, 1.0
        values = np.linalg.svd(columns, compute_uv=False)
        rank = int((values > RANK_CUT[self.kind] * values[0]).sum())
        return rank, float(values[0] / values[-1]) if values[-1] > 0 else np.inf

    def _refuse_empty_target(self, inner: Optimizer | None) -> None:
        cure = "No force, known mass or known law scales it."
        if inner is not None and self.step.known_sites:
            cure = (
                f"The optimizer dropped every term of {self.step.known_sites[0]}, which"
                " scales it; lower its threshold."
            )
        what = f"{self.step.name}: the right-hand side is zero throughout"
        raise IdentifiabilityError(what, cure)

    def _dependent_columns(self, columns: np.ndarray, rank: int) -> str:
        """Which columns depend on each other; refused where a mass is among them."""
        labels = self._labels()
        idle = np.linalg.svd(columns)[2][rank:]
        weight = np.sqrt((idle**2).sum(axis=0))
        largest = np.argsort(-weight)[:MAX_NAMED_COLUMNS]
        named = [labels[i] for i in largest if weight[i] > NAMED_PART]
        what = (
            f"{self.step.name}: rank {rank} of {len(labels)}; {', '.join(named)} are"
            " linearly dependent on this excitation"
        )
        if self.step.masses and weight[0] > NAMED_PART:
            raise IdentifiabilityError(
                f"{what}, so {labels[0]} cannot be separated from a stiffness",
                "A steady harmonic excitation or too few samples do this; excite"
                " several frequencies, lower the degree, or give the mass in"
                " known_masses.",
            )
        return (
            f"{what}. Their coefficients are the smallest that fit; excite more"
            " frequencies or amplitudes, or lower the degree."
        )

    def _mass_noise(
        self, upper: np.ndarray, scaled: np.ndarray, share: float
    ) -> tuple[float, ...]:
        """Residual over each mass's own part of the right-hand side.

        The masses are the first columns.
        """
        n_masses = len(self.step.masses)
        if not n_masses:
            return ()
        unit = np.eye(len(upper), n_masses)
        inverse_rows = back_substituted(upper, unit, transposed=True)
        inertias = np.abs(scaled[:n_masses]) / np.linalg.norm(inverse_rows, axis=0)
        noise = np.full(n_masses, np.inf)
        np.divide(share, inertias, out=noise, where=inertias != 0)
        return tuple(noise.tolist())

    def _sparse(
        self, columns: np.ndarray, target: np.ndarray, inner: Optimizer
    ) -> tuple[np.ndarray, Optimizer | None, Warned]:
        """Run a PySINDy optimizer with the masses eliminated; then solve for these.

        The masses are the first columns of the triangle.
        """
        n_masses = len(self.step.masses)
        p = columns.shape[1]
        coefficients = np.zeros(p)
        fitted: Optimizer | None = None
        warned: Warned = ()
        if p > n_masses:
            optimizer = inner
            if isinstance(inner, KeptTerms):
                optimizer = inner.of_step(self.step.name)
            require_optimizer(optimizer)
            terms, rest = self._given_to(optimizer, columns, target)
            values, fitted, warned = fit_inner(optimizer, terms, rest)
            coefficients[n_masses:] = values
        if n_masses:
            explained = columns[:n_masses, n_masses:] @ coefficients[n_masses:]
            coefficients[:n_masses] = back_substituted(
                columns[:n_masses, :n_masses], target[:n_masses] - explained
            )
        return coefficients, fitted, warned

    def _given_to(
        self, optimizer: Optimizer, columns: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Terms and right-hand side without the part of the masses, of rms one.

        As their triangular factor, or as samples where the optimizer needs them.
        """
        n_masses = len(self.step.masses)
        rms = float(self.n_samples) ** 0.5
        if survives_compression(optimizer, columns.shape[1] - n_masses):
            return columns[n_masses:, n_masses:] * rms, target[n_masses:] * rms
        if self.rows is None:
            what = (
                f"{type(optimizer).__name__} needs the samples, and of the"
                f" {self.step.name} only the sums of their products are known"
            )
            cure = (
                "Fit data in memory, with strategy 'auto', 'complete' or 'sequential',"
                " or use an optimizer that needs none (STLSQ, SR3, SSR, FROLS)."
            )
            raise NRFError(what, cure)

        samples = self.rows() * (rms / self._lengths())
        masses = columns[:n_masses, :n_masses]
        basis = back_substituted(masses, samples[:, :n_masses].T, transposed=True).T
        crossing = np.column_stack([columns[:n_masses, n_masses:], target[:n_masses]])
        rest = samples[:, n_masses:] - basis @ crossing
        return rest[:, :-1], rest[:, -1]


def back_substituted(
    upper: np.ndarray, target: np.ndarray, transposed: bool = False
) -> np.ndarray:
    """Solution of an upper triangular system of full rank, or of its transpose."""
    if not len(upper):
        return target
    return lapack.dtrtrs(upper.T, target, lower=1, trans=int(not transposed))[0]


def _bound_of_condition(uppers: Sequence[np.ndarray]) -> np.ndarray:
    """Upper bounds of the condition of triangular factors of unit columns."""
    bounds = []
    for upper in uppers:
        inverse, singular = lapack.dtrtri(upper.T, lower=1)
        if singular:
            raise NotTogether()
        bounds.append(len(upper) ** 0.5 * np.linalg.norm(inverse))
    return np.array(bounds)
