"""Cost of an identification beside others' and beside the machine: one table.

    python benchmarks/speed.py --quick
    python benchmarks/speed.py                       # a quarter of an hour
    python benchmarks/speed.py --only passes limits  # some parts
    python benchmarks/speed.py --out table.csv

Parts: limits, passes, scaling, laws, starts, file, dask. Every contender gets the same
data in the same run and runs on one thread, alternating with the others. Times are
processor time of that thread, the least of all rounds, so that other people's load on
the machine falls on none of them (several cores, process starts, files and Dask: wall
time). Data: chains of Duffing storeys in random motion, 1 % noise in the forces (and
rows without noise). ``lstsq``, scikit-learn and SINDy are given the raw channels, as
this package is; their time holds the columns they need. Memory: peak of what Python and
NumPy allocate on top of the data (tracemalloc, in a run of its own).
"""

from __future__ import annotations

import cProfile
import importlib.util
import math
import os
import pstats
import subprocess
import sys
import tempfile
import time
import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import search_path
import numba
import numpy as np
import pandas as pd
from harness import judged, options_of, times_in_turns
from threadpoolctl import threadpool_limits

from pysindy_nrf import NRFRegressor, laws
from pysindy_nrf.laws.memory import state_path

DEGREE = 3
PARTS = ("limits", "passes", "scaling", "laws", "starts", "file", "dask")
COMPLETE = "complete"
SEQUENTIAL = "sequential"
# largest problem each contender is asked to solve; beyond it takes memory or hours
MAX_NUMBERS = 1.2e8  # of a design matrix
MAX_WORK = 1.5e11  # numbers times columns
MAX_FOR_PER_BALANCE = 1.1e7  # samples times DOFs
MAX_FOR_FROLS = 20_000  # samples
BLOCK = 2**16  # samples drawn at a time


# -- data ----------------------------------------------------------------------


@dataclass(frozen=True)
class Data:
    """Channels of one chain, and the truth behind them."""

    n: int
    X: np.ndarray
    F: np.ndarray
    masses: np.ndarray
    excitation: str
    noise: float

    @property
    def size(self) -> int:
        return len(self.X)

    @property
    def name(self) -> str:
        noise = f"{100 * self.noise:g} %" if self.noise else "no"
        return f"{self.excitation}, {noise} noise"


def chain_data(
    n: int, size: int, noise: float = 0.01, excitation: str = COMPLETE
) -> Data:
    """Duffing storeys in random motion; every DOF forced, or the top one alone."""
    rng = np.random.default_rng(n)
    m = rng.uniform(5, 20, n)
    c = rng.uniform(50, 150, n)
    k = rng.uniform(5e4, 2e5, n)
    k3 = k * 1e5 * rng.uniform(0.5, 1.0, n)
    X = np.empty((size, 3 * n))
    F = np.empty((size, n))
    for first in range(0, size, BLOCK):
        rows = slice(first, min(first + BLOCK, size))
        shape = (rows.stop - rows.start, n)
        v = 0.1 * rng.standard_normal(shape)
        s = 1e-3 * rng.standard_normal(shape)
        R = c * v + k * s + k3 * s**3
        net = R.copy()
        net[:, :-1] -= R[:, 1:]
        if excitation == COMPLETE:
            a = 10.0 * rng.standard_normal(shape)
            force = m * a + net
            acting = force
        else:
            force = np.zeros(shape)
            force[:, -1] = 200.0 * rng.standard_normal(len(force))
            a = (force - net) / m
            acting = force[:, -1:]
        if noise:
            acting += noise * acting.std() * rng.standard_normal(acting.shape)
        X[rows] = np.hstack([a, v, s])
        F[rows] = force
    return Data(n, X, F, m, excitation, noise)


def powers(v: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Columns v^h s^j of one storey, total degree up to three."""
    columns = []
    for degree in range(1, DEGREE + 1):
        for h in range(degree, -1, -1):
            columns.append(v**h * s ** (degree - h))
    return np.column_stack(columns)


def balance_columns(data: Data, j: int) -> np.ndarray:
    """Columns of balance j: a_j, storey j, and storey j+1 where it is not known yet."""
    n = data.n
    columns = [data.X[:, [j]], powers(data.X[:, n + j], data.X[:, 2 * n + j])]
    if j + 1 < n and data.excitation == COMPLETE:
        v, s = data.X[:, n + j + 1], data.X[:, 2 * n + j + 1]
        columns.append(-powers(v, s))
    return np.hstack(columns)


# -- contenders: from raw channels to masses -----------------------------------

Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]


def this_package(data: Data) -> np.ndarray:
    """By the strategy of the others."""
    regressor = NRFRegressor(degree=DEGREE, strategy=data.excitation)
    return regressor.fit(data.X, data.F).masses_


def per_balance(data: Data, solve: Solver) -> np.ndarray:
    """One balance after the other, from the top."""
    masses = np.empty(data.n)
    above: np.ndarray | float = 0.0
    for j in range(data.n - 1, -1, -1):
        A = balance_columns(data, j)
        solution = solve(A, data.F[:, j] + above)
        masses[j] = solution[0]
        if data.excitation == SEQUENTIAL:
            above = A[:, 1:] @ solution[1:]
    return masses


def lstsq(data: Data) -> np.ndarray:
    def solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(A, b, rcond=None)[0]

    return per_balance(data, solve)


def sklearn_linear(data: Data) -> np.ndarray:
    from sklearn.linear_model import LinearRegression

    def solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
        return LinearRegression(fit_intercept=False, tol=1e-12).fit(A, b).coef_

    return per_balance(data, solve)


def scaled_qr(data: Data) -> np.ndarray:
    """The reference for accuracy: Householder's QR of columns of unit length."""
    from scipy import linalg

    def solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
        size = np.linalg.norm(A, axis=0)
        q, r = linalg.qr(A / size, mode="economic")
        return linalg.solve_triangular(r, q.T @ b) / size

    return per_balance(data, solve)


def sindy(data: Data) -> np.ndarray:
    """SINDy on the same terms: storey polynomials and forces, all for every target."""
    import pysindy as ps

    n = data.n
    storeys = [ps.PolynomialLibrary(degree=DEGREE, include_bias=False)] * n
    inputs = [[j, n + j] for j in range(n)]
    inputs.append(list(range(2 * n, 3 * n)))
    library = ps.GeneralizedLibrary(
        [*storeys, ps.IdentityLibrary()], inputs_per_library=inputs
    )
    optimizer = ps.STLSQ(threshold=0.0, alpha=0.0, unbias=False)
    model = ps.SINDy(feature_library=library, optimizer=optimizer)
    model.fit(data.X[:, n:], t=1.0, x_dot=data.X[:, :n], u=data.F)
    return 1.0 / np.diag(model.coefficients()[:, -n:])


def plain_sindy(data: Data) -> np.ndarray:
    """SINDy as it comes: a cubic in all states and forces."""
    import pysindy as ps

    n = data.n
    library = ps.PolynomialLibrary(degree=DEGREE)
    model = ps.SINDy(feature_library=library, optimizer=ps.STLSQ())
    model.fit(data.X[:, n:], t=1.0, x_dot=data.X[:, :n], u=data.F)
    with np.errstate(divide="ignore"):
        return 1.0 / np.diag(model.coefficients()[:, 1 + 2 * n : 1 + 3 * n])


def frols(data: Data) -> np.ndarray:
    """SysIdentPy: forward regression of a storey's polynomial, balance by balance."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    n = data.n
    masses = np.full(n, np.nan)
    for j in range(n):
        last = min(j + 2, n)
        v = data.X[:, n + j : n + last]
        s = data.X[:, 2 * n + j : 2 * n + last]
        u = np.hstack([data.X[:, [j]], v, s])
        model = FROLS(
            order_selection=False,
            n_terms=20,
            ylag=1,
            xlag=[[1]] * u.shape[1],
            model_type="NFIR",
            basis_function=Polynomial(degree=DEGREE),
        )
        # its inputs are those of the sample before
        model.fit(X=u, y=np.roll(data.F[:, [j]], 1, axis=0))
        terms = model.final_model
        linear = (terms[:, 0] == 2001) & (terms[:, 1:] == 0).all(axis=1)
        if linear.any():
            masses[j] = model.theta[np.argmax(linear), 0]
    return masses


OURS = "pysindy_nrf"
PER_DOF = "lstsq per DOF"
SKLEARN = "LinearRegression"
SINDY = "SINDy, same terms"
PLAIN_SINDY = "SINDy, plain"
FROLS_NAME = "SysIdentPy FROLS"
PYCC = "pyCC-ID polynomial"
CONTENDERS: dict[str, Callable[[Data], np.ndarray]] = {
    OURS: this_package,
    PER_DOF: lstsq,
    SKLEARN: sklearn_linear,
    SINDY: sindy,
    PLAIN_SINDY: plain_sindy,
    FROLS_NAME: frols,
}
PACKAGES = {PYCC: "pycc", FROLS_NAME: "sysidentpy"}


def n_columns(name: str, n: int) -> float:
    """Width of the widest matrix that a contender makes."""
    inputs = 3 * n
    widths = {
        SINDY: 10 * n + n,
        PLAIN_SINDY: (inputs + 1) * (inputs + 2) * (inputs + 3) / 6,
        FROLS_NAME: 286 if n > 1 else 35,
    }
    return widths.get(name, 20)


def excuse(name: str, data: Data) -> str | None:
    """Why a contender does not run on these data."""
    return not_installed(name) or too_large(name, data)


def not_installed(name: str) -> str | None:
    package = PACKAGES.get(name)
    if package and importlib.util.find_spec(package) is None:
        needs = ", which brings torch and Julia," if name == PYCC else ""
        return f"not run: the package {package}{needs} is not installed here"
    if name == PYCC:
        return "does not apply: functions of one variable, no terms in v and s together"
    return None


def too_large(name: str, data: Data) -> str | None:
    if name == OURS:
        return None
    columns = n_columns(name, data.n)
    numbers = columns * data.size
    if numbers > MAX_NUMBERS or columns * numbers > MAX_WORK:
        return (
            f"not run: a matrix of {numbers * 8 / 1e9:.2g} GB with {columns:.0f}"
            " columns"
        )
    if name in (PER_DOF, SKLEARN) and data.n * data.size > MAX_FOR_PER_BALANCE:
        return "not run: minutes"
    if name == FROLS_NAME and data.size > MAX_FOR_FROLS:
        return "not run: orthogonalises every candidate at every step, minutes"
    return None


# -- measuring -----------------------------------------------------------------


def least_times(
    contenders: dict[str, Callable[[], Any]], rounds: int, patience: float, **options
) -> dict[str, float]:
    """Least time of each, in turns, s."""
    times = times_in_turns(contenders, rounds, patience, **options)
    return {name: min(of_one) for name, of_one in times.items()}


def least(function: Callable[[], Any], rounds: int, **options) -> float:
    """Least time of a function, s."""
    return least_times({"": function}, rounds, np.inf, **options)[""]


def runs_of(names: tuple[str, ...], data: Data) -> dict[str, Callable[[], Any]]:
    """Calls of the contenders that run on these data."""
    running = [name for name in names if excuse(name, data) is None]
    return {name: partial(CONTENDERS[name], data) for name in running}


def peak_memory(function: Callable[[], Any]) -> float:
    """MB on top of what was there."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


def work_of_pass(n: int) -> tuple[float, float]:
    """Operations, and bytes read, for each sample: what the balances of a chain need.

    Products of the columns of neighbouring storeys, each pair once; symmetric blocks on
    and below the diagonal.
    """
    p = DEGREE * (DEGREE + 3) // 2
    products = n * (p * (p + 1) / 2 + 3 + 2 * p) + (n - 1) * (p * p + 2 * p)
    columns = n * (p - 2)
    return 2 * products + columns, 8.0 * 4 * n


@dataclass(frozen=True)
class Limits:
    """What the machine can do, measured in this run."""

    gemm: float  # operations/s of a large matrix product
    read: float  # bytes/s summed up from main memory

    def seconds(self, n: int, size: int) -> float:
        """Least time of a pass: arithmetic or memory, whichever is slower."""
        operations, read = work_of_pass(n)
        return size * max(operations / self.gemm, read / self.read)


def measure_limits(rounds: int) -> Limits:
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 768, 768))
    big = np.ones(2**24)
    product = least(lambda: a @ b, rounds)
    total = least(big.sum, rounds)
    return Limits(2 * 768**3 / product, big.nbytes / total)


# -- tables --------------------------------------------------------------------


def show(title: str, table: pd.DataFrame) -> None:
    """Print a table with columns of equal width."""
    cells = table.astype(str)
    rows = [list(map(str, cells)), *cells.to_numpy().tolist()]
    widths = [max(map(len, column)) for column in zip(*rows)]
    rows.insert(1, ["-" * width for width in widths])
    print(f"\n## {title}\n")
    for row in rows:
        padded = [text.ljust(width) for text, width in zip(row, widths)]
        print(f"| {' | '.join(padded)} |")


class Verdicts:
    """Claims with what was measured; PASS or MISS."""

    def __init__(self) -> None:
        self.claims: list = []

    def add(self, claim: str, measured: str, holds: bool) -> None:
        self.claims.append(judged(claim, measured, bool(holds), otherwise="MISS"))

    def add_ratio(self, claim: str, ratio: float, limit: float) -> None:
        """A ratio that must not be larger; none where it was not measured."""
        if np.isfinite(ratio):
            self.add(claim, f"{ratio:.2f} times", ratio <= limit)

    def table(self) -> pd.DataFrame:
        rows = [(claim.asked, claim.measured, claim.verdict) for claim in self.claims]
        return pd.DataFrame(rows, columns=["claim", "measured", ""])

    @property
    def missed_a_time(self) -> bool:
        """Whether a claim on a time is missed."""
        missed = [claim.asked for claim in self.claims if claim.verdict == "MISS"]
        return any("times" in claim or "limit" in claim for claim in missed)


# -- one pass ------------------------------------------------------------------


@dataclass(frozen=True)
class Pass:
    """One contender on some data: least time (s), memory (MB), worst mass error."""

    n: int
    size: int
    name: str
    note: str = ""
    seconds: float = np.nan
    memory: float = np.nan
    error: float = np.nan


def passes(sizes: list[tuple[int, int]], rounds: int, patience: float) -> list[Pass]:
    """Every contender on the same data."""
    results = []
    for n, size in sizes:
        data = chain_data(n, size)
        # compiled code comes from the disk
        NRFRegressor(degree=DEGREE).fit(data.X[:2000], data.F[:2000])
        runs = runs_of(tuple(CONTENDERS), data)
        seconds = least_times(runs, rounds, patience)
        for name in [*CONTENDERS, PYCC]:
            why = excuse(name, data)
            if why is not None:
                results.append(Pass(n, size, name, why))
                continue
            error = float(np.abs(runs[name]() / data.masses - 1).max())
            memory = np.nan
            if size <= 10**6 or name == OURS:
                memory = peak_memory(runs[name])
            results.append(Pass(n, size, name, "", seconds[name], memory, error))
    return results


def pass_table(results: list[Pass], machine: Limits) -> pd.DataFrame:
    ours = {
        (result.n, result.size): result.seconds
        for result in results
        if result.name == OURS
    }
    rows = []
    for result in results:
        row = {"n": result.n, "samples": f"{result.size:.0e}".replace("e+0", "e")}
        row["by"] = result.name
        if not result.note:
            bound = machine.seconds(result.n, result.size)
            row |= {
                "s": f"{result.seconds:.3g}",
                "times ours": f"{result.seconds / ours[result.n, result.size]:.3g}",
                "times limit": f"{result.seconds / bound:.3g}",
                "extra MB": f"{result.memory:.3g}",
                "worst mass error": f"{result.error:.1e}",
            }
        rows.append(row | {"note": result.note})
    return pd.DataFrame(rows).fillna("")


def judge_passes(results: list[Pass], machine: Limits, verdicts: Verdicts) -> None:
    times = {(result.n, result.size, result.name): result.seconds for result in results}

    def seconds(n: int, size: int, name: str = OURS) -> float:
        return times.get((n, size, name), np.nan)

    ours = seconds(10, 10**6)
    for name, wanted in ((PER_DOF, 40), (SINDY, 60)):
        ratio = seconds(10, 10**6, name) / ours
        if np.isfinite(ratio):
            claim = (
                f"n = 10, 1e6 samples, complete: at least {wanted} times faster than"
                f" {name}"
            )
            verdicts.add(claim, f"{ratio:.1f} times", ratio >= wanted)
    ratio = ours / machine.seconds(10, 10**6)
    verdicts.add_ratio("n = 10, 1e6: within 4 times the measured limit", ratio, 4)
    ratio = seconds(10, 10**7) / ours
    verdicts.add_ratio("1e7 samples cost at most 12 times 1e6 (n = 10)", ratio, 12)
    ratio = seconds(100, 10**6) / ours
    samples = "1e6"
    if not np.isfinite(ratio):
        ratio = seconds(100, 10**5) / seconds(10, 10**5)
        samples = "1e5"
    claim = f"n = 100 costs at most 13 times n = 10 ({samples})"
    verdicts.add_ratio(claim, ratio, 13)

    small = [
        result.memory for result in results if result.name == OURS and result.n <= 10
    ]
    memory = np.nanmax(small) if small else np.nan
    claim = "extra memory at most 32 MB whatever the samples (n <= 10)"
    verdicts.add(claim, f"{memory:.1f} MB", memory <= 32)


def accuracy(verdicts: Verdicts, size: int) -> None:
    """Against Householder's QR, with and without noise, complete and sequential."""
    for excitation in (COMPLETE, SEQUENTIAL):
        for noise in (0.01, 0.0):
            data = chain_data(10, size, noise, excitation)
            gap = float(np.abs(this_package(data) / scaled_qr(data) - 1).max())
            claim = f"masses equal to a QR reference to 1e-9: {data.name}"
            verdicts.add(claim, f"{gap:.1e}", gap <= 1e-9)


def other_passes(verdicts: Verdicts, size: int, rounds: int) -> None:
    """The top DOF forced alone; and complete without noise, which needs two passes."""
    for excitation, noise in ((SEQUENTIAL, 0.01), (SEQUENTIAL, 0.0), (COMPLETE, 0.0)):
        data = chain_data(10, size, noise, excitation)
        best = least_times(runs_of((OURS, PER_DOF, SINDY), data), rounds, 20.0)
        for name, wanted in ((PER_DOF, 40), (SINDY, 60)):
            if name not in best:
                continue
            ratio = best[name] / best[OURS]
            claim = (
                f"n = 10, {size:.0e} samples, {data.name}: at least {wanted} times"
                f" faster than {name}"
            )
            if excitation == SEQUENTIAL and name == PER_DOF:
                claim += " (its columns: 10 a balance, not 19)"
            verdicts.add(claim, f"{ratio:.1f} times", ratio >= wanted)


def on_all_cores(size: int, rounds: int) -> pd.DataFrame:
    """Wall time of a fit on one thread and more, beside ``lstsq`` with as many."""
    rows = []
    for excitation in (COMPLETE, SEQUENTIAL):
        data = chain_data(10, size, excitation=excitation)
        runs = runs_of((OURS, PER_DOF), data)
        for threads in sorted({1, 2, os.cpu_count() or 1}):
            number = str(threads)
            asked = {"OMP_NUM_THREADS": number, "NUMBA_NUM_THREADS": number}
            with patch.dict(os.environ, asked), threadpool_limits(threads, "blas"):
                best = least_times(runs, rounds, 60.0, clock=time.perf_counter)
            row = {"excitation": excitation, "threads": threads}
            for name, seconds in best.items():
                row[name] = f"{seconds:.3f}"
            row["times"] = f"{best[PER_DOF] / best[OURS]:.1f}"
            rows.append(row)
    return pd.DataFrame(rows)


def profile_of_pass(size: int) -> pd.DataFrame:
    """Where the time of one fit goes."""
    data = chain_data(10, size)
    this_package(data)
    profile = cProfile.Profile()
    profile.runcall(this_package, data)
    stats = pstats.Stats(profile)
    rows = []
    for (file, _, name), (_, _, seconds, _, _) in stats.stats.items():
        rows.append({"in": f"{Path(file).name}:{name}", "seconds": seconds})
    table = pd.DataFrame(rows).nlargest(12, "seconds")
    shares = 100 * table["seconds"] / stats.total_tt
    return table.assign(
        s=table["seconds"].map("{:.4f}".format), share=shares.map("{:.0f} %".format)
    ).drop(columns="seconds")


# -- laws with memory ----------------------------------------------------------


@numba.njit(error_model="numpy")
def bare_dahl(s, sigma, z):
    state = 0.0
    for i in range(1, s.size):
        ds = s[i] - s[i - 1]
        if ds > 0.0:
            state = 1.0 + (state - 1.0) * math.exp(-sigma * ds)
        elif ds < 0.0:
            state = -1.0 + (state + 1.0) * math.exp(sigma * ds)
        z[i] = state


@numba.njit(error_model="numpy")
def bare_jenkins(s, uy, z):
    state = 0.0
    for i in range(1, s.size):
        state = min(max(state + (s[i] - s[i - 1]) / uy, -1.0), 1.0)
        z[i] = state


@numba.njit(error_model="numpy")
def wen_slope(ds, w, beta, rho, n):
    return 1.0 - (math.copysign(1.0, ds * w) + rho) * (beta * abs(w)) ** n


@numba.njit(error_model="numpy")
def bare_bouc_wen(s, beta, rho, n, z):
    """Wen's equation by one step of the midpoint rule."""
    w = 0.0
    for i in range(1, s.size):
        ds = s[i] - s[i - 1]
        half = w + 0.5 * ds * wen_slope(ds, w, beta, rho, n)
        w += ds * wen_slope(ds, half, beta, rho, n)
        z[i] = w


def three_sines(size: int) -> laws.Motion:
    """Drift, rate and acceleration of a storey at 1 kHz."""
    t = np.arange(size) / 1000.0
    s, v, a = np.zeros((3, size))
    for number, frequency in enumerate((1.3, 2.1, 3.7)):
        w = 2 * np.pi * frequency
        angle = w * t + number
        s += 1e-3 * np.sin(angle)
        v += 1e-3 * w * np.cos(angle)
        a -= 1e-3 * w * w * np.sin(angle)
    return laws.Motion(s, v, a, t)


def along(law: laws.ForceLaw, motion: laws.Motion) -> None:
    """In blocks that share a sample, as a fit of a long record takes them."""
    channels = (motion.s, motion.v, motion.a, motion.t)
    state = np.zeros(law.n_states)
    for first in range(0, motion.n_samples, BLOCK):
        rows = slice(max(first - 1, 0), first + BLOCK)
        block = laws.Motion(*[channel[rows] for channel in channels])
        state_path(law, block, np.empty((0, block.n_samples)), law.theta, state)


def memory_laws(verdicts: Verdicts, size: int, rounds: int) -> pd.DataFrame:
    """Samples a second of laws with memory beside the same loop, compiled and bare."""
    motion = three_sines(size)
    s = motion.s
    z = np.zeros(size)
    smooth = laws.BoucWen(beta=800.0, rho=0.5, n=1.0)
    sharp = laws.BoucWen(beta=800.0, rho=0.5, n=1.6)
    bare_smooth = partial(bare_bouc_wen, s, 800.0, 0.5, 1.0, z)
    bare_sharp = partial(bare_bouc_wen, s, 800.0, 0.5, 1.6, z)
    cases = [
        ("Dahl", laws.Dahl(sigma=2000.0), partial(bare_dahl, s, 2000.0, z), 1e8),
        ("Jenkins", laws.Jenkins(uy=1e-3), partial(bare_jenkins, s, 1e-3, z), 1e8),
        ("Bouc-Wen, n = 1", smooth, bare_smooth, 2e7),
        ("Bouc-Wen, n = 1.6", sharp, bare_sharp, 1e7),
    ]
    rows = []
    for name, law, bare, wanted in cases:
        runs = {"law": partial(along, law, motion), "bare": bare}
        for run in runs.values():
            run()  # compiles
        best = least_times(runs, rounds, np.inf)
        rate = size / best["law"]
        bare_rate = size / best["bare"]
        row = {"law": name, "samples/s": f"{rate:.2e}"}
        rows.append(row | {"bare loop": f"{bare_rate:.2e}"})
        claim = f"{name}: {wanted:.0e} samples a second"
        verdicts.add(claim, f"{rate:.2e}", rate >= wanted)
    return pd.DataFrame(rows)


# -- process starts ------------------------------------------------------------

START = """
import time; began = time.perf_counter()
import numpy as np
from pysindy_nrf import NRFRegressor, laws
rng = np.random.default_rng(0)
X = rng.standard_normal((4000, 6)); F = 3 * X[:, :2] + X[:, 2:4] + 5 * X[:, 4:]
NRFRegressor(laws={"storey 1": [laws.LinearElastic(), laws.LinearViscous()]}).fit(X, F)
t = np.arange(4000) / 1e3
laws.Dahl(sigma=10.0).features(laws.Motion(np.sin(t), np.cos(t), t=t))
print(time.perf_counter() - began)
"""
IMPORT = """
import time; began = time.perf_counter()
{}
print(time.perf_counter() - began)
"""
IMPORT_SINDY = "import pysindy"
IMPORT_BOTH = "import pysindy, pysindy_nrf"
IMPORT_OURS = "import pysindy_nrf"


def seconds_of(code: str, cache: str | None = None) -> float:
    """What a new process prints."""
    env = os.environ | {"PYTHONWARNINGS": "ignore"}
    if cache:
        env["NUMBA_CACHE_DIR"] = cache
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, env=env, check=True)
    return float(done.stdout)


def starts(verdicts: Verdicts, rounds: int) -> pd.DataFrame:
    """A process that identifies, nothing compiled yet and all on the disk; imports."""
    with tempfile.TemporaryDirectory() as cache:
        first = seconds_of(START, cache)
        second = min(seconds_of(START, cache) for _ in range(max(rounds, 2)))
    imports = dict.fromkeys((IMPORT_SINDY, IMPORT_BOTH, IMPORT_OURS), np.inf)
    for _ in range(2 * rounds + 1):
        for statement in imports:
            seconds = seconds_of(IMPORT.format(statement))
            imports[statement] = min(imports[statement], seconds)

    ours = max(imports[IMPORT_BOTH], imports[IMPORT_OURS])
    more = ours - imports[IMPORT_SINDY]
    claim = "the second start costs at most half the first"
    verdicts.add(claim, f"{first:.2f} s, then {second:.2f} s", second < first / 2)
    claim = "import pysindy_nrf: at most 0.15 s more than import pysindy"
    verdicts.add(claim, f"{more:.3f} s", more <= 0.15)
    times = {"first start, compiling": first, "second start": second} | imports
    rows = [{"process": name, "s": f"{value:.2f}"} for name, value in times.items()]
    return pd.DataFrame(rows)


# -- a file by path ------------------------------------------------------------

WATCHED = """
import sys, threading, time
from pathlib import Path
from pysindy_nrf import NRFRegressor
from pysindy_nrf.identification.streaming import fit
fit.SECONDS_BETWEEN_STATES = 0.5
peak = 0.0
running = True
def watch():
    global peak
    while running:
        status = Path("/proc/self/status").read_text()
        peak = max(peak, int(status.split("RssAnon:")[1].split()[0]) / 1024)
        time.sleep(0.01)
watcher = threading.Thread(target=watch)
watcher.start()
began = time.perf_counter()
masses = NRFRegressor().fit(sys.argv[1], sys.argv[2], state=sys.argv[3]).masses_
running = False
watcher.join()
print(time.perf_counter() - began, peak, *map(repr, masses.tolist()))
"""


@dataclass(frozen=True)
class Watched:
    """A fit in a process of its own: seconds, anonymous memory (MB), masses."""

    seconds: float
    memory: float
    masses: np.ndarray


def start_fit(folder: str) -> subprocess.Popen:
    """A process that fits the files of a folder."""
    paths = [str(Path(folder, name)) for name in ("X.npy", "F.npy", "state")]
    env = os.environ | {"PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-c", WATCHED, *paths]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)


def watched_fit(folder: str) -> Watched:
    seconds, memory, *masses = map(float, start_fit(folder).communicate()[0].split())
    return Watched(seconds, memory, np.array(masses))


def write_files(folder: str, n: int, size: int) -> None:
    """Motions and forces of a chain, repeated in pieces."""
    piece = chain_data(n, 2**18)
    for name, values in (("X.npy", piece.X), ("F.npy", piece.F)):
        shape = (size, values.shape[1])
        array = np.lib.format.open_memmap(
            Path(folder, name), mode="w+", dtype=np.float64, shape=shape
        )
        for first in range(0, size, len(values)):
            rows = min(len(values), size - first)
            array[first : first + rows] = values[:rows]


def kill_half_way(folder: str, seconds: float) -> bool:
    """Kill a fit after some time; whether it had saved its state."""
    state = Path(folder, "state")
    process = start_fit(folder)
    began = time.monotonic()
    while not state.exists() and process.poll() is None:
        if time.monotonic() - began > 600:
            break
        time.sleep(0.02)
    time.sleep(max(0.0, seconds - (time.monotonic() - began)))
    process.kill()
    process.wait()
    return state.exists()


def big_file(verdicts: Verdicts, gigabytes: float) -> pd.DataFrame:
    """A file fitted by path, then killed half-way and resumed."""
    n = 10
    with tempfile.TemporaryDirectory() as folder:
        write_files(folder, n, int(gigabytes * 1e9 / (32 * n)))
        straight = watched_fit(folder)
        saved = kill_half_way(folder, 0.4 * straight.seconds)
        resumed = watched_fit(folder)

    gap = float(np.abs(resumed.masses / straight.masses - 1).max())
    name = f"{gigabytes:g} GB by path"
    memory = straight.memory
    claim = f"{name}: less than 600 MB of anonymous memory"
    verdicts.add(claim, f"{memory:.0f} MB", memory < 600)
    claim = f"{name}, killed half-way and resumed: same masses to 1e-12"
    verdicts.add(claim, f"{gap:.1e}", gap <= 1e-12 and saved)
    rows = []
    for run, fit in (("straight", straight), ("resumed", resumed)):
        memory_text = f"{fit.memory:.0f}"
        row = {"run": run, "s": f"{fit.seconds:.1f}", "anonymous MB": memory_text}
        rows.append(row)
    return pd.DataFrame(rows)


# -- Dask ----------------------------------------------------------------------


def piece_of_motion(number: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    data = chain_data(10, rows)
    factor = 1 + 0.01 * number
    return data.X * factor, data.F * factor


def dask_scaling(verdicts: Verdicts, n_pieces: int, rows: int) -> pd.DataFrame:
    """Partitions made and fitted on one worker process and on two."""
    import dask
    import distributed

    parts = [dask.delayed(piece_of_motion)(i, rows) for i in range(n_pieces)]
    pieces = [piece_of_motion(i, rows) for i in range(n_pieces)]
    X, F = [np.vstack(arrays) for arrays in zip(*pieces)]
    reference = NRFRegressor(degree=1).fit(X, F)
    del pieces, X, F

    def fit() -> NRFRegressor:
        return NRFRegressor(degree=1).fit(parts)

    table_rows = []
    first = np.nan
    for workers in (1, 2):
        cluster = partial(
            distributed.LocalCluster,
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=50,
        )
        with (
            dask.config.set({"distributed.comm.timeouts.connect": "60s"}),
            cluster() as workers_running,
            distributed.Client(workers_running),
        ):
            model = fit()  # imports and compiled code
            seconds = least(fit, 2, clock=time.perf_counter)
        gap = float(np.abs(model.masses_ / reference.masses_ - 1).max())
        claim = f"Dask, {workers} worker process(es): same masses to 1e-12"
        verdicts.add(claim, f"{gap:.1e}", gap <= 1e-12)
        first = seconds if workers == 1 else first
        row = {"workers": workers, "s": f"{seconds:.2f}", "gap to arrays": f"{gap:.1e}"}
        table_rows.append(row | {"speed-up": f"{first / seconds:.2f}"})
    return pd.DataFrame(table_rows)


# -- everything ----------------------------------------------------------------


def show_limits(machine: Limits) -> None:
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    print(
        f"One thread for every contender, processor time; {os.cpu_count()} cores, load"
        f" {load:.1f}."
    )
    rows = []
    for n in (2, 10, 100):
        operations, read = work_of_pass(n)
        row = {
            "n": n,
            "operations/sample": f"{operations:.0f}",
            "bytes/sample": f"{read:.0f}",
            "least s for 1e6": f"{machine.seconds(n, 10**6):.3f}",
        }
        rows.append(row)
    gemm, read = machine.gemm / 1e9, machine.read / 1e9
    title = f"The machine: {gemm:.1f} GFlop/s (dgemm), {read:.1f} GB/s read"
    show(title, pd.DataFrame(rows))


def problem_sizes(options: Any) -> list[tuple[int, int]]:
    """DOFs and samples."""
    if options.quick:
        return [(2, 10**4), (10, 10**4)]
    sizes = []
    for n in options.dofs:
        for size in (10**4, 10**5, 10**6, 10**7):
            if size <= options.most and n * size <= 10**8:
                sizes.append((n, size))
    return sizes


def run_passes(options: Any, machine: Limits, verdicts: Verdicts, rounds: int) -> None:
    """The contenders side by side, and the accuracy."""
    patience = 1.0 if options.quick else 20.0
    results = passes(problem_sizes(options), rounds, patience)
    table = pass_table(results, machine)
    show("One pass: this package beside others (one thread each)", table)
    judge_passes(results, machine, verdicts)
    accuracy(verdicts, 10**4 if options.quick else 10**5)
    if not options.quick:
        other_passes(verdicts, min(int(options.most), 10**6), rounds)
    if options.out:
        table.to_csv(options.out, index=False)


def run_slow_parts(options: Any, verdicts: Verdicts, rounds: int) -> None:
    """What ``--quick`` leaves out."""
    if "scaling" in options.only:
        title = "A fit on several cores, n = 10, 1e6 samples, wall time in s"
        show(title, on_all_cores(10**6, rounds))
    if "starts" in options.only:
        show("Process starts", starts(verdicts, rounds))
    if "file" in options.only and Path("/proc/self/status").exists():
        show("A file by path", big_file(verdicts, options.gigabytes))
    if "dask" in options.only and importlib.util.find_spec("distributed"):
        title = "Dask: workers, processes of one thread"
        show(title, dask_scaling(verdicts, 16, 2**17))


def main(arguments: list[str] | None = None) -> int:
    """Print all tables."""
    parser = options_of(__doc__, quick="small sizes, under half a minute")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--dofs", type=int, nargs="+", default=(2, 10, 100))
    parser.add_argument(
        "--most", type=float, default=1e7, help="largest number of samples"
    )
    parser.add_argument(
        "--gigabytes", type=float, default=4.0, help="size of the file fitted by path"
    )
    parser.add_argument("--out", type=Path, help="CSV file for the table of contenders")
    options = parser.parse_args(arguments)
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    warnings.simplefilter("ignore")
    rounds = options.rounds or (2 if options.quick else 5)
    verdicts = Verdicts()
    machine = measure_limits(3 * rounds)
    show_limits(machine)
    if "passes" in options.only:
        run_passes(options, machine, verdicts, rounds)
    if "laws" in options.only:
        size = 10**5 if options.quick else 10**6
        show("Laws with memory, one core", memory_laws(verdicts, size, 3 * rounds))
    if not options.quick:
        run_slow_parts(options, verdicts, rounds)

    show("It must show", verdicts.table())
    if verdicts.missed_a_time and "passes" in options.only:
        size = 10**5 if options.quick else min(int(options.most), 10**6)
        show("What bounds a fit, n = 10", profile_of_pass(size))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
