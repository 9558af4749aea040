"""A wrong gain that is found before another effect is known is estimated again beside it."""

from __future__ import annotations

import integrated
import numpy as np
import pytest

from pysindy_nrf import Record, close_loop, laws

pytestmark = [pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning"), pytest.mark.slow]


@pytest.mark.parametrize("gain", [0.1, -0.15])
def test_a_gain_beside_a_cubic_spring(gain):
    fs, rng = 250.0, np.random.default_rng(0)
    push = integrated.multisine(rng, fs, 20.0, (0.5, 25.0), 100.0)
    cubic = 6e6

    def hard(v, x):  # storey 2
        force = cubic * (x[1] - x[0]) ** 3
        return np.array([force, -force])

    a, _, x, t = integrated.run(
        [10.0, 8.0], [60.0, 60.0], [4e4, 3e4], fs, 20.0, lambda t: np.array([0.0, push(t)]), extra=hard
    )
    noise = rng.standard_normal((len(t), 4))
    record = Record(
        acceleration=a + 0.01 * a.std(axis=0) * noise[:, :2],
        displacement=(1 + np.array([0.0, gain])) * (x + 0.005 * x.std(axis=0) * noise[:, 2:]),
        force=np.column_stack([0 * t, push(t)]),
        fs=fs,
    )
    report = close_loop(record, catalogue=[laws.GainError(), laws.CubicStiffness(), laws.CoulombFriction()])
    told = {(step.law, step.site): step for step in report.steps}
    assert set(told) == {("gain_error", "sensor x2"), ("cubic_stiffness", "storey 2")}
    step = told["gain_error", "sensor x2"]
    assert step.parameters["e"] == pytest.approx(gain, abs=0.001)
    low, high = step.intervals["e"]
    assert report.steps[0] is step and low < gain < high and high - low < 0.01
