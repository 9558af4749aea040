"""Motions that no sensor measured, from the free run and the gaps of the channels.

What a run misses of the measured channels shows what it misses of the others: as much
as forces on the floors would cause that make up for the error of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..equations.errors import COLUMNS
from ..records.dataset import Dataset
from .fewer_sensors_settings import SETTINGS
from .free_run_fit import FreeRunFit, Solution
from .free_runs import with_motion
from .linear_response import transfer
from .noise_spectra import NoiseModel, expected_gaps
from .shots import Shot
from .spectra import line_frequencies, white_density

# Step of the differences along a direction, in standard errors.
DIFFERENCE = 1e-4


def channel_errors(shots: Sequence[Shot], model: ChainModel) -> pd.DataFrame:
    """Free-run errors of the measured channels, percent NRMSE.

    A row for each DOF, with its worst channel, and a row "pooled".
    """
    measured = np.concatenate([shot.measured for shot in shots])
    simulated = np.concatenate([shot.simulated_channels(model) for shot in shots])
    residual = np.sqrt(np.mean((simulated - measured) ** 2, axis=0))
    reference = np.sqrt(np.mean(measured**2, axis=0))
    percent = 100 * residual / reference

    rows: dict[str, list[float | str]] = {}
    for c in np.argsort(percent, kind="stable"):
        # the worst channel of a DOF comes last
        channel = shots[0].channels[c]
        rows[f"dof {channel[1:]}"] = [percent[c], residual[c], reference[c], channel]
    pooled = 100 * float(np.sqrt(np.mean((residual / reference) ** 2)))
    rows["pooled"] = [pooled, np.nan, np.nan, ""]
    return pd.DataFrame.from_dict(rows, orient="index", columns=COLUMNS)


def error_beyond_noise(fit: FreeRunFit, shot: Shot, model: ChainModel) -> float:
    """Largest share of a channel that is no noise, and that no other channel explains.

    Parameters
    ----------
    fit : FreeRunFit
        Whose noise is known; 0 otherwise.
    shot : Shot
    model : ChainModel
    """
    if fit.noise is None:
        return 0.0
    noise = fit.noise.with_model_error(shot.segment, shot.measured)
    step = shot.segment.step
    gap = shot.measured - shot.simulated_channels(model)

    shares = [0.0]
    n_channels = len(shot.channels)
    for c in range(n_channels):
        missed = gap[:, c]
        others = [k for k in range(n_channels) if k != c]
        if others:
            of_others = noise.of_channels(others)
            name = shot.channels[c : c + 1]
            expected = expected_gaps(of_others, name, gap[:, others], step)
            missed = missed - expected[:, 0]

        measured = shot.measured[:, c]
        white_power = white_density(measured, step) / step
        beyond = np.mean(missed**2) - SETTINGS.noise_margin**2 * white_power
        shares.append(float(np.sqrt(max(beyond, 0.0) / np.mean(measured**2))))
    return max(shares)


def motions_of(
    fit: FreeRunFit, number: int, solution: Solution, model_error: float
) -> pd.DataFrame:
    """Motions of all DOFs and forces of all sites in a record, with intervals.

    Parameters
    ----------
    fit : FreeRunFit
    number : int
        Of the shot.
    solution : Solution
    model_error : float
        Error of the model, as a share of every motion and force.

    Returns
    -------
    DataFrame
        ``a1``.. (absolute, m/s^2), ``v1``.. and ``x1``.. (relative to the base, m/s
        and m), ``R storey 1``.. (N), and ``_lower`` and ``_upper`` of each; by time.
    """
    shot = fit.shots[number]
    model = solution.model
    noise = fit.noise
    if noise is not None:
        noise = noise.with_model_error(shot.segment, shot.measured)
    hidden = _HiddenMotion(shot, noise, tuple(model.laws))

    best = hidden.columns(model)
    variance = np.zeros_like(best) + np.mean((model_error * best) ** 2, axis=0)
    # independent directions of the parameters, each one standard error long
    _, sizes, directions = np.linalg.svd(solution.influences, full_matrices=False)
    for direction in sizes[:, None] * directions:
        moved = hidden.columns(fit.rebuild(solution.u + DIFFERENCE * direction))
        variance += ((moved - best) / DIFFERENCE) ** 2
    if noise is not None:
        variance += hidden.variance_of_unknown_forces(noise, model, fit.weighting.band)

    half = norm.ppf(0.5 + SETTINGS.level / 2) * np.sqrt(variance)
    names = [*hidden.channels, *(f"R {site}" for site in hidden.sites)]
    table = pd.concat(
        [
            pd.DataFrame(best, columns=names),
            pd.DataFrame(best - half, columns=names).add_suffix("_lower"),
            pd.DataFrame(best + half, columns=names).add_suffix("_upper"),
        ],
        axis=1,
    )
    segment = shot.segment
    time = None if segment.t is None else segment.t[segment.valid]
    return table.set_axis(pd.Index(time, name="t"), axis=0)


@dataclass(frozen=True)
class _HiddenMotion:
    """Motions of all DOFs and forces of all sites along one shot."""

    shot: Shot
    noise: NoiseModel | None
    sites: tuple[Site, ...]

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.shot.segment.n_dof

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of all motions: accelerations, velocities, displacements."""
        names = []
        for kind in "avx":
            for dof in range(1, self.n_dof + 1):
                names.append(f"{kind}{dof}")
        return tuple(names)

    def columns(self, model: ChainModel) -> np.ndarray:
        """Motions and forces of a model, corrected by the gaps of the channels."""
        motion = self.shot.motion(model)
        if self.noise is not None:
            gap = self.shot.measured - self.shot.channels_of(motion)
            step = self.shot.segment.step
            missed = expected_gaps(self.noise, self.channels, gap, step)
            a, v, x = np.hsplit(missed, 3)
            motion = {
                "a": motion["a"] + a,
                "v": motion["v"] + v,
                "x": motion["x"] + x,
            }
        segment = with_motion(self.shot.segment, motion)
        forces = model.site_forces(Dataset([segment], 0))[0]
        return np.hstack([motion["a"], motion["v"], motion["x"], forces])

    def variance_of_unknown_forces(
        self, noise: NoiseModel, model: ChainModel, band: tuple[float, float]
    ) -> np.ndarray:
        """Variance of motions and forces by what the channels do not show of forces."""
        f = line_frequencies(self.shot.segment)
        f = f[(f >= band[0]) & (f <= band[1])]

        variance = np.zeros(len(self.channels) + len(self.sites))
        for rows, G, S in noise.covariances(f):
            T = self._responses(noise, model, f[rows])
            explained = np.linalg.solve(S, G * noise.force)
            adjoint = (G * noise.force).conj().transpose(0, 2, 1)
            unknown = np.diag(noise.force) - adjoint @ explained
            power = np.einsum("fck,fkl,fcl->c", T, unknown, T.conj(), optimize=True)
            variance += 2 * power.real * (f[1] - f[0])
        return variance

    def _responses(
        self, noise: NoiseModel, model: ChainModel, f: np.ndarray
    ) -> np.ndarray:
        """Motions and linear storey forces from forces and base acceleration."""
        motions = transfer(noise.matrices, f, self.channels)
        displacements = motions[:, 2 * self.n_dof :]
        # with the ground in front
        x = np.pad(displacements, ((0, 0), (1, 0), (0, 0)))
        iw = 2j * np.pi * f[:, None]

        forces = []
        for site in self.sites:
            linear = model.restoring_forces[site].linear_part()
            drift = x[:, site.p] - x[:, site.q or 0]
            forces.append((linear["k"] + iw * linear["c"]) * drift)
        return np.concatenate([motions, np.stack(forces, axis=1)], axis=1)
