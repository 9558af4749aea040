"""Frequency responses: their noise, a fit that noise does not bias, and what is wrong.

Over a few lines a response is a ratio of low polynomials, with one denominator for all
DOFs; what is left is noise (local rational method, McKelvey and Guerin, IFAC SYSID
2012). A balance is linear in the responses: weighted total least squares finds the
responses nearest to the measured ones, in units of noise, that obey it. Their distance
is one where noise is all there is. Their rows are the instruments of the fit, which is
then one of total least squares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy import linalg

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..common.warn import warn_user
from ..equations.accumulation import pieces_of
from ..equations.chain_solve import groups_of, model_of, solve
from ..equations.errors import judge
from ..exceptions import ChainError, DataQualityWarning
from ..records.dataset import Dataset
from ..records.files import frf_to_features
from ..records.files.frequency_response import FrequencyResponse, in_band
from ..records.input_arrays import Input, InputSettings, from_arrays
from ..records.quality import QualityNote
from ..records.zero_phase_filter import Band
from .examination import Examination, Finding
from .intervals import Resolver
from .methods import RESPONSES, IdentificationMethod, finite_band, result_of
from .problem import Problem, blocks_of, least_squares
from .result import IdentificationResult

# Lines on each side of one over which a response is a polynomial of degree 2 over one
# of degree 2: 9 n values for 3 n + 2 unknowns.
HALF_WIDTH = 4
_DEGREE = 2
# Smallest noise, as a share of the response: round-off of the polynomials.
_SMALLEST_NOISE = 1e-9
# Rounds of the weights of lines, which settle to 1 % within four.
_ROUNDS = 6
# Distance, in variances of noise, above which responses cannot obey a balance. At 0.2,
# 1 and 5 % noise the largest of 1,200 simulated responses is 3.7.
_FAR = 9.0
# Change of the responses, as a share, that matters: Hann's window leaves less, a gain
# that is 20 % wrong and 2 ms at 4 Hz leave more.
_MATTERS = 0.01
# Standard errors of a power that a force puts into a structure, which is not negative.
_SURELY_NEGATIVE = -3.0


class FrequencyResponseFit(IdentificationMethod[FrequencyResponse]):
    """Total least squares of the balances, with the noise that the lines show."""

    name = "iv"
    label = "a fit of frequency responses"
    requires = frozenset({RESPONSES})
    uses = frozenset({"optimizer", "strategy", "constraints", "band"})

    def read(self, passed: Input, settings: InputSettings) -> FrequencyResponse:
        """The responses as they are."""
        responses: FrequencyResponse = passed.X
        return responses

    def identify(
        self, problem: Problem, data: FrequencyResponse
    ) -> IdentificationResult:
        """Masses and linear laws of a problem; its band chooses lines."""
        used = _lines_in_band(data, problem.band)
        unfiltered = replace(problem, band=None)
        noise = noise_of(used.H)
        sites = problem.layout.acting
        nearest = {}
        for j in range(1, data.n_dof + 1):
            nearest[j] = nearest_responses(used, noise, sites, j)
        doubts = responses_in_doubt(used, noise, sites, nearest)
        measured = _balances(used, nearest)
        instruments = _balances(used, nearest, of_nearest=True)
        start = least_squares(unfiltered, measured)
        layout = start.problem.layout
        order = start.order
        known_masses = dict(problem.known_masses)
        pieces = pieces_of(
            measured,
            layout,
            groups_of(layout, order),
            [None] * data.n_dof,
            known_masses,
            instruments.segments,
        )
        total = pieces.sum().projected()
        solution = solve(total, order, known_masses, problem.optimizer)

        resolver = Resolver(pieces, order, known_masses, problem.optimizer)
        estimate = start._replace(model=model_of(layout, solution))
        finding = Finding(
            estimate,
            measured,
            asked=self.asked,
            method=self.name,
            notes=("nearest responses",),
            resolver=resolver,
        )
        result = result_of(finding)
        notes = tuple(QualityNote("other", doubt, record=data.name) for doubt in doubts)
        if doubts:
            warn_user(f"{data.name}: {' '.join(doubts)}", DataQualityWarning)
        return replace(
            result,
            model=_without_motion(result.model, problem.band),
            errors=judge(
                result.model,
                layout,
                order,
                lambda: blocks_of(measured, [None] * data.n_dof, layout),
            ),
            unknown_forces=pd.DataFrame(),
            examination=Examination(quality=notes),
        )


def _lines_in_band(frf: FrequencyResponse, band: Band) -> FrequencyResponse:
    inside = in_band(frf.f, band)
    n_lines = int(inside.sum())
    if n_lines <= 2 * HALF_WIDTH:
        raise ChainError(
            f"{n_lines} lines of {frf.name} do not separate noise from motion",
            "Give more lines.",
        )
    return FrequencyResponse(frf.f[inside], frf.H[inside], frf.excited, frf.name)


def _balances(
    frf: FrequencyResponse,
    nearest: Mapping[int, NearestResponses],
    of_nearest: bool = False,
) -> Dataset:
    """One record for each balance, whose lines have the weights of this balance.

    It holds the measured responses, or those that obey the balance.
    """
    motions = []
    forces = []
    for dof, responses in nearest.items():
        H = responses.H if of_nearest else frf.H
        X, F = frf_to_features(frf.f, H, frf.excited, weight=responses.weights)
        # the force on any other DOF is unknown, so that its balance is not used
        F.loc[:, F.columns != f"F{dof}"] = np.nan
        motions.append(X)
        forces.append(F)
    record = np.repeat(list(nearest), 2 * len(frf.f))
    return from_arrays(
        pd.concat(motions, ignore_index=True),
        pd.concat(forces, ignore_index=True),
        n_dof=frf.n_dof,
        record=record,
    )


def _without_motion(model: ChainModel, band: Band) -> ChainModel:
    """The model without visited regions: steady-state amplitudes are no motion."""
    info = model.info | {"band": finite_band(band)}
    return ChainModel(model.masses, model.laws, model.chain, info=info)


# -- noise and nearest responses -----------------------------------------------------


def noise_of(H: np.ndarray) -> np.ndarray:
    """Variance of each line of each DOF, from the lines next to it.

    Parameters
    ----------
    H : ndarray of complex, shape (n_lines, n_dof)

    Returns
    -------
    ndarray of shape (n_lines, n_dof)
    """
    n_lines, n = H.shape
    offset = np.arange(-HALF_WIDTH, HALF_WIDTH + 1)
    centre = np.clip(np.arange(n_lines), HALF_WIDTH, n_lines - 1 - HALF_WIDTH)
    near = H[centre[:, None] + offset].transpose(0, 2, 1)
    rms = np.sqrt((np.abs(near) ** 2).mean(axis=2, keepdims=True))
    size = rms + np.finfo(float).tiny

    # what the numerator leaves, for every power of the denominator
    numerator = np.vander(offset / HALF_WIDTH, _DEGREE + 1)
    denominator = numerator[:, :_DEGREE]
    leave = np.eye(len(offset)) - numerator @ np.linalg.pinv(numerator)
    columns = np.einsum("ij,jp,lkj->lkip", leave, denominator, near / size)
    columns = columns.reshape(n_lines, -1, _DEGREE)
    target = ((near / size) @ leave).reshape(n_lines, -1, 1)

    poles = -np.linalg.pinv(columns) @ target
    residual = np.abs(columns @ poles + target) ** 2
    residual = residual.reshape(n_lines, n, -1).sum(axis=2)
    of_denominator = np.abs(1 + denominator @ poles[:, :, 0].T) ** 2
    freedom = len(offset) - (_DEGREE + 1) - _DEGREE / n
    variance = residual / of_denominator.mean(axis=0)[:, None] / freedom
    variance = variance * size[:, :, 0] ** 2
    return np.maximum(variance, (_SMALLEST_NOISE * size[:, :, 0]) ** 2)


@dataclass(frozen=True)
class NearestResponses:
    """Responses that obey a balance, nearest to the measured ones.

    Attributes
    ----------
    distance : float
        Mean square, in variances of noise.
    H : ndarray of complex, shape (n_lines, n_dof)
    weights : ndarray of shape (n_lines,)
        One over the noise of the balance, largest one.
    """

    distance: float
    H: np.ndarray
    weights: np.ndarray


def nearest_responses(
    frf: FrequencyResponse,
    noise: np.ndarray,
    sites: Sequence[Site],
    dof: int,
    free: int | None = None,
) -> NearestResponses:
    """Responses that obey the balance of a DOF, with any gain of the DOF ``free``."""
    terms = _terms_of_balance(frf, sites, dof, free)
    columns = np.einsum("lk,lkc->lc", frf.H, terms)
    if dof == frf.excited:
        # the force is exact: one at every line, without noise
        ones = np.ones((len(columns), 1))
        zeros = np.zeros((*terms.shape[:2], 1))
        columns = np.append(columns, ones, axis=1)
        terms = np.append(terms, zeros, axis=2)

    weights = np.ones(len(columns))
    for _ in range(_ROUNDS):
        squared = weights**2
        weighted = weights[:, None] * columns
        gram = (weighted.conj().T @ weighted).real
        of_noise = np.einsum(
            "lkc,lkd,lk->cd",
            terms.conj(),
            terms,
            noise * squared[:, None],
            optimize=True,
        ).real
        size = np.sqrt(np.diag(gram))
        gram = gram / size[:, None] / size
        of_noise = of_noise / size[:, None] / size
        values, vectors = linalg.eigh(of_noise, gram + 1e-13 * np.eye(len(gram)))

        theta = vectors[:, -1] / size
        passed = terms @ theta
        power = (np.abs(passed) ** 2 * noise).sum(axis=1)
        weights = np.sqrt(power.min() / power)

    correction = passed.conj() * noise * ((columns @ theta) / power)[:, None]
    return NearestResponses(1.0 / float(values[-1]), frf.H - correction, weights)


def _terms_of_balance(
    frf: FrequencyResponse, sites: Sequence[Site], dof: int, free: int | None
) -> np.ndarray:
    """What the accelerances are multiplied by in every term of a balance.

    Shape (n_lines, n_dof, n_terms): masses, then dampers and springs of the drifts.
    """
    n = frf.n_dof
    unit = np.eye(n + 1)[:, 1:]  # row 0 is the ground
    joined = [site for site in sites if dof in (site.p, site.q)]
    drifts = np.array([unit[site.p] - unit[site.q or 0] for site in joined])
    drifts = drifts.reshape(-1, n)
    masses = unit[[dof]]
    if free is not None and drifts[:, free - 1].any():
        more = np.vstack([drifts, unit[[free]]])
        if np.linalg.matrix_rank(more) == len(more):
            drifts = more
            masses = unit[sorted({dof, free})]

    iw = 2j * np.pi * frf.f[:, None, None]
    inertia = np.broadcast_to(masses.T, (len(iw), *masses.T.shape))
    return np.concatenate([inertia, drifts.T / iw, drifts.T / iw**2], axis=2)


# -- what is wrong with responses ----------------------------------------------------


def responses_in_doubt(
    frf: FrequencyResponse,
    noise: np.ndarray,
    sites: Sequence[Site],
    nearest: Mapping[int, NearestResponses],
) -> list[str]:
    """Sentences on responses that no chain of these sites has, whatever its masses."""
    sentences = []
    driven = frf.excited - 1
    power = (frf.H[:, driven].imag / frf.f).sum()
    error = np.sqrt((noise[:, driven] / 2 / frf.f**2).sum())
    if power < _SURELY_NEGATIVE * error:
        sentences.append(
            f"H{frf.excited}, where the force acts, gives energy back: its sign, that"
            " of the imaginary parts, or kind= is wrong."
        )

    of_lines = linalg.norm(frf.H, axis=1)
    changes = {}
    farthest = 0.0
    for j, responses in nearest.items():
        change = np.median(linalg.norm(responses.H - frf.H, axis=1) / of_lines)
        if responses.distance > _FAR and change > _MATTERS:
            changes[j] = change
            farthest = max(farthest, responses.distance)
    if not changes:
        return sentences

    bad = list(changes)
    worst = max(bad, key=changes.__getitem__)
    level = changes[worst] / np.sqrt(nearest[worst].distance)
    limit = max(_FAR, farthest / _FAR)
    cause = _cause_of(frf, noise, sites, bad, worst, limit)
    sentences.append(
        f"No masses and laws fit the balance of DOF {', '.join(map(str, bad))}: the"
        f" responses would have to differ by {100 * changes[worst]:.2g} %, their noise"
        f" is {100 * level:.2g} %. Check {cause}."
    )
    return sentences


def _cause_of(
    frf: FrequencyResponse,
    noise: np.ndarray,
    sites: Sequence[Site],
    bad: list[int],
    worst: int,
    limit: float,
) -> str:
    """What may be wrong where balances leave more than a limit, in words."""
    causes = []
    if bad == [frf.excited]:
        causes.append("the force (is it late, and kind= right?)")
    elif bad == [worst]:
        elsewhere = replace(frf, excited=worst)
        if nearest_responses(elsewhere, noise, sites, worst).distance < limit:
            causes.append(f"whether the force acts on DOF {worst} (excited={worst})")

    with_free_gain = []
    for k in range(1, frf.n_dof + 1):
        distances = [nearest_responses(frf, noise, sites, j, k).distance for j in bad]
        if max(distances) < limit:
            with_free_gain.append(f"H{k}")
    if with_free_gain:
        named = " or ".join(with_free_gain)
        causes.append(f"the gain, sign, unit or delay of {named}")
    return (
        " or ".join(causes)
        or "the order of the channels, or a link that the chain lacks"
    )
