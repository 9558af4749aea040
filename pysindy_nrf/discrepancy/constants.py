"""Every number by which the loop decides, with its derivation, its source or the
measurement behind it.

Measured on: the simulated battery (`benchmarks/discrepancy_battery.py`, seeds 3 to 11,
31 and 41) and the records EMPS, Silverbox, dry friction 60.52 and 70.83, the shaken
frame, MR dampers, friction damper and Bouc-Wen benchmark. What bounds the effort of a
computation (iterations, points of a drawing, memory) stands where it is used.
"""

from math import log10
from typing import Final

from scipy.stats import chi2

# -- samples -------------------------------------------------------------------

# Noise of every channel, as a share of its rms, below which the channels are taken as
# they are: the bias of least squares is its square, 2e-5 of a mass or a stiffness.
CLEAN: Final = 0.004
# Windows that the records of a search hold side by side. Fewer leave no three windows
# for each of ten folds, more widen the lowest band; between 40 and 120 the records
# above give the same effects.
WINDOWS: Final = 60
# Ten folds: the usual bias and variance of cross-validation (Kohavi 1995).
FOLDS: Final = 10
# A quarter is held out, in pieces of at least four half windows: longer than the memory
# of filters and windows.
HELD_OUT: Final = 0.25
SHORTEST_PIECE: Final = 4
# Numbers of held-out pieces that are tried; that which holds its share of the energy of
# every channel is taken. Fewer pieces must come nearer to it, by 2 % for each.
PIECES: Final = {4: 0.0, 3: 0.02, 2: 0.04}

# -- bands ---------------------------------------------------------------------

# Bands, equal on a logarithmic axis: about eight to the decade over three decades.
BANDS: Final = 24
# The core of a balance: bands that hold 90 % of its energy.
ENERGY: Final = 0.9
# A band is informative if a chain explains more than half of it: then the signal
# exceeds what is not explained.
EXPLAINED: Final = 0.5
# Share of the reference that no measurement tells from zero, 0.1 %: 16 bits resolve
# 3e-5 of a range, ten times the rms.
FLOOR: Final = 1e-3
# An order of magnitude: what is less than a tenth of its counterpart is next to
# nothing. Errors are reported in bands that leave at most ten times (10 dB) the typical
# share (the top band of the Silverbox leaves 30 dB more), a wrong sign counts from a
# tenth of the force, an effect cancels a declared mass if a tenth of it is left.
TENTH: Final = 0.1

# -- the search ----------------------------------------------------------------

# Draws of chance: its gain exceeds four of its own in one case of five, and a draw
# costs a search.
DRAWS: Final = 4
# Squares of likely errors of the channels, in standard deviations: nine in ten of those
# that act as one law does. Those of imperfect sensors that a law stood in for need less
# than 2 (seed 1701), to act as a tie of 4 % takes 3.9 (1901).
LIKELY: Final = float(chi2.ppf(1 - TENTH, 1))

# -- the judge -----------------------------------------------------------------

# Least gain of an effect, dB, also without the fold that speaks most for it (half of it
# then). Where nothing is missing the best of all candidates gains at most 0.1 dB;
# effects of the battery gain 1.1 dB and more at 5 % noise.
LEAST_GAIN: Final = 0.5
# An effect matters if it changes the force at its site by 3 %, or lowers the residual
# by 2 dB (a fifth); a force of one frequency by 2 dB there (seeds 1501, 1701: forces
# 5.3 dB and more, pink noise of sensors 1.1 and 1.4). One that does both beyond a
# standard error is not compared with chance.
LEAST_SHARE: Final = 0.03
LARGE_GAIN: Final = 2.0
# Errors that every channel may have where nothing else is said: gain and part of
# another DOF's channel as shares, delay in samples; rectangular (GUM), so that
# calibrations and mountings scatter by 1.2 %. All of them together explain an effect if
# their squares are at most the median for one error a channel. Without that limit
# chains with imperfect sensors alone use 0.6 to 1.5 times it (seed 401), a tie to the
# ground that changes a balance by 2 % uses 2.6 times.
TOLERANCES: Final = {"gain": 0.02, "cross_axis": 0.02, "delay": 0.4}
# Standard errors beyond which a gain is sure (95 %); families are tied within one.
FAR: Final = 2.0

# -- the conclusion ------------------------------------------------------------

# Least gain of an effect that the model holds, dB: what it leaves is less by a tenth.
CLAIMED: Final = -20 * log10(1 - TENTH)
# Nothing is claimed where a balance keeps 80 % of its force (64 % of its power).
HOPELESS: Final = 80.0
# A name is sure if at most 5 % of the effect stays beyond 1.2 times what noise leaves:
# right names of the battery leave 0.7 to 1.1 times it, names that stand in for a
# withheld law 1.4 times.
COMPLETE: Final = 0.05
BY_NOISE: Final = 1.2
# Periods in a window of a free run: long enough to accumulate a wrong frequency, short
# of the loss of phase.
PERIODS: Final = 10

# -- the evidence, which informs the page and decides nothing ------------------

# A residual within this factor of the noise floor is at the floor: from one draw of
# noise the floor is known no better (battery, nothing hidden: 0.8 to 1.31).
AT_FLOOR: Final = 1.5
# Shares of squares that differ by less are alike, and what explains less matters to
# nobody: two standard errors of a share over 25 blocks (1 to 3 points on forces of
# known kind with 5 % noise).
NEARLY: Final = 0.04
