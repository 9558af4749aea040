"""What the foundation claims, measured: one table for each topic, PASS or FAIL in every
row.

    python benchmarks/foundation.py [--quick] [--only TOPIC]

``--quick`` takes fewer seeds, samples and forced floors (under 20 s). Cases,
independent integrators and least squares in extended precision are those of ``tests``:
install ``pysindy-nrf[test]``. Measured data: the folder that PYSINDY_NRF_DATA names, or
``../shared/data``; skipped, with the reason, if absent. Exit code 1 if a row fails.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("PYSINDY_NRF_DATA", str(ROOT.parent / "shared" / "data"))
sys.path[:0] = [str(ROOT / folder) for folder in ("tests", "benchmarks", "examples")]
sys.path += [str(folder) for folder in (ROOT / "tests").iterdir() if folder.is_dir()]

import chains  # noqa: E402
import measured_sets  # noqa: E402
import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
import pysindy as ps  # noqa: E402
import test_comparison  # noqa: E402
import test_signals as four_floors  # noqa: E402
import test_simulation as two_storeys  # noqa: E402
from bad_inputs_battery import every_kind, judge  # noqa: E402
from paper_tables import independent_masses  # noqa: E402

from pysindy_nrf import (
    Chain,
    ChainOptimizer,
    InterstoryPolynomialLibrary,
    KinematicSmoother,
    NRFRegressor,
    Record,
    StateSpaceChainOptimizer,
    compare_with_sindy,
    laws,
)
from pysindy_nrf.chain.identifiability import plan_solve_order  # noqa: E402
from pysindy_nrf.chain.layout import Layout, blocks_of  # noqa: E402
from pysindy_nrf.equations.chain_solve import solve_blocks  # noqa: E402
from pysindy_nrf.exceptions import NRFError  # noqa: E402
from pysindy_nrf.simulation import free_run  # noqa: E402

Row = tuple[str, str, str]  # claim, measured, verdict
EXACT = 1e-8
REPRESENTATIVE = {
    "wrong number of columns": "one column short",
    "NaN samples": "NaN inside",
    "infinite samples": "infinity",
    "all-zero force": "all-zero force",
    "unequal lengths": "unequal lengths",
    "constant channel": "constant velocity",
    "too few samples for the terms": "fewer samples than unknowns",
    "unknown column names": "unknown column",
    "missing column": "missing column",
    "degree 2.5": "degree 2.5",
    "degree -1": "degree -1",
    "shuffled record, law with memory": "shuffled rows, a law with memory",
}


def row(claim: str, measured: str, so: bool) -> Row:
    return claim, measured, "PASS" if so else "FAIL"


def below(claim: str, value: float, limit: float, unit: str = "") -> Row:
    return row(
        f"{claim}: below {limit:g}{unit}", f"{value:.2g}{unit}", bool(value < limit)
    )


def show(title: str, rows: list[Row]) -> None:
    cells = [tuple(cell.replace("|", "\\|") for cell in r) for r in rows]
    print(f"## {title}\n\n| claim | measured | |\n|---|---|---|")
    print(
        "\n".join(
            f"| {claim} | {measured} | {verdict} |"
            for claim, measured, verdict in cells
        ),
        flush=True,
    )


def rms(y: np.ndarray, axis: int | None = 0):
    return np.sqrt(np.mean(np.square(y), axis=axis))


def parameter_error(model: NRFRegressor, case: chains.Case) -> float:
    """Worst relative error of masses and true coefficients."""
    found = [model.restoring_forces_[i].coefficients for i in range(1, case.n + 1)]
    truth = {"v": case.c, "s": case.k, **({"s^3": case.k3} if case.k3.any() else {})}
    return max(
        chains.worst(model.masses_, case.m),
        *(chains.worst([f[t] for f in found], y) for t, y in truth.items()),
    )


def absent(model: NRFRegressor, case: chains.Case) -> float:
    return chains.absent_share(
        model, case, ("v", "s", "s^3") if case.k3.any() else ("v", "s")
    )


# -- 1: noise-free chains ------------------------------------------------------


def exact_rows(name: str, cases: list[chains.Case], **options) -> list[Row]:
    models = [NRFRegressor(degree=3, **options).fit(case.X, case.F) for case in cases]
    done = {m.solve_order_.strategy for m in models}
    name = f"{name} (chains: {len(cases)}; {' or '.join(sorted(done))})"
    return [
        below(
            f"{name}, masses and true coefficients",
            max(map(parameter_error, models, cases)),
            EXACT,
        ),
        below(
            f"{name}, absent terms, share of the storey's force",
            max(map(absent, models, cases)),
            EXACT,
        ),
    ]


def noise_free(quick: bool) -> list[Row]:
    rows = []
    for kind, cubic in (("linear", False), ("Duffing", True)):
        seeds, sizes, large = (
            (range(1), (1, 2, 4), 10) if quick else (range(3), range(1, 11), 50)
        )
        single = [
            c
            for n in sizes
            for q in seeds
            for c in chains.each_single(n, n + 100 * q, 800, cubic=cubic)
        ]
        every = [
            chains.duffing(n, range(1, n + 1), n + 100 * q, 800, cubic=cubic)
            for n in sizes
            for q in seeds
        ]
        some = (1, large) if quick else range(1, large + 1)
        tall = [chains.duffing(large, [j], 3, 50 * large, cubic=cubic) for j in some]
        name = f"{kind}, n = {sizes[0]}..{sizes[-1]}"
        rows += exact_rows(f"{name}, any one DOF forced", single)
        rows += exact_rows(f"{name}, all forced", every)
        rows += exact_rows(f"{name}, all forced", every, strategy="sequential")
        rows += exact_rows(
            f"{kind}, n = {large}, DOF {'1 or ' + str(large) if quick else 'any'}"
            " forced",
            tall,
        )
        whole = [chains.duffing(large, range(1, large + 1), 3, 50 * large, cubic=cubic)]
        rows += exact_rows(f"{kind}, n = {large}, all forced", whole)
    plain = [c for c in single if c.n <= 4]
    found = [independent_masses(pd.DataFrame(c.X), pd.DataFrame(c.F)) for c in plain]
    worst = max(chains.worst(m, c.m) for m, c in zip(found, plain))
    return [
        *rows,
        below(
            "for comparison: plain sequential least squares in NumPy, masses, n = 1..4",
            worst,
            EXACT,
        ),
    ]


# -- 2: three entrances --------------------------------------------------------


def entrances(quick: bool) -> list[Row]:
    rows = []
    for forced in ([3], [1, 2, 3, 4]):
        for name, inner in {
            "least squares": None,
            "STLSQ": ps.STLSQ(threshold=0.01),
        }.items():
            case = chains.duffing(4, forced, seed=1)
            X = four_floors.with_noise([case.X], 0.02, np.random.default_rng(0))[0]
            own = NRFRegressor(degree=3, optimizer=inner).fit(X, case.F)
            library = InterstoryPolynomialLibrary(3)
            inside = ps.SINDy(
                optimizer=ChainOptimizer(inner, terms=library), feature_library=library
            )
            inside = inside.fit(X, t=case.dt, x_dot=case.F).optimizer
            terms, chain = np.asarray(library.transform(X))[:, 4:], Chain(4)
            solve_order = plan_solve_order(chain, forced, alone=inner is not None)
            layout = Layout(chain, dict.fromkeys(chain.sites, 9))
            rows_of = partial(blocks_of, terms, X[:, :4], case.F)
            direct, _ = solve_blocks(layout, solve_order, rows_of, inner=inner)
            gaps = [
                chains.worst(m, own.masses_)
                for m in (inside.masses_, [direct.masses[j] for j in range(1, 5)])
            ]
            for i in range(1, 5):
                part = slice(9 * (i - 1), 9 * i)
                size, c = (
                    rms(terms[:, part]),
                    own.restoring_forces_[i].coefficients.to_numpy(),
                )
                others = (
                    inside.coef_[i - 1, 4:][part],
                    direct.coefficients[chain.site(i)],
                )
                gaps += [
                    np.abs((other - c) * size).max() / np.linalg.norm(c * size)
                    for other in others
                ]
            rows.append(
                below(
                    f"{name}, DOF {forced} forced, 2 % noise: masses and terms agree",
                    max(gaps),
                    1e-10,
                )
            )
    return rows


# -- 3: simulation -------------------------------------------------------------


def simulation(quick: bool) -> list[Row]:
    rows = []
    for kind, level in (
        ("linear", 200.0),
        ("duffing", 800.0),
        ("dahl", 50.0),
        ("dahl", 800.0),
    ):
        model, F = (
            two_storeys.two_storeys(kind),
            two_storeys.top_force(level, 150 if quick else 1000),
        )
        rest = np.zeros(5 if kind == "dahl" else 4)
        truth = two_storeys.by_scipy(
            two_storeys.two_storey_rate(kind), F, two_storeys.DT, rest
        )[:, :4]
        run = free_run(model, F, two_storeys.DT)
        error = np.abs(
            np.hstack([run.record.displacement, run.record.velocity]) - truth
        ).max(0) / np.abs(truth).max(0)
        gap = free_run(
            model, two_storeys.top_force(level, 2000), two_storeys.DT
        ).energy_gap
        rows.append(
            below(
                f"{kind}, {level:g} N rms: x and v against SciPy's DOP853, relative",
                error.max(),
                1e-5,
            )
        )
        rows.append(below(f"{kind}, {level:g} N rms: energy balance", gap, 1e-6))
    return rows + speed(15 if quick else 300)


def speed(n: int) -> list[Row]:
    """10 s at 1 kHz through both; PySINDy on the first n samples."""
    case = chains.duffing(4, [3], seed=1, n_samples=10000)
    state, rate = np.split(case.absolute[:, 4:], 2, axis=1)[::-1], case.a
    state, rate = np.hstack(state), np.hstack([state[1], rate])
    library = InterstoryPolynomialLibrary(3, inputs="state")
    theirs = ps.SINDy(
        optimizer=StateSpaceChainOptimizer(terms=library), feature_library=library
    )
    theirs.fit(state, t=case.dt, x_dot=rate, u=case.F)
    ours = NRFRegressor(degree=3, dt=case.dt).fit(case.X, case.F)
    start = dict(
        x0=state[0, :4], v0=state[0, 4:], hold="cubic"
    )  # PySINDy joins the forces by a cubic
    ours.simulate(case.F[:20], **start)  # compile
    began = time.perf_counter()
    run = ours.simulate(case.F, **start).displacement
    own = time.perf_counter() - began
    began = time.perf_counter()
    slow = theirs.simulate(state[0], np.arange(n) * case.dt, u=case.F[:n])
    per_row = (time.perf_counter() - began) / n
    gap = np.abs(slow[:, :4] - run[: len(slow)]).max() / np.abs(slow[:, :4]).max()
    ratio = per_row * len(case.F) / own
    claim = (
        "4 DOFs, 10 s at 1 kHz, same model, one run: at least 500 times faster than"
        " SINDy.simulate"
    )
    said = f"{ratio:.0f} times: {own:.3f} s against {per_row * len(case.F):.0f} s"
    return [
        row(
            claim,
            f"{said} (extrapolated per row from {n} samples, {1e3 * per_row:.1f} ms"
            " each)",
            ratio >= 500,
        ),
        below("the two runs agree over these samples, relative", gap, 1e-3),
    ]


# -- 4: the paper's damper -----------------------------------------------------


def extended_least_squares(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Least squares by Gram-Schmidt, twice, in 80-bit arithmetic."""
    A = np.asarray(A, dtype=np.longdouble)
    size = np.sqrt((A**2).sum(axis=0))
    A, y = A / size, np.asarray(y, dtype=np.longdouble)
    p = A.shape[1]
    Q, R = A.copy(), np.zeros((p, p), dtype=np.longdouble)
    for j in range(p):
        for _ in range(2):
            share = Q[:, :j].T @ Q[:, j]
            R[:j, j] += share
            Q[:, j] -= Q[:, :j] @ share
        R[j, j] = np.sqrt((Q[:, j] ** 2).sum())
        Q[:, j] /= R[j, j]
    x, z = np.zeros(p, dtype=np.longdouble), Q.T @ y
    for j in range(p - 1, -1, -1):
        x[j] = (z[j] - R[j, j + 1 :] @ x[j + 1 :]) / R[j, j]
    return (x / size).astype(float)


def powers(case: Any, i: int) -> np.ndarray:
    """Columns v^h s^j of a cubic of storey i."""
    v, s = case.v[:, i - 1], case.s[:, i - 1]
    return np.column_stack(
        [v**h * s ** (d - h) for d in range(1, 4) for h in range(d, -1, -1)]
    )


def dahl(quick: bool) -> list[Row]:
    case, *_ = chains.paper_case(duration=2.0 if quick else 4.0)
    cubic = NRFRegressor(degree=3, strategy="complete").fit(
        case.X, case.F
    )  # the paper's way
    R2 = case.storey_forces[:, 1]
    gap2 = np.abs(cubic.restoring_force(case.X)[:, 1] - R2).max() / rms(R2)
    A = np.column_stack([case.a[:, 0], powers(case, 1), -powers(case, 2)])
    exact = extended_least_squares(A, case.F[:, 0])[:10]
    own = np.array([cubic.masses_[0], *cubic.restoring_forces_[1].coefficients])
    gap = np.abs((own - exact) * rms(A[:, :10])).max() / rms(case.F[:, 0])
    held = {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=chains.DAMPER["sigma"])]}
    true = NRFRegressor(degree=1, laws=held, dt=case.dt).fit(case.X, case.F)
    m1 = f"m1 = {own[0]:.6f} kg (truth 10; extended {exact[0]:.6f}), "
    return [
        below("cubic: storey 2, largest error, share of its rms force", gap2, 1e-6),
        row(
            "cubic: numbers of storey 1 equal least squares in 80-bit arithmetic, share"
            " of the force: below 1e-9",
            f"{m1}gap {gap:.1e}",
            gap < 1e-9 and abs(own[0] / exact[0] - 1) < 1e-9,
        ),
        below("true law in storey 1: masses", chains.worst(true.masses_, case.m), 1e-6),
    ]


# -- 5: fusion -----------------------------------------------------------------


def fused(kind: str, seed: int) -> tuple[float, float, float]:
    """Worst mass error fused and filtered only, percent; worst ratio of edge to middle
    error.
    """
    clean = four_floors.chain_test(kind, seed)
    F, a, v, x = four_floors.with_noise(clean, 0.05, np.random.default_rng(100 + seed))
    F[:, [0, 1, 3]] = 0.0
    record = Record(F, a, v, x, fs=four_floors.FS)
    X, force = record.to_features(smooth=KinematicSmoother())
    raw, _ = record.to_features(smooth=False)
    band = dict(degree=1, band=(0.5, 60.0), dt=record.dt)
    found = [
        NRFRegressor(degree=1).fit(X, force).masses_,
        NRFRegressor(**band).fit(raw, force).masses_,
    ]
    errors = [100 * chains.worst(m, np.full(4, four_floors.MASS)) for m in found]
    parts = X.to_numpy(copy=True).reshape(len(X), 3, 4)
    parts[:, 1:] = parts[:, 1:].cumsum(axis=2)
    gap, edge = parts - np.stack(clean[1:], axis=1), len(X) // 20
    ratio = max(
        (rms(gap[cut]) / rms(gap[edge:-edge])).max()
        for cut in (slice(edge), slice(-edge, None))
    )
    return *errors, float(ratio)


def fusion(quick: bool) -> list[Row]:
    rows, seeds = [], range(1 if quick else 10)
    for kind in ("random", "hammer"):
        found = np.array([fused(kind, seed) for seed in seeds])
        name = f"{kind}, 5 % noise on all channels, DOF 3 forced, {len(seeds)} seeds"
        low, high = found[:, 1].min(), found[:, 1].max()
        claim = (
            f"{name}: worst mass error, least squares on fused channels: at most 2 %"
        )
        said = (
            f"{found[:, 0].max():.2f} % (filtered to 0.5-60 Hz only: {low:.1f} to"
            f" {high:.1f} %)"
        )
        rows.append(row(claim, said, found[:, 0].max() <= 2))
        worst = found[:, 2].max()
        rows.append(
            row(
                f"{name}: error at the edges at most twice the middle's",
                f"{worst:.2f} times",
                worst <= 2,
            )
        )
    return rows


# -- 6: base excitation, roving hammer -----------------------------------------


def scaled_otherwise(quick: bool) -> list[Row]:
    ag = chains.band_limited(4000, 1e-3, np.random.default_rng(5), rms=2.0)
    case, rows = chains.duffing(4, [], seed=7, n_samples=4000, ag=ag), []
    for j in range(1, 5):
        model = NRFRegressor(degree=3, known_masses={j: case.m[j - 1]}).fit(
            case.X, base_acceleration=ag
        )
        error = max(parameter_error(model, case), absent(model, case))
        rows.append(
            below(
                f"base excitation, 4 DOFs, only m{j} known: masses and terms",
                error,
                EXACT,
            )
        )
    same = chains.parameters(3, np.random.default_rng(9))
    hits = [
        chains.duffing(3, [j], seed=20 + j, n_samples=1200 + 300 * j, given=same)
        for j in (1, 2, 3)
    ]
    ids = np.repeat([1, 2, 3], [len(c.X) for c in hits])
    roving = NRFRegressor(degree=3).fit(
        np.vstack([c.X for c in hits]), np.vstack([c.F for c in hits]), record=ids
    )
    once = chains.duffing(3, [1, 2, 3], seed=30, given=same)
    together = NRFRegressor(degree=3).fit(once.X, once.F)
    motion = once.X[::10]
    gap = np.abs(roving.restoring_force(motion) - together.restoring_force(motion)).max(
        0
    ) / rms(once.storey_forces)
    name = "roving hammer, three records of different length"
    return rows + [
        below(
            f"{name}: masses and terms against the truth",
            parameter_error(roving, hits[0]),
            EXACT,
        ),
        below(
            f"{name}: masses of one record with all forces",
            chains.worst(roving.masses_, together.masses_),
            EXACT,
        ),
        below(f"{name}: storey forces of one record with all forces", gap.max(), EXACT),
    ]


# -- 7: measured records -------------------------------------------------------


def identify(*arguments: str) -> dict:
    """The command line's own answer."""
    from pysindy_nrf.cli.group import run

    out, errors = io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            code = run(["identify", *arguments, "--no-figures", "--json"])
    if code:
        raise RuntimeError(
            f"identify {' '.join(arguments)} returned {code}: {errors.getvalue()}"
        )
    return json.loads(out.getvalue())


def emps(root: Path) -> list[Row]:
    path = root / "emps" / "DATA_EMPS.mat"
    found = identify(
        str(path),
        *"--map x1=qm --map F1=vir*35.1507 --map t=t --band 0,20 --degree 1".split(),
    )
    mass, share = found["masses_kg"][0], found["balance_error_percent"]["dof 1"]
    return [
        row(
            "emps, no friction in the model: 93 to 97 kg (published: 95.1)",
            f"{mass:.2f} kg",
            93 <= mass <= 97,
        ),
        row(
            "emps: unexplained share of the force, about 17 %",
            f"{share:.1f} %",
            16 <= share <= 18,
        ),
    ]


def three_storey_frf(root: Path) -> list[Row]:
    path = root / "three_storey_frf" / "cristallo_Experimental.csv"
    m = np.array(
        identify(str(path), "--frf", "--excited", "1", "--band", "4,32")["masses_kg"]
    )
    spread = 100 * (m.max() / m.min() - 1)
    said = f"{', '.join(f'{x:.2f}' for x in m)} kg: {spread:.1f} %"
    return [
        row(
            "three_storey_frf, force on floor 1 only: three masses within 10 %",
            said,
            spread < 10,
        )
    ]


def real_input(quick: bool) -> list[Row]:
    rows = []
    for load, table in (
        (measured_sets.load_emps, emps),
        (measured_sets.load_three_storey_frf, three_storey_frf),
    ):
        try:
            load()
        except NRFError as error:
            rows.append((judge.__name__, str(error), "skipped"))
        else:
            rows += table(Path(os.environ["PYSINDY_NRF_DATA"]))
    return rows


# -- 8: plain SINDy ------------------------------------------------------------


def beside_sindy(quick: bool) -> list[Row]:
    case = chains.duffing(2, [1, 2], seed=1, n_samples=3000)
    truth = test_comparison.true_model(case)
    table = compare_with_sindy(
        case.X, case.F, case.dt, truth=truth, free_run=15 if quick else 300
    )
    rows = [
        (
            f"{name}: terms, restoring-force error, time",
            f"{r.terms:.0f}, {r.restoring_force_error:.2g} %, {said}",
            "-",
        )
        for name, r in table.iterrows()
        for said in (f"{1e3 * r.seconds:.0f} ms",)
    ]
    exact, sparse = (
        table.loc["pysindy_nrf, least squares"],
        table.loc["pysindy_nrf, STLSQ, threshold 0.01"],
    )
    plain, ours = (
        table.loc[name, "restoring_force_error"]
        for name in ("SINDy, defaults", "pysindy_nrf, STLSQ")
    )
    return rows + [
        below(
            "ours, least squares: restoring-force error",
            exact.restoring_force_error,
            1e-6,
            " %",
        ),
        row(
            "ours, STLSQ at 0.01: the 8 true terms and no other",
            f"{sparse.terms:.0f} terms, precision {sparse.precision:g}, recall"
            f" {sparse.recall:g}",
            (sparse.terms, sparse.precision, sparse.recall) == (8, 1, 1),
        ),
        row(
            "plain SINDy, default STLSQ: error above ours with default STLSQ",
            f"{plain:.3g} % against {ours:.3g} %",
            plain > ours,
        ),
    ]


# -- 9: bad input --------------------------------------------------------------


def bad_input(quick: bool) -> list[Row]:
    rooms = {
        kind.name: kind for kind in every_kind() if kind.room in ("estimator", "record")
    }
    kinds = {
        k: v for k, v in rooms.items() if not quick or k in REPRESENTATIVE.values()
    }
    found = {name: judge(kind) for name, kind in kinds.items()}
    good = sum(outcome.kept for outcome in found.values())
    claim = (
        f"{len(kinds)} kinds: each an error or a warning that names the channel and the"
        " cure"
    )
    return [
        row(claim, f"{good} of {len(kinds)}", good == len(kinds)),
        *(
            row(claim, found[name].message, found[name].kept)
            for claim, name in REPRESENTATIVE.items()
            if name in found
        ),
    ]


TOPICS: dict[str, tuple[str, Callable[[bool], list[Row]]]] = {
    "chains": ("1 Noise-free chains, degree 3, random SI parameters", noise_free),
    "entrances": ("2 Regressor, optimizer inside ps.SINDy, direct solve", entrances),
    "simulation": ("3 Simulation", simulation),
    "dahl": ("4 The paper's 2-DOF chain with a Dahl damper in storey 1", dahl),
    "fusion": ("5 Fusion of noisy channels", fusion),
    "scale": ("6 Base excitation, roving hammer", scaled_otherwise),
    "measured": ("7 Measured records, by the command `identify`", real_input),
    "sindy": ("8 Plain SINDy on the same 2-DOF data", beside_sindy),
    "input": ("9 Bad input", bad_input),
}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="fewer seeds, samples and forced floors"
    )
    parser.add_argument("--only", choices=TOPICS, help="one topic")
    options = parser.parse_args(arguments)
    failed = 0
    for name in [options.only] if options.only else TOPICS:
        title, measure = TOPICS[name]
        began = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rows = measure(options.quick)
        show(title, rows)
        print(f"\n{time.perf_counter() - began:.1f} s\n")
        failed += sum(verdict == "FAIL" for *_, verdict in rows)
    print(f"{failed} rows FAIL" if failed else "no row fails")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
