"""Hand-made findings, faults and loops for the exact tests of the walk."""

from __future__ import annotations

import numpy as np

from pysindy_nrf import ChainModel, Record, Site, laws
from pysindy_nrf.discrepancy import (
    residual,
    sensors,
    workspace,
)
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.gate import Verdict
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.discrepancy.splits import BlockRows
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.input_arrays import from_arrays


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def finding(law, error=1.0, site="storey 1", drop=(), folds=None):
    folds = np.full(5, float(error)) if folds is None else np.array(folds, dtype=float)
    return Finding(Candidate(law, Site(site)), law, error, drop, folds)


def fault(law, error=1.0, site="sensor a1", screen=1.0):
    one = sensors.SensorFinding(Candidate(law, Site(site)), law, screen)
    one.folds = np.full(5, float(error))
    return one


def refuse(*a, **k):
    raise NRFError("cannot", "be")


FRICTION, CUBIC = finding(laws.CoulombFriction()), finding(laws.CubicStiffness(), site="storey 2")


def turned_down(verdict, *a):
    return Verdict(False, verdict.gain, 1.0, 0.0, "turned down")


def four(forced=(1,), masses=(1.0, 2.0, 3.0, 5.0), n=60, f=None):
    """Four balances of a chain under forces on some, with what a force on DOF 2 leaves."""
    X, F = np.random.default_rng(0).standard_normal((n, 12)), np.zeros((n, 4))
    F[:, [j - 1 for j in forced]] = 1.0
    model = ChainModel(
        list(masses), {i: [laws.LinearElastic(1.0 + i), laws.LinearViscous(0.1 * i)] for i in (1, 2, 3, 4)}
    )
    one = residual.residual_of(model, from_arrays(X, F, dt=0.01))
    return one.with_balance([np.outer(noise(n, 1) if f is None else f, [0, 1, 0, 0])]), X


def record(n=400, level=0.0, n_dof=1, seed=0, name="r", **more):
    """A cosine of one DOF whose three channels agree but for white noise of a share of their rms."""
    t, rng = np.arange(n) / 100, np.random.default_rng(seed)
    x = np.cos(5 * t)[:, None] * np.arange(1, n_dof + 1)
    motion = {"displacement": x, "velocity": np.gradient(x, t, axis=0), "acceleration": -25 * x}
    motion = {k: y + level * y.std(axis=0) * rng.standard_normal(y.shape) for k, y in motion.items()}
    return Record(fs=100.0, force=rng.standard_normal((n, n_dof)), name=name, **motion, **more)


def shaken_space(n_dof, unknown=False, n=240, known=None, strategy="auto", silent=()):
    """Noise under noise: two records of balances that nothing closes, one of them perhaps with an unknown force."""
    rng, out = np.random.default_rng(5), []
    for k in range(2):
        F = rng.standard_normal((n, n_dof))
        F[:, list(silent)] = 0.0
        if unknown and k:
            F[:, 0] = np.nan
        out += from_arrays(rng.standard_normal((n, 3 * n_dof)), F, dt=0.01).segments
    data = type(from_arrays(np.zeros((9, 3)), dt=0.01))(out, 2 * n)
    search = [BlockRows(k, slice(a, a + 60)) for k in (0, 1) for a in (0, 60, 120)]
    held = [BlockRows(0, slice(180, 240)), BlockRows(1, slice(180, 210)), BlockRows(0, slice(100, 110))]
    return workspace.Workspace(data, [None] * 2, search, held, known or {}, strategy)
