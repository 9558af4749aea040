"""Cost of an identification beside others' and beside the machine: one table, same
data, same run.

    python benchmarks/speed.py --quick
    python benchmarks/speed.py                       # about a quarter of an hour on one idle core
    python benchmarks/speed.py --only passes limits  # some parts: limits, passes,
    scaling, laws, starts, file, dask python benchmarks/speed.py --out table.csv

Every contender runs on one thread, alternating with the others. Times are processor
time of that thread, the least of all rounds, so that other people's load on the machine
falls on none of them (several cores, process starts, files and Dask: wall time). Data:
chains of Duffing storeys in random motion, 1 % noise in the forces (and rows without
noise). ``lstsq``, scikit-learn and SINDy are given the raw channels, as this package
is; their time holds the columns they need. Memory: peak of what Python and NumPy
allocate on top of the data (tracemalloc, in a run of its own).
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

for variable in (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
):
    os.environ.setdefault(variable, "1")
warnings.simplefilter("ignore")

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402

from pysindy_nrf import NRFRegressor, laws  # noqa: E402
from pysindy_nrf.laws.memory import state_path  # noqa: E402

DEGREE = 3
PARTS = ("limits", "passes", "scaling", "laws", "starts", "file", "dask")
# Largest problem each contender is asked to solve, in numbers of its design matrix;
# beyond it takes memory or hours.
MOST = 1.2e8
MOST_WORK = 1.5e11  # numbers times columns


# -- data ----------------------------------------------------------------------


@dataclass
class Data:
    """Channels of one chain, and the truth behind them."""

    n: int
    X: np.ndarray
    F: np.ndarray
    masses: np.ndarray
    name: str

    @property
    def size(self) -> int:
        return len(self.X)


def chain_data(
    n: int,
    size: int,
    noise: float = 0.01,
    excitation: str = "complete",
    dtype=np.float64,
) -> Data:
    """Duffing storeys in random motion; every DOF forced, or the top one alone
    (sequential).
    """
    rng = np.random.default_rng(n)
    m, c = rng.uniform(5, 20, n), rng.uniform(50, 150, n)
    k = rng.uniform(5e4, 2e5, n)
    k3 = k * 1e5 * rng.uniform(0.5, 1.0, n)
    X, F = np.empty((size, 3 * n), dtype=dtype), np.empty((size, n), dtype=dtype)
    for low in range(0, size, 2**16):
        rows = slice(low, min(low + 2**16, size))
        count = rows.stop - rows.start
        v, s = (
            0.1 * rng.standard_normal((count, n)),
            1e-3 * rng.standard_normal((count, n)),
        )
        R = c * v + k * s + k3 * s**3
        net = R.copy()
        net[:, :-1] -= R[:, 1:]
        if excitation == "complete":
            a = 10.0 * rng.standard_normal((count, n))
            force = m * a + net
        else:
            force = np.zeros((count, n))
            force[:, -1] = 200.0 * rng.standard_normal(count)
            a = (force - net) / m
        loud = force if excitation == "complete" else force[:, -1:]
        if noise:
            loud += noise * loud.std() * rng.standard_normal(loud.shape)
        X[rows] = np.hstack([a, v, s])
        F[rows] = force
    return Data(
        n, X, F, m, f"{excitation}, {'no' if not noise else f'{100 * noise:g} %'} noise"
    )


def powers(v: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Columns v^h s^j of one storey, total degree up to three."""
    exponents = [(h, d - h) for d in range(1, DEGREE + 1) for h in range(d, -1, -1)]
    out = np.empty((len(v), len(exponents)))
    for i, (h, j) in enumerate(exponents):
        out[:, i] = v**h * s**j
    return out


def balance_columns(data: Data, j: int, sequential: bool) -> np.ndarray:
    """Columns of balance j: a_j, storey j, and storey j+1 where its law is not known
    yet.
    """
    n, X = data.n, data.X
    own = [X[:, [j]], powers(X[:, n + j], X[:, 2 * n + j])]
    if j + 1 < n and not sequential:
        own.append(-powers(X[:, n + j + 1], X[:, 2 * n + j + 1]))
    return np.hstack(own)


# -- contenders: from raw channels to masses -----------------------------------


def this_package(data: Data) -> np.ndarray:
    return (
        NRFRegressor(degree=DEGREE, strategy=data.name.split(",")[0])
        .fit(data.X, data.F)
        .masses_
    )  # as the others


def per_balance(
    data: Data, solve: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> np.ndarray:
    sequential = "sequential" in data.name
    masses, above = np.empty(data.n), 0.0
    for j in range(data.n - 1, -1, -1):
        A = balance_columns(data, j, sequential)
        target = data.F[:, j] + above if sequential else data.F[:, j]
        found = solve(A, target)
        masses[j] = found[0]
        above = A[:, 1:] @ found[1:] if sequential else 0.0
    return masses


def lstsq(data: Data) -> np.ndarray:
    return per_balance(data, lambda A, b: np.linalg.lstsq(A, b, rcond=None)[0])


def sklearn_linear(data: Data) -> np.ndarray:
    from sklearn.linear_model import LinearRegression

    return per_balance(
        data,
        lambda A, b: LinearRegression(fit_intercept=False, tol=1e-12).fit(A, b).coef_,
    )


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
    inputs = [[j, n + j] for j in range(n)] + [list(range(2 * n, 3 * n))]
    library = ps.GeneralizedLibrary(
        [ps.PolynomialLibrary(degree=DEGREE, include_bias=False) for _ in range(n)]
        + [ps.IdentityLibrary()],
        inputs_per_library=inputs,
    )
    model = ps.SINDy(
        feature_library=library,
        optimizer=ps.STLSQ(threshold=0.0, alpha=0.0, unbias=False),
    )
    model.fit(data.X[:, n:], t=1.0, x_dot=data.X[:, :n], u=data.F)
    gain = model.coefficients()[:, -n:]
    return 1.0 / np.diag(gain)


def plain_sindy(data: Data) -> np.ndarray:
    """SINDy as it comes: a cubic in all states and forces."""
    import pysindy as ps

    n = data.n
    model = ps.SINDy(
        feature_library=ps.PolynomialLibrary(degree=DEGREE), optimizer=ps.STLSQ()
    )
    model.fit(data.X[:, n:], t=1.0, x_dot=data.X[:, :n], u=data.F)
    with np.errstate(divide="ignore"):
        return 1.0 / np.diag(model.coefficients()[:, 1 + 2 * n : 1 + 3 * n])


def frols(data: Data) -> np.ndarray:
    """SysIdentPy: forward regression of a storey's polynomial, one balance after the
    other.
    """
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    n, masses = data.n, np.full(data.n, np.nan)
    for j in range(n):
        last = min(j + 2, n)
        u = np.hstack(
            [
                data.X[:, [j]],
                data.X[:, n + j : n + last],
                data.X[:, 2 * n + j : 2 * n + last],
            ]
        )
        model = FROLS(
            order_selection=False,
            n_terms=20,
            ylag=1,
            xlag=[[1]] * u.shape[1],
            model_type="NFIR",
            basis_function=Polynomial(degree=DEGREE),
        )
        model.fit(
            X=u, y=np.roll(data.F[:, [j]], 1, axis=0)
        )  # its inputs are those of the sample before
        linear = np.flatnonzero(
            (model.final_model[:, 0] == 2001)
            & (model.final_model[:, 1:] == 0).all(axis=1)
        )
        if linear.size:
            masses[j] = model.theta[linear[0], 0]
    return masses


def columns_of(name: str, n: int) -> float:
    """Width of the widest matrix a contender holds."""
    inputs = 3 * n
    return {
        "SINDy, same terms": 10 * n + n,
        "SINDy, plain": (inputs + 1) * (inputs + 2) * (inputs + 3) / 6,
        "SysIdentPy FROLS": 286 if n > 1 else 35,
    }.get(name, 20)


CONTENDERS: dict[str, Callable[[Data], np.ndarray]] = {
    "pysindy_nrf": this_package,
    "lstsq per DOF": lstsq,
    "LinearRegression": sklearn_linear,
    "SINDy, same terms": sindy,
    "SINDy, plain": plain_sindy,
    "SysIdentPy FROLS": frols,
}
NOT_HERE = {
    "pyCC-ID polynomial": "pycc",
    "SysIdentPy FROLS": "sysidentpy",
}


def excuse(name: str, data: Data) -> str | None:
    """Why a contender does not run on these data."""
    package = NOT_HERE.get(name)
    if package and importlib.util.find_spec(package) is None:
        needs = ", which brings torch and Julia," if package == "pycc" else ""
        return f"not run: the package {package}{needs} is not installed here"
    if name == "pyCC-ID polynomial":
        return "does not apply: functions of one variable, no terms in v and s together"
    columns = columns_of(name, data.n)
    if name != "pysindy_nrf" and (
        columns * data.size > MOST or columns**2 * data.size > MOST_WORK
    ):
        return (
            f"not run: a matrix of {columns * data.size * 8 / 1e9:.2g} GB with"
            f" {columns:.0f} columns"
        )
    if name in ("lstsq per DOF", "LinearRegression") and data.n * data.size > 1.1e7:
        return "not run: minutes"
    if name.startswith("Sys") and data.size > 20_000:
        return "not run: orthogonalises every candidate at every step, minutes"
    return None


# -- measuring -----------------------------------------------------------------


def least(
    function: Callable[[], object],
    rounds: int,
    enough: float = 0.0,
    clock: Callable[[], float] = time.process_time,
) -> float:
    best, spent = np.inf, 0.0
    for _ in range(rounds):
        began = clock()
        function()
        took = clock() - began
        best, spent = min(best, took), spent + took
        if enough and spent > enough:
            break
    return best


def alternate(
    functions: dict[str, Callable[[], object]],
    rounds: int,
    patience: float,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, float]:
    """Least time of each, in turns; one that takes longer than ``patience`` seconds has
    its last turn.
    """
    best = dict.fromkeys(functions, np.inf)
    open_ = dict(functions)
    for _ in range(rounds):
        for name in list(open_):
            took = least(open_[name], 1, clock=clock)
            best[name] = min(best[name], took)
            if took > patience:
                del open_[name]
        if list(open_) == ["pysindy_nrf"] and len(functions) > 1:
            break
    return best


def peak_memory(function: Callable[[], object]) -> float:
    """MB on top of what was there."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


def work_of_pass(n: int) -> tuple[float, float]:
    """Multiplications and additions, and bytes read, for each sample: what the balances
    of a chain need.

    Products of the columns of neighbouring storeys, each pair once; symmetric blocks on
    and below the diagonal.
    """
    p = DEGREE * (DEGREE + 3) // 2
    products = n * (p * (p + 1) / 2 + 3 + 2 * p) + (n - 1) * (p * p + 2 * p)
    columns = n * (p - 2)
    return 2 * products + columns, 8.0 * 4 * n


@dataclass
class Limits:
    """What the machine can do, measured in this run."""

    gemm: float  # operations/s of a large matrix product
    read: float  # bytes/s summed up from main memory

    def seconds(self, n: int, size: int) -> float:
        """Least time of a pass: arithmetic or memory, whichever is slower."""
        operations, read = work_of_pass(n)
        return size * max(operations / self.gemm, read / self.read)


def limits(rounds: int = 5) -> Limits:
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 768, 768))
    big = np.ones(2**24)
    return Limits(
        2 * 768**3 / least(lambda: a @ b, rounds),
        big.nbytes / least(lambda: big.sum(), rounds),
    )


# -- tables --------------------------------------------------------------------


def show(title: str, table: pd.DataFrame) -> None:
    print(f"\n## {title}\n")
    cells = table.astype(str)
    widths = [
        max(len(c), *(len(x) for x in cells[c])) if len(cells) else len(c)
        for c in cells
    ]
    for row in [list(cells), ["-" * w for w in widths], *cells.to_numpy().tolist()]:
        print("| " + " | ".join(str(x).ljust(w) for x, w in zip(row, widths)) + " |")


class Verdicts:
    """Claims with what was measured; PASS or MISS."""

    def __init__(self) -> None:
        self.rows: list[list[str]] = []

    def add(self, claim: str, measured: str, holds: bool) -> bool:
        self.rows.append([claim, measured, "PASS" if holds else "MISS"])
        return holds

    def table(self) -> pd.DataFrame:
        return pd.DataFrame(self.rows, columns=["claim", "measured", ""])


def passes(
    machine: Limits, sizes: list[tuple[int, int]], rounds: int, patience: float
) -> pd.DataFrame:
    """Every contender on the same data."""
    rows = []
    for n, size in sizes:
        data = chain_data(n, size)
        own = NRFRegressor(degree=DEGREE).fit(
            data.X[:2000], data.F[:2000]
        )  # compiled code comes from the disk
        assert own.masses_.shape == (n,)
        run = {
            k: lambda f=f, d=data: f(d)
            for k, f in CONTENDERS.items()
            if excuse(k, data) is None
        }
        best = alternate(run, rounds, patience)
        bound = machine.seconds(n, size)
        for name in [*CONTENDERS, "pyCC-ID polynomial"]:
            why = excuse(name, data)
            row = {"n": n, "samples": f"{size:.0e}".replace("e+0", "e"), "by": name}
            if why is not None:
                rows.append({**row, "note": why})
                continue
            small = data if size <= 10**6 or name == "pysindy_nrf" else None
            masses = run[name]()
            error = float(np.abs(masses / data.masses - 1).max())
            memory = peak_memory(run[name]) if small is not None else np.nan
            rows.append(
                {
                    **row,
                    "s": f"{best[name]:.3g}",
                    "times ours": f"{best[name] / best['pysindy_nrf']:.3g}",
                    "times limit": f"{best[name] / bound:.3g}",
                    "extra MB": f"{memory:.3g}",
                    "worst mass error": f"{error:.1e}",
                    "note": "",
                    "_s": best[name],
                    "_mb": memory,
                }
            )
        del data, run
    return pd.DataFrame(rows)


def judged_passes(table: pd.DataFrame, machine: Limits, verdicts: Verdicts) -> None:
    def seconds(n: int, samples: str, by: str = "pysindy_nrf") -> float:
        hit = table[
            (table["n"] == n) & (table["samples"] == samples) & (table["by"] == by)
        ]
        return float(hit["_s"].iloc[0]) if len(hit) and "_s" in hit else np.nan

    for by, wanted in (("lstsq per DOF", 40), ("SINDy, same terms", 60)):
        ratio = seconds(10, "1e6", by) / seconds(10, "1e6")
        if np.isfinite(ratio):
            claim = (
                f"n = 10, 1e6 samples, complete: at least {wanted} times faster than"
                f" {by}"
            )
            verdicts.add(claim, f"{ratio:.1f} times", ratio >= wanted)
    ours = seconds(10, "1e6")
    if np.isfinite(ours):
        ratio = ours / machine.seconds(10, 10**6)
        verdicts.add(
            "n = 10, 1e6: within 4 times the measured limit",
            f"{ratio:.2f} times",
            ratio <= 4,
        )
    for n, samples, wanted in ((10, "1e7", 12),):
        ratio = seconds(n, samples) / seconds(n, "1e6")
        if np.isfinite(ratio):
            verdicts.add(
                "1e7 samples cost at most 12 times 1e6 (n = 10)",
                f"{ratio:.2f} times",
                ratio <= wanted,
            )
    for samples in ("1e6", "1e5"):
        ratio = seconds(100, samples) / seconds(10, samples)
        if np.isfinite(ratio):
            verdicts.add(
                f"n = 100 costs at most 13 times n = 10 ({samples})",
                f"{ratio:.2f} times",
                ratio <= 13,
            )
            break
    memory = table[(table["by"] == "pysindy_nrf") & (table["n"] <= 10)]["_mb"].dropna()
    most = float(memory.max())
    verdicts.add(
        "extra memory at most 32 MB whatever the samples (n <= 10)",
        f"{most:.1f} MB",
        most <= 32,
    )


def accuracy(verdicts: Verdicts, size: int) -> None:
    """Against Householder's QR, with and without noise, complete and sequential."""
    for excitation in ("complete", "sequential"):
        for noise in (0.01, 0.0):
            data = chain_data(10, size, noise, excitation)
            gap = float(np.abs(this_package(data) / scaled_qr(data) - 1).max())
            verdicts.add(
                f"masses equal to a QR reference to 1e-9: {data.name}",
                f"{gap:.1e}",
                gap <= 1e-9,
            )


def sequential_pass(
    verdicts: Verdicts, size: int, rounds: int, patience: float
) -> None:
    """The top DOF forced alone; and complete without noise, which needs a second
    pass.
    """
    for excitation, noise in (
        ("sequential", 0.01),
        ("sequential", 0.0),
        ("complete", 0.0),
    ):
        data = chain_data(10, size, noise, excitation)
        names = ("pysindy_nrf", "lstsq per DOF", "SINDy, same terms")
        run = {
            k: lambda f=CONTENDERS[k], d=data: f(d)
            for k in names
            if excuse(k, data) is None
        }
        best = alternate(run, rounds, patience)
        for name, wanted in (("lstsq per DOF", 40), ("SINDy, same terms", 60)):
            if name in best:
                ratio = best[name] / best["pysindy_nrf"]
                wide = (
                    " (its columns: 10 a balance, not 19)"
                    if excitation == "sequential" and "DOF" in name
                    else ""
                )
                claim = (
                    f"n = 10, {size:.0e} samples, {data.name}: at least {wanted} times"
                    f" faster than {name}{wide}"
                )
                verdicts.add(claim, f"{ratio:.1f} times", ratio >= wanted)


def on_all_cores(size: int, rounds: int) -> pd.DataFrame:
    """Wall time of a fit on one thread and more, beside ``lstsq`` with as many threads
    of BLAS.
    """
    from unittest.mock import patch

    from threadpoolctl import threadpool_limits

    rows = []
    for excitation in ("complete", "sequential"):
        data = chain_data(10, size, excitation=excitation)
        for threads in sorted({1, 2, os.cpu_count() or 1}):
            asked = dict.fromkeys(
                ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), str(threads)
            )
            with patch.dict(os.environ, asked), threadpool_limits(threads, "blas"):
                run = {
                    k: lambda f=CONTENDERS[k], d=data: f(d)
                    for k in ("pysindy_nrf", "lstsq per DOF")
                }
                best = alternate(run, rounds, 60.0, clock=time.perf_counter)
            row = {"excitation": excitation, "threads": threads} | {
                k: f"{s:.3f}" for k, s in best.items()
            }
            rows.append(
                row | {"times": f"{best['lstsq per DOF'] / best['pysindy_nrf']:.1f}"}
            )
    return pd.DataFrame(rows)


def profile_of_pass(size: int) -> pd.DataFrame:
    """Where the time of one fit goes."""
    import cProfile
    import pstats

    data = chain_data(10, size)
    this_package(data)
    profile = cProfile.Profile()
    profile.enable()
    this_package(data)
    profile.disable()
    stats = pstats.Stats(profile)
    rows = [
        (own, f"{Path(file).name}:{name}")
        for (file, _, name), (_, _, own, _, _) in stats.stats.items()
    ]
    rows.sort(reverse=True)
    return pd.DataFrame(
        [
            {"in": name, "s": f"{t:.4f}", "share": f"{100 * t / stats.total_tt:.0f} %"}
            for t, name in rows[:12]
        ]
    )


def memory_laws(verdicts: Verdicts, size: int, rounds: int) -> pd.DataFrame:
    """Samples a second of laws with memory beside the same loop, compiled and bare."""
    import math

    import numba

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
    def bare_bouc_wen(s, beta, rho, n, z):
        """Wen's equation by one step of the midpoint rule."""
        w = 0.0
        for i in range(1, s.size):
            ds = s[i] - s[i - 1]
            half = w + 0.5 * ds * (
                1.0 - (math.copysign(1.0, ds * w) + rho) * (beta * abs(w)) ** n
            )
            w += ds * (
                1.0 - (math.copysign(1.0, ds * half) + rho) * (beta * abs(half)) ** n
            )
            z[i] = w

    t = np.arange(size) / 1000.0
    omega, phase = 2 * np.pi * np.array([1.3, 2.1, 3.7]), np.arange(3.0)
    s, v, a = np.zeros((3, size))
    for w, p in zip(omega, phase):
        s += 1e-3 * np.sin(w * t + p)
        v += 1e-3 * w * np.cos(w * t + p)
        a -= 1e-3 * w * w * np.sin(w * t + p)
    z, block = np.zeros(size), 2**16

    def along(law: laws.ForceLaw) -> None:
        """In blocks that share a sample, as a fit of a long record takes them."""
        state = np.zeros(law.n_states)
        for low in range(0, size, block):
            part = laws.Motion(
                *(x[max(low - 1, 0) : low + block] for x in (s, v, a, t))
            )
            state_path(law, part, np.empty((0, part.n_samples)), law.theta, state)

    smooth, sharp = (laws.BoucWen(beta=800.0, rho=0.5, n=n) for n in (1.0, 1.6))
    cases = [
        ("Dahl", laws.Dahl(sigma=2000.0), lambda: bare_dahl(s, 2000.0, z), 1e8),
        ("Jenkins", laws.Jenkins(uy=1e-3), lambda: bare_jenkins(s, 1e-3, z), 1e8),
        ("Bouc-Wen, n = 1", smooth, lambda: bare_bouc_wen(s, 800.0, 0.5, 1.0, z), 2e7),
        ("Bouc-Wen, n = 1.6", sharp, lambda: bare_bouc_wen(s, 800.0, 0.5, 1.6, z), 1e7),
    ]
    rows = []
    for name, law, bare, wanted in cases:
        run = {
            "law": lambda law=law: along(law),
            "bare": bare,
        }
        for f in run.values():
            f()
        best = alternate(run, rounds, np.inf)
        rate = size / best["law"]
        rows.append(
            {
                "law": name,
                "samples/s": f"{rate:.2e}",
                "bare loop": f"{size / best['bare']:.2e}",
            }
        )
        verdicts.add(
            f"{name}: {wanted:.0e} samples a second", f"{rate:.2e}", rate >= wanted
        )
    return pd.DataFrame(rows)


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


def starts(verdicts: Verdicts, rounds: int) -> pd.DataFrame:
    """A process that identifies: nothing compiled yet, and all on the disk; and what
    importing costs.
    """

    def run(code: str, folder: str | None = None) -> float:
        env = {
            **os.environ,
            "PYTHONWARNINGS": "ignore",
            **({"NUMBA_CACHE_DIR": folder} if folder else {}),
        }
        out = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            env=env,
            check=True,
        )
        return float(out.stdout)

    with tempfile.TemporaryDirectory() as folder:
        first = run(START, folder)
        second = min(run(START, folder) for _ in range(max(rounds, 2)))
    clock = (
        "import time; began = time.perf_counter(); {}; print(time.perf_counter() -"
        " began)"
    )
    both = {
        k: np.inf
        for k in ("import pysindy", "import pysindy, pysindy_nrf", "import pysindy_nrf")
    }
    for _ in range(2 * rounds + 1):
        for k in both:
            both[k] = min(both[k], run(clock.format(k)))
    more = (
        max(both["import pysindy, pysindy_nrf"], both["import pysindy_nrf"])
        - both["import pysindy"]
    )
    claim = "the second start costs at most half the first"
    verdicts.add(claim, f"{first:.2f} s, then {second:.2f} s", second < first / 2)
    claim = "import pysindy_nrf: at most 0.15 s more than import pysindy"
    verdicts.add(claim, f"{more:.3f} s", more <= 0.15)
    rows = [("first start, compiling", first), ("second start", second), *both.items()]
    return pd.DataFrame([{"process": k, "s": f"{v:.2f}"} for k, v in rows])


WATCHED = """
import sys, threading, time
from pathlib import Path
import numpy as np
from pysindy_nrf import NRFRegressor
def anonymous():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024
most, on = [0.0], [True]
def watch():
    while on[0]:
        most[0] = max(most[0], anonymous()); time.sleep(0.01)
watcher = threading.Thread(target=watch); watcher.start()
began = time.perf_counter()
masses = NRFRegressor().fit(sys.argv[1], sys.argv[2], state=sys.argv[3]).masses_
on[0] = False; watcher.join()
print(time.perf_counter() - began, most[0], *map(repr, masses.tolist()))
"""


def big_file(verdicts: Verdicts, gigabytes: float) -> pd.DataFrame:
    """A file fitted by path, then killed half-way and resumed."""
    n = 10
    size = int(gigabytes * 1e9 / (32 * n))
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder, name)) for name in ("X.npy", "F.npy", "state")]
        X, F = (
            np.lib.format.open_memmap(
                path, mode="w+", dtype=np.float64, shape=(size, width)
            )
            for path, width in zip(paths, (3 * n, n))
        )
        part = chain_data(n, 2**18)
        for low in range(0, size, 2**18):
            rows = min(2**18, size - low)
            X[low : low + rows], F[low : low + rows] = part.X[:rows], part.F[:rows]
        del X, F, part
        quick_save = "from pysindy_nrf.identification.streaming import fit\n"
        quick_save += "fit.SECONDS_BETWEEN_STATES = 0.5\n"
        env = {**os.environ, "PYTHONWARNINGS": "ignore"}

        def start() -> subprocess.Popen:
            return subprocess.Popen(
                [sys.executable, "-c", quick_save + WATCHED, *paths],
                stdout=subprocess.PIPE,
                text=True,
                env=env,
            )

        straight = start().communicate()[0].split()
        killed = start()
        began = time.monotonic()
        while (
            not Path(paths[2]).exists()
            and killed.poll() is None
            and time.monotonic() - began < 600
        ):
            time.sleep(0.02)
        time.sleep(max(0.0, 0.4 * float(straight[0]) - (time.monotonic() - began)))
        killed.kill()
        killed.wait()
        left = Path(paths[2]).exists()
        resumed = start().communicate()[0].split()
    masses, again = (
        np.array([float(x) for x in out[2:]]) for out in (straight, resumed)
    )
    gap = float(np.abs(again / masses - 1).max())
    name = f"{gigabytes:g} GB by path"
    memory = float(straight[1])
    verdicts.add(
        f"{name}: less than 600 MB of anonymous memory",
        f"{memory:.0f} MB",
        memory < 600,
    )
    verdicts.add(
        f"{name}, killed half-way and resumed: same masses to 1e-12",
        f"{gap:.1e}",
        gap <= 1e-12 and left,
    )
    return pd.DataFrame(
        [
            {"run": k, "s": f"{float(v[0]):.1f}", "anonymous MB": f"{float(v[1]):.0f}"}
            for k, v in {"straight": straight, "resumed": resumed}.items()
        ]
    )


def dask_scaling(verdicts: Verdicts, pieces: int, rows: int) -> pd.DataFrame:
    """Partitions made and fitted on one worker process and on two."""
    import dask
    import distributed

    def piece(i: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
        part = chain_data(10, rows)
        return part.X * (1 + 0.01 * i), part.F * (1 + 0.01 * i)

    parts = [dask.delayed(piece)(i, rows) for i in range(pieces)]
    reference = NRFRegressor(degree=1)
    pairs = [piece(i, rows) for i in range(pieces)]
    reference.fit(*(np.vstack(x) for x in zip(*pairs)))
    del pairs
    out = []
    for workers in (1, 2):
        how = dict(threads_per_worker=1, dashboard_address=None, silence_logs=50)
        with dask.config.set({"distributed.comm.timeouts.connect": "60s"}):
            with (
                distributed.LocalCluster(n_workers=workers, **how) as cluster,
                distributed.Client(cluster),
            ):
                model = NRFRegressor(degree=1).fit(parts)  # imports and compiled code
                seconds = least(
                    lambda: NRFRegressor(degree=1).fit(parts),
                    2,
                    clock=time.perf_counter,
                )
        gap = float(np.abs(model.masses_ / reference.masses_ - 1).max())
        out.append({"workers": workers, "s": seconds, "gap to arrays": f"{gap:.1e}"})
        verdicts.add(
            f"Dask, {workers} worker process(es): same masses to 1e-12",
            f"{gap:.1e}",
            gap <= 1e-12,
        )
    table = pd.DataFrame(out)
    table["speed-up"] = [f"{table['s'][0] / s:.2f}" for s in table["s"]]
    return table.assign(s=[f"{s:.2f}" for s in table["s"]])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="small sizes, under half a minute"
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--rounds", type=int, default=None)
    parser.add_argument("--dofs", type=int, nargs="+", default=(2, 10, 100))
    parser.add_argument(
        "--most", type=float, default=1e7, help="largest number of samples"
    )
    parser.add_argument(
        "--gigabytes", type=float, default=4.0, help="size of the file fitted by path"
    )
    parser.add_argument("--out", type=Path, help="CSV file for the table of contenders")
    o = parser.parse_args(arguments)
    rounds = o.rounds or (2 if o.quick else 5)
    verdicts = Verdicts()
    machine = limits(3 * rounds)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    print(
        f"One thread for every contender, processor time; {os.cpu_count()} cores, load"
        f" {load:.1f}."
    )
    rows = []
    for n in (2, 10, 100):
        operations, read = work_of_pass(n)
        rows.append(
            {
                "n": n,
                "operations/sample": f"{operations:.0f}",
                "bytes/sample": f"{read:.0f}",
                "least s for 1e6": f"{machine.seconds(n, 10**6):.3f}",
            }
        )
    rates = (
        f"{machine.gemm / 1e9:.1f} GFlop/s (dgemm), {machine.read / 1e9:.1f} GB/s read"
    )
    show(f"The machine: {rates}", pd.DataFrame(rows))
    if "passes" in o.only:
        sizes = (
            [(2, 10**4), (10, 10**4)]
            if o.quick
            else [
                (n, size)
                for n in o.dofs
                for size in (10**4, 10**5, 10**6, 10**7)
                if size <= o.most and n * size <= 10**8
            ]
        )
        table = passes(machine, sizes, rounds, 1.0 if o.quick else 20.0)
        visible = table[[c for c in table if not c.startswith("_")]].fillna("")
        show("One pass: this package beside others (one thread each)", visible)
        judged_passes(table, machine, verdicts)
        accuracy(verdicts, 10**4 if o.quick else 10**5)
        if not o.quick:
            sequential_pass(verdicts, min(int(o.most), 10**6), rounds, 20.0)
        if o.out:
            visible.to_csv(o.out, index=False)
    if "scaling" in o.only and not o.quick:
        show(
            "A fit on several cores, n = 10, 1e6 samples, wall time in s",
            on_all_cores(10**6, rounds),
        )
    if "laws" in o.only:
        show(
            "Laws with memory, one core",
            memory_laws(verdicts, 10**5 if o.quick else 10**6, 3 * rounds),
        )
    if "starts" in o.only and not o.quick:
        show("Process starts", starts(verdicts, rounds))
    if "file" in o.only and not o.quick and Path("/proc/self/status").exists():
        show("A file by path", big_file(verdicts, o.gigabytes))
    if "dask" in o.only and not o.quick and importlib.util.find_spec("distributed"):
        show(
            "Dask: workers, processes of one thread", dask_scaling(verdicts, 16, 2**17)
        )
    show("It must show", verdicts.table())
    missed = any(
        row[2] == "MISS" and ("times" in row[0] or "limit" in row[0])
        for row in verdicts.rows
    )
    if missed and "passes" in o.only:
        show(
            "What bounds a fit, n = 10",
            profile_of_pass(10**5 if o.quick else min(int(o.most), 10**6)),
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
