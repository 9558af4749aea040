"""Compiles what most tests need, once: two test processes that start together would
each compile it for themselves.
"""

import warnings

from pysindy_nrf import ChainModel, NRFRegressor, close_loop, excitation, laws, simulate

warnings.simplefilter("ignore")
linear = [laws.LinearElastic(1e5), laws.LinearViscous(80.0)]
truth = ChainModel(
    [10.0, 12.0], {1: [*linear, laws.Dahl(sigma=3e3, Fd=30.0)], 2: linear}
)
F = excitation.band_limited_random(
    2, 4.0, 500.0, excited=2, rms=100.0, band=(1, 60), random_state=3
)
record = simulate(truth, F, 1 / 500)
simulate(truth, F, 1 / 500, method="newmark")
NRFRegressor(degree=7, estimation="iv").fit(record)
close_loop(record, max_steps=1)
