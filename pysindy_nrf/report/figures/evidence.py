"""Figures of what a model leaves: residuals, and what explains them."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...chain.restoring_force import RestoringForce
from ...common.unit_system import TRANSLATION, UnitSystem
from ...diagnosis.effects import plain_name
from ...diagnosis.evidence import (
    Characterisation,
    Detection,
    Evidence,
    NoiseFloor,
)
from ...diagnosis.site_loops import SiteLoop
from ...drawing.figure import (
    CYCLE,
    Axis,
    Bars,
    Figure,
    Line,
    Mark,
    Table,
    dof_words,
    rms,
    table,
)
from ..results import Loop

# Word and unit of the variables over which the mean of a missing force is drawn.
_VARIABLES = {"s": ("drift s", "m"), "v": ("rate v", "m/s")}
_DEPENDENCES = {
    "constant": "nothing (constant)",
    "linear": "s, v, a linearly",
    "line": "a spectral line",
    "path": "the path (memory)",
}
# Sites that are drawn, and that the table lists.
DRAWN_SITES, LISTED_SITES = 8, 20
# Upper end of an axis of shares, percent, and of one of errors, times the largest.
SHARE_LIMIT, ERROR_HEADROOM = 105.0, 1.15


def evidence_figures(
    evidence: Evidence, units: UnitSystem, means: bool = True
) -> list[Figure]:
    """What can be drawn of one step of the loop.

    Residual, detection, localisation, dependence and, with ``means``, the mean of the
    missing force over drift and rate.
    """
    figures = [residual_figure(evidence.sizes, evidence.floor, units)]
    if evidence.detection is not None:
        figures.append(_detection_figure(evidence.detection))
    if evidence.localisation is not None and evidence.site:
        sites = evidence.localisation.table
        figures.append(localisation_figure(sites, evidence.chosen))
    drawn = [figure for figure in figures if figure is not None]
    if evidence.characterisation is not None:
        where = f" at {evidence.site}"
        drawn += dependence_figures(evidence.characterisation, where, units, means)
    return drawn


def _variable(name: str, units: UnitSystem) -> tuple[str, str]:
    """Word and unit of a variable."""
    word, unit = _VARIABLES[name]
    return word, units.of(unit)


def _height_of_lying_bars(n_bars: int) -> float:
    """Height of a figure on the sheet, inches."""
    return 1.0 + 0.3 * n_bars


# -- residual ------------------------------------------------------------------


def residual_figure(
    sizes: pd.DataFrame,
    floor: NoiseFloor | None = None,
    units: UnitSystem = TRANSLATION,
) -> Figure | None:
    """Residual of each balance and storey, and what noise alone leaves.

    Parameters
    ----------
    sizes : DataFrame
        ``rms`` (N), ``percent``, ``reference`` (N) and ``of`` by ``"dof j"`` and
        ``"storey i"``.
    floor : NoiseFloor, optional
    units : UnitSystem
        Of the model.

    Returns
    -------
    Figure or None
        None if no residual is known.
    """
    if len(sizes):
        sizes = sizes[np.isfinite(sizes["percent"])]
    if sizes.empty:
        return None
    names = [dof_words(name) for name in sizes.index]
    of_balances = sizes.index.str.startswith("dof")
    colors = np.where(of_balances, "sky", "blue").tolist()
    noise = _noise_percent(sizes, floor)
    marks: list[Mark] = [Bars(sizes["percent"], color=colors)]
    caption = (
        "DOF: error of its force balance. Storey: the force that is missing across it."
    )
    if np.isfinite(noise).any():
        heights = np.arange(len(noise))
        marks = [
            Bars(sizes["percent"], "residual", colors),
            Line(noise, heights, "noise alone", "red", 0, "", "|"),
        ]
        caption += " The red mark is what noise alone would leave."

    largest = float(np.nanmax([*sizes["percent"], *noise]))
    shown = sizes[["rms", "percent", "of"]].assign(noise=noise).set_axis(names, axis=0)
    head = {
        "rms": f"residual rms ({units.force})",
        "percent": "residual (%)",
        "of": "percent of",
        "noise": "noise alone (%)",
    }
    return Figure(
        "Residual: how much is left",
        marks,
        Axis("residual", "% of its reference", (0, ERROR_HEADROOM * largest or 1.0)),
        Axis(ticks=names),
        lying=True,
        size=(5.0, _height_of_lying_bars(len(names))),
        alt=(
            "Residual of each balance and storey in percent; the largest is"
            f" {sizes['percent'].max():.3g} in {sizes['percent'].idxmax()}."
        ),
        caption=caption,
        table=table("Residual on the search data", shown, head, index="where"),
    )


def _noise_percent(sizes: pd.DataFrame, floor: NoiseFloor | None) -> np.ndarray:
    """What noise alone leaves, percent of each reference; NaN where unknown."""
    percent = np.full(len(sizes), np.nan)
    if floor is not None:
        level = np.array([floor.rms_at(str(where)) for where in sizes.index])
        reference = sizes["reference"].to_numpy()
        np.divide(100 * level, reference, out=percent, where=reference > 0)
    return percent


# -- detection and localisation ------------------------------------------------


def _detection_figure(detection: Detection) -> Figure | None:
    """What the motion explains of the residual; None where nothing was asked."""
    shares = detection.verdicts[["linear share", "nonlinear share", "verdict"]].dropna()
    if shares.empty:
        return None
    linear, rest = 100 * shares["linear share"], 100 * shares["nonlinear share"]
    names = [dof_words(name) for name in shares.index]
    verdicts = [verdict.value for verdict in shares["verdict"]]
    shown = pd.DataFrame({"linear": linear, "rest": rest, "verdict": verdicts})
    head = {
        "linear": "linear (%)",
        "rest": "of the rest, nonlinear (%)",
        "verdict": "verdict",
    }
    return Figure(
        "Detection: what the motion explains of the residual",
        [
            Bars(linear, "linearly", "sky"),
            Bars(rest, "of the rest, nonlinearly", "blue"),
        ],
        Axis("explained on data left out", "%", (0, SHARE_LIMIT)),
        Axis(ticks=names),
        lying=True,
        size=(5.0, _height_of_lying_bars(2 * len(names))),
        alt=(
            f"Nonlinear laws of its own motion explain at most {rest.max():.0f}"
            f" percent, in {rest.idxmax()}."
        ),
        caption=(
            "Linearly: by all drifts, rates and inputs. Nonlinearly: by laws of its own"
            " motion."
        ),
        table=table(
            "What the motion explains of the residual",
            shown.set_axis(names),
            head,
            index="where",
        ),
    )


@dataclass(frozen=True, eq=False)
class _Pattern:
    """Sites that no balance distinguishes, and the row of the first of them."""

    sites: list[str]
    row: pd.Series

    @property
    def name(self) -> str:
        """The first site, whether there are others, and the signs in the balances."""
        name = self.sites[0]
        if len(self.sites) > 1:
            name += f" or {self.sites[1]}"
        if len(self.sites) > 2:
            name += ", …"
        return f"{name}  ({self.row['balances']})"


def localisation_figure(sites: pd.DataFrame, chosen: str = "") -> Figure | None:
    """Share of the residual that a force at each site explains.

    Sites that no balance distinguishes share a bar.

    Parameters
    ----------
    sites : DataFrame
        ``share``, ``low``, ``high``, ``own`` (percent), ``balances`` and ``pattern`` by
        site, best first.
    chosen : str
        The site that the loop chose; it is always drawn.

    Returns
    -------
    Figure or None
        None if there are fewer than two patterns.
    """
    sites = sites[sites["share"].notna()]
    patterns = _patterns_of(sites)
    if len(patterns) < 2:
        return None
    patterns = _drawn_patterns(patterns, chosen)

    colors = ["blue"] + ["sky"] * (len(patterns) - 1)
    caption = (
        "By the pattern of signs across the balances (Newton's third law); lines are"
        " about 95 %."
    )
    for k, pattern in enumerate(patterns):
        if chosen in pattern.sites:
            colors[k] = "orange"
            caption += " Orange: the site the loop chose."

    rows = pd.DataFrame([pattern.row for pattern in patterns])
    low, high = rows["low"].clip(0, 100), rows["high"].clip(0, 100)
    head = {
        "share": "explains (%)",
        "low": "from (%)",
        "high": "to (%)",
        "own": "follows its own motion (%)",
        "balances": "signs in the balances",
    }
    listed = sites.head(LISTED_SITES)
    return Figure(
        "Localisation: where the missing force acts",
        [Bars(rows["share"], color=colors, low=low, high=high)],
        Axis("residual explained by a force there", "%", (0, SHARE_LIMIT)),
        Axis(ticks=[pattern.name for pattern in patterns]),
        lying=True,
        size=(5.0, _height_of_lying_bars(len(patterns))),
        alt=(
            f"A force at {sites.index[0]} would explain {rows['share'].iloc[0]:.0f}"
            " percent of the residual."
        ),
        caption=caption,
        table=table(
            "Sites by the share of the residual that a force there would explain",
            listed[[name for name in head if name in listed]],
            head,
            index="site",
        ),
    )


def _patterns_of(sites: pd.DataFrame) -> list[_Pattern]:
    """Groups of sites that no balance distinguishes, best first."""
    patterns = []
    for _, rows in sites.groupby("pattern", sort=False):
        patterns.append(_Pattern(list(rows.index), rows.iloc[0]))
    return patterns


def _drawn_patterns(patterns: Sequence[_Pattern], chosen: str) -> list[_Pattern]:
    """The best patterns; the one that was chosen takes the place of the last."""
    best = list(patterns[:DRAWN_SITES])
    for pattern in patterns[DRAWN_SITES:]:
        if chosen in pattern.sites:
            best[-1] = pattern
    return best


# -- characterisation ----------------------------------------------------------


def dependence_figures(
    characterisation: Characterisation,
    where: str = "",
    units: UnitSystem = TRANSLATION,
    means: bool = True,
) -> list[Figure]:
    """What a force depends on, without any formula.

    With ``means`` its mean over drift and rate, too.
    """
    shares = characterisation.shares
    names = [_DEPENDENCES.get(str(name), str(name)) for name in shares.index]
    head = {
        "share": "explains (%)",
        "low": "from (%)",
        "high": "to (%)",
        "gain": "more than linear (points)",
    }
    bars = Bars(
        shares["share"].clip(lower=0),
        color=["blue" if chosen else "sky" for chosen in shares["chosen"]],
        low=shares["low"].clip(0, 100),
        high=shares["high"].clip(0, 100),
    )
    figures = [
        Figure(
            f"Characterisation: what the force{where} depends on",
            [bars],
            Axis("explained on data left out", "%", (0, SHARE_LIMIT)),
            Axis(ticks=names),
            lying=True,
            size=(4.2, 3.2),
            alt=characterisation.sentence,
            caption=(
                "Without any formula. Highlighted: the simplest that explains nearly as"
                " much as the best."
            ),
            table=table(
                "Share of the missing force that is a function of",
                shares[list(head)].set_axis(names),
                head,
                index="of",
            ),
        )
    ]
    for variable in _VARIABLES:
        if means and variable in characterisation.curves:
            figures.append(
                _mean_figure(characterisation.curves[variable], variable, where, units)
            )
    return figures


def _mean_figure(
    curve: pd.DataFrame, variable: str, where: str, units: UnitSystem
) -> Figure:
    """Mean force in bins of one variable, with twice its error."""
    word, unit = _variable(variable, units)
    head = {
        "centre": f"{word} ({unit})",
        "mean": f"mean force ({units.force})",
        "error": f"its error ({units.force})",
        "count": "samples",
    }
    mean, error = curve["mean"], 2 * curve["error"]
    shown = curve[list(head)].astype({"count": int})
    return Figure(
        f"The missing force{where} against its {word.split()[0]}",
        [Line(curve["centre"], mean, width=1.6, marker="o", error=error)],
        Axis(word, unit),
        Axis("mean missing force", units.force, zero=True),
        alt=(
            f"Mean missing force from {mean.iloc[0]:.3g} {units.force} at the lowest"
            f" {word} to {mean.iloc[-1]:.3g} {units.force} at the highest."
        ),
        caption="Mean in bins of equal count, with twice its error.",
        table=table(f"Mean missing force{where}", shown, head),
        size=(3.4, 3.2),
        height=280,
    )


# -- the loop ------------------------------------------------------------------


def before_after_figure(report: Loop) -> Figure:
    """Held-out errors of the baseline and after each effect of a closed loop."""
    held_out = report.table.filter(like="held-out")
    if held_out.shape[1] == 2:  # the error of the only balance is the pooled one
        held_out = held_out[["held-out"]]
    groups = ["pooled"]
    for name in held_out.columns[1:]:
        groups.append(dof_words(name.removeprefix("held-out ")))

    errors = held_out.to_numpy(dtype=float)
    models = [plain_name(name) for name in held_out.index]
    models[1:] = [f"+ {name}" for name in models[1:]]
    marks = [Bars(errors[0], models[0], "muted")]
    colors = itertools.cycle((*CYCLE, "muted"))
    for step, name, row, color in zip(report.steps, models[1:], errors[1:], colors):
        if not step.confirmed:
            name = f"{name} (not confirmed)"
        marks.append(Bars(row, name, color, hatched=not step.confirmed))

    first, last = errors[0, 0], report.final["held-out"]
    return Figure(
        "Held-out balance error before and after",
        marks,
        Axis(ticks=groups),
        Axis("held-out balance error", "% NRMSE", (0, 1.25 * np.nanmax(errors))),
        alt=(
            f"Held-out error by balance; {groups[0]}: from {first:.3g} to {last:.3g}"
            " percent."
        ),
        caption="Data that neither the search nor any fit has seen.",
        table=table(
            "Held-out balance error, percent NRMSE",
            pd.DataFrame(errors, models, groups),
            index="model",
        ),
        wide=True,
        height=280,
    )


# -- the missing force, and the law found --------------------------------------


def missing_force_figures(
    force: RestoringForce, loop: SiteLoop, added: Collection[str]
) -> list[Figure]:
    """The force that the declared laws lack at a site, with the found law over it.

    Over drift and over rate. Empty where the force was not measured, or where declared
    laws are not linear: their parts can then not be separated along filtered lines.

    Parameters
    ----------
    force : RestoringForce
        Of the final model.
    loop : SiteLoop
        Forces along the data.
    added : collection of str
        Names of the laws that the loop added there.
    """
    declared = [law for law in force.laws if law.name not in added]
    linear = RestoringForce(force.site, declared)
    if loop.measured is None or len(declared) == len(force.laws):
        return []
    if not set(linear.coefficients.index) <= {"v", "s"}:
        return []

    c, k = linear.linear_part()[["c", "k"]]
    carried = c * loop.v + k * loop.s
    missing, law = loop.measured - carried, loop.identified - carried
    figures = []
    for variable, values in (("s", loop.s), ("v", loop.v)):
        figures.append(_law_over_missing(loop, variable, values, missing, law))
    return figures


def _law_over_missing(
    loop: SiteLoop,
    variable: str,
    values: np.ndarray,
    missing: np.ndarray,
    law: np.ndarray,
) -> Figure:
    """The missing force over one variable."""
    word, unit = _variable(variable, loop.units)
    force_unit = loop.units.force
    size = rms(missing)
    share = 100.0 * rms(missing - law) / size if size > 0 else 0.0
    return Figure(
        f"The missing force at {loop.site} and the law found, over the {word[:-2]}",
        [
            Line(values, missing, "missing: measured less declared", "orange", 3.0),
            Line(values, law, "the law found", "blue", 1.2),
        ],
        Axis(word, unit),
        Axis("force", force_unit, zero=True),
        alt=(
            f"Force missing at {loop.site}, {size:.3g} {force_unit} rms, over the"
            f" {word[:-2]}; the law found leaves {share:.2g} percent of it."
        ),
        caption=(
            "Orange: the measured force less the declared laws. Blue: the law that was"
            f" found. It leaves {share:.2g} % of the missing force."
        ),
        legend="above",
        size=(4.2, 3.2),
        height=300,
        table=_table_of_missing(loop, missing, law),
    )


def _table_of_missing(loop: SiteLoop, missing: np.ndarray, law: np.ndarray) -> Table:
    """Sizes of a missing force, of the law found, and of what it leaves."""
    rows: list[list[object]] = []
    forces = {"missing": missing, "the law found": law, "left": missing - law}
    for name, force in forces.items():
        rows.append([name, rms(force), float(np.abs(force).max())])
    unit = loop.units.force
    head = ["force", f"rms ({unit})", f"peak ({unit})"]
    return Table(f"The missing force at {loop.site}", head, rows)
