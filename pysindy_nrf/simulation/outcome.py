"""How an integration ended."""

from typing import NamedTuple

from ..exceptions import DivergenceError, SimulationError

# Why a run ended.
DONE = 0
DIVERGED = 1
CRAWLS = 2
# Steps a sample, on average over the samples so far, beyond which a run is given up.
PATIENCE = 250


class StepCounts(NamedTuple):
    """Steps of an integration.

    Attributes
    ----------
    accepted, rejected : int
        Number of steps taken, and tried in vain.
    forced : int
        Steps taken with too large an error.
    """

    accepted: int
    rejected: int
    forced: int


class Outcome(NamedTuple):
    """Why a run ended, in which interval and at which DOF, and its steps."""

    why: int
    interval: int
    dof: int
    steps: StepCounts

    def require_done(self, dt: float) -> None:
        """Raise an error if the run has not reached its end."""
        time = self.interval * dt
        if self.why == CRAWLS:
            raise SimulationError(
                f"Up to {time:.6g} s the free run took more than {PATIENCE} steps a"
                " sample: a law is far stiffer than the sampling, or two laws at one"
                " site make it chatter",
                "Use method='newmark', a shorter dt, or one law instead of two at a"
                " site that sticks.",
            )
        if self.why == DIVERGED:
            raise DivergenceError(
                f"The free run diverges at {time:.6g} s, at DOF {self.dof + 1}",
                "The model is unstable there (a softening or negative term beyond the"
                " range it was fitted in), or dt is too long for its stiffness: lower"
                " the force, the degree or dt.",
            )
