"""What the foundation claims, measured: one table for each topic, PASS or FAIL.

    python benchmarks/foundation.py [--quick] [--only TOPIC]

``--quick`` takes fewer seeds, samples and forced floors (under 20 s). Some cases are
those of ``tests``: install ``pysindy-nrf[test]``. Measured data: the folder that
PYSINDY_NRF_DATA names, or ``../shared/data``; skipped, with the reason, if absent. Exit
code 1 if a row fails.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import search_path
import chains
import measured_sets
import numpy as np
import pandas as pd
import pysindy as ps
import smooth_motions
from bad_inputs_battery import every_kind, judge
from harness import FAIL, Claim, judged, markdown, options_of, quietly
from independent import (
    DT,
    extended_least_squares,
    force_on_top,
    independent_masses,
    motion_by_scipy,
    two_storeys,
)

from pysindy_nrf import (
    Chain,
    ChainModel,
    ChainOptimizer,
    InterstoryPolynomialLibrary,
    KinematicSmoother,
    NRFRegressor,
    Record,
    StateSpaceChainOptimizer,
    compare_with_sindy,
    laws,
)
from pysindy_nrf.chain.identifiability import plan_solve_order
from pysindy_nrf.chain.layout import Layout, blocks_of
from pysindy_nrf.equations.chain_solve import solve_blocks
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.simulation import free_run

EXACT = 1e-8
# a claim of the page, and the kind of bad input that stands for it
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


def below(claim: str, value: float, limit: float, unit: str = "") -> Claim:
    """A number that must stay below a limit."""
    asked = f"{claim}: below {limit:g}{unit}"
    return judged(asked, f"{value:.2g}{unit}", bool(value < limit))


def rms(y: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(y), axis=0))


# -- 1: noise-free chains ------------------------------------------------------


def true_terms(case: chains.Case) -> dict[str, np.ndarray]:
    """Coefficients of the terms that a chain has."""
    terms = {"v": case.c, "s": case.k}
    if case.k3.any():
        terms["s^3"] = case.k3
    return terms


def parameter_error(model: NRFRegressor, case: chains.Case) -> float:
    """Worst relative error of masses and true coefficients."""
    storeys = [model.restoring_forces_[i].coefficients for i in range(1, case.n + 1)]
    errors = [chains.worst(model.masses_, case.m)]
    for term, truth in true_terms(case).items():
        errors.append(chains.worst([storey[term] for storey in storeys], truth))
    return max(errors)


def absent_terms(model: NRFRegressor, case: chains.Case) -> float:
    """Largest term that the chain does not have, as a share of the storey's force."""
    return chains.absent_share(model, case, tuple(true_terms(case)))


def exact_rows(name: str, cases: list[chains.Case], **options) -> list[Claim]:
    """Claims on a group of chains."""
    models = [NRFRegressor(degree=3, **options).fit(case.X, case.F) for case in cases]
    strategies = sorted({model.solve_order_.strategy for model in models})
    name = f"{name} (chains: {len(cases)}; {' or '.join(strategies)})"
    parameters = max(map(parameter_error, models, cases))
    absent = max(map(absent_terms, models, cases))
    return [
        below(f"{name}, masses and true coefficients", parameters, EXACT),
        below(f"{name}, absent terms, share of the storey's force", absent, EXACT),
    ]


def noise_free(quick: bool) -> list[Claim]:
    rows = []
    for kind in ("linear", "Duffing"):
        rows += small_chains(kind, quick)
        rows += tall_chains(kind, 10 if quick else 50, quick)
    return [*rows, plain_least_squares(quick)]


def small_chains(kind: str, quick: bool) -> list[Claim]:
    """Chains of up to ten DOFs, one of them forced or all."""
    cubic = kind == "Duffing"
    single, every = [], []
    sizes = (1, 2, 4) if quick else range(1, 11)
    for n in sizes:
        for draw in range(1 if quick else 3):
            seed = n + 100 * draw
            single += chains.each_single(n, seed, 800, cubic=cubic)
            every.append(chains.duffing(n, range(1, n + 1), seed, 800, cubic=cubic))
    name = f"{kind}, n = {sizes[0]}..{sizes[-1]}"
    return [
        *exact_rows(f"{name}, any one DOF forced", single),
        *exact_rows(f"{name}, all forced", every),
        *exact_rows(f"{name}, all forced", every, strategy="sequential"),
    ]


def tall_chains(kind: str, n: int, quick: bool) -> list[Claim]:
    """Chains of many DOFs, one of them forced or all."""
    dofs = (1, n) if quick else range(1, n + 1)
    draw = partial(chains.duffing, seed=3, n_samples=50 * n, cubic=kind == "Duffing")
    where = f"DOF {f'1 or {n}' if quick else 'any'} forced"
    single = [draw(n, [dof]) for dof in dofs]
    return [
        *exact_rows(f"{kind}, n = {n}, {where}", single),
        *exact_rows(f"{kind}, n = {n}, all forced", [draw(n, range(1, n + 1))]),
    ]


def plain_least_squares(quick: bool) -> Claim:
    """Duffing chains of up to four DOFs, solved without the package."""
    errors = []
    for n in (1, 2, 4) if quick else (1, 2, 3, 4):
        for draw in range(1 if quick else 3):
            for case in chains.each_single(n, n + 100 * draw, 800, cubic=True):
                masses = independent_masses(case.X, case.F)
                errors.append(chains.worst(masses, case.m))
    name = "for comparison: plain sequential least squares in NumPy, masses, n = 1..4"
    return below(name, max(errors), EXACT)


# -- 2: three entrances --------------------------------------------------------


def entrances(quick: bool) -> list[Claim]:
    rows = []
    for forced in ([3], [1, 2, 3, 4]):
        for name, inner in (
            ("least squares", None),
            ("STLSQ", ps.STLSQ(threshold=0.01)),
        ):
            claim = f"{name}, DOF {forced} forced, 2 % noise: masses and terms agree"
            rows.append(below(claim, gap_of_entrances(forced, inner), 1e-10))
    return rows


def gap_of_entrances(forced: list[int], inner: ps.STLSQ | None) -> float:
    """Largest difference of the optimizer and of the direct solve from the regressor.

    That of a coefficient counts as a share of its storey's terms.
    """
    case = chains.duffing(4, forced, seed=1)
    X = smooth_motions.with_noise(case.X, 0.02, np.random.default_rng(0))
    regressor = NRFRegressor(degree=3, optimizer=inner).fit(X, case.F)
    library = InterstoryPolynomialLibrary(3)
    optimizer = ChainOptimizer(inner, terms=library)
    sindy = ps.SINDy(optimizer=optimizer, feature_library=library)
    optimizer = sindy.fit(X, t=case.dt, x_dot=case.F).optimizer
    terms = np.asarray(library.transform(X))[:, 4:]
    masses, coefficients = solved_directly(terms, X[:, :4], case.F, forced, inner)

    gaps = [
        chains.worst(values, regressor.masses_)
        for values in (optimizer.masses_, masses)
    ]
    for i in range(1, 5):
        columns = slice(9 * (i - 1), 9 * i)
        size = rms(terms[:, columns])
        fitted = regressor.restoring_forces_[i].coefficients.to_numpy()
        for other in (optimizer.coef_[i - 1, 4:][columns], coefficients[i]):
            gap = np.abs((other - fitted) * size).max()
            gaps.append(gap / np.linalg.norm(fitted * size))
    return max(gaps)


def solved_directly(terms, a, F, forced, inner):
    """Masses and coefficients by storey from the solver of the balances itself."""
    chain = Chain(4)
    order = plan_solve_order(chain, forced, alone=inner is not None)
    layout = Layout(chain, dict.fromkeys(chain.sites, 9))
    rows_of = partial(blocks_of, terms, a, F)
    solution, _ = solve_blocks(layout, order, rows_of, inner=inner)
    storeys = range(1, 5)
    masses = [solution.masses[j] for j in storeys]
    return masses, {i: solution.coefficients[chain.site(i)] for i in storeys}


# -- 3: simulation -------------------------------------------------------------


def simulation(quick: bool) -> list[Claim]:
    levels = (("linear", 200.0), ("duffing", 800.0), ("dahl", 50.0), ("dahl", 800.0))
    rows = []
    for kind, level in levels:
        model = two_storeys(kind)
        F = force_on_top(level, 150 if quick else 1000)
        truth = motion_by_scipy(kind, F)
        run = free_run(model, F, DT).record
        motion = np.hstack([run.displacement, run.velocity])
        error = np.abs(motion - truth).max(axis=0) / np.abs(truth).max(axis=0)
        energy = free_run(model, force_on_top(level, 2000), DT).energy_gap

        name = f"{kind}, {level:g} N rms"
        claim = f"{name}: x and v against SciPy's DOP853, relative"
        rows.append(below(claim, error.max(), 1e-5))
        rows.append(below(f"{name}: energy balance", energy, 1e-6))
    return rows + beside_sindy_simulate(15 if quick else 300)


def beside_sindy_simulate(n: int) -> list[Claim]:
    """10 s at 1 kHz through both; PySINDy on the first n samples."""
    case = chains.duffing(4, [3], seed=1, n_samples=10000)
    a, v, x = np.hsplit(case.absolute, 3)
    state = np.hstack([x, v])
    library = InterstoryPolynomialLibrary(3, inputs="state")
    optimizer = StateSpaceChainOptimizer(terms=library)
    sindy = ps.SINDy(optimizer=optimizer, feature_library=library)
    sindy.fit(state, t=case.dt, x_dot=np.hstack([v, a]), u=case.F)
    ours = NRFRegressor(degree=3, dt=case.dt).fit(case.X, case.F)
    # PySINDy joins the forces by a cubic
    start = {"x0": x[0], "v0": v[0], "hold": "cubic"}
    ours.simulate(case.F[:20], **start)  # compiles

    began = time.perf_counter()
    run = ours.simulate(case.F, **start).displacement
    seconds = time.perf_counter() - began
    began = time.perf_counter()
    slow = sindy.simulate(state[0], np.arange(n) * case.dt, u=case.F[:n])
    per_row = (time.perf_counter() - began) / n

    x_slow = slow[:, :4]
    gap = np.abs(x_slow - run[: len(slow)]).max() / np.abs(x_slow).max()
    total = per_row * len(case.F)
    ratio = total / seconds
    claim = (
        "4 DOFs, 10 s at 1 kHz, same model, one run: at least 500 times faster than"
        " SINDy.simulate"
    )
    measured = (
        f"{ratio:.0f} times: {seconds:.3f} s against {total:.0f} s (extrapolated per"
        f" row from {n} samples, {1e3 * per_row:.1f} ms each)"
    )
    return [
        judged(claim, measured, ratio >= 500),
        below("the two runs agree over these samples, relative", gap, 1e-3),
    ]


# -- 4: the paper's damper -----------------------------------------------------


def cubic_columns(case: chains.Case, i: int) -> np.ndarray:
    """Columns v^h s^j of a cubic of storey i."""
    v = case.v[:, i - 1]
    s = case.s[:, i - 1]
    columns = []
    for degree in (1, 2, 3):
        for h in range(degree, -1, -1):
            columns.append(v**h * s ** (degree - h))
    return np.column_stack(columns)


def dahl(quick: bool) -> list[Claim]:
    case, *_ = chains.paper_case(duration=2.0 if quick else 4.0)
    # the paper solves each balance alone
    cubic = NRFRegressor(degree=3, strategy="complete").fit(case.X, case.F)
    R2 = case.storey_forces[:, 1]
    gap_2 = np.abs(cubic.restoring_force(case.X)[:, 1] - R2).max() / rms(R2)

    columns = [case.a[:, 0], cubic_columns(case, 1), -cubic_columns(case, 2)]
    A = np.column_stack(columns)
    exact = extended_least_squares(A, case.F[:, 0])[:10]
    fitted = np.array([cubic.masses_[0], *cubic.restoring_forces_[1].coefficients])
    gap_1 = np.abs((fitted - exact) * rms(A[:, :10])).max() / rms(case.F[:, 0])
    equal = gap_1 < 1e-9 and abs(fitted[0] / exact[0] - 1) < 1e-9

    law = [laws.PowerSeries(1), laws.Dahl(sigma=chains.DAMPER["sigma"])]
    declared = NRFRegressor(degree=1, laws={"storey 1": law}, dt=case.dt)
    masses = declared.fit(case.X, case.F).masses_
    claim = (
        "cubic: numbers of storey 1 equal least squares in 80-bit arithmetic, share"
        " of the force: below 1e-9"
    )
    measured = (
        f"m1 = {fitted[0]:.6f} kg (truth 10; extended {exact[0]:.6f}), gap {gap_1:.1e}"
    )
    return [
        below("cubic: storey 2, largest error, share of its rms force", gap_2, 1e-6),
        judged(claim, measured, bool(equal)),
        below("true law in storey 1: masses", chains.worst(masses, case.m), 1e-6),
    ]


# -- 5: fusion -----------------------------------------------------------------


def fused(kind: str, seed: int) -> tuple[float, float, float]:
    """Worst mass error fused and filtered only, percent; worst ratio of edge to middle.

    The ratio is that of the errors of the fused motion.
    """
    clean = smooth_motions.chain_test(kind, seed)
    rng = np.random.default_rng(100 + seed)
    channels = (clean.force, clean.a, clean.v, clean.x)
    noisy = [smooth_motions.with_noise(channel, 0.05, rng) for channel in channels]
    noisy[0][:, [0, 1, 3]] = 0.0
    record = Record(*noisy, fs=smooth_motions.FS)
    X, force = record.to_features(smooth=KinematicSmoother())
    raw, _ = record.to_features(smooth=False)

    truth = np.full(4, smooth_motions.MASS)
    masses = NRFRegressor(degree=1).fit(X, force).masses_
    filtered = NRFRegressor(degree=1, band=(0.5, 60.0), dt=record.dt)
    filtered_masses = filtered.fit(raw, force).masses_

    motion = X.to_numpy(copy=True).reshape(len(X), 3, 4)
    motion[:, 1:] = motion[:, 1:].cumsum(axis=2)
    gap = motion - np.stack([clean.a, clean.v, clean.x], axis=1)
    edge = len(X) // 20
    middle = rms(gap[edge:-edge])
    ratio = max((rms(ends) / middle).max() for ends in (gap[:edge], gap[-edge:]))
    return (
        100 * chains.worst(masses, truth),
        100 * chains.worst(filtered_masses, truth),
        float(ratio),
    )


def fusion(quick: bool) -> list[Claim]:
    rows = []
    seeds = range(1 if quick else 10)
    for kind in ("random", "hammer"):
        errors = np.array([fused(kind, seed) for seed in seeds])
        error, filtered, ratio = errors.T
        name = f"{kind}, 5 % noise on all channels, DOF 3 forced, {len(seeds)} seeds"
        claim = (
            f"{name}: worst mass error, least squares on fused channels: at most 2 %"
        )
        measured = (
            f"{error.max():.2f} % (filtered to 0.5-60 Hz only: {filtered.min():.1f} to"
            f" {filtered.max():.1f} %)"
        )
        rows.append(judged(claim, measured, bool(error.max() <= 2)))
        claim = f"{name}: error at the edges at most twice the middle's"
        rows.append(judged(claim, f"{ratio.max():.2f} times", bool(ratio.max() <= 2)))
    return rows


# -- 6: base excitation, roving hammer -----------------------------------------


def scaled_otherwise(quick: bool) -> list[Claim]:
    return [*shaken_base(), *roving_hammer()]


def shaken_base() -> list[Claim]:
    """One known mass scales a chain that is shaken at its base."""
    ag = chains.band_limited(4000, DT, np.random.default_rng(5), rms=2.0)
    case = chains.duffing(4, [], seed=7, n_samples=4000, ag=ag)
    rows = []
    for j in range(1, 5):
        model = NRFRegressor(degree=3, known_masses={j: case.m[j - 1]})
        model.fit(case.X, base_acceleration=ag)
        error = max(parameter_error(model, case), absent_terms(model, case))
        claim = f"base excitation, 4 DOFs, only m{j} known: masses and terms"
        rows.append(below(claim, error, EXACT))
    return rows


def roving_hammer() -> list[Claim]:
    """Three records, each with another DOF forced, beside one with all."""
    draw = partial(
        chains.duffing,
        3,
        parameters_of_chain=chains.parameters(3, np.random.default_rng(9)),
    )
    hits = [draw([j], seed=20 + j, n_samples=1200 + 300 * j) for j in (1, 2, 3)]
    X = np.vstack([hit.X for hit in hits])
    F = np.vstack([hit.F for hit in hits])
    number = np.repeat([1, 2, 3], [len(hit.X) for hit in hits])
    roving = NRFRegressor(degree=3).fit(X, F, record=number)
    case = draw([1, 2, 3], seed=30)
    together = NRFRegressor(degree=3).fit(case.X, case.F)

    motion = case.X[::10]
    gap = np.abs(roving.restoring_force(motion) - together.restoring_force(motion))
    force = (gap.max(axis=0) / rms(case.storey_forces)).max()
    parameters = parameter_error(roving, hits[0])
    masses = chains.worst(roving.masses_, together.masses_)
    name = "roving hammer, three records of different length"
    return [
        below(f"{name}: masses and terms against the truth", parameters, EXACT),
        below(f"{name}: masses of one record with all forces", masses, EXACT),
        below(f"{name}: storey forces of one record with all forces", force, EXACT),
    ]


# -- 7: measured records -------------------------------------------------------


def identify(path: Path, *options: str) -> dict:
    """What the command prints as JSON."""
    command = [sys.executable, "-m", "pysindy_nrf", "identify", str(path), *options]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [*command, "--no-figures", "--json"],
            capture_output=True,
            text=True,
            cwd=folder,
        )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")
    return json.loads(done.stdout)


def emps() -> list[Claim]:
    channels = ("--map", "x1=qm", "--map", "F1=vir*35.1507", "--map", "t=t")
    path = measured_sets.data_file("emps")
    identified = identify(path, *channels, "--band", "0,20", "--degree", "1")
    mass = identified["masses_kg"][0]
    share = identified["balance_error_percent"]["dof 1"]
    asked_mass = "emps, no friction in the model: 93 to 97 kg (published: 95.1)"
    asked_share = "emps: unexplained share of the force, about 17 %"
    return [
        judged(asked_mass, f"{mass:.2f} kg", 93 <= mass <= 97),
        judged(asked_share, f"{share:.1f} %", 16 <= share <= 18),
    ]


def three_storey_frf() -> list[Claim]:
    path = measured_sets.data_file("three_storey_frf")
    identified = identify(path, "--frf", "--excited", "1", "--band", "4,32")
    masses = np.array(identified["masses_kg"])
    spread = 100 * (masses.max() / masses.min() - 1)
    claim = "three_storey_frf, force on floor 1 only: three masses within 10 %"
    measured = f"{', '.join(f'{m:.2f}' for m in masses)} kg: {spread:.1f} %"
    return [judged(claim, measured, bool(spread < 10))]


def measured_records(quick: bool) -> list[Claim]:
    rows = []
    for table in (emps, three_storey_frf):
        try:
            rows += table()
        except NRFError as error:
            rows.append(Claim(table.__name__, str(error), "skipped"))
    return rows


# -- 8: plain SINDy ------------------------------------------------------------


def true_model(case: chains.Case) -> ChainModel:
    storeys = {}
    for i, (c, k, k3) in enumerate(zip(case.c, case.k, case.k3), 1):
        storeys[i] = [laws.LinearViscous(c), laws.Duffing(k, k3)]
    return ChainModel(case.m, storeys)


def beside_sindy(quick: bool) -> list[Claim]:
    case = chains.duffing(2, [1, 2], seed=1, n_samples=3000)
    truth = true_model(case)
    seconds = 15 if quick else 300
    table = compare_with_sindy(case.X, case.F, case.dt, truth=truth, free_run=seconds)
    rows = []
    for name, row in table.iterrows():
        measured = (
            f"{row.terms:.0f}, {row.restoring_force_error:.2g} %,"
            f" {1e3 * row.seconds:.0f} ms"
        )
        claim = f"{name}: terms, restoring-force error, time"
        rows.append(Claim(claim, measured, "-"))

    errors = table["restoring_force_error"]
    exact = errors["pysindy_nrf, least squares"]
    rows.append(below("ours, least squares: restoring-force error", exact, 1e-6, " %"))
    sparse = table.loc["pysindy_nrf, STLSQ, threshold 0.01"]
    measured = (
        f"{sparse.terms:.0f} terms, precision {sparse.precision:g}, recall"
        f" {sparse.recall:g}"
    )
    right = (sparse.terms, sparse.precision, sparse.recall) == (8, 1, 1)
    claim = "ours, STLSQ at 0.01: the 8 true terms and no other"
    rows.append(judged(claim, measured, right))
    plain = errors["SINDy, defaults"]
    ours = errors["pysindy_nrf, STLSQ"]
    claim = "plain SINDy, default STLSQ: error above ours with default STLSQ"
    measured = f"{plain:.3g} % against {ours:.3g} %"
    rows.append(judged(claim, measured, bool(plain > ours)))
    return rows


# -- 9: bad input --------------------------------------------------------------


def bad_input(quick: bool) -> list[Claim]:
    outcomes = {}
    for kind in every_kind():
        wanted = not quick or kind.name in REPRESENTATIVE.values()
        if wanted and kind.room in ("estimator", "record"):
            outcomes[kind.name] = judge(kind)
    n = len(outcomes)
    good = sum(outcome.is_good for outcome in outcomes.values())
    claim = f"{n} kinds: each an error or a warning that names the channel and the cure"
    rows = [judged(claim, f"{good} of {n}", good == n)]
    for asked, name in REPRESENTATIVE.items():
        if name in outcomes:
            outcome = outcomes[name]
            rows.append(judged(asked, outcome.message, outcome.is_good))
    return rows


# -- all topics ----------------------------------------------------------------

TOPICS: dict[str, tuple[str, Callable[[bool], list[Claim]]]] = {
    "chains": ("1 Noise-free chains, degree 3, random SI parameters", noise_free),
    "entrances": ("2 Regressor, optimizer inside ps.SINDy, direct solve", entrances),
    "simulation": ("3 Simulation", simulation),
    "dahl": ("4 The paper's 2-DOF chain with a Dahl damper in storey 1", dahl),
    "fusion": ("5 Fusion of noisy channels", fusion),
    "scale": ("6 Base excitation, roving hammer", scaled_otherwise),
    "measured": ("7 Measured records, by the command `identify`", measured_records),
    "sindy": ("8 Plain SINDy on the same 2-DOF data", beside_sindy),
    "input": ("9 Bad input", bad_input),
}


def in_table(claims: list[Claim]) -> str:
    rows = [(claim.asked, claim.measured, claim.verdict) for claim in claims]
    table = pd.DataFrame(rows, columns=["claim", "measured", ""])
    return markdown(table.replace(r"\|", r"\\|", regex=True))


def main(arguments: list[str] | None = None) -> int:
    """Print all tables; the exit code says whether a row fails."""
    parser = options_of(__doc__, quick="fewer seeds, samples and forced floors")
    parser.add_argument("--only", choices=TOPICS, help="one topic")
    options = parser.parse_args(arguments)
    failed = 0
    for name in [options.only] if options.only else TOPICS:
        title, measure = TOPICS[name]
        began = time.perf_counter()
        claims = quietly(measure, options.quick)
        print(f"## {title}\n\n{in_table(claims)}", flush=True)
        print(f"\n{time.perf_counter() - began:.1f} s\n")
        failed += sum(claim.verdict == FAIL for claim in claims)
    print(f"{failed} rows FAIL" if failed else "no row fails")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
