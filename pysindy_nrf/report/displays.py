"""Displays of a fitted model as scikit-learn has them.

Each is made by ``from_estimator`` (or ``from_report``), which draws it, and drawn again
by ``plot``; ``ax_`` and ``figure_`` are matplotlib's. Without matplotlib an error names
the extra ``plot``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

import numpy as np

from ..chain.model import ChainModel, parameters_of
from ..chain.sites import SiteName
from ..diagnosis.free_run import FreeRuns, free_runs
from ..diagnosis.site_loops import SiteLoop, loops_of
from ..drawing.figure import Figure
from ..drawing.matplotlib_renderer import Column, Single, animated
from ..exceptions import ChannelError, NRFError
from ..records.dataset import Dataset
from ..records.record import Record
from ..records.zero_phase_filter import filters_of
from .figures.evidence import before_after_figure
from .figures.forces import force_figure, loop_figure
from .figures.intervals import intervals_figure
from .figures.modes import modes_figure
from .figures.motion import free_run_figure, free_run_figures
from .figures.residual import equation_residuals, largest_residual, residual_figures
from .model_content import Fitted, Identification, identification_of
from .results import Loop

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes

Records = Record | Sequence[Record]


def _shown(subject: ChainModel | Fitted, record: Records | None) -> Identification:
    """A model with the data over which it is drawn."""
    shown = identification_of(subject, record)
    if shown.data is None:
        raise ChannelError(
            "There are no data over which the model could be drawn",
            "Pass record=, or fit again.",
        )
    return shown


def _data_of(shown: Identification) -> Dataset:
    assert shown.data is not None  # _shown refuses others
    return shown.data


def _loop_at(shown: Identification, storey: SiteName) -> SiteLoop:
    """The force of one site along the data."""
    site = str(shown.model.chain.site(storey))
    data = _data_of(shown)
    for loop in loops_of(shown.model, data, filters_of(shown.band, data)):
        if loop.site == site:
            return loop
    raise NRFError(
        f"The model has no law at {site} that these data can be put into",
        "Choose a site with a law, or a record with the channels that it reads.",
    )


class RestoringForceDisplay(Single):
    """Restoring force of a site over drift and rate, with the path of the data.

    Coloured where the data were, a net beyond. A force that depends on its path is no
    surface: its path is drawn alone.

    Parameters
    ----------
    figures : sequence of Figure

    Attributes
    ----------
    ax_ : Axes3D
    figure_ : matplotlib Figure

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, RestoringForceDisplay, datasets
    >>> record = datasets.load_demo()
    >>> model = NRFRegressor(degree=3).fit(record)
    >>> shown = RestoringForceDisplay.from_estimator(model, record, storey=2)
    >>> shown.ax_.get_zlabel()
    'force $R_{2}$ (N)'
    """

    @classmethod
    def from_estimator(
        cls,
        estimator: ChainModel | Fitted,
        record: Records | None = None,
        storey: SiteName = 1,
        *,
        ax: Axes | None = None,
    ) -> Self:
        """Draw the force of one site.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record or sequence of Record, optional
            Along which it is drawn; the data of the fit if None.
        storey : int, str or Site
            A storey by its number, or a site such as ``"link 3-1"``.
        ax : Axes3D, optional
            New ones if None.

        Returns
        -------
        RestoringForceDisplay

        Raises
        ------
        ChannelError
            If there are no data.
        NRFError
            If the site has no law.
        """
        shown = _shown(estimator, record)
        site = shown.model.chain.site(storey)
        figure = force_figure(shown.model, site, _loop_at(shown, site))
        assert figure is not None  # there is a path
        return cls([figure]).plot(ax)


class HysteresisDisplay(Single):
    """Force of a site over its drift, identified over measured.

    Measured is the force that the measured motion and forces ask for, where they
    determine it. The largest cycles are drawn.

    Parameters
    ----------
    figures : sequence of Figure

    Attributes
    ----------
    ax_ : Axes
    figure_ : matplotlib Figure

    Examples
    --------
    >>> from pysindy_nrf import HysteresisDisplay, NRFRegressor, datasets
    >>> model = NRFRegressor(degree=3).fit(datasets.load_demo())
    >>> HysteresisDisplay.from_estimator(model, storey=1).ax_.get_xlabel()
    'drift $s_{1}$ (mm)'
    """

    @classmethod
    def from_estimator(
        cls,
        estimator: ChainModel | Fitted,
        record: Records | None = None,
        storey: SiteName = 1,
        *,
        without_spring: bool = False,
        ax: Axes | None = None,
    ) -> Self:
        """Draw the loops of one site.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record or sequence of Record, optional
            The data of the fit if None.
        storey : int, str or Site
        without_spring : bool
            Whether the linear spring is taken off both forces.
        ax : Axes, optional
            New ones if None.

        Returns
        -------
        HysteresisDisplay
        """
        shown = _shown(estimator, record)
        loop = _loop_at(shown, storey)
        force = shown.model.restoring_forces[storey]
        stiffness = float(force.linear_part()["k"]) if without_spring else 0.0
        return cls([loop_figure(loop, stiffness)]).plot(ax)


class _OfOneDof(Column):
    """Figures of one DOF below each other."""

    @classmethod
    def from_estimator(
        cls,
        estimator: ChainModel | Fitted,
        record: Records | None = None,
        dof: int | None = None,
        *,
        ax: Axes | Sequence[Axes] | np.ndarray | None = None,
    ) -> Self:
        """Draw one DOF.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record or sequence of Record, optional
            The data of the fit if None; of several the first is drawn.
        dof : int, optional
            The one that moves most, or whose residual is the largest part of its
            force, if None.
        ax : sequence of Axes, optional
            One for each figure, or fewer for the first ones; new ones if None.

        Returns
        -------
        Display

        Raises
        ------
        ChannelError
            If there is no such DOF, or nothing to draw of it; the reason is given.
        """
        shown = _shown(estimator, record)
        return cls(cls._figures_of(shown, dof, record is not None)).plot(ax)

    @classmethod
    def _figures_of(
        cls, shown: Identification, dof: int | None, over_records: bool
    ) -> list[Figure]:
        """The figures; ``over_records`` says whether records were given."""
        raise NotImplementedError


class FreeRunDisplay(_OfOneDof):
    """The model alone under the measured force over the measurement; its error below.

    Parameters
    ----------
    figures : sequence of Figure

    Attributes
    ----------
    ax_ : ndarray of Axes
        Motion, and below it the error of the run.
    figure_ : matplotlib Figure

    Examples
    --------
    >>> from pysindy_nrf import FreeRunDisplay, NRFRegressor, datasets
    >>> model = NRFRegressor(degree=3).fit(datasets.load_demo())
    >>> shown = FreeRunDisplay.from_estimator(model, dof=1)
    >>> [axes.get_ylabel() for axes in shown.ax_]
    ['$x_{1}$ (mm)', 'error of $x_{1}$ (mm)']
    """

    @classmethod
    def _figures_of(
        cls, shown: Identification, dof: int | None, over_records: bool
    ) -> list[Figure]:
        runs = _runs_of(shown, over_records)
        if not runs.runs:
            raise ChannelError(
                f"There is no free run: {runs.why_not}", "Give a record with forces."
            )
        if dof is None:
            return free_run_figures(runs)[:1]
        n_dof = shown.model.n_dof
        if not 1 <= dof <= n_dof:
            raise ChannelError(f"There is no DOF {dof}", f"Choose 1 to {n_dof}.")
        return [free_run_figure(runs, dof)]


def _runs_of(shown: Identification, over_records: bool) -> FreeRuns:
    """Free runs over the records that were given, or over the data of the fit."""
    if shown.free_runs is not None and not over_records:
        return shown.free_runs
    data = _data_of(shown)
    return free_runs(shown.model, data, filters_of(shown.band, data))


class ResidualDisplay(_OfOneDof):
    """What the model leaves of one equation of motion.

    Its spectrum with the force and the noise of the channels; its correlation with
    itself, and with what drives the structure.

    Parameters
    ----------
    figures : sequence of Figure

    Attributes
    ----------
    ax_ : ndarray of Axes
        Spectrum, autocorrelation, cross-correlation.
    figure_ : matplotlib Figure

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, ResidualDisplay, datasets
    >>> model = NRFRegressor(degree=3).fit(datasets.load_demo())
    >>> shown = ResidualDisplay.from_estimator(model, dof=2)
    >>> [axes.get_xlabel() for axes in shown.ax_]
    ['frequency (Hz)', 'lag (s)', 'lag (s)']
    """

    _shared = False

    @classmethod
    def _figures_of(
        cls, shown: Identification, dof: int | None, over_records: bool
    ) -> list[Figure]:
        data = _data_of(shown)
        residuals = equation_residuals(shown.model, data, filters_of(shown.band, data))
        if dof is None:
            return residual_figures(largest_residual(residuals))
        for residual in residuals:
            if residual.dof == dof:
                return residual_figures(residual)
        known = ", ".join(str(residual.dof) for residual in residuals)
        raise ChannelError(
            f"The equation of motion of DOF {dof} has no residual", f"Choose {known}."
        )


class IntervalsDisplay(Single):
    """Every estimate with its 95 % interval, as percent of the estimate.

    Parameters
    ----------
    figures : sequence of Figure

    Attributes
    ----------
    ax_ : Axes
    figure_ : matplotlib Figure

    Examples
    --------
    >>> from pysindy_nrf import IntervalsDisplay, NRFRegressor, datasets
    >>> model = NRFRegressor(degree=3).fit(datasets.load_demo())
    >>> IntervalsDisplay.from_estimator(model).ax_.get_xlabel()
    'deviation from the estimate (%)'
    """

    @classmethod
    def from_estimator(cls, estimator: Fitted, *, ax: Axes | None = None) -> Self:
        """Draw the intervals of a fitted regressor.

        Parameters
        ----------
        estimator : fitted NRFRegressor
        ax : Axes, optional
            New ones if None.

        Returns
        -------
        IntervalsDisplay

        Raises
        ------
        NRFError
            If there is no interval; the reason is given.
        """
        bounds, reasons = estimator.bounds()
        figure = intervals_figure(parameters_of(estimator.model_), bounds)
        if figure is None:
            raise NRFError(
                " ".join(reasons) or "There is no interval", "See docs/noise.md."
            )
        return cls([figure]).plot(ax)


class ModesDisplay(Single):
    """Shapes of the modes of the linear part, with frequencies and dampings.

    :meth:`plot` draws them at their largest deflection, :meth:`animate` moving.

    Parameters
    ----------
    figures : sequence of Figure

    Attributes
    ----------
    ax_ : Axes
    figure_ : matplotlib Figure

    Examples
    --------
    >>> from pysindy_nrf import ModesDisplay, datasets
    >>> len(ModesDisplay.from_estimator(datasets.demo_truth()).ax_.lines) > 3
    True
    """

    @classmethod
    def from_estimator(
        cls, estimator: ChainModel | Fitted, *, ax: Axes | None = None
    ) -> Self:
        """Draw the modes of a fitted regressor or a model.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        ax : Axes, optional
            New ones if None.

        Returns
        -------
        ModesDisplay
        """
        model = estimator
        if not isinstance(model, ChainModel):
            model = model.model_
        return cls([modes_figure(model.modes())]).plot(ax)

    def animate(self) -> FuncAnimation:
        """Let the modes move on the axes where they are drawn.

        All are slowed down by the same factor, so that the fastest takes 0.8 s for a
        cycle.

        Returns
        -------
        matplotlib.animation.FuncAnimation
            Keep it as long as it is to move; ``save("modes.gif")`` writes one cycle of
            the slowest mode.

        Raises
        ------
        MissingExtraError
            Without matplotlib, which the extra ``plot`` brings.

        Examples
        --------
        >>> import matplotlib.pyplot as plt
        >>> from pysindy_nrf import ModesDisplay, datasets
        >>> shown = ModesDisplay.from_estimator(datasets.demo_truth())
        >>> moving = shown.animate()
        >>> type(moving).__name__
        'FuncAnimation'
        >>> moving.pause()
        >>> plt.close(shown.figure_)
        """
        assert not isinstance(self.ax_, np.ndarray)  # one figure has one pair of axes
        return animated(self.figures()[0], self.ax_)


class StepsDisplay(Single):
    """Held-out errors of the declared model and after each effect of a closed loop.

    Parameters
    ----------
    figures : sequence of Figure

    Attributes
    ----------
    ax_ : Axes
    figure_ : matplotlib Figure

    Examples
    --------
    >>> from pysindy_nrf import StepsDisplay, close_loop, datasets
    >>> report = close_loop(datasets.load_demo(), max_steps=1)
    >>> StepsDisplay.from_report(report).ax_.get_ylabel()
    'held-out balance error (% NRMSE)'
    """

    @classmethod
    def from_report(cls, report: Loop, *, ax: Axes | None = None) -> Self:
        """Draw the steps of a loop.

        Parameters
        ----------
        report : LoopReport
            Of :func:`pysindy_nrf.close_loop`.
        ax : Axes, optional
            New ones if None.

        Returns
        -------
        StepsDisplay
        """
        return cls([before_after_figure(report)]).plot(ax)

    @classmethod
    def from_estimator(cls, report: Loop, *, ax: Axes | None = None) -> Self:
        """The same as :meth:`from_report`."""
        return cls.from_report(report, ax=ax)
