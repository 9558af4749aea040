"""Figures of the examples.

Channels, forces, surfaces, loops, energy, modes, free runs, coefficients, tracks.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np
import pandas as pd
from scipy.signal import welch

from pysindy_nrf import Record, simulate
from pysindy_nrf.chain.model import as_model, as_segments
from pysindy_nrf.chain.sites import index_of
from pysindy_nrf.diagnosis.site_loops import SiteLoop
from pysindy_nrf.drawing.figure import (
    CYCLE,
    DASHES,
    Axis,
    Bars,
    Figure,
    Line,
    Mark,
)
from pysindy_nrf.drawing.matplotlib_renderer import Drawing
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.identification import damper_force, dissipated_energy
from pysindy_nrf.laws import Motion, PowerSeries
from pysindy_nrf.monitoring import moving_windows
from pysindy_nrf.records.fusion.kinematics import base_acceleration_if_any, base_motion
from pysindy_nrf.records.input_arrays import from_arrays
from pysindy_nrf.report.figures.evidence import before_after_figure
from pysindy_nrf.report.figures.forces import energy_figure, loop_figure, surface_figure
from pysindy_nrf.report.figures.modes import modes_figure
from pysindy_nrf.report.figures.motion import below, change_figure

_OVER = {
    "time": ("time", "s"),
    "drift": ("drift s_{{{i}}}", "m"),
    "rate": ("rate v_{{{i}}}", "m/s"),
}


class Display(Drawing):
    """One pair of axes, ``ax_``, unless a display has several."""

    _columns = 0


class DamperForceDisplay(Display):
    """Device force of one storey, identified and true or measured (paper Figs. 4, 5, 7,
    8, 12, 15).

    Parameters
    ----------
    abscissa : ndarray of shape (n_samples,)
        Time (s), drift (m) or rate (m/s).
    identified, measured : ndarray of shape (n_samples,)
        N; the second may be None.
    site : str
    over : {"time", "drift", "rate"}

    Examples
    --------
    >>> import numpy as np
    >>> from paper_displays import DamperForceDisplay
    >>> t = np.linspace(0, 6.3, 500)
    >>> display = DamperForceDisplay(
    ...     t,
    ...     20.0 * np.tanh(9 * np.cos(t)),
    ...     20.0 * np.sign(np.cos(t)),
    ...     over="time",
    ... ).plot()
    >>> display.ax_.get_xlabel(), display.ax_.get_ylabel()
    ('time (s)', 'damper force (N)')
    """

    def __init__(
        self,
        abscissa: Any,
        identified: Any,
        measured: Any = None,
        site: str = "storey 1",
        over: str = "drift",
    ) -> None:
        self.abscissa = np.asarray(abscissa, dtype=float)
        self.identified = np.asarray(identified, dtype=float)
        self.measured = _array_if_any(measured)
        self.site = site
        self.over = over

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        linear: Any,
        X: Any,
        site: Any,
        measured: Any = None,
        over: str = "drift",
        **options: Any,
    ) -> Self:
        """Device force by subtraction.

        Parameters
        ----------
        estimator, linear : fitted NRFRegressor or ChainModel
            Of the structure with and without its devices.
        X, **options
            As of :func:`pysindy_nrf.identification.damper_force`.
        site : str or int
            A storey.
        measured : ndarray of shape (n_samples,), optional
            N.
        over : {"time", "drift", "rate"}

        Raises
        ------
        ChannelError
            If ``over`` is none of these.
        """
        if over not in _OVER:
            raise ChannelError(
                f"over={over!r} is unknown", f"Choose one of {', '.join(_OVER)}."
            )
        place = as_model(estimator).chain.site(site)
        force = damper_force(estimator, linear, X, **options)
        data = as_segments(estimator, X, **options)
        abscissa = force.index.to_numpy()
        if over != "time":
            key = "s" if over == "drift" else "v"
            motion = [getattr(seg, key)[seg.valid] for seg in data.segments]
            abscissa = data.scatter(motion)[:, place.p - 1]
        return cls(abscissa, force[str(place)].to_numpy(), measured, str(place), over)

    def figures(self) -> list[Figure]:
        marks: list[Mark] = []
        if self.measured is not None:
            marks.append(Line(self.abscissa, self.measured, "true", "orange", 1.4))
        marks.append(Line(self.abscissa, self.identified, "identified", "blue", 0.6))
        label, unit = _OVER[self.over]
        x = Axis(label.format(i=index_of(self.site)), unit)
        y = Axis("damper force", "N")
        return [Figure(f"Device force of {self.site}", marks, x, y, heading=self.site)]


class TrackDisplay(Display):
    """Stiffness of every storey over time, as a change from its first window.

    Parameters
    ----------
    table : DataFrame
        As of :func:`pysindy_nrf.monitoring.moving_windows`, of one record.
    onset : float, optional
        Time of a change, s; marked.
    window : float, optional
        Length of the windows, s; shown.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from paper_displays import TrackDisplay
    >>> t = np.arange(1.0, 9.0, 0.25)
    >>> table = pd.DataFrame(
    ...     {
    ...         "record": "quake",
    ...         "t": t,
    ...         "k1": np.where(t < 5, 4e4, 3.2e4),
    ...         "k2": 3e4,
    ...     }
    ... )
    >>> display = TrackDisplay(table, onset=5.0).plot()
    >>> display.ax_.get_ylabel()
    'change of stiffness (%)'
    """

    def __init__(
        self,
        table: pd.DataFrame,
        onset: float | None = None,
        window: float | None = None,
    ) -> None:
        self.table = table
        self.onset = onset
        self.window = window

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any,
        F: Any = None,
        onset: float | None = None,
        **options: Any,
    ) -> Self:
        """Moving-window identification; parameters as of
        :func:`pysindy_nrf.monitoring.moving_windows`.

        Parameters
        ----------
        onset : float, optional
            s.
        """
        return cls(
            moving_windows(estimator, X, F, **options),
            onset,
            options.get("window", 2.0),
        )

    def figures(self) -> list[Figure]:
        stiffness = self.table.filter(regex="^k")
        change = 100 * (stiffness / stiffness.iloc[0] - 1)
        t = self.table["t"]
        marks: list[Mark] = []
        for i, k in enumerate(change):
            name = f"storey {k[1:]}"
            marks.append(Line(t, change[k], name, CYCLE[i % 6], 1.5, DASHES[i % 6]))
        if self.onset is not None and np.isfinite(self.onset):
            ends = [float(change.min(axis=None)), float(change.max(axis=None))]
            times = [self.onset, self.onset]
            name = f"onset {self.onset:.2f} s"
            marks.append(Line(times, ends, name, "muted", 0.8, "dot"))
        window = "window" if self.window is None else f"{self.window:g} s window"
        x = Axis(f"time at the middle of the {window}", "s")
        y = Axis("change of stiffness", "%")
        return [Figure("Stiffness over time", marks, x, y, size=(6.0, 3.2))]


_KINDS = {
    "force": ("F", "N"),
    "acceleration": ("a", "m/s²"),
    "velocity": ("v", "m/s"),
    "displacement": ("x", "m"),
}


class RecordDisplay(Display):
    """Measured channels of one kind over time, axes for each DOF (Figs. 2, 10).

    Parameters
    ----------
    record : Record
    kind : {"force", "acceleration", "velocity", "displacement"}

    Examples
    --------
    >>> from paper_displays import RecordDisplay
    >>> from pysindy_nrf import datasets
    >>> display = RecordDisplay(datasets.load_demo(), "displacement").plot()
    >>> (
    ...     display.ax_[-1].get_xlabel(),
    ...     [axis.get_ylabel() for axis in display.ax_],
    ... )
    ('time (s)', ['$x_{3}$ (mm)', '$x_{2}$ (mm)', '$x_{1}$ (mm)'])
    """

    _columns = 1

    def __init__(self, record: Any, kind: str = "acceleration") -> None:
        self.record, self.kind = record, kind

    def figures(self) -> list[Figure]:
        symbol, unit = _KINDS[self.kind]
        color = "red" if self.kind == "force" else "blue"
        values = getattr(self.record, self.kind)
        if values is None:
            values = np.full((self.record.n_samples, self.record.n_dof), np.nan)
        figures = []
        for j in range(self.record.n_dof, 0, -1):
            channel = values[:, j - 1]
            label = f"{symbol}_{{{j}}}"
            marks: list[Mark] = []
            if np.isnan(channel).all():
                label += ", not measured"
            else:
                marks.append(Line(self.record.time, channel, color=color, width=0.7))
            x, y = below(j, "time", "s"), Axis(label, unit)
            title = f"{self.kind} of DOF {j}"
            figures.append(Figure(title, marks, x, y, size=(6.5, 1.2)))
        return figures


class ModesDisplay(Display):
    """Shapes of the linear part's modes, and the measured spectrum with their
    frequencies.

    Parameters
    ----------
    modes : DataFrame
        As of :meth:`ChainModel.modes`.
    frequency, spectrum : ndarray, optional
        Hz, and the acceleration spectrum by DOF, shape (n_frequencies, n_dof),
        (m/s^2)/sqrt(Hz).

    Examples
    --------
    >>> from paper_displays import ModesDisplay
    >>> from pysindy_nrf import datasets
    >>> len(ModesDisplay.from_estimator(datasets.demo_truth()).modes)
    3
    """

    _columns = 2

    def __init__(
        self, modes: pd.DataFrame, frequency: Any = None, spectrum: Any = None
    ) -> None:
        self.modes = modes
        self.frequency = frequency
        self.spectrum = spectrum

    @classmethod
    def from_estimator(cls, estimator: Any, record: Any = None) -> Self:
        """Modes of a fitted regressor or model.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record, optional
            With accelerations, for the spectrum.
        """
        modes = getattr(estimator, "model_", estimator).modes()
        if record is None or record.acceleration is None:
            return cls(modes)
        length = min(record.n_samples, int(8 * record.fs))
        f, power = welch(record.acceleration, record.fs, nperseg=length, axis=0)
        return cls(modes, f, np.sqrt(power))

    def figures(self) -> list[Figure]:
        shapes = modes_figure(self.modes)
        if self.spectrum is None:
            return [shapes]
        highest = 2.5 * self.modes["frequency"].max()
        shown = (self.frequency > 0) & (self.frequency < highest)
        f, spectrum = self.frequency[shown], self.spectrum[shown]
        ends = [0.5 * spectrum.min(), 2 * spectrum.max()]
        marks: list[Mark] = []
        for mode in self.modes["frequency"]:
            marks.append(Line([mode, mode], ends, "", "muted", 0.8, "dot"))
        for j, line in enumerate(spectrum.T, 1):
            marks.append(Line(f, line, f"a_{{{j}}}", CYCLE[j % 6 - 1], 0.9))
        x = Axis("frequency", "Hz", (0, f[-1]))
        y = Axis("acceleration", "(m/s²)/√Hz", tuple(ends), log=True)
        return [shapes, Figure("Spectrum of the accelerations", marks, x, y)]


class RestoringForceSurfaceDisplay(Display):
    """Restoring force over drift and rate, the visited region in full colour (paper
    Figs. 3, 6, 11, 14).

    Parameters
    ----------
    surface : DataFrame
        ``v`` (m/s), ``s`` (m), ``R`` (N), ``visited``; as of
        :meth:`ChainModel.surface`.
    site : str
    reference : array-like of the same length, optional
        Another force on the same grid, N, drawn as a net: a published law, another
        model.
    reference_label : str

    Examples
    --------
    >>> from paper_displays import RestoringForceSurfaceDisplay
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> model = NRFRegressor().fit(datasets.load_demo())
    >>> RestoringForceSurfaceDisplay.from_estimator(model, 1).surface.shape
    (1681, 4)
    """

    def __init__(
        self,
        surface: pd.DataFrame,
        site: str = "storey 1",
        reference: Any = None,
        reference_label: str = "paper",
    ) -> None:
        self.surface = surface
        self.site = site
        self.reference = reference
        self.reference_label = reference_label

    @classmethod
    def from_estimator(
        cls, estimator: Any, site: Any, reference: Any = None, size: int = 41
    ) -> Self:
        """Display of a fitted regressor or model.

        Parameters
        ----------
        estimator : NRFRegressor or ChainModel
        site : str or int
        reference : callable, optional
            (v, s) -> N, e.g. the restoring force of another model.
        size : int
            Points along each side.
        """
        model = getattr(estimator, "model_", estimator)
        surface = model.surface(site, size)
        other = None
        if reference is not None:
            other = reference(surface["v"].to_numpy(), surface["s"].to_numpy())
        return cls(surface, str(model.chain.site(site)), other)

    def figures(self) -> list[Figure]:
        return [
            surface_figure(
                self.surface, self.site, self.reference, self.reference_label
            )
        ]


class HysteresisLoopDisplay(Display):
    """Loops of the restoring force over the drift, identified over measured.

    Parameters
    ----------
    drift, identified, measured : ndarray of shape (n_samples,)
        m, N, and N if known: the force that balances the inertia above the storey.
    site : str

    Examples
    --------
    >>> import numpy as np
    >>> from paper_displays import HysteresisLoopDisplay
    >>> t = np.linspace(0, 6.3, 500)
    >>> force = 30.0 * np.sin(t) + 10.0 * np.sign(
    ...     np.cos(t)
    ... )  # spring and friction
    >>> HysteresisLoopDisplay(
    ...     0.001 * np.sin(t), force, site="storey 2"
    ... ).plot().ax_.get_ylabel()
    'force $R_{2}$ (N)'
    """

    def __init__(
        self, drift: Any, identified: Any, measured: Any = None, site: str = "storey 1"
    ) -> None:
        self.drift = np.asarray(drift, dtype=float)
        self.identified = np.asarray(identified, dtype=float)
        self.measured = _array_if_any(measured)
        self.site = site

    @classmethod
    def from_estimator(
        cls, estimator: Any, X: Any, F: Any, site: Any, **options: Any
    ) -> Self:
        """Loops of a storey.

        "Measured" is the force that balances the inertia above it with the identified
        masses.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        X, F, **options
            Data, as for ``fit``.
        site : str or int
            A storey.

        Raises
        ------
        ChannelError
            If the site is no storey, or the chain has further links, whose share of the
            balance is not known.
        """
        model = as_model(estimator)
        place = model.chain.site(site)
        if not place.is_storey or any(
            model.laws[s] for s in model.laws if not s.is_storey
        ):
            cure = "Pass drift and forces yourself."
            raise ChannelError(
                f"The force of {place} cannot be read off the balances above it", cure
            )
        i = place.p - 1
        data = as_segments(estimator, X, F, **options)
        drifts, loads = [], []
        for seg in data.segments:
            drifts.append(seg.s[seg.valid])
            loads.append(seg.F[seg.valid] - model.masses * seg.a[seg.valid])
        drift = data.scatter(drifts)[:, i]
        measured = data.scatter(loads)[:, i:].sum(axis=1)
        identified = model.restoring_force(data)[:, i]
        return cls(drift, identified, measured, str(place))

    def figures(self) -> list[Figure]:
        none = np.empty(0)
        forces = (self.identified, self.measured)
        loop = SiteLoop(self.site, "", none, self.drift, none, *forces)
        return [loop_figure(loop)]


class EnergyDisplay(Display):
    """Dissipated energy over time (paper Figs. 13, 16).

    Parameters
    ----------
    time : ndarray of shape (n_samples,)
        s.
    energy : mapping of str to ndarray of shape (n_samples,)
        J, by the name that stands in the legend.

    Examples
    --------
    >>> import numpy as np
    >>> from paper_displays import EnergyDisplay
    >>> t = np.linspace(0, 10, 500)
    >>> EnergyDisplay(
    ...     t, {"identified": 2.0 * t, "true": 2.1 * t}
    ... ).plot().ax_.get_ylabel()
    'dissipated energy (J)'
    """

    def __init__(self, time: Any, energy: Mapping[str, Any]) -> None:
        self.time = np.asarray(time, dtype=float)
        self.energy = {}
        for name, line in energy.items():
            self.energy[name] = np.asarray(line, dtype=float)

    @classmethod
    def from_estimator(
        cls, estimator: Any, X: Any, without: Any = None, **options: Any
    ) -> Self:
        """Energy dissipated in every storey; parameters as of
        :func:`pysindy_nrf.identification.dissipated_energy`.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        """
        table = dissipated_energy(estimator, X, without, **options)
        return cls(table.index.to_numpy(dtype=float), dict(table.items()))

    def figures(self) -> list[Figure]:
        return [energy_figure(pd.DataFrame(self.energy, index=self.time))]


class CoefficientsDisplay(Display):
    """Coefficients of plain SINDy and of this package: a panel for each storey.

    Parameters
    ----------
    shares : DataFrame
        Shares of the storey forces, by site and term.

    Examples
    --------
    >>> import pandas as pd
    >>> from paper_displays import CoefficientsDisplay
    >>> index = pd.MultiIndex.from_tuples(
    ...     [("storey 1", "v"), ("storey 1", "s")]
    ... )
    >>> shares = pd.DataFrame(
    ...     {"truth": [0.1, 0.9], "SINDy": [0.3, 0.6]}, index=index
    ... )
    >>> len(CoefficientsDisplay(shares).plot().ax_)
    1
    """

    _columns = 1

    def __init__(self, shares: pd.DataFrame) -> None:
        self.shares = shares

    @classmethod
    def from_comparison(
        cls, table: pd.DataFrame, record: Record, degree: int = 3
    ) -> Self:
        """Storey forces of a comparison, taken apart into the terms of their storey.

        Parameters
        ----------
        table : DataFrame
            Of :func:`pysindy_nrf.compare_with_sindy`, with ``truth``.
        record : Record
            That it was made of.
        degree : int
        """
        forces = table.attrs["storey_forces"]
        (seg,) = from_arrays(record).segments
        end = seg.valid.stop
        rest = slice(end - len(forces["truth"]), end)
        law = PowerSeries(degree)
        labels = [*(term.label for term in law.terms()), "other"]
        storeys = {}
        for i in range(seg.n_dof):
            motion = Motion(seg.s[rest, i].astype(float), seg.v[rest, i].astype(float))
            wanted = np.column_stack([R[:, i] for R in forces.values()])
            shares = _shares_of_terms(law.features(motion), wanted)
            size = np.sqrt(np.mean(forces["truth"][:, i] ** 2))
            storey = pd.DataFrame(shares / size, index=labels, columns=list(forces))
            storeys[f"storey {i + 1}"] = storey
        return cls(pd.concat(storeys, names=["site", "term"]))

    def figures(self) -> list[Figure]:
        sites = list(self.shares.index.unique(0))
        legend = (
            "term: coefficient times its rms; other: what the terms of this storey"
            " cannot hold"
        )
        figures = []
        for site in sites:
            label = legend if site == sites[-1] else ""
            figures.append(self._panel(site, label))
        return figures

    def _panel(self, site: str, label: str) -> Figure:
        """Bars of one storey."""
        storey = self.shares.loc[site]
        others = [model for model in storey if model != "truth"]
        marks: list[Mark] = []
        for model in storey:
            color, hatched = "ink", False
            if model != "truth":
                number = others.index(model)
                color, hatched = CYCLE[number % 5], number >= 5
            marks.append(Bars(storey[model], str(model), color, hatched=hatched))
        # bars beyond twice the storey's force (columns that nearly cancel) are cut
        ends = [1.1 * storey.min(axis=None), 1.1 * storey.max(axis=None)]
        limits = tuple(np.clip(ends, -2.0, 2.0))
        x = Axis(label, ticks=[_typeset(str(term)) for term in storey.index])
        y = Axis(f"{site}\nshare of its force", limits=limits, zero=True)
        return Figure(str(site), marks, x, y, legend="sheet", size=(8.5, 2.3))


def _shares_of_terms(columns: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Coefficients times the rms of their terms, and the rms of the rest, N."""
    scaled = columns / np.sqrt(np.mean(columns**2, axis=0))
    solution = np.linalg.lstsq(scaled, forces, rcond=None)[0]
    rest = np.sqrt(np.mean((forces - scaled @ solution) ** 2, axis=0))
    return np.vstack([solution, rest])


def _typeset(term: str) -> str:
    """Powers of v and s as a formula; other words as they are."""
    if not re.fullmatch(r"[vs](\^\d+)?( [vs](\^\d+)?)*", term):
        return term
    return "$" + term.replace(" ", r"\,") + "$"


class FreeRunDisplay(Display):
    """Displacements a model predicts from the forces alone, over the measured ones.

    Parameters
    ----------
    time : ndarray of shape (n_samples,)
        s.
    measured, predicted : ndarray of shape (n_samples, n_dof)
        Displacement of the DOFs relative to the base, m.
    begin : float, optional
        Where the drawing begins, s; the error is that of the whole record.

    Examples
    --------
    >>> import numpy as np
    >>> from paper_displays import FreeRunDisplay
    >>> t = np.linspace(0, 10, 500)
    >>> x = 1e-3 * np.column_stack([np.sin(9 * t), 2 * np.sin(9 * t)])
    >>> FreeRunDisplay(t, x, 0.98 * x).plot().error.round(
    ...     1
    ... )  # percent NRMSE of both DOFs
    array([2., 2.])
    """

    _columns = 1

    def __init__(
        self, time: Any, measured: Any, predicted: Any, begin: float | None = None
    ) -> None:
        self.time = np.asarray(time, dtype=float)
        self.measured = np.asarray(measured, dtype=float)
        self.predicted = np.asarray(predicted, dtype=float)
        self.begin = begin

    @classmethod
    def from_estimator(cls, estimator: Any, record: Any, **options: Any) -> Self:
        """Simulate the model under the forces of a record.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record
            With forces, displacements and the covariates of the laws; its first sample
            is the initial condition.
        **options
            Passed to :func:`pysindy_nrf.simulate`.

        Raises
        ------
        ChannelError
            If the record has no displacement to compare with.
        """
        if record.displacement is None:
            cure = "Fuse its channels with KinematicSmoother first."
            raise ChannelError(
                f"Record {record.name!r} has no displacement to compare with", cure
            )
        measured, rate = _relative_motion(record)
        start = {
            "x0": measured[0],
            "v0": None if rate is None else rate[0],
            "covariates": record.covariates,
            "base_acceleration": base_acceleration_if_any(record),
        }
        model = getattr(estimator, "model_", estimator)
        run = simulate(model, record.force, record.dt, **(start | options))
        return cls(record.time, measured, run.displacement)

    @property
    def error(self) -> np.ndarray:
        """Free-run error of every DOF, percent NRMSE."""
        pairs = zip(self.measured.T, self.predicted.T)
        return np.array([nrmse(measured, run) for measured, run in pairs])

    def figures(self) -> list[Figure]:
        figures = []
        for j in range(len(self.error), 0, -1):
            measured, run = self.measured[:, j - 1], self.predicted[:, j - 1]
            label = f"free run ({self.error[j - 1]:.2g} % NRMSE)"
            marks: list[Mark] = [
                Line(self.time, measured, "measured", "orange", 1.6),
                Line(self.time, run, label, "blue", 0.8, "dash"),
            ]
            x = below(j, "time", "s")
            if self.begin is not None:
                x = replace(x, limits=(self.begin, self.time[-1]))
            y = Axis(f"x_{{{j}}}", "m")
            title = f"Free run of DOF {j}"
            figures.append(Figure(title, marks, x, y, legend="above", size=(6.5, 1.4)))
        return figures


def _relative_motion(record: Record) -> tuple[np.ndarray, np.ndarray | None]:
    """Displacement and velocity relative to the base."""
    x, v = record.displacement, record.velocity
    if record.coordinates != "absolute" or not record.base_moves:
        return x, v
    from_acceleration = not {"vg", "xg"} <= set(record.measured)
    vg, xg = base_motion(record, record, from_acceleration)
    return x - xg[:, None], None if v is None else v - vg[:, None]


def _array_if_any(values: Any) -> np.ndarray | None:
    return None if values is None else np.asarray(values, dtype=float)


class ChangeMapDisplay(Display):
    """Where in the (v, s) plane a storey's force changed significantly.

    Parameters
    ----------
    table : DataFrame
        As of :meth:`pysindy_nrf.monitoring.change.ChangeReport.map`.
    site : str
    largest : float, optional
        Force at the ends of the colour scale, N; the largest change if None. One scale
        for all storeys lets them be compared.
    colorbar : bool

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from paper_displays import ChangeMapDisplay
    >>> v, s = (
    ...     g.ravel()
    ...     for g in np.meshgrid(
    ...         np.linspace(-0.1, 0.1, 9), np.linspace(-0.002, 0.002, 9)
    ...     )
    ... )
    >>> table = pd.DataFrame(
    ...     {"v": v, "s": s, "change": -4e3 * s, "error": 0.5}
    ... )  # 4 kN/m of stiffness lost
    >>> table["significant"], table["visited"] = (
    ...     abs(table["change"]) > 1.0,
    ...     True,
    ... )
    >>> ChangeMapDisplay(table, "storey 2").plot().ax_.get_title(loc="left")
    'storey 2'
    """

    def __init__(
        self,
        table: pd.DataFrame,
        site: str = "storey 1",
        largest: float | None = None,
        colorbar: bool = True,
    ) -> None:
        self.table = table
        self.site = site
        self.largest = largest
        self.colorbar = colorbar

    @classmethod
    def from_report(
        cls, report: Any, site: Any, largest: float | None = None, size: int = 41
    ) -> Self:
        """Map of one storey of a :class:`pysindy_nrf.monitoring.change.ChangeReport`.

        Parameters
        ----------
        report : ChangeReport
        site : str or int
        largest, size
            As for :class:`ChangeMapDisplay`, and the points along each side.
        """
        return cls(report.map(site, size), str(report.before.chain.site(site)), largest)

    def figures(self) -> list[Figure]:
        return [change_figure(self.table, self.site, self.largest, self.colorbar)]


class BeforeAfterDisplay(Display):
    """Held-out errors of the baseline and after each effect that the loop added."""

    def __init__(self, report: Any) -> None:
        self.report = report

    @classmethod
    def from_report(cls, report: Any) -> Self:
        """The errors of a report of :func:`pysindy_nrf.close_loop`."""
        return cls(report)

    def figures(self) -> list[Figure]:
        return [before_after_figure(self.report)]
