"""Every number by which the loop decides, with its derivation, its source or the measurement behind it.

Measured on: the simulated battery (`benchmarks/discrepancy_battery.py`, seeds 3 to 11) and the records EMPS, Silverbox,
dry friction 60.52 and 70.83, the shaken frame, MR dampers, friction damper and Bouc-Wen benchmark.
"""

from __future__ import annotations

from typing import Final

# -- samples ----------------------------------------------------------------------------------

# Windows that the records of a search hold side by side. Fewer leave no three windows for each of ten folds, more widen
# the lowest band; between 40 and 120 the records above give the same effects.
WINDOWS: Final = 60
# Ten folds: the usual bias and variance of cross-validation (Kohavi 1995).
FOLDS: Final = 10
# A quarter is held out, in pieces of at least four half windows: longer than the memory of filters and windows.
HELD_OUT: Final = 0.25
SHORTEST_PIECE: Final = 4
# Numbers of held-out pieces that are tried; that which holds its share of the energy of every channel is taken.
PIECES: Final = (4, 3, 2)

# -- bands ------------------------------------------------------------------------------------

# Bands, equal on a logarithmic axis: about eight to the decade over three decades.
BANDS: Final = 24
# The core of a balance: bands that hold 90 % of its energy.
ENERGY: Final = 0.9
# A band is informative if a chain explains more than half of it: then the signal exceeds what is not explained.
EXPLAINED: Final = 0.5
# Errors are reported where no more than ten times (10 dB) the typical share is left: the top band of the
# Silverbox leaves 30 dB more.
TYPICAL: Final = 10.0
# Share of the reference that no measurement tells from zero, 0.1 %: 16 bits resolve 3e-5 of a range, whose rms
# is a tenth.
FLOOR: Final = 1e-3
# Iterations of bands and weights; both settle in three or four.
ROUNDS: Final = 6

# -- the search -------------------------------------------------------------------------------

# Points of a scan along each axis by the number of shape parameters, and evaluations of the refinement for each.
GRID: Final = {1: 9, 2: 5, 3: 4}
EVALUATIONS: Final = 25
# Candidates that are refined and cross-validated; the right one was among the first three in all battery cases.
FINALISTS: Final = 8
# Spectra kept from one step to the next, bytes.
CACHE: Final = 300_000_000

# -- the judge --------------------------------------------------------------------------------

# Least gain of an effect, dB, also without the fold that speaks most for it (half of it then). Where nothing is missing
# the best of all candidates gains at most 0.1 dB; effects of the battery gain 1.1 dB and more at 5 % noise.
LEAST_GAIN: Final = 0.5
# Below this gain, dB, the whole search is run on a free run of the model with fresh noise, and must gain less there.
BORDER: Final = 2.0
# An effect matters if it changes the force at its site by 3 %, or lowers the residual by 2 dB (a fifth).
LEAST_SHARE: Final = 0.03
LARGE_GAIN: Final = 2.0
# Least gain, dB, of a sensor's fault that no other channel contradicts (three quarters of the power): at 5 % noise the
# bias of least squares beside friction makes the gain of one of several forces worth 5.9 dB.
UNWITNESSED: Final = 6.0
# Families are tied if their gains differ by less than two standard errors (95 %).
FAR: Final = 2.0

# -- the conclusion ---------------------------------------------------------------------------

# Nothing is claimed where a balance keeps 80 % of its force (64 % of its power).
HOPELESS: Final = 80.0
# A name is sure if at most 5 % of the effect stays beyond 1.2 times what noise leaves (right names of the battery leave
# 0.7 to 1.1 times it, names that stand in for a withheld law 1.4 times), and its gain is three
# standard errors.
COMPLETE: Final = 0.05
LEAST_RATIO: Final = 3.0
# Periods in a window of a free run: long enough to accumulate a wrong frequency, short of the loss of phase.
PERIODS: Final = 10
