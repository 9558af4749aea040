"""The report of the loop: steps, table, reason to stop, model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ..common.audit import constants_of, settings_of
from ..common.lazy import Hook
from ..exceptions import NRFError
from ..laws.base import ForceLaw
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel
from ..regression.chain_solve import Solution, model_of
from ..regression.domains import VisitedRegion
from ..regression.errors import balance_errors, free_run_error
from ..signals.channel_checks import Measured
from .evidence import Evidence, gather, searched
from .noise_floor import NoiseFloor
from .prepare import Prepared, measured_of
from .search import Finding
from .site_loops import SiteLoop, loops_of
from .stage import Stage, Trial
from .workspace import Workspace


@dataclass
class Scene:
    """A model on the way: its laws and its validation errors; masses and coefficients, if not those of the trial."""

    name: str
    trial: Trial
    folds: np.ndarray
    null: Any = None
    floor: NoiseFloor | None = None
    found: Solution | None = None

    @property
    def noise(self) -> list[Stage]:
        """The model's laws on surrogate records of it with nothing but noise; empty where there are none."""
        return list(getattr(self.null, "stages", ()))


@dataclass
class Step:
    """One accepted effect.

    Attributes
    ----------
    law, family : str
        E.g. ``"coulomb_friction"`` of the family ``"friction"``.
    site : str
        In the grammar of :class:`pysindy_nrf.Site`.
    shape : dict
        Shape parameters by name, SI units, as the search found them.
    parameters : dict
        Coefficients by symbol and shape parameters by name, SI units, in the final model; of a faulty sensor, of all
        corrections together.
    intervals : dict of str to (float, float)
        95 % intervals of the same, from block to block and from the noise in the motion; empty for an
        effect that another took the place of.
    bias : dict of str to float
        By which share noise alone makes a coefficient of least squares wrong, as seen on surrogates of the final model.
    alternatives : list of str
        Other families the data cannot tell from this one (at most two, three with its own).
    error_before, error_after : float
        Pooled balance error on the held-out data, percent NRMSE.
    free_run_before, free_run_after : float
        Free-run error on the held-out data, percent NRMSE; NaN where the model could not run.
    validation_before, validation_after : float
        Median over the search blocks, each judged after fitting to the others.
    gain, wins, null_gain : float
        Fall of the median, share of blocks won, largest gain on surrogates without the effect (NaN if none was run).
    noise_floor : float
        Median error that noise alone leaves, percent; NaN if no surrogate could be run.
    remainder : float
        Share of the effect (noise taken off) that stays unexplained.
    sure : bool
        Whether the remainder is small enough for the name to be sure.
    evidence : str
        Why the gate accepted it.
    detection, localisation, characterisation : str
        What the residual before this step looked like, gathered without any law: whether it was noise,
        where it acted (and whether that agrees with ``site``), what it depended on.
    tied, runners_up : list of (law, site, validation error)
    sensors : list of str
        For a faulty sensor: others that the data could accuse as well.
    company : list of str
        Other laws of the same variable (rate or drift) at this site: together they may write a single law that
        the catalogue does not hold, so that no name is sure; ``remainder`` is then what this one leaves alone.

    Examples
    --------
    >>> from pysindy_nrf.discrepancy import Step
    >>> found = {"Fc": 20.3}  # N
    >>> step = Step("coulomb_friction", "friction", "storey 2", parameters=found, intervals={"Fc": (19.8, 20.8)})
    >>> step.law, step.site, step.intervals["Fc"], step.sure
    ('coulomb_friction', 'storey 2', (19.8, 20.8), True)
    """

    law: str
    family: str
    site: str
    shape: dict[str, float | None] = field(default_factory=dict)
    parameters: dict[str, float | None] = field(default_factory=dict)
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    bias: dict[str, float] = field(default_factory=dict)
    alternatives: list[str] = field(default_factory=list)
    error_before: float = float("nan")
    error_after: float = float("nan")
    free_run_before: float = float("nan")
    free_run_after: float = float("nan")
    validation_before: float = float("nan")
    validation_after: float = float("nan")
    gain: float = 0.0
    wins: float = 0.0
    null_gain: float = 0.0
    noise_floor: float = float("nan")
    remainder: float = 0.0
    sure: bool = True
    evidence: str = ""
    detection: str = ""
    localisation: str = ""
    characterisation: str = ""
    tied: list[tuple[str, str, float]] = field(default_factory=list)
    runners_up: list[tuple[str, str, float]] = field(default_factory=list)
    sensors: list[str] = field(default_factory=list)
    company: list[str] = field(default_factory=list)

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor, which is no force."""
        return Site(self.site).kind == "sensor"

    @property
    def sentence(self) -> str:
        """The step in words."""
        values = ", ".join(f"{k} = {v:.4g}" for k, v in self.parameters.items() if v is not None)
        name = (
            f"{self.law} at {self.site}"
            if self.sure
            else f"closest law {self.law} at {self.site}, unexplained remainder {100 * self.remainder:.0f} %"
        )
        change = f"held-out balance error {self.error_before:.3g} to {self.error_after:.3g} %"
        text = f"{name} ({values}): {self.evidence}; {change}."
        if self.alternatives:
            text += f" The data cannot tell it from: {', '.join(self.alternatives)}."
        if self.company:
            text += f" With {' and '.join(self.company)} there it may stand for one law that is not in the catalogue."
        if self.sensors:
            text += f" The same fault, reversed, at {' or '.join(self.sensors)} explains as much."
        return text


@dataclass
class LoopReport:
    """What the loop found.

    Attributes
    ----------
    steps : list of Step
    table : DataFrame
        One row for the baseline and each step: search, validation, held-out balance error, per
        balance and pooled, and free-run error, percent NRMSE; the band.
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
        What was left of the search data after the baseline and after each step: is it noise, where does it
        act, what is it like. See :mod:`pysindy_nrf.discrepancy.evidence`.
    measured : list of Measured
        What was measured, for the page.
    loops : list of SiteLoop
        The force of every site of the final model along the search data, thinned for drawing.
    settings : dict of str to dict
        Every setting of the run, by group.

    Examples
    --------
    >>> import pandas as pd
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.discrepancy import LoopReport, Step
    >>> model = ChainModel([10.0], {1: [laws.PowerSeries(1, [30.0, 4e4]), laws.CoulombFriction(20.3)]})
    >>> step = Step("coulomb_friction", "friction", "storey 1", error_before=31.0, error_after=2.0)
    >>> table = pd.DataFrame({"held-out": [31.0, 2.0]}, index=["baseline", "coulomb_friction at storey 1"])
    >>> report = LoopReport([step], table, "No law of the catalogue lowers the error at any site.", model)
    >>> [(step.law, step.site) for step in report.steps], report.table["held-out"].tolist()
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

    @classmethod
    def assemble(
        cls,
        work: Workspace,
        scenes: Sequence[Scene],
        steps: list[Step],
        stopped: str,
        ranking: Sequence[Finding],
        band: Any,
        ready: Any,
    ) -> LoopReport:
        """Fit every scene to the search data and read the held-out data, once, at the end.

        Parameters
        ----------
        work : Workspace
        scenes : sequence of Scene
            The baseline and the model after each step.
        steps : list of Step
        stopped : str
            Why the search ended.
        ranking : sequence of Finding
            The candidates of the last search, best first.
        band : tuple or None
            Hz.
        ready : Prepared
            What was measured, after fusion.

        Returns
        -------
        LoopReport
        """
        search = range(len(work.search))
        held = range(len(work.search), len(work.blocks))
        rows: dict[str, dict[str, float]] = {}
        models = []
        for scene in scenes:
            trial = scene.trial
            solution = scene.found or trial.solve(search)
            model = model_of(trial.layout, solution)
            models.append(model)
            errors = balance_errors(model, trial.total(held))["error"]
            row = {
                "search": trial.error(solution, search),
                "validation": float(np.median(scene.folds)),
                "held-out": float(errors["pooled"]),
                "free run": free_run_error(model, trial.work, trial.work.held),
                **{f"held-out {name}": float(e) for name, e in errors.items() if name != "pooled"},
            }
            rows[scene.name if scene.name not in rows else f"{scene.name} ({len(rows)})"] = row
        table = pd.DataFrame.from_dict(rows, orient="index")
        table["band"] = (
            "full" if band is None else f"{band[0] or 0:g}-{band[1] if band[1] is not None else np.inf:g} Hz"
        )
        model = models[-1]
        for site in model.laws:
            try:
                seen = [(work.motion(site, b.segment), b.rows) for b in work.search]
            except (NRFError, IndexError):
                continue
            v, s = (np.concatenate([getattr(m, k)[rows] for m, rows in seen]) for k in "vs")
            model.visited[Site(site)] = VisitedRegion.of(v, s)
        model.info = {
            "band": None if band is None else list(band),
            "steps": [s.law + " at " + s.site for s in steps],
            "stopped_because": stopped,
        }
        for step, before, after in zip(steps, table.index, table.index[1:]):
            step.error_before, step.error_after = (
                float(table.loc[before, "held-out"]),
                float(table.loc[after, "held-out"]),
            )
            step.free_run_before, step.free_run_after = (
                float(table.loc[before, "free run"]),
                float(table.loc[after, "free run"]),
            )
            if not step.parameters:  # another took its place: as it stood last
                ever = [law for m in reversed(models) for law in m.laws.get(Site(step.site), ())]
                step.parameters = next((law.parameters for law in ever if law.name == step.law), {})
        listed = pd.DataFrame(
            [[f.law.name, f.law.family, str(f.site), f.error] for f in ranking],
            columns=["law", "family", "site", "validation error (%)"],
        )
        evidence = gather(scenes, models, steps)
        if evidence[-1].couplings:
            stopped += f". {evidence[-1].coupling_sentence}"
            model.info["stopped_because"] = stopped
        loops = loops_of(model, *searched(scenes[-1].trial.work))
        return cls(steps, table, stopped, model, band, listed, models, evidence, measured_of(ready), loops)

    def __str__(self) -> str:
        lines = [f"{i}. {step.sentence}" for i, step in enumerate(self.steps, 1)] or ["No effect was added."]
        return "\n".join([*lines, f"Stopped: {self.stopped_because}."])

    def to_markdown(self) -> str:
        """The report as Markdown.

        Returns
        -------
        str
        """
        return str(Hook.LOOP_MARKDOWN(self))

    def to_html(self, path: Any) -> None:
        """Write the report as one self-contained page that works offline.

        What was measured, the model with its equations, surfaces and loops, the story of the loop step by
        step with its evidence, tables that sort and copy, and every setting.

        Parameters
        ----------
        path : path-like
            An older file is replaced whole.

        Raises
        ------
        MissingExtraError
            Without jinja2 or plotly, which the extra ``report`` brings.
        """
        Hook.PAGE(path, self)

    def _repr_html_(self) -> str:
        return str(Hook.LOOP_HTML(self))


def audit(
    baseline: Any,
    tried: Sequence[ForceLaw],
    band: Any,
    random_state: Any,
    max_steps: int,
    n_surrogates: int,
    ready: Prepared,
    noise_floor: str = "",
) -> dict[str, dict[str, str]]:
    """Every setting of a run of the loop: its arguments, the declared model, the thresholds of the gate."""
    from . import gate, splits

    held = ready.heldout
    return settings_of(
        loop={
            "band": "full" if band is None else f"{band} Hz",
            "random_state": random_state,
            "max_steps": max_steps,
            "n_surrogates": n_surrogates,
            "noise floor": noise_floor,
            "held out": "a quarter of every record"
            if held is None
            else "; ".join(ready.records[i].name for i in held),
            "catalogue": ", ".join(dict.fromkeys(law.name for law in tried)),
        },
        baseline=baseline.get_params(deep=False),
        gate=constants_of(gate),
        blocks=constants_of(splits),
    )
