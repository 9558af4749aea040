"""Figures of the examples: channels, forces, surfaces, loops, energy, modes, free runs,
coefficients, tracks.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator
from scipy.signal import welch

from pysindy_nrf import Record, simulate
from pysindy_nrf.chain.model import as_model, as_segments
from pysindy_nrf.chain.sites import index_of
from pysindy_nrf.diagnosis.site_loops import SiteLoop
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.identification import damper_force, dissipated_energy
from pysindy_nrf.laws import Motion, PowerSeries
from pysindy_nrf.monitoring import track
from pysindy_nrf.records.fusion.kinematics import base_acceleration_if_any, base_motion
from pysindy_nrf.records.input_arrays import from_arrays
from pysindy_nrf.report.figures.evidence import before_after_figure
from pysindy_nrf.report.figures.figure import (
    CYCLE,
    DASHES,
    Axis,
    Bars,
    Figure,
    Line,
    Mark,
)
from pysindy_nrf.report.figures.forces import energy_figure, loop_figure, surface_figure
from pysindy_nrf.report.figures.matplotlib_renderer import Drawing, dress
from pysindy_nrf.report.figures.motion import below, change_figure, modes_figure

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
        self.abscissa, self.identified = (
            np.asarray(abscissa, dtype=float),
            np.asarray(identified, dtype=float),
        )
        self.measured = None if measured is None else np.asarray(measured, dtype=float)
        self.site, self.over = site, over

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
        """Device force by subtraction; see :func:`pysindy_nrf.identification.damper_force`
        for ``X`` and the options.

        Parameters
        ----------
        estimator, linear : fitted NRFRegressor or ChainModel
            Of the structure with and without its devices.
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
            abscissa = data.scatter(
                [getattr(seg, key)[seg.valid] for seg in data.segments]
            )[:, place.p - 1]
        return cls(abscissa, force[str(place)].to_numpy(), measured, str(place), over)

    def figures(self) -> list[Figure]:
        marks: list[Mark] = [
            Line(self.abscissa, self.identified, "identified", "blue", 0.6)
        ]
        if self.measured is not None:
            marks.insert(0, Line(self.abscissa, self.measured, "true", "orange", 1.4))
        label, unit = _OVER[self.over]
        x, y = (
            Axis(label.format(i=index_of(self.site)), unit),
            Axis("damper force", "N"),
        )
        return [Figure(f"Device force of {self.site}", marks, x, y, heading=self.site)]


class TrackDisplay(Display):
    """Stiffness of every storey over time, as a change from its first window.

    Parameters
    ----------
    table : DataFrame
        As of :func:`pysindy_nrf.monitoring.track`, of one record.
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
        self.table, self.onset, self.window = table, onset, window

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
        :func:`pysindy_nrf.monitoring.track`.

        Parameters
        ----------
        onset : float, optional
            s.
        """
        return cls(track(estimator, X, F, **options), onset, options.get("window", 2.0))

    def figures(self) -> list[Figure]:
        stiffness = self.table[[c for c in self.table if str(c).startswith("k")]]
        change = 100 * (stiffness / stiffness.iloc[0] - 1)
        marks: list[Mark] = [
            Line(
                self.table["t"],
                change[k],
                f"storey {k[1:]}",
                CYCLE[i % 6],
                1.5,
                DASHES[i % 6],
            )
            for i, k in enumerate(change)
        ]
        if self.onset is not None and np.isfinite(self.onset):
            ends = [float(change.min(axis=None)), float(change.max(axis=None))]
            marks.append(
                Line(
                    [self.onset, self.onset],
                    ends,
                    f"onset {self.onset:.2f} s",
                    "muted",
                    0.8,
                    "dot",
                )
            )
        window = "window" if self.window is None else f"{self.window:g} s window"
        x, y = (
            Axis(f"time at the middle of the {window}", "s"),
            Axis("change of stiffness", "%"),
        )
        return [Figure("Stiffness over time", marks, x, y, size=(6.0, 3.2))]


_KINDS = {
    "force": ("F", "N"),
    "acceleration": ("a", "m/s²"),
    "velocity": ("v", "m/s"),
    "displacement": ("x", "m"),
}


class RecordDisplay(Display):
    """Measured channels of one kind over time, one line of axes for each DOF (paper
    Figs. 2, 10).

    Parameters
    ----------
    record : Record
    kind : {"force", "acceleration", "velocity", "displacement"}

    Examples
    --------
    >>> from pysindy_nrf import datasets, displays
    >>> display = displays.RecordDisplay(
    ...     datasets.load_demo(), "displacement"
    ... ).plot()
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
        values, (symbol, unit) = getattr(self.record, self.kind), _KINDS[self.kind]
        out = []
        for j in range(self.record.n_dof, 0, -1):
            known = values is not None and not np.isnan(values[:, j - 1]).all()
            color = "red" if symbol == "F" else "blue"
            marks: list[Mark] = (
                [Line(self.record.time, values[:, j - 1], color=color, width=0.7)]
                if known
                else []
            )
            y = Axis(
                f"{symbol}_{{{j}}}" if known else f"{symbol}_{{{j}}}, not measured",
                unit,
            )
            out.append(
                Figure(
                    f"{self.kind} of DOF {j}",
                    marks,
                    below(j, "time", "s"),
                    y,
                    size=(6.5, 1.2),
                )
            )
        return out


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
        self.modes, self.frequency, self.spectrum = modes, frequency, spectrum

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
        f, power = welch(
            record.acceleration,
            record.fs,
            nperseg=min(record.n_samples, int(8 * record.fs)),
            axis=0,
        )
        return cls(modes, f, np.sqrt(power))

    def figures(self) -> list[Figure]:
        shapes = modes_figure(self.modes)
        if self.spectrum is None:
            return [shapes]
        shown = (self.frequency > 0) & (
            self.frequency < 2.5 * self.modes["frequency"].max()
        )
        f, spectrum = self.frequency[shown], self.spectrum[shown]
        ends = [0.5 * spectrum.min(), 2 * spectrum.max()]
        marks: list[Mark] = [
            Line([f, f], ends, "", "muted", 0.8, "dot") for f in self.modes["frequency"]
        ]
        marks += [
            Line(f, line, f"a_{{{j}}}", CYCLE[j % 6 - 1], 0.9)
            for j, line in enumerate(spectrum.T, 1)
        ]
        y = Axis("acceleration", "(m/s²)/√Hz", tuple(ends), log=True)
        return [
            shapes,
            Figure(
                "Spectrum of the accelerations",
                marks,
                Axis("frequency", "Hz", (0, f[-1])),
                y,
            ),
        ]


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
        self.surface, self.site, self.reference, self.reference_label = (
            surface,
            site,
            reference,
            reference_label,
        )

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
        other = (
            None
            if reference is None
            else reference(surface["v"].to_numpy(), surface["s"].to_numpy())
        )
        return cls(surface, str(model.chain.site(site)), other)

    def figures(self) -> list[Figure]:
        return [
            surface_figure(
                self.surface, self.site, self.reference, self.reference_label
            )
        ]

    def plot(self, ax: Any = None) -> Self:
        """Draw in space; drifts in mm."""
        figure = self.figures()[0]
        if ax is None:
            ax = plt.figure(figsize=figure.size, layout="constrained").add_subplot(
                projection="3d"
            )
        for mark in figure.marks:
            x, y, z = 1e3 * np.asarray(mark.x), np.asarray(mark.y), np.asarray(mark.z)
            if mark.style == "full":
                ax.plot_surface(
                    x,
                    y,
                    z,
                    cmap="cividis",
                    rstride=1,
                    cstride=1,
                    linewidth=0,
                    alpha=0.95,
                )
                color = "#7b7b78"
            else:
                color, width, stride = (
                    ("0.75", 0.3, 4) if mark.style == "faint" else ("black", 0.6, 3)
                )
                ax.plot_wireframe(
                    x,
                    y,
                    z,
                    color=color,
                    linewidth=width,
                    rstride=stride,
                    cstride=stride,
                )
            ax.plot([], [], [], color=color, linewidth=3, label=mark.name)
        for side, axis in zip("xyz", (figure.x, figure.y, figure.z)):
            dress(ax, side, axis)
            getattr(ax, f"{side}axis").set_major_locator(MaxNLocator(5))
        ax.set_title(figure.heading)
        ax.tick_params(labelsize="small", pad=1)
        ax.tick_params(axis="z", pad=4)
        ax.zaxis.labelpad = 11
        ax.view_init(elev=24, azim=-125)
        ax.set_box_aspect(None, zoom=0.8)
        ax.legend(loc="upper left", fontsize="x-small", frameon=False)
        self.ax_, self.figure_ = ax, ax.figure
        return self


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
        self.drift, self.identified = (
            np.asarray(drift, dtype=float),
            np.asarray(identified, dtype=float),
        )
        self.measured = None if measured is None else np.asarray(measured, dtype=float)
        self.site = site

    @classmethod
    def from_estimator(
        cls, estimator: Any, X: Any, F: Any, site: Any, **options: Any
    ) -> Self:
        """Loops of a storey; "measured" is the force that balances the inertia above it
        with the identified masses.

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
        drift = data.scatter([seg.s[seg.valid] for seg in data.segments])[:, i]
        above = data.scatter(
            [
                seg.F[seg.valid] - model.masses * seg.a[seg.valid]
                for seg in data.segments
            ]
        )
        return cls(
            drift,
            model.restoring_force(data)[:, i],
            above[:, i:].sum(axis=1),
            str(place),
        )

    def figures(self) -> list[Figure]:
        none = np.empty(0)
        return [
            loop_figure(
                SiteLoop(
                    self.site,
                    "",
                    none,
                    self.drift,
                    none,
                    self.identified,
                    self.measured,
                )
            )
        ]


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
        self.energy = {
            name: np.asarray(line, dtype=float) for name, line in energy.items()
        }

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
        return cls(
            table.index.to_numpy(dtype=float),
            {name: table[name].to_numpy() for name in table},
        )

    def figures(self) -> list[Figure]:
        return [energy_figure(pd.DataFrame(self.energy, index=self.time))]


class CoefficientsDisplay(Display):
    """Coefficients of plain SINDy and of this package: one panel a storey, one group of
    bars a term.

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
        """The storey forces of each model of a comparison, taken apart into the terms
        of their own storey.

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
        rest = slice(seg.valid.stop - len(forces["truth"]), seg.valid.stop)
        law, rows = PowerSeries(degree), {}
        for i in range(seg.n_dof):
            columns = law.features(
                Motion(seg.s[rest, i].astype(float), seg.v[rest, i].astype(float))
            )
            scale = np.sqrt(np.mean(columns**2, axis=0))
            wanted = np.column_stack([R[:, i] for R in forces.values()])
            found = np.linalg.lstsq(columns / scale, wanted, rcond=None)[0]
            left = np.sqrt(np.mean((wanted - columns / scale @ found) ** 2, axis=0))
            size = np.sqrt(np.mean(forces["truth"][:, i] ** 2))
            for label, row in zip(
                [*(term.label for term in law.terms()), "other"],
                np.vstack([found, left]) / size,
            ):
                rows[f"storey {i + 1}", label] = row
        index = pd.MultiIndex.from_tuples(rows, names=["site", "term"])
        return cls(
            pd.DataFrame(
                np.array(list(rows.values())), index=index, columns=list(forces)
            )
        )

    def figures(self) -> list[Figure]:
        sites = list(dict.fromkeys(self.shares.index.get_level_values(0)))
        said = (
            "term: coefficient times its rms; other: what the terms of this storey"
            " cannot hold"
        )
        out = []
        for site in sites:
            part = self.shares.loc[site]
            others = [m for m in part if m != "truth"]
            colors = {m: CYCLE[k % 5] for k, m in enumerate(others)} | {"truth": "ink"}
            marks: list[Mark] = [
                Bars(part[m], str(m), colors[m], hatched=m in others[5:]) for m in part
            ]
            # bars beyond twice the storey's force (columns that nearly cancel) are cut,
            # and say so by reaching the edge
            low, high = np.clip(
                [1.1 * part.min(axis=None), 1.1 * part.max(axis=None)], -2.0, 2.0
            )
            x = Axis(
                said if site == sites[-1] else "",
                ticks=[_typeset(str(term)) for term in part.index],
            )
            y = Axis(f"{site}\nshare of its force", limits=(low, high), zero=True)
            out.append(Figure(str(site), marks, x, y, legend="sheet", size=(8.5, 2.3)))
        return out


def _typeset(term: str) -> str:
    """Powers of v and s as a formula; other words as they are."""
    return (
        f"${term.replace(' ', chr(92) + ',')}$"
        if re.fullmatch(r"[vs](\^\d+)?( [vs](\^\d+)?)*", term)
        else term
    )


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
        self.time, self.begin = np.asarray(time, dtype=float), begin
        self.measured, self.predicted = (
            np.asarray(measured, dtype=float),
            np.asarray(predicted, dtype=float),
        )

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
        measured, rate = record.displacement, record.velocity
        if (
            record.coordinates == "absolute" and record.base_moves
        ):  # all relative to the base
            vg, xg = base_motion(
                record, record, not {"vg", "xg"} <= set(record.measured)
            )
            measured, rate = (
                measured - xg[:, None],
                (None if rate is None else rate - vg[:, None]),
            )
        given = {
            "x0": measured[0],
            "v0": None if rate is None else rate[0],
            "covariates": record.covariates,
        }
        given |= {"base_acceleration": base_acceleration_if_any(record)} | options
        run = simulate(
            getattr(estimator, "model_", estimator), record.force, record.dt, **given
        )
        return cls(record.time, measured, run.displacement)

    @property
    def error(self) -> np.ndarray:
        """Free-run error of every DOF, percent NRMSE."""
        return np.array(
            [nrmse(x, own) for x, own in zip(self.measured.T, self.predicted.T)]
        )

    def figures(self) -> list[Figure]:
        out = []
        for j, error in reversed(list(enumerate(self.error, 1))):
            marks: list[Mark] = [
                Line(self.time, self.measured[:, j - 1], "measured", "orange", 1.6),
                Line(
                    self.time,
                    self.predicted[:, j - 1],
                    f"free run ({error:.2g} % NRMSE)",
                    "blue",
                    0.8,
                    "dash",
                ),
            ]
            x, y = below(j, "time", "s"), Axis(f"x_{{{j}}}", "m")
            if self.begin is not None:
                x = replace(x, limits=(self.begin, self.time[-1]))
            out.append(
                Figure(
                    f"Free run of DOF {j}", marks, x, y, legend="above", size=(6.5, 1.4)
                )
            )
        return out


class ChangeMapDisplay(Display):
    """Where in the (v, s) plane a storey's force changed, and where the change is
    significant.

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
        self.table, self.site, self.largest, self.colorbar = (
            table,
            site,
            largest,
            colorbar,
        )

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
    """Held-out errors of the baseline and after each effect that the closed loop
    added.
    """

    def __init__(self, report: Any) -> None:
        self.report = report

    @classmethod
    def from_report(cls, report: Any) -> Self:
        """The errors of a report of :func:`pysindy_nrf.close_loop`."""
        return cls(report)

    def figures(self) -> list[Figure]:
        return [before_after_figure(self.report)]
