"""Free runs of chain models under sampled forces."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypedDict, Unpack

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..common import number_of, positive
from ..exceptions import SimulationError
from ..records.hold import BAND_LIMITED
from ..records.record import Record
from . import newmark, runge_kutta
from .balance import Drive, Output
from .inputs import (
    LawStates,
    courses_between,
    force_matrix,
    initial_motion,
    initial_states,
    input_matrix,
)
from .linear import linear_run as linear_run
from .outcome import Outcome, StepCounts
from .sensors import as_read
from .sensors import as_true as as_true
from .system import Layout, System, flatten, jumping_sites

METHODS = ("default", "newmark")
Method = Literal["default", "newmark", "classical"]


@dataclass(frozen=True)
class FreeRun:
    """A free run with what happened inside.

    Attributes
    ----------
    record : Record
    states : dict
        Internal states of the laws with memory, (n_samples, n_states), by the site and
        the number of the law there.
    energy : DataFrame
        J by time: of the input (forces and base), kinetic, and the work on each site.
        The input is the change of all others.
    quality : StepCounts
    """

    record: Record
    states: dict[tuple[Site, int], np.ndarray]
    energy: pd.DataFrame
    quality: StepCounts

    @property
    def energy_gap(self) -> float:
        """Largest violation of the energy balance, by the largest energy."""
        energy = self.energy
        kinetic = energy["kinetic"] - energy["kinetic"].iloc[0]
        gap = energy["input"] - kinetic - energy.iloc[:, 2:].sum(axis=1)
        largest = energy.abs().to_numpy().max()
        return float(gap.abs().max() / max(largest, np.finfo(float).tiny))


class RunOptions(TypedDict, total=False):
    """Options of a free run, see :func:`simulate`."""

    x0: npt.ArrayLike | None
    v0: npt.ArrayLike | None
    states: LawStates | None
    base_acceleration: npt.ArrayLike | None
    covariates: Mapping[str, npt.ArrayLike] | None
    courses: Mapping[str, npt.ArrayLike] | None
    hold: str
    rtol: float
    t0: float
    limit: float


@dataclass(frozen=True, kw_only=True)
class _Options:
    """The options with their defaults."""

    x0: npt.ArrayLike | None = None
    v0: npt.ArrayLike | None = None
    states: LawStates | None = None
    base_acceleration: npt.ArrayLike | None = None
    covariates: Mapping[str, npt.ArrayLike] | None = None
    courses: Mapping[str, npt.ArrayLike] | None = None
    hold: str = BAND_LIMITED
    rtol: float = 1e-10
    t0: float = 0.0
    limit: float = 1e100

    def checked_rtol(self) -> float:
        cure = "Give a small positive number, e.g. 1e-10."
        return positive("rtol", self.rtol, cure, SimulationError)

    def checked_limit(self) -> float:
        cure = "Give a displacement in m."
        return positive("limit", self.limit, cure, SimulationError)

    def checked_t0(self) -> float:
        start = number_of(self.t0)
        if not np.isfinite(start):
            raise SimulationError(
                f"t0={self.t0!r} is not a number",
                "Give the time of the first sample in s.",
            )
        return start


@dataclass(frozen=True)
class _FinishedRun:
    """A run as arrays, with what is needed to read them."""

    samples: np.ndarray
    dt: float
    t0: float
    system: System
    layout: Layout
    out: Output
    outcome: Outcome
    options: _Options
    hold: str | None
    rotates: bool

    def record(self, name: str) -> Record:
        """The motion as a Record."""
        n = self.system.n_dof
        base_moves = self.options.base_acceleration is not None
        record = Record(
            force=self.samples[:, :n].copy(),
            acceleration=self.out.a,
            velocity=self.out.v,
            displacement=self.out.x,
            fs=1.0 / self.dt,
            base_acceleration=self.samples[:, n].copy() if base_moves else None,
            covariates=self.options.covariates,
            name=name,
            hold=self.hold,
        )
        record = record.starting_at(self.t0)
        return record.of_rotations() if self.rotates else record

    def energy(self) -> pd.DataFrame:
        """Energies by time, J."""
        kinetic = 0.5 * self.out.v**2 @ self.system.masses
        work = self.out.work
        return pd.DataFrame(
            np.column_stack([work[:, 0], kinetic, work[:, 1:]]),
            index=pd.Index(self.t0 + np.arange(len(kinetic)) * self.dt, name="t"),
            columns=["input", "kinetic", *map(str, self.layout.sites)],
        )


def simulate(
    model: ChainModel,
    F: npt.ArrayLike | None,
    dt: float,
    *,
    method: str = "default",
    x0: npt.ArrayLike | None = None,
    v0: npt.ArrayLike | None = None,
    states: LawStates | None = None,
    base_acceleration: npt.ArrayLike | None = None,
    covariates: Mapping[str, npt.ArrayLike] | None = None,
    courses: Mapping[str, npt.ArrayLike] | None = None,
    hold: str = BAND_LIMITED,
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
    states : mapping of (Site, int) to array-like, optional
        Initial internal states of laws with memory, by the site and the number of the
        law there; zero, the state of a law at rest, if not given.
    base_acceleration : array-like of shape (n_samples,), optional
        m/s^2.
    covariates : mapping of str to array-like of shape (n_samples,), optional
        Channels that the laws read.
    courses : mapping of str to array-like of shape (n_samples,), optional
        Coefficients that change while the structure moves, SI units, by the names of
        ``confidence_intervals``, such as ``"storey 1: s"``. They stand in for those of
        the model.
    hold : {"cubic", "linear", "zero"}
        Course of forces, base acceleration, covariates and coefficients between the
        samples: a cubic spline (measured channels, which are band-limited), straight
        lines, or steps (a D/A converter). With straight lines and steps, accelerations
        above a tenth of the sampling rate contradict the displacements by some percent.
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
        If the method is unknown, a course is not that of a coefficient, or the run
        diverges; the message says when and where.

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
    options = _Options(
        x0=x0,
        v0=v0,
        states=states,
        base_acceleration=base_acceleration,
        covariates=covariates,
        courses=courses,
        hold=hold,
        rtol=rtol,
        t0=t0,
        limit=limit,
    )
    run = _integrate(model, F, dt, _known(method), options)
    return as_read(run.record(name), model.laws)


def classical_run(
    model: ChainModel,
    F: npt.ArrayLike | None,
    dt: float,
    **options: Unpack[RunOptions],
) -> Record:
    """Free run by one classical Runge-Kutta step of order 4 a sample.

    For fits that repeat it; options as for :func:`simulate`.
    """
    run = _integrate(model, F, dt, "classical", _Options(**options))
    return as_read(run.record("simulation"), model.laws)


def free_run(
    model: ChainModel,
    F: npt.ArrayLike | None,
    dt: float,
    *,
    method: str = "default",
    name: str = "simulation",
    **options: Unpack[RunOptions],
) -> FreeRun:
    """Free run with internal states and energies; options of :func:`simulate`."""
    run = _integrate(model, F, dt, _known(method), _Options(**options))
    columns = run.layout.states
    states = {law: run.out.z[:, columns[law]] for law in columns}
    return FreeRun(run.record(name), states, run.energy(), run.outcome.steps)


def _known(method: str) -> Method:
    """The method, or an error that names those that exist."""
    if method not in METHODS:
        raise SimulationError(
            f"method={method!r} is unknown",
            f"Choose {' or '.join(map(repr, METHODS))}.",
        )
    return method  # type: ignore[return-value]


def _integrate(
    model: ChainModel,
    F: npt.ArrayLike | None,
    dt: float,
    method: Method,
    options: _Options,
) -> _FinishedRun:
    """Check the arguments, flatten the model and march."""
    dt = positive("dt", dt, "Give the sampling step in s.", SimulationError)
    rtol = options.checked_rtol()
    limit = options.checked_limit()
    t0 = options.checked_t0()
    n = len(model.masses)
    force = force_matrix(F, options.base_acceleration, n)
    x0 = initial_motion(options.x0, "x", n, "displacement")
    v0 = initial_motion(options.v0, "v", n, "velocity")

    courses = dict(options.courses or {})
    system, layout = flatten(model, t0, list(courses))
    start = x0, v0, initial_states(options.states, layout.states, system.n_states)
    samples = input_matrix(
        force,
        options.base_acceleration,
        {**(options.covariates or {}), **courses},
        [*layout.covariates, *courses],
    )
    last, n_inputs = len(samples) - 1, samples.shape[1]
    hold = None
    if method == "newmark":
        drive = Drive(samples, samples, 0, last, n_inputs, dt)
        out, outcome = newmark.integrate(system, drive, start)
    else:
        hold = options.hold
        between = courses_between(samples, hold)
        drive = Drive(between, samples, len(between) - 1, last, n_inputs, dt)
        covariates = np.abs(samples[:, n + 1 :]).max(axis=0, initial=0.0)
        jumps = jumping_sites(model.laws, layout, covariates)
        adaptive = method == "default"
        rule = runge_kutta.dormand_prince if adaptive else runge_kutta.classical
        out, outcome = runge_kutta.integrate(
            system, drive, start, jumps, rule(rtol, limit), adaptive
        )
    outcome.require_done(dt)
    return _FinishedRun(
        samples,
        dt,
        t0,
        system,
        layout,
        out,
        outcome,
        options,
        hold,
        model.chain.rotates,
    )
