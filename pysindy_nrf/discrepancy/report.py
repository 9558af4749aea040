"""The report of the loop: steps, table, reason to stop, model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..diagnosis.evidence import Evidence
from ..diagnosis.facts import Alternative, AmbiguousInterval
from ..diagnosis.site_loops import SiteLoop
from ..diagnosis.verdict import FreeRuns, Verdict, loop_verdict
from ..drawing.matplotlib_renderer import Drawing
from ..identification.result import IdentificationResult
from ..records.checks.channel_checks import Measured
from ..records.quality import QualityNote
from ..report import write_html
from ..report.loop_content import pictures
from ..report.markdown import markdown
from ..report.notebook import loop_html
from ..report.summary import Summary, summary_of
from ..report.words import band_text
from . import wording

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Step:
    """One effect that the search found.

    With its size and its effect on errors, in the search and on held-out data.

    Attributes
    ----------
    law, family : str
        E.g. ``"coulomb_friction"`` of the family ``"friction"``: the name that carries
        the model, or its general law (``"general_hysteresis"``).
    site : str
        In the grammar of :class:`pysindy_nrf.Site`.
    effect_class : str
        What kind of thing it is: ``"memoryless"``, ``"hysteresis"``, ``"change in
        time"``, ``"inertial"``, ``"tie"``, ``"outside force"``, ``"sensor error"``.
    closest : str
        Name of the law of the class that comes closest.
    closest_share : float
        Part of the error reduction, in dB, that the closest name has by itself.
    carries : bool
        Whether the name carries the model, and not the general law of the class.
    judged_by : str
        What judged it: ``"another record"``, ``"another amplitude"``, ``"another
        time"``.
    judged_reduction, judged_error : float
        Error reduction there, dB, and its standard error.
    shape : dict
        Shape parameters by name, SI units, as the search found them.
    parameters, units : dict
        Coefficients by symbol and shape parameters by name, SI units, with the effects
        that came before it. For a faulty sensor, those of all corrections together.
        Their units are empty for a plain number.
    intervals : dict of str to (float, float)
        95 % intervals of the same, from fold to fold.
    alternatives : list of str
        Other families that explain the data as well (at most two, three with its
        own).
    error_before, error_after : float
        Pooled balance error on the held-out data, percent NRMSE.
    free_run_before, free_run_after : float
        Free-run error on the held-out data, percent NRMSE; NaN where the model could
        not run.
    validation_before : float
        Pooled balance error on the search data, each fold judged after fitting to the
        others, percent NRMSE.
    reduction, reduction_error, reduction_least : float
        Reduction of the cross-validated residual, dB; its standard error over folds;
        the reduction without the fold that contributes most.
    reduction_heldout : float
        The same reduction on held-out data, dB.
    share : float
        What the effect changes of the force at its site, as a share of the storey
        force; NaN for a sensor.
    confirmed : bool
        Whether the effect holds at the condition that judged it; the model has
        confirmed effects only.
    remainder : float
        Share of the effect (noise taken off) that stays unexplained.
    sure : bool
        Whether another record has judged it, its name carries the model, and the
        records refute every other name and place.
    evidence : str
        Why it was accepted.
    rivals : list of (law, site, error reduction in dB)
        Candidates that explained the data as well when it was accepted, or that the
        record that judged it does not refute.
    sensors : list of str
        For a faulty sensor: others that the data could accuse as well.
    laws_beside : list of str
        Other laws of the same variable (rate or drift) at this site: together they may
        stand for a single law that the catalogue lacks, so that no name is
        sure; ``remainder`` is then what this one leaves alone.

    Examples
    --------
    >>> from pysindy_nrf.discrepancy import Step
    >>> found = {"Fc": 20.3}  # N
    >>> step = Step(
    ...     "coulomb_friction",
    ...     "friction",
    ...     "storey 2",
    ...     parameters=found,
    ...     intervals={"Fc": (19.8, 20.8)},
    ... )
    >>> step.law, step.site, step.intervals["Fc"], step.sure
    ('coulomb_friction', 'storey 2', (19.8, 20.8), True)
    """

    law: str
    family: str
    site: str
    shape: dict[str, float | None] = field(default_factory=dict)
    parameters: dict[str, float | None] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    alternatives: list[str] = field(default_factory=list)
    error_before: float = float("nan")
    error_after: float = float("nan")
    free_run_before: float = float("nan")
    free_run_after: float = float("nan")
    validation_before: float = float("nan")
    reduction: float = 0.0
    reduction_error: float = 0.0
    reduction_least: float = 0.0
    reduction_heldout: float = float("nan")
    share: float = float("nan")
    confirmed: bool = True
    remainder: float = 0.0
    sure: bool = True
    evidence: str = ""
    rivals: list[tuple[str, str, float]] = field(default_factory=list)
    sensors: list[str] = field(default_factory=list)
    laws_beside: list[str] = field(default_factory=list)
    effect_class: str = ""
    closest: str = ""
    closest_share: float = 1.0
    carries: bool = True
    judged_by: str = ""
    judged_reduction: float = float("nan")
    judged_error: float = float("nan")

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor, which is no force."""
        return Site(self.site).kind == "sensor"

    @property
    def sentence(self) -> str:
        """The step in words."""
        return wording.step_sentence(self)


class WholeTable(pd.DataFrame):
    """A table that is printed in full: no row and no column gives way to dots."""

    def __repr__(self) -> str:
        return self.to_string(float_format="{:.4g}".format)


@dataclass(frozen=True)
class LoopReport:
    """What the loop found.

    Attributes
    ----------
    steps : list of Step
    table : DataFrame
        One row for the baseline and each step, percent NRMSE: search and validation
        error with all effects found so far; held-out balance error, per balance and
        pooled, and free-run error after the confirmed ones; the band.
    stopped_because : str
    model : ChainModel
        With the confirmed effects in it, as finally estimated.
    band : tuple or None
        Hz.
    candidates : DataFrame
        The candidates of the last search, best first.
    models : list of ChainModel
        The baseline and the model after each step.
    evidence : list of Evidence
        What was left of the search data after the baseline and after each step: is it
        noise, where does it act, what is it like. See
        :mod:`pysindy_nrf.diagnosis.evidence`.
    measured : list of Measured
        What was measured, for the page.
    loops : list of SiteLoop
        The force of every site of the final model along the search data, thinned for
        drawing.
    settings : dict of str to dict
        Every setting of the run, by group.
    lack_of_fit : DataFrame
        What the general law of each class would still gain at each storey when the
        search ended, dB.
    bounds : dict of str to (float, float)
        95 % intervals of masses and coefficients, by the names of
        ``confidence_intervals``.
    free_runs : FreeRuns or None
        The model alone under the measured forces of all records.
    beyond_noise : ndarray of shape (n_dof,)
        Error of each balance of the final model beyond what noise leaves of it,
        percent.
    alternatives : tuple of Alternative
        What the data allow besides the model, the one that leaves least first.
    ambiguous_intervals : tuple of AmbiguousInterval
        Intervals of ``bounds`` that alternatives widen, or that are withheld for them.
    unseen_drifts : dict of int to float
        Noise over rms of the drift of each storey that noise hides.
    wiring, faults : str, dict of str to bool
        The mapping of channels with which the balances close, where they do not;
        channels that seem to be reversed or in the wrong column, and whether that is
        sure.
    quality : tuple of QualityNote
        What is known of the quality of the records.
    nothing_claimed : bool
        Whether the model is too far from the data for any claim; ``stopped_because``
        gives the reason.
    identified : IdentificationResult or None
        The final estimate, by the method that :class:`~pysindy_nrf.NRFRegressor`
        chooses for the laws of ``model`` in the band of the search; None where its
        method cannot fit them, and the estimates are those of the search.

    Examples
    --------
    >>> import pandas as pd
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.discrepancy import LoopReport, Step
    >>> model = ChainModel(
    ...     [10.0],
    ...     {1: [laws.PowerSeries(1, [30.0, 4e4]), laws.CoulombFriction(20.3)]},
    ... )
    >>> step = Step(
    ...     "coulomb_friction",
    ...     "friction",
    ...     "storey 1",
    ...     error_before=31.0,
    ...     error_after=2.0,
    ... )
    >>> table = pd.DataFrame(
    ...     {"held-out": [31.0, 2.0]},
    ...     index=["baseline", "coulomb_friction at storey 1"],
    ... )
    >>> report = LoopReport(
    ...     [step],
    ...     table,
    ...     "No law of the catalogue lowers the error at any site.",
    ...     model,
    ... )
    >>> (
    ...     [(step.law, step.site) for step in report.steps],
    ...     report.table["held-out"].tolist(),
    ... )
    ([('coulomb_friction', 'storey 1')], [31.0, 2.0])
    """

    steps: Sequence[Step]
    table: pd.DataFrame
    stopped_because: str
    model: ChainModel
    band: tuple[float | None, float | None] | None = None
    candidates: pd.DataFrame = field(default_factory=pd.DataFrame)
    models: Sequence[ChainModel] = ()
    evidence: Sequence[Evidence] = ()
    measured: Sequence[Measured] = ()
    loops: Sequence[SiteLoop] = ()
    settings: dict[str, dict[str, str]] = field(default_factory=dict)
    lack_of_fit: pd.DataFrame = field(default_factory=pd.DataFrame)
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    free_runs: FreeRuns | None = None
    beyond_noise: np.ndarray = field(default_factory=lambda: np.zeros(0))
    alternatives: tuple[Alternative, ...] = ()
    ambiguous_intervals: tuple[AmbiguousInterval, ...] = ()
    unseen_drifts: dict[int, float] = field(default_factory=dict)
    wiring: str = ""
    faults: dict[str, bool] = field(default_factory=dict)
    quality: tuple[QualityNote, ...] = ()
    nothing_claimed: bool = False
    identified: IdentificationResult | None = None

    @property
    def final(self) -> pd.Series:
        """The row of the table that belongs to the model.

        That of the last confirmed effect, or of the baseline.
        """
        for row, model in enumerate(self.models):
            if model is self.model:
                return self.table.iloc[row]
        confirmed = [k for k, step in enumerate(self.steps, 1) if step.confirmed]
        return self.table.iloc[max([0, *confirmed])]

    @property
    def verdict(self) -> Verdict:
        """Whether the model may be used, what was found, and why not.

        See :mod:`pysindy_nrf.diagnosis.verdict`.
        """
        return loop_verdict(self)

    def __str__(self) -> str:
        lines = [f"{i}. {step.sentence}" for i, step in enumerate(self.steps, 1)]
        lines = lines or ["No effect was added."]
        return "\n".join([*lines, f"Stopped: {self.stopped_because}."])

    def summary(self) -> Summary:
        """Estimates with errors, intervals, units and shares of the forces.

        Returns
        -------
        Summary
            ``str`` prints it; ``to_frame``, ``as_html``, ``as_latex``. Where the final
            estimate is that of the search, intervals are from fold to fold, without
            standard errors.
        """
        if self.identified is not None:
            return replace(self.identified.summary(), verdict=self.verdict)
        n_forces = sum(bool(laws) for laws in self.model.laws.values())
        return Summary(
            f"Closed loop: {self.model.n_dof} masses and {n_forces} restoring forces",
            [("band", band_text(self.band))],
            summary_of(self.model, self.bounds, {}, {}, {}),
            self.verdict,
        )

    def plot(self, ax: Axes | Sequence[Axes] | np.ndarray | None = None) -> Drawing:
        """Draw errors before and after, the missing force and the free run.

        The missing force is drawn with the law that was found over it (matplotlib).

        Parameters
        ----------
        ax : sequence of Axes, optional
            New ones if None.

        Returns
        -------
        Drawing
            With ``ax_`` and ``figure_``.
        """
        return Drawing(pictures(self)).plot(ax)

    def to_markdown(self) -> str:
        """The report as Markdown.

        Returns
        -------
        str
        """
        return markdown(self)

    def to_html(self, path: str | PathLike[str]) -> None:
        """Write the report as one self-contained page that works offline.

        What was measured, the model with its equations, surfaces and loops, the story
        of the loop step by step with its evidence, tables that sort and copy, and every
        setting.

        Parameters
        ----------
        path : path-like
            An older file is replaced completely.

        Raises
        ------
        MissingExtraError
            Without jinja2 or plotly, which the extra ``report`` brings.
        """
        write_html(path, self)

    def _repr_html_(self) -> str:
        return loop_html(self)
