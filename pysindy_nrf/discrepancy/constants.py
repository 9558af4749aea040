"""Every number by which the loop decides, with its derivation, its source or the measurement behind it."""

from __future__ import annotations

from typing import Final

# -- the ruler --------------------------------------------------------------------------------

BANDS: Final = 24
WINDOWS: Final = 60
FOLDS: Final = 10
HELD_OUT: Final = 0.25
PIECES: Final = (4, 3, 2)
SHORTEST_PIECE: Final = 4
# Share of the reference below which no measurement tells a residual: 0.1 %, -60 dB.
FLOOR: Final = 1e-3
ROUNDS: Final = 6
ENERGY: Final = 0.9
EXPLAINED: Final = 0.5
TYPICAL: Final = 10.0

# -- the search -------------------------------------------------------------------------------

GRID: Final = {1: 9, 2: 5, 3: 4}
EVALUATIONS: Final = 25
FINALISTS: Final = 8
LEAST_GAIN: Final = 0.1
CONFIDENCE: Final = 3.0
LEAST_SHARE: Final = 0.03
LARGE_GAIN: Final = 1.0
FAR: Final = 2.0
BORDER: Final = 0.5

# -- the conclusion ---------------------------------------------------------------------------

HOPELESS: Final = 80.0
COMPLETE: Final = 0.25
LEAST_RATIO: Final = 3.0
PERIODS: Final = 10
