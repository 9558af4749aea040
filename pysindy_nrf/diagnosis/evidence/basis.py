"""Groups of columns of a motion: functions of drift, of rate, of both, of the path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...laws.shape import Motion
from .kinds import Dependence
from .motion_columns import rms_of_all, sliders

# Yield drifts of the sliders, in multiples of the rms drift: small ones are friction,
# large ones springs.
YIELD_DRIFTS = (0.02, 0.06, 0.15, 0.3, 0.6, 1.0, 1.6, 2.5)
# Gaps that are tried, in multiples of the rms drift.
GAPS = np.arange(9) * 0.3
# Knots of functions of drift or rate, of both together, of time and of a covariate.
KNOTS = 9
KNOTS_OF_SURFACE = 4
KNOTS_OF_TIME = 7
KNOTS_OF_COVARIATE = 5
# Least distance of knots, as a share of the range.
LEAST_DISTANCE = 0.02

_DRIFT = ["powers", "drift"]
_RATE = ["jump", "rate powers", "rate"]
_SURFACE = [*_RATE, *_DRIFT, "surface"]
# Groups of the rows of the table of shares beside constant and linear terms, simplest
# first.
ROWS: dict[str, list[str]] = {
    Dependence.CONSTANT.value: [],
    Dependence.LINEAR.value: [],
    Dependence.LINE.value: ["line"],
    Dependence.DRIFT.value: _DRIFT,
    Dependence.RATE.value: _RATE,
    Dependence.COVARIATE.value: [],
    Dependence.TIME.value: ["time"],
    Dependence.SURFACE.value: _SURFACE,
    Dependence.PATH.value: [*_SURFACE, "sliders"],
}


class Basis:
    """Groups of columns, with knots and scales of the motions they were made for."""

    def __init__(self, motions: Sequence[Motion]) -> None:
        self.motions = motions
        self.drift = rms_of_all([motion.s for motion in motions])
        self.rate = rms_of_all([motion.v for motion in motions])
        # name of each group that changes in time, with its signal and number of knots
        self.changing: dict[str, tuple[str, int]] = {}
        if all(motion.t is not None for motion in motions):
            self.changing["time"] = ("t", KNOTS_OF_TIME)
        for name in self._moving_covariates():
            self.changing[f"covariate {name}"] = (name, KNOTS_OF_COVARIATE)

        axes = [(axis, n) for axis in "sv" for n in (KNOTS, KNOTS_OF_SURFACE)]
        axes += self.changing.values()
        self._knots: dict[tuple[str, int], np.ndarray] = {}
        for axis, count in axes:
            signal = np.concatenate([_signal(motion, axis) for motion in motions])
            self._knots[axis, count] = knots_of(signal, count)

    def _moving_covariates(self) -> list[str]:
        """Covariates that all motions have and that change in one of them."""
        names = []
        for name in self.motions[0].covariates:
            shared = all(name in motion.covariates for motion in self.motions)
            if shared:
                ranges = [np.ptp(motion.covariates[name]) for motion in self.motions]
                if max(ranges) > 0:
                    names.append(name)
        return names

    def _hats(self, motion: Motion, axis: str, count: int) -> np.ndarray:
        """Piecewise linear functions that are 1 at one knot and 0 at the others.

        Constant beyond the ends.
        """
        signal, knots = _signal(motion, axis), self._knots[axis, count]
        hats = [np.interp(signal, knots, hat) for hat in np.eye(len(knots))]
        return np.column_stack(hats)

    def groups(self, motion: Motion) -> dict[str, np.ndarray]:
        """All groups by name.

        With those named in ``ROWS`` they make a row of the table of shares.
        """
        s, v = motion.s, motion.v
        x, y = s / self.drift, v / self.rate
        sign, unity = np.sign(v), np.ones(motion.n_samples)
        linear = [s, v] if motion.a is None else [s, v, motion.a]
        rate_powers = [y * np.abs(y), y**2, y**3, y**4, y**5]

        groups = {
            "constant": unity[:, None],
            "linear": np.column_stack(linear),
            "powers": np.column_stack([x**2, x**3, x**4, x**5]),
            "drift": self._hats(motion, "s", KNOTS),
        }
        for k, gap in enumerate(GAPS):
            groups[f"gap {k}"] = np.maximum(np.column_stack([x, -x]) - gap, 0.0)
        groups["jump"] = sign[:, None]
        groups["rate powers"] = np.column_stack(rate_powers)
        groups["rate"] = self._hats(motion, "v", KNOTS)
        groups["surface"] = np.column_stack([self._surface(motion), sign * x])
        groups["sliders"] = sliders(motion, self.drift, YIELD_DRIFTS)

        carriers = np.column_stack([unity, x, y, sign])
        for name, axis in self.changing.items():
            groups[name] = _products(self._hats(motion, *axis), carriers)
        return groups

    def _surface(self, motion: Motion) -> np.ndarray:
        """Functions of drift and rate together."""
        of_drift = self._hats(motion, "s", KNOTS_OF_SURFACE)
        of_rate = self._hats(motion, "v", KNOTS_OF_SURFACE)
        return _products(of_drift, of_rate)


def _signal(motion: Motion, axis: str) -> np.ndarray:
    """Drift, rate, time or a covariate of a motion."""
    if axis in ("s", "v", "t"):
        return np.asarray(getattr(motion, axis), dtype=float)
    return np.asarray(motion.covariates[axis], dtype=float)


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of every column of a with every column of b."""
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)


def knots_of(x: np.ndarray, count: int) -> np.ndarray:
    """Knots at quantiles and at even distances, so that rare large values have some.

    Zero is one of them where it is inside.
    """
    least = LEAST_DISTANCE * np.ptp(x)
    if least == 0:
        return np.array([x[0] - 1.0, x[0] + 1.0])

    even = np.linspace(x.min(), x.max(), count)
    quantiles = np.quantile(x, np.linspace(0, 1, count))
    knots = np.unique(np.concatenate([even, quantiles]))
    knots = knots[np.abs(knots) > least]
    knots = knots[np.concatenate([[True], np.diff(knots) > least])]
    return np.sort(np.append(knots, 0.0)) if x.min() <= 0 <= x.max() else knots
