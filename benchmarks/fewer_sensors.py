"""Fewer sensors than floors: what the free run fitted to the channels that there are
finds.

    python benchmarks/fewer_sensors.py --quick     # two runs of the linear rows: some seconds
    python benchmarks/fewer_sensors.py             # 300 runs for the intervals, 30 of each law: hours
    python benchmarks/fewer_sensors.py --only linear --runs 20

Chains with masses of 8 to 16 kg, 100 to 200 kN/m and 15 to 40 N s/m, drawn anew for
each run; 8 s at 200 Hz of a random force on the top floor. Noise is white on every
channel, the force included, as a share of its RMS.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import IdentifiabilityError
from pysindy_nrf.identification.fewer_sensors import estimate, shot_of
from pysindy_nrf.simulation.noise import add_noise

FS, DURATION, RMS, BAND = 200.0, 8.0, 100.0, (0.5, 50.0)
GAP, FRICTION, CUBE = (
    2e-3,
    30.0,
    4e9,
)  # m, N, N/m^3: about a tenth of the storey's force


def chain(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, stiffnesses and damping of a run."""
    rng = np.random.default_rng([seed, n])
    return rng.uniform(8, 16, n), rng.uniform(1e5, 2e5, n), rng.uniform(15, 40, n)


def hidden(record: Record, floors) -> Record:
    """The accelerations of some floors, and the forces."""
    there = np.isin(np.arange(1, record.n_dof + 1), floors)
    return Record(
        force=record.force,
        acceleration=np.where(there, record.acceleration, np.nan),
        fs=record.fs,
        base_acceleration=record.base_acceleration,
    )


def linear(n: int, noise: float, seed: int) -> tuple[float, float, str]:
    """Worst relative error of masses and stiffnesses, share of 95 % intervals that hold
    the truth, or a refusal.
    """
    m, k, c = chain(n, seed)
    truth = ChainModel(m, {i + 1: laws.PowerSeries(1, [c[i], k[i]]) for i in range(n)})
    F = excitation.band_limited_random(
        n, DURATION, FS, excited=[n], rms=RMS, band=BAND, random_state=seed
    )
    record = simulate(truth, F, 1 / FS)
    record = add_noise(record, noise, random_state=[seed, 1]) if noise else record
    try:
        model = quietly(NRFRegressor(degree=1).fit, hidden(record, [n]))
    except IdentifiabilityError as error:
        return np.nan, np.nan, error.what
    ci = quietly(model.confidence_intervals).set_index("parameter")
    names = [f"m{j}" for j in range(1, n + 1)] + [
        f"storey {j}: s" for j in range(1, n + 1)
    ]
    true = np.concatenate([m, k])
    ci = ci.loc[names]
    if ci["lower"].isna().any():
        return np.nan, np.nan, "another chain fits as well"
    inside = (ci["lower"] <= true) & (true <= ci["upper"])
    return float(np.abs(ci["estimate"] / true - 1).max()), float(inside.mean()), ""


def quietly(function, *given):
    """Call without warnings."""
    with warnings.catch_warnings(action="ignore"):
        return function(*given)


def held(law: str, c: float, k: float) -> tuple[list, list]:
    """The true laws of storey 2, and what the estimator is told of them."""
    if law == "cubic":
        return [laws.Duffing(k, CUBE), laws.LinearViscous(c)], [
            laws.Duffing(),
            laws.LinearViscous(),
        ]
    if law == "gap":
        stops = laws.TwoSidedGap(gap=GAP, k=k / 2)
        return [laws.PowerSeries(1, [c, k]), stops], [
            laws.PowerSeries(1),
            laws.TwoSidedGap(),
        ]
    return [laws.PowerSeries(1, [c, k]), laws.CoulombFriction(FRICTION)], [
        laws.PowerSeries(1),
        laws.CoulombFriction(),
    ]


def nonlinear(law: str, noise: float, seed: int) -> tuple[float, float, str]:
    """Worst relative error of the masses and of the parameters of the law in storey 2;
    floors 2 and 4 have sensors.
    """
    m, k, c = chain(4, seed)
    true, told = held(law, c[1], k[1])
    storeys = {i + 1: [laws.PowerSeries(1, [c[i], k[i]])] for i in range(4)}
    truth = ChainModel(m, {**storeys, 2: true})
    F = excitation.band_limited_random(
        4, DURATION, FS, excited=[4], rms=RMS, band=BAND, random_state=seed
    )
    record = add_noise(simulate(truth, F, 1 / FS), noise, random_state=[seed, 1])
    try:
        model = quietly(
            NRFRegressor(degree=1, laws={"storey 2": told}).fit, hidden(record, [2, 4])
        ).model_
    except IdentifiabilityError as error:
        return np.nan, np.nan, error.what
    own = [
        v
        for one in (true if law == "cubic" else true[1:])
        for v in one.parameters.values()
    ]
    found = [
        v
        for one in (
            model.laws["storey 2"] if law == "cubic" else model.laws["storey 2"][1:]
        )
        for v in one.parameters.values()
    ]
    if law == "cubic":
        own, found = own[1:2], found[1:2]
    return (
        float(np.abs(model.masses / m - 1).max()),
        float(np.abs(np.divide(found, own) - 1).max()),
        "",
    )


def compared(n: int, noise: float, seed: int) -> tuple[float, float, float]:
    """Shares of 95 % intervals of masses and stiffnesses that hold the truth: from
    pieces of the data, from curvature.

    The third number is the median width by pieces over that by curvature, the inverse
    of the normal matrix.
    """
    m, k, c = chain(n, seed)
    F = excitation.band_limited_random(
        n, DURATION, FS, excited=[n], rms=RMS, band=BAND, random_state=seed
    )
    truth = ChainModel(m, {i + 1: laws.PowerSeries(1, [c[i], k[i]]) for i in range(n)})
    record = hidden(
        add_noise(simulate(truth, F, 1 / FS), noise, random_state=[seed, 1]), [n]
    )
    with warnings.catch_warnings(action="ignore"):
        fit, best, _ = estimate(
            NRFRegressor(degree=1).problem(n), [shot_of(record, 0, n)], {}
        )
    true = [*m, *(value for pair in zip(c, k) for value in pair)]
    judged = np.r_[:n, n + 1 : 3 * n : 2]  # not damping
    now = fit.rebuild.values(best.u)
    slope = fit.rebuild.slopes(best.u)
    pieces = np.sqrt((best.influences**2).sum(axis=0)) * slope
    curvature = np.sqrt(np.diag(np.linalg.inv(best.jacobian.T @ best.jacobian))) * slope
    inside = [
        float((np.abs(now - true) < 1.96 * half)[judged].mean())
        for half in (pieces, curvature)
    ]
    return *inside, float(np.median((pieces / curvature)[judged]))


HIDDEN = ("friction", "cubic", "square", "gap", "none")


def effect(
    kind: str, share: float, force: float, s: np.ndarray, v: np.ndarray
) -> laws.ForceLaw:
    """A law whose force is a share of a storey's, along a motion."""
    if kind == "friction":
        return laws.CoulombFriction(share * force)
    if kind == "cubic":
        return laws.CubicStiffness(share * force / np.sqrt(np.mean(s**6)))
    if kind == "square":
        return laws.QuadraticDamping(share * force / np.sqrt(np.mean(v**4)))
    gap = 0.8 * s.std()
    return laws.TwoSidedGap(
        gap=gap,
        k=share * force / np.sqrt(np.mean(np.maximum(np.abs(s) - gap, 0.0) ** 2)),
    )


def looped(
    noise: float, seed: int, share: float = 0.12
) -> tuple[str, str, list[str], float]:
    """``close_loop`` with floors 2 and 4 measured: the hidden law, its storey, what is
    found, held-out error before.
    """
    m, k, c = chain(4, seed)
    kind, i = HIDDEN[seed % len(HIDDEN)], (seed // len(HIDDEN)) % 4
    plain = {j + 1: [laws.PowerSeries(1, [c[j], k[j]])] for j in range(4)}
    F = excitation.band_limited_random(
        4, DURATION, FS, excited=[4], rms=RMS, band=BAND, random_state=seed
    )
    truth = ChainModel(m, plain)
    record = simulate(truth, F, 1 / FS)
    law = ""
    for _ in range(3 if kind != "none" else 0):
        s, v = (
            np.diff(y, axis=1, prepend=0.0)[:, i]
            for y in (record.displacement, record.velocity)
        )
        hidden_law = effect(
            kind, share, float(np.sqrt(np.mean((k[i] * s + c[i] * v) ** 2))), s, v
        )
        record = simulate(
            ChainModel(m, plain | {i + 1: [*plain[i + 1], hidden_law]}), F, 1 / FS
        )
        law = hidden_law.name
    with warnings.catch_warnings(action="ignore"):
        try:
            report = close_loop(
                hidden(add_noise(record, noise, random_state=[seed, 1]), [2, 4])
            )
        except IdentifiabilityError as error:
            return law, f"storey {i + 1}", [f"refused: {error.what}"], np.nan
    found = [f"{step.law} at {step.site}" for step in report.steps if step.confirmed]
    return law, f"storey {i + 1}", found, float(report.table["held-out"].iloc[0])


def steady(frf, band: tuple[float, float], seed: int = 0) -> Record:
    """A period of the steady motion under a random-phase multisine in a band, from
    measured frequency responses.
    """
    n = 2 * len(frf.f)
    inside = (frf.f >= band[0]) & (frf.f <= band[1])
    lines = np.zeros((n // 2 + 1, frf.H.shape[1] + 1), dtype=complex)
    phases = np.exp(2j * np.pi * np.random.default_rng(seed).random((inside.sum(), 1)))
    lines[1:][inside] = phases * np.column_stack([np.ones(inside.sum()), frf.H[inside]])
    force, *motion = np.fft.irfft(lines, n, axis=0).T
    F = np.zeros((n, len(motion)))
    F[:, frf.excited - 1] = force
    return Record(
        force=F,
        acceleration=np.column_stack(motion),
        fs=n * (frf.f[1] - frf.f[0]),
        name=frf.name,
    )


def predicted(record: Record, floor: int, estimator: NRFRegressor) -> float:
    """Percent NRMSE of the motion of a floor that was hidden from the fit."""
    kind = "acceleration" if record.acceleration is not None else "displacement"
    values = np.array(getattr(record, kind))
    measured = values[:, floor - 1].copy()
    values[:, floor - 1] = np.nan
    model = quietly(estimator.fit, record.replace(**{kind: values}))
    if kind == "displacement" and record.coordinates == "absolute":
        measured -= record.base_displacement
    return nrmse(
        measured,
        model.motions_[0][f"{kind[0] if kind[0] == 'a' else 'x'}{floor}"].to_numpy(),
    )


def report(name: str, record: Record, floor: int, estimator: NRFRegressor) -> None:
    """Print by how much the motion of a hidden floor is missed."""
    try:
        said = f"{predicted(record, floor, estimator):.1f} % NRMSE off"
    except IdentifiabilityError as error:
        said = f"refused: {error.what}"
    print(f"{name}, floor {floor} hidden: its motion is {said}", flush=True)


def row(name: str, results: list[tuple[float, float, str]], second: str) -> None:
    """Print the medians of a row."""
    worst, other = (np.array([r[k] for r in results]) for k in (0, 1))
    there, refused = np.isfinite(worst), sum(bool(r[2]) for r in results)
    if not there.any():
        print(f"{name:42s} refused in all of {len(results)}", flush=True)
        return
    share = 100 * (
        np.mean(other[there]) if second == "inside" else np.median(other[there])
    )
    print(
        f"{name:42s} worst error, median {100 * np.median(worst[there]):8.2g} %,"
        f" largest {100 * worst[there].max():8.2g} %; {second} {share:6.3g} %; refused,"
        f" or no interval, {refused} of {len(results)}",
        flush=True,
    )


def main(arguments: list[str] | None = None) -> None:
    """Print every row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true")
    parser.add_argument(
        "--only", choices=("linear", "intervals", "laws", "loop", "measured")
    )
    parser.add_argument("--runs", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)
    began = time.perf_counter()

    def runs(function, count: int, *given) -> list:
        return Parallel(options.jobs)(
            delayed(function)(*given, seed) for seed in range(count)
        )

    if options.only in (None, "linear"):
        for n in (2, 3) if options.quick else (2, 3, 4, 5):
            for noise in (0.0, 0.005) if options.quick else (0.0, 0.005, 0.02):
                count = options.runs or (2 if options.quick else 300 if noise else 10)
                row(
                    f"linear, {n} floors, top alone, {100 * noise:g} % noise",
                    runs(linear, count, n, noise),
                    "inside",
                )
    if options.only in (None, "intervals"):
        for n, noise in (
            ((2, 0.005),) if options.quick else ((3, 0.005), (3, 0.02), (4, 0.02))
        ):
            count = options.runs or (2 if options.quick else 100)
            pieces, curvature, ratio = np.array(runs(compared, count, n, noise)).T
            print(
                f"intervals, {n} floors, {100 * noise:g} % noise: pieces"
                f" {100 * pieces.mean():.1f} % hold,",
                end=" ",
            )
            print(
                f"curvature {100 * curvature.mean():.1f} %; width over width"
                f" {np.median(ratio):.2f}",
                flush=True,
            )
    if options.only in (None, "laws") and not options.quick:
        for law in ("cubic", "gap", "friction"):
            row(
                f"{law} in storey 2, sensors 2 and 4, 1 %",
                runs(nonlinear, options.runs or 30, law, 0.01),
                "law",
            )
    if options.only in (None, "loop") and not options.quick:
        right = none = 0
        for law, site, found, before in runs(looped, options.runs or 250, 0.005):
            good = found == ([f"{law} at {site}"] if law else [])
            right, none = right + (good and bool(law)), none + (good and not law)
            print(
                f"{law or 'nothing':18s} {site}: {', '.join(found) or 'nothing'}"
                f" (linear chain {before:.2g} % off)"
            )
        print(
            f"close_loop, sensors 2 and 4, 0.5 %: right {right}, nothing found where"
            f" nothing is {none}"
        )
    if options.only in (None, "measured") and not options.quick:
        sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
        import measured_sets

        equal, bends = (
            {1: 5.201, 2: 5.201, 3: 5.201},
            {s: [laws.BendingCoupling()] for s in ("link 3-1", "ground 2")},
        )
        for seed in range(3):
            record = steady(measured_sets.load_three_storey_frf(), (4.0, 32.0), seed)
            for floor in (3, 2, 1):
                report(
                    f"three_storey_frf {seed}", record, floor, NRFRegressor(degree=1)
                )
            for floor in (3, 2, 1) if not seed else ():
                declared = NRFRegressor(degree=1, laws=bends, known_masses=equal)
                report(
                    "three_storey_frf, masses known, bending declared",
                    record,
                    floor,
                    declared,
                )
        for test in ("fbgm162s1", "fbgm162s3", "fbgm162s5"):
            record = measured_sets.load_nees_three_storey(test)
            for floor in (3, 2, 1):
                declared = NRFRegressor(degree=1, known_masses={1: 1.0, 2: 1.0, 3: 1.0})
                report(f"nees_three_storey {test}", record, floor, declared)
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
