"""Hand-made findings, residuals and workspaces for the exact tests of the rooms."""

from __future__ import annotations

import numpy as np

from pysindy_nrf import ChainModel, Site, laws
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.residual import residual_of
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.discrepancy.splits import BlockRows
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.input_arrays import from_arrays
from pysindy_nrf.laws import Motion


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def fresh(text):
    """The same text, as another object: what it says counts."""
    return "".join(list(text))


def finding(law, error, site="storey 1", drop=(), folds=None):
    folds = np.array([error, error, 9 * error]) if folds is None else folds
    return Finding(Candidate(law, Site(site)), law, error, drop, folds)


def residual(n=600, n_dof=2, e=None, forced=True, seed=0, lengths=None, **more):
    """A residual of given balances along motions and forces of noise."""
    sets = []
    for k, length in enumerate(lengths or [n]):
        rng = np.random.default_rng(seed + k)
        X, F = rng.standard_normal((length, 3 * n_dof)), rng.standard_normal((length, n_dof))
        sets.append(from_arrays(X, F if forced else 0 * F, dt=0.01, **more))
    data = type(sets[0])([s.segments[0] for s in sets], sum(lengths or [n]))
    model = ChainModel([1.0] * n_dof, {i: [laws.LinearElastic(1.0)] for i in range(1, n_dof + 1)})
    found = residual_of(model, data)
    return found if e is None else found.with_balance(e)


def blocks(gain, n=10, level=5.0):
    return np.full(n, level), np.full(n, level * (1 - gain))


def motion(n=500, seed=0, dt=0.02, a=False, **covariates):
    t = np.arange(n) * dt
    w, p = np.array([2.1, 5.3, 9.7])[:, None], np.random.default_rng(seed).uniform(0, 6, (3, 1))
    s, v, acceleration = (f.sum(axis=0) for f in (np.sin(w * t + p), w * np.cos(w * t + p), -w * w * np.sin(w * t + p)))
    return Motion(s, v, acceleration if a else None, t, covariates)


def workspace(lengths=(300, 200), n_dof=2, blocks=None, first=0, seed=0, F=None):
    found = residual(n_dof=n_dof, lengths=list(lengths), seed=seed)
    for seg in found.data.segments:
        seg.valid = slice(first, len(seg.s))
        if F is not None:
            seg.F[:] = F(seg)
    blocks = blocks or [(0, 0, 100), (0, 100, 150), (0, 200, 250), (1, 5, 80)]
    search = [BlockRows(i, slice(a, b)) for i, a, b in blocks]
    return Workspace(found.data, [None] * len(lengths), search, [], {}, "auto")
