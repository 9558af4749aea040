"""Public benchmark records beside published results, by defaults.

    python benchmarks/published.py [--quick]

Splits and measures are those of nonlinearbenchmark.org, as far as the records are in
the folder that PYSINDY_NRF_DATA names: the rms error of a free run, in the unit of the
output, after the samples that are given for its initial state. The laws of the system
are declared, and nothing else. ``--quick`` fits Silverbox to a fifth of its samples and
leaves out the sweep of Bouc-Wen. ``docs/published.md`` is made of the rows.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import search_path
import measured_sets
import numpy as np
import pandas as pd
from harness import markdown, options_of, quietly

from pysindy_nrf import NRFRegressor, Record, laws
from pysindy_nrf.laws.base import ForceLaw

# Row 0 of the ten multisines is row 41,224 of SNLS80mV, as the silence between the
# multisines says; the official test begins at its row 105,712.
SILVERBOX_TEST = 64_488
# Samples of which the official test gives the output for the initial state.
INITIAL = {"Silverbox": 50, "EMPS": 20}
# Of these, the ones that a cubic follows: six of Silverbox hold most of a period of its
# resonance; EMPS accelerates slowly.
FOR_STATE = {"Silverbox": 6, "EMPS": 20}
# Periods of a multisine until a free run from rest is steady: damping 1.6 %, 35 Hz.
PERIODS = 2
HEADER = (
    "record",
    "trained on",
    "tested on",
    "rms error",
    "% of output",
    "parameters",
    "fit, s",
)


@dataclass(frozen=True)
class Row:
    """A fit, and the free run of it over samples that it did not see.

    Attributes
    ----------
    record, trained, tested : str
    error : float
        Rms error of the displacement, in its unit.
    size : float
        Rms of the measured displacement there.
    unit : str
    factor : float
        Turns the displacement into the unit.
    n_parameters : int
    seconds : float
        Processor time of the fit.
    model : NRFRegressor
    """

    record: str
    trained: str
    tested: str
    error: float
    size: float
    unit: str
    factor: float
    n_parameters: int
    seconds: float
    model: NRFRegressor

    @property
    def percent(self) -> float:
        """Error over the rms of the output."""
        return 100.0 * self.error / self.size

    def cells(self) -> list[str]:
        """The row of the table."""
        return [
            self.record,
            self.trained,
            self.tested,
            f"{self.factor * self.error:.3g} {self.unit}",
            f"{self.percent:.2g}",
            str(self.n_parameters),
            f"{self.seconds:.0f}",
        ]


def fitted(record: Record, law: Sequence[ForceLaw]) -> tuple[NRFRegressor, float]:
    """A fit by defaults, and its processor time, s."""
    began = time.process_time()
    model = quietly(NRFRegressor(laws={1: list(law)}).fit, record)
    return model, time.process_time() - began


def n_parameters(model: NRFRegressor) -> int:
    """Masses, coefficients and shape parameters."""
    shapes = 0
    for group in model.model_.laws.values():
        shapes += sum(len(law.shape) for law in group)
    coefficients = sum(len(c) for c in model.model_.coefficients.values())
    return len(model.masses_) + coefficients + shapes


def first_state(record: Record, n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity of the first sample, by a cubic through some."""
    t = record.dt * np.arange(n_samples)
    cubic = np.polynomial.Polynomial.fit(t, record.displacement[:n_samples, 0], 3)
    return np.array([cubic(0.0)]), np.array([cubic.deriv()(0.0)])


def error_of_run(model: NRFRegressor, record: Record, skipped: int) -> float:
    """Rms error of the free run over a record after its first samples."""
    x0, v0 = first_state(record, FOR_STATE[record.name.split(",")[0]])
    run = model.simulate(record.force, dt=record.dt, x0=x0, v0=v0)
    error = run.displacement[skipped:] - record.displacement[skipped:]
    return float(np.sqrt(np.mean(error**2)))


def error_in_steady_state(model: NRFRegressor, record: Record) -> float:
    """Rms error of the free run over the last of some periods of a record."""
    force = np.tile(record.force, (PERIODS + 1, 1))
    run = model.simulate(force, dt=record.dt)
    error = run.displacement[-record.n_samples :] - record.displacement
    return float(np.sqrt(np.mean(error**2)))


def rms(record: Record) -> float:
    """Of the displacement."""
    return float(np.sqrt(np.mean(record.displacement**2)))


# -- the records ---------------------------------------------------------------


def silverbox(quick: bool) -> list[Row]:
    """Mass, dashpot, and linear, quadratic and cubic spring; V for N and m."""
    every = measured_sets.load_silverbox_multisine()
    first = SILVERBOX_TEST - SILVERBOX_TEST // 5 if quick else 0
    train = every.rows(slice(first, SILVERBOX_TEST))
    test = every.rows(slice(SILVERBOX_TEST, every.n_samples))
    law = [
        laws.LinearViscous(),
        laws.LinearElastic(),
        laws.QuadraticStiffness(),
        laws.CubicStiffness(),
    ]
    model, seconds = fitted(train, law)
    return [
        Row(
            "Silverbox",
            f"multisines, {train.n_samples:,} samples",
            f"multisines, {test.n_samples:,} samples",
            error_of_run(model, test, INITIAL["Silverbox"]),
            rms(test),
            "mV",
            1e3,
            n_parameters(model),
            seconds,
            model,
        )
    ]


def emps(quick: bool) -> list[Row]:
    """Mass, viscous and dry friction, offset; each half tested on the other."""
    every = measured_sets.load_emps()
    middle = every.n_samples // 2
    halves = {
        "first half": every.rows(slice(0, middle)),
        "second half": every.rows(slice(middle, every.n_samples)),
    }
    pairs = [
        ("all", every, "itself", every),
        ("first half", halves["first half"], "second half", halves["second half"]),
        ("second half", halves["second half"], "first half", halves["first half"]),
    ]
    rows = []
    for trained, train, tested, test in pairs:
        law = [laws.LinearViscous(), laws.CoulombFriction(), laws.ConstantForce()]
        model, seconds = fitted(train, law)
        rows.append(
            Row(
                "EMPS",
                trained,
                tested,
                error_of_run(model, test, INITIAL["EMPS"]),
                rms(test),
                "mm",
                1e3,
                n_parameters(model),
                seconds,
                model,
            )
        )
    return rows


def bouc_wen(quick: bool) -> list[Row]:
    """Mass, dashpot, spring and Bouc-Wen; each official test tested by the other."""
    multisine = measured_sets.load_bouc_wen_benchmark("multisine")
    sweep = measured_sets.load_bouc_wen_benchmark("sinesweep")
    pairs = [("multisine", multisine, "sweep", sweep)]
    if not quick:
        pairs.append(("sweep", sweep, "multisine", multisine))

    rows = []
    for trained, train, tested, test in pairs:
        model, seconds = fitted(train, [laws.PowerSeries(1), laws.BoucWen()])
        steady = tested == "multisine"
        error = error_in_steady_state if steady else error_from_rest
        rows.append(
            Row(
                "Bouc-Wen",
                f"{trained}, {train.n_samples:,} samples",
                f"{tested}, {test.n_samples:,} samples",
                error(model, test),
                rms(test),
                "m",
                1.0,
                n_parameters(model),
                seconds,
                model,
            )
        )
    return rows


def error_from_rest(model: NRFRegressor, record: Record) -> float:
    """Rms error of the free run from rest over a record."""
    run = model.simulate(record.force, dt=record.dt)
    error = run.displacement - record.displacement
    return float(np.sqrt(np.mean(error**2)))


RECORDS: dict[str, Callable[[bool], list[Row]]] = {
    "silverbox": silverbox,
    "emps": emps,
    "bouc_wen": bouc_wen,
}


def main(arguments: list[str] | None = None) -> None:
    """Print the rows, and the parameters with their intervals."""
    parser = options_of(__doc__, quick="a part of the samples, one fit of Bouc-Wen")
    parser.add_argument("names", nargs="*", help=f"of {', '.join(RECORDS)}")
    options = parser.parse_args(arguments)
    rows: list[Row] = []
    for name in options.names or RECORDS:
        rows += RECORDS[name](options.quick)
    print(markdown(pd.DataFrame([row.cells() for row in rows], columns=HEADER)))

    for row in rows:
        print(f"\n{row.record}, trained on {row.trained}")
        table = quietly(row.model.confidence_intervals)
        print(table.to_string(index=False, float_format="{:.5g}".format))
        for group in row.model.model_.laws.values():
            for law in group:
                if law.shape:
                    print(law)


if __name__ == "__main__":
    main()
