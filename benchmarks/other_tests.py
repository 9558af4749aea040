"""Does an effect of one test hold on other tests of the same structure?

    python benchmarks/other_tests.py                    # 22 searches, some 20 min
    python benchmarks/other_tests.py "friction damper"  # one structure
    python benchmarks/other_tests.py --quick            # one search

``close_loop`` searches one test, and its models before and after each effect, with all
their coefficients, are tried on every other test of the structure: balance errors in
the band of the search. The fall of the error is the mean over the other tests, dB.
Effects that the loop refused stand in the table too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import search_path
import measured_sets
import numpy as np
import pandas as pd
from battery import measured
from harness import markdown, options_of, quietly, write_csv
from tqdm import tqdm

from pysindy_nrf import ChainModel, NRFRegressor, Record, close_loop
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.records.dataset import Dataset
from pysindy_nrf.records.zero_phase_filter import filters_of

WORSE = -1.0  # dB: a further effect that costs more is not there


@dataclass(frozen=True)
class Structure:
    """Tests of one structure, and what is known of its masses, kg."""

    load: Callable[[str], Record]
    tests: tuple[str, ...]
    masses: dict[int, float]


@dataclass(frozen=True)
class JudgedStep:
    """An effect, and what other tests of the structure say of it.

    Attributes
    ----------
    test, effect : str
    later : bool
        Whether another effect came before it.
    confirmed : bool
    judged_by : str
        What judged it in the search.
    judged, judged_error : float
        The error reduction there and its standard error, dB.
    others : float
        Mean fall of the error on the other tests, dB.
    by_test : list of float
    """

    test: str
    effect: str
    later: bool
    confirmed: bool
    judged_by: str
    judged: float
    judged_error: float
    others: float
    by_test: list[float] = field(default_factory=list)


DAMPER_TESTS = (
    "0.25Hz30lbtension1.5amplitude",
    "0.5Hz36lbtension1.5amplitude",
    "1Hz0lbtension1amplitude",
    "1Hz30lbtension1amplitude",
    "1Hz36lbtension0.5amplitude",
    "2Hz30lbtension0.5amplitude",
    "2Hz36lbtension0.5amplitude",
    "ImperialValleyMCE",
    "KocaeliMCE",
)
FRAME_TESTS = ("fbgm162s1", "fbgm162s3", "fbgm162s5", "fbgm152s3", "fbgm152s4")


def load_friction_damper(test: str) -> Record:
    """A test of the friction damper, of either file."""
    first = measured_sets.data_file("friction_damper_with_backlash")
    for file in (first, first.with_name("brfd_more.npz")):
        with np.load(file) as tests:
            if test in tests:
                table = tests[test].astype(float)
    return Record(
        displacement=measured_sets.INCH * table[:, 1],
        force=measured_sets.KIP * table[:, 2],
        fs=1024.0,
        name=test,
    )


def load_rubbing_mass(test: str) -> Record:
    """A run of the mass that rubs on a fixed frame."""
    if test == "60.52":
        return measured.dry_friction()
    return measured_sets.load_dry_friction_storey_more()


STRUCTURES = {
    "friction damper": Structure(load_friction_damper, DAMPER_TESTS, {1: 0.0}),
    "steel frame": Structure(
        measured_sets.load_nees_three_storey, FRAME_TESTS, {1: 1.0, 2: 1.0, 3: 1.0}
    ),
    "isolated frame": Structure(
        measured.load_nees_isolated,
        ("fpgm111s1", "fpgm171s3"),
        {1: 1.0, 2: 1.0, 3: 1.0, 4: 1.0},
    ),
    "rubbing mass": Structure(load_rubbing_mass, ("60.52", "70.83"), {1: 1.0}),
}


def judged_steps(structure: Structure, test: str) -> list[JudgedStep]:
    """The effects of one test, judged on the others."""
    baseline = NRFRegressor(degree=1, known_masses=structure.masses)
    report = quietly(close_loop, structure.load(test), baseline)
    others = [name for name in structure.tests if name != test]
    data = [quietly(prepare, structure.load(name)).data for name in others]
    measure = partial(errors_on, data, report.band)

    before = measure(report.models[0])
    steps = []
    for step, model in zip(report.steps, report.models[1:]):
        after = measure(model)
        falls = 20.0 * np.log10(before / after)
        steps.append(
            JudgedStep(
                test,
                f"{step.effect_class} at {step.site} ({step.law})",
                any(earlier.confirmed for earlier in steps),
                step.confirmed,
                step.judged_by,
                step.judged_reduction,
                step.judged_error,
                float(falls.mean()),
                np.round(falls, 1).tolist(),
            )
        )
        if step.confirmed:
            before = after
    return steps


def errors_on(
    tests: list[Dataset], band: tuple[float, float], model: ChainModel
) -> np.ndarray:
    """Errors of the equations of motion of a model on some tests, root mean square."""
    return np.array([error_on(data, band, model) for data in tests])


def error_on(data: Dataset, band: tuple[float, float], model: ChainModel) -> float:
    """Residual over force, or over inertia where no force is, all DOFs alike."""
    segment, band_pass = data.segments[0], filters_of(band, data)[0]
    assert band_pass is not None
    rows = segment.valid
    force = segment.F[rows]
    missed = band_pass.apply(force - model.balance_forces(data)[0])
    inertia = band_pass.apply(segment.a[rows].astype(float)) * model.masses
    reference = np.where(force.any(axis=0), band_pass.apply(force), inertia)
    shares = (missed**2).sum(axis=0) / (reference**2).sum(axis=0)
    return float(np.sqrt(shares.mean()))


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Print all effects, and how many further ones make other tests worse."""
    parser = options_of(__doc__, quick="one search of the friction damper")
    parser.add_argument(
        "structures", nargs="*", choices=[*STRUCTURES, []], help="all by default"
    )
    parser.add_argument("--out", type=Path, help="folder for the table")
    options = parser.parse_args(arguments)

    steps: list[JudgedStep] = []
    for name in options.structures or STRUCTURES:
        structure = STRUCTURES[name]
        tests = structure.tests[4:5] if options.quick else structure.tests
        for test in tqdm(tests, desc=name, disable=None):
            steps += judged_steps(structure, test)
        if options.quick:
            break

    table = pd.DataFrame([asdict(step) for step in steps])
    print(markdown(table.round(2)))
    confirmed = table[table["confirmed"]]
    for later, words in ((False, "first"), (True, "further")):
        falls = confirmed.loc[confirmed["later"] == later, "others"]
        print(
            f"{words} effects: {len(falls)}, better on other tests {(falls > 0).sum()},"
            f" worse by more than 1 dB {(falls < WORSE).sum()}"
        )
    write_csv(table, options.out, "other_tests")
    return table


if __name__ == "__main__":
    main()
