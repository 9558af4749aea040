"""Each measured record from its undeclared baseline: held-out error before and after, effect by effect.

    python benchmarks/measured_records.py                 # all
    python benchmarks/measured_records.py emps bouc_wen   # some

``close_loop`` gets records in SI units, the baseline and the band; everything else is its default.
Data: the folder that PYSINDY_NRF_DATA names, or ``../shared/data``.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "2")
os.environ.setdefault("PYSINDY_NRF_DATA", str(Path(__file__).resolve().parents[2] / "shared" / "data"))
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np  # noqa: E402
from battery import measured  # noqa: E402

from pysindy_nrf import NRFRegressor, close_loop, laws  # noqa: E402
from pysindy_nrf.exceptions import NRFError  # noqa: E402

Check = tuple[str, str, bool | None]
HAND = {  # found by hand, with the same bands
    "emps": "17-18 -> Coulomb 7 -> offset or v^2: 4",
    "nees_s5": "30/27/38 -> hysteresis 14/10/21",
    "nees_s1": "24/19/31, nothing",
    "nees_isolated": "friction",
    "dry_friction": "17.7 -> friction against the ground 8.1 (in the storey: 16.3)",
    "mr_damper": "50 -> friction or Dahl 33 -> times voltage 26 -> lagged 15-18",
    "mr_cyclic": "30, cubic 17 -> friction along v + k x 11-13",
    "bouc_wen": "25 -> Bouc-Wen 0.5",
    "hotel": "21, nothing",
}


def families(step) -> set[str]:
    """The step's family and its declared ties."""
    return {step.family, *step.alternatives}


def held(report) -> list[float]:
    """Held-out pooled errors: baseline and each step, percent."""
    return [float(x) for x in report.table["held-out"]]


def told(name: str, found: str) -> Check:
    """Something to read, not to pass."""
    return name, found, None


def in_range(name: str, value: float, low: float, high: float) -> Check:
    return f"{name} {low:g} to {high:g}", f"{value:.4g}", bool(low <= value <= high)


def at_most(name: str, value: float, limit: float) -> Check:
    return f"{name} at most {limit:g} %", f"{value:.3g}", bool(value <= limit)


def is_so(name: str, found: str, so: bool) -> Check:
    return name, found, bool(so)


def steps_text(report) -> str:
    return "; ".join(f"{s.law} at {s.site}" for s in report.steps) or "nothing"


def storey_errors(report, records, band) -> list[np.ndarray]:
    """Error of each storey's force against the inertia above it, on the held-out rows; baseline first."""
    from pysindy_nrf.discrepancy.splits import split

    from pysindy_nrf.discrepancy.prepare import prepare
    from pysindy_nrf.signals.zero_phase_filter import FairFilter

    ready = prepare(records)
    _, blocks = split(ready.data.segments)
    out = []
    for model in report.models:
        top = bottom = 0.0
        residuals = model.balance_forces(ready.data)
        for block in blocks:
            seg = ready.data.segments[block.segment]
            a = np.asarray(seg.a[seg.valid], dtype=float) * model.masses
            pair = [np.cumsum(y[:, ::-1], axis=1)[:, ::-1] for y in (residuals[block.segment], a)]
            if band is not None:
                filter = FairFilter(band, 1 / seg.dt)
                pair = [filter.apply(y) for y in pair]
            top = top + (pair[0][block.rows] ** 2).sum(axis=0)
            bottom = bottom + (pair[1][block.rows] ** 2).sum(axis=0)
        out.append(100 * np.sqrt(top / bottom))
    return out


def slashed(values) -> str:
    return " / ".join(f"{x:.1f}" for x in values)


# -- the records --------------------------------------------------------------------------------


def emps():
    record, without = (
        measured.load_emps(),
        NRFRegressor(laws={1: laws.LinearViscous()}),
    )  # a stage on rails has no spring
    report = close_loop(record, NRFRegressor(degree=1), band=(None, 20.0))
    e = held(report)
    checks = [
        is_so("first: friction", steps_text(report), bool(report.steps) and "friction" in families(report.steps[0]))
    ]
    checks += [at_most("after the first effect", e[min(1, len(e) - 1)], 9.0), at_most("after all", e[-1], 5.5)]
    for how, one in (
        ("springs declared", report),
        ("no spring declared", close_loop(record, without, band=(None, 20.0))),
    ):
        numbers = next((n for m in reversed(one.models) if (n := _emps_numbers(m)) is not None), (np.nan,) * 4)
        for (name, low, high), value in zip(
            (("M", 94, 96), ("viscous", 195, 210), ("Coulomb", 19.8, 21.2), ("offset", -3.5, -2.9)), numbers
        ):
            checks.append(in_range(f"{name} ({how})", value, low, high))
    return [report], checks


def _emps_numbers(model):
    """Mass, viscous damping, Coulomb friction and offset, if the model is of these."""
    every = [law for held_ in model.laws.values() for law in held_]
    values = {}
    for law in every:
        p = law.parameters
        if law.name == "coulomb_friction":
            values["Fc"] = p["Fc"]
        elif law.name == "asymmetric_friction":
            values["Fc"], values["f0"] = (p["Fp"] + p["Fm"]) / 2, (p["Fp"] - p["Fm"]) / 2
        elif law.name == "constant_force":
            values["f0"] = p["f0"]
        elif law.name in ("power_series", "linear_viscous"):
            values["c"] = model.restoring_forces["storey 1"].coefficients["v"]
        else:
            return None
    return (model.masses[0], values["c"], values["Fc"], values["f0"]) if {"Fc", "f0", "c"} <= set(values) else None


def nees_s5():
    band, record = (0.2, 10.0), measured.load_nees_three_storey("fbgm162s5")
    report = close_loop(record, NRFRegressor(degree=1, known_masses={1: 1.0, 2: 1.0, 3: 1.0}), band=band)
    errors = storey_errors(report, record, band)
    with_memory = {s.site for s in report.steps if "hysteresis" in families(s)}
    checks = [
        is_so("hysteresis in every storey", steps_text(report), {"storey 1", "storey 2", "storey 3"} <= with_memory)
    ]
    for i, limit in enumerate((20, 15, 28)):
        checks.append(at_most(f"storey {i + 1} after (before: {errors[0][i]:.1f})", errors[-1][i], limit))
    said = [line for line in str(report).splitlines() if "not explained" in line or "unexplained" in line]
    checks.append(
        is_so("storey 3: remaining coupling reported", " ".join(said) or "not said", any("3" in line for line in said))
    )
    return [report], checks + [told("storeys 1 / 2 / 3: baseline and each step", " -> ".join(map(slashed, errors)))]


def nees_s1():
    band, record = (0.2, 10.0), measured.load_nees_three_storey("fbgm162s1")
    report = close_loop(record, NRFRegressor(degree=1, known_masses={1: 1.0, 2: 1.0, 3: 1.0}), band=band)
    errors = storey_errors(report, record, band)
    return [report], [
        is_so("nothing accepted", steps_text(report), not report.steps),
        told("storeys", " -> ".join(map(slashed, errors))),
    ]


def nees_isolated():
    report = close_loop(
        measured.nees_isolated(), NRFRegressor(degree=1, known_masses={j: 1.0 for j in (1, 2, 3, 4)}), band=(0.2, 10.0)
    )
    ok = any("friction" in families(s) and s.site == "storey 1" for s in report.steps)
    return [report], [is_so("isolator (storey 1): friction", steps_text(report), ok)]


def dry_friction():
    report = close_loop(measured.dry_friction(), NRFRegressor(degree=1, known_masses={1: 1.0}), band=(None, 20.0))
    e = held(report)
    first = report.steps[0] if report.steps else None
    stiffness = report.model.restoring_forces["storey 1"].linear_part()["k"]
    return [report], [
        is_so("friction against the ground", steps_text(report), first is not None and first.law == "ground_friction"),
        is_so(
            "no friction in the storey",
            steps_text(report),
            not any(s.family == "friction" and s.site == "storey 1" for s in report.steps),
        ),
        at_most("after", e[-1], 10),
        in_range("k/m", stiffness, 380, 395),
    ]


def mr_damper():
    report = close_loop(
        measured.load_mr_damper_white_noise(), NRFRegressor(degree=1, known_masses={1: 0.0}), band=(None, 60.0)
    )
    e = held(report)
    following = [min(e[i + 1 :]) for i, s in enumerate(report.steps) if "covariate" in s.law]
    lagged = [
        min(e[i + 1 :]) for i, s in enumerate(report.steps) if s.law in ("lagged_covariate_friction", "covariate_dahl")
    ]
    return [report], [
        is_so(
            "first: friction or Dahl",
            steps_text(report),
            bool(report.steps) and bool({"friction", "hysteresis"} & families(report.steps[0])),
        ),
        at_most("after the first effect", e[min(1, len(e) - 1)], 39),
        at_most("with voltage", min(following, default=np.nan), 30),
        at_most("with lagged voltage", min(lagged, default=np.nan), 21),
    ]


def _cyclic(record):
    """The loop on one run, and the cubic series' held-out error."""

    def declared(degree):
        return NRFRegressor(laws={1: [laws.PowerSeries(degree), laws.ConstantForce()]}, known_masses={1: 0.0})

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cubic = close_loop(record, declared(3), band=(None, 8.0), max_steps=0)
        return close_loop(record, declared(1), band=(None, 8.0)), held(cubic)[0]


def mr_cyclic():
    from joblib import Parallel, delayed

    reports, cubic = zip(*Parallel(n_jobs=2)(delayed(_cyclic)(record) for record in measured.mr_cyclic()))
    before, after = (float(np.median([held(r)[i] for r in reports])) for i in (0, -1))
    kinds: dict[str, int] = {}
    for r in reports:
        first = r.steps[0].law if r.steps else "nothing"
        kinds[first] = kinds.get(first, 0) + 1
    return reports[:1], [
        told(f"median before of {len(reports)}", f"{before:.3g}"),
        at_most("median after", after, 16),
        is_so("below the cubic series", f"{after:.3g} against {np.median(cubic):.3g}", after < np.median(cubic)),
        told("first effects", ", ".join(f"{k} {n}" for k, n in sorted(kinds.items(), key=lambda x: -x[1]))),
    ]


def bouc_wen():
    report = close_loop(measured.load_bouc_wen_benchmark(), NRFRegressor(degree=1), band=(None, 150.0))
    e = held(report)
    first = report.steps[0] if report.steps else None
    checks = [
        is_so("Bouc-Wen", steps_text(report), first is not None and first.law == "bouc_wen"),
        at_most("after", e[-1], 1.5),
    ]
    if first is not None and first.law == "bouc_wen":
        linear = report.model.restoring_forces["storey 1"].linear_part()
        p = first.parameters
        for name, value, truth in (
            ("m", report.model.masses[0], 2.0),
            ("c", linear["c"], 10.0),
            ("k", linear["k"], 5e4),
            ("alpha", p["alpha"], 5e4),
            ("beta gamma", p["beta"], 800.0),
            ("delta/gamma", p["rho"], -1.375),
            ("nu", p["n"], 1.0),
        ):
            checks.append(in_range(name, value, *sorted((0.9 * truth, 1.1 * truth))))
    return [report], checks


def hotel():
    records = measured.hotel()
    report = close_loop(records, NRFRegressor(degree=1, known_masses={1: 1.0, 2: 1.0}))
    errors = storey_errors(report, records, None)
    return [report], [
        is_so("nothing accepted", steps_text(report), not report.steps),
        told("storeys", " -> ".join(map(slashed, errors))),
    ]


SETS: dict[str, Callable] = {
    f.__name__: f for f in (emps, nees_s5, nees_s1, nees_isolated, dry_friction, mr_damper, mr_cyclic, bouc_wen, hotel)
}


def main(arguments: list[str] | None = None) -> dict[str, list[Check]]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", choices=[*SETS, []], help="sets to run; all by default")
    o = parser.parse_args(arguments)
    out = {}
    for name in o.sets or SETS:
        start = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                reports, checks = SETS[name]()
        except NRFError as error:
            if "folder" not in str(error):
                raise
            print(f"## {name}\n\nskipped: {error}\n")
            continue
        out[name] = checks
        print(
            f"## {name} ({time.perf_counter() - start:.0f} s)\n\nBy hand: {HAND[name]}\n\nHeld-out: "
            + " -> ".join(f"{x:.3g}" for x in held(reports[0]))
            + " %\n"
        )
        print(f"{reports[0]}\n\n| check | found | |\n|---|---|---|")
        for what, found, passed in checks:
            print(f"| {what} | {found} | {'' if passed is None else 'PASS' if passed else 'FAIL'} |")
        print(flush=True)
    return out


if __name__ == "__main__":
    main()
