"""The report of the loop: steps, table, reason to stop, model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..common.audit import constants_of, settings_of
from ..diagnosis.site_loops import SiteLoop
from ..diagnosis.verdict import FreeRuns, Verdict, loop_verdict
from ..records.checks.channel_checks import Measured
from ..records.quality import QualityNote
from ..records.record import Record
from ..report import write_html
from ..report.markdown import markdown
from ..report.notebook import loop_html
from ..report.words import BAND_FOUND
from . import constants, words
from .evidence import Evidence


@dataclass
class Step:
    """One effect that the search found: what the search says, and what held-out data
    say of it.

    Attributes
    ----------
    law, family : str
        E.g. ``"coulomb_friction"`` of the family ``"friction"``.
    site : str
        In the grammar of :class:`pysindy_nrf.Site`.
    shape : dict
        Shape parameters by name, SI units, as the search found them.
    parameters, units : dict
        Coefficients by symbol and shape parameters by name, SI units, beside the
        effects found before it; of a faulty sensor, of all corrections together; their
        units, empty for a plain number.
    intervals : dict of str to (float, float)
        95 % intervals of the same, from fold to fold.
    alternatives : list of str
        Other families the data cannot tell from this one (at most two, three with its
        own).
    error_before, error_after : float
        Pooled balance error on the held-out data, percent NRMSE.
    free_run_before, free_run_after : float
        Free-run error on the held-out data, percent NRMSE; NaN where the model could
        not run.
    validation_before : float
        Pooled balance error on the search data, each fold judged after fitting to the
        others, percent NRMSE.
    gain, gain_error, gain_least : float
        Fall of the cross-validated residual, dB; its standard error over folds; the
        gain without the fold that speaks most for the effect.
    gain_heldout : float
        The same fall on held-out data, dB.
    share : float
        What the effect changes of the force at its site, as a share of the storey
        force; NaN for a sensor.
    confirmed : bool
        Whether held-out errors fall, and there or in the search by a tenth; the model
        holds confirmed effects only.
    remainder : float
        Share of the effect (noise taken off) that stays unexplained.
    sure : bool
        Whether the remainder is small enough for the name to be sure.
    evidence : str
        Why the gate accepted it.
    tied : list of (law, site, gain in dB)
        Candidates that the data could not tell from this one when it was accepted.
    sensors : list of str
        For a faulty sensor: others that the data could accuse as well.
    company : list of str
        Other laws of the same variable (rate or drift) at this site: together they may
        write a single law that the catalogue does not hold, so that no name is sure;
        ``remainder`` is then what this one leaves alone.

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
    gain: float = 0.0
    gain_error: float = 0.0
    gain_least: float = 0.0
    gain_heldout: float = float("nan")
    share: float = float("nan")
    confirmed: bool = True
    remainder: float = 0.0
    sure: bool = True
    evidence: str = ""
    tied: list[tuple[str, str, float]] = field(default_factory=list)
    sensors: list[str] = field(default_factory=list)
    company: list[str] = field(default_factory=list)

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor, which is no force."""
        return Site(self.site).kind == "sensor"

    @property
    def sentence(self) -> str:
        """The step in words."""
        held = (
            (k, v, self.units.get(k, ""))
            for k, v in self.parameters.items()
            if v is not None
        )
        values = ", ".join(f"{k} = {v:.4g} {unit}".rstrip() for k, v, unit in held)
        name = f"{self.law} at {self.site}"
        if not self.sure:
            name = (
                f"closest law {name}, unexplained remainder"
                f" {100 * self.remainder:.0f} %"
            )
        text = f"{name} ({values}): {self.evidence}; {words.confirmation(self)}."
        if self.alternatives:
            text += f" The data cannot tell it from: {', '.join(self.alternatives)}."
        if self.company:
            text += (
                f" With {' and '.join(self.company)} there it may stand for one law"
                " that is not in the catalogue."
            )
        if self.sensors:
            text += (
                f" The same fault, reversed, at {' or '.join(self.sensors)} explains as"
                " much."
            )
        return text


class Whole(pd.DataFrame):
    """A table that is printed whole: no row and no column gives way to dots."""

    def __repr__(self) -> str:
        return self.to_string(float_format="{:.4g}".format)


@dataclass
class LoopReport:
    """What the loop found.

    Attributes
    ----------
    steps : list of Step
    table : DataFrame
        One row for the baseline and each step, percent NRMSE: search and validation
        error with all effects found so far; held-out balance error, per balance and
        pooled, and free-run error beside the confirmed ones; the band.
    stopped_because : str
    model : ChainModel
        With the effects in it, fitted to the search data.
    band : tuple or None
        Hz.
    candidates : DataFrame
        The candidates of the last search, best first.
    models : list of ChainModel
        The baseline and the model after each step.
    evidence : list of Evidence
        What was left of the search data after the baseline and after each step: is it
        noise, where does it act, what is it like. See
        :mod:`pysindy_nrf.discrepancy.evidence`.
    measured : list of Measured
        What was measured, for the page.
    loops : list of SiteLoop
        The force of every site of the final model along the search data, thinned for
        drawing.
    settings : dict of str to dict
        Every setting of the run, by group.
    lack_of_fit : DataFrame
        What a general law without memory (:class:`~pysindy_nrf.laws.SmoothSurface`) and
        a general hysteresis (:class:`~pysindy_nrf.laws.PrandtlIshlinskii`) would still
        gain at each storey beside the final model, dB: what no law of the catalogue
        explains.
    bounds : dict of str to (float, float)
        95 % intervals of masses and coefficients, from fold to fold, by the names of
        ``confidence_intervals``.
    free_runs : FreeRuns or None
        The model alone under the measured forces of all records.
    beyond_noise : ndarray of shape (n_dof,)
        Error of each balance of the final model beyond what noise leaves of it,
        percent.
    wiring, faults : str, dict of str to bool
        The mapping of channels with which the balances close, where they do not;
        channels that seem to be reversed or in the wrong column, and whether that is
        sure.
    quality : tuple of QualityNote
        What is known of the channels, clocks and units of the records.
    claims_nothing : bool
        Whether a model this poor claims nothing; ``stopped_because`` says why.

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

    steps: list[Step]
    table: pd.DataFrame
    stopped_because: str
    model: ChainModel
    band: Any = None
    candidates: pd.DataFrame = field(default_factory=pd.DataFrame)
    models: list[ChainModel] = field(default_factory=list)
    evidence: list[Evidence] = field(default_factory=list)
    measured: list[Measured] = field(default_factory=list)
    loops: list[SiteLoop] = field(default_factory=list)
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)
    lack_of_fit: pd.DataFrame = field(default_factory=pd.DataFrame)
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    free_runs: FreeRuns | None = None
    beyond_noise: np.ndarray = field(default_factory=lambda: np.zeros(0))
    wiring: str = ""
    faults: dict[str, bool] = field(default_factory=dict)
    quality: tuple[QualityNote, ...] = ()
    claims_nothing: bool = False

    def __post_init__(self) -> None:
        self.table = Whole(self.table)

    @property
    def final(self) -> pd.Series:
        """The row of the table that belongs to the model: the last confirmed effect's,
        or the baseline's.
        """
        confirmed = [k for k, step in enumerate(self.steps, 1) if step.confirmed]
        return self.table.iloc[
            next(
                (k for k, m in enumerate(self.models) if m is self.model),
                max([0, *confirmed]),
            )
        ]

    @property
    def verdict(self) -> Verdict:
        """Whether the model may be used, what was found, and why not; see
        :mod:`pysindy_nrf.diagnosis.verdict`.
        """
        return loop_verdict(self)

    def __str__(self) -> str:
        lines = [f"{i}. {step.sentence}" for i, step in enumerate(self.steps, 1)] or [
            "No effect was added."
        ]
        return "\n".join([*lines, f"Stopped: {self.stopped_because}."])

    def to_markdown(self) -> str:
        """The report as Markdown.

        Returns
        -------
        str
        """
        return markdown(self)

    def to_html(self, path: Any) -> None:
        """Write the report as one self-contained page that works offline.

        What was measured, the model with its equations, surfaces and loops, the story
        of the loop step by step with its evidence, tables that sort and copy, and every
        setting.

        Parameters
        ----------
        path : path-like
            An older file is replaced whole.

        Raises
        ------
        MissingExtraError
            Without jinja2 or plotly, which the extra ``report`` brings.
        """
        write_html(path, self)

    def _repr_html_(self) -> str:
        return loop_html(self)


def audit(
    settings: Mapping[str, Any], heldout: Sequence[Record]
) -> dict[str, dict[str, str]]:
    """Every setting of a run of the loop: its arguments, the declared model, the
    constants of the decisions.
    """
    band, names = settings["band"], [record.name for record in heldout]
    return settings_of(
        loop={
            "band": BAND_FOUND if band is None else f"{band} Hz",
            "random_state": settings["random_state"],
            "max_steps": settings["max_steps"],
            "calibration": settings["calibration"],
            "held out": "; ".join(names) if names else "a quarter of every record",
            "catalogue": ", ".join(
                dict.fromkeys(law.name for law in settings["catalogue"])
            ),
        },
        baseline=settings["baseline"].get_params(deep=False),
        constants=constants_of(constants),
    )
