"""Prints the numbers of fits, a free run and, with the word "loop", of a loop.

They are printed to the last bit, so that processes can be compared.
"""

import json
import sys
import warnings

import numpy as np

from pysindy_nrf import ChainModel, NRFRegressor, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise

STOREY = [laws.LinearElastic(1e5), laws.LinearViscous(80.0)]
CATALOGUE = [laws.CoulombFriction(), laws.Dahl(), laws.CubicStiffness()]


def noisy_record():
    with_dahl = STOREY + [laws.Dahl(sigma=3e3, Fd=30.0)]
    truth = ChainModel([10.0, 12.0, 9.0], {1: with_dahl, 2: STOREY, 3: STOREY})
    F = excitation.band_limited_random(
        3, 2.0, 1000.0, excited=2, rms=100.0, band=(1, 60), random_state=3
    )
    return add_noise(simulate(truth, F, 1e-3), 0.01, random_state=4)


def numbers_of_fits(record):
    X, F = record.to_features()
    with_law = NRFRegressor(degree=3, laws={1: [laws.PowerSeries(1), laws.Dahl()]})
    with_law.fit(X, F)
    plain = NRFRegressor(degree=3).fit(X, F)
    forces = plain.restoring_forces_.values()
    return {
        "features": X.to_numpy()[::97],
        "masses": with_law.masses_,
        "sigma": with_law.model_.laws["storey 1"][1].shape["sigma"],
        "coefficients": np.concatenate([force.coefficients for force in forces]),
        "intervals": plain.confidence_intervals()[["lower", "upper"]],
        "modes": plain.modes(),
        "free run": simulate(with_law.model_, F.to_numpy()[:800], dt=1e-3).displacement,
    }


def numbers_of_loop(record):
    report = close_loop(record, catalogue=CATALOGUE, max_steps=1, random_state=6)
    return {
        "loop": report.table.select_dtypes("number"),
        "loop model": report.model.masses,
    }


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    record = noisy_record()
    numbers = numbers_of_fits(record)
    if "loop" in sys.argv:
        numbers |= numbers_of_loop(record)
    texts = {}
    for name, values in numbers.items():
        flat = np.ravel(np.asarray(values, dtype=float))
        texts[name] = [float(value).hex() for value in flat]
    print(json.dumps(texts))
