"""Free runs of identified chains under another excitation, by defaults.

    python benchmarks/free_runs.py [--quick] [--chains 60]

Chains of one to four floors, with one law of some kind at a storey and linear storeys
beside; one or all floors are forced, 1 % of noise is on forces, accelerations and
displacements. The law is declared without its values, and nothing else. The model then
runs alone under random forces of another band. The error is that of its displacements
against the true ones, without noise. Beside it stands what the verdict
says of the model, and whether the run gave a ``SensitivityWarning``: a large error that
is not green, or came with a warning, was said. ``docs/published.md`` has
the table. ``--quick`` runs a linear chain, one with a cubic spring, and one that is
chaotic under the other forces.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import search_path
import numpy as np
import pandas as pd
from harness import linear_storeys, markdown, options_of, quietly
from tqdm import tqdm

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import NRFError, SensitivityWarning
from pysindy_nrf.laws.base import ForceLaw
from pysindy_nrf.simulation.noise import add_noise

FS = 250.0  # Hz
DURATION = 24.0  # s
NOISE = 0.01
FORCE = 100.0  # N, rms
OTHER_BAND = (1.0, 15.0)  # Hz, of the excitation that the fit did not see
QUICK = (0, 1, 36)
HEADER = ("law", "chains", "median, %", "worst, %", "worst unsaid, %", "fit, s")


@dataclass(frozen=True)
class Chain:
    """A true chain, its declared laws, and the floors that are forced."""

    kind: str
    truth: ChainModel
    declared: dict[str, list[ForceLaw]]
    forced: tuple[int, ...]


@dataclass(frozen=True)
class Outcome:
    """Percent of the true displacements, what was said, and seconds of the fit."""

    kind: str
    error: float
    colour: str
    warned: bool
    seconds: float

    @property
    def said(self) -> bool:
        """Whether something warns of a large error."""
        return self.colour != "green" or self.warned


def linear(k: float, c: float, drift: float) -> tuple[ForceLaw, ...]:
    return ()


def cubic(k: float, c: float, drift: float) -> tuple[ForceLaw, ...]:
    """A third of the linear force at twice the rms drift."""
    return (laws.CubicStiffness(k / 3 / (2 * drift) ** 2),)


def friction(k: float, c: float, drift: float) -> tuple[ForceLaw, ...]:
    """A tenth of the rms force of the spring."""
    return (laws.CoulombFriction(0.1 * k * drift),)


def dahl(k: float, c: float, drift: float) -> tuple[ForceLaw, ...]:
    """A fifth of the rms force of the spring, at once."""
    return (laws.Dahl(sigma=5.0 / drift, Fd=0.2 * k * drift),)


def bouc_wen(k: float, c: float, drift: float) -> tuple[ForceLaw, ...]:
    """As stiff as half of the spring, bending at the rms drift."""
    return (laws.BoucWen(beta=1.0 / drift, rho=0.2, n=1.5, alpha=0.5 * k),)


KINDS = (linear, cubic, friction, dahl, bouc_wen)
# The laws as they are declared, without values.
DECLARED = {
    "linear": (),
    "cubic": (laws.CubicStiffness(),),
    "friction": (laws.CoulombFriction(),),
    "dahl": (laws.Dahl(),),
    "bouc_wen": (laws.BoucWen(),),
}


def drawn(number: int) -> Chain:
    """A chain by its number."""
    rng = np.random.default_rng([number, 61])
    law = KINDS[number % len(KINDS)]
    kind = law.__name__
    n = int(rng.integers(1, 5))
    masses = rng.uniform(5.0, 20.0, n)
    k = rng.uniform(2e4, 8e4, n)
    c = rng.uniform(0.01, 0.04, n) * 2 * np.sqrt(k * masses)
    storey = int(rng.integers(1, n + 1))
    forced = tuple(range(1, n + 1)) if rng.random() < 0.5 else (n,)

    storeys = linear_storeys(k, c)
    plain = ChainModel(masses, storeys)
    run = simulate(plain, random_force(n, forced, [number, 1]), 1 / FS)
    drift = np.diff(run.displacement, axis=1, prepend=0.0)[:, storey - 1]
    size = float(np.sqrt(np.mean(drift**2)))
    there = f"storey {storey}"
    storeys[there] += law(k[storey - 1], c[storey - 1], size)
    declared = {}
    if DECLARED[kind]:
        declared[there] = [laws.PowerSeries(1), *DECLARED[kind]]
    return Chain(kind, ChainModel(masses, storeys), declared, forced)


def random_force(
    n: int,
    forced: Sequence[int],
    seed: list[int],
    band: tuple[float, float] = (0.5, 30),
) -> np.ndarray:
    return excitation.band_limited_random(
        n, DURATION, FS, excited=forced, rms=FORCE, band=band, random_state=seed
    )


def outcome(number: int) -> Outcome:
    """Fit a chain by defaults, and run the model under the sweep."""
    chain = drawn(number)
    n = chain.truth.n_dof
    exact = simulate(chain.truth, random_force(n, chain.forced, [number, 2]), 1 / FS)
    noisy = add_noise(exact, NOISE, random_state=[number, 3])
    record = noisy.replace(velocity=None, hold=None)

    began = time.process_time()
    model = NRFRegressor(degree=1, laws=chain.declared or None).fit(record)
    seconds = time.process_time() - began
    colour = model.verdict().state

    F = random_force(n, chain.forced, [number, 4], OTHER_BAND)
    true = simulate(chain.truth, F, 1 / FS).displacement
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SensitivityWarning)
        try:
            missed = model.simulate(F, dt=1 / FS).displacement - true
            error = 100 * float(np.sqrt(np.mean(missed**2) / np.mean(true**2)))
        except NRFError:
            error = np.inf
    return Outcome(chain.kind, error, colour, bool(caught), seconds)


def row(kind: str, outcomes: Sequence[Outcome]) -> list[str]:
    """The row of a kind of law, or of all."""
    errors = [o.error for o in outcomes]
    green = sum(o.colour == "green" for o in outcomes)
    unsaid = [o.error for o in outcomes if not o.said]
    return [
        kind,
        f"{len(outcomes)} ({green} green)",
        f"{np.median(errors):.2f}",
        f"{max(errors):.1f}",
        f"{max(unsaid):.1f}" if unsaid else "",
        f"{np.median([o.seconds for o in outcomes]):.1f}",
    ]


def main(arguments: list[str] | None = None) -> None:
    """Print a row for each kind of law, and one for all."""
    parser = options_of(__doc__, quick="three chains, none with memory or friction")
    parser.add_argument("--chains", type=int, default=60)
    options = parser.parse_args(arguments)
    numbers = QUICK if options.quick else range(options.chains)
    outcomes = []
    for number in tqdm(numbers, disable=None, leave=False):
        outcomes.append(quietly(outcome, number))

    rows = []
    for kind in dict.fromkeys(o.kind for o in outcomes):
        rows.append(row(kind, [o for o in outcomes if o.kind == kind]))
    rows.append(row("all", outcomes))
    print(markdown(pd.DataFrame(rows, columns=HEADER)))
    for number, o in zip(numbers, outcomes):
        if o.error > 2.0:
            said = "said" if o.said else "not said"
            print(f"chain {number}, {o.kind}: {o.error:.1f} %, {o.colour}, {said}")


if __name__ == "__main__":
    main()
