"""Figures of what a model leaves: residuals, what explains them, where the missing
force acts, what it depends on.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...discrepancy.residual import Evidence
from .figure import CYCLE, Axis, Bars, Figure, Line, Mark, dof_words, table

_VARIABLES = {"s": ("drift s", "m"), "v": ("rate v", "m/s")}
_DEPENDENCES = {
    "constant": "nothing (constant)",
    "linear": "s, v, a linearly",
    "line": "a spectral line",
    "path": "the path (memory)",
}


def evidence_figures(evidence: Evidence, means: bool = True) -> list[Figure]:
    """What can be drawn of one step of the loop: residual, detection, localisation,
    dependence, ``means`` by bins.
    """
    made = [residual_figure(evidence.sizes, evidence.floor)]
    if evidence.detection is not None:
        made.append(_detection(evidence.detection))
    if evidence.localisation is not None and evidence.site:
        made.append(localisation_figure(evidence.localisation.table, evidence.chosen))
    found = [figure for figure in made if figure is not None]
    if evidence.characterisation is not None:
        found += dependence_figures(
            evidence.characterisation, f" at {evidence.site}", means
        )
    return found


def _lying(
    count: int, label: str, names: Sequence[str], high: float = 105.0, unit: str = "%"
) -> dict[str, Any]:
    """Axes and size of lying bars."""
    x = Axis(label, unit, (0, high))
    return {
        "x": x,
        "y": Axis(ticks=list(names)),
        "lying": True,
        "size": (5.0, 1.0 + 0.3 * count),
    }


def residual_figure(sizes: pd.DataFrame, floor: Any = None) -> Figure | None:
    """Residual of each balance and storey beside what noise alone leaves; None if there
    is none.
    """
    sizes = sizes[np.isfinite(sizes["percent"])] if len(sizes) else sizes
    if not len(sizes):
        return None
    names = [dof_words(n) for n in sizes.index]
    noise = np.full(len(sizes), np.nan)
    if floor is not None:
        level, reference = (
            np.array([floor.at(str(where)) for where in sizes.index]),
            sizes["reference"].to_numpy(),
        )
        np.divide(100 * level, reference, out=noise, where=reference > 0)
    caption = (
        "DOF: error of its force balance. Storey: the force that is missing across it."
    )
    colors = ["sky" if n.startswith("DOF") else "blue" for n in names]
    known = bool(np.isfinite(noise).any())
    marks: list[Mark] = [Bars(sizes["percent"], "residual" * known, colors)]
    if known:
        marks.append(
            Line(noise, np.arange(len(noise)), "noise alone", "red", 0, "", "|")
        )
        caption += " The red mark is what noise alone would leave."
    worst = sizes["percent"].idxmax()
    shown = sizes[["rms", "percent", "of"]].assign(noise=noise).set_axis(names, axis=0)
    head = {
        "rms": "residual rms (N)",
        "percent": "residual (%)",
        "of": "percent of",
        "noise": "noise alone (%)",
    }
    high = 1.15 * float(np.nanmax([*sizes["percent"], *noise])) or 1.0
    return Figure(
        "Residual: how much is left",
        marks,
        **_lying(len(names), "residual", names, high, "% of its reference"),
        alt=(
            "Residual of each balance and storey in percent; the largest is"
            f" {sizes['percent'].max():.3g} in {worst}."
        ),
        caption=caption,
        table=table("Residual on the search data", shown, head, index="where"),
    )


def _detection(found: Any) -> Figure | None:
    """What the motion explains of the residual of each balance and storey; None where
    nothing was asked.
    """
    shares = found.verdicts[["linear share", "nonlinear share", "verdict"]].dropna()
    if not len(shares):
        return None
    linear, rest = 100 * shares["linear share"], 100 * shares["nonlinear share"]
    names = [dof_words(n) for n in shares.index]
    shown = pd.DataFrame(
        {
            "linear": linear,
            "rest": rest,
            "verdict": [v.value for v in shares["verdict"]],
        }
    )
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
        **_lying(2 * len(names), "explained on data left out", names),
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


def localisation_figure(
    found: pd.DataFrame, chosen: str = "", most: int = 8
) -> Figure | None:
    """Share of the residual that a force at each site explains; sites that no balance
    tells apart share a bar.
    """
    found = found[found["share"].notna()]
    groups = [
        (list(g.index), g.iloc[0]) for _, g in found.groupby("pattern", sort=False)
    ]
    if len(groups) < 2:
        return None
    late = any(chosen in sites for sites, _ in groups[most:])
    groups = [g for k, g in enumerate(groups) if k < most - late or chosen in g[0]]
    heads = pd.DataFrame([first for _, first in groups])
    colors = [
        "orange" if chosen in sites else "sky" if k else "blue"
        for k, (sites, _) in enumerate(groups)
    ]
    more = [
        f" or {sites[1]}{', …' if len(sites) > 2 else ''}" if len(sites) > 1 else ""
        for sites, _ in groups
    ]
    names = [
        f"{sites[0]}{other}  ({row['balances']})"
        for (sites, row), other in zip(groups, more)
    ]
    head = {
        "share": "explains (%)",
        "low": "from (%)",
        "high": "to (%)",
        "own": "follows its own motion (%)",
        "balances": "signs in the balances",
    }
    shown = found.head(20)[[c for c in head if c in found]]
    low, high = heads["low"].clip(0, 100), heads["high"].clip(0, 100)
    return Figure(
        "Localisation: where the missing force acts",
        [Bars(heads["share"], color=colors, low=low, high=high)],
        **_lying(len(names), "residual explained by a force there", names),
        alt=(
            f"A force at {found.index[0]} would explain {heads['share'].iloc[0]:.0f}"
            " percent of the residual."
        ),
        caption=(
            "By the pattern of signs across the balances (Newton's third law); lines"
            " are about 95 %."
        )
        + " Orange: the site the loop chose." * ("orange" in colors),
        table=table(
            "Sites by the share of the residual that a force there would explain",
            shown,
            head,
            index="site",
        ),
    )


def dependence_figures(found: Any, where: str = "", means: bool = True) -> list[Figure]:
    """What a force depends on, without any formula, and its mean over single
    variables.
    """
    shares = found.shares
    names = [_DEPENDENCES.get(str(n), str(n)) for n in shares.index]
    bars = Bars(
        shares["share"].clip(lower=0),
        color=["blue" if chosen else "sky" for chosen in shares["chosen"]],
        low=shares["low"].clip(0, 100),
        high=shares["high"].clip(0, 100),
    )
    head = {
        "share": "explains (%)",
        "low": "from (%)",
        "high": "to (%)",
        "gain": "more than linear (points)",
    }
    shown = shares[list(head)].set_axis(names)
    whole = Figure(
        f"Characterisation: what the force{where} depends on",
        [bars],
        **_lying(len(names), "explained on data left out", names)
        | {"size": (4.2, 3.2)},
        alt=found.sentence,
        caption=(
            "Without any formula. Highlighted: the simplest that explains nearly as"
            " much as the best."
        ),
        table=table(
            "Share of the missing force that is a function of", shown, head, index="of"
        ),
    )
    drawn = [name for name in _VARIABLES if means and name in found.curves]
    return [
        whole,
        *(_mean(found.curves[name], *_VARIABLES[name], where) for name in drawn),
    ]


def _mean(curve: pd.DataFrame, word: str, unit: str, where: str) -> Figure:
    """Mean force in bins of one variable, with twice its error."""
    head = {
        "centre": f"{word} ({unit})",
        "mean": "mean force (N)",
        "error": "its error (N)",
        "count": "samples",
    }
    shown = curve[list(head)].astype({"count": int})
    first, last = curve["mean"].iloc[0], curve["mean"].iloc[-1]
    return Figure(
        f"The missing force{where} against its {word.split()[0]}",
        [
            Line(
                curve["centre"],
                curve["mean"],
                width=1.6,
                marker="o",
                error=2 * curve["error"],
            )
        ],
        Axis(word, unit),
        Axis("mean missing force", "N", zero=True),
        alt=(
            f"Mean missing force from {first:.3g} N at the lowest {word} to {last:.3g}"
            " N at the highest."
        ),
        caption="Mean in bins of equal count, with twice its error.",
        table=table(f"Mean missing force{where}", shown, head),
        size=(3.4, 3.2),
        height=280,
    )


def before_after_figure(report: Any) -> Figure:
    """Held-out errors of the baseline and after each effect that the closed loop
    added.
    """
    balances = [c for c in report.table if c.startswith("held-out dof")]
    columns = ["held-out", *balances] if len(balances) > 1 else ["held-out"]
    named = [
        "pooled" if c == "held-out" else dof_words(c.removeprefix("held-out "))
        for c in columns
    ]
    held = [True, *(step.confirmed for step in report.steps)]
    words = [
        ("+ " if k else "") + str(i).replace("_", " ")
        for k, i in enumerate(report.table.index)
    ]
    errors = report.table[columns].to_numpy(dtype=float)
    first, last = errors[0, 0], report.final["held-out"]
    names = [n if kept else f"{n} (not confirmed)" for n, kept in zip(words, held)]
    marks: list[Mark] = [
        Bars(row, name, ("muted", *CYCLE)[k % 7], hatched=not held[k])
        for k, (name, row) in enumerate(zip(names, errors))
    ]
    return Figure(
        "Held-out balance error before and after",
        marks,
        Axis(ticks=named),
        Axis("held-out balance error", "% NRMSE", (0, 1.25 * np.nanmax(errors))),
        alt=(
            f"Held-out error by balance; {named[0]}: from {first:.3g} to {last:.3g}"
            " percent."
        ),
        caption="Data that neither the search nor any fit has seen.",
        table=table(
            "Held-out balance error, percent NRMSE",
            pd.DataFrame(errors, words, named),
            index="model",
        ),
        wide=True,
        height=280,
    )
