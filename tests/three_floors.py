"""Chains of 10 kg floors on linear storeys, with further laws, and their records."""

from pysindy_nrf import ChainModel, laws
from pysindy_nrf.simulation import add_noise, free_run
from pysindy_nrf.simulation.excitation import band_limited_random

FS = 500.0
STOREY = laws.PowerSeries(1, [60.0, 5e4])


def chain(*extra, n=3):
    """Masses of 10 kg on linear storeys; further laws as pairs (storey, law)."""
    by_storey = {storey: [STOREY] for storey in range(1, n + 1)}
    for storey, law in extra:
        by_storey[storey].append(law)
    return ChainModel([10.0] * n, by_storey)


def run(model, dofs, rms=100.0, duration=16.0, seed=0):
    F = band_limited_random(
        model.n_dof,
        duration,
        FS,
        excited=dofs,
        rms=rms,
        band=(0.5, 40),
        random_state=seed,
    )
    return free_run(model, F, 1 / FS)


def features(result):
    return result.record.to_features(smooth=False)


def noisy(result, level, seed=0):
    return add_noise(result.record, level, random_state=seed).to_features()
