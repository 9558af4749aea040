"""Figures of the paper's cases: channels of a test, the force of a device, modes, stiffness over time."""

from typing import Any, Self

import numpy as np
import pandas as pd
from scipy.signal import welch

from pysindy_nrf.estimation import damper_force
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.monitoring import track
from pysindy_nrf.output.displays._figure import CYCLE, DASHES, Axis, Figure, Line, Mark, Rule, index_of
from pysindy_nrf.output.displays._matplotlib import Display
from pysindy_nrf.output.displays.motion import below, modes_figure
from pysindy_nrf.regression.chain_model import as_model, as_segments

_OVER = {"time": ("time", "s"), "drift": ("drift s_{{{i}}}", "m"), "rate": ("rate v_{{{i}}}", "m/s")}


class DamperForceDisplay(Display):
    """Device force of one storey, identified and true or measured (paper Figs. 4, 5, 7, 8, 12, 15).

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
    >>> display = DamperForceDisplay(t, 20.0 * np.tanh(9 * np.cos(t)), 20.0 * np.sign(np.cos(t)), over="time").plot()
    >>> display.ax_.get_xlabel(), display.ax_.get_ylabel()
    ('time (s)', 'damper force (N)')
    """

    def __init__(
        self, abscissa: Any, identified: Any, measured: Any = None, site: str = "storey 1", over: str = "drift"
    ) -> None:
        self.abscissa, self.identified = np.asarray(abscissa, dtype=float), np.asarray(identified, dtype=float)
        self.measured = None if measured is None else np.asarray(measured, dtype=float)
        self.site, self.over = site, over

    @classmethod
    def from_estimator(
        cls, estimator: Any, linear: Any, X: Any, site: Any, measured: Any = None, over: str = "drift", **options: Any
    ) -> Self:
        """Device force by subtraction; see :func:`pysindy_nrf.estimation.damper_force` for ``X`` and the options.

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
            raise ChannelError(f"over={over!r} is unknown", f"Choose one of {', '.join(_OVER)}.")
        place = as_model(estimator).chain.site(site)
        force = damper_force(estimator, linear, X, **options)
        data = as_segments(estimator, X, **options)
        abscissa = force.index.to_numpy()
        if over != "time":
            key = "s" if over == "drift" else "v"
            abscissa = data.scatter([getattr(seg, key)[seg.valid] for seg in data.segments])[:, place.p - 1]
        return cls(abscissa, force[str(place)].to_numpy(), measured, str(place), over)

    def figures(self) -> list[Figure]:
        marks: list[Mark] = [Line(self.abscissa, self.identified, "identified", "blue", 0.6)]
        if self.measured is not None:
            marks.insert(0, Line(self.abscissa, self.measured, "true", "orange", 1.4))
        label, unit = _OVER[self.over]
        x, y = Axis(label.format(i=index_of(self.site)), unit), Axis("damper force", "N")
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
    >>> table = pd.DataFrame({"record": "quake", "t": t, "k1": np.where(t < 5, 4e4, 3.2e4), "k2": 3e4})
    >>> display = TrackDisplay(table, onset=5.0).plot()
    >>> display.ax_.get_ylabel()
    'change of stiffness (%)'
    """

    def __init__(self, table: pd.DataFrame, onset: float | None = None, window: float | None = None) -> None:
        self.table, self.onset, self.window = table, onset, window

    @classmethod
    def from_estimator(cls, estimator: Any, X: Any, F: Any = None, onset: float | None = None, **options: Any) -> Self:
        """Moving-window identification; parameters as of :func:`pysindy_nrf.monitoring.track`.

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
            Line(self.table["t"], change[k], f"storey {k[1:]}", CYCLE[i % 6], 1.5, DASHES[i % 6])
            for i, k in enumerate(change)
        ]
        if self.onset is not None and np.isfinite(self.onset):
            marks.append(Rule(self.onset, f"onset {self.onset:.2f} s"))
        window = "window" if self.window is None else f"{self.window:g} s window"
        x, y = Axis(f"time at the middle of the {window}", "s"), Axis("change of stiffness", "%")
        return [Figure("Stiffness over time", marks, x, y, size=(6.0, 3.2))]


_KINDS = {"force": ("F", "N"), "acceleration": ("a", "m/s²"), "velocity": ("v", "m/s"), "displacement": ("x", "m")}


class RecordDisplay(Display):
    """Measured channels of one kind over time, one line of axes for each DOF (paper Figs. 2, 10).

    Parameters
    ----------
    record : Record
    kind : {"force", "acceleration", "velocity", "displacement"}

    Examples
    --------
    >>> from pysindy_nrf import datasets, displays
    >>> display = displays.RecordDisplay(datasets.load_demo(), "displacement").plot()
    >>> display.ax_[-1].get_xlabel(), [axis.get_ylabel() for axis in display.ax_]
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
            marks: list[Mark] = [Line(self.record.time, values[:, j - 1], color=color, width=0.7)] if known else []
            y = Axis(f"{symbol}_{{{j}}}" if known else f"{symbol}_{{{j}}}, not measured", unit)
            out.append(Figure(f"{self.kind} of DOF {j}", marks, below(j, "time", "s"), y, size=(6.5, 1.2)))
        return out


class ModesDisplay(Display):
    """Shapes of the linear part's modes, and the measured spectrum with their frequencies.

    Parameters
    ----------
    modes : DataFrame
        As of :meth:`ChainModel.modes`.
    frequency, spectrum : ndarray, optional
        Hz, and the acceleration spectrum by DOF, shape (n_frequencies, n_dof), (m/s^2)/sqrt(Hz).

    Examples
    --------
    >>> from paper_displays import ModesDisplay
    >>> from pysindy_nrf import datasets
    >>> len(ModesDisplay.from_estimator(datasets.demo_truth()).modes)
    3
    """

    _columns = 2

    def __init__(self, modes: pd.DataFrame, frequency: Any = None, spectrum: Any = None) -> None:
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
        f, power = welch(record.acceleration, record.fs, nperseg=min(record.n_samples, int(8 * record.fs)), axis=0)
        return cls(modes, f, np.sqrt(power))

    def figures(self) -> list[Figure]:
        shapes = modes_figure(self.modes)
        if self.spectrum is None:
            return [shapes]
        shown = (self.frequency > 0) & (self.frequency < 2.5 * self.modes["frequency"].max())
        f, spectrum = self.frequency[shown], self.spectrum[shown]
        marks: list[Mark] = [Rule(f) for f in self.modes["frequency"]]
        marks += [Line(f, line, f"a_{{{j}}}", CYCLE[j % 6 - 1], 0.9) for j, line in enumerate(spectrum.T, 1)]
        y = Axis("acceleration", "(m/s²)/√Hz", (0.5 * spectrum.min(), 2 * spectrum.max()), log=True)
        return [shapes, Figure("Spectrum of the accelerations", marks, Axis("frequency", "Hz", (0, f[-1])), y)]
