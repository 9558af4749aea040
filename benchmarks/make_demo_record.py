"""Make the bundled demonstration record: a shaken three-storey frame with a hardening
ground storey.

    python benchmarks/make_demo_record.py            # writes pysindy_nrf/datasets/demo_record.csv

The truth is ``pysindy_nrf.datasets.demo_truth``; the record holds what sensors would:
the shaker's force on floor 2 and accelerations and displacements of three floors with 2
% noise (share of each channel's rms).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pysindy_nrf import Record, simulate
from pysindy_nrf.common.files import atomic_write
from pysindy_nrf.datasets import demo_truth
from pysindy_nrf.simulation.excitation import band_limited_random
from pysindy_nrf.simulation.noise import add_noise

FS, DURATION, OVERSAMPLING, NOISE, SEED = 200.0, 20.0, 10, 0.02, 20240501


def measure() -> Record:
    """Shake the frame on floor 2 and record it with noisy sensors."""
    rate = FS * OVERSAMPLING
    force = band_limited_random(
        3, DURATION, rate, excited=2, rms=80.0, band=(1.0, 25.0), random_state=SEED
    )
    run = simulate(demo_truth(), force, 1.0 / rate, hold="cubic")
    F, a, x = (
        channel[::OVERSAMPLING]
        for channel in (run.force, run.acceleration, run.displacement)
    )
    record = Record(force=F, acceleration=a, displacement=x, fs=FS, name="demo")
    return add_noise(
        record, NOISE, random_state=np.random.default_rng(SEED)
    )  # the stream the record was made with


def main(
    path: str | Path = Path(__file__).parents[1]
    / "pysindy_nrf"
    / "datasets"
    / "demo_record.csv",
) -> None:
    """Write the record in SI units, so that reading it needs no package for units."""
    record = measure()
    table = record.to_frame()
    lines = [
        "# Three-storey frame, shaker on floor 2, simulated with 2 % noise"
        " (benchmarks/make_demo_record.py)"
    ]
    lines.append("t [s],F2 [N],a1 [m/s^2],a2 [m/s^2],a3 [m/s^2],x1 [m],x2 [m],x3 [m]")
    columns = ["F2", "a1", "a2", "a3", "x1", "x2", "x3"]
    for time, row in zip(table.index, table[columns].to_numpy()):
        lines.append(f"{time:.3f}," + ",".join(f"{value:.4g}" for value in row))
    with atomic_write(path) as file:
        file.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
