"""Free runs of chain models: simulate and free_run, the checks of their input, the
channels as sensors show them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from ..chain.sites import Site
from ..common import number_of, positive
from ..exceptions import ChannelError, SimulationError
from ..laws.base import ForceLaw
from ..laws.sensor import SensorFault
from ..records.channels import as_matrix, rows_text
from ..records.record import OF_LETTER, Record
from . import system as flat
from .integrators import CRAWLS, PATIENCE, Rule, newmark, rule_of, runge_kutta

METHODS = ("default", "newmark")
CLASSICAL = "classical"  # the rule of classical_run


@dataclass
class FreeRun:
    """A free run with what happened inside."""

    record: Record
    states: dict[
        tuple[Site, int], np.ndarray
    ]  # by (site, number of the law there), (n_samples, n_states)
    # J by time: input (forces and base), kinetic, work on each site; input = change of
    # the rest
    energy: pd.DataFrame
    quality: dict[str, int] = field(
        default_factory=dict
    )  # steps: number, rejected, forced (too large an error)

    @property
    def energy_gap(self) -> float:
        """Largest violation of the energy balance as a share of the largest energy."""
        e = self.energy
        gap = (
            e["input"]
            - (e["kinetic"] - e["kinetic"].iloc[0])
            - e.iloc[:, 2:].sum(axis=1)
        )
        return float(
            gap.abs().max() / max(e.abs().to_numpy().max(), np.finfo(float).tiny)
        )


def simulate(
    model: Any,
    F: Any,
    dt: float,
    *,
    method: str = "default",
    x0: Any = None,
    v0: Any = None,
    base_acceleration: Any = None,
    covariates: Mapping[str, Any] | None = None,
    hold: str = "linear",
    rtol: float = 1e-10,
    t0: float = 0.0,
    name: str = "simulation",
    limit: float = 1e100,
) -> Record:
    r"""Free run of a chain model under sampled forces.

    .. math:: m_j a_j + R_j - R_{j+1} = F_j

    Parameters
    ----------
    model : ChainModel
        Anything with ``chain``, ``masses`` and ``laws``.
    F : array-like of shape (n_samples, n_dof), or None
        Applied forces, N; None if only the base moves.
    dt : float
        Sampling step, s.
    method : {"default", "newmark"}
        ``"default"``: Dormand-Prince of order 8 with error control and sub-steps inside
        each sample interval. ``"newmark"``: the paper's average-acceleration
        Newmark-beta scheme (beta = 1/4, gamma = 1/2) with Newton iterations, one step
        for each sample; second order.
    x0, v0 : array-like of shape (n_dof,), optional
        Initial displacement (m) and velocity (m/s) relative to the base; zero if None.
    base_acceleration : array-like of shape (n_samples,), optional
        m/s^2.
    covariates : mapping of str to array-like of shape (n_samples,), optional
        Channels that the laws read.
    hold : {"linear", "zero", "cubic"}
        Course of forces, base acceleration and covariates between the samples: straight
        lines, steps, or a cubic spline (for band-limited signals). With straight lines
        and steps, accelerations above a tenth of the sampling rate contradict the
        displacements by some percent, and a fit of the fused record finds masses as
        much too high.
    rtol : float
        Error of a step of the default method as a share of the largest motion so far.
    t0 : float
        Time of the first sample, s, on the clock of the data that the model was fitted
        to, for laws that know the time.
    name : str
        Name of the record.
    limit : float
        Displacement, m, beyond which the default method calls the run divergent.

    Returns
    -------
    Record
        On the clock of F, its first row the initial condition: force, absolute
        acceleration, velocity and displacement relative to the base. The accelerations
        follow from the balance at the samples, so that the record closes it to
        round-off.

    Raises
    ------
    ChannelError
        If a channel has the wrong shape or is not finite.
    SimulationError
        If the method is unknown, or the run diverges; the message says when and where.

    Notes
    -----
    Laws with memory are moved by their own ``advance`` along the path. Reversals at
    their sites, and at sites whose force jumps where the rate changes sign (Coulomb
    friction), are located and the step is split there. A site with such a jump sticks
    while its friction can hold it (Filippov's solution): its rate is then exactly zero,
    and its force is what equilibrium asks for.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws, simulate
    >>> model = ChainModel([10.0], {1: laws.LinearElastic(1e3)})
    >>> rec = simulate(model, np.zeros((101, 1)), dt=0.01, x0=[1e-3])
    >>> bool(
    ...     np.allclose(
    ...         rec.displacement[:, 0], 1e-3 * np.cos(10 * rec.time), atol=1e-11
    ...     )
    ... )
    True
    """
    run = _run(
        model,
        F,
        dt,
        _known(method),
        x0,
        v0,
        base_acceleration,
        covariates,
        hold,
        rtol,
        t0,
        limit,
    )
    return as_read(run.record(name), model.laws)


def classical_run(model: Any, F: Any, dt: float, **options: Any) -> Record:
    """Free run by one classical Runge-Kutta step of order 4 a sample, for fits that
    repeat it; options of simulate.
    """
    return as_read(
        _run(model, F, dt, CLASSICAL, **({"rtol": 1.0} | options)).record("simulation"),
        model.laws,
    )


def free_run(model: Any, F: Any, dt: float, **options: Any) -> FreeRun:
    """Free run with internal states, energies and the quality of the integration."""
    name, method = options.pop("name", "simulation"), options.pop("method", "default")
    run = _run(model, F, dt, _known(method), **options)
    out = run.out
    kinetic = 0.5 * (out.v**2) @ run.masses
    times = pd.Index(run.t0 + np.arange(len(kinetic)) * dt, name="t")
    names = ["input", "kinetic", *map(str, run.layout.sites)]
    energy = pd.DataFrame(
        np.column_stack([out.work[:, 0], kinetic, out.work[:, 1:]]), times, names
    )
    states = {key: out.z[:, part] for key, part in run.layout.states.items()}
    return FreeRun(run.record(name), states, energy, run.quality)


def linear_run(
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray],
    F: np.ndarray,
    dt: float,
    start: np.ndarray,
    base_acceleration: Any = None,
    hold: str = "linear",
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Motion x, v (relative), a (absolute) of a linear structure from (x0, v0), exact;
    None if modes coincide.
    """
    M, C, K = matrices
    n, base = (
        len(M),
        (np.zeros(len(F)) if base_acceleration is None else base_acceleration),
    )
    A = np.vstack([np.eye(2 * n)[n:], -np.linalg.solve(M, np.hstack([K, C]))])
    if not np.isfinite(A).all():
        return None
    values, vectors = np.linalg.eig(A)
    if not np.linalg.cond(vectors) < 1e10 or (values.real * dt * len(F) > 200).any():
        return None
    back = np.linalg.inv(vectors)
    half = values.imag >= 0  # the others are conjugate
    values, vectors, back = (
        values[half],
        vectors[:, half] * np.where(values[half].imag > 0, 2.0, 1.0),
        back[half],
    )
    inputs = np.vstack(
        [np.zeros((n, n + 1)), np.hstack([np.linalg.inv(M), -np.ones((n, 1))])]
    )
    courses = polynomials(np.column_stack([F, base]), hold)
    at, weights = np.polynomial.legendre.leggauss(12)
    at, weights = 0.5 + 0.5 * at, 0.5 * weights * dt
    grown = np.exp(np.outer(values, (1 - at) * dt)) * weights
    drive = sum(
        (back @ inputs * (grown @ at**d)[:, None]) @ part.T
        for d, part in enumerate(courses)
    )
    drive = np.column_stack([back @ start.ravel(), drive])
    modal = np.array(
        [
            lfilter([1.0], [1.0, -np.exp(value * dt)], line)
            for value, line in zip(values, drive)
        ]
    )
    x, v = np.split((vectors @ modal).real, 2)
    return x.T, v.T, np.linalg.solve(M, F.T - C @ v - K @ x).T


@dataclass
class _Run:
    """A finished run as arrays."""

    samples: np.ndarray
    dt: float
    masses: np.ndarray
    layout: Any
    out: Any
    base_moves: bool
    covariates: Mapping[str, Any] | None
    quality: dict[str, int]
    t0: float

    def record(self, name: str) -> Record:
        """The motion as a Record."""
        n = len(self.masses)
        record = Record(
            force=self.samples[:, :n].copy(),
            acceleration=self.out.a,
            velocity=self.out.v,
            displacement=self.out.x,
            fs=1.0 / self.dt,
            base_acceleration=self.samples[:, n].copy() if self.base_moves else None,
            covariates=self.covariates,
            name=name,
        )
        record.t0 = self.t0
        return record


def _run(
    model: Any,
    F: Any,
    dt: Any,
    method: str,
    x0: Any = None,
    v0: Any = None,
    base_acceleration: Any = None,
    covariates: Any = None,
    hold: str = "linear",
    rtol: Any = 1e-10,
    t0: Any = 0.0,
    limit: float = 1e100,
) -> _Run:
    """Check the arguments, flatten the model and march."""
    dt = positive("dt", dt, "Give the sampling step in s.", SimulationError)
    rtol = positive(
        "rtol", rtol, "Give a small positive number, e.g. 1e-10.", SimulationError
    )
    limit = positive("limit", limit, "Give a displacement in m.", SimulationError)
    start = number_of(t0)
    if not np.isfinite(start):
        raise SimulationError(
            f"t0={t0!r} is not a number", "Give the time of the first sample in s."
        )
    n = len(model.masses)
    if F is None and base_acceleration is None:
        raise ChannelError(
            "Nothing drives the free run", "Give forces F, or base_acceleration=."
        )
    force = (
        np.zeros((len(base_acceleration), n))
        if F is None
        else finite(F, "F", n, "force")
    )
    if len(force) < 2:
        raise ChannelError(
            f"The force has {len(force)} samples", "At least two are needed."
        )
    x, v = initial(x0, "x", n, "displacement"), initial(v0, "v", n, "velocity")

    system, layout = flat.flatten(model, start)
    samples = input_matrix(force, base_acceleration, covariates, layout.covariates)
    rows, n_inputs = samples.shape
    out = flat.Output(
        *(np.empty((rows, k)) for k in (n, n, n, system.n_states, system.n_sites + 1))
    )
    z, w = np.zeros(system.n_states), flat.work_arrays(system)
    if method == "newmark":
        drive = flat.Drive(samples, samples, 0, rows - 1, n_inputs, dt)
        ended = newmark(
            system,
            drive,
            flat.stages(1, system, n_inputs, np.zeros(system.n_sites)),
            w,
            x,
            v,
            z,
            out,
        )
    else:
        courses = polynomials(samples, hold)
        drive = flat.Drive(courses, samples, len(courses) - 1, rows - 1, n_inputs, dt)
        tables = rule_of(method)
        rule = Rule._make([*tables, len(tables[1]), rtol, max(rtol, 1e-8), limit])
        jump = flat.jumps(
            model, layout, np.abs(samples[:, n + 1 :]).max(axis=0, initial=0.0)
        )
        k = flat.stages(rule.stages, system, n_inputs, jump)
        smallest, general = (
            dt / 1024,
            bool(k.watch.any() or system.laws[:, flat.INERTIA].any()) or None,
        )
        ended = runge_kutta(
            system,
            drive,
            rule,
            k,
            w,
            x,
            v,
            z,
            method == "default",
            smallest,
            out,
            general,
        )
    why, interval, dof, steps, rejected, forced = ended
    if why == CRAWLS:
        what = (
            f"Up to {interval * dt:.6g} s the free run took more than {PATIENCE} steps"
            " a sample: a law is far "
        )
        what += "stiffer than the sampling, or two laws at one site make it chatter"
        cure = (
            "Use method='newmark', a shorter dt, or one law instead of two at a site"
            " that sticks."
        )
        raise SimulationError(what, cure)
    if why:
        cure = (
            "The model is unstable there (a softening or negative term beyond the range"
            " it was fitted in), or dt "
        )
        cure += "is too long for its stiffness: lower the force, the degree or dt."
        raise SimulationError(
            f"The free run diverges at {interval * dt:.6g} s, at DOF {dof + 1}", cure
        )
    quality = {"steps": int(steps), "rejected": int(rejected), "forced": int(forced)}
    return _Run(
        samples,
        dt,
        system.masses,
        layout,
        out,
        base_acceleration is not None,
        covariates,
        quality,
        start,
    )


def _known(method: str) -> str:
    """The method, or an error that names those that exist."""
    if method not in METHODS:
        raise SimulationError(
            f"method={method!r} is unknown",
            f"Choose {' or '.join(map(repr, METHODS))}.",
        )
    return method


def finite(value: Any, names: Any, n_columns: int, what: str) -> np.ndarray:
    """A matrix of finite numbers, or an error that names channel and rows."""
    array = as_matrix(value, names, n_columns, what).astype(float)
    for j in range(n_columns):
        bad = np.flatnonzero(~np.isfinite(array[:, j]))
        if bad.size:
            name = f"{names}{j + 1}" if isinstance(names, str) else names[j]
            cure = "Give a number for every sample."
            raise ChannelError(
                f"Channel {name} of the {what} is not finite in {rows_text(bad)}", cure
            )
    return array


def initial(value: Any, prefix: str, n_dof: int, what: str) -> np.ndarray:
    """An initial condition of every DOF."""
    if value is None:
        return np.zeros(n_dof)
    array = np.asarray(value)
    if array.shape != (n_dof,):
        cure = f"Give one initial {what} for each DOF."
        raise ChannelError(
            f"{prefix}0 has shape {array.shape}, ({n_dof},) is needed", cure
        )
    return finite(array[None, :], prefix, n_dof, f"initial {what}")[0]


def input_matrix(
    force: np.ndarray,
    base_acceleration: Any,
    covariates: Mapping[str, Any] | None,
    names: tuple[str, ...],
) -> np.ndarray:
    """Forces, base acceleration and the covariates that the laws read, side by side."""
    n = len(force)
    given, columns = dict(covariates or {}), []
    for name in names:
        if name not in given:
            cure = f"Pass covariates={{{name!r}: ...}}."
            raise ChannelError(
                f"The laws of the model read the covariate {name!r}, which is not"
                " given",
                cure,
            )
    base = np.zeros(n) if base_acceleration is None else base_acceleration
    for name, line in [("ag", base), *((name, given[name]) for name in names)]:
        column = finite(line, [name], 1, "input")[:, 0]
        if len(column) != n:
            raise ChannelError(
                f"{name} has {len(column)} samples, the force {n}",
                "Cut or resample them to one clock.",
            )
        columns.append(column)
    return np.ascontiguousarray(
        np.column_stack([force, *columns])
    )  # one layout: compiled once


def polynomials(samples: np.ndarray, hold: str) -> np.ndarray:
    """Coefficients of the inputs between samples, in powers of the share of the
    interval.
    """
    if hold == "linear":
        return np.stack([samples[:-1], np.diff(samples, axis=0)])
    if hold == "zero":
        return samples[None, :-1].copy()
    if hold == "cubic":
        return np.ascontiguousarray(
            CubicSpline(np.arange(len(samples)), samples).c[::-1]
        )
    raise ChannelError(f"hold={hold!r} is unknown", "Choose 'linear', 'zero', 'cubic'.")


def as_read(record: Record, laws: Mapping[Site, Sequence[ForceLaw]]) -> Record:
    """A true record as the sensors of a model show it."""
    for site, group in laws.items():
        for law in group if site.kind == "sensor" else ():
            if isinstance(law, SensorFault):
                record = _changed(record, site, law.reading)
    return record


def as_true(record: Record, site: Site, law: SensorFault) -> Record:
    """A record with one channel freed of a fault."""
    return _changed(record, site, law.corrected)


def _changed(
    record: Record, site: Site, change: Callable[[np.ndarray, float], np.ndarray]
) -> Record:
    """A record with one channel passed through a function of its values and dt."""
    kind, number = site.channel[:1], site.channel[1:]
    if (
        kind not in OF_LETTER
        or not number.isdigit()
        or not 1 <= int(number) <= record.n_dof
    ):
        cure = f"Its channels are {', '.join(record.channels())}."
        raise ChannelError(
            f"{str(site)!r} is not a channel of record {record.name!r}", cure
        )
    values = getattr(record, OF_LETTER[kind])
    if values is None:
        return record
    values, j = np.array(values, dtype=float), int(number) - 1
    if np.nan_to_num(values[:, j]).any():
        values[:, j] = change(values[:, j], record.dt)
    return record.replace(**{OF_LETTER[kind]: values})
