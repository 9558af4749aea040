"""Change between two tests, 200 simulated pairs: found in the right place?

    python benchmarks/damage.py [--quick] [--out FOLDER]

Chains of 2 to 6 floors under random forces, measured twice with other forces. Between
the two: a stiffness loss of 2 to 30 %, a gap or a cubic spring that appears, a bolt
that rubs (friction), mass that is added; amplitude ratios of 0.5 to 2 and noise of 0 to
3 % of each channel's rms, drawn for each test. Two further kinds change nothing but the
amplitude, or the noise: there the comparison must be silent. A third of the chains
carries an MR damper (Dahl) in one storey that the regressor, linear in every storey,
does not know.

A change counts as *detectable* if its force, or the inertia of an added mass, is at
least 1.5 % of the storey's elastic force over the common domain of motion (the report
asks for 1 %), and five standard errors of a least-squares fit that knows all laws, the
noise-free motion and the masses: what noise in the forces and accelerations alone would
leave. ``--quick`` takes five pairs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import search_path
import numpy as np
import pandas as pd
from harness import linear_storeys, options_of, quietly, write_csv

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.monitoring import compare_tests
from pysindy_nrf.simulation.noise import add_noise

FS = 500.0  # Hz
SECONDS = 24.0
LEVEL = 150.0  # N rms of the forces of the first test
CHANGES = ("stiffness", "gap", "cubic", "friction", "mass")
NOTHING = ("amplitude", "noise")
KINDS = (*CHANGES, *NOTHING)
# what counts as detectable: share of the elastic force, standard errors
LEAST_SHARE = 0.015
LEAST_ERRORS = 5.0
# stiffness, friction, mass, and nothing twice, of few floors
QUICK = (14, 3, 18, 12, 27)
# share of a channel's rms that a clean one is taken to have as noise
LEAST_NOISE = 1e-4


# -- two tests of one structure ------------------------------------------------


@dataclass(frozen=True)
class Change:
    """Storey or DOF that changes ("": none), and the structure after it."""

    place: str
    healthy: ChainModel
    changed: ChainModel

    @property
    def dof(self) -> int:
        return int(self.place.split()[1])


@dataclass(frozen=True)
class Pair:
    """Two tests of one structure, and what happened between them."""

    kind: str
    place: str
    # rms force of the change over that of the storey's spring, in the common domain
    size: float
    # its size in standard errors of a fit that knows everything but the coefficients
    errors: float
    before: Record
    after: Record
    about: str

    @property
    def detectable(self) -> bool:
        """Whether the data can tell it."""
        large = self.size >= LEAST_SHARE and self.errors >= LEAST_ERRORS
        return self.place != "" and large


def pair(number: int) -> Pair:
    """A pair of tests; the same for the same number."""
    rng = np.random.default_rng([26, number])
    kind = KINDS[number % len(KINDS)]
    healthy = draw_chain(rng, damped=number % 3 == 0)
    forced = draw_forced(rng, healthy.n_dof)
    ratio = 1.0 if kind == "noise" else float(np.exp(rng.uniform(*np.log([0.5, 2.0]))))
    noise = rng.uniform(0, 0.03, 2)
    if kind == "amplitude":
        noise[1] = noise[0]

    first = run(healthy, forced, LEVEL, [26, number, 0])
    change = draw_change(rng, kind, healthy, first)
    second = run(change.changed, forced, LEVEL * ratio, [26, number, 1])
    size, errors = visibility(change, [first, second], noise)
    about = (
        f"n {healthy.n_dof}, forced {forced}, ratio {ratio:.2f},"
        f" noise {noise[0]:.1%} {noise[1]:.1%}"
    )
    if number % 3 == 0:
        about += ", damper"
    return Pair(
        kind,
        change.place,
        size,
        errors,
        add_noise(first, noise[0], random_state=[number, 0]),
        add_noise(second, noise[1], random_state=[number, 1]),
        about,
    )


def draw_chain(rng: np.random.Generator, damped: bool) -> ChainModel:
    """A chain of linear storeys, one of them with a damper."""
    n = int(rng.integers(2, 7))
    m = rng.uniform(8, 14, n)
    k = rng.uniform(0.6e5, 1.4e5, n)
    c = rng.uniform(60, 150, n)
    storeys = linear_storeys(k, c)
    if damped:
        place = f"storey {rng.integers(1, n + 1)}"
        storeys[place].append(laws.Dahl(sigma=5e4, Fd=rng.uniform(15, 40)))
    return ChainModel(m, storeys)


def draw_forced(rng: np.random.Generator, n: int) -> list[int]:
    """All floors, or one."""
    if rng.random() < 0.5:
        return list(range(1, n + 1))
    return [int(rng.integers(1, n + 1))]


def run(model: ChainModel, forced: list[int], rms: float, seed: list[int]) -> Record:
    """A test without noise under random forces."""
    F = excitation.band_limited_random(
        model.n_dof,
        SECONDS,
        FS,
        excited=forced,
        rms=rms,
        band=(0.5, 40),
        random_state=seed,
    )
    return simulate(model, F, 1 / FS)


def draw_change(
    rng: np.random.Generator, kind: str, healthy: ChainModel, test: Record
) -> Change:
    """What happens to the structure; of a size that fits its motion in a test."""
    n = healthy.n_dof
    if kind in NOTHING:
        return Change("", healthy, healthy)
    if kind == "mass":
        dof = int(rng.integers(1, n + 1))
        masses = healthy.masses.copy()
        masses[dof - 1] *= 1 + rng.uniform(0.02, 0.2)
        return Change(f"dof {dof}", healthy, ChainModel(masses, healthy.laws))

    storey = int(rng.integers(1, n + 1))
    place = f"storey {storey}"
    drift = np.diff(test.displacement, axis=1, prepend=0.0)[:, storey - 1]
    stiffness = healthy.restoring_forces[place].linear_part()["k"]
    law = draw_law(rng, kind, stiffness, drift)
    changed = healthy.with_laws({place: [*healthy.laws[place], law]})
    return Change(place, healthy, changed)


def draw_law(
    rng: np.random.Generator, kind: str, stiffness: float, drift: np.ndarray
) -> laws.ForceLaw:
    """What a storey gains."""
    elastic = stiffness * drift.std()
    if kind == "stiffness":
        return laws.LinearElastic(-rng.uniform(0.02, 0.3) * stiffness)
    if kind == "gap":
        gap = rng.uniform(0.5, 1.5) * drift.std()
        return laws.TwoSidedGap(gap, rng.uniform(0.1, 0.5) * stiffness)
    if kind == "cubic":
        return laws.CubicStiffness(rng.uniform(0.03, 0.3) * elastic / (drift**3).std())
    return laws.CoulombFriction(rng.uniform(0.03, 0.3) * elastic)


# -- what the data can tell ----------------------------------------------------


def visibility(
    change: Change, tests: list[Record], noise: np.ndarray
) -> tuple[float, float]:
    """Size of a change in the common domain, and in standard errors.

    The errors are those of a fit that knows all but the coefficients of the storey.
    """
    if not change.place:
        return 0.0, 0.0
    motions = [motion_of(test, change.dof) for test in tests]
    reach = [np.min([abs(m.v).max() for m in motions])]
    reach.append(np.min([abs(m.s).max() for m in motions]))

    rows = []
    for number, (test, motion) in enumerate(zip(tests, motions)):
        inside = (np.abs(motion.v) <= reach[0]) & (np.abs(motion.s) <= reach[1])
        columns = columns_of(change, motion)
        force = force_of(change, motion)
        sigma = force_noise(change, test, noise[number])
        rows.append(np.column_stack([columns, force * number])[inside] / sigma)

    elastic = columns[inside, 1] * stiffness_of(change)
    size = np.std(force[inside]) / np.std(elastic)
    return float(size), unexplained(np.vstack(rows))


def motion_of(test: Record, dof: int) -> laws.Motion:
    """Motion of the storey below a DOF."""
    s, v = (
        np.diff(y, axis=1, prepend=0.0)[:, dof - 1]
        for y in (test.displacement, test.velocity)
    )
    return laws.Motion(s, v, test.acceleration[:, dof - 1], test.time)


def stiffness_of(change: Change) -> float:
    """Stiffness of the storey before the change, N/m."""
    forces = change.healthy.restoring_forces[f"storey {change.dof}"]
    return forces.linear_part()["k"]


def columns_of(change: Change, motion: laws.Motion) -> np.ndarray:
    """Features of the storey's laws before the change."""
    storey = change.healthy.laws[f"storey {change.dof}"]
    return np.hstack([law.features(motion) for law in storey])


def force_of(change: Change, motion: laws.Motion) -> np.ndarray:
    """Force of the change along a motion: of its law, or of the added mass."""
    if change.place.startswith("dof"):
        added = change.changed.masses - change.healthy.masses
        return added[change.dof - 1] * motion.a
    return change.changed.laws[change.place][-1].force(motion)


def force_noise(change: Change, test: Record, noise: float) -> float:
    """Noise of the storey's force, which is the balance of all floors above it, N."""
    above = slice(change.dof - 1, None)
    forces = test.force[:, above].std(axis=0)
    inertias = change.healthy.masses[above] * test.acceleration[:, above].std(axis=0)
    return max(noise, LEAST_NOISE) * np.sqrt((forces**2).sum() + (inertias**2).sum())


def unexplained(rows: np.ndarray) -> float:
    """Size of the last column in standard errors, beside the others."""
    others = rows[:, :-1] / np.linalg.norm(rows[:, :-1], axis=0)
    change = rows[:, -1]
    fitted = others @ np.linalg.lstsq(others, change, rcond=None)[0]
    return float(np.linalg.norm(change - fitted))


# -- tables --------------------------------------------------------------------


def compared(number: int) -> dict[str, Any]:
    """What ``compare_tests`` says of a pair."""
    case = pair(number)
    start = perf_counter()
    report = quietly(compare_tests, NRFRegressor(degree=1), case.before, case.after)
    seconds = perf_counter() - start

    places = report.changed["place"].tolist()
    wanted = [case.place] if case.place else []
    explained = [f"{row.term} of {row.storey}" for row in report.explained.itertuples()]
    return {
        "pair": number,
        "kind": case.kind,
        "place": case.place,
        "size (%)": 100 * case.size,
        "sure": case.errors,
        "detectable": case.detectable,
        "found": ", ".join(places),
        "terms": "; ".join(report.changed["term"]),
        "change (%)": report.changed["change"].iloc[0] if places else np.nan,
        "first right": places[:1] == wanted,
        "right alone": places == wanted,
        "apart": ", ".join(explained),
        "seconds": seconds,
        "about": case.about,
    }


def table(numbers: Iterable[int]) -> pd.DataFrame:
    """One row for each pair."""
    return pd.DataFrame([compared(number) for number in numbers]).set_index("pair")


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """By kind: pairs, those that are asked, right place (or silence), no other place.

    Of changes those are asked that are detectable.
    """
    groups = {kind: (kind,) for kind in KINDS}
    groups |= {"changes": CHANGES, "nothing": NOTHING}
    out = {}
    for name, kinds in groups.items():
        pairs = rows[rows["kind"].isin(kinds)]
        asked = pairs
        right = asked["right alone"]
        if kinds[0] in CHANGES:
            asked = pairs[pairs["detectable"]]
            right = asked["first right"]
        out[name] = {
            "pairs": len(pairs),
            "asked": len(asked),
            "right place (%)": 100 * right.mean(),
            "and no other (%)": 100 * asked["right alone"].mean(),
        }
    return pd.DataFrame.from_dict(out, orient="index")


def main(arguments: list[str] | None = None) -> int:
    """Print the summary and the pairs that went wrong."""
    parser = options_of(__doc__, quick="five pairs")
    parser.add_argument("--out", type=Path, help="folder for a CSV file of all pairs")
    options = parser.parse_args(arguments)

    rows = table(QUICK if options.quick else range(200))
    wrong = rows[~rows["right alone"]]
    print(summary(rows).to_string(float_format="{:.1f}".format))
    print(
        f"\n{rows['seconds'].median():.1f} s a pair. Others than these are right and"
        " alone:"
    )
    print(wrong.to_string(float_format="{:.3g}".format))
    write_csv(rows, options.out, "damage")
    return 0


if __name__ == "__main__":
    sys.exit(main())
