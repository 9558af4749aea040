"""Careless measurements: is a fault refused, named, harmless, or silent?

    python benchmarks/careless.py               # 300 faults, 300 clean records
    python benchmarks/careless.py --quick       # 5 and 2
    python benchmarks/careless.py --silent      # silent cases, accusations in words
    python benchmarks/careless.py --seed 1000   # other chains, noise and places

Cases are sentences of a grammar, fault x channel x size, on random chains of 2 to 4
floors (linear or with one cubic storey, all floors or the lowest forced, 0.2 to 1 %
noise). A case is

- *refused* by an error of the package;
- *named* by a message of ``fit``, ``inspect`` or ``diagnose`` that says the fault at
  its channel, floor or record;
- *right* if masses and stiffnesses are within 3 % (or twice the error without the
  fault), so that it does no harm;
- *silent* otherwise.

Clean records must be left in peace. Measured on 300 faults: 15 refused, 266 named, 16
right, 3 silent. Why these stay silent: a gain or unit of the only force scales all
masses and laws alike and cannot be known from that test. Of 300 clean records none is
accused.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import search_path
import numpy as np
import pandas as pd
from harness import in_parallel, markdown, options_of
from scipy.signal import butter, sosfiltfilt

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records.checks.channel_checks import data_warnings
from pysindy_nrf.simulation.noise import add_noise

FS = 400.0  # Hz
SECONDS = 8.0
BAND = (0.5, 40)  # Hz
CLOSE = 0.03  # relative error of masses and stiffnesses that is right
ACCEPTED = 0.02  # share of silent faults, and of accused records
VERDICTS = ("refused", "named", "right", "silent")
PARTS = {"a": "acceleration", "x": "displacement", "F": "force"}
N = int(FS * SECONDS)
ROWS = np.arange(N)
MIDDLE = np.linspace(-0.5, 0.5, N)  # time from the middle, in durations


# -- clean measurements --------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """Records of a chain, how they are fitted, and the truth."""

    records: list[Record]
    settings: dict[str, Any]
    truth: ChainModel
    rng: np.random.Generator
    # what a message may name: channels, floors, records
    where: set[str] = field(default_factory=set)


def chain(rng: np.random.Generator, n: int, cubic: bool) -> ChainModel:
    """A chain whose first frequency lies at 2 to 4 Hz."""
    m = rng.uniform(6, 16, n)
    k = rng.uniform(0.7, 1.4, n) * (2 * np.pi * 2.5 * n) ** 2 * m.mean()
    c = 0.02 * np.sqrt(k * m)
    storeys: dict[str, list[laws.ForceLaw]] = {}
    for i in range(n):
        storeys[f"storey {i + 1}"] = [
            laws.LinearElastic(k[i]),
            laws.LinearViscous(c[i]),
        ]
    if cubic:
        i = int(rng.integers(n))
        storeys[f"storey {i + 1}"].append(laws.CubicStiffness(k[i] * 2e3))
    return ChainModel(m, storeys)


def case(seed: int, n_records: int = 1, base: bool = False) -> Case:
    """A clean case."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    cubic = bool(rng.random() < 0.3)
    noise = float(rng.choice([0.002, 0.005, 0.01]))
    all_forced = bool(rng.random() < 0.7)
    truth = chain(rng, n, cubic)

    records = []
    for i in range(n_records):
        measure = shaken if base else partial(forced, all_forced=all_forced)
        records.append(measure(truth, rng, noise, name=f"test {i + 1}"))
    settings: dict[str, Any] = {"degree": 3 if cubic else 1}
    if base:
        settings["known_masses"] = dict(enumerate(truth.masses.tolist(), 1))
    return Case(records, settings, truth, rng)


def random_signals(n: int, excited: list[int], rms: float, seed: int) -> np.ndarray:
    return excitation.band_limited_random(
        n, SECONDS, FS, excited=excited, rms=rms, band=BAND, random_state=seed
    )


def forced(
    truth: ChainModel,
    rng: np.random.Generator,
    noise: float,
    all_forced: bool,
    name: str,
) -> Record:
    """A noisy test under random forces on all floors, or on the lowest."""
    seed = int(rng.integers(1 << 30))
    floors = list(range(1, truth.n_dof + 1)) if all_forced else [1]
    F = random_signals(truth.n_dof, floors, 60.0, seed)
    return noisy(simulate(truth, F, 1 / FS, name=name), noise, seed)


def shaken(
    truth: ChainModel, rng: np.random.Generator, noise: float, name: str
) -> Record:
    """A noisy test on a base that shakes."""
    seed = int(rng.integers(1 << 30))
    ag = random_signals(1, [1], 2.0, seed)[:, 0]
    F = np.zeros((N, truth.n_dof))
    run = simulate(truth, F, 1 / FS, base_acceleration=ag, name=name)
    return noisy(run, noise, seed)


def noisy(run: Record, noise: float, seed: int) -> Record:
    """What is measured of a run: no velocity."""
    return add_noise(run, noise, random_state=seed).replace(velocity=None)


# -- faults of one channel -----------------------------------------------------
# a channel, the size of the fault, a generator -> what is read


def rms(y: np.ndarray) -> float:
    return float(np.sqrt(np.mean(y**2)))


def gain(y, factor, rng):
    return factor * y


def inverted(y, size, rng):
    return -y


def late(y, samples, rng):
    return np.interp(ROWS - samples, ROWS, y)


def offset(y, size, rng):
    return y + size * rms(y)


def drifting(y, size, rng):
    return y + size * rms(y) * MIDDLE


def clipped(y, size, rng):
    return np.clip(y, -size * rms(y), size * rms(y))


def softly_clipped(y, size, rng):
    limit = size * rms(y)
    return limit * np.tanh(y / limit)


def dead_band(y, size, rng):
    return np.sign(y) * np.maximum(np.abs(y) - size * rms(y), 0)


def weak_to_one_side(y, factor, rng):
    return np.where(y > 0, y, factor * y)


def drifting_gain(y, size, rng):
    return y * (1 + size * MIDDLE)


def interpolated(y, every, rng):
    return np.interp(ROWS, ROWS[:: int(every)], y[:: int(every)])


def repeated(y, every, rng):
    return y[ROWS // int(every) * int(every)]


def lost(y, share, rng, filler=0.0):
    out = y.copy()
    for start in rng.integers(0, N - 60, max(4, int(share * N / 30))):
        out[start : start + 30] = filler
    return out


def filled(y, filler, rng):
    return lost(y, 0.02, rng, filler)


def spiked(y, size, rng):
    out = y.copy()
    out[rng.integers(5, N - 5, 8)] += size * rms(y)
    return out


def stuck(y, share, rng):
    return np.where(ROWS > share * N, y[int(share * N)], y)


def constant(y, value, rng):
    return np.full(N, value)


def humming(y, size, rng):
    return y + size * rms(y) * np.sin(100 * np.pi * ROWS / FS)


def low_passed(y, hertz, rng):
    return sosfiltfilt(butter(2, hertz, fs=FS, output="sos"), y)


def coarse(y, size, rng):
    step = size * rms(y)
    return np.round(y / step) * step


@dataclass(frozen=True)
class ChannelFault:
    """A change of one channel, its sizes, its channels, the words that name it."""

    change: Callable[..., np.ndarray]
    sizes: tuple[float, ...]
    channels: str
    words: str


CHANNEL_FAULTS = {
    "gain": ChannelFault(
        gain, (0.8, 1.1, 1.4), "axF", "gain|calibration|contradict|times as large|unit"
    ),
    "sign": ChannelFault(
        inverted, (1,), "axF", "sign|invert|contradict|not positive|negative"
    ),
    "unit": ChannelFault(
        gain,
        (1e-3, 1 / 9.80665, 1e3),
        "axF",
        "unit|times as large|contradict|gain|reaches",
    ),
    "late": ChannelFault(late, (2, 8), "axF", "late|delay|early|contradict"),
    "offset": ChannelFault(offset, (0.3, 1.0), "axF", "zero|offset|mean|contradict"),
    "drift": ChannelFault(drifting, (1.0, 3.0), "axF", "drift|zero"),
    "hard saturation": ChannelFault(
        clipped, (1.0, 1.8), "axF", "cut off|clipped|satur"
    ),
    "soft saturation": ChannelFault(
        softly_clipped,
        (1.5, 3.0),
        "aF",
        "satur|peaks|missing|terms|contradict|calibration",
    ),
    "dead band": ChannelFault(
        dead_band,
        (0.1, 0.3),
        "aF",
        "dead band|either side|missing|terms|contradict|calibration",
    ),
    "push and pull": ChannelFault(
        weak_to_one_side,
        (0.8, 0.9),
        "aF",
        "push|pull|missing|terms|zero|contradict|calibration",
    ),
    "gain that drifts": ChannelFault(
        drifting_gain,
        (0.2, 0.5),
        "axF",
        "gain.* drifts|contradict|calibration|missing|terms",
    ),
    "interpolated": ChannelFault(interpolated, (4, 8), "axF", "straight|slower"),
    "held": ChannelFault(repeated, (4, 8), "axF", "slower|the same"),
    "dropouts": ChannelFault(
        lost, (0.02, 0.1), "axF", "drops to zero|spike|does not change"
    ),
    "fillers": ChannelFault(filled, (-9999.0, np.nan), "axF", "not measured|NaN"),
    "spikes": ChannelFault(spiked, (15, 40), "ax", "spike|far off"),
    "stuck": ChannelFault(stuck, (0.5, 0.8), "ax", "does not change|constant"),
    "dead": ChannelFault(constant, (0.0, 0.1), "ax", "constant"),
    "hum": ChannelFault(humming, (0.1, 0.5), "axF", "mains|hum"),
    "low pass": ChannelFault(
        low_passed,
        (8.0, 15.0),
        "aF",
        "delay|late|gain|contradict|calibration|missing|terms",
    ),
    "coarse": ChannelFault(coarse, (0.3, 1.0), "axF", "steps"),
}


def channel_fault(seed: int, change: Callable, channel: str, size: float) -> Case:
    """A clean case of which one channel is read wrongly."""
    clean = case(seed)
    record = clean.records[0]
    places = record.forced if channel == "F" else range(1, record.n_dof + 1)
    j = int(clean.rng.choice(places))
    matrix = getattr(record, PARTS[channel]).copy()
    matrix[:, j - 1] = change(matrix[:, j - 1], size, clean.rng)
    read = record.replace(**{PARTS[channel]: matrix})
    return replace(clean, records=[read], where=about(channel, j))


def about(channel: str, j: int) -> set[str]:
    """How a message may name a channel of DOF j."""
    where = {f"{channel}{j}", f"DOF {j}", f"dof {j}", f"m{j}"}
    where |= {f"storey {j}", f"storey {j + 1}", "motions", "neighbour"}
    if channel in "ax":
        where |= {f"a{j}", f"x{j}"}
    return where


# -- faults of the whole test --------------------------------------------------
# a seed, the size of the fault -> the case


def swapped(seed: int, number: float) -> Case:
    """The first two channels of one kind are swapped."""
    clean = case(seed)
    record = clean.records[0]
    matrix = list(PARTS.values())[int(number)]
    columns = np.arange(record.n_dof)
    columns[:2] = [1, 0]
    read = record.replace(**{matrix: getattr(record, matrix)[:, columns]})
    return replace(clean, records=[read], where={"1", "2"})


def forgotten(seed: int, size: float) -> Case:
    """A force that acts is not measured."""
    clean = case(seed)
    record = clean.records[0]
    j = max(record.forced)
    F = record.force.copy()
    F[:, j - 1] = 0.0
    where = {f"DOF {j}", f"F{j}", f"m{j}", f"dof {j}", "nothing scales"}
    return replace(clean, records=[record.replace(force=F)], where=where)


def copied(seed: int, times: float) -> Case:
    """One test is given several times."""
    clean = case(seed)
    records = clean.records * int(times)
    return replace(clean, records=records, where={"hold the same"})


def other_structure(seed: int, factor: float) -> Case:
    """The second test is of a structure with another mass."""
    clean = case(seed, 2)
    j = int(clean.rng.integers(clean.truth.n_dof))
    masses = clean.truth.masses.copy()
    masses[j] *= factor
    all_forced = len(clean.records[0].forced) > 1
    heavier = ChainModel(masses, clean.truth.laws)
    second = forced(heavier, clean.rng, 0.005, all_forced, "test 2")
    records = [clean.records[0], second]
    return replace(clean, records=records, where={"together", "DOF", "balance"})


def other_gain(seed: int, factor: float) -> Case:
    """The forces of the second test are read with another gain."""
    clean = case(seed, 2)
    first, second = clean.records
    second = second.replace(force=factor * second.force)
    return replace(clean, records=[first, second], where={"together", "F1"})


def wrong_clock(seed: int, factor: float) -> Case:
    """The sampling rate is another one."""
    clean = case(seed)
    record = clean.records[0]
    records = [record.replace(fs=record.fs * factor)]
    return replace(clean, records=records, where={"motions", "x1", "time", "x2"})


def wrong_mass(seed: int, factor: float) -> Case:
    """A mass that is declared as known is wrong."""
    clean = case(seed, base=True)
    j = int(clean.rng.integers(clean.truth.n_dof)) + 1
    masses = dict(clean.settings["known_masses"])
    masses[j] *= factor
    settings = clean.settings | {"known_masses": masses}
    where = {f"DOF {j}", f"dof {j}", "known", f"storey {j}", f"m{j}"}
    return replace(clean, settings=settings, where=where)


def tapered(seed: int, size: float) -> Case:
    """All channels fade in and out."""
    clean = case(seed)
    record = clean.records[0]
    window = np.hanning(N)[:, None]
    faded = {matrix: getattr(record, matrix) * window for matrix in PARTS.values()}
    where = {"taper", "DOF", "x1", "balance"}
    return replace(clean, records=[record.replace(**faded)], where=where)


@dataclass(frozen=True)
class TestFault:
    """A fault of the whole test, its sizes, the words that name it."""

    make: Callable[[int, float], Case]
    sizes: tuple[float, ...]
    words: str


TEST_FAULTS = {
    "channels swapped": TestFault(swapped, (0, 1, 2), "."),
    "force left out": TestFault(forgotten, (1,), "."),
    "copies": TestFault(copied, (2, 10), "same samples"),
    "another structure": TestFault(
        other_structure, (0.8, 1.2, 1.5), "together|contradict"
    ),
    "another gain": TestFault(other_gain, (0.85, 1.1, 1.3), "together|contradict|gain"),
    "clock": TestFault(
        wrong_clock,
        (0.5, 0.9, 1.1, 1e-3),
        "time|contradict|times as large|calibration|gain",
    ),
    "wrong known mass": TestFault(
        wrong_mass, (0.7, 1.3), "known|contradict|missing|terms"
    ),
    "tapered": TestFault(tapered, (1,), "taper|contradict|missing|terms"),
}


# -- the grammar ---------------------------------------------------------------


@dataclass(frozen=True)
class Sentence:
    """A fault of a channel ("-": of the test) of one size."""

    fault: str
    channel: str
    size: float
    make: Callable[[int], Case]
    words: str

    @property
    def row(self) -> str:
        """Where it is counted."""
        kind = {"F": "force", "-": "test"}.get(self.channel, "motion")
        return f"{self.fault}, {kind}"


def grammar() -> list[Sentence]:
    """All sentences."""
    sentences = []
    for name, fault in CHANNEL_FAULTS.items():
        for channel in fault.channels:
            for size in fault.sizes:
                make = partial(
                    channel_fault, change=fault.change, channel=channel, size=size
                )
                sentences.append(Sentence(name, channel, size, make, fault.words))
    for name, test_fault in TEST_FAULTS.items():
        for size in test_fault.sizes:
            make = partial(call_with_size, test_fault.make, size)
            sentences.append(Sentence(name, "-", size, make, test_fault.words))
    return sentences


def call_with_size(make: Callable[[int, float], Case], size: float, seed: int) -> Case:
    return make(seed, size)


# -- the verdict ---------------------------------------------------------------


def messages_and_error(made: Case) -> tuple[list[str], float]:
    """What fit, inspect and diagnose say, and the largest error of the parameters."""
    messages: list[str] = []
    for record in made.records:
        messages += data_warnings(record)
    model = NRFRegressor(**made.settings).fit(made.records)
    for line in str(model.diagnose()).split("\n"):
        if not line.startswith("Nothing limits"):
            messages.append(line)
    return messages, largest_error(model.model_, made.truth)


def largest_error(model: ChainModel, truth: ChainModel) -> float:
    """Of masses and stiffnesses."""
    errors = [abs(model.masses / truth.masses - 1).max()]
    for i in range(1, truth.n_dof + 1):
        stiffness = model.restoring_forces[i].linear_part()["k"]
        true = truth.restoring_forces[i].linear_part()["k"]
        errors.append(abs(stiffness / true - 1))
    return float(np.max(errors))


def names(text: str, sentence: Sentence, made: Case) -> bool:
    """Whether a message says what is wrong, and where."""
    placed = any(where in text for where in made.where)
    return placed and bool(re.search(sentence.words, text))


def judged(sentence: Sentence, seed: int) -> tuple[str, str]:
    """What became of a case, and the message."""
    try:
        made = sentence.make(seed)
        messages, error = messages_and_error(made)
    except NRFError as refusal:
        return "refused", str(refusal)

    naming = [text for text in messages if names(text, sentence, made)]
    if naming:
        return "named", naming[0]

    clean = case(seed, len(made.records), "known_masses" in made.settings)
    _, error_of_clean = messages_and_error(clean)
    if np.isfinite(error) and error <= max(CLOSE, 2 * error_of_clean):
        return "right", f"{100 * error:.1f} %"
    return "silent", (
        f"{seed}: {sentence.fault} of {sentence.channel}, size {sentence.size:.3g}:"
        f" {100 * error:.0f} % off; said: {' | '.join(messages)[:300] or 'nothing'}"
    )


# limits of a test, not faults of it
LIMITS = r"is known to \+-|moves .* at most|condition number|is expected to come out"


def accused(seed: int) -> str:
    """What is said of faults of a clean case; empty if nothing."""
    made = case(10_000 + seed, 1 + seed % 2, seed % 5 == 4)
    try:
        messages, _ = messages_and_error(made)
    except NRFError as refusal:
        return f"{seed}: {refusal}"
    accusations = [text for text in messages if not re.search(LIMITS, text)]
    return f"{seed}: {' | '.join(accusations)}" if accusations else ""


# -- tables --------------------------------------------------------------------


def counts(sentences: list[Sentence], verdicts: list[str]) -> pd.DataFrame:
    """Verdicts by fault."""
    rows = pd.Series([sentence.row for sentence in sentences])
    table = pd.crosstab(rows, pd.Series(verdicts))
    table = table.reindex(index=rows.unique(), columns=VERDICTS, fill_value=0)
    table.loc["all"] = table.sum()
    table.insert(0, "tried", table.sum(axis=1))
    return table.rename_axis("fault").reset_index()


def in_words(cases: list[str], n_tried: int, verdict: str) -> str:
    """How many of those tried, and how many are asked for."""
    share = 100 * len(cases) / n_tried
    return f"{len(cases)} {verdict} ({share:.1f} %; asked: 2 % at most)"


def main(arguments: list[str] | None = None) -> int:
    """Run the battery; the exit code says whether the goals are met."""
    parser = options_of(__doc__, quick="5 faults and 2 clean records")
    parser.add_argument(
        "--silent", action="store_true", help="print silent cases and accusations"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="added to the seed of every case"
    )
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(arguments)
    n_faults, n_clean = (5, 2) if options.quick else (300, 300)

    sentences = grammar()
    stride = len(sentences) // n_faults if options.quick else 1
    numbers = stride * np.arange(n_faults) % len(sentences)
    chosen = [sentences[number] for number in numbers]
    seeds = range(options.seed, options.seed + n_faults)
    outcomes = in_parallel(judged, zip(chosen, seeds), options.jobs)
    silent = [text for verdict, text in outcomes if verdict == "silent"]

    clean = range(options.seed, options.seed + n_clean)
    accusations = in_parallel(accused, zip(clean), options.jobs)
    wrong = list(filter(None, accusations))

    print(markdown(counts(chosen, [verdict for verdict, _ in outcomes])))
    print(f"\n{n_faults} faults, {in_words(silent, n_faults, 'silent')}.")
    if options.silent:
        print("\n".join(["", "Silent:", *silent, ""]))
    print(f"{n_clean} clean records, {in_words(wrong, n_clean, 'accused')}.")
    if options.silent:
        print("\n".join(["", "Accused:", *wrong]))
    return int(len(wrong) > ACCEPTED * n_clean or len(silent) > ACCEPTED * n_faults)


if __name__ == "__main__":
    sys.exit(main())
