"""Frequency responses: their noise, whether a chain can hold them, and a fit that noise
does not bias.

Over a few lines a response is a ratio of low polynomials, with one denominator for all
DOFs; what is left is noise (local rational method, McKelvey and Guerin, IFAC SYSID
2012). A balance is linear in the responses: weighted total least squares finds the
responses nearest to the measured ones, in units of noise, that obey it. Their distance
is one where noise is all there is. Their rows are the instruments of the fit, which is
then one of total least squares.
"""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg

from ..equations.accumulation import pieces_of
from ..equations.chain_solve import groups_of, model_of, solve
from ..exceptions import BiasWarning, ChainError, DataQualityWarning
from ..records.files import frf_to_features
from ..records.files.frequency_response import FrequencyResponse, in_band
from ..records.input_arrays import from_arrays
from .intervals import Resolver

# lines on each side, of a polynomial of degree 2 over one of degree 2: 9 n values for 3
# n + 2 unknowns
HALF = 4
ROUNDS = 6  # of weights: they settle to 1 % within four
# variances of noise; at 0.2, 1 and 5 % noise the largest of 1,200 simulated responses
# is 3.7
BEYOND = 9.0
# of the responses; Hann's window leaves less, a gain that is 20 % wrong and 2 ms at 4
# Hz leave more
MATTERS = 0.01


def noise_of(H: np.ndarray) -> np.ndarray:
    """Variance of each line of each DOF, from the lines beside it; shape of ``H``."""
    n_lines, n = H.shape
    d = np.arange(-HALF, HALF + 1) / HALF
    near = np.clip(np.arange(n_lines), HALF, n_lines - 1 - HALF)[:, None] + np.arange(
        -HALF, HALF + 1
    )
    Y = H[near].transpose(0, 2, 1)
    numerator, denominator = np.vander(d, 3), np.vander(d, 3)[:, :2]
    rest = np.eye(len(d)) - numerator @ np.linalg.pinv(numerator)
    size = np.sqrt((np.abs(Y) ** 2).mean(axis=2, keepdims=True)) + np.finfo(float).tiny
    columns = np.einsum("ij,jp,lkj->lkip", rest, denominator, Y / size).reshape(
        n_lines, -1, 2
    )
    target = ((Y / size) @ rest).reshape(n_lines, -1, 1)
    q = -np.linalg.pinv(columns) @ target
    left = (np.abs(columns @ q + target) ** 2).reshape(n_lines, n, -1).sum(axis=2)
    shape = (np.abs(1 + denominator @ q[:, :, 0].T) ** 2).mean(axis=0)[:, None]
    floor = (1e-9 * size[:, :, 0]) ** 2
    return np.maximum(left / shape / (len(d) - 3 - 2 / n) * size[:, :, 0] ** 2, floor)


def nearest(
    frf: FrequencyResponse, noise: np.ndarray, sites: Any, j: int, free: int = 0
) -> tuple[float, np.ndarray, np.ndarray]:
    """Distance, in variances of noise, of responses that obey a balance (with any gain
    of DOF free); they; weights.
    """
    unit, iw = np.eye(frf.n_dof + 1)[:, 1:], 2j * np.pi * frf.f[:, None, None]
    drifts = np.array(
        [unit[s.p] - unit[s.q or 0] for s in sites if j in (s.p, s.q)]
    ).reshape(-1, frf.n_dof)
    masses = unit[[j]]
    more = np.vstack([drifts, unit[[free]]])
    if free and drifts[:, free - 1].any() and np.linalg.matrix_rank(more) == len(more):
        drifts, masses = more, unit[sorted({j, free})]
    T = np.concatenate(
        [
            np.broadcast_to(masses.T, (len(iw), *masses.T.shape)),
            drifts.T / iw,
            drifts.T / iw**2,
        ],
        axis=2,
    )
    X = np.einsum("lk,lkc->lc", frf.H, T)
    if j == frf.excited:
        X, T = (
            np.append(y, np.full((*y.shape[:-1], 1), value), axis=-1)
            for y, value in ((X, 1.0), (T, 0.0))
        )
    w = np.ones(len(X))
    for _ in range(ROUNDS):
        G = ((w[:, None] * X).conj().T @ (w[:, None] * X)).real
        N = np.einsum(
            "lkc,lkd,lk->cd", T.conj(), T, noise * w[:, None] ** 2, optimize=True
        ).real
        size = np.sqrt(np.diag(G))
        G, N = G / size[:, None] / size, N / size[:, None] / size
        values, vectors = linalg.eigh(N, G + 1e-13 * np.eye(len(G)))
        theta = vectors[:, -1] / size
        passed = T @ theta
        power = (np.abs(passed) ** 2 * noise).sum(axis=1)
        w = np.sqrt(power.min() / power)
    return (
        1.0 / float(values[-1]),
        frf.H + -passed.conj() * noise * ((X @ theta) / power)[:, None],
        w,
    )


def doubts(
    frf: FrequencyResponse, noise: np.ndarray, sites: Any, found: dict[int, Any]
) -> list[str]:
    """Sentences on responses that no chain of these sites has, whatever its masses and
    laws.
    """
    out, e = [], frf.excited
    if (frf.H[:, e - 1].imag / frf.f).sum() < -3 * np.sqrt(
        (noise[:, e - 1] / 2 / frf.f**2).sum()
    ):
        out.append(
            f"H{e}, where the force acts, gives energy back: its sign, that of the"
            " imaginary parts, or kind= is wrong."
        )
    whole = linalg.norm(frf.H, axis=1)
    sizes = {
        j: np.median(linalg.norm(H - frf.H, axis=1) / whole)
        for j, (_, H, _) in found.items()
    }
    bad = [
        j
        for j, (distance, *_) in found.items()
        if distance > BEYOND and sizes[j] > MATTERS
    ]
    if not bad:
        return out
    worst = max(bad, key=lambda j: sizes[j])
    level = sizes[worst] / np.sqrt(found[worst][0])
    limit = max(BEYOND, max(found[j][0] for j in bad) / BEYOND)
    causes = ["the force (is it late, and kind= right?)"] if bad == [e] else []
    if (
        bad == [worst] != [e]
        and nearest(replace(frf, excited=worst), noise, sites, worst)[0] < limit
    ):
        causes.append(f"whether the force acts on DOF {worst} (excited={worst})")
    free = {
        k: [nearest(frf, noise, sites, j, k)[0] for j in bad]
        for k in range(1, frf.n_dof + 1)
    }
    if alone := [f"H{k}" for k, left in free.items() if max(left) < limit]:
        causes.append(f"the gain, sign, unit or delay of {' or '.join(alone)}")
    cause = (
        " or ".join(causes)
        or "the order of the channels, or a link that the chain lacks"
    )
    return [
        *out,
        (
            f"No masses and laws fit the balance of DOF {', '.join(map(str, bad))}: the"
            f" responses would have to differ by {100 * sizes[worst]:.2g} %, their"
            f" noise is {100 * level:.2g} %. Check {cause}."
        ),
    ]


def fit_frequency_response(estimator: Any, frf: FrequencyResponse) -> Any:
    """Fit a regressor to measured frequency responses; its band chooses lines."""
    band, asked = (
        estimator.band,
        {
            "band": estimator.band,
            "estimation": estimator.estimation,
        },
    )
    use = in_band(frf.f, band)
    n_lines, n = int(use.sum()), frf.n_dof
    if estimator.estimation == "simulation":
        raise ChainError(
            "estimation='simulation' does not work on frequency responses",
            "Use 'ls' or 'iv'.",
        )
    if n_lines <= 2 * HALF:
        raise ChainError(
            f"{n_lines} lines of {frf.name} do not tell noise from motion",
            "Give more lines.",
        )
    part = FrequencyResponse(frf.f[use], frf.H[use], frf.excited, frf.name)
    noise, problem = noise_of(part.H), estimator.problem(n)
    sites = problem.layout.acting
    found = {j: nearest(part, noise, sites, j) for j in range(1, n + 1)}
    said = doubts(part, noise, sites, found)
    ids = np.repeat(np.arange(n), 2 * n_lines)

    def rows(responses: Any) -> tuple[pd.DataFrame, pd.DataFrame]:
        """One record for each balance, whose lines have the weights of this balance."""
        pairs = [
            frf_to_features(part.f, H, frf.excited, weight=w)
            for H, (*_, w) in zip(responses, found.values())
        ]
        X, F = (pd.concat(tables, ignore_index=True) for tables in zip(*pairs))
        return X, F.where(ids[:, None] == np.arange(n))

    X, F = rows([part.H] * n)
    try:
        with warnings.catch_warnings(
            action="ignore", category=BiasWarning
        ):  # there is no time, and no bias is left
            estimator.set_params(band=None, estimation="ls").fit(X, F, record=ids)
    finally:
        estimator.set_params(**asked)
    data, near = (
        from_arrays(x, F, n_dof=n, record=ids)
        for x in (X, rows([H for _, H, _ in found.values()])[0])
    )
    layout, order, known = (
        estimator.problem_.layout,
        estimator.solve_order_,
        dict(problem.known_masses),
    )
    pieces = pieces_of(
        data, layout, groups_of(layout, order), [None] * n, known, near.segments
    )
    solution = solve(pieces.sum().projected(), order, known, problem.optimizer)
    how = {"asked": asked["estimation"], "found": "iv", "notes": ["nearest responses"]}
    lines = (
        None
        if band is None
        else [None if b is None or np.isinf(b) else b for b in band]
    )
    model = model_of(
        layout, solution
    )  # amplitudes of a steady state are no visited motion
    model.info = estimator.model_.info | {"estimation": how, "band": lines}
    estimator.model_, estimator.masses_, estimator.restoring_forces_ = (
        model,
        model.masses,
        model.restoring_forces,
    )
    estimator._resolver = Resolver(pieces, order, known, problem.optimizer)
    estimator.errors_ = estimator.balance_errors(X, F, record=ids)
    estimator.missing_terms_ = estimator.missing_terms_.iloc[:0]
    estimator.data_warnings_ = {"channels": said}
    if said:
        warnings.warn(f"{frf.name}: {' '.join(said)}", DataQualityWarning, stacklevel=3)
    return estimator
