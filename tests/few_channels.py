"""A frame of four floors, and records with sensors on some floors only."""

import numpy as np
from chains import driven

from pysindy_nrf import ChainModel, Record, laws, simulate
from pysindy_nrf.simulation import add_noise

FS = 250.0
MASSES = [14.0, 11.0, 9.0, 12.0]
STIFFNESS = [1.6e5, 1.2e5, 1.8e5, 1.4e5]
DAMPING = 25.0


def frame(n=4):
    """The lowest n floors."""
    storeys = {
        i: laws.PowerSeries(1, [DAMPING, STIFFNESS[i - 1]]) for i in range(1, n + 1)
    }
    return ChainModel(MASSES[:n], storeys)


def true_parameters(n=4):
    """Masses and stiffnesses of the lowest n floors, by name."""
    masses = {f"m{j}": MASSES[j - 1] for j in range(1, n + 1)}
    stiffness = {f"storey {i}: s": STIFFNESS[i - 1] for i in range(1, n + 1)}
    return masses | stiffness


def parameters(model):
    """Masses and stiffnesses of a model."""
    forces = model.restoring_forces.values()
    stiffness = [force.linear_part()["k"] for force in forces]
    return np.array([*model.masses, *stiffness])


def pushed(model, seconds=8.0, dof=None, fs=FS, seed=1):
    """Free run under a random force on one floor, the top unless another is named."""
    dofs = [dof or model.n_dof]
    return driven(model, dofs, seconds, fs, 100.0, (0.5, 50.0), seed=seed)


def shaken(model, ground, fs=FS, noise=0.0):
    """Free run under a motion of the ground."""
    record = simulate(model, None, 1 / fs, base_acceleration=ground)
    return add_noise(record, noise, random_state=2) if noise else record


def with_sensors(record, floors):
    """The record with accelerometers on some floors only."""
    acceleration = record.acceleration.copy()
    for j in range(record.n_dof):
        if j + 1 not in floors:
            acceleration[:, j] = np.nan
    return Record(
        force=record.force,
        acceleration=acceleration,
        fs=record.fs,
        base_acceleration=record.base_acceleration,
    )
