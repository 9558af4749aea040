"""Columns of missing effects, against their definitions."""

import numpy as np

from pysindy_nrf.diagnostics.windows import probe_regressors


def test_columns_are_what_their_names_say():
    """Friction, drag, a stiffening spring, a gap of one rms; loops that depend on the drift since the last reversal."""
    t = np.linspace(0, 3, 400)
    s = np.array([np.sin(2 * np.pi * t), 0.01 * np.cos(3 * t)])
    v = np.array([2 * np.pi * np.cos(2 * np.pi * t), -0.03 * np.sin(3 * t)])
    scales = np.column_stack([v.std(axis=1), s.std(axis=1)])
    found = probe_regressors(v, s, scales, t / 1.5 - 1)
    x, y = v / scales[:, :1], s / scales[:, 1:]
    for i in range(2):
        reversals = np.flatnonzero(np.diff(np.sign(v[i]))) + 1
        last = np.array([max([0, *reversals[reversals <= k]]) for k in range(len(t))])
        way = np.abs(y[i] - y[i][last])
        loops = [np.sign(v[i]) * (1 - 2 * np.exp(-sharp * way)) for sharp in (1, 5, 25)]
        gap = np.where(np.abs(y[i]) > 1, y[i] - np.sign(y[i]), 0.0)
        expected = [np.sign(v[i]), x[i] * np.abs(x[i]), y[i] * np.abs(y[i]), gap, *loops, np.ones(400), t / 1.5 - 1]
        np.testing.assert_allclose(found[i], expected, atol=1e-12)
