"""Make the bundled record: a shaken three-storey frame with a hardening ground storey.

    python benchmarks/make_demo_record.py   # pysindy_nrf/datasets/demo_record.csv

The truth is ``pysindy_nrf.datasets.demo_truth``; the record holds what sensors would:
the shaker's force on floor 2 and accelerations and displacements of three floors with 2
% noise (share of each channel's rms).
"""

from __future__ import annotations

from pathlib import Path

import search_path
import numpy as np
from harness import options_of

from pysindy_nrf import Record, datasets, excitation, simulate
from pysindy_nrf.simulation.noise import add_noise

FS = 200.0  # Hz
DURATION = 20.0  # s
OVERSAMPLING = 10
NOISE = 0.02
SEED = 20240501
CSV = search_path.ROOT / "pysindy_nrf" / "datasets" / "demo_record.csv"
COMMENT = (
    "# Three-storey frame, shaker on floor 2, simulated with 2 % noise"
    " (benchmarks/make_demo_record.py)"
)
# SI units, so that reading the file needs no package for units
UNITS = {"F": "N", "a": "m/s^2", "x": "m"}
CHANNELS = ("F2", "a1", "a2", "a3", "x1", "x2", "x3")


def measure() -> Record:
    """Shake the frame on floor 2 and record it with noisy sensors."""
    rate = FS * OVERSAMPLING
    force = excitation.band_limited_random(
        3, DURATION, rate, excited=2, rms=80.0, band=(1.0, 25.0), random_state=SEED
    )
    run = simulate(datasets.demo_truth(), force, 1.0 / rate, hold="cubic")
    record = Record(
        force=run.force[::OVERSAMPLING],
        acceleration=run.acceleration[::OVERSAMPLING],
        displacement=run.displacement[::OVERSAMPLING],
        fs=FS,
        name="demo",
    )
    # the stream of random numbers that the record was made with
    return add_noise(record, NOISE, random_state=np.random.default_rng(SEED))


def as_text(record: Record) -> str:
    """The record as delimited text, four digits a number."""
    header = [f"{channel} [{UNITS[channel[0]]}]" for channel in CHANNELS]
    lines = [COMMENT, ",".join(["t [s]", *header])]
    table = record.to_frame()[list(CHANNELS)]
    for time, row in zip(table.index, table.to_numpy()):
        lines.append(",".join([f"{time:.3f}", *(f"{value:.4g}" for value in row)]))
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> None:
    """Write the record."""
    parser = options_of(__doc__)
    parser.add_argument("path", type=Path, nargs="?", default=CSV)
    options = parser.parse_args(arguments)
    options.path.write_text(as_text(measure()), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
