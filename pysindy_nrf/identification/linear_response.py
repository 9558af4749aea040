"""Responses of a model linearised along its free run."""

from collections.abc import Iterator, Sequence

import numpy as np

from ..chain.frequency_response import transfer as transfer
from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..records.dataset import Dataset, Segment
from .spectra import line_frequencies

# Lines that are processed at a time; bounds the memory.
LINES_AT_ONCE = 4096
Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]


def equivalent_matrices(
    model: ChainModel, layout: LawLayout, runs: Sequence[Segment]
) -> Matrices:
    """Mass, damping and stiffness matrix whose forces are nearest along free runs."""
    n = model.n_dof
    C = np.zeros((n, n))
    K = np.zeros((n, n))

    coefficients = model.coefficients
    for site in layout.acting:
        if site.kind == "dof":
            continue
        c, k = _equivalent_link(layout, site, coefficients[site], runs)
        signs = np.array([site.incidence(j) for j in range(1, n + 1)], dtype=float)
        C = C + c * np.outer(signs, signs)
        K = K + k * np.outer(signs, signs)

    return np.diag(model.masses), C, K


def _equivalent_link(
    layout: LawLayout, site: Site, coefficients: np.ndarray, runs: Sequence[Segment]
) -> np.ndarray:
    """Dashpot and spring nearest to the force of one link along free runs."""
    gram = np.zeros((2, 2))
    right = np.zeros(2)
    for run in runs:
        motion = run.motion(site, run.valid)
        columns = np.stack([motion.v, motion.s])
        gram += columns @ columns.T
        right += columns @ (layout.columns(site, motion) @ coefficients)

    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    unit = gram / size[:, None] / size
    return np.linalg.lstsq(unit, right / size, rcond=1e-12)[0] / size


def blocks_of_lines(n_lines: int) -> Iterator[slice]:
    """Consecutive Fourier lines, as many as are processed at a time."""
    for start in range(0, n_lines, LINES_AT_ONCE):
        yield slice(start, start + LINES_AT_ONCE)


def unbalanced(
    model: ChainModel, matrices: Sequence[np.ndarray], segment: Segment
) -> np.ndarray:
    """Velocities that forces equal to the residuals would cause, (n_valid, n_dof).

    Of a linear model these are the gaps of its free run. The run of a nonlinear one may
    lose the motion without any noise.
    """
    forces = model.balance_forces(Dataset([segment], segment.n_samples))[0]
    residual = segment.F[segment.valid] - forces
    f = line_frequencies(segment)

    lines = np.fft.rfft(residual, axis=0)
    lines[0] = 0.0
    moving = lines[1:]
    for rows in blocks_of_lines(len(f)):
        G = transfer(matrices, f[rows])[:, :, : segment.n_dof]
        moving[rows] = -(G @ moving[rows][:, :, None])[:, :, 0]
    return np.fft.irfft(lines, len(residual), axis=0)
