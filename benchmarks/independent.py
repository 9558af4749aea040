"""Solutions that share no code with the package: integrators and least squares."""

from __future__ import annotations

from collections.abc import Callable

import search_path
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pysindy_nrf import ChainModel, laws

Rate = Callable[[np.ndarray, np.ndarray], np.ndarray]


# -- two storeys, integrated by SciPy ------------------------------------------

DT = 1e-3  # s
MASS = 10.0  # kg
STIFFNESS = 1e5  # N/m
DAMPING = 100.0  # N s/m
CUBE = 1e9  # N/m^3
DAMPER = {"K0": 50.0, "C0": 399.0, "Fd": 34.85, "f0": 0.0, "sigma": 5e4}


def two_storeys(kind: str) -> ChainModel:
    """Two linear storeys, two cubic ones, or a Dahl damper in the first."""
    linear = laws.PowerSeries(1, [DAMPING, STIFFNESS])
    if kind == "duffing":
        cubic = laws.PowerSeries(3, [DAMPING, STIFFNESS, *[0.0] * 6, CUBE])
        return ChainModel([MASS, MASS], {"storey 1": cubic, "storey 2": cubic})
    first = [linear]
    if kind == "dahl":
        first.append(laws.ModifiedDahl(**DAMPER))
    return ChainModel([MASS, MASS], {"storey 1": first, "storey 2": linear})


def two_storey_rate(kind: str) -> Rate:
    """Rates of the same structure; states x1, x2, v1, v2 and z of the damper."""
    cube = CUBE if kind == "duffing" else 0.0

    def rate(y: np.ndarray, F: np.ndarray) -> np.ndarray:
        s = np.array([y[0], y[1] - y[0]])
        v = np.array([y[2], y[3] - y[2]])
        R = STIFFNESS * s + DAMPING * v + cube * s**3
        damper = []
        if kind == "dahl":
            z = y[4]
            R[0] += DAMPER["K0"] * s[0] + DAMPER["C0"] * v[0] + DAMPER["Fd"] * z
            damper = [DAMPER["sigma"] * (v[0] - z * abs(v[0]))]
        net = np.array([F[0] - R[0] + R[1], F[1] - R[1]])
        return np.concatenate([y[2:4], net / MASS, damper])

    return rate


def motion_by_scipy(kind: str, F: np.ndarray) -> np.ndarray:
    """x1, x2, v1, v2 from rest by DOP853, SciPy's cubic spline through the forces."""
    rate = two_storey_rate(kind)
    states = [np.zeros(5 if kind == "dahl" else 4)]
    times = DT * np.arange(len(F))
    spline = CubicSpline(times, F)

    def field(t: float, y: np.ndarray) -> np.ndarray:
        return rate(y, spline(t))

    for step in zip(times[:-1], times[1:]):
        run = solve_ivp(
            field, step, states[-1], method="DOP853", rtol=1e-12, atol=1e-15
        )
        states.append(run.y[:, -1])
    return np.array(states)[:, :4]


def force_on_top(rms: float, n_samples: int) -> np.ndarray:
    """White noise on the second floor, N."""
    F = np.zeros((n_samples, 2))
    F[:, 1] = rms * np.random.default_rng(0).standard_normal(n_samples)
    return F


# -- least squares -------------------------------------------------------------


def extended_least_squares(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Least squares by Gram-Schmidt, twice, in 80-bit arithmetic."""
    A = np.asarray(A, dtype=np.longdouble)
    y = np.asarray(y, dtype=np.longdouble)
    size = np.sqrt((A**2).sum(axis=0))
    Q = A / size
    p = A.shape[1]
    R = np.zeros((p, p), dtype=np.longdouble)
    for j in range(p):
        for _ in range(2):
            share = Q[:, :j].T @ Q[:, j]
            R[:j, j] += share
            Q[:, j] -= Q[:, :j] @ share
        R[j, j] = np.sqrt((Q[:, j] ** 2).sum())
        Q[:, j] /= R[j, j]

    x = np.zeros(p, dtype=np.longdouble)
    z = Q.T @ y
    for j in range(p - 1, -1, -1):
        x[j] = (z[j] - R[j, j + 1 :] @ x[j + 1 :]) / R[j, j]
    return (x / size).astype(float)


def monomials(v: np.ndarray, s: np.ndarray, degree: int) -> np.ndarray:
    """Columns v^h s^j of one storey, of unit size."""
    v = v / v.std()
    s = s / s.std()
    columns = []
    for h in range(degree + 1):
        for j in range(degree + 1 - h):
            if h + j > 0:
                columns.append(v**h * s**j)
    return np.column_stack(columns)


def independent_masses(X: np.ndarray, F: np.ndarray, degree: int = 3) -> np.ndarray:
    """Masses by NumPy's lstsq of the balances (eqs. 3-5).

    With all DOFs forced each balance is solved alone, otherwise in sequence: a storey
    found in one balance is known in the next.
    """
    X = np.asarray(X)
    F = np.asarray(F)
    n = F.shape[1]
    a, v, s = np.hsplit(X, 3)
    storeys = [monomials(v[:, i], s[:, i], degree) for i in range(n)]
    width = storeys[0].shape[1]
    forced = F.any(axis=0)

    masses = np.full(n, np.nan)
    known: dict[int, np.ndarray] = {}
    while np.isnan(masses).any():
        j = next_balance(masses, forced, known)
        signs = {j: 1.0}
        if j + 1 < n:
            signs[j + 1] = -1.0
        unknown = [i for i in signs if forced.all() or i not in known]
        columns = [a[:, [j]]]
        columns += [signs[i] * storeys[i] for i in unknown]
        target = F[:, j].copy()
        for i in signs.keys() - set(unknown):
            target -= signs[i] * known[i]

        solution = np.linalg.lstsq(np.hstack(columns), target, rcond=None)[0]
        masses[j] = solution[0]
        for number, i in enumerate(unknown):
            coefficients = solution[1 + number * width : 1 + (number + 1) * width]
            known.setdefault(i, storeys[i] @ coefficients)
    return masses


def next_balance(
    masses: np.ndarray, forced: np.ndarray, known: dict[int, np.ndarray]
) -> int:
    """The forced balances first, then those beside a known storey; fewest unknowns."""
    n = len(masses)

    def rank(j: int) -> tuple[bool, int, int]:
        storeys = {j, j + 1} & set(range(n))
        return not forced[j], len(storeys - known.keys()), -j

    def solvable(j: int) -> bool:
        return np.isnan(masses[j]) and (forced[j] or j in known or j + 1 in known)

    return min(filter(solvable, range(n)), key=rank)
