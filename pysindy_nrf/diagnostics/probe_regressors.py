"""Columns that stand for what a law may lack, along the motion of each site."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

LASTING = 2  # columns that are no law: a constant, a ramp in time
OFFERED = 7 + LASTING  # further columns of each site, those two last
_LOOPS = 4  # first of three columns of hysteresis


def further_columns(v: np.ndarray, s: np.ndarray, scales: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """Friction, a quadratic damper and spring, a gap, three loops of hysteresis; a constant and a ramp."""
    out = np.empty((len(v), OFFERED, len(clock)))
    if out.size:
        plain, loops = _compiled()
        plain(v, s, scales, clock, out)
        loops(np.exp(out[:, _LOOPS]), out)  # NumPy's exponential is several times faster than a compiled one
    return out


@cache
def _compiled() -> tuple[Callable[..., None], Callable[..., None]]:
    """Compiled."""
    from ..laws.compiled import jit

    def plain_columns(v, s, scales, clock, out):
        for i in range(v.shape[0]):
            rate, drift = 1.0 / scales[i, 0], 1.0 / scales[i, 1]
            was, turned = np.sign(v[i, 0]), s[i, 0]
            for t in range(v.shape[1]):
                forward = np.sign(v[i, t])
                turned = s[i, t] if forward != was else turned
                was = forward
                out[i, 0, t] = forward
                out[i, _LOOPS, t] = -abs(s[i, t] - turned) * drift
            for t in range(v.shape[1]):
                x, y = v[i, t] * rate, s[i, t] * drift
                out[i, 1, t] = x * abs(x)
                out[i, 2, t] = y * abs(y)
                out[i, 3, t] = y - min(max(y, -1.0), 1.0)
                out[i, 7, t] = 1.0
                out[i, 8, t] = clock[t]

    def loop_columns(near, out):
        for i in range(near.shape[0]):
            for t in range(near.shape[1]):
                forward, once = out[i, 0, t], near[i, t]
                five = once * once * once * once * once
                out[i, _LOOPS, t] = forward * (1.0 - 2.0 * once)
                out[i, _LOOPS + 1, t] = forward * (1.0 - 2.0 * five)
                out[i, _LOOPS + 2, t] = forward * (1.0 - 2.0 * five * five * five * five * five)

    return jit(plain_columns), jit(loop_columns)
