"""Plain SINDy, SINDy set up by an expert, and this package side by side, on the same
data in the same call.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pysindy as ps
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from ..chain.model import ChainModel
from ..equations.errors import Sizes, nrmse, pooled_percent
from ..exceptions import ChannelError, NRFError, SimulationError
from ..identification.regressor import NRFRegressor
from ..records.input_arrays import from_arrays
from ..selection.sparsity import select_sparsity

__all__ = ["compare_with_sindy"]


@dataclass
class Part:
    """Absolute accelerations, inter-storey rates and drifts, forces of one record."""

    a: np.ndarray
    v: np.ndarray
    s: np.ndarray
    F: np.ndarray
    dt: float

    def part(self, rows: slice) -> Part:
        return Part(self.a[rows], self.v[rows], self.s[rows], self.F[rows], self.dt)

    def __post_init__(self) -> None:
        self.x, self.xdot = self.s.cumsum(axis=1), self.v.cumsum(axis=1)

    @property
    def X(self) -> np.ndarray:
        return np.hstack([self.a, self.v, self.s])

    @property
    def n_dof(self) -> int:
        return self.a.shape[1]

    @property
    def forced(self) -> np.ndarray:
        return np.flatnonzero(self.F.any(axis=0))


@dataclass
class Ruler:
    """What every row is judged by: masses, true storey forces on the held-out part,
    their rms.
    """

    model: ChainModel
    known: bool
    R: np.ndarray
    size: np.ndarray

    def force_error(self, R: np.ndarray) -> float:
        share = np.sqrt(np.mean((R - self.R) ** 2, axis=0)) / self.size
        return float(100 * np.sqrt(np.mean(share**2)))

    def balance_error(self, masses: np.ndarray, a_hat: np.ndarray, rest: Part) -> float:
        columns = masses * (a_hat - rest.a), rest.F, masses * rest.a
        residual, force, inertia = (
            np.sqrt(np.mean(y**2, axis=0)).tolist() for y in columns
        )
        sizes = zip(residual, force, inertia, self.size.tolist())
        return pooled_percent(
            Sizes(r, f or i, size, "F" if f else "m a", len(rest.a))
            for r, f, i, size in sizes
        )


def shares(kept: set, true: set) -> tuple[float, float]:
    """Precision and recall of the terms kept."""
    right = len(kept & true)
    return right / len(kept) if kept else np.nan, right / len(true) if true else np.nan


_DIVERGED = 1e3


class PlainSINDy:
    """``ps.SINDy`` on state [x | xdot], u = F."""

    finds_masses = False
    targets_of_one = False  # targets divided by their norm

    def __init__(self, degree: int, normalise: bool = True) -> None:
        self.degree, self.normalise = degree, normalise

    def n_features(self, data: Part) -> int:
        return math.comb(2 * data.n_dof + len(data.forced) + self.degree, self.degree)

    def work(self, data: Part) -> float:
        """Multiplications of a fit: a few passes of every target over the normal
        equations.
        """
        return 10.0 * data.n_dof * len(data.a) * self.n_features(data) ** 2

    def state(self, data: Part) -> np.ndarray:
        return np.hstack([data.x, data.xdot])

    def rate(self, data: Part) -> np.ndarray:
        return np.hstack([data.xdot, data.a])

    def library(self, data: Part) -> Any:
        return ps.PolynomialLibrary(self.degree)

    def optimizer(self) -> Any:
        return ps.STLSQ(normalize_columns=self.normalise)

    def fit(self, data: Part) -> None:
        self.forced = (
            data.forced
        )  # a force that is zero throughout would be 0/0 when normalised
        model = ps.SINDy(optimizer=self.optimizer(), feature_library=self.library(data))
        rate = self.rate(data)
        self.size = (
            np.linalg.norm(rate, axis=0)
            if self.targets_of_one
            else np.ones(rate.shape[1])
        )
        self.model = model.fit(
            self.state(data),
            t=data.dt,
            x_dot=rate / self.size,
            u=data.F[:, self.forced],
        )
        # of the accelerations: that the rate of a position is a velocity is no term
        # found
        self.coefficients = (
            np.asarray(self.model.coefficients()) * self.size[:, None]
        )[-data.n_dof :]
        self.names = self.model.get_feature_names()

    @property
    def kept(self) -> set[int]:
        """Features that stand in the acceleration of any DOF."""
        return set(np.flatnonzero(self.coefficients.any(axis=0)).tolist())

    @property
    def terms(self) -> int:
        return len(self.kept)

    def linear(self, prefix: str) -> np.ndarray:
        """Coefficients of the terms x0.. or u0.. in the accelerations."""
        column = {name: i for i, name in enumerate(self.names)}
        count = sum(
            1 for name in self.names if name[:1] == prefix and name[1:].isdigit()
        )
        return self.coefficients[:, [column[f"{prefix}{i}"] for i in range(count)]]

    def stiffness(self, n: int) -> np.ndarray:
        """d a / d x of the linear terms."""
        return self.linear("x")[:, :n]

    def masses(self, data: Part) -> np.ndarray:
        """1/m is the coefficient of the force on the DOF; NaN where none acts, or its
        term was dropped.
        """
        found = np.full(data.n_dof, np.nan)
        inverse = self.linear("u")[self.forced, np.arange(len(self.forced))]
        found[self.forced] = np.divide(
            1.0, inverse, out=np.full(len(inverse), np.nan), where=inverse != 0
        )
        return found

    def predict(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.asarray(self.model.predict(state, u=u)) * self.size

    def accelerations(self, data: Part) -> np.ndarray:
        return self.predict(self.state(data), data.F[:, self.forced])[:, -data.n_dof :]

    derivative = predict

    def hits(self, data: Part, truth: ChainModel) -> tuple[float, float]:
        """The true terms are those of an exact fit of the true accelerations at random
        points.
        """
        rng = np.random.default_rng(0)
        size = 3 * self.n_features(data)
        v, s, F = (
            rng.standard_normal((size, y.shape[1])) * y.std(axis=0)
            for y in (data.v, data.s, data.F)
        )
        R = truth.restoring_force(np.hstack([np.zeros_like(s), v, s]))
        a = (F - R + np.hstack([R[:, 1:], np.zeros((size, 1))])) / truth.masses
        points = Part(a, v, s, F, data.dt)
        features = np.asarray(
            self.model.feature_library.transform(
                np.hstack([self.state(points), F[:, self.forced]])
            )
        )
        scale = np.sqrt(np.mean(features**2, axis=0))
        target = a / np.sqrt(np.mean(a**2, axis=0))
        exact, *_ = np.linalg.lstsq(features / scale, target, rcond=None)
        if np.abs(features / scale @ exact - target).max() > 1e-6:
            return np.nan, np.nan  # the library cannot hold the truth
        return shares(
            self.kept, set(np.flatnonzero((np.abs(exact) > 1e-7).any(axis=1)).tolist())
        )

    def third_law(self, masses: np.ndarray) -> tuple[float, str]:
        """Stiffness of each storey from the balance above it and from the one below."""
        n = len(masses)
        if n == 1:
            return 0.0, "once"
        K = -masses[:, None] * self.stiffness(n)
        upper, lower = (
            K[np.arange(1, n), np.arange(n - 1)],
            K[np.arange(n - 1), np.arange(1, n)],
        )
        mean = 0.5 * (np.abs(upper) + np.abs(lower))
        return (
            float(np.max(100 * np.abs(upper - lower) / mean)) if mean.all() else np.nan
        ), "twice"

    def run(self, data: Part, deadline: float) -> np.ndarray:
        """The model alone, with the forces linear between samples."""
        y, u, t = (
            self.state(data),
            data.F[:, self.forced],
            data.dt * np.arange(len(data.a)),
        )
        force, limit = make_interp_spline(t, u, k=1), _DIVERGED * np.abs(y).max(axis=0)

        def rate(time_: float, state: np.ndarray) -> np.ndarray:
            if time.perf_counter() > deadline:
                raise TimeoutError
            if not (np.abs(state) <= limit).all():
                raise OverflowError
            return self.derivative(state[None], force(time_)[None])[0]

        found = solve_ivp(rate, (0.0, t[-1]), y[0], t_eval=t, max_step=data.dt)
        if not found.success:
            raise OverflowError
        return found.y.T[:, : data.n_dof]


_HAND_THRESHOLD = 0.01  # of an acceleration's norm
# enough for the conditioning of a chain's columns; PySINDy's 0.05 outweighs normalised
# columns
_HAND_RIDGE = 1e-8


class HandSteeredSINDy(PlainSINDy):
    """``ps.SINDy`` as one who knows both would use it: accelerations from the terms of
    each storey by itself.
    """

    targets_of_one = True

    def n_features(self, data: Part) -> int:
        return data.n_dof * (math.comb(2 + self.degree, 2) - 1) + len(data.forced)

    def state(self, data: Part) -> np.ndarray:
        return np.hstack([data.s, data.v])

    def rate(self, data: Part) -> np.ndarray:
        return data.a

    def derivative(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        a = self.predict(state, u)
        return np.hstack([state[:, a.shape[1] :], np.diff(a, axis=1, prepend=0.0)])

    def library(self, data: Part) -> Any:
        n, m = data.n_dof, len(data.forced)
        storeys = [[j, n + j] for j in range(n)]
        return ps.GeneralizedLibrary(
            [ps.PolynomialLibrary(self.degree, include_bias=False) for _ in storeys]
            + [ps.PolynomialLibrary(1, include_bias=False)],
            inputs_per_library=[*storeys, list(range(2 * n, 2 * n + m))],
        )

    def optimizer(self) -> Any:
        return ps.STLSQ(
            threshold=_HAND_THRESHOLD, alpha=_HAND_RIDGE, normalize_columns=True
        )

    def stiffness(self, n: int) -> np.ndarray:
        inter_storey = self.linear("x")[:, :n]  # d a / d s
        return inter_storey - np.hstack([inter_storey[:, 1:], np.zeros((n, 1))])

    def run(self, data: Part, deadline: float) -> np.ndarray:
        return super().run(data, deadline).cumsum(axis=1)


class Ours:
    """NRFRegressor with some optimizer, or with the terms that the held-out rule leaves
    ("select").
    """

    finds_masses = True

    def __init__(self, degree: int, optimizer: Any, estimation: str = "ls") -> None:
        self.degree, self.optimizer, self.estimation = degree, optimizer, estimation

    def fit(self, data: Part) -> None:
        if isinstance(self.optimizer, str):
            model = select_sparsity(
                data.X, data.F, degree=self.degree, dt=data.dt
            ).regressor()
        else:
            model = NRFRegressor(
                self.degree,
                optimizer=self.optimizer,
                estimation=self.estimation,
                dt=data.dt,
            )
        self.model: Any = model.fit(data.X, data.F)

    @property
    def terms(self) -> int:
        laws = sum(
            int(np.count_nonzero(R.coefficients))
            for R in self.model.restoring_forces_.values()
        )
        return len(self.model.masses_) + laws

    def masses(self, data: Part) -> np.ndarray:
        return self.model.masses_

    def accelerations(self, data: Part) -> np.ndarray:
        return data.a + (data.F - self.model.predict(data.X)) / self.model.masses_

    def hits(self, data: Part, truth: ChainModel) -> tuple[float, float]:
        def kept(forces: Any) -> set[tuple[str, str]]:
            return {
                (str(site), label)
                for site, R in forces.items()
                for label, c in R.coefficients.items()
                if c
            }

        return shares(kept(self.model.restoring_forces_), kept(truth.restoring_forces))

    def third_law(self, masses: np.ndarray) -> tuple[float, str]:
        gap = self.model.third_law_gap_
        return (float(gap.max()), "twice") if len(gap) else (0.0, "once")

    def run(self, data: Part, deadline: float) -> np.ndarray:
        return self.model.simulate(data.F, x0=data.x[0], v0=data.xdot[0]).displacement


def compare_with_sindy(
    X: Any,
    F: Any = None,
    dt: float | None = None,
    *,
    truth: ChainModel | None = None,
    degree: int = 3,
    optimizers: Mapping[str, Any] | str | None = None,
    heldout: float = 0.3,
    free_run: int = 500,
    time_limit: float = 10.0,
    coordinates: str = "relative",
) -> pd.DataFrame:
    """Fit plain SINDy and this package to the first part of a record and judge them on
    the rest.

    Parameters
    ----------
    X : array-like of shape (n_samples, 3 n_dof), DataFrame or Record
        As for :meth:`NRFRegressor.fit`: one contiguous record, base at rest.
    F : array-like of shape (n_samples, n_dof)
        Applied forces, N.
    dt : float
        Sampling step, s; not needed with a Record or a time index.
    truth : ChainModel, optional
        The structure, if it is known (a simulation): gives ``precision``, ``recall``,
        ``mass_error`` and ``restoring_force_error``.
    degree : int
        Of the power series everywhere.
    optimizers : mapping of str to PySINDy optimizer, or "select", optional
        Rows of this package beside least squares; ``"select"`` has one with the terms
        that :func:`~pysindy_nrf.selection.select_sparsity` leaves, chosen within the
        first part of the record. STLSQ at PySINDy's default threshold (a tenth of each
        balance's force) and at a hundredth if None.
    heldout : float
        Share of the record at its end on which all errors are measured.
    free_run : int
        Most samples of the free run; PySINDy takes 2 to 30 ms for each.
    time_limit : float
        Seconds after which a free run through PySINDy is given up.
    coordinates : {"relative", "absolute"}
        See :class:`NRFRegressor`.

    Returns
    -------
    DataFrame
        One row for each model:

        * ``SINDy, defaults``: state [x, xdot], u = F, ``PolynomialLibrary(degree)``,
          default STLSQ;
        * ``SINDy, normalised``: the same with ``normalize_columns=True``;
        * ``SINDy, hand-steered``: SINDy at its best: the accelerations alone from terms
          of each storey by itself and the forces that act, columns and targets of norm
          one, threshold 0.01, ridge 1e-8;
        * ``pysindy_nrf, ...``: least squares, instrumental variables and the optimizers
          given.

        Columns: ``terms`` found (each counted once, in however many accelerations it
        stands; rows that say that the rate of a position is a velocity do not count),
        ``precision`` and ``recall`` (shares) of the true terms in each model's own
        library; ``mass_error`` (largest, percent); ``restoring_force_error``, where
        SINDy is given the masses, and ``force_error_own_masses``, where it finds them
        as 1/m (NaN where a DOF is not forced); ``balance_error`` (pooled percent NRMSE,
        one step, as the two before); ``free_run_error`` (percent NRMSE of the
        displacements, inf if it diverges); ``third_law_gap`` (largest disagreement of
        the two estimates of a storey, percent) and ``storeys_found`` (``"once"`` or
        ``"twice"``); ``seconds`` of the fit, choosing included; ``note``. NaN = cannot
        be known. ``attrs["storey_forces"]`` holds the storey forces (N) that each model
        finds on the rest of the record, by its name, and the true ones.

    Raises
    ------
    ChannelError
        If the record has several parts or no sampling step.
    NRFError
        If ``optimizers`` is another word.

    Notes
    -----
    SINDy finds accelerations, not forces. To give it a restoring force, and balance
    errors in N, it is handed the masses: the true ones, or those of this package's
    least squares. All rows see the same measured accelerations.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, excitation, laws, simulate
    >>> from pysindy_nrf.sindy.comparison import compare_with_sindy
    >>> truth = ChainModel(
    ...     [10.0, 10.0], {i: laws.PowerSeries(1, [100.0, 1e5]) for i in (1, 2)}
    ... )
    >>> F = excitation.band_limited_random(
    ...     2,
    ...     1.0,
    ...     1000.0,
    ...     excited=[1, 2],
    ...     rms=50.0,
    ...     band=(1, 60),
    ...     random_state=0,
    ... )
    >>> table = compare_with_sindy(
    ...     simulate(truth, F, 1e-3), truth=truth, free_run=2
    ... )
    >>> bool(
    ...     table.loc["pysindy_nrf, STLSQ", "terms"]
    ...     < table.loc["SINDy, normalised", "terms"]
    ... )
    True
    """
    data = from_arrays(X, F, coordinates=coordinates, dt=dt)
    if len(data.segments) != 1 or data.segments[0].ag is not None:
        raise ChannelError(
            "The comparison takes one contiguous record on a base at rest",
            "Choose one record.",
        )
    segment = data.segments[0]
    step = segment.dt
    if step is None:
        raise ChannelError("The comparison needs the sampling step", "Pass dt= in s.")
    if not 0 < heldout < 1:
        raise ChannelError(
            f"heldout={heldout!r} is not a share", "Give a number between 0 and 1."
        )
    a, v, s, force = (
        getattr(segment, k)[segment.valid].astype(float) for k in ("a", "v", "s", "F")
    )
    whole = Part(a, v, s, force, step)
    if np.isnan(whole.F).any():
        raise ChannelError(
            "A force is unknown", "SINDy needs every force: give zeros where none acts."
        )
    cut = round(len(whole.a) * (1 - heldout))
    search, rest = whole.part(slice(0, cut)), whole.part(slice(cut, None))
    given: Any = {"terms selected": "select"} if optimizers == "select" else optimizers
    if given is None:
        given = {"STLSQ": ps.STLSQ(), "STLSQ, threshold 0.01": ps.STLSQ(threshold=0.01)}
    if isinstance(given, str):
        raise NRFError(
            f"optimizers={given!r} is unknown", "Give 'select', or optimizers by name."
        )
    entries: dict[str, Any] = {
        "SINDy, defaults": PlainSINDy(degree, normalise=False),
        "SINDy, normalised": PlainSINDy(degree),
        "SINDy, hand-steered": HandSteeredSINDy(degree),
        "pysindy_nrf, least squares": Ours(degree, None),
        "pysindy_nrf, instrumental variables": Ours(degree, None, "iv"),
        **{
            f"pysindy_nrf, {name}": Ours(degree, optimizer)
            for name, optimizer in given.items()
        },
    }
    with warnings.catch_warnings(action="ignore"):
        reference = Ours(degree, None)
        reference.fit(search)
        model = reference.model.model_ if truth is None else truth
        R = model.restoring_force(whole.X, dt=whole.dt)[cut:]
        ruler = Ruler(model, truth is not None, R, np.sqrt(np.mean(R**2, axis=0)))
        found = {
            name: row_of(entry, search, rest, ruler, free_run, time_limit)
            for name, entry in entries.items()
        }
    table = pd.DataFrame(
        [line for line, _ in found.values()], pd.Index(found, name="model"), COLUMNS
    )
    forces = {name: R for name, (_, R) in found.items() if R is not None}
    table.attrs["storey_forces"] = _Forces(
        {"truth": ruler.R, **forces} if ruler.known else forces
    )
    return table


class _Forces(dict[str, np.ndarray]):
    """Storey forces by model. Tables that are joined compare what they carry: these are
    equal to themselves alone.
    """

    __eq__ = object.__eq__
    __hash__ = object.__hash__  # type: ignore[assignment]


COLUMNS = [
    "terms",
    "precision",
    "recall",
    "mass_error",
    "restoring_force_error",
    "force_error_own_masses",
    "balance_error",
    "free_run_error",
    "third_law_gap",
    "storeys_found",
    "seconds",
    "note",
]
_MOST_WORK = 2e11  # multiplications of a fit, some ten seconds


def row_of(
    entry: Any, search: Part, rest: Part, ruler: Ruler, free_run: int, time_limit: float
) -> tuple[list[Any], np.ndarray | None]:
    """The row of one model (see ``COLUMNS``), and the storey forces (N) it finds on the
    held-out part.
    """
    if not entry.finds_masses and entry.work(search) > _MOST_WORK:
        size = entry.n_features(search)
        gigabytes = 32e-9 * size * (len(search.a) + size)
        note = (
            f"not run: {size} columns of {len(search.a)} samples take minutes and"
            f" {gigabytes:.1f} GB"
        )
        return [np.nan] * 9 + ["", np.nan, note], None
    start = time.perf_counter()
    try:
        entry.fit(search)
    except NRFError as error:
        return [np.nan] * 9 + ["", np.nan, f"no fit: {error}"], None
    seconds = time.perf_counter() - start
    masses = entry.masses(search)
    handed = masses if entry.finds_masses else ruler.model.masses
    a_hat = entry.accelerations(rest)
    R, own = (
        np.cumsum((rest.F - m * a_hat)[:, ::-1], axis=1)[:, ::-1]
        for m in (handed, masses)
    )
    hits = (
        entry.hits(search, ruler.model)
        if ruler.known and not ruler.model.has_memory
        else (np.nan, np.nan)
    )
    run, note = _free_run(entry, rest.part(slice(0, max(2, free_run))), time_limit)
    return [
        entry.terms,
        *hits,
        (
            float(np.max(np.abs(100 * (masses / ruler.model.masses - 1))))
            if ruler.known
            else np.nan
        ),
        ruler.force_error(R) if ruler.known else np.nan,
        ruler.force_error(own) if ruler.known else np.nan,
        ruler.balance_error(handed, a_hat, rest),
        run,
        *entry.third_law(ruler.model.masses),
        seconds,
        note,
    ], R


def _free_run(entry: Any, rest: Part, time_limit: float) -> tuple[float, str]:
    try:
        x = entry.run(rest, time.perf_counter() + time_limit)
    except TimeoutError:
        return np.nan, f"free run given up after {time_limit:g} s"
    except (SimulationError, OverflowError, FloatingPointError):
        x = np.full(1, np.nan)
    if not np.isfinite(x).all():
        return np.inf, "free run diverges"
    share = [nrmse(rest.x[:, j], x[:, j]) for j in range(rest.n_dof)]
    return float(np.sqrt(np.mean(np.square(share)))), ""
