"""Change between two tests, 200 simulated pairs: found in the right place, and silence
where nothing changed?

    python benchmarks/damage.py [--quick] [--out FOLDER]

Chains of 2 to 6 floors under random forces, measured twice with other forces. Between
the two: a stiffness loss of 2 to 30 %, a gap or a cubic spring that appears, a bolt
that rubs (friction), mass that is added; amplitude ratios of 0.5 to 2 and noise of 0 to
3 % of each channel's rms, drawn for each test. Two further kinds change nothing but the
amplitude, or the noise. A third of the chains carries an MR damper (Dahl) in one storey
that the regressor, linear in every storey, does not know.

A change counts as *detectable* if its force, or the inertia of an added mass, is at
least 1.5 % of the storey's elastic force over the common domain of motion (the report
asks for 1 %), and five standard errors of a least-squares fit that knows all laws, the
noise-free motion and the masses: what noise in the forces and accelerations alone would
leave. ``--quick`` takes five pairs.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import ChainModel, NRFRegressor, Record, laws
from pysindy_nrf.exceptions import NRFWarning
from pysindy_nrf.monitoring import compare_tests
from pysindy_nrf.simulation import free_run
from pysindy_nrf.simulation.excitation import band_limited_random
from pysindy_nrf.simulation.noise import add_noise

FS, SECONDS = 500.0, 24.0
KINDS = ("stiffness", "gap", "cubic", "friction", "mass", "amplitude", "noise")
NOTHING = ("amplitude", "noise")
LEAST, SURE = (
    0.015,
    5.0,
)  # share of the elastic force, standard errors: what counts as detectable
QUICK = (
    14,
    3,
    18,
    12,
    27,
)  # stiffness, friction, mass, and nothing twice, of few floors
LEVEL = 150.0  # N rms of the forces of the first test


@dataclass
class Pair:
    """Two tests of one structure, and what happened between them."""

    kind: str
    place: str  # storey or DOF that changed; "" where nothing did
    # rms force of the change over that of the storey's spring, in the common domain
    size: float
    # its size in standard errors of a fit that knows everything but the coefficients
    sure: float
    before: Record
    after: Record
    about: str

    @property
    def detectable(self) -> bool:
        """Whether the data can tell it."""
        return self.place != "" and self.size >= LEAST and self.sure >= SURE


def pair(number: int) -> Pair:
    """A pair of tests; the same for the same number."""
    rng = np.random.default_rng([26, number])
    kind = KINDS[number % len(KINDS)]
    n = int(rng.integers(2, 7))
    m, k, c = (
        rng.uniform(8, 14, n),
        rng.uniform(0.6e5, 1.4e5, n),
        rng.uniform(60, 150, n),
    )
    held: dict[int, list[Any]] = {
        i + 1: [laws.PowerSeries(1, [c[i], k[i]])] for i in range(n)
    }
    if damped := number % 3 == 0:
        held[int(rng.integers(1, n + 1))].append(
            laws.Dahl(sigma=5e4, Fd=rng.uniform(15, 40))
        )
    dofs = (
        list(range(1, n + 1)) if rng.random() < 0.5 else [int(rng.integers(1, n + 1))]
    )
    ratio = (
        1.0 if kind == "noise" else float(np.exp(rng.uniform(np.log(0.5), np.log(2.0))))
    )
    noise = rng.uniform(0, 0.03, 2)
    if kind == "amplitude":
        noise[1] = noise[0]
    forces = [
        band_limited_random(
            n,
            SECONDS,
            FS,
            excited=dofs,
            rms=LEVEL * r,
            band=(0.5, 40),
            random_state=[26, number, at],
        )
        for at, r in enumerate((1.0, ratio))
    ]
    healthy = ChainModel(m, {f"storey {i}": law for i, law in held.items()})
    first = free_run(healthy, forces[0], 1 / FS).record
    place, changed = "", healthy
    if kind == "mass":
        place = f"dof {rng.integers(1, n + 1)}"
        heavy = m.copy()
        heavy[int(place[4:]) - 1] *= 1 + rng.uniform(0.02, 0.2)
        changed = ChainModel(heavy, healthy.laws)
    elif kind not in NOTHING:
        i = int(rng.integers(1, n + 1))
        place = f"storey {i}"
        drift = np.diff(first.displacement, axis=1, prepend=0.0)[:, i - 1]
        elastic = k[i - 1] * drift.std()
        new = {
            "stiffness": lambda: laws.LinearElastic(-rng.uniform(0.02, 0.3) * k[i - 1]),
            "gap": lambda: laws.TwoSidedGap(
                rng.uniform(0.5, 1.5) * drift.std(), rng.uniform(0.1, 0.5) * k[i - 1]
            ),
            "cubic": lambda: laws.CubicStiffness(
                rng.uniform(0.03, 0.3) * elastic / (drift**3).std()
            ),
            "friction": lambda: laws.CoulombFriction(rng.uniform(0.03, 0.3) * elastic),
        }[kind]()
        changed = healthy.with_laws({place: [*held[i], new]})
    second = free_run(changed, forces[1], 1 / FS).record
    size, sure = _oracle(healthy, changed, place, first, second, noise)
    measured = [
        add_noise(r, s, random_state=[number, at])
        for at, (r, s) in enumerate(zip((first, second), noise))
    ]
    about = (
        f"n {n}, forced {dofs}, ratio {ratio:.2f}, noise {noise[0]:.1%}"
        f" {noise[1]:.1%}{', damper' * damped}"
    )
    return Pair(kind, place, size, sure, *measured, about)


def _oracle(
    healthy: ChainModel,
    changed: ChainModel,
    place: str,
    first: Record,
    second: Record,
    noise: np.ndarray,
) -> tuple[float, float]:
    """Size of a change in the common domain, and in standard errors if all but the
    coefficients were known.
    """
    if not place:
        return 0.0, 0.0
    j = int(place.split()[1]) - 1
    storey = f"storey {j + 1}"
    rows, lefts = [], []
    motions = [
        [np.diff(y, axis=1, prepend=0.0)[:, j] for y in (r.velocity, r.displacement)]
        for r in (first, second)
    ]
    reach = [min(np.abs(a).max(), np.abs(b).max()) for a, b in zip(*motions)]
    for at, (record, (v, s)) in enumerate(zip((first, second), motions)):
        motion = laws.Motion(s, v, record.acceleration[:, j], record.time)
        own = np.column_stack(
            [x for law in healthy.laws[storey] for x in law.features(motion).T]
        )
        inside = (np.abs(v) <= reach[0]) & (np.abs(s) <= reach[1])
        if place.startswith("dof"):
            change = (changed.masses - healthy.masses)[j] * record.acceleration[:, j]
        else:
            change = changed.laws[storey][-1].force(motion)
        rms_F, rms_a = (
            record.force[:, j:].std(axis=0),
            record.acceleration[:, j:].std(axis=0),
        )
        sigma = max(noise[at], 1e-4) * np.sqrt(
            (rms_F**2).sum() + ((healthy.masses[j:] * rms_a) ** 2).sum()
        )
        rows.append(np.column_stack([own, change * at])[inside] / sigma)
        lefts.append(
            (
                change[inside],
                own[inside, 1] * healthy.restoring_forces[storey].linear_part()["k"],
            )
        )
    both = np.vstack(rows)
    other, column = both[:, :-1], both[:, -1]
    other = other / np.linalg.norm(other, axis=0)
    left = column - other @ np.linalg.lstsq(other, column, rcond=None)[0]
    change, elastic = lefts[1]
    return float(np.std(change) / np.std(elastic)), float(np.linalg.norm(left))


def run(number: int) -> dict[str, Any]:
    """What `compare_tests` says of a pair."""
    case = pair(number)
    start = perf_counter()
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        report = compare_tests(NRFRegressor(degree=1), case.before, case.after)
    places = report.changed["place"].tolist()
    return {
        "pair": number,
        "kind": case.kind,
        "place": case.place,
        "size (%)": 100 * case.size,
        "sure": case.sure,
        "detectable": case.detectable,
        "found": ", ".join(places),
        "terms": "; ".join(report.changed["term"]),
        "change (%)": report.changed["change"].iloc[0] if places else np.nan,
        "first right": places[:1] == [case.place] * bool(case.place),
        "right alone": places == [case.place] * bool(case.place),
        "apart": ", ".join(
            f"{r.term} of {r.storey}" for r in report.explained.itertuples()
        ),
        "seconds": perf_counter() - start,
        "about": case.about,
    }


def table(numbers: Any) -> pd.DataFrame:
    """One row for each pair."""
    return pd.DataFrame([run(i) for i in numbers]).set_index("pair")


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """By kind: pairs, those detectable (or with nothing to detect), right place (or
    silence), and no other place.
    """
    out = {}
    for kind in [*KINDS, "changes", "nothing"]:
        some = rows[
            rows["kind"].isin(
                {"changes": set(KINDS) - set(NOTHING), "nothing": NOTHING}.get(
                    kind, [kind]
                )
            )
        ]
        asked = some if kind in (*NOTHING, "nothing") else some[some["detectable"]]
        first = asked["right alone" if kind in (*NOTHING, "nothing") else "first right"]
        out[kind] = {
            "pairs": len(some),
            "asked": len(asked),
            "right place (%)": 100 * first.mean(),
            "and no other (%)": 100 * asked["right alone"].mean(),
        }
    return pd.DataFrame.from_dict(out, orient="index")


def main(argv: list[str] | None = None) -> int:
    """Print the summary and the pairs that went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="five pairs")
    parser.add_argument("--out", type=Path, help="folder for a CSV file of all pairs")
    args = parser.parse_args(argv)
    rows = table(QUICK if args.quick else range(200))
    wrong = rows[~rows["right alone"]]
    print(summary(rows).to_string(float_format="{:.1f}".format))
    print(
        f"\n{rows['seconds'].median():.1f} s a pair. Others than these are right and"
        " alone:"
    )
    print(wrong.to_string(float_format="{:.3g}".format))
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        rows.to_csv(args.out / "damage.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
