"""Tests under loads that laboratories use and that other benchmarks do not.

    python benchmarks/unusual_loads.py                          # 45 tests, twice
    python benchmarks/unusual_loads.py --seed 1000 --tests 30   # other structures
    python benchmarks/unusual_loads.py --quick                  # the first two loads

Chains of 1 to 4 floors have one force, or one on every floor, a moving base, or a
release. Some of acceleration, velocity and displacement are measured, with 0.2 to 1 %
noise. Each chain is tested as it is, and with one law hidden in a storey.

- *accused*: without a hidden law, `NRFRegressor` of degree 1 or 3 has a ground against
  a channel, the wiring or the record, or an alternative that fits better;
- *green, off*: green with a mass that is more than 10 % off;
- *false*: `close_loop` confirms an effect that is not there, in either test;
- *found*: it finds the hidden law first, in class and site. Friction may be given as
  hysteresis: they are alike where an element does not creep.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import search_path
import numpy as np
import pandas as pd
from harness import in_parallel, linear_storeys, markdown, options_of, quietly

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.diagnosis.verdict import Verdict
from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.simulation import add_noise

ACCUSATIONS = {"alternative", "channel", "quality", "wiring"}
OFF = 0.1  # relative error of a mass
FORCE = 1000.0  # N
DEGREES = (1, 3)
MEASURED = (
    ("acceleration", "displacement"),
    ("acceleration",),
    ("acceleration", "velocity"),
    ("acceleration", "velocity", "displacement"),
)
MOTIONS = ("acceleration", "velocity", "displacement")

# -- loads ---------------------------------------------------------------------


@dataclass(frozen=True)
class Clock:
    """Samples of a test, and the frequencies of its chain.

    Attributes
    ----------
    t : ndarray
        s.
    first, last : float
        First natural frequency, and a little more than the last, Hz.
    rng : Generator
    """

    t: np.ndarray
    first: float
    last: float
    rng: np.random.Generator

    @property
    def length(self) -> float:
        return float(self.t[-1])

    @property
    def step(self) -> float:
        return float(self.t[1])


def sine(clock: Clock) -> np.ndarray:
    """One frequency that grows from rest."""
    frequency = clock.first * clock.rng.uniform(0.6, 2.5)
    grows = np.clip(10.0 * clock.t / clock.length, 0.0, 1.0)
    return np.sin(2 * np.pi * frequency * clock.t) * grows


def steps_of_sines(clock: Clock) -> np.ndarray:
    """Eight frequencies, one after the other."""
    frequencies = np.linspace(0.6 * clock.first, clock.last, 8)
    number = np.minimum(8 * clock.t / clock.length, 7).astype(int)
    since = clock.t - number * clock.length / 8
    return np.sin(2 * np.pi * frequencies[number] * since)


def slow_sweep(clock: Clock) -> np.ndarray:
    low = 0.5 * clock.first
    rate = (clock.last - low) / clock.length
    return np.sin(2 * np.pi * (low + 0.5 * rate * clock.t) * clock.t)


def multisine(clock: Clock) -> np.ndarray:
    frequencies = np.arange(0.5 * clock.first, clock.last, 0.5 * clock.first)
    phases = clock.rng.uniform(0, 2 * np.pi, len(frequencies))
    lines = np.cos(2 * np.pi * np.outer(clock.t, frequencies) + phases)
    return lines.sum(axis=1) / np.sqrt(len(frequencies) / 2)


def beating(clock: Clock) -> np.ndarray:
    low = np.sin(2 * np.pi * 0.9 * clock.first * clock.t)
    return low + np.sin(2 * np.pi * 1.05 * clock.first * clock.t)


def modulated(clock: Clock) -> np.ndarray:
    """A sine whose amplitude goes up and down."""
    amplitude = 1 + 0.7 * np.sin(2 * np.pi * 0.1 * clock.first * clock.t)
    return amplitude * np.sin(2 * np.pi * 1.3 * clock.first * clock.t)


def square(clock: Clock) -> np.ndarray:
    started = clock.t > 0.5 / clock.first
    return np.sign(np.sin(2 * np.pi * 0.7 * clock.first * clock.t)) * started


def sawtooth(clock: Clock) -> np.ndarray:
    return 2 * ((0.6 * clock.first * clock.t) % 1) - 1


def half_sines(clock: Clock) -> np.ndarray:
    """Blows that only push."""
    width = 0.25 / clock.first
    since = (clock.t - 1 / clock.first) % (6 / clock.first)
    hit = (clock.t > 1 / clock.first) & (since < width)
    return np.where(hit, np.sin(np.pi * since / width), 0.0)


def noise(clock: Clock) -> np.ndarray:
    values = excitation.band_limited_random(
        1,
        clock.length + clock.step,
        1 / clock.step,
        excited=1,
        rms=1.0,
        band=(0.3 * clock.first, clock.last),
        random_state=int(clock.rng.integers(1_000_000)),
    )[:, 0]
    return np.resize(values, len(clock.t))


def bursts(clock: Clock) -> np.ndarray:
    return noise(clock) * ((4 * clock.t / clock.length) % 1 < 0.4)


def quiet_lead(clock: Clock) -> np.ndarray:
    return noise(clock) * (clock.t > 0.3 * clock.length)


def shock(clock: Clock) -> np.ndarray:
    """Noise that comes and goes, as an earthquake."""
    middle, width = clock.length / 3, clock.length / 6
    return noise(clock) * np.exp(-(((clock.t - middle) / width) ** 2))


def nothing(clock: Clock) -> np.ndarray:
    return np.zeros_like(clock.t)


LOADS: dict[str, Callable[[Clock], np.ndarray]] = {
    "sine": sine,
    "square": square,
    "half sines": half_sines,
    "steps of sines": steps_of_sines,
    "slow sweep": slow_sweep,
    "multisine": multisine,
    "beating": beating,
    "modulated": modulated,
    "sawtooth": sawtooth,
    "bursts": bursts,
    "quiet lead": quiet_lead,
    "every floor": noise,
    "base": shock,
    "release": nothing,
    "release in noise": noise,
}

# -- tests ---------------------------------------------------------------------


@dataclass(frozen=True)
class Test:
    """A chain under a load, as it is measured."""

    load: str
    model: ChainModel
    simulation: dict[str, np.ndarray]
    step: float
    measured: tuple[str, ...]
    noise: float
    seed: int

    @property
    def known_masses(self) -> dict[int, float] | None:
        """Mass of the first floor where no force scales the chain."""
        if self.load in ("base", "release"):
            return {1: float(self.model.masses[0])}
        return None

    def clean_record(self, model: ChainModel) -> Record:
        return simulate(model, dt=self.step, **self.simulation)

    def record(self, model: ChainModel) -> Record:
        """What is measured of a model under the load."""
        missing = {name: None for name in MOTIONS if name not in self.measured}
        record = self.clean_record(model).replace(**missing)
        return add_noise(record, self.noise, random_state=self.seed)


def drawn(load: str, seed: int) -> Test:
    """A test with random masses, stiffnesses, length, rate and channels."""
    rng = np.random.default_rng([seed, 63])
    n = int(rng.integers(2 if load == "base" else 1, 5))
    masses = rng.uniform(800, 1500, n)
    stiffness = rng.uniform(1e6, 3e6, n)
    damping = stiffness * rng.uniform(5e-4, 2e-3)
    model = ChainModel(masses, linear_storeys(stiffness, damping))

    frequencies = model.modes()["frequency"].to_numpy()
    fs = round(float(rng.choice([10, 20, 40])) * frequencies[-1])
    seconds = float(rng.choice([40, 100])) / frequencies[0]
    t = np.arange(0, seconds, 1 / fs)
    clock = Clock(t, frequencies[0], 1.3 * frequencies[-1], rng)

    F = np.zeros((len(t), n))
    simulation = {"F": F}
    forced = list(range(n)) if load == "every floor" else [int(rng.integers(n))]
    if load == "base":
        simulation["base_acceleration"] = 2.0 * LOADS[load](clock)
    else:
        for j in forced:
            F[:, j] = FORCE * LOADS[load](clock)
    if load.startswith("release"):
        simulation["x0"] = np.cumsum(rng.uniform(0.001, 0.003, n))

    measured = MEASURED[rng.integers(len(MEASURED))]
    level = float(rng.choice([0.002, 0.005, 0.01]))
    return Test(load, model, simulation, 1 / fs, measured, level, seed)


@dataclass(frozen=True)
class Hidden:
    """A law that is hidden at a site, and the classes that are right."""

    site: str
    law: laws.ForceLaw
    classes: frozenset[str]

    def is_found_by(self, step: Step) -> bool:
        return step.site == self.site and step.effect_class in self.classes


def hidden_law(test: Test) -> Hidden:
    """What is hidden, scaled to the motion without it."""
    rng = np.random.default_rng([test.seed, 64])
    run = test.clean_record(test.model)
    j = int(rng.integers(test.model.n_dof))
    s = np.diff(run.displacement, axis=1, prepend=0.0)[:, j].std()
    v = np.diff(run.velocity, axis=1, prepend=0.0)[:, j].std()
    _, k = test.model.coefficients[f"storey {j + 1}"]
    site = f"storey {j + 1}"
    if rng.random() < 0.4:
        friction = laws.CoulombFriction(0.08 * k * s)
        return Hidden(site, friction, frozenset({"memoryless", "hysteresis"}))

    choices = [
        laws.CubicStiffness(0.1 * k / s**2),
        laws.QuadraticDamping(0.15 * k * s / v**2),
        laws.TwoSidedGap(s, k),
    ]
    law = choices[rng.integers(len(choices))]
    return Hidden(site, law, frozenset({"memoryless"}))


# -- runs ----------------------------------------------------------------------


def is_accused(verdict: Verdict) -> bool:
    return any(ground.kind in ACCUSATIONS for ground in verdict.grounds)


def run(load: str, seed: int) -> dict[str, object]:
    """Counts of one test without and with a hidden law."""
    test = drawn(load, seed)
    known = test.known_masses
    record = test.record(test.model)
    n_accused, n_off = 0, 0
    for degree in DEGREES:
        fitted = NRFRegressor(degree=degree, known_masses=known).fit(record)
        verdict = fitted.verdict()
        errors = np.abs(fitted.model_.masses / test.model.masses - 1)
        n_accused += is_accused(verdict)
        n_off += verdict.state == "green" and errors.max() > OFF

    hidden = hidden_law(test)
    at_site = [*test.model.laws[hidden.site], hidden.law]
    with_law = {**test.model.laws, hidden.site: at_site}
    other = test.record(ChainModel(test.model.masses, with_law))
    baseline = NRFRegressor(degree=1, known_masses=known)
    without = confirmed_steps(record, baseline)
    claims = confirmed_steps(other, baseline)

    right = [hidden.is_found_by(step) for step in claims]
    return {
        "load": load,
        "seed": seed,
        "accused": n_accused,
        "green, off": n_off,
        "false": len(without) + len(claims) - sum(right),
        "found": int(any(right[:1])),
        "hidden": f"{hidden.law.name} at {hidden.site}",
        "claimed": ", ".join(f"{s.law} at {s.site}" for s in [*without, *claims]),
    }


def confirmed_steps(record: Record, baseline: NRFRegressor) -> list[Step]:
    return [step for step in close_loop(record, baseline).steps if step.confirmed]


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Run all, print counts by load and the tests that fail."""
    parser = options_of(__doc__, quick="the first two loads")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tests", type=int, default=45, help="numbers of tests")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)

    n_tests = 2 if options.quick else options.tests
    loads = np.resize(list(LOADS), n_tests).tolist()
    tasks = [(load, options.seed + k) for k, load in enumerate(loads)]
    table = pd.DataFrame(in_parallel(run, tasks, options.jobs))

    counts = table.groupby("load", sort=False)[
        ["accused", "green, off", "false", "found"]
    ].sum()
    counts.insert(0, "tests", table.groupby("load", sort=False).size())
    counts.loc["all"] = counts.sum()
    print(markdown(counts.reset_index()))

    failed = (table["accused"] > 0) | (table["false"] > 0) | (table["found"] == 0)
    print()
    print(markdown(table[failed | (table["green, off"] > 0)]))
    return table


if __name__ == "__main__":
    quietly(main)
